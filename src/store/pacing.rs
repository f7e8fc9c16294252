//! When a simulation steps and which steps it publishes. Pure: the clock is a parameter.

use std::time::Duration;

/// A step is due at every multiple of the period after the start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    due: Duration,
    period: Duration,
}

impl Pace {
    /// The first step is due at `start`.
    pub(crate) fn new(start: Duration, dt_s: f64) -> Self {
        Self { due: start, period: period(dt_s) }
    }

    /// When the next step is due.
    pub(crate) fn due(&self) -> Duration {
        self.due
    }

    /// Changes the period from the step after the next on.
    pub(crate) fn set_period(&mut self, dt_s: f64) {
        self.period = period(dt_s);
    }

    /// Begins the step that is due and plans the next one. Returns how many whole periods it comes
    /// too late: so many steps are left out.
    pub(crate) fn begin_step(&mut self, now: Duration) -> u64 {
        let late = now.saturating_sub(self.due);
        let n_late = (late.as_nanos() / self.period.as_nanos()) as u64;
        let advance_ns = (self.period.as_nanos() as u64).saturating_mul(n_late.saturating_add(1));
        self.due += Duration::from_nanos(advance_ns);
        n_late
    }
}

fn period(dt_s: f64) -> Duration {
    Duration::from_nanos(((dt_s * 1e9).round() as u64).max(1))
}

/// Chooses the steps to publish, evenly.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PublishRate {
    phase: f64,
}

impl PublishRate {
    /// Whether a step of `dt_s` is one to publish at `publish_hz`.
    pub(crate) fn is_due(&mut self, dt_s: f64, publish_hz: f64) -> bool {
        self.phase += dt_s * publish_hz;
        // Rounding must not delay a frame by a whole step.
        let due = self.phase >= 1.0 - 1e-9;
        if due {
            self.phase = (self.phase - 1.0).max(0.0).fract();
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(count: u64) -> Duration {
        Duration::from_millis(count)
    }

    #[test]
    fn steps_in_time_do_not_drift() {
        let mut pace = Pace::new(ms(100), 0.01);
        for step in 0..1000 {
            assert_eq!(pace.due(), ms(100 + 10 * step));
            // Up to just under a period late: still this step.
            assert_eq!(pace.begin_step(pace.due() + Duration::from_micros(9_999)), 0);
        }
    }

    #[test]
    fn missed_periods_are_left_out_and_counted() {
        let mut pace = Pace::new(ms(0), 0.01);
        assert_eq!(pace.begin_step(ms(35)), 3);
        assert_eq!(pace.due(), ms(40));
        assert_eq!(pace.begin_step(ms(50)), 1);
        assert_eq!(pace.due(), ms(60));
    }

    #[test]
    fn a_step_begun_early_is_not_late() {
        let mut pace = Pace::new(ms(10), 0.01);
        assert_eq!(pace.begin_step(ms(3)), 0);
        assert_eq!(pace.due(), ms(20));
    }

    #[test]
    fn a_new_period_applies_after_the_planned_step() {
        let mut pace = Pace::new(ms(0), 0.01);
        pace.begin_step(ms(0));
        pace.set_period(0.002);
        assert_eq!(pace.due(), ms(10));
        pace.begin_step(ms(10));
        assert_eq!(pace.due(), ms(12));
    }

    #[test]
    fn frames_are_spread_evenly() {
        let published = |dt_s, publish_hz, n_steps| {
            let mut rate = PublishRate::default();
            (0..n_steps).filter(|_| rate.is_due(dt_s, publish_hz)).count()
        };
        assert_eq!(published(0.01, 100.0, 1000), 1000);
        assert_eq!(published(0.01, 50.0, 1000), 500);
        assert_eq!(published(0.001, 60.0, 1000), 60);
        // Not more than one a step.
        assert_eq!(published(0.01, 1000.0, 1000), 1000);
    }
}
