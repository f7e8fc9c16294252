//! Linear modes against theory.

use crate::bodies::{column, params};
use std::f64::consts::PI;
use sutura_core::build::{self, Artifacts, BuildParams, MassKind};
use sutura_core::control::Uncontrolled;
use sutura_core::material::Material;
use sutura_core::modes;
use sutura_core::testing::{Bar, BarMesh, Cell, Cut};

const E_PA: f64 = 1e6;
const DENSITY_KG_M3: f64 = 1000.0;

/// A slender bar, 1 × 0.1 × 0.1 m, without lateral contraction, so that theory of beams applies.
fn slender(refinement: usize) -> BarMesh {
    let n_cells = [10, 1, 1].map(|n| n * refinement);
    Bar { size_m: [1.0, 0.1, 0.1], n_cells, cell: Cell::Five, cut: Cut::Whole }.mesh()
}

fn built(bar: &BarMesh, fixed: Vec<u32>, mass: MassKind, n_modes: usize) -> Artifacts {
    let params = BuildParams {
        materials: vec![Material::stvk(E_PA, 0.0, DENSITY_KG_M3).unwrap()],
        fixed_vertices: fixed,
        mass,
        ..params(bar, n_modes)
    };
    build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap()
}

#[test]
fn modes_are_mass_orthonormal_and_solve_their_equation() {
    for fixed in [true, false] {
        for kind in [MassKind::Lumped, MassKind::Consistent] {
            let bar = slender(2);
            let built = built(&bar, if fixed { bar.root.clone() } else { vec![] }, kind, 20);
            let model = built.full_model();
            let pattern = std::sync::Arc::new(model.pattern(&[]));
            let mass = model.mass(kind, &pattern);
            let shapes = faer::Mat::from_fn(model.n(), 20, |i, j| {
                built.mode(j)[3 * model.free_vertices()[i / 3] as usize + i % 3]
            });
            let error = modes::orthonormality_error(&mass, shapes.as_ref());
            assert!(error < 1e-10, "{kind:?} {fixed}: ‖ΦᵀMΦ − I‖ = {error:e}");
            let residual = modes::residual_vectors(
                model.rest_stiffness(&pattern).multiply(shapes.as_ref()),
                &mass,
                shapes.as_ref(),
                built.eigenvalues_per_s2(),
            );
            let weighted = mass.multiply(shapes.as_ref());
            for (j, lambda) in built.eigenvalues_per_s2().iter().enumerate() {
                let relative = residual.col(j).norm_l2() / (lambda * weighted.col(j).norm_l2());
                assert!(relative < 1e-6, "{kind:?} {fixed}: mode {j}: {relative:e}");
            }
            assert!(built.residuals().iter().all(|r| *r < 1e-8), "{:?}", built.residuals());
        }
    }
}

#[test]
fn a_free_bar_vibrates_along_its_axis_at_half_the_wave_speed_over_its_length() {
    // u = cos(πx/L) solves the three-dimensional equations for ν = 0: λ = (π/L)² E/ρ. Linear
    // elements with a consistent mass have a relative error of about (πh/L)²/12 in λ.
    let exact = PI.powi(2) * E_PA / DENSITY_KG_M3;
    let error = |refinement: usize| {
        let bar = slender(refinement);
        let built = built(&bar, vec![], MassKind::Consistent, 14);
        assert_eq!(built.n_rigid_modes(), 6);
        let model = built.full_model();
        let mass = model.mass(MassKind::Consistent, &std::sync::Arc::new(model.pattern(&[])));
        let wave: Vec<f64> =
            bar.mesh.vertices().iter().flat_map(|x| [(PI * x[0]).cos(), 0.0, 0.0]).collect();
        let size = mass.inner(column(&wave), column(&wave))[(0, 0)];
        let axial = (0..built.n_modes())
            .find(|&i| {
                let likeness = mass.inner(column(&built.mode(i)), column(&wave))[(0, 0)];
                likeness.powi(2) > 0.98 * size
            })
            .expect("an axial mode");
        built.eigenvalues_per_s2()[axial] / exact - 1.0
    };
    let (coarse, fine) = (error(1), error(2));
    let expected = (PI / 10.0).powi(2) / 12.0;
    assert!(coarse > 0.0 && coarse < 2.0 * expected, "{coarse:e}, expected {expected:e}");
    assert!((coarse / fine - 4.0).abs() < 0.5, "second order: {coarse:e} {fine:e}");
}

#[test]
fn a_cantilever_bends_at_the_frequency_of_beam_theory() {
    // Euler–Bernoulli: λ = (1.875104/L)⁴ EI/(ρA) with I/A = h²/12. Linear tets are too stiff in
    // bending by O(h²): two meshes extrapolate to a value from which shear and rotary inertia, of
    // order (h/L)², take about 1 %.
    let exact = 1.8751041_f64.powi(4) * E_PA * 0.1f64.powi(2) / 12.0 / DENSITY_KG_M3;
    let lambda = |refinement: usize| {
        let bar = slender(refinement);
        built(&bar, bar.root.clone(), MassKind::Consistent, 4).eigenvalues_per_s2()[0]
    };
    let values = [2, 4, 6].map(lambda);
    let errors = values.map(|l| l / exact - 1.0);
    assert!(errors[0] > errors[1] && errors[1] > errors[2] && errors[2] > 0.0, "{errors:?}");
    let extrapolated = values[2] + (values[2] - values[1]) / ((6.0f64 / 4.0).powi(2) - 1.0);
    let error = (extrapolated / exact - 1.0).abs();
    assert!(error < 0.02, "extrapolated {error:e}, meshes {errors:?}");
}
