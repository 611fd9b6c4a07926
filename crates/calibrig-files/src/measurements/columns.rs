//! Which columns of a measurement file mean what, and in which unit.

use std::sync::Arc;

use super::layout::{TableFormat, Wanted};
use super::own_columns as own;
use super::pose_list::PoseList;
use super::table::bag::BagOptions;
use super::text::TextFormat;
use super::units::{AirQuantity, AngleUnit, LengthUnit, TemperatureUnit, TimeUnit};
use crate::input::{InputError, Source};
use crate::rotation::RotationForm;
use calibrig_model::measurement::SphericalReading;
use calibrig_model::{JointKind, Payload};
use nalgebra::{Matrix3, Vector3};

/// Which columns of a file mean what, and in which unit. The default is calibrig's own columns.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ColumnMap {
    /// `None` for calibrig's own columns, which depend on the robot's joints and on the file's header.
    mapping: Option<Mapping>,
    /// Whether a file in calibrig's own columns is read as such even if there is a mapping.
    or_own: bool,
    /// Whether target and station are optional: read if a file has their columns.
    names_where_there: bool,
    /// The text of the map.
    source: Option<Arc<Source>>,
}

/// The columns by name or number, for one robot and one kind of file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mapping {
    pub joints: Vec<Entry>,
    pub revolute: Option<AngleUnit>,
    pub prismatic: Option<LengthUnit>,
    pub position: PositionColumns,
    /// Of a target with axes of its own, whose readings are full poses.
    pub rotation: Option<RotationColumns>,
    pub uncertainty: Option<Uncertainty>,
    pub noise: Option<Noise>,
    pub pose: Option<Entry>,
    pub station: Option<Entry>,
    pub target: Option<Entry>,
    pub time: Option<Entry>,
    /// Of times that are numbers.
    pub time_unit: TimeUnit,
    pub temperature: Option<Entry>,
    pub temperature_unit: TemperatureUnit,
    pub air: Vec<(AirQuantity, Entry)>,
    pub face: Option<FaceColumn>,
    pub approach: Vec<Entry>,
    pub payload: Option<PayloadColumns>,
    /// Of calibrig's own files.
    pub since_reversal: Vec<Entry>,
    pub rows: RowChoices,
    pub sets: Sets,
    pub join: Option<Join>,
    pub text: TextFormat,
    pub table: TableFormat,
}

/// Columns that form one quantity: as written, which may be the name of a single column, and as a signed sum.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    pub written: String,
    pub terms: Vec<Term>,
}

/// A column to add, or to subtract.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Term {
    pub column: ColumnRef,
    pub sign: f64,
}

/// A column of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum ColumnRef {
    Name(String),
    /// From 1.
    Number(usize),
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum PositionColumns {
    /// x, y and z.
    Cartesian { axes: [Entry; 3], unit: Option<LengthUnit> },
    Spherical {
        range: Entry,
        range_unit: Option<LengthUnit>,
        azimuth: Entry,
        polar: Entry,
        polar_angle: PolarAngle,
        angle_unit: Option<AngleUnit>,
    },
}

/// Reference of the second angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PolarAngle {
    /// From the x-y plane.
    Elevation,
    /// From z.
    Zenith,
}

/// Columns with the uncertainty, in the order of the position's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Uncertainty {
    Sigmas {
        columns: [Entry; 3],
        units: SigmaUnits,
        /// The columns state this many standard deviations.
        coverage: f64,
    },
    /// Upper triangle by rows, SI.
    Covariance([Entry; 6]),
    /// Of position and rotation, in the tracker's axes: the upper triangle by rows, or the whole matrix. Units of lengths and angles.
    Pose { columns: Vec<Entry>, units: (LengthUnit, AngleUnit) },
}

/// Columns with the rotation of a target that has axes of its own.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RotationColumns {
    pub form: RotationForm,
    pub columns: Vec<Entry>,
    /// Of the angles of some forms.
    pub unit: Option<AngleUnit>,
    /// Whether position and rotation are those of the tracker in the target's frame.
    pub is_of_tracker: bool,
    pub sigma: Option<RotationSigma>,
}

/// Columns with the standard deviations of a rotation about the tracker's axes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RotationSigma {
    /// One about each axis, or one about every axis.
    pub columns: Vec<Entry>,
    pub unit: Option<AngleUnit>,
    /// The columns state this many standard deviations.
    pub coverage: f64,
}

/// The column with the face of a reading.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FaceColumn {
    pub column: Entry,
    /// Its texts for the front and for the back face.
    pub words: [Vec<String>; 2],
    pub angles: BackAngles,
}

/// The columns with what the flange carries.
#[derive(Debug, Clone, PartialEq)]
// One per map.
#[allow(clippy::large_enum_variant)]
pub(super) enum PayloadColumns {
    /// The name of one of these.
    Named { column: Entry, known: Vec<Payload> },
    /// Its mass, kg, and its centre; a name and a force, N, if there are such columns.
    Numbers {
        name: Option<Entry>,
        mass: Entry,
        centre: [Entry; 3],
        unit: LengthUnit,
        force: Option<[Entry; 3]>,
    },
}

impl PayloadColumns {
    fn entries(&self) -> Vec<&Entry> {
        match self {
            Self::Named { column, .. } => vec![column],
            Self::Numbers { name, mass, centre, force, .. } => {
                name.iter().chain([mass]).chain(centre).chain(force.iter().flatten()).collect()
            }
        }
    }
}

/// The angles of a back-face reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BackAngles {
    /// As the encoders show them: azimuth + 180° and 360° - zenith.
    Raw,
    /// Of the point, as in the front face.
    Direction,
    /// The same in calibrig's own columns, which may count any number of turns.
    Own,
    /// Found from the values.
    Found,
}

/// Units of standard deviations, if the map states them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum SigmaUnits {
    Cartesian(Option<LengthUnit>),
    /// Of the range, and of both angles.
    Spherical(Option<LengthUnit>, Option<AngleUnit>),
}

/// The instrument's noise by distance, as standard deviations: a + b R along the line of sight and across it. m, and without unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    pub range: [f64; 2],
    pub transverse: [f64; 2],
    /// Of a rotation, about every axis, rad.
    pub rotation: Option<f64>,
    /// Place of the instrument in the frame of the positions, m.
    pub tracker: Vector3<f64>,
}

impl Noise {
    fn sigmas(&self, distance: f64) -> [f64; 2] {
        [self.range, self.transverse].map(|[a, b]| a + b * distance)
    }

    /// Covariance of a position, m².
    pub fn at(&self, position: &Vector3<f64>) -> Matrix3<f64> {
        let sight = position - self.tracker;
        let [along, across] = self.sigmas(sight.norm()).map(|sigma| sigma * sigma);
        let Some(direction) = sight.try_normalize(0.0) else { return Matrix3::identity() * across };
        Matrix3::identity() * across + direction * direction.transpose() * (along - across)
    }

    /// Covariance of range, azimuth and elevation; `None` at the zenith, where there is no azimuth, and if the readings are not from the
    /// instrument's place.
    pub fn of_reading(&self, reading: &SphericalReading) -> Option<Matrix3<f64>> {
        let [along, across] = self.sigmas(reading.range);
        let level = reading.range * reading.elevation.cos().abs();
        if level < 1e-6 * reading.range || self.tracker != Vector3::zeros() {
            return None;
        }
        let sigmas = Vector3::new(along, across / level, across / reading.range);
        Some(Matrix3::from_diagonal(&sigmas.component_mul(&sigmas)))
    }
}

/// Further processing of rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct RowChoices {
    /// Marks of a missed shot in a cell of the position, in addition to a position of (0, 0, 0).
    pub missed: Vec<MissedCode>,
    pub approach_from_order: bool,
    pub average_repeats: bool,
    /// Whether a front-face and a back-face reading are averaged.
    pub average_faces: bool,
}

/// A mark of a missed shot.
#[derive(Debug, Clone, PartialEq)]
pub enum MissedCode {
    /// A number, however it is written.
    Number(f64),
    /// A text.
    Text(String),
}

impl MissedCode {
    /// A number if it can be one.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        match text.trim().parse::<f64>() {
            Ok(number) if number.is_finite() => Self::Number(number),
            _ => Self::Text(text.trim().to_owned()),
        }
    }
}

/// Which rows are held out.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Sets {
    pub column: Option<Entry>,
    pub identification: Vec<String>,
    pub verification: Vec<String>,
    /// Poses by number, first and last of each run; or by name.
    pub poses: PoseList,
}

/// How rows of the joints' file and of the points' files belong together.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Join {
    pub by: JoinBy,
    /// The column in the joints' file, and in the points' files; none if joined by rows.
    pub keys: Option<[Entry; 2]>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum JoinBy {
    Row,
    Name,
    /// Within this many seconds; the joints' clock is ahead of the points' by `offset` seconds.
    Time {
        within: f64,
        offset: f64,
    },
}

impl Entry {
    /// A column by name.
    pub fn named(name: &str) -> Self {
        let column = ColumnRef::Name(name.to_owned());
        Self { written: name.to_owned(), terms: vec![Term { column, sign: 1.0 }] }
    }

    /// Which of it a header has.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let terms = self.terms.iter().filter_map(|term| match &term.column {
            ColumnRef::Name(name) => Some(name.as_str()),
            ColumnRef::Number(_) => None,
        });
        let written = terms.clone().any(|name| name != self.written).then_some(self.written.as_str());
        terms.chain(written)
    }

    pub fn numbers(&self) -> impl Iterator<Item = usize> {
        self.terms.iter().filter_map(|term| match &term.column {
            ColumnRef::Number(number) => number.checked_sub(1),
            ColumnRef::Name(_) => None,
        })
    }
}

/// Whose columns are looked for in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FilePart {
    /// All of them in one.
    Whole,
    /// Joints alone, with what joins them.
    Joints,
    /// All but the joints.
    Points,
}

/// What a command line states in addition to, or instead of, the map.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RowOptions {
    /// Marks of missed shots in addition to those of the map.
    pub missed: Vec<MissedCode>,
    /// Poses that are held out.
    pub verification_poses: PoseList,
    /// Whether the signs of approach follow from the order of the rows.
    pub approach_from_order: bool,
    /// Whether repeats of a pose are averaged into one reading.
    pub average_repeats: bool,
    /// Whether a front-face and a back-face reading are averaged into one.
    pub average_faces: bool,
    /// The sheet of a spreadsheet that is read; the first if none is named.
    pub sheet: Option<String>,
    /// What is read of a bag.
    pub bag: BagOptions,
}

impl ColumnMap {
    pub(super) fn new(mapping: Mapping, source: Source) -> Self {
        Self {
            mapping: Some(mapping),
            or_own: false,
            names_where_there: false,
            source: Some(Arc::new(source)),
        }
    }

    /// Refuses a map that does not fit the robot's joints; `source` is the text that it was read from.
    pub fn check_joints(&self, source: &Source, joints: &[JointKind]) -> Result<(), InputError> {
        let Some(mapping) = &self.mapping else { return Ok(()) };
        let (found, expected) = (mapping.joints.len(), joints.len());
        if found != expected {
            let message =
                format!("joints.columns names {found} columns, but the robot has {expected} joints");
            let help = "expected one column per joint".to_owned();
            return Err(source.error(source.place_of("joints.columns"), message, Some(help)));
        }
        Ok(())
    }

    /// The same map, except that a file that has calibrig's own columns for the commands, and none of the map's, is read as
    /// calibrig's own: a robot's map is that of one tracker's files.
    #[must_use]
    pub fn or_own(self) -> Self {
        Self { or_own: true, ..self }
    }

    /// The same map, with the columns of target and station optional: bags have them only if there are several.
    #[must_use]
    pub fn with_names_where_there(self) -> Self {
        Self { names_where_there: true, ..self }
    }

    #[cfg(test)]
    pub(super) fn mapping(&self) -> Option<&Mapping> {
        self.mapping.as_ref()
    }

    /// Its text, for messages to point into.
    pub(super) fn source(&self) -> Option<&Source> {
        self.source.as_deref()
    }

    /// The form of a text or a table.
    pub(super) fn format(&self) -> (TextFormat, TableFormat) {
        self.mapping.as_ref().map_or_else(Default::default, |mapping| (mapping.text.clone(), mapping.table))
    }

    /// Options for rows.
    pub(super) fn row_choices(&self) -> Option<&RowChoices> {
        self.mapping.as_ref().map(|mapping| &mapping.rows)
    }

    /// How rows of two files are joined.
    pub(super) fn join(&self) -> Option<&Join> {
        self.mapping.as_ref()?.join.as_ref()
    }

    /// The columns to look for in a header, whatever of them it holds.
    pub(super) fn wanted(&self, joints: &[JointKind], part: FilePart) -> Wanted {
        let mut wanted = Wanted::default();
        for entry in self.mapping.iter().flat_map(|mapping| mapping.entries(part)) {
            wanted.names.extend(entry.names().map(str::to_owned));
            wanted.numbers.extend(entry.numbers());
        }
        if let Some(mapping) = self.mapping.as_ref().filter(|_| !wanted.numbers.is_empty()) {
            // Other cells need not hold numbers in every row.
            wanted.numbers = mapping.needed(part).into_iter().flat_map(Entry::numbers).collect();
        }
        if self.mapping.is_some() && !self.or_own {
            return wanted;
        }
        if part != FilePart::Joints {
            let fixed = [own::POSE, own::STATION, own::TARGET, own::FACE, own::TIME, own::TEMPERATURE];
            let payload = [own::PAYLOAD, own::PAYLOAD_MASS];
            let fixed = fixed.iter().chain(&payload).chain(&own::PAYLOAD_CENTRE).chain(&own::PAYLOAD_FORCE);
            let fixed = fixed.chain(&own::SPHERICAL).chain(&own::CARTESIAN).chain(&own::ROTATION);
            wanted.names.extend(fixed.map(|name| (*name).to_owned()));
        }
        if part != FilePart::Points {
            wanted.names.extend(joints.iter().enumerate().map(|(index, kind)| own::joint(index, *kind)));
        }
        wanted
    }

    /// The columns of a file with this header, or why they cannot be found.
    pub(super) fn resolve(&self, header: &[&str], joints: &[JointKind]) -> Result<Mapping, String> {
        let has = |name: &str| header.contains(&name);
        let own = |mapping: &Mapping| {
            self.or_own
                && !mapping.joints.iter().flat_map(Entry::names).any(has)
                && !mapping.joints.iter().any(|entry| entry.numbers().next().is_some())
                && (0..joints.len()).all(|index| has(&own::joint(index, joints[index])))
        };
        match &self.mapping {
            Some(mapping) if !own(mapping) => {
                let mut mapping = mapping.clone();
                if self.names_where_there {
                    let is_there = |entry: &Entry| entry.names().any(has);
                    mapping.target = mapping.target.filter(is_there);
                    mapping.station = mapping.station.filter(is_there);
                }
                Ok(mapping)
            }
            _ => own::mapping(header, joints),
        }
    }
}

impl Mapping {
    /// Every entry that is looked for in that part.
    pub fn entries(&self, part: FilePart) -> Vec<&Entry> {
        let mut entries = self.needed(part);
        if part != FilePart::Joints {
            entries.extend(self.approach.iter().chain(&self.since_reversal));
            match &self.uncertainty {
                Some(Uncertainty::Sigmas { columns, .. }) => entries.extend(columns),
                Some(Uncertainty::Covariance(columns)) => entries.extend(columns),
                Some(Uncertainty::Pose { columns, .. }) => entries.extend(columns),
                None => {}
            }
            let rotation = self.rotation.iter().flat_map(|rotation| &rotation.sigma);
            entries.extend(rotation.flat_map(|sigma| &sigma.columns));
            entries.extend(self.face.iter().map(|face| &face.column));
            entries.extend(self.air.iter().map(|(_, entry)| entry));
            entries.extend(self.payload.iter().flat_map(PayloadColumns::entries));
            let rest = [&self.pose, &self.station, &self.target, &self.time, &self.temperature];
            entries.extend(rest.into_iter().flatten());
            entries.extend(&self.sets.column);
        }
        if let Some([joints, points]) = self.join.as_ref().and_then(|join| join.keys.as_ref()) {
            match part {
                FilePart::Whole => {}
                FilePart::Joints => entries.push(joints),
                FilePart::Points => entries.push(points),
            }
        }
        entries
    }

    /// Commands and position: what every row of a measurement has.
    fn needed(&self, part: FilePart) -> Vec<&Entry> {
        let mut entries: Vec<&Entry> = Vec::new();
        if part != FilePart::Points {
            entries.extend(&self.joints);
        }
        if part != FilePart::Joints {
            match &self.position {
                PositionColumns::Cartesian { axes, .. } => entries.extend(axes),
                PositionColumns::Spherical { range, azimuth, polar, .. } => {
                    entries.extend([range, azimuth, polar]);
                }
            }
            entries.extend(self.rotation.iter().flat_map(|rotation| &rotation.columns));
        }
        entries
    }
}
