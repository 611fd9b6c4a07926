//! Planned measuring sessions: what the nominal robot would show, without any error.

use nalgebra::Vector3;

use super::{CalibrateError, PipelineError, PlantKind, simulate, without_drift};
use crate::scenario::Scenario;
use calibrig_estimation::identification::{CalibratedRobot, Mode, PredictionError, Predictor};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, Motion, Observation, Reading, Station, Target};
use calibrig_model::{CalibrationModel, PoseQuery};
use calibrig_plant::AsBuilt;
use calibrig_plant::effects::Effects;

/// The identification set of a scenario as the nominal robot would give it: its poses in their order, with its nests and its tracker.
pub fn planned(scenario: &Scenario) -> Result<MeasurementSet, PipelineError> {
    let nominal = &scenario.robot.model;
    let mut session = Scenario {
        as_built: AsBuilt {
            kinematics: nominal.kinematics.clone(),
            actuators: nominal.actuators.clone(),
            statics: nominal.statics.clone().unwrap_or_else(|| scenario.as_built.statics.clone()),
            target: scenario.robot.target().unwrap_or(scenario.as_built.target),
            effects: Effects::default(),
        },
        drawn: None,
        outliers: None,
        verification_poses: 0,
        ..scenario.clone()
    };
    session.plan.payloads.make_as_stated();
    session.tracker.instrument.noise = false;
    if let Some(probe) = &mut session.probe {
        probe.noise = false;
    }
    let simulated = simulate(&session, scenario.seed, 0, PlantKind::Analytic, |_, _| {})?;
    Ok(without_drift(simulated.sets)?.sets.into_iter().next().map(|set| set.measurements).unwrap_or_default())
}

/// The same at any poses (joint variables) with the target at `in_flange`, m, if the tracker's place, that offset and the readings'
/// noise are all unknown. The poses are approached one from the other.
pub fn planned_at(
    model: &CalibrationModel,
    poses: &[Vec<f64>],
    in_flange: Vector3<f64>,
) -> Result<MeasurementSet, PipelineError> {
    let mut set = MeasurementSet {
        stations: vec![Station { name: "1".to_owned(), ..Station::default() }],
        targets: vec![Target { name: "SMR".to_owned(), in_flange, covariance: None, orientation: None }],
        observations: Vec::new(),
    };
    let robot = CalibratedRobot {
        instruments: Vec::new(),
        mode: Mode::Extended,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: vec![Transform::identity()],
        targets: vec![in_flange],
        orientations: vec![None],
    };
    let failed = |source| CalibrateError::Predict { mode: robot.mode, source };
    let mut predictor = Predictor::new(&robot).map_err(failed)?;
    let mut motion: Option<Motion> = None;
    for (pose, joints) in (1..).zip(poses) {
        let command = model.actuators.command_from_joints(joints);
        motion.get_or_insert_with(|| Motion::at(&command)).go_to(&command, 0.0);
        let Motion { approach, since_reversal, .. } = motion.clone().unwrap_or_default();
        let position = predictor
            .in_base(PoseQuery::at(&command).approached(&approach).moved(&since_reversal))
            .map_err(|source| failed(PredictionError::Pose { pose, source: Box::new(source) }))?;
        set.observations.push(Observation {
            pose,
            command,
            approach,
            since_reversal,
            temperature: None,
            time: 0.0,
            station: 0,
            target: 0,
            payload: None,
            reading: Reading::Cartesian { position, covariance: None },
        });
    }
    Ok(set)
}
