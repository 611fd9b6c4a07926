//! What calibration made of measurements.

use nalgebra::Vector3;

use super::AccuracyRow;
use crate::identification::{CalibratedRobot, Estimate, Mode};

/// How the tracker's frame was tied to the robot's for the row "without calibration".
#[derive(Debug, Clone, PartialEq)]
pub struct RegistrationSummary {
    /// In words.
    pub how: String,
    /// Poses used.
    pub poses: usize,
    /// RMS of the 3-D residual of the fit, m.
    pub rms: f64,
}

/// What one mode made of the measurements.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeOutcome {
    /// Which.
    pub mode: Mode,
    /// The robot that predicts.
    pub robot: CalibratedRobot,
    /// How it was identified; `None` for "without calibration".
    pub estimate: Option<Estimate>,
    /// Measured minus predicted in the base frame, m: one vector a set of the session, one entry an observation.
    pub errors: Vec<Vec<Vector3<f64>>>,
    /// The rows of the tables, one a set.
    pub rows: Vec<Option<AccuracyRow>>,
}
