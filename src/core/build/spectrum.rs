//! Factorization and lowest modes of a body, with the choice of the shift.

use super::StageClock;
use super::params::BuildError;
use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::assembly::sparse::BlockMatrix;
use crate::control::Stage;
use crate::factorization::{SparseCholesky, SymbolicCholesky, shifted};
use crate::modes::lanczos::{self, AuditedModes, ShiftInvert};
use crate::modes::{LinearModes, shift};
use faer::MatRef;
use std::sync::Arc;

/// Elastic modes computed beyond those kept: the highest of a set are always the least exact, and
/// an update starts from all of them.
pub(super) const GUARD_MODES: usize = 14;

/// A factorization of K + σM with the lowest modes, guards included.
pub(super) struct Spectrum {
    pub(super) factor: SparseCholesky,
    pub(super) sigma: f64,
    /// Guards included, ΦᵀKΦ = Λ.
    pub(super) modes: LinearModes,
    /// Of `modes` ([`AuditedModes::residuals`]).
    pub(super) residuals: Vec<f64>,
}

/// Factorizes, by the analysis of the stiffness's pattern, and finds the lowest elastic modes. A body
/// without rigid motions needs no shift; for the others σ is an estimate of the first elastic
/// eigenvalue, chosen again from the true one if it was far off.
pub(super) fn lowest_spectrum(
    model: &FullModel,
    mass: &Mass,
    stiffness: &BlockMatrix,
    rigid: MatRef<'_, f64>,
    symbolic: Arc<SymbolicCholesky>,
    n_modes: usize,
    clock: &mut StageClock<'_>,
) -> Result<Spectrum, BuildError> {
    let factorize = |sigma: f64| factorized(model, mass, stiffness, symbolic.clone(), sigma);
    let mut sigma = if rigid.ncols() == 0 {
        0.0
    } else {
        match shift::estimate_first_elastic_eigenvalue(model, stiffness, mass)? {
            Some(estimate) => estimate,
            // Only partly held components are free: guess low, the true eigenvalue corrects it.
            None => 1e-6 * mean_eigenvalue(stiffness, mass),
        }
    };
    let mut factor = factorize(sigma)?;
    clock.finish(Stage::Factorization)?;
    let problem = ShiftInvert { factor: &factor, sigma, mass, rigid };
    let AuditedModes { modes, residuals } =
        lanczos::lowest_modes(&problem, n_modes, GUARD_MODES, clock.control)?;
    if modes.eigenvalues.iter().any(|lambda| !lambda.is_finite()) {
        return Err(BuildError::NonFinite { what: "the eigensolver" });
    }
    clock.finish(Stage::Modes)?;
    if let Some(&first) = modes.eigenvalues.first().filter(|first| sigma > 0.0 && **first > 0.0) {
        let [low, high] = shift::GOOD_RATIO;
        if !(low * first..=high * first).contains(&sigma) {
            sigma = first;
            drop(factor);
            factor = factorize(sigma)?;
            clock.finish(Stage::Factorization)?;
        }
    }
    Ok(Spectrum { factor, sigma, modes, residuals })
}

/// K + σM, factorized by the analysis of K's pattern.
pub(super) fn factorized(
    model: &FullModel,
    mass: &Mass,
    stiffness: &BlockMatrix,
    symbolic: Arc<SymbolicCholesky>,
    sigma: f64,
) -> Result<SparseCholesky, BuildError> {
    match sigma {
        0.0 => SparseCholesky::with_symbolic(symbolic, stiffness),
        _ => SparseCholesky::with_symbolic(symbolic, &shifted(stiffness, sigma, mass)),
    }
    .map_err(|error| BuildError::of_factorization(error, model))
}

/// tr(K)/tr(M): the mean eigenvalue, far above the lowest.
fn mean_eigenvalue(stiffness: &BlockMatrix, mass: &Mass) -> f64 {
    let pattern = stiffness.pattern();
    let (mut k, mut m) = (0.0, 0.0);
    for v in 0..pattern.n() {
        if let Some(entry) = pattern.find(v, v as u32) {
            let block = &stiffness.blocks()[entry];
            k += block[0] + block[4] + block[8];
        }
        m += 3.0 * mass.entry(v, v);
    }
    k / m
}
