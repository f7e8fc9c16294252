//! The whole HTTP API.

use super::extract::{no_method, no_route};
use super::{
    edit, evaluate, event, generation, layers, operations, session, simulation, stream, viewer,
};
use crate::conversion::array::ArrayKind;
use crate::gateway::Gateway;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::routing::{MethodRouter, get, post};

/// Sessions and what is done with them: shed under load.
fn api() -> Vec<(&'static str, MethodRouter<Gateway>)> {
    vec![
        ("/v1/sessions", post(session::create).get(session::list)),
        ("/v1/sessions/{id}", get(session::get).delete(session::delete)),
        ("/v1/sessions/{id}/fork", post(session::fork)),
        ("/v1/sessions/{id}/seams", post(session::add_seams)),
        ("/v1/sessions/{id}/events", get(event::events)),
        ("/v1/sessions/{id}/edits", post(edit::edit)),
        ("/v1/sessions/{id}/generations/{generation}/modes", generation::get(ArrayKind::Modes)),
        ("/v1/sessions/{id}/generations/{generation}/basis", generation::get(ArrayKind::Basis)),
        (
            "/v1/sessions/{id}/generations/{generation}/transfer",
            generation::get(ArrayKind::Transfer),
        ),
        ("/v1/sessions/{id}/generations/{generation}/delta", generation::get(ArrayKind::Delta)),
        (
            "/v1/sessions/{id}/generations/{generation}/combination",
            generation::get(ArrayKind::Combination),
        ),
        (
            "/v1/sessions/{id}/generations/{generation}/dictionary",
            generation::get(ArrayKind::Dictionary),
        ),
        (
            "/v1/sessions/{id}/generations/{generation}/evaluator",
            generation::get(ArrayKind::Evaluator),
        ),
        ("/v1/sessions/{id}/generations/{generation}/mass", generation::get(ArrayKind::Mass)),
        (
            "/v1/sessions/{id}/generations/{generation}/frequencies_hz",
            generation::get(ArrayKind::FrequenciesHz),
        ),
        (
            "/v1/sessions/{id}/generations/{generation}/positions",
            generation::get(ArrayKind::Positions),
        ),
        ("/v1/sessions/{id}/generations/{generation}/tets", generation::get(ArrayKind::Tets)),
        (
            "/v1/sessions/{id}/generations/{generation}/stitches",
            generation::get(ArrayKind::Stitches),
        ),
        ("/v1/sessions/{id}/generations/{generation}/evaluate", post(evaluate::at_generation)),
        ("/v1/sessions/{id}/evaluate", post(evaluate::at_current)),
        (
            "/v1/sessions/{id}/simulation",
            get(simulation::get).put(simulation::put).delete(simulation::delete),
        ),
        ("/v1/sessions/{id}/simulation/forces", post(simulation::push_forces)),
        ("/v1/sessions/{id}/simulation/grabs", post(simulation::grab)),
        ("/v1/sessions/{id}/stream", get(stream::stream)),
    ]
}

/// What the people who run the daemon ask for: always answered.
fn operations() -> Vec<(&'static str, MethodRouter<Gateway>)> {
    vec![
        ("/", get(viewer::page)),
        ("/healthz", get(operations::healthz)),
        ("/readyz", get(operations::readyz)),
        ("/openapi.json", get(operations::openapi)),
    ]
}

/// What only those ask for who run it.
fn guarded() -> Vec<(&'static str, MethodRouter<Gateway>)> {
    vec![("/metrics", get(operations::metrics))]
}

/// The whole HTTP API over `gateway`.
pub fn router(gateway: Gateway) -> Router {
    let routes = |routes: Vec<(&str, MethodRouter<Gateway>)>| {
        routes
            .into_iter()
            .fold(Router::new(), |router, (path, methods)| router.route(path, methods))
    };
    let api = layers::shed_load(layers::authorize(routes(api()), &gateway), &gateway);
    let guarded = layers::authorize(routes(guarded()), &gateway);
    let router = api
        .merge(guarded)
        .merge(routes(operations()))
        .merge(viewer::assets())
        .fallback(no_route)
        .method_not_allowed_fallback(no_method)
        .layer(DefaultBodyLimit::max(gateway.limits().max_document_bytes))
        .with_state(gateway.clone());
    layers::surround(router, &gateway)
}

/// Every path of the API.
#[cfg(test)]
pub(super) fn paths() -> Vec<&'static str> {
    api().into_iter().chain(guarded()).chain(operations()).map(|(path, _)| path).collect()
}
