//! The process that watches the simulation: receives states over Zenoh, reconstructs u = U q, and
//! measures what an edit in mid-motion does to the displacement field.
//!
//! It speaks JSON on standard output, one [`Message`] a line.

use super::error::{DemoError, Doing};
use serde::{Deserialize, Serialize};
use std::time::Duration;
use sutura_client::proto::state::StateFrame;
use sutura_client::{BusSession, Tracker, ZenohClient};

/// Frames that are watched after the edit has taken effect.
const N_FRAMES_AFTER_SWITCH: usize = 100;
/// Frames between two words to the parent process.
const N_FRAMES_BETWEEN_WORDS: usize = 50;
/// A simulation that is silent for so long has stopped.
const MAX_SILENCE: Duration = Duration::from_secs(30);

/// What to watch.
#[derive(clap::Args, Debug)]
pub(crate) struct SubscriberArgs {
    /// The daemon's Zenoh endpoint
    #[arg(long)]
    pub(crate) zenoh: String,
    /// The session
    #[arg(long)]
    pub(crate) session: String,
    /// How many frames to receive at least
    #[arg(long)]
    pub(crate) n_frames: usize,
}

/// A line on standard output.
#[derive(Debug, Serialize, Deserialize)]
#[serde(tag = "message", rename_all = "snake_case")]
pub(crate) enum Message {
    /// Subscribed, and the basis is here.
    Ready,
    /// So many frames have arrived.
    Received { n_frames: usize },
    /// The end.
    Report(MotionReport),
}

/// What was seen.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct MotionReport {
    /// States received and turned into displacements.
    pub(crate) n_frames: usize,
    /// States that were published but never arrived.
    pub(crate) n_lost: u64,
    /// Simulated time between the first and the last of them, in s.
    pub(crate) duration_s: f64,
    /// The state in which the body was furthest from rest before the edit.
    pub(crate) furthest: Furthest,
    pub(crate) switch: SwitchReport,
}

/// A state worth a picture.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Furthest {
    pub(crate) generation: u64,
    pub(crate) time_s: f64,
    pub(crate) max_displacement_m: f64,
    pub(crate) q: Vec<f32>,
}

impl Furthest {
    /// At rest.
    pub(crate) fn rest() -> Furthest {
        Furthest { generation: 0, time_s: 0.0, max_displacement_m: 0.0, q: Vec::new() }
    }

    /// Takes `state` over if it is further from rest.
    pub(crate) fn update(&mut self, state: &StateFrame, displacement: &[f32]) {
        let max_displacement_m = largest(displacement);
        if max_displacement_m > self.max_displacement_m {
            *self = Furthest {
                generation: state.generation,
                time_s: state.time_s,
                max_displacement_m,
                q: state.q.clone(),
            };
        }
    }
}

/// How the body crossed from one generation to the next.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct SwitchReport {
    pub(crate) from_generation: u64,
    pub(crate) to_generation: u64,
    /// Simulated time of the last state before and of the first one after, in s. A daemon publishes
    /// the state in which it goes over twice, in either basis: then they are the same.
    pub(crate) times_s: [f64; 2],
    /// Largest displacement of the last state before, in m.
    pub(crate) max_displacement_m: f64,
    /// Largest difference over the vertices between U q of the first state after and U q before,
    /// continued to the same time should one of the two states be lost; relative to
    /// `max_displacement_m`.
    pub(crate) jump: f64,
}

impl SwitchReport {
    /// Both states of the moment of the switch arrived, so that the jump is one and no estimate.
    pub(crate) fn is_seen(&self) -> bool {
        self.times_s[0] == self.times_s[1]
    }
}

/// Watches until enough has been seen.
pub(crate) async fn run(args: &SubscriberArgs) -> Result<(), DemoError> {
    let client = ZenohClient::open(&args.zenoh).await.doing("joining the daemon's Zenoh")?;
    let session = client.session(&args.session).doing("naming the session")?;
    let mut states = session.states().await.doing("subscribing to the states")?;
    let tracker = Tracker::new(session).await.doing("fetching the basis")?;
    say(&Message::Ready);
    let mut watch = Watch::new(tracker);
    while !watch.is_done(args.n_frames) {
        let next = tokio::time::timeout(MAX_SILENCE, states.next()).await;
        let state = next.map_err(|_| {
            let silence = MAX_SILENCE.as_secs();
            DemoError::Unexpected(format!("no state was published for {silence} s"))
        })?;
        let Some(state) = state.doing("receiving a state")? else { break };
        watch.see(state).await?;
        if watch.n_frames.is_multiple_of(N_FRAMES_BETWEEN_WORDS) {
            say(&Message::Received { n_frames: watch.n_frames });
        }
    }
    say(&Message::Report(watch.into_report()?));
    client.close().await.doing("leaving Zenoh")
}

fn say(message: &Message) {
    // Serializing these cannot fail: no map keys, and what is not finite becomes null.
    if let Ok(line) = serde_json::to_string(message) {
        println!("{line}");
    }
}

/// A state as a displacement field.
struct Moment {
    time_s: f64,
    displacement: Vec<f32>,
}

struct Watch {
    tracker: Tracker<BusSession>,
    n_frames: usize,
    n_lost: u64,
    first_time_s: f64,
    last_sequence: u64,
    /// The last three states of the current generation, the oldest first.
    recent: Vec<Moment>,
    furthest: Furthest,
    switch: Option<SwitchReport>,
    n_frames_at_switch: usize,
}

impl Watch {
    fn new(tracker: Tracker<BusSession>) -> Watch {
        Watch {
            tracker,
            n_frames: 0,
            n_lost: 0,
            first_time_s: 0.0,
            last_sequence: 0,
            recent: Vec::new(),
            furthest: Furthest::rest(),
            switch: None,
            n_frames_at_switch: 0,
        }
    }

    fn is_done(&self, n_frames: usize) -> bool {
        self.n_frames >= n_frames
            && self.switch.is_some()
            && self.n_frames >= self.n_frames_at_switch + N_FRAMES_AFTER_SWITCH
    }

    async fn see(&mut self, state: StateFrame) -> Result<(), DemoError> {
        if self.n_frames == 0 {
            self.first_time_s = state.time_s;
        } else {
            self.n_lost += state.sequence.saturating_sub(self.last_sequence + 1);
        }
        self.last_sequence = state.sequence;
        let from_generation = self.tracker.generation();
        let displacement =
            self.tracker.displacement(&state).await.doing("reconstructing u = U q")?;
        if state.generation != from_generation {
            self.switch = self.compare(&state, from_generation, &displacement);
            self.n_frames_at_switch = self.n_frames;
            self.recent.clear();
        } else if self.switch.is_none() {
            self.furthest.update(&state, &displacement);
        }
        if self.recent.last().is_some_and(|last| last.time_s == state.time_s) {
            self.recent.pop();
        } else if self.recent.len() == 3 {
            self.recent.remove(0);
        }
        self.recent.push(Moment { time_s: state.time_s, displacement });
        self.n_frames += 1;
        Ok(())
    }

    /// Holds the first state of a new generation against the states before it.
    fn compare(
        &self,
        state: &StateFrame,
        from_generation: u64,
        displacement: &[f32],
    ) -> Option<SwitchReport> {
        let last = self.recent.last()?;
        let heading = extrapolate(&self.recent, state.time_s)?;
        let max_displacement_m = largest(&last.displacement);
        Some(SwitchReport {
            from_generation,
            to_generation: state.generation,
            times_s: [last.time_s, state.time_s],
            max_displacement_m,
            jump: largest_difference(&heading, displacement) / max_displacement_m,
        })
    }

    fn into_report(self) -> Result<MotionReport, DemoError> {
        let switch = self.switch.ok_or_else(|| {
            DemoError::Unexpected("the simulation never went over to the edited body".to_owned())
        })?;
        Ok(MotionReport {
            n_frames: self.n_frames,
            n_lost: self.n_lost,
            duration_s: self.recent.last().map_or(0.0, |last| last.time_s - self.first_time_s),
            furthest: self.furthest,
            switch,
        })
    }
}

/// Where three states are heading at `time_s`, by the parabola through them.
fn extrapolate(recent: &[Moment], time_s: f64) -> Option<Vec<f32>> {
    let [a, b, c] = recent else { return None };
    let weight = |of: &Moment, other: &Moment, another: &Moment| {
        ((time_s - other.time_s) * (time_s - another.time_s)
            / ((of.time_s - other.time_s) * (of.time_s - another.time_s))) as f32
    };
    // At the time of the last state this is exactly that state.
    let [wa, wb, wc] = [weight(a, b, c), weight(b, a, c), weight(c, a, b)];
    let fields = a.displacement.iter().zip(&b.displacement).zip(&c.displacement);
    Some(fields.map(|((a, b), c)| wa * a + wb * b + wc * c).collect())
}

/// The largest displacement of any vertex; not a number if one of them is not.
pub(crate) fn largest(displacement: &[f32]) -> f64 {
    let norm = |u: &[f32]| u.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
    let norms = displacement.chunks_exact(3).map(norm);
    norms.fold(0.0, |largest, norm| if norm > largest || norm.is_nan() { norm } else { largest })
}

fn largest_difference(a: &[f32], b: &[f32]) -> f64 {
    let difference: Vec<f32> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    largest(&difference)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_continued_exactly() {
        let x = |t: f64| (1.0 - 2.0 * t + 3.0 * t * t) as f32;
        let moment = |time_s| Moment { time_s, displacement: vec![x(time_s), 0.0, -x(time_s)] };
        let recent = [0.0, 0.1, 0.25].map(moment);
        let heading = extrapolate(&recent, 0.4).unwrap();
        assert!(largest_difference(&heading, &[x(0.4), 0.0, -x(0.4)]) < 1e-6);
        assert!(extrapolate(&recent[..2], 0.4).is_none());
    }

    #[test]
    fn the_largest_displacement_is_a_vector_length() {
        assert_eq!(largest(&[0.0, 0.0, 1.0, 3.0, 0.0, -4.0]), 5.0);
        assert!(largest(&[0.0, 0.0, 1.0, f32::NAN, 0.0, 0.0, 3.0, 0.0, -4.0]).is_nan());
    }
}
