//! Reduced motion of a stitched bar against its full-order motion, for every material law, found by another
//! code with forces by automatic differentiation (`tests/data/reference/trajectories.py`).

use crate::bodies::{by, params, stitch};
use serde_json::Value;
use std::sync::Arc;
use sutura_core::build::{
    self, Artifacts, BuildParams, CubatureParams, Method, RayleighDamping, Selection,
};
use sutura_core::control::Uncontrolled;
use sutura_core::material::{Law, Material};
use sutura_core::mesh::TetMesh;
use sutura_core::reduced::{Integrator, Simulation, SimulationParams};
use sutura_core::testing::{Bar, Cell, Cut};

const DT_S: f64 = 1e-3;

struct Reference(Value);

impl Reference {
    fn load() -> Reference {
        let text = include_str!("../../../tests/data/reference/trajectories.json");
        Reference(serde_json::from_str(text).unwrap())
    }

    fn number(&self, name: &str) -> f64 {
        self.0[name].as_f64().unwrap()
    }

    fn rows<const N: usize>(&self, name: &str) -> Vec<[u32; N]> {
        serde_json::from_value::<Vec<Vec<u32>>>(self.0[name].clone())
            .unwrap()
            .into_iter()
            .map(|row| row.try_into().unwrap())
            .collect()
    }

    fn vector(&self, name: &str) -> [f64; 3] {
        serde_json::from_value(self.0[name].clone()).unwrap()
    }

    fn series(&self, law: Law, name: &str) -> Vec<f64> {
        let law = match law {
            Law::Linear => "linear",
            Law::StVenantKirchhoff => "stvk",
            Law::NeoHookean => "neo_hookean",
            Law::MooneyRivlin => "mooney_rivlin",
            Law::Corotational => "corotational",
        };
        serde_json::from_value(self.0["laws"][law][name].clone()).unwrap()
    }

    /// The two halves, built apart and stitched by an edit.
    fn body(&self, law: Law, cubature: Option<CubatureParams>) -> Artifacts {
        let vertices = serde_json::from_value(self.0["vertices_m"].clone()).unwrap();
        let mesh = Arc::new(TetMesh::new(vertices, self.rows("tets"), Vec::new()).unwrap());
        let [young, poisson, density] =
            ["young_modulus_pa", "poisson_ratio", "density_kg_m3"].map(|name| self.number(name));
        let material = Material::new(law, young, poisson, density)
            .unwrap()
            .with_mooney_ratio(self.number("mooney_ratio"))
            .unwrap();
        let [mass_per_s, stiffness_s]: [f64; 2] =
            serde_json::from_value(self.0["damping"].clone()).unwrap();
        let unit = Bar { size_m: [1.0; 3], n_cells: [2, 1, 1], cell: Cell::Six, cut: Cut::Whole };
        let params = BuildParams {
            materials: vec![material],
            fixed_vertices: serde_json::from_value(self.0["fixed_vertices"].clone()).unwrap(),
            n_derivative_modes: if law == Law::Linear { 0 } else { 8 },
            basis_size: 50,
            cubature,
            damping: RayleighDamping { mass_per_s, stiffness_s },
            ..params(&unit.mesh(), 24)
        };
        let apart = build::build(mesh, &params, &Uncontrolled).unwrap();
        let edit = stitch(&self.rows("pairs"), self.number("stitch_n_m"));
        build::rebuild(&apart, &edit, &by(Method::Flexibility), &Uncontrolled).unwrap().0
    }
}

/// Tip and energies (kinetic, potential) at the times of the reference.
fn motion(reference: &Reference, body: &Artifacts, n_samples: usize) -> Vec<([f64; 3], [f64; 2])> {
    let params = SimulationParams {
        dt_s: DT_S,
        integrator: Integrator::ImplicitNewmark,
        gravity_m_s2: reference.vector("gravity_m_s2"),
        substep_tolerance: None,
    };
    let mut simulation = Simulation::new(body.model().clone(), params).unwrap();
    let tip = body.vertex_rows(body.mesh().vertices().len() as u32 - 1);
    let (rest, pull) = (vec![0.0; body.basis_size()], reference.vector("pull_n"));
    let steps = |name: &str| (reference.number(name) / DT_S).round() as usize;
    let (every, pulled) = (steps("sample_s"), steps("pulled_s"));
    let mut samples = Vec::new();
    for step in 0..n_samples * every {
        let loads = [(&tip, pull)];
        let report = simulation.step(&rest, if step < pulled { &loads } else { &[] });
        assert!(!report.recovered);
        if (step + 1) % every == 0 {
            let mut place = [0.0; 3];
            for (row, q) in tip.rows.iter().zip(simulation.q()) {
                (0..3).for_each(|axis| place[axis] += row[axis] * q);
            }
            samples.push((place, simulation.energies_j()));
        }
    }
    samples
}

/// Mean time between crossings of the mean, twice over: the dominant period.
fn period(x: &[f64], sample_s: f64) -> f64 {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    let crossings: Vec<f64> = x
        .windows(2)
        .enumerate()
        .filter(|(_, w)| (w[0] < mean) != (w[1] < mean))
        .map(|(i, w)| sample_s * (i as f64 + (mean - w[0]) / (w[1] - w[0])))
        .collect();
    assert!(crossings.len() >= 3, "two half swings at least");
    2.0 * (crossings[crossings.len() - 1] - crossings[0]) / (crossings.len() - 1) as f64
}

#[test]
fn reduced_motion_follows_full_order_motion_for_every_law() {
    let reference = Reference::load();
    let cubature = CubatureParams {
        n_points: 100,
        n_training_poses: 60,
        tolerance: 0.01,
        seed: 5,
        selection: Selection::GreedyNnls,
        smoothing: true,
    };
    for law in Law::ALL {
        let tip: Vec<[f64; 3]> = {
            let [x, y, z] = ["x_m", "y_m", "z_m"].map(|name| reference.series(law, name));
            (0..x.len()).map(|i| [x[i], y[i], z[i]]).collect()
        };
        let energies = ["kinetic_j", "potential_j"].map(|name| reference.series(law, name));
        let largest = |x: &[f64]| x.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        let length = |x: &[f64; 3]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
        let reach = tip.iter().map(length).fold(0.0, f64::max);
        assert!(reach > 0.015, "beyond the linear range");
        for cubature in [None, Some(cubature)] {
            let body = reference.body(law, cubature);
            let found = motion(&reference, &body, tip.len());
            let gap = |(a, (b, _)): (&[f64; 3], &([f64; 3], _))| {
                length(&std::array::from_fn(|axis| a[axis] - b[axis]))
            };
            let place = tip.iter().zip(&found).map(gap).fold(0.0, f64::max) / reach;
            let energy = [0, 1].map(|k| {
                let apart: Vec<f64> =
                    energies[k].iter().zip(&found).map(|(a, (_, b))| a - b[k]).collect();
                largest(&apart) / largest(&energies[1])
            });
            let sample_s = reference.number("sample_s");
            let heights = |of: &dyn Fn(usize) -> f64| (0..tip.len()).map(of).collect::<Vec<f64>>();
            let frequency = period(&heights(&|i| tip[i][1]), sample_s)
                / period(&heights(&|i| found[i].0[1]), sample_s)
                - 1.0;
            let what = format!(
                "{law:?}, cubature {}: place {place:.4}, energies {energy:.4?}, frequency {frequency:.5}",
                cubature.is_some()
            );
            println!("{what}");
            // What is left without cubature is the subspace's part, and time steps four times as long; cubature
            // adds about its own force error.
            let bounds = match cubature {
                None => [0.005, 0.003, 0.001],
                Some(_) => [0.03, 0.03, 0.005],
            };
            let worst = [place, energy[0].max(energy[1]), frequency.abs()];
            assert!(worst.iter().zip(bounds).all(|(found, bound)| *found < bound), "{what}");
        }
    }
}
