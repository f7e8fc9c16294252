//! A daemon: the store with both its doors open. `sutura serve` is one; anything else in this
//! process can run one too.

use crate::config::Config;
use metrics_exporter_prometheus::PrometheusHandle;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use sutura_store::{LocalFiles, OpenError, StorageError, Store, StoreConfig};
use sutura_transport::bus::{self, Bus, BusError};
use sutura_transport::{Gateway, http};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// How long closing connections may take once all work has ended or been cancelled.
const CLOSING_GRACE: Duration = Duration::from_secs(2);

/// Why a daemon could not start.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StartError {
    /// The data directory cannot be used.
    #[error("cannot use the data directory: {0}")]
    Data(#[from] StorageError),
    /// The store could not be opened.
    #[error(transparent)]
    Store(#[from] OpenError),
    /// The store's threads could not be started.
    #[error("cannot start the worker threads: {0}")]
    Threads(#[from] std::io::Error),
    /// HTTP's address cannot be listened on.
    #[error("cannot listen on {address}: {source}")]
    Http {
        /// The address asked for.
        address: SocketAddr,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// Zenoh cannot be served.
    #[error(transparent)]
    Zenoh(#[from] BusError),
}

/// A running daemon.
pub(crate) struct Daemon {
    store: Store,
    bus: Bus,
    http_address: SocketAddr,
    stop_http: oneshot::Sender<()>,
    http: JoinHandle<std::io::Result<()>>,
    deadline: Duration,
}

impl Daemon {
    /// Starts a daemon that serves already when this returns. `recorder` is the process's (see
    /// [`sutura_transport::install_recorder`]).
    pub(crate) async fn start(
        config: &Config,
        recorder: PrometheusHandle,
    ) -> Result<Daemon, StartError> {
        let store_config = StoreConfig {
            work: config.work.clone(),
            limits: config.limits.clone(),
            memory: config.memory.store(),
        };
        let store = match &config.data.path.0 {
            None => Store::new(store_config)?,
            Some(path) => Store::open(store_config, Arc::new(LocalFiles::open(path)?))?,
        };
        let gateway = Gateway::new(store.clone(), config.traffic.clone(), recorder);
        let address = config.http.listen;
        let refused = |source| StartError::Http { address, source };
        let listener = TcpListener::bind(address).await.map_err(refused)?;
        let http_address = listener.local_addr().map_err(refused)?;
        for address in [address, config.zenoh.listen.0] {
            if !address.ip().is_loopback() {
                tracing::warn!(%address, "open to the network, and nobody is asked who they are");
            }
        }
        let bus = bus::open(&gateway, config.zenoh.bus()).await?;
        let (stop_http, stopped) = oneshot::channel();
        let http = tokio::spawn(http::serve(gateway, listener, async {
            // Dropping the daemon stops it too.
            let _ = stopped.await;
        }));
        let deadline = config.shutdown.deadline;
        Ok(Daemon { store, bus, http_address, stop_http, http, deadline })
    }

    /// Base of every HTTP address of this daemon: `http://127.0.0.1:8080`.
    pub(crate) fn http_url(&self) -> String {
        format!("http://{}", self.http_address)
    }

    /// The endpoint that Zenoh clients connect to: `tcp/127.0.0.1:7447`.
    pub(crate) fn zenoh_endpoint(&self) -> String {
        self.bus.endpoint()
    }

    /// Takes no new work, cancels builds, lets edits and requests under way finish until the
    /// configured deadline, then closes both doors.
    pub(crate) async fn stop(self) {
        let _ = self.stop_http.send(());
        if !self.store.shutdown(self.deadline).await {
            tracing::warn!("some work did not stop in time and is left behind");
        }
        match timeout(CLOSING_GRACE, self.bus.close()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "Zenoh did not close cleanly"),
            Err(_) => tracing::warn!("Zenoh did not close in time"),
        }
        match timeout(CLOSING_GRACE, self.http).await {
            Ok(Ok(Ok(()))) => {}
            Ok(Ok(Err(error))) => tracing::warn!(%error, "HTTP did not end cleanly"),
            Ok(Err(error)) => tracing::error!(%error, "HTTP ended unexpectedly"),
            Err(_) => tracing::warn!("some HTTP connections did not close in time"),
        }
        tracing::info!("stopped");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DataPath;
    use sutura_client::{Client, ZenohClient};

    #[tokio::test(flavor = "multi_thread")]
    async fn a_daemon_serves_both_doors_from_its_start_to_its_stop() {
        let mut config = Config::default();
        config.data.path = DataPath(None);
        config.http.listen.set_port(0);
        config.zenoh.listen.0.set_port(0);
        config.zenoh.daemon = Some("door-keeper".into());
        let recorder = sutura_transport::install_recorder().unwrap();
        let daemon = Daemon::start(&config, recorder.clone()).await.unwrap();
        let (url, endpoint) = (daemon.http_url(), daemon.zenoh_endpoint());

        let http = Client::connect(&url).await.unwrap();
        assert!(http.list(None, 10).await.unwrap().sessions.is_empty());
        let zenoh = ZenohClient::open(&endpoint).await.unwrap();
        assert_eq!(zenoh.daemons().await.unwrap(), ["door-keeper"]);
        zenoh.close().await.unwrap();

        // A second daemon finds the address taken, and says which.
        config.http.listen = url.strip_prefix("http://").unwrap().parse().unwrap();
        let refused = Daemon::start(&config, recorder).await.err().unwrap();
        assert!(refused.to_string().contains(&config.http.listen.to_string()), "{refused}");

        daemon.stop().await;
        assert!(Client::connect(&url).await.is_err());
    }
}
