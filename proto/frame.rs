//! `application/vnd.sutura.frame`: named arrays in one block of bytes.
//!
//! A bincode 2 header (little-endian, fixed-width integers), zero bytes up to a multiple of 8, then
//! the arrays in the header's order, each starting at a multiple of 8 (zero bytes between), the
//! last one ending the frame:
//!
//! | bytes | header member |
//! |---|---|
//! | 8 | magic: `SUTURA`, format version 1, 0 |
//! | 8 | generation, u64 |
//! | 8 | number of arrays, u64 |
//! | 8 + n | for each array: length n of its name as u64, the name in UTF-8 |
//! | 4 | its element type as u32: 0 = f32, 1 = f64, 2 = u32 |
//! | 8 + 8 k | its rank k as u64, then its extents as u64, the slowest axis first |

use crate::array::{Array, DType, Data, n_elements};
use crate::bus::fixed_width;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// First bytes of every frame; the seventh is the format's version.
pub const MAGIC: [u8; 8] = *b"SUTURA\x01\0";
/// Most arrays in a frame.
pub const MAX_ARRAYS: usize = 32;
/// Most axes of an array.
pub const MAX_RANK: usize = 4;
/// Longest name of an array, in bytes.
pub const MAX_NAME_BYTES: usize = 64;
/// Longest header, in bytes: [`MAX_ARRAYS`] of the longest fit.
pub const MAX_HEADER_BYTES: usize = 8 * 1024;

const ALIGNMENT: usize = 8;

#[derive(Serialize, Deserialize)]
struct Header {
    magic: [u8; 8],
    generation: u64,
    arrays: Vec<ArrayHeader>,
}

#[derive(Serialize, Deserialize)]
struct ArrayHeader {
    name: String,
    dtype: DType,
    shape: Vec<u64>,
}

/// Named arrays that belong to one generation.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame<'a> {
    /// The generation they describe.
    pub generation: u64,
    /// The arrays.
    pub arrays: Vec<Array<'a>>,
}

/// Bytes that are not a frame, or arrays that do not make one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The header cannot be read.
    #[error("the frame's header cannot be read: {0}")]
    Header(String),
    /// Not a frame, or of another version.
    #[error("the bytes do not start with the mark of a version 1 frame")]
    Magic,
    /// A limit is exceeded.
    #[error("{what} is {value}, at most {limit}")]
    TooMany {
        /// What there is too much of.
        what: &'static str,
        /// How much there is.
        value: usize,
        /// How much there may be.
        limit: usize,
    },
    /// Two arrays of one name.
    #[error("two arrays are named {0:?}")]
    Duplicate(String),
    /// A shape and its elements disagree.
    #[error("array {name:?}: {actual} elements do not fill the shape {shape:?}")]
    Shape {
        /// The array.
        name: String,
        /// Its shape.
        shape: Vec<usize>,
        /// The elements it holds.
        actual: usize,
    },
    /// Announced and actual length disagree.
    #[error("the header announces a frame of {expected} bytes, but there are {actual}")]
    Length {
        /// Bytes announced.
        expected: usize,
        /// Bytes there are.
        actual: usize,
    },
    /// The announced length overflows.
    #[error("array {0:?} is announced larger than any memory")]
    Overflow(String),
    /// An array is missing, or is not of the expected type and shape.
    #[error("array {name:?} is {found}, expected {expected}")]
    Unexpected {
        /// The array.
        name: String,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
}

impl<'a> Frame<'a> {
    /// The frame as bytes, written once into a buffer of the right size.
    pub fn encode(&self) -> Result<Vec<u8>, FrameError> {
        let header = Header {
            magic: MAGIC,
            generation: self.generation,
            arrays: self.arrays.iter().map(describe).collect::<Result<_, _>>()?,
        };
        check_names(&header.arrays)?;
        let header = bincode::serde::encode_to_vec(&header, fixed_width::<MAX_HEADER_BYTES>())
            .map_err(|e| FrameError::Header(e.to_string()))?;
        let mut size = header.len();
        for array in &self.arrays {
            size = size.next_multiple_of(ALIGNMENT) + array.data.bytes().len();
        }
        let mut bytes = Vec::with_capacity(size);
        bytes.extend_from_slice(&header);
        for array in &self.arrays {
            bytes.resize(bytes.len().next_multiple_of(ALIGNMENT), 0);
            bytes.extend_from_slice(array.data.bytes());
        }
        Ok(bytes)
    }

    /// The frame that `bytes` holds, all of them. Arrays are views of `bytes` where it is aligned.
    /// Every length is checked against `bytes` before anything of that length is allocated.
    pub fn decode(bytes: &'a [u8]) -> Result<Frame<'a>, FrameError> {
        if !bytes.starts_with(&MAGIC) {
            return Err(FrameError::Magic);
        }
        let head = &bytes[..bytes.len().min(MAX_HEADER_BYTES)];
        let (header, mut end): (Header, usize) =
            bincode::serde::decode_from_slice(head, fixed_width::<MAX_HEADER_BYTES>())
                .map_err(|e| FrameError::Header(e.to_string()))?;
        check_names(&header.arrays)?;
        let mut blocks = Vec::with_capacity(header.arrays.len());
        for array in header.arrays {
            let overflow = || FrameError::Overflow(array.name.clone());
            let shape: Vec<usize> = array
                .shape
                .iter()
                .map(|&extent| usize::try_from(extent).map_err(|_| overflow()))
                .collect::<Result<_, _>>()?;
            let size = n_elements(&shape)
                .and_then(|n| n.checked_mul(array.dtype.size()))
                .ok_or_else(overflow)?;
            let start = end.checked_next_multiple_of(ALIGNMENT).ok_or_else(overflow)?;
            end = start.checked_add(size).ok_or_else(overflow)?;
            blocks.push((array.name, array.dtype, shape, start..end));
        }
        if end != bytes.len() {
            return Err(FrameError::Length { expected: end, actual: bytes.len() });
        }
        let arrays = blocks
            .into_iter()
            .map(|(name, dtype, shape, range)| Array {
                name: Cow::Owned(name),
                shape,
                data: Data::view(dtype, &bytes[range]),
            })
            .collect();
        Ok(Frame { generation: header.generation, arrays })
    }

    /// Takes the array called `name` out of the frame.
    pub fn take(&mut self, name: &str) -> Result<Array<'a>, FrameError> {
        match self.arrays.iter().position(|array| array.name == name) {
            Some(i) => Ok(self.arrays.swap_remove(i)),
            None => Err(FrameError::Unexpected {
                name: name.to_owned(),
                found: "missing".to_owned(),
                expected: "present".to_owned(),
            }),
        }
    }
}

fn describe(array: &Array<'_>) -> Result<ArrayHeader, FrameError> {
    if !array.is_consistent() {
        return Err(FrameError::Shape {
            name: array.name.to_string(),
            shape: array.shape.clone(),
            actual: array.data.len(),
        });
    }
    Ok(ArrayHeader {
        name: array.name.to_string(),
        dtype: array.data.dtype(),
        shape: array.shape.iter().map(|&extent| extent as u64).collect(),
    })
}

fn check_names(arrays: &[ArrayHeader]) -> Result<(), FrameError> {
    let at_most = |what, value, limit| {
        if value <= limit { Ok(()) } else { Err(FrameError::TooMany { what, value, limit }) }
    };
    at_most("the number of arrays", arrays.len(), MAX_ARRAYS)?;
    for (i, array) in arrays.iter().enumerate() {
        at_most("the length of an array's name", array.name.len(), MAX_NAME_BYTES)?;
        at_most("the rank of an array", array.shape.len(), MAX_RANK)?;
        if arrays[..i].iter().any(|other| other.name == array.name) {
            return Err(FrameError::Duplicate(array.name.clone()));
        }
    }
    Ok(())
}
