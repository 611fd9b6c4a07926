mod element;
mod ends;
mod frame;

use nalgebra::{Matrix6, Matrix6x3, Rotation3, Vector3, Vector6};
use proptest::prelude::*;

use super::*;
use calibrig_model::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};
use calibrig_model::{Beam, BeamError, BeamRun, Section, SegmentLength};
use ends::{end_compliance, end_stiffness, segment_groups};
use frame::{Frame, FrameError};

const TUBE: Section =
    Section { axial: 4e8, shear: [8e7, 9e7], torsion: 5e5, bending: [6e5, 7e5], mass_per_length: 20.0 };
const THICK: Section =
    Section { axial: 9e8, shear: [1.5e8, 2e8], torsion: 3e6, bending: [2.5e6, 4e6], mass_per_length: 55.0 };
const L: f64 = 1.35;

fn beam(run: BeamRun, parts: &[(f64, Section)]) -> Beam {
    let segments = parts
        .iter()
        .map(|&(length, section)| BeamSegment { length: SegmentLength::Constant(length), section })
        .collect();
    Beam { run, segments }
}

fn euler(section: Section) -> Section {
    Section { shear: [f64::INFINITY; 2], ..section }
}

#[track_caller]
fn assert_close(found: f64, expected: f64, scale: f64) {
    assert!((found - expected).abs() <= 1e-10 * scale.abs(), "{found:e} instead of {expected:e}");
}

#[track_caller]
fn assert_relative(found: f64, expected: f64) {
    assert_close(found, expected, expected);
}

/// The tip's displacement of a cantilever under a force and a moment there, and its own weight.
fn cantilever(beam: &Beam, pieces: usize, wrench: [f64; 6], gravity: [f64; 3]) -> Vector6<f64> {
    let (mut frame, root, tip) = Frame::of_beam(beam, 0.0, pieces, &gravity.into()).unwrap();
    frame.clamp(root);
    frame.add_load(tip, &wrench.into());
    let solution = frame.solve().unwrap();
    // The support carries everything.
    let weight = beam.mass(0.0) * Vector3::from(gravity);
    let held = solution.reactions[root].fixed_rows::<3>(0).into_owned();
    assert!((held + weight + Vector3::new(wrench[0], wrench[1], wrench[2])).norm() < 1e-6);
    solution.displacements[tip]
}

#[test]
fn a_cantilever_bends_as_in_the_books() {
    let load = 300.0;
    for section in [TUBE, euler(TUBE)] {
        let arm = beam(BeamRun::AlongX, &[(L, section)]);
        // Deflection along the axis, rotation, and its sign: a force along +y turns about +z, one along +z about -y.
        for (along, about, sign, shear, bending) in [
            (1, 5, 1.0, section.shear[0], section.bending[1]),
            (2, 4, -1.0, section.shear[1], section.bending[0]),
        ] {
            for pieces in [1, 5] {
                let mut wrench = [0.0; 6];
                wrench[along] = load;
                let tip = cantilever(&arm, pieces, wrench, [0.0; 3]);
                assert_relative(tip[along], load * (L.powi(3) / (3.0 * bending) + L / shear));
                assert_relative(tip[about], sign * load * L * L / (2.0 * bending));

                let mut wrench = [0.0; 6];
                wrench[about] = load;
                let tip = cantilever(&arm, pieces, wrench, [0.0; 3]);
                assert_relative(tip[along], sign * load * L * L / (2.0 * bending));
                assert_relative(tip[about], load * L / bending);

                let mut gravity = [0.0; 3];
                gravity[along] = -9.81;
                let tip = cantilever(&arm, pieces, [0.0; 6], gravity);
                let weight = -9.81 * section.mass_per_length;
                assert_relative(tip[along], weight * (L.powi(4) / (8.0 * bending) + L * L / (2.0 * shear)));
                assert_relative(tip[about], sign * weight * L.powi(3) / (6.0 * bending));
            }
        }
    }
}

#[test]
fn bars_stretch_and_twist() {
    let (l1, l2, load) = (0.5, 0.85, 700.0);
    let bar = beam(BeamRun::AlongX, &[(l1, THICK), (l2, TUBE)]);
    let tip = cantilever(&bar, 3, [load, 0.0, 0.0, 0.5 * load, 0.0, 0.0], [9.81, 0.0, 0.0]);
    let hung = 9.81
        * (THICK.mass_per_length * l1 * l1 / (2.0 * THICK.axial)
            + TUBE.mass_per_length * (l2 * l1 / THICK.axial + l2 * l2 / (2.0 * TUBE.axial)));
    assert_relative(tip[0], load * (l1 / THICK.axial + l2 / TUBE.axial) + hung);
    assert_relative(tip[3], 0.5 * load * (l1 / THICK.torsion + l2 / TUBE.torsion));
}

#[test]
fn a_beam_along_z_has_its_second_axis_along_x() {
    let load = 100.0;
    let tube = beam(BeamRun::EndsAtOrigin, &[(L, TUBE)]);
    let tip = cantilever(&tube, 2, [load, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 3]);
    assert_relative(tip[0], load * (L.powi(3) / (3.0 * TUBE.bending[1]) + L / TUBE.shear[0]));
    assert_relative(tip[4], load * L * L / (2.0 * TUBE.bending[1]));
    let tip = cantilever(&tube, 2, [0.0, load, 0.0, 0.0, 0.0, load], [0.0; 3]);
    assert_relative(tip[1], load * (L.powi(3) / (3.0 * TUBE.bending[0]) + L / TUBE.shear[1]));
    assert_relative(tip[3], -load * L * L / (2.0 * TUBE.bending[0]));
    assert_relative(tip[5], load * L / TUBE.torsion);
}

/// The integral of a polynomial up to the fifth degree: Gauss and Legendre's three points.
fn integral(from: f64, to: f64, f: impl Fn(f64) -> f64) -> f64 {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let out = 0.6_f64.sqrt() * half;
    half * (5.0 * f(middle - out) + 8.0 * f(middle) + 5.0 * f(middle + out)) / 9.0
}

/// Castigliano's second theorem, with s from the tip: the displacement is the integral of M m / EI + V v / GA.
#[test]
fn a_stepped_cantilever_follows_castigliano() {
    let (l1, l2) = (0.5, 0.85);
    let total = l1 + l2;
    let arm = beam(BeamRun::AlongX, &[(l1, THICK), (l2, TUBE)]);
    let work = |moment: &dyn Fn(f64) -> f64,
                shear: &dyn Fn(f64) -> f64,
                unit_moment: &dyn Fn(f64) -> f64,
                unit_shear: f64| {
        let part = |from: f64, to: f64, section: &Section| {
            integral(from, to, |s| {
                moment(s) * unit_moment(s) / section.bending[1] + shear(s) * unit_shear / section.shear[0]
            })
        };
        part(0.0, l2, &TUBE) + part(l2, total, &THICK)
    };
    let (w1, w2) = (9.81 * THICK.mass_per_length, 9.81 * TUBE.mass_per_length);
    let weight_shear = |s: f64| if s < l2 { w2 * s } else { w2 * l2 + w1 * (s - l2) };
    let weight_moment = |s: f64| {
        if s < l2 { 0.5 * w2 * s * s } else { w2 * l2 * (s - 0.5 * l2) + 0.5 * w1 * (s - l2).powi(2) }
    };
    let load = 250.0;
    type Along<'a> = &'a dyn Fn(f64) -> f64;
    let cases: [([f64; 6], [f64; 3], Along, Along); 3] = [
        ([0.0, load, 0.0, 0.0, 0.0, 0.0], [0.0; 3], &|s| load * s, &|_| load),
        ([0.0, 0.0, 0.0, 0.0, 0.0, load], [0.0; 3], &|_| load, &|_| 0.0),
        ([0.0; 6], [0.0, 9.81, 0.0], &weight_moment, &weight_shear),
    ];
    for (wrench, gravity, moment, shear) in cases {
        let tip = cantilever(&arm, 1, wrench, gravity);
        assert_relative(tip[1], work(moment, shear, &|s| s, 1.0));
        assert_relative(tip[5], work(moment, shear, &|_| 1.0, 0.0));
    }
}

#[test]
fn a_beam_clamped_at_both_ends_bends_as_in_the_books() {
    let (bending, shear) = (TUBE.bending[1], TUBE.shear[0]);
    let arm = beam(BeamRun::AlongX, &[(L, TUBE)]);
    let clamped = |gravity: f64, centre_load: f64| {
        let (mut frame, root, tip) = Frame::of_beam(&arm, 0.0, 4, &Vector3::new(0.0, gravity, 0.0)).unwrap();
        frame.clamp(root);
        frame.clamp(tip);
        frame.add_load(2, &Vector6::new(0.0, centre_load, 0.0, 0.0, 0.0, 0.0));
        let solution = frame.solve().unwrap();
        (solution.displacements[2][1], solution.reactions[root], solution.reactions[tip])
    };
    let w = 9.81 * TUBE.mass_per_length;
    let (middle, root, tip) = clamped(-9.81, 0.0);
    assert_relative(middle, -w * (L.powi(4) / (384.0 * bending) + L * L / (8.0 * shear)));
    assert_relative(root[1], 0.5 * w * L);
    assert_relative(root[5], w * L * L / 12.0);
    assert_relative(tip[5], -w * L * L / 12.0);
    let (middle, root, tip) = clamped(0.0, -800.0);
    assert_relative(middle, -800.0 * (L.powi(3) / (192.0 * bending) + L / (4.0 * shear)));
    assert_relative(root[1], 400.0);
    assert_relative(tip[5], -100.0 * L);
}

#[test]
fn a_propped_cantilever_leans_on_its_prop() {
    for section in [TUBE, euler(TUBE)] {
        let (bending, shear) = (section.bending[1], section.shear[0]);
        let arm = beam(BeamRun::AlongX, &[(L, section)]);
        let (mut frame, root, tip) = Frame::of_beam(&arm, 0.0, 3, &Vector3::new(0.0, -9.81, 0.0)).unwrap();
        frame.clamp(root);
        frame.fix(tip, [false, true, false, false, false, false]);
        let solution = frame.solve().unwrap();
        let w = 9.81 * section.mass_per_length;
        let prop = w * (L.powi(4) / (8.0 * bending) + L * L / (2.0 * shear))
            / (L.powi(3) / (3.0 * bending) + L / shear);
        if shear.is_infinite() {
            assert_relative(prop, 0.375 * w * L);
        }
        assert_relative(solution.reactions[tip][1], prop);
        assert_relative(solution.reactions[root][5], 0.5 * w * L * L - prop * L);
        assert_relative(
            solution.displacements[tip][5],
            prop * L * L / (2.0 * bending) - w * L.powi(3) / (6.0 * bending),
        );
    }
}

const HEIGHT: f64 = 2.0;
const SPAN: f64 = 3.0;

/// A portal with clamped feet in the plane x-z, turned by `turn`: the frame and its top nodes.
fn portal(turn: &Rotation3<f64>, column: &Section, girder: &Section) -> (Frame, usize, usize) {
    let mut frame = Frame::default();
    let nodes = [(0.0, 0.0), (0.0, HEIGHT), (SPAN, HEIGHT), (SPAN, 0.0)]
        .map(|(x, z)| frame.add_node(turn * Vector3::new(x, 0.0, z)));
    // The second axis across the portal: it bends about that one.
    let across = turn * Vector3::y();
    frame.add_element(nodes[0], nodes[1], column, &across).unwrap();
    frame.add_element(nodes[1], nodes[2], girder, &across).unwrap();
    frame.add_element(nodes[3], nodes[2], column, &across).unwrap();
    frame.clamp(nodes[0]);
    frame.clamp(nodes[3]);
    (frame, nodes[1], nodes[2])
}

/// Sway of the loaded and of the other corner under a force at one, by the force method on half a portal (cut at the girder's middle).
fn portal_sway(load: f64, column: &Section, girder: &Section) -> [f64; 2] {
    let (h, half) = (HEIGHT, 0.5 * SPAN);
    let ([ei, gi], [ga, gg]) = ([column.bending[0], girder.bending[0]], [column.shear[1], girder.shear[1]]);
    let push = h.powi(3) / (3.0 * ei) + h / ga;
    // Half of the load at either corner: only shear in the cut, whose ends do not move apart.
    let own = half.powi(3) / (3.0 * gi) + half / gg + half * half * h / ei + h / column.axial;
    let cut = 0.5 * load * h * h / (2.0 * ei) * half / own;
    let sway = 0.5 * load * push - cut * half * h * h / (2.0 * ei);
    // Half of the load towards the middle at either corner: only moment and thrust in the cut.
    let moment_per_push = h * h / (2.0 * ei) / (h / ei + half / gi);
    let soft = push - moment_per_push * h * h / (2.0 * ei);
    let squeeze = 0.5 * load * soft / (1.0 + soft * girder.axial / half);
    [sway + squeeze, sway - squeeze]
}

#[test]
fn a_portal_sways_as_by_the_force_method_in_any_attitude() {
    let load = 5e3;
    for turn in [Rotation3::identity(), Rotation3::new(Vector3::new(0.4, -1.1, 2.0))] {
        let (mut frame, near, far) = portal(&turn, &TUBE, &THICK);
        let push = turn * Vector3::new(load, 0.0, 0.0);
        frame.add_load(near, &Vector6::new(push.x, push.y, push.z, 0.0, 0.0, 0.0));
        let solution = frame.solve().unwrap();
        let expected = portal_sway(load, &TUBE, &THICK);
        for (node, expected) in [near, far].into_iter().zip(expected) {
            let moved = solution.displacements[node].fixed_rows::<3>(0).into_owned();
            let moved = turn.inverse() * moved;
            assert_relative(moved.x, expected);
            assert!(moved.y.abs() < 1e-12 * expected);
        }
        let held: Vector6<f64> = solution.reactions[0] + solution.reactions[3];
        assert!((held.fixed_rows::<3>(0) + push).norm() < 1e-9 * load);
    }
}

/// Without extension and shear: P h³ (3k + 2) / (12 EI (6k + 1)), k = (I girder / span) / (I column / h).
#[test]
fn an_inextensible_portal_sways_as_in_the_books() {
    let load = 5e3;
    let (column, girder) = (euler(TUBE), euler(THICK));
    let k = girder.bending[0] / SPAN * HEIGHT / column.bending[0];
    let sway = load * HEIGHT.powi(3) * (3.0 * k + 2.0) / (12.0 * column.bending[0] * (6.0 * k + 1.0));
    let inextensible = |section: Section| Section { axial: f64::INFINITY, ..section };
    let by_force = portal_sway(load, &inextensible(column), &inextensible(girder));
    assert_relative(by_force[0], sway);

    let (mut frame, near, far) = portal(&Rotation3::identity(), &column, &girder);
    for corner in [near, far] {
        // Columns that keep their length; with half the load at either corner the girder keeps its own.
        frame.fix(corner, [false, false, true, false, false, false]);
        frame.add_load(corner, &Vector6::new(0.5 * load, 0.0, 0.0, 0.0, 0.0, 0.0));
    }
    let solution = frame.solve().unwrap();
    assert_relative(solution.displacements[far][0], sway);
    let foot = 0.5 * load * HEIGHT * (3.0 * k + 1.0) / (6.0 * k + 1.0);
    assert_relative(solution.reactions[0][4].abs(), foot);
}

fn section() -> impl Strategy<Value = Section> {
    let stiffness = |from: f64| from..10.0 * from;
    (
        stiffness(1e8),
        [stiffness(5e7), stiffness(5e7)],
        stiffness(5e5),
        [stiffness(5e5), stiffness(5e5)],
        5.0..60.0_f64,
    )
        .prop_map(|(axial, shear, torsion, bending, mass_per_length)| Section {
            axial,
            shear,
            torsion,
            bending,
            mass_per_length,
        })
}

fn any_beam() -> impl Strategy<Value = Beam> {
    let run = prop_oneof![Just(BeamRun::AlongX), Just(BeamRun::EndsAtOrigin)];
    (run, prop::collection::vec((0.2..1.0_f64, section()), 1..4)).prop_map(|(run, parts)| beam(run, &parts))
}

/// One group's transform, as it is defined for the chain.
fn group_transform(at: &Vector3<f64>, u: &Vector6<f64>) -> Transform {
    translation(at.x, at.y, at.z)
        * translation(u[0], u[1], u[2])
        * rotation_x(u[3])
        * rotation_y(u[4])
        * rotation_z(u[5])
        * translation(-at.x, -at.y, -at.z)
}

/// Displacement of the tip by the springs and lumps themselves: every spring under what is behind it, then the product of the groups.
fn tip_by_groups(beam: &Beam, wrench: &Vector6<f64>, gravity: &Vector3<f64>) -> Vector6<f64> {
    let (groups, tip) = (segment_groups(beam, 0.0).unwrap(), beam.point(beam.length(0.0), 0.0));
    let mut product = Transform::identity();
    for (index, group) in groups.iter().enumerate() {
        let centre = beam.point(group.centre, 0.0);
        let mut force = wrench.fixed_rows::<3>(0).into_owned();
        let mut moment = wrench.fixed_rows::<3>(3) + (tip - centre).cross(&force);
        let later = groups[index + 1..].iter().flat_map(|g| g.lumps);
        for lump in later.chain([group.lumps[1]]) {
            let weight = lump.mass * gravity;
            force += weight;
            moment += (beam.point(lump.from_root, 0.0) - centre).cross(&weight);
        }
        let load = [force.x, force.y, force.z, moment.x, moment.y, moment.z];
        product *= group_transform(&centre, &Vector6::from_fn(|i, _| load[i] / group.stiffness[i]));
    }
    let shift = product.transform_point(&tip.into()).coords - tip;
    // The skew part: the rotation vector of small turns, without the rounding of a cosine near one.
    let skew = 0.5 * (product.rotation.matrix() - product.rotation.matrix().transpose());
    let turn = Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]);
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn groups_have_the_compliance_and_sag_of_the_condensed_elements(beam in any_beam(), pieces in 1..4_usize) {
        let (soft, stiff) = (end_compliance(&beam, 0.0).unwrap(), end_stiffness(&beam, 0.0, pieces).unwrap());
        // In comparable units: every entry against the geometric mean of its diagonal entries.
        let scale = soft.compliance.diagonal().map(f64::sqrt);
        let unit = Matrix6::from_diagonal(&scale);
        let product = unit.try_inverse().unwrap() * soft.compliance * stiff.stiffness * unit;
        prop_assert!((product - Matrix6::identity()).amax() < 1e-10, "{product}");
        let sag = soft.compliance * stiff.weight;
        let scaled = |m: Matrix6x3<f64>| unit.try_inverse().unwrap() * m;
        prop_assert!((scaled(sag) - scaled(soft.sag)).amax() < 1e-10 * scaled(sag).amax());
    }

    #[test]
    fn groups_displace_the_tip_as_their_transforms_do(
        beam in any_beam(),
        wrench in prop::array::uniform6(-1.0..1.0_f64),
        gravity in prop::array::uniform3(-1.0..1.0_f64),
    ) {
        let (wrench, gravity) = (Vector6::from(wrench), Vector3::from(gravity));
        let end = end_compliance(&beam, 0.0).unwrap();
        let first_order = end.compliance * wrench + end.sag * gravity;
        let product = tip_by_groups(&beam, &wrench, &gravity);
        // The product is of second order in what is at most some 0.1 mm and rounded like 1 m.
        prop_assert!((product - first_order).amax() < 1e-14 + 10.0 * first_order.amax().powi(2), "{product} {first_order}");
    }

    #[test]
    fn condensing_to_both_ends_keeps_all_that_they_do(beam in any_beam()) {
        let gravity = Vector3::new(1.0, -9.0, 4.0);
        let (mut frame, root, tip) = Frame::of_beam(&beam, 0.0, 3, &gravity).unwrap();
        let ends = frame.condense(&[root, tip]).unwrap();
        // Moving the whole link strains nothing.
        let arm = beam.point(beam.length(0.0), 0.0) - beam.point(0.0, 0.0);
        for motion in 0..6 {
            let mut xi = [0.0; 6];
            xi[motion] = 1.0;
            let (shift, turn) = (Vector3::from_column_slice(&xi[..3]), Vector3::from_column_slice(&xi[3..]));
            let there = shift + turn.cross(&arm);
            let moved: Vec<f64> = [shift, turn, there, turn].iter().flat_map(|v| v.iter().copied()).collect();
            let forces = &ends.stiffness * nalgebra::DVector::from_vec(moved);
            prop_assert!(forces.amax() < 1e-10 * ends.stiffness.amax());
        }
        // Both ends held: the supports take what the load comes to.
        frame.clamp(root);
        frame.clamp(tip);
        let held = frame.solve().unwrap();
        for (row, node) in [root, tip].into_iter().enumerate() {
            let load = ends.load.fixed_rows::<6>(6 * row);
            prop_assert!((held.reactions[node] + load).amax() < 1e-8 * load.amax());
        }
    }
}

#[test]
fn a_rigid_segment_is_a_rigid_group_and_no_element() {
    let weight = Section { mass_per_length: 40.0, ..Section::RIGID };
    let mixed = beam(BeamRun::AlongX, &[(0.5, weight), (0.85, TUBE)]);
    let groups = segment_groups(&mixed, 0.0).unwrap();
    assert_eq!(groups[0].stiffness, calibrig_model::RIGID);
    let (end, alone) = (end_compliance(&mixed, 0.0).unwrap(), beam(BeamRun::AlongX, &[(0.85, TUBE)]));
    let alone = end_compliance(&alone, 0.0).unwrap();
    assert!((end.compliance - alone.compliance).amax() < 1e-20 && (end.sag - alone.sag).amax() < 1e-16);
    assert_eq!(end_stiffness(&mixed, 0.0, 1), Err(FrameError::NotElastic));
}

#[test]
fn the_lumps_weigh_what_the_beam_does() {
    let arm = beam(BeamRun::EndsAtOrigin, &[(0.5, THICK), (0.85, TUBE)]);
    let lumps: Vec<LumpedMass> = segment_groups(&arm, 0.0).unwrap().iter().flat_map(|g| g.lumps).collect();
    let (m1, m2) = (0.5 * THICK.mass_per_length, 0.85 * TUBE.mass_per_length);
    assert_relative(lumps.iter().map(|l| l.mass).sum(), arm.mass(0.0));
    assert_relative(lumps.iter().map(|l| l.mass * l.from_root).sum(), m1 * 0.25 + m2 * (0.5 + 0.425));
}

#[test]
fn what_cannot_stand_is_refused() {
    let arm = beam(BeamRun::AlongX, &[(L, TUBE)]);
    let (mut frame, root, tip) = Frame::of_beam(&arm, 0.0, 3, &Vector3::y()).unwrap();
    assert_eq!(frame.solve(), Err(FrameError::Mechanism));
    frame.fix(root, [true, true, true, true, true, false]);
    assert_eq!(frame.solve(), Err(FrameError::Mechanism));
    assert_eq!(frame.add_element(tip, tip, &TUBE, &Vector3::y()), Err(FrameError::Degenerate));
    assert!(matches!(frame.add_element(root, tip, &TUBE, &Vector3::x()), Err(FrameError::Degenerate)));
    let soft = Section { bending: [0.0, 1.0], ..TUBE };
    assert!(matches!(frame.add_element(root, tip, &soft, &Vector3::y()), Err(FrameError::NotElastic)));

    let segments = vec![BeamSegment { length: SegmentLength::Extension(1.2), section: TUBE }];
    let telescope = Beam { run: BeamRun::EndsAtOrigin, segments };
    let housed = BeamError::Length { segment: 0, length: 0.0, q: 1.2 };
    assert_eq!(segment_groups(&telescope, 1.2), Err(housed));
    assert_eq!(end_stiffness(&telescope, 1.2, 1), Err(FrameError::Beam(housed)));
    assert!((segment_groups(&telescope, 2.0).unwrap()[0].centre - 0.4).abs() < 1e-15);
}
