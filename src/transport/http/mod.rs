//! HTTP: parse, command, reply.

mod edit;
mod evaluate;
mod event;
mod extract;
mod generation;
mod layers;
mod negotiation;
mod openapi;
mod operations;
mod router;
mod session;
mod simulation;
mod stream;
#[cfg(test)]
pub(crate) mod tests;
mod upload;

pub use router::router;

use crate::gateway::Gateway;
use crate::metrics;
use crate::problem::Problem;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::serve::ListenerExt;
use std::future::Future;
use sutura_proto::media;
use tokio::net::TcpListener;

/// Serves the whole API on `listener` until `stop` is ready, then winds down: streams end, requests
/// under way are answered.
pub async fn serve(
    gateway: Gateway,
    listener: TcpListener,
    stop: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let upkeep = tokio::spawn(metrics::upkeep(gateway.recorder().clone()));
    let observe = tokio::spawn(metrics::observe(gateway.store().clone()));
    let router = router(gateway.clone());
    let stopping = async move {
        stop.await;
        gateway.wind_down();
    };
    // Published states are small and must not wait for more to come.
    let listener = listener.tap_io(|stream| {
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "a connection keeps gathering small writes");
        }
    });
    let served = axum::serve(listener, router).with_graceful_shutdown(stopping).await;
    upkeep.abort();
    observe.abort();
    served
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        self.log();
        let status =
            StatusCode::from_u16(self.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let content_type = HeaderValue::from_static(media::PROBLEM_JSON);
        let mut response =
            (status, [(header::CONTENT_TYPE, content_type)], self.to_json()).into_response();
        if let Some(seconds) = self.retry_after_s {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response
    }
}
