//! `[work]`: threads, queues and pacing. Meanings: [`sutura_store::WorkConfig`].

use super::bounds::{queue, seconds, threads};
use serde::Deserialize;
use std::time::Duration;

#[derive(Deserialize)]
#[serde(
    remote = "sutura_store::WorkConfig",
    default = "sutura_store::WorkConfig::default",
    deny_unknown_fields
)]
pub(super) struct Work {
    #[serde(deserialize_with = "threads")]
    n_build_threads: usize,
    #[serde(deserialize_with = "threads")]
    n_query_threads: usize,
    #[serde(deserialize_with = "threads")]
    n_stepping_threads: usize,
    #[serde(deserialize_with = "queue")]
    build_queue_limit: usize,
    #[serde(deserialize_with = "queue")]
    edit_queue_limit: usize,
    #[serde(deserialize_with = "queue")]
    query_queue_limit: usize,
    #[serde(rename = "max_edit_wait_s", deserialize_with = "seconds")]
    max_edit_wait: Duration,
    #[serde(rename = "max_query_wait_s", deserialize_with = "seconds")]
    max_query_wait: Duration,
    #[serde(deserialize_with = "queue")]
    stepping_queue_limit: usize,
    #[serde(deserialize_with = "queue")]
    n_kept_generations: usize,
    #[serde(deserialize_with = "queue")]
    max_open_stitches: usize,
    #[serde(rename = "progress_interval_s", deserialize_with = "seconds")]
    progress_interval: Duration,
    #[serde(deserialize_with = "queue")]
    event_backlog: usize,
    #[serde(deserialize_with = "queue")]
    frame_backlog: usize,
}
