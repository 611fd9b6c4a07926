//! How measurements are identified where nobody says how.

use crate::scenario::with_stated_of;
use calibrig_estimation::identification::{IdentificationOptions, Mode};
use calibrig_files::Robot;

/// Relative standard deviation from which on a stated stiffness is a guess: what it predicts is not worth a row.
const GUESS: f64 = 1.0;

/// The options that hold for any robot, with what its files say of its compliances.
pub fn default_options(robot: &Robot) -> IdentificationOptions {
    with_stated_of(robot, IdentificationOptions::default())
}

/// Geometry alone; and where the robot's files give masses and stiffnesses, gravity, or the stiffnesses where they are a guess.
pub fn default_modes(robot: &Robot) -> Vec<Mode> {
    let options = default_options(robot);
    Mode::ALL.into_iter().filter(|mode| is_default(*mode, robot, &options)).collect()
}

/// Whether a mode is among the [`default_modes`] where compliances are known as `options` say.
pub fn is_default(mode: Mode, robot: &Robot, options: &IdentificationOptions) -> bool {
    let is_guess = options.stiffness_unknown || options.compliance_sigma >= GUESS;
    let bends = robot.model.statics.is_some();
    match mode {
        Mode::WithoutCalibration | Mode::OnlyCalibration => true,
        Mode::WithGravity => bends && !is_guess,
        Mode::ElastoGeometric => bends && is_guess,
        Mode::Extended => false,
    }
}
