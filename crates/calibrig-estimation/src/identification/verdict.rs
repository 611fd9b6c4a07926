//! What a person must look at before an estimate is used: one list of reasons, shared by the exit code, the reports and campaigns (ADR 0015).

use super::{Estimate, Outlier, Warning};

impl Warning {
    /// The key of the reason for which a person must look at the result; `None` for a warning that is information only.
    ///
    /// It is a reason if the stated intervals do not hold, or what was asked for was not done. A misfit that the intervals account for, a weak
    /// direction, a prior that a parameter rests on, or a drive without visible compliance is not a reason.
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
            // An observation without weight does not move the fit.
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
    /// What a person must look at before the estimate is used; empty where its intervals hold as far as the data can show.
    pub fn reasons(&self) -> impl Iterator<Item = &Warning> {
        self.warnings.iter().filter(|warning| warning.reason().is_some())
    }

    /// Whether the estimate may be used without a second look: it has no [reasons](Self::reasons) for one.
    pub fn is_sound(&self) -> bool {
        self.reasons().next().is_none()
    }
}
