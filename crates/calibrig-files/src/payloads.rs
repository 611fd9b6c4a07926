//! `[[payload]]`: loads that the flange carries at some poses, by name.

use std::ops::Range;

use nalgebra::Vector3;
use serde::Deserialize;

use crate::input::{InputError, Source, Spanned};
use calibrig_model::Payload;

/// The name that stands for no payload.
pub const NO_PAYLOAD: &str = "none";

/// A load at the flange, as column maps, session files and scenarios give it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PayloadTable {
    name: Spanned<String>,
    mass_kg: Option<Spanned<f64>>,
    x_mm: Option<Spanned<f64>>,
    y_mm: Option<Spanned<f64>>,
    z_mm: Option<Spanned<f64>>,
    force_x_n: Option<Spanned<f64>>,
    force_y_n: Option<Spanned<f64>>,
    force_z_n: Option<Spanned<f64>>,
    /// Of a simulated one: its real mass over the stated one.
    pub mass_factor: Option<Spanned<f64>>,
    /// Of a session file: the set whose poses all carry it.
    pub set: Option<Spanned<String>>,
}

/// The kind of file that a payload stands in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PayloadFile {
    /// A column map, whose rows name it.
    ColumnMap,
    /// A session file: all poses of a set carry it.
    Session,
    /// A scenario, whose machine carries it.
    Scenario,
}

/// The payloads of `tables` in a `file` of that kind, each with a different name.
///
/// # Errors
/// Errors for a payload without name, mass or centre, with an invalid number, or with a key of another kind of file; for two of
/// one name.
pub fn read_payloads(
    source: &Source,
    tables: &[Spanned<PayloadTable>],
    file: PayloadFile,
) -> Result<Vec<Payload>, InputError> {
    let mut payloads: Vec<Payload> = Vec::with_capacity(tables.len());
    for table in tables {
        table.get_ref().check_keys(source, file)?;
        let payload = table.get_ref().read(source, table.span())?;
        if payloads.iter().any(|other| other.name == payload.name) {
            let message = format!("a second payload {:?}", payload.name);
            let help = Some("expected a different name for each payload".to_owned());
            return Err(source.error(table.get_ref().name.span(), message, help));
        }
        payloads.push(payload);
    }
    Ok(payloads)
}

/// Index of the payload of a name among the known ones; `None` if the name means no payload: a word for it, or a weight of 0.
///
/// # Errors
/// What was expected instead of an unknown name.
pub fn payload_by_name<'a>(
    name: &str,
    known: impl Iterator<Item = &'a str> + Clone,
) -> Result<Option<usize>, String> {
    if name.is_empty() || name == NO_PAYLOAD {
        return Ok(None);
    }
    if let Some(index) = known.clone().position(|other| other == name) {
        return Ok(Some(index));
    }
    if name.parse() == Ok(0.0) {
        return Ok(None);
    }
    let nearest = known.clone().min_by_key(|other| edits(name, other));
    let all: Vec<_> = known.map(|name| format!("{name:?}")).collect();
    Err(match (nearest, all.as_slice()) {
        (None, _) => format!("the name of a [[payload]], or {NO_PAYLOAD:?}; this file has no [[payload]]"),
        (Some(nearest), [_]) => format!("the name of a [[payload]], {nearest:?}, or {NO_PAYLOAD:?}"),
        (Some(nearest), _) => format!(
            "the name of a [[payload]], most likely {nearest:?}, or {NO_PAYLOAD:?}; there are {}",
            all.join(", ")
        ),
    })
}

/// Letters to insert, delete or replace between two names, whatever their case (Levenshtein 1966).
fn edits(a: &str, b: &str) -> usize {
    let [a, b] = [a, b].map(|text| text.to_lowercase().chars().collect::<Vec<_>>());
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.iter().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

impl PayloadTable {
    /// Refuses keys that belong to other files.
    fn check_keys(&self, source: &Source, file: PayloadFile) -> Result<(), InputError> {
        let (message, help, span) = match (&self.mass_factor, &self.set) {
            (Some(factor), _) if file != PayloadFile::Scenario => (
                "mass_factor applies to a simulated payload",
                "expected it in a [[payload]] of a scenario, whose machine carries more or less than is stated",
                factor.span(),
            ),
            (_, Some(set)) if file != PayloadFile::Session => (
                "set applies to a payload that a whole set carries",
                "expected it in a [[payload]] of a session file; here poses name what they carry",
                set.span(),
            ),
            _ => return Ok(()),
        };
        Err(source.error(span, message, Some(help.to_owned())))
    }

    fn read(&self, source: &Source, span: Range<usize>) -> Result<Payload, InputError> {
        let name = self.name.get_ref();
        if name.trim().is_empty() || name.trim() != name || name == NO_PAYLOAD {
            let message = format!("payload.name is {name:?}");
            let help = format!("expected a name without blanks at its ends, other than {NO_PAYLOAD:?}");
            return Err(source.error(self.name.span(), message, Some(help)));
        }
        let forces = [&self.force_x_n, &self.force_y_n, &self.force_z_n];
        let mut force = Vector3::zeros();
        for ((axis, key), value) in ["force_x_n", "force_y_n", "force_z_n"].iter().enumerate().zip(forces) {
            if let Some(value) = value {
                force[axis] = source.finite(&format!("payload.{key}"), value)?;
            }
        }
        let refuse =
            |message: String, help: &str| Err(source.error(span.clone(), message, Some(help.to_owned())));
        let mass = match &self.mass_kg {
            Some(mass) => source.not_negative("payload.mass_kg", mass)?,
            None if force != Vector3::zeros() => 0.0,
            None => {
                return refuse(
                    format!("payload {name:?} has no mass"),
                    "expected mass_kg, or a force in the base frame: force_x_n, force_y_n or force_z_n",
                );
            }
        };
        if mass == 0.0 && force == Vector3::zeros() {
            return refuse(
                format!("payload {name:?} weighs nothing"),
                "expected mass_kg above zero; poses without a payload name \"none\", or leave the name empty",
            );
        }
        let (Some(x), Some(y), Some(z)) = (&self.x_mm, &self.y_mm, &self.z_mm) else {
            return refuse(
                format!("payload {name:?} has no centre"),
                "expected x_mm, y_mm and z_mm: its centre of mass in the flange frame, where a force acts as well",
            );
        };
        let centre = Vector3::new(
            source.finite("payload.x_mm", x)?,
            source.finite("payload.y_mm", y)?,
            source.finite("payload.z_mm", z)?,
        ) / 1e3;
        Ok(Payload { name: name.clone(), mass, centre, force })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct File {
        payload: Vec<Spanned<PayloadTable>>,
    }

    fn read(text: &str) -> Result<Vec<Payload>, InputError> {
        let source = Source::new("loads.toml", text);
        let file: File = source.toml()?;
        read_payloads(&source, &file.payload, PayloadFile::ColumnMap)
    }

    #[test]
    fn payloads_are_read_in_si() {
        let text = "[[payload]]\nname = \"25 kg\"\nmass_kg = 25\nx_mm = 0\ny_mm = -4\nz_mm = 120\n\
                    [[payload]]\nname = \"rope\"\nforce_z_n = 200\nx_mm = 0\ny_mm = 0\nz_mm = 50\n";
        let payloads = read(text).expect("sound");
        assert_eq!(payloads[0], Payload::of_mass("25 kg", 25.0, Vector3::new(0.0, -0.004, 0.12)));
        assert_eq!((payloads[1].mass, payloads[1].force.z), (0.0, 200.0));
    }

    #[test]
    fn payloads_that_cannot_be_are_refused_with_their_place() {
        let centre = "x_mm = 0\ny_mm = 0\nz_mm = 90\n";
        for (rest, message, help) in [
            (centre.to_owned(), "payload \"a\" has no mass", "expected mass_kg"),
            (format!("mass_kg = -3\n{centre}"), "mass_kg is -3", "zero or more"),
            (format!("mass_kg = 0\n{centre}"), "payload \"a\" weighs nothing", "above zero"),
            (format!("mass_kg = nan\n{centre}"), "mass_kg is nan", "a finite number"),
            (format!("mass_kg = inf\n{centre}"), "mass_kg is inf", "a finite number"),
            ("mass_kg = 25\nx_mm = 1\ny_mm = 0\n".to_owned(), "payload \"a\" has no centre", "z_mm"),
            ("mass_kg = 25\n".to_owned(), "payload \"a\" has no centre", "in the flange frame"),
            (
                format!("mass_kg = 25\nset = \"verification\"\n{centre}"),
                "set applies to a payload",
                "session file",
            ),
            (format!("mass = 25\n{centre}"), "unknown key `mass`", "mass_kg"),
            (format!("mass_kg = 25\nz = 0.1\n{centre}"), "unknown key `z`", "z_mm"),
            (
                format!("mass_kg = 25\n{centre}[[payload]]\nname = \"a\"\nmass_kg = 1\n{centre}"),
                "a second payload",
                "a different name",
            ),
        ] {
            let error = read(&format!("[[payload]]\nname = \"a\"\n{rest}")).expect_err(message);
            let text = format!("{:?}", miette::Report::new(error));
            let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(text.contains(message) && text.contains(help) && text.contains("loads.toml"), "{text}");
        }
        let named = |name: &str| read(&format!("[[payload]]\nname = \"{name}\"\nmass_kg = 1\n{centre}"));
        for name in ["", " ", "a ", "none"] {
            assert!(named(name).expect_err("refused").to_string().contains("payload.name is"), "{name:?}");
        }
    }

    #[test]
    fn an_unknown_name_is_told_with_the_nearest() {
        let known = ["25 kg", "50 kg", "gripper"];
        let find = |name: &str| payload_by_name(name, known.into_iter());
        assert_eq!([find("50 kg"), find("none"), find("")], [Ok(Some(1)), Ok(None), Ok(None)]);
        assert_eq!(
            [find("0"), find("0.0"), payload_by_name("0", ["0"].into_iter())],
            [Ok(None), Ok(None), Ok(Some(0))]
        );
        assert!(find("50kg").expect_err("unknown").contains("most likely \"50 kg\""));
        assert!(find("Griper").expect_err("unknown").contains("most likely \"gripper\""));
        let nothing = payload_by_name("x", std::iter::empty()).expect_err("unknown");
        assert!(nothing.contains("this file has no [[payload]]"), "{nothing}");
        assert_eq!([edits("", "abc"), edits("kitten", "sitting"), edits("a", "A")], [3, 3, 0]);
    }
}
