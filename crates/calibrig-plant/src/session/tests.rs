use std::ops::ControlFlow;

use nalgebra::{Matrix3, UnitVector3, Vector3};

use super::*;
use crate::effects::{Ambient, DriveHeat, Effects, GrowingPart, Growth, MOST_RISE, Thermal};
use crate::experiment::WorkingRegion;
use crate::tracker::{DriftLaw, ErrorLine, Instrument, LaserTracker, Motion, SmrLaw};
use calibrig_model::geometry::translation;
use calibrig_model::measurement::Face;
use calibrig_model::visibility::{Obstacles, stance_at};
use calibrig_model::{ActuatorMap, Body, CraigLink, KinematicModel, StaticProperties, Visual, VisualShape};

/// A slide along z that carries an arm of 1 m, which turns in the x-y plane: nothing of it yields.
fn machine() -> AsBuilt {
    let links =
        vec![CraigLink::prismatic("slide").limits(0.0, 1.0), CraigLink::revolute("arm").limits(-3.0, 3.0)];
    let mut kinematics = KinematicModel::new(links).expect("a chain");
    kinematics.last_from_flange = translation(1.0, 0.0, 0.0);
    let body = Body { mass: 1.0, centre_of_mass: Vector3::zeros(), inertia: Matrix3::identity() };
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    AsBuilt {
        kinematics,
        actuators: ActuatorMap::Direct,
        statics: StaticProperties::of_drives(vec![body.clone(), body], vec![1e9, 1e9], gravity),
        target: Vector3::new(0.0, 0.0, 0.1),
        effects: Effects::default(),
    }
}

/// The machine where its commands say, by the product of its links.
struct Exact(AsBuilt);

impl Machine for Exact {
    type Error = PlantError;

    fn settle(&mut self, motors: &[f64], _: &[[f64; 6]]) -> Result<SettledPose, PlantError> {
        let (links, flange) = stance_at(&self.0.kinematics, motors);
        Ok(SettledPose {
            target: flange.rotation * self.0.target + flange.translation.vector,
            links,
            deflection: vec![0.0; 2],
            elastic: Vec::new(),
            linkage: None,
            rod_force: None,
            residual: 0.0,
            closure: 0.0,
            steps: 0,
        })
    }

    fn carry(&mut self, _: Option<&Payload>) -> Result<(), PlantError> {
        Ok(())
    }
}

struct Scene {
    machine: AsBuilt,
    region: WorkingRegion,
    tracker: LaserTracker,
    nests: Vec<(String, Vector3<f64>)>,
    plan: SessionPlan,
}

fn scene(plan: SessionPlan) -> Scene {
    let line = |offset| ErrorLine { offset, per_metre: 0.0 };
    let instrument = Instrument::of_noise(line(15e-6), line(10e-6), 0.125);
    let place = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
    let nests = [place(0.5, -1.0, 0.0), place(0.5, 1.0, 0.0), place(-0.5, 1.0, 1.0), place(-0.5, -1.0, 1.0)];
    Scene {
        machine: machine(),
        region: WorkingRegion { centre: vec![0.5, 0.0], half_width: vec![0.4, 1.5] },
        tracker: LaserTracker::levelled(instrument, place(4.0, 0.0, 0.5), 3.0, &Vector3::z()),
        nests: nests.iter().enumerate().map(|(i, nest)| (format!("N{i}"), *nest)).collect(),
        plan,
    }
}

fn measure(scene: &Scene, poses: [u32; 2]) -> Simulation {
    let session = MeasuringSession {
        as_built: &scene.machine,
        actuators: &scene.machine.actuators,
        region: &scene.region,
        listed: [None; 2],
        identification_poses: poses[0],
        verification_poses: poses[1],
        tracker: &scene.tracker,
        outliers: None,
        nests: &scene.nests,
        nest_sigma: 1e-5,
        target_covariance: &(Matrix3::identity() * 1e-10),
        probe: None,
        plan: &scene.plan,
    };
    let mut events = 0;
    let told = session.measure(&mut Exact(scene.machine.clone()), 5, 0, &mut |_| {
        events += 1;
        ControlFlow::Continue(())
    });
    // Begin, and per set its own two and one a pose.
    assert_eq!(events, 1 + poses.iter().filter(|p| **p > 0).map(|p| 2 + p).sum::<u32>());
    told.expect("a session")
}

fn timed(rounds: NestRounds) -> SessionPlan {
    SessionPlan {
        timing: Timing { warm_up: 100.0, nest: 3.0, ..Timing::default() },
        rounds: NestRounds { timed: true, ..rounds },
        ..SessionPlan::default()
    }
}

#[test]
fn the_plainest_session_reads_one_target_once_every_ten_seconds() {
    let told = measure(&scene(SessionPlan::default()), [4, 2]);
    let times: Vec<_> = told.sets.iter().flat_map(|s| &s.measurements.observations).map(|o| o.time).collect();
    assert_eq!(times, [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]);
    let station = &told.sets[1].measurements.stations[0];
    assert_eq!((station.nests.len(), station.nests[0].time, station.instrument.is_none()), (4, None, true));
}

/// The slide's motions heat the arm, 500 J a metre at 0.2 K/W and 60 s; nothing else does.
fn heated(mut scene: Scene, per_motion: f64) -> Scene {
    let ambient = Ambient { start: 20.0, drift: 0.0, swing: 0.0, period: 1.0, phase: 0.0 };
    let part = GrowingPart::Link { joint: 1, axis: 0 };
    let heat = Some(DriveHeat { actuator: 0, power: 0.0, per_motion, resistance: 0.2 });
    let growth = Growth { part, length: 1.0, with_travel: false, expansion: 10e-6, lag: 60.0, heat };
    scene.machine.effects.thermal = Some(Thermal { ambient, reference: 20.0, growths: vec![growth] });
    scene
}

/// Against the sum over all motions of what is left of each one's heat.
#[test]
fn the_heat_of_all_motions_as_driven_is_there_in_both_sets() {
    let scene = heated(scene(SessionPlan::default()), 500.0);
    let told = measure(&scene, [4, 3]);
    let mut motions: Vec<(f64, f64, f64)> = Vec::new();
    let (mut before, mut largest) = (0.0, 0.0_f64);
    for (set, effects) in told.sets.iter().zip(&told.truth.effects) {
        let mut slide = scene.region.centre[0];
        for (observation, effects) in set.measurements.observations.iter().zip(effects) {
            let now = observation.time;
            motions.push((before, now, (observation.command[0] - slide).abs()));
            (before, slide) = (now, observation.command[0]);
            let left = |(begin, end, way): &(f64, f64, f64)| {
                let since = |time: f64| (-(now - time) / 60.0).exp();
                let heat = 0.2 * 500.0 * way;
                if begin == end {
                    heat / 60.0 * since(*end)
                } else {
                    heat * (since(*end) - since(*begin)) / (end - begin)
                }
            };
            let expected: f64 = motions.iter().map(left).sum();
            let found = effects.displacements[1][0] / 10e-6;
            assert!((found - expected).abs() < 1e-12, "{now} s: {found} K against {expected} K");
            largest = largest.max(found);
        }
    }
    assert!(largest > 1.0, "{largest} K");
}

#[test]
fn a_session_that_overheats_a_part_is_refused() {
    let scene = heated(scene(SessionPlan::default()), 1e6);
    let session = MeasuringSession {
        as_built: &scene.machine,
        actuators: &scene.machine.actuators,
        region: &scene.region,
        listed: [None; 2],
        identification_poses: 5,
        verification_poses: 0,
        tracker: &scene.tracker,
        outliers: None,
        nests: &scene.nests,
        nest_sigma: 1e-5,
        target_covariance: &(Matrix3::identity() * 1e-10),
        probe: None,
        plan: &scene.plan,
    };
    let told = session.measure(&mut Exact(scene.machine.clone()), 5, 0, &mut |_| ControlFlow::Continue(()));
    match told.expect_err("too hot") {
        SessionError::Effects(EffectError::Overheated { actuator: 0, value, .. }) => {
            assert!(value > MOST_RISE);
        }
        other => panic!("{other}"),
    }
}

#[test]
fn nests_are_measured_before_between_and_after_in_both_sets() {
    let rounds = NestRounds { every: 2, after: true, two_faces: true, ..NestRounds::default() };
    let told = measure(&scene(timed(rounds)), [3, 2]);
    let [first, second] = [0, 1].map(|set| told.sets[set].measurements.stations.clone());
    assert_eq!(first, second, "one session has one set of nests");
    // Before, behind poses 2 and 4, after; four nests, two faces.
    assert_eq!(first[0].nests.len(), 4 * 4 * 2);
    let times: Vec<f64> = first[0].nests.iter().map(|nest| nest.time.expect("timed")).collect();
    let starts: Vec<f64> = times.iter().copied().step_by(8).collect();
    assert_eq!(starts, [100.0, 144.0, 188.0, 222.0]);
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
    let faces: Vec<Face> = first[0].nests.iter().take(3).map(|nest| nest.reading.face()).collect();
    assert_eq!(faces, [Face::Front, Face::Back, Face::Front]);
    assert!(
        first[0]
            .nests
            .iter()
            .all(|n| n.in_base == first[0].nests.iter().find(|o| o.name == n.name).unwrap().in_base)
    );
    let poses: Vec<f64> =
        told.sets.iter().flat_map(|s| &s.measurements.observations).map(|o| o.time).collect();
    assert_eq!(poses, [124.0, 134.0, 168.0, 178.0, 212.0]);
}

#[test]
fn visits_come_from_both_sides_in_turn_and_every_target_is_read() {
    let target = |name: &str, y| FurtherTarget {
        name: name.to_owned(),
        in_flange: Vector3::new(0.0, y, 0.1),
        opening: None,
    };
    let plan = SessionPlan {
        repeats: 3,
        approach: Approach::BothSides([0.01, 0.02]),
        targets: vec![target("B", 0.2), target("C", -0.2)],
        ..SessionPlan::default()
    };
    let told = measure(&scene(plan), [5, 0]);
    let set = &told.sets[0].measurements;
    assert_eq!((set.observations.len(), set.targets.len(), told.truth.further_targets.len()), (45, 3, 2));
    for pose in set.observations.chunks(9) {
        let signs: Vec<i8> = pose.iter().step_by(3).map(|o| o.approach[1]).collect();
        assert_eq!(signs, [1, -1, 1]);
        let targets: Vec<usize> = pose.iter().take(4).map(|o| o.target).collect();
        assert_eq!(targets, [0, 1, 2, 0]);
        assert!(pose.iter().all(|o| o.pose == pose[0].pose && o.command == pose[0].command));
    }
    // The truth beside a reading is that of its own target.
    let from = told.truth.stations[0].inverse();
    for (o, settled) in set.observations.iter().zip(&told.truth.poses[0]) {
        let seen = from.rotation * o.reading.position() + from.translation.vector;
        assert!((seen - settled.target).norm() < 30e-6, "{}", o.target);
    }
    let apart = told.truth.poses[0][1].target - told.truth.poses[0][2].target;
    assert!((apart.norm() - 0.4).abs() < 1e-12);
}

#[test]
fn the_station_that_sees_reads_and_a_hidden_pose_names_the_link() {
    let mut both = scene(SessionPlan::default());
    // A wall on the slide, between the arm at negative angles and the first station.
    let wall =
        Visual { link_from_shape: translation(2.0, -1.0, 0.0), shape: VisualShape::Box([0.1, 1.9, 2.0]) };
    let visuals = [vec![], vec![wall], vec![]];
    let obstacles = Obstacles::of_shapes(&both.machine.kinematics, &visuals, 0.0);
    let up = Vector3::z();
    let beside = LaserTracker::levelled(both.tracker.instrument, Vector3::new(0.0, -5.0, 0.5), 1.5, &up);
    let further = FurtherStation { name: "beside".to_owned(), tracker_from_base: beside.tracker_from_base };
    both.plan.sight = Some(Sight { obstacles, acceptance: 0.5 });
    let alone = measure(&both, [40, 0]);
    let (seen, hidden) = (&alone.sets[0].measurements.observations, &alone.sets[0].dropped);
    assert!(hidden.len() > 8 && seen.len() > 8 && seen.len() + hidden.len() == 40);
    assert!(hidden.iter().all(|(_, why)| why == "slide hides the target from the tracker"), "{hidden:?}");
    assert!(hidden.iter().all(|(pose, _)| !seen.iter().any(|o| o.pose == *pose)));

    both.plan.stations = vec![further];
    let shared = measure(&both, [40, 0]);
    assert!(shared.sets[0].dropped.is_empty());
    for o in &shared.sets[0].measurements.observations {
        let was_hidden = hidden.iter().any(|(pose, _)| *pose == o.pose);
        assert!(o.station == 1 || !was_hidden, "pose {}", o.pose);
    }
    both.plan.share = StationShare::All;
    let all = measure(&both, [40, 0]);
    assert_eq!(all.sets[0].measurements.observations.len(), 80 - hidden.len());
    assert_eq!(all.missing[0].len(), hidden.len());
    assert!(
        all.missing[0].iter().all(|m| m.station == 0 && m.why.starts_with("from station 1: slide hides"))
    );
}

#[test]
fn a_reflector_that_looks_away_is_not_read() {
    let mut scene = scene(SessionPlan::default());
    let obstacles = Obstacles::none(&scene.machine.kinematics);
    scene.plan.sight = Some(Sight { obstacles, acceptance: 0.5 });
    // It looks along the arm: to the tracker only where the arm points there.
    scene.plan.opening = Some(UnitVector3::new_normalize(Vector3::x()));
    let told = measure(&scene, [60, 0]);
    assert!(!told.sets[0].measurements.observations.is_empty() && told.sets[0].dropped.len() > 20);
    for (_, why) in &told.sets[0].dropped {
        assert!(
            why.starts_with("the beam meets the target at ")
                && why.ends_with("28.6 deg up to which it is returned"),
            "{why}"
        );
    }
    let largest =
        told.sets[0].measurements.observations.iter().map(|o| o.command[1].abs()).fold(0.0, f64::max);
    assert!(largest < 0.5, "{largest}");
}

#[test]
fn a_short_way_measures_the_same_poses_in_another_order() {
    let drawn = measure(&scene(SessionPlan::default()), [50, 0]);
    let short =
        measure(&scene(SessionPlan { order: PoseOrder::ShortTravel, ..SessionPlan::default() }), [50, 0]);
    let commands = |told: &Simulation| {
        let mut all: Vec<_> =
            told.sets[0].measurements.observations.iter().map(|o| o.command.clone()).collect();
        let way: f64 = all.windows(2).map(|pair| (pair[0][1] - pair[1][1]).abs()).sum();
        all.sort_by(|a, b| a[0].total_cmp(&b[0]));
        (all, way)
    };
    let ((drawn, long), (same, way)) = (commands(&drawn), commands(&short));
    assert_eq!(drawn, same);
    assert!(way < 0.5 * long, "{way} of {long} rad");
    let numbers: Vec<u32> = short.sets[0].measurements.observations.iter().map(|o| o.pose).collect();
    assert_eq!(numbers, (0..50).collect::<Vec<_>>());
}

#[test]
fn readings_follow_the_drift_of_their_stations_and_nests_show_it() {
    let mut scene = scene(timed(NestRounds { every: 5, after: true, ..NestRounds::default() }));
    let still = Motion { shift: 0.0, turn: 0.0 };
    // 0.4 mm in the session's quarter of an hour: far beyond the noise.
    let ramp = Motion { shift: 1.6e-3, turn: 0.0 };
    scene.tracker.conditions.drift =
        Some(DriftLaw { ramp, warm_up: [still; 2], warm_up_time: 1.0, walk: still });
    let told = measure(&scene, [60, 0]);
    let set = &told.sets[0].measurements;
    let nest = |index: usize| {
        let of: Vec<_> = set.stations[0].nests.iter().filter(|nest| nest.name == "N0").collect();
        of[if index == 0 { 0 } else { of.len() - 1 }].clone()
    };
    let (first, last) = (nest(0), nest(1));
    let span = last.time.unwrap() - first.time.unwrap();
    let moved = (last.reading.position() - first.reading.position()).norm();
    assert!((moved / (1.6e-3 * span / 3600.0) - 1.0).abs() < 0.05, "{moved}");
    // The stated place is that of the middle of the rounds: the mean error of all readings is small, that of the first is not.
    let from = told.truth.stations[0].inverse();
    let errors: Vec<f64> = set
        .observations
        .iter()
        .zip(&told.truth.poses[0])
        .map(|(o, s)| (from.rotation * o.reading.position() + from.translation.vector - s.target).norm())
        .collect();
    assert!(errors[0] > 0.3 * moved && errors[30] < 0.1 * moved && errors[59] > 0.3 * moved, "{errors:?}");
}

#[test]
fn reflectors_have_a_centre_of_their_own_and_sit_anew_each_round() {
    let mut scene = scene(timed(NestRounds { every: 1, after: true, ..NestRounds::default() }));
    let exact = |offset| ErrorLine { offset, per_metre: 0.0 };
    scene.tracker.instrument = Instrument::of_noise(exact(1e-9), exact(1e-9), 0.125);
    scene.tracker.conditions.smr = Some(SmrLaw { centring_sigma: 0.0, seat_sigma: 40e-6, acceptance: 0.5 });
    let told = measure(&scene, [100, 0]);
    let nests = &told.sets[0].measurements.stations[0].nests;
    let seats: Vec<Vector3<f64>> =
        nests.iter().filter(|n| n.name == "N1").map(|n| n.reading.position()).collect();
    let mean = seats.iter().sum::<Vector3<f64>>() / seats.len() as f64;
    let variance =
        seats.iter().map(|s| (s - mean).norm_squared()).sum::<f64>() / (3.0 * (seats.len() - 1) as f64);
    // Chi-square with 300 degrees of freedom, 99.9 % band.
    assert!((variance / 40e-6_f64.powi(2) - 1.0).abs() < 3.3 * (2.0_f64 / 300.0).sqrt(), "{variance}");
}

#[test]
fn plans_that_cannot_be_carried_out_are_refused() {
    let refused = |plan: SessionPlan| plan.check(10).expect_err("no plan").to_string();
    let sound = SessionPlan::default();
    assert!(sound.check(100_000).is_ok());
    let text = refused(SessionPlan { repeats: 0, ..sound.clone() });
    assert!(text.contains("0 visits") && text.contains("1 to 1000"), "{text}");
    let timing = Timing { settling: f64::NAN, ..Timing::default() };
    assert!(refused(SessionPlan { timing, ..sound.clone() }).contains("settling takes NaN s"));
    let timing = Timing { averaging: 0.0, ..Timing::default() };
    assert!(refused(SessionPlan { timing, ..sound.clone() }).contains("a reading takes 0 s"));
    let approach = Approach::OneSide([0.01, -1.0]);
    assert!(refused(SessionPlan { approach, ..sound.clone() }).contains("-1"));
    let order = PoseOrder::ShortTravel;
    let text = SessionPlan { order, ..sound }.check(5001).expect_err("too many").to_string();
    assert!(text.contains("5001 poses"), "{text}");
}
