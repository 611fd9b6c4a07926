//! A load on the flange: one more load of the last link, for as long as it hangs there.

use super::{Plant, PlantError};
use calibrig_model::{Payload, PointLoad};
use nalgebra::Point3;

impl Plant {
    /// Hangs a load on the flange, or takes it off, for all later poses.
    ///
    /// # Errors
    ///
    /// [`PlantError`], for an invalid load; the previous load then stays.
    pub fn carry(&mut self, payload: Option<&Payload>) -> Result<(), PlantError> {
        if self.payload.as_ref() == payload {
            return Ok(());
        }
        let mut robot = self.robot.clone();
        let own = robot.statics.loads.len() - usize::from(self.payload.is_some());
        robot.statics.loads.truncate(own);
        robot.statics.loads.extend(payload.map(|payload| PointLoad {
            name: payload.name.clone(),
            link: robot.kinematics.joint_count().saturating_sub(1),
            at: (robot.kinematics.last_from_flange * Point3::from(payload.centre)).coords,
            mass: payload.mass,
            force: payload.force,
        }));
        let mut loaded = Self::new(&robot, self.options)?;
        loaded.payload = payload.cloned();
        loaded.newton_steps = self.newton_steps;
        *self = loaded;
        Ok(())
    }
}
