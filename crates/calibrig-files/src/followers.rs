//! Joints that follow others have no command: files of measurements have no columns for them, measurements in memory have a
//! zero.

use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, JointKind};

/// Kinds of the joints that are commanded, in their order: the columns of a measurement file.
pub fn commanded_joints(model: &CalibrationModel) -> Vec<JointKind> {
    let links = model.kinematics.links.iter().enumerate();
    links.filter(|(joint, _)| model.actuators.is_commanded(*joint)).map(|(_, link)| link.kind).collect()
}

/// Inserts zeros where a file has no columns, for joints that follow others.
pub fn add_followers(model: &CalibrationModel, set: &mut MeasurementSet) {
    let joints: Vec<bool> =
        (0..model.kinematics.joint_count()).map(|joint| model.actuators.is_commanded(joint)).collect();
    for observation in &mut set.observations {
        observation.command = spread(&joints, &observation.command);
        if !observation.approach.is_empty() {
            observation.approach = spread(&joints, &observation.approach);
        }
        if !observation.since_reversal.is_empty() {
            observation.since_reversal = spread(&joints, &observation.since_reversal);
        }
    }
}

/// A command of one number per joint, from the commands of the commanded joints.
pub fn with_followers(model: &CalibrationModel, commands: &[f64]) -> Vec<f64> {
    let joints: Vec<bool> =
        (0..model.kinematics.joint_count()).map(|joint| model.actuators.is_commanded(joint)).collect();
    spread(&joints, commands)
}

/// The inverse of [`add_followers`].
#[must_use]
pub fn without_followers(model: &CalibrationModel, set: &MeasurementSet) -> MeasurementSet {
    let mut set = set.clone();
    for observation in &mut set.observations {
        keep(model, &mut observation.command);
        keep(model, &mut observation.approach);
        keep(model, &mut observation.since_reversal);
    }
    set
}

/// The values of the joints that are commanded.
fn keep<T>(model: &CalibrationModel, values: &mut Vec<T>) {
    let mut joint = 0..;
    values.retain(|_| joint.next().is_some_and(|joint| model.actuators.is_commanded(joint)));
}

/// The given values for commanded joints, the default for others.
fn spread<T: Copy + Default>(commanded: &[bool], values: &[T]) -> Vec<T> {
    let mut values = values.iter().copied();
    commanded
        .iter()
        .map(|commanded| if *commanded { values.next().unwrap_or_default() } else { T::default() })
        .collect()
}
