//! How a body answers a load, to first order: u = Σ φᵢ (φᵢ·f) / λᵢ over its linear modes. Enough to
//! choose loads whose effect can be seen; the simulation is the daemon's.

use nalgebra::Vector3;
use std::f64::consts::TAU;
use sutura_client::Array;
use sutura_client::proto::simulation::Force;
use sutura_core::mesh::TetMesh;

/// Static displacements are scaled to this fraction of the body's diagonal: the pull, and the
/// opening of the incision. Applied at once, a load swings the body twice as far.
const PULL_RATIO: f64 = 0.04;
const OPENING_RATIO: f64 = 0.05;

/// Linear modes as a compliance.
pub(crate) struct Compliance<'a> {
    modes: &'a Array<f32>,
    eigenvalues_per_s2: Vec<f64>,
}

impl Compliance<'_> {
    pub(crate) fn new<'a>(modes: &'a Array<f32>, frequencies_hz: &[f64]) -> Compliance<'a> {
        let eigenvalues_per_s2 = frequencies_hz.iter().map(|hz| (TAU * hz).powi(2)).collect();
        Compliance { modes, eigenvalues_per_s2 }
    }

    fn shape(&self, mode: usize, vertex: u32) -> Vector3<f64> {
        let n_vertices = self.modes.shape[1];
        let at = 3 * (mode * n_vertices + vertex as usize);
        Vector3::from_fn(|axis, _| f64::from(self.modes.data[at + axis]))
    }

    fn n_modes(&self) -> usize {
        self.eigenvalues_per_s2.len().min(self.modes.shape[0])
    }

    /// The displacement in m at `vertex` under `forces`.
    fn displacement(&self, forces: &[(u32, Vector3<f64>)], vertex: u32) -> Vector3<f64> {
        let along = |mode: usize| -> f64 {
            forces.iter().map(|(v, force)| self.shape(mode, *v).dot(force)).sum()
        };
        let term = |mode| self.shape(mode, vertex) * along(mode) / self.eigenvalues_per_s2[mode];
        (0..self.n_modes()).map(term).sum()
    }

    /// A pull on the vertex that the lowest mode moves furthest, along that motion.
    pub(crate) fn pull(&self, mesh: &TetMesh) -> (u32, Vector3<f64>) {
        let vertices = 0..mesh.vertices().len() as u32;
        let reach = |vertex: &u32| self.shape(0, *vertex).norm();
        let vertex = vertices.max_by(|a, b| reach(a).total_cmp(&reach(b))).unwrap_or(0);
        let direction = self.shape(0, vertex).try_normalize(0.0).unwrap_or(Vector3::x());
        let moved = self.displacement(&[(vertex, direction)], vertex).norm();
        (vertex, direction * (PULL_RATIO * mesh.diagonal() / moved.max(f64::MIN_POSITIVE)))
    }

    /// Forces that pull the two sides of every pair apart, equal and opposite.
    pub(crate) fn gape(&self, mesh: &TetMesh, pairs: &[[u32; 2]]) -> Vec<(u32, Vector3<f64>)> {
        let centres = centres_around(mesh);
        let forces: Vec<(u32, Vector3<f64>)> = pairs
            .iter()
            .flat_map(|&[a, b]| {
                let apart = centres[a as usize] - centres[b as usize];
                let direction = apart.try_normalize(0.0).unwrap_or(Vector3::zeros());
                [(a, direction), (b, -direction)]
            })
            .collect();
        let opening = pairs
            .iter()
            .map(|&[a, b]| (self.displacement(&forces, a) - self.displacement(&forces, b)).norm())
            .fold(0.0, f64::max);
        let scale = OPENING_RATIO * mesh.diagonal() / opening.max(f64::MIN_POSITIVE);
        forces.into_iter().map(|(vertex, force)| (vertex, force * scale)).collect()
    }
}

/// For each vertex the mean of the centres of its tets.
fn centres_around(mesh: &TetMesh) -> Vec<Vector3<f64>> {
    let mut sums = vec![(Vector3::zeros(), 0u32); mesh.vertices().len()];
    for corners in mesh.tets() {
        let positions = corners.map(|v| Vector3::from(mesh.vertices()[v as usize]));
        let centre = positions.iter().sum::<Vector3<f64>>() / 4.0;
        for v in corners {
            let (sum, count) = &mut sums[*v as usize];
            *sum += centre;
            *count += 1;
        }
    }
    sums.into_iter().map(|(sum, count)| sum / f64::from(count.max(1))).collect()
}

/// Loads as the wire wants them.
pub(crate) fn as_forces(loads: &[(u32, Vector3<f64>)], duration_s: f64) -> Vec<Force> {
    let force = |(vertex, force): &(u32, Vector3<f64>)| Force {
        vertex: *vertex,
        force_n: (*force).into(),
        duration_s,
    };
    loads.iter().map(force).collect()
}
