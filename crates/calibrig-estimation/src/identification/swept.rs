//! Readings of sweeps that place a station. Their rows are like those of poses, but enter the fit as the triangular factor of their information on
//! the parameters, so that they are not taken for poses.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix3};

use super::IdentifyError;
use super::factor::triangular_factor_of_all;
use super::forward_model::ForwardModel;
use super::instrument::Instruments;
use super::problem::{PositionRow, Prior};
use crate::circle_points::SweptPlace;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, Observation};

/// The readings of a station's sweeps, each with its covariance.
pub(super) fn swept_rows(
    set: &MeasurementSet,
    index: usize,
    swept: &SweptPlace,
    forward: &mut ForwardModel,
    (instruments, places): (&Instruments, &[Transform]),
) -> Result<Vec<PositionRow>, IdentifyError> {
    let station = &set.stations[index];
    let read: Vec<&Observation> =
        swept.readings.iter().map(|(reading, _)| &station.sweeps[*reading]).collect();
    let row = |(observation, (_, covariance)): (&&Observation, &(usize, Matrix3<f64>))| {
        let pose = observation.pose;
        let what = || format!("a reading of the sweeps of station {}", station.name);
        let whitening = Cholesky::new(*covariance)
            .and_then(|factor| factor.l().solve_lower_triangular(&Matrix3::identity()))
            .ok_or_else(|| IdentifyError::Covariance { what: what() })?;
        Ok::<_, IdentifyError>(PositionRow {
            pose,
            told: forward
                .prepare(&(*observation).into())
                .map_err(|source| IdentifyError::Machine { pose, source })?,
            seen: observation.reading.position(),
            reading: Some(*covariance),
            whitening,
            instrument: Vec::new(),
            hours: 0.0,
            station: index,
            target: observation.target,
        })
    };
    let mut rows = read.iter().zip(&swept.readings).map(row).collect::<Result<Vec<_>, _>>()?;
    instruments.add_to(&mut rows, read.into_iter(), set, places);
    Ok(rows)
}

/// The prior with the information of rows with these residuals and this Jacobian at `x`, and the sum of squares that no parameter changes there.
pub(super) fn condensed(residuals: &DVector<f64>, jacobian: &DMatrix<f64>, x: &[f64]) -> (Prior, f64) {
    let n = jacobian.ncols();
    let at_zero = residuals - jacobian * DVector::from_column_slice(x);
    let mut system = jacobian.clone().insert_column(n, 0.0);
    system.column_mut(n).copy_from(&at_zero);
    let r = triangular_factor_of_all(system.as_view());
    let rows = r.nrows().min(n);
    let left = if r.nrows() > n { r[(n, n)].powi(2) } else { 0.0 };
    let prior = Prior {
        columns: (0..n).collect(),
        whitening: r.view((0, 0), (rows, n)).into_owned(),
        offset: DVector::from_iterator(rows, r.column(n).iter().copied().take(rows)),
    };
    (prior, left)
}
