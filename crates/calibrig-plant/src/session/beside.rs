//! The same machine without any compliance, beside the one that is measured: what deflections are told from.

use std::ops::ControlFlow;

use super::{MeasuredPose, SessionEvent, SessionListener};
use crate::effects::PoseEffects;
use crate::{AsBuilt, Plant, PlantError, SettleOptions, SettledPose};

/// The machine with every spring of it rigid: what its deflections are told from.
pub struct RigidMachine(Plant);

impl RigidMachine {
    /// From the machine as built.
    pub fn new(as_built: &AsBuilt) -> Result<Self, PlantError> {
        let mut machine = as_built.clone();
        machine.statics.make_rigid();
        Ok(Self(Plant::new(&machine, SettleOptions::default())?))
    }

    /// At a pose, its effects included.
    pub fn settle(&mut self, effects: &PoseEffects) -> Result<SettledPose, PlantError> {
        self.0.settle_displaced(&effects.command, &effects.displacements)
    }
}

/// Places the rigid machine beside every pose that passes on the way to `listener`.
pub struct BesideRigid<'a, 'b> {
    listener: &'a mut SessionListener<'b>,
    machine: Option<RigidMachine>,
    /// One vector a set, as [`Truth::rigid`](super::Truth::rigid).
    poses: Vec<Vec<SettledPose>>,
    failure: Option<PlantError>,
}

impl<'a, 'b> BesideRigid<'a, 'b> {
    /// Passes on to `listener`.
    pub fn new(listener: &'a mut SessionListener<'b>) -> Self {
        Self { listener, machine: None, poses: Vec::new(), failure: None }
    }

    /// The listener to give to a session.
    pub fn hear(&mut self, event: SessionEvent<'_>) -> ControlFlow<()> {
        match event {
            SessionEvent::Begin { as_built, .. } => match RigidMachine::new(as_built) {
                Ok(machine) => self.machine = Some(machine),
                Err(error) => return self.fail(error),
            },
            SessionEvent::Set { .. } => self.poses.push(Vec::new()),
            SessionEvent::Measured(pose) => {
                let (Some(machine), Some(set)) = (&mut self.machine, self.poses.last_mut()) else {
                    return (self.listener)(event);
                };
                match machine.settle(pose.effects) {
                    Ok(rigid) => {
                        let told = MeasuredPose { rigid: Some(&rigid), ..pose };
                        let go_on = (self.listener)(SessionEvent::Measured(told));
                        set.push(rigid);
                        return go_on;
                    }
                    Err(error) => return self.fail(error),
                }
            }
            SessionEvent::Dropped { .. } | SessionEvent::SetEnd { .. } => {}
        }
        (self.listener)(event)
    }

    fn fail(&mut self, error: PlantError) -> ControlFlow<()> {
        self.failure = Some(error);
        ControlFlow::Break(())
    }

    /// The rigid machine at every measured pose, or why it could not be brought to rest.
    pub fn finish(self) -> Result<Vec<Vec<SettledPose>>, PlantError> {
        self.failure.map_or(Ok(self.poses), Err)
    }
}
