//! `[data]`

use super::bounds::seconds;
use serde::Deserialize;
use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

/// Bytes of a megabyte.
const MEGABYTE: u64 = 1 << 20;

/// Where sessions are kept.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct DataConfig {
    /// A folder, which is made if there is none; or `none`.
    pub(crate) path: DataPath,
    /// Megabytes (2²⁰ bytes) of prepared bodies beside them; 0 for none.
    pub(crate) max_bodies_mb: u32,
    /// How long a session has to be as it is before its bodies are written.
    #[serde(rename = "bodies_rest_s", deserialize_with = "seconds")]
    pub(crate) bodies_rest: Duration,
}

impl Default for DataConfig {
    fn default() -> Self {
        let sutura_store::KeepingConfig { max_body_bytes, rest } = Default::default();
        let max_bodies_mb = u32::try_from(max_body_bytes / MEGABYTE).unwrap_or(u32::MAX);
        DataConfig { path: DataPath::default(), max_bodies_mb, bodies_rest: rest }
    }
}

impl DataConfig {
    /// What the store needs, beside the folder.
    pub(crate) fn keeping(&self) -> sutura_store::KeepingConfig {
        let max_body_bytes = u64::from(self.max_bodies_mb) * MEGABYTE;
        sutura_store::KeepingConfig { max_body_bytes, rest: self.bodies_rest }
    }
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
