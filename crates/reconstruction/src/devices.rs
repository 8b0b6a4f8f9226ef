//! Training and rendering on the device of a run: each function picks the CPU or a GPU.

use anyhow::Result;
use ffgs_core::{Camera, Gaussians, PlanarImage, Scene, SkyCube, StageLog, TrainingView};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, View};
use ffgs_rasterizer_gpu::{GpuRasterizer, GpuScene, SceneDevice};
use ffgs_trainer::{
    BackgroundConfig, BirthConfig, CpuBackend, Disoccluded, DisocclusionConfig, DynamicLaneConfig, Equalise,
    FirstFrame, FirstFrameConfig, FirstFrameTask, Newborn, Progress, StaticColours, StaticLane,
    StaticTargets, Surroundings, sky_picture, train_disoccluded, train_dynamic, train_first_frame,
    train_newborn, train_sky,
};
use ffgs_trainer_gpu::GpuBackend;
use rayon::prelude::*;
use std::sync::Arc;

/// Device of each training lane: GPU i mod n for dynamic, static, sky; none = the CPU. GPU 0 does the rest.
#[derive(Clone, Copy)]
pub struct Devices<'a>(pub &'a [SceneDevice]);

/// Progress callback, called after every step.
type Report<'a> = &'a mut dyn FnMut(Progress);

impl<'a> Devices<'a> {
    /// The GPU of a lane: 0 = dynamic, 1 = static, 2 = sky.
    fn gpu(self, lane: usize) -> Option<&'a SceneDevice> {
        self.0.get(lane.checked_rem(self.0.len())?)
    }

    /// Runs the three lanes of a frame at the same time. With one device the static lane and the sky take turns: they
    /// would only hold more memory.
    pub(crate) fn together<D: Send, S: Send, K: Send>(
        self,
        dynamic: impl FnOnce() -> D + Send,
        static_lane: impl FnOnce() -> S + Send,
        sky: impl FnOnce() -> K + Send,
    ) -> (D, S, K) {
        if self.0.len() < 2 {
            let (dynamic, (static_lane, sky)) = rayon::join(dynamic, || (static_lane(), sky()));
            return (dynamic, static_lane, sky);
        }
        // Threads that mostly wait for a device; the CPU's own stay free for the linear solve.
        std::thread::scope(|scope| {
            let (static_lane, sky) = (scope.spawn(static_lane), scope.spawn(sky));
            let dynamic = dynamic();
            (dynamic, joined(static_lane), joined(sky))
        })
    }

    /// Frame 0.
    pub(crate) fn first_frame(
        self,
        config: &FirstFrameConfig,
        task: FirstFrameTask,
        equalise: Equalise,
        log: &mut StageLog,
        report: Report,
    ) -> Result<FirstFrame> {
        Ok(match self.gpu(0) {
            None => train_first_frame(&CpuBackend, config, task, equalise, log, report)?,
            Some(gpu) => train_first_frame(&GpuBackend(gpu), config, task, equalise, log, report)?,
        })
    }

    /// The moving Gaussians; says in how many steps.
    pub(crate) fn dynamic(
        self,
        config: &DynamicLaneConfig,
        views: &[TrainingView],
        around: Surroundings,
        layer: &mut Gaussians,
        seed: u64,
        report: Report,
    ) -> Result<usize> {
        Ok(match self.gpu(0) {
            None => train_dynamic(&CpuBackend, config, views, around, layer, seed, report)?,
            Some(gpu) => train_dynamic(&GpuBackend(gpu), config, views, around, layer, seed, report)?,
        })
    }

    /// The static layer's colours.
    pub(crate) fn static_layer(
        self,
        lane: &mut StaticLane,
        config: &BackgroundConfig,
        targets: StaticTargets,
        colours: StaticColours,
        seed: u64,
        report: Report,
    ) -> Result<()> {
        match self.gpu(1) {
            None => lane.train(&CpuBackend, config, targets, colours, seed, report)?,
            Some(gpu) => lane.train(&GpuBackend(gpu), config, targets, colours, seed, report)?,
        }
        Ok(())
    }

    /// The static Gaussians that come to light; whether any view shows them.
    pub(crate) fn disoccluded(
        self,
        config: &DisocclusionConfig,
        what: Disoccluded,
        layer: &mut Arc<Gaussians>,
        seed: u64,
        report: Report,
    ) -> Result<bool> {
        Ok(match self.gpu(1) {
            None => train_disoccluded(&CpuBackend, config, what, layer, seed, report)?,
            Some(gpu) => train_disoccluded(&GpuBackend(gpu), config, what, layer, seed, report)?,
        })
    }

    /// Moving Gaussians that join the layer; `None` when too few pixels show them.
    pub(crate) fn newborn(
        self,
        config: &BirthConfig,
        newborn: Newborn,
        scene: &Scene,
        seed: u64,
        report: Report,
    ) -> Result<Option<Gaussians>> {
        Ok(match self.gpu(0) {
            None => train_newborn(&CpuBackend, config, newborn, scene, seed, report)?,
            Some(gpu) => train_newborn(&GpuBackend(gpu), config, newborn, scene, seed, report)?,
        })
    }

    /// The sky.
    pub(crate) fn sky(
        self,
        config: &BackgroundConfig,
        views: &[TrainingView],
        layer: &Arc<Gaussians>,
        sky: &mut SkyCube,
        seed: u64,
    ) -> Result<()> {
        match self.gpu(2) {
            None => train_sky(&CpuBackend, config, views, layer, sky, seed)?,
            Some(gpu) => train_sky(&GpuBackend(gpu), config, views, layer, sky, seed)?,
        }
        Ok(())
    }

    /// Depth-sorted renders of both layers over the sky; on a GPU several views in a submission.
    ///
    /// # Errors
    /// When the device fails.
    pub fn render(self, scene: &Scene, cameras: &[Camera]) -> Result<Vec<PlanarImage>> {
        let options = RenderOptions::default();
        let behind: Vec<PlanarImage> =
            cameras.par_iter().map(|camera| sky_picture(&scene.sky, camera)).collect();
        let view = |(camera, image)| View { camera, background: Background::Image(image), tiles: None };
        let views: Vec<View> = cameras.iter().zip(&behind).map(view).collect();
        if let Some(device) = self.gpu(0) {
            let gpu = &device.gpu;
            let moving = GpuScene::upload(gpu, &scene.dynamic.gaussians)?;
            let joint = GpuScene::joined(gpu, &[&device.layer(&scene.static_layer)?, &moving])?;
            let rendered = GpuRasterizer::new(gpu, options)?.render_views(&joint, &views)?;
            gpu.release_unused();
            return Ok(rendered.into_iter().map(|r| r.image).collect());
        }
        let (rasterizer, mut tape) = (CpuRasterizer::new(options), RenderTape::default());
        let render = |view| {
            rasterizer.render_layers(&scene.layers(), view, &mut tape);
            tape.take_image()
        };
        Ok(views.iter().map(render).collect())
    }
}

/// A panic of a lane goes on here.
fn joined<T>(lane: std::thread::ScopedJoinHandle<T>) -> T {
    lane.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
