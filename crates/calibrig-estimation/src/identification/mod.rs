//! From measurements to parameters: weighted nonlinear least squares with priors, and what the data can and cannot determine.
//!
//! Nothing here can see the plant, the inside of the tracker or the truth: this crate does not depend on the crates that hold them.

mod build;
mod by_name;
mod commanded;
mod contradiction;
mod divided;
mod estimate;
mod factor;
mod factorised;
mod foresight;
mod forward_model;
mod gross;
mod identifiability;
mod identify;
mod information;
mod instrument;
mod limits;
mod linearisation;
mod mode;
mod noise;
mod options;
mod parameters;
mod place;
mod planned;
mod problem;
mod prospect;
mod robot;
mod shared;
mod sizes;
mod solver;
mod summary;
mod swept;
#[cfg(test)]
mod tests;
mod turns;
mod uncertainty;
mod variance;
mod verdict;
mod weighed;
mod within;

pub use by_name::{ByNameError, ListedParameter, ParameterState, check_named, list_parameters};
pub use contradiction::{CONTRADICTION_LEVEL, Contradiction, Stated};
pub use estimate::{
    Assumption, Estimate, IterationRecord, LeftOut, LeftOutReason, NoiseScale, Outlier, ParameterEstimate,
    TerminationReason, Warning,
};
pub(crate) use factor::triangular_factor_of_all;
pub use foresight::{ForeseenSpread, Foresight, foresee};
pub use gross::held_out_outliers;
pub(crate) use identifiability::analyse_r;
pub use identifiability::{
    DependentGroup, Explanation, Finding, IdentifiabilityReport, RANK_TOLERANCE, Remedy, Spectrum,
    WEAK_TOLERANCE, WeakDirection, complete_set, complete_set_of, explain, identifiability,
    identifiability_of, neighbour_axis_rules, reachable_poses, spectrum, structural_poses,
};
use identifiability::{complete_set_by_name, dependent_ends, select_independent};
pub use identify::{IdentifyError, identify, without_calibration};
pub use information::{Information, information_at};
pub use limits::{ParameterBound, ParameterBoundError, RefusedBound, check_bounds};
pub use linearisation::{
    Linearisation, PredictedReading, Whitening, linearise, predict_places, predict_readings,
};
pub use mode::Mode;
pub use noise::{MachineNoise, MachineNoiseChoice};
pub use options::{
    ComplianceChoice, DEFAULT_TOLERANCE, FrameChoice, IdentificationOptions, InstrumentChoice, LINKAGE,
    ParameterChoice, Redundancy, TargetChoice, TermPrior, Tolerance, UNKNOWN_STIFFNESS,
};
pub(crate) use planned::{PlannedRows, PlannedSystem};
pub use prospect::{Prospect, prospect};
pub use robot::{
    CalibratedRobot, EstimatePredictor, InstrumentErrors, PredictedOrientation, Prediction, PredictionError,
    Predictor,
};
pub(crate) use solver::scale_of;
use solver::{Bounds, LeastSquares, Solution, minimise, minimise_within};
pub use solver::{BoundsError, Loss, LossScale, SolverOptions};
pub use uncertainty::{
    ParameterSupport, PoseInfluence, PositionJacobian, Uncertainty, bayesian_cramer_rao_bound,
    cramer_rao_bound,
};
pub use weighed::weighed_covariances;
