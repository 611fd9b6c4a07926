//! Where a tool is to be, and estimates that are handed over: read, and corrected for.

use std::ops::ControlFlow;
use std::sync::LazyLock;

use calibrig::compensate::{CompensationPlan, Way, compensate};
use calibrig::compensation::{PathOptions, Raster, ToolPath};
use calibrig::files::{GoalFile, GoalTable, Source, StatedHold, parse_goal_file, parse_goals};
use calibrig::geometry::Transform;
use calibrig::handover::EstimateFile;
use calibrig::inverse::{Goal, InverseOptions, Tool};
use calibrig::kinematics::target_in_base;
use calibrig::report::{commands_csv, compensated_csv, compensation_html, compensation_json_text};

use super::choices::Choices;
use super::edit::{Seed, text};

static TABLES: LazyLock<Vec<Seed>> = LazyLock::new(|| {
    let texts = [include_str!("../seeds/goals.csv"), include_str!("../seeds/turned.csv")];
    texts.map(Seed::table).into()
});
static FILES: LazyLock<Vec<Seed>> = LazyLock::new(|| vec![Seed::toml(include_str!("../seeds/goals.toml"))]);
static ESTIMATES: LazyLock<Vec<Seed>> =
    LazyLock::new(|| vec![Seed::json(include_str!("../seeds/estimate.json"))]);
static SOUND: LazyLock<EstimateFile> = LazyLock::new(|| {
    EstimateFile::parse(&Source::new("estimate.json", &*ESTIMATES[0].text)).expect("as it was written")
});

/// Tables of points, rasters and grids.
pub fn goals(data: &[u8]) {
    let choices = &mut Choices::new(data);
    if choices.below(2) == 0 {
        let text = text(choices, &TABLES);
        if let Ok(table) = parse_goals(&Source::new("goals.csv", text)) {
            use_table(&table, choices);
        }
        return;
    }
    let text = text(choices, &FILES);
    read_goal_file(text, choices);
}

pub fn goal_files() -> &'static [Seed] {
    &FILES
}

pub fn read_goal_file(text: String, choices: &mut Choices<'_>) {
    let Ok(GoalFile { raster, grid, .. }) = parse_goal_file(Source::new("goals.toml", text)) else { return };
    if let Some(stated) = raster {
        let raster = Raster {
            corners: stated.corners,
            pitch: stated.pitch,
            spacing: stated.spacing,
            standoff: stated.standoff,
        };
        // A million points of a raster are allowed, and too many here.
        let size = raster.corners.iter().map(calibrig::nalgebra::Matrix::norm).fold(0.0, f64::max);
        if size < 1e4 * stated.spacing.min(stated.pitch)
            && size < 30.0 * stated.pitch
            && size < 30.0 * stated.spacing
            && let Ok(goals) = raster.goals()
        {
            assert!(goals.iter().all(|goal| goal.check().is_ok()), "{stated:?}");
            correct(Way::Points(goals.into_iter().take(1).collect()), &SOUND, choices);
        }
    }
    if let Some(grid) = grid {
        assert!(grid.low.iter().chain(grid.high.iter()).all(|v| v.is_finite()), "{grid:?}");
    }
}

fn use_table(table: &GoalTable, choices: &mut Choices<'_>) {
    let goal = |stated: &calibrig::files::StatedGoal| match stated.held {
        StatedHold::Free => Goal::Position(stated.position),
        StatedHold::Axis(direction) => Goal::Axis { position: stated.position, direction },
        StatedHold::Rotation(rotation) => Goal::Pose(Transform::from_parts(stated.position.into(), rotation)),
    };
    let goals: Vec<Goal> = table.goals.iter().take(2).map(goal).collect();
    for goal in &goals {
        assert!(goal.check().is_ok(), "{goal:?}");
    }
    drop(ToolPath::at_speed(&goals, 0.1));
    correct(Way::Points(goals.into_iter().take(1).collect()), &SOUND, choices);
}

/// An estimate as it is handed over.
pub fn estimate(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let text = text(choices, &ESTIMATES);
    if let Ok(estimate) = EstimateFile::parse(&Source::new("estimate.json", text)) {
        assert!(estimate.text().is_ok());
        let model = &estimate.estimate.robot.nominal;
        let middle = model.kinematics.links.iter().map(|link| {
            let [low, high] = link.limits.map(|limit| limit.clamp(-3.0, 3.0));
            0.5 * (low + high)
        });
        let joints: Vec<f64> = middle.collect();
        if let Ok(place) = target_in_base(&model.kinematics, &joints, &calibrig::nalgebra::Vector3::zeros()) {
            correct(Way::Points(vec![Goal::Position(place)]), &estimate, choices);
        }
    }
}

/// What is told of a corrected command is finite, or nothing.
fn correct(way: Way, estimate: &EstimateFile, choices: &mut Choices<'_>) {
    let Ok(tool) = Tool::at(estimate.estimate.robot.targets.first().copied().unwrap_or_default()) else {
        return;
    };
    let inverse = InverseOptions { starts: 2, ..InverseOptions::default() };
    let plan = CompensationPlan {
        file: "goals.csv".to_owned(),
        way,
        names: Vec::new(),
        tool,
        tool_name: String::new(),
        options: PathOptions { inverse, ..PathOptions::default() },
        trust: Some(1e-3),
        grid: None,
    };
    let Ok(made) = compensate(estimate, &plan, &mut |_, _, _| ControlFlow::Continue(())) else { return };
    for (_, point) in made.corrected() {
        assert!(point.command.iter().all(|value| value.is_finite()), "{point:?}");
        assert!(point.missed().is_finite(), "{point:?}");
    }
    assert!(compensation_json_text(&made).is_ok());
    if choices.one_in(8) {
        assert!(compensated_csv(&made).is_ok() && commands_csv(&made).is_ok());
        assert!(compensation_html(&made).is_ok());
    }
}
