//! The wire contract of sutura, version 1: what travels over HTTP and Zenoh, and nothing else.
//!
//! * [`session`], [`edit`], [`evaluate`], [`simulation`], [`event`], [`problem`]: the JSON documents.
//!   A type that is deserialized has every default filled in; `validate` then refuses what no body
//!   could accept and says which member is at fault.
//! * [`frame`] and [`npy`]: named numerical arrays as bytes; [`mod@array`] is their common currency,
//!   [`generation`] lists the arrays there are.
//! * [`state`]: one published state of a running simulation.
//! * [`bus`]: the documents that also travel as bincode over Zenoh.
//! * [`keys`], [`media`], [`openapi`]: key expressions, media types, schemas.
//! * [`login`]: joining Zenoh with a key.

#[cfg(target_endian = "big")]
compile_error!(
    "arrays travel little-endian and are viewed in place: big-endian hosts are not supported"
);

pub mod array;
pub mod bus;
pub mod edit;
pub mod evaluate;
pub mod event;
pub mod frame;
pub mod generation;
pub mod keys;
pub mod login;
pub mod media;
pub mod npy;
pub mod openapi;
pub mod problem;
pub mod session;
pub mod simulation;
pub mod state;

pub use problem::{Invalid, Problem};
