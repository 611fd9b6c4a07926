//! A convention that a session may break.

use std::f64::consts::FRAC_PI_2;

use super::FarOff;
use calibrig_model::ActuatorMap;

/// One way in which a session may have been misread. Joints and observations are counted from zero.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Part {
    /// Commands of revolute joints are in another unit.
    AngleUnit {
        /// Which joints.
        joints: Vec<usize>,
        /// Factor by which the commands have to be multiplied.
        factor: f64,
    },
    /// Commands of prismatic joints are in another unit.
    TravelUnit {
        /// Which joints.
        joints: Vec<usize>,
        /// Factor by which the commands have to be multiplied.
        factor: f64,
    },
    /// The points are in another unit.
    PointUnit {
        /// Factor by which the points have to be multiplied.
        factor: f64,
    },
    /// The tracker's angles are in another unit.
    TrackerAngleUnit {
        /// Factor by which the angles have to be multiplied.
        factor: f64,
        /// Whether the second angle is measured from the zenith.
        zenith: bool,
    },
    /// A joint moves the other way.
    Sign {
        /// Which joint.
        joint: usize,
    },
    /// A joint's zero is elsewhere, by multiples of a quarter turn.
    Offset {
        /// Which joint.
        joint: usize,
        /// Correction of the command, in quarters of a turn: -1, 1 or 2.
        quarters: i8,
    },
    /// The columns of the commands are in another order.
    Order {
        /// The column that belongs to each joint.
        from: Vec<usize>,
        /// Factor for the joint's column where it was read as one of another kind of joint; otherwise 1.
        factors: Vec<f64>,
    },
    /// A joint is driven with another one.
    Coupling {
        /// Which joint.
        joint: usize,
        /// The other joint.
        with: usize,
        /// The share of the other's command that has to be added: 1 or -1.
        share: f64,
        /// Whether the other joint, which is coupled itself, counts with its joint variable instead of its command.
        of_joint: bool,
    },
    /// The table is in the other convention.
    Convention {
        /// Whether that is the standard convention.
        standard: bool,
    },
    /// The target is on another link than the last.
    ToolLink {
        /// The joint that moves this link.
        joint: usize,
    },
    /// Points are next to the commands of other rows.
    ShiftedRows {
        /// Each command belongs to the point this many rows below.
        by: i64,
    },
    /// An angle from the zenith was read as an elevation, or vice versa.
    ZenithElevation {
        /// Whether, of the two points that coordinates leave open, the one on the side with fewer points is meant.
        turned: bool,
    },
    /// Azimuth and elevation are exchanged.
    AnglesExchanged {
        /// Whether what was read as an elevation is the complement of a zenith angle.
        zenith: bool,
    },
    /// The points are mirrored: axes are exchanged, or one of them, or the azimuth, has the opposite sense.
    Mirrored,
    /// Observations have each other's points.
    ExchangedRows {
        /// In each cycle, every observation has the point of the next one, and the last has that of the first.
        cycles: Vec<Vec<usize>>,
    },
    /// Points that are off.
    GrossErrors {
        /// Which observations, farthest first.
        rows: Vec<FarOff>,
    },
    /// Codes of missed shots in place of points.
    MissedShots {
        /// Which observations, with the distance from the middle of the others.
        rows: Vec<FarOff>,
    },
    /// Several targets with different offsets have the same name.
    SeveralTargets {
        /// Index of the target.
        target: usize,
        /// The observations of each target except the most frequent one.
        others: Vec<Vec<usize>>,
    },
}

impl Part {
    /// The key in JSON.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::AngleUnit { .. } | Self::TrackerAngleUnit { .. } => "angle_unit",
            Self::TravelUnit { .. } | Self::PointUnit { .. } => "length_unit",
            Self::Sign { .. } => "joint_sign",
            Self::Offset { .. } => "joint_offset",
            Self::Order { .. } => "joint_order",
            Self::Coupling { .. } => "coupling",
            Self::Convention { .. } => "convention",
            Self::ToolLink { .. } => "tool_link",
            Self::ShiftedRows { .. } => "rows_shifted",
            Self::ZenithElevation { .. } => "zenith_elevation",
            Self::AnglesExchanged { .. } => "axes_exchanged",
            Self::Mirrored => "mirrored_frame",
            Self::ExchangedRows { .. } => "rows_exchanged",
            Self::GrossErrors { .. } => "gross_error",
            Self::MissedShots { .. } => "missed_shot_code",
            Self::SeveralTargets { .. } => "mixed_targets",
        }
    }

    /// Joints that the part concerns.
    pub fn joints(&self) -> Vec<usize> {
        match self {
            Self::AngleUnit { joints, .. } | Self::TravelUnit { joints, .. } => joints.clone(),
            Self::Sign { joint } | Self::Offset { joint, .. } | Self::ToolLink { joint } => vec![*joint],
            Self::Coupling { joint, with, .. } => vec![*joint, *with],
            Self::Order { from, .. } => (0..from.len()).filter(|joint| from[*joint] != *joint).collect(),
            _ => Vec::new(),
        }
    }

    /// Observations that the part concerns.
    pub fn rows(&self) -> Vec<usize> {
        match self {
            Self::ExchangedRows { cycles } => cycles.iter().flatten().copied().collect(),
            Self::GrossErrors { rows } | Self::MissedShots { rows } => {
                rows.iter().map(|far| far.observation).collect()
            }
            Self::SeveralTargets { others, .. } => others.iter().flatten().copied().collect(),
            _ => Vec::new(),
        }
    }

    /// Whether the part concerns single rows.
    pub fn is_of_rows(&self) -> bool {
        matches!(
            self,
            Self::ExchangedRows { .. }
                | Self::GrossErrors { .. }
                | Self::MissedShots { .. }
                | Self::SeveralTargets { .. }
        )
    }

    /// Rank: of two parts that explain the same, the one of lower rank is the more common mistake.
    pub(super) fn rank(&self) -> u8 {
        match self {
            Self::AngleUnit { joints, .. } if joints.len() > 1 => 0,
            Self::PointUnit { .. } | Self::TravelUnit { .. } => 1,
            Self::Mirrored | Self::MissedShots { .. } => 2,
            Self::Sign { .. } => 3,
            Self::Offset { .. } | Self::ZenithElevation { .. } | Self::AnglesExchanged { .. } => 4,
            Self::Order { from, .. } if moved(from) == 2 => 5,
            Self::ShiftedRows { .. } | Self::Convention { .. } | Self::TrackerAngleUnit { .. } => 5,
            Self::Coupling { .. }
            | Self::ExchangedRows { .. }
            | Self::GrossErrors { .. }
            | Self::SeveralTargets { .. } => 6,
            Self::ToolLink { .. } | Self::AngleUnit { .. } => 7,
            Self::Order { .. } => 8,
        }
    }

    /// Whether the part is common enough to be tried together with another one.
    pub(super) fn is_usual(&self) -> bool {
        match self {
            Self::Order { from, .. } => moved(from) == 2 || is_all_moved(from),
            Self::Coupling { joint, with, .. } => joint.abs_diff(*with) <= 2,
            Self::TravelUnit { factor, .. } => [1e3, 1e-3].contains(factor),
            _ => true,
        }
    }

    /// Merges two consecutive orders into one.
    pub(super) fn merged(parts: Vec<Self>) -> Vec<Self> {
        let [Self::Order { from: a, factors: f }, Self::Order { from: b, factors: g }] = parts.as_slice()
        else {
            return parts;
        };
        let from = b.iter().map(|column| a[*column]).collect();
        let factors = b.iter().zip(g).map(|(column, g)| f[*column] * g).collect();
        vec![Self::Order { from, factors }]
    }

    /// Parts in the order in which they change the commands.
    pub fn in_order<'p>(parts: &[&'p Self]) -> Vec<&'p Self> {
        let mut ordered = parts.to_vec();
        if !(parts.len() == 2 && parts[0].is_twofold_with(parts[1])) {
            ordered.sort_by_key(|part| part.layer());
        }
        ordered
    }

    /// Step of reading a session in which the part applies.
    fn layer(&self) -> u8 {
        match self {
            Self::Order { .. } => 0,
            Self::AngleUnit { .. } | Self::TravelUnit { .. } => 1,
            Self::Sign { .. } => 2,
            Self::Offset { .. } => 3,
            _ => 4,
        }
    }

    /// Whether the order of the two matters beyond the usual order.
    pub(super) fn is_twofold_with(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Coupling { joint, with, .. }, Self::Coupling { joint: j, with: w, .. }) => {
                joint == w || with == j
            }
            (Self::Coupling { with, .. }, Self::Offset { joint, .. })
            | (Self::Offset { joint, .. }, Self::Coupling { with, .. }) => joint == with,
            (Self::Order { from: a, .. }, Self::Order { from: b, .. }) => {
                (0..a.len()).any(|i| a[i] != i && b[i] != i)
            }
            _ => false,
        }
    }

    /// Changes the command of one observation. `before` is memory for a copy.
    pub(super) fn command(&self, actuators: &ActuatorMap, command: &mut [f64], before: &mut Vec<f64>) {
        match self {
            Self::AngleUnit { joints, factor } | Self::TravelUnit { joints, factor } => {
                for joint in joints {
                    command[*joint] *= factor;
                }
            }
            Self::Sign { joint } => command[*joint] = -command[*joint],
            Self::Offset { joint, quarters } => command[*joint] += FRAC_PI_2 * f64::from(*quarters),
            Self::Coupling { joint, with, share, of_joint: true } => {
                before.clear();
                before.resize(command.len(), 0.0);
                actuators.actuators_from_command(command, before);
                command[*joint] += share * before[*with];
            }
            Self::Coupling { joint, with, share, .. } => command[*joint] += share * command[*with],
            Self::Order { from, factors } => {
                before.clear();
                before.extend_from_slice(command);
                for (joint, (column, factor)) in from.iter().zip(factors).enumerate() {
                    command[joint] = factor * before[*column];
                }
            }
            _ => {}
        }
    }
}

/// Whether the columns are in reverse order, or the first stands last, or the last first.
fn is_all_moved(from: &[usize]) -> bool {
    let n = from.len();
    let is =
        |column: &dyn Fn(usize) -> usize| from.iter().enumerate().all(|(joint, from)| *from == column(joint));
    is(&|joint| n - 1 - joint) || is(&|joint| (joint + 1) % n) || is(&|joint| (joint + n - 1) % n)
}

/// Number of joints that take another column.
pub(super) fn moved(from: &[usize]) -> usize {
    from.iter().enumerate().filter(|(joint, column)| joint != *column).count()
}
