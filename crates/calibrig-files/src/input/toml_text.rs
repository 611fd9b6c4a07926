//! Keys and places in a TOML text, and the parser's errors in the terms of the file.

use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::{InputError, Source, units};

/// A text as a value of TOML: Rust's own quotes have escapes that TOML lacks.
pub(crate) fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A file's contents. A key whose unit differs from the file's form (`theta_rad` for `theta_deg`) is accepted, and its value converted.
pub(super) fn read<T: DeserializeOwned>(source: &Source) -> Result<T, InputError> {
    let literals = units::Literals::of(&source.text);
    let mut table = DeTable::parse(&source.text).map_err(|error| refusal(source, &error))?;
    loop {
        let error = match T::deserialize(toml::Deserializer::from(table.clone())) {
            Ok(contents) => return Ok(contents),
            Err(error) => error,
        };
        match units::convert(&mut table, &literals, &error) {
            units::Converted::Yes => {}
            units::Converted::No => return Err(refusal(source, &error)),
            units::Converted::Twice { span, keys: [a, b] } => {
                let message = format!("{a} and {b} state the same quantity");
                return Err(source.error(span, message, Some("expected only one of them".to_owned())));
            }
        }
    }
}

/// The key as in the file at a value's place: it may have another unit.
pub(super) fn as_written(text: &str, key: &str, span: &Range<usize>) -> String {
    let found = key_at(text, span);
    let last = |key: &str| key.rsplit('.').next().unwrap_or_default().to_owned();
    if units::are_same_quantity(&last(&found), &last(key)) {
        let before = key.len() - last(key).len();
        return format!("{}{}", &key[..before], last(&found));
    }
    key.to_owned()
}

/// A value of a TOML text.
struct Value {
    /// Its key behind those of the tables around it.
    key: String,
    span: Range<usize>,
}

/// Bytes of the value of `key`; the start of the text if the key is missing.
pub(super) fn place_of(text: &str, key: &str) -> Range<usize> {
    values(text).into_iter().find(|value| value.key == key).map_or(0..0, |value| value.span)
}

/// The parser's error: which key, what it is, what was expected.
pub(super) fn refusal(source: &Source, error: &toml::de::Error) -> InputError {
    let span = error.span().unwrap_or(0..0);
    let parsed = error.message().trim().replace('\n', ", ");
    let (found, expected) = parsed.split_once(", expected ").unwrap_or((&parsed, ""));
    let mistake = Mistake {
        found,
        expected: in_words(expected),
        key: key_at(&source.text, &span),
        literal: source.text.get(span.clone()).unwrap_or_default(),
        behind_digit: source.text[..span.start].ends_with(|c: char| c.is_ascii_digit()),
        rest: &source.text[span.start..],
    };
    let (message, expected) = mistake.in_words();
    source.error(span, message, Some(format!("expected {expected}")))
}

struct Mistake<'a> {
    /// The parser's words.
    found: &'a str,
    expected: String,
    /// Empty at the top of the file.
    key: String,
    literal: &'a str,
    behind_digit: bool,
    /// The text from the mistake on.
    rest: &'a str,
}

impl Mistake<'_> {
    /// What is wrong, and what was expected.
    fn in_words(self) -> (String, String) {
        let Self { found, expected, key, literal, .. } = self;
        if let Some(name) = found.strip_prefix("unknown field ") {
            return (format!("unknown key {name}"), known_keys(name, &expected));
        }
        if let Some(name) = found.strip_prefix("missing field ") {
            let table = if key.is_empty() { String::new() } else { format!(" in [{key}]") };
            let has_unit = UNITS.iter().any(|unit| name.ends_with(&format!("_{unit}`")));
            let unit = if has_unit { "; the unit is part of the key" } else { "" };
            return (format!("missing key {name}{table}"), format!("{name} with a value{unit}"));
        }
        if found == "duplicate key" {
            return (format!("duplicate key `{literal}`"), "every key only once".to_owned());
        }
        if self.behind_digit && self.rest.starts_with(',') && !key.is_empty() {
            return (format!("{key} has a decimal comma"), "a decimal point".to_owned());
        }
        let is_literal = !key.is_empty() && !literal.is_empty();
        let value = || format!("{key} is {}", shortened(literal));
        match found {
            "string values must be quoted" if is_literal => {
                (value(), "a number, true, false, or a text in quotes".to_owned())
            }
            "string values must be quoted" if !key.is_empty() => {
                (format!("{key} has no value"), "a value after the `=`".to_owned())
            }
            "wanted string or table" if is_literal => (value(), "a text in quotes".to_owned()),
            "invalid type: sequence" if expected == "a table" => {
                let name = key.rsplit('.').next().unwrap_or_default();
                let message = format!(
                    "{key} is a list ([[{key}]], or [ ] in brackets), but only one {name} is possible here"
                );
                (message, format!("[{key}] in single brackets, once"))
            }
            "invalid type: map" if expected.starts_with("a list") => (
                format!("{key} is a single table"),
                format!("[[{key}]] in double brackets, one table for each"),
            ),
            _ if is_literal && found.ends_with("overflowed") => (value(), "a finite number".to_owned()),
            _ if is_literal && WRONG_VALUE.iter().any(|start| found.starts_with(start)) => {
                (value(), expected)
            }
            _ => {
                let subject = if key.is_empty() { String::new() } else { format!("{key}: ") };
                let expected = if expected.is_empty() { "valid TOML".to_owned() } else { expected };
                (format!("{subject}{found}"), expected)
            }
        }
    }
}

/// How messages on a value of the wrong kind begin.
const WRONG_VALUE: [&str; 4] = ["invalid type", "invalid value", "invalid length", "unknown variant"];

/// What keys of quantities end with.
const UNITS: [&str; 18] = [
    "m",
    "mm",
    "um",
    "um_per_m",
    "m_per_m",
    "rad",
    "mrad",
    "urad",
    "deg",
    "arcsec",
    "n",
    "kg",
    "kg_per_m3",
    "gpa",
    "n_per_m",
    "nm_per_rad",
    "m_per_s2",
    "s",
];

/// Serde's types, in terms of a TOML file.
fn in_words(expected: &str) -> String {
    match expected {
        "f64" => "a number".to_owned(),
        "u32" => format!("a whole number from 0 to {}", u32::MAX),
        "u64" | "usize" => format!("a whole number from 0 to {}", u64::MAX),
        "a boolean" => "true or false".to_owned(),
        "a string" => "a text in quotes".to_owned(),
        "a sequence" => "a list in brackets, [ ]".to_owned(),
        "an array of length 3" => "a list of 3 numbers, [ , , ]".to_owned(),
        _ if expected.starts_with("struct ") => "a table".to_owned(),
        _ => expected.to_owned(),
    }
}

/// The known keys; if a unit was forgotten, those that are meant.
fn known_keys(unknown: &str, expected: &str) -> String {
    let start = format!("{}_", unknown.trim_end_matches('`'));
    let words = expected.split(", ").flat_map(str::split_whitespace);
    let meant: Vec<_> = words.filter(|key| key.starts_with(&start)).collect();
    if meant.is_empty() {
        expected.to_owned()
    } else {
        format!("{}: the unit is part of the key", meant.join(" or "))
    }
}

/// A value as it is in the file, cut if it is long.
fn shortened(literal: &str) -> String {
    let line = literal.lines().next().unwrap_or_default();
    if line.len() == literal.len() && line.chars().count() <= 40 {
        return line.to_owned();
    }
    format!("{}...", line.chars().take(40).collect::<String>())
}

/// The key whose value lies closest around `span`; empty at the top of the file.
fn key_at(text: &str, span: &Range<usize>) -> String {
    let around = |value: &Value| value.span.start <= span.start && span.end <= value.span.end;
    // Among equals the last: the keys in a table come after it.
    let candidates = values(text).into_iter().filter(around).rev();
    candidates.min_by_key(|value| value.span.len()).map_or_else(String::new, |value| value.key)
}

/// All values, a table before what is in it, as far as the text can be parsed.
fn values(text: &str) -> Vec<Value> {
    let (table, _) = DeTable::parse_recoverable(text);
    let mut values = Vec::new();
    collect_table("", table.get_ref(), &mut values);
    values
}

fn collect_table(path: &str, table: &DeTable<'_>, values: &mut Vec<Value>) {
    for (name, value) in table {
        let name = name.get_ref();
        let key = if path.is_empty() { name.to_string() } else { format!("{path}.{name}") };
        collect(&key, value, values);
    }
}

fn collect(key: &str, value: &Spanned<DeValue<'_>>, values: &mut Vec<Value>) {
    values.push(Value { key: key.to_owned(), span: value.span() });
    match value.get_ref() {
        DeValue::Table(table) => collect_table(key, table, values),
        DeValue::Array(array) => array.iter().for_each(|item| collect(key, item, values)),
        _ => {}
    }
}

/// A step of a key: a name, and which of the tables of that name, by number from 1 or by what they are called.
struct Step<'a> {
    name: &'a str,
    which: Option<&'a str>,
}

/// Keys by which tables of an array are told apart.
const CALLED: [&str; 3] = ["joint", "name", "mode"];

impl<'a> Step<'a> {
    /// The steps of `effects.backlash.joint[rail].gap_um`; `None` if brackets do not close.
    fn all(key: &'a str) -> Option<Vec<Self>> {
        let mut steps = Vec::new();
        let mut rest = key;
        loop {
            let end = rest.find(['.', '[']).unwrap_or(rest.len());
            let name = &rest[..end];
            rest = &rest[end..];
            let mut which = None;
            if let Some(inside) = rest.strip_prefix('[') {
                let close = inside.find(']')?;
                which = Some(inside[..close].trim_matches('"'));
                rest = &inside[close + 1..];
            }
            steps.push(Step { name, which });
            match rest.strip_prefix('.') {
                Some(more) => rest = more,
                None => return rest.is_empty().then_some(steps),
            }
        }
    }

    fn takes(&self, number: usize, item: &DeValue<'_>) -> bool {
        let Some(which) = self.which else { return true };
        if which.parse() == Ok(number) {
            return true;
        }
        let DeValue::Table(table) = item else { return false };
        CALLED.iter().any(|key| matches!(table.get(*key).map(Spanned::get_ref), Some(DeValue::String(name)) if name == which))
    }
}

/// Bytes of every value of `key`, in which a table of an array may be chosen: `poses.region[rail].half_width_mm`, `tracker.nest[2].x_mm`. Without a
/// choice, all tables of the array are searched.
pub(super) fn places_of(text: &str, key: &str) -> Vec<Range<usize>> {
    let (table, _) = DeTable::parse_recoverable(text);
    let mut places = Vec::new();
    if let Some(steps) = Step::all(key) {
        follow(&steps, table.get_ref(), &mut places);
    }
    places
}

fn follow(steps: &[Step<'_>], table: &DeTable<'_>, places: &mut Vec<Range<usize>>) {
    let Some((step, rest)) = steps.split_first() else { return };
    let Some(value) = table.get(step.name) else { return };
    let mut enter = |value: &Spanned<DeValue<'_>>| match value.get_ref() {
        DeValue::Table(inner) if !rest.is_empty() => follow(rest, inner, places),
        _ if rest.is_empty() => places.push(value.span()),
        _ => {}
    };
    match value.get_ref() {
        DeValue::Array(items) if step.which.is_some() || !rest.is_empty() => {
            let chosen = (1..).zip(items.iter()).filter(|(number, item)| step.takes(*number, item.get_ref()));
            chosen.for_each(|(_, item)| enter(item));
        }
        _ if step.which.is_none() => enter(value),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(serde::Deserialize, Debug)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "read by serde alone")]
    struct File {
        a_mm: f64,
        list: Vec<u32>,
        table: Option<Table>,
    }

    #[derive(serde::Deserialize, Debug)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "read by serde alone")]
    struct Table {
        b_rad: f64,
    }

    #[test]
    fn keys_are_found_by_name() {
        let text = "a_mm = 1\nlist = [2, 3]\n[table]\nb_rad = 4.5\n";
        assert_eq!(&text[place_of(text, "table.b_rad")], "4.5");
        assert_eq!(&text[place_of(text, "list")], "[2, 3]");
        assert_eq!(place_of(text, "table.c"), 0..0);
    }

    #[test]
    fn keys_choose_among_tables_of_an_array() {
        let text = "list = [2, 3]\n[[a.joint]]\njoint = \"rail\"\ngap_um = 7\n[[a.joint]]\njoint = \"waist\"\ngap_um = 8\n[b]\nc = { d = 1.5 }\n";
        let found = |key| places_of(text, key).into_iter().map(|place| &text[place]).collect::<Vec<_>>();
        assert_eq!(found("a.joint[waist].gap_um"), ["8"]);
        assert_eq!(found("a.joint[\"rail\"].gap_um"), ["7"]);
        assert_eq!(found("a.joint[1].gap_um"), ["7"]);
        assert_eq!(found("a.joint.gap_um"), ["7", "8"]);
        assert_eq!(
            (found("b.c.d"), found("list"), found("list[2]")),
            (vec!["1.5"], vec!["[2, 3]"], vec!["3"])
        );
        // Of a table, where it begins.
        assert_eq!(found("a"), ["a"]);
        let nowhere = [
            "",
            "a.joint[3].gap_um",
            "a.joint[wrist].gap_um",
            "b.c[1].d",
            "a.joint[1.gap_um",
            "b.c.d.e",
            "list[1]x",
            ".",
        ];
        for key in nowhere {
            assert!(found(key).is_empty(), "{key}: {:?}", found(key));
        }
    }

    #[test]
    fn mistakes_deep_in_a_file_are_called_by_their_keys() {
        for (text, message, line, expected) in [
            ("a_mm = 1\nlist = [2, -3]", "list is -3", 2, "a whole number from 0 to 4294967295"),
            ("a_mm = 1\nlist = [2, \n'x']", "list is 'x'", 3, "a whole number"),
            ("a_mm = 1\nlist = []\ntable = { b_rad = true }", "table.b_rad is true", 3, "a number"),
            ("a_mm = 1\nlist = []\ntable = { }", "missing key `b_rad` in [table]", 3, "part of the key"),
            ("a_mm = 1\nlist = []\ntable = 3", "table is 3", 3, "a table"),
            ("a_mm = 1,5\nlist = []", "a_mm has a decimal comma", 1, "a decimal point"),
            ("a_mm = 1\nlist = [", "list: unclosed array", 2, "`]`"),
            ("a_mm = ''\nlist = []", "a_mm is ''", 1, "a number"),
        ] {
            match Source::new("file.toml", text).toml::<File>() {
                Err(InputError::Invalid { message: found, line: at, help, .. }) => {
                    assert_eq!((found.as_str(), at), (message, line), "{text}");
                    assert!(help.as_deref().is_some_and(|help| help.contains(expected)), "{text}: {help:?}");
                }
                other => panic!("{text}: {other:?}"),
            }
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "([ab_m=\\[\\]{},.\"'\n #]|\\PC|table|list|1e9){0,30}") {
            if let Err(error) = Source::new("file.toml", text).toml::<File>() {
                let shown = format!("{:?}", miette::Report::new(error));
                prop_assert!(!shown.is_empty());
            }
        }
    }
}
