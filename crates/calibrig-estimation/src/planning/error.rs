//! What cannot be planned, and why.

use thiserror::Error;

use super::Criterion;
use crate::identification::{DependentGroup, IdentifyError, PredictionError};

/// Poses that cannot be planned.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The robot, the candidates' set or the options cannot be used.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// Nothing to choose from.
    #[error(
        "there is no candidate pose: expected some that are not yet measured; loosen the filters, or draw more"
    )]
    NoCandidates,
    /// Fewer candidates than poses.
    #[error(
        "{candidates} candidate poses for {wanted} to choose: expected at least as many; draw more, choose fewer, or allow repeats"
    )]
    TooFewCandidates {
        /// Candidates.
        candidates: usize,
        /// Poses to choose.
        wanted: usize,
    },
    /// A design of nothing.
    #[error("no pose is to be chosen: expected a number of one or more")]
    NoPoses,
    /// Poses that cannot determine the parameters.
    #[error(
        "{count} poses have at most {rows} coordinates, which together with the priors determine {determined} of {parameters} \
         parameters: expected at least {least} poses, or a prior (tolerance) on the parameters"
    )]
    TooFewPoses {
        /// Poses to choose.
        count: usize,
        /// Coordinates that so many poses have at most.
        rows: usize,
        /// Parameters that these, priors, nests, targets and earlier poses determine at most.
        determined: usize,
        /// Parameters.
        parameters: usize,
        /// Poses that could do.
        least: usize,
    },
    /// What no choice of these candidates determines, and no prior holds.
    #[error(
        "{what} cannot determine all parameters: {}; give these a prior (tolerance), fix one of each group, or look for other \
         poses",
        .groups.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
    )]
    Singular {
        /// The candidates, or the chosen poses.
        what: &'static str,
        /// What depends on what.
        groups: Vec<DependentGroup>,
    },
    /// A criterion of a region without one.
    #[error("{}-optimality needs a region, but none is given: expected poses where the robot will work", .criterion.key())]
    NoRegion {
        /// Which.
        criterion: Criterion,
    },
    /// A reading whose noise nobody states.
    #[error(
        "pose {pose}: the planned reading states no covariance: expected one, because it is weighed against the priors"
    )]
    NoNoise {
        /// The pose.
        pose: u32,
    },
    /// A number that is not one.
    #[error("{what} is not a finite number")]
    NotFinite {
        /// Which.
        what: String,
    },
    /// A list of another length.
    #[error("{what}: {found} entries, expected {expected}")]
    Length {
        /// Which.
        what: String,
        /// Its length.
        found: usize,
        /// What it has to be.
        expected: usize,
    },
    /// A number out of its range.
    #[error("{field} is {value}: expected {expected}")]
    Number {
        /// Which.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What it has to be.
        expected: &'static str,
    },
    /// A pose that the robot's limits exclude.
    #[error(
        "{what}: joint {} is at {value:.6}, beyond its limits {} to {} by {:.6} (m or rad)",
        .joint.saturating_add(1), .limits[0], .limits[1], (.limits[0] - .value).max(.value - .limits[1])
    )]
    OutsideLimits {
        /// Which pose, or which end of a region.
        what: String,
        /// Index of the joint.
        joint: usize,
        /// Its variable, m or rad.
        value: f64,
        /// The limits.
        limits: [f64; 2],
    },
    /// A pose of the region that the robot cannot take.
    #[error("pose {} of the region: {source}", .index.saturating_add(1))]
    Region {
        /// Its place in the list.
        index: usize,
        /// Why.
        source: PredictionError,
    },
    /// A pose that is said to be measured and is not in the set.
    #[error("pose {pose} is listed as measured, but the set has no pose of that number")]
    UnknownMeasured {
        /// Its number.
        pose: u32,
    },
    /// A drawn robot that cannot take a pose.
    #[error("robot {} of those drawn from the priors: {source}; expected a smaller tolerance, or candidates farther from the \
             limits of the linkage", .robot.saturating_add(1))]
    Drawn {
        /// Which.
        robot: usize,
        /// Why.
        source: IdentifyError,
    },
}
