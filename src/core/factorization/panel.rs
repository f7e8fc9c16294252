//! Triangular solves with the panel of one supernode for a row of right-hand sides.
//!
//! A lane is a right-hand side: entries of the factor are read once, in the order in which they lie,
//! and spread over the lanes. Up to 16 of them the memory is the bound, which general
//! matrix products (made for wide right-hand sides, they copy the factor first) do not reach: 16 and
//! 32 columns took them 45 and 76 ms where this takes 36 and 64, on 31 million values and two cores.

#![expect(clippy::needless_range_loop, reason = "see the note on loops below")]

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Values of `N` right-hand sides at one row; `N` is 8, 16 or 32.
pub(super) type Row<const N: usize> = [f64; N];

/// Columns of the factor that one pass over the right-hand sides uses.
const COLUMNS: usize = 8;

/// Columns solved before the rows below them are brought up to date, by all threads.
const BLOCK: usize = 128;

/// Rows or columns of one chunk of work.
const CHUNK: usize = 256;

/// Whether the chunks of a panel are shared between threads.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Threads {
    /// This one; others are busy with subtrees of their own.
    One,
    /// All.
    All,
}

/// Part of a factor's panel: column j begins at `values[j * stride]`.
#[derive(Clone, Copy)]
pub(super) struct Panel<'a> {
    values: &'a [f64],
    stride: usize,
    n_columns: usize,
}

impl<'a> Panel<'a> {
    /// A whole panel, `height` × `width` by columns.
    pub(super) fn new(values: &'a [f64], height: usize, width: usize) -> Panel<'a> {
        assert_eq!(values.len(), height * width);
        Panel { values, stride: height, n_columns: width }
    }

    /// Rows from `row` and `n_columns` columns from `column` on.
    fn part(self, row: usize, column: usize, n_columns: usize) -> Panel<'a> {
        let start = (column * self.stride + row).min(self.values.len());
        Panel { values: &self.values[start..], stride: self.stride, n_columns }
    }

    /// The first `count` entries of a column.
    #[inline(always)]
    fn column(&self, column: usize, count: usize) -> &'a [f64] {
        &self.values[column * self.stride..][..count]
    }
}

/// X ← L₁⁻¹X and B ← −L₂X for a panel [L₁; L₂] with as many columns as X has rows.
pub(super) fn solve_forward<const N: usize>(
    panel: Panel<'_>,
    x: &mut [Row<N>],
    below: &mut [Row<N>],
    threads: Threads,
) {
    let width = x.len();
    below.fill([0.0; N]);
    for first in (0..width).step_by(BLOCK) {
        let size = BLOCK.min(width - first);
        let (solved, rest) = x[first..].split_at_mut(size);
        dispatch(SolveTriangle { l: panel.part(first, first, size), x: solved });
        let solved = &*solved;
        subtract(panel.part(first + size, first, size), solved, rest, threads);
        subtract(panel.part(width, first, size), solved, below, threads);
    }
}

/// X ← L₁⁻ᵀ(X − L₂ᵀB) for a panel [L₁; L₂].
pub(super) fn solve_backward<const N: usize>(
    panel: Panel<'_>,
    x: &mut [Row<N>],
    below: &[Row<N>],
    threads: Threads,
) {
    let width = x.len();
    subtract_transposed(panel.part(width, 0, width), below, x, threads);
    for first in (0..width).step_by(BLOCK).rev() {
        let size = BLOCK.min(width - first);
        let (current, solved) = x[first..].split_at_mut(size);
        subtract_transposed(panel.part(first + size, first, size), solved, current, threads);
        dispatch(SolveTransposedTriangle { l: panel.part(first, first, size), x: current });
    }
}

/// Y ← Y − LX, rows shared between threads.
fn subtract<const N: usize>(l: Panel<'_>, x: &[Row<N>], y: &mut [Row<N>], threads: Threads) {
    match threads {
        Threads::One => dispatch(Subtract { l, x, y }),
        Threads::All => y.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, y)| {
            dispatch(Subtract { l: l.part(chunk * CHUNK, 0, l.n_columns), x, y });
        }),
    }
}

/// X ← X − LᵀY, columns shared between threads.
fn subtract_transposed<const N: usize>(
    l: Panel<'_>,
    y: &[Row<N>],
    x: &mut [Row<N>],
    threads: Threads,
) {
    match threads {
        Threads::One => dispatch(SubtractTransposed { l, y, x }),
        Threads::All => {
            x.par_chunks_mut(CHUNK / 8).enumerate().for_each(|(chunk, x)| {
                let l = l.part(0, chunk * (CHUNK / 8), x.len());
                dispatch(SubtractTransposed { l, y, x });
            });
        }
    }
}

fn dispatch(operation: impl WithSimd<Output = ()>) {
    Arch::new().dispatch(operation);
}

// Loops, not iterator or array methods: those are not sure to be inlined into code compiled for the
// processor at hand, and cost tenfold when they are not.

#[inline(always)]
fn load<S: Simd, const N: usize>(row: &Row<N>, part: usize) -> S::f64s {
    S::as_simd_f64s(row).0[part]
}

#[inline(always)]
fn store<S: Simd, const N: usize>(row: &mut Row<N>, part: usize, x: S::f64s) {
    S::as_mut_simd_f64s(row).0[part] = x;
}

/// Y ← Y − LX.
struct Subtract<'a, const N: usize> {
    l: Panel<'a>,
    x: &'a [Row<N>],
    y: &'a mut [Row<N>],
}

impl<const N: usize> WithSimd for Subtract<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Subtract { l, x, y } = self;
        let mut first = 0;
        while first + COLUMNS <= x.len() {
            subtract_block::<S, N>(simd, l, x, y, first);
            first += COLUMNS;
        }
        while first < x.len() {
            subtract_columns::<S, N, 1>(simd, l, x, y, first);
            first += 1;
        }
    }
}

/// Y ← Y − LX for [`COLUMNS`] columns of L from `first` on, as many at a time as registers hold.
#[inline(always)]
fn subtract_block<S: Simd, const N: usize>(
    simd: S,
    l: Panel<'_>,
    x: &[Row<N>],
    y: &mut [Row<N>],
    first: usize,
) {
    if N <= 16 {
        subtract_columns::<S, N, COLUMNS>(simd, l, x, y, first);
    } else {
        subtract_columns::<S, N, { COLUMNS / 2 }>(simd, l, x, y, first);
        subtract_columns::<S, N, { COLUMNS / 2 }>(simd, l, x, y, first + COLUMNS / 2);
    }
}

/// Y ← Y − LX for `C` columns of L from `first` on.
#[inline(always)]
fn subtract_columns<S: Simd, const N: usize, const C: usize>(
    simd: S,
    l: Panel<'_>,
    x: &[Row<N>],
    y: &mut [Row<N>],
    first: usize,
) {
    let zero = simd.splat_f64s(0.0);
    let mut minus = [[zero; N]; C];
    let mut columns: [&[f64]; C] = [&[]; C];
    for c in 0..C {
        columns[c] = l.column(first + c, y.len());
        for part in 0..N / S::F64_LANES {
            minus[c][part] = simd.sub_f64s(zero, load::<S, N>(&x[first + c], part));
        }
    }
    for i in 0..y.len() {
        let mut factor = [zero; C];
        for c in 0..C {
            factor[c] = simd.splat_f64s(columns[c][i]);
        }
        for part in 0..N / S::F64_LANES {
            let mut sum = load::<S, N>(&y[i], part);
            for c in 0..C {
                sum = simd.mul_add_f64s(factor[c], minus[c][part], sum);
            }
            store::<S, N>(&mut y[i], part, sum);
        }
    }
}

/// X ← X − LᵀY.
struct SubtractTransposed<'a, const N: usize> {
    l: Panel<'a>,
    y: &'a [Row<N>],
    x: &'a mut [Row<N>],
}

impl<const N: usize> WithSimd for SubtractTransposed<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let SubtractTransposed { l, y, x } = self;
        let mut first = 0;
        while first + COLUMNS <= x.len() {
            subtract_transposed_block::<S, N>(simd, l, y, x, first);
            first += COLUMNS;
        }
        while first < x.len() {
            subtract_transposed_columns::<S, N, 1>(simd, l, y, x, first);
            first += 1;
        }
    }
}

/// X ← X − LᵀY for [`COLUMNS`] columns of L from `first` on, as many at a time as registers hold.
#[inline(always)]
fn subtract_transposed_block<S: Simd, const N: usize>(
    simd: S,
    l: Panel<'_>,
    y: &[Row<N>],
    x: &mut [Row<N>],
    first: usize,
) {
    if N <= 16 {
        subtract_transposed_columns::<S, N, COLUMNS>(simd, l, y, x, first);
    } else {
        subtract_transposed_columns::<S, N, { COLUMNS / 2 }>(simd, l, y, x, first);
        subtract_transposed_columns::<S, N, { COLUMNS / 2 }>(simd, l, y, x, first + COLUMNS / 2);
    }
}

/// X ← X − LᵀY for `C` columns of L from `first` on.
#[inline(always)]
fn subtract_transposed_columns<S: Simd, const N: usize, const C: usize>(
    simd: S,
    l: Panel<'_>,
    y: &[Row<N>],
    x: &mut [Row<N>],
    first: usize,
) {
    let zero = simd.splat_f64s(0.0);
    let mut sums = [[zero; N]; C];
    let mut columns: [&[f64]; C] = [&[]; C];
    for c in 0..C {
        columns[c] = l.column(first + c, y.len());
    }
    for i in 0..y.len() {
        let mut row = [zero; N];
        for part in 0..N / S::F64_LANES {
            row[part] = load::<S, N>(&y[i], part);
        }
        for c in 0..C {
            let factor = simd.splat_f64s(columns[c][i]);
            for part in 0..N / S::F64_LANES {
                sums[c][part] = simd.mul_add_f64s(factor, row[part], sums[c][part]);
            }
        }
    }
    for c in 0..C {
        for part in 0..N / S::F64_LANES {
            let difference = simd.sub_f64s(load::<S, N>(&x[first + c], part), sums[c][part]);
            store::<S, N>(&mut x[first + c], part, difference);
        }
    }
}

/// X ← L⁻¹X, L lower triangular.
struct SolveTriangle<'a, const N: usize> {
    l: Panel<'a>,
    x: &'a mut [Row<N>],
}

impl<const N: usize> WithSimd for SolveTriangle<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let SolveTriangle { l, x } = self;
        let n = x.len();
        for first in (0..n).step_by(COLUMNS) {
            let size = COLUMNS.min(n - first);
            let (current, rest) = x[first..].split_at_mut(size);
            for c in 0..size {
                let column = l.part(first, first + c, 1).column(0, size);
                let (done, under) = current.split_at_mut(c + 1);
                scale::<S, N>(simd, &mut done[c], column[c].recip());
                for r in 0..under.len() {
                    subtract_row::<S, N>(simd, column[c + 1 + r], &done[c], &mut under[r]);
                }
            }
            let l = l.part(first + size, first, size);
            if size == COLUMNS {
                subtract_block::<S, N>(simd, l, current, rest, 0);
            }
        }
    }
}

/// X ← L⁻ᵀX, L lower triangular.
struct SolveTransposedTriangle<'a, const N: usize> {
    l: Panel<'a>,
    x: &'a mut [Row<N>],
}

impl<const N: usize> WithSimd for SolveTransposedTriangle<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let SolveTransposedTriangle { l, x } = self;
        let n = x.len();
        for first in (0..n).step_by(COLUMNS).rev() {
            let size = COLUMNS.min(n - first);
            let (current, solved) = x[first..].split_at_mut(size);
            if size == COLUMNS {
                let l = l.part(first + size, first, size);
                subtract_transposed_block::<S, N>(simd, l, solved, current, 0);
            }
            for c in (0..size).rev() {
                let column = l.part(first, first + c, 1).column(0, size);
                let (done, under) = current.split_at_mut(c + 1);
                for r in 0..under.len() {
                    subtract_row::<S, N>(simd, column[c + 1 + r], &under[r], &mut done[c]);
                }
                scale::<S, N>(simd, &mut done[c], column[c].recip());
            }
        }
    }
}

/// `y -= factor·x`.
#[inline(always)]
fn subtract_row<S: Simd, const N: usize>(simd: S, factor: f64, x: &Row<N>, y: &mut Row<N>) {
    let minus = simd.splat_f64s(-factor);
    for part in 0..N / S::F64_LANES {
        let sum = simd.mul_add_f64s(minus, load::<S, N>(x, part), load::<S, N>(y, part));
        store::<S, N>(y, part, sum);
    }
}

#[inline(always)]
fn scale<S: Simd, const N: usize>(simd: S, x: &mut Row<N>, factor: f64) {
    let factor = simd.splat_f64s(factor);
    for part in 0..N / S::F64_LANES {
        let scaled = simd.mul_f64s(load::<S, N>(x, part), factor);
        store::<S, N>(x, part, scaled);
    }
}
