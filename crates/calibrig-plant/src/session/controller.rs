//! The machine between two poses: the memory of its controller and its drives.

use rand::Rng;

use super::{Machine, MeasuringSession};
use crate::effects::{Commanded, DriveState, PoseEffects, Warmth};
use crate::{AsBuilt, SettledPose};
use calibrig_model::measurement::Motion;

pub(super) struct Controller<'a> {
    as_built: &'a AsBuilt,
    pub motion: Motion,
    drives: DriveState,
}

impl<'a> Controller<'a> {
    /// Referenced at the home pose, with the drives as warm as before.
    pub(super) fn at_home(session: &MeasuringSession<'a>, warmth: Warmth) -> Self {
        let command = session.actuators.command_from_joints(&session.region.centre);
        let drives = DriveState { warmth, ..session.as_built.referenced_at(&command) };
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
        // The effects are too small to change the load on which they depend.
        let load = if self.as_built.effects.need_load() {
            self.as_built.drive_loads(&machine.pass(command)?)
        } else {
            Vec::new()
        };
        let pose = Commanded { command, time, load: &load };
        let (effects, drives) = self.as_built.pose_effects(&self.drives, &pose, rng);
        self.drives = drives;
        Ok(effects)
    }

    /// Goes to a command only for the heat of its drives.
    pub(super) fn warm(&mut self, command: &[f64], time: f64) {
        self.drives = self.as_built.warmed(&self.drives, command, time);
    }

    /// Its drives' heat.
    pub(super) fn warmth(&self) -> &Warmth {
        &self.drives.warmth
    }
}
