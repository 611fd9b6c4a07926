//! A URDF with the origins of a table's rows, written through `urdf-rs`.

use std::fmt::Write;

use urdf_rs::{Geometry, Inertia, Inertial, Joint, JointLimit, JointType, Link, Mimic, Pose, Vec3};

use super::urdf;
use super::writer::{RobotText, one_line};
use crate::convert::text::roll_pitch_yaw;
use crate::input::{InputError, Source};
use calibrig_model::geometry::Transform;
use calibrig_model::{ActuatorMap, Body, CalibrationModel, CraigLink, JointKind, Visual, VisualShape};

/// Names of the links that are added behind the last joint.
const FLANGE: &str = "flange";
const TARGET: &str = "target";

/// The text of the URDF: rigid, every joint about or along the z axis of its row's frame, with links for the flange and the targets after the
/// last joint.
pub(super) fn text(robot: &RobotText<'_>) -> Result<String, InputError> {
    let (mut written, last) = match robot.urdf {
        Some(source) => urdf::with_rows(source, robot.model)?,
        None => made(robot),
    };
    follow(&mut written, robot.model);
    let flange = add_fixed(&mut written, &last, FLANGE, &robot.model.kinematics.last_from_flange);
    for target in robot.targets {
        let name =
            if robot.targets.len() == 1 { TARGET.to_owned() } else { format!("{TARGET}_{}", target.name) };
        let place = Transform::from_parts(target.in_flange.into(), target.rotation.unwrap_or_default());
        add_fixed(&mut written, &flange, &name, &place);
    }
    let plain = urdf_rs::write_to_string(&written).map_err(|error| {
        let what = Source::new("robot.urdf", "");
        what.error(0..0, error, Some("expected a robot that a URDF can hold".to_owned()))
    })?;
    let mut text = "<?xml version=\"1.0\"?>\n<!--\n".to_owned();
    for remark in robot.remarks {
        // Two hyphens would end the comment.
        let _ = writeln!(text, "  {}", one_line(remark).replace("--", "- -"));
    }
    text.push_str("-->\n");
    text.push_str(&without_empty_inertials(&plain));
    text.push('\n');
    Ok(text)
}

/// `urdf-rs` writes an inertial without mass for a link that has none; readers take it as real.
fn without_empty_inertials(text: &str) -> String {
    let Ok(document) = roxmltree::Document::parse(text) else { return text.to_owned() };
    let is_empty = |node: &roxmltree::Node<'_, '_>| {
        let mass = node.children().find(|child| child.has_tag_name("mass"));
        let value = mass.and_then(|mass| mass.attribute("value")).and_then(|value| value.parse::<f64>().ok());
        node.has_tag_name("inertial") && value == Some(0.0)
    };
    let mut kept = String::new();
    let mut from = 0;
    for range in document.descendants().filter(is_empty).map(|node| node.range()) {
        kept.push_str(text.get(from..range.start).unwrap_or_default().trim_end_matches([' ', '\n']));
        from = range.end;
    }
    kept.push_str(text.get(from..).unwrap_or_default());
    kept
}

/// A robot without a URDF of its own, and the name of its last link.
fn made(robot: &RobotText<'_>) -> (urdf_rs::Robot, String) {
    let model = robot.model;
    let shapes = |index: usize| robot.visuals.get(index).into_iter().flatten().map(visual).collect();
    let link = |name: &str, index: usize| Link {
        name: name.to_owned(),
        inertial: Inertial::default(),
        visual: shapes(index),
        collision: Vec::new(),
    };
    let mut last = "base".to_owned();
    let mut made = urdf_rs::Robot {
        name: robot.name.to_owned(),
        version: None,
        links: vec![link(&last, 0)],
        joints: Vec::new(),
        materials: Vec::new(),
    };
    for (index, row) in model.kinematics.links.iter().enumerate() {
        let name = format!("{}_link", row.name);
        let mut carried = link(&name, index + 1);
        if let Some(body) = model.statics.as_ref().and_then(|statics| statics.bodies.get(index)) {
            carried.inertial = inertial(body);
        }
        made.links.push(carried);
        made.joints.push(Joint {
            name: row.name.clone(),
            joint_type: match row.kind {
                JointKind::Revolute => JointType::Revolute,
                JointKind::Prismatic => JointType::Prismatic,
            },
            origin: pose(&origin(model, index, row)),
            parent: urdf_rs::LinkName { link: last },
            child: urdf_rs::LinkName { link: name.clone() },
            axis: urdf_rs::Axis { xyz: Vec3([0.0, 0.0, 1.0]) },
            limit: JointLimit { lower: row.limits[0], upper: row.limits[1], ..JointLimit::default() },
            calibration: None,
            dynamics: None,
            mimic: None,
            safety_controller: None,
        });
        last = name;
    }
    (made, last)
}

/// From the frame of the joint before to that of a joint at its variable zero.
pub(super) fn origin(model: &CalibrationModel, index: usize, row: &CraigLink) -> Transform {
    if index == 0 { model.kinematics.base_from_first * row.fixed_part() } else { row.fixed_part() }
}

/// Joints that follow others say so.
fn follow(robot: &mut urdf_rs::Robot, model: &CalibrationModel) {
    let ActuatorMap::Axes { axes, .. } = &model.actuators else { return };
    let links = &model.kinematics.links;
    for (axis, own) in links.iter().enumerate().take(axes.axes()) {
        if model.actuators.is_commanded(axis) {
            continue;
        }
        let row = axes.shown_by_actuators().row(axis);
        let mut others = row.iter().zip(links).enumerate();
        let Some((at, (share, leader))) = others.find(|(other, (share, _))| *other != axis && **share != 0.0)
        else {
            continue;
        };
        // What follows the elbow's motor of a parallelogram has two leaders, shoulder and elbow, but a <mimic> names only
        // one.
        if model.actuators.elbow().is_some_and(|drive| drive.elbow == at) {
            continue;
        }
        if let Some(joint) = robot.joints.iter_mut().find(|joint| joint.name == own.name) {
            joint.mimic = Some(Mimic {
                joint: leader.name.clone(),
                multiplier: Some(0.0 - share),
                offset: Some(0.0 - axes.zero()[axis]),
            });
        }
    }
}

/// Adds a link that is fixed to another one; returns its name, changed if it is taken.
fn add_fixed(robot: &mut urdf_rs::Robot, parent: &str, name: &str, place: &Transform) -> String {
    let is_taken = |robot: &urdf_rs::Robot, name: &str| {
        robot.links.iter().any(|link| link.name == name)
            || robot.joints.iter().any(|joint| joint.name == format!("{name}_fixed"))
    };
    let mut free = name.to_owned();
    while is_taken(robot, &free) {
        free = format!("calibrated_{free}");
    }
    robot.links.push(Link {
        name: free.clone(),
        inertial: Inertial::default(),
        visual: Vec::new(),
        collision: Vec::new(),
    });
    robot.joints.push(Joint {
        name: format!("{free}_fixed"),
        joint_type: JointType::Fixed,
        origin: pose(place),
        parent: urdf_rs::LinkName { link: parent.to_owned() },
        child: urdf_rs::LinkName { link: free.clone() },
        axis: urdf_rs::Axis::default(),
        limit: JointLimit::default(),
        calibration: None,
        dynamics: None,
        mimic: None,
        safety_controller: None,
    });
    free
}

pub(super) fn pose(frame: &Transform) -> Pose {
    let place = frame.translation.vector;
    // No minus in front of a zero.
    let plain = |values: [f64; 3]| Vec3(values.map(|value| value + 0.0));
    Pose { xyz: plain([place.x, place.y, place.z]), rpy: plain(roll_pitch_yaw(&frame.rotation)) }
}

pub(super) fn inertial(body: &Body) -> Inertial {
    let centre = body.centre_of_mass;
    let i = &body.inertia;
    Inertial {
        origin: Pose { xyz: Vec3([centre.x, centre.y, centre.z]), rpy: Vec3::default() },
        mass: urdf_rs::Mass { value: body.mass },
        inertia: Inertia { ixx: i.m11, ixy: i.m12, ixz: i.m13, iyy: i.m22, iyz: i.m23, izz: i.m33 },
    }
}

fn visual(visual: &Visual) -> urdf_rs::Visual {
    urdf_rs::Visual {
        name: None,
        origin: pose(&visual.link_from_shape),
        geometry: match visual.shape {
            VisualShape::Box(size) => Geometry::Box { size: Vec3(size) },
            VisualShape::Cylinder { radius, length } => Geometry::Cylinder { radius, length },
            VisualShape::Sphere(radius) => Geometry::Sphere { radius },
        },
        material: None,
    }
}
