//! What a person must look at before an estimate is used: one list of reasons, for the exit code, the reports and campaigns alike (ADR 0015).

use super::{Estimate, Outlier, Warning};

impl Warning {
    /// The key of the reason that it is to look at the result; `None` for what is only to be known of it.
    ///
    /// The stated intervals do not hold, or what was asked for was not done: that is a reason. A misfit that the intervals account for, a
    /// weak direction, a prior that a parameter rests on, or a drive without visible compliance is not a reason.
    pub fn reason(&self) -> Option<&'static str> {
        match self {
            Self::NotConverged(_) => Some("not_converged"),
            Self::RankDeficient { .. } => Some("rank_deficient"),
            Self::AtBound { .. } => Some("at_bound"),
            Self::Contradicted(_) => Some("contradicted"),
            Self::OffThePoints { .. } => Some("off_the_points"),
            Self::OrientationsOff { .. } => Some("orientations_off"),
            Self::SeveralTargets { .. } => Some("several_targets"),
            Self::StationMoved { .. } => Some("station_moved"),
            // What carries no weight in the fit does not move it.
            Self::Outliers(outliers) => Outlier::are_a_reason(outliers).then_some("gross_errors"),
            Self::Weak { .. }
            | Self::HeldByPrior { .. }
            | Self::Fixed { .. }
            | Self::Unexcited { .. }
            | Self::IdlePayloads { .. }
            | Self::UnusedBound { .. }
            | Self::Moved(_)
            | Self::Overstated { .. }
            | Self::Understated { .. }
            | Self::NoFreedom { .. }
            | Self::Untested { .. }
            | Self::Rigid { .. }
            | Self::SeveralMinima { .. }
            | Self::Inconsistent { .. } => None,
        }
    }
}

impl Estimate {
    /// What a person must look at before it is used; none where its intervals hold as far as the data can tell.
    pub fn reasons(&self) -> impl Iterator<Item = &Warning> {
        self.warnings.iter().filter(|warning| warning.reason().is_some())
    }

    /// Whether it may be used without a second look: there is no [reason](Self::reasons) for one.
    pub fn is_sound(&self) -> bool {
        self.reasons().next().is_none()
    }
}
