//! The commands but `run`: a file each, or a folder.

pub(crate) mod check;
pub(crate) mod config;
pub mod eval;
pub(crate) mod export;
pub(crate) mod prepare;
pub(crate) mod render;
pub(crate) mod segment;
pub mod stage;
pub(crate) mod view;
pub(crate) mod workflow;
