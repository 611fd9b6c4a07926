//! `calibrig recover`.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::inspect::{named, whole_words, with_progress, write_faults, write_sets};
use super::{CliError, Verdict, print};
use calibrig_recording::{Inspection, NotReplayed, ProvenanceState, Recovered, State, recover};

/// Save the sound parts of a damaged, truncated or unfinished recording into a new file
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig recover out/recording.mcap.part recovered.mcap   left by a run that was killed
  calibrig recover damaged.mcap recovered.mcap --force      overwrites recovered.mcap

The damaged file is not touched. Any MCAP file can be saved, not only calibrig's. Exit code 0 if nothing is lost, 3 if something is.")]
pub(super) struct Args {
    /// The damaged file
    bad: PathBuf,
    /// The new file
    good: PathBuf,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let recovered =
        with_progress("recovering", |progress| recover(&args.bad, &args.good, args.force, progress))
            .map_err(|error| named(&args.bad, error))?;
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write_text(&recovered, &args.bad, &args.good, &mut text);
    print(&text)?;
    Ok(if recovered.inspection.recoverable.anything_lost { Verdict::Doubtful } else { Verdict::Done })
}

fn write_text(recovered: &Recovered, bad: &Path, good: &Path, text: &mut String) -> std::fmt::Result {
    let (bad, place) = (bad.display(), good.display());
    let inspection = &recovered.inspection;
    if recovered.copied {
        writeln!(
            text,
            "{bad}: {}; nothing is wrong with it: copied to {place}",
            whole_words(&inspection.health)
        )?;
        return write_next(recovered, good, text);
    }
    let saved = inspection.recoverable;
    let of = saved.messages_lost.map_or_else(String::new, |lost| format!(" of {}", saved.messages + lost));
    writeln!(text, "{bad}: {}{of} messages saved to {place}", saved.messages)?;
    write_sets(&inspection.sets, text)?;
    writeln!(text, "\ntopic  messages saved")?;
    let width = inspection.topics.iter().map(|topic| topic.topic.chars().count()).max().unwrap_or(0);
    for topic in &inspection.topics {
        let lost = match topic.lost {
            Some(lost) if lost > 0 => format!(", {lost} lost"),
            _ => String::new(),
        };
        writeln!(text, "  {:<width$}  {}{lost}", topic.topic, topic.messages)?;
    }
    if saved.anything_lost {
        writeln!(text, "\nlost")?;
        write_faults(&inspection.health, text)?;
    } else {
        writeln!(text, "\nlost: nothing of what is in the file{}", unknown(inspection.health.state))?;
    }
    write_doubts(inspection, text)?;
    write_next(recovered, good, text)
}

/// What is unknown about a file that ends too early.
fn unknown(state: State) -> &'static str {
    match state {
        State::Unfinished | State::Truncated => "; whether more was written before it ended is unknown",
        _ => "",
    }
}

/// What the new file cannot guarantee.
fn write_doubts(inspection: &Inspection, text: &mut String) -> std::fmt::Result {
    if let Some(provenance) =
        inspection.provenance.as_ref().filter(|provenance| provenance.state == ProvenanceState::Altered)
    {
        writeln!(text, "\n{}", provenance.problem.as_deref().unwrap_or_default())?;
        writeln!(
            text,
            "So seed, scenario and models may not be those of the run: the metadata are kept as `calibrig_altered`, and are"
        )?;
        let sound = if inspection.health.holds_unprotected() {
            ""
        } else {
            " The messages are sound: each is under a checksum."
        };
        writeln!(text, "not read.{sound}")?;
    }
    for set in inspection.sets.iter().filter(|set| !set.described) {
        writeln!(
            text,
            "\nThe session of the {} set is lost: its stations and targets are not known, and its observations cannot be used.",
            set.set
        )?;
    }
    if inspection.health.holds_unprotected() {
        writeln!(
            text,
            "\n{} messages or attachments have no checksum: whether they were altered is unknown.",
            inspection.health.without_checksum
        )?;
    }
    Ok(())
}

fn write_next(recovered: &Recovered, good: &Path, text: &mut String) -> std::fmt::Result {
    let good = good.display();
    match recovered.inspection.not_replayed(recovered.copied) {
        None => writeln!(text, "\nnext: calibrig replay {good}"),
        Some(NotReplayed::OpaqueChunks(why)) => writeln!(
            text,
            "\nSome messages are in chunks with a compression that calibrig cannot read: {why}. `calibrig replay` refuses it: \
             write it again with zstd, lz4\nor no compression."
        ),
        Some(NotReplayed::Foreign) => writeln!(
            text,
            "\nIt is not a calibrig recording: MCAP viewers open it, `calibrig replay` does not."
        ),
        Some(NotReplayed::Newer(software)) => {
            writeln!(text, "\nA later version wrote it: replay it with {software}.")
        }
        Some(NotReplayed::NothingMeasured | NotReplayed::SessionLost) => {
            writeln!(text, "\nIt holds no measured pose to identify from: there is nothing to replay.")
        }
    }
}
