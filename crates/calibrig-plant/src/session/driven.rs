//! The same session with other commands: its verification set again, and then a path.

use std::ops::ControlFlow;

use nalgebra::Vector3;
use thiserror::Error;

use super::controller::Controller;
use super::events::SessionEvent;
use super::measure::{Setup, Taken, Visit, empty_set};
use super::{Machine, MeasuringSession, SessionError};
use calibrig_model::ModelError;
use calibrig_model::measurement::{SetKind, SetOutcome};
use calibrig_model::random;

/// Place of a path in the streams of a session, after those of its sets and of a pose test.
const PLACE: u64 = 3 << 32;

/// Measurements with other commands, and the machine's real places.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenSet {
    /// As measured; poses that were not are listed with the reason.
    pub set: SetOutcome,
    /// The target in the base frame, m; one per observation.
    pub attained: Vec<Vector3<f64>>,
}

/// Why commands cannot be driven. `E` is why the machine does not come to rest. Exhaustive, because the caller has to handle every case.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DriveError<E> {
    /// The session around them is invalid.
    #[error(transparent)]
    Session(#[from] SessionError<E>),
    /// A list whose length differs from the set's.
    #[error("{found} commands: expected {expected}, one for each pose of the verification set")]
    Count {
        /// As given.
        found: usize,
        /// Poses of the set.
        expected: usize,
    },
    /// A command of another machine, or with a number that is not finite.
    #[error("command {}: {source}", index + 1)]
    Command {
        /// Its place in the list.
        index: usize,
        /// Why.
        source: ModelError,
    },
    /// A time that is not after that of the point before.
    #[error("point {} is at {time} s: expected a finite time after that of the point before", index + 1)]
    Time {
        /// Its place in the list.
        index: usize,
        /// s
        time: f64,
    },
    /// The machine cannot reach a point of the path.
    #[error("point {}: {source}", index + 1)]
    Point {
        /// Its place in the list.
        index: usize,
        /// Why.
        source: E,
    },
}

/// Receives the number of poses done and of all poses, and may end the drive.
pub type DriveProgress<'a> = dyn FnMut(u32, u32) -> ControlFlow<()> + 'a;

impl MeasuringSession<'_> {
    /// Commands of the verification set's poses in the order in which they are driven, m or rad, and when each is first read, s.
    pub fn verification_commands(&self, seed: u64, trial: u32) -> Vec<(Vec<f64>, f64)> {
        let schedule = self.schedule(seed, trial);
        let of_set = schedule.sets.iter().find(|set| set.kind == SetKind::Verification);
        let poses = of_set.map_or(&[][..], |set| &set.poses);
        poses.iter().map(|(joints, time)| (self.actuators.command_from_joints(joints), *time)).collect()
    }

    /// Measures the verification set again as [`measure`](Self::measure) does, at the same time of day, with the same draws and payloads, but with
    /// other commands for its poses: what it would have shown if these had been driven. With the set's own commands the results are the same to
    /// within rounding.
    ///
    /// # Errors
    ///
    /// [`DriveError`].
    pub fn measure_again<M: Machine>(
        &self,
        machine: &mut M,
        (seed, trial): (u64, u32),
        commands: &[Vec<f64>],
        progress: &mut DriveProgress<'_>,
    ) -> Result<DrivenSet, DriveError<M::Error>> {
        let session = |error: SessionError<M::Error>| DriveError::Session(error);
        self.check_commands(commands)?;
        self.check_session().map_err(session)?;
        let mut schedule = self.schedule(seed, trial);
        let place = schedule.sets.iter().position(|set| set.kind == SetKind::Verification);
        let expected = place.map_or(0, |place| schedule.sets[place].poses.len());
        let Some(place) = place.filter(|_| commands.len() == expected) else {
            return Err(DriveError::Count { found: commands.len(), expected });
        };
        let warmth = self.warmth_behind(&schedule, &schedule.sets[..place]).map_err(|e| session(e.into()))?;
        let trackers = self.trackers(&schedule, seed, trial).map_err(|e| session(e.into()))?;
        let described = self.measure_nests(&trackers, &schedule, (seed, trial)).map_err(session)?;
        let empty = empty_set(SetKind::Verification, &described, &self.measure_targets(seed, trial));
        let setup = Setup { trackers, mounted: self.mounted(seed, trial), seed, trial };
        for ((joints, _), command) in schedule.sets[place].poses.iter_mut().zip(commands) {
            self.actuators.joints_from_command(command, joints);
        }
        let total = u32::try_from(commands.len()).unwrap_or(u32::MAX);
        let mut done = 0;
        let mut hear = |event: SessionEvent<'_>| {
            if !matches!(event, SessionEvent::Measured(_) | SessionEvent::Dropped { .. }) {
                return Ok(());
            }
            done += 1;
            match progress(done, total) {
                ControlFlow::Break(()) if done < total => Err(SessionError::Interrupted { done, total }),
                _ => Ok(()),
            }
        };
        let mut controller = Controller::at_home(self, warmth);
        let planned = &schedule.sets[place];
        let measured =
            self.measure_set(machine, &mut controller, &setup, planned, empty, &mut hear).map_err(session)?;
        let attained = measured.poses.iter().map(|pose| pose.target).collect();
        Ok(DrivenSet { set: measured.set, attained })
    }

    /// Drives a path after both sets: commands (m or rad) with their times, s from its first point on. It is one motion from the home pose, slow
    /// enough to be at rest at every point, where every target is read as in the sets; random differences between approaches are drawn once for the
    /// whole path. Poses count from zero.
    ///
    /// # Errors
    ///
    /// [`DriveError`].
    pub fn measure_path<M: Machine>(
        &self,
        machine: &mut M,
        (seed, trial): (u64, u32),
        points: &[(Vec<f64>, f64)],
        progress: &mut DriveProgress<'_>,
    ) -> Result<DrivenSet, DriveError<M::Error>> {
        let session = |error: SessionError<M::Error>| DriveError::Session(error);
        self.check_session().map_err(session)?;
        let mut last = 0.0;
        for (index, (command, time)) in points.iter().enumerate() {
            self.check_command(index, command)?;
            if !(time.is_finite() && (*time > last || index == 0 && *time >= 0.0)) {
                return Err(DriveError::Time { index, time: *time });
            }
            last = *time;
        }
        let schedule = self.schedule(seed, trial);
        self.as_built.check_effects(schedule.duration + last).map_err(|e| session(e.into()))?;
        let warmth = self.warmth_after(&schedule).map_err(|e| session(e.into()))?;
        let trackers = self.trackers(&schedule, seed, trial).map_err(|e| session(e.into()))?;
        let described = self.measure_nests(&trackers, &schedule, (seed, trial)).map_err(session)?;
        let mut set = empty_set(SetKind::Verification, &described, &self.measure_targets(seed, trial));
        let setup = Setup { trackers, mounted: self.mounted(seed, trial), seed, trial };
        let mut noise = random::stream(seed, trial, random::StreamSource::PathNoise);
        let mut controller = Controller::at_home(self, warmth);
        let mut attained = Vec::new();
        let total = u32::try_from(points.len()).unwrap_or(u32::MAX);
        machine.carry(None).map_err(|source| DriveError::Point { index: 0, source })?;
        for (index, (command, time)) in points.iter().enumerate() {
            let pose = u32::try_from(index).unwrap_or(u32::MAX);
            let time = schedule.duration + time;
            let mut own = random::stream_at(seed, trial, random::StreamSource::Repeatability, PLACE);
            let (settled, effects) = controller
                .go_to(machine, command, time, &mut own)
                .map_err(|source| DriveError::Point { index, source })?;
            let (place, payload, share) = (PLACE | u64::from(pose), None, self.plan.share);
            let controller = &controller;
            let visit = Visit { command, controller, pose, place, time, payload, settled, effects, share };
            let mut taken = Taken::default();
            self.read(&setup, &visit, &mut noise, &mut taken);
            attained.extend(taken.settled.iter().map(|pose| pose.target));
            if taken.observations.is_empty() {
                let why = taken.missing.into_iter().next().map(|missing| missing.why);
                set.dropped.push((pose, why.unwrap_or_else(|| "no reading was planned".to_owned())));
            }
            set.measurements.observations.extend(taken.observations);
            let done = pose.saturating_add(1);
            if progress(done, total).is_break() && done < total {
                return Err(session(SessionError::Interrupted { done, total }));
            }
        }
        Ok(DrivenSet { set, attained })
    }

    fn check_commands<E>(&self, commands: &[Vec<f64>]) -> Result<(), DriveError<E>> {
        commands.iter().enumerate().try_for_each(|(index, command)| self.check_command(index, command))
    }

    fn check_command<E>(&self, index: usize, command: &[f64]) -> Result<(), DriveError<E>> {
        let checked = self.as_built.kinematics.check_joints("command", command);
        checked.map_err(|source| DriveError::Command { index, source })
    }
}
