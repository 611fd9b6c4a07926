//! Why there is no plan.

use thiserror::Error;

use crate::pipeline::PipelineError;
use calibrig_estimation::identification::PredictionError;
use calibrig_estimation::planning::PlanError;

/// Why poses cannot be planned.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PosePlanError {
    /// The choice.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The planned session.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The robot.
    #[error(transparent)]
    Robot(#[from] PredictionError),
    /// Too few poses are left.
    #[error(
        "{kept} of {drawn} candidate poses can be measured, but {wanted} are to be chosen{}",
        reasons(refused)
    )]
    TooFew {
        /// The measurable ones.
        kept: usize,
        /// Those that were tried.
        drawn: usize,
        /// To be chosen.
        wanted: usize,
        /// How many were refused, and why; the most first.
        refused: Vec<(String, usize)>,
    },
    /// Pose numbers run out.
    #[error(
        "pose numbers leave no room for {count} more: the next would be {next}, but the last possible is {}",
        u32::MAX
    )]
    NoNumbers {
        /// Number of the first new pose.
        next: u32,
        /// Poses that are to be numbered.
        count: usize,
    },
    /// A region of another robot.
    #[error("the region has {sides} sides, but the robot has {joints} joints")]
    Region {
        /// Of the region.
        sides: usize,
        /// Of the robot.
        joints: usize,
    },
    /// No pose in the working region.
    #[error("the nominal robot can take none of {looked} poses of the working region{}", reasons(refused))]
    NoRegion {
        /// Those that were tried.
        looked: usize,
        /// Why not.
        refused: Vec<(String, usize)>,
    },
    /// An unreachable accuracy without a number of poses.
    #[error("no number of poses reaches {:.4} mm: {why}", 1e3 * accuracy)]
    OutOfReach {
        /// m
        accuracy: f64,
        /// In words.
        why: String,
    },
}

fn reasons(refused: &[(String, usize)]) -> String {
    let told: Vec<_> = refused.iter().take(4).map(|(why, count)| format!("{why} ({count})")).collect();
    if told.is_empty() { String::new() } else { format!(": {}", told.join(", ")) }
}

impl PosePlanError {
    /// A suggestion.
    pub fn help(&self) -> &'static str {
        match self {
            Self::TooFew { .. } => {
                "expected more candidates (--candidates), fewer poses, another place of the tracker, or less --clearance-mm"
            }
            Self::NoRegion { .. } => {
                "expected a region in which the robot can work: check its limits and shapes"
            }
            Self::NoNumbers { .. } => {
                "expected lower pose numbers in the measurements, for example counted from 1"
            }
            Self::Region { .. } => "expected the lowest and the highest variable of every joint",
            Self::OutOfReach { .. } => {
                "expected a larger --accuracy, or --poses N for the best accuracy with that number; see the curve of calibrig \
                 plan --poses N"
            }
            Self::Plan(PlanError::NoNoise { .. }) => {
                "expected readings that state their uncertainty, or --tracker or --noise-um"
            }
            Self::Plan(PlanError::TooFewPoses { .. }) => "expected more poses (--poses), or a prior",
            Self::Plan(PlanError::Singular { .. }) => {
                "expected more or other poses, a prior (--tolerance-mm, --tolerance-mrad), or fewer parameters; `calibrig \
                 identifiability` says what the poses determine"
            }
            _ => "see the reason",
        }
    }
}
