//! One whole session build in a process of its own, so that its peak memory is its own; and the
//! build at VegaFEM's settings.

use crate::bodies::{Body, Failure};
use crate::clock::Clock;
use crate::kernels;
use crate::measure::{Check, Times, median, peak_memory_bytes};
use crate::paper::vega;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;
use sutura_core::build::{self, Artifacts, BuildParams, CubatureParams, MassKind};
use sutura_core::control::Stage;
use sutura_core::mesh::TetMesh;

/// One build.
#[derive(Serialize, Deserialize)]
pub(crate) struct Session {
    pub(crate) total_s: f64,
    /// By the name of the stage.
    pub(crate) stages_s: BTreeMap<String, f64>,
    pub(crate) peak_memory_bytes: Option<u64>,
    pub(crate) factor_bytes: usize,
    /// What the finished body keeps.
    pub(crate) kept_bytes: usize,
    /// Relative force error of the cubature on held-out poses.
    pub(crate) cubature_error: Option<f64>,
    pub(crate) n_cubature_points: Option<usize>,
    pub(crate) warnings: Vec<String>,
}

/// Several builds of one body.
#[derive(Serialize, Deserialize)]
pub(crate) struct Sessions {
    pub(crate) total: Times,
    /// In the order of the data flow.
    pub(crate) stages: Vec<(String, Times)>,
    /// Median.
    pub(crate) peak_memory_bytes: Option<f64>,
    pub(crate) last: Session,
}

impl Sessions {
    /// Of builds that each had a process to itself.
    pub(crate) fn of(mut all: Vec<Session>) -> Option<Sessions> {
        let seconds = |of: &dyn Fn(&Session) -> f64| -> Vec<f64> { all.iter().map(of).collect() };
        let total = Times::of(&seconds(&|session| session.total_s));
        let stages = Stage::ALL
            .iter()
            .map(|stage| stage.name())
            .filter(|name| all.iter().any(|session| session.stages_s.contains_key(*name)))
            .map(|name| {
                let of = |session: &Session| session.stages_s.get(name).copied().unwrap_or(0.0);
                (name.to_owned(), Times::of(&seconds(&of)))
            })
            .collect();
        let peaks: Vec<f64> =
            all.iter().filter_map(|session| session.peak_memory_bytes).map(|b| b as f64).collect();
        let peak_memory_bytes = (!peaks.is_empty()).then(|| median(&peaks));
        Some(Sessions { total, stages, peak_memory_bytes, last: all.pop()? })
    }
}

/// Builds `body` once with `params`.
fn build(body: &Body, params: &BuildParams) -> Result<(Session, Artifacts), Failure> {
    let start = Instant::now();
    let artifacts = build::build(body.mesh.clone(), params, &Clock::start())?;
    let total_s = start.elapsed().as_secs_f64();
    let mut stages_s = BTreeMap::new();
    for (stage, time) in artifacts.timings() {
        *stages_s.entry(stage.name().to_owned()).or_insert(0.0) += time.as_secs_f64();
    }
    let session = Session {
        total_s,
        stages_s,
        peak_memory_bytes: peak_memory_bytes(),
        factor_bytes: artifacts.factor_bytes(),
        kept_bytes: artifacts.memory_bytes(),
        cubature_error: artifacts.cubature().map(|report| report.validation_error),
        n_cubature_points: artifacts.cubature().map(|report| report.n_points),
        warnings: artifacts.warnings().to_vec(),
    };
    Ok((session, artifacts))
}

/// Opens a session on `body` once, no seams prepared, its cubature points smoothed or left as tets.
pub(crate) fn measure(body: &Body, smoothing: bool) -> Result<Session, Failure> {
    let mut params = body.session(&[]);
    params.cubature = params.cubature.map(|cubature| CubatureParams { smoothing, ..cubature });
    Ok(build(body, &params)?.0)
}

/// The stomach at VegaFEM's own settings.
#[derive(Serialize, Deserialize)]
pub(crate) struct Vega {
    pub(crate) sessions: Sessions,
    pub(crate) checks: Vec<Check>,
}

impl Vega {
    /// Median seconds without the tables for evaluating every tet: they stand where VegaFEM has its
    /// polynomials, which its figure leaves out.
    pub(crate) fn build_s(&self) -> f64 {
        let reduction = self.sessions.stages.iter().filter(|(name, _)| name == "reduction");
        self.sessions.total.median_s - reduction.map(|(_, times)| times.median_s).sum::<f64>()
    }
}

/// Builds `body` with its pairs welded: 20 modes of the consistent mass, the derivatives of all 210
/// pairs, 30 columns from those 230, no cubature.
pub(crate) fn measure_vega(body: &Body, repeat: usize) -> Result<Vega, Failure> {
    let welded = Body {
        name: body.name.clone(),
        mesh: welded(body)?,
        materials: body.materials.clone(),
        fixed: Vec::new(),
        stitches: Vec::new(),
        all_pairs: Vec::new(),
        stiffness_n_m: body.stiffness_n_m,
    };
    let fixed = fixed_of_welded(body);
    let params = BuildParams {
        fixed_vertices: fixed,
        mass: MassKind::Consistent,
        n_modes: 20,
        n_derivative_modes: 20,
        basis_size: 30,
        cubature: None,
        ..welded.session(&[])
    };
    let mut all = Vec::new();
    loop {
        let (session, artifacts) = build(&welded, &params)?;
        all.push(session);
        if all.len() < repeat {
            continue;
        }
        let mut checks = vec![kernels::evaluator_check(&artifacts)];
        if body.name == "stomach" {
            let found = artifacts.eigenvalues_per_s2();
            let errors = found.iter().zip(vega::EIGENVALUES).map(|(f, v)| (f / v - 1.0).abs());
            let worst = errors.fold(0.0, f64::max);
            checks.push(Check::at_most("eigenvalues against VegaFEM's", worst, 1e-6));
        }
        let sessions = Sessions::of(all).ok_or("no repetition")?;
        return Ok(Vega { sessions, checks });
    }
}

/// The new index of every vertex once each pair is one vertex; kept ones stay in order.
fn welding(body: &Body) -> Vec<u32> {
    let n = body.mesh.vertices().len();
    let mut root: Vec<usize> = (0..n).collect();
    let find = |root: &[usize], mut v: usize| {
        while root[v] != v {
            v = root[v];
        }
        v
    };
    for [a, b] in &body.all_pairs {
        let [a, b] = [*a, *b].map(|v| find(&root, v as usize));
        root[a.max(b)] = a.min(b);
    }
    let mut next = 0;
    let mut index = vec![0; n];
    for v in 0..n {
        let kept = find(&root, v);
        index[v] = if kept == v {
            next += 1;
            next - 1
        } else {
            index[kept]
        };
    }
    index
}

fn welded(body: &Body) -> Result<Arc<TetMesh>, Failure> {
    let index = welding(body);
    let n = index.iter().max().map_or(0, |last| *last as usize + 1);
    let mut vertices = vec![[0.0; 3]; n];
    for (v, &new) in index.iter().enumerate() {
        vertices[new as usize] = body.mesh.vertices()[v];
    }
    let tets = body.mesh.tets().iter().map(|tet| tet.map(|v| index[v as usize])).collect();
    let labels = body
        .mesh
        .domain_of_tet()
        .iter()
        .map(|&domain| body.mesh.domains()[domain as usize])
        .collect();
    Ok(Arc::new(TetMesh::new(vertices, tets, labels)?))
}

fn fixed_of_welded(body: &Body) -> Vec<u32> {
    let index = welding(body);
    let mut fixed: Vec<u32> = body.fixed.iter().map(|&v| index[v as usize]).collect();
    fixed.sort_unstable();
    fixed.dedup();
    fixed
}
