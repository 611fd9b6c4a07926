//! Points in both faces of drawn instruments: what they show is what was drawn, within what is stated of it.

use calibrig::geometry::Transform;
use calibrig::measurement::{InstrumentTerm, SphericalReading};
use calibrig::nalgebra::Vector3;
use calibrig::random::{StreamSource, stream_at};
use calibrig::statistics::{NORMAL_95, binomial_cdf, chi2_cdf};
use calibrig::tracker::{LaserTracker, Misalignment, Preset, Shot};
use calibrig::two_face::{TwoFacePair, two_face};

const INSTRUMENTS: u32 = 100;
/// Errors that turn over.
const TURNED: f64 = 10.0;

/// A room's worth of points: three distances, three heights, six azimuths.
fn points() -> Vec<Vector3<f64>> {
    let mut all = Vec::new();
    for distance in [1.5, 3.0, 6.0] {
        for height in [-1.2, 0.3, 2.0] {
            for sixth in 0..6 {
                let azimuth = std::f64::consts::FRAC_PI_3 * f64::from(sixth) + 0.1 * height;
                all.push(Vector3::new(distance * azimuth.cos(), distance * azimuth.sin(), height));
            }
        }
    }
    all
}

/// The amplitudes of what turns over, as the geometry has them.
fn drawn(own: &Misalignment, term: InstrumentTerm) -> f64 {
    match term {
        InstrumentTerm::TransitOffset => -own.transit_offset,
        InstrumentTerm::BeamOffsetTransverse => -own.beam_offset[0],
        InstrumentTerm::BeamOffsetNormal => -own.beam_offset[1],
        InstrumentTerm::Collimation => -own.collimation,
        InstrumentTerm::AxisTilt => own.axis_tilt,
        InstrumentTerm::VerticalIndex => own.elevation.zero,
        InstrumentTerm::AzimuthSin1 => own.azimuth.centre[0],
        InstrumentTerm::AzimuthCos1 => -own.azimuth.centre[1],
        InstrumentTerm::ElevationSin1 => own.elevation.centre[0],
        InstrumentTerm::ElevationCos2 => own.elevation.oval_diagonal,
        other => panic!("{other} does not turn over"),
    }
}

/// Whether so many hits of a share of 95 % are within the central 99.9 % of the binomial distribution, shared by `tests` tests.
fn is_in_band(hits: u64, trials: u64, tests: f64) -> bool {
    let tail = 0.0005 / tests;
    binomial_cdf(hits, trials, 0.95) > tail
        && (hits == 0 || 1.0 - binomial_cdf(hits - 1, trials, 0.95) > tail)
}

#[test]
fn a_hundred_instruments_are_found_to_be_what_was_drawn() {
    let kind = Preset::At500.instrument();
    let mut hits = std::collections::BTreeMap::new();
    let (mut chi2, mut freedom, mut gained) = (0.0, 0.0, 1.0_f64);
    for trial in 0..INSTRUMENTS {
        let own = kind.draw_misalignment(&mut stream_at(1, trial, StreamSource::Instrument, 0));
        let mut tracker = LaserTracker::placed(kind, Transform::identity());
        tracker.errors.misalignment = own;
        let rng = &mut stream_at(1, trial, StreamSource::Acceptance, 1);
        let readings: Vec<[SphericalReading; 2]> = points()
            .iter()
            .map(|point| {
                [calibrig::measurement::Face::Front, calibrig::measurement::Face::Back].map(|face| {
                    tracker.measure(point, &Shot { face, ..Shot::default() }, rng).expect("in reach")
                })
            })
            .collect();
        let pairs: Vec<_> = readings.iter().map(|[front, back]| TwoFacePair { front, back }).collect();
        let found = two_face(&pairs, &tracker.stated()).expect("enough points");
        assert_eq!(found.terms.len(), 10);
        chi2 += found.chi2;
        freedom += found.degrees_of_freedom as f64;
        for term in &found.terms {
            let off = (term.value - drawn(&own, term.term)) / term.sigma;
            *hits.entry(term.term).or_insert(0_u64) += u64::from(off.abs() <= NORMAL_95);
            let prior = term.prior_sigma.expect("stated");
            assert!(term.sigma < prior, "{term:?}");
            if term.term == InstrumentTerm::Collimation {
                gained = gained.min(term.sigma / prior);
            }
        }
    }
    println!(
        "intervals that hold, of {INSTRUMENTS}: {hits:?}; chi-square {chi2:.0} of {freedom}; collimation known {gained:.2} of its prior"
    );
    for (term, hits) in &hits {
        assert!(is_in_band(*hits, u64::from(INSTRUMENTS), TURNED), "{term}: {hits}");
    }
    let level = chi2_cdf(chi2, freedom);
    assert!((0.0005..=0.9995).contains(&level), "{chi2} of {freedom}: {level}");
}
