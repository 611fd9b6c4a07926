//! The record of truth: MCAP with the public `foxglove.*` messages for viewers and the `calibrig.v1` messages for replay.

use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::path::Path;

use foxglove::messages::{
    ArrowPrimitive, Color, CubePrimitive, CylinderPrimitive, FrameTransform, FrameTransforms, LinePrimitive,
    Log, PackedElementField, Point3, PointCloud, Pose, Quaternion, SceneEntity, SceneUpdate, SpherePrimitive,
    TextPrimitive, Timestamp, line_primitive, log, packed_element_field,
};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use nalgebra::{UnitQuaternion, Vector3};
use prost::{Message, Name};

use super::file::write_whole;
use super::provenance::{METADATA, attached_inputs, metadata_of};
use super::scene::{self, Arrow, Colour};
use super::schema::{self, v1};
use super::{Chain, LogEntry, LogLevel, PoseStep, Provenance, Recorder, RecordingError, record, truth};
use crate::geometry::Transform;
use crate::identification::Estimate;
use crate::model::{Visual, VisualShape};
use crate::pipeline::{ModeOutcome, Outcome, SetOutcome};

/// The longest record that is read back, bytes.
pub(super) const RECORD_LIMIT: usize = 64 << 20;
/// Poses after which the data are put out: an abort loses the open chunk.
const POSES_A_BATCH: u32 = 10;
/// The root frame.
const WORLD: &str = "world";
/// The robot's base frame.
const BASE: &str = "base";

/// Writes an MCAP recording of `outcome`. The file is whole or not there.
///
/// # Errors
/// The file cannot be written, or an input file is longer than 64 MiB.
pub fn write_mcap(outcome: &Outcome, path: &Path) -> Result<(), RecordingError> {
    write_whole(path, |file| {
        let mut recorder = McapRecorder::new(file)?;
        record(outcome, &mut recorder)?;
        recorder.finish()
    })
}

/// Writes MCAP to any seekable sink.
pub struct McapRecorder<W: Write + Seek> {
    writer: Writer<W>,
    /// Channel number and messages so far, by topic.
    channels: BTreeMap<String, (u16, u32)>,
}

impl<W: Write + Seek> McapRecorder<W> {
    /// Begins a file.
    pub fn new(sink: W) -> Result<Self, RecordingError> {
        // Message indexes cost a third of a small file, but Foxglove's reader refuses chunks without them. The library's name and the
        // number of threads are pinned: the same story gives the same bytes.
        let options = WriteOptions::new().library(Provenance::software()).compression_threads(0);
        let writer = options.create(sink).map_err(RecordingError::unrecordable)?;
        Ok(Self { writer, channels: BTreeMap::new() })
    }

    /// Ends the file.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.writer.finish().map_err(RecordingError::unrecordable)?;
        self.writer.into_inner().flush().map_err(RecordingError::unrecordable)
    }

    fn publish(
        &mut self,
        topic: &str,
        time: u64,
        schema: (&str, &[u8]),
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let (channel_id, sequence) = match self.channels.get(topic) {
            Some(known) => *known,
            None => (self.add_channel(topic, schema).map_err(RecordingError::unrecordable)?, 0),
        };
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, data).map_err(RecordingError::unrecordable)?;
        self.channels.insert(topic.to_owned(), (channel_id, sequence.wrapping_add(1)));
        Ok(())
    }

    fn add_channel(&mut self, topic: &str, (name, descriptors): (&str, &[u8])) -> mcap::McapResult<u16> {
        let schema = self.writer.add_schema(name, "protobuf", descriptors)?;
        self.writer.add_channel(schema, topic, "protobuf", &BTreeMap::new())
    }

    /// Publishes a message of package `calibrig.v1`.
    fn own<M: Message + Name>(&mut self, topic: &str, time: u64, message: &M) -> Result<(), RecordingError> {
        self.publish(topic, time, (&M::full_name(), schema::DESCRIPTORS), &message.encode_to_vec())
    }

    /// Publishes a message of package `foxglove`.
    fn foxglove<M: Message + foxglove::Encode>(
        &mut self,
        topic: &str,
        time: u64,
        message: &M,
    ) -> Result<(), RecordingError> {
        let schema = M::get_schema()
            .ok_or_else(|| RecordingError::unrecordable(format!("no schema for the messages on {topic}")))?;
        self.publish(topic, time, (&schema.name, &schema.data), &message.encode_to_vec())
    }

    fn provenance(&mut self, outcome: &Outcome) -> Result<(), RecordingError> {
        let inputs = attached_inputs(outcome);
        let metadata = Metadata { name: METADATA.to_owned(), metadata: metadata_of(outcome, &inputs) };
        self.writer.write_metadata(&metadata).map_err(RecordingError::unrecordable)?;
        for (name, text) in inputs {
            // The header of the record is far below a kilobyte.
            let limit = RECORD_LIMIT - 1024;
            if text.len() > limit {
                return Err(RecordingError::AttachmentTooLong { name, bytes: text.len(), limit });
            }
            let media_type = media_type(&name).to_owned();
            let attachment =
                Attachment { log_time: 0, create_time: 0, name, media_type, data: text.into_bytes().into() };
            self.writer.attach(&attachment).map_err(RecordingError::unrecordable)?;
        }
        Ok(())
    }

    fn measured(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let kind = step.set.kind;
        let (set, first) = (kind.key(), step.first);
        for (i, (observation, &time)) in step.observations.iter().zip(step.times).enumerate() {
            let index = first + i;
            self.own("/measurement", time, &schema::observation(kind, index, observation))?;
            for residuals in &step.residuals {
                let Some(error) = residuals.errors.get(i) else { continue };
                let key = residuals.mode.key();
                let message = v1::Residual {
                    set: set.to_owned(),
                    index: schema::saturating(index),
                    pose: observation.pose,
                    mode: key.to_owned(),
                    x: error.x,
                    y: error.y,
                    z: error.z,
                    norm: error.norm(),
                };
                self.own(&format!("/residual/{key}"), time, &message)?;
            }
            if let Some(message) = truth::settled_pose(step, i) {
                self.own("/truth/pose", time, &message)?;
            }
            if let Some(message) = truth::pose_effects(step, i) {
                self.own("/truth/effects", time, &message)?;
            }
        }
        Ok(())
    }
}

impl<W: Write + Seek> Recorder for McapRecorder<W> {
    fn begin(&mut self, outcome: &Outcome) -> Result<(), RecordingError> {
        self.provenance(outcome)?;
        for set in &outcome.sets {
            self.own("/session", 0, &v1::Session::from(set))?;
        }
        if let Some(known) = &outcome.truth {
            self.own("/truth/as_built", 0, &truth::as_built(outcome, known))?;
        }
        self.foxglove("/tf_static", 0, &fixed_frames(outcome))?;
        self.foxglove("/scene/robot", 0, &shapes(outcome))?;
        for set in &outcome.sets {
            let points = scene::measured_points(outcome, &set.measurements);
            self.foxglove(&format!("/targets/{}", set.kind.key()), 0, &cloud(0, &points))?;
        }
        self.writer.flush().map_err(RecordingError::unrecordable)
    }

    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        let time = step.time();
        self.foxglove("/tf", time, &moving_frames(step))?;
        self.foxglove("/scene", time, &moving_lines(step))?;
        let points: Vec<_> = step.sightings.iter().map(|s| s.point).collect();
        self.foxglove("/targets", time, &cloud(time, &points))?;
        for residuals in &step.residuals {
            let name = format!("pose {}", step.number);
            let update = arrows(time, name, &residuals.arrows, scene::mode_colour(residuals.mode));
            self.foxglove(&format!("/scene/residual_x100/{}", residuals.mode.key()), time, &update)?;
        }
        self.measured(step)?;
        if step.number % POSES_A_BATCH == POSES_A_BATCH - 1 {
            self.writer.flush().map_err(RecordingError::unrecordable)?;
        }
        Ok(())
    }

    fn estimate(&mut self, time: u64, outcome: &Outcome, mode: &ModeOutcome) -> Result<(), RecordingError> {
        self.own(&format!("/estimate/{}", mode.mode.key()), time, &estimate(&outcome.sets, mode))
    }

    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
        let level = match entry.level {
            LogLevel::Info => log::Level::Info,
            LogLevel::Warning => log::Level::Warning,
        };
        let message = Log {
            timestamp: Some(timestamp(entry.time)),
            level: level as i32,
            message: entry.message.clone(),
            name: "calibrig".to_owned(),
            file: String::new(),
            line: 0,
        };
        self.foxglove("/log", entry.time, &message)
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

fn estimate(sets: &[SetOutcome], mode: &ModeOutcome) -> v1::Estimate {
    let accuracy = sets.iter().zip(&mode.rows).filter_map(|(set, row)| {
        let row = row.as_ref()?;
        Some(v1::Accuracy {
            set: set.kind.key().to_owned(),
            max: schema::vector(&row.max),
            mean: schema::vector(&row.mean),
            bias: schema::vector(&row.bias),
            rms_3d: row.rms_3d,
            max_3d: row.max_3d,
            count: row.count as u64,
        })
    });
    let robot = v1::Estimate {
        mode: mode.mode.key().to_owned(),
        stations: mode.robot.stations.iter().map(schema::pose).collect(),
        targets: mode.robot.targets.iter().map(|t| v1::Point { position: schema::vector(t) }).collect(),
        accuracy: accuracy.collect(),
        ..v1::Estimate::default()
    };
    match &mode.estimate {
        Some(estimate) => with_identification(robot, estimate),
        None => robot,
    }
}

fn with_identification(robot: v1::Estimate, estimate: &Estimate) -> v1::Estimate {
    use crate::identification::NoiseScale;

    let parameter = |p: &crate::identification::ParameterEstimate| v1::Parameter {
        name: p.id.to_string(),
        unit: p.id.unit().to_string(),
        value: Some(p.value),
        sigma: p.sigma,
        prior_sigma: p.prior_sigma,
    };
    let iteration = |i: &crate::identification::IterationRecord| v1::Iteration {
        cost: i.cost,
        damping: i.damping,
        step: i.step,
        gain: i.gain,
        accepted: i.accepted,
    };
    v1::Estimate {
        parameters: estimate.parameters.iter().map(parameter).collect(),
        covariance: estimate
            .covariance
            .as_ref()
            .map(|c| c.transpose().iter().copied().collect())
            .unwrap_or_default(),
        chi2: Some(estimate.chi2),
        degrees_of_freedom: Some(estimate.degrees_of_freedom as u64),
        termination: estimate.termination.key().to_owned(),
        iterations: estimate.iterations.iter().map(iteration).collect(),
        rank: Some(estimate.spectrum.rank as u64),
        condition: Some(estimate.spectrum.condition),
        warnings: estimate.warnings.iter().map(ToString::to_string).collect(),
        held: estimate.held.iter().map(ToString::to_string).collect(),
        fixed: estimate.fixed.iter().map(ToString::to_string).collect(),
        noise_from_residuals: match estimate.noise {
            NoiseScale::Stated => None,
            NoiseScale::Residuals(sigma) => Some(sigma),
        },
        ..robot
    }
}

fn timestamp(nanoseconds: u64) -> Timestamp {
    let seconds = u32::try_from(nanoseconds / 1_000_000_000).unwrap_or(u32::MAX);
    // Below 10^9.
    #[allow(clippy::cast_possible_truncation)]
    let rest = (nanoseconds % 1_000_000_000) as u32;
    Timestamp::new(seconds, rest)
}

fn xyz(v: &Vector3<f64>) -> foxglove::messages::Vector3 {
    foxglove::messages::Vector3 { x: v.x, y: v.y, z: v.z }
}

fn point(v: &Vector3<f64>) -> Point3 {
    Point3 { x: v.x, y: v.y, z: v.z }
}

fn quaternion(q: &UnitQuaternion<f64>) -> Quaternion {
    Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }
}

fn colour([r, g, b, a]: Colour) -> Color {
    let part = |byte: u8| f64::from(byte) / 255.0;
    Color { r: part(r), g: part(g), b: part(b), a: part(a) }
}

fn pose(position: &Vector3<f64>, orientation: &UnitQuaternion<f64>) -> Pose {
    Pose { position: Some(xyz(position)), orientation: Some(quaternion(orientation)) }
}

fn orientation(transform: &Transform) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&transform.rotation)
}

fn frame(time: u64, parent: &str, child: String, parent_from_child: &Transform) -> FrameTransform {
    FrameTransform {
        timestamp: Some(timestamp(time)),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child,
        translation: Some(xyz(&parent_from_child.translation.vector)),
        rotation: Some(quaternion(&orientation(parent_from_child))),
    }
}

/// World, base and trackers, on a topic of their own: after a jump in time viewers are given the last message of every topic.
fn fixed_frames(outcome: &Outcome) -> FrameTransforms {
    let world_from_base = Transform::from_parts(
        nalgebra::Translation3::identity(),
        scene::world_from_base(outcome).to_rotation_matrix(),
    );
    let trackers = scene::trackers(outcome);
    let stations =
        trackers.iter().zip(1..).map(|(place, number)| frame(0, BASE, format!("station{number}"), place));
    let transforms = std::iter::once(frame(0, WORLD, BASE.to_owned(), &world_from_base)).chain(stations);
    FrameTransforms { transforms: transforms.collect() }
}

/// Every chain from link to link, and its flange.
fn moving_frames(step: &PoseStep<'_>) -> FrameTransforms {
    let mut transforms = Vec::new();
    for chain in &step.chains {
        let mut parent = (BASE.to_owned(), Transform::identity());
        let flange = (format!("{}/flange", chain.kind.key()), chain.flange);
        let links = chain.links.iter().enumerate().map(|(i, link)| (chain.frame(i), *link));
        for (name, base_from_frame) in links.chain([flange]) {
            let parent_from_frame = parent.1.inverse() * base_from_frame;
            transforms.push(frame(step.time(), &parent.0, name.clone(), &parent_from_frame));
            parent = (name, base_from_frame);
        }
    }
    FrameTransforms { transforms }
}

fn entity(time: u64, frame: &str, id: impl Into<String>) -> SceneEntity {
    SceneEntity {
        timestamp: Some(timestamp(time)),
        frame_id: frame.to_owned(),
        id: id.into(),
        frame_locked: true,
        ..SceneEntity::default()
    }
}

fn line(points: &[Vector3<f64>], thickness: f64, rgba: Colour) -> LinePrimitive {
    LinePrimitive {
        r#type: line_primitive::Type::LineStrip as i32,
        pose: Some(pose(&Vector3::zeros(), &UnitQuaternion::identity())),
        thickness,
        points: points.iter().map(point).collect(),
        color: Some(colour(rgba)),
        ..LinePrimitive::default()
    }
}

fn ball(centre: &Vector3<f64>, diameter: f64, rgba: Colour) -> SpherePrimitive {
    SpherePrimitive {
        pose: Some(pose(centre, &UnitQuaternion::identity())),
        size: Some(xyz(&Vector3::repeat(diameter))),
        color: Some(colour(rgba)),
    }
}

fn label(place: &Vector3<f64>, text: &str) -> TextPrimitive {
    TextPrimitive {
        pose: Some(pose(place, &UnitQuaternion::identity())),
        billboard: true,
        font_size: 0.15,
        color: Some(colour(scene::POINT)),
        text: text.to_owned(),
        ..TextPrimitive::default()
    }
}

/// The links' shapes, each in its moving frame, the trackers and the nests: sent once.
fn shapes(outcome: &Outcome) -> SceneUpdate {
    let shown = scene::chains(outcome, 0, 0);
    let mut entities = Vec::new();
    if let Some(chain) = shown.iter().find(|c| !c.kind.is_ghost()) {
        for (i, visuals) in outcome.visuals.iter().enumerate() {
            let frame = if i == 0 { BASE.to_owned() } else { chain.frame(i - 1) };
            let mut body = entity(0, &frame, format!("{frame} shape"));
            for visual in visuals {
                add_shape(&mut body, visual);
            }
            entities.push(body);
        }
    }
    let mut instruments = entity(0, BASE, "trackers");
    for (place, number) in scene::trackers(outcome).iter().zip(1..) {
        let place = place.translation.vector;
        instruments.spheres.push(ball(&place, 0.25, scene::TRACKER));
        instruments.texts.push(label(&place, &format!("station {number}")));
    }
    let mut nests = entity(0, BASE, "nests");
    for (name, place) in scene::nests(outcome) {
        nests.spheres.push(ball(&place, 0.06, scene::NEST));
        nests.texts.push(label(&place, &name));
    }
    entities.extend([instruments, nests]);
    SceneUpdate { deletions: Vec::new(), entities }
}

fn add_shape(body: &mut SceneEntity, visual: &Visual) {
    let place = Some(pose(&visual.link_from_shape.translation.vector, &orientation(&visual.link_from_shape)));
    let color = Some(colour(scene::SHELL));
    match visual.shape {
        VisualShape::Box(edges) => {
            body.cubes.push(CubePrimitive { pose: place, size: Some(xyz(&edges.into())), color });
        }
        VisualShape::Cylinder { radius, length } => body.cylinders.push(CylinderPrimitive {
            pose: place,
            size: Some(xyz(&Vector3::new(2.0 * radius, 2.0 * radius, length))),
            bottom_scale: 1.0,
            top_scale: 1.0,
            color,
        }),
        VisualShape::Sphere(radius) => {
            let size = Some(xyz(&Vector3::repeat(2.0 * radius)));
            body.spheres.push(SpherePrimitive { pose: place, size, color });
        }
    }
}

/// The chains as lines, the targets, and the tracker's lines of sight.
fn moving_lines(step: &PoseStep<'_>) -> SceneUpdate {
    let time = step.time();
    let chain = |chain: &Chain| {
        let rgba = chain.kind.colour();
        let mut shown = entity(time, BASE, format!("{} chain", chain.kind.key()));
        shown.lines.push(line(&chain.polyline(), 0.04, rgba));
        shown.lines.extend(chain.linkage.map(|linkage| line(&linkage, 2.0 * scene::ROD_RADIUS, rgba)));
        shown.texts.extend(chain.kind.label().map(|text| label(&chain.target, text)));
        shown
    };
    let mut seen = entity(time, BASE, "line of sight");
    for sighting in &step.sightings {
        seen.lines.push(line(&[sighting.tracker, sighting.point], 0.01, scene::BEAM));
        seen.spheres.push(ball(&sighting.point, 0.08, scene::POINT));
    }
    SceneUpdate { deletions: Vec::new(), entities: step.chains.iter().map(chain).chain([seen]).collect() }
}

fn arrows(time: u64, name: String, arrows: &[Arrow], rgba: Colour) -> SceneUpdate {
    let primitive = |arrow: &Arrow| {
        let length = arrow.vector.norm();
        // A primitive points along x.
        let orientation = scene::turn(&arrow.vector, &Vector3::x());
        ArrowPrimitive {
            pose: Some(pose(&arrow.origin, &orientation)),
            shaft_length: 0.75 * length,
            shaft_diameter: 0.02,
            head_length: 0.25 * length,
            head_diameter: 0.05,
            color: Some(colour(rgba)),
        }
    };
    let mut shown = entity(time, BASE, name);
    shown.arrows = arrows.iter().filter(|a| a.vector.norm() > 0.0).map(primitive).collect();
    SceneUpdate { deletions: Vec::new(), entities: vec![shown] }
}

/// Points in the base frame, in single precision: for the eye only.
fn cloud(time: u64, points: &[Vector3<f64>]) -> PointCloud {
    let field = |name: &str, offset: u32| PackedElementField {
        name: name.to_owned(),
        offset,
        r#type: packed_element_field::NumericType::Float32 as i32,
    };
    // Metres in single precision: 0.2 µm at 4 m.
    #[allow(clippy::cast_possible_truncation)]
    let bytes = |coordinate: &f64| (*coordinate as f32).to_le_bytes();
    let data: Vec<u8> = points.iter().flat_map(|p| p.iter().flat_map(bytes).collect::<Vec<u8>>()).collect();
    PointCloud {
        timestamp: Some(timestamp(time)),
        frame_id: BASE.to_owned(),
        pose: Some(pose(&Vector3::zeros(), &UnitQuaternion::identity())),
        point_stride: 12,
        fields: vec![field("x", 0), field("y", 4), field("z", 8)],
        data: data.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    use mcap::MessageStream;
    use nalgebra::Translation3;

    use crate::recording::{RESIDUAL_SCALE, synthetic};

    fn bytes_of(outcome: &Outcome) -> Vec<u8> {
        let mut file = Cursor::new(Vec::new());
        let mut recorder = McapRecorder::new(&mut file).expect("begun");
        record(outcome, &mut recorder).expect("recorded");
        recorder.finish().expect("finished");
        file.into_inner()
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
        let known = outcome.truth.as_ref().expect("simulated");
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
        let observer = scene::observer(&outcome).expect("a mode");
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
    fn provenance_comes_before_the_first_message_and_time_never_runs_back() {
        let outcome = synthetic::outcome(25, 10, true);
        let bytes = bytes_of(&outcome);
        let find = |text: &[u8]| bytes.windows(text.len()).position(|w| w == text).expect("in the file");
        // zstd's magic number: the first chunk.
        let first_chunk = find(&[0x28, 0xb5, 0x2f, 0xfd]);
        assert!(find(b"provenance_sha256") < first_chunk);
        for (_, source) in &outcome.sources {
            assert!(find(source.text.as_bytes()) < first_chunk);
        }
        let mut last = 0;
        let mut counts = BTreeMap::new();
        for message in MessageStream::new(&bytes).expect("a file").map(|m| m.expect("sound")) {
            assert!(message.log_time >= last, "{}", message.channel.topic);
            last = message.log_time;
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
        let error = record(&outcome, &mut recorder).expect_err("too long");
        assert!(matches!(error, RecordingError::AttachmentTooLong { .. }));
        assert!(error.to_string().contains("scenario/synthetic.toml"), "{error}");
    }
}
