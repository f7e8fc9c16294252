//! A trial space of which everything but masses is known.

use super::DEPENDENT;
use super::start::Start;
use crate::lanes::kernels::Real;
use crate::linalg::{self, DenseError};
use crate::modes::flexibility::Update;
use crate::pool::Tall;
use faer::{Mat, MatMut, MatRef};

/// Of what is missing of a mode, the part that is not worth growing the space for.
const MINOR: f64 = 0.3;

/// [X, X̃Q, W] with its Gram matrices. Coefficients are over these columns, in this order.
pub(super) struct Space<'a, T> {
    problem: &'a Update<'a, T>,
    start: Start,
    /// X: rigid modes and elastic ones.
    x: [MatRef<'a, f64>; 2],
    /// Q (p×m).
    q: Mat<f64>,
    /// TQ (n×m): X̃Q is XQ less.
    t: Tall,
    /// Largest squared length, of a column of X̃Q of unit length, of stretches that should not be there.
    stretched: f64,
    /// Combinations of X̃ in the space, Q first.
    held: Mat<f64>,
    /// What of X̃ (p×p, in K̂_σ) lies outside of the space.
    outside: Mat<f64>,
    w: Vec<Tall>,
    /// Coefficients, of the columns after X, of vectors that B has been applied to, but for their part in X.
    applied: Mat<f64>,
    gram_k: Mat<f64>,
    gram_m: Mat<f64>,
}

/// What lies outside of the space of B applied to some vectors.
pub(super) struct Missing {
    /// What B has not been applied to, by coefficients of the columns after X.
    y: Mat<f64>,
    /// A bound of the length, in K̂_σ, of B applied to it.
    of_y: Vec<f64>,
    /// Shares g of the vectors in X; BXg = X̃Λ_σ⁻¹g.
    shares: Mat<f64>,
    /// Length of what of that lies outside.
    of_shares: Vec<f64>,
    /// A bound of the length of what is missing because modes of the base body are not exact.
    of_base: Vec<f64>,
}

impl Missing {
    /// A bound of the length, in K̂_σ, of all that is missing of vector `i`.
    pub(super) fn length(&self, i: usize) -> f64 {
        self.of_y[i] + self.of_shares[i] + self.of_base[i]
    }

    /// Those of the vectors `chosen` of which the part `of` is not minor, with its lengths.
    fn major(&self, chosen: &[usize], of: &[f64]) -> Vec<(usize, f64)> {
        let lengths = chosen.iter().map(|&i| (i, of[i]));
        lengths.filter(|&(i, length)| length > MINOR * self.length(i)).collect()
    }
}

impl<'a, T: Real> Space<'a, T> {
    /// [X, X̃Q].
    pub(super) fn new(problem: &'a Update<'a, T>) -> Result<Space<'a, T>, DenseError> {
        let Update { stitched, mass, sigma, rigid, base, eigenvalues, .. } = *problem;
        let x = [rigid, base];
        let a = stitched.stitch_matrix();
        let stretches = x.map(|x| a.transpose_times(x));
        let stretch = linalg::concatenate(&stretches.each_ref().map(Mat::as_ref));
        let relaxed = stitched.relaxed(stretch.as_ref());
        let shifted = std::iter::repeat_n(0.0, rigid.ncols())
            .chain(eigenvalues.iter().copied())
            .map(|lambda| lambda + sigma)
            .collect();
        let start = Start::new(shifted, stretch, relaxed);
        let wanted = problem.n_rigid_left + problem.n_modes;
        let q = start.best(wanted.next_multiple_of(T::WIDTHS[0]))?;
        let (n, m) = (base.nrows(), q.ncols());
        let mut t = Tall::for_a_while(n, m);
        let relaxed = linalg::small_product(start.relaxed.as_ref(), q.as_ref());
        stitched.flexed_into(t.as_mut(), relaxed.as_ref());

        let gram_k = start.gram_k(q.as_ref());
        let stretched = linalg::small_product(start.stretch.as_ref(), q.as_ref())
            - a.transpose_times(t.as_ref())
            - relaxed;
        let of_column = |j: usize| {
            let length = gram_k[(start.p() + j, start.p() + j)];
            let square = stretched.col(j).squared_norm_l2() / length;
            if square.is_finite() { square } else { f64::INFINITY }
        };
        let stretched = (0..m).map(of_column).fold(0.0, f64::max);
        let [on_rigid, on_elastic] = x.map(|x| mass.inner(x, t.as_ref()));
        let inner = &q - linalg::stacked(&[on_rigid.as_ref(), on_elastic.as_ref()]);
        // (XQ − TQ)ᵀM(XQ − TQ), with XᵀM(XQ − TQ) = `inner`.
        let crossed = linalg::small_product(q.transpose(), inner.as_ref());
        let own = linalg::small_product(q.transpose(), q.as_ref());
        let corner = mass.gram(t.as_ref()) - own + &crossed + crossed.transpose();
        let column = linalg::stacked(&[inner.as_ref(), corner.as_ref()]);
        let unit = Mat::identity(start.p(), start.p());
        let gram_m = linalg::bordered_symmetric(unit.as_ref(), column.as_ref());
        let outside = start.outside(q.as_ref())?;
        Ok(Space {
            problem,
            start,
            x,
            held: q.clone(),
            q,
            t,
            stretched,
            outside,
            w: Vec::new(),
            applied: Mat::zeros(m, 0),
            gram_k,
            gram_m,
        })
    }

    /// What rounding leaves at least of a relative residual, squared, with solves that leave `rounding`.
    pub(super) fn floor(&self, rounding: f64) -> f64 {
        rounding * rounding * self.start.amplification() + self.stretched
    }

    /// Ritz pairs: θ = 1/(λ + σ), descending, with coefficients of M-orthonormal vectors.
    pub(super) fn ritz(&self) -> Result<(Vec<f64>, Mat<f64>), DenseError> {
        linalg::inverse_ritz(self.gram_k.as_ref(), self.gram_m.as_ref(), DEPENDENT)
    }

    /// The vectors of these coefficients.
    fn combined(&self, c: MatRef<'_, f64>) -> Tall {
        let mut combined = Tall::for_a_while(self.t.nrows(), c.ncols());
        let (parts, c) = self.split(c);
        linalg::combine(combined.as_mut(), &parts, &refs(&c));
        combined
    }

    /// The same, with their Gram matrix in M.
    pub(super) fn combined_with_gram(&self, c: MatRef<'_, f64>) -> (Tall, Mat<f64>) {
        let mut combined = Tall::new(self.t.nrows(), c.ncols());
        let (parts, c) = self.split(c);
        let c = refs(&c);
        let make = |first, rows: MatMut<'_, f64>| linalg::combine_rows(rows, first, &parts, &c);
        let (_, gram) = self.problem.mass.gram_of_made(combined.as_mut(), make);
        (combined, gram)
    }

    /// All columns that are there, and what coefficients `c` mean for each part of them.
    fn split(&self, c: MatRef<'_, f64>) -> (Vec<MatRef<'_, f64>>, Vec<Mat<f64>>) {
        let [p, m] = [self.q.nrows(), self.q.ncols()];
        let hat = c.subrows(p, m);
        let of_x = c.subrows(0, p) + linalg::small_product(self.q.as_ref(), hat);
        let (of_rigid, of_elastic) = of_x.as_ref().split_at_row(self.x[0].ncols());
        let mut parts = vec![self.x[0], self.x[1], self.t.as_ref()];
        let mut coefficients = vec![of_rigid.to_owned(), of_elastic.to_owned(), -hat];
        let mut at = p + m;
        for w in &self.w {
            parts.push(w.as_ref());
            coefficients.push(c.subrows(at, w.ncols()).to_owned());
            at += w.ncols();
        }
        (parts, coefficients)
    }

    /// XᵀM times the columns after X, and the Gram matrix in M of what these have outside of X.
    fn outer(&self) -> (MatRef<'_, f64>, Mat<f64>) {
        let p = self.q.nrows();
        let d = self.gram_m.ncols() - p;
        let onto = self.gram_m.submatrix(0, p, p, d);
        let inside = linalg::small_product(onto.transpose(), onto);
        (onto, self.gram_m.submatrix(p, p, d, d) - inside)
    }

    /// What is missing of B applied to the vectors of these coefficients, `beyond` being an eigenvalue λ_σ that no mode
    /// of the base body outside of X is below.
    pub(super) fn missing(&self, c: MatRef<'_, f64>, beyond: f64) -> Result<Missing, DenseError> {
        let p = self.q.nrows();
        let (_, outer) = self.outer();
        let mut y = c.subrows(p, c.nrows() - p).to_owned();
        if self.applied.ncols() > 0 {
            let gram = linalg::small_product(outer.as_ref(), self.applied.as_ref());
            let gram = linalg::small_product(self.applied.transpose(), gram.as_ref());
            let basis = linalg::orthonormal_coefficients(gram.as_ref(), DEPENDENT)?;
            let basis = linalg::small_product(self.applied.as_ref(), basis.as_ref());
            // Twice, for what rounding leaves.
            for _ in 0..2 {
                let weighed = linalg::small_product(outer.as_ref(), y.as_ref());
                let onto = linalg::small_product(basis.transpose(), weighed.as_ref());
                y -= linalg::small_product(basis.as_ref(), onto.as_ref());
            }
        }
        let squares = squared_lengths(outer.as_ref(), y.as_ref());
        let of_y = squares.iter().map(|square| (square / beyond).sqrt()).collect();
        let shares = linalg::small_product(self.gram_m.subrows(0, p), c);
        let shares = Mat::from_fn(p, c.ncols(), |i, j| shares[(i, j)] / self.start.shifted[i]);
        let squares = squared_lengths(self.outside.as_ref(), shares.as_ref());
        let of_shares = squares.iter().map(|square| square.sqrt()).collect();
        // K_σx = μMx + r: of BXg a solution for r is missing, which is ρ√μ long and divided by μ.
        let n_rigid = self.x[0].ncols();
        let inexact = |(residual, (g, mu)): (&f64, (&f64, &f64))| residual * mu.sqrt() * g.abs();
        let of_base = shares.col_iter().map(|g| {
            let of_elastic = g.iter().zip(&self.start.shifted).skip(n_rigid);
            self.problem.residuals.iter().zip(of_elastic).map(inexact).sum()
        });
        let of_base = of_base.collect();
        Ok(Missing { y, of_y, shares, of_shares, of_base })
    }

    /// Adds what is missing of the vectors `chosen`, and tells whether that was anything.
    pub(super) fn grow(&mut self, missing: &Missing, chosen: &[usize]) -> Result<bool, DenseError> {
        let p = self.q.nrows();
        let Update { stitched, mass, .. } = *self.problem;
        let before = self.gram_m.ncols();
        let major = missing.major(chosen, &missing.of_shares);
        if !major.is_empty() {
            // X̃g, of which K̂_σX̃g = K_σXg = MXΛ_σg.
            let g = scaled(missing.shares.as_ref(), &major);
            let relaxed = linalg::small_product(self.start.relaxed.as_ref(), g.as_ref());
            let mut t = Tall::for_a_while(self.t.nrows(), g.ncols());
            stitched.flexed_into(t.as_mut(), relaxed.as_ref());
            let none = Mat::zeros(self.gram_m.ncols() - p, g.ncols());
            let mut w = self.combined(linalg::stacked(&[g.as_ref(), none.as_ref()]).as_ref());
            linalg::for_each_column(w.as_mut(), |j, w| {
                w.iter_mut().zip(t.col_as_slice(j)).for_each(|(w, t)| *w -= t);
            });
            let weighed = self.start.weighed(g.as_ref());
            self.add(w, linalg::stacked(&[weighed.as_ref(), none.as_ref()]).as_ref());
            self.held = linalg::concatenate(&[self.held.as_ref(), g.as_ref()]);
            self.outside = self.start.outside(self.held.as_ref())?;
        }
        let major = missing.major(chosen, &missing.of_y);
        if !major.is_empty() {
            // By, of which K̂_σBy = My.
            let y = scaled(missing.y.as_ref(), &major);
            let after = Mat::zeros(self.gram_m.ncols() - p - y.nrows(), y.ncols());
            let y = linalg::stacked(&[y.as_ref(), after.as_ref()]);
            let onto = linalg::small_product(self.outer().0, y.as_ref());
            let z = linalg::stacked(&[(-onto).as_ref(), y.as_ref()]);
            let of = self.combined(z.as_ref());
            let mut w = Tall::for_a_while(of.nrows(), of.ncols());
            mass.multiply_into(w.as_mut(), of.as_ref());
            drop(of);
            stitched.solve_in_place(w.as_mut());
            self.add(w, z.as_ref());
            let (old, rows) = (&self.applied, self.gram_m.ncols() - p);
            self.applied = Mat::from_fn(rows, old.ncols() + y.ncols(), |i, j| {
                let (column, of) = match j.checked_sub(old.ncols()) {
                    Some(column) => (column, &y),
                    None => (j, old),
                };
                if i < of.nrows() { of[(i, column)] } else { 0.0 }
            });
        }
        Ok(self.gram_m.ncols() > before)
    }

    /// Adds W with K̂_σW = MZ, Z being the vectors of coefficients `z`.
    fn add(&mut self, w: Tall, z: MatRef<'_, f64>) {
        let mass = self.problem.mass;
        let [on_rigid, on_elastic] = self.x.map(|x| mass.inner(x, w.as_ref()));
        let on_x = linalg::stacked(&[on_rigid.as_ref(), on_elastic.as_ref()]);
        let on_t = mass.inner(self.t.as_ref(), w.as_ref());
        let on_hat = linalg::small_product(self.q.transpose(), on_x.as_ref()) - on_t;
        let on_w = self.w.iter().map(|old| mass.inner(old.as_ref(), w.as_ref()));
        let on_w: Vec<Mat<f64>> = on_w.collect();
        let mut inner = vec![on_x.as_ref(), on_hat.as_ref()];
        inner.extend(on_w.iter().map(Mat::as_ref));
        let inner = linalg::stacked(&inner);
        let own = mass.gram(w.as_ref());
        let column = linalg::stacked(&[inner.as_ref(), own.as_ref()]);
        let stiff = linalg::small_product(self.gram_m.as_ref(), z);
        let corner = linalg::small_product(inner.transpose(), z);
        let stiff = linalg::stacked(&[stiff.as_ref(), corner.as_ref()]);
        self.gram_m = linalg::bordered_symmetric(self.gram_m.as_ref(), column.as_ref());
        self.gram_k = linalg::bordered_symmetric(self.gram_k.as_ref(), stiff.as_ref());
        let (old, k) = (&self.applied, w.ncols());
        self.applied = linalg::stacked(&[old.as_ref(), Mat::zeros(k, old.ncols()).as_ref()]);
        self.w.push(w);
    }
}

fn refs(matrices: &[Mat<f64>]) -> Vec<MatRef<'_, f64>> {
    matrices.iter().map(Mat::as_ref).collect()
}

/// xᵀGx of every column.
fn squared_lengths(gram: MatRef<'_, f64>, x: MatRef<'_, f64>) -> Vec<f64> {
    let weighed = linalg::small_product(gram, x);
    (0..x.ncols()).map(|j| (x.col(j).transpose() * weighed.col(j)).max(0.0)).collect()
}

/// These columns, over these lengths.
fn scaled(x: MatRef<'_, f64>, chosen: &[(usize, f64)]) -> Mat<f64> {
    Mat::from_fn(x.nrows(), chosen.len(), |i, j| x[(i, chosen[j].0)] / chosen[j].1)
}
