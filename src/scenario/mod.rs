//! What is simulated and how it is identified: the scenario file and its validated, SI form.

mod effects;
mod file;

pub use file::{load_scenario, parse_scenario};

use nalgebra::{Matrix3, Vector3};

use crate::experiment::WorkingRegion;
use crate::identification::{IdentificationOptions, Mode};
use crate::input::Source;
use crate::measurement::SetKind;
use crate::model::Robot;
use crate::plant::AsBuilt;
use crate::tracker::LaserTracker;

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
    /// Where poses are drawn.
    pub region: WorkingRegion,
    /// Poses of the identification set.
    pub identification_poses: u32,
    /// Poses of the verification set.
    pub verification_poses: u32,
    /// The tracker at its real place.
    pub tracker: LaserTracker,
    /// Base nests: name and true place in the base frame, m.
    pub nests: Vec<(String, Vector3<f64>)>,
    /// Standard deviation of the nests' certified coordinates, m.
    pub nest_sigma: f64,
    /// Covariance of the measured target offset, m².
    pub target_covariance: Matrix3<f64>,
    /// What is fitted; the mode is set for each row.
    pub options: IdentificationOptions,
    /// The rows of the tables.
    pub modes: Vec<Mode>,
    /// Published figures to print beside: m, max x, mean x, max y, mean y, max z, mean z.
    pub published: Vec<(SetKind, Mode, [f64; 6])>,
    /// The files read, by role.
    pub sources: Vec<(String, Source)>,
}
