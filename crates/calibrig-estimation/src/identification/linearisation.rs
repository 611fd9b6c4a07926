//! The whitened system at an estimate, from which uncertainty, leverage and residual patterns are computed.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Vector3, Vector6};

use super::build::{rebuild, start};
use super::factorised::determined_by;
use super::identify::check;
use super::noise::{ActuatorMotions, Noise};
use super::problem::{CalibrationProblem, whiten_together};
use super::shared::SharedWhitening;
use super::{Estimate, IdentificationOptions, IdentifyError, MachineNoise, MachineNoiseChoice, NoiseScale};
use calibrig_model::geometry::{Transform, small_displacement};
use calibrig_model::measurement::{MeasurementSet, Observation, Reading};
use calibrig_model::{CalibrationModel, ParameterId};

/// Residuals and Jacobian of a fit at its estimate. A residual of 1 is one standard deviation.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearisation {
    /// m x n, in the order of the estimate's parameters; rows of the observations and their orientations, then of nests and target, then of the other
    /// priors.
    pub jacobian: DMatrix<f64>,
    /// Predicted minus measured, and the priors, in standard deviations; m rows.
    pub residuals: DVector<f64>,
    /// Number of the first rows, in blocks of three: one per observation, then one per orientation.
    pub data_rows: usize,
    /// Observation of every orientation, by index.
    pub orientations: Vec<usize>,
    /// Number of these rows and the rows of nests and targets behind them.
    pub measured_rows: usize,
    /// Blocks of every pose: its observations and their orientations.
    pub poses: Vec<Vec<usize>>,
    /// Maps displacements of the observations' targets to standard deviations.
    pub whitening: Whitening,
    /// Columns held at a bound: they have no spread.
    pub bounded: Vec<usize>,
}

const LEAST_WEIGHT: f64 = 1e-12;

/// Maps displacements of targets in the base frame, m, to the standard deviations of the data rows. The observations of a pose share its errors,
/// and are mapped to independent rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Whitening {
    /// One matrix per observation.
    pub(super) single: Vec<Matrix3<f64>>,
    /// Poses whose observations depend on each other: their indices, and the further map that makes their rows independent.
    pub(super) joined: Vec<(Vec<usize>, DMatrix<f64>)>,
    /// The further map where many readings share errors.
    pub(super) shared: Option<SharedWhitening>,
}

impl Whitening {
    /// The whitening of independent observations: one matrix each.
    pub fn apart(single: Vec<Matrix3<f64>>) -> Self {
        Self { single, ..Self::default() }
    }

    /// Number of observations.
    pub fn observations(&self) -> usize {
        self.single.len()
    }

    /// The data rows of displacements, one per observation, m; missing displacements are zero.
    pub fn rows(&self, displacements: impl Iterator<Item = Vector3<f64>>) -> DVector<f64> {
        let mut rows = DVector::zeros(3 * self.single.len());
        for (i, (whitening, displacement)) in self.single.iter().zip(displacements).enumerate() {
            rows.fixed_rows_mut::<3>(3 * i).copy_from(&(whitening * displacement));
        }
        for (pose, whitening) in &self.joined {
            let count = rows.len();
            whiten_together(pose, whitening, rows.as_mut_slice(), count);
        }
        if let Some(shared) = &self.shared {
            let count = rows.len();
            rows = rows.resize_vertically(shared.rows(), 0.0);
            shared.apply(&mut rows);
            rows = rows.resize_vertically(count, 0.0);
        }
        rows
    }

    /// The displacements of data rows, m: the inverse of [`rows`](Self::rows). Rows beyond the observations are ignored.
    pub fn displacements(&self, rows: &DVector<f64>) -> Vec<Vector3<f64>> {
        let mut rows = rows.clone();
        if let Some(shared) = &self.shared {
            rows = rows.resize_vertically(shared.rows(), 0.0);
            shared.undo(&mut rows);
        }
        let count = rows.len().min(3 * self.single.len());
        rows = rows.resize_vertically(count, 0.0);
        for (pose, whitening) in &self.joined {
            let inverse =
                whitening.solve_lower_triangular(&DMatrix::identity(whitening.nrows(), whitening.nrows()));
            if let Some(inverse) = inverse.filter(|_| pose.iter().all(|i| 3 * i + 3 <= rows.len())) {
                let count = rows.len();
                whiten_together(pose, &inverse, rows.as_mut_slice(), count);
            }
        }
        let of = |(i, whitening): (usize, &Matrix3<f64>)| {
            let row: Vector3<f64> = rows.fixed_rows::<3>(3 * i).into_owned();
            whitening.lu().solve(&row).unwrap_or_else(|| Vector3::repeat(f64::NAN))
        };
        self.single.iter().enumerate().take(rows.len() / 3).map(of).collect()
    }

    /// Root mean square length of what is taken as noise of a single reading, m.
    pub fn noise(&self) -> f64 {
        let inverses = self.single.iter().filter_map(|whitening| whitening.try_inverse());
        let squares: f64 = inverses.map(|inverse| inverse.norm_squared()).sum();
        (squares / self.single.len().max(1) as f64).sqrt()
    }
}

impl Linearisation {
    /// Columns that are free.
    pub(super) fn free(&self) -> Vec<usize> {
        (0..self.jacobian.ncols()).filter(|column| !self.bounded.contains(column)).collect()
    }

    /// The system as it was solved, with the weights of the estimate's robust loss; its covariance is the estimate's.
    #[must_use]
    pub fn weighted(mut self, estimate: &Estimate) -> Self {
        let observations = (self.data_rows / 3).saturating_sub(self.orientations.len());
        for (i, weight) in estimate.weights.iter().enumerate().take(observations) {
            // An observation without weight still has an error of its own.
            let factor = (weight.max(LEAST_WEIGHT) / estimate.weight_unit).sqrt();
            let factor = if factor.is_finite() { factor } else { LEAST_WEIGHT };
            self.residuals.rows_mut(3 * i, 3).scale_mut(factor);
            self.jacobian.rows_mut(3 * i, 3).scale_mut(factor);
            if let Some(whitening) = self.whitening.single.get_mut(i) {
                *whitening *= factor;
            }
            if let Some(place) = self.orientations.iter().position(|own| *own == i) {
                let first = 3 * (observations + place);
                self.residuals.rows_mut(first, 3).scale_mut(factor);
                self.jacobian.rows_mut(first, 3).scale_mut(factor);
            }
        }
        self
    }

    /// Degrees of freedom of the measured rows: their number less the trace of their part of the hat matrix.
    pub fn freedom(&self) -> f64 {
        let determined = determined_by(&self.jacobian, self.measured_rows, &self.free());
        (self.measured_rows as f64 - determined).max(0.0)
    }
}

/// The system that `estimate` solves, evaluated at the estimate, with the noise that it was given or found, and without the weights of a robust
/// loss.
///
/// # Errors
///
/// [`IdentifyError`], where the estimate does not belong to model, set and options, or the estimated robot cannot take a pose.
pub fn linearise(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<Linearisation, IdentifyError> {
    let x: Vec<_> = estimate.parameters.iter().map(|p| p.value).collect();
    linearise_at(model, set, options, estimate, &x)
}

/// The system evaluated at `x`, values of the estimate's parameters in their order, SI.
pub(super) fn linearise_at(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
    x: &[f64],
) -> Result<Linearisation, IdentifyError> {
    check(model, set)?;
    options.check()?;
    if let Some(value) = x.iter().copied().find(|value| !value.is_finite()) {
        let field = "a value of estimate.parameters";
        return Err(IdentifyError::Number { field, value, expected: "a finite number" });
    }
    let mut problem = solved(model, set, options, estimate)?;
    let (residuals, jacobian) = start(&mut problem, x)?;
    let mut linearisation = Linearisation {
        jacobian,
        residuals,
        data_rows: problem.data_rows(),
        orientations: problem.turns.iter().map(|turn| turn.observation).collect(),
        measured_rows: problem.measured_rows(),
        poses: problem.poses.iter().map(|pose| problem.blocks_of(pose)).collect(),
        whitening: Whitening::default(),
        bounded: Vec::new(),
    };
    linearisation.whitening = problem.whitening();
    let is_bounded = |place: &usize| estimate.at_bound.contains(&problem.parameters[*place]);
    linearisation.bounded = (0..x.len()).filter(is_bounded).collect();
    Ok(linearisation)
}

/// A reading compared with the prediction of an estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictedReading {
    /// Predicted minus measured position in the tracker's frame, m.
    pub error: Vector3<f64>,
    /// Covariance of the prediction due to the estimate's parameters, including the tracker's place, m².
    pub of_parameters: Matrix3<f64>,
    /// Covariance due to the machine's noise beside its model, m².
    pub of_machine: Matrix3<f64>,
}

/// Predictions of `estimate` for the readings of any `set` of the same robot, stations and targets, with the uncertainty of the robot's place;
/// the noise of the readings is not included. `None` for an estimate without a covariance.
///
/// # Errors
///
/// As [`linearise`].
pub fn predict_readings(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<Option<Vec<PredictedReading>>, IdentifyError> {
    predict(model, set, options, estimate, Seen::ByTheInstrument)
}

/// Like [`predict_readings`], for true places of the targets in the trackers' frames, without instrument errors and drift: readings of a perfect
/// instrument. The uncertainty of the robot and the tracker's place that the real instrument's errors cause is still included.
///
/// # Errors
///
/// As [`linearise`].
pub fn predict_places(
    model: &CalibrationModel,
    places: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<Option<Vec<PredictedReading>>, IdentifyError> {
    predict(model, places, options, estimate, Seen::Truly)
}

/// What is predicted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Seen {
    /// Readings with the instrument's errors.
    ByTheInstrument,
    /// Places.
    Truly,
}

fn predict(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
    seen: Seen,
) -> Result<Option<Vec<PredictedReading>>, IdentifyError> {
    let Some(factor) = &estimate.factor else { return Ok(None) };
    let mut in_metres = set.clone();
    in_metres.stations.iter_mut().for_each(|station| station.motion = None);
    for observation in &mut in_metres.observations {
        // Weighed with one, residuals and Jacobian are in metres.
        match &mut observation.reading {
            Reading::Pose(pose) => pose.covariance = Some(Matrix6::identity()),
            other => {
                let position = other.position();
                *other = Reading::Cartesian { position, covariance: Some(Matrix3::identity()) };
            }
        }
    }
    let plain = IdentificationOptions {
        unmodelled_sigma: 0.0,
        machine_noise: MachineNoiseChoice::Stated(Vec::new()),
        ..options.clone()
    };
    let bare = Estimate {
        machine_noise: Vec::new(),
        turn_noise: None,
        reading_scale: None,
        noise: NoiseScale::Stated,
        ..estimate.clone()
    };
    check(model, set)?;
    let mut problem = solved(model, &in_metres, &plain, &bare)?;
    if seen == Seen::Truly {
        problem.rows.iter_mut().for_each(|row| row.instrument.clear());
    }
    // Where nothing places a station, its frame is displaced from its place in the fitted set.
    problem.stations = estimate.frame_origins();
    let x: Vec<f64> = estimate.parameters.iter().map(|parameter| parameter.value).collect();
    let (residuals, jacobian) = start(&mut problem, &x)?;
    let beside = estimate.beside();
    let mut motions = ActuatorMotions::new(model);
    let of = |(i, observation): (usize, &Observation)| {
        let spread = jacobian.fixed_rows::<3>(3 * i) * factor;
        let axes = estimate.robot.stations.get(observation.station).map(|place| *place.rotation.matrix());
        let axes = axes.unwrap_or_else(Matrix3::identity);
        let target = estimate.robot.targets.get(observation.target).copied().unwrap_or_default();
        let motions = motions.at(&observation.command, &target);
        let of_machine = beside.iter().map(|machine| machine.covariance(&motions)).sum::<Matrix3<f64>>();
        PredictedReading {
            error: residuals.fixed_rows::<3>(3 * i).into_owned(),
            of_parameters: &spread * spread.transpose(),
            of_machine: axes * of_machine * axes.transpose(),
        }
    };
    Ok(Some(set.observations.iter().enumerate().map(of).collect()))
}

impl Estimate {
    /// `tracker_from_base` of each station, which the frame parameters displace.
    fn frame_origins(&self) -> Vec<Transform> {
        let origin = |(station, place): (usize, &Transform)| {
            let value = |component| self.value(ParameterId::Frame { station, component }).unwrap_or(0.0);
            place * small_displacement(&Vector6::from_fn(|component, _| value(component))).inverse()
        };
        self.robot.stations.iter().enumerate().map(origin).collect()
    }

    /// Independent parts of the assumed machine noise beside the model. Where the readings state no noise, the whole residual counts, since nothing
    /// separates the two.
    pub(super) fn beside(&self) -> Vec<MachineNoise> {
        let mut parts = self.machine_noise.clone();
        if let NoiseScale::Residuals(sigma) = self.noise
            && self.found_machine().is_none()
        {
            parts.push(MachineNoise {
                position: sigma,
                actuators: Vec::new(),
                freedom: self.interval_freedom,
            });
        }
        parts
    }

    /// Covariance of a single reading as the fit weighs it, m²; `stated` is its stated covariance.
    pub fn reading_covariance(&self, stated: Option<Matrix3<f64>>) -> Matrix3<f64> {
        let scale = self.reading_scale.unwrap_or(1.0);
        match (stated, self.noise) {
            (Some(stated), _) => stated * scale * scale,
            (None, NoiseScale::Residuals(sigma)) => Matrix3::identity() * sigma * sigma,
            (None, NoiseScale::Stated) => Matrix3::zeros(),
        }
    }

    /// The part that was estimated.
    pub fn found_machine(&self) -> Option<&MachineNoise> {
        self.machine_noise.iter().find(|part| part.freedom.is_some())
    }
}

/// The problem that `estimate` solves.
fn solved(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<CalibrationProblem, IdentifyError> {
    let kept: Vec<_> = estimate.parameters.iter().map(|p| p.id).collect();
    let mut problem = rebuild(&as_spread(model, estimate), set, options, &kept)?;
    if problem.parameters != kept {
        let names = problem.parameters.iter().chain(&kept);
        let foreign: Vec<_> =
            names.filter(|id| !(problem.parameters.contains(id) && kept.contains(id))).collect();
        // The right parameters in another order, or one of them twice, do not belong to this estimate either.
        let named = if foreign.is_empty() { kept.iter().collect() } else { foreign };
        let name = named.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        return Err(IdentifyError::UnknownParameter { name });
    }
    for (column, weight) in &mut problem.own_priors {
        // The size was found with the fit because none was stated.
        if let (ParameterId::Term(_), Some(sigma)) = (
            problem.parameters[*column],
            estimate.parameters[*column].prior_sigma.filter(|sigma| *sigma > 0.0),
        ) {
            *weight = 1.0 / sigma;
        }
    }
    weigh_as(&mut problem, set, &estimate.robot.targets, estimate)?;
    Ok(problem)
}

/// The model with the spans over which the terms of an estimate are spread, whatever set is examined.
pub(super) fn as_spread<'m>(model: &'m CalibrationModel, estimate: &Estimate) -> Cow<'m, CalibrationModel> {
    let spans = &estimate.robot.nominal.spans;
    if *spans == model.spans {
        return Cow::Borrowed(model);
    }
    Cow::Owned(CalibrationModel { spans: spans.clone(), ..model.clone() })
}

/// Weighs a problem, whose targets lie at `targets` on the flange, with the noise that an estimate was given or found.
pub(super) fn weigh_as(
    problem: &mut CalibrationProblem,
    set: &MeasurementSet,
    targets: &[Vector3<f64>],
    estimate: &Estimate,
) -> Result<(), IdentifyError> {
    let unstated = match estimate.noise {
        NoiseScale::Residuals(sigma) if sigma > 0.0 && sigma.is_finite() => Some(sigma),
        _ => None,
    };
    let machine = estimate.found_machine().cloned();
    let (turn, scale) = (estimate.turn_noise, estimate.reading_scale);
    if unstated.is_none() && machine.is_none() && turn.is_none() && scale.is_none() {
        return Ok(());
    }
    if machine.is_some() {
        problem.prepare_motions(set, targets);
    }
    problem.weigh(&Noise { unstated, scale, machine, turn, freedom: estimate.interval_freedom })
}
