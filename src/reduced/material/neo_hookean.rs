//! Stable neo-Hookean elasticity (Smith, De Goes and Kim, *Stable Neo-Hookean Flesh Simulation*, ACM
//! Trans. Graph. 37, 2018, eq. 14): Ψ = μ/2 (I_C − 3) − μ/2 log(I_C + 1) + λ/2 (J − α)² with I_C = tr FᵀF,
//! J = det F, α = 1 + 3μ/4λ. Finite for every F, inverted ones included.
//!
//! Their μ and λ are 4/3 μ and λ + 5/6 μ of Lamé's constants. Ψ is written in s = I_C − 3 and j = J − 1
//! so that nothing cancels near rest: ¾μ(s/2 − j) − μ/2 (log(1 + s/4) − s/4) + λ/2 j².

use super::cross::{
    add_dyad, add_scaled, cofactor, cofactor_change, cross_matrix, diagonal, volume_change,
};
use super::{AtRest, Hyperelastic, Mat3, Mat9};

/// Below this s/4 the logarithm is summed as a series.
const SERIES_BELOW: f64 = 1e-2;

/// Stable neo-Hookean elasticity with the constants of the paper.
#[derive(Clone, Copy, Debug)]
pub struct NeoHookean {
    lambda: f64,
    mu: f64,
}

impl NeoHookean {
    /// From Lamé's constants `[lame_lambda, lame_mu]` in Pa.
    pub fn new([lame_lambda, lame_mu]: [f64; 2]) -> NeoHookean {
        NeoHookean { lambda: lame_lambda + 5.0 / 6.0 * lame_mu, mu: 4.0 / 3.0 * lame_mu }
    }
}

/// s = tr FᵀF − 3.
fn stretch(d: &Mat3) -> f64 {
    2.0 * d.trace() + d.norm_squared()
}

/// log(1 + x) − x.
fn log_remainder(x: f64) -> f64 {
    if x.abs() >= SERIES_BELOW {
        return x.ln_1p() - x;
    }
    // The next term is x⁹/9: 1e-17 of the first at most.
    let series = (3..=8).rev().fold(0.0, |sum, k| {
        let sign = if k % 2 == 0 { -1.0 } else { 1.0 };
        sum * x + sign / f64::from(k)
    });
    x * x * (-0.5 + x * series)
}

impl Hyperelastic for NeoHookean {
    fn energy_density(&self, d: &Mat3) -> f64 {
        let (s, j) = (stretch(d), volume_change(d));
        let shape = 0.5 * d.norm_squared() - cofactor(d).trace() - d.determinant();
        self.mu * (0.75 * shape - 0.5 * log_remainder(0.25 * s)) + 0.5 * self.lambda * j * j
    }

    /// P = ¾μ(F − cof F) + μ (¼ − 1/(4 + s)) F + λ j cof F.
    fn stress(&self, d: &Mat3) -> Mat3 {
        let (s, j) = (stretch(d), volume_change(d));
        let change = cofactor_change(d);
        let (f, cofactor) = (d + Mat3::identity(), change + Mat3::identity());
        (d - change) * (0.75 * self.mu)
            + f * (self.mu * s / (4.0 * (4.0 + s)))
            + cofactor * (self.lambda * j)
    }

    fn stress_derivative(&self, d: &Mat3) -> Mat9 {
        let (s, j) = (stretch(d), volume_change(d));
        let (f, cofactor) = (d + Mat3::identity(), cofactor_change(d) + Mat3::identity());
        let mut out = diagonal(self.mu * (0.75 + s / (4.0 * (4.0 + s))));
        add_dyad(&mut out, 2.0 * self.mu / (4.0 + s).powi(2), &f, &f);
        add_dyad(&mut out, self.lambda, &cofactor, &cofactor);
        add_scaled(&mut out, self.lambda * j - 0.75 * self.mu, &cross_matrix(&f));
        out
    }

    /// From J = 1 + e₁ + (e₁²/2 − e₂) + (4/3 e₃ − e₁e₂ + e₁³/6) + … with e_k = tr Eᵏ, and s = 2e₁.
    fn at_rest(&self) -> AtRest {
        let NeoHookean { lambda, mu } = *self;
        AtRest {
            lame: [lambda - 0.625 * mu, 0.75 * mu],
            third_order: [1.5 * lambda - 7.0 / 16.0 * mu, 0.75 * mu - lambda, -3.0 * mu],
            is_nonlinear: true,
        }
    }
}
