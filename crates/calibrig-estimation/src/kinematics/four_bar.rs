//! The spatial four-bar that drives the elbow, closed without iteration.

use nalgebra::Vector3;
use thiserror::Error;

use super::JOINTS;
use calibrig_model::geometry::{Transform, rotation_z};
use calibrig_model::{
    ActuatorMap, CalibrationModel, CraigLink, CrankAxis, FourBar, KinematicModel, LEAST_TRANSMISSION_ANGLE,
    ModelError,
};

/// Why a four-bar gives no joint angle.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum ClosureError {
    /// The ends of crank and lever cannot be at the rod's length.
    #[error("the four-bar cannot close: its rod is {:.6} m too {}", gap.abs(), if *gap > 0.0 { "short" } else { "long" })]
    CannotClose {
        /// How much longer the rod would have to be, m; negative where it is too long.
        gap: f64,
    },
    /// Rod and lever (or crank) are nearly in one line: the two ways to close the four-bar meet.
    #[error(
        "the four-bar is near its singularity: rod and arm at {:.2} deg, at least {:.0} deg needed",
        transmission_angle.to_degrees(),
        LEAST_TRANSMISSION_ANGLE.to_degrees()
    )]
    NearSingular {
        /// Angle between the rod and the arm that it turns, rad.
        transmission_angle: f64,
    },
    /// The joint angles belong to the way of closing that is farther from the exact parallelogram.
    #[error(
        "elbow angle {q_elbow} rad is the four-bar's other closure; the machine would go to {nearest} rad"
    )]
    OtherClosure {
        /// The angle asked for, rad.
        q_elbow: f64,
        /// The angle that the command sets, rad.
        nearest: f64,
    },
    /// The four-bar spans other joints.
    #[error("the four-bar joins joints {} and {}, which are not neighbours", shoulder.saturating_add(1), elbow.saturating_add(1))]
    NotNeighbours {
        /// Index of the shoulder.
        shoulder: usize,
        /// Index of the elbow.
        elbow: usize,
    },
    /// The chain is not valid, or the command or the joint variables do not have one finite number per joint.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// An arm turned about its axis until the rod fits.
///
/// All vectors are in the frame in which [`swing_to`] was given its arguments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closure {
    /// The arm's angle about its axis, rad: within half a turn of the ideal one.
    pub angle: f64,
    /// The end of the arm, m.
    pub end: Vector3<f64>,
    /// Unit vector along the rod, towards [`Self::end`].
    pub rod_direction: Vector3<f64>,
    /// Change of the distance between the rod's ends per unit of the angle, m/rad.
    pub rate: f64,
    /// Angle between rod and arm, 0..pi/2 rad: `sin` of it is `|rate|` over the arm's length.
    pub transmission_angle: f64,
}

/// Turns an arm about the z axis of `pivot` until its end is at the distance `rod` (m) of `anchor`, and gives the angle nearest to `ideal`.
///
/// `end` is the arm's end in the turning frame, which is `pivot` at the angle zero; any displacement behind the axis is part of it. The
/// rod's condition is linear in sine and cosine of the angle; with the half-angle tangent of the deviation from `ideal` it is a quadratic whose
/// smaller root is the wanted one, and which is exact where the deviation vanishes.
///
/// # Errors
///
/// [`ClosureError::CannotClose`] out of the rod's reach, [`ClosureError::NearSingular`] below [`LEAST_TRANSMISSION_ANGLE`].
pub fn swing_to(
    pivot: &Transform,
    end: &Vector3<f64>,
    anchor: &Vector3<f64>,
    rod: f64,
    ideal: f64,
) -> Result<Closure, ClosureError> {
    // In the pivot's axes, where the arm's end has the height of its own z and turns in x and y.
    let to_anchor = pivot.rotation.inverse() * (anchor - pivot.translation.vector);
    let turned = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        Vector3::new(cos * end.x - sin * end.y, sin * end.x + cos * end.y, end.z)
    };
    let at_ideal = turned(ideal);
    let ideal_rod = at_ideal - to_anchor;
    // distance²(deviation) - rod² = misfit + 2 tangential sin(deviation) + 2 radial (1 - cos(deviation))
    let ideal_length = ideal_rod.norm();
    let misfit = (ideal_length - rod) * (ideal_length + rod);
    let tangential = at_ideal.x * ideal_rod.y - at_ideal.y * ideal_rod.x;
    let radial = at_ideal.x * to_anchor.x + at_ideal.y * to_anchor.y;

    // The square of half the derivative of distance² at either closure.
    let discriminant = tangential * tangential - misfit * (misfit / 4.0 + radial);
    if !(discriminant >= 0.0 && rod > 0.0) {
        return Err(out_of_reach(rod, misfit + 2.0 * radial, 2.0 * tangential.hypot(radial)));
    }
    let slope = discriminant.sqrt();
    let transmission_angle = (slope / (rod * end.x.hypot(end.y))).clamp(0.0, 1.0).asin();
    if !(transmission_angle >= LEAST_TRANSMISSION_ANGLE) {
        return Err(ClosureError::NearSingular { transmission_angle });
    }
    let half_angle_tangent = -misfit / (2.0 * (tangential + slope.copysign(tangential)));
    let angle = ideal + 2.0 * half_angle_tangent.atan();

    let closed = turned(angle);
    let rod_direction = (closed - to_anchor).normalize();
    Ok(Closure {
        angle,
        end: pivot.rotation * closed + pivot.translation.vector,
        rod_direction: pivot.rotation * rod_direction,
        rate: closed.x * rod_direction.y - closed.y * rod_direction.x,
        transmission_angle,
    })
}

/// The refusal where distance² lies within `middle ± range` of rod² for every angle, and neither side contains zero.
fn out_of_reach(rod: f64, middle: f64, range: f64) -> ClosureError {
    let nearest = if middle > 0.0 { middle - range } else { middle + range };
    let gap = (rod * rod + nearest).max(0.0).sqrt() - rod;
    // Rounding decides on which side of the flat four-bar this is.
    if gap.abs() <= 1e-12 * rod.abs() {
        return ClosureError::NearSingular { transmission_angle: 0.0 };
    }
    ClosureError::CannotClose { gap }
}

/// The elbow's four-bar without deflections, made once a robot and closed at every command.
///
/// Crank and upper arm turn alike behind the shoulder's fixed part, in whose frame the crank's axis is told, so the shoulder's own link parameters
/// have no influence on the elbow's angle, and all is computed there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElbowLinkage {
    joints: usize,
    shoulder: usize,
    elbow: usize,
    offset: f64,
    rod: f64,
    axis: CrankAxis,
    crank_end: Vector3<f64>,
    lever_end: Vector3<f64>,
    /// Of the elbow's link.
    fixed_part: Transform,
    theta: f64,
}

/// The elbow's angle and how it follows the commands; the links are rigid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElbowClosure {
    /// rad
    pub q_elbow: f64,
    /// By the elbow's command psi, rad/rad.
    pub by_psi: f64,
    /// By the shoulder's joint variable at psi held, rad/rad.
    pub by_shoulder: f64,
}

impl ElbowLinkage {
    /// The four-bar of a robot, or `None` where the elbow has none whose lengths are known.
    ///
    /// # Errors
    ///
    /// [`ClosureError::NotNeighbours`].
    pub fn new(kinematics: &KinematicModel, actuators: &ActuatorMap) -> Result<Option<Self>, ClosureError> {
        let Some((shoulder, elbow, offset, linkage)) = actuators.four_bar() else {
            return Ok(None);
        };
        let link = match kinematics.links.get(elbow) {
            Some(link) if elbow == shoulder.saturating_add(1) => link,
            _ => return Err(ClosureError::NotNeighbours { shoulder, elbow }),
        };
        Ok(Some(Self {
            joints: kinematics.joint_count(),
            shoulder,
            elbow,
            offset,
            rod: linkage.rod,
            axis: linkage.axis,
            crank_end: linkage.crank.end(),
            lever_end: linkage.lever.end(),
            fixed_part: link.fixed_part(),
            theta: link.theta,
        }))
    }

    /// The shoulder's and the elbow's entry of a list with one a joint.
    fn pair(&self, field: &'static str, values: &[f64]) -> Result<(f64, f64), ModelError> {
        let length = ModelError::Length { field, found: values.len(), expected: self.joints };
        match (values.get(self.shoulder), values.get(self.elbow)) {
            (Some(&shoulder), Some(&elbow)) if values.len() == self.joints => Ok((shoulder, elbow)),
            _ => Err(length),
        }
    }

    fn crank(&self, psi: f64) -> Transform {
        self.axis.shoulder_from_axis() * rotation_z(psi + self.offset + self.theta)
    }

    fn pivot(&self, q_shoulder: f64) -> Transform {
        rotation_z(q_shoulder) * self.fixed_part
    }

    fn close(&self, psi: f64, q_shoulder: f64) -> Result<Closure, ClosureError> {
        let anchor = self.crank(psi).transform_point(&self.crank_end.into()).coords;
        let ideal = psi + self.offset - q_shoulder;
        swing_to(&self.pivot(q_shoulder), &self.lever_end, &anchor, self.rod, ideal)
    }

    /// The elbow's joint variable at these [positions of the actuators](ActuatorMap::actuators_from_command) (as long as the chain), rad.
    ///
    /// # Errors
    ///
    /// [`ClosureError`].
    pub fn q_elbow(&self, command: &[f64]) -> Result<f64, ClosureError> {
        let (q_shoulder, psi) = self.pair("command", command)?;
        Ok(self.close(psi, q_shoulder)?.angle)
    }

    /// The position psi of the elbow's actuator that sets the joint variables (as long as the chain), rad.
    ///
    /// # Errors
    ///
    /// [`ClosureError`].
    pub fn psi(&self, joints: &[f64]) -> Result<f64, ClosureError> {
        let (q_shoulder, q_elbow) = self.pair(JOINTS, joints)?;
        let anchor =
            (self.pivot(q_shoulder) * rotation_z(q_elbow)).transform_point(&self.lever_end.into()).coords;
        let ideal = q_shoulder + q_elbow + self.theta;
        let turned = swing_to(&self.axis.shoulder_from_axis(), &self.crank_end, &anchor, self.rod, ideal)?;
        let psi = turned.angle - self.offset - self.theta;
        let nearest = self.close(psi, q_shoulder)?.angle;
        // Away from the singularity the two closures are far apart, and rounding is far below this.
        if (nearest - q_elbow).abs() > 1e-6 {
            return Err(ClosureError::OtherClosure { q_elbow, nearest });
        }
        Ok(psi)
    }

    /// The elbow's angle at these [positions of the actuators](ActuatorMap::actuators_from_command) (as long as the chain), with its derivatives.
    ///
    /// # Errors
    ///
    /// [`ClosureError`].
    pub fn closure(&self, command: &[f64]) -> Result<ElbowClosure, ClosureError> {
        let (q_shoulder, psi) = self.pair("command", command)?;
        let closure = self.close(psi, q_shoulder)?;
        // The rod keeps its length: what it is stretched by at either end, the elbow makes up for.
        let by_end = |motion: Vector3<f64>| -closure.rod_direction.dot(&motion) / closure.rate;
        let by_anchor = |motion: Vector3<f64>| closure.rod_direction.dot(&motion) / closure.rate;
        // From where the crank's axis crosses the plane z = 0 of its frame to the crank's end.
        let crank = self.crank(psi);
        let crank_arm = crank.rotation * self.crank_end;
        let crank_axis = crank.rotation * Vector3::z();
        Ok(ElbowClosure {
            q_elbow: closure.angle,
            by_psi: by_anchor(crank_axis.cross(&crank_arm)),
            by_shoulder: by_end(Vector3::z().cross(&closure.end)),
        })
    }
}

/// Writes the joint variables of `command` to `joints` (both as long as the chain): those of the rigid machine, with its real four-bar where
/// the lengths are known, else those of the [ideal map](ActuatorMap::joints_from_command).
///
/// # Errors
///
/// [`ClosureError`]: of a four-bar that does not close, with the elbow's entry that of the ideal map; or of a chain, a map, a command or a
/// list `joints` that do not belong together, with `joints` as they were.
pub fn joints_from_command(
    kinematics: &KinematicModel,
    actuators: &ActuatorMap,
    command: &[f64],
    joints: &mut [f64],
) -> Result<(), ClosureError> {
    kinematics.check()?;
    let linkage = ElbowLinkage::new(kinematics, actuators)?;
    actuators.check(kinematics.joint_count())?;
    kinematics.check_joints("command", command)?;
    let (found, expected) = (joints.len(), kinematics.joint_count());
    if found != expected {
        return Err(ModelError::Length { field: JOINTS, found, expected }.into());
    }
    actuators.joints_from_command(command, joints);
    if let Some(linkage) = linkage {
        let mut positions = vec![0.0; expected];
        actuators.actuators_from_command(command, &mut positions);
        joints[linkage.elbow] = linkage.q_elbow(&positions)?;
    }
    Ok(())
}

/// Joint variables of the rigid nominal machine, for a command and a list that are known to be of it: those of the ideal map, or where the lengths
/// of its four-bar are those of no parallelogram, of that four-bar.
///
/// # Errors
///
/// [`ClosureError`] of a four-bar that does not close, with the elbow's entry that of the ideal map.
pub(crate) fn nominal_joints(
    model: &CalibrationModel,
    command: &[f64],
    joints: &mut [f64],
) -> Result<(), ClosureError> {
    match model.actuators.four_bar() {
        Some((_, elbow, _, linkage)) if !is_parallelogram(&model.kinematics, elbow, linkage) => {
            joints_from_command(&model.kinematics, &model.actuators, command, joints)
        }
        _ => {
            model.actuators.joints_from_command(command, joints);
            Ok(())
        }
    }
}

/// Whether crank and lever are the same, the rod is as long as the upper arm, and the crank turns about the shoulder's axis.
pub(crate) fn is_parallelogram(kinematics: &KinematicModel, elbow: usize, linkage: &FourBar) -> bool {
    let is_arm = |link: &CraigLink| {
        link.a.abs() == linkage.rod && [link.alpha, link.beta, link.d].iter().all(|value| *value == 0.0)
    };
    let is_coaxial = linkage.axis.is_shoulders();
    is_coaxial && linkage.crank == linkage.lever && kinematics.links.get(elbow).is_some_and(is_arm)
}

/// The command that takes the rigid machine, with its real four-bar where the lengths are known, to `joints`.
///
/// # Errors
///
/// [`ClosureError`], also where the command would take the machine elsewhere, or chain, map and joint variables do not belong together.
pub fn command_from_joints(
    kinematics: &KinematicModel,
    actuators: &ActuatorMap,
    joints: &[f64],
) -> Result<Vec<f64>, ClosureError> {
    kinematics.check()?;
    let linkage = ElbowLinkage::new(kinematics, actuators)?;
    actuators.check(kinematics.joint_count())?;
    kinematics.check_joints(JOINTS, joints)?;
    let Some(linkage) = linkage else { return Ok(actuators.command_from_joints(joints)) };
    let mut positions = joints.to_vec();
    positions[linkage.elbow] = linkage.psi(joints)?;
    Ok(actuators.command_from_actuators(&positions))
}

#[cfg(test)]
mod tests;
