//! Edits outside a seam: modes and derivatives with columns of the size of the mesh.

use super::StageClock;
use super::artifacts::Prepared;
use super::certificate::Verdict;
use super::derive::{Body, new_derivatives, rounded_derivatives};
use super::finish::Draft;
use super::params::BuildError;
use super::single::Single;
use super::span::{DerivativeSet, Span};
use super::update::rigid_left;
use crate::assembly::mass::Mass;
use crate::control::{self, Stage};
use crate::cubature::Rule;
use crate::derivatives::{self, SOLVE_TOLERANCE};
use crate::edit::EditState;
use crate::lanes::kernels::Real;
use crate::linalg;
use crate::modes::flexibility::{self, Update, Updated};
use crate::modes::low_rank::{self, MassInverse};
use crate::modes::stitched::StitchedStiffness;
use crate::modes::{self, AuditedSpectrum, LinearModes, series};
use crate::pool::Tall;
use faer::Mat;
use std::sync::Arc;

/// What a solve in double precision leaves at most of a relative error in the norm of K_σ, for what can be factorized
/// at all.
const DOUBLE_ROUNDING: f64 = 1e-8;

/// Modes after an edit.
struct Found {
    /// With the eigenvalues to weigh them by.
    modes: LinearModes,
    spectrum: AuditedSpectrum,
    /// Motions that remain rigid (n×k).
    rigid: Mat<f64>,
    warnings: Vec<String>,
}

/// By flexibility to `tolerance`, in single precision where that serves, or by the low-rank update if there is none.
pub(super) fn refined(
    prepared: Arc<Prepared>,
    state: EditState,
    reuse: Vec<(Rule, f64)>,
    tolerance: Option<f64>,
    clock: &mut StageClock<'_>,
) -> Result<Draft, BuildError> {
    let base = &*prepared;
    let stitches = state.open_stitches();
    let mut found = None;
    let mut derivatives = None;
    let single = tolerance
        .filter(|tolerance| *tolerance >= series::least_tolerance::<f32>())
        .and_then(|tolerance| Some((tolerance, base.single()?)));
    if let Some((tolerance, Single { factor, rounding })) = single {
        let stitched = StitchedStiffness::new(&base.model, &base.stiffness, factor, &stitches)?;
        found = by_series(base, &stitched, *rounding, tolerance, clock)?;
        // Rigid motions that are left make derivatives a matter of conjugate gradients.
        if let Some(found) = found.as_ref().filter(|_| base.sigma == 0.0) {
            clock.finish(Stage::Modes)?;
            let (eigenvalues, loads) = loads(base, found, clock)?;
            derivatives = Some(rounded_derivatives(&stitched, eigenvalues, loads, clock.control)?);
        }
    }
    let (found, derivatives) = match (found, derivatives) {
        (Some(found), Some(derivatives)) => (found, derivatives),
        (found, _) => {
            let factor = &base.factor;
            let stitched = StitchedStiffness::new(&base.model, &base.stiffness, factor, &stitches)?;
            control::check(clock.control)?;
            let found = match (found, tolerance) {
                (Some(found), _) => found,
                (None, Some(tolerance)) => by_flexibility(base, &stitched, tolerance, clock)?,
                (None, None) => by_low_rank(base, &stitched)?,
            };
            clock.finish(Stage::Modes)?;
            let derivatives = derived(base, &stitched, &found, tolerance.is_some(), clock)?;
            (found, derivatives)
        }
    };
    clock.finish(Stage::Derivatives)?;
    let Found { modes, spectrum, rigid, warnings } = found;
    Ok(Draft {
        state,
        verdict: Verdict::Refined,
        tolerance,
        n_rigid_modes: rigid.ncols(),
        spectrum,
        weighing: modes.eigenvalues,
        derivative_residual: derivatives.residual,
        span: Span::Dense { modes: modes.shapes, derivatives },
        reuse,
        warnings,
        prepared,
    })
}

/// By few solves and bounds, with a factor that leaves `rounding`, if that suffices.
fn by_series<T: Real>(
    base: &Prepared,
    stitched: &StitchedStiffness<'_, T>,
    rounding: f64,
    tolerance: f64,
    clock: &mut StageClock<'_>,
) -> Result<Option<Found>, BuildError> {
    let rigid = rigid_left(stitched.stitch_matrix(), base.rigid())?;
    let problem = problem(base, stitched, rigid.ncols(), tolerance);
    let control = clock.control;
    let updated = series::update(&problem, rounding, &mut stops(base, clock), control)?;
    Ok(updated.map(|updated| Found::of(updated, rigid, tolerance)))
}

/// By the factor in double precision.
fn by_flexibility(
    base: &Prepared,
    stitched: &StitchedStiffness<'_>,
    tolerance: f64,
    clock: &mut StageClock<'_>,
) -> Result<Found, BuildError> {
    if let Some(found) = by_series(base, stitched, DOUBLE_ROUNDING, tolerance, clock)? {
        return Ok(found);
    }
    let rigid = rigid_left(stitched.stitch_matrix(), base.rigid())?;
    let problem = problem(base, stitched, rigid.ncols(), tolerance);
    let control = clock.control;
    let updated = flexibility::update(&problem, &mut stops(base, clock), control)?;
    Ok(Found::of(updated, rigid, tolerance))
}

fn problem<'a, T>(
    base: &'a Prepared,
    stitched: &'a StitchedStiffness<'a, T>,
    n_rigid_left: usize,
    tolerance: f64,
) -> Update<'a, T> {
    Update {
        stitched,
        mass: &base.mass,
        sigma: base.sigma,
        rigid: base.rigid(),
        n_rigid_left,
        base: base.modes(),
        eigenvalues: &base.spectrum.eigenvalues,
        residuals: &base.spectrum.residuals,
        n_modes: base.params.n_modes,
        tolerance,
    }
}

/// Whether there is no time for a round that refines so many modes.
fn stops<'c>(base: &'c Prepared, clock: &'c mut StageClock<'_>) -> impl FnMut(usize) -> bool + 'c {
    |n| clock.skips(base.column_time * (n + base.params.n_modes) as u32)
}

impl Found {
    fn of(updated: Updated, rigid: Mat<f64>, tolerance: f64) -> Found {
        let Updated { shapes, spectrum, .. } = updated;
        let mut warnings = Vec::new();
        let [worst, _] = spectrum.worst_errors();
        if worst > tolerance {
            warnings.push(format!(
                "the lower half of the modes reached a relative eigenvalue error of {worst:.1e}, not \
                 {tolerance:.1e}"
            ));
        }
        let modes = LinearModes { shapes, eigenvalues: spectrum.eigenvalues.clone() };
        Found { modes, spectrum, rigid, warnings }
    }
}

/// The loads of derivatives, and the eigenvalues of the modes that these are of: all pairs of the lowest.
///
/// With 21 derivatives of the six lowest and those of the open body beside them (\[M16\] §4.2.1), static displacements came
/// out 1.2 to 2.7 times as wrong as in a basis from scratch.
fn loads<'f>(
    base: &Prepared,
    found: &'f Found,
    clock: &StageClock<'_>,
) -> Result<(&'f [f64], Tall), BuildError> {
    let LinearModes { shapes, eigenvalues } = &found.modes;
    let count = base.params.n_derivative_modes.min(eigenvalues.len());
    let lowest = shapes.subcols(0, count);
    let loads = derivatives::right_hand_sides(&base.model, lowest, clock.control)?;
    Ok((&eigenvalues[..count], loads))
}

fn derived(
    base: &Prepared,
    stitched: &StitchedStiffness<'_>,
    found: &Found,
    are_accurate: bool,
    clock: &StageClock<'_>,
) -> Result<DerivativeSet, BuildError> {
    let body = Body {
        mass: &base.mass,
        stitched,
        sigma: base.sigma,
        rigid: found.rigid.as_ref(),
        tolerance: SOLVE_TOLERANCE,
    };
    let (eigenvalues, loads) = loads(base, found, clock)?;
    let accurate = are_accurate.then_some(&found.modes);
    new_derivatives(&body, eigenvalues, accurate, loads, clock.control)
}

/// The paper's update (\[M16\] §4.1).
fn by_low_rank(base: &Prepared, stitched: &StitchedStiffness<'_>) -> Result<Found, BuildError> {
    let rigid = rigid_left(stitched.stitch_matrix(), base.rigid())?;
    let modes = low_rank_modes(base, stitched, rigid.ncols(), base.params.n_modes)?;
    // Its eigenvalues can vanish; the true Rayleigh quotients take their place as weights.
    let weighing = rayleigh_quotients(stitched, &modes);
    let residuals = audit(stitched, &base.mass, &modes, base.sigma);
    let LinearModes { shapes, eigenvalues } = modes;
    let spectrum = AuditedSpectrum {
        eigenvalues,
        error_estimates: residuals.clone(),
        angle_estimates: residuals.iter().map(|residual| residual.min(1.0)).collect(),
        residuals,
    };
    let warnings = vec![
        "low_rank treats all higher modes as having no stiffness: its frequencies are those of that \
         approximation, not of the stitched body (see the residuals)"
            .into(),
    ];
    let modes = LinearModes { shapes, eigenvalues: weighing };
    Ok(Found { modes, spectrum, rigid, warnings })
}

/// Relative residuals of modes that come without an audit of their own.
fn audit(
    stitched: &StitchedStiffness<'_>,
    mass: &Mass,
    modes: &LinearModes,
    sigma: f64,
) -> Vec<f64> {
    let shapes = modes.shapes.as_ref();
    let product = stitched.multiply(shapes);
    let residual = modes::residual_vectors(product, mass, shapes, &modes.eigenvalues);
    let energies = stitched.forward(residual.as_ref()).energies();
    modes::relative_residuals(&energies, &modes.eigenvalues, sigma)
}

/// The paper's update, guards included in what it starts from; the motions that remain rigid are
/// its lowest and are left out.
fn low_rank_modes(
    prepared: &Prepared,
    stitched: &StitchedStiffness<'_>,
    n_rigid_left: usize,
    n_modes: usize,
) -> Result<LinearModes, BuildError> {
    let inverse = match prepared.mass_inverse.get() {
        Some(inverse) => inverse,
        None => {
            let made = MassInverse::new(&prepared.mass)
                .map_err(|error| BuildError::of_factorization(error, &prepared.model))?;
            prepared.mass_inverse.get_or_init(|| made)
        }
    };
    let u = linalg::concatenate(&[prepared.rigid(), prepared.modes()]);
    let lambda: Vec<f64> = std::iter::repeat_n(0.0, prepared.rigid().ncols())
        .chain(prepared.spectrum.eigenvalues.iter().copied())
        .collect();
    let a = stitched.stitch_matrix();
    let all = low_rank::update(u.as_ref(), &lambda, a, inverse, n_rigid_left + n_modes)?;
    let count = all.eigenvalues.len().saturating_sub(n_rigid_left);
    let shapes = all.shapes.subcols(n_rigid_left, count);
    // Through the inverse root of a Gram matrix they come orthonormal to 1e-7 only.
    let gram = linalg::SmallCholesky::new(prepared.mass.gram(shapes).as_ref())?;
    Ok(LinearModes {
        shapes: linalg::product(shapes, gram.whitening().as_ref()).into(),
        eigenvalues: all.eigenvalues[n_rigid_left..].to_vec(),
    })
}

/// φᵀK̂φ of M-normalised shapes.
fn rayleigh_quotients(stitched: &StitchedStiffness<'_>, modes: &LinearModes) -> Vec<f64> {
    let product = stitched.multiply(modes.shapes.as_ref());
    linalg::column_products(modes.shapes.as_ref(), product.as_ref())
}
