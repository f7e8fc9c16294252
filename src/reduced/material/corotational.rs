//! Corotational linear elasticity: Ψ = μ‖F − R‖² + λ/2 tr²(S − I) with the polar decomposition F = RS
//! (Müller and Gross 2004; Chao et al. 2010 for the exact derivative): linear in the strain that is left when
//! the rotation is taken out.

use super::cross::{add_dyad, diagonal};
use super::stvk::green_strain;
use super::{AtRest, Hyperelastic, Mat3, Mat9};
use nalgebra::Vector3;

/// Corotational elasticity with Lamé's constants.
#[derive(Clone, Copy, Debug)]
pub struct Corotational {
    /// `[lame_lambda, lame_mu]` in Pa.
    pub lame: [f64; 2],
}

/// F = U Σ Vᵀ with rotations U and V: the smallest entry of Σ takes the sign of det F.
struct Polar {
    /// R = UVᵀ.
    rotation: Mat3,
    /// F − R = U(Σ − I)Vᵀ.
    strain: Mat3,
    v: Mat3,
    /// Σ − I.
    stretches: Vector3<f64>,
}

/// Sums of two stretches below this are taken for it: where both vanish, or cancel in an inverted
/// state, the rotation is not differentiable.
const LEAST_STRETCH: f64 = 1e-6;

impl Polar {
    fn new(d: &Mat3) -> Polar {
        // From E, whose eigenvalues e give the stretches as √(1 + 2e): those keep their digits near 1.
        let eigen = green_strain(d).symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let mut v = Mat3::from_columns(&order.map(|k| eigen.eigenvectors.column(k).into_owned()));
        if v.determinant() < 0.0 {
            v.set_column(2, &-v.column(2).into_owned());
        }
        let fv = v + d * v;
        let first = unit(&fv.column(0).into_owned(), &Vector3::x());
        let second = fv.column(1) - first * first.dot(&fv.column(1));
        let second = unit(&second, &perpendicular(&first));
        let third = first.cross(&second);
        let u = Mat3::from_columns(&[first, second, third]);
        let is_inverted = third.dot(&fv.column(2)) < 0.0;
        let stretches = Vector3::from_fn(|k, _| {
            let e = eigen.eigenvalues[order[k]];
            let stretch = (1.0 + 2.0 * e).max(0.0).sqrt();
            if k == 2 && is_inverted { -stretch - 1.0 } else { 2.0 * e.max(-0.5) / (stretch + 1.0) }
        });
        let strain = u * Mat3::from_diagonal(&stretches) * v.transpose();
        Polar { rotation: u * v.transpose(), strain, v, stretches }
    }
}

/// `x` with unit length, or `otherwise` where there is nothing of it.
fn unit(x: &Vector3<f64>, otherwise: &Vector3<f64>) -> Vector3<f64> {
    let length = x.norm();
    if length > 1e-12 { x / length } else { *otherwise }
}

/// Some unit vector that is perpendicular to the unit vector `x`.
fn perpendicular(x: &Vector3<f64>) -> Vector3<f64> {
    let axis = Vector3::ith(x.iamin(), 1.0);
    x.cross(&axis).normalize()
}

impl Corotational {
    fn energy_density_of(&self, polar: &Polar) -> f64 {
        let [lame_lambda, lame_mu] = self.lame;
        let Polar { stretches, .. } = polar;
        lame_mu * stretches.norm_squared() + 0.5 * lame_lambda * stretches.sum().powi(2)
    }

    /// P = 2μ(F − R) + λ tr(S − I) R.
    fn stress_of(&self, polar: &Polar) -> Mat3 {
        let [lame_lambda, lame_mu] = self.lame;
        polar.strain * (2.0 * lame_mu) + polar.rotation * (lame_lambda * polar.stretches.sum())
    }

    /// dR = R \[w\]ₓ with (tr(S) I − S) w the axis of RᵀdF − dFᵀR, and d tr S = R : dF.
    fn stress_derivative_of(&self, polar: &Polar) -> Mat9 {
        let [lame_lambda, lame_mu] = self.lame;
        let Polar { rotation, v, stretches, .. } = polar;
        let mut out = diagonal(2.0 * lame_mu);
        add_dyad(&mut out, lame_lambda, rotation, rotation);
        let turning = lame_lambda * stretches.sum() - 2.0 * lame_mu;
        // In the frame V the matrix is diagonal; along its axis k, R [v_k]ₓ is what the rotation
        // changes by, and twice the part of dF in it, over the two other stretches, how much.
        for k in 0..3 {
            let [a, b] = [(k + 1) % 3, (k + 2) % 3];
            let sum = (stretches[a] + 1.0) + (stretches[b] + 1.0);
            let direction = rotation * v.column(k).into_owned().cross_matrix();
            add_dyad(&mut out, turning / sum.max(LEAST_STRETCH), &direction, &direction);
        }
        out
    }
}

impl Hyperelastic for Corotational {
    fn energy_density(&self, d: &Mat3) -> f64 {
        self.energy_density_of(&Polar::new(d))
    }

    fn stress(&self, d: &Mat3) -> Mat3 {
        self.stress_of(&Polar::new(d))
    }

    fn stress_derivative(&self, d: &Mat3) -> Mat9 {
        self.stress_derivative_of(&Polar::new(d))
    }

    /// One polar decomposition for all: it is most of the work.
    fn at(&self, d: &Mat3, derivative: Option<&mut Mat9>) -> (f64, Mat3) {
        let polar = Polar::new(d);
        if let Some(derivative) = derivative {
            *derivative = self.stress_derivative_of(&polar);
        }
        (self.energy_density_of(&polar), self.stress_of(&polar))
    }

    /// S = √(I + 2E) = I + E − E²/2 + …
    fn at_rest(&self) -> AtRest {
        let [lame_lambda, lame_mu] = self.lame;
        AtRest {
            lame: self.lame,
            third_order: [0.0, -0.5 * lame_lambda, -3.0 * lame_mu],
            is_nonlinear: true,
        }
    }
}
