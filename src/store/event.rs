//! What subscribers hear.

use crate::session::{Progress, SessionId, SessionState};

/// Something happened to a session.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// The session it happened to.
    pub session: SessionId,
    /// What happened.
    pub kind: EventKind,
}

/// What can happen to a session.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EventKind {
    /// It exists (its build has been queued), or it was forked from another.
    Created,
    /// Its state changed.
    State(SessionState),
    /// The build or edit that runs has come this far.
    Progress(Progress),
    /// This generation is current now. (Only its number: an event waiting for a slow subscriber
    /// must not keep a body alive.)
    Generation(u64),
    /// It is being simulated.
    SimulationStarted,
    /// It is no longer simulated: by request, or because the simulation failed.
    SimulationStopped,
    /// It is gone; no further event follows.
    Deleted,
}
