//! How far loads bend the robot, and how the target moves with what is known of its springs and masses.

mod apply;
mod beam;
mod chain;

pub use apply::apply;
pub(crate) use apply::put;
pub(crate) use chain::Carried;
pub use chain::{Deflection, ElasticChain, ElasticError, Settled};
