//! The figures of R. Mukherjee, X. Wu, H. Wang, *Incremental Deformation Subspace Reconstruction*,
//! Computer Graphics Forum 35(7), 2016 (\[M16\]), Table 1: an Intel Core i7-3770S at 3.10 GHz, MKL and
//! ARPACK. Our bodies are stand-ins of the same size under the same names.

/// One row of the three parts of the table.
pub(crate) struct Row {
    /// The paper's name, in lower case.
    pub(crate) name: &'static str,
    /// Vertices and tets in thousands, springs.
    pub(crate) size: [u32; 3],
    /// (a) Linear modes from scratch and by the paper's method, in s.
    pub(crate) modes_s: [f64; 2],
    /// (b) Number of modal derivatives.
    pub(crate) n_derivatives: u32,
    /// (b) Modal derivatives from scratch and by the paper's method, in s.
    pub(crate) derivatives_s: [f64; 2],
    /// (c) PCA by a standard and by a randomized singular value decomposition, in s.
    pub(crate) pca_s: [f64; 2],
    /// All pairs of so many modes are the number nearest to the paper's.
    pub(crate) n_derivative_modes: usize,
}

/// Table 1.
pub(crate) const TABLE_1: [Row; 5] = [
    row("stomach", [37, 118, 30], [16.89, 1.10], 201, [26.08, 5.14], [15.76, 2.29], 20),
    row("plant", [13, 43, 30], [4.35, 0.42], 91, [6.82, 0.89], [3.00, 0.80], 13),
    row("fork", [13, 55, 40], [6.03, 0.67], 143, [6.50, 1.20], [3.75, 0.91], 16),
    row("dinosaur", [57, 192, 38], [14.12, 2.65], 91, [34.09, 4.21], [13.74, 3.04], 13),
    row("oball", [16, 60, 160], [7.72, 2.30], 143, [6.54, 1.25], [4.22, 0.98], 16),
];

const fn row(
    name: &'static str,
    size: [u32; 3],
    modes_s: [f64; 2],
    n_derivatives: u32,
    derivatives_s: [f64; 2],
    pca_s: [f64; 2],
    n_derivative_modes: usize,
) -> Row {
    Row { name, size, modes_s, n_derivatives, derivatives_s, pca_s, n_derivative_modes }
}

/// The row of the body `name`, its small version included.
pub(crate) fn row_of(name: &str) -> Option<&'static Row> {
    TABLE_1.iter().find(|row| name == row.name || name.strip_suffix("_small") == Some(row.name))
}

/// VegaFEM 4 (C++, TBB, ARPACK, MKL Pardiso) on the stomach with its pairs welded: 20 modes, the 210
/// derivatives of all pairs, a basis from those 230 columns; two threads of a machine on which its
/// factorization by Pardiso, analysis included, took `FACTORIZATION_S`.
pub(crate) mod vega {
    /// Mass 0.89, stiffness 7.1, modes 8.1, derivative right-hand sides 36.0, factorization 1.5,
    /// 210 solves 1.6, principal components 10.5; the cubic polynomials left out.
    pub(crate) const BUILD_S: f64 = 0.89 + 7.1 + 8.1 + 36.0 + FACTORIZATION_S + 1.6 + 10.5;
    /// The step that its figures are rescaled by.
    pub(crate) const FACTORIZATION_S: f64 = 1.5;
    /// Derivative right-hand sides: 36.0 s for 210 pairs of 121 278 tets.
    pub(crate) const LOAD_S: f64 = 36.0 / (210.0 * 121_278.0);
    /// Lowest eigenvalues in (rad/s)².
    pub(crate) const EIGENVALUES: [f64; 6] =
        [73.11207586, 390.3351245, 576.6682312, 667.5487361, 798.5586836, 1115.933299];
}
