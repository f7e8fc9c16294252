//! Tall blocks of eight vectors, held by rows.
//!
//! A *lane* is a vector: eight of them at one row are a cache line and a register of AVX-512. What a solve, a
//! product with a sparse matrix and an inner product read is then contiguous, which columns are not. faer's products
//! of 105 264 × 184 by 8 numbers, which copy what they read, took 1.7 times as long.

#![expect(clippy::needless_range_loop, reason = "see the note on loops in `kernels`")]

pub(crate) mod kernels;

use crate::pool::Pooled;
use faer::{ColRef, Mat, MatMut, MatRef};
use kernels::{Real, dispatch};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;

/// Vectors in a block.
pub const LANES: usize = 8;

/// The numbers of a block at one row.
pub type Lanes = [f64; LANES];

/// Rows that go through all blocks at a time, three degrees of freedom a vertex: those of one block and of the
/// next stay in the first-level cache.
const CHUNK: usize = 192;

/// Chunks of one task.
const CHUNKS_PER_TASK: usize = 16;

/// Eight vectors (n × 8).
#[derive(Clone, Debug)]
pub struct LaneBlock {
    rows: Vec<Lanes>,
}

impl LaneBlock {
    /// Zero vectors of length `n`.
    pub fn zeros(n: usize) -> LaneBlock {
        LaneBlock { rows: vec![[0.0; LANES]; n] }
    }

    /// The columns of `x` (n×k, k ≤ 8), and zero vectors after them.
    pub fn of_columns(x: MatRef<'_, f64>) -> LaneBlock {
        assert!(x.ncols() <= LANES);
        let mut block = LaneBlock::zeros(x.nrows());
        pack(x, &mut block.rows);
        block
    }

    /// As many blocks as the columns of `x` (n×k) fill; the last may end with zero vectors.
    pub fn split(x: MatRef<'_, f64>) -> Vec<LaneBlock> {
        let some = |first: usize| x.subcols(first, LANES.min(x.ncols() - first));
        (0..x.ncols()).step_by(LANES).map(|first| LaneBlock::of_columns(some(first))).collect()
    }

    /// Writes the first vectors to the columns of `x` (n×k, k ≤ 8).
    pub fn copy_to(&self, x: MatMut<'_, f64>) {
        assert!(x.nrows() == self.n() && x.ncols() <= LANES);
        x.par_row_chunks_mut(CHUNK).zip(self.rows.par_chunks(CHUNK)).for_each(|(mut x, rows)| {
            for (lane, column) in x.as_mut().col_iter_mut().enumerate() {
                column.iter_mut().zip(rows).for_each(|(x, row)| *x = row[lane]);
            }
        });
    }

    /// The three rows of vertex `of(i)` in place of those of vertex `i`.
    pub fn by_vertices(&self, of: impl Fn(usize) -> usize + Sync) -> LaneBlock {
        let mut permuted = LaneBlock::zeros(self.n());
        let (from, to) = (self.rows.as_chunks::<3>().0, permuted.rows.as_chunks_mut::<3>().0);
        to.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, to)| {
            for (i, to) in to.iter_mut().enumerate() {
                *to = from[of(chunk * CHUNK + i)];
            }
        });
        permuted
    }

    /// Length of the vectors.
    pub fn n(&self) -> usize {
        self.rows.len()
    }
    /// Of these rows.
    pub(crate) fn of_rows(rows: Vec<Lanes>) -> LaneBlock {
        LaneBlock { rows }
    }
    /// Its rows; none are left.
    pub(crate) fn take_rows(&mut self) -> Vec<Lanes> {
        std::mem::take(&mut self.rows)
    }
    /// The rows.
    pub fn rows(&self) -> &[Lanes] {
        &self.rows
    }
    /// The rows, to be changed.
    pub fn rows_mut(&mut self) -> &mut [Lanes] {
        &mut self.rows
    }
}

/// `XᵀDY` (8·blocks × 8), D being diagonal with `weight(i)` in row i.
pub fn weighted_gram(
    x: &[LaneBlock],
    weight: impl Fn(usize) -> f64 + Sync,
    y: &LaneBlock,
) -> Mat<f64> {
    assert!(x.iter().all(|x| x.n() == y.n()));
    let tasks = y.rows.par_chunks(CHUNK * CHUNKS_PER_TASK).enumerate();
    let parts: Vec<Vec<Lanes>> = tasks
        .map(|(task, y)| {
            let mut sums = vec![[0.0; LANES]; LANES * x.len()];
            let mut weighted = [[0.0; LANES]; CHUNK];
            for (chunk, y) in y.chunks(CHUNK).enumerate() {
                let begin = (task * CHUNKS_PER_TASK + chunk) * CHUNK;
                for (i, (weighted, y)) in weighted.iter_mut().zip(y).enumerate() {
                    let weight = weight(begin + i);
                    *weighted = y.map(|y| weight * y);
                }
                let rows = |block: usize| &x[block].rows[begin..begin + y.len()];
                for (block, sums) in sums.as_chunks_mut().0.iter_mut().enumerate() {
                    let next = rows(if block + 1 < x.len() { block + 1 } else { block });
                    dispatch(AddGram { x: rows(block), next, y: &weighted[..y.len()], sums });
                }
            }
            sums
        })
        .collect();
    let sums = sum_of(parts, LANES * x.len());
    Mat::from_fn(LANES * x.len(), LANES, |i, j| sums[i][j])
}

/// `XᵀDX` of the columns of tall matrices side by side (n×k → k×k), D being diagonal with `weight(i)` in row i. Columns
/// are put abreast a chunk of rows at a time; only blocks of the lower triangle are multiplied out. Of 230 columns of
/// 105 264 rows this takes 0.07 s; products of the same blocks by faer took 0.12 to 0.17.
pub fn weighted_square(x: &[MatRef<'_, f64>], weight: impl Fn(usize) -> f64 + Sync) -> Mat<f64> {
    let n = x.first().map_or(0, |x| x.nrows());
    let k = x.iter().map(|x| x.ncols()).sum();
    let tasks = (0..n.div_ceil(TASK_ROWS)).into_par_iter();
    let parts = tasks.map(|task| {
        let rows = task * TASK_ROWS..n.min((task + 1) * TASK_ROWS);
        let some: Vec<_> = x.iter().map(|x| x.get(rows.clone(), ..)).collect();
        let mut sums = Square::new(k);
        sums.add_rows(&some, |i| weight(rows.start + i));
        sums
    });
    Square::sum_of(parts.collect(), k)
}

/// Makes X (n×k) by `make(first row, rows)`, and XᵀDX of its rows while they are in the cache. Returns what `make`
/// does.
pub fn weighted_square_of_made<T: Send>(
    x: MatMut<'_, f64>,
    make: impl Fn(usize, MatMut<'_, f64>) -> T + Sync,
    weight: impl Fn(usize) -> f64 + Sync,
) -> (Vec<T>, Mat<f64>) {
    let k = x.ncols();
    let tasks = x.par_row_chunks_mut(TASK_ROWS).enumerate();
    let parts = tasks.map(|(task, mut x)| {
        let made = make(task * TASK_ROWS, x.as_mut());
        let mut sums = Square::new(k);
        sums.add_rows(&[x.as_ref()], |i| weight(task * TASK_ROWS + i));
        (made, sums)
    });
    let (made, parts): (Vec<T>, Vec<Square>) = parts.unzip();
    (made, Square::sum_of(parts, k))
}

/// XᵀY of X (n×k) and Y = AX for a symmetric A, of which `times(rows, x, y)` makes rows that begin and end with vertices
/// of three rows each. A is then read once for 32 columns, and Y never written.
pub fn square_by(
    x: MatRef<'_, f64>,
    times: impl Fn(Range<usize>, &[Lanes], &mut [Lanes]) + Sync,
) -> Mat<f64> {
    let (n, k) = (x.nrows(), x.ncols());
    let n_blocks = k.div_ceil(LANES);
    let columns = |block: usize| x.subcols(LANES * block, LANES.min(k - LANES * block));
    let mut parts = Vec::new();
    parts.resize_with(n.div_ceil(TASK_ROWS), || Square::new(k));
    let mut pooled = Pooled::take(n * LANES * n_blocks.min(MOST_PACKED));
    let memory: &mut [Lanes] = pooled.numbers().as_chunks_mut().0;
    for first in (0..n_blocks).step_by(MOST_PACKED) {
        let end = n_blocks.min(first + MOST_PACKED);
        for (block, packed) in (first..end).zip(memory.chunks_mut(n.max(1))) {
            pack(columns(block), packed);
        }
        let packed: Vec<&[Lanes]> = memory.chunks(n.max(1)).take(end - first).collect();
        let others = x.get(.., (LANES * end).min(k)..);
        parts.par_iter_mut().enumerate().for_each(|(task, sums)| {
            let mut after = vec![[[0.0; LANES]; CHUNK]; n_blocks - end];
            for begin in (task * TASK_ROWS..n.min((task + 1) * TASK_ROWS)).step_by(CHUNK) {
                let rows = begin..n.min(begin + CHUNK);
                put_abreast(&mut after, others.get(rows.clone(), ..).col_iter());
                let own = packed.iter().map(|block| &block[rows.clone()]);
                let some: Vec<&[Lanes]> =
                    own.chain(after.iter().map(|block| &block[..rows.len()])).collect();
                sums.add(first..end, &some, |block, y| times(rows.clone(), packed[block], y));
            }
        });
    }
    Square::sum_of(parts, k)
}

/// Blocks that [`square_by`] has packed at a time, for the sake of memory: an even number.
const MOST_PACKED: usize = 4;

/// Rows of one task.
const TASK_ROWS: usize = CHUNK * CHUNKS_PER_TASK;

/// Sums of XᵀY over rows, of blocks of eight columns each: those of the lower triangle, by columns.
struct Square(Vec<Lanes>);

impl Square {
    /// Of k columns.
    fn new(k: usize) -> Square {
        let n_blocks = k.div_ceil(LANES);
        Square(vec![[0.0; LANES]; LANES * n_blocks * (n_blocks + 1) / 2])
    }

    /// Pairs of the blocks before `right`, which is one of `n_blocks`: n_blocks + (n_blocks − 1) + …
    fn start(n_blocks: usize, right: usize) -> usize {
        right * n_blocks - right * right.saturating_sub(1) / 2
    }

    /// Adds the sums over some rows (at most [`CHUNK`]) for the blocks `rights` of Y, an even number of them or up to the last;
    /// `x` are the blocks of X from the first of them on, and `make` makes the rows of a block of Y, counted likewise.
    fn add(&mut self, rights: Range<usize>, x: &[&[Lanes]], make: impl Fn(usize, &mut [Lanes])) {
        let rows = x.first().map_or(0, |x| x.len());
        let mut y = [[[0.0; LANES]; CHUNK]; 2];
        let [y, other] = y.each_mut().map(|y| &mut y[..rows]);
        let start = Square::start(rights.start + x.len(), rights.start);
        let mut rest = &mut self.0.as_chunks_mut().0[start..];
        for right in (0..rights.len()).step_by(2) {
            make(right, y);
            let (of_y, after) = rest.split_at_mut(x.len() - right);
            let Some((own, of_y)) = of_y.split_first_mut() else { return };
            dispatch(AddGram { x: x[right], next: x[right], y, sums: own });
            if right + 1 == x.len() {
                return;
            }
            make(right + 1, other);
            let (of_other, after) = after.split_at_mut(x.len() - right - 1);
            rest = after;
            for ((x, of_y), of_other) in x[right + 1..].iter().zip(of_y).zip(of_other) {
                dispatch(AddGrams { x, y: [y, other], sums: [of_y, of_other] });
            }
        }
    }

    /// Adds XᵀDX of some rows, of columns side by side.
    fn add_rows(&mut self, x: &[MatRef<'_, f64>], weight: impl Fn(usize) -> f64) {
        let n = x.first().map_or(0, |x| x.nrows());
        let k: usize = x.iter().map(|x| x.ncols()).sum();
        let mut blocks = vec![[[0.0; LANES]; CHUNK]; k.div_ceil(LANES)];
        for begin in (0..n).step_by(CHUNK) {
            let rows = begin..n.min(begin + CHUNK);
            put_abreast(&mut blocks, x.iter().flat_map(|x| x.get(rows.clone(), ..).col_iter()));
            let some: Vec<&[Lanes]> = blocks.iter().map(|block| &block[..rows.len()]).collect();
            self.add(0..some.len(), &some, |right, y| {
                for (i, (y, x)) in y.iter_mut().zip(some[right]).enumerate() {
                    let weight = weight(begin + i);
                    *y = x.map(|x| weight * x);
                }
            });
        }
    }

    /// The sum of all parts, in their order, as a matrix (k×k).
    fn sum_of(parts: Vec<Square>, k: usize) -> Mat<f64> {
        let n_blocks = k.div_ceil(LANES);
        let length = Square::new(k).0.len();
        let sums = self::sum_of(parts.into_iter().map(|part| part.0).collect(), length);
        let pair = |left: usize, right: usize| Square::start(n_blocks, right) + left - right;
        Mat::from_fn(k, k, |i, j| {
            let (i, j) = (i.max(j), i.min(j));
            // Of two columns of one block both products are there; they differ in rounding.
            sums[LANES * pair(i / LANES, j / LANES) + i % LANES][j % LANES]
        })
    }
}

/// Puts columns of at most [`CHUNK`] rows side by side, eight to a block.
fn put_abreast<'c>(blocks: &mut [[Lanes; CHUNK]], columns: impl Iterator<Item = ColRef<'c, f64>>) {
    for (j, column) in columns.enumerate() {
        let block = blocks[j / LANES].iter_mut();
        block.zip(column.iter()).for_each(|(row, x)| row[j % LANES] = *x);
    }
}

/// The columns of `x` (n×k, k ≤ 8) side by side.
pub(crate) fn pack(x: MatRef<'_, f64>, packed: &mut [Lanes]) {
    packed.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, packed)| {
        let x = x.subrows(chunk * CHUNK, packed.len());
        for (lane, column) in x.col_iter().enumerate() {
            packed.iter_mut().zip(column.iter()).for_each(|(row, x)| row[lane] = *x);
        }
    });
}

/// The sum, in their order, of parts of this length.
fn sum_of(parts: Vec<Vec<Lanes>>, length: usize) -> Vec<Lanes> {
    let mut sums = vec![[0.0; LANES]; length];
    for part in parts {
        for (sum, part) in sums.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
            *sum += part;
        }
    }
    sums
}

/// `Y ← Y − XC` with C (k×l; k ≤ 8·blocks of X, l ≤ 8·blocks of Y) small, continued with zeros.
pub fn subtract_product(y: &mut [LaneBlock], x: &[LaneBlock], c: MatRef<'_, f64>) {
    let n = y.first().map_or(0, LaneBlock::n);
    assert!(x.iter().chain(&*y).all(|block| block.n() == n));
    assert!(c.nrows() <= LANES * x.len() && c.ncols() <= LANES * y.len());
    let n_used = c.nrows().div_ceil(LANES);
    let mut coefficients = vec![[[0.0; LANES]; LANES]; n_used * y.len()];
    for j in 0..c.ncols() {
        for i in 0..c.nrows() {
            coefficients[j / LANES * n_used + i / LANES][i % LANES][j % LANES] = c[(i, j)];
        }
    }
    let x = &x[..n_used];
    // A chunk of X is read once for all blocks of Y.
    let mut tasks: Vec<Vec<&mut [Lanes]>> = Vec::new();
    tasks.resize_with(n.div_ceil(CHUNK * CHUNKS_PER_TASK), Vec::new);
    for block in y {
        let parts = block.rows.chunks_mut(CHUNK * CHUNKS_PER_TASK);
        tasks.iter_mut().zip(parts).for_each(|(task, part)| task.push(part));
    }
    tasks.into_par_iter().enumerate().for_each(|(task, mut y)| {
        let n_rows = y.first().map_or(0, |y| y.len());
        for first in (0..n_rows).step_by(CHUNK) {
            let end = n_rows.min(first + CHUNK);
            let begin = task * CHUNK * CHUNKS_PER_TASK;
            let rows = |block: usize| &x[block].rows[begin + first..begin + end];
            for (y, coefficients) in y.iter_mut().zip(coefficients.chunks(n_used.max(1))) {
                for (block, c) in coefficients.iter().enumerate() {
                    let next = rows(if block + 1 < x.len() { block + 1 } else { block });
                    let (x, y) = (rows(block), &mut y[first..end]);
                    dispatch(SubtractProduct { x, next, c, y });
                }
            }
        }
    });
}

/// Sums ← Sums + XᵀY over some rows.
struct AddGram<'a> {
    x: &'a [Lanes],
    /// What is read next.
    next: &'a [Lanes],
    y: &'a [Lanes],
    sums: &'a mut [Lanes; LANES],
}

impl WithSimd for AddGram<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let AddGram { x, next, y, sums } = self;
        let n_parts = LANES / S::F64_LANES;
        let zero = simd.splat_f64s(0.0);
        let mut acc = [[zero; LANES]; LANES];
        let y = &y[..x.len()];
        for i in 0..x.len() {
            prefetch_index::prefetch_index(next, i);
            for part in 0..n_parts {
                let y = f64::load::<S>(&y[i], part);
                for c in 0..LANES {
                    acc[c][part] = simd.mul_add_f64s(simd.splat_f64s(x[i][c]), y, acc[c][part]);
                }
            }
        }
        for c in 0..LANES {
            for part in 0..n_parts {
                let sum = simd.add_f64s(f64::load::<S>(&sums[c], part), acc[c][part]);
                f64::store::<S>(&mut sums[c], part, sum);
            }
        }
    }
}

/// The same of two blocks of Y: a number of X is fetched once for both. Squares of 60 columns of 105 264 rows take 5.9 to
/// 6.3 ms instead of 6.4 to 8.2.
struct AddGrams<'a> {
    x: &'a [Lanes],
    y: [&'a [Lanes]; 2],
    sums: [&'a mut [Lanes; LANES]; 2],
}

impl WithSimd for AddGrams<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let AddGrams { x, y, sums } = self;
        let n_parts = LANES / S::F64_LANES;
        let zero = simd.splat_f64s(0.0);
        let mut acc = [[[zero; LANES]; LANES]; 2];
        let y = y.map(|y| &y[..x.len()]);
        for i in 0..x.len() {
            for part in 0..n_parts {
                let first = f64::load::<S>(&y[0][i], part);
                let second = f64::load::<S>(&y[1][i], part);
                for c in 0..LANES {
                    let factor = simd.splat_f64s(x[i][c]);
                    acc[0][c][part] = simd.mul_add_f64s(factor, first, acc[0][c][part]);
                    acc[1][c][part] = simd.mul_add_f64s(factor, second, acc[1][c][part]);
                }
            }
        }
        for (sums, acc) in sums.into_iter().zip(acc) {
            for c in 0..LANES {
                for part in 0..n_parts {
                    let sum = simd.add_f64s(f64::load::<S>(&sums[c], part), acc[c][part]);
                    f64::store::<S>(&mut sums[c], part, sum);
                }
            }
        }
    }
}

/// Y ← Y − XC over some rows.
struct SubtractProduct<'a> {
    x: &'a [Lanes],
    /// What is read next.
    next: &'a [Lanes],
    c: &'a [Lanes; LANES],
    y: &'a mut [Lanes],
}

impl WithSimd for SubtractProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let SubtractProduct { x, next, c, y } = self;
        let n_parts = LANES / S::F64_LANES;
        let zero = simd.splat_f64s(0.0);
        let mut minus = [[zero; LANES]; LANES];
        for k in 0..LANES {
            for part in 0..n_parts {
                minus[k][part] = simd.sub_f64s(zero, f64::load::<S>(&c[k], part));
            }
        }
        let y = &mut y[..x.len()];
        for i in 0..x.len() {
            prefetch_index::prefetch_index(next, i);
            for part in 0..n_parts {
                let mut sum = f64::load::<S>(&y[i], part);
                for k in 0..LANES {
                    sum = simd.mul_add_f64s(simd.splat_f64s(x[i][k]), minus[k][part], sum);
                }
                f64::store::<S>(&mut y[i], part, sum);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::slice;

    #[test]
    fn products_are_those_of_columns() {
        // One row, a chunk and a bit, more than a task.
        for n in [1, CHUNK + 3, CHUNK * CHUNKS_PER_TASK + 5 * CHUNK + 7] {
            let columns = |k: usize, phase: f64| {
                Mat::from_fn(n, k, |i, j| ((3 * i + 7 * j) as f64 + phase).sin())
            };
            let (x, y) = (columns(19, 0.0), columns(5, 1.0));
            let blocks = LaneBlock::split(x.as_ref());
            let lanes = LaneBlock::of_columns(y.as_ref());
            assert_eq!(blocks.len(), 3);
            let weight = |i: usize| 1.0 + (i % 5) as f64;
            let gram = weighted_gram(&blocks, weight, &lanes);
            let exact = Mat::from_fn(19, 5, |a, b| {
                (0..n).map(|i| x[(i, a)] * weight(i) * y[(i, b)]).sum::<f64>()
            });
            assert!((gram.get(..19, ..5) - exact).norm_max() < 1e-12 * n as f64);
            assert!(gram.get(19.., ..).norm_max() == 0.0 && gram.get(.., 5..).norm_max() == 0.0);

            let parts = [x.as_ref().subcols(0, 9), x.as_ref().subcols(9, 10)];
            let square = weighted_square(&parts, weight);
            let exact = Mat::from_fn(19, 19, |a, b| {
                (0..n).map(|i| x[(i, a)] * weight(i) * x[(i, b)]).sum::<f64>()
            });
            assert!((square - exact).norm_max() < 1e-12 * n as f64);

            let c = Mat::from_fn(19, 5, |i, j| ((i + 2 * j) as f64).cos());
            let mut rest = lanes.clone();
            subtract_product(slice::from_mut(&mut rest), &blocks, c.as_ref());
            let mut found = Mat::from_fn(n, 5, |_, _| f64::NAN);
            rest.copy_to(found.as_mut());
            assert!((found - (&y - &x * &c)).norm_max() < 1e-13);

            // More than one block.
            let c = Mat::from_fn(19, 11, |i, j| ((i + 2 * j) as f64).cos());
            let mut product = vec![LaneBlock::zeros(n), LaneBlock::zeros(n)];
            subtract_product(&mut product, &blocks, c.as_ref());
            for (first, block) in [(0, &product[0]), (8, &product[1])] {
                let mut found = Mat::zeros(n, LANES.min(11 - first));
                block.copy_to(found.as_mut());
                let exact = &x * c.subcols(first, found.ncols());
                assert!((found + exact).norm_max() < 1e-13);
            }
        }
    }
}
