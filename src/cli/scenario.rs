//! `calibrig scenario`.

use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde_json::json;

use super::{CliError, Verdict, print, say};
use crate::twin::{Mounting, Preset, SizeClass, Twin, TwinOptions, twin};
use calibrig_files::{InputError, load_robot};
use calibrig_model::JointKind;

/// Make a scenario: the simulated twin of a robot
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig scenario new --model models/ur5/robot.toml --out ur5.toml
  calibrig scenario new --model models/wam/robot.toml --mounting wall --out wam.toml")]
pub(super) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    New(NewArgs),
}

/// Write the simulated twin of a robot, ready to run
///
/// From only the robot's file: a box of joint variables in which it touches neither itself nor the floor, a place for the tracker that sees it,
/// nests, and as many poses as its parameters need. As-built errors, stiffnesses and effects are those of a size class, each with its source or
/// reason next to it in the file, which you can edit.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig scenario new --model models/ur5/robot.toml --out ur5.toml
  calibrig scenario new --model models/ur5/robot.toml --out hanging.toml --mounting ceiling --tracker gts3800
  calibrig scenario new --model models/spray_painter/robot.toml --out painter.toml --class large --floor-mm -400

From a URDF, make a robot's file first: calibrig model from-urdf FILE --out DIR.")]
struct NewArgs {
    /// The robot's file
    #[arg(long, value_name = "ROBOT.toml")]
    model: PathBuf,
    /// File for the scenario
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Size class, which sets errors, stiffnesses and effects [default: by reach and moving mass]
    #[arg(long, value_enum)]
    class: Option<ClassArg>,
    /// How the base is mounted [default: as the robot's file states]
    #[arg(long, value_enum)]
    mounting: Option<MountingArg>,
    /// The tracker: at500, at960, vantage or gts3800
    #[arg(long, value_name = "PRESET", default_value = "at500", value_parser = preset)]
    tracker: Preset,
    /// Height of the floor above the base's origin, mm, such as -400 [default: by the robot's own heights]
    #[arg(long, value_name = "MM", allow_hyphen_values = true, value_parser = millimetres)]
    floor_mm: Option<f64>,
    /// Seed of its random draws
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
    /// Print what was chosen as JSON (schema calibrig.twin/1)
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ClassArg {
    /// Such as a UR5, an iiwa, an IRB 120
    Small,
    /// Such as a KR 240
    Medium,
    /// On a rail or a gantry
    Large,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum MountingArg {
    /// The base's z axis upwards
    Floor,
    /// The base's z axis level, its x axis upwards
    Wall,
    /// The base's z axis downwards
    Ceiling,
}

fn preset(text: &str) -> Result<Preset, String> {
    Preset::parse(text).ok_or_else(|| {
        let known: Vec<_> = Preset::ALL.iter().map(|preset| preset.key()).collect();
        format!("expected one of: {}", known.join(", "))
    })
}

fn millimetres(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.abs() <= 1e6 => Ok(number),
        _ => Err("expected a number of mm such as -400, at most a kilometre either way".to_owned()),
    }
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let What::New(args) = &args.what;
    check_place(args)?;
    let robot = load_robot(&args.model).map_err(|error| about_urdf(error, &args.model))?;
    robot.remarks.iter().for_each(|remark| say(remark));
    let options = TwinOptions {
        class: args.class.map(|class| match class {
            ClassArg::Small => SizeClass::Small,
            ClassArg::Medium => SizeClass::Medium,
            ClassArg::Large => SizeClass::Large,
        }),
        mounting: args.mounting.map(|mounting| match mounting {
            MountingArg::Floor => Mounting::Floor,
            MountingArg::Wall => Mounting::Wall,
            MountingArg::Ceiling => Mounting::Ceiling,
        }),
        preset: args.tracker,
        floor: args.floor_mm.map(|height| 1e-3 * height),
        seed: args.seed,
    };
    let named = from_folder_of(&args.out, &args.model);
    let made = twin(&robot, &named, &options)
        .map_err(|source| CliError::Twin { file: args.model.clone(), source: Box::new(source) })?;
    write(args, &made.text)?;
    made.told.iter().for_each(|told| say(told));
    print(&if args.json { as_json(args, &made) } else { as_text(args, &made) })?;
    Ok(Verdict::Done)
}

/// A URDF is refused here rather than read: a robot's file is made from it first, where missing values are asked for.
fn about_urdf(error: InputError, path: &Path) -> CliError {
    let is_urdf =
        path.extension().is_some_and(|ext| ["urdf", "xml", "xacro"].iter().any(|known| ext == *known));
    if !is_urdf || matches!(error, InputError::Unreadable { .. }) {
        return error.into();
    }
    let help = format!(
        "expected a robot's file: `calibrig model from-urdf {} --out DIR` makes one from a URDF",
        path.display()
    );
    InputError::Place {
        place: path.display().to_string(),
        message: "not a robot's file".to_owned(),
        help: Some(help),
    }
    .into()
}

/// Refuses a name that cannot be written to, before anything is computed.
fn check_place(args: &NewArgs) -> Result<(), CliError> {
    let path = &args.out;
    let folder = folder_of(path);
    let in_the_way = |at: &Path, what, expected| {
        Err(CliError::InTheWay { folder: folder.to_path_buf(), at: at.to_path_buf(), what, expected })
    };
    if path.is_dir() {
        return in_the_way(path, "a folder", "the name of a file in it, such as twin.toml");
    }
    if let Some(at) = folder.ancestors().find(|at| at.exists())
        && !at.is_dir()
    {
        return in_the_way(at, "no folder", "a folder, or the name of a new one");
    }
    if path.exists() && !args.force {
        return Err(CliError::AlreadyThere { paths: vec![path.clone()] });
    }
    Ok(())
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The file takes its name when it is complete.
fn write(args: &NewArgs, text: &str) -> Result<(), CliError> {
    let path = &args.out;
    let folder = folder_of(path);
    let failed = |source| CliError::Output { what: path.display().to_string(), source };
    fs::create_dir_all(folder).map_err(failed)?;
    super::write_whole(folder, path, text).map_err(failed)
}

/// The path of a file as another file names it: relative to that file's folder.
fn from_folder_of(other: &Path, file: &Path) -> String {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    // The other file does not exist yet.
    let (folder, file) = (absolute(folder_of(other)), absolute(file));
    let (folder, file) =
        (fs::canonicalize(&folder).unwrap_or(folder), fs::canonicalize(&file).unwrap_or(file));
    let (mine, theirs): (Vec<_>, Vec<_>) = (folder.components().collect(), file.components().collect());
    let common = mine.iter().zip(&theirs).take_while(|(a, b)| a == b).count();
    if common == 0 {
        return file.display().to_string();
    }
    let up = std::iter::repeat_n("..", mine.len() - common).map(PathBuf::from);
    let down = theirs[common..].iter().map(|part| PathBuf::from(part.as_os_str()));
    let path: PathBuf = up.chain(down).collect();
    path.display().to_string()
}

fn as_text(args: &NewArgs, made: &Twin) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    let mut line = |words: std::fmt::Arguments<'_>| {
        // Writing to a String cannot fail.
        let _ = text.write_fmt(words);
        text.push('\n');
    };
    let scenario = &made.scenario;
    let mass = made
        .mass
        .map_or("unknown masses, so that nothing deflects".to_owned(), |m| format!("moves {m:.0} kg"));
    line(format_args!("{}: the twin of {}", args.out.display(), scenario.robot.name));
    line(format_args!("  size         class {}: reaches {:.2} m, {mass}", made.class, made.reach));
    for (index, link) in scenario.robot.model.kinematics.links.iter().enumerate() {
        let (unit, scale) = match link.kind {
            JointKind::Prismatic => ("mm", 1e3),
            JointKind::Revolute => ("deg", 1_f64.to_degrees()),
        };
        let (centre, half) = (made.region.centre[index], made.region.half_width[index]);
        let title = if index == 0 { "region" } else { "" };
        line(format_args!(
            "  {title:<12} {:<12} {:8.1} to {:8.1} {unit}",
            link.name,
            scale * (centre - half),
            scale * (centre + half)
        ));
    }
    let [x, y, z] = [0, 1, 2].map(|axis| 1e3 * made.place.position[axis]);
    line(format_args!(
        "  tracker      {} at ({x:.0}, {y:.0}, {z:.0}) mm sees {:.0} % of the poses, at {:.1} m on average",
        args.tracker.key(),
        100.0 * made.place.seen,
        made.place.range
    ));
    line(format_args!(
        "  poses        {} to fit, {} to verify, for {} link parameters",
        made.poses[0], made.poses[1], made.parameters[0]
    ));
    let effects: Vec<_> = scenario.as_built.effects.active().iter().map(|effect| effect.key()).collect();
    line(format_args!("  effects      {}", effects.join(", ")));
    let file = crate::report::quoted(&args.out.display().to_string());
    line(format_args!("\nEvery number has its reason next to it in the file. Next:"));
    line(format_args!("  calibrig check {file}"));
    line(format_args!("  calibrig identifiability {file}"));
    line(format_args!("  calibrig run {file}"));
    line(format_args!("  calibrig montecarlo {file} --trials 100"));
    text
}

fn as_json(args: &NewArgs, made: &Twin) -> String {
    let links = &made.scenario.robot.model.kinematics.links;
    let region =
        links.iter().zip(made.region.centre.iter().zip(&made.region.half_width)).map(|(link, (c, h))| {
            let key = if link.kind == JointKind::Prismatic { "m" } else { "rad" };
            json!({ "joint": link.name, "unit": key, "least": c - h, "most": c + h })
        });
    let value = json!({
        "schema": "calibrig.twin/1",
        "scenario": args.out.display().to_string(),
        "robot": made.scenario.robot.name,
        "class": made.class.key(),
        "reach_m": made.reach,
        "mass_kg": made.mass,
        "region": region.collect::<Vec<_>>(),
        "extent_m": made.extent.map(<[f64; 3]>::from),
        "tracker": {
            "preset": args.tracker.key(),
            "position_m": <[f64; 3]>::from(made.place.position),
            "yaw_rad": made.place.yaw,
            "seen": made.place.seen,
            "mean_range_m": made.place.range,
        },
        "identification_poses": made.poses[0],
        "verification_poses": made.poses[1],
        "link_parameters": made.parameters[0],
        "rank": made.parameters[1],
        "remarks": made.told,
    });
    format!("{value:#}\n")
}
