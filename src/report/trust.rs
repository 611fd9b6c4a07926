//! Whether the numbers can be trusted: how every estimate ended, and what it warns of.

use std::fmt::Write;

use maud::{Markup, html};

use super::drift::drift_section;
use super::markup::key;
use super::parameters::fitted;
use super::plots::look;
use super::sweeps::sweep_section;
use super::words::{
    condition_words, consistency_ratio, counted, left_out_words, length_words, parameter_words, set_title,
    significant,
};
use crate::pipeline::Outcome;
use calibrig_estimation::identification::Estimate;
use calibrig_estimation::identification::{
    Assumption, DependentGroup, Mode, NoiseScale, Warning, WeakDirection,
};
use calibrig_model::ParameterId;

/// Poses that were not measured and are named.
const LISTED: usize = 50;

pub(super) fn trust_section(outcome: &Outcome) -> Markup {
    let fitted = fitted(outcome);
    html! {
        section #trust {
            h2 { "Can the numbers be trusted?" }
            @if fitted.is_empty() {
                p { "No model was fitted." }
            } @else {
                (estimate_table(&fitted))
                p.note {
                    "The condition number is that of the system with scaled columns. \u{221a}(\u{3c7}\u{b2}/dof) compares the residuals with the stated noise: "
                    "1 where model and noise are right; dof are the degrees of freedom."
                }
            }
            @for (mode, estimate) in &fitted {
                (mode_trust(*mode, estimate))
            }
            (sweep_section(outcome))
            (drift_section(outcome))
            @for set in outcome.sets.iter().filter(|s| !s.dropped.is_empty()) {
                h3 { (set_title(set.kind)) ": " (counted(set.dropped.len(), "pose")) " not measured" }
                ul { @for (pose, why) in set.dropped.iter().take(LISTED) { li { "pose " (pose) ": " (why) } } }
                @if set.dropped.len() > LISTED { p.note { "And " (set.dropped.len() - LISTED) " more: report.json." } }
            }
        }
    }
}

pub(super) fn estimate_table(fitted: &[(Mode, &Estimate)]) -> Markup {
    html! {
        div.scroll {
            table {
                thead {
                    tr {
                        th {} th.words { "state" } th { "iterations" } th { "rank" } th { "condition" }
                        th { "\u{3c7}\u{b2}" } th { "dof" } th { "\u{221a}(\u{3c7}\u{b2}/dof)" }
                    }
                }
                tbody {
                    @for (mode, estimate) in fitted {
                        tr {
                            th scope="row" { (key(&look(*mode))) (mode.title()) }
                            td.words {
                                @if estimate.termination.converged() { "converged: " } @else { strong { "not converged: " } }
                                (estimate.termination.words())
                            }
                            td { (estimate.iterations.len()) }
                            td { (estimate.spectrum.rank) " of " (estimate.parameters.len()) }
                            td { (condition_words(estimate.spectrum.condition)) }
                            @match estimate.noise {
                                NoiseScale::Stated => td { (significant(estimate.chi2)) },
                                NoiseScale::Residuals(_) => td { "\u{2013}" },
                            }
                            td { (format!("{:.1}", estimate.degrees_of_freedom)) }
                            td {
                                @if let Some(ratio) = consistency_ratio(estimate) { (significant(ratio)) } @else { "\u{2013}" }
                            }
                        }
                    }
                }
            }
        }
    }
}

pub(super) fn mode_trust(mode: Mode, estimate: &Estimate) -> Markup {
    let spectrum = &estimate.spectrum;
    // Weak directions have a list of their own below.
    let warnings: Vec<_> = estimate.warnings.iter().filter(|w| !matches!(w, Warning::Weak { .. })).collect();
    html! {
        h3 { (key(&look(mode))) (mode.title()) }
        @if warnings.is_empty() && spectrum.weak.is_empty() && spectrum.dependent.is_empty() {
            p { "No warnings; every parameter is determined." }
        }
        @if !warnings.is_empty() {
            ul.warnings { @for warning in &warnings { li { (warning) } } }
        }
        @for words in left_out_words(estimate) { p { "Left out: " (words) "." } }
        @if !estimate.bounds.is_empty() {
            p { "Held within bounds: " (estimate.bounds.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")) "." }
        }
        (machine_noise(estimate))
        @if let NoiseScale::Residuals(sigma) = estimate.noise {
            p { "The readings state no uncertainty; from the residuals, one coordinate has a standard deviation of " (length_words(sigma)) "." }
        }
        @if !spectrum.dependent.is_empty() {
            p { "Not identifiable from these measurements (fix them, or measure what tells them apart):" }
            ul { @for group in &spectrum.dependent { li { (dependent_words(group)) } } }
        }
        @if !spectrum.weak.is_empty() {
            p { "Poorly determined:" }
            ul { @for weak in &spectrum.weak { li { (weak_words(weak)) } } }
        }
        @if !(spectrum.dependent.is_empty() && spectrum.weak.is_empty()) {
            p.note { code { "calibrig identifiability" } " says what to fix or to measure." }
        }
    }
}

/// What readings and machine were found to do beside what is stated, and what that makes of intervals.
pub(super) fn machine_noise(estimate: &Estimate) -> Markup {
    let is_found =
        |a: &&Assumption| matches!(a, Assumption::NoiseOfReadings { .. } | Assumption::NoiseOfMachine(_));
    html! {
        @for found in estimate.assumptions.iter().filter(is_found) { p { (found) "." } }
        @if let Some(freedom) = estimate.interval_freedom.filter(|freedom| freedom.is_finite()) {
            p {
                "The 95 % interval of a parameter is " (format!("{:.2}", estimate.interval_factor(0.95))) " standard deviations to either side (Student\u{2019}s t, "
                (format!("{freedom:.1}")) " degrees of freedom of the estimated noise)."
            }
        }
    }
}

pub(super) fn dependent_words(group: &DependentGroup) -> String {
    if group.with.is_empty() {
        return format!(
            "{} ({}) changes nothing that was measured.",
            group.redundant,
            parameter_words(group.redundant)
        );
    }
    format!(
        "{} ({}) does the same as {} (m and rad): only the combination is determined.",
        group.redundant,
        parameter_words(group.redundant),
        combination(&group.with)
    )
}

pub(super) fn weak_words(weak: &WeakDirection) -> String {
    format!(
        "{} (scaled weights): changed together in these proportions, they show {} of what the best determined combination shows in the \
         measurements.",
        combination(&weak.members),
        fraction_words(weak.singular_value)
    )
}

/// "1/530" with two significant digits; "1/1.7e5" beyond ten thousand.
pub(super) fn fraction_words(share: f64) -> String {
    let factor = 1.0 / share;
    if factor < 1e4 {
        let unit = 10.0_f64.powf(factor.log10().floor() - 1.0);
        format!("1/{:.0}", (factor / unit).round() * unit)
    } else {
        format!("1/{factor:.1e}")
    }
}

pub(super) fn combination(members: &[(ParameterId, f64)]) -> String {
    let mut text = String::new();
    for (i, (id, weight)) in members.iter().enumerate() {
        let sign = match (i, *weight < 0.0) {
            (0, false) => "",
            (0, true) => "\u{2212}",
            (_, false) => " + ",
            (_, true) => " \u{2212} ",
        };
        let weight = weight.abs();
        if (weight - 1.0).abs() < 5e-4 {
            let _ = write!(text, "{sign}{id}");
        } else {
            let _ = write!(text, "{sign}{} {id}", significant(weight));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_have_two_digits() {
        assert_eq!([1.9e-3, 0.01, 5.9e-6].map(fraction_words), ["1/530", "1/100", "1/1.7e5"]);
    }
}
