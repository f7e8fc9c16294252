//! Symbolic analysis: what a factorization needs to know of a pattern, whatever the values.
//!
//! Everything is counted in *vertices*, of `size` degrees of freedom each: the analysis of the vertex
//! graph costs an eighth of that of the degrees of freedom and finds the same supernodes.

use super::FactorizationError;
use super::ordering::nested_dissection;
use super::panel;
use crate::assembly::sparse::Pattern;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::SymbolicSupernodalParams;
use faer::sparse::linalg::cholesky::{simplicial, supernodal};
use std::ops::Range;
use std::sync::Arc;

/// Two adjacent supernodes become one if together they have at most so many vertices and the share
/// of zeros stored for it stays below the second number.
const RELAXATION: &[(usize, f64)] = &[(4, 1.0), (16, 0.8), (48, 0.1), (usize::MAX, 0.05)];

/// Subtrees with at most this share of the floating-point operations are one task each; what lies
/// above them is worked through front by front, each with all threads. A constant, so that results
/// do not depend on the number of threads.
const SHARE_OF_A_TASK: f64 = 1.0 / 16.0;

/// The same for what solves work through on one thread above those tasks, so that threads wait for each other at few
/// fronts only: a solve of 8 columns takes 6 to 14 % less so, of 32 columns 3 to 6 %.
const SHARE_OF_A_BRANCH: f64 = 1.0 / 2.0;

/// Supernodes this far below a root begin a task whatever its size. Nested dissection leaves about
/// a dozen levels above the tasks; a graph that it cannot dissect must not exhaust the stack.
const MOST_LEVELS: usize = 64;

/// Columns of the factor with (nearly) the same rows below them.
#[derive(Debug)]
pub(super) struct Supernode {
    /// Vertex positions of the columns.
    pub(super) columns: Range<usize>,
    /// Where the vertex positions of the rows below lie in [`SymbolicCholesky::rows`].
    rows: Range<usize>,
    /// The piece that it belongs to, and where its panel, rows below included, lies among the values of
    /// that ([`panel::pack`]).
    pub(super) piece: usize,
    pub(super) values: Range<usize>,
    /// The supernode of its first row below.
    pub(super) parent: Option<usize>,
    children: Range<usize>,
}

/// Consecutive supernodes: a whole subtree of the elimination forest, or one supernode above such
/// subtrees.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub(super) supernodes: Range<usize>,
    pub(super) is_subtree: bool,
}

/// Supernodes of a subtree of the elimination forest that one thread solves with, one after the other.
#[derive(Debug)]
pub(super) struct Branch {
    /// Ascending; the last is the subtree's root.
    pub(super) supernodes: Vec<usize>,
    /// Vertex positions of the whole subtree's columns.
    pub(super) columns: Range<usize>,
}

impl Branch {
    /// The root of the subtree.
    pub(super) fn root(&self) -> usize {
        self.supernodes.last().copied().unwrap_or_default()
    }
}

/// How solves go through the forest, from the leaves.
#[derive(Debug)]
pub(super) struct Schedule {
    /// Branches that are independent of one another, ascending: whole subtrees, then what lies above those up to larger
    /// subtrees' roots.
    pub(super) stages: [Vec<Branch>; 2],
    /// What lies above, one after the other, each with all threads.
    pub(super) shared: Vec<usize>,
}

/// The structure of a Cholesky factor, to be shared by all matrices with one pattern.
#[derive(Debug)]
pub struct SymbolicCholesky {
    pattern: Arc<Pattern>,
    size: usize,
    /// Vertex at each position, and the position of each vertex.
    order: Vec<usize>,
    position: Vec<u32>,
    supernodes: Vec<Supernode>,
    rows: Vec<u32>,
    children: Vec<u32>,
    pieces: Vec<Piece>,
    schedule: Schedule,
    n_values: usize,
    n_flops: f64,
}

impl SymbolicCholesky {
    /// Analyses matrices with `size` × `size` blocks on `pattern`.
    pub fn new(pattern: Arc<Pattern>, size: usize) -> Result<SymbolicCholesky, FactorizationError> {
        let fill_reducing = nested_dissection(&pattern)?;
        let tree = elimination_tree(&pattern, &fill_reducing);
        // Subtrees must be contiguous.
        let order: Vec<usize> =
            postorder(&tree).into_iter().map(|position| fill_reducing[position]).collect();
        let structure = supernodal_structure(&pattern, &order)?;

        let n_supernodes = structure.n_supernodes();
        let mut supernode_of = vec![0u32; order.len()];
        for s in 0..n_supernodes {
            let columns = structure.supernode_begin()[s]..structure.supernode_end()[s];
            supernode_of[columns].fill(s as u32);
        }
        let mut supernodes: Vec<Supernode> = Vec::with_capacity(n_supernodes);
        let mut rows: Vec<u32> = Vec::with_capacity(structure.row_idx().len());
        let mut n_values = 0usize;
        for s in 0..n_supernodes {
            let columns = structure.supernode_begin()[s]..structure.supernode_end()[s];
            let first_row = rows.len();
            rows.extend(structure.supernode(s).pattern().iter().map(|&row| row as u32));
            let below = &rows[first_row..];
            // The whole rectangle has to be countable: it is made before it is packed.
            let end = (size * size)
                .checked_mul(columns.len())
                .and_then(|width| width.checked_mul(columns.len() + below.len()))
                .and_then(|panel| n_values.checked_add(panel))
                .map(|_| size * (columns.len() + below.len()))
                .map(|height| n_values + panel::n_packed(height, size * columns.len()))
                .ok_or(FactorizationError::TooLarge)?;
            supernodes.push(Supernode {
                parent: below.first().map(|&row| supernode_of[row as usize] as usize),
                columns,
                rows: first_row..rows.len(),
                piece: 0,
                values: n_values..end,
                children: 0..0,
            });
            n_values = end;
        }
        let children = gather_children(&mut supernodes);
        let (pieces, schedule, n_flops) = pieces(&supernodes, size);
        for (index, piece) in pieces.iter().enumerate() {
            let begin = supernodes[piece.supernodes.start].values.start;
            for supernode in &mut supernodes[piece.supernodes.clone()] {
                let Range { start, end } = supernode.values;
                (supernode.piece, supernode.values) = (index, start - begin..end - begin);
            }
        }
        let mut position = vec![0u32; order.len()];
        for (at, &vertex) in order.iter().enumerate() {
            position[vertex] = at as u32;
        }
        Ok(SymbolicCholesky {
            pattern,
            size,
            order,
            position,
            supernodes,
            rows,
            children,
            pieces,
            schedule,
            n_values,
            n_flops,
        })
    }

    /// Whether it belongs to matrices with `size` × `size` blocks on `pattern`.
    pub fn is_of(&self, pattern: &Arc<Pattern>, size: usize) -> bool {
        self.size == size && (Arc::ptr_eq(&self.pattern, pattern) || self.pattern == *pattern)
    }
    /// The pattern that was analysed.
    pub fn pattern(&self) -> &Arc<Pattern> {
        &self.pattern
    }
    /// Degrees of freedom of a vertex.
    pub fn size(&self) -> usize {
        self.size
    }
    /// Rows of the matrices.
    pub fn n(&self) -> usize {
        self.size * self.order.len()
    }
    /// Numbers stored for a factor, zeros of merged supernodes included.
    pub fn n_values(&self) -> usize {
        self.n_values
    }
    /// Floating-point operations of a factorization.
    pub fn n_flops(&self) -> f64 {
        self.n_flops
    }
    /// Vertex at each position of the factor.
    pub fn order(&self) -> &[usize] {
        &self.order
    }
    /// Position of each vertex.
    pub fn position(&self) -> &[u32] {
        &self.position
    }
    pub(super) fn supernodes(&self) -> &[Supernode] {
        &self.supernodes
    }
    /// The supernode with the column at a vertex position.
    pub(super) fn supernode_of(&self, position: usize) -> usize {
        self.supernodes.partition_point(|s| s.columns.end <= position)
    }
    /// Vertex positions of the rows below a supernode's columns, ascending.
    pub(super) fn rows(&self, supernode: usize) -> &[u32] {
        &self.rows[self.supernodes[supernode].rows.clone()]
    }
    pub(super) fn children(&self, supernode: usize) -> &[u32] {
        &self.children[self.supernodes[supernode].children.clone()]
    }
    /// All supernodes in order, cut into pieces.
    pub(super) fn pieces(&self) -> &[Piece] {
        &self.pieces
    }
    /// How solves go through them.
    pub(super) fn schedule(&self) -> &Schedule {
        &self.schedule
    }
    /// Numbers stored for a piece.
    pub(super) fn n_values_of(&self, piece: &Piece) -> usize {
        self.supernodes[piece.supernodes.end - 1].values.end
    }
    /// Numbers in the update matrix of a supernode.
    pub(super) fn update_area(&self, supernode: usize) -> usize {
        self.width_and_depth(supernode).1.pow(2)
    }
    /// Numbers in the panel of a supernode before it is packed.
    pub(super) fn panel_area(&self, supernode: usize) -> usize {
        let (width, depth) = self.width_and_depth(supernode);
        width * (width + depth)
    }
    /// Degrees of freedom in the columns and in the rows below of a supernode.
    pub(super) fn width_and_depth(&self, supernode: usize) -> (usize, usize) {
        let Supernode { columns, rows, .. } = &self.supernodes[supernode];
        (self.size * columns.len(), self.size * rows.len())
    }
}

/// The upper triangle of the permuted graph by columns: starts and rows.
fn upper_triangle(pattern: &Pattern, order: &[usize]) -> (Vec<usize>, Vec<usize>) {
    let mut position = vec![0usize; order.len()];
    for (at, &vertex) in order.iter().enumerate() {
        position[vertex] = at;
    }
    let mut start = Vec::with_capacity(order.len() + 1);
    start.push(0);
    let mut rows = Vec::with_capacity(pattern.n_entries() / 2 + order.len());
    for (at, &vertex) in order.iter().enumerate() {
        let first = rows.len();
        rows.extend(
            pattern.row(vertex).iter().map(|&w| position[w as usize]).filter(|&row| row <= at),
        );
        rows[first..].sort_unstable();
        start.push(rows.len());
    }
    (start, rows)
}

/// Parent of each position in the elimination forest (Liu's algorithm with path compression).
fn elimination_tree(pattern: &Pattern, order: &[usize]) -> Vec<Option<usize>> {
    let (start, rows) = upper_triangle(pattern, order);
    let mut parent = vec![None; order.len()];
    let mut ancestor: Vec<Option<usize>> = vec![None; order.len()];
    for column in 0..order.len() {
        for &row in &rows[start[column]..start[column + 1]] {
            let mut at = row;
            while at < column {
                let next = ancestor[at].replace(column);
                match next {
                    None => {
                        parent[at] = Some(column);
                        break;
                    }
                    Some(next) => at = next,
                }
            }
        }
    }
    parent
}

/// The positions in postorder: children before parents, subtrees contiguous.
fn postorder(parent: &[Option<usize>]) -> Vec<usize> {
    let n = parent.len();
    let mut first_child = vec![None; n];
    let mut next_sibling = vec![None; n];
    let mut roots = Vec::new();
    for v in (0..n).rev() {
        match parent[v] {
            None => roots.push(v),
            Some(p) => next_sibling[v] = first_child[p].replace(v),
        }
    }
    let mut order = Vec::with_capacity(n);
    let mut path = Vec::new();
    while let Some(root) = roots.pop() {
        path.push(root);
        while let Some(&v) = path.last() {
            match first_child[v].take() {
                Some(child) => path.push(child),
                None => {
                    path.pop();
                    order.push(v);
                    // The next child to descend into.
                    if let Some(p) = parent[v] {
                        first_child[p] = next_sibling[v];
                    }
                }
            }
        }
    }
    order
}

/// faer's supernodes of the permuted graph.
fn supernodal_structure(
    pattern: &Pattern,
    order: &[usize],
) -> Result<supernodal::SymbolicSupernodalCholesky<usize>, FactorizationError> {
    let n = order.len();
    let (start, rows) = upper_triangle(pattern, order);
    // Rows are sorted and in range, so that this cannot panic.
    let graph = SymbolicSparseColMatRef::new_checked(n, n, &start, None, &rows);
    let mut tree = vec![0isize; n];
    let mut column_counts = vec![0usize; n];
    let scratch = simplicial::prefactorize_symbolic_cholesky_scratch::<usize>(n, rows.len())
        .or(supernodal::factorize_supernodal_symbolic_cholesky_scratch::<usize>(n));
    let mut memory = MemBuffer::new(scratch);
    let tree = simplicial::prefactorize_symbolic_cholesky(
        &mut tree,
        &mut column_counts,
        graph,
        MemStack::new(&mut memory),
    );
    supernodal::factorize_supernodal_symbolic_cholesky(
        graph,
        tree,
        &column_counts,
        MemStack::new(&mut memory),
        SymbolicSupernodalParams { relax: Some(RELAXATION) },
    )
    .map_err(|_| FactorizationError::TooLarge)
}

/// Lists the children of every supernode, ascending.
fn gather_children(supernodes: &mut [Supernode]) -> Vec<u32> {
    let mut count = vec![0usize; supernodes.len()];
    for parent in supernodes.iter().filter_map(|s| s.parent) {
        count[parent] += 1;
    }
    let mut end = 0;
    for (supernode, count) in supernodes.iter_mut().zip(count) {
        supernode.children = end..end;
        end += count;
    }
    let mut children = vec![0; end];
    for s in 0..supernodes.len() {
        if let Some(parent) = supernodes[s].parent {
            let list = &mut supernodes[parent].children;
            children[list.end] = s as u32;
            list.end += 1;
        }
    }
    children
}

/// Cuts the forest into tasks for the numbers and into branches for solves; also counts the floating-point operations.
fn pieces(supernodes: &[Supernode], size: usize) -> (Vec<Piece>, Schedule, f64) {
    let mut first: Vec<usize> = (0..supernodes.len()).collect();
    let mut flops = vec![0.0f64; supernodes.len()];
    let mut total = 0.0;
    for (s, supernode) in supernodes.iter().enumerate() {
        let (w, b) = (size * supernode.columns.len(), size * supernode.rows.len());
        let (w, b) = (w as f64, b as f64);
        let own = w * (w * w / 3.0 + w * b + b * b);
        flops[s] += own;
        total += own;
        if let Some(parent) = supernode.parent {
            flops[parent] += flops[s];
            first[parent] = first[parent].min(first[s]);
        }
    }
    let mut level = vec![0; supernodes.len()];
    for s in (0..supernodes.len()).rev() {
        level[s] = supernodes[s].parent.map_or(0, |parent| level[parent] + 1);
    }
    let in_task = |s: usize| flops[s] <= SHARE_OF_A_TASK * total || level[s] >= MOST_LEVELS;
    let in_branch = |s: usize| flops[s] <= SHARE_OF_A_BRANCH * total;
    let branch = |root: usize, members: Vec<usize>| Branch {
        columns: supernodes[first[root]].columns.start..supernodes[root].columns.end,
        supernodes: members,
    };
    let mut pieces = Vec::new();
    let [mut subtrees, mut branches] = [const { Vec::new() }; 2];
    let (mut shared, mut above) = (Vec::new(), Vec::new());
    for (s, supernode) in supernodes.iter().enumerate() {
        if in_task(s) {
            if !supernode.parent.is_some_and(in_task) {
                pieces.push(Piece { supernodes: first[s]..s + 1, is_subtree: true });
                subtrees.push(branch(s, (first[s]..=s).collect()));
            }
            continue;
        }
        pieces.push(Piece { supernodes: s..s + 1, is_subtree: false });
        if !in_branch(s) {
            shared.push(s);
            continue;
        }
        above.push(s);
        if !supernode.parent.is_some_and(in_branch) {
            branches.push(branch(s, std::mem::take(&mut above)));
        }
    }
    (pieces, Schedule { stages: [subtrees, branches], shared }, total)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_postorder_keeps_subtrees_together() {
        // 0→3, 1→4, 2→3, 3→5, 4→5, 6 alone.
        let parent = [Some(3), Some(4), Some(3), Some(5), Some(5), None, None];
        assert_eq!(postorder(&parent), [0, 2, 3, 1, 4, 5, 6]);
    }

    #[test]
    fn pieces_cover_every_supernode_once() {
        let pairs: Vec<[u32; 2]> =
            (0..899).flat_map(|v| [[v, v + 1], [v, v + 30]]).filter(|pair| pair[1] < 900).collect();
        let pattern = Arc::new(Pattern::new(900, &[], &pairs));
        let symbolic = SymbolicCholesky::new(pattern, 3).unwrap();
        let mut next = 0;
        for piece in symbolic.pieces() {
            assert_eq!(piece.supernodes.start, next);
            next = piece.supernodes.end;
            let root = next - 1;
            for s in piece.supernodes.clone() {
                // Nothing inside a subtree has its parent outside.
                assert!(s == root || symbolic.supernodes()[s].parent.unwrap() < next);
            }
        }
        assert_eq!(next, symbolic.supernodes().len());
        assert!(symbolic.pieces().iter().filter(|p| p.is_subtree).count() > 4);
        assert!(symbolic.pieces().iter().any(|p| !p.is_subtree));

        // So do the stages of a solve; nothing that a branch reads lies in another one.
        let Schedule { stages, shared } = symbolic.schedule();
        let branches = stages.iter().flatten();
        let mut all: Vec<usize> = branches.flat_map(|b| b.supernodes.clone()).collect();
        all.extend(shared);
        all.sort_unstable();
        assert!(all.into_iter().eq(0..symbolic.supernodes().len()));
        assert!(stages.iter().all(|stage| stage.len() > 1) && !shared.is_empty());
        for stage in stages {
            assert!(stage.is_sorted_by(|a, b| a.columns.end <= b.columns.start));
            for branch in stage {
                let root = *branch.supernodes.last().unwrap();
                for &s in &branch.supernodes {
                    assert!(s == root || symbolic.supernodes()[s].parent.unwrap() <= root);
                }
            }
        }
    }
}
