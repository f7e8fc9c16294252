//! Names of everything the store measures, and the one way to record each.

use metrics::{
    Counter, Histogram, Unit, counter, describe_counter, describe_gauge, describe_histogram, gauge,
    histogram,
};
use std::time::Duration;

const TASK_WAIT: &str = "sutura_task_wait_seconds";
const TASK_RUN: &str = "sutura_task_run_seconds";
const STEPS: &str = "sutura_steps_total";
const STEPS_LATE: &str = "sutura_steps_late_total";
const STEP: &str = "sutura_step_seconds";
const STEP_DELAY: &str = "sutura_step_delay_seconds";
const JOURNAL_WRITE: &str = "sutura_journal_write_seconds";
const SHED: &str = "sutura_shed_total";
const BODIES: &str = "sutura_bodies_total";
const KEPT_BODIES: &str = "sutura_kept_body_bytes";

/// Says what each metric is, to the recorder of the process.
pub fn describe_metrics() {
    describe_histogram!(TASK_WAIT, Unit::Seconds, "Time that tasks waited for a thread, by kind");
    describe_histogram!(TASK_RUN, Unit::Seconds, "Time that tasks took once they ran, by kind");
    describe_counter!(STEPS, "Steps that simulations took");
    describe_counter!(STEPS_LATE, "Steps that were left out because their time had passed");
    describe_histogram!(STEP, Unit::Seconds, "Time that steps took");
    describe_histogram!(STEP_DELAY, Unit::Seconds, "How long after they were due steps began");
    describe_histogram!(JOURNAL_WRITE, Unit::Seconds, "Time until a record was on the disk");
    describe_counter!(SHED, "Requests refused because a limit was reached, by limit");
    describe_counter!(
        BODIES,
        "Bodies made, read from the storage, written there, and found damaged there, by event"
    );
    describe_gauge!(KEPT_BODIES, Unit::Bytes, "Prepared bodies in the storage");
}

/// A body was `made`, `read`, `written` or found `damaged`.
pub(crate) fn body(event: &'static str) {
    counter!(BODIES, "event" => event).increment(1);
}

/// Prepared bodies take up so much of the storage.
pub(crate) fn kept_bodies(n_bytes: u64) {
    gauge!(KEPT_BODIES).set(n_bytes as f64);
}

pub(crate) fn task_waited(kind: &'static str, waited: Duration) {
    histogram!(TASK_WAIT, "kind" => kind).record(waited);
}

pub(crate) fn task_ran(kind: &'static str, took: Duration) {
    histogram!(TASK_RUN, "kind" => kind).record(took);
}

pub(crate) fn shed(limit: &'static str) {
    counter!(SHED, "limit" => limit).increment(1);
}

pub(crate) fn journal_written(took: Duration) {
    histogram!(JOURNAL_WRITE).record(took);
}

/// What a stepping thread counts, at thousands a second: looked up once.
pub(crate) struct Steps {
    taken: Counter,
    late: Counter,
    took: Histogram,
    delay: Histogram,
}

impl Steps {
    pub(crate) fn new() -> Steps {
        Steps {
            taken: counter!(STEPS),
            late: counter!(STEPS_LATE),
            took: histogram!(STEP),
            delay: histogram!(STEP_DELAY),
        }
    }

    /// A step began `delay` after it was due, behind `n_late` that were left out, and took `took`.
    pub(crate) fn record(&self, n_late: u64, delay: Duration, took: Duration) {
        self.taken.increment(1);
        self.late.increment(n_late);
        self.took.record(took);
        self.delay.record(delay);
    }
}
