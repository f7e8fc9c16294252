//! What the load came to.

use crate::Options;
use crate::arrivals::{Answer, Counts};
use crate::daemon::Sample;
use crate::states::States;
use hdrhistogram::Histogram;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// A distribution of times, in ms.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Times {
    pub(crate) n: u64,
    pub(crate) p50_ms: f64,
    pub(crate) p95_ms: f64,
    pub(crate) p99_ms: f64,
    pub(crate) max_ms: f64,
}

impl Times {
    pub(crate) fn of(histogram: &Histogram<u64>) -> Times {
        let ms = |micros: u64| micros as f64 / 1e3;
        let at = |quantile: f64| ms(histogram.value_at_quantile(quantile));
        let (p50_ms, p95_ms, p99_ms) = (at(0.5), at(0.95), at(0.99));
        Times { n: histogram.len(), p50_ms, p95_ms, p99_ms, max_ms: ms(histogram.max()) }
    }
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Times { n, p50_ms, p95_ms, p99_ms, max_ms } = self;
        write!(f, "{n:7} p50 {p50_ms:8.1} p95 {p95_ms:8.1} p99 {p99_ms:8.1} max {max_ms:8.1} ms")
    }
}

/// The whole in a few numbers.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Summary {
    pub(crate) n_sent: u64,
    pub(crate) n_acknowledged: u64,
    /// Acknowledged edits that their session does not show afterwards.
    pub(crate) n_lost: u64,
    /// Acknowledged, a second.
    pub(crate) edits_per_s: f64,
    pub(crate) n_steps: f64,
    pub(crate) n_late_steps: f64,
    /// Resident memory at the end over that after the first third.
    pub(crate) memory_growth: Option<f64>,
}

/// One second of the load.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Second {
    pub(crate) median_ms: f64,
    pub(crate) max_ms: f64,
    pub(crate) n_made: u32,
    pub(crate) n_refused: u32,
}

/// Everything that is written down.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub(crate) options: Options,
    pub(crate) summary: Summary,
    /// From when an edit was due until it was acknowledged, by door.
    pub(crate) edits: BTreeMap<&'static str, Times>,
    pub(crate) refusals: Times,
    pub(crate) errors: BTreeMap<String, u64>,
    pub(crate) n_states: u64,
    pub(crate) n_lost_states: u64,
    pub(crate) n_late_states: u64,
    pub(crate) state_gaps: Times,
    /// By the second in which edits were due.
    pub(crate) seconds: Vec<Second>,
    pub(crate) samples: Vec<Sample>,
}

impl Report {
    pub(crate) fn new(
        options: &Options,
        counts: &Counts,
        states: &States,
        samples: Vec<Sample>,
        n_lost: u64,
    ) -> Report {
        let n_acknowledged = counts.latency.values().map(Histogram::len).sum();
        let grown = |name: &str| {
            let value = |sample: Option<&Sample>| sample.map_or(0.0, |s| s.values[name]);
            value(samples.last()) - value(samples.first())
        };
        let memory: Vec<f64> =
            samples.iter().map(|s| s.values["process_resident_memory_bytes"]).collect();
        let warm = memory.get(memory.len() / 3).copied().filter(|bytes| *bytes > 0.0);
        let summary = Summary {
            n_sent: counts.n_sent,
            n_acknowledged,
            n_lost,
            edits_per_s: n_acknowledged as f64 / options.seconds,
            n_steps: grown("sutura_steps_total"),
            n_late_steps: grown("sutura_steps_late_total"),
            memory_growth: warm.zip(memory.last()).map(|(warm, last)| last / warm),
        };
        Report {
            options: options.clone(),
            summary,
            edits: counts.latency.iter().map(|(door, h)| (*door, Times::of(h))).collect(),
            refusals: Times::of(&counts.refusal),
            errors: counts.errors.clone(),
            n_states: states.n_received,
            n_lost_states: states.n_lost,
            n_late_states: states.n_late,
            state_gaps: Times::of(&states.gap),
            seconds: seconds(&counts.answers),
            samples,
        }
    }
}

fn seconds(answers: &[Answer]) -> Vec<Second> {
    let mut latencies: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    let n = answers.iter().map(|answer| answer.due_s as usize + 1).max().unwrap_or(0);
    let mut seconds = vec![Second::default(); n];
    for answer in answers {
        let second = answer.due_s as usize;
        if answer.is_made {
            seconds[second].n_made += 1;
            latencies.entry(second).or_default().push(answer.latency_s * 1e3);
        } else {
            seconds[second].n_refused += 1;
        }
    }
    for (second, mut made) in latencies {
        made.sort_by(f64::total_cmp);
        seconds[second].median_ms = made[made.len() / 2];
        seconds[second].max_ms = made[made.len() - 1];
    }
    seconds
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Summary { n_sent, n_acknowledged, n_lost, edits_per_s, .. } = &self.summary;
        writeln!(
            f,
            "edits: {n_sent} sent, {n_acknowledged} acknowledged ({edits_per_s:.1}/s), {n_lost} lost"
        )?;
        for (door, times) in &self.edits {
            writeln!(f, "  {door:9} {times}")?;
        }
        writeln!(f, "  refused   {}", self.refusals)?;
        for (kind, n) in &self.errors {
            writeln!(f, "  {n:7} {kind}")?;
        }
        writeln!(
            f,
            "states: {} received, {} lost, {} late",
            self.n_states, self.n_lost_states, self.n_late_states
        )?;
        writeln!(f, "  gaps      {}", self.state_gaps)?;
        let Summary { n_steps, n_late_steps, memory_growth, .. } = &self.summary;
        write!(f, "steps: {n_steps} taken, {n_late_steps} left out")?;
        if let Some(growth) = memory_growth {
            write!(f, "\nmemory at the end over that after a third: {growth:.3}")?;
        }
        Ok(())
    }
}
