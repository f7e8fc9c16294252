//! Simulations and forces.

use super::extract::{Document, InSession};
use crate::command;
use crate::conversion::simulation;
use crate::gateway::Gateway;
use crate::problem::Problem;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use sutura_proto::simulation::{ForceRequest, GrabRequest, SimulationConfig, SimulationInfo};

/// PUT /v1/sessions/{id}/simulation
pub(super) async fn put(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    Document(config): Document<SimulationConfig>,
) -> Result<Json<SimulationInfo>, Problem> {
    let info = gateway.store().put_simulation(id, simulation::config(config)?).await?;
    simulation::info(&info).map(Json)
}

/// GET /v1/sessions/{id}/simulation
pub(super) async fn get(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
) -> Result<Json<SimulationInfo>, Problem> {
    simulation::info(&gateway.store().simulation(id).await?).map(Json)
}

/// DELETE /v1/sessions/{id}/simulation
pub(super) async fn delete(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
) -> Result<StatusCode, Problem> {
    gateway.store().stop_simulation(id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// POST /v1/sessions/{id}/simulation/forces
pub(super) async fn push_forces(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    Document(request): Document<ForceRequest>,
) -> Result<StatusCode, Problem> {
    command::push_forces(&gateway, id, request)?;
    Ok(StatusCode::NO_CONTENT)
}

/// POST /v1/sessions/{id}/simulation/grabs
pub(super) async fn grab(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    Document(request): Document<GrabRequest>,
) -> Result<StatusCode, Problem> {
    command::grab(&gateway, id, request)?;
    Ok(StatusCode::NO_CONTENT)
}
