//! Shapes as combinations of columns that many generations share.
//!
//! What an edit makes of a body lies in the span of columns that exist already: modes, flexibility
//! columns, derivatives. A basis is then a small matrix of coefficients, and everything but the
//! basis itself costs nothing of the size of the mesh. The dense columns are multiplied out when
//! somebody asks for them, once.

use crate::linalg;
use crate::pool::Tall;
use faer::{Mat, MatRef};
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// Columns (n×k) with a name.
#[derive(Debug)]
pub struct Block {
    /// Unique in this process.
    pub id: u64,
    /// n×k.
    pub columns: Tall,
    /// How it is written in even columns, if it has any.
    evening: Option<Evening>,
    /// BᵀG, the first time somebody asked for it.
    under_loads: OnceLock<Mat<f64>>,
}

impl Block {
    /// Names `columns`.
    pub fn new(columns: impl Into<Tall>) -> Arc<Block> {
        Block::named(columns.into(), None)
    }

    /// Names `columns` that nearly depend on each other and on those of `earlier` blocks: combinations
    /// of them are differences of large numbers, for which single precision is not enough. To those who
    /// want that they are given as even columns E with
    ///
    /// B = E·R + Σ E_i·C_i,
    ///
    /// E_i being the even columns of `earlier` and E about orthonormal, as far as B is independent.
    pub fn dependent(columns: impl Into<Tall>, earlier: &[Arc<Block>]) -> Arc<Block> {
        let evening = Evening { earlier: earlier.to_vec(), coefficients: OnceLock::new() };
        Block::named(columns.into(), Some(evening))
    }

    fn named(columns: Tall, evening: Option<Evening>) -> Arc<Block> {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        Arc::new(Block { id, columns, evening, under_loads: OnceLock::new() })
    }

    /// The blocks that [`Block::dependent`] was told of.
    pub fn earlier(&self) -> &[Arc<Block>] {
        self.evening.as_ref().map_or(&[], |evening| &evening.earlier)
    }

    /// E (n×k), where that is another matrix than B.
    pub fn even_columns(&self) -> Option<Mat<f64>> {
        let evening = self.evening.as_ref()?;
        let Coefficients { onto, turn, .. } = evening.coefficients(self);
        let mut rest = self.columns.as_ref().to_owned();
        for (block, onto) in evening.earlier.iter().zip(onto) {
            let even = block.even_columns();
            let even = even.as_ref().map_or(block.columns.as_ref(), Mat::as_ref);
            linalg::add_product(rest.as_mut(), -1.0, even, onto.as_ref());
        }
        Some(linalg::product(rest.as_ref(), turn.as_ref()))
    }

    /// BᵀG for loads G (n×l) that are the same at every call, as `product` makes it: kept from the first one on.
    fn under_loads(&self, product: &impl Fn(MatRef<'_, f64>) -> Mat<f64>) -> &Mat<f64> {
        self.under_loads.get_or_init(|| product(self.columns.as_ref()))
    }
}

/// How a block is written in even columns.
#[derive(Debug)]
struct Evening {
    earlier: Vec<Arc<Block>>,
    /// Found out the first time somebody asks: it takes the block's Gram matrix.
    coefficients: OnceLock<Coefficients>,
}

/// See [`Block::dependent`].
#[derive(Debug)]
struct Coefficients {
    /// C_i.
    onto: Vec<Mat<f64>>,
    /// R⁻¹.
    turn: Mat<f64>,
    /// R.
    back: Mat<f64>,
}

/// Squared length, of vectors of unit length, below which what is left of them is not drawn out any
/// further: it would be rounding.
const EVEN_FLOOR: f64 = 1e-12;

impl Evening {
    fn coefficients(&self, block: &Block) -> &Coefficients {
        self.coefficients.get_or_init(|| {
            let mut rest = block.columns.as_ref().to_owned();
            let mut onto = Vec::new();
            for earlier in &self.earlier {
                let even = earlier.even_columns();
                let even = even.as_ref().map_or(earlier.columns.as_ref(), Mat::as_ref);
                let inner = linalg::gram(even, rest.as_ref());
                linalg::add_product(rest.as_mut(), -1.0, even, inner.as_ref());
                onto.push(inner);
            }
            let (turn, back) = evened(linalg::gram(rest.as_ref(), rest.as_ref()).as_ref());
            Coefficients { onto, turn, back }
        })
    }
}

/// R⁻¹ and R, with which vectors of the Gram matrix `g` become about orthonormal. Any invertible R
/// will do: without an eigendecomposition it is their length alone.
fn evened(g: MatRef<'_, f64>) -> (Mat<f64>, Mat<f64>) {
    let k = g.nrows();
    let length = |i: usize| if g[(i, i)] > 0.0 { g[(i, i)].sqrt() } else { 1.0 };
    let scaled = Mat::from_fn(k, k, |i, j| g[(i, j)] / (length(i) * length(j)));
    let (values, vectors) = linalg::symmetric_eigen(scaled.as_ref())
        .unwrap_or_else(|_| (vec![1.0; k], Mat::identity(k, k)));
    let root: Vec<f64> = values.iter().map(|value| value.max(EVEN_FLOOR).sqrt()).collect();
    (
        Mat::from_fn(k, k, |i, j| vectors[(i, j)] / (length(i) * root[j])),
        Mat::from_fn(k, k, |i, j| root[i] * vectors[(j, i)] * length(j)),
    )
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

    /// The columns that `c` (p×k) uses, with their rows of `c`: each block in pieces, as an edit of a part of
    /// a seam uses a few columns of a block of hundreds.
    fn used<'a>(
        &'a self,
        c: MatRef<'a, f64>,
    ) -> impl Iterator<Item = (MatRef<'a, f64>, MatRef<'a, f64>)> {
        let mut at = 0;
        self.blocks.iter().flat_map(move |block| {
            let rows = c.subrows(at, block.columns.ncols());
            at += block.columns.ncols();
            pieces(rows).into_iter().map(move |piece| {
                let columns = block.columns.as_ref().subcols(piece.start, piece.len());
                (columns, rows.subrows(piece.start, piece.len()))
            })
        })
    }

    /// `D·C` (p×k → n×k).
    fn times(&self, c: MatRef<'_, f64>) -> Tall {
        let mut product = Tall::new(self.blocks[0].columns.nrows(), c.ncols());
        let (blocks, rows): (Vec<_>, Vec<_>) = self.used(c).unzip();
        linalg::combine(product.as_mut(), &blocks, &rows);
        product
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

/// Rows of zeros between others that are not worth a piece of their own.
const NARROW_GAP: usize = 8;

/// Ranges of rows without the gaps of zeros between them.
fn pieces(rows: MatRef<'_, f64>) -> Vec<Range<usize>> {
    let mut pieces: Vec<Range<usize>> = Vec::new();
    let is_used = |i: &usize| rows.row(*i).iter().any(|x| *x != 0.0);
    for i in (0..rows.nrows()).filter(is_used) {
        match pieces.last_mut() {
            Some(piece) if i - piece.end <= NARROW_GAP => piece.end = i + 1,
            _ => pieces.push(i..i + 1),
        }
    }
    pieces
}

fn gather(x: MatRef<'_, f64>, rows: &[Option<usize>]) -> Mat<f64> {
    let mut gathered = Mat::zeros(rows.len(), x.ncols());
    linalg::for_each_column(gathered.as_mut(), |j, column| {
        let some = rows.iter().map(|row| row.map_or(0.0, |row| x[(row, j)]));
        column.iter_mut().zip(some).for_each(|(to, x)| *to = x);
    });
    gathered
}

/// U = D·W (n×r).
#[derive(Debug)]
pub struct Combination {
    dictionary: Arc<Dictionary>,
    /// W (p×r).
    coefficients: Mat<f64>,
    dense: OnceLock<Tall>,
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
    pub fn of_dense(columns: impl Into<Tall>) -> Combination {
        let columns = columns.into();
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

    /// The same as a combination of even columns ([`Block::dependent`]): blocks, and for each its rows of
    /// the coefficients.
    pub fn even(&self) -> Vec<(Arc<Block>, Mat<f64>)> {
        let mut parts: Vec<(Arc<Block>, Mat<f64>)> = Vec::new();
        let mut add = |block: &Arc<Block>, rows: Mat<f64>| match parts
            .iter_mut()
            .find(|(known, _)| known.id == block.id)
        {
            Some((_, sum)) => *sum += rows,
            None => parts.push((block.clone(), rows)),
        };
        let mut at = 0;
        for block in self.dictionary.blocks() {
            let rows = self.coefficients.as_ref().subrows(at, block.columns.ncols());
            at += block.columns.ncols();
            let Some(evening) = &block.evening else {
                add(block, rows.to_owned());
                continue;
            };
            let Coefficients { onto, back, .. } = evening.coefficients(block);
            for (earlier, onto) in evening.earlier.iter().zip(onto) {
                add(earlier, linalg::small_product(onto.as_ref(), rows));
            }
            add(block, linalg::small_product(back.as_ref(), rows));
        }
        parts
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

    /// What `look` makes of the same, which is not kept where it has not been multiplied out yet.
    pub fn with_dense<T>(&self, look: impl FnOnce(MatRef<'_, f64>) -> T) -> T {
        match self.known_dense() {
            Some(dense) => look(dense),
            None => look(self.dictionary.times(self.coefficients()).as_ref()),
        }
    }

    fn known_dense(&self) -> Option<MatRef<'_, f64>> {
        if self.is_whole {
            return Some(self.dictionary.blocks[0].columns.as_ref());
        }
        self.dense.get().map(|dense| dense.as_ref())
    }

    /// UᵀG for loads G (n×l) that are the same for every combination of these blocks (gravity), by `product`, which makes XᵀG
    /// of columns X.
    pub fn under_loads(&self, product: impl Fn(MatRef<'_, f64>) -> Mat<f64>) -> Mat<f64> {
        let parts: Vec<&Mat<f64>> =
            self.dictionary.blocks.iter().map(|block| block.under_loads(&product)).collect();
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

    /// Bytes held, without the blocks that `is_shared` names.
    pub fn bytes(&self, is_shared: impl Fn(&Block) -> bool) -> usize {
        let own = self.dictionary.blocks.iter().filter(|block| !is_shared(block));
        own.map(|block| block.columns.bytes()).sum::<usize>()
            + linalg::bytes(&self.coefficients)
            + self.dense.get().map_or(0, Tall::bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_columns_lose_nothing_in_single_precision() {
        // x, x², …, close to x = 1: the later ones nearly depend on the earlier ones.
        let power = |first: usize, k| {
            Mat::from_fn(2000, k, |i, j| {
                let x = 1.0 + 0.1 * (i as f64 / 2000.0 - 0.5);
                10f64.powi(j as i32 - 3) * x.powi((first + j) as i32)
            })
        };
        let plain = Block::new(Mat::from_fn(2000, 1, |i, _| (i as f64).sin()));
        let first = Block::dependent(power(1, 2), &[]);
        let second = Block::dependent(power(3, 2), std::slice::from_ref(&first));
        assert!(plain.even_columns().is_none());
        let all = Dictionary::new(vec![plain.clone(), second.clone(), first.clone()]);
        let powers = linalg::concatenate(&[
            plain.columns.as_ref(),
            second.columns.as_ref(),
            first.columns.as_ref(),
        ]);
        let gram = linalg::gram(powers.as_ref(), powers.as_ref());
        let w = linalg::orthonormal_coefficients(gram.as_ref(), 1e-13).unwrap();
        let u = Combination::new(all, w);
        let exact = linalg::product(powers.as_ref(), u.coefficients());
        let parts = u.even();
        assert_eq!(
            parts.iter().map(|(block, _)| block.id).collect::<Vec<_>>(),
            [plain.id, first.id, second.id]
        );
        let single = |x: f64| x as f32 as f64;
        let error_of = |parts: &[(Mat<f64>, Mat<f64>)], round: fn(f64) -> f64| {
            let mut sum = Mat::<f64>::zeros(exact.nrows(), exact.ncols());
            for (columns, rows) in parts {
                let [columns, rows] = [columns, rows]
                    .map(|m| Mat::from_fn(m.nrows(), m.ncols(), |i, j| round(m[(i, j)])));
                linalg::add_product(sum.as_mut(), 1.0, columns.as_ref(), rows.as_ref());
            }
            (sum - exact.as_ref()).norm_max() / exact.norm_max()
        };
        let even: Vec<_> = parts
            .iter()
            .map(|(b, rows)| {
                (b.even_columns().unwrap_or_else(|| b.columns.as_ref().to_owned()), rows.clone())
            })
            .collect();
        let raw = [(powers.clone(), u.coefficients().to_owned())];
        let [even_exact, even_single] = [error_of(&even, |x| x), error_of(&even, single)];
        let raw_single = error_of(&raw, single);
        assert!(even_exact < 1e-9, "{even_exact:e}");
        // A few units in the last place of a single, where the columns as they are leave three digits.
        assert!(even_single < 1e-6 && raw_single > 1e-4, "{even_single:e} {raw_single:e}");
    }

    #[test]
    fn a_combination_is_its_dense_columns() {
        let block = |seed: usize, k| {
            Block::new(Mat::from_fn(9000, k, |i, j| ((i * (j + 2) + seed) as f64).sin()))
        };
        let dictionary = Dictionary::new(vec![block(1, 3), block(2, 5), block(3, 30)]);
        // The second block is not used, and of the third what lies beside gaps, a narrow and a wide one.
        let is_used = |i: usize| i < 3 || [8, 12, 13, 30, 37].contains(&i);
        let w = Mat::from_fn(38, 4, |i, j| f64::from(is_used(i)) * ((3 * i + j) as f64).cos());
        assert_eq!(pieces(w.as_ref()), [0..14, 30..38]);
        assert_eq!(pieces(w.as_ref().subrows(8, 30)), [0..6, 22..30]);
        assert!(pieces(w.as_ref().subrows(3, 5)).is_empty());
        let parts: Vec<_> = dictionary.blocks().iter().map(|b| b.columns.as_ref()).collect();
        let expected = linalg::product(linalg::concatenate(&parts).as_ref(), w.as_ref());
        let lazy = Combination::new(dictionary, w);
        let whole = Combination::of_dense(expected.clone());
        let rows = [Some(8999), None, Some(0)];
        for u in [&lazy, &whole] {
            let some = u.rows(&rows);
            for j in 0..4 {
                assert!((some[(0, j)] - expected[(8999, j)]).abs() < 1e-12);
                assert!(some[(1, j)] == 0.0);
                assert!((some[(2, j)] - expected[(0, j)]).abs() < 1e-12);
            }
        }
        let known = lazy.with_dense(|dense| dense.to_owned());
        for dense in [known, lazy.dense().to_owned(), whole.dense().to_owned()] {
            assert!((dense - expected.as_ref()).norm_max() < 1e-12);
        }
    }
}
