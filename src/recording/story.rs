//! The one story that every recorder is told.

use std::cmp::Ordering;
use std::fmt::Write;
use std::ops::Range;

use nalgebra::Vector3;

use super::scene::{self, Arrow, Chain, Sighting};
use super::{Provenance, RecordingError};
use crate::identification::Mode;
use crate::measurement::Observation;
use crate::pipeline::{ModeOutcome, Outcome, SetKind, SetOutcome};
use crate::plant::SettledPose;
use crate::plant::effects::PoseEffects;

/// A sink for the story of a run.
pub trait Recorder {
    /// What holds for the whole run: provenance, sets, shapes, the machine as built.
    fn begin(&mut self, outcome: &Outcome) -> Result<(), RecordingError>;
    /// One pose.
    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError>;
    /// What a mode made of the measurements, at `time` ns.
    fn estimate(&mut self, time: u64, outcome: &Outcome, mode: &ModeOutcome) -> Result<(), RecordingError>;
    /// A line for people.
    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError>;
}

/// How much a line matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    /// To know.
    Info,
    /// To look into.
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

/// All that belongs to one pose: the robot, and every target seen at it.
#[derive(Debug, Clone)]
pub struct PoseStep<'a> {
    /// Running number over all sets, from 0.
    pub number: u32,
    /// The set.
    pub set: &'a SetOutcome,
    /// Place of the first observation in its set.
    pub first: usize,
    /// The observations.
    pub observations: &'a [Observation],
    /// Simulated time of each observation, ns.
    pub times: &'a [u64],
    /// The robots to show.
    pub chains: Vec<Chain>,
    /// Where the targets were seen, in the base frame.
    pub sightings: Vec<Sighting>,
    /// What each mode left over.
    pub residuals: Vec<Residuals<'a>>,
    /// The machine at rest, one an observation; empty where not simulated.
    pub truth: &'a [SettledPose],
    /// The same if nothing of it yielded.
    pub rigid: &'a [SettledPose],
    /// What the machine's effects made of the pose.
    pub effects: &'a [PoseEffects],
}

/// What a mode left over at one pose.
#[derive(Debug, Clone)]
pub struct Residuals<'a> {
    /// The mode.
    pub mode: Mode,
    /// Measured minus predicted position in the base frame, m, one an observation.
    pub errors: &'a [Vector3<f64>],
    pub(super) arrows: Vec<Arrow>,
}

impl PoseStep<'_> {
    /// Simulated time of the pose, ns.
    pub fn time(&self) -> u64 {
        self.times.first().copied().unwrap_or(0)
    }

    /// How far elasticity takes the target of observation `index` of this pose, in the base frame, m.
    pub fn deflection(&self, index: usize) -> Option<Vector3<f64>> {
        Some(self.truth.get(index)?.target - self.rigid.get(index)?.target)
    }
}

/// Tells `outcome` to `recorder`.
pub fn record(outcome: &Outcome, recorder: &mut dyn Recorder) -> Result<(), RecordingError> {
    recorder.begin(outcome)?;
    for message in opening(outcome) {
        recorder.log(&LogEntry { time: 0, level: LogLevel::Info, message })?;
    }
    let times = times(&outcome.sets);
    let mut number = 0;
    for (index, (set, times)) in outcome.sets.iter().zip(&times).enumerate() {
        let start = times.first().copied().unwrap_or(0);
        for (pose, reason) in &set.dropped {
            let message = format!("{} pose {pose} was dropped: {reason}", set.kind.key());
            recorder.log(&LogEntry { time: start, level: LogLevel::Warning, message })?;
        }
        for range in poses(&set.measurements.observations) {
            recorder.pose(&step(outcome, index, range, number, times))?;
            number += 1;
        }
    }
    let end = times.iter().flatten().max().map_or(0, |last| last.saturating_add(SECOND));
    for mode in &outcome.modes {
        recorder.estimate(end, outcome, mode)?;
        for (level, message) in closing(outcome, mode) {
            recorder.log(&LogEntry { time: end, level, message })?;
        }
    }
    Ok(())
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

fn step<'a>(
    outcome: &'a Outcome,
    set_index: usize,
    range: Range<usize>,
    number: u32,
    times: &'a [u64],
) -> PoseStep<'a> {
    let set = &outcome.sets[set_index];
    let observations = &set.measurements.observations[range.clone()];
    let observer = scene::observer(outcome);
    let sightings =
        observer.map(|robot| observations.iter().filter_map(|o| scene::sighting(robot, o)).collect());
    let truth = outcome.truth.as_ref();
    let residuals = |mode: &'a ModeOutcome| {
        let errors = mode.errors.get(set_index)?.get(range.clone())?;
        let arrows = observations.iter().zip(errors).filter_map(|(o, e)| scene::arrow(mode, o, e)).collect();
        Some(Residuals { mode: mode.mode, errors, arrows })
    };
    PoseStep {
        number,
        set,
        first: range.start,
        observations,
        times: &times[range.clone()],
        chains: scene::chains(outcome, set_index, range.start),
        sightings: sightings.unwrap_or_default(),
        residuals: outcome.modes.iter().filter_map(residuals).collect(),
        truth: truth.map_or(&[][..], |truth| part(&truth.poses, set_index, &range)),
        rigid: truth.map_or(&[][..], |truth| part(&truth.rigid, set_index, &range)),
        effects: truth.map_or(&[][..], |truth| part(&truth.effects, set_index, &range)),
    }
}

fn part<'a, T>(sets: &'a [Vec<T>], set: usize, range: &Range<usize>) -> &'a [T] {
    sets.get(set).and_then(|set| set.get(range.clone())).unwrap_or_default()
}

const SECOND: u64 = 1_000_000_000;
/// Between one set and the next, where their own times do not tell.
const PAUSE: u64 = 10 * SECOND;

/// Simulated time of every observation, ns, increasing over the sets.
fn times(sets: &[SetOutcome]) -> Vec<Vec<u64>> {
    let mut end: Option<u64> = None;
    sets.iter()
        .map(|set| {
            let observations = &set.measurements.observations;
            let own = own_times(observations).unwrap_or_else(|| one_second_a_pose(observations));
            let (Some(&first), Some(&last)) = (own.first(), own.last()) else { return own };
            let shift = match end {
                Some(end) if first <= end => end.saturating_add(PAUSE) - first,
                _ => 0,
            };
            end = Some(last.saturating_add(shift));
            own.iter().map(|t| t.saturating_add(shift)).collect()
        })
        .collect()
}

/// The observations' own times, if they never decrease and increase from pose to pose.
fn own_times(observations: &[Observation]) -> Option<Vec<u64>> {
    // Viewers hold whole seconds in 32 bits.
    let usable = |o: &Observation| (0.0..4e9).contains(&o.time);
    let increase = observations.windows(2).all(|pair| match pair[0].time.partial_cmp(&pair[1].time) {
        Some(Ordering::Less) => true,
        Some(Ordering::Equal) => pair[0].pose == pair[1].pose,
        _ => false,
    });
    if !increase || !observations.iter().all(usable) {
        return None;
    }
    // In range by the test above.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let nanoseconds = |o: &Observation| (o.time * 1e9).round() as u64;
    Some(observations.iter().map(nanoseconds).collect())
}

fn one_second_a_pose(observations: &[Observation]) -> Vec<u64> {
    let ranges = poses(observations).zip(0_u64..);
    ranges.flat_map(|(range, number)| range.map(move |_| number * SECOND)).collect()
}

fn opening(outcome: &Outcome) -> Vec<String> {
    let input = &outcome.input;
    let seed = input.seed.map(|seed| format!(", seed {seed}")).unwrap_or_default();
    let hash: String = input.sha256.chars().take(12).collect();
    let registration = &outcome.registration;
    let mut lines = vec![
        format!("{}: {} {}{seed}, sha256 {hash}", Provenance::software(), input.kind, input.name),
        format!(
            "registration: {}, {} poses, rms {:.4} mm",
            registration.how,
            registration.poses,
            1e3 * registration.rms
        ),
    ];
    for set in &outcome.sets {
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

fn closing(outcome: &Outcome, mode: &ModeOutcome) -> Vec<(LogLevel, String)> {
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
    for (set, row) in outcome.sets.iter().zip(&mode.rows) {
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
    use crate::recording::synthetic;

    #[derive(Default)]
    struct Listener {
        poses: Vec<(u32, SetKind, usize, usize, u64)>,
        estimates: Vec<Mode>,
        log: Vec<LogEntry>,
        last_time: u64,
    }

    impl Recorder for Listener {
        fn begin(&mut self, _: &Outcome) -> Result<(), RecordingError> {
            assert!(self.poses.is_empty() && self.estimates.is_empty() && self.log.is_empty());
            Ok(())
        }
        fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
            assert!(step.time() >= self.last_time, "time runs backwards");
            self.last_time = *step.times.last().expect("an observation");
            self.poses.push((step.number, step.set.kind, step.first, step.observations.len(), step.time()));
            assert_eq!(step.residuals.len(), Mode::ALL.len());
            assert_eq!(step.sightings.len(), step.observations.len());
            Ok(())
        }
        fn estimate(&mut self, time: u64, _: &Outcome, mode: &ModeOutcome) -> Result<(), RecordingError> {
            assert!(time > self.last_time);
            self.estimates.push(mode.mode);
            Ok(())
        }
        fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
            self.log.push(entry.clone());
            Ok(())
        }
    }

    fn listen(outcome: &Outcome) -> Listener {
        let mut listener = Listener::default();
        record(outcome, &mut listener).expect("no sink to fail");
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

    #[test]
    fn times_are_the_observations_own_or_a_second_a_pose() {
        let mut outcome = synthetic::outcome(3, 2, false);
        let own: Vec<f64> = outcome.sets[0].measurements.observations.iter().map(|o| o.time).collect();
        let told = times(&outcome.sets);
        for (told, own) in told[0].iter().zip(own) {
            assert!((*told as f64 * 1e-9 - own).abs() < 1e-9);
        }
        // The second set starts at its own time 0, so that it is moved behind the first.
        assert_eq!(told[1][0], told[0][2] + PAUSE);
        for bad in [f64::NAN, -1.0, 1e300, 0.0] {
            outcome.sets[0].measurements.observations[2].time = bad;
            assert_eq!(times(&outcome.sets)[0], [0, SECOND, 2 * SECOND], "{bad}");
        }
    }
}
