//! `calibrig identifiability --sensors`: one point, three points and full poses at the same poses.

use std::fmt::Write;
use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use super::{Args, CliError, Verdict};
use crate::cli::{print, read_scenario, say};
use crate::pipeline::{PipelineError, SensorResult, compare_sensors};
use calibrig_estimation::identification::Mode;
use calibrig_model::{ParameterId, Unit};

pub(super) fn execute(args: &Args, path: &Path, mode: Mode) -> Result<Verdict, CliError> {
    let scenario = read_scenario(path)?;
    let failed = |source: PipelineError| CliError::Pipeline { file: path.to_path_buf(), source };
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("simulating pose {pos}/{len} {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    let results = compare_sensors(&scenario, scenario.seed, mode, |done, all| {
        bar.set_length(all.into());
        bar.set_position(done.into());
    });
    bar.finish_and_clear();
    let results = results.map_err(failed)?;
    let name = &scenario.name;
    print(&if args.json { as_json(name, mode, &results) } else { as_text(name, mode, &results) })?;
    for result in &results {
        for warning in &result.warnings {
            say(&format!("{}: {warning}", result.sensor.title()));
        }
    }
    let complete = results.iter().all(|result| result.rank == result.parameters.len());
    Ok(if complete { Verdict::Done } else { Verdict::Doubtful })
}

fn as_json(name: &str, mode: Mode, results: &[SensorResult]) -> String {
    let sensors: Vec<_> = results
        .iter()
        .map(|result| {
            let parameters: Vec<_> = result
                .parameters
                .iter()
                .map(|(id, sigma)| json!({ "name": id.to_string(), "unit": id.unit().to_string(), "sigma": sigma }))
                .collect();
            json!({
                "sensor": result.sensor.key(),
                "rank": result.rank,
                "parameter_count": result.parameters.len(),
                "parameters": parameters,
                "held_out_rms_3d_m": result.held_out,
                "held_out_orientation_rms_rad": result.held_out_turn,
                "warnings": result.warnings,
            })
        })
        .collect();
    let value =
        json!({ "schema": "calibrig.sensors/1", "name": name, "mode": mode.key(), "sensors": sensors });
    format!("{value:#}\n")
}

const NAME: usize = 24;
const NUMBER: usize = 14;

fn as_text(name: &str, mode: Mode, results: &[SensorResult]) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write_text(name, mode, results, &mut text);
    text
}

fn write_text(name: &str, mode: Mode, results: &[SensorResult], text: &mut String) -> std::fmt::Result {
    writeln!(text, "{name}, \"{}\": what each sensor can determine at the same poses\n", mode.title())?;
    let line = |text: &mut String, title: &str, cell: &dyn Fn(&SensorResult) -> String| {
        write!(text, "{title:<NAME$}")?;
        for result in results {
            write!(text, "{:>NUMBER$}", cell(result))?;
        }
        writeln!(text)
    };
    line(text, "", &|result| result.sensor.title().to_owned())?;
    line(text, "rank of parameters", &|result| format!("{} of {}", result.rank, result.parameters.len()))?;
    let thousand = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{:.4}", 1e3 * v));
    line(text, "held-out RMS 3D, mm", &|result| thousand(result.held_out))?;
    line(text, "held-out angle RMS, mrad", &|result| thousand(result.held_out_turn))?;
    writeln!(text, "\nstandard deviations")?;
    let mut ids: Vec<ParameterId> = Vec::new();
    for (id, _) in results.iter().flat_map(|result| &result.parameters) {
        let is_tracker = matches!(id, ParameterId::Frame { .. });
        if !is_tracker && !ids.contains(id) {
            ids.push(*id);
        }
    }
    for id in ids {
        let (unit, factor) = match id.unit() {
            Unit::Metre => ("mm", 1e3),
            Unit::Radian => ("mrad", 1e3),
            Unit::One => ("%", 1e2),
        };
        line(text, &format!("{id}, {unit}"), &|result| {
            let own = result.parameters.iter().find(|(own, _)| *own == id);
            own.map_or("-".to_owned(), |(_, sigma)| {
                sigma.map_or("undetermined".to_owned(), |sigma| format!("{:.5}", factor * sigma))
            })
        })?;
    }
    Ok(())
}
