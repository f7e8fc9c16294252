//! What tests of the core, and tests of what is built on it, compare against: structured bars whose
//! answers are known, a difference stencil ([`differences`]) and a full-order nonlinear solver
//! ([`statics`]). Compiled with the feature `testing` only.

pub mod differences;
pub mod statics;

use crate::mesh::TetMesh;
use std::sync::Arc;

/// How a hexahedral cell is split into tets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Five tets, mirrored from cell to cell by the parity of i + j + k.
    Five,
    /// Six tets around the diagonal (Kuhn), the same in every cell.
    Six,
}

/// A cut on the plane x = length/2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// None.
    Whole,
    /// From the face z = height down to half the height: vertices above that line are doubled.
    HalfDepth,
    /// Through the whole section: two separate halves.
    Through,
}

/// A box [0, l] × [0, w] × [0, h] of regular cells. Vertex (i, j, k) has the index
/// (i(n_y + 1) + j)(n_z + 1) + k; the doubles of a cut follow at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
    /// Length, width and height in m.
    pub size_m: [f64; 3],
    /// Cells along each; with a cut, even along the length (and the height, for `HalfDepth`).
    pub n_cells: [usize; 3],
    /// The split.
    pub cell: Cell,
    /// The cut.
    pub cut: Cut,
}

/// A bar's mesh.
#[derive(Clone, Debug)]
pub struct BarMesh {
    /// The mesh, one domain.
    pub mesh: Arc<TetMesh>,
    /// Vertices on x = 0.
    pub root: Vec<u32>,
    /// Vertices on x = length.
    pub tip: Vec<u32>,
    /// Co-located vertices of the two sides of the cut.
    pub pairs: Vec<[u32; 2]>,
}

impl Bar {
    /// Meshes the bar.
    pub fn mesh(&self) -> BarMesh {
        let [nx, ny, nz] = self.n_cells;
        let index = |[i, j, k]: [usize; 3]| ((i * (ny + 1) + j) * (nz + 1) + k) as u32;
        let mut vertices = Vec::new();
        for i in 0..=nx {
            for j in 0..=ny {
                for k in 0..=nz {
                    let place = [i, j, k];
                    vertices.push(std::array::from_fn(|axis| {
                        self.size_m[axis] * place[axis] as f64 / self.n_cells[axis] as f64
                    }));
                }
            }
        }
        let first_doubled = match self.cut {
            Cut::Whole => nz + 1,
            Cut::HalfDepth => nz / 2 + 1,
            Cut::Through => 0,
        };
        assert!(self.cut == Cut::Whole || nx.is_multiple_of(2), "the cut lies between cells");
        let mut double_of = std::collections::BTreeMap::new();
        for (j, k) in (0..=ny).flat_map(|j| (first_doubled..=nz).map(move |k| (j, k))) {
            let vertex = index([nx / 2, j, k]);
            double_of.insert(vertex, vertices.len() as u32);
            vertices.push(vertices[vertex as usize]);
        }
        let mut tets = Vec::new();
        for (i, j, k) in
            (0..nx).flat_map(|i| (0..ny).flat_map(move |j| (0..nz).map(move |k| (i, j, k))))
        {
            for offsets in self.cell.tets((i + j + k) % 2 == 1) {
                let tet = offsets.map(|[a, b, c]| index([i + a, j + b, k + c]));
                let beyond = |v: u32| double_of.get(&v).copied().unwrap_or(v);
                tets.push(oriented(if i >= nx / 2 { tet.map(beyond) } else { tet }, &vertices));
            }
        }
        let face =
            |i: usize| (0..=ny).flat_map(|j| (0..=nz).map(move |k| [i, j, k])).map(index).collect();
        let (root, tip) = (face(0), face(nx));
        let mesh = TetMesh::new(vertices, tets, Vec::new()).expect("a regular bar is a valid mesh");
        let pairs = double_of.into_iter().map(|(a, b)| [a, b]).collect();
        BarMesh { mesh: Arc::new(mesh), root, tip, pairs }
    }
}

impl Cell {
    /// Corners, as offsets from the cell's first vertex, of its tets.
    fn tets(self, is_odd: bool) -> Vec<[[usize; 3]; 4]> {
        match self {
            Cell::Five => {
                // One tet on four corners of equal parity, one at each of the other four corners.
                let flip = |[a, b, c]: [usize; 3]| if is_odd { [1 - a, b, c] } else { [a, b, c] };
                let inner = [[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]];
                let outer = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]];
                let mut tets = vec![inner.map(flip)];
                for corner in outer {
                    let mut tet = [corner; 4];
                    for axis in 0..3 {
                        tet[axis + 1][axis] = 1 - corner[axis];
                    }
                    tets.push(tet.map(flip));
                }
                tets
            }
            // One tet for each order in which the three axes can be walked.
            Cell::Six => [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]]
                .map(|axes| {
                    let mut tet = [[0; 3]; 4];
                    for step in 0..3 {
                        tet[step + 1] = tet[step];
                        tet[step + 1][axes[step]] = 1;
                    }
                    tet
                })
                .to_vec(),
        }
    }
}

/// `tet` with two corners swapped if its volume is negative.
fn oriented(mut tet: [u32; 4], vertices: &[[f64; 3]]) -> [u32; 4] {
    let x = tet.map(|v| nalgebra::Vector3::from(vertices[v as usize]));
    if (x[1] - x[0]).cross(&(x[2] - x[0])).dot(&(x[3] - x[0])) < 0.0 {
        tet.swap(2, 3);
    }
    tet
}
