//! Modal derivatives: K̂ Φ_ij = −(H:φ_i)φ_j (\[M16\] eq. 13, \[B12\] eq. 15).
//!
//! The right-hand sides use the stiffness's derivative at rest, which stitches do not change. A body
//! with rigid motions has a singular K̂; then (and wherever only the shifted factor exists) the
//! equations are solved by conjugate gradients, preconditioned by the shifted factor corrected on
//! the known modes: what remains has condition number 1 + σ/λ_{r+1}, so two or three steps suffice.

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::control::{self, Cancelled, Control, Stage};
use crate::linalg;
use crate::modes::LinearModes;
use crate::modes::stitched::StitchedStiffness;
use faer::{Mat, MatRef};

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
) -> Result<Mat<f64>, Cancelled> {
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

impl Solver<'_> {
    /// Solves K̂X = B with XᵀMR = 0 from Y = K̂_σ⁻¹B. Returns X and the worst relative residual.
    pub fn solve(
        &self,
        b: MatRef<'_, f64>,
        y: Mat<f64>,
        control: &dyn Control,
    ) -> Result<(Mat<f64>, f64), Cancelled> {
        let k = b.ncols();
        let balanced = (self.rigid.ncols() > 0).then(|| self.balance(b.to_owned()));
        let rhs = balanced.as_ref().map_or(b, |balanced| balanced.as_ref());
        let norms = linalg::column_norms(rhs);
        // Balancing changes K̂_σ⁻¹B by a rigid motion only, which is removed.
        let mut x = self.correct(rhs, y);
        self.remove_rigid(&mut x);
        let mut r = self.stitched.multiply(x.as_ref());
        linalg::for_each_column(&mut r, |j, r| {
            for (r, b) in r.iter_mut().zip(rhs.col(j).iter()) {
                *r = b - *r;
            }
        });
        let mut direction = Mat::<f64>::zeros(b.nrows(), k);
        let mut old = vec![0.0f64; k];
        for step in 0..MOST_STEPS {
            control::check(control)?;
            let worst = worst_ratio(r.as_ref(), &norms);
            if worst <= self.tolerance || self.sigma == 0.0 {
                return Ok((x, worst));
            }
            let z = self.precondition(&r);
            let energy = column_products(&r, &z);
            for j in 0..k {
                let beta = if step == 0 || old[j] == 0.0 { 0.0 } else { energy[j] / old[j] };
                for (d, z) in direction.col_as_slice_mut(j).iter_mut().zip(z.col_as_slice(j)) {
                    *d = z + beta * *d;
                }
            }
            let kd = self.stitched.multiply(direction.as_ref());
            let curvature = column_products(&direction, &kd);
            for j in 0..k {
                let alpha = if curvature[j] > 0.0 { energy[j] / curvature[j] } else { 0.0 };
                axpy(x.col_as_slice_mut(j), alpha, direction.col_as_slice(j));
                axpy(r.col_as_slice_mut(j), -alpha, kd.col_as_slice(j));
            }
            old = energy;
        }
        let worst = worst_ratio(r.as_ref(), &norms);
        Ok((x, worst))
    }

    /// B ← B − MRRᵀB: a load that rigid motions do not feel.
    fn balance(&self, mut b: Mat<f64>) -> Mat<f64> {
        let c = linalg::gram(self.rigid, b.as_ref());
        let mr = self.mass.multiply(self.rigid);
        linalg::add_product(b.as_mut(), -1.0, mr.as_ref(), c.as_ref());
        b
    }

    fn remove_rigid(&self, x: &mut Mat<f64>) {
        if self.rigid.ncols() > 0 {
            let c = self.mass.inner(self.rigid, x.as_ref());
            linalg::add_product(x.as_mut(), -1.0, self.rigid, c.as_ref());
        }
    }

    fn precondition(&self, r: &Mat<f64>) -> Mat<f64> {
        let mut z = self.correct(r.as_ref(), self.stitched.solve(r.as_ref()));
        self.remove_rigid(&mut z);
        z
    }

    /// K̂_σ⁻¹R + Φ(Λ⁻¹ − (Λ + σ)⁻¹)ΦᵀR: exact on the span of the modes.
    fn correct(&self, r: MatRef<'_, f64>, mut z: Mat<f64>) -> Mat<f64> {
        if let Some(modes) = self.modes.filter(|_| self.sigma > 0.0) {
            let mut c = linalg::gram(modes.shapes.as_ref(), r);
            for (i, lambda) in modes.eigenvalues.iter().enumerate() {
                let factor = lambda.recip() - (lambda + self.sigma).recip();
                (0..c.ncols()).for_each(|j| c[(i, j)] *= factor);
            }
            linalg::add_product(z.as_mut(), 1.0, modes.shapes.as_ref(), c.as_ref());
        }
        z
    }
}

fn column_products(x: &Mat<f64>, y: &Mat<f64>) -> Vec<f64> {
    (0..x.ncols()).map(|j| x.col(j).transpose() * y.col(j)).collect()
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
