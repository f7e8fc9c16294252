//! Modal derivatives of a build or of an edit that seams do not cover.

use super::artifacts::Prepared;
use super::params::BuildError;
use super::span::DerivativeSet;
use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::control::{self, Control};
use crate::derivatives;
use crate::linalg;
use crate::modes::LinearModes;
use crate::modes::load_cases::LoadCases;
use crate::modes::stitched::StitchedStiffness;
use faer::{Mat, MatRef};

/// What the derivative stage needs of a (stitched) body.
pub(super) struct Body<'a> {
    pub(super) model: &'a FullModel,
    pub(super) mass: &'a Mass,
    pub(super) stitched: &'a StitchedStiffness<'a>,
    pub(super) sigma: f64,
    /// Motions that remain rigid.
    pub(super) rigid: MatRef<'a, f64>,
}

impl<'a> Body<'a> {
    fn solver(&self, accurate: Option<&'a LinearModes>) -> derivatives::Solver<'a> {
        derivatives::Solver {
            stitched: self.stitched,
            mass: self.mass,
            sigma: self.sigma,
            rigid: self.rigid,
            modes: accurate,
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
    Ok((DerivativeSet { shapes, pairs, eigenvalues, residual }, loads))
}

/// K̂⁻¹ of the loads of the base body, which takes no solve (\[M16\] §4.2.1 reuses 40 % of them; by
/// these means all of them cost less than one solve): K̂⁻¹L = F + K̂⁻¹(MXXᵀL − AAᵀF). Where the
/// factor is shifted `modes` carry the difference, as in
/// [`crate::modes::prepared::PreparedStitches::load_responses`].
pub(super) fn reused_derivatives(
    prepared: &Prepared,
    cases: &LoadCases,
    body: &Body<'_>,
    modes: Option<&LinearModes>,
) -> DerivativeSet {
    let blocks: Vec<MatRef<'_, f64>> = cases.blocks.iter().map(|b| b.columns.as_ref()).collect();
    let mut shapes = linalg::concatenate(&blocks);
    let a = body.stitched.stitch_matrix();
    let of_f = a.transpose_times(shapes.as_ref());
    let theta = prepared.theta();
    let x = Mat::from_fn(theta.len(), cases.len(), |i, j| theta[i] * cases.on_modes[(i, j)]);
    // Φ̂ᵀ(MXXᵀL − AAᵀF), before F becomes something else.
    let shifted = modes.filter(|_| body.sigma > 0.0);
    let correction = shifted.map(|modes| {
        let phi = modes.shapes.as_ref();
        let stretch = a.transpose_times(phi);
        let mut c = linalg::small_product(stretch.transpose(), of_f.as_ref());
        c *= faer::Scale(-1.0);
        let mut at = 0;
        for block in &prepared.x {
            let part = block.columns.as_ref();
            let inner = body.mass.inner(phi, part);
            let loads = cases.on_modes.subrows(at, part.ncols());
            c += linalg::small_product(inner.as_ref(), loads);
            at += part.ncols();
        }
        for (i, lambda) in modes.eigenvalues.iter().enumerate() {
            let factor = lambda.recip() - (lambda + body.sigma).recip();
            (0..c.ncols()).for_each(|j| c[(i, j)] *= factor);
        }
        c
    });
    let mut start = Mat::zeros(shapes.nrows(), cases.len());
    let mut at = 0;
    for block in &prepared.x {
        let part = block.columns.as_ref();
        linalg::add_product(start.as_mut(), 1.0, part, x.subrows(at, part.ncols()));
        at += part.ncols();
    }
    // K_σ⁻¹B = X·x + …, and what the stitches take back of it with EᵀF as their gap.
    let gap = a.transpose_times(start.as_ref()) + of_f;
    shapes += start;
    shapes -= body.stitched.flexed(gap.as_ref());
    if let (Some(modes), Some(c)) = (shifted, correction) {
        linalg::add_product(shapes.as_mut(), 1.0, modes.shapes.as_ref(), c.as_ref());
    }
    if body.rigid.ncols() > 0 {
        let c = body.mass.inner(body.rigid, shapes.as_ref());
        linalg::add_product(shapes.as_mut(), -1.0, body.rigid, c.as_ref());
    }
    let pairs = cases.sources.iter().flat_map(|s| derivatives::pairs(s.eigenvalues.len()));
    DerivativeSet {
        shapes,
        pairs: pairs.collect(),
        eigenvalues: cases.eigenvalues(),
        residual: 0.0,
    }
}
