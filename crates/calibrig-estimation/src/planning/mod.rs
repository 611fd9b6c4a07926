//! Chooses the poses to measure: those with the most information on the parameters, or on what will be predicted with them.
//!
//! A [`PlannedSession`] computes the rows of candidate poses: those of the system that [`identify`](crate::identification::identify) would solve,
//! with its noise, nests, targets and priors, at the nominal robot (or at an estimate, for further poses). [`choose`] selects the best of them by a
//! [`Criterion`], [`ordered`] puts them in an order, [`grow`] shows how many are enough. The candidates have to be visible, reachable and free of
//! collisions; this is not checked here.

mod closed;
mod criteria;
mod draw;
mod error;
mod exchange;
mod figures;
mod growth;
mod order;
mod screened;
mod session;
mod small;
mod space;
#[cfg(test)]
mod tests;

pub use criteria::{Criterion, Observability};
pub use draw::candidate_commands;
pub use error::PlanError;
pub use exchange::{Choice, Design, Over, choose};
pub use figures::{Accuracy, DesignFigures, Spread};
pub use growth::{Growth, GrowthPoint, Needed, grow};
pub use order::{DriftCoupling, OrderCost, OrderWeights, Ordered, Way, order_cost, ordered};
pub use session::PlannedSession;
pub use space::{DesignRows, DesignSpace, ParameterScale};
