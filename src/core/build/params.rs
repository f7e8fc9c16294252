//! What a build and a rebuild are asked for, and why they may refuse.

use crate::assembly::FullModel;
use crate::assembly::mass::MassKind;
use crate::basis::PcaMethod;
use crate::closing::ClosingError;
use crate::control::Cancelled;
use crate::cubature::{Selection, TrainingError};
use crate::edit::{self, BaseState, EditError, EditKind};
use crate::factorization::FactorizationError;
use crate::linalg::DenseError;
use crate::material::Material;
use crate::mesh::TetMesh;
use crate::modes::ModesError;
use crate::reduced::RayleighDamping;
use std::sync::Arc;
use std::time::Duration;

/// Cubature training (\[M16\] §4.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CubatureParams {
    /// Most points that may be chosen.
    pub n_points: usize,
    /// Poses to fit.
    pub n_training_poses: usize,
    /// Relative reduced-force error (energy norm) at which training stops and above which a reused
    /// rule is refitted.
    pub tolerance: f64,
    /// Seed of the poses and of the candidate subset.
    pub seed: u64,
    /// How points are chosen.
    pub selection: Selection,
    /// Whether points may take of their neighbours' strain where the tolerance is not met without
    /// ([`Smoothing`](crate::cubature::Smoothing)).
    pub smoothing: bool,
}

/// Everything that [`build`](super::build) needs beside the mesh. There is no default on purpose: the caller
/// resolves every value and can show it.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildParams {
    /// One material for each entry of [`TetMesh::domains`].
    pub materials: Vec<Material>,
    /// Stiffness of each tet relative to its domain's material; empty if all are alike.
    pub tet_stiffness: Arc<[f64]>,
    /// Vertices that never move.
    pub fixed_vertices: Vec<u32>,
    /// Lumped or consistent.
    pub mass: MassKind,
    /// Elastic linear modes to keep.
    pub n_modes: usize,
    /// Columns of the basis.
    pub basis_size: usize,
    /// How its columns are found.
    pub pca: PcaMethod,
    /// The lowest so many modes contribute all their pairwise modal derivatives.
    pub n_derivative_modes: usize,
    /// Cubature training; `None` evaluates every tet.
    pub cubature: Option<CubatureParams>,
    /// Damping of the reduced model.
    pub damping: RayleighDamping,
    /// Candidate stitch pairs, for [`prepare_seams`](super::prepare_seams).
    pub seams: Vec<[u32; 2]>,
}

/// How the linear modes follow an edit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Preconditioned by the cached factorization, refined to a tolerance (numerics: the default).
    Flexibility,
    /// The low-rank update of \[M16\] §4.1.
    LowRank,
    /// Everything anew.
    FromScratch,
}

/// Where the modal derivatives of an edit inside a seam come from (`Flexibility` only).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Derivatives {
    /// From what is prepared, whatever it knows of the stitched body's modes: never a solve.
    #[default]
    Prepared,
    /// From what is prepared where that knows the stitched body's modes, else solved for.
    Own,
}

/// Parameters of [`rebuild`](super::rebuild).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RebuildParams {
    /// How to update the modes.
    pub method: Method,
    /// Where derivatives come from.
    pub derivatives: Derivatives,
    /// Relative eigenvalue error accepted for the lower half of the modes (`Flexibility` only).
    pub tolerance: f64,
    /// Time, by the caller's clock, after which nothing more is refined: the best so far is the answer
    /// (`Flexibility` only). What cannot be done without, whatever the time, is a first answer.
    pub deadline: Option<Duration>,
}

impl RebuildParams {
    /// Refines until `tolerance` is met.
    pub fn new(method: Method, tolerance: f64) -> RebuildParams {
        RebuildParams { method, derivatives: Derivatives::default(), tolerance, deadline: None }
    }
}

/// Why a body could not be built or rebuilt.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum BuildError {
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    #[error(transparent)]
    Edit(#[from] EditError),
    #[error("seams: {0}")]
    Seam(EditError),
    #[error(
        "fixed_vertices entry {position}: vertex {vertex} is out of range, the mesh has {n_vertices} vertices"
    )]
    FixedVertexOutOfRange { position: usize, vertex: u32, n_vertices: usize },
    #[error("every vertex is fixed: nothing can move")]
    NothingFree,
    #[error(
        "the body would take about {n_bytes} bytes of memory while it is prepared, more than is left of the budget"
    )]
    OverBudget { n_bytes: usize },
    #[error("{given} materials for {n_domains} domains")]
    MaterialCount { given: usize, n_domains: usize },
    #[error("tet_stiffness has {given} entries for {n_tets} tets")]
    TetStiffnessCount { given: usize, n_tets: usize },
    #[error("tet_stiffness entry {tet} is {value:e}, but must be between {low:e} and {high:e}")]
    TetStiffness { tet: usize, value: f64, low: f64, high: f64 },
    #[error("{name} is {value}, but must be between {low} and {high}")]
    OutOfRange { name: &'static str, value: usize, low: usize, high: usize },
    #[error("{name} is {value}, but must be {rule}")]
    BadParameter { name: &'static str, value: f64, rule: &'static str },
    #[error(
        "the stiffness matrix could not be factorized: vertex {vertex} meets a non-positive pivot (is a tet extremely flat or a material extremely soft?)"
    )]
    NonPositivePivot { vertex: u32 },
    #[error("{what} did not converge: {detail}")]
    NotConverged { what: &'static str, detail: String },
    #[error("{what} produced a number that is not finite")]
    NonFinite { what: &'static str },
    #[error("what was kept of the body does not belong to it: {what}")]
    Misfit { what: &'static str },
}

impl BuildError {
    /// A factorization's error, its row named as a vertex of the mesh.
    pub(crate) fn of_factorization(error: FactorizationError, model: &FullModel) -> BuildError {
        match error {
            FactorizationError::NonPositivePivot { row } => BuildError::NonPositivePivot {
                vertex: model.free_vertices().get(row / 3).copied().unwrap_or_default(),
            },
            other => {
                BuildError::NotConverged { what: "the factorization", detail: other.to_string() }
            }
        }
    }
}

impl From<DenseError> for BuildError {
    fn from(error: DenseError) -> BuildError {
        BuildError::NotConverged { what: "a small dense problem", detail: error.to_string() }
    }
}

impl From<ModesError> for BuildError {
    fn from(error: ModesError) -> BuildError {
        match error {
            ModesError::Cancelled(cancelled) => BuildError::Cancelled(cancelled),
            other => BuildError::NotConverged { what: "the modes", detail: other.to_string() },
        }
    }
}

impl From<ClosingError> for BuildError {
    fn from(error: ClosingError) -> BuildError {
        match error {
            ClosingError::Cancelled(cancelled) => BuildError::Cancelled(cancelled),
            other => BuildError::NotConverged { what: "the closing", detail: other.to_string() },
        }
    }
}

impl From<TrainingError> for BuildError {
    fn from(error: TrainingError) -> BuildError {
        match error {
            TrainingError::Cancelled(cancelled) => BuildError::Cancelled(cancelled),
            TrainingError::Dense(dense) => BuildError::from(dense),
        }
    }
}

/// Checks what can be checked before anything is computed.
pub(super) fn check(mesh: &TetMesh, params: &BuildParams) -> Result<(), BuildError> {
    let n_vertices = mesh.vertices().len();
    for (position, &vertex) in params.fixed_vertices.iter().enumerate() {
        if vertex as usize >= n_vertices {
            return Err(BuildError::FixedVertexOutOfRange { position, vertex, n_vertices });
        }
    }
    let n_domains = mesh.domains().len();
    if params.materials.len() != n_domains {
        return Err(BuildError::MaterialCount { given: params.materials.len(), n_domains });
    }
    let n_tets = mesh.tets().len();
    if !params.tet_stiffness.is_empty() && params.tet_stiffness.len() != n_tets {
        return Err(BuildError::TetStiffnessCount { given: params.tet_stiffness.len(), n_tets });
    }
    let [low, high] = edit::STIFFNESS_FACTOR_RANGE;
    let beyond = |value: &f64| !(low..=high).contains(value);
    if let Some(tet) = params.tet_stiffness.iter().position(beyond) {
        let value = params.tet_stiffness[tet];
        return Err(BuildError::TetStiffness { tet, value, low, high });
    }
    let at_least_one = |name, value: usize| match value {
        0 => Err(BuildError::OutOfRange { name, value, low: 1, high: usize::MAX }),
        _ => Ok(()),
    };
    at_least_one("n_modes", params.n_modes)?;
    at_least_one("basis.size", params.basis_size)?;
    if params.n_derivative_modes > params.n_modes {
        return Err(BuildError::OutOfRange {
            name: "basis.n_derivative_modes",
            value: params.n_derivative_modes,
            low: 0,
            high: params.n_modes,
        });
    }
    for (name, value) in [
        ("damping.rayleigh_mass_per_s", params.damping.mass_per_s),
        ("damping.rayleigh_stiffness_s", params.damping.stiffness_s),
    ] {
        if !(value >= 0.0 && value.is_finite()) {
            let rule = "finite and not negative";
            return Err(BuildError::BadParameter { name, value, rule });
        }
    }
    if let Some(cubature) = &params.cubature {
        at_least_one("cubature.n_points", cubature.n_points)?;
        at_least_one("cubature.n_training_poses", cubature.n_training_poses)?;
        check_fraction("cubature.tolerance", cubature.tolerance)?;
    }
    Ok(())
}

/// The materials of `params` with the domains that have a factor as much stiffer.
pub(super) fn scaled_materials(
    state: &BaseState,
    params: &BuildParams,
) -> Result<Vec<Material>, BuildError> {
    let domains = state.mesh().domains();
    let scaled = domains.iter().zip(&params.materials).map(|(domain, material)| {
        match state.stiffness_factors().get(domain) {
            None => Ok(*material),
            Some(factor) => material.scaled(*factor).map_err(|_| BuildError::BadParameter {
                name: "young_modulus_pa",
                value: material.young_modulus_pa() * factor,
                rule: "positive and finite",
            }),
        }
    });
    scaled.collect()
}

/// Checks that `value` lies strictly between 0 and 1.
pub(super) fn check_fraction(name: &'static str, value: f64) -> Result<(), BuildError> {
    if value > 0.0 && value < 1.0 {
        Ok(())
    } else {
        Err(BuildError::BadParameter { name, value, rule: "strictly between 0 and 1" })
    }
}

/// Checks the seams' pairs like an edit's.
pub(super) fn check_seams(state: &BaseState, pairs: &[[u32; 2]]) -> Result<(), BuildError> {
    let allowed_m = edit::COINCIDENCE_RATIO * state.mesh().diagonal();
    for (position, &pair) in pairs.iter().enumerate() {
        edit::check_pair(0, EditKind::Stitch, position, pair, state, allowed_m)
            .map_err(BuildError::Seam)?;
    }
    Ok(())
}
