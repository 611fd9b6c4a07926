//! From measurements to a robot's parameters.

pub mod elastostatics;
pub mod evaluation;
pub mod identification;
pub mod kinematics;
pub mod validation;
