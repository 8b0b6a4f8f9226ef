//! The dynamic lane: all parameters of the moving Gaussians, at a cost proportional to the foreground.
//!
//! Per view the static layer and the sky are rendered once, cut at the depth of the moving layer (docs/adr/0003):
//! image = front + T_front (dynamic over behind). A step then touches only the moving Gaussians and the tiles under
//! the dilated mask.

use crate::background::SkyBehind;
use crate::loss::SSIM_WEIGHT;
use crate::prior::{Penalty, Prior};
use crate::schedule::{Epochs, decay};
use crate::view::{Progress, Running};
use crate::{Adam, LearningRates, LossRegion, PhotometricLoss, Update};
use ffgs_core::{Gaussians, ImageSize, Mask, PlanarImage, SkyCube, TrainingView};
use ffgs_rasterizer::{
    Background, CpuRasterizer, DifferentiableRasterizer, Gradients, PixelGradients, Rasterizer,
    RenderOptions, RenderTape, SplitLayers, TileDepths, TileMask, View,
};
use rayon::prelude::*;
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
    /// Weight of what earlier frames know; 1 = as their information says, 0 = nothing is kept. The diagonal counts what
    /// neighbours that overlap share as known of each, so it claims too much.
    pub prior_weight: f32,
    /// Least change of a parameter from frame to frame (standard deviation): turns (rad), log scales, opacity logits, SH
    /// coefficient 0, the others.
    pub drift: [f64; 5],
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
            prior_weight: 0.1,
            drift: [0.02, 0.04, 0.1, 0.04, 0.02],
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
    /// What is known of the dynamic layer; `None` = nothing.
    pub prior: Option<Prior<'a>>,
}

/// Pixels around the mask whose tiles are computed: a splat that leaves the mask must still be seen there.
pub const TILE_DILATION: usize = 4;

/// What stays fixed of one view. Columns hold the pixels of the computed tiles only: nothing else of an image is read
/// or written in a step, and memory grows with the foreground as time does.
struct CachedView<'a> {
    view: &'a TrainingView,
    region: Mask,
    tiles: TileMask,
    /// Pixels of `tiles`.
    runs: Vec<Range<usize>>,
    /// Static colour in front of the moving layer, channel by channel.
    front: Vec<f32>,
    /// Transmittance of that.
    transmittance: Vec<f32>,
    /// Static colour and sky behind the moving layer, channel by channel.
    behind: Vec<f32>,
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
    let mut cache = Cache::new(config, rasterizer, surroundings, dynamic);
    let cached = cache.views(views);
    let seen = cache.seen;
    let mut lane = Lane::new(config, &cached, rasterizer, dynamic);
    lane.penalty_of_change = surroundings.prior.map(|prior| Penalty::new(prior, dynamic, seen));
    let mut epochs = Epochs::new((0..cached.len()).collect(), seed);
    for iteration in 0..config.iterations {
        let Some(index) = epochs.draw() else { return };
        lane.step(iteration, index, dynamic);
        report(lane.running.progress(iteration + 1, config.iterations, dynamic.len()));
    }
}

/// Makes the cached views, one after another in the same memory.
struct Cache<'a> {
    config: &'a DynamicLaneConfig,
    rasterizer: CpuRasterizer,
    around: Surroundings<'a>,
    dynamic: &'a Gaussians,
    tape: RenderTape,
    sky: SkyBehind,
    layers: SplitLayers,
    /// Views that see each Gaussian.
    seen: Vec<u32>,
}

impl<'a> Cache<'a> {
    fn new(
        config: &'a DynamicLaneConfig,
        rasterizer: CpuRasterizer,
        around: Surroundings<'a>,
        dynamic: &'a Gaussians,
    ) -> Self {
        let (tape, sky, layers) = (RenderTape::default(), SkyBehind::new(), SplitLayers::default());
        let seen = vec![0; dynamic.len()];
        Self { config, rasterizer, around, dynamic, tape, sky, layers, seen }
    }

    /// Those with foreground.
    fn views<'v>(&mut self, views: &'v [TrainingView]) -> Vec<CachedView<'v>> {
        views.iter().filter(|v| v.mask.count() > 0).map(|v| self.view(v)).collect()
    }

    fn view<'v>(&mut self, view: &'v TrainingView) -> CachedView<'v> {
        let camera = &view.camera;
        let tiles = TileMask::covering(&view.mask.dilated(TILE_DILATION));
        let background = Background::Image(self.sky.render(self.around.sky, camera));
        let frame = View { camera, background, tiles: Some(&tiles) };
        self.rasterizer.render(self.dynamic, &frame, &mut self.tape);
        self.tape.visible_indices().for_each(|i| self.seen[i] += 1);
        let depths = TileDepths::nearest(&self.tape);
        let layers = &mut self.layers;
        self.rasterizer.render_split(self.around.static_layer, &frame, &depths, &mut self.tape, layers);
        let region = view.mask.dilated(self.config.loss_dilation);
        let runs = tiles.pixel_runs(camera.size());
        let (front, behind) = (cut_image(&layers.front, &runs), cut_image(&layers.behind, &runs));
        let transmittance = cut(&layers.transmittance, &runs);
        CachedView { view, region, tiles, runs, front, transmittance, behind }
    }
}

/// The values of some runs of a plane, in exactly the memory they need.
fn cut(plane: &[f32], runs: &[Range<usize>]) -> Vec<f32> {
    let mut out = Vec::with_capacity(runs.iter().map(Range::len).sum());
    runs.iter().for_each(|run| out.extend_from_slice(&plane[run.clone()]));
    out
}

fn cut_image(image: &PlanarImage, runs: &[Range<usize>]) -> Vec<f32> {
    [0, 1, 2].map(|c| cut(image.plane(c), runs)).concat()
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
    /// Of the view at hand, meaningful in its computed tiles.
    behind: PlanarImage,
    /// Derivative of the alpha penalty with respect to transmittance, likewise.
    penalty: Vec<f32>,
    penalty_of_change: Option<Penalty<'a>>,
}

impl<'a> Lane<'a> {
    fn new(
        config: &'a DynamicLaneConfig,
        cached: &'a [CachedView<'a>],
        rasterizer: CpuRasterizer,
        dynamic: &Gaussians,
    ) -> Self {
        let size = ImageSize { width: 1, height: 1 };
        Self {
            config,
            cached,
            rasterizer,
            extent: robust_extent(dynamic),
            adam: Adam::new(dynamic.len(), dynamic.sh_degree()),
            running: Running::default(),
            tape: RenderTape::default(),
            loss: PhotometricLoss::new(),
            gradients: Gradients::default(),
            image: PlanarImage::zeros(size),
            pixel_gradient: PlanarImage::zeros(size),
            behind: PlanarImage::zeros(size),
            penalty: Vec::new(),
            penalty_of_change: None,
        }
    }

    fn step(&mut self, iteration: usize, index: usize, dynamic: &mut Gaussians) {
        let cached = &self.cached[index];
        self.unpack(cached);
        let background = Background::Image(&self.behind);
        let frame = View { camera: &cached.view.camera, background, tiles: Some(&cached.tiles) };
        self.rasterizer.render(dynamic, &frame, &mut self.tape);
        compose(cached, self.tape.image(), &mut self.image);
        let region = LossRegion::Mask(&cached.region);
        let value = self.loss.evaluate(&self.image, &cached.view.image, region, &mut self.pixel_gradient);
        self.running.add(value.total, value.mse);
        for_each_run(&mut self.pixel_gradient, &cached.runs, |_, _, at, gradient| {
            gradient.iter_mut().zip(&cached.transmittance[at]).for_each(|(g, &t)| *g *= t);
        });
        self.gradients.reset(dynamic.len(), dynamic.sh_degree());
        let upstream = PixelGradients { image: &self.pixel_gradient, transmittance: Some(&self.penalty) };
        self.rasterizer.backward(dynamic, &frame, &mut self.tape, &upstream, &mut self.gradients);
        if let Some(penalty) = &self.penalty_of_change {
            let pixels = cached.region.count();
            let l1_share = 1.0 - SSIM_WEIGHT as f32;
            penalty.add(dynamic, l1_share, pixels, &mut self.gradients);
        }
        let touched = Update::Touched(&self.gradients.touched);
        self.adam.step(
            dynamic,
            &self.gradients.gaussians,
            &self.config.rates(iteration, self.extent),
            touched,
        );
    }

    /// Lays what is cached of a view into images of its size.
    fn unpack(&mut self, cached: &CachedView) {
        let size = cached.view.camera.size();
        if self.behind.size() != size {
            self.behind.reset(size);
            self.image.reset(size);
            self.penalty.resize(size.pixels(), 0.0);
        }
        let pixels = cached.transmittance.len();
        for_each_run(&mut self.behind, &cached.runs, |channel, _, at, out| {
            out.copy_from_slice(&cached.behind[channel * pixels..][at]);
        });
        let weight = self.config.outside_alpha / cached.view.mask.count() as f32;
        let mut transmittance = cached.transmittance.iter();
        for run in &cached.runs {
            let region = &cached.region.data()[run.clone()];
            for ((out, &inside), &t) in
                self.penalty[run.clone()].iter_mut().zip(region).zip(&mut transmittance)
            {
                *out = if inside == 0 { -weight * t } else { 0.0 };
            }
        }
    }
}

/// `front + T_front * (dynamic over behind)`.
fn compose(cached: &CachedView, dynamic: &PlanarImage, image: &mut PlanarImage) {
    let pixels = cached.transmittance.len();
    for_each_run(image, &cached.runs, |channel, run, at, out| {
        let front = &cached.front[channel * pixels..][at.clone()];
        let dynamic = &dynamic.plane(channel)[run];
        let through = &cached.transmittance[at];
        for (((out, &front), &dynamic), &t) in out.iter_mut().zip(front).zip(dynamic).zip(through) {
            *out = front + t * dynamic;
        }
    });
}

/// Calls `visit(channel, run, place in the cached columns, values)` for every channel of the pixels in `runs`.
fn for_each_run(
    image: &mut PlanarImage,
    runs: &[Range<usize>],
    visit: impl Fn(usize, Range<usize>, Range<usize>, &mut [f32]) + Sync,
) {
    let pixels = image.size().pixels();
    image.data_mut().par_chunks_exact_mut(pixels).enumerate().for_each(|(channel, plane)| {
        let mut start = 0;
        for run in runs {
            let at = start..start + run.len();
            start = at.end;
            visit(channel, run.clone(), at, &mut plane[run.clone()]);
        }
    });
}
