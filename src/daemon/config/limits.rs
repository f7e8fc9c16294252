//! `[limits]`: largest sizes accepted from a client. Meanings: [`sutura_store::Limits`].

use super::bounds::{count, positive};
use serde::Deserialize;

#[derive(Deserialize)]
#[serde(
    remote = "sutura_store::Limits",
    default = "sutura_store::Limits::default",
    deny_unknown_fields
)]
pub(super) struct Limits {
    #[serde(deserialize_with = "count")]
    max_sessions: usize,
    #[serde(deserialize_with = "count")]
    max_name_bytes: usize,
    #[serde(deserialize_with = "count")]
    max_vertices: usize,
    #[serde(deserialize_with = "count")]
    max_tets: usize,
    #[serde(deserialize_with = "count")]
    max_domains: usize,
    #[serde(deserialize_with = "count")]
    max_modes: usize,
    #[serde(deserialize_with = "count")]
    max_basis_size: usize,
    #[serde(deserialize_with = "count")]
    max_cubature_points: usize,
    #[serde(deserialize_with = "count")]
    max_training_poses: usize,
    #[serde(deserialize_with = "count")]
    max_seams: usize,
    #[serde(deserialize_with = "count")]
    max_seam_bytes: usize,
    #[serde(deserialize_with = "count")]
    max_edits_per_request: usize,
    #[serde(deserialize_with = "count")]
    max_stitches: usize,
    #[serde(deserialize_with = "count")]
    max_evaluations_per_request: usize,
    #[serde(deserialize_with = "count")]
    max_simulations: usize,
    #[serde(deserialize_with = "positive")]
    min_dt_s: f64,
    #[serde(deserialize_with = "positive")]
    max_publish_hz: f64,
    #[serde(deserialize_with = "count")]
    max_obstacles: usize,
    #[serde(deserialize_with = "count")]
    max_grabs: usize,
    #[serde(deserialize_with = "count")]
    max_forces_per_request: usize,
    #[serde(deserialize_with = "count")]
    max_active_forces: usize,
    #[serde(deserialize_with = "positive")]
    max_force_n: f64,
    #[serde(deserialize_with = "positive")]
    max_force_duration_s: f64,
}
