//! Sessions: their configuration and their description.

use crate::problem::{Invalid, Problem, all_finite, count_within, within};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Longest session name, in bytes.
pub const MAX_NAME_BYTES: usize = 200;
/// Most elastic modes.
pub const MAX_MODES: usize = 512;
/// Most basis columns.
pub const MAX_BASIS_SIZE: usize = 1024;
/// Most modes that contribute derivatives (n(n + 1)/2 of them).
pub const MAX_DERIVATIVE_MODES: usize = 64;
/// Most cubature points.
pub const MAX_CUBATURE_POINTS: usize = 100_000;
/// Most training poses.
pub const MAX_TRAINING_POSES: usize = 10_000;
/// Most candidate pairs prepared ahead.
pub const MAX_SEAM_PAIRS: usize = 65_536;

/// What a session is made from. The mesh is either inline (`mesh`, in a JSON request) or a file
/// (the `mesh` part of a multipart request, which leaves this member out).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionConfig {
    /// A name for people; need not be unique.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The mesh, inline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh: Option<MeshConfig>,
    /// The material of every domain that `domain_materials` does not name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<MaterialConfig>,
    /// Materials of single domains, by label.
    #[serde(default)]
    #[schema(value_type = BTreeMap<String, MaterialConfig>)] // names of members are text
    pub domain_materials: BTreeMap<i64, MaterialConfig>,
    /// How many times as stiff each tet is as the material of its domain; empty if all are alike.
    #[serde(default)]
    pub tet_stiffness: Vec<f64>,
    /// Vertices that never move (zero-based).
    #[serde(default)]
    pub fixed_vertices: Vec<u32>,
    /// How mass is distributed. Default: `lumped`.
    #[serde(default)]
    pub mass: MassConfig,
    /// Elastic linear modes to keep. Default: 30.
    #[serde(default = "default_n_modes")]
    pub n_modes: usize,
    /// The basis of the reduced model.
    #[serde(default)]
    pub basis: BasisConfig,
    /// Cubature training; `null` skips it, and every tet is summed. Default: train.
    #[serde(default = "default_cubature")]
    pub cubature: Option<CubatureConfig>,
    /// Rayleigh damping.
    #[serde(default)]
    pub damping: DampingConfig,
    /// Candidate stitch pairs to prepare ahead (zero-based vertices).
    #[serde(default)]
    pub seams: Vec<[u32; 2]>,
}

fn default_n_modes() -> usize {
    30
}

fn default_cubature() -> Option<CubatureConfig> {
    Some(CubatureConfig::default())
}

/// A tetrahedral mesh, inline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeshConfig {
    /// Rest positions in metres.
    pub vertices: Vec<[f64; 3]>,
    /// Corners of each tet (zero-based), positively oriented.
    pub tets: Vec<[u32; 4]>,
    /// The domain label of each tet; empty for a single domain 0.
    #[serde(default)]
    pub domains: Vec<i64>,
}

/// A constitutive law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum MaterialLaw {
    /// Small-strain linear elasticity: for small rotations only.
    Linear,
    /// St. Venant–Kirchhoff.
    Stvk,
    /// Stable neo-Hookean (Smith, De Goes and Kim 2018).
    NeoHookean,
    /// Mooney–Rivlin, compressible.
    MooneyRivlin,
    /// Corotational linear elasticity.
    Corotational,
}

/// A material.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MaterialConfig {
    /// The constitutive law.
    pub law: MaterialLaw,
    /// Young's modulus in Pa.
    pub young_modulus_pa: f64,
    /// Poisson's ratio, strictly between −1 and 0.5.
    pub poisson_ratio: f64,
    /// Density in kg/m³.
    pub density_kg_m3: f64,
    /// C₀₁/(C₁₀ + C₀₁), 0 to 1, of a `mooney_rivlin` material. Default: 0.2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mooney_ratio: Option<f64>,
}

/// How mass is distributed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum MassConfig {
    /// A quarter of each tet's mass at each of its corners.
    #[default]
    Lumped,
    /// ∫ρ NᵢNⱼ.
    Consistent,
}

/// The basis of the reduced model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BasisConfig {
    /// Columns of the basis. Default: 60.
    pub size: usize,
    /// The lowest so many modes contribute all their pairwise derivatives. Default: 8.
    pub n_derivative_modes: usize,
    /// How the columns are chosen among modes and derivatives. Default: `snapshots`.
    pub pca: PcaConfig,
}

impl Default for BasisConfig {
    fn default() -> Self {
        BasisConfig { size: 60, n_derivative_modes: 8, pca: PcaConfig::default() }
    }
}

/// How principal components in the mass inner product are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PcaConfig {
    /// From the Gram matrix of all columns.
    #[default]
    Snapshots,
    /// From random combinations of the columns.
    Randomized,
}

/// Cubature training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CubatureConfig {
    /// Most points that may be chosen. Default: 120.
    pub n_points: usize,
    /// Poses to fit. Default: 100.
    pub n_training_poses: usize,
    /// Relative reduced-force error at which training stops. Default: 0.05.
    pub tolerance: f64,
    /// Seed of the poses and of the candidates. Default: 1.
    pub seed: u64,
    /// How points are chosen. Default: `greedy_nnls`.
    pub selection: SelectionConfig,
    /// Whether, where the tolerance is not met otherwise, each point may take of the strain of its tet's neighbours as
    /// much as the poses say: half the error with as many points, for longer training. `false`: points are tets, as in
    /// the papers. Default: `true`.
    pub smoothing: bool,
}

impl Default for CubatureConfig {
    fn default() -> Self {
        CubatureConfig {
            n_points: 120,
            n_training_poses: 100,
            tolerance: 0.05,
            seed: 1,
            selection: SelectionConfig::default(),
            smoothing: true,
        }
    }
}

/// How cubature points are chosen among the tets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SelectionConfig {
    /// Greedy non-negative least squares over random candidates.
    #[default]
    GreedyNnls,
    /// Non-negative hard thresholding pursuit over random candidates.
    NnHtp,
    /// Sparse non-negative least squares over every tet (energy-conserving sampling and weighting).
    SparseNnls,
    /// Empirical cubature over every tet.
    EmpiricalCubature,
}

/// Rayleigh damping D = α M + β K.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DampingConfig {
    /// α in 1/s. Default: 0.1.
    pub rayleigh_mass_per_s: f64,
    /// β in s. Default: 0.001.
    pub rayleigh_stiffness_s: f64,
}

impl Default for DampingConfig {
    fn default() -> Self {
        DampingConfig { rayleigh_mass_per_s: 0.1, rayleigh_stiffness_s: 0.001 }
    }
}

impl SessionConfig {
    /// Everything at its default, one material for every domain.
    pub fn new(material: MaterialConfig) -> SessionConfig {
        SessionConfig {
            name: None,
            mesh: None,
            material: Some(material),
            domain_materials: BTreeMap::new(),
            tet_stiffness: Vec::new(),
            fixed_vertices: Vec::new(),
            mass: MassConfig::default(),
            n_modes: default_n_modes(),
            basis: BasisConfig::default(),
            cubature: default_cubature(),
            damping: DampingConfig::default(),
            seams: Vec::new(),
        }
    }

    /// Refuses what no mesh could make valid. Whether indices exist, whether every domain has a
    /// material and whether the mesh is sound is for the body to say.
    pub fn validate(&self) -> Result<(), Invalid> {
        check_name(self.name.as_deref())?;
        if self.material.is_none() && self.domain_materials.is_empty() {
            return Err(Invalid::new("/material", "give a material (or domain_materials)"));
        }
        if let Some(material) = &self.material {
            material.validate("/material")?;
        }
        for (label, material) in &self.domain_materials {
            material.validate(&format!("/domain_materials/{label}"))?;
        }
        all_finite("/tet_stiffness", &self.tet_stiffness)?;
        count_within("/n_modes", self.n_modes, 1, MAX_MODES)?;
        count_within("/basis/size", self.basis.size, 1, MAX_BASIS_SIZE)?;
        count_within(
            "/basis/n_derivative_modes",
            self.basis.n_derivative_modes,
            0,
            MAX_DERIVATIVE_MODES,
        )?;
        if let Some(cubature) = &self.cubature {
            cubature.validate()?;
        }
        let DampingConfig { rayleigh_mass_per_s, rayleigh_stiffness_s } = self.damping;
        within("/damping/rayleigh_mass_per_s", rayleigh_mass_per_s, 0.0, 1e6)?;
        within("/damping/rayleigh_stiffness_s", rayleigh_stiffness_s, 0.0, 1e6)?;
        if self.seams.len() > MAX_SEAM_PAIRS {
            return Err(Invalid::new("/seams", format!("at most {MAX_SEAM_PAIRS} pairs")));
        }
        if let Some(i) = self.seams.iter().position(|[a, b]| a == b) {
            return Err(Invalid::new(format!("/seams/{i}"), "a vertex cannot meet itself"));
        }
        if let Some(mesh) = &self.mesh {
            mesh.validate()?;
        }
        Ok(())
    }
}

impl MeshConfig {
    fn validate(&self) -> Result<(), Invalid> {
        for (i, x) in self.vertices.iter().enumerate() {
            all_finite(&format!("/mesh/vertices/{i}"), x)?;
        }
        if self.tets.is_empty() {
            return Err(Invalid::new("/mesh/tets", "the mesh has no tetrahedra"));
        }
        if !self.domains.is_empty() && self.domains.len() != self.tets.len() {
            let (n_labels, n_tets) = (self.domains.len(), self.tets.len());
            return Err(Invalid::new(
                "/mesh/domains",
                format!("{n_labels} labels for {n_tets} tets"),
            ));
        }
        Ok(())
    }
}

impl MaterialConfig {
    /// St. Venant–Kirchhoff: Young's modulus in Pa, Poisson's ratio, density in kg/m³.
    pub fn stvk(young_modulus_pa: f64, poisson_ratio: f64, density_kg_m3: f64) -> MaterialConfig {
        MaterialConfig {
            law: MaterialLaw::Stvk,
            young_modulus_pa,
            poisson_ratio,
            density_kg_m3,
            mooney_ratio: None,
        }
    }

    fn validate(&self, pointer: &str) -> Result<(), Invalid> {
        within(&format!("{pointer}/young_modulus_pa"), self.young_modulus_pa, 1e-30, 1e30)?;
        if !(self.poisson_ratio > -1.0 && self.poisson_ratio < 0.5) {
            let detail =
                format!("must lie strictly between -1 and 0.5, not {}", self.poisson_ratio);
            return Err(Invalid::new(format!("{pointer}/poisson_ratio"), detail));
        }
        within(&format!("{pointer}/density_kg_m3"), self.density_kg_m3, 1e-30, 1e30)?;
        match self.mooney_ratio {
            Some(_) if self.law != MaterialLaw::MooneyRivlin => Err(Invalid::new(
                format!("{pointer}/mooney_ratio"),
                "only mooney_rivlin materials have one",
            )),
            Some(ratio) => within(&format!("{pointer}/mooney_ratio"), ratio, 0.0, 1.0),
            None => Ok(()),
        }
    }
}

impl CubatureConfig {
    fn validate(&self) -> Result<(), Invalid> {
        count_within("/cubature/n_points", self.n_points, 1, MAX_CUBATURE_POINTS)?;
        count_within("/cubature/n_training_poses", self.n_training_poses, 1, MAX_TRAINING_POSES)?;
        within("/cubature/tolerance", self.tolerance, 1e-12, 1.0)
    }
}

fn check_name(name: Option<&str>) -> Result<(), Invalid> {
    let Some(name) = name else { return Ok(()) };
    if name.is_empty() || name.len() > MAX_NAME_BYTES {
        return Err(Invalid::new("/name", format!("must be 1 to {MAX_NAME_BYTES} bytes")));
    }
    if name.chars().any(char::is_control) {
        return Err(Invalid::new("/name", "must not contain control characters"));
    }
    Ok(())
}

/// What a session is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SessionState {
    /// Generation 0 is being prepared.
    Building,
    /// The current generation serves.
    Ready,
    /// The current generation serves while the next one is being prepared.
    Rebuilding,
    /// Generation 0 could not be prepared, or what was kept of the body could not be read; `error` says
    /// why.
    Failed,
    /// Kept on disk, not in memory. Whatever asks for the body has it restored first.
    Stored,
    /// The body is being made again from what is kept of it; requests wait for it.
    Restoring,
}

/// A session. Counts that a build has yet to find are 0, and lists empty, while `state` is
/// `building` or `failed`, and while the body is not in memory: `stored` or `restoring`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionInfo {
    /// The session's identifier.
    pub id: String,
    /// The name it was given.
    pub name: Option<String>,
    /// Whose it is, where the daemon asks for keys: what is published of it over Zenoh lies below
    /// `sutura/v1/tenants/{tenant}`.
    pub tenant: Option<String>,
    /// What it is doing.
    pub state: SessionState,
    /// The stage of the build or rebuild in progress.
    pub stage: Option<String>,
    /// How much of that stage is done, 0 to 1; 1 when nothing is in progress.
    pub progress: f64,
    /// The current generation.
    pub generation: u64,
    /// The oldest generation that is still kept, while the body is in memory.
    pub oldest_generation: Option<u64>,
    /// Vertices of the mesh.
    pub n_vertices: usize,
    /// Tets of the mesh.
    pub n_tets: usize,
    /// Distinct domain labels of the mesh.
    pub n_domains: usize,
    /// Connected pieces of the unstitched mesh.
    pub n_components: usize,
    /// Three times the number of vertices that may move.
    pub n_free_dofs: usize,
    /// Rigid motions that cost no energy, with the stitches in force.
    pub n_rigid_modes: usize,
    /// Elastic modes kept.
    pub n_modes: usize,
    /// Columns of the basis.
    pub basis_size: usize,
    /// Cubature points; `null` when every tet is summed.
    pub n_cubature_points: Option<usize>,
    /// Stitches in force.
    pub n_stitches: usize,
    /// Candidate pairs that are prepared: edits of them take no sparse solve.
    pub n_prepared_pairs: usize,
    /// Frequencies of the elastic modes in Hz, ascending.
    pub frequencies_hz: Vec<f64>,
    /// Bytes the session holds, parts shared with other sessions included.
    pub memory_bytes: u64,
    /// Time spent in each stage of the build or rebuild that made the current generation, in ms.
    pub timings_ms: BTreeMap<String, f64>,
    /// What the caller should know about the current generation, in words.
    pub warnings: Vec<String>,
    /// The parameters in force, defaults filled in; `null` while there is no generation.
    pub parameters: Option<SessionParameters>,
    /// Why the build failed.
    pub error: Option<Problem>,
}

/// Names candidate pairs, which are then prepared in the background.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SeamRequest {
    /// Pairs of co-located vertices (zero-based) that may be stitched later.
    pub pairs: Vec<[u32; 2]>,
}

impl SeamRequest {
    /// Refuses what no body could accept.
    pub fn validate(&self) -> Result<(), Invalid> {
        match self.pairs.len() {
            0 => Err(Invalid::new("/pairs", "must not be empty")),
            n if n > MAX_SEAM_PAIRS => {
                Err(Invalid::new("/pairs", format!("at most {MAX_SEAM_PAIRS} pairs")))
            }
            _ => Ok(()),
        }
    }
}

/// What a session has of candidate pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SeamReply {
    /// Pairs named, when the session was opened and since.
    pub n_pairs: usize,
    /// Those prepared so far, stitched ones included.
    pub n_prepared_pairs: usize,
}

/// The parameters a session was built with, every default filled in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionParameters {
    /// The material of each domain, by label.
    #[schema(value_type = BTreeMap<String, MaterialConfig>)] // names of members are text
    pub domain_materials: BTreeMap<i64, MaterialConfig>,
    /// How many vertices are fixed.
    pub n_fixed_vertices: usize,
    /// How mass is distributed.
    pub mass: MassConfig,
    /// Elastic modes asked for.
    pub n_modes: usize,
    /// The basis asked for.
    pub basis: BasisConfig,
    /// Cubature training; `null` if skipped.
    pub cubature: Option<CubatureConfig>,
    /// Rayleigh damping.
    pub damping: DampingConfig,
    /// How many candidate pairs are prepared ahead.
    pub n_seam_pairs: usize,
}

/// One page of sessions, in the order in which they were made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionList {
    /// The sessions of this page.
    pub sessions: Vec<SessionInfo>,
    /// Pass as `?after=` to get the next page; `null` on the last one.
    pub next: Option<String>,
}

/// How a fork differs from its origin. A request without a body differs in nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ForkRequest {
    /// The new session's name; without it, the origin's.
    pub name: Option<String>,
}

impl ForkRequest {
    /// Refuses names that no session may have.
    pub fn validate(&self) -> Result<(), Invalid> {
        check_name(self.name.as_deref())
    }
}
