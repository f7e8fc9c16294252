//! Modal derivatives: K̂ Φ_ij = −(H:φ_i)φ_j (\[M16\] eq. 13, \[B12\] eq. 15).
//!
//! The right-hand sides use the stiffness's derivative at rest, which stitches do not change. A body
//! with rigid motions has a singular K̂; then (and wherever only the shifted factor exists) the
//! equations are solved by conjugate gradients, preconditioned by the shifted factor corrected on
//! the known modes: what remains has condition number 1 + σ/λ_{r+1}, so two or three steps suffice.

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::control::{self, Cancelled, Control, Stage};
use crate::lanes::LANES;
use crate::linalg;
use crate::modes::LinearModes;
use crate::modes::stitched::StitchedStiffness;
use crate::pool::{Pooled, Tall};
use faer::{Mat, MatMut, MatRef};

/// Relative residual to which derivatives are solved where a direct solve is not exact. They only
/// enter the span of a basis; the correction on the known modes alone reaches σ/λ_{r+1}, mostly
/// 1e-3, and from there each step costs as much as the solve itself.
pub const SOLVE_TOLERANCE: f64 = 1e-2;

/// The same for load cases (`modes::load_cases`), from which stitched bodies take theirs: what is a
/// hundredth of the open body's load can be as much as all of the closed body's response.
pub const LOAD_CASE_TOLERANCE: f64 = 1e-10;

/// Conjugate-gradient steps before the solution is taken as it is.
const MOST_STEPS: usize = 60;

/// Every pair i ≤ j of `k` modes, those of the lowest modes first.
pub fn pairs(k: usize) -> Vec<[usize; 2]> {
    (0..k).flat_map(|j| (0..=j).map(move |i| [i, j])).collect()
}

/// −(H:φ_i)φ_j for every pair of the columns of `shapes` (n×k), in the order of [`pairs`].
pub fn right_hand_sides(
    model: &FullModel,
    shapes: MatRef<'_, f64>,
    control: &dyn Control,
) -> Result<Tall, Cancelled> {
    control::check(control)?;
    let all = model.second_derivatives_at_rest(shapes, -1.0);
    control.progress(Stage::Derivatives, 0.5);
    Ok(all)
}

/// K̂ on the complement of the rigid motions.
pub struct Solver<'a> {
    /// K̂ and K̂_σ⁻¹.
    pub stitched: &'a StitchedStiffness<'a>,
    /// M.
    pub mass: &'a Mass,
    /// σ in 1/s²; 0 makes the factor exact.
    pub sigma: f64,
    /// The motions that remain rigid (n×k, M-orthonormal).
    pub rigid: MatRef<'a, f64>,
    /// Modes of K̂ to correct the preconditioner on; none if they are not accurate.
    pub modes: Option<&'a LinearModes>,
    /// Relative residual to which to solve.
    pub tolerance: f64,
}

/// Columns of residuals, of `k`, that are there at a time: some where a solve is exact and they only tell how exact, for the
/// sake of memory.
fn residuals_at_a_time(k: usize, sigma: f64) -> usize {
    if sigma == 0.0 { k.clamp(1, LANES) } else { k.max(1) }
}

/// Memory for the right-hand sides and the residuals of one block of columns after another.
pub struct Scratch([Pooled; 2]);

impl Scratch {
    /// For blocks of at most n × k, solved for with this shift.
    pub fn new(n: usize, k: usize, sigma: f64) -> Scratch {
        Scratch([k, residuals_at_a_time(k, sigma)].map(|k| Pooled::take(n * k)))
    }
}

impl Solver<'_> {
    /// Solves K̂X = B (n×k) with XᵀMR = 0 in the place of B, k being at most what `scratch` is for. Returns the worst
    /// relative residual.
    pub fn solve_in_place(
        &self,
        mut x: MatMut<'_, f64>,
        scratch: &mut Scratch,
        control: &dyn Control,
    ) -> Result<f64, Cancelled> {
        let k = x.ncols();
        if self.rigid.ncols() > 0 {
            self.balance(x.as_mut());
        }
        let n = x.nrows();
        let [b, r] = &mut scratch.0;
        let mut b = b.columns_mut(n, k);
        linalg::copy(b.as_mut(), x.as_ref());
        let b = b.as_ref();
        self.precondition(b, x.as_mut());
        let norms = linalg::column_norms(b);
        let mut worst = 0.0f64;
        let at_a_time = residuals_at_a_time(k, self.sigma);
        for first in (0..k).step_by(at_a_time) {
            let count = at_a_time.min(k - first);
            let mut r = r.columns_mut(n, count);
            self.stitched.multiply_into(r.as_mut(), x.as_ref().subcols(first, count));
            linalg::for_each_column(r.as_mut(), |j, r| {
                r.iter_mut().zip(b.col(first + j).iter()).for_each(|(r, b)| *r = b - *r);
            });
            worst = worst.max(worst_ratio(r.as_ref(), &norms[first..]));
        }
        if worst <= self.tolerance || self.sigma == 0.0 {
            return Ok(worst);
        }
        let mut r = r.columns_mut(n, k);
        let mut direction = Mat::<f64>::zeros(b.nrows(), k);
        let mut old = vec![0.0f64; k];
        for step in 0..MOST_STEPS {
            control::check(control)?;
            let mut z = r.to_owned();
            self.precondition(r.as_ref(), z.as_mut());
            let energy = linalg::column_products(r.as_ref(), z.as_ref());
            let beta = |j: usize| if step == 0 || old[j] == 0.0 { 0.0 } else { energy[j] / old[j] };
            linalg::for_each_column(direction.as_mut(), |j, direction| {
                let beta = beta(j);
                direction.iter_mut().zip(z.col_as_slice(j)).for_each(|(d, z)| *d = z + beta * *d);
            });
            let kd = self.stitched.multiply(direction.as_ref());
            let curvature = linalg::column_products(direction.as_ref(), kd.as_ref());
            let alpha = |j: usize| if curvature[j] > 0.0 { energy[j] / curvature[j] } else { 0.0 };
            linalg::for_each_column(x.as_mut(), |j, x| {
                axpy(x, alpha(j), direction.col_as_slice(j));
            });
            linalg::for_each_column(r.as_mut(), |j, r| axpy(r, -alpha(j), kd.col_as_slice(j)));
            old = energy;
            worst = worst_ratio(r.as_ref(), &norms);
            if worst <= self.tolerance {
                break;
            }
        }
        Ok(worst)
    }

    /// B ← B − MRRᵀB: a load that rigid motions do not feel.
    fn balance(&self, b: MatMut<'_, f64>) {
        let c = linalg::gram(self.rigid, b.as_ref());
        let mr = self.mass.multiply(self.rigid);
        linalg::add_product(b, -1.0, mr.as_ref(), c.as_ref());
    }

    /// Overwrites X, which holds R, by K̂_σ⁻¹R + Φ(Λ⁻¹ − (Λ + σ)⁻¹)ΦᵀR, without rigid motions: exact on the span
    /// of the modes.
    fn precondition(&self, r: MatRef<'_, f64>, mut x: MatMut<'_, f64>) {
        self.stitched.solve_in_place(x.as_mut());
        if let Some(modes) = self.modes.filter(|_| self.sigma > 0.0) {
            let mut c = linalg::gram(modes.shapes.as_ref(), r);
            for (i, lambda) in modes.eigenvalues.iter().enumerate() {
                let factor = lambda.recip() - (lambda + self.sigma).recip();
                (0..c.ncols()).for_each(|j| c[(i, j)] *= factor);
            }
            linalg::add_product(x.as_mut(), 1.0, modes.shapes.as_ref(), c.as_ref());
        }
        if self.rigid.ncols() > 0 {
            let c = self.mass.inner(self.rigid, x.as_ref());
            linalg::add_product(x, -1.0, self.rigid, c.as_ref());
        }
    }
}

fn worst_ratio(r: MatRef<'_, f64>, norms: &[f64]) -> f64 {
    let ratios = linalg::column_norms(r).into_iter().zip(norms);
    ratios.map(|(r, b)| if *b > 0.0 { r / b } else { 0.0 }).fold(0.0, f64::max)
}

fn axpy(y: &mut [f64], alpha: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += alpha * x;
    }
}
