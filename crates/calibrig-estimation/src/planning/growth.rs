//! Shows how many poses are enough.

use serde::{Deserialize, Serialize};

use super::exchange::Search;
use super::{Accuracy, Choice, DesignSpace, PlanError, Spread};

/// Best known designs for increasing numbers of poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Designs in the order of their numbers of poses.
    pub points: Vec<GrowthPoint>,
    /// Limit for any number of poses of these candidates.
    pub floor: Accuracy,
    /// Number of poses beyond which more help less than before: where the mean standard deviation (with the machine's noise) lies furthest below the
    /// straight line from the first to the last point, with numbers and standard deviations each divided by their range (V. Satopää et al., "Finding
    /// a Kneedle in a haystack", ICDCS Workshops 2011, 166). It depends on the range that was examined. `None` for fewer than three points, or if
    /// none lies below.
    pub knee: Option<usize>,
}

/// The best known design for one number of poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GrowthPoint {
    /// Number of poses.
    pub count: usize,
    /// Indices of the candidates, ascending.
    pub chosen: Vec<usize>,
    /// Value of the criterion by which it was chosen.
    pub value: f64,
    /// Accuracy of its predictions.
    pub accuracy: Accuracy,
}

/// Number of poses needed to reach a tolerance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Needed {
    /// This number, the smallest of those that were examined.
    Poses {
        /// Number of poses.
        count: usize,
        /// Value that they reach, m.
        reached: f64,
    },
    /// No number: the machine's noise beside its model alone is larger.
    BelowMachine {
        /// Value of the machine's noise alone, m.
        floor: f64,
    },
    /// No number of these candidates: combinations of parameters rest on their priors, and these with the machine's noise exceed the tolerance.
    BelowCandidates {
        /// Value with any number of poses, m.
        floor: f64,
    },
    /// More than the largest number that was examined.
    MoreThan {
        /// Largest number that was examined.
        count: usize,
        /// Value that it reaches, m.
        reached: f64,
    },
}

/// Designs for the numbers of poses in `counts`. Each begins with the one before it, adds further poses one by one, and is improved by exchanges, so
/// that none is worse than the one before. The count and the random starts of `choice` are not used.
///
/// # Errors
///
/// [`PlanError`], as [`choose`](super::choose) for the smallest number, and without a region.
pub fn grow(spaces: &[DesignSpace], choice: &Choice, counts: &[usize]) -> Result<Growth, PlanError> {
    let mut counts = counts.to_vec();
    counts.sort_unstable();
    counts.dedup();
    let least = *counts.first().ok_or(PlanError::NoPoses)?;
    let most = *counts.last().ok_or(PlanError::NoPoses)?;
    let no_region = || PlanError::NoRegion { criterion: choice.criterion };
    let nominal = spaces.first().ok_or(PlanError::NoCandidates)?;
    if !choice.repeats && most > nominal.candidates() {
        return Err(PlanError::TooFewCandidates { candidates: nominal.candidates(), wanted: most });
    }
    let mut search = Search::new(spaces, &Choice { count: least, ..*choice })?;
    let mut design = Vec::new();
    let mut points = Vec::new();
    for count in counts {
        let grown = search.grown(design, count);
        design = search.improved(grown).0;
        let mut chosen = design.clone();
        chosen.sort_unstable();
        let accuracy = nominal.figures(&chosen)?.accuracy.ok_or_else(no_region)?;
        points.push(GrowthPoint { count, value: search.value(&chosen)?, chosen, accuracy });
    }
    let floor = nominal.floor()?.ok_or_else(no_region)?;
    let curve: Vec<_> = points.iter().map(|point| (point.count, point.accuracy.with_machine.mean)).collect();
    Ok(Growth { points, floor, knee: knee(&curve) })
}

fn knee(curve: &[(usize, f64)]) -> Option<usize> {
    let (first, last) = (curve.first()?, curve.last()?);
    let (width, height) = (last.0 as f64 - first.0 as f64, first.1 - last.1);
    if !(width > 0.0 && height > 0.0) {
        return None;
    }
    let below = |(count, sigma): &(usize, f64)| {
        let x = (*count as f64 - first.0 as f64) / width;
        (1.0 - x) - (sigma - last.1) / height
    };
    let furthest = curve.iter().max_by(|a, b| below(a).total_cmp(&below(b)))?;
    (below(furthest) > 1e-9).then_some(furthest.0)
}

impl Growth {
    /// Number of poses that predict within `tolerance`, m, by a figure of the standard deviations with the machine's noise, such as their mean or 95
    /// % quantile over the region.
    ///
    /// # Errors
    ///
    /// [`PlanError::Number`], for a tolerance that is not finite and above zero.
    pub fn needed(&self, tolerance: f64, figure: impl Fn(&Spread) -> f64) -> Result<Needed, PlanError> {
        if !(tolerance > 0.0 && tolerance.is_finite()) {
            let field = "the tolerance of predicted places";
            return Err(PlanError::Number {
                field,
                value: tolerance,
                expected: "a finite length above zero, m",
            });
        }
        let of_machine = figure(&self.floor.of_machine);
        if of_machine > tolerance {
            return Ok(Needed::BelowMachine { floor: of_machine });
        }
        let reached = |point: &GrowthPoint| figure(&point.accuracy.with_machine);
        if let Some(point) = self.points.iter().find(|point| reached(point) <= tolerance) {
            return Ok(Needed::Poses { count: point.count, reached: reached(point) });
        }
        let floor = figure(&self.floor.with_machine);
        if floor > tolerance {
            return Ok(Needed::BelowCandidates { floor });
        }
        let last = self.points.last().ok_or(PlanError::NoPoses)?;
        Ok(Needed::MoreThan { count: last.count, reached: reached(last) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_knee_of_a_hyperbola_is_where_its_slope_is_that_of_the_chord() {
        // For 1/n from 1 to 100, the tangent is parallel to the chord at sqrt(100).
        let curve: Vec<_> = (1..=100).map(|n| (n, 1.0 / n as f64)).collect();
        assert_eq!(knee(&curve), Some(10));
        let line: Vec<_> = (1..=10_usize).map(|n| (n, 20.0 - n as f64)).collect();
        assert_eq!(knee(&line), None);
        assert_eq!(knee(&curve[..2]), None);
        assert_eq!(knee(&[]), None);
    }
}
