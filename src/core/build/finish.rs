//! The second half of every build and rebuild: basis, cubature, reduced model.

use super::StageClock;
use super::artifacts::{Artifacts, CubatureReport, CubatureSource, Origin, Prepared};
use super::certificate::Verdict;
use super::params::{BuildError, CubatureParams};
use super::span::{Span, Subspace};
use crate::control::{self, Cancelled, Control, Stage};
use crate::cubature::poses::{PoseSource, Shapes};
use crate::cubature::{self, EnergyNorm, Rule, Samples, Training};
use crate::dictionary::Combination;
use crate::edit::EditState;
use crate::linalg;
use crate::modes::AuditedSpectrum;
use crate::modes::stitched::StitchMatrix;
use crate::pool;
use crate::reduced::{self, FreeBody, Whole};
use faer::Mat;
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// Poses for validation: this share of the training poses, and at least so many.
const VALIDATION_SHARE: f64 = 0.2;
const LEAST_VALIDATION_POSES: usize = 10;

/// Validation poses come from another stream than training poses.
const VALIDATION_SEED: u64 = 0x9e37_79b9_7f4a_7c15;

/// Poses beyond the training poses that smoothing is fitted to, as a share of them, from a stream of their own: it has
/// thirteen numbers a point. With training poses alone held-out errors were 5.2 % instead of 4.6 % on the stomach.
const SMOOTHING_SHARE: f64 = 0.5;
const SMOOTHING_SEED: u64 = 0xbb67_ae85_84ca_a73b;

/// A rule whose error grew by no more than this since its training is as good as it was: the error
/// itself is known only to about a sixth, from a score of validation poses.
const REUSING_FACTOR: f64 = 1.25;

/// A rule that even its own training left above the tolerance is replaced after an edit only if it
/// has become worse than that by this factor: training anew costs more than the rest of an edit.
const RETRAINING_FACTOR: f64 = 2.0;

/// A smoothed rule that is worse than what suffices by more than this factor is not fitted anew: other points are chosen at
/// once. Fitting brought 6.7 % down to 1.8 (fork), but 11.1 to 8.0 (stomach), 44 and 204 to 15 (ball).
const REFITTING_FACTOR: f64 = 2.0;

/// Share of the training poses that weights are refitted to where points are not smoothed: every pose gives one equation for each
/// basis column, and the points are already chosen.
///
/// Held-out errors after edits of the small plant: 11.3 % as they were, 5.9, 5.3, 5.0 % refitted to 0.2, 0.4
/// and all of them; 23.0, then 3.5, 2.9, 2.8 %. On the stomach (105 264 unknowns) refitting seldom helps: 11.6,
/// then 12.9, 11.6, 11.2 %, for about as much time as the rest of such an edit takes. So half of the share goes first.
const REFITTING_SHARE: f64 = 0.4;

/// Loads under which a rule is looked at that an edit has made worse or that was refitted, and the stream that they
/// come from: as many as forces are made for at a time. A rule that is as good as it was is kept without; for the others static
/// solutions and what is left of the loads took 17 to 19 ms (105 264 unknowns).
const N_LOADS: usize = 8;
const LOAD_SEED: u64 = 0x6a09_e667_f3bc_c908;

/// What a refitted rule may leave of a load in its equilibrium. Refitted rules left 0.36 to 0.6 on the plant, where static
/// displacements were wrong by 13 to 40 %, and 0.1 to 0.22 on fork, dinosaur and small stomach, where they were not;
/// rules trained for their basis left 0.04 to 0.37.
const MOST_UNBALANCED: f64 = 0.3;

/// Relative residual of a modal derivative above which the caller is told.
const DERIVATIVE_RESIDUAL_LIMIT: f64 = 1e-4;

/// A generation up to its derivatives.
pub(super) struct Draft {
    pub(super) prepared: Arc<Prepared>,
    pub(super) state: EditState,
    pub(super) n_rigid_modes: usize,
    pub(super) spectrum: AuditedSpectrum,
    pub(super) verdict: Verdict,
    /// Relative eigenvalue error asked for, if any.
    pub(super) tolerance: Option<f64>,
    /// Eigenvalues by which the modes are weighed; not always their own.
    pub(super) weighing: Vec<f64>,
    pub(super) span: Span,
    /// Worst relative residual of the derivatives.
    pub(super) derivative_residual: f64,
    /// Cubature rules to reuse, that in use first, and their validation errors when they were trained.
    pub(super) reuse: Vec<(Rule, f64)>,
    pub(super) warnings: Vec<String>,
}

/// Completes a draft.
pub(super) fn finish(draft: Draft, mut clock: StageClock<'_>) -> Result<Artifacts, BuildError> {
    let Draft { prepared, state, weighing, derivative_residual, mut warnings, .. } = draft;
    let params = &prepared.params;
    if derivative_residual > DERIVATIVE_RESIDUAL_LIMIT {
        warnings.push(format!(
            "modal derivatives have a relative residual of {derivative_residual:.1e}"
        ));
    }
    let subspace = draft.span.reduce(&prepared, &state.open_stitches(), &weighing)?;
    let size = subspace.basis.n_columns();
    if size < params.basis_size {
        warnings.push(format!(
            "the basis has {size} columns instead of {}: modes and derivatives span no more",
            params.basis_size
        ));
    }
    if !subspace.is_finite() {
        return Err(BuildError::NonFinite { what: "the basis" });
    }
    clock.finish(Stage::Basis)?;

    let stitch_stiffness = stitch_stiffness(&prepared, &subspace);
    let basis = &subspace.basis;
    let (Fitted { rule, trained_error, begun_from }, cubature) = match &params.cubature {
        None => {
            // As with a rule: whether rows come from these columns or from what they are combined of shows
            // in their last bits.
            subspace.basis.dense();
            let rule = Rule::exact(prepared.model.corners().len());
            (Fitted { rule, trained_error: 0.0, begun_from: None }, None)
        }
        Some(cubature) => {
            let fit = Fit::new(&prepared, &subspace, &stitch_stiffness, &weighing, cubature)?;
            let (fitted, report) = fit.rule(draft.reuse, &mut clock)?;
            if report.validation_error > cubature.tolerance {
                warnings.push(format!(
                    "the cubature's relative force error is {:.1e}, above the tolerance of {:.1e}: \
                     more points would help",
                    report.validation_error, cubature.tolerance
                ));
            }
            (fitted, Some(report))
        }
    };
    clock.finish(Stage::Cubature)?;

    let model = reduced::reduced_model(
        &prepared.model,
        &rule,
        basis,
        Whole {
            stitch_stiffness,
            gravity: reduced::gravity_loads(&prepared.model, basis),
            free: free_body(&prepared, basis, draft.n_rigid_modes),
        },
        params.damping,
        draft.n_rigid_modes,
    );
    clock.finish(Stage::Reduction)?;
    Ok(Artifacts {
        origin: Origin { reuse: begun_from, ..Origin::built(clock.skipped) },
        closings: Vec::new(),
        earlier: Vec::new(),
        n_rigid_modes: draft.n_rigid_modes,
        verdict: draft.verdict,
        tolerance: draft.tolerance,
        is_unfinished: clock.is_unfinished,
        spectrum: draft.spectrum,
        modes: subspace.modes,
        basis: subspace.basis,
        rule,
        cubature,
        trained_error,
        model: Arc::new(model),
        surface: OnceLock::new(),
        timings: clock.timings,
        prepared,
        state,
        warnings,
    })
}

/// The inertia of a body that nothing holds: its six rigid motions are those of the whole.
pub(super) fn free_body(
    prepared: &Prepared,
    basis: &Combination,
    n_rigid_modes: usize,
) -> Option<Arc<FreeBody>> {
    let is_free = n_rigid_modes == 6 && prepared.state.fixed_vertices().is_empty();
    let free = || Arc::new(reduced::free_body(&prepared.model, &prepared.mass, basis.dense()));
    is_free.then(free)
}

/// Reduced stiffness of all stitches (r×r). Cubature knows of tets alone: to it those that the base body holds are
/// stitches as others.
fn stitch_stiffness(prepared: &Prepared, subspace: &Subspace) -> Mat<f64> {
    let folded = StitchMatrix::new(&prepared.model, &prepared.state.folded_stitches());
    let folded = folded.transpose_times_combination(&subspace.basis);
    let stretch = linalg::stacked(&[subspace.stretch.as_ref(), folded.as_ref()]);
    linalg::gram(stretch.as_ref(), stretch.as_ref())
}

/// The poses of a cubature rule.
pub struct Examined<'a> {
    /// Those that points are chosen by.
    pub training: Samples<'a>,
    /// Those that smoothing is fitted to beside them.
    pub more: Samples<'a>,
    /// Those that it is judged by.
    pub held_out: Samples<'a>,
}

/// What the cubature rule of a draft would be fitted to, and what it would be judged by, for `examine`.
pub(super) fn examined<T>(
    draft: Draft,
    cubature: &CubatureParams,
    control: &dyn Control,
    examine: impl FnOnce(Examined<'_>) -> T,
) -> Result<T, BuildError> {
    let Draft { prepared, state, weighing, span, .. } = draft;
    let subspace = span.reduce(&prepared, &state.open_stitches(), &weighing)?;
    let stitches = stitch_stiffness(&prepared, &subspace);
    let fit = Fit::new(&prepared, &subspace, &stitches, &weighing, cubature)?;
    let CubatureParams { n_training_poses, seed, .. } = *cubature;
    let n_more = n_smoothing_poses(n_training_poses);
    let n_held_out = n_validation(n_training_poses);
    Ok(examine(Examined {
        training: fit.samples(n_training_poses, seed, control)?,
        more: fit.samples(n_more, seed ^ SMOOTHING_SEED, control)?,
        held_out: fit.samples(n_held_out, seed ^ VALIDATION_SEED, control)?,
    }))
}

fn n_smoothing_poses(n_training_poses: usize) -> usize {
    (SMOOTHING_SHARE * n_training_poses as f64).ceil() as usize
}

fn n_validation(n_training_poses: usize) -> usize {
    ((VALIDATION_SHARE * n_training_poses as f64) as usize).max(LEAST_VALIDATION_POSES)
}

/// A cubature rule.
struct Fitted {
    rule: Rule,
    /// Its validation error when it was trained.
    trained_error: f64,
    /// That of the rules to reuse which it began from.
    begun_from: Option<(Rule, f64)>,
}

/// Everything a cubature rule is fitted to.
struct Fit<'a> {
    prepared: &'a Prepared,
    basis: &'a Combination,
    /// Reduced stiffness at rest, stitches included (r×r).
    stiffness: Mat<f64>,
    /// That of the stitches (r×r).
    stitches: &'a Mat<f64>,
    norm: EnergyNorm,
    poses: PoseSource<'a>,
    params: &'a CubatureParams,
}

impl<'a> Fit<'a> {
    fn new(
        prepared: &'a Prepared,
        subspace: &'a Subspace,
        stitches: &'a Mat<f64>,
        eigenvalues: &'a [f64],
        params: &'a CubatureParams,
    ) -> Result<Fit<'a>, BuildError> {
        let Subspace { basis, stretch, stiffness, .. } = subspace;
        let mut reduced_stiffness = linalg::gram(stretch.as_ref(), stretch.as_ref());
        match stiffness {
            Some(stiffness) => reduced_stiffness += stiffness,
            None => reduced_stiffness += prepared.stiffness.gram(basis.dense()),
        }
        let shapes = Shapes {
            modes: subspace.of_modes.clone(),
            eigenvalues,
            derivatives: subspace.of_derivatives.clone(),
            pairs: &subspace.pairs,
            diagonal_m: prepared.model.mesh().diagonal(),
        };
        let norm = EnergyNorm::new(reduced_stiffness.as_ref())?;
        // Forces at the poses take it. Made before the probes of the poses, which are its rows then.
        basis.dense();
        let poses = PoseSource::new(shapes, basis);
        Ok(Fit { prepared, basis, stiffness: reduced_stiffness, stitches, norm, poses, params })
    }

    /// How far the body is from an equilibrium where `rule` finds one: the force that is left over, relative to the
    /// load, the median over some loads that act on all modes about equally.
    ///
    /// Held-out poses do not tell it. In an equilibrium stiff directions are relaxed, so what a rule gets wrong there
    /// is small beside the forces of a pose and large beside a load: a rule of 4 % held-out error refitted on the plant
    /// left 0.5 of the load and static displacements wrong by 13 to 40 %, one trained for that basis 0.25 and 5 to 7 %.
    fn unbalanced(&self, rule: &Rule) -> f64 {
        let r = self.basis.n_columns();
        let poses = self.poses.linear_poses(N_LOADS, self.params.seed ^ LOAD_SEED);
        let loads = linalg::small_product(self.stiffness.as_ref(), poses.as_ref());
        let whole = Whole {
            stitch_stiffness: self.stitches.clone(),
            gravity: Mat::zeros(r, 3),
            free: None,
        };
        let model = &self.prepared.model;
        let damping = self.prepared.params.damping;
        let reduced = reduced::reduced_model(model, rule, self.basis, whole, damping, 0);
        let rest = vec![0.0; r];
        let found: Vec<(usize, Vec<f64>)> = (0..N_LOADS)
            .into_par_iter()
            .filter_map(|i| Some((i, reduced.solve_static(loads.col_as_slice(i), &rest).ok()?)))
            .collect();
        let q = Mat::from_fn(r, found.len(), |i, j| found[j].1[i]);
        let loads = Mat::from_fn(r, found.len(), |i, j| loads[(i, found[j].0)]);
        let mut gap = model.reduced_forces(self.basis.dense(), q.as_ref());
        gap += linalg::small_product(self.stitches.as_ref(), q.as_ref());
        gap -= &loads;
        let [gaps, sizes] = [&gap, &loads].map(|forces| self.norm.lengths(forces.as_ref()));
        let mut all: Vec<f64> = gaps.iter().zip(&sizes).map(|(gap, size)| gap / size).collect();
        // Where the rule has no equilibrium at all.
        all.resize(N_LOADS, f64::INFINITY);
        all.sort_unstable_by(f64::total_cmp);
        all[N_LOADS / 2]
    }

    fn samples(
        &self,
        count: usize,
        seed: u64,
        control: &dyn Control,
    ) -> Result<Samples<'_>, Cancelled> {
        self.samples_at(self.poses.random_poses(count, seed), control)
    }

    fn samples_at(&self, poses: Mat<f64>, control: &dyn Control) -> Result<Samples<'_>, Cancelled> {
        Samples::new(&self.prepared.model, self.basis, &self.norm, poses, control)
    }

    /// The rule in use from now on. Of those in `reuse` the first is kept if it is as good on held-out poses as it was when it
    /// was trained, or else the one that errs least while its error is acceptable and it finds equilibria; it is fitted
    /// anew, smoothing and weights or weights alone, and replaced where that does not serve.
    ///
    /// Weights alone make a smoothed rule hardly better: 8.4 and 8.2 % after an edit of the stomach.
    fn rule(
        &self,
        reuse: Vec<(Rule, f64)>,
        clock: &mut StageClock<'_>,
    ) -> Result<(Fitted, CubatureReport), BuildError> {
        let control = clock.control;
        let CubatureParams { n_points, n_training_poses, tolerance, seed, selection, smoothing } =
            *self.params;
        control::check(control)?;
        let samples = |count: usize, seed: u64| self.samples(count, seed, control);
        // What follows is where a build takes most memory. An edit is followed by others, which use it again.
        let is_build = reuse.is_empty();
        let make_room = || {
            if is_build {
                pool::clear();
            }
        };
        make_room();
        let n_validation = n_validation(n_training_poses);
        let begin = control.now();
        let validation = samples(n_validation, seed ^ VALIDATION_SEED)?;
        let report = |rule: &Rule, source| CubatureReport {
            n_points: rule.tets.len(),
            source,
            validation_error: validation.error(rule),
        };
        let n_more = n_smoothing_poses(n_training_poses);
        // What is to be smoothed anew, and the error up to which that serves.
        let mut worse = None;
        let mut source = CubatureSource::Trained;
        let mut begun_from = None;
        if let Some((old, reused, trained_error)) = least_wrong(reuse, &report) {
            source = CubatureSource::Retrained;
            begun_from = Some((old.clone(), trained_error));
            let as_good = REUSING_FACTOR * trained_error;
            let acceptable = tolerance.max(RETRAINING_FACTOR * trained_error);
            // What follows takes the forces of so many more poses, and about as long again to solve or to fit.
            let pose_time = clock.control.now().saturating_sub(begin) / n_validation as u32;
            let mut skips = |n_poses: usize| clock.skips(2 * pose_time * n_poses as u32);
            let is_within = match smoothing {
                true => reused.validation_error <= acceptable,
                false => reused.validation_error <= tolerance.max(as_good),
            };
            let n_poses = match smoothing {
                true => n_training_poses + n_more,
                false => (REFITTING_SHARE * n_training_poses as f64).ceil() as usize,
            };
            if reused.validation_error <= as_good
                || is_within && (skips(N_LOADS) || self.is_balanced(&old))
                || skips(n_poses)
            {
                return Ok((Fitted { rule: old, trained_error, begun_from }, reused));
            }
            if smoothing {
                let enough = tolerance.max(as_good);
                let may_serve = reused.validation_error <= REFITTING_FACTOR * enough;
                worse = may_serve.then_some((old, enough));
            } else {
                let poses = self.poses.random_poses(n_poses, seed);
                let (rule, best) = self.refitted(old, reused, &report, poses, control)?;
                let is_acceptable = best.validation_error <= acceptable;
                if is_acceptable && (skips(N_LOADS) || self.is_balanced(&rule))
                    || skips(n_training_poses)
                {
                    return Ok((Fitted { rule, trained_error, begun_from }, best));
                }
            }
        }
        control.progress(Stage::Cubature, 0.1);
        make_room();
        let training = samples(n_training_poses, seed)?;
        make_room();
        let smoothed = |rule: Rule, suffices: &dyn Fn(&Rule) -> bool| {
            let more = || samples(n_more, seed ^ SMOOTHING_SEED).inspect(|_| make_room());
            cubature::smooth(rule, training.clone(), more, tolerance, suffices, control)
        };
        if let Some((old, enough)) = worse {
            // Weights first: they find at once what a step of both goes far for. Where some rounds do not suffice, other
            // points come next.
            let rule = smoothed(cubature::refit(&training, &old, control)?, &|_| true)?;
            let refitted = report(&rule, CubatureSource::Refitted);
            if refitted.validation_error <= enough && self.is_balanced(&rule) {
                let trained_error = refitted.validation_error;
                return Ok((Fitted { rule, trained_error, begun_from }, refitted));
            }
        }
        let wanted = Training { selection, n_points, tolerance, seed };
        let mut rule = cubature::train(&training, &wanted, control)?;
        if smoothing {
            rule = smoothed(rule, &|rule| validation.error(rule) <= tolerance)?;
        }
        let report = report(&rule, source);
        let trained_error = report.validation_error;
        Ok((Fitted { rule, trained_error, begun_from }, report))
    }

    /// `old` with its weights fitted to half of `poses`, and where that lowers the error that `report` finds to all of
    /// them; `old` itself, reported of as `reused`, where it does not.
    fn refitted(
        &self,
        old: Rule,
        reused: CubatureReport,
        report: &dyn Fn(&Rule, CubatureSource) -> CubatureReport,
        poses: Mat<f64>,
        control: &dyn Control,
    ) -> Result<(Rule, CubatureReport), Cancelled> {
        let [some, others] = poses.as_ref().split_at_col(poses.ncols().div_ceil(2)).into();
        let some = self.samples_at(some.to_owned(), control)?;
        let fitted_to = |samples: &Samples<'_>| -> Result<_, Cancelled> {
            let rule = cubature::refit(samples, &old, control)?;
            let refitted = report(&rule, CubatureSource::Refitted);
            Ok((rule, refitted))
        };
        let gains = |refitted: &CubatureReport| refitted.validation_error < reused.validation_error;
        let mut fitted = fitted_to(&some)?;
        // Where half of the poses gain nothing, the others hardly would.
        if gains(&fitted.1) && others.ncols() > 0 {
            let all = some.with(self.samples_at(others.to_owned(), control)?);
            fitted = fitted_to(&all)?;
        }
        Ok(if gains(&fitted.1) { fitted } else { (old, reused) })
    }

    fn is_balanced(&self, rule: &Rule) -> bool {
        self.unbalanced(rule) <= MOST_UNBALANCED
    }
}

/// The first of `rules` if it is as good as it was, or else the one of the smallest error, with what is reported of it and its
/// error when it was trained.
fn least_wrong(
    rules: Vec<(Rule, f64)>,
    report: &dyn Fn(&Rule, CubatureSource) -> CubatureReport,
) -> Option<(Rule, CubatureReport, f64)> {
    let mut least: Option<(Rule, CubatureReport, f64)> = None;
    for (rule, trained_error) in rules {
        let found = report(&rule, CubatureSource::Reused);
        let error = |report: &CubatureReport| report.validation_error;
        let is_kept = least.is_none() && error(&found) <= REUSING_FACTOR * trained_error;
        if least.as_ref().is_none_or(|(_, least, _)| error(&found) < error(least)) {
            least = Some((rule, found, trained_error));
        }
        if is_kept {
            break;
        }
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::{BuildParams, MassKind, RayleighDamping, first_draft};
    use crate::control::Uncontrolled;
    use crate::material::Material;
    use crate::testing::{Bar, Cell, Cut};

    #[test]
    fn a_rule_leaves_of_a_load_what_its_points_do_not_see() {
        let bar =
            Bar { size_m: [0.2, 0.05, 0.05], n_cells: [6, 2, 2], cell: Cell::Six, cut: Cut::Whole }
                .mesh();
        let cubature = CubatureParams {
            n_points: 40,
            n_training_poses: 20,
            tolerance: 0.05,
            seed: 1,
            selection: Default::default(),
            smoothing: true,
        };
        let params = BuildParams {
            materials: vec![Material::stvk(5e5, 0.4, 1000.0).unwrap()],
            tet_stiffness: [].into(),
            fixed_vertices: bar.root.clone(),
            mass: MassKind::Lumped,
            n_modes: 10,
            basis_size: 16,
            pca: Default::default(),
            n_derivative_modes: 4,
            cubature: Some(cubature),
            damping: RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 },
            seams: Vec::new(),
        };
        let mut clock = StageClock::start(&Uncontrolled);
        let draft = first_draft(bar.mesh, &params, &[], &mut clock).unwrap();
        let Draft { prepared, state, weighing, span, .. } = draft;
        let subspace = span.reduce(&prepared, &state.open_stitches(), &weighing).unwrap();
        let stitches = stitch_stiffness(&prepared, &subspace);
        let fit = Fit::new(&prepared, &subspace, &stitches, &weighing, &cubature).unwrap();
        let n_tets = prepared.model.corners().len();
        let all = fit.unbalanced(&Rule::exact(n_tets));
        assert!(all < 1e-6, "{all:e}");
        let (trained, _) = fit.rule(Vec::new(), &mut clock).unwrap();
        let left = fit.unbalanced(&trained.rule);
        assert!(left < MOST_UNBALANCED, "{left}");
        // Half of the body has no points.
        let half = n_tets as u32 / 2;
        let blind = Rule::of_tets((0..half).collect(), vec![2.0; half as usize]);
        let left = fit.unbalanced(&blind);
        assert!(left > MOST_UNBALANCED, "{left}");
    }
}
