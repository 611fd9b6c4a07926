//! URDF.

use thiserror::Error;

/// A URDF that does not fit.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum UrdfError {}

/// What a URDF says.
#[derive(Debug, Clone)]
pub struct UrdfRobot {}
