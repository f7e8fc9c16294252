//! What a factor leaves of errors.

use crate::assembly::mass::Mass;
use crate::assembly::sparse::BlockMatrix;
use crate::factorization::SparseCholesky;
use crate::lanes::kernels::Real;
use crate::linalg;
use faer::{Mat, MatRef};

/// Modes that are solved for to tell it.
const PROBED: usize = 16;

/// By how much more other right-hand sides may feel it, those that stitches make of them above all: an allowance.
const MARGIN: f64 = 3.0;

/// Relative error of solutions by `factor` in the norm of K_σ, of a body of K, M and σ, with a margin: of the
/// lowest of its `modes` (rigid and elastic ones, n×k each; `eigenvalues` of the elastic ones in 1/s², `sigma` likewise), solved
/// for from their inertial forces. Infinite where there is no solution.
pub fn rounding<T: Real>(
    factor: &SparseCholesky<T>,
    (stiffness, mass, sigma): (&BlockMatrix, &Mass, f64),
    [rigid, elastic]: [MatRef<'_, f64>; 2],
    eigenvalues: &[f64],
) -> f64 {
    let n_rigid = rigid.ncols().min(PROBED);
    let n_elastic = elastic.ncols().min(PROBED - n_rigid);
    let modes = linalg::concatenate(&[rigid.subcols(0, n_rigid), elastic.subcols(0, n_elastic)]);
    let shifted = |j: usize| j.checked_sub(n_rigid).map_or(0.0, |j| eigenvalues[j]) + sigma;
    let mut solved = mass.multiply(modes.as_ref());
    factor.solve_in_place(solved.as_mut());
    let error = Mat::from_fn(modes.nrows(), modes.ncols(), |i, j| {
        shifted(j) * solved[(i, j)] - modes[(i, j)]
    });
    let mut stiff = stiffness.multiply(error.as_ref());
    stiff += faer::Scale(sigma) * mass.multiply(error.as_ref());
    let energies = linalg::column_products(error.as_ref(), stiff.as_ref());
    let relative = |(j, energy): (usize, &f64)| match energy / shifted(j) {
        square if square.is_finite() => square.max(0.0).sqrt(),
        _ => f64::INFINITY,
    };
    MARGIN * energies.iter().enumerate().map(relative).fold(0.0, f64::max)
}
