use std::f64::consts::{PI, TAU};

use proptest::prelude::*;

use super::*;
use calibrig_model::geometry::{rotation_x, rotation_y, translation};
use calibrig_model::{CraigLink, FourBar, JointKind, LinkageArm, ParameterId};

const SHOULDER: usize = 0;
const ELBOW: usize = 1;

fn revolute(name: &str) -> CraigLink {
    CraigLink {
        name: name.to_owned(),
        kind: JointKind::Revolute,
        a: 0.0,
        alpha: 0.0,
        beta: 0.0,
        d: 0.0,
        theta: 0.0,
        limits: [-PI, PI],
    }
}

#[derive(Debug, Clone)]
struct FourBarRobot {
    kinematics: KinematicModel,
    linkage: FourBar,
    offset: f64,
}

impl FourBarRobot {
    /// An exact parallelogram with arms of 0.35 m on an upper arm of 1.35 m.
    fn exact(lever_angle: f64, elbow_theta: f64, offset: f64) -> Self {
        let mut links = vec![revolute("shoulder"), revolute("elbow")];
        (links[SHOULDER].a, links[SHOULDER].alpha) = (0.25, -PI / 2.0);
        (links[ELBOW].a, links[ELBOW].theta) = (1.35, elbow_theta);
        let arm = |angle: f64| LinkageArm { length: 0.35, angle, along: 0.1 };
        Self {
            kinematics: KinematicModel {
                links,
                base_from_first: Transform::identity(),
                last_from_flange: Transform::identity(),
            },
            linkage: FourBar {
                crank: arm(lever_angle),
                lever: arm(lever_angle),
                rod: 1.35,
                axis: CrankAxis::default(),
            },
            offset,
        }
    }

    fn actuators(&self) -> ActuatorMap {
        ActuatorMap::Parallelogram {
            shoulder: SHOULDER,
            elbow: ELBOW,
            offset: self.offset,
            linkage: Some(self.linkage),
        }
    }

    fn joints(&self, command: &[f64]) -> Result<[f64; 2], ClosureError> {
        let mut joints = [0.0; 2];
        joints_from_command(&self.kinematics, &self.actuators(), command, &mut joints)?;
        Ok(joints)
    }

    fn command(&self, joints: &[f64]) -> Result<Vec<f64>, ClosureError> {
        command_from_joints(&self.kinematics, &self.actuators(), joints)
    }

    fn closure(&self, command: &[f64]) -> ElbowClosure {
        ElbowLinkage::new(&self.kinematics, &self.actuators()).unwrap().unwrap().closure(command).unwrap()
    }

    /// What the rod is off by, from the products of the whole chain, m.
    fn gap(&self, command: &[f64], joints: &[f64]) -> f64 {
        let waist_from_shoulder = self.kinematics.links[SHOULDER].transform(joints[SHOULDER]);
        let waist_from_elbow = waist_from_shoulder * self.kinematics.links[ELBOW].transform(joints[ELBOW]);
        let CrankAxis { x, y, rx, ry } = self.linkage.axis;
        let waist_from_crank = self.kinematics.links[SHOULDER].fixed_part()
            * (translation(x, y, 0.0) * rotation_x(rx) * rotation_y(ry))
            * rotation_z(command[ELBOW] + self.offset + self.kinematics.links[ELBOW].theta);
        let crank = waist_from_crank * nalgebra::Point3::from(self.linkage.crank.end());
        let lever = waist_from_elbow * nalgebra::Point3::from(self.linkage.lever.end());
        (crank - lever).norm() - self.linkage.rod
    }

    fn change(&mut self, id: ParameterId, delta: f64) {
        match id {
            ParameterId::Linkage(term) => *self.linkage.term_mut(term) += delta,
            _ => self.kinematics.add(id, delta),
        }
    }
}

prop_compose! {
    /// An exact parallelogram, with the joint angles that put rod and lever at the drawn angle: square enough to close as built, too.
    fn exact_machine()(
        lever_angle in -PI..PI,
        theta in -1.0..1.0_f64,
        offset in -1.0..1.0_f64,
        between in 1.1..2.0_f64,
        mirrored in any::<bool>(),
        shoulder in -PI..PI,
    ) -> (FourBarRobot, [f64; 2]) {
        let between = if mirrored { -between } else { between };
        (FourBarRobot::exact(lever_angle, theta, offset), [shoulder, between - lever_angle - theta])
    }
}

prop_compose! {
    /// A machine as built, up to 20 mm and 0.02 rad off in everything, with a command.
    fn machine_as_built()(
        (machine, joints) in exact_machine(),
        off in prop::array::uniform32(-1.0..1.0_f64),
    ) -> (FourBarRobot, [f64; 2]) {
        let mut built = machine.clone();
        let mut off = off.iter();
        let mut draw = |scale: f64| off.next().map_or(0.0, |x| scale * x);
        for id in ParameterId::all_of_links(2) {
            built.change(id, draw(0.02));
        }
        for arm in [&mut built.linkage.crank, &mut built.linkage.lever] {
            arm.length += draw(0.02);
            arm.along += draw(0.02);
            arm.angle += draw(0.02);
        }
        built.linkage.rod += draw(0.02);
        built.linkage.axis = CrankAxis { x: draw(0.02), y: draw(0.02), rx: draw(0.02), ry: draw(0.02) };
        let command = machine.actuators().command_from_joints(&joints);
        (built, [command[SHOULDER], command[ELBOW]])
    }
}

/// Every elbow angle within half a turn of `ideal` at which the rod fits, by bisection.
fn all_closures(machine: &FourBarRobot, command: &[f64], ideal: f64) -> Vec<f64> {
    let gap = |q: f64| machine.gap(command, &[command[SHOULDER], q]);
    let grid: Vec<f64> = (0..=720).map(|i| ideal - PI + TAU * f64::from(i) / 720.0).collect();
    grid.windows(2)
        .filter(|w| gap(w[0]) * gap(w[1]) <= 0.0)
        .map(|w| {
            let (mut low, mut high) = (w[0], w[1]);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if gap(low) * gap(middle) <= 0.0 { high = middle } else { low = middle }
            }
            0.5 * (low + high)
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn an_exact_parallelogram_is_the_ideal_map((machine, joints) in exact_machine()) {
        let command = machine.actuators().command_from_joints(&joints);
        let closed = machine.joints(&command).unwrap();
        prop_assert!((closed[ELBOW] - joints[ELBOW]).abs() < 1e-14, "{closed:?} {joints:?}");
        let opened = machine.command(&joints).unwrap();
        prop_assert!((opened[ELBOW] - command[ELBOW]).abs() < 1e-14);
        let d = machine.closure(&command);
        prop_assert!((d.by_psi - 1.0).abs() < 1e-13 && (d.by_shoulder + 1.0).abs() < 1e-13);
    }

    #[test]
    fn as_built_the_rod_fits_and_the_closure_is_the_nearest((machine, command) in machine_as_built()) {
        let joints = machine.joints(&command).unwrap();
        prop_assert!(machine.gap(&command, &joints).abs() < 1e-14, "{:e}", machine.gap(&command, &joints));
        let ideal = command[ELBOW] + machine.offset - command[SHOULDER];
        let nearest = all_closures(&machine, &command, ideal)
            .into_iter()
            .min_by(|a, b| (a - ideal).abs().total_cmp(&(b - ideal).abs()))
            .unwrap();
        prop_assert!((joints[ELBOW] - nearest).abs() < 1e-12, "{joints:?} {nearest}");
    }

    #[test]
    fn as_built_the_joints_give_back_the_command((machine, command) in machine_as_built()) {
        let joints = machine.joints(&command).unwrap();
        let back = machine.command(&joints).unwrap();
        prop_assert!(back[SHOULDER] == command[SHOULDER]);
        prop_assert!((back[ELBOW] - command[ELBOW]).abs() < 1e-13, "{back:?} {command:?}");
    }

    #[test]
    fn the_derivatives_are_central_differences((machine, command) in machine_as_built()) {
        let closed = machine.closure(&command);
        prop_assert_eq!(closed.q_elbow, machine.joints(&command).unwrap()[ELBOW]);
        let step = 1e-5;
        let by_command = |index: usize| {
            let at = |delta: f64| {
                let mut command = command;
                command[index] += delta;
                machine.joints(&command).unwrap()[ELBOW]
            };
            (at(step) - at(-step)) / (2.0 * step)
        };
        prop_assert!((closed.by_psi - by_command(ELBOW)).abs() < 1e-7);
        prop_assert!((closed.by_shoulder - by_command(SHOULDER)).abs() < 1e-7);
    }

    /// Frames and points in general position, as deflections displace them.
    #[test]
    fn a_displaced_arm_still_meets_the_rod(
        pivot in prop::array::uniform6(-1.0..1.0_f64),
        end in prop::array::uniform3(0.2..1.0_f64),
        anchor in prop::array::uniform3(-1.0..1.0_f64),
        rod in 0.5..2.0_f64,
        ideal in -PI..PI,
    ) {
        let pivot = calibrig_model::geometry::small_displacement(&pivot.into());
        let (end, anchor) = (Vector3::from(end), Vector3::from(anchor));
        let place = |angle: f64| (pivot * rotation_z(angle)).transform_point(&end.into()).coords;
        let distance = |angle: f64| (place(angle) - anchor).norm();
        let turn = || (0..=1440).map(|i| distance(TAU * f64::from(i) / 1440.0));
        match swing_to(&pivot, &end, &anchor, rod, ideal) {
            Ok(closure) => {
                prop_assert!((distance(closure.angle) - rod).abs() < 1e-14);
                prop_assert!((closure.end - place(closure.angle)).norm() < 1e-14);
                let rate = (distance(closure.angle + 1e-5) - distance(closure.angle - 1e-5)) / 2e-5;
                prop_assert!((closure.rate - rate).abs() < 1e-8);
                let sine = rate.abs() / end.xy().norm();
                prop_assert!((closure.transmission_angle.sin() - sine).abs() < 1e-7);
                prop_assert!((closure.angle - ideal).abs() <= PI);
            }
            Err(ClosureError::CannotClose { gap }) => {
                let reachable = if gap > 0.0 { turn().fold(f64::INFINITY, f64::min) } else { turn().fold(0.0, f64::max) };
                prop_assert!((reachable - rod - gap).abs() < 1e-4, "{reachable} {rod} {gap}");
            }
            Err(ClosureError::NearSingular { transmission_angle }) => {
                prop_assert!(transmission_angle < LEAST_TRANSMISSION_ANGLE);
                let crossings = turn().zip(turn().skip(1)).filter(|(a, b)| (a - rod) * (b - rod) <= 0.0);
                for (a, b) in crossings {
                    let sine = (b - a).abs() / (TAU / 1440.0) / end.xy().norm();
                    prop_assert!(sine < LEAST_TRANSMISSION_ANGLE.sin() + 0.02, "{sine}");
                }
            }
            Err(other) => prop_assert!(false, "{other}"),
        }
    }
}

#[test]
fn near_the_flat_four_bar_the_pose_is_refused() {
    let machine = FourBarRobot::exact(0.0, 0.0, 0.0);
    for (degrees, singular) in
        [(0.0, true), (5.0, true), (9.9, true), (10.1, false), (169.0, false), (175.0, true)]
    {
        let between = f64::to_radians(degrees);
        let command = machine.actuators().command_from_joints(&[-1.2, between]);
        for outcome in [machine.joints(&command).map(|_| ()), machine.command(&[-1.2, between]).map(|_| ())] {
            match outcome {
                Err(ClosureError::NearSingular { transmission_angle }) if singular => {
                    assert!((transmission_angle.sin() - between.sin()).abs() < 1e-7, "{transmission_angle}");
                }
                Ok(()) if !singular => {}
                other => panic!("{degrees} deg: {other:?}"),
            }
        }
    }
}

#[test]
fn a_rod_that_does_not_reach_is_refused_with_the_gap() {
    // Crank across the upper arm: from its end to the elbow it is the hypotenuse of 0.35 m and 1.35 m.
    let diagonal = 0.35_f64.hypot(1.35);
    for (rod, gap) in [(0.9, diagonal - 0.35 - 0.9), (2.0, diagonal + 0.35 - 2.0)] {
        let mut machine = FourBarRobot::exact(0.0, 0.0, 0.0);
        machine.linkage.rod = rod;
        let refused = machine.joints(&[0.0, PI / 2.0]).unwrap_err();
        let ClosureError::CannotClose { gap: found } = refused else { panic!("{refused:?}") };
        assert!((found - gap).abs() < 1e-14);
        assert!(refused.to_string().contains(if gap > 0.0 { "short" } else { "long" }));
        assert!(matches!(machine.command(&[0.0, PI / 2.0]), Err(ClosureError::CannotClose { .. })));
    }
}

#[test]
fn joints_that_no_command_sets_are_refused() {
    let mut machine = FourBarRobot::exact(0.0, 0.0, 0.0);
    (machine.linkage.crank.length, machine.linkage.lever.length) = (0.5, 0.3);
    let refused = machine.command(&[0.0, -3.1]).unwrap_err();
    let ClosureError::OtherClosure { q_elbow, nearest } = refused else { panic!("{refused:?}") };
    assert!(q_elbow == -3.1 && (nearest + 2.634).abs() < 1e-3, "{nearest}");
}

#[test]
fn an_arm_or_rod_that_is_none_is_refused() {
    let mut machine = FourBarRobot::exact(0.0, 0.0, 0.0);
    machine.linkage.lever = LinkageArm { length: 0.0, angle: 0.0, along: 0.1 };
    machine.linkage.rod = 1.35_f64.hypot(0.35);
    assert!(machine.joints(&[0.0, PI / 2.0]).is_err());
    for wrong in [0.0, -1.35, f64::NAN] {
        let mut machine = FourBarRobot::exact(0.0, 0.0, 0.0);
        machine.linkage.rod = wrong;
        assert!(machine.joints(&[0.0, PI / 2.0]).is_err(), "{wrong}");
    }
}

#[test]
fn joints_must_be_neighbours_and_a_machine_without_lengths_is_ideal() {
    let machine = FourBarRobot::exact(0.0, 0.0, 0.2);
    let map = |shoulder, elbow, linkage| ActuatorMap::Parallelogram { shoulder, elbow, offset: 0.2, linkage };
    let mut joints = [0.0; 2];
    for (shoulder, elbow) in [(1, 0), (0, 0)] {
        let refused = joints_from_command(
            &machine.kinematics,
            &map(shoulder, elbow, Some(machine.linkage)),
            &[0.3, 0.7],
            &mut joints,
        );
        assert_eq!(refused, Err(ClosureError::NotNeighbours { shoulder, elbow }));
    }
    joints_from_command(&machine.kinematics, &map(0, 1, None), &[0.3, 0.7], &mut joints).unwrap();
    assert_eq!(joints, [0.3, 0.7 + 0.2 - 0.3]);
    assert_eq!(ElbowLinkage::new(&machine.kinematics, &ActuatorMap::Direct), Ok(None));
}
