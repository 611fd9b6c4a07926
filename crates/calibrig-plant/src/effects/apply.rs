//! All effects of a machine at one pose.

use nalgebra::Point3;
use rand::Rng;

use super::{EffectError, GrowingPart};
use crate::AsBuilt;
use calibrig_model::geometry::rotation_z;

/// Where the drives stand between two poses: what the next pose remembers of the way to it. One entry an actuator.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveState {
    /// Position of the motor, m or rad.
    pub motor: Vec<f64>,
    /// How far the driven side stands ahead of the motor within its play, m or rad.
    pub ahead: Vec<f64>,
    /// Friction force as a share of its limit.
    pub friction: Vec<f64>,
}

/// A pose as the controller asks for it.
#[derive(Debug, Clone, Copy)]
pub struct Commanded<'a> {
    /// One entry an actuator, m or rad.
    pub command: &'a [f64],
    /// Since the session began, s.
    pub time: f64,
    /// Load of every drive (N or N m), where friction depends on it; else empty.
    pub load: &'a [f64],
}

/// What the effects make of a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseEffects {
    /// Where the actuators really are, without their elasticity, m or rad.
    pub command: Vec<f64>,
    /// Displacement of every link's frame: along its x, y, z (m), about them (rad).
    pub displacements: Vec<[f64; 6]>,
    /// Of the air, °C, where the machine feels it.
    pub temperature: Option<f64>,
}

impl AsBuilt {
    /// Refuses effects whose numbers make no machine, also in a session of `duration` s.
    pub fn check_effects(&self, duration: f64) -> Result<(), EffectError> {
        self.effects.check(self.kinematics.joint_count(), self.actuators.four_bar().is_some())?;
        self.effects.thermal.as_ref().map_or(Ok(()), |thermal| thermal.check_session(duration))
    }

    /// At rest at a command, with the play in its middle and the friction relaxed, as after referencing.
    pub fn referenced_at(&self, command: &[f64]) -> DriveState {
        let nothing = vec![0.0; command.len()];
        DriveState { motor: self.motors(command), ahead: nothing.clone(), friction: nothing }
    }

    /// The effects at a pose that is approached from `before`, and where the drives then stand.
    ///
    /// `rng` is the pose's own. The effects must have passed [`check_effects`](Self::check_effects).
    pub fn pose_effects(
        &self,
        before: &DriveState,
        pose: &Commanded<'_>,
        rng: &mut impl Rng,
    ) -> (PoseEffects, DriveState) {
        let state = self.drive_state(before, pose.command);
        let mut command = self.driven(&state, pose.load);
        if let Some(repeatability) = &self.effects.repeatability {
            for (position, error) in command.iter_mut().zip(repeatability.draw(rng)) {
                *position += error;
            }
        }
        let displacements = self.displacements(&mut command, pose.time);
        let temperature = self.effects.thermal.as_ref().map(|thermal| thermal.ambient.at(pose.time));
        (PoseEffects { command, displacements, temperature }, state)
    }

    fn motors(&self, command: &[f64]) -> Vec<f64> {
        let Some(encoder) = &self.effects.encoder else { return command.to_vec() };
        command.iter().enumerate().map(|(actuator, command)| encoder.motor(actuator, *command)).collect()
    }

    fn drive_state(&self, before: &DriveState, command: &[f64]) -> DriveState {
        let mut state = before.clone();
        state.motor = self.motors(command);
        for (actuator, now) in state.motor.iter().enumerate() {
            let motion = now - before.motor[actuator];
            if let Some(backlash) = &self.effects.backlash {
                state.ahead[actuator] = backlash.ahead_after(actuator, before.ahead[actuator], motion);
            }
            if let Some(friction) = &self.effects.friction {
                state.friction[actuator] = friction.share_after(actuator, before.friction[actuator], motion);
            }
        }
        state
    }

    /// Where the driven sides are.
    fn driven(&self, state: &DriveState, load: &[f64]) -> Vec<f64> {
        let effects = &self.effects;
        let position = |(actuator, &motor): (usize, &f64)| {
            let mut position = motor;
            if let Some(ratio) = &effects.ratio {
                position += ratio.error(actuator, motor);
            }
            if let Some(harmonics) = &effects.harmonics {
                position += harmonics.error(actuator, motor);
            }
            if effects.backlash.is_some() {
                position += state.ahead[actuator];
            }
            if let Some(friction) = &effects.friction {
                let load = load.get(actuator).copied().unwrap_or(0.0);
                let stiffness = self.statics.drive_stiffness[actuator];
                position += friction.deflection(actuator, state.friction[actuator], load, stiffness);
            }
            position
        };
        state.motor.iter().enumerate().map(position).collect()
    }

    /// Displacements of the links' frames. A rod that grows turns the crank of `command` instead.
    fn displacements(&self, command: &mut [f64], time: f64) -> Vec<[f64; 6]> {
        let mut displacements = vec![[0.0; 6]; command.len()];
        if let Some(rail) = &self.effects.rail {
            displacements[rail.joint] = rail.displacement(command[rail.joint]);
        }
        let Some(thermal) = &self.effects.thermal else { return displacements };
        for growth in &thermal.growths {
            let strain = thermal.strain(growth, time);
            match growth.part {
                GrowingPart::Link { joint, axis } => {
                    let travel = if growth.with_travel { command[joint] } else { 0.0 };
                    displacements[joint][axis] += strain * (growth.length + travel);
                }
                GrowingPart::Rod => self.grow_rod(strain, command),
            }
        }
        displacements
    }

    /// Turns the crank by as much as brings its end nearer to the lever's as the rod would have grown: to first order the same, at the elbow
    /// of the exact parallelogram.
    fn grow_rod(&self, strain: f64, command: &mut [f64]) {
        let Some((shoulder, elbow, offset, linkage)) = self.actuators.four_bar() else { return };
        let mut positions = command.to_vec();
        self.actuators.actuators_from_command(command, &mut positions);
        let crank_angle = positions[elbow] + offset;
        let theta = self.kinematics.links[elbow].theta;
        let end = rotation_z(crank_angle + theta) * Point3::from(linkage.crank.end());
        let upper_arm = rotation_z(positions[shoulder]) * self.kinematics.links[elbow].fixed_part();
        let lever =
            upper_arm * rotation_z(crank_angle - positions[shoulder]) * Point3::from(linkage.lever.end());
        let along_rod = (end - lever).normalize();
        // z × end
        let motion = nalgebra::Vector3::new(-end.y, end.x, 0.0);
        positions[elbow] -= strain * linkage.rod / along_rod.dot(&motion);
        command.copy_from_slice(&self.actuators.command_from_actuators(&positions));
    }
}
