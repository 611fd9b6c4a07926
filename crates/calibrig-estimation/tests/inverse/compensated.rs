//! Corrected commands: points, paths and grids of identified robots.

use calibrig_estimation::compensation::{
    CompensationError, Compensator, GridPlan, PathError, PathOptions, PathPoint, PointStatus, Raster,
    ToolPath,
};
use calibrig_estimation::identification::{
    CalibratedRobot, IdentificationOptions, Mode, Predictor, identify,
};
use calibrig_estimation::inverse::{Circumstances, Criterion, Goal, InverseOptions, Tool};
use calibrig_model::PoseQuery;
use calibrig_model::measurement::{MeasurementSet, Motion};
use calibrig_model::nalgebra::Vector3;

use super::robots::{NAMES, calibrated, goals, joints, model, off, rigid, tool, trials, wave};

/// In the middle of the spray painter's working region.
const MIDDLE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];

fn spray_painter(mode: Mode) -> (CalibratedRobot, Vec<f64>) {
    let model = model("spray_painter");
    let command = model.actuators.command_from_joints(&MIDDLE);
    (calibrated(&model, mode), command)
}

/// A panel in front of the tool where the middle pose has it: 1 m high, rows along the rail.
fn panel(robot: &CalibratedRobot, command: &[f64], size: [f64; 2], pitch: f64, spacing: f64) -> Vec<Goal> {
    let (place, _) = rigid(&robot.nominal, command, &tool());
    let gun = place.rotation * Vector3::z();
    let along = (Vector3::z() - gun * gun.z).normalize();
    let up = gun.cross(&along);
    let centre = place.translation.vector + 0.2 * gun;
    let corner = |x: f64, y: f64| centre + x * size[0] * along - y * size[1] * up;
    let corners = [corner(-0.5, -0.5), corner(0.5, -0.5), corner(0.5, 0.5), corner(-0.5, 0.5)];
    let raster = Raster { corners, pitch, spacing, standoff: 0.2 };
    raster.goals().expect("a panel")
}

/// Every mode of every robot: the identified robot is predicted to be within a micrometre, where the nominal command misses by far more.
#[test]
fn corrected_commands_close_to_a_micrometre() {
    let (mut asked, mut out) = (0, 0);
    for name in NAMES {
        let (model, tool) = (model(name), tool());
        for mode in [Mode::OnlyCalibration, Mode::WithGravity, Mode::Extended] {
            if mode.needs_statics() && model.statics.is_none() {
                continue;
            }
            let robot = calibrated(&model, mode);
            let mut predictor = Predictor::new(&robot).expect("a robot");
            let mut compensator = Compensator::new(&robot, tool).expect("a robot");
            for joints in (0..trials(8, 200)).filter_map(|index| joints(&model, index)) {
                let (place, _) = rigid(&model, &model.actuators.command_from_joints(&joints), &tool);
                // What has fewer joints than a goal has rows reaches it by chance alone.
                let commanded = (0..joints.len()).filter(|axis| model.actuators.is_commanded(*axis)).count();
                for goal in goals(&place).into_iter().filter(|goal| goal.rows() <= commanded) {
                    asked += 1;
                    match compensator.point(&goal, &InverseOptions::default()) {
                        Ok(point) => {
                            let there =
                                predictor.flange(&point.command).expect("a pose") * tool.flange_from_tool();
                            let (position, angle) = off(&goal, &there);
                            assert!(position < 1e-6 && angle < 1e-6, "{name} {mode:?}: {position} {angle}");
                            assert!(
                                point.missed() < 1e-6 && point.uncompensated.norm() > 1e-5,
                                "{name}: {point:?}"
                            );
                        }
                        // At the edge of what the robot can do the identified one may not reach what the nominal one does.
                        Err(CompensationError::OutOfCorrection(told)) => {
                            assert!(told.missed.norm() < 0.1, "{name}: {told}");
                            out += 1;
                        }
                        Err(other) => panic!("{name}: {other}"),
                    }
                }
            }
        }
    }
    println!("{out} of {asked} places are out of reach of the identified robot alone");
    assert!(10 * out < asked, "{out} of {asked}");
}

/// A raster with every term: each command alone gives the place, from the side from which the commands themselves come; no joint jumps, and the steps change
/// as little as those of the nominal path.
#[test]
fn a_raster_is_followed_smoothly_and_from_the_right_side() {
    let (robot, command) = spray_painter(Mode::Extended);
    let points = usize::try_from(trials(600, 10_000)).expect("small");
    let mut goals = panel(&robot, &command, [1.2, 0.8], 0.1, 10.0 / points as f64);
    goals.truncate(points);
    let path = ToolPath::at_speed(&goals, 0.3).expect("a path");
    let mut compensator = Compensator::new(&robot, tool()).expect("a robot");
    let inverse = InverseOptions {
        criterion: Criterion { limits: 1.0, ..Criterion::NONE },
        reference: Some(command),
        ..InverseOptions::default()
    };
    let options = PathOptions { inverse, ..PathOptions::default() };
    let followed = compensator.path(&path, &options).expect("a path");
    assert!(
        followed.is_whole(),
        "{:?}",
        followed.points.iter().find(|p| !matches!(p.status, PointStatus::Met(_)))
    );

    let mut predictor = Predictor::new(&robot).expect("a robot");
    let mut motion: Option<Motion> = None;
    let (mut worst, mut before) = (0.0_f64, 0.0_f64);
    for report in &followed.points {
        let point = report.point().expect("met");
        let approach = match &mut motion {
            Some(motion) => {
                motion.go_to(&point.command, 1e-7);
                motion.clone()
            }
            None => motion.insert(Motion::at(&point.command)).clone(),
        };
        let mut pose =
            PoseQuery::at(&point.command).approached(&approach.approach).moved(&approach.since_reversal);
        pose.time = report.asked.time;
        let there = predictor.flange(pose).expect("a pose") * tool().flange_from_tool();
        let (position, angle) = off(&report.asked.goal, &there);
        assert!(report.wavers || (position < 1e-6 && angle < 1e-6), "{position} {angle}");
        worst = worst.max(position);
        before = before.max(point.uncompensated.norm());
    }
    let wavering = followed.points.iter().filter(|report| report.wavers).count();
    let list = |which: fn(&calibrig_estimation::compensation::CompensatedPoint) -> &Vec<f64>| {
        followed.points.iter().map(|report| which(report.point().expect("met")).clone()).collect::<Vec<_>>()
    };
    let (nominal, corrected) = (list(|p| &p.nominal), list(|p| &p.command));
    let longest = |commands: &[Vec<f64>]| {
        let steps = commands
            .windows(2)
            .flat_map(|w| w[0].iter().zip(&w[1]).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>());
        steps.fold(0.0, f64::max)
    };
    println!(
        "{} points: {:.2e} m left of up to {:.2} mm; longest step {:.2e}, of the nominal path {:.2e} m or rad; {wavering} waver",
        points,
        worst,
        1e3 * before,
        longest(&corrected),
        longest(&nominal)
    );
    // Two hysteresis amplitudes of at most 0.3 mrad beside the nominal steps, at a reversal.
    assert!(longest(&corrected) < longest(&nominal) + 2e-3, "{} {}", longest(&corrected), longest(&nominal));
    assert!(wavering * 20 < points, "{wavering}");
}

/// Without terms that change sides, second differences are those of the nominal path and what the deflection adds: no jitter.
#[test]
fn without_hysteresis_the_corrected_path_is_as_smooth_as_the_nominal_one() {
    let (robot, command) = spray_painter(Mode::ElastoGeometric);
    let goals = panel(&robot, &command, [1.0, 0.1], 0.2, 5e-3);
    let path = ToolPath::at_speed(&goals[..200], 0.3).expect("a path");
    let mut compensator = Compensator::new(&robot, tool()).expect("a robot");
    let inverse = InverseOptions { reference: Some(command), ..InverseOptions::default() };
    let followed =
        compensator.path(&path, &PathOptions { inverse, ..PathOptions::default() }).expect("a path");
    assert!(followed.is_whole());
    let bend = |which: fn(&calibrig_estimation::compensation::CompensatedPoint) -> &Vec<f64>| {
        let commands: Vec<_> =
            followed.points.iter().map(|r| which(r.point().expect("met")).clone()).collect();
        let second =
            |w: &[Vec<f64>]| (0..7).map(|a| (w[0][a] - 2.0 * w[1][a] + w[2][a]).abs()).fold(0.0, f64::max);
        commands.windows(3).map(second).fold(0.0, f64::max)
    };
    let (nominal, corrected) = (bend(|p| &p.nominal), bend(|p| &p.command));
    println!("largest second difference {corrected:.2e}, of the nominal path {nominal:.2e} m or rad");
    assert!(corrected < 1.2 * nominal + 1e-7, "{corrected} {nominal}");
}

/// A rail that is too slow is named with what is missing; and the way of it is cut by the redundancy where that can.
#[test]
fn a_step_that_is_too_fast_names_the_actuator() {
    let (robot, command) = spray_painter(Mode::ElastoGeometric);
    let goals = panel(&robot, &command, [1.0, 0.1], 0.2, 0.02);
    let path = ToolPath::at_speed(&goals[..40], 1.0).expect("a path");
    let mut compensator = Compensator::new(&robot, tool()).expect("a robot");
    let inverse = InverseOptions { reference: Some(command), ..InverseOptions::default() };
    let mut follow = |limit: f64| {
        let speed_limits = vec![limit; 7];
        let options = PathOptions { inverse: inverse.clone(), speed_limits, ..PathOptions::default() };
        compensator.path(&path, &options).expect("a path")
    };
    assert!(follow(20.0).is_whole());
    let slow = follow(0.01);
    assert!(!slow.is_whole() && slow.points.iter().all(|report| report.point().is_some()));
    let first = &slow.exceeded[0];
    assert!(first.speed > first.limit && first.limit == 0.01, "{first:?}");
    let text = first.to_string();
    assert!(text.contains(&first.name) && text.contains("above its limit"), "{text}");
}

#[test]
fn points_out_of_reach_are_marked_and_the_rest_is_kept() {
    let (robot, command) = spray_painter(Mode::ElastoGeometric);
    let mut goals = panel(&robot, &command, [0.4, 0.1], 0.2, 0.02);
    goals.truncate(20);
    goals[7] = goals[7].moved_to(Vector3::new(30.0, 0.0, 0.0));
    let path = ToolPath::at_speed(&goals, 0.5).expect("a path");
    let mut compensator = Compensator::new(&robot, tool()).expect("a robot");
    let inverse = InverseOptions { reference: Some(command), starts: 5, ..InverseOptions::default() };
    let followed =
        compensator.path(&path, &PathOptions { inverse, ..PathOptions::default() }).expect("a path");
    assert!(!followed.is_whole());
    for (index, report) in followed.points.iter().enumerate() {
        assert_eq!(report.point().is_none(), index == 7, "{index}");
        if let PointStatus::Unreachable(told) = &report.status {
            assert!(told.missed.norm() > 10.0 && told.to_string().contains("misses it by"), "{told}");
        }
    }
}

#[test]
fn paths_that_cannot_be_are_refused_by_point() {
    let at = |x: f64| Goal::Position(Vector3::new(x, 0.0, 0.0));
    let told = |goals: &[Goal], speed| ToolPath::at_speed(goals, speed).expect_err("no path").to_string();
    assert_eq!(ToolPath::timed(Vec::new()), Err(PathError::NoPoints));
    assert!(
        told(&[at(0.0), at(f64::NAN)], 1.0)
            .starts_with("point 2 of the path: the position of the goal is (NaN")
    );
    assert_eq!(
        told(&[at(0.0), at(0.1), at(0.1)], 1.0),
        "point 3 of the path is at the same place as point 2: leave one of them out"
    );
    assert!(told(&[at(0.0), at(1.0)], 0.0).contains("speed of the path is 0 m/s"));
    let axis = Goal::Axis { position: Vector3::x(), direction: Vector3::z() };
    assert!(
        told(&[at(0.0), axis], 1.0)
            .starts_with("point 2 of the path has 5 constrained coordinates: expected 3")
    );
    let timed = |times: [f64; 2]| {
        let points = times.iter().zip([0.0, 1.0]).map(|(time, x)| PathPoint { goal: at(x), time: *time });
        ToolPath::timed(points.collect()).expect_err("no path").to_string()
    };
    assert!(timed([1.0, 1.0]).starts_with("point 2 of the path is at 1 s"));
    assert!(timed([0.0, f64::NAN]).starts_with("point 2 of the path is at NaN s"));

    let (robot, _) = spray_painter(Mode::ElastoGeometric);
    let mut compensator = Compensator::new(&robot, tool()).expect("a robot");
    let path = ToolPath::at_speed(&[at(2.0), at(2.1)], 1.0).expect("a path");
    let mut refused = |speed_limits: Vec<f64>| {
        let options = PathOptions { speed_limits, ..PathOptions::default() };
        compensator.path(&path, &options).expect_err("no limits").to_string()
    };
    assert!(refused(vec![1.0; 3]).contains("speed limits has 3 entries: expected 7"));
    assert!(refused(vec![1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0]).contains("speed limit of actuator 2 is 0"));
}

/// Offsets close at the points of the grid by themselves; between them what is left is stated from middles that no offset was made for, and falls with the
/// square of the mesh.
#[test]
fn a_grid_of_offsets_states_what_lies_between() {
    let (robot, command) = spray_painter(Mode::ElastoGeometric);
    let (place, _) = rigid(&robot.nominal, &command, &tool());
    let centre = place.translation.vector;
    let half = Vector3::new(0.2, 0.2, 0.2);
    let mut compensator = Compensator::new(&robot, tool()).expect("a robot");
    let options = InverseOptions {
        criterion: Criterion::LEAST_MOTION,
        reference: Some(command.clone()),
        ..InverseOptions::default()
    };
    let mut grid = |count: usize| {
        let held = Goal::Axis { position: centre, direction: place.rotation * Vector3::z() };
        let plan = GridPlan { low: centre - half, high: centre + half, counts: [count; 3], held };
        compensator.grid(&plan, &options).expect("a grid")
    };
    let (coarse, fine) = (grid(2), grid(3));
    println!(
        "uncorrected {:.3} mm at most; left {:.4} mm at most with 2, {:.4} with 3 points an axis; turned by {:.2e} rad",
        1e3 * fine.uncorrected.max,
        1e3 * coarse.interpolated.max,
        1e3 * fine.interpolated.max,
        fine.turned
    );
    assert_eq!((coarse.interpolated.points, fine.interpolated.points), (1, 8));
    assert!(fine.uncorrected.max > 1e-3 && fine.interpolated.max < 0.1 * fine.uncorrected.max);
    assert!(
        fine.interpolated.max < 0.6 * coarse.interpolated.max,
        "{:?} {:?}",
        fine.interpolated,
        coarse.interpolated
    );
    // At a corner, checked apart: the rigid robot's command for place + offset puts the identified robot at the place.
    let corner = fine.plan.low;
    let offset = fine.offset(&corner).expect("in the box");
    let mut nominal =
        calibrig_estimation::inverse::InverseKinematics::new(&robot.nominal, tool()).expect("a robot");
    let told = nominal.solve(&fine.plan.held.moved_to(corner + offset), &options).expect("within reach");
    let there = Predictor::new(&robot).expect("a robot").flange(&told.command).expect("a pose")
        * tool().flange_from_tool();
    assert!((there.translation.vector - corner).norm() < 1e-7, "{there} {corner}");
    assert!(fine.offset(&(corner - Vector3::x())).is_none());

    let mut refused = |change: &dyn Fn(&mut GridPlan)| {
        let mut plan = fine.plan.clone();
        change(&mut plan);
        compensator.grid(&plan, &options).expect_err("no grid").to_string()
    };
    assert!(refused(&|plan| plan.counts[1] = 1).starts_with("the grid has 1 points along y: expected 2 to"));
    assert!(refused(&|plan| plan.high.z = plan.low.z).contains("along z"));
    assert!(refused(&|plan| plan.low.x = f64::NAN).contains("along x"));
}

/// An estimate from exact measurements at 40 poses: the corrected point's standard deviation is that of the estimate's own prediction there, and grows
/// with the noise.
#[test]
fn a_corrected_point_says_how_far_it_is_to_be_trusted() {
    let model = model("irb120");
    let in_flange = Vector3::new(0.1, 0.05, 0.2);
    let tool = Tool::at(in_flange).expect("a tool");
    let measured = |sigma: f64| {
        let pose = |(k, joints): (usize, Vec<f64>)| {
            let command = model.actuators.command_from_joints(&joints);
            let (place, _) = rigid(&model, &command, &tool);
            let error = Vector3::new(wave(k, 5.3), wave(k, 6.1), wave(k, 7.7)) * sigma;
            (command, place.translation.vector + error)
        };
        let poses: Vec<_> = (0..60).filter_map(|index| joints(&model, index)).enumerate().map(pose).collect();
        let mut set = MeasurementSet::of_points(poses).with_sigma(sigma);
        set.targets[0].in_flange = in_flange;
        set
    };
    let options = IdentificationOptions { mode: Mode::OnlyCalibration, ..IdentificationOptions::default() };
    let sigma = |noise: f64| {
        let estimate = identify(&model, &measured(noise), &options).expect("an estimate");
        let mut compensator = Compensator::of_estimate(&estimate, tool).expect("an estimate");
        let joints = joints(&model, 70).expect("within");
        let (place, _) = rigid(&model, &model.actuators.command_from_joints(&joints), &tool);
        let goal = Goal::Position(place.translation.vector);
        let circumstances = Circumstances::default();
        let point = compensator
            .point(&goal, &InverseOptions { circumstances, ..InverseOptions::default() })
            .expect("reach");
        let predicted = estimate.predict(&point.command).expect("a pose");
        (point.sigma().expect("a covariance"), predicted.sigma().expect("a covariance"))
    };
    let ((small, own), (large, _)) = (sigma(10e-6), sigma(40e-6));
    assert!(small.min() > 0.0 && (large.norm() / small.norm() - 4.0).abs() < 1.5, "{small} {large}");
    // The tool is taken as exact where the estimate's own target is identified with the rest.
    assert!(small.norm() < 3.0 * own.norm() && own.norm() < 10.0 * small.norm(), "{small} {own}");
}
