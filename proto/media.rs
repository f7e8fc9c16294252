//! Media types: HTTP's `Content-Type` and `Accept`, and the encodings of Zenoh payloads.

/// A JSON document.
pub const JSON: &str = "application/json";
/// An RFC 9457 problem document ([`crate::Problem`]).
pub const PROBLEM_JSON: &str = "application/problem+json";
/// Named arrays ([`crate::frame`]).
pub const FRAME: &str = "application/vnd.sutura.frame";
/// One array in NumPy's format ([`crate::npy`]).
pub const NPY: &str = "application/x-npy";
/// One published state ([`crate::state::StateFrame`]).
pub const STATE: &str = "application/vnd.sutura.state";
/// A control document as bincode ([`crate::bus`]); Zenoh only.
pub const BINCODE: &str = "application/vnd.sutura.bincode";
/// Server-sent events ([`crate::event::Event`]).
pub const EVENT_STREAM: &str = "text/event-stream";
