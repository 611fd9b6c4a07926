//! The regressors that represent a cause.

use std::f64::consts::TAU;

use nalgebra::{DVector, Vector3};

use super::{Cause, PoseConditions, ResidualSet};

/// Degree of the polynomials of a command: gravity's effects and a joint's once-per-turn errors are below it.
const COMMAND_DEGREE: usize = 4;
/// Degree of the polynomials of time and temperature, whose effects are slower.
const DRIFT_DEGREE: usize = 3;
/// Harmonics of a motor's turn.
const HARMONICS: usize = 2;

/// Every cause that the set can be tested for.
pub(super) fn causes(set: &ResidualSet<'_>) -> Vec<Cause> {
    let joints = joints(set);
    let approaches = set.poses.iter().map(|pose| pose.approach.len()).min().unwrap_or(0);
    let mut causes = vec![Cause::Constant];
    for joint in 0..joints {
        causes.push(Cause::Joint(joint));
        if set.motor_turns.get(joint).is_some_and(Option::is_some) {
            causes.push(Cause::MotorTurn(joint));
        }
        if joint < approaches {
            causes.push(Cause::Approach(joint));
        }
    }
    if set.poses.iter().any(|pose| pose.load != set.poses[0].load) {
        causes.push(Cause::Payload);
    }
    causes.push(Cause::Time);
    if set.poses.iter().all(|pose| pose.temperature.is_some()) {
        causes.push(Cause::Temperature);
    }
    causes
}

fn joints(set: &ResidualSet<'_>) -> usize {
    set.poses.iter().map(|pose| pose.command.len()).min().unwrap_or(0)
}

/// The regressors of a cause, whitened; zero in the rows of the priors.
pub(super) fn regressors(set: &ResidualSet<'_>, cause: Cause) -> Vec<DVector<f64>> {
    let mut columns = Columns { set, columns: Vec::new() };
    match cause {
        Cause::Constant => columns.along_axes(&vec![1.0; set.poses.len()]),
        Cause::Joint(joint) => {
            for values in legendre(set, COMMAND_DEGREE, |pose| pose.command[joint]) {
                columns.along_axes(&values);
                columns.along_joint(joint, &values);
            }
        }
        Cause::MotorTurn(joint) => {
            let turns = set.motor_turns[joint].unwrap_or(0.0);
            for harmonic in 1..=HARMONICS {
                for shift in [0.0, 0.25] {
                    let values: Vec<_> = set
                        .poses
                        .iter()
                        .map(|pose| (TAU * (harmonic as f64 * turns * pose.command[joint] + shift)).sin())
                        .collect();
                    if !columns.along_joint(joint, &values) {
                        columns.along_axes(&values);
                    }
                }
            }
        }
        Cause::Approach(joint) => {
            let values: Vec<_> = set.poses.iter().map(|pose| f64::from(pose.approach[joint])).collect();
            columns.along_axes(&values);
            columns.along_joint(joint, &values);
        }
        Cause::Payload => columns.payload(joints(set)),
        Cause::Time => columns.drift(|pose| pose.time),
        Cause::Temperature => columns.drift(|pose| pose.temperature.unwrap_or(0.0)),
        Cause::Sequence => {}
    }
    columns.columns
}

struct Columns<'a> {
    set: &'a ResidualSet<'a>,
    columns: Vec<DVector<f64>>,
}

impl Columns<'_> {
    fn push(&mut self, displacement: impl Fn(usize, &PoseConditions<'_>) -> Vector3<f64>) {
        let displacements = self.set.poses.iter().enumerate().map(|(i, pose)| displacement(i, pose));
        let rows = self.set.whitening.rows(displacements);
        self.columns.push(rows.resize_vertically(self.set.residuals.len(), 0.0));
    }

    /// Adds a displacement of the target along each axis of the base.
    fn along_axes(&mut self, values: &[f64]) {
        for axis in 0..3 {
            self.push(|i, _| Vector3::ith(axis, values[i]));
        }
    }

    /// Adds a displacement of an actuator; false where its effect on the target is unknown.
    fn along_joint(&mut self, joint: usize, values: &[f64]) -> bool {
        let known = self.set.poses.iter().all(|pose| pose.sensitivity.len() > joint);
        if known {
            self.push(|i, pose| values[i] * pose.sensitivity[joint]);
        }
        known
    }

    /// Adds drives that yield under load, by the work that the load does at the target, and displacements in proportion to the load, such as
    /// those of a mount that gives way.
    fn payload(&mut self, joints: usize) {
        let sizes: Vec<_> = self.set.poses.iter().map(|pose| pose.load.norm()).collect();
        self.along_axes(&sizes);
        for joint in 0..joints {
            let work =
                |pose: &PoseConditions<'_>| pose.sensitivity.get(joint).map_or(0.0, |s| s.dot(&pose.load));
            let torques: Vec<_> = self.set.poses.iter().map(work).collect();
            self.along_joint(joint, &torques);
        }
    }

    /// Adds a slow change of place, and growth about the base.
    fn drift(&mut self, variable: impl Fn(&PoseConditions<'_>) -> f64) {
        for (degree, values) in legendre(self.set, DRIFT_DEGREE, variable).iter().enumerate() {
            self.along_axes(values);
            if degree == 0 {
                self.push(|i, pose| values[i] * pose.position);
            }
        }
    }
}

/// Legendre polynomials of degree 1 to `degree` of a variable that is scaled to -1..1 over the set; empty where it does not vary.
fn legendre(
    set: &ResidualSet<'_>,
    degree: usize,
    variable: impl Fn(&PoseConditions<'_>) -> f64,
) -> Vec<Vec<f64>> {
    let values: Vec<_> = set.poses.iter().map(variable).collect();
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !(high > low && (high - low).is_finite()) {
        return Vec::new();
    }
    let x: Vec<_> = values.iter().map(|v| 2.0 * (v - low) / (high - low) - 1.0).collect();
    let mut polynomials = vec![vec![1.0; x.len()], x.clone()];
    for k in 1..degree {
        let n = k as f64;
        let next = (0..x.len())
            .map(|i| ((2.0 * n + 1.0) * x[i] * polynomials[k][i] - n * polynomials[k - 1][i]) / (n + 1.0))
            .collect();
        polynomials.push(next);
    }
    polynomials.split_off(1)
}
