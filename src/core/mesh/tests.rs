use super::*;

/// The unit tetrahedron at `origin`, and its four vertices.
fn unit_tet(origin: [f64; 3]) -> Vec<[f64; 3]> {
    let [x, y, z] = origin;
    vec![[x, y, z], [x + 1.0, y, z], [x, y + 1.0, z], [x, y, z + 1.0]]
}

fn error(vertices: Vec<[f64; 3]>, tets: Vec<[u32; 4]>, labels: Vec<i64>) -> MeshError {
    TetMesh::new(vertices, tets, labels).unwrap_err()
}

#[test]
fn a_mesh_needs_tets() {
    assert_eq!(error(unit_tet([0.0; 3]), vec![], vec![]), MeshError::NoTets);
}

#[test]
fn coordinates_must_be_finite() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut vertices = unit_tet([0.0; 3]);
        vertices[2][1] = bad;
        assert_eq!(
            error(vertices, vec![[0, 1, 2, 3]], vec![]),
            MeshError::NonFinite { vertex: 2, axis: 1 }
        );
    }
}

#[test]
fn a_huge_but_finite_tet_is_refused_without_overflow() {
    let vertices = unit_tet([0.0; 3]).into_iter().map(|x| x.map(|c| c * 1e200)).collect();
    assert!(matches!(error(vertices, vec![[0, 1, 2, 3]], vec![]), MeshError::Flat { tet: 0, .. }));
}

#[test]
fn corners_must_be_vertices() {
    assert_eq!(
        error(unit_tet([0.0; 3]), vec![[0, 1, 2, 3], [0, 1, 4, 3]], vec![]),
        MeshError::VertexOutOfRange { tet: 1, corner: 2, index: 4, n_vertices: 4 }
    );
}

#[test]
fn corners_must_differ() {
    assert_eq!(
        error(unit_tet([0.0; 3]), vec![[0, 1, 1, 3]], vec![]),
        MeshError::RepeatedVertex { tet: 0, vertex: 1 }
    );
}

#[test]
fn inverted_and_flat_tets_are_told_apart() {
    let MeshError::Inverted { tet: 0, volume_m3 } =
        error(unit_tet([0.0; 3]), vec![[0, 2, 1, 3]], vec![])
    else {
        panic!("not reported as inverted");
    };
    assert!((volume_m3 + 1.0 / 6.0).abs() < 1e-15);

    let mut vertices = unit_tet([0.0; 3]);
    vertices[3] = [0.3, 0.3, 0.0];
    let MeshError::Flat { tet: 0, longest_edge_m, .. } =
        error(vertices, vec![[0, 1, 2, 3]], vec![])
    else {
        panic!("not reported as flat");
    };
    assert!((longest_edge_m - 2f64.sqrt()).abs() < 1e-15);
}

#[test]
fn labels_are_one_a_tet_or_none() {
    assert_eq!(
        error(unit_tet([0.0; 3]), vec![[0, 1, 2, 3]], vec![1, 2]),
        MeshError::LabelCount { n_labels: 2, n_tets: 1 }
    );
    let mesh = TetMesh::new(unit_tet([0.0; 3]), vec![[0, 1, 2, 3]], vec![]).unwrap();
    assert_eq!((mesh.labels(), mesh.domains()), (&[0][..], &[0][..]));
}

#[test]
fn domains_components_and_unused_vertices_are_indexed() {
    // Two tets that share vertex 3, one apart, and vertex 4 that none uses.
    let mut vertices = unit_tet([0.0; 3]);
    vertices.push([9.0; 3]);
    vertices.extend(unit_tet([0.0, 0.0, 1.0]).split_off(1));
    vertices.extend(unit_tet([5.0, 0.0, 0.0]));
    let tets = vec![[8, 9, 10, 11], [3, 5, 6, 7], [0, 1, 2, 3]];
    let mesh = TetMesh::new(vertices, tets, vec![30, -7, 30]).unwrap();
    assert_eq!(mesh.domains(), [-7, 30]);
    assert_eq!(mesh.domain_of_tet(), [1, 0, 1]);
    assert_eq!(mesh.n_components(), 2);
    assert_eq!(mesh.component_of_vertex()[..4], [0; 4]);
    assert_eq!(mesh.component_of_vertex()[4], NO_COMPONENT);
    assert_eq!(mesh.component_of_vertex()[5..8], [0; 3]);
    assert_eq!(mesh.component_of_vertex()[8..], [1; 4]);
    assert_eq!(mesh.unused_vertices(), [4]);
    // The unused vertex does not count: from (0, 0, 0) to (6, 1, 2).
    assert!((mesh.diagonal() - 41f64.sqrt()).abs() < 1e-14);
}
