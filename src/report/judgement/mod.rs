//! How far the estimates can be trusted: what the residuals still contain, and how sure the numbers are.

mod figures;
mod json;

pub use json::{
    JsonConfidence, JsonCorrelation, JsonInfluence, JsonJudgement, JsonOutlier, JsonPattern, JsonPoint,
    JsonRegion, JsonSupport,
};

pub(super) use json::json_judgement;

use maud::{Markup, PreEscaped, html};

use self::figures::{MARKED, map_figure, pattern_figure};
use crate::pipeline::{Confidence, Judgement, Outcome, PredictedPosition, SetKind};
use crate::report::files::ReportError;
use crate::report::plots::thinned_words;
use crate::report::scatter::scatter_words;
use crate::report::terminal::{Ink, Style};
use crate::report::words::{
    capital, counted, length_words, number, parameter_words, printable, printed_unit, significant,
};
use calibrig_estimation::evaluation::{Cause, ResidualPattern};
use calibrig_estimation::identification::{Mode, Outlier};
use calibrig_model::ParameterId;

/// Patterns that are named on the terminal, and those that are drawn, a mode.
const NAMED: usize = 3;
const DRAWN: usize = 2;
/// Rows of the tables of weakest, strongest and most.
const LISTED: usize = 8;

fn patterns(judgement: &Judgement) -> &[ResidualPattern] {
    judgement.consistency.shape.as_ref().map_or(&[], |shape| &shape.patterns)
}

/// Median, 95 % quantile and largest of the 3-D standard deviations, m.
fn quantiles(map: &[PredictedPosition]) -> Option<[f64; 3]> {
    let mut lengths: Vec<_> = map.iter().map(PredictedPosition::length).collect();
    lengths.sort_by(f64::total_cmp);
    let last = lengths.len().checked_sub(1)?;
    Some([lengths[last / 2], lengths[last * 95 / 100], lengths[last]])
}

const UNTESTED: &str = "the residuals are not searched for patterns while single readings are wrong: correct or leave out what the warnings name, then fit again";

/// Gross errors in what was held out.
fn held_out_words(judgement: &Judgement) -> Vec<String> {
    let words = |(kind, outliers): &(SetKind, Vec<Outlier>)| {
        let named: Vec<_> = outliers.iter().take(LISTED).map(ToString::to_string).collect();
        let more = outliers.len() - named.len();
        let more = if more > 0 { format!(", and {more} more") } else { String::new() };
        format!(
            "{} set, gross errors, far from what the other readings say: {}{more}; measure these poses again or leave them out",
            kind.key(),
            named.join(", ")
        )
    };
    judgement.held_out.iter().map(words).collect()
}

/// What a user must know beside how the estimate ended.
pub(super) fn judgement_lines(outcome: &Outcome, mode: Mode, style: Style) -> Vec<String> {
    let Some(judgement) = outcome.judgements.iter().find(|j| j.mode == mode) else { return Vec::new() };
    let mut lines = Vec::new();
    let mut say = |ink, words: &str, indent: &str| {
        lines.extend(style.told(ink, words, indent));
    };
    if let Some(confidence) = &judgement.confidence {
        let mut words = format!(
            "  the data determine {:.1} of {}",
            confidence.effective_parameters,
            counted(confidence.support.len(), "parameter"),
        );
        if let Some([median, _, most]) = quantiles(&confidence.map) {
            let (usual, worst) = (length_words(median), length_words(most));
            words = format!(
                "{words}; RMS uncertainty of a predicted position (3-D): median {usual} over the region, largest {worst}"
            );
        }
        say(Ink::Dim, &words, "    ");
    }
    for words in scatter_words(outcome, judgement) {
        say(Ink::Dim, &format!("  {}", printable(&words)), "    ");
    }
    for outside in &judgement.outside {
        say(Ink::Warning, &format!("  warning: {outside}"), "           ");
    }
    for worse in &judgement.worse {
        say(Ink::Warning, &format!("  warning: {worse}"), "           ");
    }
    let found = patterns(judgement);
    for pattern in found.iter().take(NAMED) {
        say(Ink::Warning, &format!("  warning: {}", printable(&pattern.to_string())), "           ");
    }
    if found.len() > NAMED {
        let more = counted(found.len() - NAMED, "more pattern");
        say(Ink::Warning, &format!("  and {more} in the residual: see report.html"), "    ");
    }
    if !judgement.makes_sense {
        say(Ink::Warning, &format!("  {UNTESTED}"), "    ");
    }
    for words in held_out_words(judgement) {
        say(Ink::Warning, &format!("  warning: {}", printable(&words)), "           ");
    }
    if judgement.is_consistent() && judgement.consistency.shape.is_some() {
        say(Ink::Good, "  the residual has no pattern against joints, approach, time or sequence", "    ");
    }
    lines
}

/// The section on what the residuals still contain; empty without a judgement.
pub(super) fn residual_section(outcome: &Outcome) -> Result<Markup, ReportError> {
    let mut parts = Vec::new();
    for judgement in &outcome.judgements {
        let Some(mode) = outcome.modes.iter().find(|m| m.mode == judgement.mode) else { continue };
        let mut figures = Vec::new();
        // What has no variable of its own has nothing to be drawn against.
        let drawn = patterns(judgement).iter().filter(|p| p.cause != Cause::Constant).take(DRAWN);
        for pattern in drawn {
            figures.push((pattern, pattern_figure(outcome, mode, judgement, pattern)?));
        }
        parts.push(html! {
            h3 { (judgement.mode.title()) }
            (verdict(judgement))
            @for (pattern, figure) in &figures {
                figure {
                    div.scroll { (PreEscaped(figure)) }
                    figcaption {
                        "Error (measured minus predicted, mm) of the identification set where it " (pattern.description)
                        ". The line joins the means of classes of equal width."
                        (thinned_words(mode.errors.first().map_or(0, Vec::len), MARKED))
                        @if matches!(pattern.cause, Cause::Joint(_) | Cause::MotorTurn(_) | Cause::Approach(_)) {
                            " \u{201c}Along the motion\u{201d} is the direction in which this actuator moves the target in each pose."
                        }
                    }
                }
            }
        });
    }
    Ok(html! {
        @if !parts.is_empty() {
            section #residual {
                h2 { "What the residual still contains" }
                p {
                    "A complete model leaves residuals as large as the stated noise and without a pattern. Patterns are searched against every command, every motor turn, "
                    "the directions of approach, payload, time, temperature and the pose before. One search in a thousand finds a pattern where there is none."
                }
                @for part in &parts { (part) }
            }
        }
    })
}

fn verdict(judgement: &Judgement) -> Markup {
    let consistency = &judgement.consistency;
    let found = patterns(judgement);
    html! {
        @if !judgement.makes_sense {
            p { strong { (UNTESTED) "." } }
        } @else if consistency.shape.is_none() {
            p { "Not tested: there are as many parameters as measured coordinates. Measure more poses." }
        } @else if consistency.is_consistent() {
            p {
                @if consistency.size.is_some() {
                    "The residuals are as large as stated, and show no pattern beyond chance."
                } @else {
                    "The residuals show no pattern beyond chance. The readings state no noise to compare their size with."
                }
            }
        } @else if found.is_empty() && consistency.too_small() {
            p {
                strong { "The noise is smaller than stated. " }
                @if let Some(size) = consistency.size {
                    "The residuals are " (significant(size.ratio())) " times what the stated noise explains, and show no pattern. State the smaller noise: the intervals are wider than they need to be."
                }
            }
        } @else {
            p {
                strong { "The model lacks something. " }
                @if let Some(size) = consistency.size.filter(|_| consistency.too_large()) {
                    "The residuals are " (significant(size.ratio())) " times what the stated noise explains. "
                }
                @if found.is_empty() { "They show no pattern, so that no term can be named: look at the readings and at the noise that is stated." } @else { "Identify a term for the strongest pattern below, or measure what it depends on." }
            }
        }
        @if !found.is_empty() {
            ul.warnings { @for pattern in found { li { (pattern) } } }
        }
        @for words in held_out_words(judgement) { p { (capital(&words)) "." } }
    }
}

/// The section on uncertainty; empty where no system is regular.
pub(super) fn sure_section(outcome: &Outcome) -> Result<Markup, ReportError> {
    let sure: Vec<_> = outcome.judgements.iter().filter_map(|j| Some((j, j.confidence.as_ref()?))).collect();
    let Some((largest, confidence)) = sure.last().copied() else { return Ok(html! {}) };
    let map = if confidence.map.is_empty() { None } else { Some(map_figure(&confidence.map)?) };
    let most = quantiles(&confidence.map).map_or(0.0, |q| q[2]);
    Ok(html! {
        section #sure {
            h2 { "How sure" }
            p {
                "How uncertain the predicted position of the target is: the RMS length of its 3-D error. It holds what the measurements leave open of the parameters, and what the machine does beside the model, as errors of single poses. It does not hold the noise of a reading."
            }
            (overview(&sure))
            @if let Some(map) = &map {
                figure {
                    div.scroll { (PreEscaped(map)) }
                    figcaption {
                        "Uncertainty of the position predicted by \u{201c}" (largest.mode.title()) "\u{201d} in three views of the base frame, over the joint ranges of the measured poses. "
                        "The wider a square, the larger the RMS length of the 3-D error in its cell; the widest is " (length_words(most)) "."
                        @if confidence.out_of_reach > 0 { " The robot cannot reach " (counted(confidence.out_of_reach, "pose")) " of these ranges." }
                    }
                }
            }
            h3 { "What the parameters rest on: " (largest.mode.title()) }
            (weakest(confidence))
            (correlations(confidence))
            (influential(outcome, confidence))
        }
    })
}

fn overview(sure: &[(&Judgement, &Confidence)]) -> Markup {
    html! {
        div.scroll {
            table {
                thead { tr {
                    th {} th { "parameters" } th { "determined" br; "by the data" } th { "median" br; "in the region" }
                    th { "95 %" br; "below" } th { "largest" } th { "RMS error," br; "poses left out" } th.words { "residuals" }
                } }
                tbody {
                    @for (judgement, confidence) in sure {
                        tr {
                            th scope="row" { (judgement.mode.title()) }
                            td { (confidence.support.len()) }
                            td { (format!("{:.1}", confidence.effective_parameters)) }
                            @for length in quantiles(&confidence.map).map_or([None; 3], |q| q.map(Some)) {
                                td { @if let Some(length) = length { (length_words(length)) } }
                            }
                            td { @if let Some(rms) = confidence.left_out_rms() { (length_words(rms)) } @else { "\u{2013}" } }
                            td.words {
                                @if judgement.consistency.is_consistent() { "as stated" } @else { strong { "contradict it" } }
                            }
                        }
                    }
                }
            }
        }
        p.note { "RMS error, poses left out: each pose in turn is predicted from the others (to first order). Where the residuals contradict the stated noise, trust this error and not the standard deviations." }
    }
}

fn weakest(confidence: &Confidence) -> Markup {
    // Tracker and target were measured beforehand: that the poses add little to it is as it should be.
    let is_end = |id: ParameterId| {
        matches!(
            id,
            ParameterId::Frame { .. }
                | ParameterId::Target { .. }
                | ParameterId::Orientation { .. }
                | ParameterId::Instrument { .. }
                | ParameterId::Drift { .. }
        )
    };
    let of_robot = |id: ParameterId| !is_end(id);
    let held = confidence.support.iter().filter(|s| s.prior_sigma.is_some() && of_robot(s.id));
    let mut held: Vec<_> = held.collect();
    held.sort_by(|a, b| a.data_share.total_cmp(&b.data_share));
    html! {
        @if held.is_empty() {
            p { "No parameter of the robot has a prior: all rest on the measurements alone." }
        } @else {
            div.scroll { table {
                caption { "Weakest supported by the data" }
                thead { tr { th.words { "parameter" } th { "data share" } th { "sigma" } th { "prior sigma" } th { "unit" } } }
                tbody { @for support in held.iter().take(LISTED) {
                    @let (unit, factor) = printed_unit(support.id.unit());
                    tr {
                        th scope="row" { code { (support.id) } " " span.note { (parameter_words(support.id)) } }
                        td { (format!("{:.0} %", 100.0 * support.data_share)) }
                        td { (significant(factor * support.sigma)) }
                        td { @if let Some(prior) = support.prior_sigma { (significant(factor * prior)) } }
                        td { (unit) }
                    }
                } }
            } }
            p.note { "Data share: 0 % where a value is its prior's, 100 % where the prior adds nothing." }
        }
    }
}

fn correlations(confidence: &Confidence) -> Markup {
    html! {
        @if confidence.correlations.is_empty() {
            p { "No two parameters are correlated by 0.9 or more." }
        } @else {
            div.scroll { table {
                caption { "Strongest correlations" }
                thead { tr { th.words { "parameters" } th { "correlation" } } }
                tbody { @for (a, b, correlation) in confidence.correlations.iter().take(LISTED) {
                    tr { th scope="row" { code { (a) } ", " code { (b) } } td { (number(*correlation, 4)) } }
                } }
            } }
            @if confidence.correlations.len() > LISTED {
                p.note { (confidence.correlations.len()) " pairs are correlated by 0.9 or more; all are in " code { "report.json" } "." }
            }
        }
    }
}

fn influential(outcome: &Outcome, confidence: &Confidence) -> Markup {
    let poses = outcome.sets.first().map_or(&[][..], |set| &set.measurements.observations);
    let mut all: Vec<_> = poses.iter().zip(confidence.influences.iter().zip(&confidence.left_out)).collect();
    let size = |cook: Option<f64>| cook.unwrap_or(f64::INFINITY);
    all.sort_by(|a, b| size(b.1.0.cook).total_cmp(&size(a.1.0.cook)));
    html! {
        div.scroll { table {
            caption { "Poses on which the estimate depends most" }
            thead { tr { th { "pose" } th { "leverage" } th { "Cook's distance" } th { "error if left out" } } }
            tbody { @for (observation, (influence, left_out)) in all.iter().take(LISTED) {
                tr {
                    td { (observation.pose) }
                    td { (format!("{:.2}", influence.leverage)) }
                    td { @if let Some(cook) = influence.cook { (significant(cook)) } @else { "\u{2013}" } }
                    td { @if let Some(error) = left_out { (length_words(error.norm())) } @else { "\u{2013}" } }
                }
            } }
        } }
        p.note {
            "Leverage: how many parameters a pose determines by itself, from 0 to 3. Cook's distance: how far the estimate would move without the pose, in units of its uncertainty. "
            "From about 1 on, measure the pose once more."
        }
    }
}
