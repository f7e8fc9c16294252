//! Dense kernels of one front: its partial Cholesky factorization.
//!
//! Work is cut into chunks of fixed size whether or not threads share it, so that results do not
//! depend on the number of threads.

use super::panel::Threads;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltError, LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, MatRef, Par, Spec};
use rayon::prelude::*;

/// Columns eliminated at a time.
const BLOCK: usize = 128;

/// Rows or columns of one chunk of work.
const CHUNK: usize = 192;

/// Runs `f` on every item, on this thread or on all.
fn for_each<I: IndexedParallelIterator>(
    threads: Threads,
    items: I,
    f: impl Fn(I::Item) + Sync + Send,
) where
    I::Item: Send,
{
    match threads {
        // One piece is one sequential loop.
        Threads::One => items.with_min_len(usize::MAX).for_each(f),
        Threads::All => items.for_each(f),
    }
}

/// Overwrites the first `width` columns of a front, P (height × width, lower trapezoid), by those
/// of its Cholesky factor. The error is the first column with a non-positive pivot.
pub(super) fn factor_panel(panel: MatMut<'_, f64>, threads: Threads) -> Result<(), usize> {
    let width = panel.ncols();
    let mut scratch =
        MemBuffer::new(cholesky_in_place_scratch::<f64>(BLOCK, Par::Seq, Spec::default()));
    let mut rest = panel;
    for first in (0..width).step_by(BLOCK) {
        let size = BLOCK.min(width - first);
        let (current, right) = rest.split_at_col_mut(size);
        let (mut diagonal, mut below) = current.split_at_row_mut(size);
        cholesky_in_place(
            diagonal.as_mut(),
            LltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut scratch),
            Spec::default(),
        )
        .map_err(|LltError::NonPositivePivot { index }| first + index.min(size - 1))?;
        let diagonal = diagonal.as_ref();
        // X·Lᵀ = B, as L·Xᵀ = Bᵀ.
        for_each(threads, below.as_mut().par_row_chunks_mut(CHUNK), |below| {
            solve_lower_triangular_in_place(diagonal, below.transpose_mut(), Par::Seq);
        });
        let mut right = right.split_at_row_mut(size).1;
        subtract_product(right.as_mut(), Accum::Add, below.as_ref(), threads);
        rest = right;
    }
    Ok(())
}

/// C ← C − LLᵀ on the lower trapezoid of C (height × width, width ≤ height), or −LLᵀ with
/// [`Accum::Replace`]; L has the height of C.
pub(super) fn subtract_product(
    c: MatMut<'_, f64>,
    accum: Accum,
    l: MatRef<'_, f64>,
    threads: Threads,
) {
    if c.ncols() == 0 || l.ncols() == 0 {
        return;
    }
    for_each(threads, c.par_col_chunks_mut(CHUNK).enumerate(), |(chunk, c)| {
        let (first, width) = (chunk * CHUNK, c.ncols());
        let (diagonal, below) = c.split_at_row_mut(first).1.split_at_row_mut(width);
        let (l, l_below) = l.split_at_row(first).1.split_at_row(width);
        triangular::matmul(
            diagonal,
            BlockStructure::TriangularLower,
            accum,
            l,
            BlockStructure::Rectangular,
            l.transpose(),
            BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
        matmul(below, accum, l_below, l.transpose(), -1.0, Par::Seq);
    });
}
