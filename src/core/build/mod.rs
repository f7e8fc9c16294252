//! The only orchestrator: [`build`] prepares a body, [`rebuild`] applies edits to it.

mod artifacts;
mod finish;
mod params;
mod spectrum;

pub use crate::assembly::mass::MassKind;
pub use crate::basis::PcaMethod;
pub use crate::cubature::Selection;
pub use crate::reduced::RayleighDamping;
pub use artifacts::{Artifacts, BasisDelta, CubatureReport, CubatureSource};
pub use params::{BuildError, BuildParams, CubatureParams, Method, RebuildParams};

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::assembly::sparse::Pattern;
use crate::control::{self, Cancelled, Control, Stage};
use crate::cubature::Rule;
use crate::derivatives::{self, NEW_DERIVATIVE_MODES, REUSED_SHARE};
use crate::edit::{Edit, EditState, StitchId};
use crate::factorization::SymbolicCholesky;
use crate::linalg::{self, DenseError};
use crate::mesh::TetMesh;
use crate::modes::low_rank::{self, MassInverse};
use crate::modes::stitched::{
    FlexibilityColumns, StitchMatrix, StitchedStiffness, flexibility_columns,
};
use crate::modes::{self, LinearModes, flexibility, rigid};
use artifacts::Prepared;
use faer::{Mat, MatRef};
use finish::{DerivativeSet, Draft, finish};
use spectrum::{Spectrum, lowest_spectrum};
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// Measures stages with the caller's clock.
struct StageClock<'a> {
    control: &'a dyn Control,
    last: Duration,
    timings: Vec<(Stage, Duration)>,
}

impl<'a> StageClock<'a> {
    fn start(control: &'a dyn Control) -> StageClock<'a> {
        StageClock { control, last: control.now(), timings: Vec::new() }
    }

    /// The time since the last call belongs to `stage`.
    fn finish(&mut self, stage: Stage) -> Result<(), Cancelled> {
        let now = self.control.now();
        self.timings.push((stage, now.saturating_sub(self.last)));
        self.last = now;
        self.control.progress(stage, 1.0);
        control::check(self.control)
    }
}

/// Prepares `mesh`: matrices, factorization, modes, derivatives, basis, cubature, reduced model.
pub fn build(
    mesh: Arc<TetMesh>,
    params: &BuildParams,
    control: &dyn Control,
) -> Result<Artifacts, BuildError> {
    params::check(&mesh, params)?;
    let mut clock = StageClock::start(control);
    let mut warnings = Vec::new();
    if let Some(first) = mesh.unused_vertices().first() {
        let count = mesh.unused_vertices().len();
        warnings.push(format!(
            "{count} vertices belong to no tet and never move (the first is {first})"
        ));
    }
    let (base, residuals, derivatives) = prepare(mesh, params, &BTreeMap::new(), &mut clock)?;
    let Base { prepared, columns } = base;
    if prepared.modes.eigenvalues.len() < params.n_modes {
        warnings.push(format!(
            "{} modes were asked for, but the body has only {}",
            params.n_modes,
            prepared.modes.eigenvalues.len()
        ));
    }
    let kept = prepared.modes.lowest(params.n_modes);
    let draft = Draft {
        columns,
        state: EditState::default(),
        n_rigid_modes: prepared.rigid.ncols(),
        weighing: kept.eigenvalues.clone(),
        modes: kept,
        residuals,
        derivatives: vec![derivatives],
        reuse: None,
        warnings,
        prepared,
    };
    finish(draft, clock)
}

/// What an edit starts from.
struct Base {
    prepared: Arc<Prepared>,
    /// Of seams and of stitches made so far.
    columns: FlexibilityColumns,
}

/// The base body with domains `stiffness_factors` times as stiff as `params` has them, its residuals
/// (of the modes kept) and its derivatives.
fn prepare(
    mesh: Arc<TetMesh>,
    params: &BuildParams,
    stiffness_factors: &BTreeMap<i64, f64>,
    clock: &mut StageClock<'_>,
) -> Result<(Base, Vec<f64>, DerivativeSet), BuildError> {
    let materials = params::scaled_materials(&mesh, params, stiffness_factors)?;
    let model = FullModel::new(mesh, &materials, &params.fixed_vertices);
    if model.n() == 0 {
        return Err(BuildError::NothingFree);
    }
    params::check_seams(&model, params)?;
    let pattern = Arc::new(model.pattern(&[]));
    let (symbolic, (mass, stiffness, rigid)) = rayon::join(
        || analyse(&pattern, &model),
        || {
            let mass = model.mass(params.mass, &pattern);
            let stiffness = model.rest_stiffness(&pattern);
            let rigid = rigid::rigid_modes(&model, &mass);
            (mass, stiffness, rigid)
        },
    );
    let (symbolic, rigid) = (symbolic?, rigid?);
    clock.finish(Stage::Assembly)?;

    let Spectrum { factor, sigma, modes, mut residuals } = lowest_spectrum(
        &model,
        &mass,
        &stiffness,
        rigid.as_ref(),
        symbolic,
        params.n_modes,
        clock,
    )?;
    let none = FlexibilityColumns::new();
    let columns = flexibility_columns(&model, &factor, &none, params.seams.iter().copied());
    if !params.seams.is_empty() {
        clock.finish(Stage::Seams)?;
    }

    let kept = modes.lowest(params.n_modes);
    residuals.truncate(params.n_modes);
    let stitched = StitchedStiffness::new(&model, &stiffness, &factor, &[], &none)?;
    let body =
        Body { model: &model, mass: &mass, stitched: &stitched, sigma, rigid: rigid.as_ref() };
    let New { set, loads, flexibility } = new_derivatives(
        &body,
        &kept,
        Some(&modes),
        params.n_derivative_modes,
        REUSED_SHARE,
        clock.control,
    )?;
    clock.finish(Stage::Derivatives)?;
    drop(stitched);

    let prepared = Arc::new(Prepared {
        params: params.clone(),
        stiffness_factors: stiffness_factors.clone(),
        model,
        mass,
        mass_inverse: OnceLock::new(),
        stiffness,
        factor,
        sigma,
        rigid,
        modes,
        derivative_loads: loads,
        derivative_flexibility: flexibility,
    });
    Ok((Base { prepared, columns }, residuals, set))
}

/// Orders and analyses the stiffness's pattern: work for one thread, beside the assembly.
fn analyse(pattern: &Arc<Pattern>, model: &FullModel) -> Result<Arc<SymbolicCholesky>, BuildError> {
    match SymbolicCholesky::new(pattern.clone(), 3) {
        Ok(symbolic) => Ok(Arc::new(symbolic)),
        Err(error) => Err(BuildError::of_factorization(error, model)),
    }
}

/// Applies `edits` to `previous` and returns the next generation with the names of the stitches
/// made. `previous` is untouched.
///
/// Modes are updated from the *base* body whatever the generation, so rounds of edits accumulate no
/// error (the limit that \[M16\] §6.1 names).
pub fn rebuild(
    previous: &Artifacts,
    edits: &[Edit],
    params: &RebuildParams,
    control: &dyn Control,
) -> Result<(Artifacts, Vec<StitchId>), BuildError> {
    params::check_fraction("tolerance", params.tolerance)?;
    let model = &previous.prepared.model;
    let (state, ids) =
        previous.state.apply(edits, model.mesh(), |v| model.free_index(v).is_none())?;
    let mut clock = StageClock::start(control);
    let base = base_for(previous, &state, &mut clock)?;
    let reuse = previous.cubature.map(|_| (previous.rule.clone(), previous.trained_error));
    let draft = match params.method {
        Method::FromScratch => from_scratch(base, state, &mut clock)?,
        Method::Flexibility => update(base, state, reuse, Some(params.tolerance), &mut clock)?,
        Method::LowRank => update(base, state, reuse, None, &mut clock)?,
    };
    Ok((finish(draft, clock)?, ids))
}

/// The base body that `state` is an update of: the previous one, or, where a domain's stiffness has
/// changed (a change of full rank, for which nothing prepared is left), a new one.
fn base_for(
    previous: &Artifacts,
    state: &EditState,
    clock: &mut StageClock<'_>,
) -> Result<Base, BuildError> {
    let prepared = &previous.prepared;
    if prepared.stiffness_factors == *state.stiffness_factors() {
        return Ok(Base { prepared: prepared.clone(), columns: previous.columns.clone() });
    }
    let mesh = prepared.model.mesh().clone();
    Ok(prepare(mesh, &prepared.params, state.stiffness_factors(), clock)?.0)
}

/// Everything up to the derivatives, from a factorization of the stitched stiffness itself.
fn from_scratch(
    base: Base,
    state: EditState,
    clock: &mut StageClock<'_>,
) -> Result<Draft, BuildError> {
    let prepared = &base.prepared;
    let Prepared { params, model, mass, .. } = &**prepared;
    let a = StitchMatrix::new(model, state.stitches());
    let pairs: Vec<[u32; 2]> = state.stitches().iter().map(|s| s.pair).collect();
    let pattern = Arc::new(model.pattern(&pairs));
    let (symbolic, stiffness) = rayon::join(
        || analyse(&pattern, model),
        || {
            let mut stiffness = model.rest_stiffness(&pattern);
            a.add_to(&mut stiffness);
            stiffness
        },
    );
    let symbolic = symbolic?;
    let rigid = rigid_left(&a, prepared.rigid.as_ref())?;
    clock.finish(Stage::Assembly)?;

    let Spectrum { factor, sigma, modes, mut residuals } =
        lowest_spectrum(model, mass, &stiffness, rigid.as_ref(), symbolic, params.n_modes, clock)?;
    let kept = modes.lowest(params.n_modes);
    residuals.truncate(params.n_modes);
    let none = FlexibilityColumns::new();
    let stitched = StitchedStiffness::new(model, &stiffness, &factor, &[], &none)?;
    let body = Body { model, mass, stitched: &stitched, sigma, rigid: rigid.as_ref() };
    let New { set, .. } =
        new_derivatives(&body, &kept, Some(&modes), params.n_derivative_modes, 0.0, clock.control)?;
    clock.finish(Stage::Derivatives)?;
    Ok(Draft {
        prepared: prepared.clone(),
        columns: base.columns,
        state,
        n_rigid_modes: rigid.ncols(),
        weighing: kept.eigenvalues.clone(),
        modes: kept,
        residuals,
        derivatives: vec![set],
        reuse: None,
        warnings: Vec::new(),
    })
}

/// Everything up to the derivatives, from the base body's factorization: by flexibility to
/// `tolerance`, or by the low-rank update if there is none. `reuse` is the cubature rule in use.
fn update(
    base: Base,
    state: EditState,
    reuse: Option<(Rule, f64)>,
    tolerance: Option<f64>,
    clock: &mut StageClock<'_>,
) -> Result<Draft, BuildError> {
    let prepared = &base.prepared;
    let Prepared { model, mass, factor, sigma, rigid, modes, .. } = &**prepared;
    let control = clock.control;
    let mut warnings = Vec::new();
    let pairs = state.stitches().iter().map(|s| s.pair);
    let columns = flexibility_columns(model, factor, &base.columns, pairs);
    let stitched =
        StitchedStiffness::new(model, &prepared.stiffness, factor, state.stitches(), &columns)?;
    control::check(control)?;
    let left = rigid_left(stitched.stitch_matrix(), rigid.as_ref())?;
    let n_modes = prepared.params.n_modes;

    let (kept, residuals, weighing) = match tolerance {
        None => {
            warnings.push(
                "low_rank treats all higher modes as having no stiffness: its frequencies are \
                 those of that approximation, not of the stitched body (see the residuals)"
                    .into(),
            );
            let modes = low_rank_modes(prepared, &stitched, left.ncols(), n_modes)?;
            // Its eigenvalues can vanish; the true Rayleigh quotients take their place as weights.
            let weighing = rayleigh_quotients(&stitched, &modes);
            let residuals = audit(&stitched, mass, &modes, *sigma);
            (modes, residuals, weighing)
        }
        Some(tolerance) => {
            let problem = flexibility::Update {
                stitched: &stitched,
                mass,
                sigma: *sigma,
                rigid: rigid.as_ref(),
                n_rigid_left: left.ncols(),
                base: modes,
                n_modes,
                tolerance,
            };
            let updated = flexibility::update(&problem, control)?;
            let half = updated.error_estimates.len().div_ceil(2);
            let worst = updated.error_estimates[..half].iter().copied().fold(0.0, f64::max);
            if worst > tolerance {
                warnings.push(format!(
                    "the lower half of the modes reached a relative eigenvalue error of \
                     {worst:.1e}, not {tolerance:.1e}"
                ));
            }
            let weighing = updated.modes.eigenvalues.clone();
            (updated.modes, updated.residuals, weighing)
        }
    };
    clock.finish(Stage::Modes)?;

    let body = Body { model, mass, stitched: &stitched, sigma: *sigma, rigid: left.as_ref() };
    let weighed = LinearModes { shapes: kept.shapes.clone(), eigenvalues: weighing.clone() };
    let accurate = tolerance.map(|_| &kept);
    let count = NEW_DERIVATIVE_MODES.min(prepared.params.n_derivative_modes);
    // Side by side: each has passages that only one thread can do.
    let (new, reused) = rayon::join(
        || new_derivatives(&body, &weighed, accurate, count, 0.0, control),
        || reused_derivatives(prepared, &body, accurate, control),
    );
    let (New { set: new, .. }, reused) = (new?, reused?);
    clock.finish(Stage::Derivatives)?;
    let n_rigid_modes = left.ncols();
    drop(stitched);
    Ok(Draft {
        prepared: prepared.clone(),
        columns,
        state,
        n_rigid_modes,
        modes: kept,
        weighing,
        residuals,
        derivatives: vec![new, reused],
        reuse,
        warnings,
    })
}

/// What the derivative stage needs of a (stitched) body.
struct Body<'a> {
    model: &'a FullModel,
    mass: &'a Mass,
    stitched: &'a StitchedStiffness<'a>,
    sigma: f64,
    /// Motions that remain rigid.
    rigid: MatRef<'a, f64>,
}

impl<'a> Body<'a> {
    fn solver(&self, accurate: Option<&'a LinearModes>) -> derivatives::Solver<'a> {
        derivatives::Solver {
            stitched: self.stitched,
            mass: self.mass,
            sigma: self.sigma,
            rigid: self.rigid,
            modes: accurate,
        }
    }
}

/// Relative residuals of modes that come without an audit of their own.
fn audit(
    stitched: &StitchedStiffness<'_>,
    mass: &Mass,
    modes: &LinearModes,
    sigma: f64,
) -> Vec<f64> {
    let shapes = modes.shapes.as_ref();
    let product = stitched.multiply(shapes);
    let residual = modes::residual_vectors(product, mass, shapes, &modes.eigenvalues);
    let solved = stitched.solve(residual.as_ref());
    modes::relative_residuals(residual.as_ref(), solved.as_ref(), &modes.eigenvalues, sigma)
}

/// Right-hand sides solved for at a time: the solve gains nothing from more, and what surrounds it holds
/// several blocks of this width.
const DERIVATIVES_PER_SOLVE: usize = 32;

/// New modal derivatives, with the right-hand sides that later updates reuse and K̂_σ⁻¹ of those.
struct New {
    set: DerivativeSet,
    loads: Mat<f64>,
    flexibility: Mat<f64>,
}

/// Derivatives of every pair of the lowest `count` modes. Right-hand sides are kept for the first
/// `kept_share` of them.
fn new_derivatives<'a>(
    body: &Body<'a>,
    modes: &LinearModes,
    accurate: Option<&'a LinearModes>,
    count: usize,
    kept_share: f64,
    control: &dyn Control,
) -> Result<New, BuildError> {
    let lowest = modes.lowest(count);
    let loads = derivatives::right_hand_sides(body.model, lowest.shapes.as_ref(), control)?;
    let (n, p) = (loads.nrows(), loads.ncols());
    let n_kept = (kept_share * p as f64).ceil() as usize;
    let mut flexibility = Mat::zeros(n, n_kept);
    let mut shapes = Mat::zeros(n, p);
    let mut residual = 0.0f64;
    for first in (0..p).step_by(DERIVATIVES_PER_SOLVE) {
        control::check(control)?;
        let block = loads.subcols(first, DERIVATIVES_PER_SOLVE.min(p - first));
        let y = body.stitched.solve(block);
        let keep = block.ncols().min(n_kept.saturating_sub(first));
        if keep > 0 {
            flexibility.as_mut().subcols_mut(first, keep).copy_from(y.subcols(0, keep));
        }
        let (x, worst) = body.solver(accurate).solve(block, y, control)?;
        shapes.as_mut().subcols_mut(first, block.ncols()).copy_from(&x);
        residual = residual.max(worst);
    }
    let loads = loads.subcols(0, n_kept).to_owned();
    let pairs = derivatives::pairs(lowest.eigenvalues.len());
    let eigenvalues = pairs.iter().map(|p| p.map(|i| lowest.eigenvalues[i])).collect();
    let set = DerivativeSet { shapes, pairs, eigenvalues, residual };
    Ok(New { set, loads, flexibility })
}

/// Derivatives of the base body's right-hand sides on the stitched body: K_σ⁻¹ of them is cached,
/// so K̂_σ⁻¹ costs no solve (\[M16\] §4.2.1 reuses 40 % of them).
fn reused_derivatives<'a>(
    prepared: &Prepared,
    body: &Body<'a>,
    accurate: Option<&'a LinearModes>,
    control: &dyn Control,
) -> Result<DerivativeSet, BuildError> {
    let loads = prepared.derivative_loads.as_ref();
    let start = prepared.derivative_flexibility.clone();
    let (shapes, residual) =
        body.solver(accurate).solve(loads, body.stitched.correct(start), control)?;
    let base = &prepared.modes.eigenvalues;
    let pairs: Vec<[usize; 2]> = derivatives::pairs(prepared.params.n_derivative_modes)
        .into_iter()
        .take(loads.ncols())
        .collect();
    let eigenvalues = pairs.iter().map(|p| p.map(|i| base[i])).collect();
    Ok(DerivativeSet { shapes, pairs, eigenvalues, residual })
}

/// The rigid motions that stretch no stitch (n×k, M-orthonormal).
fn rigid_left(a: &StitchMatrix, rigid: MatRef<'_, f64>) -> Result<Mat<f64>, DenseError> {
    let left = rigid::unstretched(a.gaps(rigid).as_ref())?;
    Ok(linalg::product(rigid, left.as_ref()))
}

/// The paper's update, guards included in what it starts from; the motions that remain rigid are
/// its lowest and are left out.
fn low_rank_modes(
    prepared: &Prepared,
    stitched: &StitchedStiffness<'_>,
    n_rigid_left: usize,
    n_modes: usize,
) -> Result<LinearModes, BuildError> {
    let inverse = match prepared.mass_inverse.get() {
        Some(inverse) => inverse,
        None => {
            let made = MassInverse::new(&prepared.mass)
                .map_err(|error| BuildError::of_factorization(error, &prepared.model))?;
            prepared.mass_inverse.get_or_init(|| made)
        }
    };
    let base = &prepared.modes;
    let u = linalg::concatenate(&[prepared.rigid.as_ref(), base.shapes.as_ref()]);
    let lambda: Vec<f64> = std::iter::repeat_n(0.0, prepared.rigid.ncols())
        .chain(base.eigenvalues.iter().copied())
        .collect();
    let a = stitched.stitch_matrix();
    let all = low_rank::update(u.as_ref(), &lambda, a, inverse, n_rigid_left + n_modes)?;
    let count = all.eigenvalues.len().saturating_sub(n_rigid_left);
    let shapes = all.shapes.subcols(n_rigid_left, count);
    // Through the inverse root of a Gram matrix they come orthonormal to 1e-7 only.
    let gram = linalg::SmallCholesky::new(prepared.mass.inner(shapes, shapes).as_ref())?;
    Ok(LinearModes {
        shapes: linalg::product(shapes, gram.whitening().as_ref()),
        eigenvalues: all.eigenvalues[n_rigid_left..].to_vec(),
    })
}

/// φᵀK̂φ of M-normalised shapes.
fn rayleigh_quotients(stitched: &StitchedStiffness<'_>, modes: &LinearModes) -> Vec<f64> {
    let product = stitched.multiply(modes.shapes.as_ref());
    (0..product.ncols()).map(|j| modes.shapes.col(j).transpose() * product.col(j)).collect()
}
