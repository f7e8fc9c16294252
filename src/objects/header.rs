//! What stands before the records in a journal's object: one line of JSON.

use serde::{Deserialize, Serialize};

/// Longest header that is read.
const MAX_BYTES: usize = 1024;

/// The form; another one is not read.
const FORMAT: u32 = 1;

/// Who wrote the object. No two writes have equal headers, so no two objects that ever existed under a name
/// have equal bytes, and none of their ETags stands for two of them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Header {
    /// [`FORMAT`].
    pub(crate) sutura_journal: u32,
    /// The process, by a name that it made up at its start.
    pub(crate) writer: String,
    /// How many writes of that process came before.
    pub(crate) write: u64,
    /// The daemon's name, which lasts from process to process.
    pub(crate) daemon: String,
    /// Whether the session is gone.
    pub(crate) is_deleted: bool,
}

impl Header {
    pub(crate) fn new(writer: &str, write: u64, daemon: &str, is_deleted: bool) -> Header {
        Header {
            sutura_journal: FORMAT,
            writer: writer.to_owned(),
            write,
            daemon: daemon.to_owned(),
            is_deleted,
        }
    }

    /// An object's bytes: header and records.
    pub(crate) fn before(&self, records: &[u8]) -> Result<Vec<u8>, serde_json::Error> {
        let mut bytes = serde_json::to_vec(self)?;
        bytes.push(b'\n');
        bytes.extend_from_slice(records);
        Ok(bytes)
    }

    /// Header and records of an object; why it has none otherwise.
    pub(crate) fn split(bytes: &[u8]) -> Result<(Header, &[u8]), String> {
        let head = &bytes[..bytes.len().min(MAX_BYTES)];
        let end = head.iter().position(|byte| *byte == b'\n').ok_or("it has no header")?;
        let header: Header = serde_json::from_slice(&bytes[..end])
            .map_err(|error| format!("its header: {error}"))?;
        if header.sutura_journal != FORMAT {
            return Err(format!(
                "its form is {}, this version reads {FORMAT}",
                header.sutura_journal
            ));
        }
        Ok((header, &bytes[end + 1..]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_read_as_it_was_written_and_nothing_else_is() {
        let header = Header::new("w", 7, "a \"quoted\"\nname", false);
        let bytes = header.before(b"records\n").unwrap();
        assert_eq!(Header::split(&bytes).unwrap(), (header, &b"records\n"[..]));
        let later =
            br#"{"sutura_journal":2,"writer":"w","write":0,"daemon":"d","is_deleted":false}"#;
        let long = [b'x'; 2 * MAX_BYTES];
        for bytes in [&b""[..], b"\n", b"{}\n", b"SUTR", &[later, &b"\n"[..]].concat(), &long] {
            assert!(Header::split(bytes).is_err(), "{bytes:?}");
        }
        for end in 0..bytes.len() - b"\nrecords\n".len() {
            assert!(Header::split(&bytes[..end]).is_err(), "{end}");
        }
    }
}
