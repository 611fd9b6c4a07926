//! Which factors an output depends on, from the outputs of a design in its order. Sums stream: memory does not grow with the trials, and the same
//! outputs in the same order give the same bits.

mod indices;
mod screening;

pub use indices::{SobolIndices, SobolSums};
pub use screening::{ElementaryEffects, MorrisSums};
