//! Column maps: `columns.toml`.
//!
//! ```toml
//! schema = "calibrig.columns/1"
//!
//! [joints]
//! columns = ["A1", "A2", "A3 + A2"] # what was commanded: an entry an actuator, in the robot's order
//! revolute_unit = "deg"             # deg, rad, mrad, urad, arcsec, gon or rev; needed where the robot has a revolute joint and the header states none
//! prismatic_unit = "mm"             # mm, m, um, cm or inch; needed where it has a prismatic one and the header states none
//!
//! [position]                        # of the target, in the tracker's frame
//! system = "cartesian"
//! unit = "mm"                       # as prismatic_unit
//! x = "x_target - x_error"          # an entry: a column, a signed sum, or a list of columns to add
//! y = ["y_target", "-y_error"]
//! z = 7                             # the seventh column; in a sum #7
//! missed = [-9999, "n/a"]           # optional: marks of a missed shot in the position, in addition to (0, 0, 0)
//! # or: system = "spherical", range = "R", range_unit = "m", azimuth = "Az", angle_unit = "deg" (rad, mrad, urad, arcsec, gon or rev), and
//! # either elevation = "El" (above the tracker's x-y plane) or zenith = "Ze" (from its z axis)
//!
//! [sigma]                           # optional: standard deviations above 0, in the system of the position
//! unit = "um"                       # spherical: range_unit and angle_unit
//! x = "sx"                          # spherical: range, azimuth, and elevation or zenith
//! y = "sy"
//! z = "sz"
//! k = 2                             # optional: coverage factor; the columns state k standard deviations, as U(95) does
//!
//! [rotation]                        # optional: of a target with axes of its own, whose rows are full poses
//! transform = "target_in_tracker"   # which frame is given in which; or "tracker_in_target"
//! form = "quaternion"               # rotation_vector, euler, matrix; kuka_abc, abb_quaternion, fanuc_wpr, ur_rotation_vector, staubli_rxryrz, kawasaki_oat
//! order = "wxyz"                    # of a quaternion, or "xyzw"; of a matrix "rows" or "columns"; an euler form has sequence = "zyx intrinsic" or "xyz fixed"
//! columns = ["qw", "qx", "qy", "qz"]
//! sigma = ["srx", "sry", "srz"]     # optional: standard deviations about the tracker's axes, or one for all; sigma_unit, k
//!
//! # instead of the sigmas of a full pose, [covariance] with columns (21: the upper triangle by rows, position before rotation; or all 36),
//! # unit = "mm" and angle_unit = "rad"
//!
//! [noise]                           # optional: standard deviations a + b R of rows that state none
//! range_um = 2                      # a along the line of sight; range_um_per_m: b
//! transverse_um = 5                 # a across it
//! transverse_um_per_m = 1.5         # b
//! rotation_urad = 30                # of full poses: about every axis
//!
//! # of spherical positions [face], optional: column = "Face", front = ["1"] and back = ["2"], its texts (default "front" and "back"), and
//! # angles = "raw", back-face angles as the encoders show them, or "direction", as in the front face; found from the values by default
//!
//! [columns]                         # each optional
//! pose = "No"                       # whole numbers, or names
//! station = "Station"
//! target = "SMR"                    # the reflector, the same name in all its rows; not the name of the shot
//! time_s = "t"
//! temperature_c = "T"               # or temperature_k, temperature_f
//! pressure_hpa = "P"                # or pressure_pa, _kpa, _mmhg, _inhg; checked, but not used
//! humidity_percent = "H"            # the same
//! approach = ["dir1", "dir2", "dir3"]  # -1, 0 or 1, one per actuator
//! payload = "Load"                  # the name of a [[payload]]; empty, "none" or 0 if the flange carries nothing
//! # or numbers: payload_mass_kg = "m", and payload_x_mm, payload_y_mm, payload_z_mm: its centre of mass in the flange frame; optionally
//! # payload_force_x_n, payload_force_y_n, payload_force_z_n: a force in the base frame that acts there
//!
//! [[payload]]                       # optional: a load on the flange that some rows name
//! name = "25 kg"
//! mass_kg = 25.02
//! x_mm = 0                          # its centre of mass in the flange frame, where a force acts as well
//! y_mm = 0
//! z_mm = 118
//! # force_x_n = 0, force_y_n and force_z_n, of the base frame
//!
//! [rows]                            # each optional
//! approach_from = "order"           # signs of approach from the order of the rows
//! repeats = "average"               # repeats of a pose are averaged into one reading
//! faces = "average"                 # a front-face and a back-face reading are averaged into one
//!
//! [sets]                            # optional: which rows are held out
//! column = "use"
//! identification = ["fit"]
//! verification = ["check"]
//!
//! [join]                            # optional: if joints and points are in separate files (--joints)
//! by = "name"                       # row, name or time
//! joints = "Name"                   # the column in the joints' file
//! points = "Point"                  # and in the points' files
//!
//! [text]                            # optional, each key: the form of a text file, if it is not detected
//! decimal = ","
//! ```

mod coordinates;
mod entries;
mod form;
mod payload;
mod pose;
mod tables;

use std::fmt;
use std::ops::Range;
use std::path::Path;

use self::entries::RawEntry;
use self::tables::{ApproachFrom, CoordinateTable, MapFile, Repeats};
use super::columns::{ColumnMap, Mapping, MissedCode, RowChoices};
use super::layout::TableFormat;
use crate::input::{InputError, Source, Spanned};

const SCHEMA: &str = "calibrig.columns/1";

/// Reads a column map, with the text that it was read from.
pub fn load_column_map(path: &Path) -> Result<(ColumnMap, Source), InputError> {
    let source = Source::read(path)?;
    Ok((parse_column_map(&source)?, source))
}

/// Marks what a suggested map leaves to a person, in front of the placeholder.
pub(super) const UNDECIDED: &str = "# DECIDE: ";

/// Refuses a map in which something is still to be decided.
fn undecided(source: &Source) -> Result<(), InputError> {
    let mut start = 0;
    for line in source.text.split_inclusive('\n') {
        if let Some(open) = line.trim_start().strip_prefix(UNDECIDED) {
            let key = open.split('=').next().unwrap_or_default().trim();
            let at = start + line.len() - line.trim_start().len();
            let help = format!(
                "expected `{key} = ...` with the right value in place of {:?}, and without the # in front of its table; or \
                 delete this line if it is not wanted",
                UNDECIDED.trim()
            );
            return Err(source.error(
                at..at + line.trim().len(),
                format!("{key} is still to be decided"),
                Some(help),
            ));
        }
        start += line.len();
    }
    Ok(())
}

/// Reads a column map from a text in memory.
pub fn parse_column_map(source: &Source) -> Result<ColumnMap, InputError> {
    undecided(source)?;
    let file: MapFile = source.toml().map_err(with_the_table_of_a_stray_key)?;
    if file.schema.get_ref() != SCHEMA {
        let message = format!("schema is {:?}", file.schema.get_ref());
        return Err(source.error(file.schema.span(), message, Some(format!("expected {SCHEMA:?}"))));
    }
    let reader = Reader { source };
    let (position, polar) = reader.position(&file.position)?;
    let joints = file.joints.get_ref();
    let columns = reader.entries(&joints.columns)?;
    if columns.is_empty() {
        return Err(reader.error(file.joints.span(), "[joints] names no columns", "one column per joint"));
    }
    let approach = match &file.columns.approach {
        Some(list) => reader.entries(list)?,
        None => Vec::new(),
    };
    if let Some(list) = &file.columns.approach
        && approach.len() != columns.len()
    {
        let message =
            format!("approach names {} columns, but [joints] names {}", approach.len(), columns.len());
        return Err(reader.error(list.span(), message, "one column per actuator"));
    }
    let approach_from_order = matches!(file.rows.approach_from, Some(ApproachFrom::Order));
    if let Some(list) = file.columns.approach.as_ref().filter(|_| approach_from_order) {
        let message = "approach names columns, but [rows] has approach_from as well";
        return Err(reader.error(list.span(), message, "only one of them"));
    }
    let optional = |entry: Option<&Spanned<RawEntry>>| entry.map(|entry| reader.single(entry)).transpose();
    let rest = &file.columns;
    let (time, time_unit) = reader.time(rest)?;
    let (temperature, temperature_unit) = reader.temperature(rest)?;
    let uncertainty = file.sigma.as_ref().map(|sigma| reader.sigmas(sigma, polar)).transpose()?;
    let of_pose = reader.pose(&file, &position, uncertainty)?;
    let mapping = Mapping {
        joints: columns,
        revolute: joints.revolute_unit,
        prismatic: joints.prismatic_unit,
        face: file.face.as_ref().map(|face| reader.face(face, &position)).transpose()?,
        position,
        rotation: of_pose.rotation,
        uncertainty: of_pose.uncertainty,
        noise: of_pose.noise,
        pose: optional(rest.pose.as_ref())?,
        station: optional(rest.station.as_ref())?,
        target: optional(rest.target.as_ref())?,
        time,
        time_unit,
        temperature,
        temperature_unit,
        air: reader.air(rest)?,
        approach,
        payload: reader.payload(rest, &file.payload)?,
        since_reversal: Vec::new(),
        rows: RowChoices {
            missed: missed(file.position.get_ref()),
            approach_from_order,
            average_repeats: file.rows.repeats == Repeats::Average,
            average_faces: file.rows.faces == Repeats::Average,
        },
        sets: file.sets.as_ref().map(|sets| reader.sets(sets)).transpose()?.unwrap_or_default(),
        join: file.join.as_ref().map(|join| reader.join(join)).transpose()?,
        text: reader.text(&file.text)?,
        table: TableFormat {
            decimal: reader.decimal(&file.text)?,
            date: reader.date(&file.text)?,
            header: file.text.header,
        },
    };
    Ok(ColumnMap::new(mapping, source.clone()))
}

/// Says for an unknown key in which table it is known.
fn with_the_table_of_a_stray_key(mut error: InputError) -> InputError {
    const TABLES: [(&str, &[&str]); 9] = [
        ("[joints]", &["revolute_unit", "prismatic_unit"]),
        ("[position]", &["missed", "unit", "system", "range_unit", "angle_unit"]),
        ("[sigma]", &["k"]),
        (
            "[columns]",
            &[
                "pose",
                "station",
                "time_s",
                "time_ms",
                "time_us",
                "time_ns",
                "temperature_c",
                "temperature_k",
                "temperature_f",
                "pressure_hpa",
                "humidity_percent",
                "approach",
                "payload_mass_kg",
                "payload_x_mm",
                "payload_y_mm",
                "payload_z_mm",
                "payload_force_x_n",
                "payload_force_y_n",
                "payload_force_z_n",
            ],
        ),
        ("[rows]", &["approach_from", "repeats", "faces"]),
        ("[rotation]", &["transform", "form", "order", "sequence", "sigma_unit"]),
        ("[face]", &["front", "back", "angles"]),
        ("[sets]", &["identification", "verification", "verification_poses"]),
        ("[text]", &["delimiter", "decimal", "date", "header", "comments", "skip_lines", "widths"]),
    ];
    let InputError::Invalid { message, help: Some(help), .. } = &mut error else { return error };
    let Some(key) = message.strip_prefix("unknown key `").and_then(|rest| rest.strip_suffix('`')) else {
        return error;
    };
    if key == "target" {
        help.push_str(
            "; the column with the targets' names is `target` in [columns]; the targets' places on the flange belong in the \
             robot's file ([target], [[target]]) or in a session file",
        );
    } else if let Some((table, _)) = TABLES.iter().find(|(_, keys)| keys.contains(&key)) {
        help.push_str("; it belongs in ");
        help.push_str(table);
    }
    error
}

fn missed(position: &CoordinateTable) -> Vec<MissedCode> {
    let codes = position.missed.iter().flat_map(|codes| &codes.get_ref().0);
    codes.map(|code| MissedCode::parse(code)).collect()
}

struct Reader<'a> {
    source: &'a Source,
}

impl Reader<'_> {
    fn error(&self, span: Range<usize>, message: impl fmt::Display, expected: &str) -> InputError {
        self.source.error(span, message, Some(format!("expected {expected}")))
    }
}

#[cfg(test)]
mod tests;
