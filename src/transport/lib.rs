//! The daemon's two doors: HTTP ([`http`]) and Zenoh ([`bus`]). The only server crate that names
//! axum or zenoh.
//!
//! Both parse a request of the contract (`sutura-proto`), run the same command on the store, and
//! turn its answer into the contract's reply; whatever goes wrong becomes a problem document
//! through one table. Nothing is computed on asynchronous threads.
//!
//! A daemon opens both like this:
//!
//! ```no_run
//! # async fn run(store: sutura_store::Store) -> Result<(), Box<dyn std::error::Error>> {
//! use sutura_transport::{Gateway, Limits, bus, http, install_recorder};
//!
//! let gateway = Gateway::new(store, Limits::default(), install_recorder()?);
//! let bus = bus::open(&gateway, bus::BusConfig::loopback(7447, "my-daemon")).await?;
//! let listener = tokio::net::TcpListener::bind("127.0.0.1:8080").await?;
//! http::serve(gateway, listener, None, async { tokio::signal::ctrl_c().await.unwrap() }).await?;
//! bus.close().await?;
//! # Ok(())
//! # }
//! ```

mod access;
pub mod bus;
mod command;
mod conversion;
mod gateway;
pub mod http;
mod limits;
mod metrics;
mod offline;
mod problem;
mod rate;
#[cfg(feature = "testing")]
pub mod testing;
#[cfg(test)]
mod tests;
mod tls;

pub use access::{Grant, KeyHash, Keyring, Role, hash, key};
pub use conversion::session::UNNAMED;
pub use gateway::{ContinueTrace, Gateway};
pub use limits::Limits;
pub use metrics::install_recorder;
pub use offline::read_request;
pub use tls::{Tls, TlsError, TlsFiles};
