//! The course of a session: sets and poses, what the machine does on its way, what the trackers read.

use std::ops::ControlFlow;

use nalgebra::{Matrix3, Vector3, Vector6};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::controller::Controller;
use super::events::{MeasuredPose, SessionEvent, SessionListener};
use super::plan::{Approach, SessionPlan, StationShare};
use super::schedule::{PlannedSet, Schedule, schedule};
use super::sight::Mounted;
use super::{Machine, MissingReading, SessionError, Simulation, Truth};
use crate::effects::{EffectError, PoseEffects, Warmth};
use crate::experiment::{WorkingRegion, check_listed};
use crate::tracker::{LaserTracker, Outliers, Probe, Shot, TrackerError, is_missed};
use crate::{AsBuilt, SettledPose};
use calibrig_model::geometry::{Transform, rotation_vector, small_displacement};
use calibrig_model::measurement::{
    InstrumentTerm, MeasurementSet, Observation, Reading, SetKind, SetOutcome, SphericalReading, Station,
    Target,
};
use calibrig_model::random::{self, StreamSource};
use calibrig_model::{ActuatorMap, JointKind, Payload};

/// What is measured, where, and with what. The results are a pure function of this, the machine, the seed and the trial.
#[derive(Debug, Clone, Copy)]
pub struct MeasuringSession<'a> {
    /// The machine: its effects, its target, and what its controller does not know.
    pub as_built: &'a AsBuilt,
    /// From joint variables to commands, as the controller believes.
    pub actuators: &'a ActuatorMap,
    /// Where poses are drawn. Its middle is the home pose, where the machine has been referenced.
    pub region: &'a WorkingRegion,
    /// Joint variables of the poses of the identification and of the verification set that are listed instead of drawn, in their order.
    pub listed: [Option<&'a [Vec<f64>]>; 2],
    /// Poses of the identification set.
    pub identification_poses: u32,
    /// Poses of the verification set.
    pub verification_poses: u32,
    /// The tracker at its real place: the first station.
    pub tracker: &'a LaserTracker,
    /// Gross errors among the readings of targets, if any.
    pub outliers: Option<&'a Outliers>,
    /// What measures the target's orientation together with its place; `None` if the target is a point.
    pub probe: Option<&'a Probe>,
    /// Base nests: name and true place in the base frame, m.
    pub nests: &'a [(String, Vector3<f64>)],
    /// Standard deviation of the nests' certified coordinates, m.
    pub nest_sigma: f64,
    /// Covariance of the measured offset of each target, m².
    pub target_covariance: &'a Matrix3<f64>,
    /// How it is carried out.
    pub plan: &'a SessionPlan,
}

/// Readings of a pose, one entry per reading in each list.
#[derive(Default)]
pub(super) struct Taken {
    pub observations: Vec<Observation>,
    pub settled: Vec<SettledPose>,
    effects: Vec<PoseEffects>,
    outliers: Vec<(u32, Vector3<f64>)>,
    /// Planned readings that were not taken.
    pub missing: Vec<MissingReading>,
}

/// Receives the events of a set, and may end it.
type Hearer<'a, E> = dyn FnMut(SessionEvent<'_>) -> Result<(), SessionError<E>> + 'a;

/// A set as measured, together with the truth.
pub(super) struct MeasuredSet {
    pub set: SetOutcome,
    pub poses: Vec<SettledPose>,
    effects: Vec<PoseEffects>,
    outliers: Vec<(u32, Vector3<f64>)>,
    missing: Vec<MissingReading>,
}

/// The trackers and targets of a session with their errors.
pub(super) struct Setup {
    pub trackers: Vec<LaserTracker>,
    pub mounted: Vec<Mounted>,
    pub seed: u64,
    pub trial: u32,
}

impl MeasuringSession<'_> {
    /// Measures with `machine`, which stands for [`as_built`](Self::as_built), and reports events to `listener`.
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
        self.check_session()?;
        let schedule = self.schedule(seed, trial);
        self.as_built.check_effects(schedule.duration)?;
        self.warmth_after(&schedule)?;
        let trackers = self.trackers(&schedule, seed, trial)?;
        let mut described = self.measure_nests(&trackers, &schedule, (seed, trial))?;
        let targets = self.measure_targets(seed, trial);
        let stations = self.mean_places(&trackers, &schedule);
        let further_targets: Vec<_> = self.plan.targets.iter().map(|target| target.in_flange).collect();
        let setup = Setup { trackers, mounted: self.mounted(seed, trial), seed, trial };
        let (sweeps_missing, mut warmth) = self.measure_sweeps(machine, &setup, &schedule, &mut described)?;
        let mut done = 0;
        let mut tell = |event: SessionEvent<'_>, done| match listener(event) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(SessionError::Interrupted { done, total }),
        };
        let payloads: Vec<_> =
            self.plan.payloads.payloads.iter().map(|payload| payload.real.clone()).collect();
        let begin = SessionEvent::Begin {
            as_built: self.as_built,
            stations: &stations,
            further_targets: &further_targets,
            payloads: &payloads,
            poses: total,
        };
        tell(begin, done)?;
        let mut truth = Truth {
            as_built: self.as_built.clone(),
            stations: stations.clone(),
            payloads: payloads.clone(),
            instrument: shared_errors(&setup.trackers),
            further_targets: further_targets.clone(),
            orientation: self.probe.map(|probe| probe.flange_from_target),
            poses: Vec::new(),
            effects: Vec::new(),
            outliers: Vec::new(),
            rigid: Vec::new(),
        };
        let (mut sets, mut missing) = (Vec::new(), Vec::new());
        for planned in &schedule.sets {
            let empty = empty_set(planned.kind, &described, &targets);
            let mut controller = Controller::at_home(self, warmth);
            let mut hear = |event: SessionEvent<'_>| {
                done += u32::from(matches!(event, SessionEvent::Measured(_) | SessionEvent::Dropped { .. }));
                tell(event, done)
            };
            let measured = self.measure_set(machine, &mut controller, &setup, planned, empty, &mut hear)?;
            warmth = controller.warmth().clone();
            sets.push(measured.set);
            missing.push(measured.missing);
            truth.poses.push(measured.poses);
            truth.effects.push(measured.effects);
            truth.outliers.push(measured.outliers);
        }
        Ok(Simulation { sets, missing, sweeps_missing, truth })
    }

    pub(super) fn check_session<E>(&self) -> Result<(), SessionError<E>> {
        let joints = self.as_built.kinematics.joint_count();
        self.region.check(joints)?;
        self.listed.into_iter().flatten().flatten().try_for_each(|pose| check_listed(pose, joints))?;
        Ok(self.plan.check(self.identification_poses.max(self.verification_poses))?)
    }

    /// The poses of a set in order, with the events reported to `hear`.
    pub(super) fn measure_set<M: Machine>(
        &self,
        machine: &mut M,
        controller: &mut Controller<'_>,
        setup: &Setup,
        planned: &PlannedSet,
        mut set: SetOutcome,
        hear: &mut Hearer<'_, M::Error>,
    ) -> Result<MeasuredSet, SessionError<M::Error>> {
        let mut noise = random::stream(setup.seed, setup.trial, planned.noise);
        let count = u32::try_from(planned.poses.len()).unwrap_or(u32::MAX);
        hear(SessionEvent::Set { set: &set, planned: count })?;
        let (mut poses, mut effects, mut outliers, mut missing) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for pose in 0..count {
            let taken = self.take(machine, controller, setup, planned, pose, &mut noise);
            let taken = taken.map_err(|source| SessionError::Pose { set: planned.kind, pose, source })?;
            if taken.observations.is_empty() {
                let first = taken.missing.into_iter().next();
                let reason = first.map_or_else(|| "no reading was planned".to_owned(), |m| m.why);
                let (kind, time) = (planned.kind, planned.poses[pose as usize].1);
                hear(SessionEvent::Dropped { kind, pose, reason: &reason, time })?;
                set.dropped.push((pose, reason));
                continue;
            }
            let measured = MeasuredPose {
                kind: planned.kind,
                first: set.measurements.observations.len(),
                observations: &taken.observations,
                settled: &taken.settled,
                rigid: &[],
                effects: &taken.effects,
            };
            hear(SessionEvent::Measured(measured))?;
            set.measurements.observations.extend(taken.observations);
            poses.extend(taken.settled);
            effects.extend(taken.effects);
            outliers.extend(taken.outliers);
            missing.extend(taken.missing);
        }
        hear(SessionEvent::SetEnd { set: &set })?;
        Ok(MeasuredSet { set, poses, effects, outliers, missing })
    }

    pub(super) fn schedule(&self, seed: u64, trial: u32) -> Schedule {
        let counts = [
            (SetKind::Identification, self.identification_poses),
            (SetKind::Verification, self.verification_poses),
        ];
        let mut schedule =
            schedule(self.plan, (self.region, self.listed), counts, self.nests.len(), (seed, trial));
        let rounds = schedule.rounds.iter_mut().map(|round| &mut round.joints);
        let poses = schedule.sets.iter_mut().flat_map(|set| &mut set.poses).map(|(joints, _)| joints);
        rounds.chain(poses).for_each(|joints| self.actuators.follow(joints));
        schedule
    }

    /// `tracker_from_base` of every station at its mean over the rounds of nests, in the session of (seed, trial).
    ///
    /// # Errors
    ///
    /// The tracker's figures are invalid.
    pub fn stations(&self, seed: u64, trial: u32) -> Result<Vec<Transform>, TrackerError> {
        let schedule = self.schedule(seed, trial);
        Ok(self.mean_places(&self.trackers(&schedule, seed, trial)?, &schedule))
    }

    /// How long the session lasts, s.
    pub fn duration(&self) -> f64 {
        self.schedule(0, 0).duration
    }

    /// Every station's tracker, with the errors that it has in this session.
    pub(super) fn trackers(
        &self,
        schedule: &Schedule,
        seed: u64,
        trial: u32,
    ) -> Result<Vec<LaserTracker>, TrackerError> {
        let further = self.plan.stations.iter().map(|station| station.tracker_from_base);
        std::iter::once(self.tracker.tracker_from_base)
            .chain(further)
            .zip(0..)
            .map(|(tracker_from_base, station)| {
                let placed = LaserTracker { tracker_from_base, ..self.tracker.clone() };
                if placed.has_law() {
                    placed.drawn(seed, trial, station, schedule.duration)
                } else {
                    Ok(placed)
                }
            })
            .collect()
    }

    fn mean_places(&self, trackers: &[LaserTracker], schedule: &Schedule) -> Vec<Transform> {
        let times = self.nest_times(schedule);
        trackers
            .iter()
            .map(|tracker| {
                let first = tracker.tracker_from_base;
                let moved = |time: &f64| {
                    let motion = tracker.tracker_from_base_at(*time) * first.inverse();
                    let (v, w) = (motion.translation.vector, rotation_vector(&motion.rotation));
                    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
                };
                if tracker.errors.drift.is_none() || times.is_empty() {
                    return first;
                }
                let mean = times.iter().map(moved).sum::<Vector6<f64>>() / times.len() as f64;
                small_displacement(&mean) * first
            })
            .collect()
    }

    /// The drives' heat after the whole schedule.
    ///
    /// # Errors
    ///
    /// On its way a part gets warmer than any drive in service makes it.
    pub(super) fn warmth_after(&self, schedule: &Schedule) -> Result<Warmth, EffectError> {
        self.warmth_behind(schedule, &schedule.sets)
    }

    /// The same after the sweeps and some of the sets.
    pub(super) fn warmth_behind(
        &self,
        schedule: &Schedule,
        sets: &[PlannedSet],
    ) -> Result<Warmth, EffectError> {
        let Some(thermal) = self.as_built.effects.thermal.as_ref().filter(|t| t.is_heated()) else {
            return Ok(Warmth::default());
        };
        let mut controller = Controller::at_home(self, Warmth::default());
        for (joints, time) in &schedule.sweeps {
            controller.warm(&self.actuators.command_from_joints(joints), *time);
            thermal.check_warmth(controller.warmth())?;
        }
        for planned in sets {
            controller = Controller::at_home(self, controller.warmth().clone());
            for (joints, start) in &planned.poses {
                for visit in 0..self.plan.repeats {
                    let time = self.time_of_visit(*start, visit);
                    for joints in self.beside(joints, visit).iter().chain([joints]) {
                        controller.warm(&self.actuators.command_from_joints(joints), time);
                    }
                    thermal.check_warmth(controller.warmth())?;
                }
            }
        }
        Ok(controller.warmth().clone())
    }

    fn time_of_visit(&self, start: f64, visit: u32) -> f64 {
        start + self.plan.seconds_per_pose() / f64::from(self.plan.repeats) * f64::from(visit)
    }

    /// All visits of a pose.
    fn take<M: Machine>(
        &self,
        machine: &mut M,
        controller: &mut Controller<'_>,
        setup: &Setup,
        planned: &PlannedSet,
        pose: u32,
        noise: &mut impl Rng,
    ) -> Result<Taken, M::Error> {
        let (seed, trial) = (setup.seed, setup.trial);
        let (joints, start) = &planned.poses[pose as usize];
        let command = self.actuators.command_from_joints(joints);
        let payload = self.plan.payloads.at(planned.kind, pose as usize, planned.poses.len());
        machine.carry(payload.map(|payload| &payload.real))?;
        let payload = payload.map(|payload| &payload.stated);
        let mut taken = Taken::default();
        for visit in 0..self.plan.repeats {
            let time = self.time_of_visit(*start, visit);
            let place = entry(planned.kind, pose) | u64::from(visit) << 34;
            if let Some(beside) = self.beside(joints, visit) {
                let mut own = random::stream_at(seed, trial, StreamSource::Repeatability, place | VIA);
                let via = self.actuators.command_from_joints(&beside);
                controller.pass(machine, &via, time, &mut own)?;
            }
            let mut own = random::stream_at(seed, trial, StreamSource::Repeatability, place);
            let (settled, effects) = controller.go_to(machine, &command, time, &mut own)?;
            let share = self.plan.share;
            let visit =
                Visit { command: &command, controller, pose, place, time, payload, settled, effects, share };
            self.read(setup, &visit, noise, &mut taken);
        }
        Ok(taken)
    }

    /// Joint variables near a pose, from which a visit comes.
    fn beside(&self, joints: &[f64], visit: u32) -> Option<Vec<f64>> {
        let (distances, side) = match self.plan.approach {
            Approach::AsTravelled => return None,
            Approach::OneSide(distances) => (distances, -1.0),
            Approach::BothSides(distances) => (distances, if visit.is_multiple_of(2) { -1.0 } else { 1.0 }),
        };
        let links = &self.as_built.kinematics.links;
        let away = |(joint, link): (&f64, &calibrig_model::CraigLink)| {
            let distance = match link.kind {
                JointKind::Prismatic => distances[0],
                JointKind::Revolute => distances[1],
            };
            let [low, high] = link.limits;
            (joint + side * distance).max(low.min(*joint)).min(high.max(*joint))
        };
        Some(joints.iter().zip(links).map(away).collect())
    }

    /// Every reading of a visit. Numbers are taken from `noise` for all stations and targets, whether they see each
    /// other or not.
    pub(super) fn read(&self, setup: &Setup, visit: &Visit<'_>, noise: &mut impl Rng, taken: &mut Taken) {
        let Visit { pose, place, settled, effects, .. } = visit;
        let seen = self.look(&setup.trackers, &setup.mounted, settled);
        let chosen = seen.chosen(visit.share);
        let targets = setup.mounted.len();
        let mut number = 0;
        for (station, tracker) in setup.trackers.iter().enumerate() {
            for target in 0..targets {
                let reading = place + ((station * targets + target) as u64) * READING;
                let outlier = self.outlier(setup, reading);
                let at = seen.places[target];
                let face = calibrig_model::measurement::Face::Front;
                let is_chosen = chosen.contains(&station);
                let time = visit.time + self.plan.timing.averaging * f64::from(number);
                let shot = Shot { face, averaging: self.plan.timing.averaging, ..Shot::at(time) };
                let point = at.optical + outlier.unwrap_or_default();
                let read = tracker.measure(&point, &shot, noise);
                let missed = self.tracker.conditions.misses > 0.0
                    && is_missed(
                        self.tracker.conditions.misses,
                        &mut random::stream_at(setup.seed, setup.trial, StreamSource::Misses, reading),
                    );
                if !is_chosen {
                    continue;
                }
                number += 1;
                let why = match (&seen.hidden[station][target], read) {
                    (Some(hidden), _) => hidden.to_string(),
                    (None, Err(error)) => error.to_string(),
                    (None, Ok(_)) if missed => "the tracker gave no reading".to_owned(),
                    (None, Ok(read)) => {
                        taken.outliers.extend(outlier.map(|shift| (*pose, shift)));
                        let now = tracker.tracker_from_base_at(time);
                        let at_place = (setup.seed, setup.trial, reading);
                        let read = self.reading(read, target, settled, &now, at_place);
                        taken.observations.push(visit.observation(station, target, time, read));
                        taken.settled.push(SettledPose { target: at.centre, ..settled.clone() });
                        taken.effects.push(effects.clone());
                        continue;
                    }
                };
                taken.missing.push(MissingReading {
                    pose: *pose,
                    station,
                    target,
                    why: self.from(station, why),
                });
            }
        }
    }

    /// A reason, with the station if there are several.
    fn from(&self, station: usize, why: String) -> String {
        match station.checked_sub(1) {
            _ if self.plan.stations.is_empty() => why,
            None => format!("from station 1: {why}"),
            Some(further) => {
                let name = self.plan.stations.get(further).map_or("", |station| station.name.as_str());
                format!("from station {name}: {why}")
            }
        }
    }

    /// The reading of a target at rest whose place was read: with the orientation for the first target, if a probe measures it. Its noise is at a
    /// place of the streams of seed and trial.
    pub(super) fn reading(
        &self,
        place: SphericalReading,
        target: usize,
        settled: &SettledPose,
        tracker_from_base: &Transform,
        (seed, trial, at): (u64, u32, u64),
    ) -> Reading {
        let (Some(probe), Some(last), 0) = (self.probe, settled.links.last(), target) else {
            return Reading::Spherical(place);
        };
        let base_from_flange = last * self.as_built.kinematics.last_from_flange;
        let mut rng = random::stream_at(seed, trial, random::StreamSource::ProbeNoise, at);
        Reading::Pose(Box::new(probe.measure(&place, &(tracker_from_base * base_from_flange), &mut rng)))
    }

    /// The error of the reading at that place of the streams, if it is a gross error.
    pub(super) fn outlier(&self, setup: &Setup, place: u64) -> Option<Vector3<f64>> {
        self.outliers?.draw(&mut random::stream_at(setup.seed, setup.trial, StreamSource::Outliers, place))
    }

    /// A vector of independent normal errors, or zero where the noise is off.
    pub(super) fn error_vector(&self, sigma: f64, rng: &mut impl Rng) -> Vector3<f64> {
        let drawn = Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(rng) });
        if self.tracker.instrument.noise { sigma * drawn } else { Vector3::zeros() }
    }

    pub(super) fn measure_targets(&self, seed: u64, trial: u32) -> Vec<Target> {
        let mut rng = random::stream(seed, trial, StreamSource::TargetOffset);
        let sigma = self.target_covariance[(0, 0)].sqrt();
        // A coordinate measuring machine touches the sphere; the distance of the optical centre from its centre is the
        // maker's figure.
        let smr = self.tracker.conditions.smr.as_ref();
        let centring = smr.map_or(0.0, |law| law.centring_sigma.powi(2));
        let further = self.plan.targets.iter().map(|target| (target.name.as_str(), target.in_flange));
        std::iter::once(("SMR", self.as_built.target))
            .chain(further)
            .map(|(name, place)| Target {
                name: name.to_owned(),
                in_flange: place + self.error_vector(sigma, &mut rng),
                covariance: Some(self.target_covariance + Matrix3::identity() * centring),
                orientation: None,
            })
            .zip(std::iter::once(self.probe).chain(std::iter::repeat(None)))
            .map(|(target, probe)| {
                let stated = |probe: &Probe| {
                    probe.stated(&mut random::stream(seed, trial, StreamSource::ProbeMounting))
                };
                Target { orientation: probe.map(stated), ..target }
            })
            .collect()
    }
}

/// The machine at rest, on one of its visits of a pose.
pub(super) struct Visit<'a> {
    pub command: &'a [f64],
    pub controller: &'a Controller<'a>,
    pub pose: u32,
    pub place: u64,
    pub time: f64,
    /// As stated.
    pub payload: Option<&'a Payload>,
    pub settled: SettledPose,
    pub effects: PoseEffects,
    /// Which stations read it.
    pub share: StationShare,
}

impl Visit<'_> {
    fn observation(&self, station: usize, target: usize, time: f64, reading: Reading) -> Observation {
        Observation {
            pose: self.pose,
            command: self.command.to_vec(),
            approach: self.controller.motion.approach.clone(),
            since_reversal: self.controller.motion.since_reversal.clone(),
            temperature: self.effects.temperature,
            time,
            station,
            target,
            payload: self.payload.cloned(),
            reading,
        }
    }
}

/// The errors that all readings of the session share; empty unless all trackers have the same.
fn shared_errors(trackers: &[LaserTracker]) -> Vec<(InstrumentTerm, f64)> {
    let own = trackers.first().map(LaserTracker::real_errors).unwrap_or_default();
    if trackers.iter().all(|tracker| tracker.real_errors() == own) { own } else { Vec::new() }
}

pub(super) fn empty_set(kind: SetKind, stations: &[Station], targets: &[Target]) -> SetOutcome {
    let measurements =
        MeasurementSet { stations: stations.to_vec(), targets: targets.to_vec(), observations: Vec::new() };
    SetOutcome { kind, measurements, dropped: Vec::new() }
}

/// The place of a pose in the random streams of a session, whatever the number of poses of each set.
fn entry(kind: SetKind, pose: u32) -> u64 {
    let set = match kind {
        SetKind::Identification => 0,
        SetKind::Verification => 1,
    };
    set << 32 | u64::from(pose)
}

/// Offset that separates the way to a pose from the pose itself in the stream of repeatability.
const VIA: u64 = 1 << 33;
/// Offset from one reading of a visit to the next in the streams: beyond a million poses.
pub(super) const READING: u64 = 1 << 20;
