//! The map as text, with its reasons.

use std::fmt::Write;

use super::column::{Role, SeenColumn};
use super::{SeenFile, SuggestedMap};
use crate::measurements::layout::Decimal;
use crate::measurements::units::{AngleUnit, HeaderUnit, LengthUnit, unit_of_name};

/// What a unit was told from.
enum Told<U> {
    /// The header says so to the reader as well, column by column.
    Header(String),
    /// With the reason.
    Seen(U, String),
    /// With what speaks for what.
    Open(String),
}

struct Writer<'f> {
    text: String,
    open: Vec<String>,
    points: &'f SeenFile,
    joints: &'f SeenFile,
    several: bool,
}

/// The map of files that belong together.
pub(super) fn map_of(files: &[SeenFile]) -> SuggestedMap {
    let has = |file: &&SeenFile, role| file.one(role).is_some();
    let has_position = |file: &&SeenFile| has(file, Role::X) || has(file, Role::Range);
    let Some(points) = files.iter().find(has_position).or(files.first()) else {
        return SuggestedMap { text: String::new(), open: vec!["a file".to_owned()] };
    };
    let joints = files.iter().find(|file| !has_position(file) && has(file, Role::Joint)).unwrap_or(points);
    let several = !std::ptr::eq(points, joints);
    let mut writer = Writer { text: String::new(), open: Vec::new(), points, joints, several };
    writer.head(files);
    writer.joints();
    writer.position();
    writer.sigma();
    writer.rest();
    writer.join();
    writer.form();
    SuggestedMap { text: writer.text, open: writer.open }
}

impl Writer<'_> {
    fn line(&mut self, line: &str) {
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// A key with the reason for its value.
    fn key(&mut self, key: &str, value: &str, reason: &str) {
        let line = format!("{key} = {value}");
        self.line(&if reason.is_empty() { line } else { format!("{line:<33} # {reason}") });
    }

    /// A key that a person must decide.
    fn undecided(&mut self, key: &str, value: &str, why: &str) {
        self.line(&format!("# DECIDE: {key} = {value:<17} # {why}"));
        self.open.push(format!("{key}: {why}"));
    }

    fn head(&mut self, files: &[SeenFile]) {
        self.line("schema = \"calibrig.columns/1\"");
        self.line("");
        self.line("# Suggested by `calibrig columns suggest`. Every line says why; check the units, signs and order before you trust it.");
        for file in files {
            let form = if file.has_header { "with a header" } else { "without a header: columns by number" };
            self.line(&format!(
                "# {}: {} rows of {} columns, {form}",
                file.name,
                file.rows,
                file.columns.len()
            ));
            for found in &file.found {
                self.line(&format!("# {found}"));
            }
            for (place, comment) in &file.unit_comments {
                self.line(&format!("# {place} says: {comment}"));
            }
        }
        if files.len() > 1 {
            let paths = |wanted: &dyn Fn(&&SeenFile) -> bool, flag: &str| {
                let of = files.iter().filter(|file| wanted(file));
                of.fold(String::new(), |mut text, file| {
                    // Writing to a String cannot fail.
                    let _ = write!(text, " {flag} {}", file.name);
                    text
                })
            };
            let joints = self.joints.name.clone();
            let is_joints = |file: &&SeenFile| self.several && file.name == joints;
            let command = format!(
                "# Use: calibrig identify --model ROBOT.toml --columns THIS.toml{}{}",
                paths(&|file| !is_joints(file), "--measurements"),
                paths(&is_joints, "--joints")
            );
            self.line(&command);
            if files.len() > 1 + usize::from(self.several) {
                self.line("# Where each file is of one target: --measurements TARGET=FILE");
            }
        }
    }

    fn joints(&mut self) {
        self.line("");
        self.line("[joints]");
        let columns = self.joints.with(Role::Joint);
        if columns.is_empty() {
            self.undecided(
                "columns",
                "[\"J1\", \"J2\"]",
                "no column looks like a joint's: name them in the robot's order",
            );
            return;
        }
        let entries: Vec<_> = columns.iter().map(|column| column.entry(self.joints.has_header)).collect();
        self.key("columns", &format!("[{}]", entries.join(", ")), &reasons(&columns));
        let told = angle_unit(&columns, "joints");
        let lengths: Vec<_> =
            columns.iter().filter(|column| matches!(unit(column), Some(HeaderUnit::Length(_)))).collect();
        match told {
            Told::Header(unit) => self.line(&format!("# revolute_unit: {unit}, as the header says")),
            Told::Seen(unit, reason) => self.key("revolute_unit", &format!("{:?}", unit.key()), &reason),
            Told::Open(why) => self.undecided("revolute_unit", "\"deg\"", &why),
        }
        if lengths.is_empty() {
            self.line("# prismatic_unit = \"mm\"            # where the robot has a prismatic joint");
        } else {
            self.line("# prismatic_unit: as the header says");
        }
    }

    fn position(&mut self) {
        self.line("");
        self.line("[position]");
        let file = self.points;
        let entry = |column: &SeenColumn| column.entry(file.has_header);
        if let (Some(x), Some(y), Some(z)) = (file.one(Role::X), file.one(Role::Y), file.one(Role::Z)) {
            self.key("system", "\"cartesian\"", "");
            self.length("unit", &[x, y, z]);
            for (key, column) in [("x", x), ("y", y), ("z", z)] {
                self.key(key, &entry(column), &reason(column));
            }
            self.missed(&[x, y, z]);
            return;
        }
        let polar = file.one(Role::Elevation).map(|column| ("elevation", column));
        let polar = polar.or(file.one(Role::Zenith).map(|column| ("zenith", column)));
        if let (Some(range), Some(azimuth), Some((key, polar))) =
            (file.one(Role::Range), file.one(Role::Azimuth), polar)
        {
            self.key("system", "\"spherical\"", "");
            self.length("range_unit", &[range]);
            match angle_unit(&[azimuth, polar], "azimuth and elevation") {
                Told::Header(unit) => self.line(&format!("# angle_unit: {unit}, as the header says")),
                Told::Seen(unit, reason) => self.key("angle_unit", &format!("{:?}", unit.key()), &reason),
                Told::Open(why) => self.undecided("angle_unit", "\"deg\"", &why),
            }
            self.key("range", &entry(range), &reason(range));
            self.key("azimuth", &entry(azimuth), &reason(azimuth));
            self.key(key, &entry(polar), &reason(polar));
            self.missed(&[range, azimuth, polar]);
            return;
        }
        self.key("system", "\"cartesian\"", "");
        self.undecided("x", "\"X\"", "no three columns look like a position: name x, y and z");
    }

    /// The unit of lengths; units in comments of the file speak too.
    fn length(&mut self, key: &str, columns: &[&SeenColumn]) {
        let in_comment = self.points.unit_comments.iter().find_map(|(place, text)| {
            let lower = text.to_lowercase();
            let unit = [
                ("millimet", LengthUnit::Mm),
                ("[mm]", LengthUnit::Mm),
                (" mm", LengthUnit::Mm),
                ("inch", LengthUnit::Inch),
                ("meters", LengthUnit::M),
                ("metres", LengthUnit::M),
            ]
            .into_iter()
            .find(|(word, _)| lower.contains(word))?;
            Some((unit.1, format!("{place} says {text:?}")))
        });
        match length_unit(columns, in_comment) {
            Told::Header(unit) => self.line(&format!("# {key}: {unit}, as the header says")),
            Told::Seen(unit, reason) => self.key(key, &format!("{:?}", unit.key()), &reason),
            Told::Open(why) => self.undecided(key, "\"mm\"", &why),
        }
    }

    /// Marks of missed shots among the numbers of a position.
    fn missed(&mut self, columns: &[&SeenColumn]) {
        let mut marks: Vec<String> =
            columns.iter().flat_map(|column| column.marks(self.points.decimal)).collect();
        marks.sort();
        marks.dedup();
        if !marks.is_empty() {
            self.key(
                "missed",
                &format!("[{}]", marks.join(", ")),
                "no coordinates, by their looks: marks of missed shots",
            );
        }
    }

    fn sigma(&mut self) {
        let file = self.points;
        let [x, y, z] = [Role::SigmaX, Role::SigmaY, Role::SigmaZ].map(|role| file.one(role));
        let (Some(x), Some(y), Some(z)) = (x, y, z) else { return };
        let is_expanded = [x, y, z].iter().any(|column| {
            let name = column.header.to_lowercase();
            name.contains("95") || name.starts_with('u')
        });
        let before = self.text.len();
        self.line("");
        self.line("[sigma]");
        match (unit(x), header_units(&[x, y, z], is_length)) {
            (_, Some(unit)) => self.line(&format!("# unit: {unit}, as the header says")),
            (Some(HeaderUnit::Length(unit)), _) => {
                self.key(
                    "unit",
                    &format!("{:?}", unit.key()),
                    &format!("the name {:?} ends with it", x.header),
                );
            }
            _ => {
                self.undecided("unit", "\"um\"", &format!("up to {}, and no unit is stated", x.numbers.most));
            }
        }
        for (key, column) in [("x", x), ("y", y), ("z", z)] {
            self.key(key, &column.entry(file.has_header), &reason(column));
        }
        if is_expanded {
            // Without a factor it would count as a standard deviation: none of it is used before that is decided.
            let why = "U is an expanded uncertainty: k = 2 where it is U(95), 1 where it is a standard deviation; then take the # away";
            self.undecided("k", "2", why);
            let section = self.text.split_off(before);
            for line in section.lines() {
                let is_plain = line.is_empty() || line.starts_with('#');
                self.line(&if is_plain { line.to_owned() } else { format!("# {line}") });
            }
        }
    }

    fn rest(&mut self) {
        let file = self.points;
        self.line("");
        self.line("[columns]");
        if let Some(column) = file.one(Role::Pose) {
            self.key("pose", &column.entry(file.has_header), &reason(column));
        }
        if let Some(column) = file.one(Role::Name) {
            let why = "names every row, so it is no target; `pose` where rows of one pose have one name";
            let line = format!("# pose = {}", column.entry(file.has_header));
            self.line(&format!("{line:<33} # {}, {why}", reason(column)));
        }
        for (key, role) in [("station", Role::Station), ("target", Role::Target)] {
            let Some(column) = file.one(role) else { continue };
            let entry = column.entry(file.has_header);
            if role == Role::Target
                && file.rows > 1
                && (column.many_texts || column.texts().len() as u64 == file.rows)
            {
                self.line(&format!(
                    "# {key} = {entry}: another one in every row, so it is no reflector's name"
                ));
                continue;
            }
            let names = column.texts();
            let names = if names.len() > 4 { format!("{} names", names.len()) } else { names.join(", ") };
            self.key(key, &entry, &format!("{}: {names}", reason(column)));
        }
        if let Some(column) = file.one(Role::Time) {
            self.key(
                "time_s",
                &column.entry(file.has_header),
                &format!("{}: seconds, or a time of the day", reason(column)),
            );
        }
        if let Some(column) = file.one(Role::Temperature) {
            self.key("temperature_c", &column.entry(file.has_header), &reason(column));
        }
        let unused: Vec<_> = file.unused().map(|column| column.header.clone()).collect();
        if !unused.is_empty() {
            self.line(&format!("# not used: {}", unused.join(", ")));
        }
        if let Some(column) = file.one(Role::Set) {
            self.line("");
            self.line("[sets]");
            let names: Vec<_> = column.texts().iter().map(|text| format!("{text:?}")).collect();
            self.key("column", &column.entry(file.has_header), &reason(column));
            self.undecided(
                "verification",
                &format!("[{}]", names.join(", ")),
                "which of these rows are held out",
            );
            // A table with nothing decided is refused, so that it is not taken as decided.
        }
    }

    fn join(&mut self) {
        if !self.several {
            return;
        }
        let (joints, points) = (self.joints, self.points);
        self.line("");
        self.line("[join]");
        let entry = |file: &SeenFile, column: &SeenColumn| column.entry(file.has_header);
        let keys = |roles: [Role; 2]| {
            let find = |file: &'_ SeenFile| {
                roles.iter().find_map(|role| file.one(*role).map(|c| (entry(file, c), c.texts().len())))
            };
            Some((find(joints)?, find(points)?))
        };
        let shared =
            |a: &SeenColumn, b: &SeenColumn| a.texts().iter().filter(|text| b.texts().contains(text)).count();
        let name = |file: &'_ SeenFile| {
            file.columns.iter().position(|c| matches!(c.role, Some(Role::Name | Role::Pose)))
        };
        if let (Some(a), Some(b)) = (name(joints), name(points)) {
            let (a, b) = (&joints.columns[a], &points.columns[b]);
            let common = shared(a, b);
            if common > 1 {
                self.key("by", "\"name\"", &format!("{common} names or more are in both files"));
                self.key("joints", &entry(joints, a), &reason(a));
                self.key("points", &entry(points, b), &reason(b));
                return;
            }
        }
        if joints.rows == points.rows {
            self.key("by", "\"row\"", &format!("both files have {} rows", points.rows));
            return;
        }
        if let Some(((a, _), (b, _))) = keys([Role::Time, Role::Time]) {
            self.key(
                "by",
                "\"time\"",
                &format!("{} rows of joints and {} of points, both with times", joints.rows, points.rows),
            );
            self.key("joints", &a, "");
            self.key("points", &b, "");
            self.undecided("within_s", "0.05", "how far apart two times of one pose may be");
            return;
        }
        let why = format!(
            "{} rows of joints and {} of points, and no column that both have",
            joints.rows, points.rows
        );
        self.undecided("by", "\"row\"", &why);
    }

    fn form(&mut self) {
        if self.points.decimal == Decimal::Comma {
            self.line("");
            self.line("[text]");
            self.key("decimal", "\",\"", "numbers have a decimal comma");
        }
    }
}

fn reason(column: &SeenColumn) -> String {
    let numbers = &column.numbers;
    if numbers.count == 0 {
        return column.reason.clone();
    }
    format!(
        "{}; column {}: {} to {}",
        column.reason,
        column.number,
        short(numbers.least),
        short(numbers.most)
    )
}

fn reasons(columns: &[&SeenColumn]) -> String {
    let (first, numbers) = (columns[0], SeenFile::numbers_of(columns));
    format!("{}; {} to {} in all", first.reason, short(numbers.least), short(numbers.most))
}

fn short(number: f64) -> String {
    let text = format!("{number:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The unit that a header states, in brackets or at the end of its name.
fn unit(column: &SeenColumn) -> Option<HeaderUnit> {
    column.unit.or_else(|| unit_of_name(&column.header))
}

/// The units in brackets of all these columns, where all have one of the kind.
fn header_units(columns: &[&SeenColumn], is_of_kind: impl Fn(HeaderUnit) -> bool) -> Option<String> {
    let mut names: Vec<&str> = Vec::new();
    for column in columns {
        let unit = column.unit.filter(|unit| is_of_kind(*unit))?;
        if !names.contains(&unit.key()) {
            names.push(unit.key());
        }
    }
    (!names.is_empty()).then(|| names.join(" and "))
}

fn is_length(unit: HeaderUnit) -> bool {
    matches!(unit, HeaderUnit::Length(_))
}

fn is_angle(unit: HeaderUnit) -> bool {
    matches!(unit, HeaderUnit::Angle(_))
}

fn angle_unit(columns: &[&SeenColumn], what: &str) -> Told<AngleUnit> {
    let angles: Vec<&SeenColumn> = columns
        .iter()
        .copied()
        .filter(|column| !matches!(unit(column), Some(HeaderUnit::Length(_))))
        .collect();
    if angles.is_empty() {
        return Told::Open("no column of angles; where the robot has a revolute joint".to_owned());
    }
    if let Some(units) = header_units(&angles, is_angle) {
        return Told::Header(units);
    }
    if let Some(HeaderUnit::Angle(unit)) = unit(angles[0]) {
        return Told::Seen(unit, format!("the name {:?} ends with it", angles[0].header));
    }
    let largest = angles.iter().max_by(|a, b| a.numbers.largest().total_cmp(&b.numbers.largest()));
    let Some(largest) = largest else { return Told::Open(String::new()) };
    let (number, size) = (largest.number, largest.numbers.largest());
    let extreme = if largest.numbers.most.abs() >= largest.numbers.least.abs() { "max" } else { "min" };
    let value = short(if extreme == "max" { largest.numbers.most } else { largest.numbers.least });
    if size > 4.0 * std::f64::consts::PI && size <= 720.0 {
        return Told::Seen(AngleUnit::Deg, format!("column {number}: {extreme} {value}, looks like degrees"));
    }
    if size > 720.0 {
        return Told::Open(format!(
            "column {number}: {extreme} {value}, more than two turns in degrees: no angle, or another unit"
        ));
    }
    Told::Open(format!(
        "column {number}: {extreme} {value}: {what} in radians, or in degrees that hardly moved"
    ))
}

fn length_unit(columns: &[&SeenColumn], comment: Option<(LengthUnit, String)>) -> Told<LengthUnit> {
    if let Some(units) = header_units(columns, is_length) {
        return Told::Header(units);
    }
    if let Some(HeaderUnit::Length(unit)) = unit(columns[0]) {
        return Told::Seen(unit, format!("the name {:?} ends with it", columns[0].header));
    }
    if let Some((unit, reason)) = comment {
        return Told::Seen(unit, reason);
    }
    let largest = SeenFile::numbers_of(columns).largest();
    if (200.0..1e5).contains(&largest) {
        return Told::Seen(
            LengthUnit::Mm,
            format!("up to {}, looks like mm: a tracker sees 0.2 to 80 m", short(largest)),
        );
    }
    if largest > 0.2 && largest <= 30.0 {
        return Told::Seen(
            LengthUnit::M,
            format!("up to {}, looks like m: as mm the points would be within a hand", short(largest)),
        );
    }
    Told::Open(format!("up to {}: m, mm and inch are all possible", short(largest)))
}
