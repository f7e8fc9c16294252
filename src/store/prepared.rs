//! Bodies prepared once: sessions on equal meshes with equal parameters share them in memory, and whoever comes
//! when they have left it reads what is kept of them.

use crate::archive::Archive;
use crate::error::StoreError;
use crate::metrics;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use sutura_core::build::{
    Artifacts, BaseBody, BuildError, BuildParams, Recipe, remake, revive, revive_base,
};
use sutura_core::control::Control;

/// Where bodies come from.
pub(crate) struct PreparedBodies {
    /// The first generations, and those restored, that some session still keeps.
    in_memory: Mutex<Vec<Weak<Artifacts>>>,
    archive: Option<Arc<Archive>>,
}

impl PreparedBodies {
    /// None in memory; `archive` may have some.
    pub(crate) fn new(archive: Option<Arc<Archive>>) -> PreparedBodies {
        PreparedBodies { in_memory: Mutex::default(), archive }
    }

    /// The body of a recipe: one that some session has, or one that is kept, or a new one. What it has in common with
    /// those that some session has, or with one of `own`, it shares. For a worker thread: equal meshes are
    /// compared number by number.
    pub(crate) fn body(
        &self,
        params: &BuildParams,
        recipe: &Recipe,
        own: &[Arc<Artifacts>],
        control: &dyn Control,
    ) -> Result<Arc<Artifacts>, StoreError> {
        let kin: Vec<Arc<Artifacts>> = own.iter().cloned().chain(self.all()).collect();
        let is_same = |body: &&Arc<Artifacts>| {
            body.is_as_built() == recipe.method.is_none()
                && body.params() == params
                && body.recipe() == *recipe
        };
        if let Some(same) = kin.iter().find(is_same) {
            tracing::info!("an equal body is shared");
            return Ok(same.clone());
        }
        let mut bases: Vec<BaseBody> = kin.iter().map(|body| body.base_body()).collect();
        let body = match self.kept(params, recipe, &mut bases, control)? {
            Some(kept) => {
                metrics::body("read");
                kept
            }
            None => {
                let made = remake(params, recipe, &bases, control)?;
                metrics::body("made");
                made
            }
        };
        if control.is_cancelled() {
            return Err(StoreError::Cancelled);
        }
        let body = Arc::new(body);
        let mut bodies = self.in_memory.lock().unwrap_or_else(PoisonError::into_inner);
        bodies.retain(|body| body.strong_count() > 0);
        bodies.push(Arc::downgrade(&body));
        Ok(body)
    }

    /// Every body that is still in memory.
    fn all(&self) -> Vec<Arc<Artifacts>> {
        let bodies = self.in_memory.lock().unwrap_or_else(PoisonError::into_inner);
        bodies.iter().filter_map(Weak::upgrade).collect()
    }

    /// The body of a recipe as it was kept. Its base body joins `bases`, if it is kept and not among them.
    fn kept(
        &self,
        params: &BuildParams,
        recipe: &Recipe,
        bases: &mut Vec<BaseBody>,
        control: &dyn Control,
    ) -> Result<Option<Artifacts>, BuildError> {
        let Some(archive) = &self.archive else { return Ok(None) };
        let Some(names) = archive.body_names(params, recipe) else { return Ok(None) };
        let state = recipe.state.base();
        if !bases.iter().any(|base| base.serves(params, state))
            && let Some(kept) = archive.kept_base(&names.base)
        {
            let base = revive_base(params, state, &kept, control);
            bases.extend(fitting(base, |why| archive.not_that_body(&names.base, why))?);
        }
        let Some(base) = bases.iter().find(|base| base.serves(params, state)) else {
            return Ok(None);
        };
        let Some(kept) = archive.kept_generation(&names.own) else { return Ok(None) };
        let body = revive(recipe, base, &kept, bases, control);
        fitting(body, |why| archive.not_that_body(&names.own, why))
    }
}

/// What came of something that was kept; `None`, and a complaint, if it was not what it should be.
fn fitting<T>(
    revived: Result<T, BuildError>,
    complain: impl FnOnce(&BuildError),
) -> Result<Option<T>, BuildError> {
    match revived {
        Ok(revived) => Ok(Some(revived)),
        Err(error @ (BuildError::Cancelled(_) | BuildError::OverBudget { .. })) => Err(error),
        Err(error) => {
            complain(&error);
            Ok(None)
        }
    }
}
