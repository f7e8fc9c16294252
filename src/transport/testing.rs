//! Doors for tests of other crates (feature `testing`): what happens to a body from outside before it meets a
//! session.

use crate::conversion::document::{parse_bincode, parse_json};
use crate::conversion::session::Upload;
use crate::conversion::{edit, evaluate, session, simulation};
use crate::problem::Problem;
use bytes::Bytes;
use serde::de::DeserializeOwned;
use sutura_core::mesh::MeshLimits;
use sutura_proto::edit::EditRequest;
use sutura_proto::evaluate::EvaluateRequest;
use sutura_proto::session::{ForkRequest, SeamRequest};
use sutura_proto::simulation::{ForceRequest, GrabRequest, SimulationConfig};
use sutura_store::testing as store;

/// Bodies, as far as checks of vertices and poses go.
const N_VERTICES: usize = 1000;
const BASIS_SIZE: usize = 4;

/// Takes a JSON body of the kind that `kind` stands for, up to the store. Says whether it was accepted.
pub fn take_json(kind: u8, bytes: &[u8]) -> bool {
    taken(match kind % 8 {
        0 => open(bytes),
        1 => parse_json(bytes).and_then(fork),
        2 => parse_json(bytes).and_then(evaluated),
        3 => parse_json(bytes).and_then(simulated),
        kind => in_either_form(kind, bytes, Json),
    })
}

/// Takes a bincode body, likewise.
pub fn take_bincode(kind: u8, bytes: &[u8]) -> bool {
    taken(in_either_form(4 + kind % 4, bytes, Bincode))
}

/// A problem must be a document, too.
fn taken(result: Result<(), Problem>) -> bool {
    match result {
        Ok(()) => true,
        Err(problem) => {
            let status = problem.status();
            assert!((400..500).contains(&status), "{status}: {}", problem.detail);
            assert!(!problem.to_json().is_empty());
            false
        }
    }
}

trait Form {
    fn parse<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<T, Problem>;
}

struct Json;

impl Form for Json {
    fn parse<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<T, Problem> {
        parse_json(bytes)
    }
}

struct Bincode;

impl Form for Bincode {
    fn parse<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<T, Problem> {
        parse_bincode(bytes)
    }
}

fn in_either_form(kind: u8, bytes: &[u8], form: impl Form) -> Result<(), Problem> {
    match kind {
        4 => form.parse(bytes).and_then(edited),
        5 => form.parse(bytes).and_then(pushed),
        6 => form.parse(bytes).and_then(grabbed),
        _ => form.parse::<SeamRequest>(bytes).and_then(|request| Ok(request.validate()?)),
    }
}

fn open(bytes: &[u8]) -> Result<(), Problem> {
    let upload = Upload { config: Bytes::copy_from_slice(bytes), files: Vec::new() };
    let limits = MeshLimits { max_vertices: N_VERTICES, max_tets: N_VERTICES };
    Ok(store::check_create(&session::create(upload, &limits)?)?)
}

fn fork(request: ForkRequest) -> Result<(), Problem> {
    Ok(request.validate()?)
}

fn evaluated(request: EvaluateRequest) -> Result<(), Problem> {
    let (poses, shape) = evaluate::poses(request)?;
    store::check_poses(&poses, BASIS_SIZE).map_err(|error| shape.place(error.into()))
}

fn simulated(config: SimulationConfig) -> Result<(), Problem> {
    Ok(store::check_simulation(&simulation::config(config)?)?)
}

fn edited(request: EditRequest) -> Result<(), Problem> {
    Ok(store::check_edit(&edit::request(request)?)?)
}

fn pushed(request: ForceRequest) -> Result<(), Problem> {
    Ok(store::check_forces(&simulation::forces(request)?, N_VERTICES)?)
}

fn grabbed(request: GrabRequest) -> Result<(), Problem> {
    let (grabs, release) = simulation::grabs(request)?;
    Ok(store::check_grabs(&grabs, release.len(), N_VERTICES)?)
}
