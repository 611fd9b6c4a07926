use std::fmt::Write;

use super::*;
use crate::{ColumnMap, parse_measurements, parse_robot, parse_session};
use calibrig_model::JointKind;
use calibrig_model::measurement::Observation;
use nalgebra::{Matrix3, Vector3};

const JOINT: &str = "schema = \"calibrig.robot/1\"\nname = \"one\"\nconvention = \"craig\"\n[actuators]\nkind = \"direct\"\n\
    [[joint]]\nname = \"j\"\ntype = \"revolute\"\na_mm = 0\nalpha_deg = 0\nd_mm = 0\ntheta_deg = 0\nmin_deg = -90\nmax_deg = 90\n";

/// A robot whose targets are these: name, x in mm, sigma in mm; the first at line 15.
fn robot(targets: &[(&str, f64, &str)]) -> Robot {
    let mut text = JOINT.to_owned();
    for (name, x, sigma) in targets {
        let key = |key: &str, value: &str| {
            if value.is_empty() { String::new() } else { format!("{key} = {value}\n") }
        };
        let name = if name.is_empty() { String::new() } else { format!("{name:?}") };
        let _ = write!(
            text,
            "[[target]]\n{}x_mm = {x}\ny_mm = 0\nz_mm = 0\n{}",
            key("name", &name),
            key("sigma_mm", sigma)
        );
    }
    parse_robot(Source::new("robot.toml", text), None, None).expect("valid")
}

/// A file with a row for each target and station, or without these columns where they are empty.
fn file(kind: SetKind, targets: &[&str], stations: &[&str]) -> MeasuredFile {
    let mut text = "q1_rad,x_m,y_m,z_m".to_owned();
    text += if targets.is_empty() { "" } else { ",target" };
    text += if stations.is_empty() { "\n" } else { ",station\n" };
    for row in 0..targets.len().max(stations.len()).max(2) {
        let _ = write!(text, "0.{row},1,2,{row}");
        for names in [targets, stations].into_iter().filter(|names| !names.is_empty()) {
            let _ = write!(text, ",{}", names[row % names.len()]);
        }
        text += "\n";
    }
    let source = Source::new(format!("{}.csv", kind.key()), text);
    let loaded = parse_measurements(&source, &ColumnMap::default(), &[JointKind::Revolute]).expect("valid");
    MeasuredFile { kind, name: source.name, loaded }
}

fn fitted(targets: &[&str]) -> Vec<MeasuredFile> {
    vec![file(SetKind::Identification, targets, &[])]
}

fn session(text: &str) -> (SessionFile, Source) {
    let source = Source::new("session.toml", format!("schema = \"calibrig.session/1\"\n{text}"));
    (parse_session(&source).expect("valid"), source)
}

/// Name, x in m, variance of x in m².
fn known(file: &MeasuredFile) -> Vec<(&str, f64, Option<f64>)> {
    let targets = &file.loaded.set.targets;
    targets.iter().map(|t| (t.name.as_str(), t.in_flange.x, t.covariance.map(|c| c.m11))).collect()
}

fn refused(robot: &Robot, session: Option<&(SessionFile, Source)>, mut files: Vec<MeasuredFile>) -> String {
    let session = session.map(|(session, source)| (session, source));
    match state(robot, session, &mut files).expect_err("refused") {
        InputError::Place { place, message, help } => {
            format!("{place}: {message} ({})", help.unwrap_or_default())
        }
        InputError::Invalid { message, line, help, source_code, .. } => {
            format!("{}:{line}: {message} ({})", source_code.name(), help.unwrap_or_default())
        }
        other => panic!("{other:?}"),
    }
}

#[track_caller]
fn assert_has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text:?}");
    }
}

#[test]
fn the_target_of_a_file_without_names_is_the_one_that_is_stated() {
    let mut files = fitted(&[]);
    let told = state(&robot(&[("", 100.0, "0.02")]), None, &mut files).expect("one of each");
    assert_eq!(known(&files[0]), [("target 1", 0.1, Some(2e-5 * 2e-5))]);
    assert_eq!(
        told.assumed,
        [
            "station 1: identified, because no nests are stated",
            "target 1: stated by robot.toml, +- 0.02 mm per axis"
        ]
    );
    assert!(told.remarks.is_empty());
    let mut files = fitted(&[]);
    let told = state(&robot(&[("SMR1", 100.0, "")]), None, &mut files).expect("one of each");
    assert_eq!(known(&files[0]), [("SMR1", 0.1, None)]);
    assert_eq!(
        told.assumed[1],
        "target SMR1: identified, starting from the offset that robot.toml states without an uncertainty"
    );
    let mut files = fitted(&[]);
    let told = state(&robot(&[]), None, &mut files).expect("nothing is stated");
    assert_eq!(known(&files[0]), [("target 1", 0.0, None)]);
    assert_eq!(told.assumed[1], "target 1: identified, because nothing is stated about it");
}

#[test]
fn targets_are_matched_by_name() {
    let both = robot(&[("A", 100.0, "0.02"), ("B", 200.0, ""), ("spare", 300.0, "0.02")]);
    let mut files = fitted(&["C", "B", "A", "C"]);
    let told = state(&both, None, &mut files).expect("two are stated");
    assert_eq!(known(&files[0]), [("C", 0.0, None), ("B", 0.2, None), ("A", 0.1, Some(2e-5 * 2e-5))]);
    assert_eq!(told.remarks, ["target spare of robot.toml: no reading names it, and it is left out"]);
    assert_eq!(told.assumed[1], "target C: identified, because nothing is stated about it");
    // A name is not asked of the only one.
    let mut files = fitted(&["SMR", "SMR"]);
    state(&robot(&[("", 100.0, "")]), None, &mut files).expect("one of each");
    assert_eq!(known(&files[0]), [("SMR", 0.1, None)]);
    // Which of three it is, nobody says.
    let mut files = fitted(&["A", "B", "C", "A"]);
    let told = state(&robot(&[("", 100.0, "")]), None, &mut files).expect("a nominal value");
    assert_eq!(known(&files[0])[0], ("A", 0.0, None));
    assert_has(
        &told.remarks[0],
        &["robot.toml: the target has no name", "3 are measured: A, B, C", "nothing is used"],
    );
}

#[test]
fn readings_that_state_no_uncertainty_among_others_that_do_are_read_and_told() {
    let read = |sigmas: [&str; 3]| {
        let row = |(i, sigma): (usize, &str)| format!("0.{i},1,2,3,{sigma},{sigma},{sigma}\n");
        let rows: String = sigmas.into_iter().enumerate().map(row).collect();
        let text = format!("q1_rad,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n{rows}");
        let source = Source::new("set.csv", text);
        let loaded =
            parse_measurements(&source, &ColumnMap::default(), &[JointKind::Revolute]).expect("valid");
        let mut files = [MeasuredFile { kind: SetKind::Identification, name: source.name, loaded }];
        let told = state(&robot(&[]), None, &mut files).expect("nothing is stated");
        let stated = |o: &Observation| o.reading.position_covariance().map(|c| c.m22);
        (files[0].loaded.set.observations.iter().map(stated).collect::<Vec<_>>(), told.remarks)
    };
    let (some, told) = read(["2e-5", "", "3e-5"]);
    assert_eq!(some, [Some(2e-5 * 2e-5), None, Some(3e-5 * 3e-5)]);
    assert_eq!(told, ["set.csv: 1 of 3 readings states no uncertainty (pose 2); the others state theirs"]);
    assert!(read(["2e-5", "", ""]).1[0].contains("2 of 3 readings state no uncertainty (poses 2, 3)"));
    assert!(read(["2e-5"; 3]).1.is_empty() && read([""; 3]).1.is_empty());
}

#[test]
fn targets_that_cannot_be_matched_are_refused() {
    let sure = refused(&robot(&[("", 100.0, "0.02")]), None, fitted(&["A", "B", "A"]));
    assert_has(&sure, &["robot.toml:15: ", "the target has no name", "[[target]] for each"]);
    let which = refused(&robot(&[("A", 1.0, ""), ("B", 2.0, "")]), None, fitted(&[]));
    assert_has(
        &which,
        &[
            "robot.toml:15: ",
            "2 targets are stated (A, B)",
            "identification.csv does not name",
            "a column target",
        ],
    );
    let other = refused(&robot(&[("A", 1.0, "")]), None, fitted(&["smr1", "smr1"]));
    assert_has(
        &other,
        &["robot.toml:15: ", "no reading names a stated target, A", "measured are smr1", "--session"],
    );
    let shots = refused(&robot(&[]), None, fitted(&["P1", "P2", "P3"]));
    assert_has(
        &shots,
        &["identification.csv:2: ", "3 targets with one reading each", "names the shot", "no target column"],
    );
    // One that was shot twice.
    let shots = refused(&robot(&[]), None, fitted(&["P1", "P2", "P3", "P3", "P4"]));
    assert_has(&shots, &["identification.csv:2: ", "3 targets with one reading each", "no target column"]);
    let mut files = fitted(&["A", "A", "A", "A", "B", "C"]);
    state(&robot(&[]), None, &mut files).expect("a reflector, and two that were tried once");
}

const NESTS: &str = "[[station.nest]]\nname = \"a\"\nin_base_m = [0, 0, 0]\nin_base_sigma_m = 1e-5\nposition_m = [1, 0, 0]\nsigma_m = 1e-5\n\
    [[station.nest]]\nname = \"b\"\nin_base_m = [1, 0, 0]\nin_base_sigma_m = 1e-5\nposition_m = [2, 0, 0]\nsigma_m = 1e-5\n\
    [[station.nest]]\nname = \"c\"\nin_base_m = [0, 1, 0]\nin_base_sigma_m = 1e-5\nposition_m = [1, 1, 0]\nsigma_m = 1e-5\n";

#[test]
fn a_session_file_holds_in_place_of_the_robots() {
    let stated = robot(&[("A", 100.0, "0.02")]);
    let (file_of, source) = session(&format!(
        "[[station]]\nname = \"s\"\n{NESTS}[[target]]\nname = \"A\"\nin_flange_m = [0.3, 0, 0]\n[[target]]\nname = \"B\"\nin_flange_m = [0, 0, 0]\nsigma_m = 1e-5\n"
    ));
    let mut files = fitted(&["A", "A"]);
    let told = state(&stated, Some((&file_of, &source)), &mut files).expect("described");
    assert_eq!(known(&files[0]), [("A", 0.3, None)]);
    assert_eq!(files[0].loaded.set.stations[0].nests.len(), 3);
    assert_eq!(
        told.assumed,
        [
            "station s: placed by 3 nests of session.toml",
            "target A: identified, starting from the offset that session.toml states without an uncertainty"
        ]
    );
    assert_eq!(
        told.remarks,
        [
            "targets are taken from session.toml, not from robot.toml",
            "target B of session.toml: no reading names it, and it is left out"
        ]
    );
    // One that tells of stations alone leaves the robot's target.
    let (file_of, source) = session(&format!("[[station]]\nname = \"s\"\n{NESTS}"));
    let mut files = fitted(&["A", "A"]);
    let told = state(&stated, Some((&file_of, &source)), &mut files).expect("described");
    assert_eq!(known(&files[0]), [("A", 0.1, Some(2e-5 * 2e-5))]);
    assert!(told.remarks.is_empty(), "{:?}", told.remarks);
}

#[test]
fn a_session_file_of_other_measurements_is_refused() {
    let one = session("[[target]]\nname = \"A\"\nin_flange_m = [0, 0, 0]\n");
    let other = refused(&robot(&[]), Some(&one), fitted(&["B", "B"]));
    assert_has(
        &other,
        &["session.toml:3: ", "target \"B\" of the identification set is not described", "described are A"],
    );
    let two = session("[[station]]\nname = \"s\"\n[[station]]\nname = \"t\"\n");
    let which = refused(&robot(&[]), Some(&two), fitted(&[]));
    assert_has(
        &which,
        &["session.toml:3: ", "does not name its station, but 2 are described: s, t", "a column station"],
    );
}

#[test]
fn held_out_poses_are_those_of_the_same_target_whatever_their_order() {
    let mut files = fitted(&["A", "B", "A", "B"]);
    files.push(file(SetKind::Verification, &["B", "A", "A"], &[]));
    state(&robot(&[]), None, &mut files).expect("the same targets");
    let set = &files[1].loaded.set;
    assert_eq!(known(&files[1]), [("A", 0.0, None), ("B", 0.0, None)]);
    assert_eq!(set.observations.iter().map(|o| o.target).collect::<Vec<_>>(), [1, 0, 0]);
    // Known from the statement alone.
    let mut files = fitted(&["A", "A"]);
    files.push(file(SetKind::Verification, &["C", "A"], &[]));
    state(&robot(&[("A", 1.0, ""), ("C", 3.0, "0.01")]), None, &mut files).expect("stated");
    assert_eq!(known(&files[0]), [("A", 1e-3, None), ("C", 3e-3, Some(1e-5 * 1e-5))]);
    assert_eq!(files[1].loaded.set.observations[0].target, 1);
    // A file without names has the only one.
    let mut files = fitted(&["A", "A"]);
    files.push(file(SetKind::Verification, &[], &[]));
    state(&robot(&[]), None, &mut files).expect("one of each");
    assert_eq!(files[1].loaded.set.observations[0].target, 0);

    let mut files = fitted(&["A", "A"]);
    files.push(file(SetKind::Verification, &["C", "A"], &[]));
    let unknown = refused(&robot(&[]), None, files);
    assert_has(
        &unknown,
        &[
            "verification.csv:2: ",
            "target \"C\" of the verification set is not in the identification set (A)",
            "nothing is stated about it",
        ],
    );
    let files = vec![
        file(SetKind::Identification, &[], &["front", "front"]),
        file(SetKind::Verification, &[], &["back", "front"]),
    ];
    let unknown = refused(&robot(&[]), None, files);
    assert_has(&unknown, &["station \"back\" of the verification set", "no nests place it", "--session"]);
}

#[test]
fn an_uncertainty_of_the_robots_file_is_that_of_every_axis() {
    let target = &robot(&[("", 1.0, "0.5")]).targets[0];
    assert_eq!(target.covariance(), Some(Matrix3::from_diagonal_element(5e-4 * 5e-4)));
    assert_eq!(target.in_flange, Vector3::new(1e-3, 0.0, 0.0));
}

#[test]
fn rows_that_repeat_another_to_the_last_digit_count_once_and_are_told() {
    let text = "q1_rad,x_m,y_m,z_m\n0.1,1,2,3\n0.2,1,2,3\n0.1,1,2,3\n0.1,1,2,3.000001\n0.1,1,2,3\n";
    let source = Source::new("m.csv", text.to_owned());
    let loaded = parse_measurements(&source, &ColumnMap::default(), &[JointKind::Revolute]).expect("valid");
    let mut files = vec![MeasuredFile { kind: SetKind::Identification, name: source.name, loaded }];
    let told = state(&robot(&[]), None, &mut files).expect("valid").remarks;
    assert_eq!(files[0].loaded.set.observations.len(), 3);
    let expected =
        "m.csv: 2 of the readings repeat another to the last digit and count only once with it (pose 3)";
    assert!(told.iter().any(|line| line == expected), "{told:?}");
}

#[test]
fn a_probe_that_turns_about_its_centre_is_seen_in_another_pose() {
    let head = "q1_rad,x_m,y_m,z_m,r11,r12,r13,r21,r22,r23,r31,r32,r33\n";
    let turned = "0.1,1,2,3,0,-1,0,1,0,0,0,0,1\n";
    let source = Source::new("m.csv", format!("{head}0.1,1,2,3,1,0,0,0,1,0,0,0,1\n{turned}{turned}"));
    let loaded = parse_measurements(&source, &ColumnMap::default(), &[JointKind::Revolute]).expect("valid");
    let mut files = vec![MeasuredFile { kind: SetKind::Identification, name: source.name, loaded }];
    let text = format!("{JOINT}[target]\nx_mm = 0\ny_mm = 0\nz_mm = 0\nrotation_vector_rad = [0, 0, 0.5]\n");
    let robot = parse_robot(Source::new("robot.toml", text), None, None).expect("valid");
    let told = state(&robot, None, &mut files).expect("valid").remarks;
    assert_eq!(files[0].loaded.set.observations.len(), 2);
    assert!(told.iter().any(|line| line.contains("1 of the readings repeats another")), "{told:?}");
    let turn = files[0].loaded.set.targets[0].orientation.as_ref().expect("as the robot's file states it");
    assert!((turn.flange_from_target.angle() - 0.5).abs() < 1e-12);
}
