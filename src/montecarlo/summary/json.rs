//! The summary as a JSON document.

use calibrig_campaign::statistics::{Convergence, Estimated, Histogram};
use serde_json::{Value, json};

use super::{
    BAND, CampaignSummary, FactorEffect, GroupSummary, LEVEL, MeanWithInterval, ModeSummary,
    ParameterSummary, PredictionCoverage, Rate, Sensitivity, SetSummary,
};
use calibrig_estimation::evaluation::Coverage;

/// The summary as a JSON document, schema `calibrig.campaign/1`. Figures are SI; `half_width_95` and `interval_95` have 95 % confidence.
pub fn summary_json(summary: &CampaignSummary) -> Value {
    let factor = |factor: &crate::scenario::Factor| json!({ "name": factor.name, "keys": factor.keys });
    let mut document = json!({
        "schema": "calibrig.campaign/1",
        "software": { "version": env!("CARGO_PKG_VERSION") },
        "scenario": summary.name,
        "sha256": summary.sha256,
        "seed": summary.seed,
        "plant": summary.study.plant,
        "first": summary.first,
        "trials": summary.trials,
        "failed": summary.failed,
        "doubtful": summary.doubtful,
        "redrawn": summary.redrawn,
        "tolerance_m": summary.tolerance,
        "design": summary.study.design,
        "factors": summary.study.factors.iter().map(factor).collect::<Vec<_>>(),
        "failures": summary.reasons.iter().map(|r| json!({ "trial": r.trial, "reason": r.text, "trials": r.count })).collect::<Vec<_>>(),
        "worst": summary.worst.iter().map(|w| json!({ "trial": w.trial, "mode": w.mode.key(), "rms_3d_m": w.rms_3d })).collect::<Vec<_>>(),
        "sensitivity": summary.sensitivity.iter().map(sensitivity_json).collect::<Vec<_>>(),
    });
    // One group is the campaign itself.
    match &summary.groups[..] {
        [group] if group.levels.is_empty() => document["modes"] = modes_json(group),
        groups => document["groups"] = groups.iter().map(group_json).collect(),
    }
    document
}

fn group_json(group: &GroupSummary) -> Value {
    json!({ "levels": group.levels.iter().map(|level| level.trim_matches('"')).collect::<Vec<_>>(), "trials": group.trials, "failed": group.failed, "modes": modes_json(group) })
}

fn modes_json(group: &GroupSummary) -> Value {
    group.modes.iter().map(mode_json).collect()
}

fn interval_json(estimate: &Estimated) -> Value {
    estimate.interval.map_or(Value::Null, |interval| json!([interval.low, interval.high]))
}

fn estimate_json(estimate: &Estimated) -> Value {
    json!({ "value": estimate.value, "interval_95": interval_json(estimate) })
}

fn mean_json(mean: &MeanWithInterval) -> Value {
    let intervals = mean.quantile_intervals.map(|interval| interval.map(|i| [i.low, i.high]));
    json!({
        "trials": mean.trials, "mean": mean.mean, "half_width_95": mean.half_width,
        "standard_deviation": mean.deviation.as_ref().map(estimate_json),
        "quantiles_5_50_95": mean.quantiles, "quantile_intervals_95": intervals,
    })
}

fn rate_json(rate: &Rate) -> Value {
    json!({ "trials": rate.hits, "of": rate.trials, "share": rate.share.value, "interval_95": interval_json(&rate.share) })
}

fn coverage_json(coverage: Coverage) -> Value {
    if coverage.trials == 0 {
        return Value::Null;
    }
    let (low, high) = coverage.interval(BAND);
    json!({
        "fraction": coverage.fraction(), "intervals": coverage.trials,
        "interval_99_9": [low, high], "p_value_of_95_percent": coverage.p_value(LEVEL),
    })
}

fn predictions_json(predictions: &PredictionCoverage) -> Value {
    let fraction = predictions.coverage.fraction();
    json!({
        "fraction": fraction, "intervals": predictions.coverage.trials,
        "interval_99_9": interval_json(&predictions.estimate()),
    })
}

fn convergence_json(convergence: &Convergence) -> Value {
    json!({
        "half_width_over_mean": convergence.reached, "wanted": convergence.wanted,
        "is_enough": convergence.is_enough(), "further_trials": convergence.more(),
    })
}

fn histogram_json(histogram: &Histogram) -> Value {
    let counts = histogram.counts();
    let ends = [histogram.edges(0).0, histogram.edges(counts.len().saturating_sub(1)).1];
    json!({ "from_m": ends[0], "to_m": ends[1], "counts": counts })
}

fn set_json(set: &SetSummary) -> Value {
    let axes = |axes: &[MeanWithInterval; 3]| axes.iter().map(mean_json).collect::<Vec<_>>();
    json!({
        "max_m": axes(&set.max), "mean_m": axes(&set.mean), "rms_3d_m": mean_json(&set.rms_3d), "max_3d_m": mean_json(&set.max_3d),
        "rms_within_tolerance": set.rms_within.as_ref().map(rate_json),
        "max_within_tolerance": set.max_within.as_ref().map(rate_json),
        "convergence": set.convergence.as_ref().map(convergence_json),
        "histogram_of_rms_3d": set.histogram.as_ref().map(histogram_json),
        "rms_against_first_combination_m": set.against_first.as_ref().map(estimate_json),
    })
}

fn parameter_json(p: &ParameterSummary) -> Value {
    json!({
        "name": p.id.to_string(), "unit": p.id.unit().to_string(), "bias": p.bias.value, "bias_interval_95": interval_json(&p.bias),
        "rmse": p.rmse.value, "rmse_interval_95": interval_json(&p.rmse), "stated_sigma": p.stated,
        "consistency": p.consistency.value, "consistency_interval_95": interval_json(&p.consistency),
        "cramer_rao_bound": p.cramer_rao, "rmse_over_cramer_rao_bound": p.cramer_rao.map(|bound| p.rmse.value / bound),
        "bayesian_cramer_rao_bound": p.bayesian,
        "rmse_over_bayesian_cramer_rao_bound": p.bayesian.map(|bound| p.rmse.value / bound),
        "rmse_over_bound": p.over_bound.as_ref().map(estimate_json),
        "coverage": coverage_json(p.coverage),
    })
}

fn mode_json(mode: &ModeSummary) -> Value {
    let sets: serde_json::Map<String, Value> =
        mode.sets.iter().map(|set| (set.kind.key().to_owned(), set_json(set))).collect();
    json!({
        "mode": mode.mode.key(),
        "sets": sets,
        "doubtful": mode.doubtful,
        "iterations": mode.iterations.as_ref().map(mean_json),
        "chi2_per_dof": mode.chi2_per_dof.as_ref().map(mean_json),
        "nees": mode.nees.map(|n| json!({ "mean": n.mean, "parameters": n.parameters, "trials": n.trials, "band_99_9": [n.band.0, n.band.1] })),
        "squared_over_bound": mode.squared_over_bound.as_ref().map(mean_json),
        "parameters": mode.parameters.iter().map(parameter_json).collect::<Vec<_>>(),
        "prediction_coverage": mode.predictions.as_ref().map(predictions_json),
    })
}

fn sensitivity_json(sensitivity: &Sensitivity) -> Value {
    let effect = |(name, effect): &(String, FactorEffect)| match effect {
        FactorEffect::Indices(indices) => json!({
            "factor": name, "first_order": estimate_json(&indices.first), "total": estimate_json(&indices.total),
        }),
        FactorEffect::Screening(effects) => json!({
            "factor": name, "effects": effects.count,
            "mean_m": effects.mean.as_ref().map(estimate_json),
            "mean_absolute_m": effects.mean_absolute.as_ref().map(estimate_json),
            "standard_deviation_m": effects.deviation.as_ref().map(estimate_json),
        }),
    };
    json!({
        "mode": sensitivity.mode.key(), "set": sensitivity.kind.key(), "of": "rms_3d_m", "left_out": sensitivity.left_out,
        "effects": sensitivity.effects.iter().map(effect).collect::<Vec<_>>(),
    })
}
