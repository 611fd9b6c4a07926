//! A spherically mounted retroreflector: its optical centre relative to the centre of its sphere, and its seat in a
//! nest.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::TrackerError;

/// How precisely reflectors of a kind are made and seated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmrLaw {
    /// Standard deviation of the optical centre along each axis of the reflector, m.
    pub centring_sigma: f64,
    /// Standard deviation of the sphere's centre along each axis each time it is put into a nest, m.
    pub seat_sigma: f64,
    /// Largest angle between the reflector's axis and the beam, rad.
    pub acceptance: f64,
}

impl SmrLaw {
    /// Whether it is valid.
    pub fn check(&self) -> Result<(), TrackerError> {
        for (quantity, value) in
            [("centring of the SMR in m", self.centring_sigma), ("seat of the SMR in m", self.seat_sigma)]
        {
            if !(value >= 0.0 && value.is_finite()) {
                let expected = "a finite number of zero or more";
                return Err(TrackerError::Figure { quantity, value, expected });
            }
        }
        if !(self.acceptance > 0.0 && self.acceptance <= 0.5 * PI) {
            let (quantity, expected) =
                ("acceptance angle of the SMR in rad", "above zero, and at most a right angle");
            return Err(TrackerError::Figure { quantity, value: self.acceptance, expected });
        }
        Ok(())
    }

    /// One reflector. Takes three numbers from `rng`.
    pub fn draw(&self, rng: &mut impl Rng) -> Smr {
        let centring = self.centring_sigma * vector(rng);
        Smr { centring, seat_sigma: self.seat_sigma, acceptance: self.acceptance }
    }
}

/// One reflector. It looks along its own x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smr {
    /// Its optical centre from the centre of its sphere, in its own axes, m.
    pub centring: Vector3<f64>,
    /// Standard deviation of the sphere's centre along each axis each time it is put into a nest, m.
    pub seat_sigma: f64,
    /// Largest angle between its axis and the beam, rad.
    pub acceptance: f64,
}

impl Smr {
    /// Without an error, and visible from everywhere.
    pub const PERFECT: Self = Self { centring: Vector3::new(0.0, 0.0, 0.0), seat_sigma: 0.0, acceptance: PI };

    /// Its optical centre from the centre of its sphere in the base frame (m), turned as given.
    pub fn offset(&self, base_from_smr: &Rotation3<f64>) -> Vector3<f64> {
        base_from_smr * self.centring
    }

    /// The same for one that is turned by hand to face a direction of the base frame, as when it is put into a nest; it takes the shortest turn.
    pub fn offset_towards(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        let turned = Rotation3::rotation_between(&Vector3::x(), direction)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::z_axis(), PI));
        self.offset(&turned)
    }

    /// Displacement of its sphere from the nest's place, m; different each time. Takes three numbers from `rng`.
    pub fn seat(&self, rng: &mut impl Rng) -> Vector3<f64> {
        self.seat_sigma * vector(rng)
    }

    /// Whether it returns a beam from the first direction (from it to the tracker, base frame) when it faces the second.
    pub fn accepts(&self, axis: &Vector3<f64>, to_tracker: &Vector3<f64>) -> bool {
        axis.angle(to_tracker) <= self.acceptance
    }
}

fn vector(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(rng))
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream};

    const LAW: SmrLaw = SmrLaw { centring_sigma: 3e-6, seat_sigma: 4e-6, acceptance: 30.0 * PI / 180.0 };

    #[test]
    fn its_centre_stays_and_its_seat_does_not() {
        let mut rng = stream(1, 0, StreamSource::Smr);
        let n = 2000;
        let (mut centres, mut seats) = (0.0, 0.0);
        for _ in 0..n {
            let smr = LAW.draw(&mut rng);
            centres += smr.centring.norm_squared();
            let [first, second] = [smr.seat(&mut rng), smr.seat(&mut rng)];
            assert_ne!(first, second);
            seats += first.norm_squared();
        }
        // Sums of 3 n squares of normal numbers, 99.9 % band.
        let spread = 3.29 * (2.0 / f64::from(3 * n)).sqrt();
        for (sum, sigma) in [(centres, 3e-6_f64), (seats, 4e-6)] {
            let ratio = sum / f64::from(3 * n) / sigma.powi(2);
            assert!((ratio - 1.0).abs() < spread, "{ratio}");
        }
    }

    #[test]
    fn it_turns_with_what_it_is_mounted_on_and_looks_into_a_cone() {
        let smr =
            Smr { centring: Vector3::new(1e-6, 2e-6, 0.0), ..LAW.draw(&mut stream(1, 0, StreamSource::Smr)) };
        let half = Rotation3::from_axis_angle(&Vector3::z_axis(), PI);
        assert!((smr.offset(&half) + smr.centring).norm() < 1e-20);
        let away = smr.offset_towards(&-Vector3::x());
        assert!((away.x + 1e-6).abs() < 1e-20 && (away.norm() - smr.centring.norm()).abs() < 1e-20);
        let beam = |deg: f64| Rotation3::from_axis_angle(&Vector3::y_axis(), deg.to_radians()) * Vector3::x();
        assert!(smr.accepts(&Vector3::x(), &beam(29.9)) && !smr.accepts(&Vector3::x(), &beam(30.1)));
        assert!(Smr::PERFECT.accepts(&Vector3::x(), &-Vector3::x()));
    }

    #[test]
    fn figures_that_cannot_be_are_refused() {
        assert_eq!(LAW.check(), Ok(()));
        for bad in [f64::NAN, -1e-6, f64::INFINITY] {
            assert!(SmrLaw { centring_sigma: bad, ..LAW }.check().is_err());
            assert!(SmrLaw { seat_sigma: bad, ..LAW }.check().is_err());
            assert!(SmrLaw { acceptance: bad, ..LAW }.check().is_err());
        }
    }
}
