//! Forces, closure and tangent stiffness of a chain in its present pose, from rapier's body Jacobians.
//!
//! A coordinate j moves a point p that it carries with velocity `v + w × p`. Let F and `S = Σ p fᵀ` be force and first moment of all that
//! j carries. Then the generalised force is `v·F + Σ w·(p × f)`, and a coordinate i in front of j on the same branch changes it by `wᵢ ·
//! h`, `h = v × F + (S - tr S) w`: forces are constant in the base, and so are v and w except for the rotation of i.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3, Matrix3xX, Vector3};

use super::AsBuilt;
use super::chain::{Chain, point, vector};
use super::effects::StiffnessCurve;
use super::tree::{Coordinate, Pull, Role, Stretch, Tree};

/// Stiffness of the loop in [`Statics::tangent`], N/m: so stiff that only motion that keeps it closed can be unstable, so soft that
/// other springs keep their digits.
const LOOP_STIFFNESS: f64 = 1e9;

/// What does not change with the pose.
struct Branches {
    parents: Vec<Option<usize>>,
    forces: Vec<Pull>,
    gravity: Vector3<f64>,
    nodes: Vec<usize>,
    /// For every coordinate, those in front of it that turn the following bodies.
    turning: Vec<Vec<usize>>,
    loop_ends: Option<LoopEnds>,
    hoses: Vec<HoseEnds>,
}

struct HoseEnds {
    stretch: Stretch,
    /// For every coordinate, whether it carries either end.
    carries: Vec<(bool, bool)>,
}

/// A hose in the present pose.
struct Stretched {
    /// Change of the force on its second end per displacement of the second end relative to the first, N/m.
    stiffness: Matrix3<f64>,
    /// How the coordinates move the second end relative to the first, 3 x n.
    jacobian: Matrix3xX<f64>,
}

struct LoopEnds {
    /// Node and point in its frame.
    tip: (usize, Vector3<f64>),
    lever: (usize, Vector3<f64>),
    /// Of every coordinate, whether it carries either.
    carries: Vec<(bool, bool)>,
    /// The coordinates that only the loop holds.
    passive: Vec<usize>,
}

/// The constraint of the loop in the present pose.
#[derive(Debug, Clone)]
pub(super) struct LoopConstraint {
    /// The rod's end, in the base frame.
    pub(super) tip: Vector3<f64>,
    /// The lever's end, in the base frame.
    pub(super) lever: Vector3<f64>,
    /// How the coordinates move the lever's end relative to the rod's, 3 x n.
    pub(super) jacobian: Matrix3xX<f64>,
    /// On the lever's end, N; its opposite acts on the rod's.
    pub(super) reaction: Vector3<f64>,
}

impl LoopConstraint {
    /// From the rod's end to the lever's.
    pub(super) fn gap(&self) -> Vector3<f64> {
        self.lever - self.tip
    }
}

/// The forces on a chain, and their effect.
pub(super) struct Statics {
    branches: Branches,
    /// Zero for rigid drives; `is_rigid` distinguishes them from passive coordinates. For a stiffening drive, that of its
    /// present range.
    stiffness: Vec<f64>,
    /// Of the coordinates whose drives stiffen: coordinate, stiffness without that, curve.
    curves: Vec<(usize, f64, StiffnessCurve)>,
    is_rigid: Vec<bool>,
    /// Velocity at the base's origin and rotation, of every coordinate.
    twists: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// F and S of all that a node carries.
    carried: Vec<(Vector3<f64>, Matrix3<f64>)>,
    /// Generalised force of weights, constant forces and the loop's reaction.
    load: DVector<f64>,
    closure: Option<LoopConstraint>,
    hoses: Vec<Stretched>,
    /// Constant forces and those of the hoses, in the present pose.
    pulls: Vec<Pull>,
}

impl Statics {
    pub(super) fn new(tree: &Tree, robot: &AsBuilt) -> Self {
        let coordinates: Vec<_> = tree.coordinates().collect();
        let curve_of = |(coordinate, (_, entry)): (usize, &(usize, Coordinate))| match entry.role {
            Role::Drive(joint) => Some((coordinate, entry.stiffness, robot.curve(joint)?.clone())),
            _ => None,
        };
        let curves = coordinates.iter().enumerate().filter_map(curve_of).collect();
        let count = coordinates.len();
        let is_rigid: Vec<bool> =
            coordinates.iter().map(|(_, entry)| entry.stiffness.is_infinite()).collect();
        let mut statics = Self {
            branches: Branches::new(tree, &robot.statics.gravity),
            stiffness: Vec::new(),
            curves,
            is_rigid,
            twists: vec![(Vector3::zeros(), Vector3::zeros()); count],
            carried: vec![(Vector3::zeros(), Matrix3::zeros()); tree.nodes.len()],
            load: DVector::zeros(count),
            closure: tree.closure.as_ref().map(|_| LoopConstraint {
                tip: Vector3::zeros(),
                lever: Vector3::zeros(),
                jacobian: Matrix3xX::zeros(count),
                reaction: Vector3::zeros(),
            }),
            hoses: Vec::new(),
            pulls: Vec::new(),
        };
        let still = || Stretched { stiffness: Matrix3::zeros(), jacobian: Matrix3xX::zeros(count) };
        statics.hoses = tree.hoses.iter().map(|_| still()).collect();
        statics.restiffen(tree);
        statics
    }

    /// Takes the stiffnesses of a tree of the same form.
    pub(super) fn restiffen(&mut self, tree: &Tree) {
        self.stiffness.clear();
        let stiffness = tree.coordinates().map(|(_, entry)| entry.stiffness);
        self.stiffness.extend(stiffness.map(|k| if k.is_finite() { k } else { 0.0 }));
    }

    /// Takes the stiffnesses of drives that stiffen at these deflections. Returns whether one has changed.
    pub(super) fn stiffen(&mut self, deflection: &[f64]) -> bool {
        let mut changed = false;
        for (coordinate, own, curve) in &self.curves {
            let (stiffness, _) = curve.tangent_and_load(*own, deflection[*coordinate]);
            changed |= std::mem::replace(&mut self.stiffness[*coordinate], stiffness) != stiffness;
        }
        changed
    }

    /// Stiffness of every coordinate's spring (zero for a rigid drive and if only the loop holds it) and the deflection at which it rests; for a
    /// stiffening drive, those of the linear spring that is tangent to it at its deflection.
    pub(super) fn springs(&self, deflection: &[f64]) -> Vec<(f64, f64)> {
        let mut springs: Vec<_> = self.stiffness.iter().map(|stiffness| (*stiffness, 0.0)).collect();
        for (coordinate, own, curve) in &self.curves {
            let (stiffness, load) = curve.tangent_and_load(*own, deflection[*coordinate]);
            springs[*coordinate] = (stiffness, deflection[*coordinate] - load / stiffness);
        }
        springs
    }

    /// The loop in the pose that was last evaluated.
    pub(super) fn closure(&self) -> Option<&LoopConstraint> {
        self.closure.as_ref()
    }

    /// Forces in the present pose. The loop's reaction is the one that holds the passive coordinates.
    pub(super) fn evaluate(&mut self, chain: &Chain) {
        for (coordinate, twist) in self.twists.iter_mut().enumerate() {
            *twist = chain.twist(coordinate);
        }
        for (node, carried) in self.carried.iter_mut().enumerate() {
            let (mass, centre) = chain.mass(node);
            let weight = mass * self.branches.gravity;
            *carried = (weight, centre * weight.transpose());
        }
        self.pulls.clear();
        let forces = self.branches.forces.iter();
        self.pulls.extend(forces.map(|own| Pull { at: in_base(chain, own.node, &own.at), ..*own }));
        self.stretch(chain);
        for Pull { node, at, force } in &self.pulls {
            act(&mut self.carried[*node], at, force);
        }
        self.collect();
        self.load_coordinates();
        if let (Some(closure), Some(ends)) = (&mut self.closure, &self.branches.loop_ends) {
            let [tip, lever] = [ends.tip, ends.lever].map(|(node, at)| in_base(chain, node, &at));
            (closure.tip, closure.lever) = (tip, lever);
            set_relative(&mut closure.jacobian, &self.twists, &ends.carries, &[tip, lever]);
            closure.reaction = holding(&closure.jacobian, &self.load, &ends.passive);
            self.load += closure.jacobian.tr_mul(&closure.reaction);
            self.carry_reaction();
        }
    }

    /// Stretches the hoses.
    fn stretch(&mut self, chain: &Chain) {
        for (hose, HoseEnds { stretch, carries }) in self.hoses.iter_mut().zip(&self.branches.hoses) {
            let ends = stretch.ends.map(|(node, at)| node.map_or(at, |node| in_base(chain, node, &at)));
            set_relative(&mut hose.jacobian, &self.twists, carries, &ends);
            let between = ends[1] - ends[0];
            let length = between.norm();
            let along = between / length;
            let (tension, stiffness) = stretch.hose.tension(length);
            let lengthwise = along * along.transpose();
            hose.stiffness =
                -stiffness * lengthwise - (Matrix3::identity() - lengthwise) * (tension / length);
            for (end, force) in [tension * along, -tension * along].into_iter().enumerate() {
                let node = stretch.ends[end].0;
                self.pulls.extend(node.map(|node| Pull { node, at: ends[end], force }));
            }
        }
    }

    /// Constant forces and those of the hoses, in the pose that was last evaluated.
    pub(super) fn pulls(&self) -> impl Iterator<Item = Pull> + Clone + '_ {
        self.pulls.iter().copied()
    }

    /// Adds up what every node carries, from the tips to the base.
    fn collect(&mut self) {
        for node in (0..self.carried.len()).rev() {
            if let Some(parent) = self.branches.parents[node] {
                let (force, moment) = self.carried[node];
                self.carried[parent].0 += force;
                self.carried[parent].1 += moment;
            }
        }
    }

    /// Adds the loop's reaction to what every node carries.
    fn carry_reaction(&mut self) {
        let (Some(closure), Some(ends)) = (&self.closure, &self.branches.loop_ends) else { return };
        let reaction = closure.reaction;
        for (start, at, force) in
            [(ends.tip.0, closure.tip, -reaction), (ends.lever.0, closure.lever, reaction)]
        {
            let mut node = Some(start);
            while let Some(here) = node {
                act(&mut self.carried[here], &at, &force);
                node = self.branches.parents[here];
            }
        }
    }

    fn load_coordinates(&mut self) {
        for (coordinate, (velocity, rotation)) in self.twists.iter().enumerate() {
            let (force, s) = &self.carried[self.branches.nodes[coordinate]];
            let moment = Vector3::new(s[(1, 2)] - s[(2, 1)], s[(2, 0)] - s[(0, 2)], s[(0, 1)] - s[(1, 0)]);
            self.load[coordinate] = velocity.dot(force) + rotation.dot(&moment);
        }
    }

    /// Force left over on every coordinate at these deflections, N or N m; zero for rigid drives.
    pub(super) fn left_over(&self, deflection: &[f64], out: &mut DVector<f64>) {
        for (coordinate, out) in out.iter_mut().enumerate() {
            *out = if self.is_rigid[coordinate] {
                0.0
            } else {
                self.load[coordinate] - self.stiffness[coordinate] * deflection[coordinate]
            };
        }
        for (coordinate, own, curve) in &self.curves {
            out[*coordinate] =
                self.load[*coordinate] - curve.tangent_and_load(*own, deflection[*coordinate]).1;
        }
    }

    /// The largest difference between a deflection and the one that the load would cause on its spring.
    pub(super) fn residual(&self, deflection: &[f64]) -> f64 {
        let mut largest: f64 = 0.0;
        for (coordinate, deflection) in deflection.iter().enumerate() {
            let stiffness = self.stiffness[coordinate];
            if stiffness == 0.0 {
                continue;
            }
            let curve = self.curves.iter().find(|(at, ..)| *at == coordinate);
            let at_rest = match curve {
                Some((_, own, curve)) => curve.deflection(*own, self.load[coordinate]),
                None => self.load[coordinate] / stiffness,
            };
            let left_over = (at_rest - deflection).abs();
            // Unlike `f64::max`, this keeps a NaN.
            if left_over > largest || left_over.is_nan() {
                largest = left_over;
            }
        }
        largest
    }

    /// Second derivative of the potential energy under the present loads, with the loop as a stiff spring; the identity for rigid drives.
    pub(super) fn tangent(&self) -> DMatrix<f64> {
        let count = self.stiffness.len();
        let mut tangent = DMatrix::zeros(count, count);
        for (j, (velocity, rotation)) in self.twists.iter().enumerate() {
            if self.is_rigid[j] {
                tangent[(j, j)] = 1.0;
                continue;
            }
            let (force, s) = &self.carried[self.branches.nodes[j]];
            let turned = velocity.cross(force) + s * rotation - s.trace() * rotation;
            for &i in &self.branches.turning[j] {
                if !self.is_rigid[i] {
                    let value = -self.twists[i].1.dot(&turned);
                    tangent[(i, j)] = value;
                    tangent[(j, i)] = value;
                }
            }
            tangent[(j, j)] += self.stiffness[j];
        }
        for hose in &self.hoses {
            let jacobian = self.movable(&hose.jacobian);
            tangent.gemm_tr(-1.0, &jacobian, &(hose.stiffness * &jacobian), 1.0);
        }
        if let Some(closure) = &self.closure {
            let jacobian = self.movable(&closure.jacobian);
            tangent.gemm_tr(LOOP_STIFFNESS, &jacobian, &jacobian, 1.0);
        }
        tangent
    }

    /// The columns of what can move; zero for rigid drives.
    fn movable(&self, jacobian: &Matrix3xX<f64>) -> Matrix3xX<f64> {
        let mut movable = jacobian.clone();
        for (coordinate, is_rigid) in self.is_rigid.iter().enumerate() {
            if *is_rigid {
                movable.column_mut(coordinate).fill(0.0);
            }
        }
        movable
    }

    /// The displacement of Newton's method towards equilibrium with the loop closed.
    pub(super) fn newton(
        &self,
        tangent: &Cholesky<f64, Dyn>,
        left_over: &DVector<f64>,
    ) -> Option<DVector<f64>> {
        let Some(closure) = &self.closure else { return Some(tangent.solve(left_over)) };
        let jacobian = self.movable(&closure.jacobian);
        let gap = closure.gap();
        let mut step = left_over - jacobian.tr_mul(&(LOOP_STIFFNESS * gap));
        tangent.solve_mut(&mut step);
        let yielding = tangent.solve(&jacobian.transpose());
        let reaction = (&jacobian * &yielding).try_inverse()? * (-gap - &jacobian * &step);
        step += yielding * reaction;
        Some(step)
    }

    /// The smallest eigenvalue of the tangent stiffness, each coordinate scaled by its own spring (and the loop): one without a load, zero
    /// if the pose is about to collapse.
    pub(super) fn margin(&self) -> f64 {
        let tangent = self.tangent();
        let scale = DVector::from_fn(tangent.nrows(), |i, _| {
            let loop_stiffness = self
                .closure
                .as_ref()
                .map_or(0.0, |closure| LOOP_STIFFNESS * closure.jacobian.column(i).norm_squared());
            let own = if self.is_rigid[i] { 1.0 } else { self.stiffness[i] + loop_stiffness };
            1.0 / own.sqrt()
        });
        let scaled =
            DMatrix::from_fn(tangent.nrows(), tangent.ncols(), |i, j| tangent[(i, j)] * scale[i] * scale[j]);
        scaled.symmetric_eigenvalues().min()
    }
}

/// A point of a node in the base frame, m.
fn in_base(chain: &Chain, node: usize, at: &Vector3<f64>) -> Vector3<f64> {
    point(&chain.pose(node).transform_point(vector(at)))
}

/// How the coordinates move the second of two points against the first, by which of them they carry.
fn set_relative(
    jacobian: &mut Matrix3xX<f64>,
    twists: &[(Vector3<f64>, Vector3<f64>)],
    carries: &[(bool, bool)],
    points: &[Vector3<f64>; 2],
) {
    for (coordinate, (velocity, rotation)) in twists.iter().enumerate() {
        let (carries_first, carries_second) = carries[coordinate];
        let mut column = Vector3::zeros();
        if carries_second {
            column += velocity + rotation.cross(&points[1]);
        }
        if carries_first {
            column -= velocity + rotation.cross(&points[0]);
        }
        jacobian.set_column(coordinate, &column);
    }
}

fn act(carried: &mut (Vector3<f64>, Matrix3<f64>), at: &Vector3<f64>, force: &Vector3<f64>) {
    carried.0 += force;
    carried.1 += at * force.transpose();
}

/// The reaction that leaves no force on the passive coordinates; none if they cannot be held.
fn holding(jacobian: &Matrix3xX<f64>, load: &DVector<f64>, passive: &[usize]) -> Vector3<f64> {
    let [a, b, c] = *passive else { return Vector3::zeros() };
    let columns = [a, b, c].map(|i| jacobian.column(i).into_owned());
    let on_passive = Vector3::new(load[a], load[b], load[c]);
    let held = Matrix3::from_columns(&columns).transpose().try_inverse();
    held.map_or_else(Vector3::zeros, |held| held * -on_passive)
}

impl Branches {
    fn new(tree: &Tree, gravity: &Vector3<f64>) -> Self {
        let parents: Vec<_> = tree.nodes.iter().map(|node| node.parent).collect();
        let coordinates: Vec<_> = tree.coordinates().collect();
        let nodes: Vec<_> = coordinates.iter().map(|(node, _)| *node).collect();
        let is_carried = |mut node: usize, by: usize| loop {
            if node == by {
                return true;
            }
            match parents[node] {
                Some(parent) => node = parent,
                None => return false,
            }
        };
        let turning = (0..nodes.len()).map(|j| {
            let in_front = (0..=j).filter(|&i| coordinates[i].1.axis >= 3 && is_carried(nodes[j], nodes[i]));
            // Within a node, the rotation comes after the translations.
            in_front.filter(|&i| i == j || nodes[i] != nodes[j]).collect()
        });
        let turning = turning.collect();
        let loop_ends = tree.closure.as_ref().map(|closure| LoopEnds {
            tip: (closure.tip, closure.tip_at),
            lever: (closure.lever, closure.lever_at),
            carries: nodes
                .iter()
                .map(|&node| (is_carried(closure.tip, node), is_carried(closure.lever, node)))
                .collect(),
            passive: (0..nodes.len()).filter(|&i| coordinates[i].1.stiffness == 0.0).collect(),
        });
        let hose_ends = |stretch: &Stretch| {
            let [first, second] = stretch.ends.map(|(node, _)| node);
            let carried = |end: Option<usize>, by: usize| end.is_some_and(|end| is_carried(end, by));
            let carries = nodes.iter().map(|&node| (carried(first, node), carried(second, node))).collect();
            HoseEnds { stretch: stretch.clone(), carries }
        };
        let hoses = tree.hoses.iter().map(hose_ends).collect();
        let forces = tree.forces.clone();
        Self { parents, forces, gravity: *gravity, nodes, turning, loop_ends, hoses }
    }
}
