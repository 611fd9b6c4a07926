//! The measuring session of a simulated machine: which poses it takes, what the tracker reads there, and the truth beside it.

mod beside;
mod controller;
mod cycles;
mod driven;
mod events;
mod measure;
mod nests;
mod payloads;
mod plan;
mod schedule;
mod sight;
mod sweeps;
#[cfg(test)]
mod tests;

pub use beside::{BesideRigid, RigidMachine};
pub use cycles::{CycleError, CycleMeasurements};
pub use driven::{DriveError, DriveProgress, DrivenSet};
pub use events::{MeasuredPose, SessionEvent, SessionListener, counting};
pub use measure::MeasuringSession;
pub use payloads::{PayloadOrder, PayloadPlan, PlannedPayload};
pub use plan::{
    Approach, FurtherStation, FurtherTarget, LEAST_PLACES, MOST_ORDERED_POSES, MOST_PLACES, MOST_REPEATS,
    MOST_SECONDS, NestRounds, PlanError, PoseOrder, SessionPlan, Sight, StationShare, Timing,
};
pub use sweeps::PlannedSweep;

use nalgebra::{Rotation3, Vector3};
use thiserror::Error;

use super::effects::{EffectError, PoseEffects};
use super::experiment::RegionError;
use super::tracker::TrackerError;
use super::{AsBuilt, Plant, PlantError, SettledPose};
use calibrig_model::Payload;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{InstrumentTerm, SetKind, SetOutcome};

/// The truth of a simulated session, for reports and recordings alone.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The machine.
    pub as_built: AsBuilt,
    /// `tracker_from_base` of every station, on the average of its rounds of nests.
    pub stations: Vec<Transform>,
    /// What the readings of the instrument are really off by, m, rad or 1; empty where that is not known, or the stations' instruments differ.
    pub instrument: Vec<(InstrumentTerm, f64)>,
    /// The loads that the flange carried at some poses, as they really are; the observations have them by name, as stated.
    pub payloads: Vec<Payload>,
    /// Real offsets of the targets beside the machine's own, in the flange frame, m.
    pub further_targets: Vec<Vector3<f64>>,
    /// `flange_from_target` of the first target, where its orientation is measured; `None` of a point.
    pub orientation: Option<Rotation3<f64>>,
    /// The settled poses, one vector a set, one entry an observation, with the target that was observed.
    pub poses: Vec<Vec<SettledPose>>,
    /// What the machine's effects made of every pose, in the order of `poses`.
    pub effects: Vec<Vec<PoseEffects>>,
    /// Poses whose reading is a gross error, and what it is off by in the base frame, m; one vector a set.
    pub outliers: Vec<Vec<(u32, Vector3<f64>)>>,
    /// The same poses, effects included, of the same machine if nothing of it yielded, in the order of `poses`; empty where not asked for.
    pub rigid: Vec<Vec<SettledPose>>,
}

/// A simulated session: what the tracker saw, and the truth beside it.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// The measured sets, identification first.
    pub sets: Vec<SetOutcome>,
    /// Readings of measured poses that were planned and did not come, one vector a set.
    pub missing: Vec<Vec<MissingReading>>,
    /// Readings of the sweeps that did not come; a pose is the number of the place among those of all sweeps.
    pub sweeps_missing: Vec<MissingReading>,
    /// What really was.
    pub truth: Truth,
}

/// A reading that was planned and did not come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissingReading {
    /// Number of the pose in its set.
    pub pose: u32,
    /// Index of the station.
    pub station: usize,
    /// Index of the target.
    pub target: usize,
    /// Why.
    pub why: String,
}

/// A machine that can be brought to rest.
pub trait Machine {
    /// Why it does not come to rest.
    type Error;

    /// The pose at rest at the positions of its motors (m or rad, one an actuator), with the frames of the links displaced (along, then about x,
    /// y and z; m and rad, one a joint; empty for none).
    fn settle(&mut self, motors: &[f64], displacements: &[[f64; 6]]) -> Result<SettledPose, Self::Error>;

    /// Like [`settle`](Self::settle) without displacements, on the way to a pose that is measured: only the loads of its drives are used, so that
    /// nothing has to confirm it.
    fn pass(&mut self, motors: &[f64]) -> Result<SettledPose, Self::Error> {
        self.settle(motors, &[])
    }

    /// Hangs a load on the flange, or takes it off, for all poses from now on.
    fn carry(&mut self, payload: Option<&Payload>) -> Result<(), Self::Error>;
}

impl Machine for Plant {
    type Error = PlantError;

    fn settle(&mut self, motors: &[f64], displacements: &[[f64; 6]]) -> Result<SettledPose, PlantError> {
        self.settle_displaced(motors, displacements)
    }

    fn pass(&mut self, motors: &[f64]) -> Result<SettledPose, PlantError> {
        self.settle_and(false, motors, &[])
    }

    fn carry(&mut self, payload: Option<&Payload>) -> Result<(), PlantError> {
        Plant::carry(self, payload)
    }
}

/// A session that cannot be measured. `E` is why the machine does not come to rest. It is exhaustive, since
/// whoever runs a session has to pass every case on.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SessionError<E> {
    /// No machine can have these effects.
    #[error("the machine's effects: {0}")]
    Effects(#[from] EffectError),
    /// No pose of the machine can be drawn.
    #[error("the working region: {0}")]
    Region(#[from] RegionError),
    /// The plan cannot be carried out.
    #[error("the session: {0}")]
    Plan(#[from] PlanError),
    /// No tracker can have these figures.
    #[error("the tracker: {0}")]
    Tracker(#[from] TrackerError),
    /// The machine cannot take a pose.
    #[error("{} set, pose {pose}: {source}", set.key())]
    Pose {
        /// The set that it is measured for.
        set: SetKind,
        /// Its number in the set.
        pose: u32,
        /// Why.
        source: E,
    },
    /// The machine cannot take a place of a sweep.
    #[error("place {} of the sweeps: {source}", place.saturating_add(1))]
    Sweep {
        /// Its number among those of all sweeps.
        place: u32,
        /// Why.
        source: E,
    },
    /// A nest is out of the tracker's reach.
    #[error("base nest {nest}: {source}")]
    Nest {
        /// Its name.
        nest: String,
        /// Why.
        source: TrackerError,
    },
    /// Whoever listened to the session ended it.
    #[error("interrupted after {done} of {total} poses")]
    Interrupted {
        /// Poses done.
        done: u32,
        /// Poses planned.
        total: u32,
    },
}

/// What stands for the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlantKind {
    /// The multibody simulation, which shares nothing with the identification.
    #[default]
    Rapier,
    /// The identification's own elastostatics with the real parameters: a matched model, for tests of the estimator alone.
    Analytic,
}

impl PlantKind {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Rapier, Self::Analytic];

    /// The key on the command line and in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Rapier => "rapier",
            Self::Analytic => "analytic",
        }
    }
}
