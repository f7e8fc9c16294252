//! What the people who run the daemon ask for.

use super::openapi;
use crate::gateway::Gateway;
use crate::metrics;
use crate::problem::{Kind, Problem};
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use utoipa::openapi::OpenApi;

/// GET /healthz: the process answers.
pub(super) async fn healthz() -> &'static str {
    "ok\n"
}

/// GET /readyz: new work is welcome.
pub(super) async fn readyz(State(gateway): State<Gateway>) -> Result<&'static str, Problem> {
    if gateway.is_winding_down() {
        return Err(Problem::new(Kind::ShuttingDown, "the daemon is going down").retry_after(5));
    }
    Ok("ready\n")
}

/// GET /metrics
pub(super) async fn metrics(State(gateway): State<Gateway>) -> impl IntoResponse {
    metrics::load(gateway.store().load());
    let measured = gateway.clone();
    if let Err(error) = tokio::task::spawn_blocking(move || measured.measure_memory()).await {
        tracing::error!(%error, "memory could not be measured");
    }
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], gateway.recorder().render())
}

/// GET /openapi.json
pub(super) async fn openapi() -> Json<OpenApi> {
    Json(openapi::document())
}
