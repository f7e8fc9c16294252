//! Evaluation of the reduced model.

use super::extract::{Document, InSession, OfGeneration};
use crate::conversion::evaluate;
use crate::gateway::Gateway;
use crate::problem::Problem;
use axum::Json;
use axum::extract::State;
use sutura_proto::evaluate::{EvaluateReply, EvaluateRequest};
use sutura_store::{GenerationRef, SessionId};

/// POST /v1/sessions/{id}/evaluate
pub(super) async fn at_current(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    Document(request): Document<EvaluateRequest>,
) -> Result<Json<EvaluateReply>, Problem> {
    at(&gateway, id, GenerationRef::Current, request).await.map(Json)
}

/// POST /v1/sessions/{id}/generations/{generation}/evaluate
pub(super) async fn at_generation(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    OfGeneration(generation): OfGeneration,
    Document(request): Document<EvaluateRequest>,
) -> Result<Json<EvaluateReply>, Problem> {
    at(&gateway, id, generation, request).await.map(Json)
}

async fn at(
    gateway: &Gateway,
    id: SessionId,
    generation: GenerationRef,
    request: EvaluateRequest,
) -> Result<EvaluateReply, Problem> {
    let exact = request.exact;
    let (poses, shape) = evaluate::poses(request)?;
    let evaluated = gateway.store().evaluate(id, generation, poses, exact).await;
    let evaluations = evaluated.map_err(|error| shape.place(error.into()))?;
    evaluate::reply(evaluations, shape)
}
