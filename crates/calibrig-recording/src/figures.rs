//! Figures for display only: histograms of errors, correlations of parameters, the convergence to the minimum.

use nalgebra::{DMatrix, Vector3};

use super::Story;
use calibrig_estimation::identification::{Estimate, Mode, ParameterEstimate};
use calibrig_model::ParameterId;

/// Bins of one width, the same on either side of zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bins {
    /// m
    pub width: f64,
    /// Bins between zero and the largest error.
    reach: usize,
}

/// Errors counted in bins.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Histogram {
    /// Middle of each bin, m.
    pub centres: Vec<f64>,
    pub counts: Vec<u64>,
}

/// Most bins between zero and the largest error.
const MOST_BINS: f64 = 20.0;

impl Bins {
    /// Bins that hold all finite errors, of a round width: 1, 2 or 5 times a power of ten, m. `None` without such errors.
    pub(super) fn around<'a>(errors: impl IntoIterator<Item = &'a Vector3<f64>>) -> Option<Self> {
        let largest =
            errors.into_iter().map(nalgebra::Matrix::norm).filter(|e| e.is_finite()).reduce(f64::max)?;
        // An exact fit has errors as well: of rounding.
        let largest = largest.max(1e-12);
        let least = largest / MOST_BINS;
        let decade = 10_f64.powf(least.log10().floor());
        let width =
            [1.0, 2.0, 5.0, 10.0].map(|step| step * decade).into_iter().find(|width| *width >= least)?;
        // From 8 to 20 by the choice above.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let reach = (largest / width).ceil().clamp(1.0, MOST_BINS) as usize;
        Some(Self { width, reach })
    }

    /// Counts of signed values, m.
    pub(super) fn signed(self, values: impl IntoIterator<Item = f64>) -> Histogram {
        self.count(self.reach, values)
    }

    /// Counts of lengths, m.
    pub(super) fn lengths(self, values: impl IntoIterator<Item = f64>) -> Histogram {
        self.count(0, values)
    }

    /// With `below` bins below zero.
    fn count(self, below: usize, values: impl IntoIterator<Item = f64>) -> Histogram {
        let zero = below as f64;
        let mut counts = vec![0; below + self.reach];
        let last = (counts.len() - 1) as f64;
        for value in values.into_iter().filter(|value| value.is_finite()) {
            // The outermost bins take what rounding puts onto their edges.
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let bin = (value / self.width + zero).floor().clamp(0.0, last) as usize;
            counts[bin] += 1;
        }
        let centres = (0..counts.len()).map(|bin| (bin as f64 - zero + 0.5) * self.width).collect();
        Histogram { centres, counts }
    }
}

/// Coefficients of correlation of an estimate's parameters.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Correlations(DMatrix<f64>);

impl Correlations {
    /// `None` if the estimate has no covariance. A parameter without variance, at its bound, has no correlations.
    pub(super) fn of(estimate: &Estimate) -> Option<Self> {
        let covariance = estimate.covariance.as_ref()?;
        let sigmas = covariance.diagonal().map(f64::sqrt);
        Some(Self(DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
            let coefficient = covariance[(i, j)] / (sigmas[i] * sigmas[j]);
            if coefficient.is_finite() { coefficient.clamp(-1.0, 1.0) } else { 0.0 }
        })))
    }

    /// Number of parameters.
    pub(super) fn len(&self) -> usize {
        self.0.nrows()
    }

    /// Every pair once: row, column < row, coefficient.
    pub(super) fn pairs(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        (0..self.len()).flat_map(move |row| (0..row).map(move |column| (row, column, self.0[(row, column)])))
    }

    /// The `most` strongest pairs, strongest first.
    pub(super) fn strongest(&self, most: usize) -> Vec<(usize, usize, f64)> {
        let mut pairs: Vec<_> = self.pairs().filter(|(_, _, r)| *r != 0.0).collect();
        pairs.sort_by(|(_, _, a), (_, _, b)| b.abs().total_cmp(&a.abs()));
        pairs.truncate(most);
        pairs
    }
}

/// The modes that identified something, with what they found.
pub(super) fn identified<'a>(story: &Story<'a>) -> impl Iterator<Item = (Mode, &'a Estimate)> {
    story.modes.iter().filter_map(|m| Some((m.mode, m.estimate.as_ref()?)))
}

/// The name of the group that a parameter belongs to.
pub(super) fn group(id: ParameterId) -> String {
    match id {
        ParameterId::Link { link, .. } => format!("link {}", link + 1),
        ParameterId::Frame { station, .. } => format!("frame {}", station + 1),
        ParameterId::Target { target, .. } | ParameterId::Orientation { target, .. } => {
            format!("target {}", target + 1)
        }
        ParameterId::Compliance(_) => "compliances".to_owned(),
        ParameterId::Mass { .. } | ParameterId::Centre { .. } => "masses".to_owned(),
        ParameterId::Linkage(_) => "linkage".to_owned(),
        ParameterId::Term(term) => term.family().key().to_owned(),
        ParameterId::Instrument { instrument, .. } => format!("tracker {}", instrument + 1),
        ParameterId::Drift { station, .. } => format!("drift {}", station + 1),
    }
}

/// How a parameter approached its final value.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Approach {
    /// Index of the parameter.
    pub parameter: usize,
    /// Distance from the final value after each iteration, in standard deviations of the result.
    pub distances: Vec<f64>,
}

/// The approach of every parameter with a standard deviation (or one of its prior), slowest first: ordered by the distance left after the last
/// iteration but one, then after the one before it, and so on.
pub(super) fn approaches(estimate: &Estimate) -> Vec<Approach> {
    let way = |(index, parameter): (usize, &ParameterEstimate)| {
        let scale = parameter.sigma.or(parameter.prior_sigma).filter(|s| *s > 0.0)?;
        let distance = |x: &f64| (x - parameter.value).abs() / scale;
        let distances: Option<_> =
            estimate.iterations.iter().map(|i| i.parameters.get(index).map(distance)).collect();
        Some(Approach { parameter: index, distances: distances? })
    };
    let mut ways: Vec<_> = estimate.parameters.iter().enumerate().filter_map(way).collect();
    let later_first = |a: &f64, b: &f64| b.total_cmp(a);
    ways.sort_by(|a, b| {
        let pairs = a.distances.iter().rev().zip(b.distances.iter().rev());
        pairs.map(|(a, b)| later_first(a, b)).find(|order| order.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
    });
    ways
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn every_error_falls_into_one_bin_of_a_round_width() {
        let errors = [[1.1e-3, 0.0, 0.0], [0.0, -2.9e-3, 0.0], [0.0, 0.0, 3.1e-3], [f64::NAN, 0.0, 0.0]]
            .map(Vector3::from);
        let bins = Bins::around(&errors).expect("errors");
        assert!((bins.width - 0.2e-3).abs() < 1e-18);
        let lengths = bins.lengths(errors.iter().map(Vector3::norm));
        assert_eq!(lengths.counts.iter().sum::<u64>(), 3);
        assert_eq!(
            (lengths.counts.len(), lengths.counts[5], lengths.counts[14], lengths.counts[15]),
            (16, 1, 1, 1)
        );
        let signed = bins.signed(errors.iter().map(|e| e.y));
        assert_eq!(signed.counts.len(), 32);
        let bin =
            signed.counts.iter().zip(&signed.centres).find(|(_, centre)| (**centre + 2.9e-3).abs() < 1e-6);
        assert_eq!(bin.expect("a bin").0, &1);
        assert_eq!((signed.counts[16], signed.counts.iter().sum::<u64>()), (3, 4));
        assert!(Bins::around(&[]).is_none());
        let exact = Bins::around(&[Vector3::zeros()]).expect("an error");
        assert_eq!(exact.lengths([0.0]).counts.iter().sum::<u64>(), 1);
    }

    #[test]
    fn the_largest_error_lies_in_the_last_bin_whatever_its_size() {
        for size in [3e-9, 1e-6, 1e-3, 2e-3, 5e-3, 9.99e-3, 0.031, 7.0] {
            let bins = Bins::around(&[Vector3::new(0.0, size, 0.0)]).expect("an error");
            let histogram = bins.lengths([size]);
            assert_eq!(histogram.counts.last(), Some(&1), "{size} {bins:?}");
            assert!((8..=20).contains(&histogram.counts.len()), "{size} {bins:?}");
            assert_eq!(bins.signed([-size]).counts.first(), Some(&1), "{size} {bins:?}");
        }
    }

    #[test]
    fn correlations_are_covariances_in_units_of_both_deviations() {
        let outcome = synthetic::outcome(3, 1, true);
        let mut estimate = outcome.modes[1].estimate.clone().expect("identified");
        let n = estimate.parameters.len();
        let mut covariance =
            DMatrix::from_diagonal(&nalgebra::DVector::from_fn(n, |i, _| 4.0 * (i + 1) as f64));
        covariance[(2, 0)] = -6.0;
        covariance[(0, 2)] = -6.0;
        // At its bound.
        covariance[(1, 1)] = 0.0;
        estimate.covariance = Some(covariance);
        let correlations = Correlations::of(&estimate).expect("a covariance");
        let strongest = correlations.strongest(5);
        assert_eq!(strongest.len(), 1);
        assert_eq!((strongest[0].0, strongest[0].1), (2, 0));
        assert!((strongest[0].2 + 6.0 / 48_f64.sqrt()).abs() < 1e-15);
        assert_eq!(correlations.pairs().count(), n * (n - 1) / 2);
        estimate.covariance = None;
        assert_eq!(Correlations::of(&estimate), None);
    }

    #[test]
    fn the_parameter_that_settles_last_comes_first() {
        let outcome = synthetic::outcome(3, 1, true);
        let mut estimate = outcome.modes[1].estimate.clone().expect("identified");
        let last = estimate.parameters.len() - 1;
        let sigma = estimate.parameters[last].sigma.expect("known");
        estimate.iterations[3].parameters[last] = estimate.parameters[last].value - 1e6 * sigma;
        let ways = approaches(&estimate);
        assert_eq!(ways[0].parameter, last);
        assert!((ways[0].distances[3] / 1e6 - 1.0).abs() < 1e-9);
        assert_eq!(ways[0].distances[4], 0.0);
        estimate.parameters[last].sigma = None;
        assert_eq!(approaches(&estimate).len(), last, "nothing to measure its distance with");
    }
}
