//! Derivatives of the stress of an isotropic material at rest.

use super::Mat3;

/// The energy of an isotropic material without stress at rest, to third order in Green's strain E:
/// Ψ = λ/2 (tr E)² + μ tr E² + a/3 (tr E)³ + b tr E tr E² + c/3 tr E³. There is no other term: at rest
/// a law is told by Lamé's constants and these three (Murnaghan's, in other words).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtRest {
    /// Lamé's constants `[lame_lambda, lame_mu]` in Pa.
    pub lame: [f64; 2],
    /// `[a, b, c]` in Pa.
    pub third_order: [f64; 3],
    /// Whether energy is a function of E: not so for linear elasticity, whose stress is linear in ∇u.
    pub is_nonlinear: bool,
}

fn symmetric(m: &Mat3) -> Mat3 {
    (m + m.transpose()) * 0.5
}

impl AtRest {
    /// λ tr(E) I + 2μE for a symmetric E.
    fn linear(&self, e: &Mat3) -> Mat3 {
        let [lame_lambda, lame_mu] = self.lame;
        e * (2.0 * lame_mu) + Mat3::identity() * (lame_lambda * e.trace())
    }

    /// DP(0)\[A\], in Pa.
    pub fn stress_derivative(&self, a: &Mat3) -> Mat3 {
        self.linear(&symmetric(a))
    }

    /// D²P(0)\[A, B\] in Pa: the integrand of (H:v)w (\[B12\] eq. 15) with A = ∇v, B = ∇w. With S(E) the
    /// linear part and T(E) the quadratic part of the second Piola–Kirchhoff stress, P = F (S + T) gives
    /// A S(sym B) + B S(sym A) + S(sym(AᵀB)) + T'(sym A)\[sym B\].
    pub fn stress_second_derivative(&self, a: &Mat3, b: &Mat3) -> Mat3 {
        if !self.is_nonlinear {
            return Mat3::zeros();
        }
        let (ea, eb) = (symmetric(a), symmetric(b));
        let [cubic, mixed, product] = self.third_order;
        let (ta, tb) = (ea.trace(), eb.trace());
        let both = ea * eb;
        let isotropic = 2.0 * cubic * ta * tb + 2.0 * mixed * both.trace();
        a * self.linear(&eb)
            + b * self.linear(&ea)
            + self.linear(&symmetric(&(a.transpose() * b)))
            + Mat3::identity() * isotropic
            + (eb * ta + ea * tb) * (2.0 * mixed)
            + (both + both.transpose()) * product
    }
}
