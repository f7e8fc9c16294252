//! Control documents as bincode, for Zenoh payloads with the encoding [`crate::media::BINCODE`].
//!
//! The same structs as in JSON, in bincode 2's fixed-width little-endian form: members in order of
//! declaration, `usize` and lengths as u64, options as one byte (0 or 1) and the value, enum
//! variants as u32 in order of declaration.

use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Largest document, in bytes.
pub const MAX_DOCUMENT_BYTES: usize = 16 << 20;

/// The one bincode form this contract uses: little-endian, fixed width, no document longer than
/// `LIMIT` bytes.
pub(crate) const fn fixed_width<const LIMIT: usize>()
-> Configuration<LittleEndian, Fixint, Limit<LIMIT>> {
    bincode::config::standard().with_fixed_int_encoding().with_limit::<LIMIT>()
}

/// Bytes that are not the document they should be.
#[derive(Debug, thiserror::Error)]
#[error("not the expected bincode document: {0}")]
pub struct BincodeError(String);

/// Encodes a document.
pub fn encode(document: &impl Serialize) -> Result<Vec<u8>, BincodeError> {
    bincode::serde::encode_to_vec(document, fixed_width::<MAX_DOCUMENT_BYTES>())
        .map_err(|e| BincodeError(e.to_string()))
}

/// Decodes a document, all of `bytes`.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, BincodeError> {
    let (document, used) =
        bincode::serde::decode_from_slice(bytes, fixed_width::<MAX_DOCUMENT_BYTES>())
            .map_err(|e| BincodeError(e.to_string()))?;
    if used != bytes.len() {
        let extra = bytes.len() - used;
        return Err(BincodeError(format!("{extra} bytes after its end")));
    }
    Ok(document)
}
