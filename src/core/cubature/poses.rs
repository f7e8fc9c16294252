//! Random poses that a cubature rule is fitted to or validated on.
//!
//! A pose is a point of the quadratic manifold u(a) = Σ a_iφ_i + ½ Σ a_ia_jΦ_ij (\[B12\] eq. 17), the
//! shapes that a nonlinear body takes of its own accord, with amplitudes that fall with frequency
//! and a largest displacement of the linear part between 2 % and 12 % of the body's diagonal.
//!
//! Static equilibria under random loads, solved for with a fine rule, were tried as training poses:
//! the static displacements that 120 points then give are no better (median error 3.7, 0.7, 4.0 and
//! 0.7 % on the small stomach, fork, ball and plant; 3.6, 1.1, 4.4 and 0.6 % with these poses).

use crate::dictionary::Combination;
use crate::linalg;
use faer::{Mat, MatRef};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Largest displacement of a pose over the diagonal: uniform between these.
const AMPLITUDE: [f64; 2] = [0.02, 0.12];

/// Amplitudes fall like (λ₁/λ_j)^p with p uniform between these: about equal forces on every mode.
/// From equal energies (½) on, high modes dominate: static displacements come out up to 2.6 times
/// worse.
const DECAY: [f64; 2] = [0.75, 1.25];

/// Vertices at which displacements are compared with [`AMPLITUDE`], evenly spread over the numbering.
const MOST_PROBES: usize = 2000;

/// What poses are made of, as an M-orthonormal basis sees it.
pub struct Shapes<'a> {
    /// UᵀM times the linear modes (r×k).
    pub modes: Mat<f64>,
    /// Their eigenvalues.
    pub eigenvalues: &'a [f64],
    /// UᵀM times their derivatives Φ_ij (r×p), for these pairs.
    pub derivatives: Mat<f64>,
    /// Pairs (i, j), i ≤ j.
    pub pairs: &'a [[usize; 2]],
    /// Diagonal of the body in m.
    pub diagonal_m: f64,
}

/// The linear parts of some poses.
struct Linear {
    /// Reduced coordinates (r×t).
    q: Mat<f64>,
    /// Of each mode (k×t), times `scale` of the pose.
    amplitudes: Mat<f64>,
    scale: Vec<f64>,
    /// Largest displacement of each pose in m.
    reach_m: Vec<f64>,
}

/// A source of random poses in reduced coordinates.
pub struct PoseSource<'a> {
    shapes: Shapes<'a>,
    /// Rows of the basis at some vertices.
    probes: Mat<f64>,
}

impl<'a> PoseSource<'a> {
    /// `basis` is the one that `shapes` speaks of.
    pub fn new(shapes: Shapes<'a>, basis: &Combination) -> PoseSource<'a> {
        let n_vertices = basis.n_rows() / 3;
        let stride = n_vertices.div_ceil(MOST_PROBES).max(1);
        let rows: Vec<Option<usize>> = (0..n_vertices)
            .step_by(stride)
            .flat_map(|v| (0..3).map(move |axis| Some(3 * v + axis)))
            .collect();
        PoseSource { shapes, probes: basis.rows(&rows) }
    }

    /// Reduced coordinates of `count` poses (r × count); the same seed gives the same poses.
    pub fn random_poses(&self, count: usize, seed: u64) -> Mat<f64> {
        let Shapes { derivatives, pairs, .. } = &self.shapes;
        let Linear { mut q, amplitudes, scale, reach_m } = self.linear(count, seed);
        let quadratic = Mat::from_fn(pairs.len(), count, |row, pose| {
            let [i, j] = pairs[row];
            let half = if i == j { 0.5 } else { 1.0 };
            half * amplitudes[(i, pose)] * amplitudes[(j, pose)] * scale[pose] * scale[pose]
        });
        let bent = linalg::small_product(derivatives.as_ref(), quadratic.as_ref());
        // Where the quadratic part outgrows the linear one the expansion has no meaning: cap it.
        for (pose, largest) in self.largest_displacements(bent.as_ref()).into_iter().enumerate() {
            let factor = if largest > reach_m[pose] { reach_m[pose] / largest } else { 1.0 };
            for (x, b) in q.col_as_slice_mut(pose).iter_mut().zip(bent.col_as_slice(pose)) {
                *x += factor * b;
            }
        }
        q
    }

    /// The linear parts of such poses.
    pub fn linear_poses(&self, count: usize, seed: u64) -> Mat<f64> {
        self.linear(count, seed).q
    }

    fn linear(&self, count: usize, seed: u64) -> Linear {
        let Shapes { modes, eigenvalues, diagonal_m, .. } = &self.shapes;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let n_modes = eigenvalues.len();
        let first = eigenvalues.first().copied().unwrap_or(1.0);
        let mut amplitudes = Mat::<f64>::zeros(n_modes, count);
        let mut reach_m = Vec::with_capacity(count);
        for pose in 0..count {
            let decay = random.random_range(DECAY[0]..DECAY[1]);
            reach_m.push(random.random_range(AMPLITUDE[0]..AMPLITUDE[1]) * diagonal_m);
            for (j, lambda) in eigenvalues.iter().enumerate() {
                let normal: f64 = StandardNormal.sample(&mut random);
                amplitudes[(j, pose)] = normal * (first / lambda).powf(decay);
            }
        }
        let mut q = linalg::small_product(modes.as_ref(), amplitudes.as_ref());
        let mut scale = Vec::with_capacity(count);
        for (pose, largest) in self.largest_displacements(q.as_ref()).into_iter().enumerate() {
            let factor = if largest > 0.0 { reach_m[pose] / largest } else { 0.0 };
            q.col_as_slice_mut(pose).iter_mut().for_each(|x| *x *= factor);
            scale.push(factor);
        }
        Linear { q, amplitudes, scale, reach_m }
    }

    /// Largest displacement of a probed vertex in m, for each column of `q` (r×t).
    fn largest_displacements(&self, q: MatRef<'_, f64>) -> Vec<f64> {
        let u = linalg::product(self.probes.as_ref(), q);
        let squared = |x: &[f64]| x.iter().map(|c| c * c).sum::<f64>();
        (0..u.ncols())
            .map(|t| u.col_as_slice(t).chunks_exact(3).map(squared).fold(0.0, f64::max).sqrt())
            .collect()
    }
}
