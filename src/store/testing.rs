//! Doors for tests of other crates (feature `testing`): the readers of what is kept, and the checks that need
//! no body.

use crate::archive::{frame, read, record, snapshot};
use crate::check;
use crate::config::Limits;
use crate::error::StoreError;
use crate::session::{CreateSession, EditRequest};
use crate::simulation::{GrabConfig, SimulationConfig, VertexForce};
use std::sync::{Arc, OnceLock};
use sutura_core::build::{
    Artifacts, BuildParams, CubatureParams, MassKind, PcaMethod, RayleighDamping, Selection, build,
    revive, revive_base,
};
use sutura_core::control::Uncontrolled;
use sutura_core::material::Material;
use sutura_core::mesh::TetMesh;

/// A record as it is kept, with its checksum.
pub fn framed(contents: &[u8]) -> Vec<u8> {
    frame::frame(contents)
}

/// Reads a journal as a start does, and what a restoration takes from it. Returns the number of generations.
pub fn read_journal(bytes: &[u8]) -> Option<usize> {
    let contents = read("journal", &frame::frames(bytes)).ok()?;
    contents.session.params.params().ok()?;
    let tet = Arc::new(one_tet()?);
    for generation in &contents.generations {
        // The recipe of another mesh is refused, not trusted.
        let _ = generation.recipe.recipe(tet.clone());
    }
    Some(contents.generations.len())
}

/// Reads a mesh's record. Returns the number of tets.
pub fn read_mesh(contents: &[u8]) -> Option<usize> {
    let mesh = record::decode::<record::MeshRecord>(contents).ok()?.mesh().ok()?;
    Some(mesh.tets().len())
}

/// Reads a kept base body (`is_base`) or generation as a restoration of a small body does, its checksums right,
/// whatever its `parts` say, and revives it. Returns how many numbers its basis or its modes hold, which are all
/// finite.
pub fn revive_body(is_base: bool, parts: &[&[u8]]) -> Option<usize> {
    static SMALL: OnceLock<Option<Artifacts>> = OnceLock::new();
    let small = SMALL.get_or_init(small_body).as_ref()?;
    let mut bytes = Vec::new();
    parts.iter().for_each(|part| frame::add_frame(&mut bytes, part));
    let recipe = small.recipe();
    if is_base {
        let kept = snapshot::decode_base(&SMALL_NAME, &bytes).ok()?;
        let params = small.params();
        let base = revive_base(params, recipe.state.base(), &kept, &Uncontrolled).ok()?;
        return numbers(&base.snapshot().modes.values);
    }
    let kept = snapshot::decode_generation(&SMALL_NAME, &bytes).ok()?;
    let body = revive(&recipe, &small.base_body(), &kept, &[], &Uncontrolled).ok()?;
    let _ = (body.evaluator_tables(), body.certificate(), body.basis_combination());
    numbers(&body.snapshot().basis.values)
}

/// What [`revive_body`] takes for the small body as it was built: the parts of its base body, or of itself.
pub fn small_body_parts(is_base: bool) -> Option<Vec<Vec<u8>>> {
    let small = small_body()?;
    let bytes = match is_base {
        true => snapshot::encode_base(&SMALL_NAME, &small.base_body().snapshot()),
        false => snapshot::encode_generation(&SMALL_NAME, &small.snapshot()),
    };
    let parts = frame::sequence(bytes.as_ref().ok()?)?.into_iter().map(<[u8]>::to_vec).collect();
    Some(parts)
}

/// Under which the small body is kept.
const SMALL_NAME: frame::Digest = [0; 32];

fn numbers(values: &[f64]) -> Option<usize> {
    assert!(values.iter().all(|x| x.is_finite()));
    Some(values.len())
}

/// Two tets that share a face, one corner held.
fn small_body() -> Option<Artifacts> {
    let mut vertices = one_tet()?.vertices().to_vec();
    vertices.push([1.0; 3]);
    let mesh = TetMesh::new(vertices, vec![[0, 1, 2, 3], [1, 2, 3, 4]], Vec::new()).ok()?;
    let params = BuildParams {
        materials: vec![Material::stvk(1e5, 0.3, 1000.0).ok()?],
        tet_stiffness: [].into(),
        fixed_vertices: vec![0, 1, 2],
        mass: MassKind::Lumped,
        n_modes: 2,
        basis_size: 3,
        pca: PcaMethod::Snapshots,
        n_derivative_modes: 1,
        cubature: Some(CubatureParams {
            n_points: 2,
            n_training_poses: 4,
            tolerance: 0.05,
            seed: 1,
            selection: Selection::default(),
            smoothing: true,
        }),
        damping: RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 },
        seams: Vec::new(),
    };
    build(Arc::new(mesh), &params, &Uncontrolled).ok()
}

fn one_tet() -> Option<TetMesh> {
    let vertices = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    TetMesh::new(vertices, vec![[0, 1, 2, 3]], vec![0]).ok()
}

/// What the store asks of a session before it builds it.
pub fn check_create(request: &CreateSession) -> Result<(), StoreError> {
    check::create(request, &Limits::default())
}

/// What it asks of an edit before a body is at hand.
pub fn check_edit(request: &EditRequest) -> Result<(), StoreError> {
    let limits = Limits::default();
    check::edit(request, &limits)?;
    check::n_stitches(0, &request.edits, &limits)
}

/// What it asks of poses for a basis of `r` columns.
pub fn check_poses(poses: &[Vec<f64>], r: usize) -> Result<(), StoreError> {
    check::poses(poses, r, &Limits::default())
}

/// What it asks of a simulation.
pub fn check_simulation(config: &SimulationConfig) -> Result<(), StoreError> {
    check::simulation(config, &Limits::default())
}

/// What it asks of forces on a body of `n_vertices`.
pub fn check_forces(forces: &[VertexForce], n_vertices: usize) -> Result<(), StoreError> {
    check::forces(forces, n_vertices, &Limits::default())
}

/// What it asks of grabs, some of which are to be released.
pub fn check_grabs(
    grabs: &[GrabConfig],
    n_released: usize,
    n_vertices: usize,
) -> Result<(), StoreError> {
    check::grabs(grabs, n_released, n_vertices, &Limits::default())
}
