//! The basis of a generation for whoever holds the columns that it shares with others.
//!
//! After an edit inside a seam the basis is U = D·W ([`crate::dictionary`]) over columns that every
//! generation of the base body shares: who has those needs W alone, some hundred rows instead of as
//! many as the mesh has degrees of freedom. A basis that shares nothing is one block and the identity.
//!
//! Columns that nearly depend on others are given as even ones
//! ([`crate::dictionary::Block::dependent`]), so that single precision is enough: of the bodies of the
//! benchmarks, plant and fork would otherwise be wrong by 7e-6 and 1e-6 of the basis's largest
//! entry, where now none is by more than 2e-7.

use super::artifacts::Artifacts;
use crate::dictionary::Block;
use std::sync::Arc;

/// A block of columns by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockName {
    /// Unique in this process, and never given to other columns.
    pub id: u64,
    /// Columns that it has.
    pub n_columns: usize,
}

impl BlockName {
    fn of(block: &Arc<Block>) -> BlockName {
        BlockName { id: block.id, n_columns: block.columns.ncols() }
    }
}

/// U = D·W, without the columns of D that take no part.
#[derive(Clone, Debug, PartialEq)]
pub struct BasisCombination {
    /// The blocks of D, in order.
    pub blocks: Vec<BlockName>,
    /// The columns of D that take part, ascending: column `i` of D is the first of the second block if
    /// the first block has `i` columns.
    pub columns: Vec<usize>,
    /// W of those columns, `columns.len()` × r, row-major.
    pub w: Vec<f64>,
}

impl Artifacts {
    /// The basis as a combination of named columns, which [`Artifacts::block_columns`] gives.
    pub fn basis_combination(&self) -> BasisCombination {
        let (mut blocks, mut columns, mut w) = (Vec::new(), Vec::new(), Vec::new());
        let mut first = 0;
        for (block, rows) in self.basis.even() {
            for i in 0..rows.nrows() {
                if rows.row(i).iter().any(|x| *x != 0.0) {
                    columns.push(first + i);
                    w.extend(rows.row(i).iter());
                }
            }
            first += rows.nrows();
            blocks.push(BlockName::of(&block));
        }
        BasisCombination { blocks, columns, w }
    }

    /// The blocks that are prepared for further edits now: what bases of later generations are combined
    /// of while the edits stay inside the seams.
    pub fn prepared_blocks(&self) -> Vec<BlockName> {
        let seams = self.prepared.known_seams();
        let blocks =
            self.prepared.x.iter().chain(seams.iter().flat_map(|seams| seams.all_blocks()));
        blocks.filter(|block| block.columns.ncols() > 0).map(BlockName::of).collect()
    }

    /// The columns of the block `id` over all vertices, vertex-major (3·n_vertices numbers each, fixed
    /// ones 0), one after the other, if this generation's basis or its base body has that block.
    pub fn block_columns(&self, id: u64) -> Option<impl ExactSizeIterator<Item = Vec<f64>> + '_> {
        let seams = self.prepared.known_seams();
        let own = self.basis.dictionary().blocks().iter();
        let own = own.flat_map(|block| std::iter::once(block).chain(block.earlier()));
        let prepared = seams.iter().flat_map(|seams| seams.all_blocks());
        let mut all = own.chain(&self.prepared.x).chain(prepared);
        let block = all.find(|block| block.id == id)?.clone();
        let even = block.even_columns();
        Some((0..block.columns.ncols()).map(move |j| {
            let column = match &even {
                Some(even) => even.col_as_slice(j),
                None => block.columns.col_as_slice(j),
            };
            self.full_model().expand(column)
        }))
    }
}
