//! The store's side of a computation in the core: cancellation, progress and the clock.

use crate::live::LiveSession;
use crate::pool::CancelFlag;
use crate::session::Progress;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use sutura_core::control::{Control, Stage};
use tracing::Span;

/// Given to the core for one task.
pub(crate) struct TaskControl<'a> {
    cancel: &'a CancelFlag,
    begin: Instant,
    reporter: Option<Reporter<'a>>,
    /// Whether there is room for so many bytes.
    admits: Option<&'a (dyn Fn(usize) -> bool + Sync)>,
}

/// Passes progress on to a session: each change of stage, and within a stage not more often than
/// `interval`.
struct Reporter<'a> {
    session: &'a LiveSession,
    interval: Duration,
    last: Mutex<Option<(Stage, Instant)>>,
    stages: StageSpans,
}

/// A span for each stage, within the one in which the task began. Stages are known as they end, so the span under
/// way gets its name then; what follows the last one is the rest.
struct StageSpans {
    task: Span,
    current: Mutex<Span>,
}

impl<'a> TaskControl<'a> {
    /// Reports no progress.
    pub(crate) fn silent(cancel: &'a CancelFlag) -> Self {
        Self { cancel, begin: Instant::now(), reporter: None, admits: None }
    }

    /// Reports progress to `session`.
    pub(crate) fn reporting(
        cancel: &'a CancelFlag,
        session: &'a LiveSession,
        interval: Duration,
    ) -> Self {
        let stages = StageSpans::begin();
        let reporter = Some(Reporter { session, interval, last: Mutex::new(None), stages });
        Self { cancel, begin: Instant::now(), reporter, admits: None }
    }

    /// Asks `admits` whether there is room for so many bytes.
    pub(crate) fn within(self, admits: &'a (dyn Fn(usize) -> bool + Sync)) -> Self {
        Self { admits: Some(admits), ..self }
    }
}

impl Control for TaskControl<'_> {
    fn is_cancelled(&self) -> bool {
        self.cancel.is_set()
    }

    fn progress(&self, stage: Stage, fraction: f64) {
        if let Some(reporter) = &self.reporter
            && reporter.is_due(stage, Instant::now())
        {
            reporter.session.report(Progress { stage, fraction: fraction.clamp(0.0, 1.0) });
        }
    }

    fn ended(&self, stage: Stage) {
        if let Some(reporter) = &self.reporter {
            reporter.stages.ended(stage);
        }
        self.progress(stage, 1.0);
    }

    fn now(&self) -> Duration {
        self.begin.elapsed()
    }

    fn admits(&self, n_bytes: usize) -> bool {
        self.admits.is_none_or(|admits| admits(n_bytes))
    }
}

impl StageSpans {
    fn begin() -> StageSpans {
        let task = Span::current();
        StageSpans { current: Mutex::new(stage_within(&task)), task }
    }

    fn ended(&self, stage: Stage) {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        current.record("stage", stage.name());
        *current = stage_within(&self.task);
    }
}

impl Drop for StageSpans {
    fn drop(&mut self) {
        self.current.get_mut().unwrap_or_else(PoisonError::into_inner).record("stage", "rest");
    }
}

fn stage_within(task: &Span) -> Span {
    tracing::debug_span!(parent: task, "stage", stage = tracing::field::Empty)
}

impl Reporter<'_> {
    fn is_due(&self, stage: Stage, now: Instant) -> bool {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let due = match *last {
            Some((last_stage, at)) => {
                last_stage != stage || now.saturating_duration_since(at) >= self.interval
            }
            None => true,
        };
        if due {
            *last = Some((stage, now));
        }
        due
    }
}
