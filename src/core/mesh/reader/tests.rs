use super::*;
use crate::mesh::vtk::tests::FILES;
use rand::Rng;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const LIMITS: MeshLimits = MeshLimits { max_vertices: 1 << 16, max_tets: 1 << 16 };

#[test]
fn formats_are_told_by_name_and_by_content() {
    assert_eq!(MeshFormat::from_file_name("a.b/liver.MSH"), Some(MeshFormat::Gmsh));
    assert_eq!(MeshFormat::from_file_name("beam.veg"), Some(MeshFormat::Vega));
    assert_eq!(MeshFormat::from_file_name("veg"), None);
    assert_eq!(MeshFormat::from_file_name("beam.vtk"), Some(MeshFormat::VtkLegacy));
    assert_eq!(MeshFormat::from_file_name("beam.VTU"), Some(MeshFormat::VtkXml));
    assert_eq!(MeshFormat::from_file_name("beam.stl"), None);
    assert_eq!(MeshFormat::sniff(b"# vtk DataFile Version 3.0"), Some(MeshFormat::VtkLegacy));
    assert_eq!(MeshFormat::sniff(b"<?xml version=\"1.0\"?>"), Some(MeshFormat::VtkXml));
    assert_eq!(MeshFormat::sniff(b"\n$MeshFormat\n"), Some(MeshFormat::Gmsh));
    assert_eq!(MeshFormat::sniff(b"# a comment"), Some(MeshFormat::Vega));
    assert_eq!(MeshFormat::sniff(b"*VERTICES"), Some(MeshFormat::Vega));
    assert_eq!(MeshFormat::sniff(b"\0\x01"), None);
    assert_eq!(MeshFormat::sniff(b""), None);
}

/// Truncations, flipped bits, swapped digits and overwritten words of valid files of every kind:
/// whatever comes out is a mesh or an error.
#[test]
fn no_bytes_make_a_reader_panic() {
    let mut files: Vec<(MeshFormat, &[u8])> = vec![
        (MeshFormat::Gmsh, include_bytes!("../../../../tests/data/formats/boxes_v41.msh")),
        (MeshFormat::Gmsh, include_bytes!("../../../../tests/data/formats/boxes_v41_binary.msh")),
        (MeshFormat::Gmsh, include_bytes!("../../../../tests/data/formats/boxes_v22_binary.msh")),
        (MeshFormat::Gmsh, include_bytes!("../../../../tests/data/formats/cube_tet4_24.msh")),
        (
            MeshFormat::Gmsh,
            b"$NOD\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$ENDNOD\n\
              $ELM\n1\n2 4 6 1 4 1 2 3 4\n$ENDELM\n",
        ),
        (MeshFormat::Vega, include_bytes!("../../../../tests/data/formats/beam3_tet.veg")),
    ];
    let format = |name: &str| MeshFormat::from_file_name(name).unwrap();
    files.extend(FILES.iter().map(|(name, bytes)| (format(name), *bytes)));
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let (mut n_read, mut n_refused) = (0, 0);
    for (format, original) in files {
        let len = original.trim_ascii_end().len();
        for end in (0..len).step_by(1 + len / 500) {
            let is_whole = read(&original[..end], format, &LIMITS).is_ok();
            // Files of Vega and legacy VTK have no mark of their end: they may be cut between sections.
            // Behind appended data comes nothing that a reader needs.
            let is_open = matches!(format, MeshFormat::Vega | MeshFormat::VtkLegacy)
                || (format == MeshFormat::VtkXml && len < end + 40);
            assert!(!is_whole || is_open, "{format:?} cut at byte {end} of {len}");
        }
        for _ in 0..2000 {
            let mut bytes = original.to_vec();
            for _ in 0..random.random_range(1..4) {
                let at = random.random_range(0..bytes.len());
                match random.random_range(0..4) {
                    0 => bytes[at] ^= 1 << random.random_range(0..8),
                    1 => bytes[at] = b"0123456789-+.eE \n\r$*#,"[random.random_range(0..22)],
                    2 => {
                        let end = (at + 8).min(bytes.len());
                        bytes[at..end].fill([0x00, 0x7f, 0xff][random.random_range(0..3)]);
                    }
                    _ => {
                        let end = random.random_range(at..bytes.len().min(at + 64));
                        bytes.drain(at..end);
                    }
                }
            }
            match read(&bytes, format, &LIMITS) {
                Ok(_) => n_read += 1,
                Err(error) => {
                    assert!(error.to_string().chars().count() < 300, "{error}");
                    n_refused += 1;
                }
            }
        }
    }
    // The mutations are neither all harmless nor all caught at the first line.
    assert!(n_read > 100 && n_refused > 1000, "{n_read} read, {n_refused} refused");
}
