//! Rank, dependent groups and weak directions: what measurements of a target can and cannot determine of a chain.
//!
//! There are two ways to the same answer: [`neighbour_axis_rules`] reads it from the robot's table, [`complete_set`] finds it from the rank of
//! the Jacobian.

mod complete;
mod explain;
mod rank;
mod rules;
#[cfg(test)]
mod tests;

pub use complete::{
    complete_set, complete_set_of, identifiability, identifiability_of, reachable_poses, spectrum,
    structural_poses,
};
pub(super) use complete::{complete_set_by_name, dependent_ends};
pub use explain::{Explanation, Finding, Remedy, explain};
#[cfg(test)]
use rank::analyse_columns;
pub(crate) use rank::analyse_r;
pub(super) use rank::select_independent;
pub use rank::{RANK_TOLERANCE, WEAK_TOLERANCE};
pub use rules::neighbour_axis_rules;
use serde::{Deserialize, Serialize};

use std::fmt;

use calibrig_model::ParameterId;

/// Singular values of the column-scaled system and what they mean. Every column is first divided by its norm, so that metres and radians are
/// comparable.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Spectrum {
    /// Numerical rank: singular values above [`RANK_TOLERANCE`] of the largest.
    pub rank: usize,
    /// Largest over smallest scaled singular value (infinite where the rank is deficient).
    #[serde(with = "calibrig_model::float::scalar")]
    pub condition: f64,
    /// Scaled singular values, largest first; NaN where the system contains a number that is not finite.
    #[serde(with = "calibrig_model::float::list")]
    pub singular_values: Vec<f64>,
    /// Directions that the data determine poorly, the best first.
    pub weak: Vec<WeakDirection>,
    /// Groups of parameters of which only combinations are determined.
    pub dependent: Vec<DependentGroup>,
}

/// A combination of parameters with a small singular value: below [`WEAK_TOLERANCE`] of the largest, above [`RANK_TOLERANCE`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeakDirection {
    /// Scaled singular value over the largest.
    pub singular_value: f64,
    /// The leading members and their weights in the right singular vector of the scaled system, largest first, the first positive.
    pub members: Vec<(ParameterId, f64)>,
}

/// Parameters whose effects on the measurements are linearly dependent: `redundant` has the effect of a combination of `with`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DependentGroup {
    /// The parameter that adds nothing to the others.
    pub redundant: ParameterId,
    /// The parameters that can replace it, with the coefficients (SI) of the combination; empty where it has no effect at all.
    pub with: Vec<(ParameterId, f64)>,
    /// Remaining effect of the combination: norm of the scaled system times its unit vector; zero for groups from the rules.
    pub singular_value: f64,
}

/// The parameters of a chain that can be identified.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IdentifiabilityReport {
    /// Candidates of the analysis, the preferred ones first.
    pub candidates: Vec<ParameterId>,
    /// A complete independent set: link parameters in table order, then frame, then target.
    pub selected: Vec<ParameterId>,
    /// Spectrum of the selected set. Its dependent groups are caused by the poses or the target, not by the structure.
    pub spectrum: Spectrum,
    /// Candidates that were left out, with what they depend on in every pose and for every target.
    pub dependent: Vec<DependentGroup>,
}

impl IdentifiabilityReport {
    /// The selected parameters without those that the poses or the target leave undetermined.
    pub fn determined(&self) -> Vec<ParameterId> {
        let lost = |id: &ParameterId| self.spectrum.dependent.iter().any(|group| group.redundant == *id);
        self.selected.iter().copied().filter(|id| !lost(id)).collect()
    }
}

impl fmt::Display for DependentGroup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.redundant)?;
        if self.with.is_empty() {
            return f.write_str(" without effect");
        }
        for (place, (id, _)) in self.with.iter().enumerate() {
            write!(f, "{}{id}", if place == 0 { " with " } else { ", " })?;
        }
        Ok(())
    }
}

impl fmt::Display for WeakDirection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (id, weight)) in self.members.iter().enumerate() {
            let sign = match (place, *weight < 0.0) {
                (0, false) => "",
                (0, true) => "-",
                (_, false) => " + ",
                (_, true) => " - ",
            };
            write!(f, "{sign}{:.2} {id}", weight.abs())?;
        }
        Ok(())
    }
}
