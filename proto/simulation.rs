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
/// Most obstacles of one simulation.
pub const MAX_OBSTACLES: usize = 1024;
/// Most grabs in one request.
pub const MAX_GRABS: usize = 256;
/// Longest a force may act, in s of simulated time.
pub const MAX_DURATION_S: f64 = 3600.0;

/// How a session is simulated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulationConfig {
    /// Time step in s. Default: 0.01.
    pub dt_s: f64,
    /// The integrator. Default: `implicit_newmark`.
    pub integrator: IntegratorConfig,
    /// Gravity in m/s². Default: (0, −9.81, 0).
    pub gravity_m_s2: [f64; 3],
    /// Relative error of the deformation that a step may add, by estimate: steps with more of it are split, into 64 parts
    /// at most. Between 0 and 1. Default: none, steps are split only where they cannot be solved.
    pub substep_tolerance: Option<f64>,
    /// What the body cannot enter. Default: nothing.
    pub obstacles: Vec<Obstacle>,
    /// How obstacles push back.
    pub contact: ContactConfig,
    /// States published per second. Default: 60.
    pub publish_hz: f64,
}

impl Default for SimulationConfig {
    fn default() -> Self {
        SimulationConfig {
            dt_s: 0.01,
            integrator: IntegratorConfig::default(),
            gravity_m_s2: [0.0, -9.81, 0.0],
            substep_tolerance: None,
            obstacles: Vec::new(),
            contact: ContactConfig::default(),
            publish_hz: 60.0,
        }
    }
}

/// Something rigid that the body cannot enter, at rest in the world until a simulation is changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Obstacle {
    /// Everything on the far side of a plane.
    Plane {
        /// A point of the plane, in m.
        point_m: [f64; 3],
        /// The side on which the body may be; any length but zero.
        normal: [f64; 3],
    },
    /// A ball.
    Sphere {
        /// Its centre, in m.
        center_m: [f64; 3],
        /// Its radius, in m.
        radius_m: f64,
    },
    /// All points within a radius of a line segment.
    Capsule {
        /// One end of the segment, in m.
        from_m: [f64; 3],
        /// The other end, in m.
        to_m: [f64; 3],
        /// Its radius, in m.
        radius_m: f64,
    },
}

/// How obstacles push back at the vertices of the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ContactConfig {
    /// Pressure for each metre of depth, in Pa/m. Default: the stiffest Young's modulus over a tenth of the
    /// body's size.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_pa_m: Option<f64>,
    /// At 1 m/s into the obstacle the pressure grows by this fraction. Default: 1.
    pub damping_s_m: f64,
    /// Coulomb's coefficient of friction. Default: 0.3.
    pub friction: f64,
    /// Speed in m/s below which friction grows with the speed: what sticks creeps. Default: a hundredth
    /// of the body's size a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub creep_m_s: Option<f64>,
}

impl Default for ContactConfig {
    fn default() -> Self {
        ContactConfig { stiffness_pa_m: None, damping_s_m: 1.0, friction: 0.3, creep_m_s: None }
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
        if let Some(tolerance) = self.substep_tolerance
            && !(tolerance > 0.0 && tolerance < 1.0)
        {
            return Err(Invalid::new("/substep_tolerance", "must lie between 0 and 1"));
        }
        if self.obstacles.len() > MAX_OBSTACLES {
            return Err(Invalid::new("/obstacles", format!("at most {MAX_OBSTACLES}")));
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
    /// Grabs that hold on.
    pub n_grabs: usize,
    /// The sum of what grabs and obstacles pull with, in N.
    pub interaction_force_n: [f64; 3],
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

/// Vertices to be held on to, and grabs to be let go.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GrabRequest {
    /// Grabs that take hold; one of the name of an earlier one takes its place, so that a tool is moved by
    /// sending its grab again.
    pub grabs: Vec<Grab>,
    /// Names of grabs that let go; those that are not there are passed over.
    pub release: Vec<u64>,
}

/// A damped spring from a vertex to a point in the world: a hand, or a surgical tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Grab {
    /// The grab's name, for the caller to choose.
    pub id: u64,
    /// The vertex (zero-based).
    pub vertex: u32,
    /// Where it is pulled to, in m.
    pub target_m: [f64; 3],
    /// Stiffness in N/m.
    pub stiffness_n_m: f64,
    /// Damping in N·s/m. Default: 0.
    #[serde(default)]
    pub damping_n_s_m: f64,
}

impl GrabRequest {
    /// Refuses numbers that are not finite, and requests that are empty or too long.
    pub fn validate(&self) -> Result<(), Invalid> {
        if self.grabs.is_empty() && self.release.is_empty() {
            return Err(Invalid::new("/grabs", "nothing to take hold of or to let go"));
        }
        for (pointer, n) in [("/grabs", self.grabs.len()), ("/release", self.release.len())] {
            if n > MAX_GRABS {
                return Err(Invalid::new(pointer, format!("at most {MAX_GRABS}")));
            }
        }
        for (i, grab) in self.grabs.iter().enumerate() {
            all_finite(&format!("/grabs/{i}/target_m"), &grab.target_m)?;
            within(&format!("/grabs/{i}/stiffness_n_m"), grab.stiffness_n_m, 0.0, 1e12)?;
            within(&format!("/grabs/{i}/damping_n_s_m"), grab.damping_n_s_m, 0.0, 1e12)?;
        }
        Ok(())
    }
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
