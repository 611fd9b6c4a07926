//! Rows and the form of files in a column map: sets, joins and text.

use super::Reader;
use super::tables::{By, ColumnsTable, JoinTable, SetsTable, TextTable};
use crate::input::{InputError, Spanned};
use crate::measurements::cells::Delimiter;
use crate::measurements::columns::{Entry, Join, JoinBy, Sets};
use crate::measurements::layout::Decimal;
use crate::measurements::pose_list::PoseList;
use crate::measurements::text::TextFormat;
use crate::measurements::times::DateOrder;
use crate::measurements::units::{AirQuantity, PressureUnit, TemperatureUnit, TimeUnit};

impl Reader<'_> {
    pub fn sets(&self, spanned: &Spanned<SetsTable>) -> Result<Sets, InputError> {
        let t = spanned.get_ref();
        let mut poses = PoseList::default();
        if let Some(list) = &t.verification_poses {
            for pose in &list.get_ref().0 {
                let refused = |expected| self.error(list.span(), format!("{pose:?} is not a pose"), expected);
                poses.add(pose).map_err(refused)?;
            }
        }
        if t.column.is_none() && poses.is_empty() {
            let message = "[sets] does not say which rows are held out";
            return Err(self.error(
                spanned.span(),
                message,
                "column with verification = [\"...\"], or verification_poses",
            ));
        }
        if t.column.is_some() && t.verification.is_empty() && t.identification.is_empty() {
            let message = "[sets] names a column, but not which of its texts mean held out";
            return Err(self.error(
                spanned.span(),
                message,
                "verification = [\"...\"], identification = [\"...\"] or both",
            ));
        }
        Ok(Sets {
            column: t.column.as_ref().map(|column| self.single(column)).transpose()?,
            identification: t.identification.clone(),
            verification: t.verification.clone(),
            poses,
        })
    }

    pub fn join(&self, spanned: &Spanned<JoinTable>) -> Result<Join, InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        if t.by == By::Row {
            if let Some(key) = t.joints.as_ref().or(t.points.as_ref()) {
                return Err(self.error(
                    key.span(),
                    "rows are joined by their order, so no column is needed",
                    "no column, or by = \"name\"",
                ));
            }
            return Ok(Join { by: JoinBy::Row, keys: None });
        }
        let table = ("join", &span);
        let key = |name, entry| {
            let entry = self.needed(table, name, entry)?;
            // A date may be in one column and the time of day in another.
            if t.by == By::Time { self.sum(entry) } else { self.single(entry) }
        };
        let keys = [key("joints", t.joints.as_ref())?, key("points", t.points.as_ref())?];
        let by = if t.by == By::Name {
            JoinBy::Name
        } else {
            let within =
                self.source.positive("within_s", self.needed(table, "within_s", t.within_s.as_ref())?)?;
            let offset =
                t.offset_s.as_ref().map_or(Ok(0.0), |offset| self.source.finite("offset_s", offset))?;
            JoinBy::Time { within, offset }
        };
        Ok(Join { by, keys: Some(keys) })
    }

    pub fn text(&self, t: &TextTable) -> Result<TextFormat, InputError> {
        let mut delimiter = None;
        if let Some(stated) = &t.delimiter {
            let mut chars = stated.get_ref().chars();
            delimiter = Some(match (stated.get_ref().as_str(), chars.next(), chars.next()) {
                ("tab", ..) => Delimiter::Character('\t'),
                ("blanks", ..) | (_, Some(' '), None) => Delimiter::Blanks,
                (_, Some(c), None) if c != '"' => Delimiter::Character(c),
                _ => {
                    let message = format!("text.delimiter is {:?}", stated.get_ref());
                    return Err(self.error(stated.span(), message, "one character, \"tab\" or \"blanks\""));
                }
            });
        }
        if let Some(widths) = &t.widths {
            if delimiter.is_some() {
                return Err(self.error(
                    widths.span(),
                    "both delimiter and widths are given",
                    "only one of them",
                ));
            }
            if widths.get_ref().is_empty() || widths.get_ref().contains(&0) {
                return Err(self.error(
                    widths.span(),
                    "a column of width zero",
                    "the number of characters of each column, 1 or more",
                ));
            }
            delimiter =
                Some(Delimiter::Widths(widths.get_ref().iter().map(|width| *width as usize).collect()));
        }
        Ok(TextFormat {
            delimiter,
            comments: t.comments.iter().filter(|prefix| !prefix.is_empty()).cloned().collect(),
            skipped_lines: t.skip_lines.into(),
        })
    }

    /// The time's columns, and the unit that the key states.
    pub fn time(&self, t: &ColumnsTable) -> Result<(Option<Entry>, TimeUnit), InputError> {
        let keys = [
            (&t.time_s, TimeUnit::S),
            (&t.time_ms, TimeUnit::Ms),
            (&t.time_us, TimeUnit::Us),
            (&t.time_ns, TimeUnit::Ns),
        ];
        let mut stated = keys.into_iter().filter_map(|(entry, unit)| Some((entry.as_ref()?, unit)));
        let (first, second) = (stated.next(), stated.next());
        if let Some((entry, _)) = second {
            return Err(self.error(
                entry.span(),
                "the time is given twice",
                "only one of time_s, time_ms, time_us and time_ns",
            ));
        }
        let Some((entry, unit)) = first else { return Ok((None, TimeUnit::S)) };
        Ok((Some(self.sum(entry)?), unit))
    }

    /// The temperature's columns, and the unit that the key states.
    pub fn temperature(&self, t: &ColumnsTable) -> Result<(Option<Entry>, TemperatureUnit), InputError> {
        let keys = [
            (&t.temperature_c, TemperatureUnit::C),
            (&t.temperature_k, TemperatureUnit::K),
            (&t.temperature_f, TemperatureUnit::F),
        ];
        let mut stated = keys.into_iter().filter_map(|(entry, unit)| Some((entry.as_ref()?, unit)));
        let (first, second) = (stated.next(), stated.next());
        if let Some((entry, _)) = second {
            let expected = "only one of temperature_c, temperature_k and temperature_f";
            return Err(self.error(entry.span(), "the temperature is given twice", expected));
        }
        let Some((entry, unit)) = first else { return Ok((None, TemperatureUnit::C)) };
        Ok((Some(self.sum(entry)?), unit))
    }

    /// The air, apart from its temperature.
    pub fn air(&self, t: &ColumnsTable) -> Result<Vec<(AirQuantity, Entry)>, InputError> {
        let pressure = AirQuantity::Pressure;
        let keys = [
            (&t.pressure_hpa, pressure(PressureUnit::Hpa)),
            (&t.pressure_pa, pressure(PressureUnit::Pa)),
            (&t.pressure_kpa, pressure(PressureUnit::Kpa)),
            (&t.pressure_mmhg, pressure(PressureUnit::Mmhg)),
            (&t.pressure_inhg, pressure(PressureUnit::Inhg)),
            (&t.humidity_percent, AirQuantity::HumidityPercent),
        ];
        let mut air: Vec<(AirQuantity, Entry)> = Vec::new();
        for (entry, quantity) in keys {
            let Some(entry) = entry else { continue };
            let is_pressure = |quantity: &AirQuantity| matches!(quantity, AirQuantity::Pressure(_));
            if is_pressure(&quantity) && air.iter().any(|(known, _)| is_pressure(known)) {
                let expected =
                    "only one of pressure_hpa, pressure_pa, pressure_kpa, pressure_mmhg and pressure_inhg";
                return Err(self.error(entry.span(), "the pressure is given twice", expected));
            }
            air.push((quantity, self.sum(entry)?));
        }
        Ok(air)
    }

    pub fn date(&self, t: &TextTable) -> Result<Option<DateOrder>, InputError> {
        let Some(stated) = &t.date else { return Ok(None) };
        match stated.get_ref().as_str() {
            "dmy" => Ok(Some(DateOrder::Dmy)),
            "mdy" => Ok(Some(DateOrder::Mdy)),
            "ymd" => Ok(Some(DateOrder::Ymd)),
            other => {
                let expected = "\"dmy\" (day, month, year), \"mdy\" or \"ymd\"";
                Err(self.error(stated.span(), format!("text.date is {other:?}"), expected))
            }
        }
    }

    pub fn decimal(&self, t: &TextTable) -> Result<Option<Decimal>, InputError> {
        let Some(stated) = &t.decimal else { return Ok(None) };
        match stated.get_ref().as_str() {
            "." => Ok(Some(Decimal::Point)),
            "," => Ok(Some(Decimal::Comma)),
            other => {
                let message = format!("text.decimal is {other:?}");
                Err(self.error(stated.span(), message, "\".\" or \",\""))
            }
        }
    }
}
