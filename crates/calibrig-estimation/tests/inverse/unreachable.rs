//! Places that no command reaches, and what is told of them.

use calibrig_estimation::inverse::{
    Goal, InverseError, InverseKinematics, InverseOptions, Tool, Unreachable,
};
use calibrig_model::nalgebra::Vector3;
use calibrig_model::{CalibrationModel, JointKind};

use super::robots::{NAMES, goals, joints, model, rigid, tool, trials};

fn told(inverse: &mut InverseKinematics<'_>, goal: &Goal, options: &InverseOptions) -> Unreachable {
    match inverse.solve(goal, options) {
        Err(InverseError::Unreachable(told)) => *told,
        other => panic!("out of reach: {other:?}"),
    }
}

/// No point of the robot is farther from the start of its chain than this.
fn longest(model: &CalibrationModel, tool: &Tool) -> f64 {
    let link = |link: &calibrig_model::CraigLink| {
        let way = if link.kind == JointKind::Prismatic { link.limits } else { [0.0; 2] };
        link.a.abs() + (link.d + way[0]).abs().max((link.d + way[1]).abs())
    };
    let ends = model.kinematics.last_from_flange.translation.vector.norm()
        + tool.flange_from_tool().translation.vector.norm();
    model.kinematics.links.iter().map(link).sum::<f64>() + ends
}

#[test]
fn places_beyond_the_sum_of_all_lengths_are_told() {
    for name in NAMES {
        let (model, tool) = (model(name), tool());
        let mut inverse = InverseKinematics::new(&model, tool).expect("a robot");
        let options = InverseOptions { starts: 10, ..InverseOptions::default() };
        let reach = longest(&model, &tool);
        let start = model.kinematics.base_from_first.translation.vector;
        for k in 0..trials(12, 200) {
            let towards =
                Vector3::from([1.1, 2.3, 3.7].map(|pace| (pace * k as f64 + 0.4).sin())).normalize();
            let beyond = 0.02 + 0.3 * (k % 5) as f64;
            let place = calibrig_model::geometry::Transform::from_parts(
                (start + (reach + beyond) * towards).into(),
                calibrig_model::nalgebra::Rotation3::identity(),
            );
            for goal in goals(&place) {
                let told = told(&mut inverse, &goal, &options);
                assert!(told.missed.norm() >= beyond || told.missed_angle > 0.0, "{name}: {told}");
                let (there, _) = rigid(&model, &told.command, &tool);
                assert!((goal.position() - there.translation.vector - told.missed).norm() < 1e-9);
            }
        }
    }
}

/// With a rail cut short, what it alone could reach is out of reach: by how much follows from the rail.
#[test]
fn a_rail_that_is_cut_short_is_named_with_what_is_missing() {
    let (whole, tool) = (model("spray_painter"), tool());
    let mut cut = whole.clone();
    cut.kinematics.links[0].limits = [0.0, 0.5];
    let mut inverse = InverseKinematics::new(&cut, tool).expect("a robot");
    // Stretched out along the rail: no other joint brings the tool farther.
    let mut joints: Vec<f64> =
        whole.kinematics.links.iter().map(|l| 0.5 * (l.limits[0] + l.limits[1])).collect();
    joints[0] = 3.7;
    let command = whole.actuators.command_from_joints(&joints);
    let (place, _) = rigid(&whole, &command, &tool);
    let told = told(&mut inverse, &Goal::Pose(place), &InverseOptions::default());
    assert!(told.missed.norm() > 0.05 || told.missed_angle > 0.01, "{told}");
    let limits = told.without_limits.clone().expect("it could be met without limits");
    let rail = limits.iter().find(|limit| limit.joint == 0);
    assert!(rail.is_some_and(|rail| rail.beyond > 0.0 && rail.limit == 0.5), "{limits:?}");
    let text = InverseError::Unreachable(Box::new(told)).to_string();
    assert!(text.contains("beyond its upper limit of 500.000 mm"), "{text}");
}

/// A robot of two links by hand: a circle of 1 m about an axis at (0, 0), then another of 1 m. Narrowed to the half plane y > 0 the place
/// (0, -2) is missed, and the joint passes its limit by exactly 90 degrees.
#[test]
fn the_way_beyond_a_limit_by_hand() {
    let quarter = std::f64::consts::FRAC_PI_2;
    let model = CalibrationModel::new(vec![
        calibrig_model::CraigLink::revolute("shoulder").row(0.0, 0.0, 0.0, 0.0).limits(0.0, 2.0 * quarter),
        calibrig_model::CraigLink::revolute("elbow").row(1.0, 0.0, 0.0, 0.0).limits(-0.2, 0.2),
    ])
    .expect("a robot");
    let mut inverse =
        InverseKinematics::new(&model, Tool::at(Vector3::x()).expect("a tool")).expect("a robot");
    let goal = Goal::Position(Vector3::new(0.0, -2.0, 0.0));
    let told = told(&mut inverse, &goal, &InverseOptions::default());
    let limits = told.without_limits.expect("it could be met without limits");
    assert_eq!((limits.len(), limits[0].joint), (1, 0), "{limits:?}");
    // At -90 or 270 degrees: 90 beyond either end. The stretched arm is singular there, so that the angle is told to the root of the tolerance.
    assert!((limits[0].beyond - quarter).abs() < 1e-4, "{limits:?}");
}

#[test]
fn what_cannot_be_asked_is_refused_by_name() {
    let mut inverse = InverseKinematics::new(&model("wam"), tool()).expect("a robot");
    let mut refused = |goal: Goal, options: InverseOptions, text: &str| {
        let error = inverse.solve(&goal, &options).expect_err(text).to_string();
        assert!(error.contains(text), "{error}");
    };
    let (here, plain) = (Vector3::new(0.3, 0.0, 0.5), InverseOptions::default);
    refused(Goal::Position(Vector3::new(f64::NAN, 0.0, 0.0)), plain(), "position of the goal");
    refused(
        Goal::Axis { position: here, direction: Vector3::zeros() },
        plain(),
        "direction of the goal has length 0",
    );
    refused(Goal::Position(here), InverseOptions { tolerance: 0.0, ..plain() }, "tolerance is 0");
    refused(Goal::Position(here), InverseOptions { lever: Some(-1.0), ..plain() }, "lever is -1");
    refused(
        Goal::Position(here),
        InverseOptions { reference: Some(vec![0.0; 3]), ..plain() },
        "command has 3 entries",
    );
    let mut criterion = calibrig_estimation::inverse::Criterion::NONE;
    criterion.motion = -1.0;
    refused(Goal::Position(here), InverseOptions { criterion, ..plain() }, "motion is -1");
    assert!(Tool::at(Vector3::new(f64::INFINITY, 0.0, 0.0)).is_err());
    assert!(tool().with_axis(Vector3::zeros()).is_err());
}

/// Poses of the narrowed robot's neighbours: each is found by the wide robot, and the narrow one never says that it reached what it did not.
#[test]
fn nothing_is_silently_wrong_with_narrow_limits() {
    let (wide, tool) = (model("iiwa14"), tool());
    let mut narrow = wide.clone();
    for link in &mut narrow.kinematics.links {
        link.limits = link.limits.map(|limit| 0.3 * limit);
    }
    let mut inverse = InverseKinematics::new(&narrow, tool).expect("a robot");
    let options = InverseOptions { starts: 20, ..InverseOptions::default() };
    let mut missed = 0;
    for joints in (0..trials(60, 1000)).filter_map(|index| joints(&wide, index)) {
        let (place, _) = rigid(&wide, &wide.actuators.command_from_joints(&joints), &tool);
        match inverse.solve(&Goal::Pose(place), &options) {
            Ok(found) => {
                let (there, joints) = rigid(&narrow, &found.command, &tool);
                assert!((there.translation.vector - place.translation.vector).norm() < 1e-9);
                assert!(super::robots::is_within(&narrow, &joints, 1e-9));
            }
            Err(InverseError::Unreachable(told)) => {
                assert!(told.missed.norm() > 1e-9 || told.missed_angle > 1e-9, "{told}");
                let passed = told.without_limits.as_ref().expect("the wide robot reaches it");
                assert!(!passed.is_empty(), "{told}");
                missed += 1;
            }
            Err(other) => panic!("{other}"),
        }
    }
    assert!(missed > 10, "{missed}");
}
