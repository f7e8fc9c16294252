//! Tetrahedral meshes: the validated [`TetMesh`], and [`read_files`] for the files they come in.

mod cursor;
mod gmsh;
mod line;
mod reader;
mod surface;
mod tetgen;
mod vega;
mod vtk;

pub use reader::{
    Location, MeshFile, MeshFormat, MeshLimits, NamedFile, ReadError, ReadFault, SourceError, read,
    read_files,
};

use std::collections::BTreeSet;

/// A tetrahedron whose volume is below this fraction of its longest edge cubed counts as flat.
/// A regular one has 0.118; the quality meshers call slivers starts near 1e-3.
pub const FLAT_VOLUME_RATIO: f64 = 1e-12;

/// What is wrong with a mesh, and where. Indices are zero-based.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum MeshError {
    #[error("the mesh has no tetrahedra")]
    NoTets,
    #[error("vertex {vertex}: coordinate {axis} is not finite")]
    NonFinite { vertex: usize, axis: usize },
    #[error("tet {tet}: corner {corner} is vertex {index}, but the mesh has {n_vertices} vertices")]
    VertexOutOfRange { tet: usize, corner: usize, index: u64, n_vertices: usize },
    #[error("tet {tet}: vertex {vertex} appears twice")]
    RepeatedVertex { tet: usize, vertex: usize },
    #[error(
        "tet {tet} is inverted: its signed volume is {volume_m3:e} m³ (swap two of its corners to orient it)"
    )]
    Inverted { tet: usize, volume_m3: f64 },
    #[error(
        "tet {tet} is flat: its volume is {volume_m3:e} m³ with a longest edge of {longest_edge_m:e} m"
    )]
    Flat { tet: usize, volume_m3: f64, longest_edge_m: f64 },
    #[error("{n_labels} domain labels for {n_tets} tets")]
    LabelCount { n_labels: usize, n_tets: usize },
    #[error("too many vertices: {n_vertices}, at most {limit}")]
    TooManyVertices { n_vertices: usize, limit: usize },
}

/// A valid tetrahedral mesh: finite coordinates in metres, every tet positively oriented and not
/// flat, one domain label a tet. Vertices that no tet uses are kept (so that the caller's indices
/// stay true) and listed; they carry no mass and never move.
#[derive(Clone, Debug, PartialEq)]
pub struct TetMesh {
    vertices: Vec<[f64; 3]>,
    tets: Vec<[u32; 4]>,
    labels: Vec<i64>,
    domains: Vec<i64>,
    domain_of_tet: Vec<u32>,
    component_of_vertex: Vec<u32>,
    n_components: usize,
    unused: Vec<u32>,
    diagonal_m: f64,
}

/// `component_of_vertex` of a vertex that no tet uses.
pub const NO_COMPONENT: u32 = u32::MAX;

impl TetMesh {
    /// Checks and indexes a mesh. `tets` holds zero-based vertex indices; `labels` is one domain
    /// label a tet, or empty for a single domain 0.
    pub fn new(
        vertices: Vec<[f64; 3]>,
        tets: Vec<[u32; 4]>,
        labels: Vec<i64>,
    ) -> Result<TetMesh, MeshError> {
        let n_vertices = vertices.len();
        let limit = (u32::MAX / 3 - 1) as usize;
        if n_vertices > limit {
            return Err(MeshError::TooManyVertices { n_vertices, limit });
        }
        if tets.is_empty() {
            return Err(MeshError::NoTets);
        }
        let labels = if labels.is_empty() { vec![0; tets.len()] } else { labels };
        if labels.len() != tets.len() {
            return Err(MeshError::LabelCount { n_labels: labels.len(), n_tets: tets.len() });
        }
        for (vertex, x) in vertices.iter().enumerate() {
            if let Some(axis) = x.iter().position(|c| !c.is_finite()) {
                return Err(MeshError::NonFinite { vertex, axis });
            }
        }
        for (tet, corners) in tets.iter().enumerate() {
            check_tet(tet, corners, &vertices)?;
        }
        let domains: Vec<i64> =
            labels.iter().copied().collect::<BTreeSet<_>>().into_iter().collect();
        let domain_of_tet =
            labels.iter().map(|label| domains.partition_point(|d| d < label) as u32).collect();
        let (component_of_vertex, n_components) = components(n_vertices, &tets);
        let unused = (0..n_vertices as u32)
            .filter(|&v| component_of_vertex[v as usize] == NO_COMPONENT)
            .collect();
        let diagonal_m = diagonal_m(&vertices, &tets);
        Ok(TetMesh {
            vertices,
            tets,
            labels,
            domains,
            domain_of_tet,
            component_of_vertex,
            n_components,
            unused,
            diagonal_m,
        })
    }

    /// Rest positions in metres.
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.vertices
    }
    /// Corners of each tet, zero-based.
    pub fn tets(&self) -> &[[u32; 4]] {
        &self.tets
    }
    /// The domain label of each tet.
    pub fn labels(&self) -> &[i64] {
        &self.labels
    }
    /// The distinct domain labels, ascending.
    pub fn domains(&self) -> &[i64] {
        &self.domains
    }
    /// For each tet, the position of its label in [`TetMesh::domains`].
    pub fn domain_of_tet(&self) -> &[u32] {
        &self.domain_of_tet
    }
    /// For each vertex, the connected component it belongs to, or [`NO_COMPONENT`].
    pub fn component_of_vertex(&self) -> &[u32] {
        &self.component_of_vertex
    }
    /// Number of connected components (tets sharing a vertex are connected).
    pub fn n_components(&self) -> usize {
        self.n_components
    }
    /// Vertices that no tet uses, ascending.
    pub fn unused_vertices(&self) -> &[u32] {
        &self.unused
    }
    /// Length of the bounding box's diagonal over the used vertices, in metres.
    pub fn diagonal(&self) -> f64 {
        self.diagonal_m
    }
}

fn diagonal_m(vertices: &[[f64; 3]], tets: &[[u32; 4]]) -> f64 {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for corner in tets.iter().flatten() {
        for axis in 0..3 {
            let x = vertices[*corner as usize][axis];
            low[axis] = low[axis].min(x);
            high[axis] = high[axis].max(x);
        }
    }
    (0..3).map(|axis| (high[axis] - low[axis]).powi(2)).sum::<f64>().sqrt()
}

fn check_tet(tet: usize, corners: &[u32; 4], vertices: &[[f64; 3]]) -> Result<(), MeshError> {
    for (corner, &index) in corners.iter().enumerate() {
        if index as usize >= vertices.len() {
            return Err(MeshError::VertexOutOfRange {
                tet,
                corner,
                index: u64::from(index),
                n_vertices: vertices.len(),
            });
        }
        if corners[..corner].contains(&index) {
            return Err(MeshError::RepeatedVertex { tet, vertex: index as usize });
        }
    }
    let x = corners.map(|v| nalgebra::Vector3::from(vertices[v as usize]));
    let volume_m3 = (x[1] - x[0]).cross(&(x[2] - x[0])).dot(&(x[3] - x[0])) / 6.0;
    let longest_edge_m = (0..4)
        .flat_map(|a| (0..a).map(move |b| (a, b)))
        .map(|(a, b)| (x[a] - x[b]).norm())
        .fold(0.0, f64::max);
    if volume_m3.abs() <= FLAT_VOLUME_RATIO * longest_edge_m.powi(3) || !volume_m3.is_finite() {
        return Err(MeshError::Flat { tet, volume_m3, longest_edge_m });
    }
    if volume_m3 < 0.0 {
        return Err(MeshError::Inverted { tet, volume_m3 });
    }
    Ok(())
}

/// Connected components by union-find over the tets' corners; numbered by lowest vertex.
fn components(n_vertices: usize, tets: &[[u32; 4]]) -> (Vec<u32>, usize) {
    fn root(parent: &mut [u32], mut v: u32) -> u32 {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    }
    let mut parent: Vec<u32> = (0..n_vertices as u32).collect();
    let mut used = vec![false; n_vertices];
    for corners in tets {
        for &v in corners {
            used[v as usize] = true;
            let (a, b) = (root(&mut parent, corners[0]), root(&mut parent, v));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut component = vec![NO_COMPONENT; n_vertices];
    let mut count = 0;
    for v in 0..n_vertices as u32 {
        if !used[v as usize] {
            continue;
        }
        let r = root(&mut parent, v);
        if r == v {
            component[v as usize] = count;
            count += 1;
        } else {
            component[v as usize] = component[r as usize];
        }
    }
    (component, count as usize)
}

#[cfg(test)]
mod tests;
