//! `[zenoh]`

use super::bounds::{bytes, count};
use serde::Deserialize;
use std::fmt;
use std::net::SocketAddr;
use std::path::Path;
use std::str::FromStr;
use sutura_transport::TlsFiles;
use sutura_transport::bus::BusConfig;

/// Where Zenoh is served, and as whom.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ZenohConfig {
    /// Endpoint to listen on; port 0 takes a free one.
    pub(crate) listen: ZenohEndpoint,
    /// The daemon's name in its liveliness token; `None` makes a new one at every start.
    pub(crate) daemon: Option<String>,
    /// Most remote Zenoh sessions connected at the same time.
    #[serde(deserialize_with = "count")]
    pub(crate) max_zenoh_sessions: usize,
    /// Largest message accepted from the network, in bytes.
    #[serde(deserialize_with = "bytes")]
    pub(crate) max_message_bytes: usize,
}

impl Default for ZenohConfig {
    fn default() -> Self {
        let bus = BusConfig::loopback(7447, "");
        Self {
            listen: ZenohEndpoint(bus.listen),
            daemon: None,
            max_zenoh_sessions: bus.max_zenoh_sessions,
            max_message_bytes: bus.max_message_bytes,
        }
    }
}

impl ZenohConfig {
    /// The daemon's name: if it has none, a new one, which stays.
    pub(crate) fn name(&mut self) -> &str {
        self.daemon.get_or_insert_with(new_name)
    }

    /// What the transport needs.
    pub(crate) fn bus(&self, tls: Option<TlsFiles>, folder: Option<&Path>) -> BusConfig {
        BusConfig {
            listen: self.listen.0,
            daemon: self.daemon.clone().unwrap_or_else(new_name),
            max_zenoh_sessions: self.max_zenoh_sessions,
            max_message_bytes: self.max_message_bytes,
            tls,
            private_folder: folder.map(Path::to_owned),
        }
    }
}

fn new_name() -> String {
    format!("sutura-{}", uuid::Uuid::now_v7().simple())
}

/// A TCP endpoint as Zenoh writes it: `tcp/127.0.0.1:7447`. On the way in, `tcp/` may be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct ZenohEndpoint(pub(crate) SocketAddr);

/// The text is no TCP endpoint.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no endpoint of the form tcp/ADDR:PORT, such as tcp/127.0.0.1:7447")]
pub(crate) struct NotAnEndpoint(String);

impl FromStr for ZenohEndpoint {
    type Err = NotAnEndpoint;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let address = text.strip_prefix("tcp/").unwrap_or(text);
        address.parse().map(Self).map_err(|_| NotAnEndpoint(text.into()))
    }
}

impl TryFrom<String> for ZenohEndpoint {
    type Error = NotAnEndpoint;
    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl fmt::Display for ZenohEndpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "tcp/{}", self.0)
    }
}
