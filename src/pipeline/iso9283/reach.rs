//! Commands for the poses of the test cube: only positions, nearest to the middle of the working region.

use nalgebra::Vector3;
use thiserror::Error;

use calibrig_estimation::evaluation::iso9283::{CubePlane, TestCube};
use calibrig_estimation::inverse::{Criterion, Goal, InverseError, InverseKinematics, InverseOptions, Tool};
use calibrig_model::CalibrationModel;
use calibrig_model::ModelError;
use calibrig_plant::experiment::WorkingRegion;

/// Why the poses of a cube cannot be reached.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ReachError {
    /// A pose is outside the working region.
    #[error(
        "{name} of the cube of {edge_mm:.0} mm, at ({}) m in the base frame, is outside the working region: the nearest point \
         found is {off_mm:.1} mm away",
        place.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ")
    )]
    Pose {
        /// `P1` to `P5`.
        name: String,
        /// Edge of the cube, mm.
        edge_mm: f64,
        /// Where it is in the base frame, m.
        place: Vector3<f64>,
        /// The remaining distance, mm.
        off_mm: f64,
    },
    /// Not even a small cube fits in the region.
    #[error("no cube of {least_mm:.0} mm or more about ({}) m in the base frame fits in the working region",
        centre.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", "))]
    NoCube {
        /// Its middle in the base frame, m.
        centre: Vector3<f64>,
        /// mm
        least_mm: f64,
    },
    /// The robot or its region is invalid.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The robot has no inverse kinematics.
    #[error(transparent)]
    Inverse(#[from] InverseError),
}

/// Edges are tried in steps of this, m.
const EDGE_STEP: f64 = 0.01;
/// No working space is larger, m.
const LARGEST_EDGE: f64 = 20.48;
/// Searches for a place, in addition to the one from the middle of the region.
const STARTS: usize = 8;

/// The rigid nominal robot with its joints inside the working region, as its controller believes it to be.
pub(super) struct Reach {
    model: CalibrationModel,
    inverse: InverseKinematics<'static>,
    options: InverseOptions,
    middle: Vector3<f64>,
}

impl Reach {
    /// Of a target in the flange frame, m.
    pub fn new(
        model: &CalibrationModel,
        region: &WorkingRegion,
        in_flange: Vector3<f64>,
    ) -> Result<Self, ReachError> {
        let model = within(model, region);
        let tool = Tool::at(in_flange).map_err(InverseError::from)?;
        let mut inverse = InverseKinematics::new(&model, tool)?;
        let middle = model.actuators.command_from_joints(&region.centre);
        let options = InverseOptions {
            criterion: Criterion::FAR_FROM_LIMITS,
            reference: Some(middle.clone()),
            starts: STARTS,
            ..InverseOptions::default()
        };
        let middle = inverse.tool_at(&middle)?.translation.vector;
        Ok(Self { model, inverse, options, middle })
    }

    /// The target in the middle of the region, m.
    pub fn middle(&self) -> Vector3<f64> {
        self.middle
    }

    /// Joint variables at P1 to P5.
    pub fn poses(&mut self, cube: &TestCube) -> Result<Vec<Vec<f64>>, ReachError> {
        let mut poses = Vec::new();
        for (number, place) in (1..).zip(cube.poses()) {
            match self.inverse.solve(&Goal::Position(place), &self.options) {
                Ok(found) => {
                    let mut joints = vec![0.0; found.command.len()];
                    self.model.actuators.joints_from_command(&found.command, &mut joints);
                    poses.push(joints);
                }
                Err(InverseError::Unreachable(nearest)) => {
                    let (name, edge_mm) = (format!("P{number}"), 1e3 * cube.edge);
                    return Err(ReachError::Pose {
                        name,
                        edge_mm,
                        place,
                        off_mm: 1e3 * nearest.missed.norm(),
                    });
                }
                Err(other) => return Err(other.into()),
            }
        }
        Ok(poses)
    }

    /// The largest cube about `centre` whose poses were found, in steps of 10 mm: a lower bound, because a search may miss a solution.
    pub fn largest(
        &mut self,
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
}

/// A robot whose joints go no farther than a working region.
pub(in crate::pipeline) fn within(model: &CalibrationModel, region: &WorkingRegion) -> CalibrationModel {
    let mut model = model.clone();
    let sides = region.centre.iter().zip(&region.half_width);
    for ((joint, link), (centre, half)) in model.kinematics.links.iter_mut().enumerate().zip(sides) {
        if model.actuators.is_commanded(joint) {
            link.limits = [centre - half, centre + half];
        }
    }
    model
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_estimation::kinematics::target_in_base;
    use calibrig_model::{ActuatorMap, AxisMap, CraigLink, KinematicModel};
    use nalgebra::{DMatrix, DVector};
    use std::f64::consts::FRAC_PI_2;

    const IN_FLANGE: Vector3<f64> = Vector3::new(0.8, 0.0, 0.0);

    /// A rail, a waist, a shoulder and an elbow: one joint more than positions need.
    fn chain() -> CalibrationModel {
        CalibrationModel::new(vec![
            CraigLink::prismatic("rail").row(0.0, -FRAC_PI_2, 0.0, 0.0),
            CraigLink::revolute("waist").row(0.0, FRAC_PI_2, 0.0, 0.0),
            CraigLink::revolute("shoulder").row(0.2, FRAC_PI_2, 0.0, 0.0),
            CraigLink::revolute("elbow").row(1.0, 0.0, 0.0, 0.0),
        ])
        .expect("a chain")
    }

    fn region(half_width: [f64; 4]) -> WorkingRegion {
        WorkingRegion { centre: vec![1.0, 0.1, 0.4, -0.9], half_width: half_width.to_vec() }
    }

    #[test]
    fn poses_are_reached_inside_the_region_and_nearest_to_its_middle() {
        let (model, region) = (chain(), region([0.6, 0.5, 0.5, 0.6]));
        let mut reach = Reach::new(&model, &region, IN_FLANGE).expect("a robot");
        let middle = reach.middle();
        let (cube, poses) = reach.largest(middle, (2, 1.0), CubePlane::C1C2C7C8).expect("a cube");
        assert!(cube.edge >= 0.3, "{}", cube.edge);
        let off = poses[0].iter().zip(&region.centre).map(|(q, c)| (q - c).abs()).fold(0.0, f64::max);
        assert!(off < 1e-6, "{:?}", poses[0]);
        for (joints, place) in poses.iter().zip(cube.poses()) {
            let there = target_in_base(&model.kinematics, joints, &IN_FLANGE).expect("a pose");
            assert!((there - place).norm() <= 1e-9);
            let sides = region.centre.iter().zip(&region.half_width);
            let inside = |(q, (c, h)): (&f64, (&f64, &f64))| (q - c).abs() <= h * (1.0 + 1e-12);
            assert!(joints.iter().zip(sides).all(inside), "{joints:?}");
        }
        // 10 mm more and a pose is out: it is named, and how far it is.
        let larger = TestCube { edge: cube.edge + EDGE_STEP, ..cube };
        let told = reach.poses(&larger).expect_err("out of the region").to_string();
        assert!(
            told.starts_with('P')
                && told.contains("is outside the working region: the nearest point found is"),
            "{told}"
        );
    }

    /// A palletizer: its tool stays level, whatever the arms in front of it do.
    #[test]
    fn joints_that_follow_others_are_taken_along() {
        let links = vec![
            CraigLink::revolute("waist").row(0.0, 0.0, 0.5, 0.0),
            CraigLink::revolute("shoulder").row(0.2, -FRAC_PI_2, 0.0, 0.0),
            CraigLink::revolute("elbow").row(1.0, 0.0, 0.0, 0.0),
            CraigLink::revolute("level").row(1.0, 0.0, 0.0, 0.0),
        ];
        let shown = DMatrix::from_row_slice(
            4,
            4,
            &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0],
        );
        let axes = AxisMap::new(shown, DVector::zeros(4)).expect("lower triangular").with_followers(&[3]);
        let actuators = ActuatorMap::Axes { axes, elbow: None };
        let mut centre = vec![0.1, -0.9, 1.2, 0.0];
        actuators.follow(&mut centre);
        let kinematics = KinematicModel::new(links.clone()).expect("a chain");
        let model = CalibrationModel { actuators, ..CalibrationModel::new(links).expect("a chain") };
        let region = WorkingRegion { centre, half_width: vec![0.8, 0.6, 0.6, 0.0] };
        let in_flange = Vector3::new(0.3, 0.2, 0.0);
        let mut reach = Reach::new(&model, &region, in_flange).expect("a robot");
        let centre = reach.middle() + Vector3::new(0.1, -0.1, 0.08);
        let cube = TestCube { centre, edge: 0.01, up: (2, 1.0), plane: CubePlane::C1C2C7C8 };
        for (joints, place) in reach.poses(&cube).expect("poses").iter().zip(cube.poses()) {
            assert!((joints[1] + joints[2] + joints[3]).abs() < 1e-14, "{joints:?}");
            let there = target_in_base(&kinematics, joints, &in_flange).expect("a pose");
            assert!((there - place).norm() < 1e-9);
        }
    }

    #[test]
    fn a_region_without_width_holds_no_cube() {
        let mut reach = Reach::new(&chain(), &region([0.0; 4]), IN_FLANGE).expect("a robot");
        let middle = reach.middle();
        let told = reach.largest(middle, (2, 1.0), CubePlane::C1C2C7C8).expect_err("no cube").to_string();
        assert!(told.starts_with("no cube of 10 mm or more about ("), "{told}");
    }
}
