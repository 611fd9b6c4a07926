//! The air and the faces, from names, units and values.

use super::SeenFile;
use super::column::{Role, SeenColumn};
use super::told::{reason, short};

/// A key of a map: with its reason, or with what is to be decided.
pub(super) enum Said {
    Key(String, String, String),
    Open(String, String, String),
}

/// Temperature, pressure and humidity.
pub(super) fn of_air(file: &SeenFile) -> Vec<Said> {
    let mut said = Vec::new();
    let entry = |column: &SeenColumn| column.entry(file.has_header);
    if let Some(column) = file.one(Role::Temperature) {
        let header = column.header.to_lowercase();
        let is_fahrenheit = ["°f", "[f]", "(f)", "degf"].iter().any(|unit| header.contains(unit));
        let (unit, why) = if is_fahrenheit {
            ("f", "; °F, as the header states".to_owned())
        } else if column.numbers.least > 200.0 {
            ("k", "; K by its size".to_owned())
        } else {
            ("c", String::new())
        };
        said.push(Said::Key(format!("temperature_{unit}"), entry(column), reason(column) + &why));
    }
    if let Some(column) = file.one(Role::Pressure) {
        said.push(pressure(column, entry(column)));
    }
    if let Some(column) = file.one(Role::Humidity) {
        let why = format!("{}; checked, but not used", reason(column));
        said.push(if column.numbers.most <= 1.0 {
            let why =
                format!("up to {}: in %, or a fraction, which a map cannot read", short(column.numbers.most));
            Said::Open("humidity_percent".to_owned(), entry(column), why)
        } else {
            Said::Key("humidity_percent".to_owned(), entry(column), why)
        });
    }
    said
}

fn pressure(column: &SeenColumn, entry: String) -> Said {
    let header = column.header.to_lowercase();
    let in_header = [("hpa", "hpa"), ("mbar", "hpa"), ("kpa", "kpa"), ("mmhg", "mmhg"), ("inhg", "inhg")];
    let stated = in_header.into_iter().find(|(word, _)| header.contains(word)).map(|(_, unit)| unit);
    let (least, most) = (column.numbers.least, column.numbers.most);
    let within = |from: f64, to: f64| least >= from && most <= to;
    // 760 can be mm of mercury at sea level, or hPa in the mountains.
    let by_size = [("hpa", 800.0, 1100.0), ("inhg", 25.0, 32.0), ("kpa", 80.0, 110.0), ("pa", 8e4, 1.1e5)];
    let by_size = by_size.into_iter().find(|(_, from, to)| within(*from, *to)).map(|(unit, ..)| unit);
    match (stated, by_size) {
        (Some(unit), _) => {
            let why = format!("{}; checked, but not used", reason(column));
            Said::Key(format!("pressure_{unit}"), entry, why)
        }
        (None, Some(unit)) => {
            let why = format!("{}; {unit} by its size; checked, but not used", reason(column));
            Said::Key(format!("pressure_{unit}"), entry, why)
        }
        (None, None) => {
            let why =
                format!("{}: in hPa, or another unit (pressure_pa, _kpa, _mmhg, _inhg)", reason(column));
            Said::Open("pressure_hpa".to_owned(), entry, why)
        }
    }
}

/// Front and back among the texts of a column, as programs write them.
pub(super) fn faces<'t>(texts: &[&'t str]) -> Option<[&'t str; 2]> {
    const PAIRS: [[&str; 2]; 5] =
        [["front", "back"], ["f1", "f2"], ["1", "2"], ["i", "ii"], ["face1", "face2"]];
    let [a, b] = texts else { return None };
    let lower = [a.to_lowercase(), b.to_lowercase()];
    PAIRS.iter().find_map(|[front, back]| {
        if lower == [*front, *back] {
            Some([*a, *b])
        } else if lower == [*back, *front] {
            Some([*b, *a])
        } else {
            None
        }
    })
}
