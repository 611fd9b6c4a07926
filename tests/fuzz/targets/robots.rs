//! Robot files, URDFs and D-H tables, and the robots that are read from them.

use std::sync::LazyLock;

use calibrig::elastostatics::{Deflection, ElasticChain};
use calibrig::files::{Convention, Robot, Source, UrdfOptions, parse_robot, robot_from_dh, robot_from_urdf};
use calibrig::geometry::Transform;
use calibrig::kinematics::{forward_kinematics, joints_from_command, link_frames};
use calibrig::model::JointKind;
use calibrig::nalgebra::Vector3;

use super::choices::Choices;
use super::edit::{Seed, text};
use super::numbers::identify_with;

const PAINTER: &str = include_str!("../../../models/spray_painter/robot.toml");
const PAINTER_URDF: &str = include_str!("../../../models/spray_painter/robot.urdf");
const UR5: &str = include_str!("../../../models/ur5/robot.toml");
const UR5_URDF: &str = include_str!("../../../models/ur5/robot.urdf");
const COLUMNS: &str = include_str!("../../../models/ur5/columns.toml");

static ROBOTS: LazyLock<Vec<Seed>> = LazyLock::new(|| {
    let texts = [include_str!("../seeds/arm.toml"), include_str!("../seeds/robot.toml"), PAINTER, UR5];
    texts.map(Seed::toml).into()
});
static URDFS: LazyLock<Vec<Seed>> = LazyLock::new(|| {
    let texts = [
        include_str!("../../fixtures/urdf/16_careless.urdf"),
        include_str!("../../fixtures/urdf/15_positioner.urdf"),
        include_str!("../../fixtures/urdf/10_scara.urdf"),
        include_str!("../../fixtures/urdf/14_palletizer.urdf"),
        UR5_URDF,
        PAINTER_URDF,
    ];
    texts.map(Seed::xml).into()
});
static TABLES: LazyLock<Vec<Seed>> = LazyLock::new(|| {
    [include_str!("../seeds/craig.csv"), include_str!("../seeds/standard.csv")].map(Seed::table).into()
});

/// `robot.toml` with the files that it names.
pub fn robot(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let text = text(choices, &ROBOTS);
    read_robot(text, choices);
}

pub fn robot_files() -> &'static [Seed] {
    &ROBOTS
}

pub fn read_robot(text: String, choices: &mut Choices<'_>) {
    let names = |key: &str| text.lines().any(|line| line.starts_with(key));
    let is_painter = text.contains("spray painter");
    let urdf =
        names("urdf").then(|| Source::new("robot.urdf", if is_painter { PAINTER_URDF } else { UR5_URDF }));
    let columns = names("columns").then(|| Source::new("columns.toml", COLUMNS));
    if let Ok(robot) = parse_robot(Source::new("robot.toml", text), urdf, columns) {
        use_robot(&robot, choices);
    }
}

/// A URDF: to make a robot of, or beside a robot that names it.
pub fn urdf(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let seeds = if choices.below(3) == 2 { &URDFS[5..] } else { &URDFS[..] };
    let text = text(choices, seeds);
    read_urdf(text, choices);
}

pub fn urdf_files() -> &'static [Seed] {
    &URDFS
}

pub fn read_urdf(text: String, choices: &mut Choices<'_>) {
    let is_painter = text.contains("spray_painter");
    let urdf = Source::new("robot.urdf", text);
    if is_painter && choices.below(2) == 0 {
        if let Ok(robot) = parse_robot(Source::new("robot.toml", PAINTER), Some(urdf), None) {
            use_robot(&robot, choices);
        }
        return;
    }
    let some = |choices: &mut Choices<'_>| choices.one_in(4).then(|| vector(choices));
    let options = UrdfOptions { target: some(choices), gravity: some(choices), ..UrdfOptions::default() };
    if let Ok(made) = robot_from_urdf(&urdf, &options) {
        assert!(made.difference.is_none_or(f64::is_finite), "{:?}", made.difference);
        use_robot(&made.robot, choices);
    }
}

/// A table of Denavit-Hartenberg rows.
pub fn dh(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let convention = *choices.pick(&[Convention::Craig, Convention::Standard]);
    let target = choices.one_in(4).then(|| vector(choices));
    let table = Source::new("table.csv", text(choices, &TABLES));
    if let Ok(made) = robot_from_dh(&table, convention, target) {
        use_robot(&made.robot, choices);
    }
}

fn vector(choices: &mut Choices<'_>) -> Vector3<f64> {
    Vector3::from_fn(|_, _| choices.number())
}

/// A robot that a file described is one, and what is computed of it is finite or an error.
fn use_robot(robot: &Robot, choices: &mut Choices<'_>) {
    let model = &robot.model;
    model.check().expect("what is read is a robot");
    let links = &model.kinematics.links;
    let within = |link: &calibrig::model::CraigLink| {
        let far = if link.kind == JointKind::Revolute { 7.0 } else { 1e3 };
        let [low, high] = link.limits.map(|limit| limit.clamp(-far, far));
        low + choices.fraction() * (high - low)
    };
    let q: Vec<f64> = links.iter().map(within).collect();
    let command = model.actuators.command_from_joints(&q);
    if let Ok(frame) = forward_kinematics(&model.kinematics, &q) {
        assert!(is_finite(&frame), "{frame:?} at {q:?}");
    }
    if let Ok(frames) = link_frames(&model.kinematics, &q) {
        assert!(frames.iter().all(is_finite), "{frames:?} at {q:?}");
    }
    let mut joints = vec![0.0; links.len()];
    if joints_from_command(&model.kinematics, &model.actuators, &command, &mut joints).is_ok() {
        assert!(joints.iter().all(|joint| joint.is_finite()), "{joints:?} of {command:?}");
    }
    if let Ok(mut chain) = ElasticChain::new(model)
        && let Ok(settled) = chain.settle(&command, &[], Deflection::Equilibrium)
    {
        assert!(settled.residual.is_finite(), "{settled:?}");
        assert!(is_finite(chain.base_from_flange()), "{:?}", chain.base_from_flange());
    }
    if choices.one_in(16) && links.len() <= 8 {
        identify_with(model, choices);
    }
}

fn is_finite(frame: &Transform) -> bool {
    frame.rotation.matrix().iter().chain(frame.translation.vector.iter()).all(|number| number.is_finite())
}
