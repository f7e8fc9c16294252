//! Records as bytes: each behind a header with its length and a SHA-256 of header and contents, so that
//! whatever is not as it was written shows.
//!
//! `magic [4] | version u32 | length u64 | SHA-256 [32] | contents`, little-endian.

use sha2::{Digest as _, Sha256};

/// A SHA-256.
pub(crate) type Digest = [u8; 32];

const MAGIC: [u8; 4] = *b"SUTR";

/// Of the contents' form; what another version writes is not read.
const VERSION: u32 = 2;

const PREFIX_BYTES: usize = 16;
const HEADER_BYTES: usize = PREFIX_BYTES + size_of::<Digest>();

/// The SHA-256 of some bytes.
pub(crate) fn digest(bytes: &[u8]) -> Digest {
    Sha256::digest(bytes).into()
}

/// Lower-case hexadecimal digits.
pub(crate) fn hex(digest: &Digest) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A record's bytes.
pub(crate) fn frame(contents: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + contents.len());
    add_frame(&mut bytes, contents);
    bytes
}

/// Adds a record's bytes to those before it.
pub(crate) fn add_frame(bytes: &mut Vec<u8>, contents: &[u8]) {
    let begin = bytes.len();
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend((contents.len() as u64).to_le_bytes());
    let sum = Sha256::new().chain_update(&bytes[begin..]).chain_update(contents).finalize();
    bytes.extend(sum);
    bytes.extend(contents);
}

/// The contents of records of this version that lie one behind the other, if there is nothing else.
pub(crate) fn sequence(mut bytes: &[u8]) -> Option<Vec<&[u8]>> {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let (version, contents) = first_frame(bytes)?;
        if version != VERSION {
            return None;
        }
        found.push(contents);
        bytes = &bytes[HEADER_BYTES + contents.len()..];
    }
    Some(found)
}

/// What a blob of records holds.
pub(crate) struct Frames<'a> {
    /// The contents of the whole records, in order.
    pub(crate) whole: Vec<&'a [u8]>,
    /// Bytes up to the end of the last whole record.
    pub(crate) end: usize,
    /// Stretches of damaged bytes that whole records follow.
    pub(crate) n_damaged: usize,
    /// Whether a record is whole but written by another version.
    pub(crate) has_other_version: bool,
}

/// Reads every whole record, damaged ones left out.
pub(crate) fn frames(bytes: &[u8]) -> Frames<'_> {
    let mut found = Frames { whole: Vec::new(), end: 0, n_damaged: 0, has_other_version: false };
    let mut at = 0;
    let mut in_order = true;
    while at < bytes.len() {
        match first_frame(&bytes[at..]) {
            Some((version, contents)) => {
                found.n_damaged += usize::from(!in_order);
                in_order = true;
                match version {
                    VERSION => found.whole.push(contents),
                    _ => found.has_other_version = true,
                }
                at += HEADER_BYTES + contents.len();
                found.end = at;
            }
            None => {
                in_order = false;
                // The next place that could be a record's beginning.
                let rest = &bytes[at + 1..];
                let next = rest.windows(MAGIC.len()).position(|window| window == MAGIC);
                at = next.map_or(bytes.len(), |next| at + 1 + next);
            }
        }
    }
    found
}

/// The whole record that `bytes` begin with: its version and its contents.
fn first_frame(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (prefix, rest) = bytes.split_at_checked(PREFIX_BYTES)?;
    let (sum, rest) = rest.split_at_checked(size_of::<Digest>())?;
    let (magic, numbers) = prefix.split_at_checked(MAGIC.len())?;
    let (version, length) = numbers.split_at_checked(size_of::<u32>())?;
    let version = u32::from_le_bytes(version.try_into().ok()?);
    let length = usize::try_from(u64::from_le_bytes(length.try_into().ok()?)).ok()?;
    let contents = rest.get(..length)?;
    let is_whole = magic == MAGIC
        && Sha256::new().chain_update(prefix).chain_update(contents).finalize()[..] == *sum;
    is_whole.then_some((version, contents))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_torn_tail_is_left_out_wherever_it_is_torn() {
        let records: [&[u8]; 3] = [b"first", b"", b"the third one"];
        let bytes: Vec<u8> = records.iter().flat_map(|record| frame(record)).collect();
        let ends: Vec<usize> = (0..=3)
            .map(|n| records[..n].iter().map(|record| HEADER_BYTES + record.len()).sum())
            .collect();
        for length in 0..=bytes.len() {
            let found = frames(&bytes[..length]);
            let n_whole = ends.iter().filter(|end| **end <= length).count() - 1;
            assert_eq!(found.whole, records[..n_whole], "{length}");
            assert_eq!((found.end, found.n_damaged), (ends[n_whole], 0), "{length}");
        }
    }

    #[test]
    fn no_flipped_bit_goes_unnoticed_and_the_records_behind_it_are_found() {
        let records: [&[u8]; 3] = [b"first", b"second SUTR", b"third"];
        let bytes: Vec<u8> = records.iter().flat_map(|record| frame(record)).collect();
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let found = frames(&damaged);
            let mut at = 0;
            let hit = records.iter().position(|record| {
                at += HEADER_BYTES + record.len();
                bit / 8 < at
            });
            let mut expected = records.to_vec();
            expected.remove(hit.unwrap());
            assert_eq!(found.whole, expected, "bit {bit}");
            assert_eq!(found.n_damaged, usize::from(hit != Some(2)), "bit {bit}");
        }
    }

    #[test]
    fn a_sequence_is_whole_or_nothing() {
        let records: [&[u8]; 3] = [b"first", b"", b"the third one"];
        let mut bytes = Vec::new();
        records.iter().for_each(|record| add_frame(&mut bytes, record));
        assert_eq!(sequence(&bytes).unwrap(), records);
        assert_eq!(sequence(&[]).unwrap(), [b""; 0]);
        let ends = records.map(|record| HEADER_BYTES + record.len());
        let ends = [0, ends[0], ends[0] + ends[1]];
        for length in (1..bytes.len()).filter(|length| !ends.contains(length)) {
            assert!(sequence(&bytes[..length]).is_none(), "{length}");
        }
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(sequence(&damaged).is_none(), "bit {bit}");
        }
    }

    #[test]
    fn a_length_beyond_the_bytes_there_are_is_refused() {
        let mut bytes = frame(b"x");
        bytes[8..16].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(frames(&bytes).whole.is_empty());
    }
}
