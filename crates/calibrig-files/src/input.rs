//! Reading of text files: every error names the file, the line and the key, and says what was expected.

mod excerpt;
mod toml_text;
mod units;

pub use excerpt::Excerpt;
pub(crate) use toml_text::quoted;

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use miette::{Diagnostic, NamedSource, SourceSpan};
use serde::de::DeserializeOwned;
use thiserror::Error;

/// A text with the name it is known by in messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Path or name of an attachment.
    pub name: String,
    /// Its whole text.
    pub text: String,
}

/// A file that cannot be used.
#[derive(Debug, Error, Diagnostic)]
#[non_exhaustive]
pub enum InputError {
    /// It cannot be opened or read.
    #[error("cannot read {}: {reason}", path.display())]
    #[diagnostic(help("expected a text file in UTF-8"))]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// Something in it is wrong.
    #[error("{}:{line}: {message}", source_code.name())]
    Invalid {
        /// What is wrong, with the key or column.
        message: String,
        /// Line, from 1.
        line: usize,
        /// The text, or the lines of it around the mistake; shared, so that the error stays small.
        #[source_code]
        source_code: Arc<NamedSource<Excerpt>>,
        /// Where in it, bytes.
        #[label("here")]
        span: SourceSpan,
        /// What was expected.
        #[help]
        help: Option<String>,
    },
    /// An error in a file that is not text, or in several lines of one.
    #[error("{place}: {message}")]
    Place {
        /// The file, and the place in it: a cell, a message, lines.
        place: String,
        /// What is wrong.
        message: String,
        /// What was expected.
        #[help]
        help: Option<String>,
    },
}

impl InputError {
    /// An error at `span` (bytes) of `excerpt`, which is of the file `name`.
    pub(crate) fn in_excerpt(
        name: &str,
        excerpt: Excerpt,
        span: Range<usize>,
        message: impl fmt::Display,
        help: Option<String>,
    ) -> Self {
        let (excerpt, span) = excerpt.shown_at(span);
        let text = excerpt.text();
        let (start, end) = (span.start, span.end);
        let before = text.as_bytes()[..start].iter().filter(|b| **b == b'\n').count();
        Self::Invalid {
            message: message.to_string(),
            line: excerpt.first_line() + before,
            source_code: Arc::new(NamedSource::new(name, excerpt)),
            span: (start, end - start).into(),
            help,
        }
    }
}

impl Source {
    /// A text that is already in memory.
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self { name: name.into(), text: text.into() }
    }

    /// Reads a UTF-8 file.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let bytes = bytes_of(path)?;
        let text = String::from_utf8(bytes).map_err(|e| unreadable(path, not_utf8(&e)))?;
        Ok(Self::new(path.display().to_string(), text))
    }

    /// Reads a text file of another program: UTF-8, UTF-16 with its mark, else Latin-1 (Windows-1252). The second value says if it is not
    /// UTF-8.
    pub fn read_foreign(path: &Path) -> Result<(Self, Option<String>), InputError> {
        let bytes = bytes_of(path)?;
        let name = path.display().to_string();
        let utf16 = |unit: fn([u8; 2]) -> u16| {
            let units = bytes[2..].as_chunks::<2>().0.iter().map(|pair| unit(*pair));
            char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect::<String>()
        };
        let (text, told) = match (bytes.as_slice(), std::str::from_utf8(&bytes)) {
            ([0xFF, 0xFE, ..], _) => (utf16(u16::from_le_bytes), Some(format!("{name}: read as UTF-16"))),
            ([0xFE, 0xFF, ..], _) => (utf16(u16::from_be_bytes), Some(format!("{name}: read as UTF-16"))),
            (_, Ok(text)) => (text.to_owned(), None),
            (_, Err(error)) => {
                let at = error.valid_up_to();
                let line = bytes[..at].iter().filter(|byte| **byte == b'\n').count() + 1;
                let told = format!(
                    "{name}:{line}: not UTF-8 (the byte 0x{:02X}): read as Latin-1 (Windows-1252), in which it is {:?}",
                    bytes[at],
                    latin(bytes[at])
                );
                (bytes.iter().map(|byte| latin(*byte)).collect(), Some(told))
            }
        };
        Ok((Self::new(name, text), told))
    }

    /// An error at `span` (bytes) of this text.
    pub fn error(&self, span: Range<usize>, message: impl fmt::Display, help: Option<String>) -> InputError {
        InputError::in_excerpt(&self.name, Excerpt::whole(self.text.clone()), span, message, help)
    }

    /// Bytes of the value of a TOML key, such as `poses.identification`; the start of the text if the key is missing.
    pub fn place_of(&self, key: &str) -> Range<usize> {
        toml_text::place_of(&self.text, key)
    }

    /// Bytes of every value of a TOML key in which a table of an array may be chosen by its number from 1, or by its `joint`, `name` or `mode`:
    /// `as_built.joint[rail].delta_d_mm`. Without a choice, all tables of the array are searched.
    pub fn places_of(&self, key: &str) -> Vec<Range<usize>> {
        toml_text::places_of(&self.text, key)
    }

    /// Reads the text as TOML; unknown keys, missing keys and wrong types are errors at their place.
    pub fn toml<T: DeserializeOwned>(&self) -> Result<T, InputError> {
        toml_text::read(self)
    }
}

fn unreadable(path: &Path, reason: String) -> InputError {
    InputError::Unreadable { path: path.to_path_buf(), reason }
}

/// All of a file.
fn bytes_of(path: &Path) -> Result<Vec<u8>, InputError> {
    if path.is_dir() {
        return Err(unreadable(path, "it is a folder; expected a file".to_owned()));
    }
    std::fs::read(path).map_err(|error| unreadable(path, error.to_string()))
}

/// A byte of Windows-1252, which is Latin-1 but for 0x80 to 0x9F.
pub(crate) fn latin(byte: u8) -> char {
    const HIGH: [char; 32] = [
        '€', '\u{81}', '‚', 'ƒ', '„', '…', '†', '‡', 'ˆ', '‰', 'Š', '‹', 'Œ', '\u{8d}', 'Ž', '\u{8f}',
        '\u{90}', '‘', '’', '“', '”', '•', '–', '—', '˜', '™', 'š', '›', 'œ', '\u{9d}', 'ž', 'Ÿ',
    ];
    match byte {
        0x80..=0x9F => HIGH[usize::from(byte) - 0x80],
        _ => char::from(byte),
    }
}

/// Where a text stops being UTF-8, and what to do about it.
fn not_utf8(error: &std::string::FromUtf8Error) -> String {
    let at = error.utf8_error().valid_up_to();
    let bytes = error.as_bytes();
    let line = bytes[..at].iter().filter(|byte| **byte == b'\n').count() + 1;
    format!("not UTF-8 text (byte {at}), because of 0x{:02X} in line {line}; save it as UTF-8", bytes[at])
}

/// A value from a TOML text with its place.
pub type Spanned<T> = toml::Spanned<T>;

/// Sizes of accepted numbers: no quantity of a robot is larger or, above zero, smaller, in any unit, and the squares of these stay
/// finite and above zero.
const SIZES: [f64; 2] = [1e-15, 1e15];

impl Source {
    fn refuse_number(&self, key: &str, value: &Spanned<f64>, expected: &str) -> InputError {
        let literal = self.text.get(value.span()).unwrap_or_default();
        let key = &toml_text::as_written(&self.text, key, &value.span());
        self.error(value.span(), format!("{key} is {literal}"), Some(format!("expected {expected}")))
    }

    /// The value if it is a finite number of a sensible size, else an error that names `key`.
    pub fn finite(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        let number = *value.get_ref();
        if !number.is_finite() {
            return Err(self.refuse_number(key, value, "a finite number"));
        }
        if number.abs() > SIZES[1] {
            return Err(self.refuse_number(key, value, &format!("a number of at most {:e}", SIZES[1])));
        }
        Ok(number)
    }

    /// The value if it is a finite number above zero, else an error that names `key`.
    pub fn positive(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        let number = self.finite(key, value)?;
        if number <= 0.0 {
            return Err(self.refuse_number(key, value, "a number above zero"));
        }
        if number < SIZES[0] {
            return Err(self.refuse_number(key, value, &format!("a number of at least {:e}", SIZES[0])));
        }
        Ok(number)
    }

    /// The value if it is a finite number of zero or more, else an error that names `key`.
    pub fn not_negative(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        let number = self.finite(key, value)?;
        if number < 0.0 {
            return Err(self.refuse_number(key, value, "zero or more"));
        }
        Ok(number)
    }
}
