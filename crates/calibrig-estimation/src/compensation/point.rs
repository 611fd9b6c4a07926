//! One corrected command.

use nalgebra::{Matrix3, Vector3};

use crate::inverse::{Goal, JointAtLimit};
use calibrig_model::geometry::Transform;

/// A command that puts the identified robot's tool where it should be.
#[derive(Debug, Clone, PartialEq)]
pub struct CompensatedPoint {
    /// Where the tool should be.
    pub goal: Goal,
    /// Command of the rigid nominal robot's controller for the goal, m or rad.
    pub nominal: Vec<f64>,
    /// Command to use instead, m or rad.
    pub command: Vec<f64>,
    /// Predicted place of the tool at the corrected command.
    pub base_from_tool: Transform,
    /// Predicted miss of the goal with the nominal command, m, base axes.
    pub uncompensated: Vector3<f64>,
    /// Signs of the actuators' last motions that the correction assumes; empty if unknown.
    pub approach: Vec<i8>,
    /// Joints at their limits.
    pub limits: Vec<JointAtLimit>,
    /// Covariance of the robot's mean position there, m², from the estimate and the machine's noise beside its model. `None` for a robot without an
    /// estimate, or an estimate without a covariance.
    pub covariance: Option<Matrix3<f64>>,
}

impl CompensatedPoint {
    /// Remaining miss of the position, m.
    pub fn missed(&self) -> f64 {
        (self.base_from_tool.translation.vector - self.goal.position()).norm()
    }

    /// An actuator's correction beyond this leads to another pose of the arm, as happens near a singular one: no machine is off by as much, m or rad.
    pub const FARTHEST: f64 = 0.2;

    /// The actuator with the largest correction and its size, m or rad, if that is beyond [`FARTHEST`](Self::FARTHEST).
    pub fn far_correction(&self) -> Option<(usize, f64)> {
        let ways = self.nominal.iter().zip(&self.command).map(|(from, to)| (to - from).abs());
        ways.enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b)).filter(|(_, way)| *way > Self::FARTHEST)
    }

    /// Standard deviations of the corrected position along the base's axes, m.
    pub fn sigma(&self) -> Option<Vector3<f64>> {
        self.covariance.map(|covariance| covariance.diagonal().map(f64::sqrt))
    }
}
