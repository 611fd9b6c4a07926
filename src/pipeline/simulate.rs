//! The measuring session of a simulated machine.

use std::ops::ControlFlow;

use nalgebra::{Matrix3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::machine::Rest;
use super::session::{MeasuredPose, SessionEvent, SessionListener, counting};
use super::{PipelineError, PlantKind, SetKind, SetOutcome, Simulation, Truth};
use crate::measurement::{MeasurementSet, NestObservation, Observation, Reading, Station, Target};
use crate::plant::effects::{Commanded, DriveState, Friction, PoseEffects};
use crate::plant::{AsBuilt, SettledPose};
use crate::random;
use crate::scenario::Scenario;

/// Time from one pose to the next, s: motion, settling and about 1 s of averaging.
const SECONDS_PER_POSE: f64 = 10.0;

/// Simulates the session of `scenario`: a pure function of (scenario, seed, trial, plant).
///
/// `progress` is told the number of poses done and of all poses.
pub fn simulate(
    scenario: &Scenario,
    seed: u64,
    trial: u32,
    plant: PlantKind,
    progress: impl FnMut(u32, u32),
) -> Result<Simulation, PipelineError> {
    measure_session(scenario, seed, trial, plant, &mut counting(progress))
}

/// The same, told to `listener` while it goes on.
///
/// The machine comes to the first pose of a set from its home pose, the middle of the working region, where it has been referenced.
pub fn measure_session(
    scenario: &Scenario,
    seed: u64,
    trial: u32,
    plant: PlantKind,
    listener: &mut SessionListener<'_>,
) -> Result<Simulation, PipelineError> {
    let scenario = &*scenario.of_trial(seed, trial);
    let total = scenario.identification_poses + scenario.verification_poses;
    scenario.as_built.check_effects(SECONDS_PER_POSE * f64::from(total))?;
    let mut plant = Rest::new(&scenario.as_built, plant)?;
    let station = measure_nests(scenario, seed, trial)?;
    let target = measure_target(scenario, seed, trial);
    let mut done = 0;
    let mut tell = |event: SessionEvent<'_>, done| match listener(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(PipelineError::Interrupted { done, total }),
    };
    let tracker_from_base = &scenario.tracker.tracker_from_base;
    tell(SessionEvent::Begin { as_built: &scenario.as_built, tracker_from_base, poses: total }, done)?;
    let (mut sets, mut poses, mut effects, mut outliers) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (kind, count, [pose_source, noise_source]) in planned_sets(scenario) {
        if count == 0 {
            continue;
        }
        let mut pose_stream = random::stream(seed, trial, pose_source);
        let mut noise = random::stream(seed, trial, noise_source);
        let (mut settled_poses, mut pose_effects, mut set_outliers) = (Vec::new(), Vec::new(), Vec::new());
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
        let mut machine = Machine::at_home(scenario);
        for pose in 0..count {
            let joints = scenario.region.draw(&mut pose_stream);
            let command = scenario.robot.model.actuators.command_from_joints(&joints);
            let time = SECONDS_PER_POSE * f64::from(done);
            let mut own = random::stream_at(seed, trial, random::Source::Repeatability, entry(kind, pose));
            let (settled, effects) = machine
                .go_to(&mut plant, &command, time, &mut own)
                .map_err(|source| PipelineError::Pose { set: kind, pose, source: Box::new(source) })?;
            let outlier = outlier(scenario, seed, trial, entry(kind, pose));
            let seen = settled.target + outlier.unwrap_or_default();
            let reading = scenario.tracker.measure(&seen, &mut noise);
            done += 1;
            match reading {
                Ok(reading) => {
                    set_outliers.extend(outlier.map(|shift| (pose, shift)));
                    let observation = Observation {
                        pose,
                        command,
                        approach: machine.approach.clone(),
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
        as_built: scenario.as_built.clone(),
        tracker_from_base: scenario.tracker.tracker_from_base,
        poses,
        effects,
        outliers,
        rigid: Vec::new(),
    };
    Ok(Simulation { sets, truth })
}

/// The sets with their number of poses, and the random sources of poses and noise.
fn planned_sets(scenario: &Scenario) -> [(SetKind, u32, [random::Source; 2]); 2] {
    use random::Source;
    [
        (
            SetKind::Identification,
            scenario.identification_poses,
            [Source::IdentificationPoses, Source::IdentificationNoise],
        ),
        (
            SetKind::Verification,
            scenario.verification_poses,
            [Source::VerificationPoses, Source::VerificationNoise],
        ),
    ]
}

/// The place of a pose in the random streams of a session, whatever the number of poses of each set.
fn entry(kind: SetKind, pose: u32) -> u64 {
    let set = match kind {
        SetKind::Identification => 0,
        SetKind::Verification => 1,
    };
    set << 32 | u64::from(pose)
}

/// What the reading at that place of the streams is off by, if it is a gross error.
fn outlier(scenario: &Scenario, seed: u64, trial: u32, place: u64) -> Option<Vector3<f64>> {
    scenario.outliers?.draw(&mut random::stream_at(seed, trial, random::Source::Outliers, place))
}

/// The machine between two poses: what its controller and its drives remember.
struct Machine<'a> {
    as_built: &'a AsBuilt,
    command: Vec<f64>,
    /// The sign of each actuator's last motion, 0 before its first.
    approach: Vec<i8>,
    drives: DriveState,
}

impl<'a> Machine<'a> {
    fn at_home(scenario: &'a Scenario) -> Self {
        let command = scenario.robot.model.actuators.command_from_joints(&scenario.region.centre);
        let drives = scenario.as_built.referenced_at(&command);
        Self { as_built: &scenario.as_built, approach: vec![0; command.len()], command, drives }
    }

    /// Approaches a command and comes to rest.
    fn go_to(
        &mut self,
        plant: &mut Rest,
        command: &[f64],
        time: f64,
        rng: &mut impl Rng,
    ) -> Result<(SettledPose, PoseEffects), PipelineError> {
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
        let load = if needs_load { self.drive_loads(&plant.settle(command, &[])?) } else { Vec::new() };
        let pose = Commanded { command, time, load: &load };
        let (effects, drives) = self.as_built.pose_effects(&self.drives, &pose, rng);
        self.drives = drives;
        let settled = plant.settle(&effects.command, &effects.displacements)?;
        Ok((settled, effects))
    }

    /// Load of every drive, N or N m; zero for a rigid drive, which no load deflects.
    fn drive_loads(&self, settled: &SettledPose) -> Vec<f64> {
        let drives = settled.deflection.iter().zip(&self.as_built.statics.drive_stiffness);
        drives.map(|(u, k)| if k.is_finite() { u * k } else { 0.0 }).collect()
    }
}

/// A vector of independent normal errors, or zero where the noise is off.
fn error_vector(scenario: &Scenario, sigma: f64, rng: &mut impl Rng) -> Vector3<f64> {
    let drawn = Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(rng) });
    if scenario.tracker.instrument.noise { sigma * drawn } else { Vector3::zeros() }
}

fn measure_nests(scenario: &Scenario, seed: u64, trial: u32) -> Result<Station, PipelineError> {
    let mut rng = random::stream(seed, trial, random::Source::NestNoise);
    let sigma = scenario.nest_sigma;
    let nests = scenario
        .nests
        .iter()
        .map(|(name, place)| {
            let certified = place + error_vector(scenario, sigma, &mut rng);
            let reading = scenario
                .tracker
                .measure(place, &mut rng)
                .map_err(|source| PipelineError::Nest { nest: name.clone(), source })?;
            Ok(NestObservation {
                name: name.clone(),
                in_base: certified,
                in_base_covariance: Matrix3::identity() * sigma * sigma,
                reading: Reading::Spherical(reading),
            })
        })
        .collect::<Result<_, PipelineError>>()?;
    Ok(Station { name: "1".to_owned(), nests })
}

fn measure_target(scenario: &Scenario, seed: u64, trial: u32) -> Target {
    let mut rng = random::stream(seed, trial, random::Source::TargetOffset);
    let sigma = scenario.target_covariance[(0, 0)].sqrt();
    Target {
        name: "SMR".to_owned(),
        in_flange: scenario.as_built.target + error_vector(scenario, sigma, &mut rng),
        covariance: Some(scenario.target_covariance),
    }
}
