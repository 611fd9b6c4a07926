//! Results of a calibration.

use nalgebra::Vector3;

use super::{AccuracyRow, OrientationRow, orientation_accuracy};
use crate::identification::{CalibratedRobot, Estimate, Mode};

/// How the tracker's frame was tied to the robot's for the row "without calibration".
#[derive(Debug, Clone, PartialEq)]
pub struct RegistrationSummary {
    /// How, in words.
    pub how: String,
    /// Number of poses used.
    pub poses: usize,
    /// RMS of the 3-D residual of the fit, m.
    pub rms: f64,
}

/// Result of one mode.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeOutcome {
    /// Which mode.
    pub mode: Mode,
    /// The identified robot, which predicts.
    pub robot: CalibratedRobot,
    /// How the robot was identified; `None` for "without calibration".
    pub estimate: Option<Estimate>,
    /// Measured minus predicted positions in the base frame, m: one list per set of the session, one entry per observation.
    pub errors: Vec<Vec<Vector3<f64>>>,
    /// Rows of the tables, one per set.
    pub rows: Vec<Option<AccuracyRow>>,
    /// Measured against predicted orientations, rotation vectors in base axes, rad, in the same lists as `errors`; `None` for a reading without an
    /// orientation.
    pub turns: Vec<Vec<Option<Vector3<f64>>>>,
}

impl ModeOutcome {
    /// The row of a set's orientations; `None` where it has no orientations.
    pub fn orientation_row(&self, set: usize) -> Option<OrientationRow> {
        orientation_accuracy(self.turns.get(set)?)
    }
}
