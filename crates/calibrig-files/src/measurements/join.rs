//! Rows of commands from a file of their own, for rows of points.

use std::collections::HashMap;
use std::sync::Arc;

use super::columns::{ColumnMap, ColumnRef, Entry, Join, JoinBy, Part};
use super::header::FileColumns;
use super::layout::{Decimal, Table};
use super::rows::{Place, Row, Rows};
use super::times;
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
    /// Rows of both files in step.
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
        key: ColumnRef,
    },
}

impl Joints {
    /// Finds the columns of the file, and reads it where its rows are not in step with those of the points.
    pub fn open(rows: Box<dyn Rows>, map: &ColumnMap, joints: &[JointKind]) -> Result<Self, InputError> {
        let wanted = map.wanted(joints, Part::Joints);
        let table = Table::find(rows, &wanted, map.format().1)?;
        let mut file = Self { name: table.name().into(), table, by: By::Row, row: Row::default() };
        match map.join() {
            None | Some(Join { by: JoinBy::Row, .. } | Join { keys: None, .. }) => {}
            Some(Join { by: JoinBy::Name, keys: Some([own, points]) }) => {
                let (own, key) = (file.find(own)?, column(points));
                file.by = file.by_name(own, key)?;
            }
            Some(Join { by: JoinBy::Time { within, offset }, keys: Some([own, points]) }) => {
                let (own, key) = (file.find(own)?, column(points));
                file.by = file.by_time(own, *offset, *within, key)?;
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

    /// How its rows are found, in words.
    pub fn remarks(&self, points: &str) -> Vec<String> {
        let how = match &self.by {
            By::Row => "row by row".to_owned(),
            By::Name { key, .. } => format!("by name ({})", words(key)),
            By::Time { key, within, .. } => format!("by time ({}, within {within} s)", words(key)),
        };
        let mut remarks = self.table.remarks();
        remarks.push(format!("{points} and {} are joined {how}", self.name));
        remarks
    }

    fn find(&self, entry: &Entry) -> Result<usize, InputError> {
        let wanted = column(entry);
        let missing = || {
            let names: Vec<_> = self.table.columns.iter().map(|column| column.header.as_str()).collect();
            let expected = format!(
                "a column {}, by which the files are joined; found {}",
                words(&wanted),
                names.join(", ")
            );
            self.columns().refuse(format!("column {} is missing", words(&wanted)), &expected)
        };
        self.columns().find(&wanted)?.ok_or_else(missing)
    }

    /// Where the key is in the rows of the points; `None` of rows in step.
    pub fn key(&self, points: FileColumns<'_>) -> Result<Option<usize>, InputError> {
        let key = match &self.by {
            By::Row => return Ok(None),
            By::Name { key, .. } | By::Time { key, .. } => key,
        };
        let missing = || {
            let names: Vec<_> = points.columns.iter().map(|column| column.header.as_str()).collect();
            let expected =
                format!("a column {}, by which the files are joined; found {}", words(key), names.join(", "));
            points.refuse(format!("column {} is missing", words(key)), &expected)
        };
        points.find(key)?.ok_or_else(missing).map(Some)
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
                let message = format!("the name {name} is there twice, first in {}", rows[first].place());
                let expected = "every name once in the file of the joints; or the files joined by row (by = \"row\" in [join])";
                return Err(row.refuse(&self.name, Some(own), message, expected));
            }
            rows.push(row.clone());
        }
        let used = vec![false; rows.len()];
        Ok(By::Name { rows, by_name, used, key })
    }

    fn by_time(&mut self, own: usize, offset: f64, within: f64, key: ColumnRef) -> Result<By, InputError> {
        let (mut rows, mut row) = (Vec::new(), Row::default());
        while self.next(&mut row)? {
            let time = times::of_cell(&self.name, &row, own, self.table.decimal)?;
            rows.push((time - offset, row.clone()));
        }
        rows.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        Ok(By::Time { rows, within, key })
    }

    /// Adds to a row of points the row of commands that belongs to it; otherwise says why no row does.
    pub fn join(
        &mut self,
        points: &str,
        row: &mut Row,
        key: Option<usize>,
        decimal: Decimal,
    ) -> Result<Result<(), String>, InputError> {
        let mut own = std::mem::take(&mut self.row);
        let name = Arc::clone(&self.name);
        let joined = match (&mut self.by, key) {
            (By::Name { rows, by_name, used, .. }, Some(key)) => {
                let wanted = row.cell(key).unwrap_or_default();
                match by_name.get(wanted) {
                    Some(index) => {
                        used[*index] = true;
                        row.join(&name, &rows[*index]);
                        Ok(())
                    }
                    None => Err(format!("{name} has no joints of the name {wanted:?}")),
                }
            }
            (By::Time { rows, within, .. }, Some(key)) => {
                let time = times::of_cell(points, row, key, decimal)?;
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
                    let message =
                        format!("{name} has no row for it: its rows are fewer than those of {points}");
                    let expected = "as many rows in both files; or the files joined by a name or a time ([join] in the column map)";
                    return Err(row.refuse(points, None, message, expected));
                }
                row.join(&name, &own);
                Ok(())
            }
        };
        self.row = own;
        Ok(joined)
    }

    /// Looks at what is left when the points have ended.
    pub fn finish(&mut self, points: &str) -> Result<Option<String>, InputError> {
        let mut row = Row::default();
        if matches!(self.by, By::Row) && self.next(&mut row)? {
            let message =
                format!("{points} has no row for it: its rows are fewer than those of {}", self.name);
            let expected = "as many rows in both files; or the files joined by a name or a time ([join] in the column map)";
            return Err(row.refuse(&self.name, None, message, expected));
        }
        let By::Name { used, .. } = &self.by else { return Ok(None) };
        let unused = used.iter().filter(|used| !**used).count();
        Ok((unused > 0).then(|| {
            format!("{}: {unused} of {} rows have no point of their name in {points}", self.name, used.len())
        }))
    }
}

fn column(entry: &Entry) -> ColumnRef {
    match entry.terms.as_slice() {
        [term] if term.sign > 0.0 => term.column.clone(),
        _ => ColumnRef::Name(entry.written.clone()),
    }
}

fn words(column: &ColumnRef) -> String {
    match column {
        ColumnRef::Name(name) => name.clone(),
        ColumnRef::Number(number) => number.to_string(),
    }
}

/// The row whose time is nearest, and how far it is away.
fn nearest(rows: &[(f64, Row)], time: f64) -> Option<(f64, &Row)> {
    let after = rows.partition_point(|(at, _)| *at < time);
    let near = rows.iter().skip(after.saturating_sub(1)).take(2);
    near.map(|(at, row)| ((at - time).abs(), row)).min_by(|(a, _), (b, _)| a.total_cmp(b))
}

/// Where a row of an unmatched point is, with the reason.
pub(super) fn unmatched(place: &Place, file: &str, why: &str) -> String {
    format!("{}: {why}", place.of(file))
}
