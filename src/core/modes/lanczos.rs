//! Lowest modes from scratch: shift-invert block Lanczos in the mass inner product.
//!
//! The operator K_σ⁻¹M is self-adjoint in the M-inner product; its largest eigenvalues θ belong to
//! the lowest λ = 1/θ − σ. Every vector is orthogonalized twice against all before it and against
//! the rigid modes, so no ghost eigenvalues appear and repeated ones are found as long as their
//! multiplicity is at most the block size. Nothing is restarted: the basis grows to a few times
//! the number of modes. (faer's partial eigensolver was measured to return wrong modes.)

use crate::assembly::mass::Mass;
use crate::control::{self, Control, Stage};
use crate::factorization::SparseCholesky;
use crate::linalg;
use crate::modes::{LinearModes, ModesError};
use faer::{Mat, MatRef};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Vectors a step; eight right-hand sides share one pass over the factor.
const BLOCK: usize = 8;

/// Residual ‖K_σ⁻¹Mx − θx‖_M / θ to which the wanted modes converge. Eigenvalues are then good to
/// its square over the relative gap.
const TOLERANCE: f64 = 1e-9;

/// A Lanczos vector shorter than this fraction of the largest eigenvalue is rounding noise.
const BREAKDOWN: f64 = 1e-13;

/// The problem K x = λ M x with K_σ = K + σM factorized.
pub struct ShiftInvert<'a> {
    /// Factor of K_σ.
    pub factor: &'a SparseCholesky,
    /// σ in 1/s².
    pub sigma: f64,
    /// M.
    pub mass: &'a Mass,
    /// M-orthonormal rigid modes (n × k), to be left out.
    pub rigid: MatRef<'a, f64>,
}

/// The `n_modes` lowest elastic modes and, beyond them, up to `n_guard` less exact ones.
pub fn lowest_modes(
    problem: &ShiftInvert<'_>,
    n_modes: usize,
    n_guard: usize,
    control: &dyn Control,
) -> Result<LinearModes, ModesError> {
    let n = problem.factor.n();
    let n_elastic = n - problem.rigid.ncols();
    let wanted = n_modes.min(n_elastic);
    let kept = (n_modes + n_guard).min(n_elastic);
    let most = (12 * kept.max(20)).min(n_elastic);
    let block = BLOCK.min(n_elastic);

    let mut random = ChaCha8Rng::seed_from_u64(0x5u64);
    let mut basis = Mat::<f64>::zeros(n, 0);
    let mut tridiagonal = Mat::<f64>::zeros(0, 0);
    let mut next = Mat::zeros(n, 0);
    fill(&mut next, block, &mut random, problem, basis.as_ref())?;
    loop {
        control::check(control)?;
        let first = basis.ncols();
        basis = linalg::concatenate(&[basis.as_ref(), next.as_ref()]);
        let dim = basis.ncols();
        let width = dim - first;
        let mut w = problem.mass.multiply(next.as_ref());
        problem.factor.solve_in_place(w.as_mut());
        let projection = orthogonalize(&mut w, problem, basis.as_ref());
        let mut grown = Mat::zeros(dim, dim);
        grown.as_mut().submatrix_mut(0, 0, first, first).copy_from(&tridiagonal);
        grown.as_mut().submatrix_mut(0, first, dim, width).copy_from(&projection);
        grown.as_mut().submatrix_mut(first, 0, width, dim).copy_from(projection.transpose());
        tridiagonal = grown;

        let remainder = problem.mass.inner(w.as_ref(), w.as_ref());
        let done = dim >= most;
        if done || (dim >= kept && (dim / BLOCK).is_multiple_of(2)) {
            let (theta, y) = linalg::symmetric_eigen(tridiagonal.as_ref())?;
            // Ritz residual of pair k: ‖W y_last‖_M with y_last its entries of the last block.
            let residual = |k: usize| {
                let last = y.submatrix(first, k, width, 1);
                let wy = linalg::small_product(remainder.as_ref(), last);
                (0..width).map(|i| last[(i, 0)] * wy[(i, 0)]).sum::<f64>().max(0.0).sqrt()
            };
            let worst = (dim - wanted..dim)
                .map(|k| residual(k) / theta[k].abs().max(f64::MIN_POSITIVE))
                .fold(0.0, f64::max);
            control.progress(
                Stage::Modes,
                (worst.max(TOLERANCE).log10() / TOLERANCE.log10()).clamp(0.0, 1.0),
            );
            if worst <= TOLERANCE || done {
                if worst > 1e3 * TOLERANCE {
                    return Err(ModesError::NotConverged { residual: worst, dimension: dim });
                }
                let coefficients = Mat::from_fn(dim, kept, |i, k| y[(i, dim - 1 - k)]);
                let shapes = linalg::product(basis.as_ref(), coefficients.as_ref());
                let eigenvalues =
                    (0..kept).map(|k| theta[dim - 1 - k].recip() - problem.sigma).collect();
                return Ok(LinearModes { shapes, eigenvalues });
            }
        }
        // Vectors lost to breakdown (an invariant subspace was found) are replaced by random ones.
        let room = block.min(n_elastic - dim);
        let largest = (0..dim).map(|i| tridiagonal[(i, i)]).fold(0.0, f64::max);
        let alive: Vec<usize> = (0..width)
            .filter(|&i| remainder[(i, i)].sqrt() > BREAKDOWN * largest)
            .take(room)
            .collect();
        let survivors = linalg::columns(&w, &alive);
        next = problem.mass.orthonormalize(survivors.as_ref(), 1e-14)?;
        if next.ncols() < room {
            fill(&mut next, room, &mut random, problem, basis.as_ref())?;
        }
    }
}

/// W ← (I − PPᵀM)W twice, P = [rigid, basis]; returns the coefficients on `basis`.
fn orthogonalize(w: &mut Mat<f64>, problem: &ShiftInvert<'_>, basis: MatRef<'_, f64>) -> Mat<f64> {
    let mut total = Mat::zeros(basis.ncols(), w.ncols());
    for _ in 0..2 {
        let mw = problem.mass.multiply(w.as_ref());
        let c = linalg::gram(basis, mw.as_ref());
        let d = linalg::gram(problem.rigid, mw.as_ref());
        linalg::add_product(w.as_mut(), -1.0, basis, c.as_ref());
        linalg::add_product(w.as_mut(), -1.0, problem.rigid, d.as_ref());
        total += c;
    }
    total
}

/// Grows `block` to `width` M-orthonormal columns, orthogonal to `basis` and the rigid modes, with
/// random vectors that one operator application has smoothed.
fn fill(
    block: &mut Mat<f64>,
    width: usize,
    random: &mut ChaCha8Rng,
    problem: &ShiftInvert<'_>,
    basis: MatRef<'_, f64>,
) -> Result<(), ModesError> {
    for _attempt in 0..4 {
        let missing = width - block.ncols();
        if missing > 0 {
            let mut fresh = Mat::from_fn(basis.nrows().max(problem.factor.n()), missing, |_, _| {
                StandardNormal.sample(random)
            });
            fresh = problem.mass.multiply(fresh.as_ref());
            problem.factor.solve_in_place(fresh.as_mut());
            *block = linalg::concatenate(&[block.as_ref(), fresh.as_ref()]);
        }
        for _ in 0..2 {
            orthogonalize(block, problem, basis);
            *block = problem.mass.orthonormalize(block.as_ref(), 1e-14)?;
        }
        if block.ncols() == width {
            return Ok(());
        }
    }
    Err(ModesError::NotConverged { residual: f64::INFINITY, dimension: basis.ncols() })
}
