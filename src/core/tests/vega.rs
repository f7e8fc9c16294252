//! Agreement with VegaFEM 4, an independent C++ code (`tests/data/reference/vega_*.json`).
//! Its conventions: consistent mass; fields for the comparison are analytic.

use crate::bodies::{column, dot, field, norm, spectrum_error};
use nalgebra::Vector3;
use serde_json::Value;
use std::sync::Arc;
use sutura_core::assembly::FullModel;
use sutura_core::build::{self, BuildParams, MassKind, RayleighDamping};
use sutura_core::control::Uncontrolled;
use sutura_core::derivatives;
use sutura_core::factorization::SparseCholesky;
use sutura_core::linalg;
use sutura_core::material::Material;
use sutura_core::mesh::{self, MeshFormat, MeshLimits, TetMesh};
use sutura_core::testing::{Bar, Cell, Cut};

fn params(material: Material, fixed_vertices: Vec<u32>, n_modes: usize) -> BuildParams {
    BuildParams {
        materials: vec![material],
        fixed_vertices,
        mass: MassKind::Consistent,
        n_modes,
        basis_size: n_modes,
        n_derivative_modes: 0,
        cubature: None,
        damping: RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 },
        seams: Vec::new(),
    }
}

#[test]
fn modes_of_a_box_held_at_one_end_and_free() {
    let bar =
        Bar { size_m: [2.0, 0.6, 0.4], n_cells: [8, 3, 2], cell: Cell::Five, cut: Cut::Whole }
            .mesh();
    let material = Material::stvk(1e6, 0.45, 1000.0).unwrap();
    let held = params(material, bar.root, 20);
    let held = build::build(bar.mesh.clone(), &held, &Uncontrolled).unwrap();
    let mass: f64 = held.lumped_mass_kg().iter().sum();
    assert!((mass - 480.0).abs() < 1e-9);
    let lambda = held.eigenvalues_per_s2();
    let expected = [18.77912348, 30.94692292, 328.8589659, 477.9717657, 608.2429908, 705.3380282];
    // The reference is printed to ten digits.
    assert!(spectrum_error(&lambda[..6], &expected) < 1e-9, "{lambda:?}");
    assert!((lambda[19] / 24640.33586 - 1.0).abs() < 1e-9);

    let free = build::build(bar.mesh, &params(material, vec![], 3), &Uncontrolled).unwrap();
    assert_eq!(free.n_rigid_modes(), 6);
    let expected = [526.6968734, 759.3891792, 1290.403506];
    assert!(spectrum_error(free.eigenvalues_per_s2(), &expected) < 1e-9);
}

struct Beam {
    mesh: Arc<TetMesh>,
    material: Material,
    reference: Value,
}

impl Beam {
    fn load() -> Beam {
        let bytes = include_bytes!("../../../tests/data/formats/beam3_tet.veg");
        let limits = MeshLimits { max_vertices: 1000, max_tets: 1000 };
        let file = mesh::read(bytes, MeshFormat::Vega, &limits).unwrap();
        let text = include_str!("../../../tests/data/reference/vega_beam3_tet.json");
        Beam {
            mesh: Arc::new(file.mesh),
            material: file.materials[&0],
            reference: serde_json::from_str(text).unwrap(),
        }
    }

    fn number(&self, name: &str) -> f64 {
        self.reference[name].as_f64().unwrap_or_else(|| panic!("{name}"))
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        self.reference[name].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
    }

    fn fixed(&self) -> Vec<u32> {
        self.numbers("fixed_vertices_0indexed").iter().map(|&v| v as u32).collect()
    }

    /// Relative to `scale`, or to the reference.
    fn assert_agrees(&self, name: &str, found: f64, scale: Option<f64>) {
        let expected = self.number(name);
        let error = (found - expected).abs() / scale.unwrap_or(expected.abs());
        assert!(error < 1e-9, "{name}: {found:e} instead of {expected:e}");
    }
}

#[test]
fn energy_force_stiffness_and_second_derivative_of_a_beam() {
    let beam = Beam::load();
    let model = FullModel::new(beam.mesh.clone(), &[beam.material], &[]);
    let (low, high) = (beam.numbers("bbox_min"), beam.numbers("bbox_max"));
    let centre = Vector3::from_fn(|i, _| 0.5 * (low[i] + high[i]));
    let r = 0.5 * beam.mesh.diagonal();
    beam.assert_agrees("R", r, None);
    let at = |f: fn(Vector3<f64>) -> Vector3<f64>| {
        field(&beam.mesh, model.free_vertices(), |x| r * f((x - centre) / r))
    };
    let u = at(|s| Vector3::new(0.1 * (2.0 * s.y).sin(), 0.1 * s.x * s.z, 0.03 * s.x * s.x));
    let v = at(|s| Vector3::new(s.x, s.y * s.y, s.z.cos()));
    let w = at(|s| Vector3::new(s.z, s.x * s.y, 0.5));

    let pattern = Arc::new(model.pattern(&[]));
    beam.assert_agrees("volume", model.volumes_m3().iter().sum(), None);
    beam.assert_agrees("ref_energy_u", model.energy(&u), None);

    let f = model.internal_force(&u);
    beam.assert_agrees("ref_f_u_norm", norm(&f), None);
    beam.assert_agrees("ref_f_u_dot_v", dot(&f, &v), None);
    beam.assert_agrees("ref_f_u_dot_w", dot(&f, &w), None);
    for (found, expected) in f.iter().zip(beam.numbers("ref_f_u_first12")) {
        assert!((found - expected).abs() < 1e-12 * norm(&f));
    }

    let times = |u: &[f64], x: &[f64]| {
        model.tangent_stiffness(u, &pattern).multiply(column(x)).col_as_slice(0).to_vec()
    };
    let kv = times(&u, &v);
    beam.assert_agrees("ref_Ku_v_norm", norm(&kv), None);
    beam.assert_agrees("ref_v_Ku_v", dot(&v, &kv), None);
    beam.assert_agrees("ref_v_Ku_w", dot(&w, &kv), None);
    let k0v = times(&vec![0.0; model.n()], &v);
    beam.assert_agrees("ref_K0_v_norm", norm(&k0v), None);

    let mass = model.mass(MassKind::Consistent, &pattern);
    beam.assert_agrees("ref_v_M_v", mass.inner(column(&v), column(&v))[(0, 0)], None);
    beam.assert_agrees("ref_v_M_w", mass.inner(column(&v), column(&w))[(0, 0)], None);

    let vw = linalg::concatenate(&[column(&v), column(&w)]);
    let h = model.second_derivatives_at_rest(vw.as_ref(), &[[0, 1]]).col_as_slice(0).to_vec();
    beam.assert_agrees("ref_H_vw_norm", norm(&h), None);
    beam.assert_agrees("ref_H_vw_dot_u", dot(&h, &u), None);
    // Zero but for rounding.
    beam.assert_agrees("ref_H_vw_dot_v", dot(&h, &v), Some(norm(&h) * norm(&v)));
    for (found, expected) in h.iter().zip(beam.numbers("ref_H_vw_first12")) {
        assert!((found - expected).abs() < 1e-12 * norm(&h));
    }
}

#[test]
fn modes_and_modal_derivatives_of_a_beam() {
    let beam = Beam::load();
    let params = params(beam.material, beam.fixed(), 20);
    let built = build::build(beam.mesh.clone(), &params, &Uncontrolled).unwrap();
    assert_eq!(built.n_free_dofs() as f64, beam.number("num_free_dofs"));
    // The reference's own eigenvalues are good to about 1e-8 (conditioning of slender beams).
    let error = spectrum_error(built.eigenvalues_per_s2(), &beam.numbers("eigenvalues"));
    assert!(error < 1e-7, "{error:e}");

    let model = built.full_model();
    let pattern = Arc::new(model.pattern(&[]));
    let mass = model.mass(MassKind::Consistent, &pattern);
    let shapes = faer::Mat::from_fn(model.n(), 20, |i, j| {
        built.mode(j)[3 * model.free_vertices()[i / 3] as usize + i % 3]
    });
    let mut solved = derivatives::right_hand_sides(model, shapes.as_ref(), &Uncontrolled).unwrap();
    SparseCholesky::of_blocks(&model.rest_stiffness(&pattern))
        .unwrap()
        .solve_in_place(solved.as_mut());
    let weighted = mass.multiply(solved.as_ref());
    let expected = beam.numbers("moddev_massnorms_ij_upper");
    for (column, [i, j]) in derivatives::pairs(20).into_iter().enumerate() {
        // The reference's order: (0,0), (0,1) … (0,19), (1,1) …
        let at = i * 20 - i * (i + 1) / 2 + j;
        let squared: f64 = solved.col(column).transpose() * weighted.col(column);
        let error = (squared.sqrt() / expected[at] - 1.0).abs();
        assert!(error < 1e-7, "Φ of modes {i} and {j}: {error:e}");
    }
}
