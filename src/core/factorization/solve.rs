//! Supernodal triangular solves of a block of right-hand sides, on all cores.
//!
//! The block is held by rows in the permuted order, so that what a supernode adds to or reads from
//! the rows below it is contiguous. Subtrees of the elimination forest are solved side by side; what
//! they owe to the rows above them is added up afterwards, in their order. One pass reads the factor
//! once whatever the number of columns, and few columns are bound by that traffic.
//!
//! Supernodes that the right-hand sides do not reach are skipped on the way down: a stitch reaches
//! a path to the root of the elimination tree, a few separators out of thousands of supernodes,
//! which makes the columns of 30 stitches 1.7 × cheaper.

use super::front::{self, Threads};
use super::symbolic::{Piece, SymbolicCholesky};
use faer::{MatMut, MatRef};
use rayon::prelude::*;

/// Columns solved at a time: with 31 million values in the factor, a column takes 40, 7.5, 5.6, 4.4 ms
/// of processor time among 1, 8, 16, 32; beyond, memory grows and speed does not.
const COLUMNS: usize = 48;

/// Overwrites B (n×k) by (LLᵀ)⁻¹B.
pub(super) fn solve_in_place(symbolic: &SymbolicCholesky, values: &[f64], mut b: MatMut<'_, f64>) {
    if b.nrows() == 0 {
        return;
    }
    for first in (0..b.ncols()).step_by(COLUMNS) {
        let k = COLUMNS.min(b.ncols() - first);
        let b = b.as_mut().subcols_mut(first, k);
        let mut solver = Solver { symbolic, values, k, x: vec![0.0; b.nrows() * k] };
        solver.gather(b.as_ref());
        solver.forward();
        solver.backward();
        solver.scatter(b);
    }
}

struct Solver<'a> {
    symbolic: &'a SymbolicCholesky,
    values: &'a [f64],
    k: usize,
    /// Right-hand sides, then solutions, by rows in permuted order.
    x: Vec<f64>,
}

/// Vertices that one task copies.
const VERTICES_PER_TASK: usize = 2048;

impl<'a> Solver<'a> {
    /// Numbers of one vertex in `x`.
    fn stride(&self) -> usize {
        self.symbolic.size() * self.k
    }

    fn gather(&mut self, b: MatRef<'_, f64>) {
        let (size, k) = (self.symbolic.size(), self.k);
        let chunks = self.x.par_chunks_mut(VERTICES_PER_TASK * size * k);
        chunks.zip(self.symbolic.order().par_chunks(VERTICES_PER_TASK)).for_each(|(x, order)| {
            for j in 0..k {
                let column = b.col(j);
                for (x, &vertex) in x.chunks_exact_mut(size * k).zip(order) {
                    for axis in 0..size {
                        x[axis * k + j] = column[size * vertex + axis];
                    }
                }
            }
        });
    }

    fn scatter(&self, mut b: MatMut<'_, f64>) {
        let (size, k) = (self.symbolic.size(), self.k);
        b.as_mut().par_col_chunks_mut(1).enumerate().for_each(|(j, column)| {
            let mut column = column.col_mut(0);
            for (x, &vertex) in self.x.chunks_exact(size * k).zip(self.symbolic.order()) {
                for axis in 0..size {
                    column[size * vertex + axis] = x[axis * k + j];
                }
            }
        });
    }

    /// The pieces with their rows of `x`, and the number of the first of these vertices.
    fn split<'x>(&self, x: &'x mut [f64]) -> Vec<(&'a Piece, &'x mut [f64])> {
        let stride = self.stride();
        let mut rest = x;
        self.symbolic
            .pieces()
            .iter()
            .map(|piece| {
                let count = self.symbolic.columns_of(piece).len() * stride;
                let (own, after) = std::mem::take(&mut rest).split_at_mut(count);
                rest = after;
                (piece, own)
            })
            .collect()
    }

    fn panel(&self, supernode: usize) -> MatRef<'a, f64> {
        let (width, depth) = self.symbolic.width_and_depth(supernode);
        let values = &self.values[self.symbolic.supernodes()[supernode].values.clone()];
        MatRef::from_column_major_slice(values, width + depth, width)
    }

    fn forward(&mut self) {
        let symbolic = self.symbolic;
        let mut x = std::mem::take(&mut self.x);
        let owed: Vec<Option<Vec<f64>>> = self
            .split(&mut x)
            .into_par_iter()
            .with_max_len(1)
            .map(|(piece, x)| if piece.is_subtree { self.forward_subtree(piece, x) } else { None })
            .collect();
        let stride = self.stride();
        for (piece, owed) in symbolic.pieces().iter().zip(owed) {
            if let Some(owed) = owed {
                let root = piece.supernodes.end - 1;
                subtract_rows(&mut x, 0, symbolic.rows(root), &owed, stride);
            }
        }
        let mut product = Vec::new();
        for piece in symbolic.pieces().iter().filter(|piece| !piece.is_subtree) {
            let s = piece.supernodes.start;
            self.forward_supernode(s, 0, &mut x, &mut product, Threads::All);
            subtract_rows(&mut x, 0, symbolic.rows(s), &product, stride);
        }
        self.x = x;
    }

    /// X ← L⁻¹X on the rows of one subtree; returns what is to be subtracted from the rows below its
    /// root, unless the right-hand sides do not reach it.
    fn forward_subtree(&self, piece: &Piece, x: &mut [f64]) -> Option<Vec<f64>> {
        let (symbolic, stride) = (self.symbolic, self.stride());
        let columns = symbolic.columns_of(piece);
        let root_rows = symbolic.rows(piece.supernodes.end - 1);
        let first = piece.supernodes.start;
        let mut reached: Vec<bool> = piece
            .supernodes
            .clone()
            .map(|s| {
                let own = &symbolic.supernodes()[s].columns;
                let rows = (own.start - columns.start) * stride..(own.end - columns.start) * stride;
                x[rows].iter().any(|value| *value != 0.0)
            })
            .collect();
        let mut owed = vec![0.0; root_rows.len() * stride];
        let mut product = Vec::new();
        for s in piece.supernodes.clone() {
            if !reached[s - first] {
                continue;
            }
            // The rest of the rows below belong to ancestors of the parent: reached through it.
            if let Some(parent) = symbolic.supernodes()[s].parent
                && let Some(parent) = reached.get_mut(parent - first)
            {
                *parent = true;
            }
            self.forward_supernode(s, columns.start, x, &mut product, Threads::One);
            let rows = symbolic.rows(s);
            let inside = rows.partition_point(|&row| (row as usize) < columns.end);
            let (own, outer) = product.split_at(inside * stride);
            subtract_rows(x, columns.start, &rows[..inside], own, stride);
            let mut at = 0;
            for (&row, product) in rows[inside..].iter().zip(outer.chunks_exact(stride)) {
                while root_rows[at] < row {
                    at += 1;
                }
                let owed = &mut owed[at * stride..][..stride];
                owed.iter_mut().zip(product).for_each(|(owed, product)| *owed += product);
            }
        }
        reached.last().copied().unwrap_or(false).then_some(owed)
    }

    /// Solves for the rows of a supernode and leaves L₂X in `product`; `x` starts at vertex `first`.
    fn forward_supernode(
        &self,
        s: usize,
        first: usize,
        x: &mut [f64],
        product: &mut Vec<f64>,
        threads: Threads,
    ) {
        let (width, depth) = self.symbolic.width_and_depth(s);
        product.resize(depth * self.k, 0.0);
        let start = (self.symbolic.supernodes()[s].columns.start - first) * self.stride();
        let x = MatMut::from_row_major_slice_mut(&mut x[start..][..width * self.k], width, self.k);
        let below = MatMut::from_row_major_slice_mut(product, depth, self.k);
        front::solve_forward(self.panel(s), x, below, threads);
    }

    fn backward(&mut self) {
        let symbolic = self.symbolic;
        let mut x = std::mem::take(&mut self.x);
        let stride = self.stride();
        let mut below = Vec::new();
        for piece in symbolic.pieces().iter().filter(|piece| !piece.is_subtree).rev() {
            let s = piece.supernodes.start;
            below.clear();
            gather_rows(&x, 0, symbolic.rows(s), &mut below, stride);
            self.backward_supernode(s, 0, &mut x, &below, Threads::All);
        }
        // What lies above a subtree is final: each takes a copy of the rows that it reads.
        let outer: Vec<Vec<f64>> = symbolic
            .pieces()
            .iter()
            .map(|piece| {
                let mut rows = Vec::new();
                if piece.is_subtree {
                    let root = piece.supernodes.end - 1;
                    gather_rows(&x, 0, symbolic.rows(root), &mut rows, stride);
                }
                rows
            })
            .collect();
        self.split(&mut x).into_par_iter().zip(outer).with_max_len(1).for_each(
            |((piece, x), outer)| {
                if piece.is_subtree {
                    self.backward_subtree(piece, x, &outer);
                }
            },
        );
        self.x = x;
    }

    /// X ← L⁻ᵀX on the rows of one subtree, given those below its root.
    fn backward_subtree(&self, piece: &Piece, x: &mut [f64], outer: &[f64]) {
        let (symbolic, stride) = (self.symbolic, self.stride());
        let columns = symbolic.columns_of(piece);
        let root_rows = symbolic.rows(piece.supernodes.end - 1);
        let mut below = Vec::new();
        for s in piece.supernodes.clone().rev() {
            let rows = symbolic.rows(s);
            let inside = rows.partition_point(|&row| (row as usize) < columns.end);
            below.clear();
            gather_rows(x, columns.start, &rows[..inside], &mut below, stride);
            let mut at = 0;
            for &row in &rows[inside..] {
                while root_rows[at] < row {
                    at += 1;
                }
                below.extend_from_slice(&outer[at * stride..][..stride]);
            }
            self.backward_supernode(s, columns.start, x, &below, Threads::One);
        }
    }

    fn backward_supernode(
        &self,
        s: usize,
        first: usize,
        x: &mut [f64],
        below: &[f64],
        threads: Threads,
    ) {
        let (width, depth) = self.symbolic.width_and_depth(s);
        let start = (self.symbolic.supernodes()[s].columns.start - first) * self.stride();
        let x = MatMut::from_row_major_slice_mut(&mut x[start..][..width * self.k], width, self.k);
        let below = MatRef::from_row_major_slice(below, depth, self.k);
        front::solve_backward(self.panel(s), x, below, threads);
    }
}

/// Subtracts one row of `values` from each vertex in `rows`; `x` starts at vertex `first`.
fn subtract_rows(x: &mut [f64], first: usize, rows: &[u32], values: &[f64], stride: usize) {
    for (&row, values) in rows.iter().zip(values.chunks_exact(stride)) {
        let x = &mut x[(row as usize - first) * stride..][..stride];
        x.iter_mut().zip(values).for_each(|(x, value)| *x -= value);
    }
}

/// Appends the values of each vertex in `rows`; `x` starts at vertex `first`.
fn gather_rows(x: &[f64], first: usize, rows: &[u32], values: &mut Vec<f64>, stride: usize) {
    for &row in rows {
        values.extend_from_slice(&x[(row as usize - first) * stride..][..stride]);
    }
}
