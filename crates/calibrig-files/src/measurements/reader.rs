//! From rows to observations.

mod readings;

use std::cell::Cell;
use std::collections::HashMap;
use std::fmt;

use nalgebra::Vector3;

use super::LoadedMeasurements;
use super::columns::{MissedCode, RowOptions};
use super::faces::Faces;
use super::header::{Columns, PayloadQuantities, Quantity, QuantityTerm};
use super::layout::{Column, Decimal};
use super::rows::{Place, Row};
use super::times::TimeReader;
use super::units::{TEMPERATURES, likelier_temperature};
use crate::input::InputError;
use crate::payloads::{NO_PAYLOAD, payload_by_name};
use calibrig_model::Payload;
use calibrig_model::measurement::{MeasurementSet, Motion, Observation, Reading, Station, Target};

/// Least motion of an actuator that counts as one, m or rad.
const MOTION: f64 = 1e-6;

/// Makes observations of the rows of one file.
pub(super) struct RowReader<'a> {
    pub columns: &'a Columns,
    pub options: &'a RowOptions,
    /// The file of the points.
    pub file: &'a str,
    /// All columns of joined rows.
    pub names: &'a [Column],
    /// From this column on they belong to the file of the joints, whose numbers use the second format.
    pub joints_from: usize,
    pub decimals: [Decimal; 2],
    /// The target of the whole file, if it is of one.
    pub target: Option<&'a str>,
    pub time: Option<TimeReader>,
    /// Source of the approaches.
    pub motion: Motion,
    pub faces: Faces,
    /// Largest deviation of a rotation's numbers from a rotation.
    pub rounded: Cell<f64>,
    pub rows: u32,
}

/// Names so far.
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

/// Refuses a row that is shorter or longer than the header.
pub(super) fn check_length(
    file: &str,
    row: &Row,
    names: &[Column],
    has_header: bool,
) -> Result<(), InputError> {
    let (found, expected) = (row.len(), names.len());
    // Sheets do not store empty cells.
    if found < expected && !matches!(row.place(), Place::Sheet { .. }) {
        let (missing, as_header) = if has_header {
            (names[found].header.clone(), "as the header has")
        } else {
            (format!("column {}", found + 1), "as the first row has")
        };
        let message = format!("the row has {found} of {expected} columns; {missing} is missing");
        return Err(row.refuse(file, None, message, &format!("{expected} values, {as_header}")));
    }
    match (expected..found).find(|column| row.cell(*column).is_some_and(|cell| !cell.is_empty())) {
        Some(column) => {
            let first = if has_header { "the header" } else { "the first row" };
            let message = format!("the row has {found} columns, {first} {expected}");
            let mut help =
                format!("{expected} values, as {first} has{}", if has_header { " names" } else { "" });
            if found == 2 * expected || found + 1 == 2 * expected {
                help += "; decimal commas look the same as the commas between the values: export with another delimiter";
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
        // A shot was missed where the robot had gone.
        let command = match &missed {
            Some(_) if !self.options.approach_from_order => Vec::new(),
            _ => cells.command()?,
        };
        let (approach, since_reversal) = if self.options.approach_from_order {
            self.motion.go_to(&command, MOTION);
            (self.motion.approach.clone(), self.motion.since_reversal.clone())
        } else {
            let cells = Cells { reader: self, row };
            (cells.approach(command.len())?, cells.since_reversal()?)
        };
        let cells = Cells { reader: self, row };
        let reading = match missed {
            Some(why) => Err(why),
            None => cells.reading()?.ok_or_else(|| "the position is (0, 0, 0)".to_owned()),
        };
        let mut reading = match reading {
            Ok(reading) => reading,
            Err(why) => {
                let why = format!("missed shot: {why} ({})", row.place().of(self.file));
                let pose = if self.columns.pose.is_some() { pose } else { self.rows };
                loaded.drop_row(pose, why, held_out);
                return Ok(());
            }
        };
        cells.is_like(&reading, loaded)?;
        let seen = cells.turn_to_point(&mut reading, &self.faces)?;
        let temperature = cells.temperature()?;
        let payload = cells.payload()?;
        cells.check_air()?;
        self.faces.note(seen, || row.place().of(self.file));
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
        let observation = Observation {
            pose,
            command,
            approach,
            since_reversal,
            temperature,
            time,
            station,
            target,
            payload,
            reading,
        };
        loaded.set.observations.push(observation);
        loaded.places.push(self.file, row.place());
        loaded.hold_out_last(held_out);
        Ok(())
    }
}

impl RowReader<'_> {
    /// Number and command of a pose that is not measured.
    pub fn commanded(&self, row: &Row, names: &mut Names) -> Result<(u32, Vec<f64>), InputError> {
        let cells = Cells { reader: self, row };
        let pose = self.columns.pose.map_or(Ok(self.rows), |column| cells.pose(column, names))?;
        Ok((pose, cells.command()?))
    }

    /// Remarks on the file's readings besides the rows.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = self.faces.remarks(self.file);
        let off = self.rounded.get();
        if off > 1e-6 {
            remarks.push(format!(
                "{}: rotations differ from exact ones by up to {off:.1e}, as rounding leaves them: the nearest rotations are \
                 used, with an uncertainty of about as much (rad)",
                self.file
            ));
        }
        remarks.extend(self.columns.air.iter().map(|(what, _)| {
            format!(
                "{}: {} is checked, but not used: ranges are taken as the instrument gives them",
                self.file,
                what.key()
            )
        }));
        remarks
    }

    /// Number of the pose if no column has it: that of the row, or of the first row of a stop, at which several shots or several targets are
    /// measured in sequence with the same command and payload.
    fn stop(&self, cells: &Cells<'_>, loaded: &LoadedMeasurements) -> Result<u32, InputError> {
        let last = loaded.set.observations.last().filter(|_| self.rows > 1 && cells.missed().is_none());
        let Some(last) = last else { return Ok(self.rows) };
        let command = cells.command()?;
        let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
        let stays = command.len() == last.command.len() && command.iter().zip(&last.command).all(same);
        let stays = stays && cells.payload()? == last.payload;
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
                let expected = "a number with a decimal point, as others of this file; decimal = \",\" in [text] of a column \
                                map reads decimal commas";
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
        // Minus zero leaves the sign of a zero unchanged when added to.
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
        // Tables from a spreadsheet write 3.0 for 3.
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
            "a whole number from 0 to 4294967295, the number of the pose, as in the rows before; or names in all rows"
        } else {
            "a whole number from 0 to 4294967295, the number of the pose; if the column holds names, do not use it as the \
             pose (in a column map: leave `pose` out): the rows are then counted from 1"
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
                Err(self
                    .refuse_cell(column, &format!("one of {known:?}, as [sets] of the column map states")))
            }
        }
    }

    /// Why the row is a missed shot, if its cells say so.
    fn missed(&self) -> Option<String> {
        let quantities = self.reader.columns.position.quantities();
        let columns = || quantities.iter().flat_map(|quantity| &quantity.terms).map(|term| term.column);
        let rotation = self.reader.columns.rotation.iter().flat_map(|rotation| &rotation.columns);
        let rotation = rotation.flat_map(|quantity| &quantity.terms).map(|term| term.column);
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
        columns()
            .chain(rotation)
            .find(is_marked)
            .map(|column| format!("{} is {}", self.header(column), self.cell(column)))
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

    fn since_reversal(&self) -> Result<Vec<f64>, InputError> {
        let quantities = &self.reader.columns.since_reversal;
        if self.is_empty(quantities) {
            return Ok(Vec::new());
        }
        let way = |quantity: &Quantity| {
            let value = self.value(quantity)?;
            let expected = "zero or more: how far the actuator has moved since it last reversed";
            if value >= 0.0 { Ok(value) } else { Err(self.refuse_cell(quantity.terms[0].column, expected)) }
        };
        quantities.iter().map(way).collect()
    }

    fn temperature(&self) -> Result<Option<f64>, InputError> {
        let Some(quantity) = &self.reader.columns.temperature else { return Ok(None) };
        if self.is_empty(std::slice::from_ref(quantity)) {
            return Ok(None);
        }
        let stated = self.reader.columns.temperature_unit;
        let value = self.value(quantity)?;
        let temperature = stated.in_celsius(value);
        let [least, most] = TEMPERATURES;
        if (least..=most).contains(&temperature) {
            return Ok(Some(temperature));
        }
        let hint = likelier_temperature(value, stated).map_or_else(String::new, |unit| {
            let (sign, key) = (unit.sign(), unit.key());
            format!("; as {sign} it is possible: then the key in a column map is temperature_{key}")
        });
        let expected = format!(
            "a temperature from {least} to {most} °C, but the column is read in {}{hint}",
            stated.sign()
        );
        Err(self.refuse_cell(quantity.terms[0].column, &expected))
    }

    /// What the flange carries; `None` if the row states nothing, or nothing with a weight.
    fn payload(&self) -> Result<Option<Payload>, InputError> {
        match &self.reader.columns.payload {
            None => Ok(None),
            Some(PayloadQuantities::Named { column, known }) => {
                let names = known.iter().map(|payload| payload.name.as_str());
                match payload_by_name(self.cell(*column), names) {
                    Ok(index) => Ok(index.map(|index| known[index].clone())),
                    Err(expected) => Err(self.refuse_cell(*column, &expected)),
                }
            }
            Some(PayloadQuantities::Numbers { name, mass, centre, force }) => {
                let name = self.name(*name).unwrap_or_default();
                let weighed = mass.terms[0].column;
                if self.is_empty(std::slice::from_ref(mass)) {
                    let rest = self.is_empty(centre) && self.is_empty(force);
                    if rest && (name.is_empty() || name == NO_PAYLOAD) {
                        return Ok(None);
                    }
                    let expected = "the mass in kg of the payload that this row describes; or an empty payload in this row";
                    return Err(self.refuse_cell(weighed, expected));
                }
                let kg = self.value(mass)?;
                if kg < 0.0 {
                    return Err(self.refuse_cell(weighed, "a mass of zero or more, kg"));
                }
                if kg == 0.0 && self.is_empty(centre) && self.is_empty(force) {
                    return Ok(None);
                }
                let vector = |quantities: &[Quantity]| -> Result<Vector3<f64>, InputError> {
                    let mut vector = Vector3::zeros();
                    for (value, quantity) in vector.iter_mut().zip(quantities) {
                        *value = self.value(quantity)?;
                    }
                    Ok(vector)
                };
                let name = if name.is_empty() { format!("{kg} kg") } else { name.to_owned() };
                let force = if self.is_empty(force) { Vector3::zeros() } else { vector(force)? };
                Ok(Some(Payload { name, mass: kg, centre: vector(centre)?, force }))
            }
        }
    }

    /// Refuses an impossible pressure or humidity. They are not used: ranges are those of the instrument, which corrects for the air.
    fn check_air(&self) -> Result<(), InputError> {
        for (what, quantity) in &self.reader.columns.air {
            if self.is_empty(std::slice::from_ref(quantity)) {
                continue;
            }
            if let Some(expected) = what.refused(self.value(quantity)?) {
                return Err(self.refuse_cell(quantity.terms[0].column, &expected));
            }
        }
        Ok(())
    }

    /// Refuses a point among full poses, and a full pose among points.
    fn is_like(&self, reading: &Reading, loaded: &LoadedMeasurements) -> Result<(), InputError> {
        let is_pose = |reading: &Reading| matches!(reading, Reading::Pose(_));
        let Some(first) = loaded.set.observations.first() else { return Ok(()) };
        if is_pose(&first.reading) == is_pose(reading) {
            return Ok(());
        }
        let (this, other) =
            if is_pose(reading) { ("a full pose", "a point") } else { ("a point", "a full pose") };
        let place = loaded.places.of(0).unwrap_or_default();
        let message = format!("this row is {this}, but {place} is {other}");
        let expected = "either full poses or points in one set: write them to two files and identify from each separately";
        Err(self.row.refuse(self.reader.file, None, message, expected))
    }

    fn name(&self, column: Option<usize>) -> Option<&'r str> {
        column.map(|column| self.cell(column))
    }
}

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
