//! The tracker as a whole.

use super::*;
use calibrig_model::random::stream;

const INSTRUMENT: Instrument = Instrument::of_noise(
    ErrorLine { offset: 15e-6, per_metre: 6e-6 },
    ErrorLine { offset: 10e-6, per_metre: 0.3e-6 },
    RANDOM_FRACTION,
);

#[test]
fn scatter_has_the_stated_covariance() {
    let up = Vector3::y();
    let tracker = LaserTracker::levelled(INSTRUMENT, Vector3::new(1.0, 0.5, -3.0), 0.4, &up);
    let point = Vector3::new(-0.5, 1.7, 1.0);
    let mut rng = stream(3, 0, StreamSource::IdentificationNoise);
    let n = 4000;
    let truth = tracker.tracker_from_base.rotation * point + tracker.tracker_from_base.translation.vector;
    let mut chi2 = 0.0;
    for _ in 0..n {
        let reading = tracker.measure(&point, &Shot::default(), &mut rng).expect("4 m");
        let error = reading.position() - truth;
        let information =
            reading.position_covariance().and_then(Matrix3::try_inverse).expect("positive definite");
        chi2 += (error.transpose() * information * error)[0];
    }
    // Chi-square with 3 n degrees of freedom, 99.9 % band.
    let spread = 3.29 * (2.0 / f64::from(3 * n)).sqrt();
    let ratio = chi2 / f64::from(3 * n);
    assert!((ratio - 1.0).abs() < spread, "{ratio} +- {spread}");
}

#[test]
fn without_noise_the_reading_is_the_point_and_its_axis_is_up() {
    let exact = Instrument { noise: false, ..INSTRUMENT };
    let up = Vector3::y();
    let tracker = LaserTracker::levelled(exact, Vector3::new(1.0, 0.5, -3.0), 0.4, &up);
    let mut rng = stream(3, 0, StreamSource::IdentificationNoise);
    let above = tracker.measure(&Vector3::new(1.0, 2.5, -3.0), &Shot::default(), &mut rng).expect("2 m");
    assert!((above.elevation - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    assert!((above.range - 2.0).abs() < 1e-15);
    assert!(tracker.measure(&Vector3::new(1.0, 0.5, -3.05), &Shot::default(), &mut rng).is_err());
}

#[test]
fn readings_near_the_zenith_are_as_exact_as_others() {
    let exact = Instrument { noise: false, ..INSTRUMENT };
    let tracker = LaserTracker::placed(exact, Transform::identity());
    let mut rng = stream(3, 0, StreamSource::IdentificationNoise);
    for off in [1e-8, 1e-6, 1e-3] {
        let point = Vector3::new(3.0 * off, 4.0 * off, 2.0);
        let reading = tracker.measure(&point, &Shot::default(), &mut rng).expect("2 m");
        let from_zenith = (5.0 * off / 2.0).atan();
        assert!((std::f64::consts::FRAC_PI_2 - reading.elevation - from_zenith).abs() < 1e-14, "{off}");
        assert!((reading.position() - point).norm() < 1e-15, "{off}");
    }
}

#[test]
fn a_point_out_of_range_moves_no_later_reading() {
    let tracker = LaserTracker::placed(INSTRUMENT, Transform::identity());
    let after = |first: f64| {
        let mut rng = stream(3, 0, StreamSource::IdentificationNoise);
        let first = tracker.measure(&Vector3::new(first, 0.0, 0.0), &Shot::default(), &mut rng);
        (
            first.is_ok(),
            tracker.measure(&Vector3::new(2.0, 1.0, 0.5), &Shot::default(), &mut rng).expect("2 m"),
        )
    };
    let (in_range, later) = after(5.0);
    assert!(in_range);
    for out_of_range in [0.05, 31.0, f64::INFINITY, f64::NAN] {
        assert_eq!(after(out_of_range), (false, later.clone()));
    }
}

/// What is read of a point over what perfect axes would read, as lengths along the beam, along growing azimuth and along growing elevation, m.
fn displaced(misalignment: &Misalignment, point: &Vector3<f64>, face: Face) -> Vector3<f64> {
    let shown = misalignment.read(point, face).expect("a point that can be reached");
    let perfect = Misalignment::default().read(point, Face::Front).expect("any point");
    let flat = point.x.hypot(point.y);
    let turn = (shown.azimuth - perfect.azimuth).sin();
    Vector3::new(
        shown.range - perfect.range,
        flat * turn,
        perfect.range * (shown.elevation - perfect.elevation).sin(),
    )
}

const PLACES: [[f64; 3]; 6] = [
    [1.0, 0.2, 0.3],
    [-2.0, 1.5, -1.2],
    [-0.5, -3.0, 2.0],
    [4.0, -4.0, 0.0],
    [-6.0, -0.1, 3.0],
    [0.3, 0.4, 1.0],
];

#[test]
fn each_error_displaces_as_published_up_to_its_square() {
    for term in InstrumentTerm::ALL {
        for (place, face) in PLACES.iter().flat_map(|place| [(place, Face::Front), (place, Face::Back)]) {
            let point = Vector3::from(*place);
            let [range, azimuth, elevation] =
                [point.norm(), point.y.atan2(point.x), point.z.atan2(point.x.hypot(point.y))];
            let first_order = term.displacement(range, azimuth, elevation, face);
            let remainder = |x: f64| {
                let exact = displaced(&Misalignment::of([(term, x)]), &point, face);
                (exact - x * first_order).norm()
            };
            let (large, small) = (remainder(1e-3), remainder(1e-4));
            // The second order: a signature of another sign or size would leave the first.
            assert!(large < 20.0 * 1e-6 * range, "{term} {face:?} {place:?}: {large}");
            // Falls a hundredfold, or was nothing but rounding.
            assert!(small < 0.012 * large + 1e-13, "{term} {face:?} {place:?}: {large} then {small}");
        }
    }
}

/// What a whole instrument is said to have displaces its readings by that, all errors at once and the air with them.
#[test]
fn real_errors_are_what_readings_are_off_by_to_first_order() {
    let mut tracker = at500();
    tracker.instrument.systematic_fraction = 0.5;
    if let Some(law) = &mut tracker.conditions.environment {
        law.gradient = 0.0;
        law.sensor_sigma.temperature = 3.0;
    }
    tracker.conditions.drift = None;
    for trial in 0..20 {
        let mut own = tracker.drawn(1, trial, 0, 60.0).expect("one passes");
        let air = own.errors.air.scale - 1.0;
        own.instrument.noise = false;
        own.tracker_from_base = Transform::identity();
        let errors = own.real_errors();
        let terms: Vec<_> = errors.iter().map(|(term, _)| *term).collect();
        assert_eq!(terms, InstrumentTerm::ALL);
        assert_eq!(Misalignment::of(own.errors.misalignment.amplitudes()), own.errors.misalignment);
        assert!(air.abs() > 1e-8 && errors.iter().all(|(_, amplitude)| *amplitude != 0.0));
        for place in PLACES {
            let point = Vector3::from(place);
            let [range, azimuth, elevation] =
                [point.norm(), point.y.atan2(point.x), point.z.atan2(point.x.hypot(point.y))];
            for face in [Face::Front, Face::Back] {
                let rng = &mut stream(1, 0, StreamSource::IdentificationNoise);
                let shot = Shot { face, azimuth_before: azimuth, ..Shot::default() };
                let read = own.measure(&point, &shot, rng).expect("a point that can be reached");
                let off = Vector3::new(
                    read.range - range,
                    point.x.hypot(point.y) * (read.azimuth - azimuth),
                    range * (read.elevation - elevation),
                );
                let told: Vector3<f64> = errors
                    .iter()
                    .map(|(term, x)| *x * term.displacement(range, azimuth, elevation, face))
                    .sum();
                // The square of errors of some 1e-5 is 1e-10, of any wrong sign 1e-6 is left.
                assert!((off - told).norm() < 2e-9, "{trial} {place:?} {face:?}: {off} is not {told}");
            }
        }
    }
    // Without errors there are none, which is known.
    let sound = LaserTracker::placed(INSTRUMENT, Transform::identity());
    assert!(sound.real_errors().iter().all(|(_, amplitude)| *amplitude == 0.0));
}

#[test]
fn the_beam_of_a_misaligned_instrument_ends_at_the_point_that_it_reads() {
    // Far larger than any instrument's.
    let own = Misalignment {
        transit_offset: 0.02,
        beam_offset: [0.01, -0.015],
        collimation: 0.02,
        axis_tilt: -0.03,
        ..Misalignment::default()
    };
    for (place, face) in PLACES.iter().flat_map(|place| [(place, Face::Front), (place, Face::Back)]) {
        let shown = own.read(&Vector3::from(*place), face).expect("a point that can be reached");
        // From what the perfect encoders show to where head and telescope really are.
        let (theta, phi) = match face {
            Face::Front | Face::Both => (shown.azimuth, shown.elevation),
            Face::Back => (shown.azimuth + std::f64::consts::PI, std::f64::consts::PI - shown.elevation),
        };
        let about = |axis: Vector3<f64>, angle: f64| Rotation3::from_scaled_axis(angle * axis);
        let beam = Vector3::new(own.collimation.cos(), own.collimation.sin(), 0.0);
        let in_telescope = Vector3::new(0.0, own.beam_offset[0], own.beam_offset[1]) + shown.range * beam;
        let in_head = about(Vector3::x(), own.axis_tilt) * (about(Vector3::y(), -phi) * in_telescope);
        let end = about(Vector3::z(), theta) * (in_head + own.transit_offset * Vector3::x());
        assert!((end - Vector3::from(*place)).norm() < 1e-9, "{place:?} {face:?}: {end}");
    }
}

/// What turns over with the telescope is not in the mean of both faces: angles are those of one without it, to the square of the error.
#[test]
fn the_mean_of_both_faces_is_free_of_what_turns_over() {
    let own = Misalignment { collimation: 2e-5, transit_offset: 3e-5, ..Misalignment::default() };
    for place in PLACES {
        let point = Vector3::from(place);
        let (exact, mean) = (
            Misalignment::default().read(&point, Face::Both).expect("a point"),
            own.read(&point, Face::Both).expect("a point"),
        );
        let front = own.read(&point, Face::Front).expect("a point");
        assert!((mean.range - exact.range).abs() < 1e-8, "{place:?}");
        assert!((mean.azimuth - exact.azimuth).abs() < 1e-8, "{place:?}");
        assert!((front.azimuth - exact.azimuth).abs() > 1e-5, "{place:?}");
    }
}

fn at500() -> LaserTracker {
    let mut tracker =
        LaserTracker::levelled(Preset::At500.instrument(), Vector3::new(3.0, 1.0, 0.5), 0.2, &Vector3::z());
    tracker.conditions = Conditions {
        environment: Some(EnvironmentLaw {
            air: Air::ROOM,
            sensor_sigma: Air { temperature: 0.3, pressure: 100.0, humidity: 0.05 },
            gradient: 0.4,
        }),
        drift: Some(DriftLaw {
            ramp: Motion { shift: 18e-6, turn: 1e-6 },
            warm_up: [Motion::default(), Motion { shift: 50e-6, turn: 0.0 }],
            warm_up_time: 1200.0,
            walk: Motion { shift: 30e-6, turn: 0.0 },
        }),
        smr: None,
        misses: 0.0,
    };
    tracker
}

#[test]
fn what_is_drawn_depends_on_seed_and_trial_alone() {
    let tracker = at500();
    let one = tracker.drawn(1, 5, 0, 3600.0).expect("passes");
    assert_eq!(one, tracker.drawn(1, 5, 0, 3600.0).expect("passes"));
    for other in [tracker.drawn(1, 6, 0, 3600.0), tracker.drawn(2, 5, 0, 3600.0)] {
        assert_ne!(one.errors.misalignment, other.expect("passes").errors.misalignment);
    }
    // Another station has the same instrument and the same air, and moves otherwise.
    let beside = tracker.drawn(1, 5, 1, 3600.0).expect("passes");
    assert_eq!((beside.errors.misalignment, beside.errors.air), (one.errors.misalignment, one.errors.air));
    assert_ne!(beside.errors.drift, one.errors.drift);
    // Switching one off moves no other.
    let mut still = tracker.clone();
    still.conditions.drift = None;
    let still = still.drawn(1, 5, 0, 3600.0).expect("passes");
    assert_eq!((still.errors.misalignment, still.errors.air), (one.errors.misalignment, one.errors.air));
    let mut exact = tracker.clone();
    exact.instrument.noise = false;
    assert!(!exact.has_law() && tracker.has_law());
    assert_eq!(exact.drawn(1, 5, 0, 3600.0).expect("nothing to draw").errors, TrackerErrors::default());
}

#[test]
fn a_reading_is_of_the_tracker_where_it_is_then() {
    let mut tracker = at500().drawn(1, 0, 0, 7200.0).expect("passes");
    tracker.instrument.noise = false;
    tracker.errors.misalignment = Misalignment::default();
    tracker.errors.air = AirErrors::default();
    let point = Vector3::new(0.2, -0.4, 1.1);
    let read = |time| {
        let rng = &mut stream(1, 0, StreamSource::IdentificationNoise);
        tracker.measure(&point, &Shot::at(time), rng).expect("3 m").position()
    };
    for time in [0.0, 600.0, 5000.0] {
        let there = tracker.tracker_from_base_at(time) * nalgebra::Point3::from(point);
        assert!((read(time) - there.coords).norm() < 1e-14, "{time}");
    }
    assert_eq!(tracker.tracker_from_base_at(0.0), tracker.tracker_from_base);
    let moved = read(5000.0) - read(0.0);
    assert!((1e-6..300e-6).contains(&moved.norm()), "{moved}");
    // The motion of the tracker is that of the points against it, turned round.
    let [shift, turn] = tracker.errors.drift.motion(5000.0);
    assert!((moved + shift + turn.cross(&read(0.0))).norm() < 1e-9, "{moved}");
}

#[test]
fn both_faces_read_one_point_and_turns_are_counted_on() {
    let tracker = LaserTracker::placed(Instrument { noise: false, ..INSTRUMENT }, Transform::identity());
    let point = Vector3::new(-2.0, -0.1, 0.4);
    let rng = &mut stream(1, 0, StreamSource::IdentificationNoise);
    let mut read = |face, azimuth_before| {
        tracker.measure(&point, &Shot { face, azimuth_before, ..Shot::default() }, rng)
    };
    let front = read(Face::Front, 0.0).expect("2 m");
    let back = read(Face::Back, 0.0).expect("2 m");
    assert_eq!((front.position(), front.face, back.face), (back.position(), Face::Front, Face::Back));
    // Coming from the left, the azimuth goes on beyond half a turn.
    let on = read(Face::Front, 3.1).expect("2 m");
    assert!((on.azimuth - front.azimuth - TAU).abs() < 1e-15 && front.azimuth < 0.0 && on.azimuth > 3.1);
    // And no further than the cable goes.
    assert!(matches!(read(Face::Front, 9.0), Err(TrackerError::Angle { angle: "azimuth", .. })));
    assert!(read(Face::Front, f64::NAN).is_err());
}

#[test]
fn what_an_instrument_cannot_do_is_refused_with_its_limits() {
    let mut limited = LaserTracker::placed(INSTRUMENT, Transform::identity());
    limited.instrument.limits = Limits { elevation: [-0.5, 0.8], range: [1.0, 5.0], ..Limits::WIDE };
    let rng = &mut stream(1, 0, StreamSource::IdentificationNoise);
    let mut text = |point: [f64; 3], shot: Shot| {
        limited.measure(&Vector3::from(point), &shot, rng).map_err(|error| error.to_string()).err()
    };
    assert_eq!(text([2.0, 0.0, 0.0], Shot::default()), None);
    let steep = text([1.0, 0.0, 2.0], Shot::default()).expect("too steep");
    assert!(steep.starts_with("elevation 63.4") && steep.contains("-28.65 to 45.84 deg"), "{steep}");
    let far = text([6.0, 0.0, 0.0], Shot::default()).expect("too far");
    assert_eq!(far, "range 6.000 m is outside the tracker's 1 to 5 m");
    for averaging in [0.0, -1.0, f64::NAN] {
        let shot = Shot { averaging, ..Shot::default() };
        assert!(text([2.0, 0.0, 0.0], shot).is_some_and(|text| text.contains("averaging time in s")));
    }
    // A beam beside the standing axis never meets it.
    let beside = Misalignment { beam_offset: [1e-3, 0.0], ..Misalignment::default() };
    let above = beside.read(&Vector3::new(0.5e-3, 0.0, 2.0), Face::Front);
    assert!(matches!(above, Err(TrackerError::BesideTheAxis { .. })), "{above:?}");
    for bad in [f64::NAN, f64::INFINITY, -1.0] {
        let instrument = Instrument { systematic_fraction: bad, ..INSTRUMENT };
        assert!(instrument.check().is_err(), "{bad}");
        assert!(Instrument { air: bad, ..INSTRUMENT }.check().is_err(), "{bad}");
        let mut tracker = at500();
        tracker.conditions.misses = bad;
        assert!(tracker.drawn(1, 0, 0, 0.0).is_err(), "{bad}");
    }
    let mut cold = at500();
    cold.instrument.limits.temperature = [25.0, 30.0];
    assert!(
        cold.check().expect_err("20 degrees").to_string().contains("20: expected a temperature at which")
    );
}

#[test]
fn longer_averaging_leaves_what_the_air_adds() {
    let instrument = Instrument { air: 2e-6, ..INSTRUMENT };
    let [_, second] = instrument.sigmas(4.0, 1.0).expect("sound");
    let [range, hundred] = instrument.sigmas(4.0, 100.0).expect("sound");
    let random = 0.125 * (15e-6 + 6e-6 * 4.0) / 4.0;
    assert!((second - f64::hypot(random, 2e-6)).abs() < 1e-18);
    assert!((hundred - f64::hypot(0.1 * random, 2e-6)).abs() < 1e-18);
    assert!((range - 0.1 * 0.125 * (10e-6 + 0.3e-6 * 4.0)).abs() < 1e-18);
}

#[test]
fn an_operator_knows_the_size_of_what_is_switched_on_and_nothing_of_what_was_drawn() {
    let tracker = at500();
    let stated = tracker.stated();
    assert_eq!((stated.name.as_str(), stated.sigmas.len()), ("at500", InstrumentTerm::ALL.len()));
    assert_eq!(stated, tracker.drawn(1, 0, 0, 0.0).expect("passes").stated());
    let sigma =
        |term| stated.sigmas.iter().find(|(t, _)| *t == term).map(|(_, sigma)| *sigma).expect("listed");
    assert!((sigma(InstrumentTerm::TransitOffset) - 3e-6).abs() < 1e-18);
    assert!((sigma(InstrumentTerm::Collimation) - 1.2e-6).abs() < 1e-18);
    assert!((sigma(InstrumentTerm::RangeOffset) - 1e-6).abs() < 1e-18);
    let air = tracker.conditions.environment.expect("stated").scale_sigma();
    assert!((sigma(InstrumentTerm::RangeScale) - f64::hypot(0.06e-6, air)).abs() < 1e-18);
    assert!(LaserTracker::placed(INSTRUMENT, Transform::identity()).stated().sigmas.is_empty());
}

/// One that was knocked after its test errs so many times more, in the same directions; what is told of it stays.
#[test]
fn real_errors_can_be_larger_than_stated() {
    let sound = LaserTracker::placed(Preset::At500.instrument(), Transform::identity());
    let mut knocked = sound.clone();
    knocked.instrument.real = RealErrors { random: 2.0, systematic: 5.0 };
    let point = Vector3::new(3.0, 1.0, 0.5);
    let read = |tracker: &LaserTracker| {
        let own = tracker.drawn(1, 3, 0, 60.0).expect("one that passes");
        let noise = &mut stream_at(1, 3, StreamSource::IdentificationNoise, 0);
        (own.measure(&point, &Shot::default(), noise).expect("in reach"), own.real_errors())
    };
    let ((one, errors), (other, larger)) = (read(&sound), read(&knocked));
    assert_eq!((one.covariance, sound.stated()), (other.covariance, knocked.stated()));
    for ((term, x), (_, y)) in errors.iter().zip(&larger) {
        assert!((5.0 * x - y).abs() <= 1e-12 * y.abs(), "{term:?}: {x} {y}");
    }
    // Without systematic errors what is left is the scatter, twice as large to the bit but for the sum.
    let scatter = |tracker: &LaserTracker| {
        let mut own = tracker.clone();
        own.instrument.systematic_fraction = 0.0;
        let noise = &mut stream_at(1, 3, StreamSource::IdentificationNoise, 0);
        own.measure(&point, &Shot::default(), noise).expect("in reach").range - point.norm()
    };
    assert!((2.0 * scatter(&sound) - scatter(&knocked)).abs() < 1e-14);
    let test = |tracker: &LaserTracker| {
        acceptance::draw_and_test(&tracker.instrument, 1, 3, 0).expect("in reach").1.length_ratio()
    };
    assert!(test(&knocked) > 2.0 * test(&sound), "{} {}", test(&knocked), test(&sound));
}

/// The law by which amplitudes are drawn is the one that is stated.
#[test]
fn drawn_amplitudes_scatter_as_stated() {
    let kind = Preset::At500.instrument();
    let n = 2000_u32;
    let squares: f64 = (0..n)
        .map(|trial| {
            let own = kind.draw_misalignment(&mut stream_at(1, trial, StreamSource::Instrument, 0));
            (own.transit_offset / 3e-6).powi(2)
                + (own.collimation / 1.2e-6).powi(2)
                + (own.elevation.zero / 1.2e-6).powi(2)
                + (own.azimuth.oval / 1.2e-6).powi(2)
                + (own.range_offset / 1e-6).powi(2)
        })
        .sum();
    let ratio = squares / f64::from(5 * n);
    assert!((ratio - 1.0).abs() < 3.29 * (2.0 / f64::from(5 * n)).sqrt(), "{ratio}");
}
