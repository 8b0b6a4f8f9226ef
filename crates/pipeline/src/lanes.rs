//! Training and rendering on the device of a run: each function has a CPU and a GPU twin.

use anyhow::Result;
use ffgs_core::{Camera, Gaussians, PlanarImage, SkyCube, TrainingView};
use ffgs_gpu::Gpu;
use ffgs_rasterizer::{Background, CpuRasterizer, Rasterizer, RenderOptions, RenderTape, View};
use ffgs_rasterizer_gpu::GpuRasterizer;
use ffgs_trainer::{
    BackgroundConfig, DynamicLaneConfig, FirstFrame, FirstFrameConfig, Progress, SkyView, StaticLane,
    StaticMethod, Surroundings,
};

/// Where lanes run: dealt over GPUs, dynamic, static, sky; none = the CPU. Everything else is done by the first.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<'a>(pub &'a [Gpu]);

/// What the static lane compares with.
#[derive(Clone, Copy)]
pub(crate) struct Photographed<'a> {
    /// Photographs and masks.
    pub views: &'a [TrainingView],
    /// What shows behind the layer.
    pub sky: &'a SkyCube,
}

/// What is told after a step.
type Report<'a> = &'a mut dyn FnMut(Progress);

impl<'a> Lanes<'a> {
    /// The GPU of a lane: 0 = dynamic, 1 = static, 2 = sky.
    fn gpu(self, lane: usize) -> Option<&'a Gpu> {
        self.0.get(lane.checked_rem(self.0.len())?)
    }

    /// Runs the three lanes of a frame at the same time. With one device the static lane and the sky take turns: they
    /// would only hold more memory.
    pub fn together<D: Send, S: Send, K: Send>(
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
    pub fn first_frame(
        self,
        config: &FirstFrameConfig,
        views: &[TrainingView],
        start: FirstFrame,
        extent: f32,
        seed: u64,
        report: Report,
    ) -> Result<FirstFrame> {
        let FirstFrame { gaussians, sky } = start;
        Ok(match self.gpu(0) {
            None => ffgs_trainer::train_first_frame(config, views, gaussians, sky, extent, seed, report),
            Some(gpu) => ffgs_trainer_gpu::train_first_frame(
                gpu,
                config,
                views,
                FirstFrame { gaussians, sky },
                extent,
                seed,
                report,
            )?,
        })
    }

    /// The moving Gaussians.
    pub fn dynamic(
        self,
        config: &DynamicLaneConfig,
        views: &[TrainingView],
        around: Surroundings,
        layer: &mut Gaussians,
        seed: u64,
        report: Report,
    ) -> Result<()> {
        match self.gpu(0) {
            None => ffgs_trainer::train_dynamic(config, views, around, layer, seed, report),
            Some(gpu) => {
                if around.prior.is_some() {
                    tracing::warn!(
                        "the GPU's dynamic lane does not use what earlier frames know (dynamic.prior_weight)"
                    );
                }
                ffgs_trainer_gpu::train_dynamic(gpu, config, views, around, layer, seed, report)?;
            }
        }
        Ok(())
    }

    /// The static layer's colours. The linear solve has no GPU twin: it runs on the CPU beside the other lanes.
    pub fn static_layer(
        self,
        lane: &mut StaticLane,
        config: &BackgroundConfig,
        Photographed { views, sky }: Photographed,
        layer: &mut Gaussians,
        seed: u64,
        report: Report,
    ) -> Result<()> {
        match self.gpu(1) {
            Some(gpu) if config.static_method == StaticMethod::Steps => {
                ffgs_trainer_gpu::train_static(gpu, config, views, sky, layer, seed, report)?;
            }
            _ => lane.train(config, views, sky, layer, seed, report),
        }
        Ok(())
    }

    /// The sky.
    pub fn sky(
        self,
        config: &BackgroundConfig,
        views: &[TrainingView],
        layer: &Gaussians,
        sky: &mut SkyCube,
        seed: u64,
    ) -> Result<()> {
        match self.gpu(2) {
            None => ffgs_trainer::train_sky(config, views, layer, sky, seed),
            Some(gpu) => ffgs_trainer_gpu::train_sky(gpu, config, views, layer, sky, seed)?,
        }
        Ok(())
    }

    /// Depth-sorted renders of Gaussians over the sky; on a GPU several views in a submission.
    pub fn render(
        self,
        gaussians: &Gaussians,
        sky: &SkyCube,
        cameras: &[Camera],
    ) -> Result<Vec<PlanarImage>> {
        let options = RenderOptions { antialiased: true, sh_degree: None };
        let behind: Vec<PlanarImage> = cameras.iter().map(|camera| sky_picture(sky, camera)).collect();
        let view = |(camera, image)| View { camera, background: Background::Image(image), tiles: None };
        let views: Vec<View> = cameras.iter().zip(&behind).map(view).collect();
        if let Some(gpu) = self.gpu(0) {
            let rendered = GpuRasterizer::new(gpu, options)?.render_views(gaussians, &views)?;
            return Ok(rendered.into_iter().map(|r| r.image).collect());
        }
        let (rasterizer, mut tape) = (CpuRasterizer::new(options), RenderTape::default());
        let render = |view| {
            rasterizer.render(gaussians, view, &mut tape);
            tape.image().clone()
        };
        Ok(views.iter().map(render).collect())
    }
}

/// What a camera sees of the sky.
pub(crate) fn sky_picture(sky: &SkyCube, camera: &Camera) -> PlanarImage {
    let mut picture = PlanarImage::zeros(camera.size());
    SkyView::new(camera, sky.face_size()).render(sky, &mut picture);
    picture
}

/// A panic of a lane goes on here.
fn joined<T>(lane: std::thread::ScopedJoinHandle<T>) -> T {
    lane.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
