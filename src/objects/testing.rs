//! Doors for tests of other crates (feature `testing`).

use crate::header::Header;

/// Reads a journal's object. Returns its header as it would be written, and its records.
pub fn read_object(bytes: &[u8]) -> Option<(Vec<u8>, &[u8])> {
    let (header, records) = Header::split(bytes).ok()?;
    Some((header.before(&[]).ok()?, records))
}
