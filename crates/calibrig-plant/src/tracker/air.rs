//! The refractive index of air by Edlén's equation, as K. P. Birch and M. J. Downs revised it ("An updated Edlén equation for the refractive index of
//! air", Metrologia 30 (1993) 155-162, and its correction, Metrologia 31 (1994) 315-316), for the light of a helium-neon laser.
//!
//! The vapour pressure is W. Wagner's and A. Pruss's auxiliary equation (J. Phys. Chem. Ref. Data 31 (2002) 387-535, eq. 2.5).

use super::TrackerError;

/// The state of the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    /// °C
    pub temperature: f64,
    /// Pa
    pub pressure: f64,
    /// Relative humidity, 0 to 1.
    pub humidity: f64,
}

impl Air {
    /// Of a measuring room: 20 °C, 101 325 Pa, half saturated.
    pub const ROOM: Self = Self { temperature: 20.0, pressure: 101_325.0, humidity: 0.5 };

    /// Refractive index at the vacuum wavelength of 633 nm, to about 1e-8 between 0 and 50 °C.
    pub fn refractive_index(&self) -> f64 {
        self.index_at(0.633)
    }

    /// At a vacuum wavelength, µm.
    fn index_at(&self, wavelength: f64) -> f64 {
        let (t, p) = (self.temperature, self.pressure);
        let s = wavelength.powi(-2);
        let standard = 1e-8 * (8342.54 + 2_406_147.0 / (130.0 - s) + 15_998.0 / (38.9 - s));
        let density = (1.0 + 1e-8 * (0.601 - 0.009_72 * t) * p) / (1.0 + 0.003_661_0 * t);
        let dry = p * standard * density / 96_095.43;
        let vapour = self.humidity * saturation_pressure(t);
        let wet = 1e-10 * (292.75 / (t + 273.15)) * (3.7345 - 0.0401 * s) * vapour;
        1.0 + dry - wet
    }

    /// Whether an instrument can work in this air.
    pub fn check(&self) -> Result<(), TrackerError> {
        let figures = [
            ("temperature of the air in deg C", self.temperature, [-40.0, 60.0], "-40 to 60"),
            ("pressure of the air in Pa", self.pressure, [50e3, 120e3], "50000 to 120000"),
            ("relative humidity of the air", self.humidity, [0.0, 1.0], "0 to 1"),
        ];
        for (quantity, value, [least, most], expected) in figures {
            if !(least..=most).contains(&value) {
                return Err(TrackerError::Figure { quantity, value, expected });
            }
        }
        Ok(())
    }
}

/// Pressure of saturated water vapour over water, Pa.
fn saturation_pressure(celsius: f64) -> f64 {
    const CRITICAL: [f64; 2] = [647.096, 22.064e6];
    const TERMS: [(f64, f64); 6] = [
        (-7.859_517_83, 1.0),
        (1.844_082_59, 1.5),
        (-11.786_649_7, 3.0),
        (22.680_741_1, 3.5),
        (-15.961_871_9, 4.0),
        (1.801_225_02, 7.5),
    ];
    let kelvin = celsius + 273.15;
    let below = 1.0 - kelvin / CRITICAL[0];
    let sum: f64 = TERMS.iter().map(|(factor, power)| factor * below.powf(*power)).sum();
    CRITICAL[1] * (sum * CRITICAL[0] / kelvin).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Temperature (°C), humidity (%), pressure (kPa), wavelength (nm) and index by the calculator of NIST's Engineering Metrology Toolbox
    /// (J. A. Stone, J. H. Zimmerman), modified Edlén equation.
    const NIST: [(f64, f64, f64, f64, f64); 9] = [
        (20.0, 0.0, 101.325, 633.0, 1.000_271_799),
        (20.0, 0.0, 60.0, 633.0, 1.000_160_920),
        (20.0, 0.0, 120.0, 633.0, 1.000_321_918),
        (50.0, 0.0, 100.0, 633.0, 1.000_243_270),
        (5.0, 0.0, 100.0, 633.0, 1.000_282_750),
        (50.0, 100.0, 120.0, 633.0, 1.000_287_864),
        (40.0, 75.0, 120.0, 633.0, 1.000_299_406),
        (20.0, 100.0, 100.0, 633.0, 1.000_267_394),
        (40.0, 100.0, 110.0, 1700.0, 1.000_270_237),
    ];

    #[test]
    fn the_index_is_that_of_the_calculator_of_nist() {
        for (temperature, humidity, pressure, wavelength, index) in NIST {
            let air = Air { temperature, pressure: 1e3 * pressure, humidity: 1e-2 * humidity };
            let own = air.index_at(1e-3 * wavelength);
            // Its last digit, and what two equations of the vapour pressure differ by.
            assert!((own - index).abs() < 2e-9, "{air:?}: {own:.9} for {index:.9}");
        }
    }

    #[test]
    fn it_changes_with_temperature_pressure_and_humidity_as_is_known_of_it() {
        let by = |air: Air| 1e6 * (air.refractive_index() - Air::ROOM.refractive_index());
        let warmer = by(Air { temperature: 21.0, ..Air::ROOM });
        let denser = by(Air { pressure: 101_425.0, ..Air::ROOM });
        let wetter = by(Air { humidity: 0.6, ..Air::ROOM });
        assert!((warmer + 0.96).abs() < 0.02, "{warmer} ppm/K");
        assert!((denser - 0.27).abs() < 0.005, "{denser} ppm/hPa");
        assert!((wetter + 0.09).abs() < 0.015, "{wetter} ppm per 10 %");
    }

    #[test]
    fn what_is_no_air_is_refused() {
        for value in [f64::NAN, f64::INFINITY, -1e6, 1e6] {
            for air in [
                Air { temperature: value, ..Air::ROOM },
                Air { pressure: value, ..Air::ROOM },
                Air { humidity: value, ..Air::ROOM },
            ] {
                assert!(air.check().is_err(), "{air:?}");
            }
        }
        assert_eq!(Air::ROOM.check(), Ok(()));
    }
}
