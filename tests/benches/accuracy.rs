//! How good a rebuilt basis is: eigenvalues, principal angles, and static solutions in the subspace
//! against those of the full nonlinear body.

use crate::bodies::{Body, Failure};
use crate::clock::Clock;
use crate::edits;
use crate::loads::{self, Case, Kind, Summary};
use crate::measure::{Check, Machine, median};
use crate::peers::{Ratio, Target};
use faer::{Mat, MatRef};
use serde::{Deserialize, Serialize};
use sutura_core::assembly::mass::Mass;
use sutura_core::build::{self, Artifacts, Derivatives, Method, RebuildParams, Verdict};
use sutura_core::linalg;
use sutura_core::modes::{self, rigid};
use sutura_core::testing::statics::StitchedBody;

/// Largest relative eigenvalue error of the lower half of the modes and of all, and largest error of
/// static solutions over that of the basis from scratch.
const TARGETS: (f64, f64, f64) = (1e-4, 1e-2, 1.1);

/// Residual (a bound on the relative eigenvalue error) below which modes from scratch are a truth.
const EXACT: f64 = 1e-6;

/// Ritz values are upper bounds but for rounding and what the guard modes leave (measured: 1e-9).
const BELOW: f64 = 1e-7;

/// Leading columns of the basis from scratch whose angles are told, beside all.
pub(crate) const LEADING: [usize; 2] = [10, 30];

/// The ways to make a basis of the stitched body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Way {
    FromScratch,
    Flexibility,
    /// The stitched pairs were named as seams.
    FlexibilityPrepared,
    /// The same with derivatives of its own, where what is prepared knows too little of the stitched body.
    FlexibilityOwn,
    LowRank,
    /// The basis from before the stitches, with the rigid motions if the body is free.
    Original,
}

impl Way {
    fn is_by_flexibility(self) -> bool {
        matches!(self, Way::Flexibility | Way::FlexibilityPrepared | Way::FlexibilityOwn)
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Way::FromScratch => "from scratch",
            Way::Flexibility => "`flexibility`",
            Way::FlexibilityPrepared => "`flexibility`, seams",
            Way::FlexibilityOwn => "`flexibility`, seams, `own` derivatives",
            Way::LowRank => "`low_rank`",
            Way::Original => "original",
        }
    }
}

/// One way on one body.
#[derive(Serialize, Deserialize)]
pub(crate) struct Quality {
    pub(crate) way: Way,
    pub(crate) n_columns: usize,
    /// |λ − λ*|/λ* of each kept mode; λ* from scratch.
    pub(crate) eigenvalue_errors: Vec<f64>,
    /// Largest principal angle, in radians, between the spans of the lower half of the modes and of
    /// those from scratch.
    pub(crate) lower_half_angle: f64,
    /// Between the spans of all kept modes.
    pub(crate) modes_angle: f64,
    /// Largest angle of the [`LEADING`] columns of the basis from scratch, and of all, to the span of
    /// the basis.
    pub(crate) basis_angles: Vec<f64>,
    /// Of the generation's own rule: none that knows of the stitches before there are any.
    pub(crate) cubature: Option<Cubature>,
    pub(crate) statics: Vec<Statics>,
}

/// A cubature rule's report.
#[derive(Serialize, Deserialize)]
pub(crate) struct Cubature {
    pub(crate) source: String,
    pub(crate) n_points: usize,
    /// Force error on held-out poses in the energy norm.
    pub(crate) held_out_error: f64,
}

/// Errors of static solutions under the loads of one kind: ‖u_reduced − u‖_M/‖u‖_M, in the order of
/// the loads.
#[derive(Serialize, Deserialize)]
pub(crate) struct Statics {
    pub(crate) kind: Kind,
    /// Every tet summed.
    pub(crate) exact: Vec<f64>,
    /// By the generation's cubature.
    pub(crate) cubature: Option<Vec<f64>>,
}

/// One body.
#[derive(Serialize, Deserialize)]
pub(crate) struct Accuracy {
    pub(crate) name: String,
    pub(crate) n_free_dofs: usize,
    pub(crate) n_stitches: usize,
    /// Pairs of the seam.
    pub(crate) n_pairs: usize,
    /// Rigid motions before the stitches.
    pub(crate) n_rigid_modes: usize,
    pub(crate) loads: Vec<Summary>,
    /// From scratch first.
    pub(crate) qualities: Vec<Quality>,
    pub(crate) checks: Vec<Check>,
}

/// A run over several bodies.
#[derive(Serialize)]
pub(crate) struct Accuracies {
    pub(crate) machine: Machine,
    pub(crate) bodies: Vec<Accuracy>,
    pub(crate) targets: Vec<Ratio>,
    /// By the body that they belong to.
    pub(crate) checks: Vec<(String, Check)>,
}

/// `count` of `pairs`, spread evenly over them; all if there are no more.
fn spread(pairs: &[[u32; 2]], count: usize) -> Vec<[u32; 2]> {
    let count = count.min(pairs.len());
    (0..count).map(|i| pairs[i * pairs.len() / count]).collect()
}

/// Measures `body` at an ordinary session's settings, closed by at most `most_stitches` of its own stitches.
/// All of these are the seam that is prepared.
pub(crate) fn measure(body: &Body, most_stitches: usize) -> Result<Accuracy, Failure> {
    let closed = spread(&body.stitches, most_stitches);
    let before = build::build(body.mesh.clone(), &body.session(&[]), &Clock::start())?;
    let prepared = build::build(body.mesh.clone(), &body.session(&body.stitches), &Clock::start())?;
    build::prepare_seams(&prepared, &body.stitches, &Clock::start())?;
    let edits = body.stitch(&closed);
    let made = |base: &Artifacts, method| {
        let params = RebuildParams::new(method, edits::TOLERANCE);
        build::rebuild(base, &edits, &params, &Clock::start()).map(|(made, _)| made)
    };
    let exact = made(&before, Method::FromScratch)?;
    let mut rebuilt = vec![
        (Way::Flexibility, made(&before, Method::Flexibility)?),
        (Way::FlexibilityPrepared, made(&prepared, Method::Flexibility)?),
    ];
    let params = RebuildParams {
        derivatives: Derivatives::Own,
        ..RebuildParams::new(Method::Flexibility, edits::TOLERANCE)
    };
    let (own, _) = build::rebuild(&prepared, &edits, &params, &Clock::start())?;
    if own.certificate().verdict == Verdict::Refined {
        rebuilt.push((Way::FlexibilityOwn, own));
    }
    rebuilt.push((Way::LowRank, made(&before, Method::LowRank)?));
    drop(prepared);

    let statics = StitchedBody::new(exact.full_model(), exact.stitches())?;
    let mut cases: Vec<Case> = Vec::new();
    for kind in Kind::ALL {
        cases.extend(loads::cases(&exact, &statics, kind)?);
    }
    let truth = Truth { exact: &exact, statics: &statics, cases: &cases };
    let mut checks: Vec<Check> =
        cases.iter().flat_map(|case| loads::checks(&case.summary)).collect();
    let worst = exact.residuals().iter().copied().fold(0.0, f64::max);
    checks.push(Check::at_most("residual of the modes from scratch", worst, EXACT));

    let mut qualities = vec![truth.judge(Way::FromScratch, &exact, &mut checks)?];
    for (way, artifacts) in &rebuilt {
        qualities.push(truth.judge(*way, artifacts, &mut checks)?);
    }
    qualities.push(truth.judge(Way::Original, &before, &mut checks)?);
    Ok(Accuracy {
        name: body.name.clone(),
        n_free_dofs: before.n_free_dofs(),
        n_stitches: closed.len(),
        n_pairs: body.stitches.len(),
        n_rigid_modes: before.n_rigid_modes(),
        loads: cases.into_iter().map(|case| case.summary).collect(),
        qualities,
        checks,
    })
}

/// What the ways are judged by.
struct Truth<'a> {
    exact: &'a Artifacts,
    statics: &'a StitchedBody<'a>,
    cases: &'a [Case],
}

impl Truth<'_> {
    fn judge(
        &self,
        way: Way,
        made: &Artifacts,
        checks: &mut Vec<Check>,
    ) -> Result<Quality, Failure> {
        let mass = self.statics.mass();
        let [kept, exact_kept] = [made, self.exact].map(modes_of);
        for (what, shapes) in [("modes", kept.as_ref()), ("basis", made.basis())] {
            let what = format!("M-orthonormality, {}: {what}", way.name());
            checks.push(Check::at_most(what, modes::orthonormality_error(mass, shapes), 1e-8));
        }
        let pairs = made.eigenvalues_per_s2().iter().zip(self.exact.eigenvalues_per_s2());
        let excess: Vec<f64> = pairs.map(|(found, exact)| found / exact - 1.0).collect();
        if way.is_by_flexibility() {
            let below = excess.iter().map(|e| -e).fold(0.0, f64::max);
            checks.push(Check::at_most("Ritz values below the exact eigenvalues", below, BELOW));
        }
        let half = excess.len().div_ceil(2);
        let mut basis = made.basis().to_owned();
        if way == Way::Original && made.n_rigid_modes() > 0 {
            let rigid = rigid::rigid_modes(made.full_model(), mass)?;
            basis = linalg::concatenate(&[rigid.as_ref(), basis.as_ref()]);
        }
        let to_basis =
            |count: usize| angle(mass, self.exact.basis().subcols(0, count), basis.as_ref());
        let all = self.exact.basis_size();
        let leading = LEADING.iter().map(|&count| to_basis(count.min(all)));
        let quality = Quality {
            way,
            n_columns: basis.ncols(),
            lower_half_angle: angle(mass, exact_kept.subcols(0, half), kept.subcols(0, half))?,
            modes_angle: angle(mass, exact_kept.as_ref(), kept.as_ref())?,
            basis_angles: leading.chain([to_basis(all)]).collect::<Result<_, _>>()?,
            cubature: made.cubature().filter(|_| way != Way::Original).map(|report| Cubature {
                source: edits::name_of(report.source).into(),
                n_points: report.n_points,
                held_out_error: report.validation_error,
            }),
            eigenvalue_errors: excess.iter().map(|e| e.abs()).collect(),
            statics: Kind::ALL
                .iter()
                .map(|&kind| self.statics_of(way, made, basis.as_ref(), kind, checks))
                .collect::<Result<_, _>>()?,
        };
        Ok(quality)
    }

    fn statics_of(
        &self,
        way: Way,
        made: &Artifacts,
        basis: MatRef<'_, f64>,
        kind: Kind,
        checks: &mut Vec<Check>,
    ) -> Result<Statics, Failure> {
        let mut exact = Vec::new();
        let mut cubature = (way != Way::Original).then(Vec::new);
        for case in self.cases.iter().filter(|case| case.summary.kind == kind) {
            let u = &case.displacement;
            let (error, found) = self.statics.error_in(basis, &case.load, u)?;
            exact.push(error);
            // No state of the subspace has less potential energy than the equilibrium next to it.
            checks.push(Check::at_most(
                "potential energy in a subspace below the true one",
                (case.potential_j - found.potential_j) / case.potential_j.abs(),
                1e-6,
            ));
            if let Some(errors) = &mut cubature {
                let load = linalg::gram(basis, column(&case.load));
                // A rule of a basis that is far off may have no equilibrium.
                errors.push(match made.model().solve_static(load.col_as_slice(0), &found.x) {
                    Ok(q) => self.statics.distance(basis, &q, u),
                    Err(_) => 1.0,
                });
            }
        }
        Ok(Statics { kind, exact, cubature })
    }
}

/// Elastic modes over the free degrees of freedom.
fn modes_of(body: &Artifacts) -> Mat<f64> {
    let model = body.full_model();
    let mut modes = Mat::zeros(model.n(), body.n_modes());
    for j in 0..body.n_modes() {
        modes.col_as_slice_mut(j).copy_from_slice(&model.restrict(&body.mode(j)));
    }
    modes
}

/// Largest angle, in radians, of a vector in the span of `x` to the span of `y`, both M-orthonormal.
/// By the sine, which keeps its digits where the angle is small (Björck and Golub, Math. Comp. 27, 1973).
fn angle(mass: &Mass, x: MatRef<'_, f64>, y: MatRef<'_, f64>) -> Result<f64, Failure> {
    let inside = mass.inner(y, x);
    let mut outside = x.to_owned();
    linalg::add_product(outside.as_mut(), -1.0, y, inside.as_ref());
    let gram = mass.inner(outside.as_ref(), outside.as_ref());
    let (squares, _) = linalg::symmetric_eigen(gram.as_ref())?;
    Ok(squares.last().copied().unwrap_or(0.0).clamp(0.0, 1.0).sqrt().asin())
}

fn column(x: &[f64]) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(x, x.len(), 1)
}

impl Quality {
    /// Largest relative eigenvalue error of the lower half of the modes, and of all.
    pub(crate) fn worst_eigenvalue_errors(&self) -> [f64; 2] {
        let worst = |errors: &[f64]| errors.iter().copied().fold(0.0, f64::max);
        let errors = &self.eigenvalue_errors;
        [worst(&errors[..errors.len().div_ceil(2)]), worst(errors)]
    }

    /// Median error under the loads of `kind`.
    pub(crate) fn static_error(&self, kind: Kind) -> f64 {
        let of_kind = self.statics.iter().filter(|statics| statics.kind == kind);
        median(&of_kind.flat_map(|statics| statics.exact.iter().copied()).collect::<Vec<_>>())
    }

    /// The same by the generation's cubature.
    pub(crate) fn cubature_error(&self, kind: Kind) -> Option<f64> {
        let statics = self.statics.iter().find(|statics| statics.kind == kind)?;
        statics.cubature.as_ref().map(|errors| median(errors))
    }
}

impl Accuracy {
    /// What the issue asks of a rebuilt basis.
    fn targets(&self) -> Vec<Ratio> {
        let mut targets = Vec::new();
        let mut add = |work: String, [ours, theirs]: [String; 2], value: f64, limit: f64| {
            targets.push(Ratio {
                work,
                against: "from scratch".into(),
                body: self.name.clone(),
                ours,
                theirs,
                value,
                target: Target::AtMost(limit),
            });
        };
        let (lower, all, statics) = TARGETS;
        let exact = &self.qualities[0];
        for quality in &self.qualities[1..] {
            if !quality.way.is_by_flexibility() {
                continue;
            }
            let name = quality.way.name();
            let [lower_error, all_error] = quality.worst_eigenvalue_errors();
            for (which, value, limit) in
                [("lower half", lower_error, lower), ("all modes", all_error, all)]
            {
                let work = format!("{name}: relative eigenvalue error, {which}");
                add(work, [format!("{value:.1e}"), String::new()], value, limit);
            }
            for kind in Kind::ALL {
                let [ours, theirs] = [quality, exact].map(|q| q.static_error(kind));
                let work = format!("{name}: static error, {} loads", kind.name());
                let cells = [ours, theirs].map(|error| format!("{:.3} %", 100.0 * error));
                add(work, cells, ours / theirs, statics);
            }
        }
        targets
    }
}

impl Accuracies {
    pub(crate) fn of(bodies: Vec<Accuracy>) -> Accuracies {
        let own = |body: &Accuracy| -> Vec<(String, Check)> {
            body.checks.iter().map(|check| (body.name.clone(), check.clone())).collect()
        };
        Accuracies {
            machine: Machine::here(),
            targets: bodies.iter().flat_map(Accuracy::targets).collect(),
            checks: bodies.iter().flat_map(own).collect(),
            bodies,
        }
    }

    /// The checks that do not hold.
    pub(crate) fn wrong(&self) -> Vec<&(String, Check)> {
        self.checks.iter().filter(|(_, check)| !check.holds()).collect()
    }
}
