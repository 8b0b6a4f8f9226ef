//! How a frame is reconstructed: from photographs and the scene before to the scene at t. No file is opened here: captures and trackers are
//! read through the traits of `method`.

pub mod birth;
mod config;
mod devices;
pub mod disocclusion;
pub mod exposures;
pub mod few_views;
pub mod initial_points;
pub mod knowledge;
pub mod marking;
pub mod sky;

pub use config::ReconstructionConfig;
pub use devices::Devices;
pub use exposures::Exposures;
pub use sky::sky_picture;
