//! The published facts on redundancy, and the two ways to find it compared with each other.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{DMatrix, DVector, Vector3};
use rand::{Rng, RngExt};

use super::*;
use crate::kinematics::stack as stacked_jacobian;
use calibrig_model::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CraigLink, JointKind, KinematicModel, LinkTerm};

/// The functions of this module, for valid chains.
fn complete_set(model: &KinematicModel, frame_free: bool, target_free: bool) -> IdentifiabilityReport {
    super::complete_set(model, frame_free, target_free).expect("a chain")
}

fn identifiability(
    model: &KinematicModel,
    poses: &[Vec<f64>],
    target: &Vector3<f64>,
    frame_free: bool,
    target_free: bool,
) -> IdentifiabilityReport {
    super::identifiability(model, poses, target, frame_free, target_free).expect("a chain and its poses")
}

fn explain(
    report: &IdentifiabilityReport,
    model: &KinematicModel,
    poses: &[Vec<f64>],
    target: &Vector3<f64>,
) -> Vec<Explanation> {
    super::explain(report, model, poses, target).expect("a chain and its poses")
}

const TARGET: Vector3<f64> = Vector3::new(0.10, 0.15, 0.20);
const REGION_CENTRE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
const REGION_HALF: [f64; 7] = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];
const TABLE: [LinkTerm; 4] = [LinkTerm::A, LinkTerm::Alpha, LinkTerm::D, LinkTerm::Theta];

fn rng(trial: u32) -> impl Rng {
    stream(20230, trial, StreamSource::IdentificationPoses)
}

fn link(kind: JointKind, a: f64, alpha_deg: f64, d: f64, limits: [f64; 2]) -> CraigLink {
    CraigLink {
        name: String::new(),
        kind,
        a,
        alpha: alpha_deg.to_radians(),
        beta: 0.0,
        d,
        theta: 0.0,
        limits,
    }
}

fn revolute(a: f64, alpha_deg: f64, d: f64) -> CraigLink {
    link(JointKind::Revolute, a, alpha_deg, d, [-PI, PI])
}

fn spray_robot() -> KinematicModel {
    KinematicModel {
        links: vec![
            link(JointKind::Prismatic, 0.0, 0.0, 0.0, [0.0, 4.0]),
            revolute(0.0, -90.0, 0.626),
            revolute(0.250, -90.0, 0.0),
            revolute(1.350, 0.0, 0.0),
            link(JointKind::Prismatic, 0.246, -90.0, 0.0, [1.7, 2.3]),
            revolute(0.0, 0.0, 0.0),
            revolute(0.0, 90.0, 0.0),
        ],
        base_from_first: Transform::identity(),
        last_from_flange: Transform::identity(),
    }
}

/// Universal Robots UR5, whose standard D-H table becomes Craig's by moving a and alpha one row down.
fn ur5() -> KinematicModel {
    let d = [0.089_159, 0.0, 0.0, 0.109_15, 0.094_65, 0.0823];
    let a = [0.0, 0.0, -0.425, -0.392_25, 0.0, 0.0];
    let alpha = [0.0, 90.0, 0.0, 0.0, 90.0, -90.0];
    KinematicModel {
        links: (0..6).map(|i| revolute(a[i], alpha[i], d[i])).collect(),
        base_from_first: Transform::identity(),
        last_from_flange: Transform::identity(),
    }
}

/// The published table of identified parameters: the terms of each row, without beta.
fn published() -> Vec<ParameterId> {
    use LinkTerm::{A, Alpha, Beta, D, Theta};
    let rows: [&[LinkTerm]; 7] = [
        &[Alpha, D, Theta],
        &[A, Alpha, D, Theta],
        &[A, Alpha, Theta],
        &[A, Alpha, D, Theta, Beta],
        &[A, Alpha, Theta],
        &[Alpha, D],
        &[A, Alpha, D, Theta],
    ];
    let row = |(link, terms): (usize, &&[LinkTerm])| -> Vec<_> {
        terms.iter().map(|term| ParameterId::link(link, *term)).collect()
    };
    rows.iter().enumerate().flat_map(row).collect()
}

fn names(ids: &[ParameterId]) -> Vec<String> {
    ids.iter().map(ToString::to_string).collect()
}

fn table_of(links: usize) -> Vec<ParameterId> {
    (0..links).flat_map(|link| TABLE.map(|term| ParameterId::link(link, term))).collect()
}

fn beta(number: usize) -> ParameterId {
    ParameterId::link(number - 1, LinkTerm::Beta)
}

fn with_frame(mut ids: Vec<ParameterId>) -> Vec<ParameterId> {
    ids.extend(ParameterId::all_of_frame(0));
    ids
}

fn with_frame_and_target(ids: Vec<ParameterId>) -> Vec<ParameterId> {
    let mut ids = with_frame(ids);
    ids.extend(ParameterId::all_of_target(0));
    ids
}

fn region_poses(count: usize, trial: u32) -> Vec<Vec<f64>> {
    let mut rng = rng(trial);
    (0..count)
        .map(|_| (0..7).map(|j| REGION_CENTRE[j] + REGION_HALF[j] * rng.random_range(-1.0..1.0)).collect())
        .collect()
}

fn poses_in_limits(model: &KinematicModel, count: usize, trial: u32) -> Vec<Vec<f64>> {
    let mut rng = rng(trial);
    (0..count)
        .map(|_| model.links.iter().map(|l| rng.random_range(l.limits[0]..=l.limits[1])).collect())
        .collect()
}

fn spectrum(
    model: &KinematicModel,
    poses: &[Vec<f64>],
    target: &Vector3<f64>,
    ids: &[ParameterId],
) -> Spectrum {
    analyse_columns(&stacked_jacobian(model, poses, target, ids), ids)
}

/// A generic chain: angles and lengths in general position.
fn random_robot(kinds: &[JointKind], trial: u32) -> KinematicModel {
    let mut rng = rng(trial);
    let links = kinds.iter().map(|kind| {
        let limits = match kind {
            JointKind::Revolute => [-2.5, 2.5],
            JointKind::Prismatic => [0.2, 1.5],
        };
        CraigLink {
            name: String::new(),
            kind: *kind,
            a: rng.random_range(0.1..0.6),
            alpha: rng.random_range(0.5..1.3),
            beta: 0.0,
            d: rng.random_range(0.1..0.6),
            theta: rng.random_range(0.3..1.2),
            limits,
        }
    });
    KinematicModel {
        links: links.collect(),
        base_from_first: rotation_y(0.6) * translation(0.2, -0.1, 0.3),
        last_from_flange: translation(0.05, -0.1, 0.2) * rotation_x(0.3) * rotation_y(-0.4),
    }
}

/// Chains with all the special cases of the rules, including half turns and locked joints.
fn special_robot(joints: usize, trial: u32) -> KinematicModel {
    let mut rng = rng(trial);
    let links = (0..joints).map(|_| {
        let kind = if rng.random_bool(0.4) { JointKind::Prismatic } else { JointKind::Revolute };
        let locked = rng.random_bool(0.2);
        CraigLink {
            name: String::new(),
            kind,
            a: if rng.random_bool(0.5) { 0.0 } else { rng.random_range(0.2..0.6) },
            alpha: [0.0, PI, FRAC_PI_2, 0.7][rng.random_range(0..4)],
            beta: 0.0,
            d: if rng.random_bool(0.7) { 0.0 } else { rng.random_range(0.2..0.6) },
            theta: [0.0, PI, 0.4][rng.random_range(0..3)],
            limits: if locked { [0.0, 0.0] } else { [-1.0, 1.5] },
        }
    });
    KinematicModel {
        links: links.collect(),
        base_from_first: Transform::identity(),
        last_from_flange: Transform::identity(),
    }
}

#[test]
fn the_rules_leave_the_published_set() {
    let (kept, groups) = neighbour_axis_rules(&spray_robot());
    assert_eq!(names(&kept), names(&published()));
    assert_eq!(kept.len(), 24);
    let groups: Vec<_> = groups.iter().map(ToString::to_string).collect();
    assert_eq!(
        groups,
        [
            "delta_a1 with delta_a2",
            "delta_a6 with delta_a5",
            "delta_d3 with delta_d4",
            "delta_d5 with delta_d6",
            "delta_theta6 with delta_theta5",
        ]
    );
}

#[test]
fn the_rules_keep_one_offset_of_three_parallel_axes() {
    let (kept, groups) = neighbour_axis_rules(&ur5());
    let groups: Vec<_> = groups.iter().map(ToString::to_string).collect();
    assert_eq!(groups, ["delta_d2 with delta_d4", "delta_d3 with delta_d4"]);
    assert_eq!(kept.len(), 24);
    assert!(kept.contains(&beta(3)) && kept.contains(&beta(4)));
}

/// The rules do not use a Jacobian; here each of their groups is tested on one.
#[test]
fn every_group_of_the_rules_is_an_exact_dependence_of_columns() {
    let mut tried = 0;
    for trial in 0..60 {
        let model = special_robot(2 + trial as usize % 6, trial);
        let poses = poses_in_limits(&model, 20, trial);
        let (kept, groups) = neighbour_axis_rules(&model);
        for group in &groups {
            let mut ids = vec![group.redundant];
            ids.extend(group.with.iter().map(|(id, _)| *id));
            assert!(!kept.contains(&group.redundant));
            assert!(group.with.iter().all(|(id, _)| kept.contains(id)), "{group}");
            let jacobian = stacked_jacobian(&model, &poses, &TARGET, &ids);
            let mut coefficients = vec![-1.0];
            coefficients.extend(group.with.iter().map(|(_, c)| *c));
            let left = &jacobian * DVector::from_vec(coefficients);
            assert!(left.amax() < 1e-12, "trial {trial}: {group} leaves {:e}", left.amax());
            tried += 1;
        }
    }
    assert!(tried > 100, "only {tried} groups");
}

#[test]
fn the_rank_method_finds_the_groups_of_the_rules() {
    let model = spray_robot();
    let (kept, by_rules) = neighbour_axis_rules(&model);
    let eliminated: Vec<_> = by_rules.iter().map(|g| g.redundant).collect();
    let ids = [kept.clone(), eliminated].concat();
    assert_eq!(ids.len(), 29);
    for poses in [region_poses(200, 1), poses_in_limits(&model, 200, 1)] {
        let jacobian = stacked_jacobian(&model, &poses, &TARGET, &ids);
        let (independent, by_rank) = select_independent(&jacobian, &ids);
        assert_eq!(independent, (0..24).collect::<Vec<_>>());
        assert_eq!(by_rank.len(), by_rules.len());
        for (rank, rule) in by_rank.iter().zip(&by_rules) {
            assert_eq!(rank.to_string(), rule.to_string());
            assert!((rank.with[0].1 - rule.with[0].1).abs() < 1e-9);
            assert!(rank.singular_value < 1e-13);
        }
        // The first one is kept: in reverse order the groups are the same.
        let backwards: Vec<_> = ids.iter().rev().copied().collect();
        let jacobian = stacked_jacobian(&model, &poses, &TARGET, &backwards);
        let mut turned: Vec<_> =
            select_independent(&jacobian, &backwards).1.iter().map(ToString::to_string).collect();
        turned.sort();
        assert_eq!(
            turned,
            [
                "delta_a2 with delta_a1",
                "delta_a5 with delta_a6",
                "delta_d4 with delta_d3",
                "delta_d6 with delta_d5",
                "delta_theta5 with delta_theta6",
            ]
        );
    }
}

#[test]
fn the_published_ranks_are_reproduced() {
    let model = spray_robot();
    let mut twenty_nine = table_of(7);
    twenty_nine.push(beta(4));
    let all = ParameterId::all_of_links(7);
    for poses in [region_poses(200, 2), poses_in_limits(&model, 200, 2)] {
        let rank = |ids: &[ParameterId], target: &Vector3<f64>| spectrum(&model, &poses, target, ids).rank;
        let centre = Vector3::zeros();
        assert_eq!(rank(&published(), &TARGET), 24);
        assert_eq!(rank(&published(), &centre), 20);
        assert_eq!(rank(&table_of(7), &TARGET), 23);
        assert_eq!(rank(&twenty_nine, &TARGET), 24);
        assert_eq!(rank(&twenty_nine, &centre), 20);
        assert_eq!(rank(&with_frame(published()), &TARGET), 25);
        assert_eq!(rank(&with_frame(published()), &centre), 21);
        assert_eq!(all.len(), 35);
        assert_eq!(rank(&all, &TARGET), 26);
        assert_eq!(rank(&with_frame_and_target(all.clone()), &TARGET), 27);
        for extra in [beta(1), beta(6)] {
            assert_eq!(rank(&[published(), vec![extra]].concat(), &TARGET), 25, "{extra}");
        }
        assert_eq!(rank(&[published(), vec![beta(1), beta(6)]].concat(), &TARGET), 26);
        let deficient = spectrum(&model, &poses, &TARGET, &twenty_nine);
        assert_eq!(deficient.dependent.len(), 5);
        assert!(deficient.condition.is_infinite());
    }
}

/// Values of these draws: 27 to 31 over full turns, 37 to 44 over half turns (published: about 41), 364 to 533 in the working region
/// (published: about 470).
#[test]
fn the_condition_of_the_published_set_is_as_known() {
    let model = spray_robot();
    let mut half_turn = model.clone();
    for link in half_turn.links.iter_mut().filter(|l| l.kind == JointKind::Revolute) {
        link.limits = [-FRAC_PI_2, FRAC_PI_2];
    }
    for trial in 0..20 {
        let condition = |poses: &[Vec<f64>]| spectrum(&model, poses, &TARGET, &published()).condition;
        let full = condition(&poses_in_limits(&model, 200, trial));
        let half = condition(&poses_in_limits(&half_turn, 200, trial));
        let region = condition(&region_poses(60, trial));
        assert!((20.0..36.0).contains(&full), "{full}");
        assert!((36.0..46.0).contains(&half), "{half}");
        assert!((300.0..800.0).contains(&region), "{region}");
    }
}

/// Position of the target with beta of one link before or after the joint's rotation.
fn position(model: &KinematicModel, q: &[f64], beta_after_rotation: bool) -> Vector3<f64> {
    let mut base_from_link = Transform::identity();
    for (l, q) in model.links.iter().zip(q) {
        let (theta, d) = match l.kind {
            JointKind::Revolute => (l.theta + q, l.d),
            JointKind::Prismatic => (l.theta, l.d + q),
        };
        base_from_link *= rotation_x(l.alpha) * translation(l.a, 0.0, 0.0);
        base_from_link *= if beta_after_rotation {
            rotation_z(theta) * rotation_y(l.beta)
        } else {
            rotation_y(l.beta) * rotation_z(theta)
        };
        base_from_link *= translation(0.0, 0.0, d);
    }
    base_from_link.rotation * TARGET + base_from_link.translation.vector
}

/// Fourth-order central differences: at a step of 1e-3 their error is below 1e-11.
fn differences(model: &KinematicModel, poses: &[Vec<f64>], after: bool) -> DMatrix<f64> {
    let ids = published();
    let mut jacobian = DMatrix::zeros(3 * poses.len(), ids.len());
    for (column, id) in ids.iter().enumerate() {
        let moved = |delta: f64| {
            let mut model = model.clone();
            model.add(*id, delta);
            model
        };
        let step = 1e-3;
        let models = [moved(-2.0 * step), moved(-step), moved(step), moved(2.0 * step)];
        for (row, q) in poses.iter().enumerate() {
            let [m2, m1, p1, p2] = models.each_ref().map(|m| position(m, q, after));
            let derivative = (8.0 * (p1 - m1) - (p2 - m2)) / (12.0 * step);
            jacobian.fixed_view_mut::<3, 1>(3 * row, column).copy_from(&derivative);
        }
    }
    jacobian
}

#[test]
fn beta_behind_the_joints_rotation_costs_a_rank() {
    let model = spray_robot();
    for poses in [region_poses(200, 3), poses_in_limits(&model, 200, 3)] {
        let before = differences(&model, &poses, false);
        assert_eq!(analyse_columns(&before, &published()).rank, 24);
        let analytic = stacked_jacobian(&model, &poses, &TARGET, &published());
        assert!((before - analytic).amax() < 1e-9);
        let after = analyse_columns(&differences(&model, &poses, true), &published());
        assert_eq!(after.rank, 23);
        assert_eq!(after.dependent.len(), 1);
        assert_eq!(after.dependent[0].to_string(), "delta_theta5 with delta_d4, delta_beta4");
    }
}

#[test]
fn a_chain_without_special_geometry_has_four_parameters_a_revolute_joint_and_two_a_prismatic_one() {
    use JointKind::{Prismatic as P, Revolute as R};
    let chains: [&[JointKind]; 9] = [
        &[R],
        &[P],
        &[R, P],
        &[P, P, P],
        &[R, R, R],
        &[P, R, R, R],
        &[R, R, P, R, R],
        &[R, R, R, R, R, R],
        &[P, R, R, P, R, R, R, R],
    ];
    for (trial, kinds) in (0..).zip(chains) {
        let revolute = kinds.iter().filter(|k| **k == R).count();
        let expected = 4 * revolute + 2 * (kinds.len() - revolute) + 3;
        let model = random_robot(kinds, 100 + trial);
        let all = with_frame_and_target(ParameterId::all_of_links(kinds.len()));
        let poses = poses_in_limits(&model, 200, trial);
        assert_eq!(spectrum(&model, &poses, &TARGET, &all).rank, expected, "{kinds:?}");
        let report = complete_set(&model, true, true);
        assert_eq!(report.selected.len(), expected, "{kinds:?}");
        assert_eq!(report.candidates.len(), report.selected.len() + report.dependent.len());
        let own = spectrum(&model, &poses, &TARGET, &report.selected);
        assert_eq!(own.rank, expected, "{kinds:?}");
        // Frame and target are chosen before any link parameter, and beta is not needed where no axes are parallel.
        if revolute >= 2 {
            assert!(with_frame_and_target(Vec::new()).iter().all(|id| report.selected.contains(id)));
            assert!((1..=kinds.len()).all(|n| !report.selected.contains(&beta(n))), "{kinds:?}");
        }
    }
}

#[test]
fn the_complete_set_of_a_chain_with_special_geometry_has_the_rank_of_all_candidates() {
    let target = Vector3::new(0.31, -0.23, 0.17);
    for trial in 0..80 {
        let model = special_robot(1 + trial as usize % 9, 1000 + trial);
        let report = complete_set(&model, trial % 2 == 0, trial % 3 == 0);
        let poses = poses_in_limits(&model, 150, trial);
        let all = spectrum(&model, &poses, &target, &report.candidates);
        let own = spectrum(&model, &poses, &target, &report.selected);
        assert_eq!(all.rank, report.selected.len(), "trial {trial}");
        assert_eq!(own.rank, report.selected.len(), "trial {trial}");
        assert_eq!(all.rank + all.dependent.len(), report.candidates.len(), "trial {trial}");
        assert!(own.condition < 1e4, "trial {trial}: {:e}", own.condition);
    }
}

#[test]
fn the_complete_set_of_the_spray_robot_is_the_published_one_and_two_betas() {
    let model = spray_robot();
    let report = complete_set(&model, false, false);
    let mut missing = report.selected.clone();
    missing.retain(|id| !published().contains(id));
    assert_eq!(missing, [beta(1), beta(6)]);
    assert_eq!(report.selected.len(), 26);
    assert_eq!(report.spectrum.rank, 26);
    // The frame adds nothing to the 26; the target adds one direction.
    for (frame, target, count) in [(true, false, 26), (false, true, 27), (true, true, 27)] {
        let report = complete_set(&model, frame, target);
        assert_eq!(report.selected.len(), count);
        assert_eq!(report.spectrum.rank, count);
        assert!(report.spectrum.dependent.is_empty() && report.spectrum.weak.is_empty());
        let of_base = report.selected.iter().any(|id| matches!(id, ParameterId::Link { link: 0, .. }));
        assert_eq!(of_base, !frame, "the frame takes the place of the first row");
    }
}

#[test]
fn parallel_axes_of_a_ur5_are_given_betas() {
    let model = ur5();
    let report = complete_set(&model, true, true);
    assert_eq!(report.selected.len(), 27);
    assert_eq!(report.spectrum.rank, 27);
    assert_eq!(report.selected.iter().filter(|id| matches!(id, ParameterId::Link { .. })).count(), 18);
    let betas: Vec<_> = (1..=6).map(beta).filter(|id| report.selected.contains(id)).collect();
    assert_eq!(betas, [beta(3), beta(4)]);
    // Nominal axes that deviate from parallel by a milliradian are described in the same way: one d for three axes.
    let mut nearly = model.clone();
    nearly.links[2].alpha += 1e-3;
    nearly.links[3].alpha -= 7e-4;
    let report = complete_set(&nearly, true, true);
    assert_eq!(report.selected.len(), 27);
    let betas: Vec<_> = (1..=6).map(beta).filter(|id| report.selected.contains(id)).collect();
    assert_eq!(betas, [beta(3), beta(4)]);
    let offsets = [1, 2, 3].map(|link| ParameterId::link(link, LinkTerm::D));
    assert_eq!(offsets.iter().filter(|id| report.selected.contains(id)).count(), 1);
    assert!(report.spectrum.weak.is_empty());
}

/// The joint ranges of a published UR5 data set (P. Jacobi, 2025), whose target is 0.7 mm off the last axis.
#[test]
fn a_target_close_to_the_last_axis_leaves_weak_directions_that_are_named() {
    let mut model = ur5();
    let ranges = [[-0.43, 0.99], [-1.83, -0.44], [0.53, 2.45], [-2.08, 0.52], [0.82, 2.57], [-0.51, 0.35]];
    for (link, range) in model.links.iter_mut().zip(ranges) {
        link.limits = range;
    }
    let poses = poses_in_limits(&model, 1000, 5);
    let close = Vector3::new(0.0005, -0.0005, 0.0);
    let report = identifiability(&ur5(), &poses, &close, true, true);
    let Spectrum { rank, condition, singular_values, weak, dependent } = &report.spectrum;
    assert_eq!((*rank, weak.len(), dependent.len()), (27, 2, 0));
    let largest = singular_values[0];
    assert!(singular_values[24] / largest > 5e-3);
    assert!((1e-4..1e-3).contains(&weak[0].singular_value), "{weak:?}");
    assert!((1e-6..1e-4).contains(&weak[1].singular_value), "{weak:?}");
    assert!((condition * weak[1].singular_value - 1.0).abs() < 1e-6);
    let explanations = explain(&report, &ur5(), &poses, &close);
    let weak: Vec<_> = explanations.iter().filter(|e| e.finding == Finding::Weak).collect();
    assert_eq!(weak.len(), 2);
    for direction in weak {
        let mut members: Vec<_> = direction.members.iter().map(|(id, _)| *id).collect();
        members.sort();
        assert_eq!(names(&members), ["delta_d5", "delta_theta5", "delta_a6", "delta_alpha6"]);
        assert!(direction.remedies.contains(&Remedy::OffsetTarget), "{direction}");
        assert!(direction.advice.contains("offset the target from the last axis"), "{direction}");
        assert!(!direction.remedies.contains(&Remedy::FixOne), "{direction}");
    }
    // Following the advice helps.
    let offset = close + Vector3::new(0.1, 0.1, 0.0);
    let report = identifiability(&ur5(), &poses, &offset, true, true);
    assert!(report.spectrum.weak.is_empty() && report.spectrum.rank == 27);
    // Exactly on the axis, the same four parameters are two dependent pairs.
    let on_axis = identifiability(&ur5(), &poses, &Vector3::zeros(), true, true);
    let groups: Vec<_> = on_axis.spectrum.dependent.iter().map(ToString::to_string).collect();
    assert_eq!(groups, ["delta_a6 with delta_theta5", "delta_alpha6 with delta_d5"]);
    assert_eq!(on_axis.determined().len(), 25);
}

#[test]
fn a_target_at_the_wrist_centre_is_to_be_offset_or_joined_by_others() {
    let model = spray_robot();
    let poses = region_poses(60, 6);
    let centre = Vector3::zeros();
    let report = identifiability(&model, &poses, &centre, false, false);
    assert_eq!(report.spectrum.rank, 21);
    let lost: Vec<_> = report.spectrum.dependent.iter().map(ToString::to_string).collect();
    assert_eq!(
        lost,
        ["delta_theta5", "delta_alpha6", "delta_beta6", "delta_alpha7", "delta_theta7"]
            .map(|name| format!("{name} without effect"))
    );
    for explanation in explain(&report, &model, &poses, &centre) {
        match explanation.finding {
            Finding::Measurements => {
                let mut remedies = explanation.remedies.clone();
                remedies.sort();
                assert_eq!(remedies, [Remedy::OffsetTarget, Remedy::MeasureFullPose], "{explanation}");
            }
            _ => assert_eq!(explanation.remedies, [Remedy::FixOne], "{explanation}"),
        }
    }
    // As published: with the full pose measured, here by three targets, the published set has full rank.
    let targets = [centre, Vector3::x() * 0.2, Vector3::y() * 0.2];
    let blocks = targets.map(|target| stacked_jacobian(&model, &poses, &target, &published()));
    let mut rows = DMatrix::zeros(3 * blocks[0].nrows(), 24);
    for (block, jacobian) in blocks.iter().enumerate() {
        rows.rows_mut(block * jacobian.nrows(), jacobian.nrows()).copy_from(jacobian);
    }
    assert_eq!(analyse_columns(&rows, &published()).rank, 24);
}

#[test]
fn joints_that_stand_still_call_for_other_poses_and_few_poses_for_more() {
    let model = spray_robot();
    let mut poses = region_poses(60, 7);
    for q in &mut poses {
        (q[2], q[3]) = (REGION_CENTRE[2], REGION_CENTRE[3]);
    }
    let report = identifiability(&model, &poses, &TARGET, false, false);
    assert!(report.spectrum.rank < 26);
    assert_eq!(report.determined().len(), report.spectrum.rank);
    let explanations = explain(&report, &model, &poses, &TARGET);
    let mut seen = 0;
    for explanation in explanations.iter().filter(|e| e.finding == Finding::Measurements) {
        assert!(explanation.remedies.contains(&Remedy::SpreadPoses), "{explanation}");
        assert!(!explanation.remedies.contains(&Remedy::OffsetTarget), "{explanation}");
        seen += 1;
    }
    assert_eq!(seen, 26 - report.spectrum.rank);
    let few = &poses[..5];
    let report = identifiability(&model, few, &TARGET, false, false);
    let explanations = explain(&report, &model, few, &TARGET);
    let mut remedies =
        explanations.iter().filter(|e| e.finding == Finding::Measurements).map(|e| &e.remedies);
    assert!(remedies.all(|r| *r == [Remedy::MeasureMorePoses]));
}

#[test]
fn what_the_structure_hides_is_explained() {
    let text = |explanations: &[Explanation], redundant: ParameterId| -> (Vec<Remedy>, String) {
        let found = explanations.iter().find(|e| e.members[0].0 == redundant).expect("a group of its own");
        (found.remedies.clone(), found.to_string())
    };
    let report = complete_set(&spray_robot(), false, false);
    let explanations = explain(&report, &spray_robot(), &[], &TARGET);
    assert_eq!(explanations.len(), 35 - 26);
    let (remedies, words) = text(&explanations, ParameterId::link(2, LinkTerm::D));
    assert_eq!(remedies, [Remedy::FixOne]);
    assert!(words.starts_with("delta_d3 with delta_d4 ("), "{words}");
    assert!(words.ends_with("fix one of them: only their sum moves the target"), "{words}");
    let report = complete_set(&ur5(), true, true);
    let explanations = explain(&report, &ur5(), &[], &TARGET);
    let (remedies, words) = text(&explanations, ParameterId::link(0, LinkTerm::Theta));
    assert_eq!(remedies, [Remedy::MeasureFrame, Remedy::FixOne]);
    assert!(words.starts_with("delta_theta1 with frame_rz ("), "{words}");
    let (remedies, words) = text(&explanations, ParameterId::link(5, LinkTerm::Theta));
    assert_eq!(remedies, [Remedy::MeasureTarget, Remedy::FixOne]);
    assert!(words.contains("measure the target's offset"), "{words}");
}

#[test]
fn structural_poses_fill_the_limits_and_pass_locked_and_endless_joints() {
    let mut model = spray_robot();
    model.links[1].limits = [0.3, 0.3];
    model.links[2].limits = [f64::NEG_INFINITY, f64::INFINITY];
    let poses = structural_poses(&model, 64);
    assert_eq!(poses, structural_poses(&model, 64));
    for (joint, [lowest, highest]) in [(0, [0.0, 4.0]), (1, [0.3, 0.3]), (2, [-PI, PI]), (4, [1.7, 2.3])] {
        let of_joint = || poses.iter().map(|q| q[joint]);
        assert!(of_joint().all(|q| (lowest..=highest).contains(&q)), "joint {joint}");
        // An even distribution leaves no eighth of the range empty.
        let eighth = (highest - lowest) / 8.0;
        for part in 0..8 {
            let from = lowest + f64::from(part) * eighth;
            assert!(of_joint().any(|q| q >= from && q <= from + eighth), "joint {joint}, part {part}");
        }
    }
}
