//! How much work the store does at once, and the sizes it accepts.

use std::time::Duration;

/// Everything the store can be told at its start.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StoreConfig {
    /// Threads, queues and pacing.
    pub work: WorkConfig,
    /// Largest sizes accepted from a caller.
    pub limits: Limits,
    /// What bodies may take up.
    pub memory: MemoryConfig,
    /// What is kept beside the sessions.
    pub keeping: KeepingConfig,
}

/// What is kept beside the sessions.
#[derive(Clone, Debug, PartialEq)]
pub struct KeepingConfig {
    /// Bytes of prepared bodies in the storage, so that they need not be made again; 0 for none. Beyond, those
    /// used longest ago are deleted. A storage that is shared keeps none.
    pub max_body_bytes: u64,
    /// How long a session has to be as it is before its bodies are written: those of edits that follow each other
    /// more quickly are of use to nobody, and would take up the disk that the edits wait for.
    pub rest: Duration,
}

impl Default for KeepingConfig {
    fn default() -> Self {
        Self { max_body_bytes: 4 << 30, rest: Duration::from_secs(2) }
    }
}

/// What bodies may take up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MemoryConfig {
    /// Bytes of all bodies in memory; `None` for as many as there are. Beyond, the bodies of idle sessions
    /// leave memory, those not used for longest first, and builds that would not fit are refused.
    pub budget_bytes: Option<usize>,
}

/// Threads, queues and pacing.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkConfig {
    /// Threads of the build pool. One of them is left to edits; of three or more, another one to bodies
    /// that are asked for and have to be restored.
    pub n_build_threads: usize,
    /// Threads of the query pool.
    pub n_query_threads: usize,
    /// Threads that step simulations.
    pub n_stepping_threads: usize,
    /// Builds that may wait for a thread. One tenant takes no more places than it leaves, here and below.
    pub build_queue_limit: usize,
    /// Edits that may wait for a thread.
    pub edit_queue_limit: usize,
    /// Queries that may wait for a thread.
    pub query_queue_limit: usize,
    /// How long an edit may wait for a thread.
    pub max_edit_wait: Duration,
    /// How long a query may wait for a thread.
    pub max_query_wait: Duration,
    /// Messages that may wait for a stepping thread.
    pub stepping_queue_limit: usize,
    /// Generations of a session that stay retrievable, the current one included.
    pub n_kept_generations: usize,
    /// Stitches that edits may add to a base body; where there are more, a base body that holds them is
    /// prepared in the background.
    pub max_open_stitches: usize,
    /// Shortest time between two progress events of one stage.
    pub progress_interval: Duration,
    /// Events a slow subscriber may fall behind before it loses the oldest.
    pub event_backlog: usize,
    /// Frames a slow subscriber may fall behind before it loses the oldest.
    pub frame_backlog: usize,
}

impl Default for WorkConfig {
    fn default() -> Self {
        Self {
            n_build_threads: 3,
            n_query_threads: 2,
            n_stepping_threads: 1,
            build_queue_limit: 16,
            edit_queue_limit: 64,
            query_queue_limit: 256,
            max_edit_wait: Duration::from_secs(10),
            max_query_wait: Duration::from_secs(10),
            stepping_queue_limit: 1024,
            n_kept_generations: 8,
            max_open_stitches: 256,
            progress_interval: Duration::from_millis(100),
            event_backlog: 256,
            frame_backlog: 16,
        }
    }
}

/// Largest sizes accepted from a caller.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Sessions at once.
    pub max_sessions: usize,
    /// Bytes of a session's name.
    pub max_name_bytes: usize,
    /// Vertices of a mesh.
    pub max_vertices: usize,
    /// Tets of a mesh.
    pub max_tets: usize,
    /// Domains of a mesh.
    pub max_domains: usize,
    /// Elastic modes kept.
    pub max_modes: usize,
    /// Columns of the basis.
    pub max_basis_size: usize,
    /// Cubature points.
    pub max_cubature_points: usize,
    /// Training poses of the cubature.
    pub max_training_poses: usize,
    /// Candidate stitch pairs prepared with the body.
    pub max_seams: usize,
    /// Bytes that the prepared pairs of one base body may take; pairs beyond are not prepared.
    pub max_seam_bytes: usize,
    /// Entries of one edit request.
    pub max_edits_per_request: usize,
    /// Stitches in force in one session.
    pub max_stitches: usize,
    /// Poses of one evaluation request.
    pub max_evaluations_per_request: usize,
    /// Simulations at once.
    pub max_simulations: usize,
    /// Shortest time step of a simulation in s.
    pub min_dt_s: f64,
    /// Highest rate of published frames in Hz.
    pub max_publish_hz: f64,
    /// Obstacles of one simulation.
    pub max_obstacles: usize,
    /// Grabs of one simulation.
    pub max_grabs: usize,
    /// Forces in one request.
    pub max_forces_per_request: usize,
    /// Forces acting at once in one simulation.
    pub max_active_forces: usize,
    /// Largest component of a force in N.
    pub max_force_n: f64,
    /// Longest time a force may act in s of simulated time.
    pub max_force_duration_s: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_sessions: 64,
            max_name_bytes: 256,
            max_vertices: 500_000,
            max_tets: 2_000_000,
            max_domains: 1024,
            max_modes: 200,
            max_basis_size: 400,
            max_cubature_points: 4000,
            max_training_poses: 2000,
            max_seams: 4096,
            max_seam_bytes: 1 << 30,
            max_edits_per_request: 256,
            max_stitches: 4096,
            max_evaluations_per_request: 256,
            max_simulations: 16,
            min_dt_s: 5e-4,
            max_publish_hz: 1000.0,
            max_obstacles: 64,
            max_grabs: 32,
            max_forces_per_request: 256,
            max_active_forces: 1024,
            max_force_n: 1e9,
            max_force_duration_s: 3600.0,
        }
    }
}
