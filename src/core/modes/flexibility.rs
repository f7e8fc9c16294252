//! The update to any tolerance, where [`series`](super::series) does not get there: Rayleigh–Ritz with the true stitched
//! stiffness in a space grown by the cached flexibility (a block generalized Davidson method whose preconditioner is
//! exact for the stiffness, by Woodbury's formula).
//!
//! 1. Residual of the old modes in the new problem: R = AAᵀU, nonzero at stitched vertices alone.
//! 2. T = K̂_σ⁻¹R = K_σ⁻¹A Z with Z = (I + C)⁻¹AᵀU: combinations of the flexibility columns.
//! 3. Ritz on [U, T] with K̂_σ.
//! 4. Residuals of the Ritz pairs through one blocked solve; they are the audit, and where they
//!    exceed the tolerance their solutions extend the space, and 3 and 4 are repeated for those pairs.
//!
//! Always from the modes of the *base* body, so that nothing accumulates over rounds of edits.

use crate::assembly::mass::Mass;
use crate::control::{self, Control, Stage};
use crate::linalg::{self, DenseError};
use crate::modes::stitched::StitchedStiffness;
use crate::modes::{AuditedSpectrum, ModesError, relative_residuals, residual_vectors};
use crate::pool::Tall;
use faer::{Mat, MatRef};

/// Rounds of refinement before the result is returned as it is. On the bodies tried, one to three
/// suffice for 1e-4 and two to five for 1e-8.
const MOST_ROUNDS: usize = 8;

/// Directions whose squared K̂_σ-length is below this fraction after scaling are dependent.
const DEPENDENT: f64 = 1e-13;

/// A new direction of which less than this fraction lies outside the space is left out.
const CANCELLED: f64 = 1e-8;

/// Projections of new directions out of the space: two are enough (Kahan), a third for safety.
const MOST_PROJECTIONS: usize = 3;

/// The base body's modes and the new problem.
pub struct Update<'a, T = f64> {
    /// K̂ and K̂_σ⁻¹.
    pub stitched: &'a StitchedStiffness<'a, T>,
    /// M.
    pub mass: &'a Mass,
    /// σ in 1/s².
    pub sigma: f64,
    /// Rigid modes of the base body (n×k, M-orthonormal).
    pub rigid: MatRef<'a, f64>,
    /// How many motions remain rigid after the edit.
    pub n_rigid_left: usize,
    /// Elastic modes of the base body, guards included.
    pub base: MatRef<'a, f64>,
    /// Their eigenvalues.
    pub eigenvalues: &'a [f64],
    /// And their residuals ([`relative_residuals`], or bounds of these).
    pub residuals: &'a [f64],
    /// Modes wanted.
    pub n_modes: usize,
    /// Relative eigenvalue error accepted for the lower half of the modes.
    pub tolerance: f64,
}

/// Updated modes with their audit.
pub struct Updated {
    /// The elastic modes wanted (n×r, M-orthonormal).
    pub shapes: Tall,
    /// Their eigenvalues, residuals and estimated errors. The audit of a mode is that of the round that accepted
    /// it: as the space grows, Ritz values only come closer to the exact ones (Cauchy's interlacing theorem).
    pub spectrum: AuditedSpectrum,
    /// Blocked solves that refinement took.
    pub n_rounds: usize,
}

/// A growing trial space: the base body's vectors and the extensions, with the two Gram matrices.
///
/// The base vectors X are M-orthonormal Ritz vectors of K, so K̂_σX is never formed: their Gram
/// matrices are I and Λ + σ + (AᵀX)ᵀ(AᵀX), and for projecting others K̂_σX = MX(Λ + σ) + A(AᵀX)
/// is close enough.
struct TrialSpace<'a> {
    problem: &'a Update<'a>,
    /// X = [rigid, U].
    base: [MatRef<'a, f64>; 2],
    /// Λ + σ of X.
    shifted: Vec<f64>,
    /// AᵀX.
    stretch: Mat<f64>,
    extensions: Vec<Extension>,
    gram_k: Mat<f64>,
    gram_m: Mat<f64>,
}

/// Columns of a trial space and K̂_σ times them.
struct Extension {
    s: Mat<f64>,
    stiff: Mat<f64>,
}

/// Columns from outside the space with what inner products need of them.
struct Candidate {
    t: Mat<f64>,
    /// M·T.
    weighted: Mat<f64>,
    /// AᵀT.
    stretch: Mat<f64>,
}

impl Candidate {
    fn new(problem: &Update<'_>, t: Mat<f64>) -> Candidate {
        let weighted = Mat::zeros(t.nrows(), t.ncols());
        let mut candidate = Candidate { t, weighted, stretch: Mat::new() };
        candidate.renew(problem);
        candidate
    }

    /// After T has changed.
    fn renew(&mut self, problem: &Update<'_>) {
        problem.mass.multiply_into(self.weighted.as_mut(), self.t.as_ref());
        self.stretch = problem.stitched.stitch_matrix().transpose_times(self.t.as_ref());
    }
}

impl<'a> TrialSpace<'a> {
    fn new(problem: &'a Update<'a>) -> TrialSpace<'a> {
        let a = problem.stitched.stitch_matrix();
        let base = [problem.rigid, problem.base];
        let stretch =
            linalg::concatenate(&base.map(|x| a.transpose_times(x)).each_ref().map(|x| x.as_ref()));
        let shifted: Vec<f64> = std::iter::repeat_n(0.0, problem.rigid.ncols())
            .chain(problem.eigenvalues.iter().copied())
            .map(|lambda| lambda + problem.sigma)
            .collect();
        let mut gram_k = linalg::gram(stretch.as_ref(), stretch.as_ref());
        for (i, value) in shifted.iter().enumerate() {
            gram_k[(i, i)] += value;
        }
        let gram_m = Mat::identity(shifted.len(), shifted.len());
        TrialSpace { problem, base, shifted, stretch, extensions: Vec::new(), gram_k, gram_m }
    }

    fn parts(&self) -> impl Iterator<Item = MatRef<'_, f64>> {
        self.base.into_iter().chain(self.extensions.iter().map(|e| e.s.as_ref()))
    }

    fn dimension(&self) -> usize {
        self.gram_k.ncols()
    }

    /// `x += alpha·S·c`.
    fn add_combination(&self, x: &mut Mat<f64>, alpha: f64, c: MatRef<'_, f64>) {
        let mut at = 0;
        for part in self.parts() {
            linalg::add_product(x.as_mut(), alpha, part, c.subrows(at, part.ncols()));
            at += part.ncols();
        }
    }

    /// SᵀMT and SᵀK̂_σT.
    fn inner_products(&self, candidate: &Candidate) -> [Mat<f64>; 2] {
        let columns = candidate.t.ncols();
        let mut inner_m = Mat::zeros(self.dimension(), columns);
        let mut at = 0;
        for part in self.parts() {
            let rows = linalg::gram(part, candidate.weighted.as_ref());
            inner_m.as_mut().subrows_mut(at, rows.nrows()).copy_from(&rows);
            at += rows.nrows();
        }
        let mut inner_k = inner_m.clone();
        let by_stitches = linalg::gram(self.stretch.as_ref(), candidate.stretch.as_ref());
        for (i, value) in self.shifted.iter().enumerate() {
            for j in 0..columns {
                inner_k[(i, j)] = value * inner_m[(i, j)] + by_stitches[(i, j)];
            }
        }
        let mut at = self.shifted.len();
        for extension in &self.extensions {
            let rows = linalg::gram(extension.stiff.as_ref(), candidate.t.as_ref());
            inner_k.as_mut().subrows_mut(at, rows.nrows()).copy_from(&rows);
            at += rows.nrows();
        }
        [inner_m, inner_k]
    }

    /// Adds columns T after projecting out, in the K̂_σ inner product, what the space already holds.
    /// K̂_σT is multiplied out afterwards: carrying it along from the right-hand side would save that
    /// product, but loses its digits to the subtraction where free bodies have large rigid components
    /// (seen: the fork breaks down at tolerance 1e-8).
    fn extend(&mut self, t: Mat<f64>) -> Result<(), DenseError> {
        let problem = self.problem;
        let before = linalg::column_norms(t.as_ref());
        let b = linalg::orthonormal_coefficients(self.gram_k.as_ref(), DEPENDENT)?;
        let mut candidate = Candidate::new(problem, t);
        let mut after = before.clone();
        for _ in 0..MOST_PROJECTIONS {
            let [_, inner_k] = self.inner_products(&candidate);
            let inner = linalg::small_product(b.transpose(), inner_k.as_ref());
            let onto = linalg::small_product(b.as_ref(), inner.as_ref());
            self.add_combination(&mut candidate.t, -1.0, onto.as_ref());
            candidate.renew(problem);
            let last = std::mem::replace(&mut after, linalg::column_norms(candidate.t.as_ref()));
            // Where little is left, rounding has left something of the space: project again.
            if after.iter().zip(&last).all(|(after, last)| *after > 1e-2 * last) {
                break;
            }
        }
        let new: Vec<usize> =
            (0..after.len()).filter(|&j| after[j] > CANCELLED * before[j]).collect();
        if new.len() < after.len() {
            candidate = Candidate::new(problem, linalg::columns(candidate.t.as_ref(), &new));
        }
        let [inner_m, mut inner_k] = self.inner_products(&candidate);
        let Candidate { t, weighted, .. } = candidate;
        let mut stiff = problem.stitched.multiply(t.as_ref());
        if problem.sigma != 0.0 {
            linalg::for_each_column(stiff.as_mut(), |j, stiff| {
                for (k, m) in stiff.iter_mut().zip(weighted.col_as_slice(j)) {
                    *k += problem.sigma * m;
                }
            });
        }
        // From K̂_σT itself where it counts: the guard modes are not converged eigenvectors.
        let mut at = 0;
        for part in self.base {
            let rows = linalg::gram(part, stiff.as_ref());
            inner_k.as_mut().subrows_mut(at, rows.nrows()).copy_from(&rows);
            at += rows.nrows();
        }
        let corner_k = linalg::gram(t.as_ref(), stiff.as_ref());
        let corner_m = linalg::gram(t.as_ref(), weighted.as_ref());
        let bordered = |gram: &Mat<f64>, cross: &Mat<f64>, corner: &Mat<f64>| {
            let column = linalg::stacked(&[cross.as_ref(), corner.as_ref()]);
            linalg::bordered_symmetric(gram.as_ref(), column.as_ref())
        };
        self.gram_k = bordered(&self.gram_k, &inner_k, &corner_k);
        self.gram_m = bordered(&self.gram_m, &inner_m, &corner_m);
        self.extensions.push(Extension { s: t, stiff });
        Ok(())
    }

    /// θ = 1/(λ + σ) descending, and coefficients C with (SC)ᵀM(SC) = I.
    fn ritz(&self) -> Result<(Vec<f64>, Mat<f64>), DenseError> {
        linalg::inverse_ritz(self.gram_k.as_ref(), self.gram_m.as_ref(), DEPENDENT)
    }
}

/// Computes the modes of the stitched body. `stops_before` a round that refines so many modes takes
/// what there is for the answer.
pub fn update(
    problem: &Update<'_>,
    stops_before: &mut dyn FnMut(usize) -> bool,
    control: &dyn Control,
) -> Result<Updated, ModesError> {
    let Update { stitched, mass, sigma, n_rigid_left, base, n_modes, tolerance, .. } = *problem;
    let a = stitched.stitch_matrix();

    // S = [rigid, U] and T = K_σ⁻¹A (I + C)⁻¹ AᵀS.
    let mut space = TrialSpace::new(problem);
    if a.n_columns() > 0 {
        let z = stitched.relaxed(space.stretch.as_ref());
        let mut t = Mat::zeros(base.nrows(), z.ncols());
        stitched.flexed_into(t.as_mut(), z.as_ref());
        space.extend(t)?;
    }
    let kept = problem.eigenvalues.len();
    let mut round = 0;
    let mut last: Option<AuditedSpectrum> = None;
    // Modes to audit: all, then those that the last round did not accept.
    let mut audited: Vec<usize> = Vec::new();
    loop {
        control::check(control)?;
        control.progress(Stage::Modes, round as f64 / 4.0);
        let (theta, c) = space.ritz()?;
        let available = theta.len().saturating_sub(n_rigid_left).min(kept);
        let wanted = n_modes.min(available);
        let c = c.subcols(n_rigid_left, wanted).to_owned();
        let combined = |c: MatRef<'_, f64>| {
            let mut shapes = Mat::zeros(base.nrows(), c.ncols());
            space.add_combination(&mut shapes, 1.0, c);
            shapes
        };
        let last_found = last.take().filter(|last| last.eigenvalues.len() == wanted);
        if last_found.is_none() {
            audited = (0..wanted).collect();
        }
        let eigenvalues: Vec<f64> =
            audited.iter().map(|i| theta[n_rigid_left + i].recip() - sigma).collect();
        let shapes = combined(linalg::columns(c.as_ref(), &audited).as_ref());
        let product = stitched.multiply(shapes.as_ref());
        let residual = residual_vectors(product, mass, shapes.as_ref(), &eigenvalues);
        // Half of a solve tells the residuals; the other half is for those that are to be refined.
        let half = stitched.forward(residual.as_ref());
        let found = relative_residuals(&half.energies(), &eigenvalues, sigma);
        let mut residuals = last_found.as_ref().map_or(vec![0.0; wanted], |l| l.residuals.clone());
        audited.iter().zip(found).for_each(|(&i, found)| residuals[i] = found);
        let beyond = theta.get(n_rigid_left + available).copied().unwrap_or(0.0);
        let kept = &theta[n_rigid_left..][..wanted];
        let mut spectrum = AuditedSpectrum::of_ritz(kept, beyond, residuals, sigma);
        if let Some(last) = last_found {
            for i in (0..wanted).filter(|i| !audited.contains(i)) {
                spectrum.error_estimates[i] = last.error_estimates[i];
                spectrum.angle_estimates[i] = last.angle_estimates[i];
            }
        }
        round += 1;
        let unaccepted = spectrum.beyond(tolerance);
        if unaccepted.is_empty() || round == MOST_ROUNDS || stops_before(unaccepted.len()) {
            let shapes = if audited.len() == wanted { shapes } else { combined(c.as_ref()) };
            // The Ritz vectors are orthonormal to about 1e-10 where large rigid parts cancelled.
            let gram = linalg::SmallCholesky::new(mass.gram(shapes.as_ref()).as_ref())?;
            let shapes = linalg::product(shapes.as_ref(), gram.whitening().as_ref());
            return Ok(Updated { shapes: shapes.into(), spectrum, n_rounds: round });
        }
        // Those that were accepted before still are.
        let refined: Vec<usize> =
            (0..audited.len()).filter(|&i| unaccepted.contains(&audited[i])).collect();
        space.extend(stitched.backward(half.columns(&refined)))?;
        (audited, last) = (unaccepted, Some(spectrum));
    }
}
