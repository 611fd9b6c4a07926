//! Which columns of a measurement file mean what, and in which unit: `columns.toml`.
//!
//! ```toml
//! schema = "calibrig.columns/1"
//!
//! [joints]
//! columns = ["A1", "A2", "A3"]      # what was commanded, one column an actuator, in the robot's order
//! revolute_unit = "deg"             # deg or rad; needed where the robot has a revolute joint
//! prismatic_unit = "mm"             # mm or m; needed where it has a prismatic one
//!
//! [position]                        # of the target, in the tracker's frame
//! system = "cartesian"
//! unit = "mm"                       # um, mm or m
//! x = ["x_target", "-x_error"]      # a sum of columns; a leading - subtracts, a leading + is allowed
//! y = ["y_target", "-y_error"]
//! z = ["z_target", "-z_error"]
//! # or: system = "spherical", range = "R", range_unit = "m", azimuth = "Az", angle_unit = "deg" (arcsec, deg or rad), and
//! # either elevation = "El" (above the tracker's x-y plane) or zenith = "Ze" (from its z axis)
//!
//! [sigma]                           # optional: standard deviations above 0, in the system of the position
//! unit = "um"                       # spherical: range_unit and angle_unit
//! x = "sx"                          # spherical: range, azimuth, and elevation or zenith
//! y = "sy"
//! z = "sz"
//!
//! [columns]                         # each optional
//! pose = "No"
//! station = "Station"
//! target = "SMR"                    # the reflector, the same name in all its rows; not the name of the shot
//! time_s = "t"
//! temperature_c = "T"
//! approach = ["dir1", "dir2", "dir3"]  # -1, 0 or 1, one an actuator
//! ```
//!
//! Without a map, calibrig's own columns are read (SI, unit in the name): `q1_rad` or `q1_m` and so on; either `range_m`, `az_rad`,
//! `el_rad` or `x_m`, `y_m`, `z_m`; and, where the file has them, `pose`, `station`, `target`, `time_s`, `temperature_c`,
//! `approach1` and so on, and the uncertainty: `sigma_range_m`, `sigma_az_rad`, `sigma_el_rad` (`sigma_x_m`, `sigma_y_m`,
//! `sigma_z_m`), or the covariance's upper triangle `cov_range_range_m2`, `cov_range_az_m_rad`, `cov_range_el_m_rad`,
//! `cov_az_az_rad2`, `cov_az_el_rad2`, `cov_el_el_rad2` (`cov_xx_m2`, `cov_xy_m2`, `cov_xz_m2`, `cov_yy_m2`, `cov_yz_m2`,
//! `cov_zz_m2`).

use std::ops::Range;
use std::path::Path;

use serde::Deserialize;

use crate::input::{InputError, Source, Spanned};
use calibrig_model::JointKind;

const SCHEMA: &str = "calibrig.columns/1";

/// Which columns of a file mean what, and in which unit. The default is calibrig's own columns.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ColumnMap {
    /// `None` for calibrig's own columns, which depend on the robot's joints and on the file's header.
    mapping: Option<Mapping>,
    /// Whether a file in calibrig's own columns is read as one although there is a mapping.
    or_own: bool,
}

/// The columns by name, for one robot and one file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mapping {
    pub joints: Vec<String>,
    pub revolute: Option<AngleUnit>,
    pub prismatic: Option<LengthUnit>,
    pub position: PositionColumns,
    pub uncertainty: Option<Uncertainty>,
    pub pose: Option<String>,
    pub station: Option<String>,
    pub target: Option<String>,
    pub time: Option<String>,
    pub temperature: Option<String>,
    pub approach: Vec<String>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum PositionColumns {
    /// x, y and z, each a sum.
    Cartesian { axes: [Vec<Term>; 3], unit: LengthUnit },
    Spherical {
        range: String,
        range_unit: LengthUnit,
        azimuth: String,
        polar: String,
        polar_angle: PolarAngle,
        angle_unit: AngleUnit,
    },
}

/// A column to add, or to subtract.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Term {
    pub column: String,
    pub sign: f64,
}

/// From where the second angle counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PolarAngle {
    /// From the x-y plane.
    Elevation,
    /// From z.
    Zenith,
}

/// Columns with the uncertainty, in the order of the position's coordinates, with the factor that makes each of them SI.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Uncertainty {
    Sigmas([(String, f64); 3]),
    /// Upper triangle by rows, SI.
    Covariance([String; 6]),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum LengthUnit {
    M,
    Mm,
    Um,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum AngleUnit {
    Rad,
    Deg,
    Arcsec,
}

impl LengthUnit {
    /// m
    pub fn in_si(self, value: f64) -> f64 {
        match self {
            Self::M => value,
            Self::Mm => value / 1e3,
            Self::Um => value / 1e6,
        }
    }
}

impl AngleUnit {
    /// rad
    pub fn in_si(self, value: f64) -> f64 {
        match self {
            Self::Rad => value,
            Self::Deg => value.to_radians(),
            Self::Arcsec => (value / 3600.0).to_radians(),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MapFile {
    schema: Spanned<String>,
    joints: Spanned<JointsTable>,
    position: Spanned<CoordinateTable<Vec<Spanned<String>>>>,
    sigma: Option<Spanned<CoordinateTable<String>>>,
    #[serde(default)]
    columns: ColumnsTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointsTable {
    columns: Vec<Spanned<String>>,
    revolute_unit: Option<AngleUnit>,
    prismatic_unit: Option<LengthUnit>,
}

#[derive(Deserialize, Clone, Copy, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
enum System {
    Cartesian,
    Spherical,
}

/// The columns of three coordinates, each a `C`. `x`, `y`, `z` and `unit` belong to the Cartesian system, the others to the
/// spherical one.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CoordinateTable<C> {
    system: Option<Spanned<System>>,
    unit: Option<Spanned<LengthUnit>>,
    x: Option<Spanned<C>>,
    y: Option<Spanned<C>>,
    z: Option<Spanned<C>>,
    range: Option<Spanned<String>>,
    range_unit: Option<Spanned<LengthUnit>>,
    azimuth: Option<Spanned<String>>,
    elevation: Option<Spanned<String>>,
    zenith: Option<Spanned<String>>,
    angle_unit: Option<Spanned<AngleUnit>>,
}

type KeySpan = (&'static str, Option<Range<usize>>);

fn key_span<T>(key: &'static str, value: Option<&Spanned<T>>) -> KeySpan {
    (key, value.map(Spanned::span))
}

impl<C> CoordinateTable<C> {
    fn cartesian_keys(&self) -> Vec<KeySpan> {
        vec![
            key_span("x", self.x.as_ref()),
            key_span("y", self.y.as_ref()),
            key_span("z", self.z.as_ref()),
            key_span("unit", self.unit.as_ref()),
        ]
    }

    fn spherical_keys(&self) -> Vec<KeySpan> {
        vec![
            key_span("range", self.range.as_ref()),
            key_span("range_unit", self.range_unit.as_ref()),
            key_span("azimuth", self.azimuth.as_ref()),
            key_span("elevation", self.elevation.as_ref()),
            key_span("zenith", self.zenith.as_ref()),
            key_span("angle_unit", self.angle_unit.as_ref()),
        ]
    }
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct ColumnsTable {
    pose: Option<Spanned<String>>,
    station: Option<Spanned<String>>,
    target: Option<Spanned<String>>,
    time_s: Option<Spanned<String>>,
    temperature_c: Option<Spanned<String>>,
    #[serde(default)]
    approach: Vec<Spanned<String>>,
}

/// Reads a column map, with the text that it was read from.
pub fn load_column_map(path: &Path) -> Result<(ColumnMap, Source), InputError> {
    let source = Source::read(path)?;
    Ok((parse_column_map(&source)?, source))
}

/// Reads a column map from a text in memory.
pub fn parse_column_map(source: &Source) -> Result<ColumnMap, InputError> {
    let file: MapFile = source.toml()?;
    if file.schema.get_ref() != SCHEMA {
        let message = format!("schema is {:?}", file.schema.get_ref());
        return Err(source.error(file.schema.span(), message, Some(format!("expected {SCHEMA:?}"))));
    }
    let reader = Reader { source };
    let (position, polar) = reader.position(&file.position)?;
    let uncertainty = match &file.sigma {
        Some(sigma) => Some(Uncertainty::Sigmas(reader.sigmas(sigma, polar)?)),
        None => None,
    };
    let joints = file.joints.get_ref();
    if joints.columns.is_empty() {
        return Err(reader.error(file.joints.span(), "[joints] names no columns", "one column a joint"));
    }
    let rest = &file.columns;
    if !rest.approach.is_empty() && rest.approach.len() != joints.columns.len() {
        let (found, expected) = (rest.approach.len(), joints.columns.len());
        let message = format!("approach names {found} columns, [joints] {expected}");
        return Err(reader.error(rest.approach[0].span(), message, "one column an actuator"));
    }
    Ok(ColumnMap {
        mapping: Some(Mapping {
            joints: reader.distinct(&joints.columns)?,
            revolute: joints.revolute_unit,
            prismatic: joints.prismatic_unit,
            position,
            uncertainty,
            pose: reader.optional(rest.pose.as_ref())?,
            station: reader.optional(rest.station.as_ref())?,
            target: reader.optional(rest.target.as_ref())?,
            time: reader.optional(rest.time_s.as_ref())?,
            temperature: reader.optional(rest.temperature_c.as_ref())?,
            approach: reader.distinct(&rest.approach)?,
        }),
        or_own: false,
    })
}

struct Reader<'a> {
    source: &'a Source,
}

impl Reader<'_> {
    fn error(&self, span: Range<usize>, message: impl std::fmt::Display, expected: &str) -> InputError {
        self.source.error(span, message, Some(format!("expected {expected}")))
    }

    fn name(&self, name: &Spanned<String>) -> Result<String, InputError> {
        let trimmed = name.get_ref().trim();
        if trimmed.is_empty() {
            return Err(self.error(
                name.span(),
                "the name of a column is empty",
                "a name of the header line",
            ));
        }
        Ok(trimmed.to_owned())
    }

    fn optional(&self, name: Option<&Spanned<String>>) -> Result<Option<String>, InputError> {
        name.map(|name| self.name(name)).transpose()
    }

    fn distinct(&self, names: &[Spanned<String>]) -> Result<Vec<String>, InputError> {
        let mut seen = Vec::with_capacity(names.len());
        for spanned in names {
            let name = self.name(spanned)?;
            if seen.contains(&name) {
                return Err(self.error(
                    spanned.span(),
                    format!("column {name:?} is named twice"),
                    "a column each",
                ));
            }
            seen.push(name);
        }
        Ok(seen)
    }

    fn needed<'t, T>(
        &self,
        table: (&str, &Range<usize>),
        key: &str,
        value: Option<&'t Spanned<T>>,
    ) -> Result<&'t Spanned<T>, InputError> {
        value.ok_or_else(|| {
            self.error(table.1.clone(), format!("[{}] has no {key}", table.0), &format!("the key {key}"))
        })
    }

    /// Refuses keys of the other coordinate system.
    fn foreign(&self, keys: Vec<KeySpan>, system: &str) -> Result<(), InputError> {
        match keys.into_iter().find_map(|(key, span)| span.map(|span| (key, span))) {
            Some((key, span)) => {
                let message = format!("{key} does not belong to the {system} system");
                Err(self.error(span, message, &format!("the keys of the {system} system alone")))
            }
            None => Ok(()),
        }
    }

    fn sum(&self, names: &Spanned<Vec<Spanned<String>>>) -> Result<Vec<Term>, InputError> {
        if names.get_ref().is_empty() {
            return Err(self.error(names.span(), "a sum of no columns", "one column or more"));
        }
        let term = |spanned: &Spanned<String>| {
            let name = self.name(spanned)?;
            let (sign, column) = match name.strip_prefix('-') {
                Some(column) => (-1.0, column),
                None => (1.0, name.strip_prefix('+').unwrap_or(&name)),
            };
            let column = column.trim();
            if column.is_empty() {
                return Err(self.error(
                    spanned.span(),
                    "a sign without a column",
                    "a name of the header line",
                ));
            }
            Ok(Term { column: column.to_owned(), sign })
        };
        names.get_ref().iter().map(term).collect()
    }

    fn polar(
        &self,
        table: (&str, &Range<usize>),
        elevation: Option<&Spanned<String>>,
        zenith: Option<&Spanned<String>>,
    ) -> Result<(String, PolarAngle), InputError> {
        match (elevation, zenith) {
            (Some(name), None) => Ok((self.name(name)?, PolarAngle::Elevation)),
            (None, Some(name)) => Ok((self.name(name)?, PolarAngle::Zenith)),
            (Some(_), Some(zenith)) => {
                Err(self.error(zenith.span(), "both elevation and zenith", "one of elevation and zenith"))
            }
            (None, None) => {
                let message = format!("[{}] has neither elevation nor zenith", table.0);
                Err(self.error(table.1.clone(), message, "one of elevation and zenith"))
            }
        }
    }

    /// The position's columns and, of a spherical one, from where its second angle counts.
    fn position(
        &self,
        spanned: &Spanned<CoordinateTable<Vec<Spanned<String>>>>,
    ) -> Result<(PositionColumns, Option<PolarAngle>), InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        let table = ("position", &span);
        if *self.needed(table, "system", t.system.as_ref())?.get_ref() == System::Cartesian {
            self.foreign(t.spherical_keys(), "cartesian")?;
            let axes = [
                self.sum(self.needed(table, "x", t.x.as_ref())?)?,
                self.sum(self.needed(table, "y", t.y.as_ref())?)?,
                self.sum(self.needed(table, "z", t.z.as_ref())?)?,
            ];
            let unit = *self.needed(table, "unit", t.unit.as_ref())?.get_ref();
            return Ok((PositionColumns::Cartesian { axes, unit }, None));
        }
        self.foreign(t.cartesian_keys(), "spherical")?;
        let (polar, polar_angle) = self.polar(table, t.elevation.as_ref(), t.zenith.as_ref())?;
        let position = PositionColumns::Spherical {
            range: self.name(self.needed(table, "range", t.range.as_ref())?)?,
            range_unit: *self.needed(table, "range_unit", t.range_unit.as_ref())?.get_ref(),
            azimuth: self.name(self.needed(table, "azimuth", t.azimuth.as_ref())?)?,
            polar,
            polar_angle,
            angle_unit: *self.needed(table, "angle_unit", t.angle_unit.as_ref())?.get_ref(),
        };
        Ok((position, Some(polar_angle)))
    }

    /// The columns of the standard deviations; `polar` is that of the position, `None` for a Cartesian one.
    fn sigmas(
        &self,
        spanned: &Spanned<CoordinateTable<String>>,
        polar: Option<PolarAngle>,
    ) -> Result<[(String, f64); 3], InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        let table = ("sigma", &span);
        if let Some(system) = &t.system {
            let message = "[sigma] is in the system of [position]";
            return Err(self.error(system.span(), message, "no key system here"));
        }
        let Some(polar) = polar else {
            self.foreign(t.spherical_keys(), "cartesian")?;
            let unit = self.needed(table, "unit", t.unit.as_ref())?.get_ref().in_si(1.0);
            return Ok([
                (self.name(self.needed(table, "x", t.x.as_ref())?)?, unit),
                (self.name(self.needed(table, "y", t.y.as_ref())?)?, unit),
                (self.name(self.needed(table, "z", t.z.as_ref())?)?, unit),
            ]);
        };
        self.foreign(t.cartesian_keys(), "spherical")?;
        let (name, own_polar) = self.polar(table, t.elevation.as_ref(), t.zenith.as_ref())?;
        if own_polar != polar {
            let message = "[sigma] and [position] differ: one says elevation, the other zenith";
            return Err(self.error(span.clone(), message, "the same angle in both"));
        }
        let length = self.needed(table, "range_unit", t.range_unit.as_ref())?.get_ref().in_si(1.0);
        let angle = self.needed(table, "angle_unit", t.angle_unit.as_ref())?.get_ref().in_si(1.0);
        Ok([
            (self.name(self.needed(table, "range", t.range.as_ref())?)?, length),
            (self.name(self.needed(table, "azimuth", t.azimuth.as_ref())?)?, angle),
            (name, angle),
        ])
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
    pub const TIME: &str = "time_s";
    pub const TEMPERATURE: &str = "temperature_c";

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
}

impl ColumnMap {
    /// Refuses a map that does not fit the robot's joints; `source` is the text that it was read from.
    pub fn check_joints(&self, source: &Source, joints: &[JointKind]) -> Result<(), InputError> {
        let Some(mapping) = &self.mapping else { return Ok(()) };
        let refused = |key: &str, message: String, expected: String| {
            Err(source.error(source.place_of(key), message, Some(format!("expected {expected}"))))
        };
        let (found, expected) = (mapping.joints.len(), joints.len());
        if found != expected {
            let message = format!("joints.columns names {found} columns, the robot has {expected} joints");
            return refused("joints.columns", message, "one column a joint".to_owned());
        }
        for (kind, name, missing, units) in [
            (JointKind::Revolute, "revolute", mapping.revolute.is_none(), "deg, rad or arcsec"),
            (JointKind::Prismatic, "prismatic", mapping.prismatic.is_none(), "mm, m or um"),
        ] {
            if missing && joints.contains(&kind) {
                let message = format!("missing key `{name}_unit` in [joints]: the robot has {name} joints");
                return refused("joints", message, format!("{name}_unit = {units}"));
            }
        }
        Ok(())
    }

    /// The same map, but a file that has calibrig's own columns for the commands, and none of the map's, is read as calibrig's own: a
    /// robot's map is of one tracker's files.
    #[must_use]
    pub fn or_own(self) -> Self {
        Self { or_own: true, ..self }
    }

    /// The columns to look for in a header line, whatever of them it holds.
    pub(super) fn candidates(&self, joints: &[JointKind]) -> Vec<String> {
        let mapped = self.mapping.iter().flat_map(Mapping::names).map(str::to_owned);
        if self.mapping.is_some() && !self.or_own {
            return mapped.collect();
        }
        let fixed = [own::POSE, own::STATION, own::TARGET, own::TIME, own::TEMPERATURE];
        let fixed = fixed.iter().chain(&own::SPHERICAL).chain(&own::CARTESIAN);
        let commands = joints.iter().enumerate().map(|(index, kind)| own::joint(index, *kind));
        mapped.chain(fixed.map(|name| (*name).to_owned())).chain(commands).collect()
    }

    /// The columns of a file with this header, or why they cannot be told.
    pub(super) fn resolve(&self, header: &[&str], joints: &[JointKind]) -> Result<Mapping, String> {
        let has = |name: &str| header.contains(&name);
        let own = |mapping: &Mapping| {
            self.or_own
                && !mapping.joints.iter().any(|name| has(name))
                && (0..joints.len()).all(|index| has(&own::joint(index, joints[index])))
        };
        match &self.mapping {
            Some(mapping) if !own(mapping) => Ok(mapping.clone()),
            _ => own_mapping(header, joints),
        }
    }
}

fn own_mapping(header: &[&str], joints: &[JointKind]) -> Result<Mapping, String> {
    let has = |name: &str| header.contains(&name);
    let surplus = [JointKind::Revolute, JointKind::Prismatic].map(|kind| own::joint(joints.len(), kind));
    if let Some(name) = surplus.iter().find(|name| has(name)) {
        return Err(format!("there is a column {name}, the robot has {} joints", joints.len()));
    }
    let cartesian = own::CARTESIAN.iter().any(|name| has(name));
    if cartesian && own::SPHERICAL.iter().any(|name| has(name)) {
        return Err("there are columns of both x_m, y_m, z_m and range_m, az_rad, el_rad".to_owned());
    }
    let (position, sigma, covariance) = if cartesian {
        let axes = own::CARTESIAN.map(|name| vec![Term { column: name.to_owned(), sign: 1.0 }]);
        let position = PositionColumns::Cartesian { axes, unit: LengthUnit::M };
        (position, own::CARTESIAN_SIGMA, own::CARTESIAN_COVARIANCE)
    } else {
        let [range, azimuth, polar] = own::SPHERICAL.map(str::to_owned);
        let position = PositionColumns::Spherical {
            range,
            range_unit: LengthUnit::M,
            azimuth,
            polar,
            polar_angle: PolarAngle::Elevation,
            angle_unit: AngleUnit::Rad,
        };
        (position, own::SPHERICAL_SIGMA, own::SPHERICAL_COVARIANCE)
    };
    // One column of a group calls for the whole group, so that a misspelt one is reported.
    let uncertainty = match (sigma.iter().any(|name| has(name)), covariance.iter().any(|name| has(name))) {
        (true, true) => return Err("there are columns of both sigma and cov".to_owned()),
        (true, false) => Some(Uncertainty::Sigmas(sigma.map(|name| (name.to_owned(), 1.0)))),
        (false, true) => Some(Uncertainty::Covariance(covariance.map(str::to_owned))),
        (false, false) => None,
    };
    let optional = |name: &str| has(name).then(|| name.to_owned());
    let approach: Vec<_> = (0..joints.len()).map(own::approach).collect();
    let directed = approach.iter().any(|name| has(name));
    Ok(Mapping {
        joints: joints.iter().enumerate().map(|(index, kind)| own::joint(index, *kind)).collect(),
        revolute: Some(AngleUnit::Rad),
        prismatic: Some(LengthUnit::M),
        position,
        uncertainty,
        pose: optional(own::POSE),
        station: optional(own::STATION),
        target: optional(own::TARGET),
        time: optional(own::TIME),
        temperature: optional(own::TEMPERATURE),
        approach: if directed { approach } else { Vec::new() },
    })
}

impl Mapping {
    /// Every column that it names.
    pub fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = self.joints.iter().chain(&self.approach).map(String::as_str).collect();
        match &self.position {
            PositionColumns::Cartesian { axes, .. } => {
                names.extend(axes.iter().flatten().map(|term| term.column.as_str()));
            }
            PositionColumns::Spherical { range, azimuth, polar, .. } => {
                names.extend([range.as_str(), azimuth, polar]);
            }
        }
        match &self.uncertainty {
            Some(Uncertainty::Sigmas(columns)) => names.extend(columns.iter().map(|(name, _)| name.as_str())),
            Some(Uncertainty::Covariance(columns)) => names.extend(columns.iter().map(String::as_str)),
            None => {}
        }
        let rest = [&self.pose, &self.station, &self.target, &self.time, &self.temperature];
        names.extend(rest.into_iter().flatten().map(String::as_str));
        names
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CARTESIAN: &str = r#"schema = "calibrig.columns/1"
[joints]
columns = ["j1", "j2"]
revolute_unit = "deg"
[position]
system = "cartesian"
unit = "mm"
x = ["xt", "-dx"]
y = ["+yt"]
z = ["zt"]
[sigma]
unit = "um"
x = "sx"
y = "sy"
z = "sz"
[columns]
pose = "No"
approach = ["a1", "a2"]
"#;

    const SPHERICAL: &str = r#"schema = "calibrig.columns/1"
[joints]
columns = ["j1"]
prismatic_unit = "mm"
[position]
system = "spherical"
range = "R"
range_unit = "m"
azimuth = "Az"
zenith = "Ze"
angle_unit = "deg"
[sigma]
range = "sR"
range_unit = "um"
azimuth = "sAz"
zenith = "sZe"
angle_unit = "arcsec"
"#;

    fn parse(text: &str) -> Result<ColumnMap, InputError> {
        parse_column_map(&Source::new("columns.toml", text))
    }

    #[test]
    fn sums_signs_and_units_are_understood() {
        let mapping = parse(CARTESIAN).expect("valid").mapping.expect("named");
        let PositionColumns::Cartesian { axes: [x, y, _], unit } = &mapping.position else {
            panic!("cartesian")
        };
        let signed: Vec<_> = x.iter().chain(y).map(|term| (term.column.as_str(), term.sign)).collect();
        assert_eq!((signed, *unit), (vec![("xt", 1.0), ("dx", -1.0), ("yt", 1.0)], LengthUnit::Mm));
        let Some(Uncertainty::Sigmas(sigmas)) = &mapping.uncertainty else { panic!("sigmas") };
        assert_eq!(sigmas[1], ("sy".to_owned(), 1e-6));
        assert_eq!(mapping.approach, ["a1", "a2"]);
        assert_eq!(AngleUnit::Arcsec.in_si(3600.0), 1f64.to_radians());
        let mapping = parse(SPHERICAL).expect("valid").mapping.expect("named");
        assert!(matches!(
            mapping.position,
            PositionColumns::Spherical { polar_angle: PolarAngle::Zenith, .. }
        ));
        assert_eq!(mapping.names(), ["j1", "R", "Az", "Ze", "sR", "sAz", "sZe"]);
    }

    #[test]
    fn every_mistake_is_named_with_its_line_and_what_was_expected() {
        for (text, from, to, message, line, help) in [
            (CARTESIAN, "columns/1", "columns/9", "columns/9", 1, "columns/1"),
            (CARTESIAN, "[\"j1\", \"j2\"]", "[]", "names no columns", 2, "one column a joint"),
            (CARTESIAN, "\"j2\"", "\"j1\"", "\"j1\" is named twice", 3, "each"),
            (CARTESIAN, "\"j2\"", "\" \"", "is empty", 3, "header"),
            (CARTESIAN, "\"deg\"", "\"grad\"", "joints.revolute_unit is \"grad\"", 4, "`deg`"),
            (CARTESIAN, "revolute_unit", "unit", "unknown key `unit`", 4, "`revolute_unit`"),
            (CARTESIAN, "unit = \"mm\"\n", "", "[position] has no unit", 5, "unit"),
            (CARTESIAN, "system = \"cartesian\"\n", "", "[position] has no system", 5, "system"),
            (CARTESIAN, "z = [\"zt\"]\n", "", "[position] has no z", 5, "z"),
            (CARTESIAN, "[\"zt\"]", "[]", "a sum of no columns", 10, "one column or more"),
            (CARTESIAN, "[\"zt\"]", "[\"-\"]", "a sign without a column", 10, "header"),
            (CARTESIAN, "[\"zt\"]", "\"zt\"", "position.z is \"zt\"", 10, "a list"),
            (
                CARTESIAN,
                "z = [\"zt\"]",
                "z = [\"zt\"]\nrange = \"R\"",
                "range does not belong to the cartesian",
                11,
                "alone",
            ),
            (CARTESIAN, "z = \"sz\"\n", "", "[sigma] has no z", 11, "z"),
            (
                CARTESIAN,
                "z = \"sz\"",
                "z = \"sz\"\nsystem = \"cartesian\"",
                "[sigma] is in the system of",
                16,
                "no key",
            ),
            (
                CARTESIAN,
                "[\"a1\", \"a2\"]",
                "[\"a1\"]",
                "approach names 1 columns, [joints] 2",
                18,
                "actuator",
            ),
            (CARTESIAN, "pose", "number", "unknown key `number`", 17, "`pose`"),
            (SPHERICAL, "\"spherical\"", "\"cartesian\"", "range does not belong", 7, "alone"),
            (SPHERICAL, "zenith = \"Ze\"", "", "neither elevation nor zenith", 5, "one of"),
            (
                SPHERICAL,
                "zenith = \"Ze\"",
                "zenith = \"Ze\"\nelevation = \"El\"",
                "both elevation and zenith",
                10,
                "one of",
            ),
            (
                SPHERICAL,
                "zenith = \"sZe\"",
                "elevation = \"sZe\"",
                "[sigma] and [position] differ",
                12,
                "same",
            ),
            (
                SPHERICAL,
                "angle_unit = \"deg\"",
                "unit = \"m\"",
                "unit does not belong to the spherical",
                11,
                "alone",
            ),
            (SPHERICAL, "angle_unit = \"deg\"", "", "[position] has no angle_unit", 5, "angle_unit"),
            (SPHERICAL, "\"arcsec\"", "\"min\"", "sigma.angle_unit is \"min\"", 17, "`arcsec`"),
        ] {
            assert!(text.contains(from), "{from}");
            match parse(&text.replacen(from, to, 1)) {
                Err(InputError::Invalid { message: found, line: at, help: expected, .. }) => {
                    assert!(found.contains(message), "{from} -> {to}: {found}");
                    assert!(
                        expected.as_deref().unwrap_or_default().contains(help),
                        "{from} -> {to}: {found}: {expected:?}"
                    );
                    assert_eq!(at, line, "{from} -> {to}: {found}");
                }
                other => panic!("{from} -> {to}: {other:?}"),
            }
        }
    }

    #[test]
    fn the_maps_of_the_repository_are_valid() {
        for (robot, joints) in [("ur5", 6), ("wam", 7)] {
            let path =
                Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models").join(robot).join("columns.toml");
            let (map, source) = load_column_map(&path).expect("the map of the repository");
            assert_eq!(map.mapping.expect("named").joints.len(), joints);
            assert!(source.text.contains("schema"));
        }
        assert!(
            load_column_map(Path::new("no such map.toml")).unwrap_err().to_string().contains("no such map")
        );
    }

    /// The map in the module's documentation.
    #[test]
    fn the_documented_map_is_valid() {
        let documented: String = include_str!("columns.rs")
            .lines()
            .skip_while(|line| *line != "//! ```toml")
            .skip(1)
            .take_while(|line| *line != "//! ```")
            .flat_map(|line| [line.trim_start_matches("//!"), "\n"])
            .collect();
        let map = parse(&documented).expect("as documented").mapping.expect("named");
        assert_eq!((map.joints.len(), map.names().len()), (3, 3 + 3 + 6 + 3 + 5));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        #[test]
        fn no_mutation_of_a_map_panics(at in 0usize..400, remove in 0usize..6, insert in "\\PC{0,3}|[\"\\[\\]=.,\n-]{0,3}") {
            for text in [CARTESIAN, SPHERICAL] {
                let mut text: Vec<char> = text.chars().collect();
                let at = at.min(text.len());
                let end = (at + remove).min(text.len());
                text.splice(at..end, insert.chars());
                if let Err(error) = parse(&text.into_iter().collect::<String>()) {
                    let drawn = format!("{:?}", miette::Report::new(error));
                    prop_assert!(!drawn.is_empty());
                }
            }
        }
    }
}
