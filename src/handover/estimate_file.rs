//! `calibrig.estimate/1`: an estimate in a file.

use std::io::{self, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::ser::Formatter;

use super::form::{Form, SCHEMA};
use crate::pipeline::{InputHash, Outcome};
use calibrig_estimation::METHOD;
use calibrig_estimation::identification::{Estimate, Mode};
use calibrig_files::{InputError, Source};
use calibrig_model::CalibrationModel;

/// An estimate with its origins, as it is exported.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimateFile {
    /// Name and version of the program that made the estimate.
    pub software: String,
    /// Number of its [method](METHOD).
    pub method: u32,
    /// Origin of the measurements.
    pub input: MadeFrom,
    /// The robot that was fitted.
    pub robot: FittedRobot,
    /// Region of the measurements.
    pub region: Region,
    /// Names of the stations, in the estimate's order.
    pub stations: Vec<String>,
    /// Names of the targets, in the estimate's order.
    pub targets: Vec<String>,
    /// The estimate.
    pub estimate: Estimate,
}

/// Origin of measurements.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MadeFrom {
    /// `scenario`, `files` or `recording`.
    pub kind: String,
    /// Its name for people.
    pub name: String,
    /// Hash over every input file, hexadecimal.
    pub sha256: String,
    /// The seed of a simulation.
    pub seed: Option<u64>,
}

/// A robot with its files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FittedRobot {
    /// Its name for people.
    pub name: String,
    /// Its files.
    pub sources: Vec<RobotSource>,
    /// [Hash of the model](model_sha256) that was fitted.
    pub model_sha256: String,
}

/// A file of a robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotSource {
    /// `robot`, `urdf` or `columns`.
    pub role: String,
    /// Name of the file.
    pub name: String,
    /// Hash of its role and text, hexadecimal.
    pub sha256: String,
}

/// The region in which a robot was measured: outside it, an estimate predicts poses that it has not seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// Observations of the identification set.
    pub observations: usize,
    /// Lowest command of every actuator, m or rad.
    pub command_min: Vec<f64>,
    /// Highest command of every actuator, m or rad.
    pub command_max: Vec<f64>,
    /// Whether the sides from which the poses were approached are known.
    pub approached: bool,
}

/// The hash of a nominal model, hexadecimal: of the JSON of its numbers. It does not include what the identification adds (the spans of smooth
/// terms).
pub fn model_sha256(model: &CalibrationModel) -> String {
    let plain = CalibrationModel { spans: Vec::new(), ..model.clone() };
    // Numbers and names always become JSON.
    let text = serde_json::to_string(&plain).unwrap_or_default();
    let mut hash = InputHash::default();
    hash.add("model", &text);
    hash.hex()
}

/// Roles of the files that a robot is read from.
const ROBOT_ROLES: [&str; 3] = ["robot", "urdf", "columns"];

impl EstimateFile {
    /// The estimate of `mode` in an outcome, or the fullest without a mode; `None` if the outcome has no such estimate.
    pub fn of(outcome: &Outcome, mode: Option<Mode>) -> Option<Self> {
        let wanted = |own: &Mode| mode.is_none_or(|mode| mode == *own);
        let mut fitted = outcome.modes.iter().rev().filter(|outcome| wanted(&outcome.mode));
        let estimate = fitted.find_map(|outcome| outcome.estimate.as_ref())?;
        let measured = outcome.sets.first().map(|set| &set.measurements)?;
        let hashed = |(role, source): &(String, Source)| {
            let mut hash = InputHash::default();
            hash.add(role, &source.text);
            let path = Path::new(&source.name);
            let name =
                path.file_name().map_or_else(|| source.name.clone(), |name| name.to_string_lossy().into());
            RobotSource { role: role.clone(), name, sha256: hash.hex() }
        };
        let is_robots = |(role, _): &&(String, Source)| ROBOT_ROLES.contains(&role.as_str());
        let bound = |pick: fn(f64, f64) -> f64| {
            let mut commands = measured.observations.iter().map(|observation| observation.command.clone());
            let first = commands.next().unwrap_or_default();
            commands.fold(first, |so_far, next| so_far.iter().zip(&next).map(|(a, b)| pick(*a, *b)).collect())
        };
        Some(Self {
            software: calibrig_recording::Provenance::software().to_owned(),
            method: METHOD,
            input: MadeFrom {
                kind: outcome.input.kind.to_owned(),
                name: outcome.input.name.clone(),
                sha256: outcome.input.sha256.clone(),
                seed: outcome.input.seed,
            },
            robot: FittedRobot {
                name: outcome.input.name.clone(),
                sources: outcome.sources.iter().filter(is_robots).map(hashed).collect(),
                model_sha256: model_sha256(&outcome.model),
            },
            region: Region {
                observations: measured.observations.len(),
                command_min: bound(f64::min),
                command_max: bound(f64::max),
                approached: measured.observations.iter().any(|o| o.approach.iter().any(|side| *side != 0)),
            },
            stations: measured.stations.iter().map(|station| station.name.clone()).collect(),
            targets: measured.targets.iter().map(|target| target.name.clone()).collect(),
            estimate: estimate.clone(),
        })
    }

    /// The text of the file. Every number reads back to the same bits.
    ///
    /// # Errors
    ///
    /// [`serde_json::Error`], which no estimate of an identification causes.
    pub fn text(&self) -> Result<String, serde_json::Error> {
        let mut text = Vec::new();
        let mut writer = serde_json::Serializer::with_formatter(&mut text, Lines::default());
        Form::of(self).serialize(&mut writer)?;
        text.push(b'\n');
        Ok(String::from_utf8_lossy(&text).into_owned())
    }

    /// Reads a file.
    ///
    /// # Errors
    ///
    /// [`InputError`] with the place: text that is not JSON, another schema, missing or invalid keys, matrices that do not fit the parameters, a
    /// model that does not match its hash, and a robot that cannot predict.
    pub fn parse(source: &Source) -> Result<Self, InputError> {
        #[derive(Deserialize)]
        struct Head {
            schema: Option<String>,
        }
        let head: Head = serde_json::from_str(&source.text).map_err(|error| not_read(source, &error))?;
        if head.schema.as_deref() != Some(SCHEMA) {
            let found = head.schema.map_or_else(|| "missing".to_owned(), |found| format!("{found:?}"));
            let help = Some(format!("expected {SCHEMA:?}, as calibrig export calibrated writes it"));
            return Err(source.error(place_of(source, "schema"), format!("schema is {found}"), help));
        }
        let form: Form = serde_json::from_str(&source.text).map_err(|error| not_read(source, &error))?;
        let refused = |key: &str, message: String, expected: String| {
            source.error(
                place_of(source, key),
                format!("{key}: {message}"),
                Some(format!("expected {expected}")),
            )
        };
        let file = form.into_file().map_err(|(key, message, expected)| refused(key, message, expected))?;
        let robot = &file.estimate.robot;
        let hash = model_sha256(&robot.nominal);
        if hash != file.robot.model_sha256 {
            let message = format!(
                "the nominal model has the hash {hash}, but the estimate is of the model {}",
                file.robot.model_sha256
            );
            return Err(refused(
                "model_sha256",
                message,
                "a file as it was written: its numbers belong together".to_owned(),
            ));
        }
        let joints = robot.nominal.kinematics.joint_count();
        let Region { command_min, command_max, .. } = &file.region;
        let ordered = command_min.iter().zip(command_max).all(|(low, high)| low <= high);
        if command_min.len() != joints || command_max.len() != joints || !ordered {
            let message = "lowest and highest commands do not fit the robot".to_owned();
            return Err(refused("region", message, format!("{joints} numbers each, the lowest first")));
        }
        if let Err(error) = file.estimate.predictor() {
            return Err(refused(
                "calibrated",
                error.to_string(),
                "a robot that can predict, with its parameters".to_owned(),
            ));
        }
        Ok(file)
    }

    /// Reads a file by its path.
    ///
    /// # Errors
    ///
    /// As [`parse`](Self::parse); also if it cannot be read.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        Self::parse(&Source::read(path)?)
    }

    /// Checks that a model is the one that was fitted; otherwise returns both hashes.
    ///
    /// # Errors
    ///
    /// [`AnotherModel`].
    pub fn check_model(&self, model: &CalibrationModel) -> Result<(), AnotherModel> {
        let found = model_sha256(model);
        let expected = self.robot.model_sha256.clone();
        if found == expected { Ok(()) } else { Err(AnotherModel { found, expected }) }
    }
}

/// A model that differs from the estimate's.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the model has the hash {found}, but the estimate is of the model {expected}")]
pub struct AnotherModel {
    /// Of the model.
    pub found: String,
    /// Of the model that was fitted.
    pub expected: String,
}

const CUT_SHORT: &str = "expected a whole file: this one is cut short or empty";

fn not_read(source: &Source, error: &serde_json::Error) -> InputError {
    let line_start: usize =
        source.text.split_inclusive('\n').take(error.line().saturating_sub(1)).map(str::len).sum();
    let at = (line_start + error.column().saturating_sub(1)).min(source.text.len());
    // A truncated number is a syntax error, although the file merely ended too early.
    let is_at_end = at + 1 >= source.text.trim_end().len();
    let help = match error.classify() {
        serde_json::error::Category::Syntax if is_at_end => CUT_SHORT,
        serde_json::error::Category::Eof => CUT_SHORT,
        serde_json::error::Category::Syntax => "expected JSON; numbers are finite",
        _ => "expected the keys of calibrig.estimate/1 (docs/formats.md)",
    };
    source.error(at..at, in_words(error), Some(help.to_owned()))
}

/// Without the names of the program's types.
fn in_words(error: &serde_json::Error) -> String {
    let said = error.to_string();
    let words = said.split_whitespace().map(|word| match word.trim_end_matches(',') {
        "f64" => "a number",
        "u64" | "u32" | "usize" | "u8" => "a whole number",
        _ => word,
    });
    words.collect::<Vec<_>>().join(" ")
}

/// The value of the first key of that name.
fn place_of(source: &Source, key: &str) -> std::ops::Range<usize> {
    source.text.find(&format!("\"{key}\"")).map_or(0..0, |at| at..at + key.len() + 2)
}

/// One line per key and object, lists of numbers on one line.
#[derive(Default)]
struct Lines {
    depth: usize,
    /// Whether the enclosing lists have objects or lists in them.
    broken: Vec<bool>,
    /// At the start of an entry of a list.
    at_entry: bool,
}

impl Lines {
    fn line(&self, writer: &mut (impl Write + ?Sized)) -> io::Result<()> {
        writer.write_all(b"\n")?;
        (0..self.depth).try_for_each(|_| writer.write_all(b"  "))
    }

    /// What starts in a list starts on a new line.
    fn begin(&mut self, writer: &mut (impl Write + ?Sized)) -> io::Result<()> {
        if std::mem::take(&mut self.at_entry) {
            if let Some(broken) = self.broken.last_mut() {
                *broken = true;
            }
            self.line(writer)?;
        }
        self.depth += 1;
        Ok(())
    }
}

impl Formatter for Lines {
    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.begin(writer)?;
        self.broken.push(false);
        writer.write_all(b"[")
    }

    fn end_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.depth -= 1;
        if self.broken.pop() == Some(true) {
            self.line(writer)?;
        }
        writer.write_all(b"]")
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        self.at_entry = true;
        if first { Ok(()) } else { writer.write_all(b",") }
    }

    fn end_array_value<W: ?Sized + Write>(&mut self, _: &mut W) -> io::Result<()> {
        self.at_entry = false;
        Ok(())
    }

    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.begin(writer)?;
        writer.write_all(b"{")
    }

    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.depth -= 1;
        self.line(writer)?;
        writer.write_all(b"}")
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        self.at_entry = false;
        if !first {
            writer.write_all(b",")?;
        }
        self.line(writer)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.at_entry = false;
        writer.write_all(b": ")
    }
}
