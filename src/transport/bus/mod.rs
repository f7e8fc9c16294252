//! Zenoh: the same commands by key expression, and the published states.
//!
//! The daemon embeds a Zenoh router on one endpoint, so that clients need neither a router nor
//! scouting. Zenoh's callbacks only hand over; its sending calls may block on a congested link even
//! where they look asynchronous, so those that may wait run on blocking threads. A reply travels
//! with the priority and congestion control of its query: clients that fetch large arrays should
//! ask with a low priority.
//!
//! The router takes its users and what they may do when it starts. When keys are made or revoked, or the
//! certificate is renewed, it therefore starts anew on the same address: connections break off, those of
//! revoked keys for good; clients of Zenoh connect again by themselves and go on.

mod access;
mod config;
mod publication;
mod query;
#[cfg(test)]
mod tests;

pub use config::{BusConfig, BusError};

use crate::access::Keyring;
use crate::gateway::Gateway;
use config::{check_daemon_name, endpoint, open_zenoh, resolve};
use query::Queries;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use sutura_proto::keys::{self, Resource};
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::{Mutex, Notify};
use tokio::task::{JoinHandle, JoinSet};
use zenoh::liveliness::LivelinessToken;

/// How long queries under way may take when the router starts anew.
const RENEWAL_GRACE: Duration = Duration::from_secs(2);

/// How long to wait until the next try where the router did not start.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// An open door to Zenoh. Dropping it without [`Bus::close`] closes it without ceremony.
pub struct Bus {
    address: SocketAddr,
    has_tls: bool,
    door: Arc<Mutex<Option<Door>>>,
    renewal: Arc<Notify>,
    keeper: JoinHandle<()>,
}

/// A router that runs, and what is declared at it.
struct Door {
    zenoh_session: zenoh::Session,
    alive: LivelinessToken,
    queries: Queries,
    tasks: JoinSet<()>,
}

/// Joins Zenoh: answers queries, publishes states and generations, hears forces, and says that the
/// daemon is there.
pub async fn open(gateway: &Gateway, config: BusConfig) -> Result<Bus, BusError> {
    check_daemon_name(&config.daemon)?;
    if Handle::current().runtime_flavor() == RuntimeFlavor::CurrentThread {
        return Err(BusError::Runtime);
    }
    let address = resolve(config.listen)?;
    let has_tls = config.tls.is_some();
    let known = gateway.keys();
    let door = Door::open(gateway, &config, address, &known).await?;
    let door = Arc::new(Mutex::new(Some(door)));
    let renewal = Arc::new(Notify::new());
    let keeper = tokio::spawn(keep(Keeper {
        gateway: gateway.clone(),
        config,
        address,
        known,
        door: door.clone(),
        renewal: renewal.clone(),
    }));
    Ok(Bus { address, has_tls, door, renewal, keeper })
}

struct Keeper {
    gateway: Gateway,
    config: BusConfig,
    address: SocketAddr,
    /// The keys that the router knows.
    known: Arc<Keyring>,
    door: Arc<Mutex<Option<Door>>>,
    renewal: Arc<Notify>,
}

/// Starts the router anew whenever it has to know something else.
async fn keep(keeper: Keeper) {
    let Keeper { gateway, config, address, mut known, door, renewal } = keeper;
    let mut keys = gateway.watch_keys();
    loop {
        tokio::select! {
            changed = keys.changed() => if changed.is_err() { return },
            () = renewal.notified() => {}
            // Keys that came before this began to watch.
            () = std::future::ready(()), if gateway.keys() != known => {}
        }
        let mut door = door.lock().await;
        if let Some(old) = door.take() {
            // Answers that take longer are lost to those who wait; what they asked for is done.
            if !matches!(tokio::time::timeout(RENEWAL_GRACE, old.close()).await, Ok(Ok(()))) {
                tracing::warn!("Zenoh's router was closed with queries under way");
            }
        }
        known = gateway.keys();
        loop {
            match Door::open(&gateway, &config, address, &known).await {
                Ok(opened) => break *door = Some(opened),
                Err(error) => {
                    tracing::error!(%error, "Zenoh's router does not start; trying again")
                }
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
        tracing::info!("Zenoh's router started anew");
    }
}

impl Door {
    async fn open(
        gateway: &Gateway,
        config: &BusConfig,
        address: SocketAddr,
        keys: &Keyring,
    ) -> Result<Door, BusError> {
        let zenoh_session = open_zenoh(config, address, keys).await?;
        let mut tasks = JoinSet::new();
        let queries = query::declare(gateway, &zenoh_session).await?;
        for resource in [Resource::Forces, Resource::Grabs] {
            let heard = publication::subscribe(&zenoh_session, resource).await?;
            tasks.spawn(publication::hear(gateway.clone(), heard));
        }
        tasks.spawn(publication::publish(gateway.clone(), zenoh_session.clone()));
        // Last, so that whoever hears of the daemon finds it complete.
        let name = keys::daemon(&config.daemon);
        let name = name.ok_or_else(|| BusError::DaemonName(config.daemon.clone()))?;
        let alive = zenoh_session.liveliness().declare_token(name).await?;
        Ok(Door { zenoh_session, alive, queries, tasks })
    }

    async fn close(self) -> Result<(), BusError> {
        let Door { zenoh_session, alive, queries, mut tasks } = self;
        alive.undeclare().await?;
        queries.finish().await?;
        tasks.shutdown().await;
        zenoh_session.close().await?;
        Ok(())
    }
}

impl Bus {
    /// The endpoint that clients connect to, as Zenoh writes it: `tcp/127.0.0.1:7447`, or `tls/…`.
    pub fn endpoint(&self) -> String {
        endpoint(self.address, self.has_tls)
    }

    /// The address that clients connect to.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Starts the router anew, with what the certificate's files hold now.
    pub fn renew(&self) {
        self.renewal.notify_one();
    }

    /// Leaves Zenoh: says goodbye, takes no new query, answers those under way, stops publishing,
    /// closes. An edit under way may take long: callers with a deadline drop the future.
    pub async fn close(self) -> Result<(), BusError> {
        self.keeper.abort();
        match self.door.lock().await.take() {
            Some(door) => door.close().await,
            None => Ok(()),
        }
    }
}

impl Drop for Bus {
    fn drop(&mut self) {
        self.keeper.abort();
    }
}
