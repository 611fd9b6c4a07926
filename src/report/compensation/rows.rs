//! Tables of corrected commands. Every number reads back to the same bits.

use crate::compensate::{Actuator, Compensation, Corrected, End};
use crate::report::files::ReportError;
use calibrig_estimation::compensation::{CompensatedPoint, CorrectionGrid};
use calibrig_estimation::inverse::Goal;
use calibrig_model::JointKind;

fn exact(number: f64) -> String {
    format!("{number:?}")
}

/// Cells of numbers, or as many empty ones.
fn cells(numbers: Option<Vec<f64>>, count: usize) -> Vec<String> {
    numbers.map_or_else(|| vec![String::new(); count], |all| all.into_iter().map(exact).collect())
}

fn text(writer: csv::Writer<Vec<u8>>) -> Result<String, ReportError> {
    let bytes = writer.into_inner().map_err(|error| csv::Error::from(error.into_error()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn commanded(made: &Compensation) -> impl Iterator<Item = (usize, &Actuator)> {
    made.actuators.iter().enumerate().filter(|(_, actuator)| actuator.is_commanded)
}

/// How a goal holds the tool, with names of its columns.
fn held(goal: &Goal) -> (Vec<String>, Vec<f64>) {
    match goal {
        Goal::Position(_) => (Vec::new(), Vec::new()),
        Goal::Axis { direction, .. } => {
            (["axis_x", "axis_y", "axis_z"].map(str::to_owned).to_vec(), direction.as_slice().to_vec())
        }
        Goal::Pose(pose) => {
            let names = (1..=3).flat_map(|row| (1..=3).map(move |column| format!("r{row}{column}")));
            (names.collect(), pose.rotation.matrix().transpose().as_slice().to_vec())
        }
    }
}

/// The text of `compensated.csv`: a row a goal, lengths in mm and angles in deg.
pub fn compensated_csv(made: &Compensation) -> Result<String, ReportError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut header: Vec<String> =
        ["point", "name", "status", "marks", "time_s", "x_mm", "y_mm", "z_mm"].map(str::to_owned).to_vec();
    let first = made.points.first();
    header.extend(first.map(|point| held(&point.goal).0).unwrap_or_default());
    for prefix in ["nominal", "q"] {
        header.extend(
            commanded(made)
                .zip(1..)
                .map(|((_, actuator), number)| format!("{prefix}{number}_{}", actuator.unit())),
        );
    }
    header.extend(commanded(made).zip(1..).map(|(_, number)| format!("approach{number}")));
    let rest = [
        "before_x_mm",
        "before_y_mm",
        "before_z_mm",
        "before_mm",
        "left_um",
        "left_urad",
        "sigma_x_mm",
        "sigma_y_mm",
        "sigma_z_mm",
        "sigma_mm",
        "limits",
        "extrapolated",
        "note",
    ];
    header.extend(rest.map(str::to_owned));
    writer.write_record(&header)?;
    for (index, point) in made.points.iter().enumerate() {
        writer.write_record(row(made, index, point))?;
    }
    text(writer)
}

fn row(made: &Compensation, index: usize, point: &Corrected) -> Vec<String> {
    let found = point.point.as_ref();
    let position = point.goal.position();
    let marks: Vec<&str> = [
        (point.is_too_fast, "too_fast"),
        (point.is_untrusted, "unsure"),
        (!point.beyond.is_empty(), "extrapolated"),
        (point.wavers, "wavers"),
    ]
    .into_iter()
    .filter_map(|(is, mark)| is.then_some(mark))
    .collect();
    let mut row = vec![
        (index + 1).to_string(),
        point.name.name.clone(),
        point.end.key().to_owned(),
        marks.join(" "),
        point.time.map_or_else(String::new, exact),
    ];
    row.extend(position.iter().map(|v| exact(1e3 * v)));
    row.extend(held(&point.goal).1.into_iter().map(exact));
    let commands = commanded(made).count();
    for of in [|p: &CompensatedPoint| p.nominal.clone(), |p: &CompensatedPoint| p.command.clone()] {
        let shown = |values: Vec<f64>| {
            commanded(made)
                .map(|(actuator, known)| known.shown(values.get(actuator).copied().unwrap_or(f64::NAN)))
                .collect()
        };
        row.extend(cells(found.map(of).map(shown), commands));
    }
    for (actuator, _) in commanded(made) {
        let side = found.and_then(|found| found.approach.get(actuator).copied());
        row.push(found.map_or_else(String::new, |_| side.unwrap_or(0).to_string()));
    }
    let before = found.map(|found| {
        let off = 1e3 * found.uncompensated;
        vec![off.x, off.y, off.z, off.norm()]
    });
    row.extend(cells(before, 4));
    row.extend(cells(found.map(|found| vec![1e6 * found.missed(), 1e6 * point.left_angle]), 2));
    let sigma = found.and_then(CompensatedPoint::sigma).zip(point.sigma());
    row.extend(cells(
        sigma.map(|(along, space)| [along.x, along.y, along.z, space].map(|v| 1e3 * v).to_vec()),
        4,
    ));
    let limits =
        found.map(|found| found.limits.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "));
    row.push(limits.unwrap_or_default());
    row.push(beyond_words(made, point));
    row.push(match &point.end {
        End::Met | End::Jumped => String::new(),
        End::Unreachable(told) => told.to_string(),
        End::Failed(why) => why.clone(),
    });
    row
}

/// "A1 3.2 deg above; A3 0.1 deg below".
fn beyond_words(made: &Compensation, point: &Corrected) -> String {
    let words = point.beyond.iter().filter_map(|beyond| {
        let actuator = made.actuators.get(beyond.actuator)?;
        let side = if beyond.by > 0.0 { "above" } else { "below" };
        Some(format!("{} {:.3} {} {side}", actuator.name, actuator.shown(beyond.by.abs()), actuator.unit()))
    });
    words.collect::<Vec<_>>().join("; ")
}

/// The text of `commands.csv`: corrected commands in calibrig's own columns, for goals that have one.
pub fn commands_csv(made: &Compensation) -> Result<String, ReportError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let has_sides = made.corrected().any(|(_, found)| !found.approach.is_empty());
    let mut header = vec!["pose".to_owned()];
    header.extend(commanded(made).zip(1..).map(|((_, actuator), number)| {
        format!("q{number}_{}", if actuator.kind == JointKind::Revolute { "rad" } else { "m" })
    }));
    if made.is_path {
        header.push("time_s".to_owned());
    }
    if has_sides {
        header.extend(commanded(made).zip(1..).map(|(_, number)| format!("approach{number}")));
    }
    writer.write_record(&header)?;
    for (index, point) in made.points.iter().enumerate() {
        let Some(found) = &point.point else { continue };
        let mut row = vec![(index + 1).to_string()];
        row.extend(
            commanded(made)
                .map(|(actuator, _)| exact(found.command.get(actuator).copied().unwrap_or(f64::NAN))),
        );
        if made.is_path {
            row.push(point.time.map_or_else(String::new, exact));
        }
        if has_sides {
            row.extend(
                commanded(made)
                    .map(|(actuator, _)| found.approach.get(actuator).copied().unwrap_or(0).to_string()),
            );
        }
        writer.write_record(&row)?;
    }
    text(writer)
}

/// The text of `grid.csv`: a row a point, x fastest; offsets are empty where the robot does not reach.
pub fn grid_csv(grid: &CorrectionGrid) -> Result<String, ReportError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(["x_mm", "y_mm", "z_mm", "offset_x_mm", "offset_y_mm", "offset_z_mm"])?;
    for (place, offset) in grid.places().zip(&grid.offsets) {
        let mut row: Vec<String> = place.iter().map(|v| exact(1e3 * v)).collect();
        row.extend(cells(offset.map(|offset| offset.iter().map(|v| 1e3 * v).collect()), 3));
        writer.write_record(&row)?;
    }
    text(writer)
}
