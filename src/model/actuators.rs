//! From what the controller commands to the joint variables of the link chain.

/// The map from actuator commands to joint variables (SI, one actuator a joint).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ActuatorMap {
    /// Every actuator moves its own joint.
    Direct,
    /// The elbow is driven through a parallelogram from a crank coaxial with the shoulder: its motor, grounded on the waist,
    /// sets `psi = q[shoulder] + q[elbow] - offset`.
    Parallelogram {
        /// Index of the shoulder joint.
        shoulder: usize,
        /// Index of the elbow joint, whose command is psi.
        elbow: usize,
        /// rad
        offset: f64,
    },
}

impl ActuatorMap {
    /// Writes the joint variables of `command` to `joints`; both as long as the chain.
    pub fn joints_from_command(&self, command: &[f64], joints: &mut [f64]) {
        joints.copy_from_slice(command);
        if let Self::Parallelogram { shoulder, elbow, offset } = *self {
            joints[elbow] = command[elbow] + offset - command[shoulder];
        }
    }

    /// The command that takes an ideal machine to `joints`.
    pub fn command_from_joints(&self, joints: &[f64]) -> Vec<f64> {
        let mut command = joints.to_vec();
        if let Self::Parallelogram { shoulder, elbow, offset } = *self {
            command[elbow] = joints[shoulder] + joints[elbow] - offset;
        }
        command
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parallelogram_is_inverted_and_a_shoulder_move_does_not_turn_the_forearm() {
        let map = ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.25 };
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
