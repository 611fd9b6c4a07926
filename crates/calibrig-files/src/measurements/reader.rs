//! From rows to observations.

use std::collections::HashMap;
use std::fmt;

use nalgebra::{Matrix3, Vector3};

use super::LoadedMeasurements;
use super::columns::{MissedCode, PolarAngle, RowOptions};
use super::header::{Columns, Position, Quantity, QuantityTerm, UncertaintyColumns};
use super::layout::{Column, Decimal};
use super::rows::{Place, Row};
use super::times::TimeReader;
use crate::input::InputError;
use calibrig_model::measurement::{
    Face, MeasurementSet, Observation, Reading, SphericalReading, Station, Target,
};

/// Least motion of an actuator that is one, m or rad.
const MOTION: f64 = 1e-6;

/// Makes observations of the rows of one file.
pub(super) struct RowReader<'a> {
    pub columns: &'a Columns,
    pub options: &'a RowOptions,
    /// The file of the points.
    pub file: &'a str,
    /// All columns of joined rows.
    pub names: &'a [Column],
    /// Those from here on are of the file of the joints, whose numbers are written in the second way.
    pub joints_from: usize,
    pub decimals: [Decimal; 2],
    /// The target of the whole file, where it is one for each.
    pub target: Option<&'a str>,
    pub time: Option<TimeReader>,
    /// What approaches follow from.
    pub motion: Motion,
    pub rows: u32,
}

/// The last command, and the signs of the motions before it.
#[derive(Default)]
pub(super) struct Motion {
    command: Vec<f64>,
    signs: Vec<i8>,
}

impl Motion {
    /// Signs of the last motion of every actuator on the way to this command.
    fn to(&mut self, command: &[f64]) -> Vec<i8> {
        self.signs.resize(command.len(), 0);
        for (index, (sign, to)) in self.signs.iter_mut().zip(command).enumerate() {
            let moved = self.command.get(index).map_or(0.0, |from| to - from);
            if moved.abs() > MOTION {
                *sign = if moved > 0.0 { 1 } else { -1 };
            }
        }
        command.clone_into(&mut self.command);
        self.signs.clone()
    }
}

/// What was named so far.
#[derive(Debug, Default)]
pub(super) struct Names {
    /// Whether poses have names; `None` before the first.
    are_poses_named: Option<bool>,
    pose_numbers: HashMap<String, u32>,
    /// Names of the poses from 1 on.
    pub poses: Vec<String>,
    stations: HashMap<String, usize>,
    targets: HashMap<String, usize>,
}

impl Names {
    fn of_pose(&self, pose: u32) -> Option<&str> {
        let index = (pose as usize).checked_sub(1)?;
        self.poses.get(index).map(String::as_str)
    }

    /// Place of a station in the set; a new one is added. Most rows are of that of the row before.
    fn station(&mut self, name: &str, set: &mut MeasurementSet) -> usize {
        let last = set.observations.last().map(|last| last.station);
        if let Some(last) = last.filter(|last| set.stations[*last].name == name) {
            return last;
        }
        index_of(&mut self.stations, name, || {
            set.stations.push(Station { name: name.to_owned(), ..Station::default() });
        })
    }

    /// The same of a target.
    fn target(&mut self, name: &str, set: &mut MeasurementSet) -> usize {
        let last = set.observations.last().map(|last| last.target);
        if let Some(last) = last.filter(|last| set.targets[*last].name == name) {
            return last;
        }
        index_of(&mut self.targets, name, || {
            set.targets.push(Target { name: name.to_owned(), ..Target::default() });
        })
    }
}

/// Refuses a row that is shorter than the header, or has more in it.
pub(super) fn check_length(
    file: &str,
    row: &Row,
    names: &[Column],
    has_header: bool,
) -> Result<(), InputError> {
    let (found, expected) = (row.len(), names.len());
    // Sheets do not hold what is empty.
    if found < expected && !matches!(row.place(), Place::Sheet { .. }) {
        let (missing, as_header) = if has_header {
            (names[found].header.clone(), "as the header has names")
        } else {
            (format!("column {}", found + 1), "as the first row has")
        };
        let message = format!("the row has {found} of {expected} columns, {missing} is missing");
        return Err(row.refuse(file, None, message, &format!("{expected} values, {as_header}")));
    }
    match (expected..found).find(|column| row.cell(*column).is_some_and(|cell| !cell.is_empty())) {
        Some(column) => {
            let first = if has_header { "the header" } else { "the first row" };
            let message = format!("the row has {found} columns, {first} {expected}");
            let mut help =
                format!("{expected} values, as {first} has{}", if has_header { " names" } else { "" });
            if found == 2 * expected || found + 1 == 2 * expected {
                help += "; decimal commas between commas cannot be told apart: export with another delimiter";
            }
            Err(row.refuse(file, Some(column), message, &help))
        }
        None => Ok(()),
    }
}

impl RowReader<'_> {
    /// Adds the row to what is loaded: as an observation or as dropped.
    pub fn observe(
        &mut self,
        row: &Row,
        names: &mut Names,
        loaded: &mut LoadedMeasurements,
    ) -> Result<(), InputError> {
        let cells = Cells { reader: self, row };
        let pose = match self.columns.pose {
            Some(column) => cells.pose(column, names)?,
            None => self.stop(&cells, loaded)?,
        };
        let held_out = cells.is_held_out(pose, names.of_pose(pose))?;
        let missed = cells.missed();
        // A shot was missed where the robot had gone to.
        let command = match &missed {
            Some(_) if !self.options.approach_from_order => Vec::new(),
            _ => cells.command()?,
        };
        let approach = if self.options.approach_from_order {
            self.motion.to(&command)
        } else {
            Cells { reader: self, row }.approach(command.len())?
        };
        let cells = Cells { reader: self, row };
        let reading = match missed {
            Some(why) => Err(why),
            None => cells.reading()?.ok_or_else(|| "the position is (0, 0, 0)".to_owned()),
        };
        let reading = match reading {
            Ok(reading) => reading,
            Err(why) => {
                let why = format!("missed shot: {why} ({})", row.place().of(self.file));
                let pose = if self.columns.pose.is_some() { pose } else { self.rows };
                loaded.drop_row(pose, why, held_out);
                return Ok(());
            }
        };
        let temperature = cells.temperature()?;
        let time = match &mut self.time {
            Some(time) => {
                let decimal = self.decimals[usize::from(time.first() >= self.joints_from)];
                time.read(self.file, row, decimal)?
            }
            None => 0.0,
        };
        let cells = Cells { reader: self, row };
        let station = cells.name(self.columns.station).unwrap_or("station 1");
        let target = cells.name(self.columns.target).or(self.target).unwrap_or("target 1");
        let station = names.station(station, &mut loaded.set);
        let target = names.target(target, &mut loaded.set);
        let observation =
            Observation { pose, command, approach, temperature, time, station, target, reading };
        loaded.set.observations.push(observation);
        loaded.places.push(self.file, row.place());
        loaded.hold_out_last(held_out);
        Ok(())
    }
}

impl RowReader<'_> {
    /// Number of the pose where no column has it: that of the row, or of the first one of a stop, at which several shots are taken or several
    /// targets are measured one behind the other with the same command.
    fn stop(&self, cells: &Cells<'_>, loaded: &LoadedMeasurements) -> Result<u32, InputError> {
        let last = loaded.set.observations.last().filter(|_| self.rows > 1 && cells.missed().is_none());
        let Some(last) = last else { return Ok(self.rows) };
        let command = cells.command()?;
        let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
        let stays = command.len() == last.command.len() && command.iter().zip(&last.command).all(same);
        Ok(if stays { last.pose } else { self.rows })
    }
}

/// The cells of a row as what they mean.
struct Cells<'r> {
    reader: &'r RowReader<'r>,
    row: &'r Row,
}

impl<'r> Cells<'r> {
    fn cell(&self, column: usize) -> &'r str {
        self.row.cell(column).unwrap_or_default()
    }

    fn decimal(&self, column: usize) -> Decimal {
        self.reader.decimals[usize::from(column >= self.reader.joints_from)]
    }

    fn header(&self, column: usize) -> &str {
        &self.reader.names[column].header
    }

    fn refuse(&self, column: usize, message: impl fmt::Display, expected: &str) -> InputError {
        self.row.refuse(self.reader.file, Some(column), message, expected)
    }

    fn refuse_cell(&self, column: usize, expected: &str) -> InputError {
        let name = self.header(column);
        match self.cell(column) {
            "" => self.refuse(column, format!("column {name} is empty"), expected),
            text => self.refuse(column, format!("column {name} is {text:?}"), expected),
        }
    }

    fn number(&self, column: usize) -> Result<f64, InputError> {
        let decimal = self.decimal(column);
        let cell = self.cell(column);
        match decimal.parse(cell) {
            Some(number) if number.is_finite() => Ok(number),
            Some(_) => Err(self.refuse_cell(column, "a finite number")),
            None if decimal == Decimal::Point && Decimal::Comma.parse(cell).is_some() => {
                let expected = "a number, with a decimal point as others of this file; decimal = \",\" in [text] of a column map reads commas";
                Err(self.refuse_cell(column, expected))
            }
            None => Err(self.refuse_cell(column, &decimal.words_for(cell))),
        }
    }

    /// A signed sum in SI.
    fn value(&self, quantity: &Quantity) -> Result<f64, InputError> {
        if let [QuantityTerm { column, sign, scale }] = quantity.terms.as_slice() {
            return Ok(scale.in_si(sign * self.number(*column)?));
        }
        // Minus zero is what leaves the sign of a zero as it is when added to.
        let mut sum = -0.0;
        for QuantityTerm { column, sign, scale } in &quantity.terms {
            let number = self.number(*column)?;
            sum += sign * if quantity.is_uniform { number } else { scale.in_si(number) };
        }
        match quantity.terms.first() {
            Some(first) if quantity.is_uniform => Ok(first.scale.in_si(sum)),
            _ => Ok(sum),
        }
    }

    fn is_empty(&self, quantities: &[Quantity]) -> bool {
        quantities.iter().flat_map(|quantity| &quantity.terms).all(|term| self.cell(term.column).is_empty())
    }

    fn pose(&self, column: usize, names: &mut Names) -> Result<u32, InputError> {
        let cell = self.cell(column);
        let number = self.decimal(column).parse(cell);
        let may_be_name = self.reader.columns.names_poses && number.is_none() && !cell.is_empty();
        let are_names = *names.are_poses_named.get_or_insert(may_be_name);
        if !are_names {
            return self.whole_number(column, number, may_be_name);
        }
        if cell.is_empty() {
            return Err(self.refuse_cell(column, "the name of a pose, as other rows have"));
        }
        if let Some(number) = names.pose_numbers.get(cell) {
            return Ok(*number);
        }
        names.poses.push(cell.to_owned());
        let number = u32::try_from(names.poses.len()).unwrap_or(u32::MAX);
        names.pose_numbers.insert(cell.to_owned(), number);
        Ok(number)
    }

    fn whole_number(&self, column: usize, number: Option<f64>, may_be_name: bool) -> Result<u32, InputError> {
        // Tables that went through a spreadsheet say 3.0 for 3.
        if let Some(number) = number
            && number.fract() == 0.0
            && (0.0..=f64::from(u32::MAX)).contains(&number)
        {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "checked just above"
            )]
            return Ok(number as u32);
        }
        let expected = if may_be_name {
            "a whole number from 0 to 4294967295, the number of the pose, as the rows before have; or names in all rows"
        } else {
            "a whole number from 0 to 4294967295, the number of the pose; where the column holds names, no pose column (in a \
             column map: leave `pose` out): the rows then count from 1"
        };
        Err(self.refuse_cell(column, expected))
    }

    fn is_held_out(&self, pose: u32, name: Option<&str>) -> Result<bool, InputError> {
        let sets = &self.reader.columns.sets;
        if sets.poses.has(pose, name) || self.reader.options.verification_poses.has(pose, name) {
            return Ok(true);
        }
        let Some(column) = self.reader.columns.set else { return Ok(false) };
        let cell = self.cell(column);
        let is_in = |names: &[String]| names.iter().any(|name| name == cell);
        match (is_in(&sets.identification), is_in(&sets.verification)) {
            (_, true) => Ok(true),
            (true, _) => Ok(false),
            _ if sets.identification.is_empty() => Ok(false),
            _ if sets.verification.is_empty() => Ok(true),
            _ => {
                let known: Vec<_> = sets.identification.iter().chain(&sets.verification).collect();
                Err(self.refuse_cell(column, &format!("one of {known:?}, as [sets] of the column map says")))
            }
        }
    }

    /// Why the row is of a missed shot, where its cells say so.
    fn missed(&self) -> Option<String> {
        let quantities = self.reader.columns.position.quantities();
        let columns = || quantities.iter().flat_map(|quantity| &quantity.terms).map(|term| term.column);
        if columns().all(|column| self.cell(column).is_empty()) {
            return Some("the position is empty".to_owned());
        }
        if self.reader.options.missed.is_empty() {
            return None;
        }
        let is_marked = |column: &usize| {
            let cell = self.cell(*column);
            self.reader.options.missed.iter().any(|code| match code {
                MissedCode::Text(text) => cell == text,
                MissedCode::Number(number) => self.decimal(*column).parse(cell) == Some(*number),
            })
        };
        columns().find(is_marked).map(|column| format!("{} is {}", self.header(column), self.cell(column)))
    }

    fn command(&self) -> Result<Vec<f64>, InputError> {
        // Not collected, so that no more room is taken than they need.
        let quantities = &self.reader.columns.joints;
        let mut command = Vec::with_capacity(quantities.len());
        for quantity in quantities {
            command.push(self.value(quantity)?);
        }
        Ok(command)
    }

    fn approach(&self, joints: usize) -> Result<Vec<i8>, InputError> {
        let quantities = &self.reader.columns.approach;
        if quantities.is_empty() {
            return Ok(vec![0; joints]);
        }
        let direction = |quantity: &Quantity| {
            let column = quantity.terms[0].column;
            let value = quantity.terms.iter().try_fold(0.0, |sum, term| {
                Some(sum + term.sign * self.decimal(term.column).parse(self.cell(term.column))?)
            });
            match value {
                Some(-1.0) => Ok(-1),
                Some(0.0) => Ok(0),
                Some(1.0) => Ok(1),
                _ => Err(self.refuse_cell(column, "-1, 0 or 1")),
            }
        };
        quantities.iter().map(direction).collect()
    }

    fn temperature(&self) -> Result<Option<f64>, InputError> {
        match &self.reader.columns.temperature {
            Some(quantity) if !self.is_empty(std::slice::from_ref(quantity)) => {
                Ok(Some(self.value(quantity)?))
            }
            _ => Ok(None),
        }
    }

    fn name(&self, column: Option<usize>) -> Option<&'r str> {
        column.map(|column| self.cell(column))
    }

    /// `None` for a missed shot.
    fn reading(&self) -> Result<Option<Reading>, InputError> {
        match &self.reader.columns.position {
            Position::Cartesian(axes) => {
                let mut position = Vector3::zeros();
                for (coordinate, quantity) in position.iter_mut().zip(axes) {
                    *coordinate = self.value(quantity)?;
                    self.check_size(quantity.terms[0].column, *coordinate)?;
                }
                if position == Vector3::zeros() {
                    return Ok(None);
                }
                let stated = self.covariance()?;
                let covariance = match (stated, &self.reader.columns.noise) {
                    (None, Some(noise)) => Some(noise.at(&position)),
                    (stated, _) => stated,
                };
                Ok(Some(Reading::Cartesian { position, covariance }))
            }
            Position::Spherical { range, azimuth, polar, polar_angle } => {
                let values = [self.value(range)?, self.value(azimuth)?, self.value(polar)?];
                if values.iter().all(|v| *v == 0.0) {
                    return Ok(None);
                }
                if values[0] <= 0.0 {
                    return Err(self.refuse_cell(range.terms[0].column, "a range above zero; what marks a missed shot is named by `--missed CODE`, or `missed` in [position] of the column map"));
                }
                // The standard deviation of an elevation is that of the zenith angle.
                let mut reading = SphericalReading {
                    range: values[0],
                    azimuth: values[1],
                    elevation: match polar_angle {
                        PolarAngle::Elevation => values[2],
                        PolarAngle::Zenith => std::f64::consts::FRAC_PI_2 - values[2],
                    },
                    covariance: self.covariance()?,
                    face: Face::Front,
                };
                if let (None, Some(noise)) = (&reading.covariance, &self.reader.columns.noise) {
                    match noise.of_reading(&reading) {
                        Some(own) => reading.covariance = Some(own),
                        None => {
                            let position = reading.position();
                            return Ok(Some(Reading::Cartesian {
                                position,
                                covariance: Some(noise.at(&position)),
                            }));
                        }
                    }
                }
                Ok(Some(Reading::Spherical(reading)))
            }
        }
    }

    /// `None` where the file has no columns for it, or the row nothing in them.
    fn covariance(&self) -> Result<Option<Matrix3<f64>>, InputError> {
        match &self.reader.columns.uncertainty {
            None => Ok(None),
            Some(UncertaintyColumns::Sigmas { columns, coverage }) => {
                if self.is_empty(columns) {
                    return Ok(None);
                }
                let mut variances = Vector3::zeros();
                for (variance, quantity) in variances.iter_mut().zip(columns) {
                    let sigma = self.above_zero(quantity, "standard deviation")? / coverage;
                    *variance = sigma * sigma;
                    self.check_variance(quantity.terms[0].column, *variance)?;
                }
                Ok(Some(Matrix3::from_diagonal(&variances)))
            }
            Some(UncertaintyColumns::Covariance(columns)) => {
                if self.is_empty(columns) {
                    return Ok(None);
                }
                let mut values = [0.0; 6];
                for (value, quantity) in values.iter_mut().zip(columns) {
                    *value = self.value(quantity)?;
                }
                for axis in 0..3 {
                    self.above_zero(&columns[TRIANGLE[axis][axis]], "variance")?;
                }
                let covariance = Matrix3::from_fn(|i, j| values[TRIANGLE[i][j]]);
                if covariance.cholesky().is_none() {
                    return Err(self.refuse_covariance(columns));
                }
                Ok(Some(covariance))
            }
        }
    }

    /// `what` is a measure of uncertainty.
    fn above_zero(&self, quantity: &Quantity, what: &str) -> Result<f64, InputError> {
        let number = self.value(quantity)?;
        let column = quantity.terms[0].column;
        if number == 0.0 {
            return Err(self.refuse_zero(column, what));
        }
        let expected = format!("a {what} above zero");
        if number > 0.0 { Ok(number) } else { Err(self.refuse_cell(column, &expected)) }
    }

    fn refuse_zero(&self, column: usize, what: &str) -> InputError {
        let message =
            format!("column {} is {:?}: a {what} of 0 was read", self.header(column), self.cell(column));
        let help = format!(
            "a {what} above zero, since no reading is exact: where the instrument rounds, what it rounds to or more; \
             or the cells of the row's uncertainty empty, so that it counts as not stated"
        );
        self.refuse(column, message, &help)
    }

    fn refuse_covariance(&self, columns: &[Quantity; 6]) -> InputError {
        let names: Vec<_> = columns.iter().map(|quantity| self.header(quantity.terms[0].column)).collect();
        let message = format!("the covariance of {} is not positive definite", names.join(", "));
        let expected = "correlations between -1 and 1 that do not contradict each other";
        self.refuse(columns[0].terms[0].column, message, expected)
    }

    fn check_variance(&self, column: usize, variance: f64) -> Result<(), InputError> {
        // The square of a very small number is zero.
        if variance == 0.0 {
            Err(self.refuse_zero(column, "variance"))
        } else {
            self.check_size(column, variance)
        }
    }

    fn check_size(&self, column: usize, value: f64) -> Result<(), InputError> {
        if value.is_finite() {
            Ok(())
        } else {
            Err(self.refuse_cell(column, "a number of a measurable size"))
        }
    }
}

/// Place of a symmetric matrix's element in its upper triangle by rows.
const TRIANGLE: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];

/// Place of a name among those that were named before; a new one is made.
fn index_of(known: &mut HashMap<String, usize>, name: &str, make: impl FnOnce()) -> usize {
    if let Some(index) = known.get(name) {
        return *index;
    }
    make();
    let index = known.len();
    known.insert(name.to_owned(), index);
    index
}
