//! Instruments that err as their data sheet allows: what is told of them, and whether intervals hold that know of it.

use std::f64::consts::PI;

use calibrig_estimation::identification::{
    Estimate, IdentificationOptions, InstrumentChoice, Loss, Mode, Predictor, Stated, identify,
    without_calibration,
};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::geometry::{Transform, rotation_z, small_displacement, translation};
use calibrig_model::measurement::{
    Face, InstrumentTerm, MeasurementSet, NestObservation, Observation, Reading, SphericalReading,
    StatedDrift, StatedInstrument, Station, Target,
};
use calibrig_model::nalgebra::{Matrix3, Point3, Vector3, Vector6};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::statistics::binomial_cdf;
use calibrig_model::{CalibrationModel, KinematicModel, ParameterId, Unit};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::coverage::{links, robots};

/// Of the nests' certified places and of the target's offset, m.
const CERTIFIED: f64 = 10e-6;
/// Time from one pose to the next, s.
const PER_POSE: f64 = 60.0;
const TARGET: Vector3<f64> = Vector3::new(0.05, 0.08, 0.12);

/// Permissible errors of a Leica AT500, m and m per m: across the beam and along it.
const ACROSS: [f64; 2] = [15e-6, 6e-6];
const ALONG: [f64; 2] = [10e-6, 0.3e-6];

/// `k` of the permissible errors: offsets of the constant part, angles and scale of the part that grows with the range.
fn data_sheet(k: f64) -> StatedInstrument {
    let sigma = |term: InstrumentTerm| match (term, term.unit()) {
        (InstrumentTerm::RangeOffset, _) => k * ALONG[0],
        (_, Unit::One) => k * ALONG[1],
        (_, Unit::Metre) => k * ACROSS[0],
        (_, Unit::Radian) => k * ACROSS[1],
    };
    StatedInstrument {
        drift: None,
        name: "tracker".to_owned(),
        sigmas: InstrumentTerm::ALL.map(|term| (term, sigma(term))).to_vec(),
    }
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A tracker with errors of its own.
struct Tracker {
    from_base: Transform,
    /// Motion in an hour, as a displacement of the base that it sees.
    drift: Vector6<f64>,
    errors: Vec<(InstrumentTerm, f64)>,
    /// Standard deviation of a reading over the permissible error.
    fraction: f64,
}

impl Tracker {
    fn read(&self, in_base: &Vector3<f64>, time: f64, face: Face, rng: &mut impl Rng) -> Reading {
        let now = self.from_base * small_displacement(&(self.drift * (time / 3600.0)));
        let p = (now * Point3::from(*in_base)).coords;
        let [range, azimuth, elevation] = Reading::Cartesian { position: p, covariance: None }.spherical();
        let across = self.fraction * (ACROSS[0] + ACROSS[1] * range);
        let along = self.fraction * (ALONG[0] + ALONG[1] * range);
        let mut off: Vector3<f64> = self
            .errors
            .iter()
            .map(|(term, size)| term.displacement(range, azimuth, elevation, face) * *size)
            .sum();
        let angle = across / range;
        off += Vector3::new(along * normal(rng), 0.0, across * normal(rng));
        Reading::Spherical(SphericalReading {
            range: range + off.x,
            azimuth: azimuth + off.y / (range * elevation.cos()) + angle * normal(rng),
            elevation: elevation + off.z / range,
            covariance: Some(Matrix3::from_diagonal(&Vector3::new(
                (along * along).max(1e-18),
                (angle * angle).max(1e-18),
                (angle * angle).max(1e-18),
            ))),
            face,
        })
    }
}

/// What is measured of a machine, from one place.
struct Plan<'a> {
    machine: &'a KinematicModel,
    tracker: &'a Tracker,
    stated: &'a StatedInstrument,
    poses: u32,
    /// Every so many poses are seen in the back face as well; and the nests.
    back_every: u32,
    certified: f64,
}

impl Plan<'_> {
    fn measure(&self, rng: &mut impl Rng) -> MeasurementSet {
        let vector = |rng: &mut _| self.certified * Vector3::from_fn(|_, _| normal(rng));
        let information = Matrix3::identity() * self.certified.powi(2).max(1e-18);
        let mut nests = Vec::new();
        for (number, (x, y)) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].into_iter().enumerate() {
            for z in [0.0, 0.8] {
                let place = Vector3::new(1.5 * x, y, z);
                let in_base = place + vector(rng);
                for face in
                    [Face::Front, Face::Back].into_iter().take(if self.back_every > 0 { 2 } else { 1 })
                {
                    // A nest that is seen again keeps its certified place; stated as one of its own, since its error is small beside.
                    nests.push(NestObservation {
                        name: format!("{number} {z} {}", face.key()),
                        in_base,
                        in_base_covariance: information,
                        reading: self.tracker.read(&place, 0.0, face, rng),
                        time: Some(0.0),
                    });
                }
            }
        }
        let joints = self.machine.joint_count();
        let mut observations = Vec::new();
        for pose in 1..=self.poses {
            let command: Vec<f64> = (0..joints).map(|_| rng.random_range(-0.8 * PI..0.8 * PI)).collect();
            let in_base = target_in_base(self.machine, &command, &TARGET).expect("a pose");
            let is_both = self.back_every > 0 && pose.is_multiple_of(self.back_every);
            for face in [Face::Front, Face::Back].into_iter().take(if is_both { 2 } else { 1 }) {
                observations.push(Observation {
                    pose,
                    approach: vec![0; joints],
                    since_reversal: Vec::new(),
                    command: command.clone(),
                    temperature: None,
                    time: PER_POSE * f64::from(pose),
                    station: 0,
                    target: 0,
                    payload: None,
                    reading: self.tracker.read(&in_base, PER_POSE * f64::from(pose), face, rng),
                });
            }
        }
        MeasurementSet {
            stations: vec![Station {
                name: "T1".to_owned(),
                nests,
                instrument: Some(self.stated.clone()),
                sweeps: Vec::new(),
                motion: None,
            }],
            targets: vec![Target {
                name: "S1".to_owned(),
                in_flange: TARGET + vector(rng),
                covariance: Some(information),
                orientation: None,
            }],
            observations,
        }
    }
}

fn place() -> Transform {
    translation(3.0, 0.4, -0.6) * rotation_z(0.7)
}

/// Without noise, and with hardly anything stated: both faces, nests and robot tell every error.
#[test]
fn exact_readings_in_both_faces_give_the_errors_of_the_instrument() {
    let [model, _] = robots();
    let errors: Vec<_> = (1..)
        .zip(InstrumentTerm::ALL)
        .map(|(place, term)| (term, 1e-6 * f64::from(place) * if place % 2 == 0 { 1.0 } else { -1.0 }))
        .collect();
    let tracker = Tracker { from_base: place(), drift: Vector6::zeros(), errors, fraction: 0.0 };
    let stated = StatedInstrument {
        drift: None,
        name: "any".to_owned(),
        sigmas: InstrumentTerm::ALL.map(|term| (term, 0.1)).to_vec(),
    };
    let plan = Plan {
        machine: &model.kinematics,
        tracker: &tracker,
        stated: &stated,
        poses: 40,
        back_every: 1,
        certified: 0.0,
    };
    let set = plan.measure(&mut stream(3, 0, StreamSource::IdentificationPoses));
    let estimate = identify(&model, &set, &IdentificationOptions::default()).expect("an estimate");
    for (term, size) in &tracker.errors {
        let id = ParameterId::Instrument { instrument: 0, term: *term };
        let found = estimate.value(id).expect("a parameter");
        // Signatures are taken where the reading is, some 0.02 mm from the point: what that makes falls with the square of the errors.
        assert!((found - size).abs() < 5e-9, "{term}: {found:e}, {size:e}");
    }
    let errors = Predictor::new(&estimate.robot).and_then(|mut p| p.errors(&set)).expect("poses");
    let worst = errors.iter().map(Vector3::norm).fold(0.0, f64::max);
    assert!(worst < 5e-9, "{worst:e}");
    // Left out, they are in the residuals.
    let ignored =
        IdentificationOptions { instrument: InstrumentChoice::Ignored, ..IdentificationOptions::default() };
    let without = identify(&model, &set, &ignored).expect("an estimate");
    assert!(without.parameters.iter().all(|p| !matches!(p.id, ParameterId::Instrument { .. })));
    let errors = Predictor::new(&without.robot).and_then(|mut p| p.errors(&set)).expect("poses");
    assert!(errors.iter().map(Vector3::norm).fold(0.0, f64::max) > 1e-6);
}

/// Intervals that held what was put in.
#[derive(Default)]
struct Held {
    links: Vec<u64>,
    positions: u64,
    of_positions: u64,
    errors: u64,
    of_errors: u64,
}

impl Held {
    fn count(
        &mut self,
        estimate: &Estimate,
        truth: &[(ParameterId, f64)],
        machine: &KinematicModel,
        rng: &mut impl Rng,
    ) {
        let factor = estimate.interval_factor(0.95);
        self.links.resize(truth.len(), 0);
        for (held, (id, truth)) in self.links.iter_mut().zip(truth) {
            let parameter = estimate.parameters.iter().find(|p| p.id == *id).expect("identified");
            *held +=
                u64::from((parameter.value - truth).abs() <= factor * parameter.sigma.expect("full rank"));
        }
        // One pose a trial, so that what is counted does not depend on what was.
        let command: Vec<f64> = (0..machine.joint_count()).map(|_| rng.random_range(-2.0..2.0)).collect();
        let position = target_in_base(machine, &command, &TARGET).expect("a pose");
        let predicted = estimate.predict(&*command).expect("a pose");
        let sigma = predicted.sigma().expect("full rank");
        for axis in 0..3 {
            self.of_positions += 1;
            self.positions +=
                u64::from((predicted.position[axis] - position[axis]).abs() <= factor * sigma[axis]);
        }
    }
}

fn sessions(poses: u32, trials: u32, choice: InstrumentChoice) -> Held {
    let [model, _]: [CalibrationModel; 2] = robots();
    let options = IdentificationOptions {
        mode: Mode::OnlyCalibration,
        instrument: choice,
        ..IdentificationOptions::default()
    };
    let stated = data_sheet(0.2);
    let mut held = Held::default();
    let mut ids = Vec::new();
    for trial in 0..=trials {
        let mut rng = stream(17, trial, StreamSource::AsBuilt);
        let mut machine = model.kinematics.clone();
        let mut truth = Vec::new();
        for id in &ids {
            let size = if ParameterId::unit(*id) == Unit::Metre { 0.5e-3 } else { 1e-3 };
            let value = size * normal(&mut rng);
            machine.add(*id, value);
            truth.push((*id, value));
        }
        let errors: Vec<_> = stated.errors().map(|(term, sigma)| (term, sigma * normal(&mut rng))).collect();
        let tracker = Tracker { from_base: place(), drift: Vector6::zeros(), errors, fraction: 0.125 };
        let plan = Plan {
            machine: &machine,
            tracker: &tracker,
            stated: &stated,
            poses,
            back_every: 0,
            certified: CERTIFIED,
        };
        let set = plan.measure(&mut rng);
        let estimate = identify(&model, &set, &options).expect("an estimate");
        if trial == 0 {
            // What is identified, before any robot is drawn.
            ids = links(&estimate);
            continue;
        }
        held.count(&estimate, &truth, &machine, &mut rng);
        let factor = estimate.interval_factor(0.95);
        for (term, size) in &tracker.errors {
            let id = ParameterId::Instrument { instrument: 0, term: *term };
            if let Some(found) = estimate.parameters.iter().find(|p| p.id == id) {
                held.of_errors += 1;
                held.errors +=
                    u64::from((found.value - size).abs() <= factor * found.sigma.expect("full rank"));
            }
        }
    }
    held
}

/// Two-sided: so seldom are as many or as few hits.
fn p_value(hits: u64, trials: u64) -> f64 {
    let less = binomial_cdf(hits, trials, 0.95);
    let more = if hits == 0 { 1.0 } else { 1.0 - binomial_cdf(hits - 1, trials, 0.95) };
    2.0 * less.min(more)
}

/// Drawn by the law that the priors state. The tests share one false alarm in a thousand.
#[test]
fn intervals_hold_where_the_instrument_errs_as_its_data_sheet_allows() {
    let trials = if std::env::var_os("CALIBRIG_FULL").is_some() { 1000 } else { 150 };
    for poses in [30, 100] {
        let with = sessions(poses, trials, InstrumentChoice::AsStated);
        let without = sessions(poses, trials, InstrumentChoice::Ignored);
        let share = |held: &Held| {
            let n = held.links.len() as f64 * f64::from(trials);
            (
                1e2 * held.links.iter().sum::<u64>() as f64 / n,
                1e2 * held.positions as f64 / held.of_positions as f64,
            )
        };
        let ((links, positions), (bare_links, bare_positions)) = (share(&with), share(&without));
        println!(
            "{poses} poses: {links:.1} % of link parameters, {positions:.1} % of positions and {:.1} % of the instrument's errors inside; \
             without its terms {bare_links:.1} % and {bare_positions:.1} %",
            1e2 * with.errors as f64 / with.of_errors as f64
        );
        let mut hits = with.links.clone();
        // Coordinates of a position depend on each other: counted as one test of a third as many.
        hits.push(with.positions / 3);
        let level = 1e-3 / hits.len() as f64;
        let failed: Vec<_> = hits.iter().filter(|hits| p_value(**hits, u64::from(trials)) < level).collect();
        assert!(failed.is_empty(), "{failed:?} of {trials}");
        assert!(bare_links < links, "{bare_links}");
    }
}

/// What is stated of an instrument is tested as all that is stated: a collimation far beyond its data sheet is named, with what it is.
#[test]
fn an_instrument_out_of_specification_is_told() {
    let [model, _] = robots();
    let stated = data_sheet(0.2);
    let size = 60e-6;
    let tracker = Tracker {
        from_base: place(),
        drift: Vector6::zeros(),
        errors: vec![(InstrumentTerm::Collimation, size)],
        fraction: 0.125,
    };
    let plan = Plan {
        machine: &model.kinematics,
        tracker: &tracker,
        stated: &stated,
        poses: 40,
        back_every: 4,
        certified: CERTIFIED,
    };
    let set = plan.measure(&mut stream(23, 0, StreamSource::IdentificationPoses));
    let estimate = identify(&model, &set, &IdentificationOptions::default()).expect("an estimate");
    let told: Vec<_> = estimate.contradicted.iter().map(|c| (c.stated.clone(), c.to_string())).collect();
    let found = told.iter().find_map(|(stated, _)| match stated {
        Stated::Parameter { id, found, sigma, .. } if id.to_string() == "tracker_collimation" => {
            Some((*found, *sigma))
        }
        _ => None,
    });
    let (found, sigma) = found.unwrap_or_else(|| panic!("{told:?}"));
    assert!((found - size).abs() < 5.0 * sigma && sigma < size / 5.0, "{found:e} +- {sigma:e}");
    let made: Vec<_> = estimate.assumptions.iter().map(ToString::to_string).collect();
    assert!(made.iter().any(|text| text.starts_with("tracker tracker: 16 errors")), "{made:?}");
}

/// A tracker that moves steadily on its stand after it saw the nests: the robot tells how, and its parameters keep clean of it.
#[test]
fn a_steady_drift_is_identified_with_the_robot() {
    let [model, _] = robots();
    let drift = Vector6::new(40e-6, -30e-6, 60e-6, 8e-6, -5e-6, 6e-6);
    let tracker = Tracker { from_base: place(), drift, errors: Vec::new(), fraction: 0.0 };
    let allowed = StatedDrift { motion_per_hour: 50e-6, turn_per_hour: 10e-6 };
    let stated = StatedInstrument { name: "T".to_owned(), sigmas: Vec::new(), drift: Some(allowed) };
    let plan = Plan {
        machine: &model.kinematics,
        tracker: &tracker,
        stated: &stated,
        poses: 60,
        back_every: 0,
        certified: 0.0,
    };
    let set = plan.measure(&mut stream(29, 0, StreamSource::IdentificationPoses));
    let estimate = identify(&model, &set, &IdentificationOptions::default()).expect("an estimate");
    for component in 0..6 {
        let found = estimate.value(ParameterId::Drift { station: 0, component }).expect("a parameter");
        // The prior pulls at it by less than what is told of it: nanometres.
        assert!((found / drift[component] - 1.0).abs() < 1e-2, "{component}: {found:e}");
    }
    let worst = |estimate: &Estimate| {
        let links = estimate.parameters.iter().filter(|p| matches!(p.id, ParameterId::Link { .. }));
        links.map(|p| p.value.abs()).fold(0.0, f64::max)
    };
    let ignored =
        IdentificationOptions { instrument: InstrumentChoice::Ignored, ..IdentificationOptions::default() };
    let without = identify(&model, &set, &ignored).expect("an estimate");
    let (with, without) = (worst(&estimate), worst(&without));
    assert!(with < 2e-7 && without > 20.0 * with, "{with:e}, {without:e}");
}

/// The nominal robot is millimetres off: laid over the measurements, none of that is the instrument's.
#[test]
fn what_the_nominal_robot_is_off_by_is_not_the_instruments() {
    let [model, _] = robots();
    let stated = data_sheet(0.2);
    let mut machine = model.kinematics.clone();
    for (place, id) in (0..).zip(ParameterId::all_of_links(6)) {
        machine.add(id, 1e-3 * f64::from(place).sin());
    }
    let tracker =
        Tracker { from_base: place(), drift: Vector6::zeros(), errors: Vec::new(), fraction: 0.125 };
    let plan = Plan {
        machine: &machine,
        tracker: &tracker,
        stated: &stated,
        poses: 40,
        back_every: 0,
        certified: CERTIFIED,
    };
    let mut set = plan.measure(&mut stream(31, 0, StreamSource::IdentificationPoses));
    set.targets[0].covariance = None;
    let robot = without_calibration(&model, &set, Loss::Squared).expect("a robot laid over the points");
    assert!(robot.instruments.is_empty(), "{:?}", robot.instruments);
    // Identified, the instrument stays within what is stated of it.
    let estimate = identify(&model, &set, &IdentificationOptions::default()).expect("an estimate");
    for (term, sigma) in stated.errors() {
        let found = estimate.value(ParameterId::Instrument { instrument: 0, term }).expect("a parameter");
        assert!(found.abs() < 4.0 * sigma, "{term}: {found:e}");
    }
}
