//! The pipeline for every material law: the full-order model by differences, modes, bases and reduced
//! models.

use crate::bodies::{STITCH_N_M, bar, by, column, dot, irregular, norm, params, stitch, vector};
use faer::Mat;
use std::sync::Arc;
use sutura_core::assembly::FullModel;
use sutura_core::build::{
    self, Artifacts, BuildError, BuildParams, CubatureParams, Method, Selection,
};
use sutura_core::control::Uncontrolled;
use sutura_core::linalg;
use sutura_core::material::{Law, Material};
use sutura_core::testing::statics::StitchedBody;
use sutura_core::testing::{BarMesh, Cut};

fn material(law: Law) -> Material {
    Material::new(law, 5e5, 0.4, 1000.0).unwrap().with_mooney_ratio(0.3).unwrap()
}

/// Central differences of fourth order with steps of 1e-3 of the body: truncation and rounding both
/// stay below 1e-8 of the largest entry.
fn slope(f: impl Fn(&[f64]) -> Vec<f64>, x: &[f64], direction: &[f64]) -> Vec<f64> {
    let at = |s: f64| f(&x.iter().zip(direction).map(|(x, d)| x + s * d).collect::<Vec<f64>>());
    let points = [at(-2.0), at(-1.0), at(1.0), at(2.0)];
    (0..points[0].len())
        .map(|i| (points[0][i] - points[3][i] + 8.0 * (points[2][i] - points[1][i])) / 12.0)
        .collect()
}

fn assert_near(found: &[f64], exact: &[f64], what: &str) {
    let gap: Vec<f64> = found.iter().zip(exact).map(|(a, b)| a - b).collect();
    let error = norm(&gap) / norm(exact);
    assert!(error < 1e-6, "{what}: {error:e}");
}

#[test]
fn forces_stiffness_and_its_derivative_follow_from_the_energy() {
    for law in Law::ALL {
        let model = FullModel::new(irregular(), &[material(law)], &[0, 1, 5]);
        let pattern = Arc::new(model.pattern(&[]));
        let times = |u: &[f64], x: &[f64]| {
            model.tangent_stiffness(u, &pattern).multiply(column(x)).col_as_slice(0).to_vec()
        };
        let [u, v, w] = [(2.0, 0.01), (3.0, 2e-4), (4.0, 2e-4)]
            .map(|(seed, size)| vector(model.n(), size, seed));
        let work = dot(&model.internal_force(&u), &v);
        assert_near(&slope(|u| vec![model.energy(u)], &u, &v), &[work], "energy");
        assert_near(&slope(|u| model.internal_force(u), &u, &v), &times(&u, &v), "force");
        let vw = Mat::from_fn(model.n(), 2, |i, j| [&v, &w][j][i]);
        let second = model.second_derivatives_at_rest(vw.as_ref(), 1.0);
        let rest = vec![0.0; model.n()];
        let difference = slope(|u| times(u, &w), &rest, &v);
        if law == Law::Linear {
            assert_eq!(second.as_ref().norm_max(), 0.0);
            assert!(norm(&difference) < 1e-12 * norm(&times(&rest, &w)));
        } else {
            assert_near(&difference, second.col_as_slice(1), "(H:v)w");
        }
        let at_rest = model.rest_stiffness(&pattern).multiply(column(&w));
        assert_near(&times(&rest, &w), at_rest.col_as_slice(0), "stiffness at rest");
    }
}

fn built(bar: &BarMesh, law: Law, cubature: Option<CubatureParams>) -> Artifacts {
    let params = BuildParams {
        materials: vec![material(law)],
        basis_size: 32,
        n_derivative_modes: 6,
        cubature,
        ..params(bar, 16)
    };
    build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap()
}

#[test]
fn every_law_has_the_same_linear_modes_and_its_own_derivatives() {
    let bar = bar(Cut::HalfDepth);
    let bodies = Law::ALL.map(|law| built(&bar, law, None));
    let stvk = &bodies[Law::StVenantKirchhoff as usize];
    for (law, body) in Law::ALL.into_iter().zip(&bodies) {
        for (found, expected) in body.frequencies_hz().iter().zip(stvk.frequencies_hz()) {
            assert!((found / expected - 1.0).abs() < 1e-10, "{law:?}");
        }
        let model = body.full_model();
        let mass = model.mass(body.params().mass, &Arc::new(model.pattern(&[])));
        let same_span = mass.inner(body.basis(), stvk.basis());
        let is_same = body.basis_size() == stvk.basis_size()
            && (same_span.squared_norm_l2() - stvk.basis_size() as f64).abs() < 1e-3;
        assert_eq!(is_same, law == Law::StVenantKirchhoff, "{law:?}");
    }
    // Linear elasticity has no modal derivatives: its basis is the modes.
    assert_eq!(bodies[Law::Linear as usize].basis_size(), 16);
}

#[test]
fn statics_in_the_rebuilt_basis_are_those_of_the_body_for_every_law() {
    let bar = bar(Cut::HalfDepth);
    for law in Law::ALL {
        let before = built(&bar, law, None);
        let edit = stitch(&bar.pairs, STITCH_N_M);
        let rebuilt =
            |method| build::rebuild(&before, &edit, &by(method), &Uncontrolled).unwrap().0;
        let [scratch, after] = [Method::FromScratch, Method::Flexibility].map(rebuilt);
        let model = after.full_model();
        let body = StitchedBody::new(model, after.stitches()).unwrap();
        let mut load = vec![0.0; model.n()];
        for &v in &bar.tip {
            load[3 * model.free_index(v).unwrap() + 2] = 0.5 / bar.tip.len() as f64;
        }
        let exact = body.equilibrium_by_steps(&load, 2).unwrap();
        let [of_scratch, of_update] =
            [&scratch, &after].map(|a| body.error_in(a.basis(), &load, &exact.x).unwrap().0);
        // Linear elasticity is measured by the modes alone, which leave more.
        assert!(of_scratch < 0.05, "{law:?}: {of_scratch:e}");
        assert!(of_update < 1.1 * of_scratch + 1e-6, "{law:?}: {of_update:e} {of_scratch:e}");
        // And the reduced model solves the same problem.
        let reduced_load = linalg::gram(after.basis(), column(&load));
        let start = vec![0.0; after.basis_size()];
        let q = after.model().solve_static(reduced_load.col_as_slice(0), &start).unwrap();
        let (_, inside) = body.error_in(after.basis(), &load, &exact.x).unwrap();
        assert_near(&q, &inside.x, "reduced statics");
    }
}

#[test]
fn cubature_is_trained_for_every_law() {
    let bar = bar(Cut::HalfDepth);
    let cubature = CubatureParams {
        n_points: 100,
        n_training_poses: 40,
        tolerance: 0.02,
        seed: 7,
        selection: Selection::default(),
        smoothing: true,
    };
    for law in Law::ALL {
        let body = built(&bar, law, Some(cubature));
        let report = body.cubature().unwrap();
        assert!(report.validation_error < 0.05, "{law:?}: {report:?}");
        let q: Vec<f64> = vector(body.basis_size(), 3e-4, 1.0)
            .iter()
            .enumerate()
            .map(|(i, x)| x / (1 + i * i) as f64)
            .collect();
        let (found, exact) = (body.model().evaluate(&q), body.evaluate_exact(&q));
        let gap: Vec<f64> = found.force.iter().zip(&exact.force).map(|(a, b)| a - b).collect();
        assert!(norm(&gap) < 0.2 * norm(&exact.force), "{law:?}");
    }
}

#[test]
fn tets_can_be_stiffer_than_their_domain() {
    let bar = bar(Cut::Whole);
    let n_tets = bar.mesh.tets().len();
    let factors = |f: &dyn Fn(usize) -> f64| BuildParams {
        tet_stiffness: (0..n_tets).map(f).collect(),
        ..params(&bar, 6)
    };
    let build = |params: &BuildParams| build::build(bar.mesh.clone(), params, &Uncontrolled);
    let plain = build(&params(&bar, 6)).unwrap();
    let all = build(&factors(&|_| 4.0)).unwrap();
    for (stiff, soft) in all.frequencies_hz().iter().zip(plain.frequencies_hz()) {
        assert!((stiff / soft - 2.0).abs() < 1e-9);
    }
    let half = build(&factors(&|tet| if tet % 2 == 0 { 4.0 } else { 1.0 })).unwrap();
    let first = |body: &Artifacts| body.frequencies_hz()[0];
    assert!(first(&plain) < first(&half) && first(&half) < first(&all));
    let few = BuildParams { tet_stiffness: [1.0; 3].into(), ..params(&bar, 6) };
    assert!(matches!(build(&few), Err(BuildError::TetStiffnessCount { given: 3, .. })));
    let bad = factors(&|tet| if tet == 7 { f64::NAN } else { 1.0 });
    assert!(matches!(build(&bad), Err(BuildError::TetStiffness { tet: 7, .. })));
}
