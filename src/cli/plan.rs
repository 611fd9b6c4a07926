//! `calibrig plan`.

mod cells;
mod values;

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::error::ErrorKind;
use clap::{CommandFactory, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use super::identify::{family, fitted_mode};
use super::measured::RowArgs;
use super::model::ChainArgs;
use super::output::{self, Destination, Files};
use super::{Cli, CliError, Verdict, colours, print, say};
use crate::pose_plan::{self, CandidateSource, Cell, Figure, PosePlan, Request, STEPS, usual_candidates};
use crate::report;
use crate::twin::Preset;
use calibrig_estimation::identification::Mode;
use calibrig_estimation::planning::{Criterion, Needed, OrderWeights, Over};
use calibrig_files::{
    ColumnMap, InputError, Robot, Source, commanded_joints, parse_column_map, parse_commands, with_followers,
};
use calibrig_model::JointKind;
use values::{Length3, SideOfRegion};

/// Choose the poses to measure: those that say most about the robot in its working region, in an order to drive them
///
/// Candidates come from the whole joint space, as far as the robot can take them without touching itself or the floor and a tracker sees the target.
/// Poses are chosen by how well a fit would determine all its parameters: geometry, stiffness and payloads together, with priors. The predicted
/// accuracy is given for the working region: [poses.region] of a scenario, else the whole space or --region.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig plan scenarios/paper.toml --poses 30                  tables here
  calibrig plan scenarios/paper.toml --poses 30 --out plan       and plan.csv, plan.json, plan.html
  calibrig plan scenarios/paper.toml --accuracy 0.1mm            how many poses does 0.1 mm need?
  calibrig plan scenarios/matched.toml --poses 30 --criterion D --candidates 5000
  calibrig plan scenarios/matched.toml --poses 30 --robots 3     also for robots within their tolerances
  calibrig plan --model models/ur5/robot.toml --tracker at500 --tracker-mm 2500,0,800 --poses 40
  calibrig plan --model robot.toml --session session.toml --noise-um 15 --poses 40 --out plan
  calibrig plan --model robot.toml --measurements first.csv --poses 10      which poses next?
  calibrig plan --after recording.mcap --poses 10 --out next                the same after a run

plan.csv is a file that a scenario takes ([poses] identification_from = \"plan.csv\"), and that calibrig identify takes once the measured
columns are added. Exit code 3 if --poses N do not reach the given accuracy; without --poses an accuracy out of reach is an error (1).")]
pub(super) struct Args {
    /// The scenario file
    #[arg(conflicts_with_all = ["robot", "measurements", "columns", "session", "tracker", "noise_um", "tracker_mm", "region"])]
    scenario: Option<PathBuf>,
    /// The robot's file
    #[arg(long, value_name = "ROBOT.toml", group = "robot")]
    model: Option<PathBuf>,
    /// The robot's URDF in place of a file of its own; read as `calibrig model from-urdf` does
    #[arg(long, value_name = "FILE", group = "robot")]
    urdf: Option<PathBuf>,
    #[command(flatten)]
    chain: ChainArgs,
    /// Number of poses to choose, such as 30
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    poses: Option<u32>,
    /// Accuracy to reach, such as 0.1mm or 80um: the standard deviation of predicted places in the region, including the machine's own random errors;
    /// without --poses, as many poses are chosen as that needs
    #[arg(long, value_name = "LENGTH", value_parser = values::length)]
    accuracy: Option<f64>,
    /// The same as a number of mm, such as 0.1
    #[arg(long, value_name = "MM", value_parser = values::mm, conflicts_with = "accuracy")]
    accuracy_mm: Option<f64>,
    /// Which statistic of the standard deviations over the region
    #[arg(long, value_enum, default_value_t = FigureArg::Rms)]
    figure: FigureArg,
    /// What to minimise: D, A, E, G or I of optimal designs (I: mean predicted variance over the region), or the observability index O1 to O5
    #[arg(long, value_name = "NAME", default_value = "I", value_parser = criterion)]
    criterion: Criterion,
    /// Number of measurable candidates from which poses are chosen [default: 2000, fewer if a pose has many readings]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    candidates: Option<u32>,
    /// Take candidates only from the working region
    #[arg(long, conflicts_with = "candidates_from")]
    candidates_in_region: bool,
    /// Take candidates from a file: joint commands in calibrig's own columns, or as the column map states
    #[arg(long, value_name = "FILE")]
    candidates_from: Option<PathBuf>,
    /// Random starts of the search, in addition to the greedy one
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..=1000))]
    starts: u32,
    /// Plan also for this many robots drawn within their tolerances
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=100))]
    robots: u32,
    /// How these robots count: by their mean, or by the worst of them
    #[arg(long, value_enum, default_value_t = OverArg::Mean)]
    over: OverArg,
    /// Allow a pose to be measured more than once
    #[arg(long)]
    repeats: bool,
    /// Largest number of poses to try for --accuracy
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(4..=2000))]
    most: u32,
    /// Seed of random starts, drawn robots and the random poses for comparison [default: the scenario's, or 1]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// The model that will be identified [default: geometry and stiffness if the robot's files give any, else geometry]
    #[arg(long, value_name = "MODE", value_parser = fitted_mode)]
    mode: Option<Mode>,
    /// Terms of the mode `extended`, by family, such as linkage,ratio; "none" for none
    #[arg(long, value_name = "FAMILY,..", value_delimiter = ',', value_parser = family)]
    terms: Option<Vec<String>>,
    /// Prior knowledge of lengths: standard deviation, mm [default: as the scenario states, else 10]
    #[arg(long, value_name = "MM", value_parser = values::mm, requires = "tolerance_mrad")]
    tolerance_mm: Option<f64>,
    /// Prior knowledge of angles: standard deviation, mrad [default: as the scenario states, else 20]
    #[arg(long, value_name = "MRAD", value_parser = values::mm, requires = "tolerance_mm")]
    tolerance_mrad: Option<f64>,
    /// The machine's own random errors: standard deviation of an actuator from approach to approach, in mm or mrad, such as waist=0.05mrad. May be
    /// repeated
    #[arg(long, value_name = "NAME=VALUE")]
    actuator_sigma: Vec<String>,
    /// Where the robot will work: a joint and its range, such as rail=100mm..3900mm or waist=-20deg..40deg; other joints use their limits. May be
    /// repeated
    #[arg(long, value_name = "JOINT=MIN..MAX", value_parser = values::side, allow_hyphen_values = true)]
    region: Vec<SideOfRegion>,
    /// The tracker, for its noise and limits: at500, at960, vantage, gts3800. After a session only for its limits: the noise is that found in
    /// the session
    #[arg(long, value_name = "NAME", value_parser = values::preset, conflicts_with = "noise_um")]
    tracker: Option<Preset>,
    /// Standard deviation of a measured coordinate, um, such as 15, instead of a tracker's
    #[arg(long, value_name = "UM", value_parser = values::mm)]
    noise_um: Option<f64>,
    /// Place of the tracker in the base frame, mm, such as 2500,0,800 [default: from the session's nests; else every pose is
    /// taken as visible]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = values::length3)]
    tracker_mm: Option<Length3>,
    /// Direction of the reflector's opening, in the flange frame, such as 0,0,1 [default: turned to the tracker by
    /// hand]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = values::length3, conflicts_with = "scenario")]
    opening: Option<Length3>,
    /// Largest angle between the opening and the beam, deg [default: 30]
    #[arg(long, value_name = "DEG", value_parser = values::angle, conflicts_with = "scenario")]
    acceptance_deg: Option<f64>,
    /// Height of the floor above the base's origin, mm
    #[arg(long, value_name = "MM", allow_negative_numbers = true, conflicts_with = "scenario")]
    floor_mm: Option<f64>,
    /// Radius of the links where the robot has no shapes, mm; 0: they touch and hide nothing [default: 8 % of its reach, at most 80]
    #[arg(long, value_name = "MM", value_parser = values::not_negative, conflicts_with = "scenario")]
    capsule_radius_mm: Option<f64>,
    /// Clearance of poses from the floor and of beams from the links, mm: the real robot is not the nominal one
    #[arg(long, value_name = "MM", default_value_t = 50.0, value_parser = values::not_negative)]
    clearance_mm: f64,
    /// Margin to the angles that tracker and reflector allow, deg
    #[arg(long, value_name = "DEG", default_value_t = 2.0, value_parser = values::not_negative)]
    clearance_deg: f64,
    /// Plan further poses: a recording, or an estimate.json with --model and --measurements. The measured poses stay
    #[arg(long, value_name = "FILE")]
    after: Option<PathBuf>,
    /// Measured poses, as calibrig identify takes them: further poses are planned. May be repeated
    #[arg(long, value_name = "[TARGET=]FILE", requires = "robot")]
    measurements: Vec<String>,
    #[command(flatten)]
    rows: RowArgs,
    /// Column map of the measurements and of --candidates-from, instead of the one named in the robot's file
    #[arg(long, value_name = "MAP.toml", requires = "robot")]
    columns: Option<PathBuf>,
    /// Stations with their nests, and targets with their uncertainty (docs/formats.md)
    #[arg(long, value_name = "SESSION.toml", requires = "robot")]
    session: Option<PathBuf>,
    /// Speed of sliding joints from pose to pose, mm/s
    #[arg(long, value_name = "MM_PER_S", default_value_t = 250.0, value_parser = values::mm)]
    slide_mm_per_s: f64,
    /// Speed of turning joints from pose to pose, deg/s
    #[arg(long, value_name = "DEG_PER_S", default_value_t = 15.0, value_parser = values::mm)]
    axis_deg_per_s: f64,
    /// Weight of balanced approaches, s: driving time that the order may cost to approach a joint from both sides instead of always from
    /// one
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = values::not_negative)]
    balance_s: f64,
    /// Weight against drift, s: driving time that the order may cost to avoid a drift that the parameters take up as a whole
    #[arg(long, value_name = "S", default_value_t = 600.0, value_parser = values::not_negative)]
    drift_s: f64,
    /// Folder for plan.csv, plan.json and plan.html, which are overwritten [default: no files]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print as JSON (schema calibrig.plan/1) instead of the tables
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FigureArg {
    /// Root of the mean variance
    Rms,
    /// Mean standard deviation
    Mean,
    /// Value that 95 % of the region's poses stay below
    Q95,
    /// The largest
    Largest,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum OverArg {
    /// Their mean
    Mean,
    /// The worst of them
    Worst,
}

fn criterion(text: &str) -> Result<Criterion, String> {
    Criterion::parse(text).ok_or_else(|| {
        let keys: Vec<_> = Criterion::ALL.iter().map(|own| own.key()).collect();
        format!("expected one of: {}", keys.join(", "))
    })
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let misused =
        |message: &str| -> ! { Cli::command().error(ErrorKind::MissingRequiredArgument, message).exit() };
    let accuracy = args.accuracy.or(args.accuracy_mm.map(|mm| 1e-3 * mm));
    if args.poses.is_none() && accuracy.is_none() {
        misused(
            "--poses N or --accuracy LENGTH: expected the number of poses, or the accuracy that they are to reach",
        );
    }
    let has_robot = args.model.is_some() || args.urdf.is_some();
    if args.scenario.is_none() && !has_robot && args.after.is_none() {
        misused("expected a scenario, or --model ROBOT.toml, or --after RECORDING.mcap");
    }
    let destination = args.out.as_deref().map(Destination::Asked);
    if let Some(destination) = destination {
        destination.check(Files::Plan)?;
    }
    let read = cells::read(args)?;
    let cell = read.cell(args)?;
    let request = request(args, accuracy, &read.robot, (&cell, read.seed))?;
    let plan = with_bar(&cell, &request, &read.file)?;
    let written = destination.map_or(Ok(()), |destination| {
        let (folder, new) = destination.make()?;
        output::or_removed(write(&plan, &folder), &folder, new)
    });
    let style = if colours(&std::io::stdout()) { report::Style::Colour } else { report::Style::Plain };
    print(&if args.json { report::plan_json_text(&plan)? } else { report::render_plan(&plan, style) })?;
    written?;
    Ok(match plan.needed {
        None | Some(Needed::Poses { .. }) => Verdict::Done,
        Some(_) => {
            say(&format!("doubtful: {}", plan.needed_words().unwrap_or_default()));
            Verdict::Doubtful
        }
    })
}

fn write(plan: &PosePlan, folder: &Path) -> Result<(), CliError> {
    report::write_plan(plan, folder)?;
    say(&format!("wrote {} to {}", Files::Plan.names().join(", "), folder.display()));
    Ok(())
}

fn with_bar(cell: &Cell<'_>, request: &Request, file: &Path) -> Result<PosePlan, CliError> {
    let bar = ProgressBar::new(STEPS as u64);
    if let Ok(style) = ProgressStyle::with_template("{msg}, step {pos}/{len} {bar:30} {elapsed} {spinner}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(250));
    let plan = pose_plan::plan(cell, request, &mut |step| {
        bar.set_position(step.number as u64);
        bar.set_message(step.name);
    });
    bar.finish_and_clear();
    plan.map_err(|source| CliError::PosePlan { file: file.to_path_buf(), source: Box::new(source) })
}

fn request(
    args: &Args,
    accuracy: Option<f64>,
    robot: &Robot,
    (cell, seed): (&Cell<'_>, Option<u64>),
) -> Result<Request, CliError> {
    let source = match &args.candidates_from {
        Some(path) => CandidateSource::Listed(listed(path, args.columns.as_deref(), robot)?),
        None if args.candidates_in_region => CandidateSource::Region,
        None => CandidateSource::WholeSpace,
    };
    let speed = |kind| match kind {
        JointKind::Prismatic => 1e-3 * args.slide_mm_per_s,
        JointKind::Revolute => args.axis_deg_per_s.to_radians(),
    };
    Ok(Request {
        poses: args.poses.map(|poses| poses as usize),
        accuracy,
        figure: match args.figure {
            FigureArg::Rms => Figure::Rms,
            FigureArg::Mean => Figure::Mean,
            FigureArg::Q95 => Figure::Quantile95,
            FigureArg::Largest => Figure::Largest,
        },
        criterion: args.criterion,
        candidates: args.candidates.map_or_else(|| usual_candidates(cell), |count| count as usize),
        source,
        starts: args.starts,
        seed: args.seed.or(seed).unwrap_or(1),
        robots: args.robots,
        over: if args.over == OverArg::Worst { Over::Worst } else { Over::Mean },
        repeats: args.repeats,
        most: args.most as usize,
        speeds: robot.model.kinematics.links.iter().map(|link| speed(link.kind)).collect(),
        weights: OrderWeights { balance: args.balance_s, drift: args.drift_s },
    })
}

/// The joint variables of a file of candidates. One beyond the limits is an error of whoever listed it.
fn listed(path: &Path, columns: Option<&Path>, robot: &Robot) -> Result<Vec<Vec<f64>>, CliError> {
    let source = Source::read(path)?;
    let map = match (columns, robot.sources.iter().find(|(role, _)| role == "columns")) {
        (Some(path), _) => calibrig_files::load_column_map(path)?.0,
        (None, Some((_, source))) => parse_column_map(source)?.or_own(),
        (None, None) => ColumnMap::default(),
    };
    let model = &robot.model;
    let mut commanded = parse_commands(&source, &map, &commanded_joints(model))?;
    // Several readings of a pose are one candidate.
    commanded.dedup_by_key(|(pose, _)| *pose);
    let mut poses = Vec::new();
    for (pose, commands) in commanded {
        let command = with_followers(model, &commands);
        let mut joints = vec![0.0; command.len()];
        model.actuators.joints_from_command(&command, &mut joints);
        let beyond = joints
            .iter()
            .zip(&model.kinematics.links)
            .find(|(q, link)| !(link.limits[0] - 1e-9..=link.limits[1] + 1e-9).contains(*q));
        if let Some((q, link)) = beyond {
            let (unit, scale) = match link.kind {
                JointKind::Prismatic => ("mm", 1e3),
                JointKind::Revolute => ("deg", 1_f64.to_degrees()),
            };
            let [low, high] = link.limits.map(|limit| scale * limit);
            return Err(InputError::Place {
                place: path.display().to_string(),
                message: format!("candidate {pose} has joint \"{}\" at {:.3} {unit}", link.name, scale * q),
                help: Some(format!(
                    "expected candidates within the limits of the robot's file, {low:.3} to {high:.3} {unit}: look at the unit of the joints"
                )),
            }
            .into());
        }
        poses.push(joints);
    }
    Ok(poses)
}
