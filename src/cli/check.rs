//! `calibrig check`.

use std::fmt::Write;
use std::path::PathBuf;

use serde_json::json;

use super::{CliError, Verdict, print, read_scenario, say};
use crate::pipeline::hash_sources;
use crate::scenario::{
    Approach, FactorValues, Layout, Passing, PayloadOrder, PayloadPlan, PoseOrder, Scenario, SessionPlan,
    StationShare,
};
use calibrig_estimation::identification::{
    ComplianceChoice, FrameChoice, Mode, ParameterChoice, TargetChoice,
};
use calibrig_model::JointKind;
use calibrig_model::measurement::SetKind;

/// Validate a scenario and the files it names, and say what would run
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig check scenarios/paper.toml
  calibrig check scenarios/paper.toml --json")]
pub(super) struct Args {
    /// The scenario file
    scenario: PathBuf,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let scenario = read_scenario(&args.scenario)?;
    let text = if args.json { as_json(&scenario) } else { as_text(&scenario) };
    print(&text)?;
    scenario.remarks().iter().for_each(|remark| say(remark));
    Ok(Verdict::Done)
}

fn as_json(scenario: &Scenario) -> String {
    let value = json!({
        "schema": "calibrig.check/1",
        "name": scenario.name,
        "seed": scenario.seed,
        "sha256": hash_sources(&scenario.sources),
        "robot": scenario.robot.name,
        "joints": scenario.robot.model.kinematics.links.iter().map(|l| &l.name).collect::<Vec<_>>(),
        "identification_poses": scenario.identification_poses,
        "verification_poses": scenario.verification_poses,
        "effects": scenario.as_built.effects.active().iter().map(|e| e.key()).collect::<Vec<_>>(),
        "tracker": json_tracker(scenario),
        "session": json_session(scenario),
        "bounds": scenario.options.bounds.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "modes": scenario.modes.iter().map(|m| m.key()).collect::<Vec<_>>(),
        "campaign": scenario.campaign.as_ref().map(|plan| json!({
            "design": plan.layout, "trials": plan.design(None).map_or(0, |design| design.trials()), "factors": plan.factors,
        })),
    });
    format!("{value:#}\n")
}

fn json_tracker(scenario: &Scenario) -> serde_json::Value {
    let instrument = &scenario.tracker.instrument;
    let redrawn = scenario.tracker_for(scenario.seed, 0).map_or(0, |drawn| drawn.errors.redraws);
    json!({
        "name": scenario.tracker.stated().name,
        "random_fraction": instrument.random_fraction,
        "systematic_fraction": instrument.systematic_fraction,
        "redrawn": redrawn,
    })
}

fn json_session(scenario: &Scenario) -> serde_json::Value {
    let plan = &scenario.plan;
    json!({
        "duration_s": scenario.session().duration(),
        "stations": 1 + plan.stations.len(),
        "targets": 1 + plan.targets.len(),
        "readings_per_visit": plan.readings_per_visit(),
        "visits_per_pose": plan.repeats,
        "order": plan.order.key(),
        "poses_shared": plan.share.key(),
        "line_of_sight": plan.sight.is_some(),
        "payloads": plan.payloads.payloads.iter().map(|payload| &payload.stated.name).collect::<Vec<_>>(),
    })
}

fn campaign_lines(scenario: &Scenario, text: &mut String) -> std::fmt::Result {
    let Some(plan) = &scenario.campaign else { return Ok(()) };
    let trials = plan.design(None).map_or(0, |design| design.trials());
    let what = match plan.layout {
        Layout::Plain => "plain",
        Layout::Sweep => "sweep, the same draws for every combination",
        Layout::Indices => "sensitivity indices",
        Layout::Screening => "screening",
    };
    writeln!(text, "  campaign     {what}, {trials} trials")?;
    for factor in &plan.factors {
        let values = match &factor.values {
            FactorValues::Drawn(distribution) => format!(
                "{} to {} in nine of ten trials",
                distribution.quantile(0.05),
                distribution.quantile(0.95)
            ),
            FactorValues::Levels(levels) => levels.join(", "),
        };
        let times = if factor.scale { "times what is stated, " } else { "" };
        writeln!(text, "  {:<12} {}: {times}{values}", "", factor.name)?;
    }
    Ok(())
}

fn as_text(scenario: &Scenario) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write_text(scenario, &mut text);
    text
}

fn write_text(scenario: &Scenario, text: &mut String) -> std::fmt::Result {
    let model = &scenario.robot.model;
    writeln!(text, "{}: valid", scenario.name)?;
    writeln!(text, "  robot        {}, {} joints", scenario.robot.name, model.kinematics.joint_count())?;
    write_joints(scenario, text)?;
    writeln!(
        text,
        "  poses        {} for identification, {} for verification, seed {}",
        scenario.identification_poses, scenario.verification_poses, scenario.seed
    )?;
    let instrument = &scenario.tracker.instrument;
    writeln!(
        text,
        "  tracker      MPE transverse {:.1} um + {:.1} um/m, range {:.1} um + {:.1} um/m, noise {}",
        instrument.transverse.offset * 1e6,
        instrument.transverse.per_metre * 1e6,
        instrument.range.offset * 1e6,
        instrument.range.per_metre * 1e6,
        if instrument.noise { "on" } else { "off" },
    )?;
    write_tracker(scenario, text)?;
    if let Some(probe) = &scenario.probe {
        let mounting = match probe.mounting_sigma {
            Some(sigma) => format!("stated within {:.4} deg", sigma.to_degrees()),
            None => "unknown".to_owned(),
        };
        let sigma = probe.turn_sigma.to_degrees();
        writeln!(
            text,
            "  probe        orientations within {sigma:.4} deg about each axis, mounting {mounting}"
        )?;
    }
    writeln!(text, "  base nests   {}", scenario.nests.len())?;
    payload_lines(scenario, text)?;
    session_lines(scenario, text)?;
    campaign_lines(scenario, text)?;
    for (index, effect) in scenario.as_built.effects.active().iter().enumerate() {
        let title = if index == 0 { "effects" } else { "" };
        writeln!(text, "  {title:<12} {}: {}", effect.title(), effect.about())?;
    }
    let options = &scenario.options;
    let parameters = match &options.parameters {
        ParameterChoice::NeighbourAxisRules => "by the published rules on neighbouring axes".to_owned(),
        ParameterChoice::Complete => "a complete independent set, by rank".to_owned(),
        ParameterChoice::Listed(list) => format!("{} listed", list.len()),
    };
    writeln!(text, "  parameters   {parameters}")?;
    let frame = match options.frame {
        FrameChoice::AsStated => "the base nests if three or more were measured, else free",
        FrameChoice::Nests => "the base nests, with their uncertainty as a prior",
        FrameChoice::Sweeps => "sweeps of two axes, with their uncertainty",
        FrameChoice::Free => "free",
        FrameChoice::Fixed => "the base nests, taken as exact",
    };
    writeln!(text, "  tracker from {frame}")?;
    let target = match options.target {
        TargetChoice::AsStated => "measured if its uncertainty is stated, else identified",
        TargetChoice::Measured => "measured, with its uncertainty as a prior",
        TargetChoice::Identified => "identified",
        TargetChoice::Fixed => "taken as exact",
    };
    writeln!(text, "  target       {target}")?;
    if scenario.modes.iter().any(|mode| mode.is_coupled()) {
        let compliances = match &options.compliances {
            ComplianceChoice::Drives => "of drives and rod that gravity loads".to_owned(),
            ComplianceChoice::All => "all that gravity loads".to_owned(),
            ComplianceChoice::Listed(list) => format!("{} listed", list.len()),
        };
        let prior = if options.stiffness_unknown {
            "unknown".to_owned()
        } else {
            format!("prior 0 +- {} %", 100.0 * options.compliance_sigma)
        };
        writeln!(text, "  compliances  {compliances}, {prior}")?;
    }
    if scenario.modes.contains(&Mode::Extended) {
        let terms =
            options.terms.as_ref().map_or_else(|| "all that the robot can have".to_owned(), |t| t.join(", "));
        writeln!(text, "  terms        {terms}")?;
    }
    for (index, bound) in options.bounds.iter().enumerate() {
        writeln!(text, "  {:<12} {bound}", if index == 0 { "bounds" } else { "" })?;
    }
    let modes: Vec<_> = scenario.modes.iter().map(|m| m.title()).collect();
    writeln!(text, "  rows         {}", modes.join(", "))
}

/// One line per joint.
fn write_joints(scenario: &Scenario, text: &mut String) -> std::fmt::Result {
    let model = &scenario.robot.model;
    for (index, link) in model.kinematics.links.iter().enumerate() {
        let (kind, unit, scale) = match link.kind {
            JointKind::Prismatic => ("P", "mm", 1e3),
            JointKind::Revolute => ("R", "deg", 180.0 / std::f64::consts::PI),
        };
        let (centre, half) = (scenario.region.centre[index], scenario.region.half_width[index]);
        let measured = if model.actuators.is_commanded(index) {
            format!("measured {:9.2} to {:9.2} {unit}", (centre - half) * scale, (centre + half) * scale)
        } else {
            format!("follows, {:10.2} {unit} in the middle", centre * scale)
        };
        writeln!(
            text,
            "    {} {kind} {:<10} {measured}, limits {:9.2} to {:9.2} {unit}",
            index + 1,
            link.name,
            link.limits[0] * scale,
            link.limits[1] * scale,
        )?;
    }
    Ok(())
}

/// What is drawn of the tracker and its session, besides the noise.
fn write_tracker(scenario: &Scenario, text: &mut String) -> std::fmt::Result {
    let tracker = &scenario.tracker;
    let instrument = &tracker.instrument;
    if let Some(preset) = instrument.preset {
        writeln!(text, "               preset {}, after {}", preset.key(), preset.source())?;
        writeln!(text, "               no source gives {}", preset.left_out())?;
    }
    if !instrument.noise {
        return Ok(());
    }
    if instrument.systematic_fraction > 0.0 {
        let redraws = scenario.tracker_for(scenario.seed, 0).map_or(0, |drawn| drawn.errors.redraws);
        writeln!(
            text,
            "               systematic errors of {} of the MPE, drawn; {redraws} redrawn for a failed acceptance test",
            instrument.systematic_fraction
        )?;
    } else if let Some(Passing { passed, tested }) = scenario.passing() {
        writeln!(
            text,
            "               only random errors, of {} of the MPE; of {tested} such instruments {passed} pass their acceptance \
             test",
            instrument.random_fraction
        )?;
    }
    let conditions = &tracker.conditions;
    if let Some(law) = &conditions.environment {
        writeln!(
            text,
            "               air of {:.1} C, {:.1} hPa, {:.0} %; its sensors leave {:.2} ppm of range; {:.2} K/m upwards",
            law.air.temperature,
            law.air.pressure * 1e-2,
            law.air.humidity * 1e2,
            law.scale_sigma() * 1e6,
            law.gradient
        )?;
    }
    if let Some(law) = &conditions.drift {
        writeln!(
            text,
            "               drift of {:.0} um/h, warm-up of {:.0} to {:.0} um, walk of {:.0} um after an hour",
            law.ramp.shift * 1e6,
            law.warm_up[0].shift * 1e6,
            law.warm_up[1].shift * 1e6,
            law.walk.shift * 1e6
        )?;
    }
    if let Some(law) = &conditions.smr {
        writeln!(
            text,
            "               SMR centred within {:.1} um, seated within {:.1} um, visible within {:.0} deg",
            law.centring_sigma * 1e6,
            law.seat_sigma * 1e6,
            law.acceptance.to_degrees()
        )?;
    }
    if conditions.misses > 0.0 {
        writeln!(text, "               {:.2} % of the readings are missing", conditions.misses * 1e2)?;
    }
    Ok(())
}

/// Which poses carry which loads.
fn payload_lines(scenario: &Scenario, text: &mut String) -> std::fmt::Result {
    let plan = &scenario.plan.payloads;
    let order = match plan.order {
        PayloadOrder::Blocks => "in sequence",
        PayloadOrder::Cycle => "a different one at every pose",
    };
    for (kind, carried) in
        SetKind::ALL.into_iter().zip(&plan.carried).filter(|(_, carried)| !carried.is_empty())
    {
        let name = |index: &Option<usize>| match index.and_then(|index| plan.payloads.get(index)) {
            Some(payload) => format!("{} ({:.1} kg)", payload.stated.name, payload.stated.mass),
            None => "nothing".to_owned(),
        };
        let names: Vec<_> = carried.iter().map(name).collect();
        writeln!(text, "  payloads     {}: {}; {order}", kind.key(), names.join(", "))?;
    }
    Ok(())
}

/// How the session is carried out, unless it is one reading per pose in order.
fn session_lines(scenario: &Scenario, text: &mut String) -> std::fmt::Result {
    let plan = &scenario.plan;
    if (SessionPlan { payloads: PayloadPlan::default(), ..plan.clone() }) == SessionPlan::default() {
        return Ok(());
    }
    let names = |first: &str, further: Vec<&str>| {
        std::iter::once(first).chain(further).collect::<Vec<_>>().join(", ")
    };
    let stations = names("1", plan.stations.iter().map(|station| station.name.as_str()).collect());
    let targets = names("SMR", plan.targets.iter().map(|target| target.name.as_str()).collect());
    let minutes = scenario.session().duration() / 60.0;
    let share = if plan.stations.is_empty() {
        String::new()
    } else {
        match plan.share {
            StationShare::Best => {
                "; each pose from the station that sees most targets, of these the nearest".to_owned()
            }
            StationShare::All => "; each pose from all stations that see it".to_owned(),
        }
    };
    writeln!(text, "  session      {minutes:.0} min, including {:.0} s of warm-up", plan.timing.warm_up)?;
    writeln!(text, "    stations   {stations}{share}")?;
    writeln!(text, "    targets    {targets}")?;
    let approach = match plan.approach {
        Approach::AsTravelled => "as travelled".to_owned(),
        Approach::OneSide([along, about]) => {
            format!("from below, {:.1} mm or {:.2} deg", 1e3 * along, about.to_degrees())
        }
        Approach::BothSides([along, about]) => {
            format!("from below and above in turn, {:.1} mm or {:.2} deg", 1e3 * along, about.to_degrees())
        }
    };
    let order = match plan.order {
        PoseOrder::AsDrawn => "as drawn",
        PoseOrder::ShortTravel => "by short paths",
    };
    writeln!(
        text,
        "    poses      {order}, {} each, approached {approach}; {:.1} s a pose",
        match plan.repeats {
            1 => "one visit".to_owned(),
            repeats => format!("{repeats} visits"),
        },
        plan.seconds_per_pose()
    )?;
    let rounds = plan.rounds;
    let between =
        if rounds.every > 0 { format!(", again every {} poses", rounds.every) } else { String::new() };
    let after = if rounds.after { ", and after the last" } else { "" };
    let faces = if rounds.two_faces { ", in both faces" } else { "" };
    writeln!(text, "    nests      before the first pose{between}{after}{faces}")?;
    match &plan.sight {
        None => writeln!(text, "    sight      taken as free, with targets turned to the tracker"),
        Some(sight) => {
            let bare: Vec<_> = sight.obstacles.without_shape().collect();
            let links = if !sight.obstacles.has_links() {
                "not blocked by links".to_owned()
            } else if sight.obstacles.is_chain() {
                "blocked by links as capsules along the chain".to_owned()
            } else if bare.is_empty() {
                "blocked by the shapes of all links".to_owned()
            } else {
                format!("blocked by the shapes of the links; without shapes: {}", bare.join(", "))
            };
            let openings = plan.targets.iter().map(|target| target.opening);
            let turned = std::iter::once(plan.opening).chain(openings).any(|opening| opening.is_some());
            let opening = if turned {
                format!("within {:.1} deg of the axis of a target's opening", sight.acceptance.to_degrees())
            } else {
                "targets turned to the tracker".to_owned()
            };
            writeln!(text, "    sight      {links}, {opening}")
        }
    }
}
