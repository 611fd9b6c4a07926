//! The pictures of a run, in the base frame and independent of any viewer.

use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};

use super::Story;
use super::{DEFLECTION_SCALE, RESIDUAL_SCALE};
use calibrig_estimation::evaluation::ModeOutcome;
use calibrig_estimation::evaluation::closed_loop::{DrivenMode, DrivenPath};
use calibrig_estimation::identification::{CalibratedRobot, Mode, Predictor};
use calibrig_estimation::kinematics::{joints_from_command, link_frames};
use calibrig_model::geometry::{Transform, rotation_vector, rotation_z};
use calibrig_model::measurement::SetOutcome;
use calibrig_model::measurement::{MeasurementSet, Observation, Reading};
use calibrig_model::{CalibrationModel, KinematicModel, LinkTerm, ParameterId};
use calibrig_plant::{AsBuilt, SettledPose};

/// Which robot a chain shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChainKind {
    /// The machine at rest, as simulated.
    True,
    /// The model before calibration.
    Nominal,
    /// The machine at rest with its deflections enlarged [`DEFLECTION_SCALE`] times. A deflection leads from the rigid machine, effects
    /// included, to the machine at rest.
    Deflection,
    /// The last mode's robot, if there is no truth to show.
    Calibrated,
}

impl ChainKind {
    /// The key in frame and entity names.
    pub fn key(self) -> &'static str {
        match self {
            Self::True => "true",
            Self::Nominal => "nominal",
            Self::Deflection => "deflection_x100",
            Self::Calibrated => "calibrated",
        }
    }

    /// Whether it is drawn as a line only, without the links' shapes.
    pub fn is_ghost(self) -> bool {
        matches!(self, Self::Nominal | Self::Deflection)
    }

    /// Label beside it.
    pub(super) fn label(self) -> Option<&'static str> {
        (self == Self::Deflection).then_some("deflection x100")
    }

    pub(super) fn colour(self) -> Colour {
        match self {
            Self::True | Self::Calibrated => STEEL,
            Self::Nominal => GHOST,
            Self::Deflection => DEFLECTED,
        }
    }
}

/// A robot at one pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// Which robot.
    pub kind: ChainKind,
    /// `base_from_link` of every link.
    pub links: Vec<Transform>,
    /// `base_from_flange`.
    pub flange: Transform,
    /// The target in the base frame, m.
    pub target: Vector3<f64>,
    /// Shoulder, crank end, lever end and elbow of its four-bar in the base frame, m.
    pub linkage: Option<[Vector3<f64>; 4]>,
}

impl Chain {
    /// Origins from the base through the links and the flange to the target, m.
    pub fn polyline(&self) -> Vec<Vector3<f64>> {
        let links = self.links.iter().map(|link| link.translation.vector);
        std::iter::once(Vector3::zeros())
            .chain(links)
            .chain([self.flange.translation.vector, self.target])
            .collect()
    }

    /// Name of the frame of link `index` (from 0), as in the parameters' names.
    pub fn frame(&self, index: usize) -> String {
        format!("{}/link{}", self.kind.key(), index + 1)
    }
}

/// The chains to show at one pose: true, nominal and with enlarged deflections; or else the calibrated one.
pub(super) fn chains(story: &Story<'_>, set: usize, index: usize) -> Vec<Chain> {
    let Some(measurements) = story.sets.get(set).map(|s| &s.measurements) else { return Vec::new() };
    let Some(observation) = measurements.observations.get(index) else { return Vec::new() };
    let machine = story.truth.and_then(|truth| {
        let settled = truth.poses.get(set)?.get(index)?;
        let rigid = truth.rigid.get(set).and_then(|set| set.get(index));
        let target = measurements.targets.get(observation.target).map(|target| &target.in_flange);
        machine_chains(&truth.as_built, settled, rigid, story.model, target, observation)
    });
    machine.unwrap_or_else(|| calibrated_chain(story, observation).into_iter().collect())
}

/// The machine at rest; the nominal robot, if its target is known; and the enlarged deflections, if the rigid machine is known.
pub(super) fn machine_chains(
    as_built: &AsBuilt,
    settled: &SettledPose,
    rigid: Option<&SettledPose>,
    model: &CalibrationModel,
    target: Option<&Vector3<f64>>,
    observation: &Observation,
) -> Option<Vec<Chain>> {
    let chain = chain_at_rest(as_built, settled)?;
    let nominal = target.and_then(|target| nominal_chain(model, target, observation));
    let deflection = rigid.and_then(|rigid| deflection_chain(as_built, rigid, &chain));
    Some(std::iter::once(chain).chain(nominal).chain(deflection).collect())
}

fn chain_at_rest(as_built: &AsBuilt, pose: &SettledPose) -> Option<Chain> {
    let flange = pose.links.last()? * as_built.kinematics.last_from_flange;
    Some(Chain {
        kind: ChainKind::True,
        links: pose.links.clone(),
        flange,
        target: pose.target,
        linkage: pose.linkage,
    })
}

fn deflection_chain(as_built: &AsBuilt, rigid: &SettledPose, settled: &Chain) -> Option<Chain> {
    let rigid = chain_at_rest(as_built, rigid)?;
    let links = rigid.links.iter().zip(&settled.links);
    let linkage = rigid.linkage.zip(settled.linkage);
    Some(Chain {
        kind: ChainKind::Deflection,
        links: links.map(|(rigid, settled)| exaggerated(rigid, settled)).collect(),
        flange: exaggerated(&rigid.flange, &settled.flange),
        target: farther(&rigid.target, &settled.target),
        linkage: linkage.map(|(rigid, settled)| std::array::from_fn(|i| farther(&rigid[i], &settled[i]))),
    })
}

/// [`DEFLECTION_SCALE`] times as far from `from` as `to` is.
fn farther(from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    from + DEFLECTION_SCALE * (to - from)
}

/// The same of a frame: its origin, and its turn about the same axis.
fn exaggerated(from: &Transform, to: &Transform) -> Transform {
    let turn = rotation_vector(&(from.rotation.inverse() * to.rotation));
    Transform::from_parts(
        farther(&from.translation.vector, &to.translation.vector).into(),
        from.rotation * Rotation3::new(DEFLECTION_SCALE * turn),
    )
}

/// The robot before calibration, with the target at its stated place in the flange frame.
pub(super) fn nominal_chain(
    model: &CalibrationModel,
    target: &Vector3<f64>,
    observation: &Observation,
) -> Option<Chain> {
    if observation.command.len() != model.kinematics.joint_count() {
        return None;
    }
    let mut joints = vec![0.0; observation.command.len()];
    joints_from_command(&model.kinematics, &model.actuators, &observation.command, &mut joints).ok()?;
    let links = link_frames(&model.kinematics, &joints).ok()?;
    chain_of(ChainKind::Nominal, model, &observation.command, links, target)
}

/// Places of the nominal robot's last link, m: with every joint in mid-travel, and with each prismatic joint at either end.
#[cfg(feature = "rerun")]
pub(super) fn reach(model: &KinematicModel) -> Vec<Vector3<f64>> {
    let middle: Vec<_> =
        model.links.iter().map(|link| f64::midpoint(link.limits[0], link.limits[1])).collect();
    let slides =
        model.links.iter().enumerate().filter(|(_, link)| link.kind == calibrig_model::JointKind::Prismatic);
    let ends = slides.flat_map(|(joint, link)| link.limits.map(|limit| (joint, limit)));
    let away = ends.map(|(joint, limit)| {
        let mut joints = middle.clone();
        joints[joint] = limit;
        joints
    });
    let frames =
        std::iter::once(middle.clone()).chain(away).filter_map(|joints| link_frames(model, &joints).ok());
    let places = frames.filter_map(|links| Some(links.last()?.translation.vector));
    places.filter(|place| place.iter().all(|x| x.is_finite())).collect()
}

/// The last mode's robot.
pub(super) fn calibrated_chain(story: &Story<'_>, observation: &Observation) -> Option<Chain> {
    let robot = observer(story)?;
    let target = robot.targets.get(observation.target)?;
    let links = Predictor::new(robot).ok()?.links(observation).ok()?;
    chain_of(ChainKind::Calibrated, &robot.model, &observation.command, links, target)
}

fn chain_of(
    kind: ChainKind,
    model: &CalibrationModel,
    command: &[f64],
    links: Vec<Transform>,
    target: &Vector3<f64>,
) -> Option<Chain> {
    let flange = links.last()? * model.kinematics.last_from_flange;
    let target = flange.rotation * target + flange.translation.vector;
    let linkage = linkage(model, command, &links);
    Some(Chain { kind, links, flange, target, linkage })
}

/// The four-bar between links whose places are known. Its crank is taken as rigid, which no picture shows.
fn linkage(model: &CalibrationModel, command: &[f64], links: &[Transform]) -> Option<[Vector3<f64>; 4]> {
    let (shoulder, elbow, offset, four_bar) = model.actuators.four_bar()?;
    let base = model.kinematics.base_from_first;
    let waist = shoulder.checked_sub(1).map_or(Some(base), |i| links.get(i).copied())?;
    let mut positions = vec![0.0; links.len()];
    model.actuators.actuators_from_command(command, &mut positions);
    let rows = &model.kinematics.links;
    let crank = waist
        * rows.get(shoulder)?.fixed_part()
        * four_bar.axis.shoulder_from_axis()
        * rotation_z(positions.get(elbow)? + offset + rows.get(elbow)?.theta);
    let lever = links.get(elbow)?;
    Some([
        crank.translation.vector,
        (crank * Point3::from(four_bar.crank.end())).coords,
        (lever * Point3::from(four_bar.lever.end())).coords,
        lever.translation.vector,
    ])
}

/// The robot whose stations place the measurements in the base frame: the last mode's.
pub(super) fn observer<'a>(story: &Story<'a>) -> Option<&'a CalibratedRobot> {
    story.modes.last().map(|mode| &mode.robot)
}

/// A reading in the base frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Where the tracker stands.
    pub tracker: Vector3<f64>,
    /// Where it saw the target.
    pub point: Vector3<f64>,
    /// How it saw the target turned, `base_from_target`, of a reading that is a full pose.
    pub turned: Option<Rotation3<f64>>,
}

impl Sighting {
    /// The target's axes where they were seen: x red, y green, z blue.
    pub(super) fn axes(&self) -> impl Iterator<Item = (Arrow, Colour)> {
        let arrow = |turned: Rotation3<f64>| {
            let along = move |axis: usize| AXIS_LENGTH * turned.matrix().column(axis).into_owned();
            let point = self.point;
            (0..3).zip(AXES).map(move |(axis, colour)| (Arrow { origin: point, vector: along(axis) }, colour))
        };
        self.turned.map(arrow).into_iter().flatten()
    }
}

/// Length of a target's axes as drawn, m.
const AXIS_LENGTH: f64 = 0.15;

/// Where `robot` holds the observation's tracker and target to be.
pub(super) fn sighting(robot: &CalibratedRobot, observation: &Observation) -> Option<Sighting> {
    Some(sighting_from(robot.stations.get(observation.station)?, observation))
}

/// The same from a tracker whose place is known.
pub(super) fn sighting_from(tracker_from_base: &Transform, observation: &Observation) -> Sighting {
    let base_from_tracker = tracker_from_base.inverse();
    let tracker = base_from_tracker.translation.vector;
    let turned = match &observation.reading {
        Reading::Pose(pose) => Some(base_from_tracker.rotation * pose.rotation),
        Reading::Spherical(_) | Reading::Cartesian { .. } => None,
    };
    Sighting { tracker, point: base_from_tracker.rotation * observation.reading.position() + tracker, turned }
}

/// All points of a set in the base frame, m.
pub(super) fn measured_points(story: &Story<'_>, measurements: &MeasurementSet) -> Vec<Vector3<f64>> {
    let Some(robot) = observer(story) else { return Vec::new() };
    measurements.observations.iter().filter_map(|o| sighting(robot, o)).map(|s| s.point).collect()
}

/// `base_from_tracker` of every station.
pub(super) fn trackers(story: &Story<'_>) -> Vec<Transform> {
    observer(story).map(|r| r.stations.iter().map(Transform::inverse).collect()).unwrap_or_default()
}

/// The certified base nests of all stations, each once, m.
pub(super) fn nests(sets: &[SetOutcome]) -> Vec<(String, Vector3<f64>)> {
    let mut nests: Vec<(String, Vector3<f64>)> = Vec::new();
    let stations = sets.iter().flat_map(|set| &set.measurements.stations);
    for nest in stations.flat_map(|station| &station.nests) {
        if !nests.iter().any(|(name, _)| *name == nest.name) {
            nests.push((nest.name.clone(), nest.in_base));
        }
    }
    nests
}

/// A residual from the predicted towards the measured point, [`RESIDUAL_SCALE`] times as long as it is, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arrow {
    pub origin: Vector3<f64>,
    pub vector: Vector3<f64>,
}

/// The arrow of one observation in one mode.
pub(super) fn arrow(mode: &ModeOutcome, observation: &Observation, error: &Vector3<f64>) -> Option<Arrow> {
    let measured = sighting(&mode.robot, observation)?.point;
    Some(Arrow { origin: measured - error, vector: RESIDUAL_SCALE * error })
}

/// The base axis that points up, against gravity; z if gravity is not known.
pub(super) fn up(story: &Story<'_>) -> Vector3<f64> {
    up_of(story.model, story.truth.map(|truth| &truth.as_built))
}

/// The same, before there is a story.
pub(super) fn up_of(model: &CalibrationModel, as_built: Option<&AsBuilt>) -> Vector3<f64> {
    let as_built = as_built.map(|machine| machine.statics.gravity);
    let gravity = model.statics.as_ref().map(|statics| statics.gravity).or(as_built);
    let Some(gravity) = gravity.filter(|g| g.norm() > 0.0) else { return Vector3::z() };
    let axis = gravity.iamax();
    let mut up = Vector3::zeros();
    up[axis] = -gravity[axis].signum();
    up
}

/// The rotation into a world whose z points up, for viewers that always take z for up.
pub(super) fn world_from_base(story: &Story<'_>) -> UnitQuaternion<f64> {
    turn(&Vector3::z(), &up(story))
}

/// The shortest rotation that takes `from` to `to`.
pub(super) fn turn(to: &Vector3<f64>, from: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(from, to)
        // Opposite vectors: half a turn about any axis across them.
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&across(from), std::f64::consts::PI))
}

/// A direction at right angles to `v`.
pub(super) fn across(v: &Vector3<f64>) -> nalgebra::Unit<Vector3<f64>> {
    let mut least = Vector3::zeros();
    least[v.iamin()] = 1.0;
    nalgebra::Unit::new_normalize(v.cross(&least))
}

/// True minus nominal value of every link parameter that differs.
pub(super) fn deviations(nominal: &KinematicModel, as_built: &KinematicModel) -> Vec<(ParameterId, f64)> {
    let links = nominal.links.iter().zip(&as_built.links).enumerate();
    links
        .flat_map(|(link, (nominal, real))| {
            LinkTerm::ALL.map(|term| (ParameterId::link(link, term), real.term(term) - nominal.term(term)))
        })
        .filter(|(_, deviation)| *deviation != 0.0)
        .collect()
}

/// Red, green, blue, opacity.
pub(super) type Colour = [u8; 4];

/// The planned points of a driven path; `None` if none was driven.
pub(super) fn planned_path(path: &DrivenPath) -> Option<Vec<Vector3<f64>>> {
    Some(path.modes.first()?.points.iter().map(|point| point.goal).collect())
}

/// The measured path, with errors enlarged [`RESIDUAL_SCALE`] times.
pub(super) fn driven_path(mode: &DrivenMode) -> Vec<Vector3<f64>> {
    mode.points.iter().map(|point| point.goal + RESIDUAL_SCALE * point.error()).collect()
}

/// Colours that can be told apart on a dark background with any colour vision (after Okabe and Ito, 2008).
pub(super) fn mode_colour(mode: Mode) -> Colour {
    const PALETTE: [Colour; 5] = [
        [204, 121, 167, 255],
        [230, 159, 0, 255],
        [0, 158, 115, 255],
        [86, 180, 233, 255],
        [240, 228, 66, 255],
    ];
    let place = Mode::ALL.iter().position(|m| *m == mode).unwrap_or(0);
    PALETTE[place % PALETTE.len()]
}

pub(super) const STEEL: Colour = [205, 218, 235, 255];
/// Translucent, so that the chains inside the links' shapes can be seen.
pub(super) const SHELL: Colour = [150, 165, 185, 110];
pub(super) const GHOST: Colour = [150, 150, 160, 255];
/// Half the thickness of a four-bar's crank, rod and lever, m.
pub(super) const ROD_RADIUS: f64 = 0.03;
/// Unlike any mode's.
pub(super) const DEFLECTED: Colour = [255, 90, 255, 255];
pub(super) const BEAM: Colour = [255, 64, 64, 255];
pub(super) const TRACKER: Colour = [255, 140, 60, 255];
/// x, y and z of a target's axes.
pub(super) const AXES: [Colour; 3] = [[230, 60, 60, 255], [60, 190, 90, 255], [80, 120, 255, 255]];
pub(super) const POINT: Colour = [235, 235, 235, 255];
/// Of correlations.
#[cfg(feature = "rerun")]
pub(super) const POSITIVE: Colour = [230, 159, 0, 255];
#[cfg(feature = "rerun")]
pub(super) const NEGATIVE: Colour = [86, 180, 233, 255];
pub(super) const NEST: Colour = [86, 180, 233, 255];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{self, Outcome};
    use calibrig_files::load_robot;
    use calibrig_model::measurement::PoseReading;
    use calibrig_plant::effects::Effects;
    use calibrig_plant::{Plant, SettleOptions};

    #[test]
    fn the_chain_ends_at_the_settled_or_predicted_target() {
        let simulated = synthetic::outcome(4, 3, true);
        let chains_of = |outcome: &Outcome, index| chains(&outcome.story(), 0, index);
        for index in 0..4 {
            let shown = chains_of(&simulated, index);
            assert_eq!(
                shown.iter().map(|c| c.kind).collect::<Vec<_>>(),
                [ChainKind::True, ChainKind::Nominal, ChainKind::Deflection]
            );
            let settled = &simulated.truth.as_ref().expect("simulated").poses[0][index];
            let end = *shown[0].polyline().last().expect("a line");
            assert!((end - settled.target).norm() < 1e-12);
        }
        let measured = Outcome { truth: None, ..simulated.clone() };
        let shown = chains_of(&measured, 1);
        assert_eq!(shown.iter().map(|c| c.kind).collect::<Vec<_>>(), [ChainKind::Calibrated]);
        let observation = &measured.sets[0].measurements.observations[1];
        let robot = observer(&measured.story()).expect("a mode");
        let predicted = Predictor::new(robot).expect("a robot").in_base(observation).expect("a pose");
        assert!((shown[0].target - predicted).norm() < 1e-12);
    }

    #[test]
    fn a_deflection_divided_by_its_scale_leads_to_the_settled_machine() {
        let outcome = synthetic::outcome(4, 1, true);
        let known = outcome.truth.as_ref().expect("simulated");
        for index in 0..4 {
            let [settled, rigid] = [&known.poses[0][index], &known.rigid[0][index]];
            let shown = chains(&outcome.story(), 0, index);
            let [truth, deflection] = [&shown[0], &shown[2]];
            let shrunk =
                |rigid: &Vector3<f64>, shown: &Vector3<f64>| rigid + (shown - rigid) / DEFLECTION_SCALE;
            assert!((shrunk(&rigid.target, &deflection.target) - settled.target).norm() < 1e-12);
            assert!((rigid.target - settled.target).norm() > 1e-5, "it yields");
            for ((shown, rigid), settled) in deflection.links.iter().zip(&rigid.links).zip(&settled.links) {
                let (from, to) = (rigid.translation.vector, settled.translation.vector);
                assert!((shrunk(&from, &shown.translation.vector) - to).norm() < 1e-12);
                let turned = rigid.rotation.rotation_to(&shown.rotation).angle();
                let really = rotation_vector(&rigid.rotation.rotation_to(&settled.rotation)).norm();
                // The arc cosine behind `angle` keeps half the digits near zero.
                assert!((turned - DEFLECTION_SCALE * really).abs() < 1e-7, "{turned} {really}");
            }
            let pins = [truth, deflection].map(|chain| chain.linkage.expect("a four-bar"));
            assert!((shrunk(&rigid.linkage.expect("one")[1], &pins[1][1]) - pins[0][1]).norm() < 1e-12);
        }
    }

    #[test]
    fn the_nominal_four_bar_is_closed_where_the_rigid_plant_closes_it() {
        let file =
            std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/spray_painter/robot.toml");
        let robot = load_robot(&file).expect("a robot");
        let model = robot.model;
        let mut statics = model.statics.clone().expect("statics");
        statics.make_rigid();
        let machine = AsBuilt {
            kinematics: model.kinematics.clone(),
            actuators: model.actuators.clone(),
            statics,
            target: Vector3::zeros(),
            effects: Effects::default(),
        };
        let mut plant = Plant::new(&machine, SettleOptions::default()).expect("a plant");
        for joints in [[2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77], [0.5, 0.0, -1.5, 0.2, 1.8, 0.4, -0.5]] {
            let command = model.actuators.command_from_joints(&joints);
            let settled = plant.settle(&command).expect("at rest");
            let pins = linkage(&model, &command, &settled.links).expect("a four-bar");
            for (pin, real) in pins.iter().zip(&settled.linkage.expect("a four-bar")) {
                assert!((pin - real).norm() < 1e-8, "{pin} {real}");
            }
        }
    }

    #[test]
    fn an_arrow_divided_by_its_scale_leads_from_prediction_to_measurement() {
        let outcome = synthetic::outcome(5, 2, false);
        for mode in &outcome.modes {
            for (observation, error) in outcome.sets[0].measurements.observations.iter().zip(&mode.errors[0])
            {
                let arrow = arrow(mode, observation, error).expect("a station");
                let predicted =
                    Predictor::new(&mode.robot).expect("a robot").in_base(observation).expect("a pose");
                assert!((arrow.origin - predicted).norm() < 1e-9);
                let measured = sighting(&mode.robot, observation).expect("a station").point;
                assert!((arrow.origin + arrow.vector / RESIDUAL_SCALE - measured).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn up_is_against_gravity_and_becomes_the_worlds_z() {
        let mut outcome = synthetic::outcome(2, 1, true);
        assert_eq!(up(&outcome.story()), Vector3::y());
        assert!((world_from_base(&outcome.story()) * Vector3::y() - Vector3::z()).norm() < 1e-15);
        if let Some(statics) = &mut outcome.model.statics {
            statics.gravity = Vector3::new(0.0, 0.0, 9.81);
        }
        assert_eq!(up(&outcome.story()), -Vector3::z());
        assert!((world_from_base(&outcome.story()) * -Vector3::z() - Vector3::z()).norm() < 1e-15);
    }

    #[test]
    fn the_axes_of_a_full_pose_are_those_of_the_target_in_the_base() {
        let outcome = synthetic::outcome(2, 1, false);
        let mut observation = outcome.sets[0].measurements.observations[0].clone();
        let robot = &outcome.modes[0].robot;
        assert_eq!(sighting(robot, &observation).expect("a station").axes().count(), 0);
        let base_from_target = Rotation3::new(Vector3::new(0.3, -0.8, 1.1));
        observation.reading = Reading::Pose(Box::new(PoseReading {
            position: observation.reading.position(),
            rotation: robot.stations[0].rotation * base_from_target,
            covariance: None,
        }));
        let seen = sighting(robot, &observation).expect("a station");
        let axes: Vec<_> = seen.axes().collect();
        let directions = [Vector3::x(), Vector3::y(), Vector3::z()];
        assert_eq!(axes.len(), 3);
        for ((arrow, colour), (direction, own)) in axes.iter().zip(directions.iter().zip(AXES)) {
            assert!((arrow.vector - AXIS_LENGTH * (base_from_target * direction)).norm() < 1e-14);
            assert_eq!((arrow.origin, *colour), (seen.point, own));
        }
    }

    #[test]
    fn a_malformed_observation_is_not_drawn_and_does_no_harm() {
        let mut outcome = synthetic::outcome(2, 1, false);
        let observation = &mut outcome.sets[0].measurements.observations[0];
        observation.command.truncate(1);
        assert!(chains(&outcome.story(), 0, 0).is_empty());
        assert!(chains(&outcome.story(), 5, 0).is_empty());
        outcome.sets[0].measurements.observations[0].station = 4;
        assert_eq!(measured_points(&outcome.story(), &outcome.sets[0].measurements).len(), 1);
    }
}
