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

/// What the attachment of a query or a publication says, line by line: a key, where the daemon asks for one,
/// and `x-request-id: ID`. Answers carry the request's name in the same way.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Attachment {
    /// Who asks.
    pub key: Option<String>,
    /// What the request is called in the daemon's log; the daemon makes a name up where there is none.
    pub request_id: Option<String>,
}

/// What precedes the name of a request.
const REQUEST_ID: &str = "x-request-id:";

/// Longest name of a request, in bytes.
pub const MAX_REQUEST_ID_BYTES: usize = 128;

/// Whether `name` can be repeated safely in a header or a log line.
pub fn is_request_id(name: &[u8]) -> bool {
    (1..=MAX_REQUEST_ID_BYTES).contains(&name.len())
        && name.iter().all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(b))
}

impl Attachment {
    /// As it travels; `None` where there is nothing to say.
    pub fn encode(&self) -> Option<String> {
        let name = self.request_id.as_ref().map(|name| format!("{REQUEST_ID} {name}"));
        let lines: Vec<&str> = self.key.as_deref().into_iter().chain(name.as_deref()).collect();
        (!lines.is_empty()).then(|| lines.join("\n"))
    }

    /// What `bytes` say. A name that cannot be repeated is left out; what is no text says nothing.
    pub fn decode(bytes: &[u8]) -> Attachment {
        let mut attachment = Attachment::default();
        for line in std::str::from_utf8(bytes).unwrap_or_default().lines() {
            match line.strip_prefix(REQUEST_ID).map(str::trim) {
                Some(name) if is_request_id(name.as_bytes()) => {
                    attachment.request_id = Some(name.to_owned());
                }
                Some(_) => {}
                None => attachment.key = Some(line.to_owned()),
            }
        }
        attachment
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attachments_say_who_asks_and_what_the_request_is_called() {
        let key = Some("sutura_0123".to_owned());
        let request_id = Some("edit-7".to_owned());
        for attachment in [
            Attachment::default(),
            Attachment { key: key.clone(), request_id: None },
            Attachment { key: None, request_id: request_id.clone() },
            Attachment { key: key.clone(), request_id },
        ] {
            let text = attachment.encode().unwrap_or_default();
            assert_eq!(Attachment::decode(text.as_bytes()), attachment);
        }
        // A key alone is what clients have always sent.
        assert_eq!(Attachment::decode(b"sutura_0123").key, key);
        assert_eq!(Attachment::decode(b"x-request-id: a b").request_id, None);
        assert_eq!(Attachment::decode(&[0xff, 0xfe]), Attachment::default());
    }
}
