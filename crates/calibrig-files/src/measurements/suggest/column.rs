//! What one column of a file looks like, and what it may be.

use std::collections::BTreeSet;

use super::super::layout::{Column, Decimal};
use super::super::times;
use super::super::units::HeaderUnit;

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
    Set,
}

/// Numbers of a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in super::super) struct Numbers {
    pub count: u64,
    pub least: f64,
    pub most: f64,
    pub are_whole: bool,
    pub are_rising: bool,
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

/// Numbers that programs write for what they have not measured.
const CODES: [f64; 6] = [-9999.0, 9999.0, -999.0, 999.0, -99_999.0, 999_999.0];

/// Different texts of a column that are kept.
const MOST_TEXTS: usize = 64;

/// A column and all that is seen of it.
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
    texts: BTreeSet<String>,
    codes: BTreeSet<String>,
    /// More than are kept.
    pub many_texts: bool,
    pub role: Option<Role>,
    /// Why it may be that.
    pub reason: String,
    /// Place among those of the same role.
    pub order: usize,
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
            texts: BTreeSet::new(),
            codes: BTreeSet::new(),
            many_texts: false,
            role: None,
            reason: String::new(),
            order: 0,
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
            _ if times::is_time(cell, decimal) => self.times += 1,
            _ => {}
        }
        if self.texts.len() < MOST_TEXTS {
            self.texts.insert(cell.to_owned());
        } else if !self.texts.contains(cell) {
            self.many_texts = true;
        }
    }

    /// Whether it holds numbers but for some cells: missed shots have marks.
    pub fn is_number(&self) -> bool {
        let filled = self.cells - self.empty;
        self.numbers.count > 0 && 10 * self.numbers.count >= 9 * filled
    }

    fn is_time(&self) -> bool {
        self.times > 0 && self.times == self.cells - self.empty
    }

    /// Different texts, where they are few.
    pub fn texts(&self) -> Vec<&str> {
        self.texts.iter().map(String::as_str).collect()
    }

    /// Cells that are no numbers among numbers, and numbers that are codes.
    pub fn marks(&self, decimal: Decimal) -> Vec<String> {
        let texts = self.texts.iter().filter(|text| decimal.parse(text).is_none_or(f64::is_nan));
        texts.map(|text| format!("{text:?}")).chain(self.codes.iter().cloned()).collect()
    }

    fn take(&mut self, role: Role, order: usize, reason: impl Into<String>) {
        (self.role, self.order, self.reason) = (Some(role), order, reason.into());
    }

    /// As a map names it.
    pub fn entry(&self, has_header: bool) -> String {
        if !has_header || self.name.is_empty() {
            return self.number.to_string();
        }
        format!("{:?}", if self.unit.is_some() { &self.name } else { &self.header })
    }
}

/// Gives every column the role that its name, or what is in it, calls for.
pub(in super::super) fn give_roles(columns: &mut [SeenColumn], has_header: bool, rows: u64) {
    if has_header {
        by_name(columns);
    }
    by_contents(columns, has_header, rows);
}

fn simple(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).collect::<String>().to_lowercase()
}

/// The number at the end of a name that begins so: `joint_3`.
fn numbered(name: &str, prefixes: &[&str]) -> Option<usize> {
    let digits = name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let number = name[digits..].parse().ok()?;
    prefixes.contains(&&name[..digits]).then_some(number)
}

/// A name without the unit at its end: `x_mm`.
fn without_unit(name: &str) -> &str {
    match name.rsplit_once('_') {
        Some((stem, unit)) if HeaderUnit::parse(unit).is_some() => stem,
        _ => name,
    }
}

const JOINTS: [&str; 10] = ["j", "a", "q", "joint", "axis", "axe", "ax", "theta", "achse", "jt"];

fn by_name(columns: &mut [SeenColumn]) {
    for column in columns.iter_mut() {
        let name = simple(without_unit(&column.name));
        let called = format!("called {:?}", column.header);
        if let Some(number) = numbered(&name, &JOINTS)
            && column.is_number()
        {
            column.take(Role::Joint, number, called);
            continue;
        }
        let role = match name.as_str() {
            "x" | "xpos" | "posx" | "xactual" | "xmeas" | "xmeasured" | "measx" | "actualx" => Role::X,
            "y" | "ypos" | "posy" | "yactual" | "ymeas" | "ymeasured" | "measy" | "actualy" => Role::Y,
            "z" | "zpos" | "posz" | "zactual" | "zmeas" | "zmeasured" | "measz" | "actualz" => Role::Z,
            "r" | "range" | "dist" | "distance" | "d" | "slopedistance" | "sd" => Role::Range,
            "az" | "azimuth" | "hz" | "horizontal" | "horizontalangle" | "ha" => Role::Azimuth,
            "el" | "elev" | "elevation" | "elevationangle" => Role::Elevation,
            "ze" | "zen" | "zenith" | "v" | "vertical" | "verticalangle" | "va" | "zenithangle" => {
                Role::Zenith
            }
            "sx" | "sigmax" | "ux" | "stdx" | "stddevx" | "sdx" | "u95x" | "ux95" | "xuncertainty"
            | "uncertaintyx" => Role::SigmaX,
            "sy" | "sigmay" | "uy" | "stdy" | "stddevy" | "sdy" | "u95y" | "uy95" | "yuncertainty"
            | "uncertaintyy" => Role::SigmaY,
            "sz" | "sigmaz" | "uz" | "stdz" | "stddevz" | "sdz" | "u95z" | "uz95" | "zuncertainty"
            | "uncertaintyz" => Role::SigmaZ,
            "pose" | "no" | "nr" | "number" | "posenumber" | "poseno" | "index" => Role::Pose,
            "name" | "point" | "pointname" | "id" | "pointid" | "label" | "nominal" => Role::Name,
            "station" | "instrument" => Role::Station,
            "target" | "smr" | "reflector" | "nest" => Role::Target,
            "t" | "time" | "timestamp" | "datetime" | "clock" | "timeofday" => Role::Time,
            "temperature" | "temp" | "airtemperature" => Role::Temperature,
            "set" | "use" | "usage" => Role::Set,
            _ => continue,
        };
        let holds_numbers =
            !matches!(role, Role::Pose | Role::Name | Role::Station | Role::Target | Role::Time | Role::Set);
        if !holds_numbers || column.is_number() {
            column.take(role, 0, called);
        }
    }
    // "t" beside joints and a position is a time; of "a" to "z" alone nothing follows.
    let is_one =
        |columns: &[SeenColumn], role| columns.iter().filter(|column| column.role == Some(role)).count() == 1;
    for role in [Role::X, Role::Y, Role::Z, Role::Pose, Role::Name, Role::Time] {
        if !is_one(columns, role) {
            for (seen, column) in columns.iter_mut().filter(|column| column.role == Some(role)).enumerate() {
                if seen > 0 {
                    (column.role, column.reason) = (None, format!("a second one {}", column.reason));
                }
            }
        }
    }
}

fn by_contents(columns: &mut [SeenColumn], has_header: bool, rows: u64) {
    let free = |columns: &[SeenColumn]| -> Vec<usize> {
        (0..columns.len())
            .filter(|index| columns[*index].role.is_none() && columns[*index].is_number())
            .collect()
    };
    // Without a header, what stands in the columns is all there is.
    if !has_header {
        let mut rest = free(columns);
        if let Some(first) = rest.first().copied()
            && rest.len() > 3
            && columns[first].numbers.are_whole
            && columns[first].numbers.are_rising
            && rows > 1
        {
            columns[first].take(Role::Pose, 0, "whole numbers that rise");
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
