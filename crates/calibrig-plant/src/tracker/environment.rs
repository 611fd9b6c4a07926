//! The air between the instrument and its target: its effects on the range, and how it bends the beam.

use nalgebra::Vector3;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::TrackerError;
use super::air::Air;

/// Change of the refractive index with temperature at the given air, per K of its own value.
fn index_per_kelvin(air: &Air) -> f64 {
    let at = |kelvin: f64| Air { temperature: air.temperature + kelvin, ..*air }.refractive_index();
    (at(0.5) - at(-0.5)) / air.refractive_index()
}

/// The air of a session, and the uncertainty of the instrument's sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnvironmentLaw {
    /// As it is.
    pub air: Air,
    /// Standard deviations of the sensors' errors: K, Pa and 1 of relative humidity. The errors are constant during a
    /// session.
    pub sensor_sigma: Air,
    /// Temperature gradient upwards, K/m.
    pub gradient: f64,
}

/// Effects of the air on the readings of a session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirErrors {
    /// Displayed range over the length, relative: the real index over the assumed one.
    pub scale: f64,
    /// Relative change of the refractive index per metre of height, 1/m.
    pub index_gradient: f64,
}

impl Default for AirErrors {
    fn default() -> Self {
        Self { scale: 1.0, index_gradient: 0.0 }
    }
}

impl EnvironmentLaw {
    /// Whether it is valid.
    pub fn check(&self) -> Result<(), TrackerError> {
        self.air.check()?;
        let sigmas = [
            ("standard deviation of the temperature sensor in K", self.sensor_sigma.temperature),
            ("standard deviation of the pressure sensor in Pa", self.sensor_sigma.pressure),
            ("standard deviation of the humidity sensor", self.sensor_sigma.humidity),
        ];
        for (quantity, value) in sigmas {
            if !(value >= 0.0 && value.is_finite()) {
                let expected = "a finite number of zero or more";
                return Err(TrackerError::Figure { quantity, value, expected });
            }
        }
        if !(self.gradient.abs() <= MOST_GRADIENT) {
            let (quantity, expected) = ("gradient of the temperature in K/m", "-20 to 20");
            return Err(TrackerError::Figure { quantity, value: self.gradient, expected });
        }
        Ok(())
    }

    /// The errors of a session. Takes three numbers from `rng`.
    pub fn draw(&self, rng: &mut impl Rng) -> AirErrors {
        let [warm, dense, wet]: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(rng));
        let sensed = Air {
            temperature: self.air.temperature + self.sensor_sigma.temperature * warm,
            pressure: self.air.pressure + self.sensor_sigma.pressure * dense,
            humidity: self.air.humidity + self.sensor_sigma.humidity * wet,
        };
        AirErrors {
            scale: self.air.refractive_index() / sensed.refractive_index(),
            index_gradient: self.gradient * index_per_kelvin(&self.air),
        }
    }

    /// Standard deviation of the range's scale due to the sensors, 1.
    pub fn scale_sigma(&self) -> f64 {
        let [air, sigma] = [&self.air, &self.sensor_sigma];
        let index = air.refractive_index();
        let changes = [
            Air { temperature: air.temperature + sigma.temperature, ..*air },
            Air { pressure: air.pressure + sigma.pressure, ..*air },
            Air { humidity: air.humidity + sigma.humidity, ..*air },
        ];
        changes.iter().map(|air| (air.refractive_index() / index - 1.0).powi(2)).sum::<f64>().sqrt()
    }
}

/// Ten times that of a hall with a heated roof.
const MOST_GRADIENT: f64 = 20.0;

impl AirErrors {
    /// Apparent place of a point (tracker frame, m) in layered air: in the direction in which the beam leaves, which is the tangent of an arc of
    /// curvature κ to the point, κ = (index gradient) cos E.
    pub(super) fn apparent(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let flat = point.x.hypot(point.y);
        if self.index_gradient == 0.0 || flat == 0.0 {
            return *point;
        }
        // κ R / 2, with R cos E the distance along the ground. Light bends towards the denser air, so that it seems to come from higher up if
        // that is below.
        let raise = -(0.5 * self.index_gradient * flat).asin();
        let (sin, cos) = raise.sin_cos();
        let ground = (flat * cos - point.z * sin) / flat;
        Vector3::new(ground * point.x, ground * point.y, point.z * cos + flat * sin)
    }

    /// Displayed range over the path to a point at this height above the tracker, m: the air half-way up counts.
    pub(super) fn range_factor(&self, height: f64) -> f64 {
        self.scale * (1.0 + 0.5 * self.index_gradient * height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream};

    fn hall(gradient: f64) -> EnvironmentLaw {
        let sensor_sigma = Air { temperature: 0.3, pressure: 100.0, humidity: 0.05 };
        EnvironmentLaw { air: Air::ROOM, sensor_sigma, gradient }
    }

    #[test]
    fn a_gradient_of_0_4_k_per_m_lifts_a_point_at_10_m_by_19_um() {
        let errors = AirErrors { scale: 1.0, ..hall(0.4).draw(&mut stream(1, 0, StreamSource::Environment)) };
        let point = Vector3::new(6.0, 8.0, 0.0);
        let seen = errors.apparent(&point);
        assert!((1e6 * seen.z - 19.0).abs() < 0.5, "{seen}");
        assert!((seen.norm() - 10.0).abs() < 1e-14);
        // A ray that is followed through the layers, in steps of a centimetre, arrives where it should.
        let mut ray = [0.0_f64, 0.0, seen.z / 10.0];
        for _ in 0..1000 {
            ray[1] += 0.01 * ray[2] + 0.5e-4 * errors.index_gradient;
            ray[2] += 0.01 * errors.index_gradient;
            ray[0] += 0.01;
        }
        assert!(ray[1].abs() < 1e-10, "{ray:?}");
    }

    #[test]
    fn straight_up_nothing_is_bent_and_the_mean_air_counts() {
        let errors = AirErrors { scale: 1.0, index_gradient: -4e-7 };
        let up = Vector3::new(0.0, 0.0, 10.0);
        assert_eq!(errors.apparent(&up), up);
        // The integral of 1 - 4e-7 z over 10 m.
        assert!((10.0 * errors.range_factor(10.0) - (10.0 - 4e-7 * 50.0)).abs() < 1e-14);
    }

    #[test]
    fn the_scale_scatters_as_is_stated() {
        let law = hall(0.0);
        let n = 4000;
        let squares: f64 = (0..n)
            .map(|trial| (law.draw(&mut stream(1, trial, StreamSource::Environment)).scale - 1.0).powi(2))
            .sum();
        let ratio = squares / f64::from(n) / law.scale_sigma().powi(2);
        assert!((ratio - 1.0).abs() < 3.29 * (2.0 / f64::from(n)).sqrt(), "{ratio}");
        // 0.96 ppm/K * 0.3 K, 0.27 ppm/hPa * 1 hPa, 0.09 ppm per 10 % * 5 %.
        assert!((1e6 * law.scale_sigma() - 0.40).abs() < 0.02, "{}", law.scale_sigma());
    }

    #[test]
    fn figures_that_cannot_be_are_refused() {
        assert_eq!(hall(0.4).check(), Ok(()));
        for bad in [f64::NAN, f64::INFINITY, -1e3] {
            assert!(hall(bad).check().is_err());
            let sensor_sigma = Air { pressure: bad, ..hall(0.0).sensor_sigma };
            assert!(EnvironmentLaw { sensor_sigma, ..hall(0.0) }.check().is_err());
        }
    }
}
