//! Simulations: what they are told and what they tell.

use crate::error::StoreError;
use std::sync::Arc;
use sutura_core::reduced::SimulationParams;

/// How to simulate a session.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationConfig {
    /// Time step, integrator, gravity.
    pub params: SimulationParams,
    /// Frames published for each second of simulated time, in Hz (at most one for each step).
    pub publish_hz: f64,
}

/// A force on one vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexForce {
    /// The vertex (zero-based).
    pub vertex: u32,
    /// The force in N.
    pub force_n: [f64; 3],
    /// How long it acts, in s of simulated time.
    pub duration_s: f64,
}

/// One published state.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Ascending by one within a session, also from one simulation to the next.
    pub sequence: u64,
    /// Simulated time in s.
    pub time_s: f64,
    /// The generation whose basis `q` belongs to.
    pub generation: u64,
    /// Rigid motion: position in m, then a unit quaternion (x, y, z, w).
    pub rigid: [f64; 7],
    /// Reduced coordinates.
    pub q: Vec<f32>,
}

/// What is known of a simulation at one moment.
#[derive(Clone, Debug)]
pub struct SimulationInfo {
    /// How it runs.
    pub config: SimulationConfig,
    /// Simulated time in s.
    pub time_s: f64,
    /// The generation it steps.
    pub generation: u64,
    /// Steps taken.
    pub n_steps: u64,
    /// Steps left out because the stepping thread could not keep up with real time.
    pub n_late_steps: u64,
    /// Steps that found no solution and brought the body to rest instead.
    pub n_recovered_steps: u64,
    /// Frames published.
    pub n_frames: u64,
    /// Forces acting.
    pub n_active_forces: usize,
    /// Why it no longer runs, if it failed.
    pub error: Option<Arc<StoreError>>,
}
