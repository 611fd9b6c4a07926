//! Rows of commands from a file of their own, for rows of points.

use std::collections::HashMap;
use std::sync::Arc;

use super::columns::{ColumnMap, ColumnRef, Entry, FilePart, Join, JoinBy};
use super::header::FileColumns;
use super::layout::{Decimal, Table};
use super::rows::{Place, Row, Rows};
use super::times::{Dates, TimeColumns, TimeReader};
use crate::input::InputError;
use calibrig_model::JointKind;

/// The file of the commands.
pub(super) struct Joints {
    name: Arc<str>,
    table: Table,
    by: By,
    row: Row,
}

enum By {
    /// Corresponding rows of both files.
    Row,
    Name {
        rows: Vec<Row>,
        by_name: HashMap<String, usize>,
        used: Vec<bool>,
        key: ColumnRef,
    },
    Time {
        /// By their times, s.
        rows: Vec<(f64, Row)>,
        within: f64,
        key: Entry,
        /// Of the joints, which are read.
        times: TimeReader,
    },
}

/// Where the key is in the rows of the points.
pub(super) enum Key {
    /// Rows of both files are in step.
    Step,
    Name(usize),
    Time(Box<TimeReader>),
}

impl Key {
    /// Remarks on the times of the points.
    pub fn remarks(&self, file: &str) -> Vec<String> {
        match self {
            Self::Time(times) => times.remarks(file),
            _ => Vec::new(),
        }
    }
}

impl Joints {
    /// Finds the columns of the file, and reads it unless its rows correspond to those of the points.
    pub fn open(rows: Box<dyn Rows>, map: &ColumnMap, joints: &[JointKind]) -> Result<Self, InputError> {
        let wanted = map.wanted(joints, FilePart::Joints);
        let table = Table::find(rows, &wanted, map.format().1)?;
        let mut file = Self { name: table.name().into(), table, by: By::Row, row: Row::default() };
        match map.join() {
            None | Some(Join { by: JoinBy::Row, .. } | Join { keys: None, .. }) => {}
            Some(Join { by: JoinBy::Name, keys: Some([own, points]) }) => {
                let (own, key) = (file.find(own)?, column(points));
                file.by = file.by_name(own, key)?;
            }
            Some(Join { by: JoinBy::Time { within, offset }, keys: Some([own, points]) }) => {
                file.by = file.by_time(own, *offset, *within, points.clone())?;
            }
        }
        Ok(file)
    }

    pub fn columns(&self) -> FileColumns<'_> {
        FileColumns {
            name: &self.name,
            head: &self.table.head,
            has_header: self.table.has_header,
            columns: &self.table.columns,
        }
    }

    pub fn decimal(&self) -> Decimal {
        self.table.decimal
    }

    pub fn dates(&self) -> &Dates {
        &self.table.dates
    }

    /// How its rows are found, in words.
    pub fn remarks(&self, points: &str) -> Vec<String> {
        let how = match &self.by {
            By::Row => "row by row".to_owned(),
            By::Name { key, .. } => format!("by name ({})", words(key)),
            By::Time { key, within, .. } => format!("by time ({}, within {within} s)", key.written),
        };
        let mut remarks = self.table.remarks();
        if let By::Time { times, .. } = &self.by {
            remarks.extend(times.remarks(&self.name));
        }
        remarks.push(format!("{points} and {} are joined {how}", self.name));
        remarks
    }

    /// Remark if the times of one file have a zone and those of the other have none.
    pub fn zones_differ(&self, points: &str, key: &Key) -> Option<String> {
        let (By::Time { times, .. }, Key::Time(key)) = (&self.by, key) else { return None };
        let (own, theirs) = (times.kind()?, key.kind()?);
        (own != theirs).then(|| {
            format!(
                "times of {points} are {}, those of {} {}: without a time zone they are taken as UTC (offset_s in [join] \
                 shifts the joints' times)",
                theirs.words(),
                self.name,
                own.words()
            )
        })
    }

    fn find(&self, entry: &Entry) -> Result<usize, InputError> {
        key_in(&self.columns(), &column(entry))
    }

    /// Where the key is in the rows of the points, whose dates are written so.
    pub fn key(&self, points: FileColumns<'_>, dates: &Dates) -> Result<Key, InputError> {
        match &self.by {
            By::Row => Ok(Key::Step),
            By::Name { key, .. } => Ok(Key::Name(key_in(&points, key)?)),
            By::Time { key, .. } => {
                Ok(Key::Time(Box::new(TimeReader::new(times_in(&points, key)?, dates.clone()))))
            }
        }
    }

    fn next(&mut self, row: &mut Row) -> Result<bool, InputError> {
        if !self.table.next_row(row)? {
            return Ok(false);
        }
        super::reader::check_length(&self.name, row, &self.table.columns, self.table.has_header)?;
        row.resize(self.table.columns.len());
        Ok(true)
    }

    fn by_name(&mut self, own: usize, key: ColumnRef) -> Result<By, InputError> {
        let (mut rows, mut by_name, mut row) = (Vec::<Row>::new(), HashMap::new(), Row::default());
        while self.next(&mut row)? {
            let name = row.cell(own).unwrap_or_default().to_owned();
            if name.is_empty() {
                return Err(row.refuse(&self.name, Some(own), "the name is empty", "a name in every row"));
            }
            if let Some(first) = by_name.insert(name.clone(), rows.len()) {
                let message = format!("the name {name} appears twice, first in {}", rows[first].place());
                let expected = "every name only once in the file of the joints; or join the files by row (by = \"row\" in \
                                [join])";
                return Err(row.refuse(&self.name, Some(own), message, expected));
            }
            rows.push(row.clone());
        }
        let used = vec![false; rows.len()];
        Ok(By::Name { rows, by_name, used, key })
    }

    fn by_time(&mut self, own: &Entry, offset: f64, within: f64, key: Entry) -> Result<By, InputError> {
        let (mut rows, mut row) = (Vec::new(), Row::default());
        let mut times = TimeReader::new(times_in(&self.columns(), own)?, self.table.dates.clone());
        while self.next(&mut row)? {
            let time = times.read(&self.name, &row, self.table.decimal)?;
            rows.push((time - offset, row.clone()));
        }
        rows.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        Ok(By::Time { rows, within, key, times })
    }

    /// Adds to a row of points the row of commands that belongs to it; otherwise says why there is none.
    pub fn join(
        &mut self,
        points: &str,
        row: &mut Row,
        key: &mut Key,
        decimal: Decimal,
    ) -> Result<Result<(), String>, InputError> {
        let mut own = std::mem::take(&mut self.row);
        let name = Arc::clone(&self.name);
        let joined = match (&mut self.by, key) {
            (By::Name { rows, by_name, used, .. }, Key::Name(key)) => {
                let wanted = row.cell(*key).unwrap_or_default();
                match by_name.get(wanted) {
                    Some(index) => {
                        used[*index] = true;
                        row.join(&name, &rows[*index]);
                        Ok(())
                    }
                    None => Err(format!("{name} has no row of joints named {wanted:?}")),
                }
            }
            (By::Time { rows, within, times, .. }, Key::Time(key)) => {
                let time = key.read(points, row, decimal)?;
                if let (Some(own), Some(theirs)) = (times.kind(), key.kind())
                    && !theirs.is_comparable_with(own)
                {
                    let message =
                        format!("the time is {}, but in {name} it is {}", theirs.words(), own.words());
                    let expected = "times of one kind in both files: export them alike, or join by name or by row ([join])";
                    return Err(row.refuse(points, Some(key.first()), message, expected));
                }
                match nearest(rows, time) {
                    Some((apart, found)) if apart <= *within => {
                        row.join(&name, found);
                        Ok(())
                    }
                    Some((apart, _)) => Err(format!(
                        "{name} has no joints within {within} s: the nearest are {apart:.3} s away"
                    )),
                    None => Err(format!("{name} has no joints")),
                }
            }
            _ => {
                if !self.next(&mut own)? {
                    let message = format!("{name} has fewer rows than {points}, and none for this one");
                    let expected = "as many rows in both files; or join the files by name or time ([join] in the column map)";
                    return Err(row.refuse(points, None, message, expected));
                }
                row.join(&name, &own);
                Ok(())
            }
        };
        self.row = own;
        Ok(joined)
    }

    /// Checks what is left when the points have ended.
    pub fn finish(&mut self, points: &str) -> Result<Option<String>, InputError> {
        let mut row = Row::default();
        if matches!(self.by, By::Row) && self.next(&mut row)? {
            let message = format!("{points} has fewer rows than {}, and none for this one", self.name);
            let expected =
                "as many rows in both files; or join the files by name or time ([join] in the column map)";
            return Err(row.refuse(&self.name, None, message, expected));
        }
        let By::Name { used, .. } = &self.by else { return Ok(None) };
        let unused = used.iter().filter(|used| !**used).count();
        Ok((unused > 0).then(|| {
            format!("{}: {unused} of {} rows match no point by name in {points}", self.name, used.len())
        }))
    }
}

fn column(entry: &Entry) -> ColumnRef {
    match entry.terms.as_slice() {
        [term] if term.sign > 0.0 => term.column.clone(),
        _ => ColumnRef::Name(entry.written.clone()),
    }
}

/// The column by which files are joined.
fn key_in(file: &FileColumns<'_>, key: &ColumnRef) -> Result<usize, InputError> {
    file.find(key)?.ok_or_else(|| {
        let expected =
            format!("a column {}, which the files are joined by; found {}", words(key), file.names());
        file.refuse(format!("column {} is missing", words(key)), &expected)
    })
}

/// The columns of the times by which files are joined.
fn times_in(file: &FileColumns<'_>, key: &Entry) -> Result<TimeColumns, InputError> {
    TimeColumns::of(key, None, file, &|column| key_in(file, column), &|index| &file.columns[index])
}

fn words(column: &ColumnRef) -> String {
    match column {
        ColumnRef::Name(name) => name.clone(),
        ColumnRef::Number(number) => number.to_string(),
    }
}

/// The row whose time is nearest, and its difference.
fn nearest(rows: &[(f64, Row)], time: f64) -> Option<(f64, &Row)> {
    let after = rows.partition_point(|(at, _)| *at < time);
    let near = rows.iter().skip(after.saturating_sub(1)).take(2);
    near.map(|(at, row)| ((at - time).abs(), row)).min_by(|(a, _), (b, _)| a.total_cmp(b))
}

/// Where a row of an unmatched point is, with the reason.
pub(super) fn unmatched(place: &Place, file: &str, why: &str) -> String {
    format!("{}: {why}", place.of(file))
}
