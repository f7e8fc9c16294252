//! The eigensolver against dense decompositions.

use faer::Mat;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use sutura_core::assembly::FullModel;
use sutura_core::assembly::mass::{Mass, MassKind};
use sutura_core::assembly::sparse::BlockMatrix;
use sutura_core::control::{Control, Stage, Uncontrolled};
use sutura_core::edit::Stitch;
use sutura_core::factorization::{SparseCholesky, shifted};
use sutura_core::linalg;
use sutura_core::material::Material;
use sutura_core::mesh::TetMesh;
use sutura_core::modes::lanczos::{AuditedModes, ShiftInvert, lowest_modes};
use sutura_core::modes::rigid::rigid_modes;
use sutura_core::modes::stitched::StitchedStiffness;
use sutura_core::modes::{ModesError, orthonormality_error, relative_residuals, residual_vectors};
use sutura_core::testing::{Bar, BarMesh, Cell, Cut};

/// A body with its matrices.
struct Problem {
    model: FullModel,
    stiffness: BlockMatrix,
    mass: Mass,
    rigid: Mat<f64>,
    sigma: f64,
    factor: SparseCholesky,
}

impl Problem {
    fn new(mesh: Arc<TetMesh>, fixed: &[u32], kind: MassKind) -> Problem {
        let material = Material::stvk(1e6, 0.3, 1000.0).unwrap();
        let model = FullModel::new(mesh, &[material], fixed);
        let pattern = Arc::new(model.pattern(&[]));
        let stiffness = model.rest_stiffness(&pattern);
        let mass = model.mass(kind, &pattern);
        let rigid = rigid_modes(&model, &mass).unwrap();
        let sigma = if rigid.ncols() > 0 { 1e4 } else { 0.0 };
        let factor = SparseCholesky::of_blocks(&shifted(&stiffness, sigma, &mass)).unwrap();
        Problem { model, stiffness, mass, rigid, sigma, factor }
    }

    fn solve(&self, n_modes: usize, n_guard: usize) -> AuditedModes {
        lowest_modes(&self.shift_invert(), n_modes, n_guard, &Uncontrolled).unwrap()
    }

    fn shift_invert(&self) -> ShiftInvert<'_> {
        let Problem { factor, sigma, mass, rigid, .. } = self;
        ShiftInvert { factor, sigma: *sigma, mass, rigid: rigid.as_ref() }
    }

    /// All eigenvalues, rigid ones left out, by a dense decomposition of A = L⁻¹KL⁻ᵀ with M = LLᵀ. The
    /// eigenvalues that a divide-and-conquer method returns are right to 1e-11 of the largest only;
    /// the Rayleigh quotients of its vectors are right to the square of their error.
    fn dense_eigenvalues(&self) -> Vec<f64> {
        let identity = Mat::<f64>::identity(self.model.n(), self.model.n());
        let whitening = linalg::SmallCholesky::new(self.mass.multiply(identity.as_ref()).as_ref())
            .unwrap()
            .whitening();
        let matrix =
            linalg::gram(whitening.as_ref(), self.stiffness.multiply(whitening.as_ref()).as_ref());
        let (_, vectors) = linalg::symmetric_eigen(matrix.as_ref()).unwrap();
        let product = linalg::small_product(matrix.as_ref(), vectors.as_ref());
        let mut quotients: Vec<f64> = (0..self.model.n())
            .map(|i| {
                let energy = vectors.col(i).transpose() * product.col(i);
                energy / vectors.col(i).squared_norm_l2()
            })
            .collect();
        quotients.sort_by(f64::total_cmp);
        quotients[self.rigid.ncols()..].to_vec()
    }
}

/// Cells mirrored about the middle: with an even number along each edge the mesh of a cube has all
/// symmetries of the tetrahedron and more, so that its free modes come in ones, twos and threes.
fn cube() -> BarMesh {
    Bar { size_m: [0.1; 3], n_cells: [4; 3], cell: Cell::Five, cut: Cut::Whole }.mesh()
}

fn square_beam(cut: Cut) -> BarMesh {
    Bar { size_m: [0.4, 0.1, 0.1], n_cells: [8, 2, 2], cell: Cell::Five, cut }.mesh()
}

/// Sizes of the groups of eigenvalues that agree to 1e-7.
fn multiplicities(values: &[f64]) -> Vec<usize> {
    values.chunk_by(|a, b| b - a < 1e-7 * b).map(<[f64]>::len).collect()
}

#[test]
fn repeated_eigenvalues_are_all_found() {
    for kind in [MassKind::Lumped, MassKind::Consistent] {
        let beam = square_beam(Cut::Whole);
        let halves = square_beam(Cut::Through);
        for (mesh, fixed, least) in [
            (cube().mesh, vec![], 3),
            (beam.mesh, beam.root, 2),
            (halves.mesh.clone(), vec![], 4),
            (halves.mesh, [halves.root, halves.tip].concat(), 4),
        ] {
            let problem = Problem::new(mesh, &fixed, kind);
            let exact = problem.dense_eigenvalues();
            let AuditedModes { modes, residuals } = problem.solve(36, 8);
            for (i, (value, exact)) in modes.eigenvalues.iter().zip(&exact).take(36).enumerate() {
                // What the residual promises; far from its neighbours an eigenvalue is right to its square.
                let error = (value / exact - 1.0).abs();
                assert!(error < 1e-8, "{kind:?}: eigenvalue {i}: {value} {exact}");
            }
            let groups = multiplicities(&exact[..36]);
            assert!(groups.iter().any(|size| *size >= least), "not a test: {groups:?}");
            assert_eq!(multiplicities(&modes.eigenvalues[..36]), groups);
            let error = orthonormality_error(&problem.mass, modes.shapes.as_ref());
            assert!(error < 1e-12, "{error:e}");
            assert!(residuals[..36].iter().all(|r| *r < 1e-8), "{residuals:?}");
        }
    }
}

#[test]
fn modes_are_rayleigh_ritz_pairs_of_the_stiffness_guards_included() {
    let problem = Problem::new(cube().mesh, &[], MassKind::Lumped);
    let modes = problem.solve(12, 8).modes;
    let shapes = modes.shapes.as_ref();
    let projected = linalg::gram(shapes, problem.stiffness.multiply(shapes).as_ref());
    for (i, lambda) in modes.eigenvalues.iter().enumerate() {
        for (j, other) in modes.eigenvalues.iter().enumerate() {
            let wanted = if i == j { *lambda } else { 0.0 };
            let error = (projected[(i, j)] - wanted).abs() / (lambda * other).sqrt();
            // The stiffness's rounding is relative to its stiffest eigenvalue.
            assert!(error < 1e-9, "{i} {j}: {error:e}");
        }
    }
}

#[test]
fn the_residuals_are_those_of_the_modes_returned() {
    let beam = square_beam(Cut::HalfDepth);
    for fixed in [&beam.root[..], &[]] {
        let problem = Problem::new(beam.mesh.clone(), fixed, MassKind::Lumped);
        // Six guards more or less exact beside twelve modes: residuals of every size.
        let AuditedModes { modes, residuals } = problem.solve(12, 8);
        let shapes = modes.shapes.as_ref();
        let product = problem.stiffness.multiply(shapes);
        let residual = residual_vectors(product, &problem.mass, shapes, &modes.eigenvalues);
        let mut solved = residual.clone();
        problem.factor.solve_in_place(solved.as_mut());
        let energies: Vec<f64> =
            (0..residual.ncols()).map(|i| residual.col(i).transpose() * solved.col(i)).collect();
        let flexible = relative_residuals(&energies, &modes.eigenvalues, problem.sigma);
        let Mass::Lumped(masses) = &problem.mass else { unreachable!("the mass is lumped") };
        // An explicit residual is rounded to 1e-16 of the stiffest eigenvalue.
        let rounding = 1e-10;
        for i in 0..residuals.len() {
            let squared: f64 = (0..problem.model.n())
                .map(|row| residual[(row, i)].powi(2) / masses[row / 3])
                .sum();
            let explicit = squared.sqrt() / (modes.eigenvalues[i] + problem.sigma);
            let error = (residuals[i] - explicit).abs();
            assert!(error < 1e-3 * explicit + rounding, "{i}: {:e} {explicit:e}", residuals[i]);
            assert!(flexible[i] < residuals[i] + rounding, "{i}: {:e}", flexible[i]);
        }
        let largest = residuals.iter().copied().fold(0.0, f64::max);
        assert!(largest > 1e2 * rounding, "not a test: {residuals:?}");
    }
}

#[test]
fn a_body_with_fewer_modes_than_asked_for_gives_them_all() {
    let tiny =
        Bar { size_m: [0.1; 3], n_cells: [1, 1, 2], cell: Cell::Six, cut: Cut::Whole }.mesh();
    for (fixed, count) in [(&[][..], 30), (&tiny.root[..], 18)] {
        let problem = Problem::new(tiny.mesh.clone(), fixed, MassKind::Lumped);
        let exact = problem.dense_eigenvalues();
        assert_eq!(exact.len(), count);
        let modes = problem.solve(40, 10).modes;
        assert_eq!(modes.eigenvalues.len(), count);
        for (value, exact) in modes.eigenvalues.iter().zip(&exact) {
            assert!((value / exact - 1.0).abs() < 1e-10, "{value} {exact}");
        }
        let error = orthonormality_error(&problem.mass, modes.shapes.as_ref());
        assert!(error < 1e-12, "{error:e}");
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let beam = square_beam(Cut::HalfDepth);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            Problem::new(beam.mesh.clone(), &beam.root, MassKind::Lumped).solve(10, 4).modes
        })
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.eigenvalues, three.eigenvalues);
    assert_eq!(one.shapes.as_ref(), three.shapes.as_ref());
}

/// Cancels at the `n`th question.
struct CancelledAt {
    n: usize,
    asked: AtomicUsize,
}

impl Control for CancelledAt {
    fn is_cancelled(&self) -> bool {
        self.asked.fetch_add(1, Ordering::Relaxed) + 1 >= self.n
    }
    fn progress(&self, _stage: Stage, fraction: f64) {
        assert!((0.0..=1.0).contains(&fraction));
    }
    fn now(&self) -> Duration {
        Duration::ZERO
    }
}

#[test]
fn a_cancelled_computation_stops_at_once() {
    let beam = square_beam(Cut::Whole);
    let problem = Problem::new(beam.mesh.clone(), &beam.root, MassKind::Lumped);
    for n in [1, 4] {
        let control = CancelledAt { n, asked: AtomicUsize::new(0) };
        let result = lowest_modes(&problem.shift_invert(), 20, 4, &control);
        assert!(matches!(result, Err(ModesError::Cancelled(_))));
        assert_eq!(control.asked.load(Ordering::Relaxed), n);
    }
}

#[test]
fn half_a_solve_tells_the_energies_however_stiff_the_stitches_are() {
    let bar = square_beam(Cut::HalfDepth);
    let problem = Problem::new(bar.mesh.clone(), &bar.root, MassKind::Lumped);
    let Problem { model, stiffness, factor, .. } = &problem;
    for stiffness_n_m in [1e-3, 1e5, 1e15] {
        let stitch = |(i, &pair): (usize, &[u32; 2])| Stitch { id: i as u64, pair, stiffness_n_m };
        let stitches: Vec<Stitch> = bar.pairs.iter().enumerate().map(stitch).collect();
        let stitched = StitchedStiffness::new(model, stiffness, factor, &stitches).unwrap();
        let b = Mat::from_fn(model.n(), 3, |i, j| ((3 * i + 7 * j) as f64).sin());
        let half = stitched.forward(b.as_ref());
        let energies = half.energies();
        let x = stitched.backward(half.columns(&[2, 0]));
        for (at, j) in [2, 0].into_iter().enumerate() {
            let expected: f64 = b.col(j).transpose() * x.col(at);
            let error = (energies[j] - expected).abs() / expected;
            // What is solved for itself loses as many digits as the stitches are stiffer than the body.
            assert!(error < 1e-12, "{stiffness_n_m:e}: {error:e}");
        }
    }
}
