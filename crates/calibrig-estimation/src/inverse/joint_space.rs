//! The joint variables that the controller can move: those of the commanded joints, within their limits.
//!
//! The unknowns y are the joint variables that the ideal map of the actuators gives to the commanded joints. Commands are linear in them, and
//! limits are bounds of single unknowns, except for joints that follow others, and for the elbow of a four-bar that is not a parallelogram.

use nalgebra::{DMatrix, DVector};

use crate::kinematics::{ClosureError, ElbowClosure, ElbowLinkage, is_parallelogram};
use calibrig_model::{ActuatorMap, CalibrationModel, JointKind, KinematicModel, ModelError};

/// Half the range of a joint that cannot move, m or rad.
const LEAST_WAY: f64 = 1e-6;
/// Sampled range of a joint without limits: a turn, or this many metres to either side.
const UNLIMITED_WAY: f64 = 2.0;

/// The commanded joints of a robot.
#[derive(Debug, Clone)]
pub(crate) struct JointSpace {
    pub kinematics: KinematicModel,
    pub actuators: ActuatorMap,
    /// Indices of the commanded joints, in order.
    pub free: Vec<usize>,
    /// Lower bound of every unknown, m or rad.
    pub low: Vec<f64>,
    pub high: Vec<f64>,
    /// Half of the range of every unknown, and its middle.
    pub half: Vec<f64>,
    pub middle: Vec<f64>,
    /// Derivative of the ideal map's joint variables by the unknowns, and their values where the unknowns are zero.
    pub joints_by_free: DMatrix<f64>,
    joints_at_zero: DVector<f64>,
    /// Whether unknowns and joint variables are the same.
    pub is_plain: bool,
    /// Derivative of the commands by the unknowns.
    pub command_by_free: DMatrix<f64>,
    /// The four-bar, if it is not a parallelogram.
    linkage: Option<(ElbowLinkage, usize, usize)>,
    /// Joints whose limits are not bounds of an unknown.
    pub sides: Vec<usize>,
}

impl JointSpace {
    /// The joint space of a valid model.
    pub fn new(model: &CalibrationModel) -> Result<Self, ClosureError> {
        let (kinematics, actuators) = (&model.kinematics, &model.actuators);
        let count = kinematics.joint_count();
        let free: Vec<usize> = (0..count).filter(|joint| actuators.is_commanded(*joint)).collect();
        let followed = |moved: Option<usize>| {
            let mut joints = vec![0.0; count];
            if let Some(joint) = moved {
                joints[joint] = 1.0;
            }
            actuators.follow(&mut joints);
            let command = DVector::from_vec(actuators.command_from_joints(&joints));
            (DVector::from_vec(joints), command)
        };
        let (joints_at_zero, command_at_zero) = followed(None);
        let mut joints_by_free = DMatrix::zeros(count, free.len());
        let mut command_by_free = DMatrix::zeros(count, free.len());
        for (unknown, joint) in free.iter().enumerate() {
            let (joints, command) = followed(Some(*joint));
            joints_by_free.set_column(unknown, &(joints - &joints_at_zero));
            command_by_free.set_column(unknown, &(command - &command_at_zero));
        }
        let linkage = match actuators.four_bar() {
            Some((shoulder, elbow, _, four_bar)) if !is_parallelogram(kinematics, elbow, four_bar) => {
                ElbowLinkage::new(kinematics, actuators)?.map(|linkage| (linkage, shoulder, elbow))
            }
            _ => None,
        };
        let is_side = |joint: &usize| {
            !actuators.is_commanded(*joint) || linkage.as_ref().is_some_and(|(_, _, elbow)| elbow == joint)
        };
        let sides: Vec<usize> = (0..count).filter(is_side).collect();
        let limits = free.iter().map(|joint| (kinematics.links[*joint].limits, sides.contains(joint)));
        let (low, high) = limits
            .map(|([low, high], side)| if side { (f64::NEG_INFINITY, f64::INFINITY) } else { (low, high) })
            .unzip();
        let way = |joint: &usize| {
            let link = &kinematics.links[*joint];
            let half = if link.kind == JointKind::Revolute { std::f64::consts::PI } else { UNLIMITED_WAY };
            match link.limits {
                [low, high] if low.is_finite() && high.is_finite() => {
                    ((0.5 * (high - low)).max(LEAST_WAY), 0.5 * (low + high))
                }
                [low, _] if low.is_finite() => (half, low + half),
                [_, high] if high.is_finite() => (half, high - half),
                _ => (half, 0.0),
            }
        };
        let (half, middle) = free.iter().map(way).unzip();
        let is_plain = free.len() == count;
        Ok(Self {
            kinematics: kinematics.clone(),
            actuators: actuators.clone(),
            free,
            low,
            high,
            half,
            middle,
            joints_by_free,
            joints_at_zero,
            is_plain,
            command_by_free,
            linkage,
            sides,
        })
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.free.len()
    }

    /// Half of the range of an unknown to divide by; one where it has no range.
    pub fn scale(&self, unknown: usize) -> f64 {
        if self.half[unknown] > 0.0 { self.half[unknown] } else { 1.0 }
    }

    /// Joint variables by the ideal map.
    pub fn ideal_joints(&self, y: &[f64], joints: &mut [f64]) {
        if self.is_plain {
            joints.copy_from_slice(y);
            return;
        }
        for (joint, value) in joints.iter_mut().enumerate() {
            let moved = self.joints_by_free.row(joint).iter().zip(y).map(|(share, y)| share * y).sum::<f64>();
            *value = self.joints_at_zero[joint] + moved;
        }
    }

    /// Joint variables of the rigid nominal machine.
    pub fn joints(&self, y: &[f64], joints: &mut [f64]) -> Result<(), ClosureError> {
        self.ideal_joints(y, joints);
        if let Some((linkage, _, elbow)) = &self.linkage {
            joints[*elbow] = linkage.q_elbow(&self.positions(y))?;
        }
        Ok(())
    }

    /// Derivatives of the rigid nominal machine's joint variables by the unknowns.
    pub fn joint_rates(&self, y: &[f64]) -> Result<DMatrix<f64>, ClosureError> {
        let mut rates = self.joints_by_free.clone();
        if let Some((linkage, shoulder, elbow)) = &self.linkage {
            let ElbowClosure { by_psi, by_shoulder, .. } = linkage.closure(&self.positions(y))?;
            let (upper, fore) = (rates.row(*shoulder).into_owned(), rates.row(*elbow).into_owned());
            rates.set_row(*elbow, &((&upper + fore) * by_psi + upper * by_shoulder));
        }
        Ok(rates)
    }

    /// Whether joint rates are those of the ideal map at every pose.
    pub fn is_ideal(&self) -> bool {
        self.linkage.is_none()
    }

    fn positions(&self, y: &[f64]) -> Vec<f64> {
        let mut positions = vec![0.0; self.kinematics.joint_count()];
        self.actuators.actuators_from_command(&self.command(y), &mut positions);
        positions
    }

    /// Actuator commands.
    pub fn command(&self, y: &[f64]) -> Vec<f64> {
        let mut joints = vec![0.0; self.kinematics.joint_count()];
        self.ideal_joints(y, &mut joints);
        self.actuators.command_from_joints(&joints)
    }

    /// The unknowns of a command.
    pub fn of_command(&self, command: &[f64]) -> Result<Vec<f64>, ModelError> {
        self.kinematics.check_joints("command", command)?;
        let mut joints = vec![0.0; command.len()];
        self.actuators.joints_from_command(command, &mut joints);
        Ok(self.free.iter().map(|joint| joints[*joint]).collect())
    }

    /// How far an unknown may move if its own actuator may move by `way` and no other command depends on it; unlimited otherwise.
    pub fn way_of_actuator(&self, unknown: usize, way: f64) -> f64 {
        let column = self.command_by_free.column(unknown);
        let mut moved = column.iter().enumerate().filter(|(_, share)| **share != 0.0);
        match (moved.next(), moved.next()) {
            (Some((actuator, share)), None)
                if actuator == self.free[unknown]
                    && self.command_by_free.row(actuator).iter().filter(|share| **share != 0.0).count()
                        == 1 =>
            {
                way / share.abs()
            }
            _ => f64::INFINITY,
        }
    }

    /// Clamps unknowns to their limits.
    pub fn clamp(&self, y: &mut [f64]) {
        for (y, (low, high)) in y.iter_mut().zip(self.low.iter().zip(&self.high)) {
            *y = y.clamp(*low, *high);
        }
    }

    /// The same robot without limits of its joints.
    pub fn without_limits(&self) -> Self {
        let mut free = self.clone();
        free.low.fill(f64::NEG_INFINITY);
        free.high.fill(f64::INFINITY);
        free.sides.clear();
        free
    }
}
