//! `robot.toml`: the D-H table, limits, drives, bearings, beams, actuators, loads, target and gravity, with their units in the keys.

mod actuators;
mod axes;
mod flexibility;
pub(crate) mod frames;
mod joints;
mod loads;
mod parallel;
mod section;
mod statics;
mod targets;
#[cfg(test)]
pub(crate) mod tests;
mod urdf;
mod urdf_text;
mod urdf_writer;
mod writer;

use std::ops::Range;
use std::path::Path;

use nalgebra::Vector3;
use serde::Deserialize;

pub use loads::{LoadTable, read_loads};
pub use targets::StatedTarget;
pub use urdf::actuator_speeds;
pub use writer::{RobotFiles, RobotText, TargetText, write_robot};

use actuators::ActuatorTable;
use frames::FrameTable;
use joints::JointTable;
use parallel::rewrite_far_normals;
use statics::{CompliancePercent, GravityTable};
use targets::{TargetTables, read_targets};

use crate::input::{InputError, Source, Spanned};
use calibrig_model::{BodyUncertainty, CalibrationModel, KinematicModel, ModelError, Visual};
use urdf::UrdfRobot;

/// The only schema that is read.
const SCHEMA: &str = "calibrig.robot/1";

/// A robot as its files describe it.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Name for people.
    pub name: String,
    /// What identification may know.
    pub model: CalibrationModel,
    /// Shapes to draw, per link (entry 0 is the base, then one per joint); empty without a URDF.
    pub visuals: Vec<Vec<Visual>>,
    /// The targets' places on the flange; empty if unknown.
    pub targets: Vec<StatedTarget>,
    /// Uncertainty of the compliances: standard deviation relative to the stated ones, if the file states it.
    pub compliance_sigma: Option<f64>,
    /// Whether the file states that its stiffnesses are unknown.
    pub stiffness_unknown: bool,
    /// Uncertainty of the bodies' masses and centres, one entry per joint; none if the file does not state it.
    pub bodies: Vec<BodyUncertainty>,
    /// Remarks on the table, in words.
    pub remarks: Vec<String>,
    /// The files read, by role: `robot`, then `urdf` and `columns` if it names them.
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
    #[serde(default)]
    target: TargetTables,
    #[serde(default)]
    load: Vec<Spanned<LoadTable>>,
    gravity: Option<Spanned<GravityTable>>,
    base: Option<Spanned<FrameTable>>,
    flange: Option<Spanned<FrameTable>>,
    compliance_percent: Option<Spanned<CompliancePercent>>,
    mass_percent: Option<Spanned<f64>>,
    centre_mm: Option<Spanned<f64>>,
}

/// Convention of the D-H table.
#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum Convention {
    /// `Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d)`, a row's a and alpha in front of its joint.
    Craig,
    /// `Rz(theta) Tz(d) Tx(a) Rx(alpha)`, a row's a and alpha behind its joint.
    Standard,
}

impl Robot {
    /// Offset of the target in the flange frame, m, of the first one if several are stated; `None` if unknown.
    pub fn target(&self) -> Option<Vector3<f64>> {
        self.targets.first().map(|target| target.in_flange)
    }
}

/// Reads `robot.toml` and the files it names, relative to its own folder.
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
                Some("expected the name of a file, relative to this file".to_owned()),
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
    let mut kinematics = reader.kinematics()?;
    let actuators = reader.axes(reader.actuators(&kinematics)?)?;
    let motor_turns = reader.motor_turns()?;
    let targets = read_targets(&robot, &file.target)?;
    let described = match &urdf {
        Some(text) => {
            let described = UrdfRobot::parse(text)?;
            described.check(text, &kinematics)?;
            Some(described)
        }
        None => None,
    };
    let statics = reader.statics(&kinematics, &actuators, described.as_ref())?;
    let (compliance_sigma, stiffness_unknown) = reader.compliance_sigma()?;
    let bodies = reader.body_uncertainties()?;
    let in_frames = described.is_some() || statics.is_some() || actuators.four_bar().is_some();
    let remarks = reader.near_normals(&mut kinematics, in_frames);
    let model = CalibrationModel { kinematics, actuators, statics, motor_turns, spans: Vec::new() };
    reader.check_whole(&model)?;
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
    Ok(Robot { name, model, visuals, targets, compliance_sigma, stiffness_unknown, bodies, remarks, sources })
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

    /// Each number may be valid but not what follows from all of them: a section's stiffness may underflow.
    fn check_whole(&self, model: &CalibrationModel) -> Result<(), InputError> {
        let Err(fault) = model.check() else { return Ok(()) };
        let joint = match fault {
            ModelError::Beam { link, .. } => Some(link),
            ModelError::Number { joint, .. } => joint,
            ModelError::Limits { joint, .. } => Some(joint),
            _ => None,
        };
        let span = joint.and_then(|joint| self.file.joint.get(joint)).map_or(0..0, Spanned::span);
        self.error(span, fault, "numbers that together describe a robot")
    }

    /// Rewrites rows whose common normals are far away, with a remark; not if other values are stated in the frames of such rows.
    fn near_normals(&self, kinematics: &mut KinematicModel, in_frames: bool) -> Vec<String> {
        let mut near = kinematics.clone();
        let runs = rewrite_far_normals(&mut near);
        let remark = |run: Range<usize>| {
            let links = &kinematics.links[run];
            let names = links.iter().map(|link| link.name.as_str()).collect::<Vec<_>>().join(", ");
            let far = links.iter().map(|link| link.d.abs()).fold(0.0, f64::max);
            let what = format!(
                "{}: the axes of {names} are nearly parallel, so their rows reach {far:.0} m out to the common normals",
                self.source.name
            );
            if in_frames {
                format!(
                    "{what}: these parameters are poorly determined. State the rows with beta_deg and a small d_mm \
                     (convention = \"craig\"); they are not rewritten here, because masses, loads or a URDF refer to their \
                     frames"
                )
            } else {
                format!(
                    "{what}: they are rewritten with beta and a small d, for the same motions; the parameters are those of \
                     the rewritten rows"
                )
            }
        };
        let remarks = runs.into_iter().map(remark).collect();
        if !in_frames {
            *kinematics = near;
        }
        remarks
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
            return self.error(self.file.name.span(), "name is empty", "a name that is not empty");
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
                let message = format!("the file {:?} of {key} was not given", name.get_ref());
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
}
