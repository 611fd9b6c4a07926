//! Full poses: their validity, and one computed from three points.

use nalgebra::{Cholesky, DimMin, DimName, Matrix3, Matrix6, OMatrix, Rotation3, SMatrix, Vector3};
use thiserror::Error;

use super::{MeasurementError, PoseReading, Reading, Target};
use crate::geometry::{best_fit_transform, cross_matrix, rotation_vector};

/// Deviation from right angles and unit lengths that rounding to six digits leaves.
const ORTHONORMAL: f64 = 1e-5;

/// Relative difference up to which two entries of a covariance are equal.
const SYMMETRIC: f64 = 1e-6;

impl PoseReading {
    pub(super) fn check(&self, pose: u32, target: &Target) -> Result<(), MeasurementError> {
        check_rotation(&self.rotation, || format!("pose {pose}"))?;
        if self.covariance.as_ref().is_some_and(|covariance| !is_covariance(covariance)) {
            return Err(MeasurementError::PoseCovariance { pose });
        }
        match target.orientation {
            Some(_) => Ok(()),
            None => Err(MeasurementError::PoseOfPoint { pose, target: target.name.clone() }),
        }
    }
}

pub(super) fn check_rotation(
    rotation: &Rotation3<f64>,
    what: impl Fn() -> String,
) -> Result<(), MeasurementError> {
    let off = (rotation.matrix().tr_mul(rotation.matrix()) - Matrix3::identity()).amax();
    if off > ORTHONORMAL {
        return Err(MeasurementError::NoRotation { what: what(), off });
    }
    if rotation.matrix().determinant() < 0.0 {
        return Err(MeasurementError::LeftHanded { what: what() });
    }
    Ok(())
}

/// Whether a matrix is symmetric and positive definite, whatever the units of its rows.
pub(super) fn is_covariance<D: DimName + DimMin<D, Output = D>>(matrix: &OMatrix<f64, D, D>) -> bool
where
    nalgebra::DefaultAllocator: nalgebra::allocator::Allocator<D, D>,
{
    let n = matrix.nrows();
    if !(0..n).all(|i| matrix[(i, i)] > 0.0) {
        return false;
    }
    let mut scaled = matrix.clone_owned();
    for i in 0..n {
        for j in 0..n {
            scaled[(i, j)] /= (matrix[(i, i)] * matrix[(j, j)]).sqrt();
        }
    }
    let is_symmetric = (&scaled - scaled.transpose()).amax() <= SYMMETRIC;
    is_symmetric && Cholesky::new(scaled).is_some()
}

/// Why points do not make a pose.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum CombineError {
    /// Too few, or on one line.
    #[error("a pose needs three or more points that are not on one line; these are fewer, or on one line")]
    OnOneLine,
    /// A reading without a known noise.
    #[error(
        "point {index}: its covariance is missing or not positive definite, so that of the pose cannot be computed: state the \
         noise of every point"
    )]
    Covariance {
        /// Which point, from zero.
        index: usize,
    },
}

/// Passes from the best fit with equal weights; two are enough to reach rounding.
const PASSES: usize = 4;

/// The pose of a tool on which three or more points were seen: `points` holds the place of each in the tool's frame (m) with its reading in
/// the tracker's. The pose is the weighted least-squares one; its covariance is propagated from the readings to first order, so that a point
/// far from the tool's origin says more about the rotation than about the place. The places of the points in the tool are taken as exact.
///
/// # Errors
///
/// [`CombineError`], if the points do not determine a pose, or a reading states no covariance.
pub fn combine(points: &[(Vector3<f64>, &Reading)]) -> Result<PoseReading, CombineError> {
    let in_tool: Vec<_> = points.iter().map(|(place, _)| *place).collect();
    let seen: Vec<_> = points.iter().map(|(_, reading)| reading.position()).collect();
    let mut pose = best_fit_transform(&seen, &in_tool).ok_or(CombineError::OnOneLine)?;
    let weight = |(index, (_, reading)): (usize, &(Vector3<f64>, &Reading))| {
        let covariance = reading.position_covariance().and_then(Cholesky::new);
        covariance.map(|c| c.inverse()).ok_or(CombineError::Covariance { index })
    };
    let weights = points.iter().enumerate().map(weight).collect::<Result<Vec<Matrix3<f64>>, _>>()?;
    for pass in 0.. {
        let mut information = Matrix6::zeros();
        let mut gradient = nalgebra::Vector6::zeros();
        for ((place, seen), weight) in in_tool.iter().zip(&seen).zip(&weights) {
            let arm = pose.rotation * place;
            let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
            jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
            jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-cross_matrix(&arm));
            let missing = seen - pose.translation.vector - arm;
            information += jacobian.transpose() * weight * jacobian;
            gradient += jacobian.transpose() * weight * missing;
        }
        let factor = Cholesky::new(information).ok_or(CombineError::OnOneLine)?;
        if pass == PASSES {
            let covariance = factor.inverse();
            let covariance = 0.5 * (covariance + covariance.transpose());
            return Ok(PoseReading {
                position: pose.translation.vector,
                rotation: pose.rotation,
                covariance: Some(covariance),
            });
        }
        let step = factor.solve(&gradient);
        pose.translation.vector += step.fixed_rows::<3>(0);
        pose.rotation = Rotation3::new(step.fixed_rows::<3>(3).into_owned()) * pose.rotation;
    }
    Err(CombineError::OnOneLine)
}

impl PoseReading {
    /// The errors of this pose against another that is taken as true: of the position (m) and of the rotation (rad), `exp(φ) · other = self`, in
    /// the tracker's axes.
    pub fn less(&self, position: &Vector3<f64>, rotation: &Rotation3<f64>) -> [Vector3<f64>; 2] {
        [self.position - position, rotation_vector(&(self.rotation * rotation.inverse()))]
    }
}

#[cfg(test)]
mod tests {
    use super::super::{MeasurementSet, TargetOrientation};
    use super::*;
    use crate::random::{StreamSource, stream};
    use crate::statistics::{chi2_survival, normal_quantile};
    use nalgebra::{Vector6, vector};
    use rand::RngExt;

    const PLACES: [Vector3<f64>; 3] =
        [vector![0.1, 0.0, 0.02], vector![-0.05, 0.09, 0.0], vector![-0.06, -0.07, -0.01]];

    fn truth() -> (Vector3<f64>, Rotation3<f64>) {
        (vector![3.0, -1.0, 0.4], Rotation3::new(vector![0.4, 1.1, -2.0]))
    }

    fn reading(position: Vector3<f64>, sigmas: Vector3<f64>) -> Reading {
        let turn = Rotation3::new(vector![0.3, 0.2, -0.5]);
        let covariance = turn * Matrix3::from_diagonal(&sigmas.map(|s| s * s)) * turn.inverse();
        Reading::Cartesian { position, covariance: Some(covariance) }
    }

    #[test]
    fn exact_points_give_their_pose() {
        let (position, rotation) = truth();
        let readings = PLACES.map(|place| reading(position + rotation * place, vector![1e-5, 2e-5, 3e-5]));
        let points: Vec<_> = PLACES.into_iter().zip(&readings).collect();
        let pose = combine(&points).expect("a pose");
        let [off, turn] = pose.less(&position, &rotation);
        assert!(off.norm() < 1e-14 && turn.norm() < 1e-14, "{off} {turn}");
    }

    /// The squared errors of 2000 noisy poses in their stated covariance, whose mean is 6 and whose sum is chi-square.
    #[test]
    fn the_covariance_is_that_of_the_errors() {
        let (position, rotation) = truth();
        let sigmas = vector![1e-5, 3e-5, 2e-5];
        let mut rng = stream(5, 0, StreamSource::IdentificationNoise);
        let turn = Rotation3::new(vector![0.3, 0.2, -0.5]);
        let (mut sum, count) = (0.0, 2000);
        for _ in 0..count {
            let readings = PLACES.map(|place| {
                let noise = sigmas.map(|s| s * normal_quantile(rng.random_range(1e-9..1.0)));
                reading(position + rotation * place + turn * noise, sigmas)
            });
            let points: Vec<_> = PLACES.into_iter().zip(&readings).collect();
            let pose = combine(&points).expect("a pose");
            let [off, turn] = pose.less(&position, &rotation);
            let error = Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z);
            let covariance = pose.covariance.expect("stated");
            sum += error.dot(&Cholesky::new(covariance).expect("definite").solve(&error));
        }
        let p = chi2_survival(sum, 6.0 * f64::from(count));
        assert!((0.0005..0.9995).contains(&p), "chi-square {sum} of {}, p {p}", 6 * count);
    }

    #[test]
    fn what_makes_no_pose_is_told() {
        let point = |x: f64| Reading::Cartesian {
            position: vector![x, 0.0, 0.0],
            covariance: Some(Matrix3::identity()),
        };
        let line = [point(0.0), point(1.0), point(2.0)];
        let on_line: Vec<_> = line.iter().map(|reading| (reading.position(), reading)).collect();
        assert_eq!(combine(&on_line), Err(CombineError::OnOneLine));
        assert_eq!(combine(&on_line[..2]), Err(CombineError::OnOneLine));
        let unknown = Reading::Cartesian { position: vector![0.0, 1.0, 0.0], covariance: None };
        let points = [on_line[0], on_line[1], (vector![0.0, 1.0, 0.0], &unknown)];
        assert_eq!(combine(&points), Err(CombineError::Covariance { index: 2 }));
    }

    fn set() -> MeasurementSet {
        let mut set = MeasurementSet::of_points([(vec![0.1], vector![1.0, 0.0, 0.0])]);
        set.targets[0].orientation =
            Some(TargetOrientation { flange_from_target: Rotation3::identity(), covariance: None });
        set.observations[0].reading = Reading::Pose(Box::new(PoseReading {
            position: vector![1.0, 0.0, 0.0],
            rotation: Rotation3::identity(),
            covariance: Some(Matrix6::identity()),
        }));
        set
    }

    #[test]
    fn poses_that_cannot_be_are_refused_with_their_place() {
        assert_eq!(set().check(1), Ok(()));
        let told = |change: &dyn Fn(&mut MeasurementSet, &mut PoseReading)| {
            let mut set = set();
            let Reading::Pose(mut pose) = set.observations[0].reading.clone() else { panic!("a pose") };
            change(&mut set, &mut pose);
            set.observations[0].reading = Reading::Pose(pose);
            set.check(1).expect_err("refused").to_string()
        };
        let mirrored = Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&vector![1.0, 1.0, -1.0]));
        let skewed = Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&vector![1.0, 1.0, 1.1]));
        let has = |text: &str, part: &str| assert!(text.contains(part), "{text}");
        has(&told(&|_, pose| pose.rotation = mirrored), "pose 1: the axes of the rotation are left-handed");
        has(
            &told(&|_, pose| pose.rotation = skewed),
            "pose 1: the three columns of the rotation differ from",
        );
        has(&told(&|_, pose| pose.covariance = Some(Matrix6::zeros())), "pose 1: the 6 x 6 covariance");
        has(
            &told(&|_, pose| {
                let mut lopsided = Matrix6::identity();
                lopsided[(0, 4)] = 0.5;
                pose.covariance = Some(lopsided);
            }),
            "symmetric",
        );
        has(
            &told(&|set, _| set.targets[0].orientation = None),
            "the orientation of its target on the flange (1) is not stated",
        );
        let of_target = |rotation, covariance| {
            told(&|set: &mut MeasurementSet, _: &mut PoseReading| {
                set.targets[0].orientation =
                    Some(TargetOrientation { flange_from_target: rotation, covariance });
            })
        };
        has(
            &of_target(mirrored, None),
            "the orientation of target 1: the axes of the rotation are left-handed",
        );
        has(
            &of_target(Rotation3::identity(), Some(-Matrix3::identity())),
            "the covariance of its orientation is not symmetric and positive definite",
        );
        has(
            &of_target(Rotation3::identity(), Some(Matrix3::identity() * f64::NAN)),
            "target 1: a coordinate or covariance is not a finite number",
        );
    }

    /// A covariance of small positions and large angles is definite all the same.
    #[test]
    fn units_do_not_make_a_covariance_singular() {
        let sigmas = Vector6::new(1e-7, 1e-7, 1e-7, 1e-1, 1e-1, 1e-1);
        assert!(is_covariance(&Matrix6::from_diagonal(&sigmas.component_mul(&sigmas))));
    }
}
