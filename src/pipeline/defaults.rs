//! How measurements are identified by default.

use crate::scenario::with_stated_of;
use calibrig_estimation::identification::{IdentificationOptions, Mode};
use calibrig_files::Robot;

/// Relative standard deviation from which on a stated stiffness is a guess: its prediction is not worth a row.
const GUESS: f64 = 1.0;

/// The options for any robot, with what its files state about its compliances.
pub fn default_options(robot: &Robot) -> IdentificationOptions {
    with_stated_of(robot, IdentificationOptions::default())
}

/// Only geometry; and if the robot's files give masses and stiffnesses, gravity, or the stiffnesses if they are a guess.
pub fn default_modes(robot: &Robot) -> Vec<Mode> {
    let options = default_options(robot);
    Mode::ALL.into_iter().filter(|mode| is_default(*mode, robot, &options)).collect()
}

/// Whether a mode is among the [`default_modes`] if compliances are known as `options` state.
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
