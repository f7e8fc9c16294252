//! Linear modes K φ = λ M φ: from scratch ([`lanczos`]) and after an edit ([`prepared`] inside a seam, [`series`]
//! or [`flexibility`] elsewhere, [`low_rank`]).

pub mod flexibility;
pub mod lanczos;
pub mod load_cases;
pub mod low_rank;
pub mod prepared;
pub mod rigid;
pub mod seams;
pub mod series;
pub mod shift;
pub mod stitched;

use crate::assembly::mass::Mass;
use crate::control::Cancelled;
use crate::linalg::{self, DenseError};
use crate::pool::Tall;
use faer::{Mat, MatRef};

/// Elastic modes, ascending; rigid ones are kept apart.
#[derive(Clone, Debug)]
pub struct LinearModes {
    /// n × r, M-orthonormal.
    pub shapes: Tall,
    /// λ = ω² in 1/s².
    pub eigenvalues: Vec<f64>,
}

impl LinearModes {
    /// The lowest `count` of them.
    pub fn lowest(&self, count: usize) -> LinearModes {
        let count = count.min(self.eigenvalues.len());
        LinearModes {
            shapes: self.shapes.subcols(0, count).to_owned().into(),
            eigenvalues: self.eigenvalues[..count].to_vec(),
        }
    }
}

/// Why modes could not be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum ModesError {
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    #[error(transparent)]
    Dense(#[from] DenseError),
    #[error("residual {residual:e} in a space of {dimension} vectors")]
    NotConverged { residual: f64, dimension: usize },
}

/// Relative residuals of modes in the norm of the flexibility:
/// ρ = √(θ · rᵀ K̂_σ⁻¹ r) with r = K̂φ − λMφ and θ = 1/(λ + σ).
///
/// In this norm a residual is a relative error: some exact eigenvalue of (K̂ + σM, M) lies within
/// the fraction ρ of λ + σ, and the error of a Ritz value is about ρ² over its relative gap. (The
/// Euclidean or M⁻¹ norm would be ruled by high frequencies that hardly matter to the mode.)
/// `energies` are rᵀ K̂_σ⁻¹ r, for each mode.
pub fn relative_residuals(energies: &[f64], eigenvalues: &[f64], sigma: f64) -> Vec<f64> {
    let pairs = energies.iter().zip(eigenvalues);
    pairs.map(|(energy, lambda)| (energy.max(0.0) / (lambda + sigma)).sqrt()).collect()
}

/// What estimates are multiplied by: `beyond` is a Ritz value too, below the exact θ, so that gaps come
/// out too large. Measured errors reached 1.2 of the bare estimates.
const ESTIMATE_MARGIN: f64 = 2.0;

/// Eigenvalues with their audit.
#[derive(Clone, Debug)]
pub struct AuditedSpectrum {
    /// λ = ω² in 1/s², ascending.
    pub eigenvalues: Vec<f64>,
    /// [`relative_residuals`].
    pub residuals: Vec<f64>,
    /// Estimated relative errors of the eigenvalues.
    pub error_estimates: Vec<f64>,
    /// Estimated sines of the angles between each mode and the exact modes' span, in the norm of K̂_σ.
    pub angle_estimates: Vec<f64>,
}

/// Relative eigenvalue error accepted for the upper half of the modes, as a multiple of the
/// tolerance for the lower half: they carry the least of a motion and cost the most to refine.
pub const UPPER_HALF_FACTOR: f64 = 100.0;

impl AuditedSpectrum {
    /// Converged eigenvalues: the error is the square of the residual, the angle the residual, as far
    /// from others as converged ones are.
    pub fn converged(eigenvalues: Vec<f64>, residuals: Vec<f64>) -> AuditedSpectrum {
        let error_estimates = residuals.iter().map(|residual| residual * residual).collect();
        AuditedSpectrum {
            eigenvalues,
            angle_estimates: residuals.clone(),
            residuals,
            error_estimates,
        }
    }

    /// Ritz values λ = 1/θ − σ. The error is estimated by the square of the residual over the relative
    /// gap to `beyond`, the first θ that is not among them, the angle by the residual over it
    /// (Davis and Kahan's sin θ theorem), both with [`ESTIMATE_MARGIN`].
    fn of_ritz(theta: &[f64], beyond: f64, residuals: Vec<f64>, sigma: f64) -> AuditedSpectrum {
        let gap = |theta: f64| ((theta - beyond) / theta).max(f64::EPSILON);
        let estimate = |(theta, residual): (&f64, &f64)| {
            let lambda = theta.recip() - sigma;
            let shifted = residual.min(residual.powi(2) / gap(*theta));
            ESTIMATE_MARGIN * shifted / theta / lambda.max(f64::MIN_POSITIVE)
        };
        let angle =
            |(theta, residual): (&f64, &f64)| (ESTIMATE_MARGIN * residual / gap(*theta)).min(1.0);
        AuditedSpectrum {
            eigenvalues: theta.iter().map(|theta| theta.recip() - sigma).collect(),
            error_estimates: theta.iter().zip(&residuals).map(estimate).collect(),
            angle_estimates: theta.iter().zip(&residuals).map(angle).collect(),
            residuals,
        }
    }

    /// The lowest `count`.
    pub fn lowest(&self, count: usize) -> AuditedSpectrum {
        let count = count.min(self.eigenvalues.len());
        AuditedSpectrum {
            eigenvalues: self.eigenvalues[..count].to_vec(),
            residuals: self.residuals[..count].to_vec(),
            error_estimates: self.error_estimates[..count].to_vec(),
            angle_estimates: self.angle_estimates[..count].to_vec(),
        }
    }

    /// The modes whose estimated errors exceed `tolerance`, or [`UPPER_HALF_FACTOR`] times that in the
    /// upper half.
    pub fn beyond(&self, tolerance: f64) -> Vec<usize> {
        let count = self.eigenvalues.len();
        let allowed =
            |i: usize| if 2 * i < count { tolerance } else { UPPER_HALF_FACTOR * tolerance };
        // A NaN is beyond.
        let is_within = |i: &usize| self.error_estimates[*i] <= allowed(*i);
        (0..count).filter(|i| !is_within(i)).collect()
    }

    /// Largest estimated errors in the lower and in the upper half.
    pub fn worst_errors(&self) -> [f64; 2] {
        let (lower, upper) = self.error_estimates.split_at(self.error_estimates.len().div_ceil(2));
        [lower, upper].map(|errors| errors.iter().copied().fold(0.0, f64::max))
    }

    /// Largest estimated angle in the lower half (sine).
    pub fn worst_angle(&self) -> f64 {
        let half = self.angle_estimates.len().div_ceil(2);
        self.angle_estimates[..half].iter().copied().fold(0.0, f64::max)
    }
}

/// R = K̂Φ − MΦΛ from K̂Φ.
pub fn residual_vectors(
    stiffness_times_shapes: Mat<f64>,
    mass: &Mass,
    shapes: MatRef<'_, f64>,
    eigenvalues: &[f64],
) -> Mat<f64> {
    let mut residual = stiffness_times_shapes;
    let ms = mass.multiply(shapes);
    linalg::for_each_column(residual.as_mut(), |j, residual| {
        for (r, m) in residual.iter_mut().zip(ms.col_as_slice(j)) {
            *r -= eigenvalues[j] * m;
        }
    });
    residual
}

/// Largest entry of |ΦᵀMΦ − I|.
pub fn orthonormality_error(mass: &Mass, shapes: MatRef<'_, f64>) -> f64 {
    linalg::distance_from_identity(mass.gram(shapes).as_ref())
}
