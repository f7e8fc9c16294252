//! Bases as combinations of columns that generations share, and a cache of such columns.

use super::{Array, Basis, Scalar, column, take};
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use sutura_proto::array::Data;
use sutura_proto::frame::Frame;
use sutura_proto::generation::*;

/// A block of columns by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockName {
    /// Names the same columns as long as the daemon runs, and never any others.
    pub id: u64,
    /// Columns that it has.
    pub n_columns: usize,
}

/// The basis of a generation as D·W, D being blocks side by side.
#[derive(Clone, Debug, PartialEq)]
pub struct Combination<T = f32> {
    n_vertices: usize,
    blocks: Vec<BlockName>,
    /// The columns of D that take part: for each the block it belongs to and its place there.
    columns: Vec<(u64, usize)>,
    /// (p, r).
    w: Array<T>,
    prepared: Vec<BlockName>,
}

impl<T: Scalar> Combination<T> {
    pub(super) fn decode(bytes: &[u8]) -> Result<Combination<T>> {
        let mut frame = Frame::decode(bytes)?;
        let [n_vertices] = numbers(&mut frame, COMBINATION_N_VERTICES)?[..] else {
            return Err(Error::Decode(format!("{COMBINATION_N_VERTICES:?} is not one number")));
        };
        let blocks = names(&mut frame, COMBINATION_BLOCKS, COMBINATION_BLOCK_SIZES)?;
        let prepared = names(&mut frame, COMBINATION_PREPARED, COMBINATION_PREPARED_SIZES)?;
        let columns = places(&blocks, &numbers(&mut frame, COMBINATION_COLUMNS)?)?;
        let w = take(&mut frame, COMBINATION_W, [Some(columns.len()), None])?;
        if w.shape[1] > columns.len() {
            // It would make many columns from few.
            return Err(Error::Decode(format!("{COMBINATION_W:?} has more columns than rows")));
        }
        Ok(Combination { n_vertices: n_vertices as usize, blocks, columns, w, prepared })
    }

    /// The generation it describes.
    pub fn generation(&self) -> u64 {
        self.w.generation
    }

    /// The number of reduced coordinates r.
    pub fn size(&self) -> usize {
        self.w.shape[1]
    }

    /// The number of vertices of the mesh.
    pub fn n_vertices(&self) -> usize {
        self.n_vertices
    }

    /// The blocks that it is combined of.
    pub fn blocks(&self) -> &[BlockName] {
        &self.blocks
    }

    /// The blocks that were prepared for further edits when it was asked for.
    pub fn prepared(&self) -> &[BlockName] {
        &self.prepared
    }

    /// Columns of its blocks that take part.
    pub fn n_used(&self) -> usize {
        self.columns.len()
    }

    /// Columns of its blocks.
    pub fn n_columns(&self) -> usize {
        self.blocks.iter().map(|block| block.n_columns).sum()
    }
}

fn numbers(frame: &mut Frame<'_>, name: &str) -> Result<Vec<u32>> {
    match frame.take(name)?.data {
        Data::U32(numbers) => Ok(numbers.into_owned()),
        _ => Err(Error::Decode(format!("array {name:?} is not of u32"))),
    }
}

/// Names and sizes of blocks; no name may come twice, and all columns together can be counted.
fn names(frame: &mut Frame<'_>, ids: &str, sizes: &str) -> Result<Vec<BlockName>> {
    let (halves, sizes) = (numbers(frame, ids)?, numbers(frame, sizes)?);
    let blocks: Vec<BlockName> = halves
        .chunks_exact(2)
        .zip(&sizes)
        .map(|(half, &size)| BlockName {
            id: u64::from(half[0]) | u64::from(half[1]) << 32,
            n_columns: size as usize,
        })
        .collect();
    let mut distinct: Vec<u64> = blocks.iter().map(|block| block.id).collect();
    distinct.sort_unstable();
    distinct.dedup();
    let total = sizes.iter().try_fold(0u32, |sum, &size| sum.checked_add(size));
    if halves.len() != 2 * sizes.len() || distinct.len() != blocks.len() || total.is_none() {
        return Err(Error::Decode(format!("{ids:?} does not name blocks")));
    }
    Ok(blocks)
}

/// Where the columns `used` of all columns side by side are found; they ascend.
fn places(blocks: &[BlockName], used: &[u32]) -> Result<Vec<(u64, usize)>> {
    let wrong = || Error::Decode("the columns in use are not columns in order".to_owned());
    if !used.is_sorted_by(|a, b| a < b) {
        return Err(wrong());
    }
    let mut places = Vec::with_capacity(used.len());
    let (mut blocks, mut first) = (blocks.iter().peekable(), 0);
    for &column in used {
        let column = column as usize;
        while let Some(block) = blocks.next_if(|block| column >= first + block.n_columns) {
            first += block.n_columns;
        }
        let block = blocks.peek().ok_or_else(wrong)?;
        places.push((block.id, column - first));
    }
    Ok(places)
}

/// Blocks of columns that a client holds, by name.
#[derive(Clone, Debug)]
pub struct Dictionary<T = f32> {
    /// (columns, n_vertices, 3) each.
    blocks: BTreeMap<u64, Array<T>>,
}

impl<T> Default for Dictionary<T> {
    fn default() -> Self {
        Dictionary { blocks: BTreeMap::new() }
    }
}

impl<T: Scalar> Dictionary<T> {
    /// Holds `columns` (k, n_vertices, 3) as the block `id`.
    pub fn insert(&mut self, id: u64, columns: Array<T>) {
        self.blocks.insert(id, columns);
    }

    /// Those of `blocks` that are not held.
    pub fn missing(&self, blocks: &[BlockName]) -> Vec<BlockName> {
        blocks.iter().filter(|block| !self.blocks.contains_key(&block.id)).copied().collect()
    }

    /// Drops every block that `serves` does not say yes to.
    pub fn retain(&mut self, mut serves: impl FnMut(u64) -> bool) {
        self.blocks.retain(|&id, _| serves(id));
    }

    /// Names of the blocks held, ascending.
    pub fn ids(&self) -> impl Iterator<Item = u64> {
        self.blocks.keys().copied()
    }

    /// Bytes of the columns held.
    pub fn bytes(&self) -> usize {
        self.blocks.values().map(|columns| columns.data.len() * size_of::<T>()).sum()
    }

    /// The columns of D that take part in `combination`, with their rows of W.
    fn columns<'a>(&'a self, combination: &'a Combination<T>) -> Result<Vec<(&'a [T], &'a [T])>> {
        let rows = combination.w.data.chunks_exact(combination.size());
        let columns = combination.columns.iter().zip(rows).map(|(&(id, place), row)| {
            let held = self.blocks.get(&id).map_or(&[][..], |block| column(block, place));
            if held.len() != 3 * combination.n_vertices {
                let detail =
                    format!("column {place} of block {id} is not held, or of another mesh");
                return Err(Error::Mismatch(detail));
            }
            Ok((held, row))
        });
        columns.collect()
    }

    /// D·(W·q): the displacement of every vertex, `n_vertices × 3`, in m, at the coordinates `q`.
    pub fn reconstruct(&self, combination: &Combination<T>, q: &[T]) -> Result<Vec<T>> {
        if q.len() != combination.size() {
            let (given, size) = (q.len(), combination.size());
            return Err(Error::Mismatch(format!("{given} coordinates for a basis of {size}")));
        }
        let columns = self.columns(combination)?;
        let factors = |row: &[T]| row.iter().zip(q).map(|(w, q)| w.to_f64() * q.to_f64()).sum();
        let terms: Vec<(f64, &[T])> =
            columns.into_iter().map(|(column, row)| (factors(row), column)).collect();
        let mut displacement = Vec::new();
        add_combined(&mut displacement, &terms, 3 * combination.n_vertices);
        Ok(displacement)
    }

    /// The basis D·W, multiplied out.
    pub fn basis(&self, combination: &Combination<T>) -> Result<Basis<T>> {
        let columns = self.columns(combination)?;
        let (r, n_vertices) = (combination.size(), combination.n_vertices);
        let mut data = Vec::new();
        for j in 0..r {
            let terms: Vec<(f64, &[T])> =
                columns.iter().map(|(column, row)| (row[j].to_f64(), *column)).collect();
            add_combined(&mut data, &terms, 3 * n_vertices);
        }
        let shape = vec![r, n_vertices, 3];
        Ok(Basis { columns: Array { generation: combination.generation(), shape, data } })
    }
}

/// Numbers summed at a time: what stays in the first cache.
const CHUNK: usize = 2048;

/// Appends Σ factor · column, `n` numbers. In single precision the rounding of some hundred terms would
/// add up to twenty times that of the columns.
fn add_combined<T: Scalar>(result: &mut Vec<T>, terms: &[(f64, &[T])], n: usize) {
    result.reserve(n);
    let mut sums = [0.0; CHUNK];
    for start in (0..n).step_by(CHUNK) {
        let range = start..n.min(start + CHUNK);
        let sums = &mut sums[..range.len()];
        sums.fill(0.0);
        for (factor, column) in terms {
            for (sum, x) in sums.iter_mut().zip(&column[range.clone()]) {
                *sum += factor * x.to_f64();
            }
        }
        result.extend(sums.iter().map(|&sum| T::nearest(sum)));
    }
}
