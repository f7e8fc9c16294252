//! How good a generation is, and how that is known.

/// How a generation's modes came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// From what was prepared, without a sparse solve.
    Patched,
    /// With solves by the base body's factorization.
    Refined,
    /// From a factorization of their own, or of a new base body.
    Rebuilt,
}

/// What a generation claims of itself. Everything is estimated from residuals, without knowing the
/// exact modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certificate {
    /// Where the modes come from.
    pub verdict: Verdict,
    /// Largest estimated relative eigenvalue error in the lower half of the modes.
    pub lower_eigenvalue_error: f64,
    /// The same in the upper half.
    pub upper_eigenvalue_error: f64,
    /// Estimated sine of the largest angle between the lower half of the modes and the exact ones, in
    /// the norm of the shifted stiffness: what a basis from scratch has that this one lacks.
    pub basis_angle: f64,
    /// Relative force error of the cubature on poses held out; `None` if every tet is summed.
    pub cubature_error: Option<f64>,
    /// Whether eigenvalues and cubature are within the tolerances asked for.
    pub is_met: bool,
    /// Whether something was left undone for the deadline's sake: another rebuild without edits, and
    /// without a deadline, does it.
    pub is_unfinished: bool,
}
