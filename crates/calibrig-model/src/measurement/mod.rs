//! The results of a tracker session: all that passes from simulation, recording or file to identification.

mod drift;
mod instrument;
mod motion;
mod pose;
mod registration;
mod repeats;

pub use drift::{
    DRIFT_FALSE_ALARM, DriftError, DriftSize, DriftVerdict, MissingForDrift, NEST_FALSE_ALARM,
    NestContradiction, OpenMotion, StationDrift, Steady, remove_drift,
};
pub use instrument::{DRIFT_UNIT, Face, InstrumentTerm, StatedDrift, StatedInstrument};
pub use motion::Motion;
pub use pose::{CombineError, combine};
pub use registration::{NestSystem, Registration, RegistrationError, WhitenedNest, nest_system, register};
pub use repeats::Repeats;

use std::collections::HashSet;

use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{Payload, PayloadError};

/// Which of the two sets of poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MeasurementSet {
    /// Places of the tracker.
    pub stations: Vec<Station>,
    /// Targets on the flange.
    pub targets: Vec<Target>,
    /// In the order in which they were taken.
    pub observations: Vec<Observation>,
}

/// A set with what was measured and what was not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SetOutcome {
    /// Which.
    pub kind: SetKind,
    /// What was measured.
    pub measurements: MeasurementSet,
    /// Poses that were planned but not measured, with the reason.
    pub dropped: Vec<(u32, String)>,
}

/// One place of the tracker, with the base nests that it measured as common points.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Station {
    /// Name for people.
    pub name: String,
    /// Empty if the base was not measured: then nothing is known about the station beforehand.
    pub nests: Vec<NestObservation>,
    /// What is known about its instrument's errors; `None` if its readings are taken to share none.
    pub instrument: Option<StatedInstrument>,
    /// Readings while single axes of the robot moved, which can place the station instead of nests. Their [`station`](Observation::station) is this one.
    pub sweeps: Vec<Observation>,
    /// The part of the drift correction's uncertainty that readings share ([`remove_drift`]); it is included in the covariance that
    /// each states.
    pub motion: Option<OpenMotion>,
}

/// A nest at a certified place of the base, and where the tracker saw it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NestObservation {
    /// Name for people.
    pub name: String,
    /// Certified coordinates in the base frame, m.
    pub in_base: Vector3<f64>,
    /// Covariance of the certified coordinates, m².
    pub in_base_covariance: Matrix3<f64>,
    /// Where the tracker saw it.
    pub reading: Reading,
    /// Time since the session began, s, if known. A nest that is measured again has one name and several times.
    pub time: Option<f64>,
}

/// A target (SMR) on the flange.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Target {
    /// Name for people.
    pub name: String,
    /// Measured or nominal offset in the flange frame, m.
    pub in_flange: Vector3<f64>,
    /// Covariance of the measured offset, m²; `None` for a nominal value of unknown uncertainty.
    pub covariance: Option<Matrix3<f64>>,
    /// Its orientation on the flange, if its readings are full poses; `None` for a point.
    pub orientation: Option<TargetOrientation>,
}

/// The orientation on the flange of a target with axes of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TargetOrientation {
    /// `flange_from_target`, measured or nominal.
    pub flange_from_target: Rotation3<f64>,
    /// Covariance of the rotation vector in `flange_from_target · exp(ξ)`, rad²; `None` for a nominal value of unknown uncertainty.
    pub covariance: Option<Matrix3<f64>>,
}

/// One target seen at one commanded pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Number of the pose, as recorded.
    pub pose: u32,
    /// What the controller commanded, one number per actuator, m or rad.
    pub command: Vec<f64>,
    /// Sign of the last motion of each actuator before the pose: -1, 0 (unknown) or 1.
    pub approach: Vec<i8>,
    /// How far each actuator had moved at the pose since it last reversed, m or rad; empty if unknown. Meaningless for an actuator without a
    /// sign of approach.
    pub since_reversal: Vec<f64>,
    /// Air temperature at the robot, °C, if known. The robot itself may be warmer.
    pub temperature: Option<f64>,
    /// Time since the session began, s.
    pub time: f64,
    /// Index into [`MeasurementSet::stations`].
    pub station: usize,
    /// Index into [`MeasurementSet::targets`].
    pub target: usize,
    /// What the flange carried at that pose in addition to the loads of the robot's model; `None` if nothing.
    pub payload: Option<Payload>,
    /// What the tracker read.
    pub reading: Reading,
}

/// What the tracker read, in its own frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Reading {
    /// As the instrument observes.
    Spherical(SphericalReading),
    /// Coordinates that another program computed from it, m, with their covariance (m²) if stated.
    Cartesian {
        /// m
        position: Vector3<f64>,
        /// m²
        covariance: Option<Matrix3<f64>>,
    },
    /// Place and orientation of a target with axes of its own.
    Pose(Box<PoseReading>),
}

/// A target's place and orientation as a tracker with a six-degree-of-freedom probe or a camera system sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseReading {
    /// Of the target's origin in the tracker's frame, m.
    pub position: Vector3<f64>,
    /// `tracker_from_target`.
    pub rotation: Rotation3<f64>,
    /// Covariance of the position's error (m) and of the rotation vector φ in `exp(φ) · rotation` (rad), both in the tracker's axes, if stated.
    pub covariance: Option<Matrix6<f64>>,
}

/// Range, azimuth and elevation: `x = R cos(el) cos(az)`, `y = R cos(el) sin(az)`, `z = R sin(el)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SphericalReading {
    /// m
    pub range: f64,
    /// About the tracker's z, from x, rad.
    pub azimuth: f64,
    /// Above the tracker's x-y plane, rad.
    pub elevation: f64,
    /// Covariance of (range, azimuth, elevation), if stated: m², m rad, rad².
    pub covariance: Option<Matrix3<f64>>,
    /// The face in which it was taken. Angles are those of the point's direction in both.
    pub face: Face,
}

/// Why measurements are invalid.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum MeasurementError {
    /// No observation.
    #[error("there are no measurements to identify from")]
    Empty,
    /// An observation of another robot.
    #[error("pose {pose}: {found} commands, but the robot has {expected} joints")]
    JointCount {
        /// The pose.
        pose: u32,
        /// Its number of commands.
        found: usize,
        /// The robot's number of joints.
        expected: usize,
    },
    /// Not one sign of approach per actuator.
    #[error(
        "pose {pose}: {found} signs of approach for {expected} commands: expected one per command, or none if unknown"
    )]
    Approach {
        /// The pose.
        pose: u32,
        /// Their number.
        found: usize,
        /// The number of commands.
        expected: usize,
    },
    /// Not one valid distance since the last reversal per actuator.
    #[error(
        "pose {pose}: since_reversal is {found:?} for {expected} commands: expected one finite distance of zero or more per \
         command, or none if unknown"
    )]
    SinceReversal {
        /// The pose.
        pose: u32,
        /// The distances, m or rad.
        found: Vec<f64>,
        /// The number of commands.
        expected: usize,
    },
    /// An observation names a station or target that the set does not hold.
    #[error("pose {pose} names a station or a target that the measurements do not describe")]
    UnknownStationOrTarget {
        /// The pose.
        pose: u32,
    },
    /// An invalid load at the flange.
    #[error("pose {pose}: {source}")]
    Payload {
        /// The pose.
        pose: u32,
        /// Why.
        source: PayloadError,
    },
    /// A number that is not finite.
    #[error("pose {pose}: a command or reading is not a finite number")]
    NotFinite {
        /// The pose.
        pose: u32,
    },
    /// An invalid standard deviation of an instrument's error.
    #[error(
        "station {station}: the standard deviation of its instrument's {term} is {sigma}: expected a finite number of zero or more"
    )]
    InstrumentSigma {
        /// Name of the station.
        station: String,
        /// Which error.
        term: InstrumentTerm,
        /// m, rad or 1.
        sigma: f64,
    },
    /// An invalid standard deviation of a drift.
    #[error(
        "station {station}: the standard deviation of its drift is {sigma} m or rad per hour: expected a finite number of \
         zero or more"
    )]
    DriftSigma {
        /// Name of the station.
        station: String,
        /// m or rad per hour.
        sigma: f64,
    },
    /// An instrument's error that is stated twice.
    #[error("station {station}: its instrument's {term} is stated twice: expected one standard deviation")]
    InstrumentTwice {
        /// Name of the station.
        station: String,
        /// Which error.
        term: InstrumentTerm,
    },
    /// A certified place, an offset or a covariance that is not finite.
    #[error("{what}: a coordinate or covariance is not a finite number")]
    NotFiniteIn {
        /// Which station, nest or target.
        what: String,
    },
    /// Axes that are not at right angles, or not of length one.
    #[error(
        "{what}: the three columns of the rotation differ from right angles and unit length by {off:.1e}: expected a \
         rotation, as a matrix with orthonormal columns; check which columns of the file hold it, and their convention"
    )]
    NoRotation {
        /// Which pose or target.
        what: String,
        /// Largest entry of `RᵀR - 1`.
        off: f64,
    },
    /// Axes that are mirrored.
    #[error(
        "{what}: the axes of the rotation are left-handed: expected right-handed ones; check the signs and the order of its columns"
    )]
    LeftHanded {
        /// Which pose or target.
        what: String,
    },
    /// An invalid covariance of a full pose.
    #[error(
        "pose {pose}: the 6 x 6 covariance of its position (m) and rotation (rad) is not symmetric and positive definite: \
         expected six errors, each with a standard deviation above zero"
    )]
    PoseCovariance {
        /// The pose.
        pose: u32,
    },
    /// An invalid covariance of a target's orientation on the flange.
    #[error(
        "target {target}: the covariance of its orientation is not symmetric and positive definite: expected standard \
         deviations above zero (rad), or none if the orientation is unknown"
    )]
    OrientationCovariance {
        /// The target.
        target: String,
    },
    /// A full pose of a target without axes.
    #[error(
        "pose {pose} has a rotation, but the orientation of its target on the flange ({target}) is not stated: state a \
         rotation of [[target]] in a session file, or of [target] in the robot's file; without an uncertainty it is \
         identified, and a rough value will do"
    )]
    PoseOfPoint {
        /// The pose.
        pose: u32,
        /// The target.
        target: String,
    },
}

impl MeasurementSet {
    /// Positions of one target in the frame of one tracker (m) at commands (m or rad), numbered from one. Tracker place, target offset and noise
    /// are unknown.
    pub fn of_points(points: impl IntoIterator<Item = (Vec<f64>, Vector3<f64>)>) -> Self {
        let mut set = Self {
            stations: vec![Station { name: "1".to_owned(), ..Station::default() }],
            targets: vec![Target { name: "1".to_owned(), ..Target::default() }],
            observations: Vec::new(),
        };
        for (pose, (command, position)) in (1..).zip(points) {
            set.observations.push(Observation {
                pose,
                approach: vec![0; command.len()],
                since_reversal: Vec::new(),
                command,
                temperature: None,
                time: 0.0,
                station: 0,
                target: 0,
                payload: None,
                reading: Reading::Cartesian { position, covariance: None },
            });
        }
        set
    }

    /// The same with this standard deviation of every coordinate of a Cartesian reading, m.
    #[must_use]
    pub fn with_sigma(mut self, sigma: f64) -> Self {
        for observation in &mut self.observations {
            if let Reading::Cartesian { covariance, .. } = &mut observation.reading {
                *covariance = Some(Matrix3::identity() * sigma * sigma);
            }
        }
        self
    }

    /// Makes a certified place that several stations have seen count once: its covariance is multiplied by their number. Their common knowledge of
    /// the base is then right, because an error of the certificate is the same for all; relative to each other, they know more than this states.
    /// Returns whether anything changed.
    pub fn share_certificates(&mut self) -> bool {
        let mut places: Vec<(&str, Vector3<f64>, usize)> = Vec::new();
        for station in &self.stations {
            let mut own: Vec<(&str, Vector3<f64>)> =
                station.nests.iter().map(|nest| (nest.name.as_str(), nest.in_base)).collect();
            own.sort_by(|a, b| a.0.cmp(b.0));
            own.dedup();
            for (name, place) in own {
                match places.iter_mut().find(|(known, at, _)| *known == name && *at == place) {
                    Some((_, _, stations)) => *stations += 1,
                    None => places.push((name, place, 1)),
                }
            }
        }
        let shared: Vec<(String, Vector3<f64>, usize)> = places
            .into_iter()
            .filter(|(_, _, stations)| *stations > 1)
            .map(|(name, place, stations)| (name.to_owned(), place, stations))
            .collect();
        for nest in self.stations.iter_mut().flat_map(|station| &mut station.nests) {
            let by = shared.iter().find(|(name, place, _)| *name == nest.name && *place == nest.in_base);
            if let Some((_, _, stations)) = by {
                nest.in_base_covariance *= *stations as f64;
            }
        }
        !shared.is_empty()
    }

    /// RMS distance of the points from their mean (those of every station from their own), m.
    pub fn spread(&self) -> f64 {
        let of_station = |station: usize| {
            let own = self.observations.iter().filter(move |o| o.station == station);
            let points: Vec<_> = own.map(|o| o.reading.position()).collect();
            let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
            points.iter().map(|point| (point - mean).norm_squared()).sum::<f64>()
        };
        let squares: f64 = (0..self.stations.len()).map(of_station).sum();
        (squares / self.observations.len().max(1) as f64).sqrt()
    }

    /// Whether the set is valid for a robot with this number of joints. Whatever identifies from a set checks this
    /// first.
    pub fn check(&self, joints: usize) -> Result<(), MeasurementError> {
        if self.observations.is_empty() {
            return Err(MeasurementError::Empty);
        }
        self.stations.iter().try_for_each(Station::check)?;
        self.targets.iter().try_for_each(Target::check)?;
        let of_sweeps =
            self.stations.iter().enumerate().flat_map(|(index, station)| {
                station.sweeps.iter().map(move |reading| (Some(index), reading))
            });
        self.observations.iter().map(|reading| (None, reading)).chain(of_sweeps).try_for_each(
            |(swept_by, observation)| {
                let pose = observation.pose;
                let (found, approaches) = (observation.command.len(), observation.approach.len());
                if found != joints {
                    return Err(MeasurementError::JointCount { pose, found, expected: joints });
                }
                if approaches != joints && approaches != 0 {
                    return Err(MeasurementError::Approach { pose, found: approaches, expected: joints });
                }
                let ways = &observation.since_reversal;
                let is_way = |way: &f64| way.is_finite() && *way >= 0.0;
                if !(ways.is_empty() || ways.len() == joints && ways.iter().all(is_way)) {
                    return Err(MeasurementError::SinceReversal {
                        pose,
                        found: ways.clone(),
                        expected: joints,
                    });
                }
                let is_foreign = swept_by.is_some_and(|own| own != observation.station);
                if is_foreign
                    || observation.station >= self.stations.len()
                    || observation.target >= self.targets.len()
                {
                    return Err(MeasurementError::UnknownStationOrTarget { pose });
                }
                let finite = observation.command.iter().all(|v| v.is_finite())
                    && observation.time.is_finite()
                    && observation.temperature.is_none_or(f64::is_finite)
                    && observation.reading.is_finite();
                if !finite {
                    return Err(MeasurementError::NotFinite { pose });
                }
                let payload = observation.payload.iter().try_for_each(Payload::check);
                payload.map_err(|source| MeasurementError::Payload { pose, source })?;
                match &observation.reading {
                    Reading::Pose(reading) => reading.check(pose, &self.targets[observation.target]),
                    Reading::Spherical(_) | Reading::Cartesian { .. } => Ok(()),
                }
            },
        )
    }

    /// The payloads, each with its number of poses, in the order of their first ones; empty without payloads.
    pub fn payloads(&self) -> Vec<(Option<&Payload>, usize)> {
        let mut carried: Vec<(Option<&Payload>, HashSet<u32>)> = Vec::new();
        for observation in &self.observations {
            let payload = observation.payload.as_ref();
            match carried.iter_mut().find(|(known, _)| *known == payload) {
                Some((_, poses)) => _ = poses.insert(observation.pose),
                None => carried.push((payload, HashSet::from([observation.pose]))),
            }
        }
        if carried.iter().all(|(payload, _)| payload.is_none()) {
            return Vec::new();
        }
        carried.into_iter().map(|(payload, poses)| (payload, poses.len())).collect()
    }

    /// Lowest and highest command of every actuator, m or rad; empty without observations.
    pub fn spans(&self) -> Vec<[f64; 2]> {
        let mut commands = self.observations.iter().map(|observation| &observation.command);
        let first = commands.next().into_iter().flatten().map(|command| [*command; 2]).collect();
        commands.fold(first, |mut spans: Vec<[f64; 2]>, command| {
            for ([low, high], command) in spans.iter_mut().zip(command) {
                (*low, *high) = (low.min(*command), high.max(*command));
            }
            spans
        })
    }

    /// Whether any reading has an orientation.
    pub fn has_poses(&self) -> bool {
        self.observations.iter().any(|observation| matches!(observation.reading, Reading::Pose(_)))
    }
}

impl Station {
    /// The mean time of the nests or, without them, the sweeps that place it, s; zero if a nest has no time.
    pub fn placed_at(&self) -> f64 {
        let of_nests = self.nests.iter().map(|nest| nest.time);
        let of_sweeps =
            self.sweeps.iter().map(|reading| Some(reading.time)).filter(|_| self.nests.is_empty());
        let times: Option<Vec<f64>> = of_nests.chain(of_sweeps).collect();
        times
            .filter(|times| !times.is_empty())
            .map_or(0.0, |times| times.iter().sum::<f64>() / times.len() as f64)
    }

    /// The readings of every nest (indices into [`nests`](Self::nests)): those with the same name and certified place.
    pub fn distinct_nests(&self) -> Vec<Vec<usize>> {
        let mut distinct: Vec<Vec<usize>> = Vec::new();
        for (index, nest) in self.nests.iter().enumerate() {
            let is_same = |other: &NestObservation| {
                other.name == nest.name
                    && other.in_base == nest.in_base
                    && other.in_base_covariance == nest.in_base_covariance
            };
            match distinct.iter_mut().find(|readings| is_same(&self.nests[readings[0]])) {
                Some(readings) => readings.push(index),
                None => distinct.push(vec![index]),
            }
        }
        distinct
    }

    fn check(&self) -> Result<(), MeasurementError> {
        let is_finite = |nest: &NestObservation| {
            let certified = nest.in_base.iter().chain(nest.in_base_covariance.iter());
            certified.copied().all(f64::is_finite) && nest.reading.is_finite()
        };
        for (place, (term, sigma)) in
            self.instrument.iter().flat_map(|stated| stated.sigmas.iter().enumerate())
        {
            let (station, term, sigma) = (self.name.clone(), *term, *sigma);
            if !(sigma.is_finite() && sigma >= 0.0) {
                return Err(MeasurementError::InstrumentSigma { station, term, sigma });
            }
            let before = self.instrument.iter().flat_map(|stated| &stated.sigmas).take(place);
            if before.into_iter().any(|(other, _)| *other == term) {
                return Err(MeasurementError::InstrumentTwice { station, term });
            }
        }
        for drift in self.instrument.iter().filter_map(|stated| stated.drift) {
            for sigma in [drift.motion_per_hour, drift.turn_per_hour] {
                if !(sigma.is_finite() && sigma >= 0.0) {
                    return Err(MeasurementError::DriftSigma { station: self.name.clone(), sigma });
                }
            }
        }
        match self.nests.iter().find(|nest| !is_finite(nest)) {
            Some(nest) => {
                let what = format!("nest {} of station {}", nest.name, self.name);
                Err(MeasurementError::NotFiniteIn { what })
            }
            None => Ok(()),
        }
    }
}

impl Target {
    fn check(&self) -> Result<(), MeasurementError> {
        let covariance = self.covariance.iter().flat_map(|c| c.iter());
        let turned = self.orientation.iter().flat_map(|orientation| {
            let covariance = orientation.covariance.iter().flat_map(|c| c.iter());
            orientation.flange_from_target.matrix().iter().chain(covariance)
        });
        if !self.in_flange.iter().chain(covariance).chain(turned).all(|v| v.is_finite()) {
            return Err(MeasurementError::NotFiniteIn { what: format!("target {}", self.name) });
        }
        let Some(orientation) = &self.orientation else { return Ok(()) };
        pose::check_rotation(&orientation.flange_from_target, || {
            format!("the orientation of target {}", self.name)
        })?;
        match &orientation.covariance {
            Some(covariance) if !pose::is_covariance(covariance) => {
                Err(MeasurementError::OrientationCovariance { target: self.name.clone() })
            }
            _ => Ok(()),
        }
    }
}

impl SphericalReading {
    /// Cartesian position in the tracker's frame, m.
    pub fn position(&self) -> Vector3<f64> {
        let (sin_az, cos_az) = self.azimuth.sin_cos();
        let (sin_el, cos_el) = self.elevation.sin_cos();
        self.range * Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el)
    }

    /// Covariance of [`Self::position`] to first order, m², if the reading states one.
    pub fn position_covariance(&self) -> Option<Matrix3<f64>> {
        let covariance = self.covariance?;
        let (sin_az, cos_az) = self.azimuth.sin_cos();
        let (sin_el, cos_el) = self.elevation.sin_cos();
        let along = Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el);
        let by_azimuth = self.range * cos_el * Vector3::new(-sin_az, cos_az, 0.0);
        let by_elevation = self.range * Vector3::new(-sin_el * cos_az, -sin_el * sin_az, cos_el);
        let jacobian = Matrix3::from_columns(&[along, by_azimuth, by_elevation]);
        Some(jacobian * covariance * jacobian.transpose())
    }
}

/// Directions along the beam to a point, and along growing azimuth and elevation there, in the tracker's axes: columns.
pub fn beam_axes(azimuth: f64, elevation: f64) -> Matrix3<f64> {
    let (sin_az, cos_az) = azimuth.sin_cos();
    let (sin_el, cos_el) = elevation.sin_cos();
    Matrix3::from_columns(&[
        Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el),
        Vector3::new(-sin_az, cos_az, 0.0),
        Vector3::new(-sin_el * cos_az, -sin_el * sin_az, cos_el),
    ])
}

impl Reading {
    /// Whether all its numbers are finite.
    fn is_finite(&self) -> bool {
        let covariance: &[f64] = match self {
            Self::Spherical(reading) => reading.covariance.as_ref().map_or(&[], Matrix3::as_slice),
            Self::Cartesian { covariance, .. } => covariance.as_ref().map_or(&[], Matrix3::as_slice),
            Self::Pose(pose) => pose.covariance.as_ref().map_or(&[], Matrix6::as_slice),
        };
        let turn: &[f64] = match self {
            Self::Pose(pose) => pose.rotation.matrix().as_slice(),
            Self::Spherical(_) | Self::Cartesian { .. } => &[],
        };
        self.position().iter().chain(covariance).chain(turn).all(|v| v.is_finite())
    }

    /// Range (m), azimuth and elevation (rad): as read, otherwise from the position.
    pub fn spherical(&self) -> [f64; 3] {
        if let Self::Spherical(reading) = self {
            return [reading.range, reading.azimuth, reading.elevation];
        }
        let p = self.position();
        [p.norm(), p.y.atan2(p.x), p.z.atan2(p.x.hypot(p.y))]
    }

    /// The face in which it was taken; front if not stated.
    pub fn face(&self) -> Face {
        match self {
            Self::Spherical(reading) => reading.face,
            Self::Cartesian { .. } | Self::Pose(_) => Face::Front,
        }
    }

    /// Displacement of the position read, per unit of an instrument error's amplitude, m in the tracker's axes.
    pub fn displaced_by(&self, term: InstrumentTerm) -> Vector3<f64> {
        let [range, azimuth, elevation] = self.spherical();
        beam_axes(azimuth, elevation) * term.displacement(range, azimuth, elevation, self.face())
    }

    /// Position in the tracker's frame, m.
    pub fn position(&self) -> Vector3<f64> {
        match self {
            Self::Spherical(reading) => reading.position(),
            Self::Cartesian { position, .. } => *position,
            Self::Pose(pose) => pose.position,
        }
    }

    /// Covariance of the position, m², if the reading states one.
    pub fn position_covariance(&self) -> Option<Matrix3<f64>> {
        match self {
            Self::Spherical(reading) => reading.position_covariance(),
            Self::Cartesian { covariance, .. } => *covariance,
            Self::Pose(pose) => pose.covariance.map(|c| c.fixed_view::<3, 3>(0, 0).into_owned()),
        }
    }
}
