//! `calibrig diagnose`.

use std::fmt::Write;

use serde_json::{Value, json};

use super::identify::{FileArgs, Loaded};
use super::inspect::with_progress;
use super::{CliError, Verdict, print, say};
use crate::pipeline::{CalibrateError, Names, SetKind, SetOutcome, commands_beyond_limits, mm};
use calibrig_estimation::diagnosis::{
    Diagnosis, Finding, Hypothesis, OrientationFinding, Orientations, Part, Undetermined, diagnose_with,
    orientations,
};
use calibrig_estimation::identification::Mode;
use calibrig_model::measurement::Reading;

/// Find out what would make measurements fit a robot: wrong units, signs, zeros, orders, axes, and bad rows
///
/// The nominal robot is fitted to the points by the tracker's place and the target's offset, with the files as they are read and as they
/// could be meant otherwise: every convention alone and every two together. Each is listed with the RMS that it leaves, its likelihood
/// against all others, and how to apply it. Readings that fit any points of the session equally well form one class. Orientations of full
/// poses are not used for this: whether they turn as the robot does, or the other way round, is reported separately.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig diagnose --model robot.toml --measurements m.csv
  calibrig diagnose --model robot.toml --measurements m.txt --columns map.toml --json
  calibrig diagnose --model models/ur5/robot.toml --measurements grid.csv --verify random.csv

Exit code 0 if the robot fits the points as they were read, 3 if something was found, 1 if there is no result.")]
pub(super) struct Args {
    #[command(flatten)]
    files: FileArgs,
    /// Print as JSON (schema calibrig.diagnosis/1)
    #[arg(long)]
    json: bool,
}

/// A set, and what was found in it.
struct Diagnosed {
    kind: SetKind,
    names: Names,
    found: Diagnosis,
    beyond: Vec<String>,
    /// Of full poses.
    orientations: Option<Orientations>,
    /// Readings that are full poses.
    poses: usize,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let loaded = args.files.read()?;
    loaded.check_session()?;
    let Loaded { robot, sets, .. } = loaded;
    let mut diagnosed = Vec::new();
    for SetOutcome { kind, measurements: set, .. } in &sets {
        if *kind != SetKind::Identification && set.observations.is_empty() {
            continue;
        }
        let found = with_progress("diagnosing", |progress| diagnose_with(&robot.model, set, progress))
            .map_err(|source| CliError::Pipeline {
                file: args.files.first(),
                source: CalibrateError::Identify { mode: Mode::WithoutCalibration, source }.into(),
            })?;
        diagnosed.push(Diagnosed {
            kind: *kind,
            names: Names::new(&robot.model, set),
            found,
            beyond: commands_beyond_limits(&robot.model, set),
            orientations: orientations(&robot.model, set),
            poses: set.observations.iter().filter(|o| matches!(o.reading, Reading::Pose(_))).count(),
        });
    }
    print(&if args.json { as_json(&robot.name, &diagnosed) } else { as_text(&robot.name, &diagnosed) })?;
    let turns_well = |set: &Diagnosed| {
        set.orientations.is_none_or(|found| found.finding() == OrientationFinding::AsTheRobot)
    };
    let is_sound = diagnosed.iter().all(|set| set.found.finding() == Finding::Sound && turns_well(set));
    if !is_sound {
        say("doubtful: the measurements do not fit the robot's files as they were read");
    }
    Ok(if is_sound { Verdict::Done } else { Verdict::Doubtful })
}

fn finding(found: &Diagnosis) -> &'static str {
    match found.finding() {
        Finding::Sound => "sound",
        Finding::Explained => "explained",
        Finding::Unexplained => "unexplained",
    }
}

/// Whether there are too few poses for any conclusion.
fn is_too_little(found: &Diagnosis) -> bool {
    found.undetermined.iter().any(|what| matches!(what, Undetermined::FewPoses { .. }))
}

/// How sure: per cent, never a certainty.
fn likelihood(probability: f64) -> String {
    match 1e2 * probability {
        share if share > 99.9 => "> 99.9 %".to_owned(),
        share if share < 0.1 => "< 0.1 %".to_owned(),
        share => format!("{share:.1} %"),
    }
}

fn as_text(name: &str, sets: &[Diagnosed]) -> String {
    let mut text = String::new();
    for set in sets {
        // Writing to a String cannot fail.
        let _ = write_text(name, set, &mut text);
    }
    text
}

fn write_text(name: &str, set: &Diagnosed, text: &mut String) -> std::fmt::Result {
    let Diagnosed { kind, names, found, beyond, .. } = set;
    let which =
        if *kind == SetKind::Identification { String::new() } else { format!(", {} set", kind.key()) };
    writeln!(text, "{name}{which}: {} observations, spread {}", found.observations, mm(found.spread))?;
    writeln!(text)?;
    match found.finding() {
        Finding::Sound if is_too_little(found) => {
            writeln!(
                text,
                "Nothing contradicts the files as they were read, but they say too little about the robot."
            )?;
        }
        Finding::Sound => writeln!(text, "Sound: the robot fits the points as they were read.")?,
        Finding::Explained => {
            let first = &found.hypotheses[0];
            writeln!(text, "Found: {}.", names.says(first))?;
            writeln!(text, "Remedy: {}.", names.remedies(first))?;
        }
        Finding::Unexplained => {
            writeln!(text, "The robot does not fit the points, and nothing that was tried explains why.")?;
        }
    }
    for other in Names::as_good(found).filter(|other| !other.parts.is_empty()) {
        writeln!(text, "Just as good: {}. Remedy: {}.", names.says(other), names.remedies(other))?;
    }
    if !found.hypotheses.is_empty() {
        writeln!(text)?;
        writeln!(text, "{:>12}{:>14}{:>12}  read as", "RMS", "links fitted", "likelihood")?;
    }
    for hypothesis in &found.hypotheses {
        let Hypothesis { rms, rms_links, probability, .. } = hypothesis;
        writeln!(
            text,
            "{:>12}{:>14}{:>12}  {}",
            mm(*rms),
            mm(*rms_links),
            likelihood(*probability),
            names.says(hypothesis)
        )?;
    }
    let undetermined = found.undetermined.iter().map(|what| names.undetermined(what));
    for line in undetermined.chain(beyond.iter().cloned()).chain(orientation_words(set)) {
        writeln!(text)?;
        writeln!(text, "{line}")?;
    }
    writeln!(text)
}

/// What is said about the orientations of full poses.
fn orientation_words(set: &Diagnosed) -> Option<String> {
    const UNUSED: &str = "the hypotheses above are weighed by positions only";
    if set.poses == 0 {
        return None;
    }
    let Some(found) = &set.orientations else {
        return Some(format!(
            "Orientations of {} full poses are too few, or turn about only one axis, so their convention cannot be checked; \
             {UNUSED}.",
            set.poses
        ));
    };
    let mrad = |angle: f64| format!("{:.1} mrad", 1e3 * angle);
    let (as_read, inverted) = (mrad(found.as_read), mrad(found.inverted));
    Some(match found.finding() {
        OrientationFinding::AsTheRobot => format!(
            "Orientations of {} full poses turn as the robot does, within {as_read} from pose to pose (RMS); {UNUSED}.",
            found.readings
        ),
        OrientationFinding::Inverted => format!(
            "Orientations of {} full poses turn the other way round: within {inverted} if inverted, {as_read} as read. \
             Remedy: the other transform in [rotation] of the column map (\"tracker_in_target\" for \"target_in_tracker\", or \
             back), or for Euler angles the reversed sequence. {UNUSED}.",
            found.readings
        ),
        OrientationFinding::Otherwise => format!(
            "Orientations of {} full poses do not turn as the robot does, by {as_read} from pose to pose ({inverted} if inverted). Unless something above explains \
             the positions: check form, order and sequence in [rotation] of the column map. {UNUSED}.",
            found.readings
        ),
    })
}

fn json_orientations(set: &Diagnosed) -> Value {
    let Some(found) = &set.orientations else { return Value::Null };
    json!({
        "readings": found.readings,
        "finding": match found.finding() {
            OrientationFinding::AsTheRobot => "as_the_robot",
            OrientationFinding::Inverted => "inverted",
            OrientationFinding::Otherwise => "otherwise",
        },
        "as_read_rad": found.as_read,
        "inverted_rad": found.inverted,
    })
}

fn as_json(name: &str, sets: &[Diagnosed]) -> String {
    let mut document = json!({ "schema": "calibrig.diagnosis/1", "name": name });
    for set in sets {
        let value = of_set(set);
        match (set.kind, value, &mut document) {
            (SetKind::Identification, Value::Object(value), Value::Object(document)) => {
                document.extend(value);
            }
            (kind, value, document) => document[kind.key()] = value,
        }
    }
    format!("{document:#}\n")
}

fn of_set(set: &Diagnosed) -> Value {
    let Diagnosed { names, found, beyond, .. } = set;
    let finite = |v: f64| v.is_finite().then_some(v);
    json!({
        "finding": finding(found),
        "observations": found.observations,
        "spread_m": finite(found.spread),
        "hypotheses": found.hypotheses.iter().map(|h| of_hypothesis(names, h)).collect::<Vec<_>>(),
        "undetermined": found.undetermined.iter().map(|what| names.undetermined(what)).collect::<Vec<_>>(),
        "beyond_limits": beyond,
        "orientations": json_orientations(set),
        "not_tried": { "inverse_rotation": "hypotheses are weighed by positions; orientations are reported separately" },
    })
}

fn of_hypothesis(names: &Names, hypothesis: &Hypothesis) -> Value {
    let finite = |v: f64| v.is_finite().then_some(v);
    let mut all: Vec<Value> = Vec::new();
    let mut parts = Vec::new();
    for part in &hypothesis.parts {
        let (joints, rows) = names.places(part);
        let places = joints.iter().map(|name| json!(name)).chain(rows.iter().map(|row| json!(row)));
        places.for_each(|place| {
            if !all.contains(&place) {
                all.push(place);
            }
        });
        let mut value = json!({
            "kind": part.kind(),
            "joints": joints,
            "rows": rows,
            "says": names.part(part),
            "remedy": names.remedy(part),
        });
        if let Part::SeveralTargets { others, .. } = part {
            let numbers = |rows: &Vec<usize>| rows.iter().map(|row| names.row(*row)).collect::<Vec<_>>();
            value["groups"] = json!(others.iter().map(numbers).collect::<Vec<_>>());
        }
        parts.push(value);
    }
    json!({
        "kinds": hypothesis.kinds(),
        "where": all,
        "rms_m": finite(hypothesis.rms),
        "remedy": if parts.is_empty() { "none".to_owned() } else { names.remedies(hypothesis) },
        "says": names.says(hypothesis),
        "rms_links_fitted_m": finite(hypothesis.rms_links),
        "probability": finite(hypothesis.probability),
        "class": hypothesis.class,
        "parts": parts,
    })
}
