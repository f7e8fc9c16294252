//! What a session tells its listeners: server-sent events, and the `generation` publication.

use crate::problem::Problem;
use crate::session::SessionState;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One server-sent event. `event:` carries [`Event::name`], `data:` this document. The first event
/// of every stream is a `state`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The session's state, at the start of the stream and whenever it changes.
    State {
        /// What it is doing.
        state: SessionState,
        /// The current generation.
        generation: u64,
    },
    /// Progress of a build or rebuild.
    Stage {
        /// The stage.
        stage: String,
        /// How much of it is done, 0 to 1.
        progress: f64,
    },
    /// A new generation serves.
    Generation(GenerationInfo),
    /// A simulation was started or stopped.
    Simulation {
        /// Whether one is running now.
        running: bool,
    },
    /// The build failed.
    Failed {
        /// Why.
        error: Problem,
    },
    /// The session was deleted; nothing follows.
    Deleted,
}

impl Event {
    /// The event's name.
    pub fn name(&self) -> &'static str {
        match self {
            Event::State { .. } => "state",
            Event::Stage { .. } => "stage",
            Event::Generation(_) => "generation",
            Event::Simulation { .. } => "simulation",
            Event::Failed { .. } => "failed",
            Event::Deleted => "deleted",
        }
    }
}

/// A new generation; also what Zenoh's `generation` publication carries, as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GenerationInfo {
    /// The generation.
    pub generation: u64,
    /// Elastic modes kept.
    pub n_modes: usize,
    /// Columns of the basis.
    pub basis_size: usize,
    /// Stitches in force.
    pub n_stitches: usize,
}
