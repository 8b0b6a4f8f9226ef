//! The composition root: it wires the stages into `ffgs run` and offers each of them alone.

pub mod check;
pub mod cli;
pub mod config;
mod config_text;
mod console;
pub mod device;
pub mod eval;
mod frame;
mod lanes;
mod manifest;
mod memory;
mod motion;
mod motion_ablation;
pub mod motion_eval;
mod motion_simulated;
pub mod record;
pub mod render;
mod request;
pub mod run;
mod scoring;
pub mod stage;
mod state;
mod turn;
