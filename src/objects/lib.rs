//! An S3-compatible object store as the storage of a fleet: any daemon can take over any session.
//!
//! A journal is one object, which is replaced whole on the condition that it is still the one that this
//! process wrote or read last (`If-Match`). That one condition is all there is to agree upon: whoever
//! takes a session over replaces its journal by an equal one under its own name (`header`), and from then
//! on every write of the earlier owner fails, whenever it arrives. There is no clock in it, no lease and no
//! list of members.
//!
//! - *Acknowledged* means that the put has been answered. If the answer was lost, the object is read back and
//!   says by its header which write it is.
//! - *Shortening* a journal is a replacement as any other.
//! - *Removal* first replaces the journal by a tombstone, then deletes the object. A writer who comes late finds
//!   another object or none, and fails either way.
//!
//! Everything else (meshes) lies under names that no two sessions share, and never changes.

mod header;
mod objects;
mod s3;
#[cfg(feature = "testing")]
pub mod testing;
#[cfg(test)]
mod tests;

pub use objects::Objects;
pub use s3::{S3Config, Secret};
