//! The core's stages one by one on one body: what its peers are compared with.

use crate::bodies::{Body, Failure};
use crate::clock::Clock;
use crate::measure::{Check, Times, timed};
use crate::paper;
use crate::references::{self, Reference};
use faer::linalg::solvers::Svd;
use faer::{Mat, MatRef};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use sutura_core::assembly::FullModel;
use sutura_core::assembly::mass::{Mass, MassKind};
use sutura_core::assembly::sparse::BlockMatrix;
use sutura_core::basis::{PcaMethod, WeightedDerivatives, mass_pca};
use sutura_core::build::{self, Artifacts, BuildParams};
use sutura_core::control::Uncontrolled;
use sutura_core::derivatives;
use sutura_core::factorization::{SparseCholesky, SymbolicCholesky, shifted};
use sutura_core::modes::lanczos::{self, ShiftInvert};
use sutura_core::modes::{self, LinearModes, rigid};

/// Modes that an eigensolver is asked for: the 30 of a session and a few more.
const N_MODES: usize = 36;

/// Columns of a blocked solve.
const SOLVES: [usize; 3] = [1, 8, 32];

/// Modes whose pairs give derivatives: a session's 8, and VegaFEM's 20.
const DERIVATIVE_MODES: [usize; 2] = [8, 20];

/// Columns of the basis that principal components are cut to.
const BASIS_SIZE: usize = 60;

/// What was measured of one body.
#[derive(Serialize, Deserialize)]
pub(crate) struct Kernels {
    pub(crate) n_vertices: usize,
    pub(crate) n_tets: usize,
    pub(crate) n_free_dofs: usize,
    pub(crate) n_rigid_modes: usize,
    /// σ of K + σM in 1/s².
    pub(crate) shift_per_s2: f64,
    pub(crate) factor_bytes: usize,
    /// Non-zeros of L as stored, and operations to make them.
    pub(crate) factor_nonzeros: usize,
    pub(crate) factor_flops: f64,
    /// Element tables, pattern, mass and stiffness.
    pub(crate) assembly: Times,
    /// Ordering, analysis and numbers.
    pub(crate) factorization: Times,
    /// Ordering and analysis alone.
    pub(crate) analysis: Times,
    /// Numbers alone.
    pub(crate) numeric: Times,
    pub(crate) solves: Vec<Solve>,
    pub(crate) n_modes: usize,
    /// The eigensolver alone.
    pub(crate) modes: Times,
    /// Lowest frequencies in Hz.
    pub(crate) frequencies_hz: Vec<f64>,
    pub(crate) loads: Vec<Loads>,
    pub(crate) pca: Pca,
    pub(crate) checks: Vec<Check>,
    /// ‖Kφ − λMφ‖ / ‖λMφ‖ of the worst mode.
    pub(crate) residual: f64,
}

/// One blocked solve.
#[derive(Serialize, Deserialize)]
pub(crate) struct Solve {
    pub(crate) columns: usize,
    pub(crate) times: Times,
}

/// Right-hand sides of modal derivatives.
#[derive(Serialize, Deserialize)]
pub(crate) struct Loads {
    pub(crate) n_pairs: usize,
    pub(crate) times: Times,
}

/// Principal components of modes and derivatives.
#[derive(Serialize, Deserialize)]
pub(crate) struct Pca {
    pub(crate) n_columns: usize,
    /// Thin singular value decomposition of the n × k matrix, one thread.
    pub(crate) standard: Times,
    /// The core's.
    pub(crate) ours: Times,
}

/// A body's matrices.
struct Assembled {
    model: FullModel,
    mass: Mass,
    stiffness: BlockMatrix,
}

fn assemble(body: &Body) -> Assembled {
    let model = FullModel::new(body.mesh.clone(), &body.materials, &body.fixed);
    let pattern = Arc::new(model.pattern(&[]));
    let mass = model.mass(MassKind::Lumped, &pattern);
    let stiffness = model.rest_stiffness(&pattern);
    Assembled { model, mass, stiffness }
}

/// Measures `body`.
pub(crate) fn measure(
    body: &Body,
    reference: Option<&Reference>,
    repeat: usize,
) -> Result<Kernels, Failure> {
    let mut checks = Vec::new();
    let base = small_build(body)?;
    checks.push(evaluator_check(&base));
    if let Some(reference) = reference {
        checks.push(references::check(
            "frequencies before stitching against the reference",
            &base.frequencies_hz(),
            &reference.before,
            references::LIMIT,
        ));
    }
    let sigma = base.shift_per_s2();
    drop(base);

    let (assembly, assembled) = timed(repeat, || Ok::<_, Failure>(assemble(body)))?;
    let Assembled { model, mass, stiffness } = &assembled;
    let matrix = shifted(stiffness, sigma, mass);
    let (factorization, factor) = timed(repeat, || SparseCholesky::of_blocks(&matrix))?;
    let (analysis, symbolic) =
        timed(repeat, || SymbolicCholesky::new(matrix.pattern().clone(), 3))?;
    let symbolic = Arc::new(symbolic);
    let (numeric, _) = timed(repeat, || SparseCholesky::with_symbolic(symbolic.clone(), &matrix))?;

    let mut solves = Vec::new();
    let noise = random(model.n(), SOLVES[2]);
    for columns in SOLVES {
        let b = noise.subcols(0, columns);
        // The copy of the right-hand sides is a peer's business too.
        let (times, x) = timed(repeat, || {
            let mut x = b.to_owned();
            factor.solve_in_place(x.as_mut());
            Ok::<_, Failure>(x)
        })?;
        let error = backward_error(&matrix, x.as_ref(), b);
        checks.push(Check::at_most(format!("backward error, {columns} columns"), error, 1e-13));
        solves.push(Solve { columns, times });
    }

    let rigid = rigid::rigid_modes(model, mass)?;
    let problem = ShiftInvert { factor: &factor, sigma, mass, rigid: rigid.as_ref() };
    let (modes, audited) =
        timed(repeat, || lanczos::lowest_modes(&problem, N_MODES, 0, &Uncontrolled))?;
    let linear = audited.modes;
    let spectrum = SpectrumErrors::of(&linear, &problem, stiffness);
    checks.push(Check::at_most(
        "residual ‖K_σ⁻¹Mφ − θφ‖_M / θ of the modes",
        spectrum.inverse_residual,
        1e-8,
    ));
    checks.push(Check::at_most("M-orthonormality of the modes", spectrum.orthonormality, 1e-10));

    let mut loads = Vec::new();
    for count in DERIVATIVE_MODES {
        let shapes = linear.shapes.subcols(0, count);
        let (times, all) =
            timed(repeat, || derivatives::right_hand_sides(model, shapes, &Uncontrolled))?;
        checks.push(load_check(model, shapes, all.as_ref()));
        loads.push(Loads { n_pairs: all.ncols(), times });
    }
    let count = paper::row_of(&body.name).map_or(13, |row| row.n_derivative_modes);
    let pca = principal_components(&assembled, &factor, &linear, count, repeat)?;
    checks.extend(pca.1);

    Ok(Kernels {
        n_vertices: body.mesh.vertices().len(),
        n_tets: body.mesh.tets().len(),
        n_free_dofs: model.n(),
        n_rigid_modes: rigid.ncols(),
        shift_per_s2: sigma,
        factor_bytes: factor.bytes(),
        factor_nonzeros: symbolic.n_values(),
        factor_flops: symbolic.n_flops(),
        assembly,
        factorization,
        analysis,
        numeric,
        solves,
        n_modes: N_MODES,
        modes,
        frequencies_hz: linear
            .eigenvalues
            .iter()
            .map(|lambda| lambda.sqrt() / std::f64::consts::TAU)
            .collect(),
        loads,
        pca: pca.0,
        checks,
        residual: spectrum.residual,
    })
}

/// A build without derivatives and with every tet summed.
fn small_build(body: &Body) -> Result<Artifacts, Failure> {
    let params =
        BuildParams { n_derivative_modes: 0, basis_size: 12, cubature: None, ..body.session(&[]) };
    Ok(build::build(body.mesh.clone(), &params, &Clock::start())?)
}

/// The reduced evaluator against the exact sum, over every tet: they differ by rounding alone.
pub(crate) fn evaluator_check(artifacts: &Artifacts) -> Check {
    let r = artifacts.basis_size();
    // A pose of a tenth of the body's size in its softest directions.
    let rows = artifacts.basis();
    let largest = |j: usize| rows.col(j).iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let size = 0.1 * artifacts.mesh().diagonal() / r as f64;
    let q: Vec<f64> = (0..r).map(|j| random.random_range(-size..size) / largest(j)).collect();
    let (reduced, exact) = (artifacts.model().evaluate(&q), artifacts.evaluate_exact(&q));
    let error = [(&reduced.force, &exact.force), (&reduced.stiffness, &exact.stiffness)]
        .iter()
        .map(|(a, b)| relative_distance(a, b))
        .fold((reduced.energy_j / exact.energy_j - 1.0).abs(), f64::max);
    Check::at_most("reduced energy, force and stiffness against the exact sum", error, 1e-9)
}

fn relative_distance(a: &[f64], b: &[f64]) -> f64 {
    let distance: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    (distance / b.iter().map(|b| b * b).sum::<f64>()).sqrt()
}

/// Normal numbers, the same every time.
pub(crate) fn random(n: usize, k: usize) -> Mat<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    Mat::from_fn(n, k, |_, _| random.random_range(-1.0..1.0))
}

/// Normwise: ‖Ax − b‖ / (‖A‖‖x‖ + ‖b‖) in the maximum norm, which rounding alone bounds whatever
/// the condition number.
pub(crate) fn backward_error(a: &BlockMatrix, x: MatRef<'_, f64>, b: MatRef<'_, f64>) -> f64 {
    let pattern = a.pattern();
    let mut norm = 0.0f64;
    for v in 0..pattern.n() {
        for axis in 0..3 {
            let row = a.blocks()[pattern.range(v)].iter();
            norm = norm.max(row.flat_map(|b| &b[3 * axis..][..3]).map(|x| x.abs()).sum());
        }
    }
    (a.multiply(x) - b).norm_max() / (norm * x.norm_max() + b.norm_max())
}

/// How well a set of modes solves its eigenproblem: the worst of all modes.
struct SpectrumErrors {
    /// ‖K_σ⁻¹Mφ − θφ‖_M / θ: what ARPACK's tolerance means in shift-invert mode.
    inverse_residual: f64,
    /// ‖Kφ − λMφ‖ / ‖λMφ‖.
    residual: f64,
    /// |ΦᵀMΦ − I|.
    orthonormality: f64,
}

impl SpectrumErrors {
    fn of(found: &LinearModes, problem: &ShiftInvert<'_>, stiffness: &BlockMatrix) -> Self {
        let shapes = found.shapes.as_ref();
        let weighted = problem.mass.multiply(shapes);
        let mut inverse = weighted.clone();
        problem.factor.solve_in_place(inverse.as_mut());
        let product = stiffness.multiply(shapes);
        let vectors = modes::residual_vectors(product, problem.mass, shapes, &found.eigenvalues);
        let (mut inverse_residual, mut residual) = (0.0f64, 0.0f64);
        for (j, lambda) in found.eigenvalues.iter().enumerate() {
            let theta = (lambda + problem.sigma).recip();
            let defect =
                Mat::from_fn(shapes.nrows(), 1, |i, _| inverse[(i, j)] - theta * shapes[(i, j)]);
            let squared = problem.mass.inner(defect.as_ref(), defect.as_ref())[(0, 0)];
            inverse_residual = inverse_residual.max(squared.sqrt() / theta);
            let scale = lambda * weighted.col(j).norm_l2();
            residual = residual.max(vectors.col(j).norm_l2() / scale);
        }
        let orthonormality = modes::orthonormality_error(problem.mass, shapes);
        SpectrumErrors { inverse_residual, residual, orthonormality }
    }
}

/// One right-hand side against a central second difference of the internal force, which a cubic
/// force (St. Venant–Kirchhoff) meets exactly: f(h) + f(−h) − 2f(0) = h²D²f.
fn load_check(model: &FullModel, shapes: MatRef<'_, f64>, loads: MatRef<'_, f64>) -> Check {
    let (j, pair) = derivatives::pairs(shapes.ncols())
        .into_iter()
        .enumerate()
        .rfind(|(_, [i, j])| i == j)
        .unwrap_or((0, [0, 0]));
    let shape = shapes.col(pair[0]);
    // A strain of about a hundredth: larger steps meet the cubic term's rounding, smaller ones the
    // linear term's.
    let size = 0.1 * model.mesh().diagonal() / shape.norm_max();
    let at = |sign: f64| -> Vec<f64> {
        model.internal_force(&shape.iter().map(|x| sign * size * x).collect::<Vec<_>>())
    };
    let (plus, minus) = (at(1.0), at(-1.0));
    let difference: Vec<f64> =
        plus.iter().zip(&minus).map(|(p, m)| -(p + m) / (size * size)).collect();
    let found: Vec<f64> = loads.col(j).iter().copied().collect();
    let error = relative_distance(&difference, &found);
    Check::at_most(format!("right-hand side {pair:?} against differences"), error, 1e-6)
}

/// Principal components of 30 modes and the derivatives of all pairs of `count` of them, by the core
/// and by the textbook: the leading directions of √M·D weighed.
fn principal_components(
    Assembled { model, mass, .. }: &Assembled,
    factor: &SparseCholesky,
    linear: &LinearModes,
    count: usize,
    repeat: usize,
) -> Result<(Pca, Vec<Check>), Failure> {
    let kept = linear.lowest(30);
    let mut derived =
        derivatives::right_hand_sides(model, linear.shapes.subcols(0, count), &Uncontrolled)?;
    factor.solve_in_place(derived.as_mut());
    let eigenvalues: Vec<[f64; 2]> = derivatives::pairs(count)
        .into_iter()
        .map(|pair| pair.map(|i| linear.eigenvalues[i]))
        .collect();
    let n_columns = kept.eigenvalues.len() + derived.ncols();
    let (ours, found) = timed(repeat, || {
        let group =
            WeightedDerivatives { shapes: derived.as_ref(), eigenvalues: eigenvalues.clone() };
        mass_pca(mass, &kept, &[group], BASIS_SIZE, PcaMethod::default())
    })?;

    let basis = found.basis;
    let first = kept.eigenvalues[0];
    let root: Vec<f64> = (0..model.n()).map(|i| mass.entry(i / 3, i / 3).sqrt()).collect();
    let (standard, svd) = timed(repeat, || {
        let mut columns = Mat::<f64>::zeros(model.n(), n_columns);
        for j in 0..n_columns {
            let (source, weight) = match j.checked_sub(kept.eigenvalues.len()) {
                None => (kept.shapes.col_as_slice(j), first / kept.eigenvalues[j]),
                Some(k) => {
                    let [li, lj] = eigenvalues[k];
                    (derived.col_as_slice(k), first * first / (li * lj))
                }
            };
            let column = columns.col_as_slice_mut(j);
            column.iter_mut().zip(source).zip(&root).for_each(|((c, s), m)| *c = s * m);
            let length = column.iter().map(|c| c * c).sum::<f64>().sqrt();
            column.iter_mut().for_each(|c| *c *= weight / length);
        }
        Svd::new_thin(columns.as_ref()).map_err(|_| "the singular value decomposition failed")
    })?;

    // Both spans are the same up to where the singular values have fallen to: compare the first ten.
    let mut checks = vec![Check::at_most(
        "M-orthonormality of the basis",
        modes::orthonormality_error(mass, basis.as_ref()),
        1e-10,
    )];
    let leading = svd.U().subcols(0, 10.min(basis.ncols()));
    let rooted =
        Mat::from_fn(basis.nrows(), basis.ncols(), |i, j| root[i] * basis.col_as_slice(j)[i]);
    let inside = rooted.transpose() * leading;
    let worst = (0..inside.ncols())
        .map(|j| (1.0 - inside.col(j).squared_norm_l2()).max(0.0).sqrt())
        .fold(0.0, f64::max);
    checks.push(Check::at_most("leading principal components outside the basis", worst, 1e-6));
    Ok((Pca { n_columns, standard, ours }, checks))
}
