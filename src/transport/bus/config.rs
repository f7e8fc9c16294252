//! The embedded Zenoh router's configuration: one endpoint, nothing found by scouting, every size bounded, and
//! where there are keys, nobody let in without one.

use super::access::{UsersFile, access_control};
use crate::access::Keyring;
use crate::tls::TlsFiles;
use serde_json::json;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::PathBuf;
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
    /// The certificate to show; without one, connections are plain TCP.
    pub tls: Option<TlsFiles>,
    /// A folder of the daemon's own, where passwords lie for a moment if there are keys.
    pub private_folder: Option<PathBuf>,
}

impl BusConfig {
    /// Loopback on `port` under the name `daemon`, with the usual bounds.
    pub fn loopback(port: u16, daemon: impl Into<String>) -> BusConfig {
        BusConfig {
            listen: SocketAddr::from(([127, 0, 0, 1], port)),
            daemon: daemon.into(),
            max_zenoh_sessions: 64,
            max_message_bytes: 128 << 20,
            tls: None,
            private_folder: None,
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
    /// The passwords cannot be handed over.
    #[error("{}: {source}", path.display())]
    Users {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// There are keys, but no folder to hand their passwords over in.
    #[error("keys need a data directory")]
    NoFolder,
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
pub(super) fn endpoint(address: SocketAddr, has_tls: bool) -> String {
    let protocol = if has_tls { "tls" } else { "tcp" };
    match address.ip() {
        IpAddr::V4(ip) => format!("{protocol}/{ip}:{}", address.port()),
        IpAddr::V6(ip) => format!("{protocol}/[{ip}]:{}", address.port()),
    }
}

/// Opens Zenoh as `config` says on the resolved `address`, for the holders of `keys`.
pub(super) async fn open_zenoh(
    config: &BusConfig,
    address: SocketAddr,
    keys: &Keyring,
) -> Result<zenoh::Session, BusError> {
    let mut zenoh_config = zenoh_config(config, address)?;
    let mut users = None;
    if !keys.is_open() {
        let folder = config.private_folder.as_deref().ok_or(BusError::NoFolder)?;
        let file = users.insert(UsersFile::write(folder, keys)?);
        // The daemon's own name: with it, users are asked for although there may be none.
        let mut password = [0; 32];
        getrandom::fill(&mut password)
            .map_err(std::io::Error::from)
            .map_err(|source| BusError::Users { path: file.path().to_owned(), source })?;
        let password: String = password.iter().map(|byte| format!("{byte:02x}")).collect();
        let login = json!({
            "user": "daemon", "password": password, "dictionary_file": file.path(),
        });
        zenoh_config.insert_json5("transport/auth/usrpwd", &login.to_string())?;
        zenoh_config.insert_json5("access_control", &access_control(keys).to_string())?;
    }
    let zenoh_session = zenoh::open(zenoh_config).await?;
    drop(users);
    Ok(zenoh_session)
}

/// Zenoh's configuration for `config` listening on the resolved `address`.
fn zenoh_config(config: &BusConfig, address: SocketAddr) -> Result<zenoh::Config, BusError> {
    let mut zenoh_config = zenoh::Config::default();
    let endpoint = endpoint(address, config.tls.is_some());
    for (key, value) in [
        ("mode", json!("router")),
        ("listen/endpoints", json!([endpoint])),
        ("listen/exit_on_failure", json!(true)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("adminspace/enabled", json!(false)),
        ("transport/link/rx/max_message_size", json!(config.max_message_bytes)),
        ("transport/unicast/max_sessions", json!(config.max_zenoh_sessions)),
    ] {
        zenoh_config.insert_json5(key, &value.to_string())?;
    }
    if let Some(TlsFiles { certificate, private_key }) = &config.tls {
        let tls = json!({"listen_certificate": certificate, "listen_private_key": private_key});
        zenoh_config.insert_json5("transport/link/tls", &tls.to_string())?;
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
        assert_eq!(endpoint(ipv6, false), "tcp/[::1]:7447");
        assert_eq!(endpoint(ipv6, true), "tls/[::1]:7447");
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
