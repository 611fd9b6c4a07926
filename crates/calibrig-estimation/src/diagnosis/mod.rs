//! Finds what would make a session fit that does not: broken conventions, tried one by one and in pairs.
//!
//! Every way in which a session could have been misread ([`Part`]), and every pair of them, is fitted to the points in closed
//! form (`place`). Those that fit approximately are weighed by how well a robot with realistic errors of its links explains the points
//! (`evidence`). Bad rows are looked for together with each single part (`rows`). Hypotheses that explain the same points equally well form a class.

mod convention;
mod evidence;
mod limits;
mod orientations;
mod part;
mod place;
mod rows;
mod search;
mod session;
#[cfg(test)]
mod tests;
mod tried;

pub use limits::Undetermined;
pub use orientations::{OrientationFinding, Orientations, orientations};
pub use part::Part;

use crate::identification::IdentifyError;
pub use crate::plausibility::FarOff;
use crate::plausibility::{BeyondLimits, LARGEST_SHARE, beyond_limits};
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::MeasurementSet;

/// Result of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnosis {
    /// Number of observations that were examined.
    pub observations: usize,
    /// RMS distance of the points from their mean, m.
    pub spread: f64,
    /// Hypotheses, the best first.
    pub hypotheses: Vec<Hypothesis>,
    /// What the session does not determine.
    pub undetermined: Vec<Undetermined>,
    /// Commands beyond the joints' limits, as they were read.
    pub beyond_limits: Vec<BeyondLimits>,
}

/// A way in which a session may be meant.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// Differences from how the session was read; empty if the session is sound.
    pub parts: Vec<Part>,
    /// RMS distance of the points from the nominal robot, with tracker and target fitted, m.
    pub rms: f64,
    /// RMS distance with links fitted that have realistic errors, m.
    pub rms_links: f64,
    /// Twice the negative logarithm of its likelihood, including its cost, less that of the first hypothesis.
    pub above_first: f64,
    /// Its share of the likelihood of all hypotheses that were tried.
    pub probability: f64,
    /// Class: hypotheses with the same number explain any points of this session equally well.
    pub class: usize,
}

/// Conclusion of a diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// The robot fits the points as they were read.
    Sound,
    /// Another reading explains the points better.
    Explained,
    /// The robot does not fit the points, and nothing that was tried explains why.
    Unexplained,
}

impl Hypothesis {
    /// Kinds of the parts, as keys.
    pub fn kinds(&self) -> Vec<&'static str> {
        if self.parts.is_empty() { vec!["sound"] } else { self.parts.iter().map(Part::kind).collect() }
    }
}

impl Diagnosis {
    /// Whether there are so few poses that the points only scatter, and say nothing of the robot.
    pub(crate) fn is_of_no_motion(&self) -> bool {
        self.undetermined
            .iter()
            .any(|what| matches!(what, Undetermined::FewPoses { distinct, .. } if *distinct < 3))
    }

    /// The conclusion.
    pub fn finding(&self) -> Finding {
        let Some(first) = self.hypotheses.first() else { return Finding::Sound };
        // For points in another unit, the spread is in that unit.
        let unit = |part: &Part| if let Part::PointUnit { factor } = part { *factor } else { 1.0 };
        let spread = self.spread * first.parts.iter().map(unit).product::<f64>();
        let is_off = first.rms > LARGEST_SHARE * spread && spread > 0.0 && !self.is_of_no_motion();
        match first.parts.as_slice() {
            // It is better, but still off by more than any robot's links.
            _ if is_off => Finding::Unexplained,
            [] => Finding::Sound,
            _ => Finding::Explained,
        }
    }
}

/// Looks for what would make the robot fit the points of `set`.
///
/// # Errors
///
/// [`IdentifyError`], where model and set do not belong together.
pub fn diagnose(model: &CalibrationModel, set: &MeasurementSet) -> Result<Diagnosis, IdentifyError> {
    diagnose_with(model, set, |_, _| {})
}

/// Like [`diagnose`]; `progress` is given the steps done and their total.
///
/// # Errors
///
/// As [`diagnose`].
pub fn diagnose_with(
    model: &CalibrationModel,
    set: &MeasurementSet,
    mut progress: impl FnMut(u64, u64),
) -> Result<Diagnosis, IdentifyError> {
    model.check()?;
    set.check(model.kinematics.joint_count())?;
    Ok(Diagnosis {
        observations: set.observations.len(),
        spread: set.spread(),
        hypotheses: search::hypotheses(model, set, &mut progress),
        undetermined: limits::undetermined(model, set),
        beyond_limits: beyond_limits(model, set),
    })
}
