//! The collector, and what becomes of the batches that it is sent.

use super::TelemetryError;
use super::shape::shaped;
use crate::config::TelemetryConfig;
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTraceServiceRequest, ExportTraceServiceResponse,
};
use opentelemetry_proto::transform::common::tonic::ResourceAttributesWithSchema;
use opentelemetry_proto::transform::trace::tonic::group_spans_by_resource_and_scope;
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::trace::{SpanData, SpanExporter};
use prost::Message;
use reqwest::header::{CONTENT_TYPE, HeaderMap, HeaderValue};
use reqwest::redirect::Policy;
use reqwest::{Client, StatusCode, Url};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;

/// Longest answer that is read, in bytes.
const MAX_ANSWER_BYTES: usize = 64 << 10;

/// Shortest time between two lines of the log about spans that were lost.
const COMPLAINT_INTERVAL: Duration = Duration::from_secs(60);

/// Why a batch was lost, or a part of it.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ExportError {
    /// It did not get there, or no answer came.
    #[error("{}", innermost(.0))]
    Unreachable(reqwest::Error),
    /// The collector does not take it.
    #[error("the collector answers {0}")]
    Refused(StatusCode),
    /// The collector took the rest.
    #[error("the collector rejected {n_spans} spans: {why}")]
    Rejected {
        /// How many it did not take.
        n_spans: u64,
        /// What it says about them.
        why: String,
    },
    /// The daemon is ending.
    #[error("the daemon ends")]
    Ending,
}

/// What went wrong at the bottom: what stands above it only says that sending did.
fn innermost(error: &reqwest::Error) -> String {
    if error.is_timeout() {
        return "no answer in time".to_owned();
    }
    let mut source: &dyn std::error::Error = error;
    while let Some(next) = source.source() {
        source = next;
    }
    source.to_string()
}

/// An OpenTelemetry collector that takes OTLP over HTTP.
#[derive(Debug)]
pub(crate) struct Collector {
    door: Door,
    resource: ResourceAttributesWithSchema,
    runtime: Handle,
    losses: Mutex<Losses>,
}

/// Where batches go in.
#[derive(Clone, Debug)]
struct Door {
    http: Client,
    traces: Url,
    headers: HeaderMap,
}

/// What was lost since somebody was told.
#[derive(Debug, Default)]
struct Losses {
    n_spans: u64,
    told: Option<Instant>,
}

impl Collector {
    /// The one that is configured, if there is one. What is sent goes by the runtime on which this is called.
    pub(crate) fn of(config: &TelemetryConfig) -> Result<Option<Collector>, TelemetryError> {
        let Some(endpoint) = &config.otlp_endpoint else { return Ok(None) };
        let mut headers = config.headers()?;
        headers.insert(CONTENT_TYPE, HeaderValue::from_static("application/x-protobuf"));
        // Fails only if there is one already.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let http = Client::builder()
            .timeout(config.export_timeout)
            // What authenticates is for this address alone, and the environment does not say where things go.
            .redirect(Policy::none())
            .no_proxy()
            .build()
            .map_err(TelemetryError::Client)?;
        Ok(Some(Collector {
            door: Door { http, traces: endpoint.traces(), headers },
            resource: ResourceAttributesWithSchema::default(),
            runtime: Handle::current(),
            losses: Mutex::default(),
        }))
    }

    /// Sends a batch without spans: whether the collector is there, and takes what we send.
    pub(crate) async fn probe(&self) -> Result<(), ExportError> {
        self.door.send(Vec::new()).await
    }

    /// Tells of lost spans, once in a while.
    fn complain(&self, n_spans: u64, error: &ExportError) {
        let mut losses = self.losses.lock().unwrap_or_else(PoisonError::into_inner);
        losses.n_spans += n_spans;
        if losses.told.is_none_or(|told| told.elapsed() >= COMPLAINT_INTERVAL) {
            tracing::warn!(n_spans = losses.n_spans, %error, "spans were not exported");
            *losses = Losses { n_spans: 0, told: Some(Instant::now()) };
        }
    }
}

impl SpanExporter for Collector {
    async fn export(&self, batch: Vec<SpanData>) -> OTelSdkResult {
        let n_spans = batch.len() as u64;
        let spans = batch.into_iter().map(shaped).collect();
        let request = ExportTraceServiceRequest {
            resource_spans: group_spans_by_resource_and_scope(spans, &self.resource),
        };
        // The thread that asks belongs to no runtime.
        let (door, body) = (self.door.clone(), request.encode_to_vec());
        let sending = self.runtime.spawn(async move { door.send(body).await });
        let lost = match sending.await.unwrap_or(Err(ExportError::Ending)) {
            Ok(()) => return Ok(()),
            Err(ExportError::Rejected { n_spans, why }) => {
                (n_spans, ExportError::Rejected { n_spans, why })
            }
            Err(error) => (n_spans, error),
        };
        self.complain(lost.0, &lost.1);
        // It has been dealt with: of an error the log would hear with every batch.
        Ok(())
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.resource = resource.into();
    }
}

impl Door {
    async fn send(&self, body: Vec<u8>) -> Result<(), ExportError> {
        let request = self.http.post(self.traces.clone()).headers(self.headers.clone()).body(body);
        let mut answer = request.send().await.map_err(ExportError::Unreachable)?;
        if !answer.status().is_success() {
            return Err(ExportError::Refused(answer.status()));
        }
        let mut told = Vec::new();
        while let Some(chunk) = answer.chunk().await.map_err(ExportError::Unreachable)? {
            if told.len() + chunk.len() > MAX_ANSWER_BYTES {
                return Ok(());
            }
            told.extend_from_slice(&chunk);
        }
        // An answer that cannot be read is still one of success.
        let told = ExportTraceServiceResponse::decode(&*told).unwrap_or_default();
        match told.partial_success {
            Some(partly) if partly.rejected_spans > 0 => Err(ExportError::Rejected {
                n_spans: partly.rejected_spans.unsigned_abs(),
                why: partly.error_message,
            }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opentelemetry_proto::tonic::collector::trace::v1::ExportTracePartialSuccess;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    /// What becomes of a batch if the collector answers this.
    async fn answered(head: &str, body: &[u8]) -> Result<(), String> {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("http://{}", listener.local_addr().unwrap());
        let length = format!("content-length: {}\r\nconnection: close\r\n\r\n", body.len());
        let answer = [b"HTTP/1.1 ", head.as_bytes(), b"\r\n", length.as_bytes(), body].concat();
        tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let n_read = stream.read(&mut [0; 4096]).await.unwrap();
            assert!(n_read > 0);
            // Whoever has heard enough hangs up.
            let _ = stream.write_all(&answer).await;
        });
        let otlp_endpoint = Some(endpoint.try_into().unwrap());
        let config = TelemetryConfig { otlp_endpoint, ..TelemetryConfig::default() };
        let collector = Collector::of(&config).unwrap().unwrap();
        collector.probe().await.map_err(|error| error.to_string())
    }

    #[tokio::test]
    async fn what_a_collector_says_is_heard() {
        let rejected = |rejected_spans| {
            let error_message = "no room".to_owned();
            let partial_success = Some(ExportTracePartialSuccess { rejected_spans, error_message });
            ExportTraceServiceResponse { partial_success }.encode_to_vec()
        };
        let long = vec![0; 10 * MAX_ANSWER_BYTES];
        for taken in [b"", &rejected(0)[..], b"no protobuf", &long] {
            assert_eq!(answered("200 OK", taken).await, Ok(()));
        }
        for (head, body, told) in [
            ("200 OK", rejected(3), "rejected 3 spans: no room"),
            ("413 Content Too Large", Vec::new(), "413"),
            ("302 Found\r\nlocation: http://127.0.0.1:1/", Vec::new(), "302"),
        ] {
            let error = answered(head, &body).await.unwrap_err();
            assert!(error.contains(told), "{error}");
        }
    }
}
