//! Commands for places: of every robot of `models/`, checked by the forward kinematics and by brute force.

// What a test expects of its own robots is no case of the interface.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod compensated;
mod criteria;
mod derivatives;
mod identified;
mod robots;
mod targets;
mod unreachable;
