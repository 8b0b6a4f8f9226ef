//! What the stages of the motion initialisation read of one frame.

use crate::MotionConfig;
use ffgs_core::Gaussians;
use ffgs_method::{Step, TrackSource};
use ffgs_rasterizer_gpu::SceneDevice;
use glam::DVec3;
use std::sync::Arc;

/// What the stages of one frame read.
pub struct MotionInput<'a> {
    /// Settings.
    pub config: &'a MotionConfig,
    /// Views at t - 1 and t.
    pub step: Step<'a>,
    /// Trackers used.
    pub trackers: Vec<&'a dyn TrackSource>,
    /// The static layer, which hides parts of the dynamic one.
    pub static_layer: &'a Arc<Gaussians>,
    /// Positions of the dynamic layer at t - 1 (m).
    pub previous: &'a [DVec3],
    /// Where motion fields and association are computed; `None` = the CPU.
    pub gpu: Option<&'a SceneDevice>,
}
