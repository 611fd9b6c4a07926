//! Measurement files in calibrig's own columns.

use std::path::{Path, PathBuf};

use miette::Diagnostic;
use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use super::own_columns as own;
use super::units::TEMPERATURES;
use crate::input::InputError;
use crate::payloads::NO_PAYLOAD;
use crate::rotation::{RotationError, rotation_of_matrix};
use calibrig_model::measurement::{Face, MeasurementSet, Observation, Reading};
use calibrig_model::{JointKind, Payload, PayloadError};

/// A measurement file that cannot be used, or a set that cannot be written as one.
#[derive(Debug, Error, Diagnostic)]
#[non_exhaustive]
pub enum CsvError {
    /// The file cannot be read, or something in it is wrong.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Input(#[from] InputError),
    /// The file cannot be written.
    #[error("cannot write {}: {reason}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A number that is not finite.
    #[error("pose {pose}: {column} is {value}")]
    #[diagnostic(help("expected a finite number"))]
    NotFinite {
        /// Pose.
        pose: u32,
        /// Its column.
        column: String,
        /// The number.
        value: f64,
    },
    /// A command or an approach without exactly one entry per joint.
    #[error("pose {pose}: {found} {what} for {expected} joints")]
    #[diagnostic(help("expected one per joint, in the order of the robot's file: {expected}"))]
    JointCount {
        /// Pose.
        pose: u32,
        /// `commands` or `approach directions`.
        what: &'static str,
        /// Entries.
        found: usize,
        /// Joints of the robot.
        expected: usize,
    },
    /// An approach direction other than -1, 0 or 1.
    #[error("pose {pose}: approach direction {value}")]
    #[diagnostic(help("expected -1, 0 or 1"))]
    Approach {
        /// Pose.
        pose: u32,
        /// The direction.
        value: i8,
    },
    /// Readings of several kinds in one set.
    #[error(
        "pose {pose}: a set must hold only spherical readings, only Cartesian readings, or only full poses"
    )]
    #[diagnostic(help("expected readings of one kind; write those of each kind to a separate file"))]
    MixedReadings {
        /// First pose that differs from the poses before it.
        pose: u32,
    },
    /// A full pose whose matrix is not a rotation.
    #[error("pose {pose}: {error}")]
    #[diagnostic(help("expected {}", error.expected()))]
    Rotation {
        /// Pose.
        pose: u32,
        /// What it is.
        error: RotationError,
    },
    /// An impossible air temperature.
    #[error("pose {pose}: the temperature is {value} °C")]
    #[diagnostic(help("expected a temperature from {} to {} °C", TEMPERATURES[0], TEMPERATURES[1]))]
    Temperature {
        /// Pose.
        pose: u32,
        /// °C
        value: f64,
    },
    /// An invalid load at the flange.
    #[error("pose {pose}: {source}")]
    #[diagnostic(help("expected a mass of zero or more, and finite numbers"))]
    Payload {
        /// Pose.
        pose: u32,
        /// Why.
        source: PayloadError,
    },
    /// A station or target that the set does not have.
    #[error("pose {pose}: {what} {index} is not in the set")]
    Missing {
        /// Pose.
        pose: u32,
        /// `station` or `target`.
        what: &'static str,
        /// Index, from zero.
        index: usize,
    },
    /// A name that is not distinct, or would not be read back.
    #[error("{what} name {name:?} cannot be written")]
    #[diagnostic(help("expected distinct names without line breaks and without blanks at their ends"))]
    Name {
        /// `station`, `target` or `payload`.
        what: &'static str,
        /// The name.
        name: String,
    },
}

/// Writes a measurement file in calibrig's own columns (see [`ColumnMap`](super::ColumnMap)); every number reads back to the same bits.
///
/// Nests and target offsets are not part of the format (see [`session_text`](crate::session_text)). The uncertainty is written as standard
/// deviations if these give the covariances exactly, else as covariances.
pub fn write_measurements(path: &Path, set: &MeasurementSet, joints: &[JointKind]) -> Result<(), CsvError> {
    let text = measurements_text(set, joints)?;
    std::fs::write(path, text)
        .map_err(|e| CsvError::Unwritable { path: path.to_path_buf(), reason: e.to_string() })
}

/// [`write_measurements`] to a text in memory.
pub fn measurements_text(set: &MeasurementSet, joints: &[JointKind]) -> Result<String, CsvError> {
    Writer { set, joints }.text()
}

/// What the columns of a file are.
#[derive(Debug, Clone, Copy)]
struct Form {
    kind: Kind,
    as_sigmas: bool,
    /// Whether some reading is of the back face.
    has_faces: bool,
    /// Whether some pose carries a payload.
    has_payloads: bool,
}

struct Writer<'a> {
    set: &'a MeasurementSet,
    joints: &'a [JointKind],
}

/// A number as text that reads back to the same bits.
fn exact(number: f64) -> String {
    format!("{number:?}")
}

/// The standard deviations whose squares are exactly the covariance.
fn exact_sigmas(covariance: &DMatrix<f64>) -> Option<DVector<f64>> {
    let sigmas = covariance.diagonal().map(f64::sqrt);
    let squared = DMatrix::from_diagonal(&sigmas.component_mul(&sigmas));
    let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
    squared.iter().zip(covariance).all(same).then_some(sigmas)
}

/// What kind of readings a file holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Spherical,
    Cartesian,
    Pose,
}

impl Kind {
    fn of(reading: &Reading) -> Self {
        match reading {
            Reading::Spherical(_) => Self::Spherical,
            Reading::Cartesian { .. } => Self::Cartesian,
            Reading::Pose(_) => Self::Pose,
        }
    }

    /// Its coordinates, and how their uncertainty is written.
    fn columns(self, as_sigmas: bool) -> Vec<&'static str> {
        match (self, as_sigmas) {
            (Self::Spherical, true) => [own::SPHERICAL, own::SPHERICAL_SIGMA].concat(),
            (Self::Spherical, false) => [&own::SPHERICAL[..], &own::SPHERICAL_COVARIANCE].concat(),
            (Self::Cartesian, true) => [own::CARTESIAN, own::CARTESIAN_SIGMA].concat(),
            (Self::Cartesian, false) => [&own::CARTESIAN[..], &own::CARTESIAN_COVARIANCE].concat(),
            (Self::Pose, true) => {
                [&own::CARTESIAN[..], &own::ROTATION, &own::CARTESIAN_SIGMA, &own::ROTATION_SIGMA].concat()
            }
            (Self::Pose, false) => [&own::CARTESIAN[..], &own::ROTATION, &own::POSE_COVARIANCE].concat(),
        }
    }

    /// Numbers of the uncertainty.
    fn uncertainties(self, as_sigmas: bool) -> usize {
        match (self, as_sigmas) {
            (Self::Pose, true) => 6,
            (Self::Pose, false) => 21,
            (_, true) => 3,
            (_, false) => 6,
        }
    }
}

/// The covariance of a reading, of as many rows as it has coordinates.
fn covariance_of(reading: &Reading) -> Option<DMatrix<f64>> {
    match reading {
        Reading::Spherical(reading) => {
            reading.covariance.map(|c| DMatrix::from_column_slice(3, 3, c.as_slice()))
        }
        Reading::Cartesian { covariance, .. } => {
            covariance.map(|c| DMatrix::from_column_slice(3, 3, c.as_slice()))
        }
        Reading::Pose(pose) => pose.covariance.map(|c| DMatrix::from_column_slice(6, 6, c.as_slice())),
    }
}

/// The cells of a payload, which are empty without one.
fn payload_cells(pose: u32, payload: Option<&Payload>) -> Result<Vec<String>, CsvError> {
    let Some(payload) = payload else { return Ok(vec![String::new(); 8]) };
    payload.check().map_err(|source| CsvError::Payload { pose, source })?;
    let name = &payload.name;
    if name.is_empty() || name == NO_PAYLOAD || name.trim() != name || name.contains(['\n', '\r']) {
        return Err(CsvError::Name { what: "payload", name: name.clone() });
    }
    let numbers = [payload.mass].into_iter().chain(payload.centre.iter().copied());
    let numbers = numbers.chain(payload.force.iter().copied());
    Ok([name.clone()].into_iter().chain(numbers.map(exact)).collect())
}

fn check_names<'n>(what: &'static str, names: impl Iterator<Item = &'n String>) -> Result<(), CsvError> {
    let mut seen: Vec<&String> = Vec::new();
    for name in names {
        if seen.contains(&name) || name.trim() != name || name.contains(['\n', '\r']) {
            return Err(CsvError::Name { what, name: name.clone() });
        }
        seen.push(name);
    }
    Ok(())
}

impl Writer<'_> {
    fn text(&self) -> Result<String, CsvError> {
        check_names("station", self.set.stations.iter().map(|station| &station.name))?;
        check_names("target", self.set.targets.iter().map(|target| &target.name))?;
        let observations = &self.set.observations;
        let kind = observations.first().map_or(Kind::Spherical, |o| Kind::of(&o.reading));
        if let Some(other) = observations.iter().find(|o| Kind::of(&o.reading) != kind) {
            return Err(CsvError::MixedReadings { pose: other.pose });
        }
        let covariances: Vec<_> = observations.iter().map(|o| covariance_of(&o.reading)).collect();
        let form = Form {
            kind,
            as_sigmas: covariances.iter().flatten().all(|covariance| exact_sigmas(covariance).is_some()),
            has_faces: observations.iter().any(|o| o.reading.face() != Face::Front),
            has_payloads: observations.iter().any(|o| o.payload.is_some()),
        };
        let header = self.header(form);
        let mut writer = csv::Writer::from_writer(Vec::new());
        let unwritable =
            |e: csv::Error| CsvError::Unwritable { path: PathBuf::from("(memory)"), reason: e.to_string() };
        writer.write_record(&header).map_err(unwritable)?;
        for (observation, covariance) in observations.iter().zip(&covariances) {
            let row = self.row(&header, observation, covariance.as_ref(), form)?;
            writer.write_record(&row).map_err(unwritable)?;
        }
        let text = writer.into_inner().map_err(|e| unwritable(e.into_error().into()))?;
        // Made of texts alone.
        Ok(String::from_utf8_lossy(&text).into_owned())
    }

    fn header(&self, form: Form) -> Vec<String> {
        let mut header: Vec<String> = [own::POSE, own::STATION, own::TARGET].map(str::to_owned).into();
        header.extend(form.has_faces.then(|| own::FACE.to_owned()));
        header.extend(self.joints.iter().enumerate().map(|(index, kind)| own::joint(index, *kind)));
        header.extend(form.kind.columns(form.as_sigmas).into_iter().map(str::to_owned));
        header.extend([own::TIME, own::TEMPERATURE].map(str::to_owned));
        header.extend((0..self.joints.len()).map(own::approach));
        if form.has_payloads {
            let columns = [own::PAYLOAD, own::PAYLOAD_MASS].into_iter().chain(own::PAYLOAD_CENTRE);
            header.extend(columns.chain(own::PAYLOAD_FORCE).map(str::to_owned));
        }
        if self.has_ways() {
            let joints = self.joints.iter().enumerate();
            header.extend(joints.map(|(index, kind)| own::since_reversal(index, *kind)));
        }
        header
    }

    /// Whether any pose states how far actuators have moved since they reversed.
    fn has_ways(&self) -> bool {
        self.set.observations.iter().any(|observation| !observation.since_reversal.is_empty())
    }

    fn row(
        &self,
        header: &[String],
        observation: &Observation,
        covariance: Option<&DMatrix<f64>>,
        form: Form,
    ) -> Result<Vec<String>, CsvError> {
        let (pose, expected) = (observation.pose, self.joints.len());
        for (what, found) in
            [("commands", observation.command.len()), ("approach directions", observation.approach.len())]
        {
            if found != expected {
                return Err(CsvError::JointCount { pose, what, found, expected });
            }
        }
        let (station, target) = (observation.station, observation.target);
        let station = &self.set.stations.get(station).ok_or(CsvError::Missing {
            pose,
            what: "station",
            index: station,
        })?;
        let target =
            &self.set.targets.get(target).ok_or(CsvError::Missing { pose, what: "target", index: target })?;
        let mut numbers: Vec<Option<f64>> = observation.command.iter().copied().map(Some).collect();
        match &observation.reading {
            Reading::Spherical(r) => numbers.extend([r.range, r.azimuth, r.elevation].map(Some)),
            Reading::Cartesian { position, .. } => numbers.extend(position.iter().copied().map(Some)),
            Reading::Pose(reading) => {
                let matrix = reading.rotation.matrix();
                rotation_of_matrix(matrix).map_err(|error| CsvError::Rotation { pose, error })?;
                numbers.extend(reading.position.iter().chain(&matrix.transpose()).copied().map(Some));
            }
        }
        let uncertainties = form.kind.uncertainties(form.as_sigmas);
        match covariance {
            Some(c) if form.as_sigmas => {
                numbers.extend(
                    exact_sigmas(c).into_iter().flat_map(|sigmas| sigmas.data.as_vec().clone()).map(Some),
                );
            }
            Some(c) => {
                let upper = (0..c.nrows()).flat_map(|i| (i..c.ncols()).map(move |j| (i, j)));
                numbers.extend(upper.map(|place| Some(c[place])));
            }
            None => numbers.extend(vec![None; uncertainties]),
        }
        if let Some(value) = observation
            .temperature
            .filter(|t| t.is_finite() && !(TEMPERATURES[0]..=TEMPERATURES[1]).contains(t))
        {
            return Err(CsvError::Temperature { pose, value });
        }
        numbers.extend([Some(observation.time), observation.temperature]);
        let mut row = vec![pose.to_string(), station.name.clone(), target.name.clone()];
        row.extend(form.has_faces.then(|| observation.reading.face().key().to_owned()));
        for (number, column) in numbers.into_iter().zip(&header[row.len()..]) {
            match number {
                Some(value) if !value.is_finite() => {
                    return Err(CsvError::NotFinite { pose, column: column.clone(), value });
                }
                number => row.push(number.map_or_else(String::new, exact)),
            }
        }
        for &value in &observation.approach {
            if !(-1..=1).contains(&value) {
                return Err(CsvError::Approach { pose, value });
            }
            row.push(value.to_string());
        }
        if form.has_payloads {
            row.extend(payload_cells(pose, observation.payload.as_ref())?);
        }
        if self.has_ways() {
            let ways = &observation.since_reversal;
            if !ways.is_empty() && ways.len() != expected {
                return Err(CsvError::JointCount {
                    pose,
                    what: "distances since a reversal",
                    found: ways.len(),
                    expected,
                });
            }
            for (index, column) in header[row.len()..].iter().enumerate() {
                match ways.get(index) {
                    Some(value) if !value.is_finite() => {
                        return Err(CsvError::NotFinite { pose, column: column.clone(), value: *value });
                    }
                    way => row.push(way.copied().map_or_else(String::new, exact)),
                }
            }
        }
        Ok(row)
    }
}
