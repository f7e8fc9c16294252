//! Modal derivatives of a build or of an edit that seams do not cover.

use super::params::BuildError;
use super::span::DerivativeSet;
use crate::assembly::mass::Mass;
use crate::control::{self, Control};
use crate::derivatives::{self, Scratch};
use crate::lanes::kernels::Real;
use crate::modes::LinearModes;
use crate::modes::stitched::StitchedStiffness;
use crate::pool::Tall;
use faer::MatRef;
use std::sync::Arc;

/// What the derivative stage needs of a (stitched) body.
pub(super) struct Body<'a> {
    pub(super) mass: &'a Mass,
    pub(super) stitched: &'a StitchedStiffness<'a>,
    pub(super) sigma: f64,
    /// Motions that remain rigid.
    pub(super) rigid: MatRef<'a, f64>,
    /// Relative residual to which derivatives are solved for.
    pub(super) tolerance: f64,
}

impl<'a> Body<'a> {
    fn solver(&self, accurate: Option<&'a LinearModes>) -> derivatives::Solver<'a> {
        derivatives::Solver {
            stitched: self.stitched,
            mass: self.mass,
            sigma: self.sigma,
            rigid: self.rigid,
            modes: accurate,
            tolerance: self.tolerance,
        }
    }
}

/// Right-hand sides solved for at a time: the solve gains nothing from more, and what surrounds it holds
/// several blocks of this width.
const DERIVATIVES_PER_SOLVE: usize = 32;

/// Derivatives of every pair of modes of these eigenvalues from their loads (n×p, [`derivatives::right_hand_sides`]), in whose memory
/// they are solved for.
pub(super) fn new_derivatives<'a>(
    body: &Body<'a>,
    eigenvalues: &[f64],
    accurate: Option<&'a LinearModes>,
    loads: Tall,
    control: &dyn Control,
) -> Result<DerivativeSet, BuildError> {
    let mut shapes = loads;
    let (n, p) = (shapes.nrows(), shapes.ncols());
    let mut scratch = Scratch::new(n, DERIVATIVES_PER_SOLVE.min(p), body.sigma);
    let solver = body.solver(accurate);
    let mut residual = 0.0f64;
    for first in (0..p).step_by(DERIVATIVES_PER_SOLVE) {
        control::check(control)?;
        let block = shapes.as_mut().subcols_mut(first, DERIVATIVES_PER_SOLVE.min(p - first));
        residual = residual.max(solver.solve_in_place(block, &mut scratch, control)?);
    }
    Ok(derivatives_of(eigenvalues, shapes, residual))
}

/// The same of a body without rigid motions by a factor in single precision. What that leaves of them, in the norm of K̂,
/// is bounded and part of the audit of modes. (Residuals of such solutions are of the shortest waves, a hundredth of the loads
/// where the error is 1e-4, and tell nothing of it.)
pub(super) fn rounded_derivatives(
    stitched: &StitchedStiffness<'_, f32>,
    eigenvalues: &[f64],
    loads: Tall,
    control: &dyn Control,
) -> Result<DerivativeSet, BuildError> {
    let mut shapes = loads;
    let at_a_time = f32::WIDTHS[2];
    for first in (0..shapes.ncols()).step_by(at_a_time) {
        control::check(control)?;
        let count = at_a_time.min(shapes.ncols() - first);
        stitched.solve_in_place(shapes.as_mut().subcols_mut(first, count));
    }
    Ok(derivatives_of(eigenvalues, shapes, 0.0))
}

fn derivatives_of(eigenvalues: &[f64], shapes: Tall, residual: f64) -> DerivativeSet {
    let pairs = derivatives::pairs(eigenvalues.len());
    let eigenvalues = pairs.iter().map(|p| p.map(|i| eigenvalues[i])).collect();
    DerivativeSet { shapes: Arc::new(shapes), pairs, eigenvalues, residual }
}
