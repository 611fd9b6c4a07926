//! What many trials say together. Every sum runs in the order of the indices, so that the same trials give the same bits.

use std::fmt::Write;

use serde_json::{Value, json};

use super::{Campaign, ModeResult, ParameterResult, Trial, trial::Fit};
use calibrig_estimation::evaluation::{Coverage, mean_nees_band};
use calibrig_estimation::identification::Mode;
use calibrig_model::measurement::SetKind;
use calibrig_model::statistics::{NORMAL_95, student_t_quantile};
use calibrig_model::{ParameterId, Unit};

/// Level of the intervals of means, and of the intervals whose coverage is counted.
const LEVEL: f64 = 0.95;
/// Level of the bands that NEES and coverage are held against: one in a thousand sound campaigns is outside.
const BAND: f64 = 0.999;

/// A mean over trials with its 95 % confidence interval, and how single trials are scattered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanWithInterval {
    /// Over the trials.
    pub mean: f64,
    /// Half the width of the mean's interval (Student's t); `None` from one trial.
    pub half_width: Option<f64>,
    /// The 5 %, 50 % and 95 % quantiles of single trials.
    pub quantiles: [f64; 3],
}

impl MeanWithInterval {
    /// Of `values`; `None` without any.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len();
        if n == 0 {
            return None;
        }
        let mean = values.iter().sum::<f64>() / n as f64;
        let half_width = (n > 1).then(|| {
            let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
            student_t_quantile(0.5 + 0.5 * LEVEL, (n - 1) as f64) * (variance / n as f64).sqrt()
        });
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        Some(Self { mean, half_width, quantiles: [0.05, 0.5, 0.95].map(|p| quantile(&sorted, p)) })
    }
}

/// Linear between the order statistics.
fn quantile(sorted: &[f64], p: f64) -> f64 {
    let place = p * (sorted.len() - 1) as f64;
    // A place in a slice is not negative and far below 2^52.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let below = place.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
}

/// Accuracy of a mode on a set over the trials, m.
#[derive(Debug, Clone, PartialEq)]
pub struct SetSummary {
    /// Which set.
    pub kind: SetKind,
    /// Largest absolute error per axis.
    pub max: [MeanWithInterval; 3],
    /// Mean absolute error per axis.
    pub mean: [MeanWithInterval; 3],
    /// RMS of the 3-D error.
    pub rms_3d: MeanWithInterval,
}

/// A parameter over the trials whose truth and standard deviation are known, SI.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterSummary {
    /// Which.
    pub id: ParameterId,
    /// Mean of estimate minus truth.
    pub bias: f64,
    /// Root mean square of estimate minus truth.
    pub rmse: f64,
    /// Root of the mean stated variance.
    pub stated: f64,
    /// Root of the mean Cramér-Rao bound at the truth of every trial: no unbiased estimator that knows the measurements alone has a smaller RMSE.
    /// One with priors may have. `None` where the truth of a parameter is not known, or the measurements alone do not determine all.
    pub cramer_rao: Option<f64>,
    /// The Bayesian Cramér-Rao bound, root of its mean over the trials, whose poses every estimator knows: none has a smaller RMSE over machines that
    /// are drawn from the priors. `None` where no machines are drawn, no parameter has a prior, or the truth of one is not known.
    pub bayesian: Option<f64>,
    /// How often the stated 95 % interval held the truth.
    pub coverage: Coverage,
}

impl ParameterSummary {
    /// RMSE over what is stated: about 1 where the stated uncertainty is the real one.
    pub fn consistency(&self) -> f64 {
        self.rmse / self.stated
    }

    /// The bound that holds for this estimator: the Bayesian one, or, where there are no priors, that of the measurements alone.
    pub fn least(&self) -> Option<f64> {
        self.bayesian.or(self.cramer_rao)
    }
}

/// A mode over the trials.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeSummary {
    /// Which.
    pub mode: Mode,
    /// Accuracy, set by set.
    pub sets: Vec<SetSummary>,
    /// Trials that were identified but not soundly: not converged, or rank-deficient.
    pub doubtful: usize,
    /// Of the solver.
    pub iterations: Option<MeanWithInterval>,
    /// About 1 where the model and the stated noise are right.
    pub chi2_per_dof: Option<MeanWithInterval>,
    /// NEES over its number of parameters, where every truth is known: about 1 for an honest covariance.
    pub nees: Option<NeesSummary>,
    /// Squared error over the bound, a parameter, where every truth is known: in the mean at least 1 for machines that are drawn from the priors
    /// and are what the model says, and 1 for the best estimator.
    pub squared_over_bound: Option<MeanWithInterval>,
    /// Parameter by parameter.
    pub parameters: Vec<ParameterSummary>,
    /// How often the stated 95 % interval of a predicted coordinate held the true one.
    pub predictions: Option<PredictionCoverage>,
}

/// How often stated intervals of predicted coordinates held the true ones. Coordinates of one trial depend on the same estimate, so that
/// trials are what counts: its uncertainty comes from the scatter between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictionCoverage {
    /// Over all coordinates of all trials.
    pub coverage: Coverage,
    /// Half the width of the 99.9 % interval of its fraction (Student's t over the trials); `None` from one trial.
    pub half_width: Option<f64>,
}

impl PredictionCoverage {
    /// From (hits, intervals) of every trial; `None` without any interval. The variance is that of a ratio of means.
    fn of(trials: &[(u64, u64)]) -> Option<Self> {
        let mut coverage = Coverage::default();
        for (hits, all) in trials {
            coverage.hits += hits;
            coverage.trials += all;
        }
        if coverage.trials == 0 {
            return None;
        }
        let (n, fraction) = (trials.len() as f64, coverage.fraction());
        let half_width = (trials.len() > 1).then(|| {
            let off = |(hits, all): &(u64, u64)| (*hits as f64 - fraction * *all as f64).powi(2);
            let variance =
                trials.iter().map(off).sum::<f64>() * n / (n - 1.0) / (coverage.trials as f64).powi(2);
            student_t_quantile(0.5 + 0.5 * BAND, n - 1.0) * variance.sqrt()
        });
        Some(Self { coverage, half_width })
    }
}

/// The mean normalised estimation error squared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeesSummary {
    /// Over the trials.
    pub mean: f64,
    /// Its expectation.
    pub parameters: usize,
    /// Trials that it is known of.
    pub trials: usize,
    /// What 99.9 % of sound campaigns lie in.
    pub band: (f64, f64),
}

/// What a campaign says.
#[derive(Debug, Clone, PartialEq)]
pub struct CampaignSummary {
    /// Trials carried out.
    pub trials: usize,
    /// Failed ones: index and reason.
    pub failures: Vec<(u32, String)>,
    /// One a mode of the scenario.
    pub modes: Vec<ModeSummary>,
}

/// Sums up trials, which are in the order of their indices.
pub fn summarise(campaign: &Campaign<'_>, trials: &[Trial]) -> CampaignSummary {
    let failures = trials
        .iter()
        .filter_map(|t| t.outcome.as_ref().err().map(|reason| (t.index, reason.clone())))
        .collect();
    let modes = campaign
        .scenario
        .modes
        .iter()
        .map(|mode| {
            let results: Vec<&ModeResult> = trials
                .iter()
                .filter_map(|t| t.outcome.as_ref().ok()?.modes.iter().find(|m| m.mode == *mode))
                .collect();
            summarise_mode(*mode, campaign.scenario.drawn.is_some(), &results)
        })
        .collect();
    CampaignSummary { trials: trials.len(), failures, modes }
}

fn summarise_mode(mode: Mode, is_drawn: bool, results: &[&ModeResult]) -> ModeSummary {
    let fits: Vec<&Fit> = results.iter().filter_map(|r| r.fit.as_ref()).collect();
    let predictions: Vec<(u64, u64)> = fits.iter().map(|f| f.predictions).collect();
    let iterations: Vec<f64> = fits.iter().map(|f| f.iterations as f64).collect();
    let chi2: Vec<f64> = fits.iter().filter_map(|f| f.chi2_per_dof).collect();
    let share = |f: &&Fit| Some(f.squared_over_bound? / f.parameters.len() as f64);
    let squared: Vec<f64> = fits.iter().filter_map(share).collect();
    ModeSummary {
        mode,
        sets: SetKind::ALL.into_iter().filter_map(|kind| summarise_set(kind, results)).collect(),
        doubtful: fits.iter().filter(|f| !f.sound).count(),
        iterations: MeanWithInterval::of(&iterations),
        chi2_per_dof: MeanWithInterval::of(&chi2),
        nees: summarise_nees(&fits),
        squared_over_bound: MeanWithInterval::of(&squared),
        parameters: summarise_parameters(&fits, is_drawn),
        predictions: PredictionCoverage::of(&predictions),
    }
}

fn summarise_set(kind: SetKind, results: &[&ModeResult]) -> Option<SetSummary> {
    let rows: Vec<_> =
        results.iter().filter_map(|r| r.rows.iter().find(|(k, _)| *k == kind).map(|(_, row)| row)).collect();
    let over = |value: &dyn Fn(usize) -> f64| {
        MeanWithInterval::of(&(0..rows.len()).map(value).collect::<Vec<f64>>())
    };
    let axes = |value: &dyn Fn(usize, usize) -> f64| {
        Some([over(&|i| value(i, 0))?, over(&|i| value(i, 1))?, over(&|i| value(i, 2))?])
    };
    Some(SetSummary {
        kind,
        max: axes(&|i, axis| rows[i].max[axis])?,
        mean: axes(&|i, axis| rows[i].mean[axis])?,
        rms_3d: over(&|i| rows[i].rms_3d)?,
    })
}

fn summarise_nees(fits: &[&Fit]) -> Option<NeesSummary> {
    let known: Vec<_> = fits.iter().filter_map(|f| Some((f.nees?, f.parameters.len()))).collect();
    let parameters = known.first()?.1;
    let trials = known.len();
    Some(NeesSummary {
        mean: known.iter().map(|(nees, _)| nees).sum::<f64>() / trials as f64,
        parameters,
        trials,
        band: mean_nees_band(trials, parameters, BAND),
    })
}

fn summarise_parameters(fits: &[&Fit], is_drawn: bool) -> Vec<ParameterSummary> {
    let mut ids: Vec<ParameterId> = Vec::new();
    for parameter in fits.iter().flat_map(|f| &f.parameters) {
        if !ids.contains(&parameter.id) {
            ids.push(parameter.id);
        }
    }
    ids.into_iter()
        .filter_map(|id| {
            let results: Vec<_> =
                fits.iter().filter_map(|f| f.parameters.iter().find(|p| p.id == id)).copied().collect();
            summarise_parameter(id, is_drawn, &results)
        })
        .collect()
}

/// Of one parameter, from the trials in which its truth and a standard deviation are known; `None` without any. With
/// the Bayesian bound where the machines are drawn.
fn summarise_parameter(
    id: ParameterId,
    is_drawn: bool,
    results: &[ParameterResult],
) -> Option<ParameterSummary> {
    let known: Vec<_> = results.iter().filter(|p| p.truth.is_some() && p.sigma.is_some()).collect();
    let errors: Vec<(f64, f64)> = known.iter().filter_map(|p| Some((p.value - p.truth?, p.sigma?))).collect();
    if errors.is_empty() {
        return None;
    }
    let n = errors.len() as f64;
    let root_mean = |bound: fn(&ParameterResult) -> Option<f64>| {
        let variances: Option<Vec<f64>> = known.iter().map(|p| bound(p).map(|sigma| sigma * sigma)).collect();
        variances.map(|variances| (variances.iter().sum::<f64>() / n).sqrt())
    };
    let mut coverage = Coverage::default();
    for (error, sigma) in &errors {
        coverage.count(error.abs() <= NORMAL_95 * sigma);
    }
    Some(ParameterSummary {
        id,
        bias: errors.iter().map(|(error, _)| error).sum::<f64>() / n,
        rmse: (errors.iter().map(|(error, _)| error * error).sum::<f64>() / n).sqrt(),
        stated: (errors.iter().map(|(_, sigma)| sigma * sigma).sum::<f64>() / n).sqrt(),
        cramer_rao: root_mean(|p| p.cramer_rao),
        bayesian: root_mean(|p| p.bayesian).filter(|_| is_drawn),
        coverage,
    })
}

/// The summary as a JSON document, schema `calibrig.campaign/1`.
pub fn summary_json(campaign: &Campaign<'_>, summary: &CampaignSummary) -> Value {
    json!({
        "schema": "calibrig.campaign/1",
        "software": { "version": env!("CARGO_PKG_VERSION") },
        "scenario": campaign.scenario.name,
        "sha256": crate::pipeline::hash_sources(&campaign.scenario.sources),
        "seed": campaign.seed,
        "plant": campaign.plant.key(),
        "trials": summary.trials,
        "failures": summary.failures.iter().map(|(trial, reason)| json!({ "trial": trial, "reason": reason })).collect::<Vec<_>>(),
        "modes": summary.modes.iter().map(mode_json).collect::<Vec<_>>(),
    })
}

fn mean_json(mean: &MeanWithInterval) -> Value {
    json!({ "mean": mean.mean, "half_width_95": mean.half_width, "quantiles_5_50_95": mean.quantiles })
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
        "interval_99_9": predictions.half_width.map(|half| [fraction - half, fraction + half]),
    })
}

fn mode_json(mode: &ModeSummary) -> Value {
    let sets: serde_json::Map<String, Value> = mode
        .sets
        .iter()
        .map(|set| {
            let axes = |axes: &[MeanWithInterval; 3]| axes.iter().map(mean_json).collect::<Vec<_>>();
            let value = json!({ "max_m": axes(&set.max), "mean_m": axes(&set.mean), "rms_3d_m": mean_json(&set.rms_3d) });
            (set.kind.key().to_owned(), value)
        })
        .collect();
    let parameters: Vec<Value> = mode
        .parameters
        .iter()
        .map(|p| {
            json!({
                "name": p.id.to_string(), "unit": p.id.unit().to_string(), "bias": p.bias, "rmse": p.rmse,
                "stated_sigma": p.stated, "consistency": p.consistency(),
                "cramer_rao_bound": p.cramer_rao, "rmse_over_cramer_rao_bound": p.cramer_rao.map(|bound| p.rmse / bound),
                "bayesian_cramer_rao_bound": p.bayesian,
                "rmse_over_bayesian_cramer_rao_bound": p.bayesian.map(|bound| p.rmse / bound),
                "coverage": coverage_json(p.coverage),
            })
        })
        .collect();
    json!({
        "mode": mode.mode.key(),
        "sets": sets,
        "doubtful": mode.doubtful,
        "iterations": mode.iterations.as_ref().map(mean_json),
        "chi2_per_dof": mode.chi2_per_dof.as_ref().map(mean_json),
        "nees": mode.nees.map(|n| json!({ "mean": n.mean, "parameters": n.parameters, "trials": n.trials, "band_99_9": [n.band.0, n.band.1] })),
        "squared_over_bound": mode.squared_over_bound.as_ref().map(mean_json),
        "parameters": parameters,
        "prediction_coverage": mode.predictions.as_ref().map(predictions_json),
    })
}

/// The summary for people: accuracy with its intervals, consistency, and parameter by parameter.
pub fn summary_text(campaign: &Campaign<'_>, summary: &CampaignSummary) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "campaign of {} trials of \"{}\", seed {}, plant: {}",
        summary.trials,
        campaign.scenario.name,
        campaign.seed,
        campaign.plant.key()
    );
    failures_text(&mut text, summary);
    for kind in SetKind::ALL {
        accuracy_text(&mut text, kind, summary);
    }
    consistency_text(&mut text, summary);
    for mode in summary.modes.iter().filter(|m| !m.parameters.is_empty()) {
        parameters_text(&mut text, mode);
    }
    text
}

fn failures_text(text: &mut String, summary: &CampaignSummary) {
    const SHOWN: usize = 5;
    if summary.failures.is_empty() {
        return;
    }
    let _ = writeln!(text, "{} failed:", summary.failures.len());
    for (trial, reason) in summary.failures.iter().take(SHOWN) {
        let _ = writeln!(text, "  trial {trial}: {reason}");
    }
    if summary.failures.len() > SHOWN {
        let _ = writeln!(text, "  and {} more: see trials.csv", summary.failures.len() - SHOWN);
    }
}

fn accuracy_text(text: &mut String, kind: SetKind, summary: &CampaignSummary) {
    let rows: Vec<_> = summary
        .modes
        .iter()
        .filter_map(|m| m.sets.iter().find(|s| s.kind == kind).map(|set| (m.mode, set)))
        .collect();
    if rows.is_empty() {
        return;
    }
    let _ = writeln!(
        text,
        "\n{} set, mm: mean over the trials ± half of its 95 % interval\n{:<32} {:>15} {:>15} {:>15} {:>15}  5 % .. 95 % of trials",
        kind.key(),
        "",
        "mean |x|",
        "mean |y|",
        "mean |z|",
        "RMS 3-D"
    );
    for (mode, set) in rows {
        let cell = |m: &MeanWithInterval| match m.half_width {
            Some(half) => format!("{:.3} ± {:.3}", 1e3 * m.mean, 1e3 * half),
            None => format!("{:.3}", 1e3 * m.mean),
        };
        let _ = writeln!(
            text,
            "{:<32} {:>15} {:>15} {:>15} {:>15}  {:.3} .. {:.3}",
            mode.title(),
            cell(&set.mean[0]),
            cell(&set.mean[1]),
            cell(&set.mean[2]),
            cell(&set.rms_3d),
            1e3 * set.rms_3d.quantiles[0],
            1e3 * set.rms_3d.quantiles[2]
        );
    }
}

fn consistency_text(text: &mut String, summary: &CampaignSummary) {
    for mode in &summary.modes {
        let Some(chi2) = &mode.chi2_per_dof else { continue };
        let _ = write!(text, "\n{}: chi-square per degree of freedom {:.3}", mode.mode.title(), chi2.mean);
        if let Some(nees) = mode.nees {
            let n = nees.parameters as f64;
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
            let _ =
                write!(text, "; squared error over the bound at the truth {:.4} a parameter", squared.mean);
        }
        if let Some(predictions) = mode.predictions {
            let share = 100.0 * predictions.coverage.fraction();
            let _ = write!(text, "; {share:.2} %");
            if let Some(half) = predictions.half_width {
                let _ = write!(text, " ± {:.2}", 100.0 * half);
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
        "\n{}: parameters; consistency is RMSE over stated standard deviation, bound the {}\n{:<24} {:>6} {:>12} {:>12} {:>12} {:>11} {:>12} {:>10} {:>10}",
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
        "in 95 %"
    );
    for p in &mode.parameters {
        let (unit, scale) = match p.id.unit() {
            Unit::Metre => ("mm", 1e3),
            Unit::Radian => ("mrad", 1e3),
            Unit::One => ("%", 1e2),
        };
        let _ = writeln!(
            text,
            "{:<24} {unit:>6} {:>12.5} {:>12.5} {:>12.5} {:>11.3} {:>12} {:>10} {:>8.1} %",
            p.id.to_string(),
            scale * p.bias,
            scale * p.rmse,
            scale * p.stated,
            p.consistency(),
            p.least().map_or_else(|| "-".to_owned(), |bound| format!("{:.5}", scale * bound)),
            p.least().map_or_else(|| "-".to_owned(), |bound| format!("{:.3}", p.rmse / bound)),
            100.0 * p.coverage.fraction()
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_with_its_interval_by_hand() {
        let m = MeanWithInterval::of(&[1.0, 2.0, 3.0, 4.0, 5.0]).expect("five values");
        assert_eq!(m.mean, 3.0);
        // t(0.975, 4) = 2.776445, s = sqrt(2.5).
        assert!((m.half_width.expect("five") - 2.776_445 * (2.5_f64 / 5.0).sqrt()).abs() < 1e-5);
        assert_eq!(m.quantiles, [1.2, 3.0, 4.8]);
        assert_eq!(MeanWithInterval::of(&[7.0]).expect("one").half_width, None);
        assert_eq!(MeanWithInterval::of(&[]), None);
    }

    #[test]
    fn coverage_of_predictions_by_hand() {
        let two = PredictionCoverage::of(&[(10, 10), (8, 10)]).expect("two trials");
        assert_eq!(two.coverage, Coverage { hits: 18, trials: 20 });
        // Fractions 1 and 0.8: their mean has the standard error 0.1, and t(0.9995, 1) = 636.619.
        assert!((two.half_width.expect("two") - 63.661_9).abs() < 1e-3);
        assert_eq!(PredictionCoverage::of(&[(3, 3)]).expect("one").half_width, None);
        assert_eq!(PredictionCoverage::of(&[(0, 0)]), None);
    }

    #[test]
    fn a_parameter_by_hand() {
        let id = ParameterId::Mass { link: 0 };
        let result = |value, sigma, least| ParameterResult {
            id,
            truth: Some(1.0),
            value,
            sigma,
            cramer_rao: Some(least),
            bayesian: Some(0.1),
        };
        let unknown = ParameterResult { truth: None, ..result(9.0, Some(1.0), 9.0) };
        let results =
            [result(4.0, Some(1.0), 0.6), result(0.0, Some(1.0), 0.8), result(9.0, None, 9.0), unknown];
        let p = summarise_parameter(id, false, &results).expect("two errors");
        assert_eq!((p.bias, p.rmse, p.stated), (1.0, 5.0_f64.sqrt(), 1.0));
        assert_eq!((p.consistency(), p.bayesian), (5.0_f64.sqrt(), None));
        assert!((p.least().expect("a bound") - 0.5_f64.sqrt()).abs() < 1e-15);
        let drawn = summarise_parameter(id, true, &results).expect("two errors");
        assert!((drawn.least().expect("a bound") - 0.1).abs() < 1e-15);
        assert_eq!(p.coverage, Coverage { hits: 1, trials: 2 });
    }
}
