//! The one place that speaks to faer about dense matrices.
//!
//! faer's own parallelism spins on skinny products (measured 2.6 × the processor time), so every
//! call here is sequential and parallelism comes from row chunks of fixed size: results do not
//! depend on the number of threads.

use crate::pool::Tall;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;
use sutura_reduced::dense::sequential;
pub use sutura_reduced::dense::{
    DenseError, SmallCholesky, lower_inverse, small_product, symmetric_eigen, vectorized,
};

/// Rows per parallel piece of a tall matrix.
const ROW_CHUNK: usize = 4096;

/// `XᵀY` of tall matrices (n×k, n×l → k×l).
pub fn gram(x: MatRef<'_, f64>, y: MatRef<'_, f64>) -> Mat<f64> {
    sum_over_chunks(x, y, |part, x, y, _| {
        matmul(part, Accum::Replace, x.transpose(), y, 1.0, Par::Seq);
    })
}

/// `XᵀDY` of tall matrices (n×k, n×l → k×l), D being diagonal with `weight(i)` in row i. D·Y exists
/// only a chunk at a time, in the processor's cache.
pub fn weighted_gram(
    x: MatRef<'_, f64>,
    weight: impl Fn(usize) -> f64 + Sync,
    y: MatRef<'_, f64>,
) -> Mat<f64> {
    sum_over_chunks(x, y, |part, x, y, start| {
        let weights: Vec<f64> = (start..start + y.nrows()).map(&weight).collect();
        let mut weighted = y.to_owned();
        for j in 0..weighted.ncols() {
            let column = weighted.col_as_slice_mut(j).iter_mut();
            column.zip(&weights).for_each(|(y, w)| *y *= w);
        }
        matmul(part, Accum::Replace, x.transpose(), weighted.as_ref(), 1.0, Par::Seq);
    })
}

/// The sum over row chunks, in their order, of what `product(part, x, y, first row)` writes.
fn sum_over_chunks(
    x: MatRef<'_, f64>,
    y: MatRef<'_, f64>,
    product: impl Fn(MatMut<'_, f64>, MatRef<'_, f64>, MatRef<'_, f64>, usize) + Sync,
) -> Mat<f64> {
    assert_eq!(x.nrows(), y.nrows());
    let n = x.nrows();
    let parts: Vec<Mat<f64>> = (0..n.div_ceil(ROW_CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let start = chunk * ROW_CHUNK;
            let rows = ROW_CHUNK.min(n - start);
            let mut part = Mat::zeros(x.ncols(), y.ncols());
            product(part.as_mut(), x.subrows(start, rows), y.subrows(start, rows), start);
            part
        })
        .collect();
    let mut sum = Mat::zeros(x.ncols(), y.ncols());
    for part in parts {
        sum += part;
    }
    sum
}

/// `Y += alpha·X·C` with X tall (n×k) and C small (k×l).
pub fn add_product(y: MatMut<'_, f64>, alpha: f64, x: MatRef<'_, f64>, c: MatRef<'_, f64>) {
    assert_eq!((y.nrows(), y.ncols(), x.ncols()), (x.nrows(), c.ncols(), c.nrows()));
    if x.nrows() == 0 || x.ncols() == 0 || c.ncols() == 0 {
        return;
    }
    y.par_row_chunks_mut(ROW_CHUNK)
        .zip(x.par_row_chunks(ROW_CHUNK))
        .for_each(|(y, x)| matmul(y, Accum::Add, x, c, alpha, Par::Seq));
}

/// `Y ← Σ X_i·C_i` with tall X_i (n×k_i) and small C_i (k_i×l), Y being written once.
pub fn combine(y: MatMut<'_, f64>, x: &[MatRef<'_, f64>], c: &[MatRef<'_, f64>]) {
    y.par_row_chunks_mut(ROW_CHUNK).enumerate().for_each(|(chunk, y)| {
        combine_rows(y, chunk * ROW_CHUNK, x, c);
    });
}

/// The rows of [`combine`] from `first` on.
pub fn combine_rows(
    mut y: MatMut<'_, f64>,
    first: usize,
    x: &[MatRef<'_, f64>],
    c: &[MatRef<'_, f64>],
) {
    assert_eq!(x.len(), c.len());
    let mut accum = Accum::Replace;
    for (x, c) in x.iter().zip(c).filter(|(x, _)| x.ncols() > 0) {
        let x = x.subrows(first, y.nrows());
        matmul(y.as_mut(), accum, x, *c, 1.0, Par::Seq);
        accum = Accum::Add;
    }
    if accum == Accum::Replace {
        y.fill(0.0);
    }
}

/// `X·C` with X tall (n×k) and C small (k×l).
pub fn product(x: MatRef<'_, f64>, c: MatRef<'_, f64>) -> Mat<f64> {
    let mut y = Mat::zeros(x.nrows(), c.ncols());
    add_product(y.as_mut(), 1.0, x, c);
    y
}

/// The same in memory that was used before.
pub fn tall_product(x: MatRef<'_, f64>, c: MatRef<'_, f64>) -> Tall {
    let mut y = Tall::for_a_while(x.nrows(), c.ncols());
    combine(y.as_mut(), &[x], &[c]);
    y
}

/// `X ← X·C` with X tall (n×k) and C small (k×k).
pub fn turn(x: MatMut<'_, f64>, c: MatRef<'_, f64>) {
    assert_eq!((c.nrows(), c.ncols()), (x.ncols(), x.ncols()));
    x.par_row_chunks_mut(ROW_CHUNK).for_each(|x| {
        let before = x.to_owned();
        matmul(x, Accum::Replace, before.as_ref(), c, 1.0, Par::Seq);
    });
}

/// Left singular vectors and singular values (descending) of a small matrix.
pub fn left_singular(a: MatRef<'_, f64>) -> Result<(Vec<f64>, Mat<f64>), DenseError> {
    if a.nrows() == 0 || a.ncols() == 0 {
        return Ok((Vec::new(), Mat::zeros(a.nrows(), 0)));
    }
    sequential();
    let svd = a.thin_svd().map_err(|_| DenseError("singular value decomposition"))?;
    let values: Vec<f64> = (0..svd.U().ncols()).map(|i| svd.S()[i]).collect();
    if values.iter().any(|v| !v.is_finite()) {
        return Err(DenseError("singular value decomposition"));
    }
    Ok((values, svd.U().to_owned()))
}

/// Coefficients that make a set of vectors orthonormal, from their Gram matrix (k×k): returns C
/// (k×m, m ≤ k) with CᵀGC = I, leaving out directions whose squared length, after scaling every
/// vector to unit length, is below `drop`.
pub fn orthonormal_coefficients(g: MatRef<'_, f64>, drop: f64) -> Result<Mat<f64>, DenseError> {
    let k = g.nrows();
    let scale: Vec<f64> =
        (0..k).map(|i| if g[(i, i)] > 0.0 { g[(i, i)].sqrt().recip() } else { 0.0 }).collect();
    let scaled = Mat::from_fn(k, k, |i, j| g[(i, j)] * scale[i] * scale[j]);
    let (values, vectors) = symmetric_eigen(scaled.as_ref())?;
    let floor = drop * values.last().copied().unwrap_or(0.0).max(1.0);
    let first = values.partition_point(|&v| v <= floor);
    Ok(Mat::from_fn(k, k - first, |i, j| {
        scale[i] * vectors[(i, first + j)] / values[first + j].sqrt()
    }))
}

/// Ritz pairs in a space of the Gram matrices K and M (k×k), in inverse form, which is well conditioned whatever the
/// largest eigenvalue of K: θ = 1/λ descending, and coefficients C (k×m) with CᵀMC = I. Directions that are dependent in
/// K to within `drop` ([`orthonormal_coefficients`]) are left out.
pub fn inverse_ritz(
    gram_k: MatRef<'_, f64>,
    gram_m: MatRef<'_, f64>,
    drop: f64,
) -> Result<(Vec<f64>, Mat<f64>), DenseError> {
    let b = orthonormal_coefficients(gram_k, drop)?;
    let mb = small_product(gram_m, b.as_ref());
    let (theta, y) = symmetric_eigen(small_product(b.transpose(), mb.as_ref()).as_ref())?;
    let k = theta.len();
    let by = small_product(b.as_ref(), y.as_ref());
    let theta: Vec<f64> = theta.into_iter().rev().collect();
    let c = Mat::from_fn(by.nrows(), k, |i, j| {
        by[(i, k - 1 - j)] / theta[j].max(f64::MIN_POSITIVE).sqrt()
    });
    Ok((theta, c))
}

/// How far from orthonormal vectors of the size of a mesh may be ([`distance_from_identity`]): inner products of
/// 105 264 numbers are rounded by some 1e-13.
pub const ORTHONORMAL: f64 = 1e-12;

/// Largest entry of `|G − I|`: how far from orthonormal a set of vectors with Gram matrix G is.
pub fn distance_from_identity(g: MatRef<'_, f64>) -> f64 {
    let mut worst = 0.0f64;
    for j in 0..g.ncols() {
        for i in 0..g.nrows() {
            worst = worst.max((g[(i, j)] - f64::from(i == j)).abs());
        }
    }
    worst
}

/// The columns of `parts` side by side.
pub fn concatenate(parts: &[MatRef<'_, f64>]) -> Mat<f64> {
    let n = parts.first().map_or(0, |p| p.nrows());
    let k = parts.iter().map(|p| p.ncols()).sum();
    let mut all = Mat::zeros(n, k);
    let mut at = 0;
    for part in parts {
        all.as_mut().subcols_mut(at, part.ncols()).copy_from(part);
        at += part.ncols();
    }
    all
}

/// The rows of `parts` one below the other.
pub fn stacked(parts: &[MatRef<'_, f64>]) -> Mat<f64> {
    let columns = parts.first().map_or(0, |p| p.ncols());
    let rows = parts.iter().map(|p| p.nrows()).sum();
    let mut all = Mat::zeros(rows, columns);
    let mut at = 0;
    for part in parts {
        all.as_mut().subrows_mut(at, part.nrows()).copy_from(part);
        at += part.nrows();
    }
    all
}

/// A symmetric matrix (k×k) grown by the block column `column` (m×(m − k)), of whose lower square the
/// symmetric part is taken.
pub fn bordered_symmetric(old: MatRef<'_, f64>, column: MatRef<'_, f64>) -> Mat<f64> {
    let (k, m) = (old.ncols(), column.nrows());
    Mat::from_fn(m, m, |i, j| match (i < k, j < k) {
        (true, true) => old[(i, j)],
        (true, false) => column[(i, j - k)],
        (false, true) => column[(j, i - k)],
        (false, false) => 0.5 * (column[(i, j - k)] + column[(j, i - k)]),
    })
}

/// Calls `f(j, column)` for every column of a column-major matrix, in parallel. Also where a sweep is
/// only memory traffic: fresh pages are then first touched, and zeroed, by both threads.
pub fn for_each_column(a: MatMut<'_, f64>, f: impl Fn(usize, &mut [f64]) + Sync) {
    a.par_col_chunks_mut(1).enumerate().for_each(|(j, column)| {
        if let Some(column) = column.col_mut(0).try_as_col_major_mut() {
            f(j, column.as_slice_mut());
        }
    });
}

/// `Y ← X`, by all threads.
pub fn copy(y: MatMut<'_, f64>, x: MatRef<'_, f64>) {
    assert_eq!((y.nrows(), y.ncols()), (x.nrows(), x.ncols()));
    for_each_column(y, |j, y| y.iter_mut().zip(x.col(j).iter()).for_each(|(y, x)| *y = *x));
}

/// The chosen columns of `a`.
pub fn columns(a: MatRef<'_, f64>, chosen: &[usize]) -> Mat<f64> {
    let mut some = Mat::zeros(a.nrows(), chosen.len());
    for_each_column(some.as_mut(), |j, column| {
        column.iter_mut().zip(a.col(chosen[j]).iter()).for_each(|(to, from)| *to = *from);
    });
    some
}

/// Euclidean lengths of the columns.
pub fn column_norms(a: MatRef<'_, f64>) -> Vec<f64> {
    (0..a.ncols()).into_par_iter().map(|j| (a.col(j).transpose() * a.col(j)).sqrt()).collect()
}

/// xᵀy of every column of X and of Y.
pub fn column_products(x: MatRef<'_, f64>, y: MatRef<'_, f64>) -> Vec<f64> {
    (0..x.ncols()).into_par_iter().map(|j| x.col(j).transpose() * y.col(j)).collect()
}

/// Bytes of a dense matrix.
pub fn bytes(a: &Mat<f64>) -> usize {
    a.nrows() * a.ncols() * size_of::<f64>()
}
