//! Residuals of single readings: `residuals.csv`, and the same in `report.json`.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::document::finite;
use crate::pipeline::{Judgement, ModeOutcome, ObservationResidual, Outcome, SetOutcome};

/// Name of the file.
pub(super) const FILE: &str = "residuals.csv";

/// A reading, measured minus predicted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonResidual {
    /// Number of its pose.
    pub pose: u32,
    /// Name of its target.
    pub target: String,
    /// Name of its station.
    pub station: String,
    /// Its file and row; absent where it comes from no file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub row: Option<String>,
    /// Along the base's axes.
    pub error_m: [Option<f64>; 3],
    /// Of the range; absent where the reading is Cartesian, as the next two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_m: Option<f64>,
    /// Of the azimuth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub az_rad: Option<f64>,
    /// Of the elevation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub el_rad: Option<f64>,
    /// Root mean square of its three coordinates in standard deviations, by which the fit weighs it.
    pub standardised: Option<f64>,
    /// What it counts for in the fit, from 1 down to 0; absent where it was not fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weight: Option<f64>,
}

/// A reading of a set under a mode.
struct Line<'a> {
    set: &'a SetOutcome,
    index: usize,
    row: Option<&'a str>,
    error: &'a Vector3<f64>,
    /// Of an identified robot.
    residual: Option<&'a ObservationResidual>,
}

/// The readings of the set with this index.
fn lines<'a>(
    outcome: &'a Outcome,
    mode: &'a ModeOutcome,
    judgement: Option<&'a Judgement>,
    set: usize,
) -> impl Iterator<Item = Line<'a>> {
    let errors = mode.errors.get(set).map_or(&[][..], Vec::as_slice);
    let residuals = judgement.and_then(|judgement| judgement.residuals.get(set));
    let places = outcome.places.get(set).map_or(&[][..], Vec::as_slice);
    let count = outcome.sets[set].measurements.observations.len();
    errors.iter().take(count).enumerate().map(move |(index, error)| Line {
        set: &outcome.sets[set],
        index,
        row: places.get(index).map(String::as_str).filter(|place| !place.is_empty()),
        error,
        residual: residuals.and_then(|residuals| residuals.get(index)),
    })
}

impl Line<'_> {
    fn names(&self) -> (u32, &str, &str) {
        let measurements = &self.set.measurements;
        let observation = &measurements.observations[self.index];
        let target = measurements.targets.get(observation.target).map_or("", |target| &target.name);
        let station = measurements.stations.get(observation.station).map_or("", |station| &station.name);
        (observation.pose, target, station)
    }
}

/// Those of an estimate, by the key of the set.
pub(super) fn json_residuals(
    outcome: &Outcome,
    judgement: &Judgement,
) -> BTreeMap<String, Vec<JsonResidual>> {
    let Some(mode) = outcome.modes.iter().find(|mode| mode.mode == judgement.mode) else {
        return BTreeMap::new();
    };
    let residual = |line: Line<'_>| {
        let (pose, target, station) = line.names();
        let spherical = line.residual.and_then(|residual| residual.spherical);
        JsonResidual {
            pose,
            target: target.to_owned(),
            station: station.to_owned(),
            row: line.row.map(str::to_owned),
            error_m: [finite(line.error.x), finite(line.error.y), finite(line.error.z)],
            range_m: spherical.and_then(|residual| finite(residual.x)),
            az_rad: spherical.and_then(|residual| finite(residual.y)),
            el_rad: spherical.and_then(|residual| finite(residual.z)),
            standardised: line.residual.and_then(|residual| residual.standardised),
            weight: line.residual.and_then(|residual| residual.weight),
        }
    };
    let of_set = |(index, set): (usize, &SetOutcome)| {
        let residuals = lines(outcome, mode, Some(judgement), index).map(residual).collect();
        (set.kind.key().to_owned(), residuals)
    };
    outcome.sets.iter().enumerate().map(of_set).collect()
}

const HEADER: [&str; 16] = [
    "mode",
    "set",
    "index",
    "pose",
    "x_m",
    "y_m",
    "z_m",
    "norm_m",
    "target",
    "station",
    "row",
    "range_m",
    "az_rad",
    "el_rad",
    "standardised",
    "weight",
];

/// The text of `residuals.csv`: a line a reading and mode, the columns of an exported recording first.
pub fn residuals_csv(outcome: &Outcome) -> Result<String, csv::Error> {
    let number = |value: Option<f64>| {
        value.filter(|value| value.is_finite()).map_or_else(String::new, |value| format!("{value:?}"))
    };
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(HEADER)?;
    for mode in &outcome.modes {
        let judgement = outcome.judgements.iter().find(|judgement| judgement.mode == mode.mode);
        for (index, set) in outcome.sets.iter().enumerate() {
            for line in lines(outcome, mode, judgement, index) {
                let (pose, target, station) = line.names();
                let spherical = line.residual.and_then(|residual| residual.spherical);
                let e = line.error;
                let mut record =
                    vec![mode.mode.key().to_owned(), set.kind.key().to_owned(), line.index.to_string()];
                record.push(pose.to_string());
                record.extend([e.x, e.y, e.z, e.norm()].map(|value| number(Some(value))));
                record.extend([target, station, line.row.unwrap_or_default()].map(str::to_owned));
                record.extend((0..3).map(|axis| number(spherical.map(|residual| residual[axis]))));
                record.push(number(line.residual.and_then(|residual| residual.standardised)));
                record.push(number(line.residual.and_then(|residual| residual.weight)));
                writer.write_record(&record)?;
            }
        }
    }
    let bytes = writer.into_inner().map_err(|error| csv::Error::from(error.into_error()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
