//! Implicit Newmark integration (β = 1/4, γ = 1/2: average acceleration) of
//! q̈ + D q̇ + f(q) = f_ext with UᵀMU = I and Rayleigh damping D = αI + βK̃(0) (\[B12\] §3.1).

use super::ReducedModel;
use crate::linalg::SmallCholesky;
use faer::Mat;
use std::sync::Arc;

/// How the reduced equations of motion are integrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integrator {
    /// Newmark with β = 1/4, γ = 1/2, each step solved by Newton's method.
    ImplicitNewmark,
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
}

/// What one step went through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepReport {
    /// Newton iterations over all substeps.
    pub n_newton: u32,
    /// Substeps the step was split into (1 when all went well).
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
    #[error(
        "the body has {n_rigid_modes} rigid modes; only bodies held in place can be simulated so far: fix vertices or stitch every component to a fixed one"
    )]
    Free { n_rigid_modes: usize },
    #[error("the transfer matrix has {given} entries, not {expected}")]
    Transfer { given: usize, expected: usize },
}

/// A running simulation of one reduced model.
pub struct Simulation {
    model: Arc<ReducedModel>,
    params: SimulationParams,
    time_s: f64,
    state: State,
}

#[derive(Clone)]
struct State {
    q: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
}

/// Newton iterations a substep may take; average acceleration converges in two or three.
const MOST_NEWTON: u32 = 12;

/// A step is halved at most so many times.
const MOST_HALVINGS: u32 = 6;

/// Residual relative to the forces in play at which a substep is solved.
const TOLERANCE: f64 = 1e-8;

const BETA: f64 = 0.25;
const GAMMA: f64 = 0.5;

impl Simulation {
    /// At rest at q = 0.
    pub fn new(
        model: Arc<ReducedModel>,
        params: SimulationParams,
    ) -> Result<Simulation, SimulationError> {
        check_model(&model)?;
        check_params(&params)?;
        let zero = vec![0.0; model.r()];
        let state = State { q: zero.clone(), velocity: zero.clone(), acceleration: zero };
        Ok(Simulation { model, params, time_s: 0.0, state })
    }

    /// Advances by `dt_s` under the reduced external force `force` (r numbers; gravity is added).
    /// Never leaves a non-finite state behind: a step that fails is split, and if no split works
    /// it is undone and the body brought to rest where it was.
    pub fn step(&mut self, force: &[f64]) -> StepReport {
        let gravity = self.model.gravity_load(self.params.gravity_m_s2);
        let load: Vec<f64> = force.iter().zip(&gravity).map(|(f, g)| f + g).collect();
        self.time_s += self.params.dt_s;
        let mut report = StepReport::default();
        if load.iter().all(|x| x.is_finite()) {
            for halvings in 0..=MOST_HALVINGS {
                let substeps = 1u32 << halvings;
                let dt = self.params.dt_s / f64::from(substeps);
                let mut state = self.state.clone();
                let done = (0..substeps)
                    .all(|_| substep(&self.model, &mut state, &load, dt, &mut report.n_newton));
                report.n_substeps = substeps;
                if done {
                    self.state = state;
                    return report;
                }
            }
        }
        report.recovered = true;
        self.state.velocity.fill(0.0);
        self.state.acceleration.fill(0.0);
        report
    }

    /// Changes the parameters from the next step on.
    pub fn set_params(&mut self, params: SimulationParams) -> Result<(), SimulationError> {
        check_params(&params)?;
        self.params = params;
        Ok(())
    }

    /// Carries state over to another generation: q, velocity and acceleration through `transfer`
    /// (r_new × r_old, row-major).
    pub fn switch(
        &mut self,
        model: Arc<ReducedModel>,
        transfer: &[f64],
    ) -> Result<(), SimulationError> {
        check_model(&model)?;
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
        };
        self.model = model;
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
}

fn check_model(model: &ReducedModel) -> Result<(), SimulationError> {
    match model.n_rigid_modes {
        0 => Ok(()),
        n_rigid_modes => Err(SimulationError::Free { n_rigid_modes }),
    }
}

fn check_params(params: &SimulationParams) -> Result<(), SimulationError> {
    if !(params.dt_s > 0.0 && params.dt_s <= 1.0) {
        return Err(SimulationError::TimeStep(params.dt_s));
    }
    if params.gravity_m_s2.iter().any(|g| !g.is_finite()) {
        return Err(SimulationError::Gravity);
    }
    Ok(())
}

/// One implicit step; false if Newton's method fails or anything is not finite.
fn substep(
    model: &ReducedModel,
    state: &mut State,
    load: &[f64],
    dt: f64,
    n_newton: &mut u32,
) -> bool {
    let r = model.r();
    let damping = Mat::from_fn(r, r, |i, j| {
        model.damping.stiffness_s * model.rest_stiffness[(i, j)]
            + if i == j { model.damping.mass_per_s } else { 0.0 }
    });
    let start = state.clone();
    let mut q = start.q.clone();
    for _ in 0..MOST_NEWTON {
        let acceleration: Vec<f64> = (0..r)
            .map(|i| {
                (q[i] - start.q[i]) / (BETA * dt * dt)
                    - start.velocity[i] / (BETA * dt)
                    - (0.5 / BETA - 1.0) * start.acceleration[i]
            })
            .collect();
        let velocity: Vec<f64> = (0..r)
            .map(|i| {
                start.velocity[i]
                    + dt * ((1.0 - GAMMA) * start.acceleration[i] + GAMMA * acceleration[i])
            })
            .collect();
        let sums = model.sums(&q, true);
        let mut scale = 0.0;
        let residual: Vec<f64> = (0..r)
            .map(|i| {
                let damped: f64 = (0..r).map(|j| damping[(i, j)] * velocity[j]).sum();
                scale += load[i].powi(2)
                    + sums.force[i].powi(2)
                    + acceleration[i].powi(2)
                    + damped.powi(2);
                load[i] - acceleration[i] - damped - sums.force[i]
            })
            .collect();
        let norm = residual.iter().map(|x| x * x).sum::<f64>();
        if !norm.is_finite() || !scale.is_finite() {
            return false;
        }
        if norm <= TOLERANCE * TOLERANCE * scale {
            *state = State { q, velocity, acceleration };
            return true;
        }
        let jacobian = Mat::from_fn(r, r, |i, j| {
            sums.stiffness[(i, j)]
                + GAMMA / (BETA * dt) * damping[(i, j)]
                + if i == j { 1.0 / (BETA * dt * dt) } else { 0.0 }
        });
        // An indefinite matrix means the step is too long for the tangent it meets: split it.
        let Ok(factor) = SmallCholesky::new(jacobian.as_ref()) else { return false };
        let step = factor.solve(Mat::from_fn(r, 1, |i, _| residual[i]).as_ref());
        for i in 0..r {
            q[i] += step[(i, 0)];
        }
        *n_newton += 1;
    }
    false
}
