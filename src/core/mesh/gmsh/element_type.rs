//! Gmsh's element types.

/// What becomes of an element of some type.
pub(super) enum Role {
    /// A 4-node tetrahedron: kept.
    Tet,
    /// Takes no volume: its `n_nodes` nodes are read and left.
    Skipped { n_nodes: usize },
    /// Fills volume in a way that is not supported.
    Refused { name: &'static str },
    /// Not in Gmsh's table.
    Unknown,
}

/// The number of a 4-node tetrahedron.
pub(super) const TET4: i64 = 4;

/// Gmsh reference manual, "Node ordering" and the table of element types under "MSH file format".
pub(super) fn role(element_type: i64) -> Role {
    let skipped = |n_nodes| Role::Skipped { n_nodes };
    let refused = |name| Role::Refused { name };
    match element_type {
        TET4 => Role::Tet,
        15 => skipped(1),
        1 => skipped(2),
        8 => skipped(3),
        26 => skipped(4),
        27 => skipped(5),
        28 => skipped(6),
        2 => skipped(3),
        9 => skipped(6),
        20 => skipped(9),
        21 => skipped(10),
        22 => skipped(12),
        23 => skipped(15),
        24 => skipped(15),
        25 => skipped(21),
        3 => skipped(4),
        10 => skipped(9),
        16 => skipped(8),
        36 => skipped(16),
        37 => skipped(25),
        11 => refused("10-node tetrahedron"),
        29 => refused("20-node tetrahedron"),
        30 => refused("35-node tetrahedron"),
        31 => refused("56-node tetrahedron"),
        5 => refused("8-node hexahedron"),
        12 => refused("27-node hexahedron"),
        17 => refused("20-node hexahedron"),
        92 => refused("64-node hexahedron"),
        93 => refused("125-node hexahedron"),
        6 => refused("6-node prism"),
        13 => refused("18-node prism"),
        18 => refused("15-node prism"),
        7 => refused("5-node pyramid"),
        14 => refused("14-node pyramid"),
        19 => refused("13-node pyramid"),
        _ => Role::Unknown,
    }
}

/// Why an element that is neither kept nor skipped stops the reader.
pub(super) fn refusal(element: u64, element_type: i64) -> String {
    match role(element_type) {
        Role::Refused { name } => format!(
            "element {element} is a {name} (type {element_type}): only 4-node tetrahedra are supported"
        ),
        _ => format!("element {element} has the unknown type {element_type}"),
    }
}
