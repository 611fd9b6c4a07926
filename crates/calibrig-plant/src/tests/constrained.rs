//! The pose at rest of the whole robot, found without rapier and without the plant's tree: Newton's method on the potential energy of all
//! springs, weights and forces, the rod being a spring between two points or, where it is rigid, a constraint with a multiplier.
//!
//! The chain is a product of constant matrices and of elementary motions `exp(q G)`. A point p behind the motion i has `∂p/∂qᵢ = Sᵢ p` and
//! `∂²p/∂qᵢ∂qⱼ = Sᵢ Sⱼ p` for i in front of j, where `Sᵢ = Tᵢ Gᵢ Tᵢ⁻¹`.

use nalgebra::{DMatrix, DVector, Matrix4, Vector3, Vector4};

use super::AsBuilt;
use super::equilibrium::{point, shift, turn};
use crate::effects::{Anchor, Hose, StiffnessCurve};
use calibrig_model::{BeamRun, BearingSide, JointKind};

#[derive(Clone)]
enum Factor {
    Constant(Matrix4<f64>),
    /// Along (0..3) or about (3..6) x, y, z, by the coordinate of that index.
    Motion(usize, usize),
}

/// Something at a point behind the first so many factors of the main chain (0) or of the crank's (1).
struct Load {
    chain: usize,
    behind: usize,
    at: Vector3<f64>,
    force: Vector3<f64>,
}

/// An unknown: its stiffness and where it rests.
struct Spring {
    stiffness: f64,
    rest: f64,
    /// Where a drive stiffens: deflection from which on its stiffness is greater, and by how much.
    hinges: Vec<(f64, f64)>,
}

impl Spring {
    /// Energy, force and stiffness at a deflection.
    fn at(&self, u: f64) -> [f64; 3] {
        let mut sum = [0.5 * self.stiffness * u * u, self.stiffness * u, self.stiffness];
        for (begin, more) in self.hinges.iter().filter(|(begin, _)| u.abs() > *begin) {
            let beyond = u.abs() - begin;
            let own = [0.5 * more * beyond * beyond, more * beyond * u.signum(), *more];
            sum.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
        }
        sum
    }

    /// Gives it the ranges of a joint's drive, where that stiffens.
    fn stiffen(&mut self, robot: &AsBuilt, joint: usize) {
        let curve = robot.effects.stiffening.as_ref().and_then(|effect| effect.actuators[joint].as_ref());
        let Some(StiffnessCurve { factors, limits }) = curve else { return };
        let own = self.stiffness;
        self.stiffness = factors[0] * own;
        let (mut begin, mut load) = (0.0, 0.0);
        for (range, limit) in limits.iter().enumerate() {
            begin += (limit - load) / (factors[range] * own);
            load = *limit;
            self.hinges.push((begin, (factors[range + 1] - factors[range]) * own));
        }
    }
}

pub(super) struct Constrained<'a> {
    robot: &'a AsBuilt,
    chains: [Vec<Factor>; 2],
    loads: Vec<Load>,
    springs: Vec<Spring>,
    /// Number of factors up to every link's frame.
    links: Vec<usize>,
    /// Ends (as loads without a force) of every hose with its stiffness and free length.
    hoses: Vec<([Load; 2], f64, f64)>,
    /// Ends of crank and lever (as loads without a force), the rod's length and stiffness, and the unknown of the elbow.
    rod: Option<(Load, Load, f64, f64, usize)>,
}

/// Value, gradient and Hessian.
type Second = (f64, DVector<f64>, DMatrix<f64>);

impl<'a> Constrained<'a> {
    /// At a command, with the links shifted behind their joints.
    pub(super) fn new(robot: &'a AsBuilt, command: &[f64], shifts: &[[f64; 6]]) -> Self {
        let mut this = Self {
            robot,
            chains: [Vec::new(), Vec::new()],
            loads: Vec::new(),
            springs: Vec::new(),
            links: Vec::new(),
            hoses: Vec::new(),
            rod: None,
        };
        if let Some(foundation) = &robot.effects.foundation {
            this.group(foundation.at, foundation.stiffness);
        }
        this.constant(robot.kinematics.base_from_first.to_homogeneous());
        let four_bar = robot.actuators.four_bar();
        let mut elbow_unknown = 0;
        for (joint, &command_here) in command.iter().enumerate() {
            let link = &robot.kinematics.links[joint];
            let bearing = &robot.statics.bearings[joint];
            let own = if link.kind == JointKind::Prismatic { 2 } else { 5 };
            let mut stiffness = this.carried(joint, command_here);
            stiffness[own] = f64::INFINITY;
            this.constant(turn(0, link.alpha) * shift(0, link.a) * turn(1, link.beta));
            this.constant(turn(2, link.theta) * shift(2, link.d));
            if bearing.side == BearingSide::Fixed {
                this.group(Vector3::z() * bearing.at, stiffness);
            }
            if let Some((shoulder, .., linkage)) = four_bar
                && shoulder == joint
            {
                this.chains[1] = this.chains[0].clone();
                let axis = linkage.axis;
                let off = shift(0, axis.x) * shift(1, axis.y) * turn(0, axis.rx) * turn(1, axis.ry);
                this.chains[1].push(Factor::Constant(off));
            }
            match four_bar {
                Some((shoulder, elbow, offset, _)) if elbow == joint => {
                    elbow_unknown = this.springs.len();
                    let ideal = command_here + offset - command[shoulder];
                    this.motion(own, 0.0, ideal);
                }
                _ => this.drive(own, joint, command_here),
            }
            if let Some([x, y, z, rx, ry, rz]) = shifts.get(joint) {
                let by = shift(0, *x) * shift(1, *y) * shift(2, *z);
                this.constant(by * turn(0, *rx) * turn(1, *ry) * turn(2, *rz));
            }
            if bearing.side == BearingSide::Moving {
                this.group(Vector3::z() * bearing.at, stiffness);
            }
            this.body_and_beam(joint, command_here);
            this.links.push(this.chains[0].len());
        }
        for load in &robot.statics.loads {
            let force = load.force + load.mass * robot.statics.gravity;
            this.loads.push(Load { chain: 0, behind: this.links[load.link], at: load.at, force });
        }
        for Hose { ends, stiffness, free_length } in robot.effects.hoses.iter().flat_map(|hoses| &hoses.hoses)
        {
            let end = |Anchor { link, at }: Anchor| {
                let behind = link.map_or(0, |link| this.links[link]);
                Load { chain: 0, behind, at, force: Vector3::zeros() }
            };
            let ends = ends.map(end);
            this.hoses.push((ends, *stiffness, *free_length));
        }
        if let Some((_, elbow, offset, linkage)) = four_bar {
            let (main, springs) = (std::mem::take(&mut this.chains[0]), this.springs.len());
            // The same way of adding factors, to the crank's chain.
            this.chains.swap(0, 1);
            let zero = offset + robot.kinematics.links[elbow].theta;
            this.drive(5, elbow, command[elbow] + zero);
            assert!(this.springs.len() <= springs + 1);
            this.chains.swap(0, 1);
            this.chains[0] = main;
            let (crank_end, lever_end) = (this.chains[1].len(), this.links[elbow]);
            let end = |chain, behind, at| Load { chain, behind, at, force: Vector3::zeros() };
            let mut rod_stiffness = f64::INFINITY;
            if let Some(statics) = &robot.statics.linkage {
                rod_stiffness = statics.rod_stiffness;
                let half = 0.5 * statics.rod_mass * robot.statics.gravity;
                let weight = statics.crank.mass * robot.statics.gravity;
                let crank = |at, force| Load { chain: 1, behind: crank_end, at, force };
                this.loads.push(crank(statics.crank.centre_of_mass, weight));
                this.loads.push(crank(linkage.crank.end(), half));
                this.loads.push(Load { chain: 0, behind: lever_end, at: linkage.lever.end(), force: half });
            }
            this.rod = Some((
                end(1, crank_end, linkage.crank.end()),
                end(0, lever_end, linkage.lever.end()),
                linkage.rod,
                rod_stiffness,
                elbow_unknown,
            ));
        }
        this
    }

    /// The bearing's stiffnesses, along x and y in series with the rail that bends between its feet.
    fn carried(&self, joint: usize, q: f64) -> [f64; 6] {
        let mut stiffness = self.robot.statics.bearings[joint].stiffness;
        let rail = self.robot.effects.foundation.as_ref().and_then(|foundation| foundation.rail.as_ref());
        let Some(rail) = rail.filter(|rail| rail.joint == joint) else { return stiffness };
        let feet = ((q - rail.first_foot) / rail.span).floor();
        let a = q - rail.first_foot - feet * rail.span;
        let b = rail.span - a;
        for (stiffness, compliance) in stiffness.iter_mut().zip(rail.compliance) {
            // Deflection under a load at a, of a clamped beam of EI with that of the middle given: EI = l³ / (192 c).
            let rigidity = rail.span.powi(3) / (192.0 * compliance);
            let sag = a.powi(3) * b.powi(3) / (3.0 * rigidity * rail.span.powi(3));
            *stiffness = 1.0 / (1.0 / *stiffness + sag);
        }
        stiffness
    }

    fn constant(&mut self, matrix: Matrix4<f64>) {
        self.chains[0].push(Factor::Constant(matrix));
    }

    fn drive(&mut self, axis: usize, joint: usize, rest: f64) {
        let (robot, stiffness) = (self.robot, self.robot.statics.drive_stiffness[joint]);
        self.motion(axis, stiffness, rest);
        if let Some(spring) = self.springs.last_mut().filter(|_| stiffness.is_finite()) {
            spring.stiffen(robot, joint);
        }
    }

    fn motion(&mut self, axis: usize, stiffness: f64, rest: f64) {
        let factor = if stiffness.is_infinite() {
            Factor::Constant(if axis < 3 { shift(axis, rest) } else { turn(axis - 3, rest) })
        } else {
            self.springs.push(Spring { stiffness, rest, hinges: Vec::new() });
            Factor::Motion(axis, self.springs.len() - 1)
        };
        self.chains[0].push(factor);
    }

    fn group(&mut self, at: Vector3<f64>, stiffness: [f64; 6]) {
        let there = Matrix4::new_translation(&at);
        self.constant(there);
        for (axis, stiffness) in stiffness.into_iter().enumerate() {
            self.motion(axis, stiffness, 0.0);
        }
        self.constant(Matrix4::new_translation(&-at));
    }

    fn weight(&mut self, mass: f64, at: Vector3<f64>) {
        let (behind, force) = (self.chains[0].len(), mass * self.robot.statics.gravity);
        self.loads.push(Load { chain: 0, behind, at, force });
    }

    fn body_and_beam(&mut self, joint: usize, q: f64) {
        let body = &self.robot.statics.bodies[joint];
        let Some(beam) = &self.robot.statics.beams[joint] else {
            return self.weight(body.mass, body.centre_of_mass);
        };
        let lengths: Vec<f64> = beam.segments.iter().map(|segment| segment.length.at(q)).collect();
        let (axis, mut root) = match beam.run {
            BeamRun::AlongX => (Vector3::x(), 0.0),
            BeamRun::EndsAtOrigin => (Vector3::z(), -lengths.iter().sum::<f64>()),
        };
        // The rest of the body hangs as a force and a moment's worth of weight where the beam begins.
        let (mut mass, mut moment) = (body.mass, body.mass * body.centre_of_mass);
        let mut middle = root;
        for (segment, length) in beam.segments.iter().zip(&lengths) {
            let weight = segment.section.mass_per_length * length;
            mass -= weight;
            moment -= weight * (middle + length / 2.0) * axis;
            middle += length;
        }
        self.weight(mass, moment / mass);
        for (segment, length) in beam.segments.iter().zip(&lengths) {
            let section = &segment.section;
            let half_mass = section.mass_per_length * length / 2.0;
            let soft = |shear: f64, bending: f64| length / shear + length.powi(3) / (12.0 * bending);
            // In section axes: (tension, shear, shear, torsion, bending, bending).
            let along = [
                section.axial / length,
                1.0 / soft(section.shear[0], section.bending[1]),
                1.0 / soft(section.shear[1], section.bending[0]),
            ];
            let about = [section.torsion, section.bending[0], section.bending[1]].map(|r| r / length);
            let stiffness = match beam.run {
                BeamRun::AlongX => [along[0], along[1], along[2], about[0], about[1], about[2]],
                BeamRun::EndsAtOrigin => [along[1], along[2], along[0], about[1], about[2], about[0]],
            };
            self.weight(half_mass, (root + length / 6.0) * axis);
            self.group((root + length / 2.0) * axis, stiffness);
            self.weight(half_mass, (root + length * 5.0 / 6.0) * axis);
            root += length;
        }
    }

    /// The frame behind every factor of a chain, beginning with the base.
    fn frames(&self, chain: usize, q: &DVector<f64>) -> Vec<Matrix4<f64>> {
        let mut frames = vec![Matrix4::identity()];
        for factor in &self.chains[chain] {
            let step = match *factor {
                Factor::Constant(matrix) => matrix,
                Factor::Motion(axis, i) if axis < 3 => shift(axis, q[i]),
                Factor::Motion(axis, i) => turn(axis - 3, q[i]),
            };
            frames.push(frames[frames.len() - 1] * step);
        }
        frames
    }

    /// A point with its first and second derivatives by its own unknowns.
    fn moved(load: &Load, frames: &[Matrix4<f64>], spatial: &[(usize, usize, Matrix4<f64>)]) -> Moved {
        let place = frames[load.behind] * point(&load.at);
        let motions: Vec<_> = spatial.iter().filter(|(factor, ..)| *factor < load.behind).collect();
        let first = motions.iter().map(|(_, i, s)| (*i, s * place)).collect::<Vec<_>>();
        let mut second = Vec::new();
        for (n, (i, _)) in first.iter().enumerate() {
            for (j, moved) in &first[n..] {
                second.push((*i, *j, (motions[n].2 * moved).xyz()));
            }
        }
        Moved { place, first, second }
    }

    fn spatial(&self, chain: usize, frames: &[Matrix4<f64>]) -> Vec<(usize, usize, Matrix4<f64>)> {
        let motions = self.chains[chain].iter().enumerate().filter_map(|(at, factor)| match *factor {
            Factor::Constant(_) => None,
            Factor::Motion(axis, i) => {
                let mut generator = Matrix4::zeros();
                if axis < 3 {
                    generator[(axis, 3)] = 1.0;
                } else {
                    let (u, v) = ((axis - 2) % 3, (axis - 1) % 3);
                    generator[(u, v)] = -1.0;
                    generator[(v, u)] = 1.0;
                }
                Some((at, i, frames[at] * generator * frames[at].try_inverse().expect("rigid")))
            }
        });
        motions.collect()
    }

    /// The potential energy without a rigid rod, and the rod's length beyond its own, with their derivatives.
    pub(super) fn energy_and_gap(&self, q: &DVector<f64>) -> (Second, Option<Second>) {
        let n = self.springs.len();
        let frames = [self.frames(0, q), self.frames(1, q)];
        let spatial = [self.spatial(0, &frames[0]), self.spatial(1, &frames[1])];
        let moved = |load: &Load| Self::moved(load, &frames[load.chain], &spatial[load.chain]);
        let (mut energy, mut gradient, mut hessian) = (0.0, DVector::zeros(n), DMatrix::zeros(n, n));
        for (i, spring) in self.springs.iter().enumerate() {
            let [stored, force, stiffness] = spring.at(q[i] - spring.rest);
            energy += stored;
            gradient[i] += force;
            hessian[(i, i)] += stiffness;
        }
        for load in &self.loads {
            let moved = moved(load);
            energy -= load.force.dot(&moved.place.xyz());
            for (i, first) in &moved.first {
                gradient[*i] -= load.force.dot(&first.xyz());
            }
            for (i, j, second) in &moved.second {
                add_symmetric(&mut hessian, *i, *j, -load.force.dot(second));
            }
        }
        let mut stretch = |stiffness: f64, (by, slope, curvature): &Second| {
            energy += 0.5 * stiffness * by * by;
            gradient += stiffness * *by * slope;
            hessian += stiffness * (slope * slope.transpose() + *by * curvature);
        };
        for ([one, other], stiffness, free_length) in &self.hoses {
            let longer = beyond([moved(one), moved(other)], *free_length, n);
            if longer.0 > 0.0 {
                stretch(*stiffness, &longer);
            }
        }
        let gap = self
            .rod
            .as_ref()
            .map(|(crank, lever, length, ..)| beyond([moved(crank), moved(lever)], *length, n));
        if let (Some(gap), Some((.., stiffness, _))) = (&gap, &self.rod)
            && stiffness.is_finite()
        {
            stretch(*stiffness, gap);
        }
        ((energy, gradient, hessian), gap)
    }

    /// Without deflections; the loop closed by the root of `a cos q + b sin q = c` next to the ideal elbow, by its half angle.
    pub(super) fn unloaded(&self) -> DVector<f64> {
        let mut q = DVector::from_iterator(self.springs.len(), self.springs.iter().map(|spring| spring.rest));
        if let Some((crank, lever, rod, _, elbow)) = &self.rod {
            // Three points of the circle of the lever's end about the elbow's axis give the coefficients of its squared distance.
            let mut squared = |angle: f64| {
                q[*elbow] = self.springs[*elbow].rest + angle;
                let ends = [(lever, 0), (crank, 1)]
                    .map(|(end, chain)| (self.frames(chain, &q)[end.behind] * point(&end.at)).xyz());
                (ends[0] - ends[1]).norm_squared()
            };
            let quarter = std::f64::consts::FRAC_PI_2;
            let (zero, left, opposite) = (squared(0.0), squared(quarter), squared(2.0 * quarter));
            let mean = f64::midpoint(zero, opposite);
            let (a, b, c) = (zero - mean, left - mean, rod * rod - mean);
            let root = (a * a + b * b - c * c).sqrt();
            let angles = [root, -root].map(|root| 2.0 * ((b + root) / (a + c)).atan());
            let least = if angles[0].abs() < angles[1].abs() { angles[0] } else { angles[1] };
            q[*elbow] = self.springs[*elbow].rest + least;
        }
        q
    }

    /// The unknowns at rest, and the force of a rod, N.
    pub(super) fn solve(&self) -> (DVector<f64>, Option<f64>) {
        let n = self.springs.len();
        let mut q = self.unloaded();
        let mut force = 0.0;
        for _ in 0..60 {
            let ((_, gradient, hessian), gap) = self.energy_and_gap(&q);
            let rigid = gap.as_ref().filter(|_| self.rod.as_ref().is_some_and(|rod| rod.3.is_infinite()));
            let rows = n + usize::from(rigid.is_some());
            let (mut matrix, mut right) = (DMatrix::zeros(rows, rows), DVector::zeros(rows));
            matrix.view_mut((0, 0), (n, n)).copy_from(&hessian);
            right.rows_mut(0, n).copy_from(&-gradient);
            if let Some((gap, slope, curvature)) = rigid {
                let mut block = matrix.view_mut((0, 0), (n, n));
                block += force * curvature;
                matrix.view_mut((0, n), (n, 1)).copy_from(slope);
                matrix.view_mut((n, 0), (1, n)).copy_from(&slope.transpose());
                let mut upper = right.rows_mut(0, n);
                upper -= force * slope;
                right[n] = -gap;
            }
            // Rows and columns in units of their own stiffness.
            let scale = DVector::from_fn(rows, |i, _| {
                let own: f64 = matrix[(i, i)];
                if own.abs() > 1.0 { own.abs().sqrt().recip() } else { 1.0 }
            });
            let scaled = DMatrix::from_fn(rows, rows, |i, j| matrix[(i, j)] * scale[i] * scale[j]);
            let step =
                scaled.lu().solve(&right.component_mul(&scale)).expect("regular").component_mul(&scale);
            q += step.rows(0, n);
            if rigid.is_some() {
                force += step[n];
            }
            if step.rows(0, n).amax() < 3e-14 {
                let elastic = self.rod.as_ref().filter(|rod| rod.3.is_finite());
                let spring = elastic.zip(gap).map(|(rod, gap)| rod.3 * gap.0);
                return (q, self.rod.as_ref().map(|_| spring.unwrap_or(force)));
            }
        }
        panic!("Newton's method did not converge");
    }

    /// The target in the base frame, m.
    pub(super) fn target(&self, q: &DVector<f64>) -> Vector3<f64> {
        let last = self.frames(0, q)[self.links[self.links.len() - 1]];
        let flange = self.robot.kinematics.last_from_flange.to_homogeneous();
        (last * flange * point(&self.robot.target)).xyz()
    }

    /// Frames of all links.
    pub(super) fn link_frames(&self, q: &DVector<f64>) -> Vec<Matrix4<f64>> {
        let frames = self.frames(0, q);
        self.links.iter().map(|&behind| frames[behind]).collect()
    }

    pub(super) fn unknowns(&self) -> usize {
        self.springs.len()
    }
}

struct Moved {
    place: Vector4<f64>,
    first: Vec<(usize, Vector4<f64>)>,
    second: Vec<(usize, usize, Vector3<f64>)>,
}

/// By how much the distance of two points is longer than a length, with its derivatives by all n unknowns.
fn beyond([one, other]: [Moved; 2], length: f64, n: usize) -> Second {
    let between = (other.place - one.place).xyz();
    let distance = between.norm();
    let mut columns = DMatrix::zeros(3, n);
    let mut curvature = DMatrix::zeros(n, n);
    for (end, sign) in [(other, 1.0), (one, -1.0)] {
        for (i, first) in &end.first {
            let mut column = columns.column_mut(*i);
            column += sign * first.xyz();
        }
        for (i, j, second) in &end.second {
            add_symmetric(&mut curvature, *i, *j, sign * between.dot(second) / distance);
        }
    }
    let slope: DVector<f64> = columns.tr_mul(&DVector::from_column_slice(between.as_slice())) / distance;
    curvature += columns.tr_mul(&columns) / distance - &slope * slope.transpose() / distance;
    (distance - length, slope, curvature)
}

fn add_symmetric(matrix: &mut DMatrix<f64>, i: usize, j: usize, value: f64) {
    matrix[(i, j)] += value;
    if i != j {
        matrix[(j, i)] += value;
    }
}
