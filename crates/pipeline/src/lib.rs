//! The composition root: it wires the stages into `ffgs run` and offers each of them alone.

pub mod cli;
pub mod commands;
pub mod job;
pub mod outputs;
pub mod plugins;
pub mod settings;
