//! Named blobs that outlive the process.

mod files;

pub use files::LocalFiles;

use std::time::SystemTime;

/// Where blobs are kept. Names are `/`-separated, of lower-case letters, digits, `-` and `.`.
///
/// Calls block, some until a disk has answered: they belong on a pool. A call that has returned `Ok` has
/// taken effect for good, whatever happens to the process or the machine; one that has failed may or
/// may not have taken effect.
pub trait Storage: Send + Sync + std::fmt::Debug {
    /// The blob's bytes; `None` if there is none.
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError>;

    /// Creates the blob or replaces it whole: readers see the old bytes or the new ones.
    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError>;

    /// Writes `bytes` at `offset` of a blob that exists and ends it there: what lay beyond, of a call that
    /// failed, is gone. If this one fails, the bytes up to `offset` are as they were.
    fn append(&self, name: &str, offset: u64, bytes: &[u8]) -> Result<(), StorageError>;

    /// Removes the blob, if there is one.
    fn delete(&self, name: &str) -> Result<(), StorageError>;

    /// Every blob whose name begins with `prefix` and a `/`, in the order of the names.
    fn list(&self, prefix: &str) -> Result<Vec<Entry>, StorageError>;
}

/// A blob as [`Storage::list`] sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// When it was written last, if that is known.
    pub modified: Option<SystemTime>,
}

/// Why the storage did not do what it was asked for.
#[derive(Debug, thiserror::Error)]
#[error("{action} {name}: {source}")]
pub struct StorageError {
    /// What was tried.
    pub action: &'static str,
    /// With which blob, or where.
    pub name: String,
    /// What the operating system, or the other side, said.
    pub source: std::io::Error,
}

impl StorageError {
    /// Whether there was no room: what is there already is still served.
    pub fn is_full(&self) -> bool {
        use std::io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
        matches!(self.source.kind(), StorageFull | QuotaExceeded | FileTooLarge)
    }
}
