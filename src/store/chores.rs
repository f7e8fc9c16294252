//! Queueing of work that nobody waits for. A session has at most one task of each kind that waits, and each
//! finds out what there is to do only when it begins: so the queue holds no bodies, sessions bound its length, and
//! nothing is refused that nobody would ask for again.

use crate::live::LiveSession;
use crate::pool::{CancelFlag, Place, Ticket};
use crate::store::Shared;
use crate::work::PREPARATION;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

/// What may have to be done for a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Chore {
    /// Bringing back its body.
    Restoration,
    /// Preparing its candidate pairs.
    Seams,
    /// Finishing what a deadline left undone.
    Improvement,
    /// Preparing a base body that holds its stitches.
    BaseBody,
    /// Making its current generation an update of that.
    Rebasing,
    /// Shortening its journal.
    Compaction,
    /// Keeping its bodies on the storage.
    Keeping,
}

impl Chore {
    /// As the log says it.
    fn name(self) -> &'static str {
        match self {
            Chore::Restoration => "restoration",
            Chore::Seams => "seams",
            Chore::Improvement => "improvement",
            Chore::BaseBody => "base body",
            Chore::Rebasing => "rebasing",
            Chore::Compaction => "compaction",
            Chore::Keeping => "keeping",
        }
    }

    /// Whether no edit runs beside it.
    fn is_in_lane(self) -> bool {
        matches!(self, Chore::Restoration | Chore::Improvement | Chore::Rebasing)
    }
}

/// Which of a session's chores wait.
#[derive(Default)]
pub(crate) struct Chores(Mutex<BTreeSet<Chore>>);

impl Chores {
    fn add(&self, chore: Chore) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(chore)
    }

    fn remove(&self, chore: Chore) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&chore);
    }
}

/// A chore that waits, until it is dropped.
struct Waiting {
    session: Arc<LiveSession>,
    chore: Chore,
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.session.chores.remove(self.chore);
    }
}

impl Shared {
    /// Queues `run`, behind everything that somebody waits for, unless such a task waits already or the store
    /// is going down. A session that has gone by then needs it no more.
    pub(crate) fn later(
        self: &Arc<Self>,
        session: &Arc<LiveSession>,
        chore: Chore,
        run: impl FnOnce(&Arc<Shared>, &Arc<LiveSession>, &CancelFlag) + Send + 'static,
    ) -> Option<Ticket> {
        if !session.chores.add(chore) {
            return None;
        }
        let waiting = Waiting { session: session.clone(), chore };
        let store = Arc::downgrade(self);
        let task = move |cancel: &CancelFlag| {
            let session = waiting.session.clone();
            // What comes up from now on is for another task.
            drop(waiting);
            let Some(store) = store.upgrade().filter(|_| !session.is_closed()) else { return };
            let _span = tracing::info_span!("background", session = %session.id).entered();
            run(&store, &session, cancel);
        };
        let place = Place::new(PREPARATION).apart().called(chore.name());
        let place = match chore {
            // The store's own work: in the order in which it was queued, whosever the sessions are.
            Chore::Restoration => place,
            _ => place.charged_to(session.account()),
        };
        let place = if chore.is_in_lane() { place.in_lane(session.id) } else { place };
        match self.builds.submit(place, task) {
            Ok(ticket) => Some(ticket),
            Err(error) => {
                tracing::debug!(session = %session.id, ?chore, %error, "left undone");
                None
            }
        }
    }
}
