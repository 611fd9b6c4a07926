//! The robots of `models/`, and where random poses of them put a tool.

use std::path::Path;

use calibrig_estimation::identification::{CalibratedRobot, Mode};
use calibrig_estimation::inverse::{Goal, Tool};
use calibrig_estimation::kinematics::{forward_kinematics, joints_from_command};
use calibrig_files::load_robot;
use calibrig_model::geometry::{Transform, rotation_vector, rotation_x, translation};
use calibrig_model::nalgebra::Vector3;
use calibrig_model::random::{StreamSource, stream_at};
use calibrig_model::{CalibrationModel, CraigLink, ParameterId, TermId};
use rand::RngExt;

/// By folder.
pub const NAMES: [&str; 10] = [
    "cobra600",
    "iiwa14",
    "irb120",
    "irb460",
    "irb4600_track",
    "spray_painter",
    "tx2_60l",
    "ur5",
    "wam",
    "youbot",
];

/// A robot by its folder.
pub fn model(name: &str) -> CalibrationModel {
    let path = Path::new("../../models").join(name).join("robot.toml");
    load_robot(&path).unwrap_or_else(|error| panic!("{name}: {error}")).model
}

/// A tool off the flange, turned against it.
pub fn tool() -> Tool {
    Tool::new(translation(0.1, 0.05, 0.2) * rotation_x(0.7)).expect("a tool")
}

/// Joint variables within the limits, or within a turn where there are none, of which the followers follow; `None` where a follower's
/// limits are passed.
pub fn joints(model: &CalibrationModel, index: u64) -> Option<Vec<f64>> {
    let mut rng = stream_at(16, 0, StreamSource::SolverStarts, index);
    let mut draw = |link: &CraigLink| {
        let share = rng.random::<f64>();
        match link.limits {
            [low, high] if low.is_finite() && high.is_finite() => low + share * (high - low),
            _ => std::f64::consts::PI * (2.0 * share - 1.0),
        }
    };
    let mut joints: Vec<f64> = model.kinematics.links.iter().map(&mut draw).collect();
    model.actuators.follow(&mut joints);
    is_within(model, &joints, 0.0).then_some(joints)
}

/// Whether joint variables are within the limits, to so much.
pub fn is_within(model: &CalibrationModel, joints: &[f64], slack: f64) -> bool {
    let within = |(link, q): (&CraigLink, &f64)| *q >= link.limits[0] - slack && *q <= link.limits[1] + slack;
    model.kinematics.links.iter().zip(joints).all(within)
}

/// `base_from_tool` of the rigid nominal robot at a command, and its joint variables.
pub fn rigid(model: &CalibrationModel, command: &[f64], tool: &Tool) -> (Transform, Vec<f64>) {
    let mut joints = vec![0.0; command.len()];
    joints_from_command(&model.kinematics, &model.actuators, command, &mut joints).expect("a command");
    let flange = forward_kinematics(&model.kinematics, &joints).expect("a pose");
    (flange * tool.flange_from_tool(), joints)
}

/// The goal of each kind that is met at a place.
pub fn goals(place: &Transform) -> [Goal; 3] {
    let position = place.translation.vector;
    let direction = place.rotation * Vector3::z();
    [Goal::Position(position), Goal::Axis { position, direction }, Goal::Pose(*place)]
}

/// How far a place is from a goal: m and rad.
pub fn off(goal: &Goal, place: &Transform) -> (f64, f64) {
    let angle = match goal {
        Goal::Position(_) => 0.0,
        Goal::Axis { direction, .. } => (place.rotation * Vector3::z()).cross(&direction.normalize()).norm(),
        Goal::Pose(pose) => rotation_vector(&(pose.rotation * place.rotation.inverse())).norm(),
    };
    ((goal.position() - place.translation.vector).norm(), angle)
}

/// A number of trials: a few, or as many as were asked for with `CALIBRIG_FULL=1`.
pub fn trials(few: u64, full: u64) -> u64 {
    if std::env::var_os("CALIBRIG_FULL").is_some() { full } else { few }
}

/// A number of -1 to 1 for a place in a list.
pub fn wave(k: usize, pace: f64) -> f64 {
    (pace * (k as f64 + 0.3)).sin()
}

/// A robot as an identification could leave it: every link a little off, and terms of every kind.
pub fn calibrated(nominal: &CalibrationModel, mode: Mode) -> CalibratedRobot {
    let mut identified = nominal.clone();
    for (k, id) in ParameterId::all_of_links(nominal.kinematics.joint_count()).into_iter().enumerate() {
        identified.kinematics.add(id, 2e-3 * wave(k, 1.7));
    }
    let keys = ["hysteresis", "harmonic", "ratio", "rail", "spline"];
    let ids = keys.iter().flat_map(|key| TermId::all_of(key, nominal).expect("a family"));
    // More of a wave as short as a motor's turn would let actuators go back while they are told to go on.
    let size = |id: TermId| if id.family().key() == "harmonic" { 2e-5 } else { 3e-4 };
    let terms = ids.enumerate().map(|(k, id)| (id, size(id) * wave(k, 2.9)));
    CalibratedRobot {
        mode,
        nominal: nominal.clone(),
        model: identified,
        terms: if mode == Mode::Extended { terms.collect() } else { Vec::new() },
        stations: Vec::new(),
        targets: vec![Vector3::new(0.1, 0.15, 0.2)],
        instruments: Vec::new(),
        orientations: vec![None],
    }
}
