//! The static lane (SH colour only) and the sky lane (texture only). Both look only at pixels outside the dilated
//! foreground mask, so that they need nothing from the dynamic lane of the same frame.

use crate::schedule::Epochs;
use crate::view::{Progress, Running, TrainingView};
use crate::{Adam, AdamVec, LearningRates, LossRegion, PhotometricLoss, SkyCube, SkyView, Update};
use ffgs_core::{Gaussians, ImageSize, Mask, PlanarImage};
use ffgs_rasterizer::{
    Background, CpuRasterizer, DifferentiableRasterizer, Gradients, PixelGradients, Rasterizer,
    RenderOptions, RenderTape, View,
};
use serde::{Deserialize, Serialize};

/// How the static layer's colours and the sky follow the light each frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BackgroundLanesConfig {
    /// Steps a frame of the static lane, one view each.
    pub static_iterations: usize,
    /// Rate of SH coefficient 0 in the static lane.
    pub sh0_rate: f32,
    /// Rate of the other SH coefficients.
    pub sh_rest_rate: f32,
    /// Steps a frame of the sky lane.
    pub sky_iterations: usize,
    /// Rate of the sky's texels.
    pub sky_rate: f32,
    /// Pixels by which the mask is grown before it is left out.
    pub mask_dilation: usize,
}

impl Default for BackgroundLanesConfig {
    fn default() -> Self {
        Self {
            static_iterations: 500,
            sh0_rate: 1e-3,
            sh_rest_rate: 5e-5,
            sky_iterations: 50,
            sky_rate: 1e-3,
            mask_dilation: 3,
        }
    }
}

fn outside(view: &TrainingView, dilation: usize) -> Mask {
    let grown = view.mask.dilated(dilation);
    let inverse = grown.data().iter().map(|&v| u8::from(v == 0)).collect();
    Mask::new(grown.size(), inverse).unwrap_or_else(|| Mask::filled(grown.size(), true))
}

/// Finetunes the SH colours of the static layer; geometry and opacity do not change.
pub fn train_static(
    config: &BackgroundLanesConfig,
    views: &[TrainingView],
    sky: &SkyCube,
    layer: &mut Gaussians,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) {
    let rasterizer = CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None });
    let regions: Vec<Mask> = views.iter().map(|v| outside(v, config.mask_dilation)).collect();
    let rates = LearningRates {
        means: 0.0,
        quats: 0.0,
        scales: 0.0,
        opacities: 0.0,
        sh0: config.sh0_rate,
        sh_rest: config.sh_rest_rate,
    };
    let (mut tape, mut loss, mut gradients) =
        (RenderTape::default(), PhotometricLoss::new(), Gradients::default());
    let mut pixel_gradient = PlanarImage::zeros(ImageSize { width: 1, height: 1 });
    let backgrounds: Vec<PlanarImage> = views.iter().map(|v| render_sky(sky, v)).collect();
    let mut adam = Adam::new(layer.len(), layer.sh_degree());
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    let mut running = Running::default();
    for iteration in 0..config.static_iterations {
        let Some(index) = epochs.draw() else { return };
        let (view, background) = (&views[index], Background::Image(&backgrounds[index]));
        let frame = View { camera: &view.camera, background, tiles: None };
        rasterizer.render(layer, &frame, &mut tape);
        let region = LossRegion::Mask(&regions[index]);
        let value = loss.evaluate(tape.image(), &view.image, region, &mut pixel_gradient);
        running.add(value.total, value.mse);
        gradients.reset(layer.len(), layer.sh_degree());
        let upstream = PixelGradients { image: &pixel_gradient, transmittance: None };
        rasterizer.backward(layer, &frame, &mut tape, &upstream, &mut gradients);
        adam.step(layer, &gradients.gaussians, &rates, Update::Touched(&gradients.touched));
        report(running.progress(iteration + 1, config.static_iterations, layer.len()));
    }
}

fn render_sky(sky: &SkyCube, view: &TrainingView) -> PlanarImage {
    let mut out = PlanarImage::zeros(view.camera.size());
    sky.render(&SkyView::new(&view.camera, sky.face_size()), &mut out);
    out
}

/// Finetunes the sky through the transmittance that `layer` leaves; the layer is rendered once a view.
pub fn train_sky(
    config: &BackgroundLanesConfig,
    views: &[TrainingView],
    layer: &Gaussians,
    sky: &mut SkyCube,
    seed: u64,
) {
    if config.sky_iterations == 0 {
        return;
    }
    let cached: Vec<SkyTarget> =
        views.iter().map(|v| SkyTarget::new(v, layer, sky, config.mask_dilation)).collect();
    let mut adam = AdamVec::new(sky.texels.len(), 3);
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    let mut rendered = PlanarImage::zeros(ImageSize { width: 1, height: 1 });
    let mut gradient = vec![[0.0; 3]; sky.texels.len()];
    for _ in 0..config.sky_iterations {
        let Some(index) = epochs.draw() else { return };
        let target = &cached[index];
        rendered.reset(views[index].camera.size());
        sky.render(&target.texels, &mut rendered);
        target.residual(&mut rendered);
        gradient.fill([0.0; 3]);
        target.texels.backward(&rendered, &mut gradient);
        let seen: Vec<bool> = gradient.iter().map(|t| *t != [0.0; 3]).collect();
        let texels = sky.texels.as_flattened_mut();
        adam.step(texels, gradient.as_flattened(), config.sky_rate, Update::Touched(&seen));
    }
}

struct SkyTarget {
    texels: SkyView,
    /// Photograph minus the layer's own colour.
    remainder: PlanarImage,
    /// Transmittance; 0 where the foreground may be.
    transmittance: Vec<f32>,
}

impl SkyTarget {
    fn new(view: &TrainingView, layer: &Gaussians, sky: &SkyCube, dilation: usize) -> Self {
        let mut tape = RenderTape::default();
        let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: None };
        CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None })
            .render(layer, &frame, &mut tape);
        let mut remainder = PlanarImage::from(&view.image);
        remainder.data_mut().iter_mut().zip(tape.image().data()).for_each(|(r, c)| *r -= c);
        let region = outside(view, dilation);
        let counted = tape.transmittance().iter().zip(region.data());
        let transmittance = counted.map(|(&t, &inside)| if inside == 0 { 0.0 } else { t }).collect();
        Self { texels: SkyView::new(&view.camera, sky.face_size()), remainder, transmittance }
    }

    /// Replaces a rendered sky by the derivative of half the squared error.
    fn residual(&self, sky: &mut PlanarImage) {
        let pixels = self.transmittance.len();
        for (i, v) in sky.data_mut().iter_mut().enumerate() {
            let t = self.transmittance[i % pixels];
            *v = t * (t * *v - self.remainder.data()[i]);
        }
    }
}
