//! `calibrig diagnose`.

use std::fmt::Write;

use serde_json::{Value, json};

use super::identify::{FileArgs, Loaded};
use super::inspect::with_progress;
use super::{CliError, Verdict, print, say};
use crate::pipeline::{Names, PipelineError, SetKind, SetOutcome, commands_beyond_limits, mm};
use calibrig_estimation::diagnosis::{Diagnosis, Finding, Hypothesis, Part, Undetermined, diagnose_with};
use calibrig_estimation::identification::Mode;

/// Say what would make measurements fit a robot: wrong units, signs, zeros, orders, axes, and rows that are to blame
///
/// The nominal robot is laid over the points by the tracker's place and the target's offset, as the files are read and as they could be meant
/// otherwise: every convention alone and every two together. Each is told with the RMS that it leaves, how likely it is against all others,
/// and what applies it. What explains any points of the session equally well is of one class. Full poses are not read yet, so a rotation that
/// is the inverse one is not looked for.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig diagnose --model robot.toml --measurements m.csv
  calibrig diagnose --model robot.toml --measurements m.txt --columns map.toml --json
  calibrig diagnose --model models/ur5/robot.toml --measurements grid.csv --verify random.csv

Exit code 0 if the robot lies on the points as they were read, 3 if something was found, 1 if there is no result.")]
pub(super) struct Args {
    #[command(flatten)]
    files: FileArgs,
    /// Print as JSON (schema calibrig.diagnosis/1)
    #[arg(long)]
    json: bool,
}

/// A set, and what was found of it.
struct Diagnosed {
    kind: SetKind,
    names: Names,
    found: Diagnosis,
    beyond: Vec<String>,
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
                source: PipelineError::Identify { mode: Mode::WithoutCalibration, source },
            })?;
        diagnosed.push(Diagnosed {
            kind: *kind,
            names: Names::new(&robot.model, set),
            found,
            beyond: commands_beyond_limits(&robot.model, set),
        });
    }
    print(&if args.json { as_json(&robot.name, &diagnosed) } else { as_text(&robot.name, &diagnosed) })?;
    let is_sound = diagnosed.iter().all(|set| set.found.finding() == Finding::Sound);
    if !is_sound {
        say("doubtful: the session is not as the robot's files say");
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

/// Whether there are fewer poses than anything can be told of.
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
    let Diagnosed { kind, names, found, beyond } = set;
    let set = if *kind == SetKind::Identification { String::new() } else { format!(", {} set", kind.key()) };
    writeln!(text, "{name}{set}: {} observations, spread {}", found.observations, mm(found.spread))?;
    writeln!(text)?;
    match found.finding() {
        Finding::Sound if is_too_little(found) => {
            writeln!(
                text,
                "Nothing speaks against the files as they were read, but they tell too little of the robot."
            )?;
        }
        Finding::Sound => writeln!(text, "Sound: the robot lies on the points as they were read.")?,
        Finding::Explained => {
            let first = &found.hypotheses[0];
            writeln!(text, "Found: {}.", names.says(first))?;
            writeln!(text, "Remedy: {}.", names.remedies(first))?;
        }
        Finding::Unexplained => {
            writeln!(text, "The robot does not lie on the points, and nothing that was tried explains why.")?;
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
    for line in undetermined.chain(beyond.iter().cloned()) {
        writeln!(text)?;
        writeln!(text, "{line}")?;
    }
    writeln!(text)
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
        "not_tried": { "inverse_rotation": "a diagnosis looks at places, not at rotations" },
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
