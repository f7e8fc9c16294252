//! Supernodal triangular solves of a block of right-hand sides, on all cores.
//!
//! The block is held by rows in the permuted order, so that what a supernode adds to or reads from
//! the rows below it is contiguous. Subtrees of the elimination forest are solved side by side, then the branches above
//! them; what they owe to the rows above them is added up afterwards, in their order. Each block of columns
//! reads the factor twice, and that traffic bounds the time.
//!
//! A factor in single precision is read in half the time, and twice as many of its numbers fit into a register. Every
//! column is then solved scaled to about one, so that no range of numbers is left.
//!
//! Supernodes that the right-hand sides do not reach are skipped on the way down: a stitch reaches
//! a path to the root of the elimination tree, a few separators out of thousands of supernodes.

use super::panel::{self, Panel, Threads};
use super::symbolic::{Branch, Schedule, SymbolicCholesky};
use crate::lanes::kernels::{Real, Row};
use crate::lanes::{LANES, LaneBlock};
use crate::linalg;
use crate::pool::{Pooled, Tall};
use faer::{MatMut, MatRef};
use rayon::prelude::*;
use std::ops::Range;

/// What to do with a block of columns B. Between the triangles rows lie in the permuted order.
#[derive(Clone, Copy)]
pub(super) enum Task<'t> {
    /// B ← L⁻¹B.
    Forward,
    /// B ← L⁻ᵀB.
    Backward,
    /// B ← (LLᵀ)⁻¹B.
    Both,
    /// B ← L⁻ᵀ(X + R(X)) with X = L⁻¹B: R makes of some rows of X what to add to them.
    Corrected(&'t [u32], &'t Correction<'t>),
    /// B ← L⁻ᵀX, X having entries in these rows alone (rows × k).
    Spread(&'t [u32], MatRef<'t, f64>),
}

/// See [`Task::Corrected`].
pub(super) type Correction<'t> = dyn Fn(MatRef<'_, f64>) -> Tall + Sync + 't;

/// Does `task` to B (n×k), some columns at a time: as many as the widest row has while there are more, and then the rest.
pub(super) fn solve_in_place<T: Real>(
    symbolic: &SymbolicCholesky,
    values: &[Vec<T>],
    task: Task<'_>,
    b: MatMut<'_, f64>,
) {
    if b.nrows() == 0 {
        return;
    }
    assert_eq!(b.row_stride(), 1, "columns are contiguous");
    let (mut rest, mut first) = (b, 0);
    while rest.ncols() > 0 {
        let width = width_for::<T>(rest.ncols());
        let count = width.min(rest.ncols());
        let (some, after) = rest.split_at_col_mut(count);
        let task = match task {
            Task::Spread(rows, x) => Task::Spread(rows, x.subcols(first, count)),
            other => other,
        };
        match width {
            8 => solve_some::<T, 8>(symbolic, values, task, some),
            16 => solve_some::<T, 16>(symbolic, values, task, some),
            32 => solve_some::<T, 32>(symbolic, values, task, some),
            _ => solve_some::<T, 48>(symbolic, values, task, some),
        }
        (rest, first) = (after, first + count);
    }
}

/// [`solve_in_place`] of at most `N` columns.
fn solve_some<T: Real, const N: usize>(
    symbolic: &SymbolicCholesky,
    values: &[Vec<T>],
    task: Task<'_>,
    b: MatMut<'_, f64>,
) {
    with_rows(symbolic.n(), |x| {
        Solver::<T, N> { symbolic, values, x, within: None }.solve(task, b)
    });
}

/// Calls `f` with `n` rows of anything.
fn with_rows<T: Real, const N: usize>(n: usize, f: impl FnOnce(&mut [Row<T, N>])) {
    let mut memory = Pooled::take(n * size_of::<Row<T, N>>() / size_of::<f64>());
    f(bytemuck::cast_slice_mut::<f64, T>(memory.numbers()).as_chunks_mut().0);
}

/// The least width that takes `count` columns at once, or the widest.
fn width_for<T: Real>(count: usize) -> usize {
    let [narrow, wide, widest] = T::WIDTHS;
    if count <= narrow {
        narrow
    } else if count <= wide {
        wide
    } else {
        widest
    }
}

/// Overwrites eight vectors, whose rows are in the permuted order, by (LLᵀ)⁻¹ of them.
pub(super) fn solve_lanes(symbolic: &SymbolicCholesky, values: &[Vec<f64>], b: &mut LaneBlock) {
    let mut rows = b.take_rows();
    let mut solver = Solver { symbolic, values, x: &mut rows[..], within: None };
    solver.forward();
    solver.backward();
    *b = LaneBlock::of_rows(rows);
}

/// L⁻¹A of columns with few entries, each its row and value: which rows they reach, in the permuted order, and
/// those rows (rows reached × columns).
pub(super) fn forward_sparse<T: Real>(
    symbolic: &SymbolicCholesky,
    values: &[Vec<T>],
    columns: &[Vec<(usize, f64)>],
) -> (Vec<u32>, Tall) {
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
    let job = SparseJob { symbolic, values, columns, is_reached: &is_reached, rows: &rows };
    // A path has few branches that could be solved side by side, but there are other columns.
    let width = width_for::<T>(order.len().div_ceil(2));
    let solve = |some: &[usize]| match width {
        8 => job.solve::<8>(some),
        16 => job.solve::<16>(some),
        32 => job.solve::<32>(some),
        _ => job.solve::<48>(some),
    };
    let parts: Vec<Tall> = order.par_chunks(width).map(solve).collect();
    let mut place = vec![0; order.len()];
    order.iter().enumerate().for_each(|(at, &column)| place[column] = at);
    let mut half = Tall::for_a_while(rows.len(), columns.len());
    linalg::for_each_column(half.as_mut(), |j, column| {
        column.copy_from_slice(parts[place[j] / width].col_as_slice(place[j] % width));
    });
    (rows, half)
}

/// Columns with few entries and the rows that they reach.
struct SparseJob<'a, T> {
    symbolic: &'a SymbolicCholesky,
    values: &'a [Vec<T>],
    columns: &'a [Vec<(usize, f64)>],
    /// By supernodes.
    is_reached: &'a [bool],
    rows: &'a [u32],
}

impl<T: Real> SparseJob<'_, T> {
    /// The columns `chosen`, at most `N`.
    fn solve<const N: usize>(&self, chosen: &[usize]) -> Tall {
        let mut half = Tall::for_a_while(self.rows.len(), chosen.len());
        with_rows(self.symbolic.n(), |x| self.solve_in::<N>(x, chosen, half.as_mut()));
        half
    }

    fn solve_in<const N: usize>(
        &self,
        x: &mut [Row<T, N>],
        chosen: &[usize],
        half: MatMut<'_, f64>,
    ) {
        let SparseJob { symbolic, values, columns, is_reached, rows } = *self;
        let size = symbolic.size();
        for &row in rows {
            x[row as usize] = [T::default(); N];
        }
        let mut solver = Solver { symbolic, values, x, within: Some(is_reached) };
        let mut scales = [1.0; N];
        for ((lane, &column), scale) in chosen.iter().enumerate().zip(&mut scales) {
            *scale = scale_of::<T>(columns[column].iter().map(|entry| &entry.1));
            for &(row, value) in &columns[column] {
                let at = symbolic.position()[row / size] as usize;
                solver.x[size * at + row % size][lane] += T::nearest(value / *scale);
            }
        }
        solver.forward();
        let x = &*solver.x;
        let chunks = half.par_row_chunks_mut(ROWS_PER_TASK);
        chunks.zip(rows.par_chunks(ROWS_PER_TASK)).for_each(|(mut half, rows)| {
            for ((lane, half), scale) in half.as_mut().col_iter_mut().enumerate().zip(scales) {
                let values = rows.iter().map(|&row| scale * x[row as usize][lane].double());
                half.iter_mut().zip(values).for_each(|(h, v)| *h = v);
            }
        });
    }
}

struct Solver<'a, T, const N: usize> {
    symbolic: &'a SymbolicCholesky,
    values: &'a [Vec<T>],
    /// Right-hand sides, then solutions, by rows in permuted order; columns that are not there are
    /// zero.
    x: &'a mut [Row<T, N>],
    /// Supernodes that right-hand sides reach at most, where that is known; what `x` has at others then has no meaning.
    within: Option<&'a [bool]>,
}

/// Rows that right-hand sides reach of which one task reads or writes all columns: they stay in the first-level cache.
const ROWS_PER_TASK: usize = 128;

/// Vertices that one task copies: 32 columns of their rows are 18 KB, which stay in the first-level cache.
const VERTICES_PER_TASK: usize = 24;

impl<'a, T: Real, const N: usize> Solver<'a, T, N> {
    /// `b` has at most `N` columns.
    fn solve(&mut self, task: Task<'_>, b: MatMut<'_, f64>) {
        let symbolic = self.symbolic;
        let unmoved: Vec<usize> = match task {
            Task::Forward | Task::Backward => (0..symbolic.order().len()).collect(),
            _ => Vec::new(),
        };
        let scales;
        if let Task::Spread(rows, values) = task {
            scales = self::scales::<T, N>(values);
            self.clear();
            self.add(rows, values, &scales);
        } else {
            scales = self::scales::<T, N>(b.as_ref());
            let is_permuted = matches!(task, Task::Backward);
            self.gather(b.as_ref(), if is_permuted { &unmoved } else { symbolic.order() }, &scales);
            if !is_permuted {
                self.forward();
            }
        }
        match task {
            Task::Forward => {
                let unmoved: Vec<u32> = (0..unmoved.len() as u32).collect();
                return self.scatter(b, &unmoved, &scales);
            }
            Task::Corrected(rows, correction) if !rows.is_empty() => {
                let x = &*self.x;
                let mut some = Tall::for_a_while(rows.len(), b.ncols());
                let chunks = some.as_mut().par_row_chunks_mut(ROWS_PER_TASK);
                chunks.zip(rows.par_chunks(ROWS_PER_TASK)).for_each(|(some, rows)| {
                    for (lane, column) in some.col_iter_mut().enumerate() {
                        let values = rows.iter().map(|&row| x[row as usize][lane].double());
                        column.iter_mut().zip(values).for_each(|(s, v)| *s = scales[lane] * v);
                    }
                });
                self.add(rows, correction(some.as_ref()).as_ref(), &scales);
            }
            _ => {}
        }
        self.backward();
        self.scatter(b, symbolic.position(), &scales);
    }

    /// Whether right-hand sides have entries in these rows of a supernode.
    fn is_reached(&self, supernode: usize, rows: &[Row<T, N>]) -> bool {
        self.within.is_none_or(|within| within[supernode])
            && rows.iter().flatten().any(|value| *value != T::default())
    }

    fn clear(&mut self) {
        self.x.par_chunks_mut(1024).for_each(|x| x.fill([T::default(); N]));
    }

    /// Adds `values` (rows × k), over the scales, to some rows.
    fn add(&mut self, rows: &[u32], values: MatRef<'_, f64>, scales: &[f64; N]) {
        let factors = scales.map(f64::recip);
        for (chunk, rows) in rows.chunks(ROWS_PER_TASK).enumerate() {
            let values = values.subrows(chunk * ROWS_PER_TASK, rows.len());
            for ((lane, column), factor) in values.col_iter().enumerate().zip(factors) {
                for (&row, value) in rows.iter().zip(column.iter()) {
                    self.x[row as usize][lane] += T::nearest(factor * value);
                }
            }
        }
    }

    /// Column j of `b`, over `scales[j]`.
    fn gather(&mut self, b: MatRef<'_, f64>, order: &[usize], scales: &[f64; N]) {
        let size = self.symbolic.size();
        let factors = scales.map(f64::recip);
        let chunks = self.x.par_chunks_mut(VERTICES_PER_TASK * size);
        chunks.zip(order.par_chunks(VERTICES_PER_TASK)).for_each(|(x, order)| {
            if b.ncols() < N {
                x.fill([T::default(); N]);
            }
            for first in (0..b.ncols()).step_by(LANES) {
                let some = b.subcols(first, LANES.min(b.ncols() - first));
                let columns: Vec<&[f64]> = some
                    .col_iter()
                    .filter_map(|column| column.try_as_col_major())
                    .map(|column| column.as_slice())
                    .collect();
                let factors = &factors[first..];
                for (x, &vertex) in x.chunks_exact_mut(size).zip(order) {
                    for (axis, x) in x.iter_mut().enumerate() {
                        let row = size * vertex + axis;
                        match <&[&[f64]; LANES]>::try_from(&columns[..]) {
                            // A line at once instead of a number in every line: half the time.
                            Ok(columns) => {
                                let line: [T; LANES] = std::array::from_fn(|j| {
                                    T::nearest(factors[j] * columns[j][row])
                                });
                                x[first..][..LANES].copy_from_slice(&line);
                            }
                            Err(_) => {
                                let x = x[first..].iter_mut().zip(factors);
                                x.zip(&columns).for_each(|((x, factor), column)| {
                                    *x = T::nearest(factor * column[row]);
                                });
                            }
                        }
                    }
                }
            }
        });
    }

    fn scatter(&self, b: MatMut<'_, f64>, position: &[u32], scales: &[f64; N]) {
        let size = self.symbolic.size();
        let chunks = b.par_row_chunks_mut(VERTICES_PER_TASK * size);
        chunks.zip(position.par_chunks(VERTICES_PER_TASK)).for_each(|(b, position)| {
            // Rows of a vertex lie together: first all of them, then column by column.
            let mut rows = Vec::new();
            copy_rows(self.x, 0, position, &mut rows, size);
            for (j, column) in b.col_iter_mut().enumerate() {
                if let Some(column) = column.try_as_col_major_mut() {
                    let column = column.as_slice_mut().iter_mut();
                    column.zip(&rows).for_each(|(b, row)| *b = scales[j] * row[j].double());
                }
            }
        });
    }

    /// The branches of a stage with their rows of `x`.
    fn split<'x>(
        &self,
        stage: &'a [Branch],
        x: &'x mut [Row<T, N>],
    ) -> Vec<(&'a Branch, &'x mut [Row<T, N>])> {
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
    fn panel(&self, supernode: usize, first: usize) -> (Panel<'a, T>, Range<usize>) {
        let (width, depth) = self.symbolic.width_and_depth(supernode);
        let supernode = &self.symbolic.supernodes()[supernode];
        let start = (supernode.columns.start - first) * self.symbolic.size();
        let values = &self.values[supernode.piece];
        let panel = Panel::new(values, supernode.values.clone(), width + depth, width);
        (panel, start..start + width)
    }

    fn forward(&mut self) {
        let (symbolic, size) = (self.symbolic, self.symbolic.size());
        let x = std::mem::take(&mut self.x);
        let Schedule { stages, shared } = symbolic.schedule();
        for stage in stages {
            let owed: Vec<Option<Vec<Row<T, N>>>> = self
                .split(stage, x)
                .into_par_iter()
                .with_max_len(1)
                .map(|(branch, x)| self.forward_branch(branch, x))
                .collect();
            for (branch, owed) in stage.iter().zip(owed) {
                if let Some(owed) = owed {
                    add_rows(x, 0, symbolic.rows(branch.root()), &owed, size);
                }
            }
        }
        let mut below = Vec::new();
        for &s in shared {
            if !self.is_reached(s, &x[self.panel(s, 0).1]) {
                continue;
            }
            self.forward_supernode(s, 0, x, &mut below, Threads::All);
            add_rows(x, 0, symbolic.rows(s), &below, size);
        }
        self.x = x;
    }

    /// X ← L⁻¹X on the rows of one branch; returns what is to be added to the rows below its root,
    /// unless the right-hand sides do not reach it.
    fn forward_branch(&self, branch: &Branch, x: &mut [Row<T, N>]) -> Option<Vec<Row<T, N>>> {
        let (symbolic, size) = (self.symbolic, self.symbolic.size());
        let columns = branch.columns.clone();
        let root_rows = symbolic.rows(branch.root());
        let mut owed = None;
        let mut below = Vec::new();
        for &s in &branch.supernodes {
            if !self.is_reached(s, &x[self.panel(s, columns.start).1]) {
                continue;
            }
            let owed = owed.get_or_insert_with(|| vec![[T::default(); N]; root_rows.len() * size]);
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
        x: &mut [Row<T, N>],
        below: &mut Vec<Row<T, N>>,
        threads: Threads,
    ) {
        below.resize(self.symbolic.width_and_depth(s).1, [T::default(); N]);
        let (panel, rows) = self.panel(s, first);
        panel::solve_forward(panel, &mut x[rows], below, threads);
    }

    fn backward(&mut self) {
        let (symbolic, size) = (self.symbolic, self.symbolic.size());
        let x = std::mem::take(&mut self.x);
        let mut below = Vec::new();
        let Schedule { stages, shared } = symbolic.schedule();
        for &s in shared.iter().rev() {
            copy_rows(x, 0, symbolic.rows(s), &mut below, size);
            let (panel, rows) = self.panel(s, 0);
            panel::solve_backward(panel, &mut x[rows], &below, Threads::All);
        }
        for stage in stages.iter().rev() {
            // What lies above a branch is final: each takes a copy of the rows that it reads.
            let copied = |branch: &Branch| {
                let mut rows = Vec::new();
                copy_rows(x, 0, symbolic.rows(branch.root()), &mut rows, size);
                rows
            };
            let outer: Vec<Vec<Row<T, N>>> = stage.iter().map(copied).collect();
            let branches = self.split(stage, x).into_par_iter().zip(outer).with_max_len(1);
            branches.for_each(|((branch, x), outer)| self.backward_branch(branch, x, &outer));
        }
        self.x = x;
    }

    /// X ← L⁻ᵀX on the rows of one branch, given those below its root.
    fn backward_branch(&self, branch: &Branch, x: &mut [Row<T, N>], outer: &[Row<T, N>]) {
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

/// What the columns of `b` are solved over, 1 where there is none.
fn scales<T: Real, const N: usize>(b: MatRef<'_, f64>) -> [f64; N] {
    let mut scales = [1.0; N];
    if T::IS_NARROW {
        scales[..b.ncols()].par_iter_mut().enumerate().for_each(|(j, scale)| {
            *scale = scale_of::<T>(b.col(j).iter());
        });
    }
    scales
}

/// What to divide a right-hand side by so that `T` can hold it and its solution: a power of two, which rounds nothing.
fn scale_of<'v, T: Real>(values: impl Iterator<Item = &'v f64>) -> f64 {
    if !T::IS_NARROW {
        return 1.0;
    }
    let largest = values.fold(0.0f64, |largest, value| largest.max(value.abs()));
    if largest > 0.0 && largest.is_finite() { largest.log2().round().exp2() } else { 1.0 }
}

#[inline(always)]
fn add<T: Real, const N: usize>(to: &mut [Row<T, N>], from: &[Row<T, N>]) {
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *to += *from;
    }
}

/// Adds `size` rows to each vertex in `rows`; `x` starts at vertex `first`.
fn add_rows<T: Real, const N: usize>(
    x: &mut [Row<T, N>],
    first: usize,
    rows: &[u32],
    values: &[Row<T, N>],
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
fn copy_rows<T: Real, const N: usize>(
    x: &[Row<T, N>],
    first: usize,
    rows: &[u32],
    values: &mut Vec<Row<T, N>>,
    size: usize,
) {
    values.resize(size * rows.len(), [T::default(); N]);
    match size {
        3 => copy_vertices::<T, N, 3>(x, first, rows, values),
        _ => copy_vertices::<T, N, 1>(x, first, rows, values),
    }
}

/// The same for vertices of `SIZE` rows: a constant, so that no vertex costs a call.
fn copy_vertices<T: Real, const N: usize, const SIZE: usize>(
    x: &[Row<T, N>],
    first: usize,
    rows: &[u32],
    values: &mut [Row<T, N>],
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
