//! `calibrig identify`.

use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::{CommandFactory, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use super::by_name::{self, ByNameArgs};
use super::measured::{AskedSet, Maps, RowArgs, hash_files};
use super::model::ChainArgs;
use super::output::{self, Destination, Files};
use super::reread::RereadArgs;
use super::{Cli, CliError, Verdict, not_identified_at, print, say};
use crate::pipeline::{
    InputHash, InputSummary, Outcome, PipelineError, SetOutcome, SplitPlan, SplitStudy, SteadySets,
    calibrate, commands_beyond_limits, default_options, foresee_sensors, is_default, judge, pose_count,
    repeat_splits, without_drift, without_gross_errors,
};
use calibrig_estimation::identification::{
    Assumption, ComplianceChoice, DEFAULT_TOLERANCE, IdentificationOptions, LINKAGE, Loss,
    MachineNoiseChoice, Mode, ParameterBound, RefusedBound, SolverOptions, Tolerance, UNKNOWN_STIFFNESS,
    check_bounds,
};
use calibrig_files::{ColumnMap, Places, is_bag, load_column_map, parse_column_map};
use calibrig_files::{InputError, Robot};
use calibrig_files::{MeasuredFile, SessionFile, Source, Statements, load_session, state};
use calibrig_files::{add_followers, commanded_joints};
use calibrig_model::measurement::{MeasurementSet, Observation, SetKind};
use calibrig_model::{BodyUncertainty, CalibrationModel, FAMILIES, JointKind, ParameterId, Unit};

/// Calibrate a robot from measured positions in a file, and verify it on another file
///
/// A file of positions says nothing about the tracker's place and the target's offset on the flange: both are identified together with
/// the links, unless a session file (--session) states base nests and measured offsets, or the robot's file states the offset of its
/// [target]. Values with an uncertainty are priors; an offset without one is a starting value. All assumptions are reported. The
/// parameters are a complete independent set, chosen by rank from the robot's table. A prior from the robot's manufacturing tolerance
/// holds the directions that the measurements hardly show; rank and weak directions are reported without it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig identify --model models/ur5/robot.toml --measurements grid.csv --verify random.csv
  calibrig identify --model models/ur5/robot.toml --measurements grid.csv --out ur5 --json
  calibrig identify --model robot.toml --measurements m.txt --columns map.toml --parameters rules
  calibrig identify --model robot.toml --joints j.csv --measurements A=a.txt --measurements B=b.txt
  calibrig identify --model robot.toml --measurements m.csv --missed -9999 --verify-poses 41..60
  calibrig identify --model robot.toml --measurements m.csv --mode elasto_geometric
  calibrig identify --model robot.toml --measurements m.csv --compliances compliance_drive2
  calibrig identify --model robot.toml --measurements m.csv --mode extended --terms rail,ratio
  calibrig identify --model robot.toml --measurements m.csv --loss tukey   names outliers
  calibrig identify --model robot.toml --measurements m.csv --bound delta_a4=-5mm..5mm
  calibrig identify --model robot.toml --measurements m.csv --list-parameters   what would be fitted
  calibrig identify --model robot.toml --measurements m.csv --fix target_z --free delta_d3
  calibrig identify --model robot.toml --measurements m.csv --splits 20 --fit 200
  calibrig identify --model robot.toml --measurements m.csv --session session.toml   nests, targets
  calibrig identify --model robot.toml --measurements m.csv --sweeps rail.csv --sweeps waist.csv
  calibrig identify --urdf ur5.urdf --tip tool0 --measurements grid.csv --columns map.toml

The columns are described by --columns MAP.toml, else by the map that the robot's file names, else (and if the file
has calibrig's own joint columns and none of the map's) they have calibrig's own layout (see docs/formats.md).")]
pub(super) struct Args {
    #[command(flatten)]
    files: FileArgs,
    #[command(flatten)]
    named: ByNameArgs,
    /// Models to fit, besides the robot without calibration; may be repeated [default: only geometry and, if the robot's files give masses
    /// and stiffnesses, gravity; geometry and stiffness instead if the stiffnesses are known to 100 % or worse]
    #[arg(long, value_name = "MODE", value_parser = fitted_mode)]
    mode: Vec<Mode>,
    /// Terms of the mode `extended`, by family, such as rail,ratio; "none" for none [default: all that the robot can
    /// have]
    #[arg(long, value_name = "FAMILY,..", value_delimiter = ',', value_parser = family)]
    terms: Option<Vec<String>>,
    /// Compliances of the modes `elasto_geometric` and `extended`: drives, all, or names such as `compliance_drive2`
    #[arg(long, value_name = "WHICH,..", value_delimiter = ',', default_value = "drives")]
    compliances: Vec<String>,
    /// Limits of a parameter's deviation, in mm, mrad or (compliances, masses) without unit; one end may be open. May be
    /// repeated. Examples: `delta_a4=-5mm..5mm`, `compliance_drive2=0..`
    #[arg(long, value_name = "NAME=MIN..MAX", value_parser = bound)]
    bound: Vec<ParameterBound>,
    /// Random errors of the machine from pose to pose: estimated if the residuals call for it, always estimated, or as stated with
    /// --actuator-sigma (without it: none)
    #[arg(long, value_enum, default_value_t = MachineNoiseArg::AsNeeded)]
    machine_noise: MachineNoiseArg,
    /// Standard deviation of an actuator, in mm or mrad, such as waist=0.05mrad; with --machine-noise stated. May be repeated
    #[arg(long, value_name = "NAME=VALUE")]
    actuator_sigma: Vec<String>,
    /// Loss of a measurement far from the others: its square, or less
    #[arg(long, value_enum, default_value_t = LossArg::Squared)]
    loss: LossArg,
    /// Prior knowledge of the compliances: standard deviation in per cent of the predicted value, such as 20; "unknown" for a prior on their
    /// logarithms, a factor of 100 wide [default: as the robot's file states, else 10]
    #[arg(long, value_name = "PERCENT", value_parser = compliance_percent)]
    compliance_percent: Option<CompliancePercent>,
    /// Prior knowledge of the links' masses: standard deviation in per cent of each; 0 for exact [default: as the robot's file states, else
    /// exact]
    #[arg(long, value_name = "PERCENT", value_parser = not_negative)]
    mass_percent: Option<f64>,
    /// Prior knowledge of their centres of mass: standard deviation along each axis, mm; 0 for exact [default: as the robot's file states,
    /// else exact]
    #[arg(long, value_name = "MM", value_parser = not_negative)]
    centre_mm: Option<f64>,
    /// Prior knowledge of the links' lengths: standard deviation, mm; 0 for no prior, then with --tolerance-mrad 0
    #[arg(long, value_name = "MM", default_value_t = 1e3 * DEFAULT_TOLERANCE.length, allow_negative_numbers = true, value_parser = tolerance_value)]
    tolerance_mm: f64,
    /// Prior knowledge of the links' angles: standard deviation, mrad; 0 for no prior, then with --tolerance-mm 0
    #[arg(long, value_name = "MRAD", default_value_t = 1e3 * DEFAULT_TOLERANCE.angle, allow_negative_numbers = true, value_parser = tolerance_value)]
    tolerance_mrad: f64,
    /// Largest number of iterations of a fit, including rejected steps
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    max_iterations: u32,
    /// Split the measurements at random this many times, fit one part and verify on the rest, and compare every mode with the one
    /// before
    #[arg(long, value_name = "N", requires = "fit", value_parser = clap::value_parser!(u32).range(2..=100_000))]
    splits: Option<u32>,
    /// Poses that are fitted in each split
    #[arg(long, value_name = "POSES", requires = "splits", value_parser = clap::value_parser!(u32).range(1..))]
    fit: Option<u32>,
    /// Seed of the random splits
    #[arg(long, value_name = "N", requires = "splits", default_value_t = 1)]
    seed: u64,
    /// Fit even if the nominal robot does not fit the points; ends with exit code 3
    #[arg(long)]
    fit_anyway: bool,
    /// Folder for report.html, report.json and residuals.csv, which are overwritten [default: no files]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the report as JSON (schema calibrig.report/1) instead of the tables
    #[arg(long)]
    json: bool,
}

/// A robot, its measurements, and what is stated beforehand.
#[derive(Debug, clap::Args)]
pub(super) struct FileArgs {
    /// The robot's file
    #[arg(long, value_name = "ROBOT.toml", required_unless_present = "urdf")]
    model: Option<PathBuf>,
    /// The robot's URDF in place of a file of its own; read as `calibrig model from-urdf` does
    #[arg(long, value_name = "FILE", conflicts_with = "model")]
    urdf: Option<PathBuf>,
    #[command(flatten)]
    chain: ChainArgs,
    /// Positions to fit; may be repeated, for example with one file per target
    #[arg(long, value_name = "[TARGET=]FILE", required = true)]
    measurements: Vec<String>,
    /// Positions to verify on; may be repeated
    #[arg(long, value_name = "[TARGET=]FILE")]
    verify: Vec<String>,
    /// Like --joints, for the files of --verify
    #[arg(long, value_name = "FILE", requires = "verify")]
    verify_joints: Option<PathBuf>,
    #[command(flatten)]
    rows: RowArgs,
    /// Column map of the files, instead of the one named in the robot's file
    #[arg(long, value_name = "MAP.toml")]
    columns: Option<PathBuf>,
    /// Session file: stations with their nests, targets with their uncertainty, what all poses carry, and dropped poses (docs/formats.md); its
    /// targets replace that of the robot's file [default: stations of unknown place, and [target] of the robot's file]
    #[arg(long, value_name = "SESSION.toml")]
    session: Option<PathBuf>,
    /// Readings taken while single joints moved and all others rested; they place the tracker if there are no base nests, or with --frame
    /// sweeps. Same layout as the measurements. May be repeated
    #[arg(long, value_name = "FILE")]
    sweeps: Vec<String>,
    #[command(flatten)]
    reread: RereadArgs,
}

impl FileArgs {
    /// The first file to fit, for messages.
    pub(super) fn first(&self) -> PathBuf {
        let sets = self.rows.sets(&self.measurements, &[], None);
        sets.first()
            .and_then(|set| set.files.points.first())
            .map(|file| file.path.clone())
            .unwrap_or_default()
    }

    pub(super) fn read(&self) -> Result<Loaded, CliError> {
        let robot = self.chain.robot(self.model.as_deref(), self.urdf.as_deref())?;
        let sets = self.rows.sets(&self.measurements, &self.verify, self.verify_joints.as_deref());
        let mut loaded = load(robot, self.columns.as_deref(), self.session.as_deref(), &self.rows, sets)?;
        self.reread.apply(&mut loaded.sets, &mut loaded.places);
        self.add_sweeps(&mut loaded)?;
        Ok(loaded)
    }
}

impl FileArgs {
    /// Adds the readings of the files of sweeps to the stations of all sets.
    fn add_sweeps(&self, loaded: &mut Loaded) -> Result<(), CliError> {
        if self.sweeps.is_empty() {
            return Ok(());
        }
        let rows = self.rows.of_sweeps();
        let asked = rows.sets(&self.sweeps, &[], None);
        let robot = loaded.robot.clone();
        let mut swept = load(robot, self.columns.as_deref(), self.session.as_deref(), &rows, asked)?;
        self.reread.apply(&mut swept.sets, &mut swept.places);
        let mut hash = InputHash::default();
        hash.add("measurements", &loaded.sha256);
        hash.add("sweeps", &swept.sha256);
        loaded.sha256 = hash.hex();
        loaded.read.append(&mut swept.read);
        let of_sweeps = |(role, source): &(String, Source)| {
            (role == SetKind::Identification.key()).then(|| ("sweeps".to_owned(), source.clone()))
        };
        loaded.sources.extend(swept.sources.iter().filter_map(of_sweeps));
        let Some((read, places)) = swept.sets.first().zip(swept.places.first()) else { return Ok(()) };
        let read = &read.measurements;
        for (row, reading) in read.observations.iter().enumerate() {
            let (station, target) =
                (&read.stations[reading.station].name, &read.targets[reading.target].name);
            for set in loaded.sets.iter_mut().map(|set| &mut set.measurements) {
                let at = set.stations.iter().position(|own| own.name == *station);
                let of = set.targets.iter().position(|own| own.name == *target);
                let (Some(at), Some(of)) = (at, of) else {
                    return Err(InputError::Place {
                        place: places.of(row).unwrap_or_default(),
                        message: format!("a sweep is from station {station} with target {target}, but the measurements lack \
                                          one of them"),
                        help: Some("expected sweeps from stations, and with a target, that occur in --measurements".to_owned()),
                    }
                    .into());
                };
                set.stations[at].sweeps.push(Observation { station: at, target: of, ..reading.clone() });
            }
        }
        Ok(())
    }
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum MachineNoiseArg {
    /// If residuals are larger than the readings' noise explains, or readings of a pose depend on each other
    AsNeeded,
    /// Always
    Estimated,
    /// Only what --actuator-sigma states
    Stated,
}

/// The values of `--machine-noise` and `--actuator-sigma`. An invalid one is an error of usage.
fn machine_noise(args: &Args, model: &CalibrationModel) -> MachineNoiseChoice {
    let sigmas = actuator_sigmas(&args.actuator_sigma, model);
    match args.machine_noise {
        MachineNoiseArg::Stated => MachineNoiseChoice::Stated(sigmas),
        _ if !args.actuator_sigma.is_empty() => {
            let message = "--actuator-sigma: expected --machine-noise stated with it";
            Cli::command().error(ErrorKind::ValueValidation, message).exit()
        }
        MachineNoiseArg::AsNeeded => MachineNoiseChoice::AsNeeded,
        MachineNoiseArg::Estimated => MachineNoiseChoice::Estimated,
    }
}

/// Standard deviation of every actuator from `--actuator-sigma`, m or rad. An invalid one is an error of usage.
pub(super) fn actuator_sigmas(stated: &[String], model: &CalibrationModel) -> Vec<f64> {
    let refuse = |message: String| -> ! { Cli::command().error(ErrorKind::ValueValidation, message).exit() };
    let links = &model.kinematics.links;
    let mut sigmas = vec![0.0; links.len()];
    for text in stated {
        let Some((name, value)) = text.split_once('=') else {
            refuse(format!("--actuator-sigma {text}: expected a name and a value, such as waist=0.05mrad"))
        };
        let Some(place) = links.iter().position(|link| link.name == name) else {
            let names = links.iter().map(|link| link.name.as_str()).collect::<Vec<_>>().join(", ");
            refuse(format!("--actuator-sigma {text}: expected one of the robot's actuators: {names}"))
        };
        let unit = if links[place].kind == JointKind::Prismatic { "mm" } else { "mrad" };
        let number = value.strip_suffix(unit).and_then(|number| number.parse::<f64>().ok());
        let Some(number) = number.filter(|number| (0.0..=1e6).contains(number)) else {
            refuse(format!("--actuator-sigma {text}: expected a number of {unit}, zero or more"))
        };
        sigmas[place] = 1e-3 * number;
    }
    sigmas
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum LossArg {
    /// Least squares
    Squared,
    /// Linear beyond 1.6 standard deviations
    Huber,
    /// Logarithmic
    Cauchy,
    /// No influence at all beyond 5.5 standard deviations
    Tukey,
}

impl From<LossArg> for Loss {
    fn from(loss: LossArg) -> Self {
        match loss {
            LossArg::Squared => Self::Squared,
            LossArg::Huber => Self::huber(),
            LossArg::Cauchy => Self::cauchy(),
            LossArg::Tukey => Self::tukey(),
        }
    }
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    if (args.tolerance_mm > 0.0) != (args.tolerance_mrad > 0.0) {
        let message = format!(
            "--tolerance-mm {} with --tolerance-mrad {}: expected 0 for both, or both above zero",
            args.tolerance_mm, args.tolerance_mrad
        );
        Cli::command().error(ErrorKind::ArgumentConflict, message).exit();
    }
    let destination = args.out.as_deref().map(Destination::Asked);
    if let Some(destination) = destination {
        destination.check(Files::Reports)?;
    }
    let prepared = prepare(args)?;
    if args.named.list_parameters {
        let Prepared { robot, sets, places, options, modes, .. } = &prepared;
        let listed = by_name::list(robot, &sets[0].measurements, modes, options, args.json)
            .map_err(|error| failed(error, &args.files.first(), sets, places))?;
        return print(&listed).map(|()| Verdict::Done);
    }
    let (options, places) = (prepared.options.clone(), prepared.places.clone());
    let (mut outcome, statements, plausible) = outcome(args, prepared)?;
    if let (Some(splits), Some(fit)) = (args.splits, args.fit) {
        outcome.splits =
            Some(split_study(args, &outcome, &options, &places, (splits as usize, fit as usize))?);
    }
    let written = destination.map_or(Ok(()), |destination| {
        let (folder, new) = destination.make()?;
        output::or_removed(output::write(&outcome, &folder, None), &folder, new)
    });
    output::show(&outcome, args.json)?;
    written?;
    statements.remarks.iter().chain(&statements.assumed).for_each(|line| say(line));
    for set in &outcome.sets {
        for line in commands_beyond_limits(&outcome.model, &set.measurements) {
            say(&line);
        }
    }
    if tolerance(args).is_some() {
        say(&format!(
            "prior on the link parameters: 0 +- {} mm, 0 +- {} mrad (--tolerance-mm, --tolerance-mrad; 0 in both for none)",
            args.tolerance_mm, args.tolerance_mrad
        ));
    }
    if outcome.modes.iter().any(|mode| mode.mode.is_coupled()) {
        let prior = if options.stiffness_unknown {
            format!("unknown, within a factor of {:.0} of the predicted value", UNKNOWN_STIFFNESS.exp())
        } else {
            format!("predicted value +- {} %", 1e2 * options.compliance_sigma)
        };
        say(&format!("prior on the compliances: {prior} (--compliance-percent)"));
        let assumptions =
            outcome.modes.iter().filter_map(|mode| mode.estimate.as_ref()).flat_map(|e| &e.assumptions);
        let is_of_bodies =
            |made: &&Assumption| matches!(made, Assumption::BodiesExact | Assumption::BodiesStated);
        if let Some(made) = assumptions.clone().find(is_of_bodies) {
            say(&made.to_string());
        }
    }
    Ok(plausible.and(output::verdict(&outcome)))
}

fn split_study(
    args: &Args,
    outcome: &Outcome,
    options: &IdentificationOptions,
    places: &[Places],
    (splits, fitted): (usize, usize),
) -> Result<SplitStudy, CliError> {
    let empty = MeasurementSet::default();
    let set = outcome.sets.first().map_or(&empty, |set| &set.measurements);
    let largest = outcome.modes.iter().rev().find_map(|mode| mode.estimate.as_ref());
    let set = &largest.map_or_else(|| set.clone(), |estimate| without_gross_errors(set, estimate));
    let poses = pose_count(set);
    if fitted >= poses {
        let message = format!("--fit {fitted}: expected fewer poses than the measurements have, {poses}");
        Cli::command().error(ErrorKind::ValueValidation, message).exit();
    }
    let bar = ProgressBar::new(splits as u64);
    if let Ok(style) = ProgressStyle::with_template("split {pos}/{len} {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    let modes: Vec<_> = outcome.modes.iter().map(|mode| mode.mode).collect();
    let plan = SplitPlan { splits, fitted, seed: args.seed };
    let study =
        repeat_splits(&outcome.model, set, &modes, options, plan, |done| bar.set_position(done as u64));
    bar.finish_and_clear();
    study.map_err(|error| failed(error, &args.files.first(), &outcome.sets, places))
}

pub(super) fn fitted_mode(text: &str) -> Result<Mode, String> {
    Mode::parse(text).filter(|mode| *mode != Mode::WithoutCalibration).ok_or_else(|| {
        let modes = Mode::ALL.iter().filter(|mode| **mode != Mode::WithoutCalibration).map(|mode| mode.key());
        format!("expected one of: {}", modes.collect::<Vec<_>>().join(", "))
    })
}

fn bound(text: &str) -> Result<ParameterBound, String> {
    let expected = "expected a parameter and its limits, such as delta_a4=-5mm..5mm, delta_theta2=..3mrad or compliance_drive2=0..";
    let (name, limits) = text.split_once('=').ok_or(expected)?;
    let (lower, upper) = limits.split_once("..").ok_or(expected)?;
    let id = ParameterId::parse(name).ok_or_else(|| {
        format!("\"{name}\" is not the name of a parameter: expected {}", ParameterId::EXAMPLES)
    })?;
    let bound = ParameterBound {
        id,
        lower: limit(id, lower)?.unwrap_or(f64::NEG_INFINITY),
        upper: limit(id, upper)?.unwrap_or(f64::INFINITY),
    };
    bound.check().map_err(|error| format!("{error}: {}", error.help()))?;
    Ok(bound)
}

/// A limit in SI; `None` if that end is open.
fn limit(id: ParameterId, text: &str) -> Result<Option<f64>, String> {
    if text.is_empty() {
        return Ok(None);
    }
    let (unit, size) = match id.unit() {
        Unit::Metre => ("mm", 1e-3),
        Unit::Radian => ("mrad", 1e-3),
        Unit::One => ("", 1.0),
    };
    let number = text.strip_suffix(unit).and_then(|number| number.parse::<f64>().ok());
    match number {
        Some(number) if number.abs() <= 1e15 => Ok(Some(size * number)),
        _ if unit.is_empty() => {
            Err(format!("\"{text}\" of {id}: expected a number without unit, or nothing for an open end"))
        }
        _ => Err(format!(
            "\"{text}\" of {id}: expected a number of {unit}, such as 5{unit}, or nothing for an open end"
        )),
    }
}

/// Refuses bounds on parameters that no mode has, as an error of usage.
fn check_flags(
    model: &CalibrationModel,
    modes: &[Mode],
    options: &IdentificationOptions,
    set: &MeasurementSet,
) {
    let checked = check_bounds(model, modes, options, &set.stations, &set.targets);
    if let Err(RefusedBound { index, error }) = checked {
        let message = format!("--bound {}: {error}: {}", options.bounds[index].id, error.help());
        Cli::command().error(ErrorKind::ValueValidation, message).exit();
    }
}

const NO_TERMS: &str = "none";

/// What `--terms` asks for.
pub(super) fn terms(families: &[String]) -> Vec<String> {
    families.iter().filter(|key| *key != NO_TERMS).cloned().collect()
}

pub(super) fn family(text: &str) -> Result<String, String> {
    let known: Vec<_> =
        [NO_TERMS, LINKAGE].into_iter().chain(FAMILIES.iter().map(|family| family.key())).collect();
    if known.contains(&text) {
        return Ok(text.to_owned());
    }
    Err(format!("expected some of: {}", known.join(", ")))
}

/// How well stiffnesses are known beforehand.
#[derive(Debug, Clone, Copy)]
enum CompliancePercent {
    Within(f64),
    Unknown,
}

fn compliance_percent(text: &str) -> Result<CompliancePercent, String> {
    match text.parse::<f64>() {
        _ if text == "unknown" => Ok(CompliancePercent::Unknown),
        Ok(number) if (1e-6..=1e6).contains(&number) => Ok(CompliancePercent::Within(number)),
        _ => Err("expected a number from 0.000001 to 1000000, or \"unknown\"".to_owned()),
    }
}

fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (0.0..=1e6).contains(&number) => Ok(number),
        _ => Err("expected a number from 0 to 1000000".to_owned()),
    }
}

/// The bodies' uncertainties, replaced by those that flags state for all bodies.
fn bodies(args: &Args, robot: &Robot) -> Vec<BodyUncertainty> {
    let mut bodies = robot.bodies.clone();
    if args.mass_percent.is_some() || args.centre_mm.is_some() {
        bodies.resize(robot.model.statics.as_ref().map_or(0, |s| s.bodies.len()), BodyUncertainty::default());
    }
    for body in &mut bodies {
        body.mass = args.mass_percent.map_or(body.mass, |percent| 1e-2 * percent);
        body.centre = args.centre_mm.map_or(body.centre, |mm| 1e-3 * mm);
    }
    bodies
}

/// The value of `--compliances`. An invalid name is an error of usage.
pub(super) fn compliances(asked: &[String], model: &CalibrationModel) -> ComplianceChoice {
    match asked.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["drives"] => return ComplianceChoice::Drives,
        ["all"] => return ComplianceChoice::All,
        _ => {}
    }
    let known = model.compliances();
    let listed = asked.iter().map(|name| match ParameterId::parse(name) {
        Some(ParameterId::Compliance(compliance)) if known.contains(&compliance) => compliance,
        _ => {
            let names = known.iter().map(|compliance| ParameterId::Compliance(*compliance).to_string());
            let names: Vec<_> = names.collect();
            let expected = if names.is_empty() {
                "to leave this flag out: the robot's files give no finite stiffness".to_owned()
            } else {
                format!("drives, all, or some of: {}", names.join(", "))
            };
            let message = format!("--compliances {name}: expected {expected}");
            Cli::command().error(ErrorKind::InvalidValue, message).exit()
        }
    });
    ComplianceChoice::Listed(listed.collect())
}

fn tolerance_value(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number == 0.0 || (1e-6..=1e6).contains(&number) => Ok(number),
        _ => Err("expected a number from 0.000001 to 1000000, or 0".to_owned()),
    }
}

fn tolerance(args: &Args) -> Option<Tolerance> {
    (args.tolerance_mm > 0.0 && args.tolerance_mrad > 0.0)
        .then_some(Tolerance { length: 1e-3 * args.tolerance_mm, angle: 1e-3 * args.tolerance_mrad })
}

fn modes(args: &Args, robot: &Robot, options: &IdentificationOptions) -> Vec<Mode> {
    let wanted = |mode: &Mode| match mode {
        Mode::WithoutCalibration => true,
        _ if !args.mode.is_empty() => args.mode.contains(mode),
        _ => is_default(*mode, robot, options),
    };
    Mode::ALL.into_iter().filter(wanted).collect()
}

/// A robot and its measurements, as read from files.
pub(super) struct Loaded {
    pub robot: Robot,
    /// Every file by its role; files of measurements only by name.
    pub sources: Vec<(String, Source)>,
    /// One hash over all files.
    pub sha256: String,
    pub sets: Vec<SetOutcome>,
    /// File and row of the observations of every set.
    pub places: Vec<Places>,
    /// Remarks on the measurement files.
    pub read: Vec<String>,
    /// The files of measurements.
    pub asked: Vec<AskedSet>,
    /// What the files state beforehand of stations and targets.
    pub statements: Statements,
    /// The session file, and its text.
    session: Option<(SessionFile, Source)>,
}

impl Loaded {
    /// Refuses a session file that states values that cannot be used; a recording may hold it.
    pub(super) fn check_session(&self) -> Result<(), CliError> {
        match &self.session {
            Some((session, source)) => Ok(session.check_usable(source)?),
            None => Ok(()),
        }
    }
}

/// Reads a robot and files of positions, whose columns are described by `columns`, else by the robot's file, with the stations and targets
/// that `session` and the robot's file state.
pub(super) fn load(
    mut robot: Robot,
    columns: Option<&Path>,
    session: Option<&Path>,
    rows: &RowArgs,
    asked: Vec<AskedSet>,
) -> Result<Loaded, CliError> {
    let joints = commanded_joints(&robot.model);
    let paths = || asked.iter().flat_map(AskedSet::paths).map(|(_, path)| path);
    let mut rows = rows.clone();
    let bags = match columns {
        None if paths().any(is_bag) => Some(rows.of_bags(&robot)?),
        _ => None,
    };
    let columns = match columns {
        Some(path) => {
            let (map, source) = load_column_map(path)?;
            map.check_joints(&source, &joints)?;
            robot.sources.retain(|(role, _)| role != "columns");
            robot.sources.push(("columns".to_owned(), source));
            map
        }
        None => match robot.sources.iter().find(|(role, _)| role == "columns") {
            Some((_, source)) => {
                let map = parse_column_map(source)?;
                map.check_joints(source, &joints)?;
                map.or_own()
            }
            None => ColumnMap::default(),
        },
    };
    let mut files = rows.read(&asked, &Maps { files: columns, bags }, &joints)?;
    for file in &mut files {
        add_followers(&robot.model, &mut file.loaded.set);
    }
    let session = session.map(load_session).transpose()?;
    let stated = session.as_ref().map(|(session, source)| (session, source));
    let statements = state(&robot, stated, &mut files)?;
    let mut sources = robot.sources.clone();
    let mut hash = InputHash::default();
    for (role, source) in &sources {
        hash.add(role, &source.text);
    }
    hash_files(&mut hash, &asked)?;
    for (role, path) in asked.iter().flat_map(AskedSet::paths) {
        sources.push((role.to_owned(), Source::new(path.display().to_string(), "")));
    }
    if let Some((_, source)) = &session {
        hash.add("session", &source.text);
        sources.push(("session".to_owned(), source.clone()));
    }
    let (mut sets, mut places, mut read) = (Vec::new(), Vec::new(), Vec::new());
    for MeasuredFile { kind, loaded, .. } in files {
        places.push(loaded.places);
        read.extend(loaded.remarks);
        sets.push(SetOutcome { kind, measurements: loaded.set, dropped: loaded.dropped });
    }
    refuse_without_readings(&asked, &sets)?;
    Ok(Loaded { robot, sources, sha256: hash.hex(), sets, places, read, asked, statements, session })
}

/// Without readings there is nothing to do, and a recording could not be read back.
fn refuse_without_readings(asked: &[AskedSet], sets: &[SetOutcome]) -> Result<(), CliError> {
    let is_empty = |set: &&SetOutcome| set.measurements.observations.is_empty() && !set.dropped.is_empty();
    let Some(set) = sets.iter().find(is_empty) else { return Ok(()) };
    let first = set.dropped.first().map_or("no reason given", |(_, why)| why.as_str());
    let file = asked.iter().find(|asked| asked.kind == set.kind).or(asked.first());
    let file = file.and_then(|asked| asked.files.points.first()).map(|file| file.path.display().to_string());
    Err(InputError::Place {
        place: file.unwrap_or_default(),
        message: format!("every row of the {} set is a missed shot; the first: {first}", set.kind.key()),
        help: Some("expected a position other than (0, 0, 0) in at least one row".to_owned()),
    }
    .into())
}

/// The failure of an identification from these files, at the rows that it names, or at the last row if more poses are needed.
pub(super) fn failed(
    error: impl Into<PipelineError>,
    file: &Path,
    sets: &[SetOutcome],
    places: &[Places],
) -> CliError {
    let error = error.into();
    let fitted = (sets.first().map_or(0, |set| set.measurements.observations.len()), places.first());
    let last = fitted.1.and_then(|places| places.of(fitted.0.checked_sub(1)?));
    let last = last.unwrap_or_else(|| file.display().to_string());
    match &error {
        PipelineError::Implausible(why) => {
            let set = sets.iter().position(|set| set.kind == why.kind).and_then(|index| places.get(index));
            let rows: Vec<String> =
                why.named().iter().filter_map(|index| set.and_then(|places| places.of(*index))).collect();
            let mut help = why.help();
            if rows.len() > 1 {
                help = format!("they are in {}; {help}", rows.join(", "));
            }
            let own = || Some(set?.of(0)?.rsplit_once(':')?.0.to_owned());
            let place = rows.first().cloned().or_else(own).unwrap_or_else(|| file.display().to_string());
            InputError::Place { place, message: error.to_string(), help: Some(help) }.into()
        }
        _ => not_identified_at(error, file, last),
    }
}

/// File and row of every observation of a set.
fn rows_of((set, places): (&SetOutcome, &Places)) -> Vec<String> {
    let count = set.measurements.observations.len();
    (0..count).map(|observation| places.of(observation).unwrap_or_default()).collect()
}

/// What is fitted to what, and how.
struct Prepared {
    robot: Robot,
    sources: Vec<(String, Source)>,
    sha256: String,
    sets: Vec<SetOutcome>,
    places: Vec<Places>,
    statements: Statements,
    options: IdentificationOptions,
    modes: Vec<Mode>,
}

fn prepare(args: &Args) -> Result<Prepared, CliError> {
    let loaded = args.files.read()?;
    loaded.check_session()?;
    let Loaded { robot, sources, sha256, sets, places, read, statements, .. } = loaded;
    for line in &read {
        say(line);
    }
    let mut options = IdentificationOptions {
        compliances: compliances(&args.compliances, &robot.model),
        bodies: bodies(args, &robot),
        solver: SolverOptions {
            loss: args.loss.into(),
            max_iterations: args.max_iterations as usize,
            ..SolverOptions::default()
        },
        terms: args.terms.as_deref().map(terms),
        bounds: args.bound.clone(),
        tolerance: tolerance(args),
        machine_noise: machine_noise(args, &robot.model),
        ..default_options(&robot)
    };
    args.named.apply(&robot.model, &mut options);
    match args.compliance_percent {
        Some(CompliancePercent::Within(percent)) => {
            (options.compliance_sigma, options.stiffness_unknown) = (1e-2 * percent, false);
        }
        Some(CompliancePercent::Unknown) => options.stiffness_unknown = true,
        None => {}
    }
    let modes = modes(args, &robot, &options);
    args.named.check(&robot.model, &modes, &options, &sets[0].measurements);
    check_flags(&robot.model, &modes, &options, &sets[0].measurements);
    Ok(Prepared { robot, sources, sha256, sets, places, statements, options, modes })
}

fn outcome(args: &Args, prepared: Prepared) -> Result<(Outcome, Statements, Verdict), CliError> {
    let Prepared { robot, sources, sha256, sets, places, statements, options, modes } = prepared;
    let measurements = &args.files.first();
    let SteadySets { sets, as_measured, drift } =
        without_drift(sets).map_err(|error| failed(error, measurements, &[], &places))?;
    let plausible = output::plausible(&robot.model, &sets, &options, args.fit_anyway)
        .map_err(|error| failed(error, measurements, &sets, &places))?;
    let (registration, modes) = calibrate(&robot.model, &sets, &modes, &options)
        .map_err(|error| failed(error, measurements, &sets, &places))?;
    let judgements = judge(&robot.model, &sets, &modes, &options)
        .map_err(|error| failed(error, measurements, &sets, &places))?;
    let sensors = foresee_sensors(&robot.model, &sets, &modes, &options);
    let outcome = Outcome {
        input: InputSummary { kind: "files", name: robot.name, sha256, seed: None, trial: None },
        sources,
        model: robot.model,
        visuals: robot.visuals,
        registration,
        places: sets.iter().zip(&places).map(rows_of).collect(),
        sets,
        as_measured,
        drift,
        missing: Vec::new(),
        modes,
        truth: None,
        bounds: Vec::new(),
        published: Vec::new(),
        judgements,
        sensors,
        ablation: None,
        splits: None,
        closed_loop: None,
        command: Some(output::command_line()),
    };
    Ok((outcome, statements, plausible))
}
