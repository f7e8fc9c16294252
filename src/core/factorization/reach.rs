//! Half solves for right-hand sides with few entries, such as a stitch has: they reach the rows on a path to the
//! root of the elimination tree, some separators out of thousands of supernodes, and only those are kept.

use super::SparseCholesky;
use super::solve;
use crate::lanes::{self, kernels::Real};
use crate::linalg;
use crate::pool::Tall;
use faer::{Mat, MatMut, MatRef};

/// L⁻¹A without the rows that no entry of A reaches, which are zero.
#[derive(Debug)]
pub struct ReachedRows {
    /// In the order of the factor, ascending.
    rows: Vec<u32>,
    /// Those rows, by the columns of A.
    values: Tall,
}

impl<T: Real> SparseCholesky<T> {
    /// L⁻¹A for the columns of A, each as its entries' rows (of the matrix) and values.
    pub fn forward_sparse(&self, columns: &[Vec<(usize, f64)>]) -> ReachedRows {
        let (rows, values) = solve::forward_sparse(&self.symbolic, &self.values, columns);
        ReachedRows { rows, values }
    }
}

impl ReachedRows {
    /// The rows that are kept, in the order of the factor.
    pub fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// Those rows of L⁻¹A.
    pub fn values(&self) -> MatRef<'_, f64> {
        self.values.as_ref()
    }

    /// Rows that are kept.
    pub fn n_rows(&self) -> usize {
        self.rows.len()
    }

    /// `(L⁻¹A)ᵀL⁻¹A`, which is AᵀK⁻¹A for K = LLᵀ.
    pub fn gram(&self) -> Mat<f64> {
        lanes::weighted_square(&[self.values()], |_| 1.0)
    }

    /// `(L⁻¹A)ᵀX` of all rows of X.
    pub fn transpose_times(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        let mut some = Mat::zeros(self.rows.len(), x.ncols());
        linalg::for_each_column(some.as_mut(), |j, some| {
            let column = x.col(j);
            some.iter_mut().zip(&self.rows).for_each(|(x, &row)| *x = column[row as usize]);
        });
        linalg::gram(self.values.as_ref(), some.as_ref())
    }

    /// `X += alpha·L⁻¹A·Z` on all rows of X.
    pub fn add_times(&self, x: MatMut<'_, f64>, alpha: f64, z: MatRef<'_, f64>) {
        let z = faer::Scale(alpha) * z;
        let product = linalg::tall_product(self.values.as_ref(), z.as_ref());
        linalg::for_each_column(x, |j, x| {
            let values = product.col_as_slice(j).iter().zip(&self.rows);
            values.for_each(|(value, &row)| x[row as usize] += value);
        });
    }
}
