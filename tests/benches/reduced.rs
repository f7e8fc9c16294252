//! The reduced model's evaluation and stepping: `cargo bench --bench paper_table -- --reduced STEPS`.
//!
//! Compared in the same run: with the dense matrix product of the machine, at the count of operations that
//! an evaluation takes; and with St. Venant–Kirchhoff as cubic polynomials (Barbič and James 2005; \[B12\]
//! §3.2), whose evaluation is two products of a matrix with the monomials of q: r × C(r + 2, 3) coefficients
//! for the cubic part of the force and (r(r + 1)/2)² for the quadratic part of the stiffness. (Lower orders
//! are left out, in the polynomials' favour.)

use crate::bodies::{Body, Failure};
use crate::clock::Clock;
use crate::measure::median;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::io::Write;
use std::time::Instant;
use sutura_core::build::{self, Artifacts, BuildParams, CubatureParams, RayleighDamping};
use sutura_core::material::{Law, Material};
use sutura_core::reduced::{Integrator, Simulation, SimulationParams};

/// Repetitions of which medians are taken.
const REPEAT: usize = 201;

/// Sizes of the basis; cubature has twice as many points.
const SIZES: [usize; 4] = [20, 40, 60, 100];

/// The size at which laws are compared and steps are taken.
const SESSION_SIZE: usize = 60;

/// Writes what evaluating and stepping `body` take to `out`; `n_steps` of 1 ms for each law.
pub(crate) fn run(body: &Body, n_steps: usize, out: &mut impl Write) -> Result<(), Failure> {
    writeln!(
        out,
        "| columns | points | evaluation | matrix product, same operations | ratio | cubic \
         polynomials | ours / theirs |\n|---|---|---|---|---|---|---|"
    )?;
    for size in SIZES {
        let built = build(body, size, Law::StVenantKirchhoff)?;
        writeln!(out, "{}", evaluation(&built))?;
    }
    writeln!(
        out,
        "\n| law | columns | evaluation | a step of 1 ms, median | 99 % | Newton iterations | undone \
         |\n|---|---|---|---|---|---|---|"
    )?;
    for law in Law::ALL {
        let built = build(body, SESSION_SIZE, law)?;
        writeln!(out, "{}", stepping(n_steps, law, &built)?)?;
    }
    Ok(())
}

fn build(body: &Body, size: usize, law: Law) -> Result<Artifacts, Failure> {
    let session = body.session(&[]);
    let of_law = |m: &Material| {
        Material::new(law, m.young_modulus_pa(), m.poisson_ratio(), m.density_kg_m3())
    };
    let cubature = session.cubature.map(|c| CubatureParams { n_points: 2 * size, ..c });
    let params = BuildParams {
        materials: body.materials.iter().map(of_law).collect::<Result<_, _>>()?,
        n_modes: 30.max(size / 2),
        n_derivative_modes: if law == Law::Linear { 0 } else { 8.max(size / 7) },
        basis_size: size,
        cubature,
        damping: RayleighDamping { mass_per_s: 0.1, stiffness_s: 0.001 },
        ..session
    };
    Ok(build::build(body.mesh.clone(), &params, &Clock::start())?)
}

/// Microseconds of `work`, by the median of `repeat` single calls.
fn micros(repeat: usize, mut work: impl FnMut()) -> f64 {
    let times: Vec<f64> = (0..repeat + repeat / 10)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    median(&times[repeat / 10..])
}

fn evaluation(built: &Artifacts) -> String {
    let (model, r) = (built.model(), built.basis_size());
    let p = built.cubature().map_or(0, |cubature| cubature.n_points);
    let q = pose(r, 1);
    let ours = micros(REPEAT, || {
        black_box(model.evaluate(black_box(&q)));
    });
    // Gradient, force, the response of nine rows a point and half of a symmetric product.
    let operations = (2 * 9 * p * r * 2 + 2 * 81 * p * r + 9 * p * r * r) as f64;
    let (a, b) = (table(r, 9 * p), table(9 * p, r));
    let mut c = Mat::<f64>::zeros(r, r);
    let product = micros(REPEAT, || {
        matmul(c.as_mut(), Accum::Replace, a.as_ref(), b.as_ref(), 1.0, Par::Seq);
        black_box(&c);
    });
    let same = product * operations / (2 * 9 * p * r * r) as f64;
    let pairs = r * (r + 1) / 2;
    let triples = r * (r + 1) * (r + 2) / 6;
    let (force, stiffness) = (table(r, triples), table(pairs, pairs));
    let (cubes, squares) = (table(triples, 1), table(pairs, 1));
    let theirs = micros(REPEAT, || {
        let f = &force * &cubes;
        let k = &stiffness * &squares;
        black_box((f, k));
    });
    format!(
        "| {r} | {p} | {ours:.1} µs | {same:.1} µs | {:.2} | {theirs:.1} µs | {:.2} |",
        ours / same,
        ours / theirs
    )
}

fn stepping(n_steps: usize, law: Law, built: &Artifacts) -> Result<String, Failure> {
    let r = built.basis_size();
    let q = pose(r, 2);
    let evaluation = micros(REPEAT, || {
        black_box(built.model().evaluate(black_box(&q)));
    });
    let params = SimulationParams {
        dt_s: 1e-3,
        integrator: Integrator::ImplicitNewmark,
        gravity_m_s2: [0.0, -9.81, 0.0],
        substep_tolerance: None,
    };
    let mut simulation = Simulation::new(built.model().clone(), params)?;
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let vertices = built.full_model().free_vertices();
    let weight = 9.81 * built.lumped_mass_kg().iter().sum::<f64>();
    let rest = vec![0.0; r];
    let (mut times, mut n_newton, mut n_recovered, mut pull) = (Vec::new(), 0, 0, None);
    for step in 0..n_steps {
        // Another pull every 20 ms, up to the body's weight.
        if step % 20 == 0 {
            let vertex = vertices[random.random_range(0..vertices.len())];
            let force: [f64; 3] = std::array::from_fn(|_| weight * random.random_range(-1.0..1.0));
            pull = Some((built.vertex_rows(vertex), force));
        }
        let loads: Vec<_> = pull.iter().map(|(vertex, force)| (vertex, *force)).collect();
        let start = Instant::now();
        let report = simulation.step(&rest, &loads);
        times.push(start.elapsed().as_secs_f64() * 1e6);
        n_newton += report.n_newton;
        n_recovered += u32::from(report.recovered);
        if !simulation.q().iter().all(|x| x.is_finite()) {
            return Err("a coordinate that is not finite".into());
        }
    }
    times.sort_by(f64::total_cmp);
    Ok(format!(
        "| {law:?} | {r} | {evaluation:.0} µs | {:.0} µs | {:.0} µs | {:.2} | {n_recovered} of {} |",
        median(&times),
        times[times.len() * 99 / 100],
        f64::from(n_newton) / n_steps as f64,
        n_steps
    ))
}

/// Coordinates of a moderate deformation.
fn pose(r: usize, seed: u64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..r).map(|i| 1e-3 * random.random_range(-1.0..1.0) / (1 + i) as f64).collect()
}

fn table(rows: usize, columns: usize) -> Mat<f64> {
    Mat::from_fn(rows, columns, |i, j| ((i * 7 + j * 13) as f64).sin())
}
