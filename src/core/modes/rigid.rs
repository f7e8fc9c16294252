//! Rigid motions that the supports allow, and those that the stitches leave.

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::linalg::{self, DenseError};
use faer::{Mat, MatRef};
use nalgebra::Vector3;

/// Squared, relative: a rigid motion that moves the supports by less than 1e-6 of its size is free.
const NULL_SPACE_TOLERANCE: f64 = 1e-12;

/// An M-orthonormal basis (n × n_rigid) of the motions with no strain: six for each component,
/// less what its fixed vertices hold (a body hinged at one vertex keeps three, along a line of
/// fixed vertices one).
pub fn rigid_modes(model: &FullModel, mass: &Mass) -> Result<Mat<f64>, DenseError> {
    let mesh = model.mesh();
    let mut columns: Vec<Mat<f64>> = Vec::new();
    for component in 0..mesh.n_components() as u32 {
        let vertices: Vec<u32> = (0..mesh.vertices().len() as u32)
            .filter(|&v| mesh.component_of_vertex()[v as usize] == component)
            .collect();
        let x = |v: u32| Vector3::from(mesh.vertices()[v as usize]);
        let centre = vertices.iter().map(|&v| x(v)).sum::<Vector3<f64>>() / vertices.len() as f64;
        let radius = vertices.iter().map(|&v| (x(v) - centre).norm()).fold(0.0, f64::max).recip();
        // Translations and rotations about the centre, scaled to unit size on the body.
        let motion = |v: u32, i: usize| match i {
            0..3 => Vector3::ith(i, 1.0),
            _ => Vector3::ith(i - 3, 1.0).cross(&(x(v) - centre)) * radius,
        };
        let mut held = Mat::<f64>::zeros(6, 6);
        let mut n_fixed = 0;
        for &v in vertices.iter().filter(|&&v| model.free_index(v).is_none()) {
            n_fixed += 1;
            for i in 0..6 {
                for j in 0..6 {
                    held[(i, j)] += motion(v, i).dot(&motion(v, j));
                }
            }
        }
        let free = if n_fixed == 0 {
            Mat::<f64>::identity(6, 6)
        } else {
            let (values, vectors) = linalg::symmetric_eigen(held.as_ref())?;
            let count = values.partition_point(|&v| v <= NULL_SPACE_TOLERANCE * f64::from(n_fixed));
            vectors.subcols(0, count).to_owned()
        };
        let mut block = Mat::zeros(model.n(), free.ncols());
        for &v in &vertices {
            let Some(index) = model.free_index(v) else { continue };
            for j in 0..free.ncols() {
                let moved: Vector3<f64> = (0..6).map(|i| motion(v, i) * free[(i, j)]).sum();
                for axis in 0..3 {
                    block[(3 * index + axis, j)] = moved[axis];
                }
            }
        }
        // A component with every vertex fixed contributes nothing.
        if free.ncols() > 0 && vertices.iter().any(|&v| model.free_index(v).is_some()) {
            columns.push(mass.orthonormalize(block.as_ref(), 1e-14)?);
        }
    }
    let views: Vec<MatRef<'_, f64>> = columns.iter().map(|c| c.as_ref()).collect();
    Ok(if views.is_empty() { Mat::zeros(model.n(), 0) } else { linalg::concatenate(&views) })
}

/// The combinations of `rigid` (n × k, M-orthonormal) that stretch no stitch: k × k' with
/// orthonormal columns. `stretch` is AᵀR for unit stiffness (3s × k).
pub fn unstretched(stretch: MatRef<'_, f64>) -> Result<Mat<f64>, DenseError> {
    let k = stretch.ncols();
    if k == 0 || stretch.nrows() == 0 {
        return Ok(Mat::identity(k, k));
    }
    let (values, vectors) = linalg::symmetric_eigen(linalg::gram(stretch, stretch).as_ref())?;
    let floor = 1e-10 * values.last().copied().unwrap_or(0.0);
    let count = values.partition_point(|&v| v <= floor);
    Ok(vectors.subcols(0, count).to_owned())
}
