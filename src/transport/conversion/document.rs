//! JSON documents from outside: parsed with the place of the fault, never deeper than serde_json's
//! recursion limit.

use crate::problem::{Kind, Problem};
use serde::de::DeserializeOwned;
use serde_path_to_error::{Path, Segment};
use std::fmt::Write;

/// Reads one JSON document, all of `bytes`.
pub(crate) fn parse_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let document = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let pointer = pointer(error.path());
        let problem = Problem::new(Kind::MalformedDocument, error.inner().to_string());
        // Where the text ends or breaks off, no member is at fault.
        if error.inner().is_data() { problem.at(pointer) } else { problem }
    })?;
    deserializer.end().map_err(|error| Problem::new(Kind::MalformedDocument, error.to_string()))?;
    Ok(document)
}

/// Reads one bincode document, all of `bytes`.
pub(crate) fn parse_bincode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    sutura_proto::bus::decode(bytes)
        .map_err(|error| Problem::new(Kind::MalformedDocument, error.to_string()))
}

/// The path as a JSON pointer (RFC 6901), as far as it is known.
fn pointer(path: &Path) -> String {
    let mut pointer = String::new();
    for segment in path.iter() {
        // Writing to a string cannot fail.
        let _ = match segment {
            Segment::Seq { index } => write!(pointer, "/{index}"),
            Segment::Map { key } => write!(pointer, "/{}", escape(key)),
            Segment::Enum { variant } => write!(pointer, "/{}", escape(variant)),
            Segment::Unknown => break,
        };
    }
    pointer
}

/// Escapes one reference token of a JSON pointer.
pub(crate) fn escape(token: &str) -> String {
    token.replace('~', "~0").replace('/', "~1")
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_proto::edit::EditRequest;
    use sutura_proto::session::SessionConfig;

    fn problem<T: DeserializeOwned + std::fmt::Debug>(json: &str) -> Problem {
        let problem = parse_json::<T>(json.as_bytes()).unwrap_err();
        assert_eq!(problem.status(), 400);
        problem
    }

    #[test]
    fn a_wrong_member_is_pointed_at() {
        let json = r#"{"edits": [{"stitch": {"pairs": [[1, 2], [3, -4]], "stiffness_n_m": 1}}]}"#;
        let problem = problem::<EditRequest>(json);
        assert_eq!(problem.pointer.as_deref(), Some("/edits/0/stitch/pairs/1/1"));
        assert!(problem.detail.contains("-4"), "{}", problem.detail);
    }

    #[test]
    fn text_that_breaks_off_is_located_by_line_and_column() {
        let problem = problem::<EditRequest>("{\"edits\": [\n");
        assert_eq!(problem.pointer, None);
        assert!(problem.detail.contains("line 2"), "{}", problem.detail);
    }

    #[test]
    fn a_nesting_bomb_is_refused_by_depth() {
        for open in ["[", "{\"mesh\":"] {
            let problem = problem::<SessionConfig>(&open.repeat(100_000));
            assert!(problem.detail.len() < 500);
        }
        let deep = format!("{{\"edits\": {}", "[".repeat(1_000_000));
        problem::<EditRequest>(&deep);
        problem::<serde_json::Value>(&"[".repeat(1_000_000));
    }

    #[test]
    fn numbers_beyond_f64_and_trailing_text_are_refused() {
        problem::<EditRequest>(r#"{"tolerance": 1e999, "edits": []}"#);
        problem::<EditRequest>(r#"{"tolerance": NaN, "edits": []}"#);
        problem::<EditRequest>(r#"{"edits": []} {}"#);
    }

    #[test]
    fn pointer_tokens_are_escaped() {
        assert_eq!(escape("a/b~c"), "a~1b~0c");
    }
}
