//! The laser tracker, in its first form: the random error of one observation, from the instrument's maximum permissible errors.
//!
//! Systematic errors of the instrument, the environment and drift are not modelled yet; line of sight is assumed free and the SMR
//! turned to the tracker.

mod outliers;
mod probe;

pub use outliers::Outliers;
pub use probe::Probe;

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use thiserror::Error;

use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{Face, SphericalReading};

/// A length error of the form `a + b R`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorLine {
    /// m
    pub offset: f64,
    /// m per m of range
    pub per_metre: f64,
}

impl ErrorLine {
    /// The error at a range, m.
    pub fn at(self, range: f64) -> f64 {
        self.offset + self.per_metre * range
    }
}

/// What an instrument's data sheet permits, and the part of it that is random from one observation to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instrument {
    /// Maximum permissible transverse error (ASME-B89.4.19-style).
    pub transverse: ErrorLine,
    /// Maximum permissible range error.
    pub range: ErrorLine,
    /// Standard deviation of one observation over the permissible error. An independent error of half the MPE a shot would not pass
    /// the instrument's own acceptance test; scatter measured on real trackers is about one eighth.
    pub random_fraction: f64,
    /// Whether readings scatter; without, they are exact, their stated covariance stays.
    pub noise: bool,
}

/// Ranges that a tracker can measure, m.
pub const WORKING_RANGE: [f64; 2] = [0.1, 30.0];

/// A point that the tracker cannot measure.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum TrackerError {
    /// Too near or too far.
    #[error("range {range:.3} m is outside the tracker's {} to {} m", WORKING_RANGE[0], WORKING_RANGE[1])]
    Range {
        /// m
        range: f64,
    },
    /// An instrument whose random errors have no standard deviation.
    #[error(
        "the instrument's standard deviation of the {quantity} is {value}: expected a finite number of zero or more"
    )]
    Instrument {
        /// `range` or `angles`.
        quantity: &'static str,
        /// m or rad
        value: f64,
    },
}

/// A tracker at its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaserTracker {
    /// What it is.
    pub instrument: Instrument,
    /// Where it really stands.
    pub tracker_from_base: Transform,
}

impl LaserTracker {
    /// A levelled tracker at `position` (base frame, m), its azimuth zero turned by `yaw` rad about `up`.
    pub fn levelled(instrument: Instrument, position: Vector3<f64>, yaw: f64, up: &Vector3<f64>) -> Self {
        // A base that hangs upside down is the one case without a shortest turn.
        let level = Rotation3::rotation_between(&Vector3::z(), up)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let turned = level * Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
        let base_from_tracker = Transform::from_parts(position.into(), turned);
        Self { instrument, tracker_from_base: base_from_tracker.inverse() }
    }

    /// Observes a point of the base frame (m). The stated covariance is the one of the random part. Takes the same numbers from `rng`
    /// whatever the point and the instrument are.
    pub fn measure(
        &self,
        in_base: &Vector3<f64>,
        rng: &mut impl Rng,
    ) -> Result<SphericalReading, TrackerError> {
        // Drawn whether used or not, so that neither the noise nor a point out of range moves another number of the stream.
        let units: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(rng));
        let point = self.tracker_from_base.rotation * in_base + self.tracker_from_base.translation.vector;
        let range = point.norm();
        if !(WORKING_RANGE[0]..=WORKING_RANGE[1]).contains(&range) {
            return Err(TrackerError::Range { range });
        }
        let fraction = self.instrument.random_fraction;
        let sigma_range = fraction * self.instrument.range.at(range);
        let sigma_angle = fraction * self.instrument.transverse.at(range) / range;
        for (quantity, value) in [("range", sigma_range), ("angles", sigma_angle)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(TrackerError::Instrument { quantity, value });
            }
        }
        let sigmas = [sigma_range, sigma_angle, sigma_angle];
        let error = |index: usize| if self.instrument.noise { sigmas[index] * units[index] } else { 0.0 };
        Ok(SphericalReading {
            range: range + error(0),
            azimuth: point.y.atan2(point.x) + error(1),
            // An arcsine would lose half of the digits near the zenith.
            elevation: point.z.atan2(point.x.hypot(point.y)) + error(2),
            covariance: Some(Matrix3::from_diagonal(&Vector3::new(
                sigma_range.powi(2),
                sigma_angle.powi(2),
                sigma_angle.powi(2),
            ))),
            face: Face::Front,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{Source, stream};

    const INSTRUMENT: Instrument = Instrument {
        transverse: ErrorLine { offset: 15e-6, per_metre: 6e-6 },
        range: ErrorLine { offset: 10e-6, per_metre: 0.3e-6 },
        random_fraction: 0.125,
        noise: true,
    };

    #[test]
    fn scatter_has_the_stated_covariance() {
        let up = Vector3::y();
        let tracker = LaserTracker::levelled(INSTRUMENT, Vector3::new(1.0, 0.5, -3.0), 0.4, &up);
        let point = Vector3::new(-0.5, 1.7, 1.0);
        let mut rng = stream(3, 0, Source::IdentificationNoise);
        let n = 4000;
        let truth = tracker.tracker_from_base.rotation * point + tracker.tracker_from_base.translation.vector;
        let mut chi2 = 0.0;
        for _ in 0..n {
            let reading = tracker.measure(&point, &mut rng).expect("4 m");
            let error = reading.position() - truth;
            let information =
                reading.position_covariance().and_then(Matrix3::try_inverse).expect("positive definite");
            chi2 += (error.transpose() * information * error)[0];
        }
        // Chi-square with 3 n degrees of freedom, 99.9 % band.
        let spread = 3.29 * (2.0 / f64::from(3 * n)).sqrt();
        let ratio = chi2 / f64::from(3 * n);
        assert!((ratio - 1.0).abs() < spread, "{ratio} +- {spread}");
    }

    #[test]
    fn without_noise_the_reading_is_the_point_and_its_axis_is_up() {
        let exact = Instrument { noise: false, ..INSTRUMENT };
        let up = Vector3::y();
        let tracker = LaserTracker::levelled(exact, Vector3::new(1.0, 0.5, -3.0), 0.4, &up);
        let mut rng = stream(3, 0, Source::IdentificationNoise);
        let above = tracker.measure(&Vector3::new(1.0, 2.5, -3.0), &mut rng).expect("2 m");
        assert!((above.elevation - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        assert!((above.range - 2.0).abs() < 1e-15);
        assert!(tracker.measure(&Vector3::new(1.0, 0.5, -3.05), &mut rng).is_err());
    }

    #[test]
    fn readings_near_the_zenith_are_as_exact_as_others() {
        let exact = Instrument { noise: false, ..INSTRUMENT };
        let tracker = LaserTracker { instrument: exact, tracker_from_base: Transform::identity() };
        let mut rng = stream(3, 0, Source::IdentificationNoise);
        for off in [1e-8, 1e-6, 1e-3] {
            let point = Vector3::new(3.0 * off, 4.0 * off, 2.0);
            let reading = tracker.measure(&point, &mut rng).expect("2 m");
            let from_zenith = (5.0 * off / 2.0).atan();
            assert!((std::f64::consts::FRAC_PI_2 - reading.elevation - from_zenith).abs() < 1e-14, "{off}");
            assert!((reading.position() - point).norm() < 1e-15, "{off}");
        }
    }

    #[test]
    fn a_point_out_of_range_moves_no_later_reading() {
        let tracker = LaserTracker { instrument: INSTRUMENT, tracker_from_base: Transform::identity() };
        let after = |first: f64| {
            let mut rng = stream(3, 0, Source::IdentificationNoise);
            let first = tracker.measure(&Vector3::new(first, 0.0, 0.0), &mut rng);
            (first.is_ok(), tracker.measure(&Vector3::new(2.0, 1.0, 0.5), &mut rng).expect("2 m"))
        };
        let (in_range, later) = after(5.0);
        assert!(in_range);
        for out_of_range in [0.05, 31.0, f64::INFINITY, f64::NAN] {
            assert_eq!(after(out_of_range), (false, later.clone()));
        }
    }
}
