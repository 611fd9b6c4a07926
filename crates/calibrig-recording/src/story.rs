//! What every recorder is told, in one order: first the session while it is measured, then its evaluation.

use std::fmt::Write;
use std::ops::Range;

use nalgebra::Vector3;

use super::clock::Clock;
use super::scene::{self, Arrow, Chain, Sighting};
use super::{Provenance, RecordingError};
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
use calibrig_estimation::evaluation::{ModeOutcome, RegistrationSummary};
use calibrig_estimation::identification::Mode;
use calibrig_files::Source;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::Observation;
use calibrig_model::measurement::{SetKind, SetOutcome};
use calibrig_model::{CalibrationModel, Payload, Visual};
use calibrig_plant::effects::PoseEffects;
use calibrig_plant::session::{PlantKind, Truth};
use calibrig_plant::{AsBuilt, SettledPose};

/// Everything that a recorder is told about a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Story<'a> {
    /// Where the measurements came from.
    pub input: &'a InputSummary,
    /// The input files by role (`scenario`, `robot`, `urdf`, ...), as read.
    pub sources: &'a [(String, Source)],
    /// The model that identification started from.
    pub model: &'a CalibrationModel,
    /// What the links look like; empty where unknown.
    pub visuals: &'a [Vec<Visual>],
    /// How the row "without calibration" was registered.
    pub registration: &'a RegistrationSummary,
    /// The sets, identification first.
    pub sets: &'a [SetOutcome],
    /// The modes in table order.
    pub modes: &'a [ModeOutcome],
    /// Only where simulated.
    pub truth: Option<&'a Truth>,
    /// Published figures beside them, m: (set, mode, [max x, mean x, max y, mean y, max z, mean z]).
    pub published: &'a [(SetKind, Mode, [f64; 6])],
    /// The effect of corrected commands on the machine, if they were driven.
    pub closed_loop: Option<&'a ClosedLoop>,
}

/// Where the measurements came from.
#[derive(Debug, Clone, PartialEq)]
pub struct InputSummary {
    /// `scenario`, `files` or `recording`.
    pub kind: &'static str,
    /// Its name for people.
    pub name: String,
    /// Hash over every input file, hexadecimal.
    pub sha256: String,
    /// The seed of a simulation.
    pub seed: Option<u64>,
    /// Number of the trial and what stood for the machine, of a simulation.
    pub trial: Option<(u32, PlantKind)>,
}

/// A sink for the story of a run. One that shows only what was made of a session need not listen to the session itself.
pub trait Recorder {
    /// Before the session.
    fn open(&mut self, _: &Preamble<'_>) -> Result<(), RecordingError> {
        Ok(())
    }
    /// A set begins, at `time` ns: its stations and targets; poses planned, where known.
    fn set(&mut self, _time: u64, _: &SetOutcome, _planned: Option<u32>) -> Result<(), RecordingError> {
        Ok(())
    }
    /// A pose was measured.
    fn measured(&mut self, _: &Measured<'_>) -> Result<(), RecordingError> {
        Ok(())
    }
    /// A pose was planned but not measured.
    fn dropped(&mut self, _time: u64, _: SetKind, _pose: u32, _why: &str) -> Result<(), RecordingError> {
        Ok(())
    }
    /// A set is complete, with so many observations.
    fn set_end(&mut self, _time: u64, _: SetKind, _observations: usize) -> Result<(), RecordingError> {
        Ok(())
    }

    /// The evaluation begins.
    fn begin(&mut self, story: &Story<'_>) -> Result<(), RecordingError>;
    /// One pose, evaluated.
    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError>;
    /// The result of a mode, at `time` ns.
    fn estimate(&mut self, time: u64, story: &Story<'_>, mode: &ModeOutcome) -> Result<(), RecordingError>;
    /// The effect of corrected commands on the machine, at `time` ns.
    fn closed_loop(&mut self, time: u64, driven: &ClosedLoop) -> Result<(), RecordingError>;
    /// A line for people.
    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError>;
}

/// What is known before the first pose.
#[derive(Debug, Clone, Copy)]
pub struct Preamble<'a> {
    /// Where the measurements come from.
    pub input: &'a InputSummary,
    /// The input files by role.
    pub sources: &'a [(String, Source)],
    /// The model that identification starts from.
    pub model: &'a CalibrationModel,
    /// What the links look like; empty where unknown.
    pub visuals: &'a [Vec<Visual>],
    /// The machine and what stands around it, where simulated.
    pub truth: Option<TrueSetting<'a>>,
}

/// The machine of a simulated session, with the trackers and targets by which it is measured.
#[derive(Debug, Clone, Copy)]
pub struct TrueSetting<'a> {
    /// The machine.
    pub as_built: &'a AsBuilt,
    /// `tracker_from_base` of every station.
    pub stations: &'a [Transform],
    /// Real offsets of the targets beside the machine's own, in the flange frame, m.
    pub further_targets: &'a [Vector3<f64>],
    /// The loads that the flange carries at some poses, as they really are.
    pub payloads: &'a [Payload],
}

impl<'a> TrueSetting<'a> {
    /// The part of the truth that is known before the session.
    pub fn of(truth: &'a Truth) -> Self {
        let Truth { as_built, stations, further_targets, payloads, .. } = truth;
        Self { as_built, stations, further_targets, payloads }
    }
}

/// The observations of one pose as they were measured, and the truth beside them.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// The set.
    pub kind: SetKind,
    /// Place of the first observation in its set.
    pub first: usize,
    /// The observations.
    pub observations: &'a [Observation],
    /// Simulated time of each observation, ns.
    pub times: &'a [u64],
    /// The machine at rest, one an observation; empty where not simulated.
    pub truth: &'a [SettledPose],
    /// The same with every part rigid.
    pub rigid: &'a [SettledPose],
    /// How the machine's effects changed the pose.
    pub effects: &'a [PoseEffects],
}

/// How much a line matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    /// For information.
    Info,
    /// Something to check.
    Warning,
}

/// A line for people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogEntry {
    /// Simulated time, ns.
    pub time: u64,
    /// How much it matters.
    pub level: LogLevel,
    /// One line.
    pub message: String,
}

/// All that belongs to one evaluated pose: the robot, and every target seen at it.
#[derive(Debug, Clone)]
pub struct PoseStep<'a> {
    /// Running number over all sets, from 0.
    pub number: u32,
    /// The set.
    pub set: &'a SetOutcome,
    /// What was measured.
    pub measured: Measured<'a>,
    /// The robots to show.
    pub chains: Vec<Chain>,
    /// Where the targets were seen, in the base frame.
    pub sightings: Vec<Sighting>,
    /// The residuals of each mode.
    pub residuals: Vec<Residuals<'a>>,
}

/// The residuals of a mode at one pose.
#[derive(Debug, Clone)]
pub struct Residuals<'a> {
    /// The mode.
    pub mode: Mode,
    /// Measured minus predicted position in the base frame, m, one an observation.
    pub errors: &'a [Vector3<f64>],
    pub(super) arrows: Vec<Arrow>,
}

impl Measured<'_> {
    /// Simulated time of the pose, ns.
    pub fn time(&self) -> u64 {
        self.times.first().copied().unwrap_or(0)
    }

    /// Elastic deflection of the target at observation `index` of this pose, in the base frame, m.
    pub fn deflection(&self, index: usize) -> Option<Vector3<f64>> {
        Some(self.truth.get(index)?.target - self.rigid.get(index)?.target)
    }
}

/// Tells `story` to `recorder`, from the first pose on.
pub fn record(story: &Story<'_>, recorder: &mut dyn Recorder) -> Result<(), RecordingError> {
    record_session(story, recorder)?;
    record_evaluation(story, recorder)
}

/// Tells the session of `story` in the same way as while it is measured.
fn record_session(story: &Story<'_>, recorder: &mut dyn Recorder) -> Result<(), RecordingError> {
    let truth = story.truth;
    let preamble = Preamble {
        input: story.input,
        sources: story.sources,
        model: story.model,
        visuals: story.visuals,
        truth: truth.map(TrueSetting::of),
    };
    record_sets(&preamble, story.sets, truth, recorder)
}

/// Tells `recorder` about sets that were measured elsewhere and are not evaluated yet.
pub(super) fn record_sets(
    preamble: &Preamble<'_>,
    sets: &[SetOutcome],
    truth: Option<&Truth>,
    recorder: &mut dyn Recorder,
) -> Result<(), RecordingError> {
    recorder.open(preamble)?;
    let times = times(sets);
    let mut now = 0;
    for (index, set) in sets.iter().enumerate() {
        let observations = &set.measurements.observations;
        let planned = poses(observations).count() + set.dropped.len();
        recorder.set(now, set, u32::try_from(planned).ok())?;
        let mut dropped = set.dropped.iter().peekable();
        for range in poses(observations) {
            let measured = measured(set, truth, index, range, &times[index]);
            let number = measured.observations.first().map_or(0, |o| o.pose);
            while let Some((pose, reason)) = dropped.next_if(|(pose, _)| *pose < number) {
                recorder.dropped(now, set.kind, *pose, reason)?;
            }
            recorder.measured(&measured)?;
            now = measured.times.last().copied().unwrap_or(now);
        }
        for (pose, reason) in dropped {
            recorder.dropped(now, set.kind, *pose, reason)?;
        }
        recorder.set_end(now, set.kind, set.measurements.observations.len())?;
    }
    Ok(())
}

/// Tells the evaluation of the session, which goes through the poses once more.
pub fn record_evaluation(story: &Story<'_>, recorder: &mut dyn Recorder) -> Result<(), RecordingError> {
    recorder.begin(story)?;
    for message in opening(story) {
        recorder.log(&LogEntry { time: 0, level: LogLevel::Info, message })?;
    }
    let times = times(story.sets);
    let mut number = 0;
    for (index, (set, times)) in story.sets.iter().zip(&times).enumerate() {
        let start = times.first().copied().unwrap_or(0);
        for (pose, reason) in &set.dropped {
            let message = format!("{} pose {pose} was dropped: {reason}", set.kind.key());
            recorder.log(&LogEntry { time: start, level: LogLevel::Warning, message })?;
        }
        for range in poses(&set.measurements.observations) {
            recorder.pose(&step(story, index, range, number, times))?;
            number += 1;
        }
    }
    let end = times.iter().flatten().max().map_or(0, |last| last.saturating_add(super::clock::SECOND));
    if let Some(driven) = story.closed_loop {
        recorder.closed_loop(end, driven)?;
    }
    for mode in story.modes {
        recorder.estimate(end, story, mode)?;
        for (level, message) in closing(story, mode) {
            recorder.log(&LogEntry { time: end, level, message })?;
        }
    }
    Ok(())
}

/// Simulated time of every observation, ns.
fn times(sets: &[SetOutcome]) -> Vec<Vec<u64>> {
    let mut clock = Clock::default();
    sets.iter()
        .map(|set| set.measurements.observations.iter().map(|o| clock.time_of(set.kind, o)).collect())
        .collect()
}

/// The observations of each pose: neighbours with the same number.
fn poses(observations: &[Observation]) -> impl Iterator<Item = Range<usize>> {
    let mut start = 0;
    observations.chunk_by(|a, b| a.pose == b.pose).map(move |pose| {
        let range = start..start + pose.len();
        start = range.end;
        range
    })
}

fn measured<'a>(
    set: &'a SetOutcome,
    truth: Option<&'a Truth>,
    set_index: usize,
    range: Range<usize>,
    times: &'a [u64],
) -> Measured<'a> {
    Measured {
        kind: set.kind,
        first: range.start,
        observations: &set.measurements.observations[range.clone()],
        times: &times[range.clone()],
        truth: truth.map_or(&[][..], |truth| part(&truth.poses, set_index, &range)),
        rigid: truth.map_or(&[][..], |truth| part(&truth.rigid, set_index, &range)),
        effects: truth.map_or(&[][..], |truth| part(&truth.effects, set_index, &range)),
    }
}

fn step<'a>(
    story: &'a Story<'a>,
    set_index: usize,
    range: Range<usize>,
    number: u32,
    times: &'a [u64],
) -> PoseStep<'a> {
    let set = &story.sets[set_index];
    let measured = measured(set, story.truth, set_index, range.clone(), times);
    let observations = measured.observations;
    let observer = scene::observer(story);
    let sightings =
        observer.map(|robot| observations.iter().filter_map(|o| scene::sighting(robot, o)).collect());
    let residuals = |mode: &'a ModeOutcome| {
        let errors = mode.errors.get(set_index)?.get(range.clone())?;
        let arrows = observations.iter().zip(errors).filter_map(|(o, e)| scene::arrow(mode, o, e)).collect();
        Some(Residuals { mode: mode.mode, errors, arrows })
    };
    PoseStep {
        number,
        set,
        measured,
        chains: scene::chains(story, set_index, range.start),
        sightings: sightings.unwrap_or_default(),
        residuals: story.modes.iter().filter_map(residuals).collect(),
    }
}

fn part<'a, T>(sets: &'a [Vec<T>], set: usize, range: &Range<usize>) -> &'a [T] {
    sets.get(set).and_then(|set| set.get(range.clone())).unwrap_or_default()
}

fn opening(story: &Story<'_>) -> Vec<String> {
    let input = story.input;
    let seed = input.seed.map(|seed| format!(", seed {seed}")).unwrap_or_default();
    let hash: String = input.sha256.chars().take(12).collect();
    let registration = story.registration;
    let mut lines = vec![
        format!("{}: {} {}{seed}, sha256 {hash}", Provenance::software(), input.kind, input.name),
        format!(
            "registration: {}, {} poses, rms {:.4} mm",
            registration.how,
            registration.poses,
            1e3 * registration.rms
        ),
    ];
    for set in story.sets {
        let measurements = &set.measurements;
        lines.push(format!(
            "{} set: observations {}, stations {}, targets {}, dropped poses {}",
            set.kind.key(),
            measurements.observations.len(),
            measurements.stations.len(),
            measurements.targets.len(),
            set.dropped.len()
        ));
    }
    lines
}

fn closing(story: &Story<'_>, mode: &ModeOutcome) -> Vec<(LogLevel, String)> {
    let title = mode.mode.title();
    let mut lines = Vec::new();
    if let Some(estimate) = &mode.estimate {
        let mut line = format!(
            "{title}: {} after {} iterations, rank {} of {}",
            estimate.termination.key(),
            estimate.iterations.len(),
            estimate.spectrum.rank,
            estimate.parameters.len()
        );
        if let Some(ratio) = estimate.chi2_per_dof() {
            // Writing to a String does not fail.
            let _ = write!(line, ", chi-square per degree of freedom {ratio:.3}");
        }
        let level = if estimate.is_sound() { LogLevel::Info } else { LogLevel::Warning };
        lines.push((level, line));
        lines.extend(estimate.warnings.iter().map(|w| (LogLevel::Warning, format!("{title}: {w}"))));
    }
    for (set, row) in story.sets.iter().zip(&mode.rows) {
        let Some(row) = row else { continue };
        let kind: SetKind = set.kind;
        lines.push((
            LogLevel::Info,
            format!(
                "{title}, {} set: rms 3-D error {:.4} mm, largest {:.4} mm",
                kind.key(),
                1e3 * row.rms_3d,
                1e3 * row.max_3d
            ),
        ));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{self, Outcome};

    #[derive(Default)]
    struct Listener {
        session: Vec<String>,
        poses: Vec<(u32, SetKind, usize, usize)>,
        estimates: Vec<Mode>,
        log: Vec<LogEntry>,
        last_time: u64,
    }

    impl Recorder for Listener {
        fn open(&mut self, _: &Preamble<'_>) -> Result<(), RecordingError> {
            assert!(self.session.is_empty());
            Ok(())
        }
        fn set(&mut self, _: u64, set: &SetOutcome, _: Option<u32>) -> Result<(), RecordingError> {
            self.session.push(format!("{} begins", set.kind.key()));
            Ok(())
        }
        fn measured(&mut self, measured: &Measured<'_>) -> Result<(), RecordingError> {
            self.session.push(format!("{} {}", measured.first, measured.observations.len()));
            Ok(())
        }
        fn dropped(&mut self, _: u64, _: SetKind, pose: u32, reason: &str) -> Result<(), RecordingError> {
            self.session.push(format!("{pose} {reason}"));
            Ok(())
        }
        fn set_end(&mut self, _: u64, kind: SetKind, observations: usize) -> Result<(), RecordingError> {
            self.session.push(format!("{} ends with {observations}", kind.key()));
            Ok(())
        }
        fn begin(&mut self, _: &Story<'_>) -> Result<(), RecordingError> {
            assert!(self.poses.is_empty() && self.estimates.is_empty() && self.log.is_empty());
            Ok(())
        }
        fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
            let measured = &step.measured;
            assert!(measured.time() >= self.last_time, "time runs backwards");
            self.last_time = *measured.times.last().expect("an observation");
            self.poses.push((step.number, step.set.kind, measured.first, measured.observations.len()));
            assert_eq!(step.residuals.len(), Mode::ALL.len());
            assert_eq!(step.sightings.len(), measured.observations.len());
            Ok(())
        }
        fn estimate(&mut self, time: u64, _: &Story<'_>, mode: &ModeOutcome) -> Result<(), RecordingError> {
            assert!(time > self.last_time);
            self.estimates.push(mode.mode);
            Ok(())
        }
        fn closed_loop(&mut self, _: u64, _: &ClosedLoop) -> Result<(), RecordingError> {
            Ok(())
        }
        fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
            self.log.push(entry.clone());
            Ok(())
        }
    }

    fn listen(outcome: &Outcome) -> Listener {
        let mut listener = Listener::default();
        record(&outcome.story(), &mut listener).expect("no sink to fail");
        listener
    }

    #[test]
    fn every_pose_and_mode_is_told_once_in_order() {
        let mut outcome = synthetic::outcome(5, 3, true);
        outcome.sets[1].dropped.push((17, "out of sight".to_owned()));
        let heard = listen(&outcome);
        assert_eq!(heard.poses.len(), 8);
        assert_eq!(heard.poses.iter().map(|p| p.0).collect::<Vec<_>>(), (0..8).collect::<Vec<_>>());
        assert_eq!(heard.poses.iter().filter(|p| p.1 == SetKind::Verification).count(), 3);
        assert_eq!(heard.estimates, Mode::ALL);
        let warnings: Vec<_> = heard.log.iter().filter(|e| e.message.contains("out of sight")).collect();
        assert_eq!(warnings.len(), 1);
        assert_eq!(warnings[0].level, LogLevel::Warning);
        let session = [
            "identification begins",
            "0 1",
            "1 1",
            "2 1",
            "3 1",
            "4 1",
            "5 no line of sight",
            "identification ends with 5",
            "verification begins",
            "0 1",
            "1 1",
            "2 1",
            "3 no line of sight",
            "17 out of sight",
            "verification ends with 3",
        ];
        assert_eq!(heard.session, session);
    }

    #[test]
    fn observations_of_one_pose_are_told_together() {
        let mut outcome = synthetic::outcome(4, 1, false);
        let observations = &mut outcome.sets[0].measurements.observations;
        observations[1].pose = observations[0].pose;
        let heard = listen(&outcome);
        assert_eq!(
            heard.poses.iter().map(|p| (p.2, p.3)).collect::<Vec<_>>(),
            [(0, 2), (2, 1), (3, 1), (0, 1)]
        );
    }
}
