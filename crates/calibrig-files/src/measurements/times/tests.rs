//! Times as programs write them.

use super::stamp::{Kind, Unread, parse};
use super::*;

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
        ("04/05/2026 10:15:30", DateOrder::DayFirst),
        ("5/4/2026 10:15:30 AM", DateOrder::MonthFirst),
        ("05-04-26 10:15:30", DateOrder::MonthFirst),
        ("26/05/04 10:15:30", DateOrder::YearFirst),
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
    assert_eq!(dates.order, Some(DateOrder::DayFirst));
    assert!(
        dates.why.is_some_and(|why| why == "dates are day, month, year, as 13/05/2026 10:15 (line 7) tells")
    );
    assert_eq!(seen(&["05/13/2026"]).order, Some(DateOrder::MonthFirst));
    let american = seen(&["04/05/2026 10:15 PM"]);
    assert_eq!(american.order, Some(DateOrder::MonthFirst));
    assert!(american.why.is_some_and(|why| why.contains("AM or PM") && why.contains("date = \"dmy\"")));
    assert_eq!(seen(&["04/05/2026 10:15", "2026-05-04", "-1.5/2"]), Dates::default());
}
