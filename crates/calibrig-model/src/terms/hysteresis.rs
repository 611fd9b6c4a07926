//! The sign of the approach: half of what backlash and friction leave between the two directions.

use super::{TermFamily, TermPlace, is_linear, joint_variable, parse_joint_variable};
use crate::{CalibrationModel, PoseQuery};

/// One amplitude per actuator: it stops this far on the side that it came from.
pub(super) struct HysteresisTerms;

impl TermFamily for HysteresisTerms {
    fn key(&self) -> &'static str {
        "hysteresis"
    }

    fn about(&self) -> &'static str {
        "an offset of every actuator with the sign of its approach"
    }

    fn terms(&self, model: &CalibrationModel) -> Vec<(usize, usize, bool)> {
        (0..model.kinematics.joint_count()).map(|joint| (joint, 0, is_linear(model, joint))).collect()
    }

    fn place(&self, joint: usize, _: usize) -> TermPlace {
        TermPlace::Actuator(joint)
    }

    fn basis(&self, _: &CalibrationModel, joint: usize, _: usize, input: &PoseQuery<'_>) -> f64 {
        input.approach.get(joint).copied().map_or(0.0, f64::from)
    }

    fn prior_sigma(&self, _: bool) -> f64 {
        // 1 mm or 1 mrad: more than a machine in service has.
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
