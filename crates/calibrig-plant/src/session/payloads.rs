//! What the flange carries at which pose.

use super::plan::PlanError;
use calibrig_model::Payload;
use calibrig_model::measurement::SetKind;

/// A load for the flange: as stated, and as it really is.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedPayload {
    /// As stated in the observations.
    pub stated: Payload,
    /// What really hangs there.
    pub real: Payload,
}

/// How the loads of a set follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PayloadOrder {
    /// One change per load: as many consecutive poses with each, the first loads with one more if they do not divide.
    #[default]
    Blocks,
    /// A change at every pose.
    Cycle,
}

impl PayloadOrder {
    /// The key in files.
    pub fn key(self) -> &'static str {
        match self {
            Self::Blocks => "blocks",
            Self::Cycle => "cycle",
        }
    }
}

/// Which poses carry which load; none by default.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PayloadPlan {
    /// All of them.
    pub payloads: Vec<PlannedPayload>,
    /// The loads of the poses of the identification and of the verification set, in turn: indices into `payloads`, `None` for nothing. A set
    /// with an empty list carries nothing.
    pub carried: [Vec<Option<usize>>; 2],
    /// In which order.
    pub order: PayloadOrder,
}

impl PayloadPlan {
    /// Makes the real load equal to the stated one.
    pub fn make_as_stated(&mut self) {
        for payload in &mut self.payloads {
            payload.real.clone_from(&payload.stated);
        }
    }

    pub(super) fn check(&self) -> Result<(), PlanError> {
        for payload in &self.payloads {
            payload.stated.check()?;
            payload.real.check()?;
        }
        let payloads = self.payloads.len();
        let mut carried = self.carried.iter().flatten().flatten();
        match carried.find(|index| **index >= payloads) {
            Some(&index) => Err(PlanError::Payload { index, payloads }),
            None => Ok(()),
        }
    }

    /// What pose number `pose` of the `count` of a set carries, in the order of measuring.
    pub fn at(&self, kind: SetKind, pose: usize, count: usize) -> Option<&PlannedPayload> {
        let carried = match kind {
            SetKind::Identification => &self.carried[0],
            SetKind::Verification => &self.carried[1],
        };
        let turn = match self.order {
            PayloadOrder::Cycle => pose % carried.len().max(1),
            // So that pose 0 begins the first block and the last pose ends the last one.
            PayloadOrder::Blocks => pose * carried.len() / count.max(1),
        };
        self.payloads.get((*carried.get(turn)?)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn plan(order: PayloadOrder) -> PayloadPlan {
        let payload = |name: &str, mass| {
            let stated = Payload::of_mass(name, mass, Vector3::zeros());
            PlannedPayload { real: Payload { mass: 1.01 * mass, ..stated.clone() }, stated }
        };
        PayloadPlan {
            payloads: vec![payload("25", 25.0), payload("50", 50.0)],
            carried: [vec![None, Some(0), Some(1)], vec![Some(1)]],
            order,
        }
    }

    fn masses(plan: &PayloadPlan, kind: SetKind, count: usize) -> Vec<f64> {
        let mass = |pose| plan.at(kind, pose, count).map_or(0.0, |payload| payload.stated.mass);
        (0..count).map(mass).collect()
    }

    #[test]
    fn loads_follow_in_blocks_or_in_turn() {
        let blocks = plan(PayloadOrder::Blocks);
        assert_eq!(blocks.check(), Ok(()));
        assert_eq!(masses(&blocks, SetKind::Identification, 6), [0.0, 0.0, 25.0, 25.0, 50.0, 50.0]);
        assert_eq!(masses(&blocks, SetKind::Identification, 7), [0.0, 0.0, 0.0, 25.0, 25.0, 50.0, 50.0]);
        assert_eq!(masses(&blocks, SetKind::Verification, 2), [50.0, 50.0]);
        let cycle = plan(PayloadOrder::Cycle);
        assert_eq!(masses(&cycle, SetKind::Identification, 5), [0.0, 25.0, 50.0, 0.0, 25.0]);
        assert_eq!(masses(&PayloadPlan::default(), SetKind::Verification, 2), [0.0, 0.0]);
    }

    #[test]
    fn a_plan_with_what_is_not_there_is_refused() {
        let mut missing = plan(PayloadOrder::Cycle);
        missing.carried[1] = vec![Some(2)];
        assert_eq!(missing.check(), Err(PlanError::Payload { index: 2, payloads: 2 }));
        let mut negative = plan(PayloadOrder::Cycle);
        negative.payloads[1].real.mass = -1.0;
        let error = negative.check().expect_err("refused").to_string();
        assert!(error.contains("\"50\" is -1 kg"), "{error}");
    }
}
