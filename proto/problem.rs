//! Errors on the wire: RFC 9457 problem documents.

use serde::{Deserialize, Serialize};
use std::fmt::Display;
use utoipa::ToSchema;

/// An RFC 9457 problem document (`application/problem+json`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// A URI that names the kind of problem.
    #[serde(rename = "type")]
    pub kind: String,
    /// The kind of problem in words.
    pub title: String,
    /// The HTTP status, over Zenoh too.
    pub status: u16,
    /// What happened this time: names the offending vertex, tet, member or limit.
    pub detail: String,
    /// JSON pointer (RFC 6901) into the request, where one input is at fault.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance_pointer: Option<String>,
}

impl Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}): {}", self.title, self.status, self.detail)?;
        match &self.instance_pointer {
            Some(pointer) => write!(f, " [at {pointer}]"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for Problem {}

/// A request that no body could accept, and which member of it is at fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{pointer}: {detail}")]
pub struct Invalid {
    /// JSON pointer (RFC 6901) to the member.
    pub pointer: String,
    /// What is wrong with it.
    pub detail: String,
}

impl Invalid {
    /// `detail` is wrong at `pointer`.
    pub fn new(pointer: impl Into<String>, detail: impl Into<String>) -> Invalid {
        Invalid { pointer: pointer.into(), detail: detail.into() }
    }
}

/// Requires `low <= value <= high`; refuses what is not finite.
pub(crate) fn within(pointer: &str, value: f64, low: f64, high: f64) -> Result<(), Invalid> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(Invalid::new(pointer, format!("must be between {low:e} and {high:e}, not {value:e}")))
}

/// Requires `low <= count <= high`.
pub(crate) fn count_within(
    pointer: &str,
    count: usize,
    low: usize,
    high: usize,
) -> Result<(), Invalid> {
    if (low..=high).contains(&count) {
        return Ok(());
    }
    Err(Invalid::new(pointer, format!("must be between {low} and {high}, not {count}")))
}

/// Requires every number of `values` to be finite.
pub(crate) fn all_finite(pointer: &str, values: &[f64]) -> Result<(), Invalid> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) => Err(Invalid::new(format!("{pointer}/{i}"), "must be finite")),
        None => Ok(()),
    }
}
