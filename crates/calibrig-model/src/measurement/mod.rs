//! What a tracker session leaves behind. It is all that passes from simulation, recording or file to identification.

mod registration;

pub use registration::{NestSystem, Registration, RegistrationError, nest_system, register};

use nalgebra::{Matrix3, Vector3};

/// Which of the two sets of poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum SetKind {
    /// The parameters are fitted to it.
    Identification,
    /// Held out.
    Verification,
}

impl SetKind {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Identification, Self::Verification];

    /// The key in JSON and recordings.
    pub fn key(self) -> &'static str {
        match self {
            Self::Identification => "identification",
            Self::Verification => "verification",
        }
    }
}

/// A tracker session: the stations, the targets and the observations taken between them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MeasurementSet {
    /// Places of the tracker.
    pub stations: Vec<Station>,
    /// Targets on the flange.
    pub targets: Vec<Target>,
    /// In the order taken.
    pub observations: Vec<Observation>,
}

/// A set as it was measured, and what of it was not.
#[derive(Debug, Clone, PartialEq)]
pub struct SetOutcome {
    /// Which.
    pub kind: SetKind,
    /// What was measured.
    pub measurements: MeasurementSet,
    /// Poses that were planned but not measured, with the reason.
    pub dropped: Vec<(u32, String)>,
}

/// One place of the tracker, with the base nests that it measured as common points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Station {
    /// Name for people.
    pub name: String,
    /// Empty where the base was not measured: then nothing is known of the station beforehand.
    pub nests: Vec<NestObservation>,
}

/// A nest at a certified place of the base, and where the tracker saw it.
#[derive(Debug, Clone, PartialEq)]
pub struct NestObservation {
    /// Name for people.
    pub name: String,
    /// Certified coordinates in the base frame, m.
    pub in_base: Vector3<f64>,
    /// Covariance of the certified coordinates, m².
    pub in_base_covariance: Matrix3<f64>,
    /// Where the tracker saw it.
    pub reading: Reading,
}

/// A target (SMR) on the flange.
#[derive(Debug, Clone, PartialEq)]
pub struct Target {
    /// Name for people.
    pub name: String,
    /// Measured or nominal offset in the flange frame, m.
    pub in_flange: Vector3<f64>,
    /// Covariance of the measured offset, m²; `None` for a nominal value of unknown uncertainty.
    pub covariance: Option<Matrix3<f64>>,
}

/// One target seen at one commanded pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Number of the pose, as recorded.
    pub pose: u32,
    /// What the controller commanded, one number an actuator, m or rad.
    pub command: Vec<f64>,
    /// Sign of the last motion of each actuator before the pose: -1, 0 (unknown) or 1.
    pub approach: Vec<i8>,
    /// Temperature of the robot, °C, where known.
    pub temperature: Option<f64>,
    /// Time since the session began, s.
    pub time: f64,
    /// Index into [`MeasurementSet::stations`].
    pub station: usize,
    /// Index into [`MeasurementSet::targets`].
    pub target: usize,
    /// What the tracker read.
    pub reading: Reading,
}

/// What the tracker read, in its own frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Reading {
    /// As the instrument observes.
    Spherical(SphericalReading),
    /// Coordinates that another program made of it, m, with their covariance (m²) where stated.
    Cartesian {
        /// m
        position: Vector3<f64>,
        /// m²
        covariance: Option<Matrix3<f64>>,
    },
}

/// Range, azimuth and elevation: `x = R cos(el) cos(az)`, `y = R cos(el) sin(az)`, `z = R sin(el)`.
#[derive(Debug, Clone, PartialEq)]
pub struct SphericalReading {
    /// m
    pub range: f64,
    /// About the tracker's z, from x, rad.
    pub azimuth: f64,
    /// Above the tracker's x-y plane, rad.
    pub elevation: f64,
    /// Covariance of (range, azimuth, elevation): m², m rad, rad².
    pub covariance: Matrix3<f64>,
}

impl SphericalReading {
    /// Cartesian position in the tracker's frame, m.
    pub fn position(&self) -> Vector3<f64> {
        let (sin_az, cos_az) = self.azimuth.sin_cos();
        let (sin_el, cos_el) = self.elevation.sin_cos();
        self.range * Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el)
    }

    /// Covariance of [`Self::position`] to first order, m².
    pub fn position_covariance(&self) -> Matrix3<f64> {
        let (sin_az, cos_az) = self.azimuth.sin_cos();
        let (sin_el, cos_el) = self.elevation.sin_cos();
        let along = Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el);
        let by_azimuth = self.range * cos_el * Vector3::new(-sin_az, cos_az, 0.0);
        let by_elevation = self.range * Vector3::new(-sin_el * cos_az, -sin_el * sin_az, cos_el);
        let jacobian = Matrix3::from_columns(&[along, by_azimuth, by_elevation]);
        jacobian * self.covariance * jacobian.transpose()
    }
}

impl Reading {
    /// Position in the tracker's frame, m.
    pub fn position(&self) -> Vector3<f64> {
        match self {
            Self::Spherical(reading) => reading.position(),
            Self::Cartesian { position, .. } => *position,
        }
    }

    /// Covariance of the position, m², where the reading states one.
    pub fn position_covariance(&self) -> Option<Matrix3<f64>> {
        match self {
            Self::Spherical(reading) => Some(reading.position_covariance()),
            Self::Cartesian { covariance, .. } => *covariance,
        }
    }
}
