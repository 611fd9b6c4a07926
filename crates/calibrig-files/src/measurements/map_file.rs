//! Column maps: `columns.toml`.
//!
//! ```toml
//! schema = "calibrig.columns/1"
//!
//! [joints]
//! columns = ["A1", "A2", "A3 + A2"] # what was commanded: an entry an actuator, in the robot's order
//! revolute_unit = "deg"             # deg, rad, mrad, arcsec or gon; needed where the robot has a revolute joint and the header states none
//! prismatic_unit = "mm"             # mm, m, um, cm or inch; needed where it has a prismatic one and the header states none
//!
//! [position]                        # of the target, in the tracker's frame
//! system = "cartesian"
//! unit = "mm"                       # as prismatic_unit
//! x = "x_target - x_error"          # an entry: a column, a signed sum, or a list of columns to add
//! y = ["y_target", "-y_error"]
//! z = 7                             # the seventh column; in a sum #7
//! missed = [-9999, "n/a"]           # optional: what marks a missed shot in a cell of the position, beside (0, 0, 0)
//! # or: system = "spherical", range = "R", range_unit = "m", azimuth = "Az", angle_unit = "deg" (rad, mrad, arcsec or gon), and
//! # either elevation = "El" (above the tracker's x-y plane) or zenith = "Ze" (from its z axis)
//!
//! [sigma]                           # optional: standard deviations above 0, in the system of the position
//! unit = "um"                       # spherical: range_unit and angle_unit
//! x = "sx"                          # spherical: range, azimuth, and elevation or zenith
//! y = "sy"
//! z = "sz"
//! k = 2                             # optional: coverage factor; the columns state k standard deviations, as U(95) does
//!
//! [noise]                           # optional: standard deviations a + b R of rows that state none
//! range_um = 2                      # a along the line of sight; range_um_per_m: b
//! transverse_um = 5                 # a across it
//! transverse_um_per_m = 1.5         # b
//!
//! [columns]                         # each optional
//! pose = "No"                       # whole numbers, or names
//! station = "Station"
//! target = "SMR"                    # the reflector, the same name in all its rows; not the name of the shot
//! time_s = "t"
//! temperature_c = "T"
//! approach = ["dir1", "dir2", "dir3"]  # -1, 0 or 1, one an actuator
//!
//! [rows]                            # each optional
//! approach_from = "order"           # signs of approach from the order of the rows
//! repeats = "average"               # repeats of a pose count as one reading
//!
//! [sets]                            # optional: which rows are held out
//! column = "use"
//! identification = ["fit"]
//! verification = ["check"]
//!
//! [join]                            # optional: where joints and points are in files of their own (--joints)
//! by = "name"                       # row, name or time
//! joints = "Name"                   # the column in the joints' file
//! points = "Point"                  # and in the points' files
//!
//! [text]                            # optional, each key: the form of a text file, where it is not found by itself
//! decimal = ","
//! ```

use std::fmt;
use std::ops::Range;
use std::path::Path;

use nalgebra::Vector3;
use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::cells::Delimiter;
use super::columns::{
    ColumnMap, ColumnRef, Entry, Join, JoinBy, Mapping, MissedCode, Noise, PolarAngle, PoseList,
    PositionColumns, RowChoices, Sets, SigmaUnits, Term, Uncertainty,
};
use super::layout::{Decimal, TableFormat};
use super::text::TextFormat;
use super::units::{AngleUnit, LengthUnit};
use crate::input::{InputError, Source, Spanned};

const SCHEMA: &str = "calibrig.columns/1";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MapFile {
    schema: Spanned<String>,
    joints: Spanned<JointsTable>,
    position: Spanned<CoordinateTable>,
    sigma: Option<Spanned<CoordinateTable>>,
    noise: Option<Spanned<NoiseTable>>,
    #[serde(default)]
    columns: ColumnsTable,
    #[serde(default)]
    rows: RowsTable,
    sets: Option<Spanned<SetsTable>>,
    join: Option<Spanned<JoinTable>>,
    #[serde(default)]
    text: TextTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointsTable {
    columns: Spanned<RawEntry>,
    revolute_unit: Option<AngleUnit>,
    prismatic_unit: Option<LengthUnit>,
}

#[derive(Deserialize, Clone, Copy, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
enum System {
    Cartesian,
    Spherical,
}

/// The columns of three coordinates. `x`, `y`, `z` and `unit` belong to the Cartesian system, the others to the spherical one; `missed` to
/// positions, `k` to sigmas.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CoordinateTable {
    system: Option<Spanned<System>>,
    unit: Option<Spanned<LengthUnit>>,
    x: Option<Spanned<RawEntry>>,
    y: Option<Spanned<RawEntry>>,
    z: Option<Spanned<RawEntry>>,
    range: Option<Spanned<RawEntry>>,
    range_unit: Option<Spanned<LengthUnit>>,
    azimuth: Option<Spanned<RawEntry>>,
    elevation: Option<Spanned<RawEntry>>,
    zenith: Option<Spanned<RawEntry>>,
    angle_unit: Option<Spanned<AngleUnit>>,
    missed: Option<Spanned<Codes>>,
    k: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoiseTable {
    range_um: Option<Spanned<f64>>,
    range_um_per_m: Option<Spanned<f64>>,
    transverse_um: Option<Spanned<f64>>,
    transverse_um_per_m: Option<Spanned<f64>>,
    k: Option<Spanned<f64>>,
    tracker_mm: Option<[Spanned<f64>; 3]>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct ColumnsTable {
    pose: Option<Spanned<RawEntry>>,
    station: Option<Spanned<RawEntry>>,
    target: Option<Spanned<RawEntry>>,
    time_s: Option<Spanned<RawEntry>>,
    temperature_c: Option<Spanned<RawEntry>>,
    approach: Option<Spanned<RawEntry>>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct RowsTable {
    approach_from: Option<ApproachFrom>,
    #[serde(default)]
    repeats: Repeats,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "lowercase")]
enum ApproachFrom {
    Order,
}

#[derive(Deserialize, Clone, Copy, Default, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Repeats {
    #[default]
    Keep,
    Average,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SetsTable {
    column: Option<Spanned<RawEntry>>,
    #[serde(default)]
    identification: Vec<String>,
    #[serde(default)]
    verification: Vec<String>,
    verification_poses: Option<Spanned<Codes>>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "lowercase")]
enum By {
    Row,
    Name,
    Time,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JoinTable {
    by: By,
    joints: Option<Spanned<RawEntry>>,
    points: Option<Spanned<RawEntry>>,
    within_s: Option<Spanned<f64>>,
    offset_s: Option<Spanned<f64>>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct TextTable {
    delimiter: Option<Spanned<String>>,
    decimal: Option<Spanned<String>>,
    header: Option<bool>,
    #[serde(default)]
    comments: Vec<String>,
    #[serde(default)]
    skip_lines: u32,
    widths: Option<Spanned<Vec<u32>>>,
}

/// An entry as it stands in the file.
#[derive(Debug)]
enum RawEntry {
    Text(String),
    Number(i64),
    List(Vec<Spanned<RawEntry>>),
}

impl<'de> Deserialize<'de> for RawEntry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct EntryVisitor;
        impl<'de> Visitor<'de> for EntryVisitor {
            type Value = RawEntry;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a column: its name in quotes, a signed sum such as \"a - b\", its number, or a list of these")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<RawEntry, E> {
                Ok(RawEntry::Text(text.to_owned()))
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<RawEntry, E> {
                Ok(RawEntry::Number(number))
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<RawEntry, E> {
                Ok(RawEntry::Number(i64::try_from(number).unwrap_or(i64::MAX)))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<RawEntry, A::Error> {
                let mut list = Vec::new();
                while let Some(item) = items.next_element()? {
                    list.push(item);
                }
                Ok(RawEntry::List(list))
            }
        }
        deserializer.deserialize_any(EntryVisitor)
    }
}

/// Numbers and texts, or a list of them.
#[derive(Debug, Default)]
struct Codes(Vec<String>);

impl<'de> Deserialize<'de> for Codes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct CodesVisitor;
        impl<'de> Visitor<'de> for CodesVisitor {
            type Value = Codes;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, a text in quotes, or a list of these")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Codes, E> {
                Ok(Codes(vec![text.to_owned()]))
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Codes, E> {
                Ok(Codes(vec![number.to_string()]))
            }

            fn visit_f64<E: de::Error>(self, number: f64) -> Result<Codes, E> {
                Ok(Codes(vec![number.to_string()]))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Codes, A::Error> {
                let mut list = Vec::new();
                while let Some(Codes(mut items)) = items.next_element()? {
                    list.append(&mut items);
                }
                Ok(Codes(list))
            }
        }
        deserializer.deserialize_any(CodesVisitor)
    }
}

type KeySpan = (&'static str, Option<Range<usize>>);

fn key_span<T>(key: &'static str, value: Option<&Spanned<T>>) -> KeySpan {
    (key, value.map(Spanned::span))
}

impl CoordinateTable {
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

/// Reads a column map, with the text that it was read from.
pub fn load_column_map(path: &Path) -> Result<(ColumnMap, Source), InputError> {
    let source = Source::read(path)?;
    Ok((parse_column_map(&source)?, source))
}

/// Reads a column map from a text in memory.
pub fn parse_column_map(source: &Source) -> Result<ColumnMap, InputError> {
    let file: MapFile = source.toml().map_err(with_the_table_of_a_stray_key)?;
    if file.schema.get_ref() != SCHEMA {
        let message = format!("schema is {:?}", file.schema.get_ref());
        return Err(source.error(file.schema.span(), message, Some(format!("expected {SCHEMA:?}"))));
    }
    let reader = Reader { source };
    let (position, polar) = reader.position(&file.position)?;
    let joints = file.joints.get_ref();
    let columns = reader.entries(&joints.columns)?;
    if columns.is_empty() {
        return Err(reader.error(file.joints.span(), "[joints] names no columns", "one column a joint"));
    }
    let approach = match &file.columns.approach {
        Some(list) => reader.entries(list)?,
        None => Vec::new(),
    };
    if let Some(list) = &file.columns.approach
        && approach.len() != columns.len()
    {
        let message = format!("approach names {} columns, [joints] {}", approach.len(), columns.len());
        return Err(reader.error(list.span(), message, "one column an actuator"));
    }
    let approach_from_order = matches!(file.rows.approach_from, Some(ApproachFrom::Order));
    if let Some(list) = file.columns.approach.as_ref().filter(|_| approach_from_order) {
        let message = "approach names columns, and [rows] has approach_from";
        return Err(reader.error(list.span(), message, "one of them"));
    }
    let optional = |entry: Option<&Spanned<RawEntry>>| entry.map(|entry| reader.single(entry)).transpose();
    let quantity = |entry: Option<&Spanned<RawEntry>>| entry.map(|entry| reader.sum(entry)).transpose();
    let rest = &file.columns;
    let mapping = Mapping {
        joints: columns,
        revolute: joints.revolute_unit,
        prismatic: joints.prismatic_unit,
        position,
        uncertainty: file.sigma.as_ref().map(|sigma| reader.sigmas(sigma, polar)).transpose()?,
        noise: file.noise.as_ref().map(|noise| reader.noise(noise)).transpose()?,
        pose: optional(rest.pose.as_ref())?,
        station: optional(rest.station.as_ref())?,
        target: optional(rest.target.as_ref())?,
        time: optional(rest.time_s.as_ref())?,
        temperature: quantity(rest.temperature_c.as_ref())?,
        approach,
        rows: RowChoices {
            missed: missed(file.position.get_ref()),
            approach_from_order,
            average_repeats: file.rows.repeats == Repeats::Average,
        },
        sets: file.sets.as_ref().map(|sets| reader.sets(sets)).transpose()?.unwrap_or_default(),
        join: file.join.as_ref().map(|join| reader.join(join)).transpose()?,
        text: reader.text(&file.text)?,
        table: TableFormat { decimal: reader.decimal(&file.text)?, header: file.text.header },
    };
    Ok(ColumnMap::new(mapping, source.clone()))
}

/// Says of an unknown key in which table it is known.
fn with_the_table_of_a_stray_key(mut error: InputError) -> InputError {
    const TABLES: [(&str, &[&str]); 7] = [
        ("[joints]", &["revolute_unit", "prismatic_unit"]),
        ("[position]", &["missed", "unit", "system", "range_unit", "angle_unit"]),
        ("[sigma]", &["k"]),
        ("[columns]", &["pose", "station", "time_s", "temperature_c", "approach"]),
        ("[rows]", &["approach_from", "repeats"]),
        ("[sets]", &["identification", "verification", "verification_poses"]),
        ("[text]", &["delimiter", "decimal", "header", "comments", "skip_lines", "widths"]),
    ];
    let InputError::Invalid { message, help: Some(help), .. } = &mut error else { return error };
    let Some(key) = message.strip_prefix("unknown key `").and_then(|rest| rest.strip_suffix('`')) else {
        return error;
    };
    if key == "target" {
        help.push_str(
            "; the column with the targets' names is `target` in [columns]; where they are on the flange is stated in the robot's file \
             ([target], [[target]]) or in a session file",
        );
    } else if let Some((table, _)) = TABLES.iter().find(|(_, keys)| keys.contains(&key)) {
        help.push_str("; it stands in ");
        help.push_str(table);
    }
    error
}

fn missed(position: &CoordinateTable) -> Vec<MissedCode> {
    let codes = position.missed.iter().flat_map(|codes| &codes.get_ref().0);
    codes.map(|code| MissedCode::parse(code)).collect()
}

struct Reader<'a> {
    source: &'a Source,
}

impl Reader<'_> {
    fn error(&self, span: Range<usize>, message: impl fmt::Display, expected: &str) -> InputError {
        self.source.error(span, message, Some(format!("expected {expected}")))
    }

    /// A column by its name, or by `#` and its number.
    fn column(&self, span: Range<usize>, name: &str) -> Result<ColumnRef, InputError> {
        let name = name.trim();
        if name.is_empty() {
            return Err(self.error(span, "a sign without a column", "a name of the header line"));
        }
        match name.strip_prefix('#').map(str::parse) {
            Some(Ok(0)) => Err(self.error(span, "#0 is no column", "columns from #1")),
            Some(Ok(number)) => Ok(ColumnRef::Number(number)),
            _ => Ok(ColumnRef::Name(name.to_owned())),
        }
    }

    /// The terms of a text: `a`, `-a`, `a + b - c`. Blanks stand around a sign between columns, since names may have signs in them.
    fn terms(&self, span: &Range<usize>, text: &str, terms: &mut Vec<Term>) -> Result<(), InputError> {
        let text = text.trim();
        if text.is_empty() {
            return Err(self.error(
                span.clone(),
                "the name of a column is empty",
                "a name of the header line",
            ));
        }
        if text.ends_with(" +") || text.ends_with(" -") {
            return Err(self.error(span.clone(), "a sign without a column", "a name of the header line"));
        }
        let (mut sign, mut rest) = match text.strip_prefix('-') {
            Some(rest) => (-1.0, rest),
            None => (1.0, text.strip_prefix('+').unwrap_or(text)),
        };
        loop {
            let next = [(" + ", 1.0), (" - ", -1.0)];
            let found = next.iter().filter_map(|(op, sign)| rest.find(op).map(|at| (at, *sign)));
            let (at, next_sign) = found.min_by_key(|(at, _)| *at).unwrap_or((rest.len(), 1.0));
            terms.push(Term { column: self.column(span.clone(), &rest[..at])?, sign });
            if at == rest.len() {
                return Ok(());
            }
            (sign, rest) = (next_sign, &rest[at + 3..]);
        }
    }

    fn add(&self, entry: &Spanned<RawEntry>, terms: &mut Vec<Term>) -> Result<(), InputError> {
        let span = entry.span();
        match entry.get_ref() {
            RawEntry::Text(text) => self.terms(&span, text, terms),
            RawEntry::Number(number) => {
                let sign = if *number < 0 { -1.0 } else { 1.0 };
                let number = usize::try_from(number.unsigned_abs()).unwrap_or(usize::MAX);
                if number == 0 {
                    return Err(self.error(span, "0 is no column", "columns from 1"));
                }
                terms.push(Term { column: ColumnRef::Number(number), sign });
                Ok(())
            }
            RawEntry::List(list) if list.is_empty() => {
                Err(self.error(span, "a sum of no columns", "one column or more"))
            }
            RawEntry::List(list) => list.iter().try_for_each(|entry| self.add(entry, terms)),
        }
    }

    /// A quantity: one column, or the sum of several.
    fn sum(&self, entry: &Spanned<RawEntry>) -> Result<Entry, InputError> {
        let mut terms = Vec::new();
        self.add(entry, &mut terms)?;
        let written = match entry.get_ref() {
            RawEntry::Text(text) => text.trim().to_owned(),
            RawEntry::Number(number) => format!("#{number}"),
            RawEntry::List(_) => self.source.text.get(entry.span()).unwrap_or_default().to_owned(),
        };
        Ok(Entry { written, terms })
    }

    /// One column.
    fn single(&self, entry: &Spanned<RawEntry>) -> Result<Entry, InputError> {
        let found = self.sum(entry)?;
        let is_list = matches!(entry.get_ref(), RawEntry::List(_));
        let is_one = found.terms.len() == 1 && found.terms[0].sign > 0.0;
        if is_one || !is_list {
            return Ok(found);
        }
        Err(self.error(
            entry.span(),
            format!("{} is no single column", found.written),
            "the name of one column",
        ))
    }

    /// Quantities, one of each.
    fn entries(&self, list: &Spanned<RawEntry>) -> Result<Vec<Entry>, InputError> {
        let RawEntry::List(items) = list.get_ref() else { return Ok(vec![self.sum(list)?]) };
        let mut seen: Vec<Entry> = Vec::with_capacity(items.len());
        for item in items {
            let entry = self.sum(item)?;
            if seen.contains(&entry) {
                let message = format!("column {:?} is named twice", entry.written);
                return Err(self.error(item.span(), message, "a column each"));
            }
            seen.push(entry);
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

    fn polar(
        &self,
        table: (&str, &Range<usize>),
        t: &CoordinateTable,
    ) -> Result<(Entry, PolarAngle), InputError> {
        match (&t.elevation, &t.zenith) {
            (Some(name), None) => Ok((self.sum(name)?, PolarAngle::Elevation)),
            (None, Some(name)) => Ok((self.sum(name)?, PolarAngle::Zenith)),
            (Some(_), Some(zenith)) => {
                Err(self.error(zenith.span(), "both elevation and zenith", "one of elevation and zenith"))
            }
            (None, None) => {
                let message = format!("[{}] has neither elevation nor zenith", table.0);
                Err(self.error(table.1.clone(), message, "one of elevation and zenith"))
            }
        }
    }

    fn xyz(&self, table: (&str, &Range<usize>), t: &CoordinateTable) -> Result<[Entry; 3], InputError> {
        Ok([
            self.sum(self.needed(table, "x", t.x.as_ref())?)?,
            self.sum(self.needed(table, "y", t.y.as_ref())?)?,
            self.sum(self.needed(table, "z", t.z.as_ref())?)?,
        ])
    }

    /// The position's columns and, of a spherical one, from where its second angle counts.
    fn position(
        &self,
        spanned: &Spanned<CoordinateTable>,
    ) -> Result<(PositionColumns, Option<PolarAngle>), InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        let table = ("position", &span);
        if let Some(k) = &t.k {
            return Err(self.error(k.span(), "k is not of a position", "k in [sigma] or [noise]"));
        }
        let unit = |unit: &Option<Spanned<LengthUnit>>| unit.as_ref().map(|unit| *unit.get_ref());
        if *self.needed(table, "system", t.system.as_ref())?.get_ref() == System::Cartesian {
            self.foreign(t.spherical_keys(), "cartesian")?;
            return Ok((PositionColumns::Cartesian { axes: self.xyz(table, t)?, unit: unit(&t.unit) }, None));
        }
        self.foreign(t.cartesian_keys(), "spherical")?;
        let (polar, polar_angle) = self.polar(table, t)?;
        let position = PositionColumns::Spherical {
            range: self.sum(self.needed(table, "range", t.range.as_ref())?)?,
            range_unit: unit(&t.range_unit),
            azimuth: self.sum(self.needed(table, "azimuth", t.azimuth.as_ref())?)?,
            polar,
            polar_angle,
            angle_unit: t.angle_unit.as_ref().map(|unit| *unit.get_ref()),
        };
        Ok((position, Some(polar_angle)))
    }

    /// The columns of the standard deviations; `polar` is that of the position, `None` for a Cartesian one.
    fn sigmas(
        &self,
        spanned: &Spanned<CoordinateTable>,
        polar: Option<PolarAngle>,
    ) -> Result<Uncertainty, InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        let table = ("sigma", &span);
        if let Some(system) = &t.system {
            let message = "[sigma] is in the system of [position]";
            return Err(self.error(system.span(), message, "no key system here"));
        }
        if let Some(missed) = &t.missed {
            return Err(self.error(missed.span(), "missed is not of an uncertainty", "missed in [position]"));
        }
        let coverage = self.coverage(t.k.as_ref())?;
        let Some(polar) = polar else {
            self.foreign(t.spherical_keys(), "cartesian")?;
            let units = SigmaUnits::Cartesian(t.unit.as_ref().map(|unit| *unit.get_ref()));
            return Ok(Uncertainty::Sigmas { columns: self.xyz(table, t)?, units, coverage });
        };
        self.foreign(t.cartesian_keys(), "spherical")?;
        let (name, own_polar) = self.polar(table, t)?;
        if own_polar != polar {
            let message = "[sigma] and [position] differ: one says elevation, the other zenith";
            return Err(self.error(span.clone(), message, "the same angle in both"));
        }
        let columns = [
            self.sum(self.needed(table, "range", t.range.as_ref())?)?,
            self.sum(self.needed(table, "azimuth", t.azimuth.as_ref())?)?,
            name,
        ];
        let length = t.range_unit.as_ref().map(|unit| *unit.get_ref());
        let angle = t.angle_unit.as_ref().map(|unit| *unit.get_ref());
        Ok(Uncertainty::Sigmas { columns, units: SigmaUnits::Spherical(length, angle), coverage })
    }

    fn coverage(&self, k: Option<&Spanned<f64>>) -> Result<f64, InputError> {
        k.map_or(Ok(1.0), |k| self.source.positive("k", k))
    }

    fn noise(&self, spanned: &Spanned<NoiseTable>) -> Result<Noise, InputError> {
        let t = spanned.get_ref();
        let k = self.coverage(t.k.as_ref())?;
        let size = |key: &str, value: &Option<Spanned<f64>>| match value {
            Some(value) => Ok(1e-6 * self.source.not_negative(key, value)? / k),
            None => Ok(0.0),
        };
        let range = [size("range_um", &t.range_um)?, size("range_um_per_m", &t.range_um_per_m)?];
        let transverse =
            [size("transverse_um", &t.transverse_um)?, size("transverse_um_per_m", &t.transverse_um_per_m)?];
        if range == [0.0; 2] || transverse == [0.0; 2] {
            let message =
                "[noise] needs a size along the line of sight and one across it: a + b R, R the distance";
            let expected = "range_um or range_um_per_m, and transverse_um or transverse_um_per_m, above zero";
            return Err(self.error(spanned.span(), message, expected));
        }
        let mut tracker = Vector3::zeros();
        for (coordinate, value) in tracker.iter_mut().zip(t.tracker_mm.iter().flatten()) {
            *coordinate = 1e-3 * self.source.finite("tracker_mm", value)?;
        }
        Ok(Noise { range, transverse, tracker })
    }

    fn sets(&self, spanned: &Spanned<SetsTable>) -> Result<Sets, InputError> {
        let t = spanned.get_ref();
        let mut poses = PoseList::default();
        if let Some(list) = &t.verification_poses {
            for pose in &list.get_ref().0 {
                let refused = |expected| self.error(list.span(), format!("{pose:?} is no pose"), expected);
                poses.add(pose).map_err(refused)?;
            }
        }
        if t.column.is_none() && poses.is_empty() {
            let message = "[sets] says nothing of which rows are held out";
            return Err(self.error(
                spanned.span(),
                message,
                "column with verification = [\"...\"], or verification_poses",
            ));
        }
        if t.column.is_some() && t.verification.is_empty() && t.identification.is_empty() {
            let message = "[sets] names a column, and not what stands in it";
            return Err(self.error(
                spanned.span(),
                message,
                "verification = [\"...\"], identification = [\"...\"] or both",
            ));
        }
        Ok(Sets {
            column: t.column.as_ref().map(|column| self.single(column)).transpose()?,
            identification: t.identification.clone(),
            verification: t.verification.clone(),
            poses,
        })
    }

    fn join(&self, spanned: &Spanned<JoinTable>) -> Result<Join, InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        if t.by == By::Row {
            if let Some(key) = t.joints.as_ref().or(t.points.as_ref()) {
                return Err(self.error(
                    key.span(),
                    "rows are joined by their order",
                    "no column, or by = \"name\"",
                ));
            }
            return Ok(Join { by: JoinBy::Row, keys: None });
        }
        let table = ("join", &span);
        let keys = [
            self.single(self.needed(table, "joints", t.joints.as_ref())?)?,
            self.single(self.needed(table, "points", t.points.as_ref())?)?,
        ];
        let by = if t.by == By::Name {
            JoinBy::Name
        } else {
            let within =
                self.source.positive("within_s", self.needed(table, "within_s", t.within_s.as_ref())?)?;
            let offset =
                t.offset_s.as_ref().map_or(Ok(0.0), |offset| self.source.finite("offset_s", offset))?;
            JoinBy::Time { within, offset }
        };
        Ok(Join { by, keys: Some(keys) })
    }

    fn text(&self, t: &TextTable) -> Result<TextFormat, InputError> {
        let mut delimiter = None;
        if let Some(stated) = &t.delimiter {
            let mut chars = stated.get_ref().chars();
            delimiter = Some(match (stated.get_ref().as_str(), chars.next(), chars.next()) {
                ("tab", ..) => Delimiter::Character('\t'),
                ("blanks", ..) | (_, Some(' '), None) => Delimiter::Blanks,
                (_, Some(c), None) if c != '"' => Delimiter::Character(c),
                _ => {
                    let message = format!("text.delimiter is {:?}", stated.get_ref());
                    return Err(self.error(stated.span(), message, "one character, \"tab\" or \"blanks\""));
                }
            });
        }
        if let Some(widths) = &t.widths {
            if delimiter.is_some() {
                return Err(self.error(widths.span(), "both delimiter and widths", "one of them"));
            }
            if widths.get_ref().is_empty() || widths.get_ref().contains(&0) {
                return Err(self.error(
                    widths.span(),
                    "a column of no width",
                    "the number of characters of each column",
                ));
            }
            delimiter =
                Some(Delimiter::Widths(widths.get_ref().iter().map(|width| *width as usize).collect()));
        }
        Ok(TextFormat {
            delimiter,
            comments: t.comments.iter().filter(|prefix| !prefix.is_empty()).cloned().collect(),
            skipped_lines: t.skip_lines.into(),
        })
    }

    fn decimal(&self, t: &TextTable) -> Result<Option<Decimal>, InputError> {
        let Some(stated) = &t.decimal else { return Ok(None) };
        match stated.get_ref().as_str() {
            "." => Ok(Some(Decimal::Point)),
            "," => Ok(Some(Decimal::Comma)),
            other => {
                let message = format!("text.decimal is {other:?}");
                Err(self.error(stated.span(), message, "\".\" or \",\""))
            }
        }
    }
}

#[cfg(test)]
mod tests;
