//! Which parameters of an elbow's four-bar positions tell, against a machine whose loop is closed by bisection.

use std::collections::BTreeSet;

use calibrig_estimation::identification::{
    ComplianceChoice, DependentGroup, FrameChoice, IdentificationOptions, LINKAGE, Mode, ParameterChoice,
    Prospect, Redundancy, TargetChoice, prospect,
};
use calibrig_model::geometry::{Transform, rotation_z, translation};
use calibrig_model::measurement::{MeasurementSet, NestObservation, Reading};
use calibrig_model::nalgebra::{DMatrix, Matrix3, Point3, Vector3};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, JointKind, LinkageTerm, ParameterId};
use rand::RngExt;

use crate::coverage::NOISE;

const TARGET: Vector3<f64> = Vector3::new(0.12, 0.08, 0.15);

/// A shipped robot whose parts do not yield.
fn rigid(name: &str) -> CalibrationModel {
    let path = format!("../../models/{name}/robot.toml");
    let mut model = calibrig_files::load_robot(path.as_ref()).expect("a shipped robot").model;
    model.statics.as_mut().expect("masses").make_rigid();
    model
}

/// Commands of joints in the middle half of their limits.
fn commands(model: &CalibrationModel, count: usize) -> Vec<Vec<f64>> {
    let mut rng = stream(41, 0, StreamSource::IdentificationPoses);
    let links = &model.kinematics.links;
    let drawn = |_| {
        let joints: Vec<f64> = links
            .iter()
            .map(|link| {
                let [low, high] = link.limits;
                0.5 * (low + high) + (high - low) * rng.random_range(-0.25..0.25)
            })
            .collect();
        model.actuators.command_from_joints(&joints)
    };
    (0..count).map(drawn).collect()
}

/// Where the target is, with the elbow turned until the rod is as long as it is: no line of this is the model's own closure.
fn place(model: &CalibrationModel, command: &[f64]) -> Vector3<f64> {
    let (shoulder, elbow, offset, bar) = model.actuators.four_bar().expect("a four-bar");
    let links = &model.kinematics.links;
    let (mut joints, mut positions) = (vec![0.0; links.len()], vec![0.0; links.len()]);
    model.actuators.joints_from_command(command, &mut joints);
    model.actuators.actuators_from_command(command, &mut positions);
    let crank = bar.axis.shoulder_from_axis() * rotation_z(positions[elbow] + offset + links[elbow].theta);
    let crank_end = crank * Point3::from(bar.crank.end());
    let forearm = rotation_z(joints[shoulder]) * links[elbow].fixed_part();
    let too_long = |q: f64| {
        let lever_end = forearm * rotation_z(q) * Point3::from(bar.lever.end());
        (lever_end - crank_end).norm() - bar.rod
    };
    // Of the two ways to close, the one within 0.2 rad of the parallelogram's.
    let [mut low, mut high] = [joints[elbow] - 0.2, joints[elbow] + 0.2];
    let rises = too_long(high) > 0.0;
    assert!(rises != (too_long(low) > 0.0), "one closure between {low} and {high}");
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        *(if (too_long(middle) > 0.0) == rises { &mut high } else { &mut low }) = middle;
    }
    joints[elbow] = 0.5 * (low + high);
    let mut flange = model.kinematics.base_from_first;
    for (link, q) in links.iter().zip(&joints) {
        let moved = match link.kind {
            JointKind::Revolute => rotation_z(*q),
            JointKind::Prismatic => translation(0.0, 0.0, *q),
        };
        flange = flange * link.fixed_part() * moved;
    }
    let flange: Transform = flange * model.kinematics.last_from_flange;
    (flange * Point3::from(TARGET)).coords
}

/// Change of every place per unit of each parameter, by central differences.
fn columns(model: &CalibrationModel, commands: &[Vec<f64>], ids: &[ParameterId]) -> DMatrix<f64> {
    const STEP: f64 = 1e-4;
    let shifted = |id: ParameterId, by: f64| {
        let mut machine = model.clone();
        match id {
            ParameterId::Linkage(term) => {
                *machine.actuators.linkage_mut().expect("a four-bar").term_mut(term) += by;
            }
            _ => machine.kinematics.add(id, by),
        }
        machine
    };
    let mut jacobian = DMatrix::zeros(3 * commands.len(), ids.len());
    for (column, id) in ids.iter().enumerate() {
        let [ahead, behind] = [STEP, -STEP].map(|by| shifted(*id, by));
        for (pose, command) in commands.iter().enumerate() {
            let change = (place(&ahead, command) - place(&behind, command)) / (2.0 * STEP);
            jacobian.fixed_view_mut::<3, 1>(3 * pose, column).copy_from(&change);
        }
    }
    jacobian
}

/// Of columns of one length: how many singular values stand above what differences leave of zero, with the values about that step.
fn rank(jacobian: &DMatrix<f64>) -> (usize, [f64; 2]) {
    let mut even = jacobian.clone();
    for mut column in even.column_iter_mut() {
        let norm = column.norm();
        column.scale_mut(if norm > 1e-7 { norm.recip() } else { 0.0 });
    }
    let mut values: Vec<f64> = even.singular_values().iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    let rank = values.iter().filter(|value| **value > 1e-5).count();
    (rank, [values[rank - 1], values.get(rank).copied().unwrap_or(0.0)])
}

fn foreseen(model: &CalibrationModel, commands: &[Vec<f64>], redundant: Redundancy) -> Prospect {
    let points = commands.iter().map(|command| (command.clone(), place(model, command)));
    let mut set = MeasurementSet::of_points(points.collect::<Vec<_>>()).with_sigma(NOISE);
    set.targets[0].in_flange = TARGET;
    // The tracker is at the base, as three nests say.
    let exact = Matrix3::identity() * 1e-12;
    set.stations[0].nests = [Vector3::zeros(), Vector3::x(), Vector3::y()]
        .map(|in_base| NestObservation {
            name: format!("{in_base}"),
            in_base,
            in_base_covariance: exact,
            reading: Reading::Cartesian { position: in_base, covariance: Some(exact) },
            time: None,
        })
        .into();
    let options = IdentificationOptions {
        mode: Mode::Extended,
        parameters: ParameterChoice::Complete,
        compliances: ComplianceChoice::Listed(Vec::new()),
        terms: Some(vec![LINKAGE.to_owned()]),
        frame: FrameChoice::Fixed,
        target: TargetChoice::Fixed,
        redundant,
        ..IdentificationOptions::default()
    };
    prospect(model, &set, &options).expect("a session")
}

/// The coefficient of a parameter in what a redundant one does.
fn share(groups: &[DependentGroup], redundant: LinkageTerm, with: LinkageTerm) -> Option<f64> {
    let group = groups.iter().find(|group| group.redundant == ParameterId::Linkage(redundant))?;
    group.with.iter().find(|(id, _)| *id == ParameterId::Linkage(with)).map(|(_, share)| *share)
}

/// In a parallelogram the rod lies along the upper arm, and its length tells of the ends what moves along it. So a longer lever does what a shorter
/// crank does; and a tilt of the crank's axis moves the crank's end, which sits `along` that axis, as a displacement of the axis does. Of the seven, four are told: one of
/// the arms, the rod, and the axis along x and y.
#[test]
fn of_the_loop_four_are_told_and_the_others_named() {
    use LinkageTerm::{AxisRx, AxisRy, AxisX, AxisY, Crank, Lever, Rod};
    for name in ["irb460", "spray_painter"] {
        let model = rigid(name);
        let along = model.actuators.four_bar().expect("a four-bar").3.crank.along;
        let commands = commands(&model, 60);
        let kept = foreseen(&model, &commands, Redundancy::Keep);
        let ids = &kept.parameters;
        let of_loop = |ids: &[ParameterId]| -> BTreeSet<ParameterId> {
            ids.iter().copied().filter(|id| matches!(id, ParameterId::Linkage(_))).collect()
        };
        let all: BTreeSet<_> = LinkageTerm::ALL.map(ParameterId::Linkage).into();
        assert_eq!(of_loop(ids), all, "{name}");

        // By the machine that closes by itself, from 60 poses: the loop beside the links, and without them.
        let links: Vec<_> = ids.iter().copied().filter(|id| !all.contains(id)).collect();
        let [with, without] = [ids, &links].map(|ids| rank(&columns(&model, &commands, ids)));
        println!("{name}: rank {with:?} of {}, {without:?} of {} without the loop", ids.len(), links.len());
        assert_eq!((without.0, with.0), (links.len(), links.len() + 4), "{name}");
        // The step between what is told and what is not is wide.
        assert!(with.1[0] > 100.0 * with.1[1], "{with:?}");
        assert_eq!((kept.measured_rank, kept.spectrum.rank), (with.0, with.0), "{name}");

        // What depends is named, with what does the same. By default a prior holds it; where it is to be fixed, it is left out.
        let held = foreseen(&model, &commands, Redundancy::Prior);
        let fixed = foreseen(&model, &commands, Redundancy::Fix);
        let dependent: BTreeSet<_> = [Lever, AxisRx, AxisRy].map(ParameterId::Linkage).into();
        for (groups, how) in [(&held.held, "held"), (&fixed.fixed, "fixed")] {
            let named: Vec<_> = groups.iter().map(|group| group.redundant).collect();
            assert_eq!(of_loop(&named), dependent, "{name}, {how}: {groups:?}");
            // Coefficients as the geometry has them: -1, minus and plus the height of the crank's end along its axis.
            for (redundant, with, expected) in
                [(Lever, Crank, -1.0), (AxisRx, AxisY, -along), (AxisRy, AxisX, along)]
            {
                let found = share(groups, redundant, with);
                assert!(
                    found.is_some_and(|found| (found - expected).abs() < 1e-6),
                    "{name}, {how}: {redundant:?} is {found:?} of {with:?}, and not {expected}"
                );
                assert_eq!(share(groups, redundant, Rod), None, "{name}: {redundant:?}");
            }
        }
        let left: BTreeSet<_> = [Crank, Rod, AxisX, AxisY].map(ParameterId::Linkage).into();
        assert_eq!(of_loop(&fixed.parameters), left, "{name}");
        assert_eq!(fixed.spectrum.rank, fixed.parameters.len(), "{name}");
    }
}

/// Where the crank sits beside the lever, the rod crosses the upper arm, and a tilt does what no displacement does.
#[test]
fn a_rod_that_is_not_parallel_tells_more_of_the_loop() {
    let mut model = rigid("irb460");
    let bar = model.actuators.linkage_mut().expect("a four-bar");
    bar.crank.along += 0.06;
    bar.rod = bar.rod.hypot(0.06);
    bar.lever.length *= 1.1;
    bar.crank.length *= 1.1;
    bar.lever.angle += 0.02;
    let commands = commands(&model, 60);
    let kept = foreseen(&model, &commands, Redundancy::Keep);
    let (own, step) = rank(&columns(&model, &commands, &kept.parameters));
    println!("rank {own} of {}, {step:?}", kept.parameters.len());
    let links = kept.parameters.len() - LinkageTerm::ALL.len();
    assert!(own > links + 4, "{own} of {links} and the loop's");
    assert_eq!(kept.measured_rank, own);
}
