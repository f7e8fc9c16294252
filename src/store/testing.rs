//! Doors for tests of other crates (feature `testing`): the readers of what is kept, and the checks that need
//! no body.

use crate::archive::{frame, read, record};
use crate::check;
use crate::config::Limits;
use crate::error::StoreError;
use crate::session::{CreateSession, EditRequest};
use crate::simulation::{GrabConfig, SimulationConfig, VertexForce};
use std::sync::Arc;
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
