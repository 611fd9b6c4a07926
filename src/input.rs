//! Reading of text files: every refusal names the file, the line and the key, and says what was expected.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

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
        /// The text.
        #[source_code]
        source_code: NamedSource<String>,
        /// Where in the text.
        #[label("here")]
        span: SourceSpan,
        /// What was expected.
        #[help]
        help: Option<String>,
    },
}

impl Source {
    /// A text that is already in memory.
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self { name: name.into(), text: text.into() }
    }

    /// Reads a UTF-8 file.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let unreadable = |reason: String| InputError::Unreadable { path: path.to_path_buf(), reason };
        if path.is_dir() {
            return Err(unreadable("it is a folder, a file was expected".to_owned()));
        }
        let bytes = std::fs::read(path).map_err(|e| unreadable(e.to_string()))?;
        let text = String::from_utf8(bytes)
            .map_err(|e| unreadable(format!("not UTF-8 text (byte {})", e.utf8_error().valid_up_to())))?;
        Ok(Self::new(path.display().to_string(), text))
    }

    /// An error at `span` (bytes) of this text.
    pub fn error(&self, span: Range<usize>, message: impl fmt::Display, help: Option<String>) -> InputError {
        let start = span.start.min(self.text.len());
        let end = span.end.clamp(start, self.text.len());
        let line = self.text.as_bytes()[..start].iter().filter(|b| **b == b'\n').count() + 1;
        InputError::Invalid {
            message: message.to_string(),
            line,
            source_code: NamedSource::new(&self.name, self.text.clone()),
            span: (start, end - start).into(),
            help,
        }
    }

    /// Reads the text as TOML; unknown keys, missing keys and wrong types are errors at their place.
    pub fn toml<T: DeserializeOwned>(&self) -> Result<T, InputError> {
        toml::from_str(&self.text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            let mut message = error.message().trim().replace('\n', ": ");
            let mut help = None;
            if let Some(at) = message.find(", expected") {
                let expected = message.split_off(at + 2);
                help = Some(with_units(&expected));
            } else if message.starts_with("missing field") {
                help = Some("units are part of the key, such as `_mm`, `_deg` or `_nm_per_rad`".to_owned());
            }
            self.error(span, message, help)
        })
    }
}

fn with_units(expected: &str) -> String {
    if expected.contains("_mm") || expected.contains("_deg") {
        format!("{expected}; the unit is part of the key")
    } else {
        expected.to_owned()
    }
}

/// A finite number from a TOML value with its place.
pub(crate) type Spanned<T> = toml::Spanned<T>;

impl Source {
    /// The value if it is a finite number, else an error that names `key`.
    pub(crate) fn finite(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        let number = *value.get_ref();
        if number.is_finite() {
            Ok(number)
        } else {
            Err(self.error(
                value.span(),
                format!("{key} is {number}"),
                Some("expected a finite number".to_owned()),
            ))
        }
    }

    /// The value if it is a finite number above zero, else an error that names `key`.
    pub(crate) fn positive(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        let number = self.finite(key, value)?;
        if number > 0.0 {
            Ok(number)
        } else {
            Err(self.error(
                value.span(),
                format!("{key} is {number}"),
                Some("expected a number above zero".to_owned()),
            ))
        }
    }

    /// The value if it is a finite number of zero or more, else an error that names `key`.
    pub(crate) fn not_negative(&self, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
        let number = self.finite(key, value)?;
        if number >= 0.0 {
            Ok(number)
        } else {
            Err(self.error(
                value.span(),
                format!("{key} is {number}"),
                Some("expected zero or more".to_owned()),
            ))
        }
    }
}
