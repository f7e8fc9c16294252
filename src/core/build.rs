//! The only orchestrator: [`build`] prepares a body, [`rebuild`] applies edits to it.

use crate::control::{Cancelled, Control, Stage};
use crate::edit::{Edit, EditError, Stitch, StitchId};
use crate::material::Material;
use crate::mesh::TetMesh;
use crate::reduced::{Evaluation, EvaluatorTables, ReducedModel};
use std::sync::Arc;
use std::time::Duration;

/// How mass is distributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MassKind {
    /// A quarter of each tet's mass at each of its corners: a diagonal matrix.
    Lumped,
    /// ∫ρ NᵢNⱼ: ρV/20·(1 + δᵢⱼ) for each tet.
    Consistent,
}

/// Cubature training ([M16] §4.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CubatureParams {
    /// Most points that may be chosen.
    pub n_points: usize,
    /// Poses to fit.
    pub n_training_poses: usize,
    /// Relative reduced-force error at which training stops and above which a reused rule is refitted.
    pub tolerance: f64,
    /// Seed of the poses and of the candidate subset.
    pub seed: u64,
}

/// Rayleigh damping D = α M + β K.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayleighDamping {
    /// α in 1/s.
    pub mass_per_s: f64,
    /// β in s.
    pub stiffness_s: f64,
}

/// Everything that [`build`] needs beside the mesh. There is no default on purpose: the caller
/// resolves every value and can show it.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildParams {
    /// One material for each entry of [`TetMesh::domains`].
    pub materials: Vec<Material>,
    /// Vertices that never move.
    pub fixed_vertices: Vec<u32>,
    /// Lumped or consistent.
    pub mass: MassKind,
    /// Elastic linear modes to keep.
    pub n_modes: usize,
    /// Columns of the basis.
    pub basis_size: usize,
    /// The lowest so many modes contribute all their pairwise modal derivatives.
    pub n_derivative_modes: usize,
    /// Cubature training; `None` evaluates every tet.
    pub cubature: Option<CubatureParams>,
    /// Damping of the reduced model.
    pub damping: RayleighDamping,
    /// Candidate stitch pairs whose flexibility columns are prepared with the body.
    pub seams: Vec<[u32; 2]>,
}

/// How the linear modes follow an edit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Preconditioned by the cached factorization, refined to a tolerance (numerics: the default).
    Flexibility,
    /// The low-rank update of [M16] §4.1.
    LowRank,
    /// Everything anew.
    FromScratch,
}

/// Parameters of [`rebuild`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RebuildParams {
    /// How to update the modes.
    pub method: Method,
    /// Relative eigenvalue error accepted for the lower half of the modes (`Flexibility` only).
    pub tolerance: f64,
}

/// Where the cubature rule of a generation came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CubatureSource {
    /// Chosen and fitted for this basis.
    Trained,
    /// Points and weights of the previous generation.
    Reused,
    /// Points of the previous generation, weights fitted anew.
    Refitted,
}

/// What is known of a generation's cubature rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CubatureReport {
    /// Points with positive weight.
    pub n_points: usize,
    /// Where the rule came from.
    pub source: CubatureSource,
    /// Relative reduced-force error on poses not used for fitting (root mean square over poses).
    pub validation_error: f64,
}

/// Why a body could not be built or rebuilt.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum BuildError {
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    #[error(transparent)]
    Edit(#[from] EditError),
    #[error(
        "fixed_vertices entry {position}: vertex {vertex} is out of range, the mesh has {n_vertices} vertices"
    )]
    FixedVertexOutOfRange { position: usize, vertex: u32, n_vertices: usize },
    #[error("every vertex is fixed: nothing can move")]
    NothingFree,
    #[error("{given} materials for {n_domains} domains")]
    MaterialCount { given: usize, n_domains: usize },
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
}

/// Difference between two bases of one body: `new = [old | columns] · w`.
#[derive(Clone, Debug, PartialEq)]
pub struct BasisDelta {
    /// Columns that the old basis lacks, each over all vertices, vertex-major (3·n_vertices).
    pub columns: Vec<Vec<f64>>,
    /// (r_old + columns.len()) × r_new, row-major.
    pub w: Vec<f64>,
}

/// One generation of a prepared body. Immutable; shared by `Arc`.
pub struct Artifacts {}

/// Prepares `mesh`: matrices, factorization, modes, derivatives, basis, cubature, reduced model.
pub fn build(
    mesh: Arc<TetMesh>,
    params: &BuildParams,
    control: &dyn Control,
) -> Result<Artifacts, BuildError> {
    let _ = (mesh, params, control);
    unimplemented!()
}

/// Applies `edits` to `previous` and returns the next generation with the names of the stitches
/// made. `previous` is untouched.
pub fn rebuild(
    previous: &Artifacts,
    edits: &[Edit],
    params: &RebuildParams,
    control: &dyn Control,
) -> Result<(Artifacts, Vec<StitchId>), BuildError> {
    let _ = (previous, edits, params, control);
    unimplemented!()
}

impl Artifacts {
    /// The mesh.
    pub fn mesh(&self) -> &Arc<TetMesh> {
        unimplemented!()
    }
    /// The parameters of the build.
    pub fn params(&self) -> &BuildParams {
        unimplemented!()
    }
    /// The stitches in force.
    pub fn stitches(&self) -> &[Stitch] {
        unimplemented!()
    }
    /// Three times the number of vertices that may move.
    pub fn n_free_dofs(&self) -> usize {
        unimplemented!()
    }
    /// Rigid motions that cost no energy, with the stitches in force.
    pub fn n_rigid_modes(&self) -> usize {
        unimplemented!()
    }
    /// Eigenvalues λ = ω² of the elastic modes in 1/s², ascending.
    pub fn eigenvalues_per_s2(&self) -> &[f64] {
        unimplemented!()
    }
    /// Frequencies √λ/2π of the elastic modes.
    pub fn frequencies_hz(&self) -> Vec<f64> {
        unimplemented!()
    }
    /// For each mode its relative residual, measured in the norm of the flexibility.
    pub fn residuals(&self) -> &[f64] {
        unimplemented!()
    }
    /// Number of elastic modes kept.
    pub fn n_modes(&self) -> usize {
        self.eigenvalues_per_s2().len()
    }
    /// Number of columns of the basis (at most the size asked for).
    pub fn basis_size(&self) -> usize {
        unimplemented!()
    }
    /// The cubature rule's report, if the body has one.
    pub fn cubature(&self) -> Option<&CubatureReport> {
        unimplemented!()
    }
    /// Time spent in each stage of the build or rebuild that made this generation.
    pub fn timings(&self) -> &[(Stage, Duration)] {
        unimplemented!()
    }
    /// What the caller should know, in words.
    pub fn warnings(&self) -> &[String] {
        unimplemented!()
    }
    /// Bytes held by this generation, shared parts included.
    pub fn memory_bytes(&self) -> usize {
        unimplemented!()
    }
    /// Elastic mode `i` over all vertices, vertex-major: 3·n_vertices numbers, fixed ones 0.
    pub fn mode(&self, _i: usize) -> Vec<f64> {
        unimplemented!()
    }
    /// Basis column `i` over all vertices, vertex-major: 3·n_vertices numbers, fixed ones 0.
    pub fn basis_column(&self, _i: usize) -> Vec<f64> {
        unimplemented!()
    }
    /// The r × 3 rows of the basis at one vertex: `rows[i]` is column `i`'s displacement there.
    pub fn basis_rows(&self, _vertex: u32) -> Vec<[f64; 3]> {
        unimplemented!()
    }
    /// Lumped mass of every vertex in kg (row sums, if the mass matrix is consistent).
    pub fn lumped_mass_kg(&self) -> Vec<f64> {
        unimplemented!()
    }
    /// `transfer` with q_new = transfer · q_old: Ūᵀ M U_old, r_new × r_old, row-major. Both must be generations of one build.
    pub fn transfer_from(&self, _old: &Artifacts) -> Vec<f64> {
        unimplemented!()
    }
    /// What a client that holds the basis of `old` needs to make this one.
    pub fn delta_from(&self, _old: &Artifacts) -> BasisDelta {
        unimplemented!()
    }
    /// The reduced model, for evaluation and simulation.
    pub fn model(&self) -> &Arc<ReducedModel> {
        unimplemented!()
    }
    /// The evaluator as plain arrays, for a client that steps on its own.
    pub fn evaluator_tables(&self) -> EvaluatorTables {
        unimplemented!()
    }
    /// Energy, force and stiffness at `q` (r numbers) summed over every tet: the oracle of the cubature.
    pub fn evaluate_exact(&self, _q: &[f64]) -> Evaluation {
        unimplemented!()
    }
}
