//! Shapes as combinations of columns that many generations share.
//!
//! What an edit makes of a body lies in the span of columns that exist already: modes, flexibility
//! columns, derivatives. A basis is then a small matrix of coefficients, and everything but the
//! basis itself costs nothing of the size of the mesh. The dense columns are multiplied out when
//! somebody asks for them, once.

use crate::linalg;
use faer::{Mat, MatRef};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// Columns (n×k) with a name.
#[derive(Debug)]
pub struct Block {
    /// Unique in this process.
    pub id: u64,
    /// n×k.
    pub columns: Mat<f64>,
    /// BᵀG, the first time somebody asked for it.
    under_loads: OnceLock<Mat<f64>>,
}

impl Block {
    /// Names `columns`.
    pub fn new(columns: Mat<f64>) -> Arc<Block> {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        Arc::new(Block { id, columns, under_loads: OnceLock::new() })
    }

    /// BᵀG for loads G (n×l) that are the same at every call: kept from the first one on.
    fn under_loads(&self, loads: &impl Fn() -> Mat<f64>) -> &Mat<f64> {
        self.under_loads.get_or_init(|| linalg::gram(self.columns.as_ref(), loads().as_ref()))
    }
}

/// Columns D = [D₁ | D₂ | …] (n×p), in blocks that dictionaries share.
#[derive(Debug)]
pub struct Dictionary {
    blocks: Vec<Arc<Block>>,
}

impl Dictionary {
    /// All columns of `blocks`, of which there is at least one.
    pub fn new(blocks: Vec<Arc<Block>>) -> Arc<Dictionary> {
        assert!(!blocks.is_empty(), "a dictionary has blocks");
        Arc::new(Dictionary { blocks })
    }

    /// The blocks, in order.
    pub fn blocks(&self) -> &[Arc<Block>] {
        &self.blocks
    }

    /// p.
    pub fn n_columns(&self) -> usize {
        self.blocks.iter().map(|block| block.columns.ncols()).sum()
    }

    /// Each block that `c` (p×k) uses, with its rows of `c`.
    fn used<'a>(
        &'a self,
        c: MatRef<'a, f64>,
    ) -> impl Iterator<Item = (MatRef<'a, f64>, MatRef<'a, f64>)> {
        let mut at = 0;
        self.blocks
            .iter()
            .map(move |block| {
                let rows = c.subrows(at, block.columns.ncols());
                at += block.columns.ncols();
                (block.columns.as_ref(), rows)
            })
            .filter(|(_, rows)| rows.col_iter().any(|column| column.iter().any(|x| *x != 0.0)))
    }

    /// `D·C` (p×k → n×k).
    pub fn times(&self, c: MatRef<'_, f64>) -> Mat<f64> {
        let mut product = Mat::zeros(self.blocks[0].columns.nrows(), c.ncols());
        let (blocks, rows): (Vec<_>, Vec<_>) = self.used(c).unzip();
        linalg::add_products(product.as_mut(), &blocks, &rows);
        product
    }

    /// `CᵀDᵀY` (p×k, n×l → k×l).
    fn gram(&self, c: MatRef<'_, f64>, y: MatRef<'_, f64>) -> Mat<f64> {
        let mut gram = Mat::zeros(c.ncols(), y.ncols());
        for (block, rows) in self.used(c) {
            let inner = linalg::gram(block, y);
            gram += linalg::small_product(rows.transpose(), inner.as_ref());
        }
        gram
    }

    /// Rows of `D·C`; a row of `None` is zero.
    fn rows(&self, c: MatRef<'_, f64>, rows: &[Option<usize>]) -> Mat<f64> {
        let mut product = Mat::zeros(rows.len(), c.ncols());
        for (block, coefficients) in self.used(c) {
            let gathered = gather(block, rows);
            linalg::add_product(product.as_mut(), 1.0, gathered.as_ref(), coefficients);
        }
        product
    }
}

fn gather(x: MatRef<'_, f64>, rows: &[Option<usize>]) -> Mat<f64> {
    Mat::from_fn(rows.len(), x.ncols(), |i, j| rows[i].map_or(0.0, |row| x[(row, j)]))
}

/// U = D·W (n×r).
#[derive(Debug)]
pub struct Combination {
    dictionary: Arc<Dictionary>,
    /// W (p×r).
    coefficients: Mat<f64>,
    dense: OnceLock<Mat<f64>>,
    /// W is the identity: D is U.
    is_whole: bool,
}

impl Combination {
    /// D·W.
    pub fn new(dictionary: Arc<Dictionary>, coefficients: Mat<f64>) -> Combination {
        assert_eq!(dictionary.n_columns(), coefficients.nrows());
        Combination { dictionary, coefficients, dense: OnceLock::new(), is_whole: false }
    }

    /// Columns that are combinations of nothing else.
    pub fn of_dense(columns: Mat<f64>) -> Combination {
        let coefficients = Mat::identity(columns.ncols(), columns.ncols());
        let dictionary = Dictionary::new(vec![Block::new(columns)]);
        Combination { dictionary, coefficients, dense: OnceLock::new(), is_whole: true }
    }

    /// D.
    pub fn dictionary(&self) -> &Arc<Dictionary> {
        &self.dictionary
    }

    /// W (p×r).
    pub fn coefficients(&self) -> MatRef<'_, f64> {
        self.coefficients.as_ref()
    }

    /// r.
    pub fn n_columns(&self) -> usize {
        self.coefficients.ncols()
    }

    /// n.
    pub fn n_rows(&self) -> usize {
        self.dictionary.blocks[0].columns.nrows()
    }

    /// U (n×r); the first call multiplies it out.
    pub fn dense(&self) -> MatRef<'_, f64> {
        match self.known_dense() {
            Some(dense) => dense,
            None => self.dense.get_or_init(|| self.dictionary.times(self.coefficients())).as_ref(),
        }
    }

    fn known_dense(&self) -> Option<MatRef<'_, f64>> {
        if self.is_whole {
            return Some(self.dictionary.blocks[0].columns.as_ref());
        }
        self.dense.get().map(|dense| dense.as_ref())
    }

    /// `U·C` (r×k → n×k).
    pub fn times(&self, c: MatRef<'_, f64>) -> Mat<f64> {
        match self.known_dense() {
            Some(dense) => linalg::product(dense, c),
            None => {
                let of_dictionary = linalg::small_product(self.coefficients(), c);
                self.dictionary.times(of_dictionary.as_ref())
            }
        }
    }

    /// `UᵀY` (n×k → r×k).
    pub fn gram(&self, y: MatRef<'_, f64>) -> Mat<f64> {
        match self.known_dense() {
            Some(dense) => linalg::gram(dense, y),
            None => self.dictionary.gram(self.coefficients(), y),
        }
    }

    /// UᵀG for loads G (n×l) that are the same for every combination of these blocks (gravity).
    pub fn under_loads(&self, loads: impl Fn() -> Mat<f64>) -> Mat<f64> {
        let parts: Vec<&Mat<f64>> =
            self.dictionary.blocks.iter().map(|block| block.under_loads(&loads)).collect();
        let all = linalg::stacked(&parts.iter().map(|part| part.as_ref()).collect::<Vec<_>>());
        linalg::small_product(self.coefficients().transpose(), all.as_ref())
    }

    /// Rows of U; a row of `None` is zero.
    pub fn rows(&self, rows: &[Option<usize>]) -> Mat<f64> {
        match self.known_dense() {
            Some(dense) => gather(dense, rows),
            None => self.dictionary.rows(self.coefficients(), rows),
        }
    }

    /// Whether no number that defines it is infinite or not a number.
    pub fn is_finite(&self) -> bool {
        let finite = |m: MatRef<'_, f64>| m.col_iter().all(|c| c.iter().all(|x| x.is_finite()));
        let mut own = self.dictionary.blocks.iter().filter(|_| self.is_whole);
        finite(self.coefficients()) && own.all(|block| finite(block.columns.as_ref()))
    }

    /// Bytes of what belongs to this combination alone.
    pub fn bytes(&self) -> usize {
        let whole = self.dictionary.blocks.iter().filter(|_| self.is_whole);
        whole.map(|block| linalg::bytes(&block.columns)).sum::<usize>()
            + linalg::bytes(&self.coefficients)
            + self.dense.get().map_or(0, linalg::bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_combination_is_its_dense_columns() {
        let block = |seed: usize, k| {
            Block::new(Mat::from_fn(9000, k, |i, j| ((i * (j + 2) + seed) as f64).sin()))
        };
        let dictionary = Dictionary::new(vec![block(1, 3), block(2, 5), block(3, 2)]);
        // The second block is not used.
        let w =
            Mat::from_fn(
                10,
                4,
                |i, j| {
                    if (3..8).contains(&i) { 0.0 } else { ((3 * i + j) as f64).cos() }
                },
            );
        let parts: Vec<_> = dictionary.blocks().iter().map(|b| b.columns.as_ref()).collect();
        let expected = linalg::product(linalg::concatenate(&parts).as_ref(), w.as_ref());
        let lazy = Combination::new(dictionary, w);
        let whole = Combination::of_dense(expected.clone());
        let c = Mat::from_fn(4, 2, |i, j| (i + 2 * j) as f64 - 1.5);
        let y = Mat::from_fn(9000, 2, |i, j| ((i + j) as f64).cos());
        let rows = [Some(8999), None, Some(0)];
        for u in [&lazy, &whole] {
            let close = |a: Mat<f64>, b: Mat<f64>| (a - b).norm_max() < 1e-11;
            assert!(close(u.times(c.as_ref()), linalg::product(expected.as_ref(), c.as_ref())));
            assert!(close(u.gram(y.as_ref()), linalg::gram(expected.as_ref(), y.as_ref())));
            let some = u.rows(&rows);
            for j in 0..4 {
                assert!((some[(0, j)] - expected[(8999, j)]).abs() < 1e-12);
                assert!(some[(1, j)] == 0.0);
                assert!((some[(2, j)] - expected[(0, j)]).abs() < 1e-12);
            }
        }
        assert!((lazy.dense() - expected.as_ref()).norm_max() < 1e-12);
        assert!((lazy.times(c.as_ref()) - whole.times(c.as_ref())).norm_max() < 1e-11);
    }
}
