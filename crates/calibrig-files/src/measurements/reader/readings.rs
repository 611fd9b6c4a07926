//! What a row's cells state about the target: a point, or a full pose.

use nalgebra::{Cholesky, DMatrix, Matrix3, Matrix6, Rotation3, SMatrix, Vector3};

use super::Cells;
use crate::input::InputError;
use crate::measurements::columns::{BackAngles, PolarAngle};
use crate::measurements::faces::{FaceSeen, Faces};
use crate::measurements::header::{Position, Quantity, RotationQuantities, UncertaintyColumns};
use crate::rotation::RotationError;
use calibrig_model::geometry::cross_matrix;
use calibrig_model::measurement::{Face, PoseReading, Reading, SphericalReading};

impl Cells<'_> {
    /// `None` for a missed shot.
    pub(super) fn reading(&self) -> Result<Option<Reading>, InputError> {
        if let Some(rotation) = &self.reader.columns.rotation {
            return self.pose_reading(rotation);
        }
        let noise = &self.reader.columns.noise;
        let Some(mut point) = self.point()? else { return Ok(None) };
        match (&mut point, noise) {
            (Reading::Cartesian { position, covariance: covariance @ None }, Some(noise)) => {
                *covariance = Some(noise.at(position));
            }
            (Reading::Spherical(reading @ SphericalReading { covariance: None, .. }), Some(noise)) => {
                match noise.of_reading(reading) {
                    Some(own) => reading.covariance = Some(own),
                    None => {
                        let position = reading.position();
                        point = Reading::Cartesian { position, covariance: Some(noise.at(&position)) };
                    }
                }
            }
            _ => {}
        }
        if let Reading::Cartesian { covariance: Some(covariance), .. } = &point
            && !is_definite(covariance)
        {
            let message = "the uncertainties of its coordinates are too different in size to compute with";
            let expected = "standard deviations of a measured point: are their units right?";
            return Err(self.row.refuse(self.reader.file, None, message.to_owned(), expected));
        }
        Ok(Some(point))
    }

    /// The place with the uncertainty stated in its row; `None` for a missed shot.
    fn point(&self) -> Result<Option<Reading>, InputError> {
        match &self.reader.columns.position {
            Position::Cartesian(axes) => {
                let mut position = Vector3::zeros();
                for (coordinate, quantity) in position.iter_mut().zip(axes) {
                    *coordinate = self.value(quantity)?;
                    self.check_size(quantity.terms[0].column, *coordinate)?;
                }
                if position == Vector3::zeros() {
                    return Ok(None);
                }
                Ok(Some(Reading::Cartesian { position, covariance: self.covariance()? }))
            }
            Position::Spherical { range, azimuth, polar, polar_angle } => {
                let values = [self.value(range)?, self.value(azimuth)?, self.value(polar)?];
                if values.iter().all(|v| *v == 0.0) {
                    return Ok(None);
                }
                if values[0] <= 0.0 {
                    return Err(self.refuse_cell(range.terms[0].column, "a range above zero; name the value that marks a \
                                                                        missed shot with `--missed CODE`, or `missed` in \
                                                                        [position] of the column map"));
                }
                // The standard deviation of an elevation is that of the zenith angle.
                Ok(Some(Reading::Spherical(SphericalReading {
                    range: values[0],
                    azimuth: values[1],
                    elevation: match polar_angle {
                        PolarAngle::Elevation => values[2],
                        PolarAngle::Zenith => std::f64::consts::FRAC_PI_2 - values[2],
                    },
                    covariance: self.covariance()?,
                    face: Face::Front,
                })))
            }
        }
    }

    /// Place and rotation, of the target in the tracker's frame whichever way the file has them.
    fn pose_reading(&self, rotation: &RotationQuantities) -> Result<Option<Reading>, InputError> {
        let Some(point) = self.point()? else { return Ok(None) };
        let first = rotation.columns[0].terms[0].column;
        if self.is_empty(&rotation.columns) {
            let message = format!("the rotation is empty ({})", self.names_of(&rotation.columns));
            let expected = "a rotation in every row: a set holds either full poses or points";
            return Err(self.refuse(first, message, expected));
        }
        let mut numbers = Vec::with_capacity(rotation.columns.len());
        for quantity in &rotation.columns {
            numbers.push(self.value(quantity)?);
        }
        let read = rotation.form.rotation(&numbers).map_err(|error: RotationError| {
            let message = format!("{error} (columns {})", self.names_of(&rotation.columns));
            self.refuse(first, message, error.expected())
        })?;
        self.reader.rounded.set(self.reader.rounded.get().max(read.off));
        let stated = Stated { position: point.position(), rotation: read.rotation };
        let (pose, jacobian) = if rotation.is_of_tracker { stated.turned_around() } else { (stated, None) };
        let place = self.reader.columns.position.quantities()[0].terms[0].column;
        pose.position.iter().try_for_each(|coordinate| self.check_size(place, *coordinate))?;
        let covariance = self.pose_covariance(rotation, &point, &pose, jacobian.as_ref())?;
        covariance.iter().flatten().try_for_each(|element| self.check_size(place, *element))?;
        // After inversion, a hardly known rotation swamps the position's own digits.
        if covariance.as_ref().is_some_and(|covariance| !is_definite(covariance)) {
            return Err(self.refuse_apart());
        }
        Ok(Some(Reading::Pose(Box::new(PoseReading {
            position: pose.position,
            rotation: pose.rotation,
            covariance,
        }))))
    }

    /// Of place and rotation in the tracker's axes; `None` if neither is stated. `jacobian` converts the file's numbers to the pose if they
    /// are those of the tracker in the target's frame.
    fn pose_covariance(
        &self,
        rotation: &RotationQuantities,
        point: &Reading,
        pose: &Stated,
        jacobian: Option<&Matrix6<f64>>,
    ) -> Result<Option<Matrix6<f64>>, InputError> {
        let turned = |stated: Matrix6<f64>| jacobian.map_or(stated, |j| j * stated * j.transpose());
        if let Some(whole) = self.whole_covariance()? {
            return Ok(Some(turned(whole)));
        }
        let noise = self.reader.columns.noise.as_ref();
        let of_place = point.position_covariance();
        let stated = self.rotation_covariance(rotation)?;
        let isotropic = |sigma: f64| Matrix3::from_diagonal_element(sigma * sigma);
        let of_rotation = stated.or(noise.and_then(|noise| noise.rotation).map(isotropic));
        match (of_place, of_rotation) {
            (Some(of_place), Some(of_rotation)) => Ok(Some(turned(blocks(&of_place, &of_rotation)))),
            (None, of_rotation) => match (noise, of_rotation) {
                // The instrument's noise is along its own line of sight whichever way the file has the pose.
                (Some(noise), Some(of_rotation)) => {
                    let own = blocks(&noise.at(&pose.position), &Matrix3::zeros());
                    Ok(Some(own + turned(blocks(&Matrix3::zeros(), &of_rotation))))
                }
                (None, None) => Ok(None),
                (Some(_), None) => Err(self.refuse_half("position", "rotation")),
                (None, Some(_)) => Err(self.refuse_half("rotation", "position")),
            },
            (Some(_), None) => Err(self.refuse_half("position", "rotation")),
        }
    }

    fn refuse_apart(&self) -> InputError {
        let message =
            "the uncertainties of its position and rotation are too different in size to compute with";
        let expected = "standard deviations of a measured pose: are their units right?";
        self.row.refuse(self.reader.file, None, message.to_owned(), expected)
    }

    fn refuse_half(&self, stated: &str, missing: &str) -> InputError {
        let message =
            format!("the uncertainty of the {stated} is stated, but that of the {missing} is empty");
        let expected = "both in a row, or neither; or [noise] in the column map with rotation_urad for rows without their own";
        self.row.refuse(self.reader.file, None, message, expected)
    }

    fn rotation_covariance(&self, rotation: &RotationQuantities) -> Result<Option<Matrix3<f64>>, InputError> {
        let Some((columns, coverage)) = &rotation.sigma else { return Ok(None) };
        if self.is_empty(columns) {
            return Ok(None);
        }
        let mut variances = Vector3::zeros();
        for (axis, variance) in variances.iter_mut().enumerate() {
            let quantity = columns.get(axis).unwrap_or(&columns[0]);
            let sigma = self.above_zero(quantity, "standard deviation")? / coverage;
            *variance = sigma * sigma;
            self.check_variance(quantity.terms[0].column, *variance)?;
        }
        Ok(Some(Matrix3::from_diagonal(&variances)))
    }

    /// The 6 x 6 covariance stated in the row.
    fn whole_covariance(&self) -> Result<Option<Matrix6<f64>>, InputError> {
        let Some(UncertaintyColumns::Pose { columns, scales }) = &self.reader.columns.uncertainty else {
            return Ok(None);
        };
        if self.is_empty(columns) {
            return Ok(None);
        }
        let place = |i: usize, j: usize| {
            let (i, j) = (i.min(j), i.max(j));
            if columns.len() == 36 { 6 * i + j } else { 6 * i - i * (i + 1) / 2 + j }
        };
        let mut covariance = Matrix6::zeros();
        for i in 0..6 {
            self.above_zero(&columns[place(i, i)], "variance")?;
            for j in i..6 {
                let element = self.value(&columns[place(i, j)])? * scales[i] * scales[j];
                self.check_size(columns[place(i, j)].terms[0].column, element)?;
                (covariance[(i, j)], covariance[(j, i)]) = (element, element);
            }
        }
        if columns.len() == 36 {
            self.check_symmetry(columns, scales, &covariance)?;
        }
        if !is_definite(&covariance) {
            return Err(self.refuse_covariance(columns));
        }
        Ok(Some(covariance))
    }

    /// Refuses a whole matrix whose two halves differ by more than their digits.
    fn check_symmetry(
        &self,
        columns: &[Quantity],
        scales: &[f64; 6],
        covariance: &Matrix6<f64>,
    ) -> Result<(), InputError> {
        for i in 0..6 {
            for j in 0..i {
                let below = self.value(&columns[6 * i + j])? * scales[i] * scales[j];
                let size = (covariance[(i, i)] * covariance[(j, j)]).sqrt();
                if (below - covariance[(i, j)]).abs() > 1e-3 * size {
                    let message = format!(
                        "the covariance is not symmetric: {} is {below:e}, but {} is {:e} (SI)",
                        self.names_of(&columns[6 * i + j..=6 * i + j]),
                        self.names_of(&columns[6 * j + i..=6 * j + i]),
                        covariance[(i, j)]
                    );
                    let expected =
                        "all 36 elements by rows: position (x, y, z), then rotation (about x, y, z)";
                    return Err(self.refuse(columns[6 * i + j].terms[0].column, message, expected));
                }
            }
        }
        Ok(())
    }

    /// Gives a spherical reading its face, and the direction of the point instead of the encoders' angles in the back face.
    pub(super) fn turn_to_point(&self, reading: &mut Reading, faces: &Faces) -> Result<FaceSeen, InputError> {
        let Reading::Spherical(spherical) = reading else {
            return match &self.reader.columns.face {
                Some((column, _)) => {
                    let message = "the point is straight above or below the tracker, where it has no azimuth";
                    Err(self.refuse(
                        *column,
                        message,
                        "a reading with an azimuth, or its uncertainty in [sigma]",
                    ))
                }
                None => Ok(FaceSeen::Nothing),
            };
        };
        let polar = self.reader.columns.position.quantities()[2].terms[0].column;
        // Beyond the zenith or the nadir, from where a tracker looks back over its head.
        let is_beyond = spherical.elevation.cos() < 0.0;
        let Some((column, face)) = &self.reader.columns.face else {
            let is_angle = spherical.elevation.abs() <= std::f64::consts::TAU;
            return Ok(if is_beyond && is_angle { FaceSeen::Beyond } else { FaceSeen::Nothing });
        };
        let cell = self.cell(*column);
        let is_one_of = |words: &[String]| {
            words.iter().any(|word| word.eq_ignore_ascii_case(cell) || self.is_same_number(*column, word))
        };
        let [front, back] = &face.words;
        if face.angles == BackAngles::Own && cell == Face::Both.key() {
            spherical.face = Face::Both;
            return Ok(FaceSeen::Front);
        }
        if is_one_of(front) {
            if is_beyond && face.angles != BackAngles::Own {
                let expected = "an angle of the front face: a zenith from 0 to 180°, an elevation from -90° to 90°; or the back face";
                return Err(self.refuse_cell(polar, expected));
            }
            return Ok(FaceSeen::Front);
        }
        if !is_one_of(back) {
            let expected = format!(
                "one of {front:?} (front face) or {back:?} (back face), as [face] of a column map states"
            );
            return Err(self.refuse_cell(*column, &expected));
        }
        spherical.face = Face::Back;
        let is_raw = self.are_raw(is_beyond, polar, face.angles, faces)?;
        if is_raw {
            turn_over(spherical);
        }
        Ok(FaceSeen::Back { is_raw, is_found: face.angles == BackAngles::Found })
    }

    /// Whether the angles of a back-face reading are those of the encoders: as stated, else as in the rows before.
    fn are_raw(
        &self,
        is_beyond: bool,
        polar: usize,
        angles: BackAngles,
        faces: &Faces,
    ) -> Result<bool, InputError> {
        let kind = |is_raw: bool| {
            if is_raw {
                "the encoders' own (a zenith beyond 180°)"
            } else {
                "of the point (a zenith up to 180°)"
            }
        };
        let stated = |here: &str, other: &str| {
            format!(
                "[face] states angles = {here:?}; if all back-face readings are like this one, state angles = {other:?}, or \
                 leave angles out"
            )
        };
        let (expected, why) = match (angles, &faces.back) {
            (BackAngles::Own, _) => return Ok(false),
            (BackAngles::Raw, _) => (true, stated("raw", "direction")),
            (BackAngles::Direction, _) => (false, stated("direction", "raw")),
            (BackAngles::Found, None) => return Ok(is_beyond),
            (BackAngles::Found, Some((is_raw, place))) => (
                *is_raw,
                format!(
                    "they are so in {place}; state with angles in [face] of the column map which they are"
                ),
            ),
        };
        if expected == is_beyond {
            return Ok(is_beyond);
        }
        let expected = format!("back-face angles that are {}: {why}", kind(expected));
        Err(self.refuse_cell(polar, &expected))
    }

    fn is_same_number(&self, column: usize, word: &str) -> bool {
        let number = self.decimal(column).parse(self.cell(column));
        number.is_some_and(|number| word.parse() == Ok(number))
    }

    fn names_of(&self, quantities: &[Quantity]) -> String {
        let names: Vec<_> = quantities.iter().map(|quantity| self.header(quantity.terms[0].column)).collect();
        names.join(", ")
    }

    /// `None` if the file has no columns for it, or the row has nothing in them.
    fn covariance(&self) -> Result<Option<Matrix3<f64>>, InputError> {
        match &self.reader.columns.uncertainty {
            // That of a full pose is read as a whole.
            None | Some(UncertaintyColumns::Pose { .. }) => Ok(None),
            Some(UncertaintyColumns::Sigmas { columns, coverage }) => {
                if self.is_empty(columns) {
                    return Ok(None);
                }
                let mut variances = Vector3::zeros();
                for (variance, quantity) in variances.iter_mut().zip(columns) {
                    let sigma = self.above_zero(quantity, "standard deviation")? / coverage;
                    *variance = sigma * sigma;
                    self.check_variance(quantity.terms[0].column, *variance)?;
                }
                Ok(Some(Matrix3::from_diagonal(&variances)))
            }
            Some(UncertaintyColumns::Covariance(columns)) => {
                if self.is_empty(columns) {
                    return Ok(None);
                }
                let mut values = [0.0; 6];
                for (value, quantity) in values.iter_mut().zip(columns) {
                    *value = self.value(quantity)?;
                }
                for axis in 0..3 {
                    self.above_zero(&columns[TRIANGLE[axis][axis]], "variance")?;
                }
                let covariance = Matrix3::from_fn(|i, j| values[TRIANGLE[i][j]]);
                if !is_definite(&covariance) {
                    return Err(self.refuse_covariance(columns));
                }
                Ok(Some(covariance))
            }
        }
    }

    /// `what` is a measure of uncertainty.
    fn above_zero(&self, quantity: &Quantity, what: &str) -> Result<f64, InputError> {
        let number = self.value(quantity)?;
        let column = quantity.terms[0].column;
        if number == 0.0 {
            return Err(self.refuse_zero(column, what));
        }
        let expected = format!("a {what} above zero");
        if number > 0.0 { Ok(number) } else { Err(self.refuse_cell(column, &expected)) }
    }

    fn refuse_zero(&self, column: usize, what: &str) -> InputError {
        let message =
            format!("column {} is {:?}: a {what} of 0 was read", self.header(column), self.cell(column));
        let help = format!(
            "a {what} above zero, since no reading is exact: if the instrument rounds, at least its rounding step; or leave \
             the cells of the row's uncertainty empty, so that it counts as not stated"
        );
        self.refuse(column, message, &help)
    }

    fn refuse_covariance(&self, columns: &[Quantity]) -> InputError {
        let names: Vec<_> = columns.iter().map(|quantity| self.header(quantity.terms[0].column)).collect();
        let message = format!("the covariance of {} is not positive definite", names.join(", "));
        let expected = "correlations between -1 and 1 that do not contradict each other";
        self.refuse(columns[0].terms[0].column, message, expected)
    }

    fn check_variance(&self, column: usize, variance: f64) -> Result<(), InputError> {
        // The square of a very small number is zero.
        if variance == 0.0 {
            Err(self.refuse_zero(column, "variance"))
        } else {
            self.check_size(column, variance)
        }
    }

    fn check_size(&self, column: usize, value: f64) -> Result<(), InputError> {
        if value.is_finite() { Ok(()) } else { Err(self.refuse_cell(column, "a number of a plausible size")) }
    }
}

/// A pose as a file has it.
struct Stated {
    position: Vector3<f64>,
    rotation: Rotation3<f64>,
}

impl Stated {
    /// The inverse of the pose, and its derivative by errors of the stated numbers: e of the position and φ of `exp(φ) · rotation`.
    fn turned_around(&self) -> (Self, Option<Matrix6<f64>>) {
        let rotation = self.rotation.inverse();
        let position = -(rotation * self.position);
        // p = -R' exp(-φ) (p' + e) = p - R' e - R' [p'] φ to first order, and exp(-R' φ) R' is the rotation.
        let mut jacobian = Matrix6::zeros();
        let back = -rotation.matrix();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(back * cross_matrix(&self.position)));
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&back);
        (Self { position, rotation }, Some(jacobian))
    }
}

fn blocks(of_place: &Matrix3<f64>, of_rotation: &Matrix3<f64>) -> Matrix6<f64> {
    let mut covariance = Matrix6::zeros();
    covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(of_place);
    covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(of_rotation);
    covariance
}

/// From the encoders' azimuth + 180° and 360° - zenith to the direction of the point.
fn turn_over(reading: &mut SphericalReading) {
    use std::f64::consts::{PI, TAU};
    reading.azimuth += if reading.azimuth > 0.0 { -PI } else { PI };
    let over = PI - reading.elevation;
    reading.elevation = over - TAU * (over / TAU).round();
    // The elevation of the point falls where the encoder's rises.
    if let Some(covariance) = &mut reading.covariance {
        for other in 0..2 {
            covariance[(other, 2)] = -covariance[(other, 2)];
            covariance[(2, other)] = -covariance[(2, other)];
        }
    }
}

/// Place of a symmetric matrix's element in its upper triangle by rows.
const TRIANGLE: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];

/// Share of a variance that the other coordinates must leave open: less is lost in later rounding.
const OPEN: f64 = 1e-12;

/// Whether it is positive definite by more than rounding, whatever the units of its rows.
fn is_definite<const N: usize>(covariance: &SMatrix<f64, N, N>) -> bool {
    let scale: Vec<f64> = covariance.diagonal().iter().map(|variance| 1.0 / variance.sqrt()).collect();
    let factor = Cholesky::new(DMatrix::from_fn(N, N, |i, j| covariance[(i, j)] * scale[i] * scale[j]));
    factor.is_some_and(|factor| factor.l_dirty().diagonal().iter().all(|pivot| pivot * pivot > OPEN))
}
