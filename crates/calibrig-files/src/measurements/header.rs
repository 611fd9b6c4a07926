//! Finding the columns of a map in the header of a table.

use std::fmt;

use super::columns::{
    ColumnRef, Entry, FaceColumn, Mapping, Noise, PayloadColumns, PolarAngle, PositionColumns,
    RotationColumns, Sets, SigmaUnits, Uncertainty,
};
use super::layout::Column;
use super::rows::Row;
use super::times::TimeColumns;
use super::units::{AirQuantity, AngleUnit, HeaderUnit, LengthUnit, TemperatureUnit, TimeUnit};
use crate::input::{InputError, Source};
use crate::rotation::RotationForm;
use calibrig_model::{JointKind, Payload};

/// Columns of one file.
#[derive(Clone, Copy)]
pub(super) struct FileColumns<'a> {
    pub name: &'a str,
    pub head: &'a Row,
    pub has_header: bool,
    pub columns: &'a [Column],
}

impl FileColumns<'_> {
    pub fn refuse(&self, message: impl fmt::Display, expected: &str) -> InputError {
        if self.has_header {
            return self.head.refuse(self.name, None, message, expected);
        }
        let help = Some(format!("expected {expected}"));
        InputError::Place { place: self.name.to_owned(), message: message.to_string(), help }
    }

    /// Names of the columns, as many as a message can hold.
    pub fn names(&self) -> String {
        const MOST: usize = 40;
        let names = self.columns.iter().take(MOST).map(|column| match column.header.char_indices().nth(60) {
            Some((end, _)) => format!("{}…", &column.header[..end]),
            None => column.header.clone(),
        });
        let names = names.collect::<Vec<_>>().join(", ");
        match self.columns.len().checked_sub(MOST) {
            Some(more @ 1..) => format!("{names} and {more} more"),
            _ => names,
        }
    }

    /// The column of an entry that is a single one, from 0.
    pub fn find(&self, column: &ColumnRef) -> Result<Option<usize>, InputError> {
        let wanted = match column {
            ColumnRef::Number(number) => {
                return match number.checked_sub(1).filter(|index| *index < self.columns.len()) {
                    Some(index) => Ok(Some(index)),
                    None => Err(self.refuse(
                        format!("column {number} is missing: the rows have {} columns", self.columns.len()),
                        &format!("a column from 1 to {}", self.columns.len()),
                    )),
                };
            }
            ColumnRef::Name(name) => name.as_str(),
        };
        let matching = |is_it: &dyn Fn(&Column) -> bool| {
            let mut at = (0..self.columns.len()).filter(|index| is_it(&self.columns[*index]));
            (at.next(), at.next())
        };
        let found = match matching(&|column| column.header == wanted) {
            (None, _) => matching(&|column| column.name() == wanted),
            found => found,
        };
        match found {
            (Some(_), Some(_)) => {
                let expected = "distinct names of columns; or, in a column map, the number of the column: 7 (in a sum: #7)";
                Err(self.refuse(format!("column {wanted} appears twice"), expected))
            }
            (found, _) => Ok(found),
        }
    }
}

/// Where the mapped columns are in the rows, and in which units.
pub(super) struct Columns {
    pub joints: Vec<Quantity>,
    pub position: Position,
    pub rotation: Option<RotationQuantities>,
    pub uncertainty: Option<UncertaintyColumns>,
    pub noise: Option<Noise>,
    pub pose: Option<usize>,
    /// Whether the pose may be a name instead of a number.
    pub names_poses: bool,
    pub station: Option<usize>,
    pub target: Option<usize>,
    pub time: Option<TimeColumns>,
    pub temperature: Option<Quantity>,
    pub temperature_unit: TemperatureUnit,
    pub air: Vec<(AirQuantity, Quantity)>,
    /// The column, and what stands in it.
    pub face: Option<(usize, FaceColumn)>,
    pub approach: Vec<Quantity>,
    pub payload: Option<PayloadQuantities>,
    pub since_reversal: Vec<Quantity>,
    pub sets: Sets,
    pub set: Option<usize>,
}

/// A signed sum of columns.
pub(super) struct Quantity {
    pub terms: Vec<QuantityTerm>,
    /// Whether all terms have the unit of the first.
    pub is_uniform: bool,
}

#[derive(Clone, Copy)]
pub(super) struct QuantityTerm {
    pub column: usize,
    pub sign: f64,
    pub scale: Scale,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scale {
    One,
    Length(LengthUnit),
    Angle(AngleUnit),
}

impl Scale {
    pub fn in_si(self, value: f64) -> f64 {
        match self {
            Self::One => value,
            Self::Length(unit) => unit.in_si(value),
            Self::Angle(unit) => unit.in_si(value),
        }
    }

    fn key(self) -> &'static str {
        match self {
            Self::One => "",
            Self::Length(unit) => unit.key(),
            Self::Angle(unit) => unit.key(),
        }
    }
}

pub(super) enum Position {
    Cartesian([Quantity; 3]),
    Spherical { range: Quantity, azimuth: Quantity, polar: Quantity, polar_angle: PolarAngle },
}

impl Position {
    pub fn quantities(&self) -> [&Quantity; 3] {
        match self {
            Self::Cartesian([x, y, z]) => [x, y, z],
            Self::Spherical { range, azimuth, polar, .. } => [range, azimuth, polar],
        }
    }
}

pub(super) enum UncertaintyColumns {
    Sigmas {
        columns: [Quantity; 3],
        coverage: f64,
    },
    Covariance([Quantity; 6]),
    /// Of a full pose, 21 or 36; a unit of each of its six coordinates in SI.
    Pose {
        columns: Vec<Quantity>,
        scales: [f64; 6],
    },
}

/// Columns with what the flange carries.
pub(super) enum PayloadQuantities {
    /// The name of one of these.
    Named { column: usize, known: Vec<Payload> },
    /// Mass and centre, and name and force where there are such columns.
    Numbers { name: Option<usize>, mass: Quantity, centre: Vec<Quantity>, force: Vec<Quantity> },
}

/// Columns with a rotation.
pub(super) struct RotationQuantities {
    pub form: RotationForm,
    pub columns: Vec<Quantity>,
    pub is_of_tracker: bool,
    /// Standard deviations about the axes, one or three, and how many of them the columns state.
    pub sigma: Option<(Vec<Quantity>, f64)>,
}

/// What kind of quantity a column holds, and the unit that the map states, with its key.
#[derive(Clone, Copy)]
enum Kind {
    Plain,
    Length(Option<LengthUnit>, &'static str),
    Angle(Option<AngleUnit>, &'static str),
}

/// Finds columns in the header of a table, or of two that are joined.
pub(super) struct Head<'a> {
    pub points: FileColumns<'a>,
    /// The file of the commands, where it is one of its own.
    pub joints: Option<FileColumns<'a>>,
    /// The map, for messages.
    pub map: Option<&'a Source>,
    /// Units taken from the header, in words.
    pub remarks: Vec<String>,
    /// Units from the header: the unit and its columns.
    from_header: Vec<(&'static str, Vec<String>)>,
}

impl<'a> Head<'a> {
    pub fn new(points: FileColumns<'a>, joints: Option<FileColumns<'a>>, map: Option<&'a Source>) -> Self {
        Self { points, joints, map, remarks: Vec::new(), from_header: Vec::new() }
    }

    /// All columns, those of the joints' file behind the others.
    pub fn all(&self) -> Vec<Column> {
        self.points.columns.iter().chain(self.joints.iter().flat_map(|file| file.columns)).cloned().collect()
    }

    pub fn columns(&mut self, mapping: &Mapping, joints: &[JointKind]) -> Result<Columns, InputError> {
        let commands = self.commands(mapping, joints)?;
        let columns = Columns {
            joints: commands,
            position: self.position(&mapping.position)?,
            rotation: mapping.rotation.as_ref().map(|columns| self.rotation(columns)).transpose()?,
            uncertainty: mapping.uncertainty.as_ref().map(|columns| self.uncertainty(columns)).transpose()?,
            noise: mapping.noise,
            pose: self.optional(mapping.pose.as_ref())?,
            names_poses: self.map.is_some(),
            station: self.optional(mapping.station.as_ref())?,
            target: self.optional(mapping.target.as_ref())?,
            time: mapping.time.as_ref().map(|entry| self.time(entry, mapping.time_unit)).transpose()?,
            temperature: mapping
                .temperature
                .as_ref()
                .map(|entry| self.quantity(entry, Kind::Plain, false))
                .transpose()?,
            temperature_unit: mapping.temperature_unit,
            air: mapping
                .air
                .iter()
                .map(|(what, entry)| Ok((*what, self.quantity(entry, Kind::Plain, false)?)))
                .collect::<Result<_, InputError>>()?,
            face: match &mapping.face {
                Some(face) => self.optional(Some(&face.column))?.map(|column| (column, face.clone())),
                None => None,
            },
            approach: self.quantities(&mapping.approach, Kind::Plain)?,
            payload: mapping.payload.as_ref().map(|columns| self.payload(columns)).transpose()?,
            // In SI units, as calibrig writes them.
            since_reversal: self.quantities(&mapping.since_reversal, Kind::Plain)?,
            set: self.optional(mapping.sets.column.as_ref())?,
            sets: mapping.sets.clone(),
        };
        for (unit, names) in std::mem::take(&mut self.from_header) {
            self.remarks.push(format!(
                "{}: {} in {unit}, as the header says",
                self.points.name,
                names.join(", ")
            ));
        }
        Ok(columns)
    }

    /// Index of a column in joined rows: of the file where it is looked for first, else of the other.
    fn find(&self, column: &ColumnRef, is_joint: bool) -> Result<usize, InputError> {
        let behind = self.points.columns.len();
        let in_points = |this: &Self| this.points.find(column);
        let in_joints = |this: &Self| match &this.joints {
            Some(file) => Ok(file.find(column)?.map(|index| behind + index)),
            None => Ok(None),
        };
        let found = match (is_joint && self.joints.is_some(), column) {
            (true, ColumnRef::Number(_)) => in_joints(self)?,
            (true, _) => in_joints(self)?.map_or_else(|| in_points(self), |at| Ok(Some(at)))?,
            (false, ColumnRef::Number(_)) => in_points(self)?,
            (false, _) => in_points(self)?.map_or_else(|| in_joints(self), |at| Ok(Some(at)))?,
        };
        found.ok_or_else(|| {
            let wanted = match column {
                ColumnRef::Name(name) => name.clone(),
                ColumnRef::Number(number) => number.to_string(),
            };
            let file = if is_joint { self.joints.unwrap_or(self.points) } else { self.points };
            if !file.has_header {
                let expected = "columns by number, x = 7, where a file has no header";
                return file.refuse(format!("column {wanted} is missing: the file has no header"), expected);
            }
            let expected = format!("a column {wanted}; found {}", file.names());
            file.refuse(format!("column {wanted} is missing"), &expected)
        })
    }

    pub fn optional(&self, entry: Option<&Entry>) -> Result<Option<usize>, InputError> {
        entry.map(|entry| self.single(entry)).transpose()
    }

    fn single(&self, entry: &Entry) -> Result<usize, InputError> {
        // The name of one column may have a sign in it.
        let column = match entry.terms.as_slice() {
            [term] if term.sign > 0.0 => term.column.clone(),
            _ => ColumnRef::Name(entry.written.clone()),
        };
        self.find(&column, false)
    }

    fn time(&self, entry: &Entry, unit: TimeUnit) -> Result<TimeColumns, InputError> {
        let key = format!("time_{}", unit.key());
        let file =
            if entry.terms.iter().all(|term| self.points.find(&term.column).is_ok_and(|at| at.is_some())) {
                self.points
            } else {
                self.joints.unwrap_or(self.points)
            };
        TimeColumns::of(entry, Some((unit, &key)), &file, &|column| self.find(column, false), &|index| {
            self.file_of(index).1
        })
    }

    fn quantity(&mut self, entry: &Entry, kind: Kind, is_joint: bool) -> Result<Quantity, InputError> {
        let whole = ColumnRef::Name(entry.written.clone());
        let is_sum = entry.terms.iter().all(|term| term.column != whole);
        // If a header has the whole text, it means that column.
        let as_one = if is_sum { self.find(&whole, is_joint).ok() } else { None };
        let terms: Vec<(usize, f64, bool)> = match as_one {
            Some(column) => vec![(column, 1.0, false)],
            None => entry
                .terms
                .iter()
                .map(|term| {
                    let by_number = matches!(term.column, ColumnRef::Number(_));
                    Ok((self.find(&term.column, is_joint)?, term.sign, by_number))
                })
                .collect::<Result<_, InputError>>()?,
        };
        let terms: Vec<QuantityTerm> = terms
            .into_iter()
            .map(|(column, sign, by_number)| {
                Ok(QuantityTerm { column, sign, scale: self.scale(column, kind, by_number)? })
            })
            .collect::<Result<_, InputError>>()?;
        let is_uniform = terms.iter().all(|term| term.scale == terms[0].scale);
        Ok(Quantity { terms, is_uniform })
    }

    fn file_of(&self, column: usize) -> (FileColumns<'a>, &'a Column) {
        match (column.checked_sub(self.points.columns.len()), &self.joints) {
            (Some(index), Some(file)) => (*file, &file.columns[index]),
            _ => (self.points, &self.points.columns[column]),
        }
    }

    /// The unit of a column: from the map and the header, which must agree.
    fn scale(&mut self, index: usize, kind: Kind, by_number: bool) -> Result<Scale, InputError> {
        let (file, column) = self.file_of(index);
        let name = &column.header;
        let (stated, key, expected) = match kind {
            Kind::Plain => return Ok(Scale::One),
            Kind::Length(unit, key) => (unit.map(Scale::Length), key, "mm, m, um, cm or inch"),
            Kind::Angle(unit, key) => {
                (unit.map(Scale::Angle), key, "deg, rad, mrad, urad, arcsec, gon or rev")
            }
        };
        let in_header = match (column.unit, kind) {
            (Some(HeaderUnit::Length(unit)), Kind::Length(..)) => Some(Scale::Length(unit)),
            (Some(HeaderUnit::Angle(unit)), Kind::Angle(..)) => Some(Scale::Angle(unit)),
            (Some(unit), _) if stated.is_none() || !by_number => {
                let message =
                    format!("column {name} is in {}, which is not a unit of this quantity", unit.key());
                let expected = format!(
                    "a column in {expected}; if the header is wrong, give the column's number and {key} in the column map"
                );
                return Err(file.refuse(message, &expected));
            }
            _ => None,
        };
        match (stated, in_header) {
            (Some(stated), Some(in_header)) if stated != in_header => {
                let message = format!(
                    "column {name} is in {} according to the header, but in {} according to the column map ({key})",
                    in_header.key(),
                    stated.key()
                );
                if by_number {
                    self.remarks.push(format!("{}: {message}: the column map holds", file.name));
                    return Ok(stated);
                }
                let expected = "the same unit in both; if the header is wrong, name the column by its number in the column \
                                map: x = 7";
                Err(file.refuse(message, expected))
            }
            (Some(stated), _) => Ok(stated),
            (None, Some(in_header)) => {
                let unit = in_header.key();
                match self.from_header.iter_mut().find(|(known, _)| *known == unit) {
                    Some((_, names)) if names.contains(name) => {}
                    Some((_, names)) => names.push(name.clone()),
                    None => self.from_header.push((unit, vec![name.clone()])),
                }
                Ok(in_header)
            }
            (None, None) => {
                let (table, unit) = key.split_once('.').unwrap_or_default();
                let message = format!(
                    "missing key `{unit}` in [{table}]: column {name} has no unit, since the header of {} does not give one \
                     after the name",
                    file.name
                );
                let help = format!("{unit} = {expected} in [{table}]");
                Err(match self.map {
                    Some(map) => map.error(map.place_of(table), message, Some(format!("expected {help}"))),
                    None => file.refuse(message, &help),
                })
            }
        }
    }

    /// The columns of the commands, with the units that the robot's joints need.
    pub fn commands(&mut self, mapping: &Mapping, joints: &[JointKind]) -> Result<Vec<Quantity>, InputError> {
        let (found, expected) = (mapping.joints.len(), joints.len());
        if found != expected {
            let message =
                format!("the column map names {found} joint columns, but the robot has {expected} joints");
            return Err(self.points.refuse(message, "one column per joint"));
        }
        let kind = |kind: &JointKind| match kind {
            JointKind::Revolute => Kind::Angle(mapping.revolute, "joints.revolute_unit"),
            JointKind::Prismatic => Kind::Length(mapping.prismatic, "joints.prismatic_unit"),
        };
        mapping
            .joints
            .iter()
            .zip(joints)
            .map(|(entry, joint)| self.quantity(entry, kind(joint), true))
            .collect()
    }

    /// Refuses calibrig's own columns without any measured one, such as a plan that has not been measured yet.
    fn refuse_unmeasured(&self, columns: &PositionColumns) -> Result<(), InputError> {
        let PositionColumns::Spherical { range, azimuth, polar, .. } = columns else { return Ok(()) };
        let is_there = |entry: &Entry| self.find(&ColumnRef::Name(entry.written.clone()), false).is_ok();
        if self.map.is_some() || self.joints.is_some() || [range, azimuth, polar].into_iter().any(is_there) {
            return Ok(());
        }
        let message =
            format!("column {} is missing, and so are all the other measured columns", range.written);
        let expected = format!(
            "columns x_m, y_m, z_m, or range_m, az_rad, el_rad next to the commands (a plan has none before it is measured); \
             found {}",
            self.points.names()
        );
        Err(self.points.refuse(message, &expected))
    }

    fn position(&mut self, columns: &PositionColumns) -> Result<Position, InputError> {
        self.refuse_unmeasured(columns)?;
        Ok(match columns {
            PositionColumns::Cartesian { axes: [x, y, z], unit } => {
                let kind = Kind::Length(*unit, "position.unit");
                Position::Cartesian([
                    self.quantity(x, kind, false)?,
                    self.quantity(y, kind, false)?,
                    self.quantity(z, kind, false)?,
                ])
            }
            PositionColumns::Spherical { range, range_unit, azimuth, polar, polar_angle, angle_unit } => {
                let angle = Kind::Angle(*angle_unit, "position.angle_unit");
                Position::Spherical {
                    range: self.quantity(range, Kind::Length(*range_unit, "position.range_unit"), false)?,
                    azimuth: self.quantity(azimuth, angle, false)?,
                    polar: self.quantity(polar, angle, false)?,
                    polar_angle: *polar_angle,
                }
            }
        })
    }

    fn quantities(&mut self, entries: &[Entry], kind: Kind) -> Result<Vec<Quantity>, InputError> {
        entries.iter().map(|entry| self.quantity(entry, kind, false)).collect()
    }

    fn payload(&mut self, columns: &PayloadColumns) -> Result<PayloadQuantities, InputError> {
        Ok(match columns {
            PayloadColumns::Named { column, known } => {
                PayloadQuantities::Named { column: self.single(column)?, known: known.clone() }
            }
            PayloadColumns::Numbers { name, mass, centre, unit, force } => PayloadQuantities::Numbers {
                name: self.optional(name.as_ref())?,
                mass: self.quantity(mass, Kind::Plain, false)?,
                centre: self.quantities(centre, Kind::Length(Some(*unit), "columns.payload_x_mm"))?,
                force: self.quantities(force.as_ref().map_or(&[], |force| &force[..]), Kind::Plain)?,
            },
        })
    }

    fn rotation(&mut self, columns: &RotationColumns) -> Result<RotationQuantities, InputError> {
        let kind =
            if columns.form.has_unit() { Kind::Angle(columns.unit, "rotation.unit") } else { Kind::Plain };
        let sigma = match &columns.sigma {
            Some(sigma) => {
                let kind = Kind::Angle(sigma.unit, "rotation.sigma_unit");
                Some((self.quantities(&sigma.columns, kind)?, sigma.coverage))
            }
            None => None,
        };
        Ok(RotationQuantities {
            form: columns.form,
            columns: self.quantities(&columns.columns, kind)?,
            is_of_tracker: columns.is_of_tracker,
            sigma,
        })
    }

    fn uncertainty(&mut self, columns: &Uncertainty) -> Result<UncertaintyColumns, InputError> {
        let (columns, units, coverage) = match columns {
            Uncertainty::Covariance(entries) => {
                let mut found = Vec::with_capacity(6);
                for entry in entries {
                    found.push(self.quantity(entry, Kind::Plain, false)?);
                }
                return match <[Quantity; 6]>::try_from(found) {
                    Ok(found) => Ok(UncertaintyColumns::Covariance(found)),
                    Err(_) => {
                        Err(self.points.refuse("a covariance without exactly six columns", "six columns"))
                    }
                };
            }
            Uncertainty::Pose { columns, units: (length, angle) } => {
                let [length, angle] = [length.in_si(1.0), angle.in_si(1.0)];
                return Ok(UncertaintyColumns::Pose {
                    columns: self.quantities(columns, Kind::Plain)?,
                    scales: [length, length, length, angle, angle, angle],
                });
            }
            Uncertainty::Sigmas { columns, units, coverage } => (columns, units, coverage),
        };
        let (first, others) = match units {
            SigmaUnits::Cartesian(unit) => {
                (Kind::Length(*unit, "sigma.unit"), Kind::Length(*unit, "sigma.unit"))
            }
            SigmaUnits::Spherical(length, angle) => {
                (Kind::Length(*length, "sigma.range_unit"), Kind::Angle(*angle, "sigma.angle_unit"))
            }
        };
        let [a, b, c] = columns;
        Ok(UncertaintyColumns::Sigmas {
            columns: [
                self.quantity(a, first, false)?,
                self.quantity(b, others, false)?,
                self.quantity(c, others, false)?,
            ],
            coverage: *coverage,
        })
    }
}
