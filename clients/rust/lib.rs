//! A client of a sutura daemon: the wire contract and the reconstruction u = U q, no solver. With the
//! feature `simulation` it evaluates and steps the reduced model by itself ([`Evaluator`]).
//!
//! [`Client`] speaks HTTP, [`ZenohClient`] speaks Zenoh; either gives a handle to a session
//! ([`Session`], [`BusSession`]) and both fetch [`Arrays`]. A running simulation is followed by a
//! [`StateStream`] and a [`Tracker`], which keeps the basis in step with the stream's generations.
//!
//! ```no_run
#![doc = include_str!("examples/stitch.rs")]
//! ```

mod arrays;
mod bus;
mod credentials;
mod error;
mod evaluator;
mod events;
mod http;
mod reply;
mod session;
mod states;
mod tracker;

pub use arrays::{
    Array, Arrays, Basis, BlockName, Combination, Delta, Dictionary, Generation, Query, Scalar,
    StitchInForce, Transfer,
};
pub use bus::{BusSession, GenerationStream, ZenohClient};
pub use credentials::Credentials;
pub use error::{Error, Result};
pub use evaluator::Evaluator;
pub use events::EventStream;
pub use http::Client;
pub use session::Session;
pub use states::StateStream;
pub use sutura_proto as proto;
#[cfg(feature = "simulation")]
pub use sutura_reduced as reduced;
pub use tracker::Tracker;
