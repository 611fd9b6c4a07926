use nalgebra::{UnitVector3, Vector3};
use proptest::prelude::*;

use super::*;
use crate::geometry::{rotation_x, rotation_y, rotation_z, translation};
use crate::{CraigLink, VisualShape};

/// Two arms of 1 m in the x-y plane, each a cylinder of 0.1 m along x.
fn arms() -> (KinematicModel, Vec<Vec<Visual>>) {
    let links = vec![CraigLink::revolute("first"), CraigLink::revolute("second").row(1.0, 0.0, 0.0, 0.0)];
    let mut kinematics = KinematicModel::new(links).expect("a chain");
    kinematics.last_from_flange = translation(1.0, 0.0, 0.0);
    let arm = Visual {
        link_from_shape: translation(0.45, 0.0, 0.0) * rotation_y(std::f64::consts::FRAC_PI_2),
        shape: VisualShape::Cylinder { radius: 0.1, length: 0.9 },
    };
    let pedestal =
        Visual { link_from_shape: translation(0.0, 0.0, -0.5), shape: VisualShape::Box([0.4, 0.4, 0.6]) };
    (kinematics, vec![vec![pedestal], vec![arm.clone()], vec![arm]])
}

const SMR: Reflector = Reflector { in_flange: Vector3::new(0.0, 0.0, 0.0), opening: None, acceptance: 0.5 };

fn at(x: f64, y: f64, z: f64) -> Transform {
    translation(x, y, z)
}

#[test]
fn the_link_in_between_is_named() {
    let (kinematics, visuals) = arms();
    let obstacles = Obstacles::of_shapes(&kinematics, &visuals, 0.0);
    let reach = TrackerReach::all_round([0.1, 30.0]);
    let look = |from: Transform, joints: [f64; 2]| {
        obstacles.look_at_joints(&from, &reach, &kinematics, &joints, &SMR).map(|sight| sight.range)
    };
    // Stretched along x, the target at 2 m; folded back, at the first joint.
    assert_eq!(look(at(4.0, 0.0, 0.0), [0.0, 0.0]), Ok(2.0));
    let behind = look(at(-3.0, 0.0, 0.0), [0.0, 0.0]).expect_err("behind both arms");
    assert_eq!(behind.to_string(), "first hides the target from the tracker");
    // The elbow bent up: the upper arm is not in the way, the second is.
    let above = look(at(1.0, -3.0, 0.0), [0.0, std::f64::consts::FRAC_PI_2]).expect_err("below the elbow");
    assert!(matches!(above, Hidden::ByLink { ref link } if link == "first" || link == "second"), "{above}");
    let pedestal = look(at(2.0, 0.0, -1.0) * rotation_z(0.3), [std::f64::consts::PI, 0.0]);
    assert_eq!(pedestal, Err(Hidden::ByLink { link: "base".to_owned() }));
    assert!(look(at(-2.0, 0.0, 1.5), [std::f64::consts::PI, 0.0]).is_ok());
}

#[test]
fn what_a_tracker_and_a_reflector_cannot_do_is_said() {
    let (kinematics, visuals) = arms();
    let up = UnitVector3::new_normalize(Vector3::z());
    let obstacles = Obstacles::of_shapes(&kinematics, &visuals, 0.0).with_floor(up, -0.8);
    let reach = TrackerReach { range: [0.5, 10.0], elevation: [-0.5, 0.5], azimuth: [-2.0, 2.0] };
    let look = |from: Transform, reflector: Reflector| match obstacles.look_at_joints(
        &from,
        &reach,
        &kinematics,
        &[0.0, 0.0],
        &reflector,
    ) {
        Ok(sight) => format!("{:.3} {:.3} {:.3}", sight.range, sight.elevation, sight.incidence),
        Err(hidden) => hidden.to_string(),
    };
    let from = |x: f64, y: f64, z: f64| at(x, y, z) * rotation_z(std::f64::consts::PI);
    assert_eq!(look(from(14.0, 0.0, 0.0), SMR), "range 12.000 m is outside the tracker's 0.5 to 10 m");
    assert_eq!(
        look(from(4.0, 0.0, 2.0), SMR),
        "elevation -45.0 deg is outside the tracker's -28.6 to 28.6 deg"
    );
    assert_eq!(
        look(at(4.0, 0.0, 0.0), SMR),
        "azimuth 180.0 deg is outside the tracker's -114.6 to 114.6 deg"
    );
    assert_eq!(
        look(from(4.0, 0.0, -0.9), SMR),
        "the floor hides the target from the tracker: it is 100.0 mm below"
    );
    let opening = |angle: f64| {
        let direction = UnitVector3::new_normalize(Vector3::new(angle.cos(), angle.sin(), 0.0));
        Reflector { opening: Some(direction), ..SMR }
    };
    assert_eq!(look(from(4.0, 0.0, 0.0), opening(0.3)), "2.000 0.000 0.300");
    assert_eq!(
        look(from(4.0, 0.0, 0.0), opening(-0.6)),
        "the beam meets the target at 34.4 deg from the axis of its opening, more than the 28.6 deg up to which it is returned"
    );
    let few = obstacles.look_at_joints(&from(4.0, 0.0, 0.0), &reach, &kinematics, &[0.0], &SMR);
    assert_eq!(few, Err(Hidden::NoPose { found: 1, expected: 2 }));
}

#[test]
fn a_station_inside_the_robot_or_the_floor_is_found() {
    let (kinematics, visuals) = arms();
    let up = UnitVector3::new_normalize(Vector3::z());
    let shapes = Obstacles::of_shapes(&kinematics, &visuals, 0.0).with_floor(up, -0.8);
    let chain = Obstacles::of_chain(&kinematics, 0.1);
    let (links, flange) = stance_at(&kinematics, &[0.0, 0.0]);
    let stance = Stance { links: &links, flange: &flange };
    assert_eq!(shapes.holding(stance, &Vector3::new(0.1, 0.1, -0.4)), Some("base"));
    for (point, link) in
        [([1.5, 0.05, 0.0], Some("second")), ([0.5, 0.0, 0.09], Some("first")), ([0.5, 0.0, 0.11], None)]
    {
        for obstacles in [&shapes, &chain] {
            assert_eq!(obstacles.holding(stance, &Vector3::from(point)), link, "{point:?}");
        }
    }
    assert!((shapes.below_floor(&Vector3::new(0.0, 0.0, -1.0)).expect("below") - 0.2).abs() < 1e-15);
    assert_eq!(shapes.below_floor(&Vector3::zeros()), None);
    assert_eq!(chain.without_shape().collect::<Vec<_>>(), ["base", "first", "second"]);
}

#[test]
fn the_seat_of_a_reflector_hides_nothing_and_its_neighbours_do() {
    let (kinematics, mut visuals) = arms();
    let ball = Visual { link_from_shape: translation(1.0, 0.0, 0.0), shape: VisualShape::Sphere(0.02) };
    visuals[2].push(ball);
    let reach = TrackerReach::all_round([0.1, 30.0]);
    for (standoff, seen) in [(0.0, true), (0.15, true)] {
        let obstacles = Obstacles::of_shapes(&kinematics, &visuals, 0.0).with_standoff(standoff);
        let found = obstacles.look_at_joints(&at(3.0, 3.0, 0.0), &reach, &kinematics, &[0.0, 0.0], &SMR);
        assert_eq!(found.is_ok(), seen, "{standoff}");
    }
    // A beam that grazes the arm's end at 0.1 m from the target: free only where that end is the seat's.
    let graze = at(-3.0, 0.0, 0.49);
    for (standoff, seen) in [(0.0, false), (2.6, true)] {
        let obstacles = Obstacles::of_shapes(&kinematics, &visuals, 0.0).with_standoff(standoff);
        let found = obstacles.look_at_joints(&graze, &reach, &kinematics, &[0.0, 0.0], &SMR);
        assert_eq!(found.is_ok(), seen, "{standoff}: {found:?}");
    }
}

/// Whether a sampled point of the line is in the shape: slow, and by another way than slabs and nearest points.
fn meets_by_samples(shape: VisualShape, from: &Transform, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let depth = |p: Vector3<f64>| match shape {
        VisualShape::Sphere(radius) => radius - p.norm(),
        VisualShape::Box([x, y, z]) => {
            (0.5 * x - p.x.abs()).min(0.5 * y - p.y.abs()).min(0.5 * z - p.z.abs())
        }
        VisualShape::Cylinder { radius, length } => (radius - p.x.hypot(p.y)).min(0.5 * length - p.z.abs()),
    };
    (0..=4000)
        .map(|k| {
            let point = a + (b - a) * (f64::from(k) / 4000.0);
            depth(from.inverse_transform_point(&point.into()).coords)
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

fn place() -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-1.5..1.5_f64).prop_map(Vector3::from)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, ..ProptestConfig::default() })]

    #[test]
    fn lines_meet_shapes_as_their_points_do(
        a in place(), b in place(), centre in place(), angles in prop::array::uniform2(-3.0..3.0_f64),
        size in prop::array::uniform3(0.1..1.2_f64), kind in 0..3_u8
    ) {
        let shape = match kind {
            0 => VisualShape::Box(size),
            1 => VisualShape::Cylinder { radius: size[0], length: size[1] },
            _ => VisualShape::Sphere(size[0]),
        };
        let placed = at(centre.x, centre.y, centre.z) * rotation_x(angles[0]) * rotation_z(angles[1]);
        let visual = Visual { link_from_shape: placed, shape };
        let found = Placed::new(&visual, 0.0).meets(&Transform::identity(), &a, &b);
        let depth = meets_by_samples(shape, &placed, &a, &b);
        // Between samples a line of up to 5.2 m goes 0.7 mm deeper at most.
        prop_assume!(!(-1e-3..0.0).contains(&depth));
        prop_assert_eq!(found, depth >= 0.0, "depth {}", depth);
    }

    #[test]
    fn segments_are_as_far_apart_as_their_points(a in place(), b in place(), c in place(), d in place(), same in any::<bool>()) {
        let d = if same { c + (b - a) * 0.5 } else { d };
        let found = distance_of_segments([&a, &b], [&c, &d]);
        let sampled = (0..=400)
            .map(|k| distance_to_segment(&(a + (b - a) * (f64::from(k) / 400.0)), &c, &d))
            .fold(f64::INFINITY, f64::min);
        prop_assert!(found <= sampled + 1e-12 && found > sampled - 0.01, "{} {}", found, sampled);
    }

    #[test]
    fn no_pose_makes_it_panic(
        joints in prop::collection::vec(prop_oneof![Just(f64::NAN), Just(f64::INFINITY), -3.0..3.0_f64, Just(1e308)], 0..4),
        from in prop::array::uniform3(prop_oneof![Just(f64::NAN), Just(0.0), -3.0..3.0_f64, Just(1e308)])
    ) {
        let (kinematics, visuals) = arms();
        let reach = TrackerReach::all_round([0.1, 30.0]);
        for obstacles in [Obstacles::of_shapes(&kinematics, &visuals, 0.01), Obstacles::of_chain(&kinematics, 0.1)] {
            let from = at(from[0], from[1], from[2]);
            let found = obstacles.look_at_joints(&from, &reach, &kinematics, &joints, &SMR);
            let refused = matches!(found, Err(Hidden::NoPose { .. }));
            prop_assert!(joints.len() == 2 || refused);
        }
    }
}

proptest! {
    #[test]
    fn hulls_hold_their_shapes(
        centre in place(), angles in prop::array::uniform2(-3.0..3.0_f64), size in prop::array::uniform3(0.1..1.2_f64),
        part in prop::array::uniform3(-1.0..1.0_f64), kind in 0..3_u8
    ) {
        let (shape, inside) = match kind {
            0 => (VisualShape::Box(size), Vector3::from_fn(|i, _| 0.5 * part[i] * size[i])),
            1 => {
                let across = Vector3::new(part[0], part[1], 0.0);
                let across = size[0] * across / across.norm().max(1.0);
                (VisualShape::Cylinder { radius: size[0], length: size[1] }, across + Vector3::z() * (0.5 * part[2] * size[1]))
            }
            _ => (VisualShape::Sphere(size[0]), size[0] * Vector3::from(part) / Vector3::from(part).norm().max(1.0)),
        };
        let placed = at(centre.x, centre.y, centre.z) * rotation_x(angles[0]) * rotation_z(angles[1]);
        let (ends, radius) = Placed::new(&Visual { link_from_shape: placed, shape }, 0.0).capsule(&Transform::identity());
        let point = (placed * nalgebra::Point3::from(inside)).coords;
        prop_assert!(distance_to_segment(&point, &ends[0], &ends[1]) <= radius + 1e-12);
        // No larger than a ball about the shape's corner.
        let reach = (ends[0] - centre).norm() + radius;
        let corner = match shape {
            VisualShape::Box(edges) => 0.5 * Vector3::from(edges).norm(),
            VisualShape::Cylinder { radius, length } => radius + 0.5 * length,
            VisualShape::Sphere(radius) => radius,
        };
        prop_assert!(reach <= 2.0_f64.sqrt() * corner + 1e-12, "{} {}", reach, corner);
    }
}

#[test]
fn a_chain_has_hulls_along_its_links_and_below_its_first_joint() {
    let (kinematics, _) = arms();
    let (links, flange) = stance_at(&kinematics, &[0.3, -0.4]);
    let stance = Stance { links: &links, flange: &flange };
    let hulls = Obstacles::of_chain(&kinematics, 0.05).hulls(stance);
    assert_eq!(hulls.iter().map(|hull| hull.link).collect::<Vec<_>>(), [0, 1, 2]);
    assert!((hulls[2].ends[1] - flange.translation.vector).norm() < 1e-15);
    let up = Vector3::z_axis();
    assert!((hulls[2].lowest(&up) - (hulls[2].ends[0].z.min(hulls[2].ends[1].z) - 0.05)).abs() < 1e-15);
    assert!(hulls[0].distance(&hulls[1]) <= -0.1 + 1e-12, "they meet at the joint");
    assert!(Obstacles::none(&kinematics).hulls(stance).is_empty());
}
