//! The update of an edit outside a seam, for the tolerances that interaction asks for: block Krylov vectors of
//! B = K̂_σ⁻¹M from the base body's modes X, with bounds of what is missing instead of residuals.
//!
//! 1. K_σX = MXΛ_σ, so the first of them cost no more than what stitches add to Woodbury's formula:
//!    X̃ = BXΛ_σ = X − T with T = K_σ⁻¹A(I + C)⁻¹S and S = AᵀX (`start`).
//! 2. Rayleigh–Ritz in [X, X̃]. The Gram matrices of K̂_σ are known, and nothing of the size of the mesh is multiplied but
//!    with M (`space`).
//! 3. Of a Ritz pair's residual all lies in the space but By, y being what the pair has outside of X and of what
//!    B has been applied to. It is M-orthogonal to X, so that ‖By‖² ≤ ‖y‖²_M/λ_σ in the norm of K̂_σ with the
//!    eigenvalue λ_σ of the last mode of X: stitches only stiffen. That bounds the residual without a solve.
//! 4. Where the bound exceeds the tolerance, By joins the space, and 2 and 3 are repeated.
//!
//! It takes as many solves as there are modes that two terms of the series do not suffice for: 9 of 30 on a body of
//! 105 264 unknowns with 30 stitches, where [`flexibility`](super::flexibility) takes one for every mode, half of it for its residual.
//! And none of them has to be exact: what rounding leaves, of a factor in single precision above all, is measured and
//! part of the audit, and eigenvalues are Rayleigh quotients of the vectors returned. Where it leaves too much of a factor in
//! single precision one in double serves; where neither does, and for tolerances below [`least_tolerance`], there is [`flexibility`](super::flexibility).

mod rounding;
mod space;
mod start;

pub use rounding::rounding;

use crate::control::{self, Control, Stage};
use crate::lanes::kernels::Real;
use crate::linalg;
use crate::modes::flexibility::{Update, Updated};
use crate::modes::{AuditedSpectrum, ModesError};
use crate::pool::Tall;
use faer::Mat;
use space::Space;

/// Times that the space grows before the update is left to others.
const MOST_ROUNDS: usize = 7;

/// Share of the tolerance that rounding may take.
const ROUNDING_SHARE: f64 = 0.1;

/// Directions whose squared K̂_σ-length is below this fraction after scaling are dependent.
const DEPENDENT: f64 = 1e-12;

/// Tolerances below are not tried with a factor in these numbers: Gram matrices that are known and not multiplied out are
/// as exact as solves are, and what single precision leaves of them is an estimate. At 1e-6 one residual of a bar was 1.6
/// times what was claimed of it, from 3e-6 on none was more than 0.8 of that.
pub fn least_tolerance<T: Real>() -> f64 {
    if T::IS_NARROW { 1e-5 } else { 1e-6 }
}

/// Computes the modes of the stitched body, if few rounds and solves as exact as these suffice. `rounding` is what a
/// solve leaves of a relative error in the norm of K_σ. `stops_before` a round that refines so many modes takes what
/// there is for the answer.
pub fn update<T: Real>(
    problem: &Update<'_, T>,
    rounding: f64,
    stops_before: &mut dyn FnMut(usize) -> bool,
    control: &dyn Control,
) -> Result<Option<Updated>, ModesError> {
    match attempt(problem, rounding, stops_before, control) {
        // Of numbers beyond a precision's range, say.
        Err(ModesError::Dense(_)) => Ok(None),
        result => result,
    }
}

fn attempt<T: Real>(
    problem: &Update<'_, T>,
    rounding: f64,
    stops_before: &mut dyn FnMut(usize) -> bool,
    control: &dyn Control,
) -> Result<Option<Updated>, ModesError> {
    let Update { sigma, n_rigid_left, eigenvalues, n_modes, tolerance, .. } = *problem;
    let [Some(first), Some(last)] = [eigenvalues.first(), eigenvalues.last()] else {
        return Ok(None);
    };
    if tolerance < least_tolerance::<T>() {
        return Ok(None);
    }
    let mut space = Space::new(problem)?;
    let floor = space.floor(rounding);
    // As much of λ as it is of λ + σ, for the softest mode.
    if is_beyond(floor * (first + sigma) / first, tolerance) {
        return Ok(None);
    }
    for round in 1..=MOST_ROUNDS {
        control::check(control)?;
        control.progress(Stage::Modes, round as f64 / 4.0);
        let (theta, c) = space.ritz()?;
        let available = theta.len().saturating_sub(n_rigid_left).min(eigenvalues.len());
        let wanted = n_modes.min(available);
        let c = c.subcols(n_rigid_left, wanted);
        let kept = &theta[n_rigid_left..][..wanted];
        let missing = space.missing(c, last + sigma)?;
        let residual = |i: usize| missing.length(i) / kept[i].sqrt() + floor.sqrt();
        let residuals: Vec<f64> = (0..wanted).map(residual).collect();
        let beyond = theta.get(n_rigid_left + available).copied().unwrap_or(0.0);
        let spectrum = AuditedSpectrum::of_ritz(kept, beyond, residuals, sigma);
        let unaccepted = spectrum.beyond(tolerance);
        if unaccepted.is_empty() || stops_before(unaccepted.len()) {
            let (shapes, gram) = space.combined_with_gram(c);
            drop(space);
            let updated = finished(problem, shapes, gram, spectrum, round)?;
            let has_changed = updated.spectrum.beyond(tolerance).len() > unaccepted.len();
            return Ok(Some(updated).filter(|_| !has_changed));
        }
        if round == MOST_ROUNDS || !space.grow(&missing, &unaccepted)? {
            break;
        }
    }
    Ok(None)
}

/// Whether an error takes more of the tolerance than rounding may. A NaN does.
fn is_beyond(error: f64, tolerance: f64) -> bool {
    error.is_nan() || error > ROUNDING_SHARE * tolerance
}

/// M-orthonormal modes with their Rayleigh quotients: by how much these differ from the Ritz values, which are those of
/// Gram matrices that were not multiplied out, is an error, too. `gram` is XᵀMX of `shapes`.
fn finished<T: Real>(
    problem: &Update<'_, T>,
    mut shapes: Tall,
    gram: Mat<f64>,
    spectrum: AuditedSpectrum,
    n_rounds: usize,
) -> Result<Updated, ModesError> {
    if linalg::distance_from_identity(gram.as_ref()) > linalg::ORTHONORMAL {
        let whitening = linalg::SmallCholesky::new(gram.as_ref())?.whitening();
        linalg::turn(shapes.as_mut(), whitening.as_ref());
    }
    let stiffness = problem.stitched.gram(shapes.as_ref());
    let quotients: Vec<f64> = (0..stiffness.ncols()).map(|i| stiffness[(i, i)]).collect();
    let off: Vec<f64> = quotients
        .iter()
        .zip(&spectrum.eigenvalues)
        .map(|(quotient, ritz)| (quotient / ritz - 1.0).abs())
        .collect();
    let mut order: Vec<usize> = (0..quotients.len()).collect();
    order.sort_by(|&i, &j| quotients[i].total_cmp(&quotients[j]));
    if !order.is_sorted() {
        shapes = linalg::columns(shapes.as_ref(), &order).into();
    }
    let in_order = |of: &dyn Fn(usize) -> f64| order.iter().map(|&i| of(i)).collect();
    let spectrum = AuditedSpectrum {
        eigenvalues: in_order(&|i| quotients[i]),
        residuals: in_order(&|i| spectrum.residuals[i] + off[i].sqrt()),
        error_estimates: in_order(&|i| spectrum.error_estimates[i] + off[i]),
        angle_estimates: in_order(&|i| spectrum.angle_estimates[i]),
    };
    Ok(Updated { shapes, spectrum, n_rounds })
}
