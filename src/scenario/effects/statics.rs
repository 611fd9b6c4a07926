//! `[effects.foundation]` and `[effects.hoses]`: the effects that are part of the machine's statics.

use nalgebra::Vector3;
use serde::Deserialize;

use super::Reader;
use super::entries::yes;
use calibrig_files::{InputError, Spanned, spring_table};
use calibrig_model::JointKind;
use calibrig_plant::effects::{Anchor, Foundation, Hose, Hoses, RailSpan};

spring_table! {
    pub(in crate::scenario) struct FoundationFile {
        #[serde(default = "yes")]
        enabled: bool,
        x_mm: Option<Spanned<f64>>,
        y_mm: Option<Spanned<f64>>,
        z_mm: Option<Spanned<f64>>,
        rail: Option<RailSpanFile>,
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RailSpanFile {
    joint: Spanned<String>,
    first_foot_mm: Option<Spanned<f64>>,
    span_mm: Spanned<f64>,
    sag_x_um_per_kn: Option<Spanned<f64>>,
    sag_y_um_per_kn: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scenario) struct HosesFile {
    #[serde(default = "yes")]
    enabled: bool,
    #[serde(default)]
    hose: Vec<Spanned<HoseFile>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HoseFile {
    from: Spanned<AnchorFile>,
    to: Spanned<AnchorFile>,
    stiffness_n_per_m: Spanned<f64>,
    free_length_mm: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AnchorFile {
    /// On the link of this joint; on the ground if absent.
    joint: Option<Spanned<String>>,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
}

pub(super) fn foundation(
    reader: &Reader<'_>,
    section: Option<&Spanned<FoundationFile>>,
) -> Result<Option<Foundation>, InputError> {
    let Some(section) = section else { return Ok(None) };
    let (file, source) = (section.get_ref(), reader.source);
    let place = |key: &str, value: &Option<Spanned<f64>>| -> Result<f64, InputError> {
        match value {
            Some(value) => Ok(1e-3 * source.finite(&format!("effects.foundation.{key}"), value)?),
            None => Ok(0.0),
        }
    };
    let at = Vector3::new(place("x_mm", &file.x_mm)?, place("y_mm", &file.y_mm)?, place("z_mm", &file.z_mm)?);
    let mut stiffness = [f64::INFINITY; 6];
    for ((key, value), stiffness) in file.stiffnesses().into_iter().zip(&mut stiffness) {
        if let Some(value) = value {
            *stiffness = source.positive(&format!("effects.foundation.{key}"), value)?;
        }
    }
    let rail = file.rail.as_ref().map(|rail| rail_span(reader, rail)).transpose()?;
    if rail.is_none() && stiffness.iter().all(|stiffness| stiffness.is_infinite()) {
        let message = "[effects.foundation] has nothing that yields".to_owned();
        return Err(reader.refuse(section.span(), message, "a stiffness_*, or [effects.foundation.rail]"));
    }
    Ok(file.enabled.then_some(Foundation { at, stiffness, rail }))
}

fn rail_span(reader: &Reader<'_>, file: &RailSpanFile) -> Result<RailSpan, InputError> {
    let source = reader.source;
    let joint = super::joint_index(source, &file.joint, reader.chain())?;
    let link = &reader.chain().links[joint];
    if joint != 0 || link.kind != JointKind::Prismatic {
        let message =
            format!("effects.foundation.rail.joint \"{}\" is not a rail that carries the robot", link.name);
        return Err(reader.refuse(file.joint.span(), message, "the first joint, a prismatic one"));
    }
    let sag = |key: &str, value: &Option<Spanned<f64>>| -> Result<f64, InputError> {
        match value {
            Some(value) => Ok(1e-9 * source.not_negative(&format!("effects.foundation.rail.{key}"), value)?),
            None => Ok(0.0),
        }
    };
    let compliance =
        [sag("sag_x_um_per_kn", &file.sag_x_um_per_kn)?, sag("sag_y_um_per_kn", &file.sag_y_um_per_kn)?];
    if compliance == [0.0; 2] {
        let message = "[effects.foundation.rail] does not sag".to_owned();
        return Err(reader.refuse(
            file.joint.span(),
            message,
            "sag_x_um_per_kn or sag_y_um_per_kn above zero",
        ));
    }
    Ok(RailSpan {
        joint,
        first_foot: match &file.first_foot_mm {
            Some(foot) => 1e-3 * source.finite("effects.foundation.rail.first_foot_mm", foot)?,
            None => link.limits[0],
        },
        span: 1e-3 * source.positive("effects.foundation.rail.span_mm", &file.span_mm)?,
        compliance,
    })
}

pub(super) fn hoses(
    reader: &Reader<'_>,
    section: Option<&Spanned<HosesFile>>,
) -> Result<Option<Hoses>, InputError> {
    let Some(section) = section else { return Ok(None) };
    let file = section.get_ref();
    if file.hose.is_empty() {
        let message = "[effects.hoses] has no hose".to_owned();
        return Err(reader.refuse(section.span(), message, "[[effects.hoses.hose]] for at least one hose"));
    }
    let hoses = file.hose.iter().map(|hose| self::hose(reader, hose)).collect::<Result<_, _>>()?;
    Ok(file.enabled.then_some(Hoses { hoses }))
}

fn hose(reader: &Reader<'_>, entry: &Spanned<HoseFile>) -> Result<Hose, InputError> {
    let file = entry.get_ref();
    let ends = [anchor(reader, &file.from)?, anchor(reader, &file.to)?];
    if ends[0].link == ends[1].link {
        let message = "a hose between two points of one link has no effect".to_owned();
        return Err(reader.refuse(
            entry.span(),
            message,
            "from and to on two links, or one of them on the ground",
        ));
    }
    Ok(Hose {
        ends,
        stiffness: reader.source.positive("stiffness_n_per_m", &file.stiffness_n_per_m)?,
        free_length: 1e-3 * reader.source.positive("free_length_mm", &file.free_length_mm)?,
    })
}

fn anchor(reader: &Reader<'_>, entry: &Spanned<AnchorFile>) -> Result<Anchor, InputError> {
    let file = entry.get_ref();
    let joint = file.joint.as_ref().map(|joint| super::joint_index(reader.source, joint, reader.chain()));
    let mm = |key: &str, value: &Spanned<f64>| -> Result<f64, InputError> {
        Ok(1e-3 * reader.source.finite(key, value)?)
    };
    let at = Vector3::new(mm("x_mm", &file.x_mm)?, mm("y_mm", &file.y_mm)?, mm("z_mm", &file.z_mm)?);
    Ok(Anchor { link: joint.transpose()?, at })
}
