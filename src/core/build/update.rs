//! Edits from the base body's factorization: inside a seam without a solve, elsewhere by refinement, or
//! by the paper's low-rank update.

use super::artifacts::Prepared;
use super::certificate::Verdict;
use super::finish::Draft;
use super::params::{BuildError, Derivatives};
use super::span::{PreparedSpan, Span, best_source};
use super::{StageClock, refined, seams};
use crate::control::Stage;
use crate::cubature::Rule;
use crate::derivatives;
use crate::edit::EditState;
use crate::linalg::{self, DenseError};
use crate::modes::prepared::PreparedStitches;
use crate::modes::seams::{SeamRecipe, Seams};
use crate::modes::stitched::StitchMatrix;
use crate::modes::{AuditedSpectrum, rigid};
use faer::{Mat, MatRef};
use std::sync::Arc;

/// Share of a mode (squared) that load cases may not know of before the caller is told. Measured on the
/// bodies of the benchmarks: all their stitches by the stiffness that was prepared for leave 1e-12, all
/// but three 4e-7 to 1e-4, half of them 4e-5 to 7e-3.
const UNEXPLAINED: f64 = 1e-3;

/// The same, above which an edit that is to have derivatives of its own solves for them: 15 pairs of fork and
/// dinosaur, below the share that a warning takes, leave 4.5 and 1.6 times the static error of a basis from scratch.
const KNOWN: f64 = 1e-6;

/// Pairs without a seam that an edit makes one for on the way: their columns and load cases take no more
/// solves than refined modes and their derivatives do.
const PREPARED_ON_THE_WAY: usize = 4;

/// What is asked of an update by flexibility.
#[derive(Clone, Copy)]
pub(super) struct Wanted {
    /// Relative eigenvalue error accepted.
    pub(super) tolerance: f64,
    pub(super) derivatives: Derivatives,
}

/// Everything up to the derivatives. `reuse` are cubature rules, that in use first, `seams` are what is prepared, if anything is.
pub(super) fn by_flexibility(
    prepared: Arc<Prepared>,
    state: EditState,
    reuse: Vec<(Rule, f64)>,
    seams: Option<Arc<Seams>>,
    wanted: Wanted,
    clock: &mut StageClock<'_>,
) -> Result<Draft, BuildError> {
    let tolerance = wanted.tolerance;
    let Some(InSeams { spectrum, n_rigid_modes, span, has_solved, unexplained }) =
        in_seams(&prepared, &state, seams, wanted, clock)?
    else {
        return refined::refined(prepared, state, reuse, Some(tolerance), clock);
    };
    let mut warnings = Vec::new();
    if unexplained > UNEXPLAINED {
        let follow = match wanted.derivatives {
            Derivatives::Own => "its own follow",
            Derivatives::Prepared => "its own come when they are asked for",
        };
        warnings.push(format!(
            "the basis has the modal derivatives of the open and of the closed seam, whose modes differ \
             from these by {:.0e}: {follow}",
            unexplained.sqrt()
        ));
    }
    clock.finish(Stage::Derivatives)?;
    // A base body that holds every stitch has these modes itself.
    let verdict = match (has_solved, state.is_folded_whole()) {
        (true, _) => Verdict::Refined,
        (_, true) => Verdict::Rebuilt,
        (_, false) => Verdict::Patched,
    };
    Ok(Draft {
        prepared,
        state,
        verdict,
        tolerance: Some(tolerance),
        n_rigid_modes,
        weighing: spectrum.eigenvalues.clone(),
        spectrum,
        // What the shift leaves of it is bounded and part of the audit of modes.
        derivative_residual: 0.0,
        span: Span::Prepared(span),
        reuse,
        warnings,
    })
}

/// The paper's update (\[M16\] §4.1).
pub(super) fn by_low_rank(
    prepared: Arc<Prepared>,
    state: EditState,
    reuse: Vec<(Rule, f64)>,
    clock: &mut StageClock<'_>,
) -> Result<Draft, BuildError> {
    refined::refined(prepared, state, reuse, None, clock)
}

/// Modes and derivatives of an edit inside a seam.
struct InSeams {
    spectrum: AuditedSpectrum,
    n_rigid_modes: usize,
    span: Box<PreparedSpan>,
    /// Whether derivatives took solves.
    has_solved: bool,
    /// Share of a mode (squared) that the derivatives do not know of.
    unexplained: f64,
}

/// Modes from what seams hold, if those hold every stitch and meet the tolerance, and derivatives from there
/// or from load cases of their own.
fn in_seams(
    prepared: &Arc<Prepared>,
    state: &EditState,
    seams: Option<Arc<Seams>>,
    wanted: Wanted,
    clock: &mut StageClock<'_>,
) -> Result<Option<InSeams>, BuildError> {
    let stitches = &state.open_stitches();
    let pairs = stitches.iter().map(|s| s.pair);
    let is_missing =
        |pair: &[u32; 2]| seams.as_ref().is_none_or(|seams| seams.position(*pair).is_none());
    let missing: Vec<[u32; 2]> = pairs.filter(is_missing).collect();
    if missing.len() > PREPARED_ON_THE_WAY {
        return Ok(None);
    }
    let mut seams = match seams {
        Some(seams) => seams,
        // Without pairs, whatever has been prepared since: that is what recipes tell.
        None => seams::remake(prepared, &SeamRecipe::default(), clock.control)?,
    };
    if !missing.is_empty() {
        seams = seams::extend(prepared, &seams, &missing, stitches, clock.control)?;
        clock.finish(Stage::Seams)?;
    }
    let Some(positions) = seams.find(stitches) else { return Ok(None) };
    let mut prepared_stitches = PreparedStitches::new(
        &seams,
        &positions,
        stitches,
        prepared.rigid().ncols(),
        &prepared.spectrum.eigenvalues,
        prepared.sigma,
    )?;
    let left = prepared_stitches.rigid_left()?;
    let n_modes = prepared.params.n_modes;
    let (mut modes, spectrum) = if stitches.is_empty() {
        let spectrum = prepared.spectrum.lowest(n_modes);
        (prepared_stitches.unstitched(spectrum.eigenvalues.len()), spectrum)
    } else {
        prepared_stitches.modes(left.ncols(), n_modes)?
    };
    let enough = spectrum.eigenvalues.len() == n_modes.min(prepared.spectrum.eigenvalues.len());
    if !enough {
        return Ok(None);
    }
    if !spectrum.beyond(wanted.tolerance).is_empty() {
        // Refining means two solves for each mode, and a column for each stitch before.
        let columns = 3 * stitches.len() + 2 * n_modes;
        if !clock.skips(prepared.column_time * columns as u32) {
            return Ok(None);
        }
    }
    clock.finish(Stage::Modes)?;
    let count = prepared.params.n_derivative_modes;
    let (_, mut unexplained) = best_source(&prepared_stitches, &modes, count);
    let mut has_solved = false;
    if unexplained > KNOWN && wanted.derivatives == Derivatives::Own {
        let n_loads = derivatives::pairs(count.min(n_modes)).len();
        if !clock.skips(prepared.column_time * n_loads as u32) {
            (prepared_stitches, modes) = seams::with_own_cases(
                prepared,
                &seams,
                &positions,
                prepared_stitches,
                modes,
                clock.control,
            )?;
            (has_solved, unexplained) = (true, 0.0);
        }
    }
    let responses = prepared_stitches.load_responses(&modes, &spectrum.eigenvalues, left.as_ref());
    let span = PreparedSpan { seams, positions, stitches: prepared_stitches, modes, responses };
    let (n_rigid_modes, span) = (left.ncols(), Box::new(span));
    Ok(Some(InSeams { spectrum, n_rigid_modes, span, has_solved, unexplained }))
}

/// The rigid motions that stretch no stitch (n×k, M-orthonormal).
pub(super) fn rigid_left(a: &StitchMatrix, rigid: MatRef<'_, f64>) -> Result<Mat<f64>, DenseError> {
    let left = rigid::unstretched(a.gaps(rigid).as_ref())?;
    Ok(linalg::product(rigid, left.as_ref()))
}
