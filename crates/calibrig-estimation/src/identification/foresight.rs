//! What other measurements of an identified robot would determine: fewer targets, more of them, or full poses.

use nalgebra::{DVector, Rotation3};

use super::build::{Built, build, start};
use super::factorised::Factorised;
use super::identify::check;
use super::linearisation::{as_spread, weigh_as};
use super::solver::{AtBound, Side};
use super::summary::{Fitted, Size, summarise};
use super::{
    ComplianceChoice, DependentGroup, Estimate, IdentificationOptions, IdentifyError, LINKAGE, Loss,
    PredictionError, Redundancy, Solution, SolverOptions, Spectrum, TerminationReason,
};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, ParameterId, PoseQuery};

/// What an estimate from other measurements would know of its parameters, if the robot is as a given estimate has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Foresight {
    /// Its robot has one more target: a point of the flange at the first target's place, with the flange's axes, that no parameter of a target moves.
    estimate: Estimate,
    measured_rank: usize,
}

/// How well a foreseen estimate predicts: RMS over poses of the root of the summed variances along three axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForeseenSpread {
    /// Spread of the first target's position in the base frame, m.
    pub place: f64,
    /// Spread of the flange's orientation, rad.
    pub turn: f64,
}

/// Analyses, without solving it, the system that [`identify`](super::identify()) would solve for `set`, with the compliances and terms that
/// `estimate` has, at the parameters of `estimate` and in the noise that it was given or found. All readings have the same weight. Readings of
/// `set` do not place stations and may be predicted ones; its stations are those of the estimate, in their order, as are the targets that both
/// have.
///
/// # Errors
///
/// [`IdentifyError`], as the identification itself.
pub fn foresee(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<Foresight, IdentifyError> {
    let options = &as_fitted(options, estimate);
    let (mut built, x) = at_estimate(model, set, options, estimate)?;
    let (residuals, jacobian) = start(&mut built.problem, &x)?;
    let bounded = built.problem.parameters.iter().enumerate();
    let bounded = bounded.filter(|(_, id)| estimate.at_bound.contains(id));
    let solution = Solution {
        x,
        cost: 0.0,
        beside: 0.0,
        // The residuals do not matter: the readings are assumed to lie where the robot is.
        residuals: DVector::zeros(residuals.len()),
        jacobian,
        termination: TerminationReason::SmallGradient,
        iterations: Vec::new(),
        at_bound: bounded
            .map(|(parameter, _)| AtBound { parameter, side: Side::Lower, gradient: 0.0 })
            .collect(),
        weights: Vec::new(),
        scale: 1.0,
        variance_factor: 1.0,
        minima: 1,
    };
    let factorised = Factorised::new(&built.problem, &solution, options.redundant);
    let measured_rank = factorised.factors.spectrum(&built.problem, Redundancy::Keep).rank;
    let size = Size::of(&built.problem, &solution, &factorised);
    let fitted = Fitted { solution, factorised, size, stated_sigmas: None };
    let mut foreseen = summarise(built, fitted, set, options);
    let robot = &mut foreseen.robot;
    robot.targets.extend(robot.targets.first().copied());
    robot.orientations.push(Some(Rotation3::identity()));
    Ok(Foresight { estimate: foreseen, measured_rank })
}

/// The problem of `set` with the compliances and terms of `estimate`, weighed in the noise that it found, and the parameters of the estimate.
pub(super) fn at_estimate(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<(Built, Vec<f64>), IdentifyError> {
    check(model, set)?;
    let options = &as_fitted(options, estimate);
    options.check()?;
    let model = &*as_spread(model, estimate);
    let mut built = build(model, set, options)?;
    let place = |id: &ParameterId| match id {
        // The stations are where the estimate found them.
        ParameterId::Frame { .. } => 0.0,
        _ => estimate.value(*id).unwrap_or(0.0),
    };
    let x: Vec<f64> = built.problem.parameters.iter().map(place).collect();
    if estimate.robot.stations.len() == built.problem.stations.len() {
        built.problem.stations.clone_from(&estimate.robot.stations);
    }
    built.problem.start = None;
    built.problem.set(&x);
    let targets = built.problem.current.targets.clone();
    weigh_as(&mut built.problem, set, &targets, estimate)?;
    Ok((built, x))
}

/// The options that fit the compliances and terms of `estimate`.
fn as_fitted(options: &IdentificationOptions, estimate: &Estimate) -> IdentificationOptions {
    let ids = || estimate.parameters.iter().map(|parameter| parameter.id);
    let compliances = ids().filter_map(|id| match id {
        ParameterId::Compliance(compliance) => Some(compliance),
        _ => None,
    });
    let families = ids().filter_map(|id| match id {
        ParameterId::Linkage(_) => Some(LINKAGE.to_owned()),
        ParameterId::Term(term) => Some(term.family().key().to_owned()),
        _ => None,
    });
    let mut terms: Vec<String> = families.collect();
    terms.dedup();
    IdentificationOptions {
        mode: estimate.robot.mode,
        compliances: ComplianceChoice::Listed(compliances.collect()),
        terms: Some(terms),
        solver: SolverOptions { loss: Loss::Squared, ..options.solver },
        ..options.clone()
    }
}

impl Foresight {
    /// The parameters that would be fitted, each with its standard deviation, SI; `None` for a singular system, or at a bound.
    pub fn parameters(&self) -> impl Iterator<Item = (ParameterId, Option<f64>)> + '_ {
        self.estimate.parameters.iter().map(|parameter| (parameter.id, parameter.sigma))
    }

    /// Rank, condition, dependent groups and weak directions, with the same priors as in the estimate's spectrum.
    pub fn spectrum(&self) -> &Spectrum {
        &self.estimate.spectrum
    }

    /// Rank from the observations, nests and targets alone.
    pub fn measured_rank(&self) -> usize {
        self.measured_rank
    }

    /// Parameters that the measurements alone cannot separate from others: those held by a prior, left out, or determined by nothing.
    pub fn open(&self) -> impl Iterator<Item = &DependentGroup> {
        let Estimate { held, fixed, spectrum, .. } = &self.estimate;
        held.iter().chain(fixed).chain(&spectrum.dependent)
    }

    /// How well the robot would be predicted at the poses of `set`, each of which counts once: the spread due to the parameters, without the
    /// machine's noise beside its model. `None` for a singular system, or without poses.
    ///
    /// # Errors
    ///
    /// [`PredictionError`], for a pose that the robot cannot take.
    pub fn spread(&self, set: &MeasurementSet) -> Result<Option<ForeseenSpread>, PredictionError> {
        let Some(factor) = &self.estimate.factor else { return Ok(None) };
        let flange = self.estimate.robot.targets.len() - 1;
        let mut predictor = self.estimate.predictor()?;
        let mut seen = std::collections::BTreeSet::new();
        let (mut place, mut turn) = (0.0, 0.0);
        for observation in set.observations.iter().filter(|o| seen.insert(o.pose)) {
            let query = PoseQuery::from(observation);
            let of_pose = |source| PredictionError::Pose { pose: observation.pose, source: Box::new(source) };
            let at_target = predictor.predict(query.with_target(0)).map_err(of_pose)?;
            let at_flange = predictor.predict(query.with_target(flange)).map_err(of_pose)?;
            place += (at_target.jacobian * factor).norm_squared();
            turn += at_flange.orientation.map_or(0.0, |turned| (turned.jacobian * factor).norm_squared());
        }
        let rms = |sum: f64| (sum / seen.len() as f64).sqrt();
        Ok((!seen.is_empty()).then(|| ForeseenSpread { place: rms(place), turn: rms(turn) }))
    }
}
