//! The composition root: it wires the stages into `ffgs run` and offers each of them alone.

pub mod check;
pub mod cli;
pub mod config;
mod config_text;
mod console;
pub mod device;
pub mod eval;
pub mod frame;
mod lanes;
pub mod manifest;
mod memory;
pub mod method;
mod methods;
pub mod prepare;
pub mod record;
pub mod registry;
pub mod render;
mod request;
pub mod run;
pub mod scoring;
pub mod stage;
pub mod state;
