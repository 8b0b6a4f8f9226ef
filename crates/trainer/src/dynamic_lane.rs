//! The dynamic lane: all parameters of the moving Gaussians, at a cost proportional to the foreground.
//!
//! Per view the static layer and the sky are rendered once, cut at the depth of the moving layer (docs/adr/0003):
//! image = front + T_front (dynamic over behind). A step then touches only the moving Gaussians and the tiles under
//! the dilated mask.

use crate::schedule::{Epochs, decay};
use crate::view::{Progress, Running, TrainingView};
use crate::{Adam, LearningRates, LossRegion, PhotometricLoss, SkyCube, SkyView, Update};
use ffgs_core::{Gaussians, ImageSize, Mask, PlanarImage};
use ffgs_rasterizer::{
    Background, CpuRasterizer, DifferentiableRasterizer, Gradients, PixelGradients, Rasterizer,
    RenderOptions, RenderTape, SplitLayers, TileDepths, TileMask, View,
};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// How the dynamic layer is finetuned each frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DynamicLaneConfig {
    /// Steps a frame, one view each (N_dyn).
    pub iterations: usize,
    /// Position rate at the first step, as a share of the dynamic layer's extent.
    pub position_rate: f32,
    /// Position rate at the last step, likewise.
    pub position_rate_end: f32,
    /// Rate of quaternions.
    pub quat_rate: f32,
    /// Rate of log scales.
    pub scale_rate: f32,
    /// Rate of opacity logits.
    pub opacity_rate: f32,
    /// Rate of SH coefficient 0.
    pub sh0_rate: f32,
    /// Rate of the other SH coefficients.
    pub sh_rest_rate: f32,
    /// Pixels by which the mask is grown for the loss, so that silhouettes are learnt from both sides.
    pub loss_dilation: usize,
    /// Weight of the mean alpha outside the mask: keeps floaters away.
    pub outside_alpha: f32,
}

impl Default for DynamicLaneConfig {
    fn default() -> Self {
        Self {
            iterations: 300,
            position_rate: 1e-4,
            position_rate_end: 3e-6,
            quat_rate: 1e-3,
            scale_rate: 5e-3,
            opacity_rate: 1e-2,
            sh0_rate: 2.5e-3,
            sh_rest_rate: 1.25e-4,
            loss_dilation: 1,
            outside_alpha: 0.05,
        }
    }
}

impl DynamicLaneConfig {
    /// Step sizes at a step, for a layer of radius `extent` (m).
    pub fn rates(&self, iteration: usize, extent: f32) -> LearningRates {
        LearningRates {
            means: decay(self.position_rate, self.position_rate_end, iteration, self.iterations) * extent,
            quats: self.quat_rate,
            scales: self.scale_rate,
            opacities: self.opacity_rate,
            sh0: self.sh0_rate,
            sh_rest: self.sh_rest_rate,
        }
    }
}

/// What stays fixed while the dynamic layer is trained.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// The static layer.
    pub static_layer: &'a Gaussians,
    /// The sky.
    pub sky: &'a SkyCube,
}

/// Pixels around the mask whose tiles are computed: a splat that leaves the mask must still be seen there.
pub const TILE_DILATION: usize = 4;

struct CachedView<'a> {
    view: &'a TrainingView,
    region: Mask,
    tiles: TileMask,
    /// Pixels of `tiles`; nothing else of an image is read or written in a step.
    runs: Vec<Range<usize>>,
    layers: SplitLayers,
    /// Derivative of the alpha penalty with respect to transmittance, row-major.
    penalty: Vec<f32>,
}

/// Finetunes `dynamic` on the foreground of `views`. Views without foreground are not used; with none left, or no
/// Gaussians, nothing changes.
pub fn train_dynamic(
    config: &DynamicLaneConfig,
    views: &[TrainingView],
    surroundings: Surroundings,
    dynamic: &mut Gaussians,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) {
    if dynamic.is_empty() || config.iterations == 0 {
        return;
    }
    let rasterizer = CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None });
    let mut tape = RenderTape::default();
    let used = views.iter().filter(|v| v.mask.count() > 0);
    let cached: Vec<CachedView> =
        used.map(|v| cache_view(config, &rasterizer, v, surroundings, dynamic, &mut tape)).collect();
    let mut lane = Lane::new(config, &cached, rasterizer, dynamic, tape);
    let mut epochs = Epochs::new((0..cached.len()).collect(), seed);
    for iteration in 0..config.iterations {
        let Some(index) = epochs.draw() else { return };
        lane.step(iteration, index, dynamic);
        report(lane.running.progress(iteration + 1, config.iterations, dynamic.len()));
    }
}

fn cache_view<'a>(
    config: &DynamicLaneConfig,
    rasterizer: &CpuRasterizer,
    view: &'a TrainingView,
    around: Surroundings,
    dynamic: &Gaussians,
    tape: &mut RenderTape,
) -> CachedView<'a> {
    let camera = &view.camera;
    let tiles = TileMask::covering(&view.mask.dilated(TILE_DILATION));
    let mut background = PlanarImage::zeros(camera.size());
    around.sky.render(&SkyView::new(camera, around.sky.face_size()), &mut background);
    let frame = View { camera, background: Background::Image(&background), tiles: Some(&tiles) };
    rasterizer.render(dynamic, &frame, tape);
    let depths = TileDepths::nearest(tape);
    let mut layers = SplitLayers::default();
    rasterizer.render_split(around.static_layer, &frame, &depths, tape, &mut layers);
    layers.shrink();
    let region = view.mask.dilated(config.loss_dilation);
    let weight = config.outside_alpha / view.mask.count() as f32;
    let penalty = region
        .data()
        .iter()
        .zip(&layers.transmittance)
        .map(|(&inside, &t)| if inside == 0 { -weight * t } else { 0.0 })
        .collect();
    let runs = tiles.pixel_runs(camera.size());
    CachedView { view, region, tiles, runs, layers, penalty }
}

/// Radius (m) around the median position that holds 90 % of the Gaussians: outliers must not set the step size.
pub fn robust_extent(gaussians: &Gaussians) -> f32 {
    if gaussians.is_empty() {
        return 0.0;
    }
    let n = gaussians.len();
    let center = [0, 1, 2].map(|a| {
        let mut axis: Vec<f32> = gaussians.means.iter().map(|m| m[a]).collect();
        axis.sort_by(f32::total_cmp);
        axis[n / 2]
    });
    let distance = |m: &[f32; 3]| (0..3).map(|a| (m[a] - center[a]).powi(2)).sum::<f32>().sqrt();
    let mut distances: Vec<f32> = gaussians.means.iter().map(distance).collect();
    distances.sort_by(f32::total_cmp);
    distances[(n * 9 / 10).min(n - 1)]
}

struct Lane<'a> {
    config: &'a DynamicLaneConfig,
    cached: &'a [CachedView<'a>],
    rasterizer: CpuRasterizer,
    extent: f32,
    adam: Adam,
    running: Running,
    tape: RenderTape,
    loss: PhotometricLoss,
    gradients: Gradients,
    image: PlanarImage,
    pixel_gradient: PlanarImage,
}

impl<'a> Lane<'a> {
    fn new(
        config: &'a DynamicLaneConfig,
        cached: &'a [CachedView<'a>],
        rasterizer: CpuRasterizer,
        dynamic: &Gaussians,
        tape: RenderTape,
    ) -> Self {
        let size = ImageSize { width: 1, height: 1 };
        Self {
            config,
            cached,
            rasterizer,
            extent: robust_extent(dynamic),
            adam: Adam::new(dynamic.len(), dynamic.sh_degree()),
            running: Running::default(),
            tape,
            loss: PhotometricLoss::new(),
            gradients: Gradients::default(),
            image: PlanarImage::zeros(size),
            pixel_gradient: PlanarImage::zeros(size),
        }
    }

    fn step(&mut self, iteration: usize, index: usize, dynamic: &mut Gaussians) {
        let cached = &self.cached[index];
        let layers = &cached.layers;
        let background = Background::Image(&layers.behind);
        let frame = View { camera: &cached.view.camera, background, tiles: Some(&cached.tiles) };
        self.rasterizer.render(dynamic, &frame, &mut self.tape);
        self.compose(cached);
        let region = LossRegion::Mask(&cached.region);
        let value = self.loss.evaluate(&self.image, &cached.view.image, region, &mut self.pixel_gradient);
        self.running.add(value.total, value.mse);
        for_each_run(&mut self.pixel_gradient, &cached.runs, |_, run, gradient| {
            gradient.iter_mut().zip(&layers.transmittance[run]).for_each(|(g, &t)| *g *= t);
        });
        self.gradients.reset(dynamic.len(), dynamic.sh_degree());
        let upstream = PixelGradients { image: &self.pixel_gradient, transmittance: Some(&cached.penalty) };
        self.rasterizer.backward(dynamic, &frame, &mut self.tape, &upstream, &mut self.gradients);
        let touched = Update::Touched(&self.gradients.touched);
        self.adam.step(
            dynamic,
            &self.gradients.gaussians,
            &self.config.rates(iteration, self.extent),
            touched,
        );
    }

    /// `front + T_front * (dynamic over behind)`.
    fn compose(&mut self, cached: &CachedView) {
        let (layers, size) = (&cached.layers, cached.layers.front.size());
        if self.image.size() != size {
            self.image.reset(size);
        }
        let dynamic = self.tape.image();
        for_each_run(&mut self.image, &cached.runs, |channel, run, out| {
            let front = &layers.front.plane(channel)[run.clone()];
            let dynamic = &dynamic.plane(channel)[run.clone()];
            let through = &layers.transmittance[run];
            for (((out, &front), &dynamic), &t) in out.iter_mut().zip(front).zip(dynamic).zip(through) {
                *out = front + t * dynamic;
            }
        });
    }
}

/// Calls `visit(channel, run, values)` for every channel of the pixels in `runs`.
fn for_each_run(
    image: &mut PlanarImage,
    runs: &[Range<usize>],
    mut visit: impl FnMut(usize, Range<usize>, &mut [f32]),
) {
    let pixels = image.size().pixels();
    for (channel, plane) in image.data_mut().chunks_exact_mut(pixels).enumerate() {
        for run in runs {
            visit(channel, run.clone(), &mut plane[run.clone()]);
        }
    }
}
