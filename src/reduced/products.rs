//! The products that an evaluation is made of, in the widest registers that the processor has.
//!
//! A point has nine columns G, one for each entry of a 3×3 matrix (3·row + column).

use crate::material::Mat9;
use pulp::{Simd, WithSimd};

/// Rows of tables are padded by zeros to a multiple of it: no register is wider.
pub(crate) const LANES: usize = 8;

/// Bytes that the processor fetches at a time.
const CACHE_LINE: usize = 64;

/// A matrix by columns, each of which begins with a cache line: half of all loads would touch two otherwise.
#[derive(Debug)]
pub(crate) struct Table {
    rows: usize,
    values: Vec<f64>,
    /// Where the first column begins.
    first: usize,
}

impl Table {
    /// Zeros; `n_rows` is rounded up to a multiple of [`LANES`].
    pub(crate) fn zeros(n_rows: usize, n_columns: usize) -> Table {
        let rows = n_rows.next_multiple_of(LANES).max(LANES);
        let values = vec![0.0; rows * n_columns + CACHE_LINE / size_of::<f64>()];
        let first = values.as_ptr().align_offset(CACHE_LINE);
        // Nothing but speed depends on it where it cannot be had.
        Table { rows, first: first.min(CACHE_LINE / size_of::<f64>()), values }
    }

    /// Rows, those of padding included.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// `count` columns from `first` on, one after the other.
    pub(crate) fn columns(&self, first: usize, count: usize) -> &[f64] {
        &self.values[self.first + self.rows * first..][..self.rows * count]
    }

    /// See [`Table::columns`].
    pub(crate) fn columns_mut(&mut self, first: usize, count: usize) -> &mut [f64] {
        &mut self.values[self.first + self.rows * first..][..self.rows * count]
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.values[..])
    }
}

/// Gᵀq of each point of whose columns `gradients` are; `q` is padded as they are.
pub(crate) fn transposed_products(gradients: &[f64], q: &[f64], out: &mut [[f64; 9]]) {
    pulp::Arch::new().dispatch(TransposedProducts { gradients, q, out });
}

/// y += Σ G s over the points of whose columns `gradients` are; `entries` are their s.
pub(crate) fn add_products(y: &mut [f64], gradients: &[f64], entries: &[[f64; 9]]) {
    pulp::Arch::new().dispatch(Products { y, gradients, entries });
}

/// GC of each point, into its nine columns of `out`, of `rows` rows; each C is symmetric.
pub(crate) fn responses(out: &mut [f64], rows: usize, gradients: &[f64], c: &[Mat9]) {
    pulp::Arch::new().dispatch(Responses { out, rows, gradients, c });
}

/// The lower triangle of A += XYᵀ (some of the upper one comes with it) of an A with as many columns as rows; all of
/// `rows` padded rows.
pub(crate) fn add_lower_product(a: &mut [f64], rows: usize, x: &[f64], y: &[f64]) {
    pulp::Arch::new().dispatch(LowerProduct { a, rows, x, y });
}

// What follows has loops where closures would be shorter: a closure is compiled without the wide registers
// where it is not inlined.

struct TransposedProducts<'a> {
    gradients: &'a [f64],
    q: &'a [f64],
    out: &'a mut [[f64; 9]],
}

impl WithSimd for TransposedProducts<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let TransposedProducts { gradients, q, out } = self;
        let rows = q.len();
        let (q, _) = S::as_simd_f64s(q);
        for (g, out) in gradients.chunks_exact(9 * rows).zip(out) {
            let (g, _) = S::as_simd_f64s(g);
            let g = columns_of::<S>(g, q.len());
            let mut sums = [simd.splat_f64s(0.0); 9];
            for (part, q) in q.iter().enumerate() {
                for k in 0..9 {
                    sums[k] = simd.mul_add_f64s(g[k][part], *q, sums[k]);
                }
            }
            for k in 0..9 {
                let mut lanes = [0.0; LANES];
                if let [lanes, ..] = S::as_mut_simd_f64s(&mut lanes).0 {
                    *lanes = sums[k];
                }
                let [a, b, c, d, e, f, g, h] = lanes;
                out[k] = ((a + e) + (c + g)) + ((b + f) + (d + h));
            }
        }
    }
}

struct Products<'a> {
    y: &'a mut [f64],
    gradients: &'a [f64],
    entries: &'a [[f64; 9]],
}

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Products { y, gradients, entries } = self;
        let rows = y.len();
        let (y, _) = S::as_mut_simd_f64s(y);
        for (g, entries) in gradients.chunks_exact(9 * rows).zip(entries) {
            let (g, _) = S::as_simd_f64s(g);
            let g = columns_of::<S>(g, y.len());
            for (part, y) in y.iter_mut().enumerate() {
                let mut sum = *y;
                for k in 0..9 {
                    sum = simd.mul_add_f64s(g[k][part], simd.splat_f64s(entries[k]), sum);
                }
                *y = sum;
            }
        }
    }
}

struct Responses<'a> {
    out: &'a mut [f64],
    rows: usize,
    gradients: &'a [f64],
    c: &'a [Mat9],
}

impl WithSimd for Responses<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Responses { out, rows, gradients, c } = self;
        let n_parts = rows / S::F64_LANES;
        let points = gradients.chunks_exact(9 * rows).zip(out.chunks_exact_mut(9 * rows));
        for ((g, out), c) in points.zip(c) {
            let (g, _) = S::as_simd_f64s(g);
            let (out, _) = S::as_mut_simd_f64s(out);
            let g = columns_of::<S>(g, n_parts);
            for part in 0..n_parts {
                let mut x = [simd.splat_f64s(0.0); 9];
                for k in 0..9 {
                    x[k] = g[k][part];
                }
                for i in 0..9 {
                    let mut sum = simd.mul_f64s(simd.splat_f64s(c[i][0]), x[0]);
                    for k in 1..9 {
                        sum = simd.mul_add_f64s(simd.splat_f64s(c[i][k]), x[k], sum);
                    }
                    out[n_parts * i + part] = sum;
                }
            }
        }
    }
}

struct LowerProduct<'a> {
    a: &'a mut [f64],
    rows: usize,
    x: &'a [f64],
    y: &'a [f64],
}

impl WithSimd for LowerProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // As many sums as leave registers for what they are made of.
        match S::REGISTER_COUNT >= 32 {
            true => self.by_tiles::<S, 8>(simd),
            false => self.by_tiles::<S, 4>(simd),
        }
    }
}

impl LowerProduct<'_> {
    /// Tiles of three registers by `WIDTH` columns.
    #[inline(always)]
    fn by_tiles<S: Simd, const WIDTH: usize>(mut self, simd: S) {
        let n_parts = self.rows / S::F64_LANES;
        for column in (0..self.rows).step_by(WIDTH) {
            let mut part = column / S::F64_LANES;
            while part < n_parts {
                // Four are two and two: a single register would wait for itself.
                part += match n_parts - part {
                    1 => self.add_tile::<S, 1, WIDTH>(simd, part, column),
                    2 | 4 => self.add_tile::<S, 2, WIDTH>(simd, part, column),
                    _ => self.add_tile::<S, 3, WIDTH>(simd, part, column),
                };
            }
        }
    }

    /// One tile, `HEIGHT` registers high; its height.
    #[inline(always)]
    fn add_tile<S: Simd, const HEIGHT: usize, const WIDTH: usize>(
        &mut self,
        simd: S,
        part: usize,
        column: usize,
    ) -> usize {
        let LowerProduct { a, rows, x, y } = self;
        let (row, height) = (part * S::F64_LANES, HEIGHT * S::F64_LANES);
        let mut sums = [[simd.splat_f64s(0.0); HEIGHT]; WIDTH];
        for (x, y) in x.chunks_exact(*rows).zip(y.chunks_exact(*rows)) {
            let (x, _) = S::as_simd_f64s(&x[row..row + height]);
            let (x, y) = (&x[..HEIGHT], &y[column..column + WIDTH]);
            for j in 0..WIDTH {
                let y = simd.splat_f64s(y[j]);
                for i in 0..HEIGHT {
                    sums[j][i] = simd.mul_add_f64s(x[i], y, sums[j][i]);
                }
            }
        }
        for j in 0..WIDTH {
            let to = &mut a[*rows * (column + j) + row..][..height];
            let (to, _) = S::as_mut_simd_f64s(to);
            for (to, sum) in to.iter_mut().zip(&sums[j]) {
                *to = simd.add_f64s(*to, *sum);
            }
        }
        HEIGHT
    }
}

/// The nine columns of a point, `n_parts` registers each.
#[inline(always)]
fn columns_of<S: Simd>(g: &[S::f64s], n_parts: usize) -> [&[S::f64s]; 9] {
    let mut columns: [&[S::f64s]; 9] = [&[]; 9];
    for (k, column) in columns.iter_mut().enumerate() {
        *column = &g[n_parts * k..][..n_parts];
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers without a pattern, in a table.
    fn table(n_rows: usize, n_columns: usize, seed: f64) -> Table {
        let mut table = Table::zeros(n_rows, n_columns);
        for (i, x) in table.columns_mut(0, n_columns).iter_mut().enumerate() {
            *x = (seed + 1.7 * i as f64).sin();
        }
        table
    }

    fn is_near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-12
    }

    #[test]
    fn columns_begin_with_cache_lines_of_padded_rows() {
        for n_rows in [0, 1, 8, 60] {
            let table = Table::zeros(n_rows, 3);
            assert_eq!(table.rows() % LANES, 0);
            assert!(table.rows() >= n_rows.max(1) && table.rows() < n_rows.max(1) + LANES);
            assert_eq!(table.columns(2, 1).len(), table.rows());
            assert!((table.columns(1, 1).as_ptr() as usize).is_multiple_of(CACHE_LINE));
        }
    }

    /// Sums entry by entry, with the widest registers and with none.
    #[test]
    fn products_are_those_of_their_entries() {
        for (rows, n_points) in [(8, 1), (16, 3), (24, 2), (40, 5), (64, 8), (104, 1)] {
            let n = 9 * n_points;
            let (g, q) = (table(rows, n, 0.3), table(rows, 1, 2.0));
            let (g, q) = (g.columns(0, n), q.columns(0, 1));
            let at = |table: &[f64], i: usize, j: usize| table[rows * j + i];
            let entries: Vec<[f64; 9]> =
                (0..n_points).map(|p| std::array::from_fn(|k| (p + 2 * k) as f64 - 3.0)).collect();
            let c: Vec<Mat9> = entries
                .iter()
                .map(|x| std::array::from_fn(|i| std::array::from_fn(|j| (x[i] * x[j]).cos())))
                .collect();
            for is_scalar in [false, true] {
                let mut strains = vec![[0.0; 9]; n_points];
                let mut force = vec![1.0; rows];
                let mut response = table(rows, n, 0.0);
                let response = response.columns_mut(0, n);
                let mut a = vec![0.5; rows * rows];
                if is_scalar {
                    let simd = pulp::Scalar;
                    simd.vectorize(TransposedProducts { gradients: g, q, out: &mut strains });
                    simd.vectorize(Products { y: &mut force, gradients: g, entries: &entries });
                    simd.vectorize(Responses { out: response, rows, gradients: g, c: &c });
                    simd.vectorize(LowerProduct { a: &mut a, rows, x: g, y: response });
                } else {
                    transposed_products(g, q, &mut strains);
                    add_products(&mut force, g, &entries);
                    responses(response, rows, g, &c);
                    add_lower_product(&mut a, rows, g, response);
                }
                for (i, force) in force.iter().take(rows).enumerate() {
                    let expected: f64 = (0..n).map(|k| at(g, i, k) * entries[k / 9][k % 9]).sum();
                    assert!(is_near(*force, 1.0 + expected));
                }
                for k in 0..n {
                    let expected: f64 = (0..rows).map(|i| at(g, i, k) * q[i]).sum();
                    assert!(is_near(strains[k / 9][k % 9], expected));
                    for i in 0..rows {
                        let row = &c[k / 9][k % 9];
                        let g = |l: usize| at(g, i, 9 * (k / 9) + l);
                        let expected: f64 = (0..9).map(|l| row[l] * g(l)).sum();
                        assert!(is_near(at(response, i, k), expected));
                    }
                }
                for j in 0..rows {
                    for i in j..rows {
                        let expected: f64 = (0..n).map(|k| at(g, i, k) * at(response, j, k)).sum();
                        assert!(is_near(at(&a, i, j), 0.5 + expected), "{rows} {i} {j}");
                    }
                }
            }
        }
    }
}
