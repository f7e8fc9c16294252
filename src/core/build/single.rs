//! The base body's factor in single precision, for edits outside a seam.

use super::artifacts::Prepared;
use crate::factorization::SparseCholesky;
use crate::modes::series;

/// Largest [`Single::rounding`] that is of use: as much error in an eigenvalue as the square of it.
const MOST_ROUNDING: f64 = 1e-2;

/// A factor in single precision.
pub(super) struct Single {
    pub(super) factor: SparseCholesky<f32>,
    /// What a solve with it leaves of relative error in the norm of K_σ ([`series::rounding`]).
    pub(super) rounding: f64,
}

impl Single {
    /// That of `base`, if it is exact enough to be of use.
    pub(super) fn new(base: &Prepared) -> Option<Single> {
        let factor = base.factor.rounded();
        let modes = [base.rigid(), base.modes()];
        let eigenvalues = &base.spectrum.eigenvalues;
        let of_body = (&base.stiffness, &base.mass, base.sigma);
        let rounding = series::rounding(&factor, of_body, modes, eigenvalues);
        (rounding <= MOST_ROUNDING).then_some(Single { factor, rounding })
    }
}
