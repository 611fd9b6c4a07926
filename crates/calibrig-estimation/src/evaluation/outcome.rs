//! What calibration made of measurements.

use nalgebra::Vector3;

use super::{AccuracyRow, OrientationRow, orientation_accuracy};
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
    /// Measured against predicted orientations, rotation vectors in base axes, rad: as `errors`; `None` of a reading without one.
    pub turns: Vec<Vec<Option<Vector3<f64>>>>,
}

impl ModeOutcome {
    /// The row of a set's orientations; `None` where it has none.
    pub fn orientation_row(&self, set: usize) -> Option<OrientationRow> {
        orientation_accuracy(self.turns.get(set)?)
    }
}
