//! Smooth errors of actuators and hysteresis that builds up: what is put in comes out, and intervals hold truths that are drawn from the priors.

use calibrig_estimation::identification::{
    CalibratedRobot, Estimate, IdentificationOptions, Mode, Predictor, TermPrior, identify, linearise,
};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, Motion};
use calibrig_model::nalgebra::Vector3;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::statistics::binomial_cdf;
use calibrig_model::{CalibrationModel, ParameterId, PoseQuery, TermId};
use rand::RngExt;
use rand_distr::{Distribution, Normal};

use crate::coverage::{NOISE, robots};

const TARGET: Vector3<f64> = Vector3::new(0.05, 0.08, 0.12);
const FAMILIES: [&str; 3] = ["spline", "hysteresis", "presliding"];

/// The six axes, whose smooth terms are spread over a stated span; the first turns round.
fn arm() -> CalibrationModel {
    let [mut arm, _] = robots();
    arm.kinematics.links[0].limits = [-4.0, 4.0];
    let spans = [[-3.0, 3.0], [-1.2, 0.8], [-1.0, 1.5], [-2.0, 2.0], [-1.5, 1.5], [-2.0, 2.2]];
    arm.with_spans(spans.into()).expect("spans")
}

/// Every term of the families.
fn terms(model: &CalibrationModel, families: &[&str]) -> Vec<TermId> {
    families.iter().flat_map(|key| TermId::all_of(key, model).expect("a family")).collect()
}

/// Steps from pose to pose of which many are small, as on a path; measured with noise of so many standard deviations.
fn session(
    model: &CalibrationModel,
    truth: &[(TermId, f64)],
    poses: usize,
    trial: u32,
    noise: f64,
) -> MeasurementSet {
    let mut rng = stream(23, trial, StreamSource::IdentificationNoise);
    let robot = CalibratedRobot {
        instruments: Vec::new(),
        mode: Mode::Extended,
        nominal: model.clone(),
        model: model.clone(),
        terms: truth.to_vec(),
        stations: vec![Transform::identity()],
        targets: vec![TARGET],
        orientations: vec![None],
    };
    let mut predictor = Predictor::new(&robot).expect("a robot");
    let normal = Normal::new(0.0, noise * NOISE).expect("a width");
    let mut motion = Motion::default();
    let mut ways = Vec::new();
    let mut command: Vec<f64> = model.spans.iter().map(|[low, high]| 0.5 * (low + high)).collect();
    let points: Vec<_> = (0..poses)
        .map(|_| {
            for (command, [low, high]) in command.iter_mut().zip(&model.spans) {
                let step = (high - low) * 10_f64.powf(rng.random_range(-3.0..-0.2));
                let to = *command + if rng.random::<bool>() { step } else { -step };
                *command = if (*low..=*high).contains(&to) { to } else { rng.random_range(*low..*high) };
            }
            motion.go_to(&command, 0.0);
            ways.push((motion.approach.clone(), motion.since_reversal.clone()));
            let (approach, since) = ways.last().expect("one");
            let pose = PoseQuery::at(&command).approached(approach).moved(since);
            let place = predictor.in_base(pose).expect("a pose");
            (command.clone(), place + Vector3::from_fn(|_, _| normal.sample(&mut rng)))
        })
        .collect();
    let mut set = MeasurementSet::of_points(points).with_sigma(NOISE);
    // As drawn, so that the last joint moves it from the start; where it really is, the fit tells.
    set.targets[0].in_flange = TARGET + Vector3::new(1e-3, -2e-3, 1.5e-3);
    for (observation, (approach, since)) in set.observations.iter_mut().zip(ways) {
        (observation.approach, observation.since_reversal) = (approach, since);
    }
    set
}

fn options(families: &[&str], sigma: Option<f64>) -> IdentificationOptions {
    let prior = |family: &&str| TermPrior { family: (*family).to_owned(), length: sigma, angle: sigma };
    IdentificationOptions {
        mode: Mode::Extended,
        terms: Some(families.iter().map(|key| (*key).to_owned()).collect()),
        term_priors: if sigma.is_some() { families.iter().map(prior).collect() } else { Vec::new() },
        ..IdentificationOptions::default()
    }
}

#[test]
fn exact_data_give_every_amplitude_back() {
    let model = arm();
    let truth: Vec<_> = terms(&model, &FAMILIES)
        .into_iter()
        .enumerate()
        .map(|(i, id)| (id, 2e-4 * (1.7 * i as f64 + 0.3).sin()))
        .collect();
    let set = session(&model, &truth, 400, 0, 0.0);
    // Priors that take nothing away.
    let estimate = identify(&model, &set, &options(&FAMILIES, Some(10.0))).expect("an estimate");
    assert!(estimate.termination.converged());
    assert_eq!(estimate.robot.terms.len(), truth.len(), "{:?}", estimate.left_out);
    let errors = Predictor::new(&estimate.robot).expect("a robot").errors(&set).expect("poses");
    let worst = errors.iter().map(Vector3::norm).fold(0.0, f64::max);
    assert!(worst < 1e-8, "{worst}");
    let mut off: Vec<_> = estimate
        .robot
        .terms
        .iter()
        .map(|(id, value)| {
            let (_, truth) = truth.iter().find(|(of, _)| of == id).expect("one that was put in");
            ((value - truth).abs(), id.to_string())
        })
        .collect();
    off.sort_by(|a, b| b.0.total_cmp(&a.0));
    println!("furthest off: {:?}", &off[..3]);
    assert!(off[0].0 < 1e-6, "{:?}", off[0]);
}

/// The whitened columns of the fit against central differences of the prediction.
#[test]
fn columns_of_the_jacobian_are_central_differences() {
    let model = arm();
    let truth: Vec<_> = terms(&model, &FAMILIES).into_iter().map(|id| (id, 0.4 * id.prior_sigma())).collect();
    let set = session(&model, &truth, 80, 3, 1.0);
    let options = options(&FAMILIES, Some(1e-3));
    let estimate = identify(&model, &set, &options).expect("an estimate");
    let system = linearise(&model, &set, &options, &estimate).expect("a system");
    let turn = estimate.robot.stations[0].rotation;
    let step = 1e-5;
    let mut compared = 0;
    for (place, (id, _)) in estimate.robot.terms.iter().enumerate() {
        let at = |by: f64| {
            let mut robot = estimate.robot.clone();
            robot.terms[place].1 += by;
            let mut predictor = Predictor::new(&robot).expect("a robot");
            let all =
                set.observations.iter().map(|observation| predictor.in_base(observation).expect("a pose"));
            all.collect::<Vec<_>>()
        };
        let column =
            estimate.parameters.iter().position(|p| p.id == ParameterId::Term(*id)).expect("a column");
        let size = system.jacobian.column(column).rows(0, system.data_rows).amax();
        for (row, (ahead, behind)) in at(step).iter().zip(at(-step)).enumerate() {
            let expected = turn * (ahead - behind) / (2.0 * step * NOISE);
            let off = system.jacobian.fixed_view::<3, 1>(3 * row, column) - expected;
            assert!(off.amax() < 1e-6 * size, "{id}, row {row}: {off:?} of {size}");
            compared += usize::from(expected.amax() > 1e-3 * size);
        }
    }
    println!("{compared} columns of single poses");
    assert!(compared > 1000);
}

/// How many of `trials` intervals of 95 % each amplitude's held its truth.
fn assert_held(counts: &[(TermId, u64)], trials: u64) {
    // 99.9 % for all of them together.
    let tail = 0.5e-3 / counts.len() as f64;
    for (id, held) in counts {
        let [below, above] = [
            binomial_cdf(*held, trials, 0.95),
            1.0 - held.checked_sub(1).map_or(0.0, |h| binomial_cdf(h, trials, 0.95)),
        ];
        assert!(below > tail && above > tail, "{id}: {held} of {trials}");
    }
    let (sum, all) = (counts.iter().map(|(_, held)| held).sum::<u64>(), trials * counts.len() as u64);
    println!("{sum} of {all} intervals hold: {:.4}", sum as f64 / all as f64);
}

/// Sessions of machines whose amplitudes are drawn from the families' own priors, the spline's `larger` times as large.
fn held_in(
    families: &[&str],
    options: &IdentificationOptions,
    trials: u32,
    larger: f64,
) -> Vec<(TermId, u64)> {
    let model = arm();
    let ids = terms(&model, families);
    let mut counts: Vec<_> = ids.iter().map(|id| (*id, 0)).collect();
    for trial in 0..trials {
        let mut rng = stream(24, trial, StreamSource::AsBuilt);
        let draw = |id: &TermId| {
            let size = if id.family().key() == "spline" { larger } else { 1.0 };
            (*id, Normal::new(0.0, size * id.prior_sigma()).expect("a width").sample(&mut rng))
        };
        let truth: Vec<_> = ids.iter().map(draw).collect();
        let set = session(&model, &truth, 60, trial, 1.0);
        let estimate = identify(&model, &set, options).expect("an estimate");
        for ((id, held), (_, truth)) in counts.iter_mut().zip(&truth) {
            *held += u64::from(holds(&estimate, *id, *truth));
        }
    }
    counts
}

fn holds(estimate: &Estimate, id: TermId, truth: f64) -> bool {
    let id = ParameterId::Term(id);
    let parameter = estimate
        .parameters
        .iter()
        .find(|p| p.id == id)
        .unwrap_or_else(|| panic!("{id} is left out: {:?}", estimate.left_out));
    let sigma = parameter.sigma.expect("full rank");
    (parameter.value - truth).abs() <= estimate.interval_factor(0.95) * sigma
}

fn trials() -> u32 {
    if std::env::var_os("CALIBRIG_FULL").is_some() { 500 } else { 100 }
}

#[test]
fn intervals_hold_what_is_drawn_from_a_stated_prior() {
    let trials = trials();
    let model = arm();
    let own = |key: &str| terms(&model, &[key])[0].prior_sigma();
    let priors =
        FAMILIES.map(|key| TermPrior { family: key.to_owned(), length: None, angle: Some(own(key)) });
    let options = IdentificationOptions { term_priors: priors.into(), ..options(&FAMILIES, None) };
    let counts = held_in(&FAMILIES, &options, trials, 1.0);
    assert_held(&counts, trials.into());
}

/// Two machines that differ by a factor of ten in how smooth they are, and one prior for both that says neither.
#[test]
fn the_size_of_smooth_terms_is_found_where_nobody_states_it() {
    let trials = trials() / 4;
    for larger in [0.3, 3.0] {
        let counts = held_in(&["spline"], &options(&["spline"], None), trials, larger);
        let held = counts.iter().map(|(_, held)| held).sum::<u64>() as f64;
        let share = held / (f64::from(trials) * counts.len() as f64);
        println!("{larger} times the size: {share:.4} of the intervals hold");
        assert!((0.92..=0.98).contains(&share), "{share}");
        let model = arm();
        let ids = terms(&model, &["spline"]);
        let mut rng = stream(25, 0, StreamSource::AsBuilt);
        let normal = Normal::new(0.0, 1.0).expect("a width");
        let truth: Vec<_> =
            ids.iter().map(|id| (*id, larger * id.prior_sigma() * normal.sample(&mut rng))).collect();
        let set = session(&model, &truth, 200, 1, 1.0);
        let estimate = identify(&model, &set, &options(&["spline"], None)).expect("an estimate");
        let parameter = estimate.parameters.iter().find(|p| p.id == ParameterId::Term(ids[0]));
        let found = parameter.and_then(|p| p.prior_sigma).expect("a size") / ids[0].prior_sigma();
        // Of so many amplitudes that are all but measured, the mean square is chi-square: 99.9 % of it.
        let drawn = (truth.iter().map(|(id, v)| (v / id.prior_sigma()).powi(2)).sum::<f64>()
            / truth.len() as f64)
            .sqrt();
        println!("found {found:.3}, drawn {drawn:.3}");
        assert!((found / drawn).ln().abs() < 3.3 / (2.0 * truth.len() as f64).sqrt(), "{found} {drawn}");
    }
}

/// What a machine without any shows is next to no size: asking for it hardly makes predictions worse.
#[test]
fn a_machine_without_smooth_errors_shows_none() {
    let model = arm();
    for trial in 0..5 {
        let set = session(&model, &[], 60, trial, 1.0);
        let estimate = identify(&model, &set, &options(&["spline"], None)).expect("an estimate");
        let plain = identify(&model, &set, &options(&[], None)).expect("an estimate");
        let of = |estimate: &Estimate| {
            let errors = Predictor::new(&estimate.robot).expect("a robot").errors(&session(
                &model,
                &[],
                200,
                100,
                0.0,
            ));
            (errors.expect("poses").iter().map(Vector3::norm_squared).sum::<f64>() / 200.0).sqrt()
        };
        let (with, without) = (of(&estimate), of(&plain));
        println!("{trial}: {:.2} um with, {:.2} um without", 1e6 * with, 1e6 * without);
        // A size that is taken on the large side costs some per cent.
        assert!(with < 1.1 * without, "{with} {without}");
    }
}
