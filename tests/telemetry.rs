//! Traces that the daemon exports to an OpenTelemetry collector.

use crate::bodies::{ready_bar, seam, stitch};
use crate::daemon::{Daemon, PATIENCE};
use crate::plain_http::plain_http;
use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::routing::post;
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::{KeyValue, any_value::Value};
use opentelemetry_proto::tonic::trace::v1::span::SpanKind;
use opentelemetry_proto::tonic::trace::v1::{ResourceSpans, Span};
use prost::Message;
use std::ffi::OsStr;
use std::fs::File;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use sutura_client::Session;

/// What the collector asks for, in the header `x-token`.
pub(crate) const TOKEN: &str = "nobody-else-knows";

/// A trace of somebody who asks, and the span of it that the request belongs to.
const CALLER: ([u8; 16], [u8; 8]) = ([0xa1; 16], [0xb2; 8]);

type Received = Arc<Mutex<Vec<ExportTraceServiceRequest>>>;

/// A collector that keeps what it is sent by those who know the token.
pub(crate) struct Collector {
    endpoint: String,
    received: Received,
}

impl Collector {
    pub(crate) async fn start() -> Collector {
        async fn take(
            State(received): State<Received>,
            headers: HeaderMap,
            body: Bytes,
        ) -> StatusCode {
            if headers.get("x-token").is_none_or(|token| token != TOKEN) {
                return StatusCode::UNAUTHORIZED;
            }
            assert_eq!(headers["content-type"], "application/x-protobuf");
            let request = ExportTraceServiceRequest::decode(body).unwrap();
            received.lock().unwrap().push(request);
            StatusCode::OK
        }
        let received = Received::default();
        let router = Router::new().route("/v1/traces", post(take)).with_state(received.clone());
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("http://{}", listener.local_addr().unwrap());
        tokio::spawn(async { axum::serve(listener, router).await.unwrap() });
        Collector { endpoint, received }
    }

    /// A daemon's configuration that names it.
    pub(crate) fn settings(&self) -> String {
        format!(
            "[telemetry]\notlp_endpoint = \"{}\"\notlp_headers = {{ x-token = \"{TOKEN}\" }}\n\
             export_interval_s = 0.1\n",
            self.endpoint
        )
    }

    fn resources(&self) -> Vec<ResourceSpans> {
        let received = self.received.lock().unwrap();
        received.iter().flat_map(|request| request.resource_spans.clone()).collect()
    }

    pub(crate) fn spans(&self) -> Vec<Span> {
        let scopes = self.resources().into_iter().flat_map(|resource| resource.scope_spans);
        scopes.flat_map(|scope| scope.spans).collect()
    }
}

/// A daemon with these settings in a folder, where its log goes to `log`.
fn start(folder: &Path, settings: &str, level: &str) -> Daemon {
    start_as(Command::new(env!("CARGO_BIN_EXE_sutura")), folder, settings, level)
}

fn start_as(sutura: Command, folder: &Path, settings: &str, level: &str) -> Daemon {
    let config = folder.join("sutura.toml");
    std::fs::write(&config, settings).unwrap();
    let arguments = [OsStr::new("--config"), config.as_os_str()];
    let log = File::create(folder.join("log")).unwrap();
    Daemon::launch(sutura, &folder.join("data"), &arguments, level, Stdio::from(log))
}

fn log(folder: &Path) -> String {
    std::fs::read_to_string(folder.join("log")).unwrap()
}

/// Stitches one pair of the seam over HTTP, with these headers.
async fn edit(daemon: &Daemon, session: &Session, pair: usize, headers: &[(&str, &str)]) {
    let url = daemon.url(&format!("/v1/sessions/{}/edits", session.id()));
    let request = plain_http().post(url).json(&stitch(&seam()[pair..=pair]));
    let request =
        headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
    assert_eq!(request.send().await.unwrap().status(), 200);
}

/// The header by which a request names [`CALLER`], who has it sampled.
fn traceparent() -> String {
    let (trace, span) = CALLER;
    format!("00-{:032x}-{:016x}-01", u128::from_be_bytes(trace), u64::from_be_bytes(span))
}

fn text(attributes: &[KeyValue], key: &str) -> Option<String> {
    let found = attributes.iter().find(|pair| pair.key == key)?;
    match found.value.clone()?.value? {
        Value::StringValue(text) => Some(text),
        other => Some(format!("{other:?}")),
    }
}

/// The span that this name was given to.
fn requested<'a>(spans: &'a [Span], request_id: &str) -> &'a Span {
    let is_called =
        |span: &&Span| text(&span.attributes, "request_id").as_deref() == Some(request_id);
    spans.iter().find(is_called).unwrap_or_else(|| panic!("no span of {request_id}"))
}

/// The span of this name within another one.
fn within<'a>(spans: &'a [Span], parent: &Span, name: &str) -> &'a Span {
    let is_child = |span: &&Span| span.parent_span_id == parent.span_id && span.name == name;
    let child =
        spans.iter().find(is_child).unwrap_or_else(|| panic!("no {name} in {}", parent.name));
    assert_eq!(child.trace_id, parent.trace_id);
    assert!(parent.start_time_unix_nano <= child.start_time_unix_nano, "{name}");
    assert!(child.start_time_unix_nano <= child.end_time_unix_nano, "{name}");
    child
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edit_is_one_trace_down_to_the_stages_by_either_door() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let collector = Collector::start().await;
    let settings = format!(
        "{}service_name = \"theatre\"\n[zenoh]\ndaemon = \"theatre-2\"\n",
        collector.settings()
    );
    let daemon = start(folder, &settings, "debug,zenoh=warn");
    let session = ready_bar(&daemon).await;
    let parent = traceparent();
    edit(&daemon, &session, 0, &[("x-request-id", "over-http"), ("traceparent", &parent)]).await;
    let zenoh = daemon.zenoh_client().await;
    let of_zenoh = zenoh.session(session.id()).unwrap().with_request_id("over-zenoh");
    of_zenoh.edit(&stitch(&seam()[1..2])).await.unwrap();
    // Sending spans makes none: they come to an end.
    let begun = Instant::now();
    let mut n_spans = 0;
    while n_spans == 0 || collector.spans().len() > n_spans {
        assert!(begun.elapsed() < PATIENCE, "there are more and more spans");
        n_spans = collector.spans().len();
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    assert!(daemon.terminate().success());

    let spans = collector.spans();
    for (request_id, name) in
        [("over-http", "POST /v1/sessions/{id}/edits"), ("over-zenoh", "query edits")]
    {
        let request = requested(&spans, request_id);
        assert_eq!((&*request.name, request.kind()), (name, SpanKind::Server));
        let task = within(&spans, request, "edit task");
        let edit = within(&spans, task, "edit");
        assert_eq!(text(&edit.attributes, "session").as_deref(), Some(session.id()));
        for stage in ["modes", "derivatives", "basis", "cubature", "reduction", "rest"] {
            within(&spans, edit, stage);
        }
        assert!(edit.events.iter().any(|event| event.name == "generation ready"), "{edit:?}");
    }
    let (trace, span) = CALLER;
    let over_http = requested(&spans, "over-http");
    assert_eq!((&over_http.trace_id[..], &over_http.parent_span_id[..]), (&trace[..], &span[..]));
    let status = text(&over_http.attributes, "http.response.status_code");
    assert_eq!(status.as_deref(), Some("IntValue(200)"));
    let over_zenoh = requested(&spans, "over-zenoh");
    assert!(over_zenoh.parent_span_id.is_empty() && over_zenoh.trace_id != trace);
    let ids: Vec<_> = spans.iter().map(|span| &span.span_id).collect();
    assert!(spans.iter().all(|span| span.trace_id == trace
        || span.parent_span_id.is_empty()
        || ids.contains(&&span.parent_span_id)));

    for resource in collector.resources() {
        let attributes = resource.resource.unwrap().attributes;
        assert_eq!(text(&attributes, "service.name").as_deref(), Some("theatre"));
        assert_eq!(text(&attributes, "service.instance.id").as_deref(), Some("theatre-2"));
    }
    let log = log(folder);
    assert!(log.contains("over-http") && !log.contains(TOKEN), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_exported_unless_the_configuration_says_where() {
    let scratch = tempfile::tempdir().unwrap();
    let collector = Collector::start().await;
    let mut sutura = Command::new(env!("CARGO_BIN_EXE_sutura"));
    sutura.env("OTEL_EXPORTER_OTLP_ENDPOINT", &collector.endpoint);
    sutura.env("OTEL_EXPORTER_OTLP_HEADERS", format!("x-token={TOKEN}"));
    let daemon = start_as(sutura, scratch.path(), "[telemetry]\nexport_interval_s = 0.1\n", "info");
    let session = ready_bar(&daemon).await;
    edit(&daemon, &session, 0, &[("traceparent", &traceparent())]).await;
    assert!(daemon.terminate().success());
    assert!(collector.spans().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_share_of_traces_is_exported_and_those_whose_caller_wants_it() {
    let scratch = tempfile::tempdir().unwrap();
    let collector = Collector::start().await;
    let settings = format!("{}sampling_ratio = 0.0\n", collector.settings());
    let daemon = start(scratch.path(), &settings, "warn");
    let session = ready_bar(&daemon).await;
    edit(&daemon, &session, 0, &[("x-request-id", "left-out")]).await;
    edit(&daemon, &session, 1, &[("traceparent", &traceparent())]).await;
    assert!(daemon.terminate().success());
    let spans = collector.spans();
    assert!(!spans.is_empty() && spans.iter().all(|span| span.trace_id == CALLER.0), "{spans:?}");
}

/// Does what a daemon does with a collector that takes nothing; returns the log.
async fn works_without(endpoint: &str) -> String {
    let scratch = tempfile::tempdir().unwrap();
    // Whatever waited for the collector would wait for much longer than is waited here.
    let settings = format!(
        "[telemetry]\notlp_endpoint = \"{endpoint}\"\nexport_interval_s = 0.05\n\
         export_timeout_s = 600.0\nspan_queue_limit = 4\n[shutdown]\ndeadline_s = 2.0\n"
    );
    let daemon = start(scratch.path(), &settings, "info,zenoh=warn");
    let session = ready_bar(&daemon).await;
    let begun = Instant::now();
    for pair in 0..4 {
        edit(&daemon, &session, pair, &[]).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert!(begun.elapsed() < PATIENCE);
    let begun = Instant::now();
    assert!(daemon.terminate().success());
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    log(scratch.path())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_collector_that_takes_nothing_disturbs_nobody() {
    let complaints = |log: &str| log.matches(" spans were not exported").count();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    // Connections come about, and nobody answers.
    let log = works_without(&endpoint).await;
    assert!(log.contains("stopped"), "{log}");
    drop(listener);
    let log = works_without(&endpoint).await;
    assert_eq!(complaints(&log), 1, "of one that is down: {log}");
    assert!(log.to_lowercase().contains("refused"), "{log}");
    let strict = Collector::start().await;
    let log = works_without(&strict.endpoint).await;
    assert_eq!(complaints(&log), 1, "of one that refuses: {log}");
    assert!(log.contains("401"), "{log}");
}
