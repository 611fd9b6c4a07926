//! How a tracker moves on its stand during a session: as one rigid body.

use nalgebra::{Rotation3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal, UnitSphere};

use calibrig_model::geometry::Transform;
use calibrig_model::measurement::StatedDrift;

use super::TrackerError;

/// A motion of a given size: translation (m) and rotation (rad), each in a direction that is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// m
    pub shift: f64,
    /// rad
    pub turn: f64,
}

/// Sizes of a drift.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DriftLaw {
    /// Steady, per hour.
    pub ramp: Motion,
    /// Remaining warm-up when the session begins, least and most; drawn uniformly in between.
    pub warm_up: [Motion; 2],
    /// Time after which a share 1/e of the warm-up is left, s.
    pub warm_up_time: f64,
    /// RMS distance of a random walk after an hour; it grows with the root of the time.
    pub walk: Motion,
}

/// Seconds an hour.
const HOUR: f64 = 3600.0;

/// Time from one knot of the walk to the next, s; linear in between.
const STEP: f64 = 60.0;

/// The motion of one tracker in one session.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Drift {
    /// Per second.
    ramp: [Vector3<f64>; 2],
    warm_up: [Vector3<f64>; 2],
    warm_up_time: f64,
    /// At multiples of [`STEP`], from zero.
    walk: Vec<[Vector3<f64>; 2]>,
}

impl DriftLaw {
    /// Whether it is valid.
    pub fn check(&self) -> Result<(), TrackerError> {
        let sizes = [self.ramp, self.warm_up[0], self.warm_up[1], self.walk];
        for value in sizes.iter().flat_map(|motion| [motion.shift, motion.turn]) {
            if !(value >= 0.0 && value.is_finite()) {
                let (quantity, expected) = ("drift", "finite numbers of zero or more");
                return Err(TrackerError::Figure { quantity, value, expected });
            }
        }
        if !(self.warm_up_time > 0.0 && self.warm_up_time.is_finite()) {
            let (quantity, expected) = ("warm-up time in s", "a number above zero");
            return Err(TrackerError::Figure { quantity, value: self.warm_up_time, expected });
        }
        Ok(())
    }

    /// What an operator knows about it: the motion in an hour along and about one axis, as one standard deviation. It is stated as a steady motion,
    /// which is all that measurements of a robot alone can determine. `None` for a stand that does not move.
    pub fn stated(&self) -> Option<StatedDrift> {
        let [_, warm_up] = self.warm_up;
        let of = |size: fn(&Motion) -> f64| {
            let parts = [&self.ramp, &warm_up, &self.walk].map(|motion| size(motion).powi(2));
            (parts.iter().sum::<f64>() / 3.0).sqrt()
        };
        let stated = StatedDrift {
            motion_per_hour: of(|motion| motion.shift),
            turn_per_hour: of(|motion| motion.turn),
        };
        (stated.motion_per_hour > 0.0 || stated.turn_per_hour > 0.0).then_some(stated)
    }

    /// The drift of a session of this length (s). A longer session has the same drift, continued.
    ///
    /// Takes the same numbers from `rng` in the same order whatever the sizes are.
    pub fn draw(&self, duration: f64, rng: &mut impl Rng) -> Drift {
        let mut anywhere = || Vector3::from(UnitSphere.sample(rng));
        let directions: [[Vector3<f64>; 2]; 2] = std::array::from_fn(|_| [anywhere(), anywhere()]);
        let share = rand::RngExt::random::<f64>(rng);
        let between = |[least, most]: [f64; 2]| least + (most - least) * share;
        let [least, most] = self.warm_up;
        let [shift, turn] = [self.walk.shift, self.walk.turn].map(|size| size * (STEP / HOUR / 3.0).sqrt());
        let mut place = [Vector3::zeros(); 2];
        let mut walk = vec![place];
        let mut reached = 0.0;
        while reached < duration {
            let mut step = |size: f64| size * Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(rng) });
            place[0] += step(shift);
            place[1] += step(turn);
            walk.push(place);
            reached += STEP;
        }
        Drift {
            ramp: [self.ramp.shift / HOUR * directions[0][0], self.ramp.turn / HOUR * directions[0][1]],
            warm_up: [
                between([least.shift, most.shift]) * directions[1][0],
                between([least.turn, most.turn]) * directions[1][1],
            ],
            warm_up_time: self.warm_up_time,
            walk,
        }
    }
}

impl Drift {
    /// Whether the tracker stands still.
    pub fn is_none(&self) -> bool {
        self.walk.is_empty()
    }

    /// How far it has moved and turned at a time (s) since the session began: m and rad, along and about its own first axes. The walk ends with the session.
    pub fn motion(&self, time: f64) -> [Vector3<f64>; 2] {
        let warm = if self.warm_up_time > 0.0 { 1.0 - (-time / self.warm_up_time).exp() } else { 0.0 };
        let walked = self.walked(time);
        std::array::from_fn(|part| time * self.ramp[part] + warm * self.warm_up[part] + walked[part])
    }

    fn walked(&self, time: f64) -> [Vector3<f64>; 2] {
        let Some(last) = self.walk.len().checked_sub(1) else { return [Vector3::zeros(); 2] };
        let steps = (time / STEP).max(0.0);
        // A cast saturates: a time beyond the end, or NaN, is at an end.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let before = (steps as usize).min(last);
        let after = (before + 1).min(last);
        let share = (steps - before as f64).clamp(0.0, 1.0);
        std::array::from_fn(|part| {
            self.walk[before][part] + share * (self.walk[after][part] - self.walk[before][part])
        })
    }

    /// Coordinates in the tracker's axes at a time (s) of a point that has these in its first ones, m.
    pub(super) fn seen(&self, first: &Vector3<f64>, time: f64) -> Vector3<f64> {
        let [shift, turn] = self.motion(time);
        Rotation3::from_scaled_axis(-turn) * (first - shift)
    }

    /// `tracker_now_from_tracker_first` at a time, s.
    pub fn now_from_first(&self, time: f64) -> Transform {
        let [shift, turn] = self.motion(time);
        Transform::from_parts(shift.into(), Rotation3::from_scaled_axis(turn)).inverse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream_at};

    const LAW: DriftLaw = DriftLaw {
        ramp: Motion { shift: 18e-6, turn: 2e-6 },
        warm_up: [Motion { shift: 20e-6, turn: 0.0 }, Motion { shift: 80e-6, turn: 1e-5 }],
        warm_up_time: 1200.0,
        walk: Motion { shift: 30e-6, turn: 3e-6 },
    };

    #[test]
    fn each_part_has_its_size() {
        let still = DriftLaw { warm_up_time: 1.0, ..DriftLaw::default() };
        let at = |law: DriftLaw, time| {
            law.draw(7200.0, &mut stream_at(1, 0, StreamSource::Drift, 0))
                .motion(time)
                .map(|part| part.norm())
        };
        assert_eq!(at(still, 5000.0), [0.0; 2]);
        let ramp = at(DriftLaw { ramp: LAW.ramp, ..still }, 7200.0);
        assert!((ramp[0] - 36e-6).abs() < 1e-18 && (ramp[1] - 4e-6).abs() < 1e-18, "{ramp:?}");
        let warm = DriftLaw { ramp: Motion::default(), walk: Motion::default(), ..LAW };
        let (begin, hour) = (at(warm, 0.0), at(warm, 3600.0));
        assert_eq!(begin, [0.0; 2]);
        assert!((19e-6..=80e-6).contains(&hour[0]) && hour[1] <= 1e-5, "{hour:?}");
        // After one hour e^-3 of it is left.
        let whole = at(warm, 1e6);
        assert!((hour[0] / whole[0] - (1.0 - (-3.0_f64).exp())).abs() < 1e-12);
    }

    #[test]
    fn a_walk_grows_with_the_root_of_time_and_a_longer_session_goes_the_same_way() {
        let law = DriftLaw { walk: LAW.walk, warm_up_time: 1.0, ..DriftLaw::default() };
        let n = 2000_u32;
        for hours in [1.0, 4.0] {
            let square = |trial| {
                let drift = law.draw(4.0 * HOUR, &mut stream_at(1, trial, StreamSource::Drift, 0));
                drift.motion(hours * HOUR)[0].norm_squared()
            };
            let mean = (0..n).map(square).sum::<f64>() / f64::from(n);
            // The sum of 3 n squares of normal numbers, 99.9 % band.
            let ratio = mean / (hours * LAW.walk.shift.powi(2));
            assert!((ratio - 1.0).abs() < 3.29 * (2.0 / f64::from(3 * n)).sqrt(), "{hours} h: {ratio}");
        }
        let draw = |duration| LAW.draw(duration, &mut stream_at(1, 0, StreamSource::Drift, 0));
        let (short, long) = (draw(600.0), draw(6000.0));
        assert_eq!(short.motion(430.0), long.motion(430.0));
        // Nothing jumps, and no time is refused.
        let step = long.motion(90.0)[0] - long.motion(90.0 - 1e-3)[0];
        assert!(step.norm() < 1e-9, "{step}");
        assert!([-1.0, f64::NAN, f64::INFINITY, 1e300].iter().all(|t| long.walked(*t)[0].x.is_finite()));
    }

    #[test]
    fn figures_that_cannot_be_are_refused() {
        assert_eq!(LAW.check(), Ok(()));
        for bad in [f64::NAN, -1e-6, f64::INFINITY] {
            assert!(DriftLaw { walk: Motion { shift: bad, turn: 0.0 }, ..LAW }.check().is_err());
            assert!(DriftLaw { warm_up_time: bad, ..LAW }.check().is_err());
        }
    }
}
