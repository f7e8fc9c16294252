//! The arrays of a generation.

use super::extract::{InSession, OfGeneration, Params};
use super::negotiation;
use crate::command::{self, ArrayParams, ArrayRequest};
use crate::conversion::array::ArrayKind;
use crate::gateway::Gateway;
use crate::problem::{Kind, Problem};
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::IntoResponse;
use axum::routing::{self, MethodRouter};

/// GET /v1/sessions/{id}/generations/{generation}/…
pub(super) fn get(kind: ArrayKind) -> MethodRouter<Gateway> {
    routing::get(
        async move |State(gateway): State<Gateway>,
                    InSession(id): InSession,
                    OfGeneration(generation): OfGeneration,
                    Params(pairs): Params<Vec<(String, String)>>,
                    headers: HeaderMap| {
            let pairs = pairs.iter().map(|(name, value)| (name.as_str(), value.as_str()));
            let params = ArrayParams::parse(pairs)?;
            let media = negotiation::choose(&headers, kind.offered()).ok_or_else(|| {
                let detail = format!("this travels as {}", kind.offered().join(" or "));
                Problem::new(Kind::NotAcceptable, detail)
            })?;
            let max_bytes = gateway.limits().max_array_bytes;
            let request = ArrayRequest { kind, generation, params, media, max_bytes };
            let bytes = command::array(&gateway, id, request).await?;
            let headers = [(header::CONTENT_TYPE, media), (header::VARY, "accept")];
            Ok::<_, Problem>((headers, bytes).into_response())
        },
    )
}
