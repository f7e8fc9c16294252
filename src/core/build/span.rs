//! What a basis is drawn from: dense columns, or coefficients over prepared ones.

use super::artifacts::Prepared;
use super::params::BuildError;
use crate::basis::{self, Pca, WeightedDerivatives, mass_pca};
use crate::dictionary::{Block, Combination, Dictionary};
use crate::edit::Stitch;
use crate::linalg::{self, SmallCholesky};
use crate::modes::LinearModes;
use crate::modes::load_cases::{LoadCases, Source};
use crate::modes::prepared::{Coefficients, PreparedStitches};
use crate::modes::seams::Seams;
use crate::modes::stitched::StitchMatrix;
use crate::pool::Tall;
use faer::{Mat, MatRef};
use std::sync::Arc;

/// Share of a mode (squared) outside the best source below which no other source is needed.
const SPANNED: f64 = 1e-4;

/// Modal derivatives and where they come from.
pub(super) struct DerivativeSet {
    /// n×p.
    pub(super) shapes: Arc<Tall>,
    /// The two modes of each.
    pub(super) pairs: Vec<[usize; 2]>,
    /// Their eigenvalues.
    pub(super) eigenvalues: Vec<[f64; 2]>,
    /// Worst relative residual of the solve.
    pub(super) residual: f64,
}

/// The modes of a generation, and the derivatives that its basis holds beside them.
pub(super) enum Span {
    /// Columns of the size of the mesh.
    Dense {
        /// n×k.
        modes: Tall,
        /// Of these modes.
        derivatives: DerivativeSet,
    },
    /// Coefficients over what seams hold.
    Prepared(Box<PreparedSpan>),
}

/// See [`Span::Prepared`].
pub(super) struct PreparedSpan {
    pub(super) seams: Arc<Seams>,
    /// Of the stitches in `seams`.
    pub(super) positions: Vec<usize>,
    pub(super) stitches: PreparedStitches,
    pub(super) modes: Coefficients,
    /// K̂⁻¹ of the load cases.
    pub(super) responses: Coefficients,
}

/// A basis, and what the rest of a build needs to know of it.
pub(super) struct Subspace {
    pub(super) modes: Combination,
    pub(super) basis: Combination,
    /// AᵀU (3s×r) of the stitches that the base body does not hold.
    pub(super) stretch: Mat<f64>,
    /// UᵀKU of the base body, where it is known already.
    pub(super) stiffness: Option<Mat<f64>>,
    /// UᵀM times the modes.
    pub(super) of_modes: Mat<f64>,
    /// UᵀM times the derivatives Φ_ij of these pairs of them.
    pub(super) of_derivatives: Mat<f64>,
    pub(super) pairs: Vec<[usize; 2]>,
}

impl Subspace {
    /// Whether no number that defines basis or modes is infinite or not a number: the products of both with masses would not
    /// be finite either.
    pub(super) fn is_finite(&self) -> bool {
        let parts = [&self.of_modes, &self.of_derivatives].map(Mat::as_ref);
        let parts = parts.into_iter().chain([self.basis.coefficients(), self.modes.coefficients()]);
        parts.into_iter().all(|part| part.is_all_finite())
    }
}

impl Span {
    /// Draws the basis; `weighing` are the eigenvalues that the modes are weighed by.
    pub(super) fn reduce(
        self,
        prepared: &Prepared,
        stitches: &[Stitch],
        weighing: &[f64],
    ) -> Result<Subspace, BuildError> {
        match self {
            Span::Dense { modes, derivatives } => {
                reduce_dense(prepared, stitches, weighing, modes, derivatives)
            }
            Span::Prepared(span) => span.reduce(prepared, weighing),
        }
    }
}

fn reduce_dense(
    prepared: &Prepared,
    stitches: &[Stitch],
    weighing: &[f64],
    modes: Tall,
    derivatives: DerivativeSet,
) -> Result<Subspace, BuildError> {
    let params = &prepared.params;
    let weighed = LinearModes { shapes: modes, eigenvalues: weighing.to_vec() };
    let group = WeightedDerivatives {
        shapes: Tall::as_ref(&derivatives.shapes),
        eigenvalues: derivatives.eigenvalues.clone(),
    };
    let Pca { basis, inner, .. } =
        mass_pca(&prepared.mass, &weighed, &[group], params.basis_size, params.pca)?;
    let (of_modes, of_derivatives) = inner.as_ref().split_at_col(weighed.shapes.ncols());
    let stretch = StitchMatrix::new(&prepared.model, stitches).transpose_times(basis.as_ref());
    Ok(Subspace {
        of_modes: of_modes.to_owned(),
        of_derivatives: of_derivatives.to_owned(),
        pairs: derivatives.pairs,
        modes: Combination::of_dense(weighed.shapes),
        basis: Combination::of_dense(basis),
        stretch,
        stiffness: None,
    })
}

impl PreparedSpan {
    fn reduce(self, prepared: &Prepared, weighing: &[f64]) -> Result<Subspace, BuildError> {
        let PreparedSpan { stitches, modes, responses, .. } = &self;
        // A source that spans the modes makes all of their derivatives. Those of another would take the
        // place of some of them: 3.8 times the static error on a slender body.
        let count = prepared.params.n_derivative_modes;
        let (best, unexplained) = best_source(&self.stitches, &self.modes, count);
        let kept = match unexplained <= SPANNED {
            true => self.loads_of(best),
            false => 0..responses.x.ncols(),
        };
        let all = Coefficients::concatenate(&[modes, &responses.columns(kept.clone())]);
        let [mass, stiffness] = stitches.grams(&all);
        let weights = basis::weights(weighing, &stitches.quotients()[kept.clone()]);
        let mut w = basis::pca_of_gram(mass.as_ref(), &weights, prepared.params.basis_size)?;
        let mut basis = all.times(w.as_ref());
        // What rounding has left of non-orthogonality shows only in the combinations themselves.
        let [own, _] = stitches.grams(&basis);
        let turn = SmallCholesky::new(own.as_ref())?.whitening();
        w = linalg::small_product(w.as_ref(), turn.as_ref());
        basis = basis.times(turn.as_ref());
        let onto = linalg::small_product(w.transpose(), mass.as_ref());
        let k = modes.x.ncols();
        let (combinations, pairs) = self.derivatives_of_own_modes(best);
        let combinations = combinations.subrows(kept.start, kept.len());
        let of_responses = onto.subcols(k, onto.ncols() - k);
        let of_derivatives = linalg::small_product(of_responses, combinations);
        let inner = linalg::small_product(stiffness.as_ref(), w.as_ref());
        Ok(Subspace {
            stretch: stitches.stretch(&basis),
            stiffness: Some(linalg::small_product(w.transpose(), inner.as_ref())),
            of_modes: onto.subcols(0, k).to_owned(),
            of_derivatives,
            pairs,
            modes: combine(prepared, &self.seams, stitches.cases(), &self.positions, modes),
            basis: combine(prepared, &self.seams, stitches.cases(), &self.positions, &basis),
        })
    }

    /// Loads of the source at `place`.
    fn loads_of(&self, place: usize) -> std::ops::Range<usize> {
        let loads = |source: &Source| source.energies.len() * (source.energies.len() + 1) / 2;
        let sources = &self.stitches.cases().sources;
        let first = sources[..place].iter().map(loads).sum();
        first..first + sources.get(place).map_or(0, loads)
    }

    /// Combinations of all responses that are about the derivatives of this generation's modes: those are
    /// bilinear in the modes, which the source at `place` spans in part.
    fn derivatives_of_own_modes(&self, place: usize) -> (Mat<f64>, Vec<[usize; 2]>) {
        let cases = self.stitches.cases();
        let inner = self.stitches.on_sources(&self.modes);
        let Some(source) = cases.sources.get(place) else {
            return (Mat::zeros(cases.len(), 0), Vec::new());
        };
        let row: usize = cases.sources[..place].iter().map(|source| source.energies.len()).sum();
        let (m, case) = (source.energies.len(), self.loads_of(place).start);
        let t = inner.subrows(row, m);
        let pairs = crate::derivatives::pairs(m.min(inner.ncols()));
        let of_source = crate::derivatives::pairs(m);
        let combinations = Mat::from_fn(cases.len(), pairs.len(), |at, column| {
            let Some([k, l]) = at.checked_sub(case).and_then(|at| of_source.get(at)) else {
                return 0.0;
            };
            let [i, j] = pairs[column];
            let (k, l) = (*k, *l);
            let crossed = if k == l { 0.0 } else { t[(l, i)] * t[(k, j)] };
            t[(k, i)] * t[(l, j)] + crossed
        });
        (combinations, pairs)
    }
}

/// The source that spans the modes which make derivatives best, by its place, and the largest share of
/// one of them (squared, in the mass norm) that it does not span: what its responses cannot know of.
pub(super) fn best_source(
    stitches: &PreparedStitches,
    modes: &Coefficients,
    n_derivative_modes: usize,
) -> (usize, f64) {
    let inner = stitches.on_sources(modes);
    let count = n_derivative_modes.min(inner.ncols());
    let mut row = 0;
    let mut best = (0, 1.0f64);
    for (place, source) in stitches.cases().sources.iter().enumerate() {
        let m = source.energies.len();
        let share = |j: usize| inner.col(j).subrows(row, m).squared_norm_l2();
        let unexplained = 1.0 - (0..count).map(share).fold(1.0, f64::min);
        if place == 0 || unexplained < best.1 {
            best = (place, unexplained.max(0.0));
        }
        row += m;
    }
    best
}

/// Vectors over the blocks of the base body's modes, of the seams and of the load cases.
pub(super) fn combine(
    prepared: &Prepared,
    seams: &Seams,
    cases: &LoadCases,
    positions: &[usize],
    y: &Coefficients,
) -> Combination {
    let count = y.x.ncols();
    let mut blocks: Vec<Arc<Block>> = Vec::new();
    let mut rows: Vec<Mat<f64>> = Vec::new();
    let mut at = 0;
    for block in &prepared.x {
        let k = block.columns.ncols();
        if k > 0 {
            rows.push(y.x.subrows(at, k).to_owned());
            blocks.push(block.clone());
        }
        at += k;
    }
    let first_of_seams = blocks.len();
    for block in seams.blocks() {
        rows.push(Mat::zeros(block.columns.ncols(), count));
        blocks.push(block.clone());
    }
    for (i, &position) in positions.iter().enumerate() {
        let (block, s1, s2) = seams.columns_of(position);
        let rows = &mut rows[first_of_seams + block];
        for (to, from) in [(s1, &y.s1), (s2, &y.s2)] {
            rows.as_mut().subrows_mut(to, 3).copy_from(from.subrows(3 * i, 3));
        }
    }
    let mut at = 0;
    for block in &cases.blocks {
        let q = block.columns.ncols();
        rows.push(y.f.subrows(at, q).to_owned());
        blocks.push(block.clone());
        at += q;
    }
    // What nothing uses is not part of the dictionary.
    let used = |rows: &Mat<f64>| rows.col_iter().any(|c| c.iter().any(|x| *x != 0.0));
    let something = rows.iter().any(used);
    let (blocks, rows): (Vec<_>, Vec<_>) =
        blocks.into_iter().zip(rows).filter(|(_, rows)| used(rows) || !something).unzip();
    let all: Vec<MatRef<'_, f64>> = rows.iter().map(Mat::as_ref).collect();
    Combination::new(Dictionary::new(blocks), linalg::stacked(&all))
}
