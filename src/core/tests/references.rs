//! Agreement with an independent code on real geometry, before and after stitching
//! (`tests/data/reference`).

use crate::bodies::{by, spectrum_error};
use serde_json::Value;
use std::f64::consts::TAU;
use std::sync::Arc;
use sutura_core::build::{
    self, Artifacts, BuildParams, MassKind, Method, RayleighDamping, RebuildParams,
};
use sutura_core::control::Uncontrolled;
use sutura_core::edit::Edit;
use sutura_core::material::Material;
use sutura_core::mesh::{self, MeshFormat, MeshLimits};

struct Case {
    before: Artifacts,
    edit: Vec<Edit>,
    reference: Value,
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn vertex(value: &Value) -> u32 {
    u32::try_from(value.as_u64().unwrap()).unwrap()
}

impl Case {
    fn load(mesh: &[u8], config: &str, reference: &str) -> Case {
        let limits = MeshLimits { max_vertices: 10_000, max_tets: 50_000 };
        let mesh = Arc::new(mesh::read(mesh, MeshFormat::Gmsh, &limits).unwrap().mesh);
        let [config, reference] =
            [config, reference].map(|t| serde_json::from_str::<Value>(t).unwrap());
        let materials = mesh
            .domains()
            .iter()
            .map(|label| {
                let m = &config["domain_materials"][label.to_string()];
                let number = |name: &str| m[name].as_f64().unwrap();
                Material::stvk(
                    number("young_modulus_pa"),
                    number("poisson_ratio"),
                    number("density_kg_m3"),
                )
                .unwrap()
            })
            .collect();
        let params = BuildParams {
            materials,
            tet_stiffness: [].into(),
            fixed_vertices: config["fixed_vertices"]
                .as_array()
                .unwrap()
                .iter()
                .map(vertex)
                .collect(),
            mass: MassKind::Lumped,
            n_modes: 30,
            basis_size: 10,
            pca: Default::default(),
            n_derivative_modes: 0,
            cubature: None,
            damping: RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 },
            seams: Vec::new(),
        };
        let pairs = config["stitches"]
            .as_array()
            .unwrap()
            .iter()
            .map(|pair| [vertex(&pair[0]), vertex(&pair[1])])
            .collect();
        let stiffness_n_m = reference["stitch_stiffness_n_m"].as_f64().unwrap();
        Case {
            before: build::build(mesh, &params, &Uncontrolled).unwrap(),
            edit: vec![Edit::Stitch { pairs, stiffness_n_m }],
            reference,
        }
    }

    fn eigenvalues(&self, name: &str) -> Vec<f64> {
        numbers(&self.reference[name]).iter().map(|hz| (TAU * hz).powi(2)).collect()
    }

    fn after(&self, params: &RebuildParams) -> Artifacts {
        build::rebuild(&self.before, &self.edit, params, &Uncontrolled).unwrap().0
    }

    fn check(&self) {
        let name = &self.reference["case"];
        let mass: f64 = self.before.lumped_mass_kg().iter().sum();
        assert!((mass / self.reference["total_mass_kg"].as_f64().unwrap() - 1.0).abs() < 1e-12);
        let n_rigid = self.reference["n_rigid_modes_before"].as_u64().unwrap();
        assert_eq!(self.before.n_rigid_modes() as u64, n_rigid);
        let before = self.eigenvalues("frequencies_hz_before");
        let error = spectrum_error(self.before.eigenvalues_per_s2(), &before);
        assert!(error < 1e-8, "{name} before: {error:e}");

        let after = self.eigenvalues("frequencies_hz_after");
        let exact = self.after(&by(Method::FromScratch));
        let error = spectrum_error(exact.eigenvalues_per_s2(), &after);
        assert!(error < 1e-8, "{name} from scratch: {error:e}");

        let updated = self.after(&by(Method::Flexibility));
        assert!(updated.warnings().is_empty(), "{name}: {:?}", updated.warnings());
        let lower = spectrum_error(&updated.eigenvalues_per_s2()[..15], &after[..15]);
        assert!(lower < 1e-4, "{name} flexibility: {lower:e}");
        let upper = spectrum_error(&updated.eigenvalues_per_s2()[15..], &after[15..]);
        assert!(upper < 1e-2, "{name} flexibility, upper half: {upper:e}");

        let low_rank = self.after(&by(Method::LowRank)).frequencies_hz();
        let expected = numbers(&self.reference["low_rank_frequencies_hz"]);
        for (found, expected) in low_rank.iter().zip(&expected) {
            // Frequencies that should be zero are rounding in either code.
            let is_zero = *expected < 0.01;
            assert!(
                if is_zero { *found < 0.01 } else { (found / expected - 1.0).abs() < 1e-4 },
                "{name} low rank: {found} instead of {expected}"
            );
        }
    }
}

macro_rules! case {
    ($name:literal) => {
        Case::load(
            include_bytes!(concat!("../../../tests/data/", $name, ".msh")),
            include_str!(concat!("../../../tests/data/", $name, ".json")),
            include_str!(concat!("../../../tests/data/reference/", $name, ".json")),
        )
    };
}

#[test]
fn stomach_with_an_incision() {
    case!("stomach_small").check();
}

#[test]
fn plant_of_three_domains_two_of_them_free() {
    case!("plant_small").check();
}

#[test]
fn fork_with_a_free_head() {
    case!("fork_small").check();
}
