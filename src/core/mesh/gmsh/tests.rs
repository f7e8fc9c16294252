use crate::mesh::{
    Location, MeshError, MeshFormat, MeshLimits, ReadError, ReadFault, TetMesh, read,
};

const LIMITS: MeshLimits = MeshLimits { max_vertices: 1000, max_tets: 1000 };

fn read_mesh(bytes: &[u8]) -> Result<TetMesh, ReadError> {
    read(bytes, MeshFormat::Gmsh, &LIMITS).map(|file| file.mesh)
}

fn error(bytes: &[u8]) -> ReadError {
    read_mesh(bytes).unwrap_err()
}

fn volume_m3(mesh: &TetMesh) -> f64 {
    let volume = |corners: &[u32; 4]| {
        let x = corners.map(|v| nalgebra::Vector3::from(mesh.vertices()[v as usize]));
        (x[1] - x[0]).cross(&(x[2] - x[0])).dot(&(x[3] - x[0])) / 6.0
    };
    mesh.tets().iter().map(volume).sum()
}

fn n_tets_of(mesh: &TetMesh, label: i64) -> usize {
    mesh.labels().iter().filter(|&&other| other == label).count()
}

macro_rules! fixture {
    ($name:literal) => {
        include_bytes!(concat!("../../../../tests/data/", $name))
    };
}

/// Two tets on either side of a triangle, with sparse node numbers: their five nodes.
const NODES: [(i32, [f64; 3]); 5] = [
    (10, [0.0, 0.0, 0.0]),
    (7, [1.0, 0.0, 0.0]),
    (300, [0.0, 1.0, 0.0]),
    (4, [0.0, 0.0, 1.0]),
    (5, [0.0, 0.0, -1.0]),
];

/// Appends int32 numbers in either byte order.
fn push_ints(bytes: &mut Vec<u8>, numbers: &[i32], big_endian: bool) {
    for number in numbers {
        bytes.extend(if big_endian { number.to_be_bytes() } else { number.to_le_bytes() });
    }
}

fn push_sizes(bytes: &mut Vec<u8>, numbers: &[u64], big_endian: bool) {
    for number in numbers {
        bytes.extend(if big_endian { number.to_be_bytes() } else { number.to_le_bytes() });
    }
}

fn push_reals(bytes: &mut Vec<u8>, numbers: &[f64], big_endian: bool) {
    for number in numbers {
        bytes.extend(if big_endian { number.to_be_bytes() } else { number.to_le_bytes() });
    }
}

/// [`NODES`] in binary format 2.2: a run of one triangle, then one of two tets.
fn binary_v2(big_endian: bool) -> Vec<u8> {
    let mut bytes = b"$MeshFormat\n2.2 1 8\n".to_vec();
    push_ints(&mut bytes, &[1], big_endian);
    bytes.extend(b"\n$EndMeshFormat\n$Nodes\n5\n");
    for (tag, x) in NODES {
        push_ints(&mut bytes, &[tag], big_endian);
        push_reals(&mut bytes, &x, big_endian);
    }
    bytes.extend(b"\n$EndNodes\n$Elements\n3\n");
    push_ints(&mut bytes, &[2, 1, 2, 1, 8, 8, 10, 7, 300], big_endian);
    push_ints(&mut bytes, &[4, 2, 2], big_endian);
    push_ints(&mut bytes, &[2, 41, 1, 10, 7, 300, 4], big_endian);
    push_ints(&mut bytes, &[3, 0, 2, 10, 300, 7, 5], big_endian);
    bytes.extend(b"\n$EndElements\n");
    bytes
}

/// The same in binary format 4.1; volume 1 is in physical group −41, volume 2 in none.
fn binary_v4(big_endian: bool) -> Vec<u8> {
    let e = big_endian;
    let mut bytes = b"$MeshFormat\n4.1 1 8\n".to_vec();
    push_ints(&mut bytes, &[1], e);
    bytes.extend(b"\n$EndMeshFormat\n$Entities\n");
    push_sizes(&mut bytes, &[1, 0, 0, 2], e);
    push_ints(&mut bytes, &[1], e);
    push_reals(&mut bytes, &[0.0; 3], e);
    push_sizes(&mut bytes, &[0], e);
    for (volume, physical) in [(1, Some(-41)), (2, None)] {
        push_ints(&mut bytes, &[volume], e);
        push_reals(&mut bytes, &[0.0; 6], e);
        push_sizes(&mut bytes, &[physical.iter().count() as u64], e);
        push_ints(&mut bytes, physical.as_slice(), e);
        push_sizes(&mut bytes, &[1], e);
        push_ints(&mut bytes, &[3], e);
    }
    bytes.extend(b"\n$EndEntities\n$Nodes\n");
    push_sizes(&mut bytes, &[2, 5, 4, 300], e);
    // The first two nodes lie on a curve and carry one parametric coordinate.
    for (block, dimension) in [(&NODES[..2], 1), (&NODES[2..], 3)] {
        push_ints(&mut bytes, &[dimension, 1, i32::from(dimension == 1)], e);
        push_sizes(&mut bytes, &[block.len() as u64], e);
        for (tag, _) in block {
            push_sizes(&mut bytes, &[*tag as u64], e);
        }
        for (_, x) in block {
            push_reals(&mut bytes, x, e);
            push_reals(&mut bytes, if dimension == 1 { &[0.5] } else { &[] }, e);
        }
    }
    bytes.extend(b"\n$EndNodes\n$Elements\n");
    push_sizes(&mut bytes, &[3, 3, 1, 3], e);
    for (block, element) in [
        ([2, 1, 2], &[1, 10, 7, 300][..]),
        ([3, 1, 4], &[2, 10, 7, 300, 4]),
        ([3, 2, 4], &[3, 10, 300, 7, 5]),
    ] {
        push_ints(&mut bytes, &block, e);
        push_sizes(&mut bytes, &[1], e);
        push_sizes(&mut bytes, element, e);
    }
    bytes.extend(b"\n$EndElements\n");
    bytes
}

const TEXT_V2: &str = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n\
    $PhysicalNames\n1\n3 41 \"upper $Nodes\"\n$EndPhysicalNames\n\
    $Nodes\n5\n10 0 0 0\n7 1 0 0\n300 0 1 0\n4 0 0 1\n5 0 0 -1\n$EndNodes\n\
    $Elements\n3\n1 2 2 8 8 10 7 300\n2 4 2 41 1 10 7 300 4\n3 4 2 0 2 10 300 7 5\n$EndElements\n";

fn two_tets() -> TetMesh {
    TetMesh::new(NODES.map(|(_, x)| x).to_vec(), vec![[0, 1, 2, 3], [0, 2, 1, 4]], vec![41, 2])
        .unwrap()
}

#[test]
fn every_version_and_encoding_gives_the_same_mesh() {
    assert_eq!(read_mesh(TEXT_V2.as_bytes()).unwrap(), two_tets());
    assert_eq!(read_mesh(TEXT_V2.replace('\n', "\r\n").as_bytes()).unwrap(), two_tets());
    for big_endian in [false, true] {
        assert_eq!(read_mesh(&binary_v2(big_endian)).unwrap(), two_tets());
        assert_eq!(read_mesh(&binary_v4(big_endian)).unwrap(), two_tets());
    }
}

#[test]
fn format_1_is_read() {
    let text = "$NOD\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$ENDNOD\n\
        $ELM\n2\n1 2 1 1 3 1 2 3\n2 4 6 1 4 1 2 3 4\n$ENDELM\n";
    let mesh = read_mesh(text.as_bytes()).unwrap();
    assert_eq!((mesh.tets(), mesh.domains()), (&[[0, 1, 2, 3]][..], &[6][..]));
}

#[test]
fn files_of_other_programs_are_read() {
    let cube = read_mesh(fixture!("formats/cube_tet4_24.msh")).unwrap();
    assert_eq!((cube.vertices().len(), cube.tets().len(), cube.domains()), (14, 24, &[1][..]));
    assert!((volume_m3(&cube) - 1.0).abs() < 1e-14);

    let bar = read_mesh(fixture!("formats/bar-186.msh")).unwrap();
    assert_eq!((bar.vertices().len(), bar.tets().len(), bar.domains()), (86, 186, &[0][..]));
    assert!((volume_m3(&bar) - 5.0).abs() < 1e-13);

    let sides = read_mesh(fixture!("formats/gmsh_physical_sides_3d_v41.msh")).unwrap();
    assert_eq!((sides.tets().len(), sides.domains()), (2, &[41, 42][..]));

    let boxes = read_mesh(fixture!("formats/boxes_v41.msh")).unwrap();
    assert_eq!((boxes.domains(), boxes.n_components()), (&[7, 9][..], 2));
    assert_eq!(n_tets_of(&boxes, 9), 2 * n_tets_of(&boxes, 7));
    assert!((volume_m3(&boxes) - 3.0).abs() < 1e-14);
    for binary in [
        &fixture!("formats/boxes_v41_binary.msh")[..],
        &fixture!("formats/boxes_v22_binary.msh")[..],
    ] {
        let binary = read_mesh(binary).unwrap();
        assert_eq!(binary.labels(), boxes.labels());
        assert!((volume_m3(&binary) - 3.0).abs() < 1e-14);
    }
}

#[test]
fn bundled_bodies_are_read() {
    let limits = MeshLimits { max_vertices: 5000, max_tets: 15_000 };
    for (bytes, n_vertices, n_tets_by_domain, expected_volume_m3) in [
        (&fixture!("stomach_small.msh")[..], 4576, vec![13659], 0.00018019822220313744),
        (fixture!("plant_small.msh"), 2817, vec![5172, 1645, 1303], 5.6463909572685214e-05),
        (fixture!("fork_small.msh"), 2401, vec![4456, 2737], 2.341735906063879e-05),
    ] {
        let mesh = read(bytes, MeshFormat::Gmsh, &limits).unwrap().mesh;
        assert_eq!(mesh.vertices().len(), n_vertices);
        let counts: Vec<usize> = mesh.domains().iter().map(|d| n_tets_of(&mesh, *d)).collect();
        assert_eq!(counts, n_tets_by_domain);
        assert_eq!(mesh.n_components(), n_tets_by_domain.len());
        assert!(mesh.unused_vertices().is_empty());
        assert!((volume_m3(&mesh) / expected_volume_m3 - 1.0).abs() < 1e-13);
    }
}

/// [`TEXT_V2`] with a piece replaced.
fn edited(from: &str, to: &str) -> ReadError {
    assert!(TEXT_V2.contains(from));
    error(TEXT_V2.replace(from, to).as_bytes())
}

#[test]
fn faults_in_text_are_located() {
    let bad_number = edited("7 1 0 0", "7 1 zero 0");
    assert_eq!(bad_number.to_string(), "line 11: expected a y coordinate, found “zero”");
    let short = edited("7 1 0 0", "7 1 0");
    assert_eq!(short.to_string(), "line 11: expected a z coordinate, found the end of the line");
    let missing_node = edited("3 4 2 0 2 10 300 7 5", "3 4 2 0 2 10 300 7 6");
    assert_eq!(missing_node.to_string(), "line 20: element 3: node 6 is not among the 5 nodes");
    let twice = edited("\n4 0 0 1", "\n7 0 0 1");
    assert_eq!(twice.to_string(), "line 13: node 7 is defined twice");
    let inverted = edited("2 4 2 41 1 10 7 300 4", "2 4 2 41 1 10 300 7 4");
    assert_eq!(inverted.location, Location::Line(19));
    assert!(matches!(
        &inverted.fault,
        ReadFault::Mesh { item, error: MeshError::Inverted { tet: 0, .. } } if item == "element 2"
    ));
    let not_a_number = edited("\n4 0 0 1", "\n4 0 0 NaN");
    assert_eq!(not_a_number.to_string(), "line 13: node 4: vertex 3: coordinate 2 is not finite");
    let truncated = error(&TEXT_V2.as_bytes()[..TEXT_V2.find("2 4 2 41").unwrap() + 10]);
    assert_eq!(truncated.location, Location::Line(19));
    assert!(truncated.to_string().ends_with("found the end of the file"), "{truncated}");
}

#[test]
fn faults_in_binary_are_located() {
    let bytes = binary_v4(false);
    let truncated = error(&bytes[..bytes.len() - 40]);
    assert!(matches!(truncated.location, Location::Byte(_)), "{truncated}");
    let mut marker = binary_v2(true);
    let at = b"$MeshFormat\n2.2 1 8\n".len();
    marker[at + 1] = 7;
    assert_eq!(error(&marker).location, Location::Line(3));
}

#[test]
fn unsupported_content_is_named() {
    let quadratic = edited("1 2 2 8 8 10 7 300", "1 11 2 8 8 1 2 3 4 5 6 7 8 9 10");
    assert_eq!(
        quadratic.to_string(),
        "line 18: element 1 is a 10-node tetrahedron (type 11): only 4-node tetrahedra are supported"
    );
    let unknown = edited("1 2 2 8 8 10 7 300", "1 999 2 8 8 10 7 300");
    assert_eq!(unknown.to_string(), "line 18: element 1 has the unknown type 999");
    let version = edited("2.2 0 8", "4 0 8");
    assert_eq!(version.to_string(), "line 2: Gmsh format 4 is not supported: save as 4.1 or 2.2");
    assert!(matches!(edited("2.2 0 8", "2.2 0 4").fault, ReadFault::Unsupported(_)));
    assert!(matches!(edited("2.2 0 8", "2.2 2 8").fault, ReadFault::Unsupported(_)));
    assert!(matches!(
        edited("$PhysicalNames", "$PartitionedEntities").fault,
        ReadFault::Unsupported(_)
    ));
}

#[test]
fn sections_must_be_there_once_and_closed() {
    for (from, to) in [
        ("$EndNodes", "$EndNode"),
        ("$EndPhysicalNames", "$EndPhysical"),
        ("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n", ""),
        ("$EndNodes\n", "$EndNodes\n$Nodes\n0\n$EndNodes\n"),
    ] {
        edited(from, to);
    }
    let nodes_only = &TEXT_V2[..TEXT_V2.find("$Elements").unwrap()];
    assert_eq!(
        error(nodes_only.as_bytes()).to_string(),
        "line 16: expected a $Elements section, found the end of the file"
    );
    let surface_only =
        edited("\n3\n1 2 2 8 8 10 7 300", "\n1\n1 2 2 8 8 10 7 300\n$EndElements\n$X");
    assert!(matches!(surface_only.fault, ReadFault::Inconsistent(_)), "{surface_only}");
    assert!(error(b"").to_string().contains("$Nodes"));
}

#[test]
fn declared_counts_are_checked_before_allocation() {
    let over = edited("$Nodes\n5", "$Nodes\n1000000000000");
    assert!(
        matches!(over.fault, ReadFault::OverLimit { declared: 1_000_000_000_000, limit: 1000, .. }),
        "{over}"
    );
    let more_than_bytes = edited("$Nodes\n5", "$Nodes\n999");
    assert!(matches!(more_than_bytes.fault, ReadFault::Truncated { declared: 999, .. }));
    let elements = edited("$Elements\n3", "$Elements\n18446744073709551615");
    assert!(matches!(elements.fault, ReadFault::Truncated { .. }), "{elements}");

    let few = MeshLimits { max_vertices: 5, max_tets: 1 };
    for bytes in [TEXT_V2.as_bytes(), &binary_v2(false), &binary_v4(true)] {
        let fault = read(bytes, MeshFormat::Gmsh, &few).unwrap_err().fault;
        assert!(
            matches!(fault, ReadFault::OverLimit { what: "tets", declared: 2, limit: 1 }),
            "{fault}"
        );
    }
}
