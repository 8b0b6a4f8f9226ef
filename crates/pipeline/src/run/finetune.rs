//! The three lanes of a frame.

use super::Job;
use crate::console::Console;
use anyhow::Result;
use ffgs_core::{Gaussians, Scene, StageLog, TrainingView};
use ffgs_reconstruction::knowledge::{self, Predicted};
use ffgs_trainer::{
    DynamicLaneConfig, Prior, Progress, ResolutionConfig, StaticLane, StaticTargets, Surroundings,
};
use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

impl Job<'_> {
    /// Every lane reads the state at the frame's start and writes its own layer, so the order does not matter.
    pub(super) fn finetune(
        &self,
        (frame, dynamic_lane): (usize, &DynamicLaneConfig),
        scene: &mut Scene,
        (static_lane, prior): (&mut StaticLane, Option<Prior>),
        views: &[TrainingView],
        console: &Console,
        log: &mut StageLog,
    ) -> Result<()> {
        let (config, devices) = (self.config(), self.devices());
        let seed = self.seed(frame);
        let (static_start, sky_start) = (Arc::clone(&scene.static_layer), scene.sky.clone());
        let around = Surroundings { static_layer: &static_start, sky: &sky_start, prior };
        let Scene { static_layer, static_colours, dynamic, sky, .. } = scene;
        let [moving, standing] =
            [&dynamic.gaussians, &static_start].map(|layer| self.as_fine_as(layer, views));
        let parts = parts(config.resolution, dynamic_lane, moving.factor);
        let dynamic_bar = console.lane("dynamic", dynamic_lane.iterations);
        let static_bar = console.lane("static", config.background.static_passes());
        let timed = |work: &mut (dyn FnMut() -> Result<()> + Send)| {
            let start = Instant::now();
            work().map(|()| start.elapsed().as_secs_f64())
        };
        let background = &config.background;
        let (dynamic_s, static_s, sky_s) = devices.together(
            || {
                timed(&mut || {
                    let layer = &mut dynamic.gaussians;
                    let report = &mut |p| dynamic_bar.show(p);
                    devices.dynamic(&parts[0], &moving.views, around, layer, seed, report)?;
                    let before = parts[0].iterations;
                    let report = &mut |p| dynamic_bar.show(after(before, p));
                    let around = Surroundings { prior: prior.map(|p| p.finer(moving.factor)), ..around };
                    devices.dynamic(&parts[1], views, around, layer, seed, report)
                })
            },
            || {
                timed(&mut || {
                    let targets = StaticTargets { views: &standing.views, sky: &sky_start };
                    let report = &mut |p| static_bar.show(p);
                    let layer = (&mut *static_layer, &mut *static_colours);
                    devices.static_layer(static_lane, background, targets, layer, seed, report)
                })
            },
            || timed(&mut || devices.sky(background, &standing.views, &static_start, sky, seed)),
        );
        log.add_seconds("dynamic", dynamic_s?);
        log.add_seconds("static", static_s?);
        log.add_seconds("sky", sky_s?);
        Ok(())
    }

    /// Finetunes a frame that was taken from another run, which had trained it less.
    pub(super) fn refine(
        &self,
        frame: usize,
        scene: &mut Scene,
        views: &[TrainingView],
        iterations: usize,
        console: &Console,
        log: &mut StageLog,
    ) -> Result<()> {
        let dynamic_lane = DynamicLaneConfig { iterations, ..self.config().dynamic };
        let predicted = Predicted::new(scene, &dynamic_lane);
        let known = predicted.as_ref().map(Predicted::prior);
        let lanes = (&mut StaticLane::default(), known);
        self.finetune((frame, &dynamic_lane), scene, lanes, views, console, log)?;
        let start = Instant::now();
        self.learn(scene, predicted.as_ref(), views);
        log.since("information", start);
        Ok(())
    }

    /// Adds what the photographs tell of the moving layer.
    pub(super) fn learn(&self, scene: &mut Scene, predicted: Option<&Predicted>, views: &[TrainingView]) {
        let views = self.as_fine_as(&scene.dynamic.gaussians, views).views;
        knowledge::learn(scene, predicted, &views);
    }

    /// The photographs, no larger than what `layer` can show.
    fn as_fine_as<'v>(&self, layer: &Gaussians, views: &'v [TrainingView]) -> Reduced<'v> {
        let factor = self.config().resolution.reduction(layer, views);
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
