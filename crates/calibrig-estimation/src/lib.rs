//! From measurements to a robot's parameters.
//!
//! # What this crate cannot see
//!
//! The machine as built, and all that simulates and measures it: no estimate can look at the truth. This does not compile:
//!
//! ```compile_fail,E0432
//! use calibrig_plant::AsBuilt;
//! ```

pub mod elastostatics;
pub mod evaluation;
pub mod identification;
pub mod kinematics;
pub mod validation;
