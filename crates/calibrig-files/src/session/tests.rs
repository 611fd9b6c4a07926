use super::*;
use calibrig_model::measurement::{InstrumentTerm, PoseReading, StatedDrift, TargetOrientation};
use nalgebra::Rotation3;
use proptest::prelude::*;

fn parse(text: &str) -> Result<SessionFile, InputError> {
    parse_session(&Source::new("session.toml", format!("schema = \"calibrig.session/1\"\n{text}")))
}

fn numbers<const N: usize>() -> impl Strategy<Value = [f64; N]> {
    let number = prop_oneof![-1e15..1e15, -1e-9..1e-9, Just(-0.0), Just(f64::MIN_POSITIVE / 3.0)];
    prop::collection::vec(number, N).prop_map(|v| v.try_into().expect("as many"))
}

fn matrix() -> impl Strategy<Value = Matrix3<f64>> {
    numbers::<9>().prop_map(|v| {
        let mut matrix = Matrix3::from_row_slice(&v);
        matrix.set_diagonal(&matrix.diagonal().abs());
        matrix
    })
}

fn reading() -> impl Strategy<Value = Reading> {
    let spherical = (1e-15..1e15, numbers::<2>(), matrix(), any::<bool>()).prop_map(
        |(range, [azimuth, elevation], covariance, is_back)| {
            Reading::Spherical(SphericalReading {
                face: if is_back { Face::Back } else { Face::Front },
                range,
                azimuth,
                elevation,
                covariance: Some(covariance),
            })
        },
    );
    let cartesian = (numbers::<3>(), prop::option::of(matrix()))
        .prop_map(|(position, covariance)| Reading::Cartesian { position: position.into(), covariance });
    prop_oneof![spherical, cartesian]
}

/// Errors in any order, each once.
fn instrument() -> impl Strategy<Value = StatedInstrument> {
    let terms = prop::sample::subsequence(InstrumentTerm::ALL.to_vec(), 0..=16).prop_shuffle();
    let sigma = prop_oneof![1e-9..1e-3f64, Just(1e-15), Just(1e15)];
    let drift = prop::option::of((0.0..1e-3f64, 0.0..1e-3f64));
    ("\\PC{0,6}", terms, prop::collection::vec(sigma, 16), drift).prop_map(|(name, terms, sigmas, drift)| {
        let drift =
            drift.map(|(motion_per_hour, turn_per_hour)| StatedDrift { motion_per_hour, turn_per_hour });
        StatedInstrument { name, sigmas: terms.into_iter().zip(sigmas).collect(), drift }
    })
}

/// Name, certified place and its covariance, and the readings of the rounds.
type SeenNest = (String, [f64; 3], Matrix3<f64>, Vec<Reading>);

/// Rounds of nests, each measured once a round; without times where there is one round.
fn stations() -> impl Strategy<Value = Vec<Station>> {
    let nest = ("\\PC{0,6}", numbers::<3>(), matrix(), prop::collection::vec(reading(), 1..3));
    let rounds = |nests: Vec<SeenNest>| {
        let of_nest = |(i, (name, in_base, in_base_covariance, readings)): (
            usize,
            (String, [f64; 3], _, Vec<Reading>),
        )| {
            let is_repeated = readings.len() > 1;
            readings
                .into_iter()
                .enumerate()
                .map(move |(round, reading)| NestObservation {
                    name: format!("{i}{name}"),
                    in_base: in_base.into(),
                    in_base_covariance,
                    reading,
                    time: is_repeated.then_some(0.1 * round as f64 - 1.0),
                })
                .collect::<Vec<_>>()
        };
        nests.into_iter().enumerate().flat_map(of_nest).collect::<Vec<_>>()
    };
    let station = (prop::collection::vec(nest, 0..3).prop_map(rounds), prop::option::of(instrument()));
    prop::collection::vec(station, 1..3).prop_map(|stations| {
        let station = |(i, (nests, instrument)): (usize, (_, Option<StatedInstrument>))| {
            // One name is one instrument.
            let instrument =
                instrument.map(|stated| StatedInstrument { name: format!("{i}{}", stated.name), ..stated });
            Station { name: format!("\"{i}\\ é"), nests, instrument, motion: None, sweeps: Vec::new() }
        };
        stations.into_iter().enumerate().map(station).collect()
    })
}

fn targets() -> impl Strategy<Value = Vec<Target>> {
    let turn = (prop::array::uniform3(-3.0f64..3.0), prop::option::of(matrix()));
    let turn = turn.prop_map(|(v, covariance)| TargetOrientation {
        flange_from_target: Rotation3::new(v.into()),
        covariance,
    });
    let target = |(i, (at, covariance, orientation)): (usize, ([f64; 3], _, _))| Target {
        name: format!("target {i}"),
        in_flange: at.into(),
        covariance,
        orientation,
    };
    let targets = (numbers::<3>(), prop::option::of(matrix()), prop::option::of(turn));
    let targets = prop::collection::vec(targets, 1..3);
    targets.prop_map(move |targets| targets.into_iter().enumerate().map(target).collect())
}

proptest! {
    #[test]
    fn every_bit_comes_back(
        sets in prop::collection::vec((stations(), targets()), 1..3), same in any::<bool>(), reason in "(\\PC|\n){0,9}"
    ) {
        let mut sets: Vec<_> = sets
            .into_iter()
            .map(|(stations, targets)| MeasurementSet { stations, targets, observations: Vec::new() })
            .collect();
        if same && sets.len() == 2 {
            sets[1] = sets[0].clone();
        } else if let [first, second] = sets.as_mut_slice() {
            for (station, other) in second.stations.iter_mut().zip(&first.stations) {
                if station.instrument.is_some() && other.instrument.is_some() {
                    station.instrument.clone_from(&other.instrument);
                }
            }
        }
        let dropped = [(3, reason)];
        let told: Vec<SessionSet<'_>> =
            SetKind::ALL.into_iter().zip(&sets).map(|(kind, set)| (kind, set, &dropped[..])).collect();
        let text = session_text(&told).expect("no nest is a full pose");
        let source = Source::new("session.toml", text);
        let file = parse_session(&source).expect("as written");
        for (kind, set, dropped) in told {
            let mut loaded = LoadedMeasurements::default();
            file.complete(&source, kind, &mut loaded).expect("nothing is missing");
            // `{:?}` tells -0.0 from 0.0 and prints enough digits for every bit.
            prop_assert_eq!(format!("{:?}", loaded.set), format!("{set:?}"));
            prop_assert_eq!(&loaded.dropped[..], dropped);
        }
    }
}

#[test]
fn standard_deviations_do_instead_of_covariances() {
    let session = parse(
        "[[station]]\nname = \"s\"\n[[station.nest]]\nname = \"n\"\nin_base_m = [1, 2, 3.5]\nin_base_sigma_m = 1e-3\n\
         range_m = 4\naz_rad = 0.5\nel_rad = 0\nsigma_range_m = 1e-5\nsigma_az_rad = 2e-6\nsigma_el_rad = 3e-6\n\
         [[target]]\nname = \"t\"\nset = \"verification\"\nin_flange_m = [0, 0, 0.1]\nsigma_m = 0.5\n",
    )
    .expect("valid");
    let nest = &session.stations[0].item.nests[0];
    assert_eq!(nest.in_base_covariance, Matrix3::from_diagonal_element(1e-3 * 1e-3));
    let Reading::Spherical(reading) = &nest.reading else { panic!("spherical") };
    assert_eq!(reading.covariance.map(|c| c.m22), Some(2e-6 * 2e-6));
    assert_eq!(session.targets[0].set, Some(SetKind::Verification));
    assert_eq!(session.targets[0].item.covariance, Some(Matrix3::from_diagonal_element(0.25)));
}

#[test]
fn stations_are_found_by_their_names() {
    let text = "[[station]]\nname = \"back\"\n[[station]]\nname = \"front\"\n";
    let source = Source::new("session.toml", format!("schema = \"calibrig.session/1\"\n{text}"));
    let session = parse_session(&source).expect("valid");
    let observation = observation(None);
    let loaded = |name: &str| LoadedMeasurements {
        set: MeasurementSet {
            stations: vec![Station { name: name.to_owned(), ..Station::default() }],
            targets: vec![Target {
                name: "t".to_owned(),
                in_flange: Vector3::zeros(),
                covariance: None,
                orientation: None,
            }],
            observations: vec![observation.clone()],
        },
        names_stations: true,
        names_targets: true,
        ..LoadedMeasurements::default()
    };
    let mut known = loaded("front");
    session.complete(&source, SetKind::Identification, &mut known).expect("described");
    assert_eq!((known.set.observations[0].station, known.set.stations.len()), (1, 2));
    assert_eq!(known.set.targets.len(), 1, "no target is described");
    let error = session.complete(&source, SetKind::Identification, &mut loaded("left")).expect_err("unknown");
    assert!(error.to_string().contains("station \"left\" of the identification set"), "{error}");
}

fn observation(payload: Option<Payload>) -> calibrig_model::measurement::Observation {
    calibrig_model::measurement::Observation {
        pose: 1,
        command: vec![0.0],
        approach: vec![0],
        since_reversal: Vec::new(),
        temperature: None,
        time: 0.0,
        station: 0,
        target: 0,
        payload,
        reading: Reading::Cartesian { position: Vector3::x(), covariance: None },
    }
}

#[test]
fn a_payload_is_that_of_every_pose_of_its_set() {
    let plate = "[[payload]]\nname = \"plate\"\nset = \"identification\"\nmass_kg = 25.02\nx_mm = 0\ny_mm = -4\nz_m = 0.118\n";
    let rope = "[[payload]]\nname = \"rope\"\nforce_z_n = 200\nx_mm = 0\ny_mm = 0\nz_mm = 50\n";
    let completed = |text: &str, kind, carried: Option<Payload>| {
        let source = Source::new("session.toml", format!("schema = \"calibrig.session/1\"\n{text}"));
        let set = MeasurementSet {
            observations: vec![observation(None), observation(carried)],
            ..MeasurementSet::default()
        };
        let mut loaded = LoadedMeasurements { set, ..LoadedMeasurements::default() };
        parse_session(&source)?.complete(&source, kind, &mut loaded)?;
        Ok::<_, InputError>(loaded.set.observations.into_iter().map(|o| o.payload).collect::<Vec<_>>())
    };
    let expected = Payload::of_mass("plate", 25.02, Vector3::new(0.0, -0.004, 0.118));
    let fitted = completed(plate, SetKind::Identification, None).expect("described");
    assert_eq!(fitted, [Some(expected.clone()), Some(expected.clone())]);
    assert_eq!(completed(plate, SetKind::Verification, None).expect("described"), [None, None]);
    let force = |kind| completed(rope, kind, None).expect("described")[1].clone().map(|p| p.force.z);
    assert_eq!(SetKind::ALL.map(force), [Some(200.0); 2]);
    // Stated twice: by the file of the measurements as well, or for one set.
    let twice = completed(plate, SetKind::Identification, Some(expected)).expect_err("twice").to_string();
    assert!(
        twice.contains("session.toml:2: payload \"plate\" is said to be carried by all poses"),
        "{twice}"
    );
    let both = parse(&format!("{plate}{rope}")).expect_err("both").to_string();
    assert!(both.contains("payloads \"plate\" and \"rope\" are both said to be carried"), "{both}");
    let other = rope.replace("force_z_n", "set = \"verification\"\nforce_z_n");
    assert!(parse(&format!("{plate}{other}")).is_ok());
    for (text, expected) in [
        ("[[payload]]\nname = \"p\"\nmass_kg = 5", "session.toml:2: payload \"p\" has no centre"),
        (
            "[[payload]]\nname = \"p\"\nmass_kg = 5\nmass_factor = 2",
            "session.toml:5: mass_factor applies to a simulated payload",
        ),
        (
            "[[payload]]\nname = \"p\"\nset = \"all\"\nmass_kg = 5\nx_mm = 0\ny_mm = 0\nz_mm = 0",
            "set is \"all\"",
        ),
    ] {
        let error = parse(text).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn refusals_name_line_and_key() {
    let nest = "[[station]]\nname = \"s\"\n[[station.nest]]\nname = \"n\"\nin_base_m = [1, 2, 3]\n";
    let seen = format!("{nest}in_base_sigma_m = 1e-5\nposition_m = [1, 2, 3]\n");
    let again = seen
        .split_once("[[station.nest]]")
        .map(|(_, nest)| format!("[[station.nest]]{nest}"))
        .expect("a nest");
    let target = "[[target]]\nname = \"t\"\nin_flange_m = [1, 2, 3]\n";
    let cases = [
        ("[[station]]\nname = \"s\"\nset = \"test\"", "session.toml:4: set is \"test\""),
        (
            "[[station]]\nname = \"s\"\n[[station]]\nname = \"s\"",
            "session.toml:5: station \"s\" appears twice",
        ),
        ("[[station]]\nname = \"s\"\nx_m = 1", "session.toml:4: unknown key `x_m`"),
        (&format!("{nest}position_m = [1, 2, 3]"), "no uncertainty"),
        (&format!("{nest}in_base_sigma_m = 1e-5"), "there is no reading"),
        (
            &format!("{nest}in_base_sigma_m = -1e-5\nposition_m = [1, 2, 3]"),
            "session.toml:7: in_base_sigma_m is -1e-5",
        ),
        (&format!("{nest}in_base_sigma_m = 1e-5\nrange_m = 2"), "the reading is incomplete"),
        (
            &format!("{nest}in_base_sigma_m = 1e-5\nrange_m = 2\naz_rad = 0\nel_rad = 0\nsigma_az_rad = 1"),
            "the uncertainty of its reading is missing or given twice",
        ),
        ("[[target]]\nname = \"t\"\nin_flange_m = [1, 2, inf]", "session.toml:4: in_flange_m holds inf"),
        ("[[target]]\nname = \"t\"\nin_flange_m = [1, 2]", "session.toml:4:"),
        (
            "[[target]]\nname = \"t\"\nin_flange_m = [1, 2, 3]\ncovariance_m2 = [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]",
            "session.toml:5: covariance_m2 has -1e0 on its diagonal",
        ),
        ("[[dropped]]\nset = \"verification\"\npose = -1\nreason = \"r\"", "session.toml:4:"),
        (
            &format!("{seen}{again}"),
            "session.toml:10: nest \"n\" appears twice, but not at two different times",
        ),
        (
            &format!("{seen}time_s = 1\n{again}time_s = 1\n"),
            "session.toml:11: nest \"n\" appears twice, but not at two different times",
        ),
        (
            &format!("{seen}time_s = 1\n{}time_s = 2\n", again.replace("3]\nin", "3.002]\nin")),
            "session.toml:11: nest \"n\" appears twice, with certified places 2.0000 mm apart",
        ),
        (&format!("{seen}face = \"back\"\n"), "session.toml:9: face applies to range and angles"),
        (
            &format!(
                "{nest}in_base_sigma_m = 1e-5\nrange_m = 2\naz_rad = 0\nel_rad = 0\nsigma_range_m = 1\nsigma_az_rad = 1\nsigma_el_rad = 1\nface = \"rear\"\n"
            ),
            "session.toml:14: face is \"rear\"",
        ),
        (
            "[[station]]\nname = \"s\"\n[station.instrument]\nname = \"i\"\ncollimation_urad = 0\n",
            "session.toml:6: collimation_urad is 0",
        ),
        (
            "[[station]]\nname = \"s\"\n[station.instrument]\nname = \"i\"\ncollimation_urad = -1\n",
            "session.toml:6: collimation_urad is -1",
        ),
        (
            "[[station]]\nname = \"s\"\n[station.instrument]\nname = \"i\"\ncollimation = 1\n",
            "session.toml:6: unknown key `collimation`",
        ),
        ("[[station]]\nname = \"s\"\n[station.instrument]\ncollimation_rad = 1\n", "missing key `name`"),
        (
            &format!(
                "{target}rotation_vector_deg = [1, 2, 3]\nrotation_matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n"
            ),
            "session.toml:6: the rotation is given twice",
        ),
        (
            &format!("{target}rotation_matrix = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\n"),
            "session.toml:5: the matrix is left-handed",
        ),
        (
            &format!("{target}rotation_quaternion_wxyz = [0, 0, 0, 0]\n"),
            "session.toml:5: the quaternion has length 0",
        ),
        (
            &format!("{target}rotation_euler_deg = [0, 0, 0]\n"),
            "session.toml:5: the sequence of the angles is not stated",
        ),
        (
            &format!("{target}rotation_sequence = \"zyx\"\n"),
            "rotation_sequence applies to angles, but there are none",
        ),
        (
            &format!("{target}rotation_sigma_mrad = 1\n"),
            "session.toml:5: the uncertainty of a rotation is stated, but no rotation",
        ),
    ];
    for (text, expected) in cases {
        let error = parse(text).expect_err(expected);
        assert!(error.to_string().contains(expected), "{error} lacks {expected}");
    }
    let error =
        parse_session(&Source::new("session.toml", "schema = \"calibrig.session/2\"")).expect_err("newer");
    assert!(error.to_string().contains("session.toml:1: schema is"), "{error}");
}

#[test]
fn what_no_identification_can_use_is_refused_at_its_line() {
    let nest = |at: &str, sigma: &str| {
        format!(
            "[[station.nest]]\nname = \"n{at}\"\nin_base_m = [{at}]\nin_base_sigma_m = {sigma}\nposition_m = [{at}]\nsigma_m = {sigma}\n"
        )
    };
    let station = |places: [&str; 3], sigma: &str| {
        let nests: String = places.iter().map(|at| nest(at, sigma)).collect();
        format!("[[station]]\nname = \"s\"\n{nests}")
    };
    let sound = ["0, 0, 0", "1, 0, 0", "0, 1, 0"];
    let check = |text: &str| {
        let source = Source::new("session.toml", format!("schema = \"calibrig.session/1\"\n{text}"));
        parse_session(&source).expect("readable").check_usable(&source).map_err(|error| error.to_string())
    };
    assert_eq!(check(&station(sound, "1e-5")), Ok(()));
    assert_eq!(check("[[station]]\nname = \"s\"\n"), Ok(()), "none is no mistake");
    let target = |spread: &str| format!("[[target]]\nname = \"t\"\nin_flange_m = [0, 0, 0.1]\n{spread}\n");
    assert_eq!(check(&target("")), Ok(()));
    for (text, expected) in [
        (
            format!("[[station]]\nname = \"s\"\n{}{}", nest("0, 0, 0", "1e-5"), nest("1, 0, 0", "1e-5")),
            "session.toml:3: station \"s\": 2 base nests were measured: placing the tracker needs at least 3",
        ),
        (
            station(["0, 0, 0", "1, 0, 0", "2, 0, 0"], "1e-5"),
            "session.toml:3: station \"s\": the base nests lie on one line and do not determine the tracker's place: \
             add a nest away from that line (n0, 0, 0, n1, 0, 0, n2, 0, 0 lie on it within 0.000 mm)",
        ),
        (station(sound, "0"), "session.toml:4: station \"s\": nest n0, 0, 0: its covariance is missing"),
        (target("sigma_m = 0"), "session.toml:3: target \"t\": its uncertainty is not above zero"),
        (
            target("covariance_m2 = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]"),
            "session.toml:3: target \"t\": its uncertainty is not above zero",
        ),
    ] {
        let error = check(&text).expect_err(expected);
        assert!(error.contains(expected), "{error} lacks {expected}");
    }
}

#[test]
fn instruments_nests_in_rounds_and_turned_targets_are_read_in_units_that_people_write() {
    let nest = |more: &str| {
        format!(
            "[[station.nest]]\nname = \"n\"\nin_base_m = [1, 2, 3]\nin_base_sigma_m = 1e-5\nrange_m = 4\naz_rad = 0.5\nel_rad = 0\n\
             sigma_range_m = 1e-5\nsigma_az_rad = 2e-6\nsigma_el_rad = 3e-6\n{more}"
        )
    };
    let text = format!(
        "[[station]]\nname = \"s\"\n[station.instrument]\nname = \"AT1\"\nrange_offset_um = 5\ncollimation_urad = 2.5\nrange_scale_um_per_m = 0.3\n\
         vertical_index_arcsec = 1\n{}{}{}[[target]]\nname = \"probe\"\nin_flange_m = [0, 0, 0.1]\nrotation_euler_deg = [90, 0, 0]\n\
         rotation_sequence = \"zyx intrinsic\"\nrotation_sigma_mrad = 2\n",
        nest("time_s = 1\n"),
        nest("time_s = 1\nface = \"back\"\n"),
        nest("time_s = 600\n")
    );
    let session = parse(&text).expect("valid");
    let station = &session.stations[0].item;
    let instrument = station.instrument.as_ref().expect("stated");
    let terms: Vec<_> = instrument.sigmas.iter().map(|(term, _)| *term).collect();
    use InstrumentTerm::{Collimation, RangeOffset, RangeScale, VerticalIndex};
    assert_eq!(terms, [RangeOffset, Collimation, RangeScale, VerticalIndex], "in the order of the file");
    let expected = [5e-6, 2.5e-6, 0.3e-6, (1.0_f64 / 3600.0).to_radians()];
    for ((_, found), expected) in instrument.sigmas.iter().zip(expected) {
        assert!((found / expected - 1.0).abs() < 1e-14, "{found} {expected}");
    }
    let rounds: Vec<_> = station.nests.iter().map(|nest| (nest.time, nest.reading.face())).collect();
    assert_eq!(rounds, [(Some(1.0), Face::Front), (Some(1.0), Face::Back), (Some(600.0), Face::Front)]);
    let turn = session.targets[0].item.orientation.as_ref().expect("stated");
    assert!((turn.flange_from_target * Vector3::x() - Vector3::y()).amax() < 1e-15);
    assert!((turn.covariance.expect("stated").m22 - 4e-6).abs() < 1e-18);

    let two = format!(
        "{text}[[station]]\nname = \"b\"\n[station.instrument]\nname = \"AT1\"\nrange_offset_um = 5\ncollimation_urad = 3\n"
    );
    let refused = parse(&two).expect_err("contradicts").to_string();
    assert!(
        refused.contains("instrument \"AT1\" is stated differently at station \"s\": range_scale_m_per_m is not stated here \
                          but 3e-7 there"),
        "{refused}"
    );
}

#[test]
fn a_nest_that_is_a_full_pose_is_not_written() {
    let reading = Reading::Pose(Box::new(PoseReading {
        position: Vector3::x(),
        rotation: Rotation3::identity(),
        covariance: None,
    }));
    let nest = NestObservation {
        name: "n".to_owned(),
        in_base: Vector3::x(),
        in_base_covariance: Matrix3::identity(),
        reading,
        time: None,
    };
    let set = MeasurementSet {
        stations: vec![Station { name: "s".to_owned(), nests: vec![nest], ..Station::default() }],
        ..MeasurementSet::default()
    };
    let refused = session_text(&[(SetKind::Identification, &set, &[])]).expect_err("a pose");
    assert_eq!(
        refused.to_string(),
        "station \"s\": nest \"n\" was read as a full pose, but a nest is a point"
    );
}
