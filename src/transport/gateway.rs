//! What both transports share: the store, the limits, and the signal to wind down.

use crate::access::{Caller, Keyring};
use crate::limits::Limits;
use crate::metrics;
use crate::problem::{Kind, Problem};
use crate::rate::Rates;
use metrics_exporter_prometheus::PrometheusHandle;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Instant;
use sutura_store::Store;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

/// The store as both transports see it. Cheap to clone; all clones are the same gateway.
#[derive(Clone)]
pub struct Gateway {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    limits: Limits,
    recorder: PrometheusHandle,
    rates: Rates,
    requests: Arc<Semaphore>,
    uploads: Arc<Semaphore>,
    streams: Arc<Semaphore>,
    winding_down: watch::Sender<bool>,
    tenants: Mutex<metrics::Tenants>,
    keys: watch::Sender<Arc<Keyring>>,
    continue_trace: OnceLock<ContinueTrace>,
}

/// Makes the span of a request part of the trace that its headers name, if they do.
pub type ContinueTrace = fn(&tracing::Span, &axum::http::HeaderMap);

impl Gateway {
    /// Opens `store` to clients within `limits`; `recorder` renders `/metrics`.
    pub fn new(store: Store, limits: Limits, recorder: PrometheusHandle) -> Gateway {
        let inner = Inner {
            rates: Rates::new(limits.max_requests_per_s, limits.max_request_burst),
            requests: Arc::new(Semaphore::new(limits.max_requests)),
            uploads: Arc::new(Semaphore::new(limits.max_uploads)),
            streams: Arc::new(Semaphore::new(limits.max_streams)),
            winding_down: watch::Sender::new(false),
            tenants: Mutex::default(),
            keys: watch::Sender::default(),
            continue_trace: OnceLock::new(),
            store,
            limits,
            recorder,
        };
        Gateway { inner: Arc::new(inner) }
    }

    /// The store behind both transports.
    pub fn store(&self) -> &Store {
        &self.inner.store
    }

    /// The bounds in force.
    pub fn limits(&self) -> &Limits {
        &self.inner.limits
    }

    /// Asks everybody for one of these keys from now on, unless they leave the daemon open.
    pub fn set_keys(&self, keys: Keyring) {
        self.inner.keys.send_replace(Arc::new(keys));
    }

    /// From now on requests over HTTP take part in the traces of those who ask. Only the first call counts.
    pub fn continue_traces(&self, by: ContinueTrace) {
        let _ = self.inner.continue_trace.set(by);
    }

    /// How a request takes part in the trace of whoever asks.
    pub(crate) fn continue_trace(&self) -> Option<ContinueTrace> {
        self.inner.continue_trace.get().copied()
    }

    /// The keys that open the daemon.
    pub(crate) fn keys(&self) -> Arc<Keyring> {
        self.inner.keys.borrow().clone()
    }

    /// Tells when there are others.
    pub(crate) fn watch_keys(&self) -> watch::Receiver<Arc<Keyring>> {
        self.inner.keys.subscribe()
    }

    pub(crate) fn recorder(&self) -> &PrometheusHandle {
        &self.inner.recorder
    }

    /// Records what takes up memory now; for a thread that may take its time.
    pub(crate) fn measure_memory(&self) {
        let mut tenants = self.inner.tenants.lock().unwrap_or_else(PoisonError::into_inner);
        tenants.memory(self.store());
    }

    /// Says goodbye: `/readyz` turns to 503 and streams end, so that their connections can close.
    /// Requests under way are still answered.
    pub fn wind_down(&self) {
        self.inner.winding_down.send_replace(true);
    }

    pub(crate) fn is_winding_down(&self) -> bool {
        *self.inner.winding_down.borrow()
    }

    /// Returns once [`Gateway::wind_down`] has been called.
    pub(crate) async fn wound_down(&self) {
        // Fails only when the sender is gone, and `self` holds it.
        let _ = self.inner.winding_down.subscribe().wait_for(|begun| *begun).await;
    }

    /// Returns once no stream is open any more, or those that are have had their time to end.
    pub(crate) async fn streams_ended(&self) {
        let n_places = u32::try_from(self.inner.limits.max_streams).unwrap_or(u32::MAX);
        let all = self.inner.streams.acquire_many(n_places);
        if tokio::time::timeout(self.inner.limits.max_send_wait, all).await.is_err() {
            tracing::warn!("streams were cut off");
        }
    }

    /// Whoever shows `key`, unless they come too often.
    pub(crate) fn let_in(&self, key: Option<&str>) -> Result<Caller, Problem> {
        let caller = self.keys().identify(key);
        // Those without a valid key count together.
        let tenant = caller.as_ref().ok().and_then(Caller::tenant);
        self.inner.rates.take(tenant, Instant::now()).map_err(|wait| {
            metrics::shed("rate");
            let per_s = self.limits().max_requests_per_s;
            Problem::new(Kind::TooOften, format!("more than {per_s} requests a second"))
                .retry_after(wait.as_secs_f64().ceil().max(1.0) as u64)
        })?;
        caller
    }

    /// One of the places for requests under way.
    pub(crate) fn admit_request(&self) -> Result<OwnedSemaphorePermit, Problem> {
        try_acquire(&self.inner.requests, "requests")
    }

    /// One of the places for open streams.
    pub(crate) fn admit_stream(&self) -> Result<OwnedSemaphorePermit, Problem> {
        try_acquire(&self.inner.streams, "streams")
    }

    /// One of the places for uploads, after a short wait if none is free.
    pub(crate) async fn admit_upload(&self) -> Result<OwnedSemaphorePermit, Problem> {
        let turn = Arc::clone(&self.inner.uploads).acquire_owned();
        match tokio::time::timeout(self.inner.limits.max_upload_queue_wait, turn).await {
            Ok(Ok(permit)) => Ok(permit),
            _ => Err(shed("uploads")),
        }
    }
}

fn try_acquire(
    places: &Arc<Semaphore>,
    what: &'static str,
) -> Result<OwnedSemaphorePermit, Problem> {
    Arc::clone(places).try_acquire_owned().map_err(|_| shed(what))
}

/// Counts and describes a refusal for want of a place.
pub(crate) fn shed(what: &'static str) -> Problem {
    metrics::shed(what);
    Problem::new(Kind::Busy, format!("too many {what} at the same time; try again shortly"))
        .retry_after(1)
}
