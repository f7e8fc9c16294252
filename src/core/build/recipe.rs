//! What a generation is a function of, so that it can be made again, bit for bit, from the mesh and the
//! parameters of its build: without the generations before it, and without what the clock and the
//! work in the background did when it was made first.

use super::artifacts::Artifacts;
use super::base::{self, BaseBody};
use super::close::ClosingReport;
use super::params::{BuildError, BuildParams, Derivatives, Method};
use super::{Plan, StageClock, finish, first_draft, update_base};
use crate::control::Control;
use crate::cubature::Rule;
use crate::edit::EditState;
use crate::modes::seams::SeamRecipe;
use std::sync::Arc;

/// Everything that decides about a generation, beside the parameters of its build.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// What edits have made of the body.
    pub state: EditState,
    /// How the modes followed the edit; `None` for a body as it was built.
    pub method: Option<Method>,
    /// Where its derivatives were to come from.
    pub derivatives: Derivatives,
    /// Relative eigenvalue error asked for.
    pub tolerance: f64,
    /// The cubature rule that it began from, and its validation error when it was trained: that of the generation before,
    /// or of the closed seams.
    pub reuse: Option<(Rule, f64)>,
    /// The seams that there were when it was made.
    pub seams: Arc<SeamRecipe>,
    /// What was left out for the sake of a deadline, decision by decision.
    pub skipped: Vec<bool>,
    /// What the closings among its edits did. The state has their result: they are not done again.
    pub closings: Vec<ClosingReport>,
}

impl Recipe {
    /// Of a body as it is built.
    pub fn of_build(state: EditState) -> Recipe {
        Recipe {
            state,
            method: None,
            derivatives: Derivatives::default(),
            tolerance: 0.0,
            reuse: None,
            seams: Arc::default(),
            skipped: Vec::new(),
            closings: Vec::new(),
        }
    }
}

impl Artifacts {
    /// Whether this is what [`build`](super::build) made.
    pub fn is_as_built(&self) -> bool {
        self.origin.method.is_none()
    }

    /// What makes this generation again ([`remake`]).
    pub fn recipe(&self) -> Recipe {
        Recipe {
            state: self.state.clone(),
            method: self.origin.method,
            derivatives: self.origin.derivatives,
            tolerance: self.origin.tolerance,
            reuse: self.origin.reuse.clone(),
            seams: self.origin.seams.clone(),
            skipped: self.origin.skipped.clone(),
            closings: self.closings.clone(),
        }
    }
}

/// Makes a generation again. A base body that is among `kin` is not prepared again.
pub fn remake(
    params: &BuildParams,
    recipe: &Recipe,
    kin: &[BaseBody],
    control: &dyn Control,
) -> Result<Artifacts, BuildError> {
    let base_state = recipe.state.base();
    let mut clock = StageClock::start(control);
    let Some(method) = recipe.method else {
        let draft = first_draft(base_state.mesh().clone(), params, kin, &mut clock)?;
        return finish(draft, clock);
    };
    check(recipe)?;
    clock.decided = Some(recipe.skipped.clone().into_iter());
    let base = match kin.iter().find(|kin| kin.serves(params, base_state)) {
        Some(BaseBody(base)) => base.clone(),
        None => base::prepare(base_state, params, &mut clock)?.0,
    };
    let earlier = base::others(&base, kin);
    let plan = Plan {
        method,
        derivatives: recipe.derivatives,
        tolerance: recipe.tolerance,
        reuse: recipe.reuse.clone(),
        seams: Some(recipe.seams.clone()),
        closings: recipe.closings.clone(),
    };
    update_base(base, earlier, recipe.state.clone(), plan, clock)
}

/// Refuses what could not have been made, so that nothing is indexed beyond its end.
pub(super) fn check(recipe: &Recipe) -> Result<(), BuildError> {
    super::params::check_fraction("tolerance", recipe.tolerance)?;
    let n_tets = recipe.state.base().mesh().tets().len();
    recipe.reuse.as_ref().map_or(Ok(()), |(rule, error)| check_rule(rule, *error, n_tets))
}

/// Refuses a rule, and its validation error when it was trained, that no training could have made.
pub(super) fn check_rule(rule: &Rule, trained_error: f64, n_tets: usize) -> Result<(), BuildError> {
    let refuse = |name, value, rule| Err(BuildError::BadParameter { name, value, rule });
    if rule.tets.len() != rule.weights.len() {
        return refuse("cubature weights", rule.weights.len() as f64, "as many as points");
    }
    if let Some(tet) = rule.tets.iter().find(|tet| **tet as usize >= n_tets) {
        return refuse("cubature point", f64::from(*tet), "a tet of the mesh");
    }
    if !rule.smoothing.is_empty() && rule.smoothing.len() != rule.tets.len() {
        return refuse("cubature smoothing", rule.smoothing.len() as f64, "none or one a point");
    }
    if let Some(x) = rule.smoothing.as_flattened().as_flattened().iter().find(|x| !x.is_finite()) {
        return refuse("cubature smoothing", *x, "finite");
    }
    let numbers = rule.weights.iter().chain([&trained_error]);
    match numbers.copied().find(|x| !(*x >= 0.0 && x.is_finite())) {
        Some(value) => refuse("cubature weight", value, "finite and not negative"),
        None => Ok(()),
    }
}
