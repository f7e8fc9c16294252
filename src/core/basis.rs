//! The basis of the subspace: mass-weighted principal component analysis of scaled modes and modal
//! derivatives.
//!
//! Weights are those of \[B12\] eq. 18, λ₁/λ_j on modes and λ₁²/(λ_iλ_j) on derivatives. (\[M16\] §4.2.2
//! prints them the other way up, which would favour high frequencies against the purpose it
//! states.) Derivatives are scaled to unit mass norm first: mass-normalised modes and their
//! derivatives have different units, and which would dominate depended on the unit of length.

use crate::assembly::mass::Mass;
use crate::linalg::{self, DenseError, SmallCholesky};
use crate::modes::LinearModes;
use faer::{Mat, MatRef};

/// A derivative's column together with the eigenvalues of the two modes it belongs to.
pub struct WeightedDerivatives<'a> {
    /// n×p.
    pub shapes: MatRef<'a, f64>,
    /// λ_i and λ_j of each column.
    pub eigenvalues: Vec<[f64; 2]>,
}

/// An M-orthonormal basis (n × at most `size`) and the singular values of the weighted columns
/// (relative to the first), descending.
///
/// The columns are M-orthonormalised unweighted and the small weighted factor is decomposed, so that
/// directions of tiny weight keep their digits; a Gram matrix of the weighted columns would lose
/// everything below 1e-8 of the first.
pub fn mass_pca(
    mass: &Mass,
    modes: &LinearModes,
    derivatives: &[WeightedDerivatives<'_>],
    size: usize,
) -> Result<(Mat<f64>, Vec<f64>), DenseError> {
    let first = modes.eigenvalues.iter().copied().fold(f64::INFINITY, f64::min);
    let mut parts = vec![modes.shapes.as_ref()];
    let mut weights: Vec<f64> = modes.eigenvalues.iter().map(|l| first / l).collect();
    for group in derivatives {
        parts.push(group.shapes);
        weights.extend(group.eigenvalues.iter().map(|[li, lj]| first * first / (li * lj)));
    }
    let columns = linalg::concatenate(&parts);
    let gram = mass.inner(columns.as_ref(), columns.as_ref());

    // Q = DC₁C₂ is M-orthonormal (twice, for rounding), and QᵀMD = C₂ᵀC₁ᵀ(DᵀMD).
    let first_pass = linalg::orthonormal_coefficients(gram.as_ref(), 1e-13)?;
    let y = linalg::product(columns.as_ref(), first_pass.as_ref());
    let second_pass = SmallCholesky::new(mass.inner(y.as_ref(), y.as_ref()).as_ref())?.whitening();
    let mut r = linalg::small_product(
        second_pass.transpose(),
        linalg::small_product(first_pass.transpose(), gram.as_ref()).as_ref(),
    );
    for j in 0..r.ncols() {
        let length = gram[(j, j)].max(0.0).sqrt();
        let factor = if length > 0.0 { weights[j].min(1.0) / length } else { 0.0 };
        (0..r.nrows()).for_each(|i| r[(i, j)] *= factor);
    }
    let (singular, left) = linalg::left_singular(r.as_ref())?;
    let largest = singular.first().copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
    let size = size.min(left.ncols());
    let leading = linalg::small_product(second_pass.as_ref(), left.subcols(0, size));
    let mut basis = linalg::product(y.as_ref(), leading.as_ref());
    for j in 0..size {
        // A sign that does not depend on the decomposition: the largest entry is positive.
        let column = basis.col_as_slice_mut(j);
        let peak = column.iter().fold(0.0f64, |m, x| if x.abs() > m.abs() { *x } else { m });
        if peak < 0.0 {
            column.iter_mut().for_each(|x| *x = -*x);
        }
    }
    Ok((basis, singular.into_iter().map(|s| s / largest).collect()))
}
