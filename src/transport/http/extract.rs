//! What handlers take from a request, refusing with a problem document.

use crate::command;
use crate::conversion::document::parse_json;
use crate::gateway::Gateway;
use crate::problem::{Kind, Problem};
use axum::extract::{FromRequest, FromRequestParts, Query, RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use axum::response::IntoResponse;
use bytes::Bytes;
use serde::de::DeserializeOwned;
use sutura_proto::media;
use sutura_store::{GenerationRef, SessionId};

/// Documents beyond this many bytes are parsed on the query pool: at some 100 MB/s, below it a
/// document takes less than half a millisecond.
const PARSE_AT_ONCE_BYTES: usize = 32 << 10;

/// The session that the path names. Whether it exists is for the store to say.
pub(super) struct InSession(pub(super) SessionId);

impl<S: Send + Sync> FromRequestParts<S> for InSession {
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        command::session_id(&path_param(parts, state, "id").await?).map(InSession)
    }
}

/// The generation that the path names.
pub(super) struct OfGeneration(pub(super) GenerationRef);

impl<S: Send + Sync> FromRequestParts<S> for OfGeneration {
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        command::generation_ref(&path_param(parts, state, "generation").await?).map(OfGeneration)
    }
}

async fn path_param<S: Send + Sync>(
    parts: &mut Parts,
    state: &S,
    name: &str,
) -> Result<String, Problem> {
    let params = RawPathParams::from_request_parts(parts, state)
        .await
        .map_err(|error| Problem::new(Kind::MalformedParameter, error.body_text()))?;
    let value = params.iter().find(|(key, _)| *key == name).map(|(_, value)| value.to_owned());
    value.ok_or_else(|| Problem::new(Kind::Internal, format!("the route has no {name}")))
}

/// The query string.
pub(super) struct Params<T>(pub(super) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Params<T> {
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let Query(params) = Query::from_request_parts(parts, state)
            .await
            .map_err(|error| Problem::new(Kind::MalformedParameter, error.body_text()))?;
        Ok(Params(params))
    }
}

/// A JSON body.
pub(super) struct Document<T>(pub(super) T);

impl<T: DeserializeOwned + Send + 'static> FromRequest<Gateway> for Document<T> {
    type Rejection = Problem;
    async fn from_request(request: Request, gateway: &Gateway) -> Result<Self, Problem> {
        if media_type(request.headers()) != Some(media::JSON) {
            let detail = format!("this takes a document of type {}", media::JSON);
            return Err(Problem::new(Kind::UnsupportedMediaType, detail));
        }
        let body = receive(gateway, Bytes::from_request(request, gateway)).await?;
        if body.len() <= PARSE_AT_ONCE_BYTES {
            return parse_json(&body).map(Document);
        }
        let job = move |_: &dyn sutura_core::control::Control| parse_json(&body).map(Document);
        gateway.store().compute("parsing a document", job).await?
    }
}

/// Waits for (a part of) a body to arrive, and gives up on clients that are too slow.
pub(super) async fn receive<T, E: Into<BodyFault>>(
    gateway: &Gateway,
    arriving: impl Future<Output = Result<T, E>>,
) -> Result<T, Problem> {
    let limit = gateway.limits().max_receive_time;
    match tokio::time::timeout(limit, arriving).await {
        Ok(received) => received.map_err(|error| error.into().0),
        Err(_) => {
            let detail = format!("the body had not arrived after {} s", limit.as_secs());
            Err(Problem::new(Kind::ReceiveTimeout, detail))
        }
    }
}

/// A body that could not be received.
pub(super) struct BodyFault(pub(super) Problem);

impl From<axum::extract::rejection::BytesRejection> for BodyFault {
    fn from(error: axum::extract::rejection::BytesRejection) -> BodyFault {
        body_fault(error.status().as_u16(), error.body_text())
    }
}

impl From<axum::extract::multipart::MultipartError> for BodyFault {
    fn from(error: axum::extract::multipart::MultipartError) -> BodyFault {
        body_fault(error.status().as_u16(), error.body_text())
    }
}

impl From<Problem> for BodyFault {
    fn from(problem: Problem) -> BodyFault {
        BodyFault(problem)
    }
}

fn body_fault(status: u16, detail: String) -> BodyFault {
    match status {
        413 => BodyFault(Problem::new(Kind::TooLarge, format!("the body is too large: {detail}"))),
        _ => BodyFault(Problem::new(Kind::MalformedDocument, detail)),
    }
}

/// The media type of the body, without its parameters.
pub(super) fn media_type(headers: &HeaderMap) -> Option<&str> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    value.split(';').next().map(str::trim)
}

/// The answer to a path that does not exist.
pub(super) async fn no_route() -> impl IntoResponse {
    Problem::new(Kind::NoRoute, "there is nothing at this path; /openapi.json lists what there is")
}

/// The answer to a method that a path does not have.
pub(super) async fn no_method() -> impl IntoResponse {
    Problem::new(Kind::MethodNotAllowed, "this path has no such method; see the Allow header")
}
