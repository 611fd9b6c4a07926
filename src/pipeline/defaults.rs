//! How measurements are identified where nobody says how.

use calibrig_estimation::identification::{
    FrameChoice, IdentificationOptions, Mode, ParameterChoice, TargetChoice, Tolerance,
};
use calibrig_files::Robot;
use calibrig_model::measurement::MeasurementSet;

/// Relative standard deviation from which on a stated stiffness is a guess: what it predicts is not worth a row.
const GUESS: f64 = 1.0;

/// How well a robot's links are taken to be made where nobody says: 10 mm and 20 mrad, far more than a workshop leaves.
pub const DEFAULT_TOLERANCE: Tolerance = Tolerance { length: 10e-3, angle: 20e-3 };

/// A complete independent set of link parameters with a prior of the making's tolerance; tracker frame and target as far as `measured` tells
/// of them: nests and offsets that were measured are priors, else both are identified.
pub fn default_options(robot: &Robot, measured: Option<&MeasurementSet>) -> IdentificationOptions {
    let defaults = IdentificationOptions::default();
    let mut options = IdentificationOptions {
        parameters: ParameterChoice::Complete,
        tolerance: Some(DEFAULT_TOLERANCE),
        compliance_sigma: robot.compliance_sigma.unwrap_or(defaults.compliance_sigma),
        frame: FrameChoice::Nests,
        target: TargetChoice::Measured,
        ..defaults
    };
    options.fit_to(measured);
    options
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
