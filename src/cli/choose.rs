//! `calibrig choose`.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use super::identify::{Loaded, LossArg, failed, load};
use super::measured::RowArgs;
use super::model::ChainArgs;
use super::{CliError, Verdict, not_identified, output, print, read_scenario, say};
use crate::pipeline::{
    self, ALL_TERMS, ChosenRow, DEFAULT_TERMS, ModelChoice, PlantKind, choose, default_options, simulate,
    without_drift,
};
use calibrig_estimation::evaluation::{Criteria, Verdict as Worth};
use calibrig_estimation::identification::{LINKAGE, Outlier};
use calibrig_model::FAMILIES;

/// Compare models on poses that they were not fitted to: do gravity, the linkage or hysteresis pay?
///
/// Every model is fitted to all identification poses and then, in turn, to all but a part of them, which it predicts. Each is compared with the
/// model that it extends: gravity with geometry, stiffness with gravity, and the others, one by one and all together, with geometry and
/// stiffness.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig choose scenarios/paper.toml
  calibrig choose scenarios/paper.toml --folds 20 --json
  calibrig choose --model models/ur5/robot.toml --measurements grid.csv

A model pays if the 95 % interval of its gain on held-out poses excludes zero. AICc and BIC take the noise as known up to a common
scale. With files, tracker, target and priors are treated as `calibrig identify` does by default, including the uncertainties that the
robot's file states for stiffnesses, masses and centres (compliance_percent, mass_percent, centre_mm).
Exit code 3 if a fit did not converge or a model could not be fitted.")]
pub(super) struct Args {
    /// The scenario file, whose identification poses are simulated
    #[arg(required_unless_present = "robot", conflicts_with_all = ["robot", "measurements", "columns", "session"])]
    scenario: Option<PathBuf>,
    /// The robot's file
    #[arg(long, value_name = "ROBOT.toml", group = "robot", requires = "measurements")]
    model: Option<PathBuf>,
    /// The robot's URDF in place of a file of its own; read as `calibrig model from-urdf` does
    #[arg(long, value_name = "FILE", group = "robot", requires = "measurements")]
    urdf: Option<PathBuf>,
    #[command(flatten)]
    chain: ChainArgs,
    /// Measured positions to fit and to hold out
    #[arg(long, value_name = "[TARGET=]FILE", requires = "robot")]
    measurements: Vec<String>,
    #[command(flatten)]
    rows: RowArgs,
    /// Column map of the file, instead of the one named in the robot's file
    #[arg(long, value_name = "MAP.toml", requires = "robot")]
    columns: Option<PathBuf>,
    /// Stations with their nests, and targets with their uncertainty (docs/formats.md)
    #[arg(long, value_name = "SESSION.toml", requires = "robot")]
    session: Option<PathBuf>,
    /// Number of parts that are held out in turn; the number of poses holds them out one by one
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    folds: u32,
    /// Seed of the random parts and, instead of the scenario's own, of its draws [default: the scenario's, or 1]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Loss of a measurement far from the others: its square, or less [default: as the scenario states, else squared]
    #[arg(long, value_enum)]
    loss: Option<LossArg>,
    /// Fit even if the nominal robot does not fit the points; ends with exit code 3
    #[arg(long, requires = "robot")]
    fit_anyway: bool,
    /// Print as JSON (schema calibrig.choice/1)
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let (name, choice, plausible) = match &args.scenario {
        Some(scenario) => of_scenario(args, scenario)?,
        None if !args.measurements.is_empty() => of_files(args)?,
        // Refused by the argument parser.
        _ => return Ok(Verdict::Doubtful),
    };
    print(&if args.json { as_json(&name, &choice) } else { as_text(&name, &choice) })?;
    Ok(plausible.and(verdict(&choice)))
}

fn of_scenario(args: &Args, path: &Path) -> Result<(String, ModelChoice, Verdict), CliError> {
    let mut scenario = read_scenario(path)?;
    scenario.verification_poses = 0;
    if let Some(loss) = args.loss {
        scenario.options.solver.loss = loss.into();
    }
    let seed = args.seed.unwrap_or(scenario.seed);
    let bar = bar("simulating pose {pos}/{len} {bar:40} {elapsed}");
    let simulation = simulate(&scenario, seed, 0, PlantKind::Rapier, |done, total| {
        bar.set_length(total.into());
        bar.set_position(done.into());
    });
    bar.finish_and_clear();
    let source = &scenario.sources[0].1;
    let refused = |error: pipeline::PipelineError| {
        not_identified(error, path, source, source.place_of("poses.identification"))
    };
    let sets = simulation.and_then(|simulation| without_drift(simulation.sets)).map_err(refused)?.sets;
    let choice = compare(|progress| {
        let measured = &sets[0].measurements;
        choose(&scenario.robot.model, measured, &scenario.options, args.folds as usize, seed, progress)
    });
    Ok((scenario.name.clone(), choice.map_err(|error| refused(error.into()))?, Verdict::Done))
}

fn of_files(args: &Args) -> Result<(String, ModelChoice, Verdict), CliError> {
    let asked = args.rows.sets(&args.measurements, &[], None);
    let first = asked.first().and_then(|set| set.files.points.first());
    let measurements = &first.map(|file| file.path.clone()).unwrap_or_default();
    let robot = args.chain.robot(args.model.as_deref(), args.urdf.as_deref())?;
    let loaded = load(robot, args.columns.as_deref(), args.session.as_deref(), &args.rows, asked)?;
    loaded.check_session()?;
    let Loaded { robot, sets, places, read, statements, .. } = loaded;
    for line in &read {
        say(line);
    }
    let mut options = default_options(&robot);
    options.solver.loss = args.loss.map_or(options.solver.loss, Into::into);
    let sets = without_drift(sets).map_err(|error| failed(error, measurements, &[], &places))?.sets;
    let plausible = output::plausible(&robot.model, &sets, &options, args.fit_anyway)
        .map_err(|error| failed(error, measurements, &sets, &places))?;
    let seed = args.seed.unwrap_or(1);
    let choice = compare(|progress| {
        choose(&robot.model, &sets[0].measurements, &options, args.folds as usize, seed, progress)
    });
    let choice = choice.map_err(|error| failed(error, measurements, &sets, &places))?;
    statements.remarks.iter().chain(&statements.assumed).for_each(|line| say(line));
    Ok((robot.name, choice, plausible))
}

fn compare(
    choose: impl FnOnce(&mut dyn FnMut(usize, usize, &str)) -> Result<ModelChoice, pipeline::CalibrateError>,
) -> Result<ModelChoice, pipeline::CalibrateError> {
    let bar = bar("fitting model {pos}/{len}: {msg} {elapsed}");
    let choice = choose(&mut |done, models, name| {
        bar.set_length(models as u64);
        bar.set_position(done as u64 + 1);
        bar.set_message(name.to_owned());
    });
    bar.finish_and_clear();
    choice
}

fn bar(template: &str) -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

fn verdict(choice: &ModelChoice) -> Verdict {
    let mut verdict = Verdict::Done;
    for row in choice.rows.iter().filter(|row| row.not_converged > 0) {
        verdict = Verdict::Doubtful;
        let (name, count, fits) = (&row.row.name, row.not_converged, choice.folds + 1);
        say(&format!("doubtful: {name}: {count} of {fits} fits did not converge"));
    }
    if !choice.gross_errors.is_empty() {
        let named: Vec<_> = choice.gross_errors.iter().map(ToString::to_string).collect();
        let named = named.join(", ");
        if Outlier::are_a_reason(&choice.gross_errors) {
            verdict = Verdict::Doubtful;
            say(&format!(
                "doubtful: gross errors have full weight in every fit: {named}; `--loss tukey` leaves them out"
            ));
        } else {
            say(&format!("left out as gross errors: {named}"));
        }
    }
    for failure in &choice.failures {
        verdict = Verdict::Doubtful;
        say(&format!("doubtful: {} could not be fitted: {}", failure.name, failure.why));
    }
    verdict
}

fn as_text(name: &str, choice: &ModelChoice) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write_text(name, choice, &mut text);
    text
}

fn write_text(name: &str, choice: &ModelChoice, text: &mut String) -> std::fmt::Result {
    writeln!(text, "{name}: {} poses, held out in {} parts", choice.poses, choice.folds)?;
    writeln!(text)?;
    writeln!(
        text,
        "{:<21}{:>7}{:>7}{:>10}{:>10}{:>10}{:>10}  gain (95 %)",
        "model", "params", "eff.", "chi2/dof", "dAICc", "dBIC", "held out"
    )?;
    writeln!(text, "{:<21}{:>7}{:>7}{:>10}{:>10}{:>10}{:>10}  mm", "", "", "", "", "", "", "mm")?;
    writeln!(text, "{}", "\u{2500}".repeat(97))?;
    for ChosenRow { row, .. } in &choice.rows {
        let mm = |metres: f64| format!("{:.4}", 1e3 * metres);
        let gain = row.gain.map_or(String::new(), |gain| {
            format!("{:+.4} ({:+.4}, {:+.4})", 1e3 * gain.value, 1e3 * gain.low, 1e3 * gain.high)
        });
        let line = format!(
            "{:<21}{:>7}{:>7.1}{:>10}{:>10}{:>10}{:>10}  {gain}",
            row.name,
            row.parameters,
            row.effective_parameters,
            row.chi2_per_dof.map_or_else(|| "-".to_owned(), |v| format!("{v:.4}")),
            difference(row.above_best.aicc),
            difference(row.above_best.bic),
            row.held_out_rms.map_or_else(|| "-".to_owned(), mm),
        );
        writeln!(text, "{}", line.trim_end())?;
    }
    writeln!(text)?;
    for row in &choice.rows {
        if let Some(words) = in_words(row) {
            writeln!(text, "{words}")?;
        }
    }
    for failure in &choice.failures {
        writeln!(text, "{}: could not be fitted: {}", failure.name, failure.why)?;
    }
    for name in &choice.without_basis {
        let hint = if name.ends_with("hysteresis") {
            ": no signs of approach are stated (--approach-from-order takes them from the order of the rows)"
        } else {
            ""
        };
        writeln!(text, "{name}: not compared: nothing that was measured depends on it{hint}")?;
    }
    writeln!(text)?;
    writeln!(text, "{}", advice(choice))
}

fn difference(value: f64) -> String {
    if value.is_finite() { format!("{value:.1}") } else { "-".to_owned() }
}

/// What a step is worth, and compared with what.
fn in_words(row: &ChosenRow) -> Option<String> {
    let row = &row.row;
    let against = row.against.as_ref()?;
    let size = row.gain.map_or(0.0, |gain| 1e3 * gain.value);
    let why = match row.verdict {
        Worth::Pays => format!("predicts held-out poses better, by {size:.3} mm RMS"),
        Worth::Hurts => format!("predicts held-out poses worse, by {:.3} mm RMS", -size),
        Worth::Undecided => "fits better, but not beyond chance on held-out poses".to_owned(),
        _ => "neither held-out poses nor AICc support it".to_owned(),
    };
    Some(format!("{}: {} ({why}; against {against})", row.name, row.verdict))
}

/// The flags of `identify` for the best model: all together if that predicts best; else the largest model of the chain that pays, with the terms that
/// pay.
fn advice(choice: &ModelChoice) -> String {
    let paying = |key: &str| choice.rows.iter().any(|row| row.key == key && row.row.verdict == Worth::Pays);
    let rms = |row: &ChosenRow| row.row.held_out_rms.unwrap_or(f64::INFINITY);
    let best = choice.rows.iter().min_by(|a, b| rms(a).total_cmp(&rms(b)));
    if let Some(best) = best.filter(|best| [DEFAULT_TERMS, ALL_TERMS].contains(&best.key) && paying(best.key))
    {
        let compared = |key: &&str| choice.rows.iter().any(|row| row.key == *key);
        let families = || std::iter::once(LINKAGE).chain(FAMILIES.iter().map(|family| family.key()));
        let terms = if best.key == ALL_TERMS {
            format!(" --terms {}", families().filter(compared).collect::<Vec<_>>().join(","))
        } else {
            String::new()
        };
        let geometry = if compared(&"complete_geometry") { ", with a complete geometry" } else { "" };
        let rms = 1e3 * rms(best);
        return format!(
            "Worth fitting: --mode extended{terms}{geometry}: {rms:.3} mm RMS on held-out poses."
        );
    }
    // A family that extends another one is fitted together with it.
    let needed =
        |key: &&str| FAMILIES.iter().any(|family| family.extends() == Some(*key) && paying(family.key()));
    let families = std::iter::once(LINKAGE).chain(FAMILIES.iter().map(|family| family.key()));
    let terms: Vec<_> = families.filter(|key| paying(key) || needed(key)).collect();
    if !terms.is_empty() || paying("complete_geometry") {
        let terms = if terms.is_empty() { "none".to_owned() } else { terms.join(",") };
        let geometry = if paying("complete_geometry") { ", with a complete geometry" } else { "" };
        return format!(
            "Worth fitting: --mode extended --terms {terms}{geometry}; the gain of all together is not the sum of these, so \
             compare again on new poses."
        );
    }
    let mode = if paying("stiffness") {
        "elasto_geometric"
    } else if paying("gravity") {
        "with_gravity"
    } else {
        "only_calibration"
    };
    format!("Worth fitting: --mode {mode}.")
}

fn as_json(name: &str, choice: &ModelChoice) -> String {
    let finite = |v: f64| v.is_finite().then_some(v);
    let criteria =
        |c: &Criteria| json!({ "aic": finite(c.aic), "aicc": finite(c.aicc), "bic": finite(c.bic) });
    let row = |chosen: &ChosenRow| -> Value {
        let row = &chosen.row;
        json!({
            "key": chosen.key,
            "name": row.name,
            "against": row.against,
            "parameters": row.parameters,
            "effective_parameters": finite(row.effective_parameters),
            "chi2_per_dof": row.chi2_per_dof.and_then(finite),
            "above_best": criteria(&row.above_best),
            "held_out_rms_m": row.held_out_rms.and_then(finite),
            "gain_m": row.gain.map(|gain| finite(gain.value)),
            "gain_interval_m": row.gain.map(|gain| [finite(gain.low), finite(gain.high)]),
            "verdict": row.verdict.key(),
            "not_converged": chosen.not_converged,
        })
    };
    let value = json!({
        "schema": "calibrig.choice/1",
        "name": name,
        "poses": choice.poses,
        "folds": choice.folds,
        "models": choice.rows.iter().map(row).collect::<Vec<_>>(),
        "gross_errors": choice.gross_errors.iter().map(|o| json!({
            "pose": o.pose, "distance_m": finite(o.distance), "size": finite(o.size), "weight": finite(o.weight),
        })).collect::<Vec<_>>(),
        "failures": choice.failures.iter().map(|f| json!({ "name": f.name, "why": f.why })).collect::<Vec<_>>(),
        "not_compared": choice.without_basis,
        "advice": advice(choice),
    });
    format!("{value:#}\n")
}
