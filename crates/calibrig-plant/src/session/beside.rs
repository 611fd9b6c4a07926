//! The same machine without any compliance, next to the measured one: deflections are the difference.

use std::ops::ControlFlow;

use nalgebra::Vector3;

use super::{MeasuredPose, SessionEvent, SessionListener};
use crate::effects::PoseEffects;
use crate::{AsBuilt, Plant, PlantError, SettleOptions, SettledPose};
use calibrig_model::geometry::Transform;

/// The machine with every spring rigid, on a rigid floor: the reference of its deflections.
pub struct RigidMachine(Plant);

impl RigidMachine {
    /// From the machine as built.
    pub fn new(as_built: &AsBuilt) -> Result<Self, PlantError> {
        let mut machine = as_built.clone();
        machine.statics.make_rigid();
        machine.effects.foundation = None;
        machine.effects.hoses = None;
        let options = SettleOptions { confirm: false, ..SettleOptions::default() };
        Ok(Self(Plant::new(&machine, options)?))
    }

    /// At a pose, its effects included.
    pub fn settle(&mut self, effects: &PoseEffects) -> Result<SettledPose, PlantError> {
        self.0.settle_displaced(&effects.command, &effects.displacements)
    }
}

/// Adds the rigid machine's pose to every pose that passes on the way to `listener`.
pub struct BesideRigid<'a, 'b> {
    listener: &'a mut SessionListener<'b>,
    machine: Option<RigidMachine>,
    /// In the flange frame, m.
    further_targets: Vec<Vector3<f64>>,
    last_from_flange: Transform,
    /// One vector per set, as [`Truth::rigid`](super::Truth::rigid).
    poses: Vec<Vec<SettledPose>>,
    failure: Option<PlantError>,
}

impl<'a, 'b> BesideRigid<'a, 'b> {
    /// Passes on to `listener`.
    pub fn new(listener: &'a mut SessionListener<'b>) -> Self {
        Self {
            listener,
            machine: None,
            further_targets: Vec::new(),
            last_from_flange: Transform::identity(),
            poses: Vec::new(),
            failure: None,
        }
    }

    /// The listener to give to a session.
    pub fn hear(&mut self, event: SessionEvent<'_>) -> ControlFlow<()> {
        match event {
            SessionEvent::Begin { as_built, further_targets, .. } => {
                self.further_targets = further_targets.to_vec();
                self.last_from_flange = as_built.kinematics.last_from_flange;
                match RigidMachine::new(as_built) {
                    Ok(machine) => self.machine = Some(machine),
                    Err(error) => return self.fail(error),
                }
            }
            SessionEvent::Set { .. } => self.poses.push(Vec::new()),
            SessionEvent::Measured(pose) => {
                let rigid = match self.settle(&pose) {
                    Ok(rigid) => rigid,
                    Err(error) => return self.fail(error),
                };
                let told = MeasuredPose { rigid: &rigid, ..pose };
                let go_on = (self.listener)(SessionEvent::Measured(told));
                if let Some(set) = self.poses.last_mut() {
                    set.extend(rigid);
                }
                return go_on;
            }
            SessionEvent::Dropped { .. } | SessionEvent::SetEnd { .. } => {}
        }
        (self.listener)(event)
    }

    /// One entry per reading, with the target that was observed.
    fn settle(&mut self, pose: &MeasuredPose<'_>) -> Result<Vec<SettledPose>, PlantError> {
        let Some(machine) = &mut self.machine else { return Ok(Vec::new()) };
        let mut before: Option<(&PoseEffects, SettledPose)> = None;
        let mut all = Vec::with_capacity(pose.observations.len());
        for (observation, effects) in pose.observations.iter().zip(pose.effects) {
            // All readings of a visit are of one machine at rest.
            let settled = match before.take() {
                Some((same, settled)) if same == effects => settled,
                _ => machine.settle(effects)?,
            };
            let mut own = settled.clone();
            let further = observation.target.checked_sub(1).and_then(|t| self.further_targets.get(t));
            if let (Some(in_flange), Some(last)) = (further, settled.links.last()) {
                let flange = last * self.last_from_flange;
                own.target = flange.rotation * in_flange + flange.translation.vector;
            }
            all.push(own);
            before = Some((effects, settled));
        }
        Ok(all)
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
