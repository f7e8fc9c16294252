//! The progress bar of a session's build.

use super::console::Console;
use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;
use sutura_client::proto::event::Event;

/// Steps of the bar within one stage.
const RESOLUTION: u64 = 1000;

/// A bar that runs once through every stage, and a line for each that is done. The times are not
/// taken here, where events arrive late: the daemon reports them with the result.
pub(crate) struct BuildProgress {
    console: Console,
    bar: ProgressBar,
    stage: Option<String>,
}

impl BuildProgress {
    pub(crate) fn new(console: Console) -> BuildProgress {
        let bar = ProgressBar::new(RESOLUTION);
        let template = "  {msg:14} {bar:40.cyan/dim} {percent:>3} % {elapsed:>4}";
        bar.set_style(
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        bar.enable_steady_tick(Duration::from_millis(100));
        bar.set_message("waiting");
        BuildProgress { console, bar, stage: None }
    }

    pub(crate) fn event(&mut self, event: &Event) {
        let Event::Stage { stage, progress } = event else { return };
        if self.stage.as_ref() != Some(stage) {
            self.end_stage();
            self.stage = Some(stage.clone());
            self.bar.set_message(stage.clone());
        }
        self.bar.set_position((progress.clamp(0.0, 1.0) * RESOLUTION as f64) as u64);
    }

    fn end_stage(&mut self) {
        if let Some(stage) = self.stage.take() {
            let line = format!("  {stage:14} done");
            self.bar.suspend(|| self.console.line(&line));
        }
    }

    pub(crate) fn finish(mut self) {
        self.end_stage();
        self.bar.finish_and_clear();
    }
}
