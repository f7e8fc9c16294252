//! Symmetric sparse matrices over vertices, stored whole by rows: 3×3 blocks ([`BlockMatrix`])
//! on a pattern shared by stiffness and consistent mass ([`Pattern`]).

use crate::lanes::{self, LANES, LaneBlock, Lanes};
use crate::linalg;
use crate::pool::Pooled;
use faer::{Mat, MatMut, MatRef};
use rayon::prelude::*;
use std::sync::Arc;

/// Which vertices are coupled: sorted neighbours of each vertex, itself included.
#[derive(Debug, PartialEq, Eq)]
pub struct Pattern {
    row_start: Vec<usize>,
    columns: Vec<u32>,
}

/// The elements that touch each vertex.
#[derive(Debug)]
pub struct Incidence {
    start: Vec<u32>,
    elements: Vec<[u32; 2]>,
}

impl Incidence {
    /// For `n` vertices and elements with the given corners; corners ≥ n are skipped: vertices that are
    /// not free.
    pub fn new<'a, I>(n: usize, elements: I) -> Incidence
    where
        I: IntoIterator<Item = &'a [u32; 4]> + Clone,
    {
        let mut start = vec![0u32; n + 1];
        for &v in elements.clone().into_iter().flatten() {
            if (v as usize) < n {
                start[v as usize + 1] += 1;
            }
        }
        for v in 0..n {
            start[v + 1] += start[v];
        }
        let mut next = start.clone();
        let mut incident = vec![[0; 2]; start[n] as usize];
        for (element, corners) in (0..).zip(elements) {
            for (corner, &v) in (0..).zip(corners) {
                if (v as usize) < n {
                    let at = &mut next[v as usize];
                    incident[*at as usize] = [element, corner];
                    *at += 1;
                }
            }
        }
        Incidence { start, elements: incident }
    }

    /// Number of vertices.
    pub fn n(&self) -> usize {
        self.start.len() - 1
    }
    /// `[element, corner]` for each element that has `vertex` as a corner, ascending.
    pub fn of(&self, vertex: usize) -> &[[u32; 2]] {
        &self.elements[self.start[vertex] as usize..self.start[vertex + 1] as usize]
    }
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.start[..]) + size_of_val(&self.elements[..])
    }
}

impl Pattern {
    /// Couples the vertices of every element in `elements` and of every pair in `pairs`
    /// (entries ≥ n are skipped: vertices that are not free).
    pub fn new(n: usize, elements: &[[u32; 4]], pairs: &[[u32; 2]]) -> Pattern {
        Pattern::of_incidence(&Incidence::new(n, elements), |element| &elements[element], pairs)
    }

    /// The same from the incidence of the elements.
    pub fn of_incidence<'a>(
        incidence: &Incidence,
        corners: impl Fn(usize) -> &'a [u32; 4] + Sync,
        pairs: &[[u32; 2]],
    ) -> Pattern {
        let n = incidence.n();
        let mut paired: Vec<[u32; 2]> = pairs.iter().flat_map(|&[v, w]| [[v, w], [w, v]]).collect();
        paired.sort_unstable();
        let rows_of = |first: usize, seen_by: &mut Vec<u32>| {
            let mut columns = Vec::new();
            let mut lengths = Vec::with_capacity(ROWS_PER_TASK);
            for v in first..n.min(first + ROWS_PER_TASK) {
                let start = columns.len();
                let mut couple = |w: u32| {
                    if (w as usize) < n && seen_by[w as usize] != v as u32 {
                        seen_by[w as usize] = v as u32;
                        columns.push(w);
                    }
                };
                couple(v as u32);
                for &[element, _] in incidence.of(v) {
                    corners(element as usize).iter().for_each(|&w| couple(w));
                }
                let first_pair = paired.partition_point(|p| (p[0] as usize) < v);
                let of_row = paired[first_pair..].iter().take_while(|p| p[0] as usize == v);
                of_row.for_each(|p| couple(p[1]));
                columns[start..].sort_unstable();
                lengths.push(columns.len() - start);
            }
            (columns, lengths)
        };
        let tasks: Vec<(Vec<u32>, Vec<usize>)> = (0..n.div_ceil(ROWS_PER_TASK))
            .into_par_iter()
            .map_init(|| vec![u32::MAX; n], |seen_by, task| rows_of(task * ROWS_PER_TASK, seen_by))
            .collect();
        let mut row_start = Vec::with_capacity(n + 1);
        row_start.push(0);
        let mut columns = Vec::with_capacity(tasks.iter().map(|(columns, _)| columns.len()).sum());
        let mut end = 0;
        for (of_task, lengths) in tasks {
            columns.extend_from_slice(&of_task);
            row_start.extend(lengths.into_iter().map(|length| {
                end += length;
                end
            }));
        }
        Pattern { row_start, columns }
    }

    /// Number of vertices.
    pub fn n(&self) -> usize {
        self.row_start.len() - 1
    }
    /// Neighbours of `row`, ascending, itself included.
    pub fn row(&self, row: usize) -> &[u32] {
        &self.columns[self.range(row)]
    }
    /// Where the entries of `row` lie among all entries.
    pub fn range(&self, row: usize) -> std::ops::Range<usize> {
        self.row_start[row]..self.row_start[row + 1]
    }
    /// Number of entries.
    pub fn n_entries(&self) -> usize {
        self.columns.len()
    }
    /// Position of (row, column) among all entries, if present.
    pub fn find(&self, row: usize, column: u32) -> Option<usize> {
        self.row(row).binary_search(&column).ok().map(|at| self.row_start[row] + at)
    }
}

/// A symmetric matrix of 3×3 blocks (each by rows), n = 3·vertices.
#[derive(Clone, Debug)]
pub struct BlockMatrix {
    pattern: Arc<Pattern>,
    blocks: Vec<[f64; 9]>,
}

/// Rows that one task makes.
const ROWS_PER_TASK: usize = 512;

/// Vertices whose rows one task multiplies: they stay in the first-level cache until they are put where they belong.
const VERTICES_PER_TASK: usize = 128;

impl BlockMatrix {
    /// A matrix on `pattern` with the given blocks, one for each entry.
    pub fn new(pattern: Arc<Pattern>, blocks: Vec<[f64; 9]>) -> BlockMatrix {
        assert_eq!(pattern.n_entries(), blocks.len());
        BlockMatrix { pattern, blocks }
    }

    /// The pattern.
    pub fn pattern(&self) -> &Arc<Pattern> {
        &self.pattern
    }
    /// Rows of the matrix.
    pub fn n(&self) -> usize {
        3 * self.pattern.n()
    }
    /// One block for each entry of the pattern.
    pub fn blocks(&self) -> &[[f64; 9]] {
        &self.blocks
    }
    /// The blocks, to be changed.
    pub fn blocks_mut(&mut self) -> &mut [[f64; 9]] {
        &mut self.blocks
    }

    /// `A·X`, X being n×k.
    pub fn multiply(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        let mut y = Mat::zeros(self.n(), x.ncols());
        self.multiply_into(y.as_mut(), x);
        y
    }

    /// `Y ← A·X`, both being n×k.
    pub fn multiply_into(&self, y: MatMut<'_, f64>, x: MatRef<'_, f64>) {
        assert_eq!(x.nrows(), self.n());
        multiply_rows(
            x,
            y,
            #[inline(always)]
            |vertex, packed| self.row_times(vertex, packed),
        );
    }

    /// `XᵀAX` (n×k → k×k). Of 30 and 60 columns of 105 264 unknowns in 0.7 to 0.9 of the time that `AX` and the product of both
    /// take in memory that is there.
    pub fn gram(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        assert_eq!(x.nrows(), self.n());
        lanes::square_by(x, |rows, x, y| {
            linalg::vectorized(
                #[inline(always)]
                || {
                    for (y, vertex) in y.as_chunks_mut().0.iter_mut().zip(rows.start / 3..) {
                        *y = self.row_times(vertex, x);
                    }
                },
            );
        })
    }

    #[inline(always)]
    fn row_times(&self, vertex: usize, packed: &[Lanes]) -> [Lanes; 3] {
        let mut sum = [[0.0; LANES]; 3];
        for entry in self.pattern.range(vertex) {
            let block = &self.blocks[entry];
            let at = 3 * self.pattern.columns[entry] as usize;
            for (row, sum) in sum.iter_mut().enumerate() {
                for column in 0..3 {
                    let a = block[3 * row + column];
                    let x = &packed[at + column];
                    for lane in 0..LANES {
                        sum[lane] += a * x[lane];
                    }
                }
            }
        }
        sum
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.blocks[..]) + size_of_val(&self.pattern.columns[..])
    }
}

/// A symmetric matrix with one number an entry, acting alike on the three axes.
#[derive(Clone, Debug)]
pub struct ScalarMatrix {
    pattern: Arc<Pattern>,
    values: Vec<f64>,
}

impl ScalarMatrix {
    /// A matrix on `pattern` with the given values, one for each entry.
    pub fn new(pattern: Arc<Pattern>, values: Vec<f64>) -> ScalarMatrix {
        assert_eq!(pattern.n_entries(), values.len());
        ScalarMatrix { pattern, values }
    }
    /// The pattern.
    pub fn pattern(&self) -> &Arc<Pattern> {
        &self.pattern
    }
    /// One number for each entry of the pattern.
    pub fn values(&self) -> &[f64] {
        &self.values
    }
    /// `Y ← (A ⊗ I₃)·X`, both being 3·vertices × k.
    pub fn multiply_into(&self, y: MatMut<'_, f64>, x: MatRef<'_, f64>) {
        assert_eq!(x.nrows(), 3 * self.pattern.n());
        multiply_rows(
            x,
            y,
            #[inline(always)]
            |vertex, packed| self.row_times(vertex, packed),
        );
    }

    /// The matrix whose vertex `i` is vertex `order[i]` of this one, `position` being the inverse of `order`.
    pub fn permuted(&self, order: &[usize], position: &[u32]) -> ScalarMatrix {
        let mut row_start = vec![0];
        let mut row: Vec<(u32, f64)> = Vec::new();
        let (mut columns, mut values) = (Vec::new(), Vec::new());
        for &vertex in order {
            let neighbours = self.pattern.row(vertex).iter().map(|&w| position[w as usize]);
            row.extend(neighbours.zip(self.values[self.pattern.range(vertex)].iter().copied()));
            row.sort_unstable_by_key(|entry| entry.0);
            columns.extend(row.iter().map(|entry| entry.0));
            values.extend(row.drain(..).map(|entry| entry.1));
            row_start.push(columns.len());
        }
        ScalarMatrix { pattern: Arc::new(Pattern { row_start, columns }), values }
    }

    /// `Y ← (A ⊗ I₃)·X` of eight vectors.
    pub fn multiply_lanes(&self, y: &mut LaneBlock, x: &LaneBlock) {
        assert!(x.n() == 3 * self.pattern.n() && y.n() == x.n());
        let tasks = y.rows_mut().par_chunks_mut(3 * VERTICES_PER_TASK).enumerate();
        tasks.for_each(|(task, y)| {
            linalg::vectorized(
                #[inline(always)]
                || {
                    for (i, rows) in y.chunks_exact_mut(3).enumerate() {
                        rows.copy_from_slice(
                            &self.row_times(task * VERTICES_PER_TASK + i, x.rows()),
                        );
                    }
                },
            );
        });
    }

    #[inline(always)]
    fn row_times(&self, vertex: usize, packed: &[Lanes]) -> [Lanes; 3] {
        let mut sum = [[0.0; LANES]; 3];
        for entry in self.pattern.range(vertex) {
            let a = self.values[entry];
            let at = 3 * self.pattern.columns[entry] as usize;
            for (sum, x) in sum.iter_mut().zip(&packed[at..at + 3]) {
                for lane in 0..LANES {
                    sum[lane] += a * x[lane];
                }
            }
        }
        sum
    }
}

/// `Y ← A·X` from what `row_times` makes of the packed columns for the three rows of a vertex. Columns are packed by
/// eight, so that a row of A is read once for all of them.
#[inline(always)]
fn multiply_rows(
    x: MatRef<'_, f64>,
    mut y: MatMut<'_, f64>,
    row_times: impl Fn(usize, &[Lanes]) -> [Lanes; 3] + Sync,
) {
    assert_eq!((x.nrows(), x.ncols()), (y.nrows(), y.ncols()));
    let mut pooled = Pooled::take(LANES * x.nrows());
    let packed: &mut [Lanes] = pooled.numbers().as_chunks_mut().0;
    for first in (0..x.ncols()).step_by(LANES) {
        let n_lanes = LANES.min(x.ncols() - first);
        lanes::pack(x.subcols(first, n_lanes), packed);
        let packed = &*packed;
        let y = y.as_mut().subcols_mut(first, n_lanes);
        y.par_row_chunks_mut(3 * VERTICES_PER_TASK).enumerate().for_each(|(chunk, mut y)| {
            let mut rows = [[[0.0; LANES]; 3]; VERTICES_PER_TASK];
            let rows = &mut rows[..y.nrows() / 3];
            linalg::vectorized(
                #[inline(always)]
                || {
                    for (i, row) in rows.iter_mut().enumerate() {
                        *row = row_times(chunk * VERTICES_PER_TASK + i, packed);
                    }
                },
            );
            for (lane, column) in y.as_mut().col_iter_mut().enumerate() {
                let values = rows.as_flattened().iter().map(|row| row[lane]);
                column.iter_mut().zip(values).for_each(|(y, value)| *y = value);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multiply_agrees_with_the_dense_product() {
        let pattern = Arc::new(Pattern::new(5, &[[0, 1, 2, 3], [1, 2, 3, 4]], &[[0, 4], [9, 1]]));
        assert_eq!(pattern.row(0), [0, 1, 2, 3, 4]);
        assert_eq!(pattern.row(4), [0, 1, 2, 3, 4]);
        let blocks: Vec<[f64; 9]> = (0..pattern.n_entries())
            .map(|e| std::array::from_fn(|i| ((e * 9 + i) as f64).sin()))
            .collect();
        let a = BlockMatrix::new(pattern.clone(), blocks);
        let dense = Mat::from_fn(15, 15, |i, j| {
            pattern.find(i / 3, (j / 3) as u32).map_or(0.0, |e| a.blocks()[e][3 * (i % 3) + j % 3])
        });
        let x = Mat::from_fn(15, 11, |i, j| ((i * 11 + j) as f64).cos());
        let (fast, slow) = (a.multiply(x.as_ref()), &dense * &x);
        assert!((fast - slow).norm_max() < 1e-13);
        let symmetric = Mat::from_fn(15, 15, |i, j| 0.5 * (dense[(i, j)] + dense[(j, i)]));
        let blocks = (0..5).flat_map(|v| pattern.row(v).iter().map(move |&w| (v, w as usize)));
        let blocks = blocks
            .map(|(v, w)| std::array::from_fn(|i| symmetric[(3 * v + i / 3, 3 * w + i % 3)]))
            .collect();
        let a_symmetric = BlockMatrix::new(pattern.clone(), blocks);
        // One block, less than what is packed at a time, and more than twice that.
        for k in [5, 11, 77] {
            let x = Mat::from_fn(15, k, |i, j| ((i * 11 + j) as f64).cos());
            let gram = a_symmetric.gram(x.as_ref());
            assert!((gram - x.transpose() * &symmetric * &x).norm_max() < 1e-12, "{k}");
        }

        let values: Vec<f64> = (0..pattern.n_entries()).map(|e| (e as f64).cos()).collect();
        let a = ScalarMatrix::new(pattern.clone(), values);
        let entry = |i: usize, j: usize| pattern.find(i, j as u32).map_or(0.0, |e| a.values()[e]);
        let on_axis = |i: usize, j: usize| if i % 3 == j % 3 { entry(i / 3, j / 3) } else { 0.0 };
        let dense = Mat::from_fn(15, 15, on_axis);
        let mut fast = Mat::from_fn(15, 11, |_, _| f64::NAN);
        a.multiply_into(fast.as_mut(), x.as_ref());
        assert!((&fast - &dense * &x).norm_max() < 1e-13);
        let some = x.subcols(3, LANES);
        let (order, position) = ([3, 0, 4, 1, 2], [1u32, 3, 4, 0, 2]);
        let x = LaneBlock::of_columns(some).by_vertices(|i| order[i]);
        let mut y = LaneBlock::zeros(15);
        a.permuted(&order, &position).multiply_lanes(&mut y, &x);
        let mut lanes = Mat::zeros(15, LANES);
        y.by_vertices(|v| position[v] as usize).copy_to(lanes.as_mut());
        assert!((lanes - fast.subcols(3, LANES)).norm_max() < 1e-13);
    }
}
