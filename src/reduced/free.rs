//! Substeps of a body that nothing holds: deformation and frame together.
//!
//! The frame moves by the trapezoidal rule where the deformation does: gravity, forces at vertices and grabs act
//! with the mean of what they do at the two ends of the step; contact pushes as at the last end
//! ([`crate::step::Scheme::ends`] says why).

use crate::frame::{FreeBody, Motion, inertial_load};
use crate::interaction::{Placement, VertexRows, Wrench};
use crate::simulation::{Advanced, Integrator, Simulation};
use crate::step::{RigidPart, Scheme, State, Stepped};
use nalgebra::Vector3;

/// Passes over a step of a free body: the first with the frame's motion before it, the second with the mean of
/// before and after (or with what is after, for backward Euler).
const FRAME_PASSES: usize = 2;

/// What acts on a body during a step.
#[derive(Clone, Copy)]
pub(crate) struct Load<'a> {
    /// Reduced, in the body's frame.
    pub(crate) force: &'a [f64],
    /// At vertices, in the world.
    pub(crate) at_vertices: &'a [(&'a VertexRows, [f64; 3])],
}

/// The beginning of a substep.
struct Start<'a> {
    state: &'a State,
    motion: &'a Motion,
    body: &'a FreeBody,
    /// Reduced force of the grabs.
    grabbed: Vec<f64>,
    /// Force and torque of the grabs, in the world.
    pull: Wrench,
}

/// The frame's motion as a pass over a step takes it.
struct Pass {
    /// Angular velocity that the frame turns with, and the one at the end.
    omega: [Vector3<f64>; 2],
    angular_acceleration: Vector3<f64>,
    q: Vec<f64>,
    velocity: Vec<f64>,
    /// What acts over the step of grabs and obstacles, in the world.
    pull: Wrench,
}

/// What a pass comes to.
struct Passed {
    next: Stepped,
    motion: Motion,
    /// What acted over the step of grabs and obstacles, in the world.
    pull: Wrench,
    /// What they pull with at its end, in the world.
    force_n: Vector3<f64>,
}

impl Simulation {
    /// One substep of a free body; `None` if it fails.
    pub(crate) fn advance_free(
        &self,
        state: &State,
        motion: &Motion,
        body: &FreeBody,
        load: Load<'_>,
        dt: f64,
        n_newton: &mut u32,
    ) -> Option<Advanced> {
        let omega = motion.angular_velocity(body, &state.q, &state.velocity)?;
        let grabs = self.grabs_at(&Placement::free(body, motion, omega), state);
        let pull = grabs.total.map(|total| motion.frame.rotation * total);
        let start = Start { state, motion, body, grabbed: grabs.force, pull };
        let mut pass = Pass {
            omega: [omega, omega],
            angular_acceleration: motion.angular_acceleration,
            q: state.q.clone(),
            velocity: state.velocity.clone(),
            pull: [Vector3::zeros(); 2],
        };
        let mut found = None;
        for _ in 0..FRAME_PASSES {
            let Passed { next, motion: moved, pull, force_n } =
                self.pass(&start, &pass, load, dt, n_newton)?;
            let Stepped { state: next, error, .. } = next;
            let after = moved.angular_velocity(body, &next.q, &next.velocity)?;
            // What the frame moves with.
            let share = if self.takes_means() { 0.5 } else { 1.0 };
            let between = |a: &[f64], b: &[f64]| -> Vec<f64> {
                a.iter().zip(b).map(|(a, b)| a + share * (b - a)).collect()
            };
            let angular_acceleration = (after - omega) / dt;
            pass = Pass {
                omega: [omega + (after - omega) * share, after],
                angular_acceleration,
                q: between(&state.q, &next.q),
                velocity: between(&state.velocity, &next.velocity),
                pull,
            };
            let motion = Some(Motion { angular_acceleration, ..moved });
            found = Some(Advanced { deformation: next, motion, force_n, error });
        }
        found
    }

    /// Whether what acts on a free body acts as its mean over the step, and not as at its end.
    fn takes_means(&self) -> bool {
        self.params().integrator != Integrator::BackwardEuler
    }

    /// A substep, the frame being expected to move as `pass` says.
    fn pass(
        &self,
        start: &Start<'_>,
        pass: &Pass,
        load: Load<'_>,
        dt: f64,
        n_newton: &mut u32,
    ) -> Option<Passed> {
        let Start { state, motion, body, grabbed, pull: before } = start;
        let scheme = self.scheme().unwrap_or(Scheme::Newmark);
        let [rate, _] = scheme.rates(dt);
        let place = |q: &[f64], vertex: &VertexRows| {
            Vector3::from(vertex.rest_m) - body.center_m() + vertex.times(q)
        };
        // Known: gravity, forces at vertices, and what pulled in the pass before.
        let gravity = Vector3::from(self.params().gravity_m_s2) * body.mass_kg();
        let given = load.at_vertices.iter().map(|(_, f)| Vector3::from(*f)).sum::<Vector3<f64>>();
        let known = gravity + given + pass.pull[0];
        let mut frame = motion.moved(body, &pass.omega[0], dt);
        frame.position_m += known / (body.mass_kg() * rate / dt);
        let velocity = motion.velocity(body) + known * (dt / body.mass_kg());
        let into = frame.rotation.inverse();
        let placement = Placement {
            frame,
            origin: body.center_m(),
            velocity: into * velocity,
            omega: pass.omega[1],
        };
        let inertial = inertial_load(
            body,
            &pass.q,
            &pass.velocity,
            &pass.omega[0],
            &pass.angular_acceleration,
        );
        let mut reduced: Vec<f64> = inertial.iter().map(|inertial| -inertial).collect();
        reduced.iter_mut().zip(load.force).for_each(|(load, f)| *load += f);
        // What forces at vertices do at the ends of the step.
        let first = match self.takes_means() {
            true => Placement { frame: motion.frame, ..placement },
            false => placement,
        };
        for end in [&first, &placement] {
            add_vertex_loads(&mut reduced, load.at_vertices, end, 0.5);
        }
        let rigid = RigidPart {
            mass_kg: body.mass_kg(),
            inertia: body.inertia(&pass.q),
            expected: pass.pull.map(|pull| into * pull),
            before: before.map(|pull| into * pull),
        };
        let next = self.solve(state, &reduced, grabbed, placement, Some(rigid), dt, n_newton)?;

        let frame = next.placement.frame;
        let first_q = if self.takes_means() { &state.q } else { &next.state.q };
        // Exact oscillators are pulled at as at the step's beginning, and nothing else.
        let ends = self.scheme().map_or(1.0, Scheme::ends);
        let acting = |k: usize| {
            (frame.rotation * next.grabs[k] + before[k] * (ends - 1.0)) / ends
                + frame.rotation * next.contact[k]
        };
        let pull = [acting(0), acting(1)];
        let mut torque = pull[1];
        for (vertex, f) in load.at_vertices {
            for (rotation, q) in [(first.frame.rotation, first_q), (frame.rotation, &next.state.q)]
            {
                torque += (rotation * place(q, vertex)).cross(&Vector3::from(*f)) * 0.5;
            }
        }
        let momentum = motion.momentum + (pull[0] + given + gravity) * dt;
        let angular_momentum = motion.angular_momentum + torque * dt;
        let finite = momentum.iter().chain(&angular_momentum).all(|x| x.is_finite());
        let motion = Motion { frame, momentum, angular_momentum, ..**motion };
        let force_n = frame.rotation * (next.grabs[0] + next.contact[0]);
        finite.then_some(Passed { next, motion, pull, force_n })
    }
}

/// Adds `share` of what forces in N in the world do at vertices of the placed body.
pub(crate) fn add_vertex_loads(
    load: &mut [f64],
    at_vertices: &[(&VertexRows, [f64; 3])],
    placement: &Placement,
    share: f64,
) {
    for (vertex, f) in at_vertices {
        let f = placement.turned(*f) * share;
        for (load, row) in load.iter_mut().zip(&vertex.rows) {
            *load += Vector3::from(*row).dot(&f);
        }
    }
}
