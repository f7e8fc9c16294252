//! The arrays of a generation, and what a client computes with them: u = U q.

mod combination;

pub use combination::{BlockName, Combination, Dictionary};

use crate::error::{Error, Result};
use crate::evaluator::Evaluator;
use std::fmt::Display;
use std::future::Future;
use std::ops::{AddAssign, Mul};
use sutura_proto::array::Data;
use sutura_proto::frame::Frame;
use sutura_proto::generation::*;
use sutura_proto::keys::Resource;

/// Which generation of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Generation {
    /// The one that is current when the daemon answers.
    Current,
    /// The one with this number.
    Number(u64),
}

impl From<u64> for Generation {
    fn from(number: u64) -> Self {
        Generation::Number(number)
    }
}

impl Display for Generation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Generation::Current => f.write_str("current"),
            Generation::Number(number) => number.fmt(f),
        }
    }
}

/// An element type: f32 or f64.
pub trait Scalar:
    Copy + Default + Send + Sync + AddAssign + Mul<Output = Self> + PartialEq + sealed::Sealed + 'static
{
    /// Its name in a request.
    const NAME: &'static str;
    /// The elements, if they are of this type.
    fn take(data: Data<'_>) -> Option<Vec<Self>>;
    /// The same number.
    fn to_f64(self) -> f64;
    /// The nearest number of this type.
    fn nearest(x: f64) -> Self;
}

mod sealed {
    /// Keeps [`super::Scalar`] to the two element types of the contract.
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

impl Scalar for f32 {
    const NAME: &'static str = "f32";
    fn take(data: Data<'_>) -> Option<Vec<f32>> {
        if let Data::F32(x) = data { Some(x.into_owned()) } else { None }
    }
    fn to_f64(self) -> f64 {
        self.into()
    }
    fn nearest(x: f64) -> f32 {
        x as f32
    }
}

impl Scalar for f64 {
    const NAME: &'static str = "f64";
    fn take(data: Data<'_>) -> Option<Vec<f64>> {
        if let Data::F64(x) = data { Some(x.into_owned()) } else { None }
    }
    fn to_f64(self) -> f64 {
        self
    }
    fn nearest(x: f64) -> f64 {
        x
    }
}

/// What to fetch: made by the methods of [`Arrays`], for those who carry it.
#[derive(Clone, Debug)]
pub struct Query {
    pub(crate) resource: Resource,
    pub(crate) generation: Generation,
    /// What else determines the arrays: a name in the query, and its value.
    parameter: Option<(&'static str, String)>,
    dtype: &'static str,
}

impl Query {
    /// The query's parameters beside resource and generation.
    pub(crate) fn parameters(&self) -> Vec<(&'static str, String)> {
        let parameter = self.parameter.iter().cloned();
        [(PARAMETER_DTYPE, self.dtype.to_owned())].into_iter().chain(parameter).collect()
    }
}

/// The arrays of a session's generations, over either transport.
pub trait Arrays: Sync {
    /// Fetches a frame of arrays.
    fn frame(&self, query: Query) -> impl Future<Output = Result<Vec<u8>>> + Send;

    /// Linear modes, (n_modes, n_vertices, 3), mass-normalised.
    fn modes<T: Scalar>(
        &self,
        generation: Generation,
    ) -> impl Future<Output = Result<Array<T>>> + Send {
        async move {
            let bytes = self.frame(query::<T>(Resource::Modes, generation, None)).await?;
            let mut frame = Frame::decode(&bytes)?;
            take(&mut frame, MODES, [None, None, Some(3)])
        }
    }

    /// Lumped mass of every vertex in kg.
    fn mass<T: Scalar>(
        &self,
        generation: Generation,
    ) -> impl Future<Output = Result<Array<T>>> + Send {
        async move {
            let bytes = self.frame(query::<T>(Resource::Mass, generation, None)).await?;
            take(&mut Frame::decode(&bytes)?, MASS, [None])
        }
    }

    /// Frequencies of the elastic modes in Hz, ascending.
    fn frequencies_hz<T: Scalar>(
        &self,
        generation: Generation,
    ) -> impl Future<Output = Result<Array<T>>> + Send {
        async move {
            let query = query::<T>(Resource::FrequenciesHz, generation, None);
            take(&mut Frame::decode(&self.frame(query).await?)?, FREQUENCIES_HZ, [None])
        }
    }

    /// Rest position of every vertex in m, (n_vertices, 3). A closing moves them.
    fn positions<T: Scalar>(
        &self,
        generation: Generation,
    ) -> impl Future<Output = Result<Array<T>>> + Send {
        async move {
            let bytes = self.frame(query::<T>(Resource::Positions, generation, None)).await?;
            take(&mut Frame::decode(&bytes)?, POSITIONS, [None, Some(3)])
        }
    }

    /// The four corners of every tet (zero-based).
    fn tets(&self, generation: Generation) -> impl Future<Output = Result<Vec<[u32; 4]>>> + Send {
        async move {
            let bytes = self.frame(query::<f32>(Resource::Tets, generation, None)).await?;
            rows(&mut Frame::decode(&bytes)?, TETS)
        }
    }

    /// The stitches in force.
    fn stitches(
        &self,
        generation: Generation,
    ) -> impl Future<Output = Result<Vec<StitchInForce>>> + Send {
        async move {
            let bytes = self.frame(query::<f64>(Resource::Stitches, generation, None)).await?;
            StitchInForce::decode(&bytes)
        }
    }

    /// The basis.
    fn basis<T: Scalar>(
        &self,
        generation: Generation,
    ) -> impl Future<Output = Result<Basis<T>>> + Send {
        async move {
            let bytes = self.frame(query::<T>(Resource::Basis, generation, None)).await?;
            let columns = take(&mut Frame::decode(&bytes)?, BASIS, [None, None, Some(3)])?;
            Ok(Basis { columns })
        }
    }

    /// The matrix from the coordinates of generation `from` to those of `generation`.
    fn transfer<T: Scalar>(
        &self,
        generation: Generation,
        from: u64,
    ) -> impl Future<Output = Result<Transfer<T>>> + Send {
        async move {
            let bytes = self
                .frame(query::<T>(
                    Resource::Transfer,
                    generation,
                    Some((PARAMETER_FROM, from.to_string())),
                ))
                .await?;
            let matrix = take(&mut Frame::decode(&bytes)?, TRANSFER, [None, None])?;
            Ok(Transfer { from, matrix })
        }
    }

    /// What a client that holds the basis of `have` needs to make that of `generation`.
    fn delta<T: Scalar>(
        &self,
        generation: Generation,
        have: u64,
    ) -> impl Future<Output = Result<Delta<T>>> + Send {
        async move {
            let bytes = self
                .frame(query::<T>(
                    Resource::Delta,
                    generation,
                    Some((PARAMETER_HAVE, have.to_string())),
                ))
                .await?;
            let mut frame = Frame::decode(&bytes)?;
            let columns = take_or_empty(&mut frame, DELTA_COLUMNS, [None, None, Some(3)])?;
            let w = take(&mut frame, DELTA_W, [None, None])?;
            Ok(Delta { have, columns, w })
        }
    }

    /// The basis as a combination of named columns.
    fn combination<T: Scalar>(
        &self,
        generation: Generation,
    ) -> impl Future<Output = Result<Combination<T>>> + Send {
        async move {
            let bytes = self.frame(query::<T>(Resource::Combination, generation, None)).await?;
            Combination::decode(&bytes)
        }
    }

    /// The columns of a block (k, n_vertices, 3) of a generation's combination, or of one that is
    /// prepared for its further edits.
    fn block<T: Scalar>(
        &self,
        generation: Generation,
        block: BlockName,
    ) -> impl Future<Output = Result<Array<T>>> + Send {
        async move {
            let which = Some((PARAMETER_BLOCKS, block.id.to_string()));
            let bytes = self.frame(query::<T>(Resource::Dictionary, generation, which)).await?;
            let shape = [Some(block.n_columns), None, Some(3)];
            take(&mut Frame::decode(&bytes)?, DICTIONARY, shape)
        }
    }

    /// The evaluator's tables.
    fn evaluator<T: Scalar>(
        &self,
        generation: Generation,
    ) -> impl Future<Output = Result<Evaluator<T>>> + Send {
        async move {
            let bytes = self.frame(query::<T>(Resource::Evaluator, generation, None)).await?;
            Evaluator::decode(&bytes)
        }
    }
}

impl<S: Arrays> Arrays for &S {
    fn frame(&self, query: Query) -> impl Future<Output = Result<Vec<u8>>> + Send {
        (**self).frame(query)
    }
}

fn query<T: Scalar>(
    resource: Resource,
    generation: Generation,
    parameter: Option<(&'static str, String)>,
) -> Query {
    Query { resource, generation, parameter, dtype: T::NAME }
}

/// An array of one generation, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Array<T = f32> {
    /// The generation it describes.
    pub generation: u64,
    /// The extent of each axis, the slowest first.
    pub shape: Vec<usize>,
    /// The elements; as many as the product of `shape`.
    pub data: Vec<T>,
}

/// Takes the array `name` out of `frame`; extents must be those of `shape` where it gives them, and
/// none may be 0.
pub(crate) fn take<T: Scalar, const RANK: usize>(
    frame: &mut Frame<'_>,
    name: &str,
    shape: [Option<usize>; RANK],
) -> Result<Array<T>> {
    let array = take_or_empty(frame, name, shape)?;
    if array.data.is_empty() {
        return Err(Error::Decode(format!("array {name:?} is empty: {:?}", array.shape)));
    }
    Ok(array)
}

/// Like [`take`], but extents may be 0. The others then bound nothing: beware of allocating by them.
fn take_or_empty<T: Scalar, const RANK: usize>(
    frame: &mut Frame<'_>,
    name: &str,
    shape: [Option<usize>; RANK],
) -> Result<Array<T>> {
    let generation = frame.generation;
    let array = frame.take(name)?;
    let fits = array.shape.len() == RANK
        && array.shape.iter().zip(shape).all(|(&found, wanted)| wanted.is_none_or(|n| n == found));
    let found = format!("{:?} {:?}", array.data.dtype(), array.shape);
    let wanted = || Error::Decode(format!("array {name:?} is {found}, not {} {shape:?}", T::NAME));
    let data = T::take(array.data).filter(|_| fits).ok_or_else(wanted)?;
    Ok(Array { generation, shape: array.shape, data })
}

/// Takes the u32 array `name` of N columns out of `frame`, row by row.
fn rows<const N: usize>(frame: &mut Frame<'_>, name: &str) -> Result<Vec<[u32; N]>> {
    let array = frame.take(name)?;
    match array.data {
        Data::U32(numbers) if array.shape.len() == 2 && array.shape[1] == N => {
            Ok(numbers.as_chunks().0.to_vec())
        }
        _ => Err(Error::Decode(format!("array {name:?} is not of u32 in rows of {N}"))),
    }
}

/// A stitch in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StitchInForce {
    /// Its name, for edits of it.
    pub id: u64,
    /// The two vertices it joins (zero-based).
    pub pair: [u32; 2],
    /// Its stiffness in N/m.
    pub stiffness_n_m: f64,
}

impl StitchInForce {
    fn decode(bytes: &[u8]) -> Result<Vec<StitchInForce>> {
        let mut frame = Frame::decode(bytes)?;
        let pairs = rows(&mut frame, STITCHES_PAIRS)?;
        let ids = rows(&mut frame, STITCHES_IDS)?;
        let n = pairs.len();
        let stiffness =
            take_or_empty::<f64, 1>(&mut frame, STITCHES_STIFFNESS_N_M, [Some(n)])?.data;
        if ids.len() != n {
            return Err(Error::Decode(format!("{} names for {n} stitches", ids.len())));
        }
        let stitches = pairs.into_iter().zip(ids).zip(stiffness);
        Ok(stitches
            .map(|((pair, [low, high]), stiffness_n_m)| {
                let id = u64::from(low) | u64::from(high) << 32;
                StitchInForce { id, pair, stiffness_n_m }
            })
            .collect())
    }
}

/// The basis of a generation: u = U q.
#[derive(Clone, Debug, PartialEq)]
pub struct Basis<T = f32> {
    columns: Array<T>,
}

impl<T: Scalar> Basis<T> {
    /// The generation it belongs to.
    pub fn generation(&self) -> u64 {
        self.columns.generation
    }

    /// The number of reduced coordinates r.
    pub fn size(&self) -> usize {
        self.columns.shape[0]
    }

    /// The number of vertices of the mesh.
    pub fn n_vertices(&self) -> usize {
        self.columns.shape[1]
    }

    /// Column `i`: the displacement of every vertex, `n_vertices × 3`; empty if there is none.
    pub fn column(&self, i: usize) -> &[T] {
        column(&self.columns, i)
    }

    /// The displacement of every vertex, `n_vertices × 3`, in m, at the coordinates `q`.
    pub fn reconstruct(&self, q: &[T]) -> Result<Vec<T>> {
        if q.len() != self.size() {
            let (given, size) = (q.len(), self.size());
            return Err(Error::Mismatch(format!("{given} coordinates for a basis of {size}")));
        }
        let mut displacement = vec![T::default(); 3 * self.n_vertices()];
        for (i, &qi) in q.iter().enumerate() {
            add_scaled(&mut displacement, qi, self.column(i));
        }
        Ok(displacement)
    }

    /// The basis that `delta` leads to.
    pub fn updated(&self, delta: &Delta<T>) -> Result<Basis<T>> {
        let (n_old, n_new) = (self.size(), delta.w.shape[1]);
        let n_extra = delta.columns.shape[0];
        let fits = delta.have == self.generation()
            && delta.w.shape[0] == n_old + n_extra
            && n_new <= n_old + n_extra
            && (n_extra == 0 || delta.columns.shape[1] == self.n_vertices());
        if !fits {
            let have = self.generation();
            return Err(Error::Mismatch(format!(
                "a delta from generation {} ({:?}, {:?}) does not fit the basis of generation \
                 {have} ({:?})",
                delta.have, delta.columns.shape, delta.w.shape, self.columns.shape
            )));
        }
        let length = 3 * self.n_vertices();
        let mut data = vec![T::default(); n_new * length];
        for (j, new) in data.chunks_exact_mut(length).enumerate() {
            for i in 0..n_old + n_extra {
                let old =
                    if i < n_old { self.column(i) } else { column(&delta.columns, i - n_old) };
                add_scaled(new, delta.w.data[i * n_new + j], old);
            }
        }
        let shape = vec![n_new, self.n_vertices(), 3];
        Ok(Basis { columns: Array { generation: delta.w.generation, shape, data } })
    }
}

/// Row `i` of an array of vectors over the vertices.
fn column<T>(columns: &Array<T>, i: usize) -> &[T] {
    let length = 3 * columns.shape[1];
    if i < columns.shape[0] { &columns.data[i * length..(i + 1) * length] } else { &[] }
}

fn add_scaled<T: Scalar>(sum: &mut [T], factor: T, values: &[T]) {
    for (sum, &value) in sum.iter_mut().zip(values) {
        *sum += factor * value;
    }
}

/// From the coordinates of one generation to those of another.
#[derive(Clone, Debug, PartialEq)]
pub struct Transfer<T = f32> {
    /// The generation it starts from.
    pub from: u64,
    /// (r, r of `from`).
    pub matrix: Array<T>,
}

impl<T: Scalar> Transfer<T> {
    /// The coordinates of the new generation that come closest to `q` of the old one.
    pub fn apply(&self, q: &[T]) -> Result<Vec<T>> {
        let [n_new, n_old] = [self.matrix.shape[0], self.matrix.shape[1]];
        if q.len() != n_old {
            let given = q.len();
            return Err(Error::Mismatch(format!(
                "{given} coordinates for a transfer from {n_old}"
            )));
        }
        let mut result = vec![T::default(); n_new];
        for (i, sum) in result.iter_mut().enumerate() {
            for (&entry, &qj) in self.matrix.data[i * n_old..].iter().zip(q) {
                *sum += entry * qj;
            }
        }
        Ok(result)
    }
}

/// The difference between two bases: the new one is `[old | columns] · w`.
#[derive(Clone, Debug, PartialEq)]
pub struct Delta<T = f32> {
    /// The generation it starts from.
    pub have: u64,
    /// (c, n_vertices, 3): columns that the old basis lacks.
    pub columns: Array<T>,
    /// (r of `have` + c, r).
    pub w: Array<T>,
}

#[cfg(test)]
mod tests;
