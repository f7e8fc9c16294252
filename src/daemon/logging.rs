//! The log: standard error, for people or for programs.

use crate::config::{LogConfig, LogFormat};
use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::ParseError;

/// The filter cannot be understood.
#[derive(Debug, thiserror::Error)]
#[error("log filter {filter:?}: {source}")]
pub(crate) struct LogFilterError {
    filter: String,
    source: ParseError,
}

/// Installs the log for the whole process; a second call changes nothing.
pub(crate) fn install(config: &LogConfig) -> Result<(), LogFilterError> {
    let filter = EnvFilter::builder()
        .parse(&config.filter)
        .map_err(|source| LogFilterError { filter: config.filter.clone(), source })?;
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    // Fails only if a log is installed already.
    let _ = match config.format {
        LogFormat::Human => builder.try_init(),
        LogFormat::Json => builder.json().try_init(),
    };
    Ok(())
}
