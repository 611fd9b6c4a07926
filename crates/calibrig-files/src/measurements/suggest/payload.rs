//! Loads on the flange, from names of columns and their content.

use super::SeenFile;
use super::column::{Role, SeenColumn};
use super::names::words;
use super::surroundings::Said;
use super::told::{is_length, reason, short, unit};
use crate::input::quoted;
use crate::measurements::units::{HeaderUnit, LengthUnit};
use crate::payloads::NO_PAYLOAD;

const LOADS: [&str; 6] = ["payload", "payloads", "load", "nutzlast", "traglast", "zuladung"];
const MASSES: [&str; 4] = ["mass", "masse", "weight", "gewicht"];
/// With kilograms in one.
const MASS_UNITS: [(&str, f64); 4] = [("kg", 1.0), ("g", 1e-3), ("lb", 0.453_592_37), ("lbs", 0.453_592_37)];
const NAMES: [&str; 8] = ["name", "id", "no", "nr", "number", "case", "label", "type"];
const CENTRES: [&str; 6] = ["cog", "com", "cg", "centre", "center", "schwerpunkt"];
const AXES: [(&str, Role); 6] = [
    ("x", Role::PayloadX),
    ("y", Role::PayloadY),
    ("z", Role::PayloadZ),
    ("cx", Role::PayloadX),
    ("cy", Role::PayloadY),
    ("cz", Role::PayloadZ),
];
/// Names for a flange without a load.
const NOTHING: [&str; 8] = ["empty", "leer", "ohne", "no load", "unloaded", "without", "-", "nothing"];
/// Heavier than any load of one session.
const MOST_PAYLOADS: usize = 12;

/// What a column is of a payload, by its name.
pub(super) fn role_of(column: &SeenColumn) -> Option<Role> {
    let words = words(column.said_name());
    let has = |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()));
    let is_unit = |word: &str| MASS_UNITS.iter().any(|(unit, _)| *unit == word);
    let is_load = has(&LOADS);
    let rest: Vec<&str> = words.iter().map(String::as_str).filter(|word| !LOADS.contains(word)).collect();
    let is_mass = !rest.is_empty() && rest.iter().all(|word| MASSES.contains(word) || is_unit(word));
    // A weight alone is often that of a fit.
    let is_weighed = has(&["mass", "masse"]) || (has(&MASSES) && rest.iter().any(|word| is_unit(word)));
    if is_mass && (is_load || is_weighed) {
        let is_number = column.is_number();
        return if is_number { Some(Role::PayloadMass) } else { is_load.then_some(Role::Payload) };
    }
    if is_load && rest.iter().all(|word| NAMES.contains(word)) {
        // A motor's load has the same name.
        let is_motors = words == ["load"] && column.is_number();
        return (!is_motors).then_some(Role::Payload);
    }
    let is_filler = |word: &str| CENTRES.contains(&word) || ["of", "mass", "gravity"].contains(&word);
    let mut axes = rest.iter().filter(|word| !is_filler(word));
    let (axis, more) = (axes.next()?, axes.next());
    let role = AXES.iter().find(|(name, _)| name == axis)?.1;
    (more.is_none() && (is_load || has(&CENTRES)) && column.is_number()).then_some(role)
}

/// What a map says of payloads.
#[derive(Default)]
pub(super) struct Carried {
    /// In `[columns]`.
    pub keys: Vec<Said>,
    /// One `[[payload]]` each, by name.
    pub tables: Vec<(String, Vec<Said>)>,
}

pub(super) fn of_file(file: &SeenFile) -> Carried {
    let [x, y, z] = [Role::PayloadX, Role::PayloadY, Role::PayloadZ].map(|role| file.one(role));
    match (file.one(Role::Payload), file.one(Role::PayloadMass), x, y, z) {
        (name, Some(mass), Some(x), Some(y), Some(z)) => Carried {
            keys: numbers(file, name, mass, [("payload_x_mm", x), ("payload_y_mm", y), ("payload_z_mm", z)]),
            tables: Vec::new(),
        },
        (Some(column), ..) | (None, Some(column), ..) => by_name(file, column),
        _ => Carried::default(),
    }
}

/// kg in the unit that the name of a column states, with the unit.
fn mass_unit(column: &SeenColumn) -> Option<(&'static str, f64)> {
    let words = words(column.said_name());
    MASS_UNITS.into_iter().find(|(unit, _)| words.iter().any(|word| word == unit))
}

/// Mass and centre of every row.
fn numbers(
    file: &SeenFile,
    name: Option<&SeenColumn>,
    mass: &SeenColumn,
    centre: [(&str, &SeenColumn); 3],
) -> Vec<Said> {
    let entry = |column: &SeenColumn| column.entry(file.has_header);
    let key = |key: &str, column: &SeenColumn, why: String| {
        Said::Key(key.to_owned(), entry(column), reason(column) + &why)
    };
    let open = |key: &str, column: &SeenColumn, why: String| Said::Open(key.to_owned(), entry(column), why);
    let mut said: Vec<Said> = name.map(|column| key("payload", column, String::new())).into_iter().collect();
    said.push(match mass_unit(mass) {
        Some(("kg", _)) => key("payload_mass_kg", mass, "; kg, as its name says".to_owned()),
        Some((unit, _)) => {
            let why = format!("in {unit} by its name, but the key reads kg: convert the column");
            open("payload_mass_kg", mass, why)
        }
        None => key("payload_mass_kg", mass, "; taken for kg".to_owned()),
    });
    let largest = SeenFile::numbers_of(&centre.map(|(_, column)| column)).largest();
    for (name, column) in centre {
        said.push(match unit(column).filter(|unit| is_length(*unit)) {
            Some(HeaderUnit::Length(LengthUnit::Mm)) => {
                key(name, column, "; mm, as its name says".to_owned())
            }
            Some(other) => {
                let why = format!("in {} by its name, but the key reads mm: convert the column", other.key());
                open(name, column, why)
            }
            // No load is carried three metres from the flange, nor within 3 mm of it.
            None if largest > 3.0 => key(name, column, "; taken for mm, by their size".to_owned()),
            None => {
                let why = format!(
                    "up to {}: in m, by its size, but the key reads mm: convert the column",
                    short(largest)
                );
                open(name, column, why)
            }
        });
    }
    said
}

/// Payloads that rows name, or identify by their mass.
fn by_name(file: &SeenFile, column: &SeenColumn) -> Carried {
    let entry = column.entry(file.has_header);
    let is_none = |text: &str| text == NO_PAYLOAD || text.parse() == Ok(0.0);
    let names: Vec<&str> = column.texts().into_iter().filter(|text| !is_none(text)).collect();
    let is_mass = column.role == Some(Role::PayloadMass);
    if column.many_texts || names.len() > MOST_PAYLOADS {
        let (key, why) = if is_mass {
            (
                "payload_mass_kg",
                "many masses: needs payload_x_mm, payload_y_mm and payload_z_mm, the columns of their centres",
            )
        } else {
            ("payload", "more names than a flange would carry loads: does it name the load?")
        };
        return Carried { keys: vec![Said::Open(key.to_owned(), entry, why.to_owned())], tables: Vec::new() };
    }
    if names.is_empty() {
        return Carried::default();
    }
    let why = format!("{}: {}", column.reason, names.join(", "));
    let unit = mass_unit(column);
    let tables = names.iter().map(|name| ((*name).to_owned(), table(name, is_mass, unit))).collect();
    Carried { keys: vec![Said::Key("payload".to_owned(), entry, why)], tables }
}

/// What is known about a payload of this name, and what a person must add.
fn table(name: &str, is_mass: bool, unit: Option<(&'static str, f64)>) -> Vec<Said> {
    let open =
        |key: &str, value: &str, why: &str| Said::Open(key.to_owned(), value.to_owned(), why.to_owned());
    let lower = name.to_lowercase();
    let number = |text: &str| text.trim().replace(',', ".").parse::<f64>().ok().filter(|mass| *mass > 0.0);
    let mass = match (number(&lower), unit) {
        (Some(mass), Some(("kg", _))) => {
            Said::Key("mass_kg".to_owned(), mass.to_string(), "by its column, in kg".to_owned())
        }
        (Some(mass), Some((unit, kg))) => {
            let why = format!("from {unit}, by its column: weigh it to check");
            open("mass_kg", &short(kg * mass), &why)
        }
        (Some(mass), None) if is_mass => {
            Said::Key("mass_kg".to_owned(), mass.to_string(), "by its column, taken for kg".to_owned())
        }
        (Some(mass), None) => open(
            "mass_kg",
            &mass.to_string(),
            "in kg, or only a number in the load's name: weigh it to check",
        ),
        (None, _) => match lower.strip_suffix("kg").and_then(number) {
            Some(mass) => open("mass_kg", &mass.to_string(), "by its name: weigh it to check"),
            None if NOTHING.contains(&lower.as_str()) => {
                let why = format!(
                    "where {} means no load, write \"none\" or 0 in the file instead, and delete this [[payload]]",
                    quoted(name)
                );
                open("mass_kg", "0", &why)
            }
            None => open("mass_kg", "0", "weigh it"),
        },
    };
    vec![
        mass,
        open("x_mm", "0", "its centre of mass in the flange frame, which no column gives"),
        open("y_mm", "0", "the same"),
        open("z_mm", "0", "the same"),
    ]
}
