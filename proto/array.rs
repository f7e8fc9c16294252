//! A named numerical array: what [`crate::frame`] and [`crate::npy`] carry.

use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Element types. On the wire little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DType {
    /// 32-bit IEEE 754.
    F32,
    /// 64-bit IEEE 754.
    F64,
    /// Unsigned 32-bit.
    U32,
}

impl DType {
    /// Bytes of one element.
    pub fn size(self) -> usize {
        match self {
            DType::F32 | DType::U32 => 4,
            DType::F64 => 8,
        }
    }
}

/// The elements of an array, borrowed wherever their alignment allows.
#[derive(Clone, Debug, PartialEq)]
pub enum Data<'a> {
    /// 32-bit IEEE 754.
    F32(Cow<'a, [f32]>),
    /// 64-bit IEEE 754.
    F64(Cow<'a, [f64]>),
    /// Unsigned 32-bit.
    U32(Cow<'a, [u32]>),
}

impl<'a> Data<'a> {
    /// The element type.
    pub fn dtype(&self) -> DType {
        match self {
            Data::F32(_) => DType::F32,
            Data::F64(_) => DType::F64,
            Data::U32(_) => DType::U32,
        }
    }

    /// The number of elements.
    pub fn len(&self) -> usize {
        match self {
            Data::F32(x) => x.len(),
            Data::F64(x) => x.len(),
            Data::U32(x) => x.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The elements as they travel.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Data::F32(x) => bytemuck::cast_slice(x),
            Data::F64(x) => bytemuck::cast_slice(x),
            Data::U32(x) => bytemuck::cast_slice(x),
        }
    }

    /// Views `bytes` (a whole number of elements) in place, or copies them if they are misaligned.
    pub(crate) fn view(dtype: DType, bytes: &'a [u8]) -> Data<'a> {
        fn cast<T: bytemuck::Pod>(bytes: &[u8]) -> Cow<'_, [T]> {
            match bytemuck::try_cast_slice(bytes) {
                Ok(elements) => Cow::Borrowed(elements),
                Err(_) => Cow::Owned(bytemuck::pod_collect_to_vec(bytes)),
            }
        }
        match dtype {
            DType::F32 => Data::F32(cast(bytes)),
            DType::F64 => Data::F64(cast(bytes)),
            DType::U32 => Data::U32(cast(bytes)),
        }
    }
}

/// A named array, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Array<'a> {
    /// Its name within its frame.
    pub name: Cow<'a, str>,
    /// The extent of each axis, the slowest first.
    pub shape: Vec<usize>,
    /// The elements; as many as the product of `shape`.
    pub data: Data<'a>,
}

impl<'a> Array<'a> {
    /// An array of f32.
    pub fn f32(
        name: impl Into<Cow<'a, str>>,
        shape: impl Into<Vec<usize>>,
        data: impl Into<Cow<'a, [f32]>>,
    ) -> Array<'a> {
        Array { name: name.into(), shape: shape.into(), data: Data::F32(data.into()) }
    }

    /// An array of f64.
    pub fn f64(
        name: impl Into<Cow<'a, str>>,
        shape: impl Into<Vec<usize>>,
        data: impl Into<Cow<'a, [f64]>>,
    ) -> Array<'a> {
        Array { name: name.into(), shape: shape.into(), data: Data::F64(data.into()) }
    }

    /// An array of u32.
    pub fn u32(
        name: impl Into<Cow<'a, str>>,
        shape: impl Into<Vec<usize>>,
        data: impl Into<Cow<'a, [u32]>>,
    ) -> Array<'a> {
        Array { name: name.into(), shape: shape.into(), data: Data::U32(data.into()) }
    }

    /// Whether `shape` and the number of elements agree.
    pub fn is_consistent(&self) -> bool {
        n_elements(&self.shape) == Some(self.data.len())
    }
}

/// The product of `shape`, unless it overflows.
pub(crate) fn n_elements(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1usize, |product, &extent| product.checked_mul(extent))
}
