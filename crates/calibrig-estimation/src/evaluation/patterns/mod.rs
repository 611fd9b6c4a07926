//! Tests the shape of the residuals: against every command, the motors' turns, the approach, the payload, the time, the temperature, and from
//! pose to pose.
//!
//! A complete model leaves residuals that depend on none of these. Each cause is a group of regressors; its test is the F test of the fitted
//! model against the same model with the group added (to first order), and so accounts for what the parameters have already absorbed.
//! The strongest cause is added to the model before the next is sought, so that it is not found again under the names of related causes.

mod basis;
mod regression;
mod serial;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use std::fmt;

use nalgebra::{DMatrix, DVector, Vector3};

use self::basis::{causes, regressors};
use self::regression::ProjectedResidual;
use self::serial::serial_correlation;
use crate::identification::Whitening;

/// The conditions of one observation, set or known.
#[derive(Debug, Clone, Copy)]
pub struct PoseConditions<'a> {
    /// Actuator commands, m or rad.
    pub command: &'a [f64],
    /// Sign of each actuator's last motion, 0 where unknown.
    pub approach: &'a [i8],
    /// Time since the session began, s.
    pub time: f64,
    /// Temperature, °C, where known.
    pub temperature: Option<f64>,
    /// The target in the base frame, m.
    pub position: Vector3<f64>,
    /// Derivative of the target's position with respect to every actuator, m/m or m/rad; empty where unknown. With it, the tests are sharp
    /// for errors of a transmission, whose direction changes with the pose.
    pub sensitivity: &'a [Vector3<f64>],
    /// Force of the payload in the base frame, N; zero where the flange carries none.
    pub load: Vector3<f64>,
    /// Number of the pose: its observations share its errors.
    pub pose: u32,
    /// Indices of the target and of the station.
    pub seen: (usize, usize),
}

/// Residuals at the minimum, and everything that they may depend on.
#[derive(Debug, Clone, Copy)]
pub struct ResidualSet<'a> {
    /// Whitened residuals: three per observation in the order of `poses`, then those of the priors, if any.
    pub residuals: &'a DVector<f64>,
    /// Derivatives of the residuals with respect to the fitted parameters (as many rows); without columns for a set that was not fitted.
    pub jacobian: &'a DMatrix<f64>,
    /// Number of rows, the first ones, whose size determines the noise: observations, nests and targets, but not the other priors.
    pub measured_rows: usize,
    /// Degrees of freedom of these rows: their number less the trace of their part of the hat matrix.
    pub freedom: f64,
    /// Maps displacements to the rows of the observations.
    pub whitening: &'a Whitening,
    /// One entry per observation.
    pub poses: &'a [PoseConditions<'a>],
    /// Names of the actuators.
    pub joint_names: &'a [String],
    /// Motor turns per metre or radian of every actuator, where known.
    pub motor_turns: &'a [Option<f64>],
}

/// What residuals may depend on. Joints count from zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Cause {
    /// The same displacement at every pose.
    Constant,
    /// Slow dependence on the command of an actuator: polynomials of low degree.
    Joint(usize),
    /// Angle of a motor: once and twice a turn.
    MotorTurn(usize),
    /// Direction from which an actuator came.
    Approach(usize),
    /// Load of the flange.
    Payload,
    /// Time since the session began.
    Time,
    /// Temperature.
    Temperature,
    /// The observation before.
    Sequence,
}

impl Cause {
    /// The cause in words, to follow "the residual".
    pub fn describe(self, joint_names: &[String]) -> String {
        let name = |joint: usize| joint_names.get(joint).map_or("an unnamed joint", String::as_str);
        match self {
            Self::Constant => "has a constant part".to_owned(),
            Self::Joint(joint) => format!("varies with the command of {}", name(joint)),
            Self::MotorTurn(joint) => format!("varies within the motor turn of {}", name(joint)),
            Self::Approach(joint) => format!("varies with the approach of {}", name(joint)),
            Self::Payload => "varies with the payload".to_owned(),
            Self::Time => "varies with time".to_owned(),
            Self::Temperature => "varies with temperature".to_owned(),
            Self::Sequence => "resembles that of the pose before".to_owned(),
        }
    }

    /// The key in JSON: `joint3`, `time`, ...; joints count from one.
    pub fn key(self) -> String {
        match self {
            Self::Constant => "constant".to_owned(),
            Self::Joint(joint) => format!("joint{}", joint + 1),
            Self::MotorTurn(joint) => format!("motor_turn{}", joint + 1),
            Self::Approach(joint) => format!("approach{}", joint + 1),
            Self::Payload => "payload".to_owned(),
            Self::Time => "time".to_owned(),
            Self::Temperature => "temperature".to_owned(),
            Self::Sequence => "sequence".to_owned(),
        }
    }
}

/// A dependence of the residuals that chance does not explain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ResidualPattern {
    /// What the residuals depend on.
    pub cause: Cause,
    /// The dependence in words, to follow "the residual".
    pub description: String,
    /// Natural logarithm of the p-value, corrected for the number of causes that were tested.
    pub ln_p: f64,
    /// Largest displacement that the pattern shows in the residuals, m, without the part that the parameters have absorbed.
    pub peak: f64,
    /// Share of the residuals' weighted sum of squares that the pattern explains.
    pub share: f64,
}

/// The dependences that were tested, and those that were found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PatternReport {
    /// Patterns found, in the order of their strength.
    pub patterns: Vec<ResidualPattern>,
    /// Every cause that could be tested, with the natural logarithm of its own uncorrected p-value before any pattern was removed.
    pub tested: Vec<(Cause, f64)>,
    /// Correlation of the whitened residuals of one observation and the next, after the patterns were removed.
    pub serial_correlation: Option<f64>,
}

impl fmt::Display for ResidualPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let p = self.ln_p.exp();
        write!(f, "the residual {} (p ", self.description)?;
        if p >= 1e-99 {
            write!(f, "= {p:.1e}")?;
        } else {
            f.write_str("< 1e-99")?;
        }
        if self.cause != Cause::Sequence {
            write!(f, ", {:.3} mm peak", self.peak * 1e3)?;
        }
        write!(f, ", {:.0} % of the sum of squares)", self.share * 100.0)
    }
}

/// Looks for patterns at the family-wise error rate `level` (such as 0.001): the probability of finding any in residuals that have none.
///
/// `None` where the residuals leave no degree of freedom, or the parts of `set` do not fit together.
pub fn find_patterns(set: &ResidualSet<'_>, level: f64) -> Option<PatternReport> {
    let rows = set.residuals.len();
    let observations = set.poses.len();
    let fits = set.jacobian.nrows() == rows && (3 * observations..=rows).contains(&set.measured_rows);
    if !fits || observations == 0 || set.whitening.observations() != observations {
        return None;
    }
    let mut residual = ProjectedResidual::new(set)?;
    let total = residual.sum_of_squares();
    let mut open: Vec<_> = causes(set).into_iter().map(|cause| (cause, regressors(set, cause))).collect();
    let mut tested = Vec::new();
    let mut patterns = Vec::new();
    loop {
        let mut best: Option<(usize, regression::GroupTest)> = None;
        for (place, (cause, columns)) in open.iter().enumerate() {
            let Some(test) = residual.test(columns) else { continue };
            if patterns.is_empty() {
                tested.push((*cause, test.ln_p));
            }
            if best.as_ref().is_none_or(|(_, other)| test.ln_p < other.ln_p) {
                best = Some((place, test));
            }
        }
        let Some((place, test)) = best else { break };
        // Holm's correction, by the number of causes that are still open, the sequence included.
        let ln_p = (test.ln_p + (open.len() as f64 + 1.0).ln()).min(0.0);
        if !(ln_p < level.ln()) {
            break;
        }
        let (cause, _) = open.remove(place);
        patterns.push(ResidualPattern {
            cause,
            description: cause.describe(set.joint_names),
            ln_p,
            peak: peak(set, &test.fitted),
            share: test.fitted.norm_squared() / total,
        });
        residual.take_out(test);
    }
    let serial = serial_correlation(&residual, set);
    if let Some(serial) = &serial {
        if patterns.is_empty() {
            tested.push((Cause::Sequence, serial.ln_p));
        }
        let ln_p = (serial.ln_p + (open.len() as f64 + 1.0).ln()).min(0.0);
        if ln_p < level.ln() {
            patterns.push(ResidualPattern {
                cause: Cause::Sequence,
                description: Cause::Sequence.describe(set.joint_names),
                ln_p,
                peak: 0.0,
                share: serial.correlation.powi(2) * residual.sum_of_squares() / total,
            });
        }
    }
    Some(PatternReport { patterns, tested, serial_correlation: serial.map(|s| s.correlation) })
}

/// Largest displacement of a whitened pattern, m.
fn peak(set: &ResidualSet<'_>, fitted: &DVector<f64>) -> f64 {
    set.whitening.displacements(fitted).iter().map(Vector3::norm).fold(0.0, f64::max)
}
