//! What sessions tell their listeners.

use super::session;
use crate::problem;
use sutura_proto::event::{Event, GenerationInfo};
use sutura_store::{
    EventKind, Generation, GenerationRef, SessionId, SessionInfo, SessionState, Store,
};

/// The event as clients hear it; `None` for those of no interest to them, or overtaken by others.
pub(crate) fn event(store: &Store, id: SessionId, kind: EventKind) -> Option<Event> {
    match kind {
        EventKind::Created => None,
        EventKind::SimulationStarted => Some(Event::Simulation { running: true }),
        EventKind::SimulationStopped => Some(Event::Simulation { running: false }),
        EventKind::State(SessionState::Failed) => {
            let error = store.info(id).ok()?.error?;
            Some(Event::Failed { error: problem::of_build(&error).to_document() })
        }
        EventKind::State(_) => Some(state(&store.info(id).ok()?)),
        EventKind::Progress(progress) => Some(Event::Stage {
            stage: progress.stage.name().to_owned(),
            progress: progress.fraction,
        }),
        EventKind::Generation(number) => {
            let generation = store.generation(id, GenerationRef::Number(number)).ok()?;
            Some(Event::Generation(generation_info(&generation)))
        }
        EventKind::Deleted => Some(Event::Deleted),
    }
}

/// Where a session stands now: the first event of a stream, and what a listener that fell behind
/// needs.
pub(crate) fn state(info: &SessionInfo) -> Event {
    Event::State { state: session::state(info.state), generation: info.generation_number }
}

/// A new generation, for those who follow a session.
pub(crate) fn generation_info(generation: &Generation) -> GenerationInfo {
    let artifacts = &generation.artifacts;
    GenerationInfo {
        generation: generation.number,
        n_modes: artifacts.n_modes(),
        basis_size: artifacts.basis_size(),
        n_stitches: artifacts.stitches().len(),
    }
}
