//! Optimisation of Gaussians and sky: photometric loss, Adam, density control, sky texture, initialisation.
//!
//! Everything here gives the same bits for any number of rayon threads.

mod adam;
mod densify;
mod initialise;
mod loss;
mod simd;
mod sky;

pub use adam::{Adam, AdamVec, LearningRates, Update};
pub use densify::{DensityConfig, DensityControl, DensityPlan, IndexMap, ViewStatistics, reset_opacities};
pub use initialise::{INITIAL_OPACITY, from_points};
pub use loss::{LossRegion, LossValue, PhotometricLoss};
pub use sky::{SkyCube, SkyObservation, SkyView};
