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

impl StVenantKirchhoff {
    #[inline(always)]
    fn energy_density_of(&self, e: &Mat3) -> f64 {
        let [lame_lambda, lame_mu] = self.lame;
        0.5 * lame_lambda * e.trace().powi(2) + lame_mu * e.norm_squared()
    }

    /// dP = dF S + F (λ tr(dE) I + 2μ dE) with dE = sym(FᵀdF):
    /// ∂P_ij/∂F_kl = λ F_ij F_kl + μ F_il F_kj + μ δ_jl (FFᵀ)_ik + δ_ik S_lj.
    #[inline(always)]
    fn set_derivative(&self, to: &mut Mat9, d: &Mat3, s: &Mat3) {
        let [lame_lambda, lame_mu] = self.lame;
        let f = d + Mat3::identity();
        let left: [[f64; 3]; 3] = (f * f.transpose() * lame_mu).into();
        let s: [[f64; 3]; 3] = (*s).into();
        let f: [[f64; 3]; 3] = f.transpose().into();
        for i in 0..3 {
            for j in 0..3 {
                let row = &mut to[3 * i + j];
                for k in 0..3 {
                    for l in 0..3 {
                        row[3 * k + l] =
                            lame_lambda * f[i][j] * f[k][l] + lame_mu * f[i][l] * f[k][j];
                    }
                    row[3 * k + j] += left[i][k];
                }
                for l in 0..3 {
                    row[3 * i + l] += s[l][j];
                }
            }
        }
    }
}

impl Hyperelastic for StVenantKirchhoff {
    fn energy_density(&self, d: &Mat3) -> f64 {
        self.energy_density_of(&green_strain(d))
    }

    /// P = F S(E).
    fn stress(&self, d: &Mat3) -> Mat3 {
        let s = second_stress(&green_strain(d), self.lame);
        s + d * s
    }

    fn stress_derivative(&self, d: &Mat3) -> Mat9 {
        let mut out = [[0.0; 9]; 9];
        self.set_derivative(&mut out, d, &second_stress(&green_strain(d), self.lame));
        out
    }

    fn at(&self, d: &Mat3, derivative: Option<&mut Mat9>) -> (f64, Mat3) {
        let e = green_strain(d);
        let s = second_stress(&e, self.lame);
        if let Some(derivative) = derivative {
            self.set_derivative(derivative, d, &s);
        }
        (self.energy_density_of(&e), s + d * s)
    }

    fn at_rest(&self) -> AtRest {
        AtRest { lame: self.lame, third_order: [0.0; 3], is_nonlinear: true }
    }
}
