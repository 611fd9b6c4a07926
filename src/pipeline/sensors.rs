//! What a target on the flange can determine: one point, three points, or a full pose, at the same poses of the same
//! machine.

mod foreseen;

pub use foreseen::{SensorProspect, SensorStudy, foresee_sensors};

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::{CalibrateError, PipelineError, PlantKind, simulate};
use crate::scenario::Scenario;
use calibrig_estimation::calibration::{errors, turns};
use calibrig_estimation::evaluation::{accuracy, orientation_accuracy};
use calibrig_estimation::identification::{IdentificationOptions, Mode, identify};
use calibrig_model::ParameterId;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{
    CombineError, MeasurementSet, Observation, PoseReading, Reading, SetOutcome, SphericalReading, Station,
    Target, TargetOrientation, combine,
};
use calibrig_model::random::{StreamSource, stream_at};
use calibrig_model::statistics::normal_quantile;

use calibrig_plant::session::SessionPlan;
use calibrig_plant::tracker::{Shot, TrackerError};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A target, or several, on the flange.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {
    /// The scenario's own target.
    OneSmr,
    /// It and two more, [`ARM`] from it along the flange's x and y.
    ThreeSmrs,
    /// The pose computed from the readings of these three.
    CombinedPose,
    /// A probe with axes: the scenario's (`[tracker.pose]`), or the one that measured full poses.
    Probe,
    /// All targets of a session together, if they are none of the others.
    AsMeasured,
}

impl Sensor {
    /// Those that can be simulated.
    pub const ALL: [Self; 4] = [Self::OneSmr, Self::ThreeSmrs, Self::CombinedPose, Self::Probe];

    /// The key in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::OneSmr => "one_smr",
            Self::ThreeSmrs => "three_smrs",
            Self::CombinedPose => "combined_pose",
            Self::Probe => "probe",
            Self::AsMeasured => "as_measured",
        }
    }

    /// The name in tables.
    pub fn title(self) -> &'static str {
        match self {
            Self::OneSmr => "one SMR",
            Self::ThreeSmrs => "three SMRs",
            Self::CombinedPose => "their pose",
            Self::Probe => "probe",
            Self::AsMeasured => "all targets",
        }
    }
}

/// Distance of the second and third SMR from the first, m: what fits on a wrist.
pub const ARM: f64 = 0.12;

/// Results of one target.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorResult {
    /// Which.
    pub sensor: Sensor,
    /// Rank of the fit.
    pub rank: usize,
    /// Every parameter with its standard deviation, SI; `None` from a singular system.
    pub parameters: Vec<(ParameterId, Option<f64>)>,
    /// RMS of the 3-D error at the first target on poses that were not fitted, m; `None` without any.
    pub held_out: Option<f64>,
    /// RMS of the angle to orientations that were not fitted, rad; `None` if none was measured.
    pub held_out_turn: Option<f64>,
    /// Remarks on the fit.
    pub warnings: Vec<String>,
}

/// Measures a scenario's machine with every [`Sensor`] at the scenario's poses, identifies `mode` from each and predicts the verification set.
/// The scenario's tracker reads every point, each with its own noise; the stated uncertainty of every offset is the scenario's. The combined
/// pose takes the places of its three points in the tool as exact. Without a probe in the scenario that one is left out.
///
/// # Errors
///
/// [`PipelineError`], as for a run; also if a point cannot be read.
pub fn compare_sensors(
    scenario: &Scenario,
    seed: u64,
    mode: Mode,
    progress: impl FnMut(u32, u32),
) -> Result<Vec<SensorResult>, PipelineError> {
    // One reading per pose, from the first station: only the sensor differs.
    let scenario = &Scenario { plan: SessionPlan::default(), ..scenario.clone() };
    let simulation = simulate(scenario, seed, 0, PlantKind::Rapier, progress)?;
    let machine = &simulation.truth.as_built;
    let last = machine.kinematics.last_from_flange;
    let flanges: Vec<Vec<Transform>> = simulation
        .truth
        .poses
        .iter()
        .map(|set| set.iter().filter_map(|pose| pose.links.last()).map(|link| link * last).collect())
        .collect();
    let study = Study { scenario, seed, first: machine.target };
    let sensors = Sensor::ALL.into_iter().filter(|s| *s != Sensor::Probe || scenario.probe.is_some());
    let options = IdentificationOptions { mode, ..scenario.options.clone() };
    sensors
        .map(|sensor| {
            let sets = simulation
                .sets
                .iter()
                .zip(&flanges)
                .zip(0_u64..)
                .map(|((set, flanges), index)| study.measured(sensor, set, flanges, index))
                .collect::<Result<Vec<_>, _>>()?;
            study.result(sensor, &sets, &options)
        })
        .collect()
}

struct Study<'a> {
    scenario: &'a Scenario,
    seed: u64,
    /// The real place of the scenario's own target in the flange frame, m.
    first: Vector3<f64>,
}

fn drawn(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal_quantile(rng.random_range(f64::EPSILON..1.0)))
}

impl Study<'_> {
    /// Real places of the three points in the tool's frame, whose axes are the flange's, m.
    fn places() -> [Vector3<f64>; 3] {
        [Vector3::zeros(), ARM * Vector3::x(), ARM * Vector3::y()]
    }

    fn rng(&self, set: u64, pose: usize, point: u64) -> ChaCha8Rng {
        let pose = u64::try_from(pose).unwrap_or(u64::MAX >> 34);
        stream_at(self.seed, 0, StreamSource::SensorComparison, set << 34 | pose << 2 | point)
    }

    /// The statements about the targets, the same for all sets.
    fn targets(&self, sensor: Sensor) -> Vec<Target> {
        let covariance = self.scenario.target_covariance;
        let sigma = covariance[(0, 0)].sqrt();
        let mut rng = stream_at(self.seed, 0, StreamSource::SensorComparison, 3 << 34);
        let error = if self.scenario.tracker.instrument.noise { sigma } else { 0.0 };
        let point = |(place, name): (Vector3<f64>, &str), rng: &mut ChaCha8Rng| Target {
            name: name.to_owned(),
            in_flange: self.first + place + error * drawn(rng),
            covariance: Some(covariance),
            orientation: None,
        };
        let mut points = Vec::new();
        for named in Self::places().into_iter().zip(["SMR 1", "SMR 2", "SMR 3"]) {
            points.push(point(named, &mut rng));
        }
        let first = |orientation| vec![Target { orientation: Some(orientation), ..points[0].clone() }];
        match sensor {
            Sensor::OneSmr => vec![points[0].clone()],
            Sensor::ThreeSmrs | Sensor::AsMeasured => points,
            Sensor::CombinedPose => {
                // As two points an arm apart determine a direction.
                let turn = std::f64::consts::SQRT_2 * sigma / ARM;
                let off = if error > 0.0 { turn * drawn(&mut rng) } else { Vector3::zeros() };
                first(TargetOrientation {
                    flange_from_target: Rotation3::new(off),
                    covariance: Some(Matrix3::identity() * turn * turn),
                })
            }
            Sensor::Probe => match &self.scenario.probe {
                Some(probe) => first(probe.stated(&mut rng)),
                None => points,
            },
        }
    }

    fn read(
        &self,
        flange: &Transform,
        place: &Vector3<f64>,
        rng: &mut ChaCha8Rng,
    ) -> Result<SphericalReading, TrackerError> {
        let in_base = flange.rotation * (self.first + place) + flange.translation.vector;
        self.scenario.tracker.measure(&in_base, &Shot::default(), rng)
    }

    /// A set with the readings of a sensor instead of its own.
    fn measured(
        &self,
        sensor: Sensor,
        set: &SetOutcome,
        flanges: &[Transform],
        index: u64,
    ) -> Result<SetOutcome, PipelineError> {
        let stations: Vec<Station> = set.measurements.stations.clone();
        let mut observations = Vec::new();
        for (pose, (observation, flange)) in set.measurements.observations.iter().zip(flanges).enumerate() {
            let places = Self::places();
            let mut points = Vec::new();
            for (point, place) in (0..).zip(&places) {
                let mut rng = self.rng(index, pose, point);
                let read = self.read(flange, place, &mut rng);
                points.push(read.map_err(|source| PipelineError::Sensor { pose: observation.pose, source })?);
            }
            let taken: Vec<Reading> = match (sensor, &self.scenario.probe) {
                (Sensor::OneSmr, _) => vec![Reading::Spherical(points[0].clone())],
                (Sensor::Probe, Some(probe)) => {
                    let from_flange = self.scenario.tracker.tracker_from_base * flange;
                    let mut rng = self.rng(index, pose, 3);
                    vec![Reading::Pose(Box::new(probe.measure(&points[0], &from_flange, &mut rng)))]
                }
                (Sensor::ThreeSmrs | Sensor::Probe | Sensor::AsMeasured, _) => {
                    points.into_iter().map(Reading::Spherical).collect()
                }
                (Sensor::CombinedPose, _) => vec![Reading::Pose(Box::new(
                    combined(&places, points)
                        .map_err(|source| PipelineError::Combine { pose: observation.pose, source })?,
                ))],
            };
            let of = |(target, reading)| Observation { target, reading, ..observation.clone() };
            observations.extend(taken.into_iter().enumerate().map(of));
        }
        let measurements = MeasurementSet { stations, targets: self.targets(sensor), observations };
        Ok(SetOutcome { kind: set.kind, measurements, dropped: set.dropped.clone() })
    }

    fn result(
        &self,
        sensor: Sensor,
        sets: &[SetOutcome],
        options: &IdentificationOptions,
    ) -> Result<SensorResult, PipelineError> {
        let model = &self.scenario.robot.model;
        let mode = options.mode;
        let empty = MeasurementSet::default();
        let fitted = sets.first().map_or(&empty, |set| &set.measurements);
        let estimate =
            identify(model, fitted, options).map_err(|source| CalibrateError::Identify { mode, source })?;
        let held_out = sets.get(1).map(|set| &set.measurements);
        let mut first = Vec::new();
        let mut angles = Vec::new();
        if let Some(set) = held_out {
            let of_first = |(observation, error): (&Observation, Vector3<f64>)| {
                (observation.target == 0).then_some(error)
            };
            let errors = errors(&estimate.robot, set)?;
            first.extend(set.observations.iter().zip(errors).filter_map(of_first));
            angles = turns(&estimate.robot, set)?;
        }
        Ok(SensorResult {
            sensor,
            rank: estimate.spectrum.rank,
            parameters: estimate.parameters.iter().map(|p| (p.id, p.sigma)).collect(),
            held_out: accuracy(&first).map(|row| row.rms_3d),
            held_out_turn: orientation_accuracy(&angles).map(|row| row.rms),
            warnings: estimate.warnings.iter().map(ToString::to_string).collect(),
        })
    }
}

fn combined(places: &[Vector3<f64>], points: Vec<SphericalReading>) -> Result<PoseReading, CombineError> {
    let readings: Vec<Reading> = points.into_iter().map(Reading::Spherical).collect();
    let points: Vec<_> = places.iter().copied().zip(&readings).collect();
    combine(&points)
}
