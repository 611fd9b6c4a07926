//! The rapier side of a plant: one multibody without colliders, one coordinate a joint.

use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d::dynamics::{
    GenericJoint, GenericJointBuilder, IntegrationParameters, JointAxesMask, MassProperties, Multibody,
    MultibodyIndex, MultibodyJointSet, MultibodyLink, RigidBodyBuilder, RigidBodyHandle,
};
use rapier3d::math::{Matrix, Pose, Rotation, Vector};
use rapier3d::pipeline::PhysicsWorld;

use super::AsBuilt;
use crate::geometry::Transform;
use crate::model::{Body, CraigLink, JointKind};

/// The links of a robot in their own rapier world, whose frame is the base.
pub(super) struct Chain {
    world: PhysicsWorld,
    multibody: MultibodyIndex,
    /// Which of the six axes of its joint frame a joint leaves free.
    axes: Vec<usize>,
    /// Infinite for a rigid drive.
    stiffness: Vec<f64>,
    /// Of every body, N.
    weights: Vec<Vector3<f64>>,
    displacement: Vec<f64>,
}

impl Chain {
    /// The chain at rest with every joint variable zero. The robot must have passed its checks.
    pub(super) fn new(robot: &AsBuilt, dt: f64) -> Self {
        let gravity = robot.statics.gravity;
        let mut world = PhysicsWorld { gravity: vector(&gravity), ..PhysicsWorld::default() };
        world.integration_parameters = IntegrationParameters {
            dt,
            // One step is one backward-Euler step of the springs: there are no constraints to iterate over.
            num_solver_iterations: 1,
            num_internal_pgs_iterations: 1,
            num_internal_stabilization_iterations: 0,
            max_ccd_substeps: 0,
            ..IntegrationParameters::default()
        };
        let base = world.bodies.insert(RigidBodyBuilder::fixed());
        let mut parent = base;
        let joints = robot.kinematics.links.iter().zip(&robot.statics.bodies);
        for ((link, body), stiffness) in joints.zip(&robot.statics.drive_stiffness) {
            let child = insert_body(&mut world, body);
            // A kinematic joint is one whose velocity, here zero, the solver never changes.
            let inserted = if stiffness.is_finite() {
                world.multibody_joints.insert(parent, child, free_joint(link), true)
            } else {
                world.multibody_joints.insert_kinematic(parent, child, free_joint(link), true)
            };
            debug_assert!(inserted.is_some(), "every body is new to the multibody");
            parent = child;
        }
        let multibody = world
            .multibody_joints
            .rigid_body_link(base)
            .map_or_else(|| unreachable!("a robot has a joint"), |link| link.multibody);
        let mut chain = Self {
            world,
            multibody,
            axes: robot.kinematics.links.iter().map(|link| axis(link.kind)).collect(),
            stiffness: robot.statics.drive_stiffness.clone(),
            weights: robot.statics.bodies.iter().map(|body| body.mass * gravity).collect(),
            displacement: vec![0.0; robot.kinematics.joint_count()],
        };
        // The base becomes fixed, and the coordinates those of the joints alone, with the first forward kinematics.
        chain.update();
        chain.multibody_mut().damping_mut().fill(0.0);
        chain
    }

    /// Sets every drive to its joint variable and puts the chain there.
    pub(super) fn drive_to(&mut self, joints: &[f64]) {
        let (axes, stiffness) = (&self.axes, &self.stiffness);
        let multibody = multibody_of(&mut self.world.multibody_joints, self.multibody);
        for (joint, link) in multibody.links_mut().skip(1).enumerate() {
            if stiffness[joint].is_finite() {
                link.joint.set_spring(axes[joint], stiffness[joint], joints[joint]);
            }
        }
        self.place(joints);
    }

    /// Puts the chain at the joint variables, to the bit, wherever it was.
    pub(super) fn place(&mut self, joints: &[f64]) {
        // By way of zero: coordinates can only be displaced, and `c + (q - c)` need not be `q`.
        for joint in 0..joints.len() {
            self.displacement[joint] = -self.coordinate(joint);
        }
        let multibody = multibody_of(&mut self.world.multibody_joints, self.multibody);
        multibody.apply_displacements(&self.displacement);
        multibody.apply_displacements(joints);
        self.update();
    }

    /// Poses and body Jacobians at the coordinates.
    fn update(&mut self) {
        let PhysicsWorld { multibody_joints, bodies, .. } = &mut self.world;
        multibody_of(multibody_joints, self.multibody).forward_kinematics(bodies, false);
    }

    /// One step of rapier from rest. Without velocities there is no memory of the way here, and no Coriolis term.
    pub(super) fn step_from_rest(&mut self) {
        self.multibody_mut().generalized_velocity_mut().fill(0.0);
        self.world.step();
    }

    /// A joint variable, rad or m.
    pub(super) fn coordinate(&self, joint: usize) -> f64 {
        self.link(joint).joint.coords()[self.axes[joint]]
    }

    /// Pose of a link in the base frame.
    pub(super) fn pose(&self, joint: usize) -> &Pose {
        self.link(joint).local_to_world()
    }

    /// Generalised force of gravity (N or N m) from rapier's body Jacobians, whose first rows move the centres of mass.
    pub(super) fn gravity_load(&self, load: &mut [f64]) {
        load.fill(0.0);
        let multibody = self.multibody();
        for (body, weight) in self.weights.iter().enumerate() {
            let jacobian = multibody.body_jacobian(body + 1);
            for (load, column) in load.iter_mut().zip(jacobian.column_iter()) {
                *load += column.fixed_rows::<3>(0).dot(weight);
            }
        }
    }

    fn multibody(&self) -> &Multibody {
        &self.world.multibody_joints[self.multibody]
    }

    fn multibody_mut(&mut self) -> &mut Multibody {
        multibody_of(&mut self.world.multibody_joints, self.multibody)
    }

    /// The link that a joint carries: link 0 is the base.
    fn link(&self, joint: usize) -> &MultibodyLink {
        self.multibody().link(joint + 1).unwrap_or_else(|| unreachable!("one link a joint"))
    }
}

fn multibody_of(joints: &mut MultibodyJointSet, index: MultibodyIndex) -> &mut Multibody {
    joints.get_multibody_mut(index).unwrap_or_else(|| unreachable!("it is never removed"))
}

fn insert_body(world: &mut PhysicsWorld, body: &Body) -> RigidBodyHandle {
    let properties = MassProperties::with_inertia_matrix(
        vector(&body.centre_of_mass),
        body.mass,
        Matrix::from_cols_array_2d(&body.inertia.data.0),
    );
    let handle = world
        .bodies
        .insert(RigidBodyBuilder::dynamic().can_sleep(false).additional_mass_properties(properties));
    // Until then a body has no mass.
    world.bodies[handle].recompute_mass_properties_from_colliders(&world.colliders);
    handle
}

fn axis(kind: JointKind) -> usize {
    match kind {
        JointKind::Prismatic => 2,
        JointKind::Revolute => 5,
    }
}

fn free_joint(link: &CraigLink) -> GenericJoint {
    let free = match link.kind {
        JointKind::Prismatic => JointAxesMask::LIN_Z,
        JointKind::Revolute => JointAxesMask::ANG_Z,
    };
    GenericJointBuilder::new(JointAxesMask::all() & !free)
        .local_frame1(pose(&link.fixed_part()))
        .contacts_enabled(false)
        .build()
}

/// To rapier.
pub(super) fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

fn pose(transform: &Transform) -> Pose {
    let q = UnitQuaternion::from_rotation_matrix(&transform.rotation);
    Pose::from_parts(vector(&transform.translation.vector), Rotation::from_xyzw(q.i, q.j, q.k, q.w))
}

/// From rapier.
pub(super) fn transform(pose: &Pose) -> Transform {
    let (t, q) = (pose.translation, pose.rotation);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
    Transform::from_parts(Translation3::new(t.x, t.y, t.z), rotation.to_rotation_matrix())
}
