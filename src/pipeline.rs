//! A run in short: simulate, identify, evaluate.

mod ablation;
mod acceptance;
mod bounds;
mod closed_loop;
mod defaults;
mod diagnosis;
mod iso9283;
mod machine;
mod planned;
mod plausible;
mod sensors;
mod simulate;
mod steady;
mod swept;
mod truth;

pub use ablation::{AblatedPart, Ablation, AblationRows, MachinePart, ablate};
pub use acceptance::{AcceptanceOutcome, Finding, Ratios, Test, TestOutcome, TestedKind, test_instruments};
pub(crate) use bounds::information_at_truth;
pub use bounds::{TruthBounds, bounds_at_truth};
pub use calibrig_estimation::calibration::{
    ALL_TERMS, CalibrateError, ChosenRow, Confidence, DEFAULT_TERMS, FALSE_ALARM, FailedVariant, Judgement,
    ModelChoice, ObservationResidual, PredictedPosition, SplitMode, SplitPlan, SplitStudy, Worse, calibrate,
    choose, judge, pose_count, repeat_splits, without_gross_errors,
};
pub use closed_loop::{ClosedLoopError, close_loop};
pub use defaults::{default_modes, default_options, is_default};
pub use diagnosis::{Names, mm};
pub use iso9283::{
    AccuracyAgainst, CombinedOrientation, Iso9283Failure, Iso9283Outcome, Iso9283Plan, Iso9283Pose,
    Iso9283Target, ReachError, iso9283_of_scenario, iso9283_of_set,
};
pub use machine::check_analytic;
pub use planned::{planned, planned_at};
pub use plausible::{Implausible, check_plausible, commands_beyond_limits};
pub use sensors::{ARM, Sensor, SensorProspect, SensorResult, SensorStudy, compare_sensors, foresee_sensors};
pub use simulate::{measure_session, simulate};
pub use steady::{SteadySets, without_drift};
pub use swept::swept_stations;
pub use truth::KnownTruth;

use std::fmt::Write;
use std::fs::File;
use std::io::{self, Read};
use std::ops::ControlFlow;
use std::path::Path;

use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::scenario::Scenario;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
pub use calibrig_estimation::evaluation::{ModeOutcome, RegistrationSummary};
use calibrig_estimation::identification::Mode;
use calibrig_files::Source;
use calibrig_model::measurement::{CombineError, DriftError, StationDrift};
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

/// All results of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Origin of the measurements.
    pub input: InputSummary,
    /// The input files by role (`scenario`, `robot`, `urdf`, ...), as read.
    pub sources: Vec<(String, Source)>,
    /// What identification knew beforehand.
    pub model: CalibrationModel,
    /// The shapes of the links; empty if unknown.
    pub visuals: Vec<Vec<Visual>>,
    /// How the row "without calibration" was registered.
    pub registration: RegistrationSummary,
    /// The sets as they were fitted, identification first.
    pub sets: Vec<SetOutcome>,
    /// The same as measured, if a tracker's nests were measured more than once; else empty.
    pub as_measured: Vec<SetOutcome>,
    /// What rounds of nests say about the trackers' own motion.
    pub drift: Vec<StationDrift>,
    /// Planned readings of measured poses that are missing, one vector per set; empty if unknown.
    pub missing: Vec<Vec<MissingReading>>,
    /// File and row of every observation, one list per set; empty if they come from no file.
    pub places: Vec<Vec<String>>,
    /// The modes in table order.
    pub modes: Vec<ModeOutcome>,
    /// Only for simulations.
    pub truth: Option<Truth>,
    /// How small errors could be, one entry per mode whose parameters all have a known truth; empty if none has.
    pub bounds: Vec<TruthBounds>,
    /// Published figures to print for comparison, metres: (set, mode, [max x, mean x, max y, mean y, max z, mean z]).
    pub published: Vec<(SetKind, Mode, [f64; 6])>,
    /// How far the estimates can be trusted, one entry per mode with an estimate.
    pub judgements: Vec<Judgement>,
    /// What other targets would have determined at the same poses; `None` if nothing can be compared.
    pub sensors: Option<SensorStudy>,
    /// What each part of the simulated machine contributes, if asked for.
    pub ablation: Option<Ablation>,
    /// The modes on random splits of the identification set, if asked for.
    pub splits: Option<SplitStudy>,
    /// The results of corrected commands on the machine, if the scenario asks for them.
    pub closed_loop: Option<ClosedLoop>,
    /// The command line that made the report, with every option; `None` of what no command made.
    pub command: Option<String>,
}

impl Outcome {
    /// What recorders receive.
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

/// Why a run cannot be carried out.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// The plant cannot be built, or a pose does not come to rest.
    #[error("the plant: {0}")]
    Plant(#[from] PlantError),
    /// The machine's effects are invalid.
    #[error("the machine's effects: {0}")]
    Effects(#[from] EffectError),
    /// No pose of the machine can be drawn.
    #[error("the working region: {0}")]
    Region(#[from] RegionError),
    /// The tracker's errors are invalid.
    #[error("the tracker: {0}")]
    Tracker(#[from] TrackerError),
    /// The analytic machine does not come to rest.
    #[error("the analytic plant: {0}")]
    Analytic(#[from] calibrig_estimation::elastostatics::ElasticError),
    /// The analytic machine does not support this effect.
    #[error("the analytic plant has no {} ([effects.{}])", effect.title(), effect.key())]
    BeyondAnalytic {
        /// Which.
        effect: calibrig_plant::effects::EffectKind,
    },
    /// The session as planned cannot be carried out.
    #[error("the session: {0}")]
    Session(#[from] PlanError),
    /// Rounds of nests are inconsistent.
    #[error(transparent)]
    Drift(#[from] DriftError),
    /// The machine cannot reach a pose.
    #[error("{} set, pose {pose}: {source}", set.key())]
    Pose {
        /// The set that it is measured for.
        set: SetKind,
        /// Its number in the set.
        pose: u32,
        /// Why.
        source: Box<PipelineError>,
    },
    /// The listener ended the session.
    #[error("interrupted after {done} of {total} poses")]
    Interrupted {
        /// Poses done.
        done: u32,
        /// Poses planned.
        total: u32,
    },
    /// The machine cannot reach a place of a sweep.
    #[error("place {} of the sweeps: {source}", place.saturating_add(1))]
    Sweep {
        /// Its number among those of all sweeps.
        place: u32,
        /// Why.
        source: Box<PipelineError>,
    },
    /// A station that sweeps are to place sees too few of their places.
    #[error(
        "{station} reads {} of the {} places of the sweeps that are to place it (place {}: {why}); each of two sweeps needs \
         {LEAST_PLACES} places: move the station, turn the target, sweep another range (from_mm, to_mm or from_deg, to_deg), \
         or place it by nests",
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
    /// The readings of a tool's points do not make a pose.
    #[error("pose {pose}: {source}")]
    Combine {
        /// The pose.
        pose: u32,
        /// Why.
        source: CombineError,
    },
    /// The nominal robot does not fit the points: the fit does not start.
    #[error("{0}")]
    Implausible(Box<Implausible>),
    /// Commands cannot be corrected and driven.
    #[error("[compensation]: {0}")]
    ClosedLoop(#[from] ClosedLoopError),
    /// The sets cannot be calibrated.
    #[error(transparent)]
    Calibrate(#[from] CalibrateError),
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

/// Simulates, identifies and evaluates a scenario: trial 0 of its campaigns. `progress` receives the number of poses done and of all
/// poses.
///
/// If the scenario has `[compensation]`, the corrected commands are driven as well.
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

/// The same for any trial, with a choice of the machine's model, reported to `listener` while it is measured.
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

    /// Adds a file, piece by piece.
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
