//! One trial: a machine is drawn, measured, identified and judged.

use nalgebra::DVector;

use super::{Campaign, Case};
use crate::pipeline::{
    KnownTruth, PipelineError, Simulation, calibrate, information_at_truth, simulate, without_drift,
};
use crate::scenario::Scenario;
use calibrig_estimation::evaluation::{AccuracyRow, accuracy, nees};
use calibrig_estimation::identification::{
    CalibratedRobot, Estimate, IdentificationOptions, Information, Mode, PredictedReading, Predictor,
    TerminationReason, predict_places,
};
use calibrig_model::ParameterId;
use calibrig_model::measurement::{MeasurementSet, Reading, SetKind};

/// The result of one trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Its number in the campaign.
    pub index: u64,
    /// Number of its draw.
    pub draw: u32,
    /// Of the campaign's factors, as TOML has them; empty if they are impossible.
    pub values: Vec<String>,
    /// How often factors or machine were drawn again because the draw was impossible.
    pub redrawn: u32,
    /// Its results, or why it failed.
    pub outcome: Result<TrialOutcome, String>,
}

/// Results of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialOutcome {
    /// One per mode of the scenario.
    pub modes: Vec<ModeResult>,
    /// Planned poses that were not measured.
    pub dropped: usize,
}

/// Results of one mode in a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeResult {
    /// Which.
    pub mode: Mode,
    /// The accuracy on every set, and against the truth.
    pub rows: Vec<(AccuracySet, AccuracyRow)>,
    /// How the identification went; `None` for "without calibration".
    pub fit: Option<FitResult>,
}

/// Reference of predicted positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AccuracySet {
    /// The readings that were fitted.
    Identification,
    /// The readings of the held-out poses.
    Verification,
    /// The true places of the held-out poses: known only in a simulation, without errors of the instrument.
    Truth,
}

impl AccuracySet {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Identification, Self::Verification, Self::Truth];

    /// In names of columns and in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Identification => SetKind::Identification.key(),
            Self::Verification => SetKind::Verification.key(),
            Self::Truth => "truth",
        }
    }

    /// For people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Identification => "identification set",
            Self::Verification => "verification set",
            Self::Truth => "true places of the verification set",
        }
    }

    fn of(kind: SetKind) -> Self {
        match kind {
            SetKind::Identification => Self::Identification,
            SetKind::Verification => Self::Verification,
        }
    }
}

/// How an identification went.
#[derive(Debug, Clone, PartialEq)]
pub struct FitResult {
    /// Why the solver stopped.
    pub termination: TerminationReason,
    /// Converged and of full rank.
    pub sound: bool,
    /// Of the solver.
    pub iterations: usize,
    /// Chi-square per degree of freedom.
    pub chi2_per_dof: Option<f64>,
    /// Normalised estimation error squared over all parameters, if the truth of every one is known.
    pub nees: Option<f64>,
    /// Squared error over the bound: of all parameters, with the information at their truth; `None` if one truth is unknown. On average at least
    /// the number of parameters, if the machine is drawn from the priors and the model is right.
    pub squared_over_bound: Option<f64>,
    /// The parameters with their truth.
    pub parameters: Vec<ParameterResult>,
    /// True positions of the verification poses inside the stated 95 % intervals (per coordinate), and their number.
    pub predictions: (u64, u64),
}

/// A parameter with its truth, SI.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterResult {
    /// Which.
    pub id: ParameterId,
    /// The truth, if it has a counterpart.
    pub truth: Option<f64>,
    /// The estimate.
    pub value: f64,
    /// Its stated standard deviation.
    pub sigma: Option<f64>,
    /// The Cramér-Rao bound at the truth: the limit for unbiased estimators that use only the measurements of this trial.
    pub cramer_rao: Option<f64>,
    /// The Bayesian Cramér-Rao bound, with the information at this truth for its mean over machines at these poses; `None` without priors.
    pub bayesian: Option<f64>,
}

pub(super) fn carry_out(campaign: &Campaign<'_>, case: &Case<'_>) -> Result<TrialOutcome, PipelineError> {
    let scenario = &*case.scenario;
    let mut simulation = simulate(scenario, campaign.seed, case.draw, campaign.plant, |_, _| {})?;
    simulation.sets = without_drift(simulation.sets)?.sets;
    let model = &scenario.robot.model;
    let (_, outcomes) = calibrate(model, &simulation.sets, &scenario.modes, &scenario.options)?;
    let kinds: Vec<SetKind> = simulation.sets.iter().map(|set| set.kind).collect();
    let truth = true_places(&simulation);
    let modes = outcomes
        .into_iter()
        .map(|outcome| ModeResult {
            mode: outcome.mode,
            rows: kinds
                .iter()
                .zip(&outcome.rows)
                .filter_map(|(kind, row)| Some((AccuracySet::of(*kind), (*row)?)))
                .chain(against_truth(&outcome.robot, truth.as_ref()).map(|row| (AccuracySet::Truth, row)))
                .collect(),
            fit: outcome
                .estimate
                .as_ref()
                .map(|estimate| fit(scenario, &simulation, estimate, truth.as_ref())),
        })
        .collect();
    Ok(TrialOutcome { modes, dropped: simulation.sets.iter().map(|set| set.dropped.len()).sum() })
}

/// The held-out poses as an instrument without errors would read them, from the same place; `None` without any.
fn true_places(simulation: &Simulation) -> Option<MeasurementSet> {
    let sets = simulation.sets.iter().zip(&simulation.truth.poses);
    let (set, settled) = sets.into_iter().find(|(set, _)| set.kind == SetKind::Verification)?;
    let mut truth: MeasurementSet = set.measurements.clone();
    for (observation, pose) in truth.observations.iter_mut().zip(settled) {
        let tracker_from_base = simulation.truth.stations.get(observation.station)?;
        let position = tracker_from_base.rotation * pose.target + tracker_from_base.translation.vector;
        observation.reading = Reading::Cartesian { position, covariance: None };
    }
    (!truth.observations.is_empty()).then_some(truth)
}

fn against_truth(robot: &CalibratedRobot, truth: Option<&MeasurementSet>) -> Option<AccuracyRow> {
    // Of the places, not of what the instrument that was identified with the robot would read.
    let robot = CalibratedRobot { instruments: Vec::new(), ..robot.clone() };
    accuracy(&Predictor::new(&robot).ok()?.errors(truth?).ok()?)
}

fn fit(
    scenario: &Scenario,
    simulation: &Simulation,
    estimate: &Estimate,
    truth: Option<&MeasurementSet>,
) -> FitResult {
    let known = KnownTruth {
        as_built: &simulation.truth.as_built,
        nominal: &scenario.robot.model,
        stations: &simulation.truth.stations,
        instrument: &simulation.truth.instrument,
        further_targets: &simulation.truth.further_targets,
        orientation: simulation.truth.orientation,
        targets: simulation.sets.first().map_or(&[], |set| &set.measurements.targets),
        settled: simulation.truth.poses.first().map_or(&[], Vec::as_slice),
    };
    let fitted = simulation.sets.first().map(|set| &set.measurements);
    let information = fitted.and_then(|set| information_at_truth(&known, set, &scenario.options, estimate));
    let cramer_rao = information.as_ref().and_then(Information::cramer_rao_sigmas);
    let bayesian = information.as_ref().and_then(Information::bayesian_cramer_rao_sigmas);
    let at = |sigmas: &Option<Vec<f64>>, place: usize| sigmas.as_ref()?.get(place).copied();
    let parameters: Vec<_> = estimate
        .parameters
        .iter()
        .enumerate()
        .map(|(place, p)| ParameterResult {
            id: p.id,
            truth: known.of(estimate, p.id),
            value: p.value,
            sigma: p.sigma,
            cramer_rao: at(&cramer_rao, place),
            bayesian: at(&bayesian, place),
        })
        .collect();
    let errors: Option<Vec<f64>> = parameters.iter().map(|p| Some(p.value - p.truth?)).collect();
    FitResult {
        termination: estimate.termination,
        sound: estimate.is_sound(),
        iterations: estimate.iterations.len(),
        chi2_per_dof: estimate.chi2_per_dof(),
        nees: nees_of(estimate, &parameters),
        predictions: truth.map_or((0, 0), |truth| predictions(scenario, truth, estimate)),
        squared_over_bound: information.as_ref().zip(errors).and_then(|(i, errors)| i.squared(&errors)),
        parameters,
    }
}

fn nees_of(estimate: &Estimate, parameters: &[ParameterResult]) -> Option<f64> {
    let error: Option<Vec<f64>> = parameters.iter().map(|p| Some(p.value - p.truth?)).collect();
    nees(&DVector::from_vec(error?), estimate.covariance.as_ref()?)
}

/// How many true coordinates of the held-out poses are inside the 95 % intervals of the robot's mean position, and how many there are. In the
/// tracker's frame, so that the uncertainty of its place is included.
fn predictions(scenario: &Scenario, truth: &MeasurementSet, estimate: &Estimate) -> (u64, u64) {
    let options = IdentificationOptions { mode: estimate.robot.mode, ..scenario.options.clone() };
    let model = &scenario.robot.model;
    let Ok(Some(predicted)) = predict_places(model, truth, &options, estimate) else { return (0, 0) };
    let factor = estimate.interval_factor(0.95);
    let inside = |reading: &PredictedReading| {
        let variance = (reading.of_parameters + reading.of_machine).diagonal();
        let held = reading.error.iter().zip(&variance).filter(|(error, v)| error.abs() <= factor * v.sqrt());
        held.count() as u64
    };
    (predicted.iter().map(inside).sum(), 3 * predicted.len() as u64)
}
