//! `calibrig export calibrated`.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::super::identify::fitted_mode;
use super::super::output::{Destination, Files, or_removed, verdict};
use super::super::{CliError, Verdict, print, replay, say};
use super::{check_free, write};
use crate::handover::{EstimateFile, FILES, hand_over, losses_text};
use crate::pipeline::Outcome;
use crate::replay::{ReplayOptions, Replayed, replay as identify_again};
use calibrig_estimation::identification::Mode;
use calibrig_files::{InputError, Robot, Source, load_robot, parse_robot};

/// Write the calibrated robot as other programs take it, with what each file loses
///
/// estimate.json is the whole estimate: parameters, covariance, terms, tracker, and the robot before and after. robot.toml and robot.urdf are the
/// calibrated robot in calibrig's own form; the URDF by itself is its rigid chain, as are the two D-H tables. offsets.csv is for controllers that
/// take joint offsets, a tool and a base frame alone. losses.json, and the table that is printed, tell what each loses against the full model.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig export calibrated runs/paper/recording.mcap --out calibrated
  calibrig export calibrated recording.mcap --mode elasto_geometric --out calibrated
  calibrig export calibrated calibrated/estimate.json --model models/ur5/robot.toml --out again
  calibrig identify --model calibrated/robot.toml --measurements later.csv

Of a recording the measurements are identified again, as by calibrig replay. Exit code 3 where that ends with it.")]
pub(super) struct Args {
    /// A recording, or an estimate.json
    input: PathBuf,
    /// Which estimate [default: the fullest one that was recorded]
    #[arg(long, value_name = "MODE", value_parser = fitted_mode)]
    mode: Option<Mode>,
    /// Folder for the files
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The nominal robot's file, whose URDF is kept: of an estimate.json, or of a recording that holds none
    #[arg(long, value_name = "ROBOT.toml")]
    model: Option<PathBuf>,
    /// Write over files that are there
    #[arg(long)]
    force: bool,
    /// Print the losses as JSON (schema calibrig.losses/1) instead of the table
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let destination = Destination::Asked(&args.out);
    destination.check(Files::Calibrated)?;
    check_free(&args.out, Files::Calibrated, &FILES.map(|name| (name, "")), args.force)?;
    let model = args.model.as_deref().map(load_robot).transpose()?;
    let (estimate, robot, ended) =
        if is_recording(&args.input)? { from_recording(args, model)? } else { from_estimate(args, model)? };
    let handover = hand_over(&estimate, robot.as_ref())
        .map_err(|source| CliError::Handover { file: args.input.clone(), source: Box::new(source) })?;
    let files: Vec<_> = handover.files.iter().map(|file| (file.name, file.text.as_str())).collect();
    let (folder, new) = destination.make()?;
    or_removed(write(&folder, &files), &folder, new)?;
    if args.json {
        let losses = handover.files.iter().find(|file| file.name == "losses.json");
        print(losses.map_or("", |file| file.text.as_str()))?;
    } else {
        print(&losses_text(&handover.losses))?;
    }
    Ok(ended)
}

/// The first bytes of every MCAP file.
const MAGIC: &[u8] = b"\x89MCAP";

fn is_recording(path: &Path) -> Result<bool, CliError> {
    let unreadable = |error: std::io::Error| InputError::Unreadable {
        path: path.to_path_buf(),
        reason: error.to_string(),
    };
    let mut start = Vec::new();
    File::open(path)
        .map_err(unreadable)?
        .take(MAGIC.len() as u64)
        .read_to_end(&mut start)
        .map_err(unreadable)?;
    Ok(start == MAGIC || path.extension().is_some_and(|extension| extension == "mcap"))
}

type Found = (EstimateFile, Option<Robot>, Verdict);

fn from_estimate(args: &Args, model: Option<Robot>) -> Result<Found, CliError> {
    let estimate = EstimateFile::read(&args.input)?;
    if args.mode.is_some_and(|mode| mode != estimate.estimate.robot.mode) {
        return Err(CliError::NoEstimate { file: args.input.clone(), mode: args.mode });
    }
    if let (Some(robot), Some(file)) = (&model, &args.model) {
        estimate
            .check_model(&robot.model)
            .map_err(|source| CliError::AnotherModel { file: file.clone(), source })?;
    }
    if model.is_none() && estimate.robot.sources.iter().any(|source| source.role == "urdf") {
        say(
            "without --model ROBOT.toml the URDF of the nominal robot is not at hand: robot.urdf has no shapes",
        );
    }
    Ok((estimate, model, Verdict::Done))
}

fn from_recording(args: &Args, model: Option<Robot>) -> Result<Found, CliError> {
    let options = ReplayOptions {
        modes: args.mode.into_iter().collect(),
        robot: model.clone(),
        ..ReplayOptions::default()
    };
    let replayed =
        identify_again(&args.input, &options).map_err(|error| replay::failed(error, &args.input))?;
    let Replayed { outcome, differences, made_by_another, missing, unprotected, .. } = &replayed;
    let mut ended = verdict(outcome);
    if let Some(line) = replay::unnoticed(unprotected) {
        say(&line);
    }
    for part in missing {
        say(&replay::cut_short(part));
        ended = Verdict::Doubtful;
    }
    if !differences.is_empty() {
        let places = differences.len();
        match made_by_another {
            Some(made_by) => say(&format!(
                "the recorded estimates were made by {made_by}; what is written is this version's"
            )),
            None => {
                say(&format!(
                    "doubtful: what was identified again differs from what is recorded in {places} places (calibrig replay tells them)"
                ));
                ended = Verdict::Doubtful;
            }
        }
    }
    let estimate = EstimateFile::of(outcome, args.mode)
        .ok_or_else(|| CliError::NoEstimate { file: args.input.clone(), mode: args.mode })?;
    let robot = match model {
        Some(robot) => Some(robot),
        None => recorded_robot(outcome)?,
    };
    Ok((estimate, robot, ended))
}

/// The robot by the files that the recording holds.
fn recorded_robot(outcome: &Outcome) -> Result<Option<Robot>, InputError> {
    let source = |role: &str| {
        let found = outcome.sources.iter().find(|(known, _)| known == role);
        found.map(|(_, source): &(String, Source)| source.clone())
    };
    source("robot").map(|robot| parse_robot(robot, source("urdf"), source("columns"))).transpose()
}
