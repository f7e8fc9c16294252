//! What handlers take from a request, refusing with a problem document.

use crate::access::Caller;
use crate::command;
use crate::conversion::document::parse_json;
use crate::gateway::Gateway;
use crate::problem::{Kind, Problem};
use axum::body::{Body, HttpBody};
use axum::extract::{FromRequest, FromRequestParts, Query, RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use axum::response::IntoResponse;
use bytes::{Bytes, BytesMut};
use futures_util::{Stream, StreamExt};
use serde::de::DeserializeOwned;
use sutura_proto::media;
use sutura_store::{Account, GenerationRef, SessionId};

/// Bytes read past a limit and thrown away.
const MAX_DISCARDED_BYTES: usize = 64 << 20;

/// The session that the path names. Whether it exists is for the store to say, unless it is another tenant's:
/// then it does not.
pub(super) struct InSession(pub(super) SessionId);

impl FromRequestParts<Gateway> for InSession {
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, gateway: &Gateway) -> Result<Self, Problem> {
        let id = command::session_id(&path_param(parts, gateway, "id").await?)?;
        let caller = caller(parts)?;
        caller.find_session(gateway, id).await?;
        caller.check_session(gateway, id)?;
        Ok(InSession(id))
    }
}

/// Whoever asks.
pub(super) struct By(pub(super) Caller);

impl<S: Send + Sync> FromRequestParts<S> for By {
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        caller(parts).cloned().map(By)
    }
}

/// Whom [`super::layers::authorize`] has let in.
fn caller(parts: &Parts) -> Result<&Caller, Problem> {
    let nobody = || Problem::new(Kind::Internal, "the route lets nobody in");
    parts.extensions.get::<Caller>().ok_or_else(nobody)
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

/// A JSON body, or the default where there is no body at all.
pub(super) struct DocumentOrDefault<T>(pub(super) T);

impl<T: DeserializeOwned + Default + Send + 'static> FromRequest<Gateway> for DocumentOrDefault<T> {
    type Rejection = Problem;
    async fn from_request(request: Request, gateway: &Gateway) -> Result<Self, Problem> {
        if request.body().is_end_stream() {
            return Ok(DocumentOrDefault(T::default()));
        }
        Document::from_request(request, gateway).await.map(|Document(body)| DocumentOrDefault(body))
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
        let limit = gateway.limits().max_document_bytes;
        let account = request.extensions().get().map_or(Account::Common, Caller::account);
        let body = receive(gateway, request.into_body(), limit).await?;
        command::parse(gateway, account, body.len(), move || parse_json(&body).map(Document)).await
    }
}

/// Reads a body of at most `limit` bytes, within the time that clients are given.
pub(super) async fn receive(gateway: &Gateway, body: Body, limit: usize) -> Result<Bytes, Problem> {
    let broken = |error: axum::Error| {
        Problem::new(Kind::MalformedDocument, format!("the body broke off: {error}"))
    };
    in_time(gateway, gather(body.into_data_stream(), limit, broken)).await
}

/// Gives up on clients that take too long to send.
pub(super) async fn in_time<T>(
    gateway: &Gateway,
    arriving: impl Future<Output = Result<T, Problem>>,
) -> Result<T, Problem> {
    let limit = gateway.limits().max_receive_time;
    tokio::time::timeout(limit, arriving).await.unwrap_or_else(|_| {
        let detail = format!("the body had not arrived after {} s", limit.as_secs());
        Err(Problem::new(Kind::ReceiveTimeout, detail))
    })
}

/// Joins pieces as they arrive; never holds more than `limit` bytes. Beyond the limit it reads on
/// for a while, because a client that is still sending would not read the refusal.
pub(super) async fn gather<E>(
    mut pieces: impl Stream<Item = Result<Bytes, E>> + Unpin,
    limit: usize,
    broken: impl Fn(E) -> Problem,
) -> Result<Bytes, Problem> {
    let mut bytes = BytesMut::new();
    let mut size = 0;
    while let Some(piece) = pieces.next().await {
        let piece = piece.map_err(&broken)?;
        size += piece.len();
        if size <= limit {
            bytes.extend_from_slice(&piece);
        } else if size > limit.saturating_add(MAX_DISCARDED_BYTES) {
            break;
        } else {
            bytes = BytesMut::new();
        }
    }
    if size > limit {
        let detail = format!("more than {limit} bytes, the most that is accepted here");
        return Err(Problem::new(Kind::TooLarge, detail));
    }
    Ok(bytes.freeze())
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
