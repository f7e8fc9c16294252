//! Sessions: from a configuration and a mesh to what the store builds, and the description of what
//! it holds.

use super::document::parse_json;
use super::edit::stage_milliseconds;
use crate::problem::{self, Kind, Problem};
use bytes::Bytes;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use sutura_core::build::{
    BuildParams, CubatureParams, MassKind, PcaMethod, RayleighDamping, Selection,
};
use sutura_core::edit::{EditState, STIFFNESS_FACTOR_RANGE};
use sutura_core::material::{Law, Material};
use sutura_core::mesh::{MeshFile, MeshLimits, NamedFile, TetMesh, read_files};
use sutura_proto::session::{
    self as wire, BasisConfig, CubatureConfig, DampingConfig, MassConfig, MaterialConfig,
    MaterialLaw, MeshConfig, PcaConfig, SelectionConfig, SessionConfig,
};
use sutura_store::{CreateSession, SessionInfo, SessionState};

/// What a client sent to open a session.
#[derive(Debug)]
pub(crate) struct Upload {
    /// The configuration, as JSON.
    pub(crate) config: Bytes,
    /// The mesh's file, or the two of TetGen's format; none if the configuration holds the mesh.
    pub(crate) files: Vec<UploadedFile>,
}

/// An uploaded mesh file.
#[derive(Debug)]
pub(crate) struct UploadedFile {
    pub(crate) name: Option<String>,
    pub(crate) bytes: Bytes,
}

/// A session's name if its client gave none.
pub const UNNAMED: &str = "unnamed";

/// Parses and checks an upload. Takes as long as its bytes are many: for the query pool.
pub(crate) fn create(upload: Upload, limits: &MeshLimits) -> Result<CreateSession, Problem> {
    let mut config: SessionConfig = parse_json(&upload.config)?;
    config.validate()?;
    let MeshFile { mesh, materials } = match (config.mesh.take(), &upload.files[..]) {
        (Some(mesh), []) => inline_mesh(mesh, limits)?,
        (None, files @ [_, ..]) => read(files, limits)?,
        (Some(_), [_, ..]) => {
            let detail = "the mesh is given twice, inline and as a file";
            return Err(Problem::new(Kind::MalformedDocument, detail).at("/mesh"));
        }
        (None, []) => {
            let detail = "there is no mesh: give \"mesh\" inline, or a file as multipart/form-data";
            return Err(Problem::new(Kind::MalformedDocument, detail).at("/mesh"));
        }
    };
    let mesh = Arc::new(mesh);
    let params = build_params(&config, &mesh, &materials)?;
    let name = config.name.unwrap_or_else(|| UNNAMED.to_owned());
    Ok(CreateSession { name, tenant: None, mesh, params })
}

fn inline_mesh(mesh: MeshConfig, limits: &MeshLimits) -> Result<MeshFile, Problem> {
    let counts = [
        ("vertices", mesh.vertices.len(), limits.max_vertices),
        ("tets", mesh.tets.len(), limits.max_tets),
    ];
    for (what, count, limit) in counts {
        if count > limit {
            let detail = format!("the mesh has {count} {what}, at most {limit} are accepted");
            return Err(Problem::new(Kind::TooLarge, detail).at(format!("/mesh/{what}")));
        }
    }
    let mesh =
        TetMesh::new(mesh.vertices, mesh.tets, mesh.domains).map_err(problem::of_inline_mesh)?;
    Ok(MeshFile { mesh, materials: BTreeMap::new() })
}

fn read(files: &[UploadedFile], limits: &MeshLimits) -> Result<MeshFile, Problem> {
    let files: Vec<NamedFile<'_>> = files
        .iter()
        .map(|UploadedFile { name, bytes }| NamedFile { name: name.as_deref(), bytes })
        .collect();
    Ok(read_files(&files, limits)?)
}

/// Resolves the configuration against the mesh. Materials that a mesh file carries serve the
/// domains that the configuration says nothing about.
fn build_params(
    config: &SessionConfig,
    mesh: &Arc<TetMesh>,
    file_materials: &BTreeMap<i64, Material>,
) -> Result<BuildParams, Problem> {
    let impossible = |detail: String| Problem::new(Kind::ImpossibleConfiguration, detail);
    if let Some(label) = config.domain_materials.keys().find(|l| !mesh.domains().contains(l)) {
        return Err(impossible(format!("the mesh has no domain {label}"))
            .at(format!("/domain_materials/{label}")));
    }
    let n_vertices = mesh.vertices().len();
    if let Some(i) = config.fixed_vertices.iter().position(|&v| v as usize >= n_vertices) {
        let vertex = config.fixed_vertices[i];
        let detail = format!("vertex {vertex} is out of range, the mesh has {n_vertices} vertices");
        return Err(impossible(detail).at(format!("/fixed_vertices/{i}")));
    }
    check_seams(config, mesh)?;
    let material_of = |label: &i64| {
        let given = config.domain_materials.get(label).or(config.material.as_ref());
        match (given, file_materials.get(label)) {
            (Some(given), _) => material(given, label, config),
            (None, Some(material)) => Ok(*material),
            (None, None) => Err(impossible(format!("domain {label} has no material"))
                .at(format!("/domain_materials/{label}"))),
        }
    };
    Ok(BuildParams {
        materials: mesh.domains().iter().map(material_of).collect::<Result<_, _>>()?,
        tet_stiffness: tet_stiffness(config, mesh)?,
        fixed_vertices: config.fixed_vertices.clone(),
        mass: match config.mass {
            MassConfig::Lumped => MassKind::Lumped,
            MassConfig::Consistent => MassKind::Consistent,
        },
        n_modes: config.n_modes,
        basis_size: config.basis.size,
        pca: match config.basis.pca {
            PcaConfig::Snapshots => PcaMethod::Snapshots,
            PcaConfig::Randomized => PcaMethod::Randomized,
        },
        n_derivative_modes: config.basis.n_derivative_modes,
        cubature: config.cubature.as_ref().map(|cubature| CubatureParams {
            n_points: cubature.n_points,
            n_training_poses: cubature.n_training_poses,
            tolerance: cubature.tolerance,
            seed: cubature.seed,
            selection: match cubature.selection {
                SelectionConfig::GreedyNnls => Selection::GreedyNnls,
                SelectionConfig::NnHtp => Selection::NnHtp,
                SelectionConfig::SparseNnls => Selection::SparseNnls,
                SelectionConfig::EmpiricalCubature => Selection::EmpiricalCubature,
            },
            smoothing: cubature.smoothing,
        }),
        damping: RayleighDamping {
            mass_per_s: config.damping.rayleigh_mass_per_s,
            stiffness_s: config.damping.rayleigh_stiffness_s,
        },
        seams: config.seams.clone(),
    })
}

/// Refuses candidate pairs that could never be stitched: here, because the build would find out
/// only after this request has been answered.
fn check_seams(config: &SessionConfig, mesh: &Arc<TetMesh>) -> Result<(), Problem> {
    // A pair named twice is prepared once.
    let mut seen = BTreeSet::new();
    let is_new = |(_, [a, b]): &(usize, [u32; 2])| seen.insert([*a.min(b), *a.max(b)]);
    let (positions, pairs): (Vec<usize>, Vec<[u32; 2]>) =
        config.seams.iter().copied().enumerate().filter(is_new).unzip();
    EditState::new(mesh.clone(), &config.fixed_vertices)
        .check_pairs(&pairs)
        .map_err(|error| problem::of_seam(&error, &positions))
}

fn material(
    given: &MaterialConfig,
    label: &i64,
    config: &SessionConfig,
) -> Result<Material, Problem> {
    let law = match given.law {
        MaterialLaw::Linear => Law::Linear,
        MaterialLaw::Stvk => Law::StVenantKirchhoff,
        MaterialLaw::NeoHookean => Law::NeoHookean,
        MaterialLaw::MooneyRivlin => Law::MooneyRivlin,
        MaterialLaw::Corotational => Law::Corotational,
    };
    let MaterialConfig { young_modulus_pa, poisson_ratio, density_kg_m3, .. } = *given;
    Material::new(law, young_modulus_pa, poisson_ratio, density_kg_m3)
        .and_then(|material| match given.mooney_ratio {
            Some(ratio) => material.with_mooney_ratio(ratio),
            None => Ok(material),
        })
        .map_err(|error| {
            let pointer = match config.domain_materials.get(label) {
                Some(_) => format!("/domain_materials/{label}"),
                None => "/material".to_owned(),
            };
            Problem::new(Kind::ImpossibleConfiguration, error.to_string()).at(pointer)
        })
}

fn wire_law(law: Law) -> MaterialLaw {
    match law {
        Law::Linear => MaterialLaw::Linear,
        Law::StVenantKirchhoff => MaterialLaw::Stvk,
        Law::NeoHookean => MaterialLaw::NeoHookean,
        Law::MooneyRivlin => MaterialLaw::MooneyRivlin,
        Law::Corotational => MaterialLaw::Corotational,
    }
}

/// One factor for each tet, if there are any.
fn tet_stiffness(config: &SessionConfig, mesh: &TetMesh) -> Result<Arc<[f64]>, Problem> {
    let impossible = |detail: String, pointer: String| {
        Err(Problem::new(Kind::ImpossibleConfiguration, detail).at(pointer))
    };
    let (given, n_tets) = (&config.tet_stiffness, mesh.tets().len());
    if !given.is_empty() && given.len() != n_tets {
        let detail = format!("{} entries for {n_tets} tets", given.len());
        return impossible(detail, "/tet_stiffness".to_owned());
    }
    let [low, high] = STIFFNESS_FACTOR_RANGE;
    if let Some(tet) = given.iter().position(|factor| !(low..=high).contains(factor)) {
        let detail = format!("must be between {low:e} and {high:e}, not {:e}", given[tet]);
        return impossible(detail, format!("/tet_stiffness/{tet}"));
    }
    Ok(given.as_slice().into())
}

/// The session as clients see it.
pub(crate) fn info(info: &SessionInfo) -> wire::SessionInfo {
    let size = &info.size;
    let artifacts = info.generation.as_deref().map(|generation| &*generation.artifacts);
    wire::SessionInfo {
        id: info.id.to_string(),
        name: Some(info.name.clone()),
        tenant: info.tenant.clone(),
        state: state(info.state),
        stage: info.progress.map(|progress| progress.stage.name().to_owned()),
        progress: info.progress.map_or(1.0, |progress| progress.fraction),
        generation: info.generation_number,
        oldest_generation: info.oldest_generation,
        n_vertices: size.n_vertices,
        n_tets: size.n_tets,
        n_domains: size.n_domains,
        n_components: size.n_components,
        n_free_dofs: artifacts.map_or(0, |a| a.n_free_dofs()),
        n_rigid_modes: artifacts.map_or(0, |a| a.n_rigid_modes()),
        n_modes: artifacts.map_or(0, |a| a.n_modes()),
        basis_size: artifacts.map_or(0, |a| a.basis_size()),
        n_cubature_points: artifacts.and_then(|a| a.cubature()).map(|c| c.n_points),
        n_stitches: artifacts.map_or(0, |a| a.stitches().len()),
        n_prepared_pairs: artifacts.map_or(0, |a| a.n_prepared_pairs()),
        frequencies_hz: artifacts.map(|a| a.frequencies_hz()).unwrap_or_default(),
        memory_bytes: artifacts.map_or(0, |a| a.memory_bytes() as u64),
        timings_ms: artifacts.map(|a| stage_milliseconds(a.timings())).unwrap_or_default(),
        warnings: artifacts.map(|a| a.warnings().to_vec()).unwrap_or_default(),
        parameters: artifacts.map(|a| parameters(a.params(), a.fixed_vertices().len(), a.mesh())),
        error: info.error.as_deref().map(|error| problem::of_build(error).to_document()),
    }
}

/// What a session is doing.
pub(crate) fn state(state: SessionState) -> wire::SessionState {
    match state {
        SessionState::Stored => wire::SessionState::Stored,
        SessionState::Restoring => wire::SessionState::Restoring,
        SessionState::Building => wire::SessionState::Building,
        SessionState::Ready => wire::SessionState::Ready,
        SessionState::Rebuilding => wire::SessionState::Rebuilding,
        SessionState::Failed => wire::SessionState::Failed,
    }
}

fn parameters(
    params: &BuildParams,
    n_fixed_vertices: usize,
    mesh: &TetMesh,
) -> wire::SessionParameters {
    let material = |material: &Material| MaterialConfig {
        law: wire_law(material.law()),
        young_modulus_pa: material.young_modulus_pa(),
        poisson_ratio: material.poisson_ratio(),
        density_kg_m3: material.density_kg_m3(),
        mooney_ratio: (material.law() == Law::MooneyRivlin).then(|| material.mooney_ratio()),
    };
    wire::SessionParameters {
        domain_materials: mesh
            .domains()
            .iter()
            .copied()
            .zip(params.materials.iter().map(material))
            .collect(),
        n_fixed_vertices,
        mass: match params.mass {
            MassKind::Lumped => MassConfig::Lumped,
            MassKind::Consistent => MassConfig::Consistent,
        },
        n_modes: params.n_modes,
        basis: BasisConfig {
            size: params.basis_size,
            n_derivative_modes: params.n_derivative_modes,
            pca: match params.pca {
                PcaMethod::Snapshots => PcaConfig::Snapshots,
                PcaMethod::Randomized => PcaConfig::Randomized,
            },
        },
        cubature: params.cubature.map(|cubature| CubatureConfig {
            n_points: cubature.n_points,
            n_training_poses: cubature.n_training_poses,
            tolerance: cubature.tolerance,
            seed: cubature.seed,
            selection: match cubature.selection {
                Selection::GreedyNnls => SelectionConfig::GreedyNnls,
                Selection::NnHtp => SelectionConfig::NnHtp,
                Selection::SparseNnls => SelectionConfig::SparseNnls,
                Selection::EmpiricalCubature => SelectionConfig::EmpiricalCubature,
            },
            smoothing: cubature.smoothing,
        }),
        damping: DampingConfig {
            rayleigh_mass_per_s: params.damping.mass_per_s,
            rayleigh_stiffness_s: params.damping.stiffness_s,
        },
        n_seam_pairs: params.seams.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: MeshLimits = MeshLimits { max_vertices: 100, max_tets: 100 };

    fn config(change: impl FnOnce(&mut serde_json::Value)) -> serde_json::Value {
        let mut config = serde_json::json!({
            "material": {"law": "stvk", "young_modulus_pa": 5e5, "poisson_ratio": 0.4,
                         "density_kg_m3": 1000},
            "mesh": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
                     "tets": [[0, 1, 2, 3]], "domains": [7]},
        });
        change(&mut config);
        config
    }

    fn created(
        config: &serde_json::Value,
        file: Option<UploadedFile>,
    ) -> Result<CreateSession, Problem> {
        let files = file.into_iter().collect();
        create(Upload { config: config.to_string().into(), files }, &LIMITS)
    }

    #[test]
    fn defaults_are_resolved_and_shown_again() {
        let request = created(&config(|_| {}), None).unwrap();
        assert_eq!(request.params.n_modes, 30);
        assert_eq!(request.params.mass, MassKind::Lumped);
        let shown = parameters(&request.params, 0, &request.mesh);
        assert_eq!(shown.basis, BasisConfig::default());
        assert_eq!(shown.cubature, Some(CubatureConfig::default()));
        assert_eq!(shown.damping, DampingConfig::default());
        assert_eq!(shown.domain_materials[&7].young_modulus_pa, 5e5);
    }

    #[test]
    fn methods_are_chosen_by_name_and_shown_again() {
        let pca = [("snapshots", PcaMethod::Snapshots), ("randomized", PcaMethod::Randomized)];
        for (name, method) in pca {
            let config = config(|c| c["basis"] = serde_json::json!({"pca": name}));
            let request = created(&config, None).unwrap();
            assert_eq!(request.params.pca, method);
            let shown = parameters(&request.params, 0, &request.mesh);
            assert_eq!(serde_json::to_value(shown.basis.pca).unwrap(), name);
        }
        let selections = [
            ("greedy_nnls", Selection::GreedyNnls),
            ("nn_htp", Selection::NnHtp),
            ("sparse_nnls", Selection::SparseNnls),
            ("empirical_cubature", Selection::EmpiricalCubature),
        ];
        for (name, method) in selections {
            let config = config(|c| c["cubature"] = serde_json::json!({"selection": name}));
            let request = created(&config, None).unwrap();
            assert_eq!(request.params.cubature.unwrap().selection, method);
            let shown = parameters(&request.params, 0, &request.mesh);
            assert_eq!(serde_json::to_value(shown.cubature.unwrap().selection).unwrap(), name);
        }
        for smoothing in [true, false] {
            let config = config(|c| c["cubature"] = serde_json::json!({"smoothing": smoothing}));
            let request = created(&config, None).unwrap();
            assert_eq!(request.params.cubature.unwrap().smoothing, smoothing);
            let shown = parameters(&request.params, 0, &request.mesh);
            assert_eq!(shown.cubature.unwrap().smoothing, smoothing);
        }
        let unknown = config(|c| c["cubature"] = serde_json::json!({"selection": "best"}));
        assert_eq!(created(&unknown, None).unwrap_err().pointer.unwrap(), "/cubature/selection");
    }

    #[test]
    fn a_domain_s_own_material_comes_first() {
        let request = created(
            &config(|c| {
                c["domain_materials"] = serde_json::json!({"7": {"law": "stvk",
                    "young_modulus_pa": 1e6, "poisson_ratio": 0.3, "density_kg_m3": 900}});
            }),
            None,
        );
        assert_eq!(request.unwrap().params.materials[0].young_modulus_pa(), 1e6);
    }

    #[test]
    fn faults_are_pointed_at() {
        let cases: [(&str, serde_json::Value, u16, &str); 8] = [
            ("/mesh/tets/0/3", 9.into(), 422, "/mesh/tets/0/3"),
            ("/mesh/tets/0", serde_json::json!([1, 0, 2, 3]), 422, "/mesh/tets/0"),
            ("/mesh/vertices/3/2", 1e-300.into(), 422, "/mesh/tets/0"),
            ("/mesh/domains", serde_json::json!([1, 2]), 422, "/mesh/domains"),
            ("/mesh/tets/0/0", (-1).into(), 400, "/mesh/tets/0/0"),
            ("/material/poisson_ratio", 0.5.into(), 422, "/material/poisson_ratio"),
            ("/mesh/vertices/1", serde_json::json!([1, 2]), 400, "/mesh/vertices/1"),
            ("/mesh/vertices/1/0", serde_json::Value::Null, 400, "/mesh/vertices/1/0"),
        ];
        for (place, value, status, pointer) in cases {
            let document = config(|c| *c.pointer_mut(place).unwrap() = value.clone());
            let problem = created(&document, None).unwrap_err();
            let found = (problem.status(), problem.pointer.as_deref());
            assert_eq!(found, (status, Some(pointer)), "{place} = {value}: {}", problem.detail);
        }
    }

    #[test]
    fn indices_and_domains_are_checked_against_the_mesh() {
        let cases = [
            ("fixed_vertices", serde_json::json!([0, 4]), "/fixed_vertices/1"),
            ("seams", serde_json::json!([[0, 0]]), "/seams/0"),
            ("seams", serde_json::json!([[0, 1]]), "/seams/0"),
            ("seams", serde_json::json!([[0, 9]]), "/seams/0"),
            (
                "domain_materials",
                serde_json::json!({"8": {"law": "stvk", "young_modulus_pa": 1e6,
                    "poisson_ratio": 0.3, "density_kg_m3": 900}}),
                "/domain_materials/8",
            ),
        ];
        for (member, value, pointer) in cases {
            let problem = created(&config(|c| c[member] = value.clone()), None).unwrap_err();
            let found = (problem.status(), problem.pointer.as_deref());
            assert_eq!(found, (422, Some(pointer)), "{}", problem.detail);
        }
    }

    #[test]
    fn unknown_members_and_missing_or_doubled_meshes_are_refused() {
        let problem = created(&config(|c| c["n_mode"] = 3.into()), None).unwrap_err();
        assert_eq!(problem.status(), 400);
        assert!(problem.detail.contains("n_mode"), "{}", problem.detail);

        let without = config(|c| drop(c.as_object_mut().unwrap().remove("mesh")));
        assert_eq!(created(&without, None).unwrap_err().status(), 400);

        let file = UploadedFile { name: None, bytes: Bytes::from_static(b"$MeshFormat") };
        assert_eq!(created(&config(|_| {}), Some(file)).unwrap_err().status(), 400);
    }

    #[test]
    fn meshes_over_the_limit_and_files_of_no_known_format_are_refused() {
        let vertices: Vec<[f64; 3]> = (0..101).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        let large = config(|c| c["mesh"]["vertices"] = serde_json::json!(vertices));
        let problem = created(&large, None).unwrap_err();
        assert_eq!((problem.status(), problem.pointer.as_deref()), (413, Some("/mesh/vertices")));

        let without = config(|c| drop(c.as_object_mut().unwrap().remove("mesh")));
        let file = UploadedFile { name: Some("a.png".into()), bytes: Bytes::from_static(b"\x89P") };
        assert_eq!(created(&without, Some(file)).unwrap_err().status(), 415);
        let file = UploadedFile { name: Some("a.msh".into()), bytes: Bytes::from_static(b"\x89P") };
        assert_eq!(created(&without, Some(file)).unwrap_err().status(), 400);
    }
}
