//! The reconstruction of frames: the state that a frame leaves, and the step to the next. Read `frame.rs` first; it is the whole sequence.
//!
//! No file is opened here: cameras, points and tracks come through the traits of `method`, photographs from the caller. What moves the
//! scene is a [`MotionMethod`](ffgs_method::MotionMethod).

mod behind;
mod birth;
mod config;
mod covered;
mod denied;
mod devices;
mod disocclusion;
mod exposures;
mod few_views;
mod first_training;
mod frame;
mod initial_points;
mod knowledge;
mod lanes;
mod left_out;
mod light;
mod marking;
mod monitor;
mod outside;
mod reconstructor;
mod reduced;
mod shown;
mod sky;
mod stops;
#[cfg(test)]
mod test_scene;
mod veils;

pub use config::ReconstructionConfig;
pub use devices::Devices;
pub use exposures::Exposures;
pub use first_training::{Earlier, FirstViews};
pub use monitor::{Monitor, Report, Silent};
pub use reconstructor::{Reconstructor, State};
pub use veils::unveiled;
