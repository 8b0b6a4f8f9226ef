//! The reconstructor, and the state that one frame leaves for the next.

use crate::config::ReconstructionConfig;
use crate::devices::Devices;
use crate::exposures::Exposures;
use crate::monitor::Monitor;
use crate::reduced::Reduced;
use ffgs_core::{Scene, TrainingView};
use ffgs_method::{Capture, MotionMethod, Step, TrackSource};
use ffgs_trainer::StaticLane;

/// Reconstructs the frames of one capture.
pub struct Reconstructor<'a> {
    /// The settings.
    pub config: ReconstructionConfig,
    /// Where to compute.
    pub devices: Devices<'a>,
    /// Where cameras, initial points and tracks are from.
    pub capture: &'a dyn Capture,
    /// Training views used, as indices into the capture's training split.
    pub views: &'a [usize],
    /// The capture's trackers.
    pub tracks: &'a [Box<dyn TrackSource>],
    /// Moves the scene.
    pub method: Box<dyn MotionMethod + 'a>,
    /// The method's name, for errors.
    pub method_name: String,
    /// Told of every training.
    pub monitor: &'a dyn Monitor,
}

/// What a frame leaves for the next. What the method keeps is in the method.
pub struct State {
    /// All layers.
    pub scene: Scene,
    /// Photographs of the frame by the training views, in one exposure.
    pub views: Vec<TrainingView>,
    /// The exposures of the cameras.
    pub exposures: Exposures,
    /// Contributors of each pixel of fixed cameras; empty after a resume, and then traced again with the same result.
    pub(crate) static_lane: StaticLane,
}

impl State {
    /// The state after a frame whose scene is `scene`.
    pub fn new(scene: Scene, views: Vec<TrainingView>, exposures: Exposures) -> Self {
        Self { scene, views, exposures, static_lane: StaticLane::default() }
    }
}

impl<'a> Reconstructor<'a> {
    /// Seed of the trainings of a frame.
    pub(crate) fn seed(&self, frame: usize) -> u64 {
        self.config.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ frame as u64
    }

    /// For errors of the method: which one it is.
    pub fn named(&self, what: &str) -> String {
        format!("method {}: {what}", self.method_name)
    }

    /// `views` as they are compared with what moves in `scene`.
    pub(crate) fn reduced<'v>(&self, scene: &Scene, views: &'v [TrainingView]) -> Reduced<'v> {
        Reduced::new(views, self.config.resolution.dynamic(&scene.dynamic.gaussians, views))
    }

    /// The step to `frame` between the photographs `before` and `now`, which are `reduced` for the moving layer.
    pub(crate) fn step<'s>(
        &self,
        frame: usize,
        [before, now]: [&'s [TrainingView]; 2],
        reduced: [&'s Reduced<'s>; 2],
    ) -> Step<'s>
    where
        'a: 's,
    {
        let Self { capture, views, tracks, .. } = *self;
        let reduced = reduced.map(|views| &*views.views);
        Step { frame, seed: self.config.seed, capture, views, before, now, reduced, tracks }
    }
}
