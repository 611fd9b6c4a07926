//! The pose of a chain at given deflections.

use nalgebra::Vector3;

use super::loads::{Load, Loads};
use super::structure::{ElasticLink, Segment, SpringGroup};
use super::{ElasticChain, ElasticError};
use crate::elastostatics::beam::segment_group;
use crate::kinematics::{MovingFrame, Screw, finite, stepped, swing_to};
use calibrig_model::{BeamRun, BeamSegment, BearingSide, Compliance, ModelError, ParameterId, TermPlace};

/// The axes of the corrections of a link's frame, and of its body, in the base frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct LinkPlace {
    /// Components of the frame's correction.
    pub correction: [Screw; 6],
    /// The axes that the body's centre of mass is told in.
    pub body: [Vector3<f64>; 3],
}

impl Default for LinkPlace {
    fn default() -> Self {
        Self { correction: [Screw::NONE; 6], body: [Vector3::zeros(); 3] }
    }
}

/// The four-bar at a pose, in the base frame.
#[derive(Debug, Clone)]
pub(super) struct LoopPlace {
    /// Of the elbow's joint, rad.
    pub angle: f64,
    /// Of the rod, m.
    pub extension: f64,
    pub crank_end: Vector3<f64>,
    pub lever_end: Vector3<f64>,
    /// Directions in which crank and lever grow.
    pub crank_growth: Vector3<f64>,
    /// Along x, along y, about x, about y of the crank's axis.
    pub axis: [Screw; 4],
    pub lever_growth: Vector3<f64>,
    /// Unit vector from the crank's end to the lever's, and their distance, m.
    pub rod: Vector3<f64>,
    pub length: f64,
    /// Change of that distance per unit of the elbow's angle, m/rad.
    pub rate: f64,
    /// Tension of the rod, N.
    pub force: f64,
    /// Weight of crank and half of the rod.
    pub crank_weight: Loads,
}

impl Default for LoopPlace {
    fn default() -> Self {
        let zero = Vector3::zeros();
        Self {
            angle: 0.0,
            extension: 0.0,
            crank_end: zero,
            lever_end: zero,
            crank_growth: zero,
            axis: [Screw::NONE; 4],
            lever_growth: zero,
            rod: zero,
            length: 0.0,
            rate: 0.0,
            force: 0.0,
            crank_weight: Loads::none(),
        }
    }
}

/// Lets the frame go through a group at `point` of the frame.
fn through(
    frame: &mut MovingFrame,
    group: &SpringGroup,
    point: &Vector3<f64>,
    u: &[f64],
    screws: &mut [Screw],
) {
    if group.components.is_empty() {
        return;
    }
    frame.origin = frame.point(point);
    for (slot, component) in group.slots().zip(&group.components) {
        screws[slot] = frame.step(*component, u[slot]);
    }
    frame.origin -= frame.turned(point);
}

/// A point behind a group as seen from in front of it.
fn in_front(point: &mut Vector3<f64>, group: &SpringGroup, at: &Vector3<f64>, u: &[f64]) {
    *point -= at;
    for (slot, component) in group.slots().zip(&group.components).rev() {
        stepped(*component, u[slot], point);
    }
    *point += at;
}

impl Segment {
    /// Takes one of the segment's lumped masses, at a point, as a load.
    fn weigh(&self, index: usize, point: &Vector3<f64>, load: &mut Load) {
        let [now, reference] = [&self.springs, &self.reference_springs].map(|s| s.lumps[index].mass);
        (load.scale, load.arm) = (now, now * point);
        load.reference = (reference, reference * point);
    }
}

impl ElasticLink {
    /// The point at `from_root` along the undeflected beam, in the link's frame, m.
    pub(super) fn on_beam(&self, from_root: f64) -> Vector3<f64> {
        match self.run {
            BeamRun::AlongX => Vector3::new(from_root, 0.0, 0.0),
            BeamRun::EndsAtOrigin => Vector3::new(0.0, 0.0, from_root - self.length),
        }
    }

    fn bearing_point(&self) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, self.bearing_at)
    }

    /// Sets the lengths of the segments at a joint variable, and the compliances and weights that follow from them.
    fn extend(&mut self, variable: f64, compliance: &mut [f64], reference: &mut [f64]) -> Result<(), f64> {
        self.length = 0.0;
        for segment in &mut self.segments {
            let length = segment.now.length.at(variable);
            if !(length > 0.0) {
                return Err(length);
            }
            let springs = |of: &BeamSegment| segment_group(of, length, self.length, self.run.axes());
            segment.springs = springs(&segment.now);
            segment.reference_springs = springs(&segment.reference);
            for (slot, component) in segment.group.slots().zip(&segment.group.components) {
                compliance[slot] = 1.0 / segment.springs.stiffness[*component];
                reference[slot] = 1.0 / segment.reference_springs.stiffness[*component];
            }
            self.length += length;
        }
        let (mut rigid, mut reference_rigid) = (self.body, self.reference_body);
        for segment in &self.segments {
            for (rest, springs) in
                [(&mut rigid, &segment.springs), (&mut reference_rigid, &segment.reference_springs)]
            {
                for lump in &springs.lumps {
                    rest.0 -= lump.mass;
                    rest.1 -= lump.mass * self.on_beam(lump.from_root);
                }
            }
        }
        (self.rigid, self.reference_rigid) = (rigid, reference_rigid);
        Ok(())
    }

    /// A point that the link carries, as seen from behind the joint's motion.
    fn behind_motion(&self, mut point: Vector3<f64>, u: &[f64]) -> Vector3<f64> {
        for segment in self.segments.iter().rev() {
            in_front(&mut point, &segment.group, &self.on_beam(segment.springs.centre), u);
        }
        if self.side == BearingSide::Moving {
            in_front(&mut point, &self.bearing, &self.bearing_point(), u);
        }
        for component in (0..6).rev() {
            stepped(component, self.correction[component], &mut point);
        }
        point
    }

    /// Places what is behind the joint's motion: correction, bearing, body, beam.
    fn place_moving(
        &self,
        frame: &mut MovingFrame,
        place: &mut LinkPlace,
        u: &[f64],
        screws: &mut [Screw],
        loads: &mut [Load],
    ) {
        for (component, (screw, by)) in place.correction.iter_mut().zip(self.correction).enumerate() {
            *screw = if by == 0.0 { frame.screw(component) } else { frame.step(component, by) };
        }
        // Rotations are about the place behind all translations.
        for screw in &mut place.correction[3..] {
            screw.origin = frame.origin;
        }
        if self.side == BearingSide::Moving {
            through(frame, &self.bearing, &self.bearing_point(), u, screws);
        }
        place.body = frame.axes;
        let in_base =
            |(mass, moment): (f64, Vector3<f64>)| (mass, mass * frame.origin + frame.turned(&moment));
        let rigid = &mut loads[self.first_load];
        (rigid.scale, rigid.arm) = in_base(self.rigid);
        rigid.reference = in_base(self.reference_rigid);
        for (index, segment) in self.segments.iter().enumerate() {
            let first = self.first_load + 1 + 2 * index;
            segment.weigh(
                0,
                &frame.point(&self.on_beam(segment.springs.lumps[0].from_root)),
                &mut loads[first],
            );
            through(frame, &segment.group, &self.on_beam(segment.springs.centre), u, screws);
            segment.weigh(
                1,
                &frame.point(&self.on_beam(segment.springs.lumps[1].from_root)),
                &mut loads[first + 1],
            );
        }
        for (load, at) in &self.point_loads {
            loads[*load].arm = frame.point(at);
        }
    }
}

impl ElasticChain {
    /// Takes a command with its corrections, and what does not depend on deflections.
    pub(super) fn start(
        &mut self,
        command: &[f64],
        corrections: &[(TermPlace, f64)],
    ) -> Result<(), ElasticError> {
        self.actuators.joints_from_command(command, &mut self.joints);
        for (index, link) in self.links.iter_mut().enumerate() {
            link.correction = [0.0; 6];
            link.extend(self.joints[index], &mut self.compliance, &mut self.reference)
                .map_err(|length| ElasticError::Housed { link: index, length })?;
        }
        self.command.copy_from_slice(command);
        for (place, value) in corrections {
            match *place {
                TermPlace::Actuator(joint) => self.command[joint] += value,
                TermPlace::Frame { joint, component } => self.links[joint].correction[component] += value,
            }
        }
        self.actuators.actuators_from_command(&self.command, &mut self.positions);
        self.actuators.joints_from_command(&self.command, &mut self.joints);
        Ok(())
    }

    /// Whether command and corrections are of this chain, and finite numbers.
    pub(super) fn check(&self, command: &[f64], corrections: &[(TermPlace, f64)]) -> Result<(), ModelError> {
        let joints = self.links.len();
        if command.len() != joints {
            return Err(ModelError::Length { field: "command", found: command.len(), expected: joints });
        }
        (0..).zip(command).try_for_each(|(joint, value)| finite("command", Some(joint), &[*value]))?;
        corrections.iter().try_for_each(|(place, value)| {
            self.has(*place)?;
            finite("a correction", None, &[*value])
        })
    }

    /// Whether a correction is of this chain.
    pub(super) fn has(&self, place: TermPlace) -> Result<(), ModelError> {
        let (joint, component) = match place {
            TermPlace::Actuator(joint) => (joint, 0),
            TermPlace::Frame { joint, component } => (joint, component),
        };
        let joints = self.links.len();
        if joint >= joints {
            return Err(ModelError::Joint { field: "a correction", joint, joints });
        }
        if component >= 6 {
            return Err(ModelError::Structure { field: "the component of a correction" });
        }
        Ok(())
    }

    /// Whether a parameter is of this chain.
    pub(super) fn knows(&self, id: ParameterId) -> Result<(), ModelError> {
        let joints = self.links.len();
        let known = match id {
            ParameterId::Link { link, .. }
            | ParameterId::Mass { link }
            | ParameterId::Compliance(Compliance::Beam { link }) => link < joints,
            ParameterId::Compliance(Compliance::Drive { joint }) => joint < joints,
            ParameterId::Compliance(Compliance::Bearing { joint, axis }) => joint < joints && axis < 6,
            ParameterId::Target { axis, .. } | ParameterId::Orientation { axis, .. } => axis < 3,
            ParameterId::Centre { link, axis } => link < joints && axis < 3,
            ParameterId::Compliance(Compliance::Rod)
            | ParameterId::Frame { .. }
            | ParameterId::Linkage(_)
            | ParameterId::Term(_)
            | ParameterId::Instrument { .. }
            | ParameterId::Drift { .. } => true,
        };
        if known { Ok(()) } else { Err(ModelError::Parameter { id }) }
    }

    /// Places the chain at its deflections and closes the four-bar.
    pub(super) fn place(&mut self) -> Result<(), ElasticError> {
        let mut frame = self.kinematics.start();
        for index in 0..self.links.len() {
            self.kinematics.pass_fixed_part(index, &mut frame);
            let link = &self.links[index];
            if link.side == BearingSide::Fixed {
                through(&mut frame, &link.bearing, &link.bearing_point(), &self.u, &mut self.screws);
            }
            let mut variable = self.joints[index] + self.u[link.drive];
            if let Some(four_bar) = &self.four_bar {
                if four_bar.shoulder == index {
                    self.place_crank(frame);
                } else if four_bar.elbow == index {
                    variable = self.close(&frame)?;
                }
            }
            let link = &self.links[index];
            self.screws[link.drive] = frame.step(self.kinematics.joint_component(index), variable);
            let (place, screws, loads) = (&mut self.places[index], &mut self.screws, &mut self.loads);
            link.place_moving(&mut frame, place, &self.u, screws, loads);
            if let Some(four_bar) = &self.four_bar
                && four_bar.elbow == index
            {
                self.closed.lever_growth = frame.turned(&growth(four_bar.four_bar.lever.angle));
                self.loads[four_bar.lever_load].arm = self.closed.lever_end;
            }
            self.frames[index] = frame.transform();
        }
        self.kinematics.end(&frame);
        let carried_at = self.kinematics.target(&self.payload.centre);
        if let Some(load) = self.loads.last_mut() {
            load.scale = 1.0;
            load.direction = self.payload.mass * self.gravity + self.payload.force;
            load.arm = carried_at;
        }
        Ok(())
    }

    /// Places the crank, in the frame in front of the shoulder's motion.
    fn place_crank(&mut self, mut frame: MovingFrame) {
        let Some(four_bar) = &self.four_bar else { return };
        let psi = self.positions[four_bar.elbow] + four_bar.offset;
        let axis = four_bar.four_bar.axis;
        self.closed.axis = [(0, axis.x), (1, axis.y), (3, axis.rx), (4, axis.ry)]
            .map(|(component, by)| frame.step(component, by));
        self.screws[four_bar.crank] = frame.step(5, psi + self.u[four_bar.crank]);
        let arm = &four_bar.four_bar.crank;
        let closed = &mut self.closed;
        closed.crank_end = frame.point(&arm.end());
        closed.crank_growth = frame.turned(&growth(arm.angle));
        let half_rod = 0.5 * four_bar.rod_mass;
        let (mass, moment) = four_bar.crank_body;
        let arm = mass * frame.origin + frame.turned(&moment) + half_rod * closed.crank_end;
        closed.crank_weight =
            Loads { force: (mass + half_rod) * self.gravity, moment: arm * self.gravity.transpose() };
    }

    /// The elbow's angle with which the rod fits; `frame` is in front of the elbow's motion.
    fn close(&mut self, frame: &MovingFrame) -> Result<f64, ElasticError> {
        let Some(four_bar) = &self.four_bar else { return Ok(0.0) };
        let lengths = &four_bar.four_bar;
        let end = self.links[four_bar.elbow].behind_motion(lengths.lever.end(), &self.u);
        let closed = &mut self.closed;
        let rod = lengths.rod + closed.extension;
        let ideal = self.joints[four_bar.elbow];
        let closure = swing_to(&frame.transform(), &end, &closed.crank_end, rod, ideal)?;
        closed.angle = closure.angle;
        closed.lever_end = closure.end;
        closed.rod = closure.rod_direction;
        closed.length = rod;
        closed.rate = closure.rate;
        Ok(closure.angle)
    }
}

/// The direction in which an arm at `angle` about z grows.
fn growth(angle: f64) -> Vector3<f64> {
    let (sin, cos) = angle.sin_cos();
    Vector3::new(cos, sin, 0.0)
}
