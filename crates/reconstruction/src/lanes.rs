//! The three lanes of a frame.

use crate::knowledge;
use crate::reconstructor::{Reconstructor, State};
use crate::reduced::Reduced;
use anyhow::Result;
use ffgs_core::{Scene, StageLog, TrainingView, stage};
use ffgs_trainer::{DynamicLaneConfig, Prior, StaticColours, StaticTargets, Surroundings};
use std::sync::Arc;
use std::time::Instant;

/// What the lanes of a frame start from, beside the scene.
pub(crate) struct FrameStart<'a> {
    /// Its index, for the seeds.
    pub frame: usize,
    /// How the dynamic layer is finetuned.
    pub dynamic_lane: DynamicLaneConfig,
    /// What is known of the dynamic layer from earlier frames.
    pub prior: Option<Prior<'a>>,
    /// Photographs of the frame.
    pub views: &'a [TrainingView],
    /// The same, reduced for the moving layer.
    pub coarse: &'a Reduced<'a>,
    /// Static Gaussians that what moves covers or that stand before it, ascending: the dynamic and the sky lane are trained without them, and they are transparent in this frame. The static
    /// lane keeps them, as its linear system has to stay the same from frame to frame.
    pub left_out: &'a [u32],
    /// Whether the static layer and the sky are trained as well.
    pub trains_background: bool,
}

impl Reconstructor<'_> {
    /// Every lane reads the state at the frame's start and writes its own layer, so the order does not matter.
    pub(crate) fn train_lanes(
        &self,
        start: &FrameStart,
        state: &mut State,
        log: &mut StageLog,
    ) -> Result<()> {
        let (config, devices, seed) = (&self.config, self.devices, self.seed(start.frame));
        let FrameStart { ref dynamic_lane, prior, views, coarse, left_out, trains_background, .. } = *start;
        let State { scene, static_lane, .. } = state;
        let (static_start, sky_start) = (scene.without(left_out), scene.sky.clone());
        let (before, mut passing) = (Arc::clone(&scene.static_layer), Vec::new());
        let around = Surroundings { static_layer: &static_start, sky: &sky_start, prior };
        let Scene { static_layer, static_colours, dynamic, sky, .. } = scene;
        let expecting = Instant::now();
        let natural = prior.filter(|_| dynamic_lane.natural_step > 0.0);
        let layers = [&static_start, &dynamic.gaussians];
        let curvature = natural.map(|prior| knowledge::curvature(&layers, &sky_start, coarse, prior));
        let prior = prior.map(|p| Prior { curvature: curvature.as_ref().unwrap_or(p.curvature), ..p });
        let around = Surroundings { prior, ..around };
        log.since(stage::INFORMATION, expecting);
        let standing = Reduced::new(views, config.resolution.static_layer(static_layer, views));
        tracing::debug!(
            "photographs are reduced by {} for the dynamic layer, by {} for the static one",
            coarse.factor,
            standing.factor
        );
        let show_dynamic = self.monitor.begin(stage::DYNAMIC, dynamic_lane.iterations);
        let passes = if trains_background { config.background.static_passes() } else { 0 };
        let show_static = self.monitor.begin(stage::STATIC, passes);
        let background = &config.background;
        let train_dynamic = || {
            let layer = &mut dynamic.gaussians;
            let around = Surroundings { prior: prior.map(|p| p.reduced(coarse.factor)), ..around };
            devices.dynamic(dynamic_lane, &coarse.views, around, layer, seed, &mut |p| show_dynamic(p))
        };
        let train_static = || {
            if !trains_background {
                return Ok(());
            }
            let targets = StaticTargets { views: &standing.views, sky: &sky_start };
            let passing = &mut passing;
            let colours = StaticColours { layer: static_layer, variances: static_colours, passing };
            devices.static_layer(static_lane, background, targets, colours, seed, &mut |p| show_static(p))
        };
        let train_sky = || {
            if !trains_background {
                return Ok(());
            }
            devices.sky(background, &standing.views, &static_start, sky, seed)
        };
        let (dynamic_s, static_s, sky_s) =
            devices.together(|| timed(train_dynamic), || timed(train_static), || timed(train_sky));
        let (steps, dynamic_s) = dynamic_s?;
        if steps > 0 {
            log.skip("steps of the dynamic lane that would not have paid", dynamic_lane.iterations - steps);
        }
        log.add_seconds(stage::DYNAMIC, dynamic_s);
        log.add_seconds(stage::STATIC, static_s?.1);
        log.add_seconds(stage::SKY, sky_s?.1);
        scene.static_layer = scene.without(left_out);
        scene.put_aside(union(&passing, left_out), &before);
        Ok(())
    }
}

/// Ascending, of ascending numbers.
pub(crate) fn union(a: &[u32], b: &[u32]) -> Vec<u32> {
    let mut all = [a, b].concat();
    all.sort_unstable();
    all.dedup();
    all
}

/// What comes of it, and the seconds that it takes.
fn timed<T>(work: impl FnOnce() -> Result<T>) -> Result<(T, f64)> {
    let start = Instant::now();
    work().map(|done| (done, start.elapsed().as_secs_f64()))
}
