//! Simulations, forces and published states.

use crate::problem::{Kind, Problem};
use sutura_core::reduced::contact::Obstacle;
use sutura_core::reduced::{Integrator, SimulationParams};
use sutura_proto::simulation as wire;
use sutura_proto::state::StateFrame;
use sutura_store::{
    ContactConfig, Frame, GrabConfig, SimulationConfig, SimulationInfo, VertexForce,
};

/// The configuration as the store takes it.
pub(crate) fn config(config: wire::SimulationConfig) -> Result<SimulationConfig, Problem> {
    config.validate()?;
    Ok(SimulationConfig {
        params: SimulationParams {
            dt_s: config.dt_s,
            integrator: match config.integrator {
                wire::IntegratorConfig::ImplicitNewmark => Integrator::ImplicitNewmark,
                wire::IntegratorConfig::BackwardEuler => Integrator::BackwardEuler,
                wire::IntegratorConfig::ModalOscillators => Integrator::ModalOscillators,
                wire::IntegratorConfig::QuasiStatic => Integrator::QuasiStatic,
            },
            gravity_m_s2: config.gravity_m_s2,
            substep_tolerance: config.substep_tolerance,
        },
        obstacles: config.obstacles.iter().map(obstacle).collect(),
        contact: ContactConfig {
            stiffness_pa_m: config.contact.stiffness_pa_m,
            damping_s_m: config.contact.damping_s_m,
            friction: config.contact.friction,
            creep_m_s: config.contact.creep_m_s,
        },
        publish_hz: config.publish_hz,
    })
}

fn obstacle(given: &wire::Obstacle) -> Obstacle {
    match *given {
        wire::Obstacle::Plane { point_m, normal } => Obstacle::Plane { point_m, normal },
        wire::Obstacle::Sphere { center_m, radius_m } => Obstacle::Sphere { center_m, radius_m },
        wire::Obstacle::Capsule { from_m, to_m, radius_m } => {
            Obstacle::Capsule { from_m, to_m, radius_m }
        }
    }
}

fn wire_obstacle(given: &Obstacle) -> wire::Obstacle {
    match *given {
        Obstacle::Plane { point_m, normal } => wire::Obstacle::Plane { point_m, normal },
        Obstacle::Sphere { center_m, radius_m } => wire::Obstacle::Sphere { center_m, radius_m },
        Obstacle::Capsule { from_m, to_m, radius_m } => {
            wire::Obstacle::Capsule { from_m, to_m, radius_m }
        }
    }
}

fn wire_config(config: &SimulationConfig) -> wire::SimulationConfig {
    wire::SimulationConfig {
        dt_s: config.params.dt_s,
        integrator: match config.params.integrator {
            Integrator::ImplicitNewmark => wire::IntegratorConfig::ImplicitNewmark,
            Integrator::BackwardEuler => wire::IntegratorConfig::BackwardEuler,
            Integrator::ModalOscillators => wire::IntegratorConfig::ModalOscillators,
            Integrator::QuasiStatic => wire::IntegratorConfig::QuasiStatic,
        },
        gravity_m_s2: config.params.gravity_m_s2,
        substep_tolerance: config.params.substep_tolerance,
        obstacles: config.obstacles.iter().map(wire_obstacle).collect(),
        contact: wire::ContactConfig {
            stiffness_pa_m: config.contact.stiffness_pa_m,
            damping_s_m: config.contact.damping_s_m,
            friction: config.contact.friction,
            creep_m_s: config.contact.creep_m_s,
        },
        publish_hz: config.publish_hz,
    }
}

/// The simulation's description; one that has failed is a problem instead.
pub(crate) fn info(info: &SimulationInfo) -> Result<wire::SimulationInfo, Problem> {
    if let Some(error) = &info.error {
        return Err(Problem::from(error.as_ref()));
    }
    Ok(wire::SimulationInfo {
        config: wire_config(&info.config),
        generation: info.generation,
        time_s: info.time_s,
        sequence: info.n_frames,
        n_steps: info.n_steps,
        n_recovered: info.n_recovered_steps,
        n_late: info.n_late_steps,
        n_forces: info.n_active_forces,
        n_grabs: info.n_grabs,
        interaction_force_n: info.interaction_force_n,
    })
}

/// The forces as the store takes them.
pub(crate) fn forces(request: wire::ForceRequest) -> Result<Vec<VertexForce>, Problem> {
    request.validate()?;
    let force = |force: wire::Force| VertexForce {
        vertex: force.vertex,
        force_n: force.force_n,
        duration_s: force.duration_s,
    };
    Ok(request.forces.into_iter().map(force).collect())
}

/// The grabs as the store takes them, and the names of those to let go.
pub(crate) fn grabs(request: wire::GrabRequest) -> Result<(Vec<GrabConfig>, Vec<u64>), Problem> {
    request.validate()?;
    let grab = |grab: wire::Grab| GrabConfig {
        id: grab.id,
        vertex: grab.vertex,
        target_m: grab.target_m,
        stiffness_n_m: grab.stiffness_n_m,
        damping_n_s_m: grab.damping_n_s_m,
    };
    Ok((request.grabs.into_iter().map(grab).collect(), request.release))
}

/// The published state as bytes.
pub(crate) fn state(frame: &Frame) -> Result<Vec<u8>, Problem> {
    let frame = StateFrame {
        // The contract counts from 1.
        sequence: frame.sequence + 1,
        time_s: frame.time_s,
        generation: frame.generation,
        rigid: frame.rigid,
        q: frame.q.clone(),
    };
    frame.encode().map_err(|error| Problem::new(Kind::Internal, error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn configurations_survive_the_way_there_and_back() {
        let given = wire::SimulationConfig {
            dt_s: 0.02,
            gravity_m_s2: [1.0, 2.0, 3.0],
            substep_tolerance: Some(1e-3),
            publish_hz: 25.0,
            integrator: wire::IntegratorConfig::BackwardEuler,
            obstacles: vec![
                wire::Obstacle::Plane { point_m: [0.0; 3], normal: [0.0, 1.0, 0.0] },
                wire::Obstacle::Sphere { center_m: [1.0, 2.0, 3.0], radius_m: 0.5 },
                wire::Obstacle::Capsule { from_m: [0.0; 3], to_m: [1.0; 3], radius_m: 0.1 },
            ],
            contact: wire::ContactConfig { stiffness_pa_m: Some(1e7), ..Default::default() },
        };
        assert_eq!(wire_config(&config(given.clone()).unwrap()), given);
    }

    #[test]
    fn impossible_steps_and_forces_are_pointed_at() {
        let given = wire::SimulationConfig { dt_s: f64::NAN, ..Default::default() };
        assert_eq!(config(given).unwrap_err().pointer.as_deref(), Some("/dt_s"));
        let force = wire::Force { vertex: 0, force_n: [0.0, f64::INFINITY, 0.0], duration_s: 1.0 };
        let problem = forces(wire::ForceRequest { forces: vec![force] }).unwrap_err();
        assert_eq!(
            (problem.status(), problem.pointer.as_deref()),
            (422, Some("/forces/0/force_n/1"))
        );
    }

    #[test]
    fn frames_decode_to_what_the_store_published() {
        let frame = Frame {
            sequence: 3,
            time_s: 0.5,
            generation: 2,
            rigid: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            q: vec![1.0, -2.0],
        };
        let decoded = StateFrame::decode(&state(&frame).unwrap()).unwrap();
        assert_eq!((decoded.sequence, decoded.generation), (4, 2));
        assert_eq!((decoded.q, decoded.rigid), (frame.q, frame.rigid));
    }
}
