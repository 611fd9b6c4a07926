//! What would make a session fit that does not: conventions that are broken, tried one by one and in pairs.
//!
//! Every way in which a session could be meant other than it was read ([`Part`]) and every pair of them is laid over the points in closed
//! form (`place`); those that come near are weighed by how well a robot whose links are off as real ones are explains the points
//! (`evidence`). Rows to blame are looked for beside each single one (`rows`). What explains the same points just as well is of one class.

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

/// What was found of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnosis {
    /// Observations that were looked at.
    pub observations: usize,
    /// RMS distance of the points from their mean, m.
    pub spread: f64,
    /// Best first.
    pub hypotheses: Vec<Hypothesis>,
    /// What the session does not tell.
    pub undetermined: Vec<Undetermined>,
    /// Commands beyond the joints' limits, as they were read.
    pub beyond_limits: Vec<BeyondLimits>,
}

/// A way in which a session can be meant.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// What is otherwise than it was read; nothing where the session is sound.
    pub parts: Vec<Part>,
    /// RMS distance of the points from the nominal robot, with tracker and target fitted, m.
    pub rms: f64,
    /// The same with links fitted that are off as those of real robots are, m.
    pub rms_links: f64,
    /// Twice the negative logarithm of its likelihood, with what it costs, less that of the first.
    pub above_first: f64,
    /// Its share of the likelihood of all that were tried.
    pub probability: f64,
    /// Hypotheses of one number explain any points of this session equally well.
    pub class: usize,
}

/// How a diagnosis ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// The robot lies on the points as they were read.
    Sound,
    /// Something explains them better.
    Explained,
    /// It does not lie on them, and nothing that was tried explains why.
    Unexplained,
}

impl Hypothesis {
    /// Kinds of its parts, as keys.
    pub fn kinds(&self) -> Vec<&'static str> {
        if self.parts.is_empty() { vec!["sound"] } else { self.parts.iter().map(Part::kind).collect() }
    }
}

impl Diagnosis {
    /// Whether the poses are so few that points scatter, and say nothing of the robot.
    pub(crate) fn is_of_no_motion(&self) -> bool {
        self.undetermined
            .iter()
            .any(|what| matches!(what, Undetermined::FewPoses { distinct, .. } if *distinct < 3))
    }

    /// What was found.
    pub fn finding(&self) -> Finding {
        let Some(first) = self.hypotheses.first() else { return Finding::Sound };
        // Of points in another unit, the spread is in that one.
        let unit = |part: &Part| if let Part::PointUnit { factor } = part { *factor } else { 1.0 };
        let spread = self.spread * first.parts.iter().map(unit).product::<f64>();
        let is_off = first.rms > LARGEST_SHARE * spread && spread > 0.0 && !self.is_of_no_motion();
        match first.parts.as_slice() {
            // Better, and still what no robot's links are off by.
            _ if is_off => Finding::Unexplained,
            [] => Finding::Sound,
            _ => Finding::Explained,
        }
    }
}

/// Looks for what would make the robot lie on the points of `set`.
///
/// # Errors
///
/// [`IdentifyError`], where model and set do not belong together.
pub fn diagnose(model: &CalibrationModel, set: &MeasurementSet) -> Result<Diagnosis, IdentifyError> {
    diagnose_with(model, set, |_, _| {})
}

/// The same; `progress` is told how much of how much is done.
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
