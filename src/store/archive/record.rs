//! What is kept of a session, in types of its own: the core's may change, these may not without a new
//! version ([`super::frame`]). Written by bincode, little-endian, integers of fixed width.

use super::frame::Digest;
use super::generation::GenerationRecord;
use crate::simulation::{ContactConfig, SimulationConfig};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sutura_core::basis::PcaMethod;
use sutura_core::build::{BuildParams, CubatureParams, MassKind, RayleighDamping, Selection};
use sutura_core::material::{Law, Material};
use sutura_core::mesh::TetMesh;
use sutura_core::reduced::contact::Obstacle;
use sutura_core::reduced::{Integrator, SimulationParams};

/// Larger ones are refused before anything is allocated for them.
const MAX_BYTES: usize = 1 << 32;

fn configuration() -> impl bincode::config::Config {
    bincode::config::standard()
        .with_little_endian()
        .with_fixed_int_encoding()
        .with_limit::<MAX_BYTES>()
}

/// A record's contents.
pub(crate) fn encode(record: &impl Serialize) -> Result<Vec<u8>, Unreadable> {
    bincode::serde::encode_to_vec(record, configuration()).map_err(Unreadable::new)
}

/// A record from its contents.
pub(crate) fn decode<T: DeserializeOwned>(contents: &[u8]) -> Result<T, Unreadable> {
    let (record, n_bytes) =
        bincode::serde::decode_from_slice(contents, configuration()).map_err(Unreadable::new)?;
    match n_bytes == contents.len() {
        true => Ok(record),
        false => Err(Unreadable("bytes are left over".into())),
    }
}

/// The bytes are those that were written, but say nothing that this version understands.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Unreadable(String);

impl Unreadable {
    pub(crate) fn new(error: impl std::fmt::Display) -> Unreadable {
        Unreadable(error.to_string())
    }
}

/// One entry of a session's journal.
#[derive(Serialize, Deserialize)]
pub(crate) enum Record {
    /// Always the first.
    Session(Box<SessionRecord>),
    /// A generation beyond the first.
    Generation(Box<GenerationRecord>),
    /// Candidate pairs named since the session was opened.
    Seams(Vec<[u32; 2]>),
    /// How the session is simulated from now on, if it is.
    Simulation(Option<SimulationRecord>),
}

/// What a session began with.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct SessionRecord {
    pub(crate) name: String,
    pub(crate) tenant: Option<String>,
    pub(crate) mesh: Digest,
    pub(crate) size: SizeRecord,
    pub(crate) params: ParamsRecord,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
pub(crate) struct SizeRecord {
    pub(crate) n_vertices: u64,
    pub(crate) n_tets: u64,
    pub(crate) n_domains: u64,
    pub(crate) n_components: u64,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct MeshRecord {
    vertices: Vec<[f64; 3]>,
    tets: Vec<[u32; 4]>,
    labels: Vec<i64>,
}

impl MeshRecord {
    pub(crate) fn new(mesh: &TetMesh) -> MeshRecord {
        MeshRecord {
            vertices: mesh.vertices().to_vec(),
            tets: mesh.tets().to_vec(),
            labels: mesh.labels().to_vec(),
        }
    }

    pub(crate) fn mesh(self) -> Result<TetMesh, Unreadable> {
        TetMesh::new(self.vertices, self.tets, self.labels).map_err(Unreadable::new)
    }
}

#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct ParamsRecord {
    materials: Vec<MaterialRecord>,
    tet_stiffness: Vec<f64>,
    pub(super) fixed_vertices: Vec<u32>,
    mass: MassRecord,
    n_modes: u64,
    basis_size: u64,
    pca: PcaRecord,
    n_derivative_modes: u64,
    cubature: Option<CubatureRecord>,
    damping_mass_per_s: f64,
    damping_stiffness_s: f64,
    seams: Vec<[u32; 2]>,
}

#[derive(Clone, Serialize, Deserialize)]
struct MaterialRecord {
    law: LawRecord,
    young_modulus_pa: f64,
    poisson_ratio: f64,
    density_kg_m3: f64,
    mooney_ratio: f64,
}

#[derive(Clone, Serialize, Deserialize)]
enum LawRecord {
    Linear,
    StVenantKirchhoff,
    NeoHookean,
    MooneyRivlin,
    Corotational,
}

#[derive(Clone, Serialize, Deserialize)]
enum MassRecord {
    Lumped,
    Consistent,
}

#[derive(Clone, Serialize, Deserialize)]
enum PcaRecord {
    Snapshots,
    Randomized,
}

/// How points are chosen, and whether they are smoothed: what came first did not say so.
#[derive(Clone, Serialize, Deserialize)]
enum SelectionRecord {
    GreedyNnls,
    NnHtp,
    SparseNnls,
    EmpiricalCubature,
    SmoothedGreedyNnls,
    SmoothedNnHtp,
    SmoothedSparseNnls,
    SmoothedEmpiricalCubature,
}

#[derive(Clone, Serialize, Deserialize)]
struct CubatureRecord {
    n_points: u64,
    n_training_poses: u64,
    tolerance: f64,
    seed: u64,
    selection: SelectionRecord,
}

pub(super) fn size(n: u64) -> Result<usize, Unreadable> {
    usize::try_from(n).map_err(Unreadable::new)
}

impl ParamsRecord {
    pub(crate) fn new(params: &BuildParams) -> ParamsRecord {
        let BuildParams {
            materials,
            tet_stiffness,
            fixed_vertices,
            mass,
            n_modes,
            basis_size,
            pca,
            n_derivative_modes,
            cubature,
            damping: RayleighDamping { mass_per_s, stiffness_s },
            seams,
        } = params;
        ParamsRecord {
            materials: materials.iter().map(MaterialRecord::new).collect(),
            tet_stiffness: tet_stiffness.to_vec(),
            fixed_vertices: fixed_vertices.clone(),
            mass: match mass {
                MassKind::Lumped => MassRecord::Lumped,
                MassKind::Consistent => MassRecord::Consistent,
            },
            n_modes: *n_modes as u64,
            basis_size: *basis_size as u64,
            pca: match pca {
                PcaMethod::Snapshots => PcaRecord::Snapshots,
                PcaMethod::Randomized => PcaRecord::Randomized,
            },
            n_derivative_modes: *n_derivative_modes as u64,
            cubature: cubature.as_ref().map(CubatureRecord::new),
            damping_mass_per_s: *mass_per_s,
            damping_stiffness_s: *stiffness_s,
            seams: seams.clone(),
        }
    }

    pub(crate) fn params(&self) -> Result<BuildParams, Unreadable> {
        Ok(BuildParams {
            materials: self
                .materials
                .iter()
                .map(MaterialRecord::material)
                .collect::<Result<_, _>>()?,
            tet_stiffness: self.tet_stiffness.as_slice().into(),
            fixed_vertices: self.fixed_vertices.clone(),
            mass: match self.mass {
                MassRecord::Lumped => MassKind::Lumped,
                MassRecord::Consistent => MassKind::Consistent,
            },
            n_modes: size(self.n_modes)?,
            basis_size: size(self.basis_size)?,
            pca: match self.pca {
                PcaRecord::Snapshots => PcaMethod::Snapshots,
                PcaRecord::Randomized => PcaMethod::Randomized,
            },
            n_derivative_modes: size(self.n_derivative_modes)?,
            cubature: self.cubature.as_ref().map(CubatureRecord::params).transpose()?,
            damping: RayleighDamping {
                mass_per_s: self.damping_mass_per_s,
                stiffness_s: self.damping_stiffness_s,
            },
            seams: self.seams.clone(),
        })
    }
}

impl MaterialRecord {
    fn new(material: &Material) -> MaterialRecord {
        MaterialRecord {
            law: match material.law() {
                Law::Linear => LawRecord::Linear,
                Law::StVenantKirchhoff => LawRecord::StVenantKirchhoff,
                Law::NeoHookean => LawRecord::NeoHookean,
                Law::MooneyRivlin => LawRecord::MooneyRivlin,
                Law::Corotational => LawRecord::Corotational,
            },
            young_modulus_pa: material.young_modulus_pa(),
            poisson_ratio: material.poisson_ratio(),
            density_kg_m3: material.density_kg_m3(),
            mooney_ratio: material.mooney_ratio(),
        }
    }

    fn material(&self) -> Result<Material, Unreadable> {
        let law = match self.law {
            LawRecord::Linear => Law::Linear,
            LawRecord::StVenantKirchhoff => Law::StVenantKirchhoff,
            LawRecord::NeoHookean => Law::NeoHookean,
            LawRecord::MooneyRivlin => Law::MooneyRivlin,
            LawRecord::Corotational => Law::Corotational,
        };
        let MaterialRecord { young_modulus_pa, poisson_ratio, density_kg_m3, .. } = *self;
        Material::new(law, young_modulus_pa, poisson_ratio, density_kg_m3)
            .and_then(|material| material.with_mooney_ratio(self.mooney_ratio))
            .map_err(Unreadable::new)
    }
}

impl CubatureRecord {
    fn new(params: &CubatureParams) -> CubatureRecord {
        let CubatureParams { n_points, n_training_poses, tolerance, seed, selection, smoothing } =
            *params;
        CubatureRecord {
            n_points: n_points as u64,
            n_training_poses: n_training_poses as u64,
            tolerance,
            seed,
            selection: match (selection, smoothing) {
                (Selection::GreedyNnls, false) => SelectionRecord::GreedyNnls,
                (Selection::NnHtp, false) => SelectionRecord::NnHtp,
                (Selection::SparseNnls, false) => SelectionRecord::SparseNnls,
                (Selection::EmpiricalCubature, false) => SelectionRecord::EmpiricalCubature,
                (Selection::GreedyNnls, true) => SelectionRecord::SmoothedGreedyNnls,
                (Selection::NnHtp, true) => SelectionRecord::SmoothedNnHtp,
                (Selection::SparseNnls, true) => SelectionRecord::SmoothedSparseNnls,
                (Selection::EmpiricalCubature, true) => SelectionRecord::SmoothedEmpiricalCubature,
            },
        }
    }

    fn params(&self) -> Result<CubatureParams, Unreadable> {
        let (selection, smoothing) = match self.selection {
            SelectionRecord::GreedyNnls => (Selection::GreedyNnls, false),
            SelectionRecord::NnHtp => (Selection::NnHtp, false),
            SelectionRecord::SparseNnls => (Selection::SparseNnls, false),
            SelectionRecord::EmpiricalCubature => (Selection::EmpiricalCubature, false),
            SelectionRecord::SmoothedGreedyNnls => (Selection::GreedyNnls, true),
            SelectionRecord::SmoothedNnHtp => (Selection::NnHtp, true),
            SelectionRecord::SmoothedSparseNnls => (Selection::SparseNnls, true),
            SelectionRecord::SmoothedEmpiricalCubature => (Selection::EmpiricalCubature, true),
        };
        Ok(CubatureParams {
            n_points: size(self.n_points)?,
            n_training_poses: size(self.n_training_poses)?,
            tolerance: self.tolerance,
            seed: self.seed,
            selection,
            smoothing,
        })
    }
}

/// How a session is simulated.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct SimulationRecord {
    dt_s: f64,
    integrator: IntegratorRecord,
    gravity_m_s2: [f64; 3],
    obstacles: Vec<ObstacleRecord>,
    contact_stiffness_pa_m: Option<f64>,
    contact_damping_s_m: f64,
    contact_friction: f64,
    contact_creep_m_s: Option<f64>,
    publish_hz: f64,
    substep_tolerance: Option<f64>,
}

#[derive(Clone, Serialize, Deserialize)]
enum IntegratorRecord {
    ImplicitNewmark,
    BackwardEuler,
    ModalOscillators,
    QuasiStatic,
}

#[derive(Clone, Serialize, Deserialize)]
enum ObstacleRecord {
    Plane { point_m: [f64; 3], normal: [f64; 3] },
    Sphere { center_m: [f64; 3], radius_m: f64 },
    Capsule { from_m: [f64; 3], to_m: [f64; 3], radius_m: f64 },
}

impl ObstacleRecord {
    fn new(obstacle: &Obstacle) -> ObstacleRecord {
        match *obstacle {
            Obstacle::Plane { point_m, normal } => ObstacleRecord::Plane { point_m, normal },
            Obstacle::Sphere { center_m, radius_m } => {
                ObstacleRecord::Sphere { center_m, radius_m }
            }
            Obstacle::Capsule { from_m, to_m, radius_m } => {
                ObstacleRecord::Capsule { from_m, to_m, radius_m }
            }
        }
    }

    fn obstacle(&self) -> Obstacle {
        match *self {
            ObstacleRecord::Plane { point_m, normal } => Obstacle::Plane { point_m, normal },
            ObstacleRecord::Sphere { center_m, radius_m } => {
                Obstacle::Sphere { center_m, radius_m }
            }
            ObstacleRecord::Capsule { from_m, to_m, radius_m } => {
                Obstacle::Capsule { from_m, to_m, radius_m }
            }
        }
    }
}

impl SimulationRecord {
    pub(crate) fn new(config: &SimulationConfig) -> SimulationRecord {
        let SimulationConfig { params, obstacles, contact, publish_hz } = config;
        let SimulationParams { dt_s, integrator, gravity_m_s2, substep_tolerance } = *params;
        let ContactConfig { stiffness_pa_m, damping_s_m, friction, creep_m_s } = *contact;
        SimulationRecord {
            dt_s,
            integrator: match integrator {
                Integrator::ImplicitNewmark => IntegratorRecord::ImplicitNewmark,
                Integrator::BackwardEuler => IntegratorRecord::BackwardEuler,
                Integrator::ModalOscillators => IntegratorRecord::ModalOscillators,
                Integrator::QuasiStatic => IntegratorRecord::QuasiStatic,
            },
            gravity_m_s2,
            obstacles: obstacles.iter().map(ObstacleRecord::new).collect(),
            contact_stiffness_pa_m: stiffness_pa_m,
            contact_damping_s_m: damping_s_m,
            contact_friction: friction,
            contact_creep_m_s: creep_m_s,
            publish_hz: *publish_hz,
            substep_tolerance,
        }
    }

    pub(crate) fn config(&self) -> SimulationConfig {
        let integrator = match self.integrator {
            IntegratorRecord::ImplicitNewmark => Integrator::ImplicitNewmark,
            IntegratorRecord::BackwardEuler => Integrator::BackwardEuler,
            IntegratorRecord::ModalOscillators => Integrator::ModalOscillators,
            IntegratorRecord::QuasiStatic => Integrator::QuasiStatic,
        };
        let SimulationRecord { dt_s, gravity_m_s2, substep_tolerance, .. } = *self;
        SimulationConfig {
            params: SimulationParams { dt_s, integrator, gravity_m_s2, substep_tolerance },
            obstacles: self.obstacles.iter().map(ObstacleRecord::obstacle).collect(),
            contact: ContactConfig {
                stiffness_pa_m: self.contact_stiffness_pa_m,
                damping_s_m: self.contact_damping_s_m,
                friction: self.contact_friction,
                creep_m_s: self.contact_creep_m_s,
            },
            publish_hz: self.publish_hz,
        }
    }
}
