//! Dense algebra of small matrices, over faer.
//!
//! Every call is sequential: faer's own parallelism spins on what is small (measured 2.6 × the processor
//! time of skinny products).

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Side};

/// A dense factorization or decomposition failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a dense {0} failed")]
pub struct DenseError(pub &'static str);

/// Runs `f` compiled for the best instruction set that this processor has. Only what is inlined into
/// `f` gains: mark `f` and what it calls `#[inline(always)]`.
pub fn vectorized<R>(f: impl FnMut() -> R) -> R {
    struct Operation<F>(F);
    impl<R, F: FnMut() -> R> pulp::WithSimd for Operation<F> {
        type Output = R;
        // Through FnMut: calling a closure as FnOnce goes through a shim that is not inlined.
        #[inline(always)]
        fn with_simd<S: pulp::Simd>(mut self, _: S) -> R {
            (self.0)()
        }
    }
    pulp::Arch::new().dispatch(Operation(f))
}

/// Makes faer's implicit global parallelism sequential; called by everything that decomposes.
pub fn sequential() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| faer::set_global_parallelism(Par::Seq));
}

/// `A·B` of small matrices.
pub fn small_product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut c = Mat::zeros(a.nrows(), b.ncols());
    matmul(c.as_mut(), Accum::Replace, a, b, 1.0, Par::Seq);
    c
}

/// Eigenvalues (ascending) and orthonormal eigenvectors of a small symmetric matrix; the two
/// triangles are averaged.
pub fn symmetric_eigen(a: MatRef<'_, f64>) -> Result<(Vec<f64>, Mat<f64>), DenseError> {
    if a.nrows() == 0 {
        // faer panics on an empty matrix.
        return Ok((Vec::new(), Mat::zeros(0, 0)));
    }
    sequential();
    let symmetric = Mat::from_fn(a.nrows(), a.ncols(), |i, j| 0.5 * (a[(i, j)] + a[(j, i)]));
    let eigen = symmetric
        .self_adjoint_eigen(Side::Lower)
        .map_err(|_| DenseError("symmetric eigendecomposition"))?;
    let values: Vec<f64> = (0..a.nrows()).map(|i| eigen.S()[i]).collect();
    if values.iter().any(|v| !v.is_finite()) {
        return Err(DenseError("symmetric eigendecomposition"));
    }
    Ok((values, eigen.U().to_owned()))
}

/// A Cholesky factorization of a small symmetric positive definite matrix.
pub struct SmallCholesky(faer::linalg::solvers::Llt<f64>);

impl SmallCholesky {
    /// Factorizes the lower triangle of `a`.
    pub fn new(a: MatRef<'_, f64>) -> Result<SmallCholesky, DenseError> {
        sequential();
        a.llt(Side::Lower).map(SmallCholesky).map_err(|_| DenseError("Cholesky factorization"))
    }

    /// `A⁻¹B`.
    pub fn solve(&self, b: MatRef<'_, f64>) -> Mat<f64> {
        use faer::prelude::Solve;
        if b.nrows() == 0 || b.ncols() == 0 {
            return b.to_owned();
        }
        self.0.solve(b)
    }

    /// L.
    pub fn lower(&self) -> MatRef<'_, f64> {
        self.0.L()
    }

    /// L⁻ᵀ: with A = BᵀMB, the columns of B·L⁻ᵀ are M-orthonormal.
    pub fn whitening(&self) -> Mat<f64> {
        lower_inverse(self.0.L()).transpose().to_owned()
    }
}

/// A⁻¹B of a square matrix, by elimination with partial pivoting; not finite if A is singular.
pub fn solve_unsymmetric(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    use faer::prelude::Solve;
    sequential();
    a.partial_piv_lu().solve(b)
}

/// L⁻¹ of a lower triangular matrix.
pub fn lower_inverse(l: MatRef<'_, f64>) -> Mat<f64> {
    let mut inverse = Mat::<f64>::identity(l.nrows(), l.nrows());
    faer::linalg::triangular_solve::solve_lower_triangular_in_place(l, inverse.as_mut(), Par::Seq);
    inverse
}
