//! How measurements are identified where nobody says how.

use calibrig_estimation::identification::{IdentificationOptions, Mode};
use calibrig_files::Robot;

/// Relative standard deviation from which on a stated stiffness is a guess: what it predicts is not worth a row.
const GUESS: f64 = 1.0;

/// The options that hold for any robot, with what its files say of its compliances.
pub fn default_options(robot: &Robot) -> IdentificationOptions {
    let defaults = IdentificationOptions::default();
    IdentificationOptions {
        compliance_sigma: robot.compliance_sigma.unwrap_or(defaults.compliance_sigma),
        ..defaults
    }
}

/// Geometry alone; and where the robot's files give masses and stiffnesses, gravity, or the stiffnesses where they are a guess.
pub fn default_modes(robot: &Robot) -> Vec<Mode> {
    let sigma = robot.compliance_sigma.unwrap_or(IdentificationOptions::default().compliance_sigma);
    Mode::ALL.into_iter().filter(|mode| is_default(*mode, robot, sigma)).collect()
}

/// Whether a mode is among the [`default_modes`] where compliances are known to `compliance_sigma`.
pub fn is_default(mode: Mode, robot: &Robot, compliance_sigma: f64) -> bool {
    let bends = robot.model.statics.is_some();
    match mode {
        Mode::WithoutCalibration | Mode::OnlyCalibration => true,
        Mode::WithGravity => bends && compliance_sigma < GUESS,
        Mode::ElastoGeometric => bends && compliance_sigma >= GUESS,
        Mode::Extended => false,
    }
}
