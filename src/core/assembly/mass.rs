//! Mass matrices.

use super::sparse::ScalarMatrix;
use crate::linalg;
use faer::{Mat, MatRef};

/// How mass is distributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MassKind {
    /// A quarter of each tet's mass at each of its corners: a diagonal matrix.
    Lumped,
    /// ∫ρ NᵢNⱼ: ρV/20·(1 + δᵢⱼ) for each tet.
    Consistent,
}

/// M over the free degrees of freedom; the same for the three axes.
#[derive(Debug)]
pub enum Mass {
    /// One mass a free vertex, in kg.
    Lumped(Vec<f64>),
    /// Couples vertices that share a tet.
    Consistent(ScalarMatrix),
}

impl Mass {
    /// `M·X`, X being n×k.
    pub fn multiply(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        let mut y = Mat::zeros(x.nrows(), x.ncols());
        self.multiply_into(&mut y, x);
        y
    }

    /// `Y ← M·X`, both being n×k.
    pub fn multiply_into(&self, y: &mut Mat<f64>, x: MatRef<'_, f64>) {
        assert_eq!((y.nrows(), y.ncols()), (x.nrows(), x.ncols()));
        linalg::for_each_column(y, |j, y| {
            for (y, x) in y.iter_mut().zip(x.col(j).iter()) {
                *y = *x;
            }
            match self {
                Mass::Lumped(masses) => {
                    for (three, m) in y.chunks_exact_mut(3).zip(masses) {
                        three.iter_mut().for_each(|y| *y *= m);
                    }
                }
                Mass::Consistent(matrix) => {
                    let source = y.to_vec();
                    matrix.multiply_column(&source, y);
                }
            }
        });
    }

    /// Entry of M between two free vertices that a tet couples (0 otherwise, or off the diagonal
    /// of a lumped matrix).
    pub fn entry(&self, row: usize, column: usize) -> f64 {
        match self {
            Mass::Lumped(masses) => {
                if row == column {
                    masses[row]
                } else {
                    0.0
                }
            }
            Mass::Consistent(matrix) => matrix
                .pattern()
                .find(row, column as u32)
                .map_or(0.0, |entry| matrix.values()[entry]),
        }
    }

    /// `XᵀMY`.
    pub fn inner(&self, x: MatRef<'_, f64>, y: MatRef<'_, f64>) -> Mat<f64> {
        match self {
            Mass::Lumped(masses) => linalg::weighted_gram(x, |row| masses[row / 3], y),
            Mass::Consistent(_) => linalg::gram(x, self.multiply(y).as_ref()),
        }
    }

    /// M-orthonormal columns with the span of X, twice orthogonalized; directions that are
    /// dependent to within `drop` (squared, relative) are left out.
    pub fn orthonormalize(
        &self,
        x: MatRef<'_, f64>,
        drop: f64,
    ) -> Result<Mat<f64>, linalg::DenseError> {
        let first = linalg::orthonormal_coefficients(self.inner(x, x).as_ref(), drop)?;
        let y = linalg::product(x, first.as_ref());
        let second = linalg::SmallCholesky::new(self.inner(y.as_ref(), y.as_ref()).as_ref())?;
        Ok(linalg::product(y.as_ref(), second.whitening().as_ref()))
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        match self {
            Mass::Lumped(masses) => size_of_val(&masses[..]),
            Mass::Consistent(matrix) => size_of_val(matrix.values()),
        }
    }
}
