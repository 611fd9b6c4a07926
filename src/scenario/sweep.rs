//! `[[session.sweep]]`: joints that are moved alone, from which the stations can be placed.

use serde::Deserialize;

use super::session::Around;
use calibrig_files::{InputError, Source, Spanned};
use calibrig_model::JointKind;
use calibrig_plant::session::{LEAST_PLACES, MOST_PLACES, PlannedSweep};

/// Default number of places of a sweep.
const PLACES: u32 = 15;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SweepFile {
    joint: Spanned<String>,
    from_mm: Option<Spanned<f64>>,
    to_mm: Option<Spanned<f64>>,
    from_deg: Option<Spanned<f64>>,
    to_deg: Option<Spanned<f64>>,
    places: Option<Spanned<u32>>,
}

pub(super) fn sweeps(
    source: &Source,
    files: &[Spanned<SweepFile>],
    around: &Around<'_>,
) -> Result<Vec<PlannedSweep>, InputError> {
    files.iter().map(|file| sweep(source, file, around)).collect()
}

fn sweep(
    source: &Source,
    section: &Spanned<SweepFile>,
    around: &Around<'_>,
) -> Result<PlannedSweep, InputError> {
    let file = section.get_ref();
    let links = &around.robot.model.kinematics.links;
    let name = file.joint.get_ref();
    let Some(joint) = links.iter().position(|link| link.name == *name) else {
        let known: Vec<_> = links.iter().map(|link| link.name.as_str()).collect();
        let help = format!("expected the name of a joint: {}", known.join(", "));
        return Err(source.error(
            file.joint.span(),
            format!("session.sweep.joint is \"{name}\""),
            Some(help),
        ));
    };
    let link = &links[joint];
    let (own, other, keys, unit, name_of) = match link.kind {
        JointKind::Prismatic => (
            [&file.from_mm, &file.to_mm],
            [&file.from_deg, &file.to_deg],
            ["from_mm", "to_mm"],
            1e-3,
            "slides",
        ),
        JointKind::Revolute => {
            let unit = 1f64.to_radians();
            (
                [&file.from_deg, &file.to_deg],
                [&file.from_mm, &file.to_mm],
                ["from_deg", "to_deg"],
                unit,
                "turns",
            )
        }
    };
    if let Some(wrong) = other.into_iter().flatten().next() {
        let help = format!("expected {} and {}, or neither for the working region's", keys[0], keys[1]);
        return Err(source.error(
            wrong.span(),
            format!("session.sweep: joint \"{name}\" {name_of}"),
            Some(help),
        ));
    }
    let of_region = around.region.centre.get(joint).zip(around.region.half_width.get(joint));
    let usual = of_region.map_or([0.0; 2], |(centre, half)| [centre - half, centre + half]);
    let mut range = [0.0; 2];
    for ((value, (given, key)), usual) in range.iter_mut().zip(own.into_iter().zip(keys)).zip(usual) {
        *value = match given {
            Some(given) => unit * source.finite(&format!("session.sweep.{key}"), given)?,
            None => usual,
        };
        let [low, high] = link.limits;
        if !(low - 1e-9..=high + 1e-9).contains(value) {
            let span = given.as_ref().map_or_else(|| section.span(), Spanned::span);
            let help = format!("expected {:.3} to {:.3}, the joint's limits", low / unit, high / unit);
            let message =
                format!("session.sweep.{key} is {:.3}, where joint \"{name}\" cannot go", *value / unit);
            return Err(source.error(span, message, Some(help)));
        }
    }
    if range[0] == range[1] {
        let help = format!("expected {} and {} that differ", keys[0], keys[1]);
        let message = format!("session.sweep: joint \"{name}\" does not move");
        return Err(source.error(section.span(), message, Some(help)));
    }
    let places = file.places.as_ref().map_or(PLACES, |places| *places.get_ref());
    if let Some(given) = file.places.as_ref().filter(|_| !(LEAST_PLACES..=MOST_PLACES).contains(&places)) {
        let help = format!("expected {LEAST_PLACES} to {MOST_PLACES} places");
        return Err(source.error(given.span(), format!("session.sweep.places is {places}"), Some(help)));
    }
    Ok(PlannedSweep { joint, range, places })
}
