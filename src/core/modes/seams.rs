//! Seams: what is prepared for pairs of vertices before they are stitched, so that an edit takes no
//! sparse solve.
//!
//! With E the three columns e_a − e_b of each pair and X the modes of the base body, rigid ones
//! included, a seam keeps the block Krylov vectors
//!
//! S₁ = K_σ⁻¹E and S₂ = K_σ⁻¹MS₁, both M-orthogonal to X,
//!
//! and their moments H_j = EᵀK_σ⁻¹(MK_σ⁻¹)ʲE on the complement of X, j = 0…4. Every inner product
//! that an update needs is one of them: EᵀS₁ = H₀, EᵀS₂ = S₁ᵀMS₁ = H₁, S₁ᵀMS₂ = H₂, S₂ᵀMS₂ = H₃,
//! S₂ᵀMK_σ⁻¹MS₂ = H₄ ([`super::prepared`]). They depend neither on the stitches in force nor on their
//! stiffness.

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::control::{self, Cancelled, Control, Stage};
use crate::dictionary::Block;
use crate::edit::{Stitch, sorted};
use crate::factorization::SparseCholesky;
use crate::linalg;
use crate::modes::load_cases::LoadCases;
use crate::modes::stitched::StitchMatrix;
use faer::{Mat, MatMut, MatRef};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Pairs prepared together: enough for the solver's best rate, few enough that an edit of some of
/// them drags few others along.
const PAIRS_PER_BLOCK: usize = 16;

/// The base body as seams need it.
pub struct BaseModes<'a> {
    /// The full-order model.
    pub model: &'a FullModel,
    /// M.
    pub mass: &'a Mass,
    /// Factor of K_σ.
    pub factor: &'a SparseCholesky,
    /// X = [rigid, elastic] (n×k each), M-orthonormal Ritz vectors of K.
    pub x: [MatRef<'a, f64>; 2],
}

impl BaseModes<'_> {
    /// Y ← Y − XXᵀMY, twice: where X carries nearly all of Y, one pass leaves rounding of it.
    pub fn remove(&self, mut y: MatMut<'_, f64>) {
        for _ in 0..2 {
            for x in self.x {
                if x.ncols() > 0 {
                    let c = self.mass.inner(x, y.as_ref());
                    linalg::add_product(y.as_mut(), -1.0, x, c.as_ref());
                }
            }
        }
    }
}

/// What seams are a function of, beside the base body: the bits of the columns too.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeamRecipe {
    /// The pairs, ends ascending, by the blocks in which they were prepared, in order.
    pub groups: Vec<Vec<[u32; 2]>>,
    /// Stiffness in N/m of the springs that closed the seam for its load cases; 0 before there were any.
    pub closing_stiffness_n_m: f64,
}

/// Prepared pairs.
#[derive(Clone, Debug)]
pub struct Seams {
    made_by: Arc<SeamRecipe>,
    /// Position of each pair (its ends ascending) among all.
    positions: BTreeMap<[u32; 2], usize>,
    /// \[S₁ | S₂\] of [`PAIRS_PER_BLOCK`] pairs each (the last of an extension may hold fewer), with
    /// the position of its first pair.
    blocks: Vec<(usize, Arc<Block>)>,
    /// H₀ … H₄ over all pairs (3p×3p each).
    moments: [Mat<f64>; 5],
    /// EᵀX (3p×k).
    gaps: Mat<f64>,
    /// Solutions F for loads of the base body.
    cases: LoadCases,
    /// EᵀF, S₁ᵀMF, S₂ᵀMF (3p×q each), S₁ᵀMΨ, S₂ᵀMΨ and EᵀΨ (3p×m each, the sources side by side).
    couplings: [Mat<f64>; 6],
}

impl Seams {
    /// No pairs yet, beside `cases`.
    pub fn new(cases: LoadCases) -> Seams {
        let k = cases.on_modes.nrows();
        Seams {
            made_by: Arc::default(),
            positions: BTreeMap::new(),
            blocks: Vec::new(),
            moments: std::array::from_fn(|_| Mat::zeros(0, 0)),
            gaps: Mat::zeros(0, k),
            couplings: no_couplings(&cases),
            cases,
        }
    }

    /// Solutions for loads of the base body.
    pub fn cases(&self) -> &LoadCases {
        &self.cases
    }

    /// What these seams are a function of.
    pub fn recipe(&self) -> &Arc<SeamRecipe> {
        &self.made_by
    }

    /// The same pairs beside the load cases of the body that springs of this stiffness close.
    pub fn with_cases(
        &self,
        base: &BaseModes<'_>,
        cases: LoadCases,
        closing_stiffness_n_m: f64,
    ) -> Seams {
        let mut seams = self.clone();
        Arc::make_mut(&mut seams.made_by).closing_stiffness_n_m = closing_stiffness_n_m;
        seams.cases = cases;
        seams.couplings = no_couplings(&seams.cases);
        for (first, block) in &self.blocks {
            let half = block.columns.ncols() / 2;
            let pairs = seams.pairs_at(*first, half / 3);
            seams.couple(base, &pairs, block);
        }
        seams
    }

    /// The pairs at `count` positions from `first`.
    fn pairs_at(&self, first: usize, count: usize) -> Vec<[u32; 2]> {
        let mut pairs = vec![[0; 2]; count];
        for (&pair, &at) in &self.positions {
            if (first..first + count).contains(&at) {
                pairs[at - first] = pair;
            }
        }
        pairs
    }

    /// Appends what `pairs`, whose columns are `block`, have to do with F.
    fn couple(&mut self, base: &BaseModes<'_>, pairs: &[[u32; 2]], block: &Block) {
        let new = couplings(base, &self.cases, pairs, block.columns.as_ref());
        self.couplings = stacked(&self.couplings, &new);
    }

    /// What the pairs at `positions` have to do with `cases`, as [`Seams::couplings`] tells it of its own.
    pub fn couplings_with(
        &self,
        base: &BaseModes<'_>,
        cases: &LoadCases,
        positions: &[usize],
    ) -> [Mat<f64>; 6] {
        let mut all = no_couplings(cases);
        for positions in positions.chunks(PAIRS_PER_BLOCK) {
            let pairs: Vec<[u32; 2]> =
                positions.iter().flat_map(|&at| self.pairs_at(at, 1)).collect();
            let half = 3 * positions.len();
            let mut columns = Mat::zeros(base.model.n(), 2 * half);
            for (i, &position) in positions.iter().enumerate() {
                let (block, s1, s2) = self.columns_of(position);
                let block = self.blocks[block].1.columns.as_ref();
                for (to, from) in [(3 * i, s1), (half + 3 * i, s2)] {
                    columns.as_mut().subcols_mut(to, 3).copy_from(block.subcols(from, 3));
                }
            }
            all = stacked(&all, &couplings(base, cases, &pairs, columns.as_ref()));
        }
        all
    }

    /// Prepared pairs.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether nothing is prepared.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The pairs, ends ascending.
    pub fn pairs(&self) -> impl Iterator<Item = [u32; 2]> {
        self.positions.keys().copied()
    }

    /// Where `pair` is, if it is prepared.
    pub fn position(&self, pair: [u32; 2]) -> Option<usize> {
        self.positions.get(&sorted(pair)).copied()
    }

    /// Where the pairs of `stitches` are, if all of them are prepared.
    pub fn find(&self, stitches: &[Stitch]) -> Option<Vec<usize>> {
        stitches.iter().map(|s| self.position(s.pair)).collect()
    }

    /// \[S₁ | S₂\] of each block of pairs.
    pub fn blocks(&self) -> impl Iterator<Item = &Arc<Block>> {
        self.blocks.iter().map(|(_, block)| block)
    }

    /// The same, and behind them those of the load cases.
    pub fn all_blocks(&self) -> impl Iterator<Item = &Arc<Block>> {
        self.blocks().chain(&self.cases.blocks)
    }

    /// Where the columns of the pair at `position` lie: its block, its first column in S₁ there, and
    /// that in S₂.
    pub fn columns_of(&self, position: usize) -> (usize, usize, usize) {
        let at = self.blocks.partition_point(|(first, _)| *first <= position) - 1;
        let (first, block) = &self.blocks[at];
        let column = 3 * (position - first);
        (at, column, block.columns.ncols() / 2 + column)
    }

    /// H_j of the pairs at `positions`.
    pub fn moment(&self, j: usize, positions: &[usize]) -> Mat<f64> {
        select(&self.moments[j], positions, positions)
    }

    /// EᵀX of the pairs at `positions`.
    pub fn gaps(&self, positions: &[usize]) -> Mat<f64> {
        rows_of(&self.gaps, positions)
    }

    /// EᵀF, S₁ᵀMF, S₂ᵀMF, S₁ᵀMΨ, S₂ᵀMΨ and EᵀΨ of the pairs at `positions`.
    pub fn couplings(&self, positions: &[usize]) -> [Mat<f64>; 6] {
        self.couplings.each_ref().map(|m| rows_of(m, positions))
    }

    /// Bytes held, shared blocks included.
    pub fn bytes(&self) -> usize {
        self.blocks().map(|block| block.columns.bytes()).sum::<usize>()
            + self.moments.iter().map(linalg::bytes).sum::<usize>()
            + self.couplings.iter().map(linalg::bytes).sum::<usize>()
            + linalg::bytes(&self.gaps)
            + self.cases.bytes()
    }

    /// These seams and `pairs`: three solves for each column.
    pub fn extended(
        &self,
        base: &BaseModes<'_>,
        pairs: &[[u32; 2]],
        control: &dyn Control,
    ) -> Result<Seams, Cancelled> {
        let new: Vec<[u32; 2]> = pairs
            .iter()
            .map(|&pair| sorted(pair))
            .filter(|pair| !self.positions.contains_key(pair))
            .collect::<BTreeSet<_>>()
            .into_iter()
            .collect();
        let mut seams = self.clone();
        for (done, some) in new.chunks(PAIRS_PER_BLOCK).enumerate() {
            control::check(control)?;
            control.progress(Stage::Seams, (done * PAIRS_PER_BLOCK) as f64 / new.len() as f64);
            seams.add(base, some);
        }
        Ok(seams)
    }

    fn add(&mut self, base: &BaseModes<'_>, pairs: &[[u32; 2]]) {
        let first = self.len();
        for (i, &pair) in pairs.iter().enumerate() {
            self.positions.insert(pair, first + i);
        }
        Arc::make_mut(&mut self.made_by).groups.push(pairs.to_vec());
        let load = incidence(base.model, pairs);
        let gaps = linalg::concatenate(
            &base.x.map(|x| load.transpose_times(x)).each_ref().map(|x| x.as_ref()),
        );
        self.gaps = linalg::stacked(&[self.gaps.as_ref(), gaps.as_ref()]);

        let solved = |mut b: Mat<f64>| {
            base.factor.solve_in_place(b.as_mut());
            base.remove(b.as_mut());
            b
        };
        let s1 = solved(load.dense(base.model.n()));
        let s2 = solved(base.mass.multiply(s1.as_ref()));
        let s3 = solved(base.mass.multiply(s2.as_ref()));
        let ms3 = base.mass.multiply(s3.as_ref());
        let block = Block::new(linalg::concatenate(&[s1.as_ref(), s2.as_ref()]));
        self.couple(base, pairs, &block);
        self.blocks.push((first, block));

        // One block column of each moment: what all pairs have to do with the new ones.
        let all = incidence(base.model, &self.pairs_at(0, self.len()));
        let mut columns = [
            all.transpose_times(s1.as_ref()),
            all.transpose_times(s2.as_ref()),
            all.transpose_times(s3.as_ref()),
            Mat::zeros(3 * self.len(), 3 * pairs.len()),
            Mat::zeros(3 * self.len(), 3 * pairs.len()),
        ];
        for (first, block) in &self.blocks {
            let half = block.columns.ncols() / 2;
            let inner = linalg::gram(block.columns.as_ref(), ms3.as_ref());
            for (j, rows) in [(3, inner.subrows(0, half)), (4, inner.subrows(half, half))] {
                columns[j].as_mut().subrows_mut(3 * first, half).copy_from(rows);
            }
        }
        for (moment, column) in self.moments.iter_mut().zip(&columns) {
            *moment = linalg::bordered_symmetric(moment.as_ref(), column.as_ref());
        }
    }
}

/// EᵀF, S₁ᵀMF, S₂ᵀMF, S₁ᵀMΨ, S₂ᵀMΨ and EᵀΨ of `pairs`, whose \[S₁ | S₂\] are `columns`.
fn couplings(
    base: &BaseModes<'_>,
    cases: &LoadCases,
    pairs: &[[u32; 2]],
    columns: MatRef<'_, f64>,
) -> [Mat<f64>; 6] {
    let load = incidence(base.model, pairs);
    let half = columns.ncols() / 2;
    let weighted = base.mass.multiply(columns);
    let mut all = no_couplings(cases).map(|m| Mat::zeros(half, m.ncols()));
    let mut at = 0;
    for case in &cases.blocks {
        let case = case.columns.as_ref();
        let inner = linalg::gram(weighted.as_ref(), case);
        let gap = load.transpose_times(case);
        let parts = [gap.as_ref(), inner.subrows(0, half), inner.subrows(half, half)];
        for (all, part) in all.iter_mut().zip(parts) {
            all.as_mut().submatrix_mut(0, at, half, case.ncols()).copy_from(part);
        }
        at += case.ncols();
    }
    let mut at = 0;
    for source in &cases.sources {
        let source = source.modes.columns.as_ref();
        let inner = linalg::gram(weighted.as_ref(), source);
        let gap = load.transpose_times(source);
        let parts = [inner.subrows(0, half), inner.subrows(half, half), gap.as_ref()];
        for (all, part) in all[3..].iter_mut().zip(parts) {
            all.as_mut().submatrix_mut(0, at, half, source.ncols()).copy_from(part);
        }
        at += source.ncols();
    }
    all
}

fn stacked(upper: &[Mat<f64>; 6], lower: &[Mat<f64>; 6]) -> [Mat<f64>; 6] {
    std::array::from_fn(|i| linalg::stacked(&[upper[i].as_ref(), lower[i].as_ref()]))
}

fn no_couplings(cases: &LoadCases) -> [Mat<f64>; 6] {
    let m = cases.sources.iter().map(|source| source.energies.len()).sum();
    let q = cases.len();
    [q, q, q, m, m, m].map(|columns| Mat::zeros(0, columns))
}

/// E of `pairs`, as the matrix of stitches of unit stiffness.
fn incidence(model: &FullModel, pairs: &[[u32; 2]]) -> StitchMatrix {
    let unit: Vec<Stitch> =
        pairs.iter().map(|&pair| Stitch { id: 0, pair, stiffness_n_m: 1.0 }).collect();
    StitchMatrix::new(model, &unit)
}

fn rows_of(m: &Mat<f64>, positions: &[usize]) -> Mat<f64> {
    Mat::from_fn(3 * positions.len(), m.ncols(), |i, j| m[(3 * positions[i / 3] + i % 3, j)])
}

fn select(m: &Mat<f64>, rows: &[usize], columns: &[usize]) -> Mat<f64> {
    Mat::from_fn(3 * rows.len(), 3 * columns.len(), |i, j| {
        m[(3 * rows[i / 3] + i % 3, 3 * columns[j / 3] + j % 3)]
    })
}
