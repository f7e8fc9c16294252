//! Kernels that read consecutive rows of eight columns: those of the factor's panels, and of blocks of vectors.

#![expect(clippy::needless_range_loop, reason = "see the note on loops below")]

use pulp::{Arch, Simd, WithSimd};

/// Values of `N` right-hand sides at one row; `N` is 8, 16 or 32.
pub(crate) type Row<const N: usize> = [f64; N];

/// Columns of a whole group.
pub(crate) const GROUP: usize = 8;

/// Right-hand sides at a time: with so many, the solutions of a group's columns stay in the registers of
/// AVX-512.
const LANES_AT_A_TIME: usize = 16;

/// Consecutive rows of a group.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a, const C: usize> {
    pub(crate) l: &'a [[f64; C]],
    pub(crate) fetch: Fetch,
}

/// What is to be fetched while rows of a whole group are read, each a cache line: those of the next *window*,
/// from its four quarters in turn, which are four pages. Whatever the line, asking for it is harmless.
#[derive(Clone, Copy)]
pub(crate) struct Fetch {
    /// Which line of all that are read the first row is.
    pub(crate) begin: usize,
    /// Lines between the end of these rows and those that are read next.
    pub(crate) gap: usize,
}

/// Lines of a window: 16 KB.
const WINDOW: usize = 256;

impl Fetch {
    /// The line of a window that is asked for when its line `at` would be.
    #[inline(always)]
    fn permuted(at: usize) -> usize {
        (at % 4) * (WINDOW / 4) + at / 4
    }

    /// On the way down, at row `i`.
    #[inline(always)]
    fn ahead<const C: usize>(self, l: &[[f64; C]], i: usize) {
        if C != GROUP {
            return;
        }
        let at = self.begin + i;
        let line = at - at % WINDOW + WINDOW + Fetch::permuted(at % WINDOW) - self.begin;
        let line = if line < l.len() { line } else { line + self.gap };
        prefetch_index::prefetch_index(l, line);
    }

    /// On the way up, at row `i`.
    #[inline(always)]
    fn behind<const C: usize>(self, l: &[[f64; C]], i: usize) {
        if C != GROUP {
            return;
        }
        let (begin, at) = (self.begin as isize, self.begin + i);
        let window = (at - at % WINDOW) as isize;
        // Negative before the first of these rows.
        let line = window - 1 - Fetch::permuted(WINDOW - 1 - at % WINDOW) as isize - begin;
        let line = if line >= 0 { line } else { line - self.gap as isize };
        prefetch_index::prefetch_index(l, line as usize);
    }
}

pub(crate) fn dispatch(operation: impl WithSimd<Output = ()>) {
    Arch::new().dispatch(operation);
}

// Loops, not iterator or array methods: those are not sure to be inlined into code compiled for the
// processor at hand, and cost tenfold when they are not.

#[inline(always)]
pub(crate) fn load<S: Simd, const N: usize>(row: &Row<N>, part: usize) -> S::f64s {
    S::as_simd_f64s(row).0[part]
}

#[inline(always)]
pub(crate) fn store<S: Simd, const N: usize>(row: &mut Row<N>, part: usize, x: S::f64s) {
    S::as_mut_simd_f64s(row).0[part] = x;
}

/// Y ← Y − LX for rows of one group.
#[inline(always)]
pub(crate) fn subtract_rows<S: Simd, const N: usize, const C: usize>(
    simd: S,
    rows: Rows<'_, C>,
    x: &[Row<N>],
    y: &mut [Row<N>],
) {
    if N > LANES_AT_A_TIME {
        subtract_lanes::<S, N, C, 0, LANES_AT_A_TIME>(simd, rows, x, y);
        subtract_lanes::<S, N, C, LANES_AT_A_TIME, LANES_AT_A_TIME>(simd, rows, x, y);
    } else {
        subtract_lanes::<S, N, C, 0, N>(simd, rows, x, y);
    }
}

/// The same for `W` right-hand sides from `LANE` on.
#[inline(always)]
fn subtract_lanes<S: Simd, const N: usize, const C: usize, const LANE: usize, const W: usize>(
    simd: S,
    rows: Rows<'_, C>,
    x: &[Row<N>],
    y: &mut [Row<N>],
) {
    let Rows { l, fetch } = rows;
    let zero = simd.splat_f64s(0.0);
    let (begin, n_parts) = (LANE / S::F64_LANES, W / S::F64_LANES);
    let mut minus = [[zero; W]; C];
    for c in 0..C {
        for part in 0..n_parts {
            minus[c][part] = simd.sub_f64s(zero, load::<S, N>(&x[c], begin + part));
        }
    }
    let y = &mut y[..l.len()];
    for i in 0..l.len() {
        if LANE == 0 {
            fetch.ahead(l, i);
        }
        let mut factor = [zero; C];
        for c in 0..C {
            factor[c] = simd.splat_f64s(l[i][c]);
        }
        for part in 0..n_parts {
            let mut sum = load::<S, N>(&y[i], begin + part);
            for c in 0..C {
                sum = simd.mul_add_f64s(factor[c], minus[c][part], sum);
            }
            store::<S, N>(&mut y[i], begin + part, sum);
        }
    }
}

/// X ← X − LᵀY for rows of one group.
#[inline(always)]
pub(crate) fn subtract_transposed_rows<S: Simd, const N: usize, const C: usize>(
    simd: S,
    rows: Rows<'_, C>,
    x: &mut [Row<N>],
    y: &[Row<N>],
) {
    if N > LANES_AT_A_TIME {
        subtract_transposed_lanes::<S, N, C, 0, LANES_AT_A_TIME>(simd, rows, x, y);
        subtract_transposed_lanes::<S, N, C, LANES_AT_A_TIME, LANES_AT_A_TIME>(simd, rows, x, y);
    } else {
        subtract_transposed_lanes::<S, N, C, 0, N>(simd, rows, x, y);
    }
}

/// The same for `W` right-hand sides from `LANE` on.
#[inline(always)]
fn subtract_transposed_lanes<
    S: Simd,
    const N: usize,
    const C: usize,
    const LANE: usize,
    const W: usize,
>(
    simd: S,
    rows: Rows<'_, C>,
    x: &mut [Row<N>],
    y: &[Row<N>],
) {
    let Rows { l, fetch } = rows;
    let zero = simd.splat_f64s(0.0);
    let (begin, n_parts) = (LANE / S::F64_LANES, W / S::F64_LANES);
    let mut sums = [[zero; W]; C];
    let y = &y[..l.len()];
    // From the end, as the groups.
    for i in 0..l.len() {
        let i = l.len() - 1 - i;
        if LANE == 0 {
            fetch.behind(l, i);
        }
        let mut row = [zero; W];
        for part in 0..n_parts {
            row[part] = load::<S, N>(&y[i], begin + part);
        }
        for c in 0..C {
            let factor = simd.splat_f64s(l[i][c]);
            for part in 0..n_parts {
                sums[c][part] = simd.mul_add_f64s(factor, row[part], sums[c][part]);
            }
        }
    }
    for c in 0..C {
        for part in 0..n_parts {
            let before = load::<S, N>(&x[c], begin + part);
            store::<S, N>(&mut x[c], begin + part, simd.sub_f64s(before, sums[c][part]));
        }
    }
}

/// `y -= factor·x`.
#[inline(always)]
pub(crate) fn subtract_row<S: Simd, const N: usize>(
    simd: S,
    factor: f64,
    x: &Row<N>,
    y: &mut Row<N>,
) {
    let minus = simd.splat_f64s(-factor);
    for part in 0..N / S::F64_LANES {
        let sum = simd.mul_add_f64s(minus, load::<S, N>(x, part), load::<S, N>(y, part));
        store::<S, N>(y, part, sum);
    }
}

#[inline(always)]
pub(crate) fn scale<S: Simd, const N: usize>(simd: S, x: &mut Row<N>, factor: f64) {
    let factor = simd.splat_f64s(factor);
    for part in 0..N / S::F64_LANES {
        let scaled = simd.mul_f64s(load::<S, N>(x, part), factor);
        store::<S, N>(x, part, scaled);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_is_asked_for_line_by_line() {
        let mut lines: Vec<usize> = (0..WINDOW).map(Fetch::permuted).collect();
        lines.sort_unstable();
        assert_eq!(lines, (0..WINDOW).collect::<Vec<_>>());
    }
}
