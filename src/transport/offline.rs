//! A session's request without a daemon: the same reading and the same refusals.

use crate::conversion::session::{Upload, UploadedFile, create};
use sutura_core::mesh::MeshLimits;
use sutura_proto::Problem;
use sutura_store::CreateSession;

/// What `POST /v1/sessions` would build from a configuration (JSON) and mesh files, each with its name.
pub fn read_request(
    config: Vec<u8>,
    files: Vec<(String, Vec<u8>)>,
    limits: &MeshLimits,
) -> Result<CreateSession, Problem> {
    let files = files
        .into_iter()
        .map(|(name, bytes)| UploadedFile { name: Some(name), bytes: bytes.into() })
        .collect();
    create(Upload { config: config.into(), files }, limits).map_err(|problem| problem.to_document())
}
