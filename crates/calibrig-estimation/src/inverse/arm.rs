//! A robot as the search uses it.

use nalgebra::{DMatrix, Matrix6xX};

use super::joint_space::JointSpace;
use super::task::Tool;
use crate::elastostatics::ElasticError;
use crate::identification::{CalibratedRobot, Mode, PredictionError, Predictor};
use crate::kinematics::{ClosureError, KinematicChain};
use calibrig_model::geometry::Transform;
use calibrig_model::{ParameterId, Payload, PoseQuery};

/// A robot that can be placed at unknowns of its [`JointSpace`] and gives the place of its tool.
pub(crate) trait Arm {
    /// Moves the robot to `y`.
    fn place(&mut self, space: &JointSpace, y: &[f64]) -> Result<(), PredictionError>;

    /// Place of the tool, m.
    fn base_from_tool(&self) -> Transform;

    /// Motion of the tool per unit of every unknown at the current pose: three rows of its point's motion in the base's axes, three of its rotation
    /// vector, m or rad per unit.
    fn differentiate(
        &mut self,
        space: &JointSpace,
        motions: &mut Matrix6xX<f64>,
    ) -> Result<(), PredictionError>;
}

/// The rigid nominal robot.
#[derive(Debug, Clone)]
pub(crate) struct RigidArm {
    chain: KinematicChain,
    flange_from_tool: Transform,
    base_from_tool: Transform,
    joints: Vec<f64>,
    /// Current unknowns.
    y: Vec<f64>,
}

impl RigidArm {
    pub fn new(space: &JointSpace, tool: &Tool) -> Self {
        Self {
            chain: KinematicChain::new(&space.kinematics),
            flange_from_tool: *tool.flange_from_tool(),
            base_from_tool: Transform::identity(),
            joints: vec![0.0; space.kinematics.joint_count()],
            y: vec![0.0; space.len()],
        }
    }
}

/// The error for a four-bar that does not close, as for any pose that cannot be taken.
pub(super) fn no_pose(error: ClosureError) -> PredictionError {
    PredictionError::Machine(ElasticError::Linkage(error))
}

/// Motion of the tool with every joint of a rigid chain.
pub(super) fn by_joints(
    chain: &KinematicChain,
    space: &JointSpace,
    base_from_tool: &Transform,
    mut tell: impl FnMut(usize, [f64; 6]),
) {
    for joint in 0..space.kinematics.joint_count() {
        let term = chain.joint_term(joint);
        let moved = chain.link_column(joint, term, &base_from_tool.translation.vector);
        let turned = chain.turn(ParameterId::Link { link: joint, term });
        tell(joint, [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z]);
    }
}

impl Arm for RigidArm {
    fn place(&mut self, space: &JointSpace, y: &[f64]) -> Result<(), PredictionError> {
        space.joints(y, &mut self.joints).map_err(no_pose)?;
        self.chain.place(&self.joints);
        self.base_from_tool = self.chain.base_from_flange() * self.flange_from_tool;
        self.y.copy_from_slice(y);
        Ok(())
    }

    fn base_from_tool(&self) -> Transform {
        self.base_from_tool
    }

    fn differentiate(
        &mut self,
        space: &JointSpace,
        motions: &mut Matrix6xX<f64>,
    ) -> Result<(), PredictionError> {
        if space.is_plain && space.is_ideal() {
            by_joints(&self.chain, space, &self.base_from_tool, |joint, motion| {
                motions.column_mut(joint).copy_from_slice(&motion);
            });
            return Ok(());
        }
        let rates: DMatrix<f64> = space.joint_rates(&self.y).map_err(no_pose)?;
        motions.fill(0.0);
        by_joints(&self.chain, space, &self.base_from_tool, |joint, motion| {
            for (unknown, rate) in rates.row(joint).iter().enumerate().filter(|(_, rate)| **rate != 0.0) {
                for (into, value) in motions.column_mut(unknown).iter_mut().zip(motion) {
                    *into += rate * value;
                }
            }
        });
        Ok(())
    }
}

/// Conditions of a command beside the place: loads, air, time and approach.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Circumstances {
    /// Payload on the flange beside the robot's own loads.
    pub payload: Option<Payload>,
    /// Temperature of the air at the robot, °C, where known.
    pub temperature: Option<f64>,
    /// Time since the session began, s.
    pub time: f64,
    /// Sign of each actuator's last motion, 0 where unknown; empty if all are unknown.
    pub approach: Vec<i8>,
    /// How far each actuator has moved since it last reversed, m or rad; empty if unknown, which counts as far.
    pub since_reversal: Vec<f64>,
}

impl Circumstances {
    /// A command under these circumstances.
    pub fn at<'a>(&'a self, command: &'a [f64]) -> PoseQuery<'a> {
        PoseQuery {
            command,
            approach: &self.approach,
            since_reversal: &self.since_reversal,
            temperature: self.temperature,
            time: self.time,
            target: 0,
            payload: self.payload.as_ref(),
        }
    }
}

/// An identified robot, as its mode predicts it.
#[derive(Debug, Clone)]
pub(crate) struct CalibratedArm<'a> {
    predictor: Predictor<'a>,
    flange_from_tool: Transform,
    base_from_tool: Transform,
    pub circumstances: Circumstances,
    /// Whether rotations are needed.
    pub turned: bool,
    command: Vec<f64>,
    motions: Matrix6xX<f64>,
}

impl<'a> CalibratedArm<'a> {
    pub fn new(robot: &'a CalibratedRobot, tool: &Tool) -> Result<Self, PredictionError> {
        let count = robot.model.kinematics.joint_count();
        Ok(Self {
            predictor: Predictor::new(robot)?,
            flange_from_tool: *tool.flange_from_tool(),
            base_from_tool: Transform::identity(),
            circumstances: Circumstances::default(),
            turned: true,
            command: vec![0.0; count],
            motions: Matrix6xX::zeros(count),
        })
    }

    pub fn mode(&self) -> Mode {
        self.predictor.robot.mode
    }

    /// Predicted place of the tool at a command.
    pub fn tool_at(&mut self, command: &[f64]) -> Result<Transform, PredictionError> {
        let flange = self.predictor.flange(self.circumstances.at(command))?;
        Ok(flange * self.flange_from_tool)
    }
}

impl Arm for CalibratedArm<'_> {
    fn place(&mut self, space: &JointSpace, y: &[f64]) -> Result<(), PredictionError> {
        self.command = space.command(y);
        let flange = self.predictor.flange(self.circumstances.at(&self.command))?;
        self.base_from_tool = flange * self.flange_from_tool;
        Ok(())
    }

    fn base_from_tool(&self) -> Transform {
        self.base_from_tool
    }

    fn differentiate(
        &mut self,
        space: &JointSpace,
        motions: &mut Matrix6xX<f64>,
    ) -> Result<(), PredictionError> {
        let pose = self.circumstances.at(&self.command);
        let in_flange = self.flange_from_tool.translation.vector;
        self.predictor.motions_by_command(&pose, &in_flange, self.turned, &mut self.motions)?;
        self.motions.mul_to(&space.command_by_free, motions);
        Ok(())
    }
}
