//! Keeping prepared bodies on the storage: when a session has come to rest, before its body leaves memory, and at
//! the end. Nobody waits for it, and nothing depends on it but how long a restoration takes.

use crate::chores::Chore;
use crate::live::LiveSession;
use crate::pool::catching;
use crate::store::Shared;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often sessions are looked at, at least and at most; in between, four times in the time of rest.
const LOOK_INTERVALS: [Duration; 2] = [Duration::from_millis(20), Duration::from_millis(500)];

/// The thread that looks which sessions have come to rest, while there is one.
#[derive(Default)]
pub(crate) struct Keeper(Mutex<Option<(Sender<()>, JoinHandle<()>)>>);

impl Keeper {
    /// Ends the thread, and waits for that.
    fn stop(&self) {
        let running = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some((sender, thread)) = running {
            drop(sender);
            if thread.join().is_err() {
                tracing::error!("the thread that keeps bodies panicked");
            }
        }
    }
}

impl Shared {
    /// Whether bodies are kept at all.
    fn keeps_bodies(&self) -> bool {
        self.archive.as_ref().is_some_and(|archive| archive.keeps_bodies())
    }

    /// Keeps bodies from now on, if they are to be kept.
    pub(crate) fn start_keeping(self: &Arc<Self>) -> std::io::Result<()> {
        if !self.keeps_bodies() {
            return Ok(());
        }
        let (sender, receiver) = std::sync::mpsc::channel();
        let store = Arc::downgrade(self);
        let [least, most] = LOOK_INTERVALS;
        let interval = (self.config.keeping.rest / 4).clamp(least, most);
        let look = move || while look_around(&store, &receiver, interval) {};
        let thread = std::thread::Builder::new().name("bodies".to_owned()).spawn(look)?;
        *self.keeper.0.lock().unwrap_or_else(PoisonError::into_inner) = Some((sender, thread));
        Ok(())
    }

    /// Queues the bodies of sessions that have come to rest.
    fn keep_those_at_rest(self: &Arc<Self>) {
        let rest = self.config.keeping.rest;
        for session in self.all_sessions() {
            if !session.is_unkept_for(rest) {
                continue;
            }
            self.later(&session, Chore::Keeping, move |store, session, cancel| {
                // An edit has come in between.
                if session.is_unkept_for(rest) {
                    store.keep_bodies(session, &|| !cancel.is_set());
                }
            });
        }
    }

    /// Keeps the bodies of a session, as far as they are not kept already.
    pub(crate) fn keep_bodies(&self, session: &LiveSession, goes_on: &dyn Fn() -> bool) {
        let Some(journal) = session.journal.as_ref().filter(|_| self.keeps_bodies()) else {
            return;
        };
        let _span = tracing::info_span!("keeping", session = %session.id).entered();
        let generations = session.begin_keeping();
        let begun = Instant::now();
        let kept = catching("keeping bodies", || journal.keep_bodies(&generations, goes_on));
        match kept {
            Ok(()) => tracing::debug!(seconds = begun.elapsed().as_secs_f64(), "bodies kept"),
            Err(error) => tracing::warn!(%error, "bodies not kept"),
        }
    }

    /// Keeps what is not kept yet, until `deadline`: the store is going down.
    pub(crate) fn keep_the_rest(&self, deadline: Instant) {
        self.keeper.stop();
        if self.keeps_bodies() {
            let mut sessions = self.all_sessions();
            sessions.retain(|session| session.is_unkept_for(Duration::ZERO));
            sessions.sort_by_key(|session| std::cmp::Reverse(session.last_use()));
            for session in sessions {
                self.keep_bodies(&session, &|| Instant::now() < deadline);
            }
        }
    }
}

/// Waits, then looks at every session once. Tells whether to go on.
fn look_around(store: &Weak<Shared>, stop: &Receiver<()>, interval: Duration) -> bool {
    if !matches!(stop.recv_timeout(interval), Err(RecvTimeoutError::Timeout)) {
        return false;
    }
    let Some(store) = store.upgrade() else { return false };
    store.keep_those_at_rest();
    true
}

#[cfg(test)]
mod tests;
