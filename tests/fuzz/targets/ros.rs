//! Bags of ROS 2: messages in CDR within MCAP.

use calibrig::files::{BagOptions, ColumnMap, MemoryRows, Source, parse_column_map, read_bag, read_rows};
use calibrig::model::JointKind;

use super::choices::Choices;
use super::file;
use super::mcap_file::{self, Part};
use super::measurements::use_measurements;

const TYPES: [&str; 6] = [
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PointStamped",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/PointStamped",
    "std_msgs/msg/String",
];
const TOPICS: [&str; 5] = ["/states", "/smr", "/smr2", "/tf", ""];
const NAMES: [&str; 6] = ["a", "b", "c", "", "a\"b", "ü"];
const MAP: &str = r#"
schema = "calibrig.columns/1"
joints = { columns = ["a", "b", "c"], revolute_unit = "rad", prismatic_unit = "m" }
position = { system = "cartesian", unit = "m", x = "x", y = "y", z = "z" }
columns = { time_s = "time_s" }
"#;

/// A bag of a few states and points.
pub fn ros(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let mut parts = Vec::new();
    let mut time: i64 = 5_000_000_000;
    for _ in 0..choices.below(24) {
        if choices.is_empty() {
            break;
        }
        parts.push(message(choices, &mut time));
    }
    let mut bytes = mcap_file::file(&parts, "ros2", choices);
    mcap_file::damage(&mut bytes, choices);
    let options = match choices.below(4) {
        0 => BagOptions { tolerance_s: choices.number(), ..BagOptions::default() },
        1 => BagOptions {
            joints: Some("/states".to_owned()),
            points: vec!["/smr".to_owned(), "/tf".to_owned()],
            names: vec!["a".to_owned(), "b".to_owned()],
            ..BagOptions::default()
        },
        _ => BagOptions::default(),
    };
    let Ok(table) = file::with(&bytes, |path, _| read_bag(path, &options)) else { return };
    let map: ColumnMap = parse_column_map(&Source::new("columns.toml", MAP)).expect("a sound map");
    let joints = [JointKind::Revolute, JointKind::Revolute, JointKind::Prismatic];
    if let Ok(loaded) = read_rows(Box::new(MemoryRows::from(table)), &map, &joints) {
        use_measurements(&loaded, choices);
    }
}

/// Sound in three of four.
fn message(choices: &mut Choices<'_>, time: &mut i64) -> Part {
    // What belongs together, more often than not.
    let kind = [0, 0, 0, 1, 1, 1, 2, 3, 4, 5][choices.below(10)];
    let topic = if choices.below(8) == 7 { *choices.pick(&TOPICS) } else { TOPICS[[0, 1, 2, 3, 1, 4][kind]] };
    *time = match choices.below(8) {
        7 => {
            *choices.pick(&[0, -1, i64::from(i32::MAX) * 1_000_000_000, i64::from(i32::MIN) * 1_000_000_000])
        }
        step => time.saturating_add([0, 10, 10, 10, 40, 100, -10][step] * 1_000_000),
    };
    let mut cdr = Cdr { bytes: vec![0, u8::from(choices.below(4) != 3), 0, 0] };
    cdr.header(*time, if choices.below(4) == 3 { choices.pick::<&str>(&NAMES) } else { "tracker" });
    match kind {
        0 => {
            let count = if choices.below(8) == 7 { choices.below(6) } else { 3 };
            cdr.u32(count);
            let names = choices.below(8) == 7;
            (0..count).for_each(|i| cdr.text(if names { choices.pick::<&str>(&NAMES) } else { NAMES[i] }));
            let positions = if choices.below(16) == 15 { choices.below(5) } else { count };
            cdr.u32(positions);
            (0..positions).for_each(|_| cdr.f64(value(choices)));
            let velocities = if choices.below(4) == 3 { count } else { 0 };
            cdr.u32(velocities);
            (0..velocities).for_each(|_| cdr.f64(value(choices)));
            cdr.u32(0);
        }
        3 => {
            cdr.text(if choices.below(4) == 3 { choices.pick::<&str>(&NAMES) } else { "smr" });
            (0..7).for_each(|_| cdr.f64(value(choices)));
        }
        _ => (0..if kind == 2 { 7 } else { 3 }).for_each(|_| cdr.f64(value(choices))),
    }
    let mut data = cdr.bytes;
    if choices.below(8) == 7 {
        let at = choices.below(data.len());
        match choices.below(2) {
            0 => data.truncate(at),
            _ => data[at] = *choices.pick(&[0, 1, 0x7f, 0xff]),
        }
    }
    let encoding = if choices.below(32) == 31 { "json" } else { "cdr" };
    Part::Message {
        topic: topic.to_owned(),
        schema: (TYPES[kind].to_owned(), "ros2msg".to_owned(), Vec::new()),
        encoding: encoding.to_owned(),
        time: u64::try_from(*time).unwrap_or(0),
        data,
    }
}

fn value(choices: &mut Choices<'_>) -> f64 {
    if choices.below(8) == 7 { choices.number() } else { 2.0 * choices.fraction() - 1.0 }
}

struct Cdr {
    bytes: Vec<u8>,
}

impl Cdr {
    fn number<const N: usize>(&mut self, mut number: [u8; N]) {
        while !(self.bytes.len() - 4).is_multiple_of(N) {
            self.bytes.push(0);
        }
        if self.bytes[1] == 0 {
            number.reverse();
        }
        self.bytes.extend(number);
    }

    fn u32(&mut self, number: usize) {
        self.number(u32::try_from(number).expect("small").to_le_bytes());
    }

    fn f64(&mut self, number: f64) {
        self.number(number.to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.u32(text.len() + 1);
        self.bytes.extend(text.as_bytes());
        self.bytes.push(0);
    }

    fn header(&mut self, stamp: i64, frame: &str) {
        let seconds = i32::try_from(stamp.div_euclid(1_000_000_000)).unwrap_or(i32::MAX);
        let nanoseconds = u32::try_from(stamp.rem_euclid(1_000_000_000)).expect("below a second");
        self.number(seconds.to_le_bytes());
        self.number(nanoseconds.to_le_bytes());
        self.text(frame);
    }
}
