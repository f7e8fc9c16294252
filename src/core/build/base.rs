//! Which base body a generation is an update of.

use super::StageClock;
use super::artifacts::{Artifacts, Prepared};
use super::params::BuildError;
use super::prepare;
use crate::edit::BaseState;
use std::sync::{Arc, Weak};

/// Base bodies that one line of generations remembers; remembering keeps none of them alive.
const MOST_REMEMBERED: usize = 16;

/// The base body of `state`: the one of `previous` or of a generation before it that is still kept
/// (so that an edit taken back costs no factorization); or a new one, because nothing prepared serves a
/// change of full rank or of the free degrees of freedom. With it those of the generations before.
pub(super) fn base_for(
    previous: &Artifacts,
    state: &BaseState,
    clock: &mut StageClock<'_>,
) -> Result<(Arc<Prepared>, Vec<Weak<Prepared>>), BuildError> {
    let Artifacts { prepared, earlier, .. } = previous;
    if prepared.state == *state {
        return Ok((prepared.clone(), earlier.clone()));
    }
    let alive: Vec<Arc<Prepared>> = earlier.iter().filter_map(Weak::upgrade).collect();
    let found = alive.iter().find(|base| base.state == *state);
    let base = match found {
        Some(found) => found.clone(),
        None => prepare(state, &prepared.params, clock)?.0,
    };
    let others = std::iter::once(prepared).chain(&alive).filter(|other| !Arc::ptr_eq(other, &base));
    let remembered = others.take(MOST_REMEMBERED).map(Arc::downgrade).collect();
    Ok((base, remembered))
}
