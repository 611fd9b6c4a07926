//! `robot.toml`: the D-H table, limits, drives, actuators, target and gravity, with their units in the keys.

use std::path::Path;

use nalgebra::Vector3;
use serde::Deserialize;

use super::urdf::UrdfRobot;
use super::{
    ActuatorMap, Body, CalibrationModel, CraigLink, JointKind, KinematicModel, StaticProperties, Visual,
};
use crate::geometry::{Transform, rotation_x, translation};
use crate::input::{InputError, Source, Spanned};

/// The only schema that is read.
const SCHEMA: &str = "calibrig.robot/1";

/// A robot as its files describe it.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Name for people.
    pub name: String,
    /// What identification may know.
    pub model: CalibrationModel,
    /// Shapes to draw, per link (link 0 of the vector is the base, then one an entry per joint); empty without a URDF.
    pub visuals: Vec<Vec<Visual>>,
    /// Nominal offset of the target in the flange frame, m; `None` where it is not known.
    pub target: Option<Vector3<f64>>,
    /// The files read, by role: `robot`, then `urdf` and `columns` where it names them.
    pub sources: Vec<(String, Source)>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    schema: Spanned<String>,
    name: Spanned<String>,
    convention: Convention,
    urdf: Option<Spanned<String>>,
    columns: Option<Spanned<String>>,
    #[serde(default)]
    joint: Vec<Spanned<JointTable>>,
    actuators: Spanned<ActuatorTable>,
    target: Option<TargetTable>,
    gravity: Option<Spanned<GravityTable>>,
}

/// Whose D-H table it is.
#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum Convention {
    /// `Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d)`, a row's a and alpha in front of its joint.
    Craig,
    /// `Rz(theta) Tz(d) Tx(a) Rx(alpha)`, a row's a and alpha behind its joint.
    Standard,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum JointType {
    Revolute,
    Prismatic,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointTable {
    name: Spanned<String>,
    r#type: JointType,
    a_mm: Spanned<f64>,
    alpha_deg: Spanned<f64>,
    d_mm: Spanned<f64>,
    theta_deg: Spanned<f64>,
    beta_deg: Option<Spanned<f64>>,
    min_mm: Option<Spanned<f64>>,
    max_mm: Option<Spanned<f64>>,
    min_deg: Option<Spanned<f64>>,
    max_deg: Option<Spanned<f64>>,
    stiffness_n_per_m: Option<Spanned<f64>>,
    stiffness_nm_per_rad: Option<Spanned<f64>>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum ActuatorKind {
    Direct,
    Parallelogram,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ActuatorTable {
    kind: ActuatorKind,
    shoulder: Option<Spanned<String>>,
    elbow: Option<Spanned<String>>,
    offset_deg: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetTable {
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GravityTable {
    x_m_per_s2: Spanned<f64>,
    y_m_per_s2: Spanned<f64>,
    z_m_per_s2: Spanned<f64>,
}

/// Reads `robot.toml` and the files it names, which it seeks beside itself.
pub fn load_robot(path: &Path) -> Result<Robot, InputError> {
    let robot = Source::read(path)?;
    let file: RobotFile = robot.toml()?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let beside = |key: &str, name: Option<&Spanned<String>>| {
        let Some(name) = name else { return Ok(None) };
        Source::read(&folder.join(name.get_ref())).map(Some).map_err(|error| {
            robot.error(
                name.span(),
                format!("{key}: {error}"),
                Some("expected the name of a file, relative to this one".to_owned()),
            )
        })
    };
    let urdf = beside("urdf", file.urdf.as_ref())?;
    let columns = beside("columns", file.columns.as_ref())?;
    parse_robot(robot, urdf, columns)
}

/// The same from texts in memory (a recording's attachments): `urdf` and `columns` are the files that the robot's text names, by
/// content.
pub fn parse_robot(
    robot: Source,
    urdf: Option<Source>,
    columns: Option<Source>,
) -> Result<Robot, InputError> {
    let file: RobotFile = robot.toml()?;
    let reader = Reader { source: &robot, file: &file };
    reader.check_head()?;
    reader.check_companion("urdf", file.urdf.as_ref(), urdf.as_ref())?;
    reader.check_companion("columns", file.columns.as_ref(), columns.as_ref())?;
    let kinematics = reader.kinematics()?;
    let actuators = reader.actuators()?;
    let drives = reader.drives()?;
    let gravity = reader.gravity()?;
    let target = reader.target()?;
    let described = match &urdf {
        Some(text) => {
            let described = UrdfRobot::parse(text)?;
            described.check(text, &kinematics)?;
            Some(described)
        }
        None => None,
    };
    let statics = reader.statics(drives, gravity, described.as_ref())?;
    let visuals = described.map_or_else(Vec::new, |described| {
        let joints = described.joints.into_iter().map(|joint| joint.visuals);
        std::iter::once(described.base_visuals).chain(joints).collect()
    });
    let name = file.name.get_ref().clone();
    let companions = [("urdf", urdf), ("columns", columns)];
    let mut sources = vec![("robot".to_owned(), robot)];
    sources.extend(
        companions.into_iter().filter_map(|(role, source)| source.map(|source| (role.to_owned(), source))),
    );
    let model = CalibrationModel {
        motor_turns: vec![None; kinematics.joint_count()],
        kinematics,
        actuators,
        statics,
    };
    Ok(Robot { name, model, visuals, target, sources })
}

struct Reader<'a> {
    source: &'a Source,
    file: &'a RobotFile,
}

impl Reader<'_> {
    fn error<T>(
        &self,
        span: std::ops::Range<usize>,
        message: impl std::fmt::Display,
        expected: &str,
    ) -> Result<T, InputError> {
        Err(self.source.error(span, message, Some(format!("expected {expected}"))))
    }

    fn check_head(&self) -> Result<(), InputError> {
        let schema = &self.file.schema;
        if schema.get_ref() != SCHEMA {
            return self.error(
                schema.span(),
                format!("schema is {:?}", schema.get_ref()),
                &format!("{SCHEMA:?}"),
            );
        }
        if self.file.name.get_ref().trim().is_empty() {
            return self.error(self.file.name.span(), "name is empty", "a name for people");
        }
        Ok(())
    }

    fn check_companion(
        &self,
        key: &str,
        name: Option<&Spanned<String>>,
        text: Option<&Source>,
    ) -> Result<(), InputError> {
        match (name, text) {
            (Some(name), None) => {
                let message = format!("{key} {:?} was not given", name.get_ref());
                self.error(name.span(), message, "the text of the file that it names")
            }
            (None, Some(text)) => {
                let message = format!("{} was given, but there is no key {key}", text.name);
                self.error(0..0, message, &format!("{key} = \"...\""))
            }
            _ => Ok(()),
        }
    }

    fn millimetres(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        Ok(self.source.finite(key, value)? / 1e3)
    }

    fn degrees(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        Ok(self.source.finite(key, value)?.to_radians())
    }

    fn kinematics(&self) -> Result<KinematicModel, InputError> {
        if self.file.joint.is_empty() {
            return self.error(0..0, "there is no joint", "a table [[joint]] for every joint, from the base");
        }
        let mut links: Vec<CraigLink> = Vec::new();
        // A standard row's a and alpha stand in front of the next joint in Craig's table: Tx and Rx commute.
        let mut behind = (0.0, 0.0);
        for table in &self.file.joint {
            let mut link = self.link(table)?;
            if links.iter().any(|other| other.name == link.name) {
                let span = table.get_ref().name.span();
                return self.error(span, format!("a second joint {:?}", link.name), "a name of its own");
            }
            if self.file.convention == Convention::Standard {
                if let Some(beta) = &table.get_ref().beta_deg {
                    let message = "beta_deg in a table of the standard convention";
                    return self.error(beta.span(), message, "no beta_deg, or convention = \"craig\"");
                }
                let own = (link.a, link.alpha);
                (link.a, link.alpha) = std::mem::replace(&mut behind, own);
            }
            links.push(link);
        }
        let last_from_flange: Transform = translation(behind.0, 0.0, 0.0) * rotation_x(behind.1);
        Ok(KinematicModel { links, last_from_flange })
    }

    fn link(&self, table: &Spanned<JointTable>) -> Result<CraigLink, InputError> {
        let joint = table.get_ref();
        let name = joint.name.get_ref();
        if name.trim().is_empty() {
            return self.error(joint.name.span(), "name is empty", "the joint's name, as in the URDF");
        }
        let beta = joint.beta_deg.as_ref().map_or(Ok(0.0), |beta| self.degrees("beta_deg", beta))?;
        Ok(CraigLink {
            name: name.clone(),
            kind: match joint.r#type {
                JointType::Revolute => JointKind::Revolute,
                JointType::Prismatic => JointKind::Prismatic,
            },
            a: self.millimetres("a_mm", &joint.a_mm)?,
            alpha: self.degrees("alpha_deg", &joint.alpha_deg)?,
            beta,
            d: self.millimetres("d_mm", &joint.d_mm)?,
            theta: self.degrees("theta_deg", &joint.theta_deg)?,
            limits: self.limits(table)?,
        })
    }

    /// The value of the key in the joint's unit; the key in the other unit is an error.
    fn in_unit_of_joint<'v>(
        &self,
        table: &Spanned<JointTable>,
        prismatic: (&str, &'v Option<Spanned<f64>>),
        revolute: (&str, &'v Option<Spanned<f64>>),
    ) -> Result<(String, Option<&'v Spanned<f64>>), InputError> {
        let joint = table.get_ref();
        let (kind, (right, value), (wrong, other)) = match joint.r#type {
            JointType::Prismatic => ("prismatic", prismatic, revolute),
            JointType::Revolute => ("revolute", revolute, prismatic),
        };
        if let Some(other) = other {
            let message = format!("{wrong} of joint {:?}, which is {kind}", joint.name.get_ref());
            return self.error(other.span(), message, right);
        }
        Ok((right.to_owned(), value.as_ref()))
    }

    fn limits(&self, table: &Spanned<JointTable>) -> Result<[f64; 2], InputError> {
        let joint = table.get_ref();
        let bounds = [
            self.in_unit_of_joint(table, ("min_mm", &joint.min_mm), ("min_deg", &joint.min_deg))?,
            self.in_unit_of_joint(table, ("max_mm", &joint.max_mm), ("max_deg", &joint.max_deg))?,
        ];
        let mut limits = [0.0; 2];
        for (limit, (key, value)) in limits.iter_mut().zip(&bounds) {
            let Some(value) = value else {
                let message = format!("joint {:?} has no {key}", joint.name.get_ref());
                return self.error(table.span(), message, key);
            };
            *limit = match joint.r#type {
                JointType::Prismatic => self.millimetres(key, value)?,
                JointType::Revolute => self.degrees(key, value)?,
            };
        }
        if limits[0] >= limits[1] {
            let (key, value) = &bounds[1];
            let message = format!("{key} of joint {:?} is not above {}", joint.name.get_ref(), bounds[0].0);
            let span = value.map_or(table.span(), Spanned::span);
            return self.error(span, message, "the lower limit below the upper");
        }
        Ok(limits)
    }

    /// N/m or N m/rad, one a joint; `None` where no joint has any.
    fn drives(&self) -> Result<Option<Vec<f64>>, InputError> {
        let mut stiffness = Vec::new();
        let mut without = None;
        for table in &self.file.joint {
            let joint = table.get_ref();
            let (key, value) = self.in_unit_of_joint(
                table,
                ("stiffness_n_per_m", &joint.stiffness_n_per_m),
                ("stiffness_nm_per_rad", &joint.stiffness_nm_per_rad),
            )?;
            match value {
                Some(value) => stiffness.push(self.source.positive(&key, value)?),
                None => without = without.or(Some((table, key))),
            }
        }
        match without {
            Some(_) if stiffness.is_empty() => Ok(None),
            Some((table, key)) => {
                let message = format!("joint {:?} has no {key}, others have", table.get_ref().name.get_ref());
                self.error(table.span(), message, "a stiffness of every drive, or of none")
            }
            None => Ok(Some(stiffness)),
        }
    }

    fn actuators(&self) -> Result<ActuatorMap, InputError> {
        let table = self.file.actuators.get_ref();
        if table.kind == ActuatorKind::Direct {
            let names = [&table.shoulder, &table.elbow].into_iter().flatten().map(Spanned::span);
            return match names.chain(table.offset_deg.as_ref().map(Spanned::span)).next() {
                Some(span) => self.error(span, "kind = \"direct\" has no loop", "kind = \"parallelogram\""),
                None => Ok(ActuatorMap::Direct),
            };
        }
        let shoulder = self.loop_joint("shoulder", table.shoulder.as_ref())?;
        let elbow = self.loop_joint("elbow", table.elbow.as_ref())?;
        if let Some(name) = table.elbow.as_ref().filter(|_| shoulder == elbow) {
            return self.error(name.span(), "elbow and shoulder are one joint", "two joints");
        }
        let Some(offset) = &table.offset_deg else {
            return self.error(self.file.actuators.span(), "[actuators] has no offset_deg", "offset_deg");
        };
        Ok(ActuatorMap::Parallelogram {
            shoulder,
            elbow,
            offset: self.degrees("offset_deg", offset)?,
            linkage: None,
        })
    }

    /// Index of the revolute joint that the parallelogram names.
    fn loop_joint(&self, key: &str, name: Option<&Spanned<String>>) -> Result<usize, InputError> {
        let Some(name) = name else {
            let message = format!("[actuators] has no {key}");
            return self.error(self.file.actuators.span(), message, "the name of a revolute joint");
        };
        let joints = || self.file.joint.iter().map(Spanned::get_ref);
        let Some(index) = joints().position(|joint| joint.name.get_ref() == name.get_ref()) else {
            let names: Vec<_> = joints().map(|joint| joint.name.get_ref().as_str()).collect();
            let message = format!("{key}: no joint {:?}", name.get_ref());
            return self.error(name.span(), message, &format!("one of {}", names.join(", ")));
        };
        if self.file.joint[index].get_ref().r#type == JointType::Prismatic {
            let message = format!("{key}: joint {:?} is prismatic", name.get_ref());
            return self.error(name.span(), message, "a revolute joint");
        }
        Ok(index)
    }

    fn gravity(&self) -> Result<Option<Vector3<f64>>, InputError> {
        let Some(table) = &self.file.gravity else { return Ok(None) };
        let gravity = table.get_ref();
        Ok(Some(Vector3::new(
            self.source.finite("x_m_per_s2", &gravity.x_m_per_s2)?,
            self.source.finite("y_m_per_s2", &gravity.y_m_per_s2)?,
            self.source.finite("z_m_per_s2", &gravity.z_m_per_s2)?,
        )))
    }

    fn target(&self) -> Result<Option<Vector3<f64>>, InputError> {
        let Some(target) = &self.file.target else { return Ok(None) };
        Ok(Some(Vector3::new(
            self.millimetres("x_mm", &target.x_mm)?,
            self.millimetres("y_mm", &target.y_mm)?,
            self.millimetres("z_mm", &target.z_mm)?,
        )))
    }

    /// Deflections need stiffness, gravity and masses together: some of them without the others are a mistake.
    fn statics(
        &self,
        drives: Option<Vec<f64>>,
        gravity: Option<Vector3<f64>>,
        urdf: Option<&UrdfRobot>,
    ) -> Result<Option<StaticProperties>, InputError> {
        let (drive_stiffness, gravity) = match (drives, gravity) {
            (None, None) => return Ok(None),
            (Some(drives), Some(gravity)) => (drives, gravity),
            (Some(_), None) => {
                let span = self.file.joint[0].span();
                return self.error(
                    span,
                    "the drives have stiffnesses, but there is no [gravity]",
                    "[gravity]",
                );
            }
            (None, Some(_)) => {
                let span = self.file.gravity.as_ref().map_or(0..0, Spanned::span);
                let expected = "stiffness_n_per_m or stiffness_nm_per_rad of every joint";
                return self.error(span, "there is [gravity], but no drive has a stiffness", expected);
            }
        };
        let Some(urdf) = urdf else {
            let message = "there are stiffnesses and [gravity], but no masses";
            return self.error(0..0, message, "urdf = \"robot.urdf\" with the inertials");
        };
        let bodies: Result<Vec<Body>, InputError> = urdf
            .joints
            .iter()
            .zip(&self.file.joint)
            .map(|(joint, table)| match &joint.body {
                Some(body) => Ok(body.clone()),
                None => {
                    let message =
                        format!("the URDF has no <inertial> of what joint {:?} carries", joint.name);
                    self.error(
                        table.get_ref().name.span(),
                        message,
                        "an <inertial>, or no stiffnesses and [gravity]",
                    )
                }
            })
            .collect();
        Ok(Some(StaticProperties::of_drives(bodies?, drive_stiffness, gravity)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elastostatics::joint_deflections;
    use crate::geometry::rotation_z;
    use crate::kinematics::{forward_kinematics, target_in_base};
    use crate::random::{Source as Stream, stream};
    use proptest::prelude::*;
    use rand::RngExt;

    const CENTRE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
    const HALF_WIDTH: [f64; 7] = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];

    fn model_file(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("models").join(name)
    }

    fn spray_painter() -> Robot {
        load_robot(&model_file("spray_painter/robot.toml")).expect("the model of the repository")
    }

    const TWO_JOINTS: &str = r#"
schema = "calibrig.robot/1"
name = "two"
convention = "craig"
[[joint]]
name = "slide"
type = "prismatic"
a_mm = 0
alpha_deg = 0
d_mm = 100
theta_deg = 0
min_mm = 0
max_mm = 500
[[joint]]
name = "swing"
type = "revolute"
a_mm = 250.5
alpha_deg = -90
d_mm = 0
theta_deg = 30
beta_deg = 1
min_deg = -180
max_deg = 90
[actuators]
kind = "direct"
"#;

    fn parse(text: &str) -> Result<Robot, InputError> {
        parse_robot(Source::new("robot.toml", text), None, None)
    }

    /// Message, line and help of the refusal of `TWO_JOINTS` with `from` replaced by `to`.
    fn refusal(from: &str, to: &str) -> (String, usize, String) {
        assert!(TWO_JOINTS.contains(from), "{from}");
        let text = TWO_JOINTS.replacen(from, to, 1);
        match parse(&text) {
            Err(InputError::Invalid { message, line, help, .. }) => (message, line, help.unwrap_or_default()),
            other => panic!("{from} -> {to}: {other:?}"),
        }
    }

    #[test]
    fn numbers_are_converted_on_entry() {
        let robot = parse(TWO_JOINTS).expect("valid");
        let [slide, swing] = robot.model.kinematics.links.as_slice() else { panic!("two links") };
        assert_eq!((slide.kind, slide.d, slide.limits), (JointKind::Prismatic, 0.1, [0.0, 0.5]));
        assert_eq!((swing.a, swing.alpha), (0.2505, -std::f64::consts::FRAC_PI_2));
        assert!((swing.beta - 0.017_453_292_519_943_295).abs() < 1e-17);
        assert_eq!(swing.limits, [-std::f64::consts::PI, std::f64::consts::FRAC_PI_2]);
        assert_eq!(robot.model.kinematics.last_from_flange, Transform::identity());
        assert_eq!(
            (robot.model.actuators, robot.model.statics, robot.target),
            (ActuatorMap::Direct, None, None)
        );
        assert!(robot.visuals.is_empty());
    }

    #[test]
    fn every_mistake_is_named_with_its_line_and_what_was_expected() {
        for (from, to, message, line, help) in [
            ("\"calibrig.robot/1\"", "\"calibrig.robot/2\"", "calibrig.robot/2", 2, "calibrig.robot/1"),
            ("\"two\"", "\" \"", "name is empty", 3, "name"),
            ("\"craig\"", "\"mdh\"", "convention is \"mdh\"", 4, "`craig`"),
            ("a_mm = 0\n", "a = 0\n", "unknown key `a`", 8, "`a_mm`"),
            ("a_mm = 0\n", "", "missing key `a_mm` in [joint]", 5, "unit"),
            ("a_mm = 0\n", "a_mm = \"0\"\n", "joint.a_mm is \"0\"", 8, "a number"),
            ("a_mm = 0\n", "a_mm = nan\n", "a_mm is nan", 8, "finite"),
            ("d_mm = 100\n", "d_mm = -inf\n", "d_mm is -inf", 10, "finite"),
            ("\"prismatic\"", "\"linear\"", "joint.type is \"linear\"", 7, "`prismatic`"),
            ("min_mm", "min_deg", "min_deg of joint \"slide\", which is prismatic", 12, "min_mm"),
            ("max_deg", "max_mm", "max_mm of joint \"swing\", which is revolute", 23, "max_deg"),
            ("max_mm = 500\n", "", "joint \"slide\" has no max_mm", 5, "max_mm"),
            ("max_mm = 500", "max_mm = -1", "max_mm of joint \"slide\" is not above min_mm", 13, "below"),
            ("\"swing\"", "\"slide\"", "a second joint \"slide\"", 15, "own"),
            ("\"swing\"", "\"\"", "name is empty", 15, "name"),
            (
                "max_mm = 500",
                "max_mm = 500\nstiffness_n_per_m = 0",
                "stiffness_n_per_m is 0",
                14,
                "above zero",
            ),
            (
                "max_mm = 500",
                "max_mm = 500\nstiffness_nm_per_rad = 1",
                "which is prismatic",
                14,
                "stiffness_n_per_m",
            ),
            (
                "max_mm = 500",
                "max_mm = 500\nstiffness_n_per_m = 1e6",
                "\"swing\" has no stiffness_nm_per_rad",
                15,
                "every",
            ),
            ("\"direct\"", "\"belt\"", "actuators.kind is \"belt\"", 25, "`direct`"),
            ("\"direct\"", "\"direct\"\noffset_deg = 0", "no loop", 26, "parallelogram"),
            ("\"direct\"", "\"parallelogram\"", "no shoulder", 24, "revolute"),
            ("\"direct\"", "\"parallelogram\"\nshoulder = \"hip\"", "no joint \"hip\"", 26, "slide, swing"),
            (
                "\"direct\"",
                "\"parallelogram\"\nshoulder = \"slide\"",
                "\"slide\" is prismatic",
                26,
                "revolute",
            ),
            (
                "\"direct\"",
                "\"parallelogram\"\nshoulder = \"swing\"\nelbow = \"swing\"\noffset_deg = 0",
                "one joint",
                27,
                "two",
            ),
            (
                "[actuators]",
                "[target]\nx_mm = 1\ny_mm = 2\n[actuators]",
                "missing key `z_mm` in [target]",
                24,
                "unit",
            ),
            (
                "[actuators]",
                "[gravity]\nx_m_per_s2 = 0\ny_m_per_s2 = 0\nz_m_per_s2 = -9.8\n[actuators]",
                "no drive has a stiffness",
                24,
                "every joint",
            ),
            ("[actuators]\nkind = \"direct\"\n", "", "missing key `actuators`", 1, ""),
            ("name = \"two\"", "name = \"two\"\nurdf = \"a.urdf\"", "\"a.urdf\" was not given", 4, "text"),
            ("convention", "convention = = ", "", 4, ""),
        ] {
            let (found, at, expected) = refusal(from, to);
            assert!(found.contains(message), "{to}: {found}");
            assert!(expected.contains(help), "{to}: {expected}");
            assert_eq!(at, line, "{to}: {found}");
        }
        let (found, ..) =
            refusal(&TWO_JOINTS[TWO_JOINTS.find("[[joint]]").unwrap()..TWO_JOINTS.find("[act").unwrap()], "");
        assert!(found.contains("there is no joint"), "{found}");
    }

    #[test]
    fn absent_files_and_folders_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let absent = folder.path().join("robot.toml");
        assert!(load_robot(&absent).unwrap_err().to_string().contains("robot.toml"));
        assert!(load_robot(folder.path()).unwrap_err().to_string().contains("folder"));
        std::fs::write(&absent, TWO_JOINTS.replace("\"craig\"", "\"craig\"\nurdf = \"none.urdf\"")).unwrap();
        let error = load_robot(&absent).unwrap_err().to_string();
        assert!(error.contains("robot.toml:5: urdf: cannot read") && error.contains("none.urdf"), "{error}");
        std::fs::write(&absent, [0x66, 0xff, 0xfe]).unwrap();
        assert!(load_robot(&absent).unwrap_err().to_string().contains("not UTF-8"));
    }

    /// Against the product of the standard link transforms `Rz(theta + q) Tz(d) Tx(a) Rx(alpha)`.
    #[test]
    fn a_standard_table_moves_the_same_flange_as_its_own_product() {
        let table = [
            (89.159, 0.0, 90.0),
            (0.0, -425.0, 0.0),
            (0.0, -392.25, 0.0),
            (109.15, 0.0, 90.0),
            (94.65, 0.0, -90.0),
            (82.3, 0.0, 0.0),
        ];
        let ur5 = load_robot(&model_file("ur5/robot.toml")).expect("the model of the repository");
        let mut rng = stream(3, 0, Stream::AsBuilt);
        for _ in 0..50 {
            let q: Vec<f64> = (0..6).map(|_| rng.random_range(-3.0..3.0)).collect();
            let product = table.iter().zip(&q).fold(Transform::identity(), |product, ((d, a, alpha), q)| {
                let alpha: f64 = *alpha;
                product * rotation_z(*q) * translation(a / 1e3, 0.0, d / 1e3) * rotation_x(alpha.to_radians())
            });
            let found = forward_kinematics(&ur5.model.kinematics, &q);
            assert!((found.to_homogeneous() - product.to_homogeneous()).norm() < 1e-14);
        }
        // A table that ends with a link of its own: 45 mm and a quarter turn behind the last joint.
        let text = TWO_JOINTS.replace("\"craig\"", "\"standard\"").replace("beta_deg = 1\n", "");
        let two = parse(&text).expect("valid").model.kinematics;
        assert_eq!(
            (two.links[0].a, two.links[0].alpha, two.links[1].a, two.links[1].alpha),
            (0.0, 0.0, 0.0, 0.0)
        );
        let expected = translation(0.2505, 0.0, 0.0) * rotation_x(-std::f64::consts::FRAC_PI_2);
        assert_eq!(two.last_from_flange, expected);
        let with_beta = TWO_JOINTS.replace("\"craig\"", "\"standard\"");
        assert!(parse(&with_beta).unwrap_err().to_string().contains("beta_deg"));
    }

    #[test]
    fn the_wam_reaches_its_published_height() {
        let wam = load_robot(&model_file("wam/robot.toml")).expect("the model of the repository");
        // Stretched upwards: 550 + 300 + 60 mm, the two 45 mm offsets cancel.
        let stretched = forward_kinematics(&wam.model.kinematics, &[0.0; 7]).translation.vector;
        assert!((stretched - Vector3::new(0.0, 0.0, 0.91)).norm() < 1e-14, "{stretched}");
    }

    #[test]
    fn the_spray_painter_has_the_published_table_and_contains_the_working_region() {
        let robot = spray_painter();
        let expected = [
            (JointKind::Prismatic, 0.0, 0.0, 0.0),
            (JointKind::Revolute, 0.0, -90.0, 0.626),
            (JointKind::Revolute, 0.25, -90.0, 0.0),
            (JointKind::Revolute, 1.35, 0.0, 0.0),
            (JointKind::Prismatic, 0.246, -90.0, 0.0),
            (JointKind::Revolute, 0.0, 0.0, 0.0),
            (JointKind::Revolute, 0.0, 90.0, 0.0),
        ];
        for (index, (link, (kind, a, alpha, d))) in
            robot.model.kinematics.links.iter().zip(expected).enumerate()
        {
            assert_eq!((link.kind, link.a, link.alpha.to_degrees(), link.d), (kind, a, alpha, d), "{index}");
            assert_eq!((link.theta, link.beta), (0.0, 0.0));
            assert!(link.limits[0] <= CENTRE[index] - HALF_WIDTH[index] + 1e-12, "{index}");
            assert!(link.limits[1] >= CENTRE[index] + HALF_WIDTH[index] - 1e-12, "{index}");
        }
        assert_eq!(
            robot.model.actuators,
            ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.0, linkage: None }
        );
        assert_eq!(robot.target, Some(Vector3::new(0.10, 0.15, 0.20)));
        let statics = robot.model.statics.expect("masses, stiffnesses and gravity");
        let masses: Vec<f64> = statics.bodies.iter().map(|body| body.mass).collect();
        assert_eq!(masses, [800.0, 400.0, 250.0, 150.0, 80.0, 25.0, 15.0]);
        assert_eq!(statics.gravity, Vector3::new(0.0, -9.80665, 0.0));
        assert_eq!(robot.visuals.len(), 8);
        assert!(robot.visuals.iter().all(|shapes| !shapes.is_empty()));
    }

    #[test]
    fn gravity_lowers_the_spray_painters_target_as_its_file_says() {
        let robot = spray_painter();
        let (chain, target) = (&robot.model.kinematics, robot.target.expect("stated"));
        let statics = robot.model.statics.as_ref().expect("stated");
        let deflection = joint_deflections(chain, statics, &CENTRE);
        let lowered_at = |q: &[f64], deflection: &[f64], joints: std::ops::Range<usize>| {
            let bent: Vec<f64> =
                (0..7).map(|i| q[i] + if joints.contains(&i) { deflection[i] } else { 0.0 }).collect();
            target_in_base(chain, q, &target).y - target_in_base(chain, &bent, &target).y
        };
        let lowered = |joints| lowered_at(&CENTRE, &deflection, joints);
        let (all, shoulder, elbow) = (lowered(0..7), lowered(2..3), lowered(3..4));
        eprintln!(
            "droop {:.2} mm: shoulder {:.2} mm, elbow {:.2} mm",
            all * 1e3,
            shoulder * 1e3,
            elbow * 1e3
        );
        assert!((all - STATED_DROOP[0]).abs() < 5e-6, "{all}");
        assert!((shoulder - STATED_DROOP[1]).abs() < 5e-6, "{shoulder}");
        assert!((elbow - STATED_DROOP[2]).abs() < 5e-6, "{elbow}");
        let mut rng = stream(2, 0, Stream::AsBuilt);
        let poses = 500;
        let sum: f64 = (0..poses)
            .map(|_| {
                let q: Vec<f64> =
                    (0..7).map(|i| CENTRE[i] + HALF_WIDTH[i] * rng.random_range(-1.0..1.0)).collect();
                lowered_at(&q, &joint_deflections(chain, statics, &q), 0..7)
            })
            .sum();
        let mean = sum / f64::from(poses);
        eprintln!("mean droop over the working region {:.2} mm", mean * 1e3);
        assert!((12e-3..18e-3).contains(&mean), "{mean}");
    }

    /// What robot.toml says of the droop, m: all drives, the shoulder's, the elbow's.
    const STATED_DROOP: [f64; 3] = [14.95e-3, 4.58e-3, 10.33e-3];

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        #[test]
        fn no_mutation_of_a_robot_file_panics(at in 0usize..900, remove in 0usize..6, insert in "\\PC{0,3}|[\"\\[\\]=.\n-]{0,3}") {
            let mut text: Vec<char> = TWO_JOINTS.chars().collect();
            let at = at.min(text.len());
            let end = (at + remove).min(text.len());
            text.splice(at..end, insert.chars());
            let text: String = text.into_iter().collect();
            if let Err(error) = parse(&text) {
                let drawn = format!("{:?}", miette::Report::new(error));
                prop_assert!(!drawn.is_empty());
            }
        }
    }
}
