//! Redundancy from the robot's table, without a Jacobian.

use super::DependentGroup;
use calibrig_model::{CraigLink, JointKind, KinematicModel, LinkTerm, ParameterId};

/// A nominal length (m) or angle (rad) below this counts as zero: unit conversion and URDF leave as much of a zero.
const ZERO: f64 = 1e-9;

/// The rules on neighbouring axes: the parameters kept (in table order) and the eliminated groups.
///
/// Candidates are a, alpha, d and theta of every link, and beta of every link whose axis is parallel to the one before, at a
/// distance. A rule ties a parameter of row i to the same parameter of row i - 1:
///
/// - parallel axes (alpha = 0): d; on a common axis (a = 0 as well): theta, too;
/// - row i - 1 prismatic with theta = 0: a;
/// - row i - 1 locked at theta = 0 and d = 0: a and alpha.
///
/// Half a turn counts as zero with the opposite sign. Of the parameters tied together one is kept: one that is not zero nominally, then
/// one that is not the offset of its joint's own variable, then the one farthest from the base.
///
/// Source: Y. Wang et al., Machines 11 (2023) 20, the redundancy rules; which one is kept is chosen so as to give the published set.
///
/// ```
/// use calibrig_estimation::identification::neighbour_axis_rules;
/// use calibrig_model::{CraigLink, KinematicModel};
///
/// // Parallel axes: the offsets d of the two do the same, so the rules keep one of them and add Hayati's beta.
/// let elbow = CraigLink::revolute("elbow").row(1.35, 0.0, 0.0, 0.0);
/// let (kept, groups) = neighbour_axis_rules(&KinematicModel::new(vec![CraigLink::revolute("shoulder"), elbow])?);
/// assert_eq!(groups[0].to_string(), "delta_d1 with delta_d2");
/// assert!(kept.iter().any(|id| id.to_string() == "delta_beta2"));
/// # Ok::<(), calibrig_model::ModelError>(())
/// ```
pub fn neighbour_axis_rules(model: &KinematicModel) -> (Vec<ParameterId>, Vec<DependentGroup>) {
    let links = &model.links;
    let groups: Vec<_> = LinkTerm::ALL.into_iter().flat_map(|term| groups_of(links, term)).collect();
    let kept = ParameterId::all_of_links(links.len())
        .into_iter()
        .filter(|id| is_candidate(links, *id) && !groups.iter().any(|g| g.redundant == *id))
        .collect();
    (kept, groups)
}

fn is_candidate(links: &[CraigLink], id: ParameterId) -> bool {
    match id {
        ParameterId::Link { link, term: LinkTerm::Beta } => {
            link > 0 && parallel(&links[link]).is_some() && links[link].a.abs() >= ZERO
        }
        _ => true,
    }
}

/// The cosine of an angle that is zero or half a turn.
fn aligned(angle: f64) -> Option<f64> {
    (angle.sin().abs() < ZERO).then(|| angle.cos().signum())
}

/// Whether the link's axis is parallel (1) or antiparallel (-1) to the one before.
fn parallel(link: &CraigLink) -> Option<f64> {
    aligned(link.alpha).filter(|_| link.beta.abs() < ZERO)
}

/// The sign with which `term` of `this` row has the effect of the same term of the `previous` row.
fn tie(previous: &CraigLink, this: &CraigLink, term: LinkTerm) -> Option<f64> {
    match term {
        LinkTerm::D => parallel(this),
        LinkTerm::Theta => parallel(this).filter(|_| this.a.abs() < ZERO),
        LinkTerm::A => match previous.kind {
            JointKind::Prismatic => aligned(previous.theta).filter(|_| previous.beta.abs() < ZERO),
            JointKind::Revolute => locked_at_zero(previous),
        },
        LinkTerm::Alpha => locked_at_zero(previous),
        LinkTerm::Beta => None,
    }
}

fn locked_at_zero(link: &CraigLink) -> Option<f64> {
    let [lowest, highest] = link.limits;
    if highest - lowest >= ZERO || link.beta.abs() >= ZERO {
        return None;
    }
    let (theta, d) = match link.kind {
        JointKind::Revolute => (link.theta + lowest, link.d),
        JointKind::Prismatic => (link.theta, link.d + lowest),
    };
    aligned(theta).filter(|_| d.abs() < ZERO)
}

/// The eliminated parameters of one term: every run of tied rows keeps one.
fn groups_of(links: &[CraigLink], term: LinkTerm) -> Vec<DependentGroup> {
    let mut groups = Vec::new();
    let mut run: Vec<(usize, f64)> = Vec::new();
    for (row, link) in links.iter().enumerate() {
        let sign = row.checked_sub(1).and_then(|previous| tie(&links[previous], link, term));
        match (sign, run.last()) {
            (Some(sign), Some((_, along))) => run.push((row, sign * along)),
            _ => {
                eliminate(links, term, &run, &mut groups);
                run = vec![(row, 1.0)];
            }
        }
    }
    eliminate(links, term, &run, &mut groups);
    groups
}

fn eliminate(links: &[CraigLink], term: LinkTerm, run: &[(usize, f64)], groups: &mut Vec<DependentGroup>) {
    let Some(&(kept, kept_sign)) = run.iter().max_by_key(|(row, _)| preference(&links[*row], term, *row))
    else {
        return;
    };
    groups.extend(run.iter().filter(|(row, _)| *row != kept).map(|&(row, sign)| DependentGroup {
        redundant: ParameterId::link(row, term),
        with: vec![(ParameterId::link(kept, term), sign * kept_sign)],
        singular_value: 0.0,
    }));
}

fn preference(link: &CraigLink, term: LinkTerm, row: usize) -> (bool, bool, usize) {
    let actuated = match link.kind {
        JointKind::Revolute => term == LinkTerm::Theta,
        JointKind::Prismatic => term == LinkTerm::D,
    };
    (link.term(term).abs() >= ZERO, !actuated, row)
}
