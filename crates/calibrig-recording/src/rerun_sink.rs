//! Recordings in Rerun's own format, with a layout of its views: for display, not for replay.

use std::io::Write;
use std::path::Path;

use rerun::archetypes::SeriesLines;
use rerun::components::Radius;

use super::Story;
use super::file::write_whole;
use super::rerun_columns::{Shown, Time};
use super::rerun_entities::{ARROWS, AXES, COST, DEFLECTION, NORM, ROD_FORCE, TEMPERATURE, color};
use super::rerun_layout::Force;
use super::rerun_views;
use super::rerun_writer::EntityWriter;
use super::scene::{self, Sighting};
use super::{
    Chain, ChainKind, LogEntry, Measured, PoseStep, Recorder, RecordingError, record_evaluation, tables,
};
use calibrig_estimation::evaluation::ModeOutcome;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
use calibrig_estimation::identification::Mode;
use calibrig_model::measurement::SetKind;

const CURVES: [&str; 4] = ["x", "y", "z", NORM];

/// Writes a Rerun recording of `story`. The file is either complete or not written at all.
pub fn write_rrd(story: &Story<'_>, path: &Path) -> Result<(), RecordingError> {
    save_rrd(&rrd_of(story)?, path)
}

/// The bytes of a Rerun recording of `story`.
pub fn rrd_of(story: &Story<'_>) -> Result<Vec<u8>, RecordingError> {
    let mut recorder = RerunRecorder::new(story)?;
    record_evaluation(story, &mut recorder)?;
    recorder.finish()
}

/// Writes what [`rrd_of`] made. The file is either complete or not written at all.
pub fn save_rrd(bytes: &[u8], path: &Path) -> Result<(), RecordingError> {
    write_whole(path, |mut file| {
        file.write_all(bytes).and_then(|()| file.flush()).map_err(RecordingError::unrecordable)
    })
}

/// Makes a Rerun recording: in memory, or in an open viewer ([`LiveRecorder`](super::LiveRecorder)).
pub struct RerunRecorder {
    pub(super) writer: EntityWriter,
    /// Number of poses that were shown while they were measured.
    live: i64,
    /// The poses so far.
    poses: Vec<Told>,
}

/// A pose that was shown.
#[derive(Debug, Clone, Copy)]
struct Told {
    /// Running number, from 0.
    number: i64,
    /// Simulated time, ns.
    nanos: i64,
    set: SetKind,
    /// Place of its first observation in the set.
    first: usize,
}

impl Told {
    fn of(number: i64, measured: &Measured<'_>) -> Self {
        Self { number, nanos: signed(measured.time()), set: measured.kind, first: measured.first }
    }

    fn time(self) -> Time {
        Time::Pose { number: self.number, nanos: self.nanos }
    }
}

impl RerunRecorder {
    /// Begins a recording in memory, with views that suit `story`.
    pub fn new(story: &Story<'_>) -> Result<Self, RecordingError> {
        let layout = rerun_views::layout(story, Force::Default)?;
        Ok(Self::on(EntityWriter::in_memory(&story.input.name, layout)?))
    }

    /// Tells what `writer` writes.
    pub(super) fn on(writer: EntityWriter) -> Self {
        Self { writer, live: 0, poses: Vec::new() }
    }

    /// The bytes of the file; none where a viewer was told.
    pub fn finish(self) -> Result<Vec<u8>, RecordingError> {
        self.writer.finish()
    }

    /// Names and colours of the curves.
    fn curves(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        for mode in story.modes {
            let (key, title) = (mode.mode.key(), mode.mode.title());
            let curve = SeriesLines::new()
                .with_names([title])
                .with_colors([color(scene::mode_colour(mode.mode))])
                .with_widths([1.5]);
            for axis in CURVES {
                self.writer.curve(&format!("residual_mm/{axis}/{key}"), &curve)?;
            }
            if mode.estimate.is_some() {
                self.writer.curve(&format!("{COST}/{key}"), &curve)?;
            }
        }
        if story.truth.is_some() { self.machine_curves() } else { Ok(()) }
    }

    /// The same of the simulated machine.
    pub(super) fn machine_curves(&mut self) -> Result<(), RecordingError> {
        let machine = [
            (format!("{DEFLECTION}/x"), "x", scene::mode_colour(Mode::OnlyCalibration)),
            (format!("{DEFLECTION}/y"), "y", scene::mode_colour(Mode::WithGravity)),
            (format!("{DEFLECTION}/z"), "z", scene::NEST),
            (format!("{DEFLECTION}/norm"), "3-D", scene::DEFLECTED),
            (ROD_FORCE.to_owned(), "tension", scene::TRACKER),
            (TEMPERATURE.to_owned(), "air", scene::TRACKER),
        ];
        for (path, name, rgba) in machine {
            let curve = SeriesLines::new().with_names([name]).with_colors([color(rgba)]).with_widths([1.5]);
            self.writer.curve(&path, &curve)?;
        }
        Ok(())
    }

    /// A pose while it is measured, on the simulated machine.
    pub(super) fn measuring(
        &mut self,
        measured: &Measured<'_>,
        chains: &[Chain],
        sightings: &[Sighting],
    ) -> Result<(), RecordingError> {
        self.writer.at(Told::of(self.live, measured).time());
        self.live += 1;
        self.seen(measured, chains, sightings)
    }

    /// The picture of a pose: robots, lines of sight, and the deflections of the simulated machine.
    fn seen(
        &mut self,
        measured: &Measured<'_>,
        chains: &[Chain],
        sightings: &[Sighting],
    ) -> Result<(), RecordingError> {
        for chain in chains {
            self.writer.chain(chain, chain.kind.is_ghost())?;
        }
        self.writer.sightings(sightings)?;
        self.writer.deflection(measured)?;
        if let Some(deflection) = measured.deflection(0) {
            let norm = deflection.norm();
            for (axis, value) in CURVES.iter().zip(deflection.iter().chain([&norm])) {
                self.writer.put(&format!("{DEFLECTION}/{axis}"), Shown::Value(1e3 * value))?;
            }
        }
        let Some(settled) = measured.truth.first() else { return Ok(()) };
        if let Some(force) = settled.rod_force {
            self.writer.put(ROD_FORCE, Shown::Value(force))?;
        }
        if let Some(temperature) = measured.effects.first().and_then(|effects| effects.temperature) {
            self.writer.put(TEMPERATURE, Shown::Value(temperature))?;
        }
        self.writer.put("tables/machine", Shown::Page(tables::machine(measured)))
    }

    /// The robot before calibration and as identified, at every pose so far.
    fn robots(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        for told in self.poses.clone() {
            let Some(set) = story.sets.iter().find(|set| set.kind == told.set) else { continue };
            let Some(observation) = set.measurements.observations.get(told.first) else { continue };
            self.writer.at(told.time());
            if story.truth.is_some() {
                if let Some(calibrated) = scene::calibrated_chain(story, observation) {
                    self.writer.chain(&calibrated, true)?;
                }
            } else if let Some(target) = set.measurements.targets.get(observation.target)
                // The calibrated robot stands for the machine and was shown with the pose.
                && let Some(nominal) = scene::nominal_chain(story.model, &target.in_flange, observation)
            {
                self.writer.chain(&nominal, true)?;
            }
        }
        Ok(())
    }

    fn residuals(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        for residuals in &step.residuals {
            let key = residuals.mode.key();
            let arrows = Shown::Arrows {
                arrows: residuals.arrows.clone(),
                colour: scene::mode_colour(residuals.mode),
                radius: Radius::new_ui_points(3.0),
                label: None,
            };
            self.writer.put(&format!("{ARROWS}/{key}/at_this_pose"), arrows)?;
            let Some(error) = residuals.errors.first() else { continue };
            for (axis, value) in AXES.iter().zip(error.iter()) {
                self.writer.put(&format!("residual_mm/{axis}/{key}"), Shown::Value(1e3 * value))?;
            }
            self.writer.put(&format!("residual_mm/norm/{key}"), Shown::Value(1e3 * error.norm()))?;
        }
        Ok(())
    }
}

// The session itself is left out: the file is written after the run, and the evaluation shows every pose.
impl Recorder for RerunRecorder {
    fn begin(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        let solid = if story.truth.is_some() { ChainKind::True } else { ChainKind::Calibrated };
        self.writer.surroundings(&scene::up(story), &scene::trackers(story), scene::nests(story.sets))?;
        self.writer.robot(solid, story.visuals)?;
        self.writer.all_measured(story)?;
        self.curves(story)?;
        self.writer.document("tables/accuracy", tables::about(story) + &tables::accuracy(story))?;
        self.writer.document("tables/parameters", tables::parameters(story))?;
        self.writer.document("tables/identification", tables::estimates(story))
    }

    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let told = Told::of(i64::from(step.number), &step.measured);
        self.poses.push(told);
        self.writer.at(told.time());
        if told.number >= self.live {
            self.seen(&step.measured, &step.chains, &step.sightings)?;
        }
        self.residuals(step)?;
        self.writer.put("tables/pose", Shown::Page(tables::pose(step)))
    }

    fn estimate(&mut self, _: u64, story: &Story<'_>, mode: &ModeOutcome) -> Result<(), RecordingError> {
        if let Some(estimate) = &mode.estimate {
            self.writer.correlations(mode.mode, estimate)?;
            self.writer.convergence(mode.mode, estimate)?;
        }
        if story.modes.last().is_some_and(|last| last.mode == mode.mode) {
            self.writer.histograms(story)?;
            self.writer.document("tables/convergence", tables::convergence(story))?;
            self.robots(story)?;
        }
        Ok(())
    }

    fn closed_loop(&mut self, _: u64, driven: &ClosedLoop) -> Result<(), RecordingError> {
        self.writer.document("tables/compensation", tables::compensation(driven))?;
        driven.path.as_ref().map_or(Ok(()), |path| self.writer.driven_path(path))
    }

    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
        let number = self.poses.last().map_or(0, |told| told.number);
        self.writer.at(Time::Pose { number, nanos: signed(entry.time) });
        self.writer.put("log", Shown::Entry(entry.level, entry.message.clone()))
    }
}

/// Nanoseconds as Rerun counts them: enough for 292 years.
fn signed(nanos: u64) -> i64 {
    i64::try_from(nanos).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{BTreeMap, BTreeSet};

    use rerun::log::{Chunk, LogMsg};

    use crate::record;
    use crate::synthetic::{self, Outcome};

    /// Rows by entity, over all times, and the names of all timelines.
    struct Contents {
        rows: BTreeMap<String, usize>,
        layout: BTreeSet<String>,
        timelines: BTreeSet<String>,
        activated: bool,
    }

    fn contents(outcome: &Outcome) -> Contents {
        let mut recorder = RerunRecorder::new(&outcome.story()).expect("begun");
        record(&outcome.story(), &mut recorder).expect("recorded");
        let mut contents = Contents {
            rows: BTreeMap::new(),
            layout: BTreeSet::new(),
            timelines: BTreeSet::new(),
            activated: false,
        };
        for message in recorder.writer.messages().expect("told") {
            match message {
                LogMsg::ArrowMsg(store, message) => {
                    let chunk = Chunk::from_arrow_msg(&message).expect("sound");
                    let path = chunk.entity_path().to_string();
                    if store.is_blueprint() {
                        contents.layout.insert(path);
                        continue;
                    }
                    *contents.rows.entry(path).or_default() += chunk.num_rows();
                    contents.timelines.extend(chunk.timelines().keys().map(ToString::to_string));
                }
                LogMsg::BlueprintActivationCommand(_) => contents.activated = true,
                LogMsg::SetStoreInfo(_) => {}
            }
        }
        contents
    }

    #[test]
    fn every_pose_is_there_with_and_without_truth() {
        for (truth, chain, other) in [(true, "true", "calibrated"), (false, "calibrated", "true")] {
            let outcome = synthetic::outcome(6, 3, truth);
            let Contents { rows, timelines, .. } = contents(&outcome);
            assert_eq!(
                timelines.iter().map(String::as_str).collect::<Vec<_>>(),
                ["iteration", "pose", "sim_time"]
            );
            for path in [
                &format!("/scene/{chain}/chain"),
                &format!("/scene/{chain}/link7"),
                "/scene/line_of_sight",
                "/scene/residual_x100/with_gravity/at_this_pose",
                "/tables/pose",
            ] {
                assert_eq!(rows.get(path), Some(&9), "{path}");
            }
            assert_eq!(rows.get("/residual_mm/z/only_calibration"), Some(&9));
            assert_eq!(rows.get("/cost_log10/only_calibration"), Some(&5));
            assert!(!rows.contains_key("/cost_log10/without_calibration"));
            // The calibrated robot has the links' shapes where there is no machine to have them.
            for path in ["/scene/nominal/chain", "/scene/calibrated/chain"] {
                assert_eq!(rows.get(path), Some(&9), "{path}");
            }
            for path in [
                "/scene/deflection_x100/chain",
                "/scene/deflection_x100/linkage",
                "/scene/deflection_x100/at_target",
                "/scene/true/linkage",
                "/tables/machine",
            ] {
                assert_eq!(rows.get(path), truth.then_some(&9), "{path}");
            }
            for path in [
                "/machine/deflection_mm/x",
                "/machine/deflection_mm/norm",
                "/machine/rod_force_n",
                "/machine/temperature_c",
            ] {
                assert_eq!(rows.get(path), truth.then_some(&9), "{path}");
            }
            assert!(!rows.keys().any(|path| path.starts_with(&format!("/scene/{other}/link7"))));
        }
    }

    #[test]
    fn errors_and_estimates_are_there_as_a_whole() {
        let outcome = synthetic::outcome(6, 3, true);
        let Contents { rows, .. } = contents(&outcome);
        for mode in &outcome.modes {
            let key = mode.mode.key();
            for (set, axis) in [("identification", "norm"), ("verification", "x"), ("verification", "z")] {
                assert_eq!(rows.get(&format!("/error_histogram/{set}/{key}/{axis}")), Some(&1), "{key}");
            }
            let identified = mode.estimate.is_some();
            for path in ["correlation/KEY/groups", "tables/correlation/KEY"] {
                let path = format!("/{}", path.replace("KEY", key));
                assert_eq!(rows.get(&path), identified.then_some(&1), "{path}");
            }
            // The last of five iterations is at the end: no logarithm.
            let root = format!("/convergence/{key}/");
            let curves: Vec<_> = rows.iter().filter(|(path, _)| path.starts_with(&root)).collect();
            assert_eq!(curves.len(), if identified { 6 } else { 0 });
            assert!(curves.iter().all(|(_, rows)| **rows == 4), "{curves:?}");
        }
        assert_eq!(rows.get("/tables/convergence"), Some(&1));
    }

    #[test]
    fn the_layout_lies_in_the_recording_with_its_eye() {
        let Contents { layout, activated, .. } = contents(&synthetic::outcome(3, 1, true));
        assert!(activated);
        assert!(layout.contains("/viewport"));
        let count = |end: &str| layout.iter().filter(|path| path.ends_with(end)).count();
        assert_eq!(count("/EyeControls3D"), 2);
        // Two of the residuals, one a histogram, one a mode and the cost's.
        assert_eq!(count("/PlotLegend"), 2 + 2 * 5 * 4 + 4 + 1);
        assert_eq!(count("/ViewContents/overrides/scene/calibrated/visualizers"), 1);
    }

    #[test]
    fn a_viewer_reads_the_layout_before_the_recording() {
        let outcome = synthetic::outcome(3, 1, true);
        let mut recorder = RerunRecorder::new(&outcome.story()).expect("begun");
        record(&outcome.story(), &mut recorder).expect("recorded");
        let messages = recorder.writer.messages().expect("told");
        let first = messages.iter().position(|m| !m.store_id().is_blueprint()).expect("a recording");
        assert!(messages[first..].iter().all(|m| !m.store_id().is_blueprint()));
        assert!(matches!(messages[first - 1], LogMsg::BlueprintActivationCommand(_)));
        assert!(matches!(messages[0], LogMsg::SetStoreInfo(_)));
    }

    #[test]
    fn the_same_run_is_told_in_the_same_order() {
        let outcome = synthetic::outcome(6, 3, true);
        let told = || {
            let mut recorder = RerunRecorder::new(&outcome.story()).expect("begun");
            record(&outcome.story(), &mut recorder).expect("recorded");
            let messages = recorder.writer.messages().expect("told");
            let chunks = messages.into_iter().filter_map(|message| match message {
                LogMsg::ArrowMsg(_, message) => Some(Chunk::from_arrow_msg(&message).expect("sound")),
                _ => None,
            });
            // Without their identities and the time of day.
            let recorded = chunks.filter(|chunk| chunk.entity_path().to_string() != "/__properties");
            recorded.collect::<Vec<_>>()
        };
        let (one, other) = (told(), told());
        assert_eq!(one.len(), other.len());
        for (one, other) in one.iter().zip(&other) {
            if let Err(difference) = Chunk::ensure_similar(one, other) {
                panic!("{}: {difference}", one.entity_path());
            }
        }
    }

    #[test]
    fn a_file_is_written_even_of_nothing_but_a_model() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("recording.rrd");
        let mut outcome = synthetic::outcome(0, 0, false);
        write_rrd(&outcome.story(), &path).expect("written");
        outcome.sets.clear();
        outcome.modes.clear();
        outcome.visuals.clear();
        outcome.model.statics = None;
        write_rrd(&outcome.story(), &path).expect("written");
        assert!(std::fs::read(&path).expect("read").starts_with(b"RRF"));
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1);
    }
}
