//! The machine between two poses: what its controller and its drives remember.

use rand::Rng;

use super::{Machine, MeasuringSession};
use crate::effects::{Commanded, DriveState, Friction, PoseEffects};
use crate::{AsBuilt, SettledPose};
use calibrig_model::measurement::Motion;

pub(super) struct Controller<'a> {
    as_built: &'a AsBuilt,
    pub motion: Motion,
    drives: DriveState,
}

impl<'a> Controller<'a> {
    pub(super) fn at_home(session: &MeasuringSession<'a>) -> Self {
        let command = session.actuators.command_from_joints(&session.region.centre);
        let drives = session.as_built.referenced_at(&command);
        Self { as_built: session.as_built, motion: Motion::at(&command), drives }
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
        self.motion.go_to(command, 0.0);
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
