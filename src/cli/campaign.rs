//! What the commands of campaigns share: the manifest and the evaluation of a table. `calibrig missing` and `calibrig merge`.

use std::io::{BufRead, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use calibrig_campaign::shards::{Folder, FolderError, Input, Inventory, Manifest, Software};
use calibrig_campaign::table::{Cell, Table, TableReader};
use indicatif::HumanCount;

use super::inspect::with_progress;
use super::{CliError, Verdict, print, say, write_whole};
use crate::montecarlo::{
    Campaign, CampaignSummary, Study, Subject, TrialColumns, summarise, summary_json, summary_text,
};
use crate::pipeline::{InputHash, hash_sources};

/// How a table is summarised.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Answers {
    /// Error in mm or um up to which the calibrated robot counts as a success, such as 0.2mm [default: that of the
    /// scenario's section campaign]
    #[arg(long, value_name = "LENGTH", value_parser = length)]
    tolerance: Option<f64>,
    /// Write trials.csv as well
    #[arg(long)]
    csv: bool,
    /// Print the summary as JSON (schema calibrig.campaign/1) instead of the tables
    #[arg(long)]
    json: bool,
}

/// `0.2mm`, m.
fn length(text: &str) -> Result<f64, String> {
    let units = [("mm", 1e-3), ("um", 1e-6), ("µm", 1e-6), ("m", 1.0)];
    let text = text.trim();
    let read = units.iter().find_map(|(unit, scale)| Some((text.strip_suffix(unit)?, *scale)));
    let (number, scale) = read.ok_or("expected a length with its unit, such as 0.2mm or 150um")?;
    match number.trim().parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(scale * value),
        _ => Err(format!("{number:?} is not a number above zero")),
    }
}

/// Print which shards of a campaign are missing or damaged, in the form that schedulers take as array numbers
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig missing out                                       prints `0-2,5`, or nothing if all are there
  calibrig missing out --json                                the same with every fault
  sbatch --array=\"$(calibrig missing out)\" out/slurm.sh      runs these again

Checks the bytes of every shard, and names those that were cut short, altered or do not belong to the campaign. Exit code 3: shards are missing, or
there are files among them that must not be merged.")]
pub(super) struct MissingArgs {
    /// The campaign's folder
    folder: PathBuf,
    /// Print as JSON (schema calibrig.missing/1)
    #[arg(long)]
    json: bool,
}

/// Join the shards of a campaign into one table, and summarise it
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig merge out                        leaves trials.parquet, summary.json and report.html in out/
  calibrig merge out --tolerance 0.2mm      also says how often the calibrated robot is within 0.2 mm

The table has the same bytes as that of a single machine. If shards are missing, altered, overlapping or of another campaign, they are named
and no table is made. If the table is there already, it is summarised again. Exit code 1: a file among the shards must not be merged; 3: shards
are missing, or a trial failed.")]
pub(super) struct MergeArgs {
    /// The campaign's folder
    folder: PathBuf,
    #[command(flatten)]
    answers: Answers,
}

pub(super) fn missing(args: &MissingArgs) -> Result<Verdict, CliError> {
    let folder = opened(&args.folder)?;
    let mut inventory = looked_through(&folder);
    let shards = folder.manifest().shards;
    if folder.is_complete() && inventory.sound() == 0 {
        // One machine did it all, or the shards were moved away.
        inventory.missing.clear();
        say("trials.parquet is complete");
    }
    tell_faults(&inventory);
    if !inventory.missing.is_empty() {
        tell_unsound(&folder);
    }
    let array = inventory.array();
    if args.json {
        let faults: Vec<_> = inventory.faults.iter().map(ToString::to_string).collect();
        let document = serde_json::json!({
            "schema": "calibrig.missing/1", "shards": shards, "missing": inventory.missing, "array": array, "faults": faults,
        });
        print(&format!("{document:#}\n"))?;
    } else if !array.is_empty() {
        print(&format!("{array}\n"))?;
    }
    let missing = inventory.missing.len();
    say(&if missing == 0 {
        "nothing is missing".to_owned()
    } else {
        format!("{missing} of {shards} shards are missing")
    });
    let sound = missing == 0 && inventory.faults.is_empty();
    Ok(if sound { Verdict::Done } else { Verdict::Doubtful })
}

pub(super) fn merge(args: &MergeArgs) -> Result<Verdict, CliError> {
    let folder = opened(&args.folder)?;
    let inventory = looked_through(&folder);
    let must_not = inventory.faults.iter().filter(|fault| !fault.is_mended_by_computing()).count();
    if must_not > 0 {
        tell_faults(&inventory);
        return Err(CliError::NotMerged { path: args.folder.clone(), count: must_not });
    }
    if folder.is_complete() && inventory.sound() == 0 {
        return conclude(&folder, &args.answers, "");
    }
    tell_faults(&inventory);
    if !inventory.missing.is_empty() {
        let (missing, shards) = (inventory.missing.len(), folder.manifest().shards);
        tell_unsound(&folder);
        if shards == 1 && inventory.faults.is_empty() {
            say(
                "doubtful: the campaign is not complete, and was not run in shards: repeat the `calibrig montecarlo` command \
                 with --resume to continue it",
            );
            return Ok(Verdict::Doubtful);
        }
        say(&format!(
            "doubtful: {missing} of {shards} shards are missing, so no table is made: {}; run these shards again, then merge",
            inventory.array()
        ));
        return Ok(Verdict::Doubtful);
    }
    with_rows("merging", &folder, |progress| folder.merge(&inventory, progress))?;
    join_timings(&folder);
    conclude(&folder, &args.answers, "trials.parquet")
}

fn opened(path: &Path) -> Result<Folder, CliError> {
    if path.is_file() {
        return Err(FolderError::NoCampaign { path: path.to_path_buf() }.into());
    }
    Ok(Folder::open(path)?)
}

/// Warns that the table cannot be used as a whole.
pub(super) fn tell_unsound(folder: &Folder) {
    if folder.has_unsound_table() {
        say(&format!(
            "{}: cut short, altered, or of another campaign: it does not match the checksum in trials.parquet.sha256, and is \
             made again",
            folder.table().display()
        ));
    }
}

fn looked_through(folder: &Folder) -> Inventory {
    let shards = u64::from(folder.manifest().shards);
    with_progress("checking the shards", |progress| {
        folder.inventory(&mut |done| progress(done, shards.max(done)))
    })
}

fn tell_faults(inventory: &Inventory) {
    inventory.faults.iter().for_each(|fault| say(&fault.to_string()));
}

/// One of the shards' side files, in the order of the shards. No result depends on them: an unreadable one is left out.
fn join_timings(folder: &Folder) {
    let entries = std::fs::read_dir(folder.path().join("shards")).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries
        .map(|entry| entry.path())
        .filter(|path| path.to_string_lossy().ends_with(".timings.csv"))
        .collect();
    files.sort();
    let Ok(mut joined) = std::fs::File::create(folder.path().join("timings.csv")) else { return };
    let _ = joined.write_all(b"trial,seconds\n");
    for file in files {
        let Ok(own) = std::fs::File::open(file) else { continue };
        let mut own = std::io::BufReader::new(own);
        let _ = own.skip_until(b'\n').and_then(|_| std::io::copy(&mut own, &mut joined));
    }
}

/// Work that counts rows, with its progress.
pub(super) fn with_rows<T>(
    what: &str,
    folder: &Folder,
    work: impl FnOnce(&mut dyn FnMut(u64)) -> Result<T, FolderError>,
) -> Result<T, CliError> {
    let trials = folder.manifest().trials;
    with_progress(what, |progress| {
        work(&mut |done| {
            if done % 1024 == 0 {
                progress(done, trials);
            }
        })
    })
    .map_err(CliError::from)
}

/// The manifest of a campaign in `shards` parts, with the trials of `range`.
pub(super) fn manifest(
    campaign: &Campaign<'_>,
    columns: &TrialColumns,
    scenario: &str,
    (range, shards): (Range<u64>, u32),
) -> Result<Manifest, CliError> {
    let sources = &campaign.scenario.sources;
    let input = |(role, source): &(String, calibrig_files::Source)| Input {
        role: role.clone(),
        sha256: hash_sources(std::slice::from_ref(&(role.clone(), source.clone()))),
    };
    let study = Study::of(campaign, columns);
    let study = serde_json::to_value(&study)
        .map_err(|error| CliError::Output { what: "the manifest".to_owned(), source: error.into() })?;
    Ok(Manifest {
        schema: Manifest::schema(),
        name: campaign.scenario.name.clone(),
        scenario: scenario.to_owned(),
        software: software()?,
        inputs: sources.iter().map(input).collect(),
        seed: campaign.seed,
        first: range.start,
        trials: range.end - range.start,
        shards,
        study,
        columns: columns.columns(),
    })
}

/// This program.
fn software() -> Result<Software, CliError> {
    let failed =
        |source| CliError::Output { what: "the manifest: this program's own file".to_owned(), source };
    // The program that is running, if the system can say: the file may have been replaced since it started.
    let running = Path::new("/proc/self/exe");
    let path =
        if running.exists() { running.to_path_buf() } else { std::env::current_exe().map_err(failed)? };
    let mut hash = InputHash::default();
    hash.add_file("program", &path).map_err(failed)?;
    Ok(Software {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        binary_sha256: hash.hex(),
        target: format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
    })
}

/// What the table says: as files next to it, and as tables on the terminal.
pub(super) fn conclude(folder: &Folder, answers: &Answers, made: &'static str) -> Result<Verdict, CliError> {
    let table = TableReader::open(&folder.table()).map_err(FolderError::from)?;
    let summary = summed_up(folder, &table, answers)?;
    let json = format!("{:#}\n", summary_json(&summary));
    let mut written: Vec<&str> = if made.is_empty() { Vec::new() } else { vec![made] };
    let put = |name: &'static str, text: &str, written: &mut Vec<&str>| {
        let path = folder.path().join(name);
        let failed = |source| CliError::Output { what: path.display().to_string(), source };
        write_whole(folder.path(), &path, text).map_err(failed)?;
        written.push(name);
        Ok::<_, CliError>(())
    };
    put("summary.json", &json, &mut written)?;
    put("report.html", &crate::report::campaign_html(&summary), &mut written)?;
    if answers.csv {
        write_csv(folder, &table)?;
        written.push("trials.csv");
    }
    print(&if answers.json { json } else { summary_text(&summary) })?;
    say(&format!("wrote {} to {}", written.join(", "), folder.path().display()));
    Ok(verdict(&summary))
}

/// The same for a table that is not complete: nothing is written.
pub(super) fn show(folder: &Folder, table: &dyn Table, answers: &Answers) -> Result<(), CliError> {
    let summary = summed_up(folder, table, answers)?;
    print(&if answers.json { format!("{:#}\n", summary_json(&summary)) } else { summary_text(&summary) })
}

fn summed_up(folder: &Folder, table: &dyn Table, answers: &Answers) -> Result<CampaignSummary, CliError> {
    let manifest = folder.manifest();
    let study: Study = serde_json::from_value(manifest.study.clone()).map_err(|error| {
        FolderError::Manifest { path: folder.path().join("manifest.json"), reason: format!("study: {error}") }
    })?;
    let mut hash = InputHash::default();
    for input in &manifest.inputs {
        hash.add(&input.role, &input.sha256);
    }
    let subject = Subject {
        name: manifest.name.clone(),
        scenario: manifest.scenario.clone(),
        seed: manifest.seed,
        sha256: hash.hex(),
        first: manifest.first,
    };
    let tolerance = answers.tolerance.or(study.tolerance);
    let summary = with_progress("summarising", |_| summarise(subject, &study, table, tolerance));
    summary.map_err(|error| CliError::Summary { path: folder.path().to_path_buf(), source: Box::new(error) })
}

fn verdict(summary: &CampaignSummary) -> Verdict {
    if summary.failed == 0 {
        return Verdict::Done;
    }
    say(&format!(
        "doubtful: {} of {} trials failed: see the columns status and reason of the table",
        HumanCount(summary.failed),
        HumanCount(summary.trials)
    ));
    Verdict::Doubtful
}

/// The table as text: numbers are read back to the bit, absent ones are empty.
fn write_csv(folder: &Folder, table: &TableReader) -> Result<(), CliError> {
    let path = folder.path().join("trials.csv");
    let failed = |source| CliError::Output { what: path.display().to_string(), source };
    let staged = tempfile::Builder::new().prefix(".calibrig-").tempfile_in(folder.path()).map_err(failed)?;
    let mut writer = csv::Writer::from_writer(std::io::BufWriter::new(staged));
    let header = table.columns().iter().map(|column| column.name.as_str());
    writer.write_record(header).map_err(|error| failed(error.into()))?;
    table.for_each_row::<CliError>(|row| {
        let cells = row.iter().map(|cell| match cell {
            Cell::Absent => String::new(),
            Cell::Integer(value) => value.to_string(),
            Cell::Number(value) => value.to_string(),
            Cell::Text(text) => text.clone(),
        });
        writer.write_record(cells).map_err(|error| failed(error.into()))
    })?;
    let buffer = writer.into_inner().map_err(|error| failed(error.into_error()))?;
    let mut staged = buffer.into_inner().map_err(|error| failed(error.into_error()))?;
    staged.flush().map_err(failed)?;
    super::make_readable(staged.as_file()).map_err(failed)?;
    staged.persist(&path).map_err(|error| failed(error.error))?;
    Ok(())
}

/// What to do about a folder.
pub(super) fn help(error: &FolderError) -> &'static str {
    match error {
        FolderError::AnotherCampaign { .. } => {
            "expected another folder (--out), or the same program, scenario file and options (--plant, --seed, --trials, --shard, \
             --shards) as in its manifest.json; the folder was not changed"
        }
        FolderError::NoCampaign { .. } => {
            "expected the folder of a campaign, as `calibrig montecarlo SCENARIO --out DIR` makes it"
        }
        FolderError::Manifest { .. } => {
            "expected a manifest as `calibrig montecarlo` writes it; start the campaign again in another folder"
        }
        FolderError::NoShard { .. } => "expected I from 0 and below N in --shard I/N",
        FolderError::Missing { .. } => "run the shards that `calibrig missing` prints again",
        _ => {
            "expected free space and permission to read and write there; what was written is kept: continue with `calibrig \
             montecarlo` and --resume (or the same --shard)"
        }
    }
}
