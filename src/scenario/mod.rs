//! What is simulated and how it is identified: the scenario file and its validated, SI form.

mod as_built;
mod campaign;
mod compensation;
mod effects;
mod file;
mod identification;
mod instrument;
mod payloads;
mod poses;
mod remarks;
mod session;
mod sweep;
pub use campaign::{CampaignPlan, Factor, FactorValues, Layout};
pub use compensation::{CompensationPlan, GoalKind, PathPlan};
pub use identification::with_stated_of;

pub use file::{load_scenario, parse_scenario, parse_scenario_with};
pub use remarks::Passing;

use std::borrow::Cow;

use nalgebra::{Matrix3, Vector3};

use calibrig_estimation::identification::{IdentificationOptions, Mode};
use calibrig_files::Robot;
use calibrig_files::Source;
use calibrig_model::measurement::SetKind;
use calibrig_model::{linkage_fault, random};
use calibrig_plant::experiment::WorkingRegion;
use calibrig_plant::session::MeasuringSession;
pub use calibrig_plant::session::{
    Approach, PayloadOrder, PayloadPlan, PoseOrder, SessionPlan, StationShare,
};
use calibrig_plant::tracker::{LaserTracker, Outliers, Probe, TrackerError};
use calibrig_plant::{AsBuilt, AsBuiltDistribution};

/// A validated scenario, SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Name for people.
    pub name: String,
    /// Seed of every random stream.
    pub seed: u64,
    /// The nominal robot: what identification may know.
    pub robot: Robot,
    /// The robot as it really is.
    pub as_built: AsBuilt,
    /// The distribution from which every trial draws its own machine around that one, if it does.
    pub drawn: Option<AsBuiltDistribution>,
    /// Where poses are drawn.
    pub region: WorkingRegion,
    /// Poses of the identification set.
    pub identification_poses: u32,
    /// Poses of the verification set.
    pub verification_poses: u32,
    /// Joint variables of the poses of the identification and of the verification set, if they are not drawn.
    pub listed: [Option<Vec<Vec<f64>>>; 2],
    /// The tracker at its real place.
    pub tracker: LaserTracker,
    /// Gross errors among its readings of the target, if any.
    pub outliers: Option<Outliers>,
    /// What measures the target's orientation together with its place; `None` if the target is a point.
    pub probe: Option<Probe>,
    /// Base nests: name and true place in the base frame, m.
    pub nests: Vec<(String, Vector3<f64>)>,
    /// Standard deviation of the nests' certified coordinates, m.
    pub nest_sigma: f64,
    /// Covariance of the measured target offset, m².
    pub target_covariance: Matrix3<f64>,
    /// How the session is carried out.
    pub plan: SessionPlan,
    /// What is fitted; the mode is set for each row.
    pub options: IdentificationOptions,
    /// The rows of the tables.
    pub modes: Vec<Mode>,
    /// What is driven with corrected commands after the session, if anything.
    pub compensation: Option<CompensationPlan>,
    /// What varies in its campaigns, if stated.
    pub campaign: Option<CampaignPlan>,
    /// Published figures to print for comparison: m, max x, mean x, max y, mean y, max z, mean z.
    pub published: Vec<(SetKind, Mode, [f64; 6])>,
    /// The files read, by role.
    pub sources: Vec<(String, Source)>,
}

/// Largest number of redraws of a machine; scenarios that would need more are refused.
const MOST_REDRAWS: u32 = 20;

impl Scenario {
    /// The machine of a trial: the given one, or one drawn only from (seed, trial).
    pub fn as_built_for(&self, seed: u64, trial: u32) -> AsBuilt {
        self.machine_of(seed, trial).0
    }

    /// How often the machine of a trial is drawn again because the loop of the one before does not close.
    pub fn redraws(&self, seed: u64, trial: u32) -> u32 {
        self.machine_of(seed, trial).1
    }

    fn machine_of(&self, seed: u64, trial: u32) -> (AsBuilt, u32) {
        let Some(drawn) = &self.drawn else { return (self.as_built.clone(), 0) };
        let draw = |count: u32| {
            let mut rng = random::stream_at(seed, trial, random::StreamSource::AsBuilt, count.into());
            drawn.draw(&self.as_built, &mut rng)
        };
        let mut machine = draw(0);
        let mut count = 0;
        // Checking an unchanged loop would take longer than everything else.
        if !drawn.varies_linkage() {
            return (machine, 0);
        }
        while count < MOST_REDRAWS && linkage_fault(&machine.kinematics, &machine.actuators).is_some() {
            count += 1;
            machine = draw(count);
        }
        (machine, count)
    }

    /// The first station's tracker with its errors in a trial, which its session draws by itself.
    pub fn tracker_for(&self, seed: u64, trial: u32) -> Result<Cow<'_, LaserTracker>, TrackerError> {
        if !self.tracker.has_law() {
            return Ok(Cow::Borrowed(&self.tracker));
        }
        self.tracker.drawn(seed, trial, 0, self.session().duration()).map(Cow::Owned)
    }

    /// The measurement of its given machine. The session draws the errors of its trackers in a trial.
    pub fn session(&self) -> MeasuringSession<'_> {
        MeasuringSession {
            as_built: &self.as_built,
            actuators: &self.robot.model.actuators,
            region: &self.region,
            listed: self.listed.each_ref().map(|poses| poses.as_deref()),
            identification_poses: self.identification_poses,
            verification_poses: self.verification_poses,
            tracker: &self.tracker,
            outliers: self.outliers.as_ref(),
            probe: self.probe.as_ref(),
            nests: &self.nests,
            nest_sigma: self.nest_sigma,
            target_covariance: &self.target_covariance,
            plan: &self.plan,
        }
    }

    /// The scenario with the machine of a trial as the given one.
    pub fn of_trial(&self, seed: u64, trial: u32) -> Cow<'_, Self> {
        match self.drawn {
            None => Cow::Borrowed(self),
            Some(_) => {
                Cow::Owned(Self { as_built: self.as_built_for(seed, trial), drawn: None, ..self.clone() })
            }
        }
    }
}
