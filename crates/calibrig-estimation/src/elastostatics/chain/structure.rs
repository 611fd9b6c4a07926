//! What a chain is made of, the same in every pose.

use std::ops::Range;

use nalgebra::Vector3;

use super::loads::Load;
use crate::elastostatics::beam::{SegmentGroup, segment_group};
use crate::kinematics::joint_component;
use calibrig_model::{
    BeamRun, BeamSegment, BearingSide, CalibrationModel, FourBar, SixStiffness, StaticProperties,
};

/// A place in the order of the chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Slot {
    /// An elementary elastic coordinate of the open chain; also the free elbow of a four-bar.
    Elastic,
    /// The crank, which branches off.
    Crank,
    /// Where parameters move the chain; nothing yields here.
    Mark,
}

/// The elastic coordinates of one group: consecutive slots, and the component (0..3 along, 3..6 about) of each.
#[derive(Debug, Clone, Default)]
pub(super) struct SpringGroup {
    pub first: usize,
    pub components: Vec<usize>,
}

impl SpringGroup {
    /// The slot of a component, if it yields.
    pub fn slot(&self, component: usize) -> Option<usize> {
        self.components.iter().position(|c| *c == component).map(|i| self.first + i)
    }

    pub fn slots(&self) -> Range<usize> {
        self.first..self.first + self.components.len()
    }
}

/// One uniform piece of a flexible link.
#[derive(Debug, Clone)]
pub(super) struct Segment {
    pub group: SpringGroup,
    pub now: BeamSegment,
    pub reference: BeamSegment,
    /// Springs and lumped masses at the pose, and those of the reference model.
    pub springs: SegmentGroup,
    pub reference_springs: SegmentGroup,
}

/// One link with its joint.
#[derive(Debug, Clone)]
pub(super) struct ElasticLink {
    /// Slot in front of the joint, where the link's parameters act.
    pub terms: usize,
    pub side: BearingSide,
    pub bearing_at: f64,
    pub bearing: SpringGroup,
    /// Slot of the drive's deflection.
    pub drive: usize,
    /// Slot behind the joint's motion, where corrections of the frame act.
    pub frame: usize,
    /// Of the pose: along and about the frame's axes.
    pub correction: [f64; 6],
    pub run: BeamRun,
    pub segments: Vec<Segment>,
    /// Of the beam at the pose, m.
    pub length: f64,
    /// kg, and mass times centre of mass, kg m.
    pub body: (f64, Vector3<f64>),
    pub reference_body: (f64, Vector3<f64>),
    /// What the body has beside its beam, at the pose.
    pub rigid: (f64, Vector3<f64>),
    pub reference_rigid: (f64, Vector3<f64>),
    /// Index of the first of the body's loads: what is rigid, then two a segment.
    pub first_load: usize,
    /// Load and place in the link's frame of the point loads.
    pub point_loads: Vec<(usize, Vector3<f64>)>,
}

impl ElasticLink {
    /// The loads of the body.
    pub fn body_loads(&self) -> Range<usize> {
        self.first_load..self.first_load + 1 + 2 * self.segments.len()
    }

    pub fn beam_slots(&self) -> Range<usize> {
        match (self.segments.first(), self.segments.last()) {
            (Some(first), Some(last)) => first.group.first..last.group.slots().end,
            _ => 0..0,
        }
    }
}

/// Slots and loads of the elbow's four-bar, and its constants.
#[derive(Debug, Clone)]
pub(super) struct ElbowLoop {
    pub shoulder: usize,
    pub elbow: usize,
    /// Slot of the crank drive's deflection.
    pub crank: usize,
    /// Slots in front of this one move the lever's end.
    pub reach: usize,
    /// Index of the load at the lever's end.
    pub lever_load: usize,
    /// Index of the first load that the elbow moves.
    pub first_outboard: usize,
    pub four_bar: FourBar,
    /// Of the crank from psi: the map's offset and the elbow's theta, rad.
    pub offset: f64,
    /// m/N; and that of the reference.
    pub compliance: f64,
    pub reference_compliance: f64,
    pub rod_mass: f64,
    /// Mass and first moment of the crank in its frame.
    pub crank_body: (f64, Vector3<f64>),
}

/// The structure of a chain: everything whose number does not change with the parameters' values.
pub(super) struct Structure {
    pub links: Vec<ElasticLink>,
    pub slots: Vec<Slot>,
    pub loads: Vec<Load>,
    pub four_bar: Option<ElbowLoop>,
}

/// Which components of a group yield: those with a finite stiffness, without the joint's own axis.
fn yielding(stiffness: &SixStiffness, without: usize) -> Vec<usize> {
    (0..6).filter(|c| *c != without && stiffness[*c].is_finite()).collect()
}

impl Structure {
    /// Of the model that says which compliances exist.
    pub fn new(model: &CalibrationModel) -> Self {
        let mut structure = Self { links: Vec::new(), slots: Vec::new(), loads: Vec::new(), four_bar: None };
        for index in 0..model.kinematics.joint_count() {
            structure.push(model, index);
        }
        // The payload's, behind all others.
        structure.load();
        structure
    }

    fn mark(&mut self) -> usize {
        self.slots.push(Slot::Mark);
        self.slots.len() - 1
    }

    fn group(&mut self, components: Vec<usize>) -> SpringGroup {
        let first = self.slots.len();
        self.slots.extend(components.iter().map(|_| Slot::Elastic));
        SpringGroup { first, components }
    }

    fn load(&mut self) -> usize {
        self.loads.push(Load::new(self.slots.len()));
        self.loads.len() - 1
    }

    fn push(&mut self, model: &CalibrationModel, index: usize) {
        let statics = model.statics.as_ref();
        let terms = self.mark();
        let own_axis = joint_component(model.kinematics.links[index].kind);
        let bearing = statics.map(|s| s.bearings[index]).unwrap_or_default();
        let mut group = SpringGroup::default();
        if bearing.side == BearingSide::Fixed {
            group = self.group(yielding(&bearing.stiffness, own_axis));
        }
        let four_bar = model.actuators.four_bar();
        if let Some((shoulder, elbow, offset, linkage)) = four_bar
            && shoulder == index
        {
            self.slots.push(Slot::Crank);
            self.four_bar = Some(ElbowLoop::new(
                shoulder,
                elbow,
                offset + model.kinematics.links[elbow].theta,
                linkage,
                self.slots.len() - 1,
                statics,
            ));
        }
        self.slots.push(Slot::Elastic);
        let drive = self.slots.len() - 1;
        if let Some(four_bar) = &mut self.four_bar
            && four_bar.elbow == index
        {
            four_bar.first_outboard = self.loads.len();
        }
        let frame = self.mark();
        if bearing.side == BearingSide::Moving {
            group = self.group(yielding(&bearing.stiffness, own_axis));
        }
        let first_load = self.load();
        let beam = statics.and_then(|s| s.beams[index].as_ref());
        let run = beam.map_or(BeamRun::AlongX, |b| b.run);
        let segments = beam.map_or(&[][..], |b| &b.segments).iter().map(|segment| {
            self.load();
            let springs = segment_group(segment, 1.0, 0.0, run.axes());
            let group = self.group((0..6).filter(|c| springs.stiffness[*c].is_finite()).collect());
            self.load();
            Segment { group, now: *segment, reference: *segment, springs, reference_springs: springs }
        });
        let segments = segments.collect();
        let all_loads = statics.map_or(&[][..], |s| &s.loads);
        let point_loads = all_loads.iter().filter(|l| l.link == index).map(|l| (self.load(), l.at)).collect();
        if self.four_bar.as_ref().is_some_and(|f| f.elbow == index) {
            let load = self.load();
            let reach = self.slots.len();
            if let Some(four_bar) = &mut self.four_bar {
                (four_bar.lever_load, four_bar.reach) = (load, reach);
            }
        }
        let body = body_of(statics, index);
        self.links.push(ElasticLink {
            terms,
            side: bearing.side,
            bearing_at: bearing.at,
            bearing: group,
            drive,
            frame,
            correction: [0.0; 6],
            run,
            segments,
            length: 0.0,
            body,
            reference_body: body,
            rigid: body,
            reference_rigid: body,
            first_load,
            point_loads,
        });
    }
}

impl ElbowLoop {
    fn new(
        shoulder: usize,
        elbow: usize,
        offset: f64,
        four_bar: &FourBar,
        crank: usize,
        statics: Option<&StaticProperties>,
    ) -> Self {
        let mut new = Self {
            shoulder,
            elbow,
            crank,
            reach: 0,
            lever_load: 0,
            first_outboard: 0,
            four_bar: *four_bar,
            offset,
            compliance: 0.0,
            reference_compliance: 0.0,
            rod_mass: 0.0,
            crank_body: (0.0, Vector3::zeros()),
        };
        new.set(four_bar, offset, statics);
        new.reference_compliance = new.compliance;
        new
    }

    /// Takes the values of a model.
    pub fn set(&mut self, four_bar: &FourBar, offset: f64, statics: Option<&StaticProperties>) {
        self.four_bar = *four_bar;
        self.offset = offset;
        if let Some(linkage) = statics.and_then(|s| s.linkage.as_ref()) {
            self.compliance = 1.0 / linkage.rod_stiffness;
            self.rod_mass = linkage.rod_mass;
            self.crank_body = (linkage.crank.mass, linkage.crank.mass * linkage.crank.centre_of_mass);
        }
    }
}

/// Mass and first moment of a link's body.
pub(super) fn body_of(statics: Option<&StaticProperties>, index: usize) -> (f64, Vector3<f64>) {
    statics.map_or((0.0, Vector3::zeros()), |s| {
        let body = &s.bodies[index];
        (body.mass, body.mass * body.centre_of_mass)
    })
}
