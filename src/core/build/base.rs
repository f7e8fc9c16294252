//! Base bodies: how they are prepared, and of which one a generation is an update.

use super::StageClock;
use super::artifacts::{Artifacts, Prepared, SeamCache};
use super::params::{self, BuildError, BuildParams};
use super::seams::base_derivatives;
use super::span::DerivativeSet;
use super::spectrum::{Spectrum, lowest_spectrum};
use super::update;
use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::assembly::sparse::{BlockMatrix, Pattern};
use crate::control::Stage;
use crate::dictionary::Block;
use crate::edit::BaseState;
use crate::factorization::{SparseCholesky, SymbolicCholesky};
use crate::modes::stitched::StitchMatrix;
use crate::modes::{AuditedSpectrum, rigid};
use crate::pool::Tall;
use faer::Mat;
use std::sync::{Arc, OnceLock, Weak};
use std::time::Duration;

/// Base bodies that one line of generations remembers; remembering keeps none of them alive.
const MOST_REMEMBERED: usize = 16;

/// Peak memory of a build, in factors of the size of the Cholesky factor, rounded up: 2.9 to 3.0 and 2.8 on bodies
/// of 105 264 and 164 469 unknowns.
const PEAK_FACTORS: usize = 3;

/// A base body: what generations are updates of, and what makes up nearly all of their preparation.
#[derive(Clone)]
pub struct BaseBody(pub(super) Arc<Prepared>);

impl BaseBody {
    /// Whether it is the one of `state` and of a build with `params`. Equal meshes that are not the same one
    /// are compared number by number.
    pub fn serves(&self, params: &BuildParams, state: &BaseState) -> bool {
        self.0.params == *params && self.0.state == *state
    }
}

impl Artifacts {
    /// The base body that this generation is an update of.
    pub fn base_body(&self) -> BaseBody {
        BaseBody(self.prepared.clone())
    }
}

/// A body before it is factorized.
pub(super) struct Assembled {
    pub(super) model: FullModel,
    pub(super) mass: Mass,
    /// Of rest, with the stitches that the base body holds.
    pub(super) stiffness: BlockMatrix,
    /// M-orthonormal motions that cost no energy (n×k).
    pub(super) rigid: Mat<f64>,
    pub(super) symbolic: Arc<SymbolicCholesky>,
}

impl Assembled {
    /// The base body of `state`, for which all of this was assembled with `params`: with the factor of K + σM and σ,
    /// its elastic modes (n×m) and their audit. It has no seams yet, and what a derivative takes is not known.
    pub(super) fn prepared(
        self,
        params: &BuildParams,
        state: &BaseState,
        (factor, sigma): (SparseCholesky, f64),
        modes: Tall,
        spectrum: AuditedSpectrum,
    ) -> Prepared {
        Prepared {
            params: params.clone(),
            state: state.clone(),
            model: self.model,
            mass: self.mass,
            mass_inverse: OnceLock::new(),
            stiffness: self.stiffness,
            factor,
            single: OnceLock::new(),
            sigma,
            x: [Block::new(self.rigid), Block::new(modes)],
            spectrum,
            column_time: Duration::ZERO,
            seams: SeamCache::default(),
        }
    }
}

/// Matrices of `state`, and the analysis of their pattern.
pub(super) fn assemble(
    state: &BaseState,
    params: &BuildParams,
    clock: &mut StageClock<'_>,
) -> Result<Assembled, BuildError> {
    let materials = params::scaled_materials(state, params)?;
    let fixed: Vec<u32> = state.fixed_vertices().iter().copied().collect();
    let mesh = state.mesh().clone();
    let model = FullModel::heterogeneous(mesh, &materials, &params.tet_stiffness, &fixed);
    if model.n() == 0 {
        return Err(BuildError::NothingFree);
    }
    let pairs: Vec<[u32; 2]> = state.folded().keys().copied().collect();
    let folded = StitchMatrix::new(&model, &state.folded_stitches());
    let pattern = Arc::new(model.pattern(&pairs));
    let (symbolic, (mass, stiffness, rigid)) = rayon::join(
        || analyse(&pattern, &model),
        || {
            let mass = model.mass(params.mass, &pattern);
            let mut stiffness = model.rest_stiffness(&pattern);
            folded.add_to(&mut stiffness);
            let rigid = rigid::rigid_modes(&model, &mass);
            (mass, stiffness, rigid)
        },
    );
    let (symbolic, rigid) = (symbolic?, update::rigid_left(&folded, rigid?.as_ref())?);
    let n_bytes = PEAK_FACTORS * symbolic.n_values() * size_of::<f64>();
    if !clock.control.admits(n_bytes) {
        return Err(BuildError::OverBudget { n_bytes });
    }
    clock.finish(Stage::Assembly)?;
    Ok(Assembled { model, mass, stiffness, rigid, symbolic })
}

/// The base body of `state`, and its derivatives.
pub(super) fn prepare(
    state: &BaseState,
    params: &BuildParams,
    clock: &mut StageClock<'_>,
) -> Result<(Arc<Prepared>, DerivativeSet), BuildError> {
    let assembled = assemble(state, params, clock)?;
    let Assembled { model, mass, stiffness, rigid, symbolic } = &assembled;
    let Spectrum { factor, sigma, modes, residuals } = lowest_spectrum(
        model,
        mass,
        stiffness,
        rigid.as_ref(),
        symbolic.clone(),
        params.n_modes,
        clock,
    )?;
    let spectrum = AuditedSpectrum::converged(modes.eigenvalues, residuals);
    let mut prepared = assembled.prepared(params, state, (factor, sigma), modes.shapes, spectrum);
    let begin = clock.control.now();
    let set = base_derivatives(&prepared, clock.control)?;
    prepared.column_time =
        clock.control.now().saturating_sub(begin) / set.pairs.len().max(1) as u32;
    *prepared.derivatives() = Some(set.shapes.clone());
    clock.finish(Stage::Derivatives)?;
    Ok((Arc::new(prepared), set))
}

/// Orders and analyses the stiffness's pattern: work for one thread, beside the assembly.
pub(super) fn analyse(
    pattern: &Arc<Pattern>,
    model: &FullModel,
) -> Result<Arc<SymbolicCholesky>, BuildError> {
    match SymbolicCholesky::new(pattern.clone(), 3) {
        Ok(symbolic) => Ok(Arc::new(symbolic)),
        Err(error) => Err(BuildError::of_factorization(error, model)),
    }
}

/// The base body of `state`: the one of `previous` or of a generation before it that is still kept
/// (so that an edit taken back costs no factorization); or a new one, because nothing prepared serves a
/// change of full rank or of the free degrees of freedom.
pub(super) fn base_for(
    previous: &Artifacts,
    state: &BaseState,
    clock: &mut StageClock<'_>,
) -> Result<Arc<Prepared>, BuildError> {
    match known(previous).find(|base| base.state == *state) {
        Some(found) => Ok(found),
        None => Ok(prepare(state, &previous.prepared.params, clock)?.0),
    }
}

/// The base bodies of `previous` and of generations before it, without `base`, which follows them.
pub(super) fn bases_before(previous: &Artifacts, base: &Arc<Prepared>) -> Vec<Weak<Prepared>> {
    let others = known(previous).filter(|other| !Arc::ptr_eq(other, base));
    others.take(MOST_REMEMBERED).map(|other| Arc::downgrade(&other)).collect()
}

/// The base bodies of `kin`, without `base`.
pub(super) fn others(base: &Arc<Prepared>, kin: &[BaseBody]) -> Vec<Weak<Prepared>> {
    let of_build = kin.iter().filter(|kin| kin.0.params == base.params);
    let others = of_build.filter(|kin| !Arc::ptr_eq(&kin.0, base));
    others.take(MOST_REMEMBERED).map(|kin| Arc::downgrade(&kin.0)).collect()
}

fn known(previous: &Artifacts) -> impl Iterator<Item = Arc<Prepared>> {
    let earlier = previous.earlier.iter().filter_map(Weak::upgrade);
    std::iter::once(previous.prepared.clone()).chain(earlier)
}
