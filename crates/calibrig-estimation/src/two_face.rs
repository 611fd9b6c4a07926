//! Errors of an instrument from points measured in both faces.
//!
//! Between the faces, errors of the head or the telescope change their sign; the point, the tracker's place and errors that keep their sign cancel in
//! the difference. The rest is linear in the errors, with the signatures of [`InstrumentTerm`]: weighted least squares, with what was stated of the
//! instrument as zero-mean priors.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::fmt;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use thiserror::Error;

use calibrig_model::measurement::{
    Face, InstrumentTerm, MeasurementSet, Observation, Reading, SphericalReading, StatedInstrument, Station,
};
use calibrig_model::statistics::student_t_quantile;

/// One point in both faces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoFacePair<'a> {
    /// Reading in the front face.
    pub front: &'a SphericalReading,
    /// Reading in the back face.
    pub back: &'a SphericalReading,
}

/// An error of the instrument that changes its sign with the face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoFaceTerm {
    /// Which error.
    pub term: InstrumentTerm,
    /// Amplitude, m or rad.
    pub value: f64,
    /// Standard deviation of the amplitude, m or rad.
    pub sigma: f64,
    /// Standard deviation of the stated zero-mean prior, if one was stated.
    pub prior_sigma: Option<f64>,
}

/// The errors found from two faces.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoFaceEstimate {
    /// The errors in the order of [`InstrumentTerm::ALL`].
    pub terms: Vec<TwoFaceTerm>,
    /// Their covariance: m², rad², m rad.
    pub covariance: DMatrix<f64>,
    /// Sum of squares of the weighted residuals, including those of the priors.
    pub chi2: f64,
    /// Degrees of freedom of `chi2`.
    pub degrees_of_freedom: usize,
}

/// Why points in two faces cannot be evaluated.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum TwoFaceError {
    /// The other half of a pair is missing.
    #[error(
        "pose {pose}, station \"{station}\", target \"{target}\": a back-face reading without its front-face reading: measure \
         the pose in the front face as well, or leave the reading out"
    )]
    BackAlone {
        /// Number of the pose.
        pose: u32,
        /// Name of the station.
        station: String,
        /// Name of the target.
        target: String,
    },
    /// A pose does not have one reading in each face.
    #[error(
        "pose {pose}, station \"{station}\", target \"{target}\": {front} front-face and {back} back-face readings: expected \
         one back face per front face"
    )]
    Unpaired {
        /// Number of the pose.
        pose: u32,
        /// Name of the station.
        station: String,
        /// Name of the target.
        target: String,
        /// Number of readings in the front face.
        front: usize,
        /// Number of readings in the back face.
        back: usize,
    },
    /// An observation refers to a station or target that the set does not contain.
    #[error("pose {pose} names a station or a target that the measurements do not describe")]
    UnknownStationOrTarget {
        /// Number of the pose.
        pose: u32,
    },
    /// The readings of a pair are not in the front and the back face.
    #[error("pair {pair}: its readings are in the faces {} and {}: expected front and back", faces[0].key(), faces[1].key())]
    Faces {
        /// Number of the pair, from one.
        pair: usize,
        /// Faces of the reading that should be in the front face, and of the other.
        faces: [Face; 2],
    },
    /// A reading is not finite, or its covariance is missing or not positive definite.
    #[error(
        "pair {pair}: a reading is not a finite number or has no positive definite covariance, so it cannot be weighed"
    )]
    Covariance {
        /// Number of the pair, from one.
        pair: usize,
    },
    /// A stated standard deviation is not a finite number above zero.
    #[error("the stated standard deviation of {term} is {sigma}: expected a finite number above zero")]
    Prior {
        /// Error for which it was stated.
        term: InstrumentTerm,
        /// Standard deviation, m or rad.
        sigma: f64,
    },
    /// There are too few points, or they lie in too few directions.
    #[error(
        "{pairs} points in two faces do not determine {terms} errors separately: measure more, at other ranges and \
         elevations, or state a standard deviation of each"
    )]
    Undetermined {
        /// Number of points.
        pairs: usize,
        /// Number of errors.
        terms: usize,
    },
}

/// The pairs of a set: readings of one pose, station and target in both faces. Front-face readings without a back face are ignored.
pub fn two_face_pairs(set: &MeasurementSet) -> Result<Vec<TwoFacePair<'_>>, TwoFaceError> {
    type Key = (u32, usize, usize);
    type Faces<'a> = [Vec<&'a SphericalReading>; 2];
    let mut places: Vec<(Key, Faces<'_>)> = Vec::new();
    let mut index = std::collections::BTreeMap::<Key, usize>::new();
    for observation in &set.observations {
        let Observation { pose, station, target, reading: Reading::Spherical(reading), .. } = observation
        else {
            continue;
        };
        let key = (*pose, *station, *target);
        let place = *index.entry(key).or_insert_with(|| {
            places.push((key, Faces::default()));
            places.len() - 1
        });
        places[place].1[usize::from(reading.face == Face::Back)].push(reading);
    }
    let mut pairs = Vec::new();
    for ((pose, station, target), [front, back]) in places {
        let names = (set.stations.get(station), set.targets.get(target));
        let (Some(station), Some(target)) = names else {
            return Err(TwoFaceError::UnknownStationOrTarget { pose });
        };
        let (station, target) = (station.name.clone(), target.name.clone());
        match (front.as_slice(), back.as_slice()) {
            (_, []) => {}
            ([], _) => return Err(TwoFaceError::BackAlone { pose, station, target }),
            (front, back) if front.len() != back.len() => {
                let (front, back) = (front.len(), back.len());
                return Err(TwoFaceError::Unpaired { pose, station, target, front, back });
            }
            (front, back) => {
                pairs.extend(front.iter().zip(back).map(|(front, back)| TwoFacePair { front, back }));
            }
        }
    }
    Ok(pairs)
}

/// Mean difference between the two faces of a station, back less front.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceDifference {
    /// Name of the station.
    pub station: String,
    /// Number of points in both faces.
    pub points: usize,
    /// Mean difference across the beam in azimuth (angle times the cosine of the elevation), and in elevation, rad.
    pub mean: [f64; 2],
    /// Standard deviations of both means, from the scatter of the points, rad.
    pub sigma: [f64; 2],
}

/// Two-sided probability by chance below which a difference counts.
const DIFFERS: f64 = 0.001;
/// Fewest points that separate a constant difference from one that varies from point to point.
const LEAST_POINTS: usize = 4;

/// Stations whose two faces differ by more than chance explains although nothing is stated of their instrument, so that no parameter of the fit
/// represents it. Points and nests count the same.
pub fn unexplained_face_differences(set: &MeasurementSet) -> Vec<FaceDifference> {
    let of_station = |(index, station): (usize, &Station)| {
        if station.instrument.is_some() {
            return None;
        }
        // Name of a nest, or pose and target; the values are readings of the front and of the back face.
        type Point<'a> = (Option<&'a str>, u32, usize);
        let mut faces: BTreeMap<Point, [Vec<&SphericalReading>; 2]> = BTreeMap::new();
        let points = set.observations.iter().filter(|observation| observation.station == index);
        let points = points.map(|o| ((None, o.pose, o.target), &o.reading));
        let nests = station.nests.iter().map(|nest| ((Some(nest.name.as_str()), 0, 0), &nest.reading));
        for (key, reading) in points.chain(nests) {
            if let Reading::Spherical(reading) = reading
                && reading.face != Face::Both
            {
                faces.entry(key).or_default()[usize::from(reading.face == Face::Back)].push(reading);
            }
        }
        let pairs = faces.values().flat_map(|[front, back]| front.iter().zip(back));
        let apart: Vec<[f64; 2]> = pairs
            .map(|(front, back)| {
                let turned = (back.azimuth - front.azimuth + PI).rem_euclid(TAU) - PI;
                [turned * front.elevation.cos(), back.elevation - front.elevation]
            })
            .filter(|angles| angles.iter().all(|angle| angle.is_finite()))
            .collect();
        let n = apart.len() as f64;
        if apart.len() < LEAST_POINTS {
            return None;
        }
        let mean = [0, 1].map(|axis| apart.iter().map(|a| a[axis]).sum::<f64>() / n);
        let square = |axis: usize| apart.iter().map(|a| (a[axis] - mean[axis]).powi(2)).sum::<f64>();
        let sigma = [0, 1].map(|axis| (square(axis) / (n - 1.0) / n).sqrt());
        let factor = student_t_quantile(1.0 - 0.5 * DIFFERS, n - 1.0);
        let differs = (0..2).any(|axis| mean[axis].abs() > factor * sigma[axis]);
        let station = station.name.clone();
        differs.then_some(FaceDifference { station, points: apart.len(), mean, sigma })
    };
    set.stations.iter().enumerate().filter_map(of_station).collect()
}

impl fmt::Display for FaceDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [azimuth, elevation] =
            [0, 1].map(|axis| format!("{:.1} +- {:.1} urad", 1e6 * self.mean[axis], 1e6 * self.sigma[axis]));
        write!(
            f,
            "station {}: at {} points the back face differs from the front face by {azimuth} in azimuth (across the beam) and \
             {elevation} in elevation, but the instrument's errors are not stated: state them ([station.instrument] of a \
             session file), so that they are parameters, or average the faces (repeats = \"average\" in [rows] of a column \
             map)",
            self.station, self.points
        )
    }
}

/// The errors of an instrument from points in both faces.
///
/// Of the `stated` errors, those that change their sign are estimated, with the stated standard deviations as priors; if none is listed, all that
/// change their sign are estimated, without priors.
pub fn two_face(
    pairs: &[TwoFacePair<'_>],
    stated: &StatedInstrument,
) -> Result<TwoFaceEstimate, TwoFaceError> {
    let asked = |term: &InstrumentTerm| {
        stated.sigmas.is_empty() || stated.sigmas.iter().any(|(listed, _)| listed == term)
    };
    let terms: Vec<_> =
        InstrumentTerm::ALL.into_iter().filter(|term| turns_over(*term) && asked(term)).collect();
    let prior = |term: InstrumentTerm| stated.sigmas.iter().find(|(t, _)| *t == term).map(|(_, s)| *s);
    let count = terms.len();
    let mut information = DMatrix::zeros(count, count);
    let mut right = DVector::zeros(count);
    for (index, term) in terms.iter().enumerate() {
        let Some(sigma) = prior(*term) else { continue };
        if !(sigma > 0.0 && sigma.is_finite()) {
            return Err(TwoFaceError::Prior { term: *term, sigma });
        }
        information[(index, index)] += sigma.powi(-2);
    }
    let mut square = 0.0;
    for (index, pair) in pairs.iter().enumerate() {
        let row = difference(pair, &terms, index + 1)?;
        information += row.signature.transpose() * row.weight * &row.signature;
        right += row.signature.transpose() * (row.weight * row.apart);
        square += row.apart.dot(&(row.weight * row.apart));
    }
    // Amplitudes are scaled: lengths and angles differ in size.
    let scale = DVector::from_fn(count, |i, _| information[(i, i)].sqrt().recip());
    let undetermined = TwoFaceError::Undetermined { pairs: pairs.len(), terms: count };
    if count == 0 || scale.iter().any(|s| !s.is_finite()) {
        return Err(undetermined);
    }
    let scaled = DMatrix::from_fn(count, count, |i, j| scale[i] * scale[j] * information[(i, j)]);
    let Some(factor) = scaled.clone().cholesky().filter(|_| is_determined(&scaled)) else {
        return Err(undetermined);
    };
    let inverse = factor.inverse();
    let covariance = DMatrix::from_fn(count, count, |i, j| scale[i] * scale[j] * inverse[(i, j)]);
    let values = &covariance * &right;
    let free = terms.iter().filter(|term| prior(**term).is_none()).count();
    Ok(TwoFaceEstimate {
        chi2: square - values.dot(&right),
        degrees_of_freedom: (3 * pairs.len()).saturating_sub(free),
        terms: terms
            .iter()
            .enumerate()
            .map(|(index, term)| TwoFaceTerm {
                term: *term,
                value: values[index],
                sigma: covariance[(index, index)].sqrt(),
                prior_sigma: prior(*term),
            })
            .collect(),
        covariance,
    })
}

/// Whether readings and priors determine every combination of the errors, up to rounding.
fn is_determined(scaled: &DMatrix<f64>) -> bool {
    scaled.symmetric_eigenvalues().min() > 1e-10
}

/// Whether the error has the opposite sign in the back face.
fn turns_over(term: InstrumentTerm) -> bool {
    let at = |face| term.displacement(3.0, 0.7, 0.4, face);
    at(Face::Front) != at(Face::Back)
}

/// Front less back as a length along the beam, along growing azimuth and along growing elevation.
struct Difference {
    /// Front less back, m.
    apart: Vector3<f64>,
    /// Inverse covariance, 1/m².
    weight: Matrix3<f64>,
    /// Derivative by the amplitudes.
    signature: DMatrix<f64>,
}

fn difference(
    pair: &TwoFacePair<'_>,
    terms: &[InstrumentTerm],
    number: usize,
) -> Result<Difference, TwoFaceError> {
    let TwoFacePair { front, back } = pair;
    if (front.face, back.face) != (Face::Front, Face::Back) {
        return Err(TwoFaceError::Faces { pair: number, faces: [front.face, back.face] });
    }
    let turned = front.azimuth - back.azimuth;
    let turn = turned - TAU * (turned / TAU).round();
    let range = 0.5 * (front.range + back.range);
    let (azimuth, elevation) = (front.azimuth - 0.5 * turn, 0.5 * (front.elevation + back.elevation));
    let lengths = Vector3::new(1.0, range * elevation.cos(), range);
    let apart = lengths.component_mul(&Vector3::new(
        front.range - back.range,
        turn,
        front.elevation - back.elevation,
    ));
    let to_lengths = Matrix3::from_diagonal(&lengths);
    let weight = front
        .covariance
        .zip(back.covariance)
        .map(|(front, back)| to_lengths * (front + back) * to_lengths)
        .and_then(Matrix3::cholesky)
        .map(|factor| factor.inverse())
        .filter(|weight| apart.iter().chain(weight.iter()).all(|v| v.is_finite()));
    let Some(weight) = weight else { return Err(TwoFaceError::Covariance { pair: number }) };
    let at = |term: InstrumentTerm, face| term.displacement(range, azimuth, elevation, face);
    let columns: Vec<_> = terms.iter().map(|term| at(*term, Face::Front) - at(*term, Face::Back)).collect();
    let signature = DMatrix::from_fn(3, columns.len(), |row, column| columns[column][row]);
    Ok(Difference { apart, weight, signature })
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::measurement::Target;

    fn reading(face: Face, point: [f64; 3]) -> SphericalReading {
        let [range, azimuth, elevation] = point;
        let covariance = Some(Matrix3::from_diagonal(&Vector3::new(1e-12, 4e-12, 4e-12)));
        SphericalReading { range, azimuth, elevation, covariance, face }
    }

    /// Readings of an instrument with a collimation error, exact to first order.
    fn readings(collimation: f64) -> Vec<[SphericalReading; 2]> {
        let places = [
            [2.0, 3.1, 0.1],
            [4.0, -1.0, -0.4],
            [3.0, 0.4, 0.7],
            [6.0, 1.9, 0.2],
            [1.5, -2.6, -0.6],
            [5.0, 2.4, 0.9],
        ];
        let both = |[range, azimuth, elevation]: [f64; 3]| {
            let turn = collimation / f64::cos(elevation);
            [
                reading(Face::Front, [range, azimuth + turn, elevation]),
                // The controller may count another turn.
                reading(Face::Back, [range, azimuth - turn + TAU, elevation]),
            ]
        };
        places.map(both).to_vec()
    }

    fn pairs(readings: &[[SphericalReading; 2]]) -> Vec<TwoFacePair<'_>> {
        readings.iter().map(|[front, back]| TwoFacePair { front, back }).collect()
    }

    #[test]
    fn what_turns_over_is_found_and_nothing_else_is() {
        let readings = readings(20e-6);
        let found = two_face(&pairs(&readings), &StatedInstrument::default()).expect("enough points");
        assert_eq!(found.terms.len(), 10);
        assert_eq!(found.degrees_of_freedom, 8);
        assert!(found.chi2.abs() < 1e-6, "{}", found.chi2);
        for term in &found.terms {
            let truth = if term.term == InstrumentTerm::Collimation { 20e-6 } else { 0.0 };
            assert!((term.value - truth).abs() < 1e-9, "{term:?}");
        }
        // A prior of a micrometre pulls towards zero according to its weight.
        let stated = StatedInstrument {
            drift: None,
            name: String::new(),
            sigmas: vec![(InstrumentTerm::Collimation, 1e-6), (InstrumentTerm::RangeScale, 1e-6)],
        };
        let held = two_face(&pairs(&readings), &stated).expect("enough points");
        assert_eq!(held.terms.len(), 1, "a scale does not turn over");
        assert!(held.terms[0].value < 20e-6 && held.terms[0].sigma < 1e-6, "{held:?}");
        let weight = 1.0 - (held.terms[0].sigma / 1e-6).powi(2);
        assert!((held.terms[0].value / 20e-6 - weight).abs() < 1e-6, "{held:?}");
    }

    /// A constant vertical index and collimation: the faces differ by twice their size. Noise alone is not reported, nor is an instrument that is
    /// stated.
    #[test]
    fn a_constant_difference_is_told_unless_the_instrument_is_stated() {
        let set = |collimation: f64, index: f64| {
            let readings = readings(collimation);
            let mut set = MeasurementSet::of_points((0..readings.len()).map(|_| (vec![0.0], Vector3::x())));
            let mut back = Vec::new();
            for (k, (observation, pair)) in set.observations.iter_mut().zip(readings).enumerate() {
                let [front, mut turned] = pair;
                turned.elevation += -2.0 * index + 1e-6 * f64::sin(7.0 * k as f64);
                turned.azimuth += 1e-6 * f64::sin(5.0 * k as f64 + 1.0);
                observation.reading = Reading::Spherical(front);
                back.push(Observation { reading: Reading::Spherical(turned), ..observation.clone() });
            }
            set.observations.extend(back);
            set
        };
        assert_eq!(unexplained_face_differences(&set(0.0, 0.0)), []);
        let mut off = set(20e-6, 30e-6);
        let [found] = &unexplained_face_differences(&off)[..] else { panic!("one station") };
        for (axis, expected) in [-40e-6, -60e-6].into_iter().enumerate() {
            let (mean, sigma) = (found.mean[axis], found.sigma[axis]);
            assert!((mean - expected).abs() < 4.0 * sigma && sigma < 1e-6, "{found:?}");
        }
        assert!(found.to_string().contains("[station.instrument]"), "{found}");
        off.stations[0].instrument = Some(StatedInstrument::default());
        assert_eq!(unexplained_face_differences(&off), []);
    }

    #[test]
    fn a_back_face_without_its_front_face_is_named() {
        let mut set = MeasurementSet::of_points((0..3).map(|_| (vec![0.0], Vector3::x())));
        set.stations = vec![Station { name: "door".to_owned(), ..Station::default() }];
        set.targets = vec![Target { name: "SMR 2".to_owned(), ..Target::default() }];
        let readings = readings(0.0);
        for (observation, pair) in set.observations.iter_mut().zip(&readings) {
            observation.reading = Reading::Spherical(pair[0].clone());
        }
        assert_eq!(two_face_pairs(&set).map(|pairs| pairs.len()), Ok(0));
        let mut both = set.clone();
        both.observations.push(Observation {
            reading: Reading::Spherical(readings[1][1].clone()),
            ..set.observations[1].clone()
        });
        assert_eq!(two_face_pairs(&both).map(|pairs| pairs.len()), Ok(1));
        both.observations.remove(1);
        let text = two_face_pairs(&both).expect_err("its front face is gone").to_string();
        assert!(text.contains("pose 2") && text.contains("\"door\"") && text.contains("\"SMR 2\""), "{text}");
        both.observations[0].station = 7;
        assert!(two_face_pairs(&both).is_err());
    }

    #[test]
    fn what_tells_nothing_is_refused() {
        let none = StatedInstrument::default();
        let good = readings(1e-6);
        let undetermined =
            |found: Result<TwoFaceEstimate, _>| matches!(found, Err(TwoFaceError::Undetermined { .. }));
        assert!(undetermined(two_face(&[], &none)));
        assert!(undetermined(two_face(&pairs(&good[..2]), &none)));
        for bad in [f64::NAN, f64::INFINITY] {
            let mut readings = good.clone();
            readings[1][1].elevation = bad;
            assert!(two_face(&pairs(&readings), &none).is_err(), "{bad}");
            readings = good.clone();
            readings[2][0].covariance = Some(Matrix3::identity() * bad);
            assert!(two_face(&pairs(&readings), &none).is_err(), "{bad}");
        }
        let mut readings = good.clone();
        readings[2][0].covariance = None;
        assert_eq!(two_face(&pairs(&readings), &none), Err(TwoFaceError::Covariance { pair: 3 }));
        readings = good.clone();
        readings[0].reverse();
        assert!(matches!(two_face(&pairs(&readings), &none), Err(TwoFaceError::Faces { pair: 1, .. })));
        let sigmas = vec![(InstrumentTerm::Collimation, -1.0)];
        let stated = StatedInstrument { drift: None, name: String::new(), sigmas };
        assert!(matches!(two_face(&pairs(&good), &stated), Err(TwoFaceError::Prior { .. })));
    }
}
