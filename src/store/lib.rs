//! Sessions over time: which bodies exist, which generation of each is current, what is being
//! built, edited and simulated.
//!
//! [`Store`] is the whole interface; HTTP and Zenoh call the same methods. It owns three kinds of
//! threads, apart from the caller's asynchronous ones:
//!
//! - the build pool, for edits (a fraction of a second) and, behind them, builds (seconds);
//! - the query pool, for evaluations and the assembly of large answers (milliseconds);
//! - the stepping threads, which advance simulations in real time.
//!
//! Knows no HTTP, no Zenoh and no wire format.

mod archive;
mod background;
mod check;
mod chores;
mod config;
mod control;
mod error;
mod event;
mod fleet;
mod keeping;
mod live;
mod memory;
mod metrics;
mod pacing;
mod pool;
mod prepared;
mod priority;
mod restore;
mod session;
mod simulation;
mod stepping;
mod storage;
mod store;
mod tasks;
#[cfg(feature = "testing")]
pub mod testing;
#[cfg(test)]
mod tests;
mod work;

pub use config::{KeepingConfig, Limits, MemoryConfig, StoreConfig, WorkConfig};
pub use error::{InputError, StoreError};
pub use event::{Event, EventKind};
pub use fleet::HAND_OVER;
pub use metrics::describe_metrics;
pub use pool::Account;
pub use session::{
    CreateSession, EditRequest, Generation, GenerationRef, MeshSize, NotASessionId, Progress,
    SessionId, SessionInfo, SessionState,
};
pub use simulation::{
    ContactConfig, Frame, GrabConfig, SimulationConfig, SimulationInfo, VertexForce,
};
pub use storage::{Entry, LocalFiles, Storage, StorageError, Taken};
pub use store::{OpenError, Store};
pub use work::{Load, TaskLoad};
