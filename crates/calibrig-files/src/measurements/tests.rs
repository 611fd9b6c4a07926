//! Files of measurements as they were read since the first version.

use std::path::Path;

mod faces;
mod payloads;
mod poses;

use super::*;
use crate::input::{InputError, Source};
use crate::robot::tests::base_from_flange;
use crate::{Robot, load_robot};
use calibrig_model::geometry::{Transform, best_fit_transform, cross_matrix, small_displacement};
use calibrig_model::measurement::{
    Face, MeasurementSet, Observation, PoseReading, Reading, SphericalReading, Station, Target,
};
use calibrig_model::{JointKind, Payload};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Point3, Rotation3, Vector3, Vector6};
use proptest::prelude::*;

const KINDS: [JointKind; 2] = [JointKind::Prismatic, JointKind::Revolute];

const OWN: &str = "pose,station,target,q1_m,q2_rad,range_m,az_rad,el_rad,sigma_range_m,sigma_az_rad,sigma_el_rad,time_s,temperature_c,approach1,approach2\n\
7,front,smr,0.5,-1.25,3.5,0.25,-0.125,1e-5,2e-6,3e-6,12.5,21.5,1,-1\n\
8,back,smr,0.75,1.25,4.5,0.5,0.125,1e-5,2e-6,3e-6,14.5,,0,0\n";

fn own(text: &str) -> Result<LoadedMeasurements, InputError> {
    parse_measurements(&Source::new("set.csv", text), &ColumnMap::default(), &KINDS)
}

fn map(text: &str) -> ColumnMap {
    let head = "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\nrevolute_unit = \"deg\"\nprismatic_unit = \"mm\"\n";
    parse_column_map(&Source::new("columns.toml", format!("{head}{text}"))).expect("a valid map")
}

fn mapped(text: &str, map: &ColumnMap) -> Result<LoadedMeasurements, InputError> {
    parse_measurements(&Source::new("set.csv", text), map, &KINDS)
}

#[test]
fn a_map_of_other_columns_does_not_keep_own_columns_from_being_read() {
    let map =
        map("[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = [\"x\"]\ny = [\"y\"]\nz = [\"z\"]\n");
    let refused = mapped(OWN, &map).expect_err("an explicit map is what holds");
    assert!(refused.to_string().contains("column s is missing"), "{refused}");
    let either = map.or_own();
    assert_eq!(mapped(OWN, &either).expect("own columns"), own(OWN).expect("valid"));
    let theirs = mapped("s,t,x,y,z,q1_m\n1000,180,1,2,3,4\n", &either).expect("mapped columns");
    assert_eq!(theirs.set.observations[0].command, [1.0, std::f64::consts::PI]);
    let neither = mapped("s1,t1,x,y,z\n1,2,3,4,5\n", &either).expect_err("no such columns");
    assert!(neither.to_string().contains("column s is missing"), "{neither}");
}

#[test]
fn own_columns_are_read() {
    let loaded = own(OWN).expect("valid");
    let set = &loaded.set;
    assert_eq!(set.stations.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["front", "back"]);
    assert_eq!(set.targets.len(), 1);
    assert_eq!((set.targets[0].in_flange, set.targets[0].covariance), (Vector3::zeros(), None));
    let first = &set.observations[0];
    assert_eq!(
        (first.pose, first.command.as_slice(), first.approach.as_slice()),
        (7, &[0.5, -1.25][..], &[1, -1][..])
    );
    assert_eq!((first.time, first.temperature, first.station, first.target), (12.5, Some(21.5), 0, 0));
    let Reading::Spherical(reading) = &first.reading else { panic!("spherical") };
    assert_eq!((reading.range, reading.azimuth, reading.elevation), (3.5, 0.25, -0.125));
    assert_eq!(
        reading.covariance.expect("stated"),
        Matrix3::from_diagonal(&Vector3::new(1e-5 * 1e-5, 2e-6 * 2e-6, 3e-6 * 3e-6))
    );
    assert_eq!((set.observations[1].station, set.observations[1].temperature), (1, None));
    assert!(loaded.dropped.is_empty());
}

#[test]
fn a_minimal_own_file_is_enough() {
    let loaded = own("q1_m;q2_rad;x_m;y_m;z_m\n1;2;3;4;5\n").expect("valid");
    let observation = &loaded.set.observations[0];
    assert_eq!((observation.pose, observation.time, observation.approach.as_slice()), (1, 0.0, &[0, 0][..]));
    assert_eq!(
        observation.reading,
        Reading::Cartesian { position: Vector3::new(3.0, 4.0, 5.0), covariance: None }
    );
    assert_eq!((loaded.set.stations.len(), loaded.set.targets.len()), (1, 1));
}

#[test]
fn exports_with_comments_other_delimiters_and_units_are_read() {
    let cartesian = map(
        "[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = [\"x t\", \"dx\"]\ny = [\"y\", \"-dy\"]\nz = [\"z\"]\n[columns]\npose = \"No\"\n",
    );
    for text in [
        "// exported\n# mm\n\"No\",s,t,x t,dx,y,dy,z\n3,500,90,1000,1,2000,2,3000\n",
        "No;s;t;x t;dx;y;dy;z;\r\n3.0; 500 ;90;1000;1;2000;2;3000;\r\n",
        "No\ts\tt\tx t\tdx\ty\tdy\tz\n\n3\t500\t90\t1000\t1\t2000\t2\t3000",
        "\u{feff}No s   t \"x t\" dx y dy z\n  3 500 90 1e3 1 2e3 2 3e3\n",
    ] {
        let loaded = mapped(text, &cartesian).expect("valid");
        let observation = &loaded.set.observations[0];
        assert_eq!(
            (observation.pose, observation.command.as_slice()),
            (3, &[0.5, std::f64::consts::FRAC_PI_2][..]),
            "{text}"
        );
        assert_eq!(observation.reading.position(), Vector3::new(1.001, 1.998, 3.0), "{text}");
    }
    let spherical = map(
        "[position]\nsystem = \"spherical\"\nrange = \"R\"\nrange_unit = \"mm\"\nazimuth = \"Az\"\nzenith = \"Ze\"\nangle_unit = \"deg\"\n\
    [sigma]\nrange = \"sR\"\nrange_unit = \"um\"\nazimuth = \"sA\"\nzenith = \"sZ\"\nangle_unit = \"arcsec\"\n",
    );
    let loaded = mapped("s,t,R,Az,Ze,sR,sA,sZ\n0,0,2000,90,60,10,1,2\n0,0,2000,90,60,,,\n", &spherical)
        .expect("valid");
    let expected = Vector3::new(0.0, 2.0 * 60f64.to_radians().sin(), 1.0);
    for observation in &loaded.set.observations {
        assert!((observation.reading.position() - expected).norm() < 1e-15);
    }
    let Reading::Spherical(reading) = &loaded.set.observations[0].reading else { panic!("spherical") };
    assert!((reading.elevation - 30f64.to_radians()).abs() < 1e-15);
    let sigmas = reading.covariance.expect("stated").diagonal().map(f64::sqrt);
    let arcsec = std::f64::consts::PI / 648_000.0;
    assert!((sigmas - Vector3::new(10e-6, arcsec, 2.0 * arcsec)).norm() < 1e-18);
    // What states no uncertainty keeps its angles, to the bit.
    let unstated = SphericalReading { covariance: None, ..reading.clone() };
    assert_eq!(loaded.set.observations[1].reading, Reading::Spherical(unstated));
    assert_eq!(loaded.set.observations[1].reading.position(), reading.position());
}

#[test]
fn covariances_that_no_scatter_has_are_refused_at_their_row() {
    let head = "q1_m,q2_rad,x_m,y_m,z_m,cov_xx_m2,cov_xy_m2,cov_xz_m2,cov_yy_m2,cov_yz_m2,cov_zz_m2\n\
            0,0,1,0,0,4e-10,1e-10,0,1e-10,0,1e-10\n";
    for (row, message, place) in [
        ("4e-10,2.1e-10,0,1e-10,0,1e-10", "cov_zz_m2 is not positive definite", "4e-10"),
        ("4e-10,1.99999999999999e-10,0,1e-10,0,1e-10", "cov_zz_m2 is not positive definite", "4e-10"),
        ("4e-10,0,0,0,0,1e-10", "cov_yy_m2 is \"0\": a variance of 0 was read", "0"),
        ("4e-10,0,0,1e-10,0,-1e-10", "cov_zz_m2 is \"-1e-10\"", "-1e-10"),
    ] {
        let text = format!("{head}0,0,2,0,0,{row}\n");
        match own(&text) {
            Err(InputError::Invalid { message: found, line: 3, span, source_code, .. }) => {
                assert!(found.contains(message), "{found}");
                assert_eq!(&source_code.inner().text()[span.offset()..span.offset() + span.len()], place);
            }
            other => panic!("{row}: {other:?}"),
        }
    }
    own(head).expect("a correlation of one half");
}

#[test]
fn missed_shots_are_left_out_and_reported() {
    let loaded = own("pose,q1_m,q2_rad,range_m,az_rad,el_rad\n4,0,0,0,0,0\n5,0,0,1,0,0\n").expect("valid");
    assert_eq!(loaded.dropped.iter().map(|(pose, _)| *pose).collect::<Vec<_>>(), [4]);
    assert!(loaded.dropped[0].1.contains("missed shot"));
    assert_eq!(loaded.set.observations.len(), 1);
    let loaded = own("q1_m,q2_rad,x_m,y_m,z_m\n0,0,1,0,0\n0,0,0,0,-0.0\n").expect("valid");
    assert_eq!((loaded.set.observations.len(), loaded.dropped[0].0), (1, 2));
}

#[test]
fn every_mistake_is_named_with_its_line_and_what_was_expected() {
    for (from, to, message, line, help, underlined) in [
        (OWN, "", "the file is empty", 1, "names of the columns", ""),
        (OWN, "# nothing\n\n", "the file is empty", 1, "names of the columns", ""),
        (
            &OWN[..OWN.find('\n').unwrap()],
            "1,2,3,4,5,6,7,8",
            "the header is missing",
            1,
            "first line",
            "1,2,3,4,5,6,7,8",
        ),
        (&OWN[OWN.find('\n').unwrap()..], "\n\n,,,,\n", "no measurements below the header", 1, "row", "pose"),
        ("q2_rad", "q2_deg", "column q2_rad is missing", 1, "found pose, station", "pose"),
        ("temperature_c", "el_rad", "column el_rad appears twice", 1, "distinct", "pose"),
        ("sigma_az_rad", "sigma_azimuth", "column sigma_az_rad is missing", 1, "found", "pose"),
        ("approach2", "approach", "column approach2 is missing", 1, "found", "pose"),
        (
            "time_s",
            "q3_rad",
            "there is a column q3_rad, but the robot has 2 joints",
            1,
            "own columns",
            "pose",
        ),
        ("time_s", "x_m", "both x_m", 1, "own columns", "pose"),
        ("time_s", "cov_az_az_rad2", "both sigma and cov", 1, "own columns", "pose"),
        ("0.5,-1.25", "0.5,left", "column q2_rad is \"left\"", 2, "a number", "left"),
        ("0.5,-1.25", "\"0,5\",-1.25", "column q1_m is \"0,5\"", 2, "decimal point", "\"0,5\""),
        ("0.5,-1.25", "0.5,", "column q2_rad is empty", 2, "a number", "7,front"),
        ("0.5,-1.25", "0.5,NaN", "column q2_rad is \"NaN\"", 2, "finite", "NaN"),
        ("4.5,0.5", "-inf,0.5", "column range_m is \"-inf\"", 3, "finite", "-inf"),
        ("4.5,0.5", "1e999,0.5", "column range_m is \"1e999\"", 3, "finite", "1e999"),
        ("4.5,0.5", "-4.5,0.5", "column range_m is \"-4.5\"", 3, "above zero", "-4.5"),
        ("7,front", "-7,front", "column pose is \"-7\"", 2, "whole number", "-7"),
        ("7,front", "7.5,front", "column pose is \"7.5\"", 2, "whole number", "7.5"),
        ("7,front", "4294967296,front", "column pose", 2, "whole number", "4294967296"),
        ("1,-1\n", "1,2\n", "column approach2 is \"2\"", 2, "-1, 0 or 1", "2"),
        ("1,-1\n", "1\n", "the row has 14 of 15 columns; approach2 is missing", 2, "15 values", "7,front"),
        ("1,-1\n", "1,-1,5\n", "the row has 16 columns, the header 15", 2, "15 values", "5"),
        ("7,front", "P7,front", "column pose is \"P7\"", 2, "holds names, do not use it as the pose", "P7"),
        ("1,-1\n", "1,left\n", "column approach2 is \"left\"", 2, "-1, 0 or 1", "left"),
        ("2e-6", "-2e-6", "column sigma_az_rad is \"-2e-6\"", 2, "deviation above zero", "-2e-6"),
        ("2e-6", "NaN", "column sigma_az_rad is \"NaN\"", 2, "finite", "NaN"),
        (
            "2e-6",
            "0.000",
            "sigma_az_rad is \"0.000\": a standard deviation of 0 was read",
            2,
            "rounds",
            "0.000",
        ),
        ("2e-6", "1e-200", "sigma_az_rad is \"1e-200\": a variance of 0 was read", 2, "empty", "1e-200"),
        ("2e-6", "2e200", "column sigma_az_rad is \"2e200\"", 2, "size", "2e200"),
        (",3e-6", ",", "column sigma_el_rad is empty", 2, "number", "7,front"),
        ("front", "\"front", "the quote is not closed", 2, "pairs", "\"front"),
    ] {
        assert!(OWN.contains(from), "{from}");
        let text = OWN.replacen(from, to, 1);
        match own(&text) {
            Err(InputError::Invalid { message: found, line: at, help: expected, span, source_code }) => {
                assert!(found.contains(message), "{to}: {found}");
                assert!(expected.as_deref().unwrap_or_default().contains(help), "{to}: {expected:?}");
                assert_eq!(at, line, "{to}: {found}");
                let place = &source_code.inner().text()[span.offset()..span.offset() + span.len()];
                assert!(place.starts_with(underlined), "{to}: {place}");
            }
            other => panic!("{to}: {other:?}"),
        }
    }
}

#[test]
fn a_map_that_does_not_fit_the_robot_is_refused() {
    let position =
        "[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = [\"x\"]\ny = [\"y\"]\nz = [\"z\"]\n";
    let text = Source::new("set.csv", "s,t,x,y,z\n1,2,3,4,5\n");
    let refusal = |map: &ColumnMap, joints: &[JointKind]| {
        parse_measurements(&text, map, joints).unwrap_err().to_string()
    };
    let both = map(position);
    assert!(
        refusal(&both, &[JointKind::Revolute; 3])
            .contains("names 2 joint columns, but the robot has 3 joints")
    );
    let no_units = format!("schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\n{position}");
    let no_units = parse_column_map(&Source::new("columns.toml", no_units)).expect("valid");
    assert!(refusal(&no_units, &[JointKind::Revolute; 2]).contains("missing key `revolute_unit`"));
    assert!(refusal(&no_units, &[JointKind::Prismatic; 2]).contains("missing key `prismatic_unit`"));
}

#[test]
fn absent_files_and_folders_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let read = |path: &Path| read_measurements(path, &ColumnMap::default(), &KINDS).unwrap_err().to_string();
    assert!(read(&folder.path().join("absent.csv")).contains("absent.csv"));
    assert!(read(folder.path()).contains("folder"));
    let set = own(OWN).unwrap().set;
    let error = write_measurements(folder.path(), &set, &KINDS).unwrap_err();
    assert!(error.to_string().starts_with("cannot write"), "{error}");
    // The CLI prints it with the source underlined.
    let path = folder.path().join("bad.csv");
    std::fs::write(&path, OWN.replace("-1.25", "left")).unwrap();
    let error = read_measurements(&path, &ColumnMap::default(), &KINDS).unwrap_err();
    let drawn = format!("{:?}", miette::Report::new(error));
    assert!(
        drawn.contains("bad.csv:2: column q2_rad is \"left\"") && drawn.contains("7,front,smr"),
        "{drawn}"
    );
}

#[test]
fn sets_that_could_not_be_read_back_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set.csv");
    let good = own(OWN).unwrap().set;
    let refusal = |change: &dyn Fn(&mut MeasurementSet)| {
        let mut set = good.clone();
        change(&mut set);
        write_measurements(&path, &set, &KINDS).unwrap_err()
    };
    assert!(
        matches!(refusal(&|s| s.observations[1].command[1] = f64::NAN), CsvError::NotFinite { pose: 8, column, .. } if column == "q2_rad")
    );
    assert!(
        matches!(refusal(&|s| s.observations[0].time = f64::INFINITY), CsvError::NotFinite { column, .. } if column == "time_s")
    );
    assert!(matches!(
        refusal(&|s| s.observations[0].command.push(1.0)),
        CsvError::JointCount { pose: 7, found: 3, expected: 2, .. }
    ));
    assert!(matches!(
        refusal(&|s| s.observations[0].approach.clear()),
        CsvError::JointCount { found: 0, .. }
    ));
    assert!(matches!(
        refusal(&|s| s.observations[0].approach[0] = 2),
        CsvError::Approach { pose: 7, value: 2 }
    ));
    assert!(matches!(
        refusal(&|s| s.observations[1].station = 2),
        CsvError::Missing { pose: 8, index: 2, .. }
    ));
    assert!(matches!(refusal(&|s| s.targets.clear()), CsvError::Missing { what: "target", .. }));
    for name in ["back", " front", "fr\nont"] {
        assert!(matches!(
            refusal(&|s| s.stations[0].name = name.to_owned()),
            CsvError::Name { what: "station", .. }
        ));
    }
    let position = Vector3::x();
    let mixed = refusal(&|s| s.observations[1].reading = Reading::Cartesian { position, covariance: None });
    assert!(matches!(mixed, CsvError::MixedReadings { pose: 8 }));
    assert!(!path.exists());
}

fn finite() -> impl Strategy<Value = f64> {
    any::<f64>().prop_filter("finite", |number| number.is_finite())
}

/// A full pose whose covariance is what six scales make of a triangle.
fn pose(place: [f64; 3], turn: [f64; 3], c: [f64; 6], (diagonal, stated): (bool, bool)) -> Reading {
    let factor = Matrix6::from_fn(|i, j| match (i, j) {
        (i, j) if i == j => 1e-5 + c[i].abs(),
        (i, j) if i > j && !diagonal => c[i] * c[j],
        _ => 0.0,
    });
    let covariance = if diagonal { factor.component_mul(&factor) } else { factor * factor.transpose() };
    // Rounding leaves a product not quite symmetric.
    let covariance = Matrix6::from_fn(|i, j| covariance[(i.min(j), i.max(j))]);
    Reading::Pose(Box::new(PoseReading {
        position: place.into(),
        rotation: Rotation3::new(turn.into()),
        covariance: stated.then_some(covariance),
    }))
}

fn payload() -> impl Strategy<Value = Payload> {
    let vector = || prop::array::uniform3(finite()).prop_map(Vector3::from);
    ("p[a-z ,;\"#é0-9]{0,5}x", 0.0f64..=1e6, vector(), vector())
        .prop_map(|(name, mass, centre, force)| Payload { name, mass, centre, force })
}

fn observation(kind: u8, diagonal: bool) -> impl Strategy<Value = Observation> {
    let parts = (
        (any::<u32>(), prop::collection::vec(finite(), 2), prop::collection::vec(-1i8..=1, 2)),
        (
            prop::option::of(-60.0f64..=120.0),
            finite(),
            prop::array::uniform3(finite()),
            prop::array::uniform6(-1e-3f64..1e-3),
        ),
        (any::<bool>(), any::<bool>(), prop::array::uniform3(-3.0f64..3.0)),
        prop::option::of(payload()),
    );
    parts.prop_map(
        move |(
            (number, command, approach),
            (temperature, time, place, c),
            (stated, is_back, turn),
            payload,
        )| {
            let c = c.map(|value| value + f64::copysign(1e-9, value));
            let covariance = if diagonal {
                Matrix3::from_diagonal(&Vector3::new(c[0] * c[0], c[1] * c[1], c[2] * c[2]))
            } else {
                // A diagonal that outweighs its rows makes it positive definite.
                let least = c[1].abs() + c[2].abs() + c[4].abs();
                let [x, y, z] = [c[0], c[3], c[5]].map(|value| least + value.abs());
                Matrix3::new(x, c[1], c[2], c[1], y, c[4], c[2], c[4], z)
            };
            let [x, y, z] = place;
            let reading = if kind == 2 {
                let place = [x, y, if place == [0.0; 3] { 1.0 } else { z }];
                pose(place, turn, c.map(|value| value - f64::copysign(1e-9, value)), (diagonal, stated))
            } else if kind == 0 {
                let range = x.abs().max(f64::MIN_POSITIVE);
                Reading::Spherical(SphericalReading {
                    face: if is_back { Face::Back } else { Face::Front },
                    range,
                    azimuth: y,
                    elevation: z,
                    covariance: stated.then_some(covariance),
                })
            } else {
                let position = Vector3::new(x, y, if (x, y, z) == (0.0, 0.0, 0.0) { 1.0 } else { z });
                Reading::Cartesian { position, covariance: stated.then_some(covariance) }
            };
            Observation {
                pose: number,
                // Some tell it, some do not.
                since_reversal: if number.is_multiple_of(2) {
                    command.iter().map(|q| q.abs()).collect()
                } else {
                    Vec::new()
                },
                command,
                approach,
                temperature,
                time,
                station: 0,
                target: 0,
                payload,
                reading,
            }
        },
    )
}

fn set() -> impl Strategy<Value = MeasurementSet> {
    (0u8..3, any::<bool>()).prop_flat_map(|(kind, diagonal)| {
        let observations = prop::collection::vec(observation(kind, diagonal), 1..6);
        (observations, "[a-z ,;\"#/.é0-9]{0,8}", "[A-Z]{1,3}").prop_map(
            |(mut observations, station, target)| {
                // The second half was taken from a second station.
                let half = observations.len().div_ceil(2);
                let mut stations = vec![Station { name: station.trim().to_owned(), ..Station::default() }];
                if half < observations.len() {
                    stations.push(Station { name: "second".to_owned(), ..Station::default() });
                    observations[half..].iter_mut().for_each(|o| o.station = 1);
                }
                let targets = vec![Target {
                    name: target,
                    in_flange: Vector3::zeros(),
                    covariance: None,
                    orientation: None,
                }];
                MeasurementSet { stations, targets, observations }
            },
        )
    })
}

/// Equality of bits, which `==` is not for zeros; `Debug` prints the sign of a zero and shortest digits that tell numbers apart.
fn bits(set: &MeasurementSet) -> String {
    format!("{set:?}")
}

fn ur5_map() -> ColumnMap {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/ur5/columns.toml");
    crate::load_column_map(&path).expect("the map of the repository").0
}

const OWN_PAYLOAD: &str = "q1_m,q2_rad,x_m,y_m,z_m,payload,payload_mass_kg,payload_x_m,payload_y_m,payload_z_m\n\
0.5,-1.25,3.5,0.25,-0.125,plates,25,0,0,0.1\n0.6,-1.25,3.5,0.25,-0.125,,,,,\n";
const OWN_POSE: &str = "q1_m,q2_rad,x_m,y_m,z_m,r11,r12,r13,r21,r22,r23,r31,r32,r33,sigma_x_m,sigma_y_m,sigma_z_m,sigma_rx_rad,sigma_ry_rad,sigma_rz_rad\n\
0.5,-1.25,3.5,0.25,-0.125,0,-1,0,1,0,0,0,0,1,1e-5,2e-6,3e-6,1e-5,2e-6,3e-6\n0.6,-1.25,3.5,0.25,-0.125,1,0,0,0,1,0,0,0,1,,,,,,\n";
const FACES: &str = "s,t,F,R,Hz,V,P\n1,2,I,3,30,80,1013\n1,2,II,3,210,280,\n3,4,II,2,211,281,990\n";
const FACES_MAP: &str = "[position]\nsystem = \"spherical\"\nrange = \"R\"\nrange_unit = \"m\"\nazimuth = \"Hz\"\nzenith = \"V\"\nangle_unit = \"deg\"\n\
[face]\ncolumn = \"F\"\nfront = [\"I\"]\nback = [\"II\"]\n[columns]\npressure_hpa = \"P\"\n";
const INVERSE: &str =
    "s,t,x,y,z,a,b,c,sr\n1,2,3000,100,-20,0.1,0.2,0.3,1e-4\n2,2,3000,100,-20,-0.1,0.2,3.3,\n";
const INVERSE_MAP: &str = "[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = \"x\"\ny = \"y\"\nz = \"z\"\n[rotation]\ntransform = \"tracker_in_target\"\n\
form = \"rotation_vector\"\nunit = \"rad\"\ncolumns = [\"a\", \"b\", \"c\"]\nsigma = \"sr\"\nsigma_unit = \"rad\"\n[noise]\nrange_um = 5\ntransverse_um = 9\nrotation_urad = 30\n";

const UR5_FILE: &str = "step_order,x_t,y_t,z_t,x_dif,y_dif,z_dif,joint_1,joint_2,joint_3,joint_4,joint_5,joint_6\n\
0,-430.3,-6.2,-98.6,-2.1,-3.5,0.8,-22.9,-43.7,135.4,-94.7,55.4,-5.5\n1,-463.7,-3.9,-104.9,-2.1,-2.9,-0.03,-19.7,-45.9,127.6,-71.4,63.3,-12.7\n";

proptest! {
#![proptest_config(ProptestConfig::with_cases(400))]
#[test]
fn what_is_written_reads_back_to_the_same_bits(set in set()) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set.csv");
    write_measurements(&path, &set, &KINDS).unwrap();
    let loaded = read_measurements(&path, &ColumnMap::default(), &KINDS).unwrap();
    prop_assert_eq!(bits(&loaded.set), bits(&set));
    prop_assert!(loaded.dropped.is_empty());
}

#[test]
fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set.csv");
    std::fs::write(&path, &bytes).unwrap();
    prop_assert!(read_measurements(&path, &ColumnMap::default(), &KINDS).is_err());
    let text = Source::new("set.csv", String::from_utf8_lossy(&bytes));
    prop_assert!(parse_measurements(&text, &ur5_map(), &[JointKind::Revolute; 6]).is_err());
}

#[test]
fn no_mutation_of_a_file_panics(
    at in 0usize..400, remove in 0usize..40, insert in "\\PC{0,4}|[\",;\t\r\n #/]{0,6}|nan|inf|1e308|-|0"
) {
    for (text, map, joints) in [
        (OWN, ColumnMap::default(), &KINDS[..]),
        (UR5_FILE, ur5_map(), &[JointKind::Revolute; 6]),
        (OWN_POSE, ColumnMap::default(), &KINDS[..]),
        (OWN_PAYLOAD, ColumnMap::default(), &KINDS[..]),
        (FACES, map(FACES_MAP), &KINDS[..]),
        (INVERSE, map(INVERSE_MAP), &KINDS[..]),
    ] {
        let mut text: Vec<char> = text.chars().collect();
        let at = at.min(text.len());
        let end = (at + remove).min(text.len());
        text.splice(at..end, insert.chars());
        let source = Source::new("set.csv", text.into_iter().collect::<String>());
        match parse_measurements(&source, &map, joints) {
            Ok(loaded) => {
                for observation in &loaded.set.observations {
                    prop_assert_eq!(observation.command.len(), joints.len());
                    prop_assert!(observation.command.iter().all(|q| q.is_finite()));
                    prop_assert!(observation.reading.position().iter().all(|x| x.is_finite()));
                }
            }
            Err(error) => {
                let drawn = format!("{:?}", miette::Report::new(error));
                prop_assert!(!drawn.is_empty());
            }
        }
    }
}
}

/// Positions of the real data are compared with the nominal robot after a fit of base and target alone.
struct RealData {
    robot: Robot,
    fitted_on: MeasurementSet,
    tested_on: MeasurementSet,
}

/// `None`, said aloud, where the data are not at hand.
fn real_data(robot: &str, folder: &str) -> Option<RealData> {
    let Some(data) = std::env::var_os("CALIBRIG_DATA") else {
        eprintln!("SKIPPED: CALIBRIG_DATA is not set, the {folder} measurements are not read");
        return None;
    };
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models").join(robot).join("robot.toml");
    let robot = load_robot(&file).expect("the model of the repository");
    let columns = robot.sources.iter().find(|(role, _)| role == "columns").expect("named by robot.toml");
    let map = parse_column_map(&columns.1).expect("the map of the repository");
    let kinds: Vec<_> = robot.model.kinematics.links.iter().map(|link| link.kind).collect();
    let read = |name: &str| {
        let file = format!("3D_{folder}_uncalibrated_{name}_cleaned.csv");
        let loaded =
            read_measurements(&Path::new(&data).join("ur5_wam").join(folder).join(file), &map, &kinds);
        let loaded = loaded.unwrap_or_else(|e| panic!("{:?}", miette::Report::new(e)));
        assert!(loaded.dropped.is_empty());
        loaded.set
    };
    let (fitted_on, tested_on) = (read("grid"), read("random"));
    Some(RealData { robot, fitted_on, tested_on })
}

impl RealData {
    /// RMS and largest 3-D error on the test set, m, with base and target fitted by Gauss-Newton.
    fn nominal_error(&self) -> (f64, f64) {
        let chain = &self.robot.model.kinematics;
        let observations = &self.fitted_on.observations;
        let seen: Vec<_> = observations.iter().map(|o| o.reading.position()).collect();
        let flange: Vec<_> =
            observations.iter().map(|o| base_from_flange(chain, &o.command).translation.vector).collect();
        let mut tracker_from_base: Transform = best_fit_transform(&seen, &flange).expect("points in space");
        let mut target = Vector3::zeros();
        let error = |frame: &Transform, target: &Vector3<f64>, o: &Observation| {
            frame.rotation.inverse() * (o.reading.position() - frame.translation.vector)
                - (base_from_flange(chain, &o.command) * Point3::from(*target)).coords
        };
        for _ in 0..10 {
            let mut jacobian = DMatrix::zeros(3 * observations.len(), 9);
            let mut residual = DVector::zeros(3 * observations.len());
            for (row, o) in observations.iter().enumerate() {
                let flange = base_from_flange(chain, &o.command);
                let carried = cross_matrix(&(flange * Point3::from(target)).coords);
                let columns = [Matrix3::identity(), -carried, *flange.rotation.matrix()];
                for (at, block) in columns.iter().enumerate() {
                    jacobian.fixed_view_mut::<3, 3>(3 * row, 3 * at).copy_from(block);
                }
                residual.fixed_rows_mut::<3>(3 * row).copy_from(&error(&tracker_from_base, &target, o));
            }
            let step = jacobian.svd(true, true).solve(&residual, 1e-12).expect("both factors");
            tracker_from_base *= small_displacement(&Vector6::from_column_slice(&step.as_slice()[..6]));
            target += Vector3::new(step[6], step[7], step[8]);
        }
        let errors: Vec<f64> = self
            .tested_on
            .observations
            .iter()
            .map(|o| error(&tracker_from_base, &target, o).norm())
            .collect();
        let mean_square = errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64;
        (mean_square.sqrt(), errors.into_iter().fold(0.0, f64::max))
    }
}

/// Reference figures of an independent program on the same data: RMS 0.561 mm, largest 1.14 mm.
#[test]
fn the_ur5_data_are_as_far_from_the_nominal_robot_as_known() {
    let Some(data) = real_data("ur5", "UR5") else { return };
    assert_eq!((data.fitted_on.observations.len(), data.tested_on.observations.len()), (1000, 20));
    let first = &data.fitted_on.observations[0];
    assert_eq!(first.pose, 0);
    assert!((first.command[0] + 22.933_297_010_882_566_f64.to_radians()).abs() < 1e-15);
    assert!(
        (first.reading.position().x - (-0.430_327_840_758_850_1 - 0.002_144_122_241_149_887)).abs() < 1e-15
    );
    let (rms, largest) = data.nominal_error();
    eprintln!("UR5: RMS {:.4} mm, largest {:.3} mm", rms * 1e3, largest * 1e3);
    assert!((rms - 0.561e-3).abs() < 0.5e-6 && (largest - 1.14e-3).abs() < 5e-6, "{rms} {largest}");
}

/// Reference figures of an independent program on the same data: RMS 4.66 mm, largest 10.5 mm.
#[test]
fn the_wam_data_are_as_far_from_the_nominal_robot_as_known() {
    let Some(data) = real_data("wam", "WAM") else { return };
    assert_eq!((data.fitted_on.observations.len(), data.tested_on.observations.len()), (216, 20));
    let (rms, largest) = data.nominal_error();
    eprintln!("WAM: RMS {:.3} mm, largest {:.2} mm", rms * 1e3, largest * 1e3);
    assert!((rms - 4.66e-3).abs() < 5e-6 && (largest - 10.5e-3).abs() < 5e-5, "{rms} {largest}");
}

#[test]
fn a_line_in_which_the_file_ends_is_dropped_and_told() {
    let head = "q1_m,q2_rad,x_m,y_m,z_m\n0,0,1,2,3\n";
    let loaded = own(&format!("{head}0.1,0,1,2")).expect("read");
    assert_eq!((loaded.set.observations.len(), loaded.dropped.len()), (1, 1));
    assert!(
        loaded.dropped[0].1.contains("breaks off in this line, which has 4 of 5 columns"),
        "{:?}",
        loaded.dropped
    );
    // In front of other lines, or with an end, it is an error.
    for rest in ["0.1,0,1,2\n", "0.1,0,1,2\n0,0,1,2,3"] {
        assert!(own(&format!("{head}{rest}")).unwrap_err().to_string().contains("4 of 5 columns"));
    }
}

#[test]
fn delimiters_at_the_end_of_lines_make_no_columns() {
    for text in [
        "q1_m,q2_rad,x_m,y_m,z_m,\n0,0,1,2,3\n",
        "q1_m,q2_rad,x_m,y_m,z_m,,\n0,0,1,2,3,\n",
        "q1_m,q2_rad,x_m,y_m,z_m\n0,0,1,2,3,,\n",
    ] {
        assert_eq!(own(text).expect("read").set.observations.len(), 1, "{text}");
    }
}

#[test]
fn numbers_with_separators_of_thousands_are_refused_with_the_reason() {
    for cell in ["\"1,234.5\"", "1'234.5", "1 234"] {
        let refused = own(&format!("q1_m,q2_rad,x_m,y_m,z_m\n0,0,{cell},2,3\n")).unwrap_err();
        let InputError::Invalid { help: Some(help), .. } = &refused else { panic!("{refused:?}") };
        assert!(help.contains("without separators of thousands"), "{cell}: {help}");
    }
}

#[test]
fn a_file_is_not_read_twice() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("m.csv");
    std::fs::write(&path, "q1_m,q2_rad,x_m,y_m,z_m\n0,0,1,2,3\n").expect("written");
    let again = folder.path().join(".").join("m.csv");
    let points = [&path, &again].map(|path| PointsFile { target: None, path: path.clone() });
    let files = MeasurementFiles { points: points.into(), joints: None };
    let joints = [JointKind::Prismatic, JointKind::Revolute];
    let refused =
        read_files(&files, &ColumnMap::default(), &joints, &RowOptions::default()).expect_err("twice");
    assert!(refused.to_string().contains("named twice"), "{refused}");
}
