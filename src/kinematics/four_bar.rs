//! The spatial four-bar that drives the elbow, closed without iteration.

use nalgebra::Vector3;
use thiserror::Error;

use crate::geometry::{Transform, rotation_x, rotation_z};
use crate::model::{
    ActuatorMap, CraigLink, FourBar, KinematicModel, LinkTerm, LinkageArm, LinkageLength, ParameterId,
};

/// Where rod and arm come closer to one line than this, rad, the elbow's angle is hardly determined and is refused.
pub const LEAST_TRANSMISSION_ANGLE: f64 = 10.0 * std::f64::consts::PI / 180.0;

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
    #[error("the four-bar joins joints {} and {}, which are not neighbours", shoulder + 1, elbow + 1)]
    NotNeighbours {
        /// Index of the shoulder.
        shoulder: usize,
        /// Index of the elbow.
        elbow: usize,
    },
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

impl Closure {
    /// The change of the angle, rad, when the arm's end is displaced by `end` (at the angle held), the rod's other end by `anchor` and the
    /// rod's length changes by `rod`, m; to first order.
    pub fn angle_change(&self, end: &Vector3<f64>, anchor: &Vector3<f64>, rod: f64) -> f64 {
        (rod - self.rod_direction.dot(&(end - anchor))) / self.rate
    }
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
    let turn = |angle: f64, point: &Vector3<f64>| pivot.rotation * (rotation_z(angle).rotation * point);
    let from_anchor = |angle: f64| turn(angle, end) + pivot.translation.vector - anchor;
    let radius = Vector3::new(end.x, end.y, 0.0);
    let axis: Vector3<f64> = pivot.rotation.matrix().column(2).into_owned();

    let outward = turn(ideal, &radius);
    let ideal_rod = from_anchor(ideal);
    // distance²(deviation) - rod² = misfit + 2 tangential sin(deviation) + 2 radial (1 - cos(deviation))
    let ideal_length = ideal_rod.norm();
    let misfit = (ideal_length - rod) * (ideal_length + rod);
    let tangential = ideal_rod.dot(&axis.cross(&outward));
    let radial = outward.norm_squared() - ideal_rod.dot(&outward);

    // The square of half the derivative of distance² at either closure.
    let discriminant = tangential * tangential - misfit * (misfit / 4.0 + radial);
    if !(discriminant >= 0.0 && rod > 0.0) {
        return Err(out_of_reach(rod, misfit + 2.0 * radial, 2.0 * tangential.hypot(radial)));
    }
    let slope = discriminant.sqrt();
    let arm = radius.norm();
    let transmission_angle = (slope / (rod * arm)).clamp(0.0, 1.0).asin();
    if !(transmission_angle >= LEAST_TRANSMISSION_ANGLE) {
        return Err(ClosureError::NearSingular { transmission_angle });
    }
    let half_angle_tangent = -misfit / (2.0 * (tangential + slope.copysign(tangential)));
    let angle = ideal + 2.0 * half_angle_tangent.atan();

    let along_rod = from_anchor(angle);
    let rod_direction = along_rod.normalize();
    Ok(Closure {
        angle,
        end: along_rod + anchor,
        rod_direction,
        rate: rod_direction.dot(&axis.cross(&turn(angle, &radius))),
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

/// The elbow's four-bar without deflections, in the frame behind the shoulder's fixed part and in front of its motion.
///
/// Crank and upper arm turn in that frame alike, so the shoulder's own link parameters have no influence on the elbow's angle.
#[derive(Debug, Clone, Copy, PartialEq)]
struct RigidFourBar<'a> {
    elbow: &'a CraigLink,
    linkage: &'a FourBar,
    offset: f64,
}

impl RigidFourBar<'_> {
    fn crank(&self, psi: f64) -> Transform {
        rotation_z(psi + self.offset)
    }

    fn pivot(&self, q_shoulder: f64) -> Transform {
        rotation_z(q_shoulder) * self.elbow.fixed_part()
    }

    fn elbow(&self, psi: f64, q_shoulder: f64) -> Result<Closure, ClosureError> {
        let anchor = self.crank(psi).rotation * self.linkage.crank.end();
        let ideal = psi + self.offset - q_shoulder;
        swing_to(&self.pivot(q_shoulder), &self.linkage.lever.end(), &anchor, self.linkage.rod, ideal)
    }

    fn psi(&self, q_shoulder: f64, q_elbow: f64) -> Result<f64, ClosureError> {
        let lever = self.linkage.lever.end();
        let anchor = (self.pivot(q_shoulder) * rotation_z(q_elbow)).transform_point(&lever.into()).coords;
        let ideal = q_shoulder + q_elbow;
        let crank = self.linkage.crank.end();
        let turned = swing_to(&Transform::identity(), &crank, &anchor, self.linkage.rod, ideal)?;
        let psi = turned.angle - self.offset;
        let nearest = self.elbow(psi, q_shoulder)?.angle;
        // Away from the singularity the two closures are far apart, and rounding is far below this.
        if (nearest - q_elbow).abs() > 1e-6 {
            return Err(ClosureError::OtherClosure { q_elbow, nearest });
        }
        Ok(psi)
    }
}

/// The elbow's angle and its change per unit of all that it depends on; the links are rigid.
///
/// The shoulder's link parameters are missing because they have no influence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElbowClosure {
    /// Index of the elbow.
    pub elbow: usize,
    /// rad
    pub q_elbow: f64,
    /// Angle between rod and lever, rad.
    pub transmission_angle: f64,
    /// By the elbow's command psi, rad/rad.
    pub by_psi: f64,
    /// By the shoulder's joint variable at psi held, rad/rad.
    pub by_shoulder: f64,
    /// By the lengths, in the order of [`LinkageLength::ALL`], rad/m.
    pub by_lengths: [f64; 3],
    /// By the elbow's link parameters, in the order of [`LinkTerm::ALL`], rad/m or rad/rad.
    pub by_link: [f64; 5],
}

impl ElbowClosure {
    /// Change of the elbow's angle per unit of any parameter, at the command held. Deflections are not in it.
    pub fn by(&self, id: ParameterId) -> f64 {
        let pick = |found: Option<usize>, values: &[f64]| found.map_or(0.0, |i| values[i]);
        match id {
            ParameterId::Link { link, term } if link == self.elbow => {
                pick(LinkTerm::ALL.iter().position(|t| *t == term), &self.by_link)
            }
            ParameterId::Linkage(length) => {
                pick(LinkageLength::ALL.iter().position(|l| *l == length), &self.by_lengths)
            }
            _ => 0.0,
        }
    }
}

/// The direction in which an arm's end moves when the arm grows, in the arm's frame.
fn growth(arm: &LinkageArm) -> Vector3<f64> {
    let (sin, cos) = arm.angle.sin_cos();
    Vector3::new(cos, sin, 0.0)
}

/// Closes the elbow's four-bar at a command, with derivatives; `None` where the elbow has none whose lengths are known.
///
/// # Errors
///
/// [`ClosureError`].
pub fn elbow_closure(
    kinematics: &KinematicModel,
    actuators: &ActuatorMap,
    command: &[f64],
) -> Result<Option<ElbowClosure>, ClosureError> {
    let Some((shoulder, elbow, four_bar)) = rigid_four_bar(kinematics, actuators)? else {
        return Ok(None);
    };
    let (psi, q_shoulder) = (command[elbow], command[shoulder]);
    let closure = four_bar.elbow(psi, q_shoulder)?;

    let (link, linkage) = (four_bar.elbow, four_bar.linkage);
    let (crank, pivot) = (four_bar.crank(psi), four_bar.pivot(q_shoulder));
    let crank_end = crank.rotation * linkage.crank.end();
    let end = closure.end;
    let upper_arm = rotation_z(q_shoulder);
    let x = upper_arm.rotation * Vector3::x();
    let y = upper_arm.rotation * (rotation_x(link.alpha).rotation * Vector3::y());
    let axis: Vector3<f64> = pivot.rotation.matrix().column(2).into_owned();
    let lever_growth = pivot.rotation * (rotation_z(closure.angle).rotation * growth(&linkage.lever));

    let still = Vector3::zeros();
    let by_end = |motion: Vector3<f64>| closure.angle_change(&motion, &still, 0.0);
    let by_anchor = |motion: Vector3<f64>| closure.angle_change(&still, &motion, 0.0);
    Ok(Some(ElbowClosure {
        elbow,
        q_elbow: closure.angle,
        transmission_angle: closure.transmission_angle,
        by_psi: by_anchor(Vector3::z().cross(&crank_end)),
        by_shoulder: by_end(Vector3::z().cross(&end)),
        by_lengths: LinkageLength::ALL.map(|length| match length {
            LinkageLength::Crank => by_anchor(crank.rotation * growth(&linkage.crank)),
            LinkageLength::Lever => by_end(lever_growth),
            LinkageLength::Rod => closure.angle_change(&still, &still, 1.0),
        }),
        by_link: LinkTerm::ALL.map(|term| match term {
            LinkTerm::A => by_end(x),
            LinkTerm::Alpha => by_end(x.cross(&end)),
            LinkTerm::Beta => by_end(y.cross(&(end - link.a * x))),
            LinkTerm::D => by_end(axis),
            // Theta and the joint turn about the same axis.
            LinkTerm::Theta => -1.0,
        }),
    }))
}

/// The indices of shoulder and elbow, and what joins them.
fn rigid_four_bar<'a>(
    kinematics: &'a KinematicModel,
    actuators: &'a ActuatorMap,
) -> Result<Option<(usize, usize, RigidFourBar<'a>)>, ClosureError> {
    let Some((shoulder, elbow, offset, linkage)) = actuators.four_bar() else {
        return Ok(None);
    };
    match kinematics.links.get(elbow) {
        Some(link) if elbow == shoulder + 1 => {
            Ok(Some((shoulder, elbow, RigidFourBar { elbow: link, linkage, offset })))
        }
        _ => Err(ClosureError::NotNeighbours { shoulder, elbow }),
    }
}

/// Writes the joint variables of `command` to `joints` (both as long as the chain): those of the rigid machine, with its real four-bar where
/// the lengths are known, else those of the [ideal map](ActuatorMap::joints_from_command).
///
/// # Errors
///
/// [`ClosureError`]; then the elbow's entry is the ideal map's.
pub fn joints_from_command(
    kinematics: &KinematicModel,
    actuators: &ActuatorMap,
    command: &[f64],
    joints: &mut [f64],
) -> Result<(), ClosureError> {
    actuators.joints_from_command(command, joints);
    if let Some((shoulder, elbow, four_bar)) = rigid_four_bar(kinematics, actuators)? {
        joints[elbow] = four_bar.elbow(command[elbow], command[shoulder])?.angle;
    }
    Ok(())
}

/// The command that takes the rigid machine, with its real four-bar where the lengths are known, to `joints`.
///
/// # Errors
///
/// [`ClosureError`], also where the command would take the machine elsewhere.
pub fn command_from_joints(
    kinematics: &KinematicModel,
    actuators: &ActuatorMap,
    joints: &[f64],
) -> Result<Vec<f64>, ClosureError> {
    let mut command = actuators.command_from_joints(joints);
    if let Some((shoulder, elbow, four_bar)) = rigid_four_bar(kinematics, actuators)? {
        command[elbow] = four_bar.psi(joints[shoulder], joints[elbow])?;
    }
    Ok(command)
}

#[cfg(test)]
mod tests;
