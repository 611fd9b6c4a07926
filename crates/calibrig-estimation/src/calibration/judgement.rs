//! How far an estimate can be trusted: what its residuals still contain, what each parameter rests on, and how well it predicts.

use std::fmt;

use nalgebra::{DVector, Vector3};

use super::CalibrateError;
use super::residuals::{ObservationResidual, residuals};
use super::worth::{Worse, worse};
use crate::evaluation::{
    ChiSquareTest, ConsistencyReport, ModeOutcome, PoseConditions, ResidualSet, ScatterComparison,
    check_consistency, compare_scatter,
};
use crate::identification::{
    Estimate, IdentificationOptions, Linearisation, Mode, NoiseScale, Outlier, ParameterSupport,
    PoseInfluence, Prediction, Predictor, Uncertainty, Warning, held_out_outliers, linearise,
    predict_readings,
};
use calibrig_model::measurement::{MeasurementSet, Observation, SetKind, SetOutcome};
use calibrig_model::{CalibrationModel, ParameterId, PoseQuery, STANDARD_GRAVITY};

/// Probability of a false alarm of each test of the residuals' size or shape.
pub const FALSE_ALARM: f64 = 0.001;
/// Correlations from this size on are listed.
const STRONG: f64 = 0.9;
/// Number of poses of the map.
const MAP_POSES: u32 = 400;
/// Step of an actuator for the derivative of its target's position, m or rad.
const STEP: f64 = 1e-4;

/// What speaks for and against an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// Mode of the estimate.
    pub mode: Mode,
    /// Size and shape of the residuals.
    pub consistency: ConsistencyReport,
    /// Change of the target's position in the base frame with every actuator, one vector per observation of the identification set, m/m or m/rad;
    /// empty where the robot cannot take the neighbouring poses.
    pub sensitivity: Vec<Vec<Vector3<f64>>>,
    /// Compliances and terms whose identification makes held-out poses worse.
    pub worse: Vec<Worse>,
    /// Uncertainty of the estimate; `None` for a singular system.
    pub confidence: Option<Confidence>,
    /// Whether the residuals are those of one robot and its noise: no gross error carries weight in the fit, and the robot fits the points. If not,
    /// the residuals' size and shape are not tested, since they would say nothing of what the model lacks.
    pub makes_sense: bool,
    /// Gross errors in the held-out sets.
    pub held_out: Vec<(SetKind, Vec<Outlier>)>,
    /// Held-out sets that are outside the stated intervals.
    pub outside: Vec<Outside>,
    /// Residual of every reading, one list per set.
    pub residuals: Vec<Vec<ObservationResidual>>,
    /// Stated against observed scatter of the readings, one entry per set.
    pub scatter: Vec<Option<ScatterComparison>>,
}

impl Judgement {
    /// Whether nothing speaks against the model and the stated noise.
    pub fn is_consistent(&self) -> bool {
        self.makes_sense && self.outside.is_empty() && self.consistency.is_consistent()
    }

    /// What a person must look at beside the estimate's own [reasons](Estimate::reasons): key and words.
    pub fn reasons(&self) -> impl Iterator<Item = (&'static str, String)> {
        let worse = self.worse.iter().filter(|worse| worse.is_doubtful);
        let outside = self.outside.iter().map(|outside| ("held_out", outside.to_string()));
        worse.map(|worse| ("worse", worse.to_string())).chain(outside)
    }
}

/// A held-out set that is outside the stated intervals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outside {
    /// Which set.
    pub kind: SetKind,
    /// Number of readings inside their 95 % ellipsoids.
    pub inside: usize,
    /// Number of all readings of the set.
    pub of: usize,
}

impl fmt::Display for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let share = 1e2 * self.inside as f64 / self.of as f64;
        write!(
            f,
            "{share:.0} % of the {} readings of the {} set lie where the 95 % intervals say: it is of another target, the station or the robot \
             changed between the sets, or the model lacks what the poses of this set need",
            self.of,
            self.kind.key()
        )
    }
}

/// A set contradicts the intervals if less than this share is inside. Its readings depend on each other through the parameters, so that even a
/// good estimate can have far fewer than 95 % inside.
const FEW_INSIDE: f64 = 0.5;
/// Fewest readings from which a set is judged.
const LEAST_READINGS: usize = 4;
/// 95 % points of chi-square for three normal coordinates and for one.
const SQUARES_95: [f64; 2] = [7.815, 3.841];

/// Whether a held-out set is outside what the estimate states for new readings.
fn outside(
    model: &CalibrationModel,
    set: &SetOutcome,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Option<Outside> {
    let predicted = predict_readings(model, &set.measurements, options, estimate).ok()??;
    // Student's distribution widens three coordinates by the same factor as one.
    let square = SQUARES_95[0] * estimate.interval_factor(0.95).powi(2) / SQUARES_95[1];
    let (mut inside, of) = (0, predicted.len());
    for (observation, predicted) in set.measurements.observations.iter().zip(&predicted) {
        let own = estimate.reading_covariance(observation.reading.position_covariance());
        let covariance = predicted.of_parameters + predicted.of_machine + own;
        let off = covariance.cholesky()?.solve(&predicted.error).dot(&predicted.error);
        inside += usize::from(off <= square);
    }
    let contradicts = of >= LEAST_READINGS && (inside as f64) < FEW_INSIDE * of as f64;
    contradicts.then_some(Outside { kind: set.kind, inside, of })
}

/// Uncertainty of an estimate, if the stated noise is right.
#[derive(Debug, Clone, PartialEq)]
pub struct Confidence {
    /// What each parameter rests on, in the order of the parameters.
    pub support: Vec<ParameterSupport>,
    /// Pairs of parameters whose correlation is 0.9 or more in size, strongest first.
    pub correlations: Vec<(ParameterId, ParameterId, f64)>,
    /// Number of parameters that the data determine.
    pub effective_parameters: f64,
    /// Influence of every observation of the identification set.
    pub influences: Vec<PoseInfluence>,
    /// Error of every observation if it had been left out of the fit, measured minus predicted in the base frame, m (to first order).
    pub left_out: Vec<Option<Vector3<f64>>>,
    /// Uncertainty of the target's predicted position: one list per set, one entry per observation; `None` where the robot cannot take a pose.
    pub at_poses: Vec<Vec<Option<PredictedPosition>>>,
    /// Uncertainty over the box of joint variables that the measured poses span.
    pub map: Vec<PredictedPosition>,
    /// Number of poses of that box that the robot cannot take.
    pub out_of_reach: usize,
}

/// A predicted position in the base frame with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictedPosition {
    /// Predicted position, m.
    pub position: Vector3<f64>,
    /// Standard deviations along the base's axes, m.
    pub sigma: Vector3<f64>,
}

impl PredictedPosition {
    /// Root mean square length of the error, m.
    pub fn length(&self) -> f64 {
        self.sigma.norm()
    }
}

impl Confidence {
    /// RMS of the 3-D errors of observations that are left out one at a time, m; `None` where one of them alone determines a direction.
    pub fn left_out_rms(&self) -> Option<f64> {
        let squares: Option<Vec<_>> = self.left_out.iter().map(|e| e.map(|e| e.norm_squared())).collect();
        squares.filter(|s| !s.is_empty()).map(|s| (s.iter().sum::<f64>() / s.len() as f64).sqrt())
    }
}

/// Judges every estimate of `modes`, which [`calibrate`](super::calibrate) made from the same model, sets and options.
pub fn judge(
    model: &CalibrationModel,
    sets: &[SetOutcome],
    modes: &[ModeOutcome],
    options: &IdentificationOptions,
) -> Result<Vec<Judgement>, CalibrateError> {
    let Some(fitted) = sets.first().map(|set| &set.measurements) else { return Ok(Vec::new()) };
    let region = region(model, sets);
    modes
        .iter()
        .filter_map(|outcome| Some((outcome, outcome.estimate.as_ref()?)))
        .map(|(outcome, estimate)| {
            let mode = outcome.mode;
            let options = IdentificationOptions { mode, ..options.clone() };
            let failed = |source| CalibrateError::Identify { mode, source };
            let system = linearise(model, fitted, &options, estimate).map_err(failed)?;
            let sensitivity = sensitivity(estimate, fitted).unwrap_or_default();
            let mut predictor =
                estimate.predictor().map_err(|source| CalibrateError::Predict { mode, source })?;
            let worse = worse(model, &sets[0], &options, estimate, &system);
            let system = system.weighted(estimate);
            let confidence = uncertainty(&system, estimate).map(|uncertainty| {
                let at_poses: Vec<Vec<_>> = sets
                    .iter()
                    .map(|set| {
                        set.measurements.observations.iter().map(|o| predictor.predict(o).ok()).collect()
                    })
                    .collect();
                let map: Vec<_> = region.iter().map(|pose| predictor.predict(pose.query()).ok()).collect();
                confidence(&system, &uncertainty, &at_poses, &map)
            });
            let makes_sense = !estimate
                .reasons()
                .any(|reason| matches!(reason, Warning::Outliers(_) | Warning::OffThePoints { .. }));
            let consistency = if makes_sense {
                consistency(model, fitted, estimate, &system, &sensitivity)
            } else {
                ConsistencyReport { size: None, shape: None, level: FALSE_ALARM }
            };
            let held_out = sets
                .iter()
                .zip(&outcome.errors)
                .skip(1)
                .map(|(set, errors)| (set.kind, held_out_outliers(&set.measurements, errors)));
            let held_out = held_out.filter(|(_, outliers)| !outliers.is_empty()).collect();
            // The intervals of an estimate that is doubted for another reason are not expected to hold.
            let held_out_sets = sets.iter().skip(1).filter(|_| estimate.is_sound());
            let outside = held_out_sets.filter_map(|set| outside(model, set, &options, estimate)).collect();
            let of_set = |(index, (set, errors)): (usize, (&SetOutcome, &Vec<Vector3<f64>>))| {
                residuals(model, (&set.measurements, errors), &options, estimate, index == 0)
            };
            let residuals = sets.iter().zip(&outcome.errors).enumerate().map(of_set).collect();
            let scatter = scatter(sets, outcome, estimate, confidence.as_ref());
            Ok(Judgement {
                mode,
                consistency,
                sensitivity,
                worse,
                confidence,
                makes_sense,
                held_out,
                outside,
                residuals,
                scatter,
            })
        })
        .collect()
}

/// Stated and observed scatter of every set; the first is the one that was fitted.
fn scatter(
    sets: &[SetOutcome],
    outcome: &ModeOutcome,
    estimate: &Estimate,
    confidence: Option<&Confidence>,
) -> Vec<Option<ScatterComparison>> {
    let of_set = |(index, (set, errors)): (usize, (&SetOutcome, &Vec<Vector3<f64>>))| {
        let observations = &set.measurements.observations;
        let in_tracker = |(observation, error): (&Observation, &Vector3<f64>)| {
            let place = estimate.robot.stations.get(observation.station);
            place.map_or(*error, |place| place.rotation * error)
        };
        let errors: Vec<_> = observations.iter().zip(errors).map(in_tracker).collect();
        let left: Vec<f64> = match confidence {
            _ if index > 0 => Vec::new(),
            Some(confidence) => confidence
                .influences
                .iter()
                .map(|influence| (1.0 - influence.leverage / 3.0).max(0.0))
                .collect(),
            // For a singular system no leverage is known: it is taken as the same for all.
            None => {
                let rows = 3.0 * observations.len() as f64;
                vec![(estimate.degrees_of_freedom / rows).clamp(0.0, 1.0); observations.len()]
            }
        };
        compare_scatter(&set.measurements, &errors, &left)
    };
    sets.iter().zip(&outcome.errors).enumerate().map(of_set).collect()
}

fn uncertainty(system: &Linearisation, estimate: &Estimate) -> Option<Uncertainty> {
    // Without the tolerance the system has too low a rank to state a covariance; then none is stated here either.
    estimate.covariance.as_ref()?;
    let ids: Vec<_> = estimate.parameters.iter().map(|p| p.id).collect();
    Uncertainty::of(system, &ids)
}

fn confidence(
    system: &Linearisation,
    uncertainty: &Uncertainty,
    at_poses: &[Vec<Option<Prediction>>],
    map: &[Option<Prediction>],
) -> Confidence {
    let place = |prediction: &Option<Prediction>| {
        let prediction = prediction.as_ref()?;
        let covariance = uncertainty.position_covariance(&prediction.jacobian)? + prediction.of_machine;
        let sigma = covariance.diagonal().map(|v| v.max(0.0).sqrt());
        let finite = sigma.iter().chain(prediction.position.iter()).all(|v| v.is_finite());
        finite.then_some(PredictedPosition { position: prediction.position, sigma })
    };
    let residuals = system.residuals.as_slice();
    let influences = influences(system, uncertainty, residuals);
    let left_out = left_out(system, &influences);
    let map: Vec<_> = map.iter().map(place).collect();
    Confidence {
        support: uncertainty.support(),
        correlations: uncertainty.strongest_correlations(STRONG),
        effective_parameters: uncertainty.effective_parameters(),
        influences,
        left_out,
        at_poses: at_poses.iter().map(|set| set.iter().map(place).collect()).collect(),
        out_of_reach: map.iter().filter(|p| p.is_none()).count(),
        map: map.into_iter().flatten().collect(),
    }
}

/// Influence of every observation; an orientation takes part of its observation's leverage, and is left out together with it.
fn influences(system: &Linearisation, uncertainty: &Uncertainty, residuals: &[f64]) -> Vec<PoseInfluence> {
    let mut all = uncertainty.influences(&system.jacobian, residuals, system.data_rows, &system.poses);
    let observations = system.whitening.observations();
    let orientations = all.split_off(observations.min(all.len()));
    for (orientation, observation) in orientations.iter().zip(&system.orientations) {
        if let Some(own) = all.get_mut(*observation) {
            own.leverage += orientation.leverage;
        }
    }
    all
}

/// Errors of observations that were left out of the fit, m; `None` where one pose alone determines a direction.
fn left_out(system: &Linearisation, influences: &[PoseInfluence]) -> Vec<Option<Vector3<f64>>> {
    let mut rows = DVector::zeros(system.data_rows);
    for (i, influence) in influences.iter().enumerate() {
        rows.fixed_rows_mut::<3>(3 * i).copy_from(&-influence.left_out.unwrap_or_default());
    }
    let errors = system.whitening.displacements(&rows);
    influences.iter().zip(errors).map(|(influence, error)| influence.left_out.map(|_| error)).collect()
}

fn consistency(
    model: &CalibrationModel,
    set: &MeasurementSet,
    estimate: &Estimate,
    system: &Linearisation,
    sensitivity: &[Vec<Vector3<f64>>],
) -> ConsistencyReport {
    if system.residuals.iter().chain(system.jacobian.iter()).any(|v| !v.is_finite()) {
        return ConsistencyReport { size: None, shape: None, level: FALSE_ALARM };
    }
    let mut predictor = Predictor::new(&estimate.robot).ok();
    let stated = model.statics.as_ref().map(|statics| statics.gravity);
    // A robot without a stated direction of gravity is assumed to stand upright.
    let gravity = stated.unwrap_or(Vector3::new(0.0, 0.0, -STANDARD_GRAVITY));
    let poses: Vec<_> = set
        .observations
        .iter()
        .enumerate()
        .map(|(i, observation)| PoseConditions {
            command: &observation.command,
            approach: &observation.approach,
            time: observation.time,
            temperature: observation.temperature,
            position: predictor.as_mut().and_then(|p| p.in_base(observation).ok()).unwrap_or_default(),
            sensitivity: sensitivity.get(i).map_or(&[][..], Vec::as_slice),
            load: observation.payload.as_ref().map_or(Vector3::zeros(), |p| p.mass * gravity + p.force),
            pose: observation.pose,
            seen: (observation.target, observation.station),
        })
        .collect();
    let names: Vec<_> = model.kinematics.links.iter().map(|link| link.name.clone()).collect();
    let residuals = ResidualSet {
        residuals: &system.residuals,
        jacobian: &system.jacobian,
        measured_rows: system.measured_rows,
        freedom: system.freedom(),
        whitening: &system.whitening,
        poses: &poses,
        joint_names: &names,
        motor_turns: &model.motor_turns,
    };
    let size = match estimate.noise {
        NoiseScale::Stated => ChiSquareTest::new(estimate.chi2, estimate.degrees_of_freedom),
        NoiseScale::Residuals(_) => None,
    };
    check_consistency(&residuals, size, FALSE_ALARM)
}

/// Derivative of every observation's target by every actuator, by central differences; `None` where the robot cannot take one of the poses.
fn sensitivity(estimate: &Estimate, set: &MeasurementSet) -> Option<Vec<Vec<Vector3<f64>>>> {
    let mut predictor = Predictor::new(&estimate.robot).ok()?;
    set.observations
        .iter()
        .map(|observation| {
            let mut command = observation.command.clone();
            let mut at = |joint: usize, step: f64| {
                command[joint] = observation.command[joint] + step;
                let position = predictor.in_base(PoseQuery { command: &command, ..observation.into() }).ok();
                command[joint] = observation.command[joint];
                position
            };
            let derivative = |joint| Some((at(joint, STEP)? - at(joint, -STEP)?) / (2.0 * STEP));
            (0..observation.command.len()).map(derivative).collect()
        })
        .collect()
}

/// A pose of the working region.
struct RegionPose {
    command: Vec<f64>,
    approach: Vec<i8>,
}

impl RegionPose {
    fn query(&self) -> PoseQuery<'_> {
        PoseQuery::at(&self.command).approached(&self.approach)
    }
}

/// Poses that evenly fill the box of joint variables that the measured poses of all sets span, the same for the same sets; the approaches
/// alternate.
fn region(model: &CalibrationModel, sets: &[SetOutcome]) -> Vec<RegionPose> {
    let mut range = vec![(f64::INFINITY, f64::NEG_INFINITY); model.kinematics.joint_count()];
    let mut joints = vec![0.0; range.len()];
    let mut any = false;
    for observation in sets.iter().flat_map(|set| &set.measurements.observations) {
        if observation.command.len() != joints.len() {
            continue;
        }
        model.actuators.joints_from_command(&observation.command, &mut joints);
        for ((low, high), q) in range.iter_mut().zip(&joints) {
            (*low, *high) = (low.min(*q), high.max(*q));
        }
        any = true;
    }
    let pose = |index: u32| {
        let shares = evenly(index, range.len());
        let joints: Vec<_> =
            range.iter().zip(shares).map(|((low, high), s)| low + (high - low) * s).collect();
        RegionPose {
            command: model.actuators.command_from_joints(&joints),
            approach: (0..joints.len())
                .map(|joint| if index >> (joint % 32) & 1 == 0 { -1 } else { 1 })
                .collect(),
        }
    };
    if any { (0..MAP_POSES).map(pose).collect() } else { Vec::new() }
}

/// Point `index` of an additive recurrence that evenly fills the unit cube of `dimensions`: its steps are powers of 1/g with
/// `g^(dimensions + 1) = g + 1`, the golden ratio for one dimension.
///
/// Source: M. Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018).
fn evenly(index: u32, dimensions: usize) -> impl Iterator<Item = f64> {
    let power = 1.0 / (dimensions as f64 + 1.0);
    let mut g = 2.0_f64;
    for _ in 0..60 {
        g = (1.0 + g).powf(power);
    }
    (1..=dimensions).map(move |k| (0.5 + f64::from(index + 1) / g.powf(k as f64)).fract())
}
