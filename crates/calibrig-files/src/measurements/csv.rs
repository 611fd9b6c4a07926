//! Measurement files: delimited text with a header line, as tracker software exports it and as calibrig writes it.

use std::ops::Range;
use std::path::{Path, PathBuf};

use miette::Diagnostic;
use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use super::ColumnMap;
use super::columns::{AngleUnit, LengthUnit, Mapping, PolarAngle, PositionColumns, Term, Uncertainty, own};
use super::csv_text::{Cell, Delimiter, content_lines, split_line};
use crate::input::{InputError, Source};
use calibrig_model::JointKind;
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, SphericalReading, Station, Target};

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

/// What a measurement file holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LoadedMeasurements {
    /// The observations. Stations have no nests; targets lie at the flange's origin with no stated uncertainty: the file does not
    /// say, the caller must.
    pub set: MeasurementSet,
    /// Rows that were left out: number of the pose, and why.
    pub dropped: Vec<(u32, String)>,
    /// Whether the file names the station of every row; without, there is one of a name that nobody gave.
    pub names_stations: bool,
    /// The same of targets.
    pub names_targets: bool,
}

/// Reads a measurement file. `joints` are the kinds of the robot's joints, in order.
///
/// - The delimiter (`,`, `;`, tab or blanks) is the one under which most columns of `map` are found in the first line; lines that
///   begin with `#` or `//`, and blank lines, are skipped.
/// - A row whose position is (0, 0, 0) is a missed shot: it is left out and reported in [`LoadedMeasurements::dropped`].
/// - Without a pose column the rows count from 1; without a time column the time is 0; without station or target columns there is
///   one of each. Stations and targets are numbered in the order of their first appearance.
/// - A spherical reading of unstated uncertainty becomes a Cartesian one without covariance.
pub fn read_measurements(
    path: &Path,
    map: &ColumnMap,
    joints: &[JointKind],
) -> Result<LoadedMeasurements, CsvError> {
    Ok(parse_measurements(&Source::read(path)?, map, joints)?)
}

/// [`read_measurements`] from a text in memory.
pub fn parse_measurements(
    source: &Source,
    map: &ColumnMap,
    joints: &[JointKind],
) -> Result<LoadedMeasurements, InputError> {
    let text = &source.text;
    let mut lines = content_lines(text);
    let Some(header_line) = lines.next() else {
        return Err(refuse(source, 0..0, "the file is empty", "a line with the names of the columns"));
    };
    let delimiter = sniff(text, &header_line, &map.candidates(joints));
    let header = split(source, header_line.clone(), delimiter)?;
    if header.iter().all(|cell| cell.text.parse::<f64>().is_ok()) {
        let expected = "the names of the columns in the first line";
        return Err(refuse(
            source,
            header_line,
            "the header is missing: the first line holds numbers",
            expected,
        ));
    }
    let names: Vec<&str> = header.iter().map(|cell| cell.text.as_ref()).collect();
    let head = Header { source, line: &header_line, names: &names };
    let mapping =
        map.resolve(&names, joints).map_err(|message| head.refuse(message, "calibrig's own columns"))?;
    let columns = head.columns(&mapping, joints)?;
    let mut loaded = LoadedMeasurements {
        names_stations: columns.station.is_some(),
        names_targets: columns.target.is_some(),
        ..LoadedMeasurements::default()
    };
    let mut rows = 0;
    for line in lines {
        let cells = split(source, line.clone(), delimiter)?;
        if cells.iter().all(|cell| cell.text.is_empty()) {
            continue;
        }
        let row = Row { source, line, names: &names, cells };
        row.check_length()?;
        rows += 1;
        columns.observe(&row, rows, &mut loaded)?;
    }
    if rows == 0 {
        let expected = "a row of numbers for every measurement";
        return Err(refuse(source, header_line, "there are no measurements below the header", expected));
    }
    Ok(loaded)
}

fn refuse(
    source: &Source,
    span: Range<usize>,
    message: impl std::fmt::Display,
    expected: &str,
) -> InputError {
    source.error(span, message, Some(format!("expected {expected}")))
}

fn split(source: &Source, line: Range<usize>, delimiter: Delimiter) -> Result<Vec<Cell<'_>>, InputError> {
    split_line(&source.text, line, delimiter)
        .map_err(|error| refuse(source, error.span, error.message, "quotes in pairs around a whole value"))
}

/// The delimiter under which most of the wanted columns are found; of equals, the one that makes most cells.
fn sniff(text: &str, header: &Range<usize>, wanted: &[String]) -> Delimiter {
    let found = |delimiter: &Delimiter| {
        let cells = split_line(text, header.clone(), *delimiter).unwrap_or_default();
        let hits = wanted.iter().filter(|name| cells.iter().any(|cell| cell.text == name.as_str())).count();
        (hits, cells.len())
    };
    // The last of equal maxima is taken: reversed, so that the first in the list wins.
    Delimiter::ALL.into_iter().rev().max_by_key(found).unwrap_or(Delimiter::Character(','))
}

/// Where the mapped columns are in the rows, and in which units.
struct Columns {
    joints: Vec<(usize, JointUnit)>,
    position: PositionIndices,
    uncertainty: Option<UncertaintyIndices>,
    pose: Option<usize>,
    station: Option<usize>,
    target: Option<usize>,
    time: Option<usize>,
    temperature: Option<usize>,
    approach: Vec<usize>,
}

#[derive(Clone, Copy)]
enum JointUnit {
    Length(LengthUnit),
    Angle(AngleUnit),
}

enum PositionIndices {
    Cartesian {
        axes: [Vec<(usize, f64)>; 3],
        unit: LengthUnit,
    },
    Spherical {
        range: usize,
        azimuth: usize,
        polar: usize,
        units: (LengthUnit, AngleUnit),
        polar_angle: PolarAngle,
    },
}

enum UncertaintyIndices {
    /// With the factors that make them SI.
    Sigmas {
        columns: [usize; 3],
        factors: [f64; 3],
    },
    Covariance([usize; 6]),
}

/// Finds columns by name in a header.
struct Header<'a> {
    source: &'a Source,
    line: &'a Range<usize>,
    names: &'a [&'a str],
}

impl Header<'_> {
    fn find(&self, wanted: &str) -> Result<usize, InputError> {
        let mut at = (0..self.names.len()).filter(|index| self.names[*index] == wanted);
        match (at.next(), at.next()) {
            (Some(index), None) => Ok(index),
            (None, _) => {
                let expected = format!("a column {wanted}; found {}", self.names.join(", "));
                Err(self.refuse(format!("column {wanted} is missing"), &expected))
            }
            (Some(_), Some(_)) => {
                Err(self.refuse(format!("column {wanted} is there twice"), "distinct names of columns"))
            }
        }
    }

    fn find_all<const N: usize>(&self, wanted: &[String; N]) -> Result<[usize; N], InputError> {
        let mut found = [0; N];
        for (index, name) in found.iter_mut().zip(wanted) {
            *index = self.find(name)?;
        }
        Ok(found)
    }

    fn optional(&self, wanted: Option<&String>) -> Result<Option<usize>, InputError> {
        wanted.map(|name| self.find(name)).transpose()
    }

    fn sum(&self, terms: &[Term]) -> Result<Vec<(usize, f64)>, InputError> {
        terms.iter().map(|term| Ok((self.find(&term.column)?, term.sign))).collect()
    }

    fn refuse(&self, message: impl std::fmt::Display, expected: &str) -> InputError {
        refuse(self.source, self.line.clone(), message, expected)
    }

    /// The columns of the commands, with the units that the robot's joints need.
    fn commands(
        &self,
        mapping: &Mapping,
        joints: &[JointKind],
    ) -> Result<Vec<(usize, JointUnit)>, InputError> {
        let (found, expected) = (mapping.joints.len(), joints.len());
        if found != expected {
            let message =
                format!("the column map names {found} joint columns, the robot has {expected} joints");
            return Err(self.refuse(message, "one column a joint"));
        }
        let unit = |kind: &JointKind| match kind {
            JointKind::Revolute => {
                mapping.revolute.map(JointUnit::Angle).ok_or(("revolute", "revolute_unit"))
            }
            JointKind::Prismatic => {
                mapping.prismatic.map(JointUnit::Length).ok_or(("prismatic", "prismatic_unit"))
            }
        };
        let command = |(name, kind): (&String, &JointKind)| {
            let unit = unit(kind).map_err(|(kind, key)| {
                let message = format!("the robot has {kind} joints, the column map no {key}");
                self.refuse(message, &format!("{key} in [joints] of the column map"))
            })?;
            Ok((self.find(name)?, unit))
        };
        mapping.joints.iter().zip(joints).map(command).collect()
    }

    fn position(&self, columns: &PositionColumns) -> Result<PositionIndices, InputError> {
        Ok(match columns {
            PositionColumns::Cartesian { axes: [x, y, z], unit } => {
                PositionIndices::Cartesian { axes: [self.sum(x)?, self.sum(y)?, self.sum(z)?], unit: *unit }
            }
            PositionColumns::Spherical { range, range_unit, azimuth, polar, polar_angle, angle_unit } => {
                PositionIndices::Spherical {
                    range: self.find(range)?,
                    azimuth: self.find(azimuth)?,
                    polar: self.find(polar)?,
                    units: (*range_unit, *angle_unit),
                    polar_angle: *polar_angle,
                }
            }
        })
    }

    fn uncertainty(&self, columns: &Uncertainty) -> Result<UncertaintyIndices, InputError> {
        Ok(match columns {
            Uncertainty::Sigmas([a, b, c]) => UncertaintyIndices::Sigmas {
                columns: [self.find(&a.0)?, self.find(&b.0)?, self.find(&c.0)?],
                factors: [a.1, b.1, c.1],
            },
            Uncertainty::Covariance(names) => UncertaintyIndices::Covariance(self.find_all(names)?),
        })
    }

    fn columns(&self, mapping: &Mapping, joints: &[JointKind]) -> Result<Columns, InputError> {
        Ok(Columns {
            joints: self.commands(mapping, joints)?,
            position: self.position(&mapping.position)?,
            uncertainty: mapping.uncertainty.as_ref().map(|columns| self.uncertainty(columns)).transpose()?,
            pose: self.optional(mapping.pose.as_ref())?,
            station: self.optional(mapping.station.as_ref())?,
            target: self.optional(mapping.target.as_ref())?,
            time: self.optional(mapping.time.as_ref())?,
            temperature: self.optional(mapping.temperature.as_ref())?,
            approach: mapping.approach.iter().map(|name| self.find(name)).collect::<Result<_, _>>()?,
        })
    }
}

impl Columns {
    /// Adds the row to what is loaded: as an observation or as dropped.
    fn observe(&self, row: &Row<'_>, number: u32, loaded: &mut LoadedMeasurements) -> Result<(), InputError> {
        let pose = self.pose.map_or(Ok(number), |column| row.whole_number(column))?;
        let Some(reading) = self.reading(row)? else {
            loaded.dropped.push((pose, "missed shot: the position is (0, 0, 0)".to_owned()));
            return Ok(());
        };
        let command = |(column, unit): &(usize, JointUnit)| {
            let value = row.number(*column)?;
            Ok(match unit {
                JointUnit::Length(unit) => unit.in_si(value),
                JointUnit::Angle(unit) => unit.in_si(value),
            })
        };
        let command: Vec<f64> = self.joints.iter().map(command).collect::<Result<_, InputError>>()?;
        let approach = match self.approach.as_slice() {
            [] => vec![0; command.len()],
            columns => columns.iter().map(|column| row.direction(*column)).collect::<Result<_, _>>()?,
        };
        let temperature = match self.temperature {
            Some(column) if !row.cells[column].text.is_empty() => Some(row.number(column)?),
            _ => None,
        };
        let time = self.time.map_or(Ok(0.0), |column| row.number(column))?;
        let station_name = self.station.map_or("station 1", |column| row.cells[column].text.as_ref());
        let target_name = self.target.map_or("target 1", |column| row.cells[column].text.as_ref());
        let set = &mut loaded.set;
        let station = index_of(
            &mut set.stations,
            |station| station.name == station_name,
            || Station { name: station_name.to_owned(), nests: Vec::new() },
        );
        let target = index_of(
            &mut set.targets,
            |target| target.name == target_name,
            || Target { name: target_name.to_owned(), in_flange: Vector3::zeros(), covariance: None },
        );
        let observation =
            Observation { pose, command, approach, temperature, time, station, target, reading };
        set.observations.push(observation);
        Ok(())
    }

    /// `None` for a missed shot.
    fn reading(&self, row: &Row<'_>) -> Result<Option<Reading>, InputError> {
        match &self.position {
            PositionIndices::Cartesian { axes, unit } => {
                // Minus zero is what leaves the sign of a zero as it is when added to.
                let mut position = Vector3::repeat(-0.0);
                for (coordinate, terms) in position.iter_mut().zip(axes) {
                    for (column, sign) in terms {
                        *coordinate += sign * row.number(*column)?;
                    }
                    row.check_size(terms[0].0, *coordinate)?;
                }
                if position == Vector3::zeros() {
                    return Ok(None);
                }
                let position = position.map(|coordinate| unit.in_si(coordinate));
                Ok(Some(Reading::Cartesian { position, covariance: self.covariance(row)? }))
            }
            PositionIndices::Spherical { range, azimuth, polar, units: (length, angle), polar_angle } => {
                let raw = [row.number(*range)?, row.number(*azimuth)?, row.number(*polar)?];
                if raw.iter().all(|v| *v == 0.0) {
                    return Ok(None);
                }
                if raw[0] <= 0.0 {
                    return Err(row.refuse_cell(*range, "a range above zero"));
                }
                let polar = angle.in_si(raw[2]);
                // The standard deviation of an elevation is that of the zenith angle.
                let covariance = self.covariance(row)?;
                let reading = SphericalReading {
                    range: length.in_si(raw[0]),
                    azimuth: angle.in_si(raw[1]),
                    elevation: match polar_angle {
                        PolarAngle::Elevation => polar,
                        PolarAngle::Zenith => std::f64::consts::FRAC_PI_2 - polar,
                    },
                    covariance: covariance.unwrap_or_default(),
                };
                Ok(Some(match covariance {
                    Some(_) => Reading::Spherical(reading),
                    None => Reading::Cartesian { position: reading.position(), covariance: None },
                }))
            }
        }
    }

    /// `None` where the file has no columns for it, or the row nothing in them.
    fn covariance(&self, row: &Row<'_>) -> Result<Option<Matrix3<f64>>, InputError> {
        match &self.uncertainty {
            None => Ok(None),
            Some(UncertaintyIndices::Sigmas { columns, factors }) => {
                if row.are_empty(columns) {
                    return Ok(None);
                }
                let mut variances = Vector3::zeros();
                for ((variance, column), factor) in variances.iter_mut().zip(columns).zip(factors) {
                    let sigma = row.above_zero(*column, "standard deviation")? * factor;
                    *variance = sigma * sigma;
                    row.check_variance(*column, *variance)?;
                }
                Ok(Some(Matrix3::from_diagonal(&variances)))
            }
            Some(UncertaintyIndices::Covariance(columns)) => {
                if row.are_empty(columns) {
                    return Ok(None);
                }
                let mut values = [0.0; 6];
                for (value, column) in values.iter_mut().zip(columns) {
                    *value = row.number(*column)?;
                }
                for axis in 0..3 {
                    row.above_zero(columns[TRIANGLE[axis][axis]], "variance")?;
                }
                let covariance = Matrix3::from_fn(|i, j| values[TRIANGLE[i][j]]);
                if covariance.cholesky().is_none() {
                    return Err(row.refuse_covariance(columns));
                }
                Ok(Some(covariance))
            }
        }
    }
}

/// Place of a symmetric matrix's element in its upper triangle by rows.
const TRIANGLE: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];

fn index_of<T>(items: &mut Vec<T>, is_it: impl Fn(&T) -> bool, make: impl FnOnce() -> T) -> usize {
    items.iter().position(is_it).unwrap_or_else(|| {
        items.push(make());
        items.len() - 1
    })
}

/// A row of values with what is needed to complain of them.
struct Row<'a> {
    source: &'a Source,
    line: Range<usize>,
    names: &'a [&'a str],
    cells: Vec<Cell<'a>>,
}

impl Row<'_> {
    /// One value a column; empty ones beyond are what a trailing delimiter leaves.
    fn check_length(&self) -> Result<(), InputError> {
        let (found, expected) = (self.cells.len(), self.names.len());
        if found < expected {
            let message =
                format!("the row has {found} of {expected} columns, {} is missing", self.names[found]);
            let expected = format!("{expected} values, as the header has names");
            return Err(refuse(self.source, self.line.clone(), message, &expected));
        }
        match self.cells[expected..].iter().find(|cell| !cell.text.is_empty()) {
            Some(cell) => {
                let message = format!("the row has {found} columns, the header {expected}");
                let expected = format!("{expected} values, as the header has names");
                Err(refuse(self.source, cell.span.clone(), message, &expected))
            }
            None => Ok(()),
        }
    }

    fn refuse_cell(&self, column: usize, expected: &str) -> InputError {
        let cell = &self.cells[column];
        let message = match cell.text.as_ref() {
            "" => format!("column {} is empty", self.names[column]),
            text => format!("column {} is {text:?}", self.names[column]),
        };
        // An empty cell has nothing to underline.
        let span = if cell.span.is_empty() { self.line.clone() } else { cell.span.clone() };
        refuse(self.source, span, message, expected)
    }

    fn number(&self, column: usize) -> Result<f64, InputError> {
        match self.cells[column].text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(_) => Err(self.refuse_cell(column, "a finite number")),
            Err(_) => Err(self.refuse_cell(column, "a number, with a decimal point")),
        }
    }

    fn are_empty(&self, columns: &[usize]) -> bool {
        columns.iter().all(|column| self.cells[*column].text.is_empty())
    }

    /// `what` is a measure of uncertainty.
    fn above_zero(&self, column: usize, what: &str) -> Result<f64, InputError> {
        let number = self.number(column)?;
        if number == 0.0 {
            return Err(self.refuse_zero(column, what));
        }
        let expected = format!("a {what} above zero");
        if number > 0.0 { Ok(number) } else { Err(self.refuse_cell(column, &expected)) }
    }

    fn refuse_zero(&self, column: usize, what: &str) -> InputError {
        let cell = &self.cells[column];
        let message =
            format!("column {} is {:?}: a {what} of 0 was read", self.names[column], cell.text.as_ref());
        let help = format!(
            "a {what} above zero, since no reading is exact: where the instrument rounds, what it rounds to or more; \
             or the cells of the row's uncertainty empty, so that it counts as not stated"
        );
        refuse(self.source, cell.span.clone(), message, &help)
    }

    fn refuse_covariance(&self, columns: &[usize; 6]) -> InputError {
        let names: Vec<_> = columns.iter().map(|column| self.names[*column]).collect();
        let message = format!("the covariance of {} is not positive definite", names.join(", "));
        let span = self.cells[columns[0]].span.clone();
        refuse(self.source, span, message, "correlations between -1 and 1 that do not contradict each other")
    }

    fn check_variance(&self, column: usize, variance: f64) -> Result<(), InputError> {
        // The square of a very small number is zero.
        if variance == 0.0 {
            Err(self.refuse_zero(column, "variance"))
        } else {
            self.check_size(column, variance)
        }
    }

    fn check_size(&self, column: usize, value: f64) -> Result<(), InputError> {
        if value.is_finite() {
            Ok(())
        } else {
            Err(self.refuse_cell(column, "a number of a measurable size"))
        }
    }

    fn whole_number(&self, column: usize) -> Result<u32, InputError> {
        // Tables that went through a spreadsheet say 3.0 for 3.
        if let Ok(number) = self.cells[column].text.parse::<f64>()
            && number.fract() == 0.0
            && (0.0..=f64::from(u32::MAX)).contains(&number)
        {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "checked just above"
            )]
            return Ok(number as u32);
        }
        let expected = "a whole number from 0 to 4294967295, the number of the pose; where the column holds names, no pose column (in a \
                        column map: leave `pose` out): the rows then count from 1";
        Err(self.refuse_cell(column, expected))
    }

    fn direction(&self, column: usize) -> Result<i8, InputError> {
        match self.cells[column].text.parse::<f64>() {
            Ok(-1.0) => Ok(-1),
            Ok(0.0) => Ok(0),
            Ok(1.0) => Ok(1),
            _ => Err(self.refuse_cell(column, "-1, 0 or 1")),
        }
    }
}

/// Writes a measurement file in calibrig's own columns (see [`ColumnMap`]); every number reads back to the same bits.
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
                Reading::Spherical(reading) if spherical => Some(reading.covariance),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::tests::base_from_flange;
    use crate::{Robot, load_robot, parse_column_map};
    use calibrig_model::geometry::{Transform, best_fit_transform, cross_matrix, small_displacement};
    use nalgebra::{DMatrix, DVector, Point3, Vector6};
    use proptest::prelude::*;

    const KINDS: [JointKind; 2] = [JointKind::Prismatic, JointKind::Revolute];

    const OWN: &str = "pose,station,target,q1_m,q2_rad,range_m,az_rad,el_rad,sigma_range_m,sigma_az_rad,sigma_el_rad,time_s,temperature_c,approach1,approach2\n\
        7,front,smr,0.5,-1.25,3.5,0.25,-0.125,1e-5,2e-6,3e-6,12.5,21.5,1,-1\n\
        8,back,smr,0.75,1.25,4.5,0.5,0.125,1e-5,2e-6,3e-6,14.5,,0,0\n";

    fn own(text: &str) -> Result<LoadedMeasurements, InputError> {
        parse_measurements(&Source::new("set.csv", text), &ColumnMap::default(), &KINDS)
    }

    fn map(text: &str) -> ColumnMap {
        let head = "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\nrevolute_unit = \"deg\"\nprismatic_unit = \"mm\"\n";
        parse_column_map(&Source::new("columns.toml", format!("{head}{text}"))).expect("a valid map")
    }

    fn mapped(text: &str, map: &ColumnMap) -> Result<LoadedMeasurements, InputError> {
        parse_measurements(&Source::new("set.csv", text), map, &KINDS)
    }

    #[test]
    fn a_map_of_other_columns_does_not_keep_own_columns_from_being_read() {
        let map =
            map("[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = [\"x\"]\ny = [\"y\"]\nz = [\"z\"]\n");
        let refused = mapped(OWN, &map).expect_err("an explicit map is what holds");
        assert!(refused.to_string().contains("column s is missing"), "{refused}");
        let either = map.or_own();
        assert_eq!(mapped(OWN, &either).expect("own columns"), own(OWN).expect("valid"));
        let theirs = mapped("s,t,x,y,z,q1_m\n1000,180,1,2,3,4\n", &either).expect("mapped columns");
        assert_eq!(theirs.set.observations[0].command, [1.0, std::f64::consts::PI]);
        let neither = mapped("s1,t1,x,y,z\n1,2,3,4,5\n", &either).expect_err("no such columns");
        assert!(neither.to_string().contains("column s is missing"), "{neither}");
    }

    #[test]
    fn own_columns_are_read() {
        let loaded = own(OWN).expect("valid");
        let set = &loaded.set;
        assert_eq!(set.stations.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["front", "back"]);
        assert_eq!(set.targets.len(), 1);
        assert_eq!((set.targets[0].in_flange, set.targets[0].covariance), (Vector3::zeros(), None));
        let first = &set.observations[0];
        assert_eq!(
            (first.pose, first.command.as_slice(), first.approach.as_slice()),
            (7, &[0.5, -1.25][..], &[1, -1][..])
        );
        assert_eq!((first.time, first.temperature, first.station, first.target), (12.5, Some(21.5), 0, 0));
        let Reading::Spherical(reading) = &first.reading else { panic!("spherical") };
        assert_eq!((reading.range, reading.azimuth, reading.elevation), (3.5, 0.25, -0.125));
        assert_eq!(
            reading.covariance,
            Matrix3::from_diagonal(&Vector3::new(1e-5 * 1e-5, 2e-6 * 2e-6, 3e-6 * 3e-6))
        );
        assert_eq!((set.observations[1].station, set.observations[1].temperature), (1, None));
        assert!(loaded.dropped.is_empty());
    }

    #[test]
    fn a_minimal_own_file_is_enough() {
        let loaded = own("q1_m;q2_rad;x_m;y_m;z_m\n1;2;3;4;5\n").expect("valid");
        let observation = &loaded.set.observations[0];
        assert_eq!(
            (observation.pose, observation.time, observation.approach.as_slice()),
            (1, 0.0, &[0, 0][..])
        );
        assert_eq!(
            observation.reading,
            Reading::Cartesian { position: Vector3::new(3.0, 4.0, 5.0), covariance: None }
        );
        assert_eq!((loaded.set.stations.len(), loaded.set.targets.len()), (1, 1));
    }

    #[test]
    fn exports_with_comments_other_delimiters_and_units_are_read() {
        let cartesian = map(
            "[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = [\"x t\", \"dx\"]\ny = [\"y\", \"-dy\"]\nz = [\"z\"]\n[columns]\npose = \"No\"\n",
        );
        for text in [
            "// exported\n# mm\n\"No\",s,t,x t,dx,y,dy,z\n3,500,90,1000,1,2000,2,3000\n",
            "No;s;t;x t;dx;y;dy;z;\r\n3.0; 500 ;90;1000;1;2000;2;3000;\r\n",
            "No\ts\tt\tx t\tdx\ty\tdy\tz\n\n3\t500\t90\t1000\t1\t2000\t2\t3000",
            "\u{feff}No s   t \"x t\" dx y dy z\n  3 500 90 1e3 1 2e3 2 3e3\n",
        ] {
            let loaded = mapped(text, &cartesian).expect("valid");
            let observation = &loaded.set.observations[0];
            assert_eq!(
                (observation.pose, observation.command.as_slice()),
                (3, &[0.5, std::f64::consts::FRAC_PI_2][..]),
                "{text}"
            );
            assert_eq!(observation.reading.position(), Vector3::new(1.001, 1.998, 3.0), "{text}");
        }
        let spherical = map(
            "[position]\nsystem = \"spherical\"\nrange = \"R\"\nrange_unit = \"mm\"\nazimuth = \"Az\"\nzenith = \"Ze\"\nangle_unit = \"deg\"\n\
            [sigma]\nrange = \"sR\"\nrange_unit = \"um\"\nazimuth = \"sA\"\nzenith = \"sZ\"\nangle_unit = \"arcsec\"\n",
        );
        let loaded = mapped("s,t,R,Az,Ze,sR,sA,sZ\n0,0,2000,90,60,10,1,2\n0,0,2000,90,60,,,\n", &spherical)
            .expect("valid");
        let expected = Vector3::new(0.0, 2.0 * 60f64.to_radians().sin(), 1.0);
        for observation in &loaded.set.observations {
            assert!((observation.reading.position() - expected).norm() < 1e-15);
        }
        let Reading::Spherical(reading) = &loaded.set.observations[0].reading else { panic!("spherical") };
        assert!((reading.elevation - 30f64.to_radians()).abs() < 1e-15);
        let sigmas = reading.covariance.diagonal().map(f64::sqrt);
        let arcsec = std::f64::consts::PI / 648_000.0;
        assert!((sigmas - Vector3::new(10e-6, arcsec, 2.0 * arcsec)).norm() < 1e-18);
        assert!(matches!(loaded.set.observations[1].reading, Reading::Cartesian { covariance: None, .. }));
    }

    #[test]
    fn covariances_that_no_scatter_has_are_refused_at_their_row() {
        let head = "q1_m,q2_rad,x_m,y_m,z_m,cov_xx_m2,cov_xy_m2,cov_xz_m2,cov_yy_m2,cov_yz_m2,cov_zz_m2\n\
                    0,0,1,0,0,4e-10,1e-10,0,1e-10,0,1e-10\n";
        for (row, message, place) in [
            ("4e-10,2.1e-10,0,1e-10,0,1e-10", "cov_zz_m2 is not positive definite", "4e-10"),
            ("4e-10,0,0,0,0,1e-10", "cov_yy_m2 is \"0\": a variance of 0 was read", "0"),
            ("4e-10,0,0,1e-10,0,-1e-10", "cov_zz_m2 is \"-1e-10\"", "-1e-10"),
        ] {
            let text = format!("{head}0,0,2,0,0,{row}\n");
            match own(&text) {
                Err(InputError::Invalid { message: found, line: 3, span, .. }) => {
                    assert!(found.contains(message), "{found}");
                    assert_eq!(&text[span.offset()..span.offset() + span.len()], place);
                }
                other => panic!("{row}: {other:?}"),
            }
        }
        own(head).expect("a correlation of one half");
    }

    #[test]
    fn missed_shots_are_left_out_and_reported() {
        let loaded =
            own("pose,q1_m,q2_rad,range_m,az_rad,el_rad\n4,0,0,0,0,0\n5,0,0,1,0,0\n").expect("valid");
        assert_eq!(loaded.dropped.iter().map(|(pose, _)| *pose).collect::<Vec<_>>(), [4]);
        assert!(loaded.dropped[0].1.contains("missed shot"));
        assert_eq!(loaded.set.observations.len(), 1);
        let loaded = own("q1_m,q2_rad,x_m,y_m,z_m\n0,0,1,0,0\n0,0,0,0,-0.0\n").expect("valid");
        assert_eq!((loaded.set.observations.len(), loaded.dropped[0].0), (1, 2));
    }

    #[test]
    fn every_mistake_is_named_with_its_line_and_what_was_expected() {
        for (from, to, message, line, help, underlined) in [
            (OWN, "", "the file is empty", 1, "names of the columns", ""),
            (OWN, "# nothing\n\n", "the file is empty", 1, "names of the columns", ""),
            (
                &OWN[..OWN.find('\n').unwrap()],
                "1,2,3,4,5,6,7,8",
                "the header is missing",
                1,
                "first line",
                "1,2,3,4,5,6,7,8",
            ),
            (
                &OWN[OWN.find('\n').unwrap()..],
                "\n\n,,,,\n",
                "no measurements below the header",
                1,
                "row",
                "pose",
            ),
            ("q2_rad", "q2_deg", "column q2_rad is missing", 1, "found pose, station", "pose"),
            ("temperature_c", "el_rad", "column el_rad is there twice", 1, "distinct", "pose"),
            ("sigma_az_rad", "sigma_azimuth", "column sigma_az_rad is missing", 1, "found", "pose"),
            ("approach2", "approach", "column approach2 is missing", 1, "found", "pose"),
            ("time_s", "q3_rad", "a column q3_rad, the robot has 2 joints", 1, "own columns", "pose"),
            ("time_s", "x_m", "both x_m", 1, "own columns", "pose"),
            ("time_s", "cov_az_az_rad2", "both sigma and cov", 1, "own columns", "pose"),
            ("0.5,-1.25", "0.5,left", "column q2_rad is \"left\"", 2, "a number", "left"),
            ("0.5,-1.25", "\"0,5\",-1.25", "column q1_m is \"0,5\"", 2, "decimal point", "\"0,5\""),
            ("0.5,-1.25", "0.5,", "column q2_rad is empty", 2, "a number", "7,front"),
            ("0.5,-1.25", "0.5,NaN", "column q2_rad is \"NaN\"", 2, "finite", "NaN"),
            ("4.5,0.5", "-inf,0.5", "column range_m is \"-inf\"", 3, "finite", "-inf"),
            ("4.5,0.5", "1e999,0.5", "column range_m is \"1e999\"", 3, "finite", "1e999"),
            ("4.5,0.5", "-4.5,0.5", "column range_m is \"-4.5\"", 3, "above zero", "-4.5"),
            ("7,front", "-7,front", "column pose is \"-7\"", 2, "whole number", "-7"),
            ("7,front", "7.5,front", "column pose is \"7.5\"", 2, "whole number", "7.5"),
            ("7,front", "4294967296,front", "column pose", 2, "whole number", "4294967296"),
            ("1,-1\n", "1,2\n", "column approach2 is \"2\"", 2, "-1, 0 or 1", "2"),
            (
                "1,-1\n",
                "1\n",
                "the row has 14 of 15 columns, approach2 is missing",
                2,
                "15 values",
                "7,front",
            ),
            ("1,-1\n", "1,-1,5\n", "the row has 16 columns, the header 15", 2, "15 values", "5"),
            ("7,front", "P7,front", "column pose is \"P7\"", 2, "holds names, no pose column", "P7"),
            ("1,-1\n", "1,left\n", "column approach2 is \"left\"", 2, "-1, 0 or 1", "left"),
            ("2e-6", "-2e-6", "column sigma_az_rad is \"-2e-6\"", 2, "deviation above zero", "-2e-6"),
            ("2e-6", "NaN", "column sigma_az_rad is \"NaN\"", 2, "finite", "NaN"),
            (
                "2e-6",
                "0.000",
                "sigma_az_rad is \"0.000\": a standard deviation of 0 was read",
                2,
                "rounds",
                "0.000",
            ),
            ("2e-6", "1e-200", "sigma_az_rad is \"1e-200\": a variance of 0 was read", 2, "empty", "1e-200"),
            ("2e-6", "2e200", "column sigma_az_rad is \"2e200\"", 2, "size", "2e200"),
            (",3e-6", ",", "column sigma_el_rad is empty", 2, "number", "7,front"),
            ("front", "\"front", "the quote is not closed", 2, "pairs", "\"front"),
        ] {
            assert!(OWN.contains(from), "{from}");
            let text = OWN.replacen(from, to, 1);
            match own(&text) {
                Err(InputError::Invalid { message: found, line: at, help: expected, span, .. }) => {
                    assert!(found.contains(message), "{to}: {found}");
                    assert!(expected.as_deref().unwrap_or_default().contains(help), "{to}: {expected:?}");
                    assert_eq!(at, line, "{to}: {found}");
                    let place = &text[span.offset()..span.offset() + span.len()];
                    assert!(place.starts_with(underlined), "{to}: {place}");
                }
                other => panic!("{to}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_map_that_does_not_fit_the_robot_is_refused() {
        let position =
            "[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = [\"x\"]\ny = [\"y\"]\nz = [\"z\"]\n";
        let text = Source::new("set.csv", "s,t,x,y,z\n1,2,3,4,5\n");
        let refusal = |map: &ColumnMap, joints: &[JointKind]| {
            parse_measurements(&text, map, joints).unwrap_err().to_string()
        };
        let both = map(position);
        assert!(
            refusal(&both, &[JointKind::Revolute; 3])
                .contains("names 2 joint columns, the robot has 3 joints")
        );
        let no_units =
            format!("schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\n{position}");
        let no_units = parse_column_map(&Source::new("columns.toml", no_units)).expect("valid");
        assert!(refusal(&no_units, &[JointKind::Revolute; 2]).contains("no revolute_unit"));
        assert!(refusal(&no_units, &[JointKind::Prismatic; 2]).contains("no prismatic_unit"));
    }

    #[test]
    fn absent_files_and_folders_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let read =
            |path: &Path| read_measurements(path, &ColumnMap::default(), &KINDS).unwrap_err().to_string();
        assert!(read(&folder.path().join("absent.csv")).contains("absent.csv"));
        assert!(read(folder.path()).contains("folder"));
        let set = own(OWN).unwrap().set;
        let error = write_measurements(folder.path(), &set, &KINDS).unwrap_err();
        assert!(error.to_string().starts_with("cannot write"), "{error}");
        // The CLI prints it with the source underlined.
        let path = folder.path().join("bad.csv");
        std::fs::write(&path, OWN.replace("-1.25", "left")).unwrap();
        let error = read_measurements(&path, &ColumnMap::default(), &KINDS).unwrap_err();
        let drawn = format!("{:?}", miette::Report::new(error));
        assert!(
            drawn.contains("bad.csv:2: column q2_rad is \"left\"") && drawn.contains("7,front,smr"),
            "{drawn}"
        );
    }

    #[test]
    fn sets_that_could_not_be_read_back_are_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("set.csv");
        let good = own(OWN).unwrap().set;
        let refusal = |change: &dyn Fn(&mut MeasurementSet)| {
            let mut set = good.clone();
            change(&mut set);
            write_measurements(&path, &set, &KINDS).unwrap_err()
        };
        assert!(
            matches!(refusal(&|s| s.observations[1].command[1] = f64::NAN), CsvError::NotFinite { pose: 8, column, .. } if column == "q2_rad")
        );
        assert!(
            matches!(refusal(&|s| s.observations[0].time = f64::INFINITY), CsvError::NotFinite { column, .. } if column == "time_s")
        );
        assert!(matches!(
            refusal(&|s| s.observations[0].command.push(1.0)),
            CsvError::JointCount { pose: 7, found: 3, expected: 2, .. }
        ));
        assert!(matches!(
            refusal(&|s| s.observations[0].approach.clear()),
            CsvError::JointCount { found: 0, .. }
        ));
        assert!(matches!(
            refusal(&|s| s.observations[0].approach[0] = 2),
            CsvError::Approach { pose: 7, value: 2 }
        ));
        assert!(matches!(
            refusal(&|s| s.observations[1].station = 2),
            CsvError::Missing { pose: 8, index: 2, .. }
        ));
        assert!(matches!(refusal(&|s| s.targets.clear()), CsvError::Missing { what: "target", .. }));
        for name in ["back", " front", "fr\nont"] {
            assert!(matches!(
                refusal(&|s| s.stations[0].name = name.to_owned()),
                CsvError::Name { what: "station", .. }
            ));
        }
        let position = Vector3::x();
        let mixed =
            refusal(&|s| s.observations[1].reading = Reading::Cartesian { position, covariance: None });
        assert!(matches!(mixed, CsvError::MixedReadings { pose: 8 }));
        assert!(!path.exists());
    }

    fn finite() -> impl Strategy<Value = f64> {
        any::<f64>().prop_filter("finite", |number| number.is_finite())
    }

    fn observation(spherical: bool, diagonal: bool) -> impl Strategy<Value = Observation> {
        let parts = (
            (any::<u32>(), prop::collection::vec(finite(), 2), prop::collection::vec(-1i8..=1, 2)),
            (
                prop::option::of(finite()),
                finite(),
                prop::array::uniform3(finite()),
                prop::array::uniform6(-1e-3f64..1e-3),
            ),
            any::<bool>(),
        );
        parts.prop_map(move |((pose, command, approach), (temperature, time, place, c), stated)| {
            let c = c.map(|value| value + f64::copysign(1e-9, value));
            let covariance = if diagonal {
                Matrix3::from_diagonal(&Vector3::new(c[0] * c[0], c[1] * c[1], c[2] * c[2]))
            } else {
                // A diagonal that outweighs its rows makes it positive definite.
                let least = c[1].abs() + c[2].abs() + c[4].abs();
                let [x, y, z] = [c[0], c[3], c[5]].map(|value| least + value.abs());
                Matrix3::new(x, c[1], c[2], c[1], y, c[4], c[2], c[4], z)
            };
            let [x, y, z] = place;
            let reading = if spherical {
                let range = x.abs().max(f64::MIN_POSITIVE);
                Reading::Spherical(SphericalReading { range, azimuth: y, elevation: z, covariance })
            } else {
                let position = Vector3::new(x, y, if (x, y, z) == (0.0, 0.0, 0.0) { 1.0 } else { z });
                Reading::Cartesian { position, covariance: stated.then_some(covariance) }
            };
            Observation { pose, command, approach, temperature, time, station: 0, target: 0, reading }
        })
    }

    fn set() -> impl Strategy<Value = MeasurementSet> {
        (any::<bool>(), any::<bool>()).prop_flat_map(|(spherical, diagonal)| {
            let observations = prop::collection::vec(observation(spherical, diagonal), 1..6);
            (observations, "[a-z ,;\"#/.é0-9]{0,8}", "[A-Z]{1,3}").prop_map(
                |(mut observations, station, target)| {
                    // The second half was taken from a second station.
                    let half = observations.len().div_ceil(2);
                    let mut stations = vec![Station { name: station.trim().to_owned(), nests: Vec::new() }];
                    if half < observations.len() {
                        stations.push(Station { name: "second".to_owned(), nests: Vec::new() });
                        observations[half..].iter_mut().for_each(|o| o.station = 1);
                    }
                    let targets =
                        vec![Target { name: target, in_flange: Vector3::zeros(), covariance: None }];
                    MeasurementSet { stations, targets, observations }
                },
            )
        })
    }

    /// Equality of bits, which `==` is not for zeros; `Debug` prints the sign of a zero and shortest digits that tell numbers apart.
    fn bits(set: &MeasurementSet) -> String {
        format!("{set:?}")
    }

    fn ur5_map() -> ColumnMap {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/ur5/columns.toml");
        crate::load_column_map(&path).expect("the map of the repository").0
    }

    const UR5_FILE: &str = "step_order,x_t,y_t,z_t,x_dif,y_dif,z_dif,joint_1,joint_2,joint_3,joint_4,joint_5,joint_6\n\
        0,-430.3,-6.2,-98.6,-2.1,-3.5,0.8,-22.9,-43.7,135.4,-94.7,55.4,-5.5\n1,-463.7,-3.9,-104.9,-2.1,-2.9,-0.03,-19.7,-45.9,127.6,-71.4,63.3,-12.7\n";

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]
        #[test]
        fn what_is_written_reads_back_to_the_same_bits(set in set()) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("set.csv");
            write_measurements(&path, &set, &KINDS).unwrap();
            let loaded = read_measurements(&path, &ColumnMap::default(), &KINDS).unwrap();
            prop_assert_eq!(bits(&loaded.set), bits(&set));
            prop_assert!(loaded.dropped.is_empty());
        }

        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("set.csv");
            std::fs::write(&path, &bytes).unwrap();
            prop_assert!(read_measurements(&path, &ColumnMap::default(), &KINDS).is_err());
            let text = Source::new("set.csv", String::from_utf8_lossy(&bytes));
            prop_assert!(parse_measurements(&text, &ur5_map(), &[JointKind::Revolute; 6]).is_err());
        }

        #[test]
        fn no_mutation_of_a_file_panics(
            at in 0usize..400, remove in 0usize..40, insert in "\\PC{0,4}|[\",;\t\r\n #/]{0,6}|nan|inf|1e308|-|0"
        ) {
            for (text, map, joints) in [
                (OWN, ColumnMap::default(), &KINDS[..]),
                (UR5_FILE, ur5_map(), &[JointKind::Revolute; 6]),
            ] {
                let mut text: Vec<char> = text.chars().collect();
                let at = at.min(text.len());
                let end = (at + remove).min(text.len());
                text.splice(at..end, insert.chars());
                let source = Source::new("set.csv", text.into_iter().collect::<String>());
                match parse_measurements(&source, &map, joints) {
                    Ok(loaded) => {
                        for observation in &loaded.set.observations {
                            prop_assert_eq!(observation.command.len(), joints.len());
                            prop_assert!(observation.command.iter().all(|q| q.is_finite()));
                            prop_assert!(observation.reading.position().iter().all(|x| x.is_finite()));
                        }
                    }
                    Err(error) => {
                        let drawn = format!("{:?}", miette::Report::new(error));
                        prop_assert!(!drawn.is_empty());
                    }
                }
            }
        }
    }

    /// Positions of the real data are compared with the nominal robot after a fit of base and target alone.
    struct RealData {
        robot: Robot,
        fitted_on: MeasurementSet,
        tested_on: MeasurementSet,
    }

    /// `None`, said aloud, where the data are not at hand.
    fn real_data(robot: &str, folder: &str) -> Option<RealData> {
        let Some(data) = std::env::var_os("CALIBRIG_DATA") else {
            eprintln!("SKIPPED: CALIBRIG_DATA is not set, the {folder} measurements are not read");
            return None;
        };
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models").join(robot).join("robot.toml");
        let robot = load_robot(&file).expect("the model of the repository");
        let columns = robot.sources.iter().find(|(role, _)| role == "columns").expect("named by robot.toml");
        let map = parse_column_map(&columns.1).expect("the map of the repository");
        let kinds: Vec<_> = robot.model.kinematics.links.iter().map(|link| link.kind).collect();
        let read = |name: &str| {
            let file = format!("3D_{folder}_uncalibrated_{name}_cleaned.csv");
            let loaded =
                read_measurements(&Path::new(&data).join("ur5_wam").join(folder).join(file), &map, &kinds);
            let loaded = loaded.unwrap_or_else(|e| panic!("{:?}", miette::Report::new(e)));
            assert!(loaded.dropped.is_empty());
            loaded.set
        };
        let (fitted_on, tested_on) = (read("grid"), read("random"));
        Some(RealData { robot, fitted_on, tested_on })
    }

    impl RealData {
        /// RMS and largest 3-D error on the test set, m, with base and target fitted by Gauss-Newton.
        fn nominal_error(&self) -> (f64, f64) {
            let chain = &self.robot.model.kinematics;
            let observations = &self.fitted_on.observations;
            let seen: Vec<_> = observations.iter().map(|o| o.reading.position()).collect();
            let flange: Vec<_> =
                observations.iter().map(|o| base_from_flange(chain, &o.command).translation.vector).collect();
            let mut tracker_from_base: Transform =
                best_fit_transform(&seen, &flange).expect("points in space");
            let mut target = Vector3::zeros();
            let error = |frame: &Transform, target: &Vector3<f64>, o: &Observation| {
                frame.rotation.inverse() * (o.reading.position() - frame.translation.vector)
                    - (base_from_flange(chain, &o.command) * Point3::from(*target)).coords
            };
            for _ in 0..10 {
                let mut jacobian = DMatrix::zeros(3 * observations.len(), 9);
                let mut residual = DVector::zeros(3 * observations.len());
                for (row, o) in observations.iter().enumerate() {
                    let flange = base_from_flange(chain, &o.command);
                    let carried = cross_matrix(&(flange * Point3::from(target)).coords);
                    let columns = [Matrix3::identity(), -carried, *flange.rotation.matrix()];
                    for (at, block) in columns.iter().enumerate() {
                        jacobian.fixed_view_mut::<3, 3>(3 * row, 3 * at).copy_from(block);
                    }
                    residual.fixed_rows_mut::<3>(3 * row).copy_from(&error(&tracker_from_base, &target, o));
                }
                let step = jacobian.svd(true, true).solve(&residual, 1e-12).expect("both factors");
                tracker_from_base *= small_displacement(&Vector6::from_column_slice(&step.as_slice()[..6]));
                target += Vector3::new(step[6], step[7], step[8]);
            }
            let errors: Vec<f64> = self
                .tested_on
                .observations
                .iter()
                .map(|o| error(&tracker_from_base, &target, o).norm())
                .collect();
            let mean_square = errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64;
            (mean_square.sqrt(), errors.into_iter().fold(0.0, f64::max))
        }
    }

    /// Reference figures of an independent program on the same data: RMS 0.561 mm, largest 1.14 mm.
    #[test]
    fn the_ur5_data_are_as_far_from_the_nominal_robot_as_known() {
        let Some(data) = real_data("ur5", "UR5") else { return };
        assert_eq!((data.fitted_on.observations.len(), data.tested_on.observations.len()), (1000, 20));
        let first = &data.fitted_on.observations[0];
        assert_eq!(first.pose, 0);
        assert!((first.command[0] + 22.933_297_010_882_566_f64.to_radians()).abs() < 1e-15);
        assert!(
            (first.reading.position().x - (-0.430_327_840_758_850_1 - 0.002_144_122_241_149_887)).abs()
                < 1e-15
        );
        let (rms, largest) = data.nominal_error();
        eprintln!("UR5: RMS {:.4} mm, largest {:.3} mm", rms * 1e3, largest * 1e3);
        assert!((rms - 0.561e-3).abs() < 0.5e-6 && (largest - 1.14e-3).abs() < 5e-6, "{rms} {largest}");
    }

    /// Reference figures of an independent program on the same data: RMS 4.66 mm, largest 10.5 mm.
    #[test]
    fn the_wam_data_are_as_far_from_the_nominal_robot_as_known() {
        let Some(data) = real_data("wam", "WAM") else { return };
        assert_eq!((data.fitted_on.observations.len(), data.tested_on.observations.len()), (216, 20));
        let (rms, largest) = data.nominal_error();
        eprintln!("WAM: RMS {:.3} mm, largest {:.2} mm", rms * 1e3, largest * 1e3);
        assert!((rms - 4.66e-3).abs() < 5e-6 && (largest - 10.5e-3).abs() < 5e-5, "{rms} {largest}");
    }
}
