//! Seams: what makes an edit cheap, prepared before it comes.

use super::artifacts::{Artifacts, ClosedRule, Prepared};
use super::derive::{Body, new_derivatives};
use super::params::{self, BuildError, Derivatives, Method};
use super::span::{DerivativeSet, combine};
use super::{Plan, StageClock, update_base};
use crate::control::{Control, Stage};
use crate::derivatives::{self, LOAD_CASE_TOLERANCE};
use crate::edit::Stitch;
use crate::modes::LinearModes;
use crate::modes::load_cases::LoadCases;
use crate::modes::prepared::{Coefficients, PreparedStitches};
use crate::modes::seams::{BaseModes, SeamRecipe, Seams};
use crate::modes::stitched::StitchedStiffness;
use crate::pool::{self, Tall};
use std::sync::Arc;

/// Stiffness of the springs that close a seam for its load cases, in N/m, where no stitch in force tells
/// what is used here (\[M16\] §6).
const CLOSING_STIFFNESS_N_M: f64 = 1e5;

/// Relative eigenvalue error of the modes that a cubature rule for closed seams is trained with.
const CLOSED_MODES_TOLERANCE: f64 = 1e-2;

/// Relative residual of load cases that serve one edit alone, where the factor is shifted. Those of the plant and
/// the oball, 15 of whose pairs were stitched, had static errors equal to 3 digits with 1e-10 and 1e-6 and to 0.6 % with 1e-3,
/// and took 0.32, 0.18 and 0.10 s on the plant.
const OWN_CASE_TOLERANCE: f64 = 1e-6;

/// Prepares `pairs` for edits of every generation that shares the base body of `body`: an edit of
/// prepared pairs takes no sparse solve. Edits may go on meanwhile.
///
/// Beside the pairs' own columns this makes load cases: modal derivatives of the body with all prepared
/// pairs closed. What a stitched body's derivatives have in common with those of the open and of
/// the closed body, an edit takes from them. Last comes the cubature rule of the closed body.
pub fn prepare_seams(
    body: &Artifacts,
    pairs: &[[u32; 2]],
    control: &dyn Control,
) -> Result<(), BuildError> {
    let prepared = &body.prepared;
    check_seams(body, pairs)?;
    let mut seams = present(prepared, control)?;
    if seams.is_empty() {
        // Of a body that was read instead of made: as they were.
        seams = remake(prepared, &body.origin.seams, control)?;
    }
    let missing: Vec<[u32; 2]> =
        pairs.iter().copied().filter(|pair| seams.position(*pair).is_none()).collect();
    if !missing.is_empty() {
        let mut clock = StageClock::start(control);
        seams = extend(prepared, &seams, &missing, &body.state.open_stitches(), control)?;
        clock.finish(Stage::Seams)?;
    }
    train_closed(body, &seams, control)
}

/// Trains a cubature rule for `body` with every pair of `seams` closed, unless there is one for half of them: the rule of
/// the open body, or of another state, has to be fitted or chosen anew after many an edit, which takes ten times
/// as long as the rest of it.
fn train_closed(body: &Artifacts, seams: &Seams, control: &dyn Control) -> Result<(), BuildError> {
    let prepared = &body.prepared;
    let is_there =
        prepared.closed_rule().as_ref().is_some_and(|rule| 2 * rule.n_pairs >= seams.len());
    let Some(cubature) = prepared.params.cubature.filter(|_| !seams.is_empty() && !is_there) else {
        return Ok(());
    };
    let pairs: Vec<[u32; 2]> = seams.pairs().collect();
    let state = body.state.closed(&pairs, seams.recipe().closing_stiffness_n_m)?;
    let is_closed = state.stitches().len() == body.state.stitches().len();
    // Not every way of closing it makes a basis whose rule serves others.
    let serves = body.origin.method == Some(Method::Flexibility)
        && body.cubature.is_some_and(|own| own.validation_error <= cubature.tolerance);
    let (rule, trained_error) = if is_closed && serves {
        (body.rule.clone(), body.trained_error)
    } else {
        let plan = Plan {
            method: Method::Flexibility,
            derivatives: Derivatives::Prepared,
            tolerance: CLOSED_MODES_TOLERANCE,
            reuse: None,
            seams: Some(seams.recipe().clone()),
            closings: Vec::new(),
        };
        let clock = StageClock::start(control);
        let closed = update_base(prepared.clone(), Vec::new(), state, plan, clock)?;
        (closed.rule, closed.trained_error)
    };
    *prepared.closed_rule() = Some(ClosedRule { n_pairs: pairs.len(), rule, trained_error });
    Ok(())
}

/// Refuses pairs that no stitch could join.
pub fn check_seams(body: &Artifacts, pairs: &[[u32; 2]]) -> Result<(), BuildError> {
    params::check_seams(&body.prepared.state, pairs)
}

/// What is prepared: at least the load cases of the base body as it is, which are made now if there are none.
pub(super) fn present(
    prepared: &Prepared,
    control: &dyn Control,
) -> Result<Arc<Seams>, BuildError> {
    if let Some(seams) = prepared.known_seams() {
        return Ok(seams);
    }
    let seams = Arc::new(unseamed(prepared, control)?);
    prepared.offer_seams(seams.clone());
    Ok(prepared.known_seams().unwrap_or(seams))
}

/// Modal derivatives of the base body as it is.
pub(super) fn base_derivatives(
    prepared: &Prepared,
    control: &dyn Control,
) -> Result<DerivativeSet, BuildError> {
    let Prepared { params, model, mass, factor, sigma, .. } = prepared;
    let lowest = lowest_modes(prepared, params.n_derivative_modes.min(params.n_modes));
    let loads = derivatives::right_hand_sides(model, lowest.shapes.as_ref(), control)?;
    // What they were made with is not to be there beside what they are solved with.
    pool::clear();
    let accurate = correcting_modes(prepared);
    let stitched = StitchedStiffness::new(model, &prepared.stiffness, factor, &[])?;
    let body = Body {
        mass,
        stitched: &stitched,
        sigma: *sigma,
        rigid: prepared.rigid(),
        tolerance: LOAD_CASE_TOLERANCE,
    };
    new_derivatives(&body, &lowest.eigenvalues, accurate.as_ref(), loads, control)
}

/// The `count` lowest elastic modes of the base body, or all of fewer.
fn lowest_modes(prepared: &Prepared, count: usize) -> LinearModes {
    let count = count.min(prepared.modes().ncols());
    LinearModes {
        shapes: prepared.modes().subcols(0, count).to_owned().into(),
        eigenvalues: prepared.spectrum.eigenvalues[..count].to_vec(),
    }
}

/// All modes of the base body, where solves with its factor have to be corrected on them.
fn correcting_modes(prepared: &Prepared) -> Option<LinearModes> {
    (prepared.sigma > 0.0).then(|| lowest_modes(prepared, prepared.modes().ncols()))
}

/// No pairs, beside the load cases of the base body as it is.
fn unseamed(prepared: &Prepared, control: &dyn Control) -> Result<Seams, BuildError> {
    let count = prepared.params.n_derivative_modes.min(prepared.params.n_modes);
    let modes = lowest_modes(prepared, count);
    let kept = prepared.derivatives().clone();
    let solutions = match kept {
        Some(solutions) => solutions,
        None => base_derivatives(prepared, control)?.shapes,
    };
    let loads = derivatives::right_hand_sides(&prepared.model, modes.shapes.as_ref(), control)?;
    let base = base_modes(prepared);
    let n_x = prepared.rigid().ncols() + prepared.modes().ncols();
    let solutions = Arc::unwrap_or_clone(solutions);
    Ok(Seams::new(LoadCases::none(n_x).with(&base, modes, loads.as_ref(), solutions)))
}

/// Adds `pairs` to `seams`, and load cases of the body with all of them closed, as stiffly as
/// `stitches` tell.
pub(super) fn extend(
    prepared: &Prepared,
    seams: &Seams,
    pairs: &[[u32; 2]],
    stitches: &[Stitch],
    control: &dyn Control,
) -> Result<Arc<Seams>, BuildError> {
    let extended = seams.extended(&base_modes(prepared), pairs, control)?;
    let stiffest = stitches.iter().map(|s| s.stiffness_n_m).fold(0.0, f64::max);
    let stiffness_n_m = if stiffest > 0.0 { stiffest } else { CLOSING_STIFFNESS_N_M };
    let seams = Arc::new(closed(prepared, &extended, stiffness_n_m, control)?);
    prepared.offer_seams(seams.clone());
    Ok(seams)
}

/// The seams that `recipe` tells of, bit for bit: those that are there if they are the same, or grown from
/// them, or made anew.
pub(super) fn remake(
    prepared: &Prepared,
    recipe: &SeamRecipe,
    control: &dyn Control,
) -> Result<Arc<Seams>, BuildError> {
    let present = present(prepared, control)?;
    if **present.recipe() == *recipe {
        return Ok(present);
    }
    let base = base_modes(prepared);
    let known = &present.recipe().groups;
    let mut seams = match recipe.groups.starts_with(known) {
        true => Seams::clone(&present),
        false => Seams::new(present.cases().first_set()),
    };
    let first_new = seams.recipe().groups.len();
    for group in &recipe.groups[first_new..] {
        params::check_seams(&prepared.state, group)?;
        seams = seams.extended(&base, group, control)?;
    }
    if recipe.groups.is_empty() {
        return Ok(Arc::new(seams));
    }
    let seams = Arc::new(closed(prepared, &seams, recipe.closing_stiffness_n_m, control)?);
    prepared.offer_seams(seams.clone());
    Ok(seams)
}

/// The base body as seams see it.
pub(super) fn base_modes(prepared: &Prepared) -> BaseModes<'_> {
    BaseModes {
        model: &prepared.model,
        mass: &prepared.mass,
        factor: &prepared.factor,
        x: [prepared.rigid(), prepared.modes()],
    }
}

/// `seams` with the load cases of the open body and of the one with every pair closed.
fn closed(
    prepared: &Prepared,
    seams: &Seams,
    stiffness_n_m: f64,
    control: &dyn Control,
) -> Result<Seams, BuildError> {
    let pairs: Vec<[u32; 2]> = seams.pairs().collect();
    let positions: Vec<usize> = pairs.iter().filter_map(|pair| seams.position(*pair)).collect();
    let stitches: Vec<Stitch> =
        pairs.iter().map(|&pair| Stitch { id: 0, pair, stiffness_n_m }).collect();
    let n_rigid = prepared.rigid().ncols();
    let lambda = &prepared.spectrum.eigenvalues;
    let closing =
        PreparedStitches::new(seams, &positions, &stitches, n_rigid, lambda, prepared.sigma)?;
    let n_left = closing.rigid_left()?.ncols();
    let (modes, _) = closing.modes(n_left, prepared.params.n_derivative_modes)?;
    let tolerance = LOAD_CASE_TOLERANCE;
    let (modes, loads, solutions) =
        solved_loads(prepared, seams, &positions, &closing, &modes, tolerance, control)?;
    let base = base_modes(prepared);
    let cases = seams.cases().first_set().with(&base, modes, loads.as_ref(), solutions);
    Ok(seams.with_cases(&base, cases, stiffness_n_m))
}

/// `stitches`, at `positions` of `seams`, and the `modes` of the body that they make, beside load cases of these
/// modes alone: all of its derivatives are among their solutions.
pub(super) fn with_own_cases(
    prepared: &Prepared,
    seams: &Seams,
    positions: &[usize],
    stitches: PreparedStitches,
    modes: Coefficients,
    control: &dyn Control,
) -> Result<(PreparedStitches, Coefficients), BuildError> {
    let count = prepared.params.n_derivative_modes.min(modes.x.ncols());
    let lowest = modes.columns(0..count);
    let tolerance = OWN_CASE_TOLERANCE;
    let (lowest, loads, solutions) =
        solved_loads(prepared, seams, positions, &stitches, &lowest, tolerance, control)?;
    let base = base_modes(prepared);
    let none = LoadCases::none(modes.x.nrows());
    let cases = none.with(&base, lowest, loads.as_ref(), solutions);
    let couplings = seams.couplings_with(&base, &cases, positions);
    let stitches = stitches.beside(cases, couplings);
    let modes = stitches.among_cases(modes);
    Ok((stitches, modes))
}

/// The loads of `modes` of the body that `stitches`, at `positions` of `seams`, make: the modes as columns, their loads
/// and the base body's response to these, to the relative residual `tolerance` where its factor is shifted.
fn solved_loads(
    prepared: &Prepared,
    seams: &Seams,
    positions: &[usize],
    stitches: &PreparedStitches,
    modes: &Coefficients,
    tolerance: f64,
    control: &dyn Control,
) -> Result<(LinearModes, Tall, Tall), BuildError> {
    let Prepared { model, mass, factor, sigma, .. } = prepared;
    let count = modes.x.ncols();
    let [_, stiffness] = stitches.grams(modes);
    let energies = (0..count).map(|i| stiffness[(i, i)]).collect();
    let shapes =
        combine(prepared, seams, stitches.cases(), positions, modes).dense().to_owned().into();
    let modes = LinearModes { shapes, eigenvalues: energies };

    // Their loads, solved for on the base body.
    let stitched = StitchedStiffness::new(model, &prepared.stiffness, factor, &[])?;
    let accurate = correcting_modes(prepared);
    let body =
        Body { mass, stitched: &stitched, sigma: *sigma, rigid: prepared.rigid(), tolerance };
    let loads = derivatives::right_hand_sides(model, modes.shapes.as_ref(), control)?;
    let set =
        new_derivatives(&body, &modes.eigenvalues, accurate.as_ref(), loads.clone(), control)?;
    Ok((modes, loads, Arc::unwrap_or_clone(set.shapes)))
}
