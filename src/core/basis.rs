//! The basis of the subspace: mass-weighted principal component analysis of scaled modes and modal
//! derivatives.
//!
//! Weights are those of \[B12\] eq. 18, λ₁/λ_j on modes and λ₁²/(λ_iλ_j) on derivatives. (\[M16\] §4.2.2
//! prints them the other way up, which would favour high frequencies against the purpose it
//! states.) Derivatives are scaled to unit mass norm first: mass-normalised modes and their
//! derivatives have different units, and which would dominate depended on the unit of length.

use crate::assembly::mass::Mass;
use crate::linalg::{self, DenseError, SmallCholesky};
use crate::modes::LinearModes;
use crate::pool::Tall;
use faer::{Mat, MatRef};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// How the principal components are found.
///
/// Measured on a body of 35K vertices, 60 of 66 and of 230 columns, processor time: snapshots 0.12 and
/// 0.32 s, random combinations 0.34 and 0.62 s. Against a singular value decomposition snapshots lose
/// nothing (angles of 6e-8, the resolution of the comparison); random combinations leave out 2 % more
/// of 230 columns than the best 60 (angles to the leading 20, 40 and 60 directions: 5e-4, 0.03, 0.5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PcaMethod {
    /// From the Gram matrix of all columns (the method of snapshots).
    #[default]
    Snapshots,
    /// From random combinations of the columns (\[M16\] §4.2.2), taken in blocks of which each sees only
    /// what those before it left (Martinsson and Voronin, SIAM J. Sci. Comput. 38, 2016), with one
    /// power iteration (Halko, Martinsson and Tropp, SIAM Review 53, 2011).
    Randomized,
}

/// Squared length below which a direction of unit columns is dependent.
const DEPENDENT: f64 = 1e-13;

/// The same where nothing is multiplied out that could be orthonormalized again: an orthonormal
/// combination of columns dependent to within d has coefficients of 1/√d, which magnify rounding by
/// 1/d. It cannot be much larger: what keeps a slender body from locking is a small part of its
/// derivatives (at 1e-9 a fork's static error was 34 times that of a basis from scratch).
const RESOLVED: f64 = 1e-12;

/// Columns no further from it are orthonormal but for rounding once they have been made so.
const NEARLY_ORTHONORMAL: f64 = 1e-8;

/// Times that columns are made orthonormal, at most.
const MOST_TURNS: usize = 3;

/// A combination shorter than this fraction of the longest is rounding noise.
const NOISE: f64 = 1e-13;

/// Random combinations a block: their singular values must span less than the eight digits that
/// survive in a Gram matrix.
const RANDOM_BLOCK: usize = 20;

/// Random combinations beyond the size of the basis (Halko et al. §4.2 advise five to ten).
const OVERSAMPLING: usize = 8;

/// Power iterations (two were measured to capture no more).
const POWER_ITERATIONS: usize = 1;

/// Weights of modes (λ₁/λ_i) and of derivatives (λ₁²/(λ_iλ_j)), at most 1 (\[B12\] eq. 18).
pub fn weights(eigenvalues: &[f64], of_derivatives: &[[f64; 2]]) -> Vec<f64> {
    let first = eigenvalues.iter().copied().fold(f64::INFINITY, f64::min);
    let modes = eigenvalues.iter().map(|l| first / l);
    let derivatives = of_derivatives.iter().map(|[li, lj]| first * first / (li * lj));
    modes.chain(derivatives).map(|weight| weight.min(1.0)).collect()
}

/// The method of snapshots on columns known by their Gram matrix alone (p×p): coefficients (p × at most
/// `size`) of an M-orthonormal basis.
pub fn pca_of_gram(
    gram: MatRef<'_, f64>,
    weights: &[f64],
    size: usize,
) -> Result<Mat<f64>, DenseError> {
    let (basis, _) = principal_coefficients(gram, weights, size, RESOLVED)?;
    let inner = linalg::small_product(gram, basis.as_ref());
    let inner = linalg::small_product(basis.transpose(), inner.as_ref());
    let turn = SmallCholesky::new(inner.as_ref())?.whitening();
    let basis = linalg::small_product(basis.as_ref(), turn.as_ref());
    let signs: Vec<f64> = (0..basis.ncols()).map(|j| sign(range(basis.col_as_slice(j)))).collect();
    Ok(Mat::from_fn(basis.nrows(), basis.ncols(), |i, j| signs[j] * basis[(i, j)]))
}

/// A derivative's column together with the eigenvalues of the two modes it belongs to.
pub struct WeightedDerivatives<'a> {
    /// n×p.
    pub shapes: MatRef<'a, f64>,
    /// λ_i and λ_j of each column.
    pub eigenvalues: Vec<[f64; 2]>,
}

/// A basis of principal components.
pub struct Pca {
    /// U (n × at most as many as asked for), M-orthonormal. The largest entry of a column is positive, so that its sign does
    /// not depend on a decomposition.
    pub basis: Tall,
    /// Singular values of the weighted columns, relative to the first, descending; at least as many as asked for
    /// unless fewer columns are independent.
    pub singular: Vec<f64>,
    /// UᵀMD of the columns D, modes first.
    pub inner: Mat<f64>,
}

/// The principal components of modes and derivatives, at most `size`.
pub fn mass_pca(
    mass: &Mass,
    modes: &LinearModes,
    derivatives: &[WeightedDerivatives<'_>],
    size: usize,
    method: PcaMethod,
) -> Result<Pca, DenseError> {
    let shapes = derivatives.iter().map(|group| group.shapes);
    let parts = std::iter::once(modes.shapes.as_ref()).chain(shapes).collect();
    let of_derivatives: Vec<[f64; 2]> =
        derivatives.iter().flat_map(|group| group.eigenvalues.iter().copied()).collect();
    let weights = weights(&modes.eigenvalues, &of_derivatives);
    let columns = Columns { mass, parts };
    let Pca { basis, mut singular, inner } = match method {
        PcaMethod::Snapshots => snapshots(&columns, &weights, size)?,
        PcaMethod::Randomized => randomized(&columns, &weights, size)?,
    };
    let largest = singular.first().copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
    singular.iter_mut().for_each(|s| *s /= largest);
    Ok(Pca { basis, singular, inner })
}

/// The least and the largest of some numbers and zero, eight of which are compared at a time.
fn range(numbers: &[f64]) -> [f64; 2] {
    let (whole, rest) = numbers.as_chunks::<8>();
    let (mut least, mut largest) = ([0.0f64; 8], [0.0f64; 8]);
    let mut see = |x: &[f64; 8]| {
        for (x, (least, largest)) in x.iter().zip(least.iter_mut().zip(&mut largest)) {
            *least = if x < least { *x } else { *least };
            *largest = if x > largest { *x } else { *largest };
        }
    };
    whole.iter().for_each(&mut see);
    let mut last = [0.0; 8];
    last[..rest.len()].copy_from_slice(rest);
    see(&last);
    joined(least.into_iter().zip(largest).map(|(least, largest)| [least, largest]))
}

/// The range of some ranges.
fn joined(ranges: impl Iterator<Item = [f64; 2]>) -> [f64; 2] {
    ranges.fold([0.0; 2], |all, one| [all[0].min(one[0]), all[1].max(one[1])])
}

/// What makes the largest entry of a column with this range positive.
fn sign([least, largest]: [f64; 2]) -> f64 {
    if -least > largest { -1.0 } else { 1.0 }
}

/// The columns D (n×p) side by side, where they lie.
struct Columns<'a> {
    mass: &'a Mass,
    parts: Vec<MatRef<'a, f64>>,
}

impl Columns<'_> {
    fn count(&self) -> usize {
        self.parts.iter().map(|part| part.ncols()).sum()
    }

    /// The rows of `c` that belong to each part.
    fn split<'c>(&self, c: MatRef<'c, f64>) -> Vec<MatRef<'c, f64>> {
        let mut at = 0;
        let rows = |part: &MatRef<'_, f64>| {
            at += part.ncols();
            c.subrows(at - part.ncols(), part.ncols())
        };
        self.parts.iter().map(rows).collect()
    }

    /// `D·C`.
    fn times(&self, c: MatRef<'_, f64>) -> Mat<f64> {
        let mut product = Mat::zeros(self.parts[0].nrows(), c.ncols());
        linalg::combine(product.as_mut(), &self.parts, &self.split(c));
        product
    }

    /// `D·C` of columns that are M-orthonormal but for rounding, made so and oriented ([`Pca::basis`]), and R with which it is
    /// `D·CR`; the first columns change least.
    fn orthonormal(&self, c: MatRef<'_, f64>) -> Result<(Tall, Mat<f64>), DenseError> {
        let mut basis = Tall::new(self.parts[0].nrows(), c.ncols());
        let coefficients = self.split(c);
        // While rows are in the cache all is seen of them.
        let (ranges, mut gram) = self.mass.gram_of_made(basis.as_mut(), |first, mut rows| {
            linalg::combine_rows(rows.as_mut(), first, &self.parts, &coefficients);
            let columns = rows.as_ref().col_iter().filter_map(|column| column.try_as_col_major());
            columns.map(|column| range(column.as_slice())).collect::<Vec<_>>()
        });
        let sign = |j: usize| sign(joined(ranges.iter().map(|ranges| ranges[j])));
        let signs: Vec<f64> = (0..c.ncols()).map(sign).collect();
        let mut turn = Mat::from_fn(c.ncols(), c.ncols(), |i, j| f64::from(i == j) * signs[j]);
        let mut distance = linalg::distance_from_identity(gram.as_ref());
        if distance < linalg::ORTHONORMAL {
            linalg::for_each_column(basis.as_mut(), |j, column| {
                if signs[j] < 0.0 {
                    column.iter_mut().for_each(|x| *x = -*x);
                }
            });
            return Ok((basis, turn));
        }
        let mut all = Mat::identity(c.ncols(), c.ncols());
        for _ in 0..MOST_TURNS {
            let whitening = SmallCholesky::new(gram.as_ref())?.whitening();
            turn = linalg::small_product(whitening.as_ref(), turn.as_ref());
            linalg::turn(basis.as_mut(), turn.as_ref());
            all = linalg::small_product(all.as_ref(), turn.as_ref());
            // What a turn so small leaves is rounding.
            if distance < NEARLY_ORTHONORMAL {
                break;
            }
            gram = self.mass.gram(basis.as_ref());
            distance = linalg::distance_from_identity(gram.as_ref());
            if distance < linalg::ORTHONORMAL {
                break;
            }
            turn = Mat::identity(c.ncols(), c.ncols());
        }
        Ok((basis, all))
    }

    /// `DᵀMY`.
    fn inner(&self, y: MatRef<'_, f64>) -> Mat<f64> {
        let mut product = Mat::zeros(self.count(), y.ncols());
        let mut at = 0;
        for part in &self.parts {
            let rows = self.mass.inner(*part, y);
            product.as_mut().subrows_mut(at, part.ncols()).copy_from(&rows);
            at += part.ncols();
        }
        product
    }

    /// Mass norms of the columns.
    fn lengths(&self) -> Vec<f64> {
        let columns = self.parts.iter().flat_map(|part| part.col_iter());
        columns.map(|column| self.mass.gram(column.as_mat())[(0, 0)].max(0.0).sqrt()).collect()
    }
}

/// Factors that bring columns of these lengths to their weights.
fn scales(lengths: &[f64], weights: &[f64]) -> Vec<f64> {
    let pairs = lengths.iter().zip(weights);
    pairs.map(|(length, weight)| if *length > 0.0 { weight / length } else { 0.0 }).collect()
}

/// The columns are M-orthonormalized unweighted and the small weighted factor is decomposed, so that
/// directions of tiny weight keep their digits; a Gram matrix of the weighted columns would lose
/// everything below 1e-8 of the first. What the first step leaves of non-orthogonality, the second
/// takes out of the columns chosen.
fn snapshots(columns: &Columns<'_>, weights: &[f64], size: usize) -> Result<Pca, DenseError> {
    let gram = columns.mass.gram_of_parts(&columns.parts);
    let (coefficients, singular) = principal_coefficients(gram.as_ref(), weights, size, DEPENDENT)?;
    let (basis, turn) = columns.orthonormal(coefficients.as_ref())?;
    let inner = linalg::small_product(coefficients.transpose(), gram.as_ref());
    let inner = linalg::small_product(turn.transpose(), inner.as_ref());
    Ok(Pca { basis, singular, inner })
}

/// Coefficients (p × at most `size`) of the leading principal components of columns D with this Gram
/// matrix DᵀMD, and all singular values; unit directions shorter than `dependent` (squared) are
/// left out.
fn principal_coefficients(
    gram: MatRef<'_, f64>,
    weights: &[f64],
    size: usize,
    dependent: f64,
) -> Result<(Mat<f64>, Vec<f64>), DenseError> {
    let lengths: Vec<f64> = (0..gram.ncols()).map(|j| gram[(j, j)].max(0.0).sqrt()).collect();
    // Q = DC is M-orthonormal and QᵀMD = CᵀDᵀMD.
    let orthonormal = linalg::orthonormal_coefficients(gram, dependent)?;
    let mut r = linalg::small_product(orthonormal.transpose(), gram);
    for (j, scale) in scales(&lengths, weights).into_iter().enumerate() {
        r.col_mut(j).iter_mut().for_each(|x| *x *= scale);
    }
    let (singular, left) = linalg::left_singular(r.as_ref())?;
    let leading = left.subcols(0, size.min(left.ncols()));
    Ok((linalg::small_product(orthonormal.as_ref(), leading), singular))
}

fn randomized(columns: &Columns<'_>, weights: &[f64], size: usize) -> Result<Pca, DenseError> {
    let mass = columns.mass;
    let p = columns.count();
    let scales = scales(&columns.lengths(), weights);
    let scaled = |mut c: Mat<f64>| {
        for j in 0..c.ncols() {
            c.col_as_slice_mut(j).iter_mut().zip(&scales).for_each(|(x, scale)| *x *= scale);
        }
        c
    };
    let mut random = ChaCha8Rng::seed_from_u64(0x9ca);
    // D S ≈ Q B with Q M-orthonormal, S the scales.
    let mut q: Vec<Tall> = Vec::new();
    let mut b: Vec<Mat<f64>> = Vec::new();
    let mut found = 0;
    let mut longest = 0.0f64;
    'blocks: while found < (size + OVERSAMPLING).min(p) {
        let width = RANDOM_BLOCK.min((size + OVERSAMPLING).min(p) - found);
        let mut probe = Mat::from_fn(p, width, |_, _| StandardNormal.sample(&mut random));
        let mut block = Mat::zeros(0, 0);
        for iteration in 0..=POWER_ITERATIONS {
            if iteration > 0 {
                probe = scaled(columns.inner(block.as_ref()));
            }
            block = columns.times(scaled(probe.clone()).as_ref());
            for (q, b) in q.iter().zip(&b) {
                let known = linalg::small_product(b.as_ref(), probe.as_ref());
                linalg::add_product(block.as_mut(), -1.0, q.as_ref(), known.as_ref());
            }
            let gram = mass.gram(block.as_ref());
            if iteration == 0 {
                let length = (0..width).map(|j| gram[(j, j)]).fold(0.0, f64::max).sqrt();
                longest = longest.max(length);
                if length <= NOISE * longest {
                    break 'blocks;
                }
            }
            let turn = linalg::orthonormal_coefficients(gram.as_ref(), DEPENDENT)?;
            block = linalg::product(block.as_ref(), turn.as_ref());
        }
        for q in &q {
            let known = mass.inner(q.as_ref(), block.as_ref());
            linalg::add_product(block.as_mut(), -1.0, q.as_ref(), known.as_ref());
        }
        let gram = mass.gram(block.as_ref());
        let turn = linalg::orthonormal_coefficients(gram.as_ref(), DEPENDENT)?;
        let whole = Columns { mass, parts: vec![block.as_ref()] };
        let (block, _) = whole.orthonormal(turn.as_ref())?;
        if block.ncols() == 0 {
            break;
        }
        found += block.ncols();
        b.push(scaled(columns.inner(block.as_ref())).transpose().to_owned());
        q.push(block);
    }
    let mut stacked = Mat::zeros(found, p);
    let mut at = 0;
    for b in &b {
        stacked.as_mut().subrows_mut(at, b.nrows()).copy_from(b);
        at += b.nrows();
    }
    let (singular, left) = linalg::left_singular(stacked.as_ref())?;
    let leading = left.subcols(0, size.min(left.ncols()));
    let blocks = Columns { mass, parts: q.iter().map(|q| q.as_ref()).collect() };
    let basis = match q.is_empty() {
        true => Tall::new(columns.parts[0].nrows(), 0),
        false => blocks.orthonormal(leading)?.0,
    };
    let inner = columns.inner(basis.as_ref()).transpose().to_owned();
    Ok(Pca { basis, singular, inner })
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: usize = 300;

    /// Twelve modes whose eigenvalues span four decades and 78 columns of no pattern as derivatives.
    fn columns() -> (Mass, LinearModes, Mat<f64>, Vec<[f64; 2]>) {
        let mass = Mass::Lumped((0..N / 3).map(|v| 1.0 + (v as f64).sin().abs()).collect());
        let wave = Mat::from_fn(N, 12, |i, j| (0.01 * (i * (j + 1)) as f64 + j as f64).sin());
        let shapes = mass.orthonormalize(wave.as_ref(), 1e-13).unwrap();
        let eigenvalues: Vec<f64> =
            (0..shapes.ncols()).map(|j| 10f64.powf(j as f64 / 3.0)).collect();
        let pairs: Vec<[usize; 2]> =
            (0..shapes.ncols()).flat_map(|j| (0..=j).map(move |i| [i, j])).collect();
        let derivatives = Mat::from_fn(N, pairs.len(), |row, k| {
            ((row * 7919 + k * 104_729 + row * k * 31) as f64).sin()
        });
        let of_pairs = pairs.iter().map(|pair| pair.map(|i| eigenvalues[i])).collect();
        (mass, LinearModes { shapes: shapes.into(), eigenvalues }, derivatives, of_pairs)
    }

    #[test]
    fn both_methods_agree_with_the_singular_value_decomposition() {
        let (mass, modes, derivatives, eigenvalues) = columns();
        let Mass::Lumped(masses) = &mass else { unreachable!("the mass is lumped") };
        // M^(1/2)D with the weights, by definition.
        let first = modes.eigenvalues[0];
        let weights = modes.eigenvalues.iter().map(|l| first / l);
        let weights = weights.chain(eigenvalues.iter().map(|[i, j]| first * first / (i * j)));
        let mut weighted = linalg::concatenate(&[modes.shapes.as_ref(), derivatives.as_ref()]);
        for (j, weight) in weights.enumerate() {
            let column = weighted.col_as_slice_mut(j);
            (0..N).for_each(|i| column[i] *= masses[i / 3].sqrt());
            let length = column.iter().map(|x| x * x).sum::<f64>().sqrt();
            column.iter_mut().for_each(|x| *x *= weight / length);
        }
        let (exact, left) = linalg::left_singular(weighted.as_ref()).unwrap();
        assert!(exact[29] > 1e-8 * exact[0], "not a test: {:?}", &exact[..30]);
        for method in [PcaMethod::Snapshots, PcaMethod::Randomized] {
            let group = WeightedDerivatives {
                shapes: derivatives.as_ref(),
                eigenvalues: eigenvalues.clone(),
            };
            for size in [4, 30] {
                let Pca { basis, singular, inner } =
                    mass_pca(&mass, &modes, std::slice::from_ref(&group), size, method).unwrap();
                let all = linalg::concatenate(&[modes.shapes.as_ref(), derivatives.as_ref()]);
                let error = (inner - mass.inner(basis.as_ref(), all.as_ref())).norm_max();
                assert!(error < 1e-9, "{method:?}: {error:e}");
                assert_eq!(basis.ncols(), size);
                let gram = mass.gram(basis.as_ref());
                assert!(linalg::distance_from_identity(gram.as_ref()) < 1e-12, "{method:?}");
                // What the basis does not capture, against the least that so many columns can leave.
                let basis = basis.as_ref();
                let scaled = Mat::from_fn(N, size, |i, j| basis[(i, j)] * masses[i / 3].sqrt());
                let inside = linalg::gram(scaled.as_ref(), weighted.as_ref());
                let mut rest = weighted.clone();
                linalg::add_product(rest.as_mut(), -1.0, scaled.as_ref(), inside.as_ref());
                let least = exact[size..].iter().map(|s| s * s).sum::<f64>().sqrt();
                let excess = rest.norm_l2() / least - 1.0;
                // One power iteration leaves a per cent; rounding is 1e-13 of the first value.
                let allowed = if method == PcaMethod::Snapshots { 1e-6 } else { 0.05 };
                assert!(
                    excess < allowed + 1e-13 * exact[0] / least,
                    "{method:?} {size}: {excess:e}"
                );
                let accuracy = if method == PcaMethod::Snapshots { 1e-6 } else { 0.05 };
                for i in 0..size.min(20) {
                    let error = (singular[i] * exact[0] / exact[i] - 1.0).abs();
                    assert!(error < accuracy, "{method:?} {size}: value {i}: {error:e}");
                }
                // The first direction stands far above the others.
                let cosine: f64 = (0..N).map(|i| scaled[(i, 0)] * left[(i, 0)]).sum();
                assert!((cosine.abs() - 1.0).abs() < 1e-6, "{method:?}: {cosine}");
            }
        }
    }

    #[test]
    fn dependent_columns_give_a_smaller_basis() {
        let (mass, modes, _, _) = columns();
        let r = modes.shapes.ncols();
        let again = WeightedDerivatives {
            shapes: modes.shapes.as_ref(),
            eigenvalues: modes.eigenvalues.iter().map(|l| [*l, modes.eigenvalues[0]]).collect(),
        };
        for method in [PcaMethod::Snapshots, PcaMethod::Randomized] {
            let pca = mass_pca(&mass, &modes, std::slice::from_ref(&again), 2 * r, method).unwrap();
            assert_eq!(pca.basis.ncols(), r, "{method:?}");
        }
    }
}
