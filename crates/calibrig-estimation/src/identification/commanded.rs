//! Predicted place of any tool of an identified robot, and how it moves with the commands.

use nalgebra::{Matrix3, Matrix6xX, Vector3};

use super::problem::in_base_column;
use super::robot::{EstimatePredictor, PredictionError, Predictor};
use super::{MachineNoise, PositionJacobian};
use calibrig_model::PoseQuery;
use calibrig_model::geometry::Transform;

/// Not a target of the robot: a tool is not displaced by what was identified for targets.
const OF_NO_TARGET: usize = usize::MAX;

impl Predictor<'_> {
    /// `base_from_flange` at a pose; the pose's target does not matter.
    ///
    /// # Errors
    ///
    /// [`PredictionError`], for a command that does not fit this robot, or a pose that it cannot take.
    pub fn flange<'q>(&mut self, pose: impl Into<PoseQuery<'q>>) -> Result<Transform, PredictionError> {
        self.place_robot(&pose.into())?;
        Ok(*self.forward.base_from_flange())
    }

    /// `base_from_flange` at a pose, and how a point of the flange frame (m) moves with every command: 6 x n, its motion in the base's axes (m)
    /// and the flange's rotation vector (rad), per m or rad of command. The derivatives are exact for the coupled modes and the geometric ones.
    /// The mode [`WithGravity`](super::Mode::WithGravity) takes its deflection from the nominal robot and holds it, which omits a hundredth of the
    /// whole, or three hundredths for a robot that is driven by cables.
    ///
    /// # Errors
    ///
    /// As [`flange`](Self::flange); and [`PredictionError::Machine`] where the equilibrium is hardly stable.
    pub fn by_command<'q>(
        &mut self,
        pose: impl Into<PoseQuery<'q>>,
        in_flange: &Vector3<f64>,
    ) -> Result<(Transform, Matrix6xX<f64>), PredictionError> {
        let pose = pose.into();
        self.place_robot(&pose)?;
        let mut motions = Matrix6xX::zeros(pose.command.len());
        self.motions_by_command(&pose, in_flange, true, &mut motions)?;
        Ok((*self.forward.base_from_flange(), motions))
    }

    /// How a point of the flange moves with every command where the robot was placed; with `turned`, also how the flange rotates.
    pub(crate) fn motions_by_command(
        &mut self,
        pose: &PoseQuery<'_>,
        in_flange: &Vector3<f64>,
        turned: bool,
        motions: &mut Matrix6xX<f64>,
    ) -> Result<(), PredictionError> {
        let told = self.forward.prepare(pose)?;
        let in_base = self.forward.target(in_flange);
        self.forward.differentiate(in_flange, &told)?;
        self.forward.by_command(pose, &in_base, |command, moved| {
            motions.fixed_view_mut::<3, 1>(0, command).copy_from(&moved);
        });
        if turned {
            self.forward.differentiate_turn(&told)?;
            self.forward.turn_by_command(pose, |command, turned| {
                motions.fixed_view_mut::<3, 1>(3, command).copy_from(&turned);
            });
        }
        Ok(())
    }
}

impl EstimatePredictor<'_> {
    /// Covariance of the predicted position of a point of the flange frame (m), in the base frame, m², from the parameters and the machine's
    /// noise beside its model. The point itself is taken as exact. `None` where the estimate has no covariance.
    ///
    /// # Errors
    ///
    /// [`PredictionError`].
    pub fn covariance_of<'q>(
        &mut self,
        pose: impl Into<PoseQuery<'q>>,
        in_flange: &Vector3<f64>,
    ) -> Result<Option<Matrix3<f64>>, PredictionError> {
        let pose = pose.into();
        let told = self.predictor.place_robot(&pose)?;
        let forward = &mut self.predictor.forward;
        forward.differentiate(in_flange, &told)?;
        let position = forward.target(in_flange);
        let parameters = &self.estimate.parameters;
        let mut jacobian = PositionJacobian::zeros(parameters.len());
        let mut term = 0;
        for (mut column, parameter) in jacobian.column_iter_mut().zip(parameters) {
            column.copy_from(&in_base_column(forward, parameter.id, OF_NO_TARGET, &position, &mut term));
        }
        let factor = self.estimate.factor.as_ref().filter(|factor| factor.nrows() == parameters.len());
        let motions = self.motions.at(pose.command, in_flange);
        let beside = |part: &MachineNoise| part.covariance(&motions);
        let of_machine = self.beside.iter().map(beside).sum::<Matrix3<f64>>();
        Ok(factor.map(|factor| {
            let spread = &jacobian * factor;
            &spread * spread.transpose() + of_machine
        }))
    }
}
