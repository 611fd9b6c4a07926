//! The loads on the springs of a placed chain.

use super::ElasticChain;
use super::loads::Loads;
use super::place::LoopPlace;
use super::structure::Slot;

impl ElasticChain {
    /// The force of the rod that holds the elbow, and the generalised force on every spring.
    pub(super) fn balance(&mut self) {
        self.balance_elbow();
        let mut outboard = Loads::none();
        let mut loads = self.loads.iter().rev().peekable();
        for (slot, kind) in self.slots.iter().enumerate().rev() {
            while let Some(load) = loads.next_if(|l| l.inboard > slot) {
                outboard.add(load);
            }
            match kind {
                Slot::Elastic => self.forces[slot] = outboard.on(&self.screws[slot]),
                Slot::Crank => {
                    let crank = self.closed.crank_loads();
                    self.forces[slot] = crank.on(&self.screws[slot]);
                    outboard.add_all(&crank);
                }
                Slot::Mark => {}
            }
        }
    }

    /// The rod's tension follows from the balance of the free elbow alone; it becomes a load on the lever.
    fn balance_elbow(&mut self) {
        let Some(four_bar) = &self.four_bar else { return };
        self.loads[four_bar.lever_load].scale = 1.0;
        self.loads[four_bar.lever_load].direction = 0.5 * four_bar.rod_mass * self.gravity;
        let mut outboard = Loads::none();
        for load in &self.loads[four_bar.first_outboard..] {
            outboard.add(load);
        }
        let closed = &mut self.closed;
        closed.force = outboard.on(&self.screws[self.links[four_bar.elbow].drive]) / closed.rate;
        self.loads[four_bar.lever_load].direction -= closed.force * closed.rod;
    }

    /// Sets every spring to compliance times load.
    pub(super) fn yield_to_loads(&mut self) {
        for ((u, c), force) in self.u.iter_mut().zip(&self.compliance).zip(&self.forces) {
            *u = c * force;
        }
        if let Some(four_bar) = &self.four_bar {
            self.closed.extension = four_bar.compliance * self.closed.force;
        }
    }

    /// By how much deflections differ from compliance times load at most, m or rad; NaN if one is.
    pub(super) fn residual(&self) -> f64 {
        let rod =
            self.four_bar.as_ref().map_or(0.0, |f| f.compliance * self.closed.force - self.closed.extension);
        let springs = self.u.iter().zip(&self.compliance).zip(&self.forces);
        springs.fold(rod.abs(), |most, ((u, c), force)| {
            let off = (c * force - u).abs();
            if off > most || off.is_nan() { off } else { most }
        })
    }
}

impl LoopPlace {
    /// What the crank carries: weights, and the pull of the rod.
    pub(super) fn crank_loads(&self) -> Loads {
        let pull = self.force * self.rod;
        Loads {
            force: self.crank_weight.force + pull,
            moment: self.crank_weight.moment + self.crank_end * pull.transpose(),
        }
    }
}
