//! Tables against what other programs wrote, and whatever is damaged.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use calibrig_model::random::{Source as Stream, stream};
use proptest::prelude::*;
use rand::RngExt;
use rust_xlsxwriter::{ExcelDateTime, Format, Formula, Workbook};

use super::bag::{BagOptions, bag_of};
use super::sheet::parse_sheet;
use super::*;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/tables").join(name)
}

/// What `tests/tools/make_tables.py` put into its files.
const NAMES: [&str; 6] = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
const POSES: u32 = 12;

fn joint(pose: u32, number: usize) -> f64 {
    1.5 * (1.3 * f64::from(pose) + 0.7 * number as f64).sin()
}

fn place(pose: u32) -> [f64; 3] {
    let pose = f64::from(pose);
    [1.0 + 0.01 * pose, -0.5 + 0.1 * pose.cos(), 0.3 * (2.0 * pose).sin()]
}

fn numbers(row: &TableRow) -> Vec<f64> {
    row.cells.iter().map(|cell| cell.parse().unwrap_or_else(|_| panic!("{cell:?} is no number"))).collect()
}

#[track_caller]
fn assert_near(found: &[f64], expected: impl IntoIterator<Item = f64>) {
    let expected: Vec<f64> = expected.into_iter().collect();
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!(
            (found - expected).abs() <= 4.0 * f64::EPSILON * expected.abs().max(1.0),
            "{found} {expected}"
        );
    }
}

mod sheets {
    use super::*;

    fn parsed(book: &mut Workbook, sheet: Option<&str>) -> Table {
        parse_sheet(&book.save_to_buffer().expect("written"), "book.xlsx", sheet).expect("read")
    }

    fn cells(table: &Table) -> Vec<(u32, Vec<&str>)> {
        let row = |row: &TableRow| match row.place {
            TablePlace::Sheet { row, .. } => row,
            TablePlace::Message { .. } => panic!("of a sheet"),
        };
        table.rows.iter().map(|r| (row(r), r.cells.iter().map(String::as_str).collect())).collect()
    }

    #[test]
    fn a_sheet_of_openpyxl_is_read_to_the_last_digit() {
        let table = sheet::read_sheet(&fixture("points.xlsx"), None).expect("read");
        assert_eq!(table.rows[0].cells, ["measured on a Tuesday"]);
        assert_eq!(table.rows[1].cells[..3], ["Pose", "shoulder_pan", "shoulder_lift"]);
        let sheet: Arc<str> = "Points".into();
        assert_eq!(table.rows[1].place, TablePlace::Sheet { sheet, row: 4, first_column: 2 });
        for (pose, row) in (0..POSES).zip(&table.rows[2..]) {
            assert_eq!(row.cells[0], (pose + 1).to_string());
            let row = TableRow { cells: row.cells[1..10].to_vec(), ..row.clone() };
            let degrees = (0..6).map(|number| joint(pose, number).to_degrees());
            assert_near(&numbers(&row), degrees.chain(place(pose).map(|axis| 1e3 * axis)));
        }
        let said = table.remarks.join("\n");
        for words in ["sheet Points is read; the others, Notes, are not", "Points!L6: a truth value"] {
            assert!(said.contains(words), "{words}: {said}");
        }
        let notes = sheet::read_sheet(&fixture("points.xlsx"), Some("Notes")).expect("read");
        assert_eq!((notes.rows.len(), notes.remarks.len()), (1, 0));
        let error = sheet::read_sheet(&fixture("points.xlsx"), Some("Pionts")).expect_err("refused");
        assert!(error.to_string().contains("there is no sheet Pionts"), "{error}");
    }

    #[test]
    fn numbers_keep_every_bit() {
        let mut rng = stream(21, 0, Stream::Splits);
        let mut book = Workbook::new();
        let sheet = book.add_worksheet();
        let mut written = Vec::new();
        for row in 0..200 {
            let size = 10_f64.powi(rng.random_range(-12..15));
            let values: Vec<f64> = (0..5).map(|_| size * (rng.random::<f64>() - 0.5)).collect();
            for (column, value) in (0..).zip(&values) {
                sheet.write_number(row, column, *value).expect("written");
            }
            written.push(values);
        }
        let table = parsed(&mut book, None);
        for (row, values) in table.rows.iter().zip(&written) {
            let bits: Vec<u64> = numbers(row).iter().map(|value| value.to_bits()).collect();
            assert_eq!(bits, values.iter().map(|value| value.to_bits()).collect::<Vec<_>>());
        }
    }

    #[test]
    fn what_is_no_number_is_a_text_and_told_with_its_cell() {
        let mut book = Workbook::new();
        book.add_worksheet().set_name("Log").expect("named");
        let sheet = book.add_worksheet().set_name("Run 2").expect("named");
        let date = Format::new().set_num_format("yyyy-mm-dd");
        let day = ExcelDateTime::parse_from_str("2026-11-29").expect("a day");
        sheet.write_string(0, 0, "X\n[mm]").expect("written");
        sheet.write_datetime_with_format(1, 0, &day, &date).expect("written");
        sheet.write_boolean(2, 0, true).expect("written");
        sheet.write_boolean(3, 0, false).expect("written");
        sheet.write_formula(4, 0, Formula::new("=1/0").set_result("#DIV/0!")).expect("written");
        sheet.write_formula(5, 0, Formula::new("=1+1").set_result("2")).expect("written");
        sheet.write_string(6, 1, "  ").expect("written");
        let table = parsed(&mut book, Some("Run 2"));
        let read = cells(&table);
        assert_eq!(read[0], (1, vec!["X [mm]"]));
        assert_eq!(read[1], (2, vec!["2026-11-29 00:00:00.000"]));
        assert_eq!((&read[2].1, &read[3].1), (&vec!["TRUE"], &vec!["FALSE"]));
        assert_eq!(read[5], (6, vec!["2"]));
        assert_eq!(read.len(), 6, "blanks are nothing");
        let said = table.remarks.join("\n");
        for words in ["Run 2!A2: a date", "Run 2!A3 and 1 cell more: a truth value"] {
            assert!(said.contains(words), "{words}: {said}");
        }
    }

    #[test]
    fn merged_cells_hold_down_their_column_and_not_across() {
        let mut book = Workbook::new();
        let sheet = book.add_worksheet();
        let plain = Format::new();
        sheet.merge_range(0, 0, 1, 0, "Pose", &plain).expect("merged");
        sheet.merge_range(0, 1, 0, 3, "Position", &plain).expect("merged");
        for (column, name) in (1..).zip(["x", "y", "z"]) {
            sheet.write_string(1, column, name).expect("written");
        }
        sheet.merge_range(2, 0, 3, 0, "P1", &plain).expect("merged");
        for row in 2..4 {
            for column in 1..4 {
                sheet.write_number(row, column, f64::from(row)).expect("written");
            }
        }
        let table = parsed(&mut book, None);
        let read = cells(&table);
        assert_eq!(read[0].1, ["Pose", "Position"]);
        assert_eq!(read[1].1, ["Pose", "x", "y", "z"]);
        assert_eq!(read[3].1, ["P1", "3", "3", "3"]);
        let said = table.remarks.join("\n");
        assert!(said.contains("Sheet1!B1:D1: merged cells"), "{said}");
    }

    /// A spreadsheet by hand: parts of a ZIP archive that are not compressed.
    fn zip(parts: &[(&str, &[u8])]) -> Vec<u8> {
        let (mut bytes, mut directory) = (Vec::new(), Vec::new());
        for (name, content) in parts {
            let at = u32::try_from(bytes.len()).expect("small");
            let size = u32::try_from(content.len()).expect("small").to_le_bytes();
            let length = u16::try_from(name.len()).expect("short").to_le_bytes();
            let middle = [
                &[20, 0, 0, 0, 0, 0, 0, 0, 0x21, 0][..],
                &crc32fast::hash(content).to_le_bytes(),
                &size,
                &size,
                &length,
                &[0; 2],
            ];
            bytes.extend([b"PK\x03\x04", middle.concat().as_slice(), name.as_bytes(), content].concat());
            directory.extend(
                [
                    b"PK\x01\x02\x14\0",
                    middle.concat().as_slice(),
                    &[0; 10],
                    &at.to_le_bytes(),
                    name.as_bytes(),
                ]
                .concat(),
            );
        }
        let count = u16::try_from(parts.len()).expect("few").to_le_bytes();
        let (start, size) =
            (u32::try_from(bytes.len()).expect("small"), u32::try_from(directory.len()).expect("small"));
        bytes.extend(directory);
        bytes.extend(
            [
                b"PK\x05\x06\0\0\0\0",
                count.as_slice(),
                &count,
                &size.to_le_bytes(),
                &start.to_le_bytes(),
                &[0, 0],
            ]
            .concat(),
        );
        bytes
    }

    const TYPES: &str = r#"<?xml version="1.0"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="xml" ContentType="application/xml"/></Types>"#;
    const RELATIONS: &str = r#"<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="rId1" Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet" Target="worksheets/sheet1.xml"/></Relationships>"#;
    const PARTS: &str = r#"<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="rId1" Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/officeDocument" Target="xl/workbook.xml"/></Relationships>"#;
    const BOOK: &str = r#"<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships"><sheets><sheet name="S" sheetId="1" r:id="rId1"/></sheets></workbook>"#;
    const SHEET: &str = r#"<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><dimension ref="A1:D9"/><sheetData><row r="1"><c r="A1" t="inlineStr"><is><t>x</t></is></c><c r="B1" t="str"><v>y</v></c></row><row r="3"><c r="A3"><v>0.1</v></c><c r="B3"><f>A3*2</f></c><c r="C3" t="b"><v>1</v></c><c r="D3" t="e"><v>#N/A</v></c></row></sheetData><mergeCells count="1"><mergeCell ref="A3:A4"/></mergeCells></worksheet>"#;

    fn by_hand(book: &[u8], sheet: &[u8]) -> Vec<u8> {
        zip(&[
            ("[Content_Types].xml", TYPES.as_bytes()),
            ("_rels/.rels", PARTS.as_bytes()),
            ("xl/workbook.xml", book),
            ("xl/_rels/workbook.xml.rels", RELATIONS.as_bytes()),
            ("xl/worksheets/sheet1.xml", sheet),
        ])
    }

    #[test]
    fn a_formula_without_its_value_is_not_taken_for_an_empty_cell() {
        let table = parse_sheet(&by_hand(BOOK.as_bytes(), SHEET.as_bytes()), "b.xlsx", None).expect("read");
        assert_eq!(
            cells(&table),
            [(1, vec!["x", "y"]), (3, vec!["0.1", "formula without value", "TRUE", "#N/A"])]
        );
        let said = table.remarks.join("\n");
        assert!(
            said.contains("S!B3: a formula without its value") && said.contains("S!D3: an error"),
            "{said}"
        );
    }

    #[test]
    fn what_is_no_spreadsheet_is_refused_with_what_to_do() {
        let zipped = zip(&[("a.txt", b"hello")]);
        for bytes in [
            &b""[..],
            b"PK\x03\x04",
            b"x,y\n1,2\n",
            &zipped,
            &[0xd0, 0xcf, 0x11, 0xe0, 0xa1, 0xb1, 0x1a, 0xe1],
        ] {
            let error = parse_sheet(bytes, "b.xlsx", None).expect_err("refused");
            assert!(error.contains("save"), "{error}");
        }
        // A cell where no sheet has one, and a range that a sheet cannot hold.
        let far = SHEET.replace("A3", "XFD1048576").replace("B3", "ZZZZZ99999999");
        assert!(parse_sheet(&by_hand(BOOK.as_bytes(), far.as_bytes()), "b.xlsx", None).is_err());
        let error = sheet::read_sheet(Path::new("no/such.xlsx"), None).expect_err("refused");
        assert!(error.to_string().contains("no/such.xlsx"), "{error}");
    }

    fn book() -> Vec<u8> {
        std::fs::read(fixture("points.xlsx")).expect("the fixture")
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(if std::env::var_os("CALIBRIG_FULL").is_some() { 20_000 } else { 400 }))]

        #[test]
        fn no_damaged_file_panics(bit in 0_usize..8 * 6900, cut in 0_usize..14_000) {
            let mut bytes = book();
            bytes[bit / 8] ^= 1 << (bit % 8);
            bytes.truncate(cut);
            let _ = parse_sheet(&bytes, "b.xlsx", None);
        }

        /// The archive is sound: what is in it is not.
        #[test]
        fn no_nonsense_in_a_sound_archive_panics(
            at in 0_usize..700, remove in 0_usize..30, insert in "\\PC{0,4}|[<>/\"=:A-Z0-9]{0,8}|99999999999|-1|NaN", of_book: bool,
        ) {
            let text = if of_book { BOOK } else { SHEET };
            let mut text: Vec<char> = text.chars().collect();
            let at = at.min(text.len());
            text.splice(at..(at + remove).min(text.len()), insert.chars());
            let text: String = text.into_iter().collect();
            let (book, sheet) = if of_book { (text.as_str(), SHEET) } else { (BOOK, text.as_str()) };
            if let Ok(table) = parse_sheet(&by_hand(book.as_bytes(), sheet.as_bytes()), "b.xlsx", None) {
                prop_assert!(table.rows.iter().all(|row| !row.cells.is_empty()));
            }
        }
    }
}

mod bags {
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
            let header = mcap::records::MessageHeader {
                channel_id,
                sequence: 0,
                log_time: *time,
                publish_time: *time,
            };
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
                messages.push((
                    "/smr",
                    POINT,
                    2,
                    Cdr::point(stamp + 2 * MS, true, "tracker", &[pose, 1.0, 2.0]),
                ));
            }
        }
        messages
    }

    #[test]
    fn bags_of_another_program_are_read_to_the_last_digit() {
        let options = BagOptions { names: NAMES.map(str::to_owned).to_vec(), ..BagOptions::default() };
        for name in ["points_lz4.mcap", "poses_zstd_be.mcap", "transforms_plain.mcap"] {
            let table =
                bag::read_bag(&fixture(name), &options).unwrap_or_else(|error| panic!("{name}: {error}"));
            let header = ["time_s"].into_iter().chain(NAMES).chain(["x", "y", "z"]);
            assert_eq!(table.rows[0].cells, header.collect::<Vec<_>>());
            assert_eq!(table.rows.len(), 1 + POSES as usize, "{name}");
            for (pose, row) in (0..POSES).zip(&table.rows[1..]) {
                let joints = (0..6).map(|number| joint(pose, number));
                let expected = std::iter::once(2.0 * f64::from(pose)).chain(joints).chain(place(pose));
                assert_near(&numbers(row), expected);
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
            assert_eq!(said.contains("the orientation is not"), name != "points_lz4.mcap", "{said}");
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

    #[test]
    fn topics_are_told_apart_or_asked_for() {
        let mut messages = session();
        let second = Cdr::point(5_050 * MS, false, "tracker", &[7.0, 8.0, 9.0]);
        messages.push(("/smr2", POINT, 1, second));
        let error = of(&messages, &BagOptions::default()).expect_err("refused");
        for words in ["several topics have points", "/smr ", "/smr2 ", "1 message)", "--bag-points"] {
            assert!(error.contains(words), "{words}: {error}");
        }
        let both =
            BagOptions { points: vec!["/smr".to_owned(), "/smr2".to_owned()], ..BagOptions::default() };
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
        assert!(error.contains("no joint called J1") && error.contains("b, a"), "{error}");
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
            "1 point dropped, no numbers: /smr, message 6",
        ] {
            assert!(said.contains(words), "{words}: {said}");
        }
        let strict = BagOptions { tolerance_s: 1e-3, ..BagOptions::default() };
        let error = of(&messages, &strict).expect_err("none is so near");
        for words in ["none of 5 points", "within 1 ms", "from 5.052 s to 9.000 s", "from 5.000 s to 5.390 s"]
        {
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
        let point = |time: u64, frame: &str, x: f64| {
            ("/smr", POINT, time, Cdr::point(0, true, frame, &[x, 0.5, 0.25]))
        };
        let second = 1_000_000_000;
        let messages = [
            state(second, 0.5),
            point(second, "t1", 1.0),
            state(2 * second, 0.75),
            point(2 * second, "t2", 2.0),
        ];
        let table = of(&messages, &BagOptions::default()).expect("read");
        assert_eq!(table.rows[0].cells, ["time_s", "a", "x", "y", "z", "station"]);
        assert_eq!(table.rows[1].cells, ["0", "0.5", "1", "0.5", "0.25", "t1"]);
        assert_eq!(table.rows[2].cells, ["1", "0.75", "2", "0.5", "0.25", "t2"]);
        let said = table.remarks.join("\n");
        for words in ["by the times of the file", "frames t1, t2: each is a station"] {
            assert!(said.contains(words), "{words}: {said}");
        }
    }

    #[test]
    fn what_is_no_bag_of_ros_2_is_refused_with_what_to_do() {
        let refused = |messages: &[Message<'_>], words: &[&str]| {
            let error = of(messages, &BagOptions::default()).expect_err("refused").replace("\n  │ ", " ");
            words.iter().for_each(|words| assert!(error.contains(words), "{words}: {error}"));
        };
        refused(
            &[("/session", "calibrig.v1.Session", 0, vec![])],
            &["calibrig recording", "calibrig replay"],
        );
        refused(
            &[("/imu", "sensor_msgs/msg/Imu", 0, vec![])],
            &["no states of joints", "/imu (sensor_msgs/msg/Imu)"],
        );
        refused(&[("/p", POINT, 0, vec![])], &["no states of joints", "record it together"]);
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
        fn no_damaged_bag_panics(which in 0_usize..3, place in 0.0..1.0_f64, bit in 0_u32..8, cut in 0.0..2.0_f64) {
            let name = ["points_lz4.mcap", "poses_zstd_be.mcap", "transforms_plain.mcap"][which];
            let mut bytes = std::fs::read(fixture(name)).expect("the fixture");
            let at = (place * bytes.len() as f64) as usize;
            bytes[at] ^= 1 << bit;
            bytes.truncate((cut * bytes.len() as f64) as usize);
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
}
