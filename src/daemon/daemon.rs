//! A daemon: the store with both its doors open. `sutura serve` is one; anything else in this
//! process can run one too.

use crate::config::{Config, HalfTls, NoCredentials};
use crate::keys::{KeyError, KeyStore};
use crate::telemetry::continue_trace;
use metrics_exporter_prometheus::PrometheusHandle;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use sutura_objects::{Objects, S3Config};
use sutura_store::{LocalFiles, OpenError, StorageError, Store, StoreConfig};
use sutura_transport::bus::{self, Bus, BusError};
use sutura_transport::{Gateway, Keyring, Tls, TlsError, http};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// How long closing connections may take once all work has ended or been cancelled.
const CLOSING_GRACE: Duration = Duration::from_secs(2);

/// How often the file of keys is looked at.
const KEYS_INTERVAL: Duration = Duration::from_secs(2);

/// Why a daemon could not start.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StartError {
    /// The data directory cannot be used.
    #[error("cannot use the data directory: {0}")]
    Data(#[from] StorageError),
    /// Nobody is named who may use the object store.
    #[error(transparent)]
    NoCredentials(#[from] NoCredentials),
    /// The object store cannot be used.
    #[error("cannot use the object store: {0}")]
    ObjectStore(StorageError),
    /// The keys cannot be read.
    #[error(transparent)]
    Keys(#[from] KeyError),
    /// Everybody on the network could do everything.
    #[error(
        "{address} is not loopback, and there are no keys: make one (sutura key new --help), or set allow_open_network in [access]"
    )]
    Open {
        /// The address asked for.
        address: SocketAddr,
    },
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
    /// The certificate is not there.
    #[error(transparent)]
    HalfTls(#[from] HalfTls),
    /// The certificate cannot be used.
    #[error("the certificate cannot be used: {0}")]
    Tls(#[from] TlsError),
}

/// Takes over the keys that are made and revoked while the daemon runs. When the last one has gone, nobody
/// is let in; the next start is open again.
async fn watch_keys(keys: KeyStore, mut known: Keyring, gateway: Gateway) {
    loop {
        tokio::time::sleep(KEYS_INTERVAL).await;
        let read = {
            let keys = keys.clone();
            tokio::task::spawn_blocking(move || keys.keyring()).await
        };
        match read {
            Ok(Ok(keyring)) if keyring != known && !(keyring.is_empty() && known.is_open()) => {
                tracing::info!(n_keys = keyring.len(), "keys taken over");
                gateway.set_keys(keyring.clone());
                known = keyring;
            }
            Ok(Ok(_)) => {}
            Ok(Err(error)) => tracing::warn!(%error, "keys not read; those known go on"),
            Err(error) => tracing::error!(%error, "reading keys failed"),
        }
    }
}

/// The sessions of an object store, as the daemon of this name. Waits for the network on a thread that may.
async fn open_fleet(
    config: StoreConfig,
    s3: S3Config,
    daemon: String,
) -> Result<Store, StartError> {
    let open = move || {
        let objects = Objects::s3(&s3, &daemon).map_err(StartError::ObjectStore)?;
        tracing::info!(
            bucket = s3.bucket,
            prefix = s3.prefix,
            daemon,
            "sessions are kept in an object store"
        );
        Ok(Store::open(config, Arc::new(objects))?)
    };
    tokio::task::spawn_blocking(open).await.map_err(std::io::Error::other)?
}

/// A running daemon.
pub(crate) struct Daemon {
    store: Store,
    bus: Bus,
    tls: Option<Arc<Tls>>,
    http_address: SocketAddr,
    stop_http: oneshot::Sender<()>,
    http: JoinHandle<std::io::Result<()>>,
    watch_keys: Option<JoinHandle<()>>,
    deadline: Duration,
}

impl Daemon {
    /// Starts a daemon that serves already when this returns. `recorder` is the process's (see
    /// [`sutura_transport::install_recorder`]).
    pub(crate) async fn start(
        config: &Config,
        recorder: PrometheusHandle,
    ) -> Result<Daemon, StartError> {
        let tls_files = config.tls.files()?;
        let tls = tls_files.clone().map(Tls::load).transpose()?.map(Arc::new);
        let store_config = StoreConfig {
            work: config.work.clone(),
            limits: config.limits.clone(),
            memory: config.memory.store(),
            keeping: config.data.keeping(),
        };
        let bus_config = config.zenoh.bus(tls_files, config.data.path.0.as_deref());
        let s3 = config.object_store.s3(|name| std::env::var(name).ok())?;
        let store = match (s3, &config.data.path.0) {
            (Some(s3), _) => open_fleet(store_config, s3, bus_config.daemon.clone()).await?,
            (None, Some(path)) => Store::open(store_config, Arc::new(LocalFiles::open(path)?))?,
            (None, None) => Store::new(store_config)?,
        };
        let gateway = Gateway::new(store.clone(), config.traffic.clone(), recorder);
        let keys = config.data.path.0.as_deref().map(KeyStore::in_folder);
        let keyring = keys.as_ref().map(KeyStore::keyring).transpose()?;
        let keyring = keyring.filter(|keyring| !keyring.is_empty()).unwrap_or_default();
        let is_open = keyring.is_open();
        gateway.set_keys(keyring.clone());
        gateway.continue_traces(continue_trace);
        let address = config.http.listen;
        let refused = |source| StartError::Http { address, source };
        let listener = TcpListener::bind(address).await.map_err(refused)?;
        let http_address = listener.local_addr().map_err(refused)?;
        for address in [address, config.zenoh.listen.0] {
            if is_open && !address.ip().is_loopback() {
                if !config.access.allow_open_network {
                    return Err(StartError::Open { address });
                }
                tracing::warn!(%address, "open to the network, and nobody is asked who they are");
            } else if tls.is_none() && !address.ip().is_loopback() {
                tracing::warn!(%address, "open to the network without TLS: keys travel readable");
            }
        }
        let watch_keys = keys.map(|keys| tokio::spawn(watch_keys(keys, keyring, gateway.clone())));
        let bus = bus::open(&gateway, bus_config).await?;
        let (stop_http, stopped) = oneshot::channel();
        let http = tokio::spawn(http::serve(gateway, listener, tls.clone(), async {
            // Dropping the daemon stops it too.
            let _ = stopped.await;
        }));
        let deadline = config.shutdown.deadline;
        Ok(Daemon { store, bus, tls, http_address, stop_http, http, watch_keys, deadline })
    }

    /// Base of every HTTP address of this daemon: `http://127.0.0.1:8080`, or `https://…`.
    pub(crate) fn http_url(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.http_address)
    }

    /// Takes over what the certificate's files hold now, for connections from now on; Zenoh's connect again.
    pub(crate) fn reload(&self) {
        let Some(tls) = &self.tls else {
            return tracing::info!("there is no certificate to read again");
        };
        match tls.reload() {
            Ok(()) => {
                tracing::info!("certificate read again");
                self.bus.renew();
            }
            Err(error) => tracing::error!(%error, "the certificate in use goes on"),
        }
    }

    /// The endpoint that Zenoh clients connect to: `tcp/127.0.0.1:7447`, or `tls/…`.
    pub(crate) fn zenoh_endpoint(&self) -> String {
        self.bus.endpoint()
    }

    /// Takes no new work, cancels builds, lets edits and requests under way finish until the
    /// configured deadline, then closes both doors.
    pub(crate) async fn stop(self) {
        let _ = self.stop_http.send(());
        if let Some(watch_keys) = &self.watch_keys {
            watch_keys.abort();
        }
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
