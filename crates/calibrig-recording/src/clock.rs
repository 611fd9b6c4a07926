//! Simulated time of a recording. It never runs backwards.

use calibrig_model::measurement::Observation;
use calibrig_model::measurement::SetKind;

pub(super) const SECOND: u64 = 1_000_000_000;
/// Pause between two sets whose own times do not follow one another.
const PAUSE: u64 = 10 * SECOND;

/// Gives every observation its time: its own if that is later than the one before, else one second a pose.
#[derive(Debug, Default)]
pub(super) struct Clock {
    /// Set, pose and time (ns) of the observation before.
    last: Option<(SetKind, u32, u64)>,
    /// How far the set's own times are shifted, ns.
    shift: u64,
}

impl Clock {
    /// The time of the next observation, ns.
    pub(super) fn time_of(&mut self, kind: SetKind, observation: &Observation) -> u64 {
        let own = own_time(observation.time);
        let moved = own.map(|own| own.saturating_add(self.shift));
        let time = match (self.last, moved) {
            (None, moved) => moved.unwrap_or(0),
            (Some((_, _, last)), Some(time)) if time > last => time,
            (Some((set, _, last)), _) if set != kind => {
                let time = last.saturating_add(PAUSE);
                // The rest of the set follows with its own intervals.
                self.shift = own.map_or(self.shift, |own| time - own.min(time));
                time
            }
            (Some((_, pose, last)), _) if pose == observation.pose => last,
            (Some((_, _, last)), _) => last.saturating_add(SECOND),
        };
        self.last = Some((kind, observation.pose, time));
        time
    }

    /// The time of the last observation, ns.
    pub(super) fn now(&self) -> u64 {
        self.last.map_or(0, |(_, _, time)| time)
    }
}

/// A time in s as whole ns, if a recording can hold it: viewers hold whole seconds in 32 bits.
fn own_time(seconds: f64) -> Option<u64> {
    // In range by the test.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    (0.0..4e9).contains(&seconds).then(|| (seconds * 1e9).round() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    /// Times in s, given as (set, pose, own time in s).
    fn times(observations: &[(SetKind, u32, f64)]) -> Vec<f64> {
        let outcome = synthetic::outcome(1, 0, false);
        let mut clock = Clock::default();
        let mut told = Vec::new();
        for &(kind, pose, time) in observations {
            let observation =
                Observation { pose, time, ..outcome.sets[0].measurements.observations[0].clone() };
            told.push((clock.time_of(kind, &observation) / 1_000_000) as f64 / 1e3);
        }
        told
    }

    #[test]
    fn times_are_the_observations_own_where_they_increase() {
        use SetKind::{Identification as I, Verification as V};
        assert_eq!(times(&[(I, 0, 0.0), (I, 1, 2.5), (I, 2, 9.0)]), [0.0, 2.5, 9.0]);
        // Two targets at one pose.
        assert_eq!(times(&[(I, 0, 1.0), (I, 0, 1.0), (I, 0, 1.5)]), [1.0, 1.0, 1.5]);
        // A set that goes on, and one that starts at zero again: it is moved behind the first, intervals and all.
        assert_eq!(times(&[(I, 0, 5.0), (V, 0, 6.0)]), [5.0, 6.0]);
        assert_eq!(times(&[(I, 0, 5.0), (V, 0, 0.0), (V, 1, 4.0)]), [5.0, 15.0, 19.0]);
    }

    #[test]
    fn times_that_make_no_sense_become_a_second_a_pose() {
        use SetKind::Identification as I;
        for bad in [f64::NAN, -1.0, 1e300, f64::INFINITY, 3.0] {
            assert_eq!(
                times(&[(I, 0, 2.0), (I, 1, 7.0), (I, 2, bad), (I, 3, bad)]),
                [2.0, 7.0, 8.0, 9.0],
                "{bad}"
            );
            assert_eq!(times(&[(I, 0, 7.0), (I, 0, bad)]), [7.0, 7.0], "{bad}");
        }
        assert_eq!(times(&[(I, 0, 0.0), (I, 1, 0.0), (I, 2, 0.0)]), [0.0, 1.0, 2.0]);
    }
}
