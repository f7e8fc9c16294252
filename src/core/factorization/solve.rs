//! Supernodal triangular solves of a block of right-hand sides, on all cores.
//!
//! The block is held by rows in the permuted order, so that what a supernode adds to or reads from
//! the rows below it is contiguous. Subtrees of the elimination forest are solved side by side, then the branches above
//! them; what they owe to the rows above them is added up afterwards, in their order. Each block of columns
//! reads the factor twice, and that traffic bounds the time.
//!
//! Supernodes that the right-hand sides do not reach are skipped on the way down: a stitch reaches
//! a path to the root of the elimination tree, a few separators out of thousands of supernodes.

use super::panel::{self, Panel, Threads};
use super::symbolic::{Branch, Schedule, SymbolicCholesky};
use crate::lanes::kernels::Row;
use crate::lanes::{LANES, LaneBlock};
use crate::linalg;
use faer::{Mat, MatMut, MatRef};
use rayon::prelude::*;
use std::ops::Range;

/// Which of the two triangles to solve with. Between them rows lie in the permuted order.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Half {
    /// L⁻¹.
    Forward,
    /// L⁻ᵀ.
    Backward,
    /// Both.
    Both,
}

/// Overwrites B (n×k) by (LLᵀ)⁻¹B or half of that, at most 32 columns at a time.
pub(super) fn solve_in_place(
    symbolic: &SymbolicCholesky,
    values: &[Vec<f64>],
    half: Half,
    b: MatMut<'_, f64>,
) {
    if b.nrows() == 0 {
        return;
    }
    assert_eq!(b.row_stride(), 1, "columns are contiguous");
    let k = b.ncols();
    let wide = k - k % 32;
    let (wide, rest) = b.split_at_col_mut(if k - wide > 16 { k } else { wide });
    solve_columns::<32>(symbolic, values, half, wide);
    match rest.ncols() {
        0..=8 => solve_columns::<8>(symbolic, values, half, rest),
        _ => solve_columns::<16>(symbolic, values, half, rest),
    }
}

/// Overwrites eight vectors, whose rows are in the permuted order, by (LLᵀ)⁻¹ of them.
pub(super) fn solve_lanes(symbolic: &SymbolicCholesky, values: &[Vec<f64>], b: &mut LaneBlock) {
    let mut solver = Solver { symbolic, values, x: b.take_rows() };
    solver.forward();
    solver.backward();
    *b = LaneBlock::of_rows(solver.x);
}

/// [`solve_in_place`], `N` columns at a time.
fn solve_columns<const N: usize>(
    symbolic: &SymbolicCholesky,
    values: &[Vec<f64>],
    half: Half,
    mut b: MatMut<'_, f64>,
) {
    if b.ncols() == 0 {
        return;
    }
    let mut solver = Solver { symbolic, values, x: vec![[0.0; N]; symbolic.n()] };
    for first in (0..b.ncols()).step_by(N) {
        let count = N.min(b.ncols() - first);
        solver.solve(half, b.as_mut().subcols_mut(first, count));
    }
}

/// L⁻¹A of columns with few entries, each its row and value: which rows they reach, in the permuted order, and
/// those rows (rows reached × columns).
pub(super) fn forward_sparse(
    symbolic: &SymbolicCholesky,
    values: &[Vec<f64>],
    columns: &[Vec<(usize, f64)>],
) -> (Vec<u32>, Mat<f64>) {
    let size = symbolic.size();
    let position = |row: usize| symbolic.position()[row / size] as usize;
    let mut is_reached = vec![false; symbolic.supernodes().len()];
    for (row, _) in columns.iter().flatten() {
        let mut next = Some(symbolic.supernode_of(position(*row)));
        while let Some(s) = next.filter(|&s| !is_reached[s]) {
            is_reached[s] = true;
            next = symbolic.supernodes()[s].parent;
        }
    }
    let reached = symbolic.supernodes().iter().zip(&is_reached).filter(|(_, reached)| **reached);
    let rows: Vec<u32> = reached
        .flat_map(|(s, _)| size * s.columns.start..size * s.columns.end)
        .map(|row| row as u32)
        .collect();
    // Neighbours in the tree together: they share their paths.
    let mut order: Vec<usize> = (0..columns.len()).collect();
    order.sort_by_key(|&j| columns[j].iter().map(|entry| position(entry.0)).min());
    let mut half = Mat::zeros(rows.len(), columns.len());
    let (wide, rest) = order.split_at(order.len() - order.len() % 32);
    let job = SparseJob { symbolic, values, columns, rows: &rows };
    if rest.len() > 16 {
        job.solve::<32>(&order, &mut half);
    } else {
        job.solve::<32>(wide, &mut half);
        job.solve::<16>(rest, &mut half);
    }
    (rows, half)
}

/// Columns with few entries and the rows that they reach.
struct SparseJob<'a> {
    symbolic: &'a SymbolicCholesky,
    values: &'a [Vec<f64>],
    columns: &'a [Vec<(usize, f64)>],
    rows: &'a [u32],
}

impl SparseJob<'_> {
    /// The columns `chosen`, `N` at a time.
    fn solve<const N: usize>(&self, chosen: &[usize], half: &mut Mat<f64>) {
        if chosen.is_empty() {
            return;
        }
        let SparseJob { symbolic, values, columns, rows } = *self;
        let size = symbolic.size();
        let mut solver = Solver { symbolic, values, x: vec![[0.0; N]; symbolic.n()] };
        for chosen in chosen.chunks(N) {
            for &row in rows {
                solver.x[row as usize] = [0.0; N];
            }
            for (lane, &column) in chosen.iter().enumerate() {
                for &(row, value) in &columns[column] {
                    let at = symbolic.position()[row / size] as usize;
                    solver.x[size * at + row % size][lane] += value;
                }
            }
            solver.forward();
            let x = &solver.x;
            linalg::for_each_column(half.as_mut(), |column, half| {
                if let Some(lane) = chosen.iter().position(|&other| other == column) {
                    half.iter_mut().zip(rows).for_each(|(h, &row)| *h = x[row as usize][lane]);
                }
            });
        }
    }
}

struct Solver<'a, const N: usize> {
    symbolic: &'a SymbolicCholesky,
    values: &'a [Vec<f64>],
    /// Right-hand sides, then solutions, by rows in permuted order; columns that are not there are
    /// zero.
    x: Vec<Row<N>>,
}

/// Vertices that one task copies: 32 columns of their rows are 18 KB, which stay in the first-level cache.
const VERTICES_PER_TASK: usize = 24;

impl<'a, const N: usize> Solver<'a, N> {
    /// `b` has at most `N` columns.
    fn solve(&mut self, half: Half, b: MatMut<'_, f64>) {
        let symbolic = self.symbolic;
        let unmoved: Vec<usize> = match half {
            Half::Both => Vec::new(),
            _ => (0..symbolic.order().len()).collect(),
        };
        self.gather(b.as_ref(), if half == Half::Backward { &unmoved } else { symbolic.order() });
        if half != Half::Backward {
            self.forward();
        }
        if half == Half::Forward {
            let unmoved: Vec<u32> = (0..unmoved.len() as u32).collect();
            return self.scatter(b, &unmoved);
        }
        self.backward();
        self.scatter(b, symbolic.position());
    }

    fn gather(&mut self, b: MatRef<'_, f64>, order: &[usize]) {
        let size = self.symbolic.size();
        let chunks = self.x.par_chunks_mut(VERTICES_PER_TASK * size);
        chunks.zip(order.par_chunks(VERTICES_PER_TASK)).for_each(|(x, order)| {
            if b.ncols() < N {
                x.fill([0.0; N]);
            }
            for first in (0..b.ncols()).step_by(LANES) {
                let some = b.subcols(first, LANES.min(b.ncols() - first));
                let columns: Vec<&[f64]> = some
                    .col_iter()
                    .filter_map(|column| column.try_as_col_major())
                    .map(|column| column.as_slice())
                    .collect();
                for (x, &vertex) in x.chunks_exact_mut(size).zip(order) {
                    for (axis, x) in x.iter_mut().enumerate() {
                        let row = size * vertex + axis;
                        match <&[&[f64]; LANES]>::try_from(&columns[..]) {
                            // A line at once instead of a number in every line: half the time.
                            Ok(columns) => {
                                let line: [f64; LANES] = std::array::from_fn(|j| columns[j][row]);
                                x[first..][..LANES].copy_from_slice(&line);
                            }
                            Err(_) => {
                                let x = x[first..].iter_mut();
                                x.zip(&columns).for_each(|(x, column)| *x = column[row]);
                            }
                        }
                    }
                }
            }
        });
    }

    fn scatter(&self, b: MatMut<'_, f64>, position: &[u32]) {
        let size = self.symbolic.size();
        let chunks = b.par_row_chunks_mut(VERTICES_PER_TASK * size);
        chunks.zip(position.par_chunks(VERTICES_PER_TASK)).for_each(|(b, position)| {
            // Rows of a vertex lie together: first all of them, then column by column.
            let mut rows = Vec::new();
            copy_rows(&self.x, 0, position, &mut rows, size);
            for (j, column) in b.col_iter_mut().enumerate() {
                if let Some(column) = column.try_as_col_major_mut() {
                    let column = column.as_slice_mut().iter_mut();
                    column.zip(&rows).for_each(|(b, row)| *b = row[j]);
                }
            }
        });
    }

    /// The branches of a stage with their rows of `x`.
    fn split<'x>(
        &self,
        stage: &'a [Branch],
        x: &'x mut [Row<N>],
    ) -> Vec<(&'a Branch, &'x mut [Row<N>])> {
        let size = self.symbolic.size();
        let (mut rest, mut begin) = (x, 0);
        let own = |branch: &'a Branch| {
            let Range { start, end } = branch.columns;
            let (_, after) = std::mem::take(&mut rest).split_at_mut(size * (start - begin));
            let (own, after) = after.split_at_mut(size * (end - start));
            (rest, begin) = (after, end);
            (branch, own)
        };
        stage.iter().map(own).collect()
    }

    /// A supernode's panel, and where its rows lie in `x` that starts at vertex `first`.
    fn panel(&self, supernode: usize, first: usize) -> (Panel<'a>, Range<usize>) {
        let (width, depth) = self.symbolic.width_and_depth(supernode);
        let supernode = &self.symbolic.supernodes()[supernode];
        let start = (supernode.columns.start - first) * self.symbolic.size();
        let values = &self.values[supernode.piece];
        let panel = Panel::new(values, supernode.values.clone(), width + depth, width);
        (panel, start..start + width)
    }

    fn forward(&mut self) {
        let (symbolic, size) = (self.symbolic, self.symbolic.size());
        let mut x = std::mem::take(&mut self.x);
        let Schedule { stages, shared } = symbolic.schedule();
        for stage in stages {
            let owed: Vec<Option<Vec<Row<N>>>> = self
                .split(stage, &mut x)
                .into_par_iter()
                .with_max_len(1)
                .map(|(branch, x)| self.forward_branch(branch, x))
                .collect();
            for (branch, owed) in stage.iter().zip(owed) {
                if let Some(owed) = owed {
                    add_rows(&mut x, 0, symbolic.rows(branch.root()), &owed, size);
                }
            }
        }
        let mut below = Vec::new();
        for &s in shared {
            if !is_reached(&x[self.panel(s, 0).1]) {
                continue;
            }
            self.forward_supernode(s, 0, &mut x, &mut below, Threads::All);
            add_rows(&mut x, 0, symbolic.rows(s), &below, size);
        }
        self.x = x;
    }

    /// X ← L⁻¹X on the rows of one branch; returns what is to be added to the rows below its root,
    /// unless the right-hand sides do not reach it.
    fn forward_branch(&self, branch: &Branch, x: &mut [Row<N>]) -> Option<Vec<Row<N>>> {
        let (symbolic, size) = (self.symbolic, self.symbolic.size());
        let columns = branch.columns.clone();
        let root_rows = symbolic.rows(branch.root());
        let mut owed = None;
        let mut below = Vec::new();
        for &s in &branch.supernodes {
            if !is_reached(&x[self.panel(s, columns.start).1]) {
                continue;
            }
            let owed = owed.get_or_insert_with(|| vec![[0.0; N]; root_rows.len() * size]);
            self.forward_supernode(s, columns.start, x, &mut below, Threads::One);
            let rows = symbolic.rows(s);
            let inside = rows.partition_point(|&row| (row as usize) < columns.end);
            let (own, outer) = below.split_at(inside * size);
            add_rows(x, columns.start, &rows[..inside], own, size);
            linalg::vectorized(
                #[inline(always)]
                || {
                    let mut at = 0;
                    for (&row, outer) in rows[inside..].iter().zip(outer.chunks_exact(size)) {
                        while root_rows[at] < row {
                            at += 1;
                        }
                        add(&mut owed[at * size..][..size], outer);
                    }
                },
            );
        }
        owed
    }

    /// Solves for the rows of a supernode and leaves −L₂X in `below`; `x` starts at vertex `first`.
    fn forward_supernode(
        &self,
        s: usize,
        first: usize,
        x: &mut [Row<N>],
        below: &mut Vec<Row<N>>,
        threads: Threads,
    ) {
        below.resize(self.symbolic.width_and_depth(s).1, [0.0; N]);
        let (panel, rows) = self.panel(s, first);
        panel::solve_forward(panel, &mut x[rows], below, threads);
    }

    fn backward(&mut self) {
        let (symbolic, size) = (self.symbolic, self.symbolic.size());
        let mut x = std::mem::take(&mut self.x);
        let mut below = Vec::new();
        let Schedule { stages, shared } = symbolic.schedule();
        for &s in shared.iter().rev() {
            copy_rows(&x, 0, symbolic.rows(s), &mut below, size);
            let (panel, rows) = self.panel(s, 0);
            panel::solve_backward(panel, &mut x[rows], &below, Threads::All);
        }
        for stage in stages.iter().rev() {
            // What lies above a branch is final: each takes a copy of the rows that it reads.
            let copied = |branch: &Branch| {
                let mut rows = Vec::new();
                copy_rows(&x, 0, symbolic.rows(branch.root()), &mut rows, size);
                rows
            };
            let outer: Vec<Vec<Row<N>>> = stage.iter().map(copied).collect();
            let branches = self.split(stage, &mut x).into_par_iter().zip(outer).with_max_len(1);
            branches.for_each(|((branch, x), outer)| self.backward_branch(branch, x, &outer));
        }
        self.x = x;
    }

    /// X ← L⁻ᵀX on the rows of one branch, given those below its root.
    fn backward_branch(&self, branch: &Branch, x: &mut [Row<N>], outer: &[Row<N>]) {
        let (symbolic, size) = (self.symbolic, self.symbolic.size());
        let columns = branch.columns.clone();
        let root_rows = symbolic.rows(branch.root());
        let (mut below, mut outside, mut places) = (Vec::new(), Vec::new(), Vec::new());
        for &s in branch.supernodes.iter().rev() {
            let rows = symbolic.rows(s);
            let inside = rows.partition_point(|&row| (row as usize) < columns.end);
            copy_rows(x, columns.start, &rows[..inside], &mut below, size);
            let mut at = 0;
            places.clear();
            places.extend(rows[inside..].iter().map(|&row| {
                while root_rows[at] < row {
                    at += 1;
                }
                at as u32
            }));
            copy_rows(outer, 0, &places, &mut outside, size);
            below.extend_from_slice(&outside);
            let (panel, rows) = self.panel(s, columns.start);
            panel::solve_backward(panel, &mut x[rows], &below, Threads::One);
        }
    }
}

/// Whether right-hand sides have entries in these rows.
fn is_reached<const N: usize>(rows: &[Row<N>]) -> bool {
    rows.iter().flatten().any(|value| *value != 0.0)
}

#[inline(always)]
fn add<const N: usize>(to: &mut [Row<N>], from: &[Row<N>]) {
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *to += from;
    }
}

/// Adds `size` rows to each vertex in `rows`; `x` starts at vertex `first`.
fn add_rows<const N: usize>(
    x: &mut [Row<N>],
    first: usize,
    rows: &[u32],
    values: &[Row<N>],
    size: usize,
) {
    linalg::vectorized(
        #[inline(always)]
        || {
            for (&row, values) in rows.iter().zip(values.chunks_exact(size)) {
                add(&mut x[(row as usize - first) * size..][..size], values);
            }
        },
    );
}

/// The rows of each vertex in `rows`, in `values`; `x` starts at vertex `first`.
fn copy_rows<const N: usize>(
    x: &[Row<N>],
    first: usize,
    rows: &[u32],
    values: &mut Vec<Row<N>>,
    size: usize,
) {
    values.resize(size * rows.len(), [0.0; N]);
    match size {
        3 => copy_vertices::<N, 3>(x, first, rows, values),
        _ => copy_vertices::<N, 1>(x, first, rows, values),
    }
}

/// The same for vertices of `SIZE` rows: a constant, so that no vertex costs a call.
fn copy_vertices<const N: usize, const SIZE: usize>(
    x: &[Row<N>],
    first: usize,
    rows: &[u32],
    values: &mut [Row<N>],
) {
    let (x, values) = (x.as_chunks::<SIZE>().0, values.as_chunks_mut::<SIZE>().0);
    linalg::vectorized(
        #[inline(always)]
        || {
            for (value, &row) in values.iter_mut().zip(rows) {
                *value = x[row as usize - first];
            }
        },
    );
}
