//! What the demonstration works on: a mesh, how to prepare it, and the stitches to make.

use super::error::DemoError;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use sutura_client::proto::session::{MaterialConfig, SessionConfig};
use sutura_core::mesh::{MeshLimits, NamedFile, TetMesh, read_files};

/// The bundled body: a stomach with an incision. Source and licence stand in the file beside it.
const BUNDLED_MESH: &[u8] = include_bytes!("../../../tests/data/stomach_small.msh");
const BUNDLED_CASE: &str = include_str!("../../../tests/data/stomach_small.json");
const BUNDLED_FILE_NAME: &str = "stomach_small.msh";

/// The largest mesh that the demonstration draws.
const LIMITS: MeshLimits = MeshLimits { max_vertices: 2_000_000, max_tets: 8_000_000 };

/// Stiffness of every stitch of the user's own mesh, unless said otherwise.
pub(crate) const DEFAULT_STITCH_STIFFNESS_N_M: f64 = 1e5;

/// A body and what is to be done with it.
pub(crate) struct Case {
    pub(crate) name: String,
    /// Where the mesh comes from.
    pub(crate) source: String,
    pub(crate) file_name: String,
    /// The mesh file, to be uploaded as it is.
    pub(crate) file: Vec<u8>,
    /// The same mesh, to be drawn.
    pub(crate) mesh: TetMesh,
    pub(crate) config: SessionConfig,
    pub(crate) stitches: Vec<[u32; 2]>,
    pub(crate) stitch_stiffness_n_m: f64,
}

/// The part of the bundled case's description that is needed here.
#[derive(Deserialize)]
struct BundledCase {
    name: String,
    provenance: String,
    license: String,
    domain_materials: BTreeMap<i64, MaterialConfig>,
    fixed_vertices: Vec<u32>,
    stitches: Vec<[u32; 2]>,
    stitch_stiffness_n_m: f64,
}

impl Case {
    /// The bundled body.
    pub(crate) fn bundled() -> Result<Case, DemoError> {
        let input = |error| DemoError::json(Path::new("stomach_small.json"), &error);
        let bundled: BundledCase = serde_json::from_str(BUNDLED_CASE).map_err(input)?;
        // Everything that the description does not name is at the contract's default.
        let config = serde_json::json!({
            "name": bundled.name,
            "domain_materials": bundled.domain_materials,
            "fixed_vertices": bundled.fixed_vertices,
            "seams": bundled.stitches,
        });
        Ok(Case {
            mesh: parse(BUNDLED_FILE_NAME, BUNDLED_MESH)?,
            config: serde_json::from_value(config).map_err(input)?,
            name: bundled.name,
            source: format!("{}; {}", bundled.provenance, bundled.license),
            file_name: BUNDLED_FILE_NAME.to_owned(),
            file: BUNDLED_MESH.to_vec(),
            stitches: bundled.stitches,
            stitch_stiffness_n_m: bundled.stitch_stiffness_n_m,
        })
    }

    /// The user's own body: a mesh file, the session's configuration as in the wire contract
    /// (without `mesh`), and the stitches as `[[a, b], …]`.
    pub(crate) fn from_files(
        mesh: &Path,
        config: &Path,
        stitches: &Path,
        stitch_stiffness_n_m: f64,
    ) -> Result<Case, DemoError> {
        let file = read_file(mesh)?;
        let file_name = mesh.file_name().unwrap_or(mesh.as_os_str()).to_string_lossy().into_owned();
        let stem = mesh.file_stem().unwrap_or(mesh.as_os_str()).to_string_lossy().into_owned();
        let config_json = read_file(config)?;
        let config_value: SessionConfig = serde_json::from_slice(&config_json)
            .map_err(|error| DemoError::json(config, &error))?;
        let stitches_json = read_file(stitches)?;
        let pairs: Vec<[u32; 2]> = serde_json::from_slice(&stitches_json)
            .map_err(|error| DemoError::json(stitches, &error))?;
        if pairs.len() < 2 {
            let message = "two rounds need at least two stitches";
            return Err(DemoError::Input(format!("{}: {message}", stitches.display())));
        }
        let mesh_value = parse(&mesh.display().to_string(), &file)?;
        let n_vertices = mesh_value.vertices().len();
        let out_of_range = |pair: &[u32; 2]| pair.iter().any(|&v| v as usize >= n_vertices);
        if let Some(position) = pairs.iter().position(out_of_range) {
            return Err(DemoError::Input(format!(
                "{}: stitch {position} is {:?}, but the mesh has {n_vertices} vertices",
                stitches.display(),
                pairs[position]
            )));
        }
        Ok(Case {
            name: config_value.name.clone().unwrap_or(stem),
            source: mesh.display().to_string(),
            file_name,
            file,
            mesh: mesh_value,
            config: config_value,
            stitches: pairs,
            stitch_stiffness_n_m,
        })
    }

    /// The stitches of the first and of the second round.
    pub(crate) fn rounds(&self) -> [&[[u32; 2]]; 2] {
        let (first, second) = self.stitches.split_at(self.stitches.len() / 2);
        [first, second]
    }
}

fn read_file(path: &Path) -> Result<Vec<u8>, DemoError> {
    std::fs::read(path).map_err(|error| DemoError::Input(format!("{}: {error}", path.display())))
}

fn parse(name: &str, bytes: &[u8]) -> Result<TetMesh, DemoError> {
    let file = read_files(&[NamedFile { name: Some(name), bytes }], &LIMITS);
    Ok(file.map_err(|error| DemoError::Input(format!("{name}: {error}")))?.mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bundled_case_is_sound() {
        let case = Case::bundled().unwrap();
        case.config.validate().unwrap();
        let [first, second] = case.rounds();
        assert_eq!((first.len(), second.len()), (6, 6));
        let positions = case.mesh.vertices();
        assert!(
            case.stitches.iter().all(|[a, b]| positions[*a as usize] == positions[*b as usize])
        );
    }

    #[test]
    fn bad_files_are_named_with_the_place_at_fault() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let mesh = path(
            "tet.msh",
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n\
             $EndNodes\n$Elements\n1\n1 4 2 1 1 1 2 3 4\n$EndElements\n",
        );
        let config = path("config.json", "{\n  \"material\": 3\n}");
        let stitches = path("stitches.json", "[[0, 1], [0, 9]]");
        let read = |config: &Path| match Case::from_files(&mesh, config, &stitches, 1.0) {
            Ok(_) => panic!("accepted"),
            Err(error) => error.to_string(),
        };
        assert!(read(&config).contains("config.json: line 2"), "{}", read(&config));
        let config = path("good.json", "{}");
        assert!(read(&config).contains("stitch 1 is [0, 9]"), "{}", read(&config));
        assert!(read(&folder.path().join("absent.json")).contains("absent.json"));
    }
}
