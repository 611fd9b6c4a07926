//! Times as programs write them.

use super::stamp::{Kind, Unread, parse};
use super::*;
use crate::Source;
use crate::measurements::{
    MeasurementFiles, PointsFile, RowOptions, parse_column_map, parse_measurements, read_files,
};
use calibrig_model::JointKind;

fn read(text: &str, order: Option<DateOrder>) -> Result<(f64, Kind), Unread> {
    parse(text, Decimal::Point, TimeUnit::S, order).map(|stamp| (stamp.seconds, stamp.kind))
}

#[test]
fn times_are_read_as_programs_write_them() {
    let moment = 1_777_889_730.0; // `date -u -d '2026-05-04 10:15:30' +%s`
    let (no, clock, zone) = (Err(Unread::NoTime), Kind::Clock, Kind::MomentInZone);
    for (text, expected) in [
        ("12.5", Ok((12.5, Kind::Number))),
        ("12:03:44.125", Ok((43_424.125, clock))),
        ("12:03:44:125", Ok((43_424.125, clock))),
        ("0:10", Ok((600.0, clock))),
        ("12:03:44 am", Ok((224.0, clock))),
        ("1:03:44 P.M.", Ok((47_024.0, clock))),
        ("10:15:30 Uhr", Ok((36_930.0, clock))),
        ("1970-01-02T00:00:01Z", Ok((86_401.0, zone))),
        ("2000-03-01 00:00:00", Ok((951_868_800.0, Kind::Moment))),
        ("2024-02-29T12:00:00+02:00", Ok((1_709_200_800.0, zone))),
        ("2026-05-04 12:03:44,5", Ok((1_777_896_224.5, Kind::Moment))),
        ("2026-05-04T10:15:30.25-0330", Ok((moment + 12_600.25, zone))),
        ("20260504T101530.5Z", Ok((moment + 0.5, zone))),
        ("2026-05-04", Ok((moment - 36_930.0, Kind::Day))),
        ("13:00:00 PM", no),
        ("12:60:00", no),
        ("31.04.2026 12:00:00", no),
        ("29.02.2025 12:00:00", no),
        ("noon", no),
        ("2024-13-01T00:00:00", no),
        ("2024-01-01T00:00:00+1", no),
        ("NaN", no),
        ("1:2:3:4:5", no),
        ("é:10", no),
        ("", no),
    ] {
        assert_eq!(read(text, None), expected, "{text}");
    }
    for text in [
        "04.05.2026 10:15:30",
        "4.5.26 10:15:30",
        "04.05.2026, 10:15:30",
        "2026-05-04T10:15:30",
        "2026/05/04 10:15:30",
        "2026-05-04_10:15:30",
        "20260504T101530",
        "04-May-2026 10:15:30",
        "4. Mai 2026 10:15:30",
        "May 4, 2026 10:15:30 AM",
        "2026 May 4 10:15:30",
    ] {
        assert_eq!(read(text, None), Ok((moment, Kind::Moment)), "{text}");
    }
}

#[test]
fn a_date_that_can_be_two_is_not_read() {
    let moment = Ok((1_777_889_730.0, Kind::Moment));
    for (text, order) in [
        ("04/05/2026 10:15:30", DateOrder::Dmy),
        ("5/4/2026 10:15:30 AM", DateOrder::Mdy),
        ("05-04-26 10:15:30", DateOrder::Mdy),
        ("26/05/04 10:15:30", DateOrder::Ymd),
    ] {
        assert_eq!(read(text, None), Err(Unread::Ambiguous), "{text}");
        assert_eq!(read(text, Some(order)), moment, "{text}");
    }
    // Of these there is one.
    for text in ["14/05/2026 10:15:30", "05/14/2026 10:15:30", "5-14-2026 10:15:30 AM"] {
        assert_eq!(read(text, None), Ok((1_778_753_730.0, Kind::Moment)), "{text}");
    }
}

#[test]
fn one_date_tells_how_all_are_written() {
    let line = Place::Line(7);
    let seen = |cells: &[&str]| Dates::seen(cells.iter().map(|cell| (&line, *cell)));
    let dates = seen(&["P-1/2", "04/05/2026 10:15", "13/05/2026 10:15"]);
    assert_eq!(dates.order, Some(DateOrder::Dmy));
    assert!(
        dates.why.is_some_and(|why| why == "dates are day, month, year, as 13/05/2026 10:15 (line 7) shows")
    );
    assert_eq!(seen(&["05/13/2026"]).order, Some(DateOrder::Mdy));
    let american = seen(&["04/05/2026 10:15 PM"]);
    assert_eq!(american.order, Some(DateOrder::Mdy));
    assert!(american.why.is_some_and(|why| why.contains("AM or PM") && why.contains("date = \"dmy\"")));
    assert_eq!(seen(&["04/05/2026 10:15", "2026-05-04", "-1.5/2"]), Dates::default());
}

#[test]
fn times_are_read_in_the_way_of_the_file_and_what_is_odd_is_told() {
    let map = |more: &str| {
        let text = format!(
            "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\nrevolute_unit = \"rad\"\nprismatic_unit = \"m\"\n\
             [position]\nsystem = \"cartesian\"\nunit = \"m\"\nx = \"x\"\ny = \"y\"\nz = \"z\"\n{more}"
        );
        parse_column_map(&Source::new("map.toml", text)).expect("a map")
    };
    let read = |cells: &[&str], head: &str, more: &str| {
        let rows = cells.iter().map(|cell| format!("{cell};0;0;1;2;3\n"));
        let text = format!("{head};s;t;x;y;z\n{}", rows.collect::<String>());
        parse_measurements(
            &Source::new("m.csv", text),
            &map(more),
            &[JointKind::Prismatic, JointKind::Revolute],
        )
    };
    let seconds = |cells: &[&str], head: &str, more: &str| {
        let loaded = read(cells, head, more).unwrap_or_else(|error| panic!("{cells:?}: {error}"));
        let times: Vec<f64> = loaded.set.observations.iter().map(|o| o.time).collect();
        (times, loaded.remarks.join("\n"))
    };
    let refused = |cells: &[&str], head: &str, more: &str| {
        let error = read(cells, head, more).expect_err("refused");
        format!(
            "{error} {}",
            miette::Diagnostic::help(&error).map_or_else(String::new, |help| help.to_string())
        )
    };
    let clock = "[columns]\ntime_s = \"clock\"\n";
    let (may, june) = (1_777_889_730.0, 1_780_568_130.0);
    assert_eq!(
        seconds(&["04.05.2026 10:15:30", "04.06.2026 10:15:30,5"], "clock", clock).0,
        [may, june + 0.5]
    );
    // One date that can be read one way only tells all.
    let (times, told) = seconds(&["04/05/2026 10:15:30", "13/05/2026 10:15:30"], "clock", clock);
    assert_eq!(times, [may, may + 9.0 * 86_400.0]);
    assert!(told.contains("dates are day, month, year, as 13/05/2026 10:15:30 (line 3) shows"), "{told}");
    let (times, told) = seconds(&["05/04/2026 10:15:30 AM"], "clock", clock);
    assert!(times == [may] && told.contains("since the time has AM or PM"), "{told}");
    let found = refused(&["05/04/2026 10:15:30"], "clock", clock);
    assert!(
        found.contains("m.csv:2")
            && found.contains("day and month cannot be told apart")
            && found.contains("date = \"dmy\""),
        "{found}"
    );
    assert_eq!(
        seconds(&["05/04/2026 10:15:30"], "clock", &format!("{clock}[text]\ndate = \"mdy\"\n")).0,
        [may]
    );
    // A date and a time in columns of their own.
    let both = "[columns]\ntime_s = [\"day\", \"clock\"]\n";
    assert_eq!(
        seconds(&["04.05.2026;10:15:30", "2026-05-04;10:15:31 AM"], "day;clock", both).0,
        [may, may + 1.0]
    );
    let found = refused(&["04.05.2026;9"], "day;clock", both);
    assert!(found.contains("are not a time"), "{found}");
    let found = refused(&["04.05.2026"], "clock", clock);
    assert!(found.contains("a date without a time of the day"), "{found}");
    // Kinds are not mixed, and what runs backwards is told.
    let found = refused(&["10:15:30", "2026-05-04 10:15:30"], "clock", clock);
    assert!(
        found.contains("m.csv:3") && found.contains("in the rows before a time of the day without a date"),
        "{found}"
    );
    let (_, told) = seconds(&["23:59:59", "0:00:01", "0:00:02"], "clock", clock);
    assert!(
        told.contains("m.csv:3: the time runs backwards: 1 row is earlier") && told.contains("midnight"),
        "{told}"
    );
    // Units of the key and of the header.
    assert_eq!(seconds(&["1500"], "clock", "[columns]\ntime_ms = \"clock\"\n").0, [1.5]);
    assert_eq!(seconds(&["1500"], "clock [ms]", "[columns]\ntime_ms = \"clock\"\n").0, [1.5]);
    let found = refused(&["1500"], "clock [ms]", clock);
    assert!(
        found.contains("in ms according to the header, but in s according to the column map (time_s)")
            && found.contains("time_ms in place"),
        "{found}"
    );
    assert_eq!(seconds(&["1500"], "clock [ms]", "[columns]\ntime_s = 1\n").0, [1500.0]);
    let (times, told) = seconds(
        &["7;500000000"],
        "stamp.sec;stamp.nanosec",
        "[columns]\ntime_s = [\"stamp.sec\", \"stamp.nanosec\"]\n",
    );
    assert!(times == [7.5] && told.contains("stamp.nanosec in ns, as its name says"), "{told}");
}

#[test]
fn files_joined_by_time_have_times_of_one_kind() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let points =
        write("points.csv", "Date;Time;x;y;z\n04.05.2026;10:15:30;1;2;3\n04.05.2026;10:16:30;1;2;4\n");
    let map = parse_column_map(&Source::new(
        "map.toml",
        "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\nrevolute_unit = \"rad\"\nprismatic_unit = \"m\"\n\
         [position]\nsystem = \"cartesian\"\nunit = \"m\"\nx = \"x\"\ny = \"y\"\nz = \"z\"\n\
         [join]\nby = \"time\"\njoints = \"stamp\"\npoints = [\"Date\", \"Time\"]\nwithin_s = 1\n",
    ))
    .expect("a map");
    let read = |joints: &str| {
        let files = MeasurementFiles {
            points: vec![PointsFile { target: None, path: points.clone() }],
            joints: Some(write("joints.csv", joints)),
        };
        read_files(&files, &map, &[JointKind::Prismatic, JointKind::Revolute], &RowOptions::default())
    };
    let loaded =
        read("stamp,s,t\n2026-05-04T10:16:30.2Z,0.2,2\n2026-05-04T10:15:30.4Z,0.1,1\n").expect("joined");
    let commands: Vec<f64> = loaded.set.observations.iter().map(|o| o.command[1]).collect();
    assert_eq!(commands, [1.0, 2.0]);
    assert!(
        loaded.remarks.iter().any(|told| told.contains("without a time zone they are taken as UTC")),
        "{:?}",
        loaded.remarks
    );
    let refused = read("stamp,s,t\n10:16:30,0.2,2\n").expect_err("no dates").to_string();
    assert!(
        refused.contains("points.csv:2") && refused.contains("it is a time of the day without a date"),
        "{refused}"
    );
}
