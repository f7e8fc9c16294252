//! Methods that choose cubature points: all minimise ‖Gw − b‖ over w ≥ 0 with few positive entries,
//! G having a column for each tet and b being the exact reduced forces at the training poses.

use super::nnls::{self, ActiveSet, LeastSquares};
use super::samples::{Samples, Sketch};
use super::{Rule, Selection, Training};
use crate::control::{self, Cancelled, Control, Stage};
use crate::linalg::{self, DenseError};
use faer::Mat;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Candidate tets for each point that may be chosen.
const CANDIDATES_PER_POINT: usize = 12;

/// Least number of candidates (or every tet of a small mesh).
const LEAST_CANDIDATES: usize = 600;

/// Most numbers in the columns of the candidates: half a gigabyte, whatever is asked for.
const MOST_NUMBERS: usize = 1 << 26;

/// Rows of the sketch for each point that may be chosen, and at least so many ([`Sketch`]).
const ROWS_PER_POINT: usize = 8;
const LEAST_ROWS: usize = 2000;

/// Points are grown to so many times the number wanted and pruned to it: 3 to 10 % less error than
/// greedy growth alone.
const OVERGROWTH: f64 = 1.5;

/// Most rounds of hard thresholding and of pricing all tets.
const MOST_ROUNDS: usize = 12;

/// Rounds that gain less than this go no further.
const LEAST_GAIN: f64 = 0.02;

/// Rows of the sketch whose singular vectors empirical cubature takes, for each point.
const SINGULAR_ROWS_PER_POINT: usize = 5;

/// A small dense decomposition failed, or the caller wanted no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum TrainingError {
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    #[error(transparent)]
    Dense(#[from] DenseError),
}

/// Tets and weights for `samples`; the weights still fit the sketch alone.
pub(super) fn select(
    samples: &Samples<'_>,
    training: &Training,
    control: &dyn Control,
) -> Result<Rule, TrainingError> {
    let rows = match training.selection {
        Selection::EmpiricalCubature => SINGULAR_ROWS_PER_POINT * training.n_points,
        _ => LEAST_ROWS.max(ROWS_PER_POINT * training.n_points),
    };
    let rows = rows.min(samples.n_equations());
    let sketch = Sketch::new(samples.n_equations(), rows, training.seed);
    let target = samples.target(&sketch);
    let most = MOST_NUMBERS / rows.max(1);
    let mut candidates = candidates(samples.model.corners().len(), training, most);
    let columns = samples.columns(&at_weight_one(&candidates), &sketch);
    control::check(control)?;
    control.progress(Stage::Cubature, 0.6);
    let entries = match training.selection {
        Selection::GreedyNnls => {
            greedy(&mut LeastSquares::new(columns, &target), training, control)?
        }
        Selection::NnHtp => {
            hard_thresholding(&mut LeastSquares::new(columns, &target), training, control)?
        }
        Selection::EmpiricalCubature => empirical(columns, &target, training, control)?,
        Selection::SparseNnls => {
            let start = Pool { candidates, columns };
            let (pool, entries) = priced(samples, &sketch, &target, start, training, control)?;
            candidates = pool.candidates;
            entries
        }
    };
    Ok(rule(&candidates, &entries))
}

/// A random subset of the tets, at most `most`, ascending.
fn candidates(n_tets: usize, training: &Training, most: usize) -> Vec<u32> {
    let mut all: Vec<u32> = (0..n_tets as u32).collect();
    all.shuffle(&mut ChaCha8Rng::seed_from_u64(training.seed));
    all.truncate((CANDIDATES_PER_POINT * training.n_points).max(LEAST_CANDIDATES).min(most));
    all.sort_unstable();
    all
}

fn rule(candidates: &[u32], entries: &[(usize, f64)]) -> Rule {
    let mut points: Vec<(u32, f64)> = entries.iter().map(|&(i, w)| (candidates[i], w)).collect();
    points.sort_unstable_by_key(|point| point.0);
    let (tets, weights) = points.into_iter().unzip();
    Rule::of_tets(tets, weights)
}

fn at_weight_one(tets: &[u32]) -> Rule {
    Rule::of_tets(tets.to_vec(), vec![1.0; tets.len()])
}

/// Greedy growth by Lawson–Hanson steps (An et al. 2008), then pruning.
fn greedy(
    problem: &mut LeastSquares,
    training: &Training,
    control: &dyn Control,
) -> Result<Vec<(usize, f64)>, Cancelled> {
    let mut set = ActiveSet::new(problem, &[]);
    let most = (OVERGROWTH * training.n_points as f64).ceil() as usize;
    set.grow(most, training.tolerance, control)?;
    set.prune(training.n_points, training.tolerance);
    Ok(set.entries())
}

/// Non-negative hard thresholding pursuit (von Tycowicz et al. 2013): a gradient step, the largest
/// entries kept, their least-squares problem solved, and again while it helps. Columns are scaled
/// to unit length; the step is the exact one along the largest entries of the gradient.
fn hard_thresholding(
    problem: &mut LeastSquares,
    training: &Training,
    control: &dyn Control,
) -> Result<Vec<(usize, f64)>, Cancelled> {
    let lengths = problem.lengths().to_vec();
    let unit = |j: usize| if lengths[j] > 0.0 { lengths[j].recip() } else { 0.0 };
    let largest = |by: &dyn Fn(usize) -> f64| -> Vec<usize> {
        let mut order: Vec<usize> = (0..lengths.len()).filter(|&j| by(j) > 0.0).collect();
        order.sort_unstable_by(|&a, &b| by(b).total_cmp(&by(a)).then(a.cmp(&b)));
        order.truncate(training.n_points);
        order
    };
    let mut best: (Vec<(usize, f64)>, f64) = (Vec::new(), 1.0);
    for _ in 0..MOST_ROUNDS {
        control::check(control)?;
        let gradient = problem.gradient(&best.0);
        let direction: Vec<(usize, f64)> = largest(&|j| gradient[j] * unit(j))
            .into_iter()
            .map(|j| (j, gradient[j] * unit(j).powi(2)))
            .collect();
        let response = problem.gram_times(&direction);
        let slope: f64 = direction.iter().map(|&(j, d)| d * gradient[j]).sum();
        let curvature: f64 = direction.iter().map(|&(j, d)| d * response[j]).sum();
        let step = if curvature > 0.0 { slope / curvature } else { break };
        let mut next: Vec<f64> = (0..lengths.len()).map(|j| step * gradient[j] * unit(j)).collect();
        best.0.iter().for_each(|&(j, x)| next[j] += x * lengths[j]);
        let start: Vec<(usize, f64)> =
            largest(&|j| next[j]).into_iter().map(|j| (j, next[j] * unit(j))).collect();
        let set = ActiveSet::new(problem, &start);
        let residual = set.relative_residual();
        if residual >= best.1 {
            break;
        }
        let done = residual > (1.0 - LEAST_GAIN) * best.1 || residual <= training.tolerance;
        best = (set.entries(), residual);
        if done {
            break;
        }
    }
    Ok(best.0)
}

/// Empirical cubature (Hernández, Caicedo and Ferrer 2017): instead of the forces themselves, the
/// orthonormal functions over the tets that span them are integrated, as many as there may be
/// points, by the same greedy growth.
fn empirical(
    columns: Mat<f64>,
    target: &[f64],
    training: &Training,
    control: &dyn Control,
) -> Result<Vec<(usize, f64)>, TrainingError> {
    let rows = columns.nrows();
    let gram = linalg::small_product(columns.as_ref(), columns.transpose());
    control::check(control)?;
    let (values, vectors) = linalg::symmetric_eigen(gram.as_ref())?;
    let count = training.n_points.min(rows);
    // G = WΣVᵀ: Vᵀ = Σ⁻¹WᵀG has the functions as rows, and integrals Σ⁻¹Wᵀb.
    let floor = 1e-14 * values.last().copied().unwrap_or(0.0);
    let kept: Vec<usize> = (rows - count..rows).filter(|&i| values[i] > floor).collect();
    let scaled =
        Mat::from_fn(rows, kept.len(), |i, j| vectors[(i, kept[j])] / values[kept[j]].sqrt());
    let functions = linalg::small_product(scaled.transpose(), columns.as_ref());
    let b = Mat::from_fn(rows, 1, |i, _| target[i]);
    let integrals = linalg::small_product(scaled.transpose(), b.as_ref());
    let mut problem = LeastSquares::new(functions, integrals.col_as_slice(0));
    let mut set = ActiveSet::new(&mut problem, &[]);
    set.grow(training.n_points, training.tolerance, control)?;
    Ok(set.entries())
}

struct Pool {
    candidates: Vec<u32>,
    columns: Mat<f64>,
}

/// Sparse NNLS over every tet (ECSW; Farhat et al. 2014), by pricing: the gradient at every tet is
/// computed without its column, the best tets join the pool, and greedy growth and pruning run on
/// the pool, until no round gains much.
fn priced(
    samples: &Samples<'_>,
    sketch: &Sketch,
    target: &[f64],
    start: Pool,
    training: &Training,
    control: &dyn Control,
) -> Result<(Pool, Vec<(usize, f64)>), Cancelled> {
    let mut pool = start;
    let mut best = (Vec::new(), 1.0);
    for _ in 0..MOST_ROUNDS {
        let mut problem = LeastSquares::new(pool.columns.clone(), target);
        let entries = greedy(&mut problem, training, control)?;
        let residual = ActiveSet::new(&mut problem, &entries).relative_residual();
        let done = residual > (1.0 - LEAST_GAIN) * best.1 || residual <= training.tolerance;
        if residual < best.1 {
            best = (entries, residual);
        }
        if done {
            break;
        }
        let left = samples.residual(&rule(&pool.candidates, &best.0));
        let gradient = samples.gradient(left.as_ref(), control)?;
        let mut joining: Vec<u32> =
            (0..gradient.len() as u32).filter(|&tet| gradient[tet as usize] > 0.0).collect();
        joining.retain(|tet| !pool.candidates.contains(tet));
        joining.sort_unstable_by(|&a, &b| {
            gradient[b as usize].total_cmp(&gradient[a as usize]).then(a.cmp(&b))
        });
        joining.truncate(2 * training.n_points);
        if joining.is_empty() {
            break;
        }
        let more = samples.columns(&at_weight_one(&joining), sketch);
        pool.columns = linalg::concatenate(&[pool.columns.as_ref(), more.as_ref()]);
        pool.candidates.extend(joining);
    }
    Ok((pool, best.0))
}

/// Weights for the points of `start` that fit every equation; some may fall to zero and leave.
pub(super) fn fit_weights(
    samples: &Samples<'_>,
    start: &Rule,
    control: &dyn Control,
) -> Result<Rule, Cancelled> {
    let (columns, target) = samples.equations(start);
    let guess: Vec<(usize, f64)> = start.weights.iter().copied().enumerate().collect();
    let mut problem = LeastSquares::new(columns, &target);
    let entries = nnls::solve(&mut problem, &guess, control)?;
    let kept = entries.iter().filter_map(|&(point, _)| start.smoothing.get(point).copied());
    Ok(Rule { smoothing: kept.collect(), ..rule(&start.tets, &entries) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assembly::FullModel;
    use crate::control::Uncontrolled;
    use crate::cubature::{EnergyNorm, train};
    use crate::dictionary::Combination;
    use crate::material::Material;
    use crate::testing::{Bar, Cell, Cut};

    #[test]
    fn every_method_finds_few_points_that_serve_poses_it_has_not_seen() {
        let bar =
            Bar { size_m: [0.2, 0.05, 0.05], n_cells: [8, 3, 3], cell: Cell::Six, cut: Cut::Whole }
                .mesh();
        let material = Material::stvk(5e5, 0.4, 1000.0).unwrap();
        let model = FullModel::new(bar.mesh.clone(), &[material], &bar.root);
        // Polynomials in the coordinates that vanish on the root: the linear forces of each are
        // smooth over the bar, so few points integrate them.
        let basis = Mat::from_fn(model.n(), 6, |row, column| {
            let x = bar.mesh.vertices()[model.free_vertices()[row / 3] as usize];
            let power = 1 + (column / 3) as i32;
            if row % 3 == column % 3 { (x[0] / 0.2).powi(power) } else { 0.0 }
        });
        let pattern = std::sync::Arc::new(model.pattern(&[]));
        let product = model.rest_stiffness(&pattern).multiply(basis.as_ref());
        let norm = EnergyNorm::new((basis.transpose() * &product).as_ref()).unwrap();
        let poses = |seed: usize, count: usize| {
            Mat::from_fn(6, count, |i, j| 0.02 * ((7 * i + 13 * (j + seed)) as f64).sin())
        };
        let basis = Combination::of_dense(basis);
        let samples = |q| Samples::new(&model, &basis, &norm, q, &Uncontrolled).unwrap();
        let (seen, unseen) = (samples(poses(0, 20)), samples(poses(100, 10)));
        for selection in [
            Selection::GreedyNnls,
            Selection::NnHtp,
            Selection::SparseNnls,
            Selection::EmpiricalCubature,
        ] {
            let training = Training { selection, n_points: 24, tolerance: 1e-3, seed: 3 };
            let rule = train(&seen, &training, &Uncontrolled).unwrap();
            assert!(rule.tets.len() <= 24 && rule.weights.iter().all(|w| *w > 0.0));
            assert!(rule.tets.is_sorted_by(|a, b| a < b), "{selection:?}");
            let error = unseen.error(&rule);
            assert!(error < 0.1, "{selection:?}: {error} with {} points", rule.tets.len());
            assert_eq!(rule, train(&seen, &training, &Uncontrolled).unwrap());
        }
        // With a generous tolerance fewer points do.
        let selection = Selection::GreedyNnls;
        let training = Training { selection, n_points: 24, tolerance: 0.4, seed: 3 };
        let rule = train(&seen, &training, &Uncontrolled).unwrap();
        assert!(rule.tets.len() < 12 && unseen.error(&rule) < 0.4, "{}", unseen.error(&rule));
    }
}
