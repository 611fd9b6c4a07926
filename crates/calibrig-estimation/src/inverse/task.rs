//! What the tool should do, and how far it misses it.

use nalgebra::{Matrix6xX, Rotation3, Vector3};
use thiserror::Error;

use calibrig_model::geometry::{Transform, rotation_vector};

/// Where the tool should be in the base frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// The tool's point only: three rows.
    Position(Vector3<f64>),
    /// The point and the direction of one axis of the tool, as for a spray gun that may turn about its jet: five rows.
    Axis {
        /// Position of the tool's point, m.
        position: Vector3<f64>,
        /// Direction of the axis, of any length but zero.
        direction: Vector3<f64>,
    },
    /// `base_from_tool`: six rows.
    Pose(Transform),
}

/// Why a goal or a tool is refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum GoalError {
    /// A coordinate is not finite.
    #[error("the {field} of the goal is ({}, {}, {}): expected finite numbers", value[0], value[1], value[2])]
    NotFinite {
        /// The part of the goal that is not finite.
        field: &'static str,
        /// Value as stated.
        value: [f64; 3],
    },
    /// A direction has length zero.
    #[error("the direction of the {of} has length {length}: expected a length above zero")]
    NoDirection {
        /// What the direction belongs to.
        of: &'static str,
        /// Length as stated.
        length: f64,
    },
}

impl Goal {
    /// Position of the tool's point, m.
    pub fn position(&self) -> Vector3<f64> {
        match self {
            Self::Position(position) | Self::Axis { position, .. } => *position,
            Self::Pose(pose) => pose.translation.vector,
        }
    }

    /// The same goal with the tool's point elsewhere, m.
    #[must_use]
    pub fn moved_to(self, position: Vector3<f64>) -> Self {
        match self {
            Self::Position(_) => Self::Position(position),
            Self::Axis { direction, .. } => Self::Axis { position, direction },
            Self::Pose(pose) => Self::Pose(Transform::from_parts(position.into(), pose.rotation)),
        }
    }

    /// Whether another goal is the same within `near`, m and rad.
    pub(crate) fn is_at(&self, other: &Self, near: f64) -> bool {
        let place = (self.position() - other.position()).norm() <= near;
        place
            && match (self, other) {
                (Self::Position(_), Self::Position(_)) => true,
                (Self::Axis { direction: a, .. }, Self::Axis { direction: b, .. }) => {
                    (a.normalize() - b.normalize()).norm() <= near
                }
                (Self::Pose(a), Self::Pose(b)) => (a.rotation * b.rotation.inverse()).angle() <= near,
                _ => false,
            }
    }

    /// Number of the goal's equations.
    pub fn rows(&self) -> usize {
        match self {
            Self::Position(_) => 3,
            Self::Axis { .. } => 5,
            Self::Pose(_) => 6,
        }
    }

    /// Checks the goal's numbers.
    ///
    /// # Errors
    ///
    /// [`GoalError`].
    pub fn check(&self) -> Result<(), GoalError> {
        finite("position", &self.position())?;
        match self {
            Self::Position(_) => Ok(()),
            Self::Axis { direction, .. } => unit("goal", direction).map(drop),
            Self::Pose(pose) => finite("rotation", &rotation_vector(&pose.rotation)),
        }
    }
}

fn finite(field: &'static str, v: &Vector3<f64>) -> Result<(), GoalError> {
    if v.iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    Err(GoalError::NotFinite { field, value: [v.x, v.y, v.z] })
}

fn unit(of: &'static str, v: &Vector3<f64>) -> Result<Vector3<f64>, GoalError> {
    finite("direction", v)?;
    let length = v.norm();
    if length > 0.0 && length.is_finite() {
        Ok(v / length)
    } else {
        Err(GoalError::NoDirection { of, length })
    }
}

/// The tool on the flange.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tool {
    /// `flange_from_tool`; its origin is the tool's point.
    flange_from_tool: Transform,
    /// The tool's axis, a unit vector in the tool's axes.
    axis: Vector3<f64>,
}

impl Tool {
    /// A tool whose z axis is the one that [`Goal::Axis`] directs.
    ///
    /// # Errors
    ///
    /// [`GoalError::NotFinite`].
    pub fn new(flange_from_tool: Transform) -> Result<Self, GoalError> {
        finite("tool's place", &flange_from_tool.translation.vector)?;
        finite("tool's rotation", &rotation_vector(&flange_from_tool.rotation))?;
        Ok(Self { flange_from_tool, axis: Vector3::z() })
    }

    /// A tool at a point of the flange frame, m, with the flange's axes.
    ///
    /// # Errors
    ///
    /// As [`new`](Self::new).
    pub fn at(in_flange: Vector3<f64>) -> Result<Self, GoalError> {
        Self::new(Transform::from_parts(in_flange.into(), Rotation3::identity()))
    }

    /// The same tool with another of its axes for [`Goal::Axis`], of any length but zero.
    ///
    /// # Errors
    ///
    /// [`GoalError`].
    pub fn with_axis(self, axis: Vector3<f64>) -> Result<Self, GoalError> {
        Ok(Self { axis: unit("tool's axis", &axis)?, ..self })
    }

    /// `flange_from_tool`.
    pub fn flange_from_tool(&self) -> &Transform {
        &self.flange_from_tool
    }

    /// The axis that [`Goal::Axis`] directs, a unit vector in the tool's axes.
    pub fn axis(&self) -> &Vector3<f64> {
        &self.axis
    }
}

/// A valid goal, with the axis of the tool that it directs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Aim {
    goal: Goal,
    tool_axis: Vector3<f64>,
    /// Length that a radian counts as, m.
    pub lever: f64,
}

/// Miss of a goal at the current place of the tool.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Miss {
    /// Missing position along the base's axes, m.
    pub position: Vector3<f64>,
    /// Missing rotation in the base's axes, rad.
    pub turn: Vector3<f64>,
    /// Two unit vectors perpendicular to the tool's axis.
    across: [Vector3<f64>; 2],
}

impl Aim {
    pub fn new(goal: &Goal, tool: &Tool, lever: f64) -> Result<Self, GoalError> {
        goal.check()?;
        let goal = match *goal {
            Goal::Axis { position, direction } => {
                Goal::Axis { position, direction: unit("goal", &direction)? }
            }
            other => other,
        };
        Ok(Self { goal, tool_axis: tool.axis, lever })
    }

    pub fn rows(&self) -> usize {
        self.goal.rows()
    }

    pub fn goal(&self) -> &Goal {
        &self.goal
    }

    /// The squared distance to a place of the tool, with angles multiplied by the lever, m²; cheap, and accurate for small angles.
    pub fn distance_squared(&self, base_from_tool: &Transform) -> f64 {
        let off = (self.goal.position() - base_from_tool.translation.vector).norm_squared();
        let turned = match &self.goal {
            Goal::Position(_) => 0.0,
            Goal::Axis { direction, .. } => {
                2.0 - 2.0 * direction.dot(&(base_from_tool.rotation * self.tool_axis))
            }
            Goal::Pose(pose) => 3.0 - pose.rotation.matrix().dot(base_from_tool.rotation.matrix()),
        };
        off + self.lever * self.lever * turned
    }

    pub fn miss(&self, base_from_tool: &Transform) -> Miss {
        let position = self.goal.position() - base_from_tool.translation.vector;
        let still = [Vector3::zeros(); 2];
        match &self.goal {
            Goal::Position(_) => Miss { position, turn: Vector3::zeros(), across: still },
            Goal::Axis { direction, .. } => {
                let axis = base_from_tool.rotation * self.tool_axis;
                let across = across(&axis);
                let (sine, cosine) = (axis.cross(direction), axis.dot(direction));
                let size = sine.norm();
                let angle = size.atan2(cosine);
                // Where the axis points the opposite way, all rotations across it are equally short.
                let turn = if size > 1e-12 {
                    sine * (angle / size)
                } else if cosine < 0.0 {
                    angle * across[0]
                } else {
                    sine
                };
                Miss { position, turn, across }
            }
            Goal::Pose(pose) => {
                let turn = shortest_turn(&(pose.rotation * base_from_tool.rotation.inverse()));
                Miss { position, turn, across: still }
            }
        }
    }

    /// The miss, row by row, m.
    pub fn errors(&self, miss: &Miss, rows: &mut [f64]) {
        rows[..3].copy_from_slice(miss.position.as_slice());
        match self.goal {
            Goal::Position(_) => {}
            Goal::Axis { .. } => {
                rows[3] = self.lever * miss.across[0].dot(&miss.turn);
                rows[4] = self.lever * miss.across[1].dot(&miss.turn);
            }
            Goal::Pose(_) => {
                for axis in 0..3 {
                    rows[3 + axis] = self.lever * miss.turn[axis];
                }
            }
        }
    }

    /// Change of the rows by motions of the tool (m and rad per unit, one per column), written to the first rows of `into`.
    ///
    /// With it, the gradient of the squared miss is exact; the change of the rows themselves is exact only where nothing is missed.
    pub fn project(&self, miss: &Miss, motions: &Matrix6xX<f64>, into: &mut nalgebra::DMatrix<f64>) {
        for (column, motion) in motions.column_iter().enumerate() {
            for row in 0..3 {
                into[(row, column)] = motion[row];
            }
            let turn = motion.fixed_rows::<3>(3);
            match self.goal {
                Goal::Position(_) => {}
                Goal::Axis { .. } => {
                    into[(3, column)] = self.lever * miss.across[0].dot(&turn);
                    into[(4, column)] = self.lever * miss.across[1].dot(&turn);
                }
                Goal::Pose(_) => {
                    for axis in 0..3 {
                        into[(3 + axis, column)] = self.lever * turn[axis];
                    }
                }
            }
        }
    }
}

/// The rotation vector, rad, also for half a turn, where the sine does not determine its axis.
fn shortest_turn(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let turn = rotation_vector(rotation);
    if turn.norm() > 0.0 || rotation.matrix().trace() > 0.0 {
        return turn;
    }
    // R + 1 is twice the projection onto the axis.
    let projection = rotation.matrix() + nalgebra::Matrix3::identity();
    let axis = (0..3).map(|column| projection.column(column).into_owned());
    let longest = axis.max_by(|a, b| a.norm().total_cmp(&b.norm())).unwrap_or_default();
    std::f64::consts::PI * longest.normalize()
}

/// Two unit vectors perpendicular to each other and to a unit vector.
fn across(axis: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = axis.cross(&Vector3::ith(axis.iamin(), 1.0)).normalize();
    [first, axis.cross(&first)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn missed(goal: Goal, from: &Transform) -> Miss {
        let tool = Tool::at(Vector3::zeros()).expect("a tool");
        Aim::new(&goal, &tool, 1.0).expect("a goal").miss(from)
    }

    /// A miss of half a turn is reported as half a turn, although its sine is zero.
    #[test]
    fn half_a_turn_is_not_nothing() {
        for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
            let turned = Rotation3::new(PI * axis).matrix().map(f64::round);
            let pose =
                Transform::from_parts(Vector3::zeros().into(), Rotation3::from_matrix_unchecked(turned));
            let turn = missed(Goal::Pose(pose), &Transform::identity()).turn;
            assert!((turn.norm() - PI).abs() < 1e-12 && turn.cross(&axis).norm() < 1e-12, "{turn}");
        }
        let away = Goal::Axis { position: Vector3::zeros(), direction: -2.0 * Vector3::z() };
        let turn = missed(away, &Transform::identity()).turn;
        assert!((turn.norm() - PI).abs() < 1e-12 && turn.z == 0.0, "{turn}");
    }

    /// The gradient of half the squared miss is minus the rows times the errors, however large the miss is.
    #[test]
    fn the_gradient_of_the_miss_is_the_central_difference() {
        let place = |v: [f64; 3], turn: [f64; 3]| {
            Transform::from_parts(Vector3::from(v).into(), Rotation3::new(Vector3::from(turn)))
        };
        let from = place([0.1, 0.2, -0.3], [0.4, -1.1, 0.3]);
        let pose = place([1.0, -0.2, 0.3], [-0.9, 0.6, 1.2]);
        let direction = Vector3::new(0.3, -0.5, 0.4);
        let position = pose.translation.vector;
        let lever = 0.7;
        for goal in [Goal::Position(position), Goal::Axis { position, direction }, Goal::Pose(pose)] {
            let tool = Tool::at(Vector3::zeros())
                .expect("a tool")
                .with_axis(Vector3::new(0.2, 0.1, 1.0))
                .expect("an axis");
            let aim = Aim::new(&goal, &tool, lever).expect("a goal");
            let cost = |from: &Transform| {
                let (miss, mut rows) = (aim.miss(from), vec![0.0; aim.rows()]);
                aim.errors(&miss, &mut rows);
                0.5 * rows.iter().map(|e| e * e).sum::<f64>()
            };
            let miss = aim.miss(&from);
            let (mut errors, mut rows) = (vec![0.0; aim.rows()], nalgebra::DMatrix::zeros(aim.rows(), 6));
            aim.errors(&miss, &mut errors);
            aim.project(&miss, &Matrix6xX::identity(6), &mut rows);
            let gradient = -rows.tr_mul(&nalgebra::DVector::from_vec(errors));
            for part in 0..6 {
                let moved = |by: f64| {
                    let mut to = from;
                    if part < 3 {
                        to.translation.vector[part] += by;
                    } else {
                        to.rotation = Rotation3::new(by * Vector3::ith(part - 3, 1.0)) * to.rotation;
                    }
                    cost(&to)
                };
                let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                assert!(
                    (difference - gradient[part]).abs() < 1e-8,
                    "{goal:?} {part}: {difference} {}",
                    gradient[part]
                );
            }
        }
    }
}
