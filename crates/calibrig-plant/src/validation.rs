//! What a plant refuses.

use nalgebra::{Matrix3, Vector3};

use super::tree::{axis, beam_mass};
use super::{AsBuilt, PlantError, SettleOptions};
use calibrig_model::{
    ActuatorMap, Body, ElbowDrive, FourBar, JointKind, KinematicModel, LinkageArm, StaticProperties,
};

/// Relative slack of the triangle inequality, for a lamina or a rod whose inertia was rounded.
const TRIANGLE_SLACK: f64 = 1e-6;
/// Relative slack of the symmetry of an inertia.
const SYMMETRY_SLACK: f64 = 1e-9;

/// Refuses a robot with invalid numbers.
pub(super) fn check_robot(robot: &AsBuilt) -> Result<(), PlantError> {
    let joints = robot.kinematics.joint_count();
    if joints == 0 {
        return Err(PlantError::NoJoints);
    }
    check_length("bodies", joints, robot.statics.bodies.len())?;
    check_length("drive stiffnesses", joints, robot.statics.drive_stiffness.len())?;
    check_length("bearings", joints, robot.statics.bearings.len())?;
    check_length("beams", joints, robot.statics.beams.len())?;
    check_kinematics(&robot.kinematics)?;
    check_actuators(&robot.actuators, &robot.kinematics)?;
    for (joint, body) in robot.statics.bodies.iter().enumerate() {
        check_body(joint, body)?;
    }
    for (joint, &stiffness) in robot.statics.drive_stiffness.iter().enumerate() {
        // Infinity is accepted: it is a rigid drive.
        if stiffness.is_nan() || stiffness <= 0.0 {
            return Err(PlantError::Stiffness { joint, stiffness });
        }
    }
    if let Some(stiffening) = &robot.effects.stiffening {
        stiffening.check(joints)?;
    }
    check_bearings(robot)?;
    check_beams(&robot.statics)?;
    check_linkage(robot)?;
    check_loads(&robot.statics, joints)?;
    robot.effects.check_statics(joints)?;
    check_finite("gravity", None, robot.statics.gravity.as_slice())?;
    check_finite("target", None, robot.target.as_slice())
}

/// Refuses options with which nothing would settle.
pub(super) fn check_options(options: &SettleOptions) -> Result<(), PlantError> {
    let positive = [
        ("dt", options.dt),
        ("max_steps", f64::from(options.max_steps)),
        ("tip_tolerance", options.tip_tolerance),
        ("residual_tolerance", options.residual_tolerance),
        ("closure_tolerance", options.closure_tolerance),
    ];
    match positive.into_iter().find(|(_, value)| !value.is_finite() || *value <= 0.0) {
        Some((option, value)) => Err(PlantError::Option { option, value }),
        None => Ok(()),
    }
}

/// Refuses a command unless it is one finite number per actuator.
pub(super) fn check_command(joints: usize, command: &[f64]) -> Result<(), PlantError> {
    check_length("command", joints, command.len())?;
    command.iter().enumerate().try_for_each(|(joint, &value)| check_finite("command", Some(joint), &[value]))
}

/// Refuses displacements unless they are absent or six finite numbers per joint.
pub(super) fn check_displacements(joints: usize, displacements: &[[f64; 6]]) -> Result<(), PlantError> {
    if displacements.is_empty() {
        return Ok(());
    }
    check_length("displacements", joints, displacements.len())?;
    let mut all = displacements.iter().enumerate();
    all.try_for_each(|(joint, values)| check_finite("displacement", Some(joint), values))
}

/// Refuses a command at which a beam has no length or outweighs its body.
pub(super) fn check_at_command(robot: &AsBuilt, joints: &[f64]) -> Result<(), PlantError> {
    for (joint, q) in joints.iter().enumerate() {
        let Some(beam) = &robot.statics.beams[joint] else { continue };
        for (segment, piece) in beam.segments.iter().enumerate() {
            let length = piece.length.at(*q);
            if !(length > 0.0 && length.is_finite()) {
                return Err(PlantError::BeamLength { joint, segment, length });
            }
        }
        let (beam, body) = (beam_mass(beam, *q).0, robot.statics.bodies[joint].mass);
        if beam > 0.0 && !(beam < body) {
            return Err(PlantError::HeavyBeam { joint, beam, body });
        }
    }
    Ok(())
}

fn check_length(quantity: &'static str, expected: usize, found: usize) -> Result<(), PlantError> {
    if found == expected { Ok(()) } else { Err(PlantError::Length { quantity, expected, found }) }
}

fn check_finite(quantity: &'static str, joint: Option<usize>, values: &[f64]) -> Result<(), PlantError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(PlantError::NotFinite { quantity, joint, value }),
        None => Ok(()),
    }
}

fn check_kinematics(model: &KinematicModel) -> Result<(), PlantError> {
    for (joint, link) in model.links.iter().enumerate() {
        for (quantity, value) in
            [("a", link.a), ("alpha", link.alpha), ("beta", link.beta), ("d", link.d), ("theta", link.theta)]
        {
            check_finite(quantity, Some(joint), &[value])?;
        }
    }
    check_finite("base_from_first", None, model.base_from_first.to_homogeneous().as_slice())?;
    check_finite("last_from_flange", None, model.last_from_flange.to_homogeneous().as_slice())
}

fn check_actuators(map: &ActuatorMap, model: &KinematicModel) -> Result<(), PlantError> {
    let joints = model.joint_count();
    if let ActuatorMap::Axes { axes, .. } = map
        && axes.axes() != joints
    {
        return Err(PlantError::Length {
            quantity: "axes of the actuators",
            found: axes.axes(),
            expected: joints,
        });
    }
    let Some(ElbowDrive { shoulder, elbow, offset, linkage }) = map.elbow() else { return Ok(()) };
    let is_revolute = |joint: usize| model.links[joint].kind == JointKind::Revolute;
    if shoulder >= joints || elbow >= joints || shoulder == elbow {
        return Err(PlantError::Transmission { shoulder, elbow, joints });
    }
    if linkage.is_some() && !(shoulder < elbow && is_revolute(shoulder) && is_revolute(elbow)) {
        return Err(PlantError::Transmission { shoulder, elbow, joints });
    }
    check_finite("parallelogram offset", None, &[offset])
}

fn check_positive(joint: usize, field: &'static str, values: &[f64]) -> Result<(), PlantError> {
    // Infinity is accepted: it is rigid.
    match values.iter().find(|value| !(**value > 0.0)) {
        Some(&value) => Err(PlantError::NotPositive { joint, field, value }),
        None => Ok(()),
    }
}

fn check_bearings(robot: &AsBuilt) -> Result<(), PlantError> {
    let bearings = robot.statics.bearings.iter().zip(&robot.kinematics.links).enumerate();
    for (joint, (bearing, link)) in bearings {
        let mut stiffness = bearing.stiffness;
        stiffness[axis(link.kind)] = f64::INFINITY;
        check_positive(joint, "a bearing stiffness", &stiffness)?;
        check_finite("place of the bearing", Some(joint), &[bearing.at])?;
    }
    Ok(())
}

fn check_beams(statics: &StaticProperties) -> Result<(), PlantError> {
    for (joint, beam) in statics.beams.iter().enumerate() {
        for piece in beam.iter().flat_map(|beam| &beam.segments) {
            let section = &piece.section;
            check_positive(joint, "the axial rigidity of a beam segment", &[section.axial])?;
            check_positive(joint, "a shear rigidity of a beam segment", &section.shear)?;
            check_positive(joint, "the torsional rigidity of a beam segment", &[section.torsion])?;
            check_positive(joint, "a bending rigidity of a beam segment", &section.bending)?;
            let weight = section.mass_per_length;
            check_finite("mass per length of a beam segment", Some(joint), &[weight])?;
            if weight < 0.0 {
                let field = "the mass per length of a beam segment";
                return Err(PlantError::NotPositive { joint, field, value: weight });
            }
        }
    }
    Ok(())
}

fn check_linkage(robot: &AsBuilt) -> Result<(), PlantError> {
    let Some((_, elbow, _, FourBar { crank, lever, rod, axis })) = robot.actuators.four_bar() else {
        return Ok(());
    };
    for (field, value) in [
        ("the crank's length", crank.length),
        ("the lever's length", lever.length),
        ("the rod's length", *rod),
    ] {
        check_positive(elbow, field, &[value])?;
        check_finite(field, Some(elbow), &[value])?;
    }
    for LinkageArm { angle, along, .. } in [crank, lever] {
        check_finite("place of a four-bar's end", Some(elbow), &[*angle, *along])?;
    }
    check_finite("place or tilt of the crank's axis", Some(elbow), &[axis.x, axis.y, axis.rx, axis.ry])?;
    let Some(statics) = &robot.statics.linkage else { return Ok(()) };
    check_positive(elbow, "the rod's stiffness", &[statics.rod_stiffness])?;
    check_finite("mass of the rod", Some(elbow), &[statics.rod_mass])?;
    if statics.rod_mass < 0.0 {
        return Err(PlantError::Mass { joint: elbow, mass: statics.rod_mass });
    }
    check_body(elbow, &statics.crank)
}

fn check_loads(statics: &StaticProperties, joints: usize) -> Result<(), PlantError> {
    for (index, load) in statics.loads.iter().enumerate() {
        if load.link >= joints {
            return Err(PlantError::Load { load: index, link: load.link, joints });
        }
        check_finite("place of a load", Some(load.link), load.at.as_slice())?;
        check_finite("force of a load", Some(load.link), load.force.as_slice())?;
        check_finite("mass of a load", Some(load.link), &[load.mass])?;
        if load.mass < 0.0 {
            return Err(PlantError::Mass { joint: load.link, mass: load.mass });
        }
    }
    Ok(())
}

fn check_body(joint: usize, body: &Body) -> Result<(), PlantError> {
    check_finite("mass", Some(joint), &[body.mass])?;
    check_finite("centre of mass", Some(joint), body.centre_of_mass.as_slice())?;
    check_finite("inertia", Some(joint), body.inertia.as_slice())?;
    if body.mass < 0.0 {
        return Err(PlantError::Mass { joint, mass: body.mass });
    }
    if body.mass == 0.0 { Ok(()) } else { check_inertia(joint, &body.inertia) }
}

fn check_inertia(joint: usize, inertia: &Matrix3<f64>) -> Result<(), PlantError> {
    let asymmetry = (inertia - inertia.transpose()).amax();
    if asymmetry > SYMMETRY_SLACK * inertia.amax() {
        return Err(PlantError::AsymmetricInertia { joint, asymmetry });
    }
    let mut moments: Vector3<f64> = inertia.symmetric_eigenvalues();
    moments.as_mut_slice().sort_by(f64::total_cmp);
    let [least, middle, greatest] = moments.into();
    if least > 0.0 && greatest <= (least + middle) * (1.0 + TRIANGLE_SLACK) {
        Ok(())
    } else {
        Err(PlantError::Inertia { joint, principal: [least, middle, greatest] })
    }
}
