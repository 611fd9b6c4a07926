//! The rest of a chain that is too soft for successive substitution.
//!
//! Where a deflection changes its own load by more than the spring does, as of a heavy load that hangs on a soft drive, `u = c Q(u)` overshoots
//! although the chain is stable. Newton's method on the energy, with a line search on its slope, goes there from the rigid pose; a
//! chain whose energy is not convex on the way is unstable and is refused.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::structure::Slot;
use super::{CONVERGED, ElasticChain, ElasticError, Settled};

/// Steps before giving up: Newton's method on a convex energy needs some ten.
const MOST_STEPS: usize = 50;
/// What a spring is displaced by for its derivative, m or rad.
const DISPLACED: f64 = 1e-5;
/// A step ends where the energy rises again by no more than this share of the slope that it began to fall with.
const OVERSHOOT: f64 = 0.1;
/// The shortest step.
const SHORTEST: f64 = 1e-6;

/// What yields.
#[derive(Debug, Clone, Copy)]
enum Spring {
    Slot(usize),
    Rod,
}

impl ElasticChain {
    /// Brings the chain to rest from its rigid pose. This takes memory.
    pub(super) fn descend(&mut self) -> Result<Settled, ElasticError> {
        let springs = self.yielding();
        let roots = DVector::from_iterator(springs.len(), springs.iter().map(|s| self.softness(*s).sqrt()));
        let mut at = DVector::zeros(springs.len());
        let mut evaluations = 0;
        self.displace(&springs, &at)?;
        for _ in 0..MOST_STEPS {
            let residual = self.residual();
            evaluations += 1;
            if residual <= CONVERGED {
                return Ok(Settled { iterations: evaluations, residual });
            }
            let slopes = self.slopes(&springs, &roots);
            let Some(stiffness) = self.stiffness(&springs, &roots, &at) else { break };
            evaluations += 2 * springs.len();
            let Some(factor) = Cholesky::new(stiffness) else { break };
            let step = -factor.solve(&slopes);
            let falls = step.dot(&slopes);
            let mut share = 1.0;
            loop {
                let tried = &at + share * step.component_mul(&roots);
                let rises =
                    self.displace(&springs, &tried).map(|()| step.dot(&self.slopes(&springs, &roots)));
                evaluations += 1;
                if rises.is_ok_and(|slope| slope <= -OVERSHOOT * falls) || self.residual() <= CONVERGED {
                    at = tried;
                    break;
                }
                share *= 0.5;
                if share < SHORTEST {
                    return Err(self.not_settled(evaluations));
                }
            }
        }
        Err(self.not_settled(evaluations))
    }

    fn not_settled(&self, iterations: usize) -> ElasticError {
        ElasticError::NotSettled { iterations, residual: self.residual() }
    }

    fn yielding(&self) -> Vec<Spring> {
        let slots =
            (0..self.slots.len()).filter(|k| self.slots[*k] != Slot::Mark && self.compliance[*k] > 0.0);
        let rod = self.four_bar.as_ref().filter(|f| f.compliance > 0.0).map(|_| Spring::Rod);
        slots.map(Spring::Slot).chain(rod).collect()
    }

    fn softness(&self, spring: Spring) -> f64 {
        match spring {
            Spring::Slot(k) => self.compliance[k],
            Spring::Rod => self.four_bar.as_ref().map_or(0.0, |f| f.compliance),
        }
    }

    /// Places the chain with its springs at `at`, m or rad, and weighs it.
    fn displace(&mut self, springs: &[Spring], at: &DVector<f64>) -> Result<(), ElasticError> {
        self.u.fill(0.0);
        self.closed.extension = 0.0;
        for (spring, value) in springs.iter().zip(at.iter()) {
            match spring {
                Spring::Slot(k) => self.u[*k] = *value,
                Spring::Rod => self.closed.extension = *value,
            }
        }
        self.place()?;
        self.balance();
        Ok(())
    }

    /// Derivatives of the energy by every spring's deflection over the root of its compliance: `(u - c Q) / sqrt(c)`.
    fn slopes(&self, springs: &[Spring], roots: &DVector<f64>) -> DVector<f64> {
        let slope = |(spring, root): (&Spring, &f64)| match spring {
            Spring::Slot(k) => self.u[*k] / root - root * self.forces[*k],
            Spring::Rod => self.closed.extension / root - root * self.closed.force,
        };
        DVector::from_iterator(springs.len(), springs.iter().zip(roots.iter()).map(slope))
    }

    /// The matrix of second derivatives, by central differences; `None` where a displaced chain cannot be placed.
    fn stiffness(
        &mut self,
        springs: &[Spring],
        roots: &DVector<f64>,
        at: &DVector<f64>,
    ) -> Option<DMatrix<f64>> {
        let n = springs.len();
        let mut stiffness = DMatrix::zeros(n, n);
        for column in 0..n {
            let mut beside = |by: f64| {
                let mut moved = at.clone();
                moved[column] += by;
                self.displace(springs, &moved).ok()?;
                Some(self.slopes(springs, roots))
            };
            let change = beside(DISPLACED)? - beside(-DISPLACED)?;
            stiffness.set_column(column, &(change * (roots[column] / (2.0 * DISPLACED))));
        }
        self.displace(springs, at).ok()?;
        stiffness.iter().all(|v| v.is_finite()).then(|| 0.5 * (&stiffness + stiffness.transpose()))
    }
}
