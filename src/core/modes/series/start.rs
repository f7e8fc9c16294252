//! What is known of X and of X̃ = K̂_σ⁻¹K_σX without anything of the size of the mesh.

use super::DEPENDENT;
use crate::linalg::{self, DenseError};
use faer::{Mat, MatRef};

/// The base body's modes X (p of them) under stitches.
pub(super) struct Start {
    /// Λ_σ = XᵀK_σX.
    pub(super) shifted: Vec<f64>,
    /// S = AᵀX.
    pub(super) stretch: Mat<f64>,
    /// (I + C)⁻¹S = AᵀX̃.
    pub(super) relaxed: Mat<f64>,
    /// X̃ᵀK̂_σX̃ = X̃ᵀK_σX = Λ_σ − Sᵀ(I + C)⁻¹S.
    tilde: Mat<f64>,
}

impl Start {
    pub(super) fn new(shifted: Vec<f64>, stretch: Mat<f64>, relaxed: Mat<f64>) -> Start {
        let eased = linalg::small_product(stretch.transpose(), relaxed.as_ref());
        let p = shifted.len();
        let tilde = Mat::from_fn(p, p, |i, j| {
            let diagonal = if i == j { shifted[i] } else { 0.0 };
            diagonal - 0.5 * (eased[(i, j)] + eased[(j, i)])
        });
        Start { shifted, stretch, relaxed, tilde }
    }

    /// p.
    pub(super) fn p(&self) -> usize {
        self.shifted.len()
    }

    /// Λ_σC.
    pub(super) fn weighed(&self, c: MatRef<'_, f64>) -> Mat<f64> {
        Mat::from_fn(c.nrows(), c.ncols(), |i, j| self.shifted[i] * c[(i, j)])
    }

    /// The Gram matrix in K̂_σ of [X, X̃Q].
    pub(super) fn gram_k(&self, q: MatRef<'_, f64>) -> Mat<f64> {
        let own = linalg::small_product(self.stretch.transpose(), self.stretch.as_ref());
        let own = Mat::from_fn(self.p(), self.p(), |i, j| {
            own[(i, j)] + if i == j { self.shifted[i] } else { 0.0 }
        });
        let corner = linalg::small_product(self.tilde.as_ref(), q);
        let corner = linalg::small_product(q.transpose(), corner.as_ref());
        let column = linalg::stacked(&[self.weighed(q).as_ref(), corner.as_ref()]);
        linalg::bordered_symmetric(own.as_ref(), column.as_ref())
    }

    /// Combinations Q of X̃ (p × at most `count`) for the lowest modes: those that it would have if nothing outside of X
    /// had mass (MacNeal's residual flexibility). A space of [X, X̃Q] is then about as good as one of [X, X̃].
    pub(super) fn best(&self, count: usize) -> Result<Mat<f64>, DenseError> {
        let p = self.p();
        let all = Mat::identity(p, p);
        if count >= p {
            return Ok(all);
        }
        // XᵀMX̃ = Λ_σ⁻¹XᵀK_σX̃.
        let inner = Mat::from_fn(p, p, |i, j| self.tilde[(i, j)] / self.shifted[i]);
        let corner = linalg::small_product(inner.transpose(), inner.as_ref());
        let column = linalg::stacked(&[inner.as_ref(), corner.as_ref()]);
        let gram_m = linalg::bordered_symmetric(all.as_ref(), column.as_ref());
        let gram_k = self.gram_k(all.as_ref());
        let (_, c) = linalg::inverse_ritz(gram_k.as_ref(), gram_m.as_ref(), DEPENDENT)?;
        let of_tilde = c.submatrix(p, 0, p, count.min(c.ncols()));
        let gram = linalg::small_product(self.tilde.as_ref(), of_tilde);
        let gram = linalg::small_product(of_tilde.transpose(), gram.as_ref());
        let turn = linalg::orthonormal_coefficients(gram.as_ref(), DEPENDENT)?;
        Ok(linalg::small_product(of_tilde, turn.as_ref()))
    }

    /// What of X̃ (p×p, in K̂_σ) lies outside of [X, X̃Q].
    pub(super) fn outside(&self, q: MatRef<'_, f64>) -> Result<Mat<f64>, DenseError> {
        let p = self.p();
        let of_x = self.weighed(Mat::<f64>::identity(p, p).as_ref());
        let of_q = linalg::small_product(q.transpose(), self.tilde.as_ref());
        let inner = linalg::stacked(&[of_x.as_ref(), of_q.as_ref()]);
        let basis = linalg::orthonormal_coefficients(self.gram_k(q).as_ref(), DEPENDENT)?;
        let onto = linalg::small_product(basis.transpose(), inner.as_ref());
        Ok(&self.tilde - linalg::small_product(onto.transpose(), onto.as_ref()))
    }

    /// By how much the rounding of a solve counts more in X̃, which may be the small difference of large vectors.
    pub(super) fn amplification(&self) -> f64 {
        let of = |j: usize| self.shifted[j] / self.tilde[(j, j)].max(f64::MIN_POSITIVE);
        (0..self.p()).map(of).fold(1.0, f64::max)
    }
}
