//! A position in the bytes of a mesh file, with located errors.

use super::reader::{Location, ReadError, ReadFault};

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    Binary { big_endian: bool },
}

/// Longest piece of the file that an error message quotes, in bytes.
const MAX_QUOTE: usize = 32;

/// A piece of the file as an error message shows it: printable and short.
pub(super) fn quote(piece: &[u8]) -> String {
    let shown = &piece[..piece.len().min(MAX_QUOTE)];
    let ellipsis = if shown.len() < piece.len() { "…" } else { "" };
    format!("{}{ellipsis}", String::from_utf8_lossy(shown).escape_debug())
}

/// Reads numbers one after another. In text a *record* (a node, an element, a block header) stands
/// on one line, so that a missing number is found where it is missing.
pub(super) struct Cursor<'a> {
    bytes: &'a [u8],
    position: usize,
    pub(super) encoding: Encoding,
    /// Which of several files this is.
    part: Option<&'static str>,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Cursor<'a> {
        Cursor { bytes, position: 0, encoding: Encoding::Text, part: None }
    }

    /// At the start of one of a mesh's text files, which errors call `part`.
    pub(super) fn part(bytes: &'a [u8], part: &'static str) -> Cursor<'a> {
        Cursor { part: Some(part), ..Cursor::new(bytes) }
    }

    pub(super) fn position(&self) -> usize {
        self.position
    }

    pub(super) fn remaining(&self) -> &'a [u8] {
        &self.bytes[self.position..]
    }

    pub(super) fn is_binary(&self) -> bool {
        self.encoding != Encoding::Text
    }

    /// What `position` is to a reader of the file.
    pub(super) fn location(&self, position: usize) -> Location {
        match self.encoding {
            Encoding::Text => {
                let before = &self.bytes[..position.min(self.bytes.len())];
                let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
                match self.part {
                    Some(part) => Location::PartLine(part, line),
                    None => Location::Line(line),
                }
            }
            Encoding::Binary { .. } => Location::Byte(position),
        }
    }

    pub(super) fn error(&self, position: usize, fault: ReadFault) -> ReadError {
        ReadError { location: self.location(position), fault }
    }

    /// An error at `position`, quoting what stands there.
    pub(super) fn unexpected(&self, position: usize, expected: &str) -> ReadError {
        let rest = &self.bytes[position..];
        let found = match (rest.first(), self.encoding) {
            (None, _) => "the end of the file".to_owned(),
            (_, Encoding::Binary { .. }) => format!("{} more bytes", rest.len()),
            (Some(b'\n' | b'\r'), _) => "the end of the line".to_owned(),
            _ => {
                let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
                format!("“{}”", quote(&rest[..end]))
            }
        };
        self.error(position, ReadFault::Unexpected { expected: expected.to_owned(), found })
    }

    pub(super) fn skip_whitespace(&mut self) {
        self.position = self.bytes.len() - self.remaining().trim_ascii_start().len();
    }

    /// Starts a record: in text, skips blank lines.
    pub(super) fn record(&mut self) -> usize {
        if !self.is_binary() {
            self.skip_whitespace();
        }
        self.position
    }

    /// The rest of the current line without its end, trimmed.
    pub(super) fn line(&mut self) -> &'a [u8] {
        let rest = self.remaining();
        let end = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
        self.position += (end + 1).min(rest.len());
        rest[..end].trim_ascii()
    }

    /// Skips to just behind the next occurrence of `marker`; false if there is none.
    pub(super) fn skip_past(&mut self, marker: &[u8]) -> bool {
        let found = self.remaining().windows(marker.len()).position(|window| window == marker);
        if let Some(offset) = found {
            self.position += offset + marker.len();
        }
        found.is_some()
    }

    /// Goes back to a position that was read before.
    pub(super) fn rewind(&mut self, position: usize) {
        self.position = position.min(self.bytes.len());
    }

    /// Skips `n` bytes that were checked to be there.
    pub(super) fn skip(&mut self, n: usize) {
        self.position = (self.position + n).min(self.bytes.len());
    }

    /// The next number of the record, in text.
    fn token<T: std::str::FromStr>(&mut self, expected: &str) -> Result<T, ReadError> {
        let rest = self.remaining();
        let blank = rest.iter().position(|byte| !matches!(byte, b' ' | b'\t'));
        let start = self.position + blank.unwrap_or(rest.len());
        let rest = &self.bytes[start..];
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let number = std::str::from_utf8(&rest[..end]).ok().and_then(|token| token.parse().ok());
        self.position = start + end;
        number.ok_or_else(|| self.unexpected(start, expected))
    }

    /// The next `N` bytes, least significant first.
    fn word<const N: usize>(&mut self, expected: &str) -> Result<[u8; N], ReadError> {
        let Some(&(mut word)) = self.remaining().first_chunk::<N>() else {
            return Err(self.unexpected(self.position, expected));
        };
        if self.encoding == (Encoding::Binary { big_endian: true }) {
            word.reverse();
        }
        self.position += N;
        Ok(word)
    }

    /// An integer: 4 bytes in binary.
    pub(super) fn int(&mut self, expected: &str) -> Result<i64, ReadError> {
        match self.encoding {
            Encoding::Text => self.token(expected),
            Encoding::Binary { .. } => Ok(i32::from_le_bytes(self.word(expected)?).into()),
        }
    }

    /// A count or number that cannot be negative, of 4 bytes in binary.
    pub(super) fn unsigned(&mut self, expected: &str) -> Result<u64, ReadError> {
        let at = self.position;
        let value = self.int(expected)?;
        u64::try_from(value).map_err(|_| {
            let found = value.to_string();
            self.error(at, ReadFault::Unexpected { expected: expected.to_owned(), found })
        })
    }

    /// A count or tag of 8 bytes in binary.
    pub(super) fn size(&mut self, expected: &str) -> Result<u64, ReadError> {
        match self.encoding {
            Encoding::Text => self.token(expected),
            Encoding::Binary { .. } => Ok(u64::from_le_bytes(self.word(expected)?)),
        }
    }

    /// A double.
    pub(super) fn real(&mut self, expected: &str) -> Result<f64, ReadError> {
        match self.encoding {
            Encoding::Text => self.token(expected),
            Encoding::Binary { .. } => Ok(f64::from_le_bytes(self.word(expected)?)),
        }
    }

    /// The next integer of a text, on whatever line.
    pub(super) fn free_int(&mut self, expected: &str) -> Result<i64, ReadError> {
        self.skip_whitespace();
        self.token(expected)
    }

    /// The next number of a text, on whatever line.
    pub(super) fn free_real(&mut self, expected: &str) -> Result<f64, ReadError> {
        self.skip_whitespace();
        self.token(expected)
    }

    pub(super) fn point(&mut self) -> Result<[f64; 3], ReadError> {
        Ok([
            self.real("an x coordinate")?,
            self.real("a y coordinate")?,
            self.real("a z coordinate")?,
        ])
    }

    /// Holds a declared count against the bytes left, each of the things taking at least
    /// `n_bytes_each`.
    pub(super) fn check_room(
        &self,
        what: &'static str,
        declared: u64,
        n_bytes_each: u64,
    ) -> Result<(), ReadError> {
        let remaining = self.remaining().len();
        // The last record of a text file may lack its line end.
        if declared.saturating_mul(n_bytes_each) > remaining as u64 + 1 {
            let fault = ReadFault::Truncated { what, declared, remaining };
            return Err(self.error(self.position, fault));
        }
        Ok(())
    }

    /// Holds a declared count against a limit.
    pub(super) fn check_limit(
        &self,
        what: &'static str,
        declared: u64,
        limit: usize,
    ) -> Result<(), ReadError> {
        let limit = limit as u64;
        if declared > limit {
            let fault = ReadFault::OverLimit { what, declared, limit };
            return Err(self.error(self.position, fault));
        }
        Ok(())
    }
}
