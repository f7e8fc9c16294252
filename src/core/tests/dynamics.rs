//! Reduced dynamics.

use crate::bodies::{bar, column, dot, params};
use std::f64::consts::TAU;
use std::sync::Arc;
use sutura_core::build::{self, Artifacts, BuildParams, RayleighDamping};
use sutura_core::control::Uncontrolled;
use sutura_core::linalg;
use sutura_core::reduced::{Integrator, Simulation, SimulationError, SimulationParams};
use sutura_core::testing::Cut;

fn body(damping: RayleighDamping) -> Artifacts {
    let bar = bar(Cut::HalfDepth);
    // Everything kept, so that the subspace holds the modes exactly.
    let params = BuildParams { basis_size: 1000, damping, ..params(&bar, 8) };
    build::build(bar.mesh, &params, &Uncontrolled).unwrap()
}

const UNDAMPED: RayleighDamping = RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 };

fn simulation(body: &Artifacts, dt_s: f64) -> Simulation {
    let params = SimulationParams {
        dt_s,
        integrator: Integrator::ImplicitNewmark,
        gravity_m_s2: [0.0; 3],
        substep_tolerance: None,
    };
    Simulation::new(body.model().clone(), params).unwrap()
}

/// The first mode in reduced coordinates.
fn first_mode(body: &Artifacts) -> Vec<f64> {
    let model = body.full_model();
    let mass = model.mass(body.params().mass, &Arc::new(model.pattern(&[])));
    let all = body.mode(0);
    let free = model.restrict(&all);
    mass.inner(body.basis(), column(&free)).col_as_slice(0).to_vec()
}

#[test]
fn a_small_oscillation_has_the_frequency_of_its_mode() {
    let body = body(UNDAMPED);
    let omega = TAU * body.frequencies_hz()[0];
    let mode = first_mode(&body);
    let dt = TAU / omega / 40.0;
    let mut simulation = simulation(&body, dt);
    let push: Vec<f64> = mode.iter().map(|x| 1e-4 * x).collect();
    simulation.step(&push, &[]);
    let rest = vec![0.0; mode.len()];
    let mut crossings = Vec::new();
    let mut last = dot(simulation.q(), &mode);
    while crossings.len() < 41 {
        simulation.step(&rest, &[]);
        let now = dot(simulation.q(), &mode);
        if (last < 0.0) != (now < 0.0) {
            crossings.push(simulation.time_s() - dt * now / (now - last));
        }
        last = now;
    }
    let measured = TAU * 20.0 / (crossings[40] - crossings[0]);
    // Average acceleration stretches the period in a known way: tan(ω'dt/2) = ωdt/2.
    let expected = 2.0 / dt * (omega * dt / 2.0).atan();
    assert!((measured / expected - 1.0).abs() < 1e-4, "{measured} {expected} {omega}");
}

#[test]
fn energy_neither_grows_nor_fades_without_damping() {
    let body = body(UNDAMPED);
    let dt = 1.0 / body.frequencies_hz()[0] / 100.0;
    let mut simulation = simulation(&body, dt);
    let tip = body.full_model().free_vertices().iter().copied().max().unwrap();
    let push = body.vertex_load(tip, [0.0, 2.0, 1.0]);
    for _ in 0..30 {
        simulation.step(&push, &[]);
    }
    let energy = |s: &Simulation| {
        0.5 * dot(s.velocity(), s.velocity()) + body.model().evaluate(s.q()).energy_j
    };
    let rest = vec![0.0; push.len()];
    // The step in which the load goes still does work: count from the one after it.
    simulation.step(&rest, &[]);
    let start = energy(&simulation);
    let u = linalg::product(body.basis(), column(simulation.q()));
    assert!(u.norm_max() > 0.005, "a motion well beyond the linear range: {}", u.norm_max());
    let mut worst = 0.0f64;
    for _ in 0..1000 {
        let report = simulation.step(&rest, &[]);
        assert_eq!((report.n_substeps, report.recovered), (1, false));
        worst = worst.max((energy(&simulation) / start - 1.0).abs());
    }
    assert!(worst < 0.02, "energy drifted by {worst:e}");
}

#[test]
fn damping_takes_energy_at_the_rate_it_is_given() {
    // Mass-proportional damping α makes a mode fade like exp(−αt/2).
    let alpha = 2.0;
    let body = body(RayleighDamping { mass_per_s: alpha, stiffness_s: 0.0 });
    let mode = first_mode(&body);
    let dt = 1.0 / body.frequencies_hz()[0] / 100.0;
    let mut simulation = simulation(&body, dt);
    simulation.step(&mode.iter().map(|x| 1e-4 * x).collect::<Vec<_>>(), &[]);
    let energy = |s: &Simulation| {
        0.5 * dot(s.velocity(), s.velocity()) + body.model().evaluate(s.q()).energy_j
    };
    // The step in which the load goes still does work: count from the one after it.
    let rest = vec![0.0; mode.len()];
    simulation.step(&rest, &[]);
    let (start, from) = (energy(&simulation), simulation.time_s());
    for _ in 0..400 {
        simulation.step(&rest, &[]);
    }
    let rate = (start / energy(&simulation)).ln() / (simulation.time_s() - from);
    assert!((rate / alpha - 1.0).abs() < 0.02, "{rate}");
}

#[test]
fn gravity_settles_on_the_static_solution() {
    let body = body(RayleighDamping { mass_per_s: 20.0, stiffness_s: 0.002 });
    let params = SimulationParams {
        dt_s: 0.02,
        integrator: Integrator::ImplicitNewmark,
        gravity_m_s2: [0.0, -3.0, 0.0],
        substep_tolerance: None,
    };
    let mut simulation = Simulation::new(body.model().clone(), params).unwrap();
    let r = body.basis_size();
    for _ in 0..400 {
        simulation.step(&vec![0.0; r], &[]);
    }
    let masses = body.lumped_mass_kg();
    let load = body.full_model().free_vertices().iter().fold(vec![0.0; r], |sum, &v| {
        let weight = body.vertex_load(v, [0.0, -3.0 * masses[v as usize], 0.0]);
        sum.iter().zip(weight).map(|(a, b)| a + b).collect()
    });
    let settled = body.model().solve_static(&load, &vec![0.0; r]).unwrap();
    let gap: Vec<f64> = settled.iter().zip(simulation.q()).map(|(a, b)| a - b).collect();
    assert!(dot(&gap, &gap).sqrt() < 1e-5 * dot(&settled, &settled).sqrt());
}

#[test]
fn a_violent_load_never_leaves_a_number_that_is_not_finite() {
    let body = body(UNDAMPED);
    let tip = body.full_model().free_vertices().iter().copied().max().unwrap();
    let finite = |s: &Simulation| s.q().iter().chain(s.velocity()).all(|x| x.is_finite());
    let mut was_split = false;
    let mut was_recovered = false;
    for force_n in [1e2, 1e5, 1e10, 1e30, 1e200, f64::MAX] {
        let mut simulation = simulation(&body, 0.05);
        for step in 0..20 {
            let sign = if step % 2 == 0 { 1.0 } else { -1.0 };
            let report =
                simulation.step(&body.vertex_load(tip, [-sign * force_n, force_n, 0.0]), &[]);
            assert!(finite(&simulation), "{force_n:e} N");
            was_split |= report.n_substeps > 1;
            was_recovered |= report.recovered;
        }
    }
    assert!(was_split && was_recovered);
    for bad in [f64::NAN, f64::INFINITY] {
        let mut simulation = simulation(&body, 0.01);
        simulation.step(&body.vertex_load(tip, [0.0, 0.01, 0.0]), &[]);
        let q = simulation.q().to_vec();
        assert!(simulation.step(&vec![bad; body.basis_size()], &[]).recovered);
        // It stays where it was, at rest, and goes on.
        assert_eq!(simulation.q(), q);
        assert!(simulation.velocity().iter().all(|v| *v == 0.0));
        assert!(!simulation.step(&vec![0.0; body.basis_size()], &[]).recovered);
        assert!(finite(&simulation));
    }
}

#[test]
fn simulations_that_cannot_run_are_refused() {
    let bar = bar(Cut::Through);
    let free = build::build(bar.mesh.clone(), &params(&bar, 6), &Uncontrolled).unwrap();
    let good = SimulationParams {
        dt_s: 0.01,
        integrator: Integrator::ImplicitNewmark,
        gravity_m_s2: [0.0; 3],
        substep_tolerance: None,
    };
    let error = Simulation::new(free.model().clone(), good).err();
    assert_eq!(error, Some(SimulationError::PartlyFree { n_rigid_modes: 6 }));

    let held = body(UNDAMPED);
    for dt_s in [0.0, -0.1, f64::NAN, f64::INFINITY, 2.0] {
        let error = Simulation::new(held.model().clone(), SimulationParams { dt_s, ..good });
        assert!(matches!(error, Err(SimulationError::TimeStep(_))), "{dt_s}");
    }
    let gravity = SimulationParams { gravity_m_s2: [0.0, f64::NAN, 0.0], ..good };
    let error = Simulation::new(held.model().clone(), gravity).err();
    assert_eq!(error, Some(SimulationError::Gravity));

    let mut running = simulation(&held, 0.01);
    let error = running.switch(held.model().clone(), &[1.0; 3]).unwrap_err();
    let expected = held.basis_size().pow(2);
    assert_eq!(error, SimulationError::Transfer { given: 3, expected });
}

#[test]
fn oscillators_are_exact_whatever_the_step_and_agree_with_newmark_for_small_motion() {
    let damping = RayleighDamping { mass_per_s: 0.5, stiffness_s: 1e-4 };
    let body = body(damping);
    let tip = body.full_model().free_vertices().iter().copied().max().unwrap();
    let push = body.vertex_load(tip, [0.0, 1e-6, 5e-7]);
    let run = |integrator, dt_s: f64, n_steps: usize| {
        let params =
            SimulationParams { dt_s, integrator, gravity_m_s2: [0.0; 3], substep_tolerance: None };
        let mut simulation = Simulation::new(body.model().clone(), params).unwrap();
        (0..n_steps).for_each(|_| assert!(!simulation.step(&push, &[]).recovered));
        simulation.q().to_vec()
    };
    let apart = |a: &[f64], b: &[f64]| {
        let gap: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
        dot(&gap, &gap).sqrt() / dot(b, b).sqrt()
    };
    let at_once = run(Integrator::ModalOscillators, 0.3, 1);
    let in_steps = run(Integrator::ModalOscillators, 0.001, 300);
    assert!(apart(&at_once, &in_steps) < 1e-9);
    let newmark = run(Integrator::ImplicitNewmark, 2e-4, 1500);
    // Average acceleration stretches periods by (ω dt)²/12, most that of the fastest modes.
    assert!(apart(&newmark, &at_once) < 2e-3, "{:e}", apart(&newmark, &at_once));
    // Second order, though the load begins with the first step.
    let newmark = |n: usize| apart(&run(Integrator::ImplicitNewmark, 0.3 / n as f64, n), &at_once);
    let ratio = newmark(1500) / newmark(3000);
    assert!((3.5..4.5).contains(&ratio), "{ratio}");
    // First order: half the step, half the error.
    let euler = |n: usize| apart(&run(Integrator::BackwardEuler, 0.3 / n as f64, n), &at_once);
    let ratio = euler(1500) / euler(3000);
    assert!((1.7..2.3).contains(&ratio), "{ratio}");
}

#[test]
fn a_quasi_static_step_is_the_static_solution() {
    let body = body(UNDAMPED);
    let tip = body.full_model().free_vertices().iter().copied().max().unwrap();
    let params = SimulationParams {
        dt_s: 0.1,
        integrator: Integrator::QuasiStatic,
        gravity_m_s2: [0.0; 3],
        substep_tolerance: None,
    };
    let mut simulation = Simulation::new(body.model().clone(), params).unwrap();
    for force_n in [0.5, 2.0, -3.0, 0.0] {
        let load = body.vertex_load(tip, [0.0, force_n, 0.5 * force_n]);
        assert!(!simulation.step(&load, &[]).recovered);
        let exact = body.model().solve_static(&load, &vec![0.0; load.len()]).unwrap();
        let gap: Vec<f64> = simulation.q().iter().zip(&exact).map(|(a, b)| a - b).collect();
        assert!(dot(&gap, &gap).sqrt() < 1e-7 * (1e-3 + dot(&exact, &exact).sqrt()), "{force_n}");
    }
}

#[test]
fn steps_are_split_where_their_error_asks_for_it() {
    let body = body(RayleighDamping { mass_per_s: 1.0, stiffness_s: 2e-3 });
    let tip = body.full_model().free_vertices().iter().copied().max().unwrap();
    let push = body.vertex_load(tip, [0.0, 1.5, 0.8]);
    let rest = vec![0.0; push.len()];
    let duration = 5.0 / body.frequencies_hz()[0];
    // Pushed for the first half, then let go; where it is in the end, and the substeps of every step.
    let run = |integrator, n_steps: usize, substep_tolerance| {
        let params = SimulationParams {
            dt_s: duration / n_steps as f64,
            integrator,
            gravity_m_s2: [0.0; 3],
            substep_tolerance,
        };
        let mut simulation = Simulation::new(body.model().clone(), params).unwrap();
        let n_substeps: Vec<u32> = (0..n_steps)
            .map(|step| {
                let load = if step < n_steps / 2 { &push } else { &rest };
                let report = simulation.step(load, &[]);
                assert!(!report.recovered);
                report.n_substeps
            })
            .collect();
        (simulation.q().to_vec(), n_substeps)
    };
    for integrator in [Integrator::ImplicitNewmark, Integrator::BackwardEuler] {
        let exact = run(Integrator::ImplicitNewmark, 12_000, None).0;
        let error = |tolerance| {
            let (q, n_substeps) = run(integrator, 60, tolerance);
            let gap: Vec<f64> = q.iter().zip(&exact).map(|(a, b)| a - b).collect();
            (dot(&gap, &gap).sqrt() / dot(&exact, &exact).sqrt(), n_substeps)
        };
        let [(whole, ones), (coarse, _), (fine, n_substeps)] =
            [None, Some(1e-2), Some(1e-4)].map(error);
        assert!(ones.iter().all(|n| *n == 1));
        assert!(fine < 0.3 * coarse && fine < 0.2 * whole, "{fine} {coarse} {whole}");
        // The jump of the load takes more of them than the calm before it.
        let most = n_substeps[30..33].iter().max().unwrap();
        let calm = n_substeps[25..30].iter().min().unwrap();
        assert!(most > calm && n_substeps.iter().all(|n| *n <= 64), "{n_substeps:?}");
    }
    for bad in [0.0, 1.0, -1e-3, f64::NAN] {
        let params = SimulationParams {
            dt_s: 0.01,
            integrator: Integrator::ImplicitNewmark,
            gravity_m_s2: [0.0; 3],
            substep_tolerance: Some(bad),
        };
        let error = Simulation::new(body.model().clone(), params);
        assert!(matches!(error, Err(SimulationError::SubstepTolerance(_))), "{bad}");
    }
}
