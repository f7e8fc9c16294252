//! What surrounds every request: its name, its trace, its measurement, and the guards.

use crate::access::Role;
use crate::gateway::Gateway;
use crate::metrics;
use crate::problem::{Kind, Problem};
use axum::Router;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderName, HeaderValue, Method, header};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use std::time::Instant;
use sutura_proto::bus::is_request_id;
use tower::ServiceBuilder;
use tower_http::ServiceBuilderExt;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::csrf::{CsrfLayer, ProtectionError};
use tower_http::request_id::MakeRequestUuid;
use tower_http::trace::{DefaultOnFailure, TraceLayer};
use tracing::field::Empty;
use tracing::{Level, Span};

static REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// Surrounds `router` with everything that holds for all routes, the outermost first.
pub(super) fn surround(router: Router, gateway: &Gateway) -> Router {
    let gateway = gateway.clone();
    // Load that is shed counts as a failure too, and must not flood the log.
    let trace = TraceLayer::new_for_http()
        .make_span_with(move |request: &Request| span(&gateway, request))
        .on_failure(DefaultOnFailure::new().level(Level::DEBUG));
    router.layer(
        ServiceBuilder::new()
            .layer(from_fn(drop_unusable_request_id))
            .set_x_request_id(MakeRequestUuid)
            .layer(trace)
            .propagate_x_request_id()
            .layer(from_fn(measure))
            .layer(CatchPanicLayer::custom(panicked))
            .layer(CsrfLayer::new().with_rejection_response(cross_origin)),
    )
}

/// Sheds requests beyond [`crate::Limits::max_requests`].
pub(super) fn shed_load(router: Router<Gateway>, gateway: &Gateway) -> Router<Gateway> {
    async fn admit(State(gateway): State<Gateway>, request: Request, next: Next) -> Response {
        match gateway.admit_request() {
            Ok(_place) => next.run(request).await,
            Err(problem) => problem.into_response(),
        }
    }
    router.layer(from_fn_with_state(gateway.clone(), admit))
}

/// Lets in who shows a key that is good for what they ask, everybody where there are no keys.
pub(super) fn authorize(router: Router<Gateway>, gateway: &Gateway) -> Router<Gateway> {
    async fn admit(State(gateway): State<Gateway>, mut request: Request, next: Next) -> Response {
        let key = presented(&request);
        let caller = gateway.let_in(key.as_deref());
        let admitted = caller.and_then(|caller| {
            caller.check_role(needed(request.method(), request.uri().path()))?;
            Ok(caller)
        });
        match admitted {
            Ok(caller) => {
                request.extensions_mut().insert(caller);
                next.run(request).await
            }
            Err(problem) => problem.into_response(),
        }
    }
    router.layer(from_fn_with_state(gateway.clone(), admit))
}

/// The key that a request shows. Browsers can send no header with a WebSocket or an event stream: those
/// two may show it as `?access_token=` (which no log of ours holds).
fn presented(request: &Request) -> Option<String> {
    let header = request.headers().get(header::AUTHORIZATION).and_then(|h| h.to_str().ok());
    if let Some((scheme, key)) = header.and_then(|header| header.split_once(' ')) {
        return scheme.eq_ignore_ascii_case("bearer").then(|| key.trim().to_owned());
    }
    let path = request.uri().path();
    let is_stream = path.ends_with("/stream") || path.ends_with("/events");
    let query = request.uri().query().filter(|_| is_stream)?;
    query.split('&').find_map(|pair| pair.strip_prefix("access_token=")).map(str::to_owned)
}

/// The role that a request takes.
fn needed(method: &Method, path: &str) -> Role {
    match *method {
        _ if path == "/metrics" => Role::Admin,
        Method::GET | Method::HEAD | Method::OPTIONS => Role::Read,
        Method::POST if path.ends_with("/evaluate") => Role::Read,
        _ => Role::Edit,
    }
}

/// Forgets a client's request id that could not be repeated safely in a header or a log line; the
/// next layer then makes one.
async fn drop_unusable_request_id(mut request: Request, next: Next) -> Response {
    let usable = |value: &HeaderValue| is_request_id(value.as_bytes());
    if !request.headers().get(&REQUEST_ID).is_some_and(usable) {
        request.headers_mut().remove(&REQUEST_ID);
    }
    next.run(request).await
}

fn span(gateway: &Gateway, request: &Request) -> Span {
    let request_id = request.headers().get(&REQUEST_ID).and_then(|id| id.to_str().ok());
    let span = tracing::info_span!("request", method = %request.method(), path = request.uri().path(),
        request_id = request_id.unwrap_or_default(), route = Empty, status = Empty);
    if let Some(continue_trace) = gateway.continue_trace() {
        continue_trace(&span, request.headers());
    }
    span
}

async fn measure(request: Request, next: Next) -> Response {
    let begun = Instant::now();
    let method = request.method().clone();
    let route = request.extensions().get::<MatchedPath>().cloned();
    let response = next.run(request).await;
    // Unmatched paths and invented methods share one label, so that clients cannot make up series.
    let route = route.as_ref().map_or("unmatched", MatchedPath::as_str);
    let status = response.status().as_u16();
    Span::current().record("route", route).record("status", i64::from(status));
    let method = if status == 405 { "other" } else { method.as_str() };
    metrics::http_request(method, route, status, begun.elapsed());
    response
}

fn panicked(payload: Box<dyn std::any::Any + Send>) -> Response {
    let message = payload
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| payload.downcast_ref::<String>().cloned())
        .unwrap_or_default();
    tracing::error!(message, "a request handler panicked");
    Problem::new(Kind::Internal, "a defect of the daemon; its log has the details").into_response()
}

fn cross_origin(_error: ProtectionError) -> Response {
    Problem::new(Kind::Forbidden, "a page of another site may not change anything here")
        .into_response()
}
