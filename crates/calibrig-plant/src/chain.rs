//! The rapier side of a plant: one multibody without colliders, closed by an impulse joint if the robot has a loop.

use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d::dynamics::{
    GenericJoint, GenericJointBuilder, IntegrationParameters, JointAxesMask, MassProperties, Multibody,
    MultibodyIndex, MultibodyJointSet, MultibodyLink, RigidBodyBuilder, RigidBodyHandle,
};
use rapier3d::math::{Matrix, Pose, Rotation, Vector};
use rapier3d::pipeline::PhysicsWorld;

use super::tree::{Loop, Node, Pull, Tree};
use calibrig_model::Body;
use calibrig_model::geometry::Transform;

/// Gauss-Seidel iterations over the three rows of the loop, along and across the rod: each reduces the error to at most 1e-2
/// of it.
const LOOP_ITERATIONS: usize = 30;
/// Stiffness that holds the elbow and the rod's two angles during a step, in addition to the loop: N m/rad about where they are. It has
/// no effect at rest. The rod must be much softer, which keeps the rows of the loop nearly independent.
const ELBOW_HOLD: f64 = 1e3;
const ROD_HOLD: f64 = 1.0;

/// A robot in its own rapier world, whose frame is the base.
pub(super) struct Chain {
    world: PhysicsWorld,
    multibody: MultibodyIndex,
    bodies: Vec<RigidBodyHandle>,
    /// Node and axis of every coordinate.
    coordinates: Vec<(usize, usize)>,
    /// Mass and its centre, of every node.
    masses: Vec<(f64, Vector3<f64>)>,
    displacement: Vec<f64>,
}

impl Chain {
    /// The tree at rest with every coordinate zero.
    pub(super) fn new(tree: &Tree, gravity: &Vector3<f64>, dt: f64) -> Self {
        let mut world = PhysicsWorld { gravity: vector(gravity), ..PhysicsWorld::default() };
        world.integration_parameters = IntegrationParameters {
            dt,
            // One step is one backward-Euler step of the springs; only a loop needs iterations.
            num_solver_iterations: 1,
            num_internal_pgs_iterations: if tree.closure.is_some() { LOOP_ITERATIONS } else { 1 },
            num_internal_stabilization_iterations: 0,
            max_ccd_substeps: 0,
            ..IntegrationParameters::default()
        };
        let base = world.bodies.insert(RigidBodyBuilder::fixed());
        let mut bodies: Vec<RigidBodyHandle> = Vec::with_capacity(tree.nodes.len());
        for node in &tree.nodes {
            let parent = node.parent.map_or(base, |parent| bodies[parent]);
            let child = world.bodies.insert(RigidBodyBuilder::dynamic().can_sleep(false));
            // A kinematic joint is one whose velocity, here zero, the solver never changes.
            let inserted = if node.coordinates.iter().all(|coordinate| coordinate.stiffness.is_finite()) {
                world.multibody_joints.insert(parent, child, joint(node), true)
            } else {
                world.multibody_joints.insert_kinematic(parent, child, joint(node), true)
            };
            debug_assert!(inserted.is_some(), "every body is new to the multibody");
            bodies.push(child);
        }
        let multibody = world
            .multibody_joints
            .rigid_body_link(base)
            .map_or_else(|| unreachable!("a robot has a joint"), |link| link.multibody);
        if let Some(closure) = &tree.closure {
            // Its iterations start from no impulse in every step: rapier's warm start is off.
            world.insert_impulse_joint(bodies[closure.tip], bodies[closure.lever], ball(closure));
        }
        let coordinates: Vec<_> = tree.coordinates().map(|(node, entry)| (node, entry.axis)).collect();
        let mut chain = Self {
            world,
            multibody,
            bodies,
            displacement: vec![0.0; coordinates.len()],
            coordinates,
            masses: vec![(0.0, Vector3::zeros()); tree.nodes.len()],
        };
        (0..tree.nodes.len()).for_each(|node| chain.load_node(tree, node));
        // The base becomes fixed, and the coordinates those of the joints alone, with the first forward kinematics.
        chain.update();
        chain.multibody_mut().damping_mut().fill(0.0);
        if let Some(closure) = &tree.closure {
            chain.hold(closure, tree, dt);
        }
        chain
    }

    /// Inertia of the passive coordinates, which is a spring of stiffness `inertia / dt²` about where a step starts.
    fn hold(&mut self, closure: &Loop, tree: &Tree, dt: f64) {
        for (coordinate, (node, entry)) in tree.coordinates().enumerate() {
            if entry.stiffness == 0.0 {
                let hold = if closure.rod.contains(&node) { ROD_HOLD } else { ELBOW_HOLD };
                self.multibody_mut().armature_mut()[coordinate] = hold * dt * dt;
            }
        }
    }

    /// Takes places and masses that depend on the pose from a tree of the same form.
    pub(super) fn rearrange(&mut self, tree: &Tree) {
        for (index, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.varies) {
            self.load_node(tree, index);
            self.place_frames(index, node);
        }
    }

    /// Sets the mass of a node.
    fn load_node(&mut self, tree: &Tree, index: usize) {
        let body = tree.nodes[index].body();
        self.masses[index] = (body.mass, body.centre_of_mass);
        let PhysicsWorld { bodies, colliders, .. } = &mut self.world;
        let rigid_body = &mut bodies[self.bodies[index]];
        rigid_body.set_additional_mass_properties(mass_properties(&body), true);
        // Until then a body has no mass.
        rigid_body.recompute_mass_properties_from_colliders(colliders);
    }

    /// Sets both local frames of a node's joint.
    pub(super) fn place_frames(&mut self, index: usize, node: &Node) {
        let data = &mut self.link_mut(index).joint.data;
        data.local_frame1 = pose(&node.parent_from_joint);
        data.local_frame2 = pose(&node.body_from_joint);
    }

    /// Sets stiffness (zero: none) and rest of every coordinate's spring.
    pub(super) fn set_springs(&mut self, springs: impl Iterator<Item = (f64, f64)>) {
        for (coordinate, (stiffness, rest)) in springs.enumerate() {
            let (node, axis) = self.coordinates[coordinate];
            self.link_mut(node).joint.set_spring(axis, stiffness, rest);
        }
    }

    /// Puts the chain at the coordinates, to the bit, wherever it was.
    pub(super) fn place(&mut self, coordinates: &[f64]) {
        // By way of zero: coordinates can only be displaced, and `c + (q - c)` need not be exactly `q`.
        for coordinate in 0..coordinates.len() {
            self.displacement[coordinate] = -self.coordinate(coordinate);
        }
        let multibody = multibody_of(&mut self.world.multibody_joints, self.multibody);
        multibody.apply_displacements(&self.displacement);
        multibody.apply_displacements(coordinates);
        self.update();
    }

    /// Poses and body Jacobians at the coordinates.
    fn update(&mut self) {
        let PhysicsWorld { multibody_joints, bodies, .. } = &mut self.world;
        multibody_of(multibody_joints, self.multibody).forward_kinematics(bodies, false);
    }

    /// Sets the forces in the present pose in addition to the weights. They must be on the same nodes as before.
    pub(super) fn pull(&mut self, pulls: impl Iterator<Item = Pull> + Clone) {
        for Pull { node, .. } in pulls.clone() {
            let body = &mut self.world.bodies[self.bodies[node]];
            body.reset_forces(false);
            body.reset_torques(false);
        }
        for Pull { node, at, force } in pulls {
            let (_, centre) = self.mass(node);
            let body = &mut self.world.bodies[self.bodies[node]];
            body.add_force(vector(&force), false);
            body.add_torque(vector(&(at - centre).cross(&force)), false);
        }
    }

    /// One step of rapier from rest. Without velocities, the step does not depend on how it got here, and has no
    /// Coriolis term.
    pub(super) fn step_from_rest(&mut self) {
        self.multibody_mut().generalized_velocity_mut().fill(0.0);
        self.world.step();
    }

    /// Number of coordinates.
    pub(super) fn coordinate_count(&self) -> usize {
        self.coordinates.len()
    }

    /// A coordinate, rad or m.
    pub(super) fn coordinate(&self, coordinate: usize) -> f64 {
        let (node, axis) = self.coordinates[coordinate];
        self.link(node).joint.coords()[axis]
    }

    /// Pose of a node's body in the base frame.
    pub(super) fn pose(&self, node: usize) -> &Pose {
        self.link(node).local_to_world()
    }

    /// Mass of a node and its centre in the base frame, kg and m.
    pub(super) fn mass(&self, node: usize) -> (f64, Vector3<f64>) {
        let (mass, centre) = &self.masses[node];
        (*mass, point(&self.pose(node).transform_point(vector(centre))))
    }

    /// How a coordinate moves the bodies that it carries, from rapier's body Jacobian of its own node: the velocity of the point of the
    /// body at the base's origin, and the rotation.
    pub(super) fn twist(&self, coordinate: usize) -> (Vector3<f64>, Vector3<f64>) {
        let (node, _) = self.coordinates[coordinate];
        let column = self.multibody().body_jacobian(node + 1).column(coordinate);
        let (velocity, rotation): (Vector3<f64>, Vector3<f64>) =
            (column.fixed_rows::<3>(0).into(), column.fixed_rows::<3>(3).into());
        let (_, centre) = self.mass(node);
        (velocity - rotation.cross(&centre), rotation)
    }

    fn multibody(&self) -> &Multibody {
        &self.world.multibody_joints[self.multibody]
    }

    fn multibody_mut(&mut self) -> &mut Multibody {
        multibody_of(&mut self.world.multibody_joints, self.multibody)
    }

    /// The link of a node: link 0 is the base.
    fn link(&self, node: usize) -> &MultibodyLink {
        self.multibody().link(node + 1).unwrap_or_else(|| unreachable!("one link a node"))
    }

    fn link_mut(&mut self, node: usize) -> &mut MultibodyLink {
        self.multibody_mut().link_mut(node + 1).unwrap_or_else(|| unreachable!("one link a node"))
    }
}

fn multibody_of(joints: &mut MultibodyJointSet, index: MultibodyIndex) -> &mut Multibody {
    joints.get_multibody_mut(index).unwrap_or_else(|| unreachable!("it is never removed"))
}

fn mass_properties(body: &Body) -> MassProperties {
    MassProperties::with_inertia_matrix(
        vector(&body.centre_of_mass),
        body.mass,
        Matrix::from_cols_array_2d(&body.inertia.data.0),
    )
}

fn joint(node: &Node) -> GenericJoint {
    let free = node.coordinates.iter().fold(JointAxesMask::empty(), |free, coordinate| {
        free | JointAxesMask::from_bits_truncate(1 << coordinate.axis)
    });
    GenericJointBuilder::new(JointAxesMask::all() & !free)
        .local_frame1(pose(&node.parent_from_joint))
        .local_frame2(pose(&node.body_from_joint))
        .contacts_enabled(false)
        .build()
}

/// The rod's end on the lever's, its rows along and across the rod.
fn ball(closure: &Loop) -> GenericJoint {
    GenericJointBuilder::new(JointAxesMask::LIN_X | JointAxesMask::LIN_Y | JointAxesMask::LIN_Z)
        .local_frame1(Pose::from_translation(vector(&closure.tip_at)))
        .local_frame2(Pose::from_translation(vector(&closure.lever_at)))
        .contacts_enabled(false)
        .build()
}

/// To rapier.
pub(super) fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

/// From rapier.
pub(super) fn point(v: &Vector) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
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
