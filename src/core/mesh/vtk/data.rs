//! The binary arrays of .vtu files: base64 or raw bytes, plain or in zlib blocks.
//!
//! ```text
//! plain        n_bytes, data
//! compressed   n_blocks, n_block_bytes, n_last_block_bytes, n_compressed_bytes of each block, blocks
//! ```
//! The numbers are of the file's header type. In base64 what follows the header may or may not begin
//! anew after padding.

use super::scalar::{Numbers, Scalar};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::borrow::Cow;

/// How a file's binary arrays are written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Form {
    pub(super) is_big_endian: bool,
    /// The type of the numbers in headers.
    pub(super) header: Scalar,
    pub(super) is_compressed: bool,
}

/// Why an array could not be read.
pub(super) type Fault = String;

/// Bytes as they stand in the file.
pub(super) enum Source<'a> {
    Raw(&'a [u8]),
    Base64(Base64<'a>),
}

/// Base64 characters, decoded as they are taken.
pub(super) struct Base64<'a> {
    rest: &'a [u8],
    /// Decoded and not yet taken: at most two bytes.
    pending: Vec<u8>,
}

impl<'a> Source<'a> {
    pub(super) fn base64(characters: &'a [u8]) -> Source<'a> {
        Source::Base64(Base64 { rest: characters, pending: Vec::new() })
    }

    /// The most bytes that can still be taken.
    fn room(&self) -> usize {
        match self {
            Source::Raw(rest) => rest.len(),
            Source::Base64(Base64 { rest, pending }) => pending.len() + rest.len() / 4 * 3,
        }
    }

    fn take(&mut self, n: usize) -> Result<Cow<'a, [u8]>, Fault> {
        let room = self.room();
        if n > room {
            return Err(format!("{n} bytes are announced, but at most {room} follow"));
        }
        match self {
            Source::Raw(rest) => {
                let (taken, left) = rest.split_at(n);
                *rest = left;
                Ok(Cow::Borrowed(taken))
            }
            Source::Base64(source) => source.take(n).map(Cow::Owned),
        }
    }

    fn numbers(&mut self, form: Form, n: usize) -> Result<Vec<u64>, Fault> {
        let size = n.checked_mul(form.header.size()).ok_or("the header is endless")?;
        let bytes = self.take(size)?;
        match form.header.decode(&bytes, form.is_big_endian) {
            Numbers::Integers(values) => Ok(values.into_iter().map(|value| value as u64).collect()),
            Numbers::Reals(_) => Err("the header is not of integers".to_owned()),
        }
    }

    /// The bytes of one array; no more than `limit` of them.
    pub(super) fn array(&mut self, form: Form, limit: usize) -> Result<Cow<'a, [u8]>, Fault> {
        let count = |n: u64| usize::try_from(n).ok().filter(|&n| n <= limit);
        let too_large = || format!("the array has more than the {limit} bytes it may have");
        if !form.is_compressed {
            let size = self.numbers(form, 1)?[0];
            return self.take(count(size).ok_or_else(too_large)?);
        }
        let n_blocks = self.numbers(form, 1)?[0];
        if n_blocks == 0 {
            return Ok(Cow::Borrowed(&[]));
        }
        if n_blocks > self.room() as u64 {
            return Err(format!(
                "{n_blocks} blocks are announced, but {} bytes follow",
                self.room()
            ));
        }
        let n_blocks = n_blocks as usize;
        let sizes = self.numbers(form, 2 + n_blocks)?;
        let (block, last) = (sizes[0], if sizes[1] == 0 { sizes[0] } else { sizes[1] });
        let total = (n_blocks as u64 - 1).checked_mul(block).and_then(|n| n.checked_add(last));
        let total = total.and_then(count).ok_or_else(too_large)?;
        let mut bytes = vec![0; total];
        let mut blocks = bytes.chunks_mut((block as usize).max(1));
        for (i, &n_compressed) in sizes[2..].iter().enumerate() {
            let n_compressed = usize::try_from(n_compressed).map_err(|_| too_large())?;
            let compressed = self.take(n_compressed)?;
            let target = blocks.next().unwrap_or_default();
            let inflated = miniz_oxide::inflate::decompress_slice_iter_to_slice(
                target,
                std::iter::once(compressed.as_ref()),
                true,
                false,
            );
            if inflated != Ok(target.len()) {
                return Err(format!("block {i} is not {} bytes of zlib data", target.len()));
            }
        }
        Ok(Cow::Owned(bytes))
    }
}

impl Base64<'_> {
    /// `n` bytes that there may be.
    fn take(&mut self, n: usize) -> Result<Vec<u8>, Fault> {
        let mut bytes = std::mem::take(&mut self.pending);
        // Each turn takes what should do; where padding ends a run short, another one follows.
        while bytes.len() < n {
            let n_characters = (n - bytes.len()).div_ceil(3) * 4;
            let run = &self.rest[..n_characters.min(self.rest.len())];
            // A run ends at the group that is padded.
            let end = run.iter().position(|&c| c == b'=').map_or(run.len(), |at| at / 4 * 4 + 4);
            let run = run.get(..end).filter(|run| !run.is_empty());
            let run = run.ok_or_else(|| "the base64 data ends too early".to_owned())?;
            let start = bytes.len();
            bytes.resize(start + run.len() / 4 * 3, 0);
            let n_decoded = STANDARD
                .decode_slice(run, &mut bytes[start..])
                .map_err(|error| format!("the base64 data is broken: {error}"))?;
            bytes.truncate(start + n_decoded);
            self.rest = &self.rest[run.len()..];
        }
        self.pending = bytes.split_off(n);
        Ok(bytes)
    }
}
