//! All effects of a machine at one pose.

use nalgebra::Point3;
use rand::Rng;

use super::{EffectError, GrowingPart, StiffnessCurve, Warmth};
use crate::{AsBuilt, SettledPose};
use calibrig_model::JointKind;
use calibrig_model::geometry::rotation_z;

/// State of the drives between two poses: what the next pose remembers of the way to it. One entry per actuator.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveState {
    /// Position of the motor, m or rad.
    pub motor: Vec<f64>,
    /// How far the driven side is ahead of the motor within its play, m or rad.
    pub ahead: Vec<f64>,
    /// The same within its lost motion under load.
    pub flank: Vec<f64>,
    /// Friction force as a share of its limit.
    pub friction: Vec<f64>,
    /// The heat of the drives.
    pub warmth: Warmth,
}

/// A pose as commanded by the controller.
#[derive(Debug, Clone, Copy)]
pub struct Commanded<'a> {
    /// One entry per actuator, m or rad.
    pub command: &'a [f64],
    /// Since the session began, s.
    pub time: f64,
    /// Load of every drive (N or N m), above zero if it pushes the driven side ahead; empty if no effect depends on it.
    pub load: &'a [f64],
}

/// The result of all effects at a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseEffects {
    /// The actuators' real positions, without their elasticity, m or rad.
    pub command: Vec<f64>,
    /// Displacement of every link's frame: along its x, y, z (m), about them (rad).
    pub displacements: Vec<[f64; 6]>,
    /// Of the air, °C, where the machine is.
    pub temperature: Option<f64>,
}

impl AsBuilt {
    /// Refuses effects with invalid numbers, also for a session of `duration` s.
    pub fn check_effects(&self, duration: f64) -> Result<(), EffectError> {
        self.effects.check(self.kinematics.joint_count(), self.actuators.four_bar().is_some())?;
        if let Some(lost_motion) = &self.effects.lost_motion {
            lost_motion.check(&self.greatest_loads())?;
        }
        self.effects.thermal.as_ref().map_or(Ok(()), |thermal| thermal.check_session(duration))
    }

    /// At rest at a command, with the play centred and the friction relaxed, as after referencing.
    pub fn referenced_at(&self, command: &[f64]) -> DriveState {
        let nothing = vec![0.0; command.len()];
        DriveState {
            motor: self.motors(command),
            ahead: nothing.clone(),
            flank: nothing.clone(),
            friction: nothing,
            warmth: Warmth::default(),
        }
    }

    /// Load on a drive as a function of its deflection, if its stiffness increases; `None` for a linear or a rigid
    /// drive.
    pub(crate) fn curve(&self, joint: usize) -> Option<&StiffnessCurve> {
        let curve = self.effects.stiffening.as_ref()?.actuators.get(joint)?.as_ref()?;
        self.statics.drive_stiffness.get(joint)?.is_finite().then_some(curve)
    }

    /// Load of every drive in a settled pose, N or N m; zero for a rigid drive, which no load deflects.
    pub fn drive_loads(&self, settled: &SettledPose) -> Vec<f64> {
        let drives = settled.deflection.iter().zip(&self.statics.drive_stiffness).enumerate();
        let load = |(joint, (&u, &k)): (usize, (&f64, &f64))| match self.curve(joint) {
            Some(curve) => curve.tangent_and_load(k, u).1,
            None if k.is_finite() => u * k,
            None => 0.0,
        };
        drives.map(load).collect()
    }

    /// The stiffness of a linear drive that would deflect as far under the mean load of `session`, N/m or N m/rad: the drive's own or, for a
    /// stiffening one, the secant at the mean size of the load. `None` if there is no such drive, or its load is unknown.
    pub fn secant_stiffness(&self, joint: usize, session: &[SettledPose]) -> Option<f64> {
        let stiffness = *self.statics.drive_stiffness.get(joint)?;
        let Some(curve) = self.curve(joint) else { return Some(stiffness) };
        let load = |pose: &SettledPose| {
            pose.deflection.get(joint).map(|u| curve.tangent_and_load(stiffness, *u).1.abs())
        };
        let loads = session.iter().map(load).collect::<Option<Vec<f64>>>()?;
        let mean = loads.iter().sum::<f64>() / loads.len() as f64;
        mean.is_finite().then(|| curve.secant(stiffness, mean))
    }

    /// Upper bound on the load of each drive by the weights and forces behind it, N or N m: with all of them as far from its axis as the links
    /// reach.
    fn greatest_loads(&self) -> Vec<f64> {
        let (links, statics) = (&self.kinematics.links, &self.statics);
        let mut rotation = self.kinematics.base_from_first.rotation;
        let mut turned = false;
        let of_drive = |joint: usize| {
            let link = &links[joint];
            rotation *= link.fixed_part().rotation;
            // Only turning joints in front can bring gravity to act on an axis on which it does not act now.
            let along = rotation.inverse() * statics.gravity;
            let gravity = match link.kind {
                _ if turned => along.norm(),
                JointKind::Revolute => along.xy().norm(),
                JointKind::Prismatic => along.z.abs(),
            };
            turned |= link.kind == JointKind::Revolute;
            let mut reach = 0.0;
            let mut load = 0.0;
            for (carried, body) in statics.bodies.iter().enumerate().skip(joint) {
                let lever = |at: f64| if link.kind == JointKind::Revolute { reach + at } else { 1.0 };
                load += body.mass * gravity * lever(body.centre_of_mass.norm());
                for own in statics.loads.iter().filter(|own| own.link == carried) {
                    load += (own.mass * gravity + own.force.norm()) * lever(own.at.norm());
                }
                if let Some(next) = links.get(carried + 1) {
                    let travel = match next.kind {
                        JointKind::Revolute => 0.0,
                        JointKind::Prismatic => next.limits[0].abs().max(next.limits[1].abs()),
                    };
                    reach += next.a.abs() + next.d.abs() + travel;
                }
            }
            load + self.linkage_load(joint, gravity)
        };
        (0..links.len()).map(of_drive).collect()
    }

    /// Upper bound on the load of crank and rod on a drive in front of them, or on the crank's own drive, N or N m.
    fn linkage_load(&self, joint: usize, gravity: f64) -> f64 {
        match (self.actuators.four_bar(), &self.statics.linkage) {
            (Some((shoulder, elbow, _, bars)), Some(statics)) if joint <= shoulder || joint == elbow => {
                let links = self.kinematics.links.get(joint..=shoulder).unwrap_or_default();
                let reach: f64 = links.iter().map(|link| link.a.abs() + link.d.abs()).sum();
                let crank = statics.crank.mass * (reach + statics.crank.centre_of_mass.norm());
                gravity * (crank + statics.rod_mass * (reach + bars.crank.length + bars.rod))
            }
            _ => 0.0,
        }
    }

    /// The effects at a pose that is approached from `before`, and the drives' state afterwards.
    ///
    /// `rng` is the pose's own. The effects must have passed [`check_effects`](Self::check_effects).
    pub fn pose_effects(
        &self,
        before: &DriveState,
        pose: &Commanded<'_>,
        rng: &mut impl Rng,
    ) -> (PoseEffects, DriveState) {
        let state = self.drive_state(before, pose);
        let mut command = self.driven(&state, pose.load);
        if let Some(repeatability) = &self.effects.repeatability {
            for (position, error) in command.iter_mut().zip(repeatability.draw(rng)) {
                *position += error;
            }
        }
        let displacements = self.displacements(&mut command, &state.warmth, pose.time);
        let temperature = self.effects.thermal.as_ref().map(|thermal| thermal.ambient.at(pose.time));
        (PoseEffects { command, displacements, temperature }, state)
    }

    fn motors(&self, command: &[f64]) -> Vec<f64> {
        let Some(encoder) = &self.effects.encoder else { return command.to_vec() };
        command.iter().enumerate().map(|(actuator, command)| encoder.motor(actuator, *command)).collect()
    }

    /// The drives' heat and the motors' positions after a motion to a command that ends at `time` s.
    pub(crate) fn warmed(&self, before: &DriveState, command: &[f64], time: f64) -> DriveState {
        let mut state = DriveState { motor: self.motors(command), ..before.clone() };
        if let Some(thermal) = self.effects.thermal.as_ref().filter(|thermal| thermal.is_heated()) {
            let motions: Vec<f64> =
                state.motor.iter().zip(&before.motor).map(|(now, before)| now - before).collect();
            state.warmth = thermal.warmth_after(&before.warmth, time, &motions);
        }
        state
    }

    fn drive_state(&self, before: &DriveState, pose: &Commanded<'_>) -> DriveState {
        let mut state = self.warmed(before, pose.command, pose.time);
        for (actuator, now) in state.motor.iter().enumerate() {
            let motion = now - before.motor[actuator];
            if let Some(backlash) = &self.effects.backlash {
                state.ahead[actuator] = backlash.ahead_after(actuator, before.ahead[actuator], motion);
            }
            if let Some(lost_motion) = &self.effects.lost_motion {
                let load = pose.load.get(actuator).copied().unwrap_or(0.0);
                state.flank[actuator] =
                    lost_motion.ahead_after(actuator, before.flank[actuator], motion, load);
            }
            if let Some(friction) = &self.effects.friction {
                state.friction[actuator] = friction.share_after(actuator, before.friction[actuator], motion);
            }
        }
        state
    }

    /// Positions of the driven sides.
    fn driven(&self, state: &DriveState, load: &[f64]) -> Vec<f64> {
        let effects = &self.effects;
        let position = |(actuator, &motor): (usize, &f64)| {
            let mut position = motor;
            let load = load.get(actuator).copied().unwrap_or(0.0);
            if let Some(ratio) = &effects.ratio {
                position += ratio.error(actuator, motor);
            }
            if let Some(harmonics) = &effects.harmonics {
                position += harmonics.error(actuator, motor);
            }
            if let Some(transmission) = &effects.transmission {
                position += transmission.error(actuator, motor, load);
            }
            position += state.ahead[actuator];
            position += state.flank[actuator];
            if let Some(friction) = &effects.friction {
                let (share, stiffness) = (state.friction[actuator], self.statics.drive_stiffness[actuator]);
                position += match self.curve(actuator) {
                    None => friction.force(actuator, share, load) / stiffness,
                    Some(curve) => {
                        let under = |load: f64| curve.deflection(stiffness, load);
                        under(load + friction.force(actuator, share, load)) - under(load)
                    }
                };
            }
            position
        };
        state.motor.iter().enumerate().map(position).collect()
    }

    /// Displacements of the links' frames. A growing rod turns the crank of `command` instead.
    fn displacements(&self, command: &mut [f64], warmth: &Warmth, time: f64) -> Vec<[f64; 6]> {
        let mut displacements = vec![[0.0; 6]; command.len()];
        if let Some(rail) = &self.effects.rail {
            displacements[rail.joint] = rail.displacement(command[rail.joint]);
        }
        let Some(thermal) = &self.effects.thermal else { return displacements };
        for (part, growth) in thermal.growths.iter().enumerate() {
            let rise = warmth.rise.get(part).copied().unwrap_or(0.0);
            let strain = thermal.strain(growth, time, rise);
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

    /// Turns the crank so that its end comes as much nearer to the lever's as the rod would have grown: the same to first order, at the
    /// elbow of the exact parallelogram.
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
