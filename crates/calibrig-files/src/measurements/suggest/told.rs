//! Units and times from headers, names and sizes.

use super::SeenFile;
use super::column::{Role, SeenColumn};
use crate::measurements::units::{AngleUnit, HeaderUnit, LengthUnit, TimeUnit, unit_of_name};

/// What shows a unit.
pub(super) enum Told<U> {
    /// The header states it to the reader as well, column by column.
    Header(String),
    /// With the reason.
    Seen(U, String),
    /// With the evidence for each.
    Open(String),
}

/// Key, columns and reason of the times of a file.
pub(super) fn time_of(file: &SeenFile) -> Option<(String, String, String)> {
    let columns = file.with(Role::Time);
    let entry = |column: &SeenColumn| column.entry(file.has_header);
    let day = columns.iter().find(|column| column.is_day());
    let clock = columns.iter().find(|column| column.is_clock());
    let moment = columns.iter().find(|column| column.is_time() && !column.is_day() && !column.is_clock());
    if let (Some(day), Some(clock), None) = (day, clock, moment) {
        let value = format!("[{}, {}]", entry(day), entry(clock));
        return Some((
            "time_s".to_owned(),
            value,
            "a date in one column, the time of the day in another".to_owned(),
        ));
    }
    let numbers: Vec<_> = columns.iter().copied().filter(|column| column.is_number()).collect();
    if let [seconds, parts] = numbers.as_slice()
        && TimeUnit::at_the_end_of(&parts.header) == Some(TimeUnit::Ns)
    {
        let value = format!("[{}, {}]", entry(seconds), entry(parts));
        return Some(("time_s".to_owned(), value, "seconds, with nanoseconds in another column".to_owned()));
    }
    if let Some(clock) = moment.or(clock) {
        return Some((
            "time_s".to_owned(),
            entry(clock),
            format!("{}: times, or dates and times", clock.reason),
        ));
    }
    let column = *numbers.first()?;
    let largest = column.numbers.largest();
    let (unit, why) = match unit(column) {
        Some(HeaderUnit::Time(unit)) => (unit, format!("in {}, as the header says", unit.key())),
        _ if largest > 1e17 => (TimeUnit::Ns, format!("{largest:.3e}, looks like ns since 1970")),
        _ if largest > 1e14 => (TimeUnit::Us, format!("{largest:.3e}, looks like us since 1970")),
        _ if largest > 1e11 => (TimeUnit::Ms, format!("{largest:.3e}, looks like ms since 1970")),
        _ => (
            TimeUnit::S,
            format!(
                "up to {}: taken for seconds; time_ms, time_us and time_ns are other units",
                short(largest)
            ),
        ),
    };
    Some((format!("time_{}", unit.key()), entry(column), format!("{}; {why}", column.reason)))
}

/// Whether a joint's column holds lengths: by its unit, its name, or numbers beyond any angle while the others are angles.
pub(super) fn is_prismatic(column: &SeenColumn, all: &[&SeenColumn]) -> bool {
    match unit(column) {
        Some(HeaderUnit::Length(_)) => return true,
        Some(HeaderUnit::Angle(_)) => return false,
        _ => {}
    }
    let is_large = |column: &SeenColumn| column.numbers.largest() > 720.0;
    let slides = column.joint.as_ref().is_some_and(|joint| joint.slides);
    slides || (is_large(column) && all.iter().any(|other| !is_large(other)))
}

/// The unit of prismatic joints.
pub(super) fn stroke_unit(columns: &[&SeenColumn]) -> Told<LengthUnit> {
    if let Some(units) = header_units(columns, is_length) {
        return Told::Header(units);
    }
    let first = columns[0];
    if let Some(HeaderUnit::Length(unit)) = unit(first) {
        return Told::Seen(unit, format!("the name {:?} ends with it", first.header));
    }
    let size = short(SeenFile::numbers_of(columns).largest());
    if !columns.iter().any(|column| column.joint.as_ref().is_some_and(|joint| joint.slides)) {
        return Told::Open(format!(
            "{} goes to {size}, more than two turns in degrees: a prismatic joint in mm, by its size, if the robot has one there",
            first.header
        ));
    }
    if SeenFile::numbers_of(columns).largest() > 100.0 {
        let why =
            format!("{} slides, by its name, and goes to {size}: no rail is that many m long", first.header);
        return Told::Seen(LengthUnit::Mm, why);
    }
    Told::Open(format!(
        "{} slides, by its name, and goes to {size}: m, or mm with hardly any motion",
        first.header
    ))
}

pub(super) fn reason(column: &SeenColumn) -> String {
    let numbers = &column.numbers;
    if numbers.count == 0 {
        return column.reason.clone();
    }
    format!(
        "{}; column {}: {} to {}",
        column.reason,
        column.number,
        short(numbers.least),
        short(numbers.most)
    )
}

pub(super) fn reasons(columns: &[&SeenColumn]) -> String {
    let (first, numbers) = (columns[0], SeenFile::numbers_of(columns));
    format!("{}; {} to {} in all", first.reason, short(numbers.least), short(numbers.most))
}

pub(super) fn short(number: f64) -> String {
    let text = format!("{number:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The unit that a header states, in brackets or at the end of its name.
pub(super) fn unit(column: &SeenColumn) -> Option<HeaderUnit> {
    column.unit.or_else(|| unit_of_name(&column.header))
}

/// The units in brackets of all these columns, where all have one of the kind.
pub(super) fn header_units(
    columns: &[&SeenColumn],
    is_of_kind: impl Fn(HeaderUnit) -> bool,
) -> Option<String> {
    let mut names: Vec<&str> = Vec::new();
    for column in columns {
        let unit = column.unit.filter(|unit| is_of_kind(*unit))?;
        if !names.contains(&unit.key()) {
            names.push(unit.key());
        }
    }
    (!names.is_empty()).then(|| names.join(" and "))
}

pub(super) fn is_length(unit: HeaderUnit) -> bool {
    matches!(unit, HeaderUnit::Length(_))
}

pub(super) fn is_angle(unit: HeaderUnit) -> bool {
    matches!(unit, HeaderUnit::Angle(_))
}

pub(super) fn angle_unit(columns: &[&SeenColumn], what: &str) -> Told<AngleUnit> {
    let angles: Vec<&SeenColumn> = columns
        .iter()
        .copied()
        .filter(|column| !matches!(unit(column), Some(HeaderUnit::Length(_))))
        .collect();
    if angles.is_empty() {
        return Told::Open("no column of angles; where the robot has a revolute joint".to_owned());
    }
    if let Some(units) = header_units(&angles, is_angle) {
        return Told::Header(units);
    }
    if let Some(HeaderUnit::Angle(unit)) = unit(angles[0]) {
        return Told::Seen(unit, format!("the name {:?} ends with it", angles[0].header));
    }
    let largest = angles.iter().max_by(|a, b| a.numbers.largest().total_cmp(&b.numbers.largest()));
    let Some(largest) = largest else { return Told::Open(String::new()) };
    let (number, size) = (largest.number, largest.numbers.largest());
    let extreme = if largest.numbers.most.abs() >= largest.numbers.least.abs() { "max" } else { "min" };
    let value = short(if extreme == "max" { largest.numbers.most } else { largest.numbers.least });
    if size > 4.0 * std::f64::consts::PI && size <= 720.0 {
        return Told::Seen(AngleUnit::Deg, format!("column {number}: {extreme} {value}, looks like degrees"));
    }
    if size <= 4.0 * std::f64::consts::PI
        && angles.iter().all(|column| column.joint.as_ref().is_some_and(|joint| joint.is_of_ros))
    {
        let why = format!(
            "column {number}: {extreme} {value}, and names as of ROS's joint states, which are in rad"
        );
        return Told::Seen(AngleUnit::Rad, why);
    }
    if size > 720.0 {
        return Told::Open(format!(
            "column {number}: {extreme} {value}, more than two turns in degrees: not an angle, or another unit"
        ));
    }
    Told::Open(format!(
        "column {number}: {extreme} {value}: {what} in radians, or in degrees with hardly any motion"
    ))
}

pub(super) fn length_unit(
    columns: &[&SeenColumn],
    comment: Option<(LengthUnit, String)>,
) -> Told<LengthUnit> {
    if let Some(units) = header_units(columns, is_length) {
        return Told::Header(units);
    }
    if let Some(HeaderUnit::Length(unit)) = unit(columns[0]) {
        return Told::Seen(unit, format!("the name {:?} ends with it", columns[0].header));
    }
    if let Some((unit, reason)) = comment {
        return Told::Seen(unit, reason);
    }
    let largest = SeenFile::numbers_of(columns).largest();
    if (200.0..1e5).contains(&largest) {
        return Told::Seen(
            LengthUnit::Mm,
            format!("up to {}, looks like mm: a tracker sees 0.2 to 80 m", short(largest)),
        );
    }
    if largest > 0.2 && largest <= 30.0 {
        return Told::Seen(
            LengthUnit::M,
            format!(
                "up to {}, looks like m: in mm, all points would be within a hand's width",
                short(largest)
            ),
        );
    }
    Told::Open(format!("up to {}: m, mm and inch are all possible", short(largest)))
}
