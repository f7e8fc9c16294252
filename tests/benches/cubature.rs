//! Points, errors and seconds of the methods that select cubature points.

use crate::bodies::{Body, Failure};
use crate::clock::Clock;
use serde::{Deserialize, Serialize};
use sutura_core::build::{self, CubatureParams, Selection};
use sutura_core::control::Stage;

/// The methods, by name, and whether points are smoothed.
pub(crate) const METHODS: [(&str, Selection, bool); 5] = [
    ("greedy NNLS", Selection::GreedyNnls, false),
    ("greedy NNLS, smoothed", Selection::GreedyNnls, true),
    ("sparse NNLS", Selection::SparseNnls, false),
    ("NN-HTP", Selection::NnHtp, false),
    ("empirical cubature", Selection::EmpiricalCubature, false),
];

/// Points allowed, one training each.
pub(crate) const POINTS: [usize; 4] = [60, 120, 240, 480];

/// Held-out errors for which points are counted.
pub(crate) const ERRORS: [f64; 2] = [0.05, 0.01];

/// A tolerance that no rule reaches: every point allowed is used.
pub(crate) const NEVER: f64 = 1e-9;

/// One method on one body.
#[derive(Serialize, Deserialize)]
pub(crate) struct Method {
    pub(crate) name: String,
    /// In the order of [`POINTS`].
    pub(crate) trainings: Vec<Training>,
}

/// One training.
#[derive(Serialize, Deserialize)]
pub(crate) struct Training {
    pub(crate) n_points: usize,
    /// Relative error on held-out poses, energy norm.
    pub(crate) error: f64,
    /// Exact forces, selection and fit.
    pub(crate) seconds: f64,
}

/// Trains every method once for each number of points.
pub(crate) fn measure(body: &Body) -> Result<Vec<Method>, Failure> {
    let mut methods = Vec::new();
    for (name, selection, smoothing) in METHODS {
        let mut trainings = Vec::new();
        for n_points in POINTS {
            let mut params = body.session(&[]);
            params.cubature = params.cubature.map(|cubature| CubatureParams {
                n_points,
                tolerance: NEVER,
                selection,
                smoothing,
                ..cubature
            });
            let built = build::build(body.mesh.clone(), &params, &Clock::start())?;
            let report = built.cubature().ok_or("a session without cubature")?;
            let stages = built.timings().iter().filter(|(stage, _)| *stage == Stage::Cubature);
            trainings.push(Training {
                n_points: report.n_points,
                error: report.validation_error,
                seconds: stages.map(|(_, time)| time.as_secs_f64()).sum(),
            });
        }
        methods.push(Method { name: name.into(), trainings });
    }
    Ok(methods)
}

impl Method {
    /// Points at which the error falls to `error`, interpolated between two trainings on logarithmic
    /// scales.
    pub(crate) fn points_at(&self, error: f64) -> Option<f64> {
        let mut before: Option<&Training> = None;
        for training in &self.trainings {
            if training.error <= error {
                return Some(match before {
                    None => training.n_points as f64,
                    Some(before) => {
                        let share =
                            (before.error / error).ln() / (before.error / training.error).ln();
                        let [low, high] = [before, training].map(|t| (t.n_points as f64).ln());
                        (low + share * (high - low)).exp()
                    }
                });
            }
            before = Some(training);
        }
        None
    }
}
