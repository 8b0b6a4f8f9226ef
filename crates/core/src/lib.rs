//! Value types that cross a stage boundary, each with its invariant.
//!
//! Conventions (docs/CONVENTIONS.md): world in metres, right-handed; cameras with OpenCV axes (x right,
//! y down, z forward); continuous pixel coordinates, the centre of (column u, row v) at (u + 0.5, v + 0.5);
//! `f32` in images and splats, `f64` in solvers. A failed item is a status, never NaN.

mod atomic_file;
mod camera;
mod connected;
mod counted;
mod estimate;
mod exposure;
mod gaussians;
mod image;
mod input_file;
mod instructions;
pub mod kernel;
mod mask;
mod median;
mod motion;
mod python_json;
mod rig;
mod scene;
mod sky_cube;
mod spatial_order;
pub mod stage;
mod stage_log;
mod view;

pub use atomic_file::write_atomically;
pub use camera::{Camera, CameraError, ImageSize, Intrinsics, Projection};
pub use connected::connected;
pub use counted::counted;
pub use estimate::{EstimateStatus, Estimates, Observations};
pub use exposure::{Exposure, scale_odds};
pub use gaussians::{Gaussians, PixelFilter, SH_C0, ShapeError, logit, sh_coefficients, sigmoid};
pub use image::{ImageRgb8, PlanarImage};
pub use input_file::{is_present, open_input, read_bytes, read_text, refuse_link};
pub use instructions::{NoSuchInstructions, check_instructions, instruction_set, instructions};
pub use mask::Mask;
pub use median::{median, upper_median};
pub use motion::{DenseMotion, TrackSet, TrackerLevel, ViewMotion};
pub use python_json::nan_to_null;
pub use rig::{RigExtent, is_fixed, up};
pub use scene::{Aside, Dynamic, Knowledge, Scene, TRANSPARENT};
pub use sky_cube::SkyCube;
pub use spatial_order::spatial_order;
pub use stage_log::{Seconds, StageLog};
pub use view::TrainingView;
