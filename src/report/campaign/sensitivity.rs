//! What the accuracy depends on, factor by factor.

use maud::{Markup, html};

use super::words::{MM, NONE, count, drawn, estimate, index, set_words, unit};
use crate::montecarlo::{CampaignSummary, FactorEffect, Sensitivity};
use crate::report::files::ReportError;
use crate::report::markup::key;
use crate::report::plots::look;
use crate::report::rows::{Dot, Panel, dots};
use calibrig_campaign::statistics::Estimated;

/// Factors that are drawn and listed, those that matter most first.
const MOST: usize = 40;

/// Of either design: what is drawn of an effect.
fn two(effect: &FactorEffect) -> [Option<Estimated>; 2] {
    match effect {
        FactorEffect::Indices(indices) => [Some(indices.total), Some(indices.first)],
        FactorEffect::Screening(effects) => [effects.mean_absolute, effects.deviation],
    }
}

fn is_indices(summary: &CampaignSummary) -> bool {
    summary
        .sensitivity
        .iter()
        .flat_map(|s| &s.effects)
        .any(|(_, effect)| matches!(effect, FactorEffect::Indices(_)))
}

/// The factors, by the largest effect that one has in any mode.
fn ranked(summary: &CampaignSummary) -> Vec<String> {
    let mut names: Vec<(String, f64)> = Vec::new();
    for (place, sensitivity) in summary.sensitivity.iter().enumerate() {
        // Modes differ in size: what matters is the share of the largest.
        let size = |effect: &FactorEffect| two(effect)[0].map_or(0.0, |estimate| estimate.value);
        let most = sensitivity.effects.iter().map(|(_, effect)| size(effect)).fold(0.0, f64::max);
        for (at, (name, effect)) in sensitivity.effects.iter().enumerate() {
            let share = if most > 0.0 { size(effect) / most } else { 0.0 };
            match names.get_mut(at).filter(|_| place > 0) {
                Some(known) => known.1 = known.1.max(share),
                None => names.push((name.clone(), share)),
            }
        }
    }
    names.sort_by(|a, b| b.1.total_cmp(&a.1));
    names.into_iter().map(|(name, _)| name).take(MOST).collect()
}

fn effect_of<'a>(sensitivity: &'a Sensitivity, name: &str) -> Option<&'a FactorEffect> {
    sensitivity.effects.iter().find(|(known, _)| known == name).map(|(_, effect)| effect)
}

/// The section of a design that tells it.
pub(super) fn section(summary: &CampaignSummary) -> Markup {
    let names = ranked(summary);
    if names.is_empty() {
        return html! { section #sensitivity { h2 { "What it depends on" } p { "No effect is known: too many trials failed, or there are too few." } } };
    }
    let indices = is_indices(summary);
    html! {
        section #sensitivity {
            h2 { "What it depends on" }
            figure {
                div.legend { @for own in &summary.sensitivity { span { (key(&look(own.mode))) (own.mode.title()) } } }
                (drawn(tornado(summary, &names, indices)))
                figcaption { (caption(indices)) }
            }
            div.columns[indices] { @for own in &summary.sensitivity { (table(own, &names, indices)) } }
        }
    }
}

fn caption(indices: bool) -> &'static str {
    if indices {
        "Sobol's indices of the RMS 3-D error, with their 95 % intervals. First order: the share of the variance over the trials that is gone, in the mean, once the factor is known. \
         Total: the share that is left once all others are known; more than the first-order index where the factor acts together with others. \
         \u{201c}draws\u{201d} is everything random that is no factor: machine, noise and poses. Estimates may lie below 0 or above 1."
    } else {
        "Elementary effects after Morris on the RMS 3-D error, mm, for the whole range of a factor, with their 95 % intervals. Mean size (mu*): how much the factor matters. \
         Scatter (sigma): large where it acts nonlinearly or together with others."
    }
}

fn tornado(summary: &CampaignSummary, names: &[String], indices: bool) -> Result<String, ReportError> {
    let factor = if indices { 1.0 } else { MM };
    let titles = if indices {
        ["total index", "first-order index"]
    } else {
        ["mean size (mu*), mm", "scatter (sigma), mm"]
    };
    let dot = |own: &Sensitivity, name: &str, which: usize| {
        let estimate = two(effect_of(own, name)?)[which]?;
        Some(Dot {
            look: look(own.mode),
            value: factor * estimate.value,
            interval: estimate.interval.map(|interval| (factor * interval.low, factor * interval.high)),
            band: None,
        })
    };
    let panels: Vec<_> = titles
        .iter()
        .enumerate()
        .map(|(which, title)| {
            let row =
                |name: &String| summary.sensitivity.iter().filter_map(|own| dot(own, name, which)).collect();
            Panel { bars: true, ..Panel::of(title, 0.0, names.iter().map(row).collect()) }
        })
        .collect();
    dots("sensitivities", "What the accuracy depends on", names, &panels)
}

fn table(own: &Sensitivity, names: &[String], indices: bool) -> Markup {
    let sizes = own.effects.iter().filter_map(|(_, effect)| two(effect)[0]);
    let (unit, factor) = unit(sizes.map(|estimate| estimate.value).fold(0.0, f64::max));
    let cell = |value: &Option<Estimated>| {
        value.as_ref().map_or_else(|| NONE.to_owned(), |value| estimate(value, factor))
    };
    html! {
        div {
        div.scroll { table {
            caption { (key(&look(own.mode))) (own.mode.title()) ", " (set_words(own.kind)) @if !indices { ", " (unit) } }
            thead { tr {
                th { "factor" }
                @if indices { th { "first order" } th { "total" } } @else { th { "mean effect" } th { "mean size" } th { "scatter" } th { "effects" } }
            } }
            tbody { @for name in names {
                tr {
                    th scope="row" { (super::words::name(name)) }
                    @match effect_of(own, name) {
                        Some(FactorEffect::Indices(effect)) => { td { (index(&effect.first)) } td { (index(&effect.total)) } },
                        Some(FactorEffect::Screening(effects)) => {
                            td { (cell(&effects.mean)) } td { (cell(&effects.mean_absolute)) } td { (cell(&effects.deviation)) } td { (count(effects.count)) }
                        },
                        None => { td { (NONE) } td { (NONE) } @if !indices { td { (NONE) } td { (NONE) } } },
                    }
                }
            } }
        } }
        @if own.effects.len() > names.len() { p.note { "and " (own.effects.len() - names.len()) " other factors: " code { "summary.json" } } }
        @if own.left_out > 0 {
            p.note { (count(own.left_out)) @if indices { " rows of the base" } @else { " effects of a factor at most" } " were left out, because trials failed." }
        }
        }
    }
}
