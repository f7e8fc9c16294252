//! Receiving a session's configuration and mesh: one JSON document, or multipart with files.

use super::extract::{gather, in_time, media_type, receive};
use crate::conversion::session::{Upload, UploadedFile};
use crate::gateway::Gateway;
use crate::problem::{Kind, Problem};
use axum::extract::multipart::{Field, Multipart, MultipartError};
use axum::extract::{DefaultBodyLimit, FromRequest, Request};
use axum::http::StatusCode;
use bytes::Bytes;
use sutura_proto::media;

/// Most files of one mesh: TetGen's are two.
const MAX_MESH_FILES: usize = 2;

/// The whole upload, within the limits of its kind.
pub(super) async fn upload(gateway: &Gateway, mut request: Request) -> Result<Upload, Problem> {
    match media_type(request.headers()) {
        Some(media::JSON) => {
            let limit = gateway.limits().max_inline_mesh_bytes;
            let config = receive(gateway, request.into_body(), limit).await?;
            Ok(Upload { config, files: Vec::new() })
        }
        Some("multipart/form-data") => {
            // Each part has its own limit; this one only bounds what surrounds them.
            let limits = gateway.limits();
            let limit = limits.max_mesh_bytes.saturating_add(2 * limits.max_document_bytes);
            DefaultBodyLimit::max(limit).apply(&mut request);
            let parts = Multipart::from_request(request, gateway)
                .await
                .map_err(|error| Problem::new(Kind::MalformedDocument, error.body_text()))?;
            in_time(gateway, multipart(gateway, parts)).await
        }
        _ => {
            let detail = "send application/json, or multipart/form-data with the parts mesh and \
                          config";
            Err(Problem::new(Kind::UnsupportedMediaType, detail))
        }
    }
}

async fn multipart(gateway: &Gateway, mut parts: Multipart) -> Result<Upload, Problem> {
    let limits = gateway.limits();
    let (mut config, mut files) = (None, Vec::new());
    while let Some(field) = parts.next_field().await.map_err(malformed)? {
        let name = field.name().unwrap_or_default().to_owned();
        match name.as_str() {
            "config" if config.is_none() => {
                config = Some(part(field, "/config", limits.max_document_bytes).await?);
            }
            "mesh" if files.len() < MAX_MESH_FILES => {
                let name = field.file_name().map(str::to_owned);
                let bytes = part(field, "/mesh", limits.max_mesh_bytes).await?;
                files.push(UploadedFile { name, bytes });
            }
            "config" => return Err(parts_fault("two parts are named config".to_owned())),
            "mesh" => {
                let detail = format!("more than {MAX_MESH_FILES} parts are named mesh");
                return Err(parts_fault(detail));
            }
            _ => return Err(parts_fault("only the parts mesh and config belong here".to_owned())),
        }
    }
    let config = config.ok_or_else(|| parts_fault("the part config is missing".to_owned()))?;
    Ok(Upload { config, files })
}

async fn part(field: Field<'_>, pointer: &str, limit: usize) -> Result<Bytes, Problem> {
    gather(field, limit, malformed).await.map_err(|problem| problem.at(pointer))
}

fn parts_fault(detail: String) -> Problem {
    Problem::new(Kind::MalformedDocument, detail)
}

fn malformed(error: MultipartError) -> Problem {
    match error.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Problem::new(Kind::TooLarge, error.body_text()),
        _ => Problem::new(Kind::MalformedDocument, error.body_text()),
    }
}
