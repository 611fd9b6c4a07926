//! The permissible errors of a data sheet, and how an instrument's errors are distributed within them.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use super::{Preset, TrackerError};

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

/// Ranges that a tracker can measure unless a data sheet states otherwise, m.
pub const WORKING_RANGE: [f64; 2] = [0.1, 30.0];

/// Where an instrument can measure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// m
    pub range: [f64; 2],
    /// rad, from its zero; a cable may stop the head after more than a turn.
    pub azimuth: [f64; 2],
    /// rad, above the horizon.
    pub elevation: [f64; 2],
    /// Of the air, °C.
    pub temperature: [f64; 2],
}

impl Limits {
    /// Only what every tracker has: a working range.
    pub const WIDE: Self = Self {
        range: WORKING_RANGE,
        azimuth: [-TAU, TAU],
        elevation: [-PI / 2.0, PI / 2.0],
        temperature: [f64::NEG_INFINITY, f64::INFINITY],
    };

    /// Whether the tracker can turn its beam to a point in its own frame (m), regardless of earlier turns of its head.
    ///
    /// # Errors
    ///
    /// [`TrackerError::Range`] or [`TrackerError::Angle`].
    pub fn reaches(&self, point: &Vector3<f64>) -> Result<(), TrackerError> {
        let range = point.norm();
        let [least, most] = self.range;
        if !(least..=most).contains(&range) {
            return Err(TrackerError::Range { range, least, most });
        }
        let value = point.z.atan2(point.x.hypot(point.y));
        let [least, most] = self.elevation;
        if !(least - SLACK..=most + SLACK).contains(&value) {
            return Err(TrackerError::Angle { angle: "elevation", value, least, most });
        }
        let value = point.y.atan2(point.x);
        let [least, most] = self.azimuth;
        // The first turn of it that is not below the limits.
        let turned = value + TAU * ((least - SLACK - value) / TAU).ceil();
        if turned > most + SLACK {
            return Err(TrackerError::Angle { angle: "azimuth", value, least, most });
        }
        Ok(())
    }
}

/// How far an angle may be beyond its limits because of an instrument error, rad.
pub(super) const SLACK: f64 = 1e-3;

/// The permissible errors of a data sheet, and the shares of random and systematic error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instrument {
    /// Source of the model.
    pub preset: Option<Preset>,
    /// Maximum permissible transverse error (ASME-B89.4.19-style).
    pub transverse: ErrorLine,
    /// Maximum permissible range error.
    pub range: ErrorLine,
    /// Maximum permissible error of the range's zero (R0), m, if the data sheet states one.
    pub range_zero: Option<f64>,
    /// Its limits.
    pub limits: Limits,
    /// Standard deviation of one observation of 1 s over the permissible error. Independent errors of half the MPE per shot would fail the
    /// instrument's own acceptance test; scatter measured on real trackers is about one eighth.
    pub random_fraction: f64,
    /// Standard deviation of the air's effect on both angles, rad; longer averaging does not remove it.
    pub air: f64,
    /// Standard deviation of each systematic error over the permissible one: of lengths over the offset of its line, of angles and scale over its
    /// slope. Zero: none.
    pub systematic_fraction: f64,
    /// Ratio of its real errors to the stated ones, on which its acceptance and all statements rest.
    pub real: RealErrors,
    /// Whether readings have errors; without, they do not scatter and nothing is drawn for the tracker, but the stated covariance stays.
    pub noise: bool,
}

/// Real errors over stated ones: an instrument that was knocked after its last test is no longer as certified.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RealErrors {
    /// Of the scatter of single readings.
    pub random: f64,
    /// Of each systematic error of an instrument that passed its test.
    pub systematic: f64,
}

impl RealErrors {
    /// As certified.
    pub const AS_STATED: Self = Self { random: 1.0, systematic: 1.0 };
}

/// About one eighth of the permissible error, as scatter measured on real trackers is.
pub const RANDOM_FRACTION: f64 = 0.125;

/// Value with which drawn instruments have the typical error of data sheets, half of the permissible one.
pub const SYSTEMATIC_FRACTION: f64 = 0.2;

/// Averaging time for which [`Instrument::random_fraction`] is stated, s.
pub const STATED_AVERAGING: f64 = 1.0;

impl Instrument {
    /// An instrument with only random errors, of `random_fraction` of the permissible ones.
    pub const fn of_noise(transverse: ErrorLine, range: ErrorLine, random_fraction: f64) -> Self {
        Self {
            preset: None,
            transverse,
            range,
            range_zero: None,
            limits: Limits::WIDE,
            random_fraction,
            air: 0.0,
            systematic_fraction: 0.0,
            real: RealErrors::AS_STATED,
            noise: true,
        }
    }

    /// Standard deviations of range (m) and of each angle (rad) at a range (m), averaged over this time (s).
    pub(super) fn sigmas(&self, range: f64, averaging: f64) -> Result<[f64; 2], TrackerError> {
        if !(averaging > 0.0 && averaging.is_finite()) {
            return Err(TrackerError::Figure {
                quantity: "averaging time in s",
                value: averaging,
                expected: "a number above zero",
            });
        }
        // A root of one is exact: a reading of the stated time has the stated sigma to the bit.
        let fraction = self.random_fraction * (STATED_AVERAGING / averaging).sqrt();
        let sigma_range = fraction * self.range.at(range);
        let random_angle = fraction * self.transverse.at(range) / range;
        let sigma_angle = if self.air == 0.0 { random_angle } else { random_angle.hypot(self.air) };
        for (quantity, value) in [("range", sigma_range), ("angles", sigma_angle)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(TrackerError::Instrument { quantity, value });
            }
        }
        Ok([sigma_range, sigma_angle])
    }

    /// Whether its figures are valid for an instrument.
    pub fn check(&self) -> Result<(), TrackerError> {
        self.sigmas(1.0, STATED_AVERAGING)?;
        let zero_or_more = [
            ("systematic fraction", self.systematic_fraction),
            ("air in rad", self.air),
            ("permissible error of the range's zero in m", self.range_zero.unwrap_or(0.0)),
            ("real scatter over the stated one", self.real.random),
            ("real systematic errors over those that passed", self.real.systematic),
        ];
        for (quantity, value) in zero_or_more {
            if !(value >= 0.0 && value.is_finite()) {
                let expected = "a finite number of zero or more";
                return Err(TrackerError::Figure { quantity, value, expected });
            }
        }
        let [least, most] = self.limits.range;
        if !(least > 0.0 && least < most) {
            let expected = "a number above zero and below the largest range";
            return Err(TrackerError::Figure { quantity: "least range in m", value: least, expected });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A head that turns from -30 to 250 deg, and a telescope from -20 to 60 deg.
    #[test]
    fn a_beam_reaches_what_its_angles_and_ranges_reach() {
        let degrees = |low: f64, high: f64| [low.to_radians(), high.to_radians()];
        let limits =
            Limits { azimuth: degrees(-30.0, 250.0), elevation: degrees(-20.0, 60.0), ..Limits::WIDE };
        let at = |azimuth: f64, elevation: f64, range: f64| {
            let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
            let across = range * elevation.cos();
            let point = Vector3::new(across * azimuth.cos(), across * azimuth.sin(), range * elevation.sin());
            limits.reaches(&point)
        };
        for (azimuth, elevation) in [(0.0, 0.0), (-29.0, 0.0), (180.0, 0.0), (-120.0, 0.0), (0.0, 59.0)] {
            assert_eq!(at(azimuth, elevation, 3.0), Ok(()), "{azimuth} {elevation}");
        }
        for (azimuth, elevation, angle) in [
            (-50.0, 0.0, "azimuth"),
            (-100.0, 0.0, "azimuth"),
            (0.0, 61.0, "elevation"),
            (0.0, -21.0, "elevation"),
        ] {
            let refused = at(azimuth, elevation, 3.0);
            assert!(
                matches!(refused, Err(TrackerError::Angle { angle: own, .. }) if own == angle),
                "{refused:?}"
            );
        }
        assert!(matches!(at(0.0, 0.0, 0.01), Err(TrackerError::Range { .. })));
        assert!(matches!(at(0.0, 0.0, 31.0), Err(TrackerError::Range { .. })));
    }
}
