//! The short story of a run: simulate, identify, evaluate.

use nalgebra::Vector3;

use crate::evaluation::AccuracyRow;
use crate::identification::{CalibratedRobot, Estimate, Mode};
use crate::input::Source;
use crate::measurement::MeasurementSet;
use crate::model::{CalibrationModel, Visual};
use crate::plant::{AsBuilt, SettledPose};

/// Which of the two sets of poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum SetKind {
    /// The parameters are fitted to it.
    Identification,
    /// Held out.
    Verification,
}

impl SetKind {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Identification, Self::Verification];

    /// The key in JSON and recordings.
    pub fn key(self) -> &'static str {
        match self {
            Self::Identification => "identification",
            Self::Verification => "verification",
        }
    }
}

/// Where the measurements came from.
#[derive(Debug, Clone, PartialEq)]
pub struct InputSummary {
    /// `scenario`, `files` or `recording`.
    pub kind: &'static str,
    /// Its name for people.
    pub name: String,
    /// Hash over every input file, hexadecimal.
    pub sha256: String,
    /// The seed of a simulation.
    pub seed: Option<u64>,
}

/// How the tracker's frame was tied to the robot's for the row "without calibration".
#[derive(Debug, Clone, PartialEq)]
pub struct RegistrationSummary {
    /// In words.
    pub how: String,
    /// Poses used.
    pub poses: usize,
    /// RMS of the 3-D residual of the fit, m.
    pub rms: f64,
}

/// A measured set with its errors per mode.
#[derive(Debug, Clone, PartialEq)]
pub struct SetOutcome {
    /// Which.
    pub kind: SetKind,
    /// What was measured.
    pub measurements: MeasurementSet,
    /// Poses that were planned but not measured, with the reason.
    pub dropped: Vec<(u32, String)>,
}

/// What one mode made of the measurements.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeOutcome {
    /// Which.
    pub mode: Mode,
    /// The robot that predicts.
    pub robot: CalibratedRobot,
    /// How it was identified; `None` for "without calibration".
    pub estimate: Option<Estimate>,
    /// Measured minus predicted in the base frame, m: one vector a set of [`Outcome::sets`], one entry an observation.
    pub errors: Vec<Vec<Vector3<f64>>>,
    /// The rows of the tables, one a set.
    pub rows: Vec<Option<AccuracyRow>>,
}

/// The truth of a simulated run, for the report and the recording alone.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The machine.
    pub as_built: AsBuilt,
    /// `tracker_from_base` of the station.
    pub tracker_from_base: crate::geometry::Transform,
    /// The settled poses, one vector a set, one entry an observation.
    pub poses: Vec<Vec<SettledPose>>,
}

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
    /// The sets, identification first.
    pub sets: Vec<SetOutcome>,
    /// The modes in table order.
    pub modes: Vec<ModeOutcome>,
    /// Only where simulated.
    pub truth: Option<Truth>,
    /// Published figures to print beside, metres: (set, mode, [max x, mean x, max y, mean y, max z, mean z]).
    pub published: Vec<(SetKind, Mode, [f64; 6])>,
}
