//! Files of measurements as commands take them: one or several, with what flags say about their rows.

use std::path::{Path, PathBuf};

use clap::CommandFactory;
use clap::error::ErrorKind;

use super::{Cli, CliError};
use crate::pipeline::{InputHash, SetKind};
use calibrig_files::{
    BagOptions, ColumnMap, DEFAULT_TOLERANCE_S, InputError, LoadedMeasurements, MeasuredFile,
    MeasurementFiles, MissedCode, PointsFile, PoseList, Robot, RowOptions, Source, is_bag, parse_column_map,
    read_files,
};
use calibrig_model::JointKind;

/// How the files are read.
pub(super) struct Maps {
    /// Text files and spreadsheets; bags too if none of their own is given here.
    pub files: ColumnMap,
    pub bags: Option<ColumnMap>,
}

impl Maps {
    fn of(&self, files: &MeasurementFiles) -> &ColumnMap {
        let paths = files.points.iter().map(|file| &file.path).chain(&files.joints);
        let bags = self.bags.as_ref().filter(|_| paths.into_iter().any(|path| is_bag(path)));
        bags.unwrap_or(&self.files)
    }
}

/// What flags say about rows, in addition to the column map.
#[derive(Debug, Clone, Default, clap::Args)]
pub(super) struct RowArgs {
    /// File with the commands, if they are not in the files of positions; joined row by row, or as [join] of the column map states
    #[arg(long, value_name = "FILE")]
    joints: Option<PathBuf>,
    /// Poses of --measurements that are held out: numbers, ranges such as 41..60, names
    #[arg(long, value_name = "POSES", value_parser = poses)]
    verify_poses: Option<PoseList>,
    /// Text in a cell of the position that marks a missed shot, such as -9999 or n/a. May be repeated
    #[arg(long, value_name = "CODE", allow_hyphen_values = true)]
    missed: Vec<String>,
    /// Take the signs of approach from the order of the rows
    #[arg(long)]
    approach_from_order: bool,
    /// Average repeated readings of a pose into one, with their mean and scatter
    #[arg(long)]
    average_repeats: bool,
    /// Average a front-face and a back-face reading of a pose into one
    #[arg(long)]
    average_faces: bool,
    /// Sheet of an XLSX file [default: the first]
    #[arg(long, value_name = "NAME")]
    sheet: Option<String>,
    /// Topic of the joint states in a bag (`sensor_msgs/JointState`), such as `/joint_states` [default: the only one]
    #[arg(long, value_name = "TOPIC")]
    bag_joints: Option<String>,
    /// Topic of the points in a bag (`geometry_msgs/PointStamped`, `PoseStamped`, `PoseWithCovarianceStamped` or `TransformStamped`,
    /// `nav_msgs/Odometry`); may be repeated, each is a target [default: the only one]
    #[arg(long, value_name = "TOPIC")]
    bag_points: Vec<String>,
    /// Largest time between a point and its joint state in a bag, ms [default: 50]
    #[arg(long, value_name = "MS", value_parser = milliseconds)]
    bag_tolerance_ms: Option<f64>,
    /// Names that the joints have in a bag.
    #[arg(skip)]
    bag_names: Vec<String>,
}

fn milliseconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (0.0..=1e6).contains(&number) => Ok(number),
        _ => Err("expected a number of milliseconds from 0 to 1000000".to_owned()),
    }
}

fn poses(text: &str) -> Result<PoseList, String> {
    PoseList::parse(text).map_err(|expected| format!("expected {expected}"))
}

/// `FILE`, or `TARGET=FILE` where the whole file is of one target.
fn points(text: &str) -> PointsFile {
    match text.split_once('=') {
        Some((target, path)) if !Path::new(text).exists() && !target.is_empty() => {
            PointsFile { target: Some(target.to_owned()), path: path.into() }
        }
        _ => PointsFile { target: None, path: text.into() },
    }
}

/// The files of a set that is asked for.
#[derive(Debug, Clone)]
pub(super) struct AskedSet {
    pub kind: SetKind,
    pub files: MeasurementFiles,
}

impl AskedSet {
    /// Every file, with the role that it has in a recording.
    pub fn paths(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let points = self.files.points.iter().map(|file| (self.kind.key(), file.path.as_path()));
        points.chain(self.files.joints.iter().map(|path| ("joints", path.as_path())))
    }
}

impl RowArgs {
    /// The sets that `--measurements` and `--verify` name.
    pub fn sets(
        &self,
        measurements: &[String],
        verify: &[String],
        verify_joints: Option<&Path>,
    ) -> Vec<AskedSet> {
        let set = |kind, texts: &[String], joints: Option<&Path>| {
            let files = MeasurementFiles {
                points: texts.iter().map(|text| points(text)).collect(),
                joints: joints.map(Path::to_path_buf),
            };
            AskedSet { kind, files }
        };
        let mut sets = vec![set(SetKind::Identification, measurements, self.joints.as_deref())];
        if !verify.is_empty() {
            sets.push(set(SetKind::Verification, verify, verify_joints));
        }
        sets
    }

    /// The same for files of sweeps, which have their commands next to their points and are held out as a whole.
    pub fn of_sweeps(&self) -> Self {
        Self { joints: None, verify_poses: None, ..self.clone() }
    }

    fn options(&self) -> RowOptions {
        RowOptions {
            missed: self.missed.iter().map(|code| MissedCode::parse(code)).collect(),
            verification_poses: self.verify_poses.clone().unwrap_or_default(),
            approach_from_order: self.approach_from_order,
            average_repeats: self.average_repeats,
            average_faces: self.average_faces,
            sheet: self.sheet.clone(),
            bag: BagOptions {
                joints: self.bag_joints.clone(),
                points: self.bag_points.clone(),
                tolerance_s: self.bag_tolerance_ms.map_or(DEFAULT_TOLERANCE_S, |ms| 1e-3 * ms),
                names: self.bag_names.clone(),
                ..BagOptions::default()
            },
        }
    }

    /// The map of bags, whose joints have the names of the robot's joints.
    pub fn of_bags(&mut self, robot: &Robot) -> Result<ColumnMap, InputError> {
        let links = robot.model.kinematics.links.iter().enumerate();
        let commanded = links.filter(|(joint, _)| robot.model.actuators.is_commanded(*joint));
        self.bag_names = commanded.map(|(_, link)| link.name.clone()).collect();
        let names = self.bag_names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", ");
        let text = format!(
            "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [{names}]\nrevolute_unit = \"rad\"\nprismatic_unit = \"m\"\n\
             [position]\nsystem = \"cartesian\"\nunit = \"m\"\nx = \"x\"\ny = \"y\"\nz = \"z\"\n\
             [columns]\ntime_s = \"time_s\"\ntarget = \"target\"\nstation = \"station\"\n"
        );
        Ok(parse_column_map(&Source::new("columns of the bag", text))?.with_names_where_there())
    }

    /// Reads the sets; held-out rows of the first become a separate set.
    pub fn read(
        &self,
        sets: &[AskedSet],
        maps: &Maps,
        joints: &[JointKind],
    ) -> Result<Vec<MeasuredFile>, CliError> {
        let options = self.options();
        let mut measured = Vec::new();
        for AskedSet { kind, files } in sets {
            let loaded = read_files(files, maps.of(files), joints, &options)?;
            let name = files.points.first().map_or_else(String::new, |file| file.path.display().to_string());
            if !loaded.has_held_out() {
                if self.verify_poses.is_some() {
                    let message = format!("--verify-poses: none of these poses is measured in {name}");
                    Cli::command().error(ErrorKind::ValueValidation, message).exit();
                }
                measured.push(MeasuredFile { kind: *kind, name, loaded });
                continue;
            }
            if sets.len() > 1 {
                return Err(held_out_twice(&name, &loaded).into());
            }
            let (fitted, held_out) = loaded.split();
            if fitted.set.observations.is_empty() {
                return Err(nothing_to_fit(&name).into());
            }
            measured.push(MeasuredFile { kind: SetKind::Identification, name: name.clone(), loaded: fitted });
            measured.push(MeasuredFile { kind: SetKind::Verification, name, loaded: held_out });
        }
        Ok(measured)
    }
}

fn nothing_to_fit(name: &str) -> InputError {
    InputError::Place {
        place: name.to_owned(),
        message: "all poses are held out ([sets] of the column map, or --verify-poses): none is left to identify from".to_owned(),
        help: Some("expected a list that leaves poses for the fit, for example two thirds of them".to_owned()),
    }
}

fn held_out_twice(name: &str, loaded: &LoadedMeasurements) -> InputError {
    let first = loaded.held_out.iter().position(|held| *held).and_then(|index| loaded.places.of(index));
    InputError::Place {
        place: first.unwrap_or_else(|| name.to_owned()),
        message: "this row is held out ([sets] of the column map, or --verify-poses), but --verify names a file to verify on \
                  as well"
            .to_owned(),
        help: Some("expected only one of them".to_owned()),
    }
}

/// Adds the files of the sets to a hash of input files, piece by piece.
pub(super) fn hash_files(hash: &mut InputHash, sets: &[AskedSet]) -> Result<(), CliError> {
    for (role, path) in sets.iter().flat_map(AskedSet::paths) {
        hash.add_file(role, path).map_err(|error| InputError::Unreadable {
            path: path.to_path_buf(),
            reason: error.to_string(),
        })?;
    }
    Ok(())
}

/// The files' texts with their roles, for a recording, or why one is left out.
pub(super) fn texts(sets: &[AskedSet]) -> (Vec<(String, Source)>, Vec<String>) {
    let (mut texts, mut left_out) = (Vec::new(), Vec::new());
    for (role, path) in sets.iter().flat_map(AskedSet::paths) {
        match Source::read(path) {
            Ok(source) => texts.push((role.to_owned(), source)),
            Err(_) => left_out.push(format!(
                "{}: not UTF-8 text: the recording holds the measurements read from it, but not the file",
                path.display()
            )),
        }
    }
    (texts, left_out)
}
