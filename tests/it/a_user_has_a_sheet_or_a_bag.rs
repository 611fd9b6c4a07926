//! The same session as text, as a sheet of a spreadsheet and as a bag of ROS 2: one estimate, to the bit.

use std::io::Cursor;

use calibrig::files::load_robot;
use calibrig::geometry::{rotation_x, rotation_z, translation};
use calibrig::kinematics::target_in_base;
use calibrig::nalgebra::{Point3, Vector3};
use calibrig::random::{StreamSource, stream};
use rand::RngExt;
use rust_xlsxwriter::Workbook;

use crate::sandbox::{Ended, Sandbox, assert_refused};

const ROBOT: &str = "models/ur5/robot.toml";
const NAMES: [&str; 6] = ["base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3"];

/// Commands (rad) and points (m) of a UR5 whose elbow is 1 mm off.
fn session() -> Vec<(Vec<f64>, Vector3<f64>)> {
    let nominal = load_robot(std::path::Path::new(ROBOT)).expect("the shipped robot").model.kinematics;
    let mut real = nominal.clone();
    real.links[2].a += 1e-3;
    let tracker = translation(2.0, -1.5, 0.3) * rotation_z(2.0) * rotation_x(0.02);
    let mut draw = stream(31, 0, StreamSource::IdentificationPoses);
    let pose = |_| {
        let joint =
            |link: &calibrig::model::CraigLink| 0.5 * draw.random_range(link.limits[0]..link.limits[1]);
        let joints: Vec<f64> = real.links.iter().map(joint).collect();
        let at = target_in_base(&real, &joints, &Vector3::new(0.03, -0.05, 0.08)).expect("a pose");
        let noise = Vector3::from_fn(|_, _| 2e-5 * (draw.random::<f64>() - 0.5));
        (joints, (tracker * Point3::from(at)).coords + noise)
    };
    (0..60).map(pose).collect()
}

const HEADER: [&str; 10] =
    ["pose", "q1_rad", "q2_rad", "q3_rad", "q4_rad", "q5_rad", "q6_rad", "x_m", "y_m", "z_m"];

fn csv(session: &[(Vec<f64>, Vector3<f64>)]) -> String {
    let mut text = HEADER.join(",") + "\n";
    for (pose, (joints, point)) in (1..).zip(session) {
        let numbers = joints.iter().chain(point.iter()).map(|number| format!("{number:?}"));
        let cells: Vec<String> = std::iter::once(pose.to_string()).chain(numbers).collect();
        text += &cells.join(",");
        text += "\n";
    }
    text
}

/// The table begins at B3 of the second sheet, below a title.
fn xlsx(session: &[(Vec<f64>, Vector3<f64>)]) -> Workbook {
    let mut book = Workbook::new();
    book.add_worksheet().set_name("Notes").expect("named").write_string(0, 0, "a note").expect("written");
    let sheet = book.add_worksheet().set_name("Points").expect("named");
    for (column, name) in (1..).zip(HEADER) {
        sheet.write_string(2, column, name).expect("written");
    }
    for (row, (joints, point)) in (3..).zip(session) {
        sheet.write_number(row, 1, f64::from(row - 2)).expect("written");
        for (column, number) in (2..).zip(joints.iter().chain(point.iter())) {
            sheet.write_number(row, column, *number).expect("written");
        }
    }
    book
}

/// CDR, little-endian.
struct Cdr(Vec<u8>);

impl Cdr {
    fn header(stamp: u64, frame: &str) -> Self {
        let mut cdr = Self(vec![0, 1, 0, 0]);
        cdr.0.extend(u32::try_from(stamp / 1_000_000_000).expect("a time").to_le_bytes());
        cdr.0.extend(u32::try_from(stamp % 1_000_000_000).expect("a time").to_le_bytes());
        cdr.text(frame);
        cdr
    }

    fn align(&mut self, size: usize) {
        while !(self.0.len() - 4).is_multiple_of(size) {
            self.0.push(0);
        }
    }

    fn length(&mut self, length: usize) {
        self.align(4);
        self.0.extend(u32::try_from(length).expect("short").to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    fn numbers(&mut self, numbers: impl IntoIterator<Item = f64>) {
        for number in numbers {
            self.align(8);
            self.0.extend(number.to_le_bytes());
        }
    }
}

/// Joints by the alphabet, as drivers have them.
fn bag(session: &[(Vec<f64>, Vector3<f64>)], names: [&str; 6]) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new().profile("ros2").create(&mut file).expect("begun");
    let none = std::collections::BTreeMap::new();
    let mut channel = |name: &str, topic: &str| {
        let schema = writer.add_schema(name, "ros2msg", b"").expect("added");
        writer.add_channel(schema, topic, "cdr", &none).expect("added")
    };
    let states = channel("sensor_msgs/msg/JointState", "/joint_states");
    let points = channel("geometry_msgs/msg/PointStamped", "/tracker");
    let mut write = |channel_id: u16, time: u64, data: &[u8]| {
        let header =
            mcap::records::MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, data).expect("written");
    };
    let mut order: Vec<usize> = (0..6).collect();
    order.sort_by_key(|joint| names[*joint]);
    for (pose, (joints, point)) in (0..).zip(session) {
        let time = 1_700_000_000_000_000_000 + 3_000_000_000 * pose;
        for step in 0..5 {
            let mut state = Cdr::header(time + 10_000_000 * step, "");
            state.length(6);
            for joint in &order {
                state.text(names[*joint]);
            }
            state.length(6);
            state.numbers(order.iter().map(|joint| joints[*joint]));
            state.length(0);
            state.length(0);
            write(states, time, &state.0);
        }
        let mut message = Cdr::header(time + 22_000_000, "tracker");
        message.numbers(point.iter().copied());
        write(points, time, &message.0);
    }
    writer.finish().expect("finished");
    drop(writer);
    file.into_inner()
}

fn identify(sandbox: &Sandbox, file: &str, more: &[&str]) -> Ended {
    let measured = ["identify", "--model", ROBOT, "--mode", "only_calibration", "--measurements", file];
    sandbox.run([&measured[..], more].concat())
}

#[test]
fn it_gives_the_estimate_of_the_same_numbers_as_text() {
    let sandbox = Sandbox::new();
    let session = session();
    sandbox.write("set.csv", csv(&session));
    sandbox.write("book.xlsx", xlsx(&session).save_to_buffer().expect("written"));
    sandbox.write("bag.mcap", bag(&session, NAMES));
    let text = identify(&sandbox, "set.csv", &["--json"]);
    assert_eq!(text.code, Some(0), "{text:?}");
    let expected = text.json();
    for (file, more, row, said) in [
        ("book.xlsx", &["--sheet", "Points"][..], "book.xlsx, sheet Points, row 4", ""),
        ("bag.mcap", &[], "bag.mcap, /tracker, message 1", "rad and m, as ROS has it"),
        (
            "bag.mcap",
            &["--bag-joints", "/joint_states", "--bag-points", "/tracker", "--bag-tolerance-ms", "5"],
            "bag.mcap, /tracker, message 1",
            "within 5 ms",
        ),
    ] {
        let ended = identify(&sandbox, file, &[more, &["--json"]].concat());
        assert_eq!(ended.code, Some(0), "{file}: {ended:?}");
        assert!(ended.stderr.contains(said), "{file}: {}", ended.stderr);
        let json = ended.json();
        assert_eq!(json["parameters"], expected["parameters"], "{file}: to the bit");
        assert_eq!(
            json["sets"]["identification"]["rows"], expected["sets"]["identification"]["rows"],
            "{file}"
        );
        assert_ne!(json["input"]["sha256"], expected["input"]["sha256"], "the file itself is told");
        assert_eq!(json["estimates"]["only_calibration"]["residuals"]["identification"][0]["row"], row);
    }
    // The first sheet has no table, and is the one that is read where nobody says which.
    let first = identify(&sandbox, "book.xlsx", &[]);
    assert_eq!(first.code, Some(1), "{first:?}");
    let suggested = sandbox.run(["columns", "suggest", "bag.mcap"]);
    // Which joint comes first is for a person to say.
    assert_eq!(suggested.code, Some(3), "{suggested:?}");
    for words in ["x = \"x\"", "time_s", "revolute_unit = \"rad\"", "# DECIDE: columns = ["] {
        assert!(suggested.stdout.contains(words), "{words}: {suggested:?}");
    }
}

#[test]
fn a_mistake_is_told_with_its_cell_or_message() {
    let sandbox = Sandbox::new();
    let session = session();
    let mut book = xlsx(&session);
    let sheet = book.worksheet_from_name("Points").expect("there");
    sheet.write_string(6, 4, "abc").expect("written");
    sheet.write_boolean(8, 9, true).expect("written");
    sandbox.write("book.xlsx", book.save_to_buffer().expect("written"));
    let refused = |file: &str, more: &[&str], place: &str, message: &str, expected: &str| {
        let arguments = ["identify", "--model", ROBOT, "--measurements", file];
        assert_refused(&sandbox, &[&arguments[..], more].concat(), place, message, expected);
    };
    refused(
        "book.xlsx",
        &["--sheet", "Points"],
        "book.xlsx, sheet Points, cell E7: ",
        "column q3_rad is \"abc\"",
        "a number",
    );
    refused(
        "book.xlsx",
        &["--sheet", "points"],
        "book.xlsx: ",
        "there is no sheet points",
        "one of: Notes, Points",
    );
    sandbox.write("bag.mcap", bag(&session, ["a", "b", "c", "d", "e", "f"]));
    refused("bag.mcap", &[], "bag.mcap: ", "no joint named base, shoulder", "column map");
    sandbox.write("map.toml", "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"a\", \"b\", \"c\", \"d\", \"e\", \"f\"]\nrevolute_unit = \"rad\"\n[position]\nsystem = \"cartesian\"\nunit = \"m\"\nx = [\"x\"]\ny = [\"y\"]\nz = [\"z\"]\n");
    let mapped = identify(&sandbox, "bag.mcap", &["--columns", "map.toml"]);
    assert_eq!(mapped.code, Some(0), "{mapped:?}");
    let whole = bag(&session, NAMES);
    sandbox.write("cut.mcap", &whole[..whole.len() / 2]);
    refused("cut.mcap", &[], "cut.mcap: ", "it breaks off", "calibrig recover");
    let recording = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/paper.mcap");
    std::fs::copy(recording, sandbox.path("paper.mcap")).expect("copied");
    refused("paper.mcap", &[], "paper.mcap: ", "calibrig recording", "calibrig replay");
    sandbox.write("old.xls", [0xd0, 0xcf, 0x11, 0xe0, 0xa1, 0xb1, 0x1a, 0xe1]);
    refused("old.xls", &[], "cannot read old.xls: ", "save it as XLSX", "");
}
