//! The element types of VTK's arrays.

use std::borrow::Cow;

/// An element type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// The elements of an array, widened.
#[derive(Debug, PartialEq)]
pub(super) enum Numbers {
    Integers(Vec<i64>),
    Reals(Vec<f64>),
}

impl Scalar {
    /// By the name that a legacy file uses; its `long` has 8 bytes, as on the systems that write them.
    pub(super) fn of_legacy(name: &str) -> Option<Scalar> {
        Some(match name.to_ascii_lowercase().as_str() {
            "char" | "signed_char" => Scalar::I8,
            "unsigned_char" => Scalar::U8,
            "short" => Scalar::I16,
            "unsigned_short" => Scalar::U16,
            "int" => Scalar::I32,
            "unsigned_int" => Scalar::U32,
            "long" | "vtktypeint64" | "vtkidtype" | "long_long" => Scalar::I64,
            "unsigned_long" | "vtktypeuint64" | "unsigned_long_long" => Scalar::U64,
            "float" => Scalar::F32,
            "double" => Scalar::F64,
            _ => return None,
        })
    }

    /// By the name that an XML file uses.
    pub(super) fn of_xml(name: &str) -> Option<Scalar> {
        Some(match name {
            "Int8" => Scalar::I8,
            "UInt8" => Scalar::U8,
            "Int16" => Scalar::I16,
            "UInt16" => Scalar::U16,
            "Int32" => Scalar::I32,
            "UInt32" => Scalar::U32,
            "Int64" => Scalar::I64,
            "UInt64" => Scalar::U64,
            "Float32" => Scalar::F32,
            "Float64" => Scalar::F64,
            _ => return None,
        })
    }

    /// Bytes of an element.
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }

    /// Whether elements are integers.
    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Scalar::F32 | Scalar::F64)
    }

    /// The elements that `bytes` hold; an incomplete last one is left out.
    pub(super) fn decode(self, bytes: &[u8], is_big_endian: bool) -> Numbers {
        macro_rules! words {
            ($type:ty, $wide:ty) => {{
                let (words, _) = bytes.as_chunks::<{ size_of::<$type>() }>();
                let decode =
                    if is_big_endian { <$type>::from_be_bytes } else { <$type>::from_le_bytes };
                words.iter().map(|&word| decode(word) as $wide).collect()
            }};
        }
        match self {
            Scalar::I8 => Numbers::Integers(words!(i8, i64)),
            Scalar::U8 => Numbers::Integers(words!(u8, i64)),
            Scalar::I16 => Numbers::Integers(words!(i16, i64)),
            Scalar::U16 => Numbers::Integers(words!(u16, i64)),
            Scalar::I32 => Numbers::Integers(words!(i32, i64)),
            Scalar::U32 => Numbers::Integers(words!(u32, i64)),
            Scalar::I64 => Numbers::Integers(words!(i64, i64)),
            // Beyond 2⁶³ they wrap below zero, which no count or index may be.
            Scalar::U64 => Numbers::Integers(words!(u64, i64)),
            Scalar::F32 => Numbers::Reals(words!(f32, f64)),
            Scalar::F64 => Numbers::Reals(words!(f64, f64)),
        }
    }
}

impl Numbers {
    pub(super) fn len(&self) -> usize {
        match self {
            Numbers::Integers(values) => values.len(),
            Numbers::Reals(values) => values.len(),
        }
    }

    pub(super) fn reals(&self) -> Cow<'_, [f64]> {
        match self {
            Numbers::Reals(values) => Cow::Borrowed(values),
            Numbers::Integers(values) => values.iter().map(|&value| value as f64).collect(),
        }
    }

    /// The element at `i`, if it is there and is an integer.
    pub(super) fn integer(&self, i: usize) -> Option<i64> {
        match self {
            Numbers::Integers(values) => values.get(i).copied(),
            Numbers::Reals(values) => {
                let value = *values.get(i)?;
                let integer = value as i64;
                (integer as f64 == value).then_some(integer)
            }
        }
    }
}
