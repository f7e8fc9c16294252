//! The only orchestrator: [`build`] prepares a body, [`rebuild`] applies edits to it,
//! [`prepare_seams`] makes those edits cheap that can be foreseen.

mod artifacts;
mod base;
mod certificate;
mod close;
mod combination;
mod derive;
mod finish;
mod params;
mod recipe;
mod refined;
mod seams;
mod single;
mod snapshot;
mod span;
mod spectrum;
mod transfer;
mod update;

pub use crate::assembly::mass::MassKind;
pub use crate::basis::PcaMethod;
pub use crate::cubature::Selection;
pub use crate::modes::seams::SeamRecipe;
pub use crate::reduced::RayleighDamping;
pub use artifacts::{Artifacts, CubatureReport, CubatureSource};
pub use base::BaseBody;
pub use certificate::{Certificate, Verdict};
pub use close::{ClosedPair, ClosingReport};
pub use combination::{BasisCombination, BlockName};
pub use finish::Examined;
pub use params::{BuildError, BuildParams, CubatureParams, Derivatives, Method, RebuildParams};
pub use recipe::{Recipe, remake};
pub use seams::{check_seams, prepare_seams};
pub use snapshot::{
    BaseSnapshot, Columns, CubatureSnapshot, GenerationSnapshot, revive, revive_base,
};
pub use transfer::BasisDelta;

use crate::control::{self, Cancelled, Control, Stage};
use crate::cubature::Rule;
use crate::derivatives::{SOLVE_TOLERANCE, right_hand_sides};
use crate::edit::{Edit, EditState, StitchId};
use crate::mesh::TetMesh;
use crate::modes::stitched::{StitchMatrix, StitchedStiffness};
use crate::modes::{AuditedSpectrum, LinearModes};
use crate::pool;
use artifacts::{Origin, Prepared};
use base::{analyse, base_for, bases_before, prepare};
use close::closed_shape;
use derive::{Body, new_derivatives};
use finish::{Draft, finish};
use span::Span;
use spectrum::{Spectrum, lowest_spectrum};
use std::sync::{Arc, Weak};
use std::time::Duration;

/// Measures stages with the caller's clock.
struct StageClock<'a> {
    control: &'a dyn Control,
    last: Duration,
    /// When nothing more is refined.
    deadline: Option<Duration>,
    /// Something was left undone for the deadline's sake.
    is_unfinished: bool,
    /// What was decided before, where it is to be decided again in the same way.
    decided: Option<std::vec::IntoIter<bool>>,
    /// What the deadline was found to leave time for, in order.
    skipped: Vec<bool>,
    timings: Vec<(Stage, Duration)>,
}

impl<'a> StageClock<'a> {
    fn start(control: &'a dyn Control) -> StageClock<'a> {
        StageClock {
            control,
            last: control.now(),
            deadline: None,
            is_unfinished: false,
            decided: None,
            skipped: Vec::new(),
            timings: Vec::new(),
        }
    }

    /// Whether there is no time for something that would only improve the answer and takes about
    /// `estimate`. If so, the answer remains unfinished.
    fn skips(&mut self, estimate: Duration) -> bool {
        let skips = match (&mut self.decided, self.deadline) {
            (Some(decided), _) => decided.next().unwrap_or(false),
            (None, Some(deadline)) => self.control.now() + estimate >= deadline,
            (None, None) => return false,
        };
        self.skipped.push(skips);
        self.is_unfinished |= skips;
        skips
    }

    /// The time since the last call belongs to `stage`.
    fn finish(&mut self, stage: Stage) -> Result<(), Cancelled> {
        let now = self.control.now();
        self.timings.push((stage, now.saturating_sub(self.last)));
        self.last = now;
        self.control.ended(stage);
        control::check(self.control)
    }
}

/// Prepares `mesh`: matrices, factorization, modes, derivatives, basis, cubature, reduced model.
/// Seams are left to [`prepare_seams`].
pub fn build(
    mesh: Arc<TetMesh>,
    params: &BuildParams,
    control: &dyn Control,
) -> Result<Artifacts, BuildError> {
    let mut clock = StageClock::start(control);
    let draft = first_draft(mesh, params, &[], &mut clock)?;
    // What derivatives were solved with is not to be there when cubature takes most memory.
    pool::clear();
    finish(draft, clock)
}

/// Lets `examine` see the poses that a cubature rule for `body` as it is now, from scratch, would be fitted to with
/// these parameters, and the held-out ones that it would be judged by.
pub fn examine_training<T>(
    body: &Artifacts,
    cubature: &CubatureParams,
    control: &dyn Control,
    examine: impl FnOnce(Examined<'_>) -> T,
) -> Result<T, BuildError> {
    let mut clock = StageClock::start(control);
    let draft = from_scratch(body.prepared.clone(), body.state.clone(), &mut clock)?;
    finish::examined(draft, cubature, control, examine)
}

/// A body before its first edit, up to its derivatives. A base body that is among `kin` is not prepared again.
fn first_draft(
    mesh: Arc<TetMesh>,
    params: &BuildParams,
    kin: &[BaseBody],
    clock: &mut StageClock<'_>,
) -> Result<Draft, BuildError> {
    params::check(&mesh, params)?;
    let mut warnings = Vec::new();
    if let Some(first) = mesh.unused_vertices().first() {
        let count = mesh.unused_vertices().len();
        warnings.push(format!(
            "{count} vertices belong to no tet and never move (the first is {first})"
        ));
    }
    let state = EditState::new(mesh, &params.fixed_vertices);
    params::check_seams(state.base(), &params.seams)?;
    let (prepared, derivatives) = match kin.iter().find(|kin| kin.serves(params, state.base())) {
        Some(BaseBody(base)) => {
            let derivatives = seams::base_derivatives(base, clock.control)?;
            clock.finish(Stage::Derivatives)?;
            (base.clone(), derivatives)
        }
        None => prepare(state.base(), params, clock)?,
    };
    let spectrum = prepared.spectrum.lowest(params.n_modes);
    let found = spectrum.eigenvalues.len();
    if found < params.n_modes {
        warnings.push(format!(
            "{} modes were asked for, but the body has only {found}",
            params.n_modes
        ));
    }
    Ok(Draft {
        state,
        n_rigid_modes: prepared.rigid().ncols(),
        weighing: spectrum.eigenvalues.clone(),
        derivative_residual: derivatives.residual,
        span: Span::Dense {
            modes: prepared.modes().subcols(0, found).to_owned().into(),
            derivatives,
        },
        spectrum,
        verdict: Verdict::Rebuilt,
        tolerance: None,
        reuse: Vec::new(),
        warnings,
        prepared,
    })
}

/// Applies `edits` to `previous` and returns the next generation with the names of the stitches
/// made. `previous` is untouched.
///
/// Modes are updated from the *base* body whatever the generation, so rounds of edits accumulate no
/// error (the limit that \[M16\] §6.1 names).
pub fn rebuild(
    previous: &Artifacts,
    edits: &[Edit],
    params: &RebuildParams,
    control: &dyn Control,
) -> Result<(Artifacts, Vec<StitchId>), BuildError> {
    params::check_fraction("tolerance", params.tolerance)?;
    let mut clock = StageClock::start(control);
    clock.deadline = params.deadline.map(|time| clock.last + time);
    let mut closings = Vec::new();
    let (state, ids) = previous.state.apply(edits, |state, edit, pairs, allowed_m| {
        let (mesh, report) =
            closed_shape(&previous.prepared, state, edit, pairs, allowed_m, clock.control)?;
        closings.push(report);
        clock.finish(Stage::Closing)?;
        Ok::<_, BuildError>(mesh)
    })?;
    let base = base_for(previous, state.base(), &mut clock)?;
    let earlier = bases_before(previous, &base);
    let reuse = previous.cubature.map(|_| (previous.rule.clone(), previous.trained_error));
    let RebuildParams { method, tolerance, .. } = *params;
    let derivatives = match method {
        Method::Flexibility => params.derivatives,
        _ => Derivatives::default(),
    };
    let plan = Plan { method, derivatives, tolerance, reuse, seams: None, closings };
    Ok((update_base(base, earlier, state, plan, clock)?, ids))
}

/// Prepares a base body that holds all stitches of `body`. Edits may go on meanwhile.
pub fn prepare_base(body: &Artifacts, control: &dyn Control) -> Result<BaseBody, BuildError> {
    let mut clock = StageClock::start(control);
    base_for(body, body.state.rebased().base(), &mut clock).map(BaseBody)
}

/// `previous` as an update of `base`: the same body, to which edits add less. `None` if edits have come in
/// between after which `base` serves no longer ([`EditState::on_base`]).
pub fn rebase(
    previous: &Artifacts,
    base: &BaseBody,
    control: &dyn Control,
) -> Result<Option<Artifacts>, BuildError> {
    let BaseBody(base) = base;
    let Some(state) = previous.state.on_base(&base.state) else { return Ok(None) };
    let plan = Plan {
        method: Method::Flexibility,
        derivatives: previous.origin.derivatives,
        tolerance: previous.origin.tolerance,
        reuse: previous.cubature.map(|_| (previous.rule.clone(), previous.trained_error)),
        seams: None,
        closings: previous.closings.clone(),
    };
    let earlier = bases_before(previous, base);
    update_base(base.clone(), earlier, state, plan, StageClock::start(control)).map(Some)
}

/// How a generation comes from its base body.
struct Plan {
    method: Method,
    derivatives: Derivatives,
    tolerance: f64,
    /// The cubature rule in use, and its validation error when it was trained.
    reuse: Option<(Rule, f64)>,
    /// The seams that there were when it was made first; `None` for those that there are now.
    seams: Option<Arc<SeamRecipe>>,
    closings: Vec<ClosingReport>,
}

fn update_base(
    base: Arc<Prepared>,
    earlier: Vec<Weak<Prepared>>,
    state: EditState,
    plan: Plan,
    mut clock: StageClock<'_>,
) -> Result<Artifacts, BuildError> {
    let Plan { method, derivatives, tolerance, reuse, seams, closings } = plan;
    let there = || base.known_seams().map(|seams| seams.recipe().clone()).unwrap_or_default();
    let mut origin = Origin {
        method: Some(method),
        derivatives,
        tolerance,
        reuse: None,
        seams: seams.clone().unwrap_or_else(there),
        skipped: Vec::new(),
    };
    let mut rules: Vec<(Rule, f64)> = reuse.into_iter().collect();
    // A generation that is made again reuses what it did then.
    if let Some(closed) =
        base.closed_rule().clone().filter(|_| seams.is_none() && !rules.is_empty())
    {
        rules.push((closed.rule, closed.trained_error));
    }
    let draft = match method {
        Method::FromScratch => from_scratch(base, state, &mut clock)?,
        Method::Flexibility => {
            let seams = match seams {
                Some(recipe) => Some(seams::remake(&base, &recipe, clock.control)?),
                None => base.known_seams(),
            };
            origin.seams = seams.as_ref().map(|seams| seams.recipe().clone()).unwrap_or_default();
            let wanted = update::Wanted { tolerance, derivatives };
            update::by_flexibility(base, state, rules, seams, wanted, &mut clock)?
        }
        Method::LowRank => update::by_low_rank(base, state, rules, &mut clock)?,
    };
    let mut made = finish(draft, clock)?;
    made.origin = Origin { skipped: made.origin.skipped, reuse: made.origin.reuse, ..origin };
    // Time enough is what is assumed where nothing is said.
    while made.origin.skipped.last() == Some(&false) {
        made.origin.skipped.pop();
    }
    made.earlier = earlier;
    made.warnings.extend(closings.iter().map(ClosingReport::warning));
    made.closings = closings;
    Ok(made)
}

/// Everything up to the derivatives, from a factorization of the stitched stiffness itself.
fn from_scratch(
    prepared: Arc<Prepared>,
    state: EditState,
    clock: &mut StageClock<'_>,
) -> Result<Draft, BuildError> {
    let Prepared { params, model, mass, .. } = &*prepared;
    let a = StitchMatrix::new(model, state.stitches());
    let pairs: Vec<[u32; 2]> = state.stitches().iter().map(|s| s.pair).collect();
    let pattern = Arc::new(model.pattern(&pairs));
    let (symbolic, stiffness) = rayon::join(
        || analyse(&pattern, model),
        || {
            let mut stiffness = model.rest_stiffness(&pattern);
            a.add_to(&mut stiffness);
            stiffness
        },
    );
    let symbolic = symbolic?;
    let rigid = update::rigid_left(&a, prepared.rigid())?;
    clock.finish(Stage::Assembly)?;

    let Spectrum { factor, sigma, modes, residuals } =
        lowest_spectrum(model, mass, &stiffness, rigid.as_ref(), symbolic, params.n_modes, clock)?;
    let kept = modes.lowest(params.n_modes);
    let stitched = StitchedStiffness::new(model, &stiffness, &factor, &[])?;
    let rigid_left = rigid.as_ref();
    let tolerance = SOLVE_TOLERANCE;
    let body = Body { mass, stitched: &stitched, sigma, rigid: rigid_left, tolerance };
    let count = params.n_derivative_modes.min(kept.eigenvalues.len());
    let lowest = kept.lowest(count);
    let loads = right_hand_sides(model, lowest.shapes.as_ref(), clock.control)?;
    let set = new_derivatives(&body, &lowest.eigenvalues, Some(&modes), loads, clock.control)?;
    clock.finish(Stage::Derivatives)?;
    let LinearModes { shapes, eigenvalues } = kept;
    let spectrum = AuditedSpectrum::converged(eigenvalues, residuals);
    Ok(Draft {
        state,
        n_rigid_modes: rigid.ncols(),
        weighing: spectrum.eigenvalues.clone(),
        spectrum: spectrum.lowest(params.n_modes),
        derivative_residual: set.residual,
        span: Span::Dense { modes: shapes, derivatives: set },
        verdict: Verdict::Rebuilt,
        tolerance: None,
        reuse: Vec::new(),
        warnings: Vec::new(),
        prepared: prepared.clone(),
    })
}
