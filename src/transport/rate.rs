//! How often a tenant may ask: the generic cell rate algorithm (ITU-T I.371), a token bucket that keeps
//! one instant for each tenant.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A rate and how far it may be run ahead of.
#[derive(Clone, Copy, Debug)]
struct Rate {
    /// Between two requests that come as fast as they may for ever.
    interval: Duration,
    /// How far ahead of that a tenant may be.
    burst: Duration,
}

/// The requests of each tenant, and of all those without one together.
#[derive(Debug)]
pub(crate) struct Rates {
    rate: Rate,
    /// When each tenant's requests so far would have come at the rate. One that lies in the past says
    /// nothing, so there are never many.
    due: Mutex<BTreeMap<Option<Arc<str>>, Instant>>,
}

/// Longest time between two requests: rates below one in a day are taken for that.
const MAX_INTERVAL: Duration = Duration::from_secs(24 * 3600);

/// Tenants above which those that have nothing outstanding are forgotten.
const MANY_TENANTS: usize = 1024;

impl Rates {
    /// At most `per_s` requests a second in the long run and `burst` at once, from each tenant.
    pub(crate) fn new(per_s: f64, burst: usize) -> Rates {
        let interval = Duration::try_from_secs_f64(1.0 / per_s).unwrap_or(MAX_INTERVAL);
        let interval = interval.min(MAX_INTERVAL);
        let n_ahead = u32::try_from(burst.saturating_sub(1)).unwrap_or(u32::MAX);
        Rates {
            rate: Rate { interval, burst: interval.saturating_mul(n_ahead) },
            due: Mutex::default(),
        }
    }

    /// Counts a request of `tenant`; or tells after how long it would be let in.
    pub(crate) fn take(&self, tenant: Option<&Arc<str>>, now: Instant) -> Result<(), Duration> {
        let Rate { interval, burst } = self.rate;
        let mut due = self.due.lock().unwrap_or_else(PoisonError::into_inner);
        if due.len() > MANY_TENANTS {
            due.retain(|_, due| *due > now);
        }
        let due = due.entry(tenant.cloned()).or_insert(now);
        let ahead = due.saturating_duration_since(now);
        if ahead > burst {
            return Err(ahead - burst);
        }
        *due = now + ahead + interval;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_let_in_and_then_the_rate() {
        let rates = Rates::new(10.0, 3);
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let take = |ms| rates.take(None, at(ms)).map_err(|wait| wait.as_millis());
        assert_eq!([take(0), take(0), take(0)], [Ok(()); 3]);
        assert_eq!(take(0), Err(100));
        // Being refused costs nothing.
        assert_eq!(take(40), Err(60));
        assert_eq!((take(100), take(100)), (Ok(()), Err(100)));
        // A long silence saves up one burst and no more.
        assert_eq!([take(9000), take(9000), take(9000)], [Ok(()); 3]);
        assert_eq!(take(9000), Err(100));
    }

    #[test]
    fn a_rate_of_next_to_nothing_is_one_a_day() {
        let now = Instant::now();
        for per_s in [f64::MIN_POSITIVE, 1e-30, 1e-6] {
            let rates = Rates::new(per_s, 1);
            assert!(rates.take(None, now).is_ok());
            assert_eq!(rates.take(None, now), Err(MAX_INTERVAL));
        }
    }

    #[test]
    fn tenants_do_not_pay_for_each_other() {
        let rates = Rates::new(1.0, 1);
        let now = Instant::now();
        let (a, b): (Arc<str>, Arc<str>) = ("a".into(), "b".into());
        assert!(rates.take(Some(&a), now).is_ok());
        assert!(rates.take(Some(&a), now).is_err());
        assert!(rates.take(Some(&b), now).is_ok());
        assert!(rates.take(None, now).is_ok());
        assert!(rates.take(None, now).is_err());
    }

    #[test]
    fn tenants_with_nothing_outstanding_are_forgotten() {
        let rates = Rates::new(1000.0, 1);
        let start = Instant::now();
        for i in 0..5000u32 {
            let tenant: Arc<str> = i.to_string().into();
            rates.take(Some(&tenant), start + Duration::from_millis(u64::from(i))).unwrap();
        }
        assert!(rates.due.lock().unwrap().len() <= MANY_TENANTS + 1);
    }
}
