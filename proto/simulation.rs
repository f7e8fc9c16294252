//! Simulations and the forces on them. [`ForceRequest`] also travels as bincode.

use crate::problem::{Invalid, all_finite, within};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Longest time step in s.
pub const MAX_DT_S: f64 = 1.0;
/// Most states published per second.
pub const MAX_PUBLISH_HZ: f64 = 1000.0;
/// Most forces in one request.
pub const MAX_FORCES: usize = 1024;
/// Longest a force may act, in s of simulated time.
pub const MAX_DURATION_S: f64 = 3600.0;

/// How a session is simulated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulationConfig {
    /// Time step in s. Default: 0.01.
    pub dt_s: f64,
    /// The integrator. Default: `implicit_newmark`.
    pub integrator: IntegratorConfig,
    /// Gravity in m/s². Default: (0, −9.81, 0).
    pub gravity_m_s2: [f64; 3],
    /// States published per second. Default: 60.
    pub publish_hz: f64,
}

impl Default for SimulationConfig {
    fn default() -> Self {
        SimulationConfig {
            dt_s: 0.01,
            integrator: IntegratorConfig::default(),
            gravity_m_s2: [0.0, -9.81, 0.0],
            publish_hz: 60.0,
        }
    }
}

/// How the reduced equations of motion are integrated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum IntegratorConfig {
    /// Newmark with β = 1/4, γ = 1/2: second order, keeps energy.
    #[default]
    ImplicitNewmark,
    /// Backward Euler: first order, calms fast motion.
    BackwardEuler,
    /// Linear modes as exact damped oscillators, for small deformations; grabs and contact act as
    /// they were at the start of each step.
    ModalOscillators,
    /// Static equilibrium at the end of each step: no inertia. For bodies that are held.
    QuasiStatic,
}

impl SimulationConfig {
    /// Refuses steps and rates that no simulation could run at.
    pub fn validate(&self) -> Result<(), Invalid> {
        within("/dt_s", self.dt_s, 1e-6, MAX_DT_S)?;
        within("/publish_hz", self.publish_hz, 1e-3, MAX_PUBLISH_HZ)?;
        for (axis, g) in self.gravity_m_s2.iter().enumerate() {
            within(&format!("/gravity_m_s2/{axis}"), *g, -1e6, 1e6)?;
        }
        Ok(())
    }
}

/// A running simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SimulationInfo {
    /// How it runs, defaults filled in.
    pub config: SimulationConfig,
    /// The generation it steps.
    pub generation: u64,
    /// Simulated time in s.
    pub time_s: f64,
    /// The number of the latest published state.
    pub sequence: u64,
    /// Steps taken.
    pub n_steps: u64,
    /// Steps that had to be undone, the body brought to rest.
    pub n_recovered: u64,
    /// Steps that could not be taken in time: simulated time fell behind by so many `dt_s`.
    pub n_late: u64,
    /// Forces acting now.
    pub n_forces: usize,
}

/// Forces to be added to those already acting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ForceRequest {
    /// The forces.
    pub forces: Vec<Force>,
}

/// A force on one vertex for some time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Force {
    /// The vertex (zero-based).
    pub vertex: u32,
    /// The force in N.
    pub force_n: [f64; 3],
    /// For how long, in s of simulated time.
    pub duration_s: f64,
}

impl ForceRequest {
    /// Refuses numbers that are not finite, durations below zero and lists that are too long.
    pub fn validate(&self) -> Result<(), Invalid> {
        if self.forces.is_empty() || self.forces.len() > MAX_FORCES {
            return Err(Invalid::new("/forces", format!("must hold 1 to {MAX_FORCES} forces")));
        }
        for (i, force) in self.forces.iter().enumerate() {
            all_finite(&format!("/forces/{i}/force_n"), &force.force_n)?;
            let pointer = format!("/forces/{i}/duration_s");
            within(&pointer, force.duration_s, 0.0, MAX_DURATION_S)?;
        }
        Ok(())
    }
}
