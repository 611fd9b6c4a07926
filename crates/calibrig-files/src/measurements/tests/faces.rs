//! Readings of both faces, and the air around them.

use super::*;
use std::f64::consts::{FRAC_PI_2, PI};

const SPHERICAL: &str = "[position]\nsystem = \"spherical\"\nrange = \"R\"\nrange_unit = \"m\"\nazimuth = \"Hz\"\nzenith = \"V\"\nangle_unit = \"deg\"\n";
const FACE: &str = "[face]\ncolumn = \"F\"\nfront = [\"I\", \"1\"]\nback = [\"II\", \"2\"]\n";

fn face_map(more: &str) -> ColumnMap {
    map(&format!("{SPHERICAL}{FACE}{more}"))
}

fn spherical(loaded: &LoadedMeasurements, index: usize) -> &SphericalReading {
    match &loaded.set.observations[index].reading {
        Reading::Spherical(reading) => reading,
        other => panic!("{other:?}"),
    }
}

#[test]
fn raw_angles_of_the_back_face_become_the_direction_of_the_point() {
    // The same point from four sides, with azimuths counted from -180° or from 0° and zeniths above and below.
    for (azimuth, zenith) in [(30.0, 80.0), (-150.0, 100.0), (200.0, 80.0), (0.0, 90.0)] {
        let raw = [(azimuth + 180.0) % 360.0, 360.0 - zenith];
        let text = format!("s,t,F,R,Hz,V\n1,2,I,3,{azimuth},{zenith}\n1,2,2.0,3,{},{}\n", raw[0], raw[1]);
        let loaded = mapped(&text, &face_map("")).expect("valid");
        let [front, back] = [0, 1].map(|index| spherical(&loaded, index));
        assert_eq!((front.face, back.face), (Face::Front, Face::Back));
        assert!((front.position() - back.position()).amax() < 1e-14);
        assert!((back.elevation - front.elevation).abs() < 1e-14 && back.elevation.abs() < FRAC_PI_2);
        assert!((-PI..=PI).contains(&back.azimuth), "{}", back.azimuth);
        assert!(
            loaded.remarks.iter().any(|r| r.contains("are the encoders' own, as set.csv:3 shows")),
            "{:?}",
            loaded.remarks
        );
        // Where the map says so, nothing is left to tell.
        let stated = mapped(&text, &map(&format!("{SPHERICAL}{FACE}angles = \"raw\"\n"))).expect("valid");
        assert_eq!((stated.set, stated.remarks.len()), (loaded.set, loaded.remarks.len() - 1));
    }
    let turned = mapped("s,t,F,R,Hz,V\n1,2,I,3,30,80\n1,2,II,3,30,80\n", &face_map("")).expect("valid");
    assert!(turned.remarks[0].contains("back-face angles are those of the point"), "{:?}", turned.remarks);
}

#[test]
fn what_both_faces_turn_over_is_averaged_out() {
    // A collimation error of 0.01° / sin(zenith) in the azimuth and an index of 0.02° in the zenith, and a turn between the azimuths.
    let text = "No,s,t,F,R,Hz,V,T\n1,1,2,1,3,179.99,60.02,20\n1,1,2,2,3,-179.99,59.98,22\n2,4,2,1,3,10.01,80.02,20\n2,4,2,2,3,9.99,79.98,20\n";
    let more = "angles = \"direction\"\n[columns]\npose = \"No\"\ntemperature_c = \"T\"\n[rows]\nfaces = \"average\"\n";
    let loaded = mapped(text, &face_map(more)).expect("valid");
    assert_eq!(loaded.set.observations.len(), 2);
    let first = spherical(&loaded, 0);
    assert!(
        ((first.azimuth.to_degrees() - 180.0).abs() < 1e-12)
            && (first.elevation.to_degrees() - 30.0).abs() < 1e-12
    );
    assert_eq!((first.face, loaded.set.observations[0].temperature), (Face::Both, Some(21.0)));
    assert_eq!(loaded.places.of(1), Some("set.csv:4".to_owned()));
    let told =
        loaded.remarks.iter().find(|r| r.contains("2 pairs of both faces are averaged")).expect("told");
    // 0.02° and 0.04° at 3 m, the first by the sine of the zenith.
    let size = |zenith: f64| (0.02 * zenith.to_radians().sin()).hypot(0.04).to_radians() * 3e3;
    let apart = f64::midpoint(size(60.0).powi(2), size(80.0).powi(2)).sqrt();
    assert!(told.contains(&format!("differ by {apart:.4} mm")), "{told} {apart}");
    let kept = mapped(text, &face_map(&more.replace("average", "keep"))).expect("valid");
    assert_eq!(kept.set.observations.len(), 4);
    // Repeats of one face are averaged apart from those of the other.
    let repeats = mapped(text, &face_map(&more.replace("faces", "repeats"))).expect("valid");
    assert_eq!(repeats.set.observations.len(), 4);
    let covariance = "[sigma]\nrange_unit = \"um\"\nangle_unit = \"arcsec\"\nrange = \"u\"\nazimuth = \"v\"\nzenith = \"w\"\n";
    let text = "s,t,F,R,Hz,V,u,v,w\n1,2,1,3,30,60,10,1,2\n1,2,2,3,210,300,10,1,2\n";
    let loaded =
        mapped(text, &face_map(&format!("{covariance}[rows]\nfaces = \"average\"\n"))).expect("valid");
    let sigma = spherical(&loaded, 0).covariance.expect("stated").diagonal().map(f64::sqrt);
    assert!((sigma.x - 1e-5 / 2.0_f64.sqrt()).abs() < 1e-18, "{sigma}");
}

#[test]
fn a_back_face_without_its_front_face_is_told_and_refused_where_the_mean_is_asked_for() {
    let text = "s,t,F,R,Hz,V\n1,2,I,3,30,80\n1,2,II,3,30,80\n5,2,II,3,31,80\n6,2,II,3,32,80\n";
    let loaded = mapped(text, &face_map("")).expect("valid");
    let told = loaded.remarks.iter().find(|remark| remark.contains("not in the front face")).expect("told");
    assert!(told.starts_with("set.csv:4, set.csv:5: read in the back face"), "{told}");
    let refused = mapped(text, &face_map("[rows]\nfaces = \"average\"\n")).expect_err("no front face");
    let refused = format!("{:?}", miette::Report::new(refused));
    assert!(
        refused.contains("set.csv:4: pose 3 was read in the back face, but not in the front face"),
        "{refused}"
    );
    assert!(refused.contains("faces = \"keep\""), "{refused}");
    let none =
        mapped("s,t,F,R,Hz,V\n1,2,I,3,30,80\n", &face_map("[rows]\nfaces = \"average\"\n")).expect("valid");
    assert!(none.remarks[0].contains("no reading is of the back face"), "{:?}", none.remarks);
}

#[test]
fn faces_that_contradict_their_angles_are_refused() {
    let head = "s,t,F,R,Hz,V\n";
    for (more, rows, expected) in [
        ("", "1,2,III,3,30,80\n", "set.csv:2: column F is \"III\""),
        ("", "1,2,I,3,30,280\n", "set.csv:2: column V is \"280\""),
        ("angles = \"raw\"\n", "1,2,II,3,30,80\n", "set.csv:2: column V is \"80\""),
        ("angles = \"direction\"\n", "1,2,II,3,30,280\n", "set.csv:2: column V is \"280\""),
        ("", "1,2,II,3,30,80\n2,2,II,3,30,280\n", "set.csv:3: column V is \"280\""),
    ] {
        let refused = mapped(&format!("{head}{rows}"), &face_map(more)).expect_err(expected);
        assert!(refused.to_string().contains(expected), "{refused}");
    }
    for (face, expected) in [
        ("front = [\"1\"]\n", "says which texts mean the front face, but not which mean the back"),
        ("front = [\"1\"]\nback = [1]\n", "\"1\" stands for both the front and the back face"),
        ("angles = \"turned\"\n", "angles is \"turned\""),
    ] {
        let head = "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\n";
        let text = format!("{head}{SPHERICAL}[face]\ncolumn = \"F\"\n{face}");
        let refused = parse_column_map(&Source::new("columns.toml", text)).expect_err(expected).to_string();
        assert!(refused.contains(expected), "{refused}");
    }
    let cartesian = "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\"]\n[position]\nsystem = \"cartesian\"\nx = \"x\"\ny = \"y\"\nz = \"z\"\n[face]\ncolumn = \"F\"\n";
    let refused =
        parse_column_map(&Source::new("columns.toml", cartesian)).expect_err("no angles").to_string();
    assert!(refused.contains("[face] applies to range and angles"), "{refused}");
}

#[test]
fn a_zenith_beyond_180_degrees_is_told_where_no_column_names_faces() {
    let text = "s,t,R,Hz,V\n1,2,3,30,80\n2,2,3,210,280\n3,2,3,211,280\n";
    let loaded = mapped(text, &map(SPHERICAL)).expect("valid");
    assert!(
        loaded
            .remarks
            .iter()
            .any(|r| r.starts_with("set.csv:3: an elevation beyond 90°") && r.contains("in 2 rows")),
        "{:?}",
        loaded.remarks
    );
    assert!((spherical(&loaded, 1).position() - spherical(&loaded, 0).position()).amax() < 1e-14);
}

#[test]
fn air_that_cannot_be_is_refused_with_the_unit_that_it_looks_like() {
    let columns = |keys: &str| map(&format!("{SPHERICAL}[columns]\n{keys}"));
    for (key, value, expected) in [
        ("temperature_c", "293.6", "as K it is possible: then the key in a column map is temperature_k"),
        ("temperature_k", "20.5", "as °C it is possible:"),
        ("temperature_c", "-300", "a temperature from -60 to 120 °C"),
        ("temperature_f", "294", "as K it is possible:"),
        ("pressure_hpa", "101325", "as pa it is possible; then the key is pressure_pa"),
        ("pressure_hpa", "29.92", "as inhg it is possible; then the key is pressure_inhg"),
        ("pressure_mmhg", "1013.2", "as hpa it is possible; then the key is pressure_hpa"),
        ("pressure_hpa", "3", "an air pressure from 500 to 1100 hPa"),
        ("humidity_percent", "140", "a relative humidity from 0 to 100 %"),
    ] {
        let text = format!("s,t,R,Hz,V,q\n1,2,3,30,80,{value}\n");
        let refused = mapped(&text, &columns(&format!("{key} = \"q\"\n"))).expect_err(expected);
        let refused = format!("{:?}", miette::Report::new(refused)).replace("\n        ", " ");
        assert!(refused.contains("set.csv:2: column q is"), "{refused}");
        assert!(refused.contains(expected), "{refused}");
    }
    let text = "s,t,R,Hz,V,T,P,H\n1,2,3,30,80,68,760,45\n1,3,3,30,80,,,\n";
    let loaded =
        mapped(text, &columns("temperature_f = \"T\"\npressure_mmhg = \"P\"\nhumidity_percent = \"H\"\n"))
            .expect("valid");
    let temperatures: Vec<_> = loaded.set.observations.iter().map(|o| o.temperature).collect();
    assert_eq!(temperatures, [Some(20.0), None]);
    assert!(
        loaded.remarks.iter().any(|r| r.contains("pressure_mmhg is checked, but not used")),
        "{:?}",
        loaded.remarks
    );
    for (keys, expected) in [
        ("temperature_c = \"T\"\ntemperature_k = \"U\"\n", "the temperature is given twice"),
        ("pressure_pa = \"T\"\npressure_hpa = \"U\"\n", "the pressure is given twice"),
    ] {
        let text = format!(
            "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\"]\n{SPHERICAL}[columns]\n{keys}"
        );
        let refused = parse_column_map(&Source::new("columns.toml", text)).expect_err(expected).to_string();
        assert!(refused.contains(expected), "{refused}");
    }
}
