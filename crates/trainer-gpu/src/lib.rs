//! Training on the GPU; the lanes of `ffgs-trainer` are their twins, with the same configuration, the same order of
//! views and the same steps.
//!
//! Parameters, moments, 8-bit photographs, masks and layers stay on the device. A step is one submission and reads
//! nothing back: sizes are measured before a lane begins, and the running loss is fetched now and then.

mod background_lanes;
mod dynamic_lane;
mod first_frame;
mod kernels;
mod layout;
mod optimiser;
mod probe;
#[cfg(test)]
mod shader_tests;
mod sky;
mod target;
#[cfg(test)]
mod tests;
mod workspace;

pub use background_lanes::{train_sky, train_static};
pub use dynamic_lane::train_dynamic;
pub use first_frame::train_first_frame;
pub use probe::{Counts, Floor, Part, Probe};
