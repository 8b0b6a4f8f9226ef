//! Frame 0: static, dynamic and sky together, from points, trackside and initialisation views.

use crate::densify::{DensityConfig, DensityControl, ViewStatistics, reset_opacities};
use crate::schedule::{Epochs, decay};
use crate::sky::sky_share;
use crate::view::{Progress, Running};
use crate::{
    Adam, AdamVec, LearningRates, LossRegion, PhotometricLoss, SKY_DOUBT, SkyView, TexelGradients, Update,
};
use ffgs_core::{Gaussians, ImageSize, PlanarImage, SkyCube, TrainingView};
use ffgs_rasterizer::{
    Background, CpuRasterizer, DifferentiableRasterizer, Gradients, PixelGradients, Rasterizer,
    RenderOptions, RenderTape, View,
};
use serde::{Deserialize, Serialize};

/// How frame 0 is trained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FirstFrameConfig {
    /// Steps, one view each.
    pub iterations: usize,
    /// SH degree of the colours (0..=3); one degree more is switched on at each tenth of the steps.
    pub sh_degree: usize,
    /// Position rate at the first step, as a share of the scene's extent.
    pub position_rate: f32,
    /// Position rate at the last step, likewise.
    pub position_rate_end: f32,
    /// Rate of log scales.
    pub scale_rate: f32,
    /// Rate of opacity logits.
    pub opacity_rate: f32,
    /// Steps between two rounds of growth and removal; 0 = none.
    pub densify_every: usize,
    /// Growth begins and ends at these shares of the steps.
    pub densify_span: [f32; 2],
    /// Mean gradient from which a Gaussian grows.
    pub grow_gradient: f32,
    /// Number of Gaussians never exceeded by growth.
    pub max_gaussians: usize,
    /// Lower all opacities at this share of the steps; 0 = never.
    pub opacity_reset: f32,
    /// Rate of the sky's texels.
    pub sky_rate: f32,
}

impl Default for FirstFrameConfig {
    fn default() -> Self {
        Self {
            iterations: 3000,
            sh_degree: 3,
            position_rate: 2e-4,
            position_rate_end: 2e-6,
            scale_rate: 1.5e-2,
            opacity_rate: 3e-2,
            densify_every: 200,
            densify_span: [0.1, 0.6],
            grow_gradient: 2e-4,
            max_gaussians: 90_000,
            opacity_reset: 0.0,
            sky_rate: 5e-3,
        }
    }
}

/// The trained frame 0.
#[derive(Clone, Debug)]
pub struct FirstFrame {
    /// All Gaussians; the split into layers is made from the masks afterwards.
    pub gaussians: Gaussians,
    /// The sky.
    pub sky: SkyCube,
}

/// Trains frame 0. `extent` is the radius of the training cameras (m); the views must not be empty.
pub fn train_first_frame(
    config: &FirstFrameConfig,
    views: &[TrainingView],
    initial: Gaussians,
    sky: SkyCube,
    extent: f32,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> FirstFrame {
    let mut training = Training::new(config, views, initial, sky, extent, seed);
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    for iteration in 0..config.iterations {
        if let Some(view) = epochs.draw() {
            training.step(iteration, view);
            training.control_density(iteration + 1);
            report(training.running.progress(iteration + 1, config.iterations, training.gaussians.len()));
        }
    }
    FirstFrame { gaussians: training.gaussians, sky: training.sky }
}

/// Thresholds of the density control in frame 0.
pub fn density_config(config: &FirstFrameConfig) -> DensityConfig {
    DensityConfig {
        grow_gradient: config.grow_gradient,
        max_gaussians: config.max_gaussians,
        prune_scale: f32::INFINITY,
        ..DensityConfig::default()
    }
}

struct Training<'a> {
    config: &'a FirstFrameConfig,
    views: &'a [TrainingView],
    /// Of the view at hand.
    sky_view: Option<SkyView>,
    gaussians: Gaussians,
    sky: SkyCube,
    extent: f32,
    adam: Adam,
    sky_adam: AdamVec,
    density: DensityControl,
    running: Running,
    tape: RenderTape,
    loss: PhotometricLoss,
    gradients: Gradients,
    background: PlanarImage,
    pixel_gradient: PlanarImage,
    texel_gradients: TexelGradients,
    /// Not used by this method: all zero.
    radii: Vec<f32>,
}

impl<'a> Training<'a> {
    fn new(
        config: &'a FirstFrameConfig,
        views: &'a [TrainingView],
        gaussians: Gaussians,
        sky: SkyCube,
        extent: f32,
        seed: u64,
    ) -> Self {
        let size = ImageSize { width: 1, height: 1 };
        let density = density_config(config);
        Self {
            config,
            views,
            sky_view: None,
            adam: Adam::new(gaussians.len(), gaussians.sh_degree()),
            sky_adam: AdamVec::new(sky.texels.len(), 3),
            density: DensityControl::new(density, gaussians.len(), seed),
            texel_gradients: TexelGradients::new(sky.texels.len()),
            radii: Vec::new(),
            gaussians,
            sky,
            extent,
            running: Running::default(),
            tape: RenderTape::default(),
            loss: PhotometricLoss::new(),
            gradients: Gradients::default(),
            background: PlanarImage::zeros(size),
            pixel_gradient: PlanarImage::zeros(size),
        }
    }

    fn step(&mut self, iteration: usize, index: usize) {
        let view = &self.views[index];
        let degree = iteration * 10 / self.config.iterations.max(1);
        let rasterizer = CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: Some(degree) });
        let face_size = self.sky.face_size();
        let sky_view = self.sky_view.get_or_insert_with(|| SkyView::new(&view.camera, face_size));
        sky_view.aim(&view.camera);
        sky_view.render(&self.sky, &mut self.background);
        let frame =
            View { camera: &view.camera, background: Background::Image(&self.background), tiles: None };
        rasterizer.render(&self.gaussians, &frame, &mut self.tape);
        let value =
            self.loss.evaluate(self.tape.image(), &view.image, LossRegion::Full, &mut self.pixel_gradient);
        self.running.add(value.total, value.mse);
        self.gradients.reset(self.gaussians.len(), self.gaussians.sh_degree());
        let upstream = PixelGradients { image: &self.pixel_gradient, transmittance: None };
        rasterizer.backward(&self.gaussians, &frame, &mut self.tape, &upstream, &mut self.gradients);
        self.update(iteration);
    }

    fn update(&mut self, iteration: usize) {
        let c = self.config;
        let rate = decay(c.position_rate, c.position_rate_end, iteration, c.iterations) * self.extent;
        let rates = LearningRates {
            scales: c.scale_rate,
            opacities: c.opacity_rate,
            ..LearningRates::with_means(rate)
        };
        let touched = &self.gradients.touched;
        self.adam.step(&mut self.gaussians, &self.gradients.gaussians, &rates, Update::Touched(touched));
        self.update_sky();
        self.observe();
    }

    /// Sparse in the texels that the view sees. The transmittance enters twice: the derivative holds it once, and the error
    /// of a hidden pixel is not the sky's.
    fn update_sky(&mut self) {
        let Some(view) = &self.sky_view else { return };
        let through = self.tape.transmittance();
        for plane in self.pixel_gradient.data_mut().chunks_exact_mut(through.len()) {
            plane.iter_mut().zip(through).for_each(|(g, &t)| *g *= t * sky_share(t));
        }
        let doubt = SKY_DOUBT / (3 * through.len()) as f32;
        self.texel_gradients.clear();
        view.backward(&self.pixel_gradient, &mut self.texel_gradients);
        let TexelGradients { sums, touched, .. } = &self.texel_gradients;
        let texels = self.sky.texels.as_flattened_mut();
        let rate = (self.config.sky_rate, doubt);
        self.sky_adam.step(texels, sums.as_flattened(), rate, Update::Touched(touched));
    }

    fn observe(&mut self) {
        self.radii.resize(self.gaussians.len(), 0.0);
        self.density.observe(&ViewStatistics {
            gradient_norms: &self.gradients.mean2d_norm,
            visible: &self.gradients.touched,
            radii: &self.radii,
        });
    }

    fn control_density(&mut self, done: usize) {
        let c = self.config;
        let share = done as f32 / c.iterations as f32;
        let reset_at = (c.opacity_reset * c.iterations as f32) as usize;
        if reset_at > 0 && done == reset_at {
            reset_opacities(&mut self.gaussians, 0.01);
            self.adam.reset_opacity();
        }
        let due = c.densify_every > 0 && done.is_multiple_of(c.densify_every);
        if due && share >= c.densify_span[0] && share <= c.densify_span[1] {
            let plan = self.density.plan(&self.gaussians, self.extent);
            let map = self.density.apply(&plan, &mut self.gaussians);
            self.adam.remap(&map);
        }
    }
}
