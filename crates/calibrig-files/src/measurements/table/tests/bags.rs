//! Bags against what rosbags and Python's mcap wrote, and byte by byte.

use super::*;
use crate::measurements::table::cdr::{self, CdrError};

/// Messages as the standard describes them, byte by byte.
struct Cdr {
    bytes: Vec<u8>,
    little: bool,
}

impl Cdr {
    fn new(little: bool) -> Self {
        Self { bytes: vec![0, u8::from(little), 0, 0], little }
    }

    fn number<const N: usize>(mut self, mut number: [u8; N]) -> Self {
        while !(self.bytes.len() - 4).is_multiple_of(N) {
            self.bytes.push(0);
        }
        if !self.little {
            number.reverse();
        }
        self.bytes.extend(number);
        self
    }

    fn u32(self, number: usize) -> Self {
        self.number(u32::try_from(number).expect("small").to_le_bytes())
    }

    fn f64s(self, numbers: &[f64]) -> Self {
        numbers.iter().fold(self, |cdr, number| cdr.number(number.to_le_bytes()))
    }

    fn text(self, text: &str) -> Self {
        let mut cdr = self.u32(text.len() + 1);
        cdr.bytes.extend(text.as_bytes());
        cdr.bytes.push(0);
        cdr
    }

    fn header(self, stamp: i64, frame: &str) -> Self {
        let seconds = i32::try_from(stamp.div_euclid(1_000_000_000)).expect("a time");
        let nanoseconds = u32::try_from(stamp.rem_euclid(1_000_000_000)).expect("below a second");
        self.number(seconds.to_le_bytes()).number(nanoseconds.to_le_bytes()).text(frame)
    }

    fn state(stamp: i64, little: bool, joints: &[(&str, f64)], velocities: &[f64]) -> Vec<u8> {
        let named = Self::new(little).header(stamp, "").u32(joints.len());
        let named = joints.iter().fold(named, |cdr, (name, _)| cdr.text(name));
        let positions: Vec<f64> = joints.iter().map(|(_, position)| *position).collect();
        let cdr = named.u32(positions.len()).f64s(&positions).u32(velocities.len()).f64s(velocities);
        cdr.u32(0).bytes
    }

    fn point(stamp: i64, little: bool, frame: &str, place: &[f64; 3]) -> Vec<u8> {
        Self::new(little).header(stamp, frame).f64s(place).bytes
    }
}

#[test]
fn messages_are_read_in_both_orders_of_bytes() {
    for little in [true, false] {
        // Names of several lengths shift what stands behind them.
        for name in ["a", "ab", "abc", "abcd", "abcde"] {
            let joints = [(name, 0.1), ("other", -2.5)];
            let message = Cdr::state(-1_500_000_001, little, &joints, &[1.0, 2.0]);
            let state = cdr::joint_state(&message).expect("sound");
            assert_eq!((state.header.stamp_ns, state.header.frame), (-1_500_000_001, ""));
            assert_eq!((state.names, state.positions), (vec![name, "other"], vec![0.1, -2.5]));
            assert_eq!(state.velocities, [1.0, 2.0]);
            let message = Cdr::point(7, little, name, &[1.0, 2.0, 3.0]);
            let point = cdr::point(&message).expect("sound");
            assert_eq!((point.header.frame, point.position), (name, [1.0, 2.0, 3.0]));
            let turned =
                Cdr::new(little).header(8, "base").text(name).f64s(&[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
            let transform = cdr::transform(&turned.bytes).expect("sound");
            assert_eq!((transform.child, transform.position), (Some(name), [1.0, 2.0, 3.0]));
            assert_eq!(transform.turn, Some([0.0, 0.0, 0.0, 1.0]));
            let pose = Cdr::new(little).header(8, name).f64s(&[1.0, 2.0, 3.0, 0.5, -0.5, 0.1, 0.7]).bytes;
            let pose = cdr::pose(&pose).expect("sound");
            assert_eq!((pose.position, pose.turn), ([1.0, 2.0, 3.0], Some([0.5, -0.5, 0.1, 0.7])));
            assert!(cdr::pose(&Cdr::point(7, little, name, &[1.0, 2.0, 3.0])).is_err(), "a point has none");
        }
    }
    assert_eq!(cdr::stamp(&[0, 7, 0, 0]), Err(CdrError::Encoding(7)));
    assert!(CdrError::Encoding(7).to_string().contains("CDR of version 2"));
    // A length that no memory could hold.
    let mut long = Cdr::state(0, true, &[("a", 0.0)], &[]);
    long[4 + 8 + 4 + 4] = 0xff;
    long[4 + 8 + 4 + 4 + 3] = 0xff;
    assert!(cdr::joint_state(&long).is_err());
}

type Message<'a> = (&'a str, &'a str, u64, Vec<u8>);

const STATE: &str = "sensor_msgs/msg/JointState";
const POINT: &str = "geometry_msgs/msg/PointStamped";

fn bag(options: mcap::WriteOptions, messages: &[Message<'_>]) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = options.create(&mut file).expect("begun");
    let none = std::collections::BTreeMap::new();
    for (topic, schema, time, data) in messages {
        let schema = writer.add_schema(schema, "ros2msg", b"").expect("added");
        let channel_id = writer.add_channel(schema, topic, "cdr", &none).expect("added");
        let header =
            mcap::records::MessageHeader { channel_id, sequence: 0, log_time: *time, publish_time: *time };
        writer.write_to_known_channel(&header, data).expect("written");
    }
    writer.finish().expect("finished");
    drop(writer);
    file.into_inner()
}

fn read(bytes: &[u8], options: &BagOptions) -> Result<Table, String> {
    bag_of(&mut Cursor::new(bytes), "b.mcap", options)
        .map_err(|error| format!("{:?}", miette::Report::new(error)))
}

fn of(messages: &[Message<'_>], options: &BagOptions) -> Result<Table, String> {
    read(&bag(mcap::WriteOptions::new(), messages), options)
}

const MS: i64 = 1_000_000;

/// States of two joints every 10 ms, and a point every 100 ms.
fn session() -> Vec<Message<'static>> {
    let mut messages = Vec::new();
    for step in 0..40_i64 {
        let stamp = 5_000_000_000 + 10 * MS * step;
        let pose = (step / 10) as f64;
        messages.push(("/states", STATE, 1, Cdr::state(stamp, true, &[("b", pose), ("a", -pose)], &[])));
        if step % 10 == 5 {
            messages.push(("/smr", POINT, 2, Cdr::point(stamp + 2 * MS, true, "tracker", &[pose, 1.0, 2.0])));
        }
    }
    messages
}

#[test]
fn bags_of_another_program_are_read_to_the_last_digit() {
    let options = BagOptions { names: NAMES.map(str::to_owned).to_vec(), ..BagOptions::default() };
    for name in ["points_lz4.mcap", "poses_zstd_be.mcap", "transforms_plain.mcap"] {
        let table = bag::read_bag(&fixture(name), &options).unwrap_or_else(|error| panic!("{name}: {error}"));
        let has_turns = name != "points_lz4.mcap";
        let turn = ["qx", "qy", "qz", "qw"].into_iter().filter(|_| has_turns);
        let header = ["time_s"].into_iter().chain(NAMES).chain(["x", "y", "z"]).chain(turn);
        assert_eq!(table.rows[0].cells, header.collect::<Vec<_>>());
        assert_eq!(table.rows.len(), 1 + POSES as usize, "{name}");
        for (pose, row) in (0..POSES).zip(&table.rows[1..]) {
            let joints = (0..6).map(|number| joint(pose, number));
            let expected = std::iter::once(2.0 * f64::from(pose)).chain(joints).chain(place(pose));
            let turn = [0.0, 0.0, 0.0, 1.0].into_iter().filter(|_| has_turns);
            assert_near(&numbers(row), expected.chain(turn));
        }
        let said = table.remarks.join("\n");
        for words in [
            "rad and m, as ROS has it",
            "1 point dropped: /tracker, message 9: no state of shoulder_pan within 50 ms",
            "1 point measured while the robot moved",
            "/tracker, message 6",
            "the stamps of their headers within 50 ms",
        ] {
            assert!(said.contains(words), "{name}: {words}: {said}");
        }
        assert_eq!(said.contains("orientations are in the columns qx, qy, qz, qw"), has_turns, "{said}");
    }
}

#[test]
fn joints_are_found_by_name_and_points_by_time_in_any_container() {
    let messages = session();
    let mut shuffled = messages.clone();
    shuffled.reverse();
    for options in [
        mcap::WriteOptions::new(),
        mcap::WriteOptions::new().compression(None),
        mcap::WriteOptions::new().use_chunks(false),
        mcap::WriteOptions::new().calculate_chunk_crcs(false).calculate_data_section_crc(false),
    ] {
        let names = BagOptions {
            names: vec!["a".to_owned(), "b".to_owned()],
            tolerance_s: 0.03,
            ..BagOptions::default()
        };
        let table = read(&bag(options.clone(), &messages), &names).expect("read");
        assert_eq!(table.rows[0].cells, ["time_s", "a", "b", "x", "y", "z"]);
        for (pose, row) in (0..4).zip(&table.rows[1..]) {
            let pose = f64::from(pose);
            assert_near(&numbers(row), [0.1 * pose, -pose, pose, pose, 1.0, 2.0]);
        }
        assert_eq!(table.remarks.len(), 1, "{:?}", table.remarks);
        let others = read(&bag(options, &shuffled), &names).expect("read");
        assert_eq!(
            others.rows.iter().map(|row| &row.cells).collect::<Vec<_>>(),
            table.rows.iter().map(|row| &row.cells).collect::<Vec<_>>()
        );
    }
}

/// Odometry and poses with covariances have the pose where transforms and poses have it; of a mixture with points, or with a pose that nobody turned,
/// the positions alone are read.
#[test]
fn orientations_are_columns_where_every_point_has_one() {
    let turn = [0.1, -0.2, 0.3, 0.9];
    let numbers: Vec<f64> = [7.0, 8.0, 9.0].into_iter().chain(turn).chain([0.0; 36 + 6 + 36]).collect();
    let odometry = Cdr::new(true).header(5_050 * MS, "tracker").text("probe").f64s(&numbers).bytes;
    let with_covariance = Cdr::new(false).header(5_150 * MS, "tracker").f64s(&numbers[..43]).bytes;
    let unset = Cdr::new(true).header(5_250 * MS, "tracker").f64s(&[7.0, 8.0, 9.0, 0.0, 0.0, 0.0, 0.0]).bytes;
    let messages = |others: &[Message<'static>]| {
        let mut all: Vec<_> = session().into_iter().filter(|(topic, ..)| *topic == "/states").collect();
        all.extend(others.iter().cloned());
        let points = others.iter().map(|(topic, ..)| (*topic).to_owned()).collect();
        of(&all, &BagOptions { points, ..BagOptions::default() }).expect("read")
    };
    let odometry = ("/odometry", "nav_msgs/msg/Odometry", 1, odometry);
    let pose = ("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", 1, with_covariance);
    let both = messages(&[odometry.clone(), pose.clone()]);
    assert_eq!(both.rows[0].cells[6..], ["qx", "qy", "qz", "qw", "target"]);
    for row in &both.rows[1..] {
        assert_eq!(row.cells[3..10], ["7", "8", "9", "0.1", "-0.2", "0.3", "0.9"], "{row:?}");
    }
    let unset = ("/unset", "geometry_msgs/msg/PoseStamped", 1, unset);
    let some = messages(&[odometry, unset]);
    assert_eq!(some.rows[0].cells.len(), 7, "{:?}", some.rows[0]);
    assert!(some.remarks.iter().any(|line| line.contains("some points have no orientation")));
}

#[test]
fn topics_are_told_apart_or_asked_for() {
    let mut messages = session();
    let second = Cdr::point(5_050 * MS, false, "tracker", &[7.0, 8.0, 9.0]);
    messages.push(("/smr2", POINT, 1, second));
    let error = of(&messages, &BagOptions::default()).expect_err("refused");
    // A drawn line may end within a name.
    let without_blanks = |text: &str| text.split_whitespace().collect::<String>();
    for words in [
        "several topics have points",
        "--bag-points with one of them, or with several if each is a different target",
        "/smr (geometry_msgs/msg/PointStamped, 4 messages)",
        "/smr2 (geometry_msgs/msg/PointStamped, 1 message)",
    ] {
        assert!(without_blanks(&error).contains(&without_blanks(words)), "{words}: {error}");
    }
    let both = BagOptions { points: vec!["/smr".to_owned(), "/smr2".to_owned()], ..BagOptions::default() };
    let table = of(&messages, &both).expect("read");
    assert_eq!(table.rows[0].cells, ["time_s", "b", "a", "x", "y", "z", "target"]);
    let targets: Vec<&str> = table.rows[1..].iter().map(|row| row.cells[6].as_str()).collect();
    assert_eq!(targets, ["/smr2", "/smr", "/smr", "/smr", "/smr"]);
    let wrong = BagOptions { points: vec!["/smr3".to_owned()], ..BagOptions::default() };
    assert!(of(&messages, &wrong).expect_err("refused").contains("there are no points on /smr3"));
    messages.push(("/gripper", STATE, 1, Cdr::state(0, true, &[("g", 0.0)], &[])));
    assert!(of(&messages, &both).expect_err("refused").contains("--bag-joints"));
    let chosen = BagOptions { joints: Some("/states".to_owned()), ..both };
    assert_eq!(of(&messages, &chosen).expect("read").rows.len(), 6);
    let unknown = BagOptions { names: vec!["J1".to_owned()], ..chosen };
    let error = of(&messages, &unknown).expect_err("refused");
    assert!(error.contains("no joint named J1") && error.contains("b, a"), "{error}");
}

#[test]
fn points_without_their_joints_are_dropped_with_the_reason() {
    let mut messages = session();
    messages.push(("/smr", POINT, 1, Cdr::point(9_000 * MS, true, "tracker", &[1.0; 3])));
    messages.push(("/smr", POINT, 1, Cdr::point(5_050 * MS, true, "tracker", &[f64::NAN; 3])));
    let table = of(&messages, &BagOptions::default()).expect("read");
    let said = table.remarks.join("\n");
    for words in [
        "1 point dropped: /smr, message 5: no state of b within 50 ms",
        "1 point dropped, coordinates not finite: /smr, message 6",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let strict = BagOptions { tolerance_s: 1e-3, ..BagOptions::default() };
    let error = of(&messages, &strict).expect_err("none is so near");
    for words in ["none of 5 points", "within 1 ms", "from 5.052 s to 9.000 s", "from 5.000 s to 5.390 s"] {
        assert!(error.replace("\n  │ ", " ").contains(words), "{words}: {error}");
    }
}

#[test]
fn a_robot_that_moves_is_told() {
    let moving: Vec<Message<'_>> = session()
        .into_iter()
        .enumerate()
        .map(|(step, (topic, schema, time, data))| {
            let Ok(state) = cdr::joint_state(&data) else { return (topic, schema, time, data) };
            let joints = [("b", 1e-3 * step as f64), ("a", 0.0)];
            (topic, schema, time, Cdr::state(state.header.stamp_ns, true, &joints, &[0.1, 0.0]))
        })
        .map(
            |(topic, schema, time, data)| {
                if topic == "/smr" { (topic, POINT, time, data) } else { (topic, schema, time, data) }
            },
        )
        .collect();
    let said = of(&moving, &BagOptions::default()).expect("read").remarks.join("\n");
    assert!(said.contains("4 points measured while the robot moved"), "{said}");
}

#[test]
fn without_stamps_the_times_of_the_file_count_and_frames_are_stations() {
    let state = |time: u64, q: f64| ("/states", STATE, time, Cdr::state(0, true, &[("a", q)], &[]));
    let point =
        |time: u64, frame: &str, x: f64| ("/smr", POINT, time, Cdr::point(0, true, frame, &[x, 0.5, 0.25]));
    let second = 1_000_000_000;
    let messages =
        [state(second, 0.5), point(second, "t1", 1.0), state(2 * second, 0.75), point(2 * second, "t2", 2.0)];
    let table = of(&messages, &BagOptions::default()).expect("read");
    assert_eq!(table.rows[0].cells, ["time_s", "a", "x", "y", "z", "station"]);
    assert_eq!(table.rows[1].cells, ["0", "0.5", "1", "0.5", "0.25", "t1"]);
    assert_eq!(table.rows[2].cells, ["1", "0.75", "2", "0.5", "0.25", "t2"]);
    let said = table.remarks.join("\n");
    for words in ["by the times of the file", "frames t1, t2: each is a separate station"] {
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn what_is_no_bag_of_ros_2_is_refused_with_what_to_do() {
    let refused = |messages: &[Message<'_>], words: &[&str]| {
        let error = of(messages, &BagOptions::default()).expect_err("refused").replace("\n  │ ", " ");
        for words in words {
            assert!(error.contains(words), "{words}: {error}");
        }
    };
    refused(&[("/session", "calibrig.v1.Session", 0, vec![])], &["calibrig recording", "calibrig replay"]);
    refused(
        &[("/imu", "sensor_msgs/msg/Imu", 0, vec![])],
        &["neither joint states nor points", "/imu (sensor_msgs/msg/Imu)"],
    );
    refused(&[("/p", POINT, 0, vec![])], &["no joint states", "record it together"]);
    let state = Cdr::state(0, true, &[("a", 0.0)], &[]);
    refused(
        &[("/s", STATE, 0, state.clone()), ("/p", POINT, 0, vec![0, 1, 0])],
        &["/p, message 1: it ends after 3 bytes"],
    );
    refused(&[("/s", STATE, 0, state), ("/p", POINT, 0, vec![0, 7, 0, 0])], &["CDR of version 2"]);
    let whole = bag(mcap::WriteOptions::new(), &session());
    let error = read(&whole[..whole.len() / 2], &BagOptions::default()).expect_err("breaks off");
    assert!(error.contains("it breaks off") && error.contains("calibrig recover"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if std::env::var_os("CALIBRIG_FULL").is_some() { 20_000 } else { 300 }))]

    #[test]
    fn no_damaged_bag_panics(which in 0_usize..3, place in 0_usize..24_000, bit in 0_u32..8, cut in 0_usize..48_000) {
        let name = ["points_lz4.mcap", "poses_zstd_be.mcap", "transforms_plain.mcap"][which];
        let mut bytes = std::fs::read(fixture(name)).expect("the fixture");
        let at = place % bytes.len();
        bytes[at] ^= 1 << bit;
        bytes.truncate(cut % (2 * bytes.len()));
        let _ = read(&bytes, &BagOptions::default());
    }

    /// The container is sound: the messages are not.
    #[test]
    fn no_damaged_message_panics(step in 0_usize..44, at in 0_usize..140, value: u8, cut in 0_usize..280) {
        let mut messages = session();
        let index = step.min(messages.len() - 1);
        let data = &mut messages[index].3;
        let at = at % data.len();
        data[at] = value;
        data.truncate(cut);
        match of(&messages, &BagOptions::default()) {
            Ok(table) => prop_assert!(table.rows.iter().all(|row| row.cells.len() == table.rows[0].cells.len())),
            Err(error) => prop_assert!(!error.is_empty()),
        }
        let damaged = &messages[index].3;
        let _ = (cdr::stamp(damaged), cdr::joint_state(damaged), cdr::point(damaged), cdr::transform(damaged));
    }
}
