//! `calibrig model`.

use std::fs;
use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::{CommandFactory, ValueEnum};
use serde_json::json;

use super::{Cli, CliError, Verdict, print, say};
use calibrig_files::{
    Convention, Converted, Robot, Source, UrdfOptions, load_robot, robot_from_dh, robot_from_urdf,
};
use calibrig_model::nalgebra::Vector3;

/// Make a robot's file from a URDF, or from a table of Denavit-Hartenberg rows
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig model from-urdf ur5.urdf --base base_link --tip tool0 --out ur5
  calibrig model from-dh table.csv --convention standard --out ur5")]
pub(super) struct Args {
    #[command(subcommand)]
    from: From,
}

#[derive(Debug, clap::Subcommand)]
enum From {
    FromUrdf(UrdfArgs),
    FromDh(DhArgs),
}

/// Make a robot's file from a URDF
///
/// The joints between two links become rows of a table: Craig's convention if their axes cross, with Hayati's beta if they are nearly parallel.
/// Signs and zeros of the joints stay those of the URDF. Masses are taken over if every moving link has one. The table is compared with the URDF at
/// 1000 poses, and refused if they differ by more than 1e-10 m. Elements that are not needed are counted and ignored, no other file is opened, and
/// assumptions are marked in the file and reported.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig model from-urdf ur5.urdf --base base_link --tip tool0 --out ur5
  calibrig model from-urdf cell.urdf --base world --tip tool0 --target-mm 12.5,0,80 --out cell
  calibrig identifiability --model ur5/robot.toml")]
struct UrdfArgs {
    /// The URDF; xacro source has to be expanded first
    file: PathBuf,
    #[command(flatten)]
    chain: ChainArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// Make a robot's file from a table of Denavit-Hartenberg rows
///
/// The table is delimited text: a header line with the columns a, alpha, d and theta and their units, and one row per joint from the base. Columns
/// name, type (revolute, prismatic), beta, min and max are optional. A cell of theta or d may hold the joint variable with its sign and offset, as
/// manuals print it: q2 - 90.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig model from-dh table.csv --convention standard --out ur5
  calibrig model from-dh table.csv --convention craig --target-mm 0,0,100 --out arm

A table.csv:
  name,a_mm,alpha_deg,d_mm,theta_deg,min_deg,max_deg
  waist,0,90,400,q1,-170,170
  shoulder,900,0,0,q2 - 90,-60,120")]
struct DhArgs {
    /// The table
    file: PathBuf,
    /// Convention of the table
    #[arg(long, value_enum)]
    convention: ConventionArg,
    /// The target in the last frame of the table, mm, such as 0,0,100
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = target)]
    target_mm: Option<Target>,
    #[command(flatten)]
    output: OutputArgs,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ConventionArg {
    /// A row's a and alpha come before its joint ("modified")
    Craig,
    /// A row's a and alpha come after its joint ("classic")
    Standard,
}

/// The chain of a URDF, and the target.
#[derive(Debug, Clone, Default, clap::Args)]
pub(super) struct ChainArgs {
    /// The link of a URDF that is the base [default: its root]
    #[arg(long, value_name = "LINK")]
    pub base: Option<String>,
    /// The link of a URDF that is the flange [default: its end, if it has only one]
    #[arg(long, value_name = "LINK")]
    pub tip: Option<String>,
    /// The target in the frame of the tip, mm, such as 12.5,0,80
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = target)]
    pub target_mm: Option<Target>,
    /// Gravity in the frame of the base, m/s², if its z axis does not point up; such as 0,-9.81,0
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = acceleration)]
    pub gravity_m_per_s2: Option<Acceleration>,
}

impl ChainArgs {
    /// The robot from its file, or from its URDF, with a report of what was made. Flags of a URDF together with a robot's file are an error
    /// of usage.
    pub(super) fn robot(&self, model: Option<&Path>, urdf: Option<&Path>) -> Result<Robot, CliError> {
        let Some(urdf) = urdf else {
            let flags = [
                ("--base", self.base.is_some()),
                ("--tip", self.tip.is_some()),
                ("--target-mm", self.target_mm.is_some()),
                ("--gravity-m-per-s2", self.gravity_m_per_s2.is_some()),
            ];
            if let Some((flag, _)) = flags.iter().find(|(_, given)| *given) {
                let message = format!("{flag}: expected --urdf with it; a robot's file states this itself");
                Cli::command().error(ErrorKind::ArgumentConflict, message).exit();
            }
            return Ok(load_robot(model.unwrap_or(Path::new("robot.toml")))?);
        };
        let (source, told) = Source::read_foreign(urdf)?;
        if let Some(told) = told {
            say(&told);
        }
        let made = robot_from_urdf(&source, &self.options())?;
        made.remarks.iter().for_each(|line| say(line));
        Ok(made.robot)
    }

    fn options(&self) -> UrdfOptions {
        UrdfOptions {
            base: self.base.clone(),
            tip: self.tip.clone(),
            target: self.target_mm.map(|target| target.0),
            gravity: self.gravity_m_per_s2.map(|gravity| gravity.0),
        }
    }
}

#[derive(Debug, clap::Args)]
struct OutputArgs {
    /// Folder for robot.toml
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite an existing robot.toml
    #[arg(long)]
    force: bool,
    /// Print the result as JSON (schema calibrig.model/1)
    #[arg(long)]
    json: bool,
}

/// A place, m.
#[derive(Debug, Clone, Copy)]
pub(super) struct Target(Vector3<f64>);

/// m/s²
#[derive(Debug, Clone, Copy)]
pub(super) struct Acceleration(Vector3<f64>);

/// Three numbers separated by commas.
fn three(text: &str) -> Option<Vector3<f64>> {
    let numbers: Vec<f64> = text.split(',').filter_map(|number| number.trim().parse().ok()).collect();
    match (numbers.as_slice(), text.split(',').count()) {
        ([x, y, z], 3) => Some(Vector3::new(*x, *y, *z)),
        _ => None,
    }
}

fn target(text: &str) -> Result<Target, String> {
    match three(text).filter(|place| place.iter().all(|number| number.abs() <= 1e6)) {
        Some(place) => Ok(Target(place / 1e3)),
        None => Err("expected three numbers of mm separated by commas, such as 12.5,0,80".to_owned()),
    }
}

fn acceleration(text: &str) -> Result<Acceleration, String> {
    match three(text).filter(|gravity| (0.1..=100.0).contains(&gravity.norm())) {
        Some(gravity) => Ok(Acceleration(gravity)),
        None => Err("expected three numbers of m/s² separated by commas, such as 0,-9.81,0".to_owned()),
    }
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let (mut made, told, output, file) = match &args.from {
        From::FromUrdf(args) => {
            let (source, told) = Source::read_foreign(&args.file)?;
            (robot_from_urdf(&source, &args.chain.options())?, told, &args.output, &args.file)
        }
        From::FromDh(args) => {
            let (source, told) = Source::read_foreign(&args.file)?;
            let convention = match args.convention {
                ConventionArg::Craig => Convention::Craig,
                ConventionArg::Standard => Convention::Standard,
            };
            let target = args.target_mm.map(|target| target.0);
            (robot_from_dh(&source, convention, target)?, told, &args.output, &args.file)
        }
    };
    made.remarks.splice(0..0, told);
    let path = write(&made, output)?;
    made.remarks.iter().for_each(|line| say(line));
    let text = if output.json { as_json(&made, file, &path) } else { as_text(&made, &path) };
    print(&text)?;
    Ok(Verdict::Done)
}

/// The file takes its name when it is complete.
fn write(made: &Converted, output: &OutputArgs) -> Result<PathBuf, CliError> {
    let folder = &output.out;
    let path = folder.join("robot.toml");
    let in_the_way = |at: &Path, what, expected| {
        Err(CliError::InTheWay { folder: folder.clone(), at: at.to_path_buf(), what, expected })
    };
    if let Some(at) = folder.ancestors().find(|path| path.exists())
        && !at.is_dir()
    {
        return in_the_way(at, "no folder", "a folder, or the name of a new one");
    }
    if path.is_dir() {
        return in_the_way(
            &path,
            "a folder",
            "the name of a folder; in this one, a folder has the name of a file to be written",
        );
    }
    if path.exists() && !output.force {
        return Err(CliError::AlreadyThere { paths: vec![path] });
    }
    let failed = |source| CliError::Output { what: path.display().to_string(), source };
    fs::create_dir_all(folder).map_err(failed)?;
    super::write_whole(folder, &path, &made.source.text).map_err(failed)?;
    Ok(path)
}

/// Which commands can use the model, in words.
fn ready(made: &Converted) -> &'static str {
    if made.robot.model.statics.is_some() {
        "ready for identifiability, choose, identify, and as the robot of a scenario (the stiffnesses are guesses)"
    } else {
        "ready for identifiability, choose, identify; a scenario also needs masses of all moving links, stiffnesses and \
         [gravity]"
    }
}

fn as_text(made: &Converted, path: &Path) -> String {
    let model = &made.robot.model;
    let joints = model.kinematics.joint_count();
    let compared = made.difference.map_or_else(String::new, |difference| {
        format!(", at most {difference:.1e} m from its URDF at 1000 poses")
    });
    format!(
        "{}: {}, {joints} joint{}{compared}\n{}\n",
        path.display(),
        made.robot.name,
        if joints == 1 { "" } else { "s" },
        ready(made)
    )
}

fn as_json(made: &Converted, file: &Path, path: &Path) -> String {
    let model = &made.robot.model;
    let value = json!({
        "schema": "calibrig.model/1",
        "file": file.display().to_string(),
        "model": path.display().to_string(),
        "name": made.robot.name,
        "joints": model.kinematics.links.iter().map(|link| &link.name).collect::<Vec<_>>(),
        "gravity": model.statics.is_some(),
        "largest_difference_m": made.difference,
        "remarks": made.remarks,
    });
    format!("{value:#}\n")
}
