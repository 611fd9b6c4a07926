//! What the flange carries at a pose.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A load at the flange, as known at a pose: in addition to the loads that the robot's model always carries. It is taken as
/// exact.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Payload {
    /// Name for people; one name is one load.
    pub name: String,
    /// kg
    pub mass: f64,
    /// Centre of the mass in the flange frame, where the force pulls as well, m.
    pub centre: Vector3<f64>,
    /// In the base frame, independent of the pose, N.
    pub force: Vector3<f64>,
}

/// Why a payload is invalid.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PayloadError {
    /// A mass that is negative or not a finite number.
    #[error("the mass of payload {name:?} is {mass} kg: expected a finite number of zero or more")]
    Mass {
        /// Which.
        name: String,
        /// kg
        mass: f64,
    },
    /// A centre or a force that is not finite.
    #[error("the centre or the force of payload {name:?} is not a finite number")]
    NotFinite {
        /// Which.
        name: String,
    },
}

impl Payload {
    /// A mass with its centre in the flange frame, kg and m.
    pub fn of_mass(name: impl Into<String>, mass: f64, centre: Vector3<f64>) -> Self {
        Self { name: name.into(), mass, centre, force: Vector3::zeros() }
    }

    /// Whether it is valid.
    ///
    /// # Errors
    ///
    /// [`PayloadError`], for a mass below zero, or a number that is not finite.
    pub fn check(&self) -> Result<(), PayloadError> {
        if !(self.mass >= 0.0 && self.mass.is_finite()) {
            return Err(PayloadError::Mass { name: self.name.clone(), mass: self.mass });
        }
        if self.centre.iter().chain(self.force.iter()).all(|value| value.is_finite()) {
            return Ok(());
        }
        Err(PayloadError::NotFinite { name: self.name.clone() })
    }

    /// Whether it loads nothing.
    pub fn is_none(&self) -> bool {
        self.mass == 0.0 && self.force == Vector3::zeros()
    }

    /// What distinguishes it from others, apart from the name: two that are equal load the flange alike.
    pub fn bits(&self) -> [u64; 7] {
        let mut bits = [self.mass.to_bits(); 7];
        for (bits, value) in bits[1..].iter_mut().zip(self.centre.iter().chain(self.force.iter())) {
            *bits = value.to_bits();
        }
        bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::{MeasurementError, MeasurementSet};
    use nalgebra::vector;

    #[test]
    fn a_payload_that_cannot_be_is_refused_with_its_pose() {
        let refused = |change: &dyn Fn(&mut Payload)| {
            let mut set = MeasurementSet::of_points([(vec![0.1], vector![1.0, 0.0, 0.0])]);
            let mut payload = Payload::of_mass("gauge", 25.0, vector![0.0, 0.0, 0.1]);
            set.observations[0].payload = Some(payload.clone());
            assert_eq!(set.check(1), Ok(()));
            change(&mut payload);
            set.observations[0].payload = Some(payload);
            let error = set.check(1).expect_err("refused");
            assert!(matches!(error, MeasurementError::Payload { pose: 1, .. }), "{error}");
            error.to_string()
        };
        for mass in [-1.0, f64::NAN, f64::INFINITY] {
            let text = refused(&|payload| payload.mass = mass);
            assert!(text.contains("pose 1: the mass of payload \"gauge\" is"), "{text}");
        }
        for axis in 0..3 {
            assert!(refused(&|payload| payload.centre[axis] = f64::NAN).contains("centre or the force"));
            assert!(refused(&|payload| payload.force[axis] = f64::INFINITY).contains("centre or the force"));
        }
    }

    /// The same command with another load is another pose, whatever its number.
    #[test]
    fn another_payload_is_no_repeat() {
        let point = |x: f64| (vec![0.1], vector![x, 0.0, 0.0]);
        let mut set = MeasurementSet::of_points([point(1.0), point(1.1), point(1.2), point(1.3)]);
        let gauge = Payload::of_mass("gauge", 25.0, vector![0.0, 0.0, 0.1]);
        set.observations[1].payload = Some(gauge.clone());
        set.observations[3].payload = Some(gauge);
        assert_eq!(set.repeated_readings(), [vec![0, 2], vec![1, 3]]);
        assert_eq!(set.same_commands(), [vec![0, 2], vec![1, 3]]);
    }
}
