//! Compares the stated scatter of readings with that of repeats and of residuals, in the instrument's own directions.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{ChiSquareTest, chi2_band};
use calibrig_model::measurement::{MeasurementSet, Reading, beam_axes};

/// Probability with which the band of repeats holds their chi-square if the readings scatter as stated.
pub const REPEATS_LEVEL: f64 = 0.999;

/// Scatter of a set. Vectors are along the beam, and across it in the directions of growing azimuth and elevation, as lengths at the target, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScatterComparison {
    /// Number of readings.
    pub readings: usize,
    /// RMS of the standard deviations that the readings state for themselves; `None` where a reading states none.
    pub stated: Option<Vector3<f64>>,
    /// RMS of how far the stated shared errors of the instruments can displace the readings, before a fit absorbs part of them; `None` where nothing
    /// is stated of an instrument.
    pub shared: Option<Vector3<f64>>,
    /// Scatter of repeats; `None` without repeats.
    pub repeats: Option<RepeatScatter>,
    /// RMS of the residuals.
    pub residuals: Vector3<f64>,
    /// Part of the residuals' sum of squares that the stated noise is expected to leave: about 1 where there is nothing else, more where it is stated
    /// too large.
    pub noise_share: Option<f64>,
    /// Part of the residuals' sum of squares that the shared errors leave at most: a fit absorbs part of them in what it identifies.
    pub shared_share: Option<f64>,
}

/// Scatter of readings of the same pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RepeatScatter {
    /// Number of poses (of a station and a target) with more than one reading.
    pub poses: usize,
    /// Number of readings of these poses beyond the first.
    pub repeats: usize,
    /// Standard deviations, pooled over the poses; they include the machine's own scatter.
    pub sigma: Vector3<f64>,
    /// Test against the stated noise; `None` where none is stated.
    pub test: Option<ChiSquareTest>,
    /// Band that holds chi-square per degree of freedom with 99.9 % if the readings scatter as stated and the machine does not.
    pub band: (f64, f64),
}

/// Directions along the beam to a point, and across it there, in the tracker's frame, as columns.
fn directions(point: &Vector3<f64>) -> Matrix3<f64> {
    beam_axes(point.y.atan2(point.x), point.z.atan2(point.x.hypot(point.y)))
}

/// Compares what the readings of a set state with their `errors` (measured minus predicted in the frame of their station's tracker, m, one per
/// observation). `left` is the part of each observation's variance that the fit leaves, 1 - leverage / 3; empty for a set that was not fitted.
/// `None` for a set without readings, for lists of another length, and for numbers that are not finite.
pub fn compare_scatter(
    set: &MeasurementSet,
    errors: &[Vector3<f64>],
    left: &[f64],
) -> Option<ScatterComparison> {
    let observations = &set.observations;
    if observations.is_empty() || observations.len() != errors.len() {
        return None;
    }
    let n = observations.len() as f64;
    let rms = |squares: Vector3<f64>| (squares / n).map(f64::sqrt);
    let mut residuals = Vector3::zeros();
    let (mut stated, mut shared) = (Some(Vector3::zeros()), Some(Vector3::zeros()));
    let (mut noise_left, mut shared_left) = (0.0, 0.0);
    for (i, (observation, error)) in observations.iter().zip(errors).enumerate() {
        let reading = &observation.reading;
        let axes = directions(&reading.position());
        let along = axes.transpose() * error;
        residuals += along.component_mul(&along);
        let left = left.get(i).copied().unwrap_or(1.0);
        let own = reading.position_covariance().map(|c| (axes.transpose() * c * axes).diagonal());
        noise_left += left * own.map_or(0.0, |variances| variances.sum());
        stated = stated.zip(own).map(|(sum, variances)| sum + variances);
        let [range, azimuth, elevation] = reading.spherical();
        let instrument = set.stations.get(observation.station).and_then(|s| s.instrument.as_ref());
        let common = instrument.map(|instrument| {
            let square = |d: Vector3<f64>| d.component_mul(&d);
            let terms = instrument.sigmas.iter();
            terms
                .map(|(term, sigma)| {
                    square(*sigma * term.displacement(range, azimuth, elevation, reading.face()))
                })
                .sum::<Vector3<f64>>()
        });
        shared_left += common.map_or(0.0, |variances| variances.sum());
        shared = shared.zip(common).map(|(sum, variances)| sum + variances);
    }
    let total = residuals.sum();
    if !total.is_finite() {
        return None;
    }
    let share = |part: f64| (total > 0.0).then(|| part / total);
    Some(ScatterComparison {
        readings: observations.len(),
        noise_share: stated.and_then(|_| share(noise_left)),
        shared_share: shared.and_then(|_| share(shared_left)),
        stated: stated.map(rms),
        shared: shared.map(rms),
        repeats: repeat_scatter(set),
        residuals: rms(residuals),
    })
}

fn repeat_scatter(set: &MeasurementSet) -> Option<RepeatScatter> {
    let groups = set.repeated_readings();
    let repeats: usize = groups.iter().map(|group| group.len() - 1).sum();
    if repeats == 0 {
        return None;
    }
    let mut squares = Vector3::zeros();
    let mut chi2 = Some(0.0);
    for group in &groups {
        let readings = || group.iter().map(|i| &set.observations[*i].reading);
        let mean = readings().map(Reading::position).sum::<Vector3<f64>>() / group.len() as f64;
        let axes = directions(&mean);
        for reading in readings() {
            let along = axes.transpose() * (reading.position() - mean);
            squares += along.component_mul(&along);
        }
        // About the mean that weighs every reading by its stated covariance: chi-square with three fewer degrees of freedom than coordinates.
        let weights: Option<Vec<Matrix3<f64>>> =
            readings().map(|r| Some(r.position_covariance()?.cholesky()?.inverse())).collect();
        chi2 = chi2.zip(weights).and_then(|(sum, weights)| {
            let information = weights.iter().sum::<Matrix3<f64>>();
            let weighted = readings().zip(&weights).map(|(r, w)| w * r.position()).sum::<Vector3<f64>>();
            let mean = information.cholesky()?.solve(&weighted);
            let own = readings().zip(&weights).map(|(r, w)| {
                let off = r.position() - mean;
                off.dot(&(w * off))
            });
            Some(sum + own.sum::<f64>())
        });
    }
    let dof = 3.0 * repeats as f64;
    Some(RepeatScatter {
        poses: groups.len(),
        repeats,
        sigma: (squares / repeats as f64).map(f64::sqrt),
        test: chi2.filter(|chi2| chi2.is_finite()).and_then(|chi2| ChiSquareTest::new(chi2, dof)),
        band: chi2_band(dof, REPEATS_LEVEL),
    })
}

impl RepeatScatter {
    /// Whether the readings scatter by more than stated (`Some(true)`) or by less (`Some(false)`); `None` where chance can explain it.
    pub fn differs(&self) -> Option<bool> {
        let per_dof = self.test.map(|test| test.chi2 / test.dof)?;
        let (low, high) = self.band;
        if per_dof > high {
            Some(true)
        } else if per_dof < low {
            Some(false)
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::measurement::{Face, InstrumentTerm, SphericalReading, StatedInstrument};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Standard deviations in metres along the beam and in radians across it.
    const SIGMAS: [f64; 3] = [2e-6, 3e-6, 1.5e-6];

    /// `poses` at different places, each read `times` times; the machine scatters by `machine` along each axis of the tracker. Errors are those of
    /// the readings.
    fn measured(poses: u32, times: u32, machine: f64, seed: u64) -> (MeasurementSet, Vec<Vector3<f64>>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = move || -> f64 { StandardNormal.sample(&mut rng) };
        let mut set = MeasurementSet::of_points([]);
        let mut errors = Vec::new();
        for pose in 0..poses {
            let turn = f64::from(pose);
            let exact = SphericalReading {
                range: 2.0 + 1.5 * turn.sin(),
                azimuth: 1.1 * turn,
                elevation: 0.9 * (2.0 * turn).sin(),
                covariance: Some(Matrix3::from_diagonal(&Vector3::from(SIGMAS.map(|s| s * s)))),
                face: Face::Front,
            };
            for _ in 0..times {
                let moved = exact.position() + machine * Vector3::from_fn(|_, _| draw());
                let read = SphericalReading {
                    range: moved.norm() + SIGMAS[0] * draw(),
                    azimuth: moved.y.atan2(moved.x) + SIGMAS[1] * draw(),
                    elevation: (moved.z / moved.norm()).asin() + SIGMAS[2] * draw(),
                    ..exact.clone()
                };
                errors.push(read.position() - exact.position());
                set.observations.push(calibrig_model::measurement::Observation {
                    pose,
                    command: vec![turn],
                    approach: vec![1],
                    since_reversal: Vec::new(),
                    temperature: None,
                    time: 0.0,
                    station: 0,
                    target: 0,
                    payload: None,
                    reading: Reading::Spherical(read),
                });
            }
        }
        (set, errors)
    }

    /// By hand: one reading straight ahead, 10 m away and 0.3 rad up.
    #[test]
    fn lengths_are_along_the_beam_and_across_it() {
        let (mut set, _) = measured(1, 1, 0.0, 1);
        let Reading::Spherical(reading) = &mut set.observations[0].reading else { panic!("spherical") };
        (reading.range, reading.azimuth, reading.elevation) = (10.0, 0.0, 0.3);
        let (sin, cos) = 0.3_f64.sin_cos();
        let error =
            5e-5 * Vector3::new(cos, 0.0, sin) + 2e-5 * Vector3::y() - 1e-5 * Vector3::new(-sin, 0.0, cos);
        let found = compare_scatter(&set, &[error], &[]).expect("a reading");
        assert!((found.residuals - Vector3::new(5e-5, 2e-5, 1e-5)).norm() < 1e-15, "{}", found.residuals);
        // 3 urad of azimuth at 10 m cos(0.3 rad), 1.5 urad of elevation.
        let expected = Vector3::new(2e-6, 3e-5 * cos, 1.5e-5);
        assert!((found.stated.expect("stated") - expected).norm() < 1e-15);
        let share = expected.norm_squared() / error.norm_squared();
        assert!((found.noise_share.expect("stated") - share).abs() < 1e-12);
        let half = compare_scatter(&set, &[error], &[0.5]).expect("a reading");
        assert!((half.noise_share.expect("stated") - 0.5 * share).abs() < 1e-12);
        assert_eq!((found.repeats, found.shared, found.shared_share), (None, None, None));

        // 10 um of range offset and 2 urad of collimation, which is a length of 20 um at 10 m.
        let sigmas = vec![(InstrumentTerm::RangeOffset, 1e-5), (InstrumentTerm::Collimation, 2e-6)];
        set.stations[0].instrument = Some(StatedInstrument { name: "1".to_owned(), sigmas, drift: None });
        let found = compare_scatter(&set, &[error], &[]).expect("a reading");
        assert!((found.shared.expect("an instrument") - Vector3::new(1e-5, 2e-5, 0.0)).norm() < 1e-15);
        assert!((found.shared_share.expect("one") - 5e-10 / error.norm_squared()).abs() < 1e-12);
    }

    #[test]
    fn what_does_not_belong_together_gives_nothing() {
        let (set, errors) = measured(3, 1, 0.0, 1);
        assert!(compare_scatter(&set, &errors[1..], &[]).is_none());
        assert!(compare_scatter(&MeasurementSet::of_points([]), &[], &[]).is_none());
        assert!(compare_scatter(&set, &[Vector3::repeat(f64::NAN); 3], &[]).is_none());
        // Without a stated covariance there is nothing to compare with; the residuals remain.
        let points = MeasurementSet::of_points([(vec![0.0], Vector3::x()), (vec![0.0], 1.1 * Vector3::x())]);
        let found = compare_scatter(&points, &[Vector3::x(), Vector3::x()], &[]).expect("two readings");
        assert_eq!((found.stated, found.noise_share), (None, None));
        let repeats = found.repeats.expect("a pose twice");
        assert!((repeats.sigma.x - 0.1 * 0.5_f64.sqrt()).abs() < 1e-12 && repeats.test.is_none());
        assert_eq!(repeats.differs(), None);
    }

    /// Readings that scatter as stated: the chi-square of 50 such sets is outside its 99.9 % band in 2 at most (p = 2e-5), shares of 1 lie within
    /// four standard deviations sqrt(2/600), and the scatter of a machine is found.
    #[test]
    fn repeats_tell_a_machine_that_scatters() {
        let mut outside = 0;
        for seed in 0..50 {
            let (set, errors) = measured(20, 11, 0.0, seed);
            let found = compare_scatter(&set, &errors, &[]).expect("readings");
            let repeats = found.repeats.expect("repeats");
            assert_eq!((repeats.poses, repeats.repeats), (20, 200));
            outside += usize::from(repeats.differs().is_some());
            // The sum of squares is dominated by azimuth and elevation: the share scatters by less than sqrt(2 / 200).
            assert!((found.noise_share.expect("stated") - 1.0).abs() < 5.0 * 0.1, "{found:?}");
            let stated = found.stated.expect("stated");
            for axis in 0..3 {
                assert!((repeats.sigma[axis] / stated[axis] - 1.0).abs() < 0.35, "{found:?}");
            }
        }
        assert!(outside <= 2, "{outside}");
        // 20 um of the machine against at most 10 um of the reading: 4 % and less.
        let (set, errors) = measured(20, 11, 2e-5, 99);
        let found = compare_scatter(&set, &errors, &[]).expect("readings");
        assert_eq!(found.repeats.expect("repeats").differs(), Some(true));
        let share = found.noise_share.expect("stated");
        let expected = {
            let variance = found.stated.expect("stated").norm_squared();
            variance / (variance + 3.0 * 4e-10)
        };
        assert!((share / expected - 1.0).abs() < 0.25, "{share} {expected}");
    }
}
