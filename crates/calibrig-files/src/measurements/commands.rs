//! Poses of a file, measured or not: for a plan.

use std::cell::Cell;

use super::columns::{ColumnMap, FilePart, PositionColumns, RowOptions, Sets};
use super::faces::Faces;
use super::files::parse_measurements;
use super::header::{Columns, FileColumns, Head, Position, Quantity};
use super::layout::Table;
use super::reader::{Names, RowReader, check_length};
use super::rows::Row;
use super::text::TextRows;
use super::units::TemperatureUnit;
use crate::input::{InputError, Source};
use calibrig_model::JointKind;
use calibrig_model::measurement::Motion;

/// Number and command (m or rad, one per actuator) of the pose of every row. A file with columns of positions is read as
/// [`parse_measurements`](super::parse_measurements) does; without them, as in a plan, only the commands are required.
///
/// # Errors
///
/// [`InputError`], for a column of commands that is missing, a cell that is not a finite number, and a file without a row.
pub fn parse_commands(
    source: &Source,
    map: &ColumnMap,
    joints: &[JointKind],
) -> Result<Vec<(u32, Vec<f64>)>, InputError> {
    let wanted = map.wanted(joints, FilePart::Whole);
    let rows = Box::new(TextRows::of_text(&source.name, &source.text, &map.format().0, &wanted)?);
    let mut table = Table::find(rows, &wanted, map.format().1)?;
    let (head_row, own) = (table.head.clone(), table.columns.clone());
    let file =
        FileColumns { name: &source.name, head: &head_row, has_header: table.has_header, columns: &own };
    let header: Vec<&str> = own.iter().flat_map(|column| [column.header.as_str(), column.name()]).collect();
    let mapping = map.resolve(&header, joints);
    let mapping = mapping.map_err(|message| file.refuse(message, "calibrig's own columns"))?;
    let position = match &mapping.position {
        PositionColumns::Cartesian { axes, .. } => axes.each_ref(),
        PositionColumns::Spherical { range, azimuth, polar, .. } => [range, azimuth, polar],
    };
    let is_there = |name: &str| header.contains(&name);
    if position.iter().any(|entry| entry.names().any(is_there) || entry.numbers().next().is_some()) {
        let measured = parse_measurements(source, map, joints)?.set.observations;
        return Ok(measured.into_iter().map(|observation| (observation.pose, observation.command)).collect());
    }
    let mut head = Head::new(file, None, map.source());
    let columns = unmeasured(head.commands(&mapping, joints)?, head.optional(mapping.pose.as_ref())?);
    let options = RowOptions::default();
    let mut reader = RowReader {
        columns: &columns,
        options: &options,
        file: &source.name,
        names: &own,
        joints_from: own.len(),
        decimals: [table.decimal; 2],
        target: None,
        time: None,
        motion: Motion::default(),
        faces: Faces::default(),
        rounded: Cell::new(0.0),
        rows: 0,
    };
    let (mut row, mut names, mut commands) = (Row::default(), Names::default(), Vec::new());
    while table.next_row(&mut row)? {
        check_length(&source.name, &row, &own, table.has_header)?;
        row.resize(own.len());
        reader.rows = reader.rows.saturating_add(1);
        commands.push(reader.commanded(&row, &mut names)?);
    }
    if commands.is_empty() {
        return Err(file.refuse("there are no poses below the header", "one row of numbers per pose"));
    }
    Ok(commands)
}

/// Columns of which none is measured.
fn unmeasured(joints: Vec<Quantity>, pose: Option<usize>) -> Columns {
    let nothing = || Quantity { terms: Vec::new(), is_uniform: true };
    Columns {
        joints,
        position: Position::Cartesian([nothing(), nothing(), nothing()]),
        rotation: None,
        uncertainty: None,
        noise: None,
        pose,
        names_poses: false,
        station: None,
        target: None,
        time: None,
        temperature: None,
        temperature_unit: TemperatureUnit::C,
        air: Vec::new(),
        face: None,
        approach: Vec::new(),
        payload: None,
        since_reversal: Vec::new(),
        sets: Sets::default(),
        set: None,
    }
}
