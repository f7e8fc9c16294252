//! St. Venant–Kirchhoff: Ψ(F) = λ/2 (tr E)² + μ E:E with E = (FᵀF − I)/2.

use super::{AtRest, Hyperelastic, Mat3, Mat9};

/// Second Piola–Kirchhoff stress S(E) = λ tr(E) I + 2μE, in Pa.
pub fn second_stress(e: &Mat3, [lame_lambda, lame_mu]: [f64; 2]) -> Mat3 {
    e * (2.0 * lame_mu) + Mat3::identity() * (lame_lambda * e.trace())
}

/// Green strain E = sym(D) + DᵀD/2: from D, so that small strains keep their digits.
pub fn green_strain(d: &Mat3) -> Mat3 {
    (d + d.transpose() + d.transpose() * d) * 0.5
}

/// St. Venant–Kirchhoff with Lamé's constants.
#[derive(Clone, Copy, Debug)]
pub struct StVenantKirchhoff {
    /// `[lame_lambda, lame_mu]` in Pa.
    pub lame: [f64; 2],
}

impl Hyperelastic for StVenantKirchhoff {
    fn energy_density(&self, d: &Mat3) -> f64 {
        let [lame_lambda, lame_mu] = self.lame;
        let e = green_strain(d);
        0.5 * lame_lambda * e.trace().powi(2) + lame_mu * e.norm_squared()
    }

    /// P = F S(E).
    fn stress(&self, d: &Mat3) -> Mat3 {
        let s = second_stress(&green_strain(d), self.lame);
        s + d * s
    }

    fn stress_derivative(&self, d: &Mat3) -> Mat9 {
        // dP = dF S + F (λ tr(dE) I + 2μ dE) with dE = sym(FᵀdF).
        let [lame_lambda, lame_mu] = self.lame;
        let f = d + Mat3::identity();
        let s = second_stress(&green_strain(d), self.lame);
        let fft = f * f.transpose();
        let mut out = [[0.0; 9]; 9];
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            for (k, l) in (0..3).flat_map(|k| (0..3).map(move |l| (k, l))) {
                // ∂P_ij/∂F_kl
                let mut value =
                    lame_lambda * f[(i, j)] * f[(k, l)] + lame_mu * f[(i, l)] * f[(k, j)];
                if j == l {
                    value += lame_mu * fft[(i, k)];
                }
                if i == k {
                    value += s[(l, j)];
                }
                out[3 * i + j][3 * k + l] = value;
            }
        }
        out
    }

    fn at_rest(&self) -> AtRest {
        AtRest { lame: self.lame, third_order: [0.0; 3], is_nonlinear: true }
    }
}
