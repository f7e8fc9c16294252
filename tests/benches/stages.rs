//! Criterion benches, one a stage: `cargo bench --bench stages [-- FILTER]`. The body is
//! `SUTURA_BENCH_BODY` (`stomach_small`) of the folder `SUTURA_BENCH_MESHES` (the repository's own).

mod bodies;
mod clock;

use bodies::{Body, Failure};
use clock::Clock;
use criterion::{BatchSize, Criterion, SamplingMode};
use faer::Mat;
use std::hint::black_box;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use sutura_core::assembly::FullModel;
use sutura_core::assembly::mass::MassKind;
use sutura_core::basis::{WeightedDerivatives, mass_pca};
use sutura_core::build::{self, Method, RebuildParams};
use sutura_core::control::{Stage, Uncontrolled};
use sutura_core::derivatives;
use sutura_core::factorization::{SparseCholesky, SymbolicCholesky, shifted};
use sutura_core::modes::lanczos::{self, ShiftInvert};
use sutura_core::modes::rigid;

/// The daemon's.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    let mut criterion = Criterion::default().configure_from_args();
    match body().and_then(|body| bench(&mut criterion, &body)) {
        Ok(()) => {
            criterion.final_summary();
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn body() -> Result<Body, Failure> {
    let meshes = std::env::var_os("SUTURA_BENCH_MESHES").map(PathBuf::from);
    let name = std::env::var("SUTURA_BENCH_BODY").unwrap_or_else(|_| "stomach_small".into());
    Body::load(&meshes.unwrap_or_else(bodies::default_directory), &name)
}

fn bench(criterion: &mut Criterion, body: &Body) -> Result<(), Failure> {
    let mut group = criterion.benchmark_group(&body.name);
    group.sample_size(10).sampling_mode(SamplingMode::Flat);

    let assemble = || {
        let model = FullModel::new(body.mesh.clone(), &body.materials, &body.fixed);
        let pattern = Arc::new(model.pattern(&[]));
        let mass = model.mass(MassKind::Lumped, &pattern);
        let stiffness = model.rest_stiffness(&pattern);
        (model, mass, stiffness)
    };
    group.bench_function("assembly", |b| b.iter(assemble));

    // Everything below starts from a finished body.
    let params = body.session(&[]);
    let base = build::build(body.mesh.clone(), &params, &Clock::start())?;
    let pairs = body.pairs(body.stitches.len());
    let prepared = build::build(body.mesh.clone(), &body.session(&pairs), &Clock::start())?;
    let (model, mass, stiffness) = assemble();
    let sigma = base.shift_per_s2();
    let matrix = shifted(&stiffness, sigma, &mass);
    let analyse = || SymbolicCholesky::new(matrix.pattern().clone(), 3);
    group.bench_function("ordering and analysis", |b| b.iter(analyse));
    let symbolic = Arc::new(analyse()?);
    group.bench_function("factorization", |b| {
        b.iter(|| SparseCholesky::with_symbolic(symbolic.clone(), &matrix));
    });

    let factor = SparseCholesky::of_blocks(&matrix)?;
    for columns in [1, 8, 32] {
        let rhs = Mat::from_fn(model.n(), columns, |i, j| ((i * 31 + j * 17) as f64).sin());
        group.bench_function(format!("solve, {columns} columns"), |b| {
            b.iter_batched_ref(
                || rhs.clone(),
                |x| factor.solve_in_place(x.as_mut()),
                BatchSize::LargeInput,
            );
        });
    }

    let rigid = rigid::rigid_modes(&model, &mass)?;
    let problem = ShiftInvert { factor: &factor, sigma, mass: &mass, rigid: rigid.as_ref() };
    group.bench_function("modes", |b| {
        b.iter(|| lanczos::lowest_modes(&problem, params.n_modes, 10, &Uncontrolled));
    });

    let modes = lanczos::lowest_modes(&problem, params.n_modes, 0, &Uncontrolled)?.modes;
    let shapes = modes.shapes.subcols(0, params.n_derivative_modes.min(modes.eigenvalues.len()));
    group.bench_function("derivative right-hand sides", |b| {
        b.iter(|| derivatives::right_hand_sides(&model, shapes, &Uncontrolled));
    });

    let mut derived = derivatives::right_hand_sides(&model, shapes, &Uncontrolled)?;
    factor.solve_in_place(derived.as_mut());
    let eigenvalues: Vec<[f64; 2]> = derivatives::pairs(shapes.ncols())
        .iter()
        .map(|pair| pair.map(|i| modes.eigenvalues[i]))
        .collect();
    group.bench_function("mass-PCA", |b| {
        b.iter(|| {
            let eigenvalues = eigenvalues.clone();
            let group = WeightedDerivatives { shapes: derived.as_ref(), eigenvalues };
            mass_pca(&mass, &modes, &[group], params.basis_size, params.pca)
        });
    });

    // Training has no entry of its own: the stage as the build times it.
    group.bench_function("cubature training", |b| {
        b.iter_custom(|iterations| {
            (0..iterations).map(|_| stage_of_build(body, Stage::Cubature)).sum()
        });
    });

    let r = base.basis_size();
    let q: Vec<f64> = (0..r).map(|i| 1e-4 * (i as f64).cos()).collect();
    group.bench_function("evaluator", |b| b.iter(|| base.model().evaluate(black_box(&q))));

    let edits = body.stitch(&pairs);
    let methods = [
        ("edit, flexibility", &base, Method::Flexibility),
        ("edit, flexibility, prepared", &prepared, Method::Flexibility),
        ("edit, low_rank", &base, Method::LowRank),
        ("edit, from_scratch", &base, Method::FromScratch),
    ];
    for (name, base, method) in methods {
        let params = RebuildParams::new(method, 1e-4);
        group.bench_function(name, |b| {
            b.iter(|| build::rebuild(base, &edits, &params, &Uncontrolled));
        });
    }
    group.finish();
    Ok(())
}

/// Time of one stage of a session build; none if the build fails, which the first one would have.
fn stage_of_build(body: &Body, stage: Stage) -> Duration {
    let built = build::build(body.mesh.clone(), &body.session(&[]), &Clock::start());
    let timings = built.as_ref().map(|built| built.timings()).unwrap_or_default();
    timings.iter().filter(|(other, _)| *other == stage).map(|(_, time)| *time).sum()
}
