//! Lines of a text file whose records are lines: fields between blanks or commas, comments after `#`.

use super::cursor::{Cursor, quote};
use super::reader::{ReadError, ReadFault};

/// One line that says something.
pub(super) struct Line<'a> {
    /// Where it begins.
    pub(super) at: usize,
    /// At least one.
    pub(super) fields: Vec<&'a str>,
}

/// The next line that holds more than blanks and a comment.
pub(super) fn next<'a>(cursor: &mut Cursor<'a>) -> Result<Option<Line<'a>>, ReadError> {
    loop {
        cursor.skip_whitespace();
        let at = cursor.position();
        if cursor.remaining().is_empty() {
            return Ok(None);
        }
        let bytes = cursor.line();
        let bytes = bytes.split(|&byte| byte == b'#').next().unwrap_or(bytes);
        let text = std::str::from_utf8(bytes).map_err(|_| cursor.unexpected(at, "text"))?;
        let fields: Vec<&str> =
            text.split([' ', '\t', ',']).filter(|field| !field.is_empty()).collect();
        if !fields.is_empty() {
            return Ok(Some(Line { at, fields }));
        }
    }
}

/// The next line, which has to be there.
pub(super) fn required<'a>(cursor: &mut Cursor<'a>, expected: &str) -> Result<Line<'a>, ReadError> {
    let line = next(cursor)?;
    line.ok_or_else(|| cursor.unexpected(cursor.position(), expected))
}

impl Line<'_> {
    /// The number in a field.
    pub(super) fn number<T: std::str::FromStr>(
        &self,
        cursor: &Cursor<'_>,
        field: usize,
        expected: &str,
    ) -> Result<T, ReadError> {
        let text = self.fields.get(field);
        text.and_then(|text| text.parse().ok()).ok_or_else(|| {
            let found = match text {
                Some(text) => format!("“{}”", quote(text.as_bytes())),
                None => "the end of the line".to_owned(),
            };
            let expected = expected.to_owned();
            cursor.error(self.at, ReadFault::Unexpected { expected, found })
        })
    }

    /// Checks that the line's own number follows the previous one; the first sets the base.
    pub(super) fn check_number(
        &self,
        cursor: &Cursor<'_>,
        what: &str,
        position: u64,
        first: &mut u64,
    ) -> Result<(), ReadError> {
        let number: u64 = self.number(cursor, 0, what)?;
        if position == 0 && number <= 1 {
            *first = number;
        }
        if number != *first + position {
            let message = match position {
                0 => format!("{what} of the first one is {number}, neither 0 nor 1"),
                _ => format!("{what} is {number} where {} should come", *first + position),
            };
            return Err(cursor.error(self.at, ReadFault::Inconsistent(message)));
        }
        Ok(())
    }
}
