//! The machine between two poses: what its controller and its drives remember.

use rand::Rng;

use super::{Machine, MeasuringSession};
use crate::effects::{Commanded, DriveState, Friction, PoseEffects};
use crate::{AsBuilt, SettledPose};

pub(super) struct Controller<'a> {
    as_built: &'a AsBuilt,
    command: Vec<f64>,
    /// The sign of each actuator's last motion, 0 before its first.
    pub approach: Vec<i8>,
    drives: DriveState,
}

impl<'a> Controller<'a> {
    pub(super) fn at_home(session: &MeasuringSession<'a>) -> Self {
        let command = session.actuators.command_from_joints(&session.region.centre);
        let drives = session.as_built.referenced_at(&command);
        Self { as_built: session.as_built, approach: vec![0; command.len()], command, drives }
    }

    /// Approaches a command and comes to rest.
    pub(super) fn go_to<M: Machine>(
        &mut self,
        machine: &mut M,
        command: &[f64],
        time: f64,
        rng: &mut impl Rng,
    ) -> Result<(SettledPose, PoseEffects), M::Error> {
        let effects = self.pass(machine, command, time, rng)?;
        let settled = machine.settle(&effects.command, &effects.displacements)?;
        Ok((settled, effects))
    }

    /// Approaches a command, to go on from there.
    pub(super) fn pass<M: Machine>(
        &mut self,
        machine: &mut M,
        command: &[f64],
        time: f64,
        rng: &mut impl Rng,
    ) -> Result<PoseEffects, M::Error> {
        for (approach, (now, before)) in self.approach.iter_mut().zip(command.iter().zip(&self.command)) {
            match now.total_cmp(before) {
                std::cmp::Ordering::Less => *approach = -1,
                std::cmp::Ordering::Equal => {}
                std::cmp::Ordering::Greater => *approach = 1,
            }
        }
        self.command.copy_from_slice(command);
        let needs_load = self.as_built.effects.friction.as_ref().is_some_and(Friction::needs_load);
        // Friction is too small to change the load that it depends on.
        let load = if needs_load { self.drive_loads(&machine.settle(command, &[])?) } else { Vec::new() };
        let pose = Commanded { command, time, load: &load };
        let (effects, drives) = self.as_built.pose_effects(&self.drives, &pose, rng);
        self.drives = drives;
        Ok(effects)
    }

    /// Load of every drive, N or N m; zero for a rigid drive, which no load deflects.
    fn drive_loads(&self, settled: &SettledPose) -> Vec<f64> {
        let drives = settled.deflection.iter().zip(&self.as_built.statics.drive_stiffness);
        drives.map(|(u, k)| if k.is_finite() { u * k } else { 0.0 }).collect()
    }
}
