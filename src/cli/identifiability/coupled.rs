//! `calibrig identifiability --mode`: all parameters of a coupled mode together.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::super::identify::{compliances, terms};
use super::{Args, CliError, MOUNTABLE_TARGET, SPREAD_POSES, Verdict, scenario_poses, spread_poses};
use crate::cli::print;
use crate::pipeline::{CalibrateError, PipelineError, default_options, planned, planned_at};
use crate::scenario::load_scenario;
use calibrig_estimation::identification::{IdentificationOptions, Mode, Prospect, prospect, reachable_poses};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, ParameterId};

/// A planned session, and what is to be fitted to it.
struct Plan {
    name: String,
    poses_from: String,
    model: CalibrationModel,
    set: MeasurementSet,
    options: IdentificationOptions,
}

pub(super) fn execute(args: &Args, mode: Mode) -> Result<Verdict, CliError> {
    let file = args.model.as_ref().or(args.urdf.as_ref()).or(args.scenario.as_ref());
    let file = file.cloned().unwrap_or_default();
    let mut plan = match &args.scenario {
        None => of_robot(args, &file)?,
        Some(scenario) => of_scenario(scenario)?,
    };
    plan.options.mode = mode;
    if let Some(asked) = &args.compliances {
        plan.options.compliances = compliances(asked, &plan.model);
    }
    if let Some(families) = &args.terms {
        plan.options.terms = Some(terms(families));
    }
    let prospect = prospect(&plan.model, &plan.set, &plan.options)
        .map_err(|source| failed(CalibrateError::Identify { mode, source }.into(), file))?;
    print(&if args.json { as_json(&plan, &prospect) } else { as_text(&plan, &prospect) })?;
    let complete = prospect.spectrum.rank == prospect.parameters.len();
    Ok(if complete { Verdict::Done } else { Verdict::Doubtful })
}

fn failed(source: PipelineError, file: PathBuf) -> CliError {
    CliError::Pipeline { file, source }
}

fn of_scenario(path: &Path) -> Result<Plan, CliError> {
    let scenario = load_scenario(path)?;
    let set = planned(&scenario).map_err(|error| failed(error, path.to_path_buf()))?;
    Ok(Plan {
        poses_from: scenario_poses(&scenario),
        name: scenario.name,
        model: scenario.robot.model,
        set,
        options: scenario.options,
    })
}

fn of_robot(args: &Args, path: &Path) -> Result<Plan, CliError> {
    let robot = args.chain.robot(args.model.as_deref(), args.urdf.as_deref())?;
    robot.remarks.iter().for_each(|remark| super::say(remark));
    let poses = reachable_poses(&robot.model, SPREAD_POSES);
    let set = planned_at(&robot.model, &poses, robot.target().unwrap_or(MOUNTABLE_TARGET))
        .map_err(|error| failed(error, path.to_path_buf()))?;
    let options = IdentificationOptions { tolerance: None, ..default_options(&robot) };
    Ok(Plan { name: robot.name, poses_from: spread_poses(), model: robot.model, set, options })
}

/// Names of the parameters by their kinds.
fn kinds(parameters: &[ParameterId]) -> Vec<(&'static str, Vec<String>)> {
    let kind = |id: &ParameterId| match id {
        ParameterId::Link { .. } => "links",
        ParameterId::Frame { .. } => "frame",
        ParameterId::Target { .. } | ParameterId::Orientation { .. } => "target",
        ParameterId::Compliance(_) => "compliances",
        ParameterId::Mass { .. } | ParameterId::Centre { .. } => "masses",
        ParameterId::Linkage(_) => "linkage",
        ParameterId::Term(_) => "terms",
        ParameterId::Instrument { .. } | ParameterId::Drift { .. } => "tracker",
    };
    let mut kinds: Vec<(&'static str, Vec<String>)> = Vec::new();
    for id in parameters {
        let (kind, name) = (kind(id), id.to_string());
        match kinds.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, names)) => names.push(name),
            None => kinds.push((kind, vec![name])),
        }
    }
    kinds
}

fn words<T: ToString>(items: &[T]) -> Vec<String> {
    items.iter().map(ToString::to_string).collect()
}

fn as_json(plan: &Plan, prospect: &Prospect) -> String {
    let finite = |v: f64| v.is_finite().then_some(v);
    let spectrum = &prospect.spectrum;
    let value = json!({
        "schema": "calibrig.identifiability/1",
        "name": plan.name,
        "poses": plan.poses_from,
        "mode": plan.options.mode.key(),
        "coupled": {
            "parameters": words(&prospect.parameters),
            "rank": spectrum.rank,
            "measured_rank": prospect.measured_rank,
            "condition": finite(spectrum.condition),
            "scaled_singular_values": spectrum.singular_values.iter().map(|v| finite(*v)).collect::<Vec<_>>(),
            "dependent": words(&spectrum.dependent),
            "weak": spectrum.weak.iter().map(|weak| json!({
                "names": weak.to_string(), "scaled_singular_value": finite(weak.singular_value),
            })).collect::<Vec<_>>(),
            "held": words(&prospect.held),
            "fixed": words(&prospect.fixed),
            "unloaded": words(&prospect.unloaded),
            "warnings": words(&prospect.warnings),
        },
    });
    format!("{value:#}\n")
}

fn as_text(plan: &Plan, prospect: &Prospect) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write_text(plan, prospect, &mut text);
    text
}

fn write_text(plan: &Plan, prospect: &Prospect, text: &mut String) -> std::fmt::Result {
    let (mode, n, spectrum) = (plan.options.mode, prospect.parameters.len(), &prospect.spectrum);
    writeln!(text, "{}: mode {} at {}\n", plan.name, mode.key(), plan.poses_from)?;
    writeln!(text, "{n} parameters")?;
    for (kind, names) in kinds(&prospect.parameters) {
        writeln!(text, "  {kind:<12}{:>3}  {}", names.len(), names.join(", "))?;
    }
    let condition = if spectrum.condition.is_finite() {
        format!("condition {:.0}", spectrum.condition)
    } else {
        "singular".to_owned()
    };
    writeln!(text, "\nRank {} of {n} in an estimate, with its priors: {condition}", spectrum.rank)?;
    writeln!(text, "Rank {} of {n} from measurements, nests and target only", prospect.measured_rank)?;
    if !prospect.unloaded.is_empty() {
        let names = words(&prospect.unloaded).join(", ");
        writeln!(text, "Left out, because gravity hardly loads them in these poses: {names}")?;
    }
    for warning in &prospect.warnings {
        writeln!(text, "warning: {warning}")?;
    }
    Ok(())
}
