//! Keys of one quantity in different units: `theta_rad` instead of the form's `theta_deg`.

use std::borrow::Cow;
use std::cell::{Cell, OnceCell};
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A unit as keys end with it, and its size in SI. Lengths in powers of ten, so that a number's decimal point can be shifted.
const LENGTHS: [(&str, i32); 3] = [("m", 0), ("mm", -3), ("um", -6)];
const ANGLES: [(&str, f64); 5] = [
    ("rad", 1.0),
    ("mrad", 1e-3),
    ("urad", 1e-6),
    ("deg", std::f64::consts::PI / 180.0),
    ("arcsec", std::f64::consts::PI / 648_000.0),
];

/// How a number becomes one of another unit.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Factor {
    PowerOfTen(i32),
    Ratio { from: f64, to: f64 },
}

/// Literals of converted numbers, which a parsed table refers to.
#[derive(Debug)]
pub(super) struct Literals {
    texts: Vec<OnceCell<String>>,
    used: Cell<usize>,
}

impl Literals {
    /// Room for all values of a text.
    pub fn of(text: &str) -> Self {
        let most = 1 + text.bytes().filter(|byte| matches!(byte, b'=' | b',')).count();
        Self { texts: vec![OnceCell::new(); most], used: Cell::new(0) }
    }

    fn keep(&self, literal: String) -> Option<&str> {
        let place = self.texts.get(self.used.get())?;
        self.used.set(self.used.get() + 1);
        Some(place.get_or_init(|| literal))
    }
}

/// The result for an unknown key.
#[derive(Debug)]
pub(super) enum Converted {
    /// It is known now.
    Yes,
    /// No known key resembles it.
    No,
    /// The quantity is given already.
    Twice {
        /// Where the key is.
        span: Range<usize>,
        /// Both.
        keys: [String; 2],
    },
}

fn stem_and_unit(key: &str) -> Option<(&str, &str)> {
    key.rsplit_once('_')
}

fn factor(from: &str, to: &str) -> Option<Factor> {
    let length = |unit: &str| LENGTHS.iter().find(|(name, _)| *name == unit).map(|(_, size)| *size);
    let angle = |unit: &str| ANGLES.iter().find(|(name, _)| *name == unit).map(|(_, size)| *size);
    if let (Some(from), Some(to)) = (length(from), length(to)) {
        return Some(Factor::PowerOfTen(from - to));
    }
    Some(Factor::Ratio { from: angle(from)?, to: angle(to)? })
}

/// Whether two keys name the same quantity in different units.
pub(super) fn are_same_quantity(a: &str, b: &str) -> bool {
    match (stem_and_unit(a), stem_and_unit(b)) {
        (Some((a, unit)), Some((b, other))) => a == b && factor(unit, other).is_some(),
        _ => false,
    }
}

/// Gives the key that `error` does not know the name and the unit of the known one.
pub(super) fn convert<'t>(
    table: &mut Spanned<DeTable<'t>>,
    literals: &'t Literals,
    error: &toml::de::Error,
) -> Converted {
    let Some(rest) = error.message().strip_prefix("unknown field `") else { return Converted::No };
    let Some((unknown, expected)) = rest.split_once('`') else { return Converted::No };
    let known = expected.split('`').skip(1).step_by(2).find(|known| are_same_quantity(unknown, known));
    let (Some(known), Some(span)) = (known, error.span()) else { return Converted::No };
    let units = (stem_and_unit(unknown), stem_and_unit(known));
    let (Some((_, from)), Some((_, to))) = units else { return Converted::No };
    let Some(factor) = factor(from, to) else { return Converted::No };
    rename(table.get_mut(), &Renaming { unknown, known, span, factor, literals }).unwrap_or(Converted::No)
}

struct Renaming<'e, 't> {
    unknown: &'e str,
    known: &'e str,
    span: Range<usize>,
    factor: Factor,
    literals: &'t Literals,
}

/// `None` if the key is not in this table.
fn rename<'t>(table: &mut DeTable<'t>, renaming: &Renaming<'_, 't>) -> Option<Converted> {
    let is_meant = |key: &Spanned<Cow<'_, str>>| {
        key.get_ref() == renaming.unknown && key.span().start == renaming.span.start
    };
    if let Some(key) = table.keys().find(|key| is_meant(key)).cloned() {
        if table.keys().any(|key| key.get_ref() == renaming.known) {
            let keys = [renaming.known.to_owned(), renaming.unknown.to_owned()];
            return Some(Converted::Twice { span: key.span(), keys });
        }
        let (key, mut value) = table.remove_entry(&key)?;
        // A value that is not a number is refused as such, under the known name.
        scale(value.get_mut(), renaming.factor, renaming.literals);
        table.insert(Spanned::new(key.span(), Cow::Owned(renaming.known.to_owned())), value);
        return Some(Converted::Yes);
    }
    table.iter_mut().find_map(|(_, value)| rename_within(value.get_mut(), renaming))
}

fn rename_within<'t>(value: &mut DeValue<'t>, renaming: &Renaming<'_, 't>) -> Option<Converted> {
    match value {
        DeValue::Table(table) => rename(table, renaming),
        DeValue::Array(array) => array.iter_mut().find_map(|item| rename_within(item.get_mut(), renaming)),
        _ => None,
    }
}

/// Converts a number, or those of a list.
fn scale<'t>(value: &mut DeValue<'t>, factor: Factor, literals: &'t Literals) {
    let literal = match value {
        DeValue::Integer(number) if number.radix() == 10 => number.as_str().to_owned(),
        DeValue::Float(number) => number.as_str().to_owned(),
        DeValue::Array(array) => {
            array.iter_mut().for_each(|item| scale(item.get_mut(), factor, literals));
            return;
        }
        _ => return,
    };
    let Ok(number) = literal.parse::<f64>() else { return };
    let scaled = match factor {
        // The digits stay as they were written.
        Factor::PowerOfTen(power) if number.is_finite() && !literal.contains(['e', 'E']) => {
            format!("{literal}e{power}")
        }
        Factor::PowerOfTen(power) => float_literal(number * 10f64.powi(power)),
        Factor::Ratio { from, to } => float_literal(number * from / to),
    };
    let Some(literal) = literals.keep(scaled) else { return };
    if let Ok(scaled) = DeValue::parse(literal) {
        *value = scaled.into_inner();
    }
}

/// A number as TOML has it.
fn float_literal(number: f64) -> String {
    if number.is_nan() {
        "nan".to_owned()
    } else if number.is_infinite() {
        if number > 0.0 { "inf" } else { "-inf" }.to_owned()
    } else {
        format!("{number:e}")
    }
}

#[cfg(test)]
mod tests {
    use crate::input::{Source, Spanned};

    #[derive(serde::Deserialize, Debug)]
    #[serde(deny_unknown_fields)]
    struct File {
        a_mm: f64,
        #[serde(default)]
        list_m: Vec<f64>,
        joint: Vec<Joint>,
    }

    #[derive(serde::Deserialize, Debug)]
    #[serde(deny_unknown_fields)]
    struct Joint {
        theta_deg: Spanned<f64>,
        gap_um: Option<f64>,
        #[expect(dead_code, reason = "two quantities of one name in different units are not exchanged")]
        gap_arcsec: Option<f64>,
    }

    fn read(text: &str) -> Result<File, String> {
        Source::new("f.toml", text).toml::<File>().map_err(|error| error.to_string())
    }

    #[test]
    fn a_quantity_is_taken_in_any_unit_and_keeps_its_digits() {
        let file = read("a_m = 0.4251\nlist_mm = [1, 2.5]\n[[joint]]\ntheta_rad = 1.5\n[[joint]]\ntheta_deg = 2\ngap_mm = 0.1\n")
            .expect("valid");
        assert_eq!((file.a_mm, file.list_m), (425.1, vec![0.001, 0.0025]));
        assert!((file.joint[0].theta_deg.get_ref() - 1.5_f64.to_degrees()).abs() < 1e-13);
        assert_eq!((*file.joint[1].theta_deg.get_ref(), file.joint[1].gap_um), (2.0, Some(100.0)));
    }

    #[test]
    fn a_quantity_stands_once_and_mistakes_are_called_by_the_key_that_is_there() {
        for (text, message) in [
            ("a_mm = 1\njoint = []\na_um = 3", "f.toml:3: a_mm and a_um state the same quantity"),
            ("a_kg = 1\njoint = []", "f.toml:1: unknown key `a_kg`"),
            ("a_m = 'x'\njoint = []", "f.toml:1: a_m is 'x'"),
        ] {
            assert_eq!(read(text).expect_err("refused"), message);
        }
        let source = Source::new("f.toml", "a_mm = 1\n[[joint]]\ntheta_rad = inf\n");
        let file = source.toml::<File>().expect("valid");
        let refused = source.finite("theta_deg", &file.joint[0].theta_deg).expect_err("not finite");
        assert_eq!(refused.to_string(), "f.toml:3: theta_rad is inf");
    }
}
