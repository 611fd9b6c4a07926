//! Reading one file of measurements, or several that belong together.

use std::cell::Cell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::columns::{ColumnMap, FilePart, JoinBy, RowOptions};
use super::faces::{self, Faces};
use super::header::{FileColumns, Head};
use super::join::{Joints, Key, unmatched};
use super::layout::Table;
use super::open::open;
use super::pose_list::PoseList;
use super::reader::{Names, RowReader, check_length};
use super::rows::{Row, Rows};
use super::text::TextRows;
use super::times::TimeReader;
use super::{CsvError, LoadedMeasurements, repeats};
use crate::input::{InputError, Source};
use calibrig_model::JointKind;
use calibrig_model::measurement::{Motion, Observation};

/// Files of one set.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeasurementFiles {
    /// Files with positions: one, or one per target.
    pub points: Vec<PointsFile>,
    /// The file of the commands, if separate; its rows are joined as the column map states, else row by row.
    pub joints: Option<PathBuf>,
}

/// A file with positions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PointsFile {
    /// Its target, if the whole file is of one.
    pub target: Option<String>,
    /// Where it is.
    pub path: PathBuf,
}

impl MeasurementFiles {
    /// One file that holds all.
    pub fn one(path: impl Into<PathBuf>) -> Self {
        Self { points: vec![PointsFile { target: None, path: path.into() }], joints: None }
    }
}

/// Reads a measurement file. `joints` are the kinds of the robot's joints, in order.
///
/// - The delimiter (`,`, `;`, tab, `|` or blanks) is the one under which most columns of `map` are found; lines that begin with `#` or
///   `//`, blank lines, and lines in front of the header are skipped.
///
/// A row whose position is (0, 0, 0), or empty, is a missed shot: it is left out and reported in [`LoadedMeasurements::dropped`].
/// - Without a pose column the rows count from 1; without a time column the time is 0; without station or target columns there is
///   one of each. Stations and targets are numbered in the order of their first appearance.
///
/// The file is read line by line: apart from the set, memory does not grow with it.
pub fn read_measurements(
    path: &Path,
    map: &ColumnMap,
    joints: &[JointKind],
) -> Result<LoadedMeasurements, CsvError> {
    Ok(read_files(&MeasurementFiles::one(path), map, joints, &RowOptions::default())?)
}

/// [`read_measurements`] from a text in memory.
pub fn parse_measurements(
    source: &Source,
    map: &ColumnMap,
    joints: &[JointKind],
) -> Result<LoadedMeasurements, InputError> {
    let wanted = map.wanted(joints, FilePart::Whole);
    let rows = Box::new(TextRows::of_text(&source.name, &source.text, &map.format().0, &wanted)?);
    read_rows(rows, map, joints)
}

/// [`read_measurements`] from rows of any kind of file.
pub fn read_rows(
    rows: Box<dyn Rows>,
    map: &ColumnMap,
    joints: &[JointKind],
) -> Result<LoadedMeasurements, InputError> {
    let mut reading = Reading::new(map, joints, &RowOptions::default());
    reading.add(rows, None, None)?;
    reading.finish()
}

/// Reads the files of one set: those with points one after the other, each joined with the file of the commands if there is one.
///
/// # Errors
/// As [`read_measurements`]; also rows of two files that do not match.
pub fn read_files(
    files: &MeasurementFiles,
    map: &ColumnMap,
    joints: &[JointKind],
    options: &RowOptions,
) -> Result<LoadedMeasurements, InputError> {
    refuse_twice(files)?;
    let format = map.format().0;
    let mut reading = Reading::new(map, joints, options);
    for file in &files.points {
        let part = if files.joints.is_some() { FilePart::Points } else { FilePart::Whole };
        let rows = open(&file.path, &format, &map.wanted(joints, part), options)?;
        let commands = match &files.joints {
            Some(path) => {
                let rows = open(path, &format, &map.wanted(joints, FilePart::Joints), options)?;
                Some(Joints::open(rows, map, joints)?)
            }
            None => None,
        };
        reading.add(rows, commands, file.target.as_deref())?;
    }
    reading.finish()
}

/// Refuses a file of points that is named twice, whose rows would count twice.
fn refuse_twice(files: &MeasurementFiles) -> Result<(), InputError> {
    let mut seen: Vec<PathBuf> = Vec::new();
    for PointsFile { path, .. } in &files.points {
        // A missing file is reported when it is opened.
        let Ok(known) = path.canonicalize() else { continue };
        if seen.contains(&known) {
            return Err(InputError::Place {
                place: path.display().to_string(),
                message: "this file is named twice: its rows would count twice".to_owned(),
                help: Some("expected every file of measurements only once".to_owned()),
            });
        }
        seen.push(known);
    }
    Ok(())
}

/// Remark on rows of one stop, if no column states it.
fn stops(observations: &[Observation], file: &str) -> Option<String> {
    let poses = observations.chunk_by(|a, b| a.pose == b.pose).count();
    (poses < observations.len()).then(|| {
        format!(
            "{file}: consecutive rows with the same command are one pose: {poses} poses from {} rows",
            observations.len()
        )
    })
}

/// Files that are being read into one set.
struct Reading<'a> {
    map: &'a ColumnMap,
    joints: &'a [JointKind],
    options: RowOptions,
    names: Names,
    loaded: LoadedMeasurements,
    /// The first file with positions.
    first: Option<String>,
    /// Poses that are listed as held out.
    held_out: PoseList,
    /// Number of the last pose of the files before.
    last_pose: u32,
    /// Whether a file has a column of poses.
    numbers_poses: bool,
}

impl<'a> Reading<'a> {
    fn new(map: &'a ColumnMap, joints: &'a [JointKind], options: &RowOptions) -> Self {
        let mut options = options.clone();
        if let Some(rows) = map.row_choices() {
            options.missed.extend(rows.missed.iter().cloned());
            options.approach_from_order |= rows.approach_from_order;
            options.average_repeats |= rows.average_repeats;
            options.average_faces |= rows.average_faces;
        }
        Self {
            map,
            joints,
            held_out: options.verification_poses.clone(),
            options,
            names: Names::default(),
            loaded: LoadedMeasurements::default(),
            first: None,
            last_pose: 0,
            numbers_poses: false,
        }
    }

    fn add(
        &mut self,
        rows: Box<dyn Rows>,
        mut commands: Option<Joints>,
        target: Option<&str>,
    ) -> Result<(), InputError> {
        let part = if commands.is_some() { FilePart::Points } else { FilePart::Whole };
        let wanted = self.map.wanted(self.joints, part);
        let mut table = Table::find(rows, &wanted, self.map.format().1)?;
        let file = table.name().to_owned();
        self.first.get_or_insert_with(|| file.clone());
        let (head_row, points) = (table.head.clone(), table.columns.clone());
        let of_points =
            FileColumns { name: &file, head: &head_row, has_header: table.has_header, columns: &points };
        let before = self.loaded.set.observations.len();
        let columns;
        let names;
        let mut remarks;
        {
            let mut head = Head::new(of_points, commands.as_ref().map(Joints::columns), self.map.source());
            names = head.all();
            let header: Vec<&str> =
                names.iter().flat_map(|column| [column.header.as_str(), column.name()]).collect();
            let mapping = self.map.resolve(&header, self.joints);
            let mapping = mapping.map_err(|message| of_points.refuse(message, "calibrig's own columns"))?;
            columns = head.columns(&mapping, self.joints)?;
            remarks = head.remarks;
        }
        if let (Some(target), Some(column)) = (target, columns.target) {
            let message = format!(
                "column {} names the target, but the whole file is said to be of {target}",
                names[column].header
            );
            return Err(of_points.refuse(message, "only one of them"));
        }
        self.held_out.extend(&columns.sets.poses);
        self.loaded.names_stations |= columns.station.is_some();
        self.loaded.names_targets |= columns.target.is_some() || target.is_some();
        let mut key =
            commands.as_ref().map_or(Ok(Key::Step), |joints| joints.key(of_points, &table.dates))?;
        let mut reader = RowReader {
            columns: &columns,
            options: &self.options,
            file: &file,
            names: &names,
            joints_from: points.len(),
            decimals: [table.decimal, commands.as_ref().map_or(table.decimal, Joints::decimal)],
            target,
            time: columns.time.clone().map(|time| {
                let of_joints = commands.as_ref().filter(|_| time.first() >= points.len());
                TimeReader::new(time, of_joints.map_or(&table.dates, Joints::dates).clone())
            }),
            motion: Motion::default(),
            faces: Faces::default(),
            rounded: Cell::new(0.0),
            rows: 0,
        };
        let mut row = Row::default();
        while table.next_row(&mut row)? {
            if row.len() < points.len() && table.breaks_off() {
                reader.rows = reader.rows.saturating_add(1);
                let why = format!(
                    "the file breaks off in this line, which has {} of {} columns ({})",
                    row.len(),
                    points.len(),
                    row.place().of(&file)
                );
                self.loaded.drop_row(reader.rows, why, false);
                continue;
            }
            check_length(&file, &row, &points, table.has_header)?;
            row.resize(points.len());
            reader.rows = reader.rows.saturating_add(1);
            if let Some(commands) = &mut commands
                && let Err(why) = commands.join(&file, &mut row, &mut key, table.decimal)?
            {
                self.loaded.drop_row(reader.rows, unmatched(row.place(), &file, &why), false);
                continue;
            }
            reader.observe(&row, &mut self.names, &mut self.loaded)?;
        }
        if reader.rows == 0 {
            let expected = "one row of numbers per measurement";
            return Err(of_points.refuse("there are no measurements below the header", expected));
        }
        remarks.extend(reader.time.iter().flat_map(|time| time.remarks(&file)));
        remarks.extend(reader.remarks());
        if let Some(commands) = &mut commands {
            remarks.extend(key.remarks(&file));
            remarks.extend(commands.remarks(&file));
            remarks.extend(commands.zones_differ(&file, &key));
            remarks.extend(commands.finish(&file)?);
        }
        remarks.extend(table.remarks());
        let numbers_poses = columns.pose.is_some();
        self.numbers_poses |= numbers_poses;
        if !numbers_poses {
            remarks.extend(stops(&self.loaded.set.observations[before..], &file));
        }
        self.number_on(before, numbers_poses, &file, &mut remarks);
        for remark in remarks {
            if !self.loaded.remarks.contains(&remark) {
                self.loaded.remarks.push(remark);
            }
        }
        Ok(())
    }

    /// Poses of a further file that repeat numbers of other poses are numbered after those.
    fn number_on(&mut self, before: usize, numbers_poses: bool, file: &str, remarks: &mut Vec<String>) {
        let (known, new) = self.loaded.set.observations.split_at_mut(before);
        let commands: HashMap<u32, &[f64]> = if new.is_empty() {
            HashMap::new()
        } else {
            known.iter().map(|o| (o.pose, &*o.command)).collect()
        };
        let is_other = |command: &[f64], known: &[f64]| {
            command.iter().zip(known).any(|(a, b)| (a - b).abs() > repeats::SAME_COMMAND)
        };
        let others =
            new.iter().any(|o| commands.get(&o.pose).is_some_and(|known| is_other(&o.command, known)));
        if others && self.names.poses.is_empty() {
            let by = self.last_pose;
            for observation in new {
                observation.pose = observation.pose.saturating_add(by);
            }
            let whose = if numbers_poses { "its poses" } else { "its rows" };
            remarks.push(format!(
                "{file}: {whose} repeat numbers of earlier poses with other commands: they are numbered from {} on",
                by.saturating_add(1)
            ));
        }
        self.last_pose = self.loaded.set.observations.iter().map(|o| o.pose).max().unwrap_or(0);
    }

    /// Why none of the files' rows can be used.
    fn nothing_left(&self) -> Option<InputError> {
        let dropped = &self.loaded.dropped;
        let by = self.map.join()?.by;
        if !self.loaded.set.observations.is_empty() || dropped.is_empty() {
            return None;
        }
        // Most are left out for the same reason.
        let (first, rest) = (&dropped[0].1, dropped.len() - 1);
        let others = if rest > 0 { format!("; and {rest} more rows") } else { String::new() };
        let help = match by {
            JoinBy::Time { .. } => {
                "expected times of one clock: in [join] of the column map, offset_s shifts the times of the joints and \
                 within_s widens the tolerance"
            }
            JoinBy::Name => "expected the same names in both files, spelled alike",
            JoinBy::Row => "expected rows with a position",
        };
        Some(InputError::Place {
            place: self.first.clone().unwrap_or_default(),
            message: format!("none of its rows can be used: {first}{others}"),
            help: Some(help.to_owned()),
        })
    }

    fn finish(mut self) -> Result<LoadedMeasurements, InputError> {
        if let Some(refused) = self.nothing_left() {
            return Err(refused);
        }
        let poses = self.names.poses;
        if let (Some(first), Some(last)) = (poses.first(), poses.last()) {
            self.loaded.remarks.push(format!(
                "poses have names: they are numbered in the order of their first rows, {first} is 1, {last} is {}",
                poses.len()
            ));
        }
        let dropped = self.loaded.dropped.iter().map(|(pose, _)| *pose);
        let numbers = self.loaded.set.observations.iter().map(|o| o.pose).chain(dropped);
        let absent = self.held_out.absent(numbers, &poses);
        if !absent.is_empty() {
            self.loaded
                .remarks
                .push(format!("poses listed as held out that no row has: {}", absent.join(", ")));
        }
        self.loaded.pose_names = poses;
        faces::pair(&mut self.loaded, self.numbers_poses, self.options.average_faces)?;
        if self.options.average_repeats {
            repeats::average(&mut self.loaded, self.numbers_poses)?;
        }
        if self.options.approach_from_order {
            let whose = match self.map.join().map(|join| join.by) {
                Some(JoinBy::Name) => " of the positions, not of those of the joints",
                _ => "",
            };
            self.loaded.remarks.push(format!("signs of approach follow from the order of the rows{whose}"));
        }
        Ok(self.loaded)
    }
}
