//! Optimisation of Gaussians and sky: photometric loss, Adam, density control, sky texture, initialisation.
//!
//! Everything here gives the same bits for any number of rayon threads.

mod adam;
mod backend;
mod background;
mod birth;
pub mod constants;
mod cpu;
mod density_control;
mod disocclusion;
mod dynamic_lane;
mod exposures;
mod first_frame;
mod floaters;
mod gain;
mod hidden_sky;
mod initialise;
mod layer_lane;
mod lengths;
mod loss;
mod natural;
mod photograph_exposures;
mod prior;
mod pyramid;
mod rates;
mod resolution;
mod schedule;
mod sky;
mod sky_lane;
mod static_lane;
mod subset;
mod texel_gradients;
mod view;

pub use adam::{Adam, AdamVec, Columns, Update, bias_corrections};
pub use backend::{
    Around, CutLayers, LayerTask, LayerTraining, Revision, SkyTask, SkyTraining, TaskView, TrainBackend,
    Training, mean_pixels,
};
pub use background::{BackgroundConfig, StaticMethod};
pub use birth::{BirthConfig, Newborn, Standing, train_newborn, unexplained};
pub use cpu::{CpuBackend, CpuLayer, CpuSky};
pub use density_control::{
    DensityConfig, DensityControl, DensityPlan, GradientSums, IndexMap, Split, normal,
};
pub use disocclusion::{Disoccluded, DisocclusionConfig, train_disoccluded};
pub use dynamic_lane::{DynamicLaneConfig, Surroundings, train_dynamic};
pub use exposures::estimate_exposures;
pub use first_frame::{Equalise, FirstFrame, FirstFrameConfig, FirstFrameTask, train_first_frame};
pub use floaters::{depths_behind, depths_without};
pub use gain::{Gain, PixelNoise, information_gain};
pub use initialise::{INITIAL_OPACITY, from_points};
pub use layer_lane::train_layer;
pub use lengths::{TILE_DILATION, pixel_length, robust_extent};
pub use loss::{LossRegion, LossValue, PhotometricLoss, SSIM_WEIGHT};
pub use natural::{Curvature, Damping, expected_gain};
pub use photograph_exposures::{PhotographExposure, photograph_exposures};
pub use prior::{Drift, KINDS, Kind, Prior};
pub use rates::{LearningRates, decay};
pub use resolution::ResolutionConfig;
pub use schedule::{Epochs, Schedule};
pub use sky::{SKY_DOUBT, SKY_LANE_DOUBT, SkyView, sky_picture};
pub use sky_lane::{shows_sky, train_sky};
pub use static_lane::{ColourVariance, StaticColours, StaticLane, StaticTargets};
pub use texel_gradients::TexelGradients;
pub use view::{Progress, camera_extent};
