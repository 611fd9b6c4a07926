//! What the rounds of base nests say of the tracker's own motion.

use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use super::words::counted;
use crate::pipeline::Outcome;
use calibrig_model::measurement::{DriftVerdict, MissingForDrift, StationDrift};

/// A station whose nests were measured more than once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonDrift {
    /// Name of the station.
    pub station: String,
    /// Different nests.
    pub nests: usize,
    /// Most readings of one nest in one face.
    pub rounds: usize,
    /// `removed`, `none` or `unknown`.
    pub verdict: String,
    /// Probability that a tracker that stands still shows as much; null where that is not known.
    pub p_value: Option<f64>,
    /// Largest motion of the nests' centroid between two times, m; null where nothing was removed, as are those below.
    pub motion_m: Option<f64>,
    /// Largest turn between two times, rad.
    pub turn_rad: Option<f64>,
    /// RMS of what readings were moved by, m.
    pub correction_rms_m: Option<f64>,
    /// RMS of the correction's own standard deviation in 3-D, m.
    pub left_rms_m: Option<f64>,
    /// Readings before the first or behind the last round.
    pub outside: Option<usize>,
    /// Scatter of the nests' readings over the stated one.
    pub noise_ratio: Option<f64>,
    /// Readings of nests that contradict the other rounds.
    pub contradictions: Vec<JsonNestContradiction>,
}

/// A nest that in one round was not where it is in the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonNestContradiction {
    /// Its name.
    pub nest: String,
    /// When, s.
    pub time_s: f64,
    /// How far off, m.
    pub distance_m: f64,
}

pub(super) fn json_drift(outcome: &Outcome) -> Vec<JsonDrift> {
    let of = |drift: &StationDrift| {
        let removed = match &drift.verdict {
            DriftVerdict::Removed(size) => Some(size),
            _ => None,
        };
        let (verdict, p_value) = match &drift.verdict {
            DriftVerdict::Removed(size) => ("removed", Some(size.p_value)),
            DriftVerdict::None { p_value } => ("none", Some(*p_value)),
            DriftVerdict::Unknown { .. } => ("unknown", None),
        };
        JsonDrift {
            station: drift.station.clone(),
            nests: drift.nests,
            rounds: drift.rounds,
            verdict: verdict.to_owned(),
            p_value,
            motion_m: removed.map(|size| size.motion),
            turn_rad: removed.map(|size| size.turn),
            correction_rms_m: removed.map(|size| size.correction_rms),
            left_rms_m: removed.map(|size| size.left_rms),
            outside: removed.map(|size| size.outside),
            noise_ratio: drift.noise_ratio,
            contradictions: drift
                .contradictions
                .iter()
                .map(|found| JsonNestContradiction {
                    nest: found.nest.clone(),
                    time_s: found.time,
                    distance_m: found.distance,
                })
                .collect(),
        }
    };
    outcome.drift.iter().map(of).collect()
}

/// One line a finding, the verdict first.
pub(super) fn drift_words(drift: &StationDrift) -> Vec<String> {
    let um = |metres: f64| format!("{:.1} um", 1e6 * metres);
    let rounds = format!("{} of {}", counted(drift.rounds, "round"), counted(drift.nests, "nest"));
    let verdict = match &drift.verdict {
        DriftVerdict::Removed(size) => format!(
            "station {}: {rounds} show that the tracker moved by {} and turned by {:.1} urad; readings were corrected by {} RMS, with a standard deviation of {} (3-D)",
            drift.station,
            um(size.motion),
            1e6 * size.turn,
            um(size.correction_rms),
            um(size.left_rms),
        ),
        DriftVerdict::None { p_value } => format!(
            "station {}: {rounds} show no motion of the tracker (p = {p_value:.2}); nothing was corrected",
            drift.station
        ),
        DriftVerdict::Unknown { missing } => {
            let missing = match missing {
                MissingForDrift::Times => "not all nests say when they were measured",
                MissingForDrift::Readings => "too few nests were measured again",
            };
            format!(
                "station {}: {rounds}; whether the tracker moved is not known, because {missing}; nothing was corrected",
                drift.station
            )
        }
    };
    let mut lines = vec![verdict];
    if let DriftVerdict::Removed(size) = &drift.verdict
        && size.outside > 0
    {
        lines.push(format!(
            "{} before the first or after the last round of nests; next time measure nests before and after all poses",
            counted(size.outside, "reading")
        ));
    }
    if let Some(ratio) = drift.noise_ratio.filter(|ratio| *ratio > 1.5) {
        lines.push(format!(
            "nests scatter {ratio:.1} times as much as their readings state: look at how they are seated, or state more"
        ));
    }
    for found in &drift.contradictions {
        lines.push(format!(
            "nest {} at {:.0} s is {} from where it is in the other rounds; that reading was left out",
            found.nest,
            found.time,
            um(found.distance)
        ));
    }
    lines
}

/// A section of the page; nothing where no nest was measured twice.
pub(super) fn drift_section(outcome: &Outcome) -> Markup {
    html! {
        @if !outcome.drift.is_empty() {
            h3 { "The tracker's own motion" }
            ul { @for drift in &outcome.drift { @for line in drift_words(drift) { li { (line) } } } }
        }
    }
}

/// How many readings of measured poses did not come, a line a set and reason of the first.
pub(super) fn missing_words(outcome: &Outcome) -> Vec<String> {
    let of_set = |(set, missing): (&crate::pipeline::SetOutcome, &Vec<crate::pipeline::MissingReading>)| {
        let first = missing.first()?;
        Some(format!(
            "{} of measured {} poses did not come, the first of pose {}: {}",
            counted(missing.len(), "reading"),
            set.kind.key(),
            first.pose,
            first.why
        ))
    };
    outcome.sets.iter().zip(&outcome.missing).filter_map(of_set).collect()
}
