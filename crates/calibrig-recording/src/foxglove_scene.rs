//! The pictures of a run as messages of package `foxglove`, which viewers draw.

use foxglove::messages::{
    ArrowPrimitive, Color, CubePrimitive, CylinderPrimitive, FrameTransform, FrameTransforms, LinePrimitive,
    Log, PackedElementField, Point3, PointCloud, Pose, Quaternion, SceneEntity, SceneUpdate, SpherePrimitive,
    TextPrimitive, Timestamp, line_primitive, log, packed_element_field,
};
use nalgebra::{UnitQuaternion, Vector3};

use super::Story;
use super::scene::{self, Arrow, Colour};
use super::{Chain, LogEntry, LogLevel, PoseStep};
use calibrig_estimation::evaluation::closed_loop::{DrivenMode, DrivenPath};
use calibrig_model::geometry::Transform;
use calibrig_model::{Visual, VisualShape};

/// The root frame.
const WORLD: &str = "world";
/// The robot's base frame.
pub(super) const BASE: &str = "base";

/// A line for people.
pub(super) fn log_line(entry: &LogEntry) -> Log {
    let level = match entry.level {
        LogLevel::Info => log::Level::Info,
        LogLevel::Warning => log::Level::Warning,
    };
    Log {
        timestamp: Some(timestamp(entry.time)),
        level: level as i32,
        message: entry.message.clone(),
        name: "calibrig".to_owned(),
        file: String::new(),
        line: 0,
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

/// World, base and trackers, on a topic of their own: after a jump in time, a viewer gets the last message of every topic.
pub(super) fn fixed_frames(story: &Story<'_>) -> FrameTransforms {
    let world_from_base = Transform::from_parts(
        nalgebra::Translation3::identity(),
        scene::world_from_base(story).to_rotation_matrix(),
    );
    let trackers = scene::trackers(story);
    let stations =
        trackers.iter().zip(1..).map(|(place, number)| frame(0, BASE, format!("station{number}"), place));
    let transforms = std::iter::once(frame(0, WORLD, BASE.to_owned(), &world_from_base)).chain(stations);
    FrameTransforms { transforms: transforms.collect() }
}

/// Every chain from link to link, and its flange.
pub(super) fn moving_frames(step: &PoseStep<'_>) -> FrameTransforms {
    let mut transforms = Vec::new();
    for chain in &step.chains {
        let mut parent = (BASE.to_owned(), Transform::identity());
        let flange = (format!("{}/flange", chain.kind.key()), chain.flange);
        let links = chain.links.iter().enumerate().map(|(i, link)| (chain.frame(i), *link));
        for (name, base_from_frame) in links.chain([flange]) {
            let parent_from_frame = parent.1.inverse() * base_from_frame;
            transforms.push(frame(step.measured.time(), &parent.0, name.clone(), &parent_from_frame));
            parent = (name, base_from_frame);
        }
    }
    FrameTransforms { transforms }
}

fn update(entities: impl IntoIterator<Item = SceneEntity>) -> SceneUpdate {
    SceneUpdate { deletions: Vec::new(), entities: entities.into_iter().collect() }
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
pub(super) fn shapes(story: &Story<'_>) -> SceneUpdate {
    let shown = scene::chains(story, 0, 0);
    let mut entities = Vec::new();
    if let Some(chain) = shown.iter().find(|c| !c.kind.is_ghost()) {
        for (i, visuals) in story.visuals.iter().enumerate() {
            let frame = if i == 0 { BASE.to_owned() } else { chain.frame(i - 1) };
            let mut body = entity(0, &frame, format!("{frame} shape"));
            for visual in visuals {
                add_shape(&mut body, visual);
            }
            entities.push(body);
        }
    }
    let mut instruments = entity(0, BASE, "trackers");
    for (place, number) in scene::trackers(story).iter().zip(1..) {
        let place = place.translation.vector;
        instruments.spheres.push(ball(&place, 0.25, scene::TRACKER));
        instruments.texts.push(label(&place, &format!("station {number}")));
    }
    let mut nests = entity(0, BASE, "nests");
    for (name, place) in scene::nests(story.sets) {
        nests.spheres.push(ball(&place, 0.06, scene::NEST));
        nests.texts.push(label(&place, &name));
    }
    entities.extend([instruments, nests]);
    update(entities)
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
pub(super) fn moving_lines(step: &PoseStep<'_>) -> SceneUpdate {
    let time = step.measured.time();
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
        let axes =
            sighting.axes().map(|(axis, rgba)| line(&[axis.origin, axis.origin + axis.vector], 0.015, rgba));
        seen.lines.extend(axes);
    }
    update(step.chains.iter().map(chain).chain([seen]))
}

pub(super) fn arrows(time: u64, name: String, arrows: &[Arrow], rgba: Colour) -> SceneUpdate {
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
    update([shown])
}

/// The path as planned.
pub(super) fn planned_path(time: u64, path: &DrivenPath) -> SceneUpdate {
    let mut shown = entity(time, BASE, "planned path");
    shown.lines.extend(scene::planned_path(path).map(|points| line(&points, 0.01, scene::POINT)));
    update([shown])
}

/// The path as measured, with errors enlarged 100 times.
pub(super) fn driven_path(time: u64, mode: &DrivenMode) -> SceneUpdate {
    let mut shown = entity(time, BASE, format!("path with the commands of {}", mode.mode.key()));
    shown.lines.push(line(&scene::driven_path(mode), 0.008, scene::mode_colour(mode.mode)));
    update([shown])
}

/// Points in the base frame, in single precision: for display only.
pub(super) fn cloud(time: u64, points: &[Vector3<f64>]) -> PointCloud {
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
