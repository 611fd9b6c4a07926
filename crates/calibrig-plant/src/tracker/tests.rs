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
    let mut rng = stream(3, 0, Source::IdentificationNoise);
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
    let mut rng = stream(3, 0, Source::IdentificationNoise);
    let above = tracker.measure(&Vector3::new(1.0, 2.5, -3.0), &Shot::default(), &mut rng).expect("2 m");
    assert!((above.elevation - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    assert!((above.range - 2.0).abs() < 1e-15);
    assert!(tracker.measure(&Vector3::new(1.0, 0.5, -3.05), &Shot::default(), &mut rng).is_err());
}

#[test]
fn readings_near_the_zenith_are_as_exact_as_others() {
    let exact = Instrument { noise: false, ..INSTRUMENT };
    let tracker = LaserTracker::placed(exact, Transform::identity());
    let mut rng = stream(3, 0, Source::IdentificationNoise);
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
        let mut rng = stream(3, 0, Source::IdentificationNoise);
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
            Face::Front => (shown.azimuth, shown.elevation),
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
