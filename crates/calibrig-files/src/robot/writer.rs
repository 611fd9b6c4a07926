//! The text of a `robot.toml`, and of the URDF that it names, of any robot that such files can hold.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use nalgebra::{Rotation3, Vector3};

use super::{Robot, parse_robot, urdf_writer};
use crate::convert::text::{line, roll_pitch_yaw};
use crate::input::{InputError, Source, quoted};
use calibrig_model::geometry::Transform;
use calibrig_model::{
    ActuatorMap, AxisMap, Beam, BeamRun, Bearing, BearingSide, CalibrationModel, CraigLink, FourBar,
    JointKind, LinkageStatics, SegmentLength, StaticProperties, Visual,
};

/// A robot that is to be written.
#[derive(Debug, Clone, Copy)]
pub struct RobotText<'a> {
    /// Name for people.
    pub name: &'a str,
    /// The robot.
    pub model: &'a CalibrationModel,
    /// What its flange carries.
    pub targets: &'a [TargetText<'a>],
    /// Shapes to draw, as [`Robot::visuals`]; ignored if a URDF is given.
    pub visuals: &'a [Vec<Visual>],
    /// The URDF that [`Robot`] was read with: its links, shapes, inertias and limits are kept, its joints' origins become those of the model.
    pub urdf: Option<&'a Source>,
    /// Remarks at the head of both files, one line each.
    pub remarks: &'a [String],
}

/// A target that is to be written.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetText<'a> {
    /// Its name; may be empty if there is only one.
    pub name: &'a str,
    /// Offset in the flange's frame, m.
    pub in_flange: Vector3<f64>,
    /// `flange_from_target`, of a target with axes.
    pub rotation: Option<Rotation3<f64>>,
}

/// The texts of a robot.
#[derive(Debug, Clone)]
pub struct RobotFiles {
    /// `robot.toml`.
    pub robot: Source,
    /// `robot.urdf`, which it names.
    pub urdf: Source,
    /// The robot read from both.
    pub read: Robot,
}

/// Writes `robot.toml` and `robot.urdf`; they read back to the same robot, to the rounding of its numbers.
///
/// The smooth terms' [spans](CalibrationModel::spans) have no key, nor do uncertainties: neither is written.
///
/// # Errors
///
/// [`InputError`] if such files cannot hold the robot, such as one without limits: the reader's error for the text.
pub fn write_robot(robot: &RobotText<'_>) -> Result<RobotFiles, InputError> {
    let urdf = Source::new("robot.urdf", urdf_writer::text(robot)?);
    let text = Source::new("robot.toml", text(robot));
    let read = parse_robot(text.clone(), Some(urdf.clone()), None)?;
    Ok(RobotFiles { robot: text, urdf, read })
}

/// A comment stays one line.
pub(super) fn one_line(text: &str) -> String {
    let plain: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    plain.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn text(robot: &RobotText<'_>) -> String {
    let model = robot.model;
    let chain = &model.kinematics;
    let mut text = String::new();
    for remark in robot.remarks {
        line!(text, "# {}", one_line(remark));
    }
    line!(text);
    line!(text, "schema = \"calibrig.robot/1\"");
    line!(text, "name = {}", quoted(robot.name));
    line!(text, "convention = \"craig\"");
    line!(text, "urdf = \"robot.urdf\"");
    frame(&mut text, "base", &chain.base_from_first);
    for (index, link) in chain.links.iter().enumerate() {
        joint(&mut text, model, index, link);
    }
    frame(&mut text, "flange", &chain.last_from_flange);
    actuators(&mut text, model);
    targets(&mut text, robot.targets);
    if let Some(statics) = &model.statics {
        loads(&mut text, statics, &chain.links);
        line!(text);
        line!(text, "[gravity]");
        let gravity = &statics.gravity;
        line!(
            text,
            "x_m_per_s2 = {:?}\ny_m_per_s2 = {:?}\nz_m_per_s2 = {:?}",
            gravity.x,
            gravity.y,
            gravity.z
        );
    }
    text
}

/// The shortest decimal that `read` converts back to the value, beginning with the digits of `shown`.
fn number(value: f64, shown: f64, read: impl Fn(f64) -> f64) -> String {
    for digits in 0..=12 {
        let scale = 10_f64.powi(digits);
        let round = (shown * scale).round() / scale;
        if read(round).to_bits() == value.to_bits() {
            return format!("{round:?}");
        }
    }
    format!("{shown:?}")
}

fn mm(value: f64) -> String {
    number(value, 1e3 * value, |mm| mm / 1e3)
}

fn deg(value: f64) -> String {
    number(value, value.to_degrees(), f64::to_radians)
}

fn frame(text: &mut String, key: &str, frame: &Transform) {
    if *frame == Transform::identity() {
        return;
    }
    let place = frame.translation.vector.map(|v| v + 0.0);
    let [roll, pitch, yaw] = roll_pitch_yaw(&frame.rotation);
    line!(text);
    line!(text, "[{key}]");
    line!(text, "x_mm = {}\ny_mm = {}\nz_mm = {}", mm(place.x), mm(place.y), mm(place.z));
    line!(text, "roll_deg = {}\npitch_deg = {}\nyaw_deg = {}", deg(roll), deg(pitch), deg(yaw));
}

fn joint(text: &mut String, model: &CalibrationModel, index: usize, link: &CraigLink) {
    let (kind, unit, per_turn) = match link.kind {
        JointKind::Revolute => ("revolute", "deg", "motor_turns_per_rev"),
        JointKind::Prismatic => ("prismatic", "mm", "motor_turns_per_m"),
    };
    line!(text);
    line!(text, "[[joint]]");
    line!(text, "name = {}\ntype = \"{kind}\"", quoted(&link.name));
    line!(text, "a_mm = {}\nalpha_deg = {}", mm(link.a), deg(link.alpha));
    if link.beta != 0.0 {
        line!(text, "beta_deg = {}", deg(link.beta));
    }
    line!(text, "d_mm = {}\ntheta_deg = {}", mm(link.d), deg(link.theta));
    let [low, high] = link.limits.map(|limit| in_unit(limit, link.kind));
    line!(text, "min_{unit} = {low}\nmax_{unit} = {high}");
    if let Some(stiffness) = model.statics.as_ref().and_then(|statics| statics.drive_stiffness.get(index)) {
        let key = match link.kind {
            JointKind::Revolute => "stiffness_nm_per_rad",
            JointKind::Prismatic => "stiffness_n_per_m",
        };
        line!(text, "{key} = {}", rigid_or(*stiffness));
    }
    if let Some(turns) = model.motor_turns.get(index).copied().flatten() {
        let turns = match link.kind {
            JointKind::Revolute => number(turns, turns * TAU, |turns| turns / TAU),
            JointKind::Prismatic => format!("{turns:?}"),
        };
        line!(text, "{per_turn} = {turns}");
    }
    if let Some(statics) = &model.statics {
        bearing(text, statics.bearings.get(index), link.kind);
        beam(text, statics.beams.get(index).and_then(Option::as_ref));
    }
    if let ActuatorMap::Axes { axes, .. } = &model.actuators {
        shown(text, axes, &model.actuators, &model.kinematics.links, index);
    }
}

fn in_unit(value: f64, kind: JointKind) -> String {
    match kind {
        JointKind::Revolute => deg(value),
        JointKind::Prismatic => mm(value),
    }
}

/// Stiffer than any number that a file can hold: no measurable deflection.
const STIFFEST: f64 = 1e15;

fn rigid_or(stiffness: f64) -> String {
    if stiffness > STIFFEST { "inf".to_owned() } else { format!("{stiffness:?}") }
}

fn bearing(text: &mut String, bearing: Option<&Bearing>, kind: JointKind) {
    const KEYS: [&str; 6] =
        ["x_n_per_m", "y_n_per_m", "z_n_per_m", "rx_nm_per_rad", "ry_nm_per_rad", "rz_nm_per_rad"];
    let Some(bearing) = bearing else { return };
    let own = if kind == JointKind::Prismatic { 2 } else { 5 };
    let yields = |(axis, stiffness): &(usize, &f64)| *axis != own && **stiffness <= STIFFEST;
    let springs: Vec<_> = bearing.stiffness.iter().enumerate().filter(yields).collect();
    if springs.is_empty() {
        return;
    }
    line!(text, "[joint.bearing]");
    if bearing.side == BearingSide::Fixed {
        line!(text, "side = \"fixed\"");
    }
    if bearing.at != 0.0 {
        line!(text, "at_mm = {}", mm(bearing.at));
    }
    for (axis, stiffness) in springs {
        line!(text, "stiffness_{} = {stiffness:?}", KEYS[axis]);
    }
}

fn beam(text: &mut String, beam: Option<&Beam>) {
    // The weight of a beam is part of its link's.
    let Some(beam) = beam.filter(|beam| beam.segments.iter().any(|s| !s.section.is_rigid())) else { return };
    let run = match beam.run {
        BeamRun::AlongX => "along_x",
        BeamRun::EndsAtOrigin => "ends_at_origin",
    };
    line!(text, "[joint.beam]\nrun = \"{run}\"");
    for segment in &beam.segments {
        line!(text, "[[joint.beam.segment]]");
        match segment.length {
            SegmentLength::Constant(length) => line!(text, "length_mm = {}", mm(length)),
            SegmentLength::Extension(housed) => line!(text, "housed_mm = {}", mm(housed)),
        }
        let section = &segment.section;
        for (key, value) in [
            ("axial_n", section.axial),
            ("shear_2_n", section.shear[0]),
            ("shear_3_n", section.shear[1]),
            ("torsion_nm2", section.torsion),
            ("bending_2_nm2", section.bending[0]),
            ("bending_3_nm2", section.bending[1]),
        ] {
            line!(text, "{key} = {:?}", value.min(STIFFEST));
        }
        line!(text, "mass_per_length_kg_per_m = {:?}", section.mass_per_length);
    }
}

/// Size of a joint's unit in the file: deg or mm.
fn unit(link: &CraigLink) -> f64 {
    match link.kind {
        JointKind::Revolute => 1_f64.to_radians(),
        JointKind::Prismatic => 1e-3,
    }
}

fn shown(text: &mut String, axes: &AxisMap, map: &ActuatorMap, links: &[CraigLink], axis: usize) {
    let Some(own) = links.get(axis).filter(|_| axis < axes.axes()) else { return };
    let (row, zero) = (axes.shown_by_actuators().row(axis), axes.zero()[axis]);
    let others = || {
        let others = row.iter().zip(links).enumerate();
        others.filter(|(other, (share, _))| *other != axis && **share != 0.0)
    };
    let offset_key = if own.kind == JointKind::Revolute { "offset_deg" } else { "offset_mm" };
    if !map.is_commanded(axis) {
        // q + zero = ratio times that of the leader.
        let Some((_, (share, leader))) = others().next() else { return };
        line!(text, "[joint.follows]\njoint = {}", quoted(&leader.name));
        line!(text, "ratio = {:?}", 0.0 - share * unit(leader) / unit(own));
        line!(text, "{offset_key} = {}", in_unit(0.0 - zero, own.kind));
        return;
    }
    let factor = row.get(axis).copied().unwrap_or(1.0);
    let is_plain = factor == 1.0 && zero == 0.0 && others().next().is_none();
    if is_plain {
        return;
    }
    line!(text, "[joint.shown]\nsign = {}", if factor < 0.0 { -1 } else { 1 });
    if factor.abs() != 1.0 {
        line!(text, "ratio = {:?}", factor.abs());
    }
    if zero != 0.0 {
        line!(text, "{offset_key} = {}", in_unit(zero, own.kind));
    }
    let coupled = |(_, (share, other)): (usize, (&f64, &CraigLink))| {
        format!("{} = {:?}", quoted(&other.name), share / factor * unit(other) / unit(own))
    };
    let coupling: Vec<String> = others().map(coupled).collect();
    if !coupling.is_empty() {
        line!(text, "coupling = {{ {} }}", coupling.join(", "));
    }
}

fn actuators(text: &mut String, model: &CalibrationModel) {
    line!(text);
    line!(text, "[actuators]");
    let Some(drive) = model.actuators.elbow() else {
        line!(text, "kind = \"direct\"");
        return;
    };
    let name = |joint: usize| model.kinematics.links.get(joint).map_or_else(String::new, |l| quoted(&l.name));
    line!(
        text,
        "kind = \"parallelogram\"\nshoulder = {}\nelbow = {}",
        name(drive.shoulder),
        name(drive.elbow)
    );
    line!(text, "offset_deg = {}", deg(drive.offset));
    if let Some(linkage) = &drive.linkage {
        let statics = model.statics.as_ref().and_then(|statics| statics.linkage.as_ref());
        four_bar(text, linkage, statics);
    }
}

fn four_bar(text: &mut String, linkage: &FourBar, statics: Option<&LinkageStatics>) {
    line!(text);
    line!(text, "[actuators.linkage]");
    let (crank, lever) = (&linkage.crank, &linkage.lever);
    line!(
        text,
        "crank_mm = {}\nlever_mm = {}\nrod_mm = {}",
        mm(crank.length),
        mm(lever.length),
        mm(linkage.rod)
    );
    line!(text, "crank_angle_deg = {}\nlever_angle_deg = {}", deg(crank.angle), deg(lever.angle));
    line!(text, "along_mm = {}", mm(crank.along));
    let axis = &linkage.axis;
    if !axis.is_shoulders() {
        line!(text, "axis_x_mm = {}\naxis_y_mm = {}", mm(axis.x), mm(axis.y));
        line!(text, "axis_tilt_x_deg = {}\naxis_tilt_y_deg = {}", deg(axis.rx), deg(axis.ry));
    }
    let Some(statics) = statics else { return };
    if statics.rod_stiffness <= STIFFEST {
        line!(text, "rod_stiffness_n_per_m = {:?}", statics.rod_stiffness);
    }
    line!(text, "rod_mass_kg = {:?}\ncrank_mass_kg = {:?}", statics.rod_mass, statics.crank.mass);
    let (sin, cos) = crank.angle.sin_cos();
    let centre = &statics.crank.centre_of_mass;
    line!(text, "crank_centre_mm = {}", mm(cos * centre.x + sin * centre.y));
}

fn targets(text: &mut String, targets: &[TargetText<'_>]) {
    for target in targets {
        line!(text);
        line!(text, "{}", if targets.len() == 1 { "[target]" } else { "[[target]]" });
        if !target.name.trim().is_empty() {
            line!(text, "name = {}", quoted(target.name));
        }
        let [x, y, z] = [target.in_flange.x, target.in_flange.y, target.in_flange.z].map(mm);
        line!(text, "x_mm = {x}\ny_mm = {y}\nz_mm = {z}");
        if let Some(rotation) = &target.rotation {
            let row = |row: usize| {
                let row = rotation.matrix().row(row);
                format!("[{:?}, {:?}, {:?}]", row[0], row[1], row[2])
            };
            line!(text, "rotation_matrix = [{}, {}, {}]", row(0), row(1), row(2));
        }
    }
}

fn loads(text: &mut String, statics: &StaticProperties, links: &[CraigLink]) {
    for load in &statics.loads {
        line!(text);
        line!(text, "[[load]]\nname = {}", quoted(&load.name));
        line!(text, "joint = {}", links.get(load.link).map_or_else(String::new, |link| quoted(&link.name)));
        line!(text, "x_mm = {}\ny_mm = {}\nz_mm = {}", mm(load.at.x), mm(load.at.y), mm(load.at.z));
        line!(text, "mass_kg = {:?}", load.mass);
        let force = &load.force;
        line!(text, "force_x_n = {:?}\nforce_y_n = {:?}\nforce_z_n = {:?}", force.x, force.y, force.z);
    }
}
