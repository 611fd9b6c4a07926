//! A table of Denavit-Hartenberg rows as manuals print it, in delimited text.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::ops::Range;

use nalgebra::Vector3;

use super::dh_cells::{Column, Sign, Unit, Value, Variable, What, cells, column, number, terms, variable};
use super::text::{line, mm, row};
use super::{Converted, doubtful_reach, file_name, in_original, made_name};
use crate::input::{InputError, Source, quoted};
use crate::robot::parse_robot;
use calibrig_model::{CraigLink, JointKind};

/// Convention of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Convention {
    /// A row's a and alpha come before its joint ("modified").
    Craig,
    /// A row's a and alpha come after its joint ("classic", "distal").
    Standard,
}

impl Convention {
    fn key(self) -> &'static str {
        match self {
            Self::Craig => "craig",
            Self::Standard => "standard",
        }
    }
}

/// Makes a robot file from a table: a header line with units, and one row per joint from the base.
///
/// Columns are `a`, `alpha`, `d` and `theta` with their units (`a_mm`, `alpha [deg]`, `θ (rad)`), and optionally `name`, `type`, `beta`, `min` and
/// `max`. A cell may show which of theta and d is the joint variable, with its sign and offset: `q2 - 90`, `-θ3`.
///
/// # Errors
///
/// [`InputError`] that points into the table.
pub fn robot_from_dh(
    source: &Source,
    convention: Convention,
    target: Option<Vector3<f64>>,
) -> Result<Converted, InputError> {
    let table = Table::read(source)?;
    let mut text = String::new();
    let mut remarks = Vec::new();
    let rows = table.rows(convention, &mut remarks)?;
    line!(
        text,
        "# Made by calibrig from {}, a table of the {} convention.",
        file_name(&source.name),
        convention.key()
    );
    line!(text, "# Values marked \"assumed\" are not in the table: check them.");
    line!(text);
    line!(text, "schema = \"calibrig.robot/1\"");
    let stem = std::path::Path::new(&source.name).file_stem();
    line!(text, "name = {}", quoted(&stem.map_or_else(|| "robot".into(), |stem| stem.to_string_lossy())));
    line!(text, "convention = \"{}\"", convention.key());
    for found in &rows {
        let comments = found.assumed.map(|assumed| if assumed { " # assumed" } else { "" });
        row(&mut text, &found.link, comments);
        if found.reversed {
            line!(text, "# The table writes the variable with a minus sign.");
            line!(text, "[joint.shown]");
            line!(text, "sign = -1");
        }
    }
    line!(text);
    line!(text, "[actuators]");
    line!(text, "kind = \"direct\"");
    if let Some(target) = target {
        line!(text);
        line!(text, "# As given by --target-mm, in the last frame of the table.");
        line!(text, "[target]");
        let [x, y, z] = [target.x, target.y, target.z].map(mm);
        line!(text, "x_mm = {x}\ny_mm = {y}\nz_mm = {z}");
    }
    let made = Source::new(made_name(&source.name), text);
    let robot = parse_robot(made.clone(), None, None).map_err(|error| in_original(source, &error))?;
    Ok(Converted { source: made, robot, remarks, difference: None })
}

/// A row, and what the table does not state about it.
struct Row {
    link: CraigLink,
    reversed: bool,
    /// Number in the name of the joint variable.
    joint: Option<u32>,
    /// Of the lower and the upper limit.
    assumed: [bool; 2],
}

/// A cell with its place in the text.
type Cell<'a> = (&'a str, Range<usize>);

struct Table<'a> {
    source: &'a Source,
    columns: Vec<Column>,
    titles: Vec<String>,
    header: Range<usize>,
    lines: Vec<Vec<Cell<'a>>>,
    decimal_comma: bool,
}

impl<'a> Table<'a> {
    fn read(source: &'a Source) -> Result<Self, InputError> {
        let refused = |span: Range<usize>, message: &str, expected: &str| {
            Err(source.error(span, message, Some(format!("expected {expected}"))))
        };
        let text = source.text.trim_start_matches('\u{feff}');
        let mut start = source.text.len() - text.len();
        let mut lines = Vec::new();
        for line in text.split_inclusive('\n') {
            let content = line.trim();
            if !content.is_empty() && !content.starts_with('#') && !content.starts_with("//") {
                lines.push((start, line.trim_end_matches(['\n', '\r'])));
            }
            start += line.len();
        }
        let Some((&(start, header), rows)) = lines.split_first() else {
            return refused(
                0..0,
                "the table is empty",
                "a header line such as name,a_mm,alpha_deg,d_mm,theta_deg",
            );
        };
        let delimiter = [';', '\t', ','].into_iter().find(|mark| header.contains(*mark)).unwrap_or(' ');
        let span = start..start + header.len();
        let titles: Vec<String> =
            cells(source, start, header, delimiter).into_iter().map(|(title, _)| title).collect();
        let columns = titles.iter().map(|title| column(title)).collect();
        let place = |range: &Range<usize>| source.text.get(range.clone()).unwrap_or_default();
        let table = Self {
            source,
            header: span.clone(),
            lines: rows
                .iter()
                .map(|(start, line)| {
                    let cells = cells(source, *start, line, delimiter);
                    cells.into_iter().map(|(_, range)| (place(&range), range)).collect()
                })
                .collect(),
            decimal_comma: delimiter != ',',
            columns,
            titles,
        };
        for (what, name, units) in [
            (What::A, "a", "a_mm or a_m"),
            (What::Alpha, "alpha", "alpha_deg or alpha_rad"),
            (What::D, "d", "d_mm or d_m"),
            (What::Theta, "theta", "theta_deg or theta_rad"),
        ] {
            let found: Vec<_> = table.columns.iter().filter(|column| column.what == what).collect();
            let is_length = matches!(what, What::A | What::D);
            let fits = |column: &&Column| match column.unit {
                Some(Unit::Length(_)) => is_length,
                Some(Unit::Angle(_)) => !is_length,
                None => false,
            };
            match found.as_slice() {
                [column] if fits(column) => {}
                [_] => {
                    return refused(
                        span,
                        &format!("the column {name} has no unit, or a unit of the other kind"),
                        units,
                    );
                }
                [] => return refused(span, &format!("there is no column {name}"), units),
                _ => {
                    return refused(
                        span,
                        &format!("there are {} columns named {name}", found.len()),
                        "only one of them",
                    );
                }
            }
        }
        if table.lines.is_empty() {
            return refused(span, "the table has no rows", "one row per joint, starting at the base");
        }
        Ok(table)
    }

    fn error<T>(&self, span: Range<usize>, message: &str, expected: &str) -> Result<T, InputError> {
        Err(self.source.error(span, message, Some(format!("expected {expected}"))))
    }

    fn rows(&self, convention: Convention, remarks: &mut Vec<String>) -> Result<Vec<Row>, InputError> {
        let mut rows: Vec<Row> = Vec::new();
        let mut unsaid = Vec::new();
        for (index, line) in self.lines.iter().enumerate() {
            let (row, said) = self.row(convention, index, line)?;
            if !said {
                unsaid.push(row.link.name.clone());
            }
            if let Some(other) = rows.iter().find(|other| other.link.name == row.link.name) {
                let span = line.first().map_or(0..0, |cell| cell.1.clone());
                let message = format!("a second joint {:?}", other.link.name);
                return self.error(span, &message, "a different name for each joint");
            }
            rows.push(row);
        }
        self.check_order(&rows)?;
        if !unsaid.is_empty() {
            remarks.push(format!(
                "assumed: the joints {} turn; the table does not say of any of them whether it turns or slides (a column \
                 type, or q in the cell of theta or d)",
                unsaid.join(", ")
            ));
        }
        let without: Vec<_> =
            rows.iter().filter(|row| row.assumed.contains(&true)).map(|row| row.link.name.as_str()).collect();
        if !without.is_empty() {
            remarks.push(format!(
                "assumed: limits of {}: -360 to 360 deg, -1000 to 1000 mm",
                without.join(", ")
            ));
        }
        remarks.extend(self.passed_over());
        remarks.extend(self.doubtful(&rows));
        remarks.push("no gravity modes: the table has no masses ([joint.body], stiffnesses and [gravity] can be added to the \
                      robot file)".to_owned());
        Ok(rows)
    }

    /// Units that are implausible.
    fn doubtful(&self, rows: &[Row]) -> Vec<String> {
        let twists = || rows.iter().map(|row| row.link.alpha.abs()).filter(|alpha| *alpha != 0.0);
        let unit =
            |what| self.columns.iter().find(|column| column.what == what).and_then(|column| column.unit);
        let is_in_degrees = matches!(unit(What::Alpha), Some(Unit::Angle(size)) if size != 1.0);
        let mut doubtful = Vec::new();
        // Most twists are right angles.
        let right = |alpha: f64| {
            (alpha - std::f64::consts::FRAC_PI_2).abs() < 1e-3 || (alpha - std::f64::consts::PI).abs() < 1e-3
        };
        if is_in_degrees && twists().count() > 0 && twists().all(|alpha| right(alpha.to_degrees())) {
            doubtful.push(
                "doubtful: the title of alpha says deg, but its values are right angles in rad".to_owned(),
            );
        }
        if !is_in_degrees && twists().any(|alpha| alpha > TAU) {
            doubtful.push(
                "doubtful: the title of alpha says rad, but some values are more than a full turn".to_owned(),
            );
        }
        let links = rows.iter().map(|row| (row.link.a, row.link.d));
        doubtful.extend(doubtful_reach(links.map(|(a, d)| a.abs() + d.abs()).sum()));
        doubtful
    }

    /// Unused columns, except a count of the rows.
    fn passed_over(&self) -> Option<String> {
        let others = self.columns.iter().zip(&self.titles).filter(|(column, _)| column.what == What::Other);
        let is_count = |title: &str| {
            ["", "#", "i", "n", "no", "no.", "nr", "nr."].contains(&title.to_lowercase().as_str())
        };
        let titles: Vec<_> =
            others.map(|(_, title)| title.as_str()).filter(|title| !is_count(title)).collect();
        (!titles.is_empty()).then(|| {
            let columns = if titles.len() == 1 { "column" } else { "columns" };
            format!("ignored: the {columns} {}", titles.join(", "))
        })
    }

    /// Joint variables that have numbers go up by one from row to row, from 0 or 1 on.
    fn check_order(&self, rows: &[Row]) -> Result<(), InputError> {
        let numbered = || (0_u32..).zip(rows).filter_map(|(index, row)| Some((index, row, row.joint?)));
        let first = u32::from(numbered().next().is_some_and(|(index, _, joint)| joint != index));
        let Some((index, row, _)) = numbered().find(|(index, _, joint)| *joint != index + first) else {
            return Ok(());
        };
        let of = |what| self.cell(&self.lines[index as usize], what).map(|(cell, _)| cell);
        let has_variable = |cell: &Cell<'_>| terms(cell.0).iter().any(|(_, term)| variable(term).is_some());
        let cell = [of(What::D), of(What::Theta)].into_iter().flatten().find(has_variable);
        let (text, span) = cell.unwrap_or(("", self.header.clone()));
        let message = format!("{text:?} is the variable of another joint, not of {}", row.link.name);
        let expected = format!(
            "the number {} here: rows are in the order of their joints, each with its own variable. Merge rows of fixed \
             frames into their neighbours; what moves with another joint goes into [joint.shown] of the robot file",
            index + first
        );
        self.error(span, &message, &expected)
    }

    fn cell(&self, line: &[Cell<'a>], what: What) -> Option<(Cell<'a>, Column)> {
        let index = self.columns.iter().position(|column| column.what == what)?;
        let cell = line.get(index)?.clone();
        Some((cell, self.columns[index]))
    }

    /// A row, and whether the table says which kind its joint is.
    fn row(
        &self,
        convention: Convention,
        index: usize,
        line: &[Cell<'a>],
    ) -> Result<(Row, bool), InputError> {
        let span = line.first().map_or(0, |cell| cell.1.start)..line.last().map_or(0, |cell| cell.1.end);
        if line.len() != self.columns.len() {
            let message = format!("{} cells, but the header has {}", line.len(), self.columns.len());
            return self.error(span, &message, "one cell per column");
        }
        let name = match self.cell(line, What::Name) {
            Some(((name, _), _)) if !name.is_empty() => name.to_owned(),
            _ => format!("J{}", index + 1),
        };
        let of = |what| self.value(line, what);
        let (a, alpha, beta) = (of(What::A)?, of(What::Alpha)?, of(What::Beta)?);
        let (d, theta) = (of(What::D)?, of(What::Theta)?);
        for (what, value) in [("a", &a), ("alpha", &alpha), ("beta", &beta)] {
            if value.variable.is_some() {
                return self.error(span, &format!("{what} of {name} has a joint variable"), "a number");
            }
        }
        if beta.number != 0.0 && convention == Convention::Standard {
            return self.error(
                span,
                "a column beta in a table of the standard convention, which has none",
                "--convention craig",
            );
        }
        let stated = match self.cell(line, What::Type) {
            Some(((text, place), _)) => Some((self.kind(text, place.clone())?, place)),
            None => None,
        };
        let (kind, said) = match (&stated, d.variable, theta.variable) {
            (_, Some(_), Some(_)) => {
                return self.error(
                    span,
                    &format!("both d and theta of {name} have a variable"),
                    "one joint variable per row",
                );
            }
            (Some((JointKind::Revolute, place)), Some(_), _)
            | (Some((JointKind::Prismatic, place)), _, Some(_)) => {
                let message = format!("the type of {name} contradicts the cell that holds its variable");
                return self.error(
                    place.clone(),
                    &message,
                    "revolute with a variable in theta, prismatic with one in d",
                );
            }
            (Some((kind, _)), ..) => (*kind, true),
            (None, Some(_), None) => (JointKind::Prismatic, true),
            (None, None, Some(_)) => (JointKind::Revolute, true),
            (None, None, None) => (JointKind::Revolute, false),
        };
        let (mut limits, mut assumed) = self.limits(line, kind, &name)?;
        let variable = d.variable.or(theta.variable);
        let reversed = variable.is_some_and(|variable| variable.sign == Sign::Minus);
        if reversed {
            // A manual's limits are those of the displayed values.
            limits = [-limits[1], -limits[0]];
            assumed.reverse();
        }
        let link = match kind {
            JointKind::Revolute => CraigLink::revolute(name),
            JointKind::Prismatic => CraigLink::prismatic(name),
        };
        let link = link
            .row(a.number, alpha.number, d.number, theta.number)
            .with_beta(beta.number)
            .limits(limits[0], limits[1]);
        Ok((Row { link, reversed, joint: variable.and_then(|variable| variable.joint), assumed }, said))
    }

    fn kind(&self, text: &str, place: Range<usize>) -> Result<JointKind, InputError> {
        match text.to_lowercase().as_str() {
            "r" | "revolute" | "rotary" | "continuous" => Ok(JointKind::Revolute),
            "p" | "prismatic" | "linear" | "t" => Ok(JointKind::Prismatic),
            _ => self.error(place, &format!("the type is {text:?}"), "revolute or prismatic (R or P)"),
        }
    }

    fn limits(
        &self,
        line: &[Cell<'a>],
        kind: JointKind,
        name: &str,
    ) -> Result<([f64; 2], [bool; 2]), InputError> {
        let mut limits = match kind {
            JointKind::Revolute => [-TAU, TAU],
            JointKind::Prismatic => [-1.0, 1.0],
        };
        let mut assumed = [true; 2];
        for (end, what) in [What::Min, What::Max].into_iter().enumerate() {
            // One column per unit: the one that fits the joint and has something in its cell.
            let columns = self.columns.iter().zip(line).filter(|(column, _)| column.what == what);
            for (column, (text, place)) in columns {
                let size = match (column.unit, kind) {
                    (Some(Unit::Angle(size)), JointKind::Revolute)
                    | (Some(Unit::Length(size)), JointKind::Prismatic) => size,
                    (None, _) => {
                        let message = "the column of a limit has no unit";
                        return self.error(
                            self.header.clone(),
                            message,
                            "min_deg, max_deg, min_mm or max_mm",
                        );
                    }
                    _ => continue,
                };
                if !text.is_empty() {
                    limits[end] = size * self.expression(text, place.clone(), size)?.number;
                    assumed[end] = false;
                }
            }
        }
        if limits[0] >= limits[1] {
            let span = line.first().map_or(0..0, |cell| cell.1.clone());
            return self.error(
                span,
                &format!("the max of {name} is not above its min"),
                "a max above the min",
            );
        }
        Ok((limits, assumed))
    }

    /// The value of a cell in SI; zero for a missing column.
    fn value(&self, line: &[Cell<'a>], what: What) -> Result<Value, InputError> {
        let Some(((text, place), column)) = self.cell(line, what) else { return Ok(Value::default()) };
        let size = match column.unit {
            Some(Unit::Length(size) | Unit::Angle(size)) => size,
            None => 1.0,
        };
        let value = self.expression(text, place, size)?;
        Ok(Value { number: value.number * size, ..value })
    }

    /// A sum of numbers and at most one joint variable, such as `q2 - 90`, `-pi/2` or `θ3*`, in the column's unit, of which `size` make one of
    /// SI.
    fn expression(&self, text: &str, place: Range<usize>, size: f64) -> Result<Value, InputError> {
        let mut value = Value::default();
        let refused = |what: &str| {
            self.error(
                place.clone(),
                what,
                "a number, or the joint variable with an offset, such as q2 - 90; pi in columns of rad",
            )
        };
        if text.is_empty() {
            return refused("an empty cell");
        }
        for (minus, term) in terms(text) {
            let sign = if minus { -1.0 } else { 1.0 };
            if let Some(number) = number(&term, size, self.decimal_comma) {
                value.number += sign * number;
            } else if let Some(digits) = variable(&term) {
                let joint = digits.parse().ok();
                let sign = if minus { Sign::Minus } else { Sign::Plus };
                if value.variable.replace(Variable { sign, joint }).is_some() {
                    return self.error(
                        place.clone(),
                        &format!("{text:?} has more than one joint variable"),
                        "only the variable of the row's own joint; motion with another joint goes into [joint.shown] of the \
                         robot file",
                    );
                }
            } else {
                return refused(&format!("{text:?} is not a number"));
            }
        }
        if value.number.is_finite() {
            Ok(value)
        } else {
            refused(&format!("{text:?} is not a finite number"))
        }
    }
}
