//! The laser tracker: its reading of a point.
//!
//! An [`Instrument`] is a data sheet, and how errors are distributed within its permissible ones; [`Preset`] names some. Its systematic errors are
//! drawn once ([`LaserTracker::drawn`]) and computed from the geometry of its axes and encoders ([`Misalignment`]): an instrument that fails the
//! virtual [acceptance] test is not sold, and another is drawn. The air ([`EnvironmentLaw`]) and the motion of the tracker on its stand
//! ([`DriftLaw`]) are drawn once per session; the random part is new in every reading. Each is optional: a tracker that was only
//! [placed](LaserTracker::levelled) has only random errors.
//!
//! Reflectors ([`Smr`]), gross errors ([`Outliers`]) and missing readings ([`is_missed`]) belong to the session that uses them. An
//! interferometer that counts from a home position is not modelled: every range is absolute.

pub mod acceptance;
mod air;
mod drift;
mod encoder;
mod environment;
mod error;
mod instrument;
mod misalignment;
mod misses;
mod outliers;
mod preset;
mod probe;
mod smr;
mod systematic;
#[cfg(test)]
mod tests;

pub use air::Air;
pub use drift::{Drift, DriftLaw, Motion};
pub use encoder::Encoder;
pub use environment::{AirErrors, EnvironmentLaw};
pub use error::TrackerError;
pub use instrument::{
    ErrorLine, Instrument, Limits, RANDOM_FRACTION, RealErrors, STATED_AVERAGING, SYSTEMATIC_FRACTION,
    WORKING_RANGE,
};
pub use misalignment::{Misalignment, Shown};
pub use misses::is_missed;
pub use outliers::Outliers;
pub use preset::Preset;
pub use probe::Probe;
pub use smr::{Smr, SmrLaw};

use std::f64::consts::TAU;

use self::instrument::SLACK;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{Face, InstrumentTerm, SphericalReading, StatedInstrument};
use calibrig_model::random::{StreamSource, stream_at};

/// Conditions of a session besides its instrument. The default has none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Conditions {
    /// The air, if it differs from that for which the instrument assumes its refractive index.
    pub environment: Option<EnvironmentLaw>,
    /// How the tracker moves on its stand.
    pub drift: Option<DriftLaw>,
    /// The reflectors.
    pub smr: Option<SmrLaw>,
    /// Share of missing readings, 0 to 1.
    pub misses: f64,
}

/// The errors that a tracker has in a session. The default has none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrackerErrors {
    /// Of its geometry.
    pub misalignment: Misalignment,
    /// Number of instruments drawn before it that failed their acceptance test.
    pub redraws: u32,
    /// Of the air.
    pub air: AirErrors,
    /// Its motion.
    pub drift: Drift,
}

/// One reading, as requested from the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot {
    /// Since the session began, s.
    pub time: f64,
    /// In which position of head and telescope.
    pub face: Face,
    /// Averaging time, s.
    pub averaging: f64,
    /// The azimuth before, rad: the controller counts turns, and shows the azimuth nearest to it.
    pub azimuth_before: f64,
}

impl Default for Shot {
    fn default() -> Self {
        Self { time: 0.0, face: Face::Front, averaging: STATED_AVERAGING, azimuth_before: 0.0 }
    }
}

impl Shot {
    /// In the front face, averaged for 1 s, at a time (s) since the session began.
    pub fn at(time: f64) -> Self {
        Self { time, ..Self::default() }
    }
}

/// A tracker at its place.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserTracker {
    /// The instrument.
    pub instrument: Instrument,
    /// The conditions of the session.
    pub conditions: Conditions,
    /// Its real place when the session begins.
    pub tracker_from_base: Transform,
    /// What is drawn for it, [once](Self::drawn) per session.
    pub errors: TrackerErrors,
}

impl LaserTracker {
    /// A levelled tracker without systematic errors at `position` (base frame, m), its azimuth zero turned by `yaw` rad about `up`.
    pub fn levelled(instrument: Instrument, position: Vector3<f64>, yaw: f64, up: &Vector3<f64>) -> Self {
        // A base that hangs upside down is the only case without a shortest turn.
        let level = Rotation3::rotation_between(&Vector3::z(), up)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let turned = level * Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
        let base_from_tracker = Transform::from_parts(position.into(), turned);
        Self::placed(instrument, base_from_tracker.inverse())
    }

    /// A tracker without systematic errors at its place.
    pub fn placed(instrument: Instrument, tracker_from_base: Transform) -> Self {
        let (conditions, errors) = (Conditions::default(), TrackerErrors::default());
        Self { instrument, conditions, tracker_from_base, errors }
    }

    /// Whether anything about it is drawn once per session.
    pub fn has_law(&self) -> bool {
        let Conditions { environment, drift, .. } = self.conditions;
        self.instrument.noise
            && (self.instrument.systematic_fraction > 0.0 || environment.is_some() || drift.is_some())
    }

    /// The same with its errors in the session of (seed, trial), which lasts `duration` s: an instrument that passes its acceptance test, the
    /// session's air, and the motion of the station of this number. All stations of a session share one instrument and one air.
    pub fn drawn(&self, seed: u64, trial: u32, station: u64, duration: f64) -> Result<Self, TrackerError> {
        self.check()?;
        let mut own = self.clone();
        own.errors = TrackerErrors::default();
        if !self.instrument.noise {
            return Ok(own);
        }
        if self.instrument.systematic_fraction > 0.0 {
            // It was as stated when it was tested.
            let tested = Instrument { real: RealErrors::AS_STATED, ..self.instrument };
            let (passed, redraws) = acceptance::first_accepted(&tested, seed, trial)?;
            let real = self.instrument.real.systematic;
            let misalignment = if real == 1.0 {
                passed
            } else {
                Misalignment::of(passed.amplitudes().into_iter().map(|(term, x)| (term, real * x)))
            };
            own.errors = TrackerErrors { misalignment, redraws, ..own.errors };
        }
        if let Some(law) = &self.conditions.environment {
            own.errors.air = law.draw(&mut stream_at(seed, trial, StreamSource::Environment, 0));
        }
        if let Some(law) = &self.conditions.drift {
            own.errors.drift = law.draw(duration, &mut stream_at(seed, trial, StreamSource::Drift, station));
        }
        Ok(own)
    }

    /// Whether its figures, and those of the session, are valid.
    pub fn check(&self) -> Result<(), TrackerError> {
        self.instrument.check()?;
        let Conditions { environment, drift, smr, misses } = &self.conditions;
        if let Some(law) = environment {
            law.check()?;
            let ([least, most], value) = (self.instrument.limits.temperature, law.air.temperature);
            if !(least..=most).contains(&value) {
                let (quantity, expected) =
                    ("surrounding air in deg C", "a temperature at which the instrument works");
                return Err(TrackerError::Figure { quantity, value, expected });
            }
        }
        drift.as_ref().map_or(Ok(()), DriftLaw::check)?;
        smr.as_ref().map_or(Ok(()), SmrLaw::check)?;
        if !(0.0..=1.0).contains(misses) {
            let quantity = "share of missing readings";
            return Err(TrackerError::Figure { quantity, value: *misses, expected: "0 to 1" });
        }
        Ok(())
    }

    /// Where the tracker is at a time (s) since the session began.
    pub fn tracker_from_base_at(&self, time: f64) -> Transform {
        if self.errors.drift.is_none() {
            return self.tracker_from_base;
        }
        self.errors.drift.now_from_first(time) * self.tracker_from_base
    }

    /// What an operator knows about the errors that all readings share: the name and, from data sheet and sensors, a standard deviation of each error
    /// that the instrument can have. An empty list: it is assumed to have none.
    pub fn stated(&self) -> StatedInstrument {
        let name = self.instrument.preset.map_or("tracker", Preset::key).to_owned();
        let air = self.conditions.environment.as_ref().map_or(0.0, EnvironmentLaw::scale_sigma);
        let sigma = |term| {
            let own = self.instrument.systematic_sigma(term);
            if term == InstrumentTerm::RangeScale { own.hypot(air) } else { own }
        };
        let sigmas = InstrumentTerm::ALL.map(|term| (term, sigma(term)));
        StatedInstrument {
            drift: self.conditions.drift.as_ref().and_then(DriftLaw::stated),
            name,
            sigmas: sigmas.into_iter().filter(|(_, sigma)| *sigma > 0.0).collect(),
        }
    }

    /// The real amplitude (m, rad or 1) of each error of the instrument, to first order: those of its geometry and, in the range's scale, what the
    /// sensed air leaves. The bending of the beam by layered air is not among them.
    pub fn real_errors(&self) -> Vec<(InstrumentTerm, f64)> {
        let mut errors = self.errors.misalignment.amplitudes();
        for (_, scale) in errors.iter_mut().filter(|(term, _)| *term == InstrumentTerm::RangeScale) {
            *scale += (1.0 + *scale) * (self.errors.air.scale - 1.0);
        }
        errors
    }

    /// Observes a point of the base frame (m). The stated covariance is that of the random part and of the air's contribution. Takes the same numbers
    /// from `rng` whatever the point and the instrument are.
    pub fn measure(
        &self,
        in_base: &Vector3<f64>,
        shot: &Shot,
        rng: &mut impl Rng,
    ) -> Result<SphericalReading, TrackerError> {
        // Drawn whether used or not, so that neither the noise nor a point out of range shifts another number of the
        // stream.
        let units: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(rng));
        let first = self.tracker_from_base.rotation * in_base + self.tracker_from_base.translation.vector;
        let drift = &self.errors.drift;
        let point = if drift.is_none() { first } else { drift.seen(&first, shot.time) };
        let distance = point.norm();
        let Limits { range: [least, most], azimuth, elevation, .. } = self.instrument.limits;
        if !(least..=most).contains(&distance) {
            return Err(TrackerError::Range { range: distance, least, most });
        }
        let [sigma_range, sigma_angle] = self.instrument.sigmas(distance, shot.averaging)?;
        let errors = &self.errors;
        let shown = errors.misalignment.read(&errors.air.apparent(&point), shot.face)?;
        let sigmas = [sigma_range, sigma_angle, sigma_angle];
        let scatter = self.instrument.real.random;
        let noise =
            |index: usize| if self.instrument.noise { scatter * (sigmas[index] * units[index]) } else { 0.0 };
        let turned = shown.azimuth + noise(1);
        let reading = SphericalReading {
            range: shown.range * errors.air.range_factor(point.z) + noise(0),
            azimuth: turned - TAU * ((turned - shot.azimuth_before) / TAU).round(),
            elevation: shown.elevation + noise(2),
            covariance: Some(Matrix3::from_diagonal(&Vector3::new(
                sigma_range.powi(2),
                sigma_angle.powi(2),
                sigma_angle.powi(2),
            ))),
            face: shot.face,
        };
        // With errors as large as the path nothing can be displayed.
        if !(reading.range > 0.0 && reading.range.is_finite()) {
            return Err(TrackerError::Range { range: reading.range, least, most });
        }
        for (angle, value, [least, most]) in
            [("azimuth", reading.azimuth, azimuth), ("elevation", reading.elevation, elevation)]
        {
            if !(least - SLACK..=most + SLACK).contains(&value) {
                return Err(TrackerError::Angle { angle, value, least, most });
            }
        }
        Ok(reading)
    }
}
