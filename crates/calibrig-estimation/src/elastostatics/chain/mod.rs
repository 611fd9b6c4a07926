//! The robot as a chain of elementary screw motions with springs and loads: where it rests, and how the target moves with every
//! parameter.
//!
//! Link parameters, joints, springs and corrections are all elementary translations or rotations `j` with an axis; a load F at a point c
//! outboard of one exerts the generalised force `Q_j = F · J_j c`. The chain rests where
//!
//! ```text
//! u_k = c_k Q_k(u)                      for every spring
//! Q_elbow = f ∂l/∂q_elbow               for the free elbow of a four-bar, with f the force of its rod
//! l = rod + c_rod f                     with l the distance of crank's and lever's ends
//! ```
//!
//! with compliances c = 1/k, so that a rigid spring is nothing special. The mixed derivative of the loads' potential with respect to an
//! inboard rotation i and an outboard motion o is `a_i · Σ (J_o c) × F`, and zero for an inboard translation: all products with the matrix of
//! second derivatives, and the sensitivity to every parameter, follow from sums along the chain in a time proportional to its length.

mod adjoint;
mod balance;
mod command;
mod loads;
mod newton;
mod place;
mod structure;
#[cfg(test)]
mod tests;

use nalgebra::Vector3;
use thiserror::Error;

use self::adjoint::Adjoint;
use self::loads::Load;
use self::place::{LinkPlace, LoopPlace};
use self::structure::{ElasticLink, ElbowLoop, Slot, Structure, body_of};
use crate::kinematics::{ClosureError, KinematicChain, Screw, finite};
use calibrig_model::geometry::Transform;
use calibrig_model::{
    ActuatorMap, CalibrationModel, ModelError, Payload, PayloadError, PointLoad, StaticProperties, TermPlace,
};

/// How much of the statics a pose is settled with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deflection {
    /// The chain is rigid.
    None,
    /// Every spring yields under the loads of the undeflected pose; the error is of second order (8-45 µm at the tool for a droop of 10 mm).
    FirstOrder,
    /// The nonlinear equilibrium.
    Equilibrium,
}

/// How well a pose settled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settled {
    /// Evaluations of the loads.
    pub iterations: usize,
    /// Largest difference between a deflection and compliance times load, m or rad; zero where the chain is rigid.
    pub residual: f64,
}

/// Why a chain has no pose at rest.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ElasticError {
    /// The iteration does not converge: the chain is unstable or far too soft.
    #[error(
        "the robot does not come to rest: after {iterations} iterations deflections still change by {residual:.1e} m or rad"
    )]
    NotSettled {
        /// Iterations done.
        iterations: usize,
        /// The last change, m or rad.
        residual: f64,
    },
    /// The elbow's four-bar cannot close, or hardly so.
    #[error(transparent)]
    Linkage(#[from] ClosureError),
    /// A command or a correction that is not of this robot.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A load at the flange that cannot be.
    #[error(transparent)]
    Payload(#[from] PayloadError),
    /// Deflections of another chain.
    #[error("deflections has {found} entries: expected {expected}, one per spring of the chain")]
    Deflections {
        /// Their number.
        found: usize,
        /// The number of springs, without those of a four-bar.
        expected: usize,
    },
    /// A telescope is drawn in farther than its beam begins.
    #[error("the exposed length of link {} would be {length:.6} m", link.saturating_add(1))]
    Housed {
        /// Index of the link.
        link: usize,
        /// m
        length: f64,
    },
}

/// Deflections that change by less than this in an iteration have converged, m or rad.
const CONVERGED: f64 = 1e-13;
/// Iterations before giving up. A robot contracts by a factor of about 100 in each.
const MOST_ITERATIONS: usize = 100;
/// A chain that contracts by less is too soft for the iteration, m or rad beyond [`ROUNDED`] ...
const SLOW: f64 = 0.5;
/// ... below which the digits run out.
const ROUNDED: f64 = 1e-9;

/// A payload as the chain needs it; nothing by default.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Carried {
    mass: f64,
    /// In the flange frame, m.
    centre: Vector3<f64>,
    force: Vector3<f64>,
}

impl Carried {
    /// Of one that has been checked.
    pub fn of(payload: Option<&Payload>) -> Self {
        payload.map_or_else(Self::default, |p| Self { mass: p.mass, centre: p.centre, force: p.force })
    }
}

/// The robot as a chain of elementary screw motions with springs and loads.
///
/// It is made once, given values by [`set_model`](Self::set_model), settled at a command, and then asked for the target, and after
/// [`prepare`](Self::prepare) for the columns of the Jacobian. After it is made, no memory is taken but where a load hangs on springs so
/// soft that successive substitution does not settle it.
#[derive(Debug, Clone)]
pub struct ElasticChain {
    /// The same without springs and loads: constants of the links, and at the pose their axes and the flange.
    kinematics: KinematicChain,
    links: Vec<ElasticLink>,
    slots: Vec<Slot>,
    /// Those of the robot, and at the end that of the payload.
    loads: Vec<Load>,
    four_bar: Option<ElbowLoop>,
    /// Whether the reference model says what its parts weigh and how they yield.
    has_statics: bool,
    actuators: ActuatorMap,
    gravity: Vector3<f64>,
    payload: Carried,
    /// Of every slot: m/N or rad/(N m), and those of the reference model.
    compliance: Vec<f64>,
    reference: Vec<f64>,

    /// Commands with corrections, and the joint variables that they set without loads.
    command: Vec<f64>,
    /// Where they take the actuators, in the sense of their joints.
    positions: Vec<f64>,
    joints: Vec<f64>,
    /// Deflection of every slot.
    u: Vec<f64>,
    screws: Vec<Screw>,
    places: Vec<LinkPlace>,
    frames: Vec<Transform>,
    closed: LoopPlace,
    /// Generalised force on every slot.
    forces: Vec<f64>,
    deflection: Deflection,
    deflections: Vec<f64>,
    adjoint: Adjoint,
}

impl ElasticChain {
    /// The chain of `reference`, whose finite stiffnesses say which springs exist, and whose compliances and masses are those that
    /// [`Compliance`](calibrig_model::ParameterId::Compliance) and [`Mass`](calibrig_model::ParameterId::Mass) are relative to.
    ///
    /// # Errors
    ///
    /// [`ModelError`], where the robot's model is not valid.
    pub fn new(reference: &CalibrationModel) -> Result<Self, ModelError> {
        reference.check()?;
        Ok(Self::of(reference))
    }

    /// The chain of a model that has been checked.
    pub(crate) fn of(reference: &CalibrationModel) -> Self {
        let Structure { links, slots, loads, four_bar } = Structure::new(reference);
        let (n, joints) = (slots.len(), links.len());
        let elastic = slots.iter().filter(|s| **s == Slot::Elastic).count();
        let with_four_bar = if four_bar.is_some() { 2 } else { 0 };
        let mut chain = Self {
            adjoint: Adjoint::new(n),
            places: vec![LinkPlace::default(); joints],
            frames: vec![Transform::identity(); joints],
            command: vec![0.0; joints],
            positions: vec![0.0; joints],
            joints: vec![0.0; joints],
            compliance: vec![0.0; n],
            reference: vec![0.0; n],
            u: vec![0.0; n],
            forces: vec![0.0; n],
            screws: vec![Screw::NONE; n],
            deflections: vec![0.0; elastic + with_four_bar],
            closed: LoopPlace::default(),
            gravity: Vector3::zeros(),
            payload: Carried::default(),
            has_statics: reference.statics.is_some(),
            actuators: reference.actuators.clone(),
            deflection: Deflection::None,
            kinematics: KinematicChain::new(&reference.kinematics),
            links,
            slots,
            loads,
            four_bar,
        };
        chain.take(reference);
        chain.reference.copy_from_slice(&chain.compliance);
        chain
    }

    /// Takes the values of a model of the same structure. A spring that is missing in the reference model stays rigid.
    ///
    /// # Errors
    ///
    /// [`ModelError`], where the robot's model is not valid, or is not built as the reference model.
    pub fn set_model(&mut self, model: &CalibrationModel) -> Result<(), ModelError> {
        model.check()?;
        self.fits(model)?;
        self.take(model);
        Ok(())
    }

    /// Whether a model, which has been checked, is built as the reference model.
    pub(crate) fn fits(&self, model: &CalibrationModel) -> Result<(), ModelError> {
        let same = |same: bool, field: &'static str| {
            if same { Ok(()) } else { Err(ModelError::Structure { field }) }
        };
        let links = &model.kinematics.links;
        same(links.len() == self.links.len(), "the number of links")?;
        same(self.kinematics.has_kinds(links.iter().map(|link| link.kind)), "the kinds of joints")?;
        let ends = |map: &ActuatorMap| map.four_bar().map(|(shoulder, elbow, _, _)| (shoulder, elbow));
        same(ends(&model.actuators) == ends(&self.actuators), "the four-bar of actuators")?;
        let statics = model.statics.as_ref();
        same(statics.is_some() == self.has_statics, "statics")?;
        (0..).zip(&self.links).try_for_each(|(index, link)| {
            let segments =
                statics.and_then(|s| s.beams[index].as_ref()).map_or(0, |beam| beam.segments.len());
            same(segments == link.segments.len(), "the segments of statics.beams")?;
            let loads = statics.map_or(0, |s| s.loads.iter().filter(|load| load.link == index).count());
            same(loads == link.point_loads.len(), "the places of statics.loads")
        })
    }

    /// [`set_model`](Self::set_model) without looking.
    pub(crate) fn take(&mut self, model: &CalibrationModel) {
        let statics = model.statics.as_ref();
        self.kinematics.set_model(&model.kinematics);
        self.gravity = statics.map_or_else(Vector3::zeros, |s| s.gravity);
        self.actuators.clone_from(&model.actuators);
        if let Some(statics) = statics {
            self.take_statics(statics);
        }
        if let (Some(four_bar), Some((_, elbow, offset, lengths))) =
            (&mut self.four_bar, model.actuators.four_bar())
        {
            four_bar.set(lengths, offset + model.kinematics.links[elbow].theta, statics);
            // The drive turns the crank; the elbow is free.
            let free = self.links[elbow].drive;
            self.compliance[four_bar.crank] = self.compliance[free];
            self.compliance[free] = 0.0;
        }
        self.set_loads(statics.map_or(&[], |s| &s.loads));
    }

    fn take_statics(&mut self, statics: &StaticProperties) {
        for (index, link) in self.links.iter_mut().enumerate() {
            link.body = body_of(Some(statics), index);
            // A change of the mass acts where the centre is now.
            link.reference_body.1 = link.reference_body.0 * statics.bodies[index].centre_of_mass;
            link.bearing_at = statics.bearings[index].at;
            self.compliance[link.drive] = 1.0 / statics.drive_stiffness[index];
            for (slot, component) in link.bearing.slots().zip(&link.bearing.components) {
                self.compliance[slot] = 1.0 / statics.bearings[index].stiffness[*component];
            }
            if let Some(beam) = &statics.beams[index] {
                for (segment, now) in link.segments.iter_mut().zip(&beam.segments) {
                    segment.now = *now;
                }
            }
        }
    }

    fn set_loads(&mut self, point_loads: &[PointLoad]) {
        for (index, link) in self.links.iter_mut().enumerate() {
            for load in link.body_loads() {
                self.loads[load].direction = self.gravity;
            }
            let of_link = point_loads.iter().filter(|l| l.link == index);
            for ((load, at), now) in link.point_loads.iter_mut().zip(of_link) {
                *at = now.at;
                self.loads[*load].scale = 1.0;
                self.loads[*load].direction = now.mass * self.gravity + now.force;
            }
        }
    }

    /// Hangs a load on the flange, or takes it off, for all poses that are settled from now on.
    ///
    /// # Errors
    ///
    /// [`PayloadError`], of one that cannot be.
    pub fn set_payload(&mut self, payload: Option<&Payload>) -> Result<(), PayloadError> {
        payload.map_or(Ok(()), Payload::check)?;
        self.carry(Carried::of(payload));
        Ok(())
    }

    /// [`set_payload`](Self::set_payload) of one that has been checked.
    pub(crate) fn carry(&mut self, payload: Carried) {
        self.payload = payload;
    }

    /// Brings the chain to rest at a command (one number an actuator).
    ///
    /// Corrections are fixed displacements: of an actuator they are added to its commanded coordinate; of a link's frame they act behind the
    /// joint's motion, in front of a bearing on the moving side, as a group at (0, 0, 0). Those of one place add up. Lengths of
    /// telescopes follow the command without corrections. The result does not depend on what was settled before, but on the
    /// [payload](Self::set_payload).
    ///
    /// # Errors
    ///
    /// [`ElasticError`]; the chain is then at no pose that means anything.
    pub fn settle(
        &mut self,
        command: &[f64],
        corrections: &[(TermPlace, f64)],
        deflection: Deflection,
    ) -> Result<Settled, ElasticError> {
        self.check(command, corrections)?;
        self.rest(command, corrections, deflection)
    }

    /// [`settle`](Self::settle) for a command and corrections that are known to be of this chain.
    pub(crate) fn rest(
        &mut self,
        command: &[f64],
        corrections: &[(TermPlace, f64)],
        deflection: Deflection,
    ) -> Result<Settled, ElasticError> {
        self.start(command, corrections)?;
        self.deflection = deflection;
        self.u.fill(0.0);
        self.closed.extension = 0.0;
        self.place()?;
        let rigid_elbow = self.closed.angle;
        let settled = match deflection {
            Deflection::None => Settled { iterations: 0, residual: 0.0 },
            Deflection::FirstOrder => {
                self.balance();
                self.yield_to_loads();
                self.place()?;
                self.balance();
                Settled { iterations: 1, residual: self.residual() }
            }
            Deflection::Equilibrium => self.iterate()?,
        };
        self.tell_deflections(rigid_elbow);
        Ok(settled)
    }

    fn iterate(&mut self) -> Result<Settled, ElasticError> {
        let mut residual = f64::INFINITY;
        for iterations in 1..=MOST_ITERATIONS {
            self.balance();
            let before = std::mem::replace(&mut residual, self.residual());
            if residual <= CONVERGED {
                return Ok(Settled { iterations, residual });
            }
            let contracts = residual <= SLOW * before || residual <= ROUNDED;
            if !contracts {
                return self.descend();
            }
            self.yield_to_loads();
            if let Err(error) = self.place() {
                return self.descend().map_err(|_| error);
            }
        }
        Err(ElasticError::NotSettled { iterations: MOST_ITERATIONS, residual })
    }

    /// Places the chain at given [deflections](Self::deflections) that loads do not change, such as those predicted for another model. Columns are
    /// then those of the frozen chain.
    ///
    /// The chain may have another map of its elbow than the one that predicted them: with a four-bar, deflections of its crank and rod
    /// close it anew; without, the elbow's own entry is taken.
    ///
    /// # Errors
    ///
    /// [`ElasticError`], also for deflections that are not one finite number a spring.
    pub fn settle_at(
        &mut self,
        command: &[f64],
        corrections: &[(TermPlace, f64)],
        deflections: &[f64],
    ) -> Result<(), ElasticError> {
        self.check(command, corrections)?;
        let expected = self.slots.iter().filter(|slot| **slot == Slot::Elastic).count();
        let found = deflections.len();
        if found != expected && found != expected + 2 {
            return Err(ElasticError::Deflections { found, expected });
        }
        finite("deflections", None, deflections)?;
        self.hold(command, corrections, deflections)
    }

    /// [`settle_at`](Self::settle_at) for what is known to be of this chain.
    pub(crate) fn hold(
        &mut self,
        command: &[f64],
        corrections: &[(TermPlace, f64)],
        deflections: &[f64],
    ) -> Result<(), ElasticError> {
        self.start(command, corrections)?;
        self.deflection = Deflection::None;
        self.u.fill(0.0);
        let elastic = (0..self.slots.len()).filter(|k| self.slots[*k] == Slot::Elastic);
        let mut given = deflections.iter();
        for (slot, value) in elastic.zip(&mut given) {
            self.u[slot] = *value;
        }
        let mut given = given.copied();
        let (crank, extension) = (given.next().unwrap_or(0.0), given.next().unwrap_or(0.0));
        if let Some(four_bar) = &self.four_bar {
            self.u[four_bar.crank] = crank;
            self.closed.extension = extension;
        }
        self.deflections.fill(0.0);
        let n = deflections.len().min(self.deflections.len());
        self.deflections[..n].copy_from_slice(&deflections[..n]);
        self.place()
    }

    /// Deflection of every spring, m or rad, in the order of the chain: for each joint those of a bearing on the fixed side, the
    /// drive's, those of a bearing on the moving side, those of its beam; then, with a four-bar, the crank's and the rod's extension. With a
    /// four-bar the elbow's own entry is how much loads change its joint angle.
    pub fn deflections(&self) -> &[f64] {
        &self.deflections
    }

    fn tell_deflections(&mut self, rigid_elbow: f64) {
        let elastic = (0..self.slots.len()).filter(|k| self.slots[*k] == Slot::Elastic);
        for (told, slot) in self.deflections.iter_mut().zip(elastic) {
            *told = self.u[slot];
            if self.four_bar.as_ref().is_some_and(|f| self.links[f.elbow].drive == slot) {
                *told = self.closed.angle - rigid_elbow;
            }
        }
        if let Some(four_bar) = &self.four_bar {
            let n = self.deflections.len();
            self.deflections[n - 2] = self.u[four_bar.crank];
            self.deflections[n - 1] = self.closed.extension;
        }
    }

    /// The slot of an actuator's drive.
    fn driven(&self, joint: usize) -> usize {
        match &self.four_bar {
            Some(four_bar) if four_bar.elbow == joint => four_bar.crank,
            _ => self.links[joint].drive,
        }
    }

    /// Deflection of a joint's drive, m or rad; with a four-bar, the elbow's drive is the crank's. `None` for a joint that is not there.
    pub fn drive_deflection(&self, joint: usize) -> Option<f64> {
        (joint < self.links.len()).then(|| self.u[self.driven(joint)])
    }

    /// `base_from_flange`.
    pub fn base_from_flange(&self) -> &Transform {
        self.kinematics.base_from_flange()
    }

    /// `base_from_link` of every link, behind all that yields in it.
    pub fn link_frames(&self) -> &[Transform] {
        &self.frames
    }

    /// Ends of the four-bar's crank and lever in the base frame, m.
    pub fn rod_ends(&self) -> Option<[Vector3<f64>; 2]> {
        self.four_bar.as_ref().map(|_| [self.closed.crank_end, self.closed.lever_end])
    }

    /// Position in the base frame of a target at `in_flange`, m.
    pub fn target(&self, in_flange: &Vector3<f64>) -> Vector3<f64> {
        self.kinematics.target(in_flange)
    }
}
