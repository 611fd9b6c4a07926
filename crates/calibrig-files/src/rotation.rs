//! Rotations as files write them: quaternions, rotation vectors, angles about three axes, and matrices.
//!
//! Numbers do not show their convention: a quaternion with w last is a different rotation with w first, and so is a transposed matrix. The
//! caller therefore states it.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use thiserror::Error;

/// Largest deviation from a rotation that rounding explains: three decimals.
const ROUNDED: f64 = 2e-3;

/// Up to this deviation numbers are used as they are, bit for bit.
const EXACT: f64 = 1e-13;

/// Why numbers are not a rotation.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum RotationError {
    /// A number that is not finite.
    #[error("the rotation holds {value}")]
    NotFinite {
        /// The number.
        value: f64,
    },
    /// A quaternion of zeros.
    #[error("the quaternion has length 0")]
    ZeroQuaternion,
    /// A quaternion whose length rounding does not explain.
    #[error("the quaternion has length {length:.6}, which differs from 1 by {:.1e}", (length - 1.0).abs())]
    QuaternionLength {
        /// Its length.
        length: f64,
    },
    /// A matrix that mirrors.
    #[error("the matrix is left-handed: its determinant is {determinant:.4}")]
    LeftHanded {
        /// Its determinant.
        determinant: f64,
    },
    /// A matrix whose columns are not of length one, or not at right angles.
    #[error(
        "the matrix is not a rotation: its columns differ from unit vectors at right angles by {off:.1e}"
    )]
    NotOrthonormal {
        /// Largest element of its product with its transpose, less the identity.
        off: f64,
    },
}

impl RotationError {
    /// What was expected, and what to do.
    pub fn expected(self) -> &'static str {
        match self {
            Self::NotFinite { .. } => "finite numbers of a size that a rotation can have",
            Self::ZeroQuaternion => {
                "a quaternion of length 1; if zeros mark a pose that was not seen, leave its position empty: it then counts \
                 as a missed shot"
            }
            Self::QuaternionLength { .. } => {
                "a quaternion of length 1 within its rounding: check that these are its four columns, w among them, and that \
                 none is scaled"
            }
            Self::LeftHanded { .. } => {
                "a right-handed rotation, of determinant 1: set the program that wrote it to a right-handed frame, or reverse \
                 the sign of one axis, of the positions as well"
            }
            Self::NotOrthonormal { .. } => {
                "columns of length 1 at right angles within their rounding: check that these are the nine columns of one \
                 matrix, in the stated order and not scaled"
            }
        }
    }
}

/// Position of the scalar among a quaternion's four numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum QuaternionOrder {
    ScalarFirst,
    ScalarLast,
}

/// In which order nine numbers fill a matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MatrixOrder {
    ByRows,
    ByColumns,
}

/// Three consecutive turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct EulerSequence {
    /// Axes in the order of the angles: 0 is x.
    axes: [usize; 3],
    /// Whether each turn is about the axes as the turns before it left them.
    is_intrinsic: bool,
}

/// How a rotation is written in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RotationForm {
    Quaternion(QuaternionOrder),
    /// Axis times angle.
    Vector,
    Euler(EulerSequence),
    Matrix(MatrixOrder),
}

/// A rotation, and how far its numbers deviated from one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ReadRotation {
    pub rotation: Rotation3<f64>,
    pub off: f64,
}

impl EulerSequence {
    pub const KUKA: Self = Self { axes: [2, 1, 0], is_intrinsic: true };
    pub const FANUC: Self = Self { axes: [0, 1, 2], is_intrinsic: false };
    pub const STAUBLI: Self = Self { axes: [0, 1, 2], is_intrinsic: true };
    pub const KAWASAKI: Self = Self { axes: [2, 1, 2], is_intrinsic: true };

    /// Reads `zyx intrinsic`, `xyz fixed`.
    pub fn parse(text: &str) -> Option<Self> {
        let (axes, kind) = text.trim().split_once(' ')?;
        let axis = |letter: u8| b"xyz".iter().position(|known| *known == letter);
        let &[a, b, c] = axes.as_bytes() else { return None };
        let axes = [axis(a)?, axis(b)?, axis(c)?];
        let is_intrinsic = match kind.trim() {
            "intrinsic" => true,
            "fixed" => false,
            _ => return None,
        };
        // Two consecutive turns about one axis are one.
        (axes[0] != axes[1] && axes[1] != axes[2]).then_some(Self { axes, is_intrinsic })
    }

    fn rotation(self, angles: [f64; 3]) -> Rotation3<f64> {
        let turn = |place: usize| {
            let axis = match self.axes[place] {
                0 => Vector3::x_axis(),
                1 => Vector3::y_axis(),
                _ => Vector3::z_axis(),
            };
            Rotation3::from_axis_angle(&axis, angles[place])
        };
        let [a, b, c] = [turn(0), turn(1), turn(2)];
        if self.is_intrinsic { a * b * c } else { c * b * a }
    }
}

impl RotationForm {
    /// How many numbers it takes.
    pub fn count(self) -> usize {
        match self {
            Self::Quaternion(_) => 4,
            Self::Vector | Self::Euler(_) => 3,
            Self::Matrix(_) => 9,
        }
    }

    /// Whether its numbers are angles.
    pub fn has_unit(self) -> bool {
        matches!(self, Self::Vector | Self::Euler(_))
    }

    /// The rotation of as many numbers, angles in rad.
    pub fn rotation(self, numbers: &[f64]) -> Result<ReadRotation, RotationError> {
        if let Some(value) = numbers.iter().copied().find(|number| !number.is_finite()) {
            return Err(RotationError::NotFinite { value });
        }
        let at = |index: usize| numbers.get(index).copied().unwrap_or_default();
        match self {
            Self::Quaternion(QuaternionOrder::ScalarFirst) => of_quaternion(at(0), [at(1), at(2), at(3)]),
            Self::Quaternion(QuaternionOrder::ScalarLast) => of_quaternion(at(3), [at(0), at(1), at(2)]),
            Self::Vector => of_angles(Rotation3::new(Vector3::new(at(0), at(1), at(2))), numbers),
            Self::Euler(sequence) => of_angles(sequence.rotation([at(0), at(1), at(2)]), numbers),
            Self::Matrix(MatrixOrder::ByRows) => of_matrix(&Matrix3::from_fn(|i, j| at(3 * i + j))),
            Self::Matrix(MatrixOrder::ByColumns) => of_matrix(&Matrix3::from_fn(|i, j| at(3 * j + i))),
        }
    }
}

/// Angles of any number of turns are too large for a rotation.
fn of_angles(rotation: Rotation3<f64>, numbers: &[f64]) -> Result<ReadRotation, RotationError> {
    if rotation.matrix().iter().all(|element| element.is_finite()) {
        return Ok(ReadRotation { rotation, off: 0.0 });
    }
    let largest = numbers.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()));
    Err(RotationError::NotFinite { value: largest.unwrap_or(f64::NAN) })
}

fn of_quaternion(w: f64, [x, y, z]: [f64; 3]) -> Result<ReadRotation, RotationError> {
    let quaternion = Quaternion::new(w, x, y, z);
    let length = quaternion.norm();
    if length == 0.0 {
        return Err(RotationError::ZeroQuaternion);
    }
    let off = (length - 1.0).abs();
    if off > ROUNDED {
        return Err(RotationError::QuaternionLength { length });
    }
    let rotation = UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix();
    Ok(ReadRotation { rotation, off })
}

fn of_matrix(matrix: &Matrix3<f64>) -> Result<ReadRotation, RotationError> {
    let off = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    let determinant = matrix.determinant();
    if off > ROUNDED {
        return Err(RotationError::NotOrthonormal { off });
    }
    if determinant < 0.0 {
        return Err(RotationError::LeftHanded { determinant });
    }
    if off <= EXACT {
        return Ok(ReadRotation { rotation: Rotation3::from_matrix_unchecked(*matrix), off });
    }
    let svd = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(RotationError::NotOrthonormal { off });
    };
    Ok(ReadRotation { rotation: Rotation3::from_matrix_unchecked(u * v_t), off })
}

/// The rotation of a matrix that may be rounded to a few digits: the nearest one; one that is exact to 1e-13 stays as it is, bit for bit.
///
/// # Errors
/// Errors for a matrix with a number that is not finite, a left-handed one, and one that differs from a rotation by more
/// than 2e-3.
pub fn rotation_of_matrix(matrix: &Matrix3<f64>) -> Result<Rotation3<f64>, RotationError> {
    if let Some(value) = matrix.iter().copied().find(|number| !number.is_finite()) {
        return Err(RotationError::NotFinite { value });
    }
    of_matrix(matrix).map(|read| read.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    fn apart(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
        (a.matrix() - b.matrix()).amax()
    }

    fn read(form: RotationForm, numbers: &[f64]) -> Rotation3<f64> {
        form.rotation(numbers).expect("a rotation").rotation
    }

    /// What manufacturers print of their own conventions, by where an axis goes.
    #[test]
    fn each_convention_turns_as_its_manual_says() {
        let [a, b, c] = [0.3_f64, -0.5, 0.7];
        let (sa, ca) = a.sin_cos();
        let (sb, cb) = b.sin_cos();
        let (sc, cc) = c.sin_cos();
        // KUKA: A about z, B about the new y, C about the new x. Written out.
        let kuka = Matrix3::new(
            ca * cb,
            ca * sb * sc - sa * cc,
            ca * sb * cc + sa * sc,
            sa * cb,
            sa * sb * sc + ca * cc,
            sa * sb * cc - ca * sc,
            -sb,
            cb * sc,
            cb * cc,
        );
        let found = read(RotationForm::Euler(EulerSequence::KUKA), &[a, b, c]);
        assert!((found.matrix() - kuka).amax() < 1e-15, "{found}");
        // FANUC: W about the fixed x, P about the fixed y, R about the fixed z: the same with the angles in the other order.
        let fanuc = read(RotationForm::Euler(EulerSequence::FANUC), &[c, b, a]);
        assert!(apart(&fanuc, &found) < 1e-15);
        // Staubli: Rx, then the new y, then the new z. Where z goes is (sin ry, -sin rx cos ry, cos rx cos ry).
        let staubli = read(RotationForm::Euler(EulerSequence::STAUBLI), &[a, b, c]);
        assert!((staubli * Vector3::z() - Vector3::new(sb, -sa * cb, ca * cb)).amax() < 1e-15);
        // Kawasaki: O and A say where z goes as longitude and angle from z.
        let kawasaki = read(RotationForm::Euler(EulerSequence::KAWASAKI), &[a, b, c]);
        assert!((kawasaki * Vector3::z() - Vector3::new(ca * sb, sa * sb, cb)).amax() < 1e-15);
        // A quarter turn about z takes x to y.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        for (form, numbers) in [
            (RotationForm::Quaternion(QuaternionOrder::ScalarFirst), &[half, 0.0, 0.0, half][..]),
            (RotationForm::Quaternion(QuaternionOrder::ScalarLast), &[0.0, 0.0, half, half]),
            (RotationForm::Vector, &[0.0, 0.0, FRAC_PI_2]),
            (RotationForm::Matrix(MatrixOrder::ByRows), &[0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
            (RotationForm::Matrix(MatrixOrder::ByColumns), &[0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        ] {
            assert!((read(form, numbers) * Vector3::x() - Vector3::y()).amax() < 1e-15, "{form:?}");
        }
    }

    #[test]
    fn sequences_are_stated_whole() {
        assert_eq!(EulerSequence::parse("zyx intrinsic"), Some(EulerSequence::KUKA));
        assert_eq!(EulerSequence::parse("xyz fixed"), Some(EulerSequence::FANUC));
        for text in ["zyx", "xxz fixed", "xzz fixed", "abc fixed", "xy fixed", "xyz moving", ""] {
            assert_eq!(EulerSequence::parse(text), None, "{text}");
        }
    }

    #[test]
    fn what_is_no_rotation_is_told_by_how_much() {
        let wxyz = RotationForm::Quaternion(QuaternionOrder::ScalarFirst);
        assert_eq!(wxyz.rotation(&[0.0; 4]), Err(RotationError::ZeroQuaternion));
        let long = wxyz.rotation(&[1.0, 0.1, 0.0, 0.0]).expect_err("too long").to_string();
        assert_eq!(long, "the quaternion has length 1.004988, which differs from 1 by 5.0e-3");
        let rows = RotationForm::Matrix(MatrixOrder::ByRows);
        let mirrored = rows.rotation(&[1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0]).expect_err("mirrored");
        assert_eq!(mirrored.to_string(), "the matrix is left-handed: its determinant is -1.0000");
        let scaled = rows.rotation(&[2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]).expect_err("scaled");
        assert_eq!(scaled, RotationError::NotOrthonormal { off: 3.0 });
        assert!(matches!(rows.rotation(&[f64::NAN; 9]), Err(RotationError::NotFinite { .. })));
        let endless = RotationForm::Vector.rotation(&[1e300, 0.0, -1e305]);
        assert_eq!(endless, Err(RotationError::NotFinite { value: -1e305 }));
        // A sequence whose middle angle leaves two axes in line is a rotation all the same.
        assert!(RotationForm::Euler(EulerSequence::KUKA).rotation(&[0.4, FRAC_PI_2, 0.2]).is_ok());
    }

    proptest! {
        /// Rounded to few digits it is the same rotation, up to them; with all digits it is the same bits.
        #[test]
        fn digits_cost_no_more_than_themselves(v in prop::array::uniform3(-2.0f64..2.0), digits in 4i32..12) {
            let rotation = Rotation3::new(v.into());
            prop_assert_eq!(rotation_of_matrix(rotation.matrix()), Ok(rotation));
            let unit = 10f64.powi(-digits);
            let rounded = rotation.matrix().map(|element| (element / unit).round() * unit);
            let found = rotation_of_matrix(&rounded).expect("rounded");
            // Nearest to the rounded one, which is within half a unit in each of nine elements.
            prop_assert!((found.matrix() - rotation.matrix()).norm() <= 2.0 * 1.5 * unit);
            prop_assert!((found.matrix().transpose() * found.matrix() - Matrix3::identity()).amax() < 1e-9);
            let q = UnitQuaternion::from_rotation_matrix(&rotation);
            let numbers = [q.i, q.j, q.k, q.w].map(|element| (element / unit).round() * unit);
            let found = read(RotationForm::Quaternion(QuaternionOrder::ScalarLast), &numbers);
            prop_assert!(apart(&found, &rotation) <= 4.0 * unit);
        }
    }
}
