//! The record of truth: MCAP with the public `foxglove.*` messages for viewers and the `calibrig.v1` messages for replay.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use prost::{Message, Name};

use super::Story;
use super::estimate::estimate;
use super::file::write_whole;
use super::foxglove_scene::{
    arrows, cloud, driven_path, fixed_frames, log_line, moving_frames, moving_lines, planned_path, shapes,
};
use super::provenance::{METADATA, attached_inputs, metadata_of};
use super::scene;
use super::schema::{self, v1};
use super::{LogEntry, Measured, PoseStep, Preamble, Provenance, Recorder, RecordingError, record, truth};
use calibrig_estimation::evaluation::ModeOutcome;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
use calibrig_model::measurement::{SetKind, SetOutcome};

/// Greatest length of a record that is read back, bytes.
pub(super) const RECORD_LIMIT: usize = 64 << 20;
/// Poses are flushed as soon as one in this many of all poses so far is waiting, at least one: a kill costs little, and a long session is not
/// cut into many chunks.
const BATCHES: u32 = 100;

/// Writes an MCAP recording of `story`. The file is either complete or not written at all.
///
/// # Errors
/// The file cannot be written, or an input file is longer than 64 MiB.
pub fn write_mcap(story: &Story<'_>, path: &Path) -> Result<(), RecordingError> {
    write_whole(path, |file| {
        let mut recorder = McapRecorder::new(file)?;
        record(story, &mut recorder)?;
        recorder.finish()
    })
}

/// Where a recording goes.
trait Sink: Write + Seek {}
impl<T: Write + Seek> Sink for T {}

/// Writes MCAP to any seekable sink. It is not generic over the sink, so that it is compiled in this crate, which is optimised for speed.
pub struct McapRecorder<'a> {
    writer: Writer<Box<dyn Sink + 'a>>,
    /// Channel number and messages so far, by topic.
    channels: BTreeMap<String, (u16, u32)>,
    /// The message that is being encoded.
    buffer: Vec<u8>,
    /// Poses measured, and how many of them are not flushed.
    poses: (u32, u32),
    /// The machine, until its first pose names the elastic parts.
    machine: Option<v1::AsBuilt>,
}

/// The writer of all recordings. Message indexes cost a third of a small file, but Foxglove's reader refuses chunks without them. The
/// library's name and the number of threads are pinned: the same story gives the same bytes.
pub(super) fn writer<W: Write + Seek>(sink: W, profile: &str) -> Result<Writer<W>, RecordingError> {
    let options = WriteOptions::new()
        .profile(profile)
        .library(Provenance::software())
        .compression_threads(0)
        .compression_level(1);
    options.create(sink).map_err(RecordingError::unwritten)
}

impl<'a> McapRecorder<'a> {
    /// Begins a file.
    pub fn new(sink: impl Write + Seek + 'a) -> Result<Self, RecordingError> {
        Self::on(Box::new(sink))
    }

    fn on(sink: Box<dyn Sink + 'a>) -> Result<Self, RecordingError> {
        Ok(Self {
            writer: writer(sink, "")?,
            channels: BTreeMap::new(),
            buffer: Vec::new(),
            poses: (0, 0),
            machine: None,
        })
    }

    /// Ends the file and flushes the sink.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.writer.finish().map_err(RecordingError::unwritten)?;
        self.writer.into_inner().flush().map_err(RecordingError::unrecordable)
    }

    /// Publishes a message; `schema` is asked for on the first one of a topic.
    fn publish(
        &mut self,
        topic: &str,
        time: u64,
        schema: impl FnOnce() -> Option<(String, Cow<'static, [u8]>)>,
        message: &impl Message,
    ) -> Result<(), RecordingError> {
        let (channel_id, sequence) = match self.channels.get_mut(topic) {
            Some((channel, count)) => {
                *count = count.wrapping_add(1);
                (*channel, count.wrapping_sub(1))
            }
            None => {
                let schema = schema().ok_or_else(|| {
                    RecordingError::unrecordable(format!("no schema for the messages on {topic}"))
                })?;
                let channel = self.add_channel(topic, &schema).map_err(RecordingError::unwritten)?;
                self.channels.insert(topic.to_owned(), (channel, 1));
                (channel, 0)
            }
        };
        self.buffer.clear();
        message.encode(&mut self.buffer).map_err(RecordingError::unrecordable)?;
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, &self.buffer).map_err(RecordingError::unwritten)
    }

    fn add_channel(
        &mut self,
        topic: &str,
        (name, descriptors): &(String, Cow<'static, [u8]>),
    ) -> mcap::McapResult<u16> {
        let schema = self.writer.add_schema(name, "protobuf", descriptors)?;
        self.writer.add_channel(schema, topic, "protobuf", &BTreeMap::new())
    }

    /// Publishes a message of package `calibrig.v1`.
    fn own<M: Message + Name>(&mut self, topic: &str, time: u64, message: &M) -> Result<(), RecordingError> {
        self.publish(topic, time, || Some((M::full_name(), schema::DESCRIPTORS.into())), message)
    }

    /// Publishes a message of package `foxglove`.
    fn foxglove<M: Message + foxglove::Encode>(
        &mut self,
        topic: &str,
        time: u64,
        message: &M,
    ) -> Result<(), RecordingError> {
        let schema = || M::get_schema().map(|schema| (schema.name, schema.data));
        self.publish(topic, time, schema, message)
    }

    fn flush(&mut self) -> Result<(), RecordingError> {
        self.writer.flush().map_err(RecordingError::unwritten)
    }

    fn provenance(&mut self, preamble: &Preamble<'_>) -> Result<(), RecordingError> {
        let inputs = attached_inputs(preamble.sources);
        let metadata = Metadata { name: METADATA.to_owned(), metadata: metadata_of(preamble.input, &inputs) };
        self.writer.write_metadata(&metadata).map_err(RecordingError::unwritten)?;
        for (name, text) in inputs {
            // The header of the record is far below a kilobyte.
            let limit = RECORD_LIMIT - 1024;
            if text.len() > limit {
                return Err(RecordingError::AttachmentTooLong { name, bytes: text.len(), limit });
            }
            let media_type = media_type(&name).to_owned();
            let attachment =
                Attachment { log_time: 0, create_time: 0, name, media_type, data: text.into_bytes().into() };
            self.writer.attach(&attachment).map_err(RecordingError::unwritten)?;
        }
        Ok(())
    }

    fn residuals(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let measured = &step.measured;
        for (i, (observation, &time)) in measured.observations.iter().zip(measured.times).enumerate() {
            for residuals in &step.residuals {
                let Some(error) = residuals.errors.get(i) else { continue };
                let key = residuals.mode.key();
                let message = v1::Residual {
                    set: measured.kind.key().to_owned(),
                    index: schema::saturating(measured.first + i),
                    pose: observation.pose,
                    mode: key.to_owned(),
                    x: error.x,
                    y: error.y,
                    z: error.z,
                    norm: error.norm(),
                };
                self.own(&format!("/residual/{key}"), time, &message)?;
            }
        }
        Ok(())
    }
}

impl Recorder for McapRecorder<'_> {
    fn open(&mut self, preamble: &Preamble<'_>) -> Result<(), RecordingError> {
        self.provenance(preamble)?;
        self.machine = preamble.truth.map(|truth| truth::as_built(&preamble.model.kinematics, truth));
        self.flush()
    }

    fn set(&mut self, time: u64, set: &SetOutcome, planned: Option<u32>) -> Result<(), RecordingError> {
        self.own("/session", time, &schema::session(set, planned))?;
        for nest in schema::nests(set) {
            self.own("/nest", time, &nest)?;
        }
        self.flush()
    }

    fn measured(&mut self, measured: &Measured<'_>) -> Result<(), RecordingError> {
        if let (Some(machine), Some(settled)) = (&mut self.machine, measured.truth.first()) {
            machine.elastic = truth::elastic_names(settled);
            let machine = std::mem::take(machine);
            self.machine = None;
            self.own("/truth/as_built", 0, &machine)?;
        }
        let topic = format!("/measurement/{}", measured.kind.key());
        for (i, (observation, &time)) in measured.observations.iter().zip(measured.times).enumerate() {
            self.own(&topic, time, &schema::observation(measured.kind, measured.first + i, observation))?;
            if let Some(message) = truth::settled_pose(measured, i) {
                self.own("/truth/pose", time, &message)?;
            }
            if let Some(message) = truth::pose_effects(measured, i) {
                self.own("/truth/effects", time, &message)?;
            }
        }
        let (poses, open) = &mut self.poses;
        *poses = poses.saturating_add(1);
        *open += 1;
        if *open >= *poses / BATCHES {
            *open = 0;
            self.flush()?;
        }
        Ok(())
    }

    fn dropped(&mut self, time: u64, kind: SetKind, pose: u32, reason: &str) -> Result<(), RecordingError> {
        let set = kind.key().to_owned();
        self.own("/dropped", time, &v1::DroppedPose { pose, reason: reason.to_owned(), set })
    }

    fn set_end(&mut self, time: u64, kind: SetKind, observations: usize) -> Result<(), RecordingError> {
        let set = kind.key().to_owned();
        let observation_count = schema::saturating(observations);
        self.own("/session/end", time, &v1::SessionEnd { set, observation_count })?;
        self.flush()
    }

    fn begin(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        self.foxglove("/tf_static", 0, &fixed_frames(story))?;
        self.foxglove("/scene/robot", 0, &shapes(story))?;
        for set in story.sets {
            let points = scene::measured_points(story, &set.measurements);
            self.foxglove(&format!("/targets/{}", set.kind.key()), 0, &cloud(0, &points))?;
        }
        Ok(())
    }

    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let time = step.measured.time();
        self.foxglove("/tf", time, &moving_frames(step))?;
        self.foxglove("/scene", time, &moving_lines(step))?;
        let points: Vec<_> = step.sightings.iter().map(|s| s.point).collect();
        self.foxglove("/targets", time, &cloud(time, &points))?;
        for residuals in &step.residuals {
            let name = format!("pose {}", step.number);
            let update = arrows(time, name, &residuals.arrows, scene::mode_colour(residuals.mode));
            self.foxglove(&format!("/scene/residual_x100/{}", residuals.mode.key()), time, &update)?;
        }
        self.residuals(step)
    }

    fn estimate(&mut self, time: u64, story: &Story<'_>, mode: &ModeOutcome) -> Result<(), RecordingError> {
        self.own(&format!("/estimate/{}", mode.mode.key()), time, &estimate(story.sets, mode))
    }

    fn closed_loop(&mut self, time: u64, driven: &ClosedLoop) -> Result<(), RecordingError> {
        let of_path = driven.path.iter().flat_map(|path| &path.modes).map(|mode| ("/compensated/path", mode));
        for (root, mode) in driven.modes.iter().map(|mode| ("/compensated", mode)).chain(of_path) {
            let key = mode.mode.key();
            for point in &mode.points {
                self.own(&format!("{root}/{key}"), time, &schema::driven_point(mode.mode, point))?;
            }
        }
        if let Some(path) = &driven.path {
            self.foxglove("/scene/path", time, &planned_path(time, path))?;
            for mode in &path.modes {
                let topic = format!("/scene/path_x100/{}", mode.mode.key());
                self.foxglove(&topic, time, &driven_path(time, mode))?;
            }
        }
        Ok(())
    }

    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
        self.foxglove("/log", entry.time, &log_line(entry))
    }
}

fn media_type(name: &str) -> &'static str {
    match Path::new(name).extension().and_then(|e| e.to_str()) {
        Some("toml") => "application/toml",
        Some("urdf" | "xml") => "application/xml",
        Some("csv") => "text/csv",
        _ => "text/plain",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    use foxglove::messages::{FrameTransform, FrameTransforms, PointCloud, SceneUpdate};
    use mcap::MessageStream;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    use crate::RESIDUAL_SCALE;
    use crate::foxglove_scene::BASE;
    use crate::synthetic::{self, Outcome};
    use calibrig_model::geometry::Transform;

    fn bytes_of(outcome: &Outcome) -> Vec<u8> {
        synthetic::recorded(outcome)
    }

    fn messages<M: Message + Default>(bytes: &[u8], topic: &str) -> Vec<(u64, M)> {
        let all = MessageStream::new(bytes).expect("a file").map(|m| m.expect("sound"));
        all.filter(|m| m.channel.topic == topic)
            .map(|m| (m.log_time, M::decode(m.data.as_ref()).expect("decoded")))
            .collect()
    }

    fn transform(frame: &FrameTransform) -> Transform {
        let (t, q) = (frame.translation.expect("given"), frame.rotation.expect("given"));
        let q = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z));
        Transform::from_parts(Translation3::new(t.x, t.y, t.z), q.to_rotation_matrix())
    }

    #[test]
    fn frames_lead_from_the_base_to_the_settled_links() {
        let outcome = synthetic::outcome(4, 2, true);
        let frames: Vec<(u64, FrameTransforms)> = messages(&bytes_of(&outcome), "/tf");
        assert_eq!(frames.len(), 6);
        let settled = outcome.truth.iter().flat_map(|truth| truth.poses.iter().flatten());
        for ((_, frames), settled) in frames.iter().zip(settled) {
            let mut places = BTreeMap::from([(BASE.to_owned(), Transform::identity())]);
            for frame in &frames.transforms {
                let place = places[&frame.parent_frame_id] * transform(frame);
                places.insert(frame.child_frame_id.clone(), place);
            }
            for (link, number) in settled.links.iter().zip(1..) {
                let found = places[&format!("true/link{number}")];
                assert!((found.to_homogeneous() - link.to_homogeneous()).norm() < 1e-12);
            }
            let target = Vector3::new(0.10, 0.15, 0.20);
            let flange = places["true/flange"];
            assert!((flange.rotation * target + flange.translation.vector - settled.target).norm() < 1e-12);
            assert!(places.contains_key("nominal/flange") && places.contains_key("deflection_x100/flange"));
        }
    }

    #[test]
    fn the_truth_of_a_pose_is_told_whole() {
        let outcome = synthetic::outcome(3, 2, true);
        let bytes = bytes_of(&outcome);
        let known = outcome.truth.expect("simulated");
        let told: Vec<(u64, v1::SettledPose)> = messages(&bytes, "/truth/pose");
        let rest = known.poses.iter().flatten().zip(known.rigid.iter().flatten());
        assert_eq!(told.len(), rest.clone().count());
        for ((_, told), (settled, rigid)) in told.iter().zip(rest) {
            assert_eq!(
                (told.residual, told.closure, told.steps),
                (settled.residual, settled.closure, settled.steps)
            );
            assert_eq!(told.rod_force, settled.rod_force);
            assert_eq!(told.deflection, settled.deflection);
            assert_eq!(told.rigid_target, schema::vector(&rigid.target));
            let pins: Vec<_> = settled.linkage.iter().flatten().flat_map(schema::vector).collect();
            assert_eq!(told.linkage, pins);
            assert_eq!(told.elastic, settled.elastic.iter().map(|e| e.value).collect::<Vec<_>>());
        }
        let effects: Vec<(u64, v1::PoseEffects)> = messages(&bytes, "/truth/effects");
        let real = known.effects.iter().flatten();
        assert_eq!(effects.len(), real.clone().count());
        for ((_, told), real) in effects.iter().zip(real) {
            assert_eq!((&told.command, told.temperature), (&real.command, real.temperature));
            assert_eq!(told.displacements, real.displacements.as_flattened());
        }
        let machine: Vec<(u64, v1::AsBuilt)> = messages(&bytes, "/truth/as_built");
        assert_eq!(machine[0].1.elastic, ["bearing3_rx", "beam5_2_y", "rod"]);
    }

    #[test]
    fn arrows_are_the_residuals_a_hundred_times() {
        let outcome = synthetic::outcome(4, 0, false);
        let bytes = bytes_of(&outcome);
        for mode in &outcome.modes {
            let key = mode.mode.key();
            let updates: Vec<(u64, SceneUpdate)> = messages(&bytes, &format!("/scene/residual_x100/{key}"));
            let residuals: Vec<(u64, v1::Residual)> = messages(&bytes, &format!("/residual/{key}"));
            assert_eq!((updates.len(), residuals.len()), (4, 4));
            for (((_, update), (_, residual)), error) in updates.iter().zip(&residuals).zip(&mode.errors[0]) {
                assert_eq!([residual.x, residual.y, residual.z], <[f64; 3]>::from(*error));
                let arrow = &update.entities[0].arrows[0];
                let q = arrow.pose.expect("given").orientation.expect("given");
                let q = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z));
                let drawn = q * Vector3::x() * (arrow.shaft_length + arrow.head_length);
                assert!((drawn - RESIDUAL_SCALE * error).norm() < 1e-9 * drawn.norm());
            }
        }
    }

    #[test]
    fn points_lie_where_the_tracker_saw_them() {
        let outcome = synthetic::outcome(3, 1, true);
        let bytes = bytes_of(&outcome);
        let clouds: Vec<(u64, PointCloud)> = messages(&bytes, "/targets");
        let observer = scene::observer(&outcome.story()).expect("a mode");
        let observations = outcome.sets.iter().flat_map(|set| &set.measurements.observations);
        assert_eq!(clouds.len(), 4);
        for ((_, cloud), observation) in clouds.iter().zip(observations) {
            let seen = scene::sighting(observer, observation).expect("a station").point;
            let read = cloud.data.chunks(4).map(|b| f32::from_le_bytes(b.try_into().expect("four bytes")));
            for (read, seen) in read.zip(seen.iter()) {
                assert!((f64::from(read) - seen).abs() < 1e-6);
            }
            let identity = cloud.pose.and_then(|p| p.orientation).expect("a pose");
            assert_eq!([identity.x, identity.y, identity.z, identity.w], [0.0, 0.0, 0.0, 1.0]);
        }
        let all: Vec<(u64, PointCloud)> = messages(&bytes, "/targets/identification");
        assert_eq!(all[0].1.data.len(), 3 * 12);
    }

    #[test]
    fn provenance_comes_before_the_first_message_and_no_topics_time_runs_back() {
        let outcome = synthetic::outcome(25, 10, true);
        let bytes = bytes_of(&outcome);
        let find = |text: &[u8]| bytes.windows(text.len()).position(|w| w == text).expect("in the file");
        // zstd's magic number: the first chunk.
        let first_chunk = find(&[0x28, 0xb5, 0x2f, 0xfd]);
        assert!(find(b"provenance_sha256") < first_chunk);
        for (_, source) in &outcome.sources {
            assert!(find(source.text.as_bytes()) < first_chunk);
        }
        let mut last = BTreeMap::new();
        let mut counts = BTreeMap::new();
        for message in MessageStream::new(&bytes).expect("a file").map(|m| m.expect("sound")) {
            let last = last.entry(message.channel.topic.clone()).or_insert(0);
            assert!(message.log_time >= *last, "{}", message.channel.topic);
            *last = message.log_time;
            let count = counts.entry(message.channel.topic.clone()).or_insert(0);
            assert_eq!(message.sequence, *count);
            *count += 1;
        }
    }

    #[test]
    fn an_input_that_could_not_be_read_back_is_refused() {
        let mut outcome = synthetic::outcome(1, 0, false);
        outcome.sources[0].1.text = " ".repeat(RECORD_LIMIT);
        let mut recorder = McapRecorder::new(Cursor::new(Vec::new())).expect("begun");
        let error = record(&outcome.story(), &mut recorder).expect_err("too long");
        assert!(matches!(error, RecordingError::AttachmentTooLong { .. }));
        assert!(error.to_string().contains("scenario/synthetic.toml"), "{error}");
    }
}
