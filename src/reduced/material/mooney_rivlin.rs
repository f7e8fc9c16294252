//! Mooney–Rivlin elasticity, compressible: Ψ = C₁₀(I_C − 3) + C₀₁(II_C − 3) − d (J − 1) + L/2 (J − 1)² with
//! d = 2C₁₀ + 4C₀₁, so that there is no stress at rest.
//!
//! The textbook form (Holzapfel, *Nonlinear Solid Mechanics*, eq. 6.147) has −d log J: its first-order
//! expansion in its place keeps the law finite and smooth for every F, inverted ones included, as
//! Smith, De Goes and Kim (2018, §3) do for neo-Hookean materials. At rest μ = 2(C₁₀ + C₀₁) and λ = L − 2C₁₀.

use super::cross::{
    add_dyad, add_scaled, cofactor, cofactor_change, cross, cross_matrix, diagonal, volume_change,
};
use super::{AtRest, Hyperelastic, Mat3, Mat9};

/// Compressible Mooney–Rivlin elasticity.
#[derive(Clone, Copy, Debug)]
pub struct MooneyRivlin {
    c10: f64,
    c01: f64,
    /// L in Pa.
    pub(super) bulk: f64,
}

impl MooneyRivlin {
    /// From Lamé's constants `[lame_lambda, lame_mu]` in Pa and C₀₁/(C₁₀ + C₀₁).
    pub fn new([lame_lambda, lame_mu]: [f64; 2], mooney_ratio: f64) -> MooneyRivlin {
        let c01 = 0.5 * lame_mu * mooney_ratio;
        let c10 = 0.5 * lame_mu - c01;
        MooneyRivlin { c10, c01, bulk: lame_lambda + 2.0 * c10 }
    }

    fn tension(&self) -> f64 {
        2.0 * self.c10 + 4.0 * self.c01
    }
}

impl Hyperelastic for MooneyRivlin {
    /// With II_C = |cof F|²; the terms linear in D cancel and are left out.
    fn energy_density(&self, d: &Mat3) -> f64 {
        let (change, j) = (cofactor_change(d), volume_change(d));
        let second = cofactor(d).trace();
        self.c10 * d.norm_squared() + self.c01 * (2.0 * second + change.norm_squared())
            - self.tension() * (second + d.determinant())
            + 0.5 * self.bulk * j * j
    }

    /// P = 2C₁₀ F + 2C₀₁ F ⨯ cof F + (L j − d) cof F, less what is constant in sum.
    fn stress(&self, d: &Mat3) -> Mat3 {
        let (change, j) = (cofactor_change(d), volume_change(d));
        let identity = Mat3::identity();
        let product = cross(&identity, &(d + change)) + cross(d, &change);
        d * (2.0 * self.c10) + product * (2.0 * self.c01) - change * self.tension()
            + (change + identity) * (self.bulk * j)
    }

    fn stress_derivative(&self, d: &Mat3) -> Mat9 {
        let j = volume_change(d);
        let (f, cofactor) = (d + Mat3::identity(), cofactor_change(d) + Mat3::identity());
        let along = cross_matrix(&f);
        let mut out = diagonal(2.0 * self.c10);
        add_scaled(&mut out, 2.0 * self.c01, &cross_matrix(&cofactor));
        let twice: Mat9 = std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..9).map(|k| along[i][k] * along[k][j]).sum())
        });
        add_scaled(&mut out, 2.0 * self.c01, &twice);
        add_dyad(&mut out, self.bulk, &cofactor, &cofactor);
        add_scaled(&mut out, self.bulk * j - self.tension(), &along);
        out
    }

    /// I_C and II_C are quadratic in E; the third order is that of J (see [`super::neo_hookean`]).
    fn at_rest(&self) -> AtRest {
        let (bulk, tension) = (self.bulk, self.tension());
        AtRest {
            lame: [bulk - 2.0 * self.c10, 2.0 * (self.c10 + self.c01)],
            third_order: [1.5 * bulk - 0.5 * tension, tension - bulk, -4.0 * tension],
            is_nonlinear: true,
        }
    }
}
