//! `calibrig iso9283`.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};

use super::identify::{Loaded, load};
use super::interrupt::stop_on_interrupt;
use super::measured::RowArgs;
use super::model::ChainArgs;
use super::montecarlo::Plant;
use super::output::{self, Destination, Files};
use super::{CliError, Verdict, colours, not_identified, print, read_scenario, say};
use crate::pipeline::{
    InputSummary, Iso9283Failure, Iso9283Outcome, Iso9283Plan, ReachError, iso9283_of_scenario,
    iso9283_of_set,
};
use crate::report;
use calibrig_estimation::evaluation::iso9283::{CubePlane, ISO_CYCLES, Iso9283Error};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::nalgebra::Vector3;

/// Measure pose accuracy and repeatability as in ISO 9283: on a simulated machine, or from a file of measured cycles
///
/// With a scenario, the machine drives 30 cycles over five poses in an inclined plane of a cube, after its session and in front of the same tracker.
/// Accuracy is given relative to what the robot without calibration predicts (with the tracker placed by the base nests, and by a best fit), and
/// relative to the identified robots. With a file, rows with the same command are the cycles of a pose.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig iso9283 scenarios/paper.toml
  calibrig iso9283 scenarios/paper.toml --cycles 10 --cube-mm 300 --out iso --json
  calibrig iso9283 --model robot.toml --measurements cycles.csv --session session.toml
  calibrig iso9283 --model robot.toml --measurements cycles.csv --columns map.toml --target A

Fewer than 30 cycles are accepted with a warning. Exit code 3 if an identified robot is doubtful.")]
pub(super) struct Args {
    /// The scenario file
    #[arg(required_unless_present = "robot", conflicts_with_all = ["robot", "measurements", "columns", "session", "target"])]
    scenario: Option<PathBuf>,
    /// The robot's file
    #[arg(long, value_name = "ROBOT.toml", group = "robot", requires = "measurements")]
    model: Option<PathBuf>,
    /// The robot's URDF in place of a file of its own; read as `calibrig model from-urdf` does
    #[arg(long, value_name = "FILE", group = "robot", requires = "measurements")]
    urdf: Option<PathBuf>,
    #[command(flatten)]
    chain: ChainArgs,
    /// Measured cycles; may be repeated, for example with one file per target
    #[arg(long, value_name = "[TARGET=]FILE", requires = "robot")]
    measurements: Vec<String>,
    #[command(flatten)]
    rows: RowArgs,
    /// Column map of the files, instead of the one named in the robot's file
    #[arg(long, value_name = "MAP.toml", requires = "robot")]
    columns: Option<PathBuf>,
    /// Stations with their nests, and targets with their uncertainty (docs/formats.md)
    #[arg(long, value_name = "SESSION.toml", requires = "robot")]
    session: Option<PathBuf>,
    /// The target to evaluate [default: each by itself, and three or more together for the orientation]
    #[arg(long, value_name = "NAME")]
    target: Option<String>,
    /// Number of cycles: with a scenario how many are driven, with a file how many of each pose are used, from the first on
    /// [default: 30; all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(3..=10_000))]
    cycles: Option<u32>,
    /// Edge of the cube, mm, such as 300 [default: the largest that is found in the working region, in steps of 10 mm]
    #[arg(long, value_name = "MM", value_parser = edge, conflicts_with = "robot")]
    cube_mm: Option<f64>,
    /// Centre of the cube in the base frame, mm, such as 1200,0,800 [default: where the target is in the middle of the
    /// working region]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = place, conflicts_with = "robot")]
    cube_centre_mm: Option<Place>,
    /// Plane of the cube, given by its corners: 1 to 4 around the upper face, 5 to 8 below them
    #[arg(long, value_enum, default_value_t = Plane::C1C2C7C8, conflicts_with = "robot")]
    plane: Plane,
    /// Seed of the random draws, instead of the scenario's
    #[arg(long, value_name = "N", conflicts_with = "robot")]
    seed: Option<u64>,
    /// Number of a campaign's trial
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=4_000_000_000), conflicts_with = "robot")]
    trial: u32,
    /// Model of the machine: the multibody simulation, or the identification's own elastostatics (a matched model, for tests of the estimator)
    #[arg(long, value_enum, default_value_t = Plant::Rapier, conflicts_with = "robot")]
    plant: Plant,
    /// Folder for iso9283.html and iso9283.json, which are overwritten [default: no files]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print as JSON (schema calibrig.iso9283/1) instead of the tables
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Plane {
    /// Corners 1, 2, 7, 8
    #[value(name = "c1-c2-c7-c8")]
    C1C2C7C8,
    /// Corners 2, 3, 8, 5
    #[value(name = "c2-c3-c8-c5")]
    C2C3C8C5,
    /// Corners 3, 4, 5, 6
    #[value(name = "c3-c4-c5-c6")]
    C3C4C5C6,
    /// Corners 4, 1, 6, 7
    #[value(name = "c4-c1-c6-c7")]
    C4C1C6C7,
}

impl From<Plane> for CubePlane {
    fn from(plane: Plane) -> Self {
        match plane {
            Plane::C1C2C7C8 => Self::C1C2C7C8,
            Plane::C2C3C8C5 => Self::C2C3C8C5,
            Plane::C3C4C5C6 => Self::C3C4C5C6,
            Plane::C4C1C6C7 => Self::C4C1C6C7,
        }
    }
}

/// m
#[derive(Debug, Clone, Copy)]
struct Place(Vector3<f64>);

fn edge(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (1.0..=20_000.0).contains(&number) => Ok(number),
        _ => Err("expected a number of mm from 1 to 20000".to_owned()),
    }
}

fn place(text: &str) -> Result<Place, String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
    let inside = |v: &f64| v.abs() <= 1e6;
    match numbers.as_slice() {
        [x, y, z] if text.split(',').count() == 3 && numbers.iter().all(inside) => {
            Ok(Place(Vector3::new(1e-3 * x, 1e-3 * y, 1e-3 * z)))
        }
        _ => Err("expected three numbers of mm, such as 1200,0,800".to_owned()),
    }
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let destination = args.out.as_deref().map(Destination::Asked);
    if let Some(destination) = destination {
        destination.check(Files::Iso9283)?;
    }
    let outcome = match &args.scenario {
        Some(scenario) => of_scenario(args, scenario)?,
        None if !args.measurements.is_empty() => of_files(args)?,
        // Refused by the argument parser.
        _ => return Ok(Verdict::Doubtful),
    };
    let written = destination.map_or(Ok(()), |destination| {
        let (folder, new) = destination.make()?;
        output::or_removed(write(&outcome, &folder), &folder, new)
    });
    let style = if colours(&std::io::stdout()) { report::Style::Colour } else { report::Style::Plain };
    print(&if args.json {
        report::iso9283_json_text(&outcome)?
    } else {
        report::render_iso9283(&outcome, style)
    })?;
    written?;
    outcome.doubts.iter().for_each(|doubt| say(&format!("doubtful: {doubt}")));
    Ok(if outcome.doubts.is_empty() { Verdict::Done } else { Verdict::Doubtful })
}

fn write(outcome: &Iso9283Outcome, folder: &Path) -> Result<(), CliError> {
    report::write_iso9283(outcome, folder)?;
    say(&format!("wrote {} to {}", Files::Iso9283.names().join(", "), folder.display()));
    Ok(())
}

fn of_scenario(args: &Args, path: &Path) -> Result<Iso9283Outcome, CliError> {
    let scenario = read_scenario(path)?;
    let cycles = args.cycles.unwrap_or_else(|| u32::try_from(ISO_CYCLES).unwrap_or(u32::MAX));
    let plan = Iso9283Plan {
        cycles,
        edge: args.cube_mm.map(|mm| 1e-3 * mm),
        centre: args.cube_centre_mm.map(|place| place.0),
        plane: args.plane.into(),
    };
    let run = (args.seed.unwrap_or(scenario.seed), args.trial, args.plant.into());
    let stop = stop_on_interrupt("the test");
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("simulating pose {pos}/{len} {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    let outcome = iso9283_of_scenario(&scenario, run, &plan, &mut |done, total| {
        bar.set_length(total.into());
        bar.set_position(done.into());
        if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    // From here on there is nothing to close: the next Ctrl-C ends the process.
    stop.store(true, Ordering::Relaxed);
    bar.finish_and_clear();
    outcome.map_err(|failure| match failure {
        Iso9283Failure::Pipeline(error) => {
            let source = &scenario.sources[0].1;
            not_identified(error, path, source, source.place_of("poses.identification"))
        }
        failure => CliError::Iso9283 { file: path.to_path_buf(), source: Box::new(failure) },
    })
}

fn of_files(args: &Args) -> Result<Iso9283Outcome, CliError> {
    let asked = args.rows.sets(&args.measurements, &[], None);
    let first = asked.first().and_then(|set| set.files.points.first());
    let file = first.map(|file| file.path.clone()).unwrap_or_default();
    let robot = args.chain.robot(args.model.as_deref(), args.urdf.as_deref())?;
    let loaded = load(robot, args.columns.as_deref(), args.session.as_deref(), &args.rows, asked)?;
    loaded.check_session()?;
    let Loaded { robot, sets, read, statements, sha256, .. } = loaded;
    for line in &read {
        say(line);
    }
    let held_out: usize = sets.iter().skip(1).map(|set| set.measurements.observations.len()).sum();
    let input = InputSummary { kind: "files", name: robot.name.clone(), sha256, seed: None, trial: None };
    let empty = MeasurementSet::default();
    let set = sets.first().map_or(&empty, |set| &set.measurements);
    let missed = sets.first().map_or(0, |set| set.dropped.len());
    let cycles = args.cycles.map(|cycles| cycles as usize);
    let outcome = iso9283_of_set(input, (robot.name, &robot.model), set, args.target.as_deref(), cycles);
    let mut outcome = outcome.map_err(|failure| CliError::Iso9283 { file, source: Box::new(failure) })?;
    if held_out > 0 {
        outcome.remarks.push(format!(
            "{held_out} held-out readings ([sets] of the column map, --verify-poses) are not used"
        ));
    }
    if missed > 0 {
        outcome.remarks.push(format!("{missed} missed shots are left out"));
    }
    statements.remarks.iter().chain(&statements.assumed).for_each(|line| say(line));
    Ok(outcome)
}

/// What to do about a failure.
pub(super) fn help(failure: &Iso9283Failure) -> &'static str {
    match failure {
        Iso9283Failure::Reach(ReachError::Pose { .. }) => {
            "expected a smaller cube (--cube-mm), another centre (--cube-centre-mm) or plane (--plane), or a larger region in \
             [poses] of the scenario"
        }
        Iso9283Failure::Reach(_) => {
            "expected another centre of the cube (--cube-centre-mm), or a larger region in [poses] of the scenario"
        }
        Iso9283Failure::Reading { .. } => {
            "expected a cube that the tracker can see (--cube-mm, --cube-centre-mm, --plane), or another place of the tracker \
             in [tracker]"
        }
        Iso9283Failure::Cycles(Iso9283Error::NoRepeats { .. } | Iso9283Error::TwoCycles { .. }) => {
            "expected one row per cycle, with the same commands or pose number, and no --average-repeats"
        }
        Iso9283Failure::Cycles(Iso9283Error::Unequal { .. }) => {
            "expected whole cycles: --cycles N uses the first N of every pose; or measure the missed shot again"
        }
        Iso9283Failure::Cycles(Iso9283Error::Stations { .. }) => {
            "expected the rows of only one station: put those of each into a separate file"
        }
        Iso9283Failure::Cycles(Iso9283Error::TooFew { .. }) => "expected a smaller --cycles",
        Iso9283Failure::Target { .. } => {
            "expected --target with one of these names, or no --target for all of them"
        }
        Iso9283Failure::Hidden { .. } => {
            "expected poses that the first station sees: another --plane, or another cube (--cube-centre-mm, --cube-mm)"
        }
        _ => "expected rows of finite numbers, one per cycle at a pose",
    }
}
