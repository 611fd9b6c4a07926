//! Which columns of a measurement file mean what, and in which unit.
//!
//! Without a map, calibrig's own columns are read (SI, unit in the name): `q1_rad` or `q1_m` and so on; either `range_m`, `az_rad`, `el_rad` or
//! `x_m`, `y_m`, `z_m`; and, if the file has them, `pose`, `station`, `target`, `time_s`, `temperature_c`, `approach1` and so on,
//! `since_reversal1_rad` (or `_m`) and so on, what the flange carries (`payload`, a name, with `payload_mass_kg`, `payload_x_m`, `payload_y_m`,
//! `payload_z_m`, and `payload_force_x_n`, `payload_force_y_n`, `payload_force_z_n`; empty where nothing), and the uncertainty: `sigma_range_m`,
//! `sigma_az_rad`, `sigma_el_rad` (`sigma_x_m`, `sigma_y_m`, `sigma_z_m`), or the covariance's upper triangle `cov_range_range_m2`,
//! `cov_range_az_m_rad`, `cov_range_el_m_rad`, `cov_az_az_rad2`, `cov_az_el_rad2`, `cov_el_el_rad2` (`cov_xx_m2`, `cov_xy_m2`, `cov_xz_m2`,
//! `cov_yy_m2`, `cov_yz_m2`, `cov_zz_m2`). A full pose has, in addition to `x_m`, `y_m`, `z_m` its rotation `tracker_from_target` by rows, `r11` to
//! `r33`, `sigma_rx_rad`, `sigma_ry_rad`, `sigma_rz_rad` with the sigmas of the place, or the 21 elements of both, `cov_x_rx_m_rad` and `cov_rx_rx_rad2`
//! among them. A spherical reading may have its `face`, `front` or `back`.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::layout::{TableFormat, Wanted};
use super::table::bag::BagOptions;
use super::text::TextFormat;
use super::units::{AirQuantity, AngleUnit, LengthUnit, TemperatureUnit, TimeUnit};
use crate::input::{InputError, Source};
use crate::rotation::{MatrixOrder, RotationForm};
use calibrig_model::measurement::{Face, SphericalReading};
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

/// A list of poses: numbers, runs of numbers such as `41..60`, and names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PoseList {
    runs: Vec<[u32; 2]>,
    names: Vec<String>,
}

impl PoseList {
    /// Adds `7`, `41..60`, `41-60` or a name.
    ///
    /// # Errors
    /// A run that ends before it begins, or an empty text; what was expected.
    pub fn add(&mut self, text: &str) -> Result<(), &'static str> {
        let text = text.trim();
        if text.is_empty() {
            return Err("the number of a pose, a range such as 41..60, or a name");
        }
        if let Ok(number) = text.parse() {
            self.runs.push([number, number]);
            return Ok(());
        }
        let run = text.split_once("..").or(text.split_once('-'));
        match run.map(|(first, last)| (first.trim().parse(), last.trim().parse())) {
            Some((Ok(first), Ok(last))) if first <= last => self.runs.push([first, last]),
            Some((Ok(_), Ok(_))) => return Err("a range from the smaller number to the larger one"),
            _ => self.names.push(text.to_owned()),
        }
        Ok(())
    }

    /// Reads a list with commas: `41..60,75`.
    ///
    /// # Errors
    /// As [`PoseList::add`].
    pub fn parse(text: &str) -> Result<Self, &'static str> {
        let mut list = Self::default();
        text.split(',').try_for_each(|part| list.add(part))?;
        Ok(list)
    }

    /// Whether it lists nothing.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty() && self.names.is_empty()
    }

    /// Whether it lists the pose of this number and, where poses have names, of this name.
    pub fn has(&self, number: u32, name: Option<&str>) -> bool {
        match name {
            Some(name) => self.names.iter().any(|known| known == name) || self.has_number_in(name),
            None => self.runs.iter().any(|[first, last]| (*first..=*last).contains(&number)),
        }
    }

    /// Listed entries that these poses lack: ranges of numbers, and names. If poses have `names`, those count, not their numbers.
    pub(super) fn absent(&self, numbers: impl Iterator<Item = u32>, names: &[String]) -> Vec<String> {
        let there: BTreeSet<u32> = if names.is_empty() {
            numbers.collect()
        } else {
            names.iter().filter_map(|name| name.parse().ok()).collect()
        };
        let gap = |first: u32, last: u32| {
            if first == last { first.to_string() } else { format!("{first}..{last}") }
        };
        let mut absent = Vec::new();
        for [first, last] in &self.runs {
            let mut next = Some(*first);
            for found in there.range(first..=last) {
                if let Some(from) = next.filter(|from| from < found) {
                    absent.push(gap(from, found - 1));
                }
                next = found.checked_add(1);
            }
            absent.extend(next.filter(|from| from <= last).map(|from| gap(from, *last)));
        }
        absent.extend(self.names.iter().filter(|name| !names.contains(name)).cloned());
        absent
    }

    /// Adds the entries of another list.
    pub(super) fn extend(&mut self, other: &Self) {
        self.runs
            .extend(other.runs.iter().filter(|run| !self.runs.contains(run)).copied().collect::<Vec<_>>());
        self.names.extend(
            other.names.iter().filter(|name| !self.names.contains(name)).cloned().collect::<Vec<_>>(),
        );
    }

    /// A name that is a number in the list, as `P7` is not.
    fn has_number_in(&self, name: &str) -> bool {
        name.parse().is_ok_and(|number| self.has(number, None))
    }
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

/// calibrig's own columns.
pub(super) mod own {
    use super::JointKind;

    pub const POSE: &str = "pose";
    pub const STATION: &str = "station";
    pub const TARGET: &str = "target";
    pub const SPHERICAL: [&str; 3] = ["range_m", "az_rad", "el_rad"];
    pub const SPHERICAL_SIGMA: [&str; 3] = ["sigma_range_m", "sigma_az_rad", "sigma_el_rad"];
    pub const SPHERICAL_COVARIANCE: [&str; 6] = [
        "cov_range_range_m2",
        "cov_range_az_m_rad",
        "cov_range_el_m_rad",
        "cov_az_az_rad2",
        "cov_az_el_rad2",
        "cov_el_el_rad2",
    ];
    pub const CARTESIAN: [&str; 3] = ["x_m", "y_m", "z_m"];
    pub const CARTESIAN_SIGMA: [&str; 3] = ["sigma_x_m", "sigma_y_m", "sigma_z_m"];
    pub const CARTESIAN_COVARIANCE: [&str; 6] =
        ["cov_xx_m2", "cov_xy_m2", "cov_xz_m2", "cov_yy_m2", "cov_yz_m2", "cov_zz_m2"];
    /// `tracker_from_target` by rows.
    pub const ROTATION: [&str; 9] = ["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"];
    pub const ROTATION_SIGMA: [&str; 3] = ["sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad"];
    pub const POSE_COVARIANCE: [&str; 21] = [
        "cov_xx_m2",
        "cov_xy_m2",
        "cov_xz_m2",
        "cov_x_rx_m_rad",
        "cov_x_ry_m_rad",
        "cov_x_rz_m_rad",
        "cov_yy_m2",
        "cov_yz_m2",
        "cov_y_rx_m_rad",
        "cov_y_ry_m_rad",
        "cov_y_rz_m_rad",
        "cov_zz_m2",
        "cov_z_rx_m_rad",
        "cov_z_ry_m_rad",
        "cov_z_rz_m_rad",
        "cov_rx_rx_rad2",
        "cov_rx_ry_rad2",
        "cov_rx_rz_rad2",
        "cov_ry_ry_rad2",
        "cov_ry_rz_rad2",
        "cov_rz_rz_rad2",
    ];
    pub const FACE: &str = "face";
    pub const TIME: &str = "time_s";
    pub const TEMPERATURE: &str = "temperature_c";
    pub const PAYLOAD: &str = "payload";
    pub const PAYLOAD_MASS: &str = "payload_mass_kg";
    pub const PAYLOAD_CENTRE: [&str; 3] = ["payload_x_m", "payload_y_m", "payload_z_m"];
    pub const PAYLOAD_FORCE: [&str; 3] = ["payload_force_x_n", "payload_force_y_n", "payload_force_z_n"];

    /// Column of the joint at `index`.
    pub fn joint(index: usize, kind: JointKind) -> String {
        match kind {
            JointKind::Revolute => format!("q{}_rad", index + 1),
            JointKind::Prismatic => format!("q{}_m", index + 1),
        }
    }

    /// Column of the approach direction of the actuator at `index`.
    pub fn approach(index: usize) -> String {
        format!("approach{}", index + 1)
    }

    /// Column of how far the actuator at `index` has moved since it last reversed.
    pub fn since_reversal(index: usize, kind: JointKind) -> String {
        match kind {
            JointKind::Revolute => format!("since_reversal{}_rad", index + 1),
            JointKind::Prismatic => format!("since_reversal{}_m", index + 1),
        }
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
            _ => own_mapping(header, joints),
        }
    }
}

fn own_mapping(header: &[&str], joints: &[JointKind]) -> Result<Mapping, String> {
    let has = |name: &str| header.contains(&name);
    let surplus = [JointKind::Revolute, JointKind::Prismatic].map(|kind| own::joint(joints.len(), kind));
    if let Some(name) = surplus.iter().find(|name| has(name)) {
        return Err(format!("there is a column {name}, but the robot has {} joints", joints.len()));
    }
    let cartesian = own::CARTESIAN.iter().any(|name| has(name));
    if cartesian && own::SPHERICAL.iter().any(|name| has(name)) {
        return Err("there are columns of both x_m, y_m, z_m and range_m, az_rad, el_rad".to_owned());
    }
    let position = if cartesian {
        PositionColumns::Cartesian { axes: own::CARTESIAN.map(Entry::named), unit: Some(LengthUnit::M) }
    } else {
        let [range, azimuth, polar] = own::SPHERICAL.map(Entry::named);
        PositionColumns::Spherical {
            range,
            range_unit: Some(LengthUnit::M),
            azimuth,
            polar,
            polar_angle: PolarAngle::Elevation,
            angle_unit: Some(AngleUnit::Rad),
        }
    };
    let rotation = own_rotation(header, cartesian)?;
    let uncertainty = own_uncertainty(header, cartesian, rotation.is_some())?;
    let optional = |name: &str| has(name).then(|| Entry::named(name));
    let approach: Vec<_> = (0..joints.len()).map(own::approach).collect();
    let directed = approach.iter().any(|name| has(name));
    let ways: Vec<_> =
        joints.iter().enumerate().map(|(index, kind)| own::since_reversal(index, *kind)).collect();
    // One of these columns requires all of them.
    let moved = ways.iter().any(|name| has(name));
    Ok(Mapping {
        joints: joints
            .iter()
            .enumerate()
            .map(|(index, kind)| Entry::named(&own::joint(index, *kind)))
            .collect(),
        revolute: Some(AngleUnit::Rad),
        prismatic: Some(LengthUnit::M),
        position,
        rotation,
        uncertainty,
        noise: None,
        pose: optional(own::POSE),
        station: optional(own::STATION),
        target: optional(own::TARGET),
        time: optional(own::TIME),
        time_unit: TimeUnit::S,
        temperature: optional(own::TEMPERATURE),
        temperature_unit: TemperatureUnit::C,
        air: Vec::new(),
        face: optional(own::FACE).map(|column| FaceColumn {
            column,
            words: [Face::Front, Face::Back].map(|face| vec![face.key().to_owned()]),
            angles: BackAngles::Own,
        }),
        approach: if directed {
            approach.iter().map(|name| Entry::named(name)).collect()
        } else {
            Vec::new()
        },
        payload: own_payload(header)?,
        since_reversal: if moved { ways.iter().map(|name| Entry::named(name)).collect() } else { Vec::new() },
        rows: RowChoices::default(),
        sets: Sets::default(),
        join: None,
        text: TextFormat::default(),
        table: TableFormat::default(),
    })
}

/// The own columns of a payload, if the file has them; one of them requires mass and centre.
fn own_payload(header: &[&str]) -> Result<Option<PayloadColumns>, String> {
    let has = |name: &&str| header.contains(name);
    let has_force = own::PAYLOAD_FORCE.iter().any(has);
    let numbers = [own::PAYLOAD_MASS].iter().chain(&own::PAYLOAD_CENTRE).any(has);
    if !numbers && !has_force {
        if !has(&own::PAYLOAD) {
            return Ok(None);
        }
        return Err(format!(
            "there is a column {}, but neither {} nor {}, one of which must say what it is",
            own::PAYLOAD,
            own::PAYLOAD_MASS,
            own::PAYLOAD_CENTRE.join(", ")
        ));
    }
    Ok(Some(PayloadColumns::Numbers {
        name: has(&own::PAYLOAD).then(|| Entry::named(own::PAYLOAD)),
        mass: Entry::named(own::PAYLOAD_MASS),
        centre: own::PAYLOAD_CENTRE.map(Entry::named),
        unit: LengthUnit::M,
        force: has_force.then(|| own::PAYLOAD_FORCE.map(Entry::named)),
    }))
}

/// The own columns of a rotation, if the file has them.
fn own_rotation(header: &[&str], cartesian: bool) -> Result<Option<RotationColumns>, String> {
    let has = |name: &&str| header.contains(name);
    if !own::ROTATION.iter().any(has) {
        return Ok(None);
    }
    if !cartesian {
        return Err("there are columns of a rotation, r11 to r33, but no x_m, y_m, z_m".to_owned());
    }
    // One column of a group requires the whole group, so that a misspelt one is reported.
    let sigma = own::ROTATION_SIGMA.iter().any(has).then(|| RotationSigma {
        columns: own::ROTATION_SIGMA.map(Entry::named).into(),
        unit: Some(AngleUnit::Rad),
        coverage: 1.0,
    });
    Ok(Some(RotationColumns {
        form: RotationForm::Matrix(MatrixOrder::ByRows),
        columns: own::ROTATION.map(Entry::named).into(),
        unit: None,
        is_of_tracker: false,
        sigma,
    }))
}

/// The own columns of an uncertainty, if the file has them; here, too, one column of a group requires the whole group.
fn own_uncertainty(header: &[&str], cartesian: bool, is_pose: bool) -> Result<Option<Uncertainty>, String> {
    let (sigma, covariance) = if cartesian {
        (own::CARTESIAN_SIGMA, own::CARTESIAN_COVARIANCE)
    } else {
        (own::SPHERICAL_SIGMA, own::SPHERICAL_COVARIANCE)
    };
    let covariance: Vec<&str> = if is_pose { own::POSE_COVARIANCE.into() } else { covariance.into() };
    let has = |name: &&str| header.contains(name);
    Ok(match (sigma.iter().any(has), covariance.iter().any(has)) {
        (true, true) => return Err("there are columns of both sigma and cov: keep one kind".to_owned()),
        (true, false) => Some(Uncertainty::Sigmas {
            columns: sigma.map(Entry::named),
            units: if cartesian {
                SigmaUnits::Cartesian(Some(LengthUnit::M))
            } else {
                SigmaUnits::Spherical(Some(LengthUnit::M), Some(AngleUnit::Rad))
            },
            coverage: 1.0,
        }),
        (false, true) => {
            let columns: Vec<Entry> = covariance.iter().map(|name| Entry::named(name)).collect();
            Some(match <[Entry; 6]>::try_from(columns) {
                Ok(columns) => Uncertainty::Covariance(columns),
                Err(columns) => Uncertainty::Pose { columns, units: (LengthUnit::M, AngleUnit::Rad) },
            })
        }
        (false, false) => None,
    })
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
