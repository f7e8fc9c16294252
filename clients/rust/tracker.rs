//! Keeping the basis in step with the generations of a state stream.

use crate::arrays::{Arrays, Basis, BlockName, Combination, Dictionary, Generation};
use crate::error::Result;
use std::borrow::Cow;
use std::collections::BTreeSet;
use sutura_proto::state::StateFrame;

/// Most bytes of columns held, unless the user says otherwise.
const MAX_DICTIONARY_BYTES: usize = 1 << 30;

/// Turns states into displacements, fetching what a new generation changed when one arrives.
///
/// It holds blocks of columns that generations share and makes of a new generation's
/// [`Combination`] what it can: after an edit inside a seam a few tens of kilobytes travel, once the
/// blocks are held. They are many more columns than one basis, so they are fetched when
/// [`Tracker::prefetch`] is called, or else when whole bases have cost as much as they would have.
#[derive(Clone, Debug)]
pub struct Tracker<S> {
    source: S,
    shapes: Shapes,
    dictionary: Dictionary,
    /// Columns fetched as whole bases since blocks were fetched last.
    n_spent: usize,
    max_bytes: usize,
}

/// What displacements are made of.
#[derive(Clone, Debug)]
enum Shapes {
    Whole(Basis),
    /// All of its blocks are in the dictionary.
    Combined(Combination),
}

impl Shapes {
    fn blocks(&self) -> &[BlockName] {
        match self {
            Shapes::Whole(_) => &[],
            Shapes::Combined(combination) => combination.blocks(),
        }
    }
}

impl<S: Arrays> Tracker<S> {
    /// Fetches the current basis.
    pub async fn new(source: S) -> Result<Tracker<S>> {
        Tracker::with_limit(source, MAX_DICTIONARY_BYTES).await
    }

    /// Fetches the current basis; holds at most `max_bytes` of shared columns. A basis whose columns are
    /// more is held whole.
    pub async fn with_limit(source: S, max_bytes: usize) -> Result<Tracker<S>> {
        let combination = source.combination(Generation::Current).await?;
        let mut dictionary = Dictionary::default();
        let mut n_spent = 0;
        let shapes =
            shapes(&source, &mut dictionary, &mut n_spent, max_bytes, &[], combination).await?;
        Ok(Tracker { source, shapes, dictionary, n_spent, max_bytes })
    }

    /// The generation in use.
    pub fn generation(&self) -> u64 {
        match &self.shapes {
            Shapes::Whole(basis) => basis.generation(),
            Shapes::Combined(combination) => combination.generation(),
        }
    }

    /// The basis in use: multiplied out, if it is held as a combination.
    pub fn basis(&self) -> Result<Cow<'_, Basis>> {
        match &self.shapes {
            Shapes::Whole(basis) => Ok(Cow::Borrowed(basis)),
            Shapes::Combined(combination) => self.dictionary.basis(combination).map(Cow::Owned),
        }
    }

    /// The shared columns held.
    pub fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// The displacement of every vertex, `n_vertices × 3`, in m, at the coordinates `q` of the generation
    /// in use; rigid motion aside.
    pub fn reconstruct(&self, q: &[f32]) -> Result<Vec<f32>> {
        match &self.shapes {
            Shapes::Whole(basis) => basis.reconstruct(q),
            Shapes::Combined(combination) => self.dictionary.reconstruct(combination, q),
        }
    }

    /// The displacement of every vertex, `n_vertices × 3`, in m, at `state`; rigid motion aside.
    pub async fn displacement(&mut self, state: &StateFrame) -> Result<Vec<f32>> {
        if state.generation != self.generation() {
            self.follow(state.generation).await?;
        }
        self.reconstruct(&state.q)
    }

    /// Goes over to the basis of `generation`. Blocks that neither it nor a further edit of it would use
    /// are dropped.
    pub async fn follow(&mut self, generation: u64) -> Result<()> {
        let Tracker { source, shapes: old, dictionary, n_spent, max_bytes } = self;
        let combination = source.combination(generation.into()).await?;
        let prepared = combination.prepared().to_vec();
        self.shapes =
            shapes(source, dictionary, n_spent, *max_bytes, old.blocks(), combination).await?;
        self.drop_useless(&prepared);
        Ok(())
    }

    /// Fetches the blocks that the daemon has prepared for further edits of the current generation, as
    /// far as the limit allows; whether all are held now. To be called while nothing else is urgent, and
    /// again when more seams have been prepared: edits inside the seams then cost their W alone.
    pub async fn prefetch(&mut self) -> Result<bool> {
        let combination: Combination = self.source.combination(Generation::Current).await?;
        let generation = Generation::Number(combination.generation());
        let prepared = combination.prepared();
        self.drop_useless(prepared);
        for block in self.dictionary.missing(prepared) {
            let n_bytes = size_of_columns(&combination, block.n_columns);
            if self.dictionary.bytes().saturating_add(n_bytes) <= self.max_bytes {
                self.dictionary.insert(block.id, self.source.block(generation, block).await?);
            }
        }
        Ok(self.dictionary.missing(prepared).is_empty())
    }

    /// Keeps the blocks in use and the `prepared` ones; of these only as many as the limit allows.
    fn drop_useless(&mut self, prepared: &[BlockName]) {
        let used = ids(self.shapes.blocks());
        let prepared = ids(prepared);
        self.dictionary.retain(|id| used.contains(&id) || prepared.contains(&id));
        make_room(&mut self.dictionary, &used, 0, self.max_bytes);
    }
}

/// What to make displacements of at `combination`: of shared columns if those that are missing are no
/// more than the basis has, together with what was spent on whole bases that they would have saved
/// (then never twice what would have been best is fetched); otherwise the whole basis. `old` are the
/// blocks in use until now: they stay in `dictionary`, whatever happens here.
async fn shapes(
    source: &impl Arrays,
    dictionary: &mut Dictionary,
    n_spent: &mut usize,
    max_bytes: usize,
    old: &[BlockName],
    combination: Combination,
) -> Result<Shapes> {
    let generation = Generation::Number(combination.generation());
    let missing = dictionary.missing(combination.blocks());
    let n_missing = missing.iter().map(|block| block.n_columns).sum::<usize>();
    let fits = size_of_columns(&combination, combination.n_columns()) <= max_bytes;
    if fits && n_missing <= combination.size() + *n_spent {
        let keep: BTreeSet<u64> = ids(old).union(&ids(combination.blocks())).copied().collect();
        make_room(dictionary, &keep, size_of_columns(&combination, n_missing), max_bytes);
        match fetch(source, dictionary, generation, &missing).await {
            Ok(()) => {
                *n_spent = n_spent.saturating_sub(n_missing.saturating_sub(combination.size()));
                return Ok(Shapes::Combined(combination));
            }
            // The generation has been dropped meanwhile, or a block is larger than may be sent.
            Err(error) if matches!(error.status(), Some(404 | 413)) => {}
            Err(error) => return Err(error),
        }
    }
    *n_spent += combination.size();
    Ok(Shapes::Whole(source.basis(generation).await?))
}

/// Adds `blocks`.
async fn fetch(
    source: &impl Arrays,
    dictionary: &mut Dictionary,
    generation: Generation,
    blocks: &[BlockName],
) -> Result<()> {
    for &block in blocks {
        dictionary.insert(block.id, source.block(generation, block).await?);
    }
    Ok(())
}

/// Drops blocks that are not in `keep`, as many as it takes to fit `n_bytes` more below `max_bytes`.
fn make_room(dictionary: &mut Dictionary, keep: &BTreeSet<u64>, n_bytes: usize, max_bytes: usize) {
    let droppable: Vec<u64> = dictionary.ids().filter(|id| !keep.contains(id)).collect();
    // The youngest first: those of the base body's modes, which every edit uses, are the oldest.
    for dropped in droppable.into_iter().rev() {
        if dictionary.bytes().saturating_add(n_bytes) <= max_bytes {
            return;
        }
        dictionary.retain(|id| id != dropped);
    }
}

fn ids(blocks: &[BlockName]) -> BTreeSet<u64> {
    blocks.iter().map(|block| block.id).collect()
}

/// Bytes of so many columns.
fn size_of_columns(combination: &Combination, n_columns: usize) -> usize {
    n_columns.saturating_mul(3 * size_of::<f32>()).saturating_mul(combination.n_vertices())
}
