//! LM
/// Options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolverOptions {}
/// Problem.
pub trait LeastSquares {}
