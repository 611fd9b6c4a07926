//! The same of identified robots, which bend and have terms.

use calibrig_estimation::identification::{Mode, Predictor};
use calibrig_estimation::inverse::{Circumstances, Criterion, InverseKinematics, InverseOptions};
use calibrig_model::Payload;
use calibrig_model::nalgebra::Vector3;

use super::robots::{NAMES, calibrated, goals, is_within, joints, model, off, rigid, tool, trials};

/// Places that the identified robot reaches within the limits, in every mode: found, as its own prediction has it.
#[test]
fn identified_robots_reach_what_they_are_predicted_to_reach() {
    let (mut asked, mut failed) = (0_u32, 0_u32);
    for name in NAMES {
        let (model, tool) = (model(name), tool());
        for mode in [Mode::OnlyCalibration, Mode::WithGravity, Mode::ElastoGeometric, Mode::Extended] {
            if mode.needs_statics() && model.statics.is_none() {
                continue;
            }
            let robot = calibrated(&model, mode);
            let mut predictor = Predictor::new(&robot).expect("a robot");
            let mut inverse = InverseKinematics::of_robot(&robot, tool).expect("a robot");
            let approach = vec![1; model.kinematics.joint_count()];
            let circumstances = Circumstances { approach: approach.clone(), ..Circumstances::default() };
            let options = InverseOptions { circumstances, ..InverseOptions::default() };
            for joints in (0..trials(10, 200)).filter_map(|index| joints(&model, index)) {
                let command = model.actuators.command_from_joints(&joints);
                let mut place = |command: &[f64]| {
                    let pose = calibrig_model::PoseQuery::at(command).approached(&approach);
                    predictor.flange(pose).expect("a pose") * tool.flange_from_tool()
                };
                let here = place(&command);
                for goal in goals(&here) {
                    asked += 1;
                    let Ok(found) = inverse.solve(&goal, &options) else {
                        failed += 1;
                        continue;
                    };
                    let (position, angle) = off(&goal, &place(&found.command));
                    assert!(position <= 2e-9 && angle <= 1e-8, "{name} {mode:?}: {position} {angle}");
                    let (_, joints) = rigid(&model, &found.command, &tool);
                    assert!(is_within(&model, &joints, 1e-9), "{name} {mode:?}: {joints:?}");
                }
            }
        }
    }
    println!("identified robots: {failed} of {asked} unsolved");
    assert!(f64::from(failed) <= 1e-3 * f64::from(asked) + 1.0, "{failed} of {asked}");
}

/// Of all commands that the spray gun's axis leaves, the one with the least deflection bends less than the one nearest to a reference, and the payload
/// counts.
#[test]
fn the_least_deflection_is_less() {
    let model = model("spray_painter");
    let robot = calibrated(&model, Mode::ElastoGeometric);
    let mut inverse = InverseKinematics::of_robot(&robot, tool()).expect("a robot");
    let command = model.actuators.command_from_joints(&[2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77]);
    let goal = goals(&rigid(&model, &command, &tool()).0)[1];
    let payload = Payload {
        name: "gun".to_owned(),
        mass: 10.0,
        centre: Vector3::new(0.0, 0.0, 0.2),
        force: Vector3::zeros(),
    };
    let mut bent = |criterion, payload: Option<Payload>| {
        let circumstances = Circumstances { payload, ..Circumstances::default() };
        let reference = Some(command.clone());
        let options = InverseOptions { criterion, reference, circumstances, ..InverseOptions::default() };
        let found = inverse.solve(&goal, &options).expect("within reach");
        let weighed = Criterion { motion: 0.0, ..Criterion::LEAST_DEFLECTION };
        let options =
            InverseOptions { criterion: weighed, reference: Some(found.command.clone()), ..options };
        (found, inverse.solve(&goal, &options).expect("within reach").criterion)
    };
    let (by_deflection, least) = bent(Criterion::LEAST_DEFLECTION, None);
    let (by_motion, _) = bent(Criterion::LEAST_MOTION, None);
    let (_, loaded) = bent(Criterion::LEAST_DEFLECTION, Some(payload));
    assert!((by_deflection.criterion - least).abs() < 1e-6 * least);
    assert!(loaded > 1.01 * least, "{loaded} {least}");
    assert!(by_motion.command != by_deflection.command);
}

/// Manipulability is the nominal robot's, whose tool is not quite where the identified one's is: its gradient has to be exact there, too, or the search
/// along the self-motion does not end.
#[test]
fn the_manipulability_of_a_robot_that_bends_is_found_least() {
    let model = model("spray_painter");
    let robot = calibrated(&model, Mode::ElastoGeometric);
    let mut inverse = InverseKinematics::of_robot(&robot, tool()).expect("a robot");
    let options = InverseOptions { criterion: Criterion::MANIPULABILITY, ..InverseOptions::default() };
    let (mut found, mut least) = (0, 0);
    for joints in (0..20).filter_map(|index| joints(&model, index)) {
        let goal = goals(&rigid(&model, &model.actuators.command_from_joints(&joints), &tool()).0)[1];
        if let Ok(solution) = inverse.solve(&goal, &options) {
            found += 1;
            least += u32::from(solution.is_least);
        }
    }
    println!("{least} of {found} ended");
    assert!(found >= 15 && 10 * least >= 9 * found, "{least} of {found}");
}
