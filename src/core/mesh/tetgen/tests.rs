use crate::mesh::{MeshFormat, MeshLimits, NamedFile, SourceError, TetMesh, read, read_files};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const LIMITS: MeshLimits = MeshLimits { max_vertices: 100, max_tets: 100 };

fn both(nodes: &[u8], tets: &[u8]) -> Result<TetMesh, SourceError> {
    let nodes = NamedFile { name: Some("a.node"), bytes: nodes };
    let tets = NamedFile { name: Some("A.ELE"), bytes: tets };
    let mesh = read_files(&[nodes, tets], &LIMITS);
    // Whichever comes first.
    assert_eq!(read_files(&[tets, nodes], &LIMITS), mesh);
    mesh.map(|file| file.mesh)
}

const NODES: &str =
    "# four nodes\n4 3 0 1\n1 0 0 0 1\n2 1 0 0 1\n3 0 1 0 1\n4 0 0 1 1 # the last\n";
const TETS: &str = "1 4 1\n1 1 2 3 4 -7\n";

#[test]
fn nodes_and_tets_make_a_mesh_whatever_the_first_number_is() {
    let mesh = both(NODES.as_bytes(), TETS.as_bytes()).unwrap();
    assert_eq!((mesh.tets(), mesh.labels()), ([[0, 1, 2, 3]].as_slice(), [-7].as_slice()));
    let nodes = "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n";
    let zero_based = both(nodes.as_bytes(), b"1 4 0\r\n0 0 1 2 3").unwrap();
    assert_eq!((zero_based.tets(), zero_based.labels()), (mesh.tets(), [0].as_slice()));
    // As meshio writes them, and the same mesh in another format.
    let boxes = both(
        include_bytes!("../../../../tests/data/formats/two_boxes.node"),
        include_bytes!("../../../../tests/data/formats/two_boxes.ele"),
    );
    let bytes = include_bytes!("../../../../tests/data/formats/two_boxes_v42_binary.vtk");
    assert_eq!(boxes.unwrap(), read(bytes, MeshFormat::VtkLegacy, &LIMITS).unwrap().mesh);
}

#[test]
fn faults_name_the_file_and_the_line() {
    for (nodes, tets, expected) in [
        (
            NODES.replace("3 0 1 0 1\n", ""),
            TETS.into(),
            ".node file, line 5: the node's number is 4",
        ),
        (NODES.replace("4 3 0", "4 2 0"), TETS.into(), ".node file, line 2: nodes must have"),
        (NODES.replace("4 0 0 1", "4 0 0 inf"), TETS.into(), ".node file, line 6: node 4"),
        (NODES.replace("4 3 0", "400 3 0"), TETS.into(), ".node file, line 3: 400 nodes declared"),
        (NODES.into(), TETS.replace("2 3 4", "2 3 5"), ".ele file, line 2: tet 1: node 5 is not"),
        (
            NODES.into(),
            TETS.replace("2 3 4", "3 2 4"),
            ".ele file, line 2: element 1: tet 0 is inv",
        ),
        (NODES.into(), TETS.replace("1 4 1", "1 10 1"), ".ele file, line 1: tets of 10 nodes"),
        (NODES.into(), TETS.replace("-7", "1.5"), ".ele file, line 2: tet 1: its region 1.5"),
        (NODES.into(), TETS.replace("-7", ""), ".ele file, line 2: expected the tet's region"),
        (NODES.into(), format!("{TETS}2 1 2 3 4 1\n"), ".ele file, line 3: expected the end"),
    ] {
        let error = both(nodes.as_bytes(), tets.as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
    }
}

#[test]
fn no_bytes_make_the_reader_panic() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut n_refused = 0;
    for _ in 0..3000 {
        let mut files = [NODES.as_bytes().to_vec(), TETS.as_bytes().to_vec()];
        for _ in 0..3 {
            let file = &mut files[random.random_range(0..2)];
            let at = random.random_range(0..file.len());
            match random.random_range(0..3) {
                0 => file[at] ^= 1 << random.random_range(0..8),
                1 => file[at] = b"0123456789-. \n#"[random.random_range(0..15)],
                _ => file.truncate(at.max(1)),
            }
        }
        n_refused += usize::from(both(&files[0], &files[1]).is_err());
    }
    assert!(n_refused > 1000, "{n_refused}");
}
