//! Smoothed points: how much of its neighbours' strain each point takes ([`Smoothing`]) is fitted with the weights.
//!
//! A tet's strain is constant and differs from its neighbours' by the error of the mesh, so a point that stands for a
//! thousand tets need not have the strain of any one of them. Weight and twelve numbers a point are fitted to the same
//! poses as the weights before and half as many again, by damped Gauss–Newton steps (Levenberg–Marquardt) on the same
//! error. Evaluating the rule costs what it did.
//!
//! Held-out errors of 120 points and 60 columns, without and with it: 9.0 and 4.6 % on the stomach, 6.8 and 2.6 % on the
//! ball. What was tried instead, on the small stomach: candidates that have the mean of a tet and its neighbours beside
//! tets, 7.6 instead of 8.4 %; two weights a point, of λ and of μ, 8.1 %; a penalty on the size of what is fitted, no gain.

use super::samples::{Samples, Sketch};
use super::{Rule, TrainingError, selection};
use crate::assembly::patch::Patch;
use crate::control::{self, Control};
use crate::linalg::{self, SmallCholesky};
use crate::material::{Hyperelastic, Mat3, Mat9};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;

/// Gauss–Newton steps for each point, if these suffice. On the small stomach, fitted to 100 poses, the training error is 4.4, 3.7,
/// 2.7 and 2.5 % after the first four.
const ROUNDS: usize = 4;

/// Most of them. Held-out errors with all stitches closed, after four, and as long as a round gained 3 %: 5.25 and 4.82 %
/// on the ball, 5.04 and 4.84 % on the stomach; each takes 0.15 s there. As long as it gains half of that, the ball's come down by
/// up to 0.2 % more (of three trainings 4.74, 4.78, 5.31, then 4.65, 4.78, 5.12 %).
const MOST_ROUNDS: usize = 12;

/// A round that gains less than this is the last.
const LEAST_GAIN: f64 = 0.015;

/// Points whose step is found together: memory and time of one grow with their square. All 120 at once, three rounds came
/// to 4.5 % held-out error in 1.1 s, four rounds of 60 and 60 to 4.6 % in 0.8 s (stomach; 0.6 s since).
const POINTS_AT_A_TIME: usize = 60;

/// Most equations of a step; of more, random sums are taken ([`Sketch`]).
const MOST_EQUATIONS: usize = 1 << 14;

/// Levenberg–Marquardt damping, of the mean diagonal entry of JᵀJ. With 10 and 30 times as much the error after three rounds
/// was 1.1 and 1.2 times as large (small stomach and small ball, 40 points at a time).
const DAMPING: f64 = 3e-3;

/// Steps are halved until they lower the error, at most so many times.
const MOST_HALVINGS: i32 = 4;

/// Most that the logarithm of a weight changes in one step.
const MOST_WEIGHT_CHANGE: f64 = 1.0;

/// Columns of JᵀJ that one task makes.
const COLUMNS_PER_TASK: usize = 96;

/// Fits smoothing and weights of `rule` to `samples`, until the training error is at most `tolerance`; after some rounds
/// only as long as what was found does not suffice.
pub(super) fn smooth(
    samples: &Samples<'_>,
    mut rule: Rule,
    tolerance: f64,
    suffices: &dyn Fn(&Rule) -> bool,
    control: &dyn Control,
) -> Result<Rule, TrainingError> {
    let n_points = rule.tets.len();
    rule.smoothing.resize(n_points, Default::default());
    let mut residual = samples.residual(&rule);
    let error =
        |residual: &Mat<f64>| (residual.squared_norm_l2() / residual.ncols().max(1) as f64).sqrt();
    // Points of one block lie all over the body.
    let n_blocks = n_points.div_ceil(POINTS_AT_A_TIME);
    for round in 0..MOST_ROUNDS {
        if round == ROUNDS && suffices(&rule) {
            break;
        }
        let before = error(&residual);
        for first in 0..n_blocks {
            control::check(control)?;
            let block = (first..n_points).step_by(n_blocks);
            let block: Vec<Point> =
                block.map(|number| Point::new(samples, &rule, number)).collect();
            step(samples, &mut rule, &mut residual, &block, round as u64)?;
        }
        let after = error(&residual);
        if after <= tolerance || after > (1.0 - LEAST_GAIN) * before {
            break;
        }
    }
    Ok(selection::fit_weights(samples, &rule, control)?)
}

/// A point whose weight and smoothing are to change.
struct Point {
    /// Its number in the rule.
    number: usize,
    patch: Patch,
    /// The faces that have a neighbour.
    faces: Vec<usize>,
}

/// One damped Gauss–Newton step of weights and smoothing at the points `block` of `rule`, which leaves `residual` of the
/// target; none if it would not help.
fn step(
    samples: &Samples<'_>,
    rule: &mut Rule,
    residual: &mut Mat<f64>,
    block: &[Point],
    seed: u64,
) -> Result<(), TrainingError> {
    let sketch = Sketch::new(samples.n_equations(), MOST_EQUATIONS, seed);
    let mut target = vec![0.0; sketch.n_rows()];
    sketch.add(residual.as_ref(), &mut target);
    let n = block.iter().map(Point::n_columns).sum();
    let mut jacobian = Mat::<f32>::zeros(sketch.n_rows(), n);
    let (mut columns, mut rest) = (Vec::with_capacity(block.len()), jacobian.as_mut());
    for point in block {
        let (some, others) = rest.split_at_col_mut(point.n_columns());
        columns.push(some);
        rest = others;
    }
    let slopes: Vec<Vec<f64>> = block
        .par_iter()
        .zip(columns)
        .map(|(point, columns)| point.linearize(samples, rule, &sketch, &target, columns))
        .collect();
    let slopes = slopes.concat();
    let mut normal = lower_gram(jacobian.as_ref());
    let damping = DAMPING * (0..n).map(|i| normal[(i, i)]).sum::<f64>() / n.max(1) as f64;
    if damping <= 0.0 {
        return Ok(());
    }
    (0..n).for_each(|i| normal[(i, i)] += damping);
    let slopes = MatRef::from_column_major_slice(&slopes, n, 1);
    let change = SmallCholesky::new(normal.as_ref())?.solve(slopes);

    let sum = |rule: &Rule| -> Mat<f64> {
        let part = |point: &Point| {
            faer::Scale(rule.weights[point.number]) * samples.contribution(rule, point.number)
        };
        let parts: Vec<Mat<f64>> = block.par_iter().map(part).collect();
        let mut sum = Mat::zeros(residual.nrows(), residual.ncols());
        parts.iter().for_each(|part| sum += part);
        sum
    };
    let others = &*residual + sum(rule);
    let before = residual.squared_norm_l2();
    for halvings in 0..=MOST_HALVINGS {
        let length = 0.5f64.powi(halvings);
        let mut moved = rule.clone();
        let mut rest = change.col_as_slice(0);
        for point in block {
            let (own, others) = rest.split_at(point.n_columns());
            point.advance(&mut moved, own, length);
            rest = others;
        }
        let left = &others - sum(&moved);
        if left.squared_norm_l2() < before {
            (*rule, *residual) = (moved, left);
            break;
        }
    }
    Ok(())
}

impl Point {
    fn new(samples: &Samples<'_>, rule: &Rule, number: usize) -> Point {
        let patch = Patch::new(samples.model, rule.tets[number] as usize);
        let faces = (0..4).filter(|&face| patch.has_neighbour[face]).collect();
        Point { number, patch, faces }
    }

    /// Unknowns: the logarithm of the weight, then what the point takes of the jump across each face, three a face.
    fn n_columns(&self) -> usize {
        1 + 3 * self.faces.len()
    }

    /// Moves the point by `length` times `change` of its unknowns.
    fn advance(&self, rule: &mut Rule, change: &[f64], length: f64) {
        let of_weight = (length * change[0]).clamp(-MOST_WEIGHT_CHANGE, MOST_WEIGHT_CHANGE);
        rule.weights[self.number] *= of_weight.exp();
        for (&face, change) in self.faces.iter().zip(change[1..].chunks_exact(3)) {
            let smoothing = &mut rule.smoothing[self.number][face];
            smoothing.iter_mut().zip(change).for_each(|(s, c)| *s += length * c);
        }
    }

    /// The derivatives of the point's weighted contribution, sketched, a column an unknown; and their products with
    /// `target`.
    fn linearize(
        &self,
        samples: &Samples<'_>,
        rule: &Rule,
        sketch: &Sketch,
        target: &[f64],
        mut columns: MatMut<'_, f32>,
    ) -> Vec<f64> {
        let tet = rule.tets[self.number] as usize;
        let weight = rule.weights[self.number];
        let t = samples.q.ncols();
        let gradient = samples.gradient_at(rule, self.number);
        let jumps = self.patch.jumps(samples.basis.rows(&self.patch.dofs).as_ref());
        let at_poses =
            |fields: &Mat<f64>| linalg::small_product(fields.as_ref(), samples.q.as_ref());
        let in_norm =
            |fields: &Mat<f64>| linalg::small_product(fields.as_ref(), samples.norm.coefficients());
        let (d, jump_at_poses) = (at_poses(&gradient), at_poses(&jumps));
        let p = samples.stresses(tet, d.as_ref());
        let (gradient, jumps) = (in_norm(&gradient), in_norm(&jumps));
        let elasticity = &samples.model.elasticities()[tet];
        let tangents: Vec<Mat9> = (0..t)
            .map(|pose| {
                let d = Mat3::from_row_slice(d.col_as_slice(pose));
                let scale = weight * samples.model.volumes_m3()[tet] * samples.scale[pose];
                elasticity.stress_derivative(&d).map(|row| row.map(|x| x * scale))
            })
            .collect();
        let mut slopes = Vec::with_capacity(self.n_columns());
        let mut column = vec![0.0; sketch.n_rows()];
        let mut put = |equations: Mat<f64>| {
            column.fill(0.0);
            sketch.add(equations.as_ref(), &mut column);
            let to = columns.as_mut().col_mut(slopes.len()).iter_mut();
            to.zip(&column).for_each(|(to, x)| *to = *x as f32);
            slopes.push(column.iter().zip(target).map(|(x, b)| x * b).sum());
        };
        put(faer::Scale(weight) * linalg::small_product(gradient.transpose(), p.as_ref()));
        for &face in &self.faces {
            // Cᵀ(GᵀdP + dGᵀP), dG and with it ∇u changing by the jump ⊗ an axis.
            let of_jump = jumps.subrows(3 * face, 3);
            let fields = linalg::stacked(&[gradient.as_ref(), of_jump]);
            for axis in 0..3 {
                let changed = |row: usize, pose: usize| {
                    let jump = |i: usize| jump_at_poses[(3 * face + i, pose)];
                    (0..3).map(|i| tangents[pose][row][3 * i + axis] * jump(i)).sum()
                };
                let stresses = Mat::from_fn(12, t, |row, pose| match row.checked_sub(9) {
                    None => changed(row, pose),
                    Some(i) => weight * p[(3 * i + axis, pose)],
                });
                put(linalg::small_product(fields.transpose(), stresses.as_ref()));
            }
        }
        slopes
    }
}

/// The lower triangle of JᵀJ. In single precision, twice as fast: it only steers the step, and its damping is far above
/// its rounding.
fn lower_gram(j: MatRef<'_, f32>) -> Mat<f64> {
    let n = j.ncols();
    let parts: Vec<Mat<f32>> = (0..n.div_ceil(COLUMNS_PER_TASK))
        .into_par_iter()
        .map(|task| {
            let first = COLUMNS_PER_TASK * task;
            let some = j.subcols(first, COLUMNS_PER_TASK.min(n - first));
            let below = j.subcols(first, n - first);
            let mut part = Mat::zeros(below.ncols(), some.ncols());
            matmul(part.as_mut(), Accum::Replace, below.transpose(), some, 1.0, Par::Seq);
            part
        })
        .collect();
    Mat::from_fn(n, n, |i, j| {
        let (task, column) = (j / COLUMNS_PER_TASK, j % COLUMNS_PER_TASK);
        match i.checked_sub(COLUMNS_PER_TASK * task) {
            Some(row) if i >= j => f64::from(parts[task][(row, column)]),
            _ => 0.0,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assembly::FullModel;
    use crate::control::Uncontrolled;
    use crate::cubature::EnergyNorm;
    use crate::dictionary::Combination;
    use crate::material::{Law, Material};
    use crate::testing::{Bar, Cell, Cut};
    use std::sync::Arc;

    /// What `examine` makes of the poses of a bar in a rough basis, the root held.
    fn with_samples<T>(law: Law, examine: impl FnOnce(&Samples<'_>) -> T) -> T {
        let bar =
            Bar { size_m: [0.2, 0.05, 0.05], n_cells: [6, 2, 2], cell: Cell::Six, cut: Cut::Whole }
                .mesh();
        let material = Material::new(law, 5e5, 0.3, 1000.0).unwrap();
        let model = FullModel::new(bar.mesh.clone(), &[material], &bar.root);
        let basis = Mat::from_fn(model.n(), 6, |row, column| {
            let x = bar.mesh.vertices()[model.free_vertices()[row / 3] as usize];
            let power = 1 + (column / 3) as i32;
            let smooth = if row % 3 == column % 3 { (x[0] / 0.2).powi(power) } else { 0.0 };
            smooth + 0.02 * ((3 * row + 7 * column * row) as f64).sin()
        });
        let product = model.rest_stiffness(&Arc::new(model.pattern(&[]))).multiply(basis.as_ref());
        let norm = EnergyNorm::new((basis.transpose() * &product).as_ref()).unwrap();
        let q = Mat::from_fn(6, 12, |i, j| 0.02 * ((7 * i + 13 * j) as f64).sin());
        let basis = Combination::of_dense(basis);
        examine(&Samples::new(&model, &basis, &norm, q, &Uncontrolled).unwrap())
    }

    fn smoothed() -> Rule {
        let tets = vec![0, 20, 77];
        let of = |k: usize| {
            std::array::from_fn(|f| std::array::from_fn(|i| 0.3 * ((k + 4 * f + i) as f64).sin()))
        };
        Rule { smoothing: (0..3).map(of).collect(), ..Rule::of_tets(tets, vec![20.0, 50.0, 30.0]) }
    }

    #[test]
    fn derivatives_are_those_of_finite_differences() {
        for law in Law::ALL {
            with_samples(law, |samples| {
                let every = Sketch::new(samples.n_equations(), usize::MAX, 0);
                for point in 0..3 {
                    let rule = smoothed();
                    let at = Point::new(samples, &rule, point);
                    let mut exact = Mat::<f32>::zeros(samples.n_equations(), at.n_columns());
                    let target: Vec<f64> =
                        (0..exact.nrows()).map(|i| ((3 * i) as f64).sin()).collect();
                    let columns = exact.as_mut();
                    let slopes = at.linearize(samples, &rule, &every, &target, columns);
                    let value = |change: &dyn Fn(&mut Rule, f64), h: f64| {
                        let mut rule = smoothed();
                        change(&mut rule, h);
                        faer::Scale(rule.weights[point]) * samples.contribution(&rule, point)
                    };
                    let check = |column: usize, change: &dyn Fn(&mut Rule, f64)| {
                        let h = 1e-5;
                        let slope = faer::Scale(0.5 / h) * (value(change, h) - value(change, -h));
                        let found = exact.col_as_slice(column);
                        let all = slope.col_iter().flat_map(|c| c.iter().copied()).zip(found);
                        let gap = all.map(|(a, b)| (a - f64::from(*b)).powi(2)).sum::<f64>().sqrt();
                        // Single precision.
                        assert!(gap < 1e-6 * slope.norm_l2(), "{law:?} {point} {column}: {gap:e}");
                        let product: f64 =
                            target.iter().zip(found).map(|(a, b)| a * f64::from(*b)).sum();
                        let size = slope.norm_l2() * (target.len() as f64).sqrt();
                        assert!((slopes[column] - product).abs() < 1e-6 * size);
                    };
                    check(0, &|rule, h| rule.weights[point] *= h.exp());
                    assert!(at.faces.len() > 1);
                    for (number, &face) in at.faces.iter().enumerate() {
                        for axis in 0..3 {
                            check(1 + 3 * number + axis, &|rule, h| {
                                rule.smoothing[point][face][axis] += h;
                            });
                        }
                    }
                }
            });
        }
    }

    #[test]
    fn smoothing_lowers_the_error_and_stops_at_the_tolerance() {
        with_samples(Law::StVenantKirchhoff, |samples| {
            let rule = Rule::of_tets(vec![3, 20, 41, 60, 77, 99, 120, 131], vec![18.0; 8]);
            let rule = selection::fit_weights(samples, &rule, &Uncontrolled).unwrap();
            let before = samples.error(&rule);
            let smooth = |rule: &Rule, tolerance: f64, is_enough: bool| {
                smooth(samples, rule.clone(), tolerance, &|_| is_enough, &Uncontrolled).unwrap()
            };
            let fitted = smooth(&rule, 1e-9, true);
            let after = samples.error(&fitted);
            assert!(after < 0.7 * before, "{before} {after}");
            assert!(fitted.weights.iter().all(|w| *w > 0.0));
            assert_eq!(fitted.smoothing.len(), fitted.tets.len());
            assert_eq!(fitted, smooth(&rule, 1e-9, true));
            // Where the first rounds do not suffice there are more.
            assert!(samples.error(&smooth(&rule, 1e-9, false)) < 0.95 * after);
            // Where less is wanted, less is done.
            assert!(samples.error(&smooth(&rule, 0.95 * before, false)) > 1.01 * after);
            let empty = Rule::of_tets(Vec::new(), Vec::new());
            assert_eq!(empty, smooth(&empty, 1e-9, false));
        });
    }

    #[test]
    fn the_gram_matrix_is_made_in_parts() {
        let j =
            Mat::from_fn(40, 2 * COLUMNS_PER_TASK + 5, |i, j| ((7 * i + 3 * i * j) as f32).sin());
        let gram = lower_gram(j.as_ref());
        for (a, b) in [(0, 0), (150, 20), (COLUMNS_PER_TASK, COLUMNS_PER_TASK), (196, 195)] {
            let exact: f64 = (0..40).map(|i| f64::from(j[(i, a)]) * f64::from(j[(i, b)])).sum();
            assert!((gram[(a, b)] - exact).abs() < 1e-4, "{a} {b}");
        }
        assert_eq!(gram[(3, 5)], 0.0);
    }
}
