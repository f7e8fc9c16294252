//! A session: one body, its generations, and what is being done to it.

use crate::error::StoreError;
use std::sync::Arc;
use std::time::Duration;
use sutura_core::build::{Artifacts, BuildParams, Derivatives, Method};
use sutura_core::control::Stage;
use sutura_core::edit::{Edit, StitchId};
use sutura_core::mesh::TetMesh;

/// Names a session; unique among daemons, ascending in the order of creation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionId(uuid::Uuid);

impl SessionId {
    /// A new name, which comes behind `newest` whatever the clock says: sessions are listed in the order in
    /// which they were opened.
    pub(crate) fn behind(newest: Option<SessionId>) -> Self {
        let by_clock = Self(uuid::Uuid::now_v7());
        let next = newest.and_then(|newest| newest.0.as_u128().checked_add(1));
        next.map_or(by_clock, |next| by_clock.max(Self(uuid::Uuid::from_u128(next))))
    }
}

impl std::fmt::Display for SessionId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.as_simple().fmt(f)
    }
}

impl std::str::FromStr for SessionId {
    type Err = NotASessionId;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        // One name, one spelling: of the forms that a UUID can take, only the one we write.
        let id = uuid::Uuid::try_parse(text).map(Self).map_err(|_| NotASessionId)?;
        if id.to_string() == text { Ok(id) } else { Err(NotASessionId) }
    }
}

/// The text is not the name of any session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a session's name is 32 lower-case hexadecimal digits")]
pub struct NotASessionId;

/// What [`crate::Store::create`] needs.
#[derive(Clone, Debug)]
pub struct CreateSession {
    /// For people; need not be unique.
    pub name: String,
    /// Whose it is; `None` where nobody is asked.
    pub tenant: Option<String>,
    /// The mesh.
    pub mesh: Arc<TetMesh>,
    /// How to build the body.
    pub params: BuildParams,
}

/// How large a mesh is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshSize {
    /// Vertices.
    pub n_vertices: usize,
    /// Tets.
    pub n_tets: usize,
    /// Domains.
    pub n_domains: usize,
    /// Connected pieces.
    pub n_components: usize,
}

impl MeshSize {
    /// That of `mesh`.
    pub fn of(mesh: &TetMesh) -> MeshSize {
        MeshSize {
            n_vertices: mesh.vertices().len(),
            n_tets: mesh.tets().len(),
            n_domains: mesh.domains().len(),
            n_components: mesh.n_components(),
        }
    }
}

/// What a session is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionState {
    /// All that makes the body is kept, but the body is not in memory: whoever asks for it has it
    /// restored.
    Stored,
    /// The body is being made again from what is kept of it.
    Restoring,
    /// The first generation is queued or being built.
    Building,
    /// The current generation is ready, nothing is being computed.
    Ready,
    /// The current generation is ready, the next one is being computed.
    Rebuilding,
    /// The first generation could not be built, or what was kept of the body could not be read.
    Failed,
}

impl SessionState {
    /// Lower-case name.
    pub fn name(self) -> &'static str {
        match self {
            SessionState::Stored => "stored",
            SessionState::Restoring => "restoring",
            SessionState::Building => "building",
            SessionState::Ready => "ready",
            SessionState::Rebuilding => "rebuilding",
            SessionState::Failed => "failed",
        }
    }
}

impl std::fmt::Display for SessionState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// How far a build or edit has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// The stage it is in.
    pub stage: Stage,
    /// Fraction of this stage that is done, 0 to 1.
    pub fraction: f64,
}

/// A prepared body after zero or more edits. Immutable.
pub struct Generation {
    /// 0 for the build; each edit request adds one.
    pub number: u64,
    /// The body.
    pub artifacts: Arc<Artifacts>,
    /// The method of the edit that made it; `None` for the build.
    pub made_by: Option<Method>,
    /// Relative eigenvalue error asked for.
    pub tolerance: f64,
    /// The generation that this one and those between are the same body as: with what a deadline had left
    /// undone, or as an update of another base body.
    pub improves: Option<u64>,
    /// Stitches made by the edit, in the order of the request.
    pub stitch_ids: Vec<StitchId>,
    /// Time the computation took (waiting not included; zero for a body taken from another session).
    pub computed_in: Duration,
}

impl Generation {
    /// Whether it is the same body as the generation `given`.
    pub(crate) fn is_body_of(&self, given: u64) -> bool {
        (self.improves.unwrap_or(self.number)..=self.number).contains(&given)
    }
}

impl std::fmt::Debug for Generation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Generation")
            .field("number", &self.number)
            .field("made_by", &self.made_by)
            .field("stitch_ids", &self.stitch_ids)
            .field("computed_in", &self.computed_in)
            .finish_non_exhaustive()
    }
}

/// Which generation of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GenerationRef {
    /// The one that is current when the call arrives.
    Current,
    /// The one with this number.
    Number(u64),
}

/// Edits that take effect together or not at all.
#[derive(Clone, Debug, PartialEq)]
pub struct EditRequest {
    /// The generation the caller means to edit; `None` edits whichever is current.
    pub base_generation: Option<u64>,
    /// A kept generation to return to first: without edits the next generation is that one again.
    pub restore: Option<u64>,
    /// How the linear modes follow.
    pub method: Method,
    /// Where the derivatives of an edit inside a seam come from.
    pub derivatives: Derivatives,
    /// Relative eigenvalue error accepted (see [`sutura_core::build::RebuildParams`]).
    pub tolerance: f64,
    /// Time in which to answer with the best that fits; the rest follows in the background, as a
    /// further generation.
    pub deadline: Option<Duration>,
    /// The edits, in order.
    pub edits: Vec<Edit>,
}

/// What is known of a session at one moment.
#[derive(Clone, Debug)]
pub struct SessionInfo {
    /// Its name in every call.
    pub id: SessionId,
    /// Its name for people.
    pub name: String,
    /// Whose it is; `None` if it was opened where nobody was asked.
    pub tenant: Option<String>,
    /// What it is doing.
    pub state: SessionState,
    /// How far that has come, while something is being computed.
    pub progress: Option<Progress>,
    /// How large the mesh is.
    pub size: MeshSize,
    /// The number of the current generation, 0 before there is one.
    pub generation_number: u64,
    /// The number of the oldest generation in memory.
    pub oldest_generation: Option<u64>,
    /// The current generation, once there is one, while it is in memory.
    pub generation: Option<Arc<Generation>>,
    /// Why the state is `Failed`.
    pub error: Option<Arc<StoreError>>,
}
