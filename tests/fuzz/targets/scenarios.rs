//! Scenario files, as `check` and `identifiability` take them, and the first poses of their sessions.

use std::sync::LazyLock;

use calibrig::files::{Robot, Source, parse_robot};
use calibrig::model::JointKind;
use calibrig::pipeline::{PlantKind, planned, simulate};
use calibrig::scenario::parse_scenario;

use super::choices::Choices;
use super::edit::{Seed, text};

static SCENARIOS: LazyLock<Vec<Seed>> = LazyLock::new(|| {
    let texts = [
        include_str!("../../../scenarios/matched.toml"),
        include_str!("../../../scenarios/session.toml"),
        include_str!("../../../scenarios/paper_floor.toml"),
        include_str!("../../../scenarios/paper.toml"),
    ];
    texts.map(Seed::toml).into()
});
static PAINTER: LazyLock<Robot> = LazyLock::new(|| {
    let robot = Source::new("robot.toml", include_str!("../../../models/spray_painter/robot.toml"));
    let urdf = Source::new("robot.urdf", include_str!("../../../models/spray_painter/robot.urdf"));
    parse_robot(robot, Some(urdf), None).expect("a robot")
});

/// A scenario of the spray painter.
pub fn scenario(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let text = text(choices, &SCENARIOS);
    read_scenario(text, choices);
}

pub fn scenario_files() -> &'static [Seed] {
    &SCENARIOS
}

pub fn read_scenario(text: String, choices: &mut Choices<'_>) {
    let Ok(mut scenario) = parse_scenario(Source::new("scenario.toml", text), PAINTER.clone()) else {
        return;
    };
    let machine = scenario.as_built_for(scenario.seed, 1);
    machine.kinematics.check().expect("a drawn machine is a robot");
    drop(scenario.tracker_for(scenario.seed, 0));
    assert!(scenario.session().duration() >= 0.0);
    for link in &scenario.robot.model.kinematics.links {
        assert!(link.limits[0] <= link.limits[1] || link.kind == JointKind::Prismatic);
    }
    if !choices.one_in(8) {
        return;
    }
    // Sessions take as long as they have poses: of a few, whose planning says the same.
    scenario.identification_poses = scenario.identification_poses.min(3);
    scenario.verification_poses = scenario.verification_poses.min(1);
    scenario.plan.repeats = scenario.plan.repeats.min(2);
    let simulated = match choices.below(2) {
        0 => planned(&scenario).map(|set| vec![set]),
        _ => simulate(&scenario, scenario.seed, 0, PlantKind::Analytic, |_, _| {})
            .map(|simulated| simulated.sets.into_iter().map(|set| set.measurements).collect()),
    };
    for set in simulated.iter().flatten().filter(|set| !set.observations.is_empty()) {
        set.check(scenario.robot.model.kinematics.joint_count()).expect("what is measured is a set");
    }
}
