//! Tables of points where a tool is to be, in calibrig's own columns.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};

use super::columns::RowOptions;
use super::header::FileColumns;
use super::layout::{Column, Table, TableFormat, Wanted};
use super::open::open;
use super::reader::check_length;
use super::rows::{Row, Rows};
use super::text::{TextFormat, TextRows};
use super::units::{HeaderUnit, unit_of_name};
use crate::goals::{GoalTable, StatedGoal, StatedHold};
use crate::input::{InputError, Source};
use crate::rotation::{MatrixOrder, QuaternionOrder, RotationForm, rotation_of_matrix};

/// Names of columns without their units, and which kind of unit they have.
const AXES: [&str; 3] = ["axis_x", "axis_y", "axis_z"];
const MATRIX: [&str; 9] = ["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"];
const QUATERNION: [&str; 4] = ["qw", "qx", "qy", "qz"];
const KNOWN: &str = "name, x_mm, y_mm, z_mm, then axis_x, axis_y, axis_z (the direction of the tool's axis), or r11 to r33 or qw, qx, qy, qz (its rotation), and \
                     time_s; lengths in m, mm, um, cm or inch";
/// Largest number of a table.
const LARGEST: f64 = 1e9;

/// Reads a table of points: text, or a sheet of a spreadsheet.
///
/// # Errors
/// [`InputError`] with line and column: a file that cannot be read or holds no points, unknown columns or columns without a unit, cells that are not
/// finite numbers, directions of length zero, and matrices that are not rotations.
pub fn read_goals(path: &Path) -> Result<GoalTable, InputError> {
    let rows = open(path, &TextFormat::default(), &wanted(), &RowOptions::default())?;
    read(rows)
}

/// The same of a text in memory.
///
/// # Errors
/// As [`read_goals`].
pub fn parse_goals(source: &Source) -> Result<GoalTable, InputError> {
    let rows = TextRows::of_text(&source.name, &source.text, &TextFormat::default(), &wanted())?;
    read(Box::new(rows))
}

/// What headers may hold.
fn wanted() -> Wanted {
    let lengths = ["x", "y", "z"].iter().flat_map(|axis| {
        let units = ["", "_m", "_mm", "_um", "_cm", "_inch"].map(|unit| format!("{axis}{unit}"));
        units.into_iter().chain([axis.to_uppercase()])
    });
    let others = AXES.iter().chain(&MATRIX).chain(&QUATERNION).chain(&["name", "time_s"]);
    Wanted { names: lengths.chain(others.map(|name| (*name).to_owned())).collect(), numbers: Vec::new() }
}

/// What a column holds, and the size of its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Field {
    Name,
    Position(usize, HeaderUnit),
    Axis(usize),
    Matrix(usize),
    Quaternion(usize),
    Time(HeaderUnit),
}

fn field(columns: &FileColumns<'_>, column: &Column) -> Result<Field, InputError> {
    let header = column.header.as_str();
    let (mut name, mut unit) = (column.name().to_lowercase(), column.unit);
    if unit.is_none()
        && let Some(found) = unit_of_name(&name)
        && let Some((before, _)) = name.rsplit_once('_')
        && ["x", "y", "z", "time"].contains(&before)
    {
        (name, unit) = (before.to_owned(), Some(found));
    }
    let plain = |names: &[&str]| names.iter().position(|known| *known == name);
    let refused = |message: String, expected: &str| Err(columns.refuse(message, expected));
    if let Some(axis) = plain(&["x", "y", "z"]) {
        return match unit {
            Some(unit @ HeaderUnit::Length(_)) => Ok(Field::Position(axis, unit)),
            Some(unit) => refused(
                format!("column {header} is in {}, which is not a unit of length", unit.key()),
                &format!("{name}_mm or {name}_m"),
            ),
            None => refused(
                format!("column {header} has no unit"),
                &format!("{name}_mm or {name}_m: the unit is part of the name"),
            ),
        };
    }
    match (name.as_str(), unit) {
        ("name", None) => return Ok(Field::Name),
        ("time", Some(unit @ HeaderUnit::Time(_))) => return Ok(Field::Time(unit)),
        ("time", _) => return refused(format!("column {header} has no unit of time"), "time_s"),
        _ => {}
    }
    let found = plain(&AXES)
        .map(Field::Axis)
        .or_else(|| plain(&MATRIX).map(Field::Matrix))
        .or_else(|| plain(&QUATERNION).map(Field::Quaternion));
    match (found, unit) {
        (Some(field), None) => Ok(field),
        (Some(_), Some(unit)) => refused(
            format!("column {header} is in {}: directions and rotations have no unit", unit.key()),
            &name,
        ),
        (None, _) => refused(format!("column {header} is not known"), KNOWN),
    }
}

/// Columns of what is wanted, by their numbers in the rows.
struct Fields {
    name: Option<usize>,
    time: Option<(usize, HeaderUnit)>,
    position: [(usize, HeaderUnit); 3],
    held: Held,
}

enum Held {
    Free,
    Axis([usize; 3]),
    Matrix([usize; 9]),
    Quaternion([usize; 4]),
}

impl Fields {
    fn find(columns: &FileColumns<'_>) -> Result<Self, InputError> {
        let fields: Vec<Field> =
            columns.columns.iter().map(|column| field(columns, column)).collect::<Result<_, _>>()?;
        let at = |wanted: &dyn Fn(&Field) -> bool| {
            let mut found = fields.iter().enumerate().filter(|(_, field)| wanted(field));
            match (found.next(), found.next()) {
                (_, Some((second, _))) => {
                    let header = &columns.columns[second].header;
                    Err(columns.refuse(format!("column {header} appears twice"), "one column per quantity"))
                }
                (found, None) => Ok(found.map(|(index, field)| (index, *field))),
            }
        };
        let mut position = [(0, HeaderUnit::Other); 3];
        for (axis, name) in ["x", "y", "z"].iter().enumerate() {
            match at(&|field| matches!(field, Field::Position(of, _) if *of == axis))? {
                Some((index, Field::Position(_, unit))) => position[axis] = (index, unit),
                _ => {
                    let message = format!("there is no column {name}; there are {}", columns.names());
                    return Err(columns
                        .refuse(message, &format!("{name}_mm or {name}_m; the columns known are {KNOWN}")));
                }
            }
        }
        let mut forms = Vec::new();
        let mut all = |names: &[&str], of: &dyn Fn(usize) -> Field| -> Result<Vec<usize>, InputError> {
            let mut found = Vec::new();
            for part in 0..names.len() {
                found.extend(at(&|field| *field == of(part))?.map(|(index, _)| index));
            }
            if !found.is_empty() {
                forms.push(names.join(", "));
                if found.len() < names.len() {
                    let message = format!("only the columns {} {} are there", names.join(", "), found.len());
                    return Err(columns.refuse(message, &format!("all {} of them, or none", names.len())));
                }
            }
            Ok(found)
        };
        let axis = all(&AXES, &Field::Axis)?;
        let matrix = all(&MATRIX, &Field::Matrix)?;
        let quaternion = all(&QUATERNION, &Field::Quaternion)?;
        if forms.len() > 1 {
            let message = format!("the tool's orientation is given in two ways: {}", forms.join("; and "));
            return Err(columns.refuse(message, "only one of them"));
        }
        let held = match (axis.as_slice(), matrix.as_slice(), quaternion.as_slice()) {
            (&[x, y, z], ..) => Held::Axis([x, y, z]),
            (_, matrix @ &[_, ..], _) => Held::Matrix(std::array::from_fn(|k| matrix[k])),
            (.., &[w, x, y, z]) => Held::Quaternion([w, x, y, z]),
            _ => Held::Free,
        };
        Ok(Self {
            name: at(&|field| *field == Field::Name)?.map(|(index, _)| index),
            time: match at(&|field| matches!(field, Field::Time(_)))? {
                Some((index, Field::Time(unit))) => Some((index, unit)),
                _ => None,
            },
            position,
            held,
        })
    }
}

/// A row that is being read.
struct Cells<'a> {
    table: &'a Table,
    row: &'a Row,
}

impl Cells<'_> {
    fn refuse(&self, column: Option<usize>, message: impl std::fmt::Display, expected: &str) -> InputError {
        self.row.refuse(self.table.name(), column, message, expected)
    }

    fn number(&self, column: usize) -> Result<f64, InputError> {
        let text = self.row.cell(column).unwrap_or_default();
        let header = self.table.columns.get(column).map_or("", |column| column.header.as_str());
        if text.is_empty() {
            return Err(self.refuse(Some(column), format!("column {header} is empty"), "a number"));
        }
        let Some(number) = self.table.decimal.parse(text) else {
            let expected = self.table.decimal.words_for(text);
            return Err(self.refuse(Some(column), format!("column {header} is {text:?}"), &expected));
        };
        if number.is_finite() && number.abs() <= LARGEST {
            return Ok(number);
        }
        let expected = format!("a finite number of at most {LARGEST:e}");
        Err(self.refuse(Some(column), format!("column {header} is {text}"), &expected))
    }

    fn numbers<const N: usize>(&self, columns: [usize; N]) -> Result<[f64; N], InputError> {
        let mut numbers = [0.0; N];
        for (into, column) in numbers.iter_mut().zip(columns) {
            *into = self.number(column)?;
        }
        Ok(numbers)
    }

    fn held(&self, held: &Held) -> Result<StatedHold, InputError> {
        let form = |form: RotationForm, numbers: &[f64], column: usize| {
            let read = form.rotation(numbers);
            let read = read.map_err(|error| self.refuse(Some(column), error, error.expected()))?;
            Ok(StatedHold::Rotation(read.rotation))
        };
        match held {
            Held::Free => Ok(StatedHold::Free),
            Held::Axis(columns) => {
                let direction = Vector3::from(self.numbers(*columns)?);
                if direction.norm() == 0.0 {
                    let expected = "a direction in the base frame, of any length but zero";
                    return Err(self.refuse(Some(columns[0]), "the tool's axis has length zero", expected));
                }
                Ok(StatedHold::Axis(direction))
            }
            Held::Matrix(columns) => {
                let numbers = self.numbers(*columns)?;
                // Unchanged, bit for bit, if it is a rotation.
                if let Ok(rotation) = rotation_of_matrix(&Matrix3::from_row_slice(&numbers)) {
                    return Ok(StatedHold::Rotation(rotation));
                }
                form(RotationForm::Matrix(MatrixOrder::ByRows), &numbers, columns[0])
            }
            Held::Quaternion(columns) => {
                let numbers = self.numbers(*columns)?;
                form(RotationForm::Quaternion(QuaternionOrder::ScalarFirst), &numbers, columns[0])
            }
        }
    }

    fn goal(&self, fields: &Fields) -> Result<StatedGoal, InputError> {
        let mut position = Vector3::zeros();
        for (axis, (column, unit)) in fields.position.iter().enumerate() {
            let number = self.number(*column)?;
            position[axis] = if let HeaderUnit::Length(unit) = unit { unit.in_si(number) } else { number };
        }
        let time = match fields.time {
            Some((column, HeaderUnit::Time(unit))) => Some(unit.in_si(self.number(column)?)),
            _ => None,
        };
        let name = fields.name.and_then(|column| self.row.cell(column)).unwrap_or_default().to_owned();
        Ok(StatedGoal {
            name,
            position,
            held: self.held(&fields.held)?,
            time,
            place: self.row.place().clone(),
        })
    }
}

fn read(rows: Box<dyn Rows>) -> Result<GoalTable, InputError> {
    let mut table = Table::find(rows, &wanted(), TableFormat::default())?;
    let fields = Fields::find(&FileColumns {
        name: table.name(),
        head: &table.head,
        has_header: table.has_header,
        columns: &table.columns,
    })?;
    let mut goals = Vec::new();
    let (mut row, mut cut) = (Row::default(), None);
    while table.next_row(&mut row)? {
        check_length(table.name(), &row, &table.columns, table.has_header)?;
        goals.push(Cells { table: &table, row: &row }.goal(&fields)?);
        cut = table.breaks_off().then(|| row.place().of(table.name()));
    }
    if goals.is_empty() {
        let columns = FileColumns {
            name: table.name(),
            head: &table.head,
            has_header: table.has_header,
            columns: &table.columns,
        };
        return Err(
            columns.refuse("the file has no points", "one row per point below the names of the columns")
        );
    }
    let mut remarks = table.remarks();
    remarks.extend(cut.map(|place| {
        format!("{place}: the last line has no line end: it is read as it stands, but the file may have been cut short there")
    }));
    Ok(GoalTable { file: table.name().to_owned(), goals, remarks })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<GoalTable, InputError> {
        parse_goals(&Source::new("goals.csv", text))
    }

    #[test]
    fn points_are_read_in_every_form() {
        let table = parsed("name,x_mm,y_m,z_mm\nA,1000,2,-3.5\n# between\nB,0,0,1\n").expect("sound");
        assert_eq!((table.goals.len(), table.goals[1].place.to_string().as_str()), (2, "line 4"));
        assert_eq!(table.goals[0].position, Vector3::new(1.0, 2.0, -0.0035));
        assert!(table.goals.iter().all(|goal| goal.held == StatedHold::Free && goal.time.is_none()));
        let table =
            parsed("X [mm];Y [mm];Z [mm];axis_x;axis_y;axis_z;time_s\n1,5;0;0;0;0;-2;0,25\n").expect("sound");
        assert_eq!(table.goals[0].position.x, 0.0015);
        assert_eq!(table.goals[0].held, StatedHold::Axis(Vector3::new(0.0, 0.0, -2.0)));
        assert!(table.is_timed() && table.goals[0].time == Some(0.25));
        let by_rows = parsed("x_m,y_m,z_m,r11,r12,r13,r21,r22,r23,r31,r32,r33\n0,0,0,0,-1,0,1,0,0,0,0,1\n")
            .expect("sound");
        let quaternion = parsed("x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0.7071068,0,0,0.7071068\n").expect("sound");
        for table in [by_rows, quaternion] {
            let StatedHold::Rotation(rotation) = table.goals[0].held else { panic!("{table:?}") };
            assert!((rotation * Vector3::x() - Vector3::y()).norm() < 1e-6, "{rotation}");
        }
        let cut = parsed("x_m,y_m,z_m\n1,2,3").expect("taken");
        assert!(
            cut.remarks.iter().any(|remark| remark.contains("goals.csv:2: the last line has no line end")),
            "{cut:?}"
        );
    }

    #[test]
    fn what_cannot_be_is_refused_with_its_line() {
        for (text, message, help) in [
            ("", "the file is empty", "names of the columns"),
            ("x_mm,y_mm,z_mm\n", "goals.csv:1: the file has no points", "one row per point"),
            ("1,2,3\n4,5,6\n", "goals.csv:1: the header is missing", "names of the columns"),
            ("x_mm,y_mm\n1,2\n", "goals.csv:1: there is no column z", "z_mm or z_m"),
            ("x,y_mm,z_mm\n1,2,3\n", "goals.csv:1: column x has no unit", "x_mm or x_m"),
            ("x_deg,y_mm,z_mm\n1,2,3\n", "column x_deg is in deg, which is not a unit of length", "x_mm"),
            ("x_mm,x_m,y_mm,z_mm\n1,1,2,3\n", "column x_m appears twice", "one column"),
            ("x_mm,y_mm,z_mm,speed\n1,2,3,4\n", "column speed is not known", "axis_x"),
            ("x_mm,y_mm,z_mm,time\n1,2,3,4\n", "column time has no unit of time", "time_s"),
            ("x_mm,y_mm,z_mm,axis_x,axis_y\n1,2,3,0,0\n", "2 are there", "all 3"),
            (
                "x_mm,y_mm,z_mm,axis_x,axis_y,axis_z,qw,qx,qy,qz\n1,2,3,0,0,1,1,0,0,0\n",
                "given in two ways",
                "only one of them",
            ),
            ("x_mm,y_mm,z_mm\n1,2,3\n1,nan,3\n", "goals.csv:3: column y_mm is nan", "finite"),
            ("x_mm,y_mm,z_mm\n1,inf,3\n", "goals.csv:2: column y_mm is inf", "finite"),
            ("x_mm,y_mm,z_mm\n1,,3\n", "goals.csv:2: column y_mm is empty", "a number"),
            ("x_mm,y_mm,z_mm\n1,two,3\n", "goals.csv:2: column y_mm is \"two\"", "a number"),
            ("x_mm,y_mm,z_mm\n1,2\n", "goals.csv:2: the row has 2 of 3 columns", "3 values"),
            ("x_mm,y_mm,z_mm,axis_x,axis_y,axis_z\n1,2,3,0,0,0\n", "length zero", "direction"),
            ("x_mm,y_mm,z_mm,qw,qx,qy,qz\n1,2,3,1,1,0,0\n", "the quaternion has length", "length 1"),
        ] {
            let error = parsed(text).expect_err(message);
            let told = format!("{:?}", miette::Report::new(error));
            let told = told.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(told.contains(message) && told.contains(help), "{message}: {told}");
        }
    }
}
