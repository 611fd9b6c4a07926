//! The links of a chain, where they are at one pose, and the axes of their parameters there.

use nalgebra::Vector3;

use super::screw::{MovingFrame, Screw};
use calibrig_model::geometry::Transform;
use calibrig_model::{CraigLink, JointKind, KinematicModel, LinkTerm, ParameterId};

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

    /// Takes a frame through the link with this angle about z and this way along it, and tells where its parameters act.
    #[inline]
    fn pass(&self, frame: &mut MovingFrame, axes: &mut LinkAxes, sin_cos_theta: (f64, f64), d: f64) {
        axes.x = frame.axes[0];
        axes.previous_origin = frame.origin;
        frame.turn(0, self.sin_cos_alpha);
        frame.origin += self.a * frame.axes[0];
        axes.y = frame.axes[1];
        axes.origin = frame.origin;
        frame.turn(1, self.sin_cos_beta);
        axes.z = frame.axes[2];
        frame.turn(2, sin_cos_theta);
        frame.origin += d * frame.axes[2];
    }

    /// [`pass`](Self::pass) of the part in front of the joint's motion.
    #[inline]
    fn pass_fixed_part(&self, frame: &mut MovingFrame, axes: &mut LinkAxes) {
        self.pass(frame, axes, self.sin_cos_theta, self.d);
    }
}

/// Where the parameters of a link act, in the base frame.
#[derive(Debug, Clone, Copy, Default)]
struct LinkAxes {
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

impl LinkAxes {
    #[inline]
    fn screw(&self, term: LinkTerm) -> Screw {
        let (about, axis, origin) = match term {
            LinkTerm::A => (false, self.x, self.previous_origin),
            LinkTerm::Alpha => (true, self.x, self.previous_origin),
            LinkTerm::Beta => (true, self.y, self.origin),
            LinkTerm::D => (false, self.z, self.origin),
            LinkTerm::Theta => (true, self.z, self.origin),
        };
        Screw { about, axis, origin }
    }
}

/// The links of a chain at one pose, from which every column of the Jacobian follows without another product.
///
/// It is made once, given a [model](Self::set_model) and [placed](Self::place) at every pose, so that nothing is allocated in the loop
/// over poses. A chain that yields lets a frame [start](Self::start) here, [pass](Self::pass_fixed_part) the fixed part of one link after the
/// other, with what moves behind each in between, and [end](Self::end) at the flange.
#[derive(Debug, Clone)]
pub(crate) struct KinematicChain {
    links: Vec<LinkConstants>,
    axes: Vec<LinkAxes>,
    base_from_first: Transform,
    last_from_flange: Transform,
    base_from_flange: Transform,
}

impl KinematicChain {
    /// The chain of `model`, not yet at a pose.
    pub fn new(model: &KinematicModel) -> Self {
        let mut chain = Self {
            links: Vec::with_capacity(model.joint_count()),
            axes: vec![LinkAxes::default(); model.joint_count()],
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

    /// Whether the joints are of these kinds.
    pub fn has_kinds(&self, mut kinds: impl Iterator<Item = JointKind>) -> bool {
        self.links.iter().all(|link| kinds.next() == Some(link.kind))
    }

    /// Along z (2) or about z (5): how a link's joint moves it.
    #[inline]
    pub fn joint_component(&self, link: usize) -> usize {
        joint_component(self.links[link].kind)
    }

    /// The link parameter that a link's joint changes.
    pub fn joint_term(&self, link: usize) -> LinkTerm {
        match self.links[link].kind {
            JointKind::Prismatic => LinkTerm::D,
            JointKind::Revolute => LinkTerm::Theta,
        }
    }

    /// Puts the rigid chain at the joint variables `q`.
    pub fn place(&mut self, q: &[f64]) {
        let mut frame = self.start();
        for ((link, axes), &q) in self.links.iter().zip(&mut self.axes).zip(q) {
            let (sin_cos_theta, d) = match link.kind {
                JointKind::Revolute => ((link.theta + q).sin_cos(), link.d),
                JointKind::Prismatic => (link.sin_cos_theta, link.d + q),
            };
            link.pass(&mut frame, axes, sin_cos_theta, d);
        }
        self.end(&frame);
    }

    /// Puts the chain at given motions behind the [fixed parts](CraigLink::fixed_part) of the links, one a link: that of the joint, and of
    /// all that yields there.
    pub fn place_at(&mut self, motions: &[Transform]) {
        let mut frame = self.start();
        for ((link, axes), motion) in self.links.iter().zip(&mut self.axes).zip(motions) {
            link.pass_fixed_part(&mut frame, axes);
            frame.go(motion);
        }
        self.end(&frame);
    }

    /// A frame in front of the first link.
    pub fn start(&self) -> MovingFrame {
        MovingFrame::from(&self.base_from_first)
    }

    /// Takes a frame through what is in front of the motion of a link's joint.
    #[inline]
    pub fn pass_fixed_part(&mut self, link: usize, frame: &mut MovingFrame) {
        self.links[link].pass_fixed_part(frame, &mut self.axes[link]);
    }

    /// Puts the flange behind a frame that has passed all links.
    pub fn end(&mut self, frame: &MovingFrame) {
        self.base_from_flange = frame.transform() * self.last_from_flange;
    }

    /// `base_from_flange`.
    pub fn base_from_flange(&self) -> &Transform {
        &self.base_from_flange
    }

    /// Position in the base frame of a target at `in_flange`, m.
    pub fn target(&self, in_flange: &Vector3<f64>) -> Vector3<f64> {
        self.base_from_flange.rotation * in_flange + self.base_from_flange.translation.vector
    }

    /// The motion per unit of a link parameter, of all that is behind it.
    #[inline]
    pub fn screw(&self, link: usize, term: LinkTerm) -> Screw {
        self.axes[link].screw(term)
    }

    /// Change of the target's position in the base frame per unit of a link parameter, where `target` is [`Self::target`].
    pub fn link_column(&self, link: usize, term: LinkTerm, target: &Vector3<f64>) -> Vector3<f64> {
        self.screw(link, term).moves(target)
    }

    /// Change of the target's position as the tracker sees it, in base axes, per unit of any parameter of the rigid chain.
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
            ParameterId::Target { axis, .. } => self.flange_axis(axis),
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

    /// An axis of the flange, in the base's axes: how the target moves with its place there.
    pub fn flange_axis(&self, axis: usize) -> Vector3<f64> {
        self.base_from_flange.rotation.matrix().column(axis).into_owned()
    }

    /// How the flange of the rigid chain turns per unit of any parameter: a rotation vector in base axes, rad per unit. Frame parameters turn the
    /// base as the tracker sees it; those of how a target is turned on the flange are the caller's.
    pub fn turn(&self, id: ParameterId) -> Vector3<f64> {
        match id {
            ParameterId::Link { link, term } => self.screw(link, term).turns(),
            ParameterId::Frame { component, .. } if component >= 3 => Vector3::ith(component % 3, 1.0),
            _ => Vector3::zeros(),
        }
    }
}

/// Along z (2) or about z (5): how a joint moves its link.
#[inline]
pub(crate) fn joint_component(kind: JointKind) -> usize {
    match kind {
        JointKind::Prismatic => 2,
        JointKind::Revolute => 5,
    }
}
