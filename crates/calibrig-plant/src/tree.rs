//! A robot as a tree of bodies on springs: which body is attached to which, along or about which axes, with what mass.

use nalgebra::{Matrix3, Translation3, Vector3};

use super::effects::{Foundation, Hose};
use super::{AsBuilt, ElasticPlace};
use calibrig_model::geometry::{Transform, translation};
use calibrig_model::{
    Beam, BeamRun, BeamSegment, BearingSide, Body, FourBar, JointKind, RIGID, Section, SixStiffness,
};

/// Radius of gyration of a point mass, m: rapier inverts inertias, and at rest they have no effect.
const POINT_GYRATION: f64 = 0.1;

/// Which of the six axes of its joint frame a joint moves along or about, in the order of [`SixStiffness`].
pub(super) fn axis(kind: JointKind) -> usize {
    match kind {
        JointKind::Prismatic => 2,
        JointKind::Revolute => 5,
    }
}

/// What a coordinate stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// The drive of a joint, by its index; with a four-bar, the elbow's turns the crank.
    Drive(usize),
    /// A spring that rests at zero.
    Elastic(ElasticPlace),
    /// Held only by the closed loop.
    Passive,
}

/// One generalised coordinate.
#[derive(Debug, Clone, Copy)]
pub(super) struct Coordinate {
    /// Of the joint frame: 0..3 along, 3..6 about x, y, z.
    pub(super) axis: usize,
    /// N/m or N m/rad; infinite for a rigid drive, zero if only the loop holds it.
    pub(super) stiffness: f64,
    pub(super) role: Role,
}

/// A body and the joint that carries it: `parent_from_joint · motion · body_from_joint⁻¹`, the motion first along all its free axes,
/// then about at most one.
#[derive(Debug, Clone)]
pub(super) struct Node {
    /// The base if absent.
    pub(super) parent: Option<usize>,
    pub(super) parent_from_joint: Transform,
    pub(super) body_from_joint: Transform,
    pub(super) coordinates: Vec<Coordinate>,
    /// What moves with it, in its frame.
    pub(super) bodies: Vec<Body>,
    /// Whether place, stiffness or mass depend on a telescope's extension.
    pub(super) varies: bool,
}

impl Node {
    /// The body of all that moves with it; without mass and inertia if nothing does.
    pub(super) fn body(&self) -> Body {
        let mass: f64 = self.bodies.iter().map(|body| body.mass).sum();
        if mass == 0.0 {
            return Body { mass, centre_of_mass: Vector3::zeros(), inertia: Matrix3::zeros() };
        }
        if let [body] = self.bodies.as_slice() {
            return body.clone();
        }
        let moment: Vector3<f64> = self.bodies.iter().map(|body| body.mass * body.centre_of_mass).sum();
        let centre_of_mass = moment / mass;
        let inertia = self.bodies.iter().map(|body| {
            let arm = body.centre_of_mass - centre_of_mass;
            body.inertia
                + body.mass * (Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose())
        });
        Body { mass, centre_of_mass, inertia: inertia.sum() }
    }
}

/// The nodes of the elbow's four-bar.
#[derive(Debug, Clone)]
pub(super) struct Loop {
    pub(super) shoulder: usize,
    pub(super) elbow: usize,
    pub(super) linkage: FourBar,
    /// Turns by `psi + offset + theta`, with theta that of the elbow's link.
    pub(super) crank: usize,
    /// The rod turns about the crank's z, then about its own y; its x axis points to the lever.
    pub(super) rod: [usize; 2],
    /// The rod's far end.
    pub(super) tip: usize,
    /// The end of the rod in its far end's frame, m.
    pub(super) tip_at: Vector3<f64>,
    /// The elbow's link.
    pub(super) lever: usize,
    /// The lever's end in the elbow's link frame, m.
    pub(super) lever_at: Vector3<f64>,
}

/// A robot, parents before their children.
#[derive(Debug, Clone, Default)]
pub(super) struct Tree {
    pub(super) nodes: Vec<Node>,
    /// The node of every link's frame.
    pub(super) links: Vec<usize>,
    /// The node of every joint's own motion.
    pub(super) motions: Vec<usize>,
    pub(super) forces: Vec<Pull>,
    pub(super) hoses: Vec<Stretch>,
    pub(super) closure: Option<Loop>,
}

/// A force at a point of a node.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pull {
    pub(super) node: usize,
    /// In the node's frame or, in a pose, in the base frame, m.
    pub(super) at: Vector3<f64>,
    /// In the base frame, N.
    pub(super) force: Vector3<f64>,
}

/// A hose between points of two nodes.
#[derive(Debug, Clone)]
pub(super) struct Stretch {
    /// Node (the ground if absent) and point in its frame.
    pub(super) ends: [(Option<usize>, Vector3<f64>); 2],
    pub(super) hose: Hose,
}

impl Tree {
    /// The tree at the joint variables `commanded`, on which telescoping beams depend. The robot must have passed its checks.
    pub(super) fn new(robot: &AsBuilt, commanded: &[f64]) -> Self {
        let mut builder = Builder { robot, nodes: Vec::new(), varies: false };
        let (mut links, mut motions) = (Vec::new(), Vec::new());
        let mut mount = Mount { node: None, from_node: Transform::identity() };
        if let Some(foundation) = &robot.effects.foundation {
            let Foundation { at, stiffness, .. } = foundation;
            mount = builder.group(mount, stiffness, *at, ElasticPlace::Foundation);
        }
        mount.from_node *= robot.kinematics.base_from_first;
        let mut crank_mount = None;
        let four_bar = robot.actuators.four_bar();
        for (joint, q) in commanded.iter().enumerate() {
            let (front, motion, link) = builder.link(joint, *q, mount);
            if four_bar.is_some_and(|(shoulder, ..)| shoulder == joint) {
                crank_mount = Some(front);
            }
            motions.push(motion);
            links.push(link);
            mount = Mount::at(link);
        }
        let closure = four_bar.zip(crank_mount).map(|((shoulder, elbow, _, linkage), mount)| {
            builder.four_bar(mount, shoulder, elbow, linkage, links[elbow])
        });
        let forces = builder.loads(&links);
        let hoses = robot.effects.hoses.iter().flat_map(|hoses| &hoses.hoses).map(|hose| Stretch {
            ends: hose.ends.map(|end| (end.link.map(|link| links[link]), end.at)),
            hose: hose.clone(),
        });
        let hoses = hoses.collect();
        Self { nodes: builder.nodes, links, motions, forces, hoses, closure }
    }

    /// Whether the tree depends on the joint variables at which it is built.
    pub(super) fn varies(&self) -> bool {
        self.nodes.iter().any(|node| node.varies)
    }

    /// All coordinates with their node, in the order of the nodes.
    pub(super) fn coordinates(&self) -> impl Iterator<Item = (usize, Coordinate)> + '_ {
        let nodes = self.nodes.iter().enumerate();
        nodes.flat_map(|(node, entry)| entry.coordinates.iter().map(move |coordinate| (node, *coordinate)))
    }
}

/// Where the next joint is mounted.
#[derive(Debug, Clone, Copy)]
struct Mount {
    node: Option<usize>,
    from_node: Transform,
}

impl Mount {
    fn at(node: usize) -> Self {
        Self { node: Some(node), from_node: Transform::identity() }
    }
}

struct Builder<'a> {
    robot: &'a AsBuilt,
    nodes: Vec<Node>,
    /// Whether the nodes of the present link depend on the joint variable.
    varies: bool,
}

impl Builder<'_> {
    fn push(&mut self, mount: Mount, coordinates: Vec<Coordinate>) -> usize {
        self.nodes.push(Node {
            parent: mount.node,
            parent_from_joint: mount.from_node,
            body_from_joint: Transform::identity(),
            coordinates,
            bodies: Vec::new(),
            varies: self.varies,
        });
        self.nodes.len() - 1
    }

    /// A link from its fixed part to its frame. Returns where its motion is mounted, the node of the motion and that of the frame.
    fn link(&mut self, joint: usize, q: f64, mut mount: Mount) -> (Mount, usize, usize) {
        let (link, statics) = (&self.robot.kinematics.links[joint], &self.robot.statics);
        let beam = statics.beams[joint].as_ref();
        mount.from_node *= link.fixed_part();
        let bearing = &statics.bearings[joint];
        let mut stiffness = bearing.stiffness;
        let foundation = self.robot.effects.foundation.as_ref();
        let rail =
            foundation.and_then(|foundation| foundation.rail.as_ref()).filter(|rail| rail.joint == joint);
        if let Some(rail) = rail {
            rail.carry(q, &mut stiffness);
        }
        self.varies = rail.is_some();
        stiffness[axis(link.kind)] = f64::INFINITY;
        let at = Vector3::new(0.0, 0.0, bearing.at);
        let place = ElasticPlace::Bearing { joint };
        if bearing.side == BearingSide::Fixed {
            mount = self.group(mount, &stiffness, at, place);
        }
        let front = mount;

        self.varies |= beam.is_some_and(|beam| {
            beam.segments.iter().any(|segment| segment.length.at(0.0) != segment.length.at(1.0))
        });
        let driven_by_crank = self.robot.actuators.four_bar().is_some_and(|(_, elbow, ..)| elbow == joint);
        let drive = if driven_by_crank {
            Coordinate { axis: axis(link.kind), stiffness: 0.0, role: Role::Passive }
        } else {
            let stiffness = statics.drive_stiffness[joint];
            Coordinate { axis: axis(link.kind), stiffness, role: Role::Drive(joint) }
        };
        let motion = self.push(mount, vec![drive]);
        mount = Mount::at(motion);
        if bearing.side == BearingSide::Moving {
            mount = self.group(mount, &stiffness, at, place);
        }
        let root = mount.node.unwrap_or(motion);
        let body = &statics.bodies[joint];
        let tip = match beam {
            None => {
                self.nodes[root].bodies.push(body.clone());
                root
            }
            Some(beam) => {
                self.nodes[root].bodies.push(without_beam(body, beam, q));
                self.beam(joint, beam, q, root)
            }
        };
        (front, motion, tip)
    }

    /// The six coordinates of a group at a point of the mount's frame, except the rigid ones.
    fn group(
        &mut self,
        mount: Mount,
        stiffness: &SixStiffness,
        at: Vector3<f64>,
        place: ElasticPlace,
    ) -> Mount {
        let coordinate =
            |axis: usize| Coordinate { axis, stiffness: stiffness[axis], role: Role::Elastic(place) };
        let elastic: Vec<_> = (0..6).filter(|&axis| stiffness[axis].is_finite()).map(coordinate).collect();
        let there = translation(at.x, at.y, at.z);
        let mut last = mount;
        last.from_node *= there;
        let mut rest = elastic.as_slice();
        // One node moves along all axes, then about one.
        while !rest.is_empty() {
            let angular = rest.iter().position(|coordinate| coordinate.axis >= 3);
            let (here, later) = rest.split_at(angular.map_or(rest.len(), |first| first + 1));
            last = Mount::at(self.push(last, here.to_vec()));
            rest = later;
        }
        if elastic.is_empty() {
            return mount;
        }
        if let Some(node) = last.node {
            self.nodes[node].body_from_joint = there;
        }
        last
    }

    /// One group and two lumps per segment; returns the node of the tip.
    fn beam(&mut self, link: usize, beam: &Beam, q: f64, root: usize) -> usize {
        let mut node = root;
        for (segment, (piece, start)) in beam.segments.iter().zip(starts(beam, q)).enumerate() {
            let length = piece.length.at(q);
            let lump = |share: f64| Body {
                mass: 0.5 * piece.section.mass_per_length * length,
                centre_of_mass: along(beam.run, start + share * length),
                inertia: Matrix3::from_diagonal_element(
                    0.5 * piece.section.mass_per_length * length * POINT_GYRATION.powi(2),
                ),
            };
            self.nodes[node].bodies.push(lump(1.0 / 6.0));
            let stiffness = segment_stiffness(&piece.section, length, beam.run);
            let at = along(beam.run, start + 0.5 * length);
            let mount = self.group(Mount::at(node), &stiffness, at, ElasticPlace::Beam { link, segment });
            node = mount.node.unwrap_or(node);
            self.nodes[node].bodies.push(lump(5.0 / 6.0));
        }
        node
    }

    fn four_bar(
        &mut self,
        mut mount: Mount,
        shoulder: usize,
        elbow: usize,
        linkage: &FourBar,
        lever: usize,
    ) -> Loop {
        self.varies = false;
        let statics = &self.robot.statics;
        let stiffness = statics.drive_stiffness[elbow];
        mount.from_node *= linkage.axis.shoulder_from_axis();
        let crank = self.push(mount, vec![Coordinate { axis: 5, stiffness, role: Role::Drive(elbow) }]);
        let (crank_end, lever_at) = (linkage.crank.end(), linkage.lever.end());
        let mut rod_stiffness = f64::INFINITY;
        if let Some(statics) = &statics.linkage {
            rod_stiffness = statics.rod_stiffness;
            if statics.crank.mass > 0.0 {
                self.nodes[crank].bodies.push(statics.crank.clone());
            }
            // The rod itself has no mass, so that it carries only its springs' moments.
            self.nodes[crank].bodies.push(point_mass(0.5 * statics.rod_mass, crank_end));
            self.nodes[lever].bodies.push(point_mass(0.5 * statics.rod_mass, lever_at));
        }
        let passive = |axis| vec![Coordinate { axis, stiffness: 0.0, role: Role::Passive }];
        let yaw = self.push(Mount { node: Some(crank), from_node: translation_by(crank_end) }, passive(5));
        let pitch = self.push(Mount::at(yaw), passive(4));
        let along_rod = Vector3::new(linkage.rod, 0.0, 0.0);
        let (tip, tip_at) = if rod_stiffness.is_finite() {
            let spring =
                Coordinate { axis: 0, stiffness: rod_stiffness, role: Role::Elastic(ElasticPlace::Rod) };
            let mount = Mount { node: Some(pitch), from_node: translation_by(along_rod) };
            (self.push(mount, vec![spring]), Vector3::zeros())
        } else {
            (pitch, along_rod)
        };
        Loop { shoulder, elbow, linkage: *linkage, crank, rod: [yaw, pitch], tip, tip_at, lever, lever_at }
    }

    /// Masses become part of their link. Returns the forces.
    fn loads(&mut self, links: &[usize]) -> Vec<Pull> {
        let mut forces = Vec::new();
        for load in &self.robot.statics.loads {
            let node = links[load.link];
            if load.mass > 0.0 {
                self.nodes[node].bodies.push(point_mass(load.mass, load.at));
            }
            if load.force != Vector3::zeros() {
                forces.push(Pull { node, at: load.at, force: load.force });
            }
        }
        forces
    }
}

fn translation_by(v: Vector3<f64>) -> Transform {
    Transform::from_parts(Translation3::from(v), nalgebra::Rotation3::identity())
}

pub(super) fn point_mass(mass: f64, at: Vector3<f64>) -> Body {
    Body { mass, centre_of_mass: at, inertia: Matrix3::from_diagonal_element(mass * POINT_GYRATION.powi(2)) }
}

/// A point on the beam's axis, by its coordinate along it.
fn along(run: BeamRun, s: f64) -> Vector3<f64> {
    match run {
        BeamRun::AlongX => Vector3::new(s, 0.0, 0.0),
        BeamRun::EndsAtOrigin => Vector3::new(0.0, 0.0, s),
    }
}

/// Where every segment starts along the beam's axis, m.
fn starts(beam: &Beam, q: f64) -> impl Iterator<Item = f64> + '_ {
    let length = move |segment: &BeamSegment| segment.length.at(q);
    let root = match beam.run {
        BeamRun::AlongX => 0.0,
        BeamRun::EndsAtOrigin => -beam.segments.iter().map(length).sum::<f64>(),
    };
    beam.segments.iter().scan(root, move |at, segment| {
        let start = *at;
        *at += length(segment);
        Some(start)
    })
}

/// Mass and first moment of the beam's sections, kg and kg m.
pub(super) fn beam_mass(beam: &Beam, q: f64) -> (f64, Vector3<f64>) {
    let pieces = beam.segments.iter().zip(starts(beam, q)).map(|(piece, start)| {
        let length = piece.length.at(q);
        let mass = piece.section.mass_per_length * length;
        (mass, mass * along(beam.run, start + 0.5 * length))
    });
    pieces.fold((0.0, Vector3::zeros()), |sum, piece| (sum.0 + piece.0, sum.1 + piece.1))
}

/// The rest of a link's body, at the root of its beam: mass and first moment of the whole are kept.
fn without_beam(body: &Body, beam: &Beam, q: f64) -> Body {
    let (beam_mass, beam_moment) = beam_mass(beam, q);
    let mass = body.mass - beam_mass;
    if mass <= 0.0 {
        return Body { mass: 0.0, ..body.clone() };
    }
    let centre_of_mass = (body.mass * body.centre_of_mass - beam_moment) / mass;
    Body { mass, centre_of_mass, inertia: body.inertia }
}

/// The group of a uniform Timoshenko segment. Bending about the second axis goes with shear along the third, and vice versa.
fn segment_stiffness(section: &Section, length: f64, run: BeamRun) -> SixStiffness {
    // What is elastic at one length is elastic at every length: the tree keeps its form.
    let spring =
        |is_elastic: bool, stiffness: f64| if is_elastic { stiffness.min(f64::MAX) } else { stiffness };
    let transverse = |shear: f64, bending: f64| {
        let stiffness = 1.0 / (length / shear + length.powi(3) / (12.0 * bending));
        spring(shear.is_finite() || bending.is_finite(), stiffness)
    };
    let linear = [
        spring(section.axial.is_finite(), section.axial / length),
        transverse(section.shear[0], section.bending[1]),
        transverse(section.shear[1], section.bending[0]),
    ];
    let angular = [section.torsion, section.bending[0], section.bending[1]]
        .map(|rigidity| spring(rigidity.is_finite(), rigidity / length));
    // The section's axes (first, second, third) are the link's (x, y, z) or (z, x, y).
    let first = match run {
        BeamRun::AlongX => 0,
        BeamRun::EndsAtOrigin => 2,
    };
    let mut stiffness = RIGID;
    for (i, (along, about)) in linear.into_iter().zip(angular).enumerate() {
        stiffness[(first + i) % 3] = along;
        stiffness[3 + (first + i) % 3] = about;
    }
    stiffness
}
