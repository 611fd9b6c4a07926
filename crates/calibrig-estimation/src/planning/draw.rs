//! Candidates that fill a box of joint variables.

use super::PlanError;
use super::session::within_limits;
use crate::identification::reachable_poses;
use calibrig_model::CalibrationModel;

/// Share of a joint's range at either end from which every second candidate is moved to the end.
const EDGE: f64 = 1.0 / 6.0;

/// Commands of this many candidates, spread evenly over a box of joint variables (lowest and highest of each, m or rad): a Kronecker sequence of the
/// generalised golden ratio, without randomness. For every second candidate the box is stretched about its middle, and values beyond an end are set
/// to the end (from a sixth of the range at either end): good designs are mostly at the edges of what is allowed, where a sequence has few points.
/// Joints that follow others go where these take them.
///
/// # Errors
///
/// [`PlanError`], for a box with another number of joints, with an end that is not finite or beyond the robot's limits, or with crossed ends.
pub fn candidate_commands(
    model: &CalibrationModel,
    region: &[[f64; 2]],
    count: usize,
) -> Result<Vec<Vec<f64>>, PlanError> {
    let expected = model.kinematics.joint_count();
    if region.len() != expected {
        let what = "the box of joint variables".to_owned();
        return Err(PlanError::Length { what, found: region.len(), expected });
    }
    if count == 0 {
        return Err(PlanError::NoCandidates);
    }
    let mut boxed = model.clone();
    for (joint, (link, ends)) in boxed.kinematics.links.iter_mut().zip(region).enumerate() {
        if !ends.iter().all(|end| end.is_finite()) {
            return Err(PlanError::NotFinite { what: format!("an end of the box at joint {}", joint + 1) });
        }
        if ends[0] > ends[1] {
            let field = "the width of the box at a joint";
            return Err(PlanError::Number { field, value: ends[1] - ends[0], expected: "zero or more" });
        }
        link.limits = *ends;
    }
    for (end, low) in [("lower", true), ("upper", false)] {
        let joints: Vec<f64> = region.iter().map(|ends| ends[usize::from(!low)]).collect();
        for (joint, (value, link)) in joints.iter().zip(&model.kinematics.links).enumerate() {
            let inside = *value >= link.limits[0] && *value <= link.limits[1];
            if !inside && model.actuators.is_commanded(joint) {
                let what = format!("the {end} end of the box");
                return Err(PlanError::OutsideLimits { what, joint, value: *value, limits: link.limits });
            }
        }
    }
    let mut poses = reachable_poses(&boxed, count);
    for joints in poses.iter_mut().skip(1).step_by(2) {
        for (value, [low, high]) in joints.iter_mut().zip(region) {
            let middle = 0.5 * (low + high);
            *value = (middle + (*value - middle) / (1.0 - 2.0 * EDGE)).clamp(*low, *high);
        }
        model.actuators.follow(joints);
    }
    let commands: Vec<Vec<f64>> =
        poses.iter().map(|joints| model.actuators.command_from_joints(joints)).collect();
    for (index, command) in commands.iter().enumerate() {
        within_limits(model, command, || format!("candidate {}", index + 1))?;
    }
    Ok(commands)
}
