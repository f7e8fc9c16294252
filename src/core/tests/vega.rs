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

fn params(materials: Vec<Material>, fixed_vertices: Vec<u32>, n_modes: usize) -> BuildParams {
    BuildParams {
        materials,
        tet_stiffness: [].into(),
        fixed_vertices,
        mass: MassKind::Consistent,
        n_modes,
        basis_size: n_modes,
        pca: Default::default(),
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
    let material = vec![Material::stvk(1e6, 0.45, 1000.0).unwrap()];
    let held = params(material.clone(), bar.root, 20);
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

/// A body of VegaFEM's with its figures.
struct Peer {
    mesh: Arc<TetMesh>,
    materials: Vec<Material>,
    fixed: Vec<u32>,
    reference: Value,
}

impl Peer {
    fn beam() -> Peer {
        let bytes = include_bytes!("../../../tests/data/formats/beam3_tet.veg");
        let limits = MeshLimits { max_vertices: 1000, max_tets: 1000 };
        let file = mesh::read(bytes, MeshFormat::Vega, &limits).unwrap();
        let text = include_str!("../../../tests/data/reference/vega_beam3_tet.json");
        let reference: Value = serde_json::from_str(text).unwrap();
        let fixed = serde_json::from_value(reference["fixed_vertices_0indexed"].clone()).unwrap();
        let materials = vec![file.materials[&0]];
        Peer { mesh: Arc::new(file.mesh), materials, fixed, reference }
    }

    /// The plant of three domains with its co-located vertices merged, in their original order.
    fn welded_plant() -> Peer {
        let bytes = include_bytes!("../../../tests/data/plant_small.msh");
        let limits = MeshLimits { max_vertices: 10_000, max_tets: 10_000 };
        let mesh = mesh::read(bytes, MeshFormat::Gmsh, &limits).unwrap().mesh;
        let case: Value =
            serde_json::from_str(include_str!("../../../tests/data/plant_small.json")).unwrap();
        let pairs: Vec<[usize; 2]> = serde_json::from_value(case["all_pairs"].clone()).unwrap();
        let fixed: Vec<usize> = serde_json::from_value(case["fixed_vertices"].clone()).unwrap();
        let mut kept: Vec<usize> = (0..mesh.vertices().len()).collect();
        for [a, b] in pairs {
            kept[a.max(b)] = a.min(b);
        }
        let own: Vec<usize> = (0..kept.len()).filter(|&v| kept[v] == v).collect();
        let merged = |v: usize| own.partition_point(|&o| o < kept[v]) as u32;
        let text = include_str!("../../../tests/data/reference/vega_plant_small_welded.json");
        let reference: Value = serde_json::from_str(text).unwrap();
        let constants: Vec<f64> =
            serde_json::from_value(reference["materials_density_E_nu"].clone()).unwrap();
        Peer {
            materials: constants
                .chunks(3)
                .map(|c| Material::stvk(c[1], c[2], c[0]).unwrap())
                .collect(),
            fixed: fixed.into_iter().map(merged).collect(),
            mesh: Arc::new(
                TetMesh::new(
                    own.iter().map(|&v| mesh.vertices()[v]).collect(),
                    mesh.tets().iter().map(|t| t.map(|v| merged(v as usize))).collect(),
                    mesh.labels().to_vec(),
                )
                .unwrap(),
            ),
            reference,
        }
    }

    fn number(&self, name: &str) -> f64 {
        self.reference[name].as_f64().unwrap_or_else(|| panic!("{name}"))
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        self.reference[name].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
    }

    /// Every component of `found` against the first so many printed, where there are any.
    fn assert_begins(&self, name: &str, found: &[f64]) {
        if self.reference.get(name).is_some() {
            for (found_one, expected) in found.iter().zip(self.numbers(name)) {
                assert!((found_one - expected).abs() < 1e-12 * norm(found), "{name}");
            }
        }
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
    assert_full_model_agrees(&Peer::beam());
}

#[test]
fn energy_force_stiffness_and_second_derivative_of_a_body_of_three_materials() {
    assert_full_model_agrees(&Peer::welded_plant());
}

fn assert_full_model_agrees(peer: &Peer) {
    let model = FullModel::new(peer.mesh.clone(), &peer.materials, &[]);
    let (low, high) = (peer.numbers("bbox_min"), peer.numbers("bbox_max"));
    let centre = Vector3::from_fn(|i, _| 0.5 * (low[i] + high[i]));
    let r = 0.5 * peer.mesh.diagonal();
    peer.assert_agrees("R", r, None);
    let at = |f: fn(Vector3<f64>) -> Vector3<f64>| {
        field(&peer.mesh, model.free_vertices(), |x| r * f((x - centre) / r))
    };
    let u = at(|s| Vector3::new(0.1 * (2.0 * s.y).sin(), 0.1 * s.x * s.z, 0.03 * s.x * s.x));
    let v = at(|s| Vector3::new(s.x, s.y * s.y, s.z.cos()));
    let w = at(|s| Vector3::new(s.z, s.x * s.y, 0.5));

    let pattern = Arc::new(model.pattern(&[]));
    peer.assert_agrees("volume", model.volumes_m3().iter().sum(), None);
    peer.assert_agrees("ref_energy_u", model.energy(&u), None);

    let f = model.internal_force(&u);
    peer.assert_agrees("ref_f_u_norm", norm(&f), None);
    peer.assert_agrees("ref_f_u_dot_v", dot(&f, &v), None);
    peer.assert_agrees("ref_f_u_dot_w", dot(&f, &w), None);
    peer.assert_begins("ref_f_u_first12", &model.expand(&f));

    let times = |u: &[f64], x: &[f64]| {
        model.tangent_stiffness(u, &pattern).multiply(column(x)).col_as_slice(0).to_vec()
    };
    let kv = times(&u, &v);
    peer.assert_agrees("ref_Ku_v_norm", norm(&kv), None);
    peer.assert_agrees("ref_v_Ku_v", dot(&v, &kv), None);
    peer.assert_agrees("ref_v_Ku_w", dot(&w, &kv), None);
    let k0v = times(&vec![0.0; model.n()], &v);
    peer.assert_agrees("ref_K0_v_norm", norm(&k0v), None);

    let mass = model.mass(MassKind::Consistent, &pattern);
    peer.assert_agrees("ref_v_M_v", mass.inner(column(&v), column(&v))[(0, 0)], None);
    peer.assert_agrees("ref_v_M_w", mass.inner(column(&v), column(&w))[(0, 0)], None);

    let vw = linalg::concatenate(&[column(&v), column(&w)]);
    let h = model.second_derivatives_at_rest(vw.as_ref(), 1.0).col_as_slice(1).to_vec();
    peer.assert_agrees("ref_H_vw_norm", norm(&h), None);
    peer.assert_agrees("ref_H_vw_dot_u", dot(&h, &u), None);
    // Zero but for rounding.
    peer.assert_agrees("ref_H_vw_dot_v", dot(&h, &v), Some(norm(&h) * norm(&v)));
    peer.assert_begins("ref_H_vw_first12", &model.expand(&h));
}

#[test]
fn modes_of_a_body_of_three_materials() {
    let plant = Peer::welded_plant();
    let params = params(plant.materials.clone(), plant.fixed.clone(), 20);
    let built = build::build(plant.mesh.clone(), &params, &Uncontrolled).unwrap();
    assert_eq!(built.n_free_dofs() as f64, plant.number("num_free_dofs"));
    let error = spectrum_error(built.eigenvalues_per_s2(), &plant.numbers("eigenvalues"));
    // The reference's own residuals on slender bodies.
    assert!(error < 1e-7, "{error:e}");
}

#[test]
fn modes_and_modal_derivatives_of_a_beam() {
    let beam = Peer::beam();
    let params = params(beam.materials.clone(), beam.fixed.clone(), 20);
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
        let squared: f64 = solved.as_ref().col(column).transpose() * weighted.col(column);
        let error = (squared.sqrt() / expected[at] - 1.0).abs();
        assert!(error < 1e-7, "Φ of modes {i} and {j}: {error:e}");
    }
}
