//! The three lanes of a frame.

use crate::knowledge::{self, Predicted};
use crate::reconstructor::{Reconstructor, State};
use anyhow::Result;
use ffgs_core::{Gaussians, Scene, StageLog, TrainingView, stage};
use ffgs_trainer::{
    DynamicLaneConfig, Prior, Progress, ResolutionConfig, StaticColours, StaticTargets, Surroundings,
};
use std::borrow::Cow;
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
        let FrameStart { ref dynamic_lane, prior, views, .. } = *start;
        let State { scene, static_lane, .. } = state;
        let (static_start, sky_start) = (Arc::clone(&scene.static_layer), scene.sky.clone());
        let around = Surroundings { static_layer: &static_start, sky: &sky_start, prior };
        let Scene { static_layer, static_colours, dynamic, sky, .. } = scene;
        let [moving, standing] =
            [&dynamic.gaussians, &static_start].map(|layer| self.as_fine_as(layer, views));
        let parts = parts(config.resolution, dynamic_lane, moving.factor);
        let show_dynamic = self.monitor.begin("dynamic", dynamic_lane.iterations);
        let show_static = self.monitor.begin("static", config.background.static_passes());
        let timed = |work: &mut (dyn FnMut() -> Result<()> + Send)| {
            let start = Instant::now();
            work().map(|()| start.elapsed().as_secs_f64())
        };
        let background = &config.background;
        let (dynamic_s, static_s, sky_s) = devices.together(
            || {
                timed(&mut || {
                    let layer = &mut dynamic.gaussians;
                    let report = &mut |p| show_dynamic(p);
                    devices.dynamic(&parts[0], &moving.views, around, layer, seed, report)?;
                    let before = parts[0].iterations;
                    let report = &mut |p| show_dynamic(after(before, p));
                    let around = Surroundings { prior: prior.map(|p| p.finer(moving.factor)), ..around };
                    devices.dynamic(&parts[1], views, around, layer, seed, report)
                })
            },
            || {
                timed(&mut || {
                    let targets = StaticTargets { views: &standing.views, sky: &sky_start };
                    let report = &mut |p| show_static(p);
                    let colours =
                        StaticColours { layer: &mut *static_layer, variances: &mut *static_colours };
                    devices.static_layer(static_lane, background, targets, colours, seed, report)
                })
            },
            || timed(&mut || devices.sky(background, &standing.views, &static_start, sky, seed)),
        );
        log.add_seconds(stage::DYNAMIC, dynamic_s?);
        log.add_seconds(stage::STATIC, static_s?);
        log.add_seconds(stage::SKY, sky_s?);
        Ok(())
    }

    /// Adds what the photographs tell of the dynamic layer to what is known of it.
    pub(crate) fn learn(
        &self,
        scene: &mut Scene,
        predicted: Option<&Predicted>,
        views: &[TrainingView],
        log: &mut StageLog,
    ) {
        let start = Instant::now();
        let views = self.as_fine_as(&scene.dynamic.gaussians, views).views;
        knowledge::learn(scene, predicted, &views);
        log.since(stage::INFORMATION, start);
    }

    /// The photographs, no larger than what `layer` can show.
    fn as_fine_as<'v>(&self, layer: &Gaussians, views: &'v [TrainingView]) -> Reduced<'v> {
        let factor = self.config.resolution.reduction(layer, views);
        Reduced { factor, views: TrainingView::all_reduced(views, factor) }
    }
}

/// Photographs whose pixels are blocks of `factor` times `factor` pixels.
struct Reduced<'v> {
    factor: usize,
    views: Cow<'v, [TrainingView]>,
}

/// The steps on photographs reduced by `factor`, and those on whole ones.
fn parts(resolution: ResolutionConfig, lane: &DynamicLaneConfig, factor: usize) -> [DynamicLaneConfig; 2] {
    let [reduced, _] = resolution.steps(lane.iterations, factor);
    lane.parts(reduced)
}

/// The progress of a part that comes after so many steps.
fn after(steps: usize, part: Progress) -> Progress {
    Progress { iteration: part.iteration + steps, iterations: part.iterations + steps, ..part }
}
