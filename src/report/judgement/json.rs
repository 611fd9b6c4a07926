//! The judgement of an estimate in `report.json`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::quantiles;
use crate::pipeline::{Confidence, Judgement, Outcome, PredictedPosition};
use crate::report::document::{axes, finite};
use crate::report::scatter::{JsonScatter, json_scatters};
use calibrig_estimation::identification::Outlier;

/// What speaks for and against an estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonJudgement {
    /// Whether neither size nor shape of the residuals speaks against model and stated noise.
    pub consistent: bool,
    /// Probability of a false alarm of each test.
    pub level: f64,
    /// Probability of residuals as large as these, if the stated noise is right; null where none is stated.
    pub size_p_value: Option<f64>,
    /// What the residual depends on, strongest first.
    pub patterns: Vec<JsonPattern>,
    /// Correlation of the residuals of one observation and the next; null where not known.
    pub serial_correlation: Option<f64>,
    /// Gross errors in the sets that were held out, by set; absent where none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub held_out_outliers: BTreeMap<String, Vec<JsonOutlier>>,
    /// How sure; absent from a singular system.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confidence: Option<JsonConfidence>,
    /// What is stated of the readings' scatter against what is seen of it, by the key of the set.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub scatter: BTreeMap<String, JsonScatter>,
}

/// A dependence of the residual.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonPattern {
    /// `joint3`, `motor_turn3`, `approach3`, `payload`, `time`, `temperature`, `sequence` or `constant`; joints count from one.
    pub cause: String,
    /// In words.
    pub words: String,
    /// Natural logarithm of the p-value, corrected for the number of causes.
    pub ln_p: Option<f64>,
    /// Largest displacement, m.
    pub peak_m: Option<f64>,
    /// Share of the weighted sum of squares.
    pub share: Option<f64>,
}

/// How sure an estimate is, if the stated noise is right.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonConfidence {
    /// How many parameters the data determine.
    pub effective_parameters: Option<f64>,
    /// RMS of the 3-D errors of observations left out one by one, m.
    pub left_out_rms_3d_m: Option<f64>,
    /// One entry a parameter.
    pub support: Vec<JsonSupport>,
    /// Pairs whose correlation is 0.9 or more in size, strongest first.
    pub correlations: Vec<JsonCorrelation>,
    /// One entry an observation of the identification set.
    pub influences: Vec<JsonInfluence>,
    /// By the key of the set: standard deviations of the predicted position along the base's axes, m, an entry an observation; null
    /// where a pose cannot be taken.
    pub predicted_sigma_m: BTreeMap<String, Vec<Option<[Option<f64>; 3]>>>,
    /// The same over the box of joint variables that the measured poses span.
    pub region: JsonRegion,
}

/// What a parameter rests on, in the parameter's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSupport {
    /// As in every file.
    pub name: String,
    /// Share of what is known of it that came with the data.
    pub data_share: Option<f64>,
    /// Standard deviation from the data alone; null where they do not determine all parameters.
    pub data_sigma: Option<f64>,
    /// Part of sigma that the readings' noise makes.
    pub noise_part: Option<f64>,
    /// Part of sigma that the priors make.
    pub prior_part: Option<f64>,
}

/// Two parameters that the data can hardly tell apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonCorrelation {
    /// Their names.
    pub parameters: [String; 2],
    /// -1 to 1.
    pub correlation: Option<f64>,
}

/// What an observation has to do with the estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonInfluence {
    /// Number of the pose.
    pub pose: u32,
    /// How many parameters it determines by itself, 0 to 3.
    pub leverage: Option<f64>,
    /// Cook's distance; null where the observation alone determines a direction.
    pub cook: Option<f64>,
    /// Its error if it had been left out, measured minus predicted in the base frame, m.
    pub left_out_m: Option<[Option<f64>; 3]>,
}

/// Standard deviations of predicted positions over a region: of the 3-D error, m.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonRegion {
    /// Poses that the robot cannot take.
    pub out_of_reach: usize,
    /// Median.
    pub median_m: Option<f64>,
    /// Largest of the best 95 %.
    pub quantile_95_m: Option<f64>,
    /// Largest.
    pub max_m: Option<f64>,
    /// One entry a pose.
    pub points: Vec<JsonPoint>,
}

/// A pose of the region.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonPoint {
    /// Predicted position in the base frame, m.
    pub position_m: [Option<f64>; 3],
    /// Standard deviation of its 3-D error, m.
    pub sigma_m: Option<f64>,
}

/// The document of a judgement.
pub(in crate::report) fn json_judgement(outcome: &Outcome, judgement: &Judgement) -> JsonJudgement {
    let consistency = &judgement.consistency;
    let patterns = consistency.shape.iter().flat_map(|shape| &shape.patterns);
    JsonJudgement {
        consistent: judgement.is_consistent(),
        level: consistency.level,
        size_p_value: consistency.size.and_then(|size| finite(size.p_value)),
        patterns: patterns
            .map(|pattern| JsonPattern {
                cause: pattern.cause.key(),
                words: pattern.to_string(),
                ln_p: finite(pattern.ln_p),
                peak_m: finite(pattern.peak),
                share: finite(pattern.share),
            })
            .collect(),
        held_out_outliers: judgement
            .held_out
            .iter()
            .map(|(kind, outliers)| (kind.key().to_owned(), outliers.iter().map(JsonOutlier::from).collect()))
            .collect(),
        serial_correlation: consistency.shape.as_ref().and_then(|s| s.serial_correlation).and_then(finite),
        confidence: judgement.confidence.as_ref().map(|confidence| json_confidence(outcome, confidence)),
        scatter: json_scatters(outcome, judgement),
    }
}

fn json_confidence(outcome: &Outcome, confidence: &Confidence) -> JsonConfidence {
    let poses = outcome.sets.first().map_or(&[][..], |set| &set.measurements.observations);
    let influences = confidence.influences.iter().zip(&confidence.left_out).zip(poses);
    let sets = outcome.sets.iter().zip(&confidence.at_poses);
    let [median, quantile_95, max] = quantiles(&confidence.map).map_or([None; 3], |q| q.map(finite));
    JsonConfidence {
        effective_parameters: finite(confidence.effective_parameters),
        left_out_rms_3d_m: confidence.left_out_rms().and_then(finite),
        support: confidence
            .support
            .iter()
            .map(|support| JsonSupport {
                name: support.id.to_string(),
                data_share: finite(support.data_share),
                data_sigma: support.data_sigma.and_then(finite),
                noise_part: finite(support.noise_part),
                prior_part: finite(support.prior_part),
            })
            .collect(),
        correlations: confidence
            .correlations
            .iter()
            .map(|(a, b, correlation)| JsonCorrelation {
                parameters: [a.to_string(), b.to_string()],
                correlation: finite(*correlation),
            })
            .collect(),
        influences: influences
            .map(|((influence, left_out), observation)| JsonInfluence {
                pose: observation.pose,
                leverage: finite(influence.leverage),
                cook: influence.cook.and_then(finite),
                left_out_m: left_out.map(axes),
            })
            .collect(),
        predicted_sigma_m: sets
            .map(|(set, places)| {
                (set.kind.key().to_owned(), places.iter().map(|p| p.map(|p| axes(p.sigma))).collect())
            })
            .collect(),
        region: JsonRegion {
            out_of_reach: confidence.out_of_reach,
            median_m: median,
            quantile_95_m: quantile_95,
            max_m: max,
            points: confidence.map.iter().map(point).collect(),
        },
    }
}

fn point(place: &PredictedPosition) -> JsonPoint {
    JsonPoint { position_m: axes(place.position), sigma_m: finite(place.length()) }
}

/// An observation far off the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonOutlier {
    /// Number of its pose.
    pub pose: u32,
    /// Name of its target, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<String>,
    /// Name of its station, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub station: Option<String>,
    /// How far it is from where a fit without it predicts it, m.
    #[serde(default)]
    pub distance_m: Option<f64>,
    /// How far it is turned from there, rad; absent where its orientation is not a gross error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn_rad: Option<f64>,
    /// The larger of the two in standard deviations of a coordinate.
    pub size: Option<f64>,
    /// What it still counts for in the fit, from 1 down to 0.
    pub weight: Option<f64>,
    /// The pose that it has exchanged its point with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exchanged_with: Option<u32>,
}

impl From<&Outlier> for JsonOutlier {
    fn from(o: &Outlier) -> Self {
        Self {
            pose: o.pose,
            target: o.target.clone(),
            station: o.station.clone(),
            distance_m: finite(o.distance),
            turn_rad: o.turn.and_then(finite),
            size: finite(o.size),
            weight: finite(o.weight),
            exchanged_with: o.exchanged_with,
        }
    }
}
