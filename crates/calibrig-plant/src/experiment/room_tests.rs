use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{UnitVector3, Vector3};
use rand::RngExt;

use super::{Stand, WorkingRegion, clear_region, usable_ranges};
use calibrig_model::geometry::translation;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::visibility::{Obstacles, Room, TrackerReach};
use calibrig_model::{ActuatorMap, CraigLink, KinematicModel};

const RADIUS: f64 = 0.06;

/// A waist at 0.4 m, an upper arm of 0.5 m, a forearm of 0.4 m and a hand of 0.2 m, all in one plane above the waist's axis.
fn arm() -> KinematicModel {
    let links = vec![
        CraigLink::revolute("waist").row(0.0, 0.0, 0.4, 0.0).limits(-PI, PI),
        CraigLink::revolute("shoulder").row(0.0, -FRAC_PI_2, 0.0, 0.0).limits(-3.0, 3.0),
        CraigLink::revolute("elbow").row(0.5, 0.0, 0.0, 0.0).limits(-2.8, 2.8),
        CraigLink::revolute("wrist").row(0.4, 0.0, 0.0, 0.0).limits(-2.8, 2.8),
    ];
    let mut kinematics = KinematicModel::new(links).expect("a chain");
    kinematics.last_from_flange = translation(0.2, 0.0, 0.0);
    kinematics
}

/// Points along the chain by plane geometry alone: (distance from the waist's axis, height), from the base to the hand's end.
fn in_plane(joints: &[f64]) -> Vec<[f64; 2]> {
    let mut at = [0.0, 0.4];
    let mut points = vec![[0.0, 0.0], at];
    let mut angle = 0.0;
    for (turn, length) in joints[1..].iter().zip([0.5, 0.4, 0.2]) {
        angle += turn;
        // The shoulder turns about the level axis so that positive angles go down.
        at = [at[0] + length * angle.cos(), at[1] - length * angle.sin()];
        points.push(at);
    }
    points
}

fn scene(kinematics: &KinematicModel) -> (Obstacles, [(UnitVector3<f64>, f64); 1]) {
    (Obstacles::of_chain(kinematics, RADIUS), [(Vector3::z_axis(), 0.0)])
}

#[test]
fn no_pose_of_the_found_box_touches_floor_or_column_by_plane_geometry() {
    let kinematics = arm();
    let (obstacles, planes) = scene(&kinematics);
    let actuators = ActuatorMap::Direct;
    let target = Vector3::new(0.05, 0.03, 0.0);
    let room = Room {
        kinematics: &kinematics,
        actuators: &actuators,
        obstacles: &obstacles,
        target,
        planes: &planes,
    };
    let ranges = usable_ranges(&kinematics, 2.9, 1.0);
    assert!(ranges.iter().zip(&kinematics.links).all(|(r, l)| r[0] > l.limits[0] && r[1] < l.limits[1]));
    let mut rng = stream(3, 0, StreamSource::IdentificationPoses);
    let drawn = |rng: &mut rand_chacha::ChaCha8Rng| -> Vec<f64> {
        ranges.iter().map(|[low, high]| rng.random_range(*low..*high)).collect()
    };
    let poses: Vec<_> = (0..300).map(|_| drawn(&mut rng)).collect();
    let built = room.survey(&poses);
    let starts: Vec<_> = poses.iter().filter(|pose| room.is_clear(pose, &built)).take(12).cloned().collect();
    let region = clear_region(&room, &ranges, &starts, &built, &mut rng).expect("a box");
    assert!(region.half_width.iter().all(|half| *half > 0.1), "{region:?}");

    let (mut least_height, mut least_column) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..5000 {
        let points = in_plane(&region.draw(&mut rng));
        // The wrist and the hand's end keep the radius of the links above the floor.
        for [_, height] in &points[3..] {
            least_height = least_height.min(*height);
        }
        // The hand stays off the column below the shoulder.
        let [across, height] = points[4];
        if (0.0..0.4).contains(&height) {
            least_column = least_column.min(across.abs());
        }
    }
    assert!(least_height > RADIUS && least_column > RADIUS, "{least_height} {least_column}");
}

#[test]
fn what_touches_by_the_way_it_is_built_is_told_apart() {
    let kinematics = arm();
    let (obstacles, planes) = scene(&kinematics);
    let actuators = ActuatorMap::Direct;
    let target = Vector3::new(0.05, 0.03, 0.0);
    let room = Room {
        kinematics: &kinematics,
        actuators: &actuators,
        obstacles: &obstacles,
        target,
        planes: &planes,
    };
    let mut rng = stream(4, 0, StreamSource::IdentificationPoses);
    let poses: Vec<Vec<f64>> =
        (0..400).map(|_| (0..4).map(|_| rng.random_range(-2.7..2.7)).collect()).collect();
    let built = room.survey(&poses);
    // The column stands on the floor and carries the shoulder, whose waist has no length.
    assert!(built.below.contains(&[0, 0]) && built.pairs.contains(&[0, 2]), "{built:?}");
    assert!(!built.below.iter().any(|[link, _]| *link > 2) && !built.pairs.contains(&[0, 4]), "{built:?}");
    assert!(!room.is_clear(&[0.0, 1.4, 0.0, 0.0], &built), "the arm points into the floor");
    assert!(room.is_clear(&[0.0, -1.0, 0.3, 0.3], &built));
}

#[test]
fn the_tracker_stands_off_the_robot_where_it_sees_and_ends_that_it_does_not_see_are_trimmed() {
    let kinematics = arm();
    let (obstacles, planes) = scene(&kinematics);
    let actuators = ActuatorMap::Direct;
    let target = Vector3::new(0.05, 0.03, 0.0);
    let room = Room {
        kinematics: &kinematics,
        actuators: &actuators,
        obstacles: &obstacles,
        target,
        planes: &planes,
    };
    let stand = Stand {
        room,
        reach: TrackerReach::all_round([0.5, 20.0]),
        up: Vector3::z_axis(),
        floor: 0.0,
        keep_off: 1.6,
        robot: Vector3::zeros(),
    };
    let region = WorkingRegion { centre: vec![0.0, -0.8, 1.3, 0.3], half_width: vec![1.2, 0.4, 0.4, 0.5] };
    let mut rng = stream(5, 0, StreamSource::IdentificationPoses);
    let poses: Vec<_> = (0..300).map(|_| region.draw(&mut rng)).collect();
    let best = stand.best(&poses).expect("a place");
    assert!(best.position.xy().norm() >= 1.59 && best.position.z >= 0.3 && best.seen > 0.9, "{best:?}");

    // One that turns its head by 0.3 rad alone, 2 m in front: it sees targets at 0.84 m within about 0.4 rad of the waist's middle.
    let narrow = TrackerReach { azimuth: [-0.3, 0.3], ..stand.reach };
    let stand = Stand { reach: narrow, ..stand };
    let place = stand.seen_from(Vector3::new(2.0, 0.0, 0.4), PI, &poses);
    assert!(place.seen > 0.15 && place.seen < 0.7, "{place:?}");
    let (smaller, at_last) = stand.trimmed(&region, &place, 0.97, &mut rng);
    assert!(at_last.seen >= 0.93, "{at_last:?}");
    assert!(smaller.half_width[0] < 0.6 && smaller.half_width[0] > 0.25, "{smaller:?}");
    for joint in 0..4 {
        let old = [
            region.centre[joint] - region.half_width[joint],
            region.centre[joint] + region.half_width[joint],
        ];
        let new = [
            smaller.centre[joint] - smaller.half_width[joint],
            smaller.centre[joint] + smaller.half_width[joint],
        ];
        assert!(new[0] >= old[0] - 1e-9 && new[1] <= old[1] + 1e-9, "{joint}");
    }
    let ring: Vec<_> = (0..12)
        .map(|k| f64::from(k) * PI / 6.0)
        .flat_map(|a| [0.1, 0.4].map(|height| Vector3::new(0.9 * a.cos(), 0.9 * a.sin(), height)))
        .collect();
    let stand = Stand { reach: TrackerReach::all_round([0.5, 20.0]), ..stand };
    let nests = stand.nests(&best, &poses[..3], &ring, 6);
    assert!(nests.len() >= 4 && nests.len() <= 6, "{}", nests.len());
    let least = nests.iter().flat_map(|a| nests.iter().map(move |b| (a - b).norm()));
    assert!(least.filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min) > 0.25);
}
