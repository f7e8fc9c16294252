//! Edits on one body: \[M16\] Table 1 (a) and (b), its Figure 3 (coverage of the exact modes) and its
//! Figure 5 (speed-up against the number of stitches).

use crate::bodies::{Body, Failure};
use crate::clock::Clock;
use crate::measure::{Check, Times};
use crate::paper;
use crate::references::{self, Reference};
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use sutura_core::build::{self, Artifacts, BuildParams, CubatureSource, Method, RebuildParams};
use sutura_core::control::{Control, Stage};

/// Stitches of Figure 5.
const COUNTS: [usize; 8] = [1, 5, 10, 20, 40, 80, 120, 160];

/// Relative eigenvalue error asked of the lower half of the modes; [`UPPER_HALF`] times as much is
/// accepted of the upper.
pub(crate) const TOLERANCE: f64 = 1e-4;
const UPPER_HALF: f64 = 100.0;

/// Repeated rebuilds: the stages that the paper times, and all of it.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Rebuilds {
    /// What a rebuild does for the linear modes (a factorization, if it makes one).
    pub(crate) modes: Times,
    pub(crate) derivatives: Times,
    pub(crate) basis: Times,
    pub(crate) cubature: Times,
    /// From edit to reduced model.
    pub(crate) total: Times,
}

/// From scratch, and ours without and with the pairs prepared as seams.
#[derive(Serialize, Deserialize)]
pub(crate) struct Comparison {
    pub(crate) n_stitches: usize,
    pub(crate) from_scratch: Rebuilds,
    pub(crate) unprepared: Rebuilds,
    pub(crate) prepared: Rebuilds,
    /// Prepared, with a deadline of no time at all: the cubature rule is reused and its error measured;
    /// fitting it again, where that error is too large, follows in the background.
    pub(crate) first_answer: Rebuilds,
    /// Without seams, to the tolerance in the modes, but with a deadline that nothing is left of where the cubature begins: its
    /// rule is reused likewise.
    pub(crate) reusing: Rebuilds,
}

/// [M16] Table 1 (a) and (b) at the paper's number of derivatives.
#[derive(Serialize, Deserialize)]
pub(crate) struct Table {
    pub(crate) n_derivatives: usize,
    pub(crate) comparison: Comparison,
}

/// The share of each exact mode that a set of vectors spans, in the mass norm.
#[derive(Serialize, Deserialize)]
pub(crate) struct Coverage {
    /// Whose vectors.
    pub(crate) by: String,
    /// How many of them.
    pub(crate) n_vectors: usize,
    /// One number an exact mode, 0 to 1.
    pub(crate) share: Vec<f64>,
}

/// What was measured of one body.
#[derive(Serialize, Deserialize)]
pub(crate) struct Edits {
    pub(crate) table: Table,
    pub(crate) coverage: Vec<Coverage>,
    /// Session settings, by the number of stitches.
    pub(crate) speedup: Vec<Comparison>,
    pub(crate) checks: Vec<Check>,
    pub(crate) notes: Vec<Check>,
}

/// Measures `body`, with edits of up to `most_stitches`.
pub(crate) fn measure(
    body: &Body,
    reference: Option<&Reference>,
    most_stitches: usize,
    repeat: usize,
) -> Result<Edits, Failure> {
    let (table, mut checks, notes) = table(body, reference, repeat)?;
    let most = body.pairs(most_stitches);
    let mut counts: Vec<usize> =
        COUNTS.iter().copied().chain([body.stitches.len()]).filter(|n| *n <= most.len()).collect();
    counts.sort_unstable();
    counts.dedup();
    let bases = Bases::build(body, [&body.session(&[]), &body.session(&[]), &body.session(&most)])?;
    let speedup = counts
        .iter()
        .map(|&count| bases.compare(body, &most[..count], repeat))
        .collect::<Result<_, _>>()?;
    let (coverage, found) = coverage(body, &bases.plain)?;
    checks.extend(found);
    Ok(Edits { table, coverage, speedup, checks, notes })
}

/// The bodies that the three ways start from.
struct Bases {
    from_scratch: Artifacts,
    plain: Artifacts,
    prepared: Artifacts,
}

impl Bases {
    fn build(
        body: &Body,
        [from_scratch, plain, prepared]: [&BuildParams; 3],
    ) -> Result<Bases, Failure> {
        let build = |params: &BuildParams| -> Result<Artifacts, Failure> {
            let built = build::build(body.mesh.clone(), params, &Clock::start())?;
            build::prepare_seams(&built, &params.seams, &Clock::start())?;
            Ok(built)
        };
        Ok(Bases {
            from_scratch: build(from_scratch)?,
            plain: build(plain)?,
            prepared: build(prepared)?,
        })
    }

    /// What `edit` (a base body, repetitions) takes without seams. An edit of few pairs prepares them on its way, for
    /// later edits too: then each repetition needs a body that has not seen them.
    fn unprepared(
        &self,
        body: &Body,
        repeat: usize,
        edit: &dyn Fn(&Artifacts, usize) -> Result<Rebuilds, Failure>,
    ) -> Result<Rebuilds, Failure> {
        let mut all = Vec::new();
        while all.len() < repeat {
            let fresh = build::build(body.mesh.clone(), self.plain.params(), &Clock::start())?;
            all.push(edit(&fresh, 1)?);
            if fresh.n_prepared_pairs() == 0 {
                return edit(&self.plain, repeat);
            }
        }
        let of = |stage: fn(&Rebuilds) -> &Times| {
            Times::of(&all.iter().map(|r| stage(r).median_s).collect::<Vec<_>>())
        };
        Ok(Rebuilds {
            modes: of(|r| &r.modes),
            derivatives: of(|r| &r.derivatives),
            basis: of(|r| &r.basis),
            cubature: of(|r| &r.cubature),
            total: of(|r| &r.total),
        })
    }

    fn compare(
        &self,
        body: &Body,
        pairs: &[[u32; 2]],
        repeat: usize,
    ) -> Result<Comparison, Failure> {
        let times = |base, method| Ok::<_, Failure>(rebuilds(body, base, pairs, method, repeat)?.0);
        Ok(Comparison {
            n_stitches: pairs.len(),
            from_scratch: times(&self.from_scratch, Method::FromScratch)?,
            unprepared: self.unprepared(body, repeat, &|base, repeat| {
                Ok(rebuilds(body, base, pairs, Method::Flexibility, repeat)?.0)
            })?,
            prepared: times(&self.prepared, Method::Flexibility)?,
            first_answer: rebuilds_by(body, &self.prepared, pairs, &hurried(), repeat)?.0,
            reusing: self
                .unprepared(body, repeat, &|base, repeat| reusing(body, base, pairs, repeat))?,
        })
    }
}

/// See [`Comparison::reusing`].
fn reusing(
    body: &Body,
    base: &Artifacts,
    pairs: &[[u32; 2]],
    repeat: usize,
) -> Result<Rebuilds, Failure> {
    let clock = || Leaping { clock: Clock::start(), has_leapt: AtomicBool::new(false) };
    let deadline = Some(LEAP / 2);
    let params = RebuildParams { deadline, ..RebuildParams::new(Method::Flexibility, TOLERANCE) };
    let (mut rebuilds, made) = rebuilds_with(body, base, pairs, &params, repeat, &clock)?;
    if made.cubature().is_some_and(|report| report.source != CubatureSource::Reused) {
        return Err("the cubature rule was not reused".into());
    }
    rebuilds.cubature = rebuilds.cubature.less(LEAP.as_secs_f64());
    Ok(rebuilds)
}

/// A clock that leaps when the basis is made.
struct Leaping {
    clock: Clock,
    has_leapt: AtomicBool,
}

const LEAP: Duration = Duration::from_secs(1 << 20);

impl Control for Leaping {
    fn is_cancelled(&self) -> bool {
        false
    }
    fn progress(&self, _stage: Stage, _fraction: f64) {}
    fn ended(&self, stage: Stage) {
        if stage == Stage::Basis {
            self.has_leapt.store(true, Ordering::Relaxed);
        }
    }
    fn now(&self) -> Duration {
        let leap = if self.has_leapt.load(Ordering::Relaxed) { LEAP } else { Duration::ZERO };
        self.clock.now() + leap
    }
}

/// Whatever fits into no time at all.
fn hurried() -> RebuildParams {
    let deadline = Some(Duration::ZERO);
    RebuildParams { deadline, ..RebuildParams::new(Method::Flexibility, TOLERANCE) }
}

/// Stitches `pairs` on `base` several times over.
fn rebuilds(
    body: &Body,
    base: &Artifacts,
    pairs: &[[u32; 2]],
    method: Method,
    repeat: usize,
) -> Result<(Rebuilds, Artifacts), Failure> {
    rebuilds_by(body, base, pairs, &RebuildParams::new(method, TOLERANCE), repeat)
}

fn rebuilds_by(
    body: &Body,
    base: &Artifacts,
    pairs: &[[u32; 2]],
    params: &RebuildParams,
    repeat: usize,
) -> Result<(Rebuilds, Artifacts), Failure> {
    rebuilds_with(body, base, pairs, params, repeat, &Clock::start)
}

/// The same with a new clock each time.
fn rebuilds_with<C: Control>(
    body: &Body,
    base: &Artifacts,
    pairs: &[[u32; 2]],
    params: &RebuildParams,
    repeat: usize,
    clock: &dyn Fn() -> C,
) -> Result<(Rebuilds, Artifacts), Failure> {
    let edits = body.stitch(pairs);
    let mut seconds: [Vec<f64>; 5] = Default::default();
    loop {
        let start = Instant::now();
        let (made, _) = build::rebuild(base, &edits, params, &clock())?;
        let stages: [&[Stage]; 4] = [
            &[Stage::Assembly, Stage::Factorization, Stage::Modes, Stage::Seams],
            &[Stage::Derivatives],
            &[Stage::Basis],
            &[Stage::Cubature],
        ];
        for (list, stages) in seconds.iter_mut().zip(stages) {
            list.push(stage_seconds(&made, stages));
        }
        seconds[4].push(start.elapsed().as_secs_f64());
        if seconds[4].len() >= repeat {
            let [modes, derivatives, basis, cubature, total] = seconds.map(|s| Times::of(&s));
            return Ok((Rebuilds { modes, derivatives, basis, cubature, total }, made));
        }
    }
}

/// Seconds that `stages` took.
pub(crate) fn stage_seconds(artifacts: &Artifacts, stages: &[Stage]) -> f64 {
    let those = artifacts.timings().iter().filter(|(stage, _)| stages.contains(stage));
    those.map(|(_, time)| time.as_secs_f64()).sum()
}

/// Table 1 (a) and (b), with the checks of the updated modes.
fn table(
    body: &Body,
    reference: Option<&Reference>,
    repeat: usize,
) -> Result<(Table, Vec<Check>, Vec<Check>), Failure> {
    let count = paper::row_of(&body.name).map_or(8, |row| row.n_derivative_modes);
    let with =
        |seams: &[[u32; 2]]| BuildParams { n_derivative_modes: count, ..body.session(seams) };
    let bases = Bases::build(body, [&with(&[]), &with(&[]), &with(&body.stitches)])?;
    let pairs = &body.stitches[..];
    let (from_scratch, exact) =
        rebuilds(body, &bases.from_scratch, pairs, Method::FromScratch, repeat)?;
    let (unprepared, updated) = rebuilds(body, &bases.plain, pairs, Method::Flexibility, repeat)?;
    let (prepared, same) = rebuilds(body, &bases.prepared, pairs, Method::Flexibility, repeat)?;
    let (first_answer, _) = rebuilds_by(body, &bases.prepared, pairs, &hurried(), repeat)?;
    let reusing = reusing(body, &bases.plain, pairs, repeat)?;

    let hz = updated.frequencies_hz();
    let half = hz.len().div_ceil(2);
    let mut checks = Vec::new();
    let mut compare = |name: &str, truth: &[f64]| {
        // A frequency errs by half of what its eigenvalue does.
        let halves = [("lower", 0..half, 1.0), ("upper", half..hz.len(), UPPER_HALF)];
        for (which, range, factor) in halves {
            let what = format!("updated frequencies, {which} half, against {name}");
            let limit = 0.5 * factor * TOLERANCE;
            checks.push(references::check(&what, &hz[range.clone()], &truth[range], limit));
        }
    };
    compare("from scratch", &exact.frequencies_hz());
    if let Some(reference) = reference {
        compare("the reference", &reference.after);
        checks.push(references::check(
            "frequencies from scratch, stitched, against the reference",
            &exact.frequencies_hz(),
            &reference.after,
            references::LIMIT,
        ));
    }
    checks.push(references::check(
        "updated frequencies with and without seams",
        &same.frequencies_hz(),
        &hz,
        // Each is within its tolerance of the truth.
        0.5 * UPPER_HALF * TOLERANCE,
    ));
    let mut notes = Vec::new();
    if let Some(report) = updated.cubature() {
        let source = name_of(report.source);
        notes.push(Check::at_most(
            format!("force error of the cubature after the edit ({source})"),
            report.validation_error,
            0.05,
        ));
    }
    Ok((
        Table {
            n_derivatives: count * (count + 1) / 2,
            comparison: Comparison {
                n_stitches: pairs.len(),
                from_scratch,
                unprepared,
                prepared,
                first_answer,
                reusing,
            },
        },
        checks,
        notes,
    ))
}

/// Where a cubature rule came from.
pub(crate) fn name_of(source: CubatureSource) -> &'static str {
    match source {
        CubatureSource::Trained => "trained",
        CubatureSource::Reused => "reused",
        CubatureSource::Refitted => "refitted",
        CubatureSource::Retrained => "trained anew",
    }
}

/// Figure 3: how much of each exact mode of the stitched body the vectors of each method span.
fn coverage(body: &Body, base: &Artifacts) -> Result<(Vec<Coverage>, Vec<Check>), Failure> {
    let made = |method| rebuilds(body, base, &body.stitches, method, 1).map(|(_, made)| made);
    let exact = modes_of(&made(Method::FromScratch)?);
    let masses = base.lumped_mass_kg();
    let mut curves = Vec::new();
    let mut checks = Vec::new();
    let flexibility = made(Method::Flexibility)?;
    let low_rank = made(Method::LowRank)?;
    let sources = [("flexibility", &flexibility), ("low_rank", &low_rank), ("original", base)];
    for (name, artifacts) in sources {
        let modes = modes_of(artifacts);
        checks.extend(orthonormality(name, &modes, masses, artifacts));
        for n in [10, 20, 30].into_iter().filter(|n| *n <= modes.len()) {
            let share = shares(&exact, &modes[..n], masses);
            curves.push(Coverage { by: format!("{name} modes"), n_vectors: n, share });
        }
        let basis: Vec<_> =
            (0..artifacts.basis_size()).map(|i| artifacts.basis_column(i)).collect();
        let share = shares(&exact, &basis, masses);
        curves.push(Coverage { by: format!("{name} basis"), n_vectors: basis.len(), share });
    }
    Ok((curves, checks))
}

fn modes_of(artifacts: &Artifacts) -> Vec<Vec<f64>> {
    (0..artifacts.n_modes()).map(|i| artifacts.mode(i)).collect()
}

/// ‖Uᵀ M φ‖ / ‖φ‖_M of each `exact` φ; `vectors` are M-orthonormal.
fn shares(exact: &[Vec<f64>], vectors: &[Vec<f64>], masses: &[f64]) -> Vec<f64> {
    let share = |mode: &Vec<f64>| {
        let inside: f64 = vectors.iter().map(|v| inner(v, mode, masses).powi(2)).sum();
        (inside / inner(mode, mode, masses)).sqrt()
    };
    exact.iter().map(share).collect()
}

fn inner(x: &[f64], y: &[f64], masses: &[f64]) -> f64 {
    let products = x.chunks_exact(3).zip(y.chunks_exact(3)).zip(masses);
    products.map(|((x, y), m)| m * (x[0] * y[0] + x[1] * y[1] + x[2] * y[2])).sum()
}

/// M-orthonormality of the modes and of the basis of a generation.
fn orthonormality(
    name: &str,
    modes: &[Vec<f64>],
    masses: &[f64],
    artifacts: &Artifacts,
) -> [Check; 2] {
    let worst = |vectors: &[Vec<f64>]| {
        let mut worst = 0.0f64;
        for (i, x) in vectors.iter().enumerate() {
            for (j, y) in vectors[..=i].iter().enumerate() {
                worst = worst.max((inner(x, y, masses) - f64::from(i == j)).abs());
            }
        }
        worst
    };
    let basis: Vec<_> = (0..artifacts.basis_size()).map(|i| artifacts.basis_column(i)).collect();
    [
        Check::at_most(format!("M-orthonormality of {name} modes"), worst(modes), 1e-8),
        Check::at_most(format!("M-orthonormality of the {name} basis"), worst(&basis), 1e-8),
    ]
}
