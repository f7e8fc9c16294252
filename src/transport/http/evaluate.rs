//! Evaluation of the reduced model.

use super::extract::{Document, InSession, OfGeneration};
use crate::conversion::evaluate;
use crate::gateway::Gateway;
use crate::problem::{Kind, Problem};
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use sutura_core::control::Control;
use sutura_proto::evaluate::EvaluateRequest;
use sutura_proto::media;
use sutura_store::{GenerationRef, SessionId};

/// POST /v1/sessions/{id}/evaluate
pub(super) async fn at_current(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    Document(request): Document<EvaluateRequest>,
) -> Result<Response, Problem> {
    at(&gateway, id, GenerationRef::Current, request).await
}

/// POST /v1/sessions/{id}/generations/{generation}/evaluate
pub(super) async fn at_generation(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    OfGeneration(generation): OfGeneration,
    Document(request): Document<EvaluateRequest>,
) -> Result<Response, Problem> {
    at(&gateway, id, generation, request).await
}

async fn at(
    gateway: &Gateway,
    id: SessionId,
    generation: GenerationRef,
    request: EvaluateRequest,
) -> Result<Response, Problem> {
    let exact = request.exact;
    let (poses, shape) = evaluate::poses(request)?;
    let store = gateway.store();
    let r = store.generation(id, generation)?.artifacts.basis_size();
    let limit = gateway.limits().max_evaluation_numbers;
    if poses.len().saturating_mul(r * r) > limit {
        let detail = format!("{} poses of {r} coordinates: too many at once", poses.len());
        return Err(Problem::new(Kind::TooLarge, detail).at("/q"));
    }
    let evaluated = store.evaluate(id, generation, poses, exact).await;
    let evaluations = evaluated.map_err(|error| shape.place(error.into()))?;
    let write = move |_: &dyn Control| {
        serde_json::to_vec(&evaluate::reply(evaluations, shape)?)
            .map_err(|error| Problem::new(Kind::Internal, error.to_string()))
    };
    let json = store.compute(store.account(id)?, "writing an evaluation", write).await??;
    Ok(([(header::CONTENT_TYPE, media::JSON)], json).into_response())
}
