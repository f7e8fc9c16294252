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
mod serve;
mod session;
mod simulation;
mod stream;
#[cfg(test)]
pub(crate) mod tests;
mod upload;
mod viewer;

pub use router::router;
pub use serve::serve;

use crate::problem::{Kind, Problem};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use sutura_proto::media;

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        self.log();
        let status =
            StatusCode::from_u16(self.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let content_type = HeaderValue::from_static(media::PROBLEM_JSON);
        let mut response =
            (status, [(header::CONTENT_TYPE, content_type)], self.to_json()).into_response();
        if self.kind == Kind::Unauthorized {
            let challenge = HeaderValue::from_static("Bearer realm=\"sutura\"");
            response.headers_mut().insert(header::WWW_AUTHENTICATE, challenge);
        }
        if let Some(seconds) = self.retry_after_s {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response
    }
}
