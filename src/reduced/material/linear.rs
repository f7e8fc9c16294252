//! Linear elasticity: Ψ = λ/2 (tr ε)² + μ ε:ε with ε = sym ∇u. A rotation costs energy: for small
//! rotations only.

use super::{AtRest, Hyperelastic, Mat3, Mat9};

/// Linear elasticity with Lamé's constants.
#[derive(Clone, Copy, Debug)]
pub struct Linear {
    /// `[lame_lambda, lame_mu]` in Pa.
    pub lame: [f64; 2],
}

impl Hyperelastic for Linear {
    fn energy_density(&self, d: &Mat3) -> f64 {
        let [lame_lambda, lame_mu] = self.lame;
        let strain = (d + d.transpose()) * 0.5;
        0.5 * lame_lambda * strain.trace().powi(2) + lame_mu * strain.norm_squared()
    }

    fn stress(&self, d: &Mat3) -> Mat3 {
        self.at_rest().stress_derivative(d)
    }

    fn stress_derivative(&self, _: &Mat3) -> Mat9 {
        let [lame_lambda, lame_mu] = self.lame;
        let mut out = [[0.0; 9]; 9];
        for i in 0..3 {
            for j in 0..3 {
                out[3 * i + j][3 * i + j] += lame_mu;
                out[3 * i + j][3 * j + i] += lame_mu;
                out[4 * i][4 * j] += lame_lambda;
            }
        }
        out
    }

    fn at_rest(&self) -> AtRest {
        AtRest { lame: self.lame, third_order: [0.0; 3], is_nonlinear: false }
    }
}
