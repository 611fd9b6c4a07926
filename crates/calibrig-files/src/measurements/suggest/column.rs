//! What one column of a file looks like, and what it may be.

use std::collections::BTreeSet;

use super::super::layout::{Column, Decimal};
use super::super::times;
use super::super::units::HeaderUnit;
use super::names::{JointName, Said, said_by, words};
use super::{payload, triples};
use crate::input::quoted;

/// What a column may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum Role {
    Joint,
    X,
    Y,
    Z,
    Range,
    Azimuth,
    Elevation,
    Zenith,
    SigmaX,
    SigmaY,
    SigmaZ,
    Pose,
    /// A name of every row.
    Name,
    Station,
    Target,
    Time,
    Temperature,
    Pressure,
    Humidity,
    /// In which face a tracker read.
    Face,
    /// Of the rotation of the position's target.
    Turn,
    Set,
    /// What the flange carries, by name.
    Payload,
    PayloadMass,
    /// Its centre.
    PayloadX,
    PayloadY,
    PayloadZ,
}

impl Role {
    fn holds_numbers(self) -> bool {
        !matches!(
            self,
            Self::Pose
                | Self::Name
                | Self::Station
                | Self::Target
                | Self::Time
                | Self::Face
                | Self::Set
                | Self::Payload
        )
    }
}

/// Numbers of a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in super::super) struct Numbers {
    pub count: u64,
    pub least: f64,
    pub most: f64,
    pub are_whole: bool,
    pub are_rising: bool,
    /// Whether some number is smaller than the one before.
    pub falls: bool,
    last: f64,
}

impl Default for Numbers {
    fn default() -> Self {
        Self {
            count: 0,
            least: f64::INFINITY,
            most: f64::NEG_INFINITY,
            are_whole: true,
            are_rising: true,
            falls: false,
            last: f64::NEG_INFINITY,
        }
    }
}

impl Numbers {
    fn see(&mut self, number: f64) {
        self.count += 1;
        (self.least, self.most) = (self.least.min(number), self.most.max(number));
        self.are_whole &= number.fract() == 0.0;
        self.are_rising &= number > self.last;
        self.falls |= number < self.last;
        self.last = number;
    }

    /// Those of two columns together.
    #[must_use]
    pub fn with(mut self, other: &Self) -> Self {
        self.count += other.count;
        (self.least, self.most) = (self.least.min(other.least), self.most.max(other.most));
        self.are_whole &= other.are_whole;
        self
    }

    /// Largest size.
    pub fn largest(&self) -> f64 {
        self.least.abs().max(self.most.abs())
    }
}

/// Numbers that programs write for missing values.
const CODES: [f64; 6] = [-9999.0, 9999.0, -999.0, 999.0, -99_999.0, 999_999.0];

/// Different texts of a column that are kept.
const MOST_TEXTS: usize = 64;

/// A column and its findings.
pub(in super::super) struct SeenColumn {
    /// From 1.
    pub number: usize,
    pub header: String,
    pub name: String,
    pub unit: Option<HeaderUnit>,
    pub numbers: Numbers,
    cells: u64,
    empty: u64,
    times: u64,
    /// Among the times: dates alone, and dates with times.
    days: u64,
    moments: u64,
    /// A date whose day and month are ambiguous.
    pub ambiguous: Option<String>,
    pub joint: Option<JointName>,
    texts: BTreeSet<String>,
    codes: BTreeSet<String>,
    /// More than are kept.
    pub many_texts: bool,
    pub role: Option<Role>,
    /// The reason for the role.
    pub reason: String,
    /// Why a person must decide on the role.
    pub doubt: Option<String>,
    /// Whether another column has this name as well.
    pub is_repeated: bool,
    /// Index among those of the same role.
    pub order: usize,
    /// Whether it belongs to an orientation next to the position.
    pub is_beside: bool,
}

impl SeenColumn {
    pub fn new(index: usize, column: &Column) -> Self {
        Self {
            number: index + 1,
            header: column.header.clone(),
            name: column.name().to_owned(),
            unit: column.unit,
            numbers: Numbers::default(),
            cells: 0,
            empty: 0,
            times: 0,
            days: 0,
            moments: 0,
            ambiguous: None,
            joint: None,
            texts: BTreeSet::new(),
            codes: BTreeSet::new(),
            many_texts: false,
            role: None,
            reason: String::new(),
            doubt: None,
            is_repeated: false,
            order: 0,
            is_beside: false,
        }
    }

    pub fn see(&mut self, cell: &str, decimal: Decimal) {
        self.cells += 1;
        if cell.is_empty() {
            self.empty += 1;
            return;
        }
        match decimal.parse(cell) {
            Some(number) if CODES.contains(&number) => {
                self.codes.insert(number.to_string());
            }
            Some(number) if number.is_finite() => self.numbers.see(number),
            _ => match times::look_at(cell, decimal) {
                times::Look::Day => {
                    self.times += 1;
                    self.days += 1;
                }
                times::Look::Clock => self.times += 1,
                times::Look::Moment => {
                    self.times += 1;
                    self.moments += 1;
                }
                times::Look::Ambiguous { is_day } => {
                    self.times += 1;
                    self.days += u64::from(is_day);
                    self.moments += u64::from(!is_day);
                    self.ambiguous.get_or_insert_with(|| cell.to_owned());
                }
                times::Look::Nothing => {}
            },
        }
        if self.texts.len() < MOST_TEXTS {
            self.texts.insert(cell.to_owned());
        } else if !self.texts.contains(cell) {
            self.many_texts = true;
        }
    }

    /// Whether it holds numbers except for some cells: missed shots have marks.
    pub fn is_number(&self) -> bool {
        let filled = self.cells - self.empty;
        self.numbers.count > 0 && 10 * self.numbers.count >= 9 * filled
    }

    pub fn is_time(&self) -> bool {
        self.times > 0 && self.times == self.cells - self.empty
    }

    /// Whether it holds times of the day without dates.
    pub fn is_clock(&self) -> bool {
        self.is_time() && self.days + self.moments == 0
    }

    /// Whether it holds dates without times of the day.
    pub fn is_day(&self) -> bool {
        self.is_time() && self.days == self.times
    }

    /// Different texts, where they are few.
    pub fn texts(&self) -> Vec<&str> {
        self.texts.iter().map(String::as_str).collect()
    }

    /// Cells that are not numbers among numbers, and numbers that are codes.
    pub fn marks(&self, decimal: Decimal) -> Vec<String> {
        let texts = self.texts.iter().filter(|text| decimal.parse(text).is_none_or(f64::is_nan));
        texts.map(|text| quoted(text)).chain(self.codes.iter().cloned()).collect()
    }

    /// Whether it describes the payload.
    pub fn is_of_payload(&self) -> bool {
        matches!(self.role, Some(Role::Payload | Role::PayloadMass))
    }

    pub fn take(&mut self, role: Role, order: usize, reason: impl Into<String>) {
        (self.role, self.order, self.reason) = (Some(role), order, reason.into());
    }

    /// The name, without a unit in brackets.
    pub fn said_name(&self) -> &str {
        if self.unit.is_some() { &self.name } else { &self.header }
    }

    /// As a map names it; by number if the name is not unique, or would be read as a sign, a sum or a number.
    pub fn entry(&self, has_header: bool) -> String {
        let name = self.said_name();
        let is_more = name.starts_with(['-', '+', '#'])
            || [" + ", " - "].iter().any(|sign| name.contains(sign) || name.ends_with(sign.trim_end()));
        if !has_header || self.name.is_empty() || self.is_repeated || is_more {
            return self.number.to_string();
        }
        quoted(self.said_name())
    }
}

/// Gives every column the role that its name or its content suggests.
pub(in super::super) fn give_roles(columns: &mut [SeenColumn], has_header: bool, rows: u64) {
    if has_header {
        by_name(columns);
    }
    by_contents(columns, has_header, rows);
}

/// The same for a bag, whose columns are those of [`read_bag`](super::super::read_bag): a column without one of its own names is a joint.
pub(in super::super) fn give_roles_of_a_bag(columns: &mut [SeenColumn]) {
    for column in columns {
        let known = match column.header.as_str() {
            "time_s" => Some(Role::Time),
            "x" => Some(Role::X),
            "y" => Some(Role::Y),
            "z" => Some(Role::Z),
            "target" => Some(Role::Target),
            "station" => Some(Role::Station),
            _ => None,
        };
        if let Some(role) = known {
            column.take(role, 0, "of the points");
            continue;
        }
        if let Some(Said::Joint(joint)) = said_by(&column.header) {
            column.joint = Some(joint);
        }
        let order = column.joint.as_ref().and_then(|joint| joint.order);
        column.take(Role::Joint, order.unwrap_or(usize::MAX), "a joint of the bag");
    }
}

fn by_name(columns: &mut [SeenColumn]) {
    for index in 0..columns.len() {
        let is_same = |other: &SeenColumn| other.said_name() == columns[index].said_name();
        columns[index].is_repeated = columns.iter().filter(|other| is_same(other)).count() > 1;
    }
    for column in columns.iter_mut() {
        let called = format!("called {:?}", column.header);
        let carried = payload::role_of(column).map(Said::Role);
        match carried.or_else(|| said_by(column.said_name())) {
            Some(Said::Joint(joint)) if column.is_number() => {
                // Axes that are not part of the arm come after it.
                let beside = if joint.is_external { 10_000 } else { 0 };
                column.take(Role::Joint, joint.order.map_or(usize::MAX, |order| order + beside), called);
                column.joint = Some(joint);
            }
            Some(Said::Role(role)) => {
                // T [°C] is not a time.
                let is_warm = role == Role::Time && column.unit == Some(HeaderUnit::Other);
                let role = if is_warm { Role::Temperature } else { role };
                if !role.holds_numbers() || column.is_number() {
                    column.take(role, 0, called);
                }
            }
            _ => {}
        }
    }
    take_axes_with_letters(columns);
    leave_quaternions(columns);
    choose_joints(columns);
    leave_times_that_fall(columns);
    triples::choose(columns);
    // "t" next to joints and a position is a time; one of "a" to "z" alone shows nothing.
    let is_one =
        |columns: &[SeenColumn], role| columns.iter().filter(|column| column.role == Some(role)).count() == 1;
    for role in [Role::X, Role::Y, Role::Z, Role::Pose, Role::Name] {
        if !is_one(columns, role) {
            for (seen, column) in columns.iter_mut().filter(|column| column.role == Some(role)).enumerate() {
                if seen > 0 {
                    (column.role, column.reason) = (None, format!("a second one {}", column.reason));
                }
            }
        }
    }
}

/// q0 to q3, or q1 to q4, directly after a place and within 1 may not be joints: a probe's export has its quaternion there.
fn leave_quaternions(columns: &mut [SeenColumn]) {
    let numbered = |column: &SeenColumn| {
        let joint = column.joint.as_ref().filter(|joint| joint.family.ends_with('q'))?;
        (column.numbers.largest() <= 1.0 + 1e-3).then_some((joint.family.clone(), joint.order?))
    };
    for at in 1..columns.len().saturating_sub(3) {
        let four: Option<Vec<_>> = columns[at..at + 4].iter().map(numbered).collect();
        let Some(four) = four else { continue };
        let family = four[0].0.clone();
        let in_row =
            four.iter().zip(four[0].1..).all(|((own, order), place)| *own == family && *order == place);
        let of_family =
            columns.iter().filter_map(|c| c.joint.as_ref()).filter(|joint| joint.family == family);
        let is_alone = of_family.count() == 4 && four[0].1 <= 1;
        if in_row && is_alone && columns[at - 1].role == Some(Role::Z) {
            for column in &mut columns[at..at + 4] {
                (column.role, column.joint) = (None, None);
            }
        }
    }
}

/// Axes of Motoman's arms have letters: S, L, U, R, B, T, and E, the seventh, between L and U.
fn take_axes_with_letters(columns: &mut [SeenColumn]) {
    const LETTERS: [&str; 7] = ["s", "l", "e", "u", "r", "b", "t"];
    let find = |letter: &str, family: Option<&[String]>| {
        let mut found = columns.iter().enumerate().filter_map(|(index, column)| {
            let words = words(column.said_name());
            let (last, rest) = words.split_last()?;
            let is_one = column.is_number() && last == letter && family.is_none_or(|family| family == rest);
            is_one.then(|| (index, rest.to_vec()))
        });
        found.next().filter(|_| found.next().is_none())
    };
    let Some((_, family)) = find("s", None) else { return };
    let found = LETTERS.map(|letter| find(letter, Some(&family)).map(|(index, _)| index));
    if found.iter().zip(LETTERS).any(|(found, letter)| found.is_none() && letter != "e") {
        return;
    }
    for (order, index) in found.into_iter().enumerate() {
        let Some(index) = index else { continue };
        let column = &mut columns[index];
        let reason = format!("called {:?}: S, L, U, R, B, T are the axes of Motoman's arms", column.header);
        column.take(Role::Joint, order + 1, reason);
        column.joint = Some(JointName::of_letter(&family.join(" "), order + 1));
    }
}

/// A time does not fall, and T may mean many things.
fn leave_times_that_fall(columns: &mut [SeenColumn]) {
    for column in columns.iter_mut().filter(|column| column.role == Some(Role::Time)) {
        let is_t = words(column.said_name()) == ["t"] && column.unit.is_none();
        if is_t && column.is_number() && column.numbers.falls {
            column.role = None;
            column.reason = String::from("it falls from row to row, so it is not a time");
        }
    }
}

/// Among several families of joints, such as commanded and actual ones, or joints and a quaternion: the commanded one, else the
/// largest.
fn choose_joints(columns: &mut [SeenColumn]) {
    let mut families: Vec<(String, usize, bool)> = Vec::new();
    for joint in columns.iter().filter_map(|column| column.joint.as_ref()) {
        if joint.is_external || joint.has_own_name {
            continue;
        }
        match families.iter_mut().find(|(family, ..)| *family == joint.family) {
            Some((_, count, _)) => *count += 1,
            None => families.push((joint.family.clone(), 1, joint.is_command)),
        }
    }
    let most = families.iter().map(|(_, count, _)| *count).max().unwrap_or(0);
    let largest = families.iter().filter(|(_, count, _)| *count == most);
    let Some((chosen, _, is_command)) = largest.min_by_key(|(_, _, is_command)| !is_command).cloned() else {
        return;
    };
    let others = families.len() > 1;
    for column in columns.iter_mut() {
        let Some(joint) = &column.joint else { continue };
        if joint.is_external || joint.has_own_name {
            continue;
        }
        if joint.family == chosen {
            if others && is_command {
                column.reason = format!("{}, which is the commanded one", column.reason);
            }
        } else {
            (column.role, column.joint) = (None, None);
            column.reason = String::from("looks like a joint's as well");
        }
    }
}

fn by_contents(columns: &mut [SeenColumn], has_header: bool, rows: u64) {
    let free = |columns: &[SeenColumn]| -> Vec<usize> {
        (0..columns.len())
            .filter(|index| columns[*index].role.is_none() && columns[*index].is_number())
            .collect()
    };
    // Without a header, only the content of the columns is known.
    if !has_header {
        let mut rest = free(columns);
        if let Some(first) = rest.first().copied()
            && rest.len() > 3
            && columns[first].numbers.are_whole
            && columns[first].numbers.are_rising
            && rows > 1
        {
            columns[first].take(Role::Pose, 0, "whole numbers that increase");
            rest.remove(0);
        }
        if rest.len() >= 3 {
            let last = rest.split_off(rest.len() - 3);
            for (index, role) in last.into_iter().zip([Role::X, Role::Y, Role::Z]) {
                columns[index].take(role, 0, "the last three columns of numbers; check it");
            }
            for (order, index) in rest.into_iter().enumerate() {
                columns[index].take(Role::Joint, order, "numbers in front of the position; check it");
            }
        } else {
            for (order, index) in rest.into_iter().enumerate() {
                columns[index].take(Role::Joint, order, "numbers; check it");
            }
        }
    }
    for column in columns.iter_mut().filter(|column| column.role.is_none()) {
        if column.is_time() {
            column.take(Role::Time, 0, "times");
        } else if !column.is_number() && rows > 1 && (column.many_texts || column.texts.len() as u64 == rows)
        {
            column.take(Role::Name, 0, "another text in every row");
        }
    }
}
