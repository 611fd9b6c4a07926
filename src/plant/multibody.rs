//! The pose of a robot at rest under gravity.

use nalgebra::{Point3, Vector3};
use rapier3d::math::Vector;

use super::chain::{Chain, transform, vector};
use super::validation::{check_command, check_options, check_robot};
use super::{AsBuilt, PlantError, SettledPose};

/// Each brings the start nearer to rest by as much as a step, at a fifth of its cost.
const PREDICTIONS: usize = 2;

/// When a pose counts as settled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SettleOptions {
    /// Length of a step, s.
    ///
    /// A step starts at rest and moves the joints by `(K + M/dt²)⁻¹` times the force left over, K the stiffness of the drives and
    /// M the mass matrix: long steps solve the statics alone. Drives so soft that long steps overshoot settle with shorter ones.
    pub dt: f64,
    /// Steps before the pose is given up.
    pub max_steps: u32,
    /// Largest motion of the target in the last step, m.
    pub tip_tolerance: f64,
    /// Largest force left over, as the displacement that it would cause on its drive, rad or m.
    pub residual_tolerance: f64,
}

impl Default for SettleOptions {
    fn default() -> Self {
        Self { dt: 100.0, max_steps: 100, tip_tolerance: 1e-9, residual_tolerance: 1e-10 }
    }
}

/// The rapier multibody of one robot.
///
/// Every joint is a reduced coordinate on a spring that rapier integrates implicitly and whose rest is the command. A drive of
/// infinite stiffness is a kinematic joint: the solver leaves it exactly where it was put.
pub struct Plant {
    robot: AsBuilt,
    options: SettleOptions,
    chain: Chain,
    target_in_last: Vector,
    /// The joint variables that the drives would hold without a load.
    commanded: Vec<f64>,
    /// Beyond the commanded joint variables.
    deflection: Vec<f64>,
    /// The joint variables to start from.
    predicted: Vec<f64>,
    /// Generalised force of gravity, N or N m.
    load: Vec<f64>,
}

impl Plant {
    /// Checks the robot and builds its multibody, with the base frame as rapier's world frame.
    pub fn new(robot: &AsBuilt, options: SettleOptions) -> Result<Self, PlantError> {
        check_options(&options)?;
        check_robot(robot)?;
        let joints = robot.kinematics.joint_count();
        let target_in_last = robot.kinematics.last_from_flange * Point3::from(robot.target);
        Ok(Self {
            robot: robot.clone(),
            options,
            chain: Chain::new(robot, options.dt),
            target_in_last: vector(&target_in_last.coords),
            commanded: vec![0.0; joints],
            deflection: vec![0.0; joints],
            predicted: vec![0.0; joints],
            load: vec![0.0; joints],
        })
    }

    /// The pose at rest under gravity at a command (SI, one an actuator).
    ///
    /// It depends on the robot, the options and the command; not one bit of it on the poses before.
    pub fn settle(&mut self, command: &[f64]) -> Result<SettledPose, PlantError> {
        check_command(self.commanded.len(), command)?;
        self.robot.actuators.joints_from_command(command, &mut self.commanded);
        let settled = self.relax();
        if settled.is_err() {
            // rapier disables the bodies that it finds at no finite place.
            self.chain = Chain::new(&self.robot, self.options.dt);
        }
        settled
    }

    /// The same with the frames of the links displaced.
    pub fn settle_displaced(
        &mut self,
        command: &[f64],
        _displacements: &[[f64; 6]],
    ) -> Result<SettledPose, PlantError> {
        self.settle(command)
    }

    /// Steps, from the deflection that the load would cause, until nothing moves any more.
    fn relax(&mut self) -> Result<SettledPose, PlantError> {
        self.chain.drive_to(&self.commanded);
        for _ in 0..PREDICTIONS {
            self.predict();
            self.chain.place(&self.predicted);
        }
        let mut tip = self.tip();
        let (mut steps, mut tip_motion, mut residual) = (0, f64::INFINITY, f64::INFINITY);
        while steps < self.options.max_steps && tip.is_finite() {
            self.chain.step_from_rest();
            steps += 1;
            let before = std::mem::replace(&mut tip, self.tip());
            tip_motion = tip.distance(before);
            residual = self.residual();
            if tip_motion <= self.options.tip_tolerance && residual <= self.options.residual_tolerance {
                return Ok(self.settled_pose(residual, steps));
            }
        }
        Err(PlantError::NotSettled { steps, tip_motion, residual })
    }

    /// The target in the base frame.
    fn tip(&self) -> Vector {
        self.chain.pose(self.commanded.len() - 1).transform_point(self.target_in_last)
    }

    /// Where the drives would carry the load of the present pose.
    fn predict(&mut self) {
        self.chain.gravity_load(&mut self.load);
        for (joint, predicted) in self.predicted.iter_mut().enumerate() {
            *predicted = self.commanded[joint] + self.load[joint] / self.robot.statics.drive_stiffness[joint];
        }
    }

    /// Reads the deflections, and compares them with those that the load in this pose would cause: the largest difference.
    fn residual(&mut self) -> f64 {
        self.chain.gravity_load(&mut self.load);
        let mut largest: f64 = 0.0;
        for (joint, deflection) in self.deflection.iter_mut().enumerate() {
            *deflection = self.chain.coordinate(joint) - self.commanded[joint];
            let supported = self.load[joint] / self.robot.statics.drive_stiffness[joint];
            let left_over = (supported - *deflection).abs();
            // Unlike `f64::max`, this keeps a NaN.
            if left_over > largest || left_over.is_nan() {
                largest = left_over;
            }
        }
        largest
    }

    fn settled_pose(&self, residual: f64, steps: u32) -> SettledPose {
        let tip = self.tip();
        SettledPose {
            target: Vector3::new(tip.x, tip.y, tip.z),
            links: (0..self.commanded.len()).map(|joint| transform(self.chain.pose(joint))).collect(),
            deflection: self.deflection.clone(),
            residual,
            steps,
        }
    }
}
