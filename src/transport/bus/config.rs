//! The embedded Zenoh router's configuration: one TCP endpoint, nothing found by scouting, every
//! size bounded.

use std::net::{IpAddr, SocketAddr, TcpListener};
use sutura_proto::keys;

/// Where and as whom the daemon joins Zenoh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// This daemon's name in its liveliness token: one chunk of a key expression.
    pub daemon: String,
    /// Most remote Zenoh sessions connected at the same time.
    pub max_zenoh_sessions: usize,
    /// Largest message accepted from the network, in bytes.
    pub max_message_bytes: usize,
}

impl BusConfig {
    /// Loopback on `port` under the name `daemon`, with the usual bounds.
    pub fn loopback(port: u16, daemon: impl Into<String>) -> BusConfig {
        BusConfig {
            listen: SocketAddr::from(([127, 0, 0, 1], port)),
            daemon: daemon.into(),
            max_zenoh_sessions: 64,
            max_message_bytes: 128 << 20,
        }
    }
}

/// Why the bus could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The daemon's name would not be one chunk of a key expression.
    #[error("the daemon name {0:?} must be 1 to 64 characters out of letters, digits, '-' and '_'")]
    DaemonName(String),
    /// Zenoh would panic.
    #[error("zenoh needs a multi-threaded asynchronous runtime")]
    Runtime,
    /// The operating system refused the address.
    #[error("cannot listen on {address}: {source}")]
    Address {
        /// The address asked for.
        address: SocketAddr,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// Zenoh refused its configuration or a declaration.
    #[error("zenoh: {0}")]
    Zenoh(#[from] zenoh::Error),
}

/// Refuses names that are no single chunk of a key expression.
pub(super) fn check_daemon_name(name: &str) -> Result<(), BusError> {
    if keys::is_id(name) { Ok(()) } else { Err(BusError::DaemonName(name.to_owned())) }
}

/// Checks that the address can be bound, and replaces port 0 by a free one. Zenoh itself does not
/// report the port it was given, so the free port is found by binding it for a moment.
pub(super) fn resolve(listen: SocketAddr) -> Result<SocketAddr, BusError> {
    TcpListener::bind(listen)
        .and_then(|listener| listener.local_addr())
        .map_err(|source| BusError::Address { address: listen, source })
}

/// The Zenoh endpoint of an address, as a client writes it.
pub(super) fn endpoint(address: SocketAddr) -> String {
    match address.ip() {
        IpAddr::V4(ip) => format!("tcp/{ip}:{}", address.port()),
        IpAddr::V6(ip) => format!("tcp/[{ip}]:{}", address.port()),
    }
}

/// Zenoh's configuration for `config` listening on the resolved `address`.
pub(super) fn zenoh_config(
    config: &BusConfig,
    address: SocketAddr,
) -> Result<zenoh::Config, BusError> {
    let mut zenoh_config = zenoh::Config::default();
    for (key, value) in [
        ("mode", r#""router""#.to_owned()),
        ("listen/endpoints", format!(r#"["{}"]"#, endpoint(address))),
        ("listen/exit_on_failure", "true".to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("adminspace/enabled", "false".to_owned()),
        ("transport/link/rx/max_message_size", config.max_message_bytes.to_string()),
        ("transport/unicast/max_sessions", config.max_zenoh_sessions.to_string()),
    ] {
        zenoh_config.insert_json5(key, &value)?;
    }
    Ok(zenoh_config)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_is_known_to_zenoh() {
        let config = BusConfig::loopback(0, "d0");
        zenoh_config(&config, SocketAddr::from(([127, 0, 0, 1], 7447))).unwrap();
        let ipv6 = "[::1]:7447".parse().unwrap();
        zenoh_config(&config, ipv6).unwrap();
        assert_eq!(endpoint(ipv6), "tcp/[::1]:7447");
    }

    #[test]
    fn port_zero_becomes_a_free_port() {
        let address = resolve(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
        assert_ne!(address.port(), 0);
    }

    #[test]
    fn a_taken_port_is_an_error_that_names_it() {
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let error = resolve(taken.local_addr().unwrap()).unwrap_err();
        assert!(error.to_string().contains(&taken.local_addr().unwrap().to_string()));
    }

    #[test]
    fn daemon_names_are_single_chunks() {
        for name in ["", "a/b", "a.b", "*", "a?b", "a#b", "$x", "ü", &"x".repeat(65)] {
            assert!(check_daemon_name(name).is_err(), "{name:?}");
        }
        check_daemon_name("host-1_example").unwrap();
    }
}
