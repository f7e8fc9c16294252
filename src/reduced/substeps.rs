//! How a step is divided: into halves of halves, as failures and errors ask for.

/// A step is halved at most so many times.
const MOST_HALVINGS: u32 = 6;

/// Local errors of second order fall by eight when a substep is halved: one with less than this part of what is
/// allowed can be twice as long.
const COARSEN_BELOW: f64 = 1.0 / 16.0;

/// A step on its way: substeps are 2⁻ᵏ of it and begin at multiples of their length, so that they end where it does.
#[derive(Clone, Debug)]
pub(crate) struct Division {
    halvings: u32,
    /// What is done, in units of the shortest substep.
    done: u32,
    /// A substep could not be solved: the rest of the step is not tried with longer ones.
    is_hard: bool,
    has_failed: bool,
}

impl Division {
    pub(crate) fn begin(halvings: u32) -> Division {
        let halvings = halvings.min(MOST_HALVINGS);
        Division { halvings, done: 0, is_hard: false, has_failed: false }
    }

    fn length(halvings: u32) -> u32 {
        1 << (MOST_HALVINGS - halvings)
    }

    /// Length of the next substep as a part of the step; `None` at its end.
    pub(crate) fn next(&self) -> Option<f64> {
        let left = !self.has_failed && self.done < Division::length(0);
        left.then(|| 0.5f64.powi(self.halvings as i32))
    }

    /// Whether the substep counts: `error` is what it has wrong, relative to what is allowed, or none where it could
    /// not be solved. Otherwise a shorter one is next, as long as there is one; the shortest is taken as it is.
    pub(crate) fn accepts(&mut self, error: Option<f64>) -> bool {
        let is_shortest = self.halvings == MOST_HALVINGS;
        // An error that is no number forbids nothing: nothing moves.
        let error = error.map(|error| if error.is_nan() { 0.0 } else { error });
        if error.is_some_and(|error| is_shortest || error <= 1.0) {
            self.done += Division::length(self.halvings);
            let is_small = error.is_some_and(|error| error <= COARSEN_BELOW);
            if self.halvings > 0
                && is_small
                && !self.is_hard
                && self.done.is_multiple_of(Division::length(self.halvings - 1))
            {
                self.halvings -= 1;
            }
            return true;
        }
        self.is_hard |= error.is_none();
        self.has_failed = is_shortest;
        self.halvings = (self.halvings + 1).min(MOST_HALVINGS);
        false
    }

    /// The shortest substep could not be solved either.
    pub(crate) fn has_failed(&self) -> bool {
        self.has_failed
    }

    /// Of the next substep.
    pub(crate) fn halvings(&self) -> u32 {
        self.halvings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lengths of the substeps taken; `answer` tells the error of one from its beginning and length.
    fn run(halvings: u32, answer: impl Fn(f64, f64) -> Option<f64>) -> (Vec<f64>, Division) {
        let (mut division, mut taken) = (Division::begin(halvings), Vec::new());
        while let Some(share) = division.next() {
            if division.accepts(answer(taken.iter().sum(), share)) {
                taken.push(share);
            }
        }
        (taken, division)
    }

    #[test]
    fn substeps_fill_the_step_whatever_is_hard() {
        assert_eq!(run(0, |_, _| Some(0.0)).0, [1.0]);
        assert_eq!(run(2, |_, _| Some(0.5)).0, [0.25; 4]);
        // Longer again where little is wrong.
        assert_eq!(run(2, |_, _| Some(0.01)).0, [0.25, 0.25, 0.5]);
        // Too long from the middle on.
        let (taken, division) =
            run(0, |at, length| Some(if at + length > 0.5 { 16.0 * length } else { 0.2 }));
        assert_eq!(taken[0], 0.5);
        assert_eq!(taken[1..], [0.0625; 8]);
        assert_eq!(division.halvings(), 4);
        // What cannot be solved is not tried again with longer ones in the same step.
        let (taken, _) = run(0, |_, length| (length <= 0.125).then_some(0.0));
        assert_eq!(taken, [0.125; 8]);
    }

    #[test]
    fn the_shortest_substep_is_the_last_resort() {
        let (taken, division) = run(0, |_, _| Some(1e9));
        assert_eq!((taken.len(), division.has_failed()), (64, false));
        let (taken, division) = run(0, |at, length| (at + length <= 0.5).then_some(0.0));
        assert!(division.has_failed() && taken == [0.5]);
        assert_eq!(run(9, |_, _| Some(f64::NAN)).0.len(), 7);
    }
}
