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
/// change of full rank or of the free degrees of freedom.
pub(super) fn base_for(
    previous: &Artifacts,
    state: &BaseState,
    clock: &mut StageClock<'_>,
) -> Result<Arc<Prepared>, BuildError> {
    match known(previous).find(|base| base.state == *state) {
        Some(found) => Ok(found),
        None => Ok(prepare(state, &previous.prepared.params, clock)?.0),
    }
}

/// The base bodies of `previous` and of generations before it, without `base`, which follows them.
pub(super) fn bases_before(previous: &Artifacts, base: &Arc<Prepared>) -> Vec<Weak<Prepared>> {
    let others = known(previous).filter(|other| !Arc::ptr_eq(other, base));
    others.take(MOST_REMEMBERED).map(|other| Arc::downgrade(&other)).collect()
}

fn known(previous: &Artifacts) -> impl Iterator<Item = Arc<Prepared>> {
    let earlier = previous.earlier.iter().filter_map(Weak::upgrade);
    std::iter::once(previous.prepared.clone()).chain(earlier)
}
