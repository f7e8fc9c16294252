//! `[traffic]`: what clients may ask of the transports. Meanings: [`sutura_transport::Limits`].

use super::bounds::{bytes, count, positive, seconds};
use serde::Deserialize;
use std::time::Duration;

#[derive(Deserialize)]
#[serde(
    remote = "sutura_transport::Limits",
    default = "sutura_transport::Limits::default",
    deny_unknown_fields
)]
pub(super) struct Traffic {
    #[serde(deserialize_with = "bytes")]
    max_mesh_bytes: usize,
    #[serde(deserialize_with = "bytes")]
    max_inline_mesh_bytes: usize,
    #[serde(deserialize_with = "bytes")]
    max_document_bytes: usize,
    #[serde(deserialize_with = "positive")]
    max_requests_per_s: f64,
    #[serde(deserialize_with = "count")]
    max_request_burst: usize,
    #[serde(deserialize_with = "count")]
    max_connections: usize,
    #[serde(deserialize_with = "count")]
    max_requests: usize,
    #[serde(deserialize_with = "count")]
    max_uploads: usize,
    #[serde(rename = "max_upload_queue_wait_s", deserialize_with = "seconds")]
    max_upload_queue_wait: Duration,
    #[serde(rename = "max_receive_time_s", deserialize_with = "seconds")]
    max_receive_time: Duration,
    #[serde(rename = "max_ready_wait_s", deserialize_with = "seconds")]
    max_ready_wait: Duration,
    #[serde(deserialize_with = "count")]
    max_page: usize,
    #[serde(deserialize_with = "count")]
    max_evaluation_numbers: usize,
    #[serde(deserialize_with = "bytes")]
    max_array_bytes: usize,
    #[serde(deserialize_with = "bytes")]
    max_bus_array_bytes: usize,
    #[serde(deserialize_with = "count")]
    max_streams: usize,
    #[serde(rename = "max_send_wait_s", deserialize_with = "seconds")]
    max_send_wait: Duration,
    #[serde(deserialize_with = "count")]
    max_queries: usize,
}
