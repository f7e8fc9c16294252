//! `application/x-npy`: one array of f32, f64 or u32 in NumPy's format, version 1.0, row-major.
//!
//! Source: `numpy.lib.format`. Bytes: `\x93NUMPY`, version 1 0, header length as u16, a Python
//! dictionary `{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }` padded with spaces and
//! a newline to a multiple of 64 bytes, then the elements.

use crate::array::{Array, DType, Data, n_elements};

const MAGIC: &[u8; 8] = b"\x93NUMPY\x01\x00";
const ALIGNMENT: usize = 64;
/// Most axes of an array.
pub const MAX_RANK: usize = 8;

/// Bytes that are not such an array, or an array that this format cannot carry.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NpyError {
    /// Not version 1.0 of the format.
    #[error("not a NumPy array file of version 1.0")]
    Magic,
    /// The header cannot be read.
    #[error("the header is not that of a row-major array of f32, f64 or u32: {0:?}")]
    Header(String),
    /// Shape and elements disagree.
    #[error("the shape {shape:?} and {actual} bytes of elements disagree")]
    Length {
        /// The shape.
        shape: Vec<usize>,
        /// Bytes of elements there are.
        actual: usize,
    },
    /// Too many axes.
    #[error("only arrays of at most {MAX_RANK} axes travel as .npy")]
    Unsupported,
}

/// The array as bytes; its name does not travel.
pub fn encode(array: &Array<'_>) -> Result<Vec<u8>, NpyError> {
    let descr = match array.data.dtype() {
        DType::F32 => "<f4",
        DType::F64 => "<f8",
        DType::U32 => "<u4",
    };
    if array.shape.len() > MAX_RANK {
        return Err(NpyError::Unsupported);
    }
    let data = array.data.bytes();
    if !array.is_consistent() {
        return Err(NpyError::Length { shape: array.shape.clone(), actual: data.len() });
    }
    let shape: String = array.shape.iter().map(|extent| format!("{extent}, ")).collect();
    let shape =
        if array.shape.len() == 1 { shape.trim_end() } else { shape.trim_end_matches(", ") };
    let mut header =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    let prefix = MAGIC.len() + 2;
    let size = (prefix + header.len() + 1).next_multiple_of(ALIGNMENT);
    header.extend(std::iter::repeat_n(' ', size - prefix - header.len() - 1));
    header.push('\n');
    let mut bytes = Vec::with_capacity(size + data.len());
    bytes.extend_from_slice(MAGIC);
    // At most MAX_RANK extents of 20 digits: far below 64 KiB.
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend_from_slice(data);
    Ok(bytes)
}

/// The array that `bytes` holds, all of them, named `name`. A view of `bytes` where it is aligned.
pub fn decode<'a>(name: &'a str, bytes: &'a [u8]) -> Result<Array<'a>, NpyError> {
    let rest = bytes.strip_prefix(MAGIC).ok_or(NpyError::Magic)?;
    let (length, rest) = rest.split_first_chunk::<2>().ok_or(NpyError::Magic)?;
    let length = usize::from(u16::from_le_bytes(*length));
    let (header, data) = rest.split_at_checked(length).ok_or(NpyError::Magic)?;
    let header = std::str::from_utf8(header).map_err(|_| NpyError::Magic)?;
    let (dtype, shape) =
        parse_header(header).ok_or_else(|| NpyError::Header(header.trim_end().to_owned()))?;
    if n_elements(&shape).and_then(|n| n.checked_mul(dtype.size())) != Some(data.len()) {
        return Err(NpyError::Length { shape, actual: data.len() });
    }
    Ok(Array { name: name.into(), shape, data: Data::view(dtype, data) })
}

/// Reads the dictionary as NumPy writes it: these three entries, in this (sorted) order.
fn parse_header(header: &str) -> Option<(DType, Vec<usize>)> {
    let rest = header.strip_prefix("{'descr': '<")?;
    let (dtype, rest) = match rest.split_at_checked(2)? {
        ("f4", rest) => (DType::F32, rest),
        ("f8", rest) => (DType::F64, rest),
        ("u4", rest) => (DType::U32, rest),
        _ => return None,
    };
    let rest = rest.strip_prefix("', 'fortran_order': False, 'shape': (")?;
    let (shape, rest) = rest.split_once(')')?;
    if rest.trim_end() != ", }" || !header.ends_with('\n') {
        return None;
    }
    if shape.is_empty() {
        return Some((dtype, Vec::new()));
    }
    // A single extent is followed by a comma, several are not: `(3,)` and `(2, 3)`.
    let shape = match shape.strip_suffix(',') {
        Some(single) if !single.contains(',') => single,
        Some(_) => return None,
        None if !shape.contains(',') => return None,
        None => shape,
    };
    let extents: Vec<usize> =
        shape.split(", ").map(|extent| extent.parse().ok()).collect::<Option<_>>()?;
    (extents.len() <= MAX_RANK).then_some((dtype, extents))
}
