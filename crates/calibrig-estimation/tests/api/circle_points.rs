//! Stations that sweeps of two axes place, against stations whose place is known.

use calibrig_estimation::circle_points::{SweepError, place_by_sweeps};
use calibrig_estimation::identification::{FrameChoice, IdentificationOptions, ParameterChoice, identify};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::geometry::{Transform, rotation_vector, rotation_x, rotation_z, translation};
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, Station, Target};
use calibrig_model::nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use calibrig_model::statistics::{chi2_quantile, normal_quantile};
use calibrig_model::{CalibrationModel, CraigLink, KinematicModel};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::FRAC_PI_2;

const OFFSET: [f64; 3] = [0.05, -0.12, 0.20];

fn tracker_from_base() -> Transform {
    translation(2.5, -3.0, 0.7) * rotation_z(0.9) * rotation_x(-0.15)
}

/// A rail, a waist, and an arm.
fn on_a_rail() -> CalibrationModel {
    CalibrationModel::new(vec![
        CraigLink::prismatic("rail").row(0.0, 0.0, 0.0, 0.0).limits(0.0, 4.0),
        CraigLink::revolute("waist").row(0.0, -FRAC_PI_2, 0.6, 0.0).limits(-1.5, 1.5),
        CraigLink::revolute("shoulder").row(0.3, -FRAC_PI_2, 0.0, 0.0).limits(-1.5, 1.5),
        CraigLink::revolute("elbow").row(1.2, 0.0, 0.1, 0.0).limits(-2.0, 2.0),
        CraigLink::revolute("wrist").row(0.2, -FRAC_PI_2, 1.0, 0.0).limits(-3.0, 3.0),
    ])
    .expect("a robot")
}

/// Two turning axes first, at right angles.
fn standing() -> CalibrationModel {
    CalibrationModel::new(vec![
        CraigLink::revolute("waist").row(0.0, 0.0, 0.4, 0.0).limits(-3.0, 3.0),
        CraigLink::revolute("shoulder").row(0.15, -FRAC_PI_2, 0.0, 0.0).limits(-2.0, 2.0),
        CraigLink::revolute("elbow").row(0.8, 0.0, 0.1, 0.0).limits(-2.5, 2.5),
        CraigLink::revolute("roll").row(0.1, -FRAC_PI_2, 0.9, 0.0).limits(-3.0, 3.0),
        CraigLink::revolute("pitch").row(0.0, FRAC_PI_2, 0.0, 0.0).limits(-2.0, 2.0),
    ])
    .expect("a robot")
}

/// Two parallel axes first.
fn scara() -> CalibrationModel {
    CalibrationModel::new(vec![
        CraigLink::revolute("inner").row(0.0, 0.0, 0.3, 0.0).limits(-2.0, 2.0),
        CraigLink::revolute("outer").row(0.4, 0.0, 0.0, 0.0).limits(-2.5, 2.5),
        CraigLink::prismatic("quill").row(0.35, 0.0, 0.0, 0.0).limits(-0.2, 0.0),
        CraigLink::revolute("tool").row(0.0, 0.0, 0.0, 0.0).limits(-3.0, 3.0),
    ])
    .expect("a robot")
}

/// Sweeps of the first two joints around `home`, through 15 places each.
fn swept(home: &[f64], ranges: [[f64; 2]; 2]) -> Vec<Vec<f64>> {
    let of = |joint: usize| {
        let [from, to] = ranges[joint];
        (0..15).map(move |k| {
            let mut command = home.to_vec();
            command[joint] = from + (to - from) * f64::from(k) / 14.0;
            command
        })
    };
    of(0).chain(of(1)).collect()
}

/// What a tracker with this noise sees of a machine.
fn readings(
    machine: &KinematicModel,
    commands: &[Vec<f64>],
    sigma: f64,
    rng: &mut impl Rng,
) -> Vec<Observation> {
    let place = tracker_from_base();
    let mut read = |(pose, command): (u32, &Vec<f64>)| {
        let in_base = target_in_base(machine, command, &Vector3::from(OFFSET)).expect("a pose");
        let error = Vector3::from_fn(|_, _| sigma * rng.sample::<f64, _>(StandardNormal));
        let position = place.rotation * in_base + place.translation.vector + error;
        Observation {
            pose,
            command: command.clone(),
            approach: Vec::new(),
            since_reversal: Vec::new(),
            temperature: None,
            time: f64::from(pose),
            station: 0,
            target: 0,
            payload: None,
            reading: Reading::Cartesian {
                position,
                covariance: Some(Matrix3::identity() * sigma.max(1e-6).powi(2)),
            },
        }
    };
    (0..).zip(commands).map(&mut read).collect()
}

fn set(sweeps: Vec<Observation>, observations: Vec<Observation>) -> MeasurementSet {
    let target = Target {
        name: "SMR".to_owned(),
        in_flange: Vector3::from(OFFSET),
        covariance: Some(Matrix3::identity() * 1e-10),
        orientation: None,
    };
    let station = Station { name: "T1".to_owned(), sweeps, ..Station::default() };
    MeasurementSet { stations: vec![station], targets: vec![target], observations }
}

fn off(found: &Transform) -> Vector6<f64> {
    let displaced = found.inverse() * tracker_from_base();
    let (along, about) = (displaced.translation.vector, rotation_vector(&displaced.rotation));
    Vector6::new(along.x, along.y, along.z, about.x, about.y, about.z)
}

fn robots() -> [(CalibrationModel, Vec<Vec<f64>>); 3] {
    [
        (on_a_rail(), swept(&[2.0, 0.1, -0.5, 0.8, 0.3], [[0.3, 3.7], [-1.2, 1.1]])),
        (standing(), swept(&[0.2, -0.4, 0.9, 0.3, 0.5], [[-2.0, 2.2], [-1.0, 0.6]])),
        (scara(), swept(&[0.3, 0.8, -0.1, 0.2], [[-1.5, 1.5], [-1.0, 2.0]])),
    ]
}

#[test]
fn exact_sweeps_of_the_nominal_robot_give_the_exact_place() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (model, commands) in robots() {
        let set = set(readings(&model.kinematics, &commands, 0.0, &mut rng), Vec::new());
        let (place, told) = place_by_sweeps(&model, &set, 0).expect("two axes");
        assert!(off(&place.tracker_from_base).amax() < 1e-12, "{}", off(&place.tracker_from_base));
        assert!((told.angle[0] - told.angle[2]).abs() < 1e-12);
        assert_eq!(told.axes.each_ref().map(|axis| axis.readings), [15, 15]);
    }
}

/// With noise, what the sweeps determine is off by no more than stated: the squares of what is off, over the covariance, have the chi-squared distribution.
#[test]
fn the_stated_covariance_is_that_of_the_place() {
    let trials = 400;
    for (model, commands) in robots() {
        let (mut inside, mut stands, mut open) = (0, [0_u32; 3], 0);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for _ in 0..trials {
            let set = set(readings(&model.kinematics, &commands, 20e-6, &mut rng), Vec::new());
            let (place, told) = place_by_sweeps(&model, &set, 0).expect("two axes");
            let off = off(&place.tracker_from_base);
            let square = off.dot(&(place.covariance.cholesky().expect("definite").solve(&off)));
            // Of what the nominal target says, 0.1 m wide, nothing is seen in the sum.
            let degrees = f64::from(6 - u8::try_from(told.open).expect("few"));
            inside += u32::from(square < chi2_quantile(0.95, degrees));
            let [stand, sigma] = told.stand;
            let beside = stand - tracker_from_base().inverse().translation.vector;
            for (axis, inside) in stands.iter_mut().enumerate() {
                *inside += u32::from(beside[axis].abs() < 1.96 * sigma[axis]);
            }
            open = told.open;
        }
        // Where sweeps scatter by more than stated, by chance alone in half of them, the covariance is the wider one: 95 % or somewhat more, less what
        // chance does once in a thousand.
        let share = f64::from(inside) / f64::from(trials);
        let band = normal_quantile(0.9995) * (0.95 * 0.05 / f64::from(trials)).sqrt();
        println!("inside {share}, stands {stands:?}");
        let of = |hits: u32| f64::from(hits) / f64::from(trials);
        assert!(open > 0 || stands.iter().all(|hits| (0.95 - band..0.99).contains(&of(*hits))), "{stands:?}");
        assert!((0.95 - band..0.99).contains(&share), "{share}");
    }
}

/// Axes that are not where the nominal robot has them: the angle between them is told, and of the robot as it is the place is exact.
#[test]
fn axes_as_they_are_give_the_exact_place() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (model, commands) in robots().into_iter().take(2) {
        let mut machine = model.kinematics.clone();
        machine.links[0].alpha += 2e-3;
        machine.links[0].beta -= 1e-3;
        machine.links[0].a += 3e-3;
        machine.links[1].alpha += 0.7e-3;
        let set = set(readings(&machine, &commands, 0.0, &mut rng), Vec::new());
        let (place, told) = place_by_sweeps(&model, &set, 0).expect("two axes");
        assert!((told.angle[0] - told.angle[2] + 0.7e-3).abs() < 1e-9, "{:?}", told.angle);
        // Of the robot as it is, the first row is a motion of the base.
        let of_machine = place.tracker_from_base
            * model.kinematics.links[0].fixed_part()
            * machine.links[0].fixed_part().inverse();
        let apart = off(&of_machine);
        // The height along the waist is that of a nominal target behind the tilted axes.
        let along = if told.open == 0 { 1e-9 } else { 3e-3 };
        assert!(apart.rows(0, 3).norm() < along && apart.rows(3, 3).norm() < 1e-9, "{apart}");
    }
}

/// In the fit the sweeps tie frame and first links; other parameters are found as with a known frame.
#[test]
fn a_robot_is_identified_in_the_frame_of_its_sweeps() {
    let model = standing();
    let mut machine = model.kinematics.clone();
    machine.links[1].theta += 1.2e-3;
    machine.links[2].a += 0.8e-3;
    machine.links[3].d -= 0.6e-3;
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let commands: Vec<Vec<f64>> = (0..60)
        .map(|_| {
            model
                .kinematics
                .links
                .iter()
                .map(|link| rng.random_range(link.limits[0]..link.limits[1]))
                .collect()
        })
        .collect();
    let (_, sweeps) = &robots()[1];
    let sweeps = readings(&machine, sweeps, 10e-6, &mut rng);
    let set = set(sweeps, readings(&machine, &commands, 10e-6, &mut rng));
    let options = IdentificationOptions {
        frame: FrameChoice::Sweeps,
        parameters: ParameterChoice::Complete,
        ..IdentificationOptions::default()
    };
    let estimate = identify(&model, &set, &options).expect("an estimate");
    assert!(estimate.is_sound(), "{:?}", estimate.warnings);
    for (name, truth) in [("delta_theta2", 1.2e-3), ("delta_a3", 0.8e-3), ("delta_d4", -0.6e-3)] {
        let Some(found) = estimate.parameters.iter().find(|p| p.id.to_string() == name) else { continue };
        let sigma = found.sigma.expect("known");
        assert!(
            (found.value - truth).abs() < 4.0 * sigma && sigma < 100e-6,
            "{name}: {} +- {sigma}",
            found.value
        );
    }
}

#[test]
fn sweeps_that_do_not_place_a_station_are_refused() {
    let model = on_a_rail();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let home = [2.0, 0.1, -0.5, 0.8, 0.3];
    let one = swept(&home, [[0.3, 3.7], [0.1, 0.1]]);
    let found =
        place_by_sweeps(&model, &set(readings(&model.kinematics, &one, 0.0, &mut rng), Vec::new()), 0);
    assert_eq!(found, Err(SweepError::TooFew { station: "T1".to_owned(), found: "rail".to_owned() }));
    assert!(matches!(
        place_by_sweeps(&model, &set(Vec::new(), Vec::new()), 0),
        Err(SweepError::TooFew { .. })
    ));
    assert!(place_by_sweeps(&model, &set(Vec::new(), Vec::new()), 1).is_err());
    let of_another =
        place_by_sweeps(&scara(), &set(readings(&model.kinematics, &one, 0.0, &mut rng), Vec::new()), 0);
    assert_eq!(of_another, Err(SweepError::AnotherRobot { station: "T1".to_owned(), joints: 4 }));
    // Two sliding axes of one direction.
    let twice = CalibrationModel::new(vec![
        CraigLink::prismatic("rail").row(0.0, 0.0, 0.0, 0.0).limits(0.0, 4.0),
        CraigLink::prismatic("slide").row(0.2, 0.0, 0.0, 0.0).limits(0.0, 1.0),
        CraigLink::revolute("wrist").row(0.2, -FRAC_PI_2, 0.0, 0.0).limits(-1.0, 1.0),
    ])
    .expect("a robot");
    let both = swept(&[1.0, 0.5, 0.0], [[0.0, 4.0], [0.0, 1.0]]);
    let found =
        place_by_sweeps(&twice, &set(readings(&twice.kinematics, &both, 0.0, &mut rng), Vec::new()), 0);
    assert!(matches!(found, Err(SweepError::Parallel { .. })), "{found:?}");
}

/// A reading far off is left out and named.
#[test]
fn a_gross_error_of_a_sweep_is_named() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (model, commands) = &robots()[1];
    let mut sweeps = readings(&model.kinematics, commands, 10e-6, &mut rng);
    if let Reading::Cartesian { position, .. } = &mut sweeps[20].reading {
        position.y += 5e-3;
    }
    let (place, told) = place_by_sweeps(model, &set(sweeps, Vec::new()), 0).expect("two axes");
    assert_eq!(told.axes.each_ref().map(|axis| axis.gross.clone()), [Vec::new(), vec![20]]);
    let covariance: Matrix6<f64> = place.covariance;
    let off = off(&place.tracker_from_base);
    assert!((0..6).all(|i| off[i].abs() < 4.5 * covariance[(i, i)].sqrt()), "{off}");
}
