//! A target with axes of its own, whose orientation is measured together with its place: a six-degree-of-freedom probe.

use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{PoseReading, SphericalReading, TargetOrientation};

/// A probe on the flange. Its place is measured as that of any target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probe {
    /// Its real orientation: `flange_from_target`.
    pub flange_from_target: Rotation3<f64>,
    /// Standard deviation of a measured orientation about each axis, rad.
    pub turn_sigma: f64,
    /// Standard deviation about each axis of the stated `flange_from_target`, rad; `None` if it is unknown.
    pub mounting_sigma: Option<f64>,
    /// Whether orientations scatter, as the tracker's readings do.
    pub noise: bool,
}

fn drawn(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(rng))
}

impl Probe {
    /// Its stated orientation: the real one with an error, or that of the flange if it is unknown.
    pub fn stated(&self, rng: &mut impl Rng) -> TargetOrientation {
        let error = drawn(rng);
        match self.mounting_sigma {
            None => TargetOrientation { flange_from_target: Rotation3::identity(), covariance: None },
            Some(sigma) => {
                let error = if self.noise { sigma * error } else { Vector3::zeros() };
                TargetOrientation {
                    flange_from_target: self.flange_from_target * Rotation3::new(error),
                    covariance: Some(Matrix3::identity() * sigma * sigma),
                }
            }
        }
    }

    /// The full pose to which `place` is the reading of the position. Takes the same numbers from `rng` whatever the pose is.
    pub fn measure(
        &self,
        place: &SphericalReading,
        tracker_from_flange: &Transform,
        rng: &mut impl Rng,
    ) -> PoseReading {
        let error = drawn(rng);
        let error = if self.noise { self.turn_sigma * error } else { Vector3::zeros() };
        let covariance = place.position_covariance().map(|position| {
            let mut covariance = Matrix6::identity() * self.turn_sigma * self.turn_sigma;
            covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&position);
            covariance
        });
        PoseReading {
            position: place.position(),
            rotation: Rotation3::new(error) * tracker_from_flange.rotation * self.flange_from_target,
            covariance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::geometry::rotation_vector;
    use calibrig_model::measurement::Face;
    use calibrig_model::random::{StreamSource, stream};
    use calibrig_model::statistics::chi2_survival;

    const PROBE: Probe = Probe {
        flange_from_target: Rotation3::from_matrix_unchecked(Matrix3::new(
            0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
        )),
        turn_sigma: 5e-5,
        mounting_sigma: Some(2e-4),
        noise: true,
    };

    fn place() -> SphericalReading {
        SphericalReading {
            range: 3.0,
            azimuth: 0.3,
            elevation: 0.2,
            covariance: Some(Matrix3::identity() * 1e-10),
            face: Face::Front,
        }
    }

    #[test]
    fn orientations_scatter_as_stated_about_the_real_one() {
        let mut rng = stream(1, 0, StreamSource::ProbeNoise);
        let flange = calibrig_model::geometry::rotation_x(0.7);
        let real = flange.rotation * PROBE.flange_from_target;
        let mut chi2 = 0.0;
        for _ in 0..2000 {
            let pose = PROBE.measure(&place(), &flange, &mut rng);
            let off = rotation_vector(&(pose.rotation * real.inverse()));
            let stated = pose.covariance.expect("stated");
            chi2 += off.norm_squared() / stated[(4, 4)];
            assert_eq!(stated.fixed_view::<3, 3>(3, 0).amax(), 0.0);
        }
        let p = chi2_survival(chi2, 6000.0);
        assert!((5e-4..1.0 - 5e-4).contains(&p), "{chi2}");
    }

    #[test]
    fn what_is_stated_of_the_mounting_is_off_by_its_uncertainty_or_unknown() {
        let off = |probe: Probe| {
            let mut rng = stream(1, 0, StreamSource::ProbeMounting);
            let stated = probe.stated(&mut rng);
            (
                rotation_vector(&(stated.flange_from_target * PROBE.flange_from_target.inverse())),
                stated.covariance,
            )
        };
        let (error, covariance) = off(PROBE);
        // Three normal numbers: within 5 sigma each, and not zero.
        assert!(error.amax() < 1e-3 && error.norm() > 1e-6 && covariance.is_some(), "{error}");
        assert!(off(Probe { noise: false, ..PROBE }).0.norm() < 1e-15);
        let (error, covariance) = off(Probe { mounting_sigma: None, ..PROBE });
        assert!(error.norm() > 1.0 && covariance.is_none());
    }
}
