//! `iso9283.json`, schema `calibrig.iso9283/1`. It only grows.

use serde::{Deserialize, Serialize};

use crate::pipeline::{AccuracyAgainst, Iso9283Outcome, Iso9283Pose, Iso9283Target};
use crate::report::document::{Axes, JsonInput, JsonSoftware, axes, finite};
use calibrig_estimation::evaluation::iso9283::{
    ISO_LEVEL, OrientationAccuracy, OrientationRepeatability, PositionAccuracy,
};

/// The schema's name.
pub const ISO9283_SCHEMA: &str = "calibrig.iso9283/1";

/// The whole document. Numbers that are not finite are `null`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonIso9283 {
    /// [`ISO9283_SCHEMA`].
    pub schema: String,
    /// What wrote it.
    pub software: JsonSoftware,
    /// Where the measurements came from.
    pub input: JsonInput,
    /// Name of the robot.
    pub robot: String,
    /// Cycles at every pose.
    pub cycles: usize,
    /// Confidence of all intervals.
    pub level: f64,
    /// `base` or `tracker`: the frame of positions and axes.
    pub frame: String,
    /// The cube; absent of measured files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cube: Option<JsonCube>,
    /// One a target.
    pub targets: Vec<JsonIsoTarget>,
    /// Orientation from three or more targets together; absent where there are fewer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub combined: Option<JsonCombined>,
    /// What is left open or was left out, in words.
    pub remarks: Vec<String>,
    /// What a person must look at: with any, exit code 3.
    pub doubts: Vec<String>,
}

/// The cube of the poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonCube {
    /// Middle in the base frame.
    pub centre_m: Axes,
    /// Length of an edge.
    pub edge_m: f64,
    /// Such as `c1-c2-c7-c8`.
    pub plane: String,
    /// P1 to P5 in the base frame.
    pub poses_m: Vec<Axes>,
}

/// What one target says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonIsoTarget {
    /// Its name.
    pub target: String,
    /// By their numbers.
    pub poses: Vec<JsonIsoPose>,
    /// Variance of all poses' scatter over that of the readings' stated noise; null where none is stated.
    pub scatter_over_stated: Option<f64>,
    /// Where that lies in 99.9 % if the machine does not scatter.
    pub scatter_over_stated_band: Option<[f64; 2]>,
    /// Accuracy, one row a robot.
    pub accuracy: Vec<JsonIsoRow>,
}

/// Repeatability at a pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonIsoPose {
    /// Its number.
    pub pose: u32,
    /// Mean of the attained positions.
    pub barycentre_m: Axes,
    /// RP of the position.
    pub rp_m: Option<f64>,
    /// Its interval.
    pub rp_interval_m: [Option<f64>; 2],
    /// Mean distance from the barycentre.
    pub mean_distance_m: Option<f64>,
    /// Standard deviation of that distance.
    pub distance_sigma_m: Option<f64>,
    /// Standard deviation along each axis.
    pub sigma_m: Axes,
    /// Root of the mean squared length of a reading's error as stated; null where not stated.
    pub stated_sigma_3d_m: Option<f64>,
    /// Attained minus barycentre, one a cycle.
    pub deviations_m: Vec<Axes>,
    /// RP of the orientation; absent of points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation: Option<JsonIsoOrientation>,
}

/// Repeatability of the orientation about x, y and z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonIsoOrientation {
    /// Three standard deviations.
    pub rp_rad: Axes,
    /// Lower ends of the intervals.
    pub rp_low_rad: Axes,
    /// Upper ends.
    pub rp_high_rad: Axes,
}

/// Accuracy against one robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonIsoRow {
    /// `nominal_by_nests`, or the key of a mode.
    pub against: String,
    /// The same in words.
    pub title: String,
    /// How the tracker is tied to the base.
    pub registration: String,
    /// One a pose.
    pub poses: Vec<JsonIsoAccuracy>,
}

/// Accuracy at a pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonIsoAccuracy {
    /// Its number.
    pub pose: u32,
    /// Distance of the barycentre from the predicted place.
    pub ap_m: Option<f64>,
    /// Along the axes.
    pub ap_axes_m: Axes,
    /// Half the interval of each.
    pub half_width_m: Axes,
    /// Radius about the barycentre that holds that of endless cycles.
    pub radius_m: Option<f64>,
    /// What the robot states to be off by there, with the tracker's place and the target's offset: root of the mean squared length; null where not known.
    pub expected_sigma_3d_m: Option<f64>,
    /// AP of the orientation; absent of points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation: Option<JsonIsoTurn>,
}

/// Accuracy of the orientation about x, y and z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonIsoTurn {
    /// Attained minus predicted.
    pub ap_rad: Axes,
    /// Half the interval of each.
    pub half_width_rad: Axes,
}

/// Orientation from targets together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonCombined {
    /// Their names.
    pub targets: Vec<String>,
    /// One a pose.
    pub repeatability: Vec<JsonIsoOrientation>,
    /// Key of the row, and one entry a pose.
    pub accuracy: Vec<(String, Vec<JsonIsoTurn>)>,
}

fn orientation(rp: &OrientationRepeatability) -> JsonIsoOrientation {
    JsonIsoOrientation {
        rp_rad: axes(rp.repeatability),
        rp_low_rad: axes(rp.low),
        rp_high_rad: axes(rp.high),
    }
}

fn turn(ap: &OrientationAccuracy) -> JsonIsoTurn {
    JsonIsoTurn { ap_rad: axes(ap.error), half_width_rad: axes(ap.half_width) }
}

fn pose(pose: &Iso9283Pose) -> JsonIsoPose {
    let rp = &pose.position;
    JsonIsoPose {
        pose: pose.pose,
        barycentre_m: axes(pose.barycentre),
        rp_m: finite(rp.repeatability),
        rp_interval_m: rp.interval.map(finite),
        mean_distance_m: finite(rp.mean_distance),
        distance_sigma_m: finite(rp.distance_sigma),
        sigma_m: axes(rp.axis_sigma),
        stated_sigma_3d_m: pose.stated_sigma.and_then(finite),
        deviations_m: pose.deviations.iter().copied().map(axes).collect(),
        orientation: pose.orientation.as_ref().map(orientation),
    }
}

fn row(target: &Iso9283Target, against: &AccuracyAgainst) -> JsonIsoRow {
    let entry = |(place, (pose, ap)): (usize, (&Iso9283Pose, &PositionAccuracy))| JsonIsoAccuracy {
        pose: pose.pose,
        ap_m: finite(ap.distance),
        ap_axes_m: axes(ap.error),
        half_width_m: axes(ap.half_width),
        radius_m: finite(ap.radius),
        expected_sigma_3d_m: against.expected_sigma.get(place).copied().flatten().and_then(finite),
        orientation: against.orientation.get(place).map(turn),
    };
    JsonIsoRow {
        against: against.key.to_owned(),
        title: against.title.clone(),
        registration: against.registration.clone(),
        poses: target.poses.iter().zip(&against.position).enumerate().map(entry).collect(),
    }
}

/// The document of a test.
pub fn json_iso9283(outcome: &Iso9283Outcome) -> JsonIso9283 {
    JsonIso9283 {
        schema: ISO9283_SCHEMA.to_owned(),
        software: JsonSoftware::own(),
        input: JsonInput::from(&outcome.input),
        robot: outcome.robot.clone(),
        cycles: outcome.cycles,
        level: ISO_LEVEL,
        frame: outcome.frame.to_owned(),
        cube: outcome.cube.map(|cube| JsonCube {
            centre_m: axes(cube.centre),
            edge_m: cube.edge,
            plane: cube.plane.key().to_owned(),
            poses_m: cube.poses().map(axes).to_vec(),
        }),
        targets: outcome
            .targets
            .iter()
            .map(|target| JsonIsoTarget {
                target: target.name.clone(),
                poses: target.poses.iter().map(pose).collect(),
                scatter_over_stated: target.over_stated.and_then(|over| finite(over.ratio)),
                scatter_over_stated_band: target.over_stated.map(|over| over.band.into()),
                accuracy: target.rows.iter().map(|against| row(target, against)).collect(),
            })
            .collect(),
        combined: outcome.combined.as_ref().map(|combined| JsonCombined {
            targets: combined.targets.clone(),
            repeatability: combined.repeatability.iter().map(orientation).collect(),
            accuracy: combined
                .accuracy
                .iter()
                .map(|(key, turns)| ((*key).to_owned(), turns.iter().map(turn).collect()))
                .collect(),
        }),
        remarks: outcome.remarks.clone(),
        doubts: outcome.doubts.clone(),
    }
}
