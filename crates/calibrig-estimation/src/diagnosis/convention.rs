//! A table of D-H rows read in the other convention.

use calibrig_model::KinematicModel;
use calibrig_model::geometry::{Transform, rotation_vector, rotation_x, translation};

/// The chain of the same table in the standard convention, or, for a table that was read as standard, in Craig's.
pub(super) fn other_convention(chain: &KinematicModel, standard: bool) -> Option<KinematicModel> {
    let links = &chain.links;
    if links.iter().any(|link| link.beta != 0.0) {
        return None;
    }
    let last = &chain.last_from_flange;
    let mut other = chain.clone();
    if standard {
        if *last != Transform::identity() {
            return None;
        }
        let mut behind = (0.0, 0.0);
        for link in &mut other.links {
            let own = (link.a, link.alpha);
            (link.a, link.alpha) = std::mem::replace(&mut behind, own);
        }
        other.last_from_flange = translation(behind.0, 0.0, 0.0) * rotation_x(behind.1);
    } else {
        let turn = rotation_vector(&last.rotation);
        let shift = last.translation.vector;
        let is_row = turn.yz().norm() < 1e-9 && shift.yz().norm() < 1e-12;
        if !is_row || links[0].a != 0.0 || links[0].alpha != 0.0 {
            return None;
        }
        let mut own = (shift.x, turn.x);
        for link in other.links.iter_mut().rev() {
            let behind = (link.a, link.alpha);
            (link.a, link.alpha) = std::mem::replace(&mut own, behind);
        }
        other.last_from_flange = Transform::identity();
    }
    (other != *chain).then_some(other)
}
