//! One time as a program writes it.

use super::super::layout::Decimal;
use super::super::units::TimeUnit;

/// Which number of a date comes first, if that is ambiguous: `04/05/2026`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum DateOrder {
    /// Day, month, year.
    Dmy,
    Mdy,
    Ymd,
}

/// The time that a text states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in super::super) struct Stamp {
    /// Since the start of the day, or since the start of 1970 if there is a date.
    pub seconds: f64,
    pub kind: Kind,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum Kind {
    Number,
    Clock,
    /// A date alone.
    Day,
    Moment,
    MomentInZone,
}

impl Kind {
    /// Whether times of both count from the same moment, as far as is known.
    pub fn is_comparable_with(self, other: Self) -> bool {
        // Numbers may count from any moment.
        let has_date = |kind| matches!(kind, Self::Moment | Self::MomentInZone);
        has_date(self) == has_date(other) || self == Self::Number || other == Self::Number
    }

    pub fn words(self) -> &'static str {
        match self {
            Self::Number => "a number of seconds",
            Self::Clock => "a time of the day without a date",
            Self::Day => "a date without a time of the day",
            Self::Moment => "a date and a time without a zone",
            Self::MomentInZone => "a date and a time with a zone",
        }
    }
}

/// Why a text is not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum Unread {
    NoTime,
    /// Day and month cannot be told apart.
    Ambiguous,
}

/// Reads a number (of `unit`), a time of the day (`12:03:44.12`, `1:03:44 PM`), a date, or both: by ISO 8601 (`2026-05-04T12:03:44Z`, `20260504T120344`),
/// with points (`04.05.2026`: day, month, year), with the name of the month (`4-May-2026`), or by `order`.
pub(in super::super) fn parse(
    text: &str,
    decimal: Decimal,
    unit: TimeUnit,
    order: Option<DateOrder>,
) -> Result<Stamp, Unread> {
    if let Some(number) = decimal.parse(text) {
        let seconds = unit.in_si(number);
        return if seconds.is_finite() {
            Ok(Stamp { seconds, kind: Kind::Number })
        } else {
            Err(Unread::NoTime)
        };
    }
    let text = text.trim();
    let (date, time) = match text.find(':') {
        // The hour stands in front of the first colon.
        Some(colon) => text.split_at(text[..colon].trim_end_matches(|c: char| c.is_ascii_digit()).len()),
        None => match text.split_once('T').filter(|(date, _)| date.len() == 8) {
            Some((date, time)) => (date, time),
            None => (text, ""),
        },
    };
    if time.is_empty() {
        return Ok(Stamp { seconds: 86_400.0 * day(date, order)?, kind: Kind::Day });
    }
    let Clock { seconds, ahead } = clock(time).ok_or(Unread::NoTime)?;
    let date = date.trim_end();
    let date = match date.strip_suffix(['T', 't']) {
        Some(date) if date.ends_with(|c: char| c.is_ascii_digit()) => date,
        _ => date.trim_end_matches([',', '_', '-', ' ']),
    };
    let seconds = seconds - ahead.unwrap_or(0.0);
    if date.is_empty() {
        return Ok(Stamp { seconds, kind: Kind::Clock });
    }
    let kind = if ahead.is_some() { Kind::MomentInZone } else { Kind::Moment };
    Ok(Stamp { seconds: 86_400.0 * day(date, order)? + seconds, kind })
}

struct Clock {
    seconds: f64,
    /// Of UTC, s, where it is stated.
    ahead: Option<f64>,
}

/// `h:mm:ss` or `h:mm`, seconds with a point or a comma, thousandths also after a third colon; `hhmmss`; then AM or PM, and a zone.
fn clock(text: &str) -> Option<Clock> {
    let (text, ahead) = zone(text.trim())?;
    let text = text.trim_end().trim_end_matches("Uhr").trim_end();
    let (text, afternoon) = half_of_day(text);
    let basic;
    let text = if text.contains(':') {
        text
    } else {
        let (digits, fraction) = text.split_at_checked(6)?;
        basic = format!("{}:{}:{}{fraction}", &digits.get(..2)?, digits.get(2..4)?, digits.get(4..)?);
        &basic
    };
    let mut parts = text.split(':');
    let (hours, minutes) = (parts.next()?, parts.next()?);
    let seconds = parts.next().unwrap_or("0").replace(',', ".");
    let thousandths = match parts.next() {
        Some(text) if text.len() == 3 && !seconds.contains('.') => whole(text)?,
        Some(_) => return None,
        None => 0.0,
    };
    let (hours, minutes, seconds) = (whole(hours)?, whole(minutes)?, seconds.trim().parse::<f64>().ok()?);
    let hours = match afternoon {
        None => hours,
        Some(_) if !(1.0..=12.0).contains(&hours) => return None,
        Some(afternoon) => hours % 12.0 + if afternoon { 12.0 } else { 0.0 },
    };
    let is_time = parts.next().is_none() && minutes < 60.0 && (0.0..61.0).contains(&seconds);
    is_time
        .then_some(Clock { seconds: 3600.0 * hours + 60.0 * minutes + seconds + 1e-3 * thousandths, ahead })
}

fn whole(text: &str) -> Option<f64> {
    let text = text.trim();
    text.bytes().all(|byte| byte.is_ascii_digit()).then(|| text.parse::<u32>().ok().map(f64::from))?
}

/// A time of the day without AM or PM, and whether it is PM.
fn half_of_day(text: &str) -> (&str, Option<bool>) {
    for (mark, afternoon) in [("am", false), ("pm", true), ("a.m.", false), ("p.m.", true)] {
        if let Some(at) = text.len().checked_sub(mark.len())
            && text.get(at..).is_some_and(|end| end.eq_ignore_ascii_case(mark))
        {
            return (text[..at].trim_end(), Some(afternoon));
        }
    }
    (text, None)
}

/// A time of the day without its zone, and how far that is ahead of UTC, s.
fn zone(time: &str) -> Option<(&str, Option<f64>)> {
    for mark in ["Z", "z", "UTC", "GMT"] {
        if let Some(time) = time.strip_suffix(mark) {
            return Some((time.trim_end(), Some(0.0)));
        }
    }
    let Some(at) = time.rfind(['+', '-']) else { return Some((time, None)) };
    let sign = if time[at..].starts_with('-') { -1.0 } else { 1.0 };
    let digits = time[at + 1..].replace(':', "");
    let (hours, minutes) = digits.split_at_checked(2)?;
    let minutes = if minutes.is_empty() { 0.0 } else { whole(minutes)? };
    Some((&time[..at], Some(sign * (3600.0 * whole(hours)? + 60.0 * minutes))))
}

/// Days from 1970 of a date.
fn day(text: &str, order: Option<DateOrder>) -> Result<f64, Unread> {
    let [year, month, day] = year_month_day(text, order)?;
    if !(1600..=9999).contains(&year) || !(1..=12).contains(&month) || day < 1 || day > length(year, month) {
        return Err(Unread::NoTime);
    }
    // March begins the year, so that the day of a leap year is its last.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let days = 365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day - 1;
    Ok(f64::from(days - 719_468))
}

fn length(year: i32, month: i32) -> i32 {
    match month {
        2 if year % 4 == 0 && (year % 100 != 0 || year % 400 == 0) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

fn year_month_day(text: &str, order: Option<DateOrder>) -> Result<[i32; 3], Unread> {
    let is_sign = |c: char| matches!(c, '-' | '.' | '/' | ',' | ' ');
    let mut parts: Vec<&str> = text.split(is_sign).filter(|part| !part.is_empty()).collect();
    if let [whole] = parts.as_slice()
        && whole.len() == 8
        && whole.is_ascii()
    {
        parts = vec![&whole[..4], &whole[4..6], &whole[6..]];
    }
    let [a, b, c] = parts[..] else { return Err(Unread::NoTime) };
    let number = |part: &str| {
        let is_one = (1..=4).contains(&part.len()) && part.bytes().all(|byte| byte.is_ascii_digit());
        is_one.then(|| part.parse::<i32>().ok())?
    };
    let of = |[year, month, day]: [Option<i32>; 3]| Ok([year, month, day].map(|part| part.unwrap_or(-1)));
    let year = |part: &str| match part.len() {
        4 => number(part),
        // Years of this century, as instruments write them.
        2 => number(part).map(|year| 2000 + year),
        _ => None,
    };
    if let Some(month) = month_named(b) {
        let (year, day) = if a.len() == 4 { (year(a), number(c)) } else { (year(c), number(a)) };
        return of([year, Some(month), day]);
    }
    if let Some(month) = month_named(a) {
        return of([year(c), Some(month), number(b)]);
    }
    if a.len() == 4 {
        return of([number(a), number(b), number(c)]);
    }
    let (day_first, month_first) = ([year(c), number(b), number(a)], [year(c), number(a), number(b)]);
    match order {
        _ if text.contains('.') => of(day_first),
        Some(DateOrder::Dmy) => of(day_first),
        Some(DateOrder::Mdy) => of(month_first),
        Some(DateOrder::Ymd) => of([year(a), number(b), number(c)]),
        // Of two numbers up to 12 each can be the month; of years with two digits each can be anything.
        None => match (number(a), number(b)) {
            (Some(13..=31), Some(..=12)) if c.len() == 4 => of(day_first),
            (Some(..=12), Some(13..=31)) if c.len() == 4 => of(month_first),
            (Some(..=99), Some(..=31)) if c.len() == 4 || c.len() == 2 => Err(Unread::Ambiguous),
            _ => Err(Unread::NoTime),
        },
    }
}

/// A month by its name, or what it begins with, in English or German.
fn month_named(text: &str) -> Option<i32> {
    const NAMES: [&[&str]; 12] = [
        &["jan"],
        &["feb"],
        &["mar", "mär", "mrz"],
        &["apr"],
        &["may", "mai"],
        &["jun"],
        &["jul"],
        &["aug"],
        &["sep"],
        &["oct", "okt"],
        &["nov"],
        &["dec", "dez"],
    ];
    if text.chars().any(|c| !c.is_alphabetic()) {
        return None;
    }
    let start: String = text.to_lowercase().chars().take(3).collect();
    (1..).zip(NAMES).find(|(_, names)| names.contains(&start.as_str())).map(|(month, _)| month)
}
