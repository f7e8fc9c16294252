//! The budget: what bodies in memory take up, and which of them leave when it is not enough.

use crate::live::{Leftovers, LiveSession};
use crate::session::SessionId;
use crate::store::{Shared, Store};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, PoisonError};

impl Store {
    /// Bytes of the bodies in memory, by the tenants that their sessions belong to. For a thread that may
    /// take its time.
    pub fn memory(&self) -> BTreeMap<Option<String>, usize> {
        self.shared.memory_by_tenant()
    }
}

impl Shared {
    /// Bytes of all bodies in memory; what generations and sessions share is counted once.
    pub(crate) fn memory_in_use(&self) -> usize {
        self.memory_by_tenant().values().sum()
    }

    /// The same by tenant. What tenants share is counted with whoever has the oldest session on it.
    fn memory_by_tenant(&self) -> BTreeMap<Option<String>, usize> {
        let mut counted = BTreeSet::new();
        let mut by_tenant = BTreeMap::new();
        for session in self.all_sessions() {
            let mut n_bytes = 0;
            for generation in session.in_memory() {
                let body = &generation.artifacts;
                if counted.insert(Arc::as_ptr(body).addr()) {
                    n_bytes += body.own_memory_bytes();
                }
                let (base, of_base) = body.base_memory();
                if counted.insert(base) {
                    n_bytes += of_base;
                }
            }
            *by_tenant.entry(session.tenant().map(str::to_owned)).or_default() += n_bytes;
        }
        by_tenant
    }

    /// Makes room for `n_bytes` more, or as much of it as can be made: bodies of idle sessions leave
    /// memory, those not used for longest first, that of `user` never. Tells whether there is room.
    pub(crate) fn make_room(&self, n_bytes: usize, user: SessionId) -> bool {
        let Some(budget) = self.config.memory.budget_bytes else { return true };
        let fits = || self.memory_in_use().saturating_add(n_bytes) <= budget;
        if fits() {
            return true;
        }
        let mut others = self.all_sessions();
        others.retain(|session| session.id != user);
        others.sort_by_key(|session| session.last_use());
        for session in others {
            // So that it comes back quickly.
            if session.is_idle() {
                self.keep_bodies(&session, &|| true);
            }
            if let Some(leftovers) = session.evict() {
                tracing::info!(session = %session.id, "the body leaves memory");
                session.cancel_improvement();
                drop::<Leftovers>(leftovers);
                if fits() {
                    return true;
                }
            }
        }
        false
    }

    /// Whether bodies take up no more than they may.
    pub(crate) fn is_within_budget(&self) -> bool {
        self.config.memory.budget_bytes.is_none_or(|budget| self.memory_in_use() <= budget)
    }

    pub(crate) fn all_sessions(&self) -> Vec<Arc<LiveSession>> {
        let sessions = self.sessions.read().unwrap_or_else(PoisonError::into_inner);
        sessions.values().cloned().collect()
    }
}
