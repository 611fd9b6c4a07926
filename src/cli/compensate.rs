//! `calibrig compensate`.

mod asked;
mod goals;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use self::asked::{Numbers, circumstances, command, length, lengths, numbers, positive, signs, speeds, tool};
use self::goals::{Goals, read_goals};
use super::estimate::{Asked, Found, find};
use super::identify::fitted_mode;
use super::interrupt::stop_on_interrupt;
use super::output::{Destination, Files, or_removed};
use super::{CliError, Verdict, colours, print, say};
use crate::compensate::{Compensation, CompensationPlan, Way, compensate};
use crate::report;
use calibrig_estimation::compensation::{CompensationError, PathError, PathOptions};
use calibrig_estimation::identification::Mode;
use calibrig_estimation::inverse::{Criterion, CriterionError, InverseError, InverseOptions};
use calibrig_files::actuator_speeds;
use calibrig_model::nalgebra::Vector3;

/// Compute commands with which the identified robot puts its tool where it should be
///
/// A controller computes its commands for the nominal robot. This command changes them as little as is needed to bring the identified robot's tool to
/// its goal, with deflection and terms, to 1 um on the model. It reports how far off the nominal command would be, and the standard deviation of
/// every corrected point.
///
/// Goals of a table are a path if it has a column of times or a speed is stated, otherwise separate points; a raster is a path. Along a path each
/// point is searched from the one before, so that joints do not jump, and corrected for the side from which every actuator comes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig compensate --estimate calibrated/estimate.json --targets points.csv --out compensated
  calibrig compensate --estimate runs/paper/recording.mcap --targets panel.toml --out compensated
  calibrig compensate --estimate estimate.json --targets path.csv --speed-mm-per-s 300 --trust-mm 0.2
  calibrig compensate --estimate estimate.json --targets points.csv --criterion deflection,limits=0.1
  calibrig compensate --estimate estimate.json --grid box.toml --start 0,-90,90,0,90,0

points.csv, in the base frame (with time_s, or with a speed, a path):
  x_mm,y_mm,z_mm,axis_x,axis_y,axis_z
  1200,300,850,0,0,-1

panel.toml, and box.toml:
  schema = \"calibrig.goals/1\"
  [raster]
  corners_mm = [[900, -500, 500], [900, 500, 500], [900, 500, 900], [900, -500, 900]]
  pitch_mm = 50
  spacing_mm = 5
  standoff_mm = 200
  speed_mm_per_s = 300
  [grid]
  low_mm = [800, -200, 400]
  high_mm = [1000, 200, 800]
  points = [3, 5, 5]
  axis = [1, 0, 0]

Exit code 3 if something must be looked at: points out of reach, jumps, speeds exceeded, less
certainty than --trust-mm, a doubtful estimate, an interruption. Points outside the measured commands
are reported as extrapolated. Files and keys: docs/formats.md.")]
pub(super) struct Args {
    /// The estimate: an estimate.json (of `export calibrated`), or a recording, whose measurements are identified again
    #[arg(long, value_name = "ESTIMATE.json|RECORDING.mcap")]
    estimate: PathBuf,
    /// Which estimate of a recording, such as `with_gravity` [default: the fullest one recorded]
    #[arg(long, value_name = "MODE", value_parser = fitted_mode)]
    mode: Option<Mode>,
    /// The nominal robot's file, the one that the estimate was made with (checked by its hash); its URDF states the
    /// speed limits of the joints
    #[arg(long, value_name = "ROBOT.toml")]
    model: Option<PathBuf>,
    /// Where the tool should be: a table of points (.csv, .xlsx), or a raster over a panel (.toml)
    #[arg(long, value_name = "FILE", required_unless_present = "grid")]
    targets: Option<PathBuf>,
    /// A box where offsets are wanted, for controllers that accept only offsets: [grid] of a .toml
    #[arg(long, value_name = "FILE.toml")]
    grid: Option<PathBuf>,
    /// Which target of the estimate is the tool [default: the first]
    #[arg(long, value_name = "NAME", conflicts_with = "tool_mm")]
    tool: Option<String>,
    /// The tool's point in the flange frame, mm, such as 0,0,120, instead of a target; its axes are the flange's
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = lengths)]
    tool_mm: Option<Numbers>,
    /// The axis of the tool that goals direct, in the tool's own axes [default: 0,0,1]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = numbers)]
    tool_axis: Option<Numbers>,
    /// How to choose between commands for the same goal: motion (from the start, along a path from the point before), deflection, limits (far from
    /// them), manipulability, several with weights (deflection,limits=0.1), or none
    #[arg(long, value_name = "CRITERION", value_parser = criterion, default_value = "motion")]
    criterion: Criterion,
    /// Command from which the robot comes: one number per actuator, mm of slides and deg of turns, such as 0,-90,90,0,90,0 [default: the middle of
    /// the measured commands]
    #[arg(long, value_name = "MM|DEG,...", allow_hyphen_values = true, value_parser = numbers)]
    start: Option<Numbers>,
    /// Sign of every actuator's last motion to single points, or to the first point of a path: -1, 0 (unknown) or 1
    #[arg(long, value_name = "SIGN,...", allow_hyphen_values = true, value_parser = signs)]
    approach: Option<Signs>,
    /// Speed of the tool's point, mm/s; makes a path of a table without times
    #[arg(long, value_name = "MM/S", value_parser = positive)]
    speed_mm_per_s: Option<f64>,
    /// Speed limits of the actuators, mm/s and deg/s, one per actuator, inf for no limit [default: those of the robot's
    /// URDF]
    #[arg(long, value_name = "MM/S|DEG/S,...", value_parser = numbers)]
    speed_limits: Option<Numbers>,
    /// Largest step of a joint from one point of a path to the next, m or rad
    #[arg(long, value_name = "M|RAD", value_parser = positive, default_value_t = 0.1)]
    longest_step: f64,
    /// Name of a [[payload]] of --session that the flange carries [default: its only one]
    #[arg(long, value_name = "NAME", requires = "session", conflicts_with = "payload_kg")]
    payload: Option<String>,
    /// A session file, for the payload that the flange carries
    #[arg(long, value_name = "SESSION.toml", conflicts_with = "payload_kg")]
    session: Option<PathBuf>,
    /// Mass that the flange carries in addition to its permanent loads, kg
    #[arg(long, value_name = "KG", value_parser = positive, requires = "payload_centre_mm")]
    payload_kg: Option<f64>,
    /// Its centre of mass in the flange frame, mm, such as 0,0,150
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = lengths, requires = "payload_kg")]
    payload_centre_mm: Option<Numbers>,
    /// Air temperature at the robot, °C
    #[arg(long, value_name = "C", allow_hyphen_values = true)]
    temperature_c: Option<f64>,
    /// Time since the session began, for terms that depend on time, s; for a path, at its time zero
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    time_s: f64,
    /// Largest remaining error on the model, um
    #[arg(long, value_name = "UM", value_parser = length, default_value_t = 0.001)]
    tolerance_um: f64,
    /// Standard deviation in space, mm, up to which corrected points are trusted; others are marked
    #[arg(long, value_name = "MM", value_parser = positive)]
    trust_mm: Option<f64>,
    /// Folder for compensated.csv, commands.csv, compensation.json, compensation.html and grid.csv, which are overwritten [default: no files]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print as JSON (schema calibrig.compensation/1) instead of the tables
    #[arg(long)]
    json: bool,
}

/// Signs of approach.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Signs(Vec<i8>);

fn criterion(text: &str) -> Result<Criterion, CriterionError> {
    text.parse()
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let destination = args.out.as_deref().map(Destination::Asked);
    if let Some(destination) = destination {
        destination.check(Files::Compensation)?;
    }
    // Cheap checks, before a recording is identified again.
    let goals = read_goals(args.targets.as_deref(), args.grid.as_deref(), args.speed_mm_per_s)?;
    goals.remarks.iter().for_each(|remark| say(remark));
    let asked = Asked { input: &args.estimate, mode: args.mode, model: args.model.as_deref() };
    let found = find(asked)?;
    let plan = plan(args, &goals, &found)?;
    let made = with_bar(|tell| compensate(&found.estimate, &plan, tell));
    let made = made.map_err(|error| refused(args, &goals, error))?;
    let written = destination.map_or(Ok(()), |destination| {
        let (folder, new) = destination.make()?;
        or_removed(write(&made, &folder), &folder, new)
    });
    let style = if colours(&std::io::stdout()) { report::Style::Colour } else { report::Style::Plain };
    print(&if args.json {
        report::compensation_json_text(&made)?
    } else {
        report::render_compensation(&made, style)
    })?;
    written?;
    // The first ones are the estimate's own.
    let said = if found.is_said { found.estimate.estimate.reasons().count() } else { 0 };
    made.doubts.iter().skip(said).for_each(|doubt| say(&format!("doubtful: {doubt}")));
    if args.json {
        made.remarks.iter().for_each(|remark| say(remark));
    }
    Ok(if made.doubts.is_empty() { found.ended } else { Verdict::Doubtful })
}

fn write(made: &Compensation, folder: &Path) -> Result<(), CliError> {
    let written = report::write_compensation(made, folder)?;
    say(&format!("wrote {} to {}", written.join(", "), folder.display()));
    let stale = Files::Compensation.names().iter().filter(|name| !written.contains(*name));
    for name in stale.filter(|name| folder.join(name).exists()) {
        say(&format!("{name} in {} is an older file, not of this run", folder.display()));
    }
    Ok(())
}

fn plan(args: &Args, goals: &Goals, found: &Found) -> Result<CompensationPlan, CliError> {
    let estimate = &found.estimate.estimate;
    let model = &estimate.robot.nominal;
    let (tool, tool_name) = tool(args, &found.estimate)?;
    let region = &found.estimate.region;
    let middle =
        || region.command_min.iter().zip(&region.command_max).map(|(low, high)| 0.5 * (low + high)).collect();
    let start = args.start.as_ref().map(|start| command(start, model, "start")).transpose()?;
    let reference = Some(start.unwrap_or_else(middle));
    let speed_limits = match &args.speed_limits {
        Some(stated) => speeds(stated, model)?,
        // Single points have no times.
        None if matches!(goals.way, Way::Points(_)) => Vec::new(),
        None => {
            let stated = found.robot.as_ref().map(actuator_speeds).unwrap_or_default();
            let all = stated.iter().map(|speed| speed.unwrap_or(f64::INFINITY)).collect::<Vec<_>>();
            if all.iter().any(|speed| speed.is_finite()) { all } else { Vec::new() }
        }
    };
    let inverse = InverseOptions {
        criterion: args.criterion,
        reference,
        circumstances: circumstances(args, model)?,
        tolerance: 1e-6 * args.tolerance_um,
        ..InverseOptions::default()
    };
    Ok(CompensationPlan {
        file: goals.file.clone(),
        way: goals.way.clone(),
        names: goals.names.clone(),
        tool,
        tool_name,
        options: PathOptions { inverse, speed_limits, longest_step: args.longest_step },
        trust: args.trust_mm.map(|mm| 1e-3 * mm),
        grid: goals.grid.clone(),
    })
}

/// Where an error comes from: the row of the goal, if it concerns one.
fn refused(args: &Args, goals: &Goals, error: CompensationError) -> CliError {
    let file = args.targets.as_ref().or(args.grid.as_ref()).unwrap_or(&args.estimate).clone();
    let help = match &error {
        CompensationError::Inverse(InverseError::NoStatics) => {
            "expected --criterion limits, manipulability, motion or none; or a robot's file with masses and stiffnesses"
        }
        CompensationError::Path(PathError::Limit { .. }) => "expected speeds above zero, inf for no limit",
        CompensationError::Grid(_) => return goals.refuse_grid(error),
        _ => "expected goals and options that suit this robot",
    };
    CliError::Compensation { file, source: Box::new(error), help }
}

/// Shows the progress if it takes longer than two seconds; the first Ctrl-C asks it to stop.
fn with_bar<T>(work: impl FnOnce(&mut dyn FnMut(&'static str, usize, usize) -> ControlFlow<()>) -> T) -> T {
    let stop = stop_on_interrupt("the correction");
    let bar = ProgressBar::hidden();
    if let Ok(style) = ProgressStyle::with_template("{msg} {pos}/{len} {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    let mut shown = false;
    let made = work(&mut |what, done, total| {
        if !shown && bar.elapsed() > Duration::from_secs(2) {
            shown = true;
            bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        if shown && done % 16 == 0 {
            bar.set_message(what);
            bar.set_length(total as u64);
            bar.set_position(done as u64);
        }
        if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    // From here on there is nothing to stop: the next Ctrl-C ends the process.
    stop.store(true, Ordering::Relaxed);
    bar.finish_and_clear();
    made
}

/// A place or a direction.
fn three(numbers: &Numbers, flag: &'static str) -> Result<Vector3<f64>, CliError> {
    match numbers.0.as_slice() {
        &[x, y, z] => Ok(Vector3::new(x, y, z)),
        other => Err(CliError::Flag {
            flag,
            message: format!("has {} numbers", other.len()),
            expected: "three numbers, such as 0,0,120".to_owned(),
        }),
    }
}
