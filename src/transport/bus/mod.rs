//! Zenoh: the same commands by key expression, and the published states.
//!
//! The daemon embeds a Zenoh router on one TCP endpoint, so that clients need neither a router nor
//! scouting. Zenoh's callbacks only hand over; its sending calls may block on a congested link even
//! where they look asynchronous, so those that may wait run on blocking threads. A reply travels
//! with the priority and congestion control of its query: clients that fetch large arrays should
//! ask with a low priority.

mod config;
mod publication;
mod query;
#[cfg(test)]
mod tests;

pub use config::{BusConfig, BusError};

use crate::gateway::Gateway;
use config::{check_daemon_name, endpoint, resolve, zenoh_config};
use query::Queries;
use std::net::SocketAddr;
use sutura_proto::keys::{self, Resource};
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::task::JoinSet;
use zenoh::liveliness::LivelinessToken;

/// An open door to Zenoh. Dropping it without [`Bus::close`] closes it without ceremony.
pub struct Bus {
    zenoh_session: zenoh::Session,
    address: SocketAddr,
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
    let zenoh_session = zenoh::open(zenoh_config(&config, address)?).await?;
    let mut tasks = JoinSet::new();
    let queries = query::declare(gateway, &zenoh_session).await?;
    for resource in [Resource::Forces, Resource::Grabs] {
        let heard = publication::subscribe(&zenoh_session, resource).await?;
        tasks.spawn(publication::hear(gateway.clone(), heard));
    }
    tasks.spawn(publication::publish(gateway.clone(), zenoh_session.clone()));
    // Last, so that whoever hears of the daemon finds it complete.
    let key = keys::daemon(&config.daemon).ok_or(BusError::DaemonName(config.daemon))?;
    let alive = zenoh_session.liveliness().declare_token(key).await?;
    Ok(Bus { zenoh_session, address, alive, queries, tasks })
}

impl Bus {
    /// The endpoint that clients connect to, as Zenoh writes it: `tcp/127.0.0.1:7447`.
    pub fn endpoint(&self) -> String {
        endpoint(self.address)
    }

    /// The address that clients connect to.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Leaves Zenoh: says goodbye, takes no new query, answers those under way, stops publishing,
    /// closes. An edit under way may take long: callers with a deadline drop the future.
    pub async fn close(self) -> Result<(), BusError> {
        let Bus { zenoh_session, alive, queries, mut tasks, .. } = self;
        alive.undeclare().await?;
        queries.finish().await?;
        tasks.shutdown().await;
        zenoh_session.close().await?;
        Ok(())
    }
}
