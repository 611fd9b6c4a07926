//! Turns a recording into text files, and measured sets into a recording.

use std::path::Path;

use miette::Diagnostic;
use prost::Message;
use thiserror::Error;

use super::file::write_whole;
use super::messages::{decode, read_messages};
use super::schema::{self, v1};
use super::story::record_sets;
use super::{McapRecorder, Preamble, Recording, RecordingError, read_recording};
use calibrig_files::Robot;
use calibrig_files::{
    ColumnMap, CsvError, LoadedMeasurements, SessionSet, SessionTextError, commanded_joints,
    measurements_text, parse_measurements, parse_session, session_text, without_followers,
};
use calibrig_files::{InputError, Source};
use calibrig_model::JointKind;
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::measurement::{SetKind, SetOutcome};

/// Why a recording cannot be written as text files.
#[derive(Debug, Error, Diagnostic)]
#[non_exhaustive]
pub enum ExportError {
    /// The recording itself.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Recording(#[from] RecordingError),
    /// An attached robot.
    #[error("an attachment of the recording: {0}")]
    #[diagnostic(transparent)]
    Attachment(#[from] InputError),
    /// There is no robot whose joints could name the columns.
    #[error("the recording holds no robot")]
    #[diagnostic(help(
        "expected an attachment robot/FILE.toml: name the robot's file with --model ROBOT.toml"
    ))]
    NoRobot,
    /// A robot is given, but the recording has its own.
    #[error("the recording holds its robot already: {name}")]
    #[diagnostic(help("expected only one robot: leave out --model"))]
    SecondRobot {
        /// Its attachment.
        name: String,
    },
    /// The columns of a measurement file cannot hold a set.
    #[error("/measurement/{set}: {source}")]
    #[diagnostic(forward(source))]
    Measurements {
        /// Key of the set.
        set: &'static str,
        /// Why.
        source: CsvError,
    },
    /// A session file cannot hold the session.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Session(#[from] SessionTextError),
    /// The text would not be read back with the same bits.
    #[error("/measurement/{set}: a measurement file cannot hold it: {reason}")]
    #[diagnostic(help(
        "expected symmetric covariances, positions other than (0, 0, 0), ranges above zero, and numbers of at most 1e15"
    ))]
    Lossy {
        /// Key of the set.
        set: &'static str,
        /// What is lost.
        reason: String,
    },
}

/// A recording as files of text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CsvExport {
    /// `robot.toml` and the other inputs, `identification.csv`, `verification.csv`, `sweeps.csv`, `session.toml`, `residuals.csv`, `parameters.csv`:
    /// names without a folder.
    pub files: Vec<Source>,
    /// What differs from the recording, or is missing, in words.
    pub remarks: Vec<String>,
}

/// The recording at `path` as text files. `model` is the robot of a recording that does not hold its own.
///
/// The measurements are read back from the texts and compared: every bit is the same. The input files get the names by which they refer to
/// each other. Residuals and parameters are the recorded ones.
///
/// # Errors
/// The recording cannot be read, has no robot or another number of joints, or holds what no measurement file can: see [`ExportError`].
pub fn export_csv(path: &Path, model: Option<Robot>) -> Result<CsvExport, ExportError> {
    let recording = read_recording(path)?;
    let robot = robot_of(&recording, model)?;
    let joints = commanded_joints(&robot.model);
    let in_columns = |set: &SetOutcome| SetOutcome {
        measurements: without_followers(&robot.model, &set.measurements),
        ..set.clone()
    };
    let mut sets: Vec<SetOutcome> = recording.sets.iter().map(in_columns).collect();
    let swept = take_sweeps(&mut sets);
    let mut export = CsvExport { files: Vec::new(), remarks: Vec::new() };
    let mut told: Vec<SessionSet<'_>> = Vec::new();
    let mut texts = Vec::new();
    for SetOutcome { kind, measurements, dropped } in &sets {
        let set = kind.key();
        if measurements.observations.is_empty() {
            export.remarks.push(format!("the {set} set has no observations: there is no {set}.csv"));
            continue;
        }
        let text = measurements_text(measurements, &joints)
            .map_err(|source| ExportError::Measurements { set, source })?;
        texts.push(Source::new(format!("{set}.csv"), text));
        told.push((*kind, measurements, dropped));
    }
    let session = Source::new("session.toml", session_text(&told)?);
    for ((kind, set, dropped), text) in told.iter().zip(&texts) {
        check(kind.key(), *kind, text, &session, &joints, |read| difference(*kind, (set, dropped), read))?;
    }
    if let Some(swept) = &swept {
        let (kind, set) = (SetKind::Identification, "swept");
        let text =
            measurements_text(swept, &joints).map_err(|source| ExportError::Measurements { set, source })?;
        let text = Source::new("sweeps.csv", text);
        check(set, kind, &text, &session, &joints, |read| differing_reading(kind, swept, &read.set))?;
        texts.push(text);
    }
    export.files.extend(texts.into_iter().chain([session]));
    for part in &recording.missing {
        let (set, found) = (part.kind.key(), part.found);
        export
            .remarks
            .push(format!("the recording was cut short: {set}.csv has the {found} observations left"));
    }
    // Residuals and parameters are not in what `read_recording` returns.
    let mut tables = Tables::default();
    read_messages(path, &mut |topic, schema, data| tables.message(topic, schema, data))?;
    for (name, table, what) in
        [("residuals.csv", tables.residuals, "residuals"), ("parameters.csv", tables.parameters, "estimates")]
    {
        match table {
            Some(text) => export.files.push(Source::new(name, text)),
            None => export.remarks.push(format!("the recording holds no {what}: there is no {name}")),
        }
    }
    let mut inputs = recording.sources;
    if !inputs.iter().any(|(role, _)| role == "robot") {
        inputs.splice(0..0, robot.sources);
    }
    add_inputs(inputs, &mut export);
    Ok(export)
}

/// Takes the readings of sweeps out of the sets, into a set of their own: they get a text file of their own.
fn take_sweeps(sets: &mut [SetOutcome]) -> Option<MeasurementSet> {
    let mut first = sets.first()?.measurements.clone();
    first.observations =
        first.stations.iter_mut().flat_map(|station| std::mem::take(&mut station.sweeps)).collect();
    for station in sets.iter_mut().flat_map(|set| &mut set.measurements.stations) {
        station.sweeps.clear();
    }
    (!first.observations.is_empty()).then_some(first)
}

/// Records sets that were measured elsewhere. The file is either complete or not written at all.
pub fn write_sets(path: &Path, preamble: &Preamble<'_>, sets: &[SetOutcome]) -> Result<(), RecordingError> {
    write_whole(path, |file| {
        let mut recorder = McapRecorder::new(file)?;
        record_sets(preamble, sets, None, &mut recorder)?;
        recorder.finish()?;
        Ok(())
    })
}

fn robot_of(recording: &Recording, model: Option<Robot>) -> Result<Robot, ExportError> {
    match (recording.source("robot"), model) {
        (Some(robot), Some(_)) => Err(ExportError::SecondRobot { name: format!("robot/{}", robot.name) }),
        (None, Some(robot)) => Ok(robot),
        (_, None) => recording.robot()?.ok_or(ExportError::NoRobot),
    }
}

/// Reads the text of a set back: it must hold what was recorded, which `difference` compares.
fn check(
    set: &'static str,
    kind: SetKind,
    text: &Source,
    session: &Source,
    joints: &[JointKind],
    difference: impl FnOnce(&LoadedMeasurements) -> Option<String>,
) -> Result<(), ExportError> {
    let read = read_back(kind, text, session, joints).map_err(|error| error.to_string());
    match read.map(|read| difference(&read)) {
        Err(reason) | Ok(Some(reason)) => Err(ExportError::Lossy { set, reason }),
        Ok(None) => Ok(()),
    }
}

fn read_back(
    kind: SetKind,
    text: &Source,
    session: &Source,
    joints: &[JointKind],
) -> Result<LoadedMeasurements, InputError> {
    let mut read = parse_measurements(text, &ColumnMap::default(), joints)?;
    parse_session(session)?.complete(session, kind, &mut read)?;
    Ok(read)
}

/// How what was read differs from what was recorded, in any bit: encoded messages are compared, since 0.0 == -0.0 as numbers.
fn difference(
    kind: SetKind,
    (set, dropped): (&MeasurementSet, &[(u32, String)]),
    read: &LoadedMeasurements,
) -> Option<String> {
    if let Some((pose, why)) = read.dropped.get(dropped.len()) {
        return Some(format!("pose {pose}: {why}"));
    }
    if let Some(reason) = differing_reading(kind, set, &read.set) {
        return Some(reason);
    }
    let around = |set: &MeasurementSet| {
        let (stations, targets) = (set.stations.clone(), set.targets.clone());
        let measurements = MeasurementSet { stations, targets, observations: Vec::new() };
        let set = SetOutcome { kind, measurements, dropped: Vec::new() };
        let nests: Vec<_> = schema::nests(&set).map(|nest| nest.encode_to_vec()).collect();
        (schema::session(&set, None).encode_to_vec(), nests)
    };
    let same = around(set) == around(&read.set) && read.dropped == dropped;
    let told = "its stations, targets or dropped poses are read back with other bits";
    (!same).then(|| told.to_owned())
}

fn differing_reading(kind: SetKind, set: &MeasurementSet, read: &MeasurementSet) -> Option<String> {
    let message = |index, observation| schema::observation(kind, index, observation).encode_to_vec();
    let pairs = set.observations.iter().zip(&read.observations).enumerate();
    let mut differing =
        pairs.filter(|(index, (recorded, read))| message(*index, recorded) != message(*index, read));
    let fewer = (set.observations.len() != read.observations.len())
        .then(|| "not all readings are read back".to_owned());
    differing
        .next()
        .map(|(_, (recorded, _))| format!("pose {} is read back with other bits", recorded.pose))
        .or(fewer)
}

/// Recorded residuals and parameters as tables; `None` where there are none.
#[derive(Default)]
struct Tables {
    residuals: Option<String>,
    parameters: Option<String>,
}

impl Tables {
    fn message(&mut self, topic: &str, schema: &str, data: &[u8]) -> Result<(), String> {
        if topic.starts_with("/residual/") {
            let v1::Residual { set, index, pose, mode, x, y, z, norm } = decode(schema, data)?;
            let text = self.residuals.get_or_insert_with(|| RESIDUALS.to_owned());
            let texts = [quoted(&mode), quoted(&set), index.to_string(), pose.to_string()];
            add_row(text, texts.into_iter().chain([x, y, z, norm].map(exact)));
        }
        if topic.starts_with("/estimate/") {
            let v1::Estimate { mode, parameters, .. } = decode(schema, data)?;
            let text = self.parameters.get_or_insert_with(|| PARAMETERS.to_owned());
            for parameter in parameters {
                let texts = [&mode, &parameter.name, &parameter.unit].map(|text| quoted(text));
                let numbers = [parameter.value, parameter.sigma, parameter.prior_sigma];
                add_row(text, texts.into_iter().chain(numbers.map(|n| n.map_or_else(String::new, exact))));
            }
        }
        Ok(())
    }
}

const RESIDUALS: &str = "mode,set,index,pose,x_m,y_m,z_m,norm_m\n";
const PARAMETERS: &str = "mode,name,unit,value,sigma,prior_sigma\n";

/// A number as text that reads back to the same bits.
fn exact(number: f64) -> String {
    format!("{number:?}")
}

/// A text as a cell.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

fn add_row(table: &mut String, cells: impl Iterator<Item = String>) {
    *table += &cells.collect::<Vec<_>>().join(",");
    table.push('\n');
}

/// Keys in input files that name another input file: role of the file, the key, and role of the other file.
const REFERENCES: [(&str, &str, &str); 5] = [
    ("scenario", "robot", "robot"),
    ("scenario", "poses.identification_from", "identification_poses"),
    ("scenario", "poses.verification_from", "verification_poses"),
    ("robot", "urdf", "urdf"),
    ("robot", "columns", "columns"),
];

/// Adds the input files. They are all in one folder now, so where one names another, the name is changed to match.
fn add_inputs(inputs: Vec<(String, Source)>, export: &mut CsvExport) {
    let mut named: Vec<(String, Source)> = Vec::new();
    for (role, source) in inputs {
        let taken: Vec<&str> =
            export.files.iter().map(|file| &*file.name).chain(named.iter().map(|(_, s)| &*s.name)).collect();
        let name = free_name(&role, &source.name, &taken);
        if name != source.name {
            export.remarks.push(format!("the input {role}/{} is {name}", source.name));
        }
        named.push((role, Source::new(name, source.text)));
    }
    for (role, key, other) in REFERENCES {
        let Some(wanted) = named.iter().find(|(known, _)| known == other).map(|(_, s)| s.name.clone()) else {
            continue;
        };
        let Some((_, file)) = named.iter_mut().find(|(known, _)| known == role) else { continue };
        let place = file.place_of(key);
        let known = file.text.get(place.clone()).unwrap_or_default().to_owned();
        if !known.is_empty() && known.trim_matches(['"', '\'']) != wanted {
            file.text.replace_range(place, &toml::Value::from(wanted.as_str()).to_string());
            export
                .remarks
                .push(format!("{}: {key} = {known} is {wanted:?} now, which lies beside it", file.name));
        }
    }
    export.files.extend(named.into_iter().map(|(_, source)| source));
}

/// The name of an input file: its own without folders, with its role in front where that name is taken. It never leads out of the folder.
fn free_name(role: &str, name: &str, taken: &[&str]) -> String {
    let plain = |text: &str| -> String {
        let last = text.rsplit(['/', '\\']).next().unwrap_or_default();
        let safe: String = last.chars().map(|c| if c.is_control() || c == ':' { '_' } else { c }).collect();
        if matches!(safe.as_str(), "" | "." | "..") { "input".to_owned() } else { safe }
    };
    // Some file systems ignore case.
    let free = |name: &String| !taken.iter().any(|known| known.to_lowercase() == name.to_lowercase());
    let (role, name) = (plain(role), plain(name));
    let numbered = (2_u64..).map(|number| format!("{role}-{number}-{name}"));
    let names = [name.clone(), format!("{role}-{name}")].into_iter().chain(numbered);
    // The numbers never run out.
    names.into_iter().find(free).unwrap_or(name.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;
    use calibrig_model::measurement::{
        Face, InstrumentTerm, PoseReading, Reading, SetOutcome, StatedInstrument, TargetOrientation,
    };
    use nalgebra::{Matrix6, Rotation3, Vector3};

    fn written_and_read(set: &SetOutcome, joints: &[JointKind]) -> Result<(), ExportError> {
        let told: [SessionSet<'_>; 1] = [(set.kind, &set.measurements, &set.dropped)];
        let text = measurements_text(&set.measurements, joints).expect("written");
        let session = Source::new("session.toml", session_text(&told)?);
        let text = Source::new("set.csv", text);
        let same = |read: &LoadedMeasurements| difference(set.kind, (&set.measurements, &set.dropped), read);
        check(set.kind.key(), set.kind, &text, &session, joints, same)
    }

    #[test]
    fn what_no_column_holds_is_refused_with_its_pose() {
        let outcome = synthetic::outcome(4, 0, false);
        let joints: Vec<_> = outcome.model.kinematics.links.iter().map(|link| link.kind).collect();
        let set = outcome.sets[0].clone();
        written_and_read(&set, &joints).expect("the same");

        let change = |change: &dyn Fn(&mut Reading)| {
            let mut set = set.clone();
            change(&mut set.measurements.observations[2].reading);
            let pose = set.measurements.observations[2].pose;
            (pose, written_and_read(&set, &joints).expect_err("lossy").to_string())
        };
        let (pose, error) = change(&|reading| {
            let Reading::Spherical(reading) = reading else { panic!("spherical") };
            reading.covariance.as_mut().expect("stated").m12 = 1e-12;
        });
        assert!(error.contains(&format!("pose {pose} is read back with other bits")), "{error}");
        let (_, error) = change(&|reading| {
            let Reading::Spherical(reading) = reading else { panic!("spherical") };
            reading.range = -1.0;
        });
        assert!(error.contains("/measurement/identification") && error.contains("set.csv:4"), "{error}");

        let mut cartesian = set.clone();
        for observation in &mut cartesian.measurements.observations {
            let position = observation.reading.position();
            observation.reading = Reading::Cartesian { position, covariance: None };
        }
        written_and_read(&cartesian, &joints).expect("the same");
        let missed = &mut cartesian.measurements.observations[1];
        missed.reading = Reading::Cartesian { position: Vector3::zeros(), covariance: None };
        let expected = format!("pose {}: missed shot", missed.pose);
        let error = written_and_read(&cartesian, &joints).expect_err("lossy").to_string();
        assert!(error.contains(&expected), "{error}");
    }

    #[test]
    fn full_poses_faces_rounds_of_nests_and_instruments_are_told_in_text() {
        let outcome = synthetic::outcome(4, 0, false);
        let joints: Vec<_> = outcome.model.kinematics.links.iter().map(|link| link.kind).collect();
        let mut set = outcome.sets[0].clone();
        let station = &mut set.measurements.stations[0];
        let mut again = station.nests[0].clone();
        (station.nests[0].time, again.time) = (Some(0.5), Some(1800.5));
        station.nests.push(again);
        station.instrument = Some(StatedInstrument {
            drift: None,
            name: "AT".to_owned(),
            sigmas: vec![(InstrumentTerm::Collimation, 1.7e-6), (InstrumentTerm::RangeOffset, 5e-6)],
        });
        if let Reading::Spherical(reading) = &mut set.measurements.observations[1].reading {
            reading.face = Face::Back;
        }
        written_and_read(&set, &joints).expect("the same");
        for (place, observation) in set.measurements.observations.iter_mut().enumerate() {
            observation.reading = Reading::Pose(Box::new(PoseReading {
                position: observation.reading.position(),
                rotation: Rotation3::new(Vector3::new(0.1, 0.2, 0.3 * place as f64)),
                covariance: (place != 2).then(|| Matrix6::identity() * 1e-10),
            }));
        }
        set.measurements.targets[0].orientation = Some(TargetOrientation {
            flange_from_target: Rotation3::new(Vector3::new(0.0, 0.4, 0.0)),
            covariance: None,
        });
        written_and_read(&set, &joints).expect("the same");
        // A nest is a point, and a nest that is measured again was measured at another time.
        let mut twice = set.clone();
        twice.measurements.stations[0].nests[0].time = None;
        let error = written_and_read(&twice, &joints).expect_err("no time").to_string();
        assert!(error.contains("appears twice, but not at two different times"), "{error}");
        set.measurements.stations[0].nests[1].reading = set.measurements.observations[0].reading.clone();
        let error = written_and_read(&set, &joints).expect_err("a nest").to_string();
        assert!(error.contains("was read as a full pose, but a nest is a point"), "{error}");
    }

    #[test]
    fn input_files_lie_beside_each_other() {
        let mut export =
            CsvExport { files: vec![Source::new("identification.csv", String::new())], remarks: Vec::new() };
        let input = |role: &str, name: &str, text: &str| (role.to_owned(), Source::new(name, text));
        let inputs = vec![
            input("scenario", "s.toml", "robot = \"../models/r/robot.toml\" # as built\n"),
            input("robot", "robot.toml", "urdf = 'r.urdf'\ncolumns = '../maps/c.toml'\n"),
            input("urdf", "r.urdf", "<robot/>"),
            input("columns", "c.toml", ""),
            input("identification", "Identification.csv", "a,b"),
            input("verification", "../../etc/passwd", ""),
        ];
        add_inputs(inputs, &mut export);
        let names: Vec<_> = export.files.iter().map(|file| file.name.as_str()).collect();
        let expected = ["identification.csv", "s.toml", "robot.toml", "r.urdf", "c.toml"];
        assert_eq!(names[..5], expected);
        assert_eq!(names[5..], ["identification-Identification.csv", "passwd"]);
        assert_eq!(export.files[1].text, "robot = \"robot.toml\" # as built\n");
        assert_eq!(export.files[2].text, "urdf = 'r.urdf'\ncolumns = \"c.toml\"\n");
        assert_eq!(export.remarks.len(), 4, "{:?}", export.remarks);
    }

    #[test]
    fn a_name_leads_to_no_other_folder() {
        for (name, expected) in [
            ("../../x.toml", "x.toml"),
            ("..\\x.toml", "x.toml"),
            ("/etc/passwd", "passwd"),
            ("..", "input"),
            ("a/", "input"),
            ("", "input"),
            ("c:x\ny", "c_x_y"),
        ] {
            assert_eq!(free_name("robot", name, &[]), expected);
        }
        assert_eq!(free_name("../r", "x", &["X"]), "r-x");
        assert_eq!(free_name("r", "x", &["x", "r-x", "r-2-x"]), "r-3-x");
    }
}
