//! The pose of a robot at rest.

use nalgebra::{Cholesky, DVector, Dyn, Point3, Vector3};
use rapier3d::math::Vector;

use super::chain::{Chain, point, transform, vector};
use super::confirmation::{AtRest, Confirmation};
use super::linkage::{check_transmission, close};
use super::statics::Statics;
use super::tree::{Role, Tree};
use super::validation::{check_at_command, check_command, check_displacements, check_options, check_robot};
use super::{AsBuilt, ElasticDeflection, PlantError, SettleOptions, SettledPose};
use calibrig_model::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};
use calibrig_model::{BeamSegment, Payload, SegmentLength};

/// Largest number of Newton steps; a few are enough for the last digits.
const MOST_NEWTON_STEPS: u32 = 12;
/// Size of a Newton step (rad or m) after which only rounding is left.
const CONVERGED: f64 = 1e-9;
/// Size of a step (rad or m) up to which the tangent stiffness stays as it is.
const SAME_TANGENT: f64 = 1e-3;
/// Size of a step (rad or m) from which the tangent says nothing about its end.
const ASTRAY: f64 = 1.0;

/// The rapier multibody of one robot.
///
/// Every elastic direction is a reduced coordinate on a spring that rapier integrates implicitly; the drives' springs rest at the command.
/// A drive of infinite stiffness is a kinematic joint: the solver leaves it exactly where it is. The four-bar of the elbow is closed by an
/// impulse joint between its rod and its lever. A four-bar without statics has a rigid rod and no mass; statics without known lengths have
/// no effect.
pub struct Plant {
    pub(super) robot: AsBuilt,
    /// The last load of the robot, if the flange carries one.
    pub(super) payload: Option<Payload>,
    pub(super) options: SettleOptions,
    pub(super) tree: Tree,
    pub(super) chain: Chain,
    /// Where poses are confirmed, unless by a step of the chain itself.
    pub(super) confirmation: Option<Confirmation>,
    pub(super) statics: Statics,
    target_in_last: Vector,
    /// The joint variables that the drives would hold without a load; the elbow's as of an exact parallelogram.
    commanded: Vec<f64>,
    /// Where the spring of every coordinate rests.
    rest: Vec<f64>,
    /// Result of Newton's method.
    pub(super) coordinates: Vec<f64>,
    /// Beyond the rest.
    deflection: Vec<f64>,
    left_over: DVector<f64>,
    /// Whether links are shifted after their joints.
    displaced: bool,
    /// Whether the tree depends on the pose.
    varies: bool,
    /// Largest number of steps of Newton's method.
    pub(super) newton_steps: u32,
}

impl Plant {
    /// Checks the robot and builds its multibody, with the base frame as rapier's world frame.
    pub fn new(robot: &AsBuilt, options: SettleOptions) -> Result<Self, PlantError> {
        check_options(&options)?;
        check_robot(robot)?;
        let joints = robot.kinematics.joint_count();
        let target_in_last = robot.kinematics.last_from_flange * Point3::from(robot.target);
        let tree = Tree::new(robot, &extended(robot));
        let (chain, confirmation) = worlds(&tree, robot, &options);
        let coordinates = chain.coordinate_count();
        Ok(Self {
            options,
            chain,
            confirmation,
            statics: Statics::new(&tree, robot),
            target_in_last: vector(&target_in_last.coords),
            commanded: vec![0.0; joints],
            rest: vec![0.0; coordinates],
            coordinates: vec![0.0; coordinates],
            deflection: vec![0.0; coordinates],
            left_over: DVector::zeros(coordinates),
            displaced: false,
            varies: tree.varies(),
            newton_steps: MOST_NEWTON_STEPS,
            tree,
            robot: robot.clone(),
            payload: None,
        })
    }

    /// The pose at rest under gravity and loads at a command (SI, one per actuator).
    ///
    /// It depends only on the robot, what it [carries](Self::carry), the options and the command; no bit depends on earlier poses.
    pub fn settle(&mut self, command: &[f64]) -> Result<SettledPose, PlantError> {
        self.settle_displaced(command, &[])
    }

    /// Like [`Plant::settle`], with every link's frame shifted: `motion · Tx·Ty·Tz·Rx·Ry·Rz`, directly after the joint's motion and in
    /// front of a bearing on the moving side, by three lengths (m) and three angles (rad). Empty for no shift; otherwise one entry per
    /// joint.
    pub fn settle_displaced(
        &mut self,
        command: &[f64],
        displacements: &[[f64; 6]],
    ) -> Result<SettledPose, PlantError> {
        self.settle_and(self.options.confirm, command, displacements)
    }

    /// Settles, with or without a confirmation: see [`SettleOptions::confirm`].
    pub(super) fn settle_and(
        &mut self,
        confirm: bool,
        command: &[f64],
        displacements: &[[f64; 6]],
    ) -> Result<SettledPose, PlantError> {
        check_command(self.commanded.len(), command)?;
        check_displacements(self.commanded.len(), displacements)?;
        self.robot.actuators.joints_from_command(command, &mut self.commanded);
        check_at_command(&self.robot, &self.commanded)?;
        self.rearrange();
        self.displace(displacements);
        self.rest_at_command()?;
        let settled = self.relax(confirm);
        if settled.is_err() {
            // rapier disables the bodies that it finds at no finite place.
            (self.chain, self.confirmation) = worlds(&self.tree, &self.robot, &self.options);
        }
        settled
    }

    /// Shifts the links behind their joints.
    fn displace(&mut self, displacements: &[[f64; 6]]) {
        if !self.displaced && displacements.is_empty() {
            return;
        }
        for (joint, &motion) in self.tree.motions.iter().enumerate() {
            let shift = displacements.get(joint).map_or_else(Transform::identity, shift);
            let node = &mut self.tree.nodes[motion];
            node.body_from_joint = shift.inverse();
            self.chain.place_frames(motion, node);
        }
        self.displaced = !displacements.is_empty();
    }

    /// Gives telescoping beams their length.
    fn rearrange(&mut self) {
        if self.varies {
            self.tree = Tree::new(&self.robot, &self.commanded);
            self.chain.rearrange(&self.tree);
            self.statics.restiffen(&self.tree);
        }
    }

    /// Lets every spring rest at the command.
    fn rest_at_command(&mut self) -> Result<(), PlantError> {
        let closure = self.tree.closure.as_ref();
        let closed = closure.map(|closure| close(&self.robot, &self.commanded, closure)).transpose()?;
        for (coordinate, (node, entry)) in self.tree.coordinates().enumerate() {
            let rest = match (entry.role, closure, closed) {
                (Role::Elastic(_), ..) => 0.0,
                (Role::Drive(joint), Some(closure), _) if joint == closure.elbow => {
                    let theta = self.robot.kinematics.links[joint].theta;
                    self.commanded[closure.shoulder] + self.commanded[joint] + theta
                }
                (Role::Drive(joint), ..) => self.commanded[joint],
                (Role::Passive, Some(closure), Some(closed)) => {
                    match closure.rod.iter().position(|&rod| rod == node) {
                        Some(turn) => closed.rod[turn],
                        None => closed.elbow,
                    }
                }
                (Role::Passive, ..) => unreachable!("only a closed loop holds passive coordinates"),
            };
            self.rest[coordinate] = rest;
        }
        Ok(())
    }

    /// The pose that Newton's method finds, confirmed by a step of rapier; if it finds none, or the step leaves it, steps of rapier until
    /// nothing moves any more.
    fn relax(&mut self, confirm: bool) -> Result<SettledPose, PlantError> {
        let is_stable = self.newton()?;
        let mut steps = 0;
        if is_stable && self.is_at_rest() {
            self.check_settled(is_stable, 0)?;
            let pose = self.settled_pose(0);
            if !confirm {
                return Ok(pose);
            }
            steps = 1;
            if self.is_confirmed() {
                return Ok(SettledPose { steps, ..pose });
            }
        }
        let mut tip = self.tip();
        let mut tip_motion = f64::INFINITY;
        while steps < self.options.max_steps && tip.is_finite() {
            self.step();
            steps += 1;
            let before = std::mem::replace(&mut tip, self.tip());
            tip_motion = tip.distance(before);
            self.evaluate();
            if tip_motion <= self.options.tip_tolerance && self.is_at_rest() {
                self.check_settled(is_stable, steps)?;
                return Ok(self.settled_pose(steps));
            }
        }
        self.check_stability(steps)?;
        let (residual, closure) = (self.residual(), self.gap());
        Err(PlantError::NotSettled { steps, tip_motion, residual, closure })
    }

    /// Takes a step of rapier from a pose at rest. Returns whether the pose stayed where it was.
    fn is_confirmed(&mut self) -> bool {
        let (springs, tip) = (self.springs(), self.tip());
        if let Some(confirmation) = &mut self.confirmation {
            let Self { tree, chain, statics, coordinates, .. } = self;
            let pose = AtRest { tree, chain, statics, coordinates, springs: &springs };
            let stepped = confirmation.step(&pose);
            self.chain.place(&stepped);
        } else {
            self.step();
        }
        self.evaluate();
        self.tip().distance(tip) <= self.options.tip_tolerance && self.is_at_rest()
    }

    /// A step of rapier from rest.
    pub(super) fn step(&mut self) {
        self.chain.set_springs(self.springs().into_iter());
        self.chain.pull(self.statics.pulls());
        self.chain.step_from_rest();
    }

    /// Stiffness and rest of every coordinate's spring in the present pose.
    pub(super) fn springs(&self) -> Vec<(f64, f64)> {
        let springs = self.statics.springs(&self.deflection).into_iter();
        springs.zip(&self.rest).map(|((stiffness, deflected), rest)| (stiffness, rest + deflected)).collect()
    }

    fn residual(&self) -> f64 {
        self.statics.residual(&self.deflection)
    }

    fn gap(&self) -> f64 {
        self.statics.closure().map_or(0.0, |closure| closure.gap().norm())
    }

    /// Whether no force is left over, and the loop is closed.
    fn is_at_rest(&self) -> bool {
        self.residual() <= self.options.residual_tolerance && self.gap() <= self.options.closure_tolerance
    }

    /// The target in the base frame.
    fn tip(&self) -> Vector {
        let last = self.tree.links[self.tree.links.len() - 1];
        self.chain.pose(last).transform_point(self.target_in_last)
    }

    /// Deflections and forces in the present pose. Returns whether the stiffness of a drive has changed.
    pub(super) fn evaluate(&mut self) -> bool {
        for (coordinate, deflection) in self.deflection.iter_mut().enumerate() {
            *deflection = self.chain.coordinate(coordinate) - self.rest[coordinate];
        }
        self.statics.evaluate(&self.chain);
        self.statics.stiffen(&self.deflection)
    }

    /// Places the chain where Newton's method on its own Jacobians finds the pose at rest, or in the unloaded pose if it finds none. Returns
    /// whether it found one with a positive definite tangent stiffness nearby; if the tangent is not positive definite even in the unloaded
    /// pose, the loads overpower the springs.
    fn newton(&mut self) -> Result<bool, PlantError> {
        self.coordinates.copy_from_slice(&self.rest);
        self.chain.place(&self.coordinates);
        let mut stiffened = self.evaluate();
        let mut tangent: Option<Cholesky<f64, Dyn>> = None;
        let mut last = f64::INFINITY;
        for iteration in 0..self.newton_steps {
            self.statics.left_over(&self.deflection, &mut self.left_over);
            if last > SAME_TANGENT || stiffened {
                tangent = Cholesky::new(self.statics.tangent());
                if tangent.is_none() && iteration == 0 {
                    self.check_stability(0)?;
                }
            }
            let step = tangent.as_ref().and_then(|tangent| self.statics.newton(tangent, &self.left_over));
            let Some(step) = step.filter(|step| step.amax() < ASTRAY) else { break };
            for (coordinate, step) in self.coordinates.iter_mut().zip(step.iter()) {
                *coordinate += step;
            }
            self.chain.place(&self.coordinates);
            stiffened = self.evaluate();
            last = step.amax();
            if last < CONVERGED {
                return Ok(true);
            }
        }
        self.coordinates.copy_from_slice(&self.rest);
        self.chain.place(&self.coordinates);
        self.evaluate();
        Ok(false)
    }

    /// Refuses a pose at rest that is unstable or close to the four-bar's singularity.
    fn check_settled(&self, is_stable: bool, steps: u32) -> Result<(), PlantError> {
        if let (Some(closure), Some(elbow)) = (self.statics.closure(), self.elbow()) {
            let lever_motion = closure.jacobian.column(elbow).into_owned();
            check_transmission(&(closure.lever - self.crank_end()), &lever_motion)?;
        }
        if is_stable { Ok(()) } else { self.check_stability(steps) }
    }

    /// Refuses a pose whose tangent stiffness is finite and not positive definite.
    fn check_stability(&self, steps: u32) -> Result<(), PlantError> {
        let tangent = self.statics.tangent();
        if tangent.iter().all(|entry| entry.is_finite()) && Cholesky::new(tangent).is_none() {
            return Err(PlantError::Unstable { steps, margin: self.statics.margin() });
        }
        Ok(())
    }

    /// The coordinate of the elbow that the four-bar drives.
    fn elbow(&self) -> Option<usize> {
        let motion = self.tree.motions[self.tree.closure.as_ref()?.elbow];
        self.tree.coordinates().position(|(node, _)| node == motion)
    }

    fn crank_end(&self) -> Vector3<f64> {
        let yaw = self.tree.closure.as_ref().map(|closure| closure.rod[0]);
        yaw.map_or_else(Vector3::zeros, |yaw| point(&self.chain.pose(yaw).translation))
    }

    fn settled_pose(&self, steps: u32) -> SettledPose {
        let tip = self.tip();
        let mut deflection = vec![0.0; self.commanded.len()];
        let mut elastic = Vec::with_capacity(self.deflection.len());
        for ((_, entry), value) in self.tree.coordinates().zip(&self.deflection) {
            match entry.role {
                Role::Drive(joint) => deflection[joint] = *value,
                Role::Elastic(place) => {
                    elastic.push(ElasticDeflection { place, axis: entry.axis, value: *value });
                }
                Role::Passive => {}
            }
        }
        SettledPose {
            target: point(&tip),
            links: self.tree.links.iter().map(|&node| transform(self.chain.pose(node))).collect(),
            deflection,
            elastic,
            linkage: self.linkage(),
            rod_force: self.rod_force(),
            residual: self.residual(),
            closure: self.gap(),
            steps,
        }
    }

    /// Crank's frame, crank end, lever end and elbow, in the base frame.
    fn linkage(&self) -> Option<[Vector3<f64>; 4]> {
        let tree = self.tree.closure.as_ref()?;
        let origin = |node: usize| point(&self.chain.pose(node).translation);
        let lever = self.statics.closure()?.lever;
        Some([origin(tree.crank), self.crank_end(), lever, origin(tree.lever)])
    }

    /// Tension of the rod, N: its spring's, or what holds the passive joints.
    fn rod_force(&self) -> Option<f64> {
        let closure = self.statics.closure()?;
        let rod = closure.lever - self.crank_end();
        Some(-closure.reaction.dot(&rod) / rod.norm())
    }
}

/// The rapier side of a tree, and that of its parts where they confirm poses.
fn worlds(tree: &Tree, robot: &AsBuilt, options: &SettleOptions) -> (Chain, Option<Confirmation>) {
    let gravity = &robot.statics.gravity;
    let confirmation = options.confirm.then(|| Confirmation::new(tree, gravity, options.dt));
    (Chain::new(tree, gravity, options.dt), confirmation.flatten())
}

/// Joint variables at which every telescope is out of its housing, to build the tree before the first command.
fn extended(robot: &AsBuilt) -> Vec<f64> {
    let housed = |segment: &BeamSegment| match segment.length {
        SegmentLength::Constant(_) => 0.0,
        SegmentLength::Extension(housed) => housed,
    };
    let beams = robot.statics.beams.iter();
    beams
        .map(|beam| beam.iter().flat_map(|beam| &beam.segments).map(housed).fold(0.0, f64::max) + 1.0)
        .collect()
}

fn shift(by: &[f64; 6]) -> Transform {
    let [x, y, z, rx, ry, rz] = *by;
    translation(x, y, z) * rotation_x(rx) * rotation_y(ry) * rotation_z(rz)
}
