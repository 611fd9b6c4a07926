//! Rerun's own format, with a layout of its views: for looking at, not for replay.

use std::io::Write;
use std::path::Path;
use std::time::Duration;

use nalgebra::{UnitQuaternion, Vector3};
use rerun::archetypes::{
    Arrows3D, Boxes3D, Cylinders3D, Ellipsoids3D, LineStrips3D, Points3D, Scalars, SeriesLines, TextDocument,
    TextLog, Transform3D, ViewCoordinates,
};
use rerun::components::{Color, FillMode, Radius, TextLogLevel};
use rerun::external::re_log_encoding::Encoder;
use rerun::log::{ChunkBatcherConfig, ChunkResult, LogMsg};
use rerun::sink::{LogSink, MemorySinkStorage};
use rerun::{AsComponents, Quaternion, RecordingStream, RecordingStreamBuilder};

use super::file::write_whole;
use super::rerun_analysis::COST;
use super::scene::{self, Arrow, Colour};
use super::{
    Chain, ChainKind, DEFLECTION_SCALE, LogEntry, LogLevel, Measured, PoseStep, Preamble, RESIDUAL_SCALE,
    Recorder, RecordingError, record, rerun_layout, tables,
};
use crate::geometry::Transform;
use crate::identification::Mode;
use crate::model::{Visual, VisualShape};
use crate::pipeline::{ModeOutcome, Outcome, SetKind, SetOutcome};

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
/// Length of the bars that show the scale of what is drawn larger than life, m.
const SCALE_BAR: f64 = 0.5;
/// Of the target, by all that yields.
pub(super) const DEFLECTION: &str = "machine/deflection_mm";
pub(super) const ROD_FORCE: &str = "machine/rod_force_n";
pub(super) const TEMPERATURE: &str = "machine/temperature_c";

/// Writes a Rerun recording of `outcome`. The file is whole or not there.
pub fn write_rrd(outcome: &Outcome, path: &Path) -> Result<(), RecordingError> {
    write_whole(path, |mut file| {
        let mut recorder = RerunRecorder::new(outcome)?;
        record(outcome, &mut recorder)?;
        // Through memory, because Rerun's own file sink only logs that a disk is full.
        file.write_all(&recorder.finish()?).and_then(|()| file.flush()).map_err(RecordingError::unrecordable)
    })
}

/// Makes a Rerun recording: in memory, or in an open viewer ([`LiveRecorder`](super::LiveRecorder)).
pub struct RerunRecorder {
    stream: RecordingStream,
    /// What was told, unless a viewer is told; the layout comes first.
    layout: Vec<LogMsg>,
    storage: Option<MemorySinkStorage>,
    /// The poses that were told.
    poses: Vec<Told>,
}

/// A pose that was told: its running number, time (s), set, and the place of its first observation there.
#[derive(Debug, Clone, Copy)]
struct Told {
    number: i64,
    seconds: f64,
    set: SetKind,
    first: usize,
}

impl RerunRecorder {
    /// Begins a recording in memory, with views that suit `outcome`.
    pub fn new(outcome: &Outcome) -> Result<Self, RecordingError> {
        let layout = rerun_layout::messages(outcome)?;
        let (stream, storage) = builder(outcome)
            // Cut into chunks by their size alone, not by the clock.
            .batcher_config(ChunkBatcherConfig { flush_tick: Duration::MAX, ..ChunkBatcherConfig::DEFAULT })
            .memory()
            .map_err(RecordingError::unrecordable)?;
        Ok(Self::on(stream, layout, Some(storage)))
    }

    /// Begins a recording that `sink` is told at once.
    pub(super) fn telling(outcome: &Outcome, sink: Box<dyn LogSink>) -> Result<Self, RecordingError> {
        sink.send_all(rerun_layout::messages(outcome)?);
        let stream = builder(outcome)
            .batcher_config(sink.default_batcher_config())
            .buffered()
            .map_err(RecordingError::unrecordable)?;
        stream.set_sink(sink);
        Ok(Self::on(stream, Vec::new(), None))
    }

    fn on(stream: RecordingStream, layout: Vec<LogMsg>, storage: Option<MemorySinkStorage>) -> Self {
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        Self { stream, layout, storage, poses: Vec::new() }
    }

    /// The bytes of the file.
    pub fn finish(self) -> Result<Vec<u8>, RecordingError> {
        // In front: a viewer that has read a part of the recording first makes up a layout of its own and keeps it.
        let messages = self.messages();
        Encoder::encode(messages.iter().map(ChunkResult::Ok)).map_err(RecordingError::unrecordable)
    }

    /// All that was told in memory, and not yet taken.
    fn messages(mut self) -> Vec<LogMsg> {
        let mut messages = std::mem::take(&mut self.layout);
        messages.extend(self.storage.iter().flat_map(MemorySinkStorage::take));
        messages
    }

    pub(super) fn into_stream(self) -> RecordingStream {
        self.stream
    }

    pub(super) fn fixed(&self, path: &str, shape: &impl AsComponents) -> Result<(), RecordingError> {
        self.stream.log_static(path, shape).map_err(RecordingError::unrecordable)
    }

    pub(super) fn put(&self, path: &str, shape: &impl AsComponents) -> Result<(), RecordingError> {
        self.stream.log(path, shape).map_err(RecordingError::unrecordable)
    }

    /// What follows belongs to iteration `index`, from 0.
    pub(super) fn at_iteration(&self, index: usize) {
        self.stream.reset_time();
        self.stream
            .set_time_sequence("iteration", i64::try_from(index).unwrap_or(i64::MAX).saturating_add(1));
    }

    /// What follows belongs to a pose.
    fn at_pose(&self, told: Told) {
        self.stream.reset_time();
        self.stream.set_time_sequence("pose", told.number);
        self.stream.set_duration_secs("sim_time", told.seconds);
    }

    fn robot(&self, outcome: &Outcome) -> Result<(), RecordingError> {
        let shown = scene::chains(outcome, 0, 0);
        let Some(chain) = shown.iter().find(|c| !c.kind.is_ghost()) else { return Ok(()) };
        for (i, visuals) in outcome.visuals.iter().enumerate() {
            let link = if i == 0 { format!("{SCENE}/base") } else { link_path(chain, i - 1) };
            self.shapes(&link, visuals)?;
        }
        Ok(())
    }

    fn shapes(&self, link: &str, visuals: &[Visual]) -> Result<(), RecordingError> {
        let grey = color(scene::SHELL);
        for (i, visual) in visuals.iter().enumerate() {
            let path = format!("{link}/shape{}", i + 1);
            let centre = [xyz(&visual.link_from_shape.translation.vector)];
            let turn = [quaternion(&visual.link_from_shape)];
            match visual.shape {
                VisualShape::Box(edges) => self.fixed(
                    &path,
                    &Boxes3D::from_centers_and_sizes(centre, [xyz(&edges.into())])
                        .with_quaternions(turn)
                        .with_colors([grey])
                        .with_fill_mode(FillMode::Solid),
                )?,
                VisualShape::Cylinder { radius, length } => self.fixed(
                    &path,
                    &Cylinders3D::from_lengths_and_radii([single(length)], [single(radius)])
                        .with_centers(centre)
                        .with_quaternions(turn)
                        .with_colors([grey])
                        .with_fill_mode(FillMode::Solid),
                )?,
                VisualShape::Sphere(radius) => self.fixed(
                    &path,
                    &Ellipsoids3D::from_centers_and_radii(centre, [single(radius)])
                        .with_colors([grey])
                        .with_fill_mode(FillMode::Solid),
                )?,
            }
        }
        Ok(())
    }

    fn instruments(&self, outcome: &Outcome) -> Result<(), RecordingError> {
        let places: Vec<_> = scene::trackers(outcome).iter().map(|t| xyz(&t.translation.vector)).collect();
        let names = (1..=places.len()).map(|number| format!("tracker, station {number}"));
        let trackers = Points3D::new(places.clone())
            .with_labels(names)
            .with_show_labels(true)
            .with_colors([color(scene::TRACKER)])
            .with_radii([0.12]);
        self.fixed(&format!("{SCENE}/trackers"), &trackers)?;
        let (names, places): (Vec<_>, Vec<_>) = scene::nests(outcome).into_iter().unzip();
        let nests = Points3D::new(places.iter().map(xyz))
            .with_labels(names)
            .with_show_labels(false)
            .with_colors([color(scene::NEST)])
            .with_radii([0.04]);
        self.fixed(&format!("{SCENE}/nests"), &nests)
    }

    /// Bars beside the first tracker (or the base) that show how long an error or a deflection is drawn.
    fn scales(&self, outcome: &Outcome) -> Result<(), RecordingError> {
        let up = scene::up(outcome);
        let place = scene::trackers(outcome).first().map_or_else(Vector3::zeros, |t| t.translation.vector);
        let bar = |path: &str, what: &str, scale: f64, place: Vector3<f64>, colour: Colour| {
            let along = SCALE_BAR * scene::across(&up).into_inner();
            let bar = Arrows3D::from_vectors([xyz(&along)])
                .with_origins([xyz(&place)])
                .with_labels([format!("{:.0} mm of {what}", 1e3 * SCALE_BAR / scale)])
                .with_show_labels(true)
                .with_colors([color(colour)])
                .with_radii([Radius::new_ui_points(3.0)]);
            self.fixed(path, &bar)
        };
        bar(&format!("{ARROWS}/scale"), "error", RESIDUAL_SCALE, place + 0.5 * up, scene::POINT)?;
        if outcome.truth.is_none() {
            return Ok(());
        }
        bar(&format!("{DEFLECTED}/scale"), "deflection", DEFLECTION_SCALE, place + 0.5 * up, scene::DEFLECTED)
    }

    /// All measured points and all arrows: they do not change with the pose.
    fn all_measured(&self, outcome: &Outcome) -> Result<(), RecordingError> {
        for (index, set) in outcome.sets.iter().enumerate() {
            let key = set.kind.key();
            let points = scene::measured_points(outcome, &set.measurements);
            let points = Points3D::new(points.iter().map(xyz))
                .with_colors([color(scene::POINT)])
                .with_radii([Radius::new_ui_points(2.0)]);
            self.fixed(&format!("{SCENE}/measured/{key}"), &points)?;
            for mode in &outcome.modes {
                let observations = &set.measurements.observations;
                let errors = mode.errors.get(index).map_or(&[][..], Vec::as_slice);
                let arrows: Vec<_> =
                    observations.iter().zip(errors).filter_map(|(o, e)| scene::arrow(mode, o, e)).collect();
                let path = format!("{ARROWS}/{}/{key}", mode.mode.key());
                self.fixed(&path, &arrows3d(&arrows, scene::mode_colour(mode.mode), 1.0))?;
            }
        }
        Ok(())
    }

    /// Names and colours of the curves.
    fn curves(&self, outcome: &Outcome) -> Result<(), RecordingError> {
        for mode in &outcome.modes {
            let (key, title) = (mode.mode.key(), mode.mode.title());
            let curve = SeriesLines::new()
                .with_names([title])
                .with_colors([color(scene::mode_colour(mode.mode))])
                .with_widths([1.5]);
            for axis in CURVES {
                self.fixed(&format!("residual_mm/{axis}/{key}"), &curve)?;
            }
            if mode.estimate.is_some() {
                self.fixed(&format!("{COST}/{key}"), &curve)?;
            }
        }
        if outcome.truth.is_none() {
            return Ok(());
        }
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
            self.fixed(&path, &curve)?;
        }
        Ok(())
    }

    fn document(&self, path: &str, markdown: String) -> Result<(), RecordingError> {
        self.fixed(path, &TextDocument::from_markdown(markdown))
    }

    /// A robot: with its links' shapes, or as a line alone.
    fn chain(&self, chain: &Chain, ghost: bool) -> Result<(), RecordingError> {
        for (i, link) in chain.links.iter().enumerate().filter(|_| !ghost) {
            let place =
                Transform3D::from_translation_rotation(xyz(&link.translation.vector), quaternion(link));
            self.put(&link_path(chain, i), &place)?;
        }
        // Beside the machine, the calibrated robot has to be told from it.
        let beside = ghost && chain.kind == ChainKind::Calibrated;
        let colour = if beside { scene::mode_colour(Mode::Extended) } else { chain.kind.colour() };
        let colour = [color(colour)];
        let root = format!("{SCENE}/{}", chain.kind.key());
        let thickness = if chain.kind == ChainKind::Nominal { 1.0 } else { 2.5 };
        let strip = |points: &[Vector3<f64>]| LineStrips3D::new([points.iter().map(xyz).collect::<Vec<_>>()]);
        let line =
            strip(&chain.polyline()).with_colors(colour).with_radii([Radius::new_ui_points(thickness)]);
        self.put(&format!("{root}/chain"), &line)?;
        if let Some(linkage) = &chain.linkage {
            let radius = if ghost {
                Radius::new_ui_points(thickness)
            } else {
                Radius::new_scene_units(single(scene::ROD_RADIUS))
            };
            self.put(&format!("{root}/linkage"), &strip(linkage).with_colors(colour).with_radii([radius]))?;
        }
        Ok(())
    }

    /// How far the target gives way, as long as the machine larger than life has it.
    fn deflection(&self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let (Some(deflection), Some(rigid)) = (step.measured.deflection(0), step.measured.rigid.first())
        else {
            return Ok(());
        };
        let drawn = DEFLECTION_SCALE * deflection;
        let label =
            format!("{:.1} mm of deflection, drawn as {:.2} m", 1e3 * deflection.norm(), drawn.norm());
        let arrow = Arrows3D::from_vectors([xyz(&drawn)])
            .with_origins([xyz(&rigid.target)])
            .with_labels([label])
            .with_show_labels(true)
            .with_colors([color(scene::DEFLECTED)])
            .with_radii([Radius::new_ui_points(2.5)]);
        self.put(&format!("{DEFLECTED}/at_target"), &arrow)
    }

    /// The robot before calibration and as identified at every pose, beside what was told of the pose itself.
    fn robots(&self, outcome: &Outcome) -> Result<(), RecordingError> {
        for told in &self.poses {
            let Some(set) = outcome.sets.iter().find(|set| set.kind == told.set) else { continue };
            let Some(observation) = set.measurements.observations.get(told.first) else { continue };
            self.at_pose(*told);
            if outcome.truth.is_none() {
                // The calibrated one stands for the machine and was told with the pose.
                if let Some(nominal) = scene::nominal_chain(outcome, &set.measurements, observation) {
                    self.chain(&nominal, true)?;
                }
            } else if let Some(calibrated) = scene::calibrated_chain(outcome, observation) {
                self.chain(&calibrated, true)?;
            }
        }
        self.stream.reset_time();
        Ok(())
    }

    /// The simulated machine at the first observation of a pose.
    fn machine(&self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        if let Some(deflection) = step.measured.deflection(0) {
            let norm = deflection.norm();
            for (axis, value) in CURVES.iter().zip(deflection.iter().chain([&norm])) {
                self.put(&format!("{DEFLECTION}/{axis}"), &Scalars::single(1e3 * value))?;
            }
        }
        let Some(settled) = step.measured.truth.first() else { return Ok(()) };
        if let Some(force) = settled.rod_force {
            self.put(ROD_FORCE, &Scalars::single(force))?;
        }
        if let Some(temperature) = step.measured.effects.first().and_then(|effects| effects.temperature) {
            self.put(TEMPERATURE, &Scalars::single(temperature))?;
        }
        self.put("tables/machine", &TextDocument::from_markdown(tables::machine(step)))
    }

    fn sightings(&self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let lines = step.sightings.iter().map(|s| vec![xyz(&s.tracker), xyz(&s.point)]);
        let beams = LineStrips3D::new(lines.collect::<Vec<_>>())
            .with_colors([color(scene::BEAM)])
            .with_radii([Radius::new_ui_points(1.0)]);
        self.put(&format!("{SCENE}/line_of_sight"), &beams)?;
        let targets = Points3D::new(step.sightings.iter().map(|s| xyz(&s.point)))
            .with_colors([color(scene::BEAM)])
            .with_radii([0.05]);
        self.put(&format!("{SCENE}/target"), &targets)
    }

    fn residuals(&self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        for residuals in &step.residuals {
            let key = residuals.mode.key();
            let arrows = arrows3d(&residuals.arrows, scene::mode_colour(residuals.mode), 3.0);
            self.put(&format!("{ARROWS}/{key}/at_this_pose"), &arrows)?;
            let Some(error) = residuals.errors.first() else { continue };
            for (axis, value) in AXES.iter().zip(error.iter()) {
                self.put(&format!("residual_mm/{axis}/{key}"), &Scalars::single(1e3 * value))?;
            }
            self.put(&format!("residual_mm/norm/{key}"), &Scalars::single(1e3 * error.norm()))?;
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

    fn begin(&mut self, outcome: &Outcome) -> Result<(), RecordingError> {
        self.fixed(SCENE, &coordinates(&scene::up(outcome)))?;
        self.robot(outcome)?;
        self.instruments(outcome)?;
        self.scales(outcome)?;
        self.all_measured(outcome)?;
        self.curves(outcome)?;
        self.document("tables/accuracy", tables::about(outcome) + &tables::accuracy(outcome))?;
        self.document("tables/parameters", tables::parameters(outcome))?;
        self.document("tables/identification", tables::estimates(outcome))
    }

    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let told = Told {
            number: i64::from(step.number),
            seconds: step.measured.time() as f64 * 1e-9,
            set: step.set.kind,
            first: step.measured.first,
        };
        self.poses.push(told);
        self.at_pose(told);
        for chain in &step.chains {
            self.chain(chain, chain.kind.is_ghost())?;
        }
        self.deflection(step)?;
        self.sightings(step)?;
        self.residuals(step)?;
        self.machine(step)?;
        self.put("tables/pose", &TextDocument::from_markdown(tables::pose(step)))
    }

    fn estimate(&mut self, _: u64, outcome: &Outcome, mode: &ModeOutcome) -> Result<(), RecordingError> {
        if let Some(estimate) = &mode.estimate {
            self.correlations(mode.mode, estimate)?;
            self.convergence(mode.mode, estimate)?;
        }
        if outcome.modes.last().is_some_and(|last| last.mode == mode.mode) {
            self.histograms(outcome)?;
            self.document("tables/convergence", tables::convergence(outcome))?;
            self.robots(outcome)?;
        }
        self.stream.reset_time();
        Ok(())
    }

    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
        let level = match entry.level {
            LogLevel::Info => TextLogLevel::INFO,
            LogLevel::Warning => TextLogLevel::WARN,
        };
        let pose = self.poses.last().map_or(0, |told| told.number);
        self.stream.set_time_sequence("pose", pose);
        self.stream.set_duration_secs("sim_time", entry.time as f64 * 1e-9);
        self.put("log", &TextLog::new(entry.message.as_str()).with_level(level))
    }
}

fn builder(outcome: &Outcome) -> RecordingStreamBuilder {
    // Whatever the environment says: the user asked for it.
    RecordingStreamBuilder::new(APPLICATION).enabled(true).recording_name(outcome.input.name.as_str())
}

fn link_path(chain: &Chain, index: usize) -> String {
    format!("{SCENE}/{}", chain.frame(index))
}

fn arrows3d(arrows: &[Arrow], rgba: Colour, thickness: f32) -> Arrows3D {
    Arrows3D::from_vectors(arrows.iter().map(|a| xyz(&a.vector)))
        .with_origins(arrows.iter().map(|a| xyz(&a.origin)))
        .with_colors([color(rgba)])
        .with_radii([Radius::new_ui_points(thickness)])
}

/// Pictures are in single precision: 0.2 µm at 4 m.
#[allow(clippy::cast_possible_truncation)]
pub(super) fn single(value: f64) -> f32 {
    value as f32
}

pub(super) fn xyz(v: &Vector3<f64>) -> [f32; 3] {
    [single(v.x), single(v.y), single(v.z)]
}

fn quaternion(transform: &Transform) -> Quaternion {
    let q = UnitQuaternion::from_rotation_matrix(&transform.rotation);
    Quaternion::from_xyzw([q.i, q.j, q.k, q.w].map(single))
}

pub(super) fn color([r, g, b, a]: Colour) -> Color {
    Color::from_unmultiplied_rgba(r, g, b, a)
}

fn coordinates(up: &Vector3<f64>) -> ViewCoordinates {
    match (up.iamax(), up.sum() > 0.0) {
        (0, true) => ViewCoordinates::RIGHT_HAND_X_UP(),
        (0, false) => ViewCoordinates::RIGHT_HAND_X_DOWN(),
        (1, true) => ViewCoordinates::RIGHT_HAND_Y_UP(),
        (1, false) => ViewCoordinates::RIGHT_HAND_Y_DOWN(),
        (_, true) => ViewCoordinates::RIGHT_HAND_Z_UP(),
        (_, false) => ViewCoordinates::RIGHT_HAND_Z_DOWN(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{BTreeMap, BTreeSet};

    use rerun::log::Chunk;

    use crate::recording::synthetic;

    /// Rows by entity, over all times, and the names of all timelines.
    struct Contents {
        rows: BTreeMap<String, usize>,
        layout: BTreeSet<String>,
        timelines: BTreeSet<String>,
        activated: bool,
    }

    fn contents(outcome: &Outcome) -> Contents {
        let mut recorder = RerunRecorder::new(outcome).expect("begun");
        record(outcome, &mut recorder).expect("recorded");
        let mut contents = Contents {
            rows: BTreeMap::new(),
            layout: BTreeSet::new(),
            timelines: BTreeSet::new(),
            activated: false,
        };
        for message in recorder.messages() {
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
            // One more row holds the curve's name and colour.
            assert_eq!(rows.get("/residual_mm/z/only_calibration"), Some(&10));
            assert_eq!(rows.get("/cost_log10/only_calibration"), Some(&6));
            assert!(!rows.contains_key("/cost_log10/without_calibration"));
            for path in [
                "/scene/nominal/chain",
                "/scene/deflection_x100/chain",
                "/scene/deflection_x100/linkage",
                "/scene/deflection_x100/label",
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
                assert_eq!(rows.get(path), truth.then_some(&10), "{path}");
            }
            assert!(!rows.keys().any(|path| path.starts_with(&format!("/scene/{other}"))));
        }
    }

    #[test]
    fn the_layout_lies_in_the_recording_with_its_eye() {
        let Contents { layout, activated, .. } = contents(&synthetic::outcome(3, 1, true));
        assert!(activated);
        assert!(layout.contains("/viewport"));
        assert_eq!(layout.iter().filter(|path| path.ends_with("/EyeControls3D")).count(), 1);
        assert_eq!(layout.iter().filter(|path| path.ends_with("/PlotLegend")).count(), 2);
    }

    #[test]
    fn a_file_is_written_even_of_nothing_but_a_model() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("recording.rrd");
        let mut outcome = synthetic::outcome(0, 0, false);
        write_rrd(&outcome, &path).expect("written");
        outcome.sets.clear();
        outcome.modes.clear();
        outcome.visuals.clear();
        outcome.model.statics = None;
        write_rrd(&outcome, &path).expect("written");
        assert!(std::fs::read(&path).expect("read").starts_with(b"RRF"));
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1);
    }
}
