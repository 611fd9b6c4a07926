//! How the target moves with what the controller commands.
//!
//! A command displaces its actuator as a correction does, and beside that it changes the lengths of telescopes: where their springs and weights sit,
//! and how soft and heavy they are.

use nalgebra::Vector3;

use super::ElasticChain;
use super::structure::Segment;
use crate::kinematics::{MovingFrame, Screw};
use calibrig_model::{BeamRun, BeamSegment, ModelError, SegmentLength, TermPlace};

impl ElasticChain {
    /// Change of what was [prepared](Self::prepare), the target's position in the base frame (m) or the flange's rotation (rad), per unit of an
    /// actuator's command, the change of the equilibrium included.
    ///
    /// # Errors
    ///
    /// [`ModelError`], of an actuator that the robot does not have.
    pub fn column_of_command(&self, actuator: usize) -> Result<Vector3<f64>, ModelError> {
        self.has(TermPlace::Actuator(actuator))?;
        Ok(self.change_by_command(actuator))
    }

    /// [`column_of_command`](Self::column_of_command) of an actuator of the robot.
    pub(crate) fn change_by_command(&self, actuator: usize) -> Vector3<f64> {
        let mut column = self.change_of_place(TermPlace::Actuator(actuator));
        for (index, link) in self.links.iter().enumerate() {
            let rate = self.actuators.rate(index, actuator);
            let extends = |segment: &Segment| matches!(segment.now.length, SegmentLength::Extension(_));
            if rate != 0.0 && link.segments.iter().any(extends) {
                column += rate * self.change_by_length(index);
            }
        }
        column
    }

    /// Change per unit of the joint variable that a link's beam takes its length from.
    fn change_by_length(&self, index: usize) -> Vector3<f64> {
        let a = &self.adjoint;
        let link = &self.links[index];
        let growth = |segment: &Segment| {
            f64::from(u8::from(matches!(segment.now.length, SegmentLength::Extension(_))))
        };
        let all: f64 = link.segments.iter().map(growth).sum();
        let shifts = |from_root: f64| match link.run {
            BeamRun::AlongX => Vector3::new(from_root, 0.0, 0.0),
            BeamRun::EndsAtOrigin => Vector3::new(0.0, 0.0, from_root - all),
        };
        let weighs = |load: usize, mass: f64, moment: Vector3<f64>| {
            let inboard = &a.inboard[self.loads[load].inboard];
            inboard.turns * moment.cross(&self.gravity) + inboard.shifts * (mass * self.gravity)
        };
        let frames = self.frames_of_beam(index);
        let mut column = Vector3::zeros();
        // What the body loses to its beam.
        let (mut rest, mut rest_moment) = (0.0, Vector3::zeros());
        let mut root = 0.0;
        for (index, (segment, [before, behind])) in link.segments.iter().zip(&frames).enumerate() {
            let grows = growth(segment);
            for (number, (lump, frame)) in segment.springs.lumps.iter().zip([before, behind]).enumerate() {
                let mass = 0.5 * segment.now.section.mass_per_length * grows;
                let shift = lump.mass * shifts(root + grows * [1.0 / 6.0, 5.0 / 6.0][number]);
                let point = link.on_beam(lump.from_root);
                rest -= mass;
                rest_moment -= mass * point + shift;
                let moment = mass * frame.point(&point) + frame.turned(&shift);
                column += weighs(link.first_load + 1 + 2 * index + number, mass, moment);
            }
            column += self.change_by_shift(segment, &shifts(root + 0.5 * grows), [before, behind]);
            for (slot, component) in segment.group.slots().zip(&segment.group.components) {
                let softer = grows * softening(&segment.now, segment.springs.length(), *component, link.run);
                column += a.mu[slot] * (self.forces[slot] * softer);
            }
            root += grows;
        }
        if let Some([first, _]) = frames.first() {
            let moment = rest * first.origin + first.turned(&rest_moment);
            column += weighs(link.first_load, rest, moment);
        }
        if a.coupled { column } else { Vector3::zeros() }
    }

    /// What a shift of a segment's springs in the link's frame does: all that is behind them turns about another place.
    fn change_by_shift(
        &self,
        segment: &Segment,
        shift: &Vector3<f64>,
        frames: [&MovingFrame; 2],
    ) -> Vector3<f64> {
        let (a, slots) = (&self.adjoint, segment.group.slots());
        if slots.is_empty() {
            return Vector3::zeros();
        }
        let moved = |frame: &MovingFrame, inboard: usize, slot: usize| {
            let screw = Screw { about: false, axis: frame.turned(shift), origin: frame.origin };
            a.seen.moved_by(&screw) + a.inboard[inboard].turns * a.outboard[slot].turned_by(&screw)
        };
        let [before, behind] = frames;
        moved(before, slots.start, slots.start) - moved(behind, slots.end, slots.end - 1)
    }

    /// The link's frame in front of every segment's springs, and behind them.
    fn frames_of_beam(&self, index: usize) -> Vec<[MovingFrame; 2]> {
        let link = &self.links[index];
        let mut frame = MovingFrame::from(&self.frames[index]);
        let mut frames: Vec<[MovingFrame; 2]> = Vec::with_capacity(link.segments.len());
        for segment in link.segments.iter().rev() {
            let (behind, at) = (frame, link.on_beam(segment.springs.centre));
            frame.origin = frame.point(&at);
            for (slot, component) in segment.group.slots().zip(&segment.group.components).rev() {
                frame.step(*component, -self.u[slot]);
            }
            frame.origin -= frame.turned(&at);
            frames.push([frame, behind]);
        }
        frames.reverse();
        frames
    }
}

/// Change of a compliance of a segment per metre of its length.
fn softening(segment: &BeamSegment, length: f64, component: usize, run: BeamRun) -> f64 {
    let section = &segment.section;
    let transverse = |shear: f64, bending: f64| 1.0 / shear + length * length / (4.0 * bending);
    let along = [
        1.0 / section.axial,
        transverse(section.shear[0], section.bending[1]),
        transverse(section.shear[1], section.bending[0]),
    ];
    let about = [1.0 / section.torsion, 1.0 / section.bending[0], 1.0 / section.bending[1]];
    let own = run.axes().iter().position(|axis| *axis == component % 3).unwrap_or(0);
    if component < 3 { along[own] } else { about[own] }
}
