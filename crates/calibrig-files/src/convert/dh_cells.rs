//! Titles and cells of a table of Denavit-Hartenberg rows.

use std::f64::consts::PI;
use std::ops::Range;

use crate::input::Source;

/// What a column holds, and the size of its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Column {
    pub what: What,
    pub unit: Option<Unit>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum What {
    Name,
    Type,
    A,
    Alpha,
    Beta,
    D,
    Theta,
    Min,
    Max,
    /// A number of the row, a remark.
    Other,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Unit {
    Length(f64),
    Angle(f64),
}

pub(super) fn unit(text: &str) -> Option<Unit> {
    Some(match text {
        "mm" => Unit::Length(1e-3),
        "cm" => Unit::Length(1e-2),
        "m" => Unit::Length(1.0),
        "in" | "inch" => Unit::Length(0.0254),
        "deg" | "°" | "degrees" | "degree" => Unit::Angle(PI / 180.0),
        "rad" | "radians" => Unit::Angle(1.0),
        _ => return None,
    })
}

pub(super) fn column(title: &str) -> Column {
    let title = title.to_lowercase().replace('α', "alpha").replace('θ', "theta").replace('β', "beta");
    let words: Vec<&str> =
        title.split(|c: char| !(c.is_alphanumeric() || c == '°')).filter(|word| !word.is_empty()).collect();
    let what = match words.first().copied().unwrap_or_default() {
        "name" | "joint" | "axis" => What::Name,
        "type" | "kind" => What::Type,
        "a" | "r" => What::A,
        "alpha" => What::Alpha,
        "beta" => What::Beta,
        "d" => What::D,
        "theta" => What::Theta,
        "min" | "lower" => What::Min,
        "max" | "upper" => What::Max,
        _ => What::Other,
    };
    Column { what, unit: words.iter().skip(1).rev().find_map(|word| unit(word)) }
}

/// The cells of a line with their places.
pub(super) fn cells(
    source: &Source,
    start: usize,
    line: &str,
    delimiter: char,
) -> Vec<(String, Range<usize>)> {
    let mut cells = Vec::new();
    let mut at = start;
    let mut is_quoted = false;
    // A delimiter in quotes is a part of its cell.
    let ends = move |mark: char| {
        is_quoted ^= mark == '"';
        mark == delimiter && !is_quoted
    };
    for cell in line.split(ends) {
        let trimmed = cell.trim().trim_matches('"').trim();
        let offset = cell.find(trimmed).unwrap_or(0);
        cells.push((trimmed.to_owned(), at + offset..(at + offset + trimmed.len()).min(source.text.len())));
        at += cell.len() + delimiter.len_utf8();
    }
    cells
}

/// What a cell says.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Value {
    pub number: f64,
    pub variable: Option<Variable>,
}

/// A joint variable, with the number in its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Variable {
    pub sign: Sign,
    pub joint: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sign {
    Plus,
    Minus,
}

/// The terms of a sum, each with whether it is subtracted.
pub(super) fn terms(text: &str) -> Vec<(bool, String)> {
    let mut terms: Vec<(bool, String)> = Vec::new();
    let mut minus = false;
    let mut term = String::new();
    for mark in text.chars().map(|c| if c == '−' || c == '–' { '-' } else { c }) {
        let in_exponent = term.ends_with(['e', 'E']) && term.starts_with(|c: char| c.is_ascii_digit());
        match mark {
            '+' | '-' if !in_exponent => {
                if !term.is_empty() {
                    terms.push((minus, std::mem::take(&mut term)));
                    minus = false;
                }
                minus ^= mark == '-';
            }
            c if c.is_whitespace() => {}
            c => term.push(c),
        }
    }
    terms.push((minus, term));
    terms
}

/// The digits of `q2`, `θ_3`, `theta4*`, `d3`, of which `q` has none; `None` if the term is not a joint variable.
pub(super) fn variable(term: &str) -> Option<String> {
    let term = term.to_lowercase();
    let term = term.trim_end_matches('*');
    ["theta", "θ", "q", "d"].iter().find_map(|name| {
        let digits = term.strip_prefix(name)?.trim_start_matches('_');
        digits.chars().all(|c| c.is_ascii_digit()).then(|| digits.to_owned())
    })
}

/// A number as in a cell, in a unit of which `size` make one of SI; multiples of pi if that is rad.
pub(super) fn number(term: &str, size: f64, decimal_comma: bool) -> Option<f64> {
    let plain = if decimal_comma { term.replace(',', ".") } else { term.to_owned() };
    if let Ok(number) = plain.parse::<f64>() {
        return number.is_finite().then_some(number);
    }
    if size != 1.0 {
        return None;
    }
    // Multiples of pi: pi, 2*pi, 3pi/4.
    let term = plain.to_lowercase().replace('π', "pi");
    let (factor, divisor) = term.split_once("pi")?;
    let factor = factor.trim_end_matches('*');
    let factor = if factor.is_empty() { 1.0 } else { factor.parse::<f64>().ok()? };
    let divisor = match divisor.strip_prefix('/') {
        Some(divisor) => divisor.parse::<f64>().ok()?,
        None if divisor.is_empty() => 1.0,
        None => return None,
    };
    Some(factor * PI / divisor).filter(|number| number.is_finite())
}
