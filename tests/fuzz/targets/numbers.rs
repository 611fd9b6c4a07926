//! Public functions of numbers, at extremes; and identification of robots in code.

use calibrig::evaluation::iso9283::{position_accuracy, position_repeatability};
use calibrig::evaluation::{accuracy, chi2_band};
use calibrig::files::rotation_of_matrix;
use calibrig::geometry::{best_fit_transform, rotation_vector};
use calibrig::identification::{IdentificationOptions, Mode, SolverOptions, identify as fit};
use calibrig::kinematics::{forward_kinematics, target_in_base};
use calibrig::measurement::{MeasurementSet, Reading, combine};
use calibrig::model::{CalibrationModel, CraigLink, JointKind};
use calibrig::nalgebra::{Matrix3, Vector3};
use calibrig::statistics::{
    beta_regularised, binomial_cdf, chi2_cdf, chi2_quantile, chi2_survival, clopper_pearson, f_ln_survival,
    ln_gamma, normal_quantile, normal_survival, student_t_quantile,
};

use super::choices::Choices;

/// Distributions, rotations and best fits: a number where there is one, within its range.
pub fn numbers(data: &[u8]) {
    let choices = &mut Choices::new(data);
    match choices.below(4) {
        0 => distributions(choices),
        1 => rotations(choices),
        2 => points(choices),
        _ => poses(choices),
    }
}

/// Of counts, beyond which distributions of them are documented to be none.
const MOST: f64 = 1e9;

fn is_probability(p: f64) -> bool {
    (0.0..=1.0).contains(&p)
}

/// One distribution an input: of large counts a quantile takes thousands of times as long as what else is looked at here.
fn distributions(choices: &mut Choices<'_>) {
    let p = if choices.below(2) == 0 { choices.fraction() } else { choices.number() };
    match choices.below(5) {
        0 => normal(p, choices.number()),
        1 => chi2(p, of_counts(choices), choices.number()),
        2 => student(p, of_counts(choices)),
        3 => beta(p, [of_counts(choices), of_counts(choices)], choices.number()),
        _ => binomial(p, choices),
    }
}

/// Degrees of freedom and the like: mostly few, now and then anything but what a series takes long for.
fn of_counts(choices: &mut Choices<'_>) -> f64 {
    if !choices.one_in(64) {
        return choices.moderate().abs().min(1e3);
    }
    let any = choices.number();
    if any > 1e4 && any < 3.0 * MOST { 1e4 } else { any }
}

fn is_positive(x: f64) -> bool {
    x > 0.0 && x.is_finite()
}

fn normal(p: f64, z: f64) {
    if !z.is_nan() {
        assert!(is_probability(normal_survival(z)), "normal_survival({z}) = {}", normal_survival(z));
    }
    if is_probability(p) {
        assert!(!normal_quantile(p).is_nan(), "normal_quantile({p})");
    }
}

fn chi2(p: f64, dof: f64, x: f64) {
    if !is_positive(dof) {
        return;
    }
    assert!(!ln_gamma(dof).is_nan(), "ln_gamma({dof})");
    for (name, found) in [("cdf", chi2_cdf(x.abs(), dof)), ("survival", chi2_survival(x.abs(), dof))] {
        assert!(x.is_nan() || is_probability(found), "chi2 {name} of {x} at {dof}: {found}");
    }
    if is_probability(p) {
        let found = chi2_quantile(p, dof);
        assert!(found >= 0.0, "chi2_quantile({p}, {dof}) = {found}");
        let (low, high) = chi2_band(dof, p);
        assert!(low <= high, "chi2_band({dof}, {p}) = {low}, {high}");
    }
}

fn student(p: f64, dof: f64) {
    if is_positive(dof) && is_probability(p) {
        let found = student_t_quantile(p, dof);
        assert!(!found.is_nan(), "student_t_quantile({p}, {dof}) = {found}");
    }
}

fn beta(p: f64, [a, b]: [f64; 2], x: f64) {
    if !is_positive(a) || !is_positive(b) || a.max(b) > MOST {
        return;
    }
    if is_probability(p) {
        let found = beta_regularised(a, b, p);
        assert!(is_probability(found), "beta_regularised({a}, {b}, {p}) = {found}");
    }
    if x >= 0.0 {
        let found = f_ln_survival(x, a, b);
        assert!(found <= 0.0, "f_ln_survival({x}, {a}, {b}) = {found}");
    }
}

fn binomial(p: f64, choices: &mut Choices<'_>) {
    let most = if choices.one_in(64) { 7 } else { 5 };
    let trials: u64 = [0, 1, 2, 10, 1000, 10_000, 3_000_000_000][choices.below(most)];
    let hits =
        [0, 1, trials / 2, trials.saturating_sub(1), trials, trials.saturating_add(1)][choices.below(6)];
    if !is_probability(p) {
        return;
    }
    if trials as f64 > MOST {
        assert!(hits >= trials || binomial_cdf(hits, trials, p).is_nan(), "{hits}, {trials}, {p}");
        return;
    }
    assert!(is_probability(binomial_cdf(hits, trials, p)), "binomial_cdf({hits}, {trials}, {p})");
    if hits <= trials {
        let (low, high) = clopper_pearson(hits, trials, p);
        let is_interval = is_probability(low) && is_probability(high) && low <= high;
        assert!(is_interval, "{low} {high}: {hits}, {trials}, {p}");
    }
}

fn vector(choices: &mut Choices<'_>) -> Vector3<f64> {
    Vector3::from_fn(|_, _| choices.number())
}

fn rotations(choices: &mut Choices<'_>) {
    let matrix = match choices.below(2) {
        0 => Matrix3::from_fn(|_, _| choices.number()),
        // Nearly one.
        _ => Matrix3::identity() + Matrix3::from_fn(|_, _| 1e-5 * choices.fraction()),
    };
    if let Ok(rotation) = rotation_of_matrix(&matrix) {
        let off = (rotation.matrix().transpose() * rotation.matrix() - Matrix3::identity()).amax();
        assert!(off < 1e-12, "{matrix} gives {rotation}");
        let vector = rotation_vector(&rotation);
        assert!(vector.norm() < 3.2, "{vector}");
    }
}

fn points(choices: &mut Choices<'_>) {
    let count = choices.below(6);
    let identical = choices.one_in(4);
    let first = vector(choices);
    let mut draw = || (0..count).map(|_| if identical { first } else { vector(choices) }).collect::<Vec<_>>();
    let (a, b) = (draw(), draw());
    if let Some(frame) = best_fit_transform(&a, &b) {
        let off =
            (frame.rotation.matrix().transpose() * frame.rotation.matrix() - Matrix3::identity()).amax();
        assert!(off < 1e-9, "{a:?} {b:?}: {frame}");
    }
    let finite = a.iter().flatten().all(|number| number.abs() <= 1e15);
    if let (Some(row), true) = (accuracy(&a), finite) {
        assert!(row.rms_3d.is_finite() && row.max_3d.is_finite(), "{a:?}: {row:?}");
    }
    // Its interval is drawn thousands of times.
    if choices.one_in(64)
        && let (Some(found), true) = (position_repeatability(&a), finite)
    {
        assert!(!format!("{found:?}").contains("NaN"), "{a:?}: {found:?}");
    }
    if let (Some(found), true) = (position_accuracy(&a), finite) {
        assert!(!format!("{found:?}").contains("NaN"), "{a:?}: {found:?}");
    }
    let readings: Vec<_> =
        b.iter().map(|position| Reading::Cartesian { position: *position, covariance: None }).collect();
    let pairs: Vec<_> = a.iter().copied().zip(&readings).collect();
    if let Ok(pose) = combine(&pairs) {
        assert!(pose.position.iter().all(|x| x.is_finite()), "{a:?} {b:?}: {pose:?}");
    }
}

/// Forward kinematics of a chain of anything.
fn poses(choices: &mut Choices<'_>) {
    let links = (0..choices.below(8)).map(|_| link(choices, false)).collect();
    let Ok(model) = CalibrationModel::new(links) else { return };
    let q: Vec<f64> = model.kinematics.links.iter().map(|_| choices.number()).collect();
    // In code nothing keeps lengths below what a product of frames can hold.
    let lengths = model.kinematics.links.iter().flat_map(|link| [link.a, link.d]).chain(q.iter().copied());
    let small = lengths.fold(0.0, |most: f64, length| most.max(length.abs())) < 1e300;
    if let Ok(frame) = forward_kinematics(&model.kinematics, &q) {
        let finite = frame.to_homogeneous().iter().all(|number| number.is_finite());
        assert!(finite || !small, "{:?} at {q:?}: {frame}", model.kinematics);
    }
}

fn link(choices: &mut Choices<'_>, sized: bool) -> CraigLink {
    let kind = choices.below(4);
    let mut number = || match choices.below(4) {
        0 => 0.0,
        1 => std::f64::consts::FRAC_PI_2,
        2 if !sized => choices.number(),
        2 => choices.number().clamp(-1e15, 1e15),
        _ => choices.moderate() / 100.0,
    };
    let link = if kind == 3 { CraigLink::prismatic("p") } else { CraigLink::revolute("r") };
    let link = link.row(number(), number(), number(), number()).with_beta(number());
    if kind == 3 { link.limits(-1.0, 1.0) } else { link.limits(-3.0, 3.0) }
}

/// Identification of a robot in code, of any number of poses.
pub fn identify(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let mut links: Vec<CraigLink> = (0..=choices.below(7)).map(|_| link(choices, true)).collect();
    if choices.one_in(8) {
        // Identical joints.
        let first = links[0].clone();
        links.fill(first);
    }
    if let Ok(model) = CalibrationModel::new(links) {
        identify_with(&model, choices);
    }
}

/// Measurements of this robot, nearly or not at all as it would give them, and what is identified from them.
pub fn identify_with(model: &CalibrationModel, choices: &mut Choices<'_>) {
    let count = [1, 2, 3, 6, 20][choices.below(5)];
    let in_flange = Vector3::from_fn(|_, _| choices.moderate() / 1e3);
    let error = [0.0, 1e-15, 1e-5, 1e-3, 1.0, 1e6][choices.below(6)];
    let mut phase = choices.fraction();
    let mut points = Vec::new();
    for _ in 0..count {
        let joint = |link: &CraigLink| {
            phase = (phase * 1.7 + 0.313).fract();
            let far = if link.kind == JointKind::Revolute { 3.0 } else { 10.0 };
            let [low, high] = link.limits.map(|limit| limit.clamp(-far, far));
            low + phase * (high - low)
        };
        let q: Vec<f64> = model.kinematics.links.iter().map(joint).collect();
        let Ok(target) = target_in_base(&model.kinematics, &q, &in_flange) else { return };
        let off = Vector3::from_fn(|_, _| {
            phase = (phase * 1.7 + 0.313).fract();
            error * (phase - 0.5)
        });
        points.push((model.actuators.command_from_joints(&q), target + off));
    }
    let set = MeasurementSet::of_points(points);
    let set =
        if choices.below(2) == 0 { set.with_sigma([1e-5, 1e-15, 1e15, 1.0][choices.below(4)]) } else { set };
    check_estimate(model, &set, choices);
}

/// An estimate has numbers in it, or there is none.
pub fn check_estimate(model: &CalibrationModel, set: &MeasurementSet, choices: &mut Choices<'_>) {
    let options = IdentificationOptions {
        mode: *choices.pick(&Mode::ALL),
        solver: SolverOptions { max_iterations: 10, ..SolverOptions::default() },
        ..IdentificationOptions::default()
    };
    let Ok(estimate) = fit(model, set, &options) else { return };
    for parameter in &estimate.parameters {
        assert!(parameter.value.is_finite(), "{parameter:?}");
        assert!(parameter.sigma.is_none_or(|sigma| sigma >= 0.0 && sigma.is_finite()), "{parameter:?}");
    }
    assert!(estimate.chi2 >= 0.0, "chi2 is {}", estimate.chi2);
    let command = &set.observations[0].command;
    if let Ok(there) = estimate.predict(command) {
        assert!(there.position.iter().all(|x| x.is_finite()), "{there:?}");
        assert!(there.sigma().is_none_or(|sigma| sigma.iter().all(|s| s.is_finite())), "{there:?}");
    }
}
