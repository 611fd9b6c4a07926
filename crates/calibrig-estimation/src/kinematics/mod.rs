//! Forward kinematics and the analytic identification Jacobian of any open chain of revolute and prismatic joints, and the closed four-bar
//! that may drive its elbow.

mod four_bar;

pub use four_bar::{
    Closure, ClosureError, ElbowClosure, ElbowLinkage, command_from_joints, joints_from_command, swing_to,
};
pub(crate) use four_bar::{is_parallelogram, nominal_joints};

use nalgebra::{DMatrix, Matrix3, Matrix3xX, Rotation3, Vector3};

use calibrig_model::geometry::Transform;
use calibrig_model::{CraigLink, JointKind, KinematicModel, LinkTerm, ModelError, ParameterId};

/// What the joint variables are called in errors.
const JOINTS: &str = "joint variables";

/// `base_from_flange` at the joint variables `q` (rad or m, one a joint).
///
/// # Errors
///
/// [`ModelError`], where the chain cannot be one, or `q` is not one finite number a joint.
pub fn forward_kinematics(model: &KinematicModel, q: &[f64]) -> Result<Transform, ModelError> {
    model.check()?;
    model.check_joints(JOINTS, q)?;
    Ok(flange(model, q))
}

/// [`forward_kinematics`] of a pose of the robot.
pub(crate) fn flange(model: &KinematicModel, q: &[f64]) -> Transform {
    let mut base_from_link = model.base_from_first;
    for (link, &q) in model.links.iter().zip(q) {
        base_from_link *= link.transform(q);
    }
    base_from_link * model.last_from_flange
}

/// `base_from_link` of every link at the joint variables `q`.
///
/// # Errors
///
/// As [`forward_kinematics`].
pub fn link_frames(model: &KinematicModel, q: &[f64]) -> Result<Vec<Transform>, ModelError> {
    model.check()?;
    model.check_joints(JOINTS, q)?;
    Ok(frames(model, q))
}

/// [`link_frames`] of a pose of the robot.
pub(crate) fn frames(model: &KinematicModel, q: &[f64]) -> Vec<Transform> {
    let mut base_from_link = model.base_from_first;
    model
        .links
        .iter()
        .zip(q)
        .map(|(link, &q)| {
            base_from_link *= link.transform(q);
            base_from_link
        })
        .collect()
}

/// Position in the base frame of a target at `in_flange`, m.
///
/// # Errors
///
/// As [`forward_kinematics`], and for a target at no finite place.
pub fn target_in_base(
    model: &KinematicModel,
    q: &[f64],
    in_flange: &Vector3<f64>,
) -> Result<Vector3<f64>, ModelError> {
    model.check()?;
    model.check_joints(JOINTS, q)?;
    check_target(in_flange)?;
    Ok(target(model, q, in_flange))
}

/// Whether a target is at a finite place of the flange.
fn check_target(in_flange: &Vector3<f64>) -> Result<(), ModelError> {
    match in_flange.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(ModelError::Number {
            field: "the target's offset",
            joint: None,
            value,
            expected: "a finite number",
        }),
        None => Ok(()),
    }
}

/// [`target_in_base`] at a pose of the robot.
pub(crate) fn target(model: &KinematicModel, q: &[f64], in_flange: &Vector3<f64>) -> Vector3<f64> {
    let base_from_flange = flange(model, q);
    base_from_flange.rotation * in_flange + base_from_flange.translation.vector
}

/// What one link does to a point that it carries, per unit of each of its parameters: an axis in the base frame and, for angles,
/// the point on it.
#[derive(Debug, Clone, Copy)]
struct LinkMotions {
    /// x before the joint: a moves along it, alpha turns about it.
    x: Vector3<f64>,
    /// Origin of the previous link.
    previous_origin: Vector3<f64>,
    /// y behind alpha and a: beta turns about it.
    y: Vector3<f64>,
    /// z behind beta: d moves along it, theta turns about it.
    z: Vector3<f64>,
    /// Origin behind a: on the axes of beta and theta.
    origin: Vector3<f64>,
}

/// The part of a link's transform that is the same in every pose.
#[derive(Debug, Clone, Copy)]
struct LinkConstants {
    kind: JointKind,
    a: f64,
    d: f64,
    theta: f64,
    sin_cos_alpha: (f64, f64),
    sin_cos_beta: (f64, f64),
    sin_cos_theta: (f64, f64),
}

impl LinkConstants {
    fn new(link: &CraigLink) -> Self {
        Self {
            kind: link.kind,
            a: link.a,
            d: link.d,
            theta: link.theta,
            sin_cos_alpha: link.alpha.sin_cos(),
            sin_cos_beta: link.beta.sin_cos(),
            sin_cos_theta: link.theta.sin_cos(),
        }
    }
}

/// A frame that goes along the chain: axes and origin in the base frame.
struct Walk {
    x: Vector3<f64>,
    y: Vector3<f64>,
    z: Vector3<f64>,
    origin: Vector3<f64>,
}

impl Walk {
    fn from(frame: &Transform) -> Self {
        let axis = |j: usize| frame.rotation.matrix().column(j).into_owned();
        Self { x: axis(0), y: axis(1), z: axis(2), origin: frame.translation.vector }
    }

    /// Goes through a link with this angle about z and this way along it, and tells what its parameters do.
    fn pass(&mut self, link: &LinkConstants, sin_cos_theta: (f64, f64), d: f64) -> LinkMotions {
        let Self { mut x, mut y, mut z, mut origin } = *self;
        let (before, previous_origin) = (x, origin);
        // Rx(alpha), Tx(a): y and z turn about x.
        let (sin, cos) = link.sin_cos_alpha;
        (y, z) = (cos * y + sin * z, cos * z - sin * y);
        origin += link.a * x;
        // Ry(beta): z and x turn about y.
        let (sin, cos) = link.sin_cos_beta;
        (z, x) = (cos * z + sin * x, cos * x - sin * z);
        let motions = LinkMotions { x: before, previous_origin, y, z, origin };
        // Rz(theta), Tz(d): x and y turn about z.
        let (sin, cos) = sin_cos_theta;
        (x, y) = (cos * x + sin * y, cos * y - sin * x);
        origin += d * z;
        *self = Self { x, y, z, origin };
        motions
    }

    fn go(&mut self, motion: &Transform) {
        let turned = |v: Vector3<f64>| self.x * v.x + self.y * v.y + self.z * v.z;
        let columns = motion.rotation.matrix();
        let column = |j: usize| turned(columns.column(j).into_owned());
        *self = Self {
            x: column(0),
            y: column(1),
            z: column(2),
            origin: self.origin + turned(motion.translation.vector),
        };
    }

    fn transform(&self) -> Transform {
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[self.x, self.y, self.z]));
        Transform::from_parts(self.origin.into(), rotation)
    }
}

/// The places and axes of a chain at one pose, from which every column of the Jacobian follows without another product.
///
/// It is made once, given a [model](Self::set_model) and [placed](Self::place) at every pose, so that nothing is allocated in the loop
/// over poses.
#[derive(Debug, Clone)]
pub(crate) struct PlacedChain {
    links: Vec<LinkConstants>,
    motions: Vec<LinkMotions>,
    base_from_first: Transform,
    last_from_flange: Transform,
    base_from_flange: Transform,
}

impl PlacedChain {
    /// The chain of `model`, not yet at a pose.
    pub fn new(model: &KinematicModel) -> Self {
        let mut chain = Self {
            links: Vec::with_capacity(model.joint_count()),
            motions: Vec::with_capacity(model.joint_count()),
            base_from_first: Transform::identity(),
            last_from_flange: Transform::identity(),
            base_from_flange: Transform::identity(),
        };
        chain.set_model(model);
        chain
    }

    /// Takes the parameters of a model with as many joints.
    pub fn set_model(&mut self, model: &KinematicModel) {
        self.links.clear();
        self.links.extend(model.links.iter().map(LinkConstants::new));
        self.base_from_first = model.base_from_first;
        self.last_from_flange = model.last_from_flange;
    }

    /// Puts the chain at the joint variables `q`.
    pub fn place(&mut self, q: &[f64]) {
        self.motions.clear();
        let mut walk = Walk::from(&self.base_from_first);
        for (link, &q) in self.links.iter().zip(q) {
            let (sin_cos_theta, d) = match link.kind {
                JointKind::Revolute => ((link.theta + q).sin_cos(), link.d),
                JointKind::Prismatic => (link.sin_cos_theta, link.d + q),
            };
            self.motions.push(walk.pass(link, sin_cos_theta, d));
        }
        self.base_from_flange = walk.transform() * self.last_from_flange;
    }

    /// Puts the chain at given motions behind the [fixed parts](CraigLink::fixed_part) of the links, one a link: that of the joint, and of
    /// all that yields there.
    pub fn place_at(&mut self, motions: &[Transform]) {
        self.motions.clear();
        let mut walk = Walk::from(&self.base_from_first);
        for (link, motion) in self.links.iter().zip(motions) {
            self.motions.push(walk.pass(link, link.sin_cos_theta, link.d));
            walk.go(motion);
        }
        self.base_from_flange = walk.transform() * self.last_from_flange;
    }

    /// `base_from_flange`.
    pub fn base_from_flange(&self) -> &Transform {
        &self.base_from_flange
    }

    /// Position in the base frame of a target at `in_flange`, m.
    pub fn target(&self, in_flange: &Vector3<f64>) -> Vector3<f64> {
        self.base_from_flange.rotation * in_flange + self.base_from_flange.translation.vector
    }

    /// Change of the target's position in the base frame per unit of a link parameter, where `target` is [`Self::target`].
    pub fn link_column(&self, link: usize, term: LinkTerm, target: &Vector3<f64>) -> Vector3<f64> {
        let m = &self.motions[link];
        match term {
            LinkTerm::A => m.x,
            LinkTerm::Alpha => m.x.cross(&(target - m.previous_origin)),
            LinkTerm::Beta => m.y.cross(&(target - m.origin)),
            LinkTerm::D => m.z,
            LinkTerm::Theta => m.z.cross(&(target - m.origin)),
        }
    }

    /// Change of the target's position as the tracker sees it, in base axes, per unit of any parameter.
    ///
    /// Frame parameters displace the base: `tracker_from_base · exp(xi)`.
    pub fn column(&self, id: ParameterId, target: &Vector3<f64>) -> Vector3<f64> {
        match id {
            ParameterId::Link { link, term } => self.link_column(link, term, target),
            ParameterId::Frame { component, .. } => {
                let mut axis = Vector3::zeros();
                axis[component % 3] = 1.0;
                if component < 3 { axis } else { axis.cross(target) }
            }
            ParameterId::Target { axis, .. } => {
                self.base_from_flange.rotation.matrix().column(axis).into_owned()
            }
            ParameterId::Orientation { .. }
            | ParameterId::Compliance(_)
            | ParameterId::Mass { .. }
            | ParameterId::Centre { .. }
            | ParameterId::Linkage(_)
            | ParameterId::Term(_)
            | ParameterId::Instrument { .. }
            | ParameterId::Drift { .. } => Vector3::zeros(),
        }
    }

    /// How the flange turns per unit of any parameter: a rotation vector in base axes, rad per unit. Frame parameters turn the base as the
    /// tracker sees it; those of how a target is turned on the flange are the caller's.
    pub fn turn(&self, id: ParameterId) -> Vector3<f64> {
        match id {
            ParameterId::Link { link, term } => {
                let m = &self.motions[link];
                match term {
                    LinkTerm::A | LinkTerm::D => Vector3::zeros(),
                    LinkTerm::Alpha => m.x,
                    LinkTerm::Beta => m.y,
                    LinkTerm::Theta => m.z,
                }
            }
            ParameterId::Frame { component, .. } if component >= 3 => Vector3::ith(component % 3, 1.0),
            _ => Vector3::zeros(),
        }
    }
}

/// The 3 x n Jacobian of the target's position in the base frame (m) with respect to `parameters` (m or rad), at `q`. Columns of parameters
/// that the rigid chain does not have, such as compliances, are zero.
///
/// # Errors
///
/// [`ModelError`], where `q` is not one finite number a joint, or a parameter is of a link that the robot does not have.
pub fn identification_jacobian(
    model: &KinematicModel,
    q: &[f64],
    in_flange: &Vector3<f64>,
    parameters: &[ParameterId],
) -> Result<Matrix3xX<f64>, ModelError> {
    let stacked = stacked_jacobian(model, &[q], in_flange, parameters)?;
    Ok(Matrix3xX::from_iterator(stacked.ncols(), stacked.iter().copied()))
}

/// The Jacobians of many poses, stacked: 3 poses x n.
///
/// # Errors
///
/// As [`identification_jacobian`].
pub fn stacked_jacobian(
    model: &KinematicModel,
    poses: &[impl AsRef<[f64]>],
    in_flange: &Vector3<f64>,
    parameters: &[ParameterId],
) -> Result<DMatrix<f64>, ModelError> {
    model.check()?;
    poses.iter().try_for_each(|q| model.check_joints(JOINTS, q.as_ref()))?;
    check_target(in_flange)?;
    let is_foreign = |id: &&ParameterId| match id {
        ParameterId::Link { link, .. } => *link >= model.joint_count(),
        ParameterId::Frame { component, .. } => *component >= 6,
        ParameterId::Target { axis, .. } | ParameterId::Orientation { axis, .. } => *axis >= 3,
        _ => false,
    };
    if let Some(id) = parameters.iter().find(is_foreign) {
        return Err(ModelError::Parameter { id: *id });
    }
    Ok(stack(model, poses, in_flange, parameters))
}

/// [`stacked_jacobian`] at poses and for parameters of the robot.
pub(crate) fn stack(
    model: &KinematicModel,
    poses: &[impl AsRef<[f64]>],
    in_flange: &Vector3<f64>,
    parameters: &[ParameterId],
) -> DMatrix<f64> {
    let mut chain = PlacedChain::new(model);
    let mut jacobian = DMatrix::zeros(3 * poses.len(), parameters.len());
    for (row, q) in poses.iter().enumerate() {
        chain.place(q.as_ref());
        let target = chain.target(in_flange);
        for (column, id) in parameters.iter().enumerate() {
            jacobian.fixed_view_mut::<3, 1>(3 * row, column).copy_from(&chain.column(*id, &target));
        }
    }
    jacobian
}

/// The Jacobians of full poses, stacked: of each pose three rows of the target's position and three of its rotation (rotation vector in base
/// axes, rad) times `lever` (m), so that both count alike. The target's axes are those of the flange turned by `flange_from_target`.
pub(crate) fn stack_poses(
    model: &KinematicModel,
    poses: &[impl AsRef<[f64]>],
    in_flange: &Vector3<f64>,
    flange_from_target: &Rotation3<f64>,
    lever: f64,
    parameters: &[ParameterId],
) -> DMatrix<f64> {
    let mut chain = PlacedChain::new(model);
    let mut jacobian = DMatrix::zeros(6 * poses.len(), parameters.len());
    for (row, q) in poses.iter().enumerate() {
        chain.place(q.as_ref());
        let target = chain.target(in_flange);
        let axes = chain.base_from_flange().rotation * flange_from_target;
        for (column, id) in parameters.iter().enumerate() {
            let turn = match *id {
                ParameterId::Orientation { axis, .. } => axes.matrix().column(axis).into_owned(),
                id => chain.turn(id),
            };
            jacobian.fixed_view_mut::<3, 1>(6 * row, column).copy_from(&chain.column(*id, &target));
            jacobian.fixed_view_mut::<3, 1>(6 * row + 3, column).copy_from(&(lever * turn));
        }
    }
    jacobian
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn link() -> impl Strategy<Value = CraigLink> {
        let angle = || -3.0..3.0_f64;
        let length = || -1.5..1.5_f64;
        (any::<bool>(), length(), angle(), -0.5..0.5_f64, length(), angle()).prop_map(
            |(revolute, a, alpha, beta, d, theta)| CraigLink {
                name: String::new(),
                kind: if revolute { JointKind::Revolute } else { JointKind::Prismatic },
                a,
                alpha,
                beta,
                d,
                theta,
                limits: [-3.0, 3.0],
            },
        )
    }

    fn robot_and_pose() -> impl Strategy<Value = (KinematicModel, Vec<f64>, Vector3<f64>)> {
        let tip = (-1.0..1.0_f64, -3.0..3.0_f64).prop_map(|(a, alpha)| {
            calibrig_model::geometry::translation(a, 0.0, 0.0) * calibrig_model::geometry::rotation_x(alpha)
        });
        let target = prop::array::uniform3(-0.5..0.5_f64).prop_map(Vector3::from);
        (prop::collection::vec((link(), -3.0..3.0_f64), 1..9), tip, target).prop_map(
            |(joints, last_from_flange, target)| {
                let (links, q) = joints.into_iter().unzip();
                let base_from_first = last_from_flange.inverse() * calibrig_model::geometry::rotation_y(0.7);
                (KinematicModel { links, base_from_first, last_from_flange }, q, target)
            },
        )
    }

    /// Position seen by a tracker whose frame is the nominal base frame, with `id` changed by `delta`.
    fn moved(
        model: &KinematicModel,
        q: &[f64],
        target: &Vector3<f64>,
        id: ParameterId,
        delta: f64,
    ) -> Vector3<f64> {
        let mut model = model.clone();
        let mut target = *target;
        let mut frame = nalgebra::Vector6::zeros();
        match id {
            ParameterId::Link { .. } => model.add(id, delta),
            ParameterId::Frame { component, .. } => frame[component] = delta,
            ParameterId::Target { axis, .. } => target[axis] += delta,
            _ => {}
        }
        let displaced = calibrig_model::geometry::small_displacement(&frame);
        let point = super::target(&model, q, &target);
        displaced.rotation * point + displaced.translation.vector
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

        #[test]
        fn the_jacobian_is_the_central_difference((model, q, target) in robot_and_pose()) {
            let mut ids = ParameterId::all_of_links(model.joint_count());
            ids.extend(ParameterId::all_of_frame(0));
            ids.extend(ParameterId::all_of_target(0));
            let jacobian = identification_jacobian(&model, &q, &target, &ids).expect("its own");
            let step = 1e-5;
            for (column, id) in ids.iter().enumerate() {
                let difference =
                    (moved(&model, &q, &target, *id, step) - moved(&model, &q, &target, *id, -step)) / (2.0 * step);
                let analytic = jacobian.column(column);
                let scale = jacobian.norm();
                prop_assert!((analytic - difference).norm() <= 1e-7 * scale.max(1.0), "{id}: {analytic} {difference}");
            }
        }

        /// Rotations against differences of the product of the link transforms.
        #[test]
        fn the_turn_of_the_flange_is_the_central_difference((model, q, target) in robot_and_pose()) {
            let mut ids = ParameterId::all_of_links(model.joint_count());
            ids.extend(ParameterId::all_of_frame(0));
            ids.extend(ParameterId::all_of_orientation(0));
            let mounted = Rotation3::new(2.0 * target);
            let jacobian = stack_poses(&model, &[&q], &target, &mounted, 1.0, &ids);
            let at = |id: ParameterId, delta: f64| {
                let (mut model, mut frame, mut turn) = (model.clone(), nalgebra::Vector6::zeros(), Vector3::zeros());
                match id {
                    ParameterId::Link { .. } => model.add(id, delta),
                    ParameterId::Frame { component, .. } => frame[component] = delta,
                    ParameterId::Orientation { axis, .. } => turn[axis] = delta,
                    _ => {}
                }
                let base = calibrig_model::geometry::small_displacement(&frame);
                base.rotation * flange(&model, &q).rotation * mounted * Rotation3::new(turn)
            };
            let step = 1e-5;
            for (column, id) in ids.iter().enumerate() {
                let change = at(*id, step) * at(*id, -step).inverse();
                let difference = calibrig_model::geometry::rotation_vector(&change) / (2.0 * step);
                let analytic = jacobian.fixed_view::<3, 1>(3, column);
                prop_assert!((analytic - difference).norm() <= 1e-8, "{id}: {analytic} {difference}");
            }
        }

        #[test]
        fn the_placed_chain_is_the_product_of_the_link_transforms((model, q, target) in robot_and_pose()) {
            let mut chain = PlacedChain::new(&model);
            chain.place(&q);
            let product = forward_kinematics(&model, &q).expect("a pose");
            prop_assert!((chain.base_from_flange().to_homogeneous() - product.to_homogeneous()).norm() < 1e-12);
            prop_assert!((chain.target(&target) - super::target(&model, &q, &target)).norm() < 1e-12);

            let columns = |chain: &PlacedChain| {
                let ids = ParameterId::all_of_links(model.joint_count()).into_iter();
                ids.map(|id| chain.column(id, &chain.target(&target))).collect::<Vec<_>>()
            };
            let by_variables = columns(&chain);
            let motions = model.links.iter().zip(&q).map(|(link, q)| link.fixed_part().inverse() * link.transform(*q));
            chain.place_at(&motions.collect::<Vec<_>>());
            prop_assert!((chain.base_from_flange().to_homogeneous() - product.to_homogeneous()).norm() < 1e-12);
            for (a, b) in columns(&chain).iter().zip(&by_variables) {
                prop_assert!((a - b).norm() < 1e-11);
            }
        }
    }

    #[test]
    fn a_planar_arm_by_hand() {
        let link = |a: f64| CraigLink {
            name: String::new(),
            kind: JointKind::Revolute,
            a,
            alpha: 0.0,
            beta: 0.0,
            d: 0.0,
            theta: 0.0,
            limits: [-3.0, 3.0],
        };
        let model = KinematicModel {
            links: vec![link(0.0), link(2.0)],
            base_from_first: Transform::identity(),
            last_from_flange: Transform::identity(),
        };
        let quarter = std::f64::consts::FRAC_PI_2;
        let tip = target_in_base(&model, &[quarter, -quarter], &Vector3::new(1.0, 0.0, 0.0)).expect("a pose");
        assert!((tip - Vector3::new(1.0, 2.0, 0.0)).norm() < 1e-15);
    }
}
