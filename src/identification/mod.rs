//! From measurements to parameters: weighted nonlinear least squares with priors, and what the data can and cannot tell.
//!
//! Nothing here may see the plant, the tracker's inside or the truth (see `tests/it/layers.rs`).

mod estimate;
mod identifiability;
mod identify;
mod problem;
mod solver;

pub use estimate::{
    CalibratedRobot, Estimate, IterationRecord, Mode, NoiseScale, ParameterEstimate, TerminationReason,
    Warning,
};
pub use identifiability::{
    DependentGroup, IdentifiabilityReport, Spectrum, WeakDirection, analyse_columns, analyse_r, complete_set,
    neighbour_axis_rules, select_independent,
};
pub use identify::{
    FrameChoice, IdentificationOptions, IdentifyError, ParameterChoice, TargetChoice, identify,
    without_calibration,
};
pub use solver::{LeastSquares, SolverOptions};
