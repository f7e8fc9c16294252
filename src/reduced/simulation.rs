//! Simulation in the subspace: q̈ + D q̇ + f(q) = f_ext with UᵀMU = I and Rayleigh damping D = αI + βK̃(0)
//! (\[B12\] §3.1), in real time and without ever leaving a number that is not finite.

use crate::ReducedModel;
use crate::contact::{Contact, ContactSurface, Obstacle};
use crate::dense::DenseError;
use crate::frame::{Frame, Motion};
use crate::free::{Load, add_vertex_loads};
use crate::interaction::{Effect, Grab, Interactions, Placement, Pull, VertexRows};
use crate::modal::Oscillators;
use crate::step::{RigidPart, Scheme, State, Step, Stepped};
use crate::substeps::Division;
use faer::Mat;
use nalgebra::Vector3;
use std::sync::Arc;

/// How the reduced equations of motion are integrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integrator {
    /// Newmark with β = 1/4, γ = 1/2 (average acceleration): second order, keeps energy. Contact acts as at the end of
    /// each step: to first order, and never gives energy back that it has not taken.
    ImplicitNewmark,
    /// Backward Euler: first order, calms fast motion.
    BackwardEuler,
    /// Linear modes as exact damped oscillators: any step, small deformations; grabs and contact act
    /// as they were at the start of the step.
    ModalOscillators,
    /// Static equilibrium at the end of each step: no inertia.
    QuasiStatic,
}

/// Parameters of a [`Simulation`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationParams {
    /// Time step in s.
    pub dt_s: f64,
    /// The integrator.
    pub integrator: Integrator,
    /// Gravity in m/s².
    pub gravity_m_s2: [f64; 3],
    /// Relative error of the deformation that a step may add, by estimate: steps with more of it are split (where
    /// 1/64 of a step is not enough, no further). Between 0 and 1; `None` takes every step whole that can be solved.
    pub substep_tolerance: Option<f64>,
}

impl SimulationParams {
    /// Refuses what no simulation can run with.
    pub fn check(&self) -> Result<(), SimulationError> {
        if !(self.dt_s > 0.0 && self.dt_s <= 1.0) {
            return Err(SimulationError::TimeStep(self.dt_s));
        }
        if self.gravity_m_s2.iter().any(|g| !g.is_finite()) {
            return Err(SimulationError::Gravity);
        }
        match self.substep_tolerance {
            Some(tolerance) if !(tolerance > 0.0 && tolerance < 1.0) => {
                Err(SimulationError::SubstepTolerance(tolerance))
            }
            _ => Ok(()),
        }
    }
}

/// What surrounds the body.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    /// What it cannot enter.
    pub obstacles: Vec<Obstacle>,
    /// How those push back.
    pub contact: Contact,
}

/// What one step went through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepReport {
    /// Newton iterations over all substeps.
    pub n_newton: u32,
    /// Substeps that were taken, 1 for a step as a whole; of a step that was undone, those before it failed.
    pub n_substeps: u32,
    /// No substep size worked: the step was undone and the body brought to rest where it was.
    pub recovered: bool,
}

/// Why a simulation cannot run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum SimulationError {
    #[error("dt_s must be positive and at most 1 s, not {0}")]
    TimeStep(f64),
    #[error("gravity_m_s2 must be finite")]
    Gravity,
    #[error("substep_tolerance must lie between 0 and 1, not {0}")]
    SubstepTolerance(f64),
    #[error(
        "{n_rigid_modes} rigid motions are left, but not those of a whole body: fix vertices, or stitch every component to the others"
    )]
    PartlyFree { n_rigid_modes: usize },
    #[error("a body that nothing holds has no static equilibrium: fix vertices")]
    NoEquilibrium,
    #[error("the transfer matrix has {given} entries, not {expected}")]
    Transfer { given: usize, expected: usize },
    #[error(transparent)]
    Dense(#[from] DenseError),
}

/// A running simulation of one reduced model.
pub struct Simulation {
    model: Arc<ReducedModel>,
    params: SimulationParams,
    time_s: f64,
    state: State,
    /// Of a body that nothing holds.
    motion: Option<Motion>,
    damping: Mat<f64>,
    oscillators: Option<Oscillators>,
    grabs: Vec<Grab>,
    environment: Option<Arc<Environment>>,
    surface: Option<Arc<ContactSurface>>,
    /// What grabs and obstacles pulled with at the end of the last step, in the world.
    interaction_force_n: [f64; 3],
    /// Halvings that the last substep had, where errors are looked at.
    halvings: u32,
}

/// What a substep ends with.
#[derive(Clone)]
pub(crate) struct Advanced {
    pub(crate) deformation: State,
    /// Of a free body.
    pub(crate) motion: Option<Motion>,
    /// Of grabs and obstacles, in the world.
    pub(crate) force_n: Vector3<f64>,
    /// Estimate of the relative error that the substep added to the deformation.
    pub(crate) error: f64,
}

impl Simulation {
    /// At rest at q = 0.
    pub fn new(
        model: Arc<ReducedModel>,
        params: SimulationParams,
    ) -> Result<Simulation, SimulationError> {
        params.check()?;
        let motion = motion_of(&model, &params)?;
        let mut simulation = Simulation {
            state: State::at_rest(model.r()),
            damping: model.damping_matrix(),
            model,
            params,
            time_s: 0.0,
            motion,
            oscillators: None,
            grabs: Vec::new(),
            environment: None,
            surface: None,
            interaction_force_n: [0.0; 3],
            halvings: 0,
        };
        simulation.prepare_oscillators()?;
        Ok(simulation)
    }

    /// Advances by `dt_s` under the reduced external force `force` (r numbers, in the body's frame; or none) and forces in N at
    /// vertices (in the world); gravity, grabs and contact are added. Never leaves a non-finite state behind: a step
    /// that fails is split, and if no split works it is undone and the body brought to rest where it was.
    pub fn step(&mut self, force: &[f64], at_vertices: &[(&VertexRows, [f64; 3])]) -> StepReport {
        self.time_s += self.params.dt_s;
        let mut report = StepReport::default();
        let is_finite = force.iter().chain(at_vertices.iter().flat_map(|(_, f)| f));
        if is_finite.into_iter().all(|x| x.is_finite()) {
            let mut division = Division::begin(self.halvings);
            let mut at = Advanced {
                deformation: self.state.clone(),
                motion: self.motion,
                force_n: Vector3::zeros(),
                error: 0.0,
            };
            while let Some(share) = division.next() {
                let dt = self.params.dt_s * share;
                let next = self.advance(&at, force, at_vertices, dt, &mut report.n_newton);
                let error = match (&next, self.params.substep_tolerance) {
                    (None, _) => None,
                    (Some(_), None) => Some(0.0),
                    (Some(next), Some(tolerance)) => Some(next.error / tolerance),
                };
                if division.accepts(error)
                    && let Some(next) = next
                {
                    at = next;
                    report.n_substeps += 1;
                }
            }
            if !division.has_failed() {
                self.halvings =
                    if self.params.substep_tolerance.is_some() { division.halvings() } else { 0 };
                self.state = at.deformation;
                self.motion = at.motion;
                self.interaction_force_n = at.force_n.into();
                return report;
            }
        }
        report.recovered = true;
        self.rest();
        report
    }

    /// Brings the body to rest where it is.
    fn rest(&mut self) {
        self.state.velocity.fill(0.0);
        self.state.acceleration.fill(0.0);
        self.state.contact.fill(0.0);
        if let Some(motion) = &mut self.motion {
            *motion = Motion {
                frame: motion.frame,
                momentum: Vector3::zeros(),
                angular_momentum: Vector3::zeros(),
                angular_acceleration: Vector3::zeros(),
            };
        }
    }

    /// One substep; `None` if it fails.
    fn advance(
        &self,
        start: &Advanced,
        force: &[f64],
        at_vertices: &[(&VertexRows, [f64; 3])],
        dt: f64,
        n_newton: &mut u32,
    ) -> Option<Advanced> {
        let state = &start.deformation;
        if let Some((motion, body)) = start.motion.as_ref().zip(self.model.free_body()) {
            let load = Load { force, at_vertices };
            return self.advance_free(state, motion, body, load, dt, n_newton);
        }
        let placement = Placement::fixed();
        let mut load = self.model.gravity_load(self.params.gravity_m_s2);
        load.iter_mut().zip(force).for_each(|(load, f)| *load += f);
        add_vertex_loads(&mut load, at_vertices, &placement, 1.0);
        let grabbed = self.grabs_at(&placement, state).force;
        let next = self.solve(state, &load, &grabbed, placement, None, dt, n_newton)?;
        Some(Advanced {
            deformation: next.state,
            motion: None,
            force_n: next.grabs[0] + next.contact[0],
            error: next.error,
        })
    }

    /// What grabs pull with at `state` of the placed body.
    pub(crate) fn grabs_at(&self, placement: &Placement, state: &State) -> Effect {
        let grabs = self.interactions().without_contact();
        grabs.pull(placement, &state.q, &state.velocity, None).grabs
    }

    /// The scheme of implicit steps; none of exact oscillators.
    pub(crate) fn scheme(&self) -> Option<Scheme> {
        match self.params.integrator {
            Integrator::ImplicitNewmark => Some(Scheme::Newmark),
            Integrator::BackwardEuler => Some(Scheme::BackwardEuler),
            Integrator::QuasiStatic => Some(Scheme::QuasiStatic),
            Integrator::ModalOscillators => None,
        }
    }

    /// The deformation after a substep under `load`, and where the frame comes to be; `grabbed` is the reduced force
    /// of the grabs at its beginning.
    #[allow(clippy::too_many_arguments)] // one for each thing that a step depends on
    pub(crate) fn solve(
        &self,
        state: &State,
        load: &[f64],
        grabbed: &[f64],
        placement: Placement,
        rigid: Option<RigidPart>,
        dt: f64,
        n_newton: &mut u32,
    ) -> Option<Stepped> {
        let interactions = self.interactions();
        let Some(scheme) = self.scheme() else {
            let Pull { grabs, contact, .. } =
                interactions.pull(&placement, &state.q, &state.velocity, None);
            let forces = load.iter().zip(&grabs.force).zip(&contact.force);
            let pulled: Vec<f64> = forces.map(|((load, a), b)| load + a + b).collect();
            let oscillators = self.oscillators.as_ref()?;
            let [q, velocity] =
                oscillators.advance(&self.model, &state.q, &state.velocity, &pulled, dt);
            let state = State { q, velocity, load: pulled, ..State::at_rest(load.len()) };
            let (grabs, contact) = (grabs.total, contact.total);
            let next = Stepped { state, placement, grabs, contact, error: 0.0 };
            return next.state.is_finite().then_some(next);
        };
        let step = Step {
            model: &self.model,
            damping: &self.damping,
            scheme,
            load,
            grabbed,
            interactions: &interactions,
            placement,
            rigid: rigid.filter(|_| !interactions.are_none()),
            dt,
        };
        step.from(state, n_newton).filter(|next| next.state.is_finite())
    }

    pub(crate) fn interactions(&self) -> Interactions<'_> {
        let environment = self.environment.as_deref();
        let contact = environment.zip(self.surface.as_deref()).filter(|(environment, surface)| {
            !environment.obstacles.is_empty() && surface.r() == self.model.r()
        });
        Interactions {
            grabs: &self.grabs,
            obstacles: contact.map_or(&[], |(environment, _)| &environment.obstacles),
            contact: contact.map(|(environment, surface)| (surface, environment.contact)),
            contact_weight: self.scheme().map_or(1.0, Scheme::ends),
        }
    }

    /// Changes the parameters from the next step on.
    pub fn set_params(&mut self, params: SimulationParams) -> Result<(), SimulationError> {
        params.check()?;
        motion_of(&self.model, &params)?;
        let was = std::mem::replace(&mut self.params, params);
        self.halvings = 0;
        if let Err(error) = self.prepare_oscillators() {
            self.params = was;
            return Err(error);
        }
        Ok(())
    }

    /// What pulls at vertices from the next step on, rows of the current basis (others are dropped).
    pub fn set_grabs(&mut self, mut grabs: Vec<Grab>) {
        grabs.retain(|grab| grab.vertex.rows.len() == self.model.r());
        self.grabs = grabs;
    }

    /// What surrounds the body from the next step on, and its surface in the current basis.
    pub fn set_environment(
        &mut self,
        environment: Option<Arc<Environment>>,
        surface: Option<Arc<ContactSurface>>,
    ) {
        self.environment = environment;
        self.surface = surface;
    }

    /// Carries state over to another generation: q, velocity and acceleration through `transfer`
    /// (r_new × r_old, row-major). Grabs and the surface belong to the old basis and are dropped: set
    /// them anew. A free body keeps its frame and its momenta.
    pub fn switch(
        &mut self,
        model: Arc<ReducedModel>,
        transfer: &[f64],
    ) -> Result<(), SimulationError> {
        let fresh = motion_of(&model, &self.params)?;
        let (new, old) = (model.r(), self.model.r());
        if transfer.len() != new * old {
            return Err(SimulationError::Transfer { given: transfer.len(), expected: new * old });
        }
        let carry = |x: &[f64]| -> Vec<f64> {
            transfer
                .chunks_exact(old)
                .map(|row| row.iter().zip(x).map(|(a, b)| a * b).sum())
                .collect()
        };
        self.state = State {
            q: carry(&self.state.q),
            velocity: carry(&self.state.velocity),
            acceleration: carry(&self.state.acceleration),
            load: carry(&self.state.load),
            contact: carry(&self.state.contact),
        };
        self.motion = fresh.map(|fresh| self.motion.unwrap_or(fresh));
        self.damping = model.damping_matrix();
        self.model = model;
        self.grabs.clear();
        self.surface = None;
        self.oscillators = None;
        self.prepare_oscillators()
    }

    fn prepare_oscillators(&mut self) -> Result<(), SimulationError> {
        let is_modal = self.params.integrator == Integrator::ModalOscillators;
        if is_modal && self.oscillators.is_none() {
            self.oscillators = Some(Oscillators::new(&self.model)?);
        }
        Ok(())
    }

    /// Simulated time in s.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }
    /// The parameters in force.
    pub fn params(&self) -> &SimulationParams {
        &self.params
    }
    /// Reduced coordinates.
    pub fn q(&self) -> &[f64] {
        &self.state.q
    }
    /// Reduced velocity in 1/s.
    pub fn velocity(&self) -> &[f64] {
        &self.state.velocity
    }
    /// What grabs and obstacles pulled with at the end of the last step that succeeded (for exact oscillators: at its
    /// beginning), in N, in the world.
    pub fn interaction_force_n(&self) -> [f64; 3] {
        self.interaction_force_n
    }

    /// The surface in the current basis, if there is one.
    pub fn surface(&self) -> Option<&Arc<ContactSurface>> {
        self.surface.as_ref()
    }

    fn placement(&self) -> Placement {
        match self.motion.as_ref().zip(self.model.free_body()) {
            None => Placement::fixed(),
            Some((motion, body)) => {
                let (q, velocity) = (&self.state.q, &self.state.velocity);
                let omega = motion.angular_velocity(body, q, velocity);
                Placement::free(body, motion, omega.unwrap_or_default())
            }
        }
    }

    /// Where a point of the mesh is: x = translation + rotation·(X + u). Position in m and unit
    /// quaternion (x, y, z, w); nothing and no rotation for a body that is held.
    pub fn rigid(&self) -> [f64; 7] {
        let Placement { frame: Frame { position_m, rotation }, origin, .. } = self.placement();
        let t = position_m - rotation * origin;
        let q = rotation.coords;
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
    }

    /// Linear momentum in kg·m/s and angular momentum about the centre of mass in kg·m²/s of a free
    /// body, from its motion: velocities, inertia and deformation.
    pub fn momenta(&self) -> Option<[[f64; 3]; 2]> {
        let (motion, body) = self.motion.as_ref().zip(self.model.free_body())?;
        let (q, velocity) = (&self.state.q, &self.state.velocity);
        let omega = motion.angular_velocity(body, q, velocity)?;
        let angular = body.inertia(q) * omega + body.spin(q, velocity);
        let linear = motion.velocity(body) * body.mass_kg();
        Some([linear.into(), (motion.frame.rotation * angular).into()])
    }

    /// Kinetic energy of the frame and the deformation, and strain energy, in J.
    pub fn energies_j(&self) -> [f64; 2] {
        let (q, velocity) = (&self.state.q, &self.state.velocity);
        let mut kinetic = 0.5 * velocity.iter().map(|v| v * v).sum::<f64>();
        if let Some((motion, body)) = self.motion.as_ref().zip(self.model.free_body()) {
            let omega = motion.angular_velocity(body, q, velocity).unwrap_or_default();
            kinetic += 0.5 * motion.momentum.norm_squared() / body.mass_kg()
                + 0.5 * omega.dot(&(body.inertia(q) * omega))
                + omega.dot(&body.spin(q, velocity));
        }
        [kinetic, self.model.sums(q, false).energy_j]
    }

    /// Sets a free body in motion: velocity of the centre of mass in m/s and angular velocity in 1/s (in the body's frame).
    /// Without effect on a body that is held.
    pub fn set_rigid_velocity(&mut self, velocity_m_s: [f64; 3], omega_per_s: [f64; 3]) {
        if let Some((motion, body)) = self.motion.as_mut().zip(self.model.free_body()) {
            let (q, velocity) = (&self.state.q, &self.state.velocity);
            motion.momentum = Vector3::from(velocity_m_s) * body.mass_kg();
            let angular = body.inertia(q) * Vector3::from(omega_per_s) + body.spin(q, velocity);
            motion.angular_momentum = motion.frame.rotation * angular;
        }
    }
}

/// The motion of a free body at rest; none of one that is held.
fn motion_of(
    model: &ReducedModel,
    params: &SimulationParams,
) -> Result<Option<Motion>, SimulationError> {
    match (model.n_rigid_modes(), model.free_body()) {
        (0, _) => Ok(None),
        (_, Some(_)) if params.integrator == Integrator::QuasiStatic => {
            Err(SimulationError::NoEquilibrium)
        }
        (_, Some(body)) => Ok(Some(Motion::at_rest(body))),
        (n_rigid_modes, None) => Err(SimulationError::PartlyFree { n_rigid_modes }),
    }
}
