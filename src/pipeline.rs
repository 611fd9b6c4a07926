//! The short story of a run: simulate, identify, evaluate.

mod ablation;
mod acceptance;
mod bounds;
mod choice;
mod closed_loop;
mod defaults;
mod diagnosis;
mod iso9283;
mod judgement;
mod machine;
mod planned;
mod plausible;
mod residuals;
mod sensors;
mod simulate;
mod splits;
mod steady;
mod swept;
mod truth;
mod worth;

pub use ablation::{AblatedPart, Ablation, AblationRows, Part, ablate};
pub use acceptance::{AcceptanceOutcome, Finding, Ratios, Test, TestOutcome, TestedKind, test_instruments};
pub(crate) use bounds::information_at_truth;
pub use bounds::{TruthBounds, bounds_at_truth};
pub use choice::{ALL_TERMS, ChosenRow, DEFAULT_TERMS, FailedVariant, ModelChoice, choose};
pub use closed_loop::{ClosedLoopError, close_loop};
pub use defaults::{default_modes, default_options, is_default};
pub use diagnosis::{Names, mm};
pub use iso9283::{
    AccuracyAgainst, CombinedOrientation, Iso9283Failure, Iso9283Outcome, Iso9283Plan, Iso9283Pose,
    Iso9283Target, ReachError, iso9283_of_scenario, iso9283_of_set,
};
pub use judgement::{Confidence, FALSE_ALARM, Judgement, PredictedPosition, judge};
pub use machine::check_analytic;
pub use planned::{planned, planned_at};
pub use plausible::{Implausible, check_plausible, commands_beyond_limits};
pub use residuals::ObservationResidual;
pub use sensors::{ARM, Sensor, SensorProspect, SensorResult, SensorStudy, compare_sensors, foresee_sensors};
pub use simulate::{measure_session, simulate};
pub use splits::{SplitMode, SplitPlan, SplitStudy, pose_count, repeat_splits, without_gross_errors};
pub use steady::{SteadySets, without_drift};
pub use swept::swept_stations;
pub use truth::KnownTruth;
pub use worth::Worse;

use std::fmt::Write;
use std::fs::File;
use std::io::{self, Read};
use std::ops::ControlFlow;
use std::path::Path;

use nalgebra::Vector3;
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::scenario::Scenario;
use calibrig_estimation::evaluation::accuracy;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
pub use calibrig_estimation::evaluation::{ModeOutcome, RegistrationSummary};
use calibrig_estimation::identification::{
    CalibratedRobot, IdentificationOptions, IdentifyError, Mode, PredictionError, Predictor, identify,
    without_calibration,
};
use calibrig_files::Source;
use calibrig_model::measurement::{CombineError, DriftError, MeasurementSet, StationDrift};
pub use calibrig_model::measurement::{SetKind, SetOutcome};
use calibrig_model::{CalibrationModel, Visual};
use calibrig_plant::PlantError;
use calibrig_plant::effects::EffectError;
use calibrig_plant::experiment::RegionError;
use calibrig_plant::session::{BesideRigid, LEAST_PLACES, PlanError, SessionError, counting};
pub use calibrig_plant::session::{
    MeasuredPose, MissingReading, PlantKind, SessionEvent, SessionListener, Simulation, Truth,
};
use calibrig_plant::tracker::TrackerError;
pub use calibrig_recording::{CarriedReport, InputSummary, Story};

/// Everything that a run leaves behind.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Where the measurements came from.
    pub input: InputSummary,
    /// The input files by role (`scenario`, `robot`, `urdf`, ...), as read.
    pub sources: Vec<(String, Source)>,
    /// What identification was told beforehand.
    pub model: CalibrationModel,
    /// What the links look like; empty where unknown.
    pub visuals: Vec<Vec<Visual>>,
    /// How the row "without calibration" was registered.
    pub registration: RegistrationSummary,
    /// The sets as they were fitted, identification first.
    pub sets: Vec<SetOutcome>,
    /// The same as they were measured, where a tracker's nests were measured more than once; else empty.
    pub as_measured: Vec<SetOutcome>,
    /// What rounds of nests say of the trackers' own motion.
    pub drift: Vec<StationDrift>,
    /// Readings of measured poses that were planned and did not come, one vector a set; empty where that is not known.
    pub missing: Vec<Vec<MissingReading>>,
    /// File and row of every observation, one list a set; empty where they come from no file.
    pub places: Vec<Vec<String>>,
    /// The modes in table order.
    pub modes: Vec<ModeOutcome>,
    /// Only where simulated.
    pub truth: Option<Truth>,
    /// How small errors could be, one entry a mode whose parameters all have a known truth; empty where nothing is known of it.
    pub bounds: Vec<TruthBounds>,
    /// Published figures to print beside, metres: (set, mode, [max x, mean x, max y, mean y, max z, mean z]).
    pub published: Vec<(SetKind, Mode, [f64; 6])>,
    /// How far the estimates can be trusted, one entry a mode with an estimate.
    pub judgements: Vec<Judgement>,
    /// What other targets would have told at the same poses; `None` where nothing can be compared.
    pub sensors: Option<SensorStudy>,
    /// What each part of the simulated machine contributes, where that was asked for.
    pub ablation: Option<Ablation>,
    /// The modes on random splits of the identification set, where that was asked for.
    pub splits: Option<SplitStudy>,
    /// What corrected commands did on the machine, where the scenario asks for it.
    pub closed_loop: Option<ClosedLoop>,
    /// The command line that made the report, with every option; `None` of what no command made.
    pub command: Option<String>,
}

impl Outcome {
    /// What recorders are told of it.
    pub fn story(&self) -> Story<'_> {
        Story {
            input: &self.input,
            sources: &self.sources,
            model: &self.model,
            visuals: &self.visuals,
            registration: &self.registration,
            sets: if self.as_measured.is_empty() { &self.sets } else { &self.as_measured },
            modes: &self.modes,
            truth: self.truth.as_ref(),
            published: &self.published,
            closed_loop: self.closed_loop.as_ref(),
        }
    }
}

/// A run that cannot be carried out.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// The plant cannot be built, or a pose does not come to rest.
    #[error("the plant: {0}")]
    Plant(#[from] PlantError),
    /// No machine can have these effects.
    #[error("the machine's effects: {0}")]
    Effects(#[from] EffectError),
    /// No pose of the machine can be drawn.
    #[error("the working region: {0}")]
    Region(#[from] RegionError),
    /// No tracker can have these errors.
    #[error("the tracker: {0}")]
    Tracker(#[from] TrackerError),
    /// The analytic machine does not come to rest.
    #[error("the analytic plant: {0}")]
    Analytic(#[from] calibrig_estimation::elastostatics::ElasticError),
    /// The analytic machine is one without this effect.
    #[error("the analytic plant has no {} ([effects.{}])", effect.title(), effect.key())]
    BeyondAnalytic {
        /// Which.
        effect: calibrig_plant::effects::EffectKind,
    },
    /// The session as planned cannot be carried out.
    #[error("the session: {0}")]
    Session(#[from] PlanError),
    /// Rounds of nests make no sense.
    #[error(transparent)]
    Drift(#[from] DriftError),
    /// The machine cannot take a pose.
    #[error("{} set, pose {pose}: {source}", set.key())]
    Pose {
        /// The set that it is measured for.
        set: SetKind,
        /// Its number in the set.
        pose: u32,
        /// Why.
        source: Box<PipelineError>,
    },
    /// Whoever listened to the session ended it.
    #[error("interrupted after {done} of {total} poses")]
    Interrupted {
        /// Poses done.
        done: u32,
        /// Poses planned.
        total: u32,
    },
    /// The machine cannot take a place of a sweep.
    #[error("place {} of the sweeps: {source}", place.saturating_add(1))]
    Sweep {
        /// Its number among those of all sweeps.
        place: u32,
        /// Why.
        source: Box<PipelineError>,
    },
    /// A station that the sweeps shall place does not see enough of them.
    #[error(
        "{station} reads {} of the {} places of the sweeps that shall place it (place {}: {why}); two sweeps need {LEAST_PLACES} places each: move the station, \
         turn the target, sweep another range (from_mm, to_mm or from_deg, to_deg), or place it by nests",
        counts[0],
        counts[1],
        counts[2]
    )]
    UnseenSweeps {
        /// The station, in words.
        station: String,
        /// Places read, all places, and the number of the first one that was not read, from 1 on.
        counts: [usize; 3],
        /// Why this one was not.
        why: String,
    },
    /// A nest is out of the tracker's reach.
    #[error("base nest {nest}: {source}")]
    Nest {
        /// Its name.
        nest: String,
        /// Why.
        source: TrackerError,
    },
    /// A point of a tool is out of the tracker's reach.
    #[error("pose {pose}: a target on the flange: {source}")]
    Sensor {
        /// The pose.
        pose: u32,
        /// Why.
        source: TrackerError,
    },
    /// The readings of a tool's points make no pose.
    #[error("pose {pose}: {source}")]
    Combine {
        /// The pose.
        pose: u32,
        /// Why.
        source: CombineError,
    },
    /// An identified robot cannot take a measured pose.
    #[error("{}: {source}", mode.title())]
    Predict {
        /// The mode.
        mode: Mode,
        /// Why.
        source: PredictionError,
    },
    /// A random split cannot be identified.
    #[error("split {split}: {source}")]
    Split {
        /// Its number, from one.
        split: usize,
        /// Why.
        source: Box<PipelineError>,
    },
    /// The nominal robot does not lie on the points: the fit does not start.
    #[error("{0}")]
    Implausible(Box<Implausible>),
    /// Commands cannot be corrected and driven.
    #[error("[compensation]: {0}")]
    ClosedLoop(#[from] ClosedLoopError),
    /// A mode cannot be identified.
    #[error("{}: {source}", mode.title())]
    Identify {
        /// Which.
        mode: Mode,
        /// Why.
        source: IdentifyError,
    },
}

impl<E: Into<Self>> From<SessionError<E>> for PipelineError {
    fn from(error: SessionError<E>) -> Self {
        match error {
            SessionError::Effects(error) => Self::Effects(error),
            SessionError::Region(error) => Self::Region(error),
            SessionError::Plan(error) => Self::Session(error),
            SessionError::Tracker(error) => Self::Tracker(error),
            SessionError::Pose { set, pose, source } => {
                Self::Pose { set, pose, source: Box::new(source.into()) }
            }
            SessionError::Sweep { place, source } => Self::Sweep { place, source: Box::new(source.into()) },
            SessionError::Nest { nest, source } => Self::Nest { nest, source },
            SessionError::Interrupted { done, total } => Self::Interrupted { done, total },
        }
    }
}

/// Identifies in every mode and evaluates on every set. The first set is the one that is fitted.
///
/// Sees measurements and the nominal model only: simulated, replayed and real data take this same way.
pub fn calibrate(
    model: &CalibrationModel,
    sets: &[SetOutcome],
    modes: &[Mode],
    options: &IdentificationOptions,
) -> Result<(RegistrationSummary, Vec<ModeOutcome>), PipelineError> {
    let empty = MeasurementSet::default();
    let fitted = sets.first().map_or(&empty, |set| &set.measurements);
    let registered = without_calibration(model, fitted, options.solver.loss)
        .map_err(|source| PipelineError::Identify { mode: Mode::WithoutCalibration, source })?;
    let rms = accuracy(&errors(&registered, fitted)?).map_or(0.0, |row| row.rms_3d);
    let registration = RegistrationSummary {
        how: if fitted.targets.iter().all(|t| t.covariance.is_none()) {
            "best fit of the nominal robot to the identification set, tracker frame and target offset free"
        } else if fitted.targets.iter().any(|t| t.covariance.is_none()) {
            "best fit of the nominal robot to the identification set, tracker frame and offsets of targets that were not measured free"
        } else {
            "best fit of the nominal robot to the identification set, tracker frame free"
        }
        .to_owned(),
        poses: fitted.observations.len(),
        rms,
    };
    let outcomes = modes
        .iter()
        .map(|&mode| {
            let estimate = match mode {
                Mode::WithoutCalibration => None,
                _ => {
                    let options = IdentificationOptions { mode, ..options.clone() };
                    Some(
                        identify(model, fitted, &options)
                            .map_err(|source| PipelineError::Identify { mode, source })?,
                    )
                }
            };
            let robot = estimate.as_ref().map_or_else(|| registered.clone(), |e| e.robot.clone());
            let errors: Vec<_> = sets
                .iter()
                .map(|set| errors(&robot, &set.measurements))
                .collect::<Result<_, PipelineError>>()?;
            let rows = errors.iter().map(|e| accuracy(e)).collect();
            let turns = sets.iter().map(|set| turns(&robot, &set.measurements)).collect::<Result<_, _>>()?;
            Ok(ModeOutcome { mode, robot, estimate, errors, rows, turns })
        })
        .collect::<Result<_, PipelineError>>()?;
    Ok((registration, outcomes))
}

fn errors(robot: &CalibratedRobot, set: &MeasurementSet) -> Result<Vec<Vector3<f64>>, PipelineError> {
    Predictor::new(robot)
        .and_then(|mut predictor| predictor.errors(set))
        .map_err(|source| PipelineError::Predict { mode: robot.mode, source })
}

fn turns(robot: &CalibratedRobot, set: &MeasurementSet) -> Result<Vec<Option<Vector3<f64>>>, PipelineError> {
    if !set.has_poses() {
        return Ok(vec![None; set.observations.len()]);
    }
    Predictor::new(robot)
        .and_then(|mut predictor| predictor.turns(set))
        .map_err(|source| PipelineError::Predict { mode: robot.mode, source })
}

/// Simulates, identifies and evaluates a scenario: trial 0 of its campaigns. `progress` is told the number of poses done and of all poses.
///
/// Where the scenario has `[compensation]`, the corrected commands are driven as well.
pub fn run(scenario: &Scenario, seed: u64, progress: impl FnMut(u32, u32)) -> Result<Outcome, PipelineError> {
    let mut outcome = run_trial(scenario, seed, 0, PlantKind::Rapier, &mut counting(progress))?;
    outcome.closed_loop =
        close_loop(scenario, (seed, 0, PlantKind::Rapier), &outcome, &mut |_, _| ControlFlow::Continue(()));
    Ok(outcome)
}

/// The source of a run's measurements: the scenario's files, its seed and the trial.
pub fn input_of(scenario: &Scenario, seed: u64, trial: u32, plant: PlantKind) -> InputSummary {
    InputSummary {
        kind: "scenario",
        name: match trial {
            0 => scenario.name.clone(),
            _ => format!("{}, trial {trial}", scenario.name),
        },
        sha256: hash_sources(&scenario.sources),
        seed: Some(seed),
        trial: Some((trial, plant)),
    }
}

/// The same of any trial, with what stands for the machine in the campaign, told to `listener` while it is measured.
pub fn run_trial(
    scenario: &Scenario,
    seed: u64,
    trial: u32,
    plant: PlantKind,
    listener: &mut SessionListener<'_>,
) -> Result<Outcome, PipelineError> {
    let mut beside = BesideRigid::new(listener);
    let simulated = measure_session(scenario, seed, trial, plant, &mut |event| beside.hear(event));
    let rigid = beside.finish()?;
    let mut simulation = simulated?;
    simulation.truth.rigid = rigid;
    let model = &scenario.robot.model;
    let SteadySets { sets, as_measured, drift } = without_drift(simulation.sets)?;
    let (registration, modes) = calibrate(model, &sets, &scenario.modes, &scenario.options)?;
    let judgements = judge(model, &sets, &modes, &scenario.options)?;
    let bounds = bounds_at_truth(model, &sets, &modes, &scenario.options, &simulation.truth);
    let sensors = foresee_sensors(model, &sets, &modes, &scenario.options);
    Ok(Outcome {
        input: input_of(scenario, seed, trial, plant),
        sources: scenario.sources.clone(),
        model: model.clone(),
        visuals: scenario.robot.visuals.clone(),
        registration,
        sets,
        as_measured,
        drift,
        missing: simulation.missing,
        places: Vec::new(),
        modes,
        truth: Some(simulation.truth),
        bounds,
        published: scenario.published.clone(),
        judgements,
        sensors,
        ablation: None,
        splits: None,
        closed_loop: None,
        command: None,
    })
}

/// One hash over the texts of all input files and their roles, hexadecimal.
pub fn hash_sources(sources: &[(String, Source)]) -> String {
    let mut hash = InputHash::default();
    for (role, source) in sources {
        hash.add(role, &source.text);
    }
    hash.hex()
}

/// A hash over input files and their roles.
#[derive(Debug, Clone, Default)]
pub struct InputHash(Sha256);

impl InputHash {
    fn part(&mut self, length: u64) {
        self.0.update(length.to_le_bytes());
    }

    /// Adds a text.
    pub fn add(&mut self, role: &str, text: &str) {
        for part in [role, text] {
            self.part(part.len() as u64);
            self.0.update(part);
        }
    }

    /// Adds a file, which is not held as a whole.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn add_file(&mut self, role: &str, path: &Path) -> io::Result<()> {
        let mut file = File::open(path)?;
        self.part(role.len() as u64);
        self.0.update(role);
        self.part(file.metadata()?.len());
        let mut piece = vec![0; 1 << 16];
        loop {
            match file.read(&mut piece)? {
                0 => return Ok(()),
                count => self.0.update(&piece[..count]),
            }
        }
    }

    /// Hexadecimal.
    pub fn hex(self) -> String {
        self.0.finalize().iter().fold(String::new(), |mut text, byte| {
            // Writing to a String cannot fail.
            let _ = write!(text, "{byte:02x}");
            text
        })
    }
}
