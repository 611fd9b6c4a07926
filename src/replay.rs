//! Identification from a recording alone: no scenario, no model folder, the same `calibrate`, the same bits.

use std::fmt;
use std::path::Path;

use miette::Diagnostic;
use thiserror::Error;

use crate::pipeline::{
    Implausible, InputSummary, ModeOutcome, Outcome, PipelineError, SetKind, SetOutcome, SteadySets, Truth,
    calibrate, check_plausible, default_modes, default_options, foresee_sensors, judge, without_drift,
};
use crate::scenario::{Scenario, parse_scenario_with};
use calibrig_estimation::METHOD;
use calibrig_estimation::identification::{
    Estimate, FrameChoice, IdentificationOptions, Loss, Mode, TargetChoice,
};
use calibrig_files::InputError;
use calibrig_files::Robot;
use calibrig_model::measurement::{MeasurementSet, Station};
use calibrig_model::{CalibrationModel, Visual};
use calibrig_recording::{
    MissingPart, Provenance, ReadOptions, RecordedEstimate, RecordedMachine, Recording, RecordingError,
    TrueSetting, Unprotected, read_recorded_machine, read_recording_with,
};

/// A recording that cannot be replayed.
#[derive(Debug, Error, Diagnostic)]
#[non_exhaustive]
pub enum ReplayError {
    /// The file.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Recording(#[from] RecordingError),
    /// An attached scenario or model.
    #[error("an attachment of the recording: {0}")]
    #[diagnostic(transparent)]
    Attachment(#[from] InputError),
    /// The robot is missing.
    #[error("the recording holds no attachment \"robot/...\", the file of the robot that was measured")]
    #[diagnostic(help("expected a recording that holds its robot's file, or --model ROBOT.toml"))]
    NoRobot,
    /// The nominal robot does not fit the recorded points.
    #[error("{0}")]
    #[diagnostic(help("{}", .0.help()))]
    Implausible(Box<Implausible>),
    /// The identification.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}

/// What should differ from the recording. Nothing by default.
#[derive(Debug, Clone, Default)]
pub struct ReplayOptions {
    /// What is fitted instead of the recorded rows; "without calibration" is always among them.
    pub modes: Vec<Mode>,
    /// The loss of a measurement far from the others.
    pub loss: Option<Loss>,
    /// Topics that are left out, each with all below it.
    pub dropped_topics: Vec<String>,
    /// The robot, instead of the recorded one.
    pub robot: Option<Robot>,
    /// Whether to identify even if the nominal robot does not fit the recorded points.
    pub fit_anyway: bool,
}

impl ReplayOptions {
    /// Whether anything may differ.
    fn changes_anything(&self) -> bool {
        let harmless = |topic: &String| topic.starts_with("/estimate") || topic.starts_with("/truth");
        self.loss.is_some() || self.robot.is_some() || !self.dropped_topics.iter().all(harmless)
    }
}

/// Where a replayed estimate differs from the recorded one.
#[derive(Debug, Clone, PartialEq)]
pub enum Difference {
    /// None was recorded.
    Missing {
        /// Key of the mode.
        mode: &'static str,
    },
    /// Other parameters.
    Set {
        /// Key of the mode.
        mode: &'static str,
    },
    /// Another value or standard deviation of a parameter that both have.
    Parameter {
        /// Key of the mode.
        mode: &'static str,
        /// Name of the parameter.
        name: String,
        /// m or rad
        recorded: f64,
        /// m or rad
        replayed: f64,
    },
    /// Another sum of squares.
    ChiSquare {
        /// Key of the mode.
        mode: &'static str,
        /// Recorded.
        recorded: f64,
        /// Replayed.
        replayed: f64,
    },
}

/// The program of the recorded estimates.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MadeBy {
    /// Name and version of the program.
    pub software: String,
    /// Number of its method of estimation ([`calibrig_estimation::METHOD`]).
    pub method: u32,
}

impl MadeBy {
    /// This version.
    pub fn this() -> Self {
        Self { software: Provenance::software().to_owned(), method: METHOD }
    }
}

impl fmt::Display for MadeBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, method {}", self.software, self.method)
    }
}

/// A parameter as recorded and as replayed.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterChange {
    /// The mode.
    pub mode: Mode,
    /// Name of the parameter.
    pub name: String,
    /// Recorded and replayed value, SI; `None` if that estimate does not have the parameter.
    pub values: [Option<f64>; 2],
    /// Recorded and replayed standard deviation, SI; `None` from a singular system as well.
    pub sigmas: [Option<f64>; 2],
}

impl ParameterChange {
    /// Replayed minus recorded value, in replayed standard deviations, or in recorded ones if there are no others.
    pub fn in_sigmas(&self) -> Option<f64> {
        let [recorded, replayed] = self.values;
        let sigma = self.sigmas[1].or(self.sigmas[0]).filter(|sigma| *sigma > 0.0)?;
        Some((replayed? - recorded?) / sigma)
    }
}

/// A replay and its comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Replayed {
    /// As for a run, without the truth.
    pub outcome: Outcome,
    /// The options of the identification.
    pub options: IdentificationOptions,
    /// The program of the recorded estimates, if it is not this version: then other bits are to be expected.
    pub made_by_another: Option<MadeBy>,
    /// Whether the options differ from the recorded ones: then nothing is compared bit for bit.
    pub what_if: bool,
    /// Number of estimates compared.
    pub compared: usize,
    /// Empty if every bit is the same.
    pub differences: Vec<Difference>,
    /// The compared parameters that differ in some bit.
    pub parameters: Vec<ParameterChange>,
    /// The recorded and the replayed error of the same mode and set.
    pub changes: Vec<Change>,
    /// Sets that were not recorded to their end.
    pub missing: Vec<MissingPart>,
    /// The parts of the recording without a checksum.
    pub unprotected: Unprotected,
    /// Why a fit made no sense, if it was done nevertheless.
    pub implausible: Option<Box<Implausible>>,
}

/// Root mean square of the 3-D errors of a mode over a set, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// The mode.
    pub mode: Mode,
    /// The set.
    pub kind: SetKind,
    /// As recorded; `None` if it was not.
    pub recorded: Option<f64>,
    /// As replayed; `None` if the set is left out.
    pub replayed: Option<f64>,
}

/// The options of the identification.
struct Plan {
    name: String,
    model: CalibrationModel,
    visuals: Vec<Vec<Visual>>,
    options: IdentificationOptions,
    modes: Vec<Mode>,
    published: Vec<(SetKind, Mode, [f64; 6])>,
}

impl Plan {
    /// From the recording's own scenario, else from its robot and its measurements.
    fn new(recording: &Recording, options: &ReplayOptions) -> Result<Self, ReplayError> {
        let robot = match &options.robot {
            Some(robot) => robot.clone(),
            None => recorded_robot(recording)?,
        };
        let mut plan = match recorded_scenario(recording, &robot)? {
            Some(scenario) => Self {
                name: scenario.name,
                model: scenario.robot.model,
                visuals: scenario.robot.visuals,
                options: scenario.options,
                modes: scenario.modes,
                published: scenario.published,
            },
            None => Self {
                name: robot.name.clone(),
                options: default_options(&robot),
                modes: default_modes(&robot),
                model: robot.model,
                visuals: robot.visuals,
                published: Vec::new(),
            },
        };
        if let Some(loss) = options.loss {
            plan.options.solver.loss = loss;
        }
        if !options.modes.is_empty() {
            let wanted = |mode: &Mode| *mode == Mode::WithoutCalibration || options.modes.contains(mode);
            plan.modes = Mode::ALL.into_iter().filter(wanted).collect();
        }
        if let Some(set) = recording.sets.first() {
            free_what_is_missing(&mut plan.options, &set.measurements);
        }
        Ok(plan)
    }
}

/// Relaxes what the options expect from the measurements if a recording lacks it, for example because its nests were dropped.
fn free_what_is_missing(options: &mut IdentificationOptions, set: &MeasurementSet) {
    let lacks = |station: &Station| match options.frame {
        FrameChoice::Nests | FrameChoice::Fixed => station.distinct_nests().len() < 3,
        FrameChoice::Sweeps => station.sweeps.is_empty(),
        FrameChoice::AsStated | FrameChoice::Free => false,
    };
    if set.stations.iter().any(lacks) {
        options.frame = FrameChoice::AsStated;
    }
    if options.target == TargetChoice::Measured && set.targets.iter().any(|t| t.covariance.is_none()) {
        options.target = TargetChoice::AsStated;
    }
}

/// The robot that the recording holds.
fn recorded_robot(recording: &Recording) -> Result<Robot, ReplayError> {
    recording.robot()?.ok_or(ReplayError::NoRobot)
}

fn recorded_scenario(recording: &Recording, robot: &Robot) -> Result<Option<Scenario>, ReplayError> {
    let source = recording.source("scenario").cloned();
    Ok(source.map(|source| parse_scenario_with(source, robot.clone(), &recording.sources)).transpose()?)
}

/// Identifies again from the contents of `path`: the measurements, the robot and, if there is one, the scenario's
/// choices.
pub fn replay(path: &Path, options: &ReplayOptions) -> Result<Replayed, ReplayError> {
    let read = ReadOptions { dropped_topics: options.dropped_topics.clone() };
    let recording = read_recording_with(path, &read)?;
    let Plan { name, model, visuals, options: fit, modes, published } = Plan::new(&recording, options)?;
    let Recording { provenance, sources, sets, missing, unprotected, estimates, .. } = recording;
    let SteadySets { sets, as_measured, drift } = without_drift(sets)?;
    let implausible = match check_plausible(&model, &sets, &fit, |_, _| {}) {
        Err(PipelineError::Implausible(why)) if options.fit_anyway => Some(why),
        Err(PipelineError::Implausible(why)) => return Err(ReplayError::Implausible(why)),
        checked => checked.map(|()| None)?,
    };
    let (registration, modes) = calibrate(&model, &sets, &modes, &fit).map_err(PipelineError::from)?;
    let judgements = judge(&model, &sets, &modes, &fit).map_err(PipelineError::from)?;
    let sensors = foresee_sensors(&model, &sets, &modes, &fit);
    let whole = missing.is_empty() && !options.changes_anything();
    let (mut differences, mut parameters, mut compared) = (Vec::new(), Vec::new(), 0);
    for outcome in modes.iter().filter(|_| whole && !estimates.is_empty()) {
        let Some(estimate) = &outcome.estimate else { continue };
        let mode = outcome.mode.key();
        match estimates.iter().find(|recorded| recorded.mode == mode) {
            Some(recorded) => {
                compared += 1;
                compare(mode, recorded, estimate, &mut differences);
                parameters.extend(parameter_changes(outcome.mode, recorded, estimate));
            }
            // An additional mode is not a difference.
            None if options.modes.is_empty() => differences.push(Difference::Missing { mode }),
            None => {}
        }
    }
    let changes = changes(&estimates, &sets, &modes);
    let made_by_another = made_by_another(provenance.as_ref(), &estimates);
    let outcome = Outcome {
        input: InputSummary {
            kind: "recording",
            name,
            sha256: provenance.as_ref().map(|p| p.input_sha256.clone()).unwrap_or_default(),
            seed: provenance.as_ref().and_then(|p| p.seed),
            trial: None,
        },
        sources,
        model,
        visuals,
        registration,
        sets,
        as_measured,
        drift,
        missing: Vec::new(),
        places: Vec::new(),
        modes,
        truth: None,
        bounds: Vec::new(),
        published,
        judgements,
        sensors,
        ablation: None,
        splits: None,
        closed_loop: None,
        command: None,
    };
    let what_if = options.changes_anything() || !options.modes.is_empty();
    Ok(Replayed {
        outcome,
        options: fit,
        made_by_another,
        what_if,
        compared,
        differences,
        parameters,
        changes,
        missing,
        unprotected,
        implausible,
    })
}

/// The program of the `estimates`, if it is not this version.
fn made_by_another(provenance: Option<&Provenance>, estimates: &[RecordedEstimate]) -> Option<MadeBy> {
    if estimates.is_empty() {
        return None;
    }
    let made_by = match provenance {
        Some(provenance) => MadeBy { software: provenance.software.clone(), method: provenance.method },
        None => MadeBy { software: "an unknown program".to_owned(), method: 1 },
    };
    (made_by != MadeBy::this()).then_some(made_by)
}

/// The parameters that differ in any bit, including those that only one of the two has.
fn parameter_changes(mode: Mode, recorded: &RecordedEstimate, replayed: &Estimate) -> Vec<ParameterChange> {
    let now: Vec<_> = replayed.parameters.iter().map(|p| (p.id.to_string(), p.value, p.sigma)).collect();
    let before = &recorded.parameters;
    let gone = before.iter().filter(|p| !now.iter().any(|(name, ..)| *name == p.name));
    let gone = gone.map(|p| (p.name.clone(), [Some(p.value), None], [p.sigma, None]));
    let there = now.iter().map(|(name, value, sigma)| {
        let known = before.iter().find(|p| p.name == *name);
        (name.clone(), [known.map(|p| p.value), Some(*value)], [known.and_then(|p| p.sigma), *sigma])
    });
    let bits = |pair: [Option<f64>; 2]| pair.map(|value| value.map(f64::to_bits));
    let is_other = |pair: [Option<f64>; 2]| bits(pair)[0] != bits(pair)[1];
    there
        .chain(gone)
        .filter(|(_, values, sigmas)| is_other(*values) || is_other(*sigmas))
        .map(|(name, values, sigmas)| ParameterChange { mode, name, values, sigmas })
        .collect()
}

fn changes(estimates: &[RecordedEstimate], sets: &[SetOutcome], modes: &[ModeOutcome]) -> Vec<Change> {
    let recorded = |mode: Mode, kind: SetKind| {
        let estimate = estimates.iter().find(|estimate| estimate.mode == mode.key())?;
        estimate.rms_3d.iter().find(|(known, _)| *known == kind).map(|(_, rms)| *rms)
    };
    let replayed = |mode: Mode, kind: SetKind| {
        let place = sets.iter().position(|set| set.kind == kind)?;
        let outcome = modes.iter().find(|outcome| outcome.mode == mode)?;
        outcome.rows.get(place)?.as_ref().map(|row| row.rms_3d)
    };
    let pairs = Mode::ALL.into_iter().flat_map(|mode| SetKind::ALL.map(|kind| (mode, kind)));
    pairs
        .map(|(mode, kind)| Change {
            mode,
            kind,
            recorded: recorded(mode, kind),
            replayed: replayed(mode, kind),
        })
        .filter(|change| change.recorded.is_some() || change.replayed.is_some())
        .collect()
}

/// Why a report of a recording does not include the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoTruth {
    /// No machine is recorded: the measurements are not simulated.
    Real,
    /// This version of the program draws another machine from the recorded scenario.
    OtherMachine,
}

/// The machine behind a simulated recording, for the report on [`replay`], which never sees it: the machine of the recorded scenario, if it
/// equals the recorded one.
pub fn recorded_truth(path: &Path) -> Result<Result<Truth, NoTruth>, ReplayError> {
    let Some(recorded) = read_recorded_machine(path)? else { return Ok(Err(NoTruth::Real)) };
    let recording = read_recording_with(path, &ReadOptions::default())?;
    let robot = recorded_robot(&recording)?;
    let Some(scenario) = recorded_scenario(&recording, &robot)? else { return Ok(Err(NoTruth::Real)) };
    let provenance = recording.provenance.as_ref();
    let seed = provenance.and_then(|p| p.seed).unwrap_or(scenario.seed);
    let trial = provenance.and_then(|p| p.trial).map_or(0, |(trial, _)| trial);
    let scenario = &*scenario.of_trial(seed, trial);
    let as_built = scenario.as_built.clone();
    let further_targets: Vec<_> = scenario.plan.targets.iter().map(|target| target.in_flange).collect();
    let Ok(stations) = scenario.session().stations(seed, trial) else {
        return Ok(Err(NoTruth::OtherMachine));
    };
    let payloads: Vec<_> =
        scenario.plan.payloads.payloads.iter().map(|payload| payload.real.clone()).collect();
    let setting = TrueSetting {
        as_built: &as_built,
        stations: &stations,
        further_targets: &further_targets,
        payloads: &payloads,
    };
    if recorded != RecordedMachine::of(&robot.model, setting) {
        return Ok(Err(NoTruth::OtherMachine));
    }
    Ok(Ok(Truth {
        as_built,
        stations,
        // A recording does not hold it.
        instrument: Vec::new(),
        payloads,
        further_targets,
        orientation: scenario.probe.map(|probe| probe.flange_from_target),
        poses: Vec::new(),
        effects: Vec::new(),
        outliers: Vec::new(),
        rigid: Vec::new(),
    }))
}

fn compare(
    mode: &'static str,
    recorded: &RecordedEstimate,
    replayed: &Estimate,
    differences: &mut Vec<Difference>,
) {
    let names: Vec<_> = replayed.parameters.iter().map(|p| p.id.to_string()).collect();
    if recorded.parameters.len() != names.len()
        || recorded.parameters.iter().zip(&names).any(|(recorded, name)| &recorded.name != name)
    {
        differences.push(Difference::Set { mode });
        return;
    }
    for (recorded, replayed) in recorded.parameters.iter().zip(&replayed.parameters) {
        let pairs = [(Some(recorded.value), Some(replayed.value)), (recorded.sigma, replayed.sigma)];
        for (a, b) in pairs {
            if a.map(f64::to_bits) != b.map(f64::to_bits) {
                differences.push(Difference::Parameter {
                    mode,
                    name: recorded.name.clone(),
                    recorded: a.unwrap_or(f64::NAN),
                    replayed: b.unwrap_or(f64::NAN),
                });
            }
        }
    }
    if recorded.chi2.map(f64::to_bits) != Some(replayed.chi2.to_bits()) {
        let recorded = recorded.chi2.unwrap_or(f64::NAN);
        differences.push(Difference::ChiSquare { mode, recorded, replayed: replayed.chi2 });
    }
}
