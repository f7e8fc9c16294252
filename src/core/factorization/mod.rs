//! Sparse Cholesky factorization A = L Lᵀ, supernodal (faer), after a nested-dissection ordering of
//! the *vertex* graph.
//!
//! Ordering vertices and expanding by three gives the fill of ordering degrees of freedom in a
//! third of the time; minimum degree (faer's own) costs five times the flops on solids. The
//! ordering is pure Rust: METIS is 6 % better but replaces the process's signal handlers while it
//! runs. faer's own threading gains nothing here, so several right-hand sides are split by columns.

mod solve;

use crate::assembly::mass::Mass;
use crate::assembly::sparse::{BlockMatrix, Pattern, ScalarMatrix};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization};
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    self, CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{MatMut, Par, Side, Spec};
use feral_ordering_core::CscPattern;
use rayon::prelude::*;

/// Columns below which splitting a blocked solve between threads loses more than it gains: a
/// supernodal solve reads all of L for every block of columns.
const MIN_COLUMNS_PER_THREAD: usize = 12;

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

/// A sparse Cholesky factorization, ready to solve.
#[derive(Debug)]
pub struct SparseCholesky {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    /// Row of the matrix at each position of the factor.
    order: Vec<usize>,
}

impl SparseCholesky {
    /// Factorizes a symmetric positive definite block matrix.
    pub fn of_blocks(a: &BlockMatrix) -> Result<SparseCholesky, FactorizationError> {
        // Only the upper block triangle (v, w ≥ v) is read: entry (3w+r, 3v+c) of the lower
        // triangle is entry (c, r) of block (v, w).
        factorize(a.pattern(), 3, |entry, row, column| a.blocks()[entry][3 * column + row])
    }

    /// Factorizes a symmetric positive definite matrix with one number an entry.
    pub fn of_scalars(a: &ScalarMatrix) -> Result<SparseCholesky, FactorizationError> {
        factorize(a.pattern(), 1, |entry, _, _| a.values()[entry])
    }

    /// Rows of the matrix.
    pub fn n(&self) -> usize {
        self.order.len()
    }

    /// Overwrites B (n×k) by A⁻¹B.
    pub fn solve_in_place(&self, b: MatMut<'_, f64>) {
        assert_eq!(b.nrows(), self.n());
        let k = b.ncols();
        let pieces = (k / MIN_COLUMNS_PER_THREAD).clamp(1, rayon::current_num_threads().max(1));
        let SymbolicCholeskyRaw::Supernodal(symbolic) = self.symbolic.raw() else {
            unreachable!("the symbolic factorization is forced to be supernodal");
        };
        let solve = |piece: MatMut<'_, f64>| {
            solve::solve_in_place(symbolic, &self.values, &self.order, piece);
        };
        if k == 0 {
        } else if pieces == 1 {
            solve(b);
        } else {
            b.par_col_chunks_mut(k.div_ceil(pieces)).for_each(solve);
        }
    }

    /// Bytes held by the factor.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.values[..])
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

fn factorize(
    pattern: &Pattern,
    size: usize,
    value: impl Fn(usize, usize, usize) -> f64,
) -> Result<SparseCholesky, FactorizationError> {
    let n = size * pattern.n();
    let order = nested_dissection(pattern)?;
    let forward: Vec<usize> =
        order.iter().flat_map(|&v| (0..size).map(move |axis| size * v + axis)).collect();
    let mut inverse = vec![0; n];
    for (new, &old) in forward.iter().enumerate() {
        inverse[old] = new;
    }

    let mut column_start = Vec::with_capacity(n + 1);
    column_start.push(0);
    let mut rows = Vec::new();
    let mut values = Vec::new();
    for v in 0..pattern.n() {
        for column in 0..size {
            for (entry, &w) in pattern.range(v).zip(pattern.row(v)) {
                let first = match (w as usize).cmp(&v) {
                    std::cmp::Ordering::Less => continue,
                    std::cmp::Ordering::Equal => column,
                    std::cmp::Ordering::Greater => 0,
                };
                for row in first..size {
                    rows.push(size * w as usize + row);
                    values.push(value(entry, row, column));
                }
            }
            column_start.push(rows.len());
        }
    }

    // The pattern is sorted and the permutation checked, so neither constructor can panic.
    let symbol = SymbolicSparseColMatRef::new_checked(n, n, &column_start, None, &rows);
    let params = CholeskySymbolicParams {
        supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
        ..Default::default()
    };
    let symbolic = cholesky::factorize_symbolic_cholesky(
        symbol,
        Side::Lower,
        SymmetricOrdering::Custom(PermRef::new_checked(&forward, &inverse, n)),
        params,
    )
    .map_err(|_| FactorizationError::TooLarge)?;
    let mut values_of_l = vec![0.0; symbolic.len_val()];
    let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
    symbolic
        .factorize_numeric_llt::<f64>(
            &mut values_of_l,
            SparseColMatRef::new(symbol, &values),
            Side::Lower,
            LltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
            Spec::default(),
        )
        .map_err(|LltError::NonPositivePivot { index }| {
            // faer counts pivots in the permuted order.
            FactorizationError::NonPositivePivot { row: forward[index.min(n - 1)] }
        })?;
    Ok(SparseCholesky { symbolic, values: values_of_l, order: forward })
}

/// A nested-dissection order of the vertices (new → old), checked to be a permutation.
fn nested_dissection(pattern: &Pattern) -> Result<Vec<usize>, FactorizationError> {
    let failed = |what: &str| FactorizationError::Ordering(what.into());
    let n = pattern.n();
    if i32::try_from(pattern.n_entries()).is_err() {
        return Err(FactorizationError::TooLarge);
    }
    let mut start = Vec::with_capacity(n + 1);
    start.push(0);
    let mut neighbours = Vec::with_capacity(pattern.n_entries());
    for v in 0..n {
        neighbours.extend(pattern.row(v).iter().filter(|&&w| w as usize != v).map(|&w| w as i32));
        start.push(neighbours.len() as i32);
    }
    let graph = CscPattern::new(n, &start, &neighbours).ok_or_else(|| failed("bad pattern"))?;
    let order =
        feral_scotch::scotch_order(&graph).map_err(|error| failed(&format!("{error:?}")))?;
    let mut seen = vec![false; n];
    for &v in &order {
        match usize::try_from(v).ok().filter(|&v| v < n) {
            Some(v) if !seen[v] => seen[v] = true,
            _ => return Err(failed("not a permutation")),
        }
    }
    if order.len() != n {
        return Err(failed("not a permutation"));
    }
    Ok(order.into_iter().map(|v| v as usize).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
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

    #[test]
    fn solves_to_rounding_with_few_and_many_right_hand_sides() {
        let a = chain(60, 9.0);
        let factor = SparseCholesky::of_blocks(&a).unwrap();
        for k in [1, 3, 40] {
            let b = Mat::from_fn(a.n(), k, |i, j| ((i + 7 * j) as f64).cos());
            let mut x = b.clone();
            factor.solve_in_place(x.as_mut());
            assert!((a.multiply(x.as_ref()) - &b).norm_max() < 1e-13, "{k}");
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let error = SparseCholesky::of_blocks(&chain(60, 0.1)).unwrap_err();
        assert!(matches!(error, FactorizationError::NonPositivePivot { row } if row < 180));
    }
}
