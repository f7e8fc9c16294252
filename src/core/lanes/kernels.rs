//! Kernels that read consecutive rows of eight columns: those of the factor's panels, and of blocks of vectors.

#![expect(clippy::needless_range_loop, reason = "see the note on loops below")]

use bytemuck::Pod;
use pulp::{Arch, Simd, WithSimd};
use std::fmt::Debug;
use std::ops::AddAssign;

/// Numbers of a factor and of what is solved with it: in double precision, or in single, of which twice as many fit into a
/// register and come from memory in the same time.
pub trait Real: Pod + Default + PartialEq + Debug + AddAssign + Send + Sync {
    /// Numbers of right-hand sides that are solved for at a time, ascending; the fewest fill a register of AVX-512.
    const WIDTHS: [usize; 3];

    /// Right-hand sides for which the solutions of a group's columns stay in the registers of AVX-512.
    const AT_A_TIME: usize;

    /// Whether numbers that doubles can be are beyond its range.
    const IS_NARROW: bool;

    /// A register full.
    type Register<S: Simd>: Copy;

    /// The nearest number.
    fn nearest(x: f64) -> Self;
    /// The same number.
    fn double(self) -> f64;
    /// One over it.
    fn recip(self) -> Self;
    /// Numbers in a register.
    fn lanes<S: Simd>() -> usize;
    /// `x` in all lanes.
    fn splat<S: Simd>(simd: S, x: Self) -> Self::Register<S>;
    /// `x - y`.
    fn sub<S: Simd>(simd: S, x: Self::Register<S>, y: Self::Register<S>) -> Self::Register<S>;
    /// `x·y`.
    fn mul<S: Simd>(simd: S, x: Self::Register<S>, y: Self::Register<S>) -> Self::Register<S>;
    /// `x·y + z`.
    fn mul_add<S: Simd>(
        simd: S,
        x: Self::Register<S>,
        y: Self::Register<S>,
        z: Self::Register<S>,
    ) -> Self::Register<S>;
    /// The register full of `row` at `part`.
    fn load<S: Simd>(row: &[Self], part: usize) -> Self::Register<S>;
    /// The same, written.
    fn store<S: Simd>(row: &mut [Self], part: usize, x: Self::Register<S>);
}

macro_rules! real {
    ($real:ty, $widths:expr, $at_a_time:literal, $is_narrow:literal, $register:ident, $lanes:ident, $splat:ident, $sub:ident, $mul:ident,
     $mul_add:ident, $load:ident, $store:ident) => {
        impl Real for $real {
            const WIDTHS: [usize; 3] = $widths;
            const AT_A_TIME: usize = $at_a_time;
            const IS_NARROW: bool = $is_narrow;
            type Register<S: Simd> = S::$register;

            fn nearest(x: f64) -> Self {
                x as Self
            }
            fn double(self) -> f64 {
                self.into()
            }
            fn recip(self) -> Self {
                1.0 / self
            }
            #[inline(always)]
            fn lanes<S: Simd>() -> usize {
                S::$lanes
            }
            #[inline(always)]
            fn splat<S: Simd>(simd: S, x: Self) -> S::$register {
                simd.$splat(x)
            }
            #[inline(always)]
            fn sub<S: Simd>(simd: S, x: S::$register, y: S::$register) -> S::$register {
                simd.$sub(x, y)
            }
            #[inline(always)]
            fn mul<S: Simd>(simd: S, x: S::$register, y: S::$register) -> S::$register {
                simd.$mul(x, y)
            }
            #[inline(always)]
            fn mul_add<S: Simd>(
                simd: S,
                x: S::$register,
                y: S::$register,
                z: S::$register,
            ) -> S::$register {
                simd.$mul_add(x, y, z)
            }
            #[inline(always)]
            fn load<S: Simd>(row: &[Self], part: usize) -> S::$register {
                S::$load(row).0[part]
            }
            #[inline(always)]
            fn store<S: Simd>(row: &mut [Self], part: usize, x: S::$register) {
                S::$store(row).0[part] = x;
            }
        }
    };
}

real!(
    f64,
    [8, 16, 32],
    16,
    false,
    f64s,
    F64_LANES,
    splat_f64s,
    sub_f64s,
    mul_f64s,
    mul_add_f64s,
    as_simd_f64s,
    as_mut_simd_f64s
);
real!(
    f32,
    [16, 32, 48],
    48,
    true,
    f32s,
    F32_LANES,
    splat_f32s,
    sub_f32s,
    mul_f32s,
    mul_add_f32s,
    as_simd_f32s,
    as_mut_simd_f32s
);

/// Values of `N` right-hand sides at one row; `N` is one of [`Real::WIDTHS`].
pub(crate) type Row<T, const N: usize> = [T; N];

/// Columns of a whole group.
pub(crate) const GROUP: usize = 8;

/// Consecutive rows of a group.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a, T, const C: usize> {
    pub(crate) l: &'a [[T; C]],
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
    fn ahead<T, const C: usize>(self, l: &[[T; C]], i: usize) {
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
    fn behind<T, const C: usize>(self, l: &[[T; C]], i: usize) {
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

/// Y ← Y − LX for rows of one group.
#[inline(always)]
pub(crate) fn subtract_rows<S: Simd, T: Real, const N: usize, const C: usize>(
    simd: S,
    rows: Rows<'_, T, C>,
    x: &[Row<T, N>],
    y: &mut [Row<T, N>],
) {
    if N > T::AT_A_TIME {
        subtract_lanes::<S, T, N, C, 0, 16>(simd, rows, x, y);
        subtract_lanes::<S, T, N, C, 16, 16>(simd, rows, x, y);
    } else {
        subtract_lanes::<S, T, N, C, 0, N>(simd, rows, x, y);
    }
}

/// The same for `W` right-hand sides from `LANE` on.
#[inline(always)]
fn subtract_lanes<
    S: Simd,
    T: Real,
    const N: usize,
    const C: usize,
    const LANE: usize,
    const W: usize,
>(
    simd: S,
    rows: Rows<'_, T, C>,
    x: &[Row<T, N>],
    y: &mut [Row<T, N>],
) {
    let Rows { l, fetch } = rows;
    let zero = T::splat(simd, T::default());
    let (begin, n_parts) = (LANE / T::lanes::<S>(), W / T::lanes::<S>());
    let mut minus = [[zero; W]; C];
    for c in 0..C {
        for part in 0..n_parts {
            minus[c][part] = T::sub(simd, zero, T::load::<S>(&x[c], begin + part));
        }
    }
    let y = &mut y[..l.len()];
    for i in 0..l.len() {
        if LANE == 0 {
            fetch.ahead(l, i);
        }
        let mut factor = [zero; C];
        for c in 0..C {
            factor[c] = T::splat(simd, l[i][c]);
        }
        for part in 0..n_parts {
            let mut sum = T::load::<S>(&y[i], begin + part);
            for c in 0..C {
                sum = T::mul_add(simd, factor[c], minus[c][part], sum);
            }
            T::store::<S>(&mut y[i], begin + part, sum);
        }
    }
}

/// X ← X − LᵀY for rows of one group.
#[inline(always)]
pub(crate) fn subtract_transposed_rows<S: Simd, T: Real, const N: usize, const C: usize>(
    simd: S,
    rows: Rows<'_, T, C>,
    x: &mut [Row<T, N>],
    y: &[Row<T, N>],
) {
    if N > T::AT_A_TIME {
        subtract_transposed_lanes::<S, T, N, C, 0, 16>(simd, rows, x, y);
        subtract_transposed_lanes::<S, T, N, C, 16, 16>(simd, rows, x, y);
    } else {
        subtract_transposed_lanes::<S, T, N, C, 0, N>(simd, rows, x, y);
    }
}

/// The same for `W` right-hand sides from `LANE` on.
#[inline(always)]
fn subtract_transposed_lanes<
    S: Simd,
    T: Real,
    const N: usize,
    const C: usize,
    const LANE: usize,
    const W: usize,
>(
    simd: S,
    rows: Rows<'_, T, C>,
    x: &mut [Row<T, N>],
    y: &[Row<T, N>],
) {
    let Rows { l, fetch } = rows;
    let zero = T::splat(simd, T::default());
    let (begin, n_parts) = (LANE / T::lanes::<S>(), W / T::lanes::<S>());
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
            row[part] = T::load::<S>(&y[i], begin + part);
        }
        for c in 0..C {
            let factor = T::splat(simd, l[i][c]);
            for part in 0..n_parts {
                sums[c][part] = T::mul_add(simd, factor, row[part], sums[c][part]);
            }
        }
    }
    for c in 0..C {
        for part in 0..n_parts {
            let before = T::load::<S>(&x[c], begin + part);
            T::store::<S>(&mut x[c], begin + part, T::sub(simd, before, sums[c][part]));
        }
    }
}

/// `y -= factor·x`.
#[inline(always)]
pub(crate) fn subtract_row<S: Simd, T: Real, const N: usize>(
    simd: S,
    factor: T,
    x: &Row<T, N>,
    y: &mut Row<T, N>,
) {
    let minus = T::sub(simd, T::splat(simd, T::default()), T::splat(simd, factor));
    for part in 0..N / T::lanes::<S>() {
        let sum = T::mul_add(simd, minus, T::load::<S>(x, part), T::load::<S>(y, part));
        T::store::<S>(y, part, sum);
    }
}

/// `x *= factor`.
#[inline(always)]
pub(crate) fn scale<S: Simd, T: Real, const N: usize>(simd: S, x: &mut Row<T, N>, factor: T) {
    let factor = T::splat(simd, factor);
    for part in 0..N / T::lanes::<S>() {
        let scaled = T::mul(simd, T::load::<S>(x, part), factor);
        T::store::<S>(x, part, scaled);
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
