//! Edits that arrive by the clock.

use crate::{Door, Failure, Options, body};
use hdrhistogram::Histogram;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use sutura_client::Error;
use sutura_client::proto::session::SessionInfo;
use tokio::task::JoinSet;
use tokio::time::Instant;

/// Longest latency told apart, in µs.
const MAX_MICROS: u64 = 600_000_000;

/// A histogram of times in µs.
pub(crate) fn histogram() -> Result<Histogram<u64>, Failure> {
    Ok(Histogram::new_with_bounds(1, MAX_MICROS, 3)?)
}

pub(crate) fn record(histogram: &mut Histogram<u64>, time: Duration) {
    let micros = u64::try_from(time.as_micros()).unwrap_or(MAX_MICROS);
    histogram.saturating_record(micros.max(1));
}

/// One answer.
pub(crate) struct Answer {
    /// When it was due to be sent, after the start.
    pub(crate) due_s: f64,
    /// From then to its end.
    pub(crate) latency_s: f64,
    pub(crate) is_made: bool,
}

/// What became of the edits of all sessions.
pub(crate) struct Counts {
    pub(crate) n_sent: u64,
    /// From when they were due until they were acknowledged, by door.
    pub(crate) latency: BTreeMap<&'static str, Histogram<u64>>,
    /// Refusals and failures, by status and kind.
    pub(crate) errors: BTreeMap<String, u64>,
    /// Time until a refusal.
    pub(crate) refusal: Histogram<u64>,
    pub(crate) answers: Vec<Answer>,
}

impl Counts {
    pub(crate) fn new() -> Result<Counts, Failure> {
        let latency = [("http", histogram()?), ("zenoh", histogram()?)].into_iter().collect();
        Ok(Counts {
            n_sent: 0,
            latency,
            errors: BTreeMap::new(),
            refusal: histogram()?,
            answers: Vec::new(),
        })
    }
}

/// What became of the edits of one session.
#[derive(Default)]
pub(crate) struct Edited {
    n_acknowledged: u64,
    newest: u64,
    /// Whether some went unanswered: they may have been made or not.
    is_unsure: bool,
}

impl Edited {
    /// Acknowledged edits that the session does not show.
    pub(crate) fn lost(&self, info: &SessionInfo, options: &Options) -> u64 {
        let n_missing = self.newest.max(self.n_acknowledged).saturating_sub(info.generation);
        // Every edit leaves as many stitches.
        let is_other = self.n_acknowledged > 0 && info.n_stitches != options.pairs;
        let is_more = !self.is_unsure
            && options.deadline_ms.is_none()
            && info.generation != self.n_acknowledged;
        n_missing + u64::from(is_other) + u64::from(is_more)
    }
}

/// Edits a session at every multiple of the period after `first`, until `end`; waits for the answers.
pub(crate) async fn edit(
    door: Door,
    options: Options,
    [start, first, end]: [Instant; 3],
    counts: Arc<Mutex<Counts>>,
) -> Result<Edited, Failure> {
    let mut answers = JoinSet::new();
    for number in 0.. {
        let due = first + Duration::from_secs_f64(number as f64 / options.edit_hz);
        if due >= end {
            break;
        }
        let request = body::edit(&options, number)?;
        tokio::time::sleep_until(due).await;
        let door = door.clone();
        answers.spawn(async move {
            let outcome = match &door {
                Door::Http(session) => session.edit(&request).await,
                Door::Zenoh(session) => session.edit(&request).await,
            };
            (due, due.elapsed(), outcome)
        });
    }
    let mut edited = Edited::default();
    while let Some(answer) = answers.join_next().await {
        let (due, latency, outcome) = answer?;
        let mut counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
        counts.n_sent += 1;
        counts.answers.push(Answer {
            due_s: (due - start).as_secs_f64(),
            latency_s: latency.as_secs_f64(),
            is_made: outcome.is_ok(),
        });
        match outcome {
            Ok(reply) => {
                edited.n_acknowledged += 1;
                edited.newest = edited.newest.max(reply.generation);
                if let Some(histogram) = counts.latency.get_mut(door.name()) {
                    record(histogram, latency);
                }
            }
            Err(error) => {
                edited.is_unsure |= error.problem().is_none();
                *counts.errors.entry(kind(&error)).or_default() += 1;
                record(&mut counts.refusal, latency);
            }
        }
    }
    Ok(edited)
}

fn kind(error: &Error) -> String {
    match error.problem() {
        Some(problem) => format!("{} {}", problem.status, problem.title),
        None => error.to_string().chars().take(80).collect(),
    }
}
