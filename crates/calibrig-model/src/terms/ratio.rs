//! A transmission whose ratio is not the stated one: a gear's, a spindle's or a rail rack's pitch.

use super::{
    TermFamily, TermPlace, half_travel, is_linear, joint_variable, middle_command, parse_joint_variable,
};
use crate::{CalibrationModel, PoseQuery};

/// One amplitude per actuator: its error at the end of its travel, with none in the middle.
///
/// A displacement, not a fraction, so that it has the unit of its joint; without a constant part, which is the joint's offset.
pub(super) struct RatioTerms;

impl TermFamily for RatioTerms {
    fn key(&self) -> &'static str {
        "ratio"
    }

    fn about(&self) -> &'static str {
        "an error of a gear ratio or a pitch, as the displacement at the end of the travel"
    }

    fn terms(&self, model: &CalibrationModel) -> Vec<(usize, usize, bool)> {
        (0..model.kinematics.joint_count()).map(|joint| (joint, 0, is_linear(model, joint))).collect()
    }

    fn place(&self, joint: usize, _: usize) -> TermPlace {
        TermPlace::Actuator(joint)
    }

    fn basis(&self, model: &CalibrationModel, joint: usize, _: usize, input: &PoseQuery<'_>) -> f64 {
        let (Some(command), Some(link)) = (input.command.get(joint), model.kinematics.links.get(joint))
        else {
            return 0.0;
        };
        (command - middle_command(model, joint)) / half_travel(link)
    }

    fn prior_sigma(&self, _: bool) -> f64 {
        // 1 mm or 1 mrad at the end: 0.05 % of 2 m, 0.03 % of half a turn.
        1e-3
    }

    fn suffix(&self, joint: usize, _: usize, linear: bool) -> String {
        joint_variable(joint, linear)
    }

    fn parse(&self, suffix: &str) -> Option<(usize, usize, bool)> {
        let (joint, linear) = parse_joint_variable(suffix)?;
        Some((joint, 0, linear))
    }
}
