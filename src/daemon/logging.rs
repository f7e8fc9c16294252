//! The log: standard error, for people or for programs. Beside it, traces for a collector, if there is one.

use crate::config::{LogConfig, LogFormat};
use crate::telemetry::Telemetry;
use std::io::IsTerminal;
use tracing_subscriber::filter::ParseError;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer, fmt};

/// The filter cannot be understood.
#[derive(Debug, thiserror::Error)]
#[error("log filter {filter:?}: {source}")]
pub(crate) struct LogFilterError {
    filter: String,
    source: ParseError,
}

/// Installs the log, and the way to the collector, for the whole process; a second call changes nothing.
pub(crate) fn install(
    config: &LogConfig,
    telemetry: Option<&Telemetry>,
) -> Result<(), LogFilterError> {
    let filter = EnvFilter::builder()
        .parse(&config.filter)
        .map_err(|source| LogFilterError { filter: config.filter.clone(), source })?;
    let log = fmt::layer().with_writer(std::io::stderr).with_ansi(std::io::stderr().is_terminal());
    let log = match config.format {
        LogFormat::Human => log.boxed(),
        LogFormat::Json => log.json().boxed(),
    };
    // Each has a filter of its own: what the log leaves out may be part of a trace.
    let both = tracing_subscriber::registry()
        .with(telemetry.map(Telemetry::layer))
        .with(log.with_filter(filter));
    // Fails only if a log is installed already.
    let _ = both.try_init();
    Ok(())
}
