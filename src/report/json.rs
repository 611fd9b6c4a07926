//! `report.json`, schema `calibrig.report/1`. It only grows: keys are added, never renamed, removed or given another meaning.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::acceptance_bounds::by_pose;
use super::closed_loop;
use super::closed_loop::JsonCompensation;
use super::document::{JsonDropped, JsonInput, JsonSoftware, axes, finite};
use super::drift::{JsonDrift, json_drift};
use super::judgement::JsonOutlier;
use super::judgement::{JsonJudgement, json_judgement};
use super::parameters::fitted;
use super::parameters::truth_of;
use super::residuals::{JsonResidual, json_residuals};
use super::sensors::{JsonSensors, json_sensors};
use super::sets::json_row;
use super::sets::{JsonMissing, JsonOrientationRow, JsonRepeats, JsonRow, JsonSet};
use super::splits::{JsonSplits, json_splits};
use super::sweeps::{JsonSweeps, json_sweeps};
use super::words::pose_count;
use crate::pipeline::{
    AblatedPart, Ablation, CarriedReport, MissingReading, Outcome, SetKind, SetOutcome, Worse,
};
use calibrig_estimation::evaluation::AccuracyRow;
use calibrig_estimation::identification::{Estimate, Mode, NoiseScale, Warning};

/// The schema's name.
pub const SCHEMA: &str = "calibrig.report/1";

/// The whole document. Numbers that are not finite are `null`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonReport {
    /// [`SCHEMA`].
    pub schema: String,
    /// What wrote it.
    pub software: JsonSoftware,
    /// Where the measurements came from.
    pub input: JsonInput,
    /// How the row "without calibration" was registered.
    pub registration: JsonRegistration,
    /// By the key of the set.
    pub sets: BTreeMap<String, JsonSet>,
    /// By the key of the mode; the modes that were fitted.
    pub estimates: BTreeMap<String, JsonEstimate>,
    /// One entry a mode and parameter.
    pub parameters: Vec<JsonParameter>,
    /// What the parts of a simulated machine contribute; absent unless asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ablation: Option<JsonAblation>,
    /// The modes on random splits of the identification set; absent unless asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub splits: Option<JsonSplits>,
    /// What rounds of nests say of the trackers' own motion; absent where no nest was measured more than once.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub drift: Vec<JsonDrift>,
    /// What sweeps of single axes show; absent where no station read any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sweeps: Vec<JsonSweeps>,
    /// What corrected commands did on the machine; its table is the set `compensated`. Absent where none were driven.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compensation: Option<JsonCompensation>,
    /// What one point, three points and full poses tell at the same poses; absent where nothing can be compared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensors: Option<JsonSensors>,
}

/// What the parts of a simulated machine contribute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonAblation {
    /// One entry a part.
    pub parts: Vec<JsonAblated>,
}

/// A run without one part of the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonAblated {
    /// Of the part.
    pub key: String,
    /// Its name for people.
    pub title: String,
    /// What removing it means.
    pub removal: String,
    /// Why there are no rows, else null.
    pub failure: Option<String>,
    /// Keys of the modes whose estimate did not converge or lacks rank.
    pub doubtful: Vec<String>,
    /// By the key of the set, then of the mode.
    pub rows: BTreeMap<String, BTreeMap<String, JsonAblationRow>>,
}

/// A row without a part, and its change against the complete machine's, m. A negative change is what the part contributed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonAblationRow {
    /// Mean absolute error per axis.
    pub mean_m: [Option<f64>; 3],
    /// RMS of the 3-D error.
    pub rms_3d_m: Option<f64>,
    /// Change of the mean.
    pub mean_change_m: [Option<f64>; 3],
    /// Change of the RMS.
    pub rms_3d_change_m: Option<f64>,
}

/// How the tracker's frame was tied to the robot's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonRegistration {
    /// In words.
    pub how: String,
    /// Poses used.
    pub poses: usize,
    /// RMS of the 3-D residual, m.
    pub rms_m: Option<f64>,
}

/// A parameter that was left out of a fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonLeftOut {
    /// Which.
    pub name: String,
    /// `unloaded`, `no_basis` or `redundant`.
    pub reason: String,
    /// The same in words.
    pub words: String,
}

/// Parameters that are better left alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonWorse {
    /// Which.
    pub names: Vec<String>,
    /// By how much the RMS of held-out poses is smaller with them identified, m: below zero.
    pub gain_m: f64,
    /// Its interval, m.
    pub gain_interval_m: [f64; 2],
    /// Whether all of the interval is of consequence: then the result is doubtful.
    pub doubtful: bool,
}

/// How an identification ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonEstimate {
    /// `ok`, or the key of the first reason to look at it.
    pub status: String,
    /// Why the solver stopped.
    pub termination: String,
    /// Iterations, rejected steps included.
    pub iterations: usize,
    /// Numerical rank.
    pub rank: usize,
    /// Number of parameters.
    pub parameter_count: usize,
    /// Chi-square per degree of freedom; null without degrees of freedom, and where the readings state no noise.
    pub chi2_per_dof: Option<f64>,
    /// Condition number of the scaled system; null where infinite.
    pub condition: Option<f64>,
    /// Standard deviation of one coordinate from the residuals, m; absent where the readings state their noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_sigma_m: Option<f64>,
    /// Effective degrees of freedom of the residuals.
    #[serde(default)]
    pub degrees_of_freedom: Option<f64>,
    /// What the machine was found to do beside the model; absent where that was not estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub machine_noise: Option<JsonMachineNoise>,
    /// Noise of the readings by themselves that was found, over what they state; absent where it was not looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reading_scale: Option<f64>,
    /// Standard deviation that was found of orientations beside what their readings state, rad; absent where none was looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation_sigma_rad: Option<f64>,
    /// Half the width of a 95 % interval, in standard deviations; null where no degree of freedom is left to estimate the noise.
    #[serde(default)]
    pub interval_factor_95: Option<f64>,
    /// What a user must know, in words.
    pub warnings: Vec<String>,
    /// Those of the warnings that a person must look at: with any, exit code 3; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reasons: Vec<String>,
    /// Parameters that the measurements alone cannot tell from others and that rest on their priors, in words; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held: Vec<String>,
    /// Parameters that were left out of the fit for the same reason, in words; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fixed: Vec<String>,
    /// All parameters that could have been fitted and were left out, with the reason; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<JsonLeftOut>,
    /// Compliances and terms whose identification makes poses that were not fitted worse; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub worse: Vec<JsonWorse>,
    /// Stated bounds of its parameters; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bounds: Vec<JsonBound>,
    /// What was stated beforehand and does not fit the measurements; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contradicted: Vec<JsonContradiction>,
    /// Gross errors: observations far off what the others say of them; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outliers: Vec<JsonOutlier>,
    /// Residuals of its readings, by the key of the set; absent where it was not judged.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub residuals: BTreeMap<String, Vec<JsonResidual>>,
    /// What speaks for and against it; absent where it was not judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judgement: Option<JsonJudgement>,
}

/// Errors of single poses beside the model, standard deviations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonMachineNoise {
    /// Displacement of the flange, along each axis.
    pub position_m: Option<f64>,
    /// Of every actuator, m or rad.
    pub actuators: Vec<Option<f64>>,
    /// Degrees of freedom of the estimate.
    pub degrees_of_freedom: Option<f64>,
}

/// Limits of a parameter, in the unit of `unit`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonBound {
    /// As in every file.
    pub name: String,
    /// `m`, `rad` or `1`.
    pub unit: String,
    /// Lowest value; null where that end is open.
    pub min: Option<f64>,
    /// Highest value; null where that end is open.
    pub max: Option<f64>,
}

/// Something stated beforehand that does not fit the measurements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonContradiction {
    /// The parameter, nests, target or nest.
    pub name: String,
    /// What was stated, and where the measurements put it.
    pub words: String,
    /// Square of the discrepancy in its own standard deviations.
    pub chi2: Option<f64>,
    /// Its number of coordinates.
    pub coordinates: usize,
}

/// A parameter of a mode, in the unit of `unit`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonParameter {
    /// As in every file.
    pub name: String,
    /// `m`, `rad` or `1`.
    pub unit: String,
    /// Key of the mode.
    pub mode: String,
    /// What it really is; null where not known.
    pub truth: Option<f64>,
    /// The estimate.
    pub estimate: Option<f64>,
    /// Standard deviation; null from a singular system, and of a parameter at its bound.
    pub sigma: Option<f64>,
    /// The one that the readings' stated noise leaves by itself; absent where the fit was not weighed with more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stated_sigma: Option<f64>,
    /// Standard deviation of its own zero-mean prior; absent where it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prior_sigma: Option<f64>,
    /// The Cramér-Rao bound at the truth: no unbiased estimator that knows the measurements alone has a smaller standard deviation. Absent where
    /// a truth is not known, or the measurements alone do not determine all parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cramer_rao_bound: Option<f64>,
    /// The Bayesian Cramér-Rao bound, with the information at the truth and the priors: no estimator has a smaller root mean squared error, if
    /// the truth is drawn from the priors. Absent where a truth is not known, or no parameter has a prior.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bayesian_cramer_rao_bound: Option<f64>,
}

/// The document of a run.
pub fn json_report(outcome: &Outcome) -> JsonReport {
    let fitted = fitted(outcome);
    JsonReport {
        schema: SCHEMA.to_owned(),
        software: JsonSoftware::own(),
        input: JsonInput::from(&outcome.input),
        registration: JsonRegistration {
            how: outcome.registration.how.clone(),
            poses: outcome.registration.poses,
            rms_m: finite(outcome.registration.rms),
        },
        sets: outcome
            .sets
            .iter()
            .enumerate()
            .map(|(index, set)| (set.kind.key().to_owned(), json_set(outcome, index, set)))
            .chain(
                outcome
                    .closed_loop
                    .iter()
                    .map(|driven| ("compensated".to_owned(), closed_loop::json_set(driven))),
            )
            .collect(),
        estimates: fitted
            .iter()
            .map(|(mode, estimate)| {
                let judgement = outcome.judgements.iter().find(|judgement| judgement.mode == *mode);
                let worse = judgement.iter().flat_map(|judgement| &judgement.worse).map(json_worse).collect();
                let residuals =
                    judgement.map(|judgement| json_residuals(outcome, judgement)).unwrap_or_default();
                let own = json_estimate(estimate);
                let more: Vec<_> = judgement.iter().flat_map(|judgement| judgement.reasons()).collect();
                let status = match more.first() {
                    Some((key, _)) if own.reasons.is_empty() => (*key).to_owned(),
                    _ => own.status.clone(),
                };
                let reasons = own.reasons.iter().cloned().chain(more.into_iter().map(|(_, words)| words));
                let reasons = reasons.collect();
                let judgement = judgement.map(|judgement| json_judgement(outcome, judgement));
                let estimate = JsonEstimate { status, reasons, worse, residuals, judgement, ..own };
                (mode.key().to_owned(), estimate)
            })
            .collect(),
        parameters: fitted
            .iter()
            .flat_map(|(mode, estimate)| {
                let bounds = outcome.bounds.iter().find(|bounds| bounds.mode == *mode);
                estimate.parameters.iter().enumerate().map(move |(place, p)| JsonParameter {
                    name: p.id.to_string(),
                    unit: p.id.unit().to_string(),
                    mode: mode.key().to_owned(),
                    truth: truth_of(outcome, estimate, p.id),
                    estimate: finite(p.value),
                    sigma: p.sigma.and_then(finite),
                    stated_sigma: p.stated_sigma.and_then(finite),
                    prior_sigma: p.prior_sigma,
                    cramer_rao_bound: bounds.and_then(|b| b.cramer_rao.as_ref()?.get(place).copied()),
                    bayesian_cramer_rao_bound: bounds.and_then(|b| b.bayesian.as_ref()?.get(place).copied()),
                })
            })
            .collect(),
        ablation: outcome.ablation.as_ref().map(json_ablation),
        splits: outcome.splits.as_ref().map(json_splits),
        drift: json_drift(outcome),
        sweeps: json_sweeps(outcome),
        compensation: outcome.closed_loop.as_ref().map(closed_loop::json_compensation),
        sensors: outcome.sensors.as_ref().map(json_sensors),
    }
}

fn json_worse(worse: &Worse) -> JsonWorse {
    JsonWorse {
        names: worse.parameters.iter().map(ToString::to_string).collect(),
        gain_m: worse.gain.value,
        gain_interval_m: [worse.gain.low, worse.gain.high],
        doubtful: worse.is_doubtful,
    }
}

fn json_ablation(ablation: &Ablation) -> JsonAblation {
    let rows = |part: &AblatedPart, set: usize| {
        let row = |(place, mode): (usize, &Mode)| {
            let (without, complete) = ablation.pair(part, place, set)?;
            let row = JsonAblationRow {
                mean_m: axes(without.mean),
                rms_3d_m: finite(without.rms_3d),
                mean_change_m: axes(without.mean - complete.mean),
                rms_3d_change_m: finite(without.rms_3d - complete.rms_3d),
            };
            Some((mode.key().to_owned(), row))
        };
        ablation.modes.iter().enumerate().filter_map(row).collect()
    };
    let part = |part: &AblatedPart| JsonAblated {
        key: part.part.key().to_owned(),
        title: part.part.title().to_owned(),
        removal: part.part.removal().to_owned(),
        failure: part.rows.as_ref().err().cloned(),
        doubtful: part.doubtful.iter().map(|mode| mode.key().to_owned()).collect(),
        rows: ablation
            .sets
            .iter()
            .enumerate()
            .map(|(i, set)| (set.key().to_owned(), rows(part, i)))
            .collect(),
    };
    JsonAblation { parts: ablation.parts.iter().map(part).collect() }
}

fn missing(outcome: &Outcome, index: usize, set: &SetOutcome) -> Vec<JsonMissing> {
    let of = |missing: &MissingReading| JsonMissing {
        pose: missing.pose,
        station: set.measurements.stations.get(missing.station).map(|s| s.name.clone()).unwrap_or_default(),
        target: set.measurements.targets.get(missing.target).map(|t| t.name.clone()).unwrap_or_default(),
        why: missing.why.clone(),
    };
    outcome.missing.get(index).into_iter().flatten().map(of).collect()
}

fn payloads(set: &SetOutcome) -> Vec<CarriedReport> {
    let carried = set.measurements.payloads().into_iter();
    carried.map(|(payload, poses)| CarriedReport::of(payload, poses)).collect()
}

fn json_set(outcome: &Outcome, index: usize, set: &SetOutcome) -> JsonSet {
    let row = |rows: &[Option<AccuracyRow>]| rows.get(index).copied().flatten();
    JsonSet {
        poses: pose_count(set),
        dropped: set
            .dropped
            .iter()
            .map(|(pose, why)| JsonDropped { pose: *pose, why: why.clone() })
            .collect(),
        missing: missing(outcome, index, set),
        payloads: payloads(set),
        repeats: set.measurements.repeats().map(|repeats| JsonRepeats {
            poses: repeats.poses,
            repeats: repeats.repeats,
            rms_3d_m: finite(repeats.rms_3d),
        }),
        rows: outcome
            .modes
            .iter()
            .filter_map(|m| {
                let orientation = m.orientation_row(index).map(|row| JsonOrientationRow {
                    rms_rad: finite(row.rms),
                    max_rad: finite(row.max),
                    n: row.count,
                });
                let readings = set.measurements.observations.iter().map(|own| own.pose);
                let held_out = m.errors.get(index).filter(|_| set.kind == SetKind::Verification);
                let held_out = held_out.map(|errors| by_pose(readings.zip(errors)));
                let row = JsonRow { orientation, ..json_row(&row(&m.rows)?, held_out.as_deref()) };
                Some((m.mode.key().to_owned(), row))
            })
            .collect(),
    }
}

fn json_estimate(estimate: &Estimate) -> JsonEstimate {
    let status = estimate.reasons().find_map(Warning::reason).unwrap_or("ok");
    let (chi2_per_dof, residual_sigma) = match estimate.noise {
        NoiseScale::Stated => (estimate.chi2_per_dof().and_then(finite), None),
        NoiseScale::Residuals(sigma) => (None, finite(sigma)),
    };
    JsonEstimate {
        status: status.to_owned(),
        termination: estimate.termination.key().to_owned(),
        iterations: estimate.iterations.len(),
        rank: estimate.spectrum.rank,
        parameter_count: estimate.parameters.len(),
        chi2_per_dof,
        condition: finite(estimate.spectrum.condition),
        residual_sigma_m: residual_sigma,
        degrees_of_freedom: finite(estimate.degrees_of_freedom),
        machine_noise: estimate.found_machine().map(|found| JsonMachineNoise {
            position_m: finite(found.position),
            actuators: found.actuators.iter().copied().map(finite).collect(),
            degrees_of_freedom: found.freedom.and_then(finite),
        }),
        reading_scale: estimate.reading_scale.and_then(finite),
        orientation_sigma_rad: estimate.turn_noise.and_then(finite),
        interval_factor_95: finite(estimate.interval_factor(0.95)),
        warnings: estimate.warnings.iter().map(ToString::to_string).collect(),
        held: estimate.held.iter().map(ToString::to_string).collect(),
        fixed: estimate.fixed.iter().map(ToString::to_string).collect(),
        left_out: estimate
            .left_out
            .iter()
            .map(|left| JsonLeftOut {
                name: left.id.to_string(),
                reason: left.reason.key().to_owned(),
                words: left.reason.to_string(),
            })
            .collect(),
        worse: Vec::new(),
        bounds: estimate
            .bounds
            .iter()
            .map(|bound| JsonBound {
                name: bound.id.to_string(),
                unit: bound.id.unit().to_string(),
                min: finite(bound.lower),
                max: finite(bound.upper),
            })
            .collect(),
        contradicted: estimate
            .contradicted
            .iter()
            .map(|contradiction| JsonContradiction {
                name: contradiction.stated.name(),
                words: contradiction.to_string(),
                chi2: finite(contradiction.chi2),
                coordinates: contradiction.freedom,
            })
            .collect(),
        outliers: estimate.outliers.iter().map(JsonOutlier::from).collect(),
        reasons: estimate.reasons().map(ToString::to_string).collect(),
        residuals: BTreeMap::new(),
        judgement: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::tests::sample;
    use serde_json::Value;

    fn document(outcome: &Outcome) -> Value {
        serde_json::to_value(json_report(outcome)).expect("JSON")
    }

    fn keys(value: &Value) -> Vec<&str> {
        let mut keys: Vec<_> = value.as_object().expect("an object").keys().map(String::as_str).collect();
        keys.sort_unstable();
        keys
    }

    #[test]
    fn the_keys_are_those_of_the_schema() {
        let json = document(&sample::simulated());
        assert_eq!(
            keys(&json),
            ["estimates", "input", "parameters", "registration", "schema", "sets", "software"]
        );
        assert_eq!(json["schema"], "calibrig.report/1");
        assert_eq!(keys(&json["software"]), ["version"]);
        assert_eq!(keys(&json["input"]), ["kind", "name", "seed", "sha256"]);
        assert_eq!(keys(&json["registration"]), ["how", "poses", "rms_m"]);
        assert_eq!(keys(&json["sets"]), ["identification", "verification"]);
        let set = &json["sets"]["verification"];
        assert_eq!(keys(set), ["dropped", "poses", "rows"]);
        assert_eq!(set["poses"], 38);
        assert_eq!(keys(&set["dropped"][0]), ["pose", "why"]);
        assert_eq!(keys(&set["rows"]), ["only_calibration", "with_gravity", "without_calibration"]);
        let row = &set["rows"]["with_gravity"];
        assert_eq!(keys(row), ["acceptance", "bias_m", "max_3d_m", "max_m", "mean_m", "n", "rms_3d_m"]);
        assert!(set["rows"]["with_gravity"]["acceptance"]["distribution_free_m"].is_null());
        let fitted = &json["sets"]["identification"]["rows"]["with_gravity"];
        assert_eq!(keys(fitted), ["bias_m", "max_3d_m", "max_m", "mean_m", "n", "rms_3d_m"]);
        assert_eq!(row["max_m"].as_array().expect("three axes").len(), 3);
        assert_eq!(row["n"], 38);
        assert_eq!(keys(&json["estimates"]), ["only_calibration", "with_gravity"]);
        assert_eq!(
            keys(&json["estimates"]["with_gravity"]),
            [
                "chi2_per_dof",
                "condition",
                "degrees_of_freedom",
                "interval_factor_95",
                "iterations",
                "parameter_count",
                "rank",
                "status",
                "termination",
                "warnings"
            ]
        );
        assert_eq!(json["estimates"]["with_gravity"]["status"], "ok");
        let parameters = json["parameters"].as_array().expect("a list");
        assert_eq!(parameters.len(), 2 * 33);
        for parameter in parameters {
            assert_eq!(keys(parameter), ["estimate", "mode", "name", "sigma", "truth", "unit"]);
        }
    }

    #[test]
    fn values_are_in_metres_and_radians_and_as_in_the_outcome() {
        let outcome = sample::simulated();
        let json = json_report(&outcome);
        let row = outcome.modes[2].rows[1].expect("a verification row");
        let written = &json.sets["verification"].rows["with_gravity"];
        assert_eq!(written.max_m, [row.max.x, row.max.y, row.max.z].map(Some));
        assert_eq!(written.rms_3d_m, Some(row.rms_3d));
        let theta4 = json.parameters.iter().find(|p| p.name == "delta_theta4").expect("delta_theta4");
        assert_eq!(theta4.unit, "rad");
        assert!((theta4.truth.expect("a simulated truth") + 0.0171).abs() < 1e-12);
    }

    #[test]
    fn rows_that_do_not_apply_are_absent_and_numbers_that_are_not_finite_are_null() {
        let outcome = sample::measured();
        let text = crate::report::json_text(&outcome).expect("JSON");
        for word in ["NaN", "inf", "Infinity"] {
            assert!(!text.contains(word), "{word} in {text}");
        }
        let json = document(&outcome);
        assert_eq!(keys(&json["sets"]), ["identification"]);
        assert_eq!(
            keys(&json["sets"]["identification"]["rows"]),
            ["only_calibration", "without_calibration"]
        );
        let estimate = &json["estimates"]["only_calibration"];
        assert_eq!(estimate["status"], "rank_deficient");
        assert!(estimate["condition"].is_null() && estimate["chi2_per_dof"].is_null());
        assert!(estimate["residual_sigma_m"].as_f64().expect("from the residuals") > 0.0);
        assert!(json["input"]["seed"].is_null());
        for parameter in json["parameters"].as_array().expect("a list") {
            assert!(parameter["truth"].is_null() && parameter["sigma"].is_null());
        }
        assert!(json["registration"]["rms_m"].is_null(), "the sample's RMS is NaN");
        let read: JsonReport = serde_json::from_str(&text).expect("what is written can be read back");
        assert_eq!(read.estimates["only_calibration"].condition, None);
    }
}
