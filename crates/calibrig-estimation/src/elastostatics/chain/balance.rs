//! The loads on the springs of a placed chain.

use super::ElasticChain;
use super::parts::Slot;
use super::place::LoopPlace;
use super::screw::Loads;

impl ElasticChain {
    /// The force of the rod that holds the elbow, and the generalised force on every spring.
    pub(super) fn balance(&mut self) {
        self.balance_elbow();
        let mut outboard = Loads::none();
        let mut lumps = self.lumps.iter().rev().peekable();
        for (slot, kind) in self.slots.iter().enumerate().rev() {
            while let Some(lump) = lumps.next_if(|l| l.inboard > slot) {
                outboard.add(lump);
            }
            match kind {
                Slot::Elastic => self.load[slot] = outboard.on(&self.screws[slot]),
                Slot::Crank => {
                    let crank = self.closed.crank_loads();
                    self.load[slot] = crank.on(&self.screws[slot]);
                    outboard.add_all(&crank);
                }
                Slot::Mark => {}
            }
        }
    }

    /// The rod's tension follows from the balance of the free elbow alone; it becomes a load on the lever.
    fn balance_elbow(&mut self) {
        let Some(four_bar) = &self.four_bar else { return };
        self.lumps[four_bar.lever_lump].scale = 1.0;
        self.lumps[four_bar.lever_lump].direction = 0.5 * four_bar.rod_mass * self.gravity;
        let mut outboard = Loads::none();
        for lump in &self.lumps[four_bar.first_outboard..] {
            outboard.add(lump);
        }
        let closed = &mut self.closed;
        closed.force = outboard.on(&self.screws[self.parts[four_bar.elbow].drive]) / closed.rate;
        self.lumps[four_bar.lever_lump].direction -= closed.force * closed.rod;
    }

    /// Sets every spring to compliance times load.
    pub(super) fn yield_to_loads(&mut self) {
        for ((u, c), load) in self.u.iter_mut().zip(&self.compliance).zip(&self.load) {
            *u = c * load;
        }
        if let Some(four_bar) = &self.four_bar {
            self.closed.extension = four_bar.compliance * self.closed.force;
        }
    }

    /// By how much deflections differ from compliance times load at most, m or rad; NaN if one is.
    pub(super) fn residual(&self) -> f64 {
        let rod =
            self.four_bar.as_ref().map_or(0.0, |f| f.compliance * self.closed.force - self.closed.extension);
        let springs = self.u.iter().zip(&self.compliance).zip(&self.load);
        springs.fold(rod.abs(), |most, ((u, c), load)| {
            let off = (c * load - u).abs();
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
