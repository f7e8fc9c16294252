//! Sessions: open, describe, list, fork, name seams, delete.

use super::extract::{By, Document, DocumentOrDefault, InSession, Params};
use super::upload::upload;
use crate::command;
use crate::conversion::session;
use crate::gateway::Gateway;
use crate::problem::{Kind, Problem};
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use std::time::Duration;
use sutura_proto::session::{ForkRequest, SeamReply, SeamRequest, SessionInfo, SessionList};
use sutura_store::SessionId;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WaitParams {
    wait_s: Option<f64>,
}

/// POST /v1/sessions
pub(super) async fn create(
    State(gateway): State<Gateway>,
    By(caller): By,
    Params(params): Params<WaitParams>,
    request: Request,
) -> Result<Response, Problem> {
    let wait = wait(&gateway, params.wait_s)?;
    let place = gateway.admit_upload().await?;
    let id = command::create(&gateway, &caller, upload(&gateway, request).await?).await?;
    drop(place);
    Ok(made(StatusCode::ACCEPTED, info_in_time(&gateway, id, wait).await?))
}

/// The session once its body is there, or once the time is over; at once if there is none.
async fn info_in_time(
    gateway: &Gateway,
    id: SessionId,
    wait: Option<Duration>,
) -> Result<SessionInfo, Problem> {
    let Some(wait) = wait else { return command::info(gateway, id) };
    // A daemon that goes down answers at once with how things stand.
    tokio::select! {
        info = gateway.store().wait_ready(id, wait) => Ok(session::info(&info?)),
        () = gateway.wound_down() => command::info(gateway, id),
    }
}

/// How long `?wait_s=` holds the answer.
fn wait(gateway: &Gateway, wait_s: Option<f64>) -> Result<Option<Duration>, Problem> {
    let longest = gateway.limits().max_ready_wait;
    match wait_s {
        None => Ok(None),
        Some(seconds) if (0.0..=longest.as_secs_f64()).contains(&seconds) => {
            Ok(Some(Duration::from_secs_f64(seconds)))
        }
        Some(_) => {
            let detail = format!("wait_s must be between 0 and {}", longest.as_secs());
            Err(Problem::new(Kind::MalformedParameter, detail))
        }
    }
}

fn made(status: StatusCode, info: SessionInfo) -> Response {
    let location = format!("/v1/sessions/{}", info.id);
    (status, [(header::LOCATION, location)], Json(info)).into_response()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParams {
    after: Option<String>,
    limit: Option<usize>,
}

/// Sessions on a page unless the client says otherwise.
const PAGE: usize = 50;

/// GET /v1/sessions
pub(super) async fn list(
    State(gateway): State<Gateway>,
    By(caller): By,
    Params(params): Params<ListParams>,
) -> Result<Json<SessionList>, Problem> {
    let longest = gateway.limits().max_page;
    let limit = params.limit.unwrap_or(PAGE.min(longest));
    if !(1..=longest).contains(&limit) {
        let detail = format!("limit must be between 1 and {longest}");
        return Err(Problem::new(Kind::MalformedParameter, detail));
    }
    let after = params.after.as_deref().map(command::session_id).transpose()?;
    // One more than asked for tells whether another page follows.
    let found = command::list(&gateway, &caller, after, limit + 1);
    let sessions: Vec<SessionInfo> = found.iter().take(limit).map(session::info).collect();
    let next = (found.len() > limit).then(|| sessions.last().map(|s| s.id.clone())).flatten();
    Ok(Json(SessionList { sessions, next }))
}

/// GET /v1/sessions/{id}
pub(super) async fn get(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    Params(params): Params<WaitParams>,
) -> Result<Json<SessionInfo>, Problem> {
    info_in_time(&gateway, id, wait(&gateway, params.wait_s)?).await.map(Json)
}

/// DELETE /v1/sessions/{id}
pub(super) async fn delete(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
) -> Result<StatusCode, Problem> {
    gateway.store().delete(id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// POST /v1/sessions/{id}/fork
pub(super) async fn fork(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    DocumentOrDefault(request): DocumentOrDefault<ForkRequest>,
) -> Result<Response, Problem> {
    request.validate()?;
    let fork = gateway.store().fork(id, request.name).await?;
    Ok(made(StatusCode::CREATED, command::info(&gateway, fork)?))
}

/// POST /v1/sessions/{id}/seams
pub(super) async fn add_seams(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    Document(request): Document<SeamRequest>,
) -> Result<(StatusCode, Json<SeamReply>), Problem> {
    Ok((StatusCode::ACCEPTED, Json(command::add_seams(&gateway, id, request).await?)))
}
