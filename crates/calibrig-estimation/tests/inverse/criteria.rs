//! What decides between the commands for one place, against brute force over the self-motion.

use calibrig_estimation::elastostatics::{Deflection, ElasticChain};
use calibrig_estimation::inverse::{Criterion, Goal, InverseKinematics, InverseOptions, InverseSolution};
use calibrig_model::CalibrationModel;
use calibrig_model::geometry::rotation_vector;
use calibrig_model::nalgebra::Vector3;

use super::robots::{goals, is_within, joints, model, off, rigid, tool};

/// A place in the working region of the spray painter.
fn goal(model: &CalibrationModel) -> Goal {
    let command = model.actuators.command_from_joints(&[2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77]);
    goals(&rigid(model, &command, &tool()).0)[1]
}

/// The parts of a criterion, computed apart from it.
fn parts(model: &CalibrationModel, command: &[f64], reference: &[f64]) -> [f64; 3] {
    let (_, joints) = rigid(model, command, &tool());
    let mean = |centre: &dyn Fn(usize) -> f64| {
        let of = |joint: usize| {
            let [low, high] = model.kinematics.links[joint].limits;
            ((joints[joint] - centre(joint)) / (0.5 * (high - low))).powi(2)
        };
        (0..joints.len()).map(of).sum::<f64>() / joints.len() as f64
    };
    let middle = |joint: usize| {
        let [low, high] = model.kinematics.links[joint].limits;
        0.5 * (low + high)
    };
    let mut chain = ElasticChain::new(model).expect("a robot");
    let in_flange = tool().flange_from_tool().translation.vector;
    let mut at = |deflection| {
        chain.settle(command, &[], deflection).expect("rest");
        chain.target(&in_flange)
    };
    let bent: Vector3<f64> = at(Deflection::Equilibrium) - at(Deflection::None);
    [1e6 * bent.norm_squared(), mean(&middle), mean(&|joint| reference[joint])]
}

fn least(
    model: &CalibrationModel,
    goal: &Goal,
    criterion: Criterion,
    reference: Option<Vec<f64>>,
) -> InverseSolution {
    let mut inverse = InverseKinematics::new(model, tool()).expect("a robot");
    let options = InverseOptions { criterion, reference, ..InverseOptions::default() };
    inverse.solve(goal, &options).expect("within reach")
}

/// The self-motion of a spray task has two dimensions: rail and telescope are moved over a fine grid about the solution, the other joints follow by the
/// inverse kinematics of a robot whose rail and telescope are held. None of these poses is better.
#[test]
fn no_pose_of_the_self_motion_around_is_better() {
    let model = model("spray_painter");
    let goal = goal(&model);
    let reference = [2.3, 0.1, -1.6, 0.2, 1.9, 0.3, -0.5];
    let command = model.actuators.command_from_joints(&reference);
    for criterion in [
        Criterion::LEAST_DEFLECTION,
        Criterion::FAR_FROM_LIMITS,
        Criterion::LEAST_MOTION,
        Criterion { deflection: 0.02, limits: 0.5, motion: 1.0, ..Criterion::NONE },
    ] {
        let found = least(&model, &goal, criterion, Some(command.clone()));
        assert!(found.is_least, "{criterion:?}: {found:?}");
        let value = |command: &[f64]| {
            let [deflection, limits, motion] = parts(&model, command, &reference);
            criterion.deflection * deflection + criterion.limits * limits + criterion.motion * motion
        };
        let own = value(&found.command);
        assert!(
            (own - found.criterion).abs() <= 1e-9 * (1.0 + own),
            "{criterion:?}: {own} {}",
            found.criterion
        );
        let (mut compared, mut worst) = (0, f64::INFINITY);
        for (rail, telescope) in (-6..=6).flat_map(|i| (-6..=6).map(move |j| (i, j))) {
            for size in [0.02, 0.002] {
                let mut held = model.clone();
                for (joint, by) in [(0, rail), (4, telescope)] {
                    let [low, high] = held.kinematics.links[joint].limits;
                    let at = (found.joints[joint] + size * f64::from(by)).clamp(low, high);
                    held.kinematics.links[joint].limits = [at, at];
                }
                let mut inverse = InverseKinematics::new(&held, tool()).expect("a robot");
                let near = InverseOptions {
                    criterion: Criterion::NONE,
                    reference: Some(held_command(&held, &found)),
                    starts: 0,
                    ..InverseOptions::default()
                };
                let Ok(other) = inverse.solve(&goal, &near) else { continue };
                let (_, joints) = rigid(&model, &other.command, &tool());
                let far = joints.iter().zip(&found.joints).any(|(a, b)| (a - b).abs() > 0.6);
                if far || !is_within(&model, &joints, 1e-9) {
                    continue;
                }
                compared += 1;
                worst = worst.min(value(&other.command) - own);
            }
        }
        println!(
            "{criterion:?}: {own:.6}, {compared} others, the best of them {worst:+.1e}; at limits: {:?}",
            found.limits
        );
        assert!(compared > 50, "{criterion:?}: {compared}");
        assert!(worst > -1e-8 * (1.0 + own), "{criterion:?}: {worst}");
    }
}

fn held_command(held: &CalibrationModel, found: &InverseSolution) -> Vec<f64> {
    let links = held.kinematics.links.iter().zip(&found.joints);
    let joints: Vec<f64> = links.map(|(link, q)| q.clamp(link.limits[0], link.limits[1])).collect();
    held.actuators.command_from_joints(&joints)
}

/// Four dimensions, by random steps along the self-motion of a position, and the manipulability computed apart.
#[test]
fn random_steps_along_the_self_motion_are_not_better() {
    use rand::RngExt;
    let model = model("iiwa14");
    let joints = joints(&model, 3).expect("within");
    let place = rigid(&model, &model.actuators.command_from_joints(&joints), &tool()).0;
    for (goal, criterion) in goals(&place).into_iter().flat_map(|goal| {
        let mixed = Criterion { manipulability: 1.0, limits: 0.3, ..Criterion::NONE };
        [Criterion::MANIPULABILITY, Criterion::FAR_FROM_LIMITS, mixed].map(|criterion| (goal, criterion))
    }) {
        let found = least(&model, &goal, criterion, None);
        assert!(found.is_least, "{goal:?} {criterion:?}: {found:?}");
        let value = |command: &[f64]| {
            let [_, limits, _] = parts(&model, command, command);
            let clumsy = clumsiness(&model, command, &goal);
            let manipulability = if criterion.manipulability > 0.0 { clumsy } else { 0.0 };
            criterion.limits * limits + criterion.manipulability * manipulability
        };
        let own = value(&found.command);
        assert!((own - found.criterion).abs() < 1e-6 * (1.0 + own.abs()), "{own} {}", found.criterion);
        let mut inverse = InverseKinematics::new(&model, tool()).expect("a robot");
        let mut rng =
            calibrig_model::random::stream(16, 1, calibrig_model::random::StreamSource::SolverStarts);
        let mut compared = 0;
        for trial in 0..120 {
            let size = [0.1, 0.01][trial % 2];
            let moved = found.command.iter().map(|c| c + size * (2.0 * rng.random::<f64>() - 1.0)).collect();
            let near = InverseOptions {
                criterion: Criterion::NONE,
                reference: Some(moved),
                starts: 0,
                ..InverseOptions::default()
            };
            let Ok(other) = inverse.solve(&goal, &near) else { continue };
            let (there, joints) = rigid(&model, &other.command, &tool());
            assert!(off(&goal, &there).0 < 1e-9 && is_within(&model, &joints, 1e-9));
            if joints.iter().zip(&found.joints).any(|(a, b)| (a - b).abs() > 0.5) {
                continue;
            }
            compared += 1;
            let better = value(&other.command) - own;
            assert!(better > -1e-7, "{goal:?} {criterion:?}: {better}");
        }
        assert!(compared > 50, "{goal:?}: {compared}");
    }
}

/// `-ln sqrt(det J Jᵀ)` from central differences of the forward kinematics.
fn clumsiness(model: &CalibrationModel, command: &[f64], goal: &Goal) -> f64 {
    use calibrig_model::nalgebra::DMatrix;
    let lever = 0.25 * model.kinematics.characteristic_length();
    let (place, _) = rigid(model, command, &tool());
    let mut jacobian = DMatrix::zeros(6, command.len());
    for joint in 0..command.len() {
        let beside = |by: f64| {
            let mut moved = command.to_vec();
            moved[joint] += by;
            rigid(model, &moved, &tool()).0
        };
        let (up, down) = (beside(1e-5), beside(-1e-5));
        let moved = (up.translation.vector - down.translation.vector) / 2e-5;
        let turned = rotation_vector(&(up.rotation * down.rotation.inverse())) / 2e-5;
        jacobian.fixed_view_mut::<3, 1>(0, joint).copy_from(&moved);
        jacobian.fixed_view_mut::<3, 1>(3, joint).copy_from(&(lever * turned));
    }
    let rows = match goal {
        Goal::Position(_) => jacobian.rows(0, 3).into_owned(),
        Goal::Pose(_) => jacobian,
        Goal::Axis { .. } => {
            let (x, y) = (place.rotation * Vector3::x(), place.rotation * Vector3::y());
            let mut rows = jacobian.rows(0, 5).into_owned();
            for (row, across) in [(3, x), (4, y)] {
                rows.set_row(row, &(across.transpose() * jacobian.rows(3, 3)).row(0));
            }
            rows
        }
    };
    -0.5 * (&rows * rows.transpose()).determinant().ln()
}

#[test]
fn a_criterion_is_read_as_it_is_printed() {
    let mixed = Criterion { limits: 0.1, ..Criterion::LEAST_DEFLECTION };
    for (criterion, text) in [
        (Criterion::NONE, "none"),
        (Criterion::LEAST_DEFLECTION, "deflection"),
        (mixed, "deflection,limits=0.1"),
        (Criterion { manipulability: 2.5, ..Criterion::LEAST_MOTION }, "manipulability=2.5,motion"),
    ] {
        assert_eq!(criterion.to_string(), text);
        assert_eq!(text.parse(), Ok(criterion));
    }
    for wrong in [
        "",
        "droop",
        "limits=",
        "limits=-1",
        "limits=0",
        "limits=inf",
        "limits,limits",
        "none,limits",
        "limits=1e999",
    ] {
        let told = wrong.parse::<Criterion>().expect_err(wrong).to_string();
        assert!(told.contains("expected deflection, limits, manipulability or motion"), "{told}");
    }
}
