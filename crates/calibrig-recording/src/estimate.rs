//! The result of a mode, as a message.

use super::schema::{self, v1};
use calibrig_estimation::evaluation::ModeOutcome;
use calibrig_estimation::identification::{Estimate, IterationRecord, NoiseScale, ParameterEstimate};
use calibrig_model::measurement::SetOutcome;

/// The message of `mode`, whose rows belong to `sets`.
pub(super) fn estimate(sets: &[SetOutcome], mode: &ModeOutcome) -> v1::Estimate {
    let accuracy = sets.iter().zip(&mode.rows).filter_map(|(set, row)| {
        let row = row.as_ref()?;
        Some(v1::Accuracy {
            set: set.kind.key().to_owned(),
            max: schema::vector(&row.max),
            mean: schema::vector(&row.mean),
            bias: schema::vector(&row.bias),
            rms_3d: row.rms_3d,
            max_3d: row.max_3d,
            count: row.count as u64,
        })
    });
    let robot = v1::Estimate {
        mode: mode.mode.key().to_owned(),
        stations: mode.robot.stations.iter().map(schema::pose).collect(),
        targets: mode.robot.targets.iter().map(|t| v1::Point { position: schema::vector(t) }).collect(),
        accuracy: accuracy.collect(),
        ..v1::Estimate::default()
    };
    match &mode.estimate {
        Some(estimate) => with_identification(robot, estimate),
        None => robot,
    }
}

fn with_identification(robot: v1::Estimate, estimate: &Estimate) -> v1::Estimate {
    let parameter = |p: &ParameterEstimate| v1::Parameter {
        name: p.id.to_string(),
        unit: p.id.unit().to_string(),
        value: Some(p.value),
        sigma: p.sigma,
        prior_sigma: p.prior_sigma,
        stated_sigma: p.stated_sigma,
    };
    let iteration = |i: &IterationRecord| v1::Iteration {
        cost: i.cost,
        damping: i.damping,
        step: i.step,
        gain: i.gain,
        accepted: i.accepted,
        parameters: i.parameters.clone(),
    };
    v1::Estimate {
        parameters: estimate.parameters.iter().map(parameter).collect(),
        covariance: estimate
            .covariance
            .as_ref()
            .map(|c| c.transpose().iter().copied().collect())
            .unwrap_or_default(),
        chi2: Some(estimate.chi2),
        degrees_of_freedom: None,
        effective_degrees_of_freedom: Some(estimate.degrees_of_freedom),
        machine_position_sigma: estimate.found_machine().map(|found| found.position),
        machine_actuator_sigmas: estimate.found_machine().map(|f| f.actuators.clone()).unwrap_or_default(),
        interval_degrees_of_freedom: estimate.interval_freedom,
        termination: estimate.termination.key().to_owned(),
        iterations: estimate.iterations.iter().map(iteration).collect(),
        rank: Some(estimate.spectrum.rank as u64),
        condition: Some(estimate.spectrum.condition),
        warnings: estimate.warnings.iter().map(ToString::to_string).collect(),
        held: estimate.held.iter().map(ToString::to_string).collect(),
        fixed: estimate.fixed.iter().map(ToString::to_string).collect(),
        noise_from_residuals: match estimate.noise {
            NoiseScale::Stated => None,
            NoiseScale::Residuals(sigma) => Some(sigma),
        },
        ..robot
    }
}

/// Degrees of freedom of a recorded chi-square, from the newer field or the older one.
pub(super) fn freedom_of(estimate: &v1::Estimate) -> Option<f64> {
    estimate.effective_degrees_of_freedom.or(estimate.degrees_of_freedom.map(|freedom| freedom as f64))
}
