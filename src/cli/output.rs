//! Where the files of a run go.

use std::path::{Path, PathBuf};

use super::inspect::with_progress;
use super::{CliError, Verdict, colours, print, say};
use crate::pipeline::{Implausible, Outcome, PipelineError, SetOutcome, check_plausible};
use crate::report;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
use calibrig_estimation::identification::{Estimate, IdentificationOptions, Warning};
use calibrig_estimation::two_face::unexplained_face_differences;
use calibrig_model::CalibrationModel;
use calibrig_recording::{RecordingError, UnfinishedFile};

/// Which files a command leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Files {
    /// Only reports.
    Reports,
    /// Reports and recordings.
    ReportsAndRecordings,
    /// Results of a pose test.
    Iso9283,
    /// Planned poses.
    Plan,
    /// Results of a campaign.
    Campaign,
    /// Results of an acceptance test.
    Acceptance,
    /// The tables of an exported recording, next to its input files.
    Export,
    /// A calibrated robot.
    Calibrated,
    /// Corrected commands.
    Compensation,
}

impl Files {
    pub(super) fn names(self) -> &'static [&'static str] {
        match self {
            Self::Reports => &["report.html", "report.json", "residuals.csv"],
            Self::Iso9283 => &["iso9283.html", "iso9283.json"],
            Self::Plan => &["plan.csv", "plan.json", "plan.html"],
            Self::Campaign => &[
                "manifest.json",
                "trials.parquet.sha256",
                "trials.parquet",
                "trials.csv",
                "summary.json",
                "report.html",
                "timings.csv",
            ],
            Self::Acceptance => &["acceptance.html", "acceptance.svg", "acceptance.json"],
            Self::Calibrated => &crate::handover::FILES,
            Self::Compensation => &crate::report::COMPENSATION_FILES,
            Self::Export => {
                &["identification.csv", "verification.csv", "session.toml", "residuals.csv", "parameters.csv"]
            }
            #[cfg(feature = "rerun")]
            Self::ReportsAndRecordings => {
                &["report.html", "report.json", "residuals.csv", "recording.mcap", "recording.rrd"]
            }
            #[cfg(not(feature = "rerun"))]
            Self::ReportsAndRecordings => &["report.html", "report.json", "residuals.csv", "recording.mcap"],
        }
    }
}

/// Where files go.
#[derive(Debug, Clone, Copy)]
pub(super) enum Destination<'a> {
    /// The given folder, whose files are overwritten.
    Asked(&'a Path),
    /// A new folder with this name under `runs/`, so that nothing is overwritten unasked.
    New(&'a str),
}

impl Destination<'_> {
    /// Refuses a place that cannot be written to, before anything is computed for it. Creates nothing.
    pub(super) fn check(self, files: Files) -> Result<(), CliError> {
        let folder = match self {
            Self::Asked(path) => path,
            Self::New(_) => Path::new(RUNS),
        };
        let refused = |at: &Path, what, expected| {
            Err(CliError::InTheWay { folder: folder.to_path_buf(), at: at.to_path_buf(), what, expected })
        };
        if let Some(at) = folder.ancestors().find(|path| path.exists())
            && !at.is_dir()
        {
            return refused(at, "no folder", "a folder, or the name of a new one");
        }
        if let Self::Asked(folder) = self {
            let taken = files.names().iter().map(|name| folder.join(name)).find(|path| path.is_dir());
            if let Some(at) = taken {
                return refused(
                    &at,
                    "a folder",
                    "the name of a folder; in this one, a folder has the name of a file to be written",
                );
            }
        }
        Ok(())
    }

    /// The folder, created if missing, and whether it was created.
    pub(super) fn make(self) -> Result<(PathBuf, bool), CliError> {
        let failed = |path: &Path| {
            let what = path.display().to_string();
            move |source| CliError::Output { what, source }
        };
        let name = match self {
            Self::Asked(path) => {
                let new = !path.exists();
                std::fs::create_dir_all(path).map_err(failed(path))?;
                return Ok((path.to_path_buf(), new));
            }
            Self::New(name) => name,
        };
        let runs = Path::new(RUNS);
        std::fs::create_dir_all(runs).map_err(failed(runs))?;
        let safe: String = name
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' })
            .collect();
        let mut number = 1_u64;
        loop {
            let path = runs.join(if number == 1 { safe.clone() } else { format!("{safe}-{number}") });
            match std::fs::create_dir(&path) {
                Ok(()) => return Ok((path, true)),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(failed(&path)(error)),
            }
        }
    }
}

const RUNS: &str = "runs";

/// Completes a recording that is in its folder already.
pub(super) type Complete<'a> = Box<dyn FnOnce() -> Result<UnfinishedFile, RecordingError> + 'a>;

/// Writes the files of `outcome` to `folder` and says where they are. All are complete before the first one takes its name, and one that
/// cannot be written does not keep the others back. The Rerun file is put together meanwhile, and written at the end.
pub(super) fn write(
    outcome: &Outcome,
    folder: &Path,
    recording: Option<Complete<'_>>,
) -> Result<(), CliError> {
    std::thread::scope(|scope| {
        #[cfg(feature = "rerun")]
        let pictures =
            recording.is_some().then(|| scope.spawn(|| calibrig_recording::rrd_of(&outcome.story())));
        #[cfg(not(feature = "rerun"))]
        let (_, recorded) = (scope, recording.is_some());

        let recording = recording.map(|complete| complete());
        let mut staged = Staged { folder, files: Vec::new(), failures: Vec::new() };
        let staging = tempfile::Builder::new().prefix(".calibrig-").tempdir_in(folder);
        match &staging {
            Ok(staging) => match report::write_reports(outcome, staging.path()) {
                Ok(()) => {
                    let file = |name: &'static str| (name, Finished::Staged(staging.path().join(name)));
                    staged.files.extend(Files::Reports.names().iter().map(|&name| file(name)));
                }
                Err(error) => staged.failed(&Files::Reports.names().join(", "), &error),
            },
            Err(error) => staged.failed(&Files::Reports.names().join(", "), error),
        }
        match recording {
            Some(Ok(file)) => staged.files.push(("recording.mcap", Finished::Recording(file))),
            Some(Err(error)) => staged.failed("recording.mcap", &error),
            None => {}
        }
        #[cfg(feature = "rerun")]
        if let (Some(pictures), Ok(staging)) = (pictures, &staging) {
            let path = staging.path().join("recording.rrd");
            let made = pictures.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            match made.and_then(|bytes| calibrig_recording::save_rrd(&bytes, &path)) {
                Ok(()) => staged.files.push(("recording.rrd", Finished::Staged(path))),
                Err(error) => staged.failed("recording.rrd", &error),
            }
        }
        let result = staged.put_in_place();
        #[cfg(not(feature = "rerun"))]
        if recorded {
            say(
                "recording.rrd is not written: this build has no Rerun (build with `--features rerun`); recording.mcap opens in Rerun and Foxglove",
            );
        }
        result
    })
}

/// `result`, after removing a new folder that stayed empty.
pub(super) fn or_removed<T>(result: Result<T, CliError>, folder: &Path, new: bool) -> Result<T, CliError> {
    if result.is_err() && new {
        // It stays if it is not empty.
        let _ = std::fs::remove_dir(folder);
    }
    result
}

/// A complete file that waits for its name.
enum Finished {
    Staged(PathBuf),
    Recording(UnfinishedFile),
}

struct Staged<'a> {
    folder: &'a Path,
    files: Vec<(&'static str, Finished)>,
    failures: Vec<String>,
}

impl Staged<'_> {
    fn failed(&mut self, name: &str, error: &impl std::error::Error) {
        // The root cause: that a staged file could not be written adds nothing.
        let mut cause: &dyn std::error::Error = error;
        while let Some(inner) = cause.source() {
            cause = inner;
        }
        let mut text = format!("{name}: {cause}");
        if self.folder.join(name).exists() {
            text += " (the file of that name there is an older one)";
        }
        self.failures.push(text);
    }

    fn put_in_place(mut self) -> Result<(), CliError> {
        let mut written = Vec::new();
        for (name, file) in std::mem::take(&mut self.files) {
            let path = self.folder.join(name);
            let put = match file {
                Finished::Staged(from) => std::fs::rename(from, &path).map_err(RecordingError::from),
                Finished::Recording(file) => file.finish(&path),
            };
            match put {
                Ok(()) => written.push(name),
                Err(error) => self.failed(name, &error),
            }
        }
        if !written.is_empty() {
            say(&format!("wrote {} to {}", written.join(", "), self.folder.display()));
        }
        if self.failures.is_empty() {
            return Ok(());
        }
        Err(CliError::NotWritten { folder: self.folder.to_path_buf(), failures: self.failures, written })
    }
}

/// Prints the tables, or the JSON document.
pub(super) fn show(outcome: &Outcome, json: bool) -> Result<(), CliError> {
    let text = if json {
        report::json_text(outcome)?
    } else {
        report::render_tables(
            outcome,
            if colours(&std::io::stdout()) { report::Style::Colour } else { report::Style::Plain },
        )
    };
    print(&text)
}

/// Whether the fit may start. Measurements that the nominal robot does not fit are the error or, if the fit goes on `anyway`, a warning.
pub(super) fn plausible(
    model: &CalibrationModel,
    sets: &[SetOutcome],
    options: &IdentificationOptions,
    anyway: bool,
) -> Result<Verdict, PipelineError> {
    match with_progress("diagnosing", |progress| check_plausible(model, sets, options, progress)) {
        Err(PipelineError::Implausible(why)) if anyway => Ok(doubtful(&why)),
        checked => checked.map(|()| Verdict::Done),
    }
}

/// Says why a fit would be of no use.
pub(super) fn doubtful(why: &Implausible) -> Verdict {
    say(&format!("doubtful: {why}; {}", why.help()));
    Verdict::Doubtful
}

/// The command line of this process for a POSIX shell, with `DIR` for the folder of its files and without flags that only choose the
/// form of the output.
pub(super) fn command_line() -> String {
    let mut words = vec!["calibrig".to_owned()];
    let mut arguments = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned());
    while let Some(word) = arguments.next() {
        match word.as_str() {
            "--json" => {}
            "--out" => {
                arguments.next();
                words.push("--out DIR".to_owned());
            }
            _ if word.starts_with("--out=") => words.push("--out DIR".to_owned()),
            _ => words.push(report::quoted(&word)),
        }
    }
    words.join(" ")
}

/// A reason, with what a stopped fit was still changing.
fn in_full(estimate: &Estimate, reason: &Warning) -> String {
    match reason {
        Warning::NotConverged(_) => format!("{reason}{}", still_moving(estimate)),
        _ => reason.to_string(),
    }
}

/// Doubtful as soon as one of the estimates has a reason to look at it; says each (ADR 0015).
pub(super) fn verdict(outcome: &Outcome) -> Verdict {
    let mut reasons = Vec::new();
    for mode in outcome.splits.iter().flat_map(|study| &study.modes).filter(|mode| mode.doubtful > 0) {
        let why: Vec<_> = mode.reasons.iter().map(|(reason, count)| format!("{reason}: {count}")).collect();
        reasons.push((
            mode.mode,
            format!("{} of {} splits ({})", mode.doubtful, mode.rms.len(), why.join(", ")),
        ));
    }
    for mode in &outcome.modes {
        if let Some(estimate) = &mode.estimate {
            reasons.extend(estimate.reasons().map(|reason| (mode.mode, in_full(estimate, reason))));
        }
    }
    for judgement in &outcome.judgements {
        reasons.extend(judgement.reasons().map(|(_, words)| (judgement.mode, words)));
    }
    let fitted = outcome.sets.first().map(|set| unexplained_face_differences(&set.measurements));
    fitted.iter().flatten().for_each(|difference| say(&difference.to_string()));
    for (mode, reason) in &reasons {
        say(&format!("doubtful: {}: {reason}", mode.title()));
    }
    let failures = outcome.closed_loop.as_ref().map_or(&[][..], |driven| &driven.failures);
    for failure in failures {
        say(&format!("not driven: {}: {}", failure.what, failure.why));
    }
    let missed = outcome.closed_loop.iter().flat_map(missed_goals).collect::<Vec<_>>();
    for words in &missed {
        say(&format!("doubtful: {words}"));
    }
    let sound = reasons.is_empty() && failures.is_empty() && missed.is_empty();
    if sound { Verdict::Done } else { Verdict::Doubtful }
}

/// Goals without a command, in words.
fn missed_goals(driven: &ClosedLoop) -> Vec<String> {
    let of_poses = driven.modes.iter().map(|mode| (mode, "pose"));
    let of_path =
        driven.path.iter().flat_map(|path| path.modes.iter().map(|mode| (mode, "point of the path")));
    let uncorrected = of_poses.chain(of_path).filter_map(|(mode, noun)| {
        let (pose, why) = mode.uncorrected.first()?;
        let (title, count) = (mode.mode.title(), mode.uncorrected.len());
        Some(format!("{title}: no corrected command for {count} of them: {noun} {pose}: {why}"))
    });
    let unreachable = driven.path.iter().filter_map(|path| {
        let (point, why) = path.unreachable.first()?;
        let count = path.unreachable.len();
        Some(format!(
            "the path: out of reach within the working region at {count} of its points: point {point}: {why}"
        ))
    });
    unreachable.chain(uncorrected).collect()
}

/// Most parameters that are named as still moving.
const MOST_MOVING: usize = 3;

/// Which way a stopped fit was still moving.
fn still_moving(estimate: &Estimate) -> String {
    let moved: Vec<_> = estimate
        .last_moved(MOST_MOVING)
        .into_iter()
        .map(|(id, sigmas)| format!("{id} by {sigmas:+.1} standard deviations"))
        .collect();
    if moved.is_empty() { String::new() } else { format!(". The last step moved {}", moved.join(", ")) }
}
