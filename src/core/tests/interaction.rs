//! Bodies that are pulled at and that lie on things.

use crate::bodies::{bar, norm, params};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::sync::Arc;
use sutura_core::build::{
    self, Artifacts, BuildParams, CubatureParams, RayleighDamping, Selection,
};
use sutura_core::control::Uncontrolled;
use sutura_core::reduced::contact::{Contact, Obstacle};
use sutura_core::reduced::{
    Environment, Grab, Integrator, Simulation, SimulationParams, StepReport, VertexRows,
};
use sutura_core::testing::Cut;

const DAMPED: RayleighDamping = RayleighDamping { mass_per_s: 5.0, stiffness_s: 0.003 };

fn body(is_held: bool, damping: RayleighDamping) -> Artifacts {
    body_of(is_held, damping, 30)
}

fn body_of(is_held: bool, damping: RayleighDamping, basis_size: usize) -> Artifacts {
    let bar = bar(Cut::Whole);
    let fixed_vertices = if is_held { bar.root.clone() } else { Vec::new() };
    let cubature = Some(CubatureParams {
        n_points: 80,
        n_training_poses: 40,
        tolerance: 0.02,
        seed: 1,
        selection: Selection::default(),
        smoothing: true,
    });
    let params = BuildParams { fixed_vertices, basis_size, damping, cubature, ..params(&bar, 12) };
    build::build(bar.mesh, &params, &Uncontrolled).unwrap()
}

fn simulation(body: &Artifacts, integrator: Integrator, gravity: f64, dt_s: f64) -> Simulation {
    let params = SimulationParams {
        dt_s,
        integrator,
        gravity_m_s2: [0.0, gravity, 0.0],
        substep_tolerance: None,
    };
    Simulation::new(body.model().clone(), params).unwrap()
}

fn floor(height_m: f64, friction: f64) -> Arc<Environment> {
    Arc::new(Environment {
        obstacles: vec![Obstacle::Plane { point_m: [0.0, height_m, 0.0], normal: [0.0, 1.0, 0.0] }],
        contact: Contact { stiffness_pa_m: 2e7, damping_s_m: 1.0, friction, creep_m_s: 1e-3 },
    })
}

fn tip(body: &Artifacts) -> u32 {
    body.full_model().free_vertices().iter().copied().max().unwrap()
}

fn run(simulation: &mut Simulation, n_steps: usize) -> Vec<StepReport> {
    let r = simulation.q().len();
    (0..n_steps).map(|_| simulation.step(&vec![0.0; r], &[])).collect()
}

/// Where some vertices are.
fn places(vertices: &[VertexRows], simulation: &Simulation) -> Vec<Vector3<f64>> {
    let [x, y, z, i, j, k, w] = simulation.rigid();
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    let place = |vertex: &VertexRows| {
        let moved = vertex.rows.iter().zip(simulation.q()).map(|(row, q)| Vector3::from(*row) * *q);
        let local = Vector3::from(vertex.rest_m) + moved.sum::<Vector3<f64>>();
        rotation * local + Vector3::new(x, y, z)
    };
    vertices.iter().map(place).collect()
}

fn lowest_m(body: &Artifacts, simulation: &Simulation) -> f64 {
    let [_, height, ..] = simulation.rigid();
    let of = |v: u32| {
        let vertex = body.vertex_rows(v);
        let u: f64 = vertex.rows.iter().zip(simulation.q()).map(|(row, q)| row[1] * q).sum();
        vertex.rest_m[1] + u + height
    };
    body.full_model().free_vertices().iter().map(|&v| of(v)).fold(f64::INFINITY, f64::min)
}

#[test]
fn a_grab_holds_a_vertex_where_force_and_spring_balance() {
    let body = body(true, DAMPED);
    let vertex = Arc::new(body.vertex_rows(tip(&body)));
    let rest = vertex.rest_m;
    let target_m = [rest[0], rest[1] + 0.02, rest[2] - 0.01];
    let grab = Grab { vertex: vertex.clone(), target_m, stiffness_n_m: 50.0, damping_n_s_m: 0.1 };
    let mut settled = Vec::new();
    for integrator in
        [Integrator::QuasiStatic, Integrator::BackwardEuler, Integrator::ImplicitNewmark]
    {
        let mut simulation = simulation(&body, integrator, 0.0, 0.01);
        simulation.set_grabs(vec![grab.clone()]);
        let n_steps = if integrator == Integrator::QuasiStatic { 1 } else { 400 };
        assert!(run(&mut simulation, n_steps).iter().all(|report| !report.recovered));
        let q = simulation.q().to_vec();
        // The spring's force, as a load, has the same equilibrium.
        let force = simulation.interaction_force_n();
        assert!(norm(&force) > 0.05);
        let start = vec![0.0; q.len()];
        let load = body.vertex_load(tip(&body), force);
        let expected = body.model().solve_static(&load, &start).unwrap();
        let gap: Vec<f64> = q.iter().zip(&expected).map(|(a, b)| a - b).collect();
        assert!(norm(&gap) < 1e-5 * norm(&q), "{integrator:?}: {:e}", norm(&gap) / norm(&q));
        settled.push(q);
        simulation.set_grabs(Vec::new());
        run(&mut simulation, n_steps);
        assert!(norm(simulation.q()) < 1e-3 * norm(&expected), "{integrator:?} lets go");
    }
}

#[test]
fn a_held_body_sags_onto_a_floor_and_no_further() {
    let body = body(true, DAMPED);
    let mut free = simulation(&body, Integrator::ImplicitNewmark, -9.81, 5e-3);
    run(&mut free, 300);
    let sag = lowest_m(&body, &free);
    let start = lowest_m(&body, &simulation(&body, Integrator::QuasiStatic, 0.0, 0.1));
    assert!(sag < start - 1e-3);
    let height_m = 0.5 * (sag + start);
    let surface = body.contact_surface().clone();
    for integrator in [Integrator::ImplicitNewmark, Integrator::BackwardEuler] {
        let mut simulation = simulation(&body, integrator, -9.81, 5e-3);
        simulation.set_environment(Some(floor(height_m, 0.3)), Some(surface.clone()));
        let reports = run(&mut simulation, 300);
        assert!(reports.iter().all(|report| !report.recovered));
        let lowest = lowest_m(&body, &simulation);
        assert!((lowest - height_m).abs() < 0.05 * (start - height_m), "{lowest} {height_m}");
        let force = simulation.interaction_force_n();
        assert!(force[1] > 0.0);
    }
}

#[test]
fn a_free_body_rests_on_the_floor_with_its_weight() {
    let body = body(false, DAMPED);
    let mut simulation = simulation(&body, Integrator::BackwardEuler, -9.81, 2e-3);
    let surface = body.contact_surface().clone();
    let height_m = lowest_m(&body, &simulation) - 0.005;
    simulation.set_environment(Some(floor(height_m, 0.3)), Some(surface));
    assert!(run(&mut simulation, 1500).iter().all(|report| !report.recovered));
    let lowest = lowest_m(&body, &simulation);
    assert!((lowest - height_m).abs() < 1e-3, "{lowest} {height_m}");
    let weight = 9.81 * body.lumped_mass_kg().iter().sum::<f64>();
    let force = simulation.interaction_force_n();
    assert!((force[1] / weight - 1.0).abs() < 0.02, "{force:?} {weight}");
    let [momentum, _] = simulation.momenta().unwrap();
    assert!(norm(&momentum) < 0.01 * weight * 0.1, "{momentum:?}");
}

#[test]
fn friction_stops_a_sliding_body_after_the_distance_of_coulomb_s_law() {
    let body = body(false, DAMPED);
    let mut simulation = simulation(&body, Integrator::BackwardEuler, -9.81, 2e-3);
    let surface = body.contact_surface().clone();
    let height_m = lowest_m(&body, &simulation);
    let friction = 0.2;
    simulation.set_environment(Some(floor(height_m, friction)), Some(surface));
    run(&mut simulation, 500);
    let from = simulation.rigid()[2];
    // Across the bar, so that it need not tip over its long side.
    let [_, angular] = simulation.momenta().unwrap();
    assert!(norm(&angular) < 1e-3);
    let speed = 0.5;
    simulation.set_rigid_velocity([speed, 0.0, 0.0], [0.0; 3]);
    let from_x = simulation.rigid()[0];
    run(&mut simulation, 500);
    let slid = simulation.rigid()[0] - from_x;
    let expected = speed * speed / (2.0 * friction * 9.81);
    assert!((slid / expected - 1.0).abs() < 0.1, "{slid} {expected}");
    assert!((simulation.rigid()[2] - from).abs() < 0.02 * slid);
}

#[test]
fn a_pose_pressed_by_a_moving_tool_stays_finite() {
    let body = body(true, DAMPED);
    let surface = body.contact_surface().clone();
    for integrator in [
        Integrator::ImplicitNewmark,
        Integrator::BackwardEuler,
        Integrator::QuasiStatic,
        Integrator::ModalOscillators,
    ] {
        let mut simulation = simulation(&body, integrator, -9.81, 0.01);
        let mut most = 0.0f64;
        for step in 0..200 {
            let depth = 0.03 * (step as f64 / 20.0).sin();
            let obstacles = vec![
                Obstacle::Sphere { center_m: [0.15, 0.1 - depth, 0.025], radius_m: 0.04 },
                Obstacle::Capsule {
                    from_m: [0.1, 0.0, -0.05 + depth],
                    to_m: [0.1, 0.05, -0.05 + depth],
                    radius_m: 0.03,
                },
            ];
            let contact =
                Contact { stiffness_pa_m: 1e7, damping_s_m: 1.0, friction: 0.4, creep_m_s: 1e-3 };
            let environment = Environment { obstacles, contact };
            simulation.set_environment(Some(Arc::new(environment)), Some(surface.clone()));
            simulation.step(&vec![0.0; body.basis_size()], &[]);
            let force = simulation.interaction_force_n();
            assert!(simulation.q().iter().chain(&force).all(|x| x.is_finite()), "{integrator:?}");
            most = most.max(norm(&force));
        }
        assert!(most > 0.1, "{integrator:?}: the tool never touched");
    }
}

#[test]
fn grabs_act_to_second_order_from_the_moment_they_are_there() {
    for is_held in [true, false] {
        // Few columns: modes that a step does not resolve hide its order.
        let damping = RayleighDamping { mass_per_s: 1.0, stiffness_s: 1e-4 };
        let body = body_of(is_held, damping, 6);
        let free = body.full_model().free_vertices();
        let vertices: Vec<VertexRows> = [0, free.len() / 2, free.len() - 1]
            .iter()
            .map(|&v| body.vertex_rows(free[v]))
            .collect();
        let [first, .., last] = &vertices[..] else { panic!() };
        let pull = |vertex: &VertexRows, by: [f64; 3], damping_n_s_m: f64| Grab {
            vertex: Arc::new(vertex.clone()),
            target_m: std::array::from_fn(|axis| vertex.rest_m[axis] + by[axis]),
            stiffness_n_m: 40.0,
            damping_n_s_m,
        };
        let after = |n_steps: usize, integrator: Integrator| {
            let mut simulation = simulation(&body, integrator, -9.81, 0.08 / n_steps as f64);
            simulation.set_rigid_velocity([0.1, -0.2, 0.05], [3.0, 12.0, -8.0]);
            simulation.set_grabs(vec![
                pull(last, [0.01, 0.03, -0.02], 0.1),
                pull(first, [0.0, 0.01, 0.01], 0.0),
            ]);
            run(&mut simulation, n_steps / 2);
            // The tool jumps, and lets go of one end.
            simulation.set_grabs(vec![pull(last, [-0.02, 0.01, 0.01], 0.1)]);
            let reports = run(&mut simulation, n_steps - n_steps / 2);
            assert!(reports.iter().all(|r| (r.n_substeps, r.recovered) == (1, false)));
            places(&vertices, &simulation)
        };
        for (integrator, ratios) in
            [(Integrator::ImplicitNewmark, 3.5..4.5), (Integrator::BackwardEuler, 1.7..2.3)]
        {
            let found = [400, 800, 1600, 3200].map(|n_steps| after(n_steps, integrator));
            let apart = |a: &[Vector3<f64>], b: &[Vector3<f64>]| {
                a.iter().zip(b).map(|(a, b)| (a - b).norm_squared()).sum::<f64>().sqrt()
            };
            let changes: Vec<f64> = found.windows(2).map(|w| apart(&w[0], &w[1])).collect();
            let is_of_order = changes.windows(2).all(|w| ratios.contains(&(w[0] / w[1])));
            assert!(is_of_order, "{is_held} {integrator:?}: {changes:?}");
        }
    }
}

#[test]
fn what_a_step_does_not_resolve_of_a_hard_floor_neither_kicks_nor_trembles() {
    let body = body(false, RayleighDamping { mass_per_s: 0.0, stiffness_s: 1e-4 });
    let surface = body.contact_surface().clone();
    let hard = |height_m: f64| {
        let contact =
            Contact { stiffness_pa_m: 1e10, damping_s_m: 0.0, friction: 0.0, creep_m_s: 1e-3 };
        Arc::new(Environment { contact, ..Environment::clone(&floor(height_m, 0.0)) })
    };
    // Flat onto the floor, in steps that resolve nothing or some of it, at many distances: the first contact falls
    // on any part of a step.
    let most_of_steps = |dt_s: f64, substep_tolerance: Option<f64>| {
        let left = (0..10).map(|start| {
            let mut simulation = simulation(&body, Integrator::ImplicitNewmark, 0.0, dt_s);
            let params = SimulationParams { substep_tolerance, ..*simulation.params() };
            simulation.set_params(params).unwrap();
            let height_m = lowest_m(&body, &simulation) - dt_s * (0.5 + 0.05 * f64::from(start));
            simulation.set_environment(Some(hard(height_m)), Some(surface.clone()));
            simulation.set_rigid_velocity([0.0, -0.5, 0.0], [0.0; 3]);
            let [before, _] = simulation.energies_j();
            assert!(run(&mut simulation, 20).iter().all(|report| !report.recovered));
            simulation.energies_j().iter().sum::<f64>() / before
        });
        left.fold(0.0, f64::max)
    };
    let most = [None, Some(1e-2), Some(1e-3)]
        .map(|tolerance| [2e-3, 5e-4, 1e-4].map(|dt_s| most_of_steps(dt_s, tolerance)));
    let mut all = most.iter().flatten();
    assert!(all.all(|most| *most < 1.001), "left with {most:?} times the energy");
    // Laid down with its weight, it lies still.
    let mut simulation = simulation(&body, Integrator::ImplicitNewmark, -9.81, 2e-3);
    let height_m = lowest_m(&body, &simulation);
    simulation.set_environment(Some(hard(height_m)), Some(surface));
    assert!(run(&mut simulation, 500).iter().all(|report| !report.recovered));
    let weight = 9.81 * body.lumped_mass_kg().iter().sum::<f64>();
    let mut worst: f64 = 0.0;
    for _ in 0..20 {
        run(&mut simulation, 1);
        worst = worst.max((simulation.interaction_force_n()[1] / weight - 1.0).abs());
    }
    assert!(worst < 0.05, "the floor bears its weight but for {worst}");
}
