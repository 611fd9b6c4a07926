//! A rail that is neither straight nor without twist.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::error::{Range, check};
use super::{EffectError, EffectKind};

/// One error along a rail: a polynomial and a wave. The wave is too short to be contained in a low-order polynomial.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RailProfile {
    /// Coefficients of 1, x, x², ... with x from -1 at the beginning of the rail to 1 at its end, m or rad.
    pub polynomial: Vec<f64>,
    /// Amplitude of the wave, m or rad.
    pub wave: f64,
    /// Phase of the wave at the beginning of the rail, rad.
    pub phase: f64,
}

impl RailProfile {
    fn at(&self, x: f64, wave_angle: f64) -> f64 {
        let polynomial = self.polynomial.iter().rev().fold(0.0, |sum, coefficient| sum * x + coefficient);
        polynomial + self.wave * (wave_angle + self.phase).sin()
    }
}

/// Straightness and angular errors of a rail, as displacements of its carriage.
#[derive(Debug, Clone, PartialEq)]
pub struct Rail {
    /// Index of the joint.
    pub joint: usize,
    /// Its beginning and end, m.
    pub range: [f64; 2],
    /// Length of the waves, m.
    pub wavelength: f64,
    /// The vertical in the carriage's frame: a unit vector across the rail, which is z.
    pub vertical: Vector3<f64>,
    /// Along vertical × z, m.
    pub horizontal_error: RailProfile,
    /// Along the vertical, m.
    pub vertical_error: RailProfile,
    /// About z, rad.
    pub roll: RailProfile,
    /// About vertical × z, rad.
    pub pitch: RailProfile,
    /// About the vertical, rad.
    pub yaw: RailProfile,
}

impl Rail {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        let kind = EffectKind::Rail;
        if self.joint >= actuators {
            return Err(EffectError::NoSuchPart { effect: kind, part: "joint of the rail's index" });
        }
        check(kind, ("length", self.joint), self.range[1] - self.range[0], Range::Positive)?;
        check(kind, ("wavelength", self.joint), self.wavelength, Range::Positive)?;
        // A unit vector across z.
        let skew = (self.vertical.norm() - 1.0).abs() + self.vertical.z.abs();
        if !(skew < 1e-9) {
            let expected = "a unit vector across the rail";
            let index = self.joint;
            return Err(EffectError::Value {
                effect: kind,
                quantity: "vertical",
                index,
                value: skew,
                expected,
            });
        }
        for profile in [&self.horizontal_error, &self.vertical_error, &self.roll, &self.pitch, &self.yaw] {
            for &coefficient in &profile.polynomial {
                check(kind, ("coefficient", self.joint), coefficient, Range::Finite)?;
            }
            check(kind, ("wave", self.joint), profile.wave, Range::NotNegative)?;
            check(kind, ("phase", self.joint), profile.phase, Range::Finite)?;
        }
        Ok(())
    }

    /// Displacement of the carriage's frame at `position` (m): along x, y, z (m), about x, y, z (rad).
    pub fn displacement(&self, position: f64) -> [f64; 6] {
        let [begin, end] = self.range;
        let x = (2.0 * position - begin - end) / (end - begin);
        let wave_angle = TAU * (position - begin) / self.wavelength;
        let at = |profile: &RailProfile| profile.at(x, wave_angle);
        let horizontal = self.vertical.cross(&Vector3::z());
        let shift = at(&self.horizontal_error) * horizontal + at(&self.vertical_error) * self.vertical;
        let turn =
            at(&self.roll) * Vector3::z() + at(&self.pitch) * horizontal + at(&self.yaw) * self.vertical;
        [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn straight() -> Rail {
        Rail {
            joint: 0,
            range: [1.0, 5.0],
            wavelength: 0.5,
            vertical: Vector3::y(),
            horizontal_error: RailProfile::default(),
            vertical_error: RailProfile::default(),
            roll: RailProfile::default(),
            pitch: RailProfile::default(),
            yaw: RailProfile::default(),
        }
    }

    fn assert_close(found: [f64; 6], expected: [f64; 6]) {
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-18, "{found} against {expected}");
        }
    }

    #[test]
    fn errors_act_along_and_about_their_own_axes() {
        // Constant errors with y up: vertical x z = x.
        let constant = |value: f64| RailProfile { polynomial: vec![value], ..RailProfile::default() };
        let mut rail = Rail {
            horizontal_error: constant(1e-4),
            vertical_error: constant(2e-4),
            roll: constant(3e-5),
            pitch: constant(4e-5),
            yaw: constant(5e-5),
            ..straight()
        };
        assert_close(rail.displacement(2.2), [1e-4, 2e-4, 0.0, 4e-5, 5e-5, 3e-5]);
        // With x up: vertical x z = -y.
        rail.vertical = Vector3::x();
        assert_close(rail.displacement(2.2), [2e-4, -1e-4, 0.0, 5e-5, -4e-5, 3e-5]);
    }

    #[test]
    fn a_bow_vanishes_in_the_middle_and_a_wave_begins_with_the_rail() {
        let mut rail = straight();
        rail.vertical_error.polynomial = vec![0.0, 1e-4, 3e-4];
        for (position, height) in [(1.0, 2e-4), (3.0, 0.0), (4.0, 1.25e-4), (5.0, 4e-4)] {
            assert_close(rail.displacement(position), [0.0, height, 0.0, 0.0, 0.0, 0.0]);
        }
        let mut rail = straight();
        rail.yaw = RailProfile { polynomial: Vec::new(), wave: 2e-5, phase: FRAC_PI_2 };
        for (position, yaw) in [(1.0, 2e-5), (1.25, -2e-5), (1.5, 2e-5), (2.75, -2e-5)] {
            assert!((rail.displacement(position)[4] - yaw).abs() < 1e-15, "{position}");
        }
    }
}
