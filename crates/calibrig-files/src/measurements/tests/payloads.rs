//! What the flange carries, by name and by numbers.

use super::*;

const CARTESIAN: &str =
    "[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = \"x\"\ny = \"y\"\nz = \"z\"\n";
const PLATES: &str = "[[payload]]\nname = \"25 kg\"\nmass_kg = 25.02\nx_mm = 0\ny_mm = -4\nz_mm = 118\n\
[[payload]]\nname = \"50 kg\"\nmass_kg = 50.1\nx_mm = 0\ny_mm = 0\nz_mm = 140\nforce_x_n = 12\n";
const NUMBERS: &str = "[columns]\npayload_mass_kg = \"m\"\npayload_x_mm = \"cx\"\npayload_y_mm = \"cy\"\npayload_z_mm = \"cz\"\n";

fn named(rows: &str) -> Result<LoadedMeasurements, InputError> {
    let map = map(&format!("{CARTESIAN}[columns]\npayload = \"Load\"\n{PLATES}"));
    mapped(&format!("s,t,x,y,z,Load\n{rows}"), &map)
}

fn told(error: InputError) -> String {
    let text = format!("{:?}", miette::Report::new(error));
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn payloads_by_name_are_those_of_the_map() {
    let loaded = named("1,2,3,4,5,25 kg\n1,2,3,4,5,\n1,2,3,4,5,none\n2,2,3,4,5,50 kg\n").expect("valid");
    let carried: Vec<_> = loaded.set.observations.iter().map(|o| o.payload.clone()).collect();
    let plates = Payload::of_mass("25 kg", 25.02, Vector3::new(0.0, -0.004, 0.118));
    assert_eq!(carried[..3], [Some(plates), None, None]);
    let heavy = carried[3].as_ref().expect("50 kg");
    assert_eq!((heavy.mass, heavy.force), (50.1, Vector3::new(12.0, 0.0, 0.0)));
    // The same command with another load is another pose: the robot was loaded in between.
    let poses: Vec<_> = loaded.set.observations.iter().map(|o| o.pose).collect();
    assert_eq!(poses, [1, 2, 2, 4]);
    let refused = told(named("1,2,3,4,5,25kg\n").expect_err("unknown"));
    assert!(
        refused.contains("set.csv:2: column Load is \"25kg\"") && refused.contains("most likely \"25 kg\""),
        "{refused}"
    );
}

#[test]
fn payloads_by_numbers_are_read_in_the_units_of_their_keys() {
    let read =
        |row: &str| mapped(&format!("s,t,x,y,z,m,cx,cy,cz\n{row}\n"), &map(&format!("{CARTESIAN}{NUMBERS}")));
    let payload = |row: &str| read(row).expect("valid").set.observations[0].payload.clone();
    let expected = Payload::of_mass("25 kg", 25.0, Vector3::new(0.001, -0.002, 0.1));
    assert_eq!(payload("1,2,3,4,5,25,1,-2,100"), Some(expected));
    assert_eq!([payload("1,2,3,4,5,,,,"), payload("1,2,3,4,5,0,,,")], [None, None]);
    for (row, expected) in [
        ("1,2,3,4,5,,1,2,3", "column m is empty"),
        ("1,2,3,4,5,-25,1,2,3", "column m is \"-25\""),
        ("1,2,3,4,5,25,,,", "column cx is empty"),
        ("1,2,3,4,5,25,1,x,3", "column cy is \"x\""),
        ("1,2,3,4,5,inf,1,2,3", "column m is \"inf\""),
    ] {
        let refused = told(read(row).expect_err(expected));
        assert!(refused.contains(&format!("set.csv:2: {expected}")), "{refused}");
    }
}

#[test]
fn maps_that_leave_a_payload_open_are_refused() {
    let column = "[columns]\npayload = \"Load\"\n";
    for (map, message, help) in [
        (column.to_owned(), "but the names in it", "[[payload]] with name"),
        (PLATES.to_owned(), "no column says which rows carry this payload", "payload in [columns]"),
        (format!("{NUMBERS}{PLATES}"), "payloads are given twice", "payload with [[payload]]"),
        (
            NUMBERS.replace("payload_z_mm = \"cz\"\n", ""),
            "[columns] has no payload_z_mm",
            "the key payload_z_mm",
        ),
        (
            NUMBERS.replace("payload_mass_kg = \"m\"\n", ""),
            "[columns] has no payload_mass_kg",
            "the key payload_mass_kg",
        ),
        (NUMBERS.replace("payload_mass_kg", "payload_mass"), "unknown key `payload_mass`", "payload_mass_kg"),
        (NUMBERS.replace("payload_x_mm", "payload_x"), "unknown key `payload_x`", "payload_x_mm"),
        (
            format!("{column}{}", PLATES.replace("mass_kg = 25.02\n", "")),
            "payload \"25 kg\" has no mass",
            "expected mass_kg",
        ),
        (
            format!("{column}{}", PLATES.replace("z_mm = 118\n", "")),
            "payload \"25 kg\" has no centre",
            "z_mm",
        ),
        (
            format!("{column}{PLATES}mass_factor = 1.1\n"),
            "mass_factor applies to a simulated payload",
            "of a scenario",
        ),
        (format!("{NUMBERS}payload_force_x_n = \"fx\"\n"), "[columns] has no payload_force_y_n", "the key"),
    ] {
        let text =
            format!("schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\n{CARTESIAN}{map}");
        let refused = told(crate::parse_column_map(&Source::new("map.toml", text)).expect_err(message));
        assert!(
            refused.contains(message) && refused.contains(help) && refused.contains("map.toml"),
            "{refused}"
        );
    }
}

/// Own columns say what a payload is by numbers; a name alone says nothing.
#[test]
fn own_columns_of_a_payload_call_for_mass_and_centre() {
    let read = |text: &str| parse_measurements(&Source::new("set.csv", text), &ColumnMap::default(), &KINDS);
    let loaded = read(OWN_PAYLOAD).expect("valid");
    let plates = Payload::of_mass("plates", 25.0, Vector3::new(0.0, 0.0, 0.1));
    assert_eq!([0, 1].map(|i| loaded.set.observations[i].payload.clone()), [Some(plates), None]);
    let nameless =
        told(read("q1_m,q2_rad,x_m,y_m,z_m,payload\n1,2,3,4,5,plates\n").expect_err("a name alone"));
    assert!(nameless.contains("there is a column payload, but neither payload_mass_kg nor"), "{nameless}");
    let centreless =
        told(read("q1_m,q2_rad,x_m,y_m,z_m,payload_mass_kg\n1,2,3,4,5,25\n").expect_err("no centre"));
    assert!(centreless.contains("column payload_x_m is missing"), "{centreless}");
}
