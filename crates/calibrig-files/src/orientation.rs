//! The orientation of a target on the flange as keys of TOML files: one of four forms, each with its convention in the key.

use std::ops::Range;

use nalgebra::Matrix3;

use crate::input::{InputError, Source, Spanned};
use crate::rotation::{EulerSequence, MatrixOrder, QuaternionOrder, RotationForm};
use calibrig_model::measurement::TargetOrientation;

pub(crate) type Three = Spanned<[f64; 3]>;
pub(crate) type Four = Spanned<[f64; 4]>;
pub(crate) type Square = Spanned<[[f64; 3]; 3]>;

/// The keys of a table.
pub(crate) struct OrientationKeys<'t> {
    pub quaternion_wxyz: Option<&'t Four>,
    pub quaternion_xyzw: Option<&'t Four>,
    pub vector_rad: Option<&'t Three>,
    pub euler_rad: Option<&'t Three>,
    pub sequence: Option<&'t Spanned<String>>,
    pub matrix: Option<&'t Square>,
    pub sigma_rad: Option<&'t Spanned<f64>>,
    pub covariance_rad2: Option<&'t Square>,
}

const FORMS: &str = "one of rotation_quaternion_wxyz, rotation_quaternion_xyzw, rotation_vector_rad, rotation_euler_rad (with rotation_sequence) and \
                     rotation_matrix (three rows)";

impl OrientationKeys<'_> {
    /// `flange_from_target`, if stated.
    pub fn read(&self, source: &Source) -> Result<Option<TargetOrientation>, InputError> {
        let refused = |span: Range<usize>, message: &str, expected: &str| {
            Err(source.error(span, message, Some(format!("expected {expected}"))))
        };
        let mut stated: Vec<(Range<usize>, RotationForm, Vec<f64>)> = Vec::new();
        let mut add = |span: Range<usize>, form: RotationForm, numbers: &[f64]| {
            stated.push((span, form, numbers.to_vec()));
        };
        if let Some(q) = self.quaternion_wxyz {
            add(q.span(), RotationForm::Quaternion(QuaternionOrder::ScalarFirst), q.get_ref());
        }
        if let Some(q) = self.quaternion_xyzw {
            add(q.span(), RotationForm::Quaternion(QuaternionOrder::ScalarLast), q.get_ref());
        }
        if let Some(v) = self.vector_rad {
            add(v.span(), RotationForm::Vector, v.get_ref());
        }
        if let Some(angles) = self.euler_rad {
            let expected = "rotation_sequence = \"zyx intrinsic\" (each about the axes as the turns before left them) or \"xyz fixed\" (about axes that stay)";
            let Some(sequence) = self.sequence else {
                return refused(angles.span(), "the sequence of the angles is not stated", expected);
            };
            let Some(known) = EulerSequence::parse(sequence.get_ref()) else {
                let message = format!("rotation_sequence is {:?}", sequence.get_ref());
                return refused(sequence.span(), &message, expected);
            };
            add(angles.span(), RotationForm::Euler(known), angles.get_ref());
        } else if let Some(sequence) = self.sequence {
            return refused(
                sequence.span(),
                "rotation_sequence applies to angles, but there are none",
                "rotation_euler_rad with it",
            );
        }
        if let Some(rows) = self.matrix {
            add(rows.span(), RotationForm::Matrix(MatrixOrder::ByRows), rows.get_ref().as_flattened());
        }
        if let Some((span, ..)) = stated.get(1) {
            return refused(span.clone(), "the rotation is given twice", FORMS);
        }
        let Some((span, form, numbers)) = stated.pop() else {
            let uncertainty = self.sigma_rad.map(Spanned::span).or(self.covariance_rad2.map(Spanned::span));
            return match uncertainty {
                Some(span) => {
                    refused(span, "the uncertainty of a rotation is stated, but no rotation", FORMS)
                }
                None => Ok(None),
            };
        };
        let read = form.rotation(&numbers);
        let read = read.map_err(|error| {
            source.error(span, error.to_string(), Some(format!("expected {}", error.expected())))
        })?;
        Ok(Some(TargetOrientation {
            flange_from_target: read.rotation,
            covariance: self.covariance(source)?,
        }))
    }

    /// Of the rotation vector in the target's own axes, rad².
    fn covariance(&self, source: &Source) -> Result<Option<Matrix3<f64>>, InputError> {
        match (self.sigma_rad, self.covariance_rad2) {
            (None, None) => Ok(None),
            (Some(sigma), None) => {
                let sigma = source.not_negative("rotation_sigma_rad", sigma)?;
                Ok(Some(Matrix3::from_diagonal_element(sigma * sigma)))
            }
            (None, Some(covariance)) => {
                covariance_of(source, "rotation_covariance_rad2", covariance).map(Some)
            }
            (Some(sigma), Some(_)) => {
                let message = "both rotation_sigma_rad and rotation_covariance_rad2 are given";
                Err(source.error(sigma.span(), message, Some("expected only one of them".to_owned())))
            }
        }
    }
}

/// Largest number of a session file, as of any number in an input file.
const LARGEST: f64 = 1e15;

/// Refuses numbers outside the range of input files.
pub(crate) fn check_numbers<'n>(
    source: &Source,
    key: &str,
    span: Range<usize>,
    mut numbers: impl Iterator<Item = &'n f64>,
) -> Result<(), InputError> {
    match numbers.find(|number| number.is_nan() || number.abs() > LARGEST) {
        Some(number) => {
            let help = Some(format!("expected finite numbers of at most {LARGEST:e}"));
            Err(source.error(span, format!("{key} holds {number}"), help))
        }
        None => Ok(()),
    }
}

/// A covariance as three rows of three numbers.
pub(crate) fn covariance_of(source: &Source, key: &str, value: &Square) -> Result<Matrix3<f64>, InputError> {
    let rows = value.get_ref();
    check_numbers(source, key, value.span(), rows.as_flattened().iter())?;
    let matrix = Matrix3::from_fn(|i, j| rows[i][j]);
    if let Some(variance) = matrix.diagonal().iter().find(|variance| **variance < 0.0) {
        let message = format!("{key} has {variance:e} on its diagonal");
        return Err(source.error(
            value.span(),
            message,
            Some("expected variances of zero or more".to_owned()),
        ));
    }
    Ok(matrix)
}
