//! Sessions that go from one daemon to another, on a storage that they share.
//!
//! Whichever daemon is asked for a session that it does not have takes it over. The one that had it learns that by
//! its next write, which fails, or by looking; it then forgets the session, whose subscriptions end, and leaves
//! it to the other one for a while, lest two clients pull it to and fro.

use crate::archive::Found;
use crate::error::StoreError;
use crate::live::LiveSession;
use crate::pool::{Account, Place};
use crate::session::SessionId;
use crate::store::{Shared, Store};
use crate::work::QUERY;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

/// How long a daemon that lost a session to another one does not take it back.
pub const HAND_OVER: Duration = Duration::from_secs(10);

/// How often a daemon looks whether its sessions are its own still.
const WATCH_INTERVAL: Duration = Duration::from_secs(5);

/// Sessions lost that are remembered; beyond, all are forgotten, and may be taken back at once.
const MAX_LOST: usize = 4096;

/// What other daemons have to do with a store.
#[derive(Default)]
pub(crate) struct Fleet {
    /// Locked while a session is taken over, so that none is twice.
    taking: Mutex<()>,
    /// Sessions lost lately, and when.
    lost: Mutex<BTreeMap<SessionId, Instant>>,
}

impl Fleet {
    fn lose(&self, id: SessionId) {
        let mut lost = self.lost.lock().unwrap_or_else(PoisonError::into_inner);
        lost.retain(|_, since| since.elapsed() < HAND_OVER);
        if lost.len() >= MAX_LOST {
            lost.clear();
        }
        lost.insert(id, Instant::now());
    }

    fn is_lost(&self, id: SessionId) -> bool {
        let lost = self.lost.lock().unwrap_or_else(PoisonError::into_inner);
        lost.get(&id).is_some_and(|since| since.elapsed() < HAND_OVER)
    }
}

impl Store {
    /// Takes over a session that another daemon had last, if there is such a one on the storage and it is
    /// `tenant`'s (anybody's for `None`). Of sessions that are here, are not there, or are somebody else's, nothing
    /// comes of it: other calls tell.
    pub async fn take_over(&self, id: SessionId, tenant: Option<&str>) -> Result<(), StoreError> {
        let shared = &self.shared;
        let is_fleet = shared.archive.as_ref().is_some_and(|archive| archive.is_shared());
        if !is_fleet || self.sessions().contains_key(&id) {
            return Ok(());
        }
        let tenant = tenant.map(str::to_owned);
        let take = move |store: &Store| store.take_over_now(id, tenant.as_deref());
        self.keep(Account::of(None), "taking a session over", take).await
    }

    fn take_over_now(&self, id: SessionId, tenant: Option<&str>) -> Result<(), StoreError> {
        let Some(archive) = &self.shared.archive else { return Ok(()) };
        let _taking = self.shared.fleet.taking.lock().unwrap_or_else(PoisonError::into_inner);
        if self.sessions().contains_key(&id) {
            return Ok(());
        }
        let Some(owner) = archive.tenant(id)? else { return Ok(()) };
        if tenant.is_some_and(|tenant| owner.as_deref() != Some(tenant)) {
            return Ok(());
        }
        if self.shared.fleet.is_lost(id) {
            return Err(StoreError::Taken(id));
        }
        let limit = self.config().limits.max_sessions;
        if self.n_sessions() >= limit {
            return Err(StoreError::Full { what: "sessions", limit });
        }
        let Some(found) = archive.claim(id)? else { return Ok(()) };
        let Found { journal, contents, modified } = found;
        let found = Found { journal, contents: Ok(contents?), modified };
        let session = Arc::new(LiveSession::found(found, self.shared.surroundings.clone()));
        self.insert(session, || Ok(()))?;
        tracing::info!(session = %id, "session taken over");
        Ok(())
    }
}

impl Shared {
    /// Passes on how a write to a session's journal went, and forgets the session if it is another daemon's now.
    pub(crate) fn heed<T>(
        self: &Arc<Self>,
        session: &Arc<LiveSession>,
        written: Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        if matches!(written, Err(StoreError::Taken(_))) {
            self.hand_over_if_taken(session);
        }
        written
    }

    /// Forgets a session that is another daemon's now; tells whether it is.
    pub(crate) fn hand_over_if_taken(self: &Arc<Self>, session: &Arc<LiveSession>) -> bool {
        let Some(journal) = session.journal.as_ref().filter(|journal| journal.is_taken()) else {
            return false;
        };
        let id = session.id;
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        if !sessions.get(&id).is_some_and(|current| Arc::ptr_eq(current, session)) {
            return true;
        }
        self.fleet.lose(id);
        sessions.remove(&id);
        drop(sessions);
        journal.let_go();
        tracing::warn!(session = %id, "another daemon has taken the session over");
        session.cancel_improvement();
        self.builds.cancel_lane(id);
        let leftovers = session.hand_over();
        // Freeing large memory is for a worker; here and now if none has time.
        drop(self.queries.submit(Place::new(QUERY).apart(), move |_| drop(leftovers)));
        true
    }

    /// Looks from time to time, on a thread of its own, whether the sessions are this daemon's still.
    pub(crate) fn watch_fleet(self: &Arc<Self>) -> std::io::Result<()> {
        if self.archive.as_ref().is_some_and(|archive| archive.is_shared()) {
            let store = Arc::downgrade(self);
            let watch = move || while look_around(&store) {};
            std::thread::Builder::new().name("fleet".to_owned()).spawn(watch)?;
        }
        Ok(())
    }
}

/// Waits, then looks at every session once. Tells whether the store is there still.
fn look_around(store: &Weak<Shared>) -> bool {
    std::thread::sleep(WATCH_INTERVAL);
    let Some(sessions) = store.upgrade().map(|store| store.all_sessions()) else { return false };
    for session in sessions {
        let Some(store) = store.upgrade() else { return false };
        match session.journal.as_ref().map(|journal| journal.look()) {
            Some(Ok(true)) => {
                store.hand_over_if_taken(&session);
            }
            Some(Ok(false)) | None => {}
            Some(Err(error)) => {
                // As bad for the next one: later.
                tracing::warn!(%error, "the storage cannot be asked whose the sessions are");
                return true;
            }
        }
    }
    true
}
