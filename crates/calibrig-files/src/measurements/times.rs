//! Times of rows: in one column, or a date in one and the time of day in another.

mod stamp;
#[cfg(test)]
mod tests;

pub(super) use self::stamp::DateOrder;
use self::stamp::{Kind, Unread, parse};
use super::columns::{ColumnRef, Entry};
use super::header::FileColumns;
use super::layout::{Column, Decimal};
use super::rows::{Place, Row};
use super::units::{HeaderUnit, TimeUnit, unit_of_name};
use crate::input::InputError;

const EXPECTED: &str = "seconds, a time such as 12:03:44.12 or 1:03:44 PM, or a date and a time such as 2026-05-04T12:03:44 or 04.05.2026 12:03:44";

/// s
const DAY: f64 = 86_400.0;

/// The order of dates in a table, and what shows it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Dates {
    pub order: Option<DateOrder>,
    /// In words, where it is not stated.
    pub why: Option<String>,
}

impl Dates {
    pub fn stated(order: DateOrder) -> Self {
        Self { order: Some(order), why: None }
    }

    /// Looks through cells for a date that is possible in only one order; without one, AM and PM suggest the month first.
    pub fn seen<'r>(cells: impl Iterator<Item = (&'r Place, &'r str)>) -> Self {
        let mut american: Option<(&Place, &str)> = None;
        for (place, cell) in cells.filter(|(_, cell)| cell.len() >= 6 && cell.contains(['/', '-'])) {
            let reads = |order| parse(cell, Decimal::Point, TimeUnit::S, Some(order)).is_ok();
            if parse(cell, Decimal::Point, TimeUnit::S, None) == Err(Unread::Ambiguous) {
                let marks = cell.to_ascii_lowercase();
                if american.is_none() && (marks.ends_with('m') || marks.ends_with("m.")) {
                    american = Some((place, cell));
                }
                continue;
            }
            let (order, words) = match (reads(DateOrder::Dmy), reads(DateOrder::Mdy)) {
                (true, false) => (DateOrder::Dmy, "day, month, year"),
                (false, true) => (DateOrder::Mdy, "month, day, year"),
                _ => continue,
            };
            return Self {
                order: Some(order),
                why: Some(format!("dates are {words}, as {cell} ({place}) shows")),
            };
        }
        let Some((place, cell)) = american else { return Self::default() };
        let why = format!(
            "dates such as {cell} ({place}) are read as month, day, year, since the time has AM or PM; date = \"dmy\" in [text] of the \
             column map reads day, month, year"
        );
        Self { order: Some(DateOrder::Mdy), why: Some(why) }
    }
}

/// A column of times.
#[derive(Debug, Clone, PartialEq)]
struct TimeColumn {
    column: usize,
    header: String,
    unit: TimeUnit,
}

/// Columns whose sum is a time.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TimeColumns {
    columns: Vec<TimeColumn>,
    /// What is taken from the header, in words.
    pub remarks: Vec<String>,
}

impl TimeColumns {
    /// The columns of an entry, found by `find`. `stated` is the unit of numbers, and the key of the map that states it.
    pub fn of<'c>(
        entry: &Entry,
        stated: Option<(TimeUnit, &str)>,
        file: &FileColumns<'_>,
        find: &dyn Fn(&ColumnRef) -> Result<usize, InputError>,
        column_at: &dyn Fn(usize) -> &'c Column,
    ) -> Result<Self, InputError> {
        let whole = ColumnRef::Name(entry.written.clone());
        let as_one = entry.terms.len() > 1 || entry.terms.iter().any(|term| term.sign < 0.0);
        let found = if as_one { find(&whole).ok() } else { None };
        let indices = match found {
            Some(column) => vec![(column, false)],
            None if entry.terms.iter().any(|term| term.sign < 0.0) => vec![(find(&whole)?, false)],
            None => {
                let of = |term: &super::columns::Term| {
                    Ok((find(&term.column)?, matches!(term.column, ColumnRef::Number(_))))
                };
                entry.terms.iter().map(of).collect::<Result<Vec<_>, InputError>>()?
            }
        };
        let are_several = indices.len() > 1;
        let (mut columns, mut remarks) = (Vec::new(), Vec::new());
        for (index, by_number) in indices {
            let column = column_at(index);
            let header = column.header.clone();
            let own = match column.unit.or_else(|| unit_of_name(&header)) {
                Some(HeaderUnit::Time(unit)) => Some(unit),
                _ => TimeUnit::at_the_end_of(&header),
            };
            let unit = match (stated, own) {
                (Some((unit, _)), Some(own)) if unit != own && !by_number && !are_several => {
                    let (own, unit) = (own.key(), unit.key());
                    let key = stated.map_or("", |(_, key)| key);
                    let message = format!(
                        "column {header} is in {own} according to the header, but in {unit} according to the column map ({key})"
                    );
                    let expected = format!(
                        "time_{own} in place of {key}; if the header is wrong, name the column by its number: {key} = {}",
                        index + 1
                    );
                    return Err(file.refuse(message, &expected));
                }
                (Some((unit, _)), _) if by_number || !are_several => unit,
                (stated, own) => {
                    if let Some(own) = own.filter(|own| *own != TimeUnit::S) {
                        remarks.push(format!("{}: {header} in {}, as its name says", file.name, own.key()));
                    }
                    own.unwrap_or(stated.map_or(TimeUnit::S, |(unit, _)| unit))
                }
            };
            columns.push(TimeColumn { column: index, header, unit });
        }
        Ok(Self { columns, remarks })
    }

    pub fn first(&self) -> usize {
        self.columns.first().map_or(0, |column| column.column)
    }
}

/// Reads the times of one file's rows, which are all of one kind.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TimeReader {
    columns: TimeColumns,
    dates: Dates,
    kind: Option<Kind>,
    last: f64,
    /// How many rows have an earlier time than the row before, and the first of them.
    backwards: Option<(u64, Place)>,
    used_order: bool,
}

impl TimeReader {
    pub fn new(columns: TimeColumns, dates: Dates) -> Self {
        Self { columns, dates, kind: None, last: f64::NEG_INFINITY, backwards: None, used_order: false }
    }

    /// The first of its columns.
    pub fn first(&self) -> usize {
        self.columns.first()
    }

    /// What all of its times are; `None` before the first.
    pub fn kind(&self) -> Option<Kind> {
        self.kind
    }

    /// The time of a row, s.
    pub fn read(&mut self, file: &str, row: &Row, decimal: Decimal) -> Result<f64, InputError> {
        // Minus zero leaves the sign of a zero as it is when added to.
        let (mut seconds, mut kind) = (-0.0, None);
        for TimeColumn { column, header, unit } in &self.columns.columns {
            let cell = row.cell(*column).unwrap_or_default();
            let refuse = |what: &str, expected: &str| {
                let message = if cell.is_empty() {
                    format!("column {header} is empty")
                } else {
                    format!("column {header} is {cell:?}{what}")
                };
                row.refuse(file, Some(*column), message, expected)
            };
            let stamp = parse(cell, decimal, *unit, self.dates.order).map_err(|why| match why {
                Unread::NoTime => refuse("", EXPECTED),
                Unread::Ambiguous => refuse(
                    ": day and month cannot be told apart",
                    "date = \"dmy\" (day, month, year), \"mdy\" or \"ymd\" in [text] of the column map",
                ),
            })?;
            self.used_order |= self.dates.why.is_some() && cell.contains(['/', '-']);
            // A spreadsheet's date is one at midnight.
            let is_day = seconds % DAY == 0.0;
            seconds += stamp.seconds;
            kind = Some(match (kind, stamp.kind) {
                (None, kind) | (Some(kind), Kind::Number) if kind != Kind::Day || stamp.kind == Kind::Day => {
                    kind
                }
                (Some(Kind::Day), Kind::Clock) | (Some(Kind::Clock), Kind::Day) => Kind::Moment,
                (Some(Kind::Moment), Kind::Clock) if is_day => Kind::Moment,
                (Some(Kind::Clock), Kind::Moment) if stamp.seconds % DAY == 0.0 => Kind::Moment,
                (Some(Kind::Number), kind) if kind != Kind::Day => kind,
                (before, _) => {
                    let before = before.map_or("", Kind::words);
                    let what =
                        format!(", {}, after {before}: together they are not a time", stamp.kind.words());
                    return Err(refuse(&what, "a date and a time of the day, or numbers of seconds"));
                }
            });
        }
        let kind = kind.unwrap_or(Kind::Number);
        let refuse =
            |message: String, expected: &str| row.refuse(file, Some(self.columns.first()), message, expected);
        let cell = || row.cell(self.columns.first()).unwrap_or_default();
        if kind == Kind::Day {
            let expected = "a date and a time; where the time of the day is in another column, both: [\"Date\", \"Time\"]";
            return Err(refuse(format!("the time is {:?}, {}", cell(), kind.words()), expected));
        }
        match self.kind {
            Some(known) if known != kind => {
                let message = format!(
                    "the time is {:?}, {}, but in the rows before {}",
                    cell(),
                    kind.words(),
                    known.words()
                );
                return Err(refuse(message, "times of one kind in all rows"));
            }
            _ => self.kind = Some(kind),
        }
        if seconds < self.last {
            self.backwards.get_or_insert_with(|| (0, row.place().clone())).0 += 1;
        }
        self.last = seconds;
        Ok(seconds)
    }

    /// Remarks on the times that were read.
    pub fn remarks(&self, file: &str) -> Vec<String> {
        let mut remarks = self.columns.remarks.clone();
        remarks.extend(self.dates.why.iter().filter(|_| self.used_order).map(|why| format!("{file}: {why}")));
        if let Some((count, place)) = &self.backwards {
            let rows = if *count == 1 { "1 row is".to_owned() } else { format!("{count} rows are") };
            let midnight = if self.kind == Some(Kind::Clock) {
                "; times of day without dates start again at midnight"
            } else {
                ""
            };
            remarks.push(format!(
                "{}: the time runs backwards: {rows} earlier than the row before{midnight}",
                place.of(file)
            ));
        }
        remarks
    }
}

/// What a cell looks like, in whatever order its date may be.
pub(super) enum Look {
    /// Not a time, or a number.
    Nothing,
    Day,
    Clock,
    /// Both.
    Moment,
    /// Day and month can be exchanged.
    Ambiguous {
        is_day: bool,
    },
}

pub(super) fn look_at(cell: &str, decimal: Decimal) -> Look {
    match parse(cell, decimal, TimeUnit::S, None) {
        Ok(stamp) if stamp.kind == Kind::Number => Look::Nothing,
        Ok(stamp) if stamp.kind == Kind::Day => Look::Day,
        Ok(stamp) if stamp.kind == Kind::Moment && stamp.seconds % DAY == 0.0 => Look::Day,
        Ok(stamp) if stamp.kind == Kind::Clock => Look::Clock,
        Ok(_) => Look::Moment,
        Err(Unread::Ambiguous) => Look::Ambiguous { is_day: !cell.contains(':') },
        Err(Unread::NoTime) => Look::Nothing,
    }
}
