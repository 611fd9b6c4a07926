//! The measuring session of a simulated machine: its poses, the tracker's readings there, and the truth.

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

/// The truth of a simulated session, for reports and recordings only.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The machine.
    pub as_built: AsBuilt,
    /// `tracker_from_base` of every station, at its mean over the rounds of nests.
    pub stations: Vec<Transform>,
    /// The instrument's real errors, m, rad or 1; empty if unknown, or if the stations' instruments differ.
    pub instrument: Vec<(InstrumentTerm, f64)>,
    /// The loads that the flange carried at some poses, as they really are; the observations refer to them by name, with
    /// the stated values.
    pub payloads: Vec<Payload>,
    /// Real offsets of the targets besides the machine's own, in the flange frame, m.
    pub further_targets: Vec<Vector3<f64>>,
    /// `flange_from_target` of the first target, if its orientation is measured; `None` for a point.
    pub orientation: Option<Rotation3<f64>>,
    /// The settled poses, one vector per set, one entry per observation, with the target that was observed.
    pub poses: Vec<Vec<SettledPose>>,
    /// The result of the machine's effects at every pose, in the order of `poses`.
    pub effects: Vec<Vec<PoseEffects>>,
    /// Poses whose reading is a gross error, with that error in the base frame, m; one vector per set.
    pub outliers: Vec<Vec<(u32, Vector3<f64>)>>,
    /// The same poses, effects included, of the same machine with everything rigid, in the order of `poses`; empty if not asked for.
    pub rigid: Vec<Vec<SettledPose>>,
}

/// A simulated session: what the tracker measured, and the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// The measured sets, identification first.
    pub sets: Vec<SetOutcome>,
    /// Planned readings of measured poses that are missing, one vector per set.
    pub missing: Vec<Vec<MissingReading>>,
    /// Missing readings of the sweeps; a pose is the number of the place among those of all sweeps.
    pub sweeps_missing: Vec<MissingReading>,
    /// The truth.
    pub truth: Truth,
}

/// A planned reading that is missing.
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

    /// The pose at rest at the positions of its motors (m or rad, one per actuator), with the frames of the links displaced (along, then about
    /// x, y and z; m and rad, one per joint; empty for none).
    fn settle(&mut self, motors: &[f64], displacements: &[[f64; 6]]) -> Result<SettledPose, Self::Error>;

    /// Like [`settle`](Self::settle) without displacements, on the way to a measured pose: only the loads of its drives are used, so no
    /// confirmation is needed.
    fn pass(&mut self, motors: &[f64]) -> Result<SettledPose, Self::Error> {
        self.settle(motors, &[])
    }

    /// Hangs a load on the flange, or takes it off, for all later poses.
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

/// Why a session cannot be measured. `E` is why the machine does not come to rest. Exhaustive, because the caller of a
/// session has to handle every case.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SessionError<E> {
    /// The machine's effects are invalid.
    #[error("the machine's effects: {0}")]
    Effects(#[from] EffectError),
    /// No pose of the machine can be drawn.
    #[error("the working region: {0}")]
    Region(#[from] RegionError),
    /// The plan cannot be carried out.
    #[error("the session: {0}")]
    Plan(#[from] PlanError),
    /// The tracker's figures are invalid.
    #[error("the tracker: {0}")]
    Tracker(#[from] TrackerError),
    /// The machine cannot reach a pose.
    #[error("{} set, pose {pose}: {source}", set.key())]
    Pose {
        /// The set that it is measured for.
        set: SetKind,
        /// Its number in the set.
        pose: u32,
        /// Why.
        source: E,
    },
    /// The machine cannot reach a place of a sweep.
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
    /// The listener ended the session.
    #[error("interrupted after {done} of {total} poses")]
    Interrupted {
        /// Poses done.
        done: u32,
        /// Poses planned.
        total: u32,
    },
}

/// Which model stands for the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlantKind {
    /// The multibody simulation, which shares nothing with the identification.
    #[default]
    Rapier,
    /// The identification's own elastostatics with the real parameters: a matched model, only for tests of the estimator.
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
