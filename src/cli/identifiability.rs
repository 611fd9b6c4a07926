//! `calibrig identifiability`.

mod coupled;
mod sensors;

use std::fmt::Write;
use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{ArgGroup, CommandFactory, ValueEnum};
use nalgebra::Vector3;
use serde_json::json;

use super::identify::family;
use super::model::ChainArgs;
use super::{Cli, CliError, Verdict, print, read_scenario, say};
use crate::pipeline::CalibrateError;
use crate::scenario::Scenario;
use calibrig_estimation::identification::{
    Explanation, Finding, FrameChoice, IdentifiabilityReport, Mode, TargetChoice, explain,
    identifiability_of, neighbour_axis_rules, reachable_poses, spectrum,
};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, KinematicModel, ModelError, ParameterId};

/// Say which parameters position measurements can determine: rank, dependent groups, weak directions, and what would
/// help
///
/// Only the nominal robot is used; no measurements are needed.
#[derive(Debug, clap::Args)]
#[command(group(ArgGroup::new("subject").required(true).args(["scenario", "model", "urdf"])), after_help = "Examples:
  calibrig identifiability scenarios/paper.toml            at the scenario's poses and target
  calibrig identifiability --model models/ur5/robot.toml   anywhere, base and target unknown
  calibrig identifiability scenarios/paper.toml --mode elasto_geometric
  calibrig identifiability scenarios/paper.toml --mode extended --terms linkage,ratio
  calibrig identifiability scenarios/matched.toml --sensors          one SMR, three, or full poses

With --mode elasto_geometric or extended, all parameters of such a fit are analysed together: links, tracker frame, target,
compliances, masses and terms, as the scenario's [identification] states, at the nominal robot's equilibrium.")]
pub(super) struct Args {
    /// The scenario file
    scenario: Option<PathBuf>,
    /// The robot's file, instead of a scenario
    #[arg(long, value_name = "ROBOT.toml")]
    model: Option<PathBuf>,
    /// The robot's URDF in place of a file of its own; read as `calibrig model from-urdf` does
    #[arg(long, value_name = "FILE")]
    urdf: Option<PathBuf>,
    #[command(flatten)]
    chain: ChainArgs,
    /// Which parameters: those of the rigid chain, or those of a mode that couples geometry and stiffness
    #[arg(long, value_enum, default_value_t = Analysed::Geometry)]
    mode: Analysed,
    /// Compliances of the coupled modes: drives, all, or names such as `compliance_drive2` [default: as the scenario
    /// states, else drives]
    #[arg(long, value_name = "WHICH,..", value_delimiter = ',')]
    compliances: Option<Vec<String>>,
    /// Terms of the mode `extended`, by family, such as linkage,ratio; "none" for none [default: as the scenario states, else all
    /// that the robot can have]
    #[arg(long, value_name = "FAMILY,..", value_delimiter = ',', value_parser = family)]
    terms: Option<Vec<String>>,
    /// Compare targets in a simulated session: one SMR, three, the pose that these make, and the scenario's probe
    #[arg(long)]
    sensors: bool,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum Analysed {
    /// Links, with frame and target if they are free
    Geometry,
    /// Geometry and stiffness together
    ElastoGeometric,
    /// The complete set with linkage and terms
    Extended,
}

/// Poses, if no scenario states them.
const SPREAD_POSES: usize = 200;

/// A target that is not known yet is assumed off every axis, where it can be mounted, m.
const MOUNTABLE_TARGET: Vector3<f64> = Vector3::new(0.1, 0.15, 0.2);

fn spread_poses() -> String {
    format!("{SPREAD_POSES} poses spread over the joint limits")
}

fn scenario_poses(scenario: &Scenario) -> String {
    format!("the scenario's {} identification poses", scenario.identification_poses)
}

struct Question {
    name: String,
    model: KinematicModel,
    robot: CalibrationModel,
    poses: Vec<Vec<f64>>,
    poses_from: String,
    target: Vector3<f64>,
    frame_free: bool,
    target_free: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let refuse = |flag: &str, expected: &str| {
        let message = format!("{flag}: expected {expected} with it");
        Cli::command().error(ErrorKind::ArgumentConflict, message).exit()
    };
    if args.sensors && args.scenario.is_none() {
        refuse("--sensors", "a scenario, whose machine is measured,");
    }
    if let (true, Some(scenario)) = (args.sensors, &args.scenario) {
        let mode = match args.mode {
            Analysed::Geometry => Mode::OnlyCalibration,
            Analysed::ElastoGeometric => Mode::ElastoGeometric,
            Analysed::Extended => Mode::Extended,
        };
        return sensors::execute(args, scenario, mode);
    }
    match args.mode {
        Analysed::Geometry if args.compliances.is_some() => {
            refuse("--compliances", "--mode elasto_geometric or --mode extended");
        }
        Analysed::Geometry | Analysed::ElastoGeometric if args.terms.is_some() => {
            refuse("--terms", "--mode extended");
        }
        Analysed::Geometry => {}
        Analysed::ElastoGeometric => return coupled::execute(args, Mode::ElastoGeometric),
        Analysed::Extended => return coupled::execute(args, Mode::Extended),
    }
    let question = question(args)?;
    let report = identifiability_of(
        &question.robot,
        &question.poses,
        &question.target,
        question.frame_free,
        question.target_free,
    )
    .map_err(|error| failed(args, error))?;
    let findings = explain(&report, &question.model, &question.poses, &question.target)
        .map_err(|error| failed(args, error))?;
    let sets = candidate_sets(&question).map_err(|error| failed(args, error))?;
    print(&if args.json {
        as_json(&question, &sets, &report, &findings)
    } else {
        as_text(&question, &sets, &report, &findings)
    })?;
    let complete = report.spectrum.rank == report.selected.len();
    Ok(if complete { Verdict::Done } else { Verdict::Doubtful })
}

fn failed(args: &Args, error: ModelError) -> CliError {
    let file =
        args.model.as_ref().or(args.urdf.as_ref()).or(args.scenario.as_ref()).cloned().unwrap_or_default();
    let source = CalibrateError::Identify { mode: Mode::OnlyCalibration, source: error.into() };
    CliError::Pipeline { file, source: source.into() }
}

fn question(args: &Args) -> Result<Question, CliError> {
    if args.scenario.is_none() {
        let robot = args.chain.robot(args.model.as_deref(), args.urdf.as_deref())?;
        robot.remarks.iter().for_each(|remark| say(remark));
        let target = robot.target().unwrap_or(MOUNTABLE_TARGET);
        return Ok(Question {
            name: robot.name,
            poses: reachable_poses(&robot.model, SPREAD_POSES),
            poses_from: spread_poses(),
            target,
            model: robot.model.kinematics.clone(),
            robot: robot.model,
            frame_free: true,
            target_free: true,
        });
    }
    let path = args.scenario.as_deref().unwrap_or(std::path::Path::new(""));
    let scenario = read_scenario(path)?;
    if scenario.probe.is_some() {
        say(
            "the scenario's probe also measures orientations, but this analysis uses positions only: --sensors and --mode use \
             full poses",
        );
    }
    let mut rng = stream(scenario.seed, 0, StreamSource::IdentificationPoses);
    let target = scenario.robot.target().unwrap_or_else(Vector3::zeros);
    let mut poses = scenario.listed[0].clone().unwrap_or_else(|| {
        (0..scenario.identification_poses).map(|_| scenario.region.draw(&mut rng)).collect::<Vec<_>>()
    });
    for joints in &mut poses {
        scenario.robot.model.actuators.follow(joints);
    }
    Ok(Question {
        poses_from: scenario_poses(&scenario),
        name: scenario.name,
        poses,
        target,
        model: scenario.robot.model.kinematics.clone(),
        robot: scenario.robot.model,
        frame_free: scenario.options.frame == FrameChoice::Free,
        target_free: scenario.options.target == TargetChoice::Identified,
    })
}

/// Candidate sets by name, with number of columns, rank and condition at the poses in question.
struct CandidateSet {
    name: &'static str,
    columns: usize,
    rank: usize,
    condition: f64,
}

fn candidate_sets(question: &Question) -> Result<Vec<CandidateSet>, ModelError> {
    let model = &question.model;
    let (kept, groups) = neighbour_axis_rules(model);
    let mut table = kept.clone();
    table.extend(groups.iter().map(|g| g.redundant));
    let all = ParameterId::all_of_links(model.joint_count());
    let mut with_frame = all.clone();
    with_frame.extend(ParameterId::all_of_frame(0));
    with_frame.extend(ParameterId::all_of_target(0));
    [
        ("kept by the neighbour-axis rules", kept),
        ("a, alpha, d, theta, beta of parallel axes", table),
        ("all five of every link", all),
        ("the same, frame and target free", with_frame),
    ]
    .into_iter()
    .map(|(name, ids)| {
        let spectrum = spectrum(model, &question.poses, &question.target, &ids)?;
        Ok(CandidateSet { name, columns: ids.len(), rank: spectrum.rank, condition: spectrum.condition })
    })
    .collect()
}

fn list(ids: &[ParameterId]) -> String {
    ids.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn as_json(
    question: &Question,
    sets: &[CandidateSet],
    report: &IdentifiabilityReport,
    findings: &[Explanation],
) -> String {
    let finite = |v: f64| v.is_finite().then_some(v);
    let (kept, groups) = neighbour_axis_rules(&question.model);
    let value = json!({
        "schema": "calibrig.identifiability/1",
        "name": question.name,
        "poses": question.poses_from,
        "frame_free": question.frame_free,
        "target_free": question.target_free,
        "candidate_sets": sets.iter().map(|s| json!({
            "name": s.name, "columns": s.columns, "rank": s.rank, "condition": finite(s.condition),
        })).collect::<Vec<_>>(),
        "neighbour_axis_rules": {
            "kept": kept.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "eliminated": groups.iter().map(ToString::to_string).collect::<Vec<_>>(),
        },
        "complete_set": {
            "parameters": report.selected.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "structural_rank": report.selected.len(),
            "rank": report.spectrum.rank,
            "condition": finite(report.spectrum.condition),
            "scaled_singular_values": report.spectrum.singular_values.iter().map(|v| finite(*v)).collect::<Vec<_>>(),
        },
        "findings": findings.iter().map(|f| json!({
            "kind": match f.finding {
                Finding::Structure => "structure",
                Finding::Measurements => "measurements",
                Finding::Weak => "weak",
            },
            "names": f.names,
            "scaled_singular_value": finite(f.singular_value),
            "advice": f.advice,
        })).collect::<Vec<_>>(),
    });
    format!("{value:#}\n")
}

fn as_text(
    question: &Question,
    sets: &[CandidateSet],
    report: &IdentifiabilityReport,
    findings: &[Explanation],
) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write_text(question, sets, report, findings, &mut text);
    text
}

fn write_text(
    question: &Question,
    sets: &[CandidateSet],
    report: &IdentifiabilityReport,
    findings: &[Explanation],
    text: &mut String,
) -> std::fmt::Result {
    let known = |free: bool, name: &str| format!("{name} {}", if free { "free" } else { "known" });
    writeln!(
        text,
        "{}: position measurements at {}, {}, {}\n",
        question.name,
        question.poses_from,
        known(question.frame_free, "tracker frame"),
        known(question.target_free, "target offset"),
    )?;
    writeln!(text, "{:<44} {:>9} {:>6} {:>11}", "candidate parameters", "number", "rank", "condition")?;
    for set in sets {
        let condition =
            if set.condition.is_finite() { format!("{:.0}", set.condition) } else { "singular".to_owned() };
        writeln!(text, "{:<44} {:>9} {:>6} {condition:>11}", set.name, set.columns, set.rank)?;
    }
    let links = |ids: &[ParameterId]| {
        ids.iter().copied().filter(|id| matches!(id, ParameterId::Link { .. })).collect::<Vec<_>>()
    };
    let (kept, groups) = neighbour_axis_rules(&question.model);
    writeln!(text, "\nNeighbour-axis rules keep {}: {}", kept.len(), list(&kept))?;
    for group in groups {
        writeln!(text, "  eliminated  {group}")?;
    }
    writeln!(
        text,
        "\nComplete set by rank: {} parameters, structural rank {}, rank {} at these poses",
        report.selected.len(),
        report.selected.len(),
        report.spectrum.rank
    )?;
    writeln!(text, "  links       {}", list(&links(&report.selected)))?;
    if question.frame_free || question.target_free {
        let others: Vec<_> =
            report.selected.iter().copied().filter(|id| !matches!(id, ParameterId::Link { .. })).collect();
        writeln!(text, "  others      {}", list(&others))?;
    }
    for (finding, title) in [
        (Finding::Structure, "Dependent by structure (left out of the set)"),
        (Finding::Measurements, "Not determined by these poses and this target"),
        (Finding::Weak, "Weak directions (determined, but poorly)"),
    ] {
        let of_kind: Vec<_> = findings.iter().filter(|f| f.finding == finding).collect();
        if of_kind.is_empty() {
            continue;
        }
        writeln!(text, "\n{title}; scaled singular value in brackets:")?;
        for f in of_kind {
            writeln!(text, "  {} [{:.1e}]\n      {}", f.names, f.singular_value, f.advice)?;
        }
    }
    Ok(())
}
