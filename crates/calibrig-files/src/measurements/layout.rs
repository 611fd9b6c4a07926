//! Where in a table of rows the header is, where the measurements begin, and how its numbers are written.

use std::collections::{HashMap, VecDeque};
use std::ops::Range;

use super::rows::{Row, Rows};
use super::times::{DateOrder, Dates};
use super::units::{HeaderUnit, name_and_unit, unit_alone};
use crate::input::{Excerpt, InputError};

/// Rows that are looked at before the first measurement is given.
const AHEAD: usize = 200;

/// What is looked for in a table.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Wanted {
    /// Names of columns, whatever of them there is.
    pub names: Vec<String>,
    /// Columns by number, from 0, that hold numbers.
    pub numbers: Vec<usize>,
}

impl Wanted {
    /// How many of the names are cells of this row.
    pub fn hits(&self, row: &Row) -> usize {
        let is_there = |name: &&String| {
            row.cells().any(|cell| cell == name.as_str() || name_and_unit(cell).0 == name.as_str())
        };
        self.names.iter().filter(is_there).count()
    }

    /// How many of the columns wanted by number hold one; of all columns where none is wanted so.
    pub fn numbers_in(&self, row: &Row, decimal_comma: bool) -> usize {
        let is_number = |text: &&str| {
            Decimal::Point.parse(text).is_some() || (decimal_comma && Decimal::Comma.parse(text).is_some())
        };
        if self.numbers.is_empty() {
            return row.cells().filter(is_number).count();
        }
        self.numbers.iter().filter_map(|column| row.cell(*column)).filter(is_number).count()
    }

    /// Whether the row can be a measurement, possibly a missed shot.
    fn is_measurement(&self, row: &Row) -> bool {
        let numbers = self.numbers_in(row, true);
        numbers > 0 && 2 * numbers >= self.numbers.len()
    }
}

/// The decimal separator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Decimal {
    #[default]
    Point,
    Comma,
}

/// Longest text that is tried as a number.
const LONGEST_NUMBER: usize = 64;

impl Decimal {
    /// The number that a text is, which may be infinite or NaN.
    pub fn parse(self, text: &str) -> Option<f64> {
        if self == Self::Point
            && let Ok(number) = text.parse()
        {
            return Some(number);
        }
        if text.len() > LONGEST_NUMBER || (self == Self::Comma && text.contains('.')) {
            return None;
        }
        // As other programs write: decimal commas, exponents with a D, and the typographic minus.
        let number: String = text
            .chars()
            .map(|c| match c {
                ',' if self == Self::Comma => '.',
                'D' | 'd' => 'e',
                '\u{2212}' => '-',
                c => c,
            })
            .collect();
        number.parse().ok()
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Point => "a number, with a decimal point",
            Self::Comma => "a number with a decimal comma, as the others of this file",
        }
    }

    /// The same for a text with separators of thousands.
    pub fn words_for(self, text: &str) -> String {
        let is_separator = |c: char| matches!(c, ',' | '.' | '\'' | '\u{2019}' | ' ' | '\u{a0}' | '\u{202f}');
        let without: String = text.chars().filter(|c| !is_separator(*c)).collect();
        let has_thousands = text.chars().filter(|c| is_separator(*c)).count() > 0
            && without.trim_start_matches('-').len() > 3
            && without.trim_start_matches('-').bytes().all(|byte| byte.is_ascii_digit());
        let what = self.words();
        if has_thousands { format!("{what}, without separators of thousands") } else { what.to_owned() }
    }
}

/// A column as the header has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Column {
    /// All of it, or the number of the column, from 1, if it has no name.
    pub header: String,
    /// Bytes of the name in it, without the unit.
    name: Range<usize>,
    pub unit: Option<HeaderUnit>,
}

impl Column {
    fn new(header: &str, unit_below: Option<HeaderUnit>) -> Self {
        let (name, unit) = name_and_unit(header);
        Self { header: header.to_owned(), name: 0..name.len(), unit: unit.or(unit_below) }
    }

    fn numbered(index: usize) -> Self {
        let header = (index + 1).to_string();
        Self { name: 0..0, header, unit: None }
    }

    /// Without the unit; empty if it has no name.
    pub fn name(&self) -> &str {
        &self.header[self.name.clone()]
    }
}

/// What a map says of a table's form, whatever kind of file it is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct TableFormat {
    pub decimal: Option<Decimal>,
    /// Order of dates that are ambiguous.
    pub date: Option<DateOrder>,
    /// Whether there is a header; found if not stated.
    pub header: Option<bool>,
}

/// A table whose header is found.
pub(super) struct Table {
    rows: Box<dyn Rows>,
    ahead: VecDeque<Row>,
    pub columns: Vec<Column>,
    /// The header; an empty row if there is none.
    pub head: Row,
    pub has_header: bool,
    pub decimal: Decimal,
    pub dates: Dates,
    /// Remarks, in words.
    pub found: Vec<String>,
}

impl Table {
    /// A table whose first rows are read, with nothing known about it.
    fn begin(mut rows: Box<dyn Rows>) -> Result<Self, InputError> {
        let mut ahead = VecDeque::new();
        while ahead.len() < AHEAD {
            let mut row = Row::default();
            if !rows.next_row(&mut row)? {
                break;
            }
            ahead.push_back(row);
        }
        if ahead.is_empty() {
            let help = Some("expected a line with the names of the columns".to_owned());
            return Err(InputError::in_excerpt(
                rows.name(),
                Excerpt::whole(""),
                0..0,
                "the file is empty",
                help,
            ));
        }
        Ok(Self {
            rows,
            ahead,
            columns: Vec::new(),
            head: Row::default(),
            has_header: false,
            decimal: Decimal::Point,
            dates: Dates::default(),
            found: Vec::new(),
        })
    }

    /// Finds the header among the first rows: the row with most of the wanted names, or none if all columns are wanted by number.
    pub fn find(rows: Box<dyn Rows>, wanted: &Wanted, format: TableFormat) -> Result<Self, InputError> {
        let mut table = Self::begin(rows)?;
        match table.header(wanted, format.header)? {
            Some(index) => table.take_header(index),
            None => table.skip_preamble(wanted, format.header == Some(false)),
        }
        table.decimal = format.decimal.unwrap_or_else(|| table.sniff_decimal());
        table.dates = format.date.map_or_else(|| table.sniff_dates(), Dates::stated);
        Ok(table)
    }

    /// A table about which nothing is known beforehand: most of its rows have the same number of cells, and at least a third of these
    /// are numbers; a row of names in front of the first of them is the header.
    pub fn find_any(rows: Box<dyn Rows>) -> Result<Self, InputError> {
        let mut table = Self::begin(rows)?;
        let mut counts: HashMap<usize, usize> = HashMap::new();
        table.ahead.iter().for_each(|row| *counts.entry(row.len()).or_default() += 1);
        let cells =
            counts.into_iter().max_by_key(|(cells, count)| (*count, *cells)).map_or(0, |(cells, _)| cells);
        let numbers = |row: &Row| Wanted::default().numbers_in(row, true);
        let is_row = |row: &Row| row.len() == cells && 3 * numbers(row) >= cells && numbers(row) > 0;
        let first = table.ahead.iter().position(is_row).unwrap_or(0);
        let is_header =
            |row: &Row| row.len() >= cells && numbers(row) == 0 && units_row(row, row.len()).is_none();
        let header = table.ahead.iter().take(first).rposition(is_header);
        // Only units may be between names and numbers.
        match header.filter(|header| first - header <= 2) {
            Some(header) => table.take_header(header),
            None => {
                table.ahead.drain(..first);
                table.columns = (0..cells).map(Column::numbered).collect();
            }
        }
        table.decimal = table.sniff_decimal();
        table.dates = table.sniff_dates();
        Ok(table)
    }

    pub fn name(&self) -> &str {
        self.rows.name()
    }

    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = self.found.clone();
        remarks.extend(self.rows.remarks());
        remarks
    }

    /// Whether the file ends within the line of the row that was given last.
    pub fn breaks_off(&self) -> bool {
        self.ahead.is_empty() && self.rows.breaks_off()
    }

    pub fn comments(&self) -> &[(u64, String)] {
        self.rows.comments()
    }

    /// Puts the next row with something in it into `row`; false at the end.
    pub fn next_row(&mut self, row: &mut Row) -> Result<bool, InputError> {
        loop {
            match self.ahead.pop_front() {
                Some(next) => *row = next,
                None if self.rows.next_row(row)? => {}
                None => return Ok(false),
            }
            if !row.is_empty() {
                return Ok(true);
            }
        }
    }

    /// Which of the rows ahead is the header.
    fn header(&self, wanted: &Wanted, stated: Option<bool>) -> Result<Option<usize>, InputError> {
        if stated == Some(false) {
            return Ok(None);
        }
        let hits = self.ahead.iter().map(|row| wanted.hits(row)).enumerate();
        let best = hits.fold((0, 0), |best, (index, hits)| if hits > best.1 { (index, hits) } else { best });
        if best.1 > 0 || stated == Some(true) {
            return Ok(Some(best.0));
        }
        if wanted.names.is_empty() {
            return Ok(None);
        }
        let first = &self.ahead[0];
        let is_number = |cell: &str| Decimal::Point.parse(cell).or(Decimal::Comma.parse(cell)).is_some();
        if first.cells().all(is_number) {
            let expected = "the names of the columns in the first line; or, for a file without a header, columns by number in a column map: x = 7";
            let message = "the header is missing: the first line holds numbers";
            return Err(first.refuse(self.name(), None, message, expected));
        }
        Ok(Some(0))
    }

    fn take_header(&mut self, index: usize) {
        if index > 0 {
            self.found.push(format!(
                "{}: {} in front of the header ({}) {} skipped",
                self.name(),
                if index == 1 { "1 row".to_owned() } else { format!("{index} rows") },
                self.ahead[index].place(),
                if index == 1 { "is" } else { "are" },
            ));
        }
        self.ahead.drain(..index);
        let Some(head) = self.ahead.pop_front() else { return };
        let mut names: Vec<String> = head.cells().map(str::to_owned).collect();
        let unit_row = self.ahead.front().and_then(|row| units_row(row, names.len()));
        if unit_row.is_some() {
            self.ahead.pop_front();
        }
        // A delimiter at the end makes no column.
        while names.last().is_some_and(String::is_empty)
            && self.ahead.iter().all(|row| row.cell(names.len() - 1).is_none_or(str::is_empty))
        {
            names.pop();
        }
        let cells = self.ahead.front().map_or(0, Row::len);
        if names.len() > cells && cells > 0 {
            names = with_units_in_place(names, cells);
        }
        self.columns = names
            .iter()
            .enumerate()
            .map(|(index, name)| {
                Column::new(name, unit_row.as_ref().and_then(|units| units.get(index).copied().flatten()))
            })
            .collect();
        (self.head, self.has_header) = (head, true);
    }

    /// Skips what is in front of the first row of numbers.
    fn skip_preamble(&mut self, wanted: &Wanted, stated: bool) {
        let first = self.ahead.iter().position(|row| wanted.is_measurement(row));
        let first = if stated { 0 } else { first.unwrap_or(0) };
        let preamble: Vec<Row> = self.ahead.drain(..first).collect();
        let cells = self.ahead.front().map_or(0, Row::len);
        self.columns = (0..cells).map(Column::numbered).collect();
        if first > 0 {
            self.found.push(format!(
                "{}: {} in front of {} {} skipped: no row of numbers",
                self.name(),
                if first == 1 { "1 row".to_owned() } else { format!("{first} rows") },
                self.ahead.front().map_or_else(String::new, |row| row.place().to_string()),
                if first == 1 { "is" } else { "are" },
            ));
        }
        // A header gives the units even if its names are not wanted.
        let units = preamble.last().filter(|row| row.len() == cells).and_then(|row| units_row(row, cells));
        let named = preamble.iter().rev().nth(usize::from(units.is_some())).filter(|row| row.len() == cells);
        let is_number = |cell: &str| Decimal::Point.parse(cell).is_some();
        if let Some(named) = named.filter(|row| !row.cells().any(is_number)) {
            let unit = |index: usize| units.as_ref().and_then(|units| units.get(index).copied().flatten());
            let names = named.cells().enumerate();
            self.columns = names
                .map(|(index, name)| match name {
                    "" => Column { unit: unit(index), ..Column::numbered(index) },
                    name => Column::new(name, unit(index)),
                })
                .collect();
        }
    }

    fn sniff_dates(&self) -> Dates {
        Dates::seen(self.ahead.iter().flat_map(|row| row.cells().map(move |cell| (row.place(), cell))))
    }

    /// A comma where all fractions have one.
    fn sniff_decimal(&mut self) -> Decimal {
        let mut comma = None;
        for (row, cell) in self.ahead.iter().flat_map(|row| row.cells().map(move |cell| (row, cell))) {
            if cell.contains('.') && Decimal::Point.parse(cell).is_some() {
                return Decimal::Point;
            }
            if comma.is_none() && cell.contains(',') && Decimal::Comma.parse(cell).is_some() {
                comma = Some((row.place().clone(), cell.to_owned()));
            }
        }
        let Some((place, cell)) = comma else { return Decimal::Point };
        self.found
            .push(format!("{}: numbers have a decimal comma, for example {cell}", place.of(self.name())));
        Decimal::Comma
    }
}

/// The units of a row that holds nothing else: `mm mm mm deg`.
fn units_row(row: &Row, columns: usize) -> Option<Vec<Option<HeaderUnit>>> {
    let units: Vec<_> = row.cells().map(|cell| (cell, unit_alone(cell))).collect();
    let all = units.iter().all(|(cell, unit)| cell.is_empty() || unit.is_some());
    let some = units.iter().any(|(_, unit)| unit.is_some_and(|unit| unit != HeaderUnit::Other));
    (all && some && units.len() <= columns).then(|| units.into_iter().map(|(_, unit)| unit).collect())
}

/// If blanks separate a header, units are separate cells: they belong to the name in front of them.
fn with_units_in_place(names: Vec<String>, cells: usize) -> Vec<String> {
    let mut joined: Vec<String> = Vec::with_capacity(names.len());
    for name in &names {
        let is_unit = name.starts_with(['[', '(', '{']) && unit_alone(name).is_some();
        match joined.last_mut() {
            Some(last) if is_unit => *last = format!("{last} {name}"),
            _ => joined.push(name.clone()),
        }
    }
    if joined.len() == cells { joined } else { names }
}

#[cfg(test)]
mod tests {
    use super::super::rows::{MemoryRows, Place};
    use super::super::units::{AngleUnit, LengthUnit};
    use super::*;

    fn table(lines: &[&[&str]], wanted: &Wanted) -> Table {
        let rows = lines
            .iter()
            .zip(1..)
            .map(|(cells, line)| (Place::Line(line), cells.iter().map(|cell| (*cell).to_owned()).collect()));
        Table::find(Box::new(MemoryRows::new("m.csv", rows.collect())), wanted, TableFormat::default())
            .expect("a table")
    }

    fn named(names: &[&str]) -> Wanted {
        Wanted { names: names.iter().map(|name| (*name).to_owned()).collect(), numbers: Vec::new() }
    }

    #[test]
    fn the_header_is_found_behind_a_preamble() {
        let mut table = table(
            &[
                &["Report"],
                &["Operator", "X"],
                &["Name", "X", "Y [mm]"],
                &["", "mm", "m"],
                &["P1", "1,5", "2"],
            ],
            &named(&["Name", "X", "Y"]),
        );
        let units: Vec<_> =
            table.columns.iter().map(|column| (column.name().to_owned(), column.unit)).collect();
        let (mm, none) = (Some(HeaderUnit::Length(LengthUnit::Mm)), None);
        // What stands in the header itself goes before what stands below.
        assert_eq!(units, [("Name".to_owned(), none), ("X".to_owned(), mm), ("Y".to_owned(), mm)]);
        assert_eq!(table.decimal, Decimal::Comma);
        assert_eq!(
            table.remarks(),
            [
                "m.csv: 2 rows in front of the header (line 3) are skipped",
                "m.csv:5: numbers have a decimal comma, for example 1,5"
            ]
        );
        let mut row = Row::default();
        assert!(table.next_row(&mut row).expect("a row") && row.cell(0) == Some("P1"));
        assert!(!table.next_row(&mut row).expect("the end"));
    }

    #[test]
    fn columns_by_number_need_no_header() {
        let wanted = Wanted { names: Vec::new(), numbers: vec![1] };
        let with = table(&[&["Export"], &["Name", "J1 (deg)"], &["P1", "1.5"]], &wanted);
        assert_eq!(with.columns[1].unit, Some(HeaderUnit::Angle(AngleUnit::Deg)));
        let without = table(&[&["P1", "1.5"]], &wanted);
        assert_eq!((without.columns[1].header.as_str(), without.has_header), ("2", false));
        assert!(without.remarks().is_empty());
    }

    #[test]
    fn blanks_do_not_part_a_name_from_its_unit() {
        let table = table(&[&["X", "[mm]", "J1", "(deg)"], &["1.5", "2"]], &named(&["X", "J1"]));
        let names: Vec<_> = table.columns.iter().map(|column| column.header.as_str()).collect();
        assert_eq!(names, ["X [mm]", "J1 (deg)"]);
    }

    #[test]
    fn numbers_are_read_as_programs_write_them() {
        for (text, point, comma) in [
            ("1.5", Some(1.5), None),
            ("1,5", None, Some(1.5)),
            ("1.234,5", None, None),
            ("-1D3", Some(-1e3), Some(-1e3)),
            ("\u{2212}2", Some(-2.0), Some(-2.0)),
            ("", None, None),
            ("P1", None, None),
        ] {
            assert_eq!((Decimal::Point.parse(text), Decimal::Comma.parse(text)), (point, comma), "{text}");
        }
    }
}
