//! The tracker's place, from the base nests.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix6, Vector6};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{DRIFT_UNIT, StatedInstrument, Station};
use crate::geometry::{Transform, best_fit_transform, cross_matrix, small_displacement};

/// The place of a station, with its covariance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    /// `tracker_from_base`.
    pub tracker_from_base: Transform,
    /// Covariance of the displacement `xi` in `tracker_from_base · exp(xi)`: m², m rad, rad².
    pub covariance: Matrix6<f64>,
    /// Weighted sum of squares of the fit, with 3 nests - 6 degrees of freedom.
    pub chi2: f64,
}

/// Why nests do not place a station.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum RegistrationError {
    /// Too few.
    #[error(
        "{found} base nests were measured: placing the tracker needs at least 3 that are not on one line"
    )]
    TooFewNests {
        /// Their number.
        found: usize,
    },
    /// On one line.
    #[error(
        "the base nests lie on one line and do not determine the tracker's place: add a nest away from that line"
    )]
    OnOneLine,
    /// A covariance that is missing or not positive definite.
    #[error(
        "nest {nest}: its covariance is missing or not positive definite: state the noise of its reading and the uncertainty \
         of its certified place"
    )]
    Covariance {
        /// Name of the nest.
        nest: String,
    },
}

/// Gauss-Newton passes; from a best fit two reach rounding, the third is for poor geometry.
const PASSES: usize = 3;

/// Fits `tracker_from_base` to a station's nests, weighted with the readings' and the certified coordinates' covariance. Readings of one nest
/// share the error of its certified place.
pub fn register(station: &Station) -> Result<Registration, RegistrationError> {
    let nests = &station.nests;
    let found = station.distinct_nests().len();
    if found < 3 {
        return Err(RegistrationError::TooFewNests { found });
    }
    let seen: Vec<_> = nests.iter().map(|n| n.reading.position()).collect();
    let certified: Vec<_> = nests.iter().map(|n| n.in_base).collect();
    let mut tracker_from_base = best_fit_transform(&seen, &certified).ok_or(RegistrationError::OnOneLine)?;
    for pass in 0.. {
        let system = nest_system(station, &tracker_from_base)?;
        let gradient = system.jacobian.tr_mul(&system.residuals);
        let information = system.jacobian.tr_mul(&system.jacobian);
        let information = Matrix6::from_iterator(information.iter().copied());
        let factor = Cholesky::new(information).ok_or(RegistrationError::OnOneLine)?;
        if pass == PASSES {
            let chi2 = system.residuals.norm_squared();
            return Ok(Registration { tracker_from_base, covariance: factor.inverse(), chi2 });
        }
        let step = factor.solve(&Vector6::from_iterator(gradient.iter().copied()));
        tracker_from_base *= small_displacement(&-step);
    }
    Err(RegistrationError::OnOneLine)
}

/// The whitened system that [`register`] solves: three rows per reading, those of one nest consecutive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NestSystem {
    /// Derivative by the displacement `xi` in `tracker_from_base · exp(xi)`, 3 readings x 6.
    pub jacobian: DMatrix<f64>,
    /// Predicted minus seen places, in standard deviations.
    pub residuals: DVector<f64>,
    /// Derivative by the stated errors of the station's instrument, 3 readings x their number.
    pub instrument: DMatrix<f64>,
    /// Derivative by a steady motion of the tracker, per hour, 3 readings x 6; zero if the nests have no times.
    pub drift: DMatrix<f64>,
    /// The nests, in the order of the rows.
    pub nests: Vec<WhitenedNest>,
}

/// The rows of a nest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WhitenedNest {
    /// Its readings: indices into the station's.
    pub readings: Vec<usize>,
    /// Lower triangular: takes displacements of its readings in the tracker's axes, m, to standard deviations.
    pub whitening: DMatrix<f64>,
}

/// The nests of a station as seen from `tracker_from_base`.
///
/// # Errors
///
/// [`RegistrationError::Covariance`], for a nest without one.
pub fn nest_system(
    station: &Station,
    tracker_from_base: &Transform,
) -> Result<NestSystem, RegistrationError> {
    let rows = 3 * station.nests.len();
    let stated: Vec<_> = station.instrument.iter().flat_map(StatedInstrument::errors).collect();
    let mut system = NestSystem {
        jacobian: DMatrix::zeros(rows, 6),
        residuals: DVector::zeros(rows),
        instrument: DMatrix::zeros(rows, stated.len()),
        drift: DMatrix::zeros(rows, 6),
        nests: Vec::new(),
    };
    let placed_at = station.placed_at();
    let rotation = *tracker_from_base.rotation.matrix();
    let mut first = 0;
    for readings in station.distinct_nests() {
        let n = 3 * readings.len();
        let failed = || RegistrationError::Covariance { nest: station.nests[readings[0]].name.clone() };
        let certified = rotation * station.nests[readings[0]].in_base_covariance * rotation.transpose();
        let mut covariance = DMatrix::from_fn(n, n, |i, j| certified[(i % 3, j % 3)]);
        let mut jacobian = DMatrix::zeros(n, 6);
        let mut residuals = DVector::zeros(n);
        let mut instrument = DMatrix::zeros(n, stated.len());
        let mut drift = DMatrix::zeros(n, 6);
        for (row, index) in (0..n).step_by(3).zip(&readings) {
            let nest = &station.nests[*index];
            let own = nest.reading.position_covariance().ok_or_else(failed)?;
            let mut block = covariance.fixed_view_mut::<3, 3>(row, row);
            block += own;
            let seen = nest.reading.position();
            let predicted = rotation * nest.in_base + tracker_from_base.translation.vector;
            residuals.fixed_rows_mut::<3>(row).copy_from(&(predicted - seen));
            jacobian.fixed_view_mut::<3, 3>(row, 0).copy_from(&rotation);
            let turn = -rotation * cross_matrix(&nest.in_base);
            jacobian.fixed_view_mut::<3, 3>(row, 3).copy_from(&turn);
            let hours = nest.time.map_or(0.0, |time| (time - placed_at) / DRIFT_UNIT);
            drift.fixed_view_mut::<3, 6>(row, 0).copy_from(&(jacobian.fixed_view::<3, 6>(row, 0) * hours));
            for (column, (term, _)) in stated.iter().enumerate() {
                let displaced = nest.reading.displaced_by(*term);
                instrument.fixed_view_mut::<3, 1>(row, column).copy_from(&displaced);
            }
        }
        let factor = Cholesky::new(covariance).ok_or_else(failed)?;
        let whitening = factor.l().solve_lower_triangular(&DMatrix::identity(n, n)).ok_or_else(failed)?;
        system.jacobian.rows_mut(first, n).copy_from(&(&whitening * jacobian));
        system.residuals.rows_mut(first, n).copy_from(&(&whitening * residuals));
        system.instrument.rows_mut(first, n).copy_from(&(&whitening * instrument));
        system.drift.rows_mut(first, n).copy_from(&(&whitening * drift));
        system.nests.push(WhitenedNest { readings, whitening });
        first += n;
    }
    Ok(system)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{rotation_x, rotation_z, translation};
    use crate::measurement::{NestObservation, Reading};
    use nalgebra::{Matrix3, Vector3};

    /// Three readings of a nest are one mean reading with a third of the noise, and the whole error of its certified place.
    #[test]
    fn readings_of_one_nest_share_the_error_of_its_place() {
        let truth = translation(1.0, -2.0, 0.4) * rotation_z(0.7) * rotation_x(0.2);
        let (certified, noise) = (Matrix3::identity() * 4e-10, Matrix3::identity() * 9e-10);
        let places = [[0.0, 0.0, 0.0], [2.0, 0.1, 0.0], [0.3, 1.5, 0.2], [1.0, 1.0, 1.2]].map(Vector3::from);
        let nest = |number: usize, shift: f64, covariance: Matrix3<f64>| {
            let place = places[number];
            let seen = truth.rotation * place + truth.translation.vector;
            let off = shift * Vector3::new(1.0, (number as f64).sin(), -1.0) * 1e-5;
            NestObservation {
                name: format!("N{number}"),
                in_base: place,
                in_base_covariance: certified,
                reading: Reading::Cartesian { position: seen + off, covariance: Some(covariance) },
                time: None,
            }
        };
        let shifts = [0.5, -2.0, 3.0];
        let mean = shifts.iter().sum::<f64>() / 3.0;
        let station = |nests| Station { name: "T".to_owned(), nests, ..Station::default() };
        let repeated = (0..3).flat_map(|round: usize| (0..4).map(move |n| (n, round)));
        let repeated = station(repeated.map(|(n, round)| nest(n, shifts[round], noise)).collect());
        let averaged = station((0..4).map(|n| nest(n, mean, noise / 3.0)).collect());
        assert_eq!(repeated.distinct_nests().len(), 4);
        let (repeated, averaged) =
            (register(&repeated).expect("four nests"), register(&averaged).expect("four nests"));
        let apart = repeated.tracker_from_base.to_homogeneous() - averaged.tracker_from_base.to_homogeneous();
        assert!(apart.amax() < 1e-13, "{apart}");
        let relative = (repeated.covariance - averaged.covariance).amax() / averaged.covariance.amax();
        assert!(relative < 1e-9, "{relative}");
    }
}
