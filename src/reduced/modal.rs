//! Linear modes of the reduced model as damped oscillators, advanced exactly.

use crate::ReducedModel;
use crate::dense::{self, DenseError};
use faer::Mat;

/// The model linearised at rest: K̃(0) = VΩ²Vᵀ, with Rayleigh damping each mode is an oscillator of its own,
/// z̈ + (α + βω²) ż + ω² z = Vᵀf (\[B12\] eq. 3). Under a load that is constant over the step its motion is
/// known in closed form, whatever the step.
pub(crate) struct Oscillators {
    v: Mat<f64>,
    squares: Vec<f64>,
}

impl Oscillators {
    pub(crate) fn new(model: &ReducedModel) -> Result<Oscillators, DenseError> {
        let (squares, v) = dense::symmetric_eigen(model.rest_stiffness())?;
        Ok(Oscillators { v, squares })
    }

    /// Position and velocity after `dt` under the reduced `load`.
    pub(crate) fn advance(
        &self,
        model: &ReducedModel,
        q: &[f64],
        velocity: &[f64],
        load: &[f64],
        dt: f64,
    ) -> [Vec<f64>; 2] {
        let column = |x: &[f64]| Mat::from_fn(x.len(), 1, |i, _| x[i]);
        let into = |x: &[f64]| dense::small_product(self.v.transpose(), column(x).as_ref());
        let [mut z, mut w, f] = [into(q), into(velocity), into(load)];
        let damping = model.damping();
        for (i, &square) in self.squares.iter().enumerate() {
            let rate = damping.mass_per_s + damping.stiffness_s * square;
            let moved = oscillate(square, rate, f[(i, 0)], [z[(i, 0)], w[(i, 0)]], dt);
            (z[(i, 0)], w[(i, 0)]) = (moved[0], moved[1]);
        }
        [z, w].map(|x| {
            let back = dense::small_product(self.v.as_ref(), x.as_ref());
            back.col_as_slice(0).to_vec()
        })
    }
}

/// Position and velocity after `dt` of z̈ + c ż + s z = f.
fn oscillate(s: f64, c: f64, f: f64, [z, w]: [f64; 2], dt: f64) -> [f64; 2] {
    // e^{−ct/2}(a cos/cosh + b sin/sinh) about the place where the spring holds the load; sinc-like
    // functions, so that nothing is divided by a frequency that vanishes.
    let decay = (-0.5 * c * dt).exp();
    let discriminant = s - 0.25 * c * c;
    let phase = discriminant.abs().sqrt() * dt;
    let (cosine, sine_over) = if discriminant >= 0.0 {
        let sinc = if phase > 1e-6 { phase.sin() / phase } else { 1.0 - phase * phase / 6.0 };
        (decay * phase.cos(), decay * sinc * dt)
    } else {
        // Decay and growth together: overdamped modes of large c·dt would overflow apart.
        let [slow, fast] = [phase - 0.5 * c * dt, -phase - 0.5 * c * dt].map(f64::exp);
        let sinhc = if phase > 1e-6 { 0.5 * (slow - fast) / phase } else { decay };
        (0.5 * (slow + fast), sinhc * dt)
    };
    // z(t) = (C + c/2 S) z₀ + S w₀ + f·(1 − C − c/2 S)/s, with S the response to a unit push.
    let c_half = cosine + 0.5 * c * sine_over;
    let settled = if s.abs() * dt * dt > 1e-8 {
        (1.0 - c_half) / s
    } else {
        // No spring: ∫S dt.
        if c * dt > 1e-6 { (dt - (1.0 - (-c * dt).exp()) / c) / c } else { 0.5 * dt * dt }
    };
    [
        c_half * z + sine_over * w + settled * f,
        -s * sine_over * z + (cosine - 0.5 * c * sine_over) * w + sine_over * f,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runge–Kutta of fourth order in many small steps.
    fn integrated(s: f64, c: f64, f: f64, start: [f64; 2], dt: f64) -> [f64; 2] {
        let slope = |[z, w]: [f64; 2]| [w, f - c * w - s * z];
        let add = |x: [f64; 2], h: f64, k: [f64; 2]| [x[0] + h * k[0], x[1] + h * k[1]];
        let n = 20_000;
        let h = dt / f64::from(n);
        (0..n).fold(start, |x, _| {
            let a = slope(x);
            let b = slope(add(x, h / 2.0, a));
            let c = slope(add(x, h / 2.0, b));
            let d = slope(add(x, h, c));
            let mean = [0, 1].map(|i| (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]) / 6.0);
            add(x, h, mean)
        })
    }

    #[test]
    fn an_oscillator_moves_as_its_equation_says() {
        // Under-, critically and overdamped, without a spring, and without either.
        for (s, c) in
            [(900.0, 0.7), (900.0, 60.0), (900.0, 200.0), (0.0, 3.0), (0.0, 0.0), (1e-9, 0.1)]
        {
            let exact = integrated(s, c, 2.5, [0.3, -1.0], 0.11);
            let found = oscillate(s, c, 2.5, [0.3, -1.0], 0.11);
            for i in 0..2 {
                assert!((found[i] - exact[i]).abs() < 1e-8, "{s} {c}: {found:?} {exact:?}");
            }
        }
        let stiff = oscillate(1e12, 1e9, 1.0, [1.0, 1.0], 1.0);
        assert!(stiff.iter().all(|x| x.is_finite()));
    }
}
