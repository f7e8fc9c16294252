//! `[data]`

use serde::Deserialize;
use std::fmt;
use std::path::PathBuf;

/// Where sessions are kept.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct DataConfig {
    /// A folder, which is made if there is none; or `none`.
    pub(crate) path: DataPath,
}

/// What [`DataPath`] calls keeping sessions in memory alone.
const NONE: &str = "none";

/// A folder, or none.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(from = "PathBuf")]
pub(crate) struct DataPath(pub(crate) Option<PathBuf>);

impl Default for DataPath {
    fn default() -> Self {
        DataPath(Some("sutura-data".into()))
    }
}

impl From<PathBuf> for DataPath {
    fn from(path: PathBuf) -> Self {
        DataPath((path.as_os_str() != NONE).then_some(path))
    }
}

impl From<std::ffi::OsString> for DataPath {
    fn from(path: std::ffi::OsString) -> Self {
        PathBuf::from(path).into()
    }
}

impl fmt::Display for DataPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0 {
            Some(path) => write!(f, "{}", path.display()),
            None => f.write_str(NONE),
        }
    }
}
