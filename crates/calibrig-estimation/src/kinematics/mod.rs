//! Forward kinematics and the analytic identification Jacobian of any open chain of revolute and prismatic joints, and the closed four-bar
//! that may drive its elbow.

mod chain;
mod four_bar;
mod screw;

pub(crate) use chain::{KinematicChain, joint_component};
pub use four_bar::{
    Closure, ClosureError, ElbowClosure, ElbowLinkage, command_from_joints, joints_from_command, swing_to,
};
pub(crate) use four_bar::{is_parallelogram, nominal_joints};
pub(crate) use screw::{MovingFrame, Screw, stepped};

use nalgebra::{DMatrix, Matrix3xX, Rotation3, Vector3};

use calibrig_model::geometry::Transform;
use calibrig_model::{KinematicModel, ModelError, ParameterId};

/// What the joint variables are called in errors.
const JOINTS: &str = "joint variables";
/// What the place of a target on the flange is called there.
pub(crate) const TARGET: &str = "the target's offset";

/// `base_from_flange` at the joint variables `q` (rad or m, one a joint).
///
/// # Errors
///
/// [`ModelError`], where the chain is not valid, or `q` does not have one finite number per joint.
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
    finite(TARGET, None, in_flange.as_slice())?;
    Ok(target(model, q, in_flange))
}

/// Refuses what is no finite number.
pub(crate) fn finite(field: &'static str, joint: Option<usize>, values: &[f64]) -> Result<(), ModelError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(ModelError::Number { field, joint, value, expected: "a finite number" }),
        None => Ok(()),
    }
}

/// [`target_in_base`] at a pose of the robot.
pub(crate) fn target(model: &KinematicModel, q: &[f64], in_flange: &Vector3<f64>) -> Vector3<f64> {
    let base_from_flange = flange(model, q);
    base_from_flange.rotation * in_flange + base_from_flange.translation.vector
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
    finite(TARGET, None, in_flange.as_slice())?;
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
    let mut chain = KinematicChain::new(model);
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
    let mut chain = KinematicChain::new(model);
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
    use calibrig_model::{CraigLink, JointKind};

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
            let mut chain = KinematicChain::new(&model);
            chain.place(&q);
            let product = forward_kinematics(&model, &q).expect("a pose");
            prop_assert!((chain.base_from_flange().to_homogeneous() - product.to_homogeneous()).norm() < 1e-12);
            prop_assert!((chain.target(&target) - super::target(&model, &q, &target)).norm() < 1e-12);

            let columns = |chain: &KinematicChain| {
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
