//! What other targets would have determined at the measured poses, by linearisation at the estimate: no machine is simulated.

use std::collections::HashMap;

use nalgebra::{Cholesky, Matrix3, Rotation3, Vector3};

use super::{ARM, Sensor};
use crate::pipeline::{ModeOutcome, SetKind, SetOutcome};
use calibrig_estimation::identification::{
    Estimate, ForeseenSpread, IdentificationOptions, Mode, NoiseScale, Predictor, foresee,
};
use calibrig_model::measurement::{
    MeasurementSet, Observation, Reading, SphericalReading, Target, TargetOrientation, combine,
};
use calibrig_model::{CalibrationModel, ParameterId};

/// A reading with less than this weight in a robust fit is left out.
const LEAST_WEIGHT: f64 = 0.5;

/// What one point, three points and full poses determine about a robot, at the poses of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorStudy {
    /// The estimate that it is based on.
    pub mode: Mode,
    /// The poses where the robot is predicted.
    pub predicted: SetKind,
    /// One entry per kind of target, including the measured one.
    pub sensors: Vec<SensorProspect>,
}

/// Results of one of them.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorProspect {
    /// Which.
    pub sensor: Sensor,
    /// Whether it was measured; otherwise it is a prediction.
    pub is_measured: bool,
    /// Rank of the fit, with the priors of the estimate.
    pub rank: usize,
    /// By observations, nests and targets alone.
    pub measured_rank: usize,
    /// Every parameter with its standard deviation, SI; `None` from a singular system, or at a bound.
    pub parameters: Vec<(ParameterId, Option<f64>)>,
    /// Parameters that it does not separate from others, with those.
    pub open: Vec<String>,
    /// Uncertainty of the robot's predictions; `None` from a singular system.
    pub spread: Option<ForeseenSpread>,
}

impl SensorProspect {
    /// Standard deviation of a parameter, SI.
    pub fn sigma(&self, id: ParameterId) -> Option<f64> {
        self.parameters.iter().find(|(own, _)| *own == id).and_then(|(_, sigma)| *sigma)
    }
}

/// What the targets of the first of `sets`, fewer, more, and full poses determine, for the last of `modes` that has an estimate; `None` if there is
/// none, or the first target was not seen.
pub fn foresee_sensors(
    model: &CalibrationModel,
    sets: &[SetOutcome],
    modes: &[ModeOutcome],
    options: &IdentificationOptions,
) -> Option<SensorStudy> {
    let fitted = &sets.first()?.measurements;
    let outcome = modes.iter().rev().find(|outcome| outcome.estimate.is_some())?;
    let estimate = outcome.estimate.as_ref()?;
    let seen = |set: &&SetOutcome| !set.measurements.observations.is_empty();
    let predicted = sets.iter().skip(1).find(seen).or(sets.first())?;
    let session = Session::new(fitted, estimate)?;
    let prospect = |(sensor, is_measured, set): (Sensor, bool, Option<MeasurementSet>)| {
        // A target that cannot be measured is left out of the comparison.
        let foreseen = foresee(model, &set?, options, estimate).ok()?;
        Some(SensorProspect {
            sensor,
            is_measured,
            rank: foreseen.spectrum().rank,
            measured_rank: foreseen.measured_rank(),
            parameters: foreseen.parameters().collect(),
            open: foreseen.open().map(ToString::to_string).collect(),
            spread: foreseen.spread(&predicted.measurements).ok()?,
        })
    };
    let sensors: Vec<_> = session.variants().into_iter().filter_map(prospect).collect();
    let is_comparison = sensors.len() > 1 && sensors.iter().any(|sensor| sensor.is_measured);
    is_comparison.then_some(SensorStudy { mode: outcome.mode, predicted: predicted.kind, sensors })
}

/// A measured set with all its readings in use.
struct Session<'a> {
    set: MeasurementSet,
    estimate: &'a Estimate,
    /// Number of the targets, and whether all are points.
    targets: usize,
    are_points: bool,
}

/// The observations of one target, each with how many of its pose, station and target came before.
fn of_target(set: &MeasurementSet, target: usize) -> HashMap<(u32, usize, usize), &Observation> {
    let mut count = HashMap::new();
    let own = set.observations.iter().filter(|o| o.target == target);
    own.map(|o| {
        let before = count.entry((o.pose, o.station)).or_insert(0);
        *before += 1;
        ((o.pose, o.station, *before), o)
    })
    .collect()
}

impl<'a> Session<'a> {
    fn new(fitted: &MeasurementSet, estimate: &'a Estimate) -> Option<Self> {
        let mut set = fitted.clone();
        let sigma = match estimate.noise {
            NoiseScale::Residuals(sigma) if sigma > 0.0 && sigma.is_finite() => Some(sigma),
            _ => None,
        };
        let mut weights = estimate.weights.iter();
        set.observations.retain(|_| weights.next().is_none_or(|weight| *weight >= LEAST_WEIGHT));
        let seen = |target| set.observations.iter().any(|o| o.target == target);
        let targets = (0..set.targets.len()).take_while(|target| seen(*target)).count();
        let others = (targets..set.targets.len()).any(seen);
        let are_points = !set.has_poses();
        // Readings whose noise was found get it.
        for reading in set.observations.iter_mut().map(|o| &mut o.reading) {
            let found = sigma.map(|sigma| Matrix3::identity() * sigma * sigma);
            if reading.position_covariance().is_none() && !matches!(reading, Reading::Pose(_)) {
                *reading = Reading::Cartesian { position: reading.position(), covariance: found };
            }
        }
        (targets > 0 && !others).then_some(Self { set, estimate, targets, are_points })
    }

    /// What is compared: which, whether it was measured, and its measurements if possible.
    fn variants(&self) -> Vec<(Sensor, bool, Option<MeasurementSet>)> {
        let (points, one) = (self.are_points, self.targets == 1);
        let three = self.three();
        let measured_three = points && self.targets == 3;
        let mut variants = vec![
            (Sensor::OneSmr, points && one, Some(self.points(1))),
            (Sensor::ThreeSmrs, measured_three, three.clone()),
        ];
        if points {
            variants.push((Sensor::CombinedPose, false, three.and_then(|three| combined(&three))));
        } else if one {
            variants.push((Sensor::Probe, true, Some(self.set.clone())));
        }
        let is_among = one || points && self.targets == 3;
        if !is_among {
            variants.push((Sensor::AsMeasured, true, Some(self.set.clone())));
        }
        variants
    }

    /// The places of the first targets alone.
    fn points(&self, targets: usize) -> MeasurementSet {
        let mut set = self.set.clone();
        set.targets.truncate(targets);
        set.targets.iter_mut().for_each(|target| target.orientation = None);
        set.observations.retain(|o| o.target < targets);
        for reading in set.observations.iter_mut().map(|o| &mut o.reading) {
            if matches!(reading, Reading::Pose(_)) {
                let (position, covariance) = (reading.position(), reading.position_covariance());
                *reading = Reading::Cartesian { position, covariance };
            }
        }
        set
    }

    /// Three points: the first three that were measured, else the first and two more, [`ARM`] from it along the flange's x and y, read and stated
    /// equally well.
    fn three(&self) -> Option<MeasurementSet> {
        if self.targets >= 3 {
            return Some(self.points(3));
        }
        let mut set = self.points(1);
        let mut robot = self.estimate.robot.clone();
        let (first, at) = (set.targets.first()?.clone(), *robot.targets.first()?);
        robot.targets.truncate(1);
        robot.orientations.truncate(1);
        let places = [ARM * Vector3::x(), ARM * Vector3::y()];
        for (place, name) in places.iter().zip(["SMR 2", "SMR 3"]) {
            let in_flange = first.in_flange + place;
            set.targets.push(Target { name: name.to_owned(), in_flange, ..first.clone() });
            robot.targets.push(at + place);
            robot.orientations.push(None);
        }
        let mut predictor = Predictor::new(&robot).ok()?;
        let mut observations = Vec::with_capacity(3 * set.observations.len());
        for observation in set.observations {
            let mut further = vec![observation.clone()];
            for target in 1..=places.len() {
                let mut other = Observation { target, ..observation.clone() };
                let in_base = predictor.in_base(&other).ok()?;
                let station = robot.stations.get(observation.station)?;
                let position = station.rotation * in_base + station.translation.vector;
                other.reading = read_at(&observation.reading, position);
                further.push(other);
            }
            observations.extend(further);
        }
        set.observations = observations;
        Some(set)
    }
}

/// The poses that three points make, if all three were seen together. Their places in the tool are taken as exact in each pose; the uncertainty
/// of the tool's orientation on the flange follows from their stated uncertainties.
fn combined(three: &MeasurementSet) -> Option<MeasurementSet> {
    let in_flange: Vec<_> = three.targets.iter().map(|target| target.in_flange).collect();
    let first = *in_flange.first()?;
    let in_tool: Vec<_> = in_flange.iter().map(|place| place - first).collect();
    let stated: Option<Vec<_>> = three
        .targets
        .iter()
        .map(|target| {
            Some(Reading::Cartesian { position: target.in_flange, covariance: Some(target.covariance?) })
        })
        .collect();
    let turned = stated.and_then(|stated| {
        let points: Vec<_> = in_tool.iter().copied().zip(&stated).collect();
        combine(&points).ok()?.covariance
    });
    let covariance = turned.map(|covariance| covariance.fixed_view::<3, 3>(3, 3).into_owned());
    let covariance = covariance.filter(|covariance| Cholesky::new(*covariance).is_some());
    let others = [of_target(three, 1), of_target(three, 2)];
    let mut observations = Vec::new();
    for (key, observation) in of_target(three, 0) {
        let [Some(second), Some(third)] = others.each_ref().map(|other| other.get(&key)) else {
            continue;
        };
        let readings = [&observation.reading, &second.reading, &third.reading];
        let points: Vec<_> = in_tool.iter().copied().zip(readings).collect();
        let reading = Reading::Pose(Box::new(combine(&points).ok()?));
        observations.push((key, Observation { reading, ..observation.clone() }));
    }
    observations.sort_by_key(|(key, _)| *key);
    let orientation = TargetOrientation { flange_from_target: Rotation3::identity(), covariance };
    let target = Target { orientation: Some(orientation), ..three.targets.first()?.clone() };
    Some(MeasurementSet {
        stations: three.stations.clone(),
        targets: vec![target],
        observations: observations.into_iter().map(|(_, observation)| observation).collect(),
    })
}

/// A reading of another point near that of `reading`, with the same uncertainty.
fn read_at(reading: &Reading, position: Vector3<f64>) -> Reading {
    match reading {
        Reading::Spherical(own) => {
            let [range, azimuth, elevation] = Reading::Cartesian { position, covariance: None }.spherical();
            let (covariance, face) = (own.covariance, own.face);
            Reading::Spherical(SphericalReading { range, azimuth, elevation, covariance, face })
        }
        other => Reading::Cartesian { position, covariance: other.position_covariance() },
    }
}
