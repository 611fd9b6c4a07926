use super::*;
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
    let spherical =
        (1e-15..1e15, numbers::<2>(), matrix()).prop_map(|(range, [azimuth, elevation], covariance)| {
            Reading::Spherical(SphericalReading {
                face: calibrig_model::measurement::Face::Front,
                range,
                azimuth,
                elevation,
                covariance: Some(covariance),
            })
        });
    let cartesian = (numbers::<3>(), prop::option::of(matrix()))
        .prop_map(|(position, covariance)| Reading::Cartesian { position: position.into(), covariance });
    prop_oneof![spherical, cartesian]
}

fn stations() -> impl Strategy<Value = Vec<Station>> {
    let nest = ("\\PC{0,6}", numbers::<3>(), matrix(), reading()).prop_map(
        |(name, in_base, in_base_covariance, reading)| NestObservation {
            time: None,
            name,
            in_base: in_base.into(),
            in_base_covariance,
            reading,
        },
    );
    prop::collection::vec(prop::collection::vec(nest, 0..3), 1..3).prop_map(|stations| {
        let station = |(i, nests)| Station { name: format!("\"{i}\\ é"), nests, instrument: None };
        stations.into_iter().enumerate().map(station).collect()
    })
}

fn targets() -> impl Strategy<Value = Vec<Target>> {
    let target = |(i, (at, covariance)): (usize, ([f64; 3], _))| Target {
        orientation: None,
        name: format!("target {i}"),
        in_flange: at.into(),
        covariance,
    };
    let targets = prop::collection::vec((numbers::<3>(), prop::option::of(matrix())), 1..3);
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
        }
        let dropped = [(3, reason)];
        let told: Vec<SessionSet<'_>> =
            SetKind::ALL.into_iter().zip(&sets).map(|(kind, set)| (kind, set, &dropped[..])).collect();
        let text = session_text(&told);
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
    let observation = calibrig_model::measurement::Observation {
        pose: 1,
        command: vec![0.0],
        approach: vec![0],
        temperature: None,
        time: 0.0,
        station: 0,
        target: 0,
        reading: Reading::Cartesian { position: Vector3::x(), covariance: None },
    };
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

#[test]
fn refusals_name_line_and_key() {
    let nest = "[[station]]\nname = \"s\"\n[[station.nest]]\nname = \"n\"\nin_base_m = [1, 2, 3]\n";
    let cases = [
        ("[[station]]\nname = \"s\"\nset = \"test\"", "session.toml:4: set is \"test\""),
        (
            "[[station]]\nname = \"s\"\n[[station]]\nname = \"s\"",
            "session.toml:5: station \"s\" is there twice",
        ),
        ("[[station]]\nname = \"s\"\nx_m = 1", "session.toml:4: unknown key `x_m`"),
        (&format!("{nest}position_m = [1, 2, 3]"), "no uncertainty"),
        (&format!("{nest}in_base_sigma_m = 1e-5"), "there is no reading"),
        (
            &format!("{nest}in_base_sigma_m = -1e-5\nposition_m = [1, 2, 3]"),
            "session.toml:7: in_base_sigma_m is -1e-5",
        ),
        (&format!("{nest}in_base_sigma_m = 1e-5\nrange_m = 2"), "the reading is not whole"),
        (
            &format!("{nest}in_base_sigma_m = 1e-5\nrange_m = 2\naz_rad = 0\nel_rad = 0\nsigma_az_rad = 1"),
            "the uncertainty of its reading is not clear",
        ),
        ("[[target]]\nname = \"t\"\nin_flange_m = [1, 2, inf]", "session.toml:4: in_flange_m holds inf"),
        ("[[target]]\nname = \"t\"\nin_flange_m = [1, 2]", "session.toml:4:"),
        (
            "[[target]]\nname = \"t\"\nin_flange_m = [1, 2, 3]\ncovariance_m2 = [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]",
            "session.toml:5: covariance_m2 has -1e0 on its diagonal",
        ),
        ("[[dropped]]\nset = \"verification\"\npose = -1\nreason = \"r\"", "session.toml:4:"),
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
            "session.toml:3: station \"s\": 2 base nests were measured, at least 3",
        ),
        (
            station(["0, 0, 0", "1, 0, 0", "2, 0, 0"], "1e-5"),
            "session.toml:3: station \"s\": the base nests lie on one line",
        ),
        (station(sound, "0"), "session.toml:4: station \"s\": nest n0, 0, 0: the covariance is missing"),
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
