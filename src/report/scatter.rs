//! What is stated of the readings' scatter against what repeats and residuals show, and what the instrument has to do with the residuals.

use std::collections::BTreeMap;

use maud::{Markup, html};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::document::{axes, finite};
use super::words::{counted, percent, set_title, significant};
use crate::pipeline::{Judgement, Outcome, SetKind};
use calibrig_estimation::evaluation::{RepeatScatter, ScatterComparison};

/// Below this part of the residuals' variance the instrument is no reason for them, m²/m².
const LITTLE: f64 = 0.1;
/// From this part on there is little else.
const NEARLY_ALL: f64 = 0.8;
/// Beyond this the noise is stated larger than the residuals can hold.
const TOO_LARGE: f64 = 1.25;

/// Scatter of a set's readings: along the beam, and across it along growing azimuth and elevation, as lengths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonScatter {
    /// Readings.
    pub readings: usize,
    /// RMS of the standard deviations that they state; null where one states none.
    pub stated_m: Option<[Option<f64>; 3]>,
    /// RMS of what the stated errors of the instrument, which its readings share, can displace them by; absent where none are stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared_m: Option<[Option<f64>; 3]>,
    /// What repeats show; absent where no pose is measured more than once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<JsonRepeatScatter>,
    /// RMS of the residuals.
    pub residuals_m: [Option<f64>; 3],
    /// Part of the residuals' sum of squares that the stated noise is expected to leave; null where none is stated.
    pub noise_share: Option<f64>,
    /// The same of the shared errors, at most; absent where none are stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared_share_at_most: Option<f64>,
}

/// Scatter of readings of the same pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonRepeatScatter {
    /// Poses with more than one reading.
    pub poses: usize,
    /// Readings of them beyond the first.
    pub repeats: usize,
    /// Standard deviations, the machine's own scatter included.
    pub sigma_m: [Option<f64>; 3],
    /// Chi-square per degree of freedom in the stated noise; null where none is stated.
    pub chi2_per_dof: Option<f64>,
    /// Where that lies in 99.9 % if the readings scatter as stated and the machine not at all.
    pub band: [Option<f64>; 2],
}

fn json_scatter(scatter: &ScatterComparison) -> JsonScatter {
    JsonScatter {
        readings: scatter.readings,
        stated_m: scatter.stated.map(axes),
        shared_m: scatter.shared.map(axes),
        repeats: scatter.repeats.map(|repeats| JsonRepeatScatter {
            poses: repeats.poses,
            repeats: repeats.repeats,
            sigma_m: axes(repeats.sigma),
            chi2_per_dof: repeats.test.and_then(|test| finite(test.chi2 / test.dof)),
            band: [finite(repeats.band.0), finite(repeats.band.1)],
        }),
        residuals_m: axes(scatter.residuals),
        noise_share: scatter.noise_share.and_then(finite),
        shared_share_at_most: scatter.shared_share.and_then(finite),
    }
}

/// Those of an estimate, by the key of the set.
pub(super) fn json_scatters(outcome: &Outcome, judgement: &Judgement) -> BTreeMap<String, JsonScatter> {
    let sets = outcome.sets.iter().zip(&judgement.scatter);
    sets.filter_map(|(set, scatter)| Some((set.kind.key().to_owned(), json_scatter(scatter.as_ref()?))))
        .collect()
}

/// Three lengths in µm.
fn micrometres(lengths: Vector3<f64>) -> String {
    let [a, b, c] = [lengths.x, lengths.y, lengths.z].map(|metres| significant(1e6 * metres));
    format!("{a}, {b}, {c} \u{b5}m")
}

fn repeats_words(repeats: &RepeatScatter) -> String {
    let sigma = micrometres(repeats.sigma);
    let Some(test) = repeats.test else { return format!("repeats {sigma}") };
    let judged = match repeats.differs() {
        Some(true) => "more than stated: the machine's own scatter, or a tracker worse than stated",
        Some(false) => "less than stated",
        None => "as stated",
    };
    let (low, high) = repeats.band;
    format!(
        "repeats {sigma} ({judged}; chi2/dof {}, as stated from {} to {})",
        significant(test.chi2 / test.dof),
        significant(low),
        significant(high)
    )
}

/// What the instrument has to do with the residuals, in a sentence; `None` where nothing is stated of it.
fn sentence(scatter: &ScatterComparison) -> Option<String> {
    let share = scatter.noise_share?;
    let part = format!("the readings' stated noise makes {} of the residuals' variance", percent(share));
    let noise = if share > TOO_LARGE {
        format!(
            "the readings' stated noise is larger than the residuals by a factor of {}: it is stated too large",
            significant(share.sqrt())
        )
    } else if share >= NEARLY_ALL {
        format!("{part}: only a better tracker or more readings would help")
    } else if share >= LITTLE {
        format!("{part}: a better tracker would help in part")
    } else {
        format!("{part}: a better tracker would not help")
    };
    Some(match scatter.shared_share {
        Some(shared) => {
            format!("{noise}; errors that readings of the instrument share make {} at most", percent(shared))
        }
        None => noise,
    })
}

/// Two lines on the set that was fitted.
pub(super) fn scatter_words(outcome: &Outcome, judgement: &Judgement) -> Vec<String> {
    let fitted =
        outcome.sets.iter().zip(&judgement.scatter).find(|(set, _)| set.kind == SetKind::Identification);
    let Some((_, Some(scatter))) = fitted else { return Vec::new() };
    let stated = scatter.stated.map_or_else(|| "nothing".to_owned(), micrometres);
    let repeats =
        scatter.repeats.map_or_else(String::new, |repeats| format!(", {}", repeats_words(&repeats)));
    let seen = format!(
        "scatter in range, azimuth, elevation: stated {stated}{repeats}, residuals {}",
        micrometres(scatter.residuals)
    );
    std::iter::once(seen).chain(sentence(scatter)).collect()
}

pub(super) fn has_scatter(outcome: &Outcome) -> bool {
    outcome.judgements.iter().flat_map(|judgement| &judgement.scatter).any(Option::is_some)
}

/// The section on stated and seen scatter; empty without a judgement.
pub(super) fn scatter_section(outcome: &Outcome) -> Markup {
    if !has_scatter(outcome) {
        return html! {};
    }
    html! {
        section #scatter {
            h2 { "Stated and seen scatter" }
            p {
                "Three RMS lengths at the target, in \u{b5}m: along the beam (range), and across it in azimuth and in elevation. The table compares the noise that readings state, the scatter that repeats of a "
                "pose show, and the residuals of each model. Repeats above the stated noise mean that the machine scatters or that the tracker is worse than stated. Residuals above the repeats mean that the model lacks something."
            }
            @for (index, set) in outcome.sets.iter().enumerate() {
                @let of_set = |judgement: &Judgement| judgement.scatter.get(index).copied().flatten();
                @if let Some(first) = outcome.judgements.iter().find_map(of_set) {
                    h3 { (set_title(set.kind)) ", " (counted(first.readings, "reading")) }
                    div.scroll { table {
                        thead { tr {
                            th {} th { "range" } th { "azimuth" } th { "elevation" } th { "noise's part of" br; "the variance" }
                            @if first.shared.is_some() { th { "shared errors'" br; "part, at most" } }
                        } }
                        tbody {
                            @if let Some(stated) = first.stated { (lengths("stated noise of a reading", stated, &first)) }
                            @if let Some(shared) = first.shared { (lengths("stated errors that readings share", shared, &first)) }
                            @if let Some(repeats) = first.repeats {
                                (lengths(&format!("repeats of {}", counted(repeats.poses, "pose")), repeats.sigma, &first))
                            }
                            @for judgement in &outcome.judgements {
                                @if let Some(scatter) = of_set(judgement) {
                                    tr {
                                        th scope="row" { "residuals, " (judgement.mode.title()) }
                                        (cells(scatter.residuals))
                                        td { @if let Some(share) = scatter.noise_share { (percent(share)) } @else { "\u{2013}" } }
                                        @if first.shared.is_some() {
                                            td { @if let Some(share) = scatter.shared_share { (percent(share)) } @else { "\u{2013}" } }
                                        }
                                    }
                                }
                            }
                        }
                    } }
                    @if let Some(repeats) = first.repeats { p.note { "Scatter of " (repeats_words(&repeats)) "." } }
                    @if let Some(words) = outcome.judgements.iter().rev().find_map(of_set).and_then(|scatter| sentence(&scatter)) {
                        p { @if let Some(last) = outcome.judgements.last() { "\u{201c}" (last.mode.title()) "\u{201d}: " } (words) "." }
                    }
                    @if first.stated.is_none() { p.note { "The readings state no noise to compare with. State it, and this table says whether tracker or model limits the accuracy." } }
                }
            }
        }
    }
}

fn cells(lengths: Vector3<f64>) -> Markup {
    html! { @for length in lengths.iter() { td { (significant(1e6 * length)) } } }
}

fn lengths(title: &str, lengths: Vector3<f64>, of: &ScatterComparison) -> Markup {
    html! {
        tr { th scope="row" { (title) } (cells(lengths)) td {} @if of.shared.is_some() { td {} } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_estimation::evaluation::ChiSquareTest;

    fn scatter(noise_share: Option<f64>, shared_share: Option<f64>) -> ScatterComparison {
        ScatterComparison {
            readings: 60,
            stated: noise_share.map(|_| Vector3::new(2e-6, 5e-6, 5e-6)),
            shared: shared_share.map(|_| Vector3::repeat(1e-5)),
            repeats: None,
            residuals: Vector3::repeat(1e-4),
            noise_share,
            shared_share,
        }
    }

    #[test]
    fn the_sentence_says_whether_a_better_tracker_would_help() {
        let words = |share| sentence(&scatter(Some(share), None)).expect("stated");
        assert_eq!(
            words(0.042),
            "the readings' stated noise makes 4.2 % of the residuals' variance: a better tracker would not help"
        );
        assert!(
            words(0.4)
                .ends_with("makes 40 % of the residuals' variance: a better tracker would help in part")
        );
        assert!(
            words(0.99).contains("99 %")
                && words(0.99).ends_with("only a better tracker or more readings would help")
        );
        assert!(
            words(4.0).ends_with("larger than the residuals by a factor of 2.00: it is stated too large")
        );
        assert!(words(1e-5).contains("less than 0.1 %"));
        assert_eq!(sentence(&scatter(None, None)), None);
        let shared = sentence(&scatter(Some(0.04), Some(0.3))).expect("stated");
        assert!(
            shared.ends_with("errors that readings of the instrument share make 30 % at most"),
            "{shared}"
        );
    }

    #[test]
    fn repeats_are_told_with_their_band() {
        let told = |per_dof: f64| {
            let test = ChiSquareTest::new(60.0 * per_dof, 60.0);
            let repeats = RepeatScatter {
                poses: 2,
                repeats: 20,
                sigma: Vector3::new(1e-5, 2e-5, 3e-5),
                test,
                band: (0.5, 1.8),
            };
            repeats_words(&repeats)
        };
        assert!(told(1.0).starts_with(
            "repeats 10.0, 20.0, 30.0 \u{b5}m (as stated; chi2/dof 1.00, as stated from 0.500 to 1.80"
        ));
        assert!(
            told(2.0).contains("more than stated: the machine's own scatter")
                && told(0.3).contains("less than stated")
        );
    }
}
