//! Modal derivatives of a build or of an edit that seams do not cover.

use super::params::BuildError;
use super::span::DerivativeSet;
use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::control::{self, Control};
use crate::derivatives;
use crate::modes::LinearModes;
use crate::modes::stitched::StitchedStiffness;
use faer::{Mat, MatRef};
use std::sync::Arc;

/// What the derivative stage needs of a (stitched) body.
pub(super) struct Body<'a> {
    pub(super) model: &'a FullModel,
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

/// Derivatives of every pair of the lowest `count` modes, with their loads (n×p each).
pub(super) fn new_derivatives<'a>(
    body: &Body<'a>,
    modes: &LinearModes,
    accurate: Option<&'a LinearModes>,
    count: usize,
    control: &dyn Control,
) -> Result<(DerivativeSet, Mat<f64>), BuildError> {
    let lowest = modes.lowest(count);
    let loads = derivatives::right_hand_sides(body.model, lowest.shapes.as_ref(), control)?;
    let (n, p) = (loads.nrows(), loads.ncols());
    let mut shapes = Mat::zeros(n, p);
    let mut residual = 0.0f64;
    for first in (0..p).step_by(DERIVATIVES_PER_SOLVE) {
        control::check(control)?;
        let block = loads.subcols(first, DERIVATIVES_PER_SOLVE.min(p - first));
        let y = body.stitched.solve(block);
        let (x, worst) = body.solver(accurate).solve(block, y, control)?;
        shapes.as_mut().subcols_mut(first, block.ncols()).copy_from(&x);
        residual = residual.max(worst);
    }
    let pairs = derivatives::pairs(lowest.eigenvalues.len());
    let eigenvalues = pairs.iter().map(|p| p.map(|i| lowest.eigenvalues[i])).collect();
    Ok((DerivativeSet { shapes: Arc::new(shapes), pairs, eigenvalues, residual }, loads))
}
