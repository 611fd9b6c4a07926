//! A rail that is neither straight nor free of twist: Legendre polynomials of the position along it.

use super::{TermFamily, TermPlace, half_travel, joint_variable, middle_of_travel, parse_joint_variable};
use crate::{CalibrationModel, JointKind, PoseQuery};

/// The rails that carry the whole robot: the prismatic joints in front of all others. A displacement along a rail is its actuator's.
///
/// A constant part is a link parameter, and so is a sideways displacement proportional to the position: it turns the rail.
pub(super) struct RailTerms;

/// By index: name of the component, the component, order of the polynomial.
const TERMS: [(&str, usize, u8); 15] = [
    ("x2", 0, 2),
    ("x3", 0, 3),
    ("x4", 0, 4),
    ("y2", 1, 2),
    ("y3", 1, 3),
    ("y4", 1, 4),
    ("rx1", 3, 1),
    ("rx2", 3, 2),
    ("rx3", 3, 3),
    ("ry1", 4, 1),
    ("ry2", 4, 2),
    ("ry3", 4, 3),
    ("rz1", 5, 1),
    ("rz2", 5, 2),
    ("rz3", 5, 3),
];

impl TermFamily for RailTerms {
    fn key(&self) -> &'static str {
        "rail"
    }

    fn about(&self) -> &'static str {
        "straightness and turning of a rail, by Legendre polynomials of the position"
    }

    fn terms(&self, model: &CalibrationModel) -> Vec<(usize, usize, bool)> {
        let links = &model.kinematics.links;
        let rails = links.iter().take_while(|link| link.kind == JointKind::Prismatic).count();
        let all =
            (0..rails).flat_map(|joint| TERMS.iter().enumerate().map(move |(i, term)| (joint, i, term.1)));
        all.map(|(joint, index, component)| (joint, index, component < 3)).collect()
    }

    fn place(&self, joint: usize, index: usize) -> TermPlace {
        TermPlace::Frame { joint, component: TERMS.get(index).map_or(0, |term| term.1) }
    }

    fn basis(&self, model: &CalibrationModel, joint: usize, index: usize, input: &PoseQuery<'_>) -> f64 {
        let (Some(position), Some((_, _, order)), Some(link)) =
            (input.command.get(joint), TERMS.get(index), model.kinematics.links.get(joint))
        else {
            return 0.0;
        };
        legendre(*order, (position - middle_of_travel(link)) / half_travel(link))
    }

    fn prior_sigma(&self, linear: bool) -> f64 {
        // Of a rail several metres long, aligned with a level: 0.5 mm and 0.3 mrad.
        if linear { 5e-4 } else { 3e-4 }
    }

    fn suffix(&self, joint: usize, index: usize, _: bool) -> String {
        format!("{}_{}", joint_variable(joint, true), TERMS.get(index).map_or("", |term| term.0))
    }

    fn parse(&self, suffix: &str) -> Option<(usize, usize, bool)> {
        let (variable, name) = suffix.split_once('_')?;
        let (joint, true) = parse_joint_variable(variable)? else { return None };
        let index = TERMS.iter().position(|term| term.0 == name)?;
        Some((joint, index, TERMS[index].1 < 3))
    }
}

/// P of that order at x, by Bonnet's recurrence.
fn legendre(order: u8, x: f64) -> f64 {
    let (mut before, mut now) = (0.0, 1.0);
    for n in 0..order {
        let n = f64::from(n);
        (before, now) = (now, ((2.0 * n + 1.0) * x * now - n * before) / (n + 1.0));
    }
    now
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_polynomials_by_hand() {
        for x in [-1.0_f64, -0.3, 0.0, 0.7, 1.0] {
            let expected = [
                1.0,
                x,
                (3.0 * x * x - 1.0) / 2.0,
                (5.0 * x.powi(3) - 3.0 * x) / 2.0,
                (35.0 * x.powi(4) - 30.0 * x * x + 3.0) / 8.0,
            ];
            for (order, expected) in (0..).zip(expected) {
                assert!((legendre(order, x) - expected).abs() < 1e-15, "P{order}({x})");
            }
        }
    }
}
