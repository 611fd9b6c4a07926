//! Every form of text that is read: the same session written as programs write it, and read back within 0.1 um.

// Helpers of tests stand outside `#[test]` functions, where clippy's leave for tests does not reach.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fmt::Write;
use std::path::{Path, PathBuf};

use calibrig_files::{
    ColumnMap, InputError, LoadedMeasurements, MeasurementFiles, MemoryRows, MissedCode, Place, PointsFile,
    PoseList, RowOptions, Source, parse_column_map, parse_measurements, read_files, read_rows,
    suggest_columns,
};
use calibrig_model::JointKind;
use calibrig_model::measurement::Reading;
use nalgebra::Vector3;
use tempfile::TempDir;

const JOINTS: [JointKind; 2] = [JointKind::Revolute, JointKind::Prismatic];

/// One pose of the session: deg, mm; mm.
#[derive(Clone, Copy)]
struct Shot {
    angle: f64,
    travel: f64,
    point: [f64; 3],
}

/// Made by rule; every number has few digits, so that they are the same in every form.
fn session() -> Vec<Shot> {
    let shot = |k: i32| {
        let k = f64::from(k);
        let rounded = |value: f64| (value * 1e4).round() / 1e4;
        Shot {
            angle: rounded(-150.0 + 23.517 * k),
            travel: rounded(100.0 + 31.25 * k),
            point: [2000.0 + 101.3 * k, -300.0 + 47.13 * k * (k - 5.0), 800.0 - 0.7 * k * k * k].map(rounded),
        }
    };
    (0..12).map(shot).collect()
}

fn map(text: &str) -> ColumnMap {
    let source = Source::new("map.toml", format!("schema = \"calibrig.columns/1\"\n{text}"));
    parse_column_map(&source).unwrap_or_else(|error| panic!("{:?}", miette::Report::new(error)))
}

fn write(folder: &TempDir, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, content).expect("a temporary file");
    path
}

fn read(path: &Path, map: &ColumnMap) -> LoadedMeasurements {
    read_as(&MeasurementFiles::one(path), map, &RowOptions::default())
}

fn read_as(files: &MeasurementFiles, map: &ColumnMap, options: &RowOptions) -> LoadedMeasurements {
    read_files(files, map, &JOINTS, options)
        .unwrap_or_else(|error| panic!("{:?}", miette::Report::new(error)))
}

fn refused(files: &MeasurementFiles, map: &ColumnMap) -> String {
    let error = read_files(files, map, &JOINTS, &RowOptions::default()).expect_err("refused");
    let help = match &error {
        InputError::Invalid { help, .. } | InputError::Place { help, .. } => help.clone().unwrap_or_default(),
        _ => String::new(),
    };
    format!("{error} ({help})")
}

/// The session is what was read, within 0.1 um and the digits of a radian.
#[track_caller]
fn assert_is_session(loaded: &LoadedMeasurements) {
    let shots = session();
    assert_eq!(loaded.set.observations.len(), shots.len(), "{:?}", loaded.remarks);
    for (observation, shot) in loaded.set.observations.iter().zip(&shots) {
        let apart = (observation.reading.position() - Vector3::from(shot.point) / 1e3).norm();
        assert!(apart < 1e-7, "{} off by {apart}", observation.pose);
        let [angle, travel] = [observation.command[0], observation.command[1]];
        assert!((angle - shot.angle.to_radians()).abs() < 1e-9, "{angle}");
        assert!((travel - shot.travel / 1e3).abs() < 1e-9, "{travel}");
    }
}

/// A line for every shot.
fn lines(head: &str, line: impl Fn(usize, &Shot) -> String) -> String {
    session().iter().enumerate().fold(head.to_owned(), |mut text, (index, shot)| {
        text.push_str(&line(index + 1, shot));
        text.push('\n');
        text
    })
}

fn comma(value: f64) -> String {
    format!("{value:.4}").replace('.', ",")
}

const BY_NAME: &str = "[joints]\ncolumns = [\"J1\", \"J2\"]\nrevolute_unit = \"deg\"\nprismatic_unit = \"mm\"\n\
                       [position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = \"X\"\ny = \"Y\"\nz = \"Z\"\n";
/// No unit: the header states them.
const BY_HEADER: &str = "[joints]\ncolumns = [\"J1\", \"J2\"]\n[position]\nsystem = \"cartesian\"\nx = \"X\"\ny = \"Y\"\nz = \"Z\"\n";

/// Name, bytes, and the map that reads it.
#[expect(clippy::too_many_lines, reason = "a list")]
fn forms() -> Vec<(&'static str, Vec<u8>, String)> {
    let columns = |s: &Shot| format!("{},{},{},{},{}", s.angle, s.travel, s.point[0], s.point[1], s.point[2]);
    let latin =
        |text: &str| text.chars().map(|c| u8::try_from(u32::from(c)).expect("Latin-1")).collect::<Vec<u8>>();
    let utf16 = |text: &str| {
        [0xFEFF].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect::<Vec<u8>>()
    };
    let by_number = |numbers: [usize; 5], unit: &str| {
        let [j1, j2, x, y, z] = numbers;
        format!(
            "[joints]\ncolumns = [{j1}, {j2}]\nrevolute_unit = \"deg\"\nprismatic_unit = \"mm\"\n[position]\nsystem = \"cartesian\"\n\
             unit = \"{unit}\"\nx = {x}\ny = {y}\nz = \"#{z}\"\n"
        )
    };
    let german = |s: &Shot| {
        let [x, y, z] = s.point.map(comma);
        format!("{};{};{x};{y};{z}", comma(s.angle), comma(s.travel))
    };
    vec![
        (
            "spatial_analyzer.csv",
            lines(
                "// SpatialAnalyzer point export\r\n// Units: Millimeters, Degrees\r\nCollection,Group,Point,X,Y,Z,J1,J2\r\n",
                |k, s| format!("A,Main,P{k},{},{},{},{},{}\r", s.point[0], s.point[1], s.point[2], s.angle, s.travel),
            )
            .into(),
            BY_NAME.to_owned(),
        ),
        (
            "leica.txt",
            lines(
                "Job:\tCell 7\r\nInstrument:\tAT960\r\n\r\nPoint\tX [mm]\tY [mm]\tZ [mm]\tJ1 [\u{b0}]\tJ2 [mm]\tTime\r\n",
                |k, s| {
                    let [x, y, z] = s.point;
                    format!("Pt {k}\t{x:.4}\t{y:.4}\t{z:.4}\t{}\t{}\t2026-05-04 10:{k:02}:00\r", s.angle, s.travel)
                },
            )
            .into(),
            BY_HEADER.to_owned(),
        ),
        (
            "faro.txt",
            lines("CAM2 Measure 10\nPart: cell 7\n\n    Name         X          Y          Z         J1         J2\n", |k, s| {
                let [x, y, z] = s.point;
                format!("M_Point{k:03} {x:10.4} {y:10.4} {z:10.4} {:10.4} {:10.4}", s.angle, s.travel)
            })
            .into(),
            BY_NAME.to_owned(),
        ),
        (
            "blanks_without_header.txt",
            lines("", |k, s| {
                let [x, y, z] = s.point;
                format!("  {k}  {:.4}  {:.4}   {x:.4} {y:.4}\t{z:.4}", s.angle, s.travel)
            })
            .into(),
            by_number([2, 3, 4, 5, 6], "mm"),
        ),
        (
            "german.csv",
            latin(&lines("J1 [\u{b0}];J2 [mm];X [\u{b5}m];Y [mm];Z [mm]\n", |_, s| {
                let [x, y, z] = s.point;
                format!("{};{};{};{};{}", comma(s.angle), comma(s.travel), comma(1e3 * x), comma(y), comma(z))
            })),
            BY_HEADER.to_owned(),
        ),
        ("german_without_header.csv", lines("", |_, s| german(s)).into(), by_number([1, 2, 3, 4, 5], "mm")),
        (
            "quoted.csv",
            lines("\"J1\",\"J2\",\"X\",\"Y\",\"Z\"\n", |_, s| {
                let [x, y, z] = s.point.map(comma);
                format!("\"{}\",\"{}\",\"{x}\",\"{y}\",\"{z}\"", comma(s.angle), comma(s.travel))
            })
            .into(),
            BY_NAME.to_owned(),
        ),
        (
            "fixed_width.txt",
            lines("", |k, s| {
                let [x, y, z] = s.point;
                format!("P{k:<5}{:10.4}{:10.4}{x:11.4}{y:11.4}{z:11.4}", s.angle, s.travel)
            })
            .into(),
            by_number([2, 3, 4, 5, 6], "mm") + "[text]\nwidths = [6, 10, 10, 11, 11, 11]\n",
        ),
        ("unicode_text.txt", utf16(&lines("J1;J2;X;Y;Z\r\n", |_, s| german(s))), BY_NAME.to_owned()),
        (
            "units_below.csv",
            lines("J1,J2,X,Y,Z\ndeg,mm,mm,mm,mm\n", |_, s| columns(s)).into(),
            BY_HEADER.to_owned(),
        ),
        (
            "savetxt.txt",
            lines("# J1 J2 X Y Z\n", |_, s| {
                let [x, y, z] = s.point;
                format!("{:.18e} {:.18e} {x:.18e} {y:.18e} {z:.18e}", s.angle, s.travel)
            })
            .into(),
            BY_NAME.to_owned(),
        ),
        (
            "inches.csv",
            lines("J1 (deg),J2 (in),X (in),Y (in),Z (in)\n", |_, s| {
                let [x, y, z] = s.point.map(|v| v / 25.4);
                format!("{},{},{x},{y},{z}", s.angle, s.travel / 25.4)
            })
            .into(),
            BY_HEADER.to_owned(),
        ),
        (
            "metres_and_radians.csv",
            lines("J1 [rad],J2 [m],X [m],Y [m],Z [m]\n", |_, s| {
                let [x, y, z] = s.point.map(|v| v / 1e3);
                format!("{},{},{x},{y},{z}", s.angle.to_radians(), s.travel / 1e3)
            })
            .into(),
            BY_HEADER.to_owned(),
        ),
        (
            "sums.csv",
            lines("j1,j3 - j1,x,dx,y,z,A-2\n", |_, s| {
                let [x, y, z] = s.point;
                format!("{},{},{},1.5,{y},{},{}", -s.angle, s.travel, x + 1.5, -z, z)
            })
            .into(),
            BY_NAME
                .replace("[\"J1\", \"J2\"]", "[\"-j1\", \"j3 - j1\"]")
                .replace("\"X\"", "\"x - dx\"")
                .replace("\"Y\"", "[\"y\"]")
                .replace("\"Z\"", "\"A-2\""),
        ),
        (
            "theodolite.txt",
            lines("J1;J2;R [m];Hz [gon];V [gon]\n", |_, s| {
                let p = Vector3::from(s.point) / 1e3;
                let zenith = (p.xy().norm()).atan2(p.z);
                let [hz, v] = [p.y.atan2(p.x), zenith].map(|angle| angle.to_degrees() / 0.9);
                format!("{};{};{:.9};{hz:.9};{v:.9}", s.angle, s.travel, p.norm())
            })
            .into(),
            "[joints]\ncolumns = [\"J1\", \"J2\"]\nrevolute_unit = \"deg\"\nprismatic_unit = \"mm\"\n[position]\nsystem = \"spherical\"\n\
             range = \"R\"\nazimuth = \"Hz\"\nzenith = \"V\"\n"
                .to_owned(),
        ),
    ]
}

#[test]
fn every_form_gives_the_same_session() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes, text) in forms() {
        let path = write(&folder, name, bytes);
        eprintln!("{name}");
        let loaded = read(&path, &map(&text));
        assert_is_session(&loaded);
        let told = loaded.remarks.join("\n");
        for (part, files) in [
            ("read as Latin-1", &["german.csv"][..]),
            ("read as UTF-16", &["unicode_text.txt"]),
            ("decimal comma", &["german.csv", "german_without_header.csv", "quoted.csv", "unicode_text.txt"]),
            ("in front of the header", &["leica.txt", "faro.txt"]),
            (
                ", as the header says",
                &[
                    "leica.txt",
                    "german.csv",
                    "units_below.csv",
                    "inches.csv",
                    "metres_and_radians.csv",
                    "theodolite.txt",
                ],
            ),
        ] {
            assert_eq!(told.contains(part), files.contains(&name), "{name}: {part}: {told}");
        }
    }
}

/// What is suggested reads the file as it is, where nothing is left to decide.
#[test]
fn a_suggested_map_reads_the_file_that_it_was_suggested_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut whole = 0;
    for (name, bytes, _) in forms() {
        let path = write(&folder, name, bytes);
        let suggested = suggest_columns(&[&path], &RowOptions::default())
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        eprintln!("{name}: {:?}\n{}", suggested.open, suggested.text);
        // What no header and no name tells: sums, and a sign.
        if ["sums.csv", "fixed_width.txt"].contains(&name) {
            continue;
        }
        // Whether a joint is prismatic no file says, nor its unit but in the header.
        let has_units = suggested.text.contains("# prismatic_unit: ");
        let text = if has_units {
            suggested.text.clone()
        } else {
            suggested.text.replace("# prismatic_unit = \"mm\"", "prismatic_unit = \"mm\"")
        };
        let parsed = parse_column_map(&Source::new("map.toml", text))
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(suggested.open.is_empty(), "{name}: {:?}", suggested.open);
        assert_is_session(&read(&path, &parsed));
        whole += 1;
    }
    assert_eq!(whole, forms().len() - 2);
}

#[test]
fn nothing_is_suggested_silently() {
    let folder = tempfile::tempdir().expect("a folder");
    // Angles that could be radians or small degrees, points that could be of any unit, an expanded uncertainty, marks of missed shots.
    let text = "J1,J2,X,Y,Z,Ux95,Uy95,Uz95,SMR\n0.1,0.2,100,20,-9999,0.1,0.1,0.1,A\n1.1,0.3,101,n/a,22,0.1,0.1,0.1,B\n0.5,0.1,103,24,25,0.1,0.2,0.1,A\n";
    let path = write(&folder, "m.csv", text.to_owned() + &"0.6,0.2,104,25,26,0.1,0.1,0.1,B\n".repeat(9));
    let suggested = suggest_columns(&[&path], &RowOptions::default()).expect("a map");
    let open = suggested.open.join("\n");
    for key in ["revolute_unit", "unit: up to 104: m, mm and inch", "k: U is an expanded"] {
        assert!(open.contains(key), "{key}: {open}\n{}", suggested.text);
    }
    assert!(suggested.text.contains("missed = [\"n/a\", -9999]"), "{}", suggested.text);
    assert!(suggested.text.contains("target = \"SMR\""), "{}", suggested.text);
    let refused = parse_column_map(&Source::new("map.toml", suggested.text.clone())).expect_err("left open");
    assert!(refused.to_string().contains("revolute_unit is still to be decided"), "{refused}");
    // And without these lines there is no unit.
    let without: String = suggested
        .text
        .lines()
        .filter(|line| !line.contains("# DECIDE: "))
        .fold(String::new(), |text, line| text + line + "\n");
    let parsed = parse_column_map(&Source::new("map.toml", without)).expect("a map without units");
    let refused = read_files(&MeasurementFiles::one(&path), &parsed, &JOINTS, &RowOptions::default())
        .expect_err("no unit");
    assert!(refused.to_string().contains("has no unit"), "{refused}");
}

/// One file of joints and three of points, one for each reflector.
struct Three {
    folder: TempDir,
    files: MeasurementFiles,
}

fn three(joints: &str, point: impl Fn(usize, &Shot) -> String) -> Three {
    let folder = tempfile::tempdir().expect("a folder");
    let joints = write(&folder, "joints.csv", joints);
    let points = ["A", "B", "C"].map(|target| {
        let path = write(&folder, &format!("{target}.txt"), lines("", &point));
        PointsFile { target: Some(target.to_owned()), path }
    });
    Three { folder, files: MeasurementFiles { points: points.into(), joints: Some(joints) } }
}

const THREE: &str = "[joints]\ncolumns = [2, 3]\nrevolute_unit = \"deg\"\nprismatic_unit = \"mm\"\n[position]\nsystem = \"cartesian\"\n\
                     unit = \"mm\"\nx = 2\ny = 3\nz = 4\n";

/// Each target's observations are the session.
#[track_caller]
fn assert_is_session_three_times(loaded: &LoadedMeasurements) {
    let names: Vec<_> = loaded.set.targets.iter().map(|target| target.name.as_str()).collect();
    assert_eq!(names, ["A", "B", "C"]);
    for target in 0..3 {
        let mut one = LoadedMeasurements::default();
        one.set.observations = loaded
            .set
            .observations
            .iter()
            .filter(|observation| observation.target == target)
            .cloned()
            .collect();
        assert_is_session(&one);
        assert!(one.set.observations.iter().zip(1..).all(|(observation, pose)| observation.pose == pose));
    }
}

fn point(name: String) -> impl Fn(usize, &Shot) -> String {
    move |k, s| format!("{name}{k} {:.4} {:.4} {:.4}", s.point[0], s.point[1], s.point[2])
}

#[test]
fn joints_of_one_file_and_points_of_three_are_joined_by_row_by_name_and_by_time() {
    let of_row = lines("", |k, s| format!("{k};{};{}", comma(s.angle), comma(s.travel)));
    let by_row = three(&of_row, point("P".to_owned()));
    let loaded = read_as(&by_row.files, &map(THREE), &RowOptions::default());
    assert_is_session_three_times(&loaded);
    assert!(loaded.remarks.iter().any(|line| line.contains("are joined row by row")), "{:?}", loaded.remarks);
    assert!(loaded.places.of(13).is_some_and(|place| place.ends_with("B.txt:2")));
    // In another order, with a pose more.
    let named: Vec<String> = session()
        .iter()
        .enumerate()
        .rev()
        .map(|(k, s)| format!("P{};{};{}", k + 1, comma(s.angle), comma(s.travel)))
        .collect();
    let by_name = three(&format!("P99;1,5;2,5\n{}\n", named.join("\n")), point("P".to_owned()));
    let join = "[join]\nby = \"name\"\njoints = 1\npoints = 1\n";
    let loaded = read_as(&by_name.files, &map(&format!("{THREE}{join}")), &RowOptions::default());
    assert_is_session_three_times(&loaded);
    assert!(
        loaded.remarks.iter().any(|line| line.contains("1 of 13 rows match no point")),
        "{:?}",
        loaded.remarks
    );
    // A log of joints ten times a second, of a clock that is two seconds ahead.
    let mut log = String::new();
    for (k, s) in session().iter().enumerate() {
        for tick in 0..40 {
            let seconds = 2.0 + 4.0 * k as f64 + 0.1 * f64::from(tick);
            // It moves in the first second, and stands then.
            let (angle, travel) = if tick < 10 { (0.0, 0.0) } else { (s.angle, s.travel) };
            writeln!(log, "{};{};{}", comma(seconds), comma(angle), comma(travel)).expect("a text");
        }
    }
    let by_time = three(&log, |k, s| {
        let at = 4 * (k - 1) + 2;
        format!("0:00:{at:02}.03 {:.4} {:.4} {:.4}", s.point[0], s.point[1], s.point[2])
    });
    let join = "[join]\nby = \"time\"\njoints = 1\npoints = 1\nwithin_s = 0.06\noffset_s = 2\n";
    let loaded = read_as(&by_time.files, &map(&format!("{THREE}{join}")), &RowOptions::default());
    assert_is_session_three_times(&loaded);
    // A tolerance that no row meets loses them all, and says why.
    let join = join.replace("0.06", "0.01");
    let lost = refused(&by_time.files, &map(&format!("{THREE}{join}")));
    for words in ["none of its rows can be used", "A.txt:1: ", "0.030 s away", "35 more rows", "offset_s"] {
        assert!(lost.contains(words), "{words}: {lost}");
    }
}

#[test]
fn rows_that_do_not_belong_together_are_refused_where_they_are() {
    let of_row = |count: usize| {
        session()[..count]
            .iter()
            .enumerate()
            .fold(String::new(), |text, (k, s)| format!("{text}P{k};{};{}\n", s.angle, s.travel))
    };
    let fewer = three(&of_row(11), point("P".to_owned()));
    let found = refused(&fewer.files, &map(THREE));
    assert!(found.contains("A.txt:12: ") && found.contains("fewer") && found.contains("[join]"), "{found}");
    let twice = three(&(of_row(12) + "P3;1;2\n"), point("P".to_owned()));
    let join = "[join]\nby = \"name\"\njoints = 1\npoints = 1\n";
    let found = refused(&twice.files, &map(&format!("{THREE}{join}")));
    assert!(found.contains("joints.csv:13: the name P3 appears twice, first in line 4"), "{found}");
    let found =
        refused(&twice.files, &map(&format!("{THREE}{}", join.replace("joints = 1", "joints = \"Name\""))));
    assert!(found.contains("joints.csv") && found.contains("Name"), "{found}");
    // A cell of the other file is called by its own place.
    let wrong = three(&of_row(12).replace("P4;", "P4;x"), point("P".to_owned()));
    let found = refused(&wrong.files, &map(THREE));
    assert!(found.contains("joints.csv:5: column 2 is \"x"), "{found}");
    drop((fewer.folder, twice.folder, wrong.folder));
}

#[test]
fn missed_shots_have_codes() {
    let text = "J1,J2,X,Y,Z\n1,2,3000,4000,5000\n1,2,-9999,-9999.0,-9999\n1,2,n/a,0,0\n1,2,,,\n1,2,0,0,0\n3,4,-9999.5,1,1\n";
    let folder = tempfile::tempdir().expect("a folder");
    let path = write(&folder, "m.csv", text);
    let by_map = read(&path, &map(&BY_NAME.replace("x = ", "missed = [-9999, \"n/a\"]\nx = ")));
    let options =
        RowOptions { missed: ["-9999", "n/a"].map(MissedCode::parse).into(), ..RowOptions::default() };
    let by_flag = read_as(&MeasurementFiles::one(&path), &map(BY_NAME), &options);
    for loaded in [by_map, by_flag] {
        let poses: Vec<_> = loaded.set.observations.iter().map(|o| o.pose).collect();
        assert_eq!(poses, [1, 6]);
        let why: Vec<_> = loaded.dropped.iter().map(|(pose, why)| format!("{pose}: {why}")).collect();
        let place = |line: usize| format!("({}:{line})", path.display());
        assert_eq!(
            why,
            [
                format!("2: missed shot: X is -9999 {}", place(3)),
                format!("3: missed shot: X is n/a {}", place(4)),
                format!("4: missed shot: the position is empty {}", place(5)),
                format!("5: missed shot: the position is (0, 0, 0) {}", place(6)),
            ]
        );
        assert!(loaded.places.of(1).is_some_and(|place| place.ends_with("m.csv:7")));
    }
}

#[test]
fn rows_of_both_sets_may_stand_in_one_file() {
    let text = lines("No,use,J1,J2,X,Y,Z\n", |k, s| {
        let [x, y, z] = s.point;
        format!("{k},{},{},{},{x},{y},{z}", if k % 4 == 0 { "check" } else { "fit" }, s.angle, s.travel)
    });
    let folder = tempfile::tempdir().expect("a folder");
    let path = write(&folder, "m.csv", text);
    let number = format!("{BY_NAME}[columns]\npose = \"No\"\n");
    let by_column =
        format!("{number}[sets]\ncolumn = \"use\"\nverification = [\"check\"]\nidentification = [\"fit\"]\n");
    let by_list = format!("{number}[sets]\nverification_poses = [4, \"8..8\", 12]\n");
    let options = RowOptions {
        verification_poses: PoseList::parse("4,8,12").expect("a list"),
        ..RowOptions::default()
    };
    let files = MeasurementFiles::one(&path);
    for loaded in
        [read(&path, &map(&by_column)), read(&path, &map(&by_list)), read_as(&files, &map(&number), &options)]
    {
        assert!(loaded.has_held_out());
        let (fitted, held_out) = loaded.split();
        let poses =
            |loaded: &LoadedMeasurements| loaded.set.observations.iter().map(|o| o.pose).collect::<Vec<_>>();
        assert_eq!((poses(&fitted), poses(&held_out)), (vec![1, 2, 3, 5, 6, 7, 9, 10, 11], vec![4, 8, 12]));
        assert!(held_out.places.of(1).is_some_and(|place| place.ends_with("m.csv:9")));
        assert_eq!((held_out.set.targets.len(), held_out.set.stations.len()), (1, 1));
    }
    let found = refused(&files, &map(&by_column.replace("\"fit\"", "\"train\"")));
    assert!(found.contains("m.csv:2: column use is \"fit\"") && found.contains("train"), "{found}");
}

#[test]
fn poses_may_have_names() {
    let text = "Point,J1,J2,X,Y,Z\nP1,1,2,3,4,5\nP7,2,2,3,4,6\nP1,1,2,3,4,7\n";
    let named = map(&format!("{BY_NAME}[columns]\npose = \"Point\"\n"));
    let parse = |text: &str| parse_measurements(&Source::new("m.csv", text), &named, &JOINTS);
    let loaded = parse(text).expect("names");
    assert_eq!(loaded.set.observations.iter().map(|o| o.pose).collect::<Vec<_>>(), [1, 2, 1]);
    assert_eq!(loaded.pose_names, ["P1", "P7"]);
    assert!(loaded.remarks.iter().any(|line| line.contains("P1 is 1, P7 is 2")), "{:?}", loaded.remarks);
    let mixed = parse(&text.replace("P1", "1")).expect_err("numbers, and a name").to_string();
    assert!(mixed.contains("m.csv:3: column Point is \"P7\""), "{mixed}");
}

#[test]
fn repeats_are_averaged_with_their_scatter() {
    // Every shot three times, by -1, 0 and +1 tenth of a millimetre along x: a variance of 0.01 mm2 on one of three axes.
    let text = session().iter().enumerate().fold("No,J1,J2,X,Y,Z\n".to_owned(), |mut text, (k, s)| {
        for off in [-0.1, 0.0, 0.1] {
            writeln!(
                text,
                "{},{},{},{:.4},{},{}",
                k + 1,
                s.angle,
                s.travel,
                s.point[0] + off,
                s.point[1],
                s.point[2]
            )
            .expect("a text");
        }
        text
    });
    let folder = tempfile::tempdir().expect("a folder");
    let path = write(&folder, "m.csv", &text);
    let kept = read(&path, &map(&format!("{BY_NAME}[columns]\npose = \"No\"\n")));
    assert_eq!(kept.set.observations.len(), 36);
    // By the number of the pose, and where there is none by the command.
    for pose in ["[columns]\npose = \"No\"\n", ""] {
        let loaded = read(&path, &map(&format!("{BY_NAME}{pose}[rows]\nrepeats = \"average\"\n")));
        assert_is_session(&loaded);
        let told = loaded.remarks.join("\n");
        assert!(
            told.contains("36 readings are averaged to 12")
                && told.contains("0.1000 mm (RMS in 3-D, 24 repeats)"),
            "{told}"
        );
        for observation in &loaded.set.observations {
            let covariance = observation.reading.position_covariance().expect("from the scatter");
            // Squares of 12 x 2 x 0.1 mm over 3 x 24 degrees of freedom, and three repeats.
            let expected = 12.0 * 2.0 * 1e-8 / 72.0 / 3.0;
            assert!((covariance.diagonal() / expected - Vector3::repeat(1.0)).norm() < 1e-6, "{covariance}");
        }
        assert!(loaded.places.of(1).is_some_and(|place| place.ends_with("m.csv:5")));
    }
    let other = write(&folder, "other.csv", text.replacen("1,-150", "1,-140", 1));
    let found = refused(
        &MeasurementFiles::one(&other),
        &map(&format!("{BY_NAME}[columns]\npose = \"No\"\n[rows]\nrepeats = \"average\"\n")),
    );
    assert!(
        found.contains("other.csv:3: pose 1 has other commands than in") && found.contains("keep"),
        "{found}"
    );
}

#[test]
fn approaches_follow_from_the_order_of_the_rows() {
    let text = "J1,J2,X,Y,Z\n0,0,1,1,1\n10,0,1,1,1\n10,-5,0,0,0\n5,-5,1,1,1\n5,-5,2,1,1\n";
    let loaded = parse_measurements(
        &Source::new("m.csv", text),
        &map(&format!("{BY_NAME}[rows]\napproach_from = \"order\"\n")),
        &JOINTS,
    )
    .expect("valid");
    let signs: Vec<_> = loaded.set.observations.iter().map(|o| (o.pose, o.approach.clone())).collect();
    // The missed shot was approached as well; who stands keeps the sign of the last motion, and is at the same stop.
    assert_eq!(signs, [(1, vec![0, 0]), (2, vec![1, 0]), (4, vec![-1, -1]), (4, vec![-1, -1])]);
}

#[test]
fn noise_grows_with_distance_and_expanded_uncertainties_have_a_factor() {
    let sigma = "[sigma]\nunit = \"um\"\nk = 2\nx = \"U\"\ny = \"U\"\nz = \"U\"\n";
    let noise = "[noise]\nrange_um = 2\nrange_um_per_m = 0.5\ntransverse_um = 5\ntransverse_um_per_m = 1.5\n";
    let text = "J1,J2,X,Y,Z,U\n0,0,0,0,4000,20\n0,0,3000,0,0,\n";
    let loaded =
        parse_measurements(&Source::new("m.csv", text), &map(&format!("{BY_NAME}{sigma}{noise}")), &JOINTS)
            .expect("valid");
    let sigmas = |index: usize| {
        let reading = &loaded.set.observations[index].reading;
        reading.position_covariance().expect("stated").diagonal().map(|v: f64| 1e6 * v.sqrt())
    };
    assert!((sigmas(0) - Vector3::repeat(10.0)).norm() < 1e-9, "{}", sigmas(0));
    assert!((sigmas(1) - Vector3::new(3.5, 9.5, 9.5)).norm() < 1e-9, "{}", sigmas(1));
    // The same reading in spherical coordinates has the same covariance.
    let spherical = BY_NAME.replace("system = \"cartesian\"\nunit = \"mm\"\nx = \"X\"\ny = \"Y\"\nz = \"Z\"", "system = \"spherical\"\nrange_unit = \"mm\"\nangle_unit = \"deg\"\nrange = \"R\"\nazimuth = \"Az\"\nelevation = \"El\"");
    let text = "J1,J2,R,Az,El\n0,0,5000,30,40\n0,0,5000,30,90\n";
    let loaded =
        parse_measurements(&Source::new("m.csv", text), &map(&format!("{spherical}{noise}")), &JOINTS)
            .expect("valid");
    let [tilted, up] = [0, 1].map(|index| &loaded.set.observations[index].reading);
    let Reading::Spherical(reading) = tilted else { panic!("{tilted:?}") };
    let direction = reading.position().normalize();
    let expected = |direction: Vector3<f64>| {
        let across = nalgebra::Matrix3::identity() - direction * direction.transpose();
        across * 12.5e-6_f64.powi(2) + direction * direction.transpose() * 4.5e-6_f64.powi(2)
    };
    assert!((reading.position_covariance().expect("stated") - expected(direction)).norm() < 1e-20);
    // At the zenith there is no azimuth.
    assert!(matches!(up, Reading::Cartesian { .. }));
    assert!((up.position_covariance().expect("stated") - expected(Vector3::z())).norm() < 1e-18);
}

#[test]
fn units_of_header_and_map_do_not_contradict_each_other() {
    let parse = |header: &str, text: &str| {
        let file = Source::new("m.csv", format!("{header}\n1,2,3,4,5\n"));
        parse_measurements(&file, &map(text), &JOINTS)
    };
    let refused = parse("J1,J2,X [m],Y [mm],Z [mm]", BY_NAME).expect_err("m and mm").to_string();
    assert!(
        refused.contains(
            "m.csv:1: column X [m] is in m according to the header, but in mm according to the column map"
        ),
        "{refused}"
    );
    let by_number = BY_NAME.replace("\"X\"", "3");
    let loaded = parse("J1,J2,X [m],Y [mm],Z [mm]", &by_number).expect("the map holds");
    assert_eq!(loaded.set.observations[0].reading.position().x, 3e-3);
    assert!(loaded.remarks.iter().any(|line| line.contains("the column map holds")), "{:?}", loaded.remarks);
    let refused = parse("J1,J2,X [deg],Y,Z", BY_NAME).expect_err("an angle").to_string();
    assert!(refused.contains("is in deg, which is not a unit of this quantity"), "{refused}");
    let refused = parse("J1,J2,X,Y,Z", BY_HEADER).expect_err("no unit").to_string();
    assert!(
        refused.contains("map.toml:2: missing key `revolute_unit` in [joints]: column J1 has no unit"),
        "{refused}"
    );
}

#[test]
fn rows_of_another_kind_of_file_go_the_same_way() {
    let shots = session();
    let place = |row: u32| Place::Sheet { sheet: "Points".into(), row, first_column: 2 };
    let names = ["J1 [deg]", "J2 [mm]", "X [mm]", "Y [mm]", "Z [mm]"].map(str::to_owned);
    let mut rows = vec![(place(1), vec!["Cell 7".to_owned()]), (place(3), names.to_vec())];
    rows.extend(shots.iter().zip(4..).map(|(s, row)| {
        let numbers = [s.angle, s.travel, s.point[0], s.point[1], s.point[2]];
        (place(row), numbers.map(|number| format!("{number:?}")).to_vec())
    }));
    let read = |rows: &[(Place, Vec<String>)]| {
        read_rows(Box::new(MemoryRows::new("book.xlsx", rows.to_vec())), &map(BY_HEADER), &JOINTS)
    };
    let loaded = read(&rows).expect("valid");
    assert_is_session(&loaded);
    assert_eq!(loaded.places.of(2).as_deref(), Some("book.xlsx, sheet Points, row 6"));
    rows[5].1[3] = "abc".to_owned();
    let refused = read(&rows).expect_err("no number").to_string();
    assert_eq!(refused, "book.xlsx, sheet Points, cell E7: column Y [mm] is \"abc\"");
}

#[test]
fn what_is_no_text_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = write(&folder, "m.xlsx", b"PK\x03\x04\x14\0\x06\0");
    let found = refused(&MeasurementFiles::one(&path), &map(BY_NAME));
    assert!(found.contains("XLSX"), "{found}");
}
