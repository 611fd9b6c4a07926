//! The cycles of a pose test (ISO 9283), after a measuring session.

use std::ops::ControlFlow;

use nalgebra::Vector3;
use thiserror::Error;

use super::controller::Controller;
use super::measure::{READING, Setup};
use super::{Machine, MeasuringSession, SessionError};
use crate::tracker::{Shot, TrackerError};
use calibrig_model::measurement::{MeasurementSet, Observation};
use calibrig_model::random;

/// Place of the test in the streams of a session, after those of its two sets.
const PLACE: u64 = 2 << 32;

/// The cycles as measured, and the machine's real places.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleMeasurements {
    /// In the order taken; poses count from one in the order in which they were given.
    pub measurements: MeasurementSet,
    /// The target in the base frame, m; one per observation.
    pub attained: Vec<Vector3<f64>>,
}

/// Why cycles cannot be measured. `E` is why the machine does not come to rest. Exhaustive, because the caller of a test has to handle
/// every case.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CycleError<E> {
    /// The session around them is invalid.
    #[error(transparent)]
    Session(#[from] SessionError<E>),
    /// A pose of another machine, or an invalid one.
    #[error("P{pose} has {found} joint variables: expected {expected} finite ones")]
    Joints {
        /// Number of the pose, from one.
        pose: u32,
        /// Its finite numbers.
        found: usize,
        /// The machine's joints.
        expected: usize,
    },
    /// The machine cannot reach a pose.
    #[error("P{pose} in cycle {cycle}: {source}")]
    Pose {
        /// Number of the pose, from one.
        pose: u32,
        /// Number of the cycle, from one; 0 on the way to the first.
        cycle: u32,
        /// Why.
        source: E,
    },
    /// Something hides a target from the tracker.
    #[error("P{pose} in cycle {cycle}: {why}")]
    Hidden {
        /// Number of the pose, from one.
        pose: u32,
        /// Number of the cycle, from one.
        cycle: u32,
        /// What.
        why: String,
    },
    /// The tracker cannot read a pose.
    #[error("P{pose} in cycle {cycle}: {source}")]
    Reading {
        /// Number of the pose, from one.
        pose: u32,
        /// Number of the cycle, from one.
        cycle: u32,
        /// Why.
        source: TrackerError,
    },
}

impl MeasuringSession<'_> {
    /// Drives `cycles` cycles over `poses` (joint variables, P1 first), and measures every target at every one from the first station. The machine
    /// goes to P1, and then in every cycle through the poses from the last one to P1, so that each has one approach. Machine, tracker and set-up are
    /// those of [`measure`](Self::measure), and the clock continues from the end of both its sets. `progress` receives the number of poses done and
    /// of all poses, and may end the test.
    ///
    /// # Errors
    ///
    /// [`CycleError`].
    pub fn measure_cycles<M: Machine>(
        &self,
        machine: &mut M,
        (seed, trial): (u64, u32),
        poses: &[Vec<f64>],
        cycles: u32,
        progress: &mut dyn FnMut(u32, u32) -> ControlFlow<()>,
    ) -> Result<CycleMeasurements, CycleError<M::Error>> {
        let session = |error: SessionError<M::Error>| CycleError::Session(error);
        let count = u32::try_from(poses.len()).unwrap_or(u32::MAX);
        let total = cycles.saturating_mul(count);
        let schedule = self.schedule(seed, trial);
        let of_pose = self.plan.seconds_per_pose();
        let end = schedule.duration + of_pose * (f64::from(total) + 1.0);
        let expected = self.as_built.kinematics.joint_count();
        self.region.check(expected).map_err(|e| session(e.into()))?;
        for (pose, joints) in (1..).zip(poses) {
            let found = joints.iter().filter(|q| q.is_finite()).count();
            if found != expected || joints.len() != expected {
                return Err(CycleError::Joints { pose, found, expected });
            }
        }
        self.as_built.check_effects(end).map_err(|e| session(e.into()))?;
        let mut noise = random::stream(seed, trial, random::StreamSource::Iso9283Noise);
        let trackers = self.trackers(&schedule, seed, trial).map_err(|e| session(e.into()))?;
        let mut test = CycleMeasurements {
            measurements: MeasurementSet {
                stations: self.measure_nests(&trackers, &schedule, (seed, trial)).map_err(session)?,
                targets: self.measure_targets(seed, trial),
                observations: Vec::new(),
            },
            attained: Vec::new(),
        };
        // The first station measures the test.
        let setup = Setup { trackers, mounted: self.mounted(seed, trial), seed, trial };
        let commands: Vec<_> = poses.iter().map(|q| self.actuators.command_from_joints(q)).collect();
        machine.carry(None).map_err(|source| CycleError::Pose { pose: 1, cycle: 0, source })?;
        let warmth = self.warmth_after(&schedule).map_err(|e| session(e.into()))?;
        let mut controller = Controller::at_home(self, warmth);
        let mut visited = 0_u32;
        let lead_in = commands.first().map(|command| (0, 1, command));
        let numbered: Vec<(u32, &Vec<f64>)> = (1..=count).zip(&commands).collect();
        let backward = || numbered.iter().rev();
        let driven =
            (1..=cycles).flat_map(|cycle| backward().map(move |(pose, command)| (cycle, *pose, *command)));
        for (cycle, pose, command) in lead_in.into_iter().chain(driven) {
            let time = schedule.duration + of_pose * f64::from(visited);
            let place = PLACE | u64::from(visited);
            let mut own = random::stream_at(seed, trial, random::StreamSource::Repeatability, place);
            let (settled, effects) = controller
                .go_to(machine, command, time, &mut own)
                .map_err(|source| CycleError::Pose { pose, cycle, source })?;
            visited += 1;
            if cycle == 0 {
                continue;
            }
            let seen = self.look(&setup.trackers, &setup.mounted, &settled);
            let averaging = self.plan.timing.averaging;
            for (target, at) in seen.places.iter().enumerate() {
                if let Some(hidden) = &seen.hidden[0][target] {
                    return Err(CycleError::Hidden { pose, cycle, why: hidden.to_string() });
                }
                let time = time + averaging * target as f64;
                let of_target = place + target as u64 * READING;
                let point = at.optical + self.outlier(&setup, of_target).unwrap_or_default();
                let shot = Shot { averaging, ..Shot::at(time) };
                let tracker = &setup.trackers[0];
                let reading = tracker
                    .measure(&point, &shot, &mut noise)
                    .map_err(|source| CycleError::Reading { pose, cycle, source })?;
                let now = tracker.tracker_from_base_at(time);
                let reading = self.reading(reading, target, &settled, &now, (seed, trial, of_target));
                test.attained.push(at.centre);
                test.measurements.observations.push(Observation {
                    pose,
                    command: command.clone(),
                    approach: controller.motion.approach.clone(),
                    since_reversal: controller.motion.since_reversal.clone(),
                    temperature: effects.temperature,
                    time,
                    station: 0,
                    target,
                    payload: None,
                    reading,
                });
            }
            let done = visited - 1;
            if progress(done, total).is_break() && done < total {
                return Err(session(SessionError::Interrupted { done, total }));
            }
        }
        Ok(test)
    }
}
