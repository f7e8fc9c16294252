//! Derivatives by differences.

/// Slope of a vector function along a direction.
#[derive(Clone, Debug)]
pub struct Slope {
    /// df/ds of each component.
    pub value: Vec<f64>,
    /// What rounding may have done to any of them.
    pub rounding: f64,
}

/// Units in the last place that a sum over a few hundred elements may lose against its largest
/// component.
const ULPS: f64 = 256.0;

/// The slope of `f` at `x` along `direction`, by the five-point central stencil
/// (f(−2) − 8f(−1) + 8f(1) − f(2))/12 with steps of one whole `direction`.
///
/// The stencil is exact for polynomials of degree four. The energy of St. Venant–Kirchhoff is one of
/// degree four in the displacement, its force of degree three, its stiffness of degree two: nothing
/// is truncated, so the step need not be small, and the only error is rounding, ε·max|f| times the
/// number of terms.
pub fn slope(f: impl Fn(&[f64]) -> Vec<f64>, x: &[f64], direction: &[f64]) -> Slope {
    let at = |s: f64| -> Vec<f64> {
        f(&x.iter().zip(direction).map(|(x, d)| x + s * d).collect::<Vec<f64>>())
    };
    let points = [at(-2.0), at(-1.0), at(1.0), at(2.0)];
    let value = (0..points[0].len())
        .map(|i| (points[0][i] - points[3][i] + 8.0 * (points[2][i] - points[1][i])) / 12.0)
        .collect();
    let largest = points.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
    Slope { value, rounding: ULPS * f64::EPSILON * largest }
}

impl Slope {
    /// Panics unless every component of `exact` is within rounding of the slope.
    pub fn assert_is(&self, exact: &[f64], what: &str) {
        assert_eq!(self.value.len(), exact.len(), "{what}");
        let largest = exact.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        assert!(largest > 100.0 * self.rounding, "{what}: nothing to compare above rounding");
        for (i, (slope, exact)) in self.value.iter().zip(exact).enumerate() {
            assert!(
                (slope - exact).abs() <= self.rounding,
                "{what}, component {i}: differences give {slope:e}, formula {exact:e}, \
                 rounding {:e}",
                self.rounding
            );
        }
    }
}
