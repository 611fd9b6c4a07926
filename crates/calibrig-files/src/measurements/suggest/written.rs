//! The map as text, with its reasons.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

use super::column::{Role, SeenColumn};
use super::payload;
use super::rotation::{Turned, turned};
use super::surroundings::{self, Said};
use super::told::{
    Told, angle_unit, header_units, is_length, is_prismatic, length_unit, reason, reasons, stroke_unit,
    time_of, unit,
};
use super::{SeenFile, SuggestedMap};
use crate::input::quoted;
use crate::measurements::layout::Decimal;
use crate::measurements::units::{HeaderUnit, LengthUnit};

/// "1 row", "2 rows".
fn counted(count: u64, noun: &str) -> String {
    if count == 1 { format!("1 {noun}") } else { format!("{count} {noun}s") }
}

/// A name of a target for every file: the file's without its folder and ending, where those differ.
fn target_names(files: &[SeenFile]) -> Option<Vec<String>> {
    let stem = |file: &SeenFile| Some(Path::new(&file.name).file_stem()?.to_str()?.to_owned());
    let names = files.iter().map(stem).collect::<Option<Vec<_>>>()?;
    let different: BTreeSet<&String> = names.iter().collect();
    let are_plain = names.iter().all(|name| !name.contains(['=', ' ']));
    (different.len() == names.len() && are_plain).then_some(names)
}

/// Why units of a bag are known.
const BAG: &str = "a bag of ROS 2, which is in rad and m";

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
    writer.rotation();
    writer.sigma();
    writer.face();
    writer.rest();
    writer.join();
    writer.form();
    SuggestedMap { text: writer.text, open: writer.open }
}

impl Writer<'_> {
    fn line(&mut self, line: &str) {
        // Names of columns appear in comments as they are, and TOML forbids other characters there.
        self.text.extend(line.chars().map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c }));
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

    fn say(&mut self, said: Vec<Said>) {
        for said in said {
            match said {
                Said::Key(key, value, why) => self.key(&key, &value, &why),
                Said::Open(key, value, why) => self.undecided(&key, &value, &why),
            }
        }
    }

    fn head(&mut self, files: &[SeenFile]) {
        self.line("schema = \"calibrig.columns/1\"");
        self.line("");
        self.line("# Suggested by `calibrig columns suggest`. Every line says why; check the units, signs and order before you trust it.");
        for file in files {
            let form = if file.has_header { "with a header" } else { "without a header: columns by number" };
            self.line(&format!(
                "# {}: {} of {}, {form}",
                file.name,
                counted(file.rows, "row"),
                counted(file.columns.len() as u64, "column")
            ));
            for found in &file.found {
                self.line(&format!("# {found}"));
            }
            for (place, comment) in &file.unit_comments {
                self.line(&format!("# {place} says: {comment}"));
            }
        }
        if files.len() > 1 {
            let is_joints = |file: &SeenFile| self.several && std::ptr::eq(file, self.joints);
            let several_points = files.len() > 1 + usize::from(self.several);
            // Points of one file of joints are those of several targets.
            let targets = if self.several && several_points { target_names(files) } else { None };
            let mut command = String::from("# Use: calibrig identify --model ROBOT.toml --columns THIS.toml");
            for (index, file) in files.iter().enumerate() {
                let target = targets.as_ref().map_or_else(String::new, |names| format!("{}=", names[index]));
                // Writing to a String cannot fail.
                let _ = if is_joints(file) {
                    write!(command, " --joints {}", file.name)
                } else {
                    write!(command, " --measurements {target}{}", file.name)
                };
            }
            self.line(&command);
            if several_points {
                let named = if targets.is_some() { ", here called as the files are" } else { "" };
                self.line(&format!("# Where each file is of one target: --measurements TARGET=FILE{named}"));
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
                "no column looks like a joint's: name the joints' columns in the robot's order; if the commands are in \
                 another file, suggest a map for both together",
            );
            return;
        }
        let entries: Vec<_> = columns.iter().map(|column| column.entry(self.joints.has_header)).collect();
        let entries = format!("[{}]", entries.join(", "));
        let has_order =
            |column: &&SeenColumn| column.joint.as_ref().is_some_and(|joint| joint.order.is_some());
        if self.joints.is_bag && !columns.iter().all(has_order) {
            let why =
                "every joint in the bag, in the bag's order: put the robot's joints into the robot's order";
            self.undecided("columns", &entries, why);
        } else {
            self.key("columns", &entries, &reasons(&columns));
        }
        self.order_of(&columns);
        if self.joints.is_bag {
            self.key("revolute_unit", "\"rad\"", BAG);
            self.key("prismatic_unit", "\"m\"", BAG);
            return;
        }
        let (lengths, angles): (Vec<&SeenColumn>, Vec<&SeenColumn>) =
            columns.iter().copied().partition(|column| is_prismatic(column, &columns));
        if angles.is_empty() {
            self.line("# revolute_unit = \"deg\"            # if the robot has a revolute joint");
        } else {
            match angle_unit(&angles, "joints") {
                Told::Header(unit) => self.line(&format!("# revolute_unit: {unit}, as the header says")),
                Told::Seen(unit, reason) => self.key("revolute_unit", &format!("{:?}", unit.key()), &reason),
                Told::Open(why) => self.undecided("revolute_unit", "\"deg\"", &why),
            }
        }
        if lengths.is_empty() {
            self.line("# prismatic_unit = \"mm\"            # if the robot has a prismatic joint");
            return;
        }
        match stroke_unit(&lengths) {
            Told::Header(unit) => self.line(&format!("# prismatic_unit: {unit}, as the header says")),
            Told::Seen(unit, reason) => self.key("prismatic_unit", &format!("{:?}", unit.key()), &reason),
            Told::Open(why) => self.undecided("prismatic_unit", "\"mm\"", &why),
        }
    }

    /// Remark on the order of the joints' columns.
    fn order_of(&mut self, columns: &[&SeenColumn]) {
        let names = || columns.iter().filter_map(|column| column.joint.as_ref());
        if names().any(|joint| joint.has_own_name && joint.order.is_none() && !joint.is_external) {
            self.line("# In the order of the file: put them into the robot's order, starting at the base.");
        } else if names().any(|joint| joint.has_own_name && !joint.is_external) {
            self.line("# From base to wrist by their names, whatever the order in the file: compare with the robot's.");
        }
        let external: Vec<_> = columns
            .iter()
            .filter(|column| column.joint.as_ref().is_some_and(|joint| joint.is_external))
            .map(|column| column.header.as_str())
            .collect();
        if !external.is_empty() && external.len() < columns.len() {
            self.line(&format!(
                "# {}: not part of the arm, by the name; put it where the robot's file has it (a rail in front of the first \
                 axis), or leave it out.",
                external.join(", ")
            ));
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
                match &x.doubt {
                    Some(doubt) if key == "x" => self.undecided(key, &entry(column), doubt),
                    Some(_) => self.undecided(key, &entry(column), &format!("with x; {}", reason(column))),
                    None => self.key(key, &entry(column), &reason(column)),
                }
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

    /// The unit of lengths; units in comments of the file count as well.
    fn length(&mut self, key: &str, columns: &[&SeenColumn]) {
        if self.points.is_bag {
            self.key(key, "\"m\"", BAG);
            return;
        }
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
                "not plausible as coordinates: marks of missed shots",
            );
        }
    }

    /// The rotation next to the position. Its conventions cannot be seen; if it is not wanted, its lines can be
    /// deleted.
    fn rotation(&mut self) {
        let columns = self.points.turn();
        let Some(turned) = turned(&columns) else { return };
        let is_seen = columns.iter().all(|column| column.role == Some(Role::Turn));
        self.line("");
        let Turned { keys, open } = turned;
        let entries: Vec<_> = columns.iter().map(|column| column.entry(self.points.has_header)).collect();
        let mut keys: Vec<(&str, String, String)> =
            keys.into_iter().map(|(key, value, why)| (key, quoted(value), why)).collect();
        keys.push(("columns", format!("[{}]", entries.join(", ")), reasons(&columns)));
        let mut open: Vec<(&str, String, String)> =
            open.into_iter().map(|(key, value, why)| (key, quoted(value), why)).collect();
        let why =
            "which frame is given in which: the target in the tracker's frame; or \"tracker_in_target\"";
        open.insert(0, ("transform", "\"target_in_tracker\"".to_owned(), why.to_owned()));
        if columns.len() == 3 {
            match angle_unit(&columns, "angles") {
                Told::Header(unit) => keys.push(("# unit", unit, "as the header says".to_owned())),
                Told::Seen(unit, why) => keys.push(("unit", format!("{:?}", unit.key()), why)),
                Told::Open(why) => open.push(("unit", "\"deg\"".to_owned(), why)),
            }
        }
        if is_seen {
            self.line("# If the rotation is not wanted, delete [rotation]: the rows are then points.");
            self.line("[rotation]");
            for (key, value, why) in open {
                self.undecided(key, &value, &why);
            }
            for (key, value, why) in keys {
                self.key(key, &value, &why);
            }
            return;
        }
        self.line("# If the tracker measured full poses (a probe, motion capture), decide the values and remove the #; \
                   otherwise leave it so.");
        self.line("# [rotation]");
        for (key, value, why) in open {
            self.line(&format!("# {key} = {value:<17} # to decide: {why}"));
        }
        for (key, value, why) in keys {
            let line = format!("# {key} = {value}");
            self.line(&format!("{line:<33} # {why}"));
        }
    }

    fn face(&mut self) {
        let Some(column) = self.points.one(Role::Face) else { return };
        self.line("");
        if self.points.one(Role::Range).is_none() {
            self.line(&format!(
                "# {}: faces apply to range and angles; both faces of a pose are averaged with repeats = \"average\" in \
                 [rows].",
                column.header
            ));
            return;
        }
        let texts = column.texts();
        let words = surroundings::faces(&texts);
        if words.is_none() && texts.len() != 2 {
            self.line(&format!(
                "# {} holds {} different texts, but there are two faces: see [face] in docs/formats.md.",
                column.header,
                texts.len()
            ));
            return;
        }
        self.line("[face]");
        self.key("column", &column.entry(self.points.has_header), &column.reason.clone());
        if let Some([front, back]) = words {
            self.key("front", &format!("[{}]", quoted(front)), "as programs write it");
            self.key(
                "back",
                &format!("[{}]", quoted(back)),
                "whether angles are the encoders' own is found from the values",
            );
        } else {
            let why =
                format!("one of {} and {} is the front face, the other the back face", texts[0], texts[1]);
            self.undecided("front", &format!("[{}]", quoted(texts[0])), &why);
            self.undecided("back", &format!("[{}]", quoted(texts[1])), "the other one");
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
                self.undecided("unit", "\"um\"", &format!("up to {}, with no unit stated", x.numbers.most));
            }
        }
        for (key, column) in [("x", x), ("y", y), ("z", z)] {
            self.key(key, &column.entry(file.has_header), &reason(column));
        }
        if is_expanded {
            // Without a factor it would count as a standard deviation: none of it is used before that is decided.
            let why = "U is an expanded uncertainty: k = 2 for U(95), 1 for a standard deviation; then remove the #";
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
            let why =
                "different in every row, so not a target; use it as `pose` if rows of one pose share a name";
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
                self.line(&format!("# {key} = {entry}: different in every row, so not a reflector's name"));
                continue;
            }
            let names = column.texts();
            let names = if names.len() > 4 { format!("{} names", names.len()) } else { names.join(", ") };
            self.key(key, &entry, &format!("{}: {names}", reason(column)));
        }
        if let Some((key, value, why)) = time_of(file) {
            self.key(&key, &value, &why);
        }
        self.say(surroundings::of_air(file));
        // By its name a column is found in either file.
        let is_named = |column: &SeenColumn| !column.is_repeated && self.joints.has_header;
        let in_joints = self.several && self.joints.columns.iter().any(|c| c.is_of_payload() && is_named(c));
        let in_points = file.columns.iter().any(SeenColumn::is_of_payload);
        let carried = payload::of_file(if in_joints && !in_points { self.joints } else { file });
        self.say(carried.keys);
        for column in file.unused().filter(|column| column.reason.contains("not a time")) {
            self.line(&format!("# {}: {}", column.header, column.reason));
        }
        let unused: Vec<_> = file.unused().map(|column| column.header.clone()).collect();
        if !unused.is_empty() {
            self.line(&format!("# not used: {}", unused.join(", ")));
        }
        for (name, said) in carried.tables {
            self.line("");
            self.line("[[payload]]");
            self.key("name", &quoted(&name), "");
            self.say(said);
        }
        if let Some(column) = file.one(Role::Set) {
            self.line("");
            self.line("[sets]");
            let names: Vec<_> = column.texts().into_iter().map(quoted).collect();
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
        let shared =
            |a: &SeenColumn, b: &SeenColumn| a.texts().iter().filter(|text| b.texts().contains(text)).count();
        let name = |file: &'_ SeenFile| {
            file.columns.iter().position(|c| matches!(c.role, Some(Role::Name | Role::Pose)))
        };
        if let (Some(a), Some(b)) = (name(joints), name(points)) {
            let (a, b) = (&joints.columns[a], &points.columns[b]);
            let common = shared(a, b);
            if common > 1 {
                self.key("by", "\"name\"", &format!("at least {common} names are in both files"));
                self.key("joints", &entry(joints, a), &reason(a));
                self.key("points", &entry(points, b), &reason(b));
                return;
            }
        }
        if joints.rows == points.rows {
            self.key("by", "\"row\"", &format!("both files have {} rows", points.rows));
            return;
        }
        if let (Some((_, a, _)), Some((_, b, _))) = (time_of(joints), time_of(points)) {
            self.key(
                "by",
                "\"time\"",
                &format!("{} rows of joints and {} of points, both with times", joints.rows, points.rows),
            );
            self.key("joints", &a, "");
            self.key("points", &b, "");
            self.undecided("within_s", "0.05", "how far apart the two times of one pose may be");
            return;
        }
        let why =
            format!("{} rows of joints and {} of points, with no column in common", joints.rows, points.rows);
        self.undecided("by", "\"row\"", &why);
    }

    fn form(&mut self) {
        let ambiguous = [self.joints, self.points].into_iter().find_map(|file| {
            let mut times = file.columns.iter().filter(|column| column.role == Some(Role::Time));
            times.find_map(|column| Some((file, column.ambiguous.clone()?)))
        });
        let has_comma = self.points.decimal == Decimal::Comma;
        let glued = self.points.glued.as_ref().or(self.joints.glued.as_ref());
        if !has_comma && ambiguous.is_none() && glued.is_none() {
            return;
        }
        self.line("");
        self.line("[text]");
        if has_comma {
            self.key("decimal", "\",\"", "numbers have a decimal comma");
        }
        if let Some(cell) = glued {
            let same = self.joints.widths == self.points.widths;
            if let Some(widths) = self.points.widths.as_ref().filter(|_| same) {
                let why = format!("{cell} holds several numbers, which end at the same places in every line");
                self.key("widths", &format!("{widths:?}"), &why);
            } else {
                let why = format!(
                    "{cell} looks like numbers with nothing between them: give the number of characters of each column"
                );
                self.undecided("widths", "[8, 12, 12]", &why);
            }
        }
        if let Some((file, cell)) = ambiguous {
            if let Some(why) = &file.dates.why {
                self.line(&format!("# date: {why}"));
            } else {
                let why = format!("{cell} can be day, month, year (dmy) or month, day, year (mdy)");
                self.undecided("date", "\"dmy\"", &why);
            }
        }
    }
}
