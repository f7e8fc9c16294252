//! The clock that the core times its stages with.

use std::time::{Duration, Instant};
use sutura_core::control::{Control, Stage};

/// Never cancels; a clock for the stages.
pub(crate) struct Clock(Instant);

impl Clock {
    /// Starts now.
    pub(crate) fn start() -> Clock {
        Clock(Instant::now())
    }
}

impl Control for Clock {
    fn is_cancelled(&self) -> bool {
        false
    }
    fn progress(&self, _stage: Stage, _fraction: f64) {}
    fn now(&self) -> Duration {
        self.0.elapsed()
    }
}
