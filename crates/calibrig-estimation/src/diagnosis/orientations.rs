//! Checks whether orientations turn as the robot turns its flange, inversely, or otherwise.
//!
//! From one pose to the next a target turns by `R' Rᵀ`, as the tracker sees it. With `R = T F M` (T the tracker's, F the flange's rotation in the
//! base, M the target's on the flange) this is `T (F' Fᵀ) Tᵀ`: its axis, times the sine of its angle, is that of the flange rotated by T, whatever M
//! is. For inverted readings `R = (T F M)ᵀ` it is that of `F'ᵀ F` rotated by `Mᵀ`. So a single rotation maps all of them to the robot's, in closed
//! form.

use nalgebra::{Matrix3, Rotation3, Vector3};

use calibrig_model::CalibrationModel;
use calibrig_model::geometry::best_fit_transform;
use calibrig_model::measurement::{MeasurementSet, Reading};
use calibrig_model::visibility::stance_at;

/// Axes within this distance turn as the robot does: no robot's links are off by as much.
const NEAR: f64 = 0.05;

/// How the orientations of a set fit the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orientations {
    /// Number of readings with an orientation.
    pub readings: usize,
    /// RMS difference between the rotations from pose to pose and those of the robot (as sines of angles, rad where small), as they were read.
    pub as_read: f64,
    /// RMS difference if every rotation is inverted.
    pub inverted: f64,
}

/// Conclusion about the orientations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OrientationFinding {
    /// They turn as the robot does.
    AsTheRobot,
    /// They turn inversely.
    Inverted,
    /// They turn in neither way.
    Otherwise,
}

impl Orientations {
    /// The conclusion.
    pub fn finding(&self) -> OrientationFinding {
        if self.as_read < NEAR && self.as_read <= self.inverted {
            OrientationFinding::AsTheRobot
        } else if self.inverted < NEAR {
            OrientationFinding::Inverted
        } else {
            OrientationFinding::Otherwise
        }
    }
}

/// Axis of a rotation times the sine of its angle.
fn axis(turn: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(turn[(2, 1)] - turn[(1, 2)], turn[(0, 2)] - turn[(2, 0)], turn[(1, 0)] - turn[(0, 1)])
}

/// Examines the orientations of a set; `None` where fewer than three readings of a target from a station have one, or all rotations are about one
/// axis.
pub fn orientations(model: &CalibrationModel, set: &MeasurementSet) -> Option<Orientations> {
    let mut joints = vec![0.0; model.kinematics.joint_count()];
    let (mut readings, mut squares, mut terms) = (0, [0.0; 2], 0.0);
    for station in 0..set.stations.len() {
        for target in 0..set.targets.len() {
            let mut seen: Vec<[Rotation3<f64>; 2]> = Vec::new();
            for observation in set.observations.iter().filter(|o| (o.station, o.target) == (station, target))
            {
                if let Reading::Pose(pose) = &observation.reading
                    && observation.command.len() == joints.len()
                {
                    model.actuators.joints_from_command(&observation.command, &mut joints);
                    seen.push([pose.rotation, stance_at(&model.kinematics, &joints).1.rotation]);
                }
            }
            readings += seen.len();
            // A pose's orientation as the tracker sees it, and as the robot has it.
            type Pair = [Rotation3<f64>; 2];
            let turns = |of: fn(&Pair, &Pair) -> Rotation3<f64>| {
                let own = seen.windows(2).map(|pair| axis(of(&pair[0], &pair[1]).matrix()));
                // With their opposites the mean is zero, and the best fit is a pure rotation.
                own.flat_map(|axis| [axis, -axis]).collect::<Vec<_>>()
            };
            let of_tracker = turns(|[before, _], [after, _]| after * before.inverse());
            let of_robot = [
                turns(|[_, before], [_, after]| after * before.inverse()),
                turns(|[_, before], [_, after]| after.inverse() * before),
            ];
            let off = of_robot.map(|of_robot| {
                let fit = best_fit_transform(&of_tracker, &of_robot)?;
                let pairs = of_tracker.iter().zip(&of_robot);
                Some(pairs.map(|(seen, own)| (seen - fit.rotation * own).norm_squared()).sum::<f64>())
            });
            let [Some(as_read), Some(inverted)] = off else { continue };
            squares[0] += as_read;
            squares[1] += inverted;
            terms += of_tracker.len() as f64;
        }
    }
    let [as_read, inverted] = squares.map(|square| (square / terms).sqrt());
    (terms > 0.0 && as_read.is_finite() && inverted.is_finite()).then_some(Orientations {
        readings,
        as_read,
        inverted,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::CraigLink;
    use calibrig_model::measurement::{PoseReading, TargetOrientation};

    fn robot() -> CalibrationModel {
        let link = |name, alpha| CraigLink::revolute(name).row(0.3, alpha, 0.1, 0.0).limits(-3.0, 3.0);
        CalibrationModel::new(vec![link("a", 0.0), link("b", 1.5), link("c", -1.4)]).expect("a robot")
    }

    fn set(read: fn(Rotation3<f64>) -> Rotation3<f64>, mounted: Rotation3<f64>) -> MeasurementSet {
        let model = robot();
        let commands = (0..12).map(|k| {
            let command: Vec<f64> = [0.7, 1.1, 1.9].map(|pace| 2.0 * (pace * f64::from(k)).sin()).into();
            (command, Vector3::new(1.0, 0.0, 0.0))
        });
        let mut set = MeasurementSet::of_points(commands);
        set.targets[0].orientation =
            Some(TargetOrientation { flange_from_target: Rotation3::identity(), covariance: None });
        let tracker = Rotation3::new(Vector3::new(0.3, -1.2, 2.0));
        for observation in &mut set.observations {
            let flange = stance_at(&model.kinematics, &observation.command).1.rotation;
            observation.reading = Reading::Pose(Box::new(PoseReading {
                position: Vector3::x(),
                rotation: read(tracker * flange * mounted),
                covariance: None,
            }));
        }
        set
    }

    #[test]
    fn turns_are_told_from_inverted_ones_and_from_others_whatever_the_mounting() {
        for mounted in [Vector3::zeros(), Vector3::new(1.0, 2.0, -0.5)].map(Rotation3::new) {
            let found = |read| orientations(&robot(), &set(read, mounted)).expect("poses");
            let direct = found(|rotation| rotation);
            assert!(direct.as_read < 1e-12 && direct.inverted > 0.1, "{direct:?}");
            assert_eq!((direct.finding(), direct.readings), (OrientationFinding::AsTheRobot, 12));
            let inverted = found(|rotation| rotation.inverse());
            assert!(inverted.inverted < 1e-12 && inverted.as_read > 0.1, "{inverted:?}");
            assert_eq!(inverted.finding(), OrientationFinding::Inverted);
            // As for angles in another unit: no rotation maps rotations of half the size to the robot's.
            let other = found(|rotation| Rotation3::new(0.5 * rotation.scaled_axis()));
            assert_eq!(other.finding(), OrientationFinding::Otherwise, "{other:?}");
        }
        let points = MeasurementSet::of_points([(vec![0.0; 3], Vector3::x())]);
        assert_eq!(orientations(&robot(), &points), None);
    }
}
