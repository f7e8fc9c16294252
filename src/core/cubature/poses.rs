//! Random poses that a cubature rule is fitted to or validated on.
//!
//! A pose is a point of the quadratic manifold u(a) = Σ a_iφ_i + ½ Σ a_ia_jΦ_ij (\[B12\] eq. 17), the
//! shapes that a nonlinear body takes of its own accord, with amplitudes that fall with frequency
//! and a largest displacement between 2 % and 12 % of the body's diagonal.

use crate::linalg;
use crate::modes::LinearModes;
use faer::{Mat, MatRef};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Largest displacement of a pose over the diagonal: uniform between these.
const AMPLITUDE: [f64; 2] = [0.02, 0.12];

/// Amplitudes fall like (λ₁/λ_j)^p with p uniform between equal energies (½) and equal forces (1).
const DECAY: [f64; 2] = [0.5, 1.0];

/// What poses are made of.
pub struct Shapes<'a> {
    /// Linear modes.
    pub modes: &'a LinearModes,
    /// Their derivatives Φ_ij (n×p) for these pairs.
    pub derivatives: MatRef<'a, f64>,
    /// Pairs (i, j), i ≤ j.
    pub pairs: &'a [[usize; 2]],
    /// Diagonal of the body in m.
    pub diagonal_m: f64,
}

impl Shapes<'_> {
    /// `count` displacement fields (n × count); the same seed gives the same poses.
    pub fn random_poses(&self, count: usize, seed: u64) -> Mat<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let n_modes = self.modes.eigenvalues.len();
        let first = self.modes.eigenvalues.first().copied().unwrap_or(1.0);
        let mut linear = Mat::<f64>::zeros(n_modes, count);
        let mut amplitude = Vec::with_capacity(count);
        for pose in 0..count {
            let decay = random.random_range(DECAY[0]..DECAY[1]);
            amplitude.push(random.random_range(AMPLITUDE[0]..AMPLITUDE[1]) * self.diagonal_m);
            for (j, lambda) in self.modes.eigenvalues.iter().enumerate() {
                let normal: f64 = StandardNormal.sample(&mut random);
                linear[(j, pose)] = normal * (first / lambda).powf(decay);
            }
        }
        let mut u = linalg::product(self.modes.shapes.as_ref(), linear.as_ref());
        let mut scale = Vec::with_capacity(count);
        for (pose, amplitude) in amplitude.into_iter().enumerate() {
            let largest = largest_displacement(u.col_as_slice(pose));
            let factor = if largest > 0.0 { amplitude / largest } else { 0.0 };
            u.col_as_slice_mut(pose).iter_mut().for_each(|x| *x *= factor);
            scale.push(factor);
        }
        let quadratic = Mat::from_fn(self.pairs.len(), count, |row, pose| {
            let [i, j] = self.pairs[row];
            let half = if i == j { 0.5 } else { 1.0 };
            half * linear[(i, pose)] * linear[(j, pose)] * scale[pose] * scale[pose]
        });
        // Where the quadratic part outgrows the linear one the expansion has no meaning: cap it.
        let mut bent = linalg::product(self.derivatives, quadratic.as_ref());
        for pose in 0..count {
            let limit = largest_displacement(u.col_as_slice(pose));
            let largest = largest_displacement(bent.col_as_slice(pose));
            let factor = if largest > limit { limit / largest } else { 1.0 };
            for (x, b) in u.col_as_slice_mut(pose).iter_mut().zip(bent.col_as_slice_mut(pose)) {
                *x += factor * *b;
            }
        }
        u
    }
}

fn largest_displacement(u: &[f64]) -> f64 {
    u.chunks_exact(3).map(|x| x.iter().map(|c| c * c).sum::<f64>().sqrt()).fold(0.0, f64::max)
}
