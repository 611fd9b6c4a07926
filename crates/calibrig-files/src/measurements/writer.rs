//! Measurement files in calibrig's own columns.

use std::path::{Path, PathBuf};

use miette::Diagnostic;
use nalgebra::Matrix3;
use thiserror::Error;

use super::columns::own;
use crate::input::InputError;
use calibrig_model::JointKind;
use calibrig_model::measurement::{MeasurementSet, Observation, Reading};

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
    /// A number that no file can hold.
    #[error("pose {pose}: {column} is {value}")]
    #[diagnostic(help("expected a finite number"))]
    NotFinite {
        /// Pose.
        pose: u32,
        /// The column that it would stand in.
        column: String,
        /// The number.
        value: f64,
    },
    /// A command or an approach that does not have one entry a joint.
    #[error("pose {pose}: {found} {what} for {expected} joints")]
    #[diagnostic(help("expected one a joint, as the robot's file has them: {expected}"))]
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
    /// Spherical and Cartesian readings in one set.
    #[error("pose {pose}: a set holds either spherical or Cartesian readings")]
    MixedReadings {
        /// First pose that differs from the poses before it.
        pose: u32,
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
    /// A name that could not be told from another, or not be read back.
    #[error("{what} name {name:?} cannot be written")]
    #[diagnostic(help("expected distinct names without line breaks or blanks at their ends"))]
    Name {
        /// `station` or `target`.
        what: &'static str,
        /// The name.
        name: String,
    },
}

/// Writes a measurement file in calibrig's own columns (see [`ColumnMap`](super::ColumnMap)); every number reads back to the same bits.
///
/// Nests and target offsets are not part of the format (see [`session_text`](crate::session_text)). The uncertainty is written as standard
/// deviations where these give the covariances exactly, else as covariances.
pub fn write_measurements(path: &Path, set: &MeasurementSet, joints: &[JointKind]) -> Result<(), CsvError> {
    let text = measurements_text(set, joints)?;
    std::fs::write(path, text)
        .map_err(|e| CsvError::Unwritable { path: path.to_path_buf(), reason: e.to_string() })
}

/// [`write_measurements`] to a text in memory.
pub fn measurements_text(set: &MeasurementSet, joints: &[JointKind]) -> Result<String, CsvError> {
    Writer { set, joints }.text()
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
fn exact_sigmas(covariance: &Matrix3<f64>) -> Option<[f64; 3]> {
    let sigmas = covariance.diagonal().map(f64::sqrt);
    let squared = Matrix3::from_diagonal(&sigmas.component_mul(&sigmas));
    let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
    squared.iter().zip(covariance).all(same).then(|| sigmas.into())
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
        let spherical =
            matches!(observations.first().map(|o| &o.reading), None | Some(Reading::Spherical(_)));
        let mut covariances = Vec::with_capacity(observations.len());
        for observation in observations {
            covariances.push(match &observation.reading {
                Reading::Spherical(reading) if spherical => reading.covariance,
                Reading::Cartesian { covariance, .. } if !spherical => *covariance,
                _ => return Err(CsvError::MixedReadings { pose: observation.pose }),
            });
        }
        let sigmas = covariances.iter().flatten().all(|covariance| exact_sigmas(covariance).is_some());
        let header = self.header(spherical, sigmas);
        let mut writer = csv::Writer::from_writer(Vec::new());
        let unwritable =
            |e: csv::Error| CsvError::Unwritable { path: PathBuf::from("(memory)"), reason: e.to_string() };
        writer.write_record(&header).map_err(unwritable)?;
        for (observation, covariance) in observations.iter().zip(&covariances) {
            let row = self.row(&header, observation, covariance.as_ref(), sigmas)?;
            writer.write_record(&row).map_err(unwritable)?;
        }
        let text = writer.into_inner().map_err(|e| unwritable(e.into_error().into()))?;
        // Made of texts alone.
        Ok(String::from_utf8_lossy(&text).into_owned())
    }

    fn header(&self, spherical: bool, sigmas: bool) -> Vec<String> {
        let mut header: Vec<String> = [own::POSE, own::STATION, own::TARGET].map(str::to_owned).into();
        header.extend(self.joints.iter().enumerate().map(|(index, kind)| own::joint(index, *kind)));
        let (position, sigma, covariance) = if spherical {
            (own::SPHERICAL, own::SPHERICAL_SIGMA, own::SPHERICAL_COVARIANCE)
        } else {
            (own::CARTESIAN, own::CARTESIAN_SIGMA, own::CARTESIAN_COVARIANCE)
        };
        header.extend(position.map(str::to_owned));
        if sigmas {
            header.extend(sigma.map(str::to_owned));
        } else {
            header.extend(covariance.map(str::to_owned));
        }
        header.extend([own::TIME, own::TEMPERATURE].map(str::to_owned));
        header.extend((0..self.joints.len()).map(own::approach));
        header
    }

    fn row(
        &self,
        header: &[String],
        observation: &Observation,
        covariance: Option<&Matrix3<f64>>,
        sigmas: bool,
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
            Reading::Pose(_) => return Err(CsvError::MixedReadings { pose }),
        }
        match covariance {
            Some(c) if sigmas => numbers.extend(exact_sigmas(c).unwrap_or_default().map(Some)),
            Some(c) => {
                numbers.extend([c.m11, c.m12, c.m13, c.m22, c.m23, c.m33].map(Some));
            }
            None => numbers.extend(vec![None; if sigmas { 3 } else { 6 }]),
        }
        numbers.extend([Some(observation.time), observation.temperature]);
        let mut row = vec![pose.to_string(), station.name.clone(), target.name.clone()];
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
        Ok(row)
    }
}
