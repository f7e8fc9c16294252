//! The stages of a build on a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use sutura_core::control::{Control, Stage};

/// Steps of a bar.
const RESOLUTION: u64 = 1000;

/// A bar that runs once through every stage; its caller's clock.
pub(super) struct StageBars {
    bar: ProgressBar,
    stage: Mutex<Option<(Stage, Instant)>>,
    begin: Instant,
}

impl StageBars {
    /// Nothing is drawn unless somebody watches.
    pub(super) fn new(is_watched: bool) -> StageBars {
        let target =
            if is_watched { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(RESOLUTION), target);
        let template = "  {msg:14} {bar:40.cyan/dim} {percent:>3} % {elapsed:>4}";
        bar.set_style(
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        bar.enable_steady_tick(Duration::from_millis(100));
        StageBars { bar, stage: Mutex::new(None), begin: Instant::now() }
    }

    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Control for StageBars {
    fn is_cancelled(&self) -> bool {
        false
    }

    fn progress(&self, stage: Stage, fraction: f64) {
        let mut current = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        if current.is_none_or(|(other, _)| other != stage) {
            *current = Some((stage, Instant::now()));
            self.bar.set_message(stage.name());
        }
        self.bar.set_position((fraction.clamp(0.0, 1.0) * RESOLUTION as f64) as u64);
        if fraction >= 1.0
            && let Some((_, begin)) = *current
        {
            let line = format!("  {:14} {:.2} s", stage.name(), begin.elapsed().as_secs_f64());
            self.bar.println(line);
        }
    }

    fn now(&self) -> Duration {
        self.begin.elapsed()
    }
}
