//! Readers of numbers that must lie in a range; the error names the range.

use serde::de::{Deserialize, Deserializer, Error};
use std::time::Duration;

/// Most threads of one kind.
const MAX_THREADS: usize = 1024;
/// Most entries of a queue or backlog: its memory is set aside at the start.
const MAX_QUEUE: usize = 1 << 20;
/// Most of anything else that is counted.
const MAX_COUNT: usize = 1 << 30;
/// Most bytes.
const MAX_BYTES: usize = 1 << 40;

fn whole<'de, D: Deserializer<'de>>(deserializer: D, high: usize) -> Result<usize, D::Error> {
    let given = i64::deserialize(deserializer)?;
    match usize::try_from(given) {
        Ok(value) if (1..=high).contains(&value) => Ok(value),
        _ => Err(D::Error::custom(format_args!("{given} is not between 1 and {high}"))),
    }
}

/// 1 to [`MAX_THREADS`].
pub(super) fn threads<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    whole(deserializer, MAX_THREADS)
}

/// 1 to [`MAX_QUEUE`].
pub(super) fn queue<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    whole(deserializer, MAX_QUEUE)
}

/// 1 to [`MAX_COUNT`].
pub(super) fn count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    whole(deserializer, MAX_COUNT)
}

/// 1 to [`MAX_BYTES`].
pub(super) fn bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    whole(deserializer, MAX_BYTES)
}

/// A positive number up to 1e12.
pub(super) fn positive<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let given = f64::deserialize(deserializer)?;
    if given > 0.0 && given <= 1e12 {
        Ok(given)
    } else {
        Err(D::Error::custom(format_args!("{given} is not positive and at most 1e12")))
    }
}

/// A number from 0 to 1.
pub(super) fn fraction<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let given = f64::deserialize(deserializer)?;
    if (0.0..=1.0).contains(&given) {
        Ok(given)
    } else {
        Err(D::Error::custom(format_args!("{given} is not between 0 and 1")))
    }
}

/// A positive time in s.
pub(super) fn seconds<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
    positive(deserializer).map(Duration::from_secs_f64)
}
