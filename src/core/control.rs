//! What a long computation needs from its caller: a way to be stopped, a listener for progress,
//! and a clock (the core has none of its own).

use std::time::Duration;

/// The stages of a build, in the order of the data flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Pulling together pairs of vertices that do not coincide.
    Closing,
    /// Mass and rest stiffness matrices; beside them the fill-reducing ordering of their graph.
    Assembly,
    /// Sparse Cholesky factorization of the shifted stiffness matrix.
    Factorization,
    /// Lowest linear modes (from scratch or updated).
    Modes,
    /// Flexibility columns of candidate stitches prepared ahead.
    Seams,
    /// Modal derivatives.
    Derivatives,
    /// Mass-weighted principal component analysis.
    Basis,
    /// Cubature training, or its reuse and validation.
    Cubature,
    /// Tables of the reduced evaluator.
    Reduction,
}

impl Stage {
    /// Every stage, in order.
    pub const ALL: [Stage; 9] = [
        Stage::Closing,
        Stage::Assembly,
        Stage::Factorization,
        Stage::Modes,
        Stage::Seams,
        Stage::Derivatives,
        Stage::Basis,
        Stage::Cubature,
        Stage::Reduction,
    ];

    /// Lower-case name, as it appears in progress reports.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Closing => "closing",
            Stage::Assembly => "assembly",
            Stage::Factorization => "factorization",
            Stage::Modes => "modes",
            Stage::Seams => "seams",
            Stage::Derivatives => "derivatives",
            Stage::Basis => "basis",
            Stage::Cubature => "cubature",
            Stage::Reduction => "reduction",
        }
    }
}

/// The caller's side of a long computation. Every method may be called from any thread.
pub trait Control: Sync {
    /// Whether the computation should stop as soon as it can.
    fn is_cancelled(&self) -> bool;
    /// `stage` has come to `fraction` (0 to 1) of its work.
    fn progress(&self, stage: Stage, fraction: f64);
    /// `stage` has ended; what it took is the time since the last call, or since the computation began.
    fn ended(&self, stage: Stage) {
        self.progress(stage, 1.0);
    }
    /// A monotonic clock; only differences are used.
    fn now(&self) -> Duration;
    /// Whether there is room for a computation that takes about so many bytes of memory.
    fn admits(&self, _n_bytes: usize) -> bool {
        true
    }
}

/// Never cancels, hears no progress, and times nothing.
pub struct Uncontrolled;

impl Control for Uncontrolled {
    fn is_cancelled(&self) -> bool {
        false
    }
    fn progress(&self, _stage: Stage, _fraction: f64) {}
    fn now(&self) -> Duration {
        Duration::ZERO
    }
}

/// The computation was stopped through [`Control::is_cancelled`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// Returns `Err(Cancelled)` once the caller has asked to stop.
pub fn check(control: &dyn Control) -> Result<(), Cancelled> {
    if control.is_cancelled() { Err(Cancelled) } else { Ok(()) }
}
