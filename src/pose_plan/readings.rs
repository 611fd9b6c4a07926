//! The readings that a session of any poses would take, as known in advance: from a scenario, or as stated.

use std::ops::Range;

use calibrig_estimation::identification::{CalibratedRobot, PredictionError, Predictor};
use calibrig_model::PoseQuery;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{Face, MeasurementSet, Observation, Reading, SphericalReading};
use calibrig_model::nalgebra::{Matrix3, Vector3};
use calibrig_plant::session::{NestRounds, PayloadOrder, PoseOrder, SessionPlan, Timing};
use calibrig_plant::tracker::{Conditions, Instrument};

use super::{Candidate, PosePlanError};
use crate::pipeline::planned;
use crate::scenario::Scenario;

/// Source of the readings.
#[derive(Debug, Clone)]
// One per plan.
#[allow(clippy::large_enum_variant)]
pub enum Readings<'a> {
    /// The session of a scenario, with the nominal robot instead of its machine.
    Scenario(&'a Scenario),
    /// Every target from every stated station that sees it, with this robot.
    Stated {
        /// The robot: the nominal one, or the one that an earlier session found.
        robot: CalibratedRobot,
        /// Stations and targets; of an earlier session, with its measurements.
        set: MeasurementSet,
        /// Of a reading.
        noise: Noise,
    },
}

/// Noise of a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Noise {
    /// As of an instrument at its distance.
    Instrument(Instrument),
    /// Standard deviation of every coordinate, m.
    Coordinate(f64),
    /// As found by the estimate of an earlier session.
    Found,
}

/// The set of `poses`, numbered from `first` on, as a session of `count` of them would measure each.
pub(super) fn read(
    readings: &Readings<'_>,
    poses: &[Candidate],
    count: usize,
    first: u32,
) -> Result<MeasurementSet, PosePlanError> {
    let numbers = numbers(first, poses.len())?;
    match readings {
        Readings::Scenario(scenario) => of_scenario(scenario, poses, count, first),
        Readings::Stated { robot, set, noise } => {
            let mut planned = set.clone();
            planned.observations = stated(robot, set, *noise, numbers.zip(poses))?;
            Ok(planned)
        }
    }
}

/// Numbers of `count` poses from `first` on.
pub(super) fn numbers(first: u32, count: usize) -> Result<Range<u32>, PosePlanError> {
    let end = u32::try_from(count).ok().and_then(|count| first.checked_add(count));
    end.map(|end| first..end).ok_or(PosePlanError::NoNumbers { next: first, count })
}

fn of_scenario(
    scenario: &Scenario,
    poses: &[Candidate],
    count: usize,
    first: u32,
) -> Result<MeasurementSet, PosePlanError> {
    let mut session = scenario.clone();
    session.identification_poses = u32::try_from(poses.len()).unwrap_or(u32::MAX);
    session.listed[0] = Some(poses.iter().map(|own| own.joints.clone()).collect());
    let SessionPlan { rounds, timing, payloads, .. } = &mut session.plan;
    // Nests once: rounds between all candidates would place the tracker far better than those between the chosen poses.
    let again = rounds.every > 0 || rounds.after;
    *rounds = NestRounds { every: 0, after: false, ..*rounds };
    if again {
        // Drift is removed.
        session.tracker.conditions = Conditions { drift: None, ..session.tracker.conditions };
    }
    let share = count as f64 / poses.len().max(1) as f64;
    *timing = Timing { motion: share * timing.motion, settling: share * timing.settling, ..*timing };
    payloads.order = PayloadOrder::Cycle;
    session.plan.order = PoseOrder::AsDrawn;
    let mut set = planned(&session)?;
    // Poses of a session count from zero; invisible ones have no observation.
    set.observations.iter_mut().for_each(|own| own.pose = own.pose.saturating_add(first));
    Ok(set)
}

fn stated<'a>(
    robot: &CalibratedRobot,
    set: &MeasurementSet,
    noise: Noise,
    poses: impl Iterator<Item = (u32, &'a Candidate)>,
) -> Result<Vec<Observation>, PredictionError> {
    let mut predictor = Predictor::new(robot)?;
    let identity = Transform::identity();
    let mut observations = Vec::new();
    for (pose, own) in poses {
        let command = robot.model.actuators.command_from_joints(&own.joints);
        for target in 0..set.targets.len() {
            let in_base = predictor.in_base(PoseQuery::at(&command).with_target(target))?;
            for station in (0..set.stations.len()).filter(|station| own.is_seen(*station, target)) {
                let from_base = robot.stations.get(station).unwrap_or(&identity);
                let seen = from_base.rotation * in_base + from_base.translation.vector;
                observations.push(Observation {
                    pose,
                    command: command.clone(),
                    approach: Vec::new(),
                    since_reversal: Vec::new(),
                    temperature: None,
                    time: 0.0,
                    station,
                    target,
                    payload: None,
                    reading: reading(seen, noise),
                });
            }
        }
    }
    Ok(observations)
}

fn reading(seen: Vector3<f64>, noise: Noise) -> Reading {
    let cartesian = |covariance| Reading::Cartesian { position: seen, covariance };
    match noise {
        Noise::Found => cartesian(None),
        Noise::Coordinate(sigma) => cartesian(Some(Matrix3::identity() * sigma * sigma)),
        Noise::Instrument(instrument) => {
            let range = seen.norm().max(1e-3);
            let along = instrument.random_fraction * instrument.range.at(range);
            let angle =
                (instrument.random_fraction * instrument.transverse.at(range) / range).hypot(instrument.air);
            let variances = Vector3::new(along, angle, angle).map(|sigma| sigma * sigma);
            Reading::Spherical(SphericalReading {
                range,
                azimuth: seen.y.atan2(seen.x),
                elevation: seen.z.atan2(seen.x.hypot(seen.y)),
                covariance: Some(Matrix3::from_diagonal(&variances)),
                face: Face::Front,
            })
        }
    }
}
