//! Rerun's own format, with a layout of its views: for looking at, not for replay.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use rerun::archetypes::{SeriesLines, TextDocument};
use rerun::components::Radius;
use rerun::external::re_log_encoding::Encoder;
use rerun::log::LogMsg;
use rerun::sink::LogSink;
use rerun::{AsComponents, RecordingStream, RecordingStreamBuilder, SerializedComponentBatch};

use super::Story;
use super::file::write_whole;
use super::rerun_analysis::COST;
use super::rerun_columns::{self, Columns, Shown, Time};
use super::rerun_layout::{self, Force};
use super::rerun_scene::color;
use super::scene::{self, Sighting};
use super::{
    Chain, ChainKind, LogEntry, Measured, PoseStep, Preamble, Recorder, RecordingError, record_evaluation,
    tables,
};
use calibrig_estimation::evaluation::ModeOutcome;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
use calibrig_estimation::identification::Mode;
use calibrig_model::measurement::{SetKind, SetOutcome};

pub(super) const APPLICATION: &str = "calibrig";
/// Root of all that is drawn in the base frame.
pub(super) const SCENE: &str = "scene";
/// Residual arrows; the scale is [`super::RESIDUAL_SCALE`].
pub(super) const ARROWS: &str = "scene/residual_x100";
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];
pub(super) const NORM: &str = "norm";
const CURVES: [&str; 4] = ["x", "y", "z", NORM];
/// The machine larger than life; the scale is [`super::DEFLECTION_SCALE`].
pub(super) const DEFLECTED: &str = "scene/deflection_x100";
/// The robot as identified.
pub(super) const CALIBRATED: &str = "scene/calibrated";
/// A path that was driven, as it was to be.
pub(super) const PATH: &str = "scene/path";
/// The same as measured; the scale of the errors is [`super::RESIDUAL_SCALE`].
pub(super) const DRIVEN_PATH: &str = "scene/path_x100";
/// Of the target, by all that yields.
pub(super) const DEFLECTION: &str = "machine/deflection_mm";
pub(super) const ROD_FORCE: &str = "machine/rod_force_n";
pub(super) const TEMPERATURE: &str = "machine/temperature_c";

/// Writes a Rerun recording of `story`. The file is whole or not there.
pub fn write_rrd(story: &Story<'_>, path: &Path) -> Result<(), RecordingError> {
    save_rrd(&rrd_of(story)?, path)
}

/// The bytes of a Rerun recording of `story`.
pub fn rrd_of(story: &Story<'_>) -> Result<Vec<u8>, RecordingError> {
    let mut recorder = RerunRecorder::new(story)?;
    record_evaluation(story, &mut recorder)?;
    recorder.finish()
}

/// Writes what [`rrd_of`] made. The file is whole or not there.
pub fn save_rrd(bytes: &[u8], path: &Path) -> Result<(), RecordingError> {
    write_whole(path, |mut file| {
        file.write_all(bytes).and_then(|()| file.flush()).map_err(RecordingError::unrecordable)
    })
}

/// Makes a Rerun recording: in memory, or in an open viewer ([`LiveRecorder`](super::LiveRecorder)).
pub struct RerunRecorder {
    way: Way,
    /// Poses that were shown while they were measured.
    live: i64,
    /// The poses that were told.
    poses: Vec<Told>,
}

/// Where it goes.
enum Way {
    /// To a viewer, at once.
    Stream(RecordingStream),
    /// Into a file, when all is told. The layout comes first.
    File { layout: Vec<LogMsg>, columns: Box<Columns> },
}

/// A pose that was told.
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
        let layout = rerun_layout::messages(story, Force::Default)?;
        let (_, store, properties, ..) = builder(&story.input.name).into_args();
        let columns = Box::new(Columns::new(store, &properties.unwrap_or_default())?);
        Ok(Self::on(Way::File { layout, columns }))
    }

    /// Begins a recording called `name` that `sink` is told at once.
    pub(super) fn telling(name: &str, sink: Box<dyn LogSink>) -> Result<Self, RecordingError> {
        let stream = builder(name)
            .batcher_config(sink.default_batcher_config())
            .buffered()
            .map_err(RecordingError::unrecordable)?;
        stream.set_sink(sink);
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        Ok(Self::on(Way::Stream(stream)))
    }

    fn on(way: Way) -> Self {
        Self { way, live: 0, poses: Vec::new() }
    }

    /// The bytes of the file; none where a viewer was told.
    pub fn finish(self) -> Result<Vec<u8>, RecordingError> {
        let mut encoder = Encoder::local().map_err(RecordingError::unrecordable)?;
        for message in self.messages()? {
            encoder.append(&message).map_err(RecordingError::unrecordable)?;
        }
        encoder.finish().map_err(RecordingError::unrecordable)?;
        encoder.into_inner().map_err(RecordingError::unrecordable)
    }

    /// All that was told in memory.
    fn messages(self) -> Result<Vec<LogMsg>, RecordingError> {
        // In front: a viewer that has read a part of the recording first makes up a layout of its own and keeps it.
        let Way::File { layout: mut messages, columns } = self.way else { return Ok(Vec::new()) };
        messages.extend(columns.messages()?);
        Ok(messages)
    }

    /// Queues a layout. A viewer that does not read holds up the stream's own thread, not the run.
    pub(super) fn lay_out(&mut self, mut messages: Vec<LogMsg>) {
        match &mut self.way {
            Way::Stream(stream) => {
                if let Some(LogMsg::BlueprintActivationCommand(activation)) = messages.pop() {
                    stream.send_blueprint(messages, activation);
                }
            }
            Way::File { layout, .. } => *layout = messages,
        }
    }

    /// The stream to a viewer.
    pub(super) fn into_stream(self) -> Option<RecordingStream> {
        match self.way {
            Way::Stream(stream) => Some(stream),
            Way::File { .. } => None,
        }
    }

    pub(super) fn fixed(&mut self, path: &str, shape: &impl AsComponents) -> Result<(), RecordingError> {
        match &mut self.way {
            Way::Stream(stream) => stream.log_static(path, shape).map_err(RecordingError::unrecordable),
            Way::File { columns, .. } => columns.fixed(path, shape),
        }
    }

    /// What the curve at `path` looks like.
    pub(super) fn curve(&mut self, path: &str, look: &impl AsComponents) -> Result<(), RecordingError> {
        match &mut self.way {
            Way::Stream(_) => self.fixed(path, look),
            Way::File { columns, .. } => {
                columns.curve(path, look);
                Ok(())
            }
        }
    }

    pub(super) fn put(&mut self, path: &str, shown: Shown) -> Result<(), RecordingError> {
        match &mut self.way {
            Way::Stream(stream) => {
                let row = rerun_columns::columns(&[shown]).map_err(RecordingError::unrecordable)?;
                let values = row.into_iter().map(|column| {
                    SerializedComponentBatch::new(Arc::clone(column.list_array.values()), column.descriptor)
                });
                stream.log_serialized_batches(path, false, values).map_err(RecordingError::unrecordable)
            }
            Way::File { columns, .. } => columns.put(path, shown),
        }
    }

    /// What follows belongs to iteration `index`, from 0.
    pub(super) fn at_iteration(&mut self, index: usize) {
        self.at(Time::Iteration(i64::try_from(index).unwrap_or(i64::MAX).saturating_add(1)));
    }

    /// What follows belongs to `time`.
    fn at(&mut self, time: Time) {
        match (&mut self.way, time) {
            (Way::File { columns, .. }, time) => columns.at(time),
            (Way::Stream(stream), Time::Pose { number, nanos }) => {
                stream.reset_time();
                stream.set_time_sequence("pose", number);
                stream.set_duration_secs("sim_time", nanos as f64 * 1e-9);
            }
            (Way::Stream(stream), Time::Iteration(number)) => {
                stream.reset_time();
                stream.set_time_sequence("iteration", number);
            }
        }
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
                self.curve(&format!("residual_mm/{axis}/{key}"), &curve)?;
            }
            if mode.estimate.is_some() {
                self.curve(&format!("{COST}/{key}"), &curve)?;
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
            self.curve(&path, &curve)?;
        }
        Ok(())
    }

    fn document(&mut self, path: &str, markdown: String) -> Result<(), RecordingError> {
        self.fixed(path, &TextDocument::from_markdown(markdown))
    }

    /// A pose while it is measured, on the simulated machine.
    pub(super) fn measuring(
        &mut self,
        measured: &Measured<'_>,
        chains: &[Chain],
        sightings: &[Sighting],
    ) -> Result<(), RecordingError> {
        self.at(Told::of(self.live, measured).time());
        self.live += 1;
        self.seen(measured, chains, sightings)
    }

    /// What is seen of a pose: robots, lines of sight, and how the simulated machine gives way.
    fn seen(
        &mut self,
        measured: &Measured<'_>,
        chains: &[Chain],
        sightings: &[Sighting],
    ) -> Result<(), RecordingError> {
        for chain in chains {
            self.chain(chain, chain.kind.is_ghost())?;
        }
        self.sightings(sightings)?;
        self.deflection(measured)?;
        if let Some(deflection) = measured.deflection(0) {
            let norm = deflection.norm();
            for (axis, value) in CURVES.iter().zip(deflection.iter().chain([&norm])) {
                self.put(&format!("{DEFLECTION}/{axis}"), Shown::Value(1e3 * value))?;
            }
        }
        let Some(settled) = measured.truth.first() else { return Ok(()) };
        if let Some(force) = settled.rod_force {
            self.put(ROD_FORCE, Shown::Value(force))?;
        }
        if let Some(temperature) = measured.effects.first().and_then(|effects| effects.temperature) {
            self.put(TEMPERATURE, Shown::Value(temperature))?;
        }
        self.put("tables/machine", Shown::Page(tables::machine(measured)))
    }

    /// The robot before calibration and as identified at every pose, beside what was told of the pose itself.
    fn robots(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        for told in self.poses.clone() {
            let Some(set) = story.sets.iter().find(|set| set.kind == told.set) else { continue };
            let Some(observation) = set.measurements.observations.get(told.first) else { continue };
            self.at(told.time());
            if story.truth.is_some() {
                if let Some(calibrated) = scene::calibrated_chain(story, observation) {
                    self.chain(&calibrated, true)?;
                }
            } else if let Some(target) = set.measurements.targets.get(observation.target)
                // The calibrated one stands for the machine and was told with the pose.
                && let Some(nominal) = scene::nominal_chain(story.model, &target.in_flange, observation)
            {
                self.chain(&nominal, true)?;
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
            self.put(&format!("{ARROWS}/{key}/at_this_pose"), arrows)?;
            let Some(error) = residuals.errors.first() else { continue };
            for (axis, value) in AXES.iter().zip(error.iter()) {
                self.put(&format!("residual_mm/{axis}/{key}"), Shown::Value(1e3 * value))?;
            }
            self.put(&format!("residual_mm/norm/{key}"), Shown::Value(1e3 * error.norm()))?;
        }
        Ok(())
    }
}

impl Recorder for RerunRecorder {
    // The file is written when the run is over: its views show the session with what was made of it.
    fn open(&mut self, _: &Preamble<'_>) -> Result<(), RecordingError> {
        Ok(())
    }
    fn set(&mut self, _: u64, _: &SetOutcome, _: Option<u32>) -> Result<(), RecordingError> {
        Ok(())
    }
    fn measured(&mut self, _: &Measured<'_>) -> Result<(), RecordingError> {
        Ok(())
    }
    fn dropped(&mut self, _: u64, _: SetKind, _: u32, _: &str) -> Result<(), RecordingError> {
        Ok(())
    }
    fn set_end(&mut self, _: u64, _: SetKind, _: usize) -> Result<(), RecordingError> {
        Ok(())
    }

    fn begin(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        let solid = if story.truth.is_some() { ChainKind::True } else { ChainKind::Calibrated };
        self.surroundings(&scene::up(story), &scene::trackers(story), scene::nests(story.sets))?;
        self.robot(solid, story.visuals)?;
        self.all_measured(story)?;
        self.curves(story)?;
        self.document("tables/accuracy", tables::about(story) + &tables::accuracy(story))?;
        self.document("tables/parameters", tables::parameters(story))?;
        self.document("tables/identification", tables::estimates(story))
    }

    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let told = Told::of(i64::from(step.number), &step.measured);
        self.poses.push(told);
        self.at(told.time());
        if told.number >= self.live {
            self.seen(&step.measured, &step.chains, &step.sightings)?;
        }
        self.residuals(step)?;
        self.put("tables/pose", Shown::Page(tables::pose(step)))
    }

    fn estimate(&mut self, _: u64, story: &Story<'_>, mode: &ModeOutcome) -> Result<(), RecordingError> {
        if let Some(estimate) = &mode.estimate {
            self.correlations(mode.mode, estimate)?;
            self.convergence(mode.mode, estimate)?;
        }
        if story.modes.last().is_some_and(|last| last.mode == mode.mode) {
            self.histograms(story)?;
            self.document("tables/convergence", tables::convergence(story))?;
            self.robots(story)?;
        }
        Ok(())
    }

    fn closed_loop(&mut self, _: u64, driven: &ClosedLoop) -> Result<(), RecordingError> {
        self.document("tables/compensation", tables::compensation(driven))?;
        driven.path.as_ref().map_or(Ok(()), |path| self.driven_path(path))
    }

    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
        let number = self.poses.last().map_or(0, |told| told.number);
        self.at(Time::Pose { number, nanos: signed(entry.time) });
        self.put("log", Shown::Entry(entry.level, entry.message.clone()))
    }
}

/// Nanoseconds as Rerun counts them: good for 292 years.
fn signed(nanos: u64) -> i64 {
    i64::try_from(nanos).unwrap_or(i64::MAX)
}

fn builder(name: &str) -> RecordingStreamBuilder {
    // Whatever the environment says: the user asked for it.
    RecordingStreamBuilder::new(APPLICATION).enabled(true).recording_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{BTreeMap, BTreeSet};

    use rerun::log::Chunk;

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
        for message in recorder.messages().expect("told") {
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
        let messages = recorder.messages().expect("told");
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
            let messages = recorder.messages().expect("told");
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
