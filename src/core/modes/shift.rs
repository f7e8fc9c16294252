//! The shift σ of K_σ = K + σM for bodies with rigid motions.
//!
//! It should be about the first elastic eigenvalue: from 0.1 to 5 times it, one update step reaches
//! 1e-9; a thousand times smaller, the huge rigid components of K_σ⁻¹A drown the elastic ones in
//! rounding and only 1e-3 is left.

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::assembly::sparse::BlockMatrix;
use crate::linalg::{self, DenseError};
use faer::Mat;

/// σ is kept if it lies within these multiples of the first elastic eigenvalue.
pub const GOOD_RATIO: [f64; 2] = [0.1, 5.0];

/// Estimates the first elastic eigenvalue from above: the lowest non-zero Ritz value of cubic
/// displacement fields, over the components that can move rigidly. Bodies held elsewhere may lie
/// far below (51 times, for a plant whose stem is fixed and whose branches are free): the caller
/// checks it against [`GOOD_RATIO`] once the true one is known.
pub fn estimate_first_elastic_eigenvalue(
    model: &FullModel,
    stiffness: &BlockMatrix,
    mass: &Mass,
) -> Result<Option<f64>, DenseError> {
    let mesh = model.mesh();
    let mut lowest: Option<f64> = None;
    for component in 0..mesh.n_components() as u32 {
        let inside = |v: u32| mesh.component_of_vertex()[v as usize] == component;
        let all: Vec<u32> = (0..mesh.vertices().len() as u32).filter(|&v| inside(v)).collect();
        let free: Vec<usize> = all.iter().filter_map(|&v| model.free_index(v)).collect();
        if free.len() < all.len() || free.len() < 5 {
            continue;
        }
        let (centre, radius) = centre_and_radius(&all, mesh.vertices());
        let powers: Vec<[i32; 3]> = (0..64)
            .map(|i| [i % 4, i / 4 % 4, i / 16])
            .filter(|p| p.iter().sum::<i32>() <= 3)
            .collect();
        let mut fields = Mat::zeros(model.n(), 3 * powers.len());
        for (&v, &index) in all.iter().zip(&free) {
            let x = mesh.vertices()[v as usize];
            let s: [f64; 3] = std::array::from_fn(|i| (x[i] - centre[i]) / radius);
            for (j, p) in powers.iter().enumerate() {
                let value = s[0].powi(p[0]) * s[1].powi(p[1]) * s[2].powi(p[2]);
                for axis in 0..3 {
                    fields[(3 * index + axis, 3 * j + axis)] = value;
                }
            }
        }
        let fields = mass.orthonormalize(fields.as_ref(), 1e-12)?;
        let projected = linalg::gram(fields.as_ref(), stiffness.multiply(fields.as_ref()).as_ref());
        let (values, _) = linalg::symmetric_eigen(projected.as_ref())?;
        // The first six are the rigid motions, which cubic fields contain exactly.
        if let Some(&first) = values.get(6).filter(|v| **v > 0.0) {
            lowest = Some(lowest.map_or(first, |l: f64| l.min(first)));
        }
    }
    Ok(lowest)
}

fn centre_and_radius(vertices: &[u32], positions: &[[f64; 3]]) -> ([f64; 3], f64) {
    let n = vertices.len() as f64;
    let centre: [f64; 3] = std::array::from_fn(|axis| {
        vertices.iter().map(|&v| positions[v as usize][axis]).sum::<f64>() / n
    });
    let radius = vertices
        .iter()
        .map(|&v| {
            (0..3).map(|i| (positions[v as usize][i] - centre[i]).powi(2)).sum::<f64>().sqrt()
        })
        .fold(0.0, f64::max);
    (centre, radius)
}
