//! From estimates to models.

use super::ElasticChain;
use calibrig_model::{CalibrationModel, Compliance, ModelError, ParameterId, Section};

/// Puts a parameter of `model` at a deviation from its value in `reference`.
///
/// A compliance of `c (1 + x)` becomes the stiffness `k / (1 + x)`, infinite at x = -1; a mass takes inertia and beam with it. Parameters of frame,
/// target and terms are not in a model.
///
/// # Errors
///
/// [`ModelError`], where one of the two cannot be a robot or has no such parameter, or the parameter cannot have that value.
pub fn apply(
    model: &mut CalibrationModel,
    reference: &CalibrationModel,
    id: ParameterId,
    value: f64,
) -> Result<(), ModelError> {
    for robot in [&*model, reference] {
        ElasticChain::new(robot)?.column(id)?;
    }
    let (holds, expected) = match id {
        ParameterId::Compliance(_) | ParameterId::Mass { .. } => {
            ((-1.0..f64::INFINITY).contains(&value), "a finite number of -1 or more")
        }
        _ => (value.is_finite(), "a finite number"),
    };
    if !holds {
        return Err(ModelError::Number { field: "the parameter's value", joint: None, value, expected });
    }
    put(model, reference, id, value);
    Ok(())
}

/// [`apply`] for a parameter of both.
pub(crate) fn put(model: &mut CalibrationModel, reference: &CalibrationModel, id: ParameterId, value: f64) {
    match id {
        ParameterId::Link { link, term } => {
            *model.kinematics.links[link].term_mut(term) =
                reference.kinematics.links[link].term(term) + value;
        }
        ParameterId::Compliance(compliance) => apply_compliance(model, reference, compliance, 1.0 + value),
        ParameterId::Mass { link } => apply_mass(model, reference, link, 1.0 + value),
        ParameterId::Centre { link, axis } => {
            if let (Some(to), Some(from)) = (&mut model.statics, &reference.statics) {
                to.bodies[link].centre_of_mass[axis] = from.bodies[link].centre_of_mass[axis] + value;
            }
        }
        ParameterId::Linkage(term) => {
            if let (Some(to), Some((_, _, _, from))) =
                (model.actuators.linkage_mut(), reference.actuators.four_bar())
            {
                *to.term_mut(term) = from.term(term) + value;
            }
        }
        ParameterId::Frame { .. }
        | ParameterId::Target { .. }
        | ParameterId::Orientation { .. }
        | ParameterId::Term(_)
        | ParameterId::Instrument { .. }
        | ParameterId::Drift { .. } => {}
    }
}

fn apply_compliance(
    model: &mut CalibrationModel,
    reference: &CalibrationModel,
    compliance: Compliance,
    factor: f64,
) {
    let (Some(to), Some(from)) = (&mut model.statics, &reference.statics) else { return };
    match compliance {
        Compliance::Drive { joint } => to.drive_stiffness[joint] = from.drive_stiffness[joint] / factor,
        Compliance::Bearing { joint, axis } => {
            to.bearings[joint].stiffness[axis] = from.bearings[joint].stiffness[axis] / factor;
        }
        Compliance::Beam { link } => {
            let (Some(to), Some(from)) = (&mut to.beams[link], &from.beams[link]) else { return };
            for (to, from) in to.segments.iter_mut().zip(&from.segments) {
                let mass_per_length = to.section.mass_per_length;
                to.section = Section { mass_per_length, ..from.section.map_stiffness(|k| k / factor) };
            }
        }
        Compliance::Rod => {
            if let (Some(to), Some(from)) = (&mut to.linkage, &from.linkage) {
                to.rod_stiffness = from.rod_stiffness / factor;
            }
        }
    }
}

fn apply_mass(model: &mut CalibrationModel, reference: &CalibrationModel, link: usize, factor: f64) {
    let (Some(to), Some(from)) = (&mut model.statics, &reference.statics) else { return };
    to.bodies[link].mass = from.bodies[link].mass * factor;
    to.bodies[link].inertia = from.bodies[link].inertia * factor;
    if let (Some(to), Some(from)) = (&mut to.beams[link], &from.beams[link]) {
        for (to, from) in to.segments.iter_mut().zip(&from.segments) {
            to.section.mass_per_length = from.section.mass_per_length * factor;
        }
    }
}
