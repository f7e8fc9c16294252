//! The update of modes by stitches inside a seam: no sparse solve, nothing of the size of the mesh.
//!
//! From Y₀ = X(Λ + σ), X being the base body's modes, two steps of inverse iteration with the
//! stitched stiffness, Y_j = K̂_σ⁻¹MY_{j−1}, are combinations of X, S₁ and S₂ ([`super::seams`]): with
//! D the stitches' compliances and EᵀK_σ⁻¹E = H₀ + EᵀX(Λ + σ)⁻¹XᵀE,
//!
//! K̂_σ⁻¹b = K_σ⁻¹b − K_σ⁻¹E (D + EᵀK_σ⁻¹E)⁻¹ EᵀK_σ⁻¹b,
//!
//! which needs no stiffness of a stitch but its inverse, so that a rigid one is D = 0. Rayleigh–Ritz on
//! [Y₁, Y₂] takes nothing but the block moments μ_j = Y₀ᵀM(K̂_σ⁻¹M)ʲY₀: the Gram matrices are
//! Y_iᵀK̂_σY_j = μ_{i+j−1} and Y_iᵀMY_j = μ_{i+j}, and the audit, ‖r‖ in the norm of K̂_σ⁻¹, needs
//! Y_iᵀMK̂_σ⁻¹MY_j = μ_{i+j+1}.
//!
//! Measured on the five bodies of the benchmarks with 44 elastic modes in X: relative eigenvalue errors
//! of at most 3e-5 in the lower half of 30 modes and 3e-3 in the upper (40 in X leave 4e-4 on the body
//! with 160 stitches). X or all columns of S₁ and S₂ beside Y₁ and Y₂ gain nothing.

use crate::edit::Stitch;
use crate::linalg::{self, DenseError, SmallCholesky};
use crate::modes::load_cases::LoadCases;
use crate::modes::seams::Seams;
use crate::modes::{AuditedSpectrum, rigid};
use faer::{Mat, MatRef};

/// Directions whose squared K̂_σ-length is below this fraction after scaling are dependent.
const DEPENDENT: f64 = 1e-13;

/// Squared residuals are known to about this much: the difference of two numbers that agree.
const RESOLUTION: f64 = 1e-10;

/// Vectors X·x + S₁·s1 + S₂·s2 + F·f over the columns of some stitches and the load cases' solutions.
#[derive(Clone, Debug)]
pub struct Coefficients {
    /// k×m.
    pub x: Mat<f64>,
    /// 3s×m.
    pub s1: Mat<f64>,
    /// 3s×m.
    pub s2: Mat<f64>,
    /// q×m.
    pub f: Mat<f64>,
}

impl Coefficients {
    /// These vectors times `c`.
    pub fn times(&self, c: MatRef<'_, f64>) -> Coefficients {
        Coefficients {
            x: linalg::small_product(self.x.as_ref(), c),
            s1: linalg::small_product(self.s1.as_ref(), c),
            s2: linalg::small_product(self.s2.as_ref(), c),
            f: linalg::small_product(self.f.as_ref(), c),
        }
    }

    /// Some of these vectors.
    pub fn columns(&self, range: std::ops::Range<usize>) -> Coefficients {
        let some = |m: &Mat<f64>| m.subcols(range.start, range.len()).to_owned();
        Coefficients { x: some(&self.x), s1: some(&self.s1), s2: some(&self.s2), f: some(&self.f) }
    }

    /// The vectors of `parts` side by side.
    pub fn concatenate(parts: &[&Coefficients]) -> Coefficients {
        let side_by_side = |of: fn(&Coefficients) -> &Mat<f64>| {
            linalg::concatenate(&parts.iter().map(|part| of(part).as_ref()).collect::<Vec<_>>())
        };
        Coefficients {
            x: side_by_side(|c| &c.x),
            s1: side_by_side(|c| &c.s1),
            s2: side_by_side(|c| &c.s2),
            f: side_by_side(|c| &c.f),
        }
    }

    fn plus(mut self, other: &Coefficients) -> Coefficients {
        self.x += &other.x;
        self.s1 += &other.s1;
        self.s2 += &other.s2;
        self.f += &other.f;
        self
    }
}

/// Stitches inside a seam, and K̂_σ⁻¹ by them.
pub struct PreparedStitches {
    /// λ of X, rigid motions first.
    lambda: Vec<f64>,
    sigma: f64,
    n_rigid: usize,
    /// √k of each stitch.
    root_stiffness: Vec<f64>,
    /// EᵀX (3s×k).
    gaps: Mat<f64>,
    /// H₀ … H₄ (3s×3s).
    moments: [Mat<f64>; 5],
    /// EᵀF, S₁ᵀMF, S₂ᵀMF (3s×q), S₁ᵀMΨ, S₂ᵀMΨ and EᵀΨ (3s×m).
    couplings: [Mat<f64>; 6],
    cases: LoadCases,
    /// D + EᵀK_σ⁻¹E.
    flexibility: SmallCholesky,
}

impl PreparedStitches {
    /// `positions` are those of `stitches` in `seams`; `eigenvalues` belong to X, whose first `n_rigid`
    /// are rigid.
    pub fn new(
        seams: &Seams,
        positions: &[usize],
        stitches: &[Stitch],
        n_rigid: usize,
        eigenvalues: &[f64],
        sigma: f64,
    ) -> Result<PreparedStitches, DenseError> {
        let lambda: Vec<f64> =
            std::iter::repeat_n(0.0, n_rigid).chain(eigenvalues.iter().copied()).collect();
        let gaps = seams.gaps(positions);
        let moments = std::array::from_fn(|j| seams.moment(j, positions));
        let mut sum = {
            let weighted =
                Mat::from_fn(gaps.nrows(), gaps.ncols(), |i, j| gaps[(i, j)] / (lambda[j] + sigma));
            linalg::small_product(weighted.as_ref(), gaps.transpose())
        };
        sum += &moments[0];
        for i in 0..sum.nrows() {
            sum[(i, i)] += stitches[i / 3].stiffness_n_m.recip();
        }
        Ok(PreparedStitches {
            lambda,
            sigma,
            n_rigid,
            root_stiffness: stitches.iter().map(|s| s.stiffness_n_m.sqrt()).collect(),
            gaps,
            moments,
            couplings: seams.couplings(positions),
            cases: seams.cases().clone(),
            flexibility: SmallCholesky::new(sum.as_ref())?,
        })
    }

    /// The same stitches beside `cases`, which they have to do with as `couplings` tell
    /// ([`Seams::couplings_with`]).
    pub fn beside(self, cases: LoadCases, couplings: [Mat<f64>; 6]) -> PreparedStitches {
        PreparedStitches { cases, couplings, ..self }
    }

    /// The load cases.
    pub fn cases(&self) -> &LoadCases {
        &self.cases
    }

    /// `y`, vectors without F, beside these load cases.
    pub fn among_cases(&self, y: Coefficients) -> Coefficients {
        Coefficients { f: Mat::zeros(self.cases.len(), y.x.ncols()), ..y }
    }

    /// `count` zero vectors.
    fn zeros(&self, count: usize) -> Coefficients {
        let (k, s, q) = (self.lambda.len(), self.gaps.nrows(), self.cases.len());
        Coefficients {
            x: Mat::zeros(k, count),
            s1: Mat::zeros(s, count),
            s2: Mat::zeros(s, count),
            f: Mat::zeros(q, count),
        }
    }

    /// θ·y, θ = 1/(λ + σ).
    fn damped(&self, y: MatRef<'_, f64>) -> Mat<f64> {
        Mat::from_fn(y.nrows(), y.ncols(), |i, j| y[(i, j)] / (self.lambda[i] + self.sigma))
    }

    /// EᵀY of vectors without F.
    fn gap(&self, y: &Coefficients) -> Mat<f64> {
        let mut gap = linalg::small_product(self.gaps.as_ref(), y.x.as_ref());
        gap += linalg::small_product(self.moments[0].as_ref(), y.s1.as_ref());
        gap += linalg::small_product(self.moments[1].as_ref(), y.s2.as_ref());
        gap
    }

    /// AᵀY: how far Y stretches the stitches, times √k.
    pub fn stretch(&self, y: &Coefficients) -> Mat<f64> {
        let mut stretch = self.gap(y);
        stretch += linalg::small_product(self.couplings[0].as_ref(), y.f.as_ref());
        for j in 0..stretch.ncols() {
            let column = stretch.col_as_slice_mut(j).iter_mut();
            column.enumerate().for_each(|(i, x)| *x *= self.root_stiffness[i / 3]);
        }
        stretch
    }

    /// The motions that remain rigid, in terms of the rigid ones of X.
    pub fn rigid_left(&self) -> Result<Mat<f64>, DenseError> {
        rigid::unstretched(self.gaps.subcols(0, self.n_rigid))
    }

    /// −K_σ⁻¹E (D + EᵀK_σ⁻¹E)⁻¹ `gap`, what the stitches take back from K_σ⁻¹B = X·x + … with
    /// EᵀK_σ⁻¹B = `gap`; `x` is added.
    fn corrected(&self, x: Mat<f64>, gap: MatRef<'_, f64>) -> Coefficients {
        let w = self.flexibility.solve(gap);
        let back = linalg::small_product(self.gaps.transpose(), w.as_ref());
        let mut y = self.zeros(w.ncols());
        y.x = x - self.damped(back.as_ref());
        y.s1 = -w;
        y
    }

    /// θ·x and EᵀK_σ⁻¹MY of vectors without F.
    fn flexed(&self, y: &Coefficients) -> (Mat<f64>, Mat<f64>) {
        let x = self.damped(y.x.as_ref());
        let mut gap = linalg::small_product(self.gaps.as_ref(), x.as_ref());
        gap += linalg::small_product(self.moments[1].as_ref(), y.s1.as_ref());
        gap += linalg::small_product(self.moments[2].as_ref(), y.s2.as_ref());
        (x, gap)
    }

    /// K̂_σ⁻¹MY for vectors of X and S₁ alone.
    fn step(&self, y: &Coefficients) -> Coefficients {
        let (x, gap) = self.flexed(y);
        let mut next = self.corrected(x, gap.as_ref());
        next.s2 = y.s1.clone();
        next
    }

    /// AᵀHB over \[S₁ | S₂\] with the Hankel blocks H_j, H_{j+1}, H_{j+2}.
    fn form(&self, j: usize, a: &Coefficients, b: &Coefficients) -> Mat<f64> {
        let product =
            |h: usize, y: &Mat<f64>| linalg::small_product(self.moments[h].as_ref(), y.as_ref());
        let upper = product(j, &b.s1) + product(j + 1, &b.s2);
        let lower = product(j + 1, &b.s1) + product(j + 2, &b.s2);
        linalg::small_product(a.s1.transpose(), upper.as_ref())
            + linalg::small_product(a.s2.transpose(), lower.as_ref())
    }

    /// AᵀMB of vectors without F.
    fn mass_of(&self, a: &Coefficients, b: &Coefficients) -> Mat<f64> {
        self.form(1, a, b) + linalg::small_product(a.x.transpose(), b.x.as_ref())
    }

    /// YᵀMK̂_σ⁻¹MY of vectors without F.
    fn twice(&self, y: &Coefficients) -> Mat<f64> {
        let (x, gap) = self.flexed(y);
        let w = self.flexibility.solve(gap.as_ref());
        self.form(2, y, y) + linalg::small_product(y.x.transpose(), x.as_ref())
            - linalg::small_product(gap.transpose(), w.as_ref())
    }

    /// \[S₁ | S₂\]ᵀMF and \[S₁ | S₂\]ᵀKF times coefficients: KS₁ = E − σMS₁ and KS₂ = MS₁ − σMS₂ on
    /// the complement of X.
    fn coupled(&self, y: &Coefficients) -> [Mat<f64>; 2] {
        let [gap, one, two, ..] = &self.couplings;
        let sum = |first: &Mat<f64>, second: &Mat<f64>| {
            linalg::small_product(first.transpose(), y.s1.as_ref())
                + linalg::small_product(second.transpose(), y.s2.as_ref())
        };
        let mass = sum(one, two);
        let stiffness = sum(gap, one) - faer::Scale(self.sigma) * &mass;
        [mass, stiffness]
    }

    /// YᵀMY and YᵀKY, K being that of the unstitched body.
    pub fn grams(&self, y: &Coefficients) -> [Mat<f64>; 2] {
        let [mass_f, stiffness_f] =
            self.coupled(y).map(|c| linalg::small_product(y.f.transpose(), c.as_ref()));
        let own = |m: &Mat<f64>| {
            let product = linalg::small_product(m.as_ref(), y.f.as_ref());
            linalg::small_product(y.f.transpose(), product.as_ref())
        };
        let without_f = self.form(1, y, y);
        let weighted = Mat::from_fn(y.x.nrows(), y.x.ncols(), |i, j| self.lambda[i] * y.x[(i, j)]);
        let stiffness = linalg::small_product(y.x.transpose(), weighted.as_ref())
            + self.form(0, y, y)
            - faer::Scale(self.sigma) * &without_f
            + &stiffness_f
            + stiffness_f.transpose()
            + own(&self.cases.energy);
        let mass = linalg::small_product(y.x.transpose(), y.x.as_ref())
            + without_f
            + &mass_f
            + mass_f.transpose()
            + own(&self.cases.mass);
        [mass, stiffness]
    }

    /// ΨᵀMY of the sources of the load cases, set after set, for vectors without F.
    pub fn on_sources(&self, y: &Coefficients) -> Mat<f64> {
        let [_, _, _, one, two, _] = &self.couplings;
        let on_x: Vec<MatRef<'_, f64>> =
            self.cases.sources.iter().map(|source| source.on_modes.as_ref()).collect();
        linalg::small_product(linalg::concatenate(&on_x).transpose(), y.x.as_ref())
            + linalg::small_product(one.transpose(), y.s1.as_ref())
            + linalg::small_product(two.transpose(), y.s2.as_ref())
    }

    /// ψ_iᵀK̂ψ_i and ψ_jᵀK̂ψ_j of the two modes that each load is made of: what a derivative is weighed by.
    /// A mode that opens the stitches is stiff in the stitched body, whatever its own eigenvalue: with
    /// that for a weight, a fork whose head was free came out 200 times worse than from scratch.
    pub fn quotients(&self) -> Vec<[f64; 2]> {
        let gaps = &self.couplings[5];
        let mut quotients = Vec::with_capacity(self.cases.len());
        let mut at = 0;
        for source in &self.cases.sources {
            let of: Vec<f64> = source
                .energies
                .iter()
                .enumerate()
                .map(|(i, energy)| {
                    let gap = gaps.col_as_slice(at + i).iter().enumerate();
                    let springs = gap.map(|(row, g)| (self.root_stiffness[row / 3] * g).powi(2));
                    energy + springs.sum::<f64>()
                })
                .collect();
            for j in 0..of.len() {
                quotients.extend((0..=j).map(|i| [of[i], of[j]]));
            }
            at += of.len();
        }
        quotients
    }

    /// K̂⁻¹L of the load cases, on the complement of the motions that remain rigid
    /// ([`PreparedStitches::rigid_left`]), exact in `modes` with `eigenvalues` λ̂. Where the factor is
    /// shifted, (σ/(λ̂ + σ))² of the part beyond them is left out.
    pub fn load_responses(
        &self,
        modes: &Coefficients,
        eigenvalues: &[f64],
        rigid_left: MatRef<'_, f64>,
    ) -> Coefficients {
        // K̂⁻¹L = F + K̂⁻¹(MXXᵀL − AAᵀF).
        let q = self.cases.len();
        let x = self.damped(self.cases.on_modes.as_ref());
        let gap = linalg::small_product(self.gaps.as_ref(), x.as_ref()) + &self.couplings[0];
        let mut y = self.corrected(x, gap.as_ref());
        if self.sigma > 0.0 {
            // K̂⁻¹ = K̂_σ⁻¹ + σK̂_σ⁻¹MK̂_σ⁻¹ + …, whose rest is (σ/(λ̂ + σ))² of a mode's share.
            let mut second = self.step(&y);
            for part in [&mut second.x, &mut second.s1, &mut second.s2] {
                *part *= faer::Scale(self.sigma);
            }
            y = y.plus(&second);
        }
        y.f = Mat::identity(q, q);
        // In the modes that are known the response is Λ̂⁻¹Φ̂ᵀL. They span what is soft, where an error of the
        // load, relative to its stiff part, is magnified most: it would outweigh all else in the basis.
        let [mass, stiffness] = self.coupled(modes);
        let loads = linalg::small_product(modes.x.transpose(), self.cases.on_modes.as_ref())
            + stiffness.transpose();
        let present = self.mass_of(modes, &y) + mass.transpose();
        let missing = Mat::from_fn(eigenvalues.len(), q, |i, j| {
            loads[(i, j)] / eigenvalues[i] - present[(i, j)]
        });
        let f = std::mem::replace(&mut y.f, Mat::zeros(q, q));
        y = y.plus(&modes.times(missing.as_ref()));
        y.f = f;
        let rigid = y.x.subrows(0, self.n_rigid).to_owned();
        let inside = linalg::small_product(rigid_left.transpose(), rigid.as_ref());
        let free = rigid - linalg::small_product(rigid_left, inside.as_ref());
        y.x.as_mut().subrows_mut(0, self.n_rigid).copy_from(&free);
        y
    }

    /// The `count` lowest elastic modes of X.
    pub fn unstitched(&self, count: usize) -> Coefficients {
        let mut modes = self.zeros(count);
        (0..count).for_each(|i| modes.x[(self.n_rigid + i, i)] = 1.0);
        modes
    }

    /// The lowest elastic modes, at most `n_modes`: coefficients of M-orthonormal vectors with their
    /// audit. `n_rigid_left` motions have no energy.
    pub fn modes(
        &self,
        n_rigid_left: usize,
        n_modes: usize,
    ) -> Result<(Coefficients, AuditedSpectrum), DenseError> {
        let k = self.lambda.len();
        let mut start = self.zeros(k);
        for (i, lambda) in self.lambda.iter().enumerate() {
            start.x[(i, i)] = lambda + self.sigma;
        }
        let y1 = self.step(&start);
        let y2 = self.step(&y1);
        let mu = [
            self.mass_of(&start, &y1),
            self.mass_of(&y1, &y1),
            self.mass_of(&y1, &y2),
            self.mass_of(&y2, &y2),
        ];
        let hankel = |j: usize| {
            Mat::from_fn(2 * k, 2 * k, |row, column| {
                let block = &mu[j + row / k + column / k];
                let (row, column) = (row % k, column % k);
                0.5 * (block[(row, column)] + block[(column, row)])
            })
        };
        let (gram_k, gram_m) = (hankel(0), hankel(1));
        let basis = linalg::orthonormal_coefficients(gram_k.as_ref(), DEPENDENT)?;
        let projected = |gram: &Mat<f64>, c: MatRef<'_, f64>| {
            linalg::small_product(c.transpose(), linalg::small_product(gram.as_ref(), c).as_ref())
        };
        let (theta, vectors) =
            linalg::symmetric_eigen(projected(&gram_m, basis.as_ref()).as_ref())?;
        let theta: Vec<f64> = theta.into_iter().rev().collect();
        let count = n_modes.min(theta.len().saturating_sub(n_rigid_left));
        let chosen = Mat::from_fn(vectors.nrows(), count, |i, j| {
            vectors[(i, theta.len() - 1 - n_rigid_left - j)]
        });
        let chosen = linalg::small_product(basis.as_ref(), chosen.as_ref());
        let turn = SmallCholesky::new(projected(&gram_m, chosen.as_ref()).as_ref())?.whitening();
        let chosen = linalg::small_product(chosen.as_ref(), turn.as_ref());
        // Ritz values beyond as many as X has elastic modes are not accurate enough to count.
        let beyond = theta.get(n_rigid_left + k - self.n_rigid).copied().unwrap_or(0.0);
        let shapes = y1.times(chosen.subrows(0, k)).plus(&y2.times(chosen.subrows(k, k)));
        // Y₁ and Y₂ lean on each other: their combinations keep 1e-7 of the orthonormality, and Ritz values from the
        // moments came out 1.5e-6 below the exact ones. Those of the combinations themselves are quotients to rounding.
        let turn = SmallCholesky::new(self.mass_of(&shapes, &shapes).as_ref())?.whitening();
        let shapes = shapes.times(turn.as_ref());
        let [_, mut stiffness] = self.grams(&shapes);
        let stretch = self.stretch(&shapes);
        stiffness += linalg::small_product(stretch.transpose(), stretch.as_ref());
        let (eigenvalues, turn) = linalg::symmetric_eigen(stiffness.as_ref())?;
        let shapes = shapes.times(turn.as_ref());
        let kept: Vec<f64> =
            eigenvalues.iter().map(|lambda| (lambda + self.sigma).recip()).collect();
        let twice = self.twice(&shapes);
        // μ²·yᵀMK̂_σ⁻¹My − μ over μ, for yᵀMy = 1 and yᵀK̂_σy = μ = 1/θ. From the combinations
        // themselves: from the moments it can come out far too small.
        let residuals: Vec<f64> =
            (0..count).map(|i| (twice[(i, i)] / kept[i] - 1.0).max(RESOLUTION).sqrt()).collect();
        Ok((shapes, AuditedSpectrum::of_ritz(&kept, beyond, residuals, self.sigma)))
    }
}
