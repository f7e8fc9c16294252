//! The bodies that are measured: a Gmsh mesh with a JSON file of supports, materials and pairs.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sutura_core::build::{BuildParams, CubatureParams, MassKind, RayleighDamping, Selection};
use sutura_core::edit::Edit;
use sutura_core::material::Material;
use sutura_core::mesh::{self, MeshFormat, MeshLimits, TetMesh};

/// Any failure of a program that measures; it ends with a message.
pub(crate) type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Stitch stiffness where the file names none, in N/m (\[M16\] §6).
const STITCH_STIFFNESS_N_M: f64 = 1e5;

/// A body with what is done to it.
pub(crate) struct Body {
    /// Name of its files.
    pub(crate) name: String,
    /// The mesh.
    pub(crate) mesh: Arc<TetMesh>,
    /// One material a domain.
    pub(crate) materials: Vec<Material>,
    /// Vertices that never move.
    pub(crate) fixed: Vec<u32>,
    /// The stitches of \[M16\] Table 1.
    pub(crate) stitches: Vec<[u32; 2]>,
    /// Every pair that may be stitched.
    pub(crate) all_pairs: Vec<[u32; 2]>,
    /// Stiffness of a stitch in N/m.
    pub(crate) stiffness_n_m: f64,
}

/// The repository's own bodies.
pub(crate) fn default_directory() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../data")
}

impl Body {
    /// Reads `NAME.msh` and `NAME.json` of `directory`.
    pub(crate) fn load(directory: &Path, name: &str) -> Result<Body, Failure> {
        let read = |extension: &str| {
            let path = directory.join(format!("{name}.{extension}"));
            std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))
        };
        let limits = MeshLimits { max_vertices: 10_000_000, max_tets: 100_000_000 };
        let mesh = mesh::read(&read("msh")?, MeshFormat::Gmsh, &limits)?.mesh;
        let config: Value = serde_json::from_slice(&read("json")?)?;
        let materials = mesh
            .domains()
            .iter()
            .map(|&label| material(&config, label))
            .collect::<Result<_, _>>()?;
        let list = |names: [&str; 2]| {
            names.iter().find_map(|name| config.get(name)).cloned().unwrap_or(Value::Null)
        };
        Ok(Body {
            name: name.into(),
            mesh: Arc::new(mesh),
            materials,
            fixed: serde_json::from_value(list(["fixed_vertices", "fixed"]))?,
            stitches: serde_json::from_value(list(["stitches", "stitches"]))?,
            all_pairs: serde_json::from_value(list(["all_pairs", "all_pairs"]))?,
            stiffness_n_m: config["stitch_stiffness_n_m"].as_f64().unwrap_or(STITCH_STIFFNESS_N_M),
        })
    }

    /// An ordinary session: 30 modes, the 36 derivatives of 8 of them, a basis of 60 columns, 120
    /// cubature points fitted to 100 poses; `seams` prepared ahead.
    pub(crate) fn session(&self, seams: &[[u32; 2]]) -> BuildParams {
        BuildParams {
            materials: self.materials.clone(),
            tet_stiffness: [].into(),
            fixed_vertices: self.fixed.clone(),
            mass: MassKind::Lumped,
            n_modes: 30,
            basis_size: 60,
            pca: Default::default(),
            n_derivative_modes: 8,
            cubature: Some(CubatureParams {
                n_points: 120,
                n_training_poses: 100,
                tolerance: 0.05,
                seed: 1,
                selection: Selection::default(),
                smoothing: true,
            }),
            damping: RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 },
            seams: seams.to_vec(),
        }
    }

    /// Stitches on `pairs`.
    pub(crate) fn stitch(&self, pairs: &[[u32; 2]]) -> Vec<Edit> {
        vec![Edit::Stitch { pairs: pairs.to_vec(), stiffness_n_m: self.stiffness_n_m }]
    }

    /// Up to `count` pairs: the body's stitches, then further ones.
    pub(crate) fn pairs(&self, count: usize) -> Vec<[u32; 2]> {
        let further = self.all_pairs.iter().filter(|pair| !self.stitches.contains(pair));
        self.stitches.iter().chain(further).copied().take(count).collect()
    }
}

/// The material of a domain: by its label (`domain_materials`), or by its place
/// (`suggested_materials`, labels from one).
fn material(config: &Value, label: i64) -> Result<Material, Failure> {
    let number = |entry: &Value, names: [&str; 2]| {
        let found = names.iter().find_map(|name| entry[name].as_f64());
        found.ok_or_else(|| format!("domain {label}: no {}", names[0]))
    };
    let mut entry = &config["domain_materials"][label.to_string()];
    if entry.is_null() {
        entry = &config["suggested_materials"][usize::try_from(label - 1)?];
    }
    Ok(Material::stvk(
        number(entry, ["young_modulus_pa", "young_Pa"])?,
        number(entry, ["poisson_ratio", "poisson"])?,
        number(entry, ["density_kg_m3", "density"])?,
    )?)
}
