//! Optimisation of Gaussians and sky: photometric loss, Adam, density control, sky texture, initialisation.
//!
//! Everything here gives the same bits for any number of rayon threads.

mod loss;
mod simd;

pub use loss::{LossRegion, LossValue, PhotometricLoss};
