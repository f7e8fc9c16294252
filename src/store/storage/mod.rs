//! Named blobs and journals that outlive the process.

mod files;

pub use files::LocalFiles;

use std::time::SystemTime;

/// Where blobs and journals are kept. Names are `/`-separated, of lower-case letters, digits, `-` and `.`.
///
/// A *blob* never changes: it is put and deleted whole. A *journal* belongs to one process at a time, which alone
/// writes to it; where the storage is shared, whoever takes one over ([`Storage::claim`]) makes every further
/// write of the earlier owner fail ([`StorageError::is_taken`]). Where it is not, a journal is a blob that can
/// also be appended to.
///
/// Calls block, some until a disk or a network has answered: they belong on a pool. A call that has returned `Ok`
/// has taken effect for good, whatever happens to the process or the machine; one that has failed may or
/// may not have taken effect.
pub trait Storage: Send + Sync + std::fmt::Debug {
    /// The blob's bytes; `None` if there is none.
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError>;

    /// Creates the blob or replaces it whole: readers see the old bytes or the new ones.
    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError>;

    /// Removes the blob, if there is one.
    fn delete(&self, name: &str) -> Result<(), StorageError>;

    /// Every blob and journal whose name begins with `prefix` and a `/`, in the order of the names.
    fn list(&self, prefix: &str) -> Result<Vec<Entry>, StorageError>;

    /// Writes `bytes` at `offset` of a journal of this process's and ends it there: what lay beyond, of a call
    /// that failed, is gone. If this one fails, the bytes up to `offset` are as they were.
    fn append(&self, name: &str, offset: u64, bytes: &[u8]) -> Result<(), StorageError>;

    /// Whether other processes use the storage, too.
    fn is_shared(&self) -> bool {
        false
    }

    /// The journals below `prefix` that this daemon had last, before it was started anew: all of them where
    /// the storage is its own.
    fn own(&self, prefix: &str) -> Result<Vec<Entry>, StorageError> {
        self.list(prefix)
    }

    /// A journal's bytes, whosever it is; `None` if there is none. Of one of this process's, as it wrote it.
    fn peek(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError> {
        self.get(name)
    }

    /// Makes a journal this process's; its bytes, `None` if there is none.
    fn claim(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError> {
        self.get(name)
    }

    /// Creates a journal of this process's.
    fn begin(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError> {
        self.put(name, bytes)
    }

    /// Replaces a journal of this process's whole.
    fn rewrite(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError> {
        self.put(name, bytes)
    }

    /// Removes a journal of this process's for good.
    fn remove(&self, name: &str) -> Result<(), StorageError> {
        self.delete(name)
    }

    /// Whether a journal is this process's still.
    fn is_held(&self, _name: &str) -> Result<bool, StorageError> {
        Ok(true)
    }
}

/// A blob as [`Storage::list`] sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// When it was written last, if that is known.
    pub modified: Option<SystemTime>,
    /// Its bytes.
    pub n_bytes: u64,
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

/// The journal is another process's now. The `source` of a [`StorageError`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("another daemon has taken it over")]
pub struct Taken;

impl StorageError {
    /// Whether there was no room: what is there already is still served.
    pub fn is_full(&self) -> bool {
        use std::io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
        matches!(self.source.kind(), StorageFull | QuotaExceeded | FileTooLarge)
    }

    /// Whether the journal is another process's now.
    pub fn is_taken(&self) -> bool {
        self.source.get_ref().is_some_and(|source| source.is::<Taken>())
    }

    /// Whether what is there is not what was written.
    pub fn is_damaged(&self) -> bool {
        self.source.kind() == std::io::ErrorKind::InvalidData
    }
}
