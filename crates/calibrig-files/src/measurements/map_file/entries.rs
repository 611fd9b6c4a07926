//! Entries of a column map, of one grammar wherever columns are named.

use std::fmt;
use std::ops::Range;

use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::Reader;
use crate::input::{InputError, Spanned};
use crate::measurements::columns::{ColumnRef, Entry, Term};

/// An entry as it stands in the file.
#[derive(Debug)]
pub(super) enum RawEntry {
    Text(String),
    Number(i64),
    List(Vec<Spanned<RawEntry>>),
}

impl<'de> Deserialize<'de> for RawEntry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct EntryVisitor;
        impl<'de> Visitor<'de> for EntryVisitor {
            type Value = RawEntry;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a column: its name in quotes, a signed sum such as \"a - b\", its number, or a list of these")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<RawEntry, E> {
                Ok(RawEntry::Text(text.to_owned()))
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<RawEntry, E> {
                Ok(RawEntry::Number(number))
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<RawEntry, E> {
                Ok(RawEntry::Number(i64::try_from(number).unwrap_or(i64::MAX)))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<RawEntry, A::Error> {
                let mut list = Vec::new();
                while let Some(item) = items.next_element()? {
                    list.push(item);
                }
                Ok(RawEntry::List(list))
            }
        }
        deserializer.deserialize_any(EntryVisitor)
    }
}

/// Numbers and texts, or a list of them.
#[derive(Debug, Default)]
pub(super) struct Codes(pub Vec<String>);

impl<'de> Deserialize<'de> for Codes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct CodesVisitor;
        impl<'de> Visitor<'de> for CodesVisitor {
            type Value = Codes;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, a text in quotes, or a list of these")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Codes, E> {
                Ok(Codes(vec![text.to_owned()]))
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Codes, E> {
                Ok(Codes(vec![number.to_string()]))
            }

            fn visit_f64<E: de::Error>(self, number: f64) -> Result<Codes, E> {
                Ok(Codes(vec![number.to_string()]))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Codes, A::Error> {
                let mut list = Vec::new();
                while let Some(Codes(mut items)) = items.next_element()? {
                    list.append(&mut items);
                }
                Ok(Codes(list))
            }
        }
        deserializer.deserialize_any(CodesVisitor)
    }
}

impl Reader<'_> {
    /// A column by its name, or by `#` and its number.
    fn column(&self, span: Range<usize>, name: &str) -> Result<ColumnRef, InputError> {
        let name = name.trim();
        if name.is_empty() {
            return Err(self.error(span, "a sign without a column after it", "a name of the header line"));
        }
        match name.strip_prefix('#').map(str::parse) {
            Some(Ok(0)) => Err(self.error(span, "#0 is not a column", "columns numbered from #1")),
            Some(Ok(number)) => Ok(ColumnRef::Number(number)),
            _ => Ok(ColumnRef::Name(name.to_owned())),
        }
    }

    /// The terms of a text: `a`, `-a`, `a + b - c`. A sign between columns has blanks around it, because names may contain signs.
    fn terms(&self, span: &Range<usize>, text: &str, terms: &mut Vec<Term>) -> Result<(), InputError> {
        let text = text.trim();
        if text.is_empty() {
            return Err(self.error(
                span.clone(),
                "the name of a column is empty",
                "a name of the header line",
            ));
        }
        if text.ends_with(" +") || text.ends_with(" -") {
            return Err(self.error(
                span.clone(),
                "a sign without a column after it",
                "a name of the header line",
            ));
        }
        let (mut sign, mut rest) = match text.strip_prefix('-') {
            Some(rest) => (-1.0, rest),
            None => (1.0, text.strip_prefix('+').unwrap_or(text)),
        };
        loop {
            let next = [(" + ", 1.0), (" - ", -1.0)];
            let found = next.iter().filter_map(|(op, sign)| rest.find(op).map(|at| (at, *sign)));
            let (at, next_sign) = found.min_by_key(|(at, _)| *at).unwrap_or((rest.len(), 1.0));
            terms.push(Term { column: self.column(span.clone(), &rest[..at])?, sign });
            if at == rest.len() {
                return Ok(());
            }
            (sign, rest) = (next_sign, &rest[at + 3..]);
        }
    }

    fn add(&self, entry: &Spanned<RawEntry>, terms: &mut Vec<Term>) -> Result<(), InputError> {
        let span = entry.span();
        match entry.get_ref() {
            RawEntry::Text(text) => self.terms(&span, text, terms),
            RawEntry::Number(number) => {
                let sign = if *number < 0 { -1.0 } else { 1.0 };
                let number = usize::try_from(number.unsigned_abs()).unwrap_or(usize::MAX);
                if number == 0 {
                    return Err(self.error(span, "0 is not a column", "columns numbered from 1"));
                }
                terms.push(Term { column: ColumnRef::Number(number), sign });
                Ok(())
            }
            RawEntry::List(list) if list.is_empty() => {
                Err(self.error(span, "a sum without columns", "at least one column"))
            }
            RawEntry::List(list) => list.iter().try_for_each(|entry| self.add(entry, terms)),
        }
    }

    /// A quantity: one column, or the sum of several.
    pub fn sum(&self, entry: &Spanned<RawEntry>) -> Result<Entry, InputError> {
        let mut terms = Vec::new();
        self.add(entry, &mut terms)?;
        let written = match entry.get_ref() {
            RawEntry::Text(text) => text.trim().to_owned(),
            RawEntry::Number(number) => format!("#{number}"),
            RawEntry::List(_) => self.source.text.get(entry.span()).unwrap_or_default().to_owned(),
        };
        Ok(Entry { written, terms })
    }

    /// One column.
    pub fn single(&self, entry: &Spanned<RawEntry>) -> Result<Entry, InputError> {
        let found = self.sum(entry)?;
        let is_list = matches!(entry.get_ref(), RawEntry::List(_));
        let is_one = found.terms.len() == 1 && found.terms[0].sign > 0.0;
        if is_one || !is_list {
            return Ok(found);
        }
        Err(self.error(
            entry.span(),
            format!("{} is not a single column", found.written),
            "the name of one column",
        ))
    }

    /// Quantities, one of each.
    pub fn entries(&self, list: &Spanned<RawEntry>) -> Result<Vec<Entry>, InputError> {
        let RawEntry::List(items) = list.get_ref() else { return Ok(vec![self.sum(list)?]) };
        let mut seen: Vec<Entry> = Vec::with_capacity(items.len());
        for item in items {
            let entry = self.sum(item)?;
            if seen.contains(&entry) {
                let message = format!("column {:?} is named twice", entry.written);
                return Err(self.error(item.span(), message, "a different column for each"));
            }
            seen.push(entry);
        }
        Ok(seen)
    }
}
