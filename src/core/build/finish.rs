//! The second half of every build and rebuild: basis, cubature, reduced model.

use super::StageClock;
use super::artifacts::{Artifacts, CubatureReport, CubatureSource, Prepared};
use super::params::{BuildError, CubatureParams};
use crate::basis::{WeightedDerivatives, mass_pca};
use crate::control::{self, Control, Stage};
use crate::cubature::poses::{PoseSource, Shapes};
use crate::cubature::{self, EnergyNorm, Rule, Samples, Training};
use crate::edit::EditState;
use crate::linalg;
use crate::modes::LinearModes;
use crate::modes::stitched::{FlexibilityColumns, StitchMatrix};
use crate::reduced::ReducedModel;
use faer::{Mat, MatRef};
use std::sync::Arc;

/// Poses for validation: this share of the training poses, and at least so many.
const VALIDATION_SHARE: f64 = 0.2;
const LEAST_VALIDATION_POSES: usize = 10;

/// Validation poses come from another stream than training poses.
const VALIDATION_SEED: u64 = 0x9e37_79b9_7f4a_7c15;

/// A rule whose error grew by no more than this since its training is as good as it was: the error
/// itself is known only to about a sixth, from a score of validation poses.
const REUSING_FACTOR: f64 = 1.25;

/// A rule that even its own training left above the tolerance is replaced after an edit only if it
/// has become worse than that by this factor: training anew costs more than the rest of an edit.
const RETRAINING_FACTOR: f64 = 2.0;

/// Share of the training poses that weights are refitted to: every pose gives one equation for each
/// basis column, and the points are already chosen.
const REFITTING_SHARE: f64 = 0.4;

/// Columns of the basis that the stiffness multiplies at a time, for the sake of memory.
const COLUMNS_AT_A_TIME: usize = 16;

/// Relative residual of a modal derivative above which the caller is told.
const DERIVATIVE_RESIDUAL_LIMIT: f64 = 1e-4;

/// Modal derivatives and where they come from.
pub(super) struct DerivativeSet {
    /// n×p.
    pub(super) shapes: Mat<f64>,
    /// The two modes of each.
    pub(super) pairs: Vec<[usize; 2]>,
    /// Their eigenvalues.
    pub(super) eigenvalues: Vec<[f64; 2]>,
    /// Worst relative residual of the solve.
    pub(super) residual: f64,
}

/// A generation up to its derivatives.
pub(super) struct Draft {
    pub(super) prepared: Arc<Prepared>,
    pub(super) columns: FlexibilityColumns,
    pub(super) state: EditState,
    pub(super) n_rigid_modes: usize,
    pub(super) modes: LinearModes,
    /// Eigenvalues by which the modes are weighed; not always their own.
    pub(super) weighing: Vec<f64>,
    pub(super) residuals: Vec<f64>,
    /// The first set belongs to the modes of this generation.
    pub(super) derivatives: Vec<DerivativeSet>,
    /// The cubature rule to reuse, and its validation error when it was trained.
    pub(super) reuse: Option<(Rule, f64)>,
    pub(super) warnings: Vec<String>,
}

/// Completes a draft.
pub(super) fn finish(mut draft: Draft, mut clock: StageClock<'_>) -> Result<Artifacts, BuildError> {
    let prepared = draft.prepared.clone();
    let params = &prepared.params;
    let worst = draft.derivatives.iter().map(|set| set.residual).fold(0.0, f64::max);
    if worst > DERIVATIVE_RESIDUAL_LIMIT {
        draft.warnings.push(format!("modal derivatives have a relative residual of {worst:.1e}"));
    }

    // The modes go by their weights until the end.
    std::mem::swap(&mut draft.modes.eigenvalues, &mut draft.weighing);
    let weighed = &draft.modes;
    let groups: Vec<WeightedDerivatives<'_>> = draft
        .derivatives
        .iter()
        .map(|set| WeightedDerivatives {
            shapes: set.shapes.as_ref(),
            eigenvalues: set.eigenvalues.clone(),
        })
        .collect();
    let (basis, _) = mass_pca(&prepared.mass, weighed, &groups, params.basis_size, params.pca)?;
    if basis.ncols() < params.basis_size {
        draft.warnings.push(format!(
            "the basis has {} columns instead of {}: modes and derivatives span no more",
            basis.ncols(),
            params.basis_size
        ));
    }
    let finite = |m: &Mat<f64>| (0..m.ncols()).all(|j| m.col(j).iter().all(|x| x.is_finite()));
    if !finite(&basis) || !finite(&draft.modes.shapes) {
        return Err(BuildError::NonFinite { what: "the basis" });
    }
    clock.finish(Stage::Basis)?;

    let stretch =
        StitchMatrix::new(&prepared.model, draft.state.stitches()).transpose_times(basis.as_ref());
    let (rule, cubature, trained_error) = match &params.cubature {
        None => (Rule::exact(prepared.model.corners().len()), None, 0.0),
        Some(cubature) => {
            let shapes = Shapes {
                modes: weighed,
                derivatives: draft.derivatives[0].shapes.as_ref(),
                pairs: &draft.derivatives[0].pairs,
                diagonal_m: prepared.model.mesh().diagonal(),
            };
            let fit = Fit {
                prepared: &prepared,
                basis: basis.as_ref(),
                stretch: stretch.as_ref(),
                shapes,
                params: cubature,
            };
            let (rule, report, trained_error) = fit.rule(draft.reuse.take(), clock.control)?;
            if report.validation_error > cubature.tolerance {
                draft.warnings.push(format!(
                    "the cubature's relative force error is {:.1e}, above the tolerance of {:.1e}: \
                     more points would help",
                    report.validation_error, cubature.tolerance
                ));
            }
            (rule, Some(report), trained_error)
        }
    };
    clock.finish(Stage::Cubature)?;

    let model = ReducedModel::new(
        &prepared.model,
        &rule,
        basis.as_ref(),
        stretch.as_ref(),
        params.damping,
        draft.n_rigid_modes,
    );
    clock.finish(Stage::Reduction)?;
    std::mem::swap(&mut draft.modes.eigenvalues, &mut draft.weighing);
    Ok(Artifacts {
        prepared,
        columns: draft.columns,
        state: draft.state,
        n_rigid_modes: draft.n_rigid_modes,
        modes: draft.modes,
        residuals: draft.residuals,
        basis,
        rule,
        cubature,
        trained_error,
        model: Arc::new(model),
        timings: clock.timings,
        warnings: draft.warnings,
    })
}

/// Everything a cubature rule is fitted to.
struct Fit<'a> {
    prepared: &'a Prepared,
    basis: MatRef<'a, f64>,
    /// AᵀU (3s×r).
    stretch: MatRef<'a, f64>,
    shapes: Shapes<'a>,
    params: &'a CubatureParams,
}

impl Fit<'_> {
    /// The rule in use from now on, with its validation error when it was trained. `reuse` is kept
    /// while its error on held-out poses is acceptable, else refitted, else replaced.
    fn rule(
        &self,
        reuse: Option<(Rule, f64)>,
        control: &dyn Control,
    ) -> Result<(Rule, CubatureReport, f64), BuildError> {
        let CubatureParams { n_points, n_training_poses, tolerance, seed, selection } =
            *self.params;
        let Prepared { model, mass, stiffness, .. } = self.prepared;
        let mut reduced_stiffness = linalg::gram(self.stretch, self.stretch);
        for first in (0..self.basis.ncols()).step_by(COLUMNS_AT_A_TIME) {
            let count = COLUMNS_AT_A_TIME.min(self.basis.ncols() - first);
            let product = stiffness.multiply(self.basis.subcols(first, count));
            let mut columns = reduced_stiffness.as_mut().subcols_mut(first, count);
            columns += linalg::gram(self.basis, product.as_ref());
        }
        let norm = EnergyNorm::new(reduced_stiffness.as_ref())?;
        let poses = PoseSource::new(&self.shapes, self.basis, mass);
        control::check(control)?;
        let samples = |count: usize, seed: u64| {
            Samples::new(model, self.basis, &norm, poses.random_poses(count, seed), control)
        };
        let n_validation =
            ((VALIDATION_SHARE * n_training_poses as f64) as usize).max(LEAST_VALIDATION_POSES);
        let validation = samples(n_validation, seed ^ VALIDATION_SEED)?;
        let report = |rule: &Rule, source| CubatureReport {
            n_points: rule.tets.len(),
            source,
            validation_error: validation.error(rule),
        };
        let mut source = CubatureSource::Trained;
        if let Some((old, trained_error)) = reuse {
            let acceptable = tolerance.max(RETRAINING_FACTOR * trained_error);
            let reused = report(&old, CubatureSource::Reused);
            if reused.validation_error <= tolerance.max(REUSING_FACTOR * trained_error) {
                return Ok((old, reused, trained_error));
            }
            let n_poses = (REFITTING_SHARE * n_training_poses as f64).ceil() as usize;
            let refit = cubature::refit(&samples(n_poses, seed)?, &old, control)?;
            let refitted = report(&refit, CubatureSource::Refitted);
            let (rule, best) = if refitted.validation_error < reused.validation_error {
                (refit, refitted)
            } else {
                (old, reused)
            };
            if best.validation_error <= acceptable {
                return Ok((rule, best, trained_error));
            }
            source = CubatureSource::Retrained;
        }
        control.progress(Stage::Cubature, 0.1);
        let training = samples(n_training_poses, seed)?;
        let wanted = Training { selection, n_points, tolerance, seed };
        let rule = cubature::train(&training, &wanted, control)?;
        let report = report(&rule, source);
        let trained_error = report.validation_error;
        Ok((rule, report, trained_error))
    }
}
