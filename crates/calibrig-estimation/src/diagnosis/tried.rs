//! The parts with which a session is tried.

use std::f64::consts::PI;

use super::convention::other_convention;
use super::part::{Part, moved};
use super::session::Session;
use calibrig_model::{ActuatorMap, JointKind};

/// Ratios of units of length.
pub(super) const LENGTHS: [f64; 10] = [1e3, 1e-3, 1e6, 1e-6, 10.0, 0.1, 100.0, 0.01, 25.4, 1.0 / 25.4];
/// Largest shift of rows that is considered.
const SHIFTS: i64 = 5;

/// Every part that changes how all rows are read, except those that a placement determines itself (mirror image and unit of the points).
pub(super) fn structural(session: &Session<'_>) -> Vec<Part> {
    let links = &session.model.kinematics.links;
    // Joints that follow others have no column.
    let commanded: Vec<usize> =
        (0..links.len()).filter(|i| session.model.actuators.is_commanded(*i)).collect();
    let n = links.len();
    let kind = |joint: usize| links[joint].kind;
    let of_kind = |wanted| commanded.iter().copied().filter(|i| kind(*i) == wanted).collect::<Vec<_>>();
    let (revolute, prismatic) = (of_kind(JointKind::Revolute), of_kind(JointKind::Prismatic));
    let largest =
        |joint: usize| session.kept.iter().map(|i| session.commands[*i][joint].abs()).fold(0.0, f64::max);
    let mut parts = Vec::new();
    angle_units(&revolute, largest, &mut parts);
    if !prismatic.is_empty() {
        let unit = |factor| Part::TravelUnit { joints: prismatic.clone(), factor };
        parts.extend(LENGTHS.map(unit));
    }
    parts.extend(commanded.iter().map(|joint| Part::Sign { joint: *joint }));
    // A rotation about the first axis is absorbed by the tracker's place if no nests determine it, one about the last by an unknown target.
    let known = session.offset_sigma.iter().all(Option::is_some);
    let placed = session.nests.iter().all(|nests| !nests.is_empty());
    for &joint in revolute.iter().filter(|joint| (**joint > 0 || placed) && (**joint + 1 < n || known)) {
        parts.extend([1, -1, 2].map(|quarters| Part::Offset { joint, quarters }));
    }
    orders(&commanded, kind, &mut parts);
    for &joint in &revolute {
        for &with in revolute.iter().filter(|with| **with != joint) {
            parts.extend([-1.0, 1.0].map(|share| Part::Coupling { joint, with, share, of_joint: false }));
            if is_coupled(&session.model.actuators, with, links.len()) {
                parts.extend([-1.0, 1.0].map(|share| Part::Coupling { joint, with, share, of_joint: true }));
            }
        }
    }
    for standard in [true, false] {
        if other_convention(&session.model.kinematics, standard).is_some() {
            parts.push(Part::Convention { standard });
        }
    }
    parts.extend((0..n.saturating_sub(1)).map(|joint| Part::ToolLink { joint }));
    parts.extend((1..=SHIFTS).flat_map(|by| [Part::ShiftedRows { by }, Part::ShiftedRows { by: -by }]));
    parts.push(Part::ZenithElevation { turned: false });
    if !session.has_angles() {
        parts.push(Part::ZenithElevation { turned: true });
    }
    parts.extend([false, true].map(|zenith| Part::AnglesExchanged { zenith }));
    for zenith in [false, true] {
        parts.push(Part::TrackerAngleUnit { factor: 1.0_f64.to_degrees(), zenith });
        if session.has_angles() {
            parts.push(Part::TrackerAngleUnit { factor: 1.0_f64.to_radians(), zenith });
        }
    }
    parts
}

fn angle_units(revolute: &[usize], largest: impl Fn(usize) -> f64, parts: &mut Vec<Part>) {
    let (degree, radian) = (1.0_f64.to_degrees(), 1.0_f64.to_radians());
    // Two whole turns in radians taken for degrees, or the smallest travel in degrees taken for radians.
    let is_small = |joint: usize| largest(joint) < (4.0 * PI).to_radians();
    let is_large = |joint: usize| largest(joint) > 2.0;
    let all = |factor| Part::AngleUnit { joints: revolute.to_vec(), factor };
    if !revolute.is_empty() && revolute.iter().all(|joint| is_small(*joint)) {
        parts.push(all(degree));
    }
    if revolute.iter().any(|joint| is_large(*joint)) {
        parts.push(all(radian));
    }
    if revolute.len() < 2 {
        return;
    }
    for &joint in revolute {
        let one = |factor| Part::AngleUnit { joints: vec![joint], factor };
        parts.extend(is_small(joint).then(|| one(degree)));
        parts.extend(is_large(joint).then(|| one(radian)));
    }
}

/// Two columns exchanged, one column moved elsewhere, and all reversed, for the joints that have a column.
fn orders(commanded: &[usize], kind: impl Fn(usize) -> JointKind, parts: &mut Vec<Part>) {
    let n = commanded.len();
    let all = commanded.last().map_or(0, |last| last + 1);
    let mut orders: Vec<Vec<usize>> = Vec::new();
    let mut add = |order: &[usize]| {
        let mut from: Vec<usize> = (0..all).collect();
        for (joint, column) in commanded.iter().zip(order) {
            from[*joint] = commanded[*column];
        }
        if !orders.contains(&from) && moved(&from) > 0 {
            orders.push(from);
        }
    };
    for i in 0..n {
        for j in i + 1..n {
            let mut order: Vec<usize> = (0..n).collect();
            order.swap(i, j);
            add(&order);
        }
    }
    for i in 0..n {
        for j in 0..n {
            let mut order: Vec<usize> = (0..n).collect();
            let column = order.remove(i);
            order.insert(j, column);
            add(&order);
        }
    }
    add(&(0..n).rev().collect::<Vec<_>>());
    for from in orders {
        let is_mixed = (0..all).any(|joint| kind(joint) != kind(from[joint]));
        // Columns in SI, or an angle in degrees that was read as millimetres, and vice versa.
        let of_columns: &[f64] = if is_mixed { &[1.0, 1e3_f64.to_radians()] } else { &[1.0] };
        for &size in of_columns {
            let factor = |joint: usize| match (kind(joint), kind(from[joint])) {
                (JointKind::Revolute, JointKind::Prismatic) => size,
                (JointKind::Prismatic, JointKind::Revolute) => 1.0 / size,
                _ => 1.0,
            };
            let factors = (0..all).map(factor).collect();
            parts.push(Part::Order { from: from.clone(), factors });
        }
    }
}

/// Whether commands of other joints move this one as well.
fn is_coupled(actuators: &ActuatorMap, joint: usize, joints: usize) -> bool {
    (0..joints).any(|other| other != joint && actuators.rate(joint, other) != 0.0)
}
