//! Cubature: a few tets with non-negative weights that reproduce the reduced internal force
//! Uᵀf(Uq) ≈ Σ_e w_e U_eᵀf_e(Uq) (\[M16\] §4.3, An et al. 2008).
//!
//! Training solves a non-negative least-squares problem over random candidate tets, each pose's
//! equations scaled by its force so that every pose counts alike. After an edit the points and
//! weights are reused, and their error is measured on poses of the new basis.

pub mod nnls;
pub mod poses;

use crate::assembly::FullModel;
use crate::control::{self, Cancelled, Control, Stage};
use crate::linalg;
use crate::material::stvk;
use faer::{Mat, MatRef};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Candidate tets for each point that may be chosen.
const CANDIDATES_PER_POINT: usize = 12;

/// Least number of candidates (or every tet of a small mesh).
const LEAST_CANDIDATES: usize = 600;

/// Training stops at this fraction of the tolerance: poses not seen in training come out worse.
const TRAINING_MARGIN: f64 = 0.5;

/// Tets and their weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    /// Chosen tets, ascending.
    pub tets: Vec<u32>,
    /// Their weights, positive.
    pub weights: Vec<f64>,
}

impl Rule {
    /// Every tet with weight one: exact.
    pub fn exact(n_tets: usize) -> Rule {
        Rule { tets: (0..n_tets as u32).collect(), weights: vec![1.0; n_tets] }
    }
}

/// Poses of a body in a basis and the exact reduced forces there.
pub struct Samples {
    /// Displacements UUᵀMu of the projected poses (n×t).
    u: Mat<f64>,
    /// Uᵀf(u) (r×t).
    force: Mat<f64>,
    /// 1/‖Uᵀf(u)‖.
    scale: Vec<f64>,
}

impl Samples {
    /// Projects `poses` (n×t) on `basis` and evaluates the exact reduced force of each.
    /// `weighted_basis` is M·U.
    pub fn new(
        model: &FullModel,
        basis: MatRef<'_, f64>,
        weighted_basis: MatRef<'_, f64>,
        poses: MatRef<'_, f64>,
        control: &dyn Control,
    ) -> Result<Samples, Cancelled> {
        let q = linalg::gram(weighted_basis, poses);
        let u = linalg::product(basis, q.as_ref());
        control::check(control)?;
        let full = model.internal_forces(u.as_ref());
        let force = linalg::gram(basis, full.as_ref());
        let scale = (0..force.ncols())
            .map(|t| {
                let norm = force.col(t).norm_l2();
                if norm > 0.0 { norm.recip() } else { 0.0 }
            })
            .collect();
        Ok(Samples { u, force, scale })
    }

    /// One scaled column for each of `tets`: their shares of the reduced force at every pose
    /// ((r·t) × tets).
    fn contributions(&self, model: &FullModel, basis: MatRef<'_, f64>, tets: &[u32]) -> Mat<f64> {
        let (r, t) = (self.force.nrows(), self.force.ncols());
        let mut columns = Mat::<f64>::zeros(r * t, tets.len());
        columns.as_mut().par_col_chunks_mut(1).zip(tets.par_iter()).for_each(
            |(mut column, &tet)| {
                let tet = tet as usize;
                let rows = model.corner_rows(tet, basis);
                let mut forces = Mat::<f64>::zeros(12, t);
                for pose in 0..t {
                    let d = model.displacement_gradient(tet, self.u.col_as_slice(pose));
                    let p = stvk::stress(&d, model.lame()[tet])
                        * (model.volumes_m3()[tet] * self.scale[pose]);
                    for (corner, g) in model.gradients()[tet].iter().enumerate() {
                        let f = p * Vector3::from(*g);
                        (0..3).for_each(|axis| forces[(3 * corner + axis, pose)] = f[axis]);
                    }
                }
                let share = linalg::small_product(rows.transpose(), forces.as_ref());
                for pose in 0..t {
                    for i in 0..r {
                        column[(pose * r + i, 0)] = share[(i, pose)];
                    }
                }
            },
        );
        columns
    }

    /// The scaled target, (r·t) × 1.
    fn target(&self) -> Mat<f64> {
        let r = self.force.nrows();
        Mat::from_fn(r * self.force.ncols(), 1, |i, _| {
            self.force[(i % r, i / r)] * self.scale[i / r]
        })
    }

    /// Root mean square over the poses of the rule's relative force error.
    pub fn error(&self, model: &FullModel, basis: MatRef<'_, f64>, rule: &Rule) -> f64 {
        let mut sum = linalg::product(
            self.contributions(model, basis, &rule.tets).as_ref(),
            Mat::from_fn(rule.weights.len(), 1, |i, _| rule.weights[i]).as_ref(),
        );
        sum -= self.target();
        (sum.col(0).squared_norm_l2() / self.force.ncols() as f64).sqrt()
    }
}

/// Chooses at most `n_points` tets among random candidates and fits their weights to `samples`.
pub fn train(
    model: &FullModel,
    basis: MatRef<'_, f64>,
    samples: &Samples,
    n_points: usize,
    tolerance: f64,
    seed: u64,
    control: &dyn Control,
) -> Result<Rule, Cancelled> {
    let n_tets = model.corners().len();
    let mut all: Vec<u32> = (0..n_tets as u32).collect();
    all.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    all.truncate((CANDIDATES_PER_POINT * n_points).max(LEAST_CANDIDATES));
    all.sort_unstable();
    control.progress(Stage::Cubature, 0.3);
    let start = vec![0.0; all.len()];
    let target = Target { n_points, tolerance: TRAINING_MARGIN * tolerance, start };
    fit(model, basis, samples, &all, target, control)
}

/// Fits weights to `samples` on the points of `rule`; some may fall to zero and leave it.
pub fn refit(
    model: &FullModel,
    basis: MatRef<'_, f64>,
    samples: &Samples,
    rule: &Rule,
    control: &dyn Control,
) -> Result<Rule, Cancelled> {
    let target = Target { n_points: rule.tets.len(), tolerance: 0.0, start: rule.weights.clone() };
    fit(model, basis, samples, &rule.tets, target, control)
}

/// When a fit is done, and where it starts.
struct Target {
    n_points: usize,
    /// Relative residual.
    tolerance: f64,
    /// A weight for each candidate.
    start: Vec<f64>,
}

fn fit(
    model: &FullModel,
    basis: MatRef<'_, f64>,
    samples: &Samples,
    candidates: &[u32],
    Target { n_points, tolerance, start }: Target,
    control: &dyn Control,
) -> Result<Rule, Cancelled> {
    let columns = samples.contributions(model, basis, candidates);
    control::check(control)?;
    control.progress(Stage::Cubature, 0.6);
    let target = samples.target();
    let gram = linalg::gram(columns.as_ref(), columns.as_ref());
    control::check(control)?;
    control.progress(Stage::Cubature, 0.8);
    let projection = linalg::gram(columns.as_ref(), target.as_ref());
    let projection: Vec<f64> = (0..candidates.len()).map(|i| projection[(i, 0)]).collect();
    let solution = nnls::solve(
        gram.as_ref(),
        &projection,
        target.col(0).squared_norm_l2(),
        n_points,
        tolerance,
        &start,
    );
    Ok(Rule {
        tets: solution.support.iter().map(|&i| candidates[i]).collect(),
        weights: solution.values,
    })
}
