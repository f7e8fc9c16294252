//! The surface of a body, with its vertices numbered anew: what a viewer needs.

use nalgebra::Vector3;
use sutura_core::mesh::TetMesh;

/// A mode is shown with its largest displacement at this fraction of the body's diagonal.
const SHOWN_FRACTION: f64 = 0.1;

pub(super) struct Shown {
    /// The mesh's vertex for each of the surface's.
    vertices: Vec<u32>,
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    diagonal: f64,
}

impl Shown {
    pub(super) fn of(mesh: &TetMesh) -> Shown {
        let surface = mesh.surface();
        let mut vertices: Vec<u32> = surface.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let number = |v: u32| vertices.partition_point(|&other| other < v) as u32;
        let triangles: Vec<[u32; 3]> = surface.iter().map(|face| face.map(number)).collect();
        let x = |v: u32| Vector3::from(mesh.vertices()[vertices[v as usize] as usize]);
        let mut sums = vec![Vector3::<f64>::zeros(); vertices.len()];
        for &[a, b, c] in &triangles {
            let area = (x(b) - x(a)).cross(&(x(c) - x(a)));
            for corner in [a, b, c] {
                sums[corner as usize] += area;
            }
        }
        let normals = sums
            .iter()
            .map(|sum| {
                let normal = sum.try_normalize(0.0).unwrap_or_else(Vector3::x);
                [0, 1, 2].map(|axis| normal[axis] as f32)
            })
            .collect();
        let positions = (0..vertices.len() as u32)
            .map(|v| {
                let x = x(v);
                [0, 1, 2].map(|axis| x[axis] as f32)
            })
            .collect();
        Shown { vertices, positions, normals, triangles, diagonal: mesh.diagonal() }
    }

    /// What to multiply `shape` (n_vertices × 3) with to show it as a mode.
    pub(super) fn scale(&self, shape: &[f64]) -> f64 {
        let norms = shape.chunks_exact(3).map(|u| u.iter().map(|x| x * x).sum::<f64>().sqrt());
        let largest = norms.fold(0.0, f64::max);
        if largest > 0.0 { SHOWN_FRACTION * self.diagonal / largest } else { 0.0 }
    }

    /// The surface's part of a vector over the vertices, scaled.
    pub(super) fn pick(&self, shape: &[f64], scale: f64) -> Vec<[f32; 3]> {
        let at = |v: u32, axis: usize| (scale * shape[3 * v as usize + axis]) as f32;
        self.vertices.iter().map(|&v| [0, 1, 2].map(|axis| at(v, axis))).collect()
    }

    pub(super) fn positions(&self) -> &[[f32; 3]] {
        &self.positions
    }

    pub(super) fn normals(&self) -> &[[f32; 3]] {
        &self.normals
    }

    pub(super) fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }
}
