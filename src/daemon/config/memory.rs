//! `[memory]`

use serde::Deserialize;

/// Bytes of a megabyte.
const MEGABYTE: usize = 1 << 20;

/// What bodies may take up.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct MemoryConfig {
    /// Megabytes (2²⁰ bytes) of all bodies in memory; 0 for as many as there are.
    pub(crate) budget_mb: u32,
}

impl MemoryConfig {
    /// What the store needs.
    pub(crate) fn store(&self) -> sutura_store::MemoryConfig {
        let budget = (self.budget_mb as usize).saturating_mul(MEGABYTE);
        sutura_store::MemoryConfig { budget_bytes: (budget > 0).then_some(budget) }
    }
}
