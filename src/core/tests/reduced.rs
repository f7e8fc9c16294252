//! The reduced model: gradients, cubature, the tables that a client evaluates, statics.

use crate::bodies::{STITCH_N_M, bar, by, by_rows, column, dot, norm, params, stitch, vector};
use faer::Mat;
use nalgebra::Matrix3;
use sutura_core::build::{
    self, Artifacts, BuildParams, CubatureParams, CubatureSource, Method, Selection,
};
use sutura_core::control::Uncontrolled;
use sutura_core::linalg;
use sutura_core::material::{Elasticity, Hyperelastic};
use sutura_core::reduced::Evaluation;
use sutura_core::testing::differences::slope;
use sutura_core::testing::statics::StitchedBody;
use sutura_core::testing::{BarMesh, Cut};

const CUBATURE: CubatureParams = CubatureParams {
    n_points: 150,
    n_training_poses: 40,
    tolerance: 0.02,
    seed: 7,
    selection: Selection::GreedyNnls,
    smoothing: true,
};

/// Fewer points than the tolerance needs: they are smoothed.
const FEW: CubatureParams = CubatureParams { n_points: 24, tolerance: 0.005, ..CUBATURE };

fn stitched(bar: &BarMesh, cubature: Option<CubatureParams>) -> [Artifacts; 2] {
    let params = BuildParams { basis_size: 16, cubature, ..params(bar, 10) };
    let before = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let edit = stitch(&bar.pairs, STITCH_N_M);
    let after = build::rebuild(&before, &edit, &by(Method::Flexibility), &Uncontrolled).unwrap().0;
    [before, after]
}

/// Reduced coordinates that move some vertex by about `amplitude_m`, low columns most.
fn pose(body: &Artifacts, amplitude_m: f64, seed: f64) -> Vec<f64> {
    let r = body.basis_size();
    let q: Vec<f64> =
        vector(r, 1.0, seed).iter().enumerate().map(|(i, x)| x / (1 + i * i) as f64).collect();
    let u = linalg::product(body.basis(), column(&q));
    let largest = u.norm_max();
    q.iter().map(|x| x * amplitude_m / largest).collect()
}

#[test]
fn force_is_the_gradient_of_energy_and_stiffness_of_force() {
    for cubature in [None, Some(CUBATURE), Some(FEW)] {
        for body in stitched(&bar(Cut::HalfDepth), cubature) {
            let model = body.model();
            let (q, direction) = (pose(&body, 0.01, 1.0), pose(&body, 0.005, 2.0));
            let at = model.evaluate(&q);
            slope(|q| vec![model.evaluate(q).energy_j], &q, &direction)
                .assert_is(&[dot(&at.force, &direction)], "reduced energy");
            let stiffness = by_rows(&at.stiffness, model.r());
            let product = linalg::product(stiffness.as_ref(), column(&direction));
            slope(|q| model.evaluate(q).force, &q, &direction)
                .assert_is(product.col_as_slice(0), "reduced force");
            assert_eq!(stiffness, stiffness.transpose().to_owned());
        }
    }
}

fn assert_same(found: &Evaluation, exact: &Evaluation, tolerance: f64) {
    let apart = |a: &[f64], b: &[f64]| {
        norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>()) / norm(b)
    };
    assert!((found.energy_j / exact.energy_j - 1.0).abs() < tolerance);
    assert!(apart(&found.force, &exact.force) < tolerance);
    assert!(apart(&found.stiffness, &exact.stiffness) < tolerance);
}

#[test]
fn without_cubature_the_sum_over_every_tet_is_exact() {
    for body in stitched(&bar(Cut::HalfDepth), None) {
        assert!(body.cubature().is_none());
        let q = pose(&body, 0.012, 3.0);
        assert_same(&body.model().evaluate(&q), &body.evaluate_exact(&q), 1e-12);
    }
}

#[test]
fn the_exact_sum_is_the_galerkin_projection_of_the_full_model() {
    let [_, body] = stitched(&bar(Cut::HalfDepth), None);
    let model = body.full_model();
    let q = pose(&body, 0.012, 3.0);
    let u = linalg::product(body.basis(), column(&q));
    let u = u.col_as_slice(0);
    let mut energy_j = model.energy(u);
    for s in body.stitches() {
        let all = model.expand(u);
        let [a, b] = s.pair.map(|v| 3 * v as usize);
        energy_j +=
            (0..3).map(|i| 0.5 * s.stiffness_n_m * (all[a + i] - all[b + i]).powi(2)).sum::<f64>();
    }
    assert!((body.evaluate_exact(&q).energy_j / energy_j - 1.0).abs() < 1e-12);
}

#[test]
fn cubature_is_as_exact_as_it_says_on_poses_it_has_not_seen() {
    let [before, after] = stitched(&bar(Cut::HalfDepth), Some(CUBATURE));
    assert_eq!(before.cubature().unwrap().source, CubatureSource::Trained);
    assert_ne!(after.cubature().unwrap().source, CubatureSource::Trained);
    for body in [before, after] {
        let report = *body.cubature().unwrap();
        assert!(report.n_points <= CUBATURE.n_points && report.n_points > body.basis_size());
        assert!(report.validation_error < 2.0 * CUBATURE.tolerance, "{report:?}");
        // Poses of our own: small random combinations of the basis, low columns most.
        for seed in 0..8 {
            let q = pose(&body, 0.004, 10.0 + f64::from(seed));
            let (found, exact) = (body.model().evaluate(&q), body.evaluate_exact(&q));
            let gap: Vec<f64> = found.force.iter().zip(&exact.force).map(|(a, b)| a - b).collect();
            let error = norm(&gap) / norm(&exact.force);
            assert!(error < 10.0 * CUBATURE.tolerance, "seed {seed}: {error:e}");
        }
    }
}

#[test]
fn smoothed_points_come_closer_than_tets() {
    let [smoothed, tets] = [true, false].map(|smoothing| {
        let [before, after] =
            stitched(&bar(Cut::HalfDepth), Some(CubatureParams { smoothing, ..FEW }));
        let (rule, _) = after.recipe().reuse.unwrap();
        assert_eq!(rule.smoothing.len(), if smoothing { rule.tets.len() } else { 0 });
        let report = *before.cubature().unwrap();
        assert!(report.n_points <= FEW.n_points, "{report:?}");
        report.validation_error
    });
    assert!(smoothed < 0.7 * tets, "{smoothed} {tets}");
}

#[test]
fn a_client_can_evaluate_from_the_tables_alone() {
    let bar = bar(Cut::HalfDepth);
    for body in [CUBATURE, FEW].into_iter().flat_map(|cubature| stitched(&bar, Some(cubature))) {
        let t = body.evaluator_tables();
        let r = t.r;
        let q = pose(&body, 0.01, 5.0);
        let mut energy_j = 0.0;
        let mut force = vec![0.0; r];
        for p in 0..t.tets.len() {
            let row = |corner: usize, axis: usize| {
                &t.basis_rows[((4 * p + corner) * 3 + axis) * r..][..r]
            };
            let n = |corner: usize, axis: usize| t.shape_gradients[(4 * p + corner) * 3 + axis];
            let d = Matrix3::from_fn(|i, j| (0..4).map(|a| dot(row(a, i), &q) * n(a, j)).sum());
            let law = Elasticity::stvk([t.lame_pa[2 * p], t.lame_pa[2 * p + 1]]);
            let scale = t.weights[p] * t.volumes_m3[p];
            energy_j += scale * law.energy_density(&d);
            let stress = law.stress(&d) * scale;
            for (a, i, j) in (0..36).map(|k| (k / 9, k / 3 % 3, k % 3)) {
                for (f, u) in force.iter_mut().zip(row(a, i)) {
                    *f += stress[(i, j)] * n(a, j) * u;
                }
            }
        }
        for i in 0..r {
            let stitch = dot(&t.stitch_stiffness[i * r..][..r], &q);
            energy_j += 0.5 * q[i] * stitch;
            force[i] += stitch;
        }
        let expected = body.model().evaluate(&q);
        assert!((energy_j / expected.energy_j - 1.0).abs() < 1e-12);
        let gap: Vec<f64> = force.iter().zip(&expected.force).map(|(a, b)| a - b).collect();
        assert!(norm(&gap) < 1e-12 * norm(&expected.force));
    }
}

#[test]
fn the_rest_stiffness_in_the_basis_has_the_body_s_frequencies() {
    // With every mode and derivative kept, the subspace holds the modes, and Galerkin on a space
    // that holds an eigenvector returns its eigenvalue.
    let bar = bar(Cut::HalfDepth);
    let whole = BuildParams { basis_size: 10_000, ..params(&bar, 10) };
    let body = build::build(bar.mesh.clone(), &whole, &Uncontrolled).unwrap();
    assert!(body.warnings().iter().any(|w| w.contains("columns")), "{:?}", body.warnings());
    let rest = body.model().evaluate(&vec![0.0; body.basis_size()]);
    let stiffness = by_rows(&rest.stiffness, body.basis_size());
    let (values, _) = linalg::symmetric_eigen(stiffness.as_ref()).unwrap();
    for lambda in body.eigenvalues_per_s2() {
        let nearest = values.iter().map(|v| (v / lambda - 1.0).abs()).fold(f64::INFINITY, f64::min);
        assert!(nearest < 1e-8, "{lambda}: {nearest:e}");
    }
    assert!((values[0] / body.eigenvalues_per_s2()[0] - 1.0).abs() < 1e-8);
}

#[test]
fn a_static_solution_balances_its_load() {
    let bar = bar(Cut::HalfDepth);
    for body in stitched(&bar, Some(CUBATURE)) {
        let r = body.basis_size();
        for force_n in [[0.0, 1.0, 0.0], [0.4, -0.6, 1.2], [-5.0, 0.0, 0.0]] {
            let load: Vec<f64> = bar
                .tip
                .iter()
                .map(|&v| body.vertex_load(v, force_n.map(|f| f / bar.tip.len() as f64)))
                .fold(vec![0.0; r], |sum, l| sum.iter().zip(l).map(|(a, b)| a + b).collect());
            let q = body.model().solve_static(&load, &vec![0.0; r]).unwrap();
            let force = body.model().evaluate(&q).force;
            let gap: Vec<f64> = force.iter().zip(&load).map(|(a, b)| a - b).collect();
            assert!(norm(&gap) < 2e-9 * norm(&load), "{:e}", norm(&gap) / norm(&load));
        }
    }
}

#[test]
fn the_basis_is_mass_orthonormal_and_its_rows_are_those_of_its_columns() {
    let [_, body] = stitched(&bar(Cut::HalfDepth), None);
    let model = body.full_model();
    let mass = model.mass(body.params().mass, &std::sync::Arc::new(model.pattern(&[])));
    let gram: Mat<f64> = mass.gram(body.basis());
    assert!(linalg::distance_from_identity(gram.as_ref()) < 1e-10);
    let vertex = model.free_vertices()[17];
    let rows = body.basis_rows(vertex);
    for (i, row) in rows.iter().enumerate() {
        assert_eq!(row[..], body.basis_column(i)[3 * vertex as usize..][..3]);
    }
    assert!(body.basis_rows(body.params().fixed_vertices[0]).iter().flatten().all(|x| *x == 0.0));
}

#[test]
fn statics_in_a_subspace_are_those_of_the_reduced_model_and_in_the_whole_space_those_of_the_body() {
    let bar = bar(Cut::HalfDepth);
    let after = stitched(&bar, None).into_iter().last().unwrap();
    let model = after.full_model();
    let body = StitchedBody::new(model, after.stitches()).unwrap();
    let mut load = vec![0.0; model.n()];
    for &v in &bar.tip {
        load[3 * model.free_index(v).unwrap() + 2] = 0.5 / bar.tip.len() as f64;
    }
    let whole = body.equilibrium(&load, &vec![0.0; model.n()]).unwrap();
    let linear = body.linear_response(&load).unwrap();
    let off: Vec<f64> = whole.x.iter().zip(&linear).map(|(u, l)| u - l).collect();
    assert!(norm(&off) > 0.01 * norm(&whole.x), "not a test of the nonlinear terms");

    let (error, inside) = body.error_in(after.basis(), &load, &whole.x).unwrap();
    assert!(error > 1e-5 && error < 0.1, "{error:e}");
    assert!(inside.potential_j > whole.potential_j);
    let reduced_load = linalg::gram(after.basis(), column(&load));
    let start = vec![0.0; after.basis_size()];
    let q = after.model().solve_static(reduced_load.col_as_slice(0), &start).unwrap();
    let off: Vec<f64> = q.iter().zip(&inside.x).map(|(q, x)| q - x).collect();
    assert!(norm(&off) < 1e-6 * norm(&q), "{:e}", norm(&off) / norm(&q));

    // The span of the solution alone: one more dimension and the error is gone.
    let with_it = linalg::concatenate(&[after.basis(), column(&whole.x)]);
    let (error, found) = body.error_in(with_it.as_ref(), &load, &whole.x).unwrap();
    assert!(error < 1e-6, "{error:e}");
    assert!((found.potential_j / whole.potential_j - 1.0).abs() < 1e-9);
    let by_steps = body.equilibrium_by_steps(&load, 3).unwrap();
    let off: Vec<f64> = by_steps.x.iter().zip(&whole.x).map(|(q, x)| q - x).collect();
    assert!(norm(&off) < 1e-6 * norm(&whole.x));
}
