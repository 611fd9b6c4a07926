//! The step of rapier that confirms a pose at rest: for some coordinates at a time, while the others stay where the pose has them.
//!
//! A long step moves every coordinate by the force left over, divided by its own spring's stiffness, whichever others may move with it; only the
//! loop couples them. It assembles two dense mass matrices body by body, in a time that grows with the square of the number of coordinates: the
//! parts one after the other take a seventh of the time of the whole robot.

use nalgebra::{Point3, Vector3};

use super::chain::{Chain, transform};
use super::statics::Statics;
use super::tree::{Loop, Node, Pull, Tree, point_mass};
use calibrig_model::geometry::Transform;

/// Number of coordinates in a part: with fewer, the rest of a step costs more than its matrices.
const PART: usize = 12;

/// The robot in parts, each with the masses that it carries.
pub(super) struct Confirmation {
    parts: Vec<Substructure>,
}

/// The pose to confirm.
pub(super) struct AtRest<'a> {
    pub(super) tree: &'a Tree,
    /// In the pose.
    pub(super) chain: &'a Chain,
    /// Evaluated in the pose.
    pub(super) statics: &'a Statics,
    pub(super) coordinates: &'a [f64],
    /// Stiffness and rest of every coordinate.
    pub(super) springs: &'a [(f64, f64)],
}

struct Substructure {
    tree: Tree,
    chain: Chain,
    /// Its nodes and coordinates as the whole robot counts them.
    nodes: Vec<usize>,
    coordinates: Vec<usize>,
    /// For every node of the whole robot, the node of the part that carries it; none in front of the part.
    carriers: Vec<Option<usize>>,
}

impl Confirmation {
    /// `None` for a robot with only one part.
    pub(super) fn new(tree: &Tree, gravity: &Vector3<f64>, dt: f64) -> Option<Self> {
        let parts = split(tree);
        let part = |nodes| Substructure::new(tree, nodes, gravity, dt);
        (parts.len() > 1).then(|| Self { parts: parts.into_iter().map(part).collect() })
    }

    /// Where a step takes the coordinates.
    pub(super) fn step(&mut self, pose: &AtRest<'_>) -> Vec<f64> {
        let mut stepped = pose.coordinates.to_vec();
        self.parts.iter_mut().for_each(|part| part.step(pose, &mut stepped));
        stepped
    }
}

impl Substructure {
    fn new(whole: &Tree, nodes: Vec<usize>, gravity: &Vector3<f64>, dt: f64) -> Self {
        let own = |node: usize| nodes.iter().position(|own| *own == node);
        let mut carriers: Vec<Option<usize>> = Vec::with_capacity(whole.nodes.len());
        for (index, node) in whole.nodes.iter().enumerate() {
            carriers.push(own(index).or_else(|| carriers[node.parent?]));
        }
        let node = |&index: &usize| {
            let node = &whole.nodes[index];
            Node { parent: node.parent.and_then(|parent| carriers[parent]), varies: true, ..node.clone() }
        };
        let closure = whole.closure.as_ref().and_then(|closure| {
            let [yaw, pitch] = closure.rod;
            let (crank, rod) = (own(closure.crank)?, [own(yaw)?, own(pitch)?]);
            Some(Loop { crank, rod, tip: own(closure.tip)?, lever: own(closure.lever)?, ..closure.clone() })
        });
        let tree = Tree { nodes: nodes.iter().map(node).collect(), closure, ..Tree::default() };
        let coordinates = whole.coordinates().enumerate();
        let coordinates = coordinates.filter_map(|(coordinate, (node, _))| own(node).map(|_| coordinate));
        Self {
            coordinates: coordinates.collect(),
            chain: Chain::new(&tree, gravity, dt),
            tree,
            carriers,
            nodes,
        }
    }

    fn step(&mut self, pose: &AtRest<'_>, stepped: &mut [f64]) {
        self.arrange(pose);
        let Self { chain, coordinates, carriers, .. } = self;
        chain.set_springs(coordinates.iter().map(|&coordinate| pose.springs[coordinate]));
        let start: Vec<f64> = coordinates.iter().map(|&coordinate| pose.coordinates[coordinate]).collect();
        chain.place(&start);
        let carried = |pull: Pull| Some(Pull { node: carriers[pull.node]?, ..pull });
        chain.pull(pose.statics.pulls().filter_map(carried));
        chain.step_from_rest();
        for (own, coordinate) in coordinates.iter().enumerate() {
            stepped[*coordinate] = chain.coordinate(own);
        }
    }

    /// Puts its nodes where they are in the pose, with the masses that they carry there.
    fn arrange(&mut self, pose: &AtRest<'_>) {
        let base_from = |node: Option<usize>| {
            node.map_or_else(Transform::identity, |node| transform(pose.chain.pose(node)))
        };
        let mut carried = vec![(0.0, Vector3::zeros()); self.nodes.len()];
        for (node, carrier) in self.carriers.iter().enumerate() {
            if let Some(carrier) = *carrier {
                let (mass, centre) = pose.chain.mass(node);
                carried[carrier].0 += mass;
                carried[carrier].1 += mass * centre;
            }
        }
        for (own, (&index, (mass, moment))) in self.nodes.iter().zip(carried).enumerate() {
            let (node, part) = (&pose.tree.nodes[index], &mut self.tree.nodes[own]);
            let parent = part.parent.map(|parent| self.nodes[parent]);
            part.parent_from_joint = node.parent_from_joint;
            if parent != node.parent {
                part.parent_from_joint =
                    base_from(parent).inverse() * base_from(node.parent) * node.parent_from_joint;
            }
            part.body_from_joint = node.body_from_joint;
            part.bodies.clear();
            if mass > 0.0 {
                let centre = base_from(Some(index)).inverse() * Point3::from(moment / mass);
                part.bodies.push(point_mass(mass, centre.coords));
            }
        }
        self.chain.rearrange(&self.tree);
    }
}

/// The nodes of every part.
fn split(tree: &Tree) -> Vec<Vec<usize>> {
    let looped = tree.closure.as_ref().map_or_else(Vec::new, |closure| looped(tree, closure));
    let (mut parts, mut part, mut size) = (Vec::new(), Vec::new(), 0);
    for (index, node) in tree.nodes.iter().enumerate().filter(|(index, _)| !looped.contains(index)) {
        part.push(index);
        size += node.coordinates.len();
        if size >= PART {
            parts.push(std::mem::take(&mut part));
            size = 0;
        }
    }
    parts.extend([part, looped]);
    parts.retain(|part| !part.is_empty());
    parts
}

/// The bodies of the loop, after the body that carries crank and lever: they can only move together.
fn looped(tree: &Tree, closure: &Loop) -> Vec<usize> {
    let mount = tree.nodes[closure.crank].parent;
    let behind_mount = |node: &usize| tree.nodes[*node].parent.filter(|parent| Some(*parent) != mount);
    let branch = |end: usize| std::iter::successors(Some(end), behind_mount);
    let mut nodes: Vec<_> = branch(closure.lever).chain(branch(closure.tip)).collect();
    nodes.sort_unstable();
    nodes
}
