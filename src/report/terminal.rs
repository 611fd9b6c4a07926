//! Lines for a terminal: colours, columns and breaks.

use std::fmt::Write;

use super::words::printable;

/// Whether escape sequences may be used. The caller decides, from the terminal and `NO_COLOR`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Style {
    /// Text alone: for files, pipes and `NO_COLOR`.
    #[default]
    Plain,
    /// ANSI escape sequences.
    Colour,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Ink {
    Heading,
    Dim,
    Good,
    Warning,
}

impl Style {
    pub(super) fn paint(self, ink: Ink, text: &str) -> String {
        let code = match ink {
            Ink::Heading => "1",
            Ink::Dim => "2",
            Ink::Good => "32",
            Ink::Warning => "33",
        };
        match self {
            Self::Plain => text.to_owned(),
            Self::Colour => format!("\x1b[{code}m{text}\x1b[0m"),
        }
    }

    /// Broken into lines, the later ones behind `indent`.
    pub(super) fn told(self, ink: Ink, text: &str, indent: &str) -> Vec<String> {
        wrap(&printable(text), indent).iter().map(|line| self.paint(ink, line)).collect()
    }
}

/// Columns of a table: as wide as a plain terminal with some room.
pub(super) const LINE: usize = 100;

pub(super) const TITLE: usize = 34;

pub(super) const NUMBER: usize = 8;

pub(super) fn aligned(title: &str, numbers: &[String]) -> String {
    let mut line = format!("{title:<TITLE$}");
    for number in numbers {
        let _ = write!(line, "{number:>NUMBER$}");
    }
    line
}

/// A title, cut where it would reach into the columns, and cells of so many characters.
pub(super) fn columns(title: &str, cells: &[String], width: usize) -> String {
    let title: String = printable(title).chars().take(TITLE - 1).collect();
    let cells: Vec<String> = cells.iter().map(|cell| format!("{cell:>width$}")).collect();
    format!("{title:<TITLE$}{}", cells.concat()).trim_end().to_owned()
}

/// Millimetres to the micrometre; large numbers, which only a failed fit has, in fewer digits.
pub(super) fn millimetres(metres: f64) -> String {
    let mm = 1e3 * metres;
    if mm.abs() >= 1e6 {
        format!("{mm:.0e}")
    } else if mm.abs() >= 999.9995 {
        format!("{mm:.0}")
    } else {
        format!("{mm:.3}")
    }
}

/// Breaks `text` at spaces into lines of at most [`LINE`] columns, the later ones behind `indent`. Longer words stand alone.
pub(super) fn wrap(text: &str, indent: &str) -> Vec<String> {
    let start = text.len() - text.trim_start().len();
    let mut lines = Vec::new();
    let mut line = text[..start].to_owned();
    let mut empty = true;
    for word in text.split_whitespace() {
        if !empty && line.chars().count() + 1 + word.chars().count() > LINE {
            lines.push(std::mem::replace(&mut line, indent.to_owned()));
            empty = true;
        }
        if !empty {
            line.push(' ');
        }
        line.push_str(word);
        empty = false;
    }
    lines.push(line);
    lines
}
