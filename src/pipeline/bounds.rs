//! How small the errors of any estimator could be, if a simulation knows the truth.

use super::{KnownTruth, ModeOutcome, SetOutcome, Truth};
use calibrig_estimation::identification::{
    Estimate, IdentificationOptions, Information, Mode, information_at,
};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, ParameterId};

/// The bounds of a mode's parameters, from the information at their truth.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthBounds {
    /// Of which mode.
    pub mode: Mode,
    /// In the order of the estimate.
    pub parameters: Vec<ParameterId>,
    /// Least standard deviations of an unbiased estimator that uses only the measurements, SI: the Cramér-Rao bound. `None` if they do not
    /// determine all parameters.
    pub cramer_rao: Option<Vec<f64>>,
    /// Least root mean squared errors with the priors, SI: the Bayesian Cramér-Rao bound, with the information at this truth for its mean over
    /// the priors. `None` if no parameter has a prior.
    pub bayesian: Option<Vec<f64>>,
}

/// The bounds of every estimate of `modes` whose parameters all have a known truth. They hold for readings with their stated noise and a machine
/// that matches the mode's model; one with random errors or effects that the model lacks does no better.
pub fn bounds_at_truth(
    model: &CalibrationModel,
    sets: &[SetOutcome],
    modes: &[ModeOutcome],
    options: &IdentificationOptions,
    truth: &Truth,
) -> Vec<TruthBounds> {
    let Some(fitted) = sets.first().map(|set| &set.measurements) else { return Vec::new() };
    let known = KnownTruth {
        as_built: &truth.as_built,
        nominal: model,
        stations: &truth.stations,
        instrument: &truth.instrument,
        further_targets: &truth.further_targets,
        orientation: truth.orientation,
        targets: &fitted.targets,
        settled: truth.poses.first().map_or(&[], Vec::as_slice),
    };
    let bounds = |outcome: &ModeOutcome| {
        let information = information_at_truth(&known, fitted, options, outcome.estimate.as_ref()?)?;
        Some(TruthBounds {
            mode: outcome.mode,
            parameters: information.parameters().to_vec(),
            cramer_rao: information.cramer_rao_sigmas(),
            bayesian: information.bayesian_cramer_rao_sigmas(),
        })
    };
    modes.iter().filter_map(bounds).collect()
}

/// The information about an estimate's parameters at their truth, with only the readings' stated noise; `None` if the truth of one is unknown.
pub(crate) fn information_at_truth(
    known: &KnownTruth<'_>,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Option<Information> {
    let values = known.values(estimate)?;
    // The stated errors of the model are not noise of the simulated readings.
    let options =
        IdentificationOptions { mode: estimate.robot.mode, unmodelled_sigma: 0.0, ..options.clone() };
    information_at(known.nominal, set, &options, estimate, &values).ok()
}
