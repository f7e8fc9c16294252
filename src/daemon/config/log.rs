//! `[log]`

use serde::Deserialize;

/// What is logged, and how. The log goes to standard error.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LogConfig {
    /// Levels by module, as `tracing_subscriber::EnvFilter` reads them.
    pub(crate) filter: String,
    /// For people or for programs.
    pub(crate) format: LogFormat,
}

/// The form of a log line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum LogFormat {
    /// Text, coloured on a terminal.
    Human,
    /// One JSON object a line.
    Json,
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { filter: "info,zenoh=warn".into(), format: LogFormat::Human }
    }
}
