//! Edits.

use super::extract::{Document, InSession};
use crate::command;
use crate::gateway::Gateway;
use crate::problem::Problem;
use axum::Json;
use axum::extract::State;
use sutura_proto::edit::{EditReply, EditRequest};

/// POST /v1/sessions/{id}/edits. A client that goes away cancels its edit: the server then drops
/// this future.
pub(super) async fn edit(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    Document(request): Document<EditRequest>,
) -> Result<Json<EditReply>, Problem> {
    command::edit(&gateway, id, request).await.map(Json)
}
