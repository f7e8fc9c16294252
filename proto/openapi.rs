//! The documents' schemas, for `/openapi.json`.

use utoipa::OpenApi;

/// Every document of the contract as an OpenAPI component; paths are the server's to add.
#[derive(OpenApi)]
#[openapi(components(schemas(
    crate::edit::EditReply,
    crate::edit::EditRequest,
    crate::evaluate::EvaluateReply,
    crate::evaluate::EvaluateRequest,
    crate::event::Event,
    crate::problem::Problem,
    crate::session::ForkRequest,
    crate::session::SeamReply,
    crate::session::SeamRequest,
    crate::session::SessionConfig,
    crate::session::SessionInfo,
    crate::session::SessionList,
    crate::simulation::ForceRequest,
    crate::simulation::GrabRequest,
    crate::simulation::SimulationConfig,
    crate::simulation::SimulationInfo,
)))]
pub struct Components;
