//! `[target]`, or `[[target]]` for each of several: the reflector's place on the flange, and its uncertainty.

use std::fmt;
use std::ops::Range;

use nalgebra::{Cholesky, Matrix3, Vector3};
use serde::Deserialize;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};

use crate::input::{InputError, Source, Spanned};
use crate::orientation::{Four, OrientationKeys, Square, Three};
use calibrig_model::measurement::TargetOrientation;

/// A target as the robot's file states it.
#[derive(Debug, Clone, PartialEq)]
pub struct StatedTarget {
    /// As in the measurement files; `None` for a single one without a name.
    pub name: Option<String>,
    /// Offset in the flange frame, m.
    pub in_flange: Vector3<f64>,
    /// Standard deviation of it along every axis, m; `None` for a nominal value of unknown uncertainty.
    pub sigma: Option<f64>,
    /// Its orientation on the flange, if its readings are full poses.
    pub orientation: Option<TargetOrientation>,
    /// Where the file states it, for messages.
    pub place: Range<usize>,
}

impl StatedTarget {
    /// Covariance of the offset, m².
    pub fn covariance(&self) -> Option<Matrix3<f64>> {
        self.sigma.map(|sigma| Matrix3::from_diagonal_element(sigma * sigma))
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetTable {
    name: Option<Spanned<String>>,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
    sigma_mm: Option<Spanned<f64>>,
    rotation_quaternion_wxyz: Option<Four>,
    rotation_quaternion_xyzw: Option<Four>,
    rotation_vector_rad: Option<Three>,
    rotation_euler_rad: Option<Three>,
    rotation_sequence: Option<Spanned<String>>,
    rotation_matrix: Option<Square>,
    rotation_sigma_rad: Option<Spanned<f64>>,
    rotation_covariance_rad2: Option<Square>,
}

impl TargetTable {
    fn orientation(&self) -> OrientationKeys<'_> {
        OrientationKeys {
            quaternion_wxyz: self.rotation_quaternion_wxyz.as_ref(),
            quaternion_xyzw: self.rotation_quaternion_xyzw.as_ref(),
            vector_rad: self.rotation_vector_rad.as_ref(),
            euler_rad: self.rotation_euler_rad.as_ref(),
            sequence: self.rotation_sequence.as_ref(),
            matrix: self.rotation_matrix.as_ref(),
            sigma_rad: self.rotation_sigma_rad.as_ref(),
            covariance_rad2: self.rotation_covariance_rad2.as_ref(),
        }
    }
}

/// One table or several. Not an untagged enum, which would lose the place of a mistake.
#[derive(Default)]
pub(super) struct TargetTables(Vec<Spanned<TargetTable>>);

impl<'de> Deserialize<'de> for TargetTables {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Tables;
        impl<'de> Visitor<'de> for Tables {
            type Value = TargetTables;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a table [target], or a table [[target]] for each of several")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<TargetTables, A::Error> {
                let table = TargetTable::deserialize(MapAccessDeserializer::new(map))?;
                let place = table.x_mm.span().start..table.z_mm.span().end;
                Ok(TargetTables(vec![Spanned::new(place, table)]))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, tables: A) -> Result<TargetTables, A::Error> {
                Deserialize::deserialize(SeqAccessDeserializer::new(tables)).map(TargetTables)
            }
        }
        deserializer.deserialize_any(Tables)
    }
}

/// The targets of `tables`, with distinct names; each has one if there are several.
pub(super) fn read_targets(source: &Source, tables: &TargetTables) -> Result<Vec<StatedTarget>, InputError> {
    let mut targets: Vec<StatedTarget> = Vec::new();
    for table in &tables.0 {
        let (target, span) = (table.get_ref(), table.span());
        let refused = |span: Range<usize>, message: String, expected: &str| {
            source.error(span, message, Some(format!("expected {expected}")))
        };
        let name = target.name.as_ref().map(|name| name.get_ref().trim());
        match (&target.name, name) {
            (None, _) if tables.0.len() > 1 => {
                let message = format!("{} targets are stated, but this one has no name", tables.0.len());
                return Err(refused(
                    span,
                    message,
                    "name = \"...\", as in the target column of the measurement files",
                ));
            }
            (Some(key), Some("")) => {
                return Err(refused(
                    key.span(),
                    "target.name is empty".to_owned(),
                    "a name, as in the measurement files",
                ));
            }
            (Some(key), Some(name)) if targets.iter().any(|known| known.name.as_deref() == Some(name)) => {
                return Err(refused(
                    key.span(),
                    format!("a second target {name:?}"),
                    "a different name for each target",
                ));
            }
            _ => {}
        }
        let millimetres =
            |key: &str, value: &Spanned<f64>| Ok::<_, InputError>(source.finite(key, value)? / 1e3);
        let orientation = target.orientation().read(source)?;
        let is_exact = orientation.as_ref().and_then(|turn| turn.covariance);
        if is_exact.is_some_and(|covariance| Cholesky::new(covariance).is_none()) {
            let message =
                "the uncertainty of the target's rotation is not above zero in every direction".to_owned();
            let expected = "rotation_sigma_rad or rotation_covariance_rad2 of a measured rotation, or neither if it is not \
                            known";
            return Err(refused(span, message, expected));
        }
        let sigma = target.sigma_mm.as_ref().map(|sigma| {
            if *sigma.get_ref() == 0.0 {
                let message = "target.sigma_mm is 0, but no measurement is exact".to_owned();
                return Err(refused(
                    sigma.span(),
                    message,
                    "the standard deviation along every axis, or no sigma_mm if it is not known",
                ));
            }
            Ok(source.positive("target.sigma_mm", sigma)? / 1e3)
        });
        targets.push(StatedTarget {
            name: name.map(str::to_owned),
            in_flange: Vector3::new(
                millimetres("target.x_mm", &target.x_mm)?,
                millimetres("target.y_mm", &target.y_mm)?,
                millimetres("target.z_mm", &target.z_mm)?,
            ),
            sigma: sigma.transpose()?,
            orientation,
            place: span,
        });
    }
    Ok(targets)
}
