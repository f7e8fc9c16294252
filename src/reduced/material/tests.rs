//! Every law by the same oracles: difference quotients, rotations, rest, and inversion.

use super::*;

const LAME: [f64; 2] = [2.3e5, 1.1e5];

/// Central differences have a relative error of h² plus rounding/h: about 1e-9 at h = 1e-5.
const H: f64 = 1e-5;

fn laws() -> [Elasticity; 5] {
    Law::ALL.map(|law| Elasticity { law, lame: LAME, mooney_ratio: 0.3 })
}

fn gradient(seed: f64, size: f64) -> Mat3 {
    Mat3::from_fn(|i, j| size * (seed + 1.7 * i as f64 + 0.9 * j as f64).sin())
}

/// States to differentiate at: moderate, large, and turned inside out.
fn states() -> Vec<Mat3> {
    let mut inverted = gradient(0.9, 0.2);
    inverted[(1, 1)] -= 1.6;
    assert!((inverted + Mat3::identity()).determinant() < -0.1);
    let mut flat = gradient(1.3, 0.1);
    flat[(2, 2)] -= 0.97;
    vec![gradient(0.4, 0.3), gradient(2.9, 1.1), flat, inverted]
}

fn along(c: &Mat9, step: &Mat3) -> Mat3 {
    Mat3::from_fn(|i, j| (0..9).map(|k| c[3 * i + j][k] * step[(k / 3, k % 3)]).sum::<f64>())
}

#[test]
fn stress_is_the_derivative_of_energy() {
    for law in laws() {
        for d in states() {
            let step = gradient(2.0, 0.3);
            let energy = |t: f64| law.energy_density(&(d + step * t));
            let slope = (energy(H) - energy(-H)) / (2.0 * H);
            let exact = law.stress(&d).dot(&step);
            let scale = law.stress(&d).norm() * step.norm() + law.energy_density(&d);
            assert!((slope - exact).abs() < 1e-8 * scale, "{law:?}: {slope} {exact}");
        }
    }
}

#[test]
fn all_at_once_is_what_each_alone_is() {
    for law in laws() {
        for d in states() {
            let mut derivative = [[f64::NAN; 9]; 9];
            let (energy, stress) = law.at(&d, Some(&mut derivative));
            assert_eq!((energy, stress), (law.energy_density(&d), law.stress(&d)), "{law:?}");
            assert_eq!(derivative, law.stress_derivative(&d), "{law:?}");
            assert_eq!(law.at(&d, None), (energy, stress), "{law:?}");
        }
    }
}

#[test]
fn stress_derivative_is_the_derivative_of_stress() {
    for law in laws() {
        for d in states() {
            let step = gradient(2.0, 0.3);
            let slope = (law.stress(&(d + step * H)) - law.stress(&(d - step * H))) / (2.0 * H);
            let c = law.stress_derivative(&d);
            let scale = along(&c, &step).norm() + LAME[0];
            assert!((slope - along(&c, &step)).norm() < 2e-8 * scale, "{law:?} at {d}");
            for (i, row) in c.iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    assert!((value - c[j][i]).abs() < 1e-13 * scale, "major symmetry at {i},{j}");
                }
            }
        }
    }
}

#[test]
fn derivatives_at_rest_are_those_of_the_stress() {
    let (a, b) = (gradient(0.4, 0.3), gradient(2.0, 0.3));
    for law in laws() {
        let rest = law.at_rest();
        assert!((rest.lame[0] - LAME[0]).abs() < 1e-9 && (rest.lame[1] - LAME[1]).abs() < 1e-9);
        let first = along(&law.stress_derivative(&Mat3::zeros()), &a);
        assert!((rest.stress_derivative(&a) - first).norm() < 1e-13 * first.norm(), "{law:?}");
        let slope = (along(&law.stress_derivative(&(b * H)), &a)
            - along(&law.stress_derivative(&(b * -H)), &a))
            / (2.0 * H);
        let exact = rest.stress_second_derivative(&a, &b);
        let other = rest.stress_second_derivative(&b, &a);
        assert!((slope - exact).norm() < 1e-8 * first.norm(), "{law:?}: {slope} {exact}");
        assert!((exact - other).norm() <= 1e-14 * first.norm());
        // Near rest all laws are linear elasticity, to the last digits.
        let small = law.stress(&(a * 1e-9)) / 1e-9;
        assert!((small - first).norm() < 1e-7 * first.norm(), "{law:?}");
        let energy = law.energy_density(&(a * 1e-9)) / 1e-18;
        assert!((energy - 0.5 * first.dot(&a)).abs() < 1e-7 * energy, "{law:?}");
    }
}

#[test]
fn a_rotation_costs_nothing_and_turns_the_stress() {
    let q = nalgebra::Rotation3::from_euler_angles(0.3, -1.1, 2.0).into_inner();
    for law in laws().into_iter().filter(|law| law.law != Law::Linear) {
        let free = law.energy_density(&(q - Mat3::identity()));
        assert!(free.abs() < 1e-15 * LAME[0], "{law:?}: {free}");
        assert!(law.stress(&(q - Mat3::identity())).norm() < 1e-14 * LAME[0], "{law:?}");
        for d in states() {
            let turned = q * (d + Mat3::identity()) - Mat3::identity();
            let expected = q * law.stress(&d);
            assert!((law.stress(&turned) - expected).norm() < 1e-12 * expected.norm(), "{law:?}");
            let energies = [law.energy_density(&turned), law.energy_density(&d)];
            assert!((energies[0] - energies[1]).abs() < 1e-12 * energies[1].abs(), "{law:?}");
        }
    }
}

#[test]
fn nothing_is_infinite_where_a_tet_collapses_or_turns_inside_out() {
    let identity = Mat3::identity();
    let collapsed = [
        -identity,
        Mat3::from_diagonal(&[0.0, 0.0, -1.0].into()),
        Mat3::from_diagonal(&[0.0, -1.0, -1.0].into()),
        Mat3::from_diagonal(&[-2.0, -2.0, -2.0].into()),
        Mat3::from_diagonal(&[0.0, 0.0, -2.0].into()),
        identity * 1e3,
    ];
    for law in laws() {
        for d in &collapsed {
            let energy = law.energy_density(d);
            // A reflection has no strain, as St. Venant and Kirchhoff see it.
            assert!(energy.is_finite() && energy >= 0.0, "{law:?} at {d}: {energy}");
            assert!(law.stress(d).iter().all(|x| x.is_finite()), "{law:?} at {d}");
            let c = law.stress_derivative(d);
            assert!(c.iter().flatten().all(|x| x.is_finite()), "{law:?} at {d}");
        }
    }
}

#[test]
fn constants_without_a_body_are_refused() {
    assert_eq!(Material::stvk(0.0, 0.3, 1.0), Err(MaterialError::YoungModulus(0.0)));
    assert_eq!(Material::stvk(1.0, 0.5, 1.0), Err(MaterialError::PoissonRatio(0.5)));
    assert_eq!(Material::stvk(1.0, 0.3, -1.0), Err(MaterialError::Density(-1.0)));
    let mooney = |poisson_ratio| Material::new(Law::MooneyRivlin, 1e5, poisson_ratio, 1e3);
    let ratio = |x: f64| mooney(0.4).unwrap().with_mooney_ratio(x);
    assert_eq!(ratio(1.5), Err(MaterialError::MooneyRatio(1.5)));
    assert!(ratio(f64::NAN).is_err());
    assert_eq!(ratio(0.7).unwrap().scaled(2.0).unwrap().mooney_ratio(), 0.7);
    let without_bulk = mooney(-0.5).unwrap().with_mooney_ratio(1.0);
    assert!(matches!(without_bulk, Err(MaterialError::NoBulk { .. })), "{without_bulk:?}");
}
