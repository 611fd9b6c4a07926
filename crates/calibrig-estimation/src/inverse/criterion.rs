//! Criteria that choose among the poses in which the tool is where it should be.

use std::fmt;
use std::str::FromStr;

use nalgebra::{DMatrix, DVector, Matrix3xX, Vector3};
use thiserror::Error;

use super::arm::{by_joints, no_pose};
use super::joint_space::JointSpace;
use super::task::{Aim, Goal, Tool};
use crate::elastostatics::{Carried, Deflection, ElasticChain};
use crate::identification::PredictionError;
use crate::kinematics::KinematicChain;
use calibrig_model::geometry::Transform;
use calibrig_model::{CalibrationModel, Payload};

/// Deflection for which the criterion's part is one, m.
const DEFLECTED: f64 = 1e-3;

/// Quantity that is minimised over all commands for a goal: the sum of four parts, each with a weight of zero or more.
///
/// ```
/// use calibrig_estimation::inverse::Criterion;
///
/// // The least deflection, and, among poses with nearly the same deflection, the one farther from the limits.
/// let criterion = Criterion { limits: 0.1, ..Criterion::LEAST_DEFLECTION };
/// assert_eq!((criterion.deflection, criterion.motion), (1.0, 0.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Criterion {
    /// Square of the tool's predicted deflection under all loads, over 1 mm: the criterion of Wang et al., Machines 11 (2023)
    /// 20. It needs a robot whose masses and stiffnesses are known.
    pub deflection: f64,
    /// Mean over the commanded joints of `((q - middle) / half of the range)²` (A. Liégeois, IEEE Trans. SMC 7 (1977) 868). A joint without limits is
    /// given the range of a turn, or of 2 m to either side of zero.
    pub limits: f64,
    /// `-ln sqrt(det J Jᵀ)` for the goal's rows by the joints of the rigid nominal robot (T. Yoshikawa, Int. J. Robotics Research 4 (1985) 3), with
    /// angles multiplied by the [lever](super::InverseOptions::lever).
    pub manipulability: f64,
    /// Mean over the commanded joints of `((q - reference) / half of the range)²`.
    pub motion: f64,
}

impl Criterion {
    /// No criterion: the first solution found is taken.
    pub const NONE: Self = Self { deflection: 0.0, limits: 0.0, manipulability: 0.0, motion: 0.0 };
    /// The least predicted deflection.
    pub const LEAST_DEFLECTION: Self = Self { deflection: 1.0, ..Self::NONE };
    /// Farthest from the joints' limits.
    pub const FAR_FROM_LIMITS: Self = Self { limits: 1.0, ..Self::NONE };
    /// Greatest manipulability.
    pub const MANIPULABILITY: Self = Self { manipulability: 1.0, ..Self::NONE };
    /// Nearest to the reference command.
    pub const LEAST_MOTION: Self = Self { motion: 1.0, ..Self::NONE };

    /// Names and weights of the parts.
    pub fn parts(&self) -> [(&'static str, f64); 4] {
        [
            ("deflection", self.deflection),
            ("limits", self.limits),
            ("manipulability", self.manipulability),
            ("motion", self.motion),
        ]
    }

    /// Whether no part is asked for.
    pub fn is_none(&self) -> bool {
        self.parts().iter().all(|(_, weight)| *weight == 0.0)
    }

    fn part_mut(&mut self, name: &str) -> Option<&mut f64> {
        match name {
            "deflection" => Some(&mut self.deflection),
            "limits" => Some(&mut self.limits),
            "manipulability" => Some(&mut self.manipulability),
            "motion" => Some(&mut self.motion),
            _ => None,
        }
    }
}

/// Parts joined by commas, each with a weight or of weight one: `deflection`, `deflection,limits=0.1`; `none`. The printed text is read back the
/// same.
impl fmt::Display for Criterion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_none() {
            return f.write_str("none");
        }
        let stated = self.parts().into_iter().filter(|(_, weight)| *weight != 0.0);
        for (index, (name, weight)) in stated.enumerate() {
            let comma = if index > 0 { "," } else { "" };
            if weight == 1.0 {
                write!(f, "{comma}{name}")?;
            } else {
                write!(f, "{comma}{name}={weight}")?;
            }
        }
        Ok(())
    }
}

/// A text does not state a criterion.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error(
    "{found:?} is not a criterion: expected deflection, limits, manipulability or motion, several of them joined by commas \
     and with weights (deflection,limits=0.1), or none"
)]
pub struct CriterionError {
    /// The part of the text that was not understood.
    pub found: String,
}

impl FromStr for Criterion {
    type Err = CriterionError;

    fn from_str(text: &str) -> Result<Self, CriterionError> {
        let mut criterion = Self::NONE;
        if text.trim() == "none" {
            return Ok(criterion);
        }
        for part in text.split(',') {
            let refused = || CriterionError { found: part.trim().to_owned() };
            let (name, weight) = part.split_once('=').unwrap_or((part, "1"));
            let weight: f64 = weight.trim().parse().map_err(|_| refused())?;
            let into = criterion.part_mut(name.trim()).ok_or_else(refused)?;
            if *into != 0.0 || !(weight > 0.0 && weight.is_finite()) {
                return Err(refused());
            }
            *into = weight;
        }
        Ok(criterion)
    }
}

impl Default for Criterion {
    fn default() -> Self {
        Self::FAR_FROM_LIMITS
    }
}

/// Evaluates a criterion on a robot.
#[derive(Debug, Clone)]
pub(super) struct Judge {
    in_flange: Vector3<f64>,
    flange_from_tool: Transform,
    chain: KinematicChain,
    /// The elastic and the rigid chain, where masses and stiffnesses are known.
    elastic: Option<[ElasticChain; 2]>,
    joints: Vec<f64>,
}

/// What the criterion is evaluated for at one goal.
#[derive(Debug, Clone, Copy)]
pub(super) struct Question<'a> {
    pub criterion: Criterion,
    pub aim: &'a Aim,
    /// Unknowns of the reference command.
    pub reference: &'a [f64],
}

impl Judge {
    /// A judge for a robot whose deflection is predicted with `model`.
    pub fn new(space: &JointSpace, model: &CalibrationModel, tool: &Tool) -> Self {
        Self {
            in_flange: tool.flange_from_tool().translation.vector,
            flange_from_tool: *tool.flange_from_tool(),
            chain: KinematicChain::new(&space.kinematics),
            elastic: model.statics.as_ref().map(|_| [ElasticChain::of(model), ElasticChain::of(model)]),
            joints: vec![0.0; space.kinematics.joint_count()],
        }
    }

    /// Whether a deflection can be predicted.
    pub fn bends(&self) -> bool {
        self.elastic.is_some()
    }

    /// Attaches a load to the flange.
    pub fn carry(&mut self, payload: Option<&Payload>) {
        let carried = Carried::of(payload);
        self.elastic.iter_mut().flatten().for_each(|chain| chain.carry(carried));
    }

    /// The criterion's value at `y`, and, if asked for, its gradient by the unknowns.
    pub fn value(
        &mut self,
        space: &JointSpace,
        asked: &Question<'_>,
        y: &[f64],
        mut gradient: Option<&mut DVector<f64>>,
    ) -> Result<f64, PredictionError> {
        if let Some(gradient) = &mut gradient {
            gradient.fill(0.0);
        }
        let criterion = &asked.criterion;
        let mut value = 0.0;
        for (weight, centre) in [(criterion.limits, &space.middle[..]), (criterion.motion, asked.reference)] {
            if weight > 0.0 {
                value += weight * away(space, centre, y, weight, gradient.as_deref_mut());
            }
        }
        if criterion.manipulability > 0.0 {
            let weight = criterion.manipulability;
            value += weight * self.clumsiness(space, asked.aim, y, weight, gradient.as_deref_mut())?;
        }
        if criterion.deflection > 0.0 {
            let weight = criterion.deflection;
            value += weight * self.deflection(space, y, weight, gradient)?;
        }
        Ok(value)
    }

    /// `|deflection|²` over the square of a millimetre.
    fn deflection(
        &mut self,
        space: &JointSpace,
        y: &[f64],
        weight: f64,
        gradient: Option<&mut DVector<f64>>,
    ) -> Result<f64, PredictionError> {
        let Some([bent, rigid]) = &mut self.elastic else { return Ok(0.0) };
        let command = space.command(y);
        bent.rest(&command, &[], Deflection::Equilibrium)?;
        rigid.rest(&command, &[], Deflection::None)?;
        let off = (bent.target(&self.in_flange) - rigid.target(&self.in_flange)) / DEFLECTED;
        if let Some(gradient) = gradient {
            let mut change = Matrix3xX::zeros(command.len());
            for (chain, sign) in [(bent, 1.0), (rigid, -1.0)] {
                chain.differentiate(&self.in_flange)?;
                for (actuator, mut column) in change.column_iter_mut().enumerate() {
                    column += chain.change_by_command(actuator) * (sign / DEFLECTED);
                }
            }
            *gradient += space.command_by_free.tr_mul(&change.tr_mul(&off)) * (2.0 * weight);
        }
        Ok(off.norm_squared())
    }

    /// `-ln sqrt(det J Jᵀ)`, with the smaller of the two products.
    fn clumsiness(
        &mut self,
        space: &JointSpace,
        aim: &Aim,
        y: &[f64],
        weight: f64,
        gradient: Option<&mut DVector<f64>>,
    ) -> Result<f64, PredictionError> {
        space.joints(y, &mut self.joints).map_err(no_pose)?;
        self.chain.place(&self.joints);
        let base_from_tool = self.chain.base_from_flange() * self.flange_from_tool;
        let (count, rows) = (self.joints.len(), aim.rows());
        let mut motions = nalgebra::Matrix6xX::zeros(count);
        by_joints(&self.chain, space, &base_from_tool, |joint, motion| {
            motions.column_mut(joint).copy_from_slice(&motion);
        });
        let miss = aim.miss(&base_from_tool);
        let mut by_joint = DMatrix::zeros(rows, count);
        aim.project(&miss, &motions, &mut by_joint);
        let jacobian = &by_joint * &space.joints_by_free;
        let product =
            if rows <= space.len() { &jacobian * jacobian.transpose() } else { jacobian.tr_mul(&jacobian) };
        let Some(factor) = product.cholesky() else { return Ok(f64::INFINITY) };
        let value = -factor.l().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        let Some(gradient) = gradient else { return Ok(value) };
        // d ln sqrt(det) = pseudo-inverse : dJ
        let inverse = if rows <= space.len() {
            factor.solve(&jacobian)
        } else {
            factor.solve(&jacobian.transpose()).transpose()
        };
        let inverse = inverse * space.joints_by_free.transpose();
        let mut changed = nalgebra::Matrix6xX::zeros(count);
        let mut rates = DMatrix::zeros(rows, count);
        let mut by_joints = DVector::zeros(count);
        for moving in 0..count {
            change_of_motions(&motions, moving, &mut changed);
            aim.project(&miss, &changed, &mut rates);
            by_joints[moving] = -inverse.dot(&rates);
        }
        *gradient += space.joints_by_free.tr_mul(&by_joints) * weight;
        Ok(value)
    }
}

/// Mean square distance from a centre, in halves of the joints' ranges.
fn away(
    space: &JointSpace,
    centre: &[f64],
    y: &[f64],
    weight: f64,
    mut gradient: Option<&mut DVector<f64>>,
) -> f64 {
    let n = y.len() as f64;
    let mut sum = 0.0;
    for unknown in 0..y.len() {
        let way = (y[unknown] - centre[unknown]) / space.scale(unknown);
        sum += way * way / n;
        if let Some(gradient) = &mut gradient {
            gradient[unknown] += 2.0 * weight * way / (n * space.scale(unknown));
        }
    }
    sum
}

/// Derivative of the tool's motions by every joint while one joint moves: the joints in front of an axis turn it, and those behind it
/// move the tool's point. Rotations are given in axes that move with the tool, which the determinant does not depend on; so it is exact also for a
/// tool whose axis is not where the goal has it.
fn change_of_motions(
    motions: &nalgebra::Matrix6xX<f64>,
    moving: usize,
    changed: &mut nalgebra::Matrix6xX<f64>,
) {
    let part = |joint: usize, first: usize| motions.fixed_view::<3, 1>(first, joint).into_owned();
    for joint in 0..motions.ncols() {
        let (moves, axis) = (part(joint, 0), part(joint, 3));
        let about = part(moving, 3);
        let (mut by_point, mut by_axis) = (Vector3::zeros(), Vector3::zeros());
        if moving <= joint {
            by_point = about.cross(&moves);
        } else {
            by_point += axis.cross(&part(moving, 0));
            by_axis += axis.cross(&about);
        }
        changed.fixed_view_mut::<3, 1>(0, joint).copy_from(&by_point);
        changed.fixed_view_mut::<3, 1>(3, joint).copy_from(&by_axis);
    }
}

impl Question<'_> {
    /// Whether the robot leaves anything for the criterion to choose.
    pub fn decides(&self, space: &JointSpace) -> bool {
        !self.criterion.is_none() && space.len() > Goal::rows(self.aim.goal())
    }
}
