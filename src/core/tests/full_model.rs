//! The full-order model: forces, stiffness and its derivative, mass, rigid motions.

use crate::bodies::{by_rows, column, dot, field, irregular, norm, soft, vector};
use faer::Mat;
use nalgebra::{Matrix3, Vector3};
use std::sync::Arc;
use sutura_core::assembly::FullModel;
use sutura_core::assembly::sparse::BlockMatrix;
use sutura_core::build::MassKind;
use sutura_core::material::Hyperelastic;
use sutura_core::modes::rigid::rigid_modes;
use sutura_core::testing::differences::slope;
use sutura_core::testing::{Bar, Cell, Cut};

fn times(matrix: &BlockMatrix, x: &[f64]) -> Vec<f64> {
    matrix.multiply(column(x)).col_as_slice(0).to_vec()
}

/// Largest displacement that the differences are taken at: 4 % of the block.
const AMPLITUDE_M: f64 = 0.01;

#[test]
fn patch_test_a_linear_field_has_constant_stress_and_no_force_inside() {
    let mesh = irregular();
    let model = FullModel::new(mesh.clone(), &[soft()], &[]);
    let gradient = Matrix3::from_fn(|i, j| 0.1 * ((3 * i + j) as f64 * 1.3).sin());
    let u = field(&mesh, model.free_vertices(), |x| gradient * x);
    let law = model.elasticities()[0];
    let stress = law.stress(&gradient);
    for tet in 0..mesh.tets().len() {
        let d = model.displacement_gradient(tet, &u);
        assert!((law.stress(&d) - stress).norm() < 1e-12 * stress.norm());
    }
    let energy = law.energy_density(&gradient) * model.volumes_m3().iter().sum::<f64>();
    assert!((model.energy(&u) / energy - 1.0).abs() < 1e-12);

    // The one vertex of a 2 × 2 × 2 block that lies inside.
    let inside = 13;
    let force = model.internal_force(&u);
    let largest = force.iter().fold(0.0f64, |m, f| m.max(f.abs()));
    assert!(largest > 1.0, "the surface carries the stress");
    assert!(norm(&model.expand(&force)[3 * inside..][..3]) < 1e-13 * largest);
    // In balance as a whole.
    for axis in 0..3 {
        let sum: f64 = force.iter().skip(axis).step_by(3).sum();
        assert!(sum.abs() < 1e-12 * largest);
    }
}

#[test]
fn force_is_the_gradient_of_energy_and_stiffness_of_force() {
    let mesh = irregular();
    let model = FullModel::new(mesh, &[soft()], &[0, 1, 5]);
    let pattern = Arc::new(model.pattern(&[]));
    let u = vector(model.n(), AMPLITUDE_M, 2.0);
    let v = vector(model.n(), AMPLITUDE_M, 3.0);
    slope(|u| vec![model.energy(u)], &u, &v)
        .assert_is(&[dot(&model.internal_force(&u), &v)], "energy");
    let tangent = model.tangent_stiffness(&u, &pattern);
    slope(|u| model.internal_force(u), &u, &v).assert_is(&times(&tangent, &v), "force");
}

#[test]
fn second_derivative_at_rest_is_the_derivative_of_the_stiffness() {
    let mesh = irregular();
    let model = FullModel::new(mesh, &[soft()], &[0, 1, 5]);
    let pattern = Arc::new(model.pattern(&[]));
    let [v, w] = [4.0, 5.0].map(|seed| vector(model.n(), AMPLITUDE_M, seed));
    let vw = Mat::from_fn(model.n(), 2, |i, j| [&v, &w][j][i]);
    let wv = Mat::from_fn(model.n(), 2, |i, j| vw[(i, 1 - j)]);
    let [vw, wv] = [vw, wv].map(|x| model.second_derivatives_at_rest(x.as_ref(), 1.0));
    // Pairs (0, 0), (0, 1), (1, 1).
    let (h_vw, h_wv) = (vw.col_as_slice(1), wv.col_as_slice(1));
    let rest = vec![0.0; model.n()];
    slope(|u| times(&model.tangent_stiffness(u, &pattern), &w), &rest, &v)
        .assert_is(h_vw, "(H:v)w");
    // Symmetric in v and w.
    let difference: Vec<f64> = h_vw.iter().zip(h_wv).map(|(a, b)| a - b).collect();
    assert!(norm(&difference) < 1e-14 * norm(h_vw));
}

#[test]
fn tiled_sums_are_the_sums_over_tets() {
    // 1440 tets: several tiles; blocks of columns that are full and that are not.
    let bar =
        Bar { size_m: [0.3, 0.2, 0.2], n_cells: [8, 6, 6], cell: Cell::Five, cut: Cut::HalfDepth };
    let bar = bar.mesh();
    let model = FullModel::new(bar.mesh, &[soft()], &bar.root);
    let force_of = |stress: &dyn Fn(usize) -> Matrix3<f64>| {
        let mut force = vec![0.0; model.n()];
        for (tet, corners) in model.corners().iter().enumerate() {
            let p = stress(tet) * model.volumes_m3()[tet];
            for (&v, g) in corners.iter().zip(&model.gradients()[tet]) {
                let Some(force) = force.get_mut(3 * v as usize..) else { continue };
                let f = p * Vector3::from(*g);
                (0..3).for_each(|axis| force[axis] += f[axis]);
            }
        }
        force
    };
    let assert_close = |found: &[f64], exact: Vec<f64>, what: &str| {
        let error: Vec<f64> = found.iter().zip(&exact).map(|(f, e)| f - e).collect();
        assert!(norm(&error) < 1e-14 * norm(&exact), "{what}: {:e}", norm(&error) / norm(&exact));
    };
    for k in [1, 2, 5, 8, 11, 19] {
        let x = Mat::from_fn(model.n(), k, |i, j| vector(1, AMPLITUDE_M, (i + 7919 * j) as f64)[0]);
        let gradients: Vec<Vec<Matrix3<f64>>> = (0..k)
            .map(|j| {
                let of = |tet| model.displacement_gradient(tet, x.col_as_slice(j));
                (0..model.corners().len()).map(of).collect()
            })
            .collect();
        let forces = model.internal_forces(x.as_ref());
        let derivatives = model.second_derivatives_at_rest(x.as_ref(), -3.0);
        let pairs = sutura_core::derivatives::pairs(k);
        assert_eq!(derivatives.ncols(), pairs.len());
        for (j, gradients) in gradients.iter().enumerate() {
            let stress = |tet: usize| model.elasticities()[tet].stress(&gradients[tet]);
            assert_close(forces.col_as_slice(j), force_of(&stress), "force");
        }
        for (column, [i, j]) in pairs.into_iter().enumerate() {
            let stress = |tet: usize| {
                let [a, b] = [i, j].map(|m| &gradients[m][tet]);
                model.elasticities()[tet].at_rest().stress_second_derivative(a, b) * -3.0
            };
            assert_close(derivatives.col_as_slice(column), force_of(&stress), "derivative");
        }
    }
}

#[test]
fn reduced_forces_are_the_products_of_forces_with_the_basis() {
    // More vertices than one task takes, and vectors than one pass over the tets does.
    let bar =
        Bar { size_m: [0.3, 0.2, 0.2], n_cells: [8, 6, 6], cell: Cell::Five, cut: Cut::HalfDepth };
    let bar = bar.mesh();
    let model = FullModel::new(bar.mesh, &[soft()], &bar.root);
    let basis = Mat::from_fn(model.n(), 7, |i, j| ((3 * i + 7 * j * i) as f64).sin());
    for t in [1, 8, 50] {
        let q = Mat::from_fn(7, t, |i, j| 0.1 * AMPLITUDE_M * ((2 * i + 3 * j) as f64).cos());
        let mut exact = Mat::zeros(7, t);
        for pose in 0..t {
            let force =
                model.internal_force((&basis * q.col(pose)).try_as_col_major().unwrap().as_slice());
            exact.col_mut(pose).copy_from(basis.transpose() * column(&force).col(0));
        }
        let found = model.reduced_forces(basis.as_ref(), q.as_ref());
        assert!((&found - &exact).norm_l2() < 1e-13 * exact.norm_l2());
    }
}

#[test]
fn stiffness_is_symmetric_and_at_rest_is_the_tangent_at_zero() {
    let mesh = irregular();
    let model = FullModel::new(mesh, &[soft()], &[7]);
    let pattern = Arc::new(model.pattern(&[]));
    let n = model.n();
    let dense = |m: &BlockMatrix| m.multiply(Mat::<f64>::identity(n, n).as_ref());
    let rest = dense(&model.rest_stiffness(&pattern));
    let at_zero = dense(&model.tangent_stiffness(&vec![0.0; n], &pattern));
    assert!((&rest - &at_zero).norm_max() < 1e-14 * rest.norm_max());
    let bent = dense(&model.tangent_stiffness(&vector(n, AMPLITUDE_M, 6.0), &pattern));
    for k in [&rest, &bent] {
        assert!((k - k.transpose()).norm_max() < 1e-14 * k.norm_max());
    }
    assert!((&rest - &bent).norm_max() > 1e-2 * rest.norm_max());
}

#[test]
fn both_masses_sum_to_volume_times_density_along_each_axis() {
    let mesh = irregular();
    let model = FullModel::new(mesh, &[soft()], &[]);
    let total: f64 = 1000.0 * model.volumes_m3().iter().sum::<f64>();
    assert!((model.lumped_mass_kg().iter().sum::<f64>() / total - 1.0).abs() < 1e-13);
    let pattern = Arc::new(model.pattern(&[]));
    for kind in [MassKind::Lumped, MassKind::Consistent] {
        let mass = model.mass(kind, &pattern);
        let unit = by_rows(
            &(0..3 * model.n())
                .map(|i| f64::from(u8::from(i / 3 % 3 == i % 3)))
                .collect::<Vec<_>>(),
            3,
        );
        let inner = mass.gram(unit.as_ref());
        for (i, j) in (0..9).map(|k| (k / 3, k % 3)) {
            let expected = if i == j { total } else { 0.0 };
            assert!((inner[(i, j)] - expected).abs() < 1e-13 * total, "{kind:?} {i} {j}");
        }
    }
}

#[test]
fn a_component_keeps_the_rigid_motions_that_its_supports_allow() {
    let bar =
        Bar { size_m: [0.2, 0.1, 0.1], n_cells: [4, 2, 2], cell: Cell::Five, cut: Cut::Whole };
    let mesh = bar.mesh().mesh;
    let at = |x: f64, y: f64, z: f64| {
        let near = |v: &[f64; 3]| (Vector3::from(*v) - Vector3::new(x, y, z)).norm() < 1e-9;
        mesh.vertices().iter().position(near).unwrap() as u32
    };
    let (a, b, c) = (at(0.0, 0.0, 0.0), at(0.1, 0.05, 0.05), at(0.2, 0.1, 0.1));
    let off_line = at(0.2, 0.0, 0.0);
    for (fixed, expected) in [
        (vec![], 6),
        (vec![a], 3),
        (vec![a, c], 1),
        (vec![a, b, c], 1),
        (vec![a, b, off_line], 0),
        (vec![a, b, c, off_line], 0),
    ] {
        let model = FullModel::new(mesh.clone(), &[soft()], &fixed);
        let pattern = Arc::new(model.pattern(&[]));
        let mass = model.mass(MassKind::Lumped, &pattern);
        let rigid = rigid_modes(&model, &mass).unwrap();
        assert_eq!(rigid.ncols(), expected, "fixed {fixed:?}");
        let stiffness = model.rest_stiffness(&pattern);
        let strained = stiffness.multiply(rigid.as_ref());
        assert!(strained.norm_max() < 1e-11 * stiffness.blocks()[0][0] * rigid.norm_max().max(1.0));
        let gram = mass.gram(rigid.as_ref());
        assert!(sutura_core::linalg::distance_from_identity(gram.as_ref()) < 1e-12);
    }
}

#[test]
fn a_free_cut_body_has_six_rigid_motions_for_each_half() {
    let bar = crate::bodies::bar(Cut::Through);
    let model = FullModel::new(bar.mesh.clone(), &[soft()], &[]);
    let mass = model.mass(MassKind::Consistent, &Arc::new(model.pattern(&[])));
    assert_eq!(bar.mesh.n_components(), 2);
    assert_eq!(rigid_modes(&model, &mass).unwrap().ncols(), 12);
}
