//! Numeric factorization: multifrontal (Duff and Reid 1983), on all cores.
//!
//! The front of a supernode is its panel, packed into the factor once it is eliminated, and the Schur
//! complement on the rows below, its *update matrix*, which the parent's front adds up. Subtrees of
//! the elimination forest are tasks of their own; the few large fronts above them are shared by all
//! threads, chunk by chunk.

use super::front;
use super::panel::{self, Threads};
use super::symbolic::{Piece, SymbolicCholesky};
use faer::{Accum, MatMut};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// The values of the factor, piece by piece, of a matrix whose `entries` are the blocks (each by rows) of the
/// analysed pattern. The error is the row of the matrix with a non-positive pivot.
///
/// Pieces have memory of their own: allocators give huge pages to blocks of less than some size (mimalloc:
/// a gigabyte), and a factor in small pages takes the kernel a third as long as us.
pub(super) fn factorize(
    symbolic: &SymbolicCholesky,
    entries: &[f64],
) -> Result<Vec<Vec<f64>>, usize> {
    let roots: Vec<usize> = (0..symbolic.supernodes().len())
        .filter(|&s| symbolic.supernodes()[s].parent.is_none())
        .collect();
    let values = symbolic.pieces().iter().map(|_| Mutex::default()).collect();
    let job = Job { symbolic, entries, values, buffers: Buffers::default() };
    let done: Vec<Result<Vec<f64>, usize>> =
        roots.into_par_iter().with_max_len(1).map(|root| job.eliminate(root)).collect();
    done.into_iter().try_for_each(|update| update.map(drop))?;
    let values = job.values.into_iter();
    Ok(values.map(|piece| piece.into_inner().unwrap_or_else(PoisonError::into_inner)).collect())
}

struct Job<'a> {
    symbolic: &'a SymbolicCholesky,
    entries: &'a [f64],
    /// Of each piece, once its task is done.
    values: Vec<Mutex<Vec<f64>>>,
    buffers: Buffers,
}

/// Memory that update matrices no longer need, by size: fresh pages cost more to come by than all
/// that is written to them (a third of the time for a cube of 59 000 vertices).
#[derive(Default)]
struct Buffers(Mutex<Vec<Vec<f64>>>);

impl Buffers {
    /// At least `length` numbers, of any value.
    fn take(&self, length: usize) -> Vec<f64> {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let fitting = waiting.partition_point(|buffer| buffer.len() < length);
        if fitting < waiting.len() {
            return waiting.remove(fitting);
        }
        drop(waiting);
        vec![0.0; length]
    }

    fn give(&self, buffer: Vec<f64>) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let at = waiting.partition_point(|other| other.len() < buffer.len());
        waiting.insert(at, buffer);
    }
}

impl Job<'_> {
    /// Eliminates a supernode after everything below it in the forest, branches side by side, and
    /// returns its update matrix, at the beginning of a buffer. Threads work depth first, so that few update matrices wait.
    fn eliminate(&self, supernode: usize) -> Result<Vec<f64>, usize> {
        let Job { symbolic, entries, values, buffers } = self;
        let index = symbolic.supernodes()[supernode].piece;
        let piece = &symbolic.pieces()[index];
        let keep = |panels: Vec<f64>| {
            *values[index].lock().unwrap_or_else(PoisonError::into_inner) = panels;
        };
        if piece.is_subtree {
            let mut panels = vec![0.0; symbolic.n_values_of(piece)];
            let update = self.eliminate_subtree(piece, &mut panels)?;
            keep(panels);
            return Ok(update);
        }
        let children = symbolic.children(supernode);
        let waiting: Vec<Result<Vec<f64>, usize>> = children
            .par_iter()
            .with_max_len(1)
            .map(|&child| self.eliminate(child as usize))
            .collect();
        let (area, panel_area) = (symbolic.update_area(supernode), symbolic.panel_area(supernode));
        let mut update = buffers.take(area);
        let mut columns = buffers.take(panel_area);
        let front = (&mut columns[..panel_area], &mut update[..area]);
        let mut front = Front::new(symbolic, supernode, front.0, front.1);
        front.add_entries(entries);
        for (&child, waiting) in children.iter().zip(waiting) {
            let (child, waiting) = (child as usize, waiting?);
            front.add_update(child, &waiting[..symbolic.update_area(child)]);
            buffers.give(waiting);
        }
        let mut packed = vec![0.0; symbolic.n_values_of(piece)];
        front.eliminate(&mut packed, Threads::All)?;
        keep(packed);
        buffers.give(columns);
        Ok(update)
    }

    /// Eliminates a whole subtree and returns the update matrix of its root. Update matrices in
    /// waiting lie on a stack: those of a supernode's children are its topmost.
    fn eliminate_subtree(&self, piece: &Piece, mut values: &mut [f64]) -> Result<Vec<f64>, usize> {
        let symbolic = self.symbolic;
        let below = |supernode: usize| -> usize {
            let children = symbolic.children(supernode).iter();
            children.map(|&child| symbolic.update_area(child as usize)).sum()
        };
        let (mut top, mut highest) = (0, 0);
        for supernode in piece.supernodes.clone() {
            let area = symbolic.update_area(supernode);
            highest = highest.max(top + area);
            top = top - below(supernode) + area;
        }
        let mut stack = self.buffers.take(highest);
        let widest = piece.supernodes.clone().map(|s| symbolic.panel_area(s)).max().unwrap_or(0);
        let mut columns = self.buffers.take(widest);
        let mut top = 0;
        for supernode in piece.supernodes.clone() {
            let (panel, rest) = values.split_at_mut(symbolic.supernodes()[supernode].values.len());
            values = rest;
            let area = symbolic.update_area(supernode);
            let base = top - below(supernode);
            let (waiting, update) = stack.split_at_mut(top);
            let columns = &mut columns[..symbolic.panel_area(supernode)];
            let mut front = Front::new(symbolic, supernode, columns, &mut update[..area]);
            front.add_entries(self.entries);
            let mut at = base;
            for &child in symbolic.children(supernode) {
                let next = at + symbolic.update_area(child as usize);
                front.add_update(child as usize, &waiting[at..next]);
                at = next;
            }
            front.eliminate(panel, Threads::One)?;
            stack.copy_within(top..top + area, base);
            top = base + area;
        }
        let mut update = self.buffers.take(top);
        update[..top].copy_from_slice(&stack[..top]);
        self.buffers.give(stack);
        self.buffers.give(columns);
        Ok(update)
    }
}

/// A supernode while it is assembled and eliminated.
struct Front<'a> {
    symbolic: &'a SymbolicCholesky,
    supernode: usize,
    /// Degrees of freedom of the columns and of the rows below.
    width: usize,
    depth: usize,
    /// (width + depth) × width, by columns.
    panel: &'a mut [f64],
    /// depth × depth, by columns; the lower triangle counts.
    update: &'a mut [f64],
}

impl<'a> Front<'a> {
    /// `panel` and `update` hold anything.
    fn new(
        symbolic: &'a SymbolicCholesky,
        supernode: usize,
        panel: &'a mut [f64],
        update: &'a mut [f64],
    ) -> Front<'a> {
        let (width, depth) = symbolic.width_and_depth(supernode);
        panel.fill(0.0);
        for column in 0..depth {
            update[column * (depth + 1)..][..depth - column].fill(0.0);
        }
        Front { symbolic, supernode, width, depth, panel, update }
    }

    /// Adds the entries of the matrix in this supernode's columns.
    fn add_entries(&mut self, entries: &[f64]) {
        let symbolic = self.symbolic;
        let (size, pattern) = (symbolic.size(), symbolic.pattern());
        let columns = symbolic.supernodes()[self.supernode].columns.clone();
        let rows = symbolic.rows(self.supernode);
        let height = self.width + self.depth;
        for column in columns.clone() {
            let vertex = symbolic.order()[column];
            for (entry, &neighbour) in pattern.range(vertex).zip(pattern.row(vertex)) {
                let row = symbolic.position()[neighbour as usize] as usize;
                let local = if row < column {
                    continue;
                } else if row < columns.end {
                    row - columns.start
                } else {
                    // Rows hold every neighbour after the columns.
                    columns.len() + rows.partition_point(|&other| (other as usize) < row)
                };
                let block = &entries[entry * size * size..][..size * size];
                for c in 0..size {
                    // Entry (row, column) of a symmetric matrix: block (column, row), transposed.
                    let to = (size * (column - columns.start) + c) * height + size * local;
                    let first = if row == column { c } else { 0 };
                    for r in first..size {
                        self.panel[to + r] += block[c * size + r];
                    }
                }
            }
        }
    }

    /// Adds the update matrix of a child.
    fn add_update(&mut self, child: usize, update: &[f64]) {
        let (symbolic, size) = (self.symbolic, self.symbolic.size());
        let depth = symbolic.width_and_depth(child).1;
        let (height, width) = (self.width + self.depth, self.width);
        let runs = self.runs(symbolic.rows(child));
        for (index, run) in runs.iter().enumerate() {
            for column in 0..run.length {
                let from = run.from + column;
                let to = run.to + column;
                let source = &update[from * depth..][..depth];
                let (target, offset) = if to < width {
                    (&mut self.panel[to * height..][..height], 0)
                } else {
                    (&mut self.update[(to - width) * self.depth..][..self.depth], width)
                };
                // From the diagonal down: the rest of this run, then whole runs.
                add(&mut target[to - offset..][..run.length - column], &source[from..]);
                for run in &runs[index + 1..] {
                    add(&mut target[run.to - offset..][..run.length], &source[run.from..]);
                }
            }
        }
        debug_assert_eq!(runs.iter().map(|run| run.length).sum::<usize>(), depth);
        debug_assert!(depth.is_multiple_of(size));
    }

    /// Where the rows of a child lie in this front, in degrees of freedom.
    fn runs(&self, child_rows: &[u32]) -> Vec<Run> {
        let size = self.symbolic.size();
        let columns = &self.symbolic.supernodes()[self.supernode].columns;
        let rows = self.symbolic.rows(self.supernode);
        let mut runs: Vec<Run> = Vec::new();
        let mut below = 0;
        for (index, &row) in child_rows.iter().enumerate() {
            let row = row as usize;
            let local = if row < columns.end {
                row - columns.start
            } else {
                while (rows[below] as usize) < row {
                    below += 1;
                }
                columns.len() + below
            };
            let (from, to) = (size * index, size * local);
            match runs.last_mut() {
                // A run does not cross from the columns into the rows below.
                Some(run) if run.to + run.length == to && to != self.width => run.length += size,
                _ => runs.push(Run { from, to, length: size }),
            }
        }
        runs
    }

    /// Factorizes the panel, keeps it in `packed` and subtracts its part from the update matrix.
    fn eliminate(self, packed: &mut [f64], threads: Threads) -> Result<(), usize> {
        let Front { symbolic, supernode, width, depth, panel: columns, update } = self;
        let mut panel = MatMut::from_column_major_slice_mut(columns, width + depth, width);
        front::factor_panel(panel.as_mut(), threads).map_err(|column| {
            let first = symbolic.supernodes()[supernode].columns.start;
            let size = symbolic.size();
            size * symbolic.order()[first + column / size] + column % size
        })?;
        let update = MatMut::from_column_major_slice_mut(update, depth, depth);
        let below = panel.as_ref().split_at_row(width).1;
        front::subtract_product(update, Accum::Add, below, threads);
        panel::pack(columns, width + depth, width, packed, threads);
        Ok(())
    }
}

/// Consecutive rows of a child's update matrix that are consecutive in the parent's front too.
struct Run {
    from: usize,
    to: usize,
    length: usize,
}

fn add(target: &mut [f64], source: &[f64]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t += s;
    }
}
