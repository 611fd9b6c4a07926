mod columns;
mod equilibrium;
mod robots;

use super::*;
