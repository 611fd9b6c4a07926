//! `calibrig export calibrated`.

use std::path::PathBuf;

use super::super::estimate::{Asked, Found, find};
use super::super::identify::fitted_mode;
use super::super::output::{Destination, Files, or_removed};
use super::super::{CliError, Verdict, print, say};
use super::{check_free, write};
use crate::handover::{FILES, hand_over, losses_text};
use calibrig_estimation::identification::Mode;

/// Write the calibrated robot in the forms that other programs read, with what each form loses
///
/// estimate.json is the whole estimate: parameters, covariance, terms, tracker, and the robot before and after. robot.toml and robot.urdf are the
/// calibrated robot in calibrig's own form; the URDF alone is its rigid chain, as are the two D-H tables. offsets.csv is for controllers that
/// accept only joint offsets, a tool and a base frame. losses.json, and the table that is printed, say what each file loses against the full
/// model.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig export calibrated runs/paper/recording.mcap --out calibrated
  calibrig export calibrated recording.mcap --mode elasto_geometric --out calibrated
  calibrig export calibrated calibrated/estimate.json --model models/ur5/robot.toml --out again
  calibrig identify --model calibrated/robot.toml --measurements later.csv

The measurements of a recording are identified again, as calibrig replay does, with its exit code 3.")]
pub(super) struct Args {
    /// A recording, or an estimate.json
    input: PathBuf,
    /// Which estimate, such as `elasto_geometric` [default: the fullest one recorded]
    #[arg(long, value_name = "MODE", value_parser = fitted_mode)]
    mode: Option<Mode>,
    /// Folder for the files
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The nominal robot's file, whose URDF is kept: needed with an estimate.json, or a recording that holds no robot
    #[arg(long, value_name = "ROBOT.toml")]
    model: Option<PathBuf>,
    /// Overwrite existing files
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
    let asked = Asked { input: &args.input, mode: args.mode, model: args.model.as_deref() };
    let Found { estimate, robot, ended, .. } = find(asked)?;
    if robot.is_none() && estimate.robot.sources.iter().any(|source| source.role == "urdf") {
        say(
            "without --model ROBOT.toml the URDF of the nominal robot is not available: robot.urdf has no shapes",
        );
    }
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
