//! Where a tool is to be: tables of points (`.csv`), and TOML files that describe a raster over a panel or a grid (`calibrig.goals/1`).

use std::path::Path;

use nalgebra::{Rotation3, Vector3};
use serde::Deserialize;

use crate::input::{InputError, Source, Spanned};
use crate::measurements::Place;
use crate::orientation::{Four, OrientationKeys, Square, Three, check_numbers};

const SCHEMA: &str = "calibrig.goals/1";

/// How a tool is to be held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StatedHold {
    /// Only its point matters.
    Free,
    /// The direction of one of its axes in the base frame, of any length but zero.
    Axis(Vector3<f64>),
    /// `base_from_tool`.
    Rotation(Rotation3<f64>),
}

/// A row of a table of points.
#[derive(Debug, Clone, PartialEq)]
pub struct StatedGoal {
    /// Its name; empty where it has none.
    pub name: String,
    /// Of the tool's point in the base frame, m.
    pub position: Vector3<f64>,
    /// The same, except for the numbers, in all rows.
    pub held: StatedHold,
    /// s
    pub time: Option<f64>,
    /// Where it stands.
    pub place: Place,
}

/// A table of points.
#[derive(Debug, Clone, PartialEq)]
pub struct GoalTable {
    /// The file, as messages call it.
    pub file: String,
    /// In their order; at least one.
    pub goals: Vec<StatedGoal>,
    /// Remarks on the file, in words.
    pub remarks: Vec<String>,
}

impl GoalTable {
    /// Whether its rows have times.
    pub fn is_timed(&self) -> bool {
        self.goals.iter().any(|goal| goal.time.is_some())
    }

    /// An error at a row, from 0.
    pub fn refuse(&self, row: usize, message: impl std::fmt::Display, expected: &str) -> InputError {
        let place = self.goals.get(row).map_or_else(|| self.file.clone(), |goal| goal.place.of(&self.file));
        InputError::Place { place, message: message.to_string(), help: Some(format!("expected {expected}")) }
    }
}

/// A raster over a panel, in SI. Whether the corners form a panel is checked where it is covered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatedRaster {
    /// In order around the panel, m in the base frame.
    pub corners: [Vector3<f64>; 4],
    /// Between rows, m.
    pub pitch: f64,
    /// Between the points of a row, m.
    pub spacing: f64,
    /// Distance of the tool's point in front of the panel, m.
    pub standoff: f64,
    /// Of the tool's point, m/s; `None` if not stated.
    pub speed: Option<f64>,
}

/// A grid over a box, in SI.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatedGrid {
    /// Corner along the base's axes, m.
    pub low: Vector3<f64>,
    /// The opposite one, m.
    pub high: Vector3<f64>,
    /// Points along x, y and z.
    pub points: [usize; 3],
    /// How the tool is held everywhere.
    pub held: StatedHold,
}

/// A TOML file of goals.
#[derive(Debug, Clone, PartialEq)]
pub struct GoalFile {
    /// Its text.
    pub source: Source,
    /// `[raster]`.
    pub raster: Option<StatedRaster>,
    /// `[grid]`.
    pub grid: Option<StatedGrid>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileTable {
    schema: Spanned<String>,
    raster: Option<Spanned<RasterTable>>,
    grid: Option<Spanned<GridTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RasterTable {
    corners_mm: Spanned<Vec<[f64; 3]>>,
    pitch_mm: Spanned<f64>,
    spacing_mm: Spanned<f64>,
    standoff_mm: Option<Spanned<f64>>,
    speed_mm_per_s: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GridTable {
    low_mm: Three,
    high_mm: Three,
    points: Spanned<[u32; 3]>,
    axis: Option<Three>,
    rotation_quaternion_wxyz: Option<Four>,
    rotation_quaternion_xyzw: Option<Four>,
    rotation_vector_rad: Option<Three>,
    rotation_euler_rad: Option<Three>,
    rotation_sequence: Option<Spanned<String>>,
    rotation_matrix: Option<Square>,
}

impl RasterTable {
    fn read(&self, source: &Source) -> Result<StatedRaster, InputError> {
        let corners = self.corners_mm.get_ref();
        let place = self.corners_mm.span();
        check_numbers(source, "raster.corners_mm", place.clone(), corners.as_flattened().iter())?;
        let &[a, b, c, d] = corners.as_slice() else {
            let message = format!("raster.corners_mm has {} corners", corners.len());
            let help = "expected four corners [x, y, z] in the base frame, in order around the panel";
            return Err(source.error(place, message, Some(help.to_owned())));
        };
        let length = |key: &str, value: &Spanned<f64>| {
            source.positive(&format!("raster.{key}"), value).map(|number| number / 1e3)
        };
        Ok(StatedRaster {
            corners: [a, b, c, d].map(|corner| Vector3::from(corner) / 1e3),
            pitch: length("pitch_mm", &self.pitch_mm)?,
            spacing: length("spacing_mm", &self.spacing_mm)?,
            standoff: match &self.standoff_mm {
                Some(standoff) => source.not_negative("raster.standoff_mm", standoff)? / 1e3,
                None => 0.0,
            },
            speed: self.speed_mm_per_s.as_ref().map(|speed| length("speed_mm_per_s", speed)).transpose()?,
        })
    }
}

impl GridTable {
    fn read(&self, source: &Source) -> Result<StatedGrid, InputError> {
        let corner = |key: &str, value: &Three| {
            let key = format!("grid.{key}");
            check_numbers(source, &key, value.span(), value.get_ref().iter())?;
            Ok::<_, InputError>(Vector3::from(*value.get_ref()) / 1e3)
        };
        let rotation = OrientationKeys {
            quaternion_wxyz: self.rotation_quaternion_wxyz.as_ref(),
            quaternion_xyzw: self.rotation_quaternion_xyzw.as_ref(),
            vector_rad: self.rotation_vector_rad.as_ref(),
            euler_rad: self.rotation_euler_rad.as_ref(),
            sequence: self.rotation_sequence.as_ref(),
            matrix: self.rotation_matrix.as_ref(),
            sigma_rad: None,
            covariance_rad2: None,
        };
        let held = match (&self.axis, rotation.read(source)?) {
            (Some(axis), Some(_)) => {
                let help =
                    "expected only one of them: the direction of the tool's axis, or its full rotation"
                        .to_owned();
                return Err(source.error(axis.span(), "grid has both axis and a rotation", Some(help)));
            }
            (Some(axis), None) => {
                check_numbers(source, "grid.axis", axis.span(), axis.get_ref().iter())?;
                let direction = Vector3::from(*axis.get_ref());
                if direction.norm() == 0.0 {
                    let help = Some("expected a direction in the base frame, such as [0, 0, -1]".to_owned());
                    return Err(source.error(axis.span(), "grid.axis has length zero", help));
                }
                StatedHold::Axis(direction)
            }
            (None, Some(stated)) => StatedHold::Rotation(stated.flange_from_target),
            (None, None) => StatedHold::Free,
        };
        Ok(StatedGrid {
            low: corner("low_mm", &self.low_mm)?,
            high: corner("high_mm", &self.high_mm)?,
            points: self.points.get_ref().map(|count| count as usize),
            held,
        })
    }
}

/// Reads a TOML file of goals.
///
/// # Errors
/// [`InputError`] with the place: another schema, unknown keys, invalid numbers, and a file with neither `[raster]` nor `[grid]`.
pub fn load_goal_file(path: &Path) -> Result<GoalFile, InputError> {
    parse_goal_file(Source::read(path)?)
}

/// The same from a text in memory.
///
/// # Errors
/// As [`load_goal_file`].
pub fn parse_goal_file(source: Source) -> Result<GoalFile, InputError> {
    let file: FileTable = source.toml()?;
    if file.schema.get_ref() != SCHEMA {
        let message = format!("schema is {:?}", file.schema.get_ref());
        return Err(source.error(file.schema.span(), message, Some(format!("expected {SCHEMA:?}"))));
    }
    let raster = file.raster.map(|table| table.get_ref().read(&source)).transpose()?;
    let grid = file.grid.map(|table| table.get_ref().read(&source)).transpose()?;
    if raster.is_none() && grid.is_none() {
        let help = "expected [raster], a panel that the tool covers, or [grid], a box of points where offsets are wanted";
        return Err(source.error(0..0, "the file has neither [raster] nor [grid]", Some(help.to_owned())));
    }
    Ok(GoalFile { source, raster, grid })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "schema = \"calibrig.goals/1\"\n[raster]\ncorners_mm = [[0, 0, 0], [1000, 0, 0], [1000, 500, 0], [0, 500, 0]]\n\
                        pitch_mm = 50\nspacing_mm = 10\nstandoff_m = 0.2\nspeed_mm_per_s = 300\n\
                        [grid]\nlow_m = [0, 0, 0]\nhigh_mm = [100, 200, 300]\npoints = [2, 3, 4]\naxis = [0, 0, -1]\n";

    #[test]
    fn a_raster_and_a_grid_are_read_in_si() {
        let file = parse_goal_file(Source::new("goals.toml", FILE)).expect("sound");
        let raster = file.raster.expect("stated");
        assert_eq!((raster.corners[2], raster.speed), (Vector3::new(1.0, 0.5, 0.0), Some(0.3)));
        assert_eq!([raster.pitch, raster.spacing, raster.standoff], [0.05, 0.01, 0.2]);
        let grid = file.grid.expect("stated");
        assert_eq!((grid.high, grid.points), (Vector3::new(0.1, 0.2, 0.3), [2, 3, 4]));
        assert_eq!(grid.held, StatedHold::Axis(-Vector3::z()));
    }

    #[test]
    fn what_cannot_be_is_refused_at_its_place() {
        for (from, to, message, help) in [
            ("calibrig.goals/1", "calibrig.robot/1", "goals.toml:1: schema is", "calibrig.goals/1"),
            ("pitch_mm = 50", "pitch_mm = 0", "goals.toml:4: raster.pitch_mm is 0", "above zero"),
            ("pitch_mm = 50", "pitch = 50", "goals.toml:4: unknown key `pitch`", "pitch_mm"),
            ("spacing_mm = 10", "spacing_mm = nan", "goals.toml:5: raster.spacing_mm is nan", "finite"),
            ("standoff_m = 0.2", "standoff_m = -1", "goals.toml:6: raster.standoff_m is -1", "zero or more"),
            (", [0, 500, 0]]", "]", "goals.toml:3: raster.corners_mm has 3 corners", "four corners"),
            ("[1000, 0, 0]", "[1000, inf, 0]", "goals.toml:3: raster.corners_mm holds inf", "finite numbers"),
            (
                "axis = [0, 0, -1]",
                "axis = [0, 0, 0]",
                "goals.toml:12: grid.axis has length zero",
                "direction",
            ),
            (
                "axis = [0, 0, -1]",
                "axis = [0, 0, -1]\nrotation_vector_rad = [0, 0, 0]",
                "both axis and a rotation",
                "one of them",
            ),
            ("points = [2, 3, 4]", "points = [2, 3]", "goals.toml:11: ", "3"),
        ] {
            assert!(FILE.contains(from), "{from}");
            let error = parse_goal_file(Source::new("goals.toml", FILE.replace(from, to))).expect_err(to);
            let text = format!("{:?}", miette::Report::new(error));
            let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(text.contains(message) && text.contains(help), "{message}: {text}");
        }
        let nothing = parse_goal_file(Source::new("goals.toml", "schema = \"calibrig.goals/1\"\n"));
        assert!(nothing.expect_err("refused").to_string().contains("has neither [raster] nor [grid]"));
    }
}
