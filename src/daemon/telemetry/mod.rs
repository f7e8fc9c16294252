//! Traces for an OpenTelemetry collector: the daemon's spans, sent over OTLP, if the configuration names one.
//!
//! Nobody waits for that: a span that has ended goes into a queue of bounded length, from which a thread of its own
//! hands batches to [`Collector`]. Where the queue is full, the span is lost.

mod collector;
mod shape;

pub(crate) use collector::Collector;

use crate::config::{BadHeader, TelemetryConfig};
use opentelemetry::KeyValue;
use opentelemetry::propagation::{Extractor, TextMapPropagator};
use opentelemetry::trace::TracerProvider;
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::{
    BatchConfigBuilder, BatchSpanProcessor, Sampler, SdkTracerProvider, SpanLimits,
};
use reqwest::header::HeaderMap;
use std::time::Duration;
use tracing::{Level, Metadata, Span};
use tracing_opentelemetry::OpenTelemetrySpanExt;
use tracing_subscriber::filter::{LevelFilter, filter_fn};
use tracing_subscriber::{Layer, Registry};

/// Most spans in one batch.
const MAX_BATCH: usize = 512;

/// Why nothing can be exported.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TelemetryError {
    /// What is to be sent along cannot be.
    #[error(transparent)]
    Header(#[from] BadHeader),
    /// There is no way to speak HTTP.
    #[error("cannot export traces: {0}")]
    Client(reqwest::Error),
}

/// The way of spans to the collector.
pub(crate) struct Telemetry {
    provider: SdkTracerProvider,
    /// How long the collector may take to accept the last spans.
    timeout: Duration,
}

impl Telemetry {
    /// Opens the way for the daemon of this name, if there is a collector; whether it answers shows later. What is
    /// sent goes by the runtime on which this is called.
    pub(crate) fn start(
        config: &TelemetryConfig,
        daemon: &str,
    ) -> Result<Option<Telemetry>, TelemetryError> {
        let Some(collector) = Collector::of(config)? else { return Ok(None) };
        // Resource, sampler and limits all have defaults that read the environment: none is left to them.
        let instance = config.service_instance.as_deref().unwrap_or(daemon);
        let resource = Resource::builder_empty()
            .with_service_name(config.service_name.clone())
            .with_attributes([
                KeyValue::new("service.version", env!("CARGO_PKG_VERSION")),
                KeyValue::new("service.instance.id", instance.to_owned()),
            ])
            .build();
        let batches = BatchConfigBuilder::default()
            .with_max_queue_size(config.span_queue_limit)
            .with_max_export_batch_size(MAX_BATCH.min(config.span_queue_limit))
            .with_scheduled_delay(config.export_interval)
            .build();
        let queue = BatchSpanProcessor::builder(collector).with_batch_config(batches).build();
        let provider = SdkTracerProvider::builder()
            .with_resource(resource)
            .with_sampler(Sampler::ParentBased(Box::new(Sampler::TraceIdRatioBased(
                config.sampling_ratio,
            ))))
            .with_span_limits(SpanLimits::default())
            .with_span_processor(queue)
            .build();
        Ok(Some(Telemetry { provider, timeout: config.export_timeout }))
    }

    /// What listens to the daemon's spans.
    pub(crate) fn layer(&self) -> impl Layer<Registry> + use<> {
        tracing_opentelemetry::layer()
            .with_tracer(self.provider.tracer("sutura"))
            .with_location(false)
            .with_threads(false)
            .with_target(false)
            .with_context_activation(false)
            .with_filter(filter_fn(is_ours).with_max_level_hint(LevelFilter::DEBUG))
    }

    /// Sends what waits, for at most `within`; what has not been sent then is lost.
    pub(crate) async fn stop(self, within: Duration) {
        let Telemetry { provider, timeout } = self;
        let flush = move || provider.shutdown_with_timeout(within.min(timeout));
        match tokio::task::spawn_blocking(flush).await {
            Ok(Ok(())) => {}
            // The log has it already, from the queue itself.
            Ok(Err(error)) => tracing::debug!(%error, "the last spans did not leave in time"),
            Err(error) => tracing::error!(%error, "ending the export of spans failed"),
        }
    }
}

/// Whether a trace shows this: spans down to the stages of a build, and what the log says within them. Of our own
/// crates alone: sending spans makes none.
fn is_ours(metadata: &Metadata<'_>) -> bool {
    let finest = if metadata.is_span() { Level::DEBUG } else { Level::INFO };
    metadata.target().starts_with("sutura") && *metadata.level() <= finest
}

/// Makes the span of a request part of the trace that its headers name (W3C Trace Context), if they do.
pub(crate) fn continue_trace(span: &Span, headers: &HeaderMap) {
    if headers.contains_key("traceparent") {
        let caller = TraceContextPropagator::new().extract(&Headers(headers));
        // Fails only where no spans are exported.
        let _ = span.set_parent(caller);
    }
}

struct Headers<'a>(&'a HeaderMap);

impl Extractor for Headers<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key)?.to_str().ok()
    }

    fn keys(&self) -> Vec<&str> {
        self.0.keys().map(|name| name.as_str()).collect()
    }
}
