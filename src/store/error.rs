//! Every way a call to the store can fail.

use crate::session::{SessionId, SessionState};
use crate::storage::StorageError;
use sutura_core::build::BuildError;
use sutura_core::edit::EditError;
use sutura_core::reduced::SimulationError;
use sutura_core::reduced::contact::ObstacleError;

/// Why a call failed. Whatever the error, the session is as it was before.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// No session has this name.
    #[error("there is no session {0}")]
    NoSession(SessionId),
    /// Another daemon of the fleet serves the session now. What this call would have changed is not changed.
    #[error("another daemon has taken session {0} over; ask there")]
    Taken(SessionId),
    /// The session never had this generation, or no longer keeps it.
    #[error("there is no generation {number}; the session keeps {oldest} to {current}")]
    NoGeneration {
        /// The generation asked for.
        number: u64,
        /// The oldest that is kept.
        oldest: u64,
        /// The current one.
        current: u64,
    },
    /// The session is not being simulated.
    #[error("the session has no simulation")]
    NoSimulation,
    /// The edit was made for a generation that is no longer (or not yet) current.
    #[error("base_generation is {given}, but the current generation is {current}")]
    WrongGeneration {
        /// The caller's.
        given: u64,
        /// The session's.
        current: u64,
    },
    /// The session has no body yet, or never will.
    #[error("the session is {state}")]
    NotReady {
        /// `Building` or `Failed`.
        state: SessionState,
    },
    /// A queue is full: try again later.
    #[error("too much work is waiting; try again in {retry_after_s} s")]
    Busy {
        /// Estimated time until there is room, in s.
        retry_after_s: u64,
    },
    /// As many as allowed exist already: one must go before another can come.
    #[error("there are already {limit} {what}, as many as allowed")]
    Full {
        /// What there are too many of.
        what: &'static str,
        /// How many may exist.
        limit: usize,
    },
    /// The input is larger than the store accepts.
    #[error("{given} {what}, at most {limit} are allowed")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// The largest accepted.
        limit: usize,
        /// The caller's.
        given: usize,
    },
    /// An input value is impossible.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The body could not be built.
    #[error(transparent)]
    Build(BuildError),
    /// The edit is impossible.
    #[error(transparent)]
    Edit(EditError),
    /// The simulation cannot run.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// What was to be kept could not be written, or what was kept could not be read.
    #[error("the storage failed: {0}")]
    Storage(#[from] StorageError),
    /// What was kept of the session is not what was written.
    #[error("{name} is damaged: {why}")]
    Damaged {
        /// The blob.
        name: String,
        /// What is wrong with it.
        why: String,
    },
    /// Nobody waits for the answer any more, or the session was deleted.
    #[error("cancelled")]
    Cancelled,
    /// The daemon is going down and takes no new work.
    #[error("shutting down")]
    ShuttingDown,
    /// A defect of ours; the log has the details.
    #[error("internal error: {what} failed unexpectedly")]
    Failed {
        /// The computation that failed.
        what: &'static str,
    },
}

impl From<BuildError> for StoreError {
    fn from(error: BuildError) -> Self {
        match error {
            BuildError::Cancelled(_) => StoreError::Cancelled,
            BuildError::Edit(error) | BuildError::Seam(error) => StoreError::Edit(error),
            error => StoreError::Build(error),
        }
    }
}

/// An input value that cannot be used, and where it stands (zero-based).
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum InputError {
    #[error("name must not be empty nor contain control characters")]
    Name,
    #[error("the request holds no edits")]
    NoEdits,
    #[error("tolerance must be positive and below 1, not {0}")]
    Tolerance(f64),
    #[error("pose {pose}: {given} numbers, but the basis has {r} columns")]
    PoseLength { pose: usize, given: usize, r: usize },
    #[error("pose {pose}: number {index} is not finite")]
    PoseNotFinite { pose: usize, index: usize },
    #[error("pose {pose}: the coordinates are so large that the result overflows")]
    PoseOverflows { pose: usize },
    #[error("dt_s must be between {low} and 1 s, not {given}")]
    TimeStep { given: f64, low: f64 },
    #[error("publish_hz must be positive and at most {high}, not {given}")]
    PublishRate { given: f64, high: f64 },
    #[error("obstacle {obstacle}: {error}")]
    Obstacle { obstacle: usize, error: ObstacleError },
    #[error("contact: {name} must be {rule}, not {value}")]
    Contact { name: &'static str, rule: &'static str, value: f64 },
    #[error("grab {grab}: vertex {vertex} is out of range, the mesh has {n_vertices} vertices")]
    GrabVertex { grab: usize, vertex: u32, n_vertices: usize },
    #[error("grab {grab}: target_m must be finite and at most 1e9 m in each axis")]
    GrabTarget { grab: usize },
    #[error("grab {grab}: {name} must be between 0 and {high:e}, not {value:e}")]
    GrabStrength { grab: usize, name: &'static str, value: f64, high: f64 },
    #[error("force {force}: vertex {vertex} is out of range, the mesh has {n_vertices} vertices")]
    ForceVertex { force: usize, vertex: u32, n_vertices: usize },
    #[error("force {force}: force_n must be finite and at most {high:e} N in each axis")]
    ForceSize { force: usize, high: f64 },
    #[error("force {force}: duration_s must be positive and at most {high} s, not {given}")]
    ForceDuration { force: usize, given: f64, high: f64 },
}
