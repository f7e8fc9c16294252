//! The peers' figures (`peers/peers.py` writes them) and the ratios to them.

use crate::bodies::Failure;
use crate::edits::Rebuilds;
use crate::measure::{Check, median};
use crate::paper::vega;
use crate::results::{BodyResults, Plan, Results};
use crate::{references, scaling};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// What `peers.py` found.
#[derive(Serialize, Deserialize)]
pub(crate) struct Peers {
    /// Versions and settings, as shown.
    pub(crate) description: String,
    pub(crate) bodies: BTreeMap<String, PeerBody>,
}

/// One body.
#[derive(Serialize, Deserialize)]
pub(crate) struct PeerBody {
    pub(crate) n_free_dofs: usize,
    /// Assembly of K and M with NumPy and SciPy.
    pub(crate) assembly_s: Vec<f64>,
    pub(crate) pardiso: Solver,
    /// Absent where it is not installed.
    pub(crate) cholmod: Option<Solver>,
    /// `eigsh` in shift-invert mode with Pardiso, factorization apart.
    pub(crate) eigsh: Eigsh,
    pub(crate) session: Option<PeerSession>,
}

/// A sparse direct solver on K + σM.
#[derive(Serialize, Deserialize)]
pub(crate) struct Solver {
    pub(crate) settings: String,
    pub(crate) analysis_s: Vec<f64>,
    pub(crate) numeric_s: Vec<f64>,
    pub(crate) solve_1_s: Vec<f64>,
    pub(crate) solve_32_s: Vec<f64>,
    pub(crate) factor_nonzeros: f64,
    pub(crate) backward_error: f64,
}

/// The lowest elastic modes.
#[derive(Serialize, Deserialize)]
pub(crate) struct Eigsh {
    pub(crate) n_modes: usize,
    pub(crate) seconds: Vec<f64>,
    pub(crate) frequencies_hz: Vec<f64>,
    /// ‖K_σ⁻¹Mφ − θφ‖_M / θ.
    pub(crate) inverse_residual: f64,
    /// ‖Kφ − λMφ‖ / ‖λMφ‖.
    pub(crate) residual: f64,
}

/// The whole session build.
#[derive(Serialize, Deserialize)]
pub(crate) struct PeerSession {
    pub(crate) seconds: Vec<f64>,
    /// Medians.
    pub(crate) stages_s: BTreeMap<String, f64>,
    /// Relative force error on held-out poses.
    pub(crate) cubature_error: f64,
    pub(crate) n_cubature_points: usize,
}

impl Peers {
    /// Reads the file.
    pub(crate) fn load(path: &Path) -> Result<Peers, Failure> {
        let text = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(serde_json::from_slice(&text)?)
    }

    /// Runs `peers.py` for one body with the interpreter `python`; what it writes goes to `folder`.
    pub(crate) fn measure(
        python: &Path,
        plan: &Plan,
        name: &str,
        folder: &Path,
    ) -> Result<Peers, Failure> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/peers.py");
        let found = folder.join(format!("peers_{name}.json"));
        let status = Command::new(python)
            .arg(script)
            .args(["--bodies", name, "--repeat", &plan.repeat.to_string()])
            .arg("--meshes")
            .arg(&plan.meshes)
            .arg("--out")
            .arg(&found)
            .status()?;
        if !status.success() {
            return Err(format!("{name}: the peers failed ({status})").into());
        }
        Peers::load(&found)
    }

    /// These and `others`, of other bodies.
    pub(crate) fn with(mut self, others: Peers) -> Peers {
        for part in others.description.split("; ") {
            if !self.description.contains(part) {
                self.description += &format!("; {part}");
            }
        }
        self.bodies.extend(others.bodies);
        self
    }
}

impl PeerBody {
    /// Of Pardiso and CHOLMOD the smaller of what `cost` says.
    fn best(&self, cost: impl Fn(&Solver) -> f64) -> f64 {
        std::iter::once(&self.pardiso).chain(&self.cholmod).map(cost).fold(f64::INFINITY, f64::min)
    }
}

impl Solver {
    fn factorization_s(&self) -> f64 {
        median(&self.analysis_s) + median(&self.numeric_s)
    }
}

/// One line of the comparison.
#[derive(Serialize)]
pub(crate) struct Ratio {
    pub(crate) work: String,
    pub(crate) against: String,
    pub(crate) body: String,
    pub(crate) ours: String,
    pub(crate) theirs: String,
    pub(crate) value: f64,
    pub(crate) target: Target,
}

/// What a ratio should reach.
#[derive(Clone, Copy, Serialize)]
pub(crate) enum Target {
    AtMost(f64),
    AtLeast(f64),
    /// From zero, either way.
    Within(f64),
    /// Shown only.
    None,
}

impl Ratio {
    /// Whether the target is met, if there is one.
    pub(crate) fn is_met(&self) -> Option<bool> {
        match self.target {
            Target::AtMost(limit) => Some(self.value <= limit),
            Target::AtLeast(limit) => Some(self.value >= limit),
            Target::Within(limit) => Some(self.value.abs() <= limit),
            Target::None => None,
        }
    }
}

/// Ours and theirs of the same problem.
pub(crate) fn checks(results: &Results, peers: &Peers) -> Vec<(String, Check)> {
    let mut checks = Vec::new();
    for body in &results.bodies {
        let Some(peer) = peers.bodies.get(&body.name) else { continue };
        let mut add = |check: Check| checks.push((body.name.clone(), check));
        let difference = body.kernels.n_free_dofs.abs_diff(peer.n_free_dofs);
        add(Check::at_most("degrees of freedom against the peers'", difference as f64, 0.0));
        add(references::check(
            "frequencies against eigsh",
            &peer.eigsh.frequencies_hz,
            &body.kernels.frequencies_hz,
            1e-6,
        ));
    }
    checks
}

/// Every comparison that these results allow.
pub(crate) fn ratios(results: &Results, peers: Option<&Peers>) -> Vec<Ratio> {
    let mut ratios = Vec::new();
    let largest = results.bodies.iter().max_by_key(|body| body.kernels.n_free_dofs);
    for body in &results.bodies {
        let is_largest = largest.is_some_and(|largest| largest.name == body.name);
        if let Some(peer) = peers.and_then(|peers| peers.bodies.get(&body.name)) {
            ratios.extend(kernel_ratios(body, peer, is_largest));
        }
    }
    // The machine of VegaFEM's figures against this one, by the factorization of the stomach.
    let rescaled = peers
        .and_then(|peers| peers.bodies.get("stomach"))
        .map(|peer| peer.pardiso.factorization_s() / vega::FACTORIZATION_S);
    if let Some(rescaled) = rescaled {
        ratios.extend(vega_ratios(results, rescaled));
    }
    for body in &results.bodies {
        let Some(peak) = body.sessions.peak_memory_bytes else { continue };
        let factor = body.sessions.last.factor_bytes as f64;
        ratios.push(Ratio {
            work: "peak memory of a session build".into(),
            against: "the factor".into(),
            body: body.name.clone(),
            ours: format!("{:.0} MB", peak / 1e6),
            theirs: format!("{:.0} MB", factor / 1e6),
            value: peak / factor,
            target: if body.name == "stomach" { Target::AtMost(3.0) } else { Target::None },
        });
    }
    ratios.extend(results.scaling.iter().flat_map(scaling_ratios));
    ratios.extend(results.bodies.iter().flat_map(edit_ratios));
    ratios
}

/// Edits by the body's own stitches, against building from scratch.
fn edit_ratios(body: &BodyResults) -> Vec<Ratio> {
    let own = body.edits.table.comparison.n_stitches;
    let Some(c) = body.edits.speedup.iter().find(|c| c.n_stitches == own) else {
        return Vec::new();
    };
    let modes = |r: &Rebuilds| r.modes.median_s;
    let total = |r: &Rebuilds| r.total.median_s;
    let rows = [
        ("linear modes", [modes(&c.from_scratch), modes(&c.unprepared)], 15.0),
        ("linear modes, prepared", [modes(&c.from_scratch), modes(&c.prepared)], 100.0),
        ("whole edit", [total(&c.from_scratch), total(&c.unprepared)], 10.0),
        ("whole edit, cubature reused", [total(&c.from_scratch), total(&c.reusing)], 10.0),
        ("whole edit, prepared", [total(&c.from_scratch), total(&c.prepared)], 20.0),
        (
            "whole edit, prepared, cubature reused",
            [total(&c.from_scratch), total(&c.first_answer)],
            20.0,
        ),
    ];
    rows.map(|(work, [theirs, ours], at_least)| {
        let target = match body.name.as_str() {
            "stomach" => Target::AtLeast(at_least),
            "oball" => Target::AtLeast(4.0),
            _ => Target::None,
        };
        let work = format!("{own} stitches, {work}");
        ratio(&body.name, &work, "from scratch", [ours, theirs], theirs / ours, target)
    })
    .into()
}

fn kernel_ratios(body: &BodyResults, peer: &PeerBody, is_largest: bool) -> Vec<Ratio> {
    let kernels = &body.kernels;
    let judged = |target: Target| if is_largest { target } else { Target::None };
    let solver = "the better of Pardiso and CHOLMOD";
    let slower = |work: &str, ours: f64, theirs: f64, target| {
        ratio(&body.name, work, solver, [ours, theirs], ours / theirs, target)
    };
    let faster = |work: &str, against: &str, ours: f64, theirs: f64, target| {
        ratio(&body.name, work, against, [ours, theirs], theirs / ours, target)
    };
    let factorization_s = kernels.factorization.median_s;
    let mut ratios = vec![slower(
        "factorization, analysis included",
        factorization_s,
        peer.best(Solver::factorization_s),
        judged(Target::AtMost(1.3)),
    )];
    ratios.push(slower(
        "factorization, numbers alone",
        kernels.numeric.median_s,
        peer.best(|s| median(&s.numeric_s)),
        judged(Target::AtMost(1.3)),
    ));
    for solve in &kernels.solves {
        let (theirs, target) = match solve.columns {
            1 => (peer.best(|s| median(&s.solve_1_s)), Target::None),
            32 => (peer.best(|s| median(&s.solve_32_s)), judged(Target::AtMost(1.2))),
            _ => continue,
        };
        let work = format!("solve, columns: {}", solve.columns);
        ratios.push(slower(&work, solve.times.median_s, theirs, target));
    }
    ratios.push(faster(
        &format!("{} modes, factorization included", kernels.n_modes),
        "eigsh with Pardiso",
        factorization_s + kernels.modes.median_s,
        peer.pardiso.factorization_s() + median(&peer.eigsh.seconds),
        Target::AtLeast(3.0),
    ));
    ratios.push(Ratio {
        work: "residual ‖Kφ − λMφ‖ / ‖λMφ‖ of these modes, worst".into(),
        against: "eigsh with Pardiso".into(),
        body: body.name.clone(),
        ours: format!("{:.1e}", kernels.residual),
        theirs: format!("{:.1e}", peer.eigsh.residual),
        value: kernels.residual,
        target: Target::AtMost(1e-8),
    });
    if let Some(session) = &peer.session {
        let target = if body.name == "stomach" { Target::AtLeast(4.0) } else { Target::None };
        for (work, ours, target) in [
            ("session build, tets as points", &body.sessions_of_tets, target),
            ("session build, smoothed points", &body.sessions, Target::None),
        ] {
            let seconds = [ours.total.median_s, median(&session.seconds)];
            ratios.push(faster(work, "SciPy, Pardiso and NumPy", seconds[0], seconds[1], target));
        }
    }
    ratios
}

fn vega_ratios(results: &Results, rescaled: f64) -> Vec<Ratio> {
    let against = format!("VegaFEM, its seconds times {rescaled:.2}");
    let mut ratios = Vec::new();
    for body in results.bodies.iter().filter(|body| body.name == "stomach") {
        for loads in &body.kernels.loads {
            let work = format!("{} derivative right-hand sides, per tet and pair", loads.n_pairs);
            let elements = (loads.n_pairs * body.kernels.n_tets) as f64;
            let (ours, theirs) = (loads.times.median_s / elements, vega::LOAD_S * rescaled);
            let target = Target::AtLeast(25.0);
            ratios.push(ratio(&body.name, &work, &against, [ours, theirs], theirs / ours, target));
        }
    }
    if let Some(vega) = results.vega.as_ref().filter(|_| results.vega_body == "stomach") {
        let (ours, theirs) = (vega.build_s(), vega::BUILD_S * rescaled);
        let work = "build of 20 modes and all 210 derivatives";
        let target = Target::AtLeast(12.0);
        ratios.push(ratio("stomach", work, &against, [ours, theirs], theirs / ours, target));
    }
    ratios
}

fn scaling_ratios(scaling: &scaling::Scaling) -> Vec<Ratio> {
    let distance = |exponent: &scaling::Exponent| Ratio {
        work: format!("exponent of {}", exponent.what),
        against: "nested dissection of a cube".into(),
        body: "cubes".into(),
        ours: format!("{:.2}", exponent.fitted),
        theirs: format!("{:.2}", exponent.theory),
        value: exponent.fitted - exponent.theory,
        target: Target::Within(0.15),
    };
    scaling.exponents.iter().map(distance).collect()
}

fn ratio(
    body: &str,
    work: &str,
    against: &str,
    [ours, theirs]: [f64; 2],
    value: f64,
    target: Target,
) -> Ratio {
    let [ours, theirs] = [ours, theirs].map(crate::report::seconds);
    Ratio {
        work: work.into(),
        against: against.into(),
        body: body.into(),
        ours,
        theirs,
        value,
        target,
    }
}
