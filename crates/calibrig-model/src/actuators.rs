//! From the controller's commands to the joint variables of the link chain.

use nalgebra::{DMatrix, DVector, Vector3};
use serde::{Deserialize, Serialize};

use super::{LinkageTerm, ModelError};
use crate::geometry::{Transform, rotation_x, rotation_y, translation};

/// The map from actuator commands to joint variables (SI, one actuator per joint).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ActuatorMap {
    /// Every actuator moves its own joint.
    Direct,
    /// The elbow is driven through a parallelogram from a crank coaxial with the shoulder: its motor, grounded on the waist,
    /// sets `psi = q[shoulder] + q[elbow] - offset`.
    Parallelogram {
        /// Index of the shoulder joint.
        shoulder: usize,
        /// Index of the elbow joint, whose command is psi. It follows the shoulder.
        elbow: usize,
        /// rad
        offset: f64,
        /// Lengths of the real mechanism, if known. This map is nevertheless that of the exact parallelogram; a four-bar is closed by the
        /// kinematics.
        linkage: Option<FourBar>,
    },
    /// The controller counts its axes differently from the table: with another sign, zero or unit, or coupled.
    Axes {
        /// From commands to the positions of the actuators.
        axes: AxisMap,
        /// The parallelogram that the elbow's actuator drives, if there is one.
        elbow: Option<ElbowDrive>,
    },
}

/// The lengths of a parallelogram; as [`ActuatorMap::Parallelogram`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ElbowDrive {
    /// Index of the shoulder joint.
    pub shoulder: usize,
    /// Index of the elbow joint.
    pub elbow: usize,
    /// rad
    pub offset: f64,
    /// Lengths of the real mechanism, if known.
    pub linkage: Option<FourBar>,
}

/// A linear map between what a controller shows of its axes and the positions of the actuators, `shown = S · actuators + zero`.
///
/// Actuators are counted as their joints are: without a parallelogram, an actuator's position *is* the joint variable.
///
/// ```
/// use calibrig_model::AxisMap;
/// use calibrig_model::nalgebra::{DMatrix, DVector};
///
/// // The second axis is shown against the horizontal: q2 - q1.
/// let shown = AxisMap::new(DMatrix::from_row_slice(2, 2, &[1.0, 0.0, -1.0, 1.0]), DVector::zeros(2))?;
/// let mut actuators = [0.0; 2];
/// shown.actuators(&[0.3, 0.1], &mut actuators);
/// assert_eq!(actuators, [0.3, 0.4]);
/// # Ok::<_, calibrig_model::ModelError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AxisMap {
    /// One row per axis, one column per actuator.
    shown_by_actuators: DMatrix<f64>,
    actuators_by_shown: DMatrix<f64>,
    /// The shown values when all actuators are at zero.
    zero: DVector<f64>,
    /// Axes that the controller does not command, because their joint follows others: their shown value is always zero.
    followers: Vec<bool>,
}

impl AxisMap {
    /// Shown values are `shown_by_actuators` (one row per axis, one column per actuator) times the actuators, plus `zero`.
    ///
    /// # Errors
    ///
    /// [`ModelError::Number`] for an entry that is not finite, [`ModelError::Length`] if the sizes do not fit, and
    /// [`ModelError::Coupling`] if the shown values do not determine the actuators.
    pub fn new(shown_by_actuators: DMatrix<f64>, zero: DVector<f64>) -> Result<Self, ModelError> {
        let expected = shown_by_actuators.nrows();
        for found in [shown_by_actuators.ncols(), zero.len()] {
            if found != expected {
                return Err(ModelError::Length { field: "actuators.axes", found, expected });
            }
        }
        let axis = |index: usize| if expected == 0 { 0 } else { index % expected };
        let mut entries = shown_by_actuators.iter().chain(&zero).enumerate();
        if let Some((index, &value)) = entries.find(|(_, value)| !value.is_finite()) {
            let (field, joint) = ("actuators.axes", Some(axis(index)));
            return Err(ModelError::Number { field, joint, value, expected: "a finite number" });
        }
        // Rows and columns are balanced first, so that ratios do not make a map look singular.
        let mut even = shown_by_actuators.clone();
        for mut row in even.row_iter_mut() {
            let size = row.amax();
            if size > 0.0 {
                row /= size;
            }
        }
        let singular = even.singular_values();
        if !(singular.min() > SINGULAR * singular.max()) {
            return Err(ModelError::Coupling);
        }
        let actuators_by_shown = shown_by_actuators.clone().try_inverse().ok_or(ModelError::Coupling)?;
        let followers = vec![false; expected];
        Ok(Self { shown_by_actuators, actuators_by_shown, zero, followers })
    }

    /// The same with these axes, by index, as followers: their rows state a combination that is zero, such as `q3 + q2` for a joint that turns
    /// back as much as the second one turns. Indices without an axis are ignored.
    #[must_use]
    pub fn with_followers(mut self, followers: &[usize]) -> Self {
        for follower in followers {
            if let Some(follows) = self.followers.get_mut(*follower) {
                *follows = true;
            }
        }
        self
    }

    /// Number of axes.
    pub fn axes(&self) -> usize {
        self.zero.len()
    }

    /// Shown values per unit of the actuators: one row per axis, one column per actuator. For a follower, its row times the actuators, plus its
    /// [`zero`](Self::zero), is zero.
    pub fn shown_by_actuators(&self) -> &DMatrix<f64> {
        &self.shown_by_actuators
    }

    /// The shown values when all actuators are at zero, one per axis.
    pub fn zero(&self) -> &DVector<f64> {
        &self.zero
    }

    /// Writes the actuators' positions for these shown values; both one per axis. If one is shorter, the rest is left as
    /// it is.
    pub fn actuators(&self, shown: &[f64], actuators: &mut [f64]) {
        for (row, actuator) in self.actuators_by_shown.row_iter().zip(actuators) {
            let shares = row.iter().zip(&self.zero).zip(shown);
            *actuator = shares
                .map(|((share, zero), shown)| if *share == 0.0 { 0.0 } else { share * (shown - zero) })
                .sum();
        }
    }

    /// The shown values for actuators at these positions; always zero for a follower.
    pub fn shown(&self, actuators: &[f64]) -> Vec<f64> {
        let row = |(axis, zero): (usize, &f64)| {
            if self.followers[axis] {
                return 0.0;
            }
            let shares = self.shown_by_actuators.row(axis);
            zero + shares.iter().zip(actuators).map(|(share, actuator)| share * actuator).sum::<f64>()
        };
        self.zero.iter().enumerate().map(row).collect()
    }

    /// Motion of an actuator per unit of an axis's shown value, m or rad each; zero for an axis that does not exist.
    pub fn rate(&self, actuator: usize, axis: usize) -> f64 {
        self.actuators_by_shown.get((actuator, axis)).copied().unwrap_or(0.0)
    }
}

/// Below this share of its largest singular value a coupling counts as singular.
const SINGULAR: f64 = 1e-9;

/// The spatial four-bar that drives the elbow: the crank turns on the waist about an axis at or next to the shoulder's, the lever is part of
/// the forearm, and the coupler rod, on spherical joints, keeps their ends at its length.
///
/// The crank's frame is the shoulder's link frame with [the crank's axis](CrankAxis) in place of the shoulder's, at the joint variable `psi +
/// offset + theta` with the theta of the elbow's link, and without the shoulder's bearing; the lever's frame is the elbow's link frame. So
/// crank and lever are parallel in an exact parallelogram, and an error of theta is an error of the motor's zero, with or without a four-bar.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FourBar {
    /// The end of the crank in its frame.
    pub crank: LinkageArm,
    /// The end of the lever in the elbow's link frame.
    pub lever: LinkageArm,
    /// Length of the coupler rod, m.
    pub rod: f64,
    /// The axis about which the crank turns; the shoulder's if not stated.
    #[serde(default, skip_serializing_if = "CrankAxis::is_shoulders")]
    pub axis: CrankAxis,
}

/// Displacement of the crank's axis from the shoulder's: in the shoulder's frame at its joint variable zero (z along its axis), first along x and y,
/// then tilted about x and y, `Tx(x) · Ty(y) · Rx(rx) · Ry(ry)`. A displacement along or about z belongs to the arm's [`along`](LinkageArm::along)
/// or to the motor's zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct CrankAxis {
    /// m
    pub x: f64,
    /// m
    pub y: f64,
    /// rad
    pub rx: f64,
    /// rad
    pub ry: f64,
}

impl CrankAxis {
    /// From the frame in which the crank turns about z to the shoulder's.
    pub fn shoulder_from_axis(&self) -> Transform {
        translation(self.x, self.y, 0.0) * rotation_x(self.rx) * rotation_y(self.ry)
    }

    /// Whether the crank turns about the shoulder's own axis.
    pub fn is_shoulders(&self) -> bool {
        *self == Self::default()
    }
}

impl FourBar {
    /// The value of a parameter, m or rad.
    pub fn term(&self, which: LinkageTerm) -> f64 {
        let mut copy = *self;
        *copy.term_mut(which)
    }

    /// The parameter itself, to change it.
    pub fn term_mut(&mut self, which: LinkageTerm) -> &mut f64 {
        match which {
            LinkageTerm::Crank => &mut self.crank.length,
            LinkageTerm::Lever => &mut self.lever.length,
            LinkageTerm::Rod => &mut self.rod,
            LinkageTerm::AxisX => &mut self.axis.x,
            LinkageTerm::AxisY => &mut self.axis.y,
            LinkageTerm::AxisRx => &mut self.axis.rx,
            LinkageTerm::AxisRy => &mut self.axis.ry,
        }
    }
}

/// A point at `(length cos(angle), length sin(angle), along)` of a frame that turns about z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LinkageArm {
    /// m
    pub length: f64,
    /// From the frame's x axis about z, rad.
    pub angle: f64,
    /// Along z, m.
    pub along: f64,
}

impl LinkageArm {
    /// The arm's end, m.
    pub fn end(&self) -> Vector3<f64> {
        let (sin, cos) = self.angle.sin_cos();
        Vector3::new(self.length * cos, self.length * sin, self.along)
    }
}

impl ActuatorMap {
    /// The parallelogram between shoulder and elbow, if there is one.
    pub fn elbow(&self) -> Option<ElbowDrive> {
        match *self {
            Self::Direct => None,
            Self::Parallelogram { shoulder, elbow, offset, linkage } => {
                Some(ElbowDrive { shoulder, elbow, offset, linkage })
            }
            Self::Axes { elbow, .. } => elbow,
        }
    }

    /// The lengths of the four-bar, mutable, if known.
    pub fn linkage_mut(&mut self) -> Option<&mut FourBar> {
        match self {
            Self::Direct => None,
            Self::Parallelogram { linkage, .. } => linkage.as_mut(),
            Self::Axes { elbow, .. } => elbow.as_mut()?.linkage.as_mut(),
        }
    }

    /// The same with the exact parallelogram in place of a four-bar.
    #[must_use]
    pub fn without_linkage(mut self) -> Self {
        match &mut self {
            Self::Direct => {}
            Self::Parallelogram { linkage, .. } => *linkage = None,
            Self::Axes { elbow, .. } => {
                if let Some(elbow) = elbow {
                    elbow.linkage = None;
                }
            }
        }
        self
    }

    /// Writes the actuators' positions at `command`, in the sense and unit of their joints: `psi` for an elbow with a parallelogram, otherwise
    /// the joint variable. Both as long as the chain; if one is shorter, the rest is left as it is.
    pub fn actuators_from_command(&self, command: &[f64], actuators: &mut [f64]) {
        match self {
            Self::Axes { axes, .. } => axes.actuators(command, actuators),
            Self::Direct | Self::Parallelogram { .. } => {
                for (actuator, command) in actuators.iter_mut().zip(command) {
                    *actuator = *command;
                }
            }
        }
    }

    /// The inverse of [`actuators_from_command`](Self::actuators_from_command).
    pub fn command_from_actuators(&self, actuators: &[f64]) -> Vec<f64> {
        match self {
            Self::Axes { axes, .. } => axes.shown(actuators),
            Self::Direct | Self::Parallelogram { .. } => actuators.to_vec(),
        }
    }

    /// Whether the controller commands an axis; it does not if its joint follows others.
    pub fn is_commanded(&self, axis: usize) -> bool {
        match self {
            Self::Axes { axes, .. } => !axes.followers.get(axis).copied().unwrap_or(false),
            Self::Direct | Self::Parallelogram { .. } => true,
        }
    }

    /// Sets joints that follow others to where these take them. Joint variables, as long as the chain.
    pub fn follow(&self, joints: &mut [f64]) {
        let followers: Vec<usize> = (0..joints.len()).filter(|axis| !self.is_commanded(*axis)).collect();
        if followers.is_empty() {
            return;
        }
        let mut led = joints.to_vec();
        self.joints_from_command(&self.command_from_joints(joints), &mut led);
        for follower in followers {
            joints[follower] = led[follower];
        }
    }

    /// Change of an actuator, in the sense and unit of its joint, per unit of a command.
    pub fn rate(&self, actuator: usize, command: usize) -> f64 {
        match self {
            Self::Axes { axes, .. } => axes.rate(actuator, command),
            Self::Direct | Self::Parallelogram { .. } => f64::from(u8::from(actuator == command)),
        }
    }

    /// Writes the joint variables of `command` to `joints`; both as long as the chain. If one is shorter, the rest is left as it is.
    pub fn joints_from_command(&self, command: &[f64], joints: &mut [f64]) {
        self.actuators_from_command(command, joints);
        if let Some(ElbowDrive { shoulder, elbow, offset, .. }) = self.elbow()
            && let Some(&upper) = joints.get(shoulder)
            && shoulder < command.len()
            && elbow < command.len()
            && let Some(joint) = joints.get_mut(elbow)
        {
            *joint = *joint + offset - upper;
        }
    }

    /// The four-bar between shoulder and elbow, if its lengths are known: (shoulder, elbow, offset, linkage).
    pub fn four_bar(&self) -> Option<(usize, usize, f64, &FourBar)> {
        match self {
            Self::Parallelogram { shoulder, elbow, offset, linkage: Some(linkage) }
            | Self::Axes {
                elbow: Some(ElbowDrive { shoulder, elbow, offset, linkage: Some(linkage) }),
                ..
            } => Some((*shoulder, *elbow, *offset, linkage)),
            _ => None,
        }
    }

    /// A parameter of the four-bar, m or rad, if known.
    pub fn linkage_term(&self, which: LinkageTerm) -> Option<f64> {
        self.four_bar().map(|(_, _, _, linkage)| linkage.term(which))
    }

    /// The command that takes an ideal machine to `joints`.
    pub fn command_from_joints(&self, joints: &[f64]) -> Vec<f64> {
        let mut actuators = joints.to_vec();
        if let Some(ElbowDrive { shoulder, elbow, offset, .. }) = self.elbow()
            && let (Some(psi), Some(upper), Some(joint)) =
                (actuators.get_mut(elbow), joints.get(shoulder), joints.get(elbow))
        {
            *psi = upper + joint - offset;
        }
        self.command_from_actuators(&actuators)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parallelogram_is_inverted_and_a_shoulder_move_does_not_turn_the_forearm() {
        let map = ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.25, linkage: None };
        let joints = [0.5, 0.1, -1.7, 0.12, 2.0];
        let mut command = map.command_from_joints(&joints);
        let mut back = [0.0; 5];
        map.joints_from_command(&command, &mut back);
        for (a, b) in joints.iter().zip(back) {
            assert!((a - b).abs() < 1e-15);
        }
        command[2] += 0.3;
        map.joints_from_command(&command, &mut back);
        let absolute = joints[2] + joints[3];
        assert!((back[2] + back[3] - absolute).abs() < 1e-15);
    }

    #[test]
    fn axes_are_shown_with_sign_ratio_zero_and_coupling() {
        // J1 counts the other way, J2 is twice the joint from 0.1 on, J3 is shown against the horizontal.
        let shown = DMatrix::from_row_slice(3, 3, &[-1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, -1.0, 1.0]);
        let axes = AxisMap::new(shown, DVector::from_vec(vec![0.0, 0.1, -0.2])).expect("can be turned round");
        let map = ActuatorMap::Axes { axes, elbow: None };
        let joints = [0.5, -0.3, 0.9];
        let command = map.command_from_joints(&joints);
        for (found, expected) in command.iter().zip([-0.5, -0.5, 1.0]) {
            assert!((found - expected).abs() < 1e-15, "{command:?}");
        }
        let mut back = [0.0; 3];
        map.joints_from_command(&command, &mut back);
        for (found, expected) in back.iter().zip(joints) {
            assert!((found - expected).abs() < 1e-15, "{back:?}");
        }
        // A step of what is shown of J2 moves J3 with it.
        assert_eq!((map.rate(1, 1), map.rate(2, 1), map.rate(0, 0)), (0.5, 0.5, -1.0));
    }

    #[test]
    fn axes_lie_in_front_of_a_parallelogram() {
        let shown = DMatrix::from_row_slice(3, 3, &[1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0]);
        let axes = AxisMap::new(shown, DVector::from_vec(vec![0.0, 0.2, 0.0])).expect("can be turned round");
        let drive = ElbowDrive { shoulder: 1, elbow: 2, offset: 0.25, linkage: None };
        let (plain, map) = (
            ActuatorMap::Parallelogram { shoulder: 1, elbow: 2, offset: 0.25, linkage: None },
            ActuatorMap::Axes { axes, elbow: Some(drive) },
        );
        let joints = [0.4, 0.7, -1.1];
        let (of_plain, command) = (plain.command_from_joints(&joints), map.command_from_joints(&joints));
        assert!((command[1] - (0.2 - of_plain[1])).abs() < 1e-15);
        assert!((command[2] - of_plain[2]).abs() < 1e-15);
        let mut back = [0.0; 3];
        map.joints_from_command(&command, &mut back);
        for (found, expected) in back.iter().zip(joints) {
            assert!((found - expected).abs() < 1e-15);
        }
    }

    #[test]
    fn a_follower_goes_with_its_leader_and_takes_no_command() {
        // q3 + q2 - 0.2 is zero: the third joint turns back what the second one turns.
        let shown = DMatrix::from_row_slice(3, 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0]);
        let axes = AxisMap::new(shown, DVector::from_vec(vec![0.0, 0.0, -0.2])).expect("lower triangular");
        let map = ActuatorMap::Axes { axes: axes.with_followers(&[2, 7]), elbow: None };
        assert_eq!([0, 1, 2, 3].map(|axis| map.is_commanded(axis)), [true, true, false, true]);
        let command = map.command_from_joints(&[0.1, 0.5, 99.0]);
        assert_eq!(command, [0.1, 0.5, 0.0]);
        let mut joints = [0.0; 3];
        map.joints_from_command(&command, &mut joints);
        assert!((joints[2] - (0.2 - 0.5)).abs() < 1e-15);
        let mut wherever = [0.1, 0.5, 99.0];
        map.follow(&mut wherever);
        assert_eq!(wherever, joints);
    }

    #[test]
    fn what_does_not_tell_where_the_actuators_are_is_refused() {
        let refused = |rows: &[f64], zero: &[f64]| {
            AxisMap::new(DMatrix::from_row_slice(2, 2, rows), DVector::from_column_slice(zero))
        };
        assert_eq!(refused(&[1.0, 2.0, 2.0, 4.0], &[0.0, 0.0]), Err(ModelError::Coupling));
        assert_eq!(refused(&[0.0, 0.0, 0.0, 1.0], &[0.0, 0.0]), Err(ModelError::Coupling));
        assert!(matches!(refused(&[1.0, f64::NAN, 0.0, 1.0], &[0.0, 0.0]), Err(ModelError::Number { .. })));
        assert!(matches!(refused(&[1.0, 0.0, 0.0, 1.0], &[0.0]), Err(ModelError::Length { .. })));
        // Ratios that are far apart are no coupling.
        assert!(refused(&[1e-5, 0.0, 0.0, 1e6], &[0.0, 0.0]).is_ok());
    }
}
