//! Goals of files.

use std::path::Path;

use calibrig_files::{
    GoalFile, GoalTable, InputError, Source, StatedGoal, StatedGrid, StatedHold, StatedRaster,
    load_goal_file, read_goals as read_table,
};
use calibrig_model::geometry::Transform;
use calibrig_model::nalgebra::Vector3;

use super::super::CliError;
use crate::compensate::{GoalName, Way};
use calibrig_estimation::compensation::{
    CompensationError, GridError, GridPlan, PathError, PathPoint, Raster, RasterError, ToolPath,
};
use calibrig_estimation::inverse::Goal;

/// What is asked for.
pub(super) struct Goals {
    /// Name of the file.
    pub file: String,
    pub way: Way,
    pub names: Vec<GoalName>,
    pub grid: Option<GridPlan>,
    /// The text that contains the grid.
    grid_source: Option<Source>,
    /// What was read from the files, in words.
    pub remarks: Vec<String>,
}

impl Goals {
    /// An error of a grid, at its place in the file.
    pub fn refuse_grid(&self, error: CompensationError) -> CliError {
        let Some(source) = &self.grid_source else {
            let file = self.file.clone().into();
            return CliError::Compensation { file, source: Box::new(error), help: "expected another grid" };
        };
        let (key, help) = match &error {
            CompensationError::Grid(GridError::Count { .. }) => {
                ("grid.points", "expected three numbers of points, such as points = [3, 5, 5]")
            }
            CompensationError::Grid(GridError::Box { .. }) => {
                ("grid.low_mm", "expected a box with high_mm above low_mm along every axis")
            }
            _ => ("grid", "expected a box that the tool can reach in this orientation"),
        };
        source.error(source.place_of(key), error, Some(help.to_owned())).into()
    }
}

/// Reads what is asked for; a speed is in m/s.
pub(super) fn read_goals(
    targets: Option<&Path>,
    grid: Option<&Path>,
    speed_mm_per_s: Option<f64>,
) -> Result<Goals, CliError> {
    let speed = speed_mm_per_s.map(|speed| 1e-3 * speed);
    let mut goals = match targets {
        None => Goals {
            file: String::new(),
            way: Way::Points(Vec::new()),
            names: Vec::new(),
            grid: None,
            grid_source: None,
            remarks: Vec::new(),
        },
        Some(path) if is_toml(path) => of_toml(path, speed)?,
        Some(path) => of_table(&read_table(path)?, speed)?,
    };
    if let Some(path) = grid {
        let file = load_goal_file(path)?;
        let Some(stated) = &file.grid else {
            let help = "expected [grid] with low_mm, high_mm and points".to_owned();
            return Err(file.source.error(0..0, "the file has no [grid]", Some(help)).into());
        };
        if goals.grid.is_some() {
            let help = "expected [grid] in one of the files of --targets and --grid".to_owned();
            let place = file.source.place_of("grid");
            return Err(file.source.error(place, "[grid] is given twice", Some(help)).into());
        }
        (goals.grid, goals.grid_source) = (Some(grid_plan(stated)), Some(file.source));
        if goals.file.is_empty() {
            goals.file = path.display().to_string();
        }
    }
    Ok(goals)
}

fn is_toml(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

fn goal(position: Vector3<f64>, held: &StatedHold) -> Goal {
    match *held {
        StatedHold::Free => Goal::Position(position),
        StatedHold::Axis(direction) => Goal::Axis { position, direction },
        StatedHold::Rotation(rotation) => Goal::Pose(Transform::from_parts(position.into(), rotation)),
    }
}

fn grid_plan(stated: &StatedGrid) -> GridPlan {
    GridPlan {
        low: stated.low,
        high: stated.high,
        counts: stated.points,
        held: goal(Vector3::zeros(), &stated.held),
    }
}

fn of_toml(path: &Path, speed: Option<f64>) -> Result<Goals, CliError> {
    let GoalFile { source, raster, grid } = load_goal_file(path)?;
    let way = match &raster {
        Some(raster) => Way::Path(raster_path(&source, raster, speed)?),
        None => Way::Points(Vec::new()),
    };
    Ok(Goals {
        file: source.name.clone(),
        way,
        names: Vec::new(),
        grid: grid.as_ref().map(grid_plan),
        grid_source: grid.is_some().then_some(source),
        remarks: Vec::new(),
    })
}

fn raster_path(source: &Source, stated: &StatedRaster, speed: Option<f64>) -> Result<ToolPath, InputError> {
    let refused = |key: &str, message: String, help: &str| {
        source.error(source.place_of(key), message, Some(format!("expected {help}")))
    };
    let speed = match (stated.speed, speed) {
        (Some(_), Some(_)) => {
            return Err(refused(
                "raster.speed_mm_per_s",
                "the speed is given twice, here and by --speed-mm-per-s".to_owned(),
                "only one of them",
            ));
        }
        (Some(speed), None) | (None, Some(speed)) => speed,
        (None, None) => {
            return Err(refused(
                "raster",
                "the raster has no speed".to_owned(),
                "speed_mm_per_s of the tool's point, or --speed-mm-per-s: a raster is a path",
            ));
        }
    };
    let raster = Raster {
        corners: stated.corners,
        pitch: stated.pitch,
        spacing: stated.spacing,
        standoff: stated.standoff,
    };
    let goals = raster.goals().map_err(|error| {
        let (key, help) = match error {
            RasterError::NoPanel { .. } => (
                "raster.corners_mm",
                "corners in order around the panel, counterclockwise as the tool sees it",
            ),
            RasterError::TooMany { .. } => ("raster.spacing_mm", "a wider pitch or spacing"),
            _ => ("raster", "finite lengths"),
        };
        refused(key, error.to_string(), help)
    })?;
    ToolPath::at_speed(&goals, speed).map_err(|error| {
        let help = "a pitch and a spacing of more than a nanometre";
        refused("raster", error.to_string(), help)
    })
}

fn of_table(table: &GoalTable, speed: Option<f64>) -> Result<Goals, CliError> {
    let all: Vec<Goal> = table.goals.iter().map(|stated| goal(stated.position, &stated.held)).collect();
    let refused = |error: PathError| refuse_row(table, &error);
    let way = match (table.is_timed(), speed) {
        (true, Some(_)) => {
            let help = "either no --speed-mm-per-s, or a table without the column";
            return Err(table
                .refuse(0, "the table has times (time_s), and --speed-mm-per-s is given as well", help)
                .into());
        }
        (true, None) => {
            let point = |(goal, stated): (&Goal, &StatedGoal)| PathPoint {
                goal: *goal,
                time: stated.time.unwrap_or(f64::NAN),
            };
            let points = all.iter().zip(&table.goals).map(point).collect();
            Way::Path(ToolPath::timed(points).map_err(refused)?)
        }
        (false, Some(speed)) => Way::Path(ToolPath::at_speed(&all, speed).map_err(refused)?),
        (false, None) => Way::Points(all),
    };
    let name = |stated: &StatedGoal| GoalName {
        name: stated.name.clone(),
        place: stated.place.of(&file_name(&table.file)),
    };
    Ok(Goals {
        file: table.file.clone(),
        way,
        names: table.goals.iter().map(name).collect(),
        grid: None,
        grid_source: None,
        remarks: table.remarks.clone(),
    })
}

fn file_name(path: &str) -> String {
    Path::new(path).file_name().map_or_else(|| path.to_owned(), |name| name.to_string_lossy().into_owned())
}

/// An error of a path, at its row.
fn refuse_row(table: &GoalTable, error: &PathError) -> CliError {
    let (row, help) = match error {
        PathError::Duplicate { point } => (*point, "consecutive places that differ"),
        PathError::Time { point, .. } => (*point, "times that increase from row to row"),
        PathError::Goal { point, .. } | PathError::Kind { point, .. } => {
            (*point, "finite numbers, and the same columns in all rows")
        }
        _ => (0, "a path of two points or more, at a speed above zero"),
    };
    table.refuse(row, error, help).into()
}
