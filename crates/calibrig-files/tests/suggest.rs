//! Maps that are suggested for files in the manner of other programs: what they say, and that they read the file once their open
//! decisions are filled in.

#![allow(clippy::expect_used, clippy::panic, clippy::unwrap_used, missing_docs)]

use std::fmt::Write;
use std::path::PathBuf;

use calibrig_files::{
    MeasurementFiles, PointsFile, RowOptions, Source, parse_column_map, read_files, suggest_columns,
};
use calibrig_model::JointKind::{self, Prismatic, Revolute};
use calibrig_model::measurement::{Observation, Reading};

const ROWS: usize = 24;

/// Commands in deg or mm, and a point in mm.
fn angle(row: usize, joint: usize) -> f64 {
    (120.0 * (1.3 * row as f64 + 0.7 * joint as f64).sin() * 1e4).round() / 1e4
}

fn point(row: usize) -> [f64; 3] {
    let k = row as f64;
    [2500.0 + 400.0 * k.sin(), -700.0 + 500.0 * (2.0 * k).cos(), 900.0 + 300.0 * (3.0 * k).sin()]
        .map(|v| (v * 1e4).round() / 1e4)
}

/// Rows made of what `of` makes of each, below a head.
fn file(head: &str, of: impl Fn(usize) -> String) -> String {
    (1..=ROWS).fold(head.to_owned(), |mut text, row| {
        writeln!(text, "{}", of(row)).unwrap();
        text
    })
}

fn angles(row: usize, joints: usize, between: &str) -> String {
    (1..=joints).map(|joint| format!("{:.4}", angle(row, joint))).collect::<Vec<_>>().join(between)
}

fn radians(row: usize, order: &[usize], between: &str) -> String {
    order
        .iter()
        .map(|joint| format!("{:.9}", angle(row, *joint).to_radians()))
        .collect::<Vec<_>>()
        .join(between)
}

fn place(row: usize, scale: f64, between: &str) -> String {
    point(row).map(|axis| format!("{:.9}", scale * axis)).join(between)
}

struct Case<'a> {
    files: &'a [(&'a str, String)],
    /// Of the robot; none where the files hold no joints.
    kinds: &'a [JointKind],
    /// Keys that are left open, with what a person decides.
    decisions: &'a [(&'a str, &'a str)],
    /// What the map says.
    says: &'a [&'a str],
    /// Command of a prismatic joint, mm, by row.
    stroke: fn(usize) -> f64,
    /// First and last time, s, where they are known.
    times: Option<[f64; 2]>,
}

const PLAIN: Case<'static> =
    Case { files: &[], kinds: &[Revolute; 6], decisions: &[], says: &[], stroke: |_| 0.0, times: None };

#[track_caller]
fn check(case: &Case<'_>) -> Vec<Observation> {
    let folder = tempfile::tempdir().unwrap();
    let paths: Vec<PathBuf> = case
        .files
        .iter()
        .map(|(name, text)| {
            let path = folder.path().join(name);
            // As Windows writes it where there are letters beyond ASCII.
            std::fs::write(
                &path,
                text.chars().map(|c| u8::try_from(u32::from(c)).unwrap_or(b'?')).collect::<Vec<_>>(),
            )
            .unwrap();
            path
        })
        .collect();
    let map =
        suggest_columns(&paths.iter().map(PathBuf::as_path).collect::<Vec<_>>(), &RowOptions::default())
            .expect("a map");
    println!("==== {}\n{}", case.files[0].0, map.text);
    for words in case.says {
        assert!(map.text.contains(words), "{words}\n{}", map.text);
    }
    let open: Vec<&str> = map.open.iter().map(|open| open.split(':').next().unwrap()).collect();
    assert_eq!(open, case.decisions.iter().map(|(key, _)| *key).collect::<Vec<_>>(), "{}", map.text);
    let mut text = map.text.clone();
    for (key, value) in case.decisions {
        let from = text.find(&format!("# DECIDE: {key} = ")).expect("open");
        let to = from + text[from..].find('\n').unwrap();
        text.replace_range(from..to, &format!("{key} = {value}"));
    }
    if case.kinds.is_empty() {
        return Vec::new();
    }
    let map =
        parse_column_map(&Source::new("map.toml", text.clone())).unwrap_or_else(|e| panic!("{e}\n{text}"));
    let several = paths.len() > 1;
    let files = MeasurementFiles {
        joints: several.then(|| paths[0].clone()),
        points: paths[usize::from(several)..]
            .iter()
            .map(|path| PointsFile {
                target: (paths.len() > 2).then(|| path.display().to_string()),
                path: path.clone(),
            })
            .collect(),
    };
    let loaded = read_files(&files, &map, case.kinds, &RowOptions::default())
        .unwrap_or_else(|e| panic!("{e}\n{text}"));
    let observations = &loaded.set.observations;
    assert_eq!(observations.len(), ROWS * files.points.len(), "{text}");
    for (index, observation) in observations.iter().enumerate() {
        let row = index % ROWS + 1;
        let mut revolute = 0;
        for (kind, command) in case.kinds.iter().zip(&observation.command) {
            let expected = match kind {
                Revolute => {
                    revolute += 1;
                    angle(row, revolute).to_radians()
                }
                Prismatic => 1e-3 * (case.stroke)(row),
            };
            assert!((command - expected).abs() < 1e-6, "row {row}: {command} {expected}\n{text}");
        }
        let position = observation.reading.position();
        for (found, expected) in position.iter().zip(point(row)) {
            assert!((found - 1e-3 * expected).abs() < 1e-7, "row {row}: {found} {expected}\n{text}");
        }
    }
    if let Some([first, last]) = case.times {
        assert_eq!([observations[0].time, observations[ROWS - 1].time], [first, last], "{text}");
    }
    loaded.set.observations
}

/// 2026-05-04 10:01:30 UTC, and each row a minute.
const FIRST: f64 = 1_777_888_890.0;
const LAST: f64 = FIRST + 60.0 * (ROWS as f64 - 1.0);

#[test]
fn leica_faro_and_spatial_analyzer() {
    let leica = file(
        "AT960 export\nUnit: mm\n\nPoint Name;Date;Time;X [mm];Y [mm];Z [mm];Ux95 [µm];Uy95 [µm];Uz95 [µm];Temp [°C]\n",
        |k| format!("P{k};04.05.2026;10:{k:02}:30;{};12.0;14.0;15.0;20.1", place(k, 1.0, ";")),
    );
    check(&Case {
        files: &[("leica.txt", leica)],
        kinds: &[],
        decisions: &[("columns", ""), ("k", "")],
        says: &["time_s = [\"Date\", \"Time\"]", "# unit: mm, as the header says", "read as Latin-1"],
        ..PLAIN
    });
    let faro =
        file("Label,X Actual,Y Actual,Z Actual,X Nominal,Y Nominal,Z Nominal,Deviation,Date,Time\n", |k| {
            format!("M{k:03},{},0,0,0,0.01,5/4/2026,10:{k:02}:30 AM", place(k, 1.0 / 25.4, ","))
        });
    check(&Case {
        files: &[("faro.csv", faro)],
        kinds: &[],
        decisions: &[("columns", ""), ("unit", ""), ("date", "")],
        says: &["x = \"X Actual\"", "# not used: X Nominal, Y Nominal, Z Nominal, Deviation"],
        ..PLAIN
    });
    let sa =
        file("// SpatialAnalyzer export\n// Units: Millimeters\nCollection, Group, Target, X, Y, Z\n", |k| {
            format!("A, Robot, p{k}, {}", place(k, 1.0, ", "))
        });
    check(&Case {
        files: &[("sa.txt", sa)],
        kinds: &[],
        decisions: &[("columns", "")],
        says: &["unit = \"mm\"", "Millimeters", "different in every row, so not a reflector's name"],
        ..PLAIN
    });
}

#[test]
fn controllers_and_their_external_axes() {
    let kuka = file(
        "$TIMER[1] $AXIS_ACT.A1 $AXIS_ACT.A2 $AXIS_ACT.A3 $AXIS_ACT.A4 $AXIS_ACT.A5 $AXIS_ACT.A6 $AXIS_ACT.E1 $POS_ACT.X $POS_ACT.Y $POS_ACT.Z $POS_ACT.A $POS_ACT.B $POS_ACT.C\n",
        |k| format!("{} {} {} {} 10 20 30", 1000 * k, angles(k, 6, " "), 1850 + 100 * k, place(k, 1.0, " ")),
    );
    check(&Case {
        files: &[("kuka.log", kuka)],
        kinds: &[Revolute, Revolute, Revolute, Revolute, Revolute, Revolute, Prismatic],
        decisions: &[
            ("prismatic_unit", "\"mm\""),
            ("x", "\"$POS_ACT.X\""),
            ("y", "\"$POS_ACT.Y\""),
            ("z", "\"$POS_ACT.Z\""),
        ],
        says: &[
            "revolute_unit = \"deg\"",
            "$AXIS_ACT.E1: not part of the arm,",
            "$AXIS_ACT.E1 goes to 4250",
            "which is not a measurement",
        ],
        stroke: |k| 1850.0 + 100.0 * k as f64,
        ..PLAIN
    });
    let abb =
        file("time,rax_1,rax_2,rax_3,rax_4,rax_5,rax_6,eax_a,trans_x,trans_y,trans_z,q1,q2,q3,q4\n", |k| {
            format!(
                "2026-05-04 10:{k:02}:30,{},{},{},1,0,0,0",
                angles(k, 6, ","),
                740 + 10 * k,
                place(k, 1.0, ",")
            )
        });
    check(&Case {
        files: &[("abb.csv", abb)],
        kinds: &[Revolute, Revolute, Revolute, Revolute, Revolute, Revolute, Prismatic],
        decisions: &[
            ("prismatic_unit", "\"mm\""),
            ("x", "\"trans_x\""),
            ("y", "\"trans_y\""),
            ("z", "\"trans_z\""),
        ],
        says: &["\"rax_6\", \"eax_a\"]", "not used: q1, q2, q3, q4", "beside q1, q2, q3, q4"],
        stroke: |k| 740.0 + 10.0 * k as f64,
        times: Some([FIRST, LAST]),
    });
    let rail = file("pose,rail_cmd,J1_cmd,J2_cmd,J3_cmd,J1_act,J2_act,J3_act,X,Y,Z\n", |k| {
        format!("{k},{:.3},{},0,0,0,{}", 0.1 * k as f64, angles(k, 3, ","), place(k, 1.0, ","))
    });
    check(&Case {
        files: &[("rail.csv", rail)],
        kinds: &[Revolute, Revolute, Revolute, Prismatic],
        decisions: &[("prismatic_unit", "\"m\"")],
        says: &[
            "the commanded one",
            "not used: J1_act, J2_act, J3_act",
            "rail_cmd slides, by its name, and goes to 2.4",
            "# rail_cmd: not part of the arm,",
        ],
        stroke: |k| 100.0 * k as f64,
        ..PLAIN
    });
    let travel = file("J1 [deg],J2 [mm],X,Y,Z\n", |k| {
        format!("{},{},{}", angles(k, 1, ","), 10 * k, place(k, 1.0, ","))
    });
    check(&Case {
        files: &[("travel.csv", travel)],
        kinds: &[Revolute, Prismatic],
        says: &["revolute_unit: deg, as the header says", "prismatic_unit: mm, as the header says"],
        stroke: |k| 10.0 * k as f64,
        ..PLAIN
    });
}

#[test]
fn dumps_of_ros() {
    let names = [
        "elbow_joint",
        "shoulder_lift_joint",
        "shoulder_pan_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ];
    let list = |before: &str, after: &str| names.map(|name| format!("{before}{name}{after}")).join(",");
    // The driver puts them into alphabetical order.
    let order = [3, 2, 1, 4, 5, 6];
    let echo = file(
        &format!(
            "%time,field.header.seq,{},{}\n",
            (0..6).map(|i| format!("field.name{i}")).collect::<Vec<_>>().join(","),
            (0..6).map(|i| format!("field.position{i}")).collect::<Vec<_>>().join(",")
        ),
        |k| {
            format!(
                "{},{k},{},{}",
                1_777_888_830_000_000_000 + 60_000_000_000 * k,
                list("", ""),
                radians(k, &order, ",")
            )
        },
    );
    check(&Case {
        files: &[("echo.csv", echo)],
        kinds: &[],
        decisions: &[("x", "")],
        says: &[
            "revolute_unit = \"rad\"",
            "ROS's joint states",
            "\"field.position5\"]",
            "time_ns = \"%time\"",
        ],
        ..PLAIN
    });
    let juggler = file(
        &format!(
            "__time,{},{},/tracker/point/x,/tracker/point/y,/tracker/point/z\n",
            list("/joint_states/", "/position"),
            list("/joint_states/", "/velocity")
        ),
        |k| {
            format!(
                "{},{},0,0,0,0,0,0,{}",
                1_777_888_830 + 60 * k,
                radians(k, &order, ","),
                place(k, 1e-3, ",")
            )
        },
    );
    check(&Case {
        files: &[("juggler.csv", juggler)],
        says: &[
            "[\"/joint_states/shoulder_pan_joint/position\", \"/joint_states/shoulder_lift_joint/position\", \"/joint_states/elbow_joint/position\", \"/joint_states/wrist_1_joint/position\"",
            "From base to wrist by their names",
            "looks like m",
        ],
        times: Some([FIRST, LAST]),
        ..PLAIN
    });
    let arrays = file(
        "header.stamp.sec,header.stamp.nanosec,position[0],position[1],position[2],position[3],position[4],position[5],point.x,point.y,point.z\n",
        |k| {
            format!(
                "{},125000000,{},{}",
                1_777_888_830 + 60 * k,
                radians(k, &[1, 2, 3, 4, 5, 6], ","),
                place(k, 1e-3, ",")
            )
        },
    );
    check(&Case {
        files: &[("arrays.csv", arrays)],
        says: &["time_s = [\"header.stamp.sec\", \"header.stamp.nanosec\"]", "revolute_unit = \"rad\""],
        times: Some([FIRST + 0.125, LAST + 0.125]),
        ..PLAIN
    });
    let iiwa = file(
        "stamp,lbr_iiwa_joint_1,lbr_iiwa_joint_2,lbr_iiwa_joint_3,lbr_iiwa_joint_4,lbr_iiwa_joint_5,lbr_iiwa_joint_6,lbr_iiwa_joint_7,x_mm,y_mm,z_mm\n",
        |k| {
            format!(
                "{},{},{}",
                1_777_888_830_000_u64 + 60_000 * k as u64,
                radians(k, &[1, 2, 3, 4, 5, 6, 7], ","),
                place(k, 1.0, ",")
            )
        },
    );
    check(&Case {
        files: &[("iiwa.csv", iiwa)],
        kinds: &[Revolute; 7],
        decisions: &[("revolute_unit", "\"rad\"")],
        says: &["time_ms = \"stamp\"", "unit = \"mm\"", "\"x_mm\" ends with it"],
        times: Some([FIRST, LAST]),
        ..PLAIN
    });
}

#[test]
fn spreadsheets_columns_and_files_without_a_header() {
    let german = file(
        "Nr.;Datum;Uhrzeit;Achse 1 [°];Achse 2 [°];Achse 3 [°];Achse 4 [°];Achse 5 [°];Achse 6 [°];X-Ist [mm];Y-Ist [mm];Z-Ist [mm];Temperatur [°C];Bemerkung\n",
        |k| {
            format!("{k};04.05.2026;10:{k:02}:30;{};{};21.5;", angles(k, 6, ";"), place(k, 1.0, ";"))
                .replace('.', ",")
                .replace("04,05,2026", "04.05.2026")
        },
    );
    check(&Case {
        files: &[("deutsch.csv", german)],
        says: &[
            "time_s = [\"Datum\", \"Uhrzeit\"]",
            "pose = \"Nr.\"",
            "temperature_c = \"Temperatur\"",
            "decimal = \",\"",
            "revolute_unit: deg, as the header says",
        ],
        times: Some([FIRST, LAST]),
        ..PLAIN
    });
    let fixed = file(
        "  No        J1        J2        J3        J4        J5        J6              X              Y              Z\n",
        |k| {
            let angles =
                (1..=6).map(|joint| format!("{:10.4}", angle(k, joint))).collect::<Vec<_>>().concat();
            format!("{k:4}{angles}{}", point(k).map(|axis| format!("{axis:15.4}")).concat())
        },
    );
    check(&Case { files: &[("fixed.txt", fixed)], says: &["pose = \"No\"", "columns = [\"J1\""], ..PLAIN });
    let bare = file("", |k| format!("{k} {} {}", angles(k, 6, " "), place(k, 1.0, " ")));
    check(&Case {
        files: &[("bare.txt", bare)],
        says: &["columns = [2, 3, 4, 5, 6, 7]", "x = 8", "check it", "pose = 1"],
        ..PLAIN
    });
    let broken = file(
        "\"Point\nName\",\"J1\n[deg]\",\"J2\n[deg]\",\"J3\n[deg]\",\"X\n[mm]\",\"Y\n[mm]\",\"Z\n[mm]\"\n",
        |k| format!("P{k},{},{}", angles(k, 3, ","), place(k, 1.0, ",")),
    );
    check(&Case {
        files: &[("broken.csv", broken)],
        kinds: &[Revolute; 3],
        says: &["columns = [\"J1\", \"J2\", \"J3\"]", "# unit: mm, as the header says"],
        ..PLAIN
    });
    let dates = file("Timestamp,J1,J2,J3,X,Y,Z\n", |k| {
        format!("04/05/2026 10:{k:02}:30,{},{}", angles(k, 3, ","), place(k, 1.0, ","))
    });
    check(&Case {
        files: &[("dates.csv", dates)],
        kinds: &[Revolute; 3],
        decisions: &[("date", "\"dmy\"")],
        says: &["can be day, month, year (dmy) or month, day, year (mdy)"],
        // The fourth of May is where the day comes first in 04/05: 4 May.
        times: Some([FIRST, LAST]),
        ..PLAIN
    });
    let joints = file("Name;J1;J2;J3\n", |k| format!("P{k};{}", angles(k, 3, ";")));
    let target = || file("", |k| format!("P{k} {}", place(k, 1.0, " ")));
    check(&Case {
        files: &[("joints.csv", joints), ("A.txt", target()), ("B.txt", target()), ("C.txt", target())],
        kinds: &[Revolute; 3],
        says: &["by = \"name\"", "--joints", "TARGET=FILE"],
        ..PLAIN
    });
    let polar = file("Pt\tHz [gon]\tV [gon]\tD [m]\tJ1\tJ2\tJ3\n", |k| {
        let [x, y, z] = point(k).map(|axis| 1e-3 * axis);
        let gon = 200.0 / std::f64::consts::PI;
        let zenith = x.hypot(y).atan2(z);
        format!(
            "P{k}\t{:.12}\t{:.12}\t{:.12}\t{}",
            gon * y.atan2(x),
            gon * zenith,
            x.hypot(y).hypot(z),
            angles(k, 3, "\t")
        )
    });
    check(&Case {
        files: &[("polar.txt", polar)],
        kinds: &[Revolute; 3],
        says: &["angle_unit: gon, as the header says", "zenith = \"V\"", "range = \"D\"", "range_unit: m"],
        ..PLAIN
    });
}

/// The controller's own place, which is not where the tracker saw the target.
fn own(row: usize, between: &str) -> String {
    point(row).map(|axis| format!("{:.4}", axis - 300.0)).join(between)
}

#[test]
fn the_controllers_own_place_is_not_taken_for_the_trackers() {
    let six = "A1,A2,A3,A4,A5,A6";
    // The tracker's by its name, wherever it stands.
    for (turn, tracker) in [
        ("A,B,C", "X_LT,Y_LT,Z_LT"),
        ("W,P,R", "X_meas,Y_meas,Z_meas"),
        ("RX,RY,RZ", "tracker.x,tracker.y,tracker.z"),
        ("O,A,T", "Leica X,Leica Y,Leica Z"),
    ] {
        let names: Vec<&str> = tracker.split(',').collect();
        let x = format!("x = {:?}", names[0]);
        let behind = file(&format!("{six},X,Y,Z,{turn},{tracker}\n"), |k| {
            format!("{},{},10,20,{},{}", angles(k, 6, ","), own(k, ","), 30 - 7 * (k % 3), place(k, 1.0, ","))
        });
        let before = file(&format!("{tracker},X,Y,Z,{turn},{six}\n"), |k| {
            format!("{},{},10,20,{},{}", place(k, 1.0, ","), own(k, ","), 30 - 7 * (k % 3), angles(k, 6, ","))
        });
        for text in [behind, before] {
            check(&Case {
                files: &[("krc.csv", text)],
                says: &[&x, "as a tracker's", "as a controller's own columns do", "beside"],
                ..PLAIN
            });
        }
    }
    // Without a name of its own, the one that has no orientation beside it.
    let plain = file(&format!("{six},X,Y,Z,TCP_X,TCP_Y,TCP_Z,TCP_A,TCP_B,TCP_C\n"), |k| {
        format!("{},{},{},10,20,30", angles(k, 6, ","), place(k, 1.0, ","), own(k, ","))
    });
    check(&Case {
        files: &[("tcp.csv", plain)],
        says: &["x = \"X\"", "columns 10, 11, 12 stand beside"],
        ..PLAIN
    });
    // The only one: a person knows.
    for turn in ["A,B,C", "W,P,R", "q1,q2,q3,q4", "qx,qy,qz,qw"] {
        let only = file(&format!("J1,J2,J3,J4,J5,J6,X,Y,Z,{turn}\n"), |k| {
            let turn = turn.split(',').map(|_| "0.5").collect::<Vec<_>>().join(",");
            format!("{},{},{turn}", angles(k, 6, ","), place(k, 1.0, ","))
        });
        check(&Case {
            files: &[("only.csv", only)],
            decisions: &[("x", "\"X\""), ("y", "\"Y\""), ("z", "\"Z\"")],
            says: &["which is not a measurement"],
            ..PLAIN
        });
    }
    // Names that are there twice: by number.
    let twice = file(&format!("{six},X,Y,Z,X,Y,Z\n"), |k| {
        format!("{},{},{}", angles(k, 6, ","), own(k, ","), place(k, 1.0, ","))
    });
    check(&Case {
        files: &[("dup.csv", twice)],
        decisions: &[("x", "10"), ("y", "11"), ("z", "12")],
        says: &["columns 7, 8, 9 and 10, 11, 12 could each be the position", "# DECIDE: x = 7 "],
        ..PLAIN
    });
    // So are names that a map would read as signs.
    let signs =
        file(&format!("{six},X -,Y -,-Z\n"), |k| format!("{},{}", angles(k, 6, ","), place(k, 1.0, ",")));
    check(&Case { files: &[("signs.csv", signs)], says: &["x = 7 ", "y = 8 ", "z = 9 "], ..PLAIN });
    // A controller's log with its own place, and the tracker's in another file.
    let log =
        file(&format!("{six},X,Y,Z,A,B,C\n"), |k| format!("{},{},1,2,3", angles(k, 6, ","), own(k, ",")));
    let seen = file("X,Y,Z\n", |k| place(k, 1.0, ","));
    check(&Case {
        files: &[("log.csv", log), ("seen.csv", seen)],
        says: &["--joints", "by = \"row\""],
        ..PLAIN
    });
}

/// A turn by row, as a unit quaternion with w first.
fn quaternion(row: usize) -> [f64; 4] {
    let (half, about) = (0.02 * row as f64, [0.36, 0.48, 0.8]);
    [half.cos(), half.sin() * about[0], half.sin() * about[1], half.sin() * about[2]]
}

fn quaternion_text(row: usize, order: [usize; 4], between: &str) -> String {
    order.map(|place| format!("{:.6}", quaternion(row)[place])).join(between)
}

/// The rotation angles of what a map reads, by row; all about one axis.
fn turns_of(files: &[(&str, String)], kinds: &[JointKind], map: &str) -> Vec<f64> {
    let folder = tempfile::tempdir().unwrap();
    let paths: Vec<PathBuf> = files
        .iter()
        .map(|(name, text)| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        })
        .collect();
    let several = paths.len() > 1;
    let files = MeasurementFiles {
        joints: several.then(|| paths[0].clone()),
        points: vec![PointsFile { target: None, path: paths[usize::from(several)].clone() }],
    };
    let map = parse_column_map(&Source::new("map.toml", map)).unwrap_or_else(|e| panic!("{e}\n{map}"));
    let loaded = read_files(&files, &map, kinds, &RowOptions::default()).unwrap();
    let angle = |reading: &Reading| match reading {
        Reading::Pose(pose) => pose.rotation.angle(),
        other => panic!("{other:?}"),
    };
    loaded.set.observations.iter().map(|o| angle(&o.reading)).collect()
}

#[test]
fn full_poses_of_probes_and_cameras_are_suggested_with_what_a_person_states() {
    // A probe's export beside the commands: which of Q0 to Q3 is the scalar is nowhere.
    let tmac = file("Point;TMac_X [mm];TMac_Y [mm];TMac_Z [mm];Q0;Q1;Q2;Q3;J1;J2;J3;J4;J5;J6\n", |k| {
        format!("P{k};{};{};{}", place(k, 1.0, ";"), quaternion_text(k, [0, 1, 2, 3], ";"), angles(k, 6, ";"))
    });
    let tmac = [("tmac.csv", tmac)];
    let decisions = [("transform", "\"target_in_tracker\""), ("order", "\"wxyz\"")];
    check(&Case {
        files: &tmac,
        decisions: &decisions,
        says: &[
            "[rotation]",
            "form = \"quaternion\"",
            "columns = [\"Q0\", \"Q1\", \"Q2\", \"Q3\"]",
            "delete [rotation]",
        ],
        ..PLAIN
    });
    // A camera system's, with names that tell the order, in a file of its own; its quaternion stands in front of the place.
    let joints = file("J1,J2,J3,J4,J5,J6\n", |k| angles(k, 6, ","));
    let axes = |what: &str, axes: &[&str]| {
        axes.iter().map(|axis| format!("RigidBody {what} {axis}")).collect::<Vec<_>>().join(",")
    };
    let head =
        format!("Frame,{},{}\n", axes("Rotation", &["X", "Y", "Z", "W"]), axes("Position", &["X", "Y", "Z"]));
    let seen =
        file(&head, |k| format!("{k},{},{}", quaternion_text(k, [1, 2, 3, 0], ","), place(k, 1e-3, ",")));
    let mocap = [("joints.csv", joints), ("mocap.csv", seen)];
    check(&Case {
        files: &mocap,
        decisions: &decisions[..1],
        says: &["order = \"xyzw\"", "by the names", "unit = \"m\""],
        ..PLAIN
    });
    // A tracker that writes in the manner of a controller.
    let abc = file("Tracker X,Tracker Y,Tracker Z,Tracker A,Tracker B,Tracker C,A1,A2,A3,A4,A5,A6\n", |k| {
        format!("{},{:.4},0,0,{}", place(k, 1.0, ","), (0.04 * k as f64).to_degrees(), angles(k, 6, ","))
    });
    let abc = [("abc.csv", abc)];
    check(&Case {
        files: &abc,
        decisions: &[decisions[0], ("form", "\"kuka_abc\"")],
        says: &["unit = \"deg\"", "KUKA's A, B, C"],
        ..PLAIN
    });
    // The only place of a file, beside an orientation: first a person says whether the tracker saw it.
    let bare = file("X,Y,Z,q0,q1,q2,q3\n", |k| {
        format!("{},{}", place(k, 1.0, ","), quaternion_text(k, [0, 1, 2, 3], ","))
    });
    check(&Case {
        files: &[("bare.csv", bare)],
        kinds: &[],
        decisions: &[("columns", ""), ("x", ""), ("y", ""), ("z", "")],
        says: &[
            "which is not a measurement",
            "# columns = [\"q0\", \"q1\", \"q2\", \"q3\"]",
            "# transform = \"target_in_tracker\"",
        ],
        ..PLAIN
    });
    let rotation = "[rotation]\ntransform = \"target_in_tracker\"\n";
    let head = |joints: &str, position: &str| {
        format!(
            "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = {joints}\nrevolute_unit = \"deg\"\n[position]\nsystem = \"cartesian\"\n{position}\n"
        )
    };
    let position = |name: &dyn Fn(&str) -> String| {
        ["x", "y", "z"].map(|axis| format!("{axis} = {:?}", name(&axis.to_uppercase()))).join("\n")
    };
    let six = |letter: &str| format!("{:?}", (1..=6).map(|k| format!("{letter}{k}")).collect::<Vec<_>>());
    for (files, map) in [
        (
            &tmac[..],
            format!(
                "{}{rotation}form = \"quaternion\"\norder = \"wxyz\"\ncolumns = [\"Q0\", \"Q1\", \"Q2\", \"Q3\"]\n",
                head(&six("J"), &position(&|axis| format!("TMac_{axis}")))
            ),
        ),
        (
            &mocap[..],
            format!(
                "{}unit = \"m\"\n{rotation}form = \"quaternion\"\norder = \"xyzw\"\ncolumns = [2, 3, 4, 5]\n",
                head(&six("J"), &position(&|axis| format!("RigidBody Position {axis}")))
            ),
        ),
    ] {
        let found = turns_of(files, &[Revolute; 6], &map);
        for (row, angle) in (1..=ROWS).zip(found) {
            assert!((angle - 0.04 * row as f64).abs() < 1e-5, "row {row}: {angle}");
        }
    }
}

#[test]
fn faces_and_the_air_are_suggested() {
    let spherical = |k: usize| {
        let [x, y, z] = point(k).map(|v| 1e-3 * v);
        let range = (x * x + y * y + z * z).sqrt();
        let (azimuth, zenith) = (y.atan2(x).to_degrees(), (z / range).acos().to_degrees());
        if k.is_multiple_of(2) { (range, azimuth + 180.0, 360.0 - zenith) } else { (range, azimuth, zenith) }
    };
    let text = |face: &'static [&'static str; 2], air: &'static str| {
        move |k: usize| {
            let (range, azimuth, zenith) = spherical(k);
            format!("{},{range:.9},{azimuth:.9},{zenith:.9},{},{air}", angles(k, 6, ","), face[(k + 1) % 2])
        }
    };
    let head = "J1,J2,J3,J4,J5,J6,R [m],Hz [deg],V [deg],Face,Temp,Pressure,Humidity\n";
    check(&Case {
        files: &[("faces.csv", file(head, text(&["F1", "F2"], "20.5,1013,45")))],
        says: &[
            "front = [\"F1\"]",
            "back = [\"F2\"]",
            "temperature_c = \"Temp\"",
            "pressure_hpa = \"Pressure\"",
            "humidity_percent",
        ],
        ..PLAIN
    });
    check(&Case {
        files: &[("words.csv", file(head, text(&["left", "right"], "293.6,760,0.45")))],
        decisions: &[
            ("front", "[\"left\"]"),
            ("back", "[\"right\"]"),
            ("pressure_hpa", "\"Pressure\""),
            ("humidity_percent", "\"Humidity\""),
        ],
        says: &["temperature_k = \"Temp\"", "K by its size"],
        ..PLAIN
    });
}

/// Mass, kg, and height of the centre, m, of what the flange carries in the first rows.
fn carried(observations: &[Observation]) -> Vec<Option<(f64, f64)>> {
    let of = |o: &Observation| o.payload.as_ref().map(|payload| (payload.mass, payload.centre.z));
    observations.iter().take(3).map(of).collect()
}

#[test]
fn payloads_are_suggested_by_name_by_mass_and_with_their_centres() {
    let text = |between: &'static str, loads: [&'static str; 3]| {
        move |k: usize| format!("{},{}{between}{}", angles(k, 6, ","), place(k, 1.0, ","), loads[(k - 1) % 3])
    };
    let head = |load: &str| format!("J1,J2,J3,J4,J5,J6,X [mm],Y [mm],Z [mm],{load}\n");
    let centre = |z| [("x_mm", "0"), ("y_mm", "-4"), ("z_mm", z)];
    // By name: what each stands for is a person's.
    let named = file(&head("Load"), text(",", ["none", "25 kg", "Gripper"]));
    let decisions =
        [&[("mass_kg", "25.02")][..], &centre("118"), &[("mass_kg", "4")], &centre("60")].concat();
    let says: &[&str] = &[
        "payload = \"Load\"",
        "called \"Load\": 25 kg, Gripper",
        "# DECIDE: mass_kg = 25 ",
        "by its name: weigh it",
    ];
    let found = check(&Case { files: &[("named.csv", named)], decisions: &decisions, says, ..PLAIN });
    assert_eq!(carried(&found), [None, Some((25.02, 0.118)), Some((4.0, 0.06))]);
    // By mass alone, in kg as the column says: centres are missing. Nothing is 0.
    let masses = file(&head("Payload [kg]"), text(",", ["0", "25", "50.5"]));
    let decisions = [centre("118"), centre("140")].concat();
    let says: &[&str] = &["name = \"50.5\"", "mass_kg = 50.5", "by its column, in kg"];
    let found = check(&Case { files: &[("masses.csv", masses)], decisions: &decisions, says, ..PLAIN });
    assert_eq!(carried(&found), [None, Some((25.0, 0.118)), Some((50.5, 0.14))]);
    // Whether numbers of a column called payload are masses nobody can see.
    let numbers = file(&head("Payload"), text(",", ["0", "1", "2"]));
    let decisions =
        [&[("mass_kg", "25.02")][..], &centre("118"), &[("mass_kg", "50")], &centre("140")].concat();
    let says: &[&str] = &["# DECIDE: mass_kg = 2 ", "a number in the load's name:"];
    let found = check(&Case { files: &[("numbers.csv", numbers)], decisions: &decisions, says, ..PLAIN });
    assert_eq!(carried(&found)[2], Some((50.0, 0.14)));
    // With the centre in columns, which are no position of the target.
    let whole = file(
        &head("load_mass_kg,load_cog_x_mm,load_cog_y_mm,load_cog_z_mm"),
        text(",", ["0,,,", "25,0,-4,118", "50.5,1,2,140"]),
    );
    let says: &[&str] = &[
        "x = \"X\"",
        "payload_mass_kg = \"load_mass_kg\"",
        "kg, as its name says",
        "payload_z_mm = \"load_cog_z_mm\"",
        "mm, as its name says",
    ];
    let found = check(&Case { files: &[("whole.csv", whole)], says, ..PLAIN });
    assert_eq!(carried(&found), [None, Some((25.0, 0.118)), Some((50.5, 0.14))]);
    // In units that the keys do not read.
    let other = file(
        &head("payload mass (lb),payload x,payload y,payload z"),
        text(",", ["0,0,0,0", "55,0,0,0.118", "110,0,0,0.14"]),
    );
    let open = ["payload_mass_kg", "payload_x_mm", "payload_y_mm", "payload_z_mm"].map(|key| (key, ""));
    let says: &[&str] = &["in lb by its name, but the key reads kg", "in m, by its size"];
    check(&Case { files: &[("other.csv", other)], kinds: &[], decisions: &open, says, ..PLAIN });
    // What motors are loaded with, and weights of a fit, are no payloads.
    let motors = file(&head("Load,Weight"), text(",", ["10,1", "20,1", "70,0.5"]));
    check(&Case { files: &[("motors.csv", motors)], says: &["# not used: Load, Weight"], ..PLAIN });
    // Beside the commands, where the points are in a file of their own.
    let commands = file("J1,J2,J3,J4,J5,J6,Nutzlast\n", |k| {
        format!("{},{}", angles(k, 6, ","), ["leer", "25 kg"][k % 2])
    });
    let points = file("X [mm],Y [mm],Z [mm]\n", |k| place(k, 1.0, ","));
    let decisions = [&[("mass_kg", "25")][..], &centre("118"), &[("mass_kg", "1e-9")], &centre("0")].concat();
    let says: &[&str] = &["payload = \"Nutzlast\"", "where \"leer\" means no load, write"];
    let files = &[("commands.csv", commands), ("points.csv", points)];
    let found = check(&Case { files, decisions: &decisions, says, ..PLAIN });
    assert_eq!(carried(&found)[0], Some((25.0, 0.118)));
}

#[test]
fn axes_with_letters_are_joints_and_what_falls_is_no_time() {
    let motoman = file("S,L,U,R,B,T,X,Y,Z\n", |k| format!("{},{}", angles(k, 6, ","), place(k, 1.0, ",")));
    let says: &[&str] = &["columns = [\"S\", \"L\", \"U\", \"R\", \"B\", \"T\"]", "Motoman"];
    check(&Case { files: &[("motoman.csv", motoman)], says, ..PLAIN });
    let seven = file("pos S,pos L,pos U,pos R,pos B,pos T,pos E,X,Y,Z\n", |k| {
        let angles = [1, 2, 4, 5, 6, 7, 3].map(|joint| format!("{:.4}", angle(k, joint))).join(",");
        format!("{angles},{}", place(k, 1.0, ","))
    });
    let says: &[&str] = &["[\"pos S\", \"pos L\", \"pos E\", \"pos U\""];
    check(&Case { files: &[("seven.csv", seven)], kinds: &[Revolute; 7], says, ..PLAIN });
    let falls = file("J1,J2,J3,T,X,Y,Z\n", |k| {
        format!("{},{:.3},{}", angles(k, 3, ","), angle(k, 4), place(k, 1.0, ","))
    });
    check(&Case {
        files: &[("t.csv", falls)],
        kinds: &[Revolute; 3],
        says: &["# T: it falls from row to row, so it is not a time"],
        ..PLAIN
    });
}

#[test]
fn joints_and_points_without_headers_are_told_apart() {
    let rows = file("", |k| angles(k, 6, " "));
    let points = file("", |k| place(k, 1.0, " "));
    let says: &[&str] =
        &["columns = [1, 2, 3, 4, 5, 6]", "x = 1 ", "by = \"row\"", " --joints ", "looks like mm"];
    check(&Case { files: &[("j.txt", rows.clone()), ("p.txt", points.clone())], says, ..PLAIN });
    // In m, and of a robot with three axes, whose file has as many columns as that of the points.
    let metres = file("", |k| place(k, 1e-3, ";"));
    check(&Case { files: &[("j.txt", rows), ("p.txt", metres)], says: &["looks like m:"], ..PLAIN });
    let three = file("", |k| angles(k, 3, "\t"));
    let says: &[&str] = &["columns = [1, 2, 3]", " --joints "];
    check(&Case { files: &[("j.txt", three), ("p.txt", points)], kinds: &[Revolute; 3], says, ..PLAIN });
    let named = file("", |k| format!("P{k:02} {}", angles(k, 6, " ")));
    let target = || file("", |k| format!("P{k:02} {}", place(k, 1.0, " ")));
    check(&Case {
        files: &[("j.txt", named), ("A.txt", target()), ("B.txt", target()), ("C.txt", target())],
        says: &[
            "columns = [2, 3, 4, 5, 6, 7]",
            "x = 2 ",
            "by = \"name\"",
            " --joints ",
            " --measurements A=",
        ],
        ..PLAIN
    });
    // The points in front, and with a header.
    let counted = file("", |k| format!("{k} {}", angles(k, 6, " ")));
    let headed = file("No X Y Z\n", |k| format!("{k} {}", place(k, 1.0, " ")));
    let folder = tempfile::tempdir().unwrap();
    let paths = [("p.txt", headed), ("j.txt", counted)].map(|(name, text)| {
        std::fs::write(folder.path().join(name), text).unwrap();
        folder.path().join(name)
    });
    let map = suggest_columns(&[&paths[0], &paths[1]], &RowOptions::default()).unwrap();
    for words in ["columns = [2, 3, 4, 5, 6, 7]", "x = \"X\"", "joints = 1", "points = \"No\""] {
        assert!(map.text.contains(words), "{words}\n{}", map.text);
    }
}

#[test]
fn numbers_with_nothing_between_them_are_cut_where_they_end() {
    // A sign that takes the last blank, among the lengths alone, behind the name as well, and everywhere.
    let centre = |width| if width == 9 { [2500.0, -700.0, 900.0] } else { [3000.0; 3] };
    for (name, angle_width, place_width) in [("P", 10, 10), ("Pt", 9, 10), ("", 9, 9)] {
        let text = file("", |k| {
            let angles = (1..=6)
                .map(|joint| format!("{:angle_width$.4}", angle(k, joint)))
                .collect::<Vec<_>>()
                .concat();
            let place = point(k).into_iter().zip(centre(place_width));
            let place = place
                .map(|(axis, centre)| format!("{:place_width$.4}", axis - centre))
                .collect::<Vec<_>>()
                .concat();
            format!("{name}{k:03}{angles}{place}")
        });
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fixed.txt");
        std::fs::write(&path, &text).unwrap();
        let map = suggest_columns(&[&path], &RowOptions::default()).expect("a map");
        assert_eq!(map.open, Vec::<String>::new(), "{text}\n{}", map.text);
        let first = name.len() + 3;
        let (a, b) = (angle_width, place_width);
        let widths = format!("[{first}, {a}, {a}, {a}, {a}, {a}, {a}, {b}, {b}, {b}]");
        assert!(map.text.contains(&format!("widths = {widths}")), "{text}\n{}", map.text);
        let map = parse_column_map(&Source::new("map.toml", map.text)).expect("a map");
        let files = MeasurementFiles::one(&path);
        let loaded = read_files(&files, &map, &[Revolute; 6], &RowOptions::default()).expect("read");
        assert_eq!(loaded.set.observations.len(), ROWS);
        for (row, observation) in (1..).zip(&loaded.set.observations) {
            assert!((observation.command[5] - angle(row, 6).to_radians()).abs() < 1e-9);
            let z = observation.reading.position()[2];
            assert!((z - 1e-3 * (point(row)[2] - centre(place_width)[2])).abs() < 1e-9);
        }
    }
}

#[test]
fn numbers_with_nothing_between_them_that_end_anywhere_ask_for_widths() {
    let glued = file("", |k| {
        let digits = 3 + k % 3;
        format!("{k} {:.digits$}{:.4}{:.4}{:.4}", angle(k, 1), -120.5, -1500.25 - k as f64, -2500.5)
    });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("glued.txt");
    std::fs::write(&path, glued).unwrap();
    let map = suggest_columns(&[&path], &RowOptions::default()).expect("a map");
    assert!(map.text.contains("# DECIDE: widths = [8, 12, 12]"), "{}", map.text);
}

#[test]
fn a_file_without_rows_of_numbers_is_refused() {
    for text in ["J1,J2,X,Y,Z\n", "<html><body>1</body></html>\n", "a b\nc d\n"] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.csv");
        std::fs::write(&path, text).unwrap();
        let refused = suggest_columns(&[&path], &RowOptions::default()).expect_err("no numbers").to_string();
        assert!(refused.contains("it has no row of numbers"), "{refused}");
    }
}
