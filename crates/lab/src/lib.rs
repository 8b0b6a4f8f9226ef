//! Experiments on the motion initialisation, for developers and papers: what `ffgs-lab` runs. The product does not
//! depend on any of this.

pub mod ablations;
mod capture_writer;
mod cells;
pub mod cli;
mod compare;
mod enlarge;
pub mod evaluation;
mod expose;
mod later;
mod markers;
mod mask_eval;
pub mod motion_eval;
mod simulate;
mod synthetic;
