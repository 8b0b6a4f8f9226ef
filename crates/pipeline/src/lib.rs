//! The composition root: it wires the stages into `ffgs run` and offers each of them alone.

pub mod check;
pub mod cli;
pub mod stage;
