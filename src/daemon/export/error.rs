//! Why a body could not be written.

use std::path::{Path, PathBuf};

/// What went wrong.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ExportError {
    /// A file could not be written.
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: std::io::Error },
    /// The body does not fit into a format.
    #[error("{0}")]
    Unfit(String),
}

impl ExportError {
    /// What the operating system said about `path`.
    pub(crate) fn at(path: &Path) -> impl FnOnce(std::io::Error) -> ExportError {
        let path = path.to_owned();
        move |source| ExportError::File { path, source }
    }
}
