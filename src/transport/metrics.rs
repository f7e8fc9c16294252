//! Names of everything measured here, and the one way to record each.

use crate::conversion::edit::method_name;
use metrics_exporter_prometheus::{BuildError, Matcher, PrometheusBuilder, PrometheusHandle};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use sutura_store::{
    Event, EventKind, Generation, GenerationRef, Load, SessionState, Store, TaskLoad,
};
use tokio::sync::broadcast::error::RecvError;

/// Upper bounds of the duration histograms' buckets, in s: from one reduced evaluation to a long
/// build.
const SECONDS_BUCKETS: [f64; 12] =
    [0.0005, 0.002, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0];

/// How often histogram samples are folded into their buckets between scrapes.
const UPKEEP_INTERVAL: Duration = Duration::from_secs(5);

/// Installs the process-wide recorder and describes every metric. Call once, from the daemon.
pub fn install_recorder() -> Result<PrometheusHandle, BuildError> {
    let handle = PrometheusBuilder::new()
        .set_buckets_for_metric(Matcher::Suffix("_seconds".into()), &SECONDS_BUCKETS)?
        .install_recorder()?;
    describe();
    sutura_store::describe_metrics();
    Ok(handle)
}

/// Keeps the recorder's memory bounded when nobody scrapes. Never returns.
pub(crate) async fn upkeep(handle: PrometheusHandle) {
    let mut interval = tokio::time::interval(UPKEEP_INTERVAL);
    loop {
        interval.tick().await;
        handle.run_upkeep();
    }
}

fn describe() {
    use metrics::{
        Unit::Bytes, Unit::Seconds, describe_counter, describe_gauge, describe_histogram,
    };
    describe_histogram!(HTTP_REQUEST, Seconds, "HTTP requests by method, route and status");
    describe_histogram!(BUS_QUERY, Seconds, "Zenoh queries by resource and status");
    describe_histogram!(EDIT_STAGE, Seconds, "Time in each stage of an edit, by method");
    describe_histogram!(BUILD_STAGE, Seconds, "Time in each stage of a body's first build");
    describe_counter!(BUILDS, "Builds ended, by outcome");
    describe_gauge!(SESSIONS, "Sessions held");
    describe_gauge!(SIMULATIONS, "Simulations running");
    describe_gauge!(TASKS, "Work of the store that waits and that runs, by kind");
    describe_gauge!(
        BODIES,
        Bytes,
        "Memory of all bodies, by tenant; what they share is counted once"
    );
    describe_gauge!(PROCESS, Bytes, "Resident memory of the process");
    describe_gauge!(STREAMS, "Open streams, by kind");
    describe_counter!(FRAMES_SENT, "State frames handed to a transport");
    describe_counter!(FRAMES_DROPPED, "State frames that a slow reader lost");
}

const HTTP_REQUEST: &str = "sutura_http_request_seconds";
const BUS_QUERY: &str = "sutura_bus_query_seconds";
const SHED: &str = "sutura_shed_total";
const EDIT_STAGE: &str = "sutura_edit_stage_seconds";
const BUILD_STAGE: &str = "sutura_build_stage_seconds";
const BUILDS: &str = "sutura_builds_total";
const SESSIONS: &str = "sutura_sessions";
const SIMULATIONS: &str = "sutura_simulations";
const TASKS: &str = "sutura_tasks";
const BODIES: &str = "sutura_body_bytes";
const PROCESS: &str = "process_resident_memory_bytes";
const STREAMS: &str = "sutura_streams";
const FRAMES_SENT: &str = "sutura_frames_sent_total";
const FRAMES_DROPPED: &str = "sutura_frames_dropped_total";

pub(crate) fn http_request(method: &str, route: &str, status: u16, took: Duration) {
    metrics::histogram!(HTTP_REQUEST, "method" => method.to_owned(), "route" => route.to_owned(),
        "status" => status.to_string())
    .record(took);
}

pub(crate) fn bus_query(resource: &'static str, status: u16, took: Duration) {
    metrics::histogram!(BUS_QUERY, "resource" => resource, "status" => status.to_string())
        .record(took);
}

pub(crate) fn shed(limit: &'static str) {
    metrics::counter!(SHED, "limit" => limit).increment(1);
}

fn edit_stage(method: &'static str, stage: &'static str, took: Duration) {
    metrics::histogram!(EDIT_STAGE, "method" => method, "stage" => stage).record(took);
}

fn build_stage(stage: &'static str, took: Duration) {
    metrics::histogram!(BUILD_STAGE, "stage" => stage).record(took);
}

fn build_ended(outcome: &'static str) {
    metrics::counter!(BUILDS, "outcome" => outcome).increment(1);
}

/// Records how busy the store is now.
pub(crate) fn load(load: Load) {
    metrics::gauge!(SESSIONS).set(load.n_sessions as f64);
    metrics::gauge!(SIMULATIONS).set(load.n_simulations as f64);
    for TaskLoad { kind, n_waiting, n_running } in load.tasks {
        for (state, count) in [("waiting", n_waiting), ("running", n_running)] {
            metrics::gauge!(TASKS, "kind" => kind, "state" => state).set(count as f64);
        }
    }
}

/// Tenants whose memory is shown one by one: the first that there are.
const MAX_TENANTS: usize = 32;

/// The tenants whose memory is shown one by one.
#[derive(Debug, Default)]
pub(crate) struct Tenants(BTreeSet<String>);

impl Tenants {
    /// Records what takes up memory now. Takes some time.
    pub(crate) fn memory(&mut self, store: &Store) {
        let mut by_tenant: BTreeMap<String, usize> = BTreeMap::new();
        for (tenant, n_bytes) in store.memory() {
            by_tenant.insert(tenant.unwrap_or_default(), n_bytes);
        }
        for tenant in by_tenant.keys() {
            if self.0.len() < MAX_TENANTS {
                self.0.insert(tenant.clone());
            }
        }
        for tenant in &self.0 {
            let n_bytes = by_tenant.remove(tenant).unwrap_or_default();
            metrics::gauge!(BODIES, "tenant" => tenant.clone()).set(n_bytes as f64);
        }
        let rest: usize = by_tenant.values().sum();
        metrics::gauge!(BODIES, "tenant" => "(all others)").set(rest as f64);
        if let Some(n_bytes) = resident_bytes() {
            metrics::gauge!(PROCESS).set(n_bytes);
        }
    }
}

/// Memory of this process that is resident; only Linux says it.
fn resident_bytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib * 1024.0)
}

pub(crate) fn frame_sent(transport: &'static str) {
    metrics::counter!(FRAMES_SENT, "transport" => transport).increment(1);
}

pub(crate) fn frames_dropped(transport: &'static str, count: u64) {
    metrics::counter!(FRAMES_DROPPED, "transport" => transport).increment(count);
}

/// Counts one open stream for as long as it lives.
pub(crate) struct OpenStream(&'static str);

impl OpenStream {
    pub(crate) fn new(kind: &'static str) -> OpenStream {
        metrics::gauge!(STREAMS, "kind" => kind).increment(1.0);
        OpenStream(kind)
    }
}

impl Drop for OpenStream {
    fn drop(&mut self) {
        metrics::gauge!(STREAMS, "kind" => self.0).decrement(1.0);
    }
}

/// Records what every build and edit took, whichever transport asked for it. Ends with the store.
pub(crate) async fn observe(store: Store) {
    let mut events = store.subscribe_all();
    loop {
        match events.recv().await {
            Ok(Event { session, kind: EventKind::Generation(number) }) => {
                if let Ok(made) = store.generation(session, GenerationRef::Number(number)) {
                    generation_made(&made);
                }
            }
            Ok(Event { kind: EventKind::State(SessionState::Failed), .. }) => build_ended("failed"),
            Ok(_) => {}
            Err(RecvError::Lagged(count)) => {
                tracing::warn!(count, "events went by too fast to be measured");
            }
            Err(RecvError::Closed) => return,
        }
    }
}

fn generation_made(generation: &Generation) {
    let stages = generation.artifacts.timings();
    match generation.made_by {
        Some(method) => {
            for (stage, took) in stages {
                edit_stage(method_name(method), stage.name(), *took);
            }
        }
        None => {
            // A body taken over from another session was not built again.
            if !generation.computed_in.is_zero() {
                for (stage, took) in stages {
                    build_stage(stage.name(), *took);
                }
            }
            build_ended("ready");
        }
    }
}
