//! From what the controller commands to the joint variables of the link chain.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::LinkageLength;

/// The map from actuator commands to joint variables (SI, one actuator a joint).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum ActuatorMap {
    /// Every actuator moves its own joint.
    Direct,
    /// The elbow is driven through a parallelogram from a crank coaxial with the shoulder: its motor, grounded on the waist,
    /// sets `psi = q[shoulder] + q[elbow] - offset`.
    Parallelogram {
        /// Index of the shoulder joint.
        shoulder: usize,
        /// Index of the elbow joint, whose command is psi. It follows the shoulder.
        elbow: usize,
        /// rad
        offset: f64,
        /// Lengths of the real mechanism, where known. The map of this type is that of the exact parallelogram all the same; a four-bar is
        /// closed by the kinematics.
        linkage: Option<FourBar>,
    },
}

/// The spatial four-bar that drives the elbow: the crank turns about the shoulder's axis on the waist, the lever is part of the forearm,
/// and the coupler rod, on spherical joints, keeps their ends at its length.
///
/// The crank's frame is the shoulder's link frame as it would be at the joint variable `psi + offset + theta`, with theta that of the elbow's
/// link, and without the shoulder's bearing; the lever's frame is the elbow's link frame. So crank and lever are parallel in an exact
/// parallelogram, and an error of theta is one of the motor's zero, with a four-bar as without.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FourBar {
    /// The end of the crank in its frame.
    pub crank: LinkageArm,
    /// The end of the lever in the elbow's link frame.
    pub lever: LinkageArm,
    /// Length of the coupler rod, m.
    pub rod: f64,
}

/// A point at `(length cos(angle), length sin(angle), along)` of a frame that turns about z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LinkageArm {
    /// m
    pub length: f64,
    /// From the frame's x axis about z, rad.
    pub angle: f64,
    /// Along z, m.
    pub along: f64,
}

impl LinkageArm {
    /// The arm's end, m.
    pub fn end(&self) -> Vector3<f64> {
        let (sin, cos) = self.angle.sin_cos();
        Vector3::new(self.length * cos, self.length * sin, self.along)
    }
}

impl ActuatorMap {
    /// Writes the joint variables of `command` to `joints`; both as long as the chain. Where one is shorter, the rest is left as it is.
    pub fn joints_from_command(&self, command: &[f64], joints: &mut [f64]) {
        for (joint, command) in joints.iter_mut().zip(command) {
            *joint = *command;
        }
        if let Self::Parallelogram { shoulder, elbow, offset, .. } = *self
            && let (Some(joint), Some(psi), Some(upper)) =
                (joints.get_mut(elbow), command.get(elbow), command.get(shoulder))
        {
            *joint = psi + offset - upper;
        }
    }

    /// The four-bar between shoulder and elbow, where its lengths are known: (shoulder, elbow, offset, linkage).
    pub fn four_bar(&self) -> Option<(usize, usize, f64, &FourBar)> {
        match self {
            Self::Parallelogram { shoulder, elbow, offset, linkage: Some(linkage) } => {
                Some((*shoulder, *elbow, *offset, linkage))
            }
            _ => None,
        }
    }

    /// A length of the four-bar, m, where it is known.
    pub fn length(&self, which: LinkageLength) -> Option<f64> {
        let (_, _, _, linkage) = self.four_bar()?;
        Some(match which {
            LinkageLength::Crank => linkage.crank.length,
            LinkageLength::Lever => linkage.lever.length,
            LinkageLength::Rod => linkage.rod,
        })
    }

    /// The command that takes an ideal machine to `joints`.
    pub fn command_from_joints(&self, joints: &[f64]) -> Vec<f64> {
        let mut command = joints.to_vec();
        if let Self::Parallelogram { shoulder, elbow, offset, .. } = *self
            && let (Some(psi), Some(upper), Some(joint)) =
                (command.get_mut(elbow), joints.get(shoulder), joints.get(elbow))
        {
            *psi = upper + joint - offset;
        }
        command
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parallelogram_is_inverted_and_a_shoulder_move_does_not_turn_the_forearm() {
        let map = ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.25, linkage: None };
        let joints = [0.5, 0.1, -1.7, 0.12, 2.0];
        let mut command = map.command_from_joints(&joints);
        let mut back = [0.0; 5];
        map.joints_from_command(&command, &mut back);
        for (a, b) in joints.iter().zip(back) {
            assert!((a - b).abs() < 1e-15);
        }
        command[2] += 0.3;
        map.joints_from_command(&command, &mut back);
        let absolute = joints[2] + joints[3];
        assert!((back[2] + back[3] - absolute).abs() < 1e-15);
    }
}
