//! Rank, dependent groups and weak directions.

use nalgebra::DMatrix;

use crate::model::{KinematicModel, ParameterId};

/// Singular values of the column-scaled system and what they mean.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Spectrum {
    /// Numerical rank.
    pub rank: usize,
    /// Largest over smallest scaled singular value (infinite where the rank is deficient).
    pub condition: f64,
    /// Scaled singular values, largest first.
    pub singular_values: Vec<f64>,
    /// Directions that the data determine, but poorly.
    pub weak: Vec<WeakDirection>,
    /// Groups of which only combinations are determined.
    pub dependent: Vec<DependentGroup>,
}

/// A combination of parameters with a small singular value.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakDirection {
    /// Scaled singular value over the largest.
    pub singular_value: f64,
    /// The leading members and their scaled weights, largest first.
    pub members: Vec<(ParameterId, f64)>,
}

/// Parameters whose effects on the measurements are linearly dependent: `redundant` does what a combination of `with` does.
#[derive(Debug, Clone, PartialEq)]
pub struct DependentGroup {
    /// The parameter that adds nothing to the others.
    pub redundant: ParameterId,
    /// The ones that can stand in for it, with the coefficients (SI) of the combination.
    pub with: Vec<(ParameterId, f64)>,
}

/// What the published rules on neighbouring axes say of a chain.
#[derive(Debug, Clone, PartialEq)]
pub struct IdentifiabilityReport {
    /// Candidates that the analysis started from.
    pub candidates: Vec<ParameterId>,
    /// A complete independent set.
    pub selected: Vec<ParameterId>,
    /// Spectrum of the selected set.
    pub spectrum: Spectrum,
    /// The candidates that were left out, with what they depend on.
    pub dependent: Vec<DependentGroup>,
}

/// Spectrum of the columns of `jacobian` (rows already weighted, priors included), one a parameter.
pub fn analyse_columns(jacobian: &DMatrix<f64>, parameters: &[ParameterId]) -> Spectrum {
    let _ = (jacobian, parameters);
    unimplemented!()
}

/// The largest set of independent columns that prefers earlier parameters, and what each left-out column depends on.
pub fn select_independent(
    jacobian: &DMatrix<f64>,
    parameters: &[ParameterId],
) -> (Vec<usize>, Vec<DependentGroup>) {
    let _ = (jacobian, parameters);
    unimplemented!()
}

/// The published neighbour-axis rules: the parameters kept, and the eliminated groups.
pub fn neighbour_axis_rules(model: &KinematicModel) -> (Vec<ParameterId>, Vec<DependentGroup>) {
    let _ = model;
    unimplemented!()
}

/// R.
pub fn analyse_r(r: &DMatrix<f64>, parameters: &[ParameterId]) -> Spectrum {
    analyse_columns(r, parameters)
}

/// Complete.
pub fn complete_set(model: &KinematicModel, frame_free: bool, target_free: bool) -> IdentifiabilityReport {
    let _ = (model, frame_free, target_free);
    unimplemented!()
}

impl std::fmt::Display for DependentGroup {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.redundant)
    }
}

impl std::fmt::Display for WeakDirection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.singular_value)
    }
}
