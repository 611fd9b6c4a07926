//! Drives that get stiffer with their load.

use super::error::{Range, check, check_length};
use super::{EffectError, EffectKind};

/// Deflection against load as gear makers state it: a stiffness K1 up to a load T1, K2 from there to T2, K3 beyond. It is odd: the same for both
/// directions of the load. Source: Harmonic Drive AG, Engineering Data, "Torsional stiffness", where the ranges have these names.
#[derive(Debug, Clone, PartialEq)]
pub struct StiffnessCurve {
    /// K1, K2, ... over the drive's stiffness without this effect: above zero, each greater than the one before.
    pub factors: Vec<f64>,
    /// T1, T2, ..., N or N m: one fewer, each greater than the one before.
    pub limits: Vec<f64>,
}

impl StiffnessCurve {
    fn check(&self, index: usize) -> Result<(), EffectError> {
        let kind = EffectKind::Stiffening;
        if self.factors.len() < 2 || self.limits.len() + 1 != self.factors.len() {
            let (factors, limits) = (self.factors.len(), self.limits.len());
            return Err(EffectError::Ranges { actuator: index, factors, limits });
        }
        for (quantity, values) in [("stiffness", &self.factors), ("end of a load range", &self.limits)] {
            let mut before = 0.0;
            for &value in values {
                check(kind, (quantity, index), value, Range::Positive)?;
                if value <= before {
                    let expected = "more than the one before it";
                    return Err(EffectError::Value { effect: kind, quantity, index, value, expected });
                }
                before = value;
            }
        }
        Ok(())
    }

    /// The ranges: stiffness, and deflection and load at which it begins.
    fn ranges(&self, stiffness: f64) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        let begins = std::iter::once(0.0).chain(self.limits.iter().copied());
        let mut before: Option<(f64, f64, f64)> = None;
        self.factors.iter().zip(begins).map(move |(factor, load)| {
            let deflection = before.map_or(0.0, |(k, deflection, begin)| deflection + (load - begin) / k);
            let range = (factor * stiffness, deflection, load);
            before = Some(range);
            range
        })
    }

    /// Deflection under `load` (N or N m) of a drive of `stiffness` (N/m or N m/rad), m or rad.
    pub fn deflection(&self, stiffness: f64, load: f64) -> f64 {
        let own = self.ranges(stiffness).take_while(|(.., begin)| *begin <= load.abs()).last();
        own.map_or(0.0, |(k, deflection, begin)| (deflection + (load.abs() - begin) / k).copysign(load))
    }

    /// The range of a deflection: (tangent stiffness, load).
    pub fn tangent_and_load(&self, stiffness: f64, deflection: f64) -> (f64, f64) {
        let own = self.ranges(stiffness).take_while(|(_, begin, _)| *begin <= deflection.abs()).last();
        own.map_or((stiffness, stiffness * deflection), |(k, begin, load)| {
            (k, (load + k * (deflection.abs() - begin)).copysign(deflection))
        })
    }

    /// Load over deflection at a load, N/m or N m/rad: the stiffness of a linear drive that deflects as far. K1 without
    /// a load.
    pub fn secant(&self, stiffness: f64, load: f64) -> f64 {
        let deflection = self.deflection(stiffness, load);
        if deflection == 0.0 { self.tangent_and_load(stiffness, 0.0).0 } else { load / deflection }
    }
}

/// The curves of every actuator; `None` for a linear drive. A rigid drive stays rigid.
#[derive(Debug, Clone, PartialEq)]
pub struct Stiffening {
    /// One entry per actuator.
    pub actuators: Vec<Option<StiffnessCurve>>,
}

impl Stiffening {
    pub(crate) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        check_length(EffectKind::Stiffening, self.actuators.len(), actuators)?;
        let curves = self.actuators.iter().enumerate();
        curves.filter_map(|(index, curve)| Some((index, curve.as_ref()?))).try_for_each(|(i, c)| c.check(i))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// K1 = 80, K2 = 100, K3 = 160 kN m/rad; T1 = 200, T2 = 1000 N m.
    fn curve() -> StiffnessCurve {
        StiffnessCurve { factors: vec![0.8, 1.0, 1.6], limits: vec![200.0, 1000.0] }
    }

    /// By the formulas of the data sheets: T/K1, T1/K1 + (T - T1)/K2, T1/K1 + (T2 - T1)/K2 + (T - T2)/K3.
    #[test]
    fn the_deflection_is_that_of_the_data_sheets_formulas() {
        for (load, deflection) in [
            (0.0, 0.0),
            (100.0, 100.0 / 8e4),
            (200.0, 200.0 / 8e4),
            (600.0, 200.0 / 8e4 + 400.0 / 1e5),
            (2600.0, 200.0 / 8e4 + 800.0 / 1e5 + 1600.0 / 1.6e5),
        ] {
            for sign in [1.0, -1.0] {
                let found = curve().deflection(1e5, sign * load);
                assert!((found - sign * deflection).abs() < 1e-17, "{load}");
                let (_, back) = curve().tangent_and_load(1e5, found);
                assert!((back - sign * load).abs() < 1e-10, "{back} for {load}");
            }
        }
        assert!((curve().secant(1e5, 600.0) - 600.0 / 6.5e-3).abs() < 1e-9);
        assert!((curve().secant(1e5, 0.0) - 8e4).abs() < 1e-9);
        assert_eq!(curve().deflection(f64::INFINITY, 600.0), 0.0);
    }

    #[test]
    fn the_tangent_is_the_slope_of_the_load() {
        for deflection in [-0.02, -0.007, -1e-3, 1e-3, 4e-3, 0.0104, 0.0106, 0.3] {
            let at = |u: f64| curve().tangent_and_load(1e5, u);
            let slope = (at(deflection + 1e-7).1 - at(deflection - 1e-7).1) / 2e-7;
            assert!((at(deflection).0 / slope - 1.0).abs() < 1e-6, "{deflection}");
        }
    }

    #[test]
    fn ranges_that_do_not_rise_are_refused() {
        let refused = |factors: &[f64], limits: &[f64]| {
            let curve = StiffnessCurve { factors: factors.to_vec(), limits: limits.to_vec() };
            let error = Stiffening { actuators: vec![None, Some(curve)] }.check(2);
            error.expect_err("no such gear").to_string()
        };
        for (factors, limits, message) in [
            (&[0.8, 1.0, 1.2][..], &[500.0, 400.0][..], "end of a load range of index 1 is 400"),
            (&[0.8, 1.0, 1.2], &[400.0, 400.0], "more than the one before it"),
            (&[0.8, 1.0, 0.9], &[100.0, 400.0], "stiffness of index 1 is 0.9"),
            (&[0.0, 1.0, 1.9], &[100.0, 400.0], "above zero"),
            (&[0.8, 1.0], &[100.0, 400.0], "2 stiffnesses and 2 ends"),
            (&[0.8], &[], "1 stiffnesses and 0 ends"),
            (&[0.8, f64::INFINITY], &[100.0], "finite"),
        ] {
            let error = refused(factors, limits);
            assert!(error.contains(message), "{message:?} in {error}");
        }
    }
}
