//! One implicit step of q̈ + D q̇ + f(q) = load + what pulls at points, with UᵀMU = I.

use crate::ReducedModel;
use crate::dense::{self, SmallCholesky};
use crate::interaction::{Derivative, Interactions, Placement, Pull, Wrench};
use crate::material::Mat3;
use faer::Mat;
use nalgebra::Vector3;

/// Reduced coordinates and their rates.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) q: Vec<f64>,
    pub(crate) velocity: Vec<f64>,
    pub(crate) acceleration: Vec<f64>,
    /// The load that `acceleration` was found under, grabs included: when it jumps, acceleration jumps with it.
    pub(crate) load: Vec<f64>,
    /// The part of `acceleration` that is contact's.
    pub(crate) contact: Vec<f64>,
}

impl State {
    pub(crate) fn at_rest(r: usize) -> State {
        let [q, velocity, acceleration, load, contact] = [(); 5].map(|()| vec![0.0; r]);
        State { q, velocity, acceleration, load, contact }
    }

    /// The same place and motion under another load (UᵀMU = I): an average acceleration over the step takes its
    /// beginning from here, or a load would come into force half a step late.
    fn under(&self, load: Vec<f64>) -> State {
        let jump = load.iter().zip(&self.load).map(|(new, old)| new - old);
        let acceleration = self.acceleration.iter().zip(jump).map(|(a, jump)| a + jump).collect();
        State { acceleration, load, ..self.clone() }
    }

    pub(crate) fn is_finite(&self) -> bool {
        let all = [&self.q, &self.velocity, &self.acceleration];
        all.into_iter().flatten().all(|x| x.is_finite())
    }
}

/// How rates follow from the new q: velocity = v·(q − q₀) + …, acceleration likewise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Scheme {
    /// Newmark with β = 1/4, γ = 1/2: average acceleration, second order, no damping of its own.
    Newmark,
    /// Backward Euler: first order, damps what it does not resolve.
    BackwardEuler,
    /// No inertia and no damping: equilibrium at the end of each step.
    QuasiStatic,
}

impl Scheme {
    /// Derivatives of velocity and acceleration by q.
    pub(crate) fn rates(self, dt: f64) -> [f64; 2] {
        match self {
            Scheme::Newmark => [2.0 / dt, 4.0 / (dt * dt)],
            Scheme::BackwardEuler => [1.0 / dt, 1.0 / (dt * dt)],
            Scheme::QuasiStatic => [0.0, 0.0],
        }
    }

    /// At how many ends of a step loads and grabs act: with their mean over both, or with what they do at the last.
    ///
    /// Contact pushes over the whole step as at its last end, so that it never gives more than it has taken. By the
    /// mean, what leaves an obstacle within a step would still be pushed by half of what it met at its beginning:
    /// a bar that fell flat on a floor harder than steps resolve left it with 3.5 times its energy.
    pub(crate) fn ends(self) -> f64 {
        match self {
            Scheme::Newmark => 2.0,
            Scheme::BackwardEuler | Scheme::QuasiStatic => 1.0,
        }
    }

    /// What a step of `dt` has wrong in q, relative to q and its motion: the first term of the series that the
    /// scheme leaves out, from how acceleration changes (Zienkiewicz and Xie, *A simple error estimator and
    /// adaptive time stepping procedure for dynamic analysis*, 1991).
    fn error(self, start: &State, end: &State, dt: f64) -> f64 {
        let wrong = match self {
            Scheme::Newmark => {
                let change = start.acceleration.iter().zip(&end.acceleration).map(|(a, b)| b - a);
                norm(change) / 12.0
            }
            Scheme::BackwardEuler => norm(end.acceleration.iter().copied()) / 2.0,
            Scheme::QuasiStatic => 0.0,
        };
        let motion = |state: &State| {
            norm(state.q.iter().copied()) + dt * norm(state.velocity.iter().copied())
        };
        let scale = motion(start) + motion(end);
        if wrong > 0.0 { dt * dt * wrong / scale } else { 0.0 }
    }
}

fn norm(x: impl Iterator<Item = f64>) -> f64 {
    x.map(|x| x * x).sum::<f64>().sqrt()
}

/// Evaluations a step may take, those after a Newton step was halved included; two or three is usual. An
/// equilibrium is found once where a motion takes many small steps.
const MOST_EVALUATIONS: [u32; 2] = [24, 100];

/// Times that one Newton step may be halved.
const MOST_BACKTRACKS: u32 = 10;

/// A Newton step is too long if the residual at its end opposes it by more than this fraction of what was
/// for it at its beginning: along it the potential then has its minimum well before.
const OVERSHOOT: f64 = 0.7;

/// Residual relative to the forces in play at which a step is solved.
const TOLERANCE: f64 = 1e-8;

/// Shifts tried on an indefinite matrix, relative to its largest diagonal entry.
const SHIFTS: [f64; 5] = [0.0, 1e-6, 1e-4, 1e-2, 1.0];

/// What a step is made of.
pub(crate) struct Step<'a> {
    pub(crate) model: &'a ReducedModel,
    pub(crate) damping: &'a Mat<f64>,
    pub(crate) scheme: Scheme,
    /// Reduced load (r numbers), constant over the step.
    pub(crate) load: &'a [f64],
    /// Reduced force of the grabs at the step's beginning (r numbers).
    pub(crate) grabbed: &'a [f64],
    pub(crate) interactions: &'a Interactions<'a>,
    /// Where the body will be as far as is known.
    pub(crate) placement: Placement,
    /// Of a body that nothing holds and that is pulled at: what the frame's motion follows from.
    pub(crate) rigid: Option<RigidPart>,
    pub(crate) dt: f64,
}

/// Inertia of the frame, and what pulls at it (force and torque in the frame).
#[derive(Clone, Copy, Debug)]
pub(crate) struct RigidPart {
    pub(crate) mass_kg: f64,
    pub(crate) inertia: Mat3,
    /// What was expected to act over the step, of grabs and contact.
    pub(crate) expected: Wrench,
    /// What grabs pull with at the step's beginning.
    pub(crate) before: Wrench,
}

impl RigidPart {
    /// What acts over the step, times the number of its ends at which grabs pull.
    fn acting(&self, pull: &Pull, ends: f64) -> Wrench {
        let of = |k: usize| {
            let before = self.before[k] * (ends - 1.0);
            pull.grabs.total[k] + before + pull.contact.total[k] * ends
        };
        [of(0), of(1)]
    }
}

/// What a step leads to.
pub(crate) struct Stepped {
    pub(crate) state: State,
    pub(crate) placement: Placement,
    /// What grabs pull with there, force and torque in the frame.
    pub(crate) grabs: Wrench,
    /// What obstacles push with there, likewise.
    pub(crate) contact: Wrench,
    /// Estimate of the relative error that the step added to q.
    pub(crate) error: f64,
}

impl Step<'_> {
    /// The state after the step; `None` if Newton's method fails or anything is not finite.
    ///
    /// Where the frame is free, its shift and turn from where it was expected are unknowns beside q: contact as
    /// stiff as it is would otherwise be stable for small steps only.
    pub(crate) fn from(&self, start: &State, n_newton: &mut u32) -> Option<Stepped> {
        let start = &start.under(sum(self.load, self.grabbed, 1.0));
        let r = self.model.r();
        let [to_velocity, to_acceleration] = self.scheme.rates(self.dt);
        let n = r + if self.rigid.is_some() { 6 } else { 0 };
        let derivative = Derivative { rate: to_velocity, of_frame: self.rigid.is_some() };
        // The frame moves as q does, if what is expected to act is multiplied by the ends at which it does.
        let ends = self.scheme.ends();
        let mut x = start.q.clone();
        x.resize(n, 0.0);
        // The last Newton step, and the residual's part along it where it began.
        let mut last: Option<(f64, Vec<f64>)> = None;
        let mut backtracks = 0;
        for _ in 0..MOST_EVALUATIONS[usize::from(self.scheme == Scheme::QuasiStatic)] {
            let (q, frame) = x.split_at(r);
            let [velocity, acceleration] = self.rates_at(q, start);
            let sums = self.model.sums(q, true);
            let part = |first: usize| Vector3::from_fn(|axis, _| frame[first + axis]);
            let [shift, turn] =
                if self.rigid.is_some() { [part(0), part(3)] } else { [Vector3::zeros(); 2] };
            let placement = match self.rigid {
                Some(_) => self.placement.corrected(shift, turn, to_velocity),
                None => self.placement,
            };
            let pull = self.interactions.pull(&placement, q, &velocity, Some(derivative));
            let mut scale = 0.0;
            let mut residual: Vec<f64> = (0..r)
                .map(|i| {
                    let damped: f64 = match self.scheme {
                        Scheme::QuasiStatic => 0.0,
                        _ => inner(self.damping.col_as_slice(i), &velocity),
                    };
                    let pulled = pull.grabs.force[i] + ends * pull.contact.force[i];
                    let inertia = match self.scheme {
                        Scheme::QuasiStatic => 0.0,
                        _ => acceleration[i],
                    };
                    scale += self.load[i].powi(2)
                        + sums.force[i].powi(2)
                        + inertia.powi(2)
                        + damped.powi(2)
                        + pulled.powi(2);
                    self.load[i] + pulled - inertia - damped - sums.force[i]
                })
                .collect();
            if let Some(rigid @ RigidPart { mass_kg, inertia, expected, .. }) = &self.rigid {
                let acting = rigid.acting(&pull, ends);
                let expected = expected.map(|expected| expected * ends);
                let changes = [shift * *mass_kg, inertia * turn];
                for ((acting, expected), change) in acting.iter().zip(&expected).zip(&changes) {
                    scale += acting.norm_squared() + expected.norm_squared();
                    residual.extend((acting - expected - change * to_acceleration).iter());
                }
            }
            let norm = residual.iter().map(|x| x * x).sum::<f64>();
            if !scale.is_finite() {
                // A step into the void can be taken back; a state that is there already cannot.
                let (_, step) = last.as_ref()?;
                backtracks += 1;
                if backtracks > MOST_BACKTRACKS {
                    return None;
                }
                retreat(&mut x, step, backtracks);
                continue;
            }
            if norm <= TOLERANCE * TOLERANCE * scale {
                let contact = pull.contact.force;
                let load = sum(self.load, &pull.grabs.force, 1.0);
                // As the rule has it, acceleration makes up for both ends.
                let acceleration = sum(&acceleration, &contact, 1.0 - ends);
                let state = State { q: q.to_vec(), velocity, acceleration, load, contact };
                let error = self.scheme.error(start, &state, self.dt);
                let (grabs, contact) = (pull.grabs.total, pull.contact.total);
                return Some(Stepped { state, placement, grabs, contact, error });
            }
            if let Some((before, step)) = &last
                && inner(&residual, step) < -OVERSHOOT * before
                && backtracks < MOST_BACKTRACKS
            {
                backtracks += 1;
                retreat(&mut x, step, backtracks);
                continue;
            }
            let mut jacobian = pull.stiffness.unwrap_or_else(|| Mat::zeros(n, n));
            if let Some(RigidPart { mass_kg, inertia, .. }) = self.rigid {
                for i in 0..3 {
                    jacobian[(r + i, r + i)] += mass_kg * to_acceleration;
                    for j in 0..3 {
                        jacobian[(r + 3 + i, r + 3 + j)] += inertia[(i, j)] * to_acceleration;
                    }
                }
            }
            for j in 0..r {
                let column = &mut jacobian.col_as_slice_mut(j)[..r];
                let terms = sums.stiffness.col_as_slice(j).iter().zip(self.damping.col_as_slice(j));
                for (to, (k, d)) in column.iter_mut().zip(terms) {
                    *to += k + to_velocity * d;
                }
                column[j] += to_acceleration;
            }
            let step = solve(jacobian, &residual, pull.is_unsymmetric)?;
            x.iter_mut().zip(&step).for_each(|(x, step)| *x += step);
            last = Some((inner(&residual, &step), step));
            backtracks = 0;
            *n_newton += 1;
        }
        None
    }

    /// Velocity and acceleration at `q`.
    fn rates_at(&self, q: &[f64], start: &State) -> [Vec<f64>; 2] {
        let dt = self.dt;
        let of = |f: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..q.len()).map(f).collect() };
        let moved = |i: usize| q[i] - start.q[i];
        match self.scheme {
            Scheme::Newmark => [
                of(&|i| 2.0 / dt * moved(i) - start.velocity[i]),
                // Contact does not act at the beginning.
                of(&|i| {
                    4.0 / dt * (moved(i) / dt - start.velocity[i])
                        - (start.acceleration[i] - start.contact[i])
                }),
            ],
            Scheme::BackwardEuler => {
                [of(&|i| moved(i) / dt), of(&|i| (moved(i) / dt - start.velocity[i]) / dt)]
            }
            Scheme::QuasiStatic => [of(&|i| moved(i) / dt), vec![0.0; q.len()]],
        }
    }
}

/// Takes back half of what is left of `step` after `backtracks − 1` times.
fn retreat(q: &mut [f64], step: &[f64], backtracks: u32) {
    let share = 0.5f64.powi(backtracks as i32);
    q.iter_mut().zip(step).for_each(|(q, step)| *q -= share * step);
}

/// J⁻¹·residual; a J whose symmetric part is indefinite is shifted until it descends. Friction makes it
/// unsymmetric.
fn solve(mut jacobian: Mat<f64>, residual: &[f64], is_unsymmetric: bool) -> Option<Vec<f64>> {
    let r = residual.len();
    let largest = (0..r).map(|i| jacobian[(i, i)].abs()).fold(0.0, f64::max);
    let rhs = Mat::from_fn(r, 1, |i, _| residual[i]);
    let mut shifted = 0.0;
    for shift in SHIFTS {
        (0..r).for_each(|i| jacobian[(i, i)] += (shift - shifted) * largest);
        shifted = shift;
        let symmetric = is_unsymmetric
            .then(|| Mat::from_fn(r, r, |i, j| 0.5 * (jacobian[(i, j)] + jacobian[(j, i)])));
        let factor = SmallCholesky::new(symmetric.as_ref().unwrap_or(&jacobian).as_ref());
        if let Ok(factor) = factor {
            let step = match is_unsymmetric {
                true => dense::solve_unsymmetric(jacobian.as_ref(), rhs.as_ref()),
                false => factor.solve(rhs.as_ref()),
            };
            return Some(step.col_as_slice(0).to_vec());
        }
    }
    None
}

/// x + s·y.
fn sum(x: &[f64], y: &[f64], s: f64) -> Vec<f64> {
    x.iter().zip(y).map(|(x, y)| x + s * y).collect()
}

fn inner(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}
