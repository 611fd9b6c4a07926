//! The robot as described in a URDF: inertias, shapes, and the kinematics again, which must agree with the table.

use std::ops::Range;

use nalgebra::{Matrix3, Rotation3, Vector3};
use urdf_rs::{Geometry, Inertial, JointType};

use super::frames::inertia_fault;
use super::urdf_text::{Element, scan};
use super::urdf_writer::{inertial, origin, pose};
use crate::input::{InputError, Source};
use calibrig_model::geometry::Transform;
use calibrig_model::{Body, CalibrationModel, CraigLink, JointKind, KinematicModel, Visual, VisualShape};

/// Largest difference between the table and the URDF, m or rad.
const TOLERANCE: f64 = 1e-9;

/// The chain of a URDF. Links joined by fixed joints count as one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct UrdfRobot {
    pub base_visuals: Vec<Visual>,
    pub joints: Vec<UrdfJoint>,
    robot_span: Range<usize>,
}

/// A moving joint with the link that it carries.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct UrdfJoint {
    pub name: String,
    pub kind: JointKind,
    /// From the previous moving link, at joint variable zero.
    pub previous_from_joint: Transform,
    pub limits: [f64; 2],
    /// `None` if the link has no inertial.
    pub body: Option<Body>,
    pub visuals: Vec<Visual>,
    span: Range<usize>,
}

/// Speed limit of every actuator in the URDF that a robot's file names, m/s or rad/s; `None` if unknown: no URDF, a velocity of zero, or an actuator
/// that moves more than its own joint.
pub fn actuator_speeds(robot: &super::Robot) -> Vec<Option<f64>> {
    let model = &robot.model;
    let urdf = robot.sources.iter().find(|(role, _)| role == "urdf");
    let urdf = urdf.and_then(|(_, source)| urdf_rs::read_from_string(&source.text).ok());
    let count = model.kinematics.joint_count();
    let elbow = model.actuators.elbow().map(|drive| drive.elbow);
    let speed = |(joint, link): (usize, &CraigLink)| {
        let stated = urdf.as_ref()?.joints.iter().find(|known| known.name == link.name)?.limit.velocity;
        let own = model.actuators.rate(joint, joint);
        let alone = (0..count).all(|other| other == joint || model.actuators.rate(joint, other) == 0.0);
        let is_stated = stated > 0.0 && stated.is_finite();
        let is_its_own = alone && own != 0.0 && elbow != Some(joint) && model.actuators.is_commanded(joint);
        (is_stated && is_its_own).then(|| stated / own.abs())
    };
    model.kinematics.links.iter().enumerate().map(speed).collect()
}

/// A link with everything that is fixed to it, each with its place in the link's frame.
type Group = Vec<(usize, Transform)>;

struct Reader<'a> {
    source: &'a Source,
    elements: Vec<Element<'a>>,
    robot: urdf_rs::Robot,
}

impl UrdfRobot {
    /// Reads an open chain; every refusal points into `source`.
    pub fn parse(source: &Source) -> Result<Self, InputError> {
        Self::reader(source)?.chain()
    }

    fn reader(source: &Source) -> Result<Reader<'_>, InputError> {
        let elements = scan(source)?;
        let robot = urdf_rs::read_from_string(&source.text).map_err(|e| {
            let help = Some("expected a URDF".to_owned());
            source.error(elements[0].span.clone(), e.to_string().replace('\n', " "), help)
        })?;
        Ok(Reader { source, elements, robot })
    }

    /// Refuses a URDF whose joints are not those of `model`: names, order, kinds, frames (1e-9) and limits.
    pub fn check(&self, source: &Source, model: &KinematicModel) -> Result<(), InputError> {
        for (index, (joint, link)) in self.joints.iter().zip(&model.links).enumerate() {
            let before = if index == 0 { model.base_from_first } else { Transform::identity() };
            let differs = |what: &str, found: String, expected: String| {
                source.error(
                    joint.span.clone(),
                    format!("joint {} ({}): {what} {found} differs from robot.toml", index + 1, joint.name),
                    Some(format!("expected {expected}")),
                )
            };
            if joint.name != link.name {
                return Err(differs("name", format!("{:?}", joint.name), format!("{:?}", link.name)));
            }
            if joint.kind != link.kind {
                return Err(differs(
                    "type",
                    kind_name(joint.kind).to_owned(),
                    kind_name(link.kind).to_owned(),
                ));
            }
            let expected = before * link.fixed_part();
            let found = &joint.previous_from_joint;
            let apart = (expected.translation.vector - found.translation.vector).norm();
            let turned = (expected.rotation.matrix() - found.rotation.matrix()).norm() / f64::sqrt(2.0);
            // Written this way round, NaN also differs.
            let agrees = apart <= TOLERANCE && turned <= TOLERANCE;
            if !agrees {
                let (roll, pitch, yaw) = expected.rotation.euler_angles();
                let at = expected.translation.vector;
                return Err(differs(
                    "origin",
                    format!("({apart:.3e} m, {turned:.3e} rad off)"),
                    format!("xyz=\"{} {} {}\" rpy=\"{roll} {pitch} {yaw}\"", at.x, at.y, at.z),
                ));
            }
            for (name, found, expected) in
                [("lower", joint.limits[0], link.limits[0]), ("upper", joint.limits[1], link.limits[1])]
            {
                if (found - expected).abs() > TOLERANCE {
                    return Err(differs(&format!("{name} limit"), found.to_string(), expected.to_string()));
                }
            }
        }
        if let Some(joint) = self.joints.get(model.links.len()) {
            let message = format!("joint {} is not in robot.toml", joint.name);
            return Err(source.error(joint.span.clone(), message, Some(expected_joints(model))));
        }
        if let Some(link) = model.links.get(self.joints.len()) {
            let message = format!("joint {} of robot.toml is missing", link.name);
            return Err(source.error(self.robot_span.clone(), message, Some(expected_joints(model))));
        }
        Ok(())
    }
}

/// A URDF that fits a model of the same joints, with the model's origins and bodies, and the name of the link behind the last joint.
pub(super) fn with_rows(
    source: &Source,
    model: &CalibrationModel,
) -> Result<(urdf_rs::Robot, String), InputError> {
    UrdfRobot::reader(source)?.with_rows(model)
}

fn expected_joints(model: &KinematicModel) -> String {
    let names: Vec<_> = model.links.iter().map(|link| link.name.as_str()).collect();
    format!("expected the joints {}", names.join(", "))
}

fn kind_name(kind: JointKind) -> &'static str {
    match kind {
        JointKind::Revolute => "revolute",
        JointKind::Prismatic => "prismatic",
    }
}

impl Reader<'_> {
    fn error(&self, span: Range<usize>, message: impl std::fmt::Display, expected: &str) -> InputError {
        self.source.error(span, message, Some(format!("expected {expected}")))
    }

    /// Start tag of the `index`-th link or joint.
    fn top_level(&self, kind: &str, index: usize) -> usize {
        let mut all = self.elements.iter().enumerate().filter(|(_, e)| e.parent == Some(0) && e.name == kind);
        all.nth(index).map_or(0, |(element, _)| element)
    }

    fn span(&self, kind: &str, index: usize) -> Range<usize> {
        self.elements[self.top_level(kind, index)].span.clone()
    }

    fn child(&self, parent: usize, name: &str) -> Option<usize> {
        self.elements.iter().position(|e| e.parent == Some(parent) && e.name == name)
    }

    fn link_index(&self, name: &str) -> Option<usize> {
        self.robot.links.iter().position(|link| link.name == name)
    }

    /// The only link that is not a joint's child.
    fn root(&self) -> Result<usize, InputError> {
        let mut carried = vec![false; self.robot.links.len()];
        for (index, link) in self.robot.links.iter().enumerate() {
            if self.link_index(&link.name) != Some(index) {
                let message = format!("a second link named {}", link.name);
                return Err(self.error(self.span("link", index), message, "a different name for each link"));
            }
        }
        for (index, joint) in self.robot.joints.iter().enumerate() {
            for end in [&joint.parent, &joint.child] {
                if self.link_index(&end.link).is_none() {
                    let message =
                        format!("joint {} names a link {} that does not exist", joint.name, end.link);
                    return Err(self.error(self.span("joint", index), message, "the name of a link"));
                }
            }
            if let Some(child) = self.link_index(&joint.child.link)
                && std::mem::replace(&mut carried[child], true)
            {
                let message = format!(
                    "joint {} has a child link that is already the child of another joint",
                    joint.name
                );
                return Err(self.error(self.span("joint", index), message, "one parent joint per link"));
            }
        }
        let mut roots = (0..carried.len()).filter(|index| !carried[*index]);
        match (roots.next(), roots.next()) {
            (Some(root), None) => Ok(root),
            (_, Some(second)) => {
                let message = format!("link {} is not connected to any joint", self.robot.links[second].name);
                Err(self.error(self.span("link", second), message, "one root link"))
            }
            (None, None) => Err(self.error(self.elements[0].span.clone(), "there is no root link", "one")),
        }
    }

    fn chain(&self) -> Result<UrdfRobot, InputError> {
        let mut start = self.root()?;
        let mut seen = 0;
        let mut joints: Vec<UrdfJoint> = Vec::new();
        let mut base_visuals = Vec::new();
        loop {
            let (group, next) = self.fixed_group(start)?;
            seen += group.len();
            let visuals = self.visuals(&group)?;
            match joints.last_mut() {
                None => base_visuals = visuals,
                Some(joint) => {
                    joint.body = self.body(&group)?;
                    joint.visuals = visuals;
                }
            }
            let Some((index, group_from_parent)) = next else { break };
            let joint = self.joint(index, &group_from_parent)?;
            start = self.link_index(&self.robot.joints[index].child.link).unwrap_or(start);
            joints.push(joint);
        }
        if seen < self.robot.links.len() {
            let message = "some links form a loop that is not connected to the root";
            return Err(self.error(self.elements[0].span.clone(), message, "an open chain"));
        }
        Ok(UrdfRobot { base_visuals, joints, robot_span: self.elements[0].span.clone() })
    }

    /// The URDF with the origins of a table's rows and the masses of its bodies, and the name of the link behind the last joint.
    fn with_rows(&self, model: &CalibrationModel) -> Result<(urdf_rs::Robot, String), InputError> {
        let mut robot = self.robot.clone();
        let mut start = self.root()?;
        let bodies = model.statics.as_ref().map(|statics| &statics.bodies);
        for (index, row) in model.kinematics.links.iter().enumerate() {
            let (_, next) = self.fixed_group(start)?;
            let Some((joint, group_from_parent)) = next else { break };
            robot.joints[joint].origin = pose(&(group_from_parent.inverse() * origin(model, index, row)));
            start = self.link_index(&self.robot.joints[joint].child.link).unwrap_or(start);
            let (group, _) = self.fixed_group(start)?;
            let Some(body) = bodies.and_then(|bodies| bodies.get(index)) else { continue };
            if self.body(&group)?.as_ref() != Some(body) {
                for (link, _) in &group {
                    robot.links[*link].inertial = Inertial::default();
                }
                robot.links[start].inertial = inertial(body);
            }
        }
        Ok((robot, self.robot.links[start].name.clone()))
    }

    /// The links that are fixed to `start`, and the one moving joint attached to them.
    fn fixed_group(&self, start: usize) -> Result<(Group, Option<(usize, Transform)>), InputError> {
        let mut group = vec![(start, Transform::identity())];
        let mut moving = None;
        let mut at = 0;
        while let Some(&(link, group_from_link)) = group.get(at) {
            at += 1;
            let name = &self.robot.links[link].name;
            for (index, joint) in self.robot.joints.iter().enumerate().filter(|(_, j)| j.parent.link == *name)
            {
                if joint.joint_type == JointType::Fixed {
                    let child = self.link_index(&joint.child.link).unwrap_or(link);
                    group.push((child, group_from_link * transform(&joint.origin)));
                } else if moving.replace((index, group_from_link)).is_some() {
                    let message = format!("joint {} makes the chain branch", joint.name);
                    return Err(self.error(self.span("joint", index), message, "an open chain"));
                }
            }
        }
        Ok((group, moving))
    }

    fn joint(&self, index: usize, group_from_parent: &Transform) -> Result<UrdfJoint, InputError> {
        let joint = &self.robot.joints[index];
        let element = self.top_level("joint", index);
        let span = self.elements[element].span.clone();
        let kind = match joint.joint_type {
            JointType::Revolute => JointKind::Revolute,
            JointType::Prismatic => JointKind::Prismatic,
            _ => {
                let message = format!("joint {} is neither revolute, prismatic nor fixed", joint.name);
                return Err(self.error(span, message, "type=\"revolute\", \"prismatic\" or \"fixed\""));
            }
        };
        if (Vector3::from(*joint.axis.xyz) - Vector3::z()).amax() > TOLERANCE {
            let at = self.child(element, "axis").unwrap_or(element);
            let message = format!("joint {} does not move along or about z", joint.name);
            return Err(self.error(self.elements[at].span.clone(), message, "<axis xyz=\"0 0 1\"/>"));
        }
        if self.child(element, "limit").is_none() {
            let message = format!("joint {} has no <limit>", joint.name);
            return Err(self.error(span, message, "the limits of robot.toml, in rad or m"));
        }
        Ok(UrdfJoint {
            name: joint.name.clone(),
            kind,
            previous_from_joint: group_from_parent * transform(&joint.origin),
            limits: [joint.limit.lower, joint.limit.upper],
            body: None,
            visuals: Vec::new(),
            span,
        })
    }

    /// All inertials of the group as one body.
    fn body(&self, group: &Group) -> Result<Option<Body>, InputError> {
        let mut bodies = Vec::new();
        for (index, group_from_link) in group {
            let link = self.top_level("link", *index);
            if let Some(inertial) = self.child(link, "inertial") {
                let body = body_of(&self.robot.links[*index].inertial, group_from_link);
                self.check_body(&self.robot.links[*index].name, inertial, &body)?;
                bodies.push(body);
            }
        }
        let body = joined(&bodies);
        match &body {
            Some(all) if !(all.mass.is_finite() && all.inertia.amax().is_finite()) => {
                let message = "the inertials of links fixed to each other sum to infinity";
                Err(self.error(self.span("link", group[0].0), message, "values in SI units"))
            }
            _ => Ok(body),
        }
    }

    fn check_body(&self, link: &str, inertial: usize, body: &Body) -> Result<(), InputError> {
        let span = |name| self.elements[self.child(inertial, name).unwrap_or(inertial)].span.clone();
        if body.mass <= 0.0 {
            let message = format!("the mass of link {link} is {} kg", body.mass);
            return Err(self.error(span("mass"), message, "a mass above zero"));
        }
        if !(body.inertia.amax().is_finite()
            && body.mass.is_finite()
            && body.centre_of_mass.amax().is_finite())
        {
            let message = format!("the inertial of link {link} is too large a number");
            return Err(self.error(self.elements[inertial].span.clone(), message, "values in SI units"));
        }
        match inertia_fault(&body.inertia) {
            None => Ok(()),
            Some(fault) => {
                let message = format!("the inertia of link {link} {fault}");
                Err(self.error(
                    span("inertia"),
                    message,
                    "that of a real body: moments above zero, none above the sum of the others",
                ))
            }
        }
    }

    fn visuals(&self, group: &Group) -> Result<Vec<Visual>, InputError> {
        let mut visuals = Vec::new();
        for (index, group_from_link) in group {
            for visual in &self.robot.links[*index].visual {
                let shape = match visual.geometry {
                    Geometry::Box { size } => VisualShape::Box(*size),
                    Geometry::Cylinder { radius, length } => VisualShape::Cylinder { radius, length },
                    Geometry::Sphere { radius } => VisualShape::Sphere(radius),
                    _ => return Err(self.shape_error(*index, "neither a box, a cylinder nor a sphere")),
                };
                let sizes = match shape {
                    VisualShape::Box(edges) => edges.to_vec(),
                    VisualShape::Cylinder { radius, length } => vec![radius, length],
                    VisualShape::Sphere(radius) => vec![radius],
                };
                if sizes.iter().any(|size| *size <= 0.0) {
                    return Err(self.shape_error(*index, "of size zero"));
                }
                visuals.push(Visual { link_from_shape: group_from_link * transform(&visual.origin), shape });
            }
        }
        Ok(visuals)
    }

    fn shape_error(&self, link: usize, what: &str) -> InputError {
        let message = format!("a shape of link {} is {what}", self.robot.links[link].name);
        self.error(self.span("link", link), message, "<box>, <cylinder> or <sphere> with sizes above zero")
    }
}

/// URDF's roll, pitch and yaw are about the fixed x, y and z.
fn transform(pose: &urdf_rs::Pose) -> Transform {
    let [x, y, z] = *pose.xyz;
    let [roll, pitch, yaw] = *pose.rpy;
    Transform::from_parts(Vector3::new(x, y, z).into(), Rotation3::from_euler_angles(roll, pitch, yaw))
}

fn body_of(inertial: &urdf_rs::Inertial, group_from_link: &Transform) -> Body {
    let group_from_centre = group_from_link * transform(&inertial.origin);
    let i = &inertial.inertia;
    let inertia = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
    let rotation = group_from_centre.rotation.matrix();
    Body {
        mass: inertial.mass.value,
        centre_of_mass: group_from_centre.translation.vector,
        inertia: rotation * inertia * rotation.transpose(),
    }
}

/// Bodies that move as one; `None` for none.
fn joined(bodies: &[Body]) -> Option<Body> {
    if bodies.is_empty() {
        return None;
    }
    let mass: f64 = bodies.iter().map(|body| body.mass).sum();
    let centre_of_mass =
        bodies.iter().map(|body| body.mass * body.centre_of_mass).sum::<Vector3<f64>>() / mass;
    let inertia = bodies
        .iter()
        .map(|body| {
            // Steiner: to the common centre of mass.
            let r = body.centre_of_mass - centre_of_mass;
            body.inertia + body.mass * (Matrix3::identity() * r.norm_squared() - r * r.transpose())
        })
        .sum();
    Some(Body { mass, centre_of_mass, inertia })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::tests::base_from_flange;
    use crate::{load_robot, parse_robot};
    use calibrig_model::random::{StreamSource as Stream, stream};
    use proptest::prelude::*;
    use rand::RngExt;
    use std::path::Path;

    fn folder() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/spray_painter")
    }

    fn text(name: &str) -> Source {
        Source::read(&folder().join(name)).expect("the model of the repository")
    }

    fn parse(text: &str) -> Result<UrdfRobot, InputError> {
        UrdfRobot::parse(&Source::new("robot.urdf", text))
    }

    const TWO: &str = r#"<robot name="two">
<link name="base"/>
<link name="arm">
  <inertial>
    <origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>
    <mass value="2"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/>
  </inertial>
  <visual>
    <origin xyz="0.5 0 0"/>
    <geometry><box size="1 0.1 0.2"/></geometry>
  </visual>
</link>
<joint name="swing" type="revolute">
  <parent link="base"/>
  <child link="arm"/>
  <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/>
  <axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/>
</joint>
</robot>
"#;

    /// Message, line and help of the refusal of `TWO` with `from` replaced by `to`.
    fn refusal(from: &str, to: &str) -> (String, usize, String) {
        assert!(TWO.contains(from), "{from}");
        match parse(&TWO.replacen(from, to, 1)) {
            Err(InputError::Invalid { message, line, help, .. }) => (message, line, help.unwrap_or_default()),
            other => panic!("{from} -> {to}: {other:?}"),
        }
    }

    #[test]
    fn the_inertias_axes_turn_with_their_origin() {
        let robot = parse(TWO).expect("valid");
        let joint = &robot.joints[0];
        let body = joint.body.as_ref().expect("an inertial");
        assert_eq!((body.mass, body.centre_of_mass), (2.0, Vector3::x()));
        // A quarter turn about z exchanges x and y.
        assert!((body.inertia - Matrix3::from_diagonal(&Vector3::new(2.0, 1.0, 2.5))).norm() < 1e-15);
        assert_eq!(joint.visuals[0].link_from_shape.translation.vector, Vector3::new(0.5, 0.0, 0.0));
        assert_eq!(joint.visuals[0].shape, VisualShape::Box([1.0, 0.1, 0.2]));
        let expected = calibrig_model::geometry::translation(0.0, 0.0, 0.3)
            * calibrig_model::geometry::rotation_z(0.3)
            * calibrig_model::geometry::rotation_y(0.2)
            * calibrig_model::geometry::rotation_x(0.1);
        assert!((joint.previous_from_joint.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-15);
    }

    /// Two halves of a box fixed to each other against the whole box.
    #[test]
    fn links_fixed_to_each_other_are_one_body() {
        let slab = |name: &str, x: f64, length: f64, mass: f64| {
            let across = mass / 12.0 * (length * length + 0.01);
            format!(
                "<link name=\"{name}\"><inertial><origin xyz=\"{x} 0 0\"/><mass value=\"{mass}\"/><inertia ixx=\"{}\" ixy=\"0\" \
                 ixz=\"0\" iyy=\"{across}\" iyz=\"0\" izz=\"{across}\"/></inertial></link>",
                mass / 12.0 * 0.02
            )
        };
        let joint = TWO[TWO.find("<joint").unwrap()..].replace("</robot>", "");
        let fixed = "<joint name=\"weld\" type=\"fixed\"><parent link=\"arm\"/><child link=\"tip\"/><origin xyz=\"0 0.7 0\" rpy=\"0 0 1.5707963267948966\"/></joint>";
        let whole =
            format!("<robot name=\"r\"><link name=\"base\"/>{}{joint}</robot>", slab("arm", 1.0, 2.0, 6.0));
        let halves = format!(
            "<robot name=\"r\"><link name=\"base\"/>{}{}{joint}{fixed}</robot>",
            slab("arm", 0.5, 1.0, 3.0),
            // In the tip's frame, which is turned by a quarter about z and lies at y = 0.7, the slab must lie along the arm's x.
            slab("tip", 0.0, 1.0, 3.0)
                .replace("xyz=\"0 0 0\"", "xyz=\"-0.7 -1.5 0\" rpy=\"0 0 -1.5707963267948966\"")
        );
        let body = |text: &str| parse(text).expect("valid").joints[0].body.clone().expect("inertials");
        let (whole, halves) = (body(&whole), body(&halves));
        assert!((whole.mass - halves.mass).abs() < 1e-14);
        assert!((whole.centre_of_mass - halves.centre_of_mass).norm() < 1e-14);
        assert!((whole.inertia - halves.inertia).norm() < 1e-14, "{} {}", whole.inertia, halves.inertia);
    }

    #[test]
    fn every_mistake_is_named_with_its_line_and_what_was_expected() {
        for (from, to, message, line, help) in [
            ("value=\"2\"", "value=\"0\"", "the mass of link arm is 0 kg", 6, "above zero"),
            ("value=\"2\"", "value=\"-2\"", "the mass of link arm is -2 kg", 6, "above zero"),
            ("value=\"2\"", "value=\"NaN\"", "value of <mass> is \"NaN\"", 6, "finite"),
            ("value=\"2\"", "value=\"1e400\"", "value of <mass> is \"1e400\"", 6, "finite"),
            ("value=\"2\"", "", "<mass> has no value", 6, "value="),
            ("<mass value=\"2\"/>", "", "<inertial> has no <mass>", 4, "<mass"),
            ("ixx=\"1\"", "ixx=\"-1\"", "not positive definite", 7, "above zero"),
            ("ixy=\"0\"", "ixy=\"1.5\"", "not positive definite", 7, "above zero"),
            ("izz=\"2.5\"", "izz=\"3.5\"", "the inertia of link arm is not that of a real body", 7, "sum"),
            ("xyz=\"1 0 0\"", "xyz=\"1 0\"", "xyz of <origin> is \"1 0\"", 5, "3 finite numbers"),
            ("xyz=\"1 0 0\"", "xyz=\"1 x 0 0\"", "xyz of <origin>", 5, "3 finite numbers"),
            ("rpy=\"0.1 0.2 0.3\"", "rpy=\"0.1 0.2 inf\"", "rpy of <origin>", 17, "3 finite numbers"),
            ("xyz=\"1 0 0\"", "xzy=\"1 0 0\"", "unknown attribute xzy of <origin>", 5, "xyz, rpy"),
            ("<inertial>", "<inertail>", "unknown element <inertail> in <link>", 4, "<inertial>"),
            ("<box size=\"1 0.1 0.2\"/>", "<mesh filename=\"a\"/>", "unknown element <mesh>", 11, "<sphere>"),
            (
                "<box size=\"1 0.1 0.2\"/>",
                "<sphere radius=\"0\"/>",
                "a shape of link arm is of size zero",
                3,
                "above zero",
            ),
            ("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 1 0\"/>", "does not move along or about z", 18, "0 0 1"),
            ("<axis xyz=\"0 0 1\"/>", "", "does not move along or about z", 14, "0 0 1"),
            (
                "<limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>",
                "",
                "has no <limit>",
                14,
                "limits",
            ),
            (
                "type=\"revolute\"",
                "type=\"continuous\"",
                "neither revolute, prismatic nor fixed",
                14,
                "revolute",
            ),
            (
                "type=\"revolute\"",
                "type=\"hinge\"",
                "type of <joint> is \"hinge\"",
                14,
                "revolute, prismatic or fixed",
            ),
            ("<child link=\"arm\"/>", "<child link=\"leg\"/>", "a link leg that does not exist", 14, "link"),
            ("<child link=\"arm\"/>", "<child link=\"base\"/>", "form a loop", 1, "open chain"),
            (
                "<link name=\"base\"/>",
                "<link name=\"base\"/><link name=\"b\"/>",
                "link b is not connected to any joint",
                2,
                "one root",
            ),
            ("<link name=\"base\"/>", "<link name=\"arm\"/>", "a second link named arm", 3, "different name"),
            ("</robot>", "", "<robot> is not closed", 1, "URDF"),
            ("</inertial>", "</visual>", "</visual> closes <inertial>", 8, "URDF"),
            ("</link>", "</link></link>", "</link> closes <robot>", 13, "URDF"),
            ("<link name=\"base\"/>", "<link name=\"base\"/>&lt;", "text outside any tag", 2, "URDF"),
            ("<link name=\"base\"/>", "<!DOCTYPE a>", "only elements and comments", 2, "URDF"),
            ("<link name=\"base\"/>", "<!-- base", "comment is not closed", 2, "URDF"),
            ("<link name=\"base\"/>", "<link name=base/>", "not in quotes", 2, "URDF"),
            ("<link name=\"base\"/>", "<link name/>", "no value", 2, "URDF"),
            ("<link name=\"base\"/>", "<link name=\"\"/>", "name of <link> is \"\"", 2, "name"),
            (
                "</link>",
                "<inertial><mass value=\"1\"/></inertial></link>",
                "a second <inertial>",
                13,
                "only one",
            ),
        ] {
            let (found, at, expected) = refusal(from, to);
            assert!(found.contains(message), "{to}: {found}");
            assert!(expected.contains(help), "{to}: {expected}");
            assert_eq!(at, line, "{to}: {found}");
        }
        for nothing in [
            "",
            " \n",
            "<!-- -->",
            "garbage",
            "<",
            "<robot",
            "\u{feff}",
            "{}",
            "<a/>",
            "<robot/>",
            "<robot name=\"a\"/>",
        ] {
            assert!(parse(nothing).is_err(), "{nothing}");
        }
        let deep = format!("<robot name=\"a\">{}", "<link name=\"a\">".repeat(100_000));
        assert!(parse(&deep).is_err());
    }

    #[test]
    fn branches_and_loops_of_links_are_refused() {
        let links: String = ["base", "a", "b"].map(|name| format!("<link name=\"{name}\"/>")).concat();
        let joint = |name: &str, parent: &str, child: &str| {
            format!(
                "<joint name=\"{name}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"{child}\"/><axis xyz=\"0 0 1\"/>\
                 <limit lower=\"0\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>"
            )
        };
        let robot = |joints: &str| parse(&format!("<robot name=\"r\">{links}{joints}</robot>"));
        assert_eq!(
            robot(&(joint("1", "base", "a") + &joint("2", "a", "b"))).expect("a chain").joints.len(),
            2
        );
        for (joints, message) in [
            (joint("1", "base", "a") + &joint("2", "base", "b"), "branch"),
            (joint("1", "a", "b") + &joint("2", "b", "a"), "form a loop"),
            (joint("1", "base", "a") + &joint("2", "b", "a"), "another joint"),
            (joint("1", "base", "a") + &joint("2", "a", "b") + &joint("3", "b", "base"), "no root"),
        ] {
            let error = robot(&joints).unwrap_err().to_string();
            assert!(error.contains(message), "{message}: {error}");
        }
    }

    #[test]
    fn a_urdf_that_differs_from_the_table_is_refused() {
        let (table, urdf) = (text("robot.toml"), text("robot.urdf"));
        let refusal = |from: &str, to: &str| {
            assert!(urdf.text.contains(from), "{from}");
            let changed = Source::new("robot.urdf", urdf.text.replacen(from, to, 1));
            parse_robot(table.clone(), Some(changed), None).unwrap_err().to_string()
        };
        for (from, to, message) in [
            ("<joint name=\"elbow\"", "<joint name=\"ellbow\"", "name \"ellbow\" differs"),
            (
                "<joint name=\"elbow\" type=\"revolute\"",
                "<joint name=\"elbow\" type=\"prismatic\"",
                "type prismatic differs",
            ),
            (
                "xyz=\"1.35 0 0\" rpy=\"0 0 0\"/>\n    <axis",
                "xyz=\"1.350000002 0 0\" rpy=\"0 0 0\"/>\n    <axis",
                "origin (2.000e-9 m",
            ),
            (
                "xyz=\"1.35 0 0\" rpy=\"0 0 0\"/>\n    <axis",
                "xyz=\"1.35 0 0\" rpy=\"0 2e-9 0\"/>\n    <axis",
                "2.000e-9 rad off",
            ),
            ("upper=\"2.3\"", "upper=\"2.31\"", "upper limit 2.31 differs"),
            ("lower=\"1.7\"", "lower=\"1.6\"", "lower limit 1.6 differs"),
        ] {
            let error = refusal(from, to);
            assert!(error.contains(message), "{to}: {error}");
        }
        // Half the tolerance passes.
        let near = urdf.text.replacen(
            "\"1.35 0 0\" rpy=\"0 0 0\"/>\n    <axis",
            "\"1.3500000005 0 0\" rpy=\"0 0 0\"/>\n    <axis",
            1,
        );
        assert_ne!(near, urdf.text);
        assert!(parse_robot(table.clone(), Some(Source::new("robot.urdf", near)), None).is_ok());
        // A joint too few, too many, and one without masses.
        let end = urdf.text.find("  <joint name=\"wrist\"").unwrap();
        let short = urdf.text[..end].replace("<link name=\"gun\">", "<!--").replacen(
            "  </link>\n  <joint",
            "-->\n  <joint",
            1,
        ) + "</robot>";
        let error = parse_robot(table.clone(), Some(Source::new("u", short)), None).unwrap_err().to_string();
        assert!(error.contains("joint wrist of robot.toml is missing"), "{error}");
        let longer = "  <link name=\"more\"/><joint name=\"more\" type=\"revolute\"><parent link=\"gun\"/><child link=\"more\"/>\
            <axis xyz=\"0 0 1\"/><limit lower=\"0\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint></robot>";
        let long = urdf.text.replace("</robot>", longer);
        let error = parse_robot(table.clone(), Some(Source::new("u", long)), None).unwrap_err().to_string();
        assert!(error.contains("joint more is not in robot.toml"), "{error}");
        let massless = urdf.text.replacen("<inertial>", "<!--", 1).replacen("</inertial>", "-->", 1);
        let error = parse_robot(table, Some(Source::new("u", massless)), None).unwrap_err().to_string();
        assert!(error.contains("no <inertial> for what joint \"rail\" carries"), "{error}");
    }

    /// The joints of the URDF multiplied out against the D-H product.
    #[test]
    fn the_urdf_of_the_spray_painter_moves_as_its_table() {
        let robot = load_robot(&folder().join("robot.toml")).expect("the model of the repository");
        let urdf = UrdfRobot::parse(&text("robot.urdf")).expect("the model of the repository");
        let mut rng = stream(1, 0, Stream::AsBuilt);
        let mut worst = 0.0f64;
        for _ in 0..200 {
            let q: Vec<f64> =
                urdf.joints.iter().map(|joint| rng.random_range(joint.limits[0]..joint.limits[1])).collect();
            let product = urdf.joints.iter().zip(&q).fold(Transform::identity(), |product, (joint, q)| {
                product
                    * joint.previous_from_joint
                    * match joint.kind {
                        JointKind::Revolute => calibrig_model::geometry::rotation_z(*q),
                        JointKind::Prismatic => calibrig_model::geometry::translation(0.0, 0.0, *q),
                    }
            });
            let difference =
                base_from_flange(&robot.model.kinematics, &q).to_homogeneous() - product.to_homogeneous();
            worst = worst.max(difference.norm());
        }
        eprintln!("URDF against D-H: {worst:.1e} m");
        assert!(worst < 1e-12, "{worst}");
    }

    /// As its comment says: every inertial is that of a uniform solid of the link's first shape.
    #[test]
    fn the_inertias_of_the_spray_painter_are_those_of_its_shapes() {
        let urdf = UrdfRobot::parse(&text("robot.urdf")).expect("the model of the repository");
        for joint in &urdf.joints {
            let (body, visual) = (joint.body.as_ref().expect("an inertial"), &joint.visuals[0]);
            let m = body.mass;
            let moments = match visual.shape {
                VisualShape::Box([a, b, c]) => {
                    Vector3::new(b * b + c * c, a * a + c * c, a * a + b * b) * (m / 12.0)
                }
                VisualShape::Cylinder { radius: r, length: l } => {
                    let across = m / 12.0 * (3.0 * r * r + l * l);
                    Vector3::new(across, across, m * r * r / 2.0)
                }
                VisualShape::Sphere(r) => Vector3::repeat(0.4 * m * r * r),
            };
            let rotation = visual.link_from_shape.rotation.matrix();
            let expected = rotation * Matrix3::from_diagonal(&moments) * rotation.transpose();
            assert!((body.inertia - expected).norm() < 1e-7 * expected.norm(), "{}", joint.name);
            assert!((body.centre_of_mass - visual.link_from_shape.translation.vector).norm() < 1e-12);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(600))]
        #[test]
        fn no_mutation_of_a_urdf_panics(
            at in 0usize..700, remove in 0usize..12, insert in "\\PC{0,4}|[<>/\"'=!?&; \n-]{0,4}", cut in prop::option::of(0usize..700)
        ) {
            let mut text: Vec<char> = TWO.chars().collect();
            let at = at.min(text.len());
            let end = (at + remove).min(text.len());
            text.splice(at..end, insert.chars());
            text.truncate(cut.unwrap_or(usize::MAX));
            let text: String = text.into_iter().collect();
            if let Err(error) = parse(&text) {
                let drawn = format!("{:?}", miette::Report::new(error));
                prop_assert!(!drawn.is_empty());
            }
        }

        #[test]
        fn no_bytes_panic_as_a_urdf(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&String::from_utf8_lossy(&bytes));
        }
    }
}
