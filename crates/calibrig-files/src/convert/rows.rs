//! From lines in space to the rows of a table: Craig's where axes cross, Hayati's where they are nearly parallel.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Rotation3, Unit, Vector3};

use super::chain::Chain;
use calibrig_model::geometry::{Transform, rotation_z, translation};
use calibrig_model::{CraigLink, JointKind, KinematicModel};

/// Axes that enclose less are nearly parallel, rad: their common normal may be anywhere.
const NEARLY_PARALLEL: f64 = 0.05;

/// Lengths (m) and angles (rad) below this are rounding.
const ROUNDING: f64 = 1e-13;

/// From a joint's axis to the next one, in the terms of a table.
#[derive(Debug, Clone, Copy)]
struct Step {
    /// Theta and d of the row of the axis that is left.
    theta: f64,
    d: f64,
    /// a, alpha and beta of the row of the axis that is reached.
    a: f64,
    alpha: f64,
    beta: f64,
}

impl Step {
    fn transform(&self) -> Transform {
        rotation_z(self.theta)
            * translation(0.0, 0.0, self.d)
            * CraigLink::revolute("").row(self.a, self.alpha, 0.0, 0.0).with_beta(self.beta).fixed_part()
    }
}

/// The way from the z axis to the line through `point` along `direction`.
fn step(point: &Vector3<f64>, direction: &Unit<Vector3<f64>>) -> Step {
    let u = direction.into_inner();
    let (theta, d, met) = if u.z.abs() > NEARLY_PARALLEL.cos() {
        // Where the line meets the plane of x and y.
        let met = point - u * (point.z / u.z);
        (plane_angle(met.x, met.y), 0.0, met)
    } else {
        // Along the common normal z × u.
        let across = 1.0 - u.z * u.z;
        let along = (u.z * point.z - point.dot(&u)) / across;
        let met = point + u * along;
        // The line's nearest point is off the z axis along the normal.
        let theta = within_a_quarter((-u.y).hypot(u.x), u.x.atan2(-u.y));
        (theta, met.z, met)
    };
    let towards: Rotation3<f64> = rotation_z(-theta).rotation;
    let (a, u) = ((towards * met).x, towards * u);
    // Rx(alpha) Ry(beta) turns z there. Without the zero, a half turn could come out with either sign.
    let alpha = (0.0 - u.y).atan2(u.z);
    let beta = if u.z.abs() > NEARLY_PARALLEL.cos() { u.x.clamp(-1.0, 1.0).asin() } else { 0.0 };
    let clean = |value: f64| if value.abs() < ROUNDING { 0.0 } else { value };
    let [theta, d, a, alpha, beta] = [theta, d, a, alpha, beta].map(clean);
    Step { theta, d, a, alpha, beta }
}

/// The direction of a point in the plane as an angle within a quarter turn: its length may be negative.
fn plane_angle(x: f64, y: f64) -> f64 {
    within_a_quarter(x.hypot(y), y.atan2(x))
}

fn within_a_quarter(length: f64, angle: f64) -> f64 {
    if length < ROUNDING {
        0.0
    } else if angle > FRAC_PI_2 + ROUNDING {
        angle - 2.0 * FRAC_PI_2
    } else if angle <= -FRAC_PI_2 + ROUNDING {
        angle + 2.0 * FRAC_PI_2
    } else {
        angle
    }
}

/// The table of a chain, and the frames of its links at zero in the base. Every joint variable is that of the chain: the offset between its
/// zero and the table's is in theta or d.
pub(super) fn table(chain: &Chain, limits: &[[f64; 2]]) -> (KinematicModel, Vec<Transform>) {
    let mut at = Transform::identity();
    // The frame on the present axis after a, alpha and beta of its row; at first the base.
    let mut frame = Transform::identity();
    let mut base_from_first = Transform::identity();
    let mut links: Vec<CraigLink> = Vec::new();
    for (joint, limits) in chain.joints.iter().zip(limits) {
        at *= joint.previous_from_joint;
        let into = frame.inverse() * at;
        let direction = Unit::new_normalize(into.rotation * joint.axis.into_inner());
        let point = match joint.kind {
            JointKind::Revolute => into.translation.vector,
            // For a sliding joint only the direction matters: through the origin, it needs no lengths.
            JointKind::Prismatic => Vector3::zeros(),
        };
        let step = step(&point, &direction);
        match links.last_mut() {
            Some(before) => (before.theta, before.d) = (step.theta, step.d),
            None => base_from_first = rotation_z(step.theta) * translation(0.0, 0.0, step.d),
        }
        frame *= step.transform();
        let link = match joint.kind {
            JointKind::Revolute => CraigLink::revolute(&joint.name),
            JointKind::Prismatic => CraigLink::prismatic(&joint.name),
        };
        let link = link.row(step.a, step.alpha, 0.0, 0.0).with_beta(step.beta).limits(limits[0], limits[1]);
        links.push(link);
    }
    let into = frame.inverse() * at * chain.last_from_tip;
    let last_from_flange = links.last_mut().map_or(into, |last| end(last, &into));
    let model = KinematicModel { links, base_from_first, last_from_flange };
    let mut base_from_link = base_from_first;
    let frames = model.links.iter().map(|link| {
        base_from_link *= link.transform(0.0);
        base_from_link
    });
    let frames = frames.collect();
    (model, frames)
}

/// Theta and d of the last row, and the transform from its frame to the tip.
fn end(last: &mut CraigLink, into: &Transform) -> Transform {
    let (place, turn) = (into.translation.vector, into.rotation.matrix());
    let on_axis = place.xy().norm() < ROUNDING && turn.column(2).xy().norm() < ROUNDING && turn.m33 > 0.0;
    if on_axis {
        (last.theta, last.d) = (turn.m21.atan2(turn.m11), place.z);
        return Transform::identity();
    }
    last.d = place.z;
    translation(0.0, 0.0, -place.z) * into
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource as Stream, stream};
    use rand::RngExt;

    /// The step's frame has its z axis on the line, and the line's own direction.
    #[test]
    fn a_step_ends_on_the_line() {
        let mut random = stream(7, 0, Stream::AsBuilt);
        for trial in 0..2000 {
            let mut vector = |size: f64| Vector3::from_fn(|_, _| random.random_range(-size..size));
            let point = vector(2.0);
            let direction = match trial % 4 {
                0 => vector(1.0),
                1 => Vector3::z() + vector(1e-6),
                2 => -Vector3::z() + vector(0.02),
                _ => [Vector3::x(), -Vector3::y(), Vector3::z(), -Vector3::z()][trial / 4 % 4],
            };
            let direction = Unit::new_normalize(direction);
            let step = step(&point, &direction);
            let frame = step.transform();
            let axis = frame.rotation * Vector3::z();
            assert!((axis - direction.into_inner()).norm() < 1e-12, "{step:?}");
            let off = (frame.translation.vector - point).cross(&axis);
            assert!(off.norm() < 1e-12, "{step:?} {off}");
            assert!(step.theta > -FRAC_PI_2 - 1e-12 && step.theta <= FRAC_PI_2 + 1e-12, "{step:?}");
            assert!(step.d.abs() < 50.0 && step.a.abs() < 5.0, "{step:?}");
        }
    }
}
