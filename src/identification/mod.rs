//! From measurements to parameters: weighted nonlinear least squares with priors, and what the data can and cannot tell.
//!
//! Nothing here may see the plant, the tracker's inside or the truth (see `tests/it/layers.rs`).

mod estimate;
mod identifiability;
mod identify;
mod problem;
mod solver;
mod uncertainty;

pub use estimate::{
    CalibratedRobot, Estimate, IterationRecord, Mode, NoiseScale, ParameterEstimate, TerminationReason,
    Warning,
};
pub use identifiability::{
    DependentGroup, Explanation, Finding, IdentifiabilityReport, RANK_TOLERANCE, Remedy, Spectrum,
    WEAK_TOLERANCE, WeakDirection, analyse_columns, analyse_r, complete_set, explain, identifiability,
    neighbour_axis_rules, select_independent, structural_poses,
};
pub use identify::{
    FrameChoice, IdentificationOptions, IdentifyError, ParameterChoice, TargetChoice, Tolerance, identify,
    without_calibration,
};
pub use solver::{LeastSquares, SolverOptions};
pub use uncertainty::{
    ParameterSupport, PoseInfluence, PositionJacobian, Uncertainty, bayesian_cramer_rao_bound,
    cramer_rao_bound,
};
