//! What is worth keeping of a body that is prepared, beside what makes it again ([`super::recipe`]): numbers that took
//! long to find and take up little.
//!
//! A factorization is the other way about: the largest part of a base body, and quickly made again where σ is
//! known. So are the matrices. What seams hold is large too, six columns a pair; whoever edits next gets
//! them prepared anew, as they were.
//!
//! A body that was revived has the bits of the one that was made, in everything that can be asked of it. (The
//! same columns have another name: [`Artifacts::basis_combination`] has a block of its own for them.)

use super::StageClock;
use super::artifacts::{Artifacts, CubatureReport, Origin, Prepared};
use super::base::{self, Assembled, BaseBody, assemble};
use super::certificate::Verdict;
use super::finish::free_body;
use super::params::{self, BuildError, BuildParams};
use super::recipe::{Recipe, check, check_rule};
use super::spectrum::{GUARD_MODES, factorized};
use crate::control::{Control, Stage};
use crate::cubature::Rule;
use crate::dictionary::Combination;
use crate::edit::BaseState;
use crate::linalg;
use crate::modes::AuditedSpectrum;
use crate::reduced::{self, Whole};
use faer::{Mat, MatRef};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// A matrix as plain numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    /// Columns.
    pub n_columns: usize,
    /// Their numbers, one column behind the other, all of them equally long.
    pub values: Vec<f64>,
}

/// What is kept of a base body.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseSnapshot {
    /// σ of the factorized K + σM in 1/s².
    pub sigma_per_s2: f64,
    /// Elastic modes, those beyond the ones asked for included.
    pub modes: Columns,
    /// Their eigenvalues.
    pub eigenvalues_per_s2: Vec<f64>,
    /// Their residuals.
    pub residuals: Vec<f64>,
    /// What a modal derivative took.
    pub column_time: Duration,
}

/// What is kept of a cubature rule.
#[derive(Clone, Debug, PartialEq)]
pub struct CubatureSnapshot {
    /// Tets and weights.
    pub rule: Rule,
    /// What is known of it.
    pub report: CubatureReport,
    /// Its validation error when it was trained.
    pub trained_error: f64,
}

/// What is kept of a generation, beside its recipe and its base body.
#[derive(Clone, Debug)]
pub struct GenerationSnapshot {
    /// Rigid motions that cost no energy, with the stitches in force.
    pub n_rigid_modes: usize,
    /// Eigenvalues with their audit.
    pub spectrum: AuditedSpectrum,
    /// Where the modes come from.
    pub verdict: Verdict,
    /// Whether something was left undone for the deadline's sake.
    pub is_unfinished: bool,
    /// Relative eigenvalue error asked for, if any.
    pub tolerance: Option<f64>,
    /// The modes; `None` if they are the lowest of the base body.
    pub modes: Option<Columns>,
    /// The basis.
    pub basis: Columns,
    /// The cubature rule; `None` if every tet is summed.
    pub cubature: Option<CubatureSnapshot>,
    /// Reduced stiffness of the stitches (r×r).
    pub stitch_stiffness: Columns,
    /// Reduced loads of unit gravity along each axis (r×3).
    pub gravity_loads: Columns,
    /// Time spent in each stage.
    pub timings: Vec<(Stage, Duration)>,
    /// What the caller should know.
    pub warnings: Vec<String>,
}

impl Columns {
    fn of(m: MatRef<'_, f64>) -> Columns {
        let mut values = Vec::with_capacity(m.nrows() * m.ncols());
        m.col_iter().for_each(|column| values.extend(column.iter()));
        Columns { n_columns: m.ncols(), values }
    }

    /// As a matrix of `n_rows`, if it is one of finite numbers.
    fn matrix(&self, n_rows: usize, what: &'static str) -> Result<Mat<f64>, BuildError> {
        if n_rows.checked_mul(self.n_columns) != Some(self.values.len()) {
            return Err(BuildError::Misfit { what });
        }
        finite(&self.values, what)?;
        let mut m = Mat::zeros(n_rows, self.n_columns);
        linalg::for_each_column(m.as_mut(), |j, column| {
            column.copy_from_slice(&self.values[j * n_rows..][..n_rows]);
        });
        Ok(m)
    }
}

fn finite(values: &[f64], what: &'static str) -> Result<(), BuildError> {
    demand(values.iter().all(|x| x.is_finite()), what)
}

fn demand(is_so: bool, what: &'static str) -> Result<(), BuildError> {
    if is_so { Ok(()) } else { Err(BuildError::Misfit { what }) }
}

impl BaseBody {
    /// What is worth keeping of it.
    pub fn snapshot(&self) -> BaseSnapshot {
        let Prepared { sigma, spectrum, column_time, .. } = &*self.0;
        BaseSnapshot {
            sigma_per_s2: *sigma,
            modes: Columns::of(self.0.modes()),
            eigenvalues_per_s2: spectrum.eigenvalues.clone(),
            residuals: spectrum.residuals.clone(),
            column_time: *column_time,
        }
    }
}

impl Artifacts {
    /// What is worth keeping of this generation beside its recipe and its base body.
    pub fn snapshot(&self) -> GenerationSnapshot {
        let modes = || self.modes.with_dense(Columns::of);
        GenerationSnapshot {
            n_rigid_modes: self.n_rigid_modes,
            spectrum: self.spectrum.clone(),
            verdict: self.verdict,
            is_unfinished: self.is_unfinished,
            tolerance: self.tolerance,
            modes: (!self.is_as_built()).then(modes),
            basis: self.basis.with_dense(Columns::of),
            cubature: self.cubature.map(|report| CubatureSnapshot {
                rule: self.rule.clone(),
                report,
                trained_error: self.trained_error,
            }),
            stitch_stiffness: Columns::of(self.model.stitch_stiffness()),
            gravity_loads: Columns::of(self.model.gravity_loads()),
            timings: self.timings.clone(),
            warnings: self.warnings.clone(),
        }
    }
}

/// The base body of `state` and of a build with `params`, of which `kept` was kept: factorized again, without looking
/// for modes. Fails with [`BuildError::Misfit`] if `kept` is of another body.
pub fn revive_base(
    params: &BuildParams,
    state: &BaseState,
    kept: &BaseSnapshot,
    control: &dyn Control,
) -> Result<BaseBody, BuildError> {
    params::check(state.mesh(), params)?;
    let mut clock = StageClock::start(control);
    let assembled = assemble(state, params, &mut clock)?;
    let Assembled { model, mass, stiffness, rigid, symbolic } = &assembled;
    let BaseSnapshot { sigma_per_s2: sigma, modes, eigenvalues_per_s2, residuals, .. } = kept;
    let n_modes = modes.n_columns;
    demand(n_modes <= params.n_modes.saturating_add(GUARD_MODES), "there are too many modes")?;
    demand(eigenvalues_per_s2.len() == n_modes, "modes and eigenvalues differ in number")?;
    demand(residuals.len() == n_modes, "modes and residuals differ in number")?;
    finite(eigenvalues_per_s2, "an eigenvalue is not finite")?;
    finite(residuals, "a residual is not finite")?;
    // A body without rigid motions needs no shift, one with some does.
    let is_shifted = *sigma > 0.0 && sigma.is_finite();
    demand(is_shifted || *sigma == 0.0, "the shift is no shift")?;
    demand(is_shifted == (rigid.ncols() > 0), "the shift is that of another body")?;
    let modes = modes.matrix(model.n(), "the modes are those of another body")?;
    let factor = factorized(model, mass, stiffness, symbolic.clone(), *sigma)?;
    clock.finish(Stage::Factorization)?;
    let spectrum = AuditedSpectrum::converged(eigenvalues_per_s2.clone(), residuals.clone());
    let prepared = assembled.prepared(params, state, (factor, *sigma), modes.into(), spectrum);
    Ok(BaseBody(Arc::new(Prepared { column_time: kept.column_time, ..prepared })))
}

/// The generation of `recipe`, an update of `base`, of which `kept` was kept; without a solve. `kin` are base bodies
/// that later edits may return to. Fails with [`BuildError::Misfit`] if `kept` or `base` belongs to another one.
pub fn revive(
    recipe: &Recipe,
    base: &BaseBody,
    kept: &GenerationSnapshot,
    kin: &[BaseBody],
    control: &dyn Control,
) -> Result<Artifacts, BuildError> {
    let BaseBody(base) = base;
    demand(base.state == *recipe.state.base(), "the base body is another one")?;
    let mut clock = StageClock::start(control);
    let origin = match recipe.method {
        None => Origin::built(recipe.skipped.clone()),
        Some(method) => {
            check(recipe)?;
            Origin {
                method: Some(method),
                derivatives: recipe.derivatives,
                tolerance: recipe.tolerance,
                reuse: recipe.reuse.clone(),
                seams: recipe.seams.clone(),
                skipped: recipe.skipped.clone(),
            }
        }
    };
    let (model, params) = (&base.model, &base.params);
    let n = model.n();
    check_spectrum(&kept.spectrum)?;
    let n_modes = kept.spectrum.eigenvalues.len();
    let modes = match &kept.modes {
        Some(modes) => modes.matrix(n, "the modes are those of another body")?,
        None => {
            demand(n_modes <= base.modes().ncols(), "the base body has fewer modes")?;
            base.modes().subcols(0, n_modes).to_owned()
        }
    };
    demand(modes.ncols() == n_modes, "modes and eigenvalues differ in number")?;
    demand(kept.n_rigid_modes <= base.rigid().ncols(), "there are too many rigid modes")?;
    finite(kept.tolerance.as_slice(), "the tolerance is not finite")?;
    let basis = kept.basis.matrix(n, "the basis is that of another body")?;
    let r = basis.ncols();
    demand(r > 0 && r <= params.basis_size, "the basis has another size")?;
    let stitch_stiffness = kept.stitch_stiffness.matrix(r, "the stitches have another basis")?;
    demand(stitch_stiffness.ncols() == r, "the stitches have another basis")?;
    let gravity = kept.gravity_loads.matrix(r, "gravity has another basis")?;
    demand(gravity.ncols() == 3, "gravity has another number of axes")?;

    let n_tets = model.corners().len();
    let (rule, cubature, trained_error) = match (&kept.cubature, &params.cubature) {
        (None, None) => (Rule::exact(n_tets), None, 0.0),
        (Some(CubatureSnapshot { rule, report, trained_error }), Some(_)) => {
            check_rule(rule, *trained_error, n_tets)?;
            finite(&[report.validation_error], "the cubature's error is not finite")?;
            demand(report.n_points == rule.tets.len(), "the cubature has another rule")?;
            (rule.clone(), Some(*report), *trained_error)
        }
        _ => return Err(BuildError::Misfit { what: "the cubature is of another kind" }),
    };
    let basis = Combination::of_dense(basis);
    let reduced = reduced::reduced_model(
        model,
        &rule,
        &basis,
        Whole { stitch_stiffness, gravity, free: free_body(base, &basis, kept.n_rigid_modes) },
        params.damping,
        kept.n_rigid_modes,
    );
    clock.finish(Stage::Reduction)?;
    Ok(Artifacts {
        prepared: base.clone(),
        earlier: base::others(base, kin),
        state: recipe.state.clone(),
        origin,
        closings: recipe.closings.clone(),
        n_rigid_modes: kept.n_rigid_modes,
        spectrum: kept.spectrum.clone(),
        verdict: kept.verdict,
        is_unfinished: kept.is_unfinished,
        tolerance: kept.tolerance,
        modes: Combination::of_dense(modes),
        basis,
        rule,
        cubature,
        trained_error,
        model: Arc::new(reduced),
        surface: OnceLock::new(),
        timings: kept.timings.clone(),
        warnings: kept.warnings.clone(),
    })
}

fn check_spectrum(spectrum: &AuditedSpectrum) -> Result<(), BuildError> {
    let AuditedSpectrum { eigenvalues, residuals, error_estimates, angle_estimates } = spectrum;
    for values in [residuals, error_estimates, angle_estimates] {
        demand(values.len() == eigenvalues.len(), "the audit is that of other eigenvalues")?;
        // An estimate may be infinite: low_rank has eigenvalues that are none.
        demand(!values.iter().any(|x| x.is_nan()), "an audit is not a number")?;
    }
    finite(eigenvalues, "an eigenvalue is not finite")
}
