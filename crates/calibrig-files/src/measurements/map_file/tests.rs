//! Column maps, right and wrong.

use super::super::columns::{ColumnRef, FilePart, PolarAngle, PositionColumns, SigmaUnits, Uncertainty};
use super::super::units::{AngleUnit, LengthUnit};
use super::*;
use proptest::prelude::*;

const CARTESIAN: &str = r#"schema = "calibrig.columns/1"
[joints]
columns = ["j1", "j2"]
revolute_unit = "deg"
[position]
system = "cartesian"
unit = "mm"
x = ["xt", "-dx"]
y = ["+yt"]
z = ["zt"]
[sigma]
unit = "um"
x = "sx"
y = "sy"
z = "sz"
[columns]
pose = "No"
approach = ["a1", "a2"]
"#;

const POSE: &str = r#"schema = "calibrig.columns/1"
[joints]
columns = ["j1"]
[position]
system = "cartesian"
x = "x"
y = "y"
z = "z"
[rotation]
transform = "target_in_tracker"
form = "euler"
sequence = "zyx intrinsic"
columns = ["a", "b", "c"]
unit = "deg"
sigma = ["sa"]
sigma_unit = "rad"
[noise]
range_um = 5
transverse_um = 9
"#;

const SPHERICAL: &str = r#"schema = "calibrig.columns/1"
[joints]
columns = ["j1"]
prismatic_unit = "mm"
[position]
system = "spherical"
range = "R"
range_unit = "m"
azimuth = "Az"
zenith = "Ze"
angle_unit = "deg"
[sigma]
range = "sR"
range_unit = "um"
azimuth = "sAz"
zenith = "sZe"
angle_unit = "arcsec"
"#;

fn name(column: &ColumnRef) -> &str {
    match column {
        ColumnRef::Name(name) => name,
        ColumnRef::Number(_) => "a number",
    }
}

fn parse(text: &str) -> Result<ColumnMap, InputError> {
    parse_column_map(&Source::new("columns.toml", text))
}

#[test]
fn sums_signs_and_units_are_understood() {
    let map = parse(CARTESIAN).expect("valid");
    let mapping = map.mapping().expect("named");
    let PositionColumns::Cartesian { axes: [x, y, _], unit } = &mapping.position else { panic!("cartesian") };
    let terms = x.terms.iter().chain(&y.terms);
    let signed: Vec<_> = terms.map(|term| (name(&term.column), term.sign)).collect();
    assert_eq!((signed, *unit), (vec![("xt", 1.0), ("dx", -1.0), ("yt", 1.0)], Some(LengthUnit::Mm)));
    let Some(Uncertainty::Sigmas { columns, units, coverage }) = &mapping.uncertainty else {
        panic!("sigmas")
    };
    assert_eq!((columns[1].written.as_str(), *coverage), ("sy", 1.0));
    assert_eq!(*units, SigmaUnits::Cartesian(Some(LengthUnit::Um)));
    assert_eq!(mapping.approach.iter().map(|entry| entry.written.as_str()).collect::<Vec<_>>(), ["a1", "a2"]);
    assert_eq!(AngleUnit::Arcsec.in_si(3600.0), 1f64.to_radians());
    let map = parse(SPHERICAL).expect("valid");
    let mapping = map.mapping().expect("named");
    assert!(matches!(mapping.position, PositionColumns::Spherical { polar_angle: PolarAngle::Zenith, .. }));
    let names: Vec<_> = mapping.entries(FilePart::Whole).iter().map(|entry| entry.written.as_str()).collect();
    assert_eq!(names, ["j1", "R", "Az", "Ze", "sR", "sAz", "sZe"]);
}

#[test]
fn every_mistake_is_named_with_its_line_and_what_was_expected() {
    for (text, from, to, message, line, help) in [
        (CARTESIAN, "columns/1", "columns/9", "columns/9", 1, "columns/1"),
        (CARTESIAN, "[\"j1\", \"j2\"]", "[]", "names no columns", 2, "one column per joint"),
        (CARTESIAN, "\"j2\"", "\"j1\"", "\"j1\" is named twice", 3, "each"),
        (CARTESIAN, "\"j2\"", "\" \"", "is empty", 3, "header"),
        (CARTESIAN, "\"deg\"", "\"grad\"", "joints.revolute_unit is \"grad\"", 4, "`deg`"),
        (CARTESIAN, "revolute_unit", "unit", "unknown key `unit`", 4, "`revolute_unit`"),
        (CARTESIAN, "system = \"cartesian\"\n", "", "[position] has no system", 5, "system"),
        (CARTESIAN, "z = [\"zt\"]\n", "", "[position] has no z", 5, "z"),
        (CARTESIAN, "[\"zt\"]", "[]", "a sum without columns", 10, "at least one column"),
        (CARTESIAN, "[\"zt\"]", "[\"-\"]", "a sign without a column", 10, "header"),
        (CARTESIAN, "[\"zt\"]", "1.5", "position.z is 1.5", 10, "a signed sum"),
        (CARTESIAN, "[\"zt\"]", "0", "0 is not a column", 10, "from 1"),
        (CARTESIAN, "[\"zt\"]", "\"a + \"", "a sign without a column", 10, "header"),
        (CARTESIAN, "\"No\"", "[\"a\", \"b\"]", "is not a single column", 17, "one column"),
        (CARTESIAN, "x = \"sx\"", "k = 0\nx = \"sx\"", "k is 0", 13, "above zero"),
        (
            CARTESIAN,
            "[columns]",
            "[[target]]\nname = \"A\"\n[columns]",
            "unknown key `target`",
            16,
            "[columns]",
        ),
        (
            CARTESIAN,
            "z = [\"zt\"]",
            "z = [\"zt\"]\nrange = \"R\"",
            "range does not belong to the cartesian",
            11,
            "only the keys of the cartesian system",
        ),
        (CARTESIAN, "z = \"sz\"\n", "", "[sigma] has no z", 11, "z"),
        (
            CARTESIAN,
            "z = \"sz\"",
            "z = \"sz\"\nsystem = \"cartesian\"",
            "[sigma] uses the system of",
            16,
            "no key",
        ),
        (
            CARTESIAN,
            "[\"a1\", \"a2\"]",
            "[\"a1\"]",
            "approach names 1 columns, but [joints] names 2",
            18,
            "actuator",
        ),
        (CARTESIAN, "pose", "number", "unknown key `number`", 17, "`pose`"),
        (
            SPHERICAL,
            "\"spherical\"",
            "\"cartesian\"",
            "range does not belong",
            7,
            "only the keys of the cartesian system",
        ),
        (SPHERICAL, "zenith = \"Ze\"", "", "neither elevation nor zenith", 5, "one of"),
        (
            SPHERICAL,
            "zenith = \"Ze\"",
            "zenith = \"Ze\"\nelevation = \"El\"",
            "both elevation and zenith",
            10,
            "only one of",
        ),
        (SPHERICAL, "zenith = \"sZe\"", "elevation = \"sZe\"", "[sigma] and [position] differ", 12, "same"),
        (
            SPHERICAL,
            "angle_unit = \"deg\"",
            "unit = \"m\"",
            "unit does not belong to the spherical",
            11,
            "only the keys of the spherical system",
        ),
        (SPHERICAL, "\"arcsec\"", "\"min\"", "sigma.angle_unit is \"min\"", 17, "`arcsec`"),
    ] {
        assert!(text.contains(from), "{from}");
        match parse(&text.replacen(from, to, 1)) {
            Err(InputError::Invalid { message: found, line: at, help: expected, .. }) => {
                assert!(found.contains(message), "{from} -> {to}: {found}");
                assert!(
                    expected.as_deref().unwrap_or_default().contains(help),
                    "{from} -> {to}: {found}: {expected:?}"
                );
                assert_eq!(at, line, "{from} -> {to}: {found}");
            }
            other => panic!("{from} -> {to}: {other:?}"),
        }
    }
}

#[test]
fn the_maps_of_the_repository_are_valid() {
    for (robot, joints) in [("ur5", 6), ("wam", 7)] {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models").join(robot).join("columns.toml");
        let (map, source) = load_column_map(&path).expect("the map of the repository");
        assert_eq!(map.mapping().expect("named").joints.len(), joints);
        assert!(source.text.contains("schema"));
    }
    assert!(load_column_map(Path::new("no such map.toml")).unwrap_err().to_string().contains("no such map"));
}

/// The map in the module's documentation.
#[test]
fn the_documented_map_is_valid() {
    let documented: String = include_str!("../map_file.rs")
        .lines()
        .skip_while(|line| *line != "//! ```toml")
        .skip(1)
        .take_while(|line| *line != "//! ```")
        .flat_map(|line| [line.trim_start_matches("//!"), "\n"])
        .collect();
    let map = parse(&documented).expect_err("approaches are stated in two ways");
    assert!(
        map.to_string().contains("approach names columns, but [rows] has approach_from as well"),
        "{map}"
    );
    let documented = documented.replacen("approach = [", "# approach = [", 1);
    let map = parse(&documented).expect("as documented");
    let mapping = map.mapping().expect("named");
    assert_eq!(
        (mapping.joints.len(), mapping.entries(FilePart::Whole).len()),
        (3, 3 + 3 + 4 + 3 + 3 + 5 + 2 + 1 + 1)
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn no_mutation_of_a_map_panics(at in 0usize..400, remove in 0usize..6, insert in "\\PC{0,3}|[\"\\[\\]=.,\n-]{0,3}") {
        for text in [CARTESIAN, SPHERICAL, POSE] {
            let mut text: Vec<char> = text.chars().collect();
            let at = at.min(text.len());
            let end = (at + remove).min(text.len());
            text.splice(at..end, insert.chars());
            if let Err(error) = parse(&text.into_iter().collect::<String>()) {
                let drawn = format!("{:?}", miette::Report::new(error));
                prop_assert!(!drawn.is_empty());
            }
        }
    }
}
