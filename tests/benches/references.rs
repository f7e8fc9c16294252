//! Frequencies from independent code, where there are some.

use crate::bodies::Failure;
use crate::measure::Check;
use serde_json::Value;
use std::path::Path;

/// Greatest relative difference of a frequency.
pub(crate) const LIMIT: f64 = 1e-4;

/// Frequencies of a body before and after its stitches, in Hz.
pub(crate) struct Reference {
    pub(crate) before: Vec<f64>,
    pub(crate) after: Vec<f64>,
}

impl Reference {
    /// Reads `NAME.reference.json` or `NAME.json` of `directory`.
    pub(crate) fn load(directory: &Path, name: &str) -> Result<Option<Reference>, Failure> {
        let names = [format!("{name}.reference.json"), format!("{name}.json")];
        let Some(path) = names.iter().map(|n| directory.join(n)).find(|path| path.exists()) else {
            return Ok(None);
        };
        let json: Value = serde_json::from_slice(&std::fs::read(path)?)?;
        let list = |key: &str| serde_json::from_value::<Vec<f64>>(json[key].clone());
        Ok(Some(Reference {
            before: list("frequencies_hz_before")?,
            after: list("frequencies_hz_after")?,
        }))
    }
}

/// Agreement of `found` with the first of `reference`.
pub(crate) fn check(what: &str, found: &[f64], reference: &[f64], limit: f64) -> Check {
    let errors = found.iter().zip(reference).map(|(f, r)| (f / r - 1.0).abs());
    Check::at_most(what, errors.fold(0.0, f64::max), limit)
}
