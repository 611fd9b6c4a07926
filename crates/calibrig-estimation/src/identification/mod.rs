//! From measurements to parameters: weighted nonlinear least squares with priors, and what the data can and cannot tell.
//!
//! Nothing here can see the plant, the tracker's inside or the truth: this crate does not depend on theirs.

mod build;
mod contradiction;
mod estimate;
mod factor;
mod identifiability;
mod identify;
mod limits;
mod linearisation;
mod machine;
mod mode;
mod options;
mod parameters;
mod problem;
mod prospect;
mod robot;
mod solver;
mod summary;
#[cfg(test)]
mod tests;
mod uncertainty;

pub use contradiction::{CONTRADICTION_LEVEL, Contradiction, Stated};
pub use estimate::{
    Estimate, IterationRecord, NoiseScale, Outlier, ParameterEstimate, TerminationReason, Warning,
};
pub use identifiability::{
    DependentGroup, Explanation, Finding, IdentifiabilityReport, RANK_TOLERANCE, Remedy, Spectrum,
    WEAK_TOLERANCE, WeakDirection, analyse_columns, analyse_r, complete_set, explain, identifiability,
    neighbour_axis_rules, select_independent, structural_poses,
};
pub use identify::{IdentifyError, identify, without_calibration};
pub use limits::{ParameterBound, ParameterBoundError, RefusedBound, check_bounds};
pub use linearisation::{Linearisation, Prediction, linearise, predict};
pub use machine::MachineError;
pub use mode::Mode;
pub use options::{
    ComplianceChoice, FrameChoice, IdentificationOptions, LINKAGE, ParameterChoice, Redundancy, TargetChoice,
    TermPrior, Tolerance,
};
pub use prospect::{Prospect, prospect};
pub use robot::{CalibratedRobot, PredictionError, Predictor};
pub use solver::{
    AtBound, Bounds, BoundsError, LeastSquares, Loss, LossScale, Side, Solution, SolverOptions, minimise,
    minimise_within,
};
pub use uncertainty::{
    ParameterSupport, PoseInfluence, PositionJacobian, Uncertainty, bayesian_cramer_rao_bound,
    cramer_rao_bound,
};
