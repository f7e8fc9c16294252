//! The paper's update (\[M16\] §4.1, eq. 8–12): K is replaced by its low-frequency part
//! MUΛUᵀM, and the eigenproblem of MUΛUᵀM + AAᵀ is solved exactly in span [U, M⁻¹A].
//!
//! With B = UᵀA and the Gram matrix G = AᵀM⁻¹A − BᵀB, P = (M⁻¹A − UB) G^(−1/2) is M-orthonormal and
//! M-orthogonal to U, and R of eq. 9 is G^(1/2): neither L⁻¹ nor Gram–Schmidt on n-vectors is needed.
//!
//! Its weakness is the paper's assumption: the dropped high-frequency stiffness is *zero* in the
//! approximation, so P's spikes at the stitched vertices close a cut at no elastic cost, and the
//! updated frequencies do not rise. Kept because it is the published method.

use crate::assembly::mass::Mass;
use crate::factorization::{FactorizationError, SparseCholesky};
use crate::linalg::{self, DenseError};
use crate::modes::LinearModes;
use crate::modes::stitched::StitchMatrix;
use faer::{Mat, MatRef};

/// M⁻¹, ready to apply.
#[derive(Debug)]
pub enum MassInverse {
    /// Reciprocals of the lumped masses.
    Lumped(Vec<f64>),
    /// A factorization over vertices (M is the same on the three axes).
    Consistent(Box<SparseCholesky>),
}

impl MassInverse {
    /// Factorizes M.
    pub fn new(mass: &Mass) -> Result<MassInverse, FactorizationError> {
        Ok(match mass {
            Mass::Lumped(masses) => MassInverse::Lumped(masses.iter().map(|m| m.recip()).collect()),
            Mass::Consistent(matrix) => {
                MassInverse::Consistent(Box::new(SparseCholesky::of_scalars(matrix)?))
            }
        })
    }

    /// `M⁻¹X`.
    pub fn apply(&self, mut x: Mat<f64>) -> Mat<f64> {
        match self {
            MassInverse::Lumped(inverse) => {
                for j in 0..x.ncols() {
                    for (three, m) in x.col_as_slice_mut(j).chunks_exact_mut(3).zip(inverse) {
                        three.iter_mut().for_each(|x| *x *= m);
                    }
                }
                x
            }
            MassInverse::Consistent(factor) => {
                let k = x.ncols();
                let mut axes = Mat::from_fn(factor.n(), 3 * k, |v, j| x[(3 * v + j % 3, j / 3)]);
                factor.solve_in_place(axes.as_mut());
                Mat::from_fn(x.nrows(), k, |i, j| axes[(i / 3, 3 * j + i % 3)])
            }
        }
    }
}

/// The `count` lowest eigenpairs of MUΛUᵀM + AAᵀ. `u` is n×r and M-orthonormal with eigenvalues
/// `lambda`, rigid modes (λ = 0) included, as \[M16\] §4.1.1 advises.
pub fn update(
    u: MatRef<'_, f64>,
    lambda: &[f64],
    a: &StitchMatrix,
    inverse: &MassInverse,
    count: usize,
) -> Result<LinearModes, DenseError> {
    let r = u.ncols();
    let b = a.transpose_times(u).transpose().to_owned();
    let minv_a = inverse.apply(a.dense(u.nrows()));
    let mut gram = a.transpose_times(minv_a.as_ref());
    gram -= linalg::small_product(b.transpose(), b.as_ref());
    // Stitches that the modes already represent (or duplicates of each other) leave no direction.
    let (values, q) = linalg::symmetric_eigen(gram.as_ref())?;
    let first = values.partition_point(|&v| v <= 1e-12 * values.last().copied().unwrap_or(0.0));
    let s = values.len() - first;
    // P = (M⁻¹A − UB) Q D^(−1/2) and R = D^(1/2) Qᵀ: G^(∓1/2) up to a rotation of P's columns.
    let to_p = Mat::from_fn(values.len(), s, |i, j| q[(i, first + j)] / values[first + j].sqrt());
    let remainder =
        Mat::from_fn(s, values.len(), |i, j| values[first + i].sqrt() * q[(j, first + i)]);

    let stacked =
        Mat::from_fn(
            r + s,
            b.ncols(),
            |i, j| {
                if i < r { b[(i, j)] } else { remainder[(i - r, j)] }
            },
        );
    let mut c = linalg::small_product(stacked.as_ref(), stacked.transpose());
    for (i, lambda) in lambda.iter().enumerate() {
        c[(i, i)] += lambda;
    }
    let (eigenvalues, w) = linalg::symmetric_eigen(c.as_ref())?;
    let count = count.min(r + s);
    // Ū = U W₁ + P W₂ = U (W₁ − B T) + M⁻¹A T with T = Q D^(−1/2) W₂.
    let t = linalg::small_product(to_p.as_ref(), w.submatrix(r, 0, s, count));
    let mut w1 = w.submatrix(0, 0, r, count).to_owned();
    w1 -= linalg::small_product(b.as_ref(), t.as_ref());
    let mut shapes = linalg::product(u, w1.as_ref());
    linalg::add_product(shapes.as_mut(), 1.0, minv_a.as_ref(), t.as_ref());
    Ok(LinearModes {
        shapes: shapes.into(),
        eigenvalues: eigenvalues[..count].iter().map(|v| v.max(0.0)).collect(),
    })
}
