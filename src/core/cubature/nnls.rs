//! Non-negative least squares, min ‖Ax − b‖ with x ≥ 0, by Lawson–Hanson's active set in the
//! normal-equation form of Bro and de Jong (1997), with a limit on the number of positive entries:
//! then it is the greedy selection of An et al. (2008).
//!
//! A column entering or leaving the support extends or shrinks one Cholesky factor, and columns of
//! AᵀA are made when they are first needed, sixteen promising ones at a time.

use crate::control::{self, Cancelled, Control};
use crate::linalg;
use faer::{Mat, MatRef};
use rayon::prelude::*;

/// Columns of AᵀA made at a time.
const FETCH: usize = 16;

/// Candidates whose products with fetched columns one task computes.
const CANDIDATES_PER_TASK: usize = 256;

/// A column of which less than this part (squared) lies outside the support's span adds nothing.
const DEPENDENT: f64 = 1e-12;

/// Rounding of a residual relative to ‖b‖², and of a gradient relative to ‖a‖‖b‖.
const ROUNDING: f64 = 1e-12;

/// A least-squares problem in normal equations.
pub(super) struct LeastSquares {
    columns: Mat<f64>,
    /// Aᵀb.
    projection: Vec<f64>,
    /// bᵀb.
    norm_squared: f64,
    /// Lengths of the columns.
    lengths: Vec<f64>,
    /// Columns of AᵀA made so far.
    gram: Vec<Option<Vec<f64>>>,
}

impl LeastSquares {
    /// Columns of A (n×m) and b (n numbers).
    pub(super) fn new(columns: Mat<f64>, target: &[f64]) -> LeastSquares {
        let m = columns.ncols();
        let b = MatRef::from_column_major_slice(target, target.len(), 1);
        let projection = linalg::small_product(columns.transpose(), b).col_as_slice(0).to_vec();
        let lengths = (0..m).map(|j| columns.col(j).norm_l2()).collect();
        LeastSquares {
            projection,
            norm_squared: b.squared_norm_l2(),
            lengths,
            gram: vec![None; m],
            columns,
        }
    }

    /// Number of columns.
    pub(super) fn m(&self) -> usize {
        self.projection.len()
    }

    /// Lengths of the columns.
    pub(super) fn lengths(&self) -> &[f64] {
        &self.lengths
    }

    /// Makes the columns `wanted` of AᵀA.
    pub(super) fn fetch(&mut self, wanted: &[usize]) {
        let missing: Vec<usize> =
            wanted.iter().copied().filter(|&j| self.gram[j].is_none()).collect();
        let some = linalg::columns(self.columns.as_ref(), &missing);
        let starts: Vec<usize> = (0..self.m()).step_by(CANDIDATES_PER_TASK).collect();
        let parts: Vec<Mat<f64>> = starts
            .par_iter()
            .map(|&start| {
                let count = CANDIDATES_PER_TASK.min(self.m() - start);
                let rows = self.columns.subcols(start, count);
                linalg::small_product(rows.transpose(), some.as_ref())
            })
            .collect();
        for (k, j) in missing.into_iter().enumerate() {
            let column = parts.iter().flat_map(|part| part.col_as_slice(k)).copied().collect();
            self.gram[j] = Some(column);
        }
    }

    /// AᵀA·x; columns of positive entries are fetched.
    pub(super) fn gram_times(&mut self, entries: &[(usize, f64)]) -> Vec<f64> {
        self.fetch(&entries.iter().map(|e| e.0).collect::<Vec<_>>());
        let mut product = vec![0.0; self.m()];
        linalg::vectorized(
            #[inline(always)]
            || {
                for (j, x) in entries {
                    if let Some(column) = &self.gram[*j] {
                        for (p, g) in product.iter_mut().zip(column) {
                            *p += x * g;
                        }
                    }
                }
            },
        );
        product
    }

    /// Aᵀ(b − Ax).
    pub(super) fn gradient(&mut self, entries: &[(usize, f64)]) -> Vec<f64> {
        let product = self.gram_times(entries);
        self.projection.iter().zip(product).map(|(c, p)| c - p).collect()
    }

    /// An entry of AᵀA; zero if neither column was fetched.
    fn entry(&self, i: usize, j: usize) -> f64 {
        match (&self.gram[i], &self.gram[j]) {
            (Some(column), _) => column[j],
            (_, Some(column)) => column[i],
            _ => 0.0,
        }
    }
}

/// The rows of a lower triangular Cholesky factor.
#[derive(Clone, Default)]
struct Factor(Vec<Vec<f64>>);

impl Factor {
    /// Appends a column of AᵀA with its diagonal entry; false if it depends on those there.
    fn append(&mut self, column: &[f64], diagonal: f64) -> bool {
        let mut row: Vec<f64> = Vec::with_capacity(column.len() + 1);
        let mut rest = diagonal;
        for (l, c) in self.0.iter().zip(column) {
            let sum: f64 = l.iter().zip(&row).map(|(l, r)| l * r).sum();
            let entry = (c - sum) / l[row.len()];
            rest -= entry * entry;
            row.push(entry);
        }
        if rest.is_nan() || rest <= DEPENDENT * diagonal {
            return false;
        }
        row.push(rest.sqrt());
        self.0.push(row);
        true
    }

    /// Removes one row and column; rotations make the rest triangular again.
    fn remove(&mut self, at: usize) {
        self.0.remove(at);
        for i in at..self.0.len() {
            let [a, b] = [self.0[i][i], self.0[i][i + 1]];
            let length = a.hypot(b);
            let [c, s] = [a / length, b / length];
            for row in &mut self.0[i..] {
                let [x, y] = [row[i], row[i + 1]];
                row[i] = c * x + s * y;
                row[i + 1] = c * y - s * x;
            }
            self.0[i].truncate(i + 1);
        }
    }

    /// (LLᵀ)⁻¹b.
    fn solve(&self, b: &[f64]) -> Vec<f64> {
        let mut x: Vec<f64> = Vec::with_capacity(b.len());
        for (i, row) in self.0.iter().enumerate() {
            let sum: f64 = row.iter().zip(&x).map(|(l, x)| l * x).sum();
            x.push((b[i] - sum) / row[i]);
        }
        for (i, row) in self.0.iter().enumerate().rev() {
            x[i] /= row[i];
            let last = x[i];
            x[..i].iter_mut().zip(row).for_each(|(x, l)| *x -= l * last);
        }
        x
    }

    /// The diagonal of (LLᵀ)⁻¹.
    fn inverse_diagonal(&self) -> Vec<f64> {
        let k = self.0.len();
        let l = Mat::from_fn(k, k, |i, j| if j <= i { self.0[i][j] } else { 0.0 });
        let inverse = linalg::lower_inverse(l.as_ref());
        (0..k).map(|j| inverse.col(j).squared_norm_l2()).collect()
    }
}

/// A support, the least-squares solution on it, and the factor of its part of AᵀA.
pub(super) struct ActiveSet<'a> {
    problem: &'a mut LeastSquares,
    support: Vec<usize>,
    values: Vec<f64>,
    factor: Factor,
}

impl<'a> ActiveSet<'a> {
    /// Starts from a guess of some positive entries, or from none.
    pub(super) fn new(problem: &'a mut LeastSquares, start: &[(usize, f64)]) -> ActiveSet<'a> {
        problem.fetch(&start.iter().map(|e| e.0).collect::<Vec<_>>());
        let (support, values, factor) = (Vec::new(), Vec::new(), Factor::default());
        let mut set = ActiveSet { problem, support, values, factor };
        for &(column, value) in start {
            set.append(column, value);
        }
        set.settle();
        set
    }

    /// The positive entries, ascending.
    pub(super) fn entries(&self) -> Vec<(usize, f64)> {
        let mut entries: Vec<(usize, f64)> =
            self.support.iter().copied().zip(self.values.iter().copied()).collect();
        entries.sort_unstable_by_key(|e| e.0);
        entries
    }

    /// ‖Ax − b‖/‖b‖.
    pub(super) fn relative_residual(&self) -> f64 {
        let n = self.problem.norm_squared;
        if n > 0.0 { (self.residual_squared() / n).sqrt() } else { 0.0 }
    }

    /// ‖b‖² − xᵀAᵀb: what Pythagoras leaves, x being the solution on its support.
    fn residual_squared(&self) -> f64 {
        let gain: f64 = self
            .support
            .iter()
            .zip(&self.values)
            .map(|(&j, x)| x * self.problem.projection[j])
            .sum();
        (self.problem.norm_squared - gain).max(0.0)
    }

    /// Lets columns enter, each time the one whose gradient over its length is largest, until there
    /// are `most` or the relative residual is at most `tolerance`.
    pub(super) fn grow(
        &mut self,
        most: usize,
        tolerance: f64,
        control: &dyn Control,
    ) -> Result<(), Cancelled> {
        let mut banned = vec![false; self.problem.m()];
        let mut residual = self.residual_squared();
        let floor = ROUNDING * self.problem.norm_squared.sqrt();
        while self.support.len() < most && self.relative_residual() > tolerance {
            control::check(control)?;
            let entries: Vec<(usize, f64)> =
                self.support.iter().copied().zip(self.values.iter().copied()).collect();
            let gradient = self.problem.gradient(&entries);
            let mut inside = vec![false; gradient.len()];
            self.support.iter().for_each(|&j| inside[j] = true);
            let mut gains: Vec<(usize, f64)> = (0..gradient.len())
                .filter(|&j| !banned[j] && !inside[j] && self.problem.lengths[j] > 0.0)
                .map(|j| (j, gradient[j] / self.problem.lengths[j]))
                .filter(|(_, gain)| *gain > floor)
                .collect();
            let count = FETCH.min(gains.len());
            if count == 0 {
                break;
            }
            gains.select_nth_unstable_by(count - 1, |a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            gains.truncate(count);
            gains.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            let entering = gains[0].0;
            if self.problem.gram[entering].is_none() {
                self.problem.fetch(&gains.iter().map(|g| g.0).collect::<Vec<_>>());
            }
            if self.append(entering, 0.0) {
                self.settle();
            }
            let now = self.residual_squared();
            if now < residual - ROUNDING * residual {
                residual = now;
                banned.fill(false);
            } else {
                // Rounding: the column adds nothing that the support lacks.
                banned[entering] = true;
            }
        }
        Ok(())
    }

    /// Drops columns, those first whose loss adds least to the residual: until there are `most`, and
    /// then for as long as the relative residual stays within `tolerance`.
    pub(super) fn prune(&mut self, most: usize, tolerance: f64) {
        while self.support.len() > 1 {
            let excess = self.support.len().saturating_sub(most);
            if excess == 0 && self.relative_residual() > tolerance {
                break;
            }
            // Without column j the residual grows by x_j² / (AᵀA)⁻¹_jj.
            let diagonal = self.factor.inverse_diagonal();
            let mut loss: Vec<(usize, f64)> =
                (0..diagonal.len()).map(|i| (i, self.values[i].powi(2) / diagonal[i])).collect();
            loss.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
            // In steps, as losses change with every column that goes.
            loss.truncate(excess.div_ceil(4).max(1));
            let before = (excess == 0)
                .then(|| (self.support.clone(), self.values.clone(), self.factor.clone()));
            let mut leaving: Vec<usize> = loss.into_iter().map(|l| l.0).collect();
            leaving.sort_unstable();
            leaving.into_iter().rev().for_each(|at| self.remove(at));
            self.settle();
            if let Some((support, values, factor)) = before
                && self.relative_residual() > tolerance
            {
                (self.support, self.values, self.factor) = (support, values, factor);
                break;
            }
        }
    }

    fn append(&mut self, column: usize, value: f64) -> bool {
        let products: Vec<f64> =
            self.support.iter().map(|&j| self.problem.entry(j, column)).collect();
        let diagonal = self.problem.lengths[column].powi(2);
        let appended = self.factor.append(&products, diagonal);
        if appended {
            self.support.push(column);
            self.values.push(value);
        }
        appended
    }

    fn remove(&mut self, at: usize) {
        self.support.remove(at);
        self.values.remove(at);
        self.factor.remove(at);
    }

    /// Solves on the support, stepping back along the segment and dropping entries while any would
    /// be negative.
    fn settle(&mut self) {
        while !self.support.is_empty() {
            let b: Vec<f64> = self.support.iter().map(|&j| self.problem.projection[j]).collect();
            let solution = self.factor.solve(&b);
            if solution.iter().all(|s| *s > 0.0) {
                self.values = solution;
                return;
            }
            // The first entries to vanish on the way from the values to the solution.
            let way = |(x, s): (&f64, &f64)| if *s > 0.0 { f64::INFINITY } else { x / (x - s) };
            let ways: Vec<f64> = self
                .values
                .iter()
                .zip(&solution)
                .map(way)
                .map(|w| if w.is_nan() { 0.0 } else { w })
                .collect();
            let step = ways.iter().copied().fold(1.0, f64::min);
            self.values.iter_mut().zip(&solution).for_each(|(x, s)| *x += step * (s - *x));
            for at in (0..ways.len()).rev().filter(|&at| ways[at] <= step) {
                self.remove(at);
            }
        }
    }
}

/// The positive entries of min ‖Ax − b‖ with x ≥ 0, from a guess of some of them.
pub(super) fn solve(
    problem: &mut LeastSquares,
    start: &[(usize, f64)],
    control: &dyn Control,
) -> Result<Vec<(usize, f64)>, Cancelled> {
    let most = problem.m();
    let mut set = ActiveSet::new(problem, start);
    set.grow(most, 0.0, control)?;
    Ok(set.entries())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Uncontrolled;

    /// A (rows × columns) and b = Σ w_j a_j.
    fn problem(rows: usize, columns: usize, truth: &[(usize, f64)]) -> (Mat<f64>, Vec<f64>) {
        // A hash, not a sine: sines of sums have rank two.
        let a = Mat::from_fn(rows, columns, |i, j| {
            let mut h = ((i << 16 | j) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            h ^= h >> 32;
            (h >> 40) as f64 / (1u64 << 24) as f64 - 0.3
        });
        let b = (0..rows).map(|i| truth.iter().map(|&(j, w)| w * a[(i, j)]).sum()).collect();
        (a, b)
    }

    /// Eleven columns, one of them negative.
    const MANY: [(usize, f64); 11] = [
        (3, 2.0),
        (5, -0.2),
        (7, 0.3),
        (11, 0.5),
        (14, 1.1),
        (19, 0.9),
        (22, 0.7),
        (25, 1.25),
        (30, 0.8),
        (33, 0.6),
        (38, 0.4),
    ];

    fn residual(a: &Mat<f64>, b: &[f64], entries: &[(usize, f64)]) -> f64 {
        let sum = |i: usize| entries.iter().map(|&(j, x)| a[(i, j)] * x).sum::<f64>();
        (0..b.len()).map(|i| (b[i] - sum(i)).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn recovers_a_non_negative_combination() {
        let truth = [(3, 2.0), (11, 0.5), (25, 1.25)];
        let (a, b) = problem(60, 40, &truth);
        let found = solve(&mut LeastSquares::new(a, &b), &[], &Uncontrolled).unwrap();
        for (j, w) in truth {
            let at = found.iter().position(|e| e.0 == j).expect("in the support");
            assert!((found[at].1 - w).abs() < 1e-6, "{found:?}");
        }
        assert!(found.iter().all(|e| e.1 > 0.0));
    }

    #[test]
    fn meets_the_optimality_conditions_where_the_unconstrained_answer_is_negative() {
        let (a, b) = problem(60, 12, &[(1, 1.0), (5, -0.7), (9, 0.4)]);
        let all: Vec<(usize, f64)> = (0..12).map(|j| (j, 0.3)).collect();
        for start in [&[][..], &all[..]] {
            let mut problem = LeastSquares::new(a.clone(), &b);
            let found = solve(&mut problem, start, &Uncontrolled).unwrap();
            let gradient = problem.gradient(&found);
            for (j, gradient) in gradient.into_iter().enumerate() {
                let scale = 1e-9 * problem.norm_squared.sqrt() * problem.lengths[j];
                assert!(gradient <= scale, "entry {j} could grow: {gradient}");
                let inside = found.iter().any(|e| e.0 == j);
                assert!(!inside || gradient.abs() <= scale, "entry {j}: {gradient}");
            }
        }
    }

    #[test]
    fn the_residual_it_tells_is_the_residual_it_leaves() {
        let (a, b) = problem(60, 40, &MANY);
        let length = b.iter().map(|x| x * x).sum::<f64>().sqrt();
        let mut problem = LeastSquares::new(a.clone(), &b);
        let mut set = ActiveSet::new(&mut problem, &[]);
        let mut last = f64::INFINITY;
        for most in [1, 2, 5, 9] {
            set.grow(most, 0.0, &Uncontrolled).unwrap();
            assert!(set.entries().len() <= most);
            let left = residual(&a, &b, &set.entries()) / length;
            assert!((left - set.relative_residual()).abs() < 1e-9, "{left}");
            assert!(left < last);
            last = left;
        }
    }

    #[test]
    fn pruning_keeps_the_solution_on_what_is_left() {
        let (a, b) = problem(60, 40, &MANY);
        let mut problem = LeastSquares::new(a.clone(), &b);
        let mut set = ActiveSet::new(&mut problem, &[]);
        set.grow(20, 0.0, &Uncontrolled).unwrap();
        let full = set.relative_residual();
        set.prune(6, 0.0);
        assert!(set.entries().len() == 6 && set.relative_residual() > full);
        // The same support solved for on its own.
        let kept: Vec<usize> = set.entries().iter().map(|e| e.0).collect();
        let (entries, left) = (set.entries(), set.relative_residual());
        let mut small = LeastSquares::new(linalg::columns(a.as_ref(), &kept), &b);
        let again = solve(&mut small, &[], &Uncontrolled).unwrap();
        for ((_, x), (_, y)) in entries.iter().zip(&again) {
            assert!((x - y).abs() < 1e-9 * y, "{entries:?} {again:?}");
        }
        // Within a tolerance that is already exceeded nothing more may go.
        let mut problem = LeastSquares::new(a, &b);
        let mut set = ActiveSet::new(&mut problem, &entries);
        set.prune(6, 1.0001 * left);
        assert!(set.relative_residual() <= 1.0001 * left);
        set.prune(6, 0.5);
        assert!(set.relative_residual() <= 0.5 && set.entries().len() < 6);
    }
}
