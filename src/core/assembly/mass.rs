//! Mass matrices.

use super::sparse::ScalarMatrix;
use crate::lanes::{self, LaneBlock};
use crate::linalg;
use faer::{Mat, MatMut, MatRef};
use rayon::prelude::*;

/// Columns of a Gram matrix that are made at a time.
const COLUMNS_AT_A_TIME: usize = 32;

/// Vertices whose rows one task weighs.
const VERTICES_PER_TASK: usize = 512;

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
        self.multiply_into(y.as_mut(), x);
        y
    }

    /// `Y ← M·X`, both being n×k.
    pub fn multiply_into(&self, y: MatMut<'_, f64>, x: MatRef<'_, f64>) {
        assert_eq!((y.nrows(), y.ncols()), (x.nrows(), x.ncols()));
        match self {
            Mass::Lumped(masses) => linalg::for_each_column(y, |j, y| {
                y.iter_mut().zip(x.col(j).iter()).for_each(|(y, x)| *y = *x);
                for (three, m) in y.chunks_exact_mut(3).zip(masses) {
                    three.iter_mut().for_each(|y| *y *= m);
                }
            }),
            Mass::Consistent(matrix) => matrix.multiply_into(y, x),
        }
    }

    /// The same with vertex `order[i]` in place of vertex `i`, `position` being the inverse of `order`.
    pub fn permuted(&self, order: &[usize], position: &[u32]) -> Mass {
        match self {
            Mass::Lumped(masses) => Mass::Lumped(order.iter().map(|&v| masses[v]).collect()),
            Mass::Consistent(matrix) => Mass::Consistent(matrix.permuted(order, position)),
        }
    }

    /// `Y ← M·X` of eight vectors.
    pub fn multiply_lanes(&self, y: &mut LaneBlock, x: &LaneBlock) {
        assert_eq!(y.n(), x.n());
        match self {
            Mass::Lumped(masses) => {
                let y = y.rows_mut().par_chunks_mut(3 * VERTICES_PER_TASK);
                let x = x.rows().par_chunks(3 * VERTICES_PER_TASK);
                y.zip(x).zip(masses.par_chunks(VERTICES_PER_TASK)).for_each(|((y, x), masses)| {
                    let rows = y.chunks_exact_mut(3).zip(x.chunks_exact(3)).zip(masses);
                    for ((y, x), m) in rows {
                        let numbers = y.as_flattened_mut().iter_mut().zip(x.as_flattened());
                        numbers.for_each(|(y, x)| *y = m * x);
                    }
                });
            }
            Mass::Consistent(matrix) => matrix.multiply_lanes(y, x),
        }
    }

    /// `XᵀMY` (8·blocks × 8).
    pub fn inner_lanes(&self, x: &[LaneBlock], y: &LaneBlock) -> Mat<f64> {
        match self {
            Mass::Lumped(masses) => lanes::weighted_gram(x, |row| masses[row / 3], y),
            Mass::Consistent(matrix) => {
                let mut weighed = LaneBlock::zeros(y.n());
                matrix.multiply_lanes(&mut weighed, y);
                lanes::weighted_gram(x, |_| 1.0, &weighed)
            }
        }
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
            // The narrower of the two is weighed.
            Mass::Consistent(_) if x.ncols() < y.ncols() => self.inner(y, x).transpose().to_owned(),
            Mass::Consistent(_) => linalg::gram(x, self.multiply(y).as_ref()),
        }
    }

    /// `XᵀMX` of the columns of `parts` side by side.
    pub fn gram_of_parts(&self, parts: &[MatRef<'_, f64>]) -> Mat<f64> {
        if let Mass::Lumped(masses) = self {
            return lanes::weighted_square(parts, |row| masses[row / 3]);
        }
        let k = parts.iter().map(|part| part.ncols()).sum();
        let mut gram = Mat::zeros(k, k);
        let mut row = 0;
        for (i, part) in parts.iter().enumerate() {
            let mut column = 0;
            for (j, other) in parts[..=i].iter().enumerate() {
                let block = match j == i {
                    true => self.gram(*part),
                    false => self.inner(*part, *other),
                };
                let (rows, columns) = (block.nrows(), block.ncols());
                gram.as_mut().submatrix_mut(row, column, rows, columns).copy_from(&block);
                if j < i {
                    let mut mirrored = gram.as_mut().submatrix_mut(column, row, columns, rows);
                    mirrored.copy_from(block.transpose());
                }
                column += columns;
            }
            row += part.ncols();
        }
        gram
    }

    /// Makes X (n×k) by `make(first row, rows)`, some rows at a time, and XᵀMX with it. Returns what `make` does.
    pub fn gram_of_made<T: Send>(
        &self,
        mut x: MatMut<'_, f64>,
        make: impl Fn(usize, MatMut<'_, f64>) -> T + Sync,
    ) -> (Vec<T>, Mat<f64>) {
        if let Mass::Lumped(masses) = self {
            return lanes::weighted_square_of_made(x, make, |row| masses[row / 3]);
        }
        let rows = x.as_mut().par_row_chunks_mut(3 * VERTICES_PER_TASK).enumerate();
        let made = rows.map(|(task, rows)| make(3 * VERTICES_PER_TASK * task, rows)).collect();
        (made, self.gram(x.as_ref()))
    }

    /// `XᵀMX`, of which about half is computed where X is wide.
    pub fn gram(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        if let Mass::Lumped(_) = self {
            return self.gram_of_parts(&[x]);
        }
        let k = x.ncols();
        let mut gram = Mat::zeros(k, k);
        for first in (0..k).step_by(COLUMNS_AT_A_TIME) {
            let some = x.subcols(first, COLUMNS_AT_A_TIME.min(k - first));
            let lower = self.inner(x.subcols(first, k - first), some);
            gram.as_mut().submatrix_mut(first, first, k - first, some.ncols()).copy_from(&lower);
            let end = first + some.ncols();
            let below = lower.subrows(some.ncols(), k - end);
            let mut mirrored = gram.as_mut().submatrix_mut(first, end, some.ncols(), k - end);
            mirrored.copy_from(below.transpose());
        }
        gram
    }

    /// M-orthonormal columns with the span of X, twice orthogonalized; directions that are
    /// dependent to within `drop` (squared, relative) are left out.
    pub fn orthonormalize(
        &self,
        x: MatRef<'_, f64>,
        drop: f64,
    ) -> Result<Mat<f64>, linalg::DenseError> {
        let first = linalg::orthonormal_coefficients(self.gram(x).as_ref(), drop)?;
        let y = linalg::product(x, first.as_ref());
        let second = linalg::SmallCholesky::new(self.gram(y.as_ref()).as_ref())?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assembly::FullModel;
    use crate::material::Material;
    use crate::testing::{Bar, Cell, Cut};
    use std::sync::Arc;

    #[test]
    fn inner_products_are_those_of_the_product() {
        let bar =
            Bar { size_m: [0.2, 0.05, 0.05], n_cells: [6, 2, 2], cell: Cell::Six, cut: Cut::Whole }
                .mesh();
        let material = Material::stvk(5e5, 0.4, 1000.0).unwrap();
        let model = FullModel::new(bar.mesh.clone(), &[material], &bar.root);
        let pattern = Arc::new(model.pattern(&[]));
        let columns =
            |k: usize| Mat::from_fn(model.n(), k, |i, j| ((3 * i + 7 * i * j) as f64).sin());
        // More columns than are made at a time, and not a multiple of them.
        let (wide, narrow) = (columns(2 * COLUMNS_AT_A_TIME + 5), columns(3));
        for kind in [MassKind::Lumped, MassKind::Consistent] {
            let mass = model.mass(kind, &pattern);
            let weighed = mass.multiply(wide.as_ref());
            let size = (wide.transpose() * &weighed).norm_max();
            let close =
                |found: Mat<f64>, exact: Mat<f64>| (found - exact).norm_max() < 1e-13 * size;
            assert!(close(mass.gram(wide.as_ref()), wide.transpose() * &weighed), "{kind:?}");
            let [wide, narrow] = [wide.as_ref(), narrow.as_ref()];
            let [left, right] = [wide.subcols(0, 7), wide.subcols(7, wide.ncols() - 7)];
            assert!(close(mass.gram_of_parts(&[left, right]), mass.gram(wide)), "{kind:?}");
            let mut made = Mat::from_fn(model.n(), wide.ncols(), |_, _| f64::NAN);
            let (firsts, gram) = mass.gram_of_made(made.as_mut(), |first, mut rows| {
                rows.copy_from(wide.subrows(first, rows.nrows()));
                first
            });
            assert!(firsts.is_sorted() && firsts[0] == 0 && (&made - wide).norm_max() == 0.0);
            assert!(close(gram, mass.gram(wide)), "{kind:?}");
            assert!(close(mass.inner(wide, narrow), weighed.transpose() * narrow), "{kind:?}");
            assert!(close(mass.inner(narrow, wide), narrow.transpose() * &weighed), "{kind:?}");
            let lanes = LaneBlock::of_columns(narrow);
            let inner = mass.inner_lanes(&LaneBlock::split(wide), &lanes);
            let inner = inner.get(..wide.ncols(), ..3).to_owned();
            assert!(close(inner, weighed.transpose() * narrow), "{kind:?}");
            let mut product = Mat::zeros(model.n(), 3);
            let mut weighed = LaneBlock::zeros(model.n());
            mass.multiply_lanes(&mut weighed, &lanes);
            weighed.copy_to(product.as_mut());
            assert!(close(product, mass.multiply(narrow)), "{kind:?}");
        }
    }
}
