//! One corrected command.

use nalgebra::{Matrix3, Vector3};

use crate::inverse::{Goal, JointAtLimit};
use calibrig_model::geometry::Transform;

/// A command that puts the identified robot's tool where it should be.
#[derive(Debug, Clone, PartialEq)]
pub struct CompensatedPoint {
    /// Where the tool should be.
    pub goal: Goal,
    /// What the controller of the rigid nominal robot commands for it, m or rad.
    pub nominal: Vec<f64>,
    /// What is to be commanded instead.
    pub command: Vec<f64>,
    /// Where the tool is predicted to be then.
    pub base_from_tool: Transform,
    /// How far the nominal command is predicted to put the tool beside the goal, m, base axes.
    pub uncompensated: Vector3<f64>,
    /// Signs of the actuators' last motions that the correction counts on; empty where none are known.
    pub approach: Vec<i8>,
    /// Joints at their limits.
    pub limits: Vec<JointAtLimit>,
    /// Covariance of the robot's mean position there, m²: of the estimate and of what the machine does beside its model. `None` of a robot without an
    /// estimate, or of one without a covariance.
    pub covariance: Option<Matrix3<f64>>,
}

impl CompensatedPoint {
    /// What is left of the position, m.
    pub fn missed(&self) -> f64 {
        (self.base_from_tool.translation.vector - self.goal.position()).norm()
    }

    /// A correction of an actuator beyond this is another pose of the arm, as near a singular one: no machine is so far off, m or rad.
    pub const FARTHEST: f64 = 0.2;

    /// The actuator that is corrected most and by how much, m or rad, where that is beyond [`FARTHEST`](Self::FARTHEST).
    pub fn far_correction(&self) -> Option<(usize, f64)> {
        let ways = self.nominal.iter().zip(&self.command).map(|(from, to)| (to - from).abs());
        ways.enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b)).filter(|(_, way)| *way > Self::FARTHEST)
    }

    /// Standard deviations of the corrected position along the base's axes, m.
    pub fn sigma(&self) -> Option<Vector3<f64>> {
        self.covariance.map(|covariance| covariance.diagonal().map(f64::sqrt))
    }
}
