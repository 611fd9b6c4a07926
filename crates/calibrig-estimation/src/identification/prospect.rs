//! What planned measurements can determine, before they are made.

use super::build::{Built, build, start};
use super::factorised::Factors;
use super::identify::check;
use super::summary::{left_open_warnings, rank_warnings};
use super::{
    DependentGroup, IdentificationOptions, IdentifyError, LeftOutReason, Redundancy, Spectrum, Warning,
};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, ParameterId};
use serde::{Deserialize, Serialize};

/// What an estimate from planned measurements would determine, at the nominal robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Prospect {
    /// The parameters that would be fitted.
    pub parameters: Vec<ParameterId>,
    /// Rank, condition, dependent groups and weak directions, with the same priors as in the estimate's spectrum.
    pub spectrum: Spectrum,
    /// Rank from the observations, nests and targets alone.
    pub measured_rank: usize,
    /// Parameters that the measurements alone cannot separate from others, and that their priors would hold.
    pub held: Vec<DependentGroup>,
    /// Parameters that would be left out because the measurements cannot separate them from others.
    pub fixed: Vec<DependentGroup>,
    /// Compliances that would be left out because gravity hardly loads them.
    pub unloaded: Vec<ParameterId>,
    /// Warnings that the estimate would have.
    pub warnings: Vec<Warning>,
}

/// Analyses the system that [`identify`](super::identify()) would solve for `set`, at readings where the nominal robot is. Of the actual
/// readings only the covariance is used; at most they place the tracker.
///
/// # Errors
///
/// [`IdentifyError`], as in the identification itself; too few poses are not an error, but reduce the rank.
pub fn prospect(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Prospect, IdentifyError> {
    let Built { mut problem, unexcited, fixed, left_out, x, .. } = at_nominal(model, set, options)?;
    let (_, jacobian) = start(&mut problem, &x)?;
    let factors = Factors::new(&problem, &jacobian);
    let spectrum = factors.spectrum(&problem, options.redundant);
    let held = factors.held(&problem, options.redundant);
    let mut warnings = rank_warnings(&spectrum, problem.parameters.len());
    warnings.extend(left_open_warnings(&held, &fixed, &unexcited));
    Ok(Prospect {
        measured_rank: factors.spectrum(&problem, Redundancy::Keep).rank,
        unloaded: left_out
            .into_iter()
            .filter(|left| matches!(left.reason, LeftOutReason::Unloaded { .. }))
            .map(|left| left.id)
            .collect(),
        parameters: problem.parameters,
        spectrum,
        held,
        fixed,
        warnings,
    })
}

/// The problem of `set` at the nominal robot, if set and options are valid.
pub(super) fn at_nominal(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Built, IdentifyError> {
    check(model, set)?;
    options.check()?;
    if options.mode.needs_statics() && model.statics.is_none() {
        return Err(IdentifyError::NoStatics { mode: options.mode });
    }
    build(model, set, options)
}
