//! rapier
use thiserror::Error;

use super::{AsBuilt, SettledPose};

/// A plant that cannot be built or does not settle.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlantError {}

/// When a pose counts as settled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SettleOptions {}

/// The rapier multibody of one robot.
pub struct Plant {}

impl Plant {
    /// Builds it.
    pub fn new(robot: &AsBuilt, options: SettleOptions) -> Result<Self, PlantError> {
        let _ = (robot, options);
        unimplemented!()
    }

    /// The pose at rest under gravity at a command (SI, one an actuator).
    pub fn settle(&mut self, command: &[f64]) -> Result<SettledPose, PlantError> {
        let _ = command;
        unimplemented!()
    }
}
