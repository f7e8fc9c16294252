//! The update that Sutura uses by default: Rayleigh–Ritz with the true stitched stiffness in a space
//! grown by the cached flexibility (a block generalized Davidson method whose preconditioner is
//! exact for the stiffness, by Woodbury's formula).
//!
//! 1. Residual of the old modes in the new problem: R = AAᵀU, nonzero at stitched vertices alone.
//! 2. T = K̂_σ⁻¹R = K_σ⁻¹A Z with Z = (I + C)⁻¹AᵀU: combinations of the flexibility columns.
//! 3. Ritz on [U, T] with K̂_σ.
//! 4. Residuals of the Ritz pairs through one blocked solve; they are the audit, and where they
//!    exceed the tolerance their solutions extend the space and 3 is repeated.
//!
//! Always from the modes of the *base* body, so that nothing accumulates over rounds of edits.

use crate::assembly::mass::Mass;
use crate::control::{self, Control, Stage};
use crate::linalg::{self, DenseError};
use crate::modes::stitched::StitchedStiffness;
use crate::modes::{LinearModes, ModesError, relative_residuals, residual_vectors};
use faer::{Mat, MatRef};

/// Rounds of refinement before the result is returned as it is. Three suffice on every body tried.
const MOST_ROUNDS: usize = 8;

/// Directions whose squared K̂_σ-length is below this fraction after scaling are dependent.
const DEPENDENT: f64 = 1e-13;

/// A new direction of which less than this fraction lies outside the space is left out.
const CANCELLED: f64 = 1e-8;

/// Relative eigenvalue error accepted for the upper half of the modes, as a multiple of the
/// tolerance for the lower half: they carry the least of a motion and cost the most to refine.
pub const UPPER_HALF_FACTOR: f64 = 100.0;

/// The base body's modes and the new problem.
pub struct Update<'a> {
    /// K̂ and K̂_σ⁻¹.
    pub stitched: &'a StitchedStiffness<'a>,
    /// M.
    pub mass: &'a Mass,
    /// σ in 1/s².
    pub sigma: f64,
    /// Rigid modes of the base body (n×k, M-orthonormal).
    pub rigid: MatRef<'a, f64>,
    /// How many motions remain rigid after the edit.
    pub n_rigid_left: usize,
    /// Elastic modes of the base body, guards included.
    pub base: &'a LinearModes,
    /// Modes wanted.
    pub n_modes: usize,
    /// Relative eigenvalue error accepted for the lower half of the modes.
    pub tolerance: f64,
}

/// Updated modes with their audit.
pub struct Updated {
    /// The elastic modes wanted.
    pub modes: LinearModes,
    /// Their relative residuals ([`relative_residuals`]).
    pub residuals: Vec<f64>,
    /// Estimated relative eigenvalue errors.
    pub error_estimates: Vec<f64>,
    /// Blocked solves that refinement took.
    pub n_rounds: usize,
}

/// A growing trial space S with K̂_σS and its two Gram matrices.
struct TrialSpace {
    s: Mat<f64>,
    stiff: Mat<f64>,
    gram_k: Mat<f64>,
    gram_m: Mat<f64>,
}

impl TrialSpace {
    fn new(s: Mat<f64>, stiff: Mat<f64>, mass: &Mass) -> TrialSpace {
        let gram_k = linalg::gram(s.as_ref(), stiff.as_ref());
        let gram_m = mass.inner(s.as_ref(), s.as_ref());
        TrialSpace { s, stiff, gram_k, gram_m }
    }

    /// Adds columns T after projecting out, in the K̂_σ inner product, what the space already holds,
    /// and scaling them to unit energy. K̂_σT is multiplied out afterwards: carrying it along from
    /// the right-hand side would save that product, but loses its digits to the subtraction where
    /// free bodies have large rigid components (seen: the fork breaks down at tolerance 1e-8).
    fn extend(&mut self, mut t: Mat<f64>, problem: &Update<'_>) -> Result<(), DenseError> {
        let Update { stitched, mass, sigma, .. } = *problem;
        let norms = |t: &Mat<f64>, mt: &Mat<f64>| -> Vec<f64> {
            (0..t.ncols()).map(|j| (t.col(j).transpose() * mt.col(j)).max(0.0).sqrt()).collect()
        };
        let before = norms(&t, &mass.multiply(t.as_ref()));
        let b = linalg::orthonormal_coefficients(self.gram_k.as_ref(), DEPENDENT)?;
        for _ in 0..2 {
            let inner = linalg::gram(self.stiff.as_ref(), t.as_ref());
            let onto = linalg::small_product(
                b.as_ref(),
                linalg::small_product(b.transpose(), inner.as_ref()).as_ref(),
            );
            linalg::add_product(t.as_mut(), -1.0, self.s.as_ref(), onto.as_ref());
        }
        let after = norms(&t, &mass.multiply(t.as_ref()));
        let new: Vec<usize> =
            (0..t.ncols()).filter(|&j| after[j] > CANCELLED * before[j]).collect();
        let mut t = Mat::from_fn(t.nrows(), new.len(), |i, j| t[(i, new[j])] / after[new[j]]);
        let mut stiff_t = stitched.multiply(t.as_ref());
        let mut mt = mass.multiply(t.as_ref());
        for j in 0..t.ncols() {
            for (k, m) in stiff_t.col_as_slice_mut(j).iter_mut().zip(mt.col_as_slice(j)) {
                *k += sigma * m;
            }
            let energy: f64 = t.col(j).transpose() * stiff_t.col(j);
            let scale = energy.max(f64::MIN_POSITIVE).sqrt().recip();
            for x in [&mut t, &mut stiff_t, &mut mt] {
                x.col_as_slice_mut(j).iter_mut().for_each(|x| *x *= scale);
            }
        }
        let grow = |old: &Mat<f64>, cross: Mat<f64>, corner: Mat<f64>| {
            let (k, l) = (old.ncols(), corner.ncols());
            Mat::from_fn(k + l, k + l, |i, j| match (i < k, j < k) {
                (true, true) => old[(i, j)],
                (true, false) => cross[(i, j - k)],
                (false, true) => cross[(j, i - k)],
                (false, false) => corner[(i - k, j - k)],
            })
        };
        self.gram_k = grow(
            &self.gram_k,
            linalg::gram(self.s.as_ref(), stiff_t.as_ref()),
            linalg::gram(t.as_ref(), stiff_t.as_ref()),
        );
        self.gram_m = grow(
            &self.gram_m,
            linalg::gram(self.s.as_ref(), mt.as_ref()),
            linalg::gram(t.as_ref(), mt.as_ref()),
        );
        self.s = linalg::concatenate(&[self.s.as_ref(), t.as_ref()]);
        self.stiff = linalg::concatenate(&[self.stiff.as_ref(), stiff_t.as_ref()]);
        Ok(())
    }

    /// Ritz pairs in shift-invert form, which is well conditioned whatever the stiffness of the
    /// stitches: θ = 1/(λ + σ) descending, and coefficients C with (SC)ᵀM(SC) = I.
    fn ritz(&self) -> Result<(Vec<f64>, Mat<f64>), DenseError> {
        let b = linalg::orthonormal_coefficients(self.gram_k.as_ref(), DEPENDENT)?;
        let mb = linalg::small_product(self.gram_m.as_ref(), b.as_ref());
        let (theta, y) =
            linalg::symmetric_eigen(linalg::small_product(b.transpose(), mb.as_ref()).as_ref())?;
        let k = theta.len();
        let by = linalg::small_product(b.as_ref(), y.as_ref());
        let theta: Vec<f64> = theta.into_iter().rev().collect();
        let c = Mat::from_fn(by.nrows(), k, |i, j| {
            by[(i, k - 1 - j)] / theta[j].max(f64::MIN_POSITIVE).sqrt()
        });
        Ok((theta, c))
    }
}

/// Computes the modes of the stitched body.
pub fn update(problem: &Update<'_>, control: &dyn Control) -> Result<Updated, ModesError> {
    let Update { stitched, mass, sigma, rigid, n_rigid_left, base, n_modes, tolerance } = *problem;
    let a = stitched.stitch_matrix();

    // S = [rigid, U]; K̂_σS = MS(Λ + σ) + A(AᵀS).
    let s = linalg::concatenate(&[rigid, base.shapes.as_ref()]);
    let mut stiff = mass.multiply(s.as_ref());
    for j in 0..s.ncols() {
        let lambda = if j < rigid.ncols() { 0.0 } else { base.eigenvalues[j - rigid.ncols()] };
        stiff.col_as_slice_mut(j).iter_mut().for_each(|x| *x *= lambda + sigma);
    }
    let stretch = a.transpose_times(s.as_ref());
    a.add_times(&mut stiff, stretch.as_ref());

    // T = G (I + C)⁻¹ AᵀS; all of G where that is no wider.
    let mut space = TrialSpace::new(s, stiff, mass);
    if a.n_columns() > 0 {
        let t = if a.n_columns() <= stretch.ncols() {
            stitched.g().to_owned()
        } else {
            linalg::product(stitched.g(), stitched.capacitance_solve(stretch.as_ref()).as_ref())
        };
        space.extend(t, problem)?;
    }
    let kept = base.eigenvalues.len();
    let mut round = 0;
    loop {
        control::check(control)?;
        control.progress(Stage::Modes, round as f64 / 4.0);
        let (theta, c) = space.ritz()?;
        let available = theta.len().saturating_sub(n_rigid_left).min(kept);
        let wanted = n_modes.min(available);
        let shapes = linalg::product(space.s.as_ref(), c.subcols(n_rigid_left, wanted));
        let eigenvalues: Vec<f64> =
            theta[n_rigid_left..][..wanted].iter().map(|t| t.recip() - sigma).collect();
        let product = stitched.multiply(shapes.as_ref());
        let residual = residual_vectors(product, mass, shapes.as_ref(), &eigenvalues);
        let solved = stitched.solve(residual.as_ref());
        let residuals = relative_residuals(residual.as_ref(), solved.as_ref(), &eigenvalues, sigma);
        let beyond = theta.get(n_rigid_left + available).copied().unwrap_or(0.0);
        let error_estimates: Vec<f64> = (0..wanted)
            .map(|i| {
                let theta = theta[n_rigid_left + i];
                let gap = ((theta - beyond) / theta).max(f64::EPSILON);
                let shifted = residuals[i].min(residuals[i].powi(2) / gap);
                shifted * (eigenvalues[i] + sigma) / eigenvalues[i].max(f64::MIN_POSITIVE)
            })
            .collect();
        let accepted = |i: usize| {
            let factor = if 2 * i < wanted { 1.0 } else { UPPER_HALF_FACTOR };
            error_estimates[i] <= factor * tolerance
        };
        round += 1;
        let unaccepted: Vec<usize> = (0..wanted).filter(|&i| !accepted(i)).collect();
        if unaccepted.is_empty() || round == MOST_ROUNDS {
            // The Ritz vectors are orthonormal to about 1e-10 where large rigid parts cancelled.
            let gram =
                linalg::SmallCholesky::new(mass.inner(shapes.as_ref(), shapes.as_ref()).as_ref())?;
            let modes = LinearModes { shapes: gram.orthonormalize(shapes.as_ref()), eigenvalues };
            return Ok(Updated { modes, residuals, error_estimates, n_rounds: round });
        }
        let pick =
            |x: &Mat<f64>| Mat::from_fn(x.nrows(), unaccepted.len(), |i, j| x[(i, unaccepted[j])]);
        space.extend(pick(&solved), problem)?;
    }
}
