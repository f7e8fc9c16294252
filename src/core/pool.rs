//! Memory for tall matrices, which outlives them.
//!
//! Fresh memory comes from the system page by page, cleared, at 2.5 GB/s or much less: edits of a body of 105 264 unknowns
//! took 1.3 to 2 times as long where all that they need for a while was fresh. What is given back is kept for the next
//! who asks, whichever body that is for. What a generation keeps, its modes and its basis, is given back with it.

use crate::linalg;
use faer::{Mat, MatMut, MatRef};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Pieces of memory that are kept while nobody uses them.
const MOST_KEPT: usize = 12;

/// Bytes of them.
const MOST_BYTES: usize = 320 << 20;

/// A piece may be so many times as large as what is asked for, for a while.
const MOST_SLACK: usize = 4;

/// The same, in quarters, for what may be kept long.
const MOST_LASTING_SLACK: usize = 5;

/// Smaller pieces are left to the allocator, which keeps them itself.
const LEAST_NUMBERS: usize = 1 << 17;

static POOL: Pool = Pool(Mutex::new(Vec::new()));

/// Numbers whose memory goes back to the pool.
#[derive(Debug)]
pub struct Pooled {
    memory: Vec<f64>,
    count: usize,
}

impl Pooled {
    /// `count` numbers of any value.
    pub fn take(count: usize) -> Pooled {
        Pooled::within(count, MOST_SLACK * count)
    }

    fn within(count: usize, most: usize) -> Pooled {
        let mut memory = POOL.take(count, most).unwrap_or_else(|| vec![0.0; count]);
        // Whoever reads what nobody has written learns it where this is tested.
        if cfg!(debug_assertions) {
            memory[..count].fill(f64::NAN);
        }
        Pooled { memory, count }
    }

    /// All of them.
    pub fn numbers(&mut self) -> &mut [f64] {
        &mut self.memory[..self.count]
    }

    /// The first of them as a matrix (n×k).
    pub fn columns(&self, n: usize, k: usize) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice(&self.memory[..n * k], n, k)
    }

    /// The same, to be changed.
    pub fn columns_mut(&mut self, n: usize, k: usize) -> MatMut<'_, f64> {
        MatMut::from_column_major_slice_mut(&mut self.memory[..n * k], n, k)
    }
}

impl Drop for Pooled {
    fn drop(&mut self) {
        POOL.give(std::mem::take(&mut self.memory));
    }
}

/// A tall matrix (n×k, by columns).
#[derive(Debug)]
pub struct Tall(Columns);

#[derive(Debug)]
enum Columns {
    Pooled { memory: Pooled, n: usize, k: usize },
    Own(Mat<f64>),
}

impl Tall {
    /// n×k numbers of any value.
    pub fn new(n: usize, k: usize) -> Tall {
        let memory = Pooled::within(n * k, MOST_LASTING_SLACK * n * k / 4);
        Tall(Columns::Pooled { memory, n, k })
    }

    /// The same for what is not kept.
    pub fn for_a_while(n: usize, k: usize) -> Tall {
        Tall(Columns::Pooled { memory: Pooled::take(n * k), n, k })
    }

    /// Its numbers.
    pub fn as_ref(&self) -> MatRef<'_, f64> {
        match &self.0 {
            Columns::Pooled { memory, n, k } => memory.columns(*n, *k),
            Columns::Own(columns) => columns.as_ref(),
        }
    }

    /// Its numbers, to be changed.
    pub fn as_mut(&mut self) -> MatMut<'_, f64> {
        match &mut self.0 {
            Columns::Pooled { memory, n, k } => memory.columns_mut(*n, *k),
            Columns::Own(columns) => columns.as_mut(),
        }
    }

    /// n.
    pub fn nrows(&self) -> usize {
        self.as_ref().nrows()
    }

    /// k.
    pub fn ncols(&self) -> usize {
        self.as_ref().ncols()
    }

    /// Some of its columns.
    pub fn subcols(&self, first: usize, count: usize) -> MatRef<'_, f64> {
        self.as_ref().subcols(first, count)
    }

    /// Column `j`.
    pub fn col_as_slice(&self, j: usize) -> &[f64] {
        match &self.0 {
            Columns::Pooled { memory, n, .. } => &memory.memory[j * n..][..*n],
            Columns::Own(columns) => columns.col_as_slice(j),
        }
    }

    /// Bytes that it needs.
    pub fn bytes(&self) -> usize {
        self.nrows() * self.ncols() * size_of::<f64>()
    }
}

impl Clone for Tall {
    fn clone(&self) -> Tall {
        let mut copy = Tall::new(self.nrows(), self.ncols());
        linalg::copy(copy.as_mut(), self.as_ref());
        copy
    }
}

impl From<Mat<f64>> for Tall {
    fn from(columns: Mat<f64>) -> Tall {
        Tall(Columns::Own(columns))
    }
}

/// Gives up what is kept, where what follows has another use for the memory.
pub fn clear() {
    let freed = std::mem::take(&mut *POOL.kept());
    drop(freed);
}

/// Pieces that nobody uses, the oldest first.
struct Pool(Mutex<Vec<Vec<f64>>>);

impl Pool {
    fn kept(&self) -> MutexGuard<'_, Vec<Vec<f64>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The smallest piece of at least `count` numbers, unless it has more than `most`.
    fn take(&self, count: usize, most: usize) -> Option<Vec<f64>> {
        let mut kept = self.kept();
        let fits = |piece: &Vec<f64>| (count..=most).contains(&piece.len());
        let fitting = (0..kept.len()).filter(|&i| fits(&kept[i]));
        let best = fitting.min_by_key(|&i| kept[i].len())?;
        Some(kept.remove(best))
    }

    fn give(&self, piece: Vec<f64>) {
        let n_bytes = |piece: &Vec<f64>| size_of_val(&piece[..]);
        if piece.len() < LEAST_NUMBERS || n_bytes(&piece) > MOST_BYTES {
            return;
        }
        // Freed when nobody waits for the lock any more.
        let mut freed = Vec::new();
        let mut kept = self.kept();
        kept.push(piece);
        while kept.len() > MOST_KEPT || kept.iter().map(n_bytes).sum::<usize>() > MOST_BYTES {
            freed.push(kept.remove(0));
        }
        drop(kept);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_kept_for_who_needs_about_as_much() {
        let pool = Pool(Mutex::new(Vec::new()));
        let take = |count: usize| pool.take(count, MOST_SLACK * count);
        assert!(take(LEAST_NUMBERS).is_none());
        for piece in [3, 1, 2] {
            pool.give(vec![f64::from(piece); piece as usize * LEAST_NUMBERS]);
        }
        pool.give(vec![0.0; LEAST_NUMBERS - 1]);
        assert_eq!(pool.kept().len(), 3);
        assert!(pool.take(LEAST_NUMBERS + 1, 2 * LEAST_NUMBERS - 1).is_none());
        assert_eq!(take(LEAST_NUMBERS + 1).unwrap()[0], 2.0);
        assert_eq!(take(LEAST_NUMBERS + 1).unwrap()[0], 3.0);
        assert!(take(LEAST_NUMBERS + 1).is_none());
        assert!(take(LEAST_NUMBERS / MOST_SLACK - 1).is_none());
        assert_eq!(take(LEAST_NUMBERS / MOST_SLACK).unwrap()[0], 1.0);
    }

    #[test]
    fn no_more_is_kept_than_is_allowed() {
        let pool = Pool(Mutex::new(Vec::new()));
        for piece in 0..2 * MOST_KEPT {
            pool.give(vec![piece as f64; LEAST_NUMBERS]);
        }
        assert_eq!(pool.kept().len(), MOST_KEPT);
        assert_eq!(pool.kept()[0][0], MOST_KEPT as f64, "the oldest go first");
        let large = MOST_BYTES / size_of::<f64>();
        pool.give(vec![0.0; large + 1]);
        assert_eq!(pool.kept().len(), MOST_KEPT);
        pool.give(vec![0.0; large]);
        assert_eq!(pool.kept().len(), 1);
    }

    #[test]
    fn numbers_lie_by_columns() {
        let mut pooled = Pooled::take(12);
        pooled.columns_mut(4, 3)[(1, 2)] = 7.0;
        assert_eq!(pooled.numbers()[9], 7.0);
        assert_eq!(pooled.columns(4, 3)[(1, 2)], 7.0);
        for mut tall in [Tall::new(4, 3), Mat::zeros(4, 3).into()] {
            tall.as_mut()[(1, 2)] = 7.0;
            assert_eq!([tall.nrows(), tall.ncols(), tall.bytes()], [4, 3, 96]);
            assert_eq!((tall.subcols(2, 1)[(1, 0)], tall.col_as_slice(2)[1]), (7.0, 7.0));
        }
    }
}
