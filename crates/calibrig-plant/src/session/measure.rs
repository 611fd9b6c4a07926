//! The order of a session: sets and poses, what the machine does on its way, what the tracker reads.

use std::ops::ControlFlow;

use nalgebra::{Matrix3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::events::{MeasuredPose, SessionEvent, SessionListener};
use super::{Machine, SessionError, Simulation, Truth};
use crate::effects::{Commanded, DriveState, Friction, PoseEffects};
use crate::experiment::WorkingRegion;
use crate::tracker::{LaserTracker, Outliers};
use crate::{AsBuilt, SettledPose};
use calibrig_model::ActuatorMap;
use calibrig_model::measurement::{
    MeasurementSet, NestObservation, Observation, Reading, SetKind, SetOutcome, Station, Target,
};
use calibrig_model::random;

/// Time from one pose to the next, s: motion, settling and about 1 s of averaging.
pub const SECONDS_PER_POSE: f64 = 10.0;

/// What is measured, where, and with what. What comes out of it is a pure function of this, the machine, the seed and the trial.
#[derive(Debug, Clone, Copy)]
pub struct MeasuringSession<'a> {
    /// The machine: its effects, its target, and what its controller does not know.
    pub as_built: &'a AsBuilt,
    /// From joint variables to commands, as the controller believes.
    pub actuators: &'a ActuatorMap,
    /// Where poses are drawn. Its middle is the home pose, where the machine has been referenced.
    pub region: &'a WorkingRegion,
    /// Poses of the identification set.
    pub identification_poses: u32,
    /// Poses of the verification set.
    pub verification_poses: u32,
    /// The tracker at its real place.
    pub tracker: &'a LaserTracker,
    /// Gross errors among its readings of the target, where there are any.
    pub outliers: Option<&'a Outliers>,
    /// Base nests: name and true place in the base frame, m.
    pub nests: &'a [(String, Vector3<f64>)],
    /// Standard deviation of the nests' certified coordinates, m.
    pub nest_sigma: f64,
    /// Covariance of the measured target offset, m².
    pub target_covariance: &'a Matrix3<f64>,
}

impl MeasuringSession<'_> {
    /// Measures with `machine`, which stands for [`as_built`](Self::as_built), and tells `listener` what happens.
    ///
    /// The machine comes to the first pose of a set from its home pose.
    pub fn measure<M: Machine>(
        &self,
        machine: &mut M,
        seed: u64,
        trial: u32,
        listener: &mut SessionListener<'_>,
    ) -> Result<Simulation, SessionError<M::Error>> {
        let total = self.identification_poses.saturating_add(self.verification_poses);
        self.region.check(self.as_built.kinematics.joint_count())?;
        self.as_built.check_effects(SECONDS_PER_POSE * f64::from(total))?;
        let station = self.measure_nests(seed, trial)?;
        let target = self.measure_target(seed, trial);
        let mut done = 0;
        let mut tell = |event: SessionEvent<'_>, done| match listener(event) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(SessionError::Interrupted { done, total }),
        };
        let tracker_from_base = &self.tracker.tracker_from_base;
        tell(SessionEvent::Begin { as_built: self.as_built, tracker_from_base, poses: total }, done)?;
        let (mut sets, mut poses, mut effects, mut outliers) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (kind, count, [pose_source, noise_source]) in self.planned_sets() {
            if count == 0 {
                continue;
            }
            let mut pose_stream = random::stream(seed, trial, pose_source);
            let mut noise = random::stream(seed, trial, noise_source);
            let (mut settled_poses, mut pose_effects, mut set_outliers) =
                (Vec::new(), Vec::new(), Vec::new());
            let mut set = SetOutcome {
                kind,
                measurements: MeasurementSet {
                    stations: vec![station.clone()],
                    targets: vec![target.clone()],
                    observations: Vec::new(),
                },
                dropped: Vec::new(),
            };
            tell(SessionEvent::Set { set: &set, planned: count }, done)?;
            let mut controller = Controller::at_home(self);
            for pose in 0..count {
                let joints = self.region.draw(&mut pose_stream);
                let command = self.actuators.command_from_joints(&joints);
                let time = SECONDS_PER_POSE * f64::from(done);
                let mut own =
                    random::stream_at(seed, trial, random::Source::Repeatability, entry(kind, pose));
                let (settled, effects) = controller
                    .go_to(machine, &command, time, &mut own)
                    .map_err(|source| SessionError::Pose { set: kind, pose, source })?;
                let outlier = self.outlier(seed, trial, entry(kind, pose));
                let seen = settled.target + outlier.unwrap_or_default();
                let reading = self.tracker.measure(&seen, &mut noise);
                done += 1;
                match reading {
                    Ok(reading) => {
                        set_outliers.extend(outlier.map(|shift| (pose, shift)));
                        let observation = Observation {
                            pose,
                            command,
                            approach: controller.approach.clone(),
                            temperature: effects.temperature,
                            time,
                            station: 0,
                            target: 0,
                            reading: Reading::Spherical(reading),
                        };
                        let measured = MeasuredPose {
                            kind,
                            index: set.measurements.observations.len(),
                            observation: &observation,
                            settled: &settled,
                            rigid: None,
                            effects: &effects,
                        };
                        tell(SessionEvent::Measured(measured), done)?;
                        set.measurements.observations.push(observation);
                        settled_poses.push(settled);
                        pose_effects.push(effects);
                    }
                    Err(error) => {
                        let reason = error.to_string();
                        tell(SessionEvent::Dropped { kind, pose, reason: &reason, time }, done)?;
                        set.dropped.push((pose, reason));
                    }
                }
            }
            tell(SessionEvent::SetEnd { set: &set }, done)?;
            sets.push(set);
            poses.push(settled_poses);
            effects.push(pose_effects);
            outliers.push(set_outliers);
        }
        let truth = Truth {
            as_built: self.as_built.clone(),
            tracker_from_base: self.tracker.tracker_from_base,
            poses,
            effects,
            outliers,
            rigid: Vec::new(),
        };
        Ok(Simulation { sets, truth })
    }

    /// The sets with their number of poses, and the random sources of poses and noise.
    fn planned_sets(&self) -> [(SetKind, u32, [random::Source; 2]); 2] {
        use random::Source;
        [
            (
                SetKind::Identification,
                self.identification_poses,
                [Source::IdentificationPoses, Source::IdentificationNoise],
            ),
            (
                SetKind::Verification,
                self.verification_poses,
                [Source::VerificationPoses, Source::VerificationNoise],
            ),
        ]
    }

    /// What the reading at that place of the streams is off by, if it is a gross error.
    pub(super) fn outlier(&self, seed: u64, trial: u32, place: u64) -> Option<Vector3<f64>> {
        self.outliers?.draw(&mut random::stream_at(seed, trial, random::Source::Outliers, place))
    }

    /// A vector of independent normal errors, or zero where the noise is off.
    fn error_vector(&self, sigma: f64, rng: &mut impl Rng) -> Vector3<f64> {
        let drawn = Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(rng) });
        if self.tracker.instrument.noise { sigma * drawn } else { Vector3::zeros() }
    }

    pub(super) fn measure_nests<E>(&self, seed: u64, trial: u32) -> Result<Station, SessionError<E>> {
        let mut rng = random::stream(seed, trial, random::Source::NestNoise);
        let sigma = self.nest_sigma;
        let nests = self
            .nests
            .iter()
            .map(|(name, place)| {
                let certified = place + self.error_vector(sigma, &mut rng);
                let reading = self
                    .tracker
                    .measure(place, &mut rng)
                    .map_err(|source| SessionError::Nest { nest: name.clone(), source })?;
                Ok(NestObservation {
                    name: name.clone(),
                    in_base: certified,
                    in_base_covariance: Matrix3::identity() * sigma * sigma,
                    reading: Reading::Spherical(reading),
                    time: None,
                })
            })
            .collect::<Result<_, SessionError<E>>>()?;
        Ok(Station { name: "1".to_owned(), nests, instrument: None })
    }

    pub(super) fn measure_target(&self, seed: u64, trial: u32) -> Target {
        let mut rng = random::stream(seed, trial, random::Source::TargetOffset);
        let sigma = self.target_covariance[(0, 0)].sqrt();
        Target {
            name: "SMR".to_owned(),
            in_flange: self.as_built.target + self.error_vector(sigma, &mut rng),
            covariance: Some(*self.target_covariance),
            orientation: None,
        }
    }
}

/// The place of a pose in the random streams of a session, whatever the number of poses of each set.
fn entry(kind: SetKind, pose: u32) -> u64 {
    let set = match kind {
        SetKind::Identification => 0,
        SetKind::Verification => 1,
    };
    set << 32 | u64::from(pose)
}

/// The machine between two poses: what its controller and its drives remember.
pub(super) struct Controller<'a> {
    as_built: &'a AsBuilt,
    command: Vec<f64>,
    /// The sign of each actuator's last motion, 0 before its first.
    pub approach: Vec<i8>,
    drives: DriveState,
}

impl<'a> Controller<'a> {
    pub fn at_home(session: &MeasuringSession<'a>) -> Self {
        let command = session.actuators.command_from_joints(&session.region.centre);
        let drives = session.as_built.referenced_at(&command);
        Self { as_built: session.as_built, approach: vec![0; command.len()], command, drives }
    }

    /// Approaches a command and comes to rest.
    pub fn go_to<M: Machine>(
        &mut self,
        machine: &mut M,
        command: &[f64],
        time: f64,
        rng: &mut impl Rng,
    ) -> Result<(SettledPose, PoseEffects), M::Error> {
        for (approach, (now, before)) in self.approach.iter_mut().zip(command.iter().zip(&self.command)) {
            match now.total_cmp(before) {
                std::cmp::Ordering::Less => *approach = -1,
                std::cmp::Ordering::Equal => {}
                std::cmp::Ordering::Greater => *approach = 1,
            }
        }
        self.command.copy_from_slice(command);
        let needs_load = self.as_built.effects.friction.as_ref().is_some_and(Friction::needs_load);
        // Friction is too small to change the load that it depends on.
        let load = if needs_load { self.drive_loads(&machine.settle(command, &[])?) } else { Vec::new() };
        let pose = Commanded { command, time, load: &load };
        let (effects, drives) = self.as_built.pose_effects(&self.drives, &pose, rng);
        self.drives = drives;
        let settled = machine.settle(&effects.command, &effects.displacements)?;
        Ok((settled, effects))
    }

    /// Load of every drive, N or N m; zero for a rigid drive, which no load deflects.
    fn drive_loads(&self, settled: &SettledPose) -> Vec<f64> {
        let drives = settled.deflection.iter().zip(&self.as_built.statics.drive_stiffness);
        drives.map(|(u, k)| if k.is_finite() { u * k } else { 0.0 }).collect()
    }
}
