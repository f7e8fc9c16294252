//! A storage that refuses what a test wants refused.

use crate::storage::{Entry, LocalFiles, Storage, StorageError};
use std::fmt;
use std::io::{Error, ErrorKind};
use std::path::Path;

/// Whether files take so many bytes more; none if one is deleted.
type Rule = dyn Fn(&LocalFiles, usize) -> Result<(), ErrorKind> + Send + Sync;

/// Local files that change only as a rule allows.
pub(crate) struct Ruled {
    files: LocalFiles,
    rule: Box<Rule>,
}

impl Ruled {
    pub(crate) fn new(
        folder: &Path,
        rule: impl Fn(&LocalFiles, usize) -> Result<(), ErrorKind> + Send + Sync + 'static,
    ) -> Ruled {
        Ruled { files: LocalFiles::open(folder).unwrap(), rule: Box::new(rule) }
    }

    fn admit(&self, name: &str, n_more: usize) -> Result<(), StorageError> {
        (self.rule)(&self.files, n_more).map_err(|kind| {
            let (action, name) = ("testing", name.to_owned());
            StorageError { action, name, source: Error::from(kind) }
        })
    }
}

impl fmt::Debug for Ruled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.files.fmt(f)
    }
}

impl Storage for Ruled {
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError> {
        self.files.get(name)
    }
    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError> {
        self.admit(name, bytes.len())?;
        self.files.put(name, bytes)
    }
    fn append(&self, name: &str, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        if let Err(error) = self.admit(name, bytes.len()) {
            // Half of it has got through.
            self.files.append(name, offset, &bytes[..bytes.len() / 2])?;
            return Err(error);
        }
        self.files.append(name, offset, bytes)
    }
    fn delete(&self, name: &str) -> Result<(), StorageError> {
        self.admit(name, 0)?;
        self.files.delete(name)
    }
    fn list(&self, prefix: &str) -> Result<Vec<Entry>, StorageError> {
        self.files.list(prefix)
    }
}
