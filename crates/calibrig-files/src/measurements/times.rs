//! Times as programs write them.

use super::layout::Decimal;
use super::rows::Row;
use crate::input::InputError;

/// Seconds of a cell: a number, `12:03:44.12`, or a date and a time by ISO 8601 (`2026-05-04T12:03:44.12Z`), counted from 1970.
pub(super) fn parse(text: &str, decimal: Decimal) -> Option<f64> {
    if let Some(number) = decimal.parse(text) {
        return number.is_finite().then_some(number);
    }
    if let Some(seconds) = clock(text) {
        return Some(seconds);
    }
    let (date, time) = text.split_once(['T', ' '])?;
    let time = time.trim();
    let (time, ahead) = match time.strip_suffix('Z') {
        Some(time) => (time, 0.0),
        None => zone(time)?,
    };
    Some(86_400.0 * day(date)? + clock(time)? - ahead)
}

/// A time of the day without its zone, and how far that is ahead of UTC, s.
fn zone(time: &str) -> Option<(&str, f64)> {
    let Some(at) = time.rfind(['+', '-']) else { return Some((time, 0.0)) };
    let sign = if time[at..].starts_with('-') { -1.0 } else { 1.0 };
    let digits = time[at + 1..].replace(':', "");
    let (hours, minutes) = digits.split_at_checked(2)?;
    let minutes: f64 = if minutes.is_empty() { 0.0 } else { minutes.parse().ok()? };
    Some((&time[..at], sign * (3600.0 * hours.parse::<f64>().ok()? + 60.0 * minutes)))
}

/// `h:mm:ss` or `h:mm`, seconds with a point or a comma.
fn clock(text: &str) -> Option<f64> {
    let mut parts = text.trim().split(':');
    let (hours, minutes) = (parts.next()?, parts.next()?);
    let seconds = parts.next().unwrap_or("0").replace(',', ".");
    let whole = |text: &str| text.parse::<u32>().ok().map(f64::from);
    let (hours, minutes, seconds) = (whole(hours)?, whole(minutes)?, seconds.parse::<f64>().ok()?);
    let is_time = parts.next().is_none() && minutes < 60.0 && (0.0..61.0).contains(&seconds);
    is_time.then_some(3600.0 * hours + 60.0 * minutes + seconds)
}

/// Days from 1970 of `yyyy-mm-dd`.
fn day(text: &str) -> Option<f64> {
    let mut parts = text.split('-').map(|part| part.parse::<i32>().ok());
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    if parts.next().is_some()
        || !(1600..=9999).contains(&year)
        || !(1..=12).contains(&month)
        || !(1..=31).contains(&day)
    {
        return None;
    }
    // March begins the year, so that the day of a leap year is its last.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let days = 365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day - 1;
    Some(f64::from(days - 719_468))
}

pub(super) fn of_cell(file: &str, row: &Row, column: usize, decimal: Decimal) -> Result<f64, InputError> {
    let cell = row.cell(column).unwrap_or_default();
    parse(cell, decimal).ok_or_else(|| {
        let expected =
            "seconds, a time such as 12:03:44.12, or a date and a time such as 2026-05-04T12:03:44.12";
        row.refuse(file, Some(column), format!("the time is {cell:?}"), expected)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_as_programs_write_them() {
        for (text, expected) in [
            ("12.5", Some(12.5)),
            ("12:03:44.125", Some(43_424.125)),
            ("0:10", Some(600.0)),
            ("1970-01-02T00:00:01Z", Some(86_401.0)),
            ("2000-03-01 00:00:00", Some(951_868_800.0)),
            ("2024-02-29T12:00:00+02:00", Some(1_709_200_800.0)),
            ("2026-05-04 12:03:44,5", Some(1_777_896_224.5)),
            ("12:60:00", None),
            ("04.05.2026 12:00:00", None),
            ("noon", None),
            ("2024-13-01T00:00:00", None),
            ("2024-01-01T00:00:00+1", None),
            ("NaN", None),
        ] {
            assert_eq!(parse(text, Decimal::Point), expected, "{text}");
        }
    }
}
