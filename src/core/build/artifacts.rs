//! One generation of a prepared body, and what can be asked of it.

use super::certificate::{Certificate, Verdict};
use super::close::ClosingReport;
use super::params::{BuildParams, Derivatives, Method};
use super::single::Single;
use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::assembly::sparse::BlockMatrix;
use crate::control::Stage;
use crate::cubature::Rule;
use crate::dictionary::{Block, Combination};
use crate::edit::{BaseState, EditState, Stitch, sorted};
use crate::factorization::SparseCholesky;
use crate::linalg;
use crate::mesh::TetMesh;
use crate::modes::AuditedSpectrum;
use crate::modes::low_rank::MassInverse;
use crate::modes::seams::{SeamRecipe, Seams};
use crate::modes::stitched::StitchMatrix;
use crate::pool::Tall;
use crate::reduced::contact::{Contact, ContactSurface};
use crate::reduced::{self, Evaluation, EvaluatorTables, ReducedModel, VertexRows};
use faer::{Mat, MatRef};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock, Weak};
use std::time::Duration;

/// Where the cubature rule of a generation came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CubatureSource {
    /// Chosen and fitted for this basis.
    Trained,
    /// Points and weights of the previous generation, or those trained for the closed seam.
    Reused,
    /// Points of the previous generation, weights fitted anew, and smoothing where there is any.
    Refitted,
    /// Chosen and fitted anew, because the previous points no longer served.
    Retrained,
}

/// What is known of a generation's cubature rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CubatureReport {
    /// Points with positive weight.
    pub n_points: usize,
    /// Where the rule came from.
    pub source: CubatureSource,
    /// Relative reduced-force error on poses not used for fitting, in the energy norm
    /// ([`crate::cubature::EnergyNorm`]; root mean square over poses).
    pub validation_error: f64,
}

/// The base body: everything that later edits reuse. Made once, shared by every generation until an
/// edit changes the [`BaseState`].
pub(super) struct Prepared {
    pub(super) params: BuildParams,
    /// What edits have made of it before it was prepared.
    pub(super) state: BaseState,
    pub(super) model: FullModel,
    pub(super) mass: Mass,
    /// Made by the first `low_rank` update.
    pub(super) mass_inverse: OnceLock<MassInverse>,
    pub(super) stiffness: BlockMatrix,
    /// Factor of K + σM.
    pub(super) factor: SparseCholesky,
    /// The same in single precision, made by the first edit outside a seam, if it is of use.
    pub(super) single: OnceLock<Option<Single>>,
    pub(super) sigma: f64,
    /// X: M-orthonormal rigid modes, then elastic ones with guards (n×k each).
    pub(super) x: [Arc<Block>; 2],
    /// Eigenvalues of the elastic modes, and their residuals.
    pub(super) spectrum: AuditedSpectrum,
    /// What a derivative took, its solve above all: to tell what fits before a deadline.
    pub(super) column_time: Duration,
    /// What is prepared for stitches, beside the load cases of derivatives.
    pub(super) seams: SeamCache,
}

/// Seams that grow while generations use them; none before somebody needs them
/// ([`super::seams::present`]).
#[derive(Default)]
pub(super) struct SeamCache {
    seams: RwLock<Option<Arc<Seams>>>,
    /// Modal derivatives (n×p) of the base body, as long as they serve nothing but load cases that nobody has needed yet.
    derivatives: Mutex<Option<Arc<Tall>>>,
    /// What comes last of a seam.
    closed_rule: Mutex<Option<ClosedRule>>,
}

/// The cubature rule of the body with all pairs of its seams closed: what edits may reuse beside that of the generation
/// before them.
#[derive(Clone)]
pub(super) struct ClosedRule {
    /// Pairs that were closed.
    pub(super) n_pairs: usize,
    pub(super) rule: Rule,
    /// Its validation error when it was trained.
    pub(super) trained_error: f64,
}

impl Prepared {
    /// Rigid modes (n×k).
    pub(super) fn rigid(&self) -> MatRef<'_, f64> {
        self.x[0].columns.as_ref()
    }

    /// Elastic modes with guards (n×k).
    pub(super) fn modes(&self) -> MatRef<'_, f64> {
        self.x[1].columns.as_ref()
    }

    /// The factor in single precision, if that is of use.
    pub(super) fn single(&self) -> Option<&Single> {
        self.single.get_or_init(|| Single::new(self)).as_ref()
    }

    /// What is prepared now, if anything is.
    pub(super) fn known_seams(&self) -> Option<Arc<Seams>> {
        self.seams.seams.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Puts larger seams in place; of two made at the same time the larger stays.
    pub(super) fn offer_seams(&self, seams: Arc<Seams>) {
        let mut kept = self.seams.seams.write().unwrap_or_else(PoisonError::into_inner);
        let size = |seams: &Seams| (seams.len(), seams.cases().len());
        if kept.as_ref().is_none_or(|kept| size(&seams) > size(kept)) {
            *kept = Some(seams);
        }
        *self.derivatives() = None;
    }

    /// Its modal derivatives (n×p), from the build until there are load cases.
    pub(super) fn derivatives(&self) -> MutexGuard<'_, Option<Arc<Tall>>> {
        self.seams.derivatives.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The rule that was trained for the closed seams, if one was.
    pub(super) fn closed_rule(&self) -> MutexGuard<'_, Option<ClosedRule>> {
        self.seams.closed_rule.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The scale of the body's softest deformation, in 1/s².
    pub(super) fn first_elastic_eigenvalue(&self) -> f64 {
        self.spectrum.eigenvalues.iter().copied().find(|lambda| *lambda > 0.0).unwrap_or(1.0)
    }
}

/// How a generation came about, beside its state ([`super::Recipe`]).
pub(super) struct Origin {
    pub(super) method: Option<Method>,
    pub(super) derivatives: Derivatives,
    pub(super) tolerance: f64,
    pub(super) reuse: Option<(Rule, f64)>,
    pub(super) seams: Arc<SeamRecipe>,
    pub(super) skipped: Vec<bool>,
}

impl Origin {
    /// Of a body as it was built.
    pub(super) fn built(skipped: Vec<bool>) -> Origin {
        Origin {
            method: None,
            derivatives: Derivatives::default(),
            tolerance: 0.0,
            reuse: None,
            seams: Arc::default(),
            skipped,
        }
    }
}

/// One generation of a prepared body. Immutable; shared by `Arc`.
pub struct Artifacts {
    pub(super) prepared: Arc<Prepared>,
    /// Base bodies of generations before this one, the latest first.
    pub(super) earlier: Vec<Weak<Prepared>>,
    pub(super) state: EditState,
    pub(super) origin: Origin,
    /// By the edits that made this generation.
    pub(super) closings: Vec<ClosingReport>,
    pub(super) n_rigid_modes: usize,
    pub(super) spectrum: AuditedSpectrum,
    pub(super) verdict: Verdict,
    pub(super) is_unfinished: bool,
    /// Relative eigenvalue error asked for, if any.
    pub(super) tolerance: Option<f64>,
    pub(super) modes: Combination,
    pub(super) basis: Combination,
    pub(super) rule: Rule,
    pub(super) cubature: Option<CubatureReport>,
    /// Validation error of the rule when it was last trained.
    pub(super) trained_error: f64,
    pub(super) model: Arc<ReducedModel>,
    /// Of the mesh in the basis, made when a simulation has obstacles.
    pub(super) surface: OnceLock<Arc<ContactSurface>>,
    pub(super) timings: Vec<(Stage, Duration)>,
    pub(super) warnings: Vec<String>,
}

impl std::fmt::Debug for Artifacts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Artifacts")
            .field("n_free_dofs", &self.n_free_dofs())
            .field("n_modes", &self.n_modes())
            .field("basis_size", &self.basis_size())
            .field("n_stitches", &self.stitches().len())
            .finish_non_exhaustive()
    }
}

impl Artifacts {
    /// The mesh. A closing ([`crate::edit::Edit::Close`]) moves vertices, no edit changes their number.
    pub fn mesh(&self) -> &Arc<TetMesh> {
        self.prepared.model.mesh()
    }
    /// The parameters of the build.
    pub fn params(&self) -> &BuildParams {
        &self.prepared.params
    }
    /// The full-order model: matrices and forces before reduction.
    pub fn full_model(&self) -> &FullModel {
        &self.prepared.model
    }
    /// The stitches in force.
    pub fn stitches(&self) -> &[Stitch] {
        self.state.stitches()
    }
    /// Factors by which domains are stiffer than they were built, by label, where not 1.
    pub fn stiffness_factors(&self) -> &BTreeMap<i64, f64> {
        self.state.base().stiffness_factors()
    }
    /// The vertices held, by the build or by edits.
    pub fn fixed_vertices(&self) -> &BTreeSet<u32> {
        self.state.base().fixed_vertices()
    }
    /// What the closings among the edits that made this generation did, in their order.
    pub fn closings(&self) -> &[ClosingReport] {
        &self.closings
    }
    /// Three times the number of vertices that may move.
    pub fn n_free_dofs(&self) -> usize {
        self.prepared.model.n()
    }
    /// The shift σ of the factorized K + σM in 1/s²: zero for a body that is held everywhere.
    pub fn shift_per_s2(&self) -> f64 {
        self.prepared.sigma
    }
    /// Bytes of the factor of K + σM that every generation shares.
    pub fn factor_bytes(&self) -> usize {
        self.prepared.factor.bytes()
    }
    /// Rigid motions that cost no energy, with the stitches in force.
    pub fn n_rigid_modes(&self) -> usize {
        self.n_rigid_modes
    }
    /// Eigenvalues λ = ω² of the elastic modes in 1/s², ascending.
    pub fn eigenvalues_per_s2(&self) -> &[f64] {
        &self.spectrum.eigenvalues
    }
    /// Frequencies √λ/2π of the elastic modes.
    pub fn frequencies_hz(&self) -> Vec<f64> {
        let hz = |lambda: &f64| lambda.max(0.0).sqrt() / std::f64::consts::TAU;
        self.spectrum.eigenvalues.iter().map(hz).collect()
    }
    /// For each mode its relative residual in the norm of the flexibility
    /// ([`crate::modes::relative_residuals`]), or the larger one that the eigensolver knows
    /// ([`crate::modes::lanczos::AuditedModes::residuals`]): its eigenvalue is wrong by about the
    /// square of it. Of a mode that was within the tolerance before others were refined it is from then.
    pub fn residuals(&self) -> &[f64] {
        &self.spectrum.residuals
    }
    /// Estimated relative errors of the eigenvalues.
    pub fn error_estimates(&self) -> &[f64] {
        &self.spectrum.error_estimates
    }
    /// What this generation claims of itself.
    pub fn certificate(&self) -> Certificate {
        let [lower, upper] = self.spectrum.worst_errors();
        let cubature_error = self.cubature.map(|report| report.validation_error);
        let allowed = self.params().cubature.map_or(f64::INFINITY, |cubature| cubature.tolerance);
        Certificate {
            verdict: self.verdict,
            lower_eigenvalue_error: lower,
            upper_eigenvalue_error: upper,
            basis_angle: self.spectrum.worst_angle(),
            cubature_error,
            is_met: self.modes_are_met() && cubature_error.is_none_or(|error| error <= allowed),
            is_unfinished: self.is_unfinished,
        }
    }
    /// Whether the modes are within the tolerance asked for, if any was.
    pub fn modes_are_met(&self) -> bool {
        self.tolerance.is_none_or(|tolerance| self.spectrum.beyond(tolerance).is_empty())
    }
    /// Where the derivatives were to come from.
    pub fn derivatives(&self) -> Derivatives {
        self.origin.derivatives
    }
    /// Stitches that the base body does not hold: what each update of it adds.
    pub fn n_open_stitches(&self) -> usize {
        self.state.open_stitches().len()
    }
    /// Those of `pairs` that neither a seam of the base body nor the base body itself holds.
    pub fn unprepared(&self, pairs: impl IntoIterator<Item = [u32; 2]>) -> Vec<[u32; 2]> {
        let (seams, folded) = (self.prepared.known_seams(), self.prepared.state.folded());
        let is_missing = |pair: &[u32; 2]| {
            seams.as_ref().is_none_or(|seams| seams.position(*pair).is_none())
                && !folded.contains_key(&sorted(*pair))
        };
        pairs.into_iter().filter(is_missing).collect()
    }
    /// Bytes that a prepared pair takes: two vectors for each of its three columns.
    pub fn prepared_pair_bytes(&self) -> usize {
        6 * size_of::<f64>() * self.n_free_dofs()
    }
    /// Pairs that seams of the base body hold.
    pub fn n_prepared_pairs(&self) -> usize {
        self.prepared.known_seams().map_or(0, |seams| seams.len())
    }
    /// Number of elastic modes kept.
    pub fn n_modes(&self) -> usize {
        self.spectrum.eigenvalues.len()
    }
    /// Number of columns of the basis (at most the size asked for).
    pub fn basis_size(&self) -> usize {
        self.basis.n_columns()
    }
    /// The cubature rule's report, if the body has one.
    pub fn cubature(&self) -> Option<&CubatureReport> {
        self.cubature.as_ref()
    }
    /// Time spent in each stage of the build or rebuild that made this generation.
    pub fn timings(&self) -> &[(Stage, Duration)] {
        &self.timings
    }
    /// What the caller should know, in words.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Bytes held by this generation, shared parts included.
    pub fn memory_bytes(&self) -> usize {
        self.base_memory().1 + self.own_memory_bytes()
    }

    /// Bytes of the base body, behind a number that tells base bodies apart for as long as they live.
    pub fn base_memory(&self) -> (usize, usize) {
        let base = &self.prepared;
        let n_bytes = base.model.bytes()
            + base.mass.bytes()
            + base.stiffness.bytes()
            + base.factor.bytes()
            + base.single.get().map_or(0, |s| s.as_ref().map_or(0, |s| s.factor.bytes()))
            + base.x.iter().map(|x| x.columns.bytes()).sum::<usize>()
            + base.known_seams().map_or(0, |seams| seams.bytes())
            + base.derivatives().as_ref().map_or(0, |shapes| shapes.bytes());
        (Arc::as_ptr(base).addr(), n_bytes)
    }

    /// Bytes beside the base body.
    pub fn own_memory_bytes(&self) -> usize {
        let surface = self.surface.get().map_or(0, |surface| surface.bytes());
        let shared: BTreeSet<u64> = self.prepared_blocks().iter().map(|block| block.id).collect();
        let [modes, basis] = [&self.modes, &self.basis]
            .map(|columns| columns.bytes(|block| shared.contains(&block.id)));
        modes + basis + self.model.bytes() + surface
    }

    /// Elastic mode `i` over all vertices, vertex-major: 3·n_vertices numbers, fixed ones 0.
    pub fn mode(&self, i: usize) -> Vec<f64> {
        self.column(&self.modes, i)
    }
    /// Basis column `i` over all vertices, vertex-major: 3·n_vertices numbers, fixed ones 0.
    pub fn basis_column(&self, i: usize) -> Vec<f64> {
        self.column(&self.basis, i)
    }
    fn column(&self, of: &Combination, i: usize) -> Vec<f64> {
        let column: Vec<f64> = of.dense().col(i).iter().copied().collect();
        self.prepared.model.expand(&column)
    }
    /// The basis over the free degrees of freedom (n×r).
    pub fn basis(&self) -> MatRef<'_, f64> {
        self.basis.dense()
    }
    /// The r × 3 rows of the basis at one vertex: `rows[i]` is column `i`'s displacement there.
    pub fn basis_rows(&self, vertex: u32) -> Vec<[f64; 3]> {
        match self.prepared.model.free_index(vertex) {
            None => vec![[0.0; 3]; self.basis_size()],
            Some(v) => {
                let rows = self.basis.rows(&[0, 1, 2].map(|axis| Some(3 * v + axis)));
                rows.col_iter().map(|c| std::array::from_fn(|axis| c[axis])).collect()
            }
        }
    }

    /// Lumped mass of every vertex in kg (row sums, if the mass matrix is consistent).
    pub fn lumped_mass_kg(&self) -> &[f64] {
        self.prepared.model.lumped_mass_kg()
    }

    /// The reduced model, for evaluation and simulation.
    pub fn model(&self) -> &Arc<ReducedModel> {
        &self.model
    }
    /// Reduced load (r numbers) of a force in N on one vertex.
    pub fn vertex_load(&self, vertex: u32, force_n: [f64; 3]) -> Vec<f64> {
        let dot = |row: &[f64; 3]| row.iter().zip(force_n).map(|(u, f)| u * f).sum();
        self.basis_rows(vertex).iter().map(dot).collect()
    }
    /// A vertex in the subspace, as simulations pull at it.
    pub fn vertex_rows(&self, vertex: u32) -> VertexRows {
        let rest_m = self.mesh().vertices()[vertex as usize];
        VertexRows { rest_m, rows: self.basis_rows(vertex) }
    }
    /// The surface in the subspace, for contact; made when it is first asked for.
    pub fn contact_surface(&self) -> &Arc<ContactSurface> {
        self.surface
            .get_or_init(|| Arc::new(reduced::contact_surface(&self.prepared.model, &self.basis)))
    }
    /// Contact as suits the body: the pressure at a depth of a tenth of its size is its stiffest Young's
    /// modulus, and what sticks creeps by a hundredth of its size a second.
    pub fn suited_contact(&self) -> Contact {
        let materials = &self.prepared.params.materials;
        let stiffest = materials.iter().map(|m| m.young_modulus_pa()).fold(0.0, f64::max);
        let size = self.mesh().diagonal();
        Contact {
            stiffness_pa_m: 10.0 * stiffest / size,
            damping_s_m: 1.0,
            friction: 0.3,
            creep_m_s: 0.01 * size,
        }
    }
    /// The evaluator as plain arrays, for a client that steps on its own.
    pub fn evaluator_tables(&self) -> EvaluatorTables {
        reduced::tables(&self.prepared.model, &self.rule, &self.basis, &self.model)
    }

    /// Energy, force and stiffness at `q` (r numbers) summed over every tet: the oracle of the
    /// cubature.
    pub fn evaluate_exact(&self, q: &[f64]) -> Evaluation {
        let model = &self.prepared.model;
        let basis = self.basis();
        let r = self.basis_size();
        let q = Mat::from_fn(r, 1, |i, _| q[i]);
        let u = linalg::product(basis, q.as_ref());
        let stretch = StitchMatrix::new(model, self.state.stitches()).transpose_times(basis);
        let stitched = linalg::gram(stretch.as_ref(), stretch.as_ref());
        let stitch_force = linalg::small_product(stitched.as_ref(), q.as_ref());
        let stitch_energy: f64 = q.col(0).transpose() * stitch_force.col(0);
        let mut force = model.reduced_forces(basis, q.as_ref());
        force += &stitch_force;
        let u = u.col_as_slice(0);
        let tangent = model.tangent_stiffness(u, self.prepared.stiffness.pattern());
        let mut stiffness = linalg::gram(basis, tangent.multiply(basis).as_ref());
        stiffness += stitched;
        Evaluation {
            energy_j: model.energy(u) + 0.5 * stitch_energy,
            force: (0..r).map(|i| force[(i, 0)]).collect(),
            stiffness: rows(&stiffness),
        }
    }
}

/// A matrix by rows.
pub(super) fn rows(m: &Mat<f64>) -> Vec<f64> {
    (0..m.nrows()).flat_map(|i| (0..m.ncols()).map(move |j| m[(i, j)])).collect()
}
