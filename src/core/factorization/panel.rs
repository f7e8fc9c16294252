//! The panel of one supernode as it is kept, and triangular solves with it for a row of right-hand sides.
//!
//! Columns are kept in *groups* of eight (the last ones of a panel in groups of 4, 2 and 1), and each
//! group by rows from its diagonal down, so that a whole row is a cache line and a solve reads the factor
//! from one end to the other. The processor by itself fetches too little of that ahead, a page at a
//! time: a core got 5 to 7 GB/s of panels of a hundred rows, by columns or by groups. [`Fetch`] asks for four
//! pages at a time, and gets 10 to 14.
//!
//! A lane is a right-hand side: entries of the factor are read once and spread over the lanes.

use crate::lanes::kernels::{
    Fetch, GROUP, Real, Row, Rows, dispatch, scale, subtract_row, subtract_rows,
    subtract_transposed_rows,
};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;

/// Columns solved before all threads bring the rows below them up to date.
const BLOCK: usize = 128;

/// Rows of one chunk of work.
const CHUNK: usize = 256;

/// Columns of one chunk of work.
const COLUMN_CHUNK: usize = 32;

/// Whether the chunks of a panel are shared between threads.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Threads {
    /// This one; others are busy with subtrees of their own.
    One,
    /// All.
    All,
}

/// A panel, a lower trapezoid.
#[derive(Clone, Copy)]
pub(super) struct Panel<'a, T> {
    values: &'a [T],
    /// Where it begins among the values of its piece of the factor.
    begin: usize,
    shape: Shape,
}

/// Rows and columns of a panel, and from these where everything lies.
#[derive(Clone, Copy)]
struct Shape {
    height: usize,
    width: usize,
}

/// Numbers kept of a panel of `height` × `width`: at most as many as it has.
pub(super) fn n_packed(height: usize, width: usize) -> usize {
    Shape { height, width }.start(width)
}

impl Shape {
    /// Where the group that begins with column `first` begins.
    fn start(self, first: usize) -> usize {
        let (in_last, height) = (first % GROUP, self.height);
        let mut column = first - in_last;
        let mut start = column * height - column * column.saturating_sub(GROUP) / 2;
        for width in [4, 2, 1] {
            if in_last & width != 0 {
                start += width * (height - column);
                column += width;
            }
        }
        start
    }

    /// Columns of the group that begins with column `first`.
    fn group_from(self, first: usize) -> usize {
        let rest = self.width - first;
        if rest >= GROUP { GROUP } else { 1 << rest.ilog2() }
    }

    /// Columns of the group that ends before column `end`.
    fn group_before(self, end: usize) -> usize {
        if end.is_multiple_of(GROUP) { GROUP } else { 1 << (end % GROUP).trailing_zeros() }
    }
}

/// Keeps the lower trapezoid of `columns`, `height` × `width` by columns, in `packed`.
pub(super) fn pack(
    columns: &[f64],
    height: usize,
    width: usize,
    packed: &mut [f64],
    threads: Threads,
) {
    assert_eq!(columns.len(), height * width);
    assert_eq!(packed.len(), n_packed(height, width));
    let shape = Shape { height, width };
    let (mut first, mut rest) = (0, packed);
    let mut groups = Vec::with_capacity(width / GROUP + 3);
    while first < width {
        let size = shape.group_from(first);
        let (group, after) = rest.split_at_mut(size * (height - first));
        groups.push((first, size, group));
        rest = after;
        first += size;
    }
    let pack = |(first, size, group): (usize, usize, &mut [f64])| {
        let columns = &columns[first * height..][..size * height];
        for (row, values) in group.chunks_exact_mut(size).enumerate() {
            for (c, value) in values.iter_mut().enumerate() {
                *value = if row < c { 0.0 } else { columns[c * height + first + row] };
            }
        }
    };
    match threads {
        Threads::One => groups.into_iter().for_each(pack),
        Threads::All => groups.into_par_iter().for_each(pack),
    }
}

impl<'a, T> Panel<'a, T> {
    /// What [`pack`] has kept at `place` among the values of a piece of the factor.
    pub(super) fn new(
        values: &'a [T],
        place: Range<usize>,
        height: usize,
        width: usize,
    ) -> Panel<'a, T> {
        assert_eq!(place.len(), n_packed(height, width));
        Panel { begin: place.start, values: &values[place], shape: Shape { height, width } }
    }

    /// Rows of the panel in the group of `C` columns that begins with column `first`.
    #[inline(always)]
    fn rows<const C: usize>(&self, first: usize, rows: Range<usize>) -> Rows<'a, T, C> {
        let start = self.shape.start(first) + (rows.start - first) * C;
        Rows {
            l: self.values[start..][..rows.len() * C].as_chunks().0,
            fetch: Fetch { begin: (self.begin + start) / GROUP, gap: 0 },
        }
    }

    /// The same where what is read next are the same rows of the next group, or of the one before.
    #[inline(always)]
    fn same_rows<const C: usize>(
        &self,
        first: usize,
        rows: Range<usize>,
        of: Next,
    ) -> Rows<'a, T, C> {
        let distance = self.shape.height - first;
        let distance = if of == Next::After { distance.saturating_sub(GROUP) } else { distance };
        let gap = distance.saturating_sub(rows.len());
        Rows { fetch: Fetch { begin: 0, gap }, ..self.rows(first, rows) }
    }
}

/// Which group is read next.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Next {
    After,
    Before,
}

/// X ← L₁⁻¹X and B ← −L₂X for a panel [L₁; L₂] with as many columns as X has rows.
pub(super) fn solve_forward<T: Real, const N: usize>(
    panel: Panel<'_, T>,
    x: &mut [Row<T, N>],
    below: &mut [Row<T, N>],
    threads: Threads,
) {
    let width = x.len();
    below.fill([T::default(); N]);
    if threads == Threads::One {
        return dispatch(Forward { panel, first: 0, x, below });
    }
    for first in (0..width).step_by(BLOCK) {
        let size = BLOCK.min(width - first);
        let (solved, rest) = x[first..].split_at_mut(size);
        dispatch(Forward { panel, first, x: solved, below: &mut [] });
        let solved = &*solved;
        let chunks = |y, begin| {
            let chunks = <[Row<T, N>]>::chunks_mut(y, CHUNK).enumerate();
            chunks.map(move |(chunk, y)| (begin + chunk * CHUNK, y))
        };
        // One loop for both, so that threads wait for each other half as often.
        let below = chunks(&mut *below, width);
        let all: Vec<(usize, &mut [Row<T, N>])> = chunks(rest, first + size).chain(below).collect();
        all.into_par_iter().for_each(|(row, y)| {
            dispatch(Subtract { panel, first, row, x: solved, y });
        });
    }
}

/// X ← L₁⁻ᵀ(X − L₂ᵀB) for a panel [L₁; L₂].
pub(super) fn solve_backward<T: Real, const N: usize>(
    panel: Panel<'_, T>,
    x: &mut [Row<T, N>],
    below: &[Row<T, N>],
    threads: Threads,
) {
    let width = x.len();
    if threads == Threads::One {
        return dispatch(Backward { panel, first: 0, x, below });
    }
    let subtract = |first: usize, x: &mut [Row<T, N>], row: usize, y: &[Row<T, N>]| {
        x.par_chunks_mut(COLUMN_CHUNK).enumerate().for_each(|(chunk, x)| {
            dispatch(SubtractTransposed { panel, first: first + chunk * COLUMN_CHUNK, row, x, y });
        });
    };
    subtract(0, x, width, below);
    for first in (0..width).step_by(BLOCK).rev() {
        let size = BLOCK.min(width - first);
        let (current, solved) = x[first..].split_at_mut(size);
        subtract(first, current, first + size, solved);
        dispatch(Backward { panel, first, x: current, below: &[] });
    }
}

/// Calls a function of a group with the number of its columns as a constant.
macro_rules! with_columns {
    ($count:expr, $function:ident::<S, T, N>($($argument:expr),*)) => {
        match $count {
            8 => $function::<S, T, N, 8>($($argument),*),
            4 => $function::<S, T, N, 4>($($argument),*),
            2 => $function::<S, T, N, 2>($($argument),*),
            _ => $function::<S, T, N, 1>($($argument),*),
        }
    };
}

/// X ← L₁⁻¹X for the columns from `first` on, as many as X has rows; B ← B − L₂X for the rows below the
/// panel's triangle, if B has any.
struct Forward<'a, T, const N: usize> {
    panel: Panel<'a, T>,
    first: usize,
    x: &'a mut [Row<T, N>],
    below: &'a mut [Row<T, N>],
}

impl<T: Real, const N: usize> WithSimd for Forward<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Forward { panel, first, x, below } = self;
        let mut at = 0;
        while at < x.len() {
            let size = panel.shape.group_from(first + at);
            let x = &mut x[at..];
            with_columns!(size, forward_group::<S, T, N>(simd, panel, first + at, x, below));
            at += size;
        }
    }
}

#[inline(always)]
fn forward_group<S: Simd, T: Real, const N: usize, const C: usize>(
    simd: S,
    panel: Panel<'_, T>,
    first: usize,
    x: &mut [Row<T, N>],
    below: &mut [Row<T, N>],
) {
    let (current, rest) = x.split_at_mut(C);
    let diagonal = panel.rows::<C>(first, first..first + C).l;
    for c in 0..C {
        let (done, under) = current.split_at_mut(c + 1);
        scale::<S, T, N>(simd, &mut done[c], diagonal[c][c].recip());
        for r in 0..under.len() {
            subtract_row::<S, T, N>(simd, diagonal[c + 1 + r][c], &done[c], &mut under[r]);
        }
    }
    let (begin, width) = (first + C, panel.shape.width);
    subtract_rows::<S, T, N, C>(simd, panel.rows(first, begin..begin + rest.len()), current, rest);
    subtract_rows::<S, T, N, C>(
        simd,
        panel.rows(first, width..width + below.len()),
        current,
        below,
    );
}

/// Y ← Y − LX for the columns from `first` on, as many as X has rows; Y begins at the panel's row `row`.
struct Subtract<'a, T, const N: usize> {
    panel: Panel<'a, T>,
    first: usize,
    row: usize,
    x: &'a [Row<T, N>],
    y: &'a mut [Row<T, N>],
}

impl<T: Real, const N: usize> WithSimd for Subtract<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Subtract { panel, first, row, x, y } = self;
        let mut at = 0;
        while at < x.len() {
            let size = panel.shape.group_from(first + at);
            let x = &x[at..];
            with_columns!(size, subtract_group::<S, T, N>(simd, panel, first + at, row, x, y));
            at += size;
        }
    }
}

#[inline(always)]
fn subtract_group<S: Simd, T: Real, const N: usize, const C: usize>(
    simd: S,
    panel: Panel<'_, T>,
    first: usize,
    row: usize,
    x: &[Row<T, N>],
    y: &mut [Row<T, N>],
) {
    let rows = panel.same_rows::<C>(first, row..row + y.len(), Next::After);
    subtract_rows::<S, T, N, C>(simd, rows, x, y);
}

/// X ← L₁⁻ᵀ(X − L₂ᵀB) for the columns from `first` on, as many as X has rows; L₂ is empty if B is.
struct Backward<'a, T, const N: usize> {
    panel: Panel<'a, T>,
    first: usize,
    x: &'a mut [Row<T, N>],
    below: &'a [Row<T, N>],
}

impl<T: Real, const N: usize> WithSimd for Backward<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Backward { panel, first, x, below } = self;
        let mut end = x.len();
        while end > 0 {
            let size = panel.shape.group_before(first + end);
            end -= size;
            let x = &mut x[end..];
            with_columns!(size, backward_group::<S, T, N>(simd, panel, first + end, x, below));
        }
    }
}

#[inline(always)]
fn backward_group<S: Simd, T: Real, const N: usize, const C: usize>(
    simd: S,
    panel: Panel<'_, T>,
    first: usize,
    x: &mut [Row<T, N>],
    below: &[Row<T, N>],
) {
    let (current, solved) = x.split_at_mut(C);
    let (begin, width) = (first + C, panel.shape.width);
    let rows = panel.rows(first, width..width + below.len());
    subtract_transposed_rows::<S, T, N, C>(simd, rows, current, below);
    let rows = panel.rows(first, begin..begin + solved.len());
    subtract_transposed_rows::<S, T, N, C>(simd, rows, current, solved);
    let diagonal = panel.rows::<C>(first, first..first + C).l;
    for c in 0..C {
        let c = C - 1 - c;
        let (done, under) = current.split_at_mut(c + 1);
        for r in 0..under.len() {
            subtract_row::<S, T, N>(simd, diagonal[c + 1 + r][c], &under[r], &mut done[c]);
        }
        scale::<S, T, N>(simd, &mut done[c], diagonal[c][c].recip());
    }
}

/// X ← X − LᵀY for the columns from `first` on, as many as X has rows; Y begins at the panel's row `row`.
struct SubtractTransposed<'a, T, const N: usize> {
    panel: Panel<'a, T>,
    first: usize,
    row: usize,
    x: &'a mut [Row<T, N>],
    y: &'a [Row<T, N>],
}

impl<T: Real, const N: usize> WithSimd for SubtractTransposed<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let SubtractTransposed { panel, first, row, x, y } = self;
        let mut end = x.len();
        while end > 0 {
            let size = panel.shape.group_before(first + end);
            end -= size;
            let x = &mut x[end..];
            with_columns!(
                size,
                subtract_transposed_group::<S, T, N>(simd, panel, first + end, row, x, y)
            );
        }
    }
}

#[inline(always)]
fn subtract_transposed_group<S: Simd, T: Real, const N: usize, const C: usize>(
    simd: S,
    panel: Panel<'_, T>,
    first: usize,
    row: usize,
    x: &mut [Row<T, N>],
    y: &[Row<T, N>],
) {
    let rows = panel.same_rows::<C>(first, row..row + y.len(), Next::Before);
    subtract_transposed_rows::<S, T, N, C>(simd, rows, x, y);
}

#[cfg(test)]
#[expect(clippy::needless_range_loop, reason = "rows and columns as in the definitions")]
mod tests {
    use super::*;

    /// A lower trapezoid by columns, its triangle well conditioned.
    fn trapezoid(height: usize, width: usize) -> Vec<f64> {
        let entry = |row: usize, column: usize| match row.cmp(&column) {
            std::cmp::Ordering::Less => f64::NAN,
            std::cmp::Ordering::Equal => 2.0 + (row as f64).cos(),
            std::cmp::Ordering::Greater => ((3 * row + 7 * column) as f64).sin() / width as f64,
        };
        (0..width).flat_map(|column| (0..height).map(move |row| entry(row, column))).collect()
    }

    fn rows<T: Real, const N: usize>(count: usize) -> Vec<Row<T, N>> {
        let value = |i: usize, j: usize| T::nearest(((5 * i + 11 * j) as f64).cos());
        (0..count).map(|i| std::array::from_fn(|j| value(i, j))).collect()
    }

    /// Both solves against their definitions, to within some roundings of `unit`.
    fn check<T: Real, const N: usize>(width: usize, depth: usize, threads: Threads, unit: f64) {
        let height = width + depth;
        let columns = trapezoid(height, width);
        // Not at the beginning, and with something behind it.
        let place = 24..24 + n_packed(height, width);
        let mut values = vec![f64::NAN; place.end + 40];
        pack(&columns, height, width, &mut values[place.clone()], threads);
        let values: Vec<T> = values.into_iter().map(T::nearest).collect();
        let panel = Panel::new(&values, place, height, width);
        let l = |row: usize, column: usize| columns[column * height + row];

        let b = rows::<T, N>(width);
        let (mut x, mut below) = (b.clone(), vec![[T::nearest(f64::NAN); N]; depth]);
        solve_forward(panel, &mut x, &mut below, threads);
        for lane in 0..N {
            let product = |row: usize| -> f64 {
                let term = |column: usize| l(row, column) * x[column][lane].double();
                (0..width.min(row + 1)).map(term).sum()
            };
            for row in 0..width {
                let error = product(row) - b[row][lane].double();
                assert!(error.abs() < 500.0 * unit, "{width} {depth} {row}");
            }
            for row in 0..depth {
                let error = product(width + row) + below[row][lane].double();
                assert!(error.abs() < 500.0 * unit, "{width} {depth} {row}");
            }
        }

        let below = rows::<T, N>(depth);
        let mut x = b.clone();
        solve_backward(panel, &mut x, &below, threads);
        for lane in 0..N {
            for column in 0..width {
                let inside: f64 =
                    (column..width).map(|row| l(row, column) * x[row][lane].double()).sum();
                let outside: f64 =
                    (0..depth).map(|row| l(width + row, column) * below[row][lane].double()).sum();
                let error = inside + outside - b[column][lane].double();
                assert!(error.abs() < 5000.0 * unit, "{width} {depth} {column}");
            }
        }
    }

    #[test]
    fn solves_with_panels_of_every_shape() {
        let [double, single] = [f64::EPSILON, f64::from(f32::EPSILON)];
        for width in (1..=20).chain([37, 128, 131, 300]) {
            for depth in [0, 1, 3, 90, 700] {
                for threads in [Threads::One, Threads::All] {
                    check::<f64, 8>(width, depth, threads, double);
                    check::<f64, 16>(width, depth, threads, double);
                    check::<f64, 32>(width, depth, threads, double);
                    check::<f32, 16>(width, depth, threads, single);
                    check::<f32, 32>(width, depth, threads, single);
                    check::<f32, 48>(width, depth, threads, single);
                }
            }
        }
    }
}
