//! Export of an estimate: a file of its own, the robot in the forms of other programs, and what each form loses against the full model.

mod estimate_file;
mod form;
mod reduced;

use std::fmt::Write;

use nalgebra::Vector3;
use serde::Serialize;
use thiserror::Error;

pub use estimate_file::{
    AnotherModel, EstimateFile, FittedRobot, MadeFrom, Region, RobotSource, model_sha256,
};
pub use reduced::{Loss, Offsets};

use calibrig_estimation::identification::{CalibratedRobot, Mode, PredictionError};
use calibrig_files::{InputError, Robot, RobotText, TargetText, craig_table, standard_table, write_robot};
use calibrig_model::{CalibrationModel, JointKind};
use reduced::{Free, Poses, fit_offsets, rigid, robot_of};

/// Why nothing can be exported.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum HandoverError {
    /// A robot that cannot predict.
    #[error(transparent)]
    Prediction(#[from] PredictionError),
    /// The robot cannot reach most commands of the region.
    #[error(
        "the identified robot can take only {found} of {wanted} poses between the lowest and highest commands of the \
         estimate's region{}",
        .why.as_ref().map_or_else(String::new, |why| format!(" ({why})"))
    )]
    Region {
        /// Poses found.
        found: usize,
        /// Poses wanted.
        wanted: usize,
        /// The last reason.
        why: Option<Box<PredictionError>>,
    },
    /// The fit of offsets gave no finite numbers.
    #[error("the fit of joint and tool offsets did not settle: the region's poses do not determine them")]
    Offsets,
    /// No robot file can hold the robot.
    #[error(transparent)]
    Robot(#[from] InputError),
    /// The estimate cannot be written as text.
    #[error("the estimate cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
}

/// A file of the export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HandedFile {
    /// Its name.
    pub name: &'static str,
    /// Its text.
    pub text: String,
}

/// What a file holds, and what it loses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Kept {
    /// Name of the file.
    pub file: &'static str,
    /// What it holds, in words.
    pub holds: &'static str,
    /// What it lacks, in words.
    pub lacks: &'static str,
    /// Against the full model, in the measured region.
    pub loss: Loss,
}

/// The document `losses.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Losses {
    /// `calibrig.losses/1`.
    pub schema: &'static str,
    /// The mode of the estimate.
    pub mode: &'static str,
    /// Hash of the nominal model, hexadecimal.
    pub model_sha256: String,
    /// Every form, the fullest first.
    pub files: Vec<Kept>,
}

/// Names of all exported files.
pub const FILES: [&str; 7] = [
    "estimate.json",
    "robot.toml",
    "robot.urdf",
    "dh_craig.csv",
    "dh_standard.csv",
    "offsets.csv",
    "losses.json",
];

/// Files with what they lose.
#[derive(Debug, Clone, PartialEq)]
pub struct Handover {
    /// [`FILES`].
    pub files: Vec<HandedFile>,
    /// Their losses.
    pub losses: Losses,
}

/// Makes all files of an estimate. `robot` is the nominal one, if available: its URDF's links, shapes, inertias and limits are kept.
/// [`EstimateFile::check_model`] checks that it is the one that was fitted.
///
/// # Errors
///
/// [`HandoverError`].
pub fn hand_over(estimate: &EstimateFile, robot: Option<&Robot>) -> Result<Handover, HandoverError> {
    let full = &estimate.estimate.robot;
    let remarks = remarks(estimate);
    let names = |index: usize| estimate.targets.get(index).map_or("", String::as_str);
    let target = |(index, in_flange): (usize, &Vector3<f64>)| TargetText {
        name: names(index),
        in_flange: *in_flange,
        rotation: full.orientations.get(index).copied().flatten(),
    };
    let targets: Vec<TargetText<'_>> = full.targets.iter().enumerate().map(target).collect();
    let urdf = robot.and_then(|robot| robot.sources.iter().find(|(role, _)| role == "urdf"));
    let model = believed(full);
    let written = write_robot(&RobotText {
        name: &estimate.robot.name,
        model: &model,
        targets: &targets,
        visuals: robot.map_or(&[][..], |robot| robot.visuals.as_slice()),
        urdf: urdf.map(|(_, source)| source),
        remarks: &remarks,
    })?;
    let poses = Poses::draw(full, &estimate.region)?;
    let read = &written.read.model;
    // A robot read from its file deflects by its own equilibrium.
    let own = if full.mode == Mode::OnlyCalibration { full.mode } else { Mode::Extended };
    let of_file = poses.loss(&robot_of(read, own, full))?;
    let of_chain = poses.loss(&rigid(read, full))?;
    let nominal = &full.nominal;
    let placed = fit_offsets(nominal, full, &poses, Free { joints: false, frame: true })?;
    let offsets = fit_offsets(nominal, full, &poses, Free { joints: true, frame: false })?;
    let framed = fit_offsets(nominal, full, &poses, Free { joints: true, frame: true })?;
    let kept = |file, holds, lacks, loss| Kept { file, holds, lacks, loss };
    let losses = Losses {
        schema: "calibrig.losses/1",
        mode: full.mode.key(),
        model_sha256: estimate.robot.model_sha256.clone(),
        files: vec![
            kept(
                "robot.toml",
                "geometry, stiffnesses, masses, linkage",
                "terms, tracker, covariance",
                of_file,
            ),
            kept("robot.urdf", "the rigid chain", "deflection, terms, lengths of the linkage", of_chain),
            kept("dh_craig.csv", "the rigid chain", "deflection, terms, lengths of the linkage", of_chain),
            kept("dh_standard.csv", "the rigid chain", "deflection, terms, lengths of the linkage", of_chain),
            kept("offsets.csv", "joint offsets, tool and base frame", "all other parameters", framed.loss),
            kept("offsets.csv", "joint offsets and tool", "all other parameters", offsets.loss),
            kept("offsets.csv", "tool and base frame", "all other parameters", placed.loss),
        ],
    };
    let chain = &full.model.kinematics;
    let files = [
        estimate.text()?,
        written.robot.text,
        written.urdf.text,
        craig_table(chain, &with_loss(&remarks, &of_chain)),
        standard_table(chain, &with_loss(&remarks, &of_chain)).text,
        offsets_text(estimate, &with_loss(&remarks, &framed.loss), [&offsets, &framed, &placed]),
        serde_json::to_string_pretty(&losses)? + "\n",
    ];
    let files = FILES.into_iter().zip(files).map(|(name, text)| HandedFile { name, text }).collect();
    Ok(Handover { files, losses })
}

/// The robot as its mode models it: modes that are not coupled have joints where the ideal map has them, whatever the lengths of the rows, and
/// one of these modes has nothing that deflects.
fn believed(robot: &CalibratedRobot) -> CalibrationModel {
    let mut model = robot.model.clone();
    if robot.mode.is_coupled() {
        return model;
    }
    model.actuators = model.actuators.without_linkage();
    model.statics = model.statics.filter(|_| robot.mode == Mode::WithGravity);
    if let Some(statics) = &mut model.statics {
        statics.linkage = None;
    }
    model
}

/// Text at the head of every file.
fn remarks(estimate: &EstimateFile) -> Vec<String> {
    let robot = &estimate.estimate.robot;
    let mut remarks = vec![
        format!("The calibrated robot {}, mode {}, by {}.", estimate.robot.name, robot.mode.key(), estimate.software),
        format!("Nominal model {}.", estimate.robot.model_sha256),
        "The whole estimate is in estimate.json next to this file: only there are terms, tracker and covariance; stiffnesses, \
         masses and the linkage are also in robot.toml. robot.urdf, the tables and the offsets hold nothing elastic."
            .to_owned(),
    ];
    if robot.model.actuators.elbow().is_some() {
        remarks.push(
            "The elbow is driven by a parallelogram: in robot.urdf and the tables it is an ordinary joint, at its motor's \
             command minus the shoulder's. The effect of the real lengths of the four-bar is lost there."
                .to_owned(),
        );
        if !robot.mode.is_coupled() {
            remarks.push(
                "This mode takes the parallelogram to be exact, and so does robot.toml: it has no lengths of the linkage."
                    .to_owned(),
            );
        }
    }
    if robot.targets.len() > 1 {
        remarks.push("Losses and tool offsets are of the first target.".to_owned());
    }
    remarks
}

fn with_loss(remarks: &[String], loss: &Loss) -> Vec<String> {
    let mut said = remarks.to_vec();
    said.push(format!(
        "Against the full model, at {} poses in the measured region: {}.",
        loss.poses,
        told(loss)
    ));
    said
}

fn told(loss: &Loss) -> String {
    let mm = |values: [f64; 3]| values.map(|value| format!("{:.4}", 1e3 * value)).join(" ");
    format!(
        "rms {} mm along x y z, largest {}; in space {:.4} and {:.4} mm",
        mm(loss.rms_m),
        mm(loss.max_m),
        1e3 * loss.rms_3d_m,
        1e3 * loss.max_3d_m
    )
}

/// The table of losses for people.
pub fn losses_text(losses: &Losses) -> String {
    let mut text = "What each file loses against the full model in the measured region, mm (rms x y z, 3-D rms, 3-D largest):\n".to_owned();
    for kept in &losses.files {
        let [x, y, z] = kept.loss.rms_m.map(|value| 1e3 * value);
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "  {:<16} {x:9.4} {y:9.4} {z:9.4}  {:9.4} {:9.4}   {}",
            kept.file,
            1e3 * kept.loss.rms_3d_m,
            1e3 * kept.loss.max_3d_m,
            kept.holds
        );
    }
    text
}

/// Rows of offsets: only joints with the tool, then with the frame, and only frame and tool.
fn offsets_text(
    estimate: &EstimateFile,
    remarks: &[String],
    [alone, framed, placed]: [&Offsets; 3],
) -> String {
    let robot = &estimate.estimate.robot;
    let mut text = String::new();
    for remark in remarks {
        let _ = writeln!(text, "# {}", remark.replace('\n', " "));
    }
    let _ = writeln!(
        text,
        "# Joints: what is added to a command before the nominal kinematics: the nominal robot at command + offset is where"
    );
    let _ = writeln!(
        text,
        "# the real one is at the command. Tool: its place in the nominal flange. Frame: where the nominal robot's base"
    );
    let _ = writeln!(
        text,
        "# is in the base, shifted, then turned about the fixed x, y and z. Take one column, not a mixture of them."
    );
    for (name, offsets) in
        [("joints_and_tool", alone), ("joints_tool_and_frame", framed), ("tool_and_frame", placed)]
    {
        let _ = writeln!(text, "# {name}: {}.", told(&offsets.loss));
    }
    let _ = writeln!(text, "kind,name,unit,joints_and_tool,joints_tool_and_frame,tool_and_frame");
    let columns = [alone, framed, placed];
    for (index, link) in robot.nominal.kinematics.links.iter().enumerate() {
        if !robot.nominal.actuators.is_commanded(index) {
            continue;
        }
        let unit = if link.kind == JointKind::Revolute { "rad" } else { "m" };
        let name = link.name.replace([',', '"', '\n', '\r'], " ");
        let values = columns.map(|offsets| offsets.commands.get(index).copied().unwrap_or_default());
        row(&mut text, "joint", &name, unit, values);
    }
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        row(&mut text, "tool", name, "m", columns.map(|offsets| offsets.tool[axis]));
    }
    let frames = columns.map(|offsets| {
        let place = offsets.base_from_nominal.translation.vector;
        let (roll, pitch, yaw) = offsets.base_from_nominal.rotation.euler_angles();
        [place.x, place.y, place.z, roll, pitch, yaw]
    });
    for (component, (name, unit)) in
        [("x", "m"), ("y", "m"), ("z", "m"), ("roll", "rad"), ("pitch", "rad"), ("yaw", "rad")]
            .into_iter()
            .enumerate()
    {
        row(&mut text, "frame", name, unit, frames.map(|frame| frame[component]));
    }
    text
}

fn row(text: &mut String, kind: &str, name: &str, unit: &str, [a, b, c]: [f64; 3]) {
    let _ = writeln!(text, "{kind},{name},{unit},{a:?},{b:?},{c:?}");
}
