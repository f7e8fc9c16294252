//! Simulations: what they are told and what they tell.

use crate::error::StoreError;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use sutura_core::build::Artifacts;
use sutura_core::reduced::contact::{Contact, Obstacle};
use sutura_core::reduced::{Environment, SimulationParams};
use tokio::sync::broadcast;

/// How to simulate a session.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulationConfig {
    /// Time step, integrator, gravity.
    pub params: SimulationParams,
    /// What the body cannot enter.
    pub obstacles: Vec<Obstacle>,
    /// How obstacles push back.
    pub contact: ContactConfig,
    /// Frames published for each second of simulated time, in Hz (at most one for each step, and
    /// one more on either side of a change of generation).
    pub publish_hz: f64,
}

impl SimulationConfig {
    /// The surroundings of `body`; none without obstacles.
    pub(crate) fn environment(&self, body: &Artifacts) -> Option<Arc<Environment>> {
        if self.obstacles.is_empty() {
            return None;
        }
        let suited = body.suited_contact();
        let ContactConfig { stiffness_pa_m, damping_s_m, friction, creep_m_s } = self.contact;
        let contact = Contact {
            stiffness_pa_m: stiffness_pa_m.unwrap_or(suited.stiffness_pa_m),
            damping_s_m,
            friction,
            creep_m_s: creep_m_s.unwrap_or(suited.creep_m_s),
        };
        Some(Arc::new(Environment { obstacles: self.obstacles.clone(), contact }))
    }
}

/// How obstacles push back ([`Contact`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactConfig {
    /// Pressure for each metre of depth, in Pa/m; by default what suits the body.
    pub stiffness_pa_m: Option<f64>,
    /// At 1 m/s into the obstacle the pressure grows by this fraction.
    pub damping_s_m: f64,
    /// Coulomb's coefficient of friction.
    pub friction: f64,
    /// Speed below which friction is viscous, in m/s; by default what suits the body.
    pub creep_m_s: Option<f64>,
}

/// A spring from a vertex to a point in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GrabConfig {
    /// The grab's name: another one of the same name takes its place.
    pub id: u64,
    /// The vertex (zero-based).
    pub vertex: u32,
    /// Where it is pulled to, in m.
    pub target_m: [f64; 3],
    /// Stiffness in N/m.
    pub stiffness_n_m: f64,
    /// Damping in N·s/m.
    pub damping_n_s_m: f64,
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
    /// Rigid motion of a body that nothing holds: a point of the mesh is at translation (m) + rotation (unit
    /// quaternion x, y, z, w) · (rest position + displacement).
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
    /// Grabs that hold on.
    pub n_grabs: usize,
    /// The sum of what grabs and obstacles pull with in N, in the world.
    pub interaction_force_n: [f64; 3],
    /// Why it no longer runs, if it failed.
    pub error: Option<Arc<StoreError>>,
}

/// The frames of one session, from one simulation to the next.
pub(crate) struct FrameSource {
    sender: broadcast::Sender<Arc<Frame>>,
    next_sequence: AtomicU64,
}

impl FrameSource {
    /// A subscriber may fall `backlog` frames behind before it loses the oldest.
    pub(crate) fn new(backlog: usize) -> Self {
        Self { sender: broadcast::Sender::new(backlog), next_sequence: AtomicU64::new(0) }
    }

    pub(crate) fn subscribe(&self) -> broadcast::Receiver<Arc<Frame>> {
        self.sender.subscribe()
    }

    pub(crate) fn publish(&self, time_s: f64, generation: u64, rigid: [f64; 7], q: &[f64]) {
        let frame = Frame {
            sequence: self.next_sequence.fetch_add(1, Ordering::Relaxed),
            time_s,
            generation,
            rigid,
            q: q.iter().map(|&x| (x as f32).clamp(f32::MIN, f32::MAX)).collect(),
        };
        // Sending fails only when nobody listens.
        let _ = self.sender.send(Arc::new(frame));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::broadcast::error::TryRecvError;

    const HELD: [f64; 7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];

    #[test]
    fn a_slow_subscriber_loses_the_oldest_frames_and_holds_up_nobody() {
        let source = FrameSource::new(4);
        let mut slow = source.subscribe();
        for step in 0..10 {
            source.publish(f64::from(step), 0, HELD, &[1.0]);
        }
        assert_eq!(slow.try_recv(), Err(TryRecvError::Lagged(6)));
        let kept: Vec<u64> =
            std::iter::from_fn(|| slow.try_recv().ok().map(|f| f.sequence)).collect();
        assert_eq!(kept, [6, 7, 8, 9]);
    }

    #[test]
    fn a_frame_holds_finite_numbers_even_where_single_precision_ends() {
        let source = FrameSource::new(1);
        let mut frames = source.subscribe();
        source.publish(0.0, 0, HELD, &[1e300, -1e300, 0.5]);
        assert_eq!(frames.try_recv().unwrap().q, [f32::MAX, f32::MIN, 0.5]);
    }
}
