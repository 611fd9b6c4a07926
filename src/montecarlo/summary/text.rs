//! The summary for people: accuracy with its intervals, consistency, and parameter by parameter.

use std::fmt::Write;

use calibrig_campaign::statistics::Estimated;

use super::digits::{decimals, with_interval};
use super::{
    CampaignSummary, ENOUGH, FactorEffect, GroupSummary, MeanWithInterval, ModeSummary, Rate, SetSummary,
};
use crate::montecarlo::AccuracySet;
use calibrig_estimation::identification::Mode;
use calibrig_model::Unit;

/// The tables. Intervals are of 95 % unless stated otherwise.
pub fn summary_text(summary: &CampaignSummary) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "campaign of {} trials of \"{}\", seed {}, plant: {}",
        summary.trials, summary.name, summary.seed, summary.study.plant
    );
    failures_text(&mut text, summary);
    match &summary.groups[..] {
        [group] if group.levels.is_empty() => group_text(&mut text, summary, group),
        groups => sweep_text(&mut text, summary, groups),
    }
    sensitivity_text(&mut text, summary);
    worst_text(&mut text, summary);
    if let Some(answer) = summary.answer() {
        let _ = writeln!(text, "\n{answer}");
    }
    text
}

fn group_text(text: &mut String, summary: &CampaignSummary, group: &GroupSummary) {
    for kind in AccuracySet::ALL {
        accuracy_text(text, kind, summary, group);
    }
    convergence_text(text, group);
    consistency_text(text, group);
    for mode in group.modes.iter().filter(|m| !m.parameters.is_empty()) {
        parameters_text(text, mode);
    }
}

fn failures_text(text: &mut String, summary: &CampaignSummary) {
    const SHOWN: usize = 5;
    if summary.redrawn > 0 {
        let _ = writeln!(
            text,
            "{} times an impossible trial was drawn, and drawn again (column redrawn)",
            summary.redrawn
        );
    }
    if summary.failed == 0 {
        return;
    }
    let _ = writeln!(text, "{} failed:", summary.failed);
    for reason in summary.reasons.iter().take(SHOWN) {
        let _ = writeln!(text, "  {} times, first in trial {}: {}", reason.count, reason.trial, reason.text);
    }
    if summary.reasons.len() > SHOWN {
        let _ =
            writeln!(text, "  and {} other reasons: see the column reason", summary.reasons.len() - SHOWN);
    }
}

/// A figure with its interval, in `unit` of the value.
fn figure(estimate: &Estimated, unit: f64) -> String {
    with_interval(estimate.value, estimate.interval, 1.0 / unit, plain)
}

fn mean(mean: &MeanWithInterval, unit: f64) -> String {
    with_interval(mean.mean, mean.interval(), 1.0 / unit, plain)
}

fn plain(value: f64, digits: usize) -> String {
    format!("{value:.digits$}")
}

fn mean_mm(mean: &MeanWithInterval) -> String {
    self::mean(mean, 1e-3)
}

fn percent(rate: &Rate) -> String {
    match rate.share.interval {
        Some(interval) => {
            format!("{:.1} % [{:.1}, {:.1}]", 1e2 * rate.share.value, 1e2 * interval.low, 1e2 * interval.high)
        }
        None => format!("{:.1} %", 1e2 * rate.share.value),
    }
}

fn accuracy_text(text: &mut String, kind: AccuracySet, summary: &CampaignSummary, group: &GroupSummary) {
    let rows: Vec<(&ModeSummary, &SetSummary)> = group
        .modes
        .iter()
        .filter_map(|m| m.sets.iter().find(|s| s.kind == kind).map(|set| (m, set)))
        .collect();
    if rows.is_empty() {
        return;
    }
    let _ = writeln!(
        text,
        "\n{:<41} {:>19} {:>19} {:>19} {:>19}  5 % .. 95 % of trials",
        format!("{} (mm)", kind.title()),
        "mean |x|",
        "mean |y|",
        "mean |z|",
        "RMS 3-D"
    );
    for (mode, set) in &rows {
        let digits = decimals(1e3 * set.rms_3d.half_width.unwrap_or(1.0));
        let _ = writeln!(
            text,
            "{:<41} {:>19} {:>19} {:>19} {:>19}  {:.digits$} .. {:.digits$}",
            mode.mode.title(),
            mean_mm(&set.mean[0]),
            mean_mm(&set.mean[1]),
            mean_mm(&set.mean[2]),
            mean_mm(&set.rms_3d),
            1e3 * set.rms_3d.quantiles[0],
            1e3 * set.rms_3d.quantiles[2]
        );
    }
    let Some(tolerance) = summary.tolerance else { return };
    let _ = writeln!(text, "within {} mm", in_mm(tolerance));
    for (mode, set) in rows {
        let share = |rate: &Option<Rate>| rate.as_ref().map_or_else(|| "-".to_owned(), percent);
        let _ = writeln!(
            text,
            "  {:<39} RMS in {} of trials, every pose in {}",
            mode.mode.title(),
            share(&set.rms_within),
            share(&set.max_within)
        );
    }
}

fn convergence_text(text: &mut String, group: &GroupSummary) {
    let wanting: Vec<_> = group
        .modes
        .iter()
        .filter_map(|mode| Some((mode, mode.told()?.convergence?)))
        .filter(|(_, convergence)| !convergence.is_enough())
        .collect();
    let Some((mode, most)) = wanting.iter().max_by_key(|(_, convergence)| convergence.needed) else {
        if group.modes.iter().any(|mode| mode.told().is_some_and(|set| set.convergence.is_some())) {
            let _ =
                writeln!(text, "\nEnough trials: every mean RMS is known within {} % (95 %).", 1e2 * ENOUGH);
        }
        return;
    };
    let _ = writeln!(
        text,
        "\nThe mean RMS of {} is uncertain by {:.1} % (95 %): about {} further trials reduce that to {} %.",
        mode.mode.title(),
        1e2 * most.reached,
        most.more(),
        1e2 * ENOUGH
    );
}

fn consistency_text(text: &mut String, group: &GroupSummary) {
    for mode in &group.modes {
        let Some(chi2) = &mode.chi2_per_dof else { continue };
        let _ = write!(text, "\n{}: chi-square per degree of freedom {}", mode.mode.title(), mean(chi2, 1.0));
        if let Some(nees) = mode.nees {
            let n = nees.parameters;
            let verdict =
                if nees.mean < nees.band.0 || nees.mean > nees.band.1 { "outside" } else { "inside" };
            let _ = write!(
                text,
                "; NEES per parameter {:.4}, {verdict} its 99.9 % band {:.4} .. {:.4}",
                nees.mean / n,
                nees.band.0 / n,
                nees.band.1 / n
            );
        }
        if let Some(squared) = &mode.squared_over_bound {
            let _ = write!(
                text,
                "; squared error over the bound at the truth {} per parameter",
                mean(squared, 1.0)
            );
        }
        if let Some(predictions) = mode.predictions {
            let share = 100.0 * predictions.coverage.fraction();
            let _ = write!(text, "; {share:.2} %");
            // Says nothing for few trials.
            if let Some(half) = predictions.half_width.filter(|half| *half < 0.5) {
                let _ = write!(text, " ± {:.2} (99.9 %)", 100.0 * half);
            }
            text.push_str(" of the true coordinates inside their stated 95 % intervals");
        }
        if mode.doubtful > 0 {
            let _ = write!(text, "; {} doubtful", mode.doubtful);
        }
        text.push('\n');
    }
}

fn parameters_text(text: &mut String, mode: &ModeSummary) {
    let _ = writeln!(
        text,
        "\n{}: parameters; consistency is RMSE over stated standard deviation, bound the {}\n{:<24} {:>6} {:>21} {:>21} {:>12} {:>23} {:>12} {:>23} {:>25}",
        mode.mode.title(),
        if mode.parameters.iter().any(|p| p.bayesian.is_some()) {
            "Bayesian Cramér-Rao bound"
        } else {
            "Cramér-Rao bound of the measurements alone"
        },
        "",
        "unit",
        "bias",
        "RMSE",
        "stated",
        "consistency",
        "bound",
        "RMSE/bound",
        "in 95 % [99.9 %]"
    );
    for p in &mode.parameters {
        let (unit, scale) = match p.id.unit() {
            Unit::Metre => ("mm", 1e3),
            Unit::Radian => ("mrad", 1e3),
            Unit::One => ("%", 1e2),
        };
        let (low, high) = p.coverage.interval(super::BAND);
        let _ = writeln!(
            text,
            "{:<24} {unit:>6} {:>21} {:>21} {:>12.5} {:>23} {:>12} {:>23} {:>25}",
            p.id.to_string(),
            fine(&p.bias, scale),
            fine(&p.rmse, scale),
            scale * p.stated,
            coarse(&p.consistency),
            p.least().map_or_else(|| "-".to_owned(), |bound| format!("{:.5}", scale * bound)),
            p.over_bound.as_ref().map_or_else(|| "-".to_owned(), coarse),
            format!("{:.1} % [{:.1}, {:.1}]", 1e2 * p.coverage.fraction(), 1e2 * low, 1e2 * high)
        );
    }
}

fn fine(estimate: &Estimated, scale: f64) -> String {
    match estimate.interval {
        Some(interval) => format!("{:.5} ± {:.5}", scale * estimate.value, scale * interval.half_width()),
        None => format!("{:.5}", scale * estimate.value),
    }
}

/// With the ends of its interval, which need not be symmetric.
fn coarse(estimate: &Estimated) -> String {
    match estimate.interval {
        Some(interval) => format!("{:.3} [{:.3}, {:.3}]", estimate.value, interval.low, interval.high),
        None => format!("{:.3}", estimate.value),
    }
}

/// A tolerance as it was written: no more digits than nanometres.
fn in_mm(tolerance: f64) -> f64 {
    (1e9 * tolerance).round() / 1e6
}

fn sweep_text(text: &mut String, summary: &CampaignSummary, groups: &[GroupSummary]) {
    let names: Vec<_> = summary.study.factors.iter().map(|factor| factor.name.as_str()).collect();
    let modes: Vec<Mode> = summary.modes().iter().map(|mode| mode.mode).collect();
    for (place, mode) in modes.iter().enumerate() {
        // One for all, so that a column has one meaning.
        let is_known = |kind: &&AccuracySet| {
            let modes = || groups.iter().filter_map(|group| group.modes.get(place));
            modes().any(|mode| mode.sets.iter().any(|set| set.kind == **kind))
        };
        let kind = AccuracySet::ALL.iter().rev().find(is_known).copied();
        let _ = writeln!(
            text,
            "\n{}{}\n{:<30} {:>7} {:>7} {:>18}  {:>18} {:>22}{}",
            mode.title(),
            kind.map_or_else(String::new, |kind| format!(", {} (mm)", kind.title())),
            names.join(", "),
            "trials",
            "failed",
            "RMS 3-D",
            "5 % .. 95 %",
            "minus the first row",
            if summary.tolerance.is_some() { "  RMS within the tolerance" } else { "" }
        );
        for group in groups {
            let set =
                group.modes.get(place).and_then(|mode| mode.sets.iter().find(|set| Some(set.kind) == kind));
            let within = summary.tolerance.map(|_| match set.and_then(|set| set.rms_within.as_ref()) {
                Some(rate) => format!("  {}", percent(rate)),
                None if group.failed == group.trials => "  0.0 %: all failed".to_owned(),
                None => "  -".to_owned(),
            });
            sweep_row(text, group, set, &within.unwrap_or_default());
        }
    }
    let tolerance =
        summary.tolerance.map_or_else(String::new, |t| format!("; the tolerance is {} mm", in_mm(t)));
    let _ = writeln!(
        text,
        "\nAll combinations have the same draws: \"minus the first row\" is the mean of differences of single \
         trials{tolerance}."
    );
}

fn sweep_row(text: &mut String, group: &GroupSummary, set: Option<&SetSummary>, within: &str) {
    let cell = |figure: Option<String>| figure.unwrap_or_else(|| "-".to_owned());
    let difference =
        set.and_then(|set| set.against_first.as_ref()).map(|difference| figure(difference, 1e-3));
    let _ = writeln!(
        text,
        "{:<30} {:>7} {:>7} {:>18}  {:>18} {:>22}{}",
        group.levels.join(", "),
        group.trials,
        group.failed,
        cell(set.map(|set| mean_mm(&set.rms_3d))),
        cell(set.map(|set| format!(
            "{:.3} .. {:.3}",
            1e3 * set.rms_3d.quantiles[0],
            1e3 * set.rms_3d.quantiles[2]
        ))),
        cell(difference),
        within
    );
}

fn sensitivity_text(text: &mut String, summary: &CampaignSummary) {
    for sensitivity in &summary.sensitivity {
        let indices = matches!(sensitivity.effects.first(), Some((_, FactorEffect::Indices(_))));
        let heading = if indices {
            ["share of the variance", "with all interactions", ""]
        } else {
            ["mean effect (mm)", "mean size (mm)", "scatter (mm)"]
        };
        let _ = writeln!(
            text,
            "\n{}: what the RMS 3-D of the {} depends on\n{:<30} {:>22} {:>22} {:>22}",
            sensitivity.mode.title(),
            sensitivity.kind.title(),
            "",
            heading[0],
            heading[1],
            heading[2]
        );
        for (name, effect) in &sensitivity.effects {
            let mm = |estimate: &Option<Estimated>| {
                estimate.as_ref().map_or_else(|| "-".to_owned(), |estimate| figure(estimate, 1e-3))
            };
            let cells = match effect {
                FactorEffect::Indices(indices) => {
                    [coarse(&indices.first), coarse(&indices.total), String::new()]
                }
                FactorEffect::Screening(effects) => {
                    [mm(&effects.mean), mm(&effects.mean_absolute), mm(&effects.deviation)]
                }
            };
            let _ = writeln!(text, "{name:<30} {:>22} {:>22} {:>22}", cells[0], cells[1], cells[2]);
        }
        if sensitivity.left_out > 0 {
            let _ = writeln!(text, "left out, because trials failed: {}", sensitivity.left_out);
        }
    }
}

fn worst_text(text: &mut String, summary: &CampaignSummary) {
    let Some(first) = summary.worst.first() else { return };
    let _ = writeln!(text, "\nLargest errors, {}:", first.mode.title());
    for worst in &summary.worst {
        let command = summary.rerun_command(worst.trial);
        let _ = writeln!(text, "  trial {}, RMS {:.3} mm: {command}", worst.trial, 1e3 * worst.rms_3d);
    }
}
