//! Static equilibrium in the subspace: f(q) = f_ext by Newton's method with a line search.

use crate::ReducedModel;
use crate::dense::SmallCholesky;
use faer::Mat;

/// A static solution was not found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("no equilibrium within {iterations} Newton iterations: residual {residual:e} of the load")]
pub struct StaticError {
    /// Iterations made.
    pub iterations: usize,
    /// ‖f(q) − f_ext‖/‖f_ext‖ at the end.
    pub residual: f64,
}

/// Newton iterations before giving up.
const MOST_ITERATIONS: usize = 60;

/// Residual relative to the load at which the equilibrium is found.
const TOLERANCE: f64 = 1e-9;

/// Units in the last place of the largest diagonal stiffness times ‖q‖ that rounding may leave of the
/// residual: more than [`TOLERANCE`] where a soft part carries one 50 times as stiff.
const ROUNDING_ULPS: f64 = 16.0;

impl ReducedModel {
    /// The equilibrium q under the reduced load `force` (r numbers), from `start`.
    pub fn solve_static(&self, force: &[f64], start: &[f64]) -> Result<Vec<f64>, StaticError> {
        let r = self.r();
        let norm = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
        let load = norm(force).max(f64::MIN_POSITIVE);
        let mut q = start.to_vec();
        let potential = |q: &[f64], energy_j: f64| {
            energy_j - q.iter().zip(force).map(|(q, f)| q * f).sum::<f64>()
        };
        let stiffest = (0..r).map(|i| self.rest_stiffness()[(i, i)]).fold(0.0, f64::max);
        let mut residual = f64::INFINITY;
        for _ in 0..MOST_ITERATIONS {
            let sums = self.sums(&q, true);
            let gap: Vec<f64> = sums.force.iter().zip(force).map(|(f, e)| e - f).collect();
            residual = norm(&gap) / load;
            let rounding = ROUNDING_ULPS * f64::EPSILON * stiffest * norm(&q) / load;
            if residual <= TOLERANCE + rounding {
                return Ok(q);
            }
            // An indefinite tangent is shifted until it descends.
            let rhs = Mat::from_fn(r, 1, |i, _| gap[i]);
            let factor = [0.0, 1e-6, 1e-4, 1e-2, 1.0].iter().find_map(|shift| {
                let k = Mat::from_fn(r, r, |i, j| {
                    sums.stiffness[(i, j)] + if i == j { shift * stiffest } else { 0.0 }
                });
                SmallCholesky::new(k.as_ref()).ok()
            });
            let Some(factor) = factor else { break };
            let step = factor.solve(rhs.as_ref());
            let slope: f64 = (0..r).map(|i| step[(i, 0)] * gap[i]).sum();
            let now = potential(&q, sums.energy_j);
            let rounding = 1e-12 * now.abs().max(sums.energy_j.abs());
            let mut length = 1.0;
            let next = loop {
                let trial: Vec<f64> = (0..r).map(|i| q[i] + length * step[(i, 0)]).collect();
                let value = potential(&trial, self.sums(&trial, false).energy_j);
                if value <= now - 1e-4 * length * slope + rounding {
                    break Some(trial);
                }
                length *= 0.5;
                if length < 1e-8 {
                    break None;
                }
            };
            match next {
                Some(next) => q = next,
                None => break,
            }
        }
        Err(StaticError { iterations: MOST_ITERATIONS, residual })
    }
}
