//! Position, uncertainty and noise of a column map.

use std::ops::Range;

use nalgebra::Vector3;

use super::Reader;
use super::tables::{CoordinateTable, KeySpan, NoiseTable, System};
use crate::input::{InputError, Spanned};
use crate::measurements::columns::{Entry, Noise, PolarAngle, PositionColumns, SigmaUnits, Uncertainty};
use crate::measurements::units::LengthUnit;

impl Reader<'_> {
    pub fn needed<'t, T>(
        &self,
        table: (&str, &Range<usize>),
        key: &str,
        value: Option<&'t Spanned<T>>,
    ) -> Result<&'t Spanned<T>, InputError> {
        value.ok_or_else(|| {
            self.error(table.1.clone(), format!("[{}] has no {key}", table.0), &format!("the key {key}"))
        })
    }

    /// Refuses keys of the other coordinate system.
    fn foreign(&self, keys: Vec<KeySpan>, system: &str) -> Result<(), InputError> {
        match keys.into_iter().find_map(|(key, span)| span.map(|span| (key, span))) {
            Some((key, span)) => {
                let message = format!("{key} does not belong to the {system} system");
                Err(self.error(span, message, &format!("only the keys of the {system} system")))
            }
            None => Ok(()),
        }
    }

    fn polar(
        &self,
        table: (&str, &Range<usize>),
        t: &CoordinateTable,
    ) -> Result<(Entry, PolarAngle), InputError> {
        match (&t.elevation, &t.zenith) {
            (Some(name), None) => Ok((self.sum(name)?, PolarAngle::Elevation)),
            (None, Some(name)) => Ok((self.sum(name)?, PolarAngle::Zenith)),
            (Some(_), Some(zenith)) => Err(self.error(
                zenith.span(),
                "both elevation and zenith are given",
                "only one of elevation and zenith",
            )),
            (None, None) => {
                let message = format!("[{}] has neither elevation nor zenith", table.0);
                Err(self.error(table.1.clone(), message, "one of elevation and zenith"))
            }
        }
    }

    fn xyz(&self, table: (&str, &Range<usize>), t: &CoordinateTable) -> Result<[Entry; 3], InputError> {
        Ok([
            self.sum(self.needed(table, "x", t.x.as_ref())?)?,
            self.sum(self.needed(table, "y", t.y.as_ref())?)?,
            self.sum(self.needed(table, "z", t.z.as_ref())?)?,
        ])
    }

    /// The position's columns and, for a spherical one, the reference of its second angle.
    pub fn position(
        &self,
        spanned: &Spanned<CoordinateTable>,
    ) -> Result<(PositionColumns, Option<PolarAngle>), InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        let table = ("position", &span);
        if let Some(k) = &t.k {
            return Err(self.error(k.span(), "k does not apply to a position", "k in [sigma] or [noise]"));
        }
        let unit = |unit: &Option<Spanned<LengthUnit>>| unit.as_ref().map(|unit| *unit.get_ref());
        if *self.needed(table, "system", t.system.as_ref())?.get_ref() == System::Cartesian {
            self.foreign(t.spherical_keys(), "cartesian")?;
            return Ok((PositionColumns::Cartesian { axes: self.xyz(table, t)?, unit: unit(&t.unit) }, None));
        }
        self.foreign(t.cartesian_keys(), "spherical")?;
        let (polar, polar_angle) = self.polar(table, t)?;
        let position = PositionColumns::Spherical {
            range: self.sum(self.needed(table, "range", t.range.as_ref())?)?,
            range_unit: unit(&t.range_unit),
            azimuth: self.sum(self.needed(table, "azimuth", t.azimuth.as_ref())?)?,
            polar,
            polar_angle,
            angle_unit: t.angle_unit.as_ref().map(|unit| *unit.get_ref()),
        };
        Ok((position, Some(polar_angle)))
    }

    /// The columns of the standard deviations; `polar` is that of the position, `None` for a Cartesian one.
    pub fn sigmas(
        &self,
        spanned: &Spanned<CoordinateTable>,
        polar: Option<PolarAngle>,
    ) -> Result<Uncertainty, InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        let table = ("sigma", &span);
        if let Some(system) = &t.system {
            let message = "[sigma] uses the system of [position]";
            return Err(self.error(system.span(), message, "no key system here"));
        }
        if let Some(missed) = &t.missed {
            return Err(self.error(
                missed.span(),
                "missed does not apply to an uncertainty",
                "missed in [position]",
            ));
        }
        let coverage = self.coverage(t.k.as_ref())?;
        let Some(polar) = polar else {
            self.foreign(t.spherical_keys(), "cartesian")?;
            let units = SigmaUnits::Cartesian(t.unit.as_ref().map(|unit| *unit.get_ref()));
            return Ok(Uncertainty::Sigmas { columns: self.xyz(table, t)?, units, coverage });
        };
        self.foreign(t.cartesian_keys(), "spherical")?;
        let (name, own_polar) = self.polar(table, t)?;
        if own_polar != polar {
            let message = "[sigma] and [position] differ: one has elevation, the other zenith";
            return Err(self.error(span.clone(), message, "the same angle in both"));
        }
        let columns = [
            self.sum(self.needed(table, "range", t.range.as_ref())?)?,
            self.sum(self.needed(table, "azimuth", t.azimuth.as_ref())?)?,
            name,
        ];
        let length = t.range_unit.as_ref().map(|unit| *unit.get_ref());
        let angle = t.angle_unit.as_ref().map(|unit| *unit.get_ref());
        Ok(Uncertainty::Sigmas { columns, units: SigmaUnits::Spherical(length, angle), coverage })
    }

    pub fn coverage(&self, k: Option<&Spanned<f64>>) -> Result<f64, InputError> {
        k.map_or(Ok(1.0), |k| self.source.positive("k", k))
    }

    pub fn noise(&self, spanned: &Spanned<NoiseTable>) -> Result<Noise, InputError> {
        let t = spanned.get_ref();
        let k = self.coverage(t.k.as_ref())?;
        let size = |key: &str, value: &Option<Spanned<f64>>| match value {
            Some(value) => Ok(1e-6 * self.source.not_negative(key, value)? / k),
            None => Ok(0.0),
        };
        let range = [size("range_um", &t.range_um)?, size("range_um_per_m", &t.range_um_per_m)?];
        let transverse =
            [size("transverse_um", &t.transverse_um)?, size("transverse_um_per_m", &t.transverse_um_per_m)?];
        if range == [0.0; 2] || transverse == [0.0; 2] {
            let message = "[noise] needs a size along the line of sight and one across it, each a + b R with the distance R";
            let expected = "range_um or range_um_per_m, and transverse_um or transverse_um_per_m, above zero";
            return Err(self.error(spanned.span(), message, expected));
        }
        let mut tracker = Vector3::zeros();
        for (coordinate, value) in tracker.iter_mut().zip(t.tracker_mm.iter().flatten()) {
            *coordinate = 1e-3 * self.source.finite("tracker_mm", value)?;
        }
        let rotation = t.rotation_urad.as_ref().map(|value| self.source.positive("rotation_urad", value));
        let rotation = rotation.transpose()?.map(|sigma| 1e-6 * sigma / k);
        Ok(Noise { range, transverse, rotation, tracker })
    }
}
