//! Why poses cannot be planned.

use thiserror::Error;

use super::Criterion;
use crate::identification::{DependentGroup, IdentifyError, PredictionError};

/// Why poses cannot be planned.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The robot, the candidates' set or the options cannot be used.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// There is no candidate to choose from.
    #[error(
        "there is no candidate pose: expected some that are not yet measured; loosen the filters, or draw more"
    )]
    NoCandidates,
    /// There are fewer candidates than poses to choose.
    #[error(
        "{candidates} candidate poses for {wanted} to choose: expected at least as many; draw more, choose fewer, or allow repeats"
    )]
    TooFewCandidates {
        /// Number of candidates.
        candidates: usize,
        /// Number of poses to choose.
        wanted: usize,
    },
    /// The number of poses to choose is zero.
    #[error("no pose is to be chosen: expected a number of one or more")]
    NoPoses,
    /// The poses cannot determine the parameters.
    #[error(
        "{count} poses have at most {rows} coordinates, which together with the priors determine {determined} of {parameters} \
         parameters: expected at least {least} poses, or a prior (tolerance) on the parameters"
    )]
    TooFewPoses {
        /// Number of poses to choose.
        count: usize,
        /// Most coordinates that this number of poses has.
        rows: usize,
        /// Most parameters that these, priors, nests, targets and earlier poses determine.
        determined: usize,
        /// Number of parameters.
        parameters: usize,
        /// Number of poses that could be enough.
        least: usize,
    },
    /// Some parameters are determined neither by any choice of these candidates nor by a prior.
    #[error(
        "{what} cannot determine all parameters: {}; give these a prior (tolerance), fix one of each group, or look for other \
         poses",
        .groups.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
    )]
    Singular {
        /// The candidates, or the chosen poses.
        what: &'static str,
        /// Groups of dependent parameters.
        groups: Vec<DependentGroup>,
    },
    /// A criterion of a region is used without a region.
    #[error("{}-optimality needs a region, but none is given: expected poses where the robot will work", .criterion.key())]
    NoRegion {
        /// Which criterion.
        criterion: Criterion,
    },
    /// A planned reading states no noise.
    #[error(
        "pose {pose}: the planned reading states no covariance: expected one, because it is weighed against the priors"
    )]
    NoNoise {
        /// Number of the pose.
        pose: u32,
    },
    /// A number is not finite.
    #[error("{what} is not a finite number")]
    NotFinite {
        /// What the number is.
        what: String,
    },
    /// A list has the wrong length.
    #[error("{what}: {found} entries, expected {expected}")]
    Length {
        /// Which list.
        what: String,
        /// Its length.
        found: usize,
        /// Expected length.
        expected: usize,
    },
    /// A number is out of its range.
    #[error("{field} is {value}: expected {expected}")]
    Number {
        /// Name of the number.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What is expected.
        expected: &'static str,
    },
    /// A pose is beyond the robot's limits.
    #[error(
        "{what}: joint {} is at {value:.6}, beyond its limits {} to {} by {:.6} (m or rad)",
        .joint.saturating_add(1), .limits[0], .limits[1], (.limits[0] - .value).max(.value - .limits[1])
    )]
    OutsideLimits {
        /// The pose, or the end of a region.
        what: String,
        /// Index of the joint.
        joint: usize,
        /// Joint variable, m or rad.
        value: f64,
        /// Limits of the joint, m or rad.
        limits: [f64; 2],
    },
    /// The robot cannot take a pose of the region.
    #[error("pose {} of the region: {source}", .index.saturating_add(1))]
    Region {
        /// Index in the list.
        index: usize,
        /// Why.
        source: PredictionError,
    },
    /// A pose that is listed as measured is not in the set.
    #[error("pose {pose} is listed as measured, but the set has no pose of that number")]
    UnknownMeasured {
        /// Number of the pose.
        pose: u32,
    },
    /// A drawn robot cannot take a pose.
    #[error("robot {} of those drawn from the priors: {source}; expected a smaller tolerance, or candidates farther from the \
             limits of the linkage", .robot.saturating_add(1))]
    Drawn {
        /// Index of the robot.
        robot: usize,
        /// Why.
        source: IdentifyError,
    },
}
