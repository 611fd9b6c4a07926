//! Hysteresis that builds up: the part still missing while an actuator has hardly moved since it reversed.
//!
//! Friction between a drive and its encoder, and the wind-up that it holds, change sides over a distance: after a reversal, `exp(-distance /
//! length)` of the difference is still to come (P. R. Dahl, AIAA Journal 14 (1976) 1675, on friction before sliding). The sum over lengths a factor
//! of four apart approximates any curve between them. Beyond them it has saturated, and only the term `hysteresis` is left.

use super::{TermFamily, TermPlace, is_linear, joint_variable};
use crate::{CalibrationModel, PoseQuery};

/// One amplitude per actuator and length: how far it still is on the side of the motion right after the reversal.
pub(super) struct PreslidingTerms;

/// By index, mm or degrees.
const LENGTHS: [f64; 3] = [0.5, 2.0, 8.0];

impl TermFamily for PreslidingTerms {
    fn key(&self) -> &'static str {
        "presliding"
    }

    fn about(&self) -> &'static str {
        "the rest of the hysteresis that builds up after a reversal, over 0.5, 2 and 8 mm or degrees"
    }

    fn terms(&self, model: &CalibrationModel) -> Vec<(usize, usize, bool)> {
        let joints = 0..model.kinematics.joint_count();
        joints
            .flat_map(|joint| (0..LENGTHS.len()).map(move |index| (joint, index, is_linear(model, joint))))
            .collect()
    }

    fn place(&self, joint: usize, _: usize) -> TermPlace {
        TermPlace::Actuator(joint)
    }

    fn basis(&self, model: &CalibrationModel, joint: usize, index: usize, input: &PoseQuery<'_>) -> f64 {
        let (Some(sign), Some(way), Some(length)) =
            (input.approach.get(joint), input.since_reversal.get(joint), LENGTHS.get(index))
        else {
            // Most motions are long.
            return 0.0;
        };
        let length = if is_linear(model, joint) { 1e-3 * length } else { length.to_radians() };
        f64::from(*sign) * (-way / length).exp()
    }

    fn prior_sigma(&self, _: bool) -> f64 {
        // As the hysteresis itself.
        1e-3
    }

    fn suffix(&self, joint: usize, index: usize, linear: bool) -> String {
        format!("{}_{}", joint_variable(joint, linear), index + 1)
    }

    fn parse(&self, suffix: &str) -> Option<(usize, usize, bool)> {
        super::parse_counted(suffix, LENGTHS.len())
    }

    fn is_on_request(&self) -> bool {
        true
    }

    fn is_of_unknown_size(&self) -> bool {
        // Most machines show hardly any; the prior size of those that do would cost them a quarter of the error.
        true
    }

    fn extends(&self) -> Option<&'static str> {
        Some("hysteresis")
    }
}
