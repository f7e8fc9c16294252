//! Sparse Cholesky factorization A = L Lᵀ: nested dissection of the *vertex* graph, supernodes, a
//! multifrontal factorization and blocked solves that keep all cores busy.

mod front;
mod numeric;
mod ordering;
mod panel;
mod reach;
mod solve;
mod symbolic;

pub use reach::ReachedRows;
pub use symbolic::SymbolicCholesky;

use crate::assembly::mass::Mass;
use crate::assembly::sparse::{BlockMatrix, ScalarMatrix};
use crate::lanes::LaneBlock;
use crate::lanes::kernels::Real;
use crate::pool::Tall;
use faer::{MatMut, MatRef};
use rayon::prelude::*;
use solve::Task;
use std::sync::Arc;

/// Why a matrix could not be factorized.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FactorizationError {
    /// The matrix is not positive definite to working precision.
    #[error("non-positive pivot at row {row}")]
    NonPositivePivot {
        /// Row of the original matrix.
        row: usize,
    },
    /// The ordering library failed or returned no permutation.
    #[error("the ordering failed: {0}")]
    Ordering(String),
    /// The factor would not fit into memory or index range.
    #[error("the factor is too large")]
    TooLarge,
}

/// A sparse Cholesky factorization, ready to solve, whose factor is held in numbers `T`. Right-hand sides and solutions
/// are in double precision.
#[derive(Debug)]
pub struct SparseCholesky<T = f64> {
    symbolic: Arc<SymbolicCholesky>,
    /// Of each piece of the analysis.
    values: Vec<Vec<T>>,
}

impl SparseCholesky {
    /// Analyses and factorizes a symmetric positive definite block matrix.
    pub fn of_blocks(a: &BlockMatrix) -> Result<SparseCholesky, FactorizationError> {
        let symbolic = Arc::new(SymbolicCholesky::new(a.pattern().clone(), 3)?);
        SparseCholesky::with_symbolic(symbolic, a)
    }

    /// Factorizes a symmetric positive definite block matrix whose pattern has been analysed.
    pub fn with_symbolic(
        symbolic: Arc<SymbolicCholesky>,
        a: &BlockMatrix,
    ) -> Result<SparseCholesky, FactorizationError> {
        assert!(symbolic.is_of(a.pattern(), 3), "the analysis belongs to another pattern");
        let values = numeric::factorize(&symbolic, a.blocks().as_flattened())
            .map_err(|row| FactorizationError::NonPositivePivot { row })?;
        Ok(SparseCholesky { symbolic, values })
    }

    /// Analyses and factorizes a symmetric positive definite matrix with one number an entry.
    pub fn of_scalars(a: &ScalarMatrix) -> Result<SparseCholesky, FactorizationError> {
        let symbolic = Arc::new(SymbolicCholesky::new(a.pattern().clone(), 1)?);
        let values = numeric::factorize(&symbolic, a.values())
            .map_err(|row| FactorizationError::NonPositivePivot { row })?;
        Ok(SparseCholesky { symbolic, values })
    }

    /// The factor rounded to single precision. Solves with it read half as much, and are as exact as the matrix is well
    /// conditioned.
    pub fn rounded(&self) -> SparseCholesky<f32> {
        let rounded = |piece: &Vec<f64>| piece.iter().map(|value| *value as f32).collect();
        SparseCholesky {
            symbolic: self.symbolic.clone(),
            values: self.values.par_iter().map(rounded).collect(),
        }
    }

    /// Overwrites eight vectors, whose rows are in the order of the factor ([`SymbolicCholesky::order`]), by A⁻¹ of
    /// them.
    pub fn solve_lanes(&self, b: &mut LaneBlock) {
        assert_eq!(b.n(), self.n());
        solve::solve_lanes(&self.symbolic, &self.values, b);
    }
}

impl<T: Real> SparseCholesky<T> {
    /// The structure, to factorize other matrices with the same pattern.
    pub fn symbolic(&self) -> &Arc<SymbolicCholesky> {
        &self.symbolic
    }

    /// Rows of the matrix.
    pub fn n(&self) -> usize {
        self.symbolic.n()
    }

    /// Overwrites B (n×k) by A⁻¹B.
    pub fn solve_in_place(&self, b: MatMut<'_, f64>) {
        self.run(Task::Both, b);
    }

    /// The same with `rows` of X = L⁻¹B, in the order of the factor, changed on the way: `correction` makes of these
    /// (rows × some columns) what to add to them.
    pub fn solve_corrected(
        &self,
        b: MatMut<'_, f64>,
        rows: &[u32],
        correction: &(dyn Fn(MatRef<'_, f64>) -> Tall + Sync),
    ) {
        self.run(Task::Corrected(rows, correction), b);
    }

    /// Overwrites B (n×k) by L⁻¹B, whose rows are in the order of the factor.
    pub fn forward_in_place(&self, b: MatMut<'_, f64>) {
        self.run(Task::Forward, b);
    }

    /// Overwrites B (n×k), whose rows are in the order of the factor, by L⁻ᵀB.
    pub fn backward_in_place(&self, b: MatMut<'_, f64>) {
        self.run(Task::Backward, b);
    }

    /// `B ← L⁻ᵀX` of X that has entries in `rows` alone, in the order of the factor, which are `x` (rows × k).
    pub fn spread(&self, b: MatMut<'_, f64>, rows: &[u32], x: MatRef<'_, f64>) {
        self.run(Task::Spread(rows, x), b);
    }

    fn run(&self, task: Task<'_>, b: MatMut<'_, f64>) {
        assert_eq!(b.nrows(), self.n());
        solve::solve_in_place(&self.symbolic, &self.values, task, b);
    }

    /// Bytes held by the factor.
    pub fn bytes(&self) -> usize {
        self.values.iter().map(|piece| size_of_val(&piece[..])).sum()
    }
}

/// K + σM.
pub fn shifted(stiffness: &BlockMatrix, sigma_per_s2: f64, mass: &Mass) -> BlockMatrix {
    let mut sum = stiffness.clone();
    if sigma_per_s2 != 0.0 {
        let pattern = sum.pattern().clone();
        let blocks = sum.blocks_mut();
        for row in 0..pattern.n() {
            for (entry, &column) in pattern.range(row).zip(pattern.row(row)) {
                let m = sigma_per_s2 * mass.entry(row, column as usize);
                for axis in 0..3 {
                    blocks[entry][4 * axis] += m;
                }
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assembly::sparse::Pattern;
    use faer::Mat;
    use std::sync::Arc;

    /// A chain of 3×3 blocks, diagonally dominant; two disconnected pieces.
    fn chain(n: usize, diagonal: f64) -> BlockMatrix {
        let pairs: Vec<[u32; 2]> =
            (0..n as u32 - 1).filter(|&v| v as usize != n / 2).map(|v| [v, v + 1]).collect();
        let pattern = Arc::new(Pattern::new(n, &[], &pairs));
        let mut blocks = vec![[0.0; 9]; pattern.n_entries()];
        for v in 0..n {
            for (entry, &w) in pattern.range(v).zip(pattern.row(v)) {
                let (low, high) = (v.min(w as usize), v.max(w as usize));
                blocks[entry] = std::array::from_fn(|i| {
                    let (r, c) = if v <= w as usize { (i / 3, i % 3) } else { (i % 3, i / 3) };
                    if low == high {
                        if r == c { diagonal } else { 0.25 }
                    } else {
                        ((low * 9 + r * 3 + c) as f64).sin()
                    }
                });
            }
        }
        BlockMatrix::new(pattern, blocks)
    }

    /// A grid of m³ vertices, diagonally dominant: its top separator is several chunks wide.
    fn grid(m: u32) -> BlockMatrix {
        let at = |x: u32, y: u32, z: u32| x + m * (y + m * z);
        let mut pairs = Vec::new();
        for z in 0..m {
            for y in 0..m {
                for x in 0..m {
                    let ahead = [(x + 1, y, z), (x, y + 1, z), (x, y, z + 1)];
                    let inside = ahead.into_iter().filter(|&(x, y, z)| x.max(y).max(z) < m);
                    pairs.extend(inside.map(|(a, b, c)| [at(x, y, z), at(a, b, c)]));
                }
            }
        }
        let pattern = Arc::new(Pattern::new((m * m * m) as usize, &[], &pairs));
        let mut blocks = vec![[0.0; 9]; pattern.n_entries()];
        for v in 0..pattern.n() {
            for (entry, &w) in pattern.range(v).zip(pattern.row(v)) {
                let weight = ((v + w as usize) as f64).sin();
                blocks[entry] = if v == w as usize {
                    [20.0, 1.0, 0.0, 1.0, 20.0, 1.0, 0.0, 1.0, 20.0]
                } else {
                    [-1.0, 0.3, weight, 0.3, -1.0, 0.0, weight, 0.0, -1.0]
                };
            }
        }
        BlockMatrix::new(pattern, blocks)
    }

    #[test]
    fn solves_to_rounding_with_few_and_many_right_hand_sides() {
        for a in [chain(60, 9.0), grid(13)] {
            let factor = SparseCholesky::of_blocks(&a).unwrap();
            for k in [1, 3, 40] {
                let b = Mat::from_fn(a.n(), k, |i, j| ((i + 7 * j) as f64).cos());
                let mut x = b.clone();
                factor.solve_in_place(x.as_mut());
                assert!((a.multiply(x.as_ref()) - &b).norm_max() < 1e-13, "{k}");
            }
        }
    }

    #[test]
    fn eight_vectors_abreast_are_solved_as_columns_are() {
        let a = grid(13);
        let factor = SparseCholesky::of_blocks(&a).unwrap();
        let b = Mat::from_fn(a.n(), 8, |i, j| ((i + 7 * j) as f64).cos());
        let mut columns = b.clone();
        factor.solve_in_place(columns.as_mut());
        let symbolic = factor.symbolic();
        let mut lanes = LaneBlock::of_columns(b.as_ref()).by_vertices(|at| symbolic.order()[at]);
        factor.solve_lanes(&mut lanes);
        let lanes = lanes.by_vertices(|vertex| symbolic.position()[vertex] as usize);
        let mut found = Mat::zeros(a.n(), 8);
        lanes.copy_to(found.as_mut());
        assert!(found == columns);
    }

    #[test]
    fn the_halves_make_the_whole() {
        let a = grid(9);
        let factor = SparseCholesky::of_blocks(&a).unwrap();
        let b = Mat::from_fn(a.n(), 20, |i, j| ((i + 7 * j) as f64).cos());
        let (mut whole, mut halves) = (b.clone(), b.clone());
        factor.solve_in_place(whole.as_mut());
        factor.forward_in_place(halves.as_mut());
        // BᵀA⁻¹B is the Gram matrix of L⁻¹B, in whatever order its rows are.
        let gram = halves.transpose() * &halves;
        assert!((gram - b.transpose() * &whole).norm_max() < 1e-12 * a.n() as f64);
        factor.backward_in_place(halves.as_mut());
        assert!((halves - whole).norm_max() == 0.0);
    }

    #[test]
    fn right_hand_sides_that_reach_little_are_solved_too() {
        let a = grid(9);
        let factor = SparseCholesky::of_blocks(&a).unwrap();
        for row in [0, 4, a.n() - 1] {
            let b = Mat::from_fn(a.n(), 1, |i, _| f64::from(i == row));
            let mut x = b.clone();
            factor.solve_in_place(x.as_mut());
            assert!((a.multiply(x.as_ref()) - &b).norm_max() < 1e-13, "{row}");
        }
    }

    #[test]
    fn half_solves_of_few_entries_are_those_of_whole_columns() {
        let a = grid(9);
        let n = a.n();
        let factor = SparseCholesky::of_blocks(&a).unwrap();
        for k in [3, 40] {
            let entries = |j: usize| vec![(37 * j % n, 1.0), ((37 * j + 5) % n, -0.5)];
            let columns: Vec<Vec<(usize, f64)>> = (0..k).map(entries).collect();
            let half = factor.forward_sparse(&columns);
            let mut dense = Mat::zeros(n, k);
            for (j, entries) in columns.iter().enumerate() {
                entries.iter().for_each(|&(row, value)| dense[(row, j)] = value);
            }
            factor.forward_in_place(dense.as_mut());
            let close = |found: Mat<f64>, exact: Mat<f64>| (found - exact).norm_max() < 1e-14;
            assert!(close(half.gram(), dense.transpose() * &dense), "{k}");
            let x = Mat::from_fn(n, 2, |i, j| ((3 * i + j) as f64).cos());
            assert!(close(half.transpose_times(x.as_ref()), dense.transpose() * &x), "{k}");
            let z = Mat::from_fn(k, 2, |i, j| ((i + 7 * j) as f64).sin());
            let mut sum = x.clone();
            half.add_times(sum.as_mut(), 2.0, z.as_ref());
            assert!(close(sum, x + faer::Scale(2.0) * &dense * &z), "{k}");
        }
        let one = factor.forward_sparse(&[vec![(0, 1.0)]]);
        assert!(one.n_rows() < n / 2);
    }

    #[test]
    fn a_rounded_factor_solves_to_single_precision_whatever_the_size_of_numbers() {
        let a = grid(13);
        let factor = SparseCholesky::of_blocks(&a).unwrap();
        let rounded = factor.rounded();
        assert_eq!(2 * rounded.bytes(), factor.bytes());
        for k in [1, 16, 20, 48, 70] {
            let size = |j: usize| [1.0, 1e-70, 1e70, 0.0][j % 4];
            let b = Mat::from_fn(a.n(), k, |i, j| size(j) * ((i + 7 * j) as f64).cos());
            let [mut exact, mut x] = [b.clone(), b];
            factor.solve_in_place(exact.as_mut());
            rounded.solve_in_place(x.as_mut());
            for j in 0..k {
                let error = (x.col(j) - exact.col(j)).norm_max();
                assert!(error <= 1e-5 * exact.col(j).norm_max(), "{k} {j}: {error:e}");
            }
        }
    }

    #[test]
    fn rows_are_corrected_between_the_halves() {
        let a = grid(9);
        let n = a.n();
        let factor = SparseCholesky::of_blocks(&a).unwrap();
        let rows: Vec<u32> = (0..n as u32).filter(|row| row % 7 == 3).collect();
        let b = Mat::from_fn(n, 40, |i, j| ((i + 7 * j) as f64).cos());
        let mut expected = b.clone();
        factor.forward_in_place(expected.as_mut());
        let mut sparse = Mat::zeros(rows.len(), 40);
        for (i, &row) in rows.iter().enumerate() {
            for j in 0..40 {
                sparse[(i, j)] = -0.5 * expected[(row as usize, j)];
                expected[(row as usize, j)] *= 0.5;
            }
        }
        factor.backward_in_place(expected.as_mut());
        let mut found = b.clone();
        factor.solve_corrected(found.as_mut(), &rows, &|x| (faer::Scale(-0.5) * x).into());
        assert!((&found - &expected).norm_max() < 1e-14);
        // What the rows alone lead to.
        let mut whole = b;
        factor.solve_in_place(whole.as_mut());
        let mut spread = Mat::zeros(n, 40);
        factor.spread(spread.as_mut(), &rows, sparse.as_ref());
        assert!((whole + spread - expected).norm_max() < 1e-14);
    }

    #[test]
    fn an_analysis_serves_other_values() {
        let mut a = grid(6);
        let first = SparseCholesky::of_blocks(&a).unwrap();
        a.blocks_mut().iter_mut().flatten().for_each(|value| *value *= 4.0);
        let second = SparseCholesky::with_symbolic(first.symbolic().clone(), &a).unwrap();
        let b = Mat::from_fn(a.n(), 2, |i, j| ((i * 3 + j) as f64).sin());
        let (mut x, mut y) = (b.clone(), b);
        first.solve_in_place(x.as_mut());
        second.solve_in_place(y.as_mut());
        assert!((x - faer::Scale(4.0) * y).norm_max() < 1e-14);
    }

    #[test]
    fn results_do_not_depend_on_the_number_of_threads() {
        let a = grid(13);
        let b = Mat::from_fn(a.n(), 9, |i, j| ((i + 7 * j) as f64).cos());
        let with = |n_threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
            pool.install(|| {
                let factor = SparseCholesky::of_blocks(&a).unwrap();
                let mut x = b.clone();
                factor.solve_in_place(x.as_mut());
                (factor.values, x)
            })
        };
        let (one, four) = (with(1), with(4));
        assert!(one.0 == four.0);
        assert!(one.1 == four.1);
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let error = SparseCholesky::of_blocks(&chain(60, 0.1)).unwrap_err();
        assert!(matches!(error, FactorizationError::NonPositivePivot { row } if row < 180));
    }
}
