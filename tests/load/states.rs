//! Published states, as a client sees them.

use crate::arrivals::{histogram, record};
use crate::{Door, Failure};
use hdrhistogram::Histogram;
use std::pin::pin;
use std::time::Duration;
use tokio::time::Instant;

/// The states of one session, or of all.
pub(crate) struct States {
    pub(crate) n_received: u64,
    /// Published states that never came.
    pub(crate) n_lost: u64,
    /// States that came more than a period after they should have.
    pub(crate) n_late: u64,
    /// Between two that follow each other.
    pub(crate) gap: Histogram<u64>,
}

impl States {
    pub(crate) fn new() -> Result<States, Failure> {
        Ok(States { n_received: 0, n_lost: 0, n_late: 0, gap: histogram()? })
    }

    pub(crate) fn add(&mut self, other: &States) -> Result<(), Failure> {
        self.n_received += other.n_received;
        self.n_lost += other.n_lost;
        self.n_late += other.n_late;
        self.gap.add(&other.gap)?;
        Ok(())
    }
}

/// Follows a session's states until `end` is ready.
pub(crate) async fn follow(
    door: Door,
    publish_hz: f64,
    end: impl Future<Output = ()> + Send,
) -> Result<States, Failure> {
    let mut end = pin!(end);
    let mut stream = match &door {
        Door::Http(session) => session.states().await?,
        Door::Zenoh(session) => session.states().await?,
    };
    let mut states = States::new()?;
    let mut last: Option<(u64, Instant)> = None;
    loop {
        let next = tokio::select! {
            next = stream.next() => next?,
            () = end.as_mut() => break,
        };
        let Some(state) = next else { break };
        let now = Instant::now();
        states.n_received += 1;
        if let Some((sequence, at)) = last {
            states.n_lost += state.sequence.saturating_sub(sequence + 1);
            let gap = now - at;
            record(&mut states.gap, gap);
            states.n_late += u64::from(gap > Duration::from_secs_f64(2.0 / publish_hz));
        }
        last = Some((state.sequence, now));
    }
    Ok(states)
}
