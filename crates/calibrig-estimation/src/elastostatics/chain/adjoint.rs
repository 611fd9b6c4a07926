//! How the target moves with every parameter, the change of the equilibrium included.
//!
//! The equilibrium is `u = C Q(u, θ)`; the target moves by `p_θ + p_u du`. With μ solving `μ = p_u + H λ`, `λ = C μ` (H the symmetric
//! matrix `∂Q/∂u`) the total is `p_θ + Σ λ_k ∂Q_k/∂θ + Σ μ_k Q_k dc_k`: `μ_k` is what a displacement in series with spring k does to the target.
//! The iteration over λ converges as fast as the equilibrium does.
//!
//! A four-bar adds the elbow's angle with its balance, whose multiplier is λ of the elbow, and the rod's force with its condition, whose
//! multiplier is ρ.

use nalgebra::{Matrix3, Vector3};

use super::loads::Loads;
use super::structure::Slot;
use super::{Deflection, ElasticChain, ElasticError, MOST_ITERATIONS, ROUNDED};
use crate::kinematics::{Screw, TARGET, finite};
use calibrig_model::{ActuatorMap, Compliance, LinkTerm, LinkageTerm, ModelError, ParameterId, TermPlace};

/// Change of a sweep, relative to the largest entry, below which the adjoint has converged: what is left is a hundredth of it.
const ADJOINT_CONVERGED: f64 = 1e-10;
/// Sweeps in which the change may grow before a smaller share of it is taken.
const GROWS_AT_FIRST: usize = 3;
/// The smallest share: for loads that turn back 64 times what the springs do.
const LEAST_SHARE: f64 = 1.0 / 64.0;

/// Sums along the chain inboard of a slot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inboard {
    /// `Σ λ_k a_kᵀ` over rotations.
    pub turns: Matrix3<f64>,
    /// `Σ λ_k (J_k 0)ᵀ`.
    pub shifts: Matrix3<f64>,
}

impl Inboard {
    fn none() -> Self {
        Self { turns: Matrix3::zeros(), shifts: Matrix3::zeros() }
    }

    #[inline]
    fn add(&mut self, lambda: &Vector3<f64>, screw: &Screw) {
        if screw.about {
            self.turns += lambda * screw.axis.transpose();
        }
        self.shifts += lambda * screw.moves_origin().transpose();
    }

    /// Row r is what the r-th component of λ does to a point.
    fn moves(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        self.turns * point.cross_matrix() + self.shifts
    }
}

/// Of what the sensitivities are.
#[derive(Debug, Clone, Copy)]
pub(super) enum Seen {
    /// The place of a target that is now at this point of the base frame, m.
    Place(Vector3<f64>),
    /// The rotation of the flange, as a rotation vector in base axes.
    Turn,
}

impl Seen {
    /// What a unit of a motion that carries the flange does to it.
    #[inline]
    pub fn moved_by(&self, screw: &Screw) -> Vector3<f64> {
        match self {
            Self::Place(target) => screw.moves(target),
            Self::Turn => screw.turns(),
        }
    }
}

/// Sensitivities of the target, one vector of three a slot.
#[derive(Debug, Clone)]
pub(super) struct Adjoint {
    pub seen: Seen,
    /// Whether the deflections follow the loads.
    pub coupled: bool,
    /// What each slot does to the target at the others' deflections held.
    direct: Vec<Vector3<f64>>,
    /// What each slot does to the lever's end relative to the crank's, and to their distance.
    rod_moves: Vec<Vector3<f64>>,
    rod_stretch: Vec<f64>,
    /// Loads outboard of each slot, and [`Loads::turned_by`] it.
    pub outboard: Vec<Loads>,
    turned: Vec<Vector3<f64>>,
    pub mu: Vec<Vector3<f64>>,
    lambda: Vec<Vector3<f64>>,
    next: Vec<Vector3<f64>>,
    /// Sums over the slots in front of each, and of all at the end.
    pub inboard: Vec<Inboard>,
    /// The same for what the crank carries.
    crank_inboard: Inboard,
    /// `Σ λ_k turned_kᵀ` over each slot and those behind it.
    behind: Vec<Matrix3<f64>>,
    rho: Vector3<f64>,
    /// What the relative displacement of the rod's ends does to the target, with the sign changed.
    rod: Matrix3<f64>,
}

impl Adjoint {
    pub fn new(n: usize) -> Self {
        let vectors = || vec![Vector3::zeros(); n];
        Self {
            seen: Seen::Place(Vector3::zeros()),
            coupled: false,
            direct: vectors(),
            rod_moves: vectors(),
            rod_stretch: vec![0.0; n],
            outboard: vec![Loads::none(); n],
            turned: vectors(),
            mu: vectors(),
            lambda: vectors(),
            next: vectors(),
            inboard: vec![Inboard::none(); n + 1],
            crank_inboard: Inboard::none(),
            behind: vec![Matrix3::zeros(); n],
            rho: Vector3::zeros(),
            rod: Matrix3::zeros(),
        }
    }
}

impl ElasticChain {
    /// Solves for the sensitivities of the target at `in_flange`; the columns that follow are this target's.
    ///
    /// They are derivatives of the settled position: exact for [`Deflection::None`], for [`Deflection::Equilibrium`] and after
    /// [`settle_at`](Self::settle_at), whose deflections are held. For [`Deflection::FirstOrder`] they are those of an equilibrium at the deflected place, and so in
    /// error by second order.
    ///
    /// # Errors
    ///
    /// [`ElasticError::NotSettled`] if the equilibrium is hardly stable; [`ElasticError::Model`] for a target at no finite place.
    pub fn prepare(&mut self, in_flange: &Vector3<f64>) -> Result<(), ElasticError> {
        finite(TARGET, None, in_flange.as_slice())?;
        self.differentiate(in_flange)
    }

    /// [`prepare`](Self::prepare) for a target that is known to be at a finite place.
    pub(crate) fn differentiate(&mut self, in_flange: &Vector3<f64>) -> Result<(), ElasticError> {
        self.look_at(Seen::Place(self.target(in_flange)))
    }

    /// Solves for the sensitivities of the flange's rotation: the columns that follow are rotation vectors in base axes, rad per unit, until
    /// the next call of [`prepare`](Self::prepare). A target is turned as the flange that carries it.
    ///
    /// # Errors
    ///
    /// [`ElasticError::NotSettled`] if the equilibrium is hardly stable.
    pub fn prepare_turn(&mut self) -> Result<(), ElasticError> {
        self.look_at(Seen::Turn)
    }

    fn look_at(&mut self, seen: Seen) -> Result<(), ElasticError> {
        self.adjoint.seen = seen;
        self.adjoint.coupled = self.deflection != Deflection::None;
        self.adjoint.lambda.fill(Vector3::zeros());
        self.adjoint.mu.fill(Vector3::zeros());
        self.set_direct();
        // What a sweep gives where λ is zero.
        self.adjoint.next.copy_from_slice(&self.adjoint.direct);
        self.adjoint.rod.fill(0.0);
        if !self.adjoint.coupled {
            self.closed.force = 0.0;
            self.take_over(1.0);
            return Ok(());
        }
        self.set_curvature();
        let (mut share, mut most) = (1.0, MOST_ITERATIONS);
        loop {
            match self.solve(share, most) {
                Ok(()) => {
                    self.sum_up();
                    return Ok(());
                }
                Err(error) if share <= LEAST_SHARE => return Err(error),
                Err(_) => {
                    (share, most) = (0.5 * share, 2 * most);
                    self.adjoint.lambda.fill(Vector3::zeros());
                    self.adjoint.next.copy_from_slice(&self.adjoint.direct);
                    self.adjoint.rod.fill(0.0);
                }
            }
        }
    }

    /// Sweeps until nothing changes, at `most` so often, taking a `share` of every change. With all of it, what a soft and hanging load turns
    /// back is overshot; the eigenvalues of the sweep are real and, in a stable chain, below one, so that a small enough share converges.
    fn solve(&mut self, share: f64, most: usize) -> Result<(), ElasticError> {
        let mut change = self.take_over(1.0);
        for iterations in 1..=most {
            self.sweep();
            let before = std::mem::replace(&mut change, self.take_over(share));
            // What is left is the change over one minus the contraction.
            if change <= ADJOINT_CONVERGED * share * share {
                return Ok(());
            }
            if iterations > GROWS_AT_FIRST && !(change < before || change <= ROUNDED) {
                break;
            }
        }
        Err(ElasticError::NotSettled { iterations: most, residual: change })
    }

    fn set_direct(&mut self) {
        let a = &mut self.adjoint;
        for (slot, screw) in self.screws.iter().enumerate() {
            a.direct[slot] = match self.slots[slot] {
                Slot::Elastic => a.seen.moved_by(screw),
                Slot::Crank | Slot::Mark => Vector3::zeros(),
            };
        }
        let Some(four_bar) = &self.four_bar else { return };
        let ends = &self.closed;
        for (slot, screw) in self.screws[..four_bar.reach].iter().enumerate() {
            let moves = match self.slots[slot] {
                Slot::Mark => continue,
                Slot::Crank => -screw.moves(&ends.crank_end),
                Slot::Elastic if slot < four_bar.crank => {
                    screw.moves(&ends.lever_end) - screw.moves(&ends.crank_end)
                }
                Slot::Elastic => screw.moves(&ends.lever_end),
            };
            a.rod_moves[slot] = moves;
            a.rod_stretch[slot] = ends.rod.dot(&moves);
        }
    }

    /// Second derivatives of the loads' potential.
    fn set_curvature(&mut self) {
        let a = &mut self.adjoint;
        let mut outboard = Loads::none();
        let mut loads = self.loads.iter().rev().peekable();
        for (slot, kind) in self.slots.iter().enumerate().rev() {
            while let Some(load) = loads.next_if(|l| l.inboard > slot) {
                outboard.add(load);
            }
            if *kind == Slot::Crank {
                let crank = self.closed.crank_loads();
                a.outboard[slot] = crank;
                outboard.add_all(&crank);
            } else {
                a.outboard[slot] = outboard;
            }
            if *kind != Slot::Mark {
                a.turned[slot] = a.outboard[slot].turned_by(&self.screws[slot]);
            }
        }
    }

    /// `next = p_u + H λ`.
    fn sweep(&mut self) {
        let Self { slots, screws, four_bar, closed, adjoint: a, .. } = self;
        let reach = four_bar.as_ref().map_or(0, |f| f.reach);
        let (mut sums, mut lever, mut crank) = (Inboard::none(), Matrix3::zeros(), Matrix3::zeros());
        for (slot, kind) in slots.iter().enumerate() {
            if slot == reach {
                lever = sums.moves(&closed.lever_end);
            }
            let screw = &screws[slot];
            match kind {
                Slot::Mark => {}
                Slot::Elastic => {
                    if slot < reach {
                        sums.add(&a.lambda[slot], screw);
                    } else if screw.about {
                        sums.turns += a.lambda[slot] * screw.axis.transpose();
                    }
                    a.next[slot] = a.direct[slot] + sums.turns * a.turned[slot];
                }
                Slot::Crank => {
                    let mut branch = sums;
                    branch.add(&a.lambda[slot], screw);
                    a.next[slot] = branch.turns * a.turned[slot];
                    crank = branch.moves(&closed.crank_end);
                }
            }
        }
        if reach == slots.len() {
            lever = sums.moves(&closed.lever_end);
        }
        let mut behind = Matrix3::zeros();
        for (slot, kind) in slots.iter().enumerate().rev() {
            if *kind == Slot::Mark {
                continue;
            }
            let screw = &screws[slot];
            if *kind == Slot::Elastic && screw.about {
                a.next[slot] += behind * screw.axis;
            }
            behind += a.lambda[slot] * a.turned[slot].transpose();
        }
        if four_bar.is_none() {
            return;
        }
        // The rod's force turns with the rod.
        let along = (lever - crank) * closed.rod;
        a.rod = (closed.force / closed.length) * (lever - crank - along * closed.rod.transpose());
        for (next, moves) in a.next.iter_mut().zip(&a.rod_moves[..reach]) {
            *next -= a.rod * moves;
        }
    }

    /// μ, ρ and a `share` of the change of λ from `next`; tells the largest change of μ relative to its largest entry.
    fn take_over(&mut self, share: f64) -> f64 {
        let a = &mut self.adjoint;
        let elbow = self.four_bar.as_ref().map(|f| self.links[f.elbow].drive);
        a.rho = elbow.map_or_else(Vector3::zeros, |slot| a.next[slot] / self.closed.rate);
        // Axis by axis, so that several are compared at a time.
        let (mut changes, mut most) = (Vector3::zeros(), Vector3::zeros());
        for ((next, stretch), mu) in a.next.iter().zip(&a.rod_stretch).zip(&mut a.mu) {
            let now = next - a.rho * *stretch;
            for axis in 0..3 {
                changes[axis] = f64::max(changes[axis], (now[axis] - mu[axis]).abs());
                most[axis] = f64::max(most[axis], now[axis].abs());
            }
            *mu = now;
        }
        let (change, largest) = (changes.max(), most.max());
        if !a.coupled {
            return change / largest.max(f64::MIN_POSITIVE);
        }
        let towards = |from: Vector3<f64>, to: Vector3<f64>| {
            if share < 1.0 { from + share * (to - from) } else { to }
        };
        let before = elbow.map(|slot| a.lambda[slot]);
        let mut stretch = Vector3::zeros();
        for (((lambda, compliance), mu), rod) in
            a.lambda.iter_mut().zip(&self.compliance).zip(&a.mu).zip(&a.rod_stretch)
        {
            let now = *compliance * mu;
            stretch += now * *rod;
            *lambda = towards(*lambda, now);
        }
        if let (Some(four_bar), Some(elbow), Some(before)) = (&self.four_bar, elbow, before) {
            // The elbow's own compliance is zero: its λ is not in the sum.
            a.lambda[elbow] = towards(before, (four_bar.compliance * a.rho - stretch) / self.closed.rate);
        }
        change / largest.max(f64::MIN_POSITIVE)
    }

    fn sum_up(&mut self) {
        let Self { slots, screws, adjoint: a, .. } = self;
        let mut sums = Inboard::none();
        for (slot, kind) in slots.iter().enumerate() {
            a.inboard[slot] = sums;
            match kind {
                Slot::Mark => {}
                Slot::Elastic => sums.add(&a.lambda[slot], &screws[slot]),
                Slot::Crank => {
                    a.crank_inboard = sums;
                    a.crank_inboard.add(&a.lambda[slot], &screws[slot]);
                }
            }
        }
        a.inboard[slots.len()] = sums;
        let mut behind = Matrix3::zeros();
        for (slot, kind) in slots.iter().enumerate().rev() {
            if *kind != Slot::Mark {
                behind += a.lambda[slot] * a.turned[slot].transpose();
            }
            a.behind[slot] = behind;
        }
    }

    /// Change of the target's position in the base frame (m) per unit of a parameter.
    ///
    /// Parameters of the tracker's frame, of how the target is turned on the flange, and of terms are the caller's: these columns are zero. A term's is its basis times
    /// [`column_of_place`](Self::column_of_place).
    ///
    /// # Errors
    ///
    /// [`ModelError::Parameter`], of a joint that the robot does not have.
    pub fn column(&self, id: ParameterId) -> Result<Vector3<f64>, ModelError> {
        self.knows(id)?;
        Ok(self.change(id))
    }

    /// [`column`](Self::column) of a parameter of the robot.
    pub(crate) fn change(&self, id: ParameterId) -> Vector3<f64> {
        match id {
            ParameterId::Link { link, term } => self.link_column(link, term),
            ParameterId::Target { axis, .. } => match self.adjoint.seen {
                Seen::Place(_) => self.kinematics.flange_axis(axis),
                Seen::Turn => Vector3::zeros(),
            },
            ParameterId::Compliance(compliance) => self.compliance_column(compliance),
            ParameterId::Mass { link } => self.mass_column(link),
            ParameterId::Centre { link, axis } => self.centre_column(link, axis),
            ParameterId::Linkage(term) => self.linkage_column(term),
            ParameterId::Frame { .. }
            | ParameterId::Orientation { .. }
            | ParameterId::Term(_)
            | ParameterId::Instrument { .. }
            | ParameterId::Drift { .. } => Vector3::zeros(),
        }
    }

    /// Change of the target's position in the base frame (m) per unit of a [correction](Self::settle).
    ///
    /// # Errors
    ///
    /// [`ModelError`], of a joint that the robot does not have.
    pub fn column_of_place(&self, place: TermPlace) -> Result<Vector3<f64>, ModelError> {
        self.has(place)?;
        Ok(self.change_of_place(place))
    }

    /// [`column_of_place`](Self::column_of_place) of a place of the robot.
    pub(crate) fn change_of_place(&self, place: TermPlace) -> Vector3<f64> {
        match place {
            TermPlace::Frame { joint, component } => {
                self.moved_at(self.links[joint].frame, &self.places[joint].correction[component])
            }
            TermPlace::Actuator(joint) => {
                let mu = |joint: usize| self.adjoint.mu[self.driven(joint)];
                let by_actuator = |actuator: usize| match self.actuators.elbow() {
                    // The ideal coupling turns the elbow back.
                    Some(drive) if actuator == drive.shoulder && self.four_bar.is_none() => {
                        mu(drive.shoulder) - mu(drive.elbow)
                    }
                    _ => mu(actuator),
                };
                match &self.actuators {
                    ActuatorMap::Axes { axes, .. } => (0..self.links.len())
                        .map(|actuator| axes.rate(actuator, joint) * by_actuator(actuator))
                        .sum(),
                    _ => by_actuator(joint),
                }
            }
        }
    }

    fn link_column(&self, link: usize, term: LinkTerm) -> Vector3<f64> {
        let moved = self.moved_at(self.links[link].terms, &self.kinematics.screw(link, term));
        match &self.four_bar {
            // The elbow's zero is the crank's.
            Some(four_bar) if four_bar.elbow == link && term == LinkTerm::Theta => {
                moved + self.adjoint.mu[four_bar.crank]
            }
            _ => moved,
        }
    }

    /// What a unit of a motion at a mark does to the target.
    fn moved_at(&self, slot: usize, screw: &Screw) -> Vector3<f64> {
        let a = &self.adjoint;
        let mut column = a.seen.moved_by(screw);
        if a.coupled {
            column += a.inboard[slot].turns * a.outboard[slot].turned_by(screw);
            if screw.about {
                column += a.behind[slot] * screw.axis;
            }
        }
        if let Some(four_bar) = &self.four_bar
            && slot < four_bar.reach
        {
            let mut moves = screw.moves(&self.closed.lever_end);
            if slot < four_bar.crank {
                moves -= screw.moves(&self.closed.crank_end);
            }
            column -= self.by_rod(&moves);
        }
        column
    }

    /// What a displacement of the lever's end relative to the crank's does to the target, with the sign changed.
    fn by_rod(&self, moves: &Vector3<f64>) -> Vector3<f64> {
        self.adjoint.rho * self.closed.rod.dot(moves) + self.adjoint.rod * moves
    }

    fn compliance_column(&self, compliance: Compliance) -> Vector3<f64> {
        let a = &self.adjoint;
        if !a.coupled {
            return Vector3::zeros();
        }
        let of_slot = |slot: usize| a.mu[slot] * (self.forces[slot] * self.reference[slot]);
        match compliance {
            Compliance::Drive { joint } => of_slot(self.driven(joint)),
            Compliance::Bearing { joint, axis } => {
                self.links[joint].bearing.slot(axis).map_or_else(Vector3::zeros, of_slot)
            }
            Compliance::Beam { link } => self.links[link].beam_slots().map(of_slot).sum(),
            Compliance::Rod => self.four_bar.as_ref().map_or_else(Vector3::zeros, |four_bar| {
                a.rho * (self.closed.force * four_bar.reference_compliance)
            }),
        }
    }

    fn mass_column(&self, link: usize) -> Vector3<f64> {
        let a = &self.adjoint;
        if !a.coupled {
            return Vector3::zeros();
        }
        let by_load = |load: usize| {
            let load = &self.loads[load];
            let (mass, moment) = load.reference;
            let inboard = &a.inboard[load.inboard];
            inboard.turns * moment.cross(&self.gravity) + inboard.shifts * (mass * self.gravity)
        };
        self.links[link].body_loads().map(by_load).sum()
    }

    fn centre_column(&self, link: usize, axis: usize) -> Vector3<f64> {
        let a = &self.adjoint;
        if !a.coupled {
            return Vector3::zeros();
        }
        let own = &self.links[link];
        let inboard = &a.inboard[self.loads[own.first_load].inboard];
        inboard.turns * (own.body.0 * self.places[link].body[axis]).cross(&self.gravity)
    }

    fn linkage_column(&self, term: LinkageTerm) -> Vector3<f64> {
        let Some(four_bar) = &self.four_bar else { return Vector3::zeros() };
        let (a, closed) = (&self.adjoint, &self.closed);
        // The loads at the moved end turn about all that is inboard.
        let (inboard, force, growth, sign) = match term {
            LinkageTerm::AxisX => return self.crank_axis_column(&closed.axis[0]),
            LinkageTerm::AxisY => return self.crank_axis_column(&closed.axis[1]),
            LinkageTerm::AxisRx => return self.crank_axis_column(&closed.axis[2]),
            LinkageTerm::AxisRy => return self.crank_axis_column(&closed.axis[3]),
            LinkageTerm::Rod => return a.rho,
            LinkageTerm::Lever => {
                let force = self.loads[four_bar.lever_load].direction;
                (&a.inboard[four_bar.reach], force, closed.lever_growth, 1.0)
            }
            LinkageTerm::Crank => {
                let force = 0.5 * four_bar.rod_mass * self.gravity + closed.force * closed.rod;
                (&a.crank_inboard, force, closed.crank_growth, -1.0)
            }
        };
        let mut column = -sign * self.by_rod(&growth);
        if a.coupled {
            column += inboard.turns * growth.cross(&force);
        }
        column
    }

    /// What a unit of a motion between the shoulder's frame and the crank does to the target.
    fn crank_axis_column(&self, screw: &Screw) -> Vector3<f64> {
        let Some(four_bar) = &self.four_bar else { return Vector3::zeros() };
        let a = &self.adjoint;
        let mut column = self.by_rod(&screw.moves(&self.closed.crank_end));
        if a.coupled {
            let crank = four_bar.crank;
            column += a.inboard[crank].turns * a.outboard[crank].turned_by(screw);
            if screw.about {
                column += a.lambda[crank] * a.turned[crank].dot(&screw.axis);
            }
        }
        column
    }
}
