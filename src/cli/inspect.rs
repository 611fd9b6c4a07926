//! `calibrig inspect`.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::{CliError, Verdict, print};
use calibrig_recording::{
    EstimateReport, FaultyPart, Health, Inspection, ProvenanceReport, ProvenanceState, RecordingError,
    SetReport, State, TopicReport, inspect,
};

/// Say what is in a recording, or in any MCAP file, and whether it is sound
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig inspect runs/paper/recording.mcap
  calibrig inspect out/recording.mcap.part           left by a run that was killed
  calibrig inspect runs/paper/recording.mcap --json

Exit code 3 if the file is unfinished, truncated or damaged.")]
pub(super) struct Args {
    /// The file
    file: PathBuf,
    /// Print as JSON (schema calibrig.inspect/1)
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let inspection = with_progress("reading", |progress| inspect(&args.file, progress))
        .map_err(|e| named(&args.file, e))?;
    let text = if args.json {
        let json = serde_json::to_string_pretty(&inspection)
            .map_err(|error| CliError::Output { what: "JSON".to_owned(), source: error.into() })?;
        json + "\n"
    } else {
        as_text(&inspection, &args.file)
    };
    print(&text)?;
    Ok(if inspection.health.state == State::Whole { Verdict::Done } else { Verdict::Doubtful })
}

/// The error, with the file's name unless the error says it itself.
pub(super) fn named(file: &Path, error: RecordingError) -> CliError {
    match error {
        source @ RecordingError::NotMcap => CliError::Mcap { file: file.to_path_buf(), source },
        error => error.into(),
    }
}

/// Does work that reports how many bytes of how many are done: shown if it takes longer than two seconds.
pub(super) fn with_progress<T>(what: &str, work: impl FnOnce(&mut dyn FnMut(u64, u64)) -> T) -> T {
    let bar = ProgressBar::hidden();
    if let Ok(style) = ProgressStyle::with_template("{msg} {percent:>3} % {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    bar.set_message(what.to_owned());
    let mut shown = false;
    let value = work(&mut |done, total| {
        if !shown && bar.elapsed() > Duration::from_secs(2) {
            shown = true;
            bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        if shown {
            bar.set_length(total);
            bar.set_position(done);
        }
    });
    bar.finish_and_clear();
    value
}

fn as_text(inspection: &Inspection, file: &Path) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write_text(inspection, file, &mut text);
    text
}

fn write_text(inspection: &Inspection, file: &Path, text: &mut String) -> std::fmt::Result {
    let library = match inspection.library.as_str() {
        "" => "does not say which program wrote it".to_owned(),
        library => format!("written by {library}"),
    };
    writeln!(text, "{}: {} bytes of MCAP, {library}", inspection.file, inspection.bytes)?;
    if !inspection.calibrig {
        writeln!(text, "  not a calibrig recording: it holds no metadata and no message of calibrig")?;
    }
    if inspection.recovered {
        writeln!(text, "  saved by `calibrig recover` from a damaged or unfinished file")?;
    }
    writeln!(text, "\nhealth      {}", state_words(&inspection.health))?;
    write_faults(&inspection.health, text)?;
    writeln!(text, "  checksums {}", checksum_words(&inspection.health))?;
    writeln!(text, "  recover   {}", recover_words(inspection, file))?;
    if let Some(provenance) = &inspection.provenance {
        write_provenance(provenance, text)?;
    }
    write_sets(&inspection.sets, text)?;
    write_estimates(&inspection.estimates, text)?;
    write_topics(&inspection.topics, text)?;
    if !inspection.attachments.is_empty() {
        let rows = inspection.attachments.iter().map(|attachment| {
            vec![attachment.name.clone(), attachment.bytes.to_string(), attachment.media_type.clone()]
        });
        write_table(&["attachment", "bytes", "type"], &rows.collect::<Vec<_>>(), &[1], text)?;
    }
    Ok(())
}

fn state_words(health: &Health) -> String {
    match (health.state, health.damaged_at) {
        (State::Whole, _) => whole_words(health).to_owned(),
        (State::Unfinished, _) => "unfinished: the program that wrote it did not finish".to_owned(),
        (State::Truncated, _) => "truncated: it ends in the middle".to_owned(),
        (State::Damaged, Some(at)) => format!("damaged at byte {at}"),
        (State::Damaged, None) => {
            "damaged, but in no part that holds data: a checksum over the whole file does not match"
                .to_owned()
        }
    }
}

/// What can be said of a file in which nothing is wrong; a missing checksum is not a matching one.
pub(super) fn whole_words(health: &Health) -> &'static str {
    let any = health.checksum_of_data == Some(true)
        || health.checksum_of_summary == Some(true)
        || health.checksums > 0;
    match (health.lost.contains_key(&FaultyPart::OpaqueChunk), health.holds_unprotected(), any) {
        (true, ..) => "whole, as far as it was checked: chunks of another compression were not",
        (_, false, true) => "whole: every part is there, and every checksum matches",
        (_, true, true) => "whole: every part is there, and every checksum matches, but some parts have none",
        (_, _, false) => "every part is there, but without a checksum changes would go unnoticed",
    }
}

/// The faults of a file, one per line.
pub(super) fn write_faults(health: &Health, text: &mut String) -> std::fmt::Result {
    for fault in health.faults.iter().take(10) {
        let part = fault.part.title();
        writeln!(text, "  byte {}: {part} of {} bytes: {}", fault.offset, fault.bytes, fault.reason)?;
    }
    let all: u64 = health.lost.values().sum();
    let told = health.faults.len().min(10) as u64;
    if all > told {
        writeln!(text, "  and {} more", all - told)?;
    }
    if health.bytes_unread > 0 {
        writeln!(text, "  {} bytes are not readable", health.bytes_unread)?;
    }
    Ok(())
}

fn checksum_words(health: &Health) -> String {
    let whole = |name: &str, there: Option<bool>| match there {
        Some(true) => format!("of the {name}"),
        Some(false) => format!("none of the {name}"),
        None => format!("of the {name} not there"),
    };
    let parts = match health.without_checksum {
        0 => "of every part that is read".to_owned(),
        n => format!("none of their own of {n} messages or attachments"),
    };
    format!(
        "{parts}; {}; {}",
        whole("data section", health.checksum_of_data),
        whole("summary", health.checksum_of_summary)
    )
}

fn recover_words(inspection: &Inspection, file: &Path) -> String {
    let saved = inspection.recoverable;
    let lost = match saved.messages_lost {
        Some(lost) => format!(" of {}", saved.messages + lost),
        None => String::new(),
    };
    match (inspection.health.state, saved.messages) {
        (State::Whole, _) => "not needed".to_owned(),
        (_, 0) => "nothing can be saved: no message can be read".to_owned(),
        (_, messages) => {
            let all = if saved.anything_lost { "" } else { ": nothing in it is lost" };
            format!("`calibrig recover {} NEW` saves {messages}{lost} messages{all}", file.display())
        }
    }
}

fn write_provenance(provenance: &ProvenanceReport, text: &mut String) -> std::fmt::Result {
    let fits = match provenance.state {
        ProvenanceState::Fits => "matches its hash",
        ProvenanceState::Newer => "not checked",
        ProvenanceState::Altered => "does not match its hash",
    };
    writeln!(text, "\nprovenance  {fits}")?;
    if let Some(problem) = &provenance.problem {
        writeln!(text, "  {problem}")?;
    }
    let numbers = [
        provenance.method.map(|method| format!("method {method}")),
        provenance.seed.map(|seed| format!("seed {seed}")),
        provenance.trial.map(|trial| format!("trial {trial}")),
        provenance.plant.as_ref().map(|plant| format!("plant {plant}")),
    ];
    let numbers: Vec<String> = numbers.into_iter().flatten().collect();
    for (name, value) in [
        ("software", &provenance.software),
        ("schema", &provenance.schema),
        ("input", &format!("{} {}", provenance.input_kind, provenance.input_name)),
        ("sha256", &provenance.input_sha256),
        ("numbers", &numbers.join(", ")),
        ("hash", &provenance.provenance_sha256),
    ] {
        if !value.trim().is_empty() {
            writeln!(text, "  {name:<9} {value}")?;
        }
    }
    Ok(())
}

/// What was measured, one line per set.
pub(super) fn write_sets(sets: &[SetReport], text: &mut String) -> std::fmt::Result {
    let number = |value: Option<u32>| value.map_or_else(|| "?".to_owned(), |value| value.to_string());
    let rows: Vec<_> = sets
        .iter()
        .map(|set| {
            let state = match (set.described, set.complete) {
                (false, _) => "its session is missing",
                (true, true) => "complete",
                (true, false) => "not complete",
            };
            vec![
                set.set.to_owned(),
                set.poses.to_string(),
                number(set.planned),
                set.dropped.to_string(),
                set.observations.to_string(),
                number(set.expected),
                set.stations.to_string(),
                set.targets.to_string(),
                set.nests.to_string(),
                [
                    (set.full_poses > 0).then(|| format!("; {} full poses", set.full_poses)),
                    (set.back_face > 0).then(|| format!("; {} of the back face", set.back_face)),
                ]
                .into_iter()
                .flatten()
                .fold(state.to_owned(), |said, more| said + &more),
            ]
        })
        .collect();
    let heads = [
        "set",
        "poses",
        "planned",
        "dropped",
        "observations",
        "of",
        "stations",
        "targets",
        "nest readings",
        "",
    ];
    write_table(&heads, &rows, &[1, 2, 3, 4, 5, 6, 7, 8], text)?;
    for set in sets.iter().filter(|set| !set.payloads.is_empty()) {
        let carried: Vec<_> = set.payloads.iter().map(ToString::to_string).collect();
        writeln!(text, "  {} carried {}", set.set, carried.join(", "))?;
    }
    Ok(())
}

fn write_estimates(estimates: &[EstimateReport], text: &mut String) -> std::fmt::Result {
    let rms = |estimate: &EstimateReport| {
        let sets = estimate.rms_3d_m.iter().map(|(set, rms)| format!("{set} {:.4}", 1e3 * rms));
        sets.collect::<Vec<_>>().join(", ")
    };
    let rows = estimates.iter().map(|estimate| {
        vec![
            estimate.mode.clone(),
            estimate.parameters.to_string(),
            estimate.chi2_per_dof.map_or_else(|| "-".to_owned(), |ratio| format!("{ratio:.3}")),
            if estimate.termination.is_empty() { "-".to_owned() } else { estimate.termination.clone() },
            rms(estimate),
        ]
    });
    let heads = ["estimate", "parameters", "chi2/dof", "ended with", "RMS 3-D mm"];
    write_table(&heads, &rows.collect::<Vec<_>>(), &[1, 2], text)
}

fn write_topics(topics: &[TopicReport], text: &mut String) -> std::fmt::Result {
    let seconds = |time: Option<u64>| {
        time.map_or_else(
            || "-".to_owned(),
            |ns| format!("{}.{:03}", ns / 1_000_000_000, ns / 1_000_000 % 1000),
        )
    };
    let rows = topics.iter().map(|topic| {
        vec![
            topic.topic.clone(),
            topic.messages.to_string(),
            topic.lost.filter(|&lost| lost > 0).map_or_else(String::new, |lost| lost.to_string()),
            topic.bytes.to_string(),
            seconds(topic.first_ns),
            seconds(topic.last_ns),
            topic.rate_hz.map_or_else(|| "-".to_owned(), |rate| format!("{rate:.3}")),
            if topic.schema.is_empty() { topic.encoding.clone() } else { topic.schema.clone() },
        ]
    });
    let heads = ["topic", "messages", "lost", "bytes", "first s", "last s", "Hz", "schema"];
    write_table(&heads, &rows.collect::<Vec<_>>(), &[1, 2, 3, 4, 5, 6], text)
}

/// A table with a blank line in front; nothing if it has no rows. Columns that are empty throughout are left out.
fn write_table(heads: &[&str], rows: &[Vec<String>], right: &[usize], text: &mut String) -> std::fmt::Result {
    if rows.is_empty() {
        return Ok(());
    }
    writeln!(text)?;
    let width = |column: usize| {
        let longest = rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
        if longest == 0 { 0 } else { longest.max(heads[column].chars().count()) }
    };
    let widths: Vec<usize> = (0..heads.len()).map(width).collect();
    let heads = heads.iter().map(|&head| head.to_owned()).collect();
    for row in std::iter::once(&heads).chain(rows) {
        let mut line = String::new();
        for (column, cell) in row.iter().enumerate().filter(|&(column, _)| widths[column] > 0) {
            let width = widths[column];
            if right.contains(&column) {
                write!(line, "{cell:>width$}  ")?;
            } else {
                write!(line, "{cell:<width$}  ")?;
            }
        }
        writeln!(text, "{}", line.trim_end())?;
    }
    Ok(())
}
