//! Lowest modes from scratch: shift-invert block Lanczos in the mass inner product.
//!
//! The operator B = K_σ⁻¹M is self-adjoint in the M-inner product; its largest eigenvalues belong to
//! the lowest λ = 1/θ − σ. With V the M-orthonormal Lanczos vectors, B V = V T + W Eᵀ: T is block
//! tridiagonal, W the remainder of the last block and E picks its columns (Grimes, Lewis and Simon,
//! "A shifted block Lanczos algorithm", SIAM J. Matrix Anal. Appl. 15, 1994).
//!
//! Modes are sought in the span of B V rather than V (Ericsson and Ruhe's implicit step, Math. Comp.
//! 35, 1980): both Gram matrices are at hand,
//!
//! (BV)ᵀK_σ(BV) = T,  (BV)ᵀM(BV) = H = T² + E(WᵀMW)Eᵀ,
//!
//! so the Ritz pairs T u = μ H u, μ = λ + σ, are one operator application ahead of those of V, are
//! true Rayleigh quotients of K (ΦᵀKΦ = Λ to rounding, guards included), and start vectors need no
//! smoothing. The residual of x = B V u is known as well: K_σx − μMx = M(Vu − μx).
//!
//! Each block is orthogonalized against the two before it (the recurrence) and then once against
//! all: after the recurrence it leans on the others by 1e-13 at most, and one pass leaves rounding. A
//! second pass follows only where a block loses digits. So no ghost eigenvalues appear, and repeated
//! ones are found as long as their multiplicity is at most the block size. Nothing is restarted: the
//! basis grows to four times the number of modes. (faer's partial eigensolver was measured to
//! return wrong modes.)

use crate::assembly::mass::Mass;
use crate::control::{self, Control, Stage};
use crate::factorization::SparseCholesky;
use crate::lanes::{self, LANES, LaneBlock};
use crate::linalg::{self, DenseError};
use crate::modes::{LinearModes, ModesError};
use crate::pool::Tall;
use faer::{Mat, MatRef};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::slice;

/// Vectors a step: as many as are held abreast. Solves of 16 take two thirds as long a vector, but
/// 1.4 times as many vectors are needed.
const BLOCK: usize = LANES;

/// Relative residual (see [`AuditedModes::residuals`]) to which the wanted modes converge; the
/// Euclidean ‖Kφ − λMφ‖/‖λMφ‖ is about as large.
const TOLERANCE: f64 = 5e-9;

/// The same for the guard modes. Updates take all modes for exact invariants of the unstitched body
/// (`modes::seams`): what guards leave of that shows in the orthonormality of updated modes.
const GUARD_TOLERANCE: f64 = 1e-6;

/// A Lanczos vector shorter than this fraction of the largest eigenvalue is rounding noise.
const BREAKDOWN: f64 = 1e-13;

/// Squared length, relative to its columns', below which a direction of a block is dependent.
const DEPENDENT: f64 = 1e-14;

/// A block that leans on earlier vectors by more than this share of its length, or of which some
/// direction is shorter than the columns by more than this factor, is orthogonalized again.
const CANCELLATION: f64 = 0.1;

/// Ritz vectors of B whose eigenvalues are below this fraction of the last wanted have no share in the
/// modes; those of the random start vectors can be lost in rounding.
const NEGLIGIBLE: f64 = 1e-6;

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

/// Modes with their residuals.
pub struct AuditedModes {
    /// Ascending, M-orthonormal, with ΦᵀKΦ = Λ.
    pub modes: LinearModes,
    /// ‖Kφ − λMφ‖ in the norm of M⁻¹, relative to λ + σ: an exact eigenvalue lies within this fraction
    /// of λ + σ. It bounds [`relative_residuals`](super::relative_residuals) from above (measured: by
    /// a factor of 10 to 50) since lower modes have no part in a mode's residual, and costs nothing.
    pub residuals: Vec<f64>,
}

/// The `n_modes` lowest elastic modes and, beyond them, up to `n_guard` less exact ones.
pub fn lowest_modes(
    problem: &ShiftInvert<'_>,
    n_modes: usize,
    n_guard: usize,
    control: &dyn Control,
) -> Result<AuditedModes, ModesError> {
    let n = problem.factor.n();
    let n_elastic = n - problem.rigid.ncols();
    let wanted = n_modes.min(n_elastic);
    let kept = (n_modes + n_guard).min(n_elastic);
    let most = (12 * kept.max(20)).min(n_elastic);
    if kept == 0 {
        let modes = LinearModes { shapes: Tall::new(n, 0), eigenvalues: Vec::new() };
        return Ok(AuditedModes { modes, residuals: Vec::new() });
    }

    let mut krylov = Krylov::new(problem);
    krylov.append_random(BLOCK.min(n_elastic))?;
    let mut schedule = Schedule { next: 2 * kept, last: None };
    loop {
        control::check(control)?;
        krylov.apply()?;
        let dim = krylov.dim;
        let done = dim >= most;
        if done || dim >= schedule.next {
            let pairs = krylov.ritz(kept)?;
            // Guards are done where their residuals would be wanted modes' at this tolerance.
            let guards = pairs.residuals[wanted..].iter().map(|r| r * TOLERANCE / GUARD_TOLERANCE);
            let worst = pairs.residuals[..wanted].iter().copied().chain(guards).fold(0.0, f64::max);
            let progress = worst.max(TOLERANCE).log10() / TOLERANCE.log10();
            control.progress(Stage::Modes, progress.clamp(0.0, 1.0));
            if worst <= TOLERANCE || done {
                if worst.is_nan() || worst > 1e3 * TOLERANCE {
                    return Err(ModesError::NotConverged { residual: worst, dimension: dim });
                }
                return Ok(krylov.modes(&pairs));
            }
            schedule.plan(dim, worst);
        }
        krylov.expand(n_elastic - dim)?;
    }
}

/// When to look at the Ritz pairs: an eigenproblem of the size of the basis is not free.
struct Schedule {
    next: usize,
    last: Option<(usize, f64)>,
}

impl Schedule {
    /// Aims at three quarters of the way to convergence as the last two looks extrapolate it.
    fn plan(&mut self, dim: usize, worst: f64) {
        let ahead = match self.last {
            Some((before, residual)) if worst < residual => {
                let per_vector = (residual / worst).ln() / (dim - before) as f64;
                (0.75 * (worst / TOLERANCE).ln() / per_vector) as usize
            }
            _ => 0,
        };
        self.last = Some((dim, worst));
        self.next = dim + ahead.clamp(1, 8 * BLOCK);
    }
}

/// Ritz pairs in the span of BV, lowest first.
struct RitzPairs {
    /// μ = λ + σ.
    shifted: Vec<f64>,
    /// u, scaled so that B V u has unit mass norm.
    coefficients: Mat<f64>,
    /// T u.
    in_basis: Mat<f64>,
    residuals: Vec<f64>,
}

/// The Krylov space of B so far.
///
/// Rows of vectors are in the order of the factor, so that no solve has to move them.
struct Krylov<'a> {
    problem: &'a ShiftInvert<'a>,
    /// M.
    mass: Mass,
    rigid: Vec<LaneBlock>,
    /// Random vectors drawn.
    n_random: u64,
    /// V by blocks: only the last may have fewer than eight vectors, and zero ones after them.
    basis: Vec<LaneBlock>,
    /// Vectors in V.
    dim: usize,
    /// Vectors of the block that [`Krylov::apply`] has not seen, or of the last it has.
    width: usize,
    /// T.
    projected: Mat<f64>,
    /// W ≈ V_next·coupling: what the last block of V has in common with B times the one before.
    coupling: Mat<f64>,
    /// W.
    remainder: LaneBlock,
    /// WᵀMW.
    gram: Mat<f64>,
    /// Largest share of a W's column that W leant on V by, after the recurrence.
    leaning: f64,
    /// Length of what was left out of all blocks as dependent.
    lost: f64,
}

impl<'a> Krylov<'a> {
    fn new(problem: &'a ShiftInvert<'a>) -> Krylov<'a> {
        let symbolic = problem.factor.symbolic();
        let order = |block: LaneBlock| block.by_vertices(|at| symbolic.order()[at]);
        Krylov {
            problem,
            mass: problem.mass.permuted(symbolic.order(), symbolic.position()),
            rigid: LaneBlock::split(problem.rigid).into_iter().map(order).collect(),
            n_random: 0,
            basis: Vec::new(),
            dim: 0,
            width: 0,
            projected: Mat::zeros(0, 0),
            coupling: Mat::zeros(0, 0),
            remainder: LaneBlock::zeros(problem.factor.n()),
            gram: Mat::zeros(0, 0),
            leaning: 0.0,
            lost: 0.0,
        }
    }

    /// W = B V_last less its part in V, and the next block column of T.
    fn apply(&mut self) -> Result<(), DenseError> {
        let mass = &self.mass;
        let (dim, width) = (self.dim, self.width);
        let first = dim - width;
        let before = first - self.coupling.ncols();
        let Some(last) = self.basis.last() else { return Ok(()) };
        mass.multiply_lanes(&mut self.remainder, last);
        self.problem.factor.solve_lanes(&mut self.remainder);

        let recent = &self.basis[before / LANES..];
        let c = take_out(mass, &mut self.remainder, recent);
        let mut diagonal = c.submatrix(first - before, 0, width, width).to_owned();
        take_out(mass, &mut self.remainder, &self.rigid);
        let c = take_out(mass, &mut self.remainder, &self.basis);
        diagonal += c.submatrix(first, 0, width, width);
        self.gram = gram(mass, &self.remainder, width);
        self.leaning = (0..width)
            .map(|j| c.col(j).norm_max() / self.gram[(j, j)].sqrt().max(f64::MIN_POSITIVE))
            .fold(0.0, f64::max);

        let mut grown = Mat::zeros(dim, dim);
        grown.as_mut().submatrix_mut(0, 0, first, first).copy_from(&self.projected);
        for j in 0..width {
            for i in 0..width {
                grown[(first + i, first + j)] = 0.5 * (diagonal[(i, j)] + diagonal[(j, i)]);
            }
        }
        let (rows, columns) = (self.coupling.nrows(), self.coupling.ncols());
        grown.as_mut().submatrix_mut(first, before, rows, columns).copy_from(&self.coupling);
        grown
            .as_mut()
            .submatrix_mut(before, first, columns, rows)
            .copy_from(self.coupling.transpose());
        self.projected = grown;
        Ok(())
    }

    /// The `count` lowest Ritz pairs of T u = μ H u.
    ///
    /// With T = YΘYᵀ and u = YΘ^(−½)z they are those of (Θ + SᵀGS) z = z/μ, S being the last rows of
    /// YΘ^(−½) and G = WᵀMW.
    fn ritz(&self, count: usize) -> Result<RitzPairs, DenseError> {
        let (dim, width) = (self.dim, self.width);
        let (theta, y) = linalg::symmetric_eigen(self.projected.as_ref())?;
        let floor = NEGLIGIBLE * theta[dim - count];
        let first = theta.partition_point(|t| *t <= floor).min(dim - count);
        let (theta, y) = (&theta[first..], y.subcols(first, dim - first));
        let root: Vec<f64> = theta.iter().map(|t| t.max(f64::MIN_POSITIVE).sqrt()).collect();
        let size = root.len();
        let last = Mat::from_fn(width, size, |i, k| y[(dim - width + i, k)] / root[k]);
        let weighted = linalg::small_product(self.gram.as_ref(), last.as_ref());
        let mut matrix = linalg::small_product(last.transpose(), weighted.as_ref());
        for (k, theta) in theta.iter().enumerate() {
            matrix[(k, k)] += theta;
        }
        let (inverse, z) = linalg::symmetric_eigen(matrix.as_ref())?;
        let largest = |k: usize| size - 1 - k;
        let scaled = Mat::from_fn(size, count, |i, k| {
            z[(i, largest(k))] / (root[i] * inverse[largest(k)].sqrt())
        });
        let coefficients = linalg::small_product(y, scaled.as_ref());
        // The product and not YΘ^(½)z: T falls off towards its last blocks, whose stiff directions
        // would feel rounding of the size of the first.
        let in_basis = linalg::small_product(self.projected.as_ref(), coefficients.as_ref());
        // The eigenproblem's rounding is relative to its largest eigenvalue: of a slender body, whose
        // first mode lies far below the others, the higher modes keep 1e-9 of the first. In this
        // order they lose it again.
        let u_last = coefficients.subrows(dim - width, width);
        let mut mass = linalg::gram(in_basis.as_ref(), in_basis.as_ref());
        mass += linalg::gram(u_last, linalg::small_product(self.gram.as_ref(), u_last).as_ref());
        let turn = linalg::SmallCholesky::new(mass.as_ref())?.whitening();
        let coefficients = linalg::small_product(coefficients.as_ref(), turn.as_ref());
        let in_basis = linalg::small_product(in_basis.as_ref(), turn.as_ref());

        let u_last = coefficients.subrows(dim - width, width);
        let weighted = linalg::small_product(self.gram.as_ref(), u_last);
        let shifted: Vec<f64> = (0..count).map(|k| inverse[largest(k)].recip()).collect();
        let residuals = (0..count)
            .map(|k| {
                // ‖V(u − μTu) − μW u_last‖²_M, V and W being orthogonal.
                let mu = shifted[k];
                let inside: f64 =
                    (0..dim).map(|i| (coefficients[(i, k)] - mu * in_basis[(i, k)]).powi(2)).sum();
                let outside = u_last.col(k).transpose() * weighted.col(k);
                (inside + mu * mu * outside.max(0.0)).sqrt() / mu + self.lost * mu
            })
            .collect();
        Ok(RitzPairs { shifted, coefficients, in_basis, residuals })
    }

    /// Φ = B V u = V T u + W u_last.
    fn modes(self, pairs: &RitzPairs) -> AuditedModes {
        let (dim, count) = (self.dim, pairs.shifted.len());
        let u_last = pairs.coefficients.subrows(dim - self.width, self.width);
        let n = self.problem.factor.n();
        let mut blocks = vec![LaneBlock::zeros(n); count.div_ceil(LANES)];
        lanes::subtract_product(&mut blocks, &self.basis, (-&pairs.in_basis).as_ref());
        lanes::subtract_product(&mut blocks, slice::from_ref(&self.remainder), (-u_last).as_ref());
        drop(self.basis);
        let position = self.problem.factor.symbolic().position();
        let mut shapes = Tall::new(n, count);
        for (first, block) in (0..count).step_by(LANES).zip(blocks) {
            let shapes = shapes.as_mut().subcols_mut(first, LANES.min(count - first));
            block.by_vertices(|vertex| position[vertex] as usize).copy_to(shapes);
        }
        let eigenvalues = pairs.shifted.iter().map(|mu| mu - self.problem.sigma).collect();
        let modes = LinearModes { shapes, eigenvalues };
        AuditedModes { modes, residuals: pairs.residuals.clone() }
    }

    /// Appends the M-orthonormal directions of W to V, at most `room`; those lost to breakdown (an
    /// invariant subspace was found) are replaced by random ones.
    fn expand(&mut self, room: usize) -> Result<(), ModesError> {
        let mass = &self.mass;
        let (dim, width) = (self.dim, self.width);
        let room = room.min(width);
        let largest = (0..dim).map(|i| self.projected[(i, i)]).fold(0.0, f64::max);
        let noise = (BREAKDOWN * largest).powi(2);
        let alive = |i: usize| self.gram[(i, i)] > noise;
        let gram =
            Mat::from_fn(
                width,
                width,
                |i, j| {
                    if alive(i) && alive(j) { self.gram[(i, j)] } else { 0.0 }
                },
            );
        let whitening = linalg::orthonormal_coefficients(gram.as_ref(), DEPENDENT)?;
        // In ascending order of their share in W: the last are the surest.
        let kept = whitening.ncols().min(room);
        let whitening = whitening.subcols(whitening.ncols() - kept, kept);
        // Each column of the whitening is a unit vector over the square root of its eigenvalue.
        let shrinking = (0..kept)
            .flat_map(|j| (0..width).map(move |i| (i, j)))
            .map(|(i, j)| (whitening[(i, j)] * gram[(i, i)].sqrt()).abs())
            .fold(1.0, f64::max)
            .recip();

        let mut new = turned(&self.remainder, whitening);
        let mut coupling = linalg::small_product(whitening.transpose(), gram.as_ref());
        if self.leaning > CANCELLATION || shrinking < CANCELLATION {
            take_out(mass, &mut new, &self.rigid);
            take_out(mass, &mut new, &self.basis);
            let again = linalg::SmallCholesky::new(self::gram(mass, &new, kept).as_ref());
            match again {
                Ok(factor) => {
                    coupling = linalg::small_product(factor.lower().transpose(), coupling.as_ref());
                    new = turned(&new, factor.whitening().as_ref());
                }
                // Nothing but rounding was left of some direction: none of the block is worth keeping.
                Err(_) => coupling = Mat::zeros(0, width),
            }
        }
        let kept = coupling.nrows();
        if kept < width {
            let block = slice::from_ref(&new);
            lanes::subtract_product(slice::from_mut(&mut self.remainder), block, coupling.as_ref());
            let left = self::gram(mass, &self.remainder, width);
            self.lost += (0..width).map(|i| left[(i, i)].max(0.0)).sum::<f64>().sqrt();
        }
        self.append(new, kept, room)?;
        self.coupling =
            Mat::from_fn(room, width, |i, j| if i < kept { coupling[(i, j)] } else { 0.0 });
        Ok(())
    }

    /// Appends `count` random vectors, M-orthonormal to V and the rigid modes.
    fn append_random(&mut self, count: usize) -> Result<(), ModesError> {
        self.append(LaneBlock::zeros(self.problem.factor.n()), 0, count)
    }

    /// Appends the first `kept` vectors of `block`, which are M-orthonormal to V, to the rigid modes and to one
    /// another, and random ones up to `count` vectors.
    fn append(
        &mut self,
        mut block: LaneBlock,
        kept: usize,
        count: usize,
    ) -> Result<(), ModesError> {
        if kept < count {
            let random = self.random_vectors(&block, count - kept)?;
            for (row, random) in block.rows_mut().iter_mut().zip(random.rows()) {
                row[kept..count].copy_from_slice(&random[..count - kept]);
            }
        }
        self.width = count;
        self.dim += count;
        if count > 0 {
            self.basis.push(block);
        }
        Ok(())
    }

    /// `count` random vectors, M-orthonormal to V, to `block` and to the rigid modes.
    fn random_vectors(&mut self, block: &LaneBlock, count: usize) -> Result<LaneBlock, ModesError> {
        for _attempt in 0..4 {
            let mut new = self.draw(count);
            let mass = &self.mass;
            for _pass in 0..3 {
                take_out(mass, &mut new, &self.rigid);
                take_out(mass, &mut new, &self.basis);
                take_out(mass, &mut new, slice::from_ref(block));
                let gram = gram(mass, &new, count);
                let whitening = linalg::orthonormal_coefficients(gram.as_ref(), DEPENDENT)?;
                if whitening.ncols() < count {
                    break;
                }
                new = turned(&new, whitening.as_ref());
            }
            let error = linalg::distance_from_identity(gram(mass, &new, count).as_ref());
            if error < 1e-10 {
                return Ok(new);
            }
        }
        Err(ModesError::NotConverged { residual: f64::INFINITY, dimension: self.dim })
    }

    /// `count` vectors of random numbers, each from a stream of its own.
    fn draw(&mut self, count: usize) -> LaneBlock {
        let stream = self.n_random;
        self.n_random += count as u64;
        let mut columns = Mat::zeros(self.problem.factor.n(), count);
        linalg::for_each_column(columns.as_mut(), |j, column| {
            let mut random = ChaCha8Rng::seed_from_u64(0x5);
            random.set_stream(stream + j as u64);
            column.iter_mut().for_each(|x| *x = random.random::<f64>() - 0.5);
        });
        LaneBlock::of_columns(columns.as_ref())
    }
}

/// W ← W − P PᵀMW; returns PᵀMW.
fn take_out(mass: &Mass, w: &mut LaneBlock, p: &[LaneBlock]) -> Mat<f64> {
    let c = mass.inner_lanes(p, w);
    lanes::subtract_product(slice::from_mut(w), p, c.as_ref());
    c
}

/// `XᵀMX` of the first `width` vectors.
fn gram(mass: &Mass, x: &LaneBlock, width: usize) -> Mat<f64> {
    mass.inner_lanes(slice::from_ref(x), x).submatrix(0, 0, width, width).to_owned()
}

/// `XC`.
fn turned(x: &LaneBlock, c: MatRef<'_, f64>) -> LaneBlock {
    let mut y = LaneBlock::zeros(x.n());
    lanes::subtract_product(slice::from_mut(&mut y), slice::from_ref(x), (-c).as_ref());
    y
}
