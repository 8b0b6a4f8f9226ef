//! Training on the GPU: [`GpuBackend`] is the twin of `ffgs_trainer::CpuBackend`, under the same loops.
//!
//! Parameters, moments, 8-bit photographs, masks and layers stay on the device. A step is one submission and reads
//! nothing back: sizes are measured before the first, and the running loss is fetched now and then.

mod backend;
mod kernels;
mod layer;
mod layout;
mod optimiser;
mod prior;
mod probe;
#[cfg(test)]
mod shader_tests;
mod sky;
mod sky_training;
mod surroundings;
mod target;
#[cfg(test)]
mod tests;
mod workspace;

pub use backend::GpuBackend;
pub use layer::GpuLayer;
pub use probe::{Counts, Floor, Part, Probe};
pub use sky_training::GpuSkyTraining;
