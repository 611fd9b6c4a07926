//! Commands for the poses of the test cube: positions alone, nearest to the middle of the working region.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use thiserror::Error;

use calibrig_estimation::evaluation::iso9283::{CubePlane, TestCube};
use calibrig_estimation::kinematics::{identification_jacobian, target_in_base};
use calibrig_model::{ActuatorMap, JointKind, KinematicModel, LinkTerm, ModelError, ParameterId};

/// A cube whose poses cannot be taken.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ReachError {
    /// A pose is out of the working region.
    #[error(
        "{name} of the cube of {edge_mm:.0} mm, at ({}) m in the base frame, is out of the working region: the nearest that was found is {off_mm:.1} mm away",
        place.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ")
    )]
    Pose {
        /// `P1` to `P5`.
        name: String,
        /// Edge of the cube, mm.
        edge_mm: f64,
        /// Where it is in the base frame, m.
        place: Vector3<f64>,
        /// What was left, mm.
        off_mm: f64,
    },
    /// Not even a small cube lies in the region.
    #[error("no cube of {least_mm:.0} mm or more about ({}) m in the base frame lies in the working region",
        centre.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", "))]
    NoCube {
        /// Its middle in the base frame, m.
        centre: Vector3<f64>,
        /// mm
        least_mm: f64,
    },
    /// The robot or its region cannot be one.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Edges of a cube that is sought, m: from the least on, in steps of the same.
const EDGE_STEP: f64 = 0.01;
/// No working space is larger, m.
const LARGEST_EDGE: f64 = 20.48;
/// A place is reached to so much, m.
const REACHED: f64 = 1e-7;
/// Steps along the way to a place; iterations a step, and for what is left at its end.
const WAY: u32 = 8;
const ITERATIONS: usize = 12;
const LAST_ITERATIONS: usize = 60;
/// Longest step of a joint variable in half widths of the region.
const LONGEST: f64 = 0.25;

/// The rigid nominal robot in its working region, as its controller believes it to be.
pub(super) struct Reach<'a> {
    pub kinematics: &'a KinematicModel,
    /// Which joints follow others.
    pub actuators: &'a ActuatorMap,
    pub centre: &'a [f64],
    pub half_width: &'a [f64],
    pub in_flange: Vector3<f64>,
}

impl Reach<'_> {
    /// The target in the middle of the region, m.
    pub fn middle(&self) -> Result<Vector3<f64>, ReachError> {
        Ok(target_in_base(self.kinematics, self.centre, &self.in_flange)?)
    }

    /// Joint variables at P1 to P5.
    pub fn poses(&self, cube: &TestCube) -> Result<Vec<Vec<f64>>, ReachError> {
        let mut poses = Vec::new();
        for (number, place) in (1..).zip(cube.poses()) {
            let (joints, off) = self.joints(&place)?;
            if !(off <= REACHED) {
                let (name, edge_mm, off_mm) = (format!("P{number}"), 1e3 * cube.edge, 1e3 * off);
                return Err(ReachError::Pose { name, edge_mm, place, off_mm });
            }
            poses.push(joints);
        }
        Ok(poses)
    }

    /// The largest cube about `centre` whose poses were found, in steps of 10 mm: a lower bound of what there is, since a search may miss a way.
    pub fn largest(
        &self,
        centre: Vector3<f64>,
        up: (usize, f64),
        plane: CubePlane,
    ) -> Result<(TestCube, Vec<Vec<f64>>), ReachError> {
        let cube = |edge| TestCube { centre, edge, up, plane };
        let mut found = None;
        let mut step = LARGEST_EDGE;
        let mut edge = 0.0;
        while step > 0.9 * EDGE_STEP {
            let tried = cube(edge + step);
            match self.poses(&tried) {
                Ok(poses) => (found, edge) = (Some((tried, poses)), edge + step),
                Err(ReachError::Pose { .. }) => {}
                Err(error) => return Err(error),
            }
            step *= 0.5;
        }
        found.ok_or(ReachError::NoCube { centre, least_mm: 1e3 * EDGE_STEP })
    }

    /// Joint variables that bring the target to `place`, and the distance that is left, m: along a straight way from the middle of the region.
    fn joints(&self, place: &Vector3<f64>) -> Result<(Vec<f64>, f64), ReachError> {
        let mut x = DVector::zeros(self.centre.len());
        let from = self.middle()?;
        for step in 1..=WAY {
            let aim = from + (place - from) * (f64::from(step) / f64::from(WAY));
            let iterations = if step == WAY { LAST_ITERATIONS } else { ITERATIONS };
            for _ in 0..iterations {
                let (off, moved) = self.step(&mut x, &aim)?;
                if off < 1e-12 && moved < 1e-10 {
                    break;
                }
            }
        }
        let joints = self.at(&x);
        let off = (target_in_base(self.kinematics, &joints, &self.in_flange)? - place).norm();
        Ok((joints, off))
    }

    fn at(&self, x: &DVector<f64>) -> Vec<f64> {
        let widths = self.centre.iter().zip(self.half_width);
        let mut joints: Vec<f64> = widths.zip(x).map(|((centre, half), x)| centre + half * x).collect();
        self.actuators.follow(&mut joints);
        joints
    }

    /// How the joints move with each of them: one that others follow takes them along.
    fn joints_by_joints(&self) -> DMatrix<f64> {
        let count = self.centre.len();
        let led = |joint: Option<usize>| {
            let mut joints = vec![0.0; count];
            if let Some(joint) = joint {
                joints[joint] = 1.0;
            }
            self.actuators.follow(&mut joints);
            DVector::from_vec(joints)
        };
        let zero = led(None);
        let columns: Vec<_> = (0..count).map(|joint| led(Some(joint)) - &zero).collect();
        DMatrix::from_columns(&columns)
    }

    /// One step of Gauss and Newton to the `x` nearest to zero, in half widths of the region, that brings the target to `aim`: what leaves the box is put on its edge,
    /// and the others make up for it. Gives the distance before the step (m), and the longest move.
    fn step(&self, x: &mut DVector<f64>, aim: &Vector3<f64>) -> Result<(f64, f64), ReachError> {
        let joints = self.at(x);
        let term = |kind| if kind == JointKind::Prismatic { LinkTerm::D } else { LinkTerm::Theta };
        let links = self.kinematics.links.iter().enumerate();
        let ids: Vec<_> = links.map(|(link, l)| ParameterId::Link { link, term: term(l.kind) }).collect();
        let by_joints = identification_jacobian(self.kinematics, &joints, &self.in_flange, &ids)?;
        let mut jacobian = by_joints * self.joints_by_joints();
        for (mut column, half) in jacobian.column_iter_mut().zip(self.half_width) {
            column *= *half;
        }
        let error = aim - target_in_base(self.kinematics, &joints, &self.in_flange)?;
        let mut bound: Vec<Option<f64>> =
            self.half_width.iter().map(|half| (*half == 0.0).then_some(0.0)).collect();
        let mut wanted = x.clone();
        for _ in 0..=x.len() {
            let mut right = error;
            let mut free: DMatrix<f64> = DMatrix::zeros(3, x.len());
            for (j, fixed) in bound.iter().enumerate() {
                let column = jacobian.column(j);
                right += column * (x[j] - fixed.unwrap_or(0.0));
                if fixed.is_none() {
                    free.column_mut(j).copy_from(&column);
                }
            }
            let gram: Matrix3<f64> = Matrix3::from_iterator((&free * free.transpose()).iter().copied());
            // Far below what a move of a micrometre needs, and enough for a direction that no joint moves along.
            let damped = gram + Matrix3::identity() * (1e-12 * gram.trace()).max(f64::MIN_POSITIVE);
            let Some(factor) = damped.cholesky() else { break };
            let moves = free.transpose() * factor.solve(&right);
            for (j, fixed) in bound.iter().enumerate() {
                wanted[j] = fixed.unwrap_or(moves[j]);
            }
            let outside = |j: &usize| bound[*j].is_none() && wanted[*j].abs() > 1.0;
            let farthest =
                (0..x.len()).filter(outside).max_by(|a, b| wanted[*a].abs().total_cmp(&wanted[*b].abs()));
            match farthest {
                Some(j) => bound[j] = Some(wanted[j].signum()),
                None => break,
            }
        }
        let mut moved = 0.0_f64;
        for (x, wanted) in x.iter_mut().zip(&wanted) {
            let step = (wanted - *x).clamp(-LONGEST, LONGEST);
            *x = (*x + step).clamp(-1.0, 1.0);
            moved = moved.max(step.abs());
        }
        Ok((error.norm(), moved))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::{AxisMap, CraigLink};
    use std::f64::consts::FRAC_PI_2;

    /// A rail, a waist, a shoulder and an elbow: one joint more than positions need.
    fn chain() -> KinematicModel {
        KinematicModel::new(vec![
            CraigLink::prismatic("rail").row(0.0, -FRAC_PI_2, 0.0, 0.0),
            CraigLink::revolute("waist").row(0.0, FRAC_PI_2, 0.0, 0.0),
            CraigLink::revolute("shoulder").row(0.2, FRAC_PI_2, 0.0, 0.0),
            CraigLink::revolute("elbow").row(1.0, 0.0, 0.0, 0.0),
        ])
        .expect("a chain")
    }

    fn reach(kinematics: &KinematicModel, widths: [f64; 4]) -> (Vec<f64>, Vec<f64>, &KinematicModel) {
        (vec![1.0, 0.1, 0.4, -0.9], widths.to_vec(), kinematics)
    }

    #[test]
    fn poses_are_reached_inside_the_region_and_nearest_to_its_middle() {
        let kinematics = chain();
        let (centre, half_width, kinematics) = reach(&kinematics, [0.6, 0.5, 0.5, 0.6]);
        let reach = Reach {
            kinematics,
            actuators: &ActuatorMap::Direct,
            centre: &centre,
            half_width: &half_width,
            in_flange: Vector3::new(0.8, 0.0, 0.0),
        };
        let middle = reach.middle().expect("the middle");
        let (cube, poses) = reach.largest(middle, (2, 1.0), CubePlane::C1C2C7C8).expect("a cube");
        assert!(cube.edge >= 0.3, "{}", cube.edge);
        assert_eq!(poses[0], centre);
        for (joints, place) in poses.iter().zip(cube.poses()) {
            let there = target_in_base(kinematics, joints, &reach.in_flange).expect("a pose");
            assert!((there - place).norm() <= REACHED);
            let inside = |((q, c), h): ((&f64, &f64), &f64)| (q - c).abs() <= h * (1.0 + 1e-12);
            assert!(joints.iter().zip(&centre).zip(&half_width).all(inside), "{joints:?}");
        }
        // 10 mm more and a pose is out: it is named, and how far it is.
        let larger = TestCube { edge: cube.edge + EDGE_STEP, ..cube };
        let told = reach.poses(&larger).expect_err("out of the region").to_string();
        assert!(
            told.starts_with('P')
                && told.contains("is out of the working region: the nearest that was found is"),
            "{told}"
        );

        // Of the poses on the self-motion through a place in the open region none is nearer to the middle.
        let place = middle + Vector3::new(0.05, -0.04, 0.06);
        let (joints, off) = reach.joints(&place).expect("a pose");
        assert!(off < 1e-10, "{off}");
        let size = |q: &[f64]| {
            q.iter().zip(&centre).zip(&half_width).map(|((q, c), h)| ((q - c) / h).powi(2)).sum::<f64>()
        };
        for shift in [-1e-3, 1e-3] {
            // The same place with the rail elsewhere: the other three joints follow.
            let (moved_centre, fixed_rail) = (
                {
                    let mut c = joints.clone();
                    c[0] += shift;
                    c
                },
                [0.0, 0.5, 0.5, 0.6],
            );
            let other = Reach { centre: &moved_centre, half_width: &fixed_rail, ..reach };
            let (q, off) = other.joints(&place).expect("a pose");
            assert!(off < 1e-10 && size(&q) > size(&joints), "{shift}: {q:?}");
        }
    }

    /// A palletizer: its tool stays level, whatever the arms in front of it do.
    #[test]
    fn joints_that_follow_others_are_taken_along() {
        let kinematics = KinematicModel::new(vec![
            CraigLink::revolute("waist").row(0.0, 0.0, 0.5, 0.0),
            CraigLink::revolute("shoulder").row(0.2, -FRAC_PI_2, 0.0, 0.0),
            CraigLink::revolute("elbow").row(1.0, 0.0, 0.0, 0.0),
            CraigLink::revolute("level").row(1.0, 0.0, 0.0, 0.0),
        ])
        .expect("a chain");
        let shown = DMatrix::from_row_slice(
            4,
            4,
            &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0],
        );
        let axes = AxisMap::new(shown, DVector::zeros(4)).expect("lower triangular").with_followers(&[3]);
        let actuators = ActuatorMap::Axes { axes, elbow: None };
        let mut centre = vec![0.1, -0.9, 1.2, 0.0];
        actuators.follow(&mut centre);
        let half_width = [0.8, 0.6, 0.6, 0.0];
        let in_flange = Vector3::new(0.3, 0.2, 0.0);
        let reach = Reach {
            kinematics: &kinematics,
            actuators: &actuators,
            centre: &centre,
            half_width: &half_width,
            in_flange,
        };
        let place = reach.middle().expect("the middle") + Vector3::new(0.1, -0.1, 0.08);
        let (joints, off) = reach.joints(&place).expect("a pose");
        assert!(off < 1e-10, "{off}");
        assert!((joints[1] + joints[2] + joints[3]).abs() < 1e-14, "{joints:?}");
        assert!((target_in_base(&kinematics, &joints, &in_flange).expect("a pose") - place).norm() < 1e-10);
    }

    #[test]
    fn a_region_without_width_holds_no_cube() {
        let kinematics = chain();
        let (centre, half_width, kinematics) = reach(&kinematics, [0.0; 4]);
        let reach = Reach {
            kinematics,
            actuators: &ActuatorMap::Direct,
            centre: &centre,
            half_width: &half_width,
            in_flange: Vector3::new(0.8, 0.0, 0.0),
        };
        let middle = reach.middle().expect("the middle");
        let told = reach.largest(middle, (2, 1.0), CubePlane::C1C2C7C8).expect_err("no cube").to_string();
        assert!(told.starts_with("no cube of 10 mm or more about ("), "{told}");
    }
}
