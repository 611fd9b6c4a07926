//! Rows turned into columns, and back.

use parquet::data_type::ByteArray;

use super::{Cell, Column, Kind};

/// Values of a column; absent ones have no value, and definition level 0.
#[derive(Debug, Clone)]
pub(super) enum Values {
    Integer(Vec<i64>),
    Number(Vec<f64>),
    Text(Vec<ByteArray>),
}

/// Some rows of a column.
#[derive(Debug, Clone)]
pub(super) struct ColumnRows {
    pub values: Values,
    /// One per row: 1 if there is a value, else 0.
    pub levels: Vec<i16>,
}

impl ColumnRows {
    pub fn new(kind: Kind) -> Self {
        let values = match kind {
            Kind::Integer => Values::Integer(Vec::new()),
            Kind::Number => Values::Number(Vec::new()),
            Kind::Text => Values::Text(Vec::new()),
        };
        Self { values, levels: Vec::new() }
    }

    pub fn of(columns: &[Column]) -> Vec<Self> {
        columns.iter().map(|column| Self::new(column.kind)).collect()
    }

    /// Whether `cell` is valid here.
    pub fn takes(&self, cell: &Cell) -> bool {
        matches!(
            (&self.values, cell),
            (_, Cell::Absent)
                | (Values::Integer(_), Cell::Integer(_))
                | (Values::Number(_), Cell::Number(_))
                | (Values::Text(_), Cell::Text(_))
        )
    }

    /// Adds a cell; one of another kind is absent.
    pub fn push(&mut self, cell: &Cell) {
        let present = match (&mut self.values, cell) {
            (Values::Integer(values), Cell::Integer(value)) => {
                values.push(*value);
                true
            }
            (Values::Number(values), Cell::Number(value)) => {
                values.push(*value);
                true
            }
            (Values::Text(values), Cell::Text(value)) => {
                values.push(ByteArray::from(value.as_str()));
                true
            }
            _ => false,
        };
        self.levels.push(i16::from(present));
    }

    pub fn clear(&mut self) {
        self.levels.clear();
        match &mut self.values {
            Values::Integer(values) => values.clear(),
            Values::Number(values) => values.clear(),
            Values::Text(values) => values.clear(),
        }
    }

    /// The cells in their order.
    pub fn cells(&self) -> Cells<'_> {
        Cells { column: self, row: 0, value: 0 }
    }
}

/// Walks through the cells of a column.
pub(super) struct Cells<'a> {
    column: &'a ColumnRows,
    row: usize,
    value: usize,
}

impl Iterator for Cells<'_> {
    type Item = Cell;

    fn next(&mut self) -> Option<Cell> {
        let level = *self.column.levels.get(self.row)?;
        self.row += 1;
        if level == 0 {
            return Some(Cell::Absent);
        }
        let at = self.value;
        self.value += 1;
        Some(match &self.column.values {
            Values::Integer(values) => values.get(at).map_or(Cell::Absent, |value| Cell::Integer(*value)),
            Values::Number(values) => values.get(at).map_or(Cell::Absent, |value| Cell::Number(*value)),
            Values::Text(values) => values
                .get(at)
                .map_or(Cell::Absent, |value| Cell::Text(String::from_utf8_lossy(value.data()).into_owned())),
        })
    }
}
