//! `[access]`

use serde::Deserialize;

/// Who is let in.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct AccessConfig {
    /// Serve the network although there are no keys.
    pub(crate) allow_open_network: bool,
}
