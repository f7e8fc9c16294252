//! `[shutdown]`

use super::bounds::seconds;
use serde::Deserialize;
use std::time::Duration;

/// How the daemon ends.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ShutdownConfig {
    /// How long edits and requests under way may take to finish.
    #[serde(rename = "deadline_s", deserialize_with = "seconds")]
    pub(crate) deadline: Duration,
}

impl Default for ShutdownConfig {
    fn default() -> Self {
        Self { deadline: Duration::from_secs(10) }
    }
}
