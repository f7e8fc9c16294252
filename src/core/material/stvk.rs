//! St. Venant–Kirchhoff: Ψ(F) = λ/2 (tr E)² + μ E:E with E = (FᵀF − I)/2.
//!
//! Every function takes the displacement gradient D = ∇u = F − I (3×3) and Lamé's constants
//! `[lame_lambda, lame_mu]` in Pa.

use nalgebra::Matrix3;

type Mat3 = Matrix3<f64>;

/// Second Piola–Kirchhoff stress S(E) = λ tr(E) I + 2μE, in Pa.
pub fn second_stress(e: &Mat3, [lame_lambda, lame_mu]: [f64; 2]) -> Mat3 {
    e * (2.0 * lame_mu) + Mat3::identity() * (lame_lambda * e.trace())
}

/// Green strain E = sym(D) + DᵀD/2: from D, so that small strains keep their digits.
pub fn green_strain(d: &Mat3) -> Mat3 {
    (d + d.transpose() + d.transpose() * d) * 0.5
}

/// Energy density in J/m³.
pub fn energy_density(d: &Mat3, [lame_lambda, lame_mu]: [f64; 2]) -> f64 {
    let e = green_strain(d);
    0.5 * lame_lambda * e.trace().powi(2) + lame_mu * e.norm_squared()
}

/// First Piola–Kirchhoff stress P = F S(E), in Pa.
pub fn stress(d: &Mat3, lame: [f64; 2]) -> Mat3 {
    let s = second_stress(&green_strain(d), lame);
    s + d * s
}

/// ∂P/∂F as a 9×9 matrix in Pa, index 3·row + column on both sides, written by rows.
pub fn stress_derivative(d: &Mat3, lame: [f64; 2]) -> [[f64; 9]; 9] {
    // dP = dF S + F (λ tr(dE) I + 2μ dE) with dE = sym(FᵀdF).
    let [lame_lambda, lame_mu] = lame;
    let f = d + Mat3::identity();
    let s = second_stress(&green_strain(d), lame);
    let fft = f * f.transpose();
    let mut out = [[0.0; 9]; 9];
    for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
        for (k, l) in (0..3).flat_map(|k| (0..3).map(move |l| (k, l))) {
            // ∂P_ij/∂F_kl
            let mut value = lame_lambda * f[(i, j)] * f[(k, l)] + lame_mu * f[(i, l)] * f[(k, j)];
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

/// Second derivative of P at rest, D²P(0)[A, B] = A S(sym B) + B S(sym A) + S(sym(AᵀB)), in Pa:
/// the integrand of (H:v)w (\[B12\] eq. 15) with A = ∇v, B = ∇w.
pub fn stress_second_derivative_at_rest(a: &Mat3, b: &Mat3, lame: [f64; 2]) -> Mat3 {
    let sym = |m: Mat3| (m + m.transpose()) * 0.5;
    a * second_stress(&sym(*b), lame)
        + b * second_stress(&sym(*a), lame)
        + second_stress(&sym(a.transpose() * b), lame)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAME: [f64; 2] = [2.3e5, 1.1e5];

    fn gradient(seed: f64) -> Mat3 {
        Mat3::from_fn(|i, j| 0.3 * (seed + 1.7 * i as f64 + 0.9 * j as f64).sin())
    }

    /// Central differences have a relative error of h² plus rounding/h: about 1e-9 at h = 1e-5.
    const H: f64 = 1e-5;

    #[test]
    fn stress_is_the_derivative_of_energy() {
        let (d, step) = (gradient(0.4), gradient(2.0));
        let slope = (energy_density(&(d + step * H), LAME) - energy_density(&(d - step * H), LAME))
            / (2.0 * H);
        let exact = stress(&d, LAME).dot(&step);
        assert!((slope - exact).abs() < 1e-8 * exact.abs(), "{slope} {exact}");
    }

    #[test]
    fn stress_derivative_is_the_derivative_of_stress() {
        let (d, step) = (gradient(0.4), gradient(2.0));
        let slope = (stress(&(d + step * H), LAME) - stress(&(d - step * H), LAME)) / (2.0 * H);
        let c = stress_derivative(&d, LAME);
        let exact = Mat3::from_fn(|i, j| {
            (0..9).map(|k| c[3 * i + j][k] * step[(k / 3, k % 3)]).sum::<f64>()
        });
        assert!((slope - exact).norm() < 1e-8 * exact.norm());
        for (i, row) in c.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                let scale = 1e-14 * LAME[0];
                assert!((value - c[j][i]).abs() < scale, "major symmetry at {i},{j}");
            }
        }
    }

    #[test]
    fn second_derivative_at_rest_is_the_derivative_of_the_stress_derivative() {
        let (a, b) = (gradient(0.4), gradient(2.0));
        let along_a = |d: Mat3| {
            let c = stress_derivative(&d, LAME);
            Mat3::from_fn(|i, j| (0..9).map(|k| c[3 * i + j][k] * a[(k / 3, k % 3)]).sum::<f64>())
        };
        let slope = (along_a(b * H) - along_a(b * -H)) / (2.0 * H);
        let exact = stress_second_derivative_at_rest(&a, &b, LAME);
        assert!((slope - exact).norm() < 1e-8 * exact.norm());
        assert!(
            (exact - stress_second_derivative_at_rest(&b, &a, LAME)).norm() < 1e-14 * exact.norm()
        );
    }

    #[test]
    fn a_rotation_costs_nothing_and_turns_the_stress() {
        let q = nalgebra::Rotation3::from_euler_angles(0.3, -1.1, 2.0).into_inner();
        let d = gradient(0.4);
        let turned = q * (d + Mat3::identity()) - Mat3::identity();
        assert!(energy_density(&(q - Mat3::identity()), LAME) < 1e-20 * LAME[0]);
        let expected = q * stress(&d, LAME);
        assert!((stress(&turned, LAME) - expected).norm() < 1e-13 * expected.norm());
    }
}
